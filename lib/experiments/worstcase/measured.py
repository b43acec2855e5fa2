"""Measured cases: an accelerometer predicted from another, both noisy, and from the force of hammer blows."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64
from scipy import signal

from experiments.worstcase.pairs import MeasuredPair, residual
from stillwork.base.checks import InputError, require_count, require_number
from stillwork.estimation.linear_fits import total_least_squares
from stillwork.estimation.min_max import qr_r, solve_silently, solve_sweep
from stillwork.estimation.recursive import run_silently
from stillwork.estimation.recursive_settings import LeastSquares, MinMax, Ridge
from stillwork.identification.regressors import fir_regressors
from workbook import figures, paths

METHODS = (
    ("least squares", figures.BLACK, "o--"),
    ("total least squares", figures.RED, "v--"),
    ("ridge", figures.GREEN, "s-"),
    ("min-max, typical bound", figures.BLUE, "o-"),
    ("min-max, guaranteed bound", figures.PURPLE, "^-"),
)


def load_blows() -> list[MeasuredPair]:
    """The shipped hammer blows on a light structure, force and acceleration, one of eight samples kept of 25.6 kHz.

    A blow lasts a millisecond: what the force sensor shows in the second half of its record is noise.
    """
    file = paths.data("motion", "impact_frf_25k6/impact_hammer_5_hits.npz")
    with np.load(file, allow_pickle=False) as archive:
        force, answer = (signal.decimate(archive[name], 8, ftype="fir") for name in ("force_n", "accel_m_s2"))
        rate = float(archive["fs_hz"]) / 8
    noise = float(np.median(force[:, force.shape[1] // 2 :].std(axis=1)))
    return [MeasuredPair(*blow, rate, (0.0, rate / 2), noise) for blow in zip(force, answer, strict=True)]


def blow_trial(
    rng: np.random.Generator, blows: list[MeasuredPair], taps: int, length: int, noisier: float
) -> dict[str, Float64[np.ndarray, " pairs"]]:
    """An FIR model from each blow predicts the others, by a force sensor that noise makes `noisier` times as noisy.

    By method: rms residual over rms output on the first `length` samples, for all ordered pairs of blows.
    """
    noise = blows[0].noise
    added = noise * np.sqrt(require_number("noisier", noisier, at_least=1.0) ** 2 - 1)
    inputs = (blow.input + added * rng.standard_normal(len(blow.input)) for blow in blows)
    windows = [
        (fir_regressors(force, taps)[:, :length].T, each.output[:length])
        for force, each in zip(inputs, blows, strict=True)
    ]
    judged = [(window, windows[:k] + windows[k + 1 :]) for k, window in enumerate(windows)]
    return _residuals(judged, replace(blows[0], noise=noisier * noise))


def loudest_band(values: np.ndarray, sample_rate: float) -> tuple[float, float, float]:
    """Where a signal's power lies: ends of the 8 Hz wide band that holds most, Hz, and its share of the power."""
    frequency, power = signal.welch(values, sample_rate, nperseg=min(len(values), 4096))
    count = max(round(8.0 / frequency[1]), 1)
    held = np.convolve(power, np.ones(count), "valid")
    first = int(held.argmax())
    return float(frequency[first]), float(frequency[first + count - 1]), float(held[first] / power.sum())


def total_trial(
    rng: np.random.Generator, motion: np.ndarray, noise: float, taps: int, length: int
) -> dict[str, float]:
    """Total against plain least squares on a machine that is exactly an FIR filter, with noise on both channels.

    A stretch of `motion` drives a filter of random, fading taps; input and output get white noise of one size, as
    total least squares presumes. ``total``, ``least``: rms residual over rms output on the window that follows.
    """
    start = rng.integers(len(motion) - 2 * length - taps)
    motion = motion[start : start + 2 * length + taps]
    response = rng.standard_normal(taps) * np.exp(-np.arange(taps) / 8)
    output = signal.lfilter(response, 1.0, motion) + noise * rng.standard_normal(len(motion))
    matrix = fir_regressors(motion + noise * rng.standard_normal(len(motion)), taps)[:, taps:].T
    output = output[taps:]
    estimates = {
        "total": total_least_squares(matrix[:length], output[:length]),
        "least": np.linalg.lstsq(matrix[:length], output[:length])[0],
    }
    return {
        name: residual(matrix[length:], output[length:], estimate) for name, estimate in estimates.items()
    }


def window_residuals(
    pair: MeasuredPair, taps: int, lengths: list[int], most: int
) -> dict[str, list[np.ndarray]]:
    """Out-of-sample residuals: an FIR model from each window predicts the window that follows.

    By method, for each length: rms residual over rms output in every window; 1 is the zero model. At most `most`
    windows a length, spread over the record.
    """
    regressors = fir_regressors(pair.input, require_count("taps", taps))
    of_lengths = [
        _residuals([(fit, [later]) for fit, later in _windows(pair, regressors, length, most)], pair)
        for length in lengths
    ]
    return {name: [found[name] for found in of_lengths] for name, *_ in METHODS}


Window = tuple[np.ndarray, np.ndarray]  # regressors, a row per sample, and outputs


def _windows(pair: MeasuredPair, regressors, length: int, most: int) -> list[tuple[Window, Window]]:
    """Pairs of neighbouring windows, spread over the record: to fit, then to predict."""
    taps, samples = regressors.shape
    if not taps < length <= (samples - taps) // 2:
        raise InputError(f"lengths holds {length}; give more than {taps} and at most half of the record")
    starts = np.arange(taps, samples - 2 * length + 1, 2 * length)
    starts = starts[np.unique(np.linspace(0, len(starts) - 1, most).astype(int))]

    def window(start) -> Window:
        part = slice(start, start + length)
        return regressors[:, part].T, pair.output[part]

    return [(window(start), window(start + length)) for start in starts]


def _residuals(judged: list[tuple[Window, list[Window]]], pair: MeasuredPair) -> dict[str, np.ndarray]:
    """By method: what the model of each window leaves of those that go with it."""
    found = {name: [] for name, *_ in METHODS}
    for fit, others in judged:
        for name, estimate in _estimates(*fit, pair).items():
            found[name] += [residual(*other, estimate) for other in others]
    return {name: np.array(values) for name, values in found.items()}


def _estimates(matrix, target, pair) -> dict[str, np.ndarray]:
    rows, taps = matrix.shape
    noise, typical = pair.noise, pair.typical_bound(taps, 1 - 1 / rows)
    guaranteed = 3 * noise * np.sqrt(rows * taps)  # every entry off by three deviations at once
    penalised = matrix.T @ matrix + rows * noise**2 * np.eye(taps)
    return {
        "least squares": np.linalg.lstsq(matrix, target, rcond=None)[0],
        "total least squares": total_least_squares(matrix, target),
        "ridge": np.linalg.solve(penalised, matrix.T @ target),
        "min-max, typical bound": solve_silently(matrix, target, typical).estimate,
        "min-max, guaranteed bound": solve_silently(matrix, target, guaranteed).estimate,
    }


def tracking_residuals(pair: MeasuredPair, taps: int, memories: list[int]) -> dict[str, np.ndarray]:
    """One-step prediction errors of the recursive estimators over the whole record, against memory length (samples).

    By method: rms prediction error over rms output, from ten memory lengths of the longest memory on.
    """
    regressors = fir_regressors(pair.input, taps)
    start = min(10 * max(memories), len(pair.output) // 2)
    scale = np.sqrt(np.mean(pair.output[start:] ** 2))
    found = {name: [] for name in ("RLS", "ridge", "min-max, typical bound")}
    for memory in memories:
        forgetting = 1 - 1 / require_number("memories", memory, above=1.0)
        estimators = {
            "RLS": LeastSquares(forgetting, 1 / pair.noise**2),
            "ridge": Ridge(memory * pair.noise**2, forgetting),
            "min-max, typical bound": MinMax(pair.typical_bound(taps, forgetting), forgetting),
        }
        for name, estimator in estimators.items():
            errors = run_silently(estimator, regressors, pair.output).errors[start:]
            found[name].append(np.sqrt(np.mean(errors**2)) / scale)
    return {name: np.array(values) for name, values in found.items()}


def bound_sweep(pair: MeasuredPair, taps: int, length: int, factors: np.ndarray, most: int) -> np.ndarray:
    """Median out-of-sample residual of min-max when the bound is `factors` times the typical one."""
    regressors = fir_regressors(pair.input, taps)
    typical = pair.typical_bound(taps, 1 - 1 / length)
    windows, found = _windows(pair, regressors, length, most), []
    for fit, later in windows:
        # a rotation of the rows changes no residual: taps + 1 of them say all
        corner = qr_r(np.column_stack(fit))
        swept = solve_sweep(corner[:, :-1], corner[:, -1], factors * typical)
        found.append([residual(*later, solution.estimate) for solution in swept])
    return np.median(found, axis=0)


def paint_windows(
    lengths: list[float], found: dict[str, list[np.ndarray]], label: str = "training window (samples)"
):
    """Out-of-sample residual against the length of the training window, or what `label` says; bars are quartiles."""
    figure, axes = figures.new(height=3.6)
    for number, (name, colour, style) in enumerate(METHODS):
        low, middle, high = np.transpose([np.quantile(values, (0.25, 0.5, 0.75)) for values in found[name]])
        if middle.min() > 1.6:
            name += " (above the frame)"
        elif middle.max() > 1.6:
            name += " (leaves the frame)"
        places = np.array(lengths) * 1.03 ** (number - 2)  # side by side
        look = {"yerr": [middle - low, high - middle], "fmt": style, "markersize": 4, "color": colour}
        axes.errorbar(places, middle, label=name, capsize=2, **look)
    axes.axhline(1, color=figures.GREY, linewidth=0.8, label="predicting zero")
    axes.set(xscale="log", xlabel=label, ylabel="rms residual / rms output")
    axes.set(ylim=(0.4, 1.6))
    axes.legend(ncols=2)
    return figure
