"""The motion room's published numbers at any reading of what the thesis leaves open (``readings.toml``)."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from experiments.motion.designs import (
    DESIGNS,
    NOISE_MODEL,
    Design,
    stage_bandwidth,
    stage_compensator,
    stage_loops,
)
from experiments.motion.drive import (
    drive_applications,
    drive_loop,
    rigid_response,
    seen_by_controller,
    statements,
)
from experiments.motion.intervals import Values, key
from experiments.motion.machines import drive, published_deviations, published_setpoint, stage, stage_mass
from experiments.motion.perturbed_tracking import CASES, MEASURED, noisy_scan_trial
from stillwork.control.bandwidth import SIX_DB, Bandwidth, Loop
from stillwork.control.crossover import crossover
from stillwork.control.feedforward import error_loop, fit_feedforward
from stillwork.control.loops import closed_loop
from stillwork.control.pid import PidFamily
from workbook.studies import run_study, spread_interval

# --- Chapter 3: bandwidths ---------------------------------------------------------------------------------------

BANDWIDTHS = {  # entries of Table 3.5 and of the text, in the order of the published values
    "pid": "PID",
    "notches": "PID with notches",
    "mc": "MC",
    "mc-and-ad-no-band-pass": "MC and AD, no band-pass",
    "ad-no-band-pass": "AD, no band-pass",
    "mc-two-constraints": "MC, two constraints",
    "ad": "AD",
    "mc-and-ad": "MC and AD",
}
OPEN_LOOPS = {  # which of them Definition 1.2.1 means
    "P_eq C_fb": lambda at: at.loop,
    "P C_eq": lambda at: at.output_loop,
    "P C_fb": lambda at: at.plant * at.controller,
}
COMPENSATIONS = {  # what keeps the integral action of MC: Q_nu, and the corner of a high-pass (Hz)
    "noise model": (NOISE_MODEL, None),
    "high-pass": (None, 1.0),
    "nothing": (None, None),
}
TARGET = 0.04  # wanted damping ratio, section 3.3.2
SIX = {"6 dB": SIX_DB, "2": 2.0}


def bandwidths(
    *, open_loop: str, mass: int, six: str, compensation: str, stage_damping: float, seed: int, lean: bool
) -> Values:
    """Bandwidths of chapter 3 at one mass, each with the half hertz that its print rounds off; it has no leaner form.

    `open_loop` is one of `OPEN_LOOPS` or ``f_bw``, `six` of `SIX`, `compensation` of `COMPENSATIONS`, and
    `stage_damping` a ratio.
    """
    found = {
        claim: bandwidth(name, open_loop, mass, six, compensation, stage_damping)
        for claim, name in BANDWIDTHS.items()
    }
    values = list(found.values())
    found["mc-two-constraints-again"] = found["mc-two-constraints"]
    return {f"motion.bandwidth.{claim}": (hz, (hz - 0.5, hz + 0.5)) for claim, hz in found.items()} | {
        "motion.bandwidth.ordering": float(values == sorted(values)),
        "motion.bandwidth.doubled-by-ad": float(found["ad"] > 2 * found["pid"]),
        "motion.bandwidth.doubled-by-both": float(found["mc-and-ad"] > 2 * found["pid"]),
    }


def bandwidth(
    name: str,
    open_loop: str,
    mass: int,
    six: str = "6 dB",
    compensation: str = "noise model",
    stage_damping: float = 0.005,
) -> float:
    """What is called the bandwidth of a design (Hz): a crossing at one mass (1 to 7), or the parameter f_bw."""
    loops, found = limit(name, six, compensation, stage_damping)
    if open_loop == "f_bw":
        return found.design_hz
    loop, function = loops[mass - 1], OPEN_LOOPS[open_loop]
    magnitude = np.abs(function(loop.at(found.controller)))
    return crossover(lambda w: function(loop.at(found.controller, w)), loop.omega, magnitude) / (2 * np.pi)


@lru_cache(maxsize=128)  # readings that differ in the loop or the mass share the search
def limit(name: str, six: str, compensation: str, stage_damping: float) -> tuple[list[Loop], Bandwidth]:
    """The seven loops of a design and the largest bandwidth that they allow."""
    design = _as_read(DESIGNS[name], compensation, stage_damping)
    found = stage_bandwidth(design, damping_ratio=stage_damping, limit=SIX[six])
    return stage_loops(design, plant=stage(stage_damping)), found


def _as_read(design: Design, compensation: str, stage_damping: float) -> Design:
    used, noise_model = design.application, design.noise_model
    if used is not None and used.damping:  # up to the wanted ratio, from what the stage has
        used = replace(used, damping=TARGET - stage_damping)
    if noise_model == NOISE_MODEL:  # printed for MC with the noise model, which is one way of two
        noise_model, high_pass_hz = COMPENSATIONS[compensation]
        used = replace(used, high_pass_hz=high_pass_hz)
    return replace(design, application=used, noise_model=noise_model)


# --- Section 3.5.2: Table 3.7 ------------------------------------------------------------------------------------

TRACKING = {key(case.replace("none", "original")): case for case in CASES}  # entries of Table 3.7
PRINTED_HZ = {"PID": 37.0, "MC": 46.0, "AD": 77.0, "MC and AD": 83.0}  # Table 3.5
RUNS, LEAN_RUNS = 100, 20  # noise realisations; of the notebook and of its lean form


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
    """Table 3.7 (nm); its lean form takes 20 realisations of the noise instead of 100.

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


@lru_cache(maxsize=64)  # readings that differ in the scan share them
def tracking_loop(case: str, redesign: str, stage_damping: float):
    observer, controlled = CASES[case]
    plant = stage(stage_damping)
    design = _as_read(DESIGNS[observer], "noise model", stage_damping)
    block = stage_compensator(MEASURED, design, plant=plant)
    if redesign == "printed":
        controller = PidFamily(stage_mass())(PRINTED_HZ[controlled])
    else:
        controller = limit(controlled, "6 dB", "noise model", stage_damping)[1].controller
    return closed_loop(plant.at([0], [MEASURED - 1]), block, controller.state_space())


# --- Section 3.6: Fig. 3.36 --------------------------------------------------------------------------------------


def drive_figure(
    *, stiffness_error: float, drive_damping: float, drive_weights: str, seed: int, lean: bool
) -> dict[str, float]:
    """What Fig. 3.36 shows, from exact responses between 5 and 30 Hz; it has no leaner form.

    `stiffness_error` is that of the observer's model (relative), `drive_damping` the added ratio, `drive_weights` one
    of `drive.WEIGHTS`. The controller has no effect on what it sees.
    """
    plant = drive()
    model = replace(plant, stiffness=plant.stiffness * (1 + stiffness_error))
    omega = 2 * np.pi * np.linspace(5, 30, 2000)
    levels = {}
    for name, each in drive_applications(drive_damping).items():
        loop = drive_loop(plant, model, each, 4.0, drive_weights)
        levels[name] = 20 * np.log10(np.abs(seen_by_controller(loop, omega) / rigid_response(plant, omega)))
    found = {f"motion.fig-3-36.{name}": float(holds) for name, holds in statements(levels).items()}
    return found | {"motion.fig-3-36.rigid": float(np.abs(levels["MC and AD"]).max())}
