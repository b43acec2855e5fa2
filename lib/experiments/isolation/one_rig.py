"""One physical rig for the whole FeRLS paper: unequal struts and sensors within the ranges that the source leaves open.

`one_rig_search` infers its parameters from the printed numbers.
"""

from dataclasses import replace
from functools import cache

import numpy as np
from scipy import stats

from experiments.isolation.convergence import SHARE
from experiments.isolation.floors import FLAT_LEVEL, ShapedFloor, flat_floor
from experiments.isolation.mean_convergence import mean_course
from experiments.isolation.performance import ENTRIES, exact_reduction_db, expected_density
from experiments.isolation.plant import plant_of_rig
from experiments.isolation.power import BAND_HZ, reduction_percent
from experiments.isolation.rig import Lines, Rig
from experiments.isolation.steady import steady_state
from experiments.isolation.twin import Twin, load_twin
from stillwork.base.toml_files import read_toml
from workbook import paths

MASS, STIFFNESS = 5.4, 60e3  # kg, N/m: sections 2 and 2.1
DURATION_S = 200.0  # of a run, as in notebook 02
_GRID = np.geomspace(0.5, 2000.0, 150)
_TIMES = {"FeLMS": np.geomspace(0.1, DURATION_S, 400), "FeRLS": np.geomspace(0.1, 60.0, 16)}


@cache
def ranges() -> dict[str, tuple[float, float, bool]]:
    """Lower end, upper end, and whether logarithmic, of every parameter, by name."""
    found = {}
    for name, axis in read_toml(paths.data("isolation", "one_rig.toml"))["ranges"].items():
        each = range(1, axis["each"] + 1) if "each" in axis else [""]
        found |= {f"{name}{k}": (*axis["range"], axis.get("log", False)) for k in each}
    return found


def parameters(position) -> dict[str, float]:
    """Values of the parameters at standard normal numbers, one each: 0 is the middle of a range."""
    found = {}
    for share, (name, (low, high, log)) in zip(stats.norm.cdf(position), ranges().items(), strict=True):
        found[name] = float(low * (high / low) ** share if log else low + (high - low) * share)
    return found


def build_rig(given: dict[str, float]) -> Rig:
    """Rig of these parameters: six axial struts and, across each, two lateral springs without actuator."""

    def of(name: str, count: int):
        return np.array([given[f"{name}{k}"] for k in range(1, count + 1)])

    pair, tilt = np.radians([given["pair"], given["tilt"]])
    angles = np.radians([0, 0, 120, 120, 240, 240]) + pair * np.array([1, -1, 1, -1, 1, -1])
    # Numbered and tilted along the ring as in rigid_body.toml: a pair leans towards each other.
    angles = angles[[0, 1, 2, 3, 5, 4]]
    side = np.array([1, -1, 1, -1, -1, 1])
    radial = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    tangent = side[:, None] * np.stack([-np.sin(angles), np.cos(angles), 0 * angles], axis=1)
    axial = np.sin(tilt) * tangent - np.cos(tilt) * np.array([0.0, 0.0, 1.0])
    across = np.cross(axial, radial)
    places = given["radius"] * radial
    stiffness, damping = STIFFNESS * of("stiffness", 6), of("damping", 6)
    struts = Lines(np.tile(places, (3, 1)), np.concatenate([axial, radial, across]))
    # The inertia puts the rotations of six equal struts at their frequency.
    turning = np.cross(places, axial)
    moment = STIFFNESS * np.sum(turning[:, 0] ** 2) / (2 * np.pi * given["rotation"]) ** 2
    azimuth = np.radians(given["azimuth"] + np.array([0, 120, 240]) + of("sensor_angle", 3))
    feet = of("sensor_radius", 3)[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=1)
    along = Lines(places, axial)
    return Rig(
        mass=MASS,
        inertia=moment * np.diag([1.0, 1.0, 2 * given["flatness"]]),
        struts=struts,
        stiffness=np.concatenate([stiffness, np.tile(given["lateral_stiffness"] * stiffness, 2)]),
        damping=np.concatenate([damping, np.full(12, given["lateral_damping"])]),
        floor_sensors=Lines(feet, np.tile([0.0, 0.0, 1.0], (3, 1))),
        actuators=along,
        platform_sensors=along,
    )


def build(given: dict[str, float]) -> tuple[Twin, ShapedFloor]:
    """Rig and floor of these parameters, with the published instruments and controller."""
    rig = build_rig(given)
    twin = replace(load_twin("rigid_body"), name="one rig", rig=rig, plant=plant_of_rig(rig)).varied(
        beta=given["beta"],
        actuator_pole_hz=given["actuator_pole"],
        platform_noise=given["output_noise"],
    )
    return twin, flat_floor(given["floor_upper_end"], [given[f"floor_level{k}"] for k in (1, 2, 3)])


def numbers(given: dict[str, float]) -> dict[str, float]:
    """What a rig of these parameters gives in the mean for the paper's numbers, by entry of the ledger."""
    twin, floor = build(given)
    steady = steady_state(twin, floor, frequencies_hz=_GRID)
    found, settled = {}, steady.weights[0]
    for name, grid in _TIMES.items():
        setting = {"initial_covariance": given["initial_covariance"]} if name == "FeRLS" else {}
        course = mean_course(twin, steady, name, grid, **setting)
        final = settled if name == "FeRLS" else course[grid > 0.9 * DURATION_S].mean(axis=0)
        times = times_to_settle(grid, np.abs(course / final - 1))
        for k in range(9):
            found[f"table-1.{name.lower()}.final-w{k + 1}"] = float(final[k])
            found[f"table-1.{name.lower()}.tau-w{k + 1}"] = float(times[k])
    f = np.geomspace(*BAND_HZ, 150)
    before, after = (
        sum(expected_density(twin, floor, f, weights=w).values()) for w in (None, steady.weights)
    )
    for direction, value in zip(ENTRIES, reduction_percent(f, before, after), strict=True):
        found[f"fig-8.removed.{direction}"] = float(value)
    found["setup.equivalent-mass"] = float(twin.plant.equivalent_mass)
    return found


def times_to_settle(time_s: np.ndarray, off: np.ndarray) -> list[float]:
    """Time from which each trace stays within 63 % of its final value, between the grid's points as well."""
    found = []
    for each in off.T:
        last = max(np.flatnonzero(each > SHARE), default=0)
        # Of a trace that ends outside, the end alone.
        found.append(float(np.interp(-SHARE, -each[last : last + 2], time_s[last : last + 2])))
    return found


def edges(given: dict[str, float]) -> tuple[float, float, float]:
    """Hz: where the reduction first exceeds 20 dB, where it does last, and where it first exceeds 0 dB.

    Without noise, in the worst of z, θx and θy, as notebook 04 takes them. NaN where there is none.
    """
    twin, floor = build(given)
    weights = steady_state(twin, floor, frequencies_hz=_GRID).weights
    f = np.arange(0.5, 450.0, 0.5)
    reduction = exact_reduction_db(twin, f, weights)
    found = [f[reduction > limit] for limit in (20.0, 0.0)]
    ends = (found[0][:1], found[0][-1:], found[1][:1])
    return tuple(float(each[0]) if len(each) else np.nan for each in ends)


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
    struts = {"stiffness": 1.0, "damping": strut_damping}
    sensors = {"sensor_radius": sensor_radius, "sensor_angle": 0.0, "floor_level": FLAT_LEVEL}
    given = {
        **{f"{name}{k}": value for name, value in struts.items() for k in range(1, 7)},
        **{f"{name}{k}": value for name, value in sensors.items() for k in (1, 2, 3)},
        "tilt": strut_tilt,
        "pair": pair_angle,
        "radius": 0.1,
        "rotation": rotations,
        "flatness": np.tan(np.radians(strut_tilt)) ** 2,  # puts the third rotation at the same frequency
        "lateral_stiffness": 1e-9,  # no springs across
        "lateral_damping": 0.0,
        "azimuth": -70.5,
        "beta": 200.0,
        "actuator_pole": actuator_pole,
        "output_noise": output_noise,
        "floor_upper_end": 1500.0,
    }
    return build(given)[0]
