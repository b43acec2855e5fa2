"""Decoupling and its damping against direct solutions, closed-form limits and least norm."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.motion.beam import published_beam
from experiments.motion.decoupled_damping import (
    added_damping,
    constrained_damping,
    constrained_stiffness,
    coupling_onset,
    rigid_coupling,
)
from experiments.motion.decoupling_schemes import (
    ROUNDED,
    SCHEMES,
    Settings,
    actuators_of,
    low_frequency_slopes,
    oscillates_stably,
    published_settings,
    sample_beam,
    scheme_gain,
    with_compensation,
    with_scheme,
)
from experiments.motion.machines import published_noise
from stillwork.control.decoupling import decouple, decoupled_plant
from stillwork.control.feedback import damping_gain
from stillwork.estimation.observer import kalman_observer
from stillwork.lti import ModalModel
from stillwork.lti.reduction import truncate

SETTINGS = published_settings()
PLANT = published_beam(2)
PUBLISHED_SLOPES = dict.fromkeys(SCHEMES, (0, 0)) | {
    "each mode": (-1, -1),
    "minimal interaction": (-1, -1),
    "minimal actuation": (0, -1),
    "stiffness": (-2, -2),
    "stiffness, second order": (-1, -1),
}
MACHINES = st.tuples(st.integers(0, 10**6), st.floats(30, 500), st.floats(1.4, 4), st.floats(1e-3, 0.03))


def machine_of(seed: int, first_hz: float, ratio: float, damping: float) -> ModalModel:
    return replace(
        sample_beam(np.random.default_rng(seed)),
        frequencies=2 * np.pi * first_hz * np.array([0, 0, 1, ratio, ratio**2]),
        damping=np.array([0, 0, damping, damping, damping]),
    )


def plant_of(name: str, machine: ModalModel = published_beam(5)) -> ModalModel:  # noqa: B008
    return machine.at(range(actuators_of(name, machine)), [0, 1])


def feedback(name: str, plant: ModalModel, s: complex) -> np.ndarray:
    """Forces on unit modal positions, (inputs, modes), written down from the definitions."""
    phi, w = plant.input_shapes, plant.frequencies
    gain, wanted = np.zeros((phi.shape[1], 5), complex), {2: 2 * 0.05 * w[2] * s, 3: 2 * 0.05 * w[3] * s}
    if "stiffness" in name:
        wanted = {j: (1.2**2 - 1) * w[j] ** 2 for j in wanted}
    others = {"minimal actuation": [0], "over-actuation": [0, 1], "total actuation": range(5)}
    others |= {"stiffness, over-actuation": [0, 1], "band-passes and over-actuation": [2, 3, 4]}
    for j, rate in wanted.items():
        if name == "minimal interaction":
            gain[:, j] = -rate * np.linalg.pinv(phi[:4])[:, j]
        elif name in others:
            rows = [j, *(i for i in others[name] if i != j)]
            gain[:, j] = -rate * np.linalg.solve(phi[rows], np.eye(len(rows))[:, 0])
        else:
            gain[:, j] = -rate * phi[j] / (phi[j] @ phi[j])
        centre, q = (w[j], 2.0)
        if name == "common band-pass":
            centre = np.sqrt(w[2] * w[3])
            q = centre / (w[3] - w[2])
        passed = (centre / q * s) / (s**2 + centre / q * s + centre**2)
        at = 1j * w[j]
        if "band-pass" in name:
            gain[:, j] *= passed / abs((centre / q * at) / (at**2 + centre / q * at + centre**2))
        elif "order" in name:
            gain[:, j] *= passed ** (2 if "fourth" in name else 1)
    return gain


@pytest.mark.parametrize("name", [name for name in SCHEMES if name != "undamped"])
def test_every_scheme_is_what_its_equations_say(name):
    """Second-order equations of motion, solved frequency by frequency."""
    plant = plant_of(name)
    both = decouple(plant)
    omega = 2 * np.pi * np.array([0.3, 40.0, 161.0, 300.0, 517.0, 755.0, 1500.0])
    direct = []
    for s in 1j * omega:
        own = np.diag(s**2 + 2 * plant.damping * plant.frequencies * s + plant.frequencies**2)
        response = np.linalg.solve(own - plant.input_shapes @ feedback(name, plant, s), plant.input_shapes)
        direct.append(both.sensing @ plant.output_shapes @ response @ both.actuation)
    direct = np.moveaxis(direct, 0, -1)
    found = with_scheme(name, plant, SETTINGS).frequency_response(omega)
    assert np.allclose(found, direct, rtol=1e-7, atol=1e-13 * np.abs(direct).max(axis=(0, 1)))


@settings(max_examples=12)
@given(MACHINES, st.sampled_from([name for name in SCHEMES if name != "total actuation"]))
def test_slopes_do_not_depend_on_the_machine(machine, name):
    system = with_scheme(name, plant_of(name, machine_of(*machine)), SETTINGS)
    found = low_frequency_slopes(system, *((0.03, 0.3) if name in ROUNDED else ()))
    assert (found[0, 1], found[1, 0]) == pytest.approx(PUBLISHED_SLOPES[name], abs=0.01)
    assert np.diag(found) == pytest.approx(-2, abs=0.01)


@settings(max_examples=15)
@given(MACHINES)
def test_total_actuation_decouples_and_damps_exactly(machine):
    plant = machine_of(*machine)
    system = with_scheme("total actuation", plant, SETTINGS)
    omega = np.geomspace(1.0, 2e4, 50)
    response = np.abs(system.frequency_response(omega))
    tightness = np.linalg.cond(plant.input_shapes)
    assert response[[0, 1], [1, 0]].max() < 1e-14 * tightness * response[[0, 1], [0, 1]].max()
    np.testing.assert_allclose(response[[0, 1], [0, 1]] * omega**2, 1, rtol=1e-12 * tightness)
    added, shift = added_damping(plant, system)
    assert np.allclose(added, [0.05, 0.05, 0.0], atol=1e-9 * tightness)
    assert np.allclose(shift, 0, atol=1e-9 * tightness)


@settings(max_examples=15)
@given(MACHINES)
def test_coupling_at_low_frequency_is_the_limit(machine):
    """The expansion s q = c + O(s) of (4.15), with one mode damped as in print."""
    plant = plant_of("each mode", machine_of(*machine))
    gain, both = damping_gain(plant.modes([0, 1, 2]), 0.05), decouple(plant)
    theta = plant.input_shapes[2] @ both.actuation
    printed = [plant.input_shapes[i] @ gain[:, 5] * theta[1 - i] / plant.frequencies[2] ** 2 for i in (0, 1)]
    limit = rigid_coupling(plant, gain, both)
    assert [limit[0, 1], limit[1, 0]] == pytest.approx(printed, rel=1e-9)
    s = 1e-5j
    response = (s * decoupled_plant(plant, both, gain).frequency_response([1e-5])[..., 0]).real
    assert [response[0, 1], response[1, 0]] == pytest.approx(printed, rel=1e-6)


def test_compliance_of_the_machine_reaches_the_axes_and_the_observer():
    """A feedthrough, as a truncated model has it: against the loop written down."""
    plant = truncate(PLANT, 4, 1)
    gain, both = damping_gain(plant, 0.05), decouple(plant)
    omega = 2 * np.pi * np.array([5.0, 161.0, 400.0, 900.0])
    direct, unit = [], np.eye(2)
    for s in 1j * omega:
        own = np.diag(1 / (s**2 + 2 * plant.damping * plant.frequencies * s + plant.frequencies**2))
        states = own @ plant.input_shapes
        forces = np.linalg.solve(unit - s * gain[:, 1::2] @ states, both.actuation)
        direct.append(both.sensing @ (plant.output_shapes @ states + plant.feedthrough) @ forces)
    direct = np.moveaxis(direct, 0, -1)
    for observer in (None, kalman_observer(plant, published_noise())):
        found = decoupled_plant(plant, both, gain, observer).frequency_response(omega)
        assert np.allclose(found, direct, rtol=1e-6, atol=1e-12 * np.abs(direct).max(axis=(0, 1)))


def test_onset_is_where_coupling_meets_compliance():
    gain, both = scheme_gain("each mode", PLANT, SETTINGS), decouple(PLANT)
    onset = coupling_onset(PLANT, gain, both)
    undamped = np.abs(with_scheme("undamped", PLANT, SETTINGS).frequency_response([1e-2])[..., 0])
    damped = decoupled_plant(PLANT, both, gain)
    for place in ((0, 1), (1, 0)):
        at = onset[place] * 1e-2
        coupling = np.abs(damped.frequency_response([at])[..., 0].imag)
        assert coupling[place] * 1e-2 == pytest.approx(undamped[place], rel=1e-4)


@pytest.mark.parametrize("constrained", [constrained_damping, constrained_stiffness])
def test_constrained_gain_is_the_least_norm_solution(constrained):
    """Against the KKT system of min |k|^2 with the constraints of (4.19) and (4.20)."""
    plant = published_beam(4)
    damping = constrained is constrained_damping
    gain = constrained(plant, [0.05, 0, 0] if damping else [1.1, 1, 1], (0, 3))
    wanted = 0.1 * plant.frequencies[2] if damping else 0.21 * plant.frequencies[2] ** 2
    rows = plant.input_shapes[[0, 3, 2]]
    kkt = np.block([[np.eye(4), rows.T], [rows, np.zeros((3, 3))]])
    expected = np.linalg.solve(kkt, [0, 0, 0, 0, 0, 0, -wanted])[:4]
    np.testing.assert_allclose(gain[:, 4 + damping], expected, rtol=1e-9)
    gain[:, 4 + damping] = 0
    assert not np.any(gain)


def test_compensation_leaves_the_compliance_of_the_unknown_mode():
    plant = PLANT
    both = decouple(plant).apply(plant)
    static = np.outer(both.output_shapes[:, 4], both.input_shapes[4]) / plant.frequencies[4] ** 2
    found = with_compensation(plant, SETTINGS).frequency_response([0.5])[..., 0]
    assert [found[0, 1].real, found[1, 0].real] == pytest.approx([static[0, 1], static[1, 0]], rel=1e-4)
    # Its dynamics too, halfway to the first resonance, because the observer knows the compliance.
    s, w = 2j * np.pi * 80, plant.frequencies[4]
    third = static * w**2 / (s**2 + 2 * 0.005 * w * s + w**2)
    found = with_compensation(plant, SETTINGS).frequency_response([s.imag])[..., 0]
    assert [found[0, 1], found[1, 0]] == pytest.approx([third[0, 1], third[1, 0]], rel=0.02)


@pytest.mark.parametrize(
    ("name", "sections"), [("stiffness, second order", 1), ("stiffness, fourth order", 2)]
)
def test_band_passed_stiffness_takes_damping_away(name, sections):
    """Against the characteristic polynomial of one mode with its filters."""
    single, q, factor = PLANT.modes([0, 1, 2]), 2.0, 1.05
    system = with_scheme(name, single, Settings(0.05, 1, q, factor))
    added, _ = added_damping(single, system)
    passed = np.poly1d([1, 0]) / q
    own, filters = np.poly1d([1, 2 * 0.005, 1]), (np.poly1d([1, 0, 1]) + passed) ** sections
    roots = (own * filters + (factor**2 - 1) * passed**sections).roots
    mode = roots[np.argmin(np.abs(roots - 1j))]
    assert added[0] == pytest.approx(-mode.real / abs(mode) - 0.005, rel=1e-6)
    assert added[0] < -0.005
    assert not oscillates_stably(system)
    assert oscillates_stably(with_scheme("stiffness", single, Settings(0.05, 1, q, factor)))
