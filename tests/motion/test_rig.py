"""The plate and the rig: published frequency parameters, orthogonality, brute-force Riccati, state-space loops."""

from dataclasses import replace

import control
import numpy as np
import pytest

from experiments.motion.rig import (
    POSITIONS,
    Geometry,
    assumed_geometry,
    decoupling,
    excitation,
    plate_modes,
    rig_model,
)
from experiments.motion.rig_control import rig_compensator, rig_observer
from experiments.motion.rig_designs import observer_model, published_settings, rig_controllers, rig_loops
from experiments.motion.rig_loops import (
    MEASURES,
    make_rig_loop,
    maximise_rig_bandwidth,
    sampled_controller,
)
from stillwork.base.checks import InputError
from stillwork.control.bandwidth import SIX_DB
from stillwork.estimation.observer import NoiseIntensities
from stillwork.lti.discretisation import continuous_poles, prewarped, zoh_modes, zoh_response

SAMPLE_TIME = 1e-4
GEOMETRY = assumed_geometry()
SETTINGS = published_settings()


@pytest.fixture(scope="module")
def plant():
    return rig_model(GEOMETRY).at(GEOMETRY.used, POSITIONS[1])


@pytest.fixture(scope="module")
def loops():
    return rig_loops(GEOMETRY, SETTINGS, positions=POSITIONS[1:2])


def test_square_plate_has_the_frequency_parameters_of_leissa():
    # Journal of Sound and Vibration 31 (1973), free square plate, nu = 0.3: upper bounds from 36 beam functions.
    leissa = np.array([13.489, 19.789, 24.432, 35.024, 35.024, 61.526])
    ours = plate_modes(1.0, 0.3, 6).parameters
    assert np.all(ours <= leissa)
    np.testing.assert_allclose(ours, leissa, rtol=0.011)


def test_slender_plate_without_poisson_is_a_free_beam():
    roots = np.array([4.730040745, 7.853204624])  # cosh x cos x = 1
    ours = plate_modes(0.02, 0.0, 6).parameters
    np.testing.assert_allclose(ours[0], roots[0] ** 2, rtol=1e-6)
    assert np.abs(ours - roots[1] ** 2).min() < 1e-5 * roots[1] ** 2


def test_shapes_are_orthogonal_to_one_another_and_to_rigid_motion():
    modes = plate_modes(0.8, 0.33, 10)
    x, weight = np.polynomial.legendre.leggauss(20)
    xi, eta = (grid.ravel() for grid in np.meshgrid(x, x, indexing="ij"))
    mean = np.outer(weight, weight).ravel() / 4
    shapes = modes.shapes(xi, eta)
    np.testing.assert_allclose(shapes.T @ (mean[:, None] * shapes), np.eye(10), atol=1e-12)
    rigid = np.stack([np.ones_like(xi), xi, eta])
    np.testing.assert_allclose(rigid @ (mean[:, None] * shapes), 0, atol=1e-12)


@pytest.mark.parametrize("position", POSITIONS)
def test_decoupling_leaves_only_mass_and_inertias(position):
    d = decoupling(GEOMETRY, GEOMETRY.used, position)
    rigid = rig_model(GEOMETRY).at(GEOMETRY.used, position).modes(slice(0, 3))
    mobility = d.sensing @ rigid.output_shapes @ rigid.input_shapes @ d.actuation
    np.testing.assert_allclose(mobility, np.diag(1 / d.masses), atol=1e-14)
    np.testing.assert_allclose(GEOMETRY.edge_masses, 20.0 * np.array([1, 1 / 3, 1 / 3]))


def test_four_actuators_leave_the_twisting_modes_alone():
    four, three = (np.abs(excitation(GEOMETRY, used)) for used in ((0, 1, 2, 3), GEOMETRY.used))
    assert four[0].max() < 1e-12 < 0.1 < three[0].min()


@pytest.mark.slow
def test_gain_is_where_the_printed_riccati_recursion_settles(plant):
    """The difference equation of section 6.3 with its noise model, iterated from rest, in units that keep it well scaled."""
    model = observer_model(plant).modes(slice(0, 5))
    noise, noise_model = NoiseIntensities(1e-4, 1e-14), 1e-4
    observer = rig_observer(model, noise, SAMPLE_TIME, noise_model)
    held, zero = zoh_modes(model, SAMPLE_TIME), np.zeros((3, 3))
    a = np.block([[held.a, held.b], [np.zeros((3, len(held.a))), np.eye(3)]])
    g = np.block([[held.b, np.zeros_like(held.b)], [zero, np.eye(3)]])
    c = np.hstack([held.c * 1e7, zero])
    q = np.diag([noise.process] * 3 + [noise_model] * 3)
    p = g @ q @ g.T
    for _ in range(20000):
        update = np.linalg.solve(c @ p @ c.T + np.eye(3), c @ p).T
        p = g @ q @ g.T + a @ (p - update @ (c @ p)) @ a.T
        p = (p + p.T) / 2
    np.testing.assert_allclose(
        observer.gain, update * 1e7, rtol=1e-5, atol=1e-6 * np.abs(observer.gain).max()
    )


@pytest.mark.parametrize("case", ["Original", "MC and AD"])
def test_loop_functions_are_those_of_the_simulated_loop(loops, case):
    loop = loops[case][0]
    pids = rig_controllers(GEOMETRY.edge_masses)(4.0, 5.0)
    some = loop.on(2 * np.pi * np.array([0.7, 4.0, 9.0, 100.0, 138.0, 410.0, 2000.0]))
    closed = loop.closed(pids)
    z = np.exp(1j * some.omega * SAMPLE_TIME)[:, None, None]
    states = np.linalg.solve(z * np.eye(len(closed.a)) - closed.a, closed.b.astype(complex))
    whole = closed.c @ states + closed.d
    at = {name: 3 * k for k, name in enumerate(("r", "u_ff", "w", "v", "d"))}
    to = {name: 3 * k for k, name in enumerate(("e_true", "e_meas", "u", "f"))}

    def block(source, target):
        return whole[:, to[target] : to[target] + 3, at[source] : at[source] + 3]

    d = loop.decoupling
    gamma, upsilon = d.actuation, d.sensing
    expected = {
        "input_sensitivity": upsilon @ block("r", "e_meas") @ np.linalg.inv(upsilon),
        "input_sensitivity_2": np.linalg.inv(gamma) @ block("u_ff", "u") @ gamma,
        "output_sensitivity": block("v", "e_true"),
        "output_sensitivity_2": np.eye(3) + block("w", "f"),
        "true_tracking": upsilon @ block("r", "e_true") @ np.linalg.inv(upsilon),
    }
    values, diagonal = (replace(some, measure=measure).at(pids)._asdict() for measure in MEASURES)
    assert set(values) == set(expected)
    for name, matrix in expected.items():
        np.testing.assert_allclose(values[name], np.linalg.norm(matrix, 2, axis=(1, 2)), rtol=2e-5)
        on = np.abs(np.diagonal(matrix, axis1=1, axis2=2)).max(axis=1)
        np.testing.assert_allclose(diagonal[name], on, rtol=2e-5)


def test_loop_without_observer_is_that_of_python_control(loops):
    loop = loops["Original"][0]
    pids = rig_controllers(GEOMETRY.edge_masses)(4.0, 4.0)
    models = zoh_modes(loop.plant, SAMPLE_TIME), sampled_controller(pids, loop.decoupling, SAMPLE_TIME)
    plant, controller = (model.to_control() for model in models)
    sensitivity = control.feedback(control.ss([], [], [], np.eye(3), SAMPLE_TIME), plant * controller)
    omega = loop.omega[:: len(loop.omega) // 12]
    response = np.moveaxis(sensitivity(np.exp(1j * omega * SAMPLE_TIME)), -1, 0)
    found = loop.on(omega).at(pids).output_sensitivity
    np.testing.assert_allclose(found, np.linalg.norm(response, 2, axis=(1, 2)), rtol=1e-4)
    assert loop.radius(pids) == pytest.approx(np.abs(sensitivity.poles()).max(), abs=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("measure", MEASURES)
def test_bandwidth_is_the_largest_by_brute_force(loops, measure):
    family = rig_controllers(GEOMETRY.edge_masses)
    found = maximise_rig_bandwidth(loops["AD"], family, measure)
    again = maximise_rig_bandwidth([*loops["Original"], *loops["AD"]], family, measure)
    radius = [np.abs(loop.closed(again.pids).poles).max() for loop in (loops["Original"][0], loops["AD"][0])]
    np.testing.assert_allclose(again.radius, radius, rtol=1e-12)
    dense = replace(loops["AD"][0].on(2 * np.pi * np.geomspace(0.5, 4900, 20000)), measure=measure)
    assert np.max(dense.at(found.pids)) == pytest.approx(SIX_DB, rel=2e-3)
    np.testing.assert_allclose(found.peaks[0], np.max(dense.at(found.pids), axis=1), rtol=2e-4)
    assert np.all(found.radius < 1)
    higher = [family(found.design_hz[0] * a, found.design_hz[1] * b) for a, b in ((1.002, 1), (1, 1.002))]
    assert all(np.max(dense.at(pids)) > SIX_DB for pids in higher)
    plant = dense.equivalent_plant()
    for k, (hertz, pid) in enumerate(zip(found.crossing_hz[0], found.pids, strict=True)):
        gain = np.abs(plant[k, k] * pid.frequency_response(prewarped(dense.omega, SAMPLE_TIME)))
        first = dense.omega[np.flatnonzero(gain < 1)[0]] / (2 * np.pi)
        assert hertz == pytest.approx(first, rel=3e-3)


def test_damping_gain_gives_a_mode_alone_the_wanted_ratio(plant):
    one = plant.modes([0, 1, 2, 3])
    block = rig_compensator(rig_observer(one, SETTINGS.noise, SAMPLE_TIME), target_damping=0.04)
    w, phi = one.frequencies[3], one.input_shapes[3]
    rate = 2 * one.damping[3] * w - phi @ block.gains[:, 0]
    assert rate / (2 * w) == pytest.approx(0.04)


@pytest.mark.parametrize("case", ["Original", "MC and AD"])
def test_poles_are_those_of_the_whole_loop(loops, case):
    loop, pids = loops[case][0], rig_controllers(GEOMETRY.edge_masses)(4.0, 5.0)
    whole = continuous_poles(loop.closed(pids).poles, SAMPLE_TIME)
    far = np.abs(loop.poles(pids)[:, None] - whole)
    assert far.shape == (len(whole), len(whole))
    assert np.all(far.min(axis=0) < 1e-6 * np.abs(whole))  # three integrators in a row meet at zero


def test_an_exact_observer_without_sensor_noise_takes_the_modes_out(plant):
    """MC on a plant without unknown modes: what the controller sees is the rigid body."""
    eight = plant.modes(slice(0, 11))
    observer = rig_observer(eight, NoiseIntensities(1e-4, 1e-18), SAMPLE_TIME)
    d = decoupling(GEOMETRY, GEOMETRY.used, POSITIONS[1])
    omega = 2 * np.pi * np.array([10.0, 137.9, 138.0, 512.0, 1178.0])
    seen = make_rig_loop(eight, rig_compensator(observer, True), d, SAMPLE_TIME, omega).equivalent_plant()
    rigid = zoh_response(eight.modes(slice(0, 3)), SAMPLE_TIME, omega)
    rigid = np.einsum("ij,jkw,kl->ilw", d.sensing, rigid, d.actuation)
    np.testing.assert_allclose(seen, rigid, atol=2e-6 * np.abs(rigid[0, 0]).max())


def test_actuators_on_a_nodal_line_are_refused():
    square = Geometry(0.5, 0.5, 20.0, 0.33, 0.9, (0.8, 0.7))
    model = rig_model(square, 0).at(square.used, (0, 1, 2))
    observer = rig_observer(model.modes(slice(0, 4)), SETTINGS.noise, SAMPLE_TIME)
    assert rig_compensator(observer, target_damping=0.04).gains.shape == (3, 1)
    with pytest.raises(InputError):  # mode 2 of a square has its nodes on the diagonals
        rig_compensator(
            rig_observer(model.modes(slice(0, 5)), SETTINGS.noise, SAMPLE_TIME), target_damping=0.04
        )
