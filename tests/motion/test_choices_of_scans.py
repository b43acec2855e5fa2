"""Chapters 4 to 6 at other options."""

import numpy as np

from experiments.motion.machines import chain_matrix
from experiments.motion.position_dependence import at_place
from notebooks.motion.twenty_nine_scans import (
    structure,
)


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
