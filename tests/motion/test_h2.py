"""H2 synthesis: Riccati equations against matrix inequalities and closed forms."""

import numpy as np
import pytest
from scipy import linalg

from notebooks.motion.optimal_observer import h2_by_inequalities
from stillwork.base.checks import InputError
from stillwork.estimation import h2_riccati
from stillwork.lti import GeneralisedPlant, StateModel


def toy(seed=0, n=4):
    """A small random plant, regular already, with one control and two measurements."""
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(n, n)) / np.sqrt(n)
    d = np.zeros((4, 5))
    model = StateModel(a, rng.normal(size=(n, 5)), rng.normal(size=(4, n)), d)
    return GeneralisedPlant(model, exogenous=4, performance=2)


@pytest.mark.parametrize("seed", [0, 1, 3])  # 2 is all but uncontrollable
def test_riccati_and_inequalities_find_the_same_optimum(seed):
    plant = toy(seed)
    riccati, lmi = h2_riccati(plant, 0.7, 0.4), h2_by_inequalities(plant, 0.7, 0.4)
    assert lmi.status == "optimal"
    np.testing.assert_allclose(lmi.claimed, riccati.regular_norm, rtol=1e-4)
    np.testing.assert_allclose(riccati.claimed, riccati.regular_norm, rtol=1e-9)
    assert lmi.regular_norm >= riccati.regular_norm * (1 - 1e-6)


def test_a_plant_that_no_controller_stabilises_is_refused():
    # The control does not reach the unstable state, so no controller stabilises the loop.
    a = np.diag([1.0, -1.0])
    b = np.array([[1.0, 0.0], [1.0, 1.0]])
    model = StateModel(a, b, np.array([[1.0, 1.0], [1.0, 1.0]]), np.zeros((2, 2)))
    plant = GeneralisedPlant(model, exogenous=1, performance=1)
    with pytest.raises(InputError, match=r"Clarabel|residual"):
        h2_by_inequalities(plant, 1.0, 1.0)
    with pytest.raises(InputError, match=r"Riccati|residual|stable"):
        h2_riccati(plant, 1.0, 1.0)


def least_norm(plant):
    """The optimum by its closed form: what the start of the states costs, and what their estimation adds."""
    a, b1, b2, c1, c2, _, d12, d21, _ = plant.blocks
    x = linalg.solve_continuous_are(a, b2, c1.T @ c1, d12.T @ d12, s=c1.T @ d12)
    y = linalg.solve_continuous_are(a.T, c2.T, b1 @ b1.T, d21 @ d21.T, s=b1 @ d21.T)
    cost = d12.T @ d12
    f = np.linalg.solve(cost, b2.T @ x + d12.T @ c1)
    return np.sqrt(np.trace(b1.T @ x @ b1) + np.trace(f.T @ cost @ f @ y))


def regular(seed, unstable):
    """A random regular plant with correlated noises and costs, and a D22."""
    rng = np.random.default_rng(seed)
    n, controls, measurements = (int(rng.integers(*each)) for each in ((2, 10), (1, 4), (1, 4)))
    w, z = measurements + int(rng.integers(1, 4)), controls + int(rng.integers(1, 4))
    a = rng.normal(size=(n, n)) / np.sqrt(n) + unstable * np.eye(n)
    b, c, d = (
        rng.normal(size=size)
        for size in ((n, w + controls), (z + measurements, n), (z + measurements, w + controls))
    )
    d[:z, :w] = 0
    return GeneralisedPlant(StateModel(a, b, c, d), w, z)


def in_other_units(plant, rng, decades):
    """The same plant with other units for each state, control and measurement, and for time: norms stay."""
    m, w, z = plant.model, plant.exogenous, plant.performance
    (n, inputs), outputs, rate = m.b.shape, len(m.c), 10.0 ** rng.uniform(-decades, decades)
    states, controls, measured = (
        10.0 ** rng.uniform(-decades, decades, k) for k in (n, inputs - w, outputs - z)
    )
    into = np.concatenate(
        [np.full(w, 1 / np.sqrt(rate)), controls]
    )  # white noise of unit intensity stays one
    out = np.concatenate([np.ones(z), measured])[:, None]
    a, b, c = m.a * states / states[:, None], m.b * into / states[:, None], m.c * states * out
    return GeneralisedPlant(StateModel(a * rate, b * rate, c, m.d * into * out), w, z)


@pytest.mark.parametrize("unstable", [-1.0, 0.0, 0.5])
@pytest.mark.parametrize("decades", [0, 3, 9])
def test_the_optimum_has_its_closed_form_in_any_units(unstable, decades):
    rng = np.random.default_rng(decades)
    for seed in range(12):
        plant = regular(seed, unstable)
        found = h2_riccati(in_other_units(plant, rng, decades))
        assert [found.norm, found.regular_norm, found.claimed] == pytest.approx(
            [least_norm(plant)] * 3, rel=1e-5
        )


@pytest.mark.parametrize(("seed", "decades"), [(10, 3), (10, 9), (299, 3), (477, 9)])
def test_the_norm_of_a_loop_that_amplifies_its_rounding_is_right_or_refused(seed, decades):
    """Several unstable modes behind one measurement: the residual of the Lyapunov equation says nothing any more."""
    plant = regular(seed, 1.0)
    found = h2_riccati(in_other_units(plant, np.random.default_rng(seed), decades))
    assert [found.norm, found.regular_norm] == pytest.approx([least_norm(plant)] * 2, rel=1e-5)


def test_the_loop_has_the_response_of_the_linear_fractional_transformation():
    plant, k = regular(4, 0.0), regular(5, 0.0).model.select([0], [0])
    plant = GeneralisedPlant(
        plant.model.select(range(plant.exogenous + 1), range(plant.performance + 1)),
        plant.exogenous,
        plant.performance,
    )
    w, z, omega = plant.exogenous, plant.performance, np.array([0.0, 0.7, 20.0])
    whole, kk = plant.model.frequency_response(omega), k.frequency_response(omega)[0, 0]
    expected = whole[:z, :w] + whole[:z, w:] * whole[z:, :w] * kk / (1 - whole[z, w] * kk)
    np.testing.assert_allclose(plant.close(k).frequency_response(omega), expected, rtol=1e-9)


def test_a_loop_of_feedthroughs_without_a_solution_is_refused():
    plant = GeneralisedPlant(
        StateModel(-np.eye(1), np.ones((1, 2)), np.ones((2, 1)), np.diag([0.0, 2.0])), 1, 1
    )
    with pytest.raises(InputError, match="feedthrough"):
        plant.close(StateModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), 0.5 * np.eye(1)))


def test_an_optimum_that_no_float_keeps_says_what_would_help():
    with pytest.raises(InputError, match=r"norm.*effort"):
        h2_riccati(regular(132, 1.0))
