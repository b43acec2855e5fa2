"""Chapters 4 to 6 of the observer thesis at any reading of what it leaves open (``readings.toml``)."""

import numpy as np

from experiments.motion.contest import figure_statements, prepare, run_entrant, sample_scans
from experiments.motion.intervals import Values, central, key, share
from experiments.motion.location_study import CASES as LOCATION_CASES
from experiments.motion.location_study import ranges, read_table
from experiments.motion.perturbed_tracking import CASES, published_blocks, tracking_trial
from experiments.motion.scan_study import judge, published_scan
from workbook.studies import run_study

# --- Section 4.2.5: Table 4.1 ------------------------------------------------------------------------------------


def locations(
    *,
    error_channel: str,
    location_noise: bool,
    location_masses: int,
    gains_from: str,
    gains_in: str,
    location_sample_time: float,
    seed: int,
    lean: bool,
) -> Values:
    """Table 4.1 (nm), one draw of the noise and its spread over ranges of the places; it has no leaner form."""
    study = read_table(
        channel={"seen by the observer": "u_ff", "unseen": "w"}[error_channel],
        noise=location_noise,
        masses=location_masses,
        fit_noise=gains_from == "noisy move",
        fit_loop={"37 Hz": "PID", "83 Hz": "MC and AD"}[gains_in],
        sample_time=location_sample_time,
        seed=seed,
    )
    found: Values = {}
    ends = study.places[0], study.places[-1]
    for case in LOCATION_CASES:
        over = 1e9 * np.array([study.over(case, *each) for each in ranges(study.places, 0.5)])
        for part, value, each in zip(("min", "mean", "max"), study.over(case, *ends), over.T, strict=True):
            over_places_nm = float(each.min()), float(each.max())
            found[f"motion.table-4-1.{key(case)}.{part}"] = float(1e9 * value), over_places_nm
    return found


# --- Section 5.4.3: Fig. 5.10 and Table 5.2 ----------------------------------------------------------------------

PLANTS, LEAN_PLANTS = 100, 40  # perturbed plants; of the notebook and of the lean form of Table 5.2


def estimation(
    *,
    penalty_weight: float,
    error_law: str,
    rigid_body_errs: bool,
    estimation_sample_time: float,
    seed: int,
    lean: bool,
) -> Values:
    """Statements about Fig. 5.10, as fractions of 100 plants; it has no leaner form."""
    scan = published_scan(sample_time=estimation_sample_time)
    contest = prepare(scan, 0.05, rigid_body_errs)
    records = sample_scans(scan, PLANTS, seed, 0.05, error_law, rigid_body_errs)
    knobs = {"Kalman": 1.0, "sensitivity penalised": penalty_weight, "regularised least squares": 0.05}
    errors = [judge(scan, records, run_entrant(name, contest, knob, records)) for name, knob in knobs.items()]
    said = figure_statements(*errors)
    kalman, penalised, _ = errors
    ratio, bias = penalised.rms[:, 0] / kalman.rms[:, 0], kalman.bias[:, 2] / kalman.rms[:, 2]
    found: Values = {f"motion.fig-5-10.{claim}": share(holds) for claim, holds in said.items()}
    return found | {
        "motion.fig-5-10.sensitivity-rigid-as-kalman": central(ratio),
        "motion.fig-5-10.kalman-unbiased": central(bias),
    }


def perturbed_scans(
    *,
    error_law: str,
    rigid_body_errs: bool,
    perturbed_feedforward: str,
    perturbed_sample_time: float,
    seed: int,
    lean: bool,
) -> Values:
    """The perturbed values of Table 5.2 and what is said of them; the lean form draws 40 plants instead of 100."""
    off = run_study(
        tracking_trial,
        LEAN_PLANTS if lean else PLANTS,
        seed,
        blocks=published_blocks(),
        size=0.05,
        law=error_law,
        rigid=rigid_body_errs,
        retune=perturbed_feedforward == "refitted",
        sample_time=perturbed_sample_time,
        progress=False,
    )
    percent = {case: 100 * off[case] / off["none"] for case in CASES if case != "none"}
    found: Values = {
        f"motion.table-5-2.perturbed.{key(case).replace('and-', '')}": central(each)
        for case, each in percent.items()
    }
    better = {case: each < 100 for case, each in percent.items()}
    said = {
        "ad-beats-none": better["AD"] & better["AD, redesigned"],
        "mc-ad-beats-none": better["MC and AD"] & better["MC and AD, redesigned"],
        "mc-ad-beats-ad": percent["MC and AD, redesigned"] < percent["AD, redesigned"],
        "redesign-beats-original": percent["AD, redesigned"] < percent["AD"],
    }
    return found | {f"motion.table-5-2.{claim}": share(holds) for claim, holds in said.items()}
