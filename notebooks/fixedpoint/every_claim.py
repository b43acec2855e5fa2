"""The statements as a table and a map: what this notebook alone needs."""

from dataclasses import dataclass

import numpy as np

from experiments.fixedpoint.axes import COLOURS, METRICS, log_axis
from experiments.fixedpoint.metrics import compare
from experiments.fixedpoint.noise import Noise
from experiments.fixedpoint.oscillator import load_oscillator
from experiments.fixedpoint.published import KALMAN, LITERAL, LOW_PASS, WINDOW, published_controllers
from experiments.fixedpoint.statements import LOW_PASS_BEST, NOISIEST, SMOOTHEST, WINDOW_PRECISE, statements
from stillwork.control.trajectory import asin_trajectory
from workbook import figures
from workbook.studies import Study, fraction


def paint_statement_map(columns: list[str], fractions: dict[str, list[float]], label: str):
    """Fraction of runs that obey each statement, a row a statement, a column a setting."""
    figure, axes = figures.new(1, height=0.34 * len(fractions) + 1.2)
    grid = np.array(list(fractions.values()), dtype=float)
    rows = np.arange(len(fractions))
    places, shades = np.arange(len(columns)), {"cmap": "Blues", "vmin": 0, "vmax": 1}
    image = axes.pcolormesh(places, rows, grid, label="fraction of runs", **shades)
    axes.set_yticks(rows, list(fractions))
    axes.set_xticks(places, columns, fontsize=7)
    axes.grid(False)
    axes.invert_yaxis()
    axes.set_xlabel(label)
    for (row, column), value in np.ndenumerate(grid):
        style = {"ha": "center", "va": "center", "fontsize": 7, "color": "w" if value > 0.5 else "k"}
        axes.text(column, row, f"{value:.2g}", **style)
    figure.colorbar(image, ax=axes, label="fraction of runs that obey the statement")
    return figure


def paint_ranking(frequency_hz: float, sharpness: float, amplitude: float):
    """RMS errors of the four controllers, mean over two noise records."""
    exact, approximate = (model.plant for model in load_oscillator().values())
    trajectory = asin_trajectory(sharpness=sharpness, frequency_hz=frequency_hz)
    controllers, noise = published_controllers(approximate), Noise("gaussian", amplitude)
    found = compare(exact, controllers, trajectory, noise, runs=2, seed=0)
    figure, panels = figures.new(1, 2, height=2.2)
    for axes, quantity in zip(panels, ("position", "roughness"), strict=True):
        for place, (name, study) in enumerate(found.items()):
            mean = METRICS[quantity][2] * study[quantity].mean()
            axes.plot(mean, place, "o", color=COLOURS[name], label=name)
        axes.set(xscale="log", xlabel=METRICS[quantity][0], ylim=(len(found) - 0.5, -0.5))
        axes.set_yticks(range(len(found)), [""] * len(found))
        log_axis(axes.xaxis)
    panels[0].set_yticklabels(list(found))
    return figure


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
