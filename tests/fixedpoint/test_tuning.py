import numpy as np
import pytest

from stillwork.checks import InputError
from stillwork.fixedpoint import Noise, asin_trajectory, compare, families, tune

NOISE = Noise("gaussian", 1e-4)


@pytest.fixture(scope="module")
def training():
    return asin_trajectory(duration=3.0)


@pytest.mark.parametrize("name", ["low pass", "EKF with disturbance", "Savitzky-Golay", "Kalman filter"])
def test_tuning_spends_its_budget_and_helps(name, exact, approximate, training):
    family = families()[name]
    found = tune(family, exact, approximate, training, NOISE, budget=24, runs=2, seed=3)
    assert found.evaluations == 24
    for knob, (low, high) in zip(family.names, np.exp(family.bounds), strict=True):
        assert low * (1 - 1e-9) <= found.settings[knob] <= high * (1 + 1e-9)
    check = compare(exact, {name: found.controller}, training, NOISE, runs=2, seed=3)[name]
    assert check["velocity"].mean() == pytest.approx(found.cost)
    # Better than the middle of the ranges.
    middle = family.controller(approximate, training.time_step, family.bounds.mean(axis=1))
    other = compare(exact, {name: middle}, training, NOISE, runs=2, seed=3)[name]
    assert found.cost <= other["velocity"].mean() + 1e-12


def test_same_seed_same_result(exact, approximate, training):
    twice = [
        tune(families()["low pass"], exact, approximate, training, NOISE, budget=12, runs=1, seed=5).settings
        for _ in range(2)
    ]
    assert twice[0] == twice[1]


def test_bad_input(exact, approximate, training):
    family = families()["low pass"]
    arguments = (family, exact, approximate, training, NOISE)
    with pytest.raises(InputError, match="budget"):
        tune(*arguments, budget=3, runs=1, seed=1)
    with pytest.raises(InputError, match="criterion"):
        tune(*arguments, budget=16, runs=1, seed=1, criterion="speed")
