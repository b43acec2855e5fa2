"""The measured case: its studies and pictures, and what notebook 06 judges beside its answer."""

from dataclasses import replace
from itertools import product

import numpy as np

from experiments.worstcase.measured import window_residuals, windows_of
from experiments.worstcase.pairs import MeasuredPair, Spectra, open_pair, residual
from stillwork.base.checks import require_number
from stillwork.estimation.min_max import qr_r, solve_sweep
from stillwork.estimation.recursive import track
from stillwork.identification.regressors import exponential_bound, fir_regressors
from workbook import figures, paths


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
        settings = {
            "RLS": {"initial_covariance": 1 / pair.noise**2},
            "ridge": {"penalty": memory * pair.noise**2},
            "min-max, typical bound": {"bound": pair.typical_bound(taps, forgetting)},
        }
        for name, each in settings.items():
            errors = track(regressors, pair.output, forgetting, **each, silent=True).errors[start:]
            found[name].append(np.sqrt(np.mean(errors**2)) / scale)
    return {name: np.array(values) for name, values in found.items()}


def bound_sweep(pair: MeasuredPair, taps: int, length: int, factors: np.ndarray, most: int) -> np.ndarray:
    """Median out-of-sample residual of min-max when the bound is `factors` times the typical one."""
    regressors = fir_regressors(pair.input, taps)
    typical = pair.typical_bound(taps, 1 - 1 / length)
    windows, found = windows_of(pair, regressors, length, most), []
    for fit, later in windows:
        # a rotation of the rows changes no residual: taps + 1 of them say all
        corner = qr_r(np.column_stack(fit))
        swept = solve_sweep(corner[:, :-1], corner[:, -1], factors * typical)
        found.append([residual(*later, solution.estimate) for solution in swept])
    return np.median(found, axis=0)


def load_pair(band_hz: tuple[float, float], quiet_hz: tuple[float, float]) -> tuple[MeasuredPair, Spectra]:
    """The shipped record `structure_accel_3k2`, channels 2 (input) and 3 (output), and its spectra."""
    file = paths.data("worstcase", "structure_accel_3k2/structure_accel_20s.npz")
    pair, spectra = open_pair(file, band_hz=band_hz, quiet_hz=quiet_hz)
    return MeasuredPair(pair.input, pair.output, pair.sample_rate, pair.band_hz, pair.noise[0]), spectra


def exchange(pair: MeasuredPair, spectra: Spectra, quiet_hz: tuple[float, float]) -> MeasuredPair:
    """The pair with input and output exchanged, and the noise of the other sensor in the quiet band."""
    still = (spectra.frequency >= quiet_hz[0]) & (spectra.frequency <= quiet_hz[1])
    noise = np.sqrt(spectra.output[still].mean() * (pair.band_hz[1] - pair.band_hz[0]))
    return MeasuredPair(pair.output, pair.input, pair.sample_rate, pair.band_hz, float(noise))


def bounds_by_memory(pair: MeasuredPair, taps: int, memories: tuple[int, ...]):
    """A row a memory (samples): the bound that covers every case and the typical one, m/s^2."""
    from pandas import DataFrame

    every = 3 * pair.noise * np.sqrt(taps)
    rows = {m: (exponential_bound(every, 1 - 1 / m), pair.typical_bound(taps, 1 - 1 / m)) for m in memories}
    return DataFrame(rows.values(), index=rows, columns=["guaranteed", "typical"]).rename_axis("memory")


def paint_spectra(pair: MeasuredPair, spectra: Spectra, quiet_hz: tuple[float, float]):
    """Densities of both channels with the sensor noise read from the quiet band, and their coherence."""
    figure, (upper, lower) = figures.new(2, 1, height=4.4, sharex=True)
    shown = spectra.frequency > 5
    frequency = spectra.frequency[shown]
    upper.loglog(frequency, spectra.input[shown], linewidth=0.8, label="input, channel 2")
    upper.loglog(frequency, spectra.output[shown], linewidth=0.8, label="output, channel 3")
    level = pair.noise**2 / (pair.band_hz[1] - pair.band_hz[0])
    taken = "sensor noise taken, over the pass band"
    upper.loglog(pair.band_hz, [level, level], color=figures.BLACK, label=taken)
    upper.set_ylabel("density ((m/s²)²/Hz)")
    upper.legend()
    lower.semilogx(frequency, spectra.coherence[shown], linewidth=0.8, color=figures.GREEN, label="coherence")
    lower.axvspan(*quiet_hz, color=figures.GREY, alpha=0.25, lw=0, label="band where the noise is read")
    lower.set(xlabel="frequency (Hz)", ylabel="coherence", ylim=(0, 1))
    lower.legend(loc="upper left")
    return figure


def paint_tracking(memories: list[int], found: dict[str, np.ndarray]):
    """One-step prediction error of the recursive estimators against their memory."""
    figure, axes = figures.new(height=3.0)
    colours = {"RLS": figures.BLACK, "ridge": figures.GREEN, "min-max, typical bound": figures.BLUE}
    for name, values in found.items():
        axes.semilogx(memories, values, "o-", markersize=4, color=colours[name], label=name)
    axes.axhline(1, color=figures.GREY, linewidth=0.8, label="predicting zero")
    axes.set(xlabel="memory 1 / (1 − λ) (samples)", ylabel="rms error / rms output", ylim=(0.4, 1.1))
    axes.legend()
    return figure


def paint_sweep(factors: np.ndarray, found: dict[int, np.ndarray]):
    """Median out-of-sample residual against the bound, for several window lengths."""
    figure, axes = figures.new(height=3.0)
    for length, values in found.items():
        axes.semilogx(factors, values, "o-", markersize=3, label=f"window of {length} samples")
    axes.axvline(1, color=figures.BLACK, linewidth=0.8, linestyle="--", label="bound from the sensor noise")
    axes.set(xlabel="bound over the typical norm of the sensor noise")
    axes.set(ylabel="median rms residual / rms output")
    axes.legend()
    return figure


def explore_sweep(taps: int, length: int):
    """`paint_sweep` for another model and window."""
    pair, _ = load_pair((100.0, 1500.0), (300.0, 600.0))
    factors = np.geomspace(0.1, 5, 7)
    return paint_sweep(factors, {int(length): bound_sweep(pair, int(taps), int(length), factors, 10)})


SHIFT = 500  # samples by which the windows are moved


def later(pair: MeasuredPair) -> MeasuredPair:
    """The record from so many samples on: windows at other places."""
    return replace(pair, input=pair.input[SHIFT:], output=pair.output[SHIFT:])


def over_models(pair: MeasuredPair, taps: tuple[int, ...], longest: int, most: int) -> dict[str, np.ndarray]:
    """What is concluded of 32 taps and one place of the windows, for each of `taps` at two places; by entry.

    ``short-windows``: the smallest share of the windows of two and of five times the taps in which min-max beats least
    squares. ``long-windows`` and ``ridge``: median residual of min-max over that of least squares, and that of ridge over
    that of min-max, with the longest window.
    """
    found = {"short-windows": [], "long-windows": [], "ridge": []}
    for each, count in product((pair, later(pair)), taps):
        residuals = window_residuals(each, count, [2 * count, 5 * count, longest], most)
        least, ridge, ours = (
            residuals[name] for name in ("least squares", "ridge", "min-max, typical bound")
        )
        found["short-windows"].append(min(np.mean(ours[k] < least[k]) for k in (0, 1)))
        found["long-windows"].append(np.median(ours[2]) / np.median(least[2]))
        found["ridge"].append(np.median(ridge[2]) / np.median(ours[2]))
    return {name: np.array(values) for name, values in found.items()}


# === What the notebook judges beside its answer =====================================================================


def appendix(page, *, found: dict[str, list[np.ndarray]], lengths: list[int]) -> None:
    """What this notebook judges beside its answer: `found` has the residuals of the windows of each of `lengths`, by method."""
    page.text(
        "## The windows in numbers\n\nMedian residuals, and the share of windows in which min-max is better."
    )
    page.show("window  " + "  ".join(f"{name:>25s}" for name in found))
    for i, length in enumerate(lengths):
        page.show(f"{length:6d}  " + "  ".join(f"{np.median(values[i]):25.3f}" for values in found.values()))
    for other in ("least squares", "ridge"):
        pairs = zip(found["min-max, typical bound"], found[other], strict=True)
        page.show(
            f"beats {other:13s}: " + " ".join(f"{np.mean(ours < theirs):.2f}" for ours, theirs in pairs)
        )
