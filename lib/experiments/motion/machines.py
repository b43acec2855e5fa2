"""The machines of the observer thesis (stage, five-mass chain, two-inertia drive), and a measured structure as a stage."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy import linalg

from stillwork.base.checks import InputError, require_choice
from stillwork.base.toml_files import read_numbers
from stillwork.control.setpoint import Setpoint, point_to_point
from stillwork.estimation.observer import NoiseIntensities
from stillwork.identification.frequency_response import Identified, impact_response
from stillwork.identification.modal_fit import ModalFit
from stillwork.lti.modal import ModalModel, modal_model
from stillwork.lti.state_space import StateModel
from workbook import paths


def parameters(machine: str) -> dict:
    """Published parameters of a machine from ``data/motion/machines.toml``, SI units."""
    tree = read_numbers(paths.data("motion", "machines.toml"), lists=False)
    return tree.table(machine)


def chain_matrix(springs: ArrayLike) -> Float64[np.ndarray, "nodes nodes"]:
    """Stiffness (or damping) matrix of masses in a row, free at both ends, from the springs between them."""
    springs = np.asarray(springs, float)
    difference = np.diff(np.eye(len(springs) + 1), axis=0)
    return difference.T @ (springs[:, None] * difference)


def stage(damping_ratio: float | None = None) -> ModalModel:
    """Stage of Fig. 3.1 and Table 3.2: force on the actuator mass to the positions y1..y7 of the other masses.

    Flexible modes are damped by 0.005, which Table 3.4 shows (Table 3.2 prints 0.001), unless given.
    """
    p = parameters("stage")
    ratio = p["damping_ratio"] if damping_ratio is None else damping_ratio
    masses = p["masses"]
    mass = np.diag([p["actuator_mass"], *[p["mass"]] * masses])
    stiffness = chain_matrix([p["actuator_stiffness"], *[p["stiffness"]] * (masses - 1)])
    places = np.eye(masses + 1)
    return modal_model(mass, stiffness, places[:, :1], places[1:], ratio)


def stage_mass() -> float:
    """Total mass of the stage, 12.5 kg."""
    p = parameters("stage")
    return p["actuator_mass"] + p["masses"] * p["mass"]


def chain(masses: ArrayLike) -> ModalModel:
    """Chain of Fig. 2.5: equal springs and dampers, a force on and a position of every mass (kg).

    The dampers are in proportion to the springs, so the modes decouple for any masses.
    """
    masses = np.asarray(masses, float)
    p = parameters("chain")
    links, places = np.ones(len(masses) - 1), np.eye(len(masses))
    names = ("stiffness", "damper")
    stiffness, damping = (chain_matrix(p[n] * links) for n in names)
    return modal_model(np.diag(masses), stiffness, places, places, damping_matrix=damping)


def loaded_modes(place: float, sharing: str = "linear") -> tuple[np.ndarray, np.ndarray]:
    """Mass matrix and mass-normalised shapes of the chain of Example 2.3.2, its extra mass at a place from 1 to 5.

    Between two neighbours it is shared in a ``linear`` way, or a ``smooth`` one (squared cosine).
    """
    p = parameters("chain")
    away = np.abs(np.arange(1, 6) - place)
    require_choice("sharing", sharing, ("linear", "smooth"))
    share = np.maximum(1 - away, 0) if sharing == "linear" else np.cos(np.pi / 2 * np.minimum(away, 1)) ** 2
    mass = np.diag(p["light_mass"] + (p["heavy_mass"] - p["light_mass"]) * share)
    shapes = linalg.eigh(chain_matrix(np.full(4, p["stiffness"])), mass)[1]
    return mass, shapes * np.sign(shapes[0])


@dataclass(frozen=True)
class Drive:
    """Two inertias on a torsion rod, Fig. 3.35 and Table 3.8; friction acts on both."""

    inertia: float  # J1 = J2, kg m^2
    friction: float  # b, N m s/rad
    stiffness: float  # k, N m/rad
    damper: float  # d, N m s/rad
    motor_constant: float  # Km, N m/A

    @property
    def resonance(self) -> float:
        """Undamped frequency of the flexible mode, rad/s."""
        return float(np.sqrt(2 * self.stiffness / self.inertia))

    def modal_states(self) -> StateModel:
        r"""Motor current to the angle of the inertia across the rod, states :math:`(\eta_1, \dot\eta_1, \eta_2, \dot\eta_2)`.

        Equal inertias and frictions decouple into the sum and the difference of both angles.
        """
        j, shape = self.inertia, 1 / np.sqrt(2 * self.inertia)
        total = [[0, 1], [0, -self.friction / j]]
        difference = [[0, 1], [-2 * self.stiffness / j, -(self.friction + 2 * self.damper) / j]]
        a = linalg.block_diag(total, difference)
        b = np.array([[0], [shape], [0], [shape]]) * self.motor_constant
        return StateModel(a, b, np.array([[shape, 0, -shape, 0]]), np.zeros((1, 1)))

    def modes(self) -> ModalModel:
        """The same without the friction of the rigid body."""
        states, frequencies = self.modal_states(), np.array([0.0, self.resonance])
        damping = np.array([0.0, -states.a[3, 3] / (2 * self.resonance)])
        return ModalModel(frequencies, damping, states.b[1::2], states.c[:, ::2], np.zeros((1, 1)))


def drive() -> Drive:
    """The two-inertia drive with the parameters of Table 3.8."""
    p = parameters("drive")
    return Drive(**{name: p[name] for name in Drive.__dataclass_fields__})


def published_deviations() -> dict[str, float]:
    """Standard deviations of w (N), v and d (m), section 3.1."""
    p = parameters("stage").table("noise")
    names = {"w": "process", "v": "reference", "d": "sensor"}
    return {k: p[n] for k, n in names.items()}


def published_noise() -> NoiseIntensities:
    """Q = sigma_w^2 and R = sigma_v^2 + sigma_d^2 of section 3.1."""
    sigma = published_deviations()
    return NoiseIntensities(sigma["w"] ** 2, sigma["d"] ** 2 + sigma["v"] ** 2)


def published_setpoint(sample_time: float = 1e-4) -> Setpoint:
    """The move of Table 3.6 and Fig. 3.32: 0.17 m, 1 m/s, scanning from 0.04 to 0.17 s."""
    p = parameters("setpoint")
    limits = (p[name] for name in ("snap", "jerk", "acceleration", "velocity", "cruise", "settling"))
    return point_to_point(*limits, sample_time)


def shapes_along(
    model: ModalModel, grid: ArrayLike, places: ArrayLike
) -> Float64[np.ndarray, "samples modes"]:
    """Mode shapes at places (m) between the outputs of a model, which sit on a `grid`, by cubic splines through them."""
    from scipy.interpolate import CubicSpline

    grid = np.asarray(grid, float)
    places = np.asarray(places, float)
    if places.min() < grid[0] or places.max() > grid[-1]:
        raise InputError(
            f"places run from {places.min():g} to {places.max():g} m, outside the grid from {grid[0]:g} to "
            f"{grid[-1]:g} m; shift or shorten the move"
        )
    return CubicSpline(grid, model.output_shapes)(places)


def measured_accelerance(padding: int = 4) -> Identified:
    """Acceleration over force of the structure (1/kg), counted positive along the force.

    The response has died out within each record, so zeros appended to it give a finer grid, not an
    interpolation.
    """
    file = paths.data("motion", "impact_frf_25k6/impact_hammer_5_hits.npz")  # see SOURCE.md beside it
    with np.load(file, allow_pickle=False) as records:
        force, response = (
            np.pad(hits, ((0, 0), (0, (padding - 1) * hits.shape[1])))
            for hits in (records["force_n"], records["accel_m_s2"])
        )
        # The accelerometer faces the hammer.
        return impact_response(force, -response, float(records["fs_hz"]))


def as_stage(fit: ModalFit, mass: float) -> tuple[ModalModel, float]:
    """The fitted structure with another total mass, and the factor on its response."""
    factor = 1 / (mass * float(fit.model.input_shapes[0, 0] * fit.model.output_shapes[0, 0]))
    model = fit.model
    shapes = {name: np.sqrt(factor) * getattr(model, name) for name in ("input_shapes", "output_shapes")}
    return replace(model, **shapes, feedthrough=factor * model.feedthrough), factor
