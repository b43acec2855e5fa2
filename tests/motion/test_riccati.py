"""Kalman gains: the return-difference identity, closed forms, and what must be refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.motion.designs import stage_observer
from experiments.motion.machines import published_noise, stage
from stillwork.base.checks import InputError
from stillwork.estimation import riccati
from stillwork.estimation.riccati import continuous_gain, covariance_root, discrete_gain
from stillwork.lti.discretisation import zoh_modes
from stillwork.lti.reduction import truncate


@pytest.mark.parametrize("noise_model", [None, 0.03, 1e3])
@pytest.mark.parametrize("position", [1, 4, 7])
def test_return_difference_identity(position, noise_model):
    r"""|1 + C(sI-A)^{-1}L|^2 R = R + |C(sI-A)^{-1}GQ^{1/2}|^2 on the imaginary axis, from matrices only."""
    noise = published_noise()
    observer = stage_observer(position, noise, noise_model)
    g = observer.b * np.sqrt(noise.process)
    if noise_model:
        extra = np.zeros((len(observer.a), 1))
        extra[-1] = np.sqrt(noise_model)
        g = np.hstack([g, extra])
    for omega in 2 * np.pi * np.array([0.5, 20.0, 120.0, 469.0, 800.0, 3000.0]):
        resolvent = np.linalg.inv(1j * omega * np.eye(len(observer.a)) - observer.a)
        left = abs(1 + (observer.c @ resolvent @ observer.gain)[0, 0]) ** 2
        right = 1 + (np.abs(observer.c @ resolvent @ g) ** 2).sum() / noise.sensor
        assert left == pytest.approx(right, rel=1e-9)
    assert observer.residual < 1e-10


def test_double_integrator_has_its_closed_form():
    mass, q, r = 12.5, 1e-4, 2e-18
    a, g, c = np.array([[0.0, 1], [0, 0]]), np.array([[0], [1 / mass]]), np.array([[1.0, 0]])
    w2 = np.sqrt(q / r) / mass
    solved = continuous_gain(a, g, c, q, r)
    np.testing.assert_allclose(solved.gain[:, 0], [np.sqrt(2 * w2), w2], rtol=1e-10)
    np.testing.assert_allclose(solved.covariance[0, 0], r * np.sqrt(2 * w2), rtol=1e-10)


def test_predictor_and_filter_form():
    model = zoh_modes(truncate(stage().at([0], [4]), 4, 3), 1e-4)
    solved = discrete_gain(model.a, model.b, model.c, 1e-4, 2e-18)
    np.testing.assert_allclose(solved.gain, model.a @ solved.filter_gain, rtol=1e-12)


def test_random_walk_has_its_closed_form():
    found = continuous_gain([[0.0]], [[1.0]], [[1.0]], 4.0, 9.0)
    assert found.gain[0, 0] == pytest.approx(2 / 3, rel=1e-12)
    assert found.covariance[0, 0] == pytest.approx(6.0, rel=1e-12)


def test_a_stable_mode_need_not_be_driven():
    found = continuous_gain(np.diag([-1.0, -2.0]), [[1.0], [0.0]], [[1.0, 1.0]], 3.0, 1.0)
    assert found.gain[:, 0] == pytest.approx([1.0, 0.0], abs=1e-9)  # p^2 + 2 p = 3


@pytest.mark.parametrize("solve", [continuous_gain, discrete_gain])
def test_where_the_library_finds_none_doubling_does(solve, monkeypatch):
    model = truncate(stage().at([0], [4]), 4, 3)
    plant = model.state_space() if solve is continuous_gain else zoh_modes(model, 1e-4)
    wanted = solve(plant.a, plant.b, plant.c, 1e-4, 2e-18).gain
    monkeypatch.setattr(riccati, "_solved", lambda _, a, g, c: np.full_like(a, np.nan))
    found = solve(plant.a, plant.b, plant.c, 1e-4, 2e-18).gain
    np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-8 * np.abs(wanted).max())


def test_a_large_residual_is_refused(monkeypatch):
    monkeypatch.setattr(riccati, "WORST_RESIDUAL", 1e-30)
    with pytest.raises(InputError, match="residual"):
        continuous_gain([[0.0, 1.0], [-3.0, -0.1]], [[0.0], [1.0]], [[1.0, 0.0]], 1.0, 1e-4)
    with pytest.raises(InputError, match="residual"):
        discrete_gain([[0.9, 0.1], [0.0, 0.7]], [[0.0], [1.0]], [[1.0, 0.0]], 1.0, 1e-4)


def noisy_system(seed):
    """Noises over fourteen decades; poles up to 1.3 times the distance to the stability boundary."""
    rng = np.random.default_rng(seed)
    states, disturbances, outputs = rng.integers(1, 7), rng.integers(1, 4), rng.integers(1, 4)
    a = rng.normal(size=(states, states))
    a *= rng.uniform(0.2, 1.3) / np.abs(np.linalg.eigvals(a)).max()
    q, r = (np.diag(10.0 ** rng.uniform(-7, 7, size)) for size in (disturbances, outputs))
    return a, rng.normal(size=(states, disturbances)), rng.normal(size=(outputs, states)), q, r


def recursion_limit(a, g, c, q, r, steps=2000):
    """Predicted covariance by the recursion in Joseph's form, from a wide start; None where it does not settle."""
    p = np.eye(len(a)) * (np.abs(q).max() + np.abs(r).max())
    for _ in range(steps):
        gain = np.linalg.solve(c @ p @ c.T + r, c @ p).T
        kept = np.eye(len(a)) - gain @ c
        following = a @ (kept @ p @ kept.T + gain @ r @ gain.T) @ a.T + g @ q @ g.T
        deviations = np.sqrt(np.diag(following))
        if np.all(np.abs(following - p) <= 1e-13 * np.outer(deviations, deviations)):
            return following
        p = following
    return None


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 400, 200))
def test_observers_are_stable_over_fourteen_decades_of_noise(first):
    settled = 0
    for seed in range(first, first + 200):
        a, g, c, q, r = noisy_system(seed)
        try:
            found = discrete_gain(a, g, c, q, r)
        except InputError as error:
            assert "Riccati equation" in str(error) or "unstable observer" in str(error)
            continue
        assert np.abs(np.linalg.eigvals(a - found.gain @ c)).max() < 1
        if seed % 5 == 0 and (expected := recursion_limit(a, g, c, q, r)) is not None:
            settled += 1
            deviations = np.sqrt(np.diag(expected))
            difference = np.abs(found.covariance - expected) / np.outer(deviations, deviations)
            assert difference.max() < 1e-7, seed  # worst found: 5e-10
    assert settled > 20


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.integers(0, 4))
def test_the_root_of_a_covariance_is_one_though_it_be_semidefinite(seed, size, rank):
    factor = np.random.default_rng(seed).normal(size=(size, rank))
    root = covariance_root(factor @ factor.T)
    np.testing.assert_allclose(root @ root.T, factor @ factor.T, atol=1e-13)
    if rank >= size:
        a, c = 0.9 * np.eye(size), np.eye(size)
        by_root = discrete_gain(a, root, c, 1.0, 0.5 * np.eye(size)).filter_gain
        whole = discrete_gain(a, np.eye(size), c, factor @ factor.T, 0.5 * np.eye(size)).filter_gain
        np.testing.assert_allclose(by_root, whole, rtol=1e-8, atol=1e-10)
