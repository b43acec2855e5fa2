"""Measured cases: an accelerometer predicted from another, both noisy, and from the force of hammer blows."""

import numpy as np
from scipy import signal

from experiments.worstcase.pairs import MeasuredPair, residual
from stillwork.base.checks import InputError, require_count
from stillwork.estimation.linear_fits import total_least_squares
from stillwork.estimation.min_max import solve_silently
from stillwork.identification.regressors import fir_regressors
from workbook import figures

METHODS = (
    ("least squares", figures.BLACK, "o--"),
    ("total least squares", figures.RED, "v--"),
    ("ridge", figures.GREEN, "s-"),
    ("min-max, typical bound", figures.BLUE, "o-"),
    ("min-max, guaranteed bound", figures.PURPLE, "^-"),
)


def loudest_band(values: np.ndarray, sample_rate: float) -> tuple[float, float, float]:
    """Where a signal's power lies: ends of the 8 Hz wide band that holds most, Hz, and its share of the power."""
    frequency, power = signal.welch(values, sample_rate, nperseg=min(len(values), 4096))
    count = max(round(8.0 / frequency[1]), 1)
    held = np.convolve(power, np.ones(count), "valid")
    first = int(held.argmax())
    return float(frequency[first]), float(frequency[first + count - 1]), float(held[first] / power.sum())


def window_residuals(
    pair: MeasuredPair, taps: int, lengths: list[int], most: int
) -> dict[str, list[np.ndarray]]:
    """Out-of-sample residuals: an FIR model from each window predicts the window that follows.

    By method, for each length: rms residual over rms output in every window; 1 is the zero model. At most `most`
    windows a length, spread over the record.
    """
    regressors = fir_regressors(pair.input, require_count("taps", taps))
    of_lengths = [
        residuals_of([(fit, [later]) for fit, later in windows_of(pair, regressors, length, most)], pair)
        for length in lengths
    ]
    return {name: [found[name] for found in of_lengths] for name, *_ in METHODS}


Window = tuple[np.ndarray, np.ndarray]  # regressors, a row per sample, and outputs


def windows_of(pair: MeasuredPair, regressors, length: int, most: int) -> list[tuple[Window, Window]]:
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


def residuals_of(judged: list[tuple[Window, list[Window]]], pair: MeasuredPair) -> dict[str, np.ndarray]:
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


def paint_windows(lengths: list[float], found: dict[str, list[np.ndarray]]):
    """Out-of-sample residual against the length of the training window; bars are quartiles."""
    figure, axes = figures.new(height=3.8)
    above, places = [], np.arange(len(lengths))
    for number, (name, colour, style) in enumerate(METHODS):
        low, middle, high = np.transpose([np.quantile(values, (0.25, 0.5, 0.75)) for values in found[name]])
        if middle.min() > 1.6:  # drawn by words alone
            above.append(f"{name}: above the frame, {middle.min():.2g} to {middle.max():.2g}")
            continue
        if np.all(low == 1) and np.all(high == 1):
            above.append(f"{name}: 1 everywhere, as predicting zero")
            continue
        if middle.max() > 1.6:
            name += " (leaves the frame)"
        beside = places + 0.12 * (number - 2)
        look = {
            "yerr": [middle - low, high - middle],
            "fmt": style[0],
            "ms": 4,
            "color": colour,
            "elinewidth": 1,
        }
        axes.errorbar(beside, middle, label=name, **look)
    axes.axhline(1, color=figures.GREY, linewidth=0.8, label="predicting zero")
    axes.set(xlabel="training window (samples)", ylabel="rms residual / rms output", ylim=(0.4, 1.6))
    axes.set_xticks(places, [f"{length:g}" for length in lengths])
    if above:
        axes.text(0, 1.02, "\n".join(above), transform=axes.transAxes, va="bottom", fontsize=7)
    axes.legend(ncols=2, loc="upper right")
    return figure
