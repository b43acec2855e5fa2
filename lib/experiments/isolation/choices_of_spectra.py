"""Sections 2, 5.1.2 and 5.2.2 at any reading of what their work leaves open (``readings.toml``), from spectra alone.

Where a notebook simulates, the lean form takes the weights in which the adaptation ends and the spectra that follow.
"""

import numpy as np
from jaxtyping import Float64

from experiments.isolation import one_rig, tracking
from experiments.isolation.floors import FLAT_LEVEL, ShapedFloor, colored_floor, flat_floor
from experiments.isolation.modes import suspension_modes
from experiments.isolation.performance import ENTRIES, central_axes, expected_density
from experiments.isolation.power import BAND_HZ, limit_ratio_db, measures, power_trial
from experiments.isolation.responses import responses
from experiments.isolation.steady import FORGETTING, steady_state
from experiments.isolation.twin import Twin, load_twin
from stillwork.signals.spectra import Spectrum

STEP_SIZE, MEMORY_S = 1e-4, 10.0  # section 5.1.1
FELMS_S, FERLS_S, RECORD_S = 250.0, 60.0, 40.0  # s, of a run of notebook 05
TRACKED_S = 90.0  # s after a switch in notebook 03
QUIET = 1e-5  # m/s^2/sqrt(Hz), output noise of notebook 03's twin
LINES_HZ = np.arange(0.25, 500.25, 0.25)  # as an estimate has them


def rig(
    *,
    strut_damping: float,
    actuator_pole: float,
    strut_tilt: float = 31.08,
    pair_angle: float = 15.0,
    rotations: float = 40.0,
    output_noise: float = 1.8e-4,
) -> Twin:
    """The rigid body of six equal struts with another geometry; its floor sensors stay where they are.

    `strut_tilt` and `pair_angle` in degrees, from the vertical and half of what is between the struts of a pair;
    `rotations` in Hz, of all three.
    """
    struts = {"stiffness": 1.0, "damping": strut_damping}
    sensors = {"sensor_radius": 0.0648, "sensor_angle": 0.0, "floor_level": FLAT_LEVEL}
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
    return one_rig.build(given)[0]


def suspension(
    *, strut_damping: float, strut_tilt: float, rotations: float, seed: int, lean: bool
) -> dict[str, float]:
    """Relative damping with the skyhook loop, as in notebook 01; there is nothing to leave out."""
    twin = rig(strut_damping=strut_damping, actuator_pole=300.0, strut_tilt=strut_tilt, rotations=rotations)
    # With equal struts all modes follow one law of their frequency, so the loop keeps their order.
    damping, shares = suspension_modes(twin).damping, twin.rig.mass * twin.rig.modes[1] ** 2
    kinds = {"horizontal": shares[0] + shares[1] > 0.5, "vertical": shares[2] > 0.5}
    kinds["rotations"] = ~(kinds["horizontal"] | kinds["vertical"])
    return {f"isolation.setup.damping-{kind}": damping[rows].mean() for kind, rows in kinds.items()}


def power(
    *,
    mains_in_power: str,
    output_noise: float,
    sensor_levels: str,
    strut_damping: float,
    actuator_pole: float,
    floor_upper_end: float,
    strut_tilt: float,
    pair_angle: float,
    rotations: float,
    seed: int,
    lean: bool,
) -> dict[str, float]:
    """Fig. 8: one run of notebook 05, or (`lean`) the weights of `steady_state` and what they leave in the mean.

    `mains_in_power` is ``"bridged"`` or ``"counted"``, `sensor_levels` three numbers between colons.
    """
    twin = rig(
        strut_damping=strut_damping,
        actuator_pole=actuator_pole,
        strut_tilt=strut_tilt,
        pair_angle=pair_angle,
        rotations=rotations,
        output_noise=output_noise,
    )
    levels = FLAT_LEVEL * np.array([float(level) for level in sensor_levels.split(":")])
    floor = flat_floor(floor_upper_end, levels)
    found = _expected(twin, floor) if lean else _measured(twin, floor, seed)
    removed = found["removed with mains" if mains_in_power == "counted" else "removed FeRLS"]
    bands, above = limit_ratio_db(
        found["lines"], [found["density FeRLS"]], [found["density output noise"]], twin.instruments.mains_hz
    )
    late = np.flatnonzero(above.max(axis=0) > 3.0)
    after = late[-1] + 1 if len(late) else 0
    return {
        **{f"isolation.fig-8.removed.{name}": value for name, value in zip(ENTRIES, removed, strict=True)},
        "isolation.fig-8.removed.range": np.mean((removed > 89.5) & (removed < 94.5)),
        "isolation.fig-8.reaches-the-limit": np.mean(found["removed limit"] - found["removed FeRLS"] < 1.0),
        "isolation.fig-8.low-end-lost": np.mean(found["low end"] > 1),
        "isolation.fig-8.no-limit-above-300-hz": np.mean(found["above band"] > found["in band"]),
        "isolation.fig-8.limit-in-band": bands[after] if after < len(bands) else np.nan,
    }


def _measured(twin: Twin, floor: ShapedFloor, seed: int) -> dict[str, np.ndarray]:
    [found] = power_trial(
        [np.random.default_rng(seed)],
        twin=twin,
        floor=floor,
        felms_s=FELMS_S,
        ferls_s=FERLS_S,
        record_s=RECORD_S,
    )
    return found | {"lines": np.arange(found["density FeRLS"].shape[1]) * LINES_HZ[0]}


def _expected(twin: Twin, floor: ShapedFloor) -> dict[str, np.ndarray]:
    """What `power_trial` gives, in the mean and without mains but where they are counted."""
    weights = steady_state(twin, floor).weights
    before = expected_density(twin, floor, LINES_HZ)
    after = expected_density(twin, floor, LINES_HZ, weights=weights)
    total, left, limit = (
        Spectrum(LINES_HZ, density, 1)
        for density in (sum(before.values()), sum(after.values()), before["output noise"])
    )
    lines = [mains_power(twin, given) for given in (None, weights)]
    return measures(total, left, limit) | {
        "removed with mains": 100
        * (1 - (left.power(*BAND_HZ) + lines[1]) / (total.power(*BAND_HZ) + lines[0])),
        "density FeRLS": left.density,
        "density output noise": limit.density,
        "lines": LINES_HZ,
    }


def mains_power(twin: Twin, weights: np.ndarray | None) -> Float64[np.ndarray, "3"]:
    """Power of the mains lines in the platform's spectrum, (m/s^2)^2 and (rad/s^2)^2.

    Their sines enter all platform sensors alike, and all floor sensors.
    """
    instruments, axes = twin.instruments, central_axes(twin.rig)
    paths = responses(twin, instruments.mains_hz)
    amplitude = paths.sensitivity.sum(axis=2) * np.array(instruments.platform_mains)[:, None]
    amplitude = (
        amplitude + paths.feedforward(weights).sum(axis=2) * np.array(instruments.floor_mains)[:, None]
    )
    return 0.5 * np.sum(np.abs(amplitude @ axes.platform.T) ** 2, axis=0)


def follow(
    *, trace: str, floor_upper_end: float, color_gain: float, seed: int, lean: bool
) -> dict[str, float]:
    """Fig. 6: one run each way of notebook 03, or (`lean`) the mean courses."""
    twin = load_twin("fitted").varied(platform_noise=QUIET)
    flat, colored = flat_floor(floor_upper_end), colored_floor(floor_upper_end, gain=color_gain)
    step_size = STEP_SIZE / (twin.actuators if trace == "literal" else 1)
    into, back = (
        _settling(twin, tracking.switch_between(twin, *floors), step_size, seed, lean)
        for floors in ((flat, colored), (colored, flat))
    )
    gains = [times["FeLMS all"] / times["FeRLS all"] for times in (into, back)]
    return {
        "isolation.tracking.flat-to-colored": into["FeRLS all"] < into["FeLMS all"],
        "isolation.tracking.colored-to-flat": back["FeLMS all"] <= back["FeRLS all"],
        "isolation.tracking.colored-to-flat-w4-w6": back["FeLMS w4-w6"] <= back["FeRLS w4-w6"],
        "isolation.tracking.benefit-shrinks": gains[1] < gains[0],
    }


def _settling(
    twin: Twin, switch: tracking.Switch, step_size: float, seed: int, lean: bool
) -> dict[str, float]:
    if not lean:
        both = tracking.settled(switch, step_size, FORGETTING)
        options = {"twin": twin, "switch": switch, "both": both, "duration_s": TRACKED_S}
        return tracking.tracking_trial([np.random.default_rng(seed)], **options)[0]
    courses = {
        name: tracking.expected_response(twin, switch, name, step_size, MEMORY_S)
        for name in tracking.ALGORITHMS
    }
    return tracking.settling_times(courses)
