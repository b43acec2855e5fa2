"""Mode shapes of a free rectangular Kirchhoff plate by the Ritz method with Legendre polynomials."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float64
from numpy.polynomial import legendre
from numpy.typing import ArrayLike
from scipy import linalg

from stillwork.base.checks import InputError, require_count
from stillwork.base.rounding import first_largest

# of the polynomials along each side; the first fourteen modes then hold to a hundredth of a per cent
DEGREE = 13


@dataclass(frozen=True)
class PlateModes:
    r"""Flexible modes, sorted by frequency, on the square :math:`-1\le\xi,\eta\le1` that the plate is mapped to."""

    parameters: Float64[np.ndarray, " modes"]  # omega length^2 sqrt(mass per area / bending stiffness)
    # of the products of normalised Legendre polynomials
    coefficients: Float64[np.ndarray, "modes degrees degrees"]

    def shapes(self, xi: ArrayLike, eta: ArrayLike) -> Float64[np.ndarray, "points modes"]:
        """Shapes at points of the square, scaled to a mean square of one over the plate."""
        if not np.abs([xi, eta]).max() <= 1:
            raise InputError("xi and eta must lie between -1 and 1; a point is off the plate")
        degree = self.coefficients.shape[1] - 1
        return np.einsum("pm,imn,pn->pi", _basis(xi, degree), self.coefficients, _basis(eta, degree))


def _basis(x: np.ndarray, degree: int, derivative: int = 0) -> np.ndarray:
    """Legendre polynomials with a mean square of one (or their derivatives), one column a degree."""
    sizes = np.diag(np.sqrt(2 * np.arange(degree + 1) + 1))
    return legendre.legval(x, legendre.legder(sizes, derivative, axis=0) if derivative else sizes).T


@cache
def _integrals(degree: int):
    """Means over the side of the products of derivatives: 2 with 2, 1 with 1, 0 with 2."""
    x, weight = legendre.leggauss(degree + 1)
    zero, one, two = (_basis(x, degree, k) for k in range(3))
    return tuple(
        left.T @ (weight[:, None] / 2 * right) for left, right in ((two, two), (one, one), (zero, two))
    )


def plate_modes(aspect: float, poisson: float, modes: int, degree: int = DEGREE) -> PlateModes:
    r"""Flexible modes of a thin free plate, which minimise the energies of Kirchhoff's theory.

    The strain energy is :math:`\frac D2\int w_{xx}^2 + w_{yy}^2 + 2\nu w_{xx}w_{yy} + 2(1-\nu)w_{xy}^2`; the free
    edges are its natural boundary conditions, so polynomials need not meet any. Modes of unlike symmetry are
    computed apart, which also tells modes of equal frequency apart.
    """
    require_count("modes", modes)
    size = require_count("degree", degree, at_least=3) + 1
    if 2 * modes + 3 > size**2:
        raise InputError(f"degree is {degree}, too low for {modes} modes; raise it")
    bend, slope, cross = _integrals(degree)
    eye, ratio = np.eye(size), 1 / aspect
    stiffness = 16 * (
        np.kron(bend, eye)
        + ratio**4 * np.kron(eye, bend)
        + ratio**2 * poisson * (np.kron(cross, cross.T) + np.kron(cross.T, cross))
        + ratio**2 * 2 * (1 - poisson) * np.kron(slope, slope)
    )
    order_x, order_y = np.divmod(np.arange(size**2), size)
    squares, vectors = [], []
    for parity in range(4):
        chosen = np.flatnonzero((order_x % 2 == parity // 2) & (order_y % 2 == parity % 2))
        values, shapes = linalg.eigh(stiffness[np.ix_(chosen, chosen)])
        rigid = (1, 1, 1, 0)[parity]  # z and both tilts; none is odd along both sides
        full = np.zeros((len(values) - rigid, size**2))
        full[:, chosen] = shapes.T[rigid:]
        squares.append(values[rigid:])
        vectors.append(full)
    squares, vectors = np.concatenate(squares), np.vstack(vectors)
    first = np.argsort(squares, kind="stable")[:modes]
    found = vectors[first]
    # On a square two coefficients are equal in size, and may be opposite: the first gives the sign.
    found *= np.sign([shape[first_largest(np.abs(shape))] for shape in found])[:, None]
    return PlateModes(np.sqrt(squares[first]), found.reshape(modes, size, size))
