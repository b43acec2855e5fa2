"""Mass, damping, stiffness, actuator pole and delay of an isolator from its measured response to its actuators."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy import optimize

from stillwork.base.bounds import Positive, Vector
from stillwork.base.checks import InputError, require_array
from stillwork.base.validation import by_value, checked
from stillwork.machine.isolation import folded_force, held_force

MOST_LINES = 250  # of the refinement; more are thinned
START_LINES = 60  # of the trial of each start
POLES_HZ = np.geomspace(30.0, 4000.0, 7)  # tried as a start
DELAYS = np.array([0.0, 1.0, 2.0, 4.0])  # samples, likewise
WORST_FIT = 0.3  # relative residual from which on it is no isolator of this kind


@by_value
@dataclass(frozen=True)
class PathFit:
    """Acceleration per command s² (M s² + C s + K)^-1 w_a / (s + w_a) exp(-s (delay + T / 2)) sinc of a measurement."""

    mass: Float64[np.ndarray, "axes axes"]  # kg
    damping: Float64[np.ndarray, "axes axes"]  # N s/m
    stiffness: Float64[np.ndarray, "axes axes"]  # N/m
    actuator_pole: float  # rad/s
    delay: float  # s, without the hold of a sample
    residual: float  # rms over the lines, of the response's size at each


@checked
def fit_path(
    frequencies_hz: Vector, response: ArrayLike, sample_rate: Positive, *, folds: bool = False
) -> PathFit:
    """Fit an isolator to its acceleration along every actuator per command of every actuator.

    Parameters
    ----------
    frequencies_hz : array_like, shape (lines,)
    response : array_like, shape (lines, axes, axes)
        (m/s^2)/N.
    sample_rate : float
        Of the controller whose hold lies within the response, Hz.
    folds : bool
        Whether the response holds what sampling folds of the steps of the held command: no anti-alias filter took it off.

    Returns
    -------
    PathFit
        Least squares, each line relative to the response's size there; M, C and K are symmetric.

    Raises
    ------
    InputError
        When the lines are too few, or no such isolator has that response.
    """
    f = frequencies_hz
    seen = require_array("response", response, dtype=complex)
    axes = seen.shape[-1]
    seen = require_array("response", seen, shape=(len(f), axes, axes), dtype=complex)
    entries_each = axes * (axes + 1) // 2
    if len(f) * axes**2 < 6 * entries_each + 4:
        raise InputError(f"frequencies_hz holds {len(f)} lines, too few for a fit; give more")
    few = _thinned(f, START_LINES)
    kept = _thinned(f, MOST_LINES)
    misfit, linear = _problem(f[few], seen[few], sample_rate, folds)
    starts = []
    for pole in 2 * np.pi * POLES_HZ:
        for delay in DELAYS / sample_rate:
            entries = linear(pole, delay)
            starts.append((float(np.sum(misfit(entries, pole, delay) ** 2)), pole, delay, entries))
    _, pole, delay, entries = min(starts, key=lambda each: each[0])
    misfit, _ = _problem(f[kept], seen[kept], sample_rate, folds)
    scale = np.concatenate([np.abs(each).max() * np.ones(entries_each) for each in np.split(entries, 3)])

    def unpack(x):
        return x[:-2] * scale, np.exp(x[-2]), x[-1] / sample_rate

    start = np.concatenate([entries / scale, [np.log(pole), delay * sample_rate]])
    found = optimize.least_squares(
        lambda x: misfit(*unpack(x)), start, x_scale="jac", ftol=1e-7, xtol=1e-7, max_nfev=60
    )
    entries, pole, delay = unpack(found.x)
    mass, damping, stiffness = (_symmetric(each, axes) for each in np.split(entries, 3))
    residual = float(np.sqrt(np.sum(found.fun**2) / len(kept)))
    if residual > WORST_FIT or min(np.linalg.eigvalsh(each)[0] for each in (mass, stiffness)) <= 0:
        raise InputError(
            f"response is no isolator on springs (the best fit is off by {100 * residual:.0f} %, its mass or stiffness may be "
            "negative: check the sign); give the acceleration per force "
            "of every actuator, around the suspension's modes"
        )
    return PathFit(mass, damping, stiffness, float(pole), float(max(delay, 0.0)), residual)


def _thinned(f, count):
    """Places of at most `count` lines, evenly on a logarithmic axis."""
    wanted = np.geomspace(f[0], f[-1], count)
    return np.unique(np.searchsorted(f, wanted)) if len(f) > count else np.arange(len(f))


def _symmetric(entries, axes):
    whole = np.zeros((axes, axes))
    rows, columns = np.tril_indices(axes)
    whole[rows, columns] = whole[columns, rows] = entries
    return whole


def _problem(f, seen, sample_rate, folds):
    """Misfit of entries, pole and delay, and the entries that solve the linear problem for given pole and delay."""
    axes = seen.shape[-1]
    rows, columns = np.tril_indices(axes)
    s = 2j * np.pi * f[:, None, None]
    size = np.linalg.norm(seen, axis=(1, 2)) / axes

    def through(pole, delay):
        return held_force(f, pole, delay, 1 / sample_rate)[:, None, None]

    def linear(pole, delay):
        """(M s² + C s + K) H = 1, with H = P2 / (s² through), solved for the entries of M, C and K."""
        flexible = seen / (s * s * through(pole, delay))
        columns_of = []
        for power in (s * s, s, np.ones_like(s)):
            for i, j in zip(rows, columns, strict=True):
                unit = np.zeros((axes, axes))
                unit[i, j] = unit[j, i] = 1.0
                columns_of.append((power * (unit @ flexible)).ravel())
        matrix = np.stack(columns_of, axis=1)
        scale = np.linalg.norm(matrix, axis=0)
        target = np.tile(np.eye(axes).ravel(), len(f)).astype(complex)
        whole = np.vstack([matrix.real, matrix.imag]) / scale
        entries, *_ = np.linalg.lstsq(whole, np.concatenate([target.real, target.imag]), rcond=None)
        return entries / scale

    def misfit(entries, pole, delay):
        mass, damping, stiffness = (_symmetric(each, axes) for each in np.split(entries, 3))
        model = s * s * np.linalg.inv(s * s * mass + s * damping + stiffness) * through(pole, delay)
        if folds:  # far above the modes the acceleration is that of the mass alone
            more = folded_force(f, pole, delay, 1 / sample_rate)
            model = model + more[:, None, None] * np.linalg.inv(mass)
        off = ((model - seen) / size[:, None, None]).ravel() / axes
        return np.concatenate([off.real, off.imag])

    return misfit, linear
