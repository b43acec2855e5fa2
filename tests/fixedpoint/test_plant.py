import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiments.fixedpoint import load_oscillator
from naive import fixedpoint as naive
from stillwork.base.checks import InputError
from stillwork.base.kernels import callback
from stillwork.estimation import Plant
from stillwork.estimation.plant import SIGNATURE, partial_derivatives, slope

NUMBERS = st.floats(-20, 20)


@given(NUMBERS, NUMBERS, NUMBERS)
def test_oscillator_is_equation_11(position, velocity, force):
    plant = load_oscillator()["exact"].plant
    expected = naive.oscillator(plant.parameters, position, velocity, force)
    found = plant.acceleration(position, velocity, force, plant.parameters)
    assert found == pytest.approx(expected, rel=1e-12, abs=1e-9)
    again = plant.force(position, velocity, expected, plant.parameters)
    assert again == pytest.approx(force, rel=1e-9, abs=1e-7)


def hard_acceleration(position, velocity, force, p):
    return (
        force - p[4] - p[1] * velocity - p[2] * position - p[3] * position**3 * (1 + p[5] * velocity**2)
    ) / p[0]


def hard_force(position, velocity, acceleration, p):
    return (
        p[0] * acceleration
        + p[4]
        + p[1] * velocity
        + p[2] * position
        + p[3] * position**3 * (1 + p[5] * velocity**2)
    )


def hard_plant(length, time, force, acceleration=hard_acceleration):
    """A mass on a spring that hardens, with gravity, in units of so many m, s and N."""
    newtons = np.array([2.0, 3.0, 500.0, 4e4, 20.0]) / force
    units = length ** np.array([1, 1, 1, 3, 0]) * time ** np.array([-2.0, -1, 0, 0, 0])
    return Plant(acceleration, hard_force, np.append(newtons * units, 7.0 * (length / time) ** 2))


@pytest.mark.parametrize(
    ("length", "time", "force"),
    [(1.0, 1.0, 1.0), (1e-9, 1e-3, 1e9), (1e-3, 60.0, 1e-9), (1e3, 1e-3, 1e-9), (1e9, 60.0, 1e9)],
)
def test_a_plant_and_its_slopes_do_not_depend_on_the_units(length, time, force):
    """Against those by hand, at rest and on the way; one that is not the inverse is refused in all units."""
    plant = hard_plant(length, time, force)
    units = np.array([1 / time**2, 1 / time, length / force / time**2])  # of the slopes, over those in SI
    for q, v in ((0.0, 0.0), (0.03, -0.4)):
        stiffness = 500.0 + 1.2e5 * q**2 * (1 + 7.0 * v**2)
        expected = -np.array([stiffness, 3.0 + 4e4 * q**3 * 14.0 * v, -1.0]) / 2.0
        found = partial_derivatives(plant, q / length, v / length * time, 10.0 / force)
        np.testing.assert_allclose(found * units, expected, rtol=1e-6, atol=1e-9 * abs(expected).max())
    with pytest.raises(InputError, match=r"^force\b"):
        hard_plant(length, time, force, lambda *given: 1.01 * hard_acceleration(*given))


@pytest.mark.parametrize("length", [1e-9, 1e9])
def test_a_plant_need_not_have_a_force_everywhere(length):
    reach = 0.1 / length  # of a crank

    def arm(position, p):
        return math.sqrt(1 - (position / p[0]) ** 2)  # an error beyond it

    def force(position, velocity, acceleration, p):
        return acceleration * arm(position, p)

    def acceleration(position, velocity, force, p):
        return force / arm(position, p)

    assert partial_derivatives(Plant(acceleration, force, [reach]), 0.6 * reach, 0.0, 1.0)[
        2
    ] == pytest.approx(1.25)


@pytest.mark.parametrize(
    ("function", "at", "expected"),
    [
        (lambda x: 3.0 + abs(x), 0.0, 0.0),  # a kink
        (lambda x: abs(x) * x, 0.0, 0.0),
        (lambda x: 1e9 + np.tanh(1e9 * x), 0.0, 1e9),
        (lambda x: np.tanh(1e-9 * x), 0.0, 1e-9),
        (lambda x: np.array([x**3, 5.0, np.exp(x)]), 2.0, [12.0, 0.0, np.exp(2.0)]),
        (lambda x: 1.0 / (1e-8 - x), 0.0, 1e16),
    ],
)
def test_slopes_of_functions_with_a_scale_of_their_own(function, at, expected):
    found = slope(function, at)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9 if np.ndim(expected) else 1e-12)


def half_force(position, velocity, acceleration, parameters):
    return 0.5 * acceleration


def whole_acceleration(position, velocity, force, parameters):
    return force


def uncompilable(position, velocity, force, parameters):
    return {"force": [force, parameters]}["force"][0] if len(str({force: {}})) else eval("force")


def test_force_must_invert_acceleration():
    with pytest.raises(InputError, match=r"^force\b"):
        Plant(whole_acceleration, half_force, np.zeros(1))


def gives_nothing(position, velocity, force, parameters):
    pass


def stumbles(position, velocity, force, parameters):
    raise ValueError("no such place")


@pytest.mark.parametrize("function", [gives_nothing, stumbles])
def test_a_function_that_fails_is_named(function):
    with pytest.raises(InputError, match=r"^acceleration\b"):
        Plant(function, function, np.zeros(0))


def test_a_function_that_numba_cannot_compile_is_named():
    with pytest.raises(InputError, match=r"^uncompilable\b"):
        callback(uncompilable, SIGNATURE)
