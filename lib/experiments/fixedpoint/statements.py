"""The paper's rankings of its three filters as statements that each run obeys or not."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from experiments.fixedpoint.published import KALMAN, LITERAL, LOW_PASS, WINDOW
from workbook.studies import Study, fraction, mean_interval

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


def pooled(studies: dict[str, dict[str, Study]], kalman: str) -> dict[str, Bool[np.ndarray, " runs"]]:
    """The statements over the runs of all cases together."""
    each = [statements(study, kalman) for study in studies.values()]
    return {name: np.concatenate([obeyed[name] for obeyed in each]) for name in each[0]}


def rankings(small: list[dict[str, Study]], large: list[dict[str, Study]]) -> dict[str, list[float]]:
    """Fractions of runs that obey what the paper says, a number for each pair of studies, in small and in large noise."""

    def share(studies, kalman, name, quantity="position"):
        return [float(statements(study, kalman, quantity)[name].mean()) for study in studies]

    return {
        "small noise: low pass smoothest": share(small, LITERAL, SMOOTHEST),
        "small noise: Kalman filter noisiest": share(small, LITERAL, NOISIEST),
        "large noise: Kalman filter noisiest": share(large, LITERAL, NOISIEST),
        "small noise: window most precise, (14) printed": share(small, LITERAL, WINDOW_PRECISE),
        "small noise: window most precise, (14) corrected": share(small, KALMAN, WINDOW_PRECISE),
        "small noise: window most precise in q', (14) printed": share(
            small, LITERAL, WINDOW_PRECISE, "velocity"
        ),
        "large noise: low pass best, (14) printed": share(large, LITERAL, LOW_PASS_BEST),
        "large noise: low pass best, (14) corrected": share(large, KALMAN, LOW_PASS_BEST),
        "large noise: low pass best in q', (14) printed": share(large, LITERAL, LOW_PASS_BEST, "velocity"),
    }


def changed(before: dict[str, Study], after: dict[str, Study], kalman: str) -> str:
    """Statements whose fraction differs between two readings of the paper, as text; ``none`` without any."""
    old, new = statements(before, kalman), statements(after, kalman)
    moved = [
        f"{name} {old[name].mean():.2g} -> {new[name].mean():.2g}"
        for name in old
        if old[name].mean() != new[name].mean()
    ]
    return "; ".join(moved) or "none"


@dataclass(frozen=True)
class StatementTable:
    """Fraction of runs that obey each statement, a row per case and statement; prints as text."""

    rows: tuple[tuple[str, str, str, str], ...]

    def __repr__(self) -> str:
        return "\n".join("{:16s} {:27s} {:22s} {:22s}".format(*row).rstrip() for row in self.rows)


def table(studies: dict[str, dict[str, Study]], corrected: str, printed: str) -> StatementTable:
    """All statements in all cases, for both forms of the Kalman filter, with Wilson's 95 % intervals.

    Runs that repeat one another, as those without noise do, are one run: they get no interval.
    """
    rows = [("case", "statement", "(14) printed", "(14) corrected")]
    for case, study in studies.items():
        repeated = all(np.ptp(found[quantity]) == 0 for found in study.values() for quantity in found.values)
        forms = [statements(study, form) for form in (printed, corrected)]
        for name in forms[0]:
            cells = []
            for obeyed in forms:
                share, (low, high) = fraction(obeyed[name])
                cells.append(f"{share:.2f}" if repeated else f"{share:.2f} ({low:.2f} .. {high:.2f})")
            rows.append((case, name, *cells))
    return StatementTable(tuple(rows))


def longest_replaced(gaps: list[float], studies: list[dict[str, Study]], kalman: str) -> float:
    """Longest gap, s, at which the better simple filter tracks q as well as the Kalman filter in every run; 0 if none."""
    replaced = [0.0]
    for gap, study in zip(gaps, studies, strict=True):
        simple = np.minimum(study[WINDOW]["position"], study[LOW_PASS]["position"])
        if (np.isfinite(simple) & (simple <= study[kalman]["position"])).all():
            replaced.append(gap)
    return max(replaced)
