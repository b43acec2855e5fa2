"""The ways to damp that section 4.3 compares, each as the decoupled machine it makes, on any geometry."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from experiments.motion.beam import beam, beam_parameters
from experiments.motion.decoupled_damping import (
    added_damping,
    band_passed,
    constrained_damping,
    constrained_stiffness,
    coupling_onset,
    fed_back_states,
    rigid_coupling,
)
from experiments.motion.loop_conditions import slope
from experiments.motion.machines import published_noise
from stillwork.base.validation import checked
from stillwork.control.applications import Application, compensator
from stillwork.control.decoupling import decouple, decoupled_plant
from stillwork.control.feedback import band_pass, damping_gain, stiffness_gain
from stillwork.control.loops import channel, closed_loop
from stillwork.estimation.observer import Observer, kalman_observer
from stillwork.lti.modal import ModalModel
from stillwork.lti.peaks import refine_peak, resonance_grid
from stillwork.lti.reduction import truncate
from stillwork.lti.state_space import StateModel, constant


def common_centre(model: ModalModel, gain: Float64[np.ndarray, "inputs states"]) -> float:
    """Centre of a band-pass for all damped modes, rad/s: the geometric mean of the first and the last.

    Remark 4.3.2, whose index of the last mode is read as that of the last damped flexible mode.
    """
    damped = model.frequencies[fed_back_states(gain) // 2]
    return float(np.sqrt(damped.min() * damped.max()))


def half_power_selectivity(model: ModalModel, gain: Float64[np.ndarray, "inputs states"]) -> float:
    """Q that puts the half-power points of the common band-pass on the first and the last damped mode."""
    damped = model.frequencies[fed_back_states(gain) // 2]
    return float(common_centre(model, gain) / (damped.max() - damped.min()))


@checked
def common_band_passed(
    model: ModalModel, gain: Float64[np.ndarray, "inputs states"], selectivity: float
) -> StateModel:
    """Dynamic gain K(s) with one band-pass for all damped modes (Remark 4.3.2).

    The gains make up for the magnitude of the filter at each resonance, not for its phase. One filter an
    actuator or one a fed-back state, whichever is fewer: a single filter serves a gain of rank one only.
    """
    fed = fed_back_states(gain)
    one = band_pass(common_centre(model, gain), selectivity)
    mended = gain.copy()
    mended[:, fed] /= np.abs(one.frequency_response(model.frequencies[fed // 2])[0, 0])
    if len(fed) <= len(gain):
        before, behind = np.eye(gain.shape[1])[fed], mended[:, fed]
    else:
        before, behind = mended, np.eye(len(gain))
    a, b, c = (np.kron(np.eye(len(before)), getattr(one, name)) for name in "abc")
    return StateModel(a, b @ before, behind @ c, np.zeros_like(gain))


# Name to the number of actuators beyond that of the rigid-body modes; None: one per mode.
SCHEMES = {
    "undamped": 0,
    "each mode": 0,
    "minimal interaction": 0,
    "band-passes": 0,
    "common band-pass": 0,
    "minimal actuation": 0,
    "over-actuation": 1,
    "total actuation": None,
    "band-passes and over-actuation": 1,
    "stiffness": 0,
    "stiffness, second order": 0,
    "stiffness, fourth order": 0,
    "stiffness, over-actuation": 1,
}

STATIC = ("each mode", "minimal interaction")  # couple both axes, by a closed form
FILTERED = ("band-passes", "common band-pass")
DAMPING = (*STATIC, *FILTERED)  # poles are looked at too

# Without a coupling of their own at low frequency, but with a rounding that grows as 1/s^2: of the estimated
# rigid body, or of a stiffness force that must not reach it. Where the compliance nearly cancels it is worth up to
# 1e-3 in the slope, another on every processor, so theirs are given to two decimals.
ROUNDED = ("compensation", "stiffness, over-actuation")


@dataclass(frozen=True)
class Settings:
    """Of the feedback of section 4.3; see ``data/motion/beam.toml``."""

    increase: float  # of the damping ratios
    damped: int  # flexible modes
    selectivity: float  # Q of the band-pass of each mode
    stiffness_factor: float  # on the frequencies
    common_selectivity: float | None = None  # None: half-power points on the outermost damped modes


def published_settings() -> Settings:
    """Those of section 4.3, with the assumed factor of active stiffness."""
    p = beam_parameters()
    printed = {name: p["published"][name] for name in ("increase", "damped", "selectivity")}
    return Settings(**printed, stiffness_factor=p["assumed"]["stiffness_factor"])


def actuators_of(name: str, machine: ModalModel) -> int:
    """Number of actuators that one of `SCHEMES` takes."""
    extra = SCHEMES[name]
    return len(machine.frequencies) if extra is None else machine.rigid_modes + extra


def scheme_gain(name: str, plant: ModalModel, settings: Settings) -> np.ndarray | StateModel:
    """Gain K or K(s) of one of `SCHEMES` on the states of the retained modes."""
    actuators = plant.input_shapes.shape[1]
    flexible = np.arange(len(plant.frequencies) - plant.rigid_modes)
    retained = truncate(plant, plant.rigid_modes + settings.damped)
    increase = np.where(flexible < settings.damped, settings.increase, 0.0)
    factor = np.where(flexible < settings.damped, settings.stiffness_factor, 1.0)
    fed = slice(0, 2 * len(retained.frequencies))
    if name == "undamped":
        return np.zeros((actuators, fed.stop))
    if name in STATIC:
        return damping_gain(retained, settings.increase, name)
    if name == "band-passes":
        return band_passed(plant, damping_gain(retained, settings.increase), settings.selectivity)
    if name == "common band-pass":
        gain = damping_gain(retained, settings.increase)
        selectivity = settings.common_selectivity or half_power_selectivity(plant, gain)
        return common_band_passed(plant, gain, selectivity)
    if name == "band-passes and over-actuation":
        gain = constrained_damping(plant, increase, range(plant.rigid_modes, len(plant.frequencies)))[:, fed]
        return band_passed(plant, gain, settings.selectivity)
    if name == "stiffness, over-actuation":
        return constrained_stiffness(plant, factor)[:, fed]
    if name.startswith("stiffness"):
        gain = stiffness_gain(retained, settings.stiffness_factor)
        orders = {"stiffness, second order": 2, "stiffness, fourth order": 4}
        return band_passed(plant, gain, settings.selectivity, orders[name]) if name in orders else gain
    return constrained_damping(plant, increase)[:, fed]  # minimal, over- and total actuation


def with_scheme(name: str, plant: ModalModel, settings: Settings, observed: bool = False) -> StateModel:
    """The decoupled machine, u to q, under one of `SCHEMES`: on the true states, or on `reduced_observer`'s."""
    observer = reduced_observer(plant, settings) if observed else None
    return decoupled_plant(plant, decouple(plant), scheme_gain(name, plant, settings), observer)


def reduced_observer(plant: ModalModel, settings: Settings) -> Observer:
    """Kalman observer of section 4.3.1: the retained modes, with the compliance of the others."""
    retained = plant.rigid_modes + settings.damped
    return kalman_observer(truncate(plant, retained, len(plant.frequencies) - retained), published_noise())


def with_compensation(plant: ModalModel, settings: Settings) -> StateModel:
    """The decoupled machine, u to q, with measurement compensation by `reduced_observer` (Fig. 4.14)."""
    block = compensator(reduced_observer(plant, settings), Application(compensate=True))
    outputs, inputs = plant.feedthrough.shape
    idle = constant(np.zeros((inputs, outputs)))
    error = channel(closed_loop(plant, block, idle), "u_ff", "e_meas", inputs, outputs)
    both = decouple(plant)
    return StateModel(
        error.a, error.b @ both.actuation, -both.sensing @ error.c, -both.sensing @ error.d @ both.actuation
    )


def sample_beam(rng: np.random.Generator) -> ModalModel:
    """A tapered beam with its five actuators and two sensors anywhere, but a tenth apart at least."""
    modes = 2 + len(beam_parameters()["published"]["frequencies_hz"])
    actuators, sensors = (sample_places(rng, count, 0.1) for count in (modes, 2))
    return beam(actuators, sensors, taper=rng.uniform(-1, 1))


def sample_places(rng: np.random.Generator, count: int, spacing: float) -> Float64[np.ndarray, " places"]:
    """Places from 0 to 1 in any order, at least `spacing` apart, all such sets alike."""
    # Spread over what the gaps leave, then put the gaps in: uniform over all places that keep them.
    free = np.sort(rng.uniform(0, 1 - spacing * (count - 1), count))
    return rng.permutation(free + spacing * np.arange(count))


def geometry_trial(
    rng: np.random.Generator, schemes: Sequence[str], settings: Settings
) -> Mapping[str, float | np.ndarray]:
    """One machine of the study: what its decoupled plants are like under some `SCHEMES` or ``compensation``.

    Of each scheme the ``slopes`` in the limit and ``slopes above``, at 0.03 to 0.3 Hz (axes, axes), ``low`` (entries
    at 1 Hz), ``peak`` (largest off-diagonal entry around the second flexible mode over the undamped one with these
    actuators), and whether it is ``stable``; for MC the entries ``at modes`` (axes, axes, damped modes) over the
    undamped; for those in `STATIC` the ``onset_hz`` of the coupling and ``limit``, the entries at 1 uHz over their
    closed form; for those in `DAMPING` the ``added`` damping ratio and the ``shift`` of the frequency (damped modes);
    for those in `FILTERED` the ``crosswise`` force (damped modes).
    """
    machine = sample_beam(rng)
    modes = machine.frequencies[machine.rigid_modes :]
    damped = modes[: settings.damped]
    found, bare = {}, {}
    for name in schemes:
        actuators = actuators_of("undamped" if name == "compensation" else name, machine)
        plant = machine.at(range(actuators), range(machine.rigid_modes))
        if actuators not in bare:
            undamped = with_scheme("undamped", plant, settings)
            bare[actuators] = undamped, off_diagonal_peak(undamped, modes[1])
        undamped, peak = bare[actuators]
        if name == "compensation":
            system = with_compensation(plant, settings)
            ratio = system.frequency_response(damped) / undamped.frequency_response(damped)
            found[f"{name}: at modes"] = np.abs(ratio)
        else:
            system = with_scheme(name, plant, settings)
        above = low_frequency_slopes(system, 0.03, 0.3)
        if name in ROUNDED:
            above = np.round(above, 2) + 0.0  # no -0
        found |= {
            f"{name}: slopes": above if name in ROUNDED else low_frequency_slopes(system),
            f"{name}: slopes above": above,
            f"{name}: low": np.abs(system.frequency_response([2 * np.pi])[..., 0]),
            f"{name}: peak": off_diagonal_peak(system, modes[1]) / peak,
            f"{name}: stable": oscillates_stably(system),
        }
        if name in STATIC:
            gain, both, still = scheme_gain(name, plant, settings), decouple(plant), 2e-6 * np.pi
            # Of s times the response the real part: the compliance is imaginary there.
            reached = (1j * still * system.frequency_response([still])[..., 0]).real
            found[f"{name}: limit"] = reached / rigid_coupling(plant, gain, both)
            found[f"{name}: onset_hz"] = coupling_onset(plant, gain, both) / (2 * np.pi)
        if name in DAMPING:
            for quantity, values in zip(("added", "shift"), added_damping(plant, system), strict=True):
                found[f"{name}: {quantity}"] = values[: settings.damped]
        if name in FILTERED:
            found[f"{name}: crosswise"] = crosswise_force(plant, scheme_gain(name, plant, settings), damped)
    return found


def crosswise_force(
    plant: ModalModel, gain: StateModel, damped: Float64[np.ndarray, " modes"]
) -> Float64[np.ndarray, " modes"]:
    """Largest force on each damped mode, at its own resonance, by the unit velocity of another one."""
    rigid, count = plant.rigid_modes, len(damped)
    response = gain.frequency_response(damped)[:, 2 * rigid + 1 : 2 * (rigid + count) : 2]
    # at mode i's resonance
    forces = np.einsum("if,fji->ij", plant.input_shapes[rigid : rigid + count], response)
    return np.where(np.eye(count, dtype=bool), 0, np.abs(forces)).max(axis=1)


def off_diagonal_peak(system: StateModel, omega: float) -> float:
    """Largest off-diagonal magnitude within a fifth of a frequency (rad/s)."""
    low, high = omega * (1 - 0.2) / (2 * np.pi), omega * (1 + 0.2) / (2 * np.pi)
    grid = resonance_grid(system.poles, low, high, 40, 5)

    def largest(frequencies: np.ndarray) -> np.ndarray:
        response = np.abs(system.frequency_response(frequencies))
        return response[~np.eye(len(response), dtype=bool)].max(axis=0)

    return refine_peak(largest, grid, largest(grid)).magnitude


def oscillates_stably(system: StateModel) -> bool:
    """Whether every pole but those of the rigid-body modes, at the origin, is stable."""
    poles = system.poles
    return bool(np.all(poles[np.abs(poles) > 1e-4 * np.abs(poles).max()].real < 0))


def low_frequency_slopes(
    system: StateModel, low_hz: float = 1e-6, high_hz: float = 1e-5
) -> Float64[np.ndarray, "outputs inputs"]:
    """Slope of every entry in decades a decade between two frequencies far below everything else.

    A 1/s coupling that nearly cancels, as on a machine close to symmetry, shows at very low frequency only:
    by default the slope is that of the limit. Where it sets in, `coupling_onset` says.
    """
    omega = 2 * np.pi * np.geomspace(low_hz, high_hz, 7)
    response = system.frequency_response(omega)
    return np.array([[slope(omega, entry) for entry in row] for row in response])
