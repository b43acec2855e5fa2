"""Tracking a scan: what this notebook alone needs."""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from experiments.motion.designs import DESIGNS, as_read, design_controller, limit, stage_compensator
from experiments.motion.intervals import Values, key
from experiments.motion.machines import published_deviations, published_setpoint, stage, stage_mass
from experiments.motion.perturbed_tracking import CASES, MEASURED, WARM_UP
from experiments.motion.pictures import paint_errors
from stillwork.control.feedforward import (
    Feedforward,
    error_loop,
    fit_feedforward,
    noise_error,
    tracking_error,
)
from stillwork.control.loops import closed_loop
from stillwork.control.pid import PidFamily
from stillwork.control.setpoint import Setpoint
from stillwork.lti.state_space import StateModel
from stillwork.signals.moving_average import rms
from workbook import figures
from workbook.studies import run_study, spread_interval


def noisy_scan_trial(
    rng: np.random.Generator,
    loops: dict[str, StateModel],
    setpoint: Setpoint,
    feedforward: Feedforward | Mapping[str, Feedforward],
    deviations: dict[str, float],
) -> dict[str, float]:
    """Rms of the true error in the scan (m) of several loops with modified feedforward under one noise realisation.

    The feedforward is one for all, or each loop's own.
    """
    seed = rng.integers(2**63)  # every loop meets the same noise
    samples = WARM_UP + setpoint.derivatives.shape[1]
    found = {}
    for name, loop in loops.items():
        draws = np.random.default_rng(seed)
        noise = noise_error(loop, setpoint.sample_time, samples, deviations, draws)[0, WARM_UP:]
        own = feedforward if isinstance(feedforward, Feedforward) else feedforward[name]
        error = tracking_error(error_loop(loop), setpoint, own) + noise
        found[name] = rms(error[setpoint.scanning])
    return found


# === Tracking pictures ============================================================================================
# Figure and explorer of tracking (notebook 11).


def paint_tracking(setpoint: Setpoint, errors: Mapping[str, np.ndarray]):
    """Tracking errors in nm over the move, one panel a case, with the scaled acceleration and the scan."""
    figure, axes = figures.new(2, 2, height=4.4, sharex=True, sharey=True)
    scaled = setpoint.derivatives[2] / np.abs(setpoint.derivatives[2]).max()
    top = 1e9 * max(np.abs(error).max() for error in errors.values())
    for axis, (name, error) in zip(axes.ravel(), errors.items(), strict=True):
        style = {"color": figures.GREY, "linewidth": 0.8, "label": "acceleration, scaled"}
        axis.plot(setpoint.time, top * scaled, **style)
        axis.plot(setpoint.time, 1e9 * error, linewidth=0.9, color=figures.BLUE, label="error")
        axis.axvspan(*setpoint.scan, color=figures.GREY, alpha=0.12, linewidth=0, label="scan")
        axis.set_title(f"{name}: {1e9 * rms(error[setpoint.scanning]):.2f} nm rms in the scan")
    axes[0, 0].set_xlim(0, setpoint.time[setpoint.time <= setpoint.scan[1]][-1] + 0.02)
    axes[0, 0].legend(loc="upper right", fontsize=7)
    figures.label(axes, "time (s)", "error (nm)")
    return figure


def paint_feedforward(acceleration_kg: float, snap: float, bandwidth_hz: float):
    """Explorer: the error of the loop without observer for given feedforward gains."""
    setpoint = published_setpoint()
    controller = PidFamily(stage_mass())(bandwidth_hz).state_space()
    loop = error_loop(closed_loop(stage().at([0], [4]), None, controller))
    error = tracking_error(loop, setpoint, Feedforward(acceleration=acceleration_kg, snap=1e-6 * snap))
    size = 1e9 * rms(error[setpoint.scanning])
    return paint_errors(setpoint, {"error": error}, f"{size:.1f} nm rms in the scan (grey)")


# --- Section 3.5.2: Table 3.7 ------------------------------------------------------------------------------------

TRACKING = {key(case.replace("none", "original")): case for case in CASES}  # entries of Table 3.7
RUNS, LEAN_RUNS = 100, 20  # noise realisations; of the notebook and of its fast variant


def tracking(
    *,
    feedforward_fit: str,
    scan_noise: str,
    scan_sample_time: float,
    redesign: str,
    stage_damping: float,
    seed: int,
    lean: bool,
) -> Values:
    """Table 3.7 (nm); its fast variant takes 20 realisations of the noise instead of 100.

    `feedforward_fit` is ``once``, in the original loop, or ``each loop``; `scan_noise` ``section 3.1`` or ``none``;
    `redesign` takes the ``own limit`` of each design, or the ``printed`` bandwidth as its parameter f_bw.
    """
    setpoint = published_setpoint(scan_sample_time)
    loops = {case: tracking_loop(case, redesign, stage_damping) for case in CASES}
    fitted = {
        case: fit_feedforward(error_loop(loops["none" if feedforward_fit == "once" else case]), setpoint)
        for case in CASES
    }
    quiet = scan_noise == "none"
    runs = 1 if quiet else LEAN_RUNS if lean else RUNS
    deviations = {name: 0.0 if quiet else size for name, size in published_deviations().items()}
    scan = {"loops": loops, "setpoint": setpoint, "feedforward": fitted, "deviations": deviations}
    study = run_study(noisy_scan_trial, runs, seed, progress=False, **scan)
    nm = {claim: 1e9 * study[case] for claim, case in TRACKING.items()}
    mean = {claim: float(each.mean()) for claim, each in nm.items()}
    found = {
        f"motion.table-3-7.{claim}": (value, (value, value) if quiet else spread_interval(nm[claim]))
        for claim, value in mean.items()
    }  # without noise no run differs from another
    return found | {"motion.table-3-7.ordering": float(ranked(mean))}


def ranked(errors: dict[str, float]) -> bool:
    """MC worst, then the original, then AD, then both, with the original and with redesigned controllers."""
    names = ["mc", "original", "ad", "mc-and-ad"]
    redesigned = ["mc-redesigned", "original", "ad-redesigned", "mc-and-ad-redesigned"]
    orders = ([errors[name] for name in each] for each in (names, redesigned))
    return all(values == sorted(values, reverse=True) for values in orders)


@lru_cache(maxsize=64)  # combinations that differ in the scan share them
def tracking_loop(case: str, redesign: str, stage_damping: float):
    observer, controlled = CASES[case]
    plant = stage(stage_damping)
    design = as_read(DESIGNS[observer], "noise model", stage_damping)
    block = stage_compensator(MEASURED, design, plant=plant)
    if redesign == "printed":
        controller = design_controller(controlled, redesign)
    else:
        controller = limit(controlled, "6 dB", "noise model", stage_damping)[1].controller
    return closed_loop(plant.at([0], [MEASURED - 1]), block, controller.state_space())
