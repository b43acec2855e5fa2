"""Norms, Riccati equations and optimal observers on cases that others published with their results."""

import numpy as np
import pytest
from scipy import linalg

from stillwork.base.checks import InputError
from stillwork.estimation import h2_riccati
from stillwork.estimation.hinfinity import hinfinity_gains, smallest_level
from stillwork.estimation.riccati import continuous_gain
from stillwork.estimation.time_varying import TimeVaryingModel
from stillwork.lti import GeneralisedPlant, StateModel, h2_norm, hinf_norm

# SLICOT library, example data and results of SB10HD: A, B, C and D.
SB10HD = (
    "-1 0 4 5 -3 -2; -2 4 -7 -2 0 3; -6 9 -5 0 2 -1; -8 4 7 -1 -3 0; 2 5 8 -9 1 -4; 3 -5 8 0 2 -6",
    "-3 -4 -2 1 0; 2 0 1 -5 2; -5 -7 0 7 -2; 4 -6 1 1 -2; -3 9 -8 0 5; 1 -2 3 -6 -2",
    "1 -1 2 -4 0 -3; -3 0 5 -1 1 1; -7 5 0 -8 2 -2; 9 -3 4 0 3 7; 0 1 -2 1 -6 -2",
    "0 0 0 -4 -1; 0 0 0 1 0; 0 0 0 0 1; 3 1 0 1 -3; -2 0 1 7 1",
)
SB10HD_CONTROLLER = (
    """88.0015 -145.7298 -46.2424 82.2168 -45.2996 -31.1407; 25.7489 -31.4642 -12.4198 9.4625 -3.5182 2.7056;
    54.3008 -102.4013 -41.4968 50.8412 -20.1286 -26.7191; 108.1006 -198.0785 -45.4333 70.3962 -25.8591 -37.2741;
    -115.8900 226.1843 47.2549 -47.8435 -12.5004 34.7474; 59.0362 -101.8471 -20.1052 36.7834 -16.1063 -26.4309""",
    "3.7345 3.4758; -0.3020 0.6530; 3.4735 4.0499; 4.3198 7.2755; -3.9424 -10.5942; 2.1784 2.5048",
    "-2.3346 3.2556 0.7150 -0.9724 0.6962 0.4074; 7.6899 -8.4558 -2.9642 7.0365 -4.2844 0.1390",
)


def matrices(texts):
    return [np.array([row.split() for row in text.split(";")], dtype=float) for text in texts]


def plant(texts, exogenous, performance):
    return GeneralisedPlant(StateModel(*matrices(texts)), exogenous, performance)


def responses(model, omega):
    return model.d + model.c @ np.linalg.solve(1j * omega * np.eye(len(model.a)) - model.a, model.b)


def test_h2_controller_of_slicot():
    """Its D12 has correlated columns, so the cost of a control is not that of each control alone."""
    found = h2_riccati(plant(SB10HD, 3, 3), 0.0, 0.0)
    # printed to four decimals; the controller is unique, its state up to a transformation
    theirs = StateModel(*matrices(SB10HD_CONTROLLER), np.zeros((2, 2)))
    for omega in (0.0, 0.3, 3.0, 30.0, 300.0):
        expected = responses(theirs, omega)
        size = np.abs(expected).max()
        assert responses(found.controller, omega) == pytest.approx(expected, rel=5e-3, abs=5e-3 * size)
    assert np.sort_complex(found.controller.poles) == pytest.approx(np.sort_complex(theirs.poles), rel=2e-3)


def test_h2_controller_of_python_control():
    """`robust_test` of python-control, testH2syn: K = -1 / (s + 3) keeps w from z altogether, a norm of zero."""
    found = h2_riccati(plant(("-1", "1 1", "1; 1", "0 1; 1 0"), 1, 1), 0.0, 0.0)
    k = found.controller
    assert [k.a[0, 0], k.b[0, 0] * k.c[0, 0]] == pytest.approx([-3.0, -1.0], rel=1e-9)
    assert found.norm == pytest.approx(0.0, abs=1e-7)
    loop = StateModel(*matrices(("-1 -1; 1 -3", "1; 1", "1 -1", "0")))
    assert h2_norm(loop) == pytest.approx(0.0, abs=1e-7)
    assert hinf_norm(loop).magnitude == pytest.approx(0.0, abs=1e-7)


def test_infinity_norm_of_slicot():
    """AB13DD: three modes with damping of a millionth, peak 0.5000000001e6 at 1.414213562 rad/s."""
    a = linalg.block_diag([[0, 1], [-0.5, -2e-4]], [[0, 1], [-1, -2e-5]], [[0, 1], [-2, -2e-6]])
    drive = np.array([[1.0, 0.0] * 3])
    peak = hinf_norm(StateModel(a, drive.T, drive, np.zeros((1, 1))))
    assert peak.magnitude == pytest.approx(0.5000000001e6, rel=1e-9)
    assert peak.omega == pytest.approx(1.414213562, rel=1e-9)


def random_walk(samples):
    one = np.ones((samples, 1, 1))
    return TimeVaryingModel(one, np.zeros((samples, 1, 1)), one, one, np.eye(1), np.eye(1), np.eye(1))


@pytest.mark.parametrize("theta", [0.0, 0.5, 0.9])
def test_h_infinity_filter_of_a_random_walk(theta):
    """Simon, "Optimal State Estimation" (2006), example 11.2: P = 2 for theta = 1/2, in general as below."""
    p = (1 - theta + np.sqrt((theta - 1) * (theta - 5))) / (2 * (1 - theta))
    level = 1 / np.sqrt(theta) if theta else 1e6
    gains = hinfinity_gains(random_walk(300), [[1.0]], level)
    assert gains.covariance[-1, 0, 0] == pytest.approx(p / (1 + p), rel=1e-9)  # after the measurement


def test_no_filter_of_a_random_walk_keeps_a_level_below_one_for_long():
    assert smallest_level(random_walk(2000), [[1.0]]) == pytest.approx(1.0, rel=2e-3)
    with pytest.raises(InputError, match=r"0\.98.*sample"):
        hinfinity_gains(random_walk(2000), [[1.0]], 0.98)


@pytest.mark.parametrize("wanted", [[[0.0]], [[1e-200]], np.zeros((0, 1))])
def test_what_every_level_keeps_has_no_smallest_one(wanted):
    with pytest.raises(InputError, match=r"^wanted\b"):
        smallest_level(random_walk(5), wanted)


def test_control_of_a_double_integrator():
    """SLICOT, SB02MD: X = [2 1; 1 2] for A = [0 1; 0 0], Q = diag(1, 2), G = diag(0, 1); here its dual."""
    found = continuous_gain([[0.0, 0.0], [1.0, 0.0]], np.diag([1.0, np.sqrt(2.0)]), [[0.0, 1.0]], 1.0, 1.0)
    assert found.covariance == pytest.approx(np.array([[2.0, 1.0], [1.0, 2.0]]), rel=1e-12)


def test_norms_beyond_the_range_of_numbers_are_refused():
    huge = StateModel(*matrices(("-2", "1e200", "1e200", "0")))
    for norm in (h2_norm, hinf_norm):
        with pytest.raises(InputError, match=r"^model\b"):
            norm(huge)
    assert h2_norm(StateModel(*matrices(("-2", "1e200", "1e-200", "0")))) == pytest.approx(0.5, rel=1e-12)


def test_a_singular_plant_names_what_it_needs():
    singular = plant(("-1", "1 1", "1; 1", "0 0; 1 0"), 1, 1)
    with pytest.raises(InputError, match=r"^effort and noise\b.*more effort"):
        h2_riccati(singular, 0.0, 0.0)
    with pytest.raises(InputError, match=r"^effort and noise\b.*more noise"):
        h2_riccati(plant(("-1", "1 1", "1; 1", "0 1; 0 0"), 1, 1), 0.0, 0.0)


def energy_gain(model, wanted, gains):
    """Largest error energy in what is wanted, at all samples, over that of the start and of both noises."""
    samples, outputs, states = model.c.shape
    process, sensor = np.linalg.cholesky(model.process), np.linalg.cholesky(model.sensor)
    causes = process.shape[1]
    error = np.zeros((states, states + (samples - 1) * (causes + outputs)))
    error[:, :states] = np.linalg.cholesky(model.initial_covariance)
    seen = [wanted @ error]
    for k in range(1, samples):
        first = states + (k - 1) * (causes + outputs)
        error = model.a[k] @ error
        error[:, first : first + causes] += model.g[k] @ process
        measured = model.c[k] @ error
        measured[:, first + causes : first + causes + outputs] += sensor
        error = error - gains.gain[k] @ measured
        seen.append(wanted @ error)
    return np.linalg.norm(np.vstack(seen), 2)


@pytest.mark.parametrize("seed", range(6))
def test_an_h_infinity_filter_keeps_its_level_to_the_last_sample(seed):
    rng = np.random.default_rng(seed)
    states, outputs, samples = int(rng.integers(1, 4)), int(rng.integers(1, 3)), int(rng.integers(2, 8))
    a, g, c = (rng.standard_normal((samples, states, n)) for n in (states, 1, outputs))
    model = TimeVaryingModel(
        a, np.zeros_like(g), g, np.swapaxes(c, 1, 2), 2.0 * np.eye(1), 0.5 * np.eye(outputs), np.eye(states)
    )
    wanted = rng.standard_normal((1, states))
    level = smallest_level(model, wanted, 1e-6)
    found = energy_gain(model, wanted, hinfinity_gains(model, wanted, 1.001 * level))
    assert 0.99 * level < found <= 1.001 * level
