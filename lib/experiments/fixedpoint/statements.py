"""The paper's rankings of its three filters as statements that each run obeys or not."""

import numpy as np
from jaxtyping import Bool

from experiments.fixedpoint.published import KALMAN, LITERAL, LOW_PASS, WINDOW
from workbook.studies import Study, mean_interval

SMOOTHEST = "low pass smoothest"
NOISIEST = "Kalman filter noisiest"
WINDOW_PRECISE = "window most precise"
LOW_PASS_BEST = "low pass tracks best"
KALMAN_WORST = "Kalman filter tracks worst"


def statements(
    study: dict[str, Study], kalman: str, quantity: str = "position", noisy_by: str = "roughness"
) -> dict[str, Bool[np.ndarray, " runs"]]:
    """Which runs obey each statement, among window, low pass and one form of the Kalman filter.

    Smooth and noisy are judged by the roughness of the motion or another quantity, precise and best by the RMS error
    of `quantity`. The paper shows errors of q and of q' and does not say which it ranks by. A run that diverged is
    neither.
    """
    names = (WINDOW, LOW_PASS, kalman)
    rough = np.array([study[name][noisy_by] for name in names])
    error = np.array([study[name][quantity] for name in names])
    return {
        SMOOTHEST: (rough.argmin(axis=0) == 1) & np.isfinite(rough[1]),
        NOISIEST: (rough.argmax(axis=0) == 2) & np.isfinite(rough[2]),
        WINDOW_PRECISE: (error.argmin(axis=0) == 0) & np.isfinite(error[0]),
        LOW_PASS_BEST: (error.argmin(axis=0) == 1) & np.isfinite(error[1]),
        KALMAN_WORST: error.argmax(axis=0) == 2,
    }


# Where the errors of q and of q' in a noise are shown.
FIGURES = {
    ("small", "gaussian"): (5, 6),
    ("small", "logistic"): (8, 9),
    ("large", "gaussian"): (11, 12),
    ("large", "logistic"): (14, 15),
}


def figure_statements(study: dict[str, Study], size: str, kind: str) -> dict[str, Bool[np.ndarray, " runs"]]:
    """Which runs in a noise obey what its figures are said to show, by the ledger's names after ``fixedpoint.fig-``."""
    q, speed = FIGURES[size, kind]
    ranking, claim = LOW_PASS_BEST, "low-pass-best"
    found = {f"{speed}.kalman-noisiest": in_both_forms(study, NOISIEST)}
    if size == "small":
        ranking, claim = WINDOW_PRECISE, "window-most-precise"
        found[f"{q}.smoothest"] = in_both_forms(study, SMOOTHEST)
    for figure, quantity in ((q, "position"), (speed, "velocity")):
        found[f"{figure}.{claim}.printed"] = statements(study, LITERAL, quantity)[ranking]
    if kind == "gaussian":
        found[f"{q}.{claim}.corrected"] = statements(study, KALMAN)[ranking]
    return found


def in_both_forms(
    study: dict[str, Study], name: str, noisy_by: str = "roughness"
) -> Bool[np.ndarray, " runs"]:
    """Which runs obey a statement with (14) as printed and with it corrected."""
    printed, corrected = (statements(study, form, noisy_by=noisy_by)[name] for form in (LITERAL, KALMAN))
    return printed & corrected


def relative_change(before: np.ndarray, after: np.ndarray) -> tuple[float, tuple[float, float]]:
    """Mean change from one study to another, run by run, over the mean before, and its 95 % interval."""
    change = (after - before) / before.mean()
    return float(change.mean()), mean_interval(change)
