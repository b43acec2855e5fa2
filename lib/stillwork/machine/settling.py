"""Settling of an isolator's weights on the record itself: from zero, around the nominal isolator and at the ends of its box."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from stillwork.base.bounds import Positive
from stillwork.base.checks import pluralise
from stillwork.base.validation import by_value, check_fields
from stillwork.machine import pictures
from stillwork.machine.isolation import FloorSpectra
from stillwork.machine.isolation_design import (
    LONGEST_S,
    LOWEST_HZ,
    WITHIN,
    IsolationDesign,
    adapt_slower,
    perturbed,
    settling_time,
)
from stillwork.machine.replay import Course, Replay, controller, replay

ENDS = 4  # of the box, tried beside the nominal isolator
ROUNDS = 5.0  # of the record, at most
LATER = 2.5  # times the settling that theory expects: so long the record runs, at most
WINDOW_S, JUDGED_S = 10, 60  # over which the remaining motion is compared, soon after settling and for longer
LINES = 8_000  # of the paths: what is compared shares them
TRIES = 6  # of time constants
GOAL = (
    0.8  # of the variance, that weights that move add on the record at most: other ends of the box add more
)
SLOWER = 1.4, 4.0  # from one to the next, at least and at most: the excess falls as its root or faster


@by_value
@dataclass(frozen=True)
class Learning:
    """What remains while weights learn from zero, over what the design's leave: the nominal isolator, then ends of its box."""

    power: Float64[np.ndarray, "isolators seconds"]  # of all axes in the judged band, (m/s^2)^2
    frozen: Float64[np.ndarray, "isolators seconds"]  # with the mean of each one's weights in the last window
    expected: tuple[float, float]  # settling by theory, s: nominal, and at most in the box
    duration: Positive  # s, of the record

    def __post_init__(self):
        check_fields(self)

    @property
    def window(self) -> int:
        """Seconds over which weights that have settled are judged: those of the record, a minute at most."""
        return max(WINDOW_S, min(JUDGED_S, round(self.duration), self.power.shape[1] // 2))

    @property
    def shown(self) -> bool:
        """Whether the record, several times round, is long enough to show how its weights settle."""
        return self.expected[1] + self.window <= self.power.shape[1]

    @property
    def excess(self) -> float:
        """Share by which the power of the last window is above that with frozen weights, at most."""
        last = slice(-self.window, None)
        return float(np.max(self.power[:, last].sum(axis=1) / self.frozen[:, last].sum(axis=1)) - 1)

    @property
    def settled(self) -> tuple[float, float]:
        """Seconds (nominal, at most) to where a window is above by a tenth, or the excess, at most; by theory where longer.

        The first ten seconds of it are above by a tenth of what remains at most.
        """
        if not self.shown:
            return self.expected
        starts, above = np.arange(self.power.shape[1] - self.window), []
        excess = 1.0 + max(self.excess, 0.0)
        for length, share in ((WINDOW_S, WITHIN * excess), (self.window, max(WITHIN, excess))):
            sums = np.cumsum(np.pad(self.power - share * self.frozen, ((0, 0), (1, 0))), axis=1)
            above.append(sums[:, starts + length] > sums[:, starts])
        found = np.argmin(np.pad(np.logical_or(*above), ((0, 0), (0, 1))), axis=1)
        return max(self.expected[0], float(found[0])), max(self.expected[1], float(found.max()))

    def record(self) -> dict:
        """Its numbers, as the written JSON has them."""
        return {
            "expected": [each if np.isfinite(each) else None for each in self.expected],
            "shown": self.shown,
            "seconds": self.power.shape[1],
            "excess": self.excess,
        }

    def sentence(self) -> str:
        """What the record shows of it."""
        if not self.shown:
            return f"the record is too short to show it, even {ROUNDS:g} times round: expected of its spectra"
        isolators = f"the isolator as given and {pluralise(len(self.power) - 1, 'end')} of the box"
        rounds = self.power.shape[1] / self.duration
        several = f"the record, which ran {rounds:.2g} times round," if rounds > 1.1 else "the record"
        return (
            f"the longer of {self.expected[1]:.3g} s, expected of its spectra, and what {several} shows with {isolators}; "
            f"a minute after it is {100 * max(self.excess, 0.0):.2g} % above frozen weights at most"
        )


def learn(
    design: IsolationDesign,
    files: dict[str, str],
    name: str,
    pause_s: float,
    floor: FloorSpectra,
    band_hz: tuple[float, float],
    spread: float,
    expected: tuple[float, float],
) -> Learning:
    """Weights from zero on the record, through the written C, each isolator from another time of the record on."""
    rng = np.random.default_rng(0)
    ends = [
        perturbed(design.isolator, spread, lambda count: rng.choice([-1.0, 1.0], count)) for _ in range(ENDS)
    ]
    length = max(min(LATER * expected[1] + JUDGED_S, ROUNDS * floor.duration), 2.0 * WINDOW_S)
    last = round(min(JUDGED_S, floor.duration, length / 2) * design.loop.rate)
    powers: tuple[list[np.ndarray], list[np.ndarray]] = [], []
    with controller(design, files, name, pause_s) as (run, _):
        for k, isolator in enumerate((design.isolator, *ends)):
            times = {"seconds": length, "start_s": k * floor.duration / (ENDS + 1)}
            course = Course(design, isolator, floor, pause_s, band_hz, **times, lines=LINES, seed=k)
            weights = np.zeros_like(design.steady.weights)
            for kept, begins in zip(powers, (course.lead, course.samples), strict=True):
                since = course.lead + course.count - last if begins == course.lead else course.samples
                forces, _, weights = run(isolator, weights, *course.read, np.inf, begins, since)
                kept.append(np.sum(course.left(forces) ** 2, axis=0))
    return Learning(np.array(powers[0]), np.array(powers[1]), expected, floor.duration)


def settling_times(
    design: IsolationDesign, around: list[IsolationDesign], floor: FloorSpectra
) -> tuple[float, float]:
    """Settling by theory, s: of the design, and the longest, of it and those around it."""
    times = [settling_time(each, floor) for each in (design, *around)]
    return times[0], max(times)


def settle_on_record(
    design: IsolationDesign,
    around: list[IsolationDesign],
    floor: FloorSpectra,
    written: Callable[[IsolationDesign], dict[str, str]],
    *,
    name: str,
    limit: float,
    pause_s: float,
    variance: float,
    spread: float,
    correction: Callable | None = None,
) -> tuple[IsolationDesign, list[IsolationDesign], dict[str, str], Replay, Learning]:
    """The design and its C with a time constant with which weights that move add at most `variance` on the record itself, too."""
    band_hz = LOWEST_HZ, design.loop.shaping.lowpass_hz
    for left in reversed(range(TRIES)):
        files, times = written(design), settling_times(design, around, floor)
        learning = learn(design, files, name, pause_s, floor, band_hz, spread, times)
        share = max(learning.excess / (GOAL * variance), 0.0)
        room = (ROUNDS * floor.duration - learning.window) / max(
            1.0, *times
        )  # no slower than the record can show
        slower = design.time_constant * min(float(np.clip(share**1.5, *SLOWER)), room)
        if share <= 1 or room < SLOWER[0] or slower > LONGEST_S or left == 0:
            break
        design, around = adapt_slower(design, around, floor, variance, slower, correction)
    return design, around, files, replay(design, files, name, limit, pause_s, floor, band_hz), learning


@pictures.house_style()
def paint_learning(found: Learning):
    """Power of ten seconds over that with frozen weights, from zero weights on."""
    figure, axes = pictures.new(1, 1, height=2.6)
    sums = [np.cumsum(np.pad(rows, ((0, 0), (1, 0))), axis=1) for rows in (found.power, found.frozen)]
    moving, frozen = (each[:, WINDOW_S:] - each[:, :-WINDOW_S] for each in sums)
    starts = np.arange(moving.shape[1])
    for k, row in reversed(list(enumerate(moving / frozen))):
        colour, label = (pictures.BLUE, "as given") if k == 0 else (pictures.SKY, "ends of the box")
        axes.semilogy(starts, row, color=colour, label=label if k < 2 else None)
    axes.axhline(WITHIN, color=pictures.GREY, linewidth=1.0, label=f"{WITHIN:g} times")
    if np.isfinite(found.settled[1]):
        axes.axvline(found.settled[1], color=pictures.BLACK, linestyle="--", linewidth=1.0, label="stated")
    axes.set(xlabel="time from zero weights (s)", ylabel="power of ten seconds\nover frozen weights'")
    axes.legend(ncols=2)
    return figure
