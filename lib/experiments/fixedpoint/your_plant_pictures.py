"""Pictures of a plant of one's own in the adaptive loop (notebook 09)."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from experiments.fixedpoint.axes import COLOURS, fill_range
from experiments.fixedpoint.metrics import judge
from experiments.fixedpoint.noise import Noise
from experiments.fixedpoint.your_plant import Contraction, Models, contraction_along, drive
from stillwork.control.fixed_point import ControlledRun, Controller
from stillwork.control.kinematics import KinematicDesign
from stillwork.control.trajectory import Trajectory
from stillwork.control.transformation import FlowTransformation
from workbook import figures

_BINS = 240  # of an envelope over a run
_SHOWN = 20_000  # samples in the explorer at most


def paint_contraction(found: Contraction, chosen: Mapping[str, Controller]):
    """Multipliers of the iteration along the trajectory: it contracts between -1 and 1, fastest at 0."""
    figure, axes = figures.new(1, 1, height=2.6)
    for number, (name, controller) in enumerate(chosen.items()):
        values = found.multiplier(controller.transformation.local_gain)
        # Equal gains lie upon each other; of several coordinates there are several lines.
        for line, each in enumerate(values.T):
            label = name if line == 0 else f"{name}, direction {line + 1}"
            axes.plot(found.time, each, "--" if number == 2 else "-", color=COLOURS[name], label=label)
    for edge in (-1.0, 1.0):
        axes.axhline(edge, color=figures.BLACK, ls="--", lw=0.9)
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, -1.3), max(high, 1.3))
    axes.set(xlabel="time (s)", ylabel="multiplier of an iteration")
    axes.set(title="it contracts between the dashed lines")
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(handles[:: found.gain.shape[1]], labels[:: found.gain.shape[1]], ncols=3)
    return figure


def paint_runs(runs: Mapping[str, list[ControlledRun]], units: tuple[str, ...], settle: float):
    """Nominal and true motion, and the range of the tracking error in short stretches; a column for each coordinate."""
    figure, panels = figures.new(2, len(units), height=4.8, sharex=True, squeeze=False)
    for number, ((motion, error), unit) in enumerate(zip(panels.T, units, strict=True)):
        _paint_coordinate(motion, error, {name: each[number] for name, each in runs.items()}, settle)
        motion.set(ylabel=f"{symbol(number, units)} ({unit})")
        error.set(xlabel="time (s)", ylabel=f"error of {symbol(number, units)} (m{unit})")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def symbol(number: int, units: tuple[str, ...]) -> str:
    """q, or q1, q2, ... where there are several."""
    return "q" if len(units) == 1 else f"q{number + 1}"


def _paint_coordinate(motion, error, runs: Mapping[str, ControlledRun], settle: float):
    nominal = next(iter(runs.values())).trajectory
    coarse = slice(None, None, max(1, len(nominal.position) // 600))
    motion.plot(nominal.time[coarse], nominal.position[coarse], "k--", label="nominal", zorder=5)
    reach = 0.0
    for name, run in runs.items():
        label = name if run.diverged_at is None else f"{name}, diverges at {run.diverged_at:.2f} s"
        motion.plot(run.time[coarse], run.position[coarse], color=COLOURS[name], lw=1, label=label)
        _paint_error(error, run, color=COLOURS[name], label=f"_{name}")
        if run.diverged_at is None:
            reach = max(reach, 1.15e3 * np.abs(run.position_error[run.time >= settle]).max())
    margin = 0.2 * np.ptp(nominal.position)
    motion.set_ylim(nominal.position.min() - margin, nominal.position.max() + margin)
    if reach:
        error.set_ylim(-reach, reach)


def _paint_error(axes, run: ControlledRun, **style):
    """In mm or mrad, each bin's extremes."""
    fill_range(axes, run.time, 1e3 * run.position_error, max(1, len(run.time) // _BINS), **style)


def plant_explorer(
    models: Models,
    chosen: Mapping[str, Controller],
    trajectories: list[Trajectory],
    noise_kind: str,
    settle: float,
    seed: int,
) -> Callable:
    """Explorer: all filters with another gain, stiffness of tracking and noise."""
    found = contraction_along(models, trajectories)
    trajectories = [  # a long record would take too long to redraw
        Trajectory(
            each.sample_time, each.position[:_SHOWN], each.velocity[:_SHOWN], each.acceleration[:_SHOWN]
        )
        for each in trajectories
    ]

    def paint(gain: float, stiffness: float, noise_size: float):
        """Every local gain times `gain`, every Lambda times `stiffness`."""
        moved = {}
        for name, controller in chosen.items():
            old = controller.transformation
            knob = "gain" if isinstance(old, FlowTransformation) else "slope"
            stronger = replace(old, **{knob: gain * getattr(old, knob)})
            stiffer = KinematicDesign(stiffness * controller.kinematics.exponent)
            moved[name] = replace(controller, transformation=stronger, kinematics=stiffer)
        noise = Noise() if noise_kind == "none" else Noise(noise_kind, noise_size)
        runs = drive(models, moved, trajectories, noise, seed)
        count = len(models.units)
        figure, panels = figures.new(count, 1, height=1.6 + 1.6 * count, squeeze=False)
        for number, (axes, unit) in enumerate(zip(panels[:, 0], models.units, strict=True)):
            for name, each in runs.items():
                run = each[number]
                if run.diverged_at is None:
                    said = f"{1e3 * judge(run, settle)['position']:.3g} m{unit} rms"
                else:
                    said = f"diverges at {run.diverged_at:.2f} s"
                if found.outside(moved[name].transformation.local_gain).any():
                    said += ", outside the contraction range"
                _paint_error(axes, run, color=COLOURS[name], label=f"{name}: {said}")
            axes.set(xlabel="time (s)", ylabel=f"error of {symbol(number, models.units)} (m{unit})")
            axes.margins(y=0.4)  # room for the legend
            axes.legend(loc="upper right")
        return figure

    return paint
