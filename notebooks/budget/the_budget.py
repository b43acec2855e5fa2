"""The budget: in which order the methods stand over floors and open choices, and the spectra of one waterfall."""

from dataclasses import replace
from itertools import product

import numpy as np

from experiments.budget.machine import BAND_HZ, FLOORS, floor, machine, noises
from experiments.budget.waterfall import STEPS
from stillwork.control.error_budget import ErrorBudget, error_budget
from workbook import figures

SCALES = (0.5, 2.0)  # of what is assumed: drive and sensors of the isolator, mass of the frame


def open_points() -> list[dict[str, float]]:
    """Corners of what the machine's file assumes: frame, damper of the struts, and noise of the assumed parts."""
    names = ("frame", "damper", "noise")
    return [dict(zip(names, scales, strict=True)) for scales in product(SCALES, repeat=len(names))]


def step_errors(point: dict[str, float]) -> dict[str, np.ndarray]:
    """Rms of each step on every floor, m, at a corner of what is assumed."""
    found = {}
    for name, step in STEPS.items():
        built = machine(**step)
        built = replace(
            built,
            frame_mass=built.frame_mass * point["frame"],
            suspension_hz=built.suspension_hz
            * np.sqrt(
                (built.frame_mass + built.stage_mass) / (built.frame_mass * point["frame"] + built.stage_mass)
            ),
            suspension_damping=built.suspension_damping * point["damper"],
        )
        powers = error_budget(built.network(), [*map(floor, FLOORS), *noises()], BAND_HZ).powers[:, 0]
        others = powers[len(FLOORS) :] * np.array([1.0, *[point["noise"] ** 2] * 3])
        found[name] = np.sqrt(powers[: len(FLOORS)] + others.sum())
    return found


def statements(study: list[dict[str, np.ndarray]]) -> dict[str, float]:
    """Shares of corners at which each statement on floors holds."""
    loud = [FLOORS.index(name) for name in ("VC-A", "VC-B", "slab under footfall")]
    quiet = [FLOORS.index(name) for name in ("VC-F", "VC-G", "LIGO ground")]
    return {
        "together-best-loud": float(
            np.mean([np.all(s["all"][loud] <= np.min(list(s.values()), axis=0)[loud]) for s in study])
        ),
        "feedforward-first-loud": float(
            np.mean(
                [
                    np.all(s["feedforward"][loud] < np.minimum(s["skyhook"], s["observer"])[loud])
                    for s in study
                ]
            )
        ),
        "observer-costs-quiet": float(
            np.mean([np.all(s["observer"][quiet] > s["passive, PID"][quiet]) for s in study])
        ),
        "observer-costs-quietest": float(np.mean([s["observer"][-1] > s["passive, PID"][-1] for s in study])),
        "together-costs-quiet": float(
            np.mean([np.all(s["all"][quiet] > s["skyhook"][quiet]) for s in study])
        ),
    }


def paint_spectra(budgets: dict[str, ErrorBudget]):
    """Backward cumulative spectra of all sources, one line a step: from the right, where the error comes from."""
    figure, axes = figures.new(height=2.8)
    for name, budget in budgets.items():
        above = np.sqrt(budget.cumulative(backward=True)[:, 0].sum(axis=0))
        axes.loglog(budget.frequencies_hz, 1e9 * above, linewidth=1.0, label=name)
    axes.set(xlabel="frequency (Hz)", ylabel="rms above (nm)", ylim=(0.3, None))
    axes.legend()
    return figure


def table_of(budgets: dict[str, ErrorBudget], exposure: float) -> list[str]:
    """A line a step: rms, interval, 3 sigma, peak in a minute, MA and MSD, nm."""
    lines = [f"{'nm':14} {'rms':>7} {'95 %':>15} {'3 sigma':>8} {'peak':>7} {'MA':>7} {'MSD':>7}"]
    for name, budget in budgets.items():
        low, high = 1e9 * budget.interval()[:, 0]
        average, deviation = (1e9 * each[0] for each in budget.moving(exposure))
        rms = 1e9 * budget.rms[0]
        lines.append(
            f"{name:14} {rms:7.3g} {f'{low:.3g} to {high:.3g}':>15} {3 * rms:8.3g} {1e9 * budget.peak(60.0)[0]:7.3g} "
            f"{average:7.3g} {deviation:7.3g}"
        )
    return lines
