"""Contraction, filters' responses, stability, limit cycles, divergence: what notebook 06 alone needs."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from experiments.fixedpoint.axes import COLOURS, legend_above
from experiments.fixedpoint.convergence_study import at_rest, remaining_motion
from experiments.fixedpoint.oscillator import load_oscillator, restoring_force
from experiments.fixedpoint.published import (
    INTEGRATION,
    KALMAN,
    LITERAL,
    LOW_PASS,
    WINDOW,
    published_controllers,
)
from stillwork.control.fixed_point import Controller, simulate
from stillwork.control.fixed_point_convergence import (
    LimitCycle,
    StableRange,
    describing_function,
    iterate,
    limit_cycles,
    stable_range,
    strongest_oscillation,
)
from stillwork.control.fixed_point_linear import LinearFilter, LinearLoop, linear_loop
from stillwork.control.kinematics import KinematicDesign
from stillwork.control.trajectory import asin_trajectory
from stillwork.control.transformation import FlowTransformation, Transformation
from stillwork.estimation.coordinate_filters import MovingWindow
from stillwork.estimation.plant import Plant
from workbook import figures


def cycles_over_gain(
    plant: Plant,
    controller: Controller,
    strengths: Sequence[float] | np.ndarray,
    width: float,
    sample_time: float,
) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
    """Predicted and simulated limit cycle for each -A: frequency in Hz, amplitude in m/s^2; NaN without one."""
    predicted, simulated = [], []
    loop = linear_loop(plant, controller, sample_time, integration=INTEGRATION)
    for strength in strengths:
        transformation = FlowTransformation(-strength, width)
        stable = [cycle for cycle in limit_cycles(loop, transformation) if cycle.stable]
        predicted.append((stable[0].frequency_hz, stable[0].iteration_error) if stable else (np.nan, np.nan))
        found = simulated_cycle(plant, replace(controller, transformation=transformation), sample_time)
        simulated.append((found.frequency_hz, found.amplitude))
    return predicted, simulated


def simulated_cycle(plant: Plant, controller: Controller, sample_time: float):
    """The strongest oscillation of response less desired, four to eight seconds after a kick at rest."""
    still = at_rest(round(8 / sample_time), sample_time)
    run = simulate(plant, controller, still, start=(0.0, 1e-3), integration=INTEGRATION)
    tail = slice(round(4 / sample_time), None)
    return strongest_oscillation(run.acceleration_estimate[tail] - run.desired[tail], sample_time)


def after_a_kick(
    plant: Plant, controllers: dict[str, Controller], transformation: Transformation, sample_time: float
) -> tuple[list[str], list[str]]:
    """With which of the paper's filters a kick at rest grows or stays under a transformation, and with which it dies."""
    left = {
        name: remaining_motion(
            plant, replace(controllers[name], transformation=transformation), 1e-3, sample_time
        )
        for name in (WINDOW, LOW_PASS, KALMAN)
    }
    kept = [f"the {name}" for name, share in left.items() if share > 1]
    return kept, [f"the {name}" for name, share in left.items() if not share > 1]


SMALL = {"textcoords": "offset points", "fontsize": 7}  # words beside a mark
BLANK = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}  # no line runs through the words


def paint_contraction(transformations: dict[str, Transformation], response_gain: float):
    """Error of the static iteration, step by step, and its multiplier against the size of the error."""
    figure, (decay, multiplier) = figures.new(1, 2, height=3.0)

    def errors(transformation, start, count):
        found = iterate(transformation, 0.0, count, response_gain=response_gain, start=start / response_gain)
        return found * response_gain

    colours = (figures.BLUE, figures.GREEN)
    for (name, transformation), colour in zip(transformations.items(), colours, strict=False):
        for start, line in ((1.0, "-"), (30.0, "--")):
            sizes = np.abs(errors(transformation, start, 40))
            decay.semilogy(sizes, line, color=colour, label=f"{name}, start {start:g} m/s²")
        sizes = np.geomspace(1e-2, 1e3, 60)
        ratio = [errors(transformation, size, 2)[1] / size for size in sizes]
        multiplier.semilogx(sizes, ratio, color=colour, label=name)
    decay.set(xlabel="iteration", ylabel="|response − desired| (m/s²)", ylim=(1e-4, 60))
    decay.set_title("static iteration")
    figure.legend(handles=decay.lines, loc="outside upper center", ncols=2)
    multiplier.set(xlabel="|response − desired| (m/s²)", ylabel="ratio of two errors", ylim=(0, 1.05))
    multiplier.set_title("multiplier: below 1 contracts")
    multiplier.legend()
    return figure


def paint_filter_responses(filters: dict[str, LinearFilter], sample_time: float, continuous):
    """Responses from the measured position to the three estimates, over the ideal derivatives; and of `continuous`, (7)."""
    figure, panels = figures.new(2, 3, height=5.2, sharex=True)
    frequency = np.geomspace(0.5, 499, 90)
    for name, device in filters.items():
        response = device.response(2 * np.pi * frequency, sample_time)
        line = {"ls": "--" if name == LITERAL else "-", "lw": 2.5 if name == LOW_PASS else 0.8}
        for column in range(3):
            ratio = response[:, column] / (2j * np.pi * frequency) ** column
            panels[0, column].loglog(frequency, np.abs(ratio), color=COLOURS[name], label=name, **line)
            angle = np.degrees(np.unwrap(np.angle(ratio)))
            panels[1, column].semilogx(frequency, angle, color=COLOURS[name], label=name, **line)
    ideal = continuous(2j * np.pi * frequency)  # the same for every derivative
    for column in range(3):
        style = {"color": figures.BLACK, "label": "(7), continuous"}
        panels[0, column].loglog(frequency, np.abs(ideal), ":", **style)
        panels[1, column].semilogx(frequency, np.degrees(np.unwrap(np.angle(ideal))), ":", **style)
    for column, title in enumerate(("estimate of q", "of q', over jω", "of q'', over (jω)²")):
        panels[0, column].set(title=title, ylim=(1e-3, 10))
        panels[1, column].set(xlabel="frequency (Hz)", ylim=(-400, 90))
    panels[0, 0].set_ylabel("gain")
    panels[1, 0].set_ylabel("phase (degrees)")
    legend_above(panels[0, 0], 3)
    return figure


def paint_stability_ranges(ranges: dict[str, StableRange], gains: dict[str, float], banach: float):
    """Stable local gains of every loop, the gain in use, and the edge that Banach's theorem gives."""
    figure, axes = figures.new(1, height=0.42 * len(ranges) + 1.5)
    for row, (name, region) in enumerate(ranges.items()):
        strong, weak = region.limits
        axes.plot([-strong, -weak], [row, row], "-", linewidth=7, color=COLOURS[name], alpha=0.5, label=name)
        axes.plot(-gains[name], row, "k|", markersize=16, markeredgewidth=2.5, label=f"_gain in use, {name}")
        for crossing, side, away in ((region.strongest, "left", 4), (region.weakest, "right", -4)):
            look = {"ha": side, "va": "center", "xytext": (away, 0), "bbox": BLANK, **SMALL}
            axes.annotate(f"{crossing.frequency_hz:.0f} Hz", (-crossing.local_gain, row), **look)
    [bar] = axes.plot([], [], color=figures.GREY, lw=7, alpha=0.5, label="the linear loop is stable")
    [tick] = axes.plot([], [], "k|", markersize=10, markeredgewidth=2.5, label="gain in use")
    edge = axes.axvline(-banach, color=figures.BLACK, ls=":", lw=1, label="limit without a filter (Banach)")
    axes.set_yticks(range(len(ranges)), list(ranges))
    axes.set(xscale="log", xlabel="strength of the transformation, −g", xlim=(6e-3, 4))
    axes.set_ylim(len(ranges) - 0.4, -0.6)
    figure.legend(handles=[bar, tick, edge], loc="outside upper center", ncols=3)
    return figure


def paint_limit_cycle_condition(
    loop: LinearLoop, transformation: FlowTransformation, cycles: list[LimitCycle]
):
    """The open loop's locus and the inverse of gain times describing function, which meet at `cycles`."""
    figure, axes = figures.new(1, height=4.0)
    frequency, marks = np.geomspace(3, 120, 180), np.array([5.0, 10.0, 20.0, 40.0, 80.0])
    locus, points = np.split(loop.response(2 * np.pi * np.append(frequency, marks)), [len(frequency)])
    axes.plot(locus.real, locus.imag, color=figures.BLUE, label="linear loop, 3 to 120 Hz")
    amplitude = np.geomspace(1e-2, 300, 60)
    inverse = np.array([1 / (transformation.local_gain * describing_function(a)) for a in amplitude])
    axes.plot(
        inverse, np.zeros_like(inverse), color=figures.RED, label="1 / (local gain × describing function)"
    )
    for hertz, point in zip(marks, points, strict=True):
        place, name = (point.real, point.imag), f"{hertz:g} Hz"
        axes.plot(*place, "o", color=figures.BLUE, markersize=4, label=name)
        side = {"xytext": (-5, 4), "ha": "right"} if hertz == 40.0 else {"xytext": (5, 3)}
        axes.annotate(name, place, textcoords="offset points", fontsize=8, **side)
    for size in (3, 10, 30, 100):
        place = 1 / (transformation.local_gain * describing_function(size / transformation.width)), 0
        axes.plot(*place, "s", color=figures.RED, markersize=4, label=f"error {size} m/s²")
        side = {"xytext": (4, 5), "ha": "left"} if size in (10, 100) else {"xytext": (0, -12), "ha": "center"}
        axes.annotate(f"{size} m/s²", place, **side, **SMALL)
    for cycle in cycles:
        place = 1 / (
            transformation.local_gain * describing_function(cycle.iteration_error / transformation.width)
        )
        name = f"{'stable' if cycle.stable else 'unstable'} limit cycle"
        look = {"ms": 11, "mew": 1.5, "color": figures.BLACK if cycle.stable else figures.GREY, "mfc": "none"}
        axes.plot(place, 0.0, "o", label=name, **look)
    axes.set(xlabel="real part", xlim=(-75, 10), ylabel="imaginary part", ylim=(-30, 30))
    named = ("linear", "1 /", "40 Hz", "error 30", "stable", "unstable")
    handles = [each for each in axes.lines if each.get_label().startswith(named)]
    words = [each.get_label() for each in handles]
    words[2:4] = "at this frequency", "at this amplitude of response − desired"
    figure.legend(handles, words, loc="outside upper center", ncols=2)
    return figure


def paint_limit_cycle_sweep(gains, predicted, simulated):
    """Frequency and amplitude of the limit cycle against the gain A: predicted lines (NaN: no cycle), simulated points."""
    figure, panels = figures.new(1, 2, height=3.0)
    titles = ("frequency (Hz)", "amplitude of response − desired (m/s²)")
    for column, (axes, title) in enumerate(zip(panels, titles, strict=True)):
        axes.plot(gains, [p[column] for p in predicted], color=figures.BLUE, label="describing function")
        axes.plot(gains, [s[column] for s in simulated], "o", ms=4, color=figures.RED, label="simulated")
        axes.axvline(1.1, color=figures.BLACK, linestyle=":", linewidth=1, label="printed −A")
        axes.set(xlabel="−A (m/s²)", ylabel=title)
    middle = np.nanmean([p[0] for p in predicted])
    panels[0].set_ylim(0.95 * middle, 1.05 * middle)
    panels[0].legend()
    return figure


def paint_limit_cycle(gain: float, window_length: int, exponent: float):
    """Where the window's loop and transformation (6) balance."""
    exact, approximate = (model.plant for model in load_oscillator().values())
    transformation, window = FlowTransformation(-gain), MovingWindow(int(window_length))
    controller = Controller(window, transformation, KinematicDesign(exponent), approximate)
    loop = linear_loop(exact, controller, 1e-3, integration=INTEGRATION)
    region = stable_range(loop)
    cycles = limit_cycles(loop, transformation, region)
    figure = paint_limit_cycle_condition(loop, transformation, cycles)
    said = [
        f"{c.frequency_hz:.1f} Hz at {c.iteration_error:.3g} m/s² ({'stable' if c.stable else 'unstable'})"
        for c in cycles
    ]
    low, high = region.limits
    figure.axes[0].set_title(
        f"stable gains {low:.3g} to {high:.3g}, here {transformation.local_gain:.3g}\n"
        f"cycles: {', '.join(said) or 'none'}"
    )
    return figure


# === What the notebook judges beside its answer =====================================================================


def appendix(page, *, sample_time: float) -> None:
    """What this notebook judges beside its answer."""
    page.text("""## "Slow parameters", (3)

The paper takes $q$ and $\\dot q$ as slow parameters of the response, because the command can jump and they cannot. Without noise, after
2 s, with the low pass: the RMS change of the fixed point $r_*$ in a sample that $q$ and $\\dot q$ cause, that of the desired
acceleration, and the RMS distance of the deformed acceleration from $r_*$.""")
    ratios = []
    for frequency in (0.1, 0.2, 0.5):
        moved, desired, apart = fixed_point_motion(frequency, sample_time)
        ratios.append(moved / desired)
        page.show(
            f"{frequency:g} Hz: by q and q' {moved:.4f} m/s² a sample, desired {desired:.4f}, distance {apart:.3f} m/s²"
        )
    page.check("fixedpoint.eq-3.slow", ratios[1], (min(ratios), max(ratios)))
    page.conclude(
        "Slow they are against the iteration, not against the desired acceleration: at 0.2 Hz they move the fixed point {ratio:.1f} times as "
        "far in a sample as it does ({low:.1f} to {high:.1f} times from 0.5 to 0.1 Hz).",
        "At 0.2 Hz they move the fixed point less than the desired acceleration does: {ratio:.1f} times as far in a sample ({low:.1f} to "
        "{high:.1f} times from 0.5 to 0.1 Hz).",
        when=ratios[1] > 1,
        ratio=ratios[1],
        low=min(ratios),
        high=max(ratios),
    )


def fixed_point_motion(frequency_hz: float, sample_time: float) -> tuple[float, float, float]:
    """RMS changes a sample of the fixed point by the state and by the desired acceleration, and of the distance to it, m/s^2.

    The command r gives m q'' = m^ r + h^(q, q') - h(q, q'), so q'' is the desired one at r = (m q''_D + h - h^) / m^.
    """
    models = load_oscillator()
    exact, approximate = (model.plant for model in models.values())
    controller = published_controllers(approximate)[LOW_PASS]
    trajectory = asin_trajectory(frequency_hz=frequency_hz, sample_time=sample_time)
    run = simulate(exact, controller, trajectory, integration=INTEGRATION)
    true, believed = (
        np.array(
            [restoring_force(q, v, plant.parameters) for q, v in zip(run.position, run.velocity, strict=True)]
        )
        for plant in (exact, approximate)
    )
    masses = models["exact"].mass, models["approximate"].mass
    state, desired = (true - believed) / masses[1], run.desired * masses[0] / masses[1]
    part = slice(round(2 / sample_time), None)
    apart = (run.deformed - state - desired)[part]
    return float(np.diff(state[part]).std()), float(np.diff(desired[part]).std()), float(apart.std())
