"""The measured case: its studies and pictures, and what notebook 06 judges beside its answer."""

from dataclasses import replace
from itertools import product

import numpy as np
from jaxtyping import Float64
from scipy import signal

from experiments.worstcase.measured import paint_windows, residuals_of, window_residuals, windows_of
from experiments.worstcase.pairs import MeasuredPair, Spectra, open_pair, residual
from stillwork.base.checks import require_number
from stillwork.estimation.linear_fits import total_least_squares
from stillwork.estimation.min_max import qr_r, solve_sweep
from stillwork.estimation.recursive import track
from stillwork.identification.regressors import fir_regressors
from workbook import figures, paths
from workbook.studies import run_study


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
    return residuals_of(judged, replace(blows[0], noise=noisier * noise))


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
    factors = np.geomspace(0.1, 5, 9)
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


def appendix(
    page,
    *,
    pair: MeasuredPair,
    found: dict[str, list[np.ndarray]],
    lengths: list[int],
    taps: int,
    noisier: list[float],
    seed: int,
) -> None:
    """What this notebook judges beside its answer.

    Parameters
    ----------
    page : workbook.appendix.Appendix
    pair : MeasuredPair
    found : dict
        Residuals of the windows of each of `lengths`, by method.
    lengths : list of int
    taps : int
    noisier : list of float
        How much noisier the force sensor of the blows is made.
    seed : int
    """
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
    page.text("## Was the bound a good one?")
    factors = np.geomspace(0.05, 5, 17)
    swept = {length: bound_sweep(pair, taps, length, factors, 20) for length in (64, 320, 3200)}
    page.save("bound", paint_sweep(factors, swept))
    _of_total(page, pair, taps, seed)
    _of_blows(page, pair, taps, noisier, seed)


def _of_total(page, pair: MeasuredPair, taps: int, seed: int) -> None:
    page.text("""## Why total least squares fails

TLS assumes noise of one size on all columns of an exact relation. It fails even where that is true, with an FIR filter of random taps
driven by the recorded motion. Driven by white noise it nearly equals least squares. With one dominant tone some directions of the
regressors hold little but noise, and the smallest singular vector points along them.""")
    rng = np.random.default_rng(seed)
    motions = {"recorded": pair.input, "white": pair.input.std() * rng.standard_normal(len(pair.input))}
    for name, motion in motions.items():
        given = {"motion": motion, "noise": pair.noise, "taps": taps, "length": 1280}
        study = run_study(total_trial, 30, seed, progress=False, **given)
        page.show(
            f"{name:8s} TLS {np.median(study['total']):.2f}, least squares {np.median(study['least']):.2f}"
        )
        page.check(f"worstcase.real-record.total-{name}", np.median(study["total"] / study["least"]))


def _of_blows(page, pair: MeasuredPair, taps: int, noisier: list[float], seed: int) -> None:
    page.text("""## A broad-band record

Five hammer blows on a light structure, force and acceleration (from the pyFRF project, MIT licence;
`data/motion/impact_frf_25k6/SOURCE.md`), are thinned to 3.2 kHz. An FIR model from the first 64 samples of one blow predicts each of
the others. The force sensor's noise is too small to matter, so we add white noise of known size. At the left end none is added. Twenty
pairs of blows have six draws of the noise each.""")
    blows = load_blows()
    loudest = np.median([each.input.max() for each in blows])
    page.show(f"force sensor's noise {1e3 * blows[0].noise:.1f} mN, a blow {loudest:.0f} N")
    for name, each in (("record", pair), ("blow", blows[0])):
        sizes = np.linalg.svd(fir_regressors(each.input, taps)[:, :64].T, compute_uv=False)
        page.show(
            f"{name}: the weakest direction of the first 64 rows is {sizes[-1] / sizes[0]:.1g} of the strongest"
        )
    hit = [
        run_study(blow_trial, 6, seed, blows=blows, taps=taps, length=64, noisier=each, progress=False)
        for each in noisier
    ]
    for factor, study in zip(noisier, hit, strict=True):
        names = "least squares", "ridge", "min-max, typical bound"
        numbers = ", ".join(f"{name} {np.median(study[name]):.3f}" for name in names)
        page.show(f"{factor:3.0f} times the noise: {numbers}")
    residuals = {name: [study[name].ravel() for study in hit] for name in hit[0].values}
    page.save(
        "blows", paint_windows(noisier, residuals, "noise of the force sensor, in multiples of its own")
    )
    least, minmax = (np.array(residuals[name]) for name in ("least squares", "min-max, typical bound"))
    still, share = np.median(minmax[0] / least[0]), np.mean(minmax[1:] < least[1:])
    page.check("worstcase.real-record.blows", still)
    page.check("worstcase.real-record.noisy-blows", share)
    page.conclude(
        "On the blows, without added noise, min-max has {still:.3f} of the residual of least squares. With more noise it has the "
        "smaller residual in {share:.0%} of the pairs: no direction of these regressors is weak, so the bound shrinks signal.",
        "On the blows, without added noise, min-max has {still:.3f} of the residual of least squares; with more noise it has the "
        "smaller one in {share:.0%} of the pairs.",
        when=share < 0.5,
        still=still,
        share=share,
    )
