"""The free beam against finite elements of a tapered one."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg

from experiments.motion.beam import beam_shapes


def test_tapered_shapes_are_those_of_finite_elements():
    taper, elements = 0.8, 60
    size = 1 / elements
    stiffness, mass = np.zeros((2, 2 * elements + 2, 2 * elements + 2))
    points, weights = np.polynomial.legendre.leggauss(6)
    for e in range(elements):
        own = slice(2 * e, 2 * e + 4)
        for s, weight in zip((points + 1) / 2, weights * size / 2, strict=True):
            thickness = 1 + taper * ((e + s) * size - 0.5)
            value = [1 - 3 * s**2 + 2 * s**3, size * (s - 2 * s**2 + s**3), 3 * s**2 - 2 * s**3]
            value = np.array([*value, size * (s**3 - s**2)])
            second = np.array([12 * s - 6, size * (6 * s - 4), 6 - 12 * s, size * (6 * s - 2)]) / size**2
            mass[own, own] += weight * thickness * np.outer(value, value)
            stiffness[own, own] += weight * thickness**3 * np.outer(second, second)
    _, vectors = linalg.eigh(stiffness, mass, subset_by_index=(2, 4))
    nodes = vectors[::2] * np.sign(vectors[-2])
    assert np.allclose(beam_shapes(np.linspace(0, 1, elements + 1), 5, taper)[:, 2:], nodes, atol=2e-5)


@settings(max_examples=15)
@given(st.floats(-1.5, 1.5))
def test_shapes_are_orthogonal_over_the_mass(taper):
    points, weights = np.polynomial.legendre.leggauss(60)
    along = (points + 1) / 2
    shapes = beam_shapes(along, 7, taper)
    mass = weights / 2 * (1 + taper * (along - 0.5))
    assert np.allclose(shapes.T @ (mass[:, None] * shapes), np.eye(7), atol=1e-9)
    assert np.all(beam_shapes([1.0], 7, taper) > 0)
