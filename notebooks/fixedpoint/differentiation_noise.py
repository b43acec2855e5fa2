"""Noise of numerical differentiation: what this notebook alone needs."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64
from numpy.typing import ArrayLike

from experiments.fixedpoint.axes import legend_above, log_axis
from experiments.fixedpoint.choices import PRINTED_NOISE, SAMPLE_TIME, Values, trajectory
from experiments.fixedpoint.differentiation import steady_errors
from experiments.fixedpoint.noise import Noise
from experiments.fixedpoint.noise_pictures import motion_at_rest
from stillwork.base.checks import require_array, require_number
from workbook import figures
from workbook.studies import fraction, mean_interval, run_study


def quotient_trial(
    rng: np.random.Generator, noise: Noise, samples: int, sample_time: float
) -> dict[str, float]:
    """One record of noise: mean of the quotient over its deviation, variance over (s / dt)^2, correlation."""
    error = noise.sample(rng, samples)
    quotient = difference_quotient(error, sample_time)
    scale = noise.standard_deviation / sample_time
    return {
        "mean": float(quotient.mean() / (np.sqrt(2) * scale)),
        "variance": float(quotient.var() / scale**2),
        "correlation": float(np.corrcoef(quotient, error[1:])[0, 1]),
    }


def rejects_gaussian(values: ArrayLike) -> bool:
    """Whether skewness and kurtosis of a record tell it from independent Gaussian noise (Jarque and Bera's test, at 0.1 %)."""
    from scipy.stats import jarque_bera

    return bool(jarque_bera(require_array("values", values, ndim=1)).pvalue < 1e-3)


def difference_quotient(measured: ArrayLike, sample_time: float) -> Float64[np.ndarray, " quotients"]:
    """(z_i - z_{i-1}) / sample_time of a record, shape (samples - 1,), in m/s."""
    require_number("sample_time", sample_time, above=0)
    return np.diff(require_array("measured", measured, ndim=1)) / sample_time


def quotient_covariance(deviation: float, sample_time: float) -> Float64[np.ndarray, "2 2"]:
    """Covariance of the errors of [difference quotient, position] at one instant.

    The first entry is (21), 2 s^2 / dt^2 (a variance, which the paper calls a standard deviation); the
    others follow in the same way: s^2 / dt between the two, s^2 of the position.
    """
    variance = require_number("deviation", deviation, at_least=0) ** 2
    require_number("sample_time", sample_time, above=0)
    return variance * np.array([[2 / sample_time**2, 1 / sample_time], [1 / sample_time, 1.0]])


def quotient_autocorrelation(lag: int) -> float:
    """Correlation of two difference quotients' errors `lag` samples apart: 1, -1/2, 0, 0, ..."""
    return {0: 1.0, 1: -0.5}.get(abs(lag), 0.0)


def quotient_cross_correlation(lag: int) -> float:
    """Correlation of the quotient's error with the position's error `lag` samples later.

    1/sqrt 2 at lag 0, -1/sqrt 2 at lag -1, else 0.
    """
    return {0: 1.0, -1: -1.0}.get(lag, 0.0) / np.sqrt(2)


class Correlations(NamedTuple):
    """Sample correlations of a record of errors at lags -`reach` .. `reach`."""

    lags: np.ndarray
    quotient: Float64[np.ndarray, " lags"]  # of the difference quotient with itself
    cross: Float64[np.ndarray, " lags"]  # of the quotient with the position's error `lag` samples later
    variance: float  # of the quotient, m^2/s^2


def correlations(error: ArrayLike, sample_time: float) -> Correlations:
    """Correlations found in a record of measurement errors (m), up to a lag of four samples."""
    quotient = difference_quotient(error, sample_time)
    position = error[1:] - error[1:].mean()
    centred = quotient - quotient.mean()
    lags = np.arange(-4, 5)
    return Correlations(
        lags,
        np.array([_correlation(centred, centred, lag) for lag in lags]),
        np.array([_correlation(centred, position, lag) for lag in lags]),
        float(centred.var()),
    )


def _correlation(first, second, lag) -> float:
    """Of first[i] with second[i + lag], normalised by the whole records."""
    samples = len(first)
    early, late = first[max(0, -lag) : samples - max(0, lag)], second[max(0, lag) : samples - max(0, -lag)]
    return float(early @ late / (samples * first.std() * second.std()))


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


def encoder_rejected(
    motion: Float64[np.ndarray, " samples"], encoder: Noise, sample_time: float, records: int, seed: int
) -> Bool[np.ndarray, " records"]:
    """In which records, each with another offset of the grid, a differentiated encoder's error is not Gaussian."""
    streams = [np.random.default_rng(stream) for stream in np.random.SeedSequence(seed).spawn(records)]
    errors = (encoder.measure(motion, stream) - motion for stream in streams)
    return np.array([rejects_gaussian(difference_quotient(error, sample_time)) for error in errors])


def differentiation(
    *,
    noise_law: str,
    record_samples: int,
    encoder_step: float,
    trajectory_shape: str,
    trajectory_frequency: float,
    seed: int,
) -> Values:
    """(20), (21) and what is said of the noises, in 40 records as in notebook 05."""
    records, deviation = 40, PRINTED_NOISE["large"]
    study = run_study(
        quotient_trial, records, seed, progress=False, noise=Noise(noise_law, deviation), samples=record_samples,
        sample_time=SAMPLE_TIME,
    )  # fmt: skip
    found: Values = {
        f"fixedpoint.{claim}": (study[quantity].mean(), mean_interval(study[quantity]))
        for claim, quantity in (("eq-20.mean", "mean"), ("eq-21.variance", "variance"))
    }
    beyond = np.abs(study["correlation"]) > 10 / np.sqrt(record_samples)
    motion = trajectory(trajectory_shape, trajectory_frequency, 1.0).position[:record_samples]
    rejected = encoder_rejected(motion, Noise("encoder", encoder_step), SAMPLE_TIME, records, seed)
    return found | {
        "fixedpoint.section-2c.not-independent": fraction(beyond),
        "fixedpoint.section-4.encoder-not-gaussian": fraction(rejected),
    }


# === What the notebook judges beside its answer =====================================================================


def appendix(page, *, seed: int, sample_time: float, deviation: float) -> None:
    """What this notebook judges beside its answer: a Kalman filter for models of first and second order.

    Parameters
    ----------
    page : workbook.appendix.Appendix
    seed : int
    sample_time, deviation : float
        s, and m of the measured position's noise.
    """
    page.text(FIRST_ORDER)
    ratios = {}
    for order, speeds in ((1, RATES), (2, 10 * RATES)):
        found = [kalman_over_low_pass(order, rate, deviation, sample_time, seed) for rate in speeds]
        ratios[order] = np.array([each["ratio"] for each in found])
        page.show(
            *(
                f"order {order}, rate {rate:.0e}: Kalman filter {each['kalman']:.2e}, computed {each['computed']:.2e}, "
                f"best low pass {each['low pass']:.2e}"
                for rate, each in zip(speeds, found, strict=True)
            )
        )
        name = "one" if order == 1 else "two"
        page.check(f"fixedpoint.section-4.first-order.{name}", np.median(ratios[order]), _ends(ratios[order]))
        own = [each["kalman"] / each["computed"] for each in found]
        page.check(f"fixedpoint.section-4.first-order.{name}-as-computed", np.median(own), _ends(own))
    page.conclude(
        "With a model of first order the Kalman filter has {first:.2f} of the error of the best low pass in the median, of second order "
        "{second:.2f}: what it gains is less there, as the paper says, but it computes its own error rightly in both.",
        "With a model of first order the Kalman filter has {first:.2f} of the error of the best low pass in the median, of second order "
        "{second:.2f}: it does not gain less there.",
        when=np.median(ratios[1]) < np.median(ratios[2]),
        first=np.median(ratios[1]),
        second=np.median(ratios[2]),
    )


FIRST_ORDER = r"""## "Mainly recommended for ... first order dynamical models"

Section IV gives as a reason that $x_1 = q$ and $x_2 = \dot q$ "are essentially not independent". We try it where nothing else is
wrong: models of first and second order, driven by white noise, with the position measured alone, the right $Q$ and $R$,

$$x_{k+1} = x_k + w_k \qquad\text{or}\qquad \dot q_{k+1} = \dot q_k + w_k,\quad q_{k+1} = q_k + \delta t\,\dot q_{k+1},\qquad z_k = q_k + n_k .$$

The Kalman filter's RMS error of the driven state, over that of the low pass (7) whose bandwidth is best on the same record (its
output, or the difference quotient of that), for four rates of the driving noise each; and over the error that it computes:"""

RATES = np.array([1e-6, 1e-5, 1e-4, 1e-3])  # deviation of w over a sample, in m; ten times that in m/s


def kalman_over_low_pass(
    order: int, rate: float, deviation: float, sample_time: float, seed: int, samples: int = 60_000
) -> dict[str, float]:
    """RMS errors of the driven state, the steady Kalman filter's and the best low pass's, and what the filter computes."""
    from scipy.linalg import solve_discrete_are
    from scipy.signal import lfilter

    rng = np.random.default_rng(seed)
    driven = np.cumsum(rate * rng.standard_normal(samples))
    position = driven if order == 1 else np.cumsum(sample_time * driven)
    measured = position + deviation * rng.standard_normal(samples)
    move = np.eye(order)
    move[-1, 0] = 1.0 if order == 1 else sample_time
    enters = rate * np.array([1.0, sample_time])[:order]
    sees = np.eye(order)[-1]
    before = solve_discrete_are(move.T, sees[:, None], np.outer(enters, enters), [[deviation**2]])
    gain = before @ sees / (before[-1, -1] + deviation**2)
    state, kalman = np.zeros(order), np.zeros(samples)
    for k, z in enumerate(measured):
        state = move @ state
        state = state + gain * (z - state[-1])
        kalman[k] = state[0]
    settled, errors = slice(samples // 10, None), []
    for bandwidth in np.geomspace(2.0, 1.9 / sample_time, 60):
        smooth, part = measured, bandwidth * sample_time
        for _ in range(3):  # (7) by Euler's rule, a pole at a time
            smooth = lfilter([0.0, part], [1.0, part - 1.0], smooth)
        if order == 2:
            smooth = np.diff(smooth, prepend=smooth[0]) / sample_time
        errors.append(np.sqrt(np.mean((smooth - driven)[settled] ** 2)))
    own = float(np.sqrt(np.mean((kalman - driven)[settled] ** 2)))
    computed = float(np.sqrt(before[0, 0] - gain[0] * before[-1, 0]))
    return {"kalman": own, "computed": computed, "low pass": min(errors), "ratio": own / min(errors)}


def _ends(values) -> tuple[float, float]:
    return float(np.min(values)), float(np.max(values))
