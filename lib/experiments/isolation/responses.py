"""Exact frequency responses of a twin as it is simulated, and the same paths as `control` objects."""

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy import signal

from experiments.isolation.twin import Twin
from stillwork.base.checks import InputError, require_array
from stillwork.estimation.mean_adaptation import Responses


def responses(twin: Twin, frequencies_hz: ArrayLike, feedback: bool = True) -> Responses:
    """Frequency responses of a twin, with the skyhook loop closed or open."""
    f = require_array("frequencies_hz", frequencies_hz, ndim=1)
    rate = twin.instruments.sample_rate
    if f.size == 0 or f.min() <= 0 or f.max() >= rate / 2:
        raise InputError(f"frequencies_hz must lie between 0 and {rate / 2:g} Hz, without the ends")
    delay = np.exp(-2j * np.pi * f / rate)
    actuator, parasitic, conditioning, skyhook, integrator, shaping = (
        _of_sections(sections, f, rate)
        for sections in (
            twin.instruments.actuator,
            twin.instruments.parasitic,
            twin.instruments.conditioning,
            twin.skyhook_filter,
            twin.integrator,
            twin.noise_shaping,
        )
    )
    plant = np.moveaxis(twin.plant.discrete(twin.sample_time).frequency_response(2 * np.pi * f), -1, 0)
    force, floor = plant[:, :, : twin.actuators], plant[:, :, twin.actuators :]
    open_path = (force + parasitic[:, None, None] * np.eye(twin.outputs)) * (actuator * delay)[:, None, None]
    disturbance = floor + open_path @ twin.plant.floor_inertia
    sensitivity = np.broadcast_to(np.eye(twin.outputs, dtype=complex), open_path.shape)
    if feedback:
        loop = np.eye(twin.outputs) + open_path * (skyhook * conditioning)[:, None, None]
        sensitivity = np.linalg.inv(loop)
        open_path, disturbance = np.linalg.solve(loop, open_path), np.linalg.solve(loop, disturbance)
    powers = integrator[:, None] ** np.arange(twin.feedforward.integrator_powers + 1)
    stack = (powers * conditioning[:, None])[:, :, None, None] * np.eye(twin.sensors)
    inverse = _of_sections(twin.error_filter, f, rate)
    return Responses(
        frequencies_hz=f,
        primary=conditioning[:, None, None] * disturbance,
        secondary=conditioning[:, None, None] * open_path,
        sensitivity=conditioning[:, None, None] * sensitivity,
        regressors=stack.reshape(len(f), twin.regressors, twin.sensors),
        shaping=shaping,
        error=inverse[:, None, None] * np.eye(twin.outputs),
        conditioning=conditioning,
    )


def _of_sections(sections: np.ndarray, f: np.ndarray, rate: float) -> np.ndarray:
    return _kept(np.ascontiguousarray(sections, float).tobytes(), f.tobytes(), rate)


@lru_cache(maxsize=64)  # several questions about one floor ask for the same filters, half of their time
def _kept(sections: bytes, frequencies_hz: bytes, rate: float) -> np.ndarray:
    found = signal.freqz_sos(np.frombuffer(sections).reshape(-1, 6), np.frombuffer(frequencies_hz), fs=rate)[
        1
    ]
    found.flags.writeable = False
    return found


# Gives an explorer its weights in time; notebooks take a dense grid.
COARSE_HZ = np.geomspace(0.05, 2400, 500)


def thinned(frequencies_hz: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Indices that paint a curve over a logarithmic axis without losing a peak, at most 480.

    Of 240 bins even in the logarithm the smallest and the largest value are kept, so that a mains line one bin
    wide is seen at its full height.
    """
    positive = np.flatnonzero(frequencies_hz > 0)
    f = frequencies_hz[positive]
    starts = np.unique(np.searchsorted(f, np.geomspace(f[0], f[-1], 240) * (1 - 1e-12)))
    bins = np.split(positive, starts[1:])
    return np.unique([pick(values[each]) + each[0] for each in bins for pick in (np.argmin, np.argmax)])
