"""The bound that two entrants make small, against brute force."""

import numpy as np
import pytest

from contest.fixed_gain import stationary
from contest.nominal import nominal_of
from contest.plants import plant_of
from contest.structured import WorstCase, least
from stillwork.estimation.riccati import discrete_gain
from stillwork.lti.discretisation import zoh_modes
from stillwork.lti.modal import ModalModel


def given_of(name):
    plant = plant_of(name)
    return *nominal_of(plant, 1.0), plant.sample_time


def error_at(model, sample_time, gain, errors, gains, z):
    """Errors of all states over the force and over w and v: the true machine beside the observer, solved at once."""
    n = len(model.a)
    a, b = np.zeros_like(model.a), np.zeros_like(model.b)
    for i, omega in enumerate(model.frequencies * (1 + errors)):
        one = ModalModel(np.array([omega]), model.damping[i : i + 1], np.eye(1), np.eye(1), np.zeros((1, 1)))
        step = zoh_modes(one, sample_time)
        pair = slice(2 * i, 2 * i + 2)
        a[pair, pair], b[pair] = step.a, step.b * gains[i] * model.input_shapes[i]
    keeps = np.eye(n) - gain @ model.c
    x_of_u = np.linalg.solve(z * np.eye(n) - a, b + 0j)
    # x^ z = keeps (A x^ + B u) + K z y, everything after the measurement.
    observer = z * np.eye(n) - keeps @ model.a
    return x_of_u - np.linalg.solve(observer, keeps @ model.b + z * gain @ model.c @ x_of_u)


@pytest.mark.parametrize(("name", "size"), [("two masses", 0.03), ("gantry", 0.02)])
def test_no_error_within_the_size_is_above_the_bound(name, size):
    model, noise, sample_time = given_of(name)
    worst = WorstCase(model, noise, sample_time, size, 100.0, peak=True)
    gain, rng = stationary(model, noise)[0], np.random.default_rng(7)
    loud = 100.0 * np.sqrt(noise.process[0, 0])
    corner = model.frequencies[model.frequencies > 0].min() * sample_time / 10
    largest = 0.0
    for z in worst.z[::2]:
        smooth = loud / (1 + (np.angle(z) / corner) ** 2)
        for _ in range(60):
            errors, gains = rng.uniform(-size, size, (2, len(model.frequencies)))
            errors = np.where(rng.uniform(size=errors.shape) < 0.5, errors, size * np.sign(errors))
            gains = 1 + size * np.sign(gains)
            of_force = error_at(model, sample_time, gain, errors, gains, z)[worst.flexible] * smooth
            largest = max(largest, float(np.sqrt(np.sum(np.abs(of_force / worst.scale[:, None]) ** 2))))
    assert 0.3 * worst.bound(gain) < largest < worst.bound(gain)


@pytest.mark.parametrize("name", ["stage", "plate"])
def test_the_quick_gain_is_the_librarys(name):
    model, noise, sample_time = given_of(name)
    worst = WorstCase(model, noise, sample_time, 0.03, 100.0, peak=False)
    for logarithm in (-3.0, 0.0, 5.0):
        forces = np.full(len(model.frequencies), logarithm)
        solved = discrete_gain(model.a, worst.driven(forces), model.c, 1.0, noise.sensor).filter_gain
        scale = worst.units[:, None]
        assert np.abs((worst.quick_gain(forces) - solved) / scale).max() < 1e-9 * np.abs(solved / scale).max()


@pytest.mark.parametrize("peak", [True, False])
def test_the_search_goes_below_the_kalman_filter(peak):
    model, noise, sample_time = given_of("drive")
    worst = WorstCase(model, noise, sample_time, 0.03, 1000.0, peak=peak)
    assert worst.bound(least(worst).data[2]) < worst.bound(stationary(model, noise)[0])
