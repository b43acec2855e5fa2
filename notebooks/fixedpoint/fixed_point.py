"""Pictures of the iteration: contraction, filters' responses, stability, limit cycles."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from experiments.fixedpoint.axes import COLOURS, legend_above
from experiments.fixedpoint.convergence_study import at_rest
from experiments.fixedpoint.metrics import noisy_run
from experiments.fixedpoint.noise import Noise
from experiments.fixedpoint.oscillator import load_oscillator
from experiments.fixedpoint.published import INTEGRATION, LITERAL
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
from stillwork.control.transformation import FlowTransformation, Transformation
from stillwork.estimation.coordinate_filters import MovingWindow
from stillwork.estimation.plant import Plant
from workbook import figures


def cycles_over_gain(
    plant: Plant, controller: Controller, strengths: Sequence[float], width: float, sample_time: float
) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
    """Predicted and simulated limit cycle for each -A: frequency in Hz, amplitude in m/s^2; NaN without one."""
    predicted, simulated = [], []
    loop = linear_loop(plant, controller, sample_time, integration=INTEGRATION)
    for strength in strengths:
        transformation = FlowTransformation(-strength, width)
        stable = [cycle for cycle in limit_cycles(loop, transformation) if cycle.stable]
        predicted.append((stable[0].frequency_hz, stable[0].iteration_error) if stable else (np.nan, np.nan))
        moved = replace(controller, transformation=transformation)
        still = at_rest(round(8 / sample_time), sample_time)
        run = simulate(plant, moved, still, start=(0.0, 1e-3), integration=INTEGRATION)
        tail = slice(round(4 / sample_time), None)
        found = strongest_oscillation(run.acceleration_estimate[tail] - run.desired[tail], sample_time)
        simulated.append((found.frequency_hz, found.amplitude))
    return predicted, simulated


def divergence_by_noise(
    plant: Plant,
    controller: Controller,
    deviations: Sequence[float],
    runs: int,
    seed: int,
    sample_time: float = 1e-3,
) -> list[float]:
    """Fraction of runs of 12 s at rest that diverge, for each standard deviation of Gaussian noise."""
    still, streams = at_rest(round(12 / sample_time), sample_time), np.random.SeedSequence(seed).spawn(runs)

    def diverges(stream, deviation) -> bool:
        noise = Noise("gaussian", deviation)
        return noisy_run(plant, controller, still, noise, stream).diverged_at is not None

    return [sum(diverges(stream, deviation) for stream in streams) / runs for deviation in deviations]


def response_noise(
    plant: Plant, controller: Controller, deviation: float, seed: int, sample_time: float = 1e-3
) -> float:
    """Standard deviation of response - desired at rest in Gaussian noise, m/s^2; 5 s after the first."""
    still = at_rest(round(6 / sample_time), sample_time)
    run = noisy_run(plant, controller, still, Noise("gaussian", deviation), seed)
    return float(np.std((run.acceleration_estimate - run.desired)[round(1 / sample_time) :]))


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


def paint_filter_responses(filters: dict[str, LinearFilter], sample_time: float):
    """Frequency responses from the measured position to the three estimates, over the ideal derivatives."""
    figure, panels = figures.new(2, 3, height=5.2, sharex=True)
    frequency = np.geomspace(0.5, 499, 90)
    for name, device in filters.items():
        response = device.response(2 * np.pi * frequency, sample_time)
        line = "--" if name == LITERAL else "-"  # in places it covers its neighbour
        for column in range(3):
            ratio = response[:, column] / (2j * np.pi * frequency) ** column
            panels[0, column].loglog(frequency, np.abs(ratio), line, color=COLOURS[name], label=name)
            angle = np.degrees(np.unwrap(np.angle(ratio)))
            panels[1, column].semilogx(frequency, angle, line, color=COLOURS[name], label=name)
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


def paint_noise_gain(deviations, remaining, weakest: float, marks: dict[str, float]):
    """What noise in the response leaves of transformation (6)'s gain, and the least that the loop needs."""
    figure, axes = figures.new(1, height=3.0)
    axes.loglog(deviations, remaining, color=figures.BLUE, label="mean gain that noise leaves")
    axes.axhline(weakest, color=figures.RED, linestyle="--")
    needed = "the Kalman loop needs at least this"
    axes.text(deviations[0], weakest * 1.08, needed, fontsize=8, color=figures.RED)
    for (name, place), line in zip(marks.items(), (":", "-."), strict=False):
        axes.axvline(place, color=figures.BLACK, linestyle=line, linewidth=1)
        axes.text(place * 1.06, remaining.max(), name, rotation=90, ha="left", va="top", fontsize=8)
    axes.set(xlabel="standard deviation of response − desired (m/s²)")
    axes.set(ylabel="strength of transformation (6), −g")
    axes.legend(handles=axes.lines[:1], loc="lower left")
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
