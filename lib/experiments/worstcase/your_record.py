"""An input-output record of one's own: opened, its sensor noise read, models fitted and judged on unseen data."""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64
from scipy import signal

from experiments.worstcase.measured import MeasuredPair
from experiments.worstcase.total import total_least_squares
from stillwork.base.checks import InputError, require_array, require_count, require_number
from stillwork.estimation.min_max import solve_sweep
from stillwork.estimation.recursive import run_silently
from stillwork.estimation.recursive_settings import LeastSquares, MinMax
from stillwork.identification.regressors import exponential_bound, fir_regressors
from stillwork.signals.records import load_record, stated_unit, unit_factor

QUIETEST = 0.1  # share of the band whose density counts as sensor noise when nothing else is said
SETTLE_S = 1.0  # cut off after a band-pass
PARTS = (0.5, 0.25, 0.25)  # of the record: to fit, to choose the bound, to judge


class Spectra(NamedTuple):
    """What the two channels hold."""

    frequency: Float64[np.ndarray, " lines"]  # Hz
    input: Float64[np.ndarray, " lines"]  # density, unit^2/Hz
    output: Float64[np.ndarray, " lines"]
    coherence: Float64[np.ndarray, " lines"]


@dataclass(frozen=True)
class Pair:
    """An input, an output, and the noise of the sensors that measured them."""

    input: Float64[np.ndarray, " samples"]  # in `units`, band-passed alike, without their means
    output: Float64[np.ndarray, " samples"]
    sample_rate: float  # Hz
    band_hz: tuple[float, float]  # what passed
    units: tuple[str, str]  # SI units of input and output
    # standard deviation of the sensor noise of input and output in the band, in `units`
    noise: tuple[float, float]
    names: tuple[str, str]  # of the channels
    source: str  # file name
    noise_source: str  # where the noise was read

    @property
    def normalised(self) -> MeasuredPair:
        """Both channels over their noise: what total least squares needs, and nothing else minds."""
        return MeasuredPair(
            self.input / self.noise[0], self.output / self.noise[1], self.sample_rate, self.band_hz, 1.0
        )

    @property
    def gain(self) -> float:
        """What an estimate of the normalised pair is multiplied by, output unit per input unit."""
        return self.noise[1] / self.noise[0]


def open_pair(
    file: str | Path,
    *,
    channels: tuple[str, str] = ("", ""),
    units: tuple[str, str] = ("m/s^2", "m/s^2"),
    sample_rate: float | None = None,
    band_hz: tuple[float, float] = (0.0, 0.0),
    quiet_hz: tuple[float, float] = (0.0, 0.0),
    noise: tuple[float, float] = (0.0, 0.0),
) -> tuple[Pair, Spectra]:
    """Read a record of two channels, band-pass both alike, and find the noise of the sensors.

    Empty `channels` take the file's only two, in order: input and output, as `units` and `noise` have them; `sample_rate`
    is for files without a time or a rate. Without a `band_hz` everything passes but the mean. In `quiet_hz` the machine
    rests, so that what is seen is sensor noise, taken as white over the pass band; by default the quietest tenth of it,
    an upper bound on a white floor. `noise` are standard deviations in the pass band from a data sheet or a measurement
    at rest, in the file's units; 0: from `quiet_hz`.
    """
    factors, si = zip(*(unit_factor(unit) for unit in units), strict=True)
    named = [name for name in channels if name]
    if len(named) == 1:
        raise InputError("only one of input_channel and output_channel is given; give both or none")
    record = load_record(file, "1", sample_rate=sample_rate, channels=named or None)
    if len(record.names) != 2:
        raise InputError(
            f"{record.source} holds {len(record.names)} channels ({', '.join(record.names)}); name the two with "
            "input_channel and output_channel"
        )
    for side, name, unit, quantity in zip(("input", "output"), record.names, units, si, strict=True):
        stated = stated_unit(name)
        if stated and unit_factor(stated)[1] != quantity:
            raise InputError(
                f"{side}_unit is {unit}, but {record.source} names the channel {name!r}; give {side}_unit {stated}"
            )
    rate = record.sample_rate
    raw = record.signals * np.array(factors)[:, None]
    raw = raw - raw.mean(axis=1, keepdims=True)
    nyquist = rate / 2
    if any(band_hz):
        low, high = band_hz
        if not 0 < low < high < nyquist:
            raise InputError(
                f"band_hz is {low:g} to {high:g} Hz; {record.source} holds 0 to {nyquist:g} Hz: give a band inside "
                "it, or (0, 0) for everything but the mean"
            )
        sections = signal.butter(4, band_hz, "bandpass", fs=rate, output="sos")
        settled = min(int(SETTLE_S * rate), raw.shape[1] // 10)
        kept = signal.sosfilt(sections, raw)[:, settled:]
    else:
        low, high = 0.0, nyquist
        kept = raw
    segment = min(4096, raw.shape[1] // 8)
    frequency, densities = signal.welch(raw, rate, nperseg=segment)
    coherence = signal.coherence(*raw, rate, nperseg=segment)[1]
    levels, where = _noise(frequency, densities, (low, high), quiet_hz)
    given = [value * factor for value, factor in zip(noise, factors, strict=True)]
    for value in given:
        require_number("noise", value, at_least=0.0)
    found = tuple(float(stated or read) for stated, read in zip(given, levels, strict=True))
    if all(given):
        where = "as given"
    pair = Pair(
        np.ascontiguousarray(kept[0]),
        np.ascontiguousarray(kept[1]),
        rate,
        (float(low), float(high)),
        si,
        found,
        record.names,
        record.source,
        where,
    )
    return pair, Spectra(frequency, densities[0], densities[1], coherence)


def _noise(frequency, densities, band_hz, quiet_hz) -> tuple[np.ndarray, str]:
    """Standard deviations over the pass band from the densities, and where they were read."""
    width = band_hz[1] - band_hz[0]
    if any(quiet_hz):
        still = (frequency >= quiet_hz[0]) & (frequency <= quiet_hz[1])
        if still.sum() < 2:
            raise InputError(
                f"quiet_hz is {quiet_hz[0]:g} to {quiet_hz[1]:g} Hz and holds {int(still.sum())} spectral lines "
                f"({frequency[1]:.3g} Hz apart, up to {frequency[-1]:g} Hz); widen it, or give (0, 0)"
            )
        return np.sqrt(densities[:, still].mean(axis=1) * width), f"{quiet_hz[0]:g} to {quiet_hz[1]:g} Hz"
    inside = (frequency > max(band_hz[0], frequency[0])) & (frequency < band_hz[1])
    quietest = np.quantile(densities[:, inside], QUIETEST, axis=1)
    return np.sqrt(quietest * width), "the quietest tenth of the band"


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


def fit_pair(pair: Pair, taps: int, memory: int, factors: np.ndarray | None = None) -> Fitted:
    """FIR models by RLS, min-max and total least squares from the first half of a record, judged on the last quarter.

    The recursive estimators run over the first half and end with the exponential weights of their memory; total least
    squares takes its last `memory` samples. The bound is swept with the same weights, over these `factors` of the
    typical bound, and chosen on the third quarter, which no model was fitted to and none is judged on.
    """
    taps, memory = require_count("taps", taps), require_count("memory", memory, at_least=2)
    scaled = pair.normalised
    fit, choose, judge = parts(len(scaled.input))
    if memory <= 2 * taps or memory > fit.stop:
        raise InputError(
            f"memory is {memory} samples; give more than {2 * taps} (twice the taps) and at most {fit.stop} (the part "
            "of the record that is fitted)"
        )
    regressors, output = fir_regressors(scaled.input, taps), scaled.output
    forgetting = 1 - 1 / memory
    typical = scaled.typical_bound(taps, forgetting)
    bounds = {
        "min-max, typical bound": typical,
        "min-max, guaranteed bound": exponential_bound(3 * np.sqrt(taps), forgetting),
    }
    estimators = {
        "RLS": LeastSquares(forgetting, 1.0),
        **{name: MinMax(bound, forgetting) for name, bound in bounds.items()},
    }
    estimates = {
        name: run_silently(estimator, regressors[:, fit], output[fit]).estimates[:, -1]
        for name, estimator in estimators.items()
    }
    last = slice(fit.stop - memory, fit.stop)
    estimates["total least squares"] = total_least_squares(regressors[:, last].T, output[last]).estimate
    matrix, target = weighted_corner(regressors[:, fit], output[fit], forgetting)
    factors = np.geomspace(0.01, 10, 25) if factors is None else require_array("factors", factors, ndim=1)
    swept = solve_sweep(matrix, target, factors * typical)
    choosing, judging = (
        np.array([residual(regressors[:, part], output[part], one.estimate) for one in swept])
        for part in (choose, judge)
    )
    best = float(factors[np.argmin(choosing)])
    bounds["min-max, chosen bound"] = best * typical
    estimates["min-max, chosen bound"] = swept[int(np.argmin(choosing))].estimate
    return Fitted(
        {name: pair.gain * estimate for name, estimate in estimates.items()},
        *(
            {name: residual(regressors[:, part], output[part], one) for name, one in estimates.items()}
            for part in (last, judge)
        ),
        {name: pair.noise[0] * bound for name, bound in bounds.items()},
        pair.noise[0] * swept[0].threshold,
        factors,
        choosing,
        judging,
    )


def parts(samples: int) -> tuple[slice, slice, slice]:
    """The stretches of a record to fit, to choose the bound, and to judge."""
    first, second = round(PARTS[0] * samples), round((PARTS[0] + PARTS[1]) * samples)
    return slice(0, first), slice(first, second), slice(second, samples)


def weighted_corner(regressors, output, forgetting: float) -> tuple[np.ndarray, np.ndarray]:
    """Square A and b that say the same as all exponentially weighted rows: a rotation changes no residual."""
    weights = forgetting ** (np.arange(len(output) - 1, -1, -1) / 2)
    corner = np.linalg.qr(np.column_stack([regressors.T, output]) * weights[:, None], mode="r")
    return corner[:, :-1].copy(), corner[:, -1].copy()


def residual(regressors, output, estimate) -> float:
    """rms of what a model leaves over the rms of the output."""
    return float(np.linalg.norm(output - estimate @ regressors) / np.linalg.norm(output))


def window_lengths(taps: int, samples: int) -> list[int]:
    """Training windows from hardly longer than the model to an eighth of the record, at most 6400 samples."""
    longest = min(6400, samples // 8)
    if longest < 2 * taps:
        raise InputError(
            f"the record holds {samples} samples, too few for {taps} taps; give {16 * taps} samples or at most "
            f"{samples // 16} taps"
        )
    return np.unique(np.geomspace(1.25 * taps, longest, 7).round().astype(int)).tolist()
