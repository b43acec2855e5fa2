"""Your record: what this notebook alone needs."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from experiments.worstcase.measured import loudest_band, paint_windows
from experiments.worstcase.pairs import Pair, Spectra, residual
from stillwork.base.checks import InputError, pluralise, require_count
from stillwork.estimation.linear_fits import total_least_squares
from stillwork.estimation.min_max import qr_r, solve_silently, solve_sweep
from stillwork.estimation.recursive import track
from stillwork.identification.regressors import exponential_bound, exponential_weights, fir_regressors
from workbook import figures

# === Your record ==================================================================================================
# Models of an input-output record of one's own: fitted, the bound chosen, and judged on unseen data.


PARTS = (0.5, 0.25, 0.25)  # of the record: to fit, to choose the bound, to judge


@dataclass(frozen=True)
class Fitted:
    """Models of one record from its first part, and how they do on its last."""

    # impulse responses by method, output unit per input unit
    estimates: dict[str, Float64[np.ndarray, " taps"]]
    # inside, held_out: rms residual over rms output where the model was fitted, and on the last part; 1 is
    # the zero model
    inside: dict[str, float]
    held_out: dict[str, float]
    bounds: dict[str, float]  # eta of each min-max estimate, in the input's unit
    threshold: float  # from this bound on the estimate is zero, in the input's unit
    factors: Float64[np.ndarray, " factors"]  # bounds of the sweep over the typical bound
    # choosing, judging: residual of each on the part for choosing and on the last part
    choosing: Float64[np.ndarray, " factors"]
    judging: Float64[np.ndarray, " factors"]

    @property
    def chosen(self) -> float:
        """Factor with the smallest residual on the part for choosing."""
        return float(self.factors[np.argmin(self.choosing)])


def fit_pair(pair: Pair, taps: int, memory: int) -> Fitted:
    """FIR models by RLS, min-max and total least squares from the first half of a record, judged on the last quarter.

    The recursive estimators run over the first half and end with the exponential weights of their memory; total least
    squares takes its last `memory` samples. The bound is swept with the same weights, over 0.01 to 10 times the
    typical bound, and chosen on the third quarter, which no model was fitted to and none is judged on.
    """
    taps, memory = require_count("taps", taps), require_count("memory", memory, at_least=2)
    scaled = pair.normalised
    fit, choose, judge = parts(len(scaled.input))
    if memory <= 2 * taps or memory > fit.stop:
        raise InputError(
            f"memory is {pluralise(memory, 'sample')}; give more than {2 * taps} (twice the taps) and at most {fit.stop} (the part "
            "of the record that is fitted)"
        )
    regressors, output = fir_regressors(scaled.input, taps), scaled.output
    forgetting = 1 - 1 / memory
    typical = scaled.typical_bound(taps, forgetting)
    bounds = {
        "min-max, typical bound": typical,
        "min-max, guaranteed bound": exponential_bound(3 * np.sqrt(taps), forgetting),
    }
    settings = {"RLS": {"initial_covariance": 1.0}} | {name: {"bound": each} for name, each in bounds.items()}
    estimates = {
        name: track(regressors[:, fit], output[fit], forgetting, **each, silent=True).estimates[:, -1]
        for name, each in settings.items()
    }
    last = slice(fit.stop - memory, fit.stop)
    estimates["total least squares"] = total_least_squares(regressors[:, last].T, output[last])
    matrix, target = weighted_corner(regressors[:, fit], output[fit], forgetting)
    factors = np.geomspace(0.01, 10, 25)
    swept = solve_sweep(matrix, target, factors * typical)
    choosing, judging = (
        np.array([residual(regressors[:, part].T, output[part], one.estimate) for one in swept])
        for part in (choose, judge)
    )
    best = int(np.argmin(choosing))
    bounds["min-max, chosen bound"] = float(factors[best]) * typical
    estimates["min-max, chosen bound"] = swept[best].estimate
    return Fitted(
        {name: pair.gain * estimate for name, estimate in estimates.items()},
        *(
            {name: residual(regressors[:, part].T, output[part], one) for name, one in estimates.items()}
            for part in (last, judge)
        ),
        {name: pair.noise[0] * bound for name, bound in bounds.items()},
        pair.noise[0] * swept[0].threshold,
        factors,
        choosing,
        judging,
    )


def warnings_of(pair: Pair, fitted: Fitted, taps: int) -> list[str]:
    """A sentence for each thing in the record, or in what was found, that makes the table misleading."""
    said = []
    if fitted.chosen in (fitted.factors[0], fitted.factors[-1]):
        said.append(
            f"the chosen bound, {fitted.chosen:.2g} times the typical one, is an end of the range that was tried: a bound "
            "beyond it may do better"
        )
    if fitted.bounds["min-max, typical bound"] >= 0.5 * fitted.threshold:
        said.append(
            "the typical bound is more than half of the threshold from which the estimate is zero: the input's noise leaves "
            "little to learn from; use a longer memory, fewer taps, a narrower band or a better sensor"
        )
    lag = delay_of(pair)
    if not 0 <= lag < taps:
        said.append(
            f"the output follows the input by {lag} samples, outside the {taps} taps: give more taps, or shift or exchange "
            "the channels"
        )
    for name, values in zip(pair.names, (pair.input, pair.output), strict=True):
        spikes = spikes_in(values)
        if spikes:
            said.append(
                f"{name} has {pluralise(spikes, 'sample')} beyond {SPIKE:g} times its typical size: least squares, min-max and "
                "total least squares follow them; remove them, or use Huber's estimate"
            )
    likeness = np.corrcoef(pair.input, pair.output)[0, 1]
    if abs(likeness) > 1 - 1e-6:
        said.append("input and output are one channel up to a factor: a model between them says nothing")
    return said


def table_of(fitted: Fitted):
    """A row a model: its bound, and what it leaves where it was fitted and on the last quarter."""
    from pandas import DataFrame, Series

    columns = {
        "bound": Series(fitted.bounds).map("{:.3g}".format),
        "where fitted": Series(fitted.inside).map("{:.3f}".format),
        "held out": Series(fitted.held_out).map("{:.3f}".format),
    }
    return DataFrame(columns, index=list(fitted.held_out)).fillna("")


def described(pair: Pair) -> Iterator[str]:
    """What the record holds, sentence by sentence."""
    yield f"{pair.source}: {len(pair.input)} samples at {pair.sample_rate:.6g} Hz; noise from {pair.noise_source}."
    sides = zip(pair.names, (pair.input, pair.output), pair.noise, pair.units, strict=True)
    for name, values, noise, unit in sides:
        yield f"{name}: standard deviation {values.std():.4g}, of it noise {noise:.4g} {unit}."
    low, high, share = loudest_band(pair.output, pair.sample_rate)
    yield f"{share:.2f} of the output's power lies between {low:.4g} and {high:.4g} Hz."


SPIKE = 12.0  # times the median of |x| over 0.6745, the deviation of Gaussian noise; a sine reaches 1.0, a hammer's blow more


def spikes_in(values: np.ndarray) -> int:
    """Samples far beyond what the bulk of a signal reaches."""
    sizes = np.abs(values - np.median(values))
    return int(np.sum(sizes > SPIKE * np.median(sizes) / 0.6745))


def delay_of(pair: Pair) -> int:
    """Lag of the output behind the input with the largest correlation of the whitened channels, samples."""
    count = 2 ** int(np.ceil(np.log2(2 * len(pair.input))))
    lines = np.conj(np.fft.rfft(pair.input, count)) * np.fft.rfft(pair.output, count)
    frequency = np.fft.rfftfreq(count, 1 / pair.sample_rate)
    inside = (frequency >= pair.band_hz[0]) & (frequency <= pair.band_hz[1]) & (np.abs(lines) > 0)
    sizes = np.where(inside, np.abs(lines), 1.0)
    answer = np.abs(np.fft.irfft(np.where(inside, lines / sizes, 0.0), count))
    lag = int(answer.argmax())
    return lag if lag < count // 2 else lag - count


def parts(samples: int) -> tuple[slice, slice, slice]:
    """The stretches of a record to fit, to choose the bound, and to judge."""
    first, second = round(PARTS[0] * samples), round((PARTS[0] + PARTS[1]) * samples)
    return slice(0, first), slice(first, second), slice(second, samples)


def weighted_corner(regressors, output, forgetting: float) -> tuple[np.ndarray, np.ndarray]:
    """Square A and b that say the same as all exponentially weighted rows: a rotation changes no residual."""
    weights = exponential_weights(len(output), forgetting)[:, None]
    corner = qr_r(np.column_stack([regressors.T, output]) * weights)
    return corner[:, :-1].copy(), corner[:, -1].copy()


def window_lengths(taps: int, samples: int) -> list[int]:
    """Training windows from hardly longer than the model to an eighth of the record, at most 6400 samples."""
    longest = min(6400, samples // 8)
    if longest < 2 * taps:
        raise InputError(
            f"the record holds {pluralise(samples, 'sample')}, too few for {pluralise(taps, 'tap')}; give {16 * taps} samples or at most "
            f"{samples // 16} taps"
        )
    return np.unique(np.geomspace(1.25 * taps, longest, 7).round().astype(int)).tolist()


# === Your record pictures =========================================================================================
# Pictures of an input-output record of one's own (notebook 07).


STYLES = {
    "RLS": (figures.BLACK, "-"),
    "total least squares": (figures.RED, ":"),
    "min-max, typical bound": (figures.BLUE, "-"),
    "min-max, chosen bound": (figures.RED, "--"),
    "min-max, guaranteed bound": (figures.PURPLE, "-."),
}
USELESS = 1.5  # a residual beyond which a model is not drawn


def paint_pair(pair: Pair, spectra: Spectra):
    """Densities of input and output with the noise taken, and their coherence."""
    figure, panels = figures.new(3, 1, height=5.4, sharex=True)
    shown = spectra.frequency > 0
    level = np.array(pair.noise) ** 2 / (pair.band_hz[1] - pair.band_hz[0])
    band = max(pair.band_hz[0], spectra.frequency[1]), pair.band_hz[1]
    rows = zip(("input", "output"), pair.names, pair.units, level, (figures.BLUE, figures.RED), strict=True)
    for axes, (side, name, unit, noise, colour) in zip(panels[:2], rows, strict=True):
        style = {"lw": 0.8, "color": colour, "label": f"{side}: {figures.literal(name)}"}
        axes.loglog(spectra.frequency[shown], getattr(spectra, side)[shown], **style)
        axes.loglog(band, [noise, noise], color=figures.BLACK, label="sensor noise taken, over the pass band")
        axes.set_ylabel(f"density (({_nice(unit)})²/Hz)")
        axes.legend()
    panels[2].semilogx(
        spectra.frequency[shown], spectra.coherence[shown], lw=0.8, color=figures.GREEN, label="coherence"
    )
    panels[2].set(xlabel="frequency (Hz)", ylabel="coherence", ylim=(0, 1))
    return figure


def paint_models(pair: Pair, fitted: Fitted):
    """Impulse responses, and predictions of the output on the first 80 samples of the part that is judged."""
    figure, (left, right) = figures.new(2, 1, height=5.2)
    taps = len(next(iter(fitted.estimates.values())))
    lags = np.arange(taps) / pair.sample_rate * 1e3
    start = parts(len(pair.output))[2].start
    regressors = fir_regressors(pair.input, taps)
    stretch = slice(start, min(start + 80, len(pair.output)))
    times = np.arange(stretch.start, stretch.stop) / pair.sample_rate
    right.plot(times, pair.output[stretch], color=figures.GREY, lw=3.5, alpha=0.4, label="measured")
    apart = []  # what the panels cannot show
    for name, estimate in fitted.estimates.items():
        if fitted.held_out[name] >= USELESS or not estimate.any():
            apart.append(f"{name}: " + ("too far off to draw" if estimate.any() else "zero"))
            continue
        colour, line = STYLES[name]
        left.plot(lags, estimate, line, color=colour, lw=1.1, label=name)
        right.plot(times, estimate @ regressors[:, stretch], line, color=colour, lw=1.2, label=f"_{name}")
    left.text(0.02, 0.02, "\n".join(apart), transform=left.transAxes, va="bottom", fontsize=7)
    left.set(xlabel="lag (ms)", ylabel=f"impulse response ({_per(pair)})", title="models")
    right.set(xlabel="time (s)", ylabel=f"output ({_nice(pair.units[1])})")
    right.set(title="prediction on the last quarter")
    figure.legend(loc="outside lower center", ncols=3)
    return figure


def _per(pair: Pair) -> str:
    return "-" if pair.units[0] == pair.units[1] else f"({_nice(pair.units[1])})/({_nice(pair.units[0])})"


def _nice(unit: str) -> str:
    return unit.replace("^2", "²")


def paint_bounds(pair: Pair, fitted: Fitted):
    """Residual against the bound on the part for choosing and on the part that is judged."""
    figure, axes = figures.new(1, 1, height=3.2)
    typical = fitted.bounds["min-max, typical bound"]
    etas = fitted.factors * typical
    axes.semilogx(
        etas,
        fitted.choosing,
        "o-",
        markersize=3,
        color=figures.GREEN,
        label="third quarter, to choose the bound",
    )
    axes.semilogx(
        etas, fitted.judging, "o-", markersize=3, color=figures.BLUE, label="last quarter, to judge"
    )
    axes.axhline(fitted.held_out["RLS"], color=figures.BLACK, lw=0.9, label="RLS on the last quarter")
    for kind in ("typical", "guaranteed", "chosen"):
        name = f"min-max, {kind} bound"
        axes.axvline(fitted.bounds[name], color=STYLES[name][0], ls="--", lw=0.9, label=f"{kind} bound")
    axes.axvline(fitted.threshold, color=figures.GREY, ls=":", lw=0.9, label="estimate zero from here on")
    axes.set(xlabel=f"bound η ({_nice(pair.units[0])})", ylabel="rms residual / rms output")
    figures.legend_below(axes, 3)
    return figure


def paint_lengths(lengths: list[int], found: dict[str, list[np.ndarray]]):
    """Residual on the next window against the length of the training window; in decades where it gets small."""
    figure = paint_windows(lengths, found)
    [axes] = figure.axes
    smallest = min(np.quantile(values, 0.25) for windows in found.values() for values in windows)
    if smallest < 0.2:
        axes.set(yscale="log", ylim=(0.6 * smallest, 1.8))
    else:
        axes.set_ylim(0, 1.6)
    return figure


def record_explorer(pair: Pair, memory: int) -> Callable:
    """Explorer: the model for another length and another bound."""
    scaled = pair.normalised
    fit, _, judge = parts(len(scaled.input))
    forgetting = 1 - 1 / memory
    recent = slice(max(0, fit.stop - min(8 * memory, 8000)), fit.stop)
    later = slice(judge.start, min(judge.start + 8000, judge.stop))

    def paint(taps: int, bound: float):
        """Impulse responses for `taps` and `bound` times the typical bound."""
        regressors = fir_regressors(scaled.input, taps)
        matrix, target = weighted_corner(regressors[:, recent], scaled.output[recent], forgetting)
        eta = bound * scaled.typical_bound(taps, forgetting)
        found = (
            ("least squares", figures.BLACK, np.linalg.lstsq(matrix, target, rcond=None)[0]),
            ("min-max", figures.BLUE, solve_silently(matrix, target, eta).estimate),
        )
        lags = np.arange(taps) / pair.sample_rate * 1e3
        figure, axes = figures.new(1, 1, height=3.0)
        for name, colour, estimate in found:
            left = residual(regressors[:, later].T, scaled.output[later], estimate)
            label = f"{name}: leaves {100 * left:.1f} % of the output"
            axes.plot(lags, pair.gain * estimate, "o-", markersize=3, color=colour, label=label)
        axes.set(xlabel="lag (ms)", ylabel=f"impulse response ({_per(pair)})")
        axes.legend()
        return figure

    return paint
