"""Poles of a machine from its frequency responses: the poly-reference least-squares complex frequency method (LSCF)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64
from numpy.typing import ArrayLike
from scipy.linalg import toeplitz

from stillwork.base.bounds import Vector
from stillwork.base.checks import InputError, require_array
from stillwork.base.validation import by_value, check_fields, checked

ORDERS = range(6, 41, 2)  # of the denominators, in each part of a band
WIDTH = 2.0  # highest over lowest frequency of a part; parts overlap by half
LOWEST = 64  # lines of the lowest part, where an octave holds too few for the lowest order
# powers of the response that an equation is divided by: what is high alone, and what is low too
WEIGHTS = (0.0, 0.5)
STRONGEST = 0.4  # damping ratio beyond which a pole is no resonance
# move of a stable pole from order to order: of its frequency, its damping; factor of the latter
STABLE_TOLERANCES = (5e-4, 0.3, 1.5)
MIN_STABLE_ORDERS = 3  # orders at which a pole must be stable


@by_value
@dataclass(frozen=True)
class Stabilisation:
    """A stabilisation diagram: the poles of every order, and which of them stay from order to order."""

    order: Int64[np.ndarray, " poles"]
    frequency: Float64[np.ndarray, " poles"]  # rad/s
    damping: Float64[np.ndarray, " poles"]  # ratio
    stable: Bool[np.ndarray, " poles"]

    def __post_init__(self):
        check_fields(self)
        if len({len(self.order), len(self.frequency), len(self.damping), len(self.stable)}) != 1:
            raise InputError(
                "order, frequency, damping and stable differ in length; give one of each per pole"
            )

    def settled(self) -> Float64[np.ndarray, "2 modes"]:
        """Frequency (rad/s) and damping ratio of poles that are stable at three orders or more, the most frequent first.

        Returns
        -------
        ndarray, shape (2, modes)
            Frequencies (rad/s) and damping ratios; no column if none is stable.

        Examples
        --------
        >>> omega = np.linspace(100.0, 200.0, 400)
        >>> response = 1 / (150.0**2 - omega**2 + 2j * 0.01 * 150 * omega)
        >>> identification.stabilisation(omega, response[:, None, None]).settled()[:, 0].round(3)  # rad/s, ratio
        array([1.5e+02, 1.0e-02])
        """
        poles = np.log([self.frequency[self.stable], self.damping[self.stable]])
        near, left = _near(poles, poles), np.ones(poles.shape[1], dtype=bool)
        found = [np.zeros((2, 0))]
        while left.any():
            often = (near[:, left].sum(axis=1) * left).argmax()
            group = near[often] & left
            if group.sum() < MIN_STABLE_ORDERS:
                break
            found.append(np.median(poles[:, group], axis=1, keepdims=True))
            left &= ~group
        return np.exp(np.hstack(found))


@checked
def stabilisation(omega: Vector, response: ArrayLike) -> Stabilisation:
    """Poles over orders in overlapping octaves, so that low and close resonances are resolved like high ones.

    Parameters
    ----------
    omega : array_like, shape (lines,)
        rad/s, ascending.
    response : array_like, shape (lines, outputs, inputs)
        Accelerance, or another response.

    Returns
    -------
    Stabilisation
        Poles of every order, and which of them are stable.

    Raises
    ------
    InputError
        When the lines do not ascend from above zero, or the response is zero at one of them.

    References
    ----------
    B. Peeters, H. Van der Auweraer, P. Guillaume and J. Leuridan, "The PolyMAX frequency-domain method: a new standard
    for modal parameter estimation?", Shock and Vibration 11 (2004).

    Examples
    --------
    >>> omega = np.linspace(100.0, 200.0, 400)
    >>> response = 1 / (150.0**2 - omega**2 + 2j * 0.01 * 150 * omega)
    >>> found = identification.stabilisation(omega, response[:, None, None])
    >>> settled = found.settled()[0]  # rad/s
    >>> bool(np.any(np.abs(settled - 150) < 0.1))
    True
    """
    response = require_array("response", response, shape=(len(omega), None, None), dtype=complex)
    size = np.sqrt(np.sum(np.abs(response) ** 2, axis=(1, 2)) / max(np.prod(response.shape[1:]), 1))
    if len(omega) < 2 or np.any(np.diff(omega) <= 0) or omega[0] <= 0 or not size.min() > 0:
        raise InputError("omega must ascend from above 0, and response be other than zero at every line")
    found = [(np.zeros(0, int), np.zeros((2, 0)), np.zeros(0, bool))]
    high, low = omega[-1], np.inf
    while low > omega[0]:
        low = high / WIDTH
        inside = (omega >= low) & (omega <= high)
        if inside.sum() < 4 * ORDERS[0]:
            low, inside = omega[0], np.arange(len(omega)) < LOWEST
        for power in WEIGHTS:
            found += _diagram(omega[inside], response[inside], size[inside] ** -power)
        high /= np.sqrt(WIDTH)
    order, poles, stable = (np.concatenate(each, axis=-1) for each in zip(*found, strict=True))
    frequency, damping = np.exp(poles)
    return Stabilisation(order.astype(np.int64), frequency, damping, stable)


def _diagram(omega, response, weight):
    """Poles of every order in one part of a band: order, logarithms of frequency and damping, whether stable."""
    orders = [order for order in ORDERS if 4 * order <= len(omega)]
    if not orders:
        return
    sums = _sums(omega, response, weight, orders[-1])
    before = np.zeros((2, 0))
    for order in orders:
        poles = _poles(sums, order, omega)
        size = np.abs(poles)
        damping = -poles.real / size
        edge = 0.02 * (omega[-1] - omega[0])
        kept = (damping > 1e-6) & (damping < STRONGEST)
        kept &= (poles.imag > omega[0] + edge) & (poles.imag < omega[-1] - edge)
        found = np.log([size[kept], damping[kept]])
        yield np.full(kept.sum(), order), found, _near(found, before).any(axis=1)
        before = found


def _near(one, other):
    """Whether poles, as logarithms of frequency and damping, are the same within what a stable one moves."""
    apart = np.abs(one[:, :, None] - other[:, None, :])
    alike, share, factor = STABLE_TOLERANCES
    return (apart[0] < np.maximum(alike, share * np.exp(one[1]))[:, None]) & (apart[1] < np.log(factor))


def _sums(omega, response, weight, order):
    """Sums over lines of 1, H and H'H, times z to the powers 0 to `order` and 0 to -`order` (real parts)."""
    turn = np.exp(1j * np.pi * (omega - omega[0]) / (omega[-1] - omega[0]))
    square = np.einsum("lop,loq->lpq", response.conj(), response)
    data = [np.ones((len(omega), 1)), response.reshape(len(omega), -1), square.reshape(len(omega), -1)]
    data = np.hstack(data) * (weight**2)[:, None]
    power, found = np.ones_like(turn), []
    for _ in range(order + 1):
        found.append([(power @ data).real, (power.conj() @ data).real])
        power = power * turn
    up, down = np.swapaxes(found, 0, 1)
    return up, down, response.shape[1:]


def _poles(sums, order, omega):
    up, down, (outputs, inputs) = sums
    matrices = [toeplitz(down[: order + 1, k], up[: order + 1, k]) for k in range(up.shape[1])]
    own = np.asarray_chkfinite(matrices[0])  # LAPACK's least squares print what they think of NaN
    cross = np.array(matrices[1 : 1 + outputs * inputs]).reshape(outputs, inputs, order + 1, -1)
    normal = np.array(matrices[1 + outputs * inputs :]).reshape(inputs, inputs, order + 1, -1)
    normal = normal.transpose(2, 0, 3, 1).reshape((order + 1) * inputs, -1)
    for each in cross.transpose(0, 2, 3, 1).reshape(outputs, order + 1, -1):
        normal = normal - each.T @ np.linalg.lstsq(own, each, rcond=1e-14)[0]
    normal = np.asarray_chkfinite(normal)
    below = np.linalg.lstsq(normal[:-inputs, :-inputs], -normal[:-inputs, -inputs:], rcond=1e-15)[0]
    companion = np.eye(order * inputs, k=inputs)
    companion[-inputs:] = -below.T
    try:
        values = np.linalg.eigvals(companion).astype(complex)
    except np.linalg.LinAlgError:  # of coefficients that a few lines far above all others have made huge
        return np.zeros(0, complex)
    found = np.log(values[values != 0]) * (omega[-1] - omega[0]) / np.pi
    return found[found.imag > 0] + 1j * omega[0]
