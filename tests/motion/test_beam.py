"""The free beam against the closed form of a uniform one and against finite elements of a tapered one."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg, optimize

from experiments.motion.beam import beam_parameters, beam_shapes, published_beam


def test_uniform_shapes_are_the_closed_form():
    along = np.linspace(0, 1, 11)
    shapes = beam_shapes(along, 5)
    assert np.allclose(shapes[:, 0], 1, atol=1e-12)
    assert np.allclose(shapes[:, 1], np.sqrt(12) * (along - 0.5), atol=1e-12)
    for k in (1, 2, 3):
        near = (k + 0.5) * np.pi
        root = optimize.brentq(lambda x: np.cos(x) - 1 / np.cosh(x), near - 0.2, near + 0.2, xtol=1e-14)
        ratio = (np.cosh(root) - np.cos(root)) / (np.sinh(root) - np.sin(root))
        x = root * along
        exact = np.cosh(x) + np.cos(x) - ratio * (np.sinh(x) + np.sin(x))
        assert np.allclose(shapes[:, 1 + k], exact * np.sign(exact[-1]), atol=1e-7)


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


def test_published_beam_has_the_published_frequencies():
    model = published_beam(3)
    assert model.input_shapes.shape == (5, 3)
    np.testing.assert_allclose(model.frequencies[2:] / (2 * np.pi), [161, 517, 760], rtol=1e-14)
    # A rigid translation: every force moves every place by 1/M.
    mass = beam_parameters()["assumed"]["mass"]
    np.testing.assert_allclose(model.output_shapes[:, :1] * model.input_shapes[0], 1 / mass, rtol=1e-10)
