"""Pictures of measurement noise: correlations, beliefs of a Kalman filter, tuned filters and their cost."""

from functools import lru_cache

import numpy as np

from experiments.fixedpoint.axes import COLOURS, METRICS, legend_above, log_axis, points_with_intervals
from experiments.fixedpoint.differentiation import (
    Correlations,
    quotient_autocorrelation,
    quotient_cross_correlation,
    steady_errors,
)
from experiments.fixedpoint.oscillator import load_oscillator
from experiments.fixedpoint.published import EXTENDED
from stillwork.control.fixed_point_linear import semi_implicit_motion
from stillwork.estimation.plant import partial_derivatives
from workbook import figures
from workbook.studies import Study


def paint_noise_correlations(found: dict[str, Correlations]):
    """Sample correlations of the difference quotient, with itself and with the position, and theory."""
    figure, panels = figures.new(1, 2, height=3.0, sharey=True)
    lags = next(iter(found.values())).lags
    theories = (quotient_autocorrelation, quotient_cross_correlation)
    titles = ("quotient with itself", "quotient with the position")
    looks = ((figures.BLUE, -0.12), (figures.GREEN, 0.0), (figures.ORANGE, 0.12))
    for axes, name, theory, title in zip(panels, ("quotient", "cross"), theories, titles, strict=True):
        derived = [theory(int(lag)) for lag in lags]
        axes.plot(lags, derived, "kD", mfc="none", ms=9, label="derived from eqs. (18)-(21)")
        style = {"color": figures.RED, "ms": 10, "zorder": 1.5, "label": "assumed: R diagonal, white"}
        axes.plot(lags, (lags == 0) * float(name == "quotient"), "x", **style)
        for (label, seen), (colour, shift) in zip(found.items(), looks, strict=False):
            axes.plot(lags + shift, getattr(seen, name), ".", color=colour, ms=7, label=label)
        axes.set(xlabel="lag (samples)", ylabel="correlation", title=title)
    legend_above(panels[0], 3)
    return figure


def paint_beliefs(
    deviations,
    computed,
    true,
    label="noise of the measured position (m)",
    marks=(1e-5, 1e-4),
    marked="the paper's two noises",
):
    """Standard deviation of the estimates, by the filter's own covariance and in truth, over the noise.

    Along the quantity that `label` names; `marks` are its values that were published or are looked at.
    """
    figure, panels = figures.new(1, 2, height=3.0)
    for axes, column, unit, name in zip(panels, (1, 0), ("m", "m/s"), ("position", "velocity"), strict=True):
        axes.loglog(
            deviations, np.sqrt(computed[:, column]), "--", color=figures.RED, label="computed by the filter"
        )
        axes.loglog(deviations, np.sqrt(true[:, column]), color=figures.BLUE, label="true")
        axes.set(xlabel=label, ylabel=f"standard deviation of the error ({unit})", title=name)
        for number, mark in enumerate(marks):
            label_it = {"label": f"_{marked}" if number else marked}
            axes.axvline(mark, color=figures.BLACK, linestyle=":", linewidth=1, **label_it)
    legend_above(panels[0])
    return figure


def paint_tuned_errors(studies: dict[str, dict[str, Study]]):
    """Errors on fresh noise of the tuned filters, mean and 95 % interval, a row a noise."""
    quantities = ("velocity", "position", "roughness")
    height = 2.0 * len(studies) + 0.6
    figure, panels = figures.new(len(studies), len(quantities), height=height, squeeze=False)
    for row, (case, study) in zip(panels, studies.items(), strict=True):
        for axes, quantity in zip(row, quantities, strict=True):
            for place, (name, runs) in enumerate(study.items()):
                points_with_intervals(axes, [METRICS[quantity][2] * runs[quantity]], [place], name)
            first = quantity == quantities[0]
            axes.set(xlabel=METRICS[quantity][0], title=case if first else "")
            axes.set_yticks(range(len(study)), list(study) if first else [""] * len(study))
            axes.set(ylim=(len(study) - 0.5, -0.5), xlim=(0, 1.06 * axes.get_xlim()[1]))
    return figure


def paint_cost_against_error(cost_ns: dict[str, float], errors: dict[str, float], unit: str):
    """What a filter costs against what it gives."""
    figure, axes = figures.new(1, height=3.2)
    for name, error in errors.items():
        axes.plot(cost_ns[name], error, "o", color=COLOURS[name], label=name)
        below = -13 if name == EXTENDED else 4  # its neighbour is close
        axes.annotate(name, (cost_ns[name], error), xytext=(6, below), textcoords="offset points", fontsize=8)
    axes.set(xscale="log", xlabel="measured time per sample, printed settings (ns)", ylabel=unit)
    axes.set(xlim=(0.7 * min(cost_ns.values()), 3 * max(cost_ns.values())))  # the names stand to the right
    axes.set_ylim(0, 1.15 * max(errors.values()))
    log_axis(axes.xaxis)
    return figure


def motion_at_rest(sample_time: float):
    """F of x = [velocity, position] for the approximate model at rest, semi-implicit."""
    slopes = partial_derivatives(load_oscillator()["approximate"].plant, 0.0, 0.0, 0.0)
    return semi_implicit_motion(slopes, sample_time)[0]


@lru_cache(maxsize=1)
def _expected_beliefs() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Scales of R, the computed variances, and the true ones for a noise of 1 m: nothing else drives the true errors."""
    scales, sample_time, nothing = np.geomspace(1e-4, 1e4, 25), 1e-3, np.zeros((2, 2))
    still, process, assumed = motion_at_rest(sample_time), np.diag([1e-1, 1e-3]), np.diag([1e-2, 1e-3])
    settled = [steady_errors(still, process, scale * assumed, 1.0, sample_time, nothing) for scale in scales]
    return scales, *(np.array([np.diag(getattr(s, n)) for s in settled]) for n in ("computed", "true"))


def paint_expected_beliefs(assumed_scale: float, noise_deviation: float):
    """Computed and true standard deviation of the Kalman filter's errors when its R is scaled."""
    scales, computed, of_one = _expected_beliefs()
    true = noise_deviation**2 * of_one
    figure = paint_beliefs(scales, computed, true, "factor on the assumed R", (assumed_scale,), "this factor")
    for axes in figure.axes:
        log_axis(axes.xaxis)
        log_axis(axes.yaxis)
    return figure
