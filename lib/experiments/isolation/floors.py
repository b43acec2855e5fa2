"""Floors: how the three floor sensors are shaken, as shaped noise or as a recorded motion."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy import signal

from stillwork.base.bounds import Positive
from stillwork.base.checks import InputError, require_array, require_count, require_number
from stillwork.base.validation import check_fields

SAMPLE_RATE = 5000.0  # Hz, section 2 of the FeRLS paper
SENSORS = 3
FLAT_LEVEL = 1.5e-3  # m/s^2/sqrt(Hz): the plateau of Fig. 2, near BBN-B/C


@dataclass(frozen=True)
class ShapedFloor:
    """Independent white noise through a filter per sensor."""

    # second-order sections as in `scipy.signal.sosfilt`, gain 1 on the plateau
    sections: Float64[np.ndarray, "channels sections 6"]
    # standard deviation of the white noise that enters, m/s^2 a sample
    scale: Float64[np.ndarray, " channels"]
    sample_rate: Positive = SAMPLE_RATE  # Hz

    def __post_init__(self):
        check_fields(self)
        for rows in require_array("sections", self.sections, shape=(len(self.scale), None, 6)):
            if any(np.any(np.abs(np.roots(row[3:])) >= 1) for row in rows):
                raise InputError(
                    "sections: a pole lies on or outside the unit circle; design a stable filter"
                )

    @property
    def channels(self) -> int:
        return len(self.scale)

    def density(self, frequencies_hz: ArrayLike) -> Float64[np.ndarray, "channels frequencies"]:
        """Exact one-sided acceleration PSD, (m/s^2)^2/Hz: white noise of variance s^2 has 2 s^2 / rate."""
        f = require_array("frequencies_hz", frequencies_hz, ndim=1)
        gains = [np.abs(signal.freqz_sos(rows, f, fs=self.sample_rate)[1]) for rows in self.sections]
        return np.array(gains) ** 2 * (2 * self.scale**2 / self.sample_rate)[:, None]

    def acceleration(self, samples: int, seed: int) -> Float64[np.ndarray, "channels samples"]:
        """Realisation of `samples` samples, m/s^2, from rest."""
        require_count("samples", samples)
        noise = np.random.default_rng(seed).standard_normal((self.channels, samples)) * self.scale[:, None]
        return np.array([signal.sosfilt(rows, row) for rows, row in zip(self.sections, noise, strict=True)])


def flat_floor(
    low_pass_hz: float = 80.0,
    level: float | ArrayLike = FLAT_LEVEL,
) -> ShapedFloor:
    """The 'flat' floor of Fig. 2: a plateau (m/s^2/sqrt(Hz)) between second-order Butterworth filters, from 3 Hz on.

    The figure gives no number for the upper end. 80 Hz agrees with the published convergence, 1500 Hz is the
    literal reading of 'flat'. The sensors are excited independently, as by the paper's three shakers.
    """
    require_number("low_pass_hz", low_pass_hz, above=3.0, below=SAMPLE_RATE / 2)
    level = np.broadcast_to(require_array("level", level), SENSORS) * np.ones(SENSORS)
    ends = ((3.0, "highpass"), (low_pass_hz, "lowpass"))
    sections = np.vstack([signal.butter(2, *end, fs=SAMPLE_RATE, output="sos") for end in ends])
    sections = np.repeat(sections[None], SENSORS, axis=0)
    return ShapedFloor(sections, level * np.sqrt(SAMPLE_RATE / 2), SAMPLE_RATE)


def coloured_floor(low_pass_hz: float = 80.0, *, gain: float = 4.0) -> ShapedFloor:
    """The 'coloured' floor of Fig. 2: `flat_floor` raised at 40-90 Hz and around 150 Hz.

    The paper names the bands, not the heights: each is a second-order peak of about `gain` times the amplitude
    (4: 12 dB, assumed), at 60 Hz (the band's geometric mean), 50 Hz wide, and at 150 Hz, 30 Hz wide (assumed).
    """
    require_number("gain", gain, at_least=1.0)
    flat = flat_floor(low_pass_hz)
    sections = _peaks([(60.0, 50.0), (150.0, 30.0)], gain)
    raised = np.concatenate([flat.sections, np.tile(sections, (flat.channels, 1, 1))], axis=1)
    return ShapedFloor(raised, flat.scale, flat.sample_rate)


def _peaks(bands: list[tuple[float, float]], gain: float):
    """Sections of 1 + (gain - 1) sum of B over (centre, width), with B a resonator that is 1 at its centre."""
    resonators = [signal.iirpeak(centre, centre / width, fs=SAMPLE_RATE) for centre, width in bands]
    whole = np.ones(1)
    for _, a in resonators:
        whole = np.polymul(whole, a)
    raised = sum(np.polymul(b, np.polydiv(whole, a)[0]) for b, a in resonators)
    return signal.tf2sos(np.polyadd(whole, (gain - 1) * raised), whole)
