"""Chapters 1 and 2: three masses, sampled matrices as printed, and the explorers of position dependence and reduction."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from experiments.motion.machines import chain, chain_matrix
from experiments.motion.pictures import paint_bode
from stillwork.base.checks import InputError, require_array, require_choice, require_number
from stillwork.control.bandwidth import Bandwidth, Loop, PeakConstraint, make_loop, maximise_bandwidth
from stillwork.control.pid import Pid, PidFamily
from stillwork.lti.discretisation import zoh
from stillwork.lti.modal import ModalModel, modal_model
from stillwork.lti.peaks import resonance_grid
from stillwork.lti.reduction import roll_off, truncate
from stillwork.lti.state_space import StateModel
from stillwork.workbook import figures


def three_masses(masses: ArrayLike, springs: ArrayLike) -> ModalModel:
    """Three masses in a row, the force on the first, positions of all (Fig. 1.7a)."""
    masses = require_array("masses", masses, shape=(3,))
    springs = require_array("springs", springs, shape=(2,))
    places = np.eye(3)
    return modal_model(np.diag(masses), chain_matrix(springs), places[:, :1], places, 0.005)


def scaled_springs(masses: ArrayLike, bandwidth_hz: float) -> np.ndarray:
    """Equal springs for which the loop through x2 has this bandwidth: all frequencies go with their root."""
    require_number("bandwidth_hz", bandwidth_hz, above=0.0)
    trial = np.full(2, 1e7)
    _, best = designed_for_second(three_masses(masses, trial), float(np.sum(masses)))
    return trial * (bandwidth_hz / best.crossing_hz[0]) ** 2


def designed_for_second(machine: ModalModel, mass: float) -> tuple[tuple[Loop, Loop], Bandwidth]:
    """Loops through x1 and x2, and the largest PID bandwidth for x2 alone."""
    first, second = (make_loop(machine.at([0], [k])) for k in (0, 1))
    scale = machine.frequencies[1] / (2 * np.pi)
    limits = [PeakConstraint("input_sensitivity")]
    best = maximise_bandwidth([second], PidFamily(mass), limits, 0.02 * scale, 0.9 * scale, scan=150)
    return (first, second), best


def stability_trial(rng: np.random.Generator, spread: float) -> dict[str, float]:
    """One machine with masses and springs drawn within +-`spread`: is x2 stable, and x1 unstable?"""
    masses, springs = 4 * (1 + rng.uniform(-spread, spread, 3)), 1e7 * (1 + rng.uniform(-spread, spread, 2))
    loops, best = designed_for_second(three_masses(masses, springs), float(masses.sum()))
    stable = [bool(np.all(loop.poles(best.controller).real < 0)) for loop in loops]
    return {"first_unstable": float(not stable[0]), "second_stable": float(stable[1])}


VARIANTS = ("exact", "printed", "lightly damped")


def transition(
    omega: float, damping: float, sample_time: float, variant: str = "exact"
) -> Float64[np.ndarray, "2 2"]:
    r"""Transition matrix of one flexible mode, states :math:`(\eta, \dot\eta)`.

    ``exact``; ``printed``, (2.31) to the letter, whose off-diagonal terms lack :math:`1/\sqrt{1-\zeta^2}`;
    ``lightly damped``, (2.32).
    """
    require_number("omega", omega, above=0.0)
    require_number("damping", damping, at_least=0.0, below=1.0)
    require_number("sample_time", sample_time, above=0.0)
    require_choice("variant", variant, VARIANTS)
    root = np.sqrt(1 - damping**2)
    decay = np.exp(-damping * omega * sample_time)
    if variant == "lightly damped":
        sine, cosine = np.sin(omega * sample_time), np.cos(omega * sample_time)
        return decay * np.array([[cosine, sine / omega], [-omega * sine, cosine]])
    sine, cosine = np.sin(omega * root * sample_time), np.cos(omega * root * sample_time)
    ratio = damping / root
    off = sine / root if variant == "exact" else sine
    return decay * np.array([[ratio * sine + cosine, off / omega], [-omega * off, cosine - ratio * sine]])


def transition_error(omega: float, ratios, sample_time: float, variant: str, row: int) -> list[float]:
    """Relative error of an entry in the second column of a variant's transition matrix, by damping ratio."""
    pairs = ([transition(omega, ratio, sample_time, each) for each in (variant, "exact")] for ratio in ratios)
    return [float(np.abs(given / exact - 1)[row, 1]) for given, exact in pairs]


def undamped_input(omega: float, shapes, sample_time: float) -> Float64[np.ndarray, "2 inputs"]:
    """Input matrix of one flexible mode without its damping, (2.33)."""
    require_number("omega", omega, above=0.0)
    shapes = require_array("shapes", shapes, ndim=1)
    return np.array(
        [(1 - np.cos(omega * sample_time)) / omega**2 * shapes, np.sin(omega * sample_time) / omega * shapes]
    )


def undamped_disturbance(
    omega: float, on_position, on_velocity, sample_time: float
) -> Float64[np.ndarray, "2 disturbances"]:
    """Disturbance matrix of one flexible mode without its damping, (2.34), for G_i = (g_i1, g_i2)."""
    require_number("omega", omega, above=0.0)
    g1 = require_array("on_position", on_position, ndim=1)
    g2 = require_array("on_velocity", on_velocity, ndim=1)
    sine, cosine = np.sin(omega * sample_time), np.cos(omega * sample_time)
    return np.array([(1 - cosine) / omega**2 * g2 + sine / omega * g1, sine / omega * g2 + (cosine - 1) * g1])


def disturbance_matrix(
    model: ModalModel, disturbance, sample_time: float
) -> Float64[np.ndarray, "states disturbances"]:
    """Exact zero-order-hold disturbance matrix for any G (form 1), by the matrix exponential."""
    states = model.state_space()
    g = require_array("disturbance", disturbance, shape=(len(states.a), None))
    held = zoh(StateModel(states.a, g, states.c, np.zeros((len(states.c), g.shape[1]))), sample_time)
    return held.b


def discrete_compliance(model: StateModel) -> Float64[np.ndarray, "outputs inputs"]:
    """Static gain C (I - A)^-1 B + D of a discrete model without rigid-body modes, (2.22)."""
    if not model.sample_time:
        raise InputError("model is in continuous time; discretise it first")
    return model.c @ np.linalg.solve(np.eye(len(model.a)) - model.a, model.b) + model.d


def paint_nyquist(loops: Mapping[str, Loop], controller: Pid):
    """Nyquist plot of open loops near -1, with the verdict of the closed-loop eigenvalues."""
    figure, axis = figures.new(1, 1, height=4.2)
    for label, loop in loops.items():
        open_loop = loop.at(controller).loop
        stable = bool(np.all(loop.poles(controller).real < 0))
        near = np.abs(open_loop) < 30
        axis.plot(
            open_loop.real[near], open_loop.imag[near], label=f"{label}: {'stable' if stable else 'unstable'}"
        )
    axis.plot([-1], [0], "+", color=figures.BLACK, markersize=12, label="-1")
    axis.set(xlim=(-6, 6), ylim=(-6, 6))
    axis.set_aspect("equal")
    axis.set(xlabel="real part", ylabel="imaginary part")
    axis.legend()
    return figure


def paint_three_masses(bandwidth_hz: float):
    """Explorer: Nyquist plot of Example 1.5.1 for both sensor positions."""
    masses = np.full(3, 4.0)
    machine = three_masses(masses, scaled_springs(masses, 45.0))
    controller = PidFamily(masses.sum())(bandwidth_hz)
    return paint_nyquist({f"$x_{k + 1}$": make_loop(machine.at([0], [k])) for k in (0, 1)}, controller)


def paint_reduction(retained: int, cutoff_hz: float):
    """Explorer: model error of the reduced ten-mass chain, with and without compliance."""
    full = chain(np.full(10, 2.0)).at([0], [0])
    omega = resonance_grid(full.poles, 0.3, 300.0, 300, 20)
    exact = full.frequency_response(omega)[0, 0]
    compensated = truncate(full, int(retained), 10 - int(retained))
    reduced = {
        "truncated": truncate(full, int(retained)),
        "with compliance": compensated,
        "rolled off": roll_off(compensated, cutoff_hz),
    }
    curves = {"full": (omega, exact)} | {
        f"error, {name}": (omega, exact - each.frequency_response(omega)[0, 0])
        for name, each in reduced.items()
    }
    return paint_bode(
        curves, "magnitude (dB re 1 m/N)", styles={"full": {"color": figures.GREY}}, height=3.2
    )[0]


def paint_heavy_mass(place: int, mass_kg: float):
    """Explorer: force to position at mass 1 of the five-mass chain with one mass changed."""
    masses = np.full(5, 1.6)
    masses[int(place) - 1] = mass_kg
    curves = {}
    for label, values in (("all 1.6 kg", np.full(5, 1.6)), (f"mass {int(place)}: {mass_kg:g} kg", masses)):
        machine = chain(values).at([0], [0])
        omega = resonance_grid(machine.poles, 5.0, 100.0, 300, 30)
        curves[label] = (omega, machine.frequency_response(omega)[0, 0])
    return paint_bode(curves, "$f_1$ to $x_1$ (dB re 1 m/N)", height=3.2)[0]


def paint_transition_error(frequency_hz: float, damping: float):
    """Explorer: error of the printed and of the lightly damped transition matrix over the sample time."""
    sample_times = np.geomspace(1e-6, 0.4 / frequency_hz, 200)
    figure, axis = figures.new(1, 1, height=2.8)
    w = 2 * np.pi * frequency_hz
    size = np.array([[1, 1 / w], [w, 1]])  # of each entry, which itself passes zero
    for variant in VARIANTS[1:]:
        pairs = (
            [transition(w, damping, sample_time, each) for each in (variant, "exact")]
            for sample_time in sample_times
        )
        error = [(np.abs(given - exact) / size).max() for given, exact in pairs]
        axis.loglog(1e3 * sample_times, error, label=variant)
    axis.set(xlabel="sample time (ms)", ylabel="largest error, scaled entries")
    axis.legend()
    return figure
