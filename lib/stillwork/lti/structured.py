r"""Upper bounds of gains over real uncertain numbers: the structured singular value with its D and G scalings.

A sample of perturbed models shows what can happen, but proves no bound. With scalings
:math:`D_i>0,\;G_i` of each uncertain number at one frequency, an inequality proves the bound for all of their values
there (Fan, Tits and Doyle, IEEE Trans. Automatic Control 36 (1991), 25-38). Over an interval of frequencies the same
scalings hold until a Hamiltonian matrix has an imaginary eigenvalue: so no grid is needed between.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy import linalg

from stillwork.base.bounds import Natural, Positive
from stillwork.base.checks import InputError
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.lti.cones import minimise
from stillwork.lti.state_space import StateModel

MOST_INTERVALS = 2000  # of frequency, in one proof
IMAGINARY = 1e-7  # real part of an eigenvalue that counts as none, relative to the largest
STEP = 1.3  # of a frequency to the next, at first
MARGINS = (0.5, 0.2, 0.05, 0.01, 0.001)  # of the inequality, relative: the larger, the wider the interval
LEAST_SCALING = 1e-2  # times the margin, of balanced signals
LEAST_STEP = 1e-5  # relative progress below which a proof gives up


@by_value
@dataclass(frozen=True)
class GainProof:
    """Whether a gain is proven below a level for all values of the uncertain numbers.

    Attributes
    ----------
    proven : bool
    level : float
    omega : float, optional
        A frequency at which no proof was found, rad/s.

    Examples
    --------
    >>> model = lti.StateModel([[-1.0]], [[0.5, 1.0]], [[-1.0], [1.0]], np.zeros((2, 2)))
    >>> lti.prove_gain(model, 1, level=2.01).omega is None
    True
    """

    proven: bool
    level: float
    omega: float | None

    def __post_init__(self):
        check_fields(self)


@checked
def prove_gain(model: StateModel, uncertain: Natural, level: Positive) -> GainProof:
    r"""Prove that the H-infinity norm from w to z stays below a level for all :math:`|\delta_i|\le1`.

    The model's first inputs and outputs are closed by the uncertain real numbers, :math:`w_i=\delta_iz_i`; the others
    are w and z. That the perturbed model is stable for all of them is proven along with it.

    Parameters
    ----------
    model : StateModel
        Stable, in continuous time.
    uncertain : int
        How many uncertain numbers there are.
    level : float
        In units of z per unit of w.

    Returns
    -------
    GainProof
        Not `proven` does not mean that the level is exceeded: the bound has a gap, small for few numbers. What is
        proven is so up to the rounding of the eigenvalues that end an interval.

    Raises
    ------
    InputError
        When the model is unstable or in discrete time, or has no other inputs and outputs.
    MissingPackage
        When clarabel is not installed.

    References
    ----------
    Fan, Tits and Doyle, IEEE Trans. Automatic Control 36 (1991), 25-38; Ferreres, Magni and Biannic, Int. J. Robust
    and Nonlinear Control 13 (2003), 1179-1197.

    Examples
    --------
    The pole of x' = -(1 + delta / 2) x + w is between -0.5 and -1.5 rad/s, so the gain is 2 at most.

    >>> model = lti.StateModel([[-1.0]], [[0.5, 1.0]], [[-1.0], [1.0]], np.zeros((2, 2)))
    >>> lti.prove_gain(model, 1, level=2.01).proven, lti.prove_gain(model, 1, level=1.99).proven
    (True, False)
    """
    outputs, inputs = model.d.shape
    if not uncertain < min(outputs, inputs):
        raise InputError(
            f"uncertain is {uncertain}; leave an input and an output of the model's {inputs} and {outputs}"
        )
    if model.sample_time or not model.is_stable:
        raise InputError("model must be stable and in continuous time for this bound")
    rate = float(np.abs(model.poles).max()) if len(model.a) else 1.0
    a, (scale, _) = linalg.matrix_balance(model.a / rate, permute=False, separate=True)
    slow = StateModel(a, model.b / scale[:, None] / rate, model.c * scale, model.d)
    least = 1e-3 * float(np.abs(slow.poles).min()) if len(a) else 1.0
    at, proven_to, step, intervals = least, 0.0, STEP, 0
    while intervals < MOST_INTERVALS:
        weights = _scalings(slow.frequency_response([at])[:, :, 0], level, uncertain)
        low, high = (at, at) if weights is None else _valid(slow, weights, at)
        if weights is None or low > proven_to:  # it does not reach back to what is proven
            if step < LEAST_STEP or at <= proven_to:
                return GainProof(False, level, at * rate)
            step /= 4
        else:
            proven_to, intervals = max(high, proven_to), intervals + 1
            if proven_to == np.inf:
                return GainProof(True, level, None)
            step = min(2 * step, STEP)
        at = max(proven_to, least) * (1 + step) if proven_to else least * step
    return GainProof(False, level, at * rate)


def _scalings(response: np.ndarray, level: float, n: int) -> tuple[np.ndarray, np.ndarray, float] | None:
    """D, G and 1 / level^2 at one frequency that prove the level there, with a margin where there is one; else None."""
    scaled, unit = _balanced(response / np.r_[np.ones(n), np.full(len(response) - n, level)][:, None], n)
    performance, inputs = scaled[n:].conj().T @ scaled[n:], scaled.shape[1]
    crosses, squares = [], []
    for row, one in zip(scaled, np.eye(n, inputs), strict=False):
        crosses.append(_real(1j * (np.outer(one, row) - np.outer(row.conj(), one))))
        squares.append(np.outer(row.conj(), row))
    for margin in MARGINS:
        fixed = _real(performance - np.diag(np.r_[np.zeros(n), np.full(inputs - n, 1 - margin)]))
        if not n:
            if np.linalg.eigvalsh(fixed)[-1] < 0:
                return np.zeros(0), np.zeros(0), 1 / level**2
            continue
        own = [
            _real(square - (1 - margin) * np.diag(one))
            for square, one in zip(squares, np.eye(n, inputs), strict=True)
        ]
        least = LEAST_SCALING * margin  # a scaling near zero proves nothing beside its own frequency
        parts = partial(_inequality, fixed=fixed, terms=np.array([*own, *crosses]), least=least)
        found, _ = minimise(np.r_[np.ones(n), np.zeros(n)], parts)
        if found is not None:
            return np.maximum(found[:n], 0.0) * unit**2, found[n:] * unit**2, 1 / level**2
    return None


def _inequality(x: np.ndarray, fixed: np.ndarray, terms: np.ndarray, least: float) -> list[np.ndarray]:
    """What must be definite of D, G = x, and by how much each D exceeds the least."""
    return [-(fixed + np.tensordot(x, terms, 1)), *(x[: len(x) // 2, None] - least)]


def _balanced(response: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """The response with its first n outputs and inputs in units that make rows and columns alike, and the units."""
    if not n:
        return response, np.ones(0)
    size = np.maximum(np.abs(response), 1e-14 * np.abs(response).max() + 1e-300)
    whole = np.zeros((max(size.shape),) * 2)
    whole[: size.shape[0], : size.shape[1]] = size
    _, (scale, _) = linalg.matrix_balance(whole, permute=False, separate=True)
    unit = 1 / scale[:n] * scale[n]  # the performance keeps its unit
    scaled = response.copy()
    scaled[:n] *= unit[:, None]
    scaled[:, :n] /= unit
    return scaled, unit


def _real(matrix: np.ndarray) -> np.ndarray:
    """A Hermitian matrix as a symmetric one, definite when it is."""
    return np.block([[matrix.real, -matrix.imag], [matrix.imag, matrix.real]])


def _valid(
    model: StateModel, weights: tuple[np.ndarray, np.ndarray, float], omega: float
) -> tuple[float, float]:
    """Frequencies around `omega` over which the inequality of these scalings holds; none where it does not hold there.

    It turns where the Hamiltonian matrix of its quadratic form has an imaginary eigenvalue.
    """
    d, g, kappa = weights
    n, (outputs, inputs) = len(d), model.d.shape
    q = np.diag(np.r_[d, np.full(outputs - n, kappa)])
    r = -np.diag(np.r_[d, np.ones(inputs - n)])
    cross = np.zeros((inputs, outputs), complex)  # w* (j G) z and its conjugate
    cross[:n, :n] = 1j * np.diag(g)

    def form(response: np.ndarray) -> np.ndarray:
        mixed = cross @ response
        return response.conj().T @ q @ response + mixed + mixed.conj().T + r

    unit = 1 / np.sqrt(np.r_[d, np.ones(inputs - n)])

    def largest(response: np.ndarray) -> float:
        return float(np.linalg.eigvalsh(form(response) * unit * unit[:, None])[-1])

    if not largest(model.frequency_response([omega])[:, :, 0]) < -MARGINS[-1] / 2:
        return np.inf, -np.inf
    a, b, c = model.a, model.b * unit, model.c  # inputs in units of their own weights
    through = form(model.d.astype(complex)) * unit * unit[:, None]
    if not len(a):
        return 0.0, np.inf
    s = c.T @ (q @ model.d + cross.conj().T) * unit
    if np.linalg.cond(through) > 1e14:
        return np.inf, -np.inf
    fed = np.linalg.solve(through, np.hstack([s.conj().T, b.T]))
    upper = a - b @ fed[:, : len(a)]
    hamiltonian = np.block(
        [[upper, -b @ fed[:, len(a) :]], [s @ fed[:, : len(a)] - c.T @ q @ c, -upper.conj().T]]
    )
    values = linalg.eigvals(hamiltonian)
    crossings = np.sort(values.imag[np.abs(values.real) <= IMAGINARY * np.maximum(np.abs(values), IMAGINARY)])
    below, above = crossings[crossings <= omega], crossings[crossings > omega]
    ends_negative = largest(model.d.astype(complex)) < 0
    high = above[0] if len(above) else (np.inf if ends_negative else omega)
    low = below[-1] if len(below) and below[-1] > 0 else 0.0
    if not low and not largest(model.frequency_response([0.0])[:, :, 0]) < -MARGINS[-1] / 2:
        low = omega  # at standstill it holds by rounding alone
    return float(low), float(high)
