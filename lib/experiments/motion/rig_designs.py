"""The four uses of the observer on the rig (Table 6.2) for one geometry."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, lru_cache, partial

import numpy as np
from jaxtyping import Float64

from experiments.motion.rig import (
    POSITIONS,
    Geometry,
    assumed,
    decoupling,
    published,
    rig_model,
)
from experiments.motion.rig_control import rig_compensator, rig_observer
from experiments.motion.rig_loops import (
    RigBandwidth,
    RigLoop,
    make_rig_loop,
    maximise_rig_bandwidth,
    no_bandwidth,
)
from experiments.motion.uncertainty import detuned
from stillwork.control.bandwidth import Infeasible
from stillwork.control.pid import Pid, PidFamily
from stillwork.estimation.observer import NoiseIntensities
from stillwork.lti.modal import ModalModel
from stillwork.lti.peaks import resonance_grid
from stillwork.lti.reduction import truncate
from workbook import figures
from workbook.claims import load_entries

RETAINED = 11  # modes in the observer: three rigid ones and the eight of Table 6.1
CASES = ("Original", "MC", "AD", "MC and AD")  # rows of Tables 6.2 to 6.4
IDS = dict(zip(CASES, ("original", "mc", "ad", "mc-ad"), strict=True))  # as the ledger has them
DIRECTIONS = ("z", "rx", "ry")


def printed(table: str, cases: Sequence[str] = CASES) -> dict[str, Float64[np.ndarray, "3"]]:
    """What is printed of each use in z, rx and ry: of ``table-6-2`` (Hz), ``table-6-3`` and ``table-6-3.ratio``, and their like."""
    entries = load_entries("motion")
    return {
        case: np.array([entries[f"motion.{table}.{IDS[case]}.{each}"].published for each in DIRECTIONS])
        for case in cases
    }


@dataclass(frozen=True)
class RigSettings:
    """What chapter 6 prints about the observer and its uses."""

    sample_time: float  # s
    noise: NoiseIntensities  # covariances a sample, N^2 and m^2
    noise_model: float  # N^2, Q_nu with MC alone
    noise_model_both: float  # N^2, Q_nu with MC and AD
    target_damping: float
    selectivity: float | None


def published_settings() -> RigSettings:
    """Section 6.3; with MC alone the smallest noise model that it allows, with MC and AD the assumed one."""
    p = published()
    return RigSettings(
        1 / p["sample_rate_hz"],
        NoiseIntensities(p["process"], p["sensor"]),
        p["noise_model"],
        assumed()["noise_model_both"],
        p["target_damping"],
        p["selectivity"],
    )


def model_errors(rng: np.random.Generator, size: float | None = None) -> Float64[np.ndarray, "8"]:
    """Relative errors of the eight frequencies that the observer works with, uniform within `size`."""
    size = assumed()["model_error"] if size is None else size
    return rng.uniform(-size, size, len(published()["frequencies_hz"]))


def observer_model(plant: ModalModel) -> ModalModel:
    """The eight published modes, and the compliance of the others."""
    return truncate(plant, RETAINED, len(plant.frequencies) - RETAINED)


def rig_loops(
    geometry: Geometry,
    settings: RigSettings,
    errors: Float64[np.ndarray, "8"] | None = None,
    positions=POSITIONS,
    omega: Float64[np.ndarray, " frequencies"] | None = None,
    cases: tuple[str, ...] = CASES,
    known: ModalModel | None = None,
) -> dict[str, list[RigLoop]]:
    """Loops of the wanted cases, each at all positions.

    The observers work with the rig's own eight modes, off by `errors`, and the compliance of the others; or with what
    is `known` at all four actuators and sensors, such as an identified model.
    """
    full, used = rig_model(geometry), geometry.used
    loops = {case: [] for case in cases}
    intensities = {"MC": settings.noise_model, "AD": None, "MC and AD": settings.noise_model_both}
    for position in positions:
        plant = full.at(used, position)
        matrices = decoupling(geometry, used, position)
        model = observer_model(plant) if known is None else known.at(used, position)
        model = model if errors is None else detuned(model, errors)
        observer = cache(partial(rig_observer, model, settings.noise, settings.sample_time))
        for case in cases:
            block = None
            if case in intensities:
                target = settings.target_damping if "AD" in case else None
                each = observer(intensities[case])
                block = rig_compensator(each, "MC" in case, target, settings.selectivity)
            loops[case].append(make_rig_loop(plant, block, matrices, settings.sample_time, omega))
    return loops


def rig_controllers(masses: Float64[np.ndarray, "3"]) -> Callable[[float, float], tuple[Pid, Pid, Pid]]:
    """PIDs on the motions of the edges from the design bandwidths of z and of both rotations (Hz)."""
    z, rx, ry = (partial(_pid, mass) for mass in masses.tolist())
    return lambda z_hz, rotation_hz: (z(z_hz), rx(rotation_hz), ry(rotation_hz))


@lru_cache(maxsize=10_000)  # all searches of one geometry begin with the same ones
def _pid(mass: float, bandwidth_hz: float) -> Pid:
    return PidFamily(mass)(bandwidth_hz)


def bandwidths(loops: dict[str, list[RigLoop]], measure: str) -> dict[str, RigBandwidth]:
    """Largest bandwidth of every case; `no_bandwidth` where no bandwidth passes."""
    found = dict.fromkeys(loops, no_bandwidth())
    for case, loop in loops.items():
        with suppress(Infeasible):
            found[case] = maximise_rig_bandwidth(loop, rig_controllers(loop[0].decoupling.masses), measure)
    return found


COLOURS = dict(zip(CASES, (figures.BLACK, figures.BLUE, figures.GREEN, figures.RED), strict=True))
FORCES, MOTIONS = ("F_z", "M_x", "M_y"), ("z", "r_x", "r_y")


def frequencies(
    low_hz: float = 5.0, high_hz: float = 2000.0, points: int = 200, around: int = 15
) -> np.ndarray:
    """Frequencies of the figures (rad/s), dense around the published modes."""
    p = published()
    w, z = 2 * np.pi * np.array(p["frequencies_hz"]), np.array(p["damping"])
    return resonance_grid(w * (-z + 1j), low_hz, high_hz, points, around)
