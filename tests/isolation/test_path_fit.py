"""The published fit against python-control and against paths whose answer is known."""

import control
import numpy as np
import pytest

from experiments.isolation.responses import responses
from experiments.isolation.twin import load_twin
from notebooks.isolation.floor_and_paths import (
    diagonal_path,
    dominance,
    fit_error_db,
    fit_reaches_hz,
    resonance_hz,
)
from stillwork.base.checks import InputError


def published_fit():
    s, pole = control.tf("s"), 2 * np.pi * 300
    path = s**2 / (1.4 * s**2 + 290 * s + 60e3) * pole / (s + pole)
    return control.sample_system(path, 2e-4, "tustin") * control.tf([1], [1, 0], 2e-4)


def test_a_path_is_judged_by_eq_2_with_one_delay():
    """Against (2) by Tustin's rule, by hand."""
    twin = load_twin("rigid_body")
    f = np.array([1.0, 20.0, 100.0, 500.0])
    path, z = twin.feedforward.path, np.exp(2j * np.pi * f / 5000.0)
    s = 10000.0 * (z - 1) / (z + 1)
    by_hand = (
        s**2
        / (path.mass * s**2 + path.damping * s + path.stiffness)
        * path.actuator_pole
        / (s + path.actuator_pole)
        / z
    )
    expected = 20 * np.log10(np.abs(diagonal_path(twin, f) / by_hand))
    assert fit_error_db(twin, f, published_fit()) == pytest.approx(expected, abs=1e-5)


def test_resonance_is_found_where_it_was_put():
    twin = load_twin("fitted").varied(parasitic_hz=700.0, parasitic_gain=1.0, parasitic_damping=0.001)
    assert resonance_hz(twin, 600.0, 800.0) == pytest.approx(700.0, abs=0.7)


def test_reach_of_the_fit_is_where_the_error_crosses():
    twin = load_twin("fitted")
    fit = published_fit()
    reach = fit_reaches_hz(twin, 5.0, fit)
    error = np.abs(fit_error_db(twin, np.array([reach - 1, reach]), fit)).max(axis=0)
    assert error[0] <= 3.0 < error[1]
    with pytest.raises(InputError, match="above_hz"):
        fit_reaches_hz(twin, 0.0, fit)


def test_dominance_compares_each_diagonal_element_with_the_rest_of_its_row():
    f = np.array([2.0, 30.0, 300.0])
    path = np.abs(responses(load_twin("rigid_body"), f, feedback=False).secondary)
    for found, matrix in zip(dominance(load_twin("rigid_body"), f), path, strict=True):
        rows = [matrix[i, i] / sum(matrix[i, j] for j in range(6) if j != i) for i in range(6)]
        assert found == pytest.approx(min(rows), rel=1e-12)
    assert np.all(np.isinf(dominance(load_twin("fitted"), f)))  # six struts apart
