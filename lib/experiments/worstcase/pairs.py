"""Two channels of a machine as a pair of input and output: opened, and the noise of the sensors that measured them."""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64
from scipy import linalg, signal

from stillwork.base.checks import InputError, pluralise, require_count, require_number
from stillwork.signals.records import channel_unit, load_unscaled

QUIETEST = 0.1  # share of the band whose density counts as sensor noise when nothing else is said
SETTLE_S = 1.0  # cut off after a band-pass


@dataclass(frozen=True)
class MeasuredPair:
    """Two channels of one structure, band-passed alike, and the noise of the input's sensor."""

    # acceleration or force (m/s^2, N), and acceleration; band-passed to `band_hz`, so that the offsets and drifts of
    # the sensors are gone
    input: Float64[np.ndarray, " samples"]
    output: Float64[np.ndarray, " samples"]
    sample_rate: float  # Hz
    band_hz: tuple[float, float]  # pass band
    noise: float  # standard deviation of the input's sensor noise, taken as white over the band

    def typical_bound(self, taps: int, forgetting: float) -> float:
        """Norm of the weighted perturbation that noise of this band has; for white noise that of `noise_bound`.

        noise (sqrt(m r) + sqrt(taps)) with m = 1 / (1 - forgetting) and r the largest eigenvalue of the noise's
        correlation over the taps (Gordon's inequality): noise in a narrow band perturbs all rows in one direction.
        """
        low, high = 2 * np.array(self.band_hz) / self.sample_rate
        lags = np.arange(require_count("taps", taps))
        correlation = (high * np.sinc(high * lags) - low * np.sinc(low * lags)) / (high - low)
        largest = np.linalg.eigvalsh(linalg.toeplitz(correlation))[-1]
        memory = 1 / (1 - require_number("forgetting", forgetting, above=0.0, below=1.0))
        return float(self.noise * (np.sqrt(memory * largest) + np.sqrt(taps)))


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
    up to a quarter low where nearly all of the band is noise alone. `noise` are standard deviations in the pass band from a data sheet or a measurement
    at rest, in the file's units; 0: from `quiet_hz`.
    """
    named = [name for name in channels if name]
    if len(named) == 1:
        raise InputError("only one of input_channel and output_channel is given; give both or none")
    record = load_unscaled(file, sample_rate=sample_rate, channels=named or None)
    if len(record.names) != 2:
        raise InputError(
            f"{record.source} holds {pluralise(len(record.names), 'channel')} ({', '.join(record.names)}); name the two with "
            "input_channel and output_channel"
        )
    sides = zip(record.names, units, ("input_unit", "output_unit"), strict=True)
    factors, si = zip(*(channel_unit(record.source, *side) for side in sides), strict=True)
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
    given = [require_number("noise", n * f, at_least=0.0) for n, f in zip(noise, factors, strict=True)]
    found = tuple(float(stated or read) for stated, read in zip(given, levels, strict=True))
    if all(given):
        where = "as given"
    signals = (np.ascontiguousarray(each) for each in kept)
    band = float(low), float(high)
    pair = Pair(*signals, rate, band, si, found, record.names, record.source, where)
    return pair, Spectra(frequency, *densities, coherence)


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


def residual(matrix, target, estimate) -> float:
    """rms of what a model leaves over the rms of the output."""
    return float(np.linalg.norm(target - matrix @ estimate) / np.linalg.norm(target))
