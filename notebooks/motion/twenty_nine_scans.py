"""Twenty-nine scans: what this notebook alone needs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float64
from numpy.typing import ArrayLike

from experiments.motion import perturbed_tracking
from experiments.motion.designs import DESIGNS, Design, stage_bandwidth
from experiments.motion.intervals import Values, key
from experiments.motion.machines import published_deviations, published_setpoint, stage, stage_mass
from experiments.motion.perturbed_tracking import APPLICATIONS, WARM_UP
from experiments.motion.pictures import case_styles, paint_errors, plain_numbers
from experiments.motion.position_dependence import at_place, compensator_at, stage_grid
from stillwork.base.checks import InputError
from stillwork.control.applications import Application
from stillwork.control.feedforward import BASIS, Feedforward, least_squares, noise_error, noise_errors
from stillwork.control.loops import channel, closed_loop, require_stable
from stillwork.control.pid import Pid, PidFamily
from stillwork.control.setpoint import Setpoint
from stillwork.lti.discretisation import zoh, zoh_modes
from stillwork.lti.modal import ModalModel
from stillwork.lti.reduction import truncate
from stillwork.lti.simulation import simulate
from stillwork.lti.state_space import StateModel
from workbook import figures
from workbook.studies import fraction

FAINT = 1e-12  # what is left of a zero's motion where it is cut off


class Force(NamedTuple):
    """A force held over each sample; it may begin before the move, whose start is time zero."""

    time: Float64[np.ndarray, " samples"]  # s
    values: Float64[np.ndarray, " samples"]  # N
    derivatives: Float64[
        np.ndarray, "4 samples"
    ]  # of the setpoint, velocity to snap: what a feedforward acts on


def sampled_ideal_force(plant: ModalModel, setpoint: Setpoint) -> Force:
    r"""The held force under which the plant meets the setpoint at every sample: stable inversion in discrete time.

    The zero-order hold adds zeros of its own; those outside the unit circle are run backwards. Solved by Fourier
    transformation of :math:`(z-1)^2r = (z-1)^2P(z)f` over a record so long that nothing is left at its ends.
    """
    sample_time = setpoint.sample_time
    sampled = zoh_modes(plant, sample_time)
    distance = np.log(np.abs(sampled.zeros))
    if np.any(np.abs(distance) < 1e-6):
        raise InputError("plant has a zero on the unit circle at this sample time; take another one")
    longest = -np.log(FAINT) / np.abs(distance)
    ahead = int(np.ceil(longest[distance > 0].max(initial=0)))
    moved = np.pad(setpoint.derivatives[1:], ((0, 0), (ahead, 0)))
    size = moved.shape[1]
    # Second differences of the position, from the first ones: those of the positions themselves would be rounding.
    steps = np.append(sample_time ** np.arange(1, 5) / [1, 2, 6, 24] @ moved, 0.0)
    whole = 1 << int(np.ceil(np.log2(size + longest.max())))
    angle = 2 * np.pi * np.fft.rfftfreq(whole)
    z = np.exp(1j * angle)
    rigid = plant.output_shapes[0, 0] * plant.input_shapes[0, 0] * sample_time**2 / 2
    flexible = zoh_modes(plant.modes(slice(1, None)), sample_time)
    gain = rigid * (z + 1) + (z - 1) ** 2 * flexible.frequency_response(angle / sample_time)[0, 0]
    values = np.fft.irfft(np.fft.rfft(np.diff(steps), whole) / gain, whole)
    return Force((np.arange(size) - ahead) * sample_time, values[:size], moved)


def feedforward_error(ideal: Force, feedforward: Feedforward) -> Force:
    """Ideal force less the applied one: what the loop must reject (Fig. 4.9)."""
    return ideal._replace(values=ideal.values - feedforward.gains @ ideal.derivatives)


# === Location study ===============================================================================================
# One feedforward error at many places of the structure, under every published design (section 4.2.5).


SETTLED = 2e-8  # m, within which an error has settled
RUNS = 35  # with other noise, in which the statements of section 4.2.5 are counted
AXIS_N = 30.0  # half the axis of Fig. 4.9
ErrorsByCase = Mapping[str, Float64[np.ndarray, "places samples"]]


@dataclass(frozen=True)
class LocationStudy:
    """True errors at every place."""

    places: Float64[np.ndarray, " places"]  # m
    setpoint: Setpoint
    errors: ErrorsByCase  # m, at the samples of the setpoint

    def noisy(self, noise: ErrorsByCase) -> "LocationStudy":
        """The same with noise on the errors."""
        return replace(self, errors={name: each + noise[name] for name, each in self.errors.items()})

    def rms(self, case: str) -> Float64[np.ndarray, " places"]:
        """Root mean square in the scanning phase (m)."""
        window = self.errors[case][:, self.setpoint.scanning]
        return np.sqrt(np.mean(window**2, axis=1))

    def every_fourth(self) -> "LocationStudy":
        """Of the twenty-nine places those where masses lie, where they go along all eight."""
        return replace(self, places=self.places[::4], errors={n: e[::4] for n, e in self.errors.items()})

    def settled(self, case: str, band: float) -> Float64[np.ndarray, " places"]:
        """Time (s) from the end of the acceleration until the error stays within +-`band` (m) to the scan's end."""
        time = self.setpoint.time
        window = (time >= self.setpoint.acceleration_end) & (time <= self.setpoint.scan[1])
        outside = np.abs(self.errors[case][:, window]) > band
        last = np.where(outside.any(axis=1), outside.shape[1] - np.argmax(outside[:, ::-1], axis=1), 0)
        return last * self.setpoint.sample_time

    def over(self, case: str, low: float, high: float, count: int = 29) -> Float64[np.ndarray, "3"]:
        """Smallest, mean and largest rms error (m) at `count` equally spaced places from `low` to `high` (m).

        Between the places of the study the rms follows a spline.
        """
        from scipy.interpolate import CubicSpline

        at = np.linspace(low, high, count)
        values = CubicSpline(self.places, self.rms(case))(at)
        return np.array([values.min(), values.mean(), values.max()])


Loops = Mapping[float, Mapping[str, StateModel]]

FIT_LOOPS = {"37 Hz": "PID", "83 Hz": "MC and AD"}  # in which the gains are fitted

# Table 4.1
CASES = {name.replace("none", "original"): case for name, case in perturbed_tracking.CASES.items()}


def structure(masses: int) -> tuple[ModalModel, Float64[np.ndarray, " masses"]]:
    """Stage with a sensor at every place (m) of seven masses, or of all `masses` = 8, the actuator's first."""
    plant, grid = stage(), stage_grid()
    if masses == len(grid):
        return plant, grid
    shapes = np.vstack([plant.input_shapes.T, plant.output_shapes])
    whole = replace(plant, output_shapes=shapes, feedthrough=np.zeros((masses, 1)))
    return whole, np.append(grid[0] - grid[1], grid)


@cache
def table_cases() -> dict[str, tuple[str, Pid]]:
    """The seven cases of Table 4.1 with the controllers of the bandwidth table."""
    controllers = {name: stage_bandwidth(name).controller for name in ("PID", *APPLICATIONS)}
    return {case: (design, controllers[name]) for case, (design, name) in CASES.items()}


@cache
def table_loops(masses: int) -> dict[float, dict[str, StateModel]]:
    """Closed loops of the seven cases at 29 equally spaced places from the first to the last of the masses."""
    plant, grid = structure(masses)
    return location_loops(plant, grid, np.linspace(grid[0], grid[-1], 29), table_cases())


@lru_cache(maxsize=2)
def table_noise(masses: int, sample_time: float, seed: int) -> ErrorsByCase:
    """What one draw of the noise of section 3.1 adds to the errors."""
    setpoint = published_setpoint(sample_time)
    return location_noise(table_loops(masses), setpoint, published_deviations(), [seed])[0]


@lru_cache(maxsize=2)
def quiet_table(
    source: str, masses: int, gains_from: str, gains_in: str, sample_time: float, seed: int
) -> LocationStudy:
    """The study of Table 4.1 without noise; the error acts through `source`, the sensor moves along 7 or 8 `masses`."""
    force = table_force(gains_from, gains_in, sample_time, seed)
    return study_locations(table_loops(masses), force, published_setpoint(sample_time), source)


@lru_cache(maxsize=8)
def table_force(gains_from: str, gains_in: str, sample_time: float, seed: int) -> Force:
    """The feedforward error, with gains fitted to a "quiet move" or a "noisy move" with one of `FIT_LOOPS`."""
    setpoint, deviations = published_setpoint(sample_time), published_deviations()
    controller, noise = stage_bandwidth(FIT_LOOPS[gains_in]).controller, None
    if gains_from == "noisy move":
        loop = closed_loop(stage().at([0], [4]), None, controller.state_space())
        draws = np.random.default_rng((seed, 0))
        noise = noise_error(loop, sample_time, WARM_UP + len(setpoint.time), deviations, draws)[1, WARM_UP:]
    return stage_error(setpoint, controller, noise=noise)


def table_values(study: LocationStudy) -> pd.DataFrame:
    """Table 4.1 (nm): printed, over the whole structure, and least and largest over parts of at least half of it."""
    rows = {}
    for case, printed in PUBLISHED.items():
        whole = 1e9 * study.over(case, study.places[0], study.places[-1])
        parts = 1e9 * np.array([study.over(case, *ends) for ends in ranges(study.places, 0.5)])
        for part, *row in zip(
            ("min", "mean", "max"), printed, whole, parts.min(0), parts.max(0), strict=True
        ):
            rows[case, part] = row
    return pd.DataFrame(rows, index=["published", "whole structure", "from", "to"]).T


def judged(table: pd.DataFrame) -> Values:
    """`table_values` as the ledger has them."""
    return {
        f"motion.table-4-1.{key(case)}.{part}": (row["whole structure"], (row["from"], row["to"]))
        for (case, part), row in table.iterrows()
    }


def table_statements(study: LocationStudy) -> dict[str, bool]:
    """Whether one run of Table 4.1's cases says what section 4.2.5 says of it."""
    size = {name: study.rms(name) for name in CASES}
    mean = {name: each.mean() for name, each in size.items()}
    time, start = study.setpoint.time, study.setpoint.acceleration_end
    settling = (time >= start) & (time < study.setpoint.scan[0])
    transient = {name: np.mean(study.errors[name][:, settling] ** 2) for name in ("MC", "MC, redesigned")}
    settled = {name: np.median(study.settled(name, SETTLED)) for name in ("original", "AD, redesigned")}
    damped = ("AD", "MC and AD")
    return {
        "damping-mean": all(mean[name] < mean["original"] for name in damped),
        "damping-variance": all(size[name].var() < size["original"].var() for name in damped),
        "compensation": mean["MC"] > mean["original"],
        "both-best": all(mean[f"MC and {name}"] < mean[name] for name in ("AD", "AD, redesigned")),
        "redesign": all(mean[f"{name}, redesigned"] < mean[name] for name in APPLICATIONS),
        "transient": transient["MC, redesigned"] < transient["MC"],
        "settling": settled["AD, redesigned"] < settled["original"],
    }


def statement_shares(quiet: LocationStudy, draws: Sequence[ErrorsByCase]) -> Values:
    """Each statement of section 4.2.5 as the ledger has it: the share of draws of the noise in which it holds."""
    said = [table_statements(quiet.noisy(each)) for each in draws]
    return {f"motion.section-4-2-5.{claim}": fraction([each[claim] for each in said]) for claim in said[0]}


def energy_values(quiet: LocationStudy, noisy: LocationStudy) -> Values:
    """Conclusion 5.7 as the ledger has it: how often the feedforward error outweighs the noise, over the cases."""
    shares = {case: np.mean(quiet.rms(case) ** 2) / np.mean(noisy.rms(case) ** 2) for case in CASES}
    outweighs = np.array(list(shares.values())) > 0.5
    return {"motion.conclusion-5-7.energy-outweighs-noise": float(outweighs.mean())}


@cache
def reduced_everywhere(masses: int) -> tuple[float, float]:
    """Share of the twenty-nine places of sensor and actuator where compliance lowers the model error at 10 Hz.

    Tenfold with that of all four discarded modes, and at all with that of the three of chapter 3.
    """
    plant, grid = structure(masses)
    low, tenfold, lowered = 2 * np.pi * np.array([10.0]), [], []
    for moves in ("sensor", "actuator"):
        for place in np.linspace(grid[0], grid[-1], 29):
            there = at_place(plant, grid, float(place), moves)
            exact = there.frequency_response(low)
            none, three, four = (
                np.abs(exact - truncate(there, 4, count).frequency_response(low)).max() for count in (0, 3, 4)
            )
            tenfold.append(four < 0.1 * none)
            lowered.append(three < none)
    return float(np.mean(tenfold)), float(np.mean(lowered))


def location_loops(
    plant: ModalModel, grid: ArrayLike, places: ArrayLike, cases: Mapping[str, tuple[str | Design, Pid]]
) -> dict[float, dict[str, StateModel]]:
    """Closed loops of every case at every place, with the observer of that place.

    The sensor stands still at each place; `cases` hold a design, or its name in `DESIGNS`, and the controller.
    """
    places = np.asarray(places, float)
    designs = {name: DESIGNS[d] if isinstance(d, str) else d for name, (d, _) in cases.items()}
    controllers = {name: controller.state_space() for name, (_, controller) in cases.items()}
    found = {}
    for place in places.tolist():
        machine = at_place(plant, grid, place)
        blocks = {design: compensator_at(plant, grid, place, design) for design in set(designs.values())}
        found[place] = {
            name: closed_loop(machine, blocks[designs[name]], controllers[name]) for name in cases
        }
        for name, loop in found[place].items():
            try:
                require_stable(loop)
            except InputError as error:
                raise InputError(f"{name} at {place:g} m: {error}") from None
    return found


def study_locations(loops: Loops, force: Force, setpoint: Setpoint, source: str = "w") -> LocationStudy:
    """Send the same force into the loops of every place, without noise.

    The force is a feedforward error, ideal less applied: the plant gets that much too little. Through ``w`` the
    observer does not see it, through ``u_ff`` it does.
    """
    ahead = len(force.time) - len(setpoint.time)
    errors = {
        name: -np.array(
            [
                simulate(zoh(channel(loop, source, "e_true"), setpoint.sample_time), force.values[None])[
                    0, ahead:
                ]
                for loop in each
            ]
        )
        for name, each in _by_case(loops).items()
    }
    return LocationStudy(np.array(list(loops)), setpoint, errors)


def _by_case(loops: Loops) -> dict[str, list[StateModel]]:
    return {name: [cases[name] for cases in loops.values()] for name in next(iter(loops.values()), ())}


def location_noise(
    loops: Loops, setpoint: Setpoint, deviations: dict[str, float], seeds: Sequence
) -> list[ErrorsByCase]:
    """What noise of these deviations adds to the errors, for each seed: fresh at every place, the same for all cases."""
    samples = WARM_UP + len(setpoint.time)
    starts = np.array([np.random.default_rng(seed).integers(2**63, size=len(loops)) for seed in seeds])
    found = {}
    for name, each in _by_case(loops).items():
        drawn = (map(np.random.default_rng, row) for row in starts.T)  # a row a place
        noises = [
            noise_errors(loop, setpoint.sample_time, samples, deviations, list(draws))
            for loop, draws in zip(each, drawn, strict=True)
        ]
        found[name] = np.array([[run[0, WARM_UP:] for run in runs] for runs in noises])
    return [{name: each[:, run] for name, each in found.items()} for run in range(len(seeds))]


def ranges(places: ArrayLike, shortest: float, points: int = 11) -> Float64[np.ndarray, "ranges 2"]:
    """All ranges (m) between `points` equally spaced places of the structure, of at least `shortest` of its length."""
    places = np.asarray(places, float)
    ends = np.linspace(places[0], places[-1], points)
    low, high = np.meshgrid(ends, ends, indexing="ij")
    wide = high - low >= shortest * (ends[-1] - ends[0]) * (1 - 1e-9)
    return np.stack([low[wide], high[wide]], axis=1)


def stage_error(setpoint: Setpoint, controller: Pid, noise: ArrayLike | None = None) -> Force:
    """Feedforward error of the stage with the fifth mass measured: ideal force less the gains fitted without observer.

    The gains leave the smallest sum of squared errors over the move; with `noise` of the measured error (m) they are
    fitted to a noisy one.
    """
    plant = stage().at([0], [4])
    loop = channel(closed_loop(plant, None, controller.state_space()), "w", "e_true")
    sampled, ideal = zoh(loop, setpoint.sample_time), sampled_ideal_force(plant, setpoint)
    left = [
        simulate(sampled, each[None])[0, -len(setpoint.time) :] for each in (ideal.values, *ideal.derivatives)
    ]
    wanted = left[0] if noise is None else left[0] + np.asarray(noise, float)
    gains = least_squares(np.array(left[1:]).T, wanted)
    return feedforward_error(ideal, Feedforward(**dict(zip(BASIS, gains, strict=True))))


# === Location pictures ============================================================================================
# Tracking errors over the places of the sensor, Table 4.1 and its figures (notebook 16).


def paint_location_errors(study: LocationStudy, cases: Sequence[str]):
    """Tracking errors, a row a case: at the places of the largest and of the smallest rms, over the band of all (Figs 4.10, 4.11).

    Red: the printed rms of Table 4.1, over the scan that it belongs to.
    """
    figure, axes = figures.new(len(cases), 2, height=5.4, sharex=True, sharey="row")
    time = study.setpoint.time
    pixel = max(round(5e-4 / study.setpoint.sample_time), 1)  # samples of one
    starts = np.arange(0, len(time), pixel)
    for row, case in zip(axes, cases, strict=True):
        errors, size = 1e9 * study.errors[case], 1e9 * study.rms(case)
        band = [each.reduceat(each.reduce(errors, axis=0), starts) for each in (np.minimum, np.maximum)]
        ends = zip(row, ("largest", "smallest"), (size.argmax(), size.argmin()), (2, 0), strict=True)
        for axis, word, k, column in ends:
            printed = PUBLISHED[case][column]
            shade = {"color": figures.GREY, "alpha": 0.35, "linewidth": 0, "label": "all places"}
            axis.fill_between(time[starts], *band, **shade)
            axis.plot(time, errors[k], color=figures.BLUE, linewidth=0.5, label="one place")
            for edge in (study.setpoint.acceleration_end, study.setpoint.scan[1]):
                line = axis.axvline(edge, color=figures.BLACK, linewidth=0.8)
            line.set_label("constant velocity between")
            level = {"color": figures.RED, "linewidth": 1.2, "label": "printed rms"}
            axis.plot(study.setpoint.scan, [printed] * 2, **level)
            title = f"{case}, {word} rms {size[k]:.1f} nm (printed {printed:.1f}), {study.places[k]:.2f} m"
            axis.set_title(title, fontsize=7)
    figures.legend_below(axes[0, 0], 4, fontsize=7)
    figures.label(axes, "time (s)", "error (nm)")
    return figure


def paint_rms_along(study: LocationStudy, cases: Sequence[str]):
    """Rms error in the scan over the place; dashed with a redesigned controller."""
    figure, axis = figures.new(1, 1, height=3.2)
    styles = case_styles(cases)
    styles["AD"] = styles.get("AD", {}) | {"linewidth": 3.5}  # MC and AD lies on it
    for case in cases:
        axis.semilogy(
            study.places, 1e9 * study.rms(case), label=case, **{"linewidth": 1.2} | styles.get(case, {})
        )
    axis.set(xlabel="place of the sensor (m)", ylabel="rms error in the scan (nm)")
    plain_numbers(axis.yaxis)
    axis.legend(ncols=3, fontsize=7, loc="upper center")
    return figure


def paint_table_of_ranges(table: pd.DataFrame):
    """Smallest, mean and largest rms error (nm) of every case, their spread over the ranges, and the published values."""
    figure, axis = figures.new(1, 1, height=3.4)
    parts = (("min", -0.22, figures.GREEN), ("mean", 0.0, figures.BLUE), ("max", 0.22, figures.RED))
    for part, offset, colour in parts:
        rows, name = table.xs(part, level=1), {"min": "smallest", "max": "largest"}.get(part, part)
        place = np.arange(len(rows)) + offset
        bars = {"color": colour, "linewidth": 4, "alpha": 0.4, "label": f"{name}, over the ranges"}
        axis.vlines(place, rows["from"], rows["to"], **bars)
        middle = {"color": colour, "markersize": 9, "label": f"{name}, whole structure"}
        axis.plot(place, rows["whole structure"].to_numpy(), "_", **middle)
        label = "published" if part == "min" else None
        figures.mark_published(axis, place, rows["published"].to_numpy(), label=label)
    axis.set_yscale("log")
    names = [name.replace(", ", ",\n") for name in CASES]
    axis.set_xticks(np.arange(len(names)), names, fontsize=7)
    axis.set(ylabel="rms error in the scan (nm)", ylim=(0.3, None))
    axis.legend(ncols=3, fontsize=7, loc="lower left")
    return figure


@cache
def _explored() -> tuple[Setpoint, Force]:
    setpoint = published_setpoint(2e-4)
    return setpoint, stage_error(setpoint, PidFamily(stage_mass())(35.6))


def paint_location(place: float, damping: float, compensate: str, bandwidth_hz: float):
    """Explorer: the tracking error at one place under the feedforward error, bare and with an observer."""
    setpoint, force = _explored()
    controller = PidFamily(stage_mass())(bandwidth_hz)
    cases = {"no observer": (Design(), controller)}
    if damping or compensate == "yes":
        application = Application(compensate == "yes", damping, selectivity=2.0 if damping else None)
        cases["observer"] = (Design(application, 0.03), controller)
    study = study_locations(location_loops(stage(), stage_grid(), [place], cases), force, setpoint)
    labels = {name: f"{name}: {1e9 * study.rms(name)[0]:.2f} nm rms in the scan" for name in cases}
    return paint_errors(setpoint, {labels[name]: study.errors[name][0] for name in cases})


PUBLISHED = {  # Table 4.1: smallest, mean and largest rms error, nm
    "original": (9.3667, 14.4019, 26.3194),
    "MC": (10.1388, 16.8212, 27.862),
    "AD": (3.3719, 4.5046, 5.7045),
    "MC and AD": (2.9148, 4.3243, 5.6566),
    "MC, redesigned": (9.75, 16.4307, 27.7159),
    "AD, redesigned": (1.4313, 1.8152, 3.0211),
    "MC and AD, redesigned": (1.4351, 1.6847, 2.1225),
}


def paint_force(force: Force, setpoint: Setpoint):
    """Fig. 4.9: the feedforward error on the axis of the published figure."""
    figure, axis = figures.new(1, 1, height=2.6)
    held = f"held for {1e3 * setpoint.sample_time:g} ms"
    axis.plot(force.time, force.values, linewidth=0.9, label=held)
    for edge in (setpoint.acceleration_end, setpoint.scan[1]):
        line = axis.axvline(edge, color=figures.BLACK, linewidth=0.8)
    line.set_label("constant velocity between")
    shade = {"color": figures.GREY, "alpha": 0.15, "linewidth": 0, "label": "axis of the published figure"}
    axis.axhspan(-AXIS_N, AXIS_N, **shade)
    axis.set(xlabel="time (s)", ylabel="feedforward error (N)")
    axis.legend(ncols=2, fontsize=7, loc="upper center")
    return figure


# === The appendix =================================================================================================


def appendix(
    page, *, table: pd.DataFrame, quiet: LocationStudy, study: LocationStudy, force: Force, **settings
) -> None:
    """What the page of motion/16 judges beside its answer; `settings` are parameters of the notebook."""
    masses, sample_time, seed = (settings[name] for name in ("masses", "sample_time", "seed"))
    page.text("""## The feedforward error

It is largest where the snap jumps (Fig. 4.9), because a snap term cannot replace the compliance of five springs. Largest (N), by
sample rate:""")
    peak = np.abs(force.values).max()
    page.check("motion.fig-4-9.peak", peak)
    page.check("motion.fig-4-9.axis", float(peak <= AXIS_N))
    held = {f"{rate} kHz": table_force(*settings["fit"], 1e-3 / rate, seed) for rate in (5, 10, 20)}
    page.show(pd.Series({name: np.abs(each.values).max() for name, each in held.items()}).round(1))
    page.text("""## Conclusion 2.2

The reduction of chapter 2 remains valid where sensor or actuator moves. We count the places where the compliance of the discarded
modes lowers the model's error at 10 Hz: tenfold with all four, at all with the three of chapter 3.""")
    tenfold, lowered = reduced_everywhere(masses)
    page.check("motion.conclusion-2-2.every-place", tenfold)
    page.check("motion.conclusion-2-2.three-modes", lowered)
    names = list(CASES)
    page.text("## Redesigned controllers (Fig. 4.11), and the error along the structure")
    page.save("fig-4-11", paint_location_errors(study, [names[0], *names[4:]]))
    page.save("along", paint_rms_along(study, names))
    page.text("""## Table 4.1 in numbers (nm)

Of one run: over the whole structure, and from least to most over all parts of at least half of it.""")
    page.show(table.round(2))
    page.text("""## What the text says

The fraction of runs with other noise in which each statement holds at the masses (every fourth place).""")
    draws = sentence_noise(masses, sample_time, seed, settings["noise"], settings["runs"])
    for claim, (ours, interval) in statement_shares(quiet.every_fourth(), draws).items():
        page.check(claim, ours, interval)
    _of_the_energy(page, quiet, study)


def _of_the_energy(page, quiet: LocationStudy, study: LocationStudy) -> None:
    page.text("""## Conclusion 5.7

Disturbances of bounded energy are what matters. Share of the mean square error that the feedforward error makes, then the time
until the error stays within 20 nm, from the end of the acceleration (ms):""")
    for claim, ours in energy_values(quiet, study).items():
        page.check(claim, ours)
    part = {name: np.mean(quiet.rms(name) ** 2) / np.mean(study.rms(name) ** 2) for name in CASES}
    page.show(100 * pd.Series(part), float_format="{:.0f} %".format)
    damped = [share for name, share in part.items() if "AD" in name]
    others = [share for name, share in part.items() if "AD" not in name]
    page.check("motion.conclusion-5-7.statements", float(min(others) > 0.9 and max(damped) < 0.25))
    settled = {name: 1e3 * np.quantile(study.settled(name, SETTLED), [0, 0.5, 1]) for name in CASES}
    page.show(pd.DataFrame(settled, index=["smallest", "median", "largest"]).T.round(1))


# --- Section 4.2.5: Table 4.1 ------------------------------------------------------------------------------------


CHANNELS = {"seen by the observer": "u_ff", "unseen": "w"}


def locations(
    *,
    error_channel: str,
    location_noise: bool,
    location_masses: int,
    gains_from: str,
    gains_in: str,
    location_sample_time: float,
    seed: int,
) -> Values:
    """Table 4.1 (nm), one draw of the noise and its spread over ranges of the places; it has no fast variant."""
    case = gains_from, gains_in, location_sample_time, seed
    study = quiet_table(CHANNELS[error_channel], location_masses, *case)
    if location_noise:
        study = study.noisy(table_noise(location_masses, location_sample_time, seed))
    return judged(table_values(study))


def location_sentences(
    *,
    error_channel: str,
    location_noise: bool,
    location_masses: int,
    gains_from: str,
    gains_in: str,
    location_sample_time: float,
    seed: int,
) -> Values:
    """What the text says of Table 4.1 and Fig. 4.9, and Conclusion 2.2 at these places; it has no fast variant."""
    case = gains_from, gains_in, location_sample_time, seed
    quiet = quiet_table(CHANNELS[error_channel], location_masses, *case).every_fourth()
    draws = sentence_noise(location_masses, location_sample_time, seed, location_noise, RUNS)
    return statement_shares(quiet, draws) | {
        "motion.fig-4-9.axis": float(np.abs(table_force(*case).values).max() <= AXIS_N),
        "motion.conclusion-2-2.every-place": reduced_everywhere(location_masses)[0],
    }


@lru_cache(maxsize=4)
def sentence_noise(masses: int, sample_time: float, seed: int, noise: bool, runs: int) -> list[ErrorsByCase]:
    """What several draws of the noise add at every fourth place; without `noise` nothing."""
    loops = table_loops(masses)
    fewer = {place: loops[place] for place in list(loops)[::4]}
    sizes = {name: noise * size for name, size in published_deviations().items()}
    seeds = [(seed, run) for run in range(runs)]
    return location_noise(fewer, published_setpoint(sample_time), sizes, seeds)


def bounded_energy(
    *,
    error_channel: str,
    location_masses: int,
    gains_from: str,
    gains_in: str,
    location_sample_time: float,
    seed: int,
) -> Values:
    """Conclusion 5.7 on the scans of Table 4.1; it has no fast variant."""
    case = location_masses, gains_from, gains_in, location_sample_time, seed
    quiet = quiet_table(CHANNELS[error_channel], *case)
    return energy_values(quiet, quiet.noisy(table_noise(location_masses, location_sample_time, seed)))
