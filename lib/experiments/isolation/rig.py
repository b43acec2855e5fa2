"""Tables of a TOML file as frozen dataclasses: a missing or unknown name is refused with the nearest one."""

from dataclasses import MISSING, dataclass, fields
from functools import cached_property

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy import linalg

from stillwork.base.checks import (
    InputError,
    nearest,
    require_array,
    require_count,
    require_number,
    short_repr,
)


def require_table(where: str, given) -> dict:
    """Return `given` when it is a table, else raise `InputError`."""
    if not isinstance(given, dict):
        raise InputError(f"{where} is {short_repr(given)}; give a table [{where}]")
    return given


def require_names(where: str, given, required, optional=()) -> None:
    """Raise `InputError` when a name of `required` is missing or one is in neither list."""
    known = [*required, *optional]
    for name in require_table(where, given):
        if name not in known:
            raise InputError(
                f"{where}: unknown name {name!r}{nearest(name, known)}; known: {', '.join(known)}"
            )
    for name in required:
        if name not in given:
            raise InputError(f"{where}: {name!r} is missing; add it")


def build(record: type, table, where: str):
    """Make the dataclass `record` from a TOML table; its own checks speak with `where` in front."""
    required = [f.name for f in fields(record) if f.default is MISSING and f.default_factory is MISSING]
    optional = [f.name for f in fields(record) if f.name not in required]
    require_names(where, table, required, optional)
    try:
        typed = {f.name: _typed(f.name, table[f.name], f.type) for f in fields(record) if f.name in table}
        return record(**typed)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _typed(name: str, value, wanted):
    """TOML distinguishes 5 from 5.0; the author of a model should not need to."""
    if wanted is float:
        return require_number(name, value)
    if wanted is int:
        return require_count(name, value, at_least=0)
    if wanted == list[float]:
        return require_array(name, value, ndim=1).tolist()
    if wanted is str and not isinstance(value, str):
        raise InputError(f"{name} is {value!r}; give text in quotes")
    return value


# Reciprocal condition below which a geometry counts as degenerate: struts or sensors that do not fix a motion.
DEGENERATE = 1e-9


@dataclass(frozen=True)
class Lines:
    """Places and directions of struts, actuators or accelerometers."""

    positions: ArrayLike  # (elements, 3), m, from the body's centre of mass
    directions: ArrayLike  # (elements, 3), any length but zero; kept with length 1

    def __post_init__(self):
        positions = require_array("positions", self.positions, shape=(None, 3))
        directions = require_array("directions", self.directions, shape=(len(positions), 3))
        lengths = np.linalg.norm(directions, axis=1)
        if np.any(lengths == 0):
            raise InputError(f"directions: row {int(np.argmin(lengths))} is zero; give it a direction")
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "directions", directions / lengths[:, None])

    @cached_property
    def jacobian(self) -> Float64[np.ndarray, "elements 6"]:
        """Motion along each line per motion (x, y, z, θx, θy, θz) of the body it is fixed to."""
        return np.hstack([self.directions, np.cross(self.positions, self.directions)])


@dataclass(frozen=True)
class Rig:
    """A rigid body on struts that stand on a rigid floor plate.

    Small motions q = (x, y, z, θx, θy, θz) of the body about its centre of mass, q0 of the plate:
    ``M q'' + C (q' - q0') + K (q - q0) = J' f``. Actuators work and platform accelerometers measure along
    the struts, as in the FeRLS paper, unless the model places them elsewhere.
    """

    mass: float  # kg
    inertia: ArrayLike  # (3, 3), kg m^2, about the centre of mass
    struts: Lines
    stiffness: ArrayLike  # (struts,), of each strut along itself, N/m
    damping: ArrayLike  # (struts,), N s/m
    floor_sensors: Lines
    actuators: Lines
    platform_sensors: Lines

    def __post_init__(self):
        require_number("mass", self.mass, above=0.0)
        inertia = require_array("inertia", self.inertia, shape=(3, 3))
        moments = np.linalg.eigvalsh(inertia)
        if not np.allclose(inertia, inertia.T, rtol=1e-9, atol=0) or moments[0] <= 0:
            raise InputError(
                "inertia is not symmetric and positive definite; give a physical inertia, kg m^2"
            )
        if moments[2] > (moments[0] + moments[1]) * (1 + 1e-9):
            raise InputError(
                "inertia: one principal moment exceeds the sum of the others, which no body has; check its units"
            )
        count = len(self.struts.positions)
        for name, low in (("stiffness", "above"), ("damping", "at_least")):
            values = np.broadcast_to(require_array(name, getattr(self, name)), count) * np.ones(count)
            for value in values:
                require_number(name, value, **{low: 0.0})
            object.__setattr__(self, name, values)
        object.__setattr__(self, "inertia", inertia)
        if np.linalg.matrix_rank(self.struts.jacobian, DEGENERATE) < 6:
            raise InputError("struts leave a motion of the body free; use six or more that fix all of them")
        sensors = self.floor_sensors.jacobian
        if np.linalg.matrix_rank(sensors, DEGENERATE) < len(sensors):
            raise InputError("floor_sensors: some measure the same motion; place them apart")

    @cached_property
    def mass_matrix(self) -> Float64[np.ndarray, "6 6"]:
        """M."""
        return linalg.block_diag(self.mass * np.eye(3), self.inertia)

    @cached_property
    def stiffness_matrix(self) -> Float64[np.ndarray, "6 6"]:
        """K = J' k J."""
        return self.struts.jacobian.T @ (self.stiffness[:, None] * self.struts.jacobian)

    @cached_property
    def damping_matrix(self) -> Float64[np.ndarray, "6 6"]:
        """C = J' d J."""
        return self.struts.jacobian.T @ (self.damping[:, None] * self.struts.jacobian)

    @cached_property
    def modes(self) -> tuple[Float64[np.ndarray, "6"], Float64[np.ndarray, "6 6"]]:
        """Undamped angular frequencies, rad/s, ascending, and mass-normalised shapes in the columns."""
        squares, shapes = linalg.eigh(self.stiffness_matrix, self.mass_matrix)
        return np.sqrt(squares), shapes

    @property
    def frequencies_hz(self) -> Float64[np.ndarray, "6"]:
        """Undamped modal frequencies, ascending."""
        return self.modes[0] / (2 * np.pi)

    def damping_ratios(self, extra: float = 0.0) -> Float64[np.ndarray, "6"]:
        """Relative damping of each mode, with `extra` N s/m of ideal skyhook damping on every strut."""
        omega, shapes = self.modes
        jacobian = self.struts.jacobian
        total = self.damping_matrix + extra * jacobian.T @ jacobian
        return np.einsum("im,ij,jm->m", shapes, total, shapes) / (2 * omega)

    @cached_property
    def strut_inverse_mass(self) -> Float64[np.ndarray, "struts struts"]:
        """J M^-1 J': acceleration along each strut per force along each, 1/kg."""
        return self.struts.jacobian @ linalg.solve(self.mass_matrix, self.struts.jacobian.T, assume_a="pos")

    @property
    def equivalent_mass(self) -> float:
        """One mass for all struts, kg: the inverse of the mean diagonal of `strut_inverse_mass`."""
        return float(1 / np.mean(np.diag(self.strut_inverse_mass)))

    @cached_property
    def plate_motion(self) -> Float64[np.ndarray, "6 sensors"]:
        """Motion q0 of the rigid floor plate per reading of its sensors; unmeasured motions are at rest."""
        return np.linalg.pinv(self.floor_sensors.jacobian)


def rig_from_table(table: dict) -> Rig:
    """Make a `Rig` from the tables ``body``, ``struts``, ``floor_sensors`` of a TOML model.

    ``actuators`` and ``platform_sensors`` are optional; without them both sit along the struts.
    """
    required = ("body", "struts", "floor_sensors")
    require_names("model", table, required, ("actuators", "platform_sensors"))
    body, struts = table["body"], table["struts"]
    require_names("body", body, ("mass", "inertia"))
    require_names("struts", struts, ("positions", "directions", "stiffness", "damping"))
    along = _lines(struts, "struts")
    lines = {
        name: _lines(table[name], name) if name in table else along
        for name in ("floor_sensors", "actuators", "platform_sensors")
    }
    return Rig(
        mass=require_number("body: mass", body["mass"]),
        inertia=require_array("body: inertia", body["inertia"], shape=(3, 3)),
        struts=along,
        stiffness=require_array("struts: stiffness", struts["stiffness"]),
        damping=require_array("struts: damping", struts["damping"]),
        **lines,
    )


def _lines(table: dict, where: str) -> Lines:
    arrays = {
        key: require_array(f"{where}: {key}", table[key], ndim=2)
        for key in ("positions", "directions")
        if key in require_table(where, table)
    }
    rest = {key: value for key, value in table.items() if where != "struts" and key not in arrays}
    return build(Lines, {**arrays, **rest}, where)
