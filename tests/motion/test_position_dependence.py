import numpy as np
import pytest

from experiments.motion.machines import chain_matrix, shapes_along, stage
from experiments.motion.position_dependence import at_place, stage_grid
from notebooks.motion.position_dependent_observers import (
    move,
    nodes,
    pass_node,
)
from notebooks.motion.twenty_nine_scans import structure

GRID = stage_grid()
SAMPLE_TIME = 1e-4


@pytest.fixture(scope="module")
def plant():
    return stage()


def test_shapes_vanish_at_their_nodes(plant):
    for mode, count in ((0, 0), (1, 1), (2, 2), (3, 2)):
        found = nodes(plant, GRID, mode)
        assert len(found) == count
        for place in found:
            assert abs(shapes_along(plant, GRID, [place])[0, mode]) < 1e-12


def test_standing_on_a_node_loses_the_mode_and_passing_it_faster_loses_less(plant):
    known, node = plant.modes([0, 1]), float(nodes(plant, GRID, 1)[0])
    sample_time = 2e-4
    stood = pass_node(known, GRID, np.full(1500, node), 1, sample_time)
    assert stood.worst(0.25, 0.3) == pytest.approx(1.0, abs=0.02)
    slow, fast = (
        pass_node(known, GRID, move(node - 0.03, 0.2, v, 0.06, 0.02, sample_time), 1, sample_time).worst(
            0.2, 0.22 + 0.06 / v
        )
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
