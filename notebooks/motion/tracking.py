"""Tracking a scan: what this notebook alone needs."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pandas as pd

from experiments.motion.designs import DESIGNS, as_read, design_controller, limit, stage_compensator
from experiments.motion.intervals import Values, key
from experiments.motion.machines import (
    parameters,
    published_deviations,
    published_setpoint,
    stage,
    stage_mass,
)
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
from stillwork.control.setpoint import Setpoint, segment_times
from stillwork.lti.state_space import StateModel
from stillwork.signals.moving_average import moving, rms
from workbook import figures
from workbook.studies import Study, proportion_interval, run_study, spread_interval


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


def paint_table(found: Values, quiet: Mapping[str, float], printed: Mapping[str, float]):
    """Table 3.7: rms errors (nm) over noise realisations and without noise, beside the printed ones, by case."""
    figure, axis = figures.new(1, 1, height=3.0)
    place, middle = np.arange(len(quiet)), np.array([mean for mean, _ in found.values()])
    low, high = np.array([interval for _, interval in found.values()]).T
    reach = [middle - low, high - middle]
    axis.errorbar(place, middle, yerr=reach, fmt="o", capsize=4, label="with noise, mean and 95 % of runs")
    style = {"markersize": 14, "color": figures.RED, "label": "without noise"}
    axis.plot(place, [*quiet.values()], "_", **style)
    figures.mark_published(axis, place, [printed[name] for name in quiet])
    axis.set_xticks(place, [name.replace(", ", ",\n") for name in quiet], fontsize=7)
    axis.set(ylabel="rms error in the scan (nm)", ylim=(0, None))
    axis.legend()
    return figure


def paint_tracking(setpoint: Setpoint, errors: Mapping[str, np.ndarray], printed: Mapping[str, float]):
    """Tracking errors in nm over the move, one panel a case, with the scaled acceleration, the scan and the printed rms."""
    figure, axes = figures.new(2, 2, height=4.4, sharex=True, sharey=True)
    scaled = setpoint.derivatives[2] / np.abs(setpoint.derivatives[2]).max()
    top = 1e9 * max(np.abs(error).max() for error in errors.values())
    for axis, (name, error) in zip(axes.ravel(), errors.items(), strict=True):
        style = {"color": figures.GREY, "linewidth": 0.8, "label": "acceleration, scaled"}
        axis.plot(setpoint.time, top * scaled, **style)
        axis.plot(setpoint.time, 1e9 * error, linewidth=0.9, color=figures.BLUE, label="error")
        axis.axvspan(*setpoint.scan, color=figures.GREY, alpha=0.12, linewidth=0, label="scan")
        style = {"color": figures.RED, "linewidth": 1.2, "label": "printed rms"}
        axis.plot(setpoint.scan, [printed[name]] * 2, **style)
        size = 1e9 * rms(error[setpoint.scanning])
        axis.set_title(f"{name}: rms {size:.2f} nm, printed {printed[name]:.2f}", fontsize=8)
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

PRINTED_NM = (9.1782, 11.647, 3.572, 3.4856, 11.086, 2.2841, 2.13)  # Table 3.7, in the order of `CASES`
TRACKING = {key(case.replace("none", "original")): case for case in CASES}  # entries of Table 3.7
RUNS, LEAN_RUNS = 100, 20  # noise realisations; of the notebook and of its fast variant


def tracking(
    *,
    feedforward_fit: str,
    scan_noise: str,
    scan_sample_time: float,
    redesign: str,
    stage_damping: float,
    both_noise_model: float,
    seed: int,
    lean: bool,
) -> Values:
    """Table 3.7 (nm); its fast variant takes 20 realisations of the noise instead of 100.

    `feedforward_fit` is ``once``, in the original loop, or ``each loop``; `scan_noise` ``section 3.1`` or ``none``;
    `redesign` takes the ``own limit`` of each design, or the ``printed`` bandwidth as its parameter f_bw, both at the
    printed Q_nu; that of the observer for MC with AD is `both_noise_model` (N^2/s).
    """
    setpoint = published_setpoint(scan_sample_time)
    loops = {case: tracking_loop(case, redesign, stage_damping, both_noise_model) for case in CASES}
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
    means = {claim: float(each.mean()) for claim, each in nm.items()}
    return scan_values(nm, quiet) | {"motion.table-3-7.ordering": float(ranked(means))}


def scan_values(nm: Mapping[str, np.ndarray], quiet: bool = False) -> Values:
    """Entries of Table 3.7, by claim, from the errors of single runs (nm): mean and central 95 % of the runs.

    Without noise (`quiet`) no run differs from another.
    """
    found = {}
    for claim, each in nm.items():
        mean = float(each.mean())
        found[f"motion.table-3-7.{claim}"] = mean, (mean, mean) if quiet else spread_interval(each)
    return found


def ranked(errors: dict[str, float]) -> bool:
    """MC worst, then the original, then AD, then both, with the original and with redesigned controllers."""
    names = ["mc", "original", "ad", "mc-and-ad"]
    redesigned = ["mc-redesigned", "original", "ad-redesigned", "mc-and-ad-redesigned"]
    orders = ([errors[name] for name in each] for each in (names, redesigned))
    return all(values == sorted(values, reverse=True) for values in orders)


@lru_cache(maxsize=64)  # combinations that differ in the scan share them
def tracking_loop(case: str, redesign: str, stage_damping: float, both_noise_model: float):
    observer, controlled = CASES[case]
    plant = stage(stage_damping)
    used = DESIGNS | {"MC and AD": replace(DESIGNS["MC and AD"], noise_model=both_noise_model)}
    design = as_read(used[observer], "noise model", stage_damping)
    block = stage_compensator(MEASURED, design, plant=plant)
    if redesign == "printed":
        controller = design_controller(controlled, redesign)
    else:
        controller = limit(controlled, "6 dB", "noise model", stage_damping)[1].controller
    return closed_loop(plant.at([0], [MEASURED - 1]), block, controller.state_space())


# === Appendix =====================================================================================================


def appendix(
    page,
    *,
    setpoint: Setpoint,
    errors: Mapping[str, np.ndarray],
    quiet: Mapping[str, float],
    study: Study,
    feedforward: Feedforward,
    same: Sequence[str],
    settled_nm: Sequence[float] | np.ndarray,
    exposure: float,
    sample_time: float,
) -> None:
    """What this notebook judges beside its answer.

    `errors` (m) and `quiet` (rms, nm) are without noise, `study` has runs with noise; `same` are the cases with the original
    controller.
    """
    page.text("## The setpoint and the fitted gains")
    limits = parameters("setpoint")
    page.check("motion.setpoint.distance", setpoint.derivatives[0, -1])
    segments = segment_times(*(limits[k] for k in ("snap", "jerk", "acceleration", "velocity")))
    page.check("motion.setpoint.snap-time", segments[0])
    page.check("motion.setpoint.scan", setpoint.scan[1] - setpoint.scan[0])
    page.show(
        f"velocity {feedforward.velocity:.2e} N s/m, acceleration {feedforward.acceleration:.5f} kg,",
        f"jerk {feedforward.jerk:.2e} kg s, snap {feedforward.snap:.3e} kg s^2",
    )
    _of_settling(page, setpoint, errors, same, settled_nm)
    _of_sentences(page, study)
    _of_averages(page, setpoint, errors, quiet, exposure, sample_time)


def _of_settling(
    page,
    setpoint: Setpoint,
    errors: Mapping[str, np.ndarray],
    same: Sequence[str],
    settled_nm: Sequence[float] | np.ndarray,
) -> None:
    page.text("""
## How soon it settles

Section 3.5.2: with AD, alone or with MC, the error settles sooner. It gives no error band. For four bands (nm), the time (ms)
from the end of the acceleration until the error stays inside:
""")
    until = setpoint.time <= setpoint.scan[1]
    sizes = {name: 1e9 * np.abs(errors[name][until]) for name in same}
    settled = pd.DataFrame(
        {
            band: {name: setpoint.time[np.flatnonzero(size > band)[-1]] for name, size in sizes.items()}
            for band in settled_nm
        }
    )
    settled = 1e3 * (settled - setpoint.acceleration_end).clip(lower=0)
    page.show(settled.round(1))
    sooner = [settled.loc[name] < settled.loc["PID"] for name in ("AD", "MC and AD")]
    page.check("motion.section-3-5-2.settling", np.mean(sooner))


def _of_sentences(page, study: Study) -> None:
    page.text("""
## Two sentences of the text that contradict the table

AD "provides the largest reduction" with the original controller (3.572 nm, but 3.4856 with both); redesigned MC shows "a small
improvement compared to the original situation" (11.086 against 9.1782 nm). The fraction of our runs in which they hold:
""")
    pairs = [(name, f"{name}, redesigned") for name in ("MC", "AD", "MC and AD")]
    says = {
        "damping-largest": study["AD"] < study["MC and AD"],
        "redesign-improves": [study[after] < study[before] for before, after in pairs],
        "all-improve": [study[after] < study["PID"] for _, after in pairs],
    }
    for claim, held in says.items():
        interval = proportion_interval(np.sum(held), np.size(held))
        page.check(f"motion.section-3-5-2.{claim}", np.mean(held), interval)
    better = pd.Series(
        np.mean(says["all-improve"], axis=1), [name for name, _ in pairs], name="runs below the original"
    )
    page.show(better)


def _of_averages(
    page,
    setpoint: Setpoint,
    errors: Mapping[str, np.ndarray],
    quiet: Mapping[str, float],
    exposure: float,
    sample_time: float,
) -> None:
    page.text("""
## The thesis's own criterion

The largest moving average (MA) and moving standard deviation (MSD) of section 1.5.3 in the scan (nm), without noise:
""")
    start = np.searchsorted(setpoint.time, setpoint.scan[0])
    windows = slice(start, np.searchsorted(setpoint.time, setpoint.scan[1] - exposure))
    criteria = {}
    for name, error in errors.items():
        found = moving(error, sample_time, exposure)
        largest = [1e9 * np.abs(each[windows]).max() for each in (found.average, found.deviation)]
        criteria[name] = {"MA": largest[0], "MSD": largest[1], "rms of the scan": quiet[name]}
    criteria = pd.DataFrame(criteria).T
    page.show(criteria.round(2))
    better = criteria.loc["MC, redesigned", "MA"] < criteria.loc["PID", "MA"]
    page.check("motion.section-3-7.compensation-improves", float(better))
