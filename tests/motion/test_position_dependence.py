import numpy as np
import pytest

from experiments.motion.designs import (
    DAMPING,
    DESIGNS,
    stage_loops,
    stage_observer,
)
from experiments.motion.machines import chain_matrix, published_noise, shapes_along, stage, stage_mass
from experiments.motion.position_dependence import at_place, observer_at, stage_grid
from notebooks.motion.position_dependent_observers import (
    damping_along,
    damping_table,
    move,
    nodes,
    pass_node,
    place_loops,
)
from notebooks.motion.twenty_nine_scans import structure
from stillwork.control.discrete_damping import sampled_feedback
from stillwork.control.pid import PidFamily

GRID = stage_grid()
SAMPLE_TIME = 1e-4


@pytest.fixture(scope="module")
def plant():
    return stage()


def test_at_a_mass_the_machine_is_that_of_the_mass(plant):
    for number in (0, 3, 6):
        here, there = at_place(plant, GRID, GRID[number]), plant.at([0], [number])
        np.testing.assert_allclose(here.output_shapes, there.output_shapes, atol=1e-14)
        np.testing.assert_array_equal(here.input_shapes, there.input_shapes)


def test_moving_the_actuator_is_reciprocal_to_moving_the_sensor(plant):
    omega = np.geomspace(10, 2e4, 50)
    sensor, actuator = (at_place(plant, GRID, 0.123, moves) for moves in ("sensor", "actuator"))
    np.testing.assert_allclose(
        sensor.frequency_response(omega), actuator.frequency_response(omega), rtol=1e-12
    )


def test_observer_and_loops_at_a_mass_are_the_published_ones(plant):
    here, there = observer_at(plant, GRID, GRID[4], noise_model=0.03), stage_observer(5, noise_model=0.03)
    np.testing.assert_allclose(here.gain, there.gain, rtol=1e-6)
    controller = PidFamily(stage_mass())(40.0)
    omega = 2 * np.pi * np.geomspace(5, 2e3, 60)
    for name in ("PID", "MC and AD"):
        ours = place_loops(plant, GRID, GRID[[2, 5]], DESIGNS[name], points=20, around=0)[1]
        theirs = stage_loops(DESIGNS[name], points=20, around=0)[5]
        for function in ("output_sensitivity", "output_controller"):
            np.testing.assert_allclose(
                getattr(ours.at(controller, omega), function),
                getattr(theirs.at(controller, omega), function),
                rtol=1e-6,
            )


def test_shapes_vanish_at_their_nodes(plant):
    for mode, count in ((0, 0), (1, 1), (2, 2), (3, 2)):
        found = nodes(plant, GRID, mode)
        assert len(found) == count
        for place in found:
            assert abs(shapes_along(plant, GRID, [place])[0, mode]) < 1e-12


def test_a_gain_solved_at_every_place_damps_alike_and_goes_with_one_over_the_shape(plant):
    places = np.array([0.02, 0.05, 0.08, 0.15])
    gains = damping_along(plant, GRID, places, DAMPING, SAMPLE_TIME)
    shapes = shapes_along(plant, GRID, places)[:, 1:4]
    for k in range(3):
        columns = gains[:, 0, 2 + 2 * k : 4 + 2 * k] * shapes[:, k : k + 1]
        np.testing.assert_allclose(columns, np.broadcast_to(columns[0], columns.shape), rtol=1e-9)
    for place, gain in zip(places, gains, strict=True):
        model = at_place(plant, GRID, place, "actuator").modes([0, 1, 2, 3])
        np.testing.assert_allclose(sampled_feedback(model, gain, SAMPLE_TIME).damping[1:], 0.04, atol=1e-9)


def test_a_table_errs_with_the_square_of_its_spacing(plant):
    fine = np.linspace(0.03, 0.09, 61)
    exact = damping_along(plant, GRID, fine, DAMPING, SAMPLE_TIME)
    errors = [
        np.abs(
            damping_table(plant, GRID, np.linspace(0.03, 0.09, n), DAMPING, SAMPLE_TIME).at(fine) - exact
        ).max()
        for n in (11, 21)
    ]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.25)


def test_standing_on_a_node_loses_the_mode_and_passing_it_faster_loses_less(plant):
    known, node = plant.modes([0, 1]), float(nodes(plant, GRID, 1)[0])
    sample_time = 2e-4
    stood = pass_node(known, GRID, np.full(1500, node), 1, published_noise(), sample_time)
    assert stood.worst(0.25, 0.3) == pytest.approx(1.0, abs=0.02)
    slow, fast = (
        pass_node(
            known, GRID, move(node - 0.03, 0.2, v, 0.06, 0.02, sample_time), 1, published_noise(), sample_time
        ).worst(0.2, 0.22 + 0.06 / v)
        for v in (0.5, 5.0)
    )
    assert fast < slow < 1


def test_the_eighth_place_is_the_mass_that_the_force_acts_on():
    plant, grid = structure(8)
    mass, stiffness = np.diag([2.5, *[10 / 7] * 7]), chain_matrix([1e8, *[9.6e7] * 6])
    for omega in (300.0, 20000.0):  # where damping hardly matters
        direct = np.linalg.inv(stiffness - omega**2 * mass)[:, 0]
        found = [
            at_place(plant, grid, place).frequency_response(np.array([omega]))[0, 0, 0] for place in grid
        ]
        np.testing.assert_allclose(np.real(found), direct, rtol=0, atol=5e-4 * np.abs(direct).max())
    assert len(structure(7)[1]) == 7
