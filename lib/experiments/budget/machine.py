"""The machine with each paper's method or without, its floors and sources, and the budget of all of them at once."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from jaxtyping import Float64

from stillwork.base.toml_files import Table, read_toml
from stillwork.control.applications import Application
from stillwork.control.budget import ErrorBudget, Source, error_budget
from stillwork.control.budget_sources import criterion_floor, measured, tabulated, white
from stillwork.control.floor_machine import FloorMachine
from stillwork.control.machine_loops import observing_compensator
from stillwork.control.pid import PidFamily
from stillwork.estimation.observer import NoiseIntensities
from stillwork.lti.modal import ModalModel, modal_model
from stillwork.lti.state_space import StateModel
from stillwork.machine.budget_tables import PLACES, MachineFile, open_machine
from stillwork.signals.records import load_record
from stillwork.signals.spectra import estimate_spectrum
from workbook import paths

BAND_HZ = (0.5, 3000.0)
FLOORS = ("VC-A", "VC-B", "VC-C", "VC-D", "VC-E", "VC-F", "VC-G", "slab under footfall", "LIGO ground")
SLAB_HZ = (5.0, 150.0)  # where its record can be trusted (its SOURCE.md)
RESOLUTION_HZ = 0.5  # of the slab's spectrum


@dataclass(frozen=True)
class Assumed:
    """What no paper prints: factors on the frame's mass, the struts' damping and the noise beside the stage's sensor."""

    frame: float = 1.0
    damper: float = 1.0
    noise: float = 1.0
    feedforward_db: float = 0.0  # 0: the file's


AS_FILED = Assumed()


@cache
def filed() -> MachineFile:
    """The machine's file, which the commands read, too."""
    return open_machine(str(paths.data("budget", "machine.toml")))


@cache
def parameters() -> Table:
    """Of its stage, and of the methods that are tried on it."""
    return read_toml(paths.data("budget", "methods.toml"))


@cache
def stage(position: int = 0) -> ModalModel:
    """Free stage of the thesis: force on the actuator mass to the position of one other, 0: that of the machine's file."""
    p = parameters().table("stage")
    n = p["masses"] + 1
    springs = np.array([p["actuator_stiffness"], *[p["stiffness"]] * (n - 2)])
    difference, places = np.diff(np.eye(n), axis=0), np.eye(n)
    mass = np.diag([p["actuator_mass"], *[p["mass"]] * (n - 1)])
    at = position or p["position"]
    stiffness = difference.T @ (springs[:, None] * difference)
    return modal_model(mass, stiffness, places[:, :1], places[at : at + 1], p["damping_ratio"])


def level(place: str) -> float:
    """Root of the density of the noise that the file has at a place, in the place's unit per root Hz."""
    return next(
        float(np.sqrt(each._at(np.ones(1))[0, 0].real[0]))
        for each in filed().sources
        if each.places == (place,)
    )


@cache
def observer(name: str, position: int = 0, sample_time: float = 0.0, delay: float = 0.0) -> StateModel | None:
    """Compensator of one use of the thesis's observer, designed for a `delay` in samples; None for the PID alone."""
    if name == "PID":
        return None
    p, retained = parameters().table("observer"), parameters().table("stage")["retained_modes"]
    noise = NoiseIntensities(p["force_noise"] ** 2, 2 * p["sensor_noise"] ** 2)
    damped = {"damping": p["added_damping"], "selectivity": p["selectivity"]} if "AD" in name else {}
    drift = {"MC": p["drift"], "MC and AD": p["drift_with_damping"]}.get(name)
    use = Application(compensate="MC" in name, **damped)
    return observing_compensator(stage(position), use, retained, noise, drift, sample_time, delay)


def machine(
    used: str = "PID",
    *,
    skyhook: bool = False,
    feedforward: bool = False,
    bandwidth_hz: float = 0.0,
    payload: float = 0.0,
    position: int = 0,
    sample_time: float = 0.0,
    delay: float = 0.0,
    assumed: Assumed = AS_FILED,
) -> FloorMachine:
    """The machine with some of the methods; 0 Hz: the bandwidth that the thesis prints for this use of the observer.

    A `payload` (kg) stands on the frame; the springs stay.
    """
    built, law = replace(filed().machine, stage=stage(position)), parameters().table("bandwidth")
    frame = assumed.frame * built.frame_mass + payload
    lighter = np.sqrt((built.frame_mass + built.stage_mass) / (frame + built.stage_mass))
    cancelled = 1 - 10 ** (-assumed.feedforward_db / 20) if assumed.feedforward_db else built.feedforward
    return replace(
        built,
        frame_mass=frame,
        suspension_hz=lighter * built.suspension_hz,
        suspension_damping=assumed.damper * lighter * built.suspension_damping,
        controller=PidFamily(built.stage_mass)(bandwidth_hz or law["design_share"] * law[used]),
        compensator=observer(used, position, sample_time, delay),
        skyhook=built.skyhook if skyhook else 0.0,
        feedforward=cancelled if feedforward else 0.0,
        sample_time=sample_time,
        delay=delay,
    )


@cache
def floor(name: str) -> Source:
    """A floor by its name: a criterion, or one of two that were measured."""
    if name == "slab under footfall":
        record = load_record(paths.data("isolation", "slab_footfall/slab_vertical.csv"), "m/s^2")
        spectrum = estimate_spectrum(record.signals[:1], record.sample_rate, RESOLUTION_HZ)
        return replace(measured(name, "floor", "m/s^2", spectrum), band_hz=SLAB_HZ)
    if name == "LIGO ground":
        with np.load(
            paths.data("isolation", "ligo_llo_ground/ground_velocity_density.npz"), allow_pickle=False
        ) as ground:
            f, velocity = ground["frequencies_hz"], ground["velocity_density_Z"].astype(float).mean(axis=0)
        seen = f > BAND_HZ[0] / 2
        return tabulated(name, "floor", "m/s^2", f[seen], (velocity * (2 * np.pi * f) ** 2)[seen])
    return criterion_floor(name, "floor", name)


def noises(sensor: float | None = None, factor: float = 1.0) -> list[Source]:
    """What acts beside the floor; of the stage's `sensor` in m/sqrt(Hz), the others by a factor on what is assumed."""
    own_level = level("stage sensor") if sensor is None else sensor
    return [
        white("stage sensor", "stage sensor", "m", own_level),
        *(
            white(name, name, PLACES[name], factor * level(name))
            for name in ("stage drive", "floor sensor", "frame sensor")
        ),
    ]


def budget_of(built: FloorMachine, name: str, sensor: float | None = None) -> ErrorBudget:
    """The budget on one floor."""
    return error_budget(built.network(), [floor(name), *noises(sensor)], BAND_HZ)


def on_every_floor(
    built: FloorMachine, floors: tuple[str, ...] = FLOORS, factor: float = 1.0
) -> tuple[Float64[np.ndarray, " floors"], Float64[np.ndarray, "4"]]:
    """Mean squares of the error by each floor and by each of `noises`, from one pass; all add up."""
    powers = error_budget(built.network(), [*map(floor, floors), *noises(None, factor)], BAND_HZ).powers[:, 0]
    return powers[: len(floors)], powers[len(floors) :]
