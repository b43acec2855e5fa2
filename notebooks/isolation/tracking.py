"""Tracking a change of the floor: what this notebook alone needs."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64
from scipy import integrate, signal

from experiments.isolation.convergence import ALGORITHMS, COLOURS, STYLES
from experiments.isolation.floors import ShapedFloor, coloured_floor, flat_floor
from experiments.isolation.mean_convergence import mean_course
from experiments.isolation.shared_runs import study_each
from experiments.isolation.simulation import TOGETHER, sample_seeds, simulate_together
from experiments.isolation.steady import steady_state
from experiments.isolation.twin import Twin, load_twin
from stillwork.base.checks import InputError, require_choice
from stillwork.estimation.adaptive import FeLms, FeRls
from stillwork.estimation.mean_adaptation import Steady
from workbook import figures, paths
from workbook.choices.kept import wanted
from workbook.studies import Study, fraction

# === Tracking =====================================================================================================
# Response of the weights to a change of the floor (section 5.1.2, Fig. 6).


GROUPS = {"all": slice(0, 9), "w1-w3": slice(0, 3), "w4-w6": slice(3, 6), "w7-w9": slice(6, 9)}
LEAD_S = 30.0  # on the first floor, from its optimum: three memories of FeRLS, so that its noise has settled
SHARE = 0.37  # of the shift that is left after one time constant


@dataclass(frozen=True)
class Switch:
    """A change of the floor, and where the weights settle before and after it."""

    before: ShapedFloor
    after: ShapedFloor
    start: Steady  # oracle of the floor before, end: of that after
    end: Steady

    @property
    def shift(self) -> Float64[np.ndarray, " parameters"]:
        """Way of the first actuator's optimum."""
        return self.end.weights[0] - self.start.weights[0]


def switch_between(twin: Twin, before: ShapedFloor, after: ShapedFloor) -> Switch:
    """Switch of a twin from one floor to another."""
    return Switch(before, after, steady_state(twin, before), steady_state(twin, after))


def settled(switch: Switch, step_size: float, forgetting: float) -> dict[str, FeLms | FeRls]:
    """The two algorithms as they are after a long time on the first floor.

    P is given in full, so it is also its own start on the new floor; it may grow beyond its printed law only
    where the floor gets quieter by more than the limit of `FeRls`.
    """
    covariance = (1 - forgetting) * np.linalg.inv(switch.start.correlation)
    return {
        "FeLMS": FeLms(step_size=step_size),
        "FeRLS": FeRls((covariance + covariance.T) / 2, forgetting, growth_limit=np.inf),
    }


@dataclass(frozen=True)
class Response:
    """Course of the first actuator's weights around a switch at time zero."""

    time_s: Float64[np.ndarray, " kept"]  # from the switch on; negative before it
    weights: Float64[np.ndarray, "kept parameters"]
    switch: Switch

    def left(self, group: str = "all") -> Float64[np.ndarray, " kept"]:
        """Share of the shift still to go: projection of a group of weights on it, 1 before, 0 in the end."""
        rows = GROUPS[require_choice("group", group, GROUPS)]
        shift = self.switch.shift[rows]
        return (self.switch.end.weights[0, rows] - self.weights[:, rows]) @ shift / (shift @ shift)

    def settling_s(self, group: str = "all") -> float:
        """Time from which on a group stays within 37 % of the shift around its new optimum.

        The band has two sides, as in Table 1: an overshoot beyond 137 % of the shift has not settled. Infinite
        where the last tenth of the run still leaves the band: it is not known then whether it will stay.
        """
        after = self.time_s > 0
        time = self.time_s[after]
        late = np.flatnonzero(np.abs(self.left(group)[after]) > SHARE)
        if len(late) == 0:
            return float(time[0])
        return float(time[late[-1] + 1]) if time[late[-1]] <= 0.9 * time[-1] else np.inf

    @property
    def noise(self) -> float:
        """Noise of the parameters before the switch in units of the shift, standard deviation."""
        return float(self.left()[self.time_s <= 0].std())


def respond(
    twin: Twin, switch: Switch, both: dict[str, FeLms | FeRls], duration_s: float, seeds: Sequence[int]
) -> list[dict[str, Response]]:
    """Simulate a switch of the floor for each seed, the same for each of the `settled` algorithms."""
    runs = simulate_together(
        twin,
        [(LEAD_S, switch.before), (duration_s, switch.after)],
        adaptations=both,
        weights=switch.start.weights,
        seeds=seeds,
    )
    return [
        {
            name: Response(run.time_s - LEAD_S, np.ascontiguousarray(run.weights[:, 0]), switch)
            for name, run in each.items()
        }
        for each in runs
    ]


def noise_over_shift(twin: Twin, switch: Switch, forgetting: float, seed: int) -> float:
    """Noise of the FeRLS weights along the shift of the optimum, over the shift: rms over eight runs before the switch."""
    both = {"FeRLS": settled(switch, STEP_SIZE, forgetting)["FeRLS"]}
    runs = respond(twin, switch, both, 1.0, range(seed, seed + TOGETHER))
    late = [
        run["FeRLS"].left()[(run["FeRLS"].time_s > -LEAD_S / 2) & (run["FeRLS"].time_s <= 0)] for run in runs
    ]
    return float(np.sqrt(np.mean((np.array(late) - 1) ** 2)))


def averaged(
    twin: Twin, switch: Switch, both: dict, duration_s: float, seed: int, group: str
) -> tuple[float, float]:
    """Settling time (s) of the FeRLS weights' average over eight runs, and how far a group strays from it at the end.

    The latter is a standard deviation along the shift, over the shift.
    """
    seeds = range(seed, seed + TOGETHER)
    runs = [each["FeRLS"] for each in respond(twin, switch, {"FeRLS": both["FeRLS"]}, duration_s, seeds)]
    mean = Response(runs[0].time_s, np.mean([each.weights for each in runs], axis=0), switch)
    late = mean.time_s > duration_s / 2
    strays = np.array([each.left(group)[late] for each in runs]) - mean.left(group)[late]
    return mean.settling_s(group), float(np.sqrt(np.sum(strays**2) / strays[0].size / (TOGETHER - 1)))


def expected_response(twin: Twin, switch: Switch, name: str, step_size: float, memory_s: float) -> Response:
    """Mean course after a switch from the oracle, without noise and without simulation, for 20 minutes."""
    time = np.concatenate([np.arange(0.1, 60, 0.1), np.arange(60, 1200, 1.0)])
    course = mean_course(
        twin, switch.end, name, time, step_size=step_size, memory_s=memory_s, start=switch.start
    )
    return Response(time, course, switch)


def expected_responses(
    twin: Twin, switches: Mapping[str, Switch], step_size: float, memory_s: float
) -> dict[str, dict[str, Response]]:
    """`expected_response` by switch and algorithm."""
    moved = {"step_size": step_size, "memory_s": memory_s}
    return {
        title: {name: expected_response(twin, switch, name, **moved) for name in ALGORITHMS}
        for title, switch in switches.items()
    }


def gain_by_trace(correlation: np.ndarray) -> Float64[np.ndarray, " modes"]:
    """How much faster FeLMS learns each direction of the regressors than its mean course, the weakest direction first.

    (18) divides by the trace of each sample, the mean course by its mean. For Gaussian regressors with eigenvalues l of
    their correlation it is E[x_i^2 / x'x] over l_i / sum(l), with E[x_i^2 / x'x] the integral over t > 0 of
    l_i / (1 + 2 l_i t) / prod_j sqrt(1 + 2 l_j t).
    """
    share = np.linalg.eigvalsh(correlation) / np.trace(correlation)

    def slope(t: float) -> np.ndarray:
        return share / (1 + 2 * share * t) / np.prod(np.sqrt(1 + 2 * share * t))

    return integrate.quad_vec(slope, 0, np.inf)[0] / share


def tracking_trial(
    draws: Sequence[np.random.Generator], *, twin: Twin, switch: Switch, both: dict, duration_s: float
) -> list[dict[str, float]]:
    """One switch for each generator, for `study_each`: the algorithms of `both` on the same floor.

    ``"FeLMS all"``, ``"FeRLS w4-w6"``, ...: settling time of each group, s, infinite where it has not settled;
    ``"FeLMS noise"``, ...
    """
    seeds = sample_seeds(draws)
    return [
        settling_times(responses) | {f"{name} noise": each.noise for name, each in responses.items()}
        for responses in respond(twin, switch, both, duration_s, seeds)
    ]


def settling_times(responses: Mapping[str, Response]) -> dict[str, float]:
    """``"FeLMS all"``, ``"FeRLS w4-w6"``, ...: settling time of each group of weights, s."""
    return {f"{name} {group}": each.settling_s(group) for name, each in responses.items() for group in GROUPS}


# === Tracking pictures ============================================================================================
# Figures of the response to a change of the floor (Fig. 6).


# of each power of the integrator, the largest shift
SHOWN = {1: figures.BLUE, 5: figures.GREEN, 7: figures.RED}
MILLI = 1e3


def paint_switches(panels: Mapping[str, Mapping[str, Response]]):
    """Fig. 6: weights around a switch of the floor, as distances from their optimum before it."""
    figure, axes = figures.new(len(panels), 1, height=2.9 * len(panels), sharex=True, squeeze=False)
    for panel, (title, responses) in zip(axes[:, 0], panels.items(), strict=True):
        for name, response in responses.items():
            start = response.switch.start.weights[0]
            for row, color in SHOWN.items():
                way = MILLI * (response.weights[:, row] - start[row])
                label = f"w{row + 1}, {name}"
                panel.plot(response.time_s, way, STYLES[name], color=color, lw=1.0, label=label)
        for row, color in SHOWN.items():
            after = response.time_s > 0
            level = np.full(after.sum(), MILLI * response.switch.shift[row])
            panel.plot(response.time_s[after], level, ":", color=color, label=f"w{row + 1}, new optimum")
        panel.axvline(0, color=figures.BLACK, lw=0.8)
        panel.set_title(title)
    figures.label(axes, "time after the switch (s)", "w − optimum before\n(10⁻³ N per m/s²)")
    figures.legend_below(axes[0, 0], 3)
    return figure


def paint_settling(
    studies: Mapping[str, Study], expected: Mapping[str, Mapping[str, Response]], duration_s: float
):
    """Settling times of all weights and of each group: run by run, and of the noise-free mean course.

    A run that has not settled at its end `duration_s` is a triangle there: its time is longer, or endless.
    """
    figure, axes = figures.new(1, len(studies), height=3.6, sharey=True, squeeze=False)
    at = np.arange(len(GROUPS))
    for panel, (title, study) in zip(axes[0], studies.items(), strict=True):
        for shift, name in zip((-0.15, 0.15), ALGORITHMS, strict=True):
            color = COLOURS[name]
            times = np.array([study[f"{name} {group}"] for group in GROUPS]).ravel()
            places = np.repeat(at + shift, study.runs)
            ended = np.isfinite(times)
            panel.plot(places[ended], times[ended], "o", ms=3, color=color, alpha=0.6, label=f"{name}, runs")
            if not ended.all():
                # Side by side, or several would look like one.
                spread = places[~ended] + 0.04 * (np.arange(np.sum(~ended)) % 3 - 1)
                ends, label = np.full(len(spread), duration_s), f"{name}, not settled in {duration_s:g} s"
                panel.plot(spread, ends, "^", ms=5, color=color, mfc="none", label=label)
            means = [expected[title][name].settling_s(group) for group in GROUPS]
            panel.plot(at + shift, means, "_", ms=12, mew=2, color=color, label=f"{name}, mean course")
        panel.set_yscale("log")
        panel.set_xticks(at, list(GROUPS))
        panel.set_title(title)
    figures.label(axes, "weights", f"time to stay within {100 * SHARE:.0f} %\nof the shift (s)")
    # Of all panels, for an algorithm may leave runs unsettled in one of them only.
    entries = [panel.get_legend_handles_labels() for panel in axes[0]]
    named = {name: handle for handles, names in entries for handle, name in zip(handles, names, strict=True)}
    figure.legend(named.values(), named.keys(), loc="outside lower center", ncols=2)
    return figure


def expected_switch_painter(twin: Twin, switches: Mapping[str, Switch], duration_s: float) -> Callable:
    """Explorer: expected share of the shift still to go, all weights."""
    time = np.linspace(duration_s / 60, duration_s, 60)

    def paint(direction: str, step_size: float, memory_s: float):
        switch = switches[direction]
        figure, axes = figures.new(1, 1, height=3.2)
        for name in ALGORITHMS:
            moved = {"step_size": step_size, "memory_s": memory_s, "start": switch.start}
            left = Response(time, mean_course(twin, switch.end, name, time, **moved), switch).left()
            style = {"color": COLOURS[name], "label": name}
            axes.plot(np.append(0.0, time), np.append(1.0, left), STYLES[name], **style)
        axes.axhline(SHARE, color=figures.GREY, lw=0.8)
        axes.set(xlabel="time after the switch (s)", ylabel="share of the shift to go")
        axes.legend()
        return figure

    return paint


# === Open choices =================================================================================================


STEP_SIZE, MEMORY_S = 1e-4, 10.0  # section 5.1.1
TRACKED_S = 90.0  # s after a switch
QUIET = 1e-5  # m/s^2/sqrt(Hz), output noise of notebook 03's twin
RUNS = 40  # repetitions: fewer than 36 leave the interval of a share of one below the threshold of 0.9


@dataclass(frozen=True)
class Switched:
    """Runs of one switch of the floor: settling times by algorithm and group of weights, s."""

    switch: Switch
    study: Study

    def gain(self, group: str = "all") -> Float64[np.ndarray, " runs"]:
        """FeLMS over FeRLS settling time; NaN where neither has settled."""
        with np.errstate(invalid="ignore"):
            return self.study[f"FeLMS {group}"] / self.study[f"FeRLS {group}"]

    def median_gain(self) -> float:
        """Of all weights; raises `InputError` where too few runs have settled for it."""
        with np.errstate(invalid="ignore"):
            gain = float(np.median(self.gain()))
        if not np.isfinite(gain):
            raise InputError(
                "half of the runs have not settled: lower platform_noise, which hides the change, or raise duration_s"
            )
        return gain

    def felms_first(self, group: str = "all") -> np.ndarray:
        """Runs in which FeLMS has settled, and no later than FeRLS."""
        felms, ferls = (self.study[f"{name} {group}"] for name in ALGORITHMS)
        return np.isfinite(felms) & (felms <= ferls)


def quiet_twin(platform_noise: float = QUIET) -> Twin:
    """The fitted twin with a quiet output."""
    return load_twin("fitted").varied(platform_noise=platform_noise)


def switch_runs(
    *, trace: str = "regressors", step_size: float = STEP_SIZE, memory_s: float = MEMORY_S, **common
) -> tuple[Switched, Switched]:
    """Runs from flat to coloured, and from coloured to flat, of both algorithms on the same floors and noises.

    `common` are the other arguments of `one_switch`.
    """
    step = step_size / (quiet_twin().actuators if trace == "literal" else 1)
    into, back = (one_switch(back, step_size=step, memory_s=memory_s, **common) for back in (False, True))
    return into, back


def one_switch(
    back: bool,
    *,
    low_pass_hz: float = 80.0,
    colour_gain: float = 4.0,
    seed: int,
    runs: int = RUNS,
    platform_noise: float = QUIET,
    step_size: float = STEP_SIZE,
    memory_s: float = MEMORY_S,
    duration_s: float = TRACKED_S,
) -> Switched:
    """Runs of both algorithms from flat to coloured, or `back`."""
    twin = quiet_twin(platform_noise)
    floors = [flat_floor(low_pass_hz), coloured_floor(low_pass_hz, gain=colour_gain)]
    switch = switch_between(twin, *(reversed(floors) if back else floors))
    both = settled(switch, step_size, float(np.exp(-twin.sample_time / memory_s)))
    cases = {("FeLMS", step_size): both["FeLMS"], ("FeRLS", memory_s): both["FeRLS"]}
    where = back, low_pass_hz, colour_gain, platform_noise, duration_s
    settings = {"twin": twin, "switch": switch, "duration_s": duration_s}
    felms, ferls = study_each(tracking_trial, cases, where, runs, seed, **settings)
    return Switched(switch, Study(seed, {**felms.values, **ferls.values}))


def follow(
    *, trace: str, floor_upper_end: float, colour_gain: float, seed: int
) -> dict[str, tuple[float, tuple[float, float]]]:
    """Fig. 6 by `RUNS` runs each way, as notebook 03 judges it."""
    return judged(*switch_runs(trace=trace, low_pass_hz=floor_upper_end, colour_gain=colour_gain, seed=seed))


WAYS = "(a) flat to coloured", "(b) coloured to flat"


def judged(into: Switched, back: Switched) -> dict[str, tuple[float, tuple[float, float]]]:
    """Share of the runs that obey each statement of section 5.1.2, with its interval."""
    with np.errstate(invalid="ignore"):
        shrinks = back.gain() < into.gain()
    obeyed = {
        "flat-to-coloured": into.gain() > 1,
        "coloured-to-flat": back.felms_first(),
        "coloured-to-flat-w4-w6": back.felms_first("w4-w6"),
        "benefit-shrinks": shrinks,
    }
    return {f"isolation.tracking.{entry}": fraction(each) for entry, each in obeyed.items()}


# === A slow floor =================================================================================================


MICROSEISM_HZ, MICROSEISM_DAMPING, WATCHED_S = 0.2, 0.1, 40.0
PATH_DELAY, EQUAL_S, REMAINS = 2, 60.0, 0.1  # samples; of the runs at equal power: s, and share


class SlowRun(NamedTuple):
    """FeRLS on a floor with slow motion, from the optimum of the floor without it."""

    seconds: float  # until it broke, or of the run
    broke: bool
    off: float  # distance from the start over its norm, mean over the second half of the run


def with_microseism(floor: ShapedFloor, times: float) -> ShapedFloor:
    """A floor with a narrow peak at `MICROSEISM_HZ` of so many times the density of its plateau, which has a gain of one.

    Four biquads (s^2 + 2 d g w s + w^2) / (s^2 + 2 d w s + w^2), each of gain g at w, where they take the floor's own gain up
    to the square root of `times`; far above w they are one. One alone would have skirts that fill the band.
    """
    w, rate = 2 * np.pi * MICROSEISM_HZ, floor.sample_rate
    own = [np.abs(signal.freqz_sos(rows, [MICROSEISM_HZ], fs=rate)[1].item()) for rows in floor.sections]
    width = 2 * MICROSEISM_DAMPING * w
    peaks = [
        np.hstack(
            signal.bilinear([1, width * (np.sqrt(times) / gain) ** 0.25, w * w], [1, width, w * w], rate)
        )
        for gain in own
    ]
    four = np.repeat(np.array(peaks)[:, None], 4, axis=1)
    return ShapedFloor(np.concatenate([floor.sections, four], axis=1), floor.scale, rate)


def on_slow_floor(
    twin: Twin, floor: ShapedFloor, slow: ShapedFloor, forgetting: float, path_delay: int | None, seed: int
) -> SlowRun:
    """FeRLS on the `slow` floor from its settled state on the other one; without a `path_delay` by the published error."""
    steady = steady_state(twin, floor, forgetting=forgetting)
    settings = FeRls(steady.covariance, forgetting, growth_limit=np.inf, path_delay=path_delay)
    options = {"weights": steady.weights, "seeds": [seed], "to_the_break": True}
    run = simulate_together(twin, [(WATCHED_S, slow)], adaptations={"": settings}, **options)[0][""]
    late = run.weights[len(run.weights) // 2 :] - steady.weights
    off = np.linalg.norm(late, axis=(1, 2)).mean() / np.linalg.norm(steady.weights) if len(late) else np.inf
    return SlowRun(run.broke_s or WATCHED_S, run.broke_s is not None, float(off))


def at_equal_power(twin: Twin, floor: ShapedFloor, step_size: float, memory_s: float, seed: int) -> float:
    """By how much FeRLS from its steady P settles sooner than FeLMS where both scatter alike, both by the modified error.

    They scatter by the power of N[(W - W*) psi] about the optimum W*, which falls as the memory of FeRLS grows from `memory_s`.
    A run has settled once a tenth of the power that zero weights leave remains: medians of eight runs.
    """

    def powers(memory: float, weights) -> dict[str, np.ndarray]:
        forgetting = float(np.exp(-twin.sample_time / memory))
        steady = steady_state(twin, floor, forgetting=forgetting)
        both = {
            "FeLMS": FeLms(step_size, path_delay=PATH_DELAY),
            "FeRLS": FeRls(steady.covariance, forgetting, growth_limit=np.inf, path_delay=PATH_DELAY),
        }
        seeds = range(seed, seed + TOGETHER)
        runs = simulate_together(twin, floor, EQUAL_S, adaptations=both, weights=weights, seeds=seeds)
        found = {}
        for name in both:
            off = np.array([run[name].weights[:, 0] for run in runs]) - steady.weights[0]
            found[name] = np.einsum("rti,ij,rtj->rt", off, steady.correlation, off)
        return found

    weights = steady_state(twin, floor).weights
    scatter = {name: rows[:, rows.shape[1] // 2 :].mean() for name, rows in powers(memory_s, weights).items()}
    equal = float(memory_s * scatter["FeRLS"] / scatter["FeLMS"])
    learning = powers(equal, 0 * weights)
    felms, ferls = (
        np.median([np.flatnonzero(row > REMAINS * row[0])[-1] + 1 for row in learning[name]])
        for name in ALGORITHMS
    )
    return float(felms / ferls)


# === Appendix =====================================================================================================


def appendix(
    page,
    *,
    noisy: Twin,
    switches: Mapping[str, Switch],
    lost: Switch,
    duration_s: float,
    settings: tuple[float, float, float],
    seed: int,
) -> None:
    """What this notebook judges beside its answer.

    Parameters
    ----------
    page : workbook.appendix.Appendix
    noisy : Twin
        The fitted twin with the output noise of Fig. 8.
    switches : mapping of str to Switch
        By title; `lost` is that of `noisy`.
    duration_s : float
    settings : tuple of float
        Step size, forgetting factor, and output noise of the quiet twin.
    seed : int
    """
    step_size, forgetting, platform_noise = settings
    rigid = load_twin("rigid_body").varied(platform_noise=platform_noise)
    first = next(iter(switches.values()))
    page.text("""## The rigid body, and the noisy output

The rigid body responds alike. With the output noise of Fig. 8 the noise hides the change of the floor: the fitted model then
gives Table 1 but not Fig. 6; without that noise, Fig. 6 but far less power than Fig. 8.""")
    others = {
        "rigid body, flat to coloured": switch_between(rigid, first.before, first.after),
        "fitted, output noise of Fig. 8, flat to coloured": lost,
    }
    found = {
        title: respond(model, switch, settled(switch, step_size, forgetting), duration_s, [seed])[0]
        for (title, switch), model in zip(others.items(), (rigid, noisy), strict=True)
    }
    page.save("fig-6-other-twins", paint_switches(found))
    moved = [np.abs(each.shift).max() for each in (*switches.values(), *others.values())]
    page.check("isolation.tracking.largest-shift", max(moved))
    page.text("""## Under other choices

Which number agrees under which of these choices and not under every one (`data/isolation/settings.csv`):""")
    page.show(
        *wanted(
            paths.data("isolation", "settings.csv"),
            ("trace", "colour-gain", "floor-upper-end"),
            never=("tracking",),
        )
    )
