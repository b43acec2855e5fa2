"""Digital twins of the isolation rig: mechanics, instruments and controller settings from one TOML file."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from experiments.isolation.plant import Platform, plant_of_rig
from experiments.isolation.rig import Lines, Rig, build, require_names, require_table, rig_from_table
from experiments.isolation.settings import Instruments, SelfTunedFeedforward, Skyhook
from stillwork.base.checks import InputError, require_array, require_choice, require_number, short_repr
from stillwork.base.toml_files import read_toml
from stillwork.base.validation import checked
from stillwork.control import isolation_filters as shaping
from stillwork.control.isolation_filters import FrequencyNotch, NoiseShaping, SecondaryPath
from workbook import paths

SHIPPED = ("rigid_body", "fitted")


@dataclass(frozen=True)
class Twin:
    """A model of an isolation rig, complete enough to run its controller on."""

    name: str
    plant: Platform
    instruments: Instruments
    skyhook: Skyhook
    feedforward: SelfTunedFeedforward
    rig: Rig | None = None  # geometry, when the plant is a rigid body on struts

    def __post_init__(self):
        if self.outputs != self.actuators:
            raise InputError(
                f"the model has {self.actuators} actuators and {self.outputs} platform sensors; the skyhook "
                "loop pairs them, so give as many of each"
            )

    @property
    def actuators(self) -> int:
        return self.plant.actuation.shape[1]

    @property
    def outputs(self) -> int:
        """Platform sensors."""
        return self.plant.observation.shape[0]

    @property
    def sensors(self) -> int:
        """Floor sensors."""
        return self.plant.floor_damping.shape[1]

    @property
    def regressors(self) -> int:
        return (self.feedforward.integrator_powers + 1) * self.sensors

    @property
    def sample_time(self) -> float:
        return self.instruments.sample_time

    def varied(self, **changes) -> "Twin":
        """Copy with other settings: ``twin.varied(platform_noise=1e-5, gain=0.0)``.

        Names are those of `Instruments`, `Skyhook` and `SelfTunedFeedforward`.
        """
        parts = {part: getattr(self, part) for part in ("instruments", "skyhook", "feedforward")}
        names = {part: list(record.__dataclass_fields__) for part, record in parts.items()}
        require_names("varied", changes, (), [name for each in names.values() for name in each])
        for part, record in parts.items():
            parts[part] = replace(record, **{name: changes[name] for name in names[part] if name in changes})
        return replace(self, **parts)

    def on_rig(self, rig: Rig) -> "Twin":
        """Copy with another rigid body on struts."""
        return replace(self, rig=rig, plant=plant_of_rig(rig))

    @cached_property
    def integrator(self) -> np.ndarray:
        """Sections of the normalised weak integrator beta H."""
        settings = self.feedforward
        cutoff = 2 * np.pi * settings.integrator_cutoff_hz
        return shaping.weak_integrator(settings.integrator_order, cutoff, settings.beta, self.sample_time)

    @cached_property
    def noise_shaping(self) -> np.ndarray:
        """Sections of N."""
        return shaping.noise_shaping(self.feedforward.shaping, self.feedforward.path, self.sample_time)

    @cached_property
    def skyhook_filter(self) -> np.ndarray:
        """Sections of the skyhook loop; the command gets minus its output."""
        settings = self.skyhook
        return shaping.skyhook(
            settings.gain, self.sample_time, settings.cutoff, FrequencyNotch(settings.notch_hz)
        )

    @cached_property
    def error_filter(self) -> np.ndarray:
        """Sections of N times the inverse of the estimated secondary path (2), the same on each axis."""
        settings = self.feedforward
        return shaping.inverse_secondary_shaping(settings.shaping, settings.path, self.sample_time)


def load_twin(model: str | Path) -> Twin:
    """Read a twin from TOML: ``"rigid_body"``, ``"fitted"``, or the path of a file of the same form."""
    if not isinstance(model, str | Path):
        raise InputError(
            f"model is {short_repr(model)}; give {', '.join(map(repr, SHIPPED))} or the path of a TOML file"
        )
    file = paths.data("isolation", f"{model}.toml") if model in SHIPPED else Path(model)
    if model not in SHIPPED and file.suffix != ".toml":
        require_choice("model", str(model), SHIPPED)
    table = read_toml(file)
    try:
        return twin_from_table(table)
    except InputError as error:
        raise InputError(f"{file.name}: {error}") from None


@checked(missing=True)
def twin_from_table(table: dict) -> Twin:
    """Make a `Twin` from the tables of a TOML model.

    Mechanics are either a rigid body on struts (tables ``body``, ``struts``, ``floor_sensors``, optional
    ``actuators`` and ``platform_sensors``) or matrices (table ``plant``).
    """
    common = ("name", "instruments", "skyhook", "feedforward")
    if "plant" in table:
        require_names("model", table, (*common, "plant"))
        rig, plant = None, _plant_from_table(table["plant"])
    else:
        body = {name: part for name, part in table.items() if name not in common}
        require_names("model", {name: table[name] for name in common if name in table}, common)
        rig = rig_from_table(body)
        plant = plant_of_rig(rig)
    return Twin(
        name=table["name"],
        plant=plant,
        instruments=build(Instruments, table["instruments"], "instruments"),
        skyhook=build(Skyhook, table["skyhook"], "skyhook"),
        feedforward=_feedforward_from_table(table["feedforward"]),
        rig=rig,
    )


def _plant_from_table(table: dict) -> Platform:
    names = ("mass", "damping", "stiffness", "floor_inertia", "floor_damping", "floor_stiffness")
    require_names("plant", table, names)
    floor = {name: require_array(f"plant: {name}", table[name], ndim=2) for name in names[3:]}
    axes = len(floor["floor_stiffness"])
    # A scalar is the same on every axis; force and acceleration are along the axes.
    square = {}
    for name in names[:3]:
        value = require_array(f"plant: {name}", table[name])
        square[name] = value * np.eye(axes) if value.ndim < 2 else value
    return build(
        Platform, {**square, **floor, "actuation": np.eye(axes), "observation": np.eye(axes)}, "plant"
    )


def _feedforward_from_table(table: dict) -> SelfTunedFeedforward:
    names = ("integrator_order", "integrator_cutoff_hz", "integrator_powers", "beta", "shaping", "path")
    require_names("feedforward", table, names)
    shape = dict(require_table("feedforward.shaping", table["shaping"]))
    notches = shape.pop("notches", [])
    if not isinstance(notches, list):
        raise InputError(f"feedforward.shaping.notches is {short_repr(notches)}; give a list of tables")
    path = dict(require_table("feedforward.path", table["path"]))
    require_names("feedforward.path", path, ("mass", "damping", "stiffness", "actuator_pole_hz"))
    path["actuator_pole"] = 2 * np.pi * require_number("actuator_pole_hz", path.pop("actuator_pole_hz"))
    shape["notches"] = tuple(build(FrequencyNotch, notch, "feedforward.shaping.notches") for notch in notches)
    parts = {
        "shaping": build(NoiseShaping, shape, "feedforward.shaping"),
        "path": build(SecondaryPath, path, "feedforward.path"),
    }
    return build(SelfTunedFeedforward, {**table, **parts}, "feedforward")


MASS, STIFFNESS = 5.4, 60e3  # kg, N/m: sections 2 and 2.1
STRUT_RADIUS, SENSOR_AZIMUTH = 0.1, -70.5  # m, degrees: as in rigid_body.toml


def equal_struts(
    *,
    strut_damping: float,
    actuator_pole: float,
    strut_tilt: float = 31.08,
    pair_angle: float = 15.0,
    rotations: float = 40.0,
    output_noise: float = 1.8e-4,
    sensor_radius: float = 0.0648,
) -> Twin:
    """The rigid body of six equal struts with another geometry.

    `strut_tilt` and `pair_angle` in degrees, from the vertical and half of what is between the struts of a pair;
    `rotations` in Hz, of all three; `sensor_radius` in m, of the floor sensors.
    """
    pair, tilt = np.radians([pair_angle, strut_tilt])
    angles = np.radians([0, 0, 120, 120, 240, 240]) + pair * np.array([1, -1, 1, -1, 1, -1])
    # Numbered and tilted along the ring as in rigid_body.toml: a pair leans towards each other.
    angles = angles[[0, 1, 2, 3, 5, 4]]
    side = np.array([1, -1, 1, -1, -1, 1])
    radial = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    tangent = side[:, None] * np.stack([-np.sin(angles), np.cos(angles), 0 * angles], axis=1)
    struts = Lines(STRUT_RADIUS * radial, np.sin(tilt) * tangent - np.cos(tilt) * np.array([0.0, 0.0, 1.0]))
    # The inertia puts the rotations at their frequency, the third by the flatness of the body.
    moment = STIFFNESS * np.sum(struts.jacobian[:, 3] ** 2) / (2 * np.pi * rotations) ** 2
    azimuth = np.radians(SENSOR_AZIMUTH + np.array([0, 120, 240]))
    feet = sensor_radius * np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=1)
    rig = Rig(
        mass=MASS,
        inertia=moment * np.diag([1.0, 1.0, 2 * np.tan(tilt) ** 2]),
        struts=struts,
        stiffness=STIFFNESS,
        damping=strut_damping,
        floor_sensors=Lines(feet, np.tile([0.0, 0.0, 1.0], (3, 1))),
        actuators=struts,
        platform_sensors=struts,
    )
    twin = replace(load_twin("rigid_body"), name="equal struts").on_rig(rig)
    return twin.varied(actuator_pole_hz=actuator_pole, platform_noise=output_noise)
