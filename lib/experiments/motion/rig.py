"""The over-actuated test rig of chapter 6: published modes on a free plate that stands in for the machine."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float64
from numpy.polynomial import legendre
from numpy.typing import ArrayLike
from scipy import linalg

from stillwork.base.rounding import first_largest
from stillwork.base.toml_files import read_numbers
from stillwork.control.decoupling import Decoupling
from stillwork.lti.modal import ModalModel
from workbook import paths

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


def plate_modes(aspect: float, poisson: float, modes: int) -> PlateModes:
    r"""Flexible modes of a thin free plate, which minimise the energies of Kirchhoff's theory.

    The strain energy is :math:`\frac D2\int w_{xx}^2 + w_{yy}^2 + 2\nu w_{xx}w_{yy} + 2(1-\nu)w_{xy}^2`; the free
    edges are its natural boundary conditions, so polynomials need not meet any. Modes of unlike symmetry are
    computed apart, which also tells modes of equal frequency apart.
    """
    size = DEGREE + 1
    bend, slope, cross = _integrals(DEGREE)
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


CORNERS = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]], dtype=float)  # signs of (x, y), counter-clockwise
POSITIONS = tuple(tuple(k for k in range(4) if k != out) for out in range(4))  # sensors in use, section 6.1


@cache
def _file() -> dict:
    return read_numbers(paths.data("motion", "rig.toml"))


def published() -> dict:
    """What chapter 6 prints: frequencies, damping, noise, sample rate (SI units, Hz where the name says so)."""
    return _file().table("published")


def assumed() -> dict:
    """What chapter 6 leaves open, as it is assumed here."""
    return _file().table("assumed")


@dataclass(frozen=True)
class Geometry:
    """A free plate with four actuators near its corners and four sensors, all placed alike in both axes."""

    length: float  # m, along x
    width: float  # m, along y
    mass: float  # kg
    poisson: float
    actuators: float  # distance from the centre over half a side, both axes
    sensors: tuple[float, float]  # the same along x and along y
    left_out: int = 3  # corner without an actuator in the experiments

    @property
    def half(self) -> Float64[np.ndarray, "2"]:
        """Half the sides (m)."""
        return np.array([self.length, self.width]) / 2

    @property
    def actuator_places(self) -> Float64[np.ndarray, "4 2"]:
        """x and y of the four actuators (m)."""
        return CORNERS * self.actuators * self.half

    @property
    def sensor_places(self) -> Float64[np.ndarray, "4 2"]:
        """x and y of the four sensors (m)."""
        return CORNERS * np.array(self.sensors) * self.half

    @property
    def used(self) -> tuple[int, ...]:
        """The three actuators of the experiments."""
        return tuple(k for k in range(4) if k != self.left_out)

    @property
    def inertia(self) -> Float64[np.ndarray, "3"]:
        """Mass (kg) and moments of inertia about x and y (kg m^2) of a uniform plate."""
        return self.mass * np.array([1, self.width**2 / 12, self.length**2 / 12])

    @property
    def edges(self) -> Float64[np.ndarray, "3"]:
        """Scales that turn (z, rx, ry) into motions of the edges in m: 1, half the width, half the length."""
        return np.array([1, self.half[1], self.half[0]])

    @property
    def edge_masses(self) -> Float64[np.ndarray, "3"]:
        """Mass that each motion of the edges feels (kg): M, M/3 and M/3 for a uniform plate."""
        return self.inertia / self.edges**2


def assumed_geometry() -> Geometry:
    """The geometry of ``data/motion/rig.toml``."""
    a = assumed()
    names = ("length", "width", "mass", "poisson", "actuators", "left_out")
    return Geometry(
        **{name: a[name] for name in names},
        sensors=tuple(a["sensors"]),
    )


def rigid_shapes(places: Float64[np.ndarray, "points 2"]) -> Float64[np.ndarray, "points 3"]:
    """Height at points of a rigid plate for unit (z, rx, ry): 1, y, -x."""
    x, y = places.T
    return np.stack([np.ones_like(x), y, -x], axis=1)


def rig_model(geometry: Geometry, higher_modes: int | None = None) -> ModalModel:
    """The plate with all four actuators and sensors: force (N) to height (m).

    The shapes of the first eight flexible modes are the plate's, in the order of its frequencies; their
    frequencies and damping are those of Table 6.1. The plate's next modes follow in the plate's own proportion
    to the eighth, with the damping of the eighth.
    """
    p = published()
    table = 2 * np.pi * np.array(p["frequencies_hz"])
    known = len(table)
    more = assumed()["higher_modes"] if higher_modes is None else higher_modes
    plate = plate_modes(geometry.width / geometry.length, geometry.poisson, known + more)
    higher = table[-1] * plate.parameters[known:] / plate.parameters[known - 1]
    damping = np.concatenate([np.zeros(3), p["damping"], np.full(more, p["damping"][-1])])

    def shapes(places: Float64[np.ndarray, "4 2"]) -> Float64[np.ndarray, "4 modes"]:
        flexible = plate.shapes(*(places / geometry.half).T) / np.sqrt(geometry.mass)
        return np.hstack([rigid_shapes(places) / np.sqrt(geometry.inertia), flexible])

    inputs, outputs = shapes(geometry.actuator_places).T, shapes(geometry.sensor_places)
    return ModalModel(
        np.concatenate([np.zeros(3), table, higher]), damping, inputs, outputs, np.zeros((4, 4))
    )


@dataclass(frozen=True)
class EdgeDecoupling(Decoupling):
    """Decoupling whose directions are motions of the edges, all in m.

    u and q hold z, and rx and ry times half the width and half the length. So singular values over directions compare
    like with like.
    """

    edges: Float64[np.ndarray, "3"]  # `Geometry.edges`
    masses: Float64[np.ndarray, "3"]  # kg, `Geometry.edge_masses`


def decoupling(geometry: Geometry, actuators: tuple[int, ...], sensors: tuple[int, ...]) -> EdgeDecoupling:
    """Rigid-body decoupling (4.12): pseudo-inverses of the rigid shapes at actuators and sensors."""

    def inverse(places: Float64[np.ndarray, "4 2"], chosen: tuple[int, ...]) -> np.ndarray:
        return np.linalg.pinv(rigid_shapes(places[list(chosen)]) / geometry.edges)

    actuation = inverse(geometry.actuator_places, actuators).T
    sensing = inverse(geometry.sensor_places, sensors)
    return EdgeDecoupling(actuation, sensing, geometry.edges, geometry.edge_masses)


def excitation(geometry: Geometry, actuators: tuple[int, ...]) -> Float64[np.ndarray, "flexible 3"]:
    """What a unit command along each direction puts into the eight published modes (1/sqrt(kg))."""
    shapes = rig_model(geometry, higher_modes=0).input_shapes[3:, list(actuators)]
    return shapes @ decoupling(geometry, actuators, (0, 1, 2)).actuation
