import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from naive import motion_robust as naive
from notebooks.motion.robust_comparison import regularised_line_search
from stillwork.estimation.robust import (
    Derivatives,
    NormBound,
    kalman_gains,
    regularised_gains,
    sensitivity_gains,
)
from stillwork.estimation.time_varying import TimeVaryingModel, estimate

SEEDS = st.integers(0, 10**6)


def covariance(rng, size):
    root = rng.normal(size=(size, size))
    return root @ root.T + 0.3 * np.eye(size)


def problem(seed, samples=2, states=3, inputs=2, disturbances=2, outputs=2):
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(states, states)) / np.sqrt(states)
    model = TimeVaryingModel(
        a,
        rng.normal(size=(states, inputs)),
        rng.normal(size=(states, disturbances)),
        rng.normal(size=(samples, outputs, states)),
        covariance(rng, disturbances),
        covariance(rng, outputs),
        covariance(rng, states),
    )
    return rng, model, rng.normal(size=(inputs, samples)), rng.normal(size=(outputs, samples))


def derivatives(rng, model, parameters=2):
    samples, outputs, states = model.c.shape
    return Derivatives(
        rng.normal(size=(parameters, states, states)),
        rng.normal(size=(parameters, states, model.b.shape[2])),
        rng.normal(size=(parameters, states, model.g.shape[2])),
        rng.normal(size=(samples, parameters, outputs, states)),
    )


def bound(rng, model, rows=3, directions=1):
    samples, outputs, states = model.c.shape
    return NormBound(
        rng.normal(size=(samples, outputs, directions)),
        rng.normal(size=(rows, states)),
        rng.normal(size=(rows, model.b.shape[2])),
        rng.normal(size=(rows, model.g.shape[2])),
    )


def first(model):
    return model.a[1], model.b[1], model.g[1], model.c[1]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_sensitivity_step_minimises_the_cost_of_the_output_error_itself(seed):
    rng, model, u, y = problem(seed, states=2, inputs=1, disturbances=1)
    d = derivatives(rng, model)
    start, gamma = rng.normal(size=2), 0.4

    def model_at(epsilon):
        a, b, g, c = first(model)
        return (
            a + np.tensordot(epsilon, d.a, 1),
            b + np.tensordot(epsilon, d.b, 1),
            g + np.tensordot(epsilon, d.g, 1),
            c + np.tensordot(epsilon, d.c[1], 1),
        )

    def cost(best):
        arguments = (model.process, model.sensor, model.initial_covariance, start, u[:, 0], y[:, 1])
        return naive.sensitivity_cost(best, model_at, 2, gamma, *arguments)

    best = naive.minimise_smooth(cost, np.zeros(3))
    a, b, g, _ = first(model)
    twin = a @ best[:2] + b @ u[:, 0] + g @ best[2:]
    ours = estimate(sensitivity_gains(model, d, gamma), u, y, start)[:, 1]
    np.testing.assert_allclose(ours, twin, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("outputs", [1, 2])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_line_search_solves_the_min_max_problem(seed, outputs):
    rng, model, u, y = problem(seed, states=2, inputs=1, disturbances=1, outputs=outputs)
    box = bound(rng, model, rows=2)
    start = rng.normal(size=2)

    def cost(best):
        arguments = (
            box.m[1],
            box.e_a,
            box.e_b,
            box.e_g,
            model.process,
            model.sensor,
            model.initial_covariance,
        )
        return naive.worst_case_cost(best, *first(model), *arguments, start, u[:, 0], y[:, 1])

    best = naive.minimise(cost, np.zeros(3))
    a, b, g, _ = first(model)
    twin = a @ best[:2] + b @ u[:, 0] + g @ best[2:]
    ours = regularised_line_search(model, box, u, y, start)
    assert ours.ratio[1] >= 1
    np.testing.assert_allclose(ours.states[:, 1], twin, rtol=1e-6, atol=1e-6)


@settings(max_examples=15, derandomize=True)
@given(seed=SEEDS, gamma=st.floats(0.01, 1.0))
def test_steps_follow_the_mended_printed_recursion(seed, gamma):
    samples = 6
    rng, model, u, y = problem(seed, samples=samples)
    d, box = derivatives(rng, model), bound(rng, model, directions=2)
    by_size = [2 * np.linalg.norm(k.T @ np.linalg.solve(model.sensor, k), 2) for k in box.m]
    known = tuple(np.broadcast_to(e, (samples, *e.shape)) for e in (box.e_a, box.e_g, box.e_b))
    less = [model.sensor - k @ k.T / w for k, w in zip(box.m, by_size, strict=True)]
    for gains, (s, t, m), weights, noise in (
        (sensitivity_gains(model, d, gamma), d.rows(model), [(1 - gamma) / gamma] * samples, [model.sensor] * samples),
        (regularised_gains(model, box), known, by_size, less),
    ):  # fmt: skip
        x, p = np.zeros(3), model.initial_covariance
        twin = np.zeros((3, samples))
        for k in range(1, samples):
            matrices = (model.a[k], model.b[k], model.g[k], model.c[k], s[k], t[k], m[k], weights[k])
            x, p = naive.printed_step(*matrices, model.process, noise[k], p, x, u[:, k - 1], y[:, k])
            twin[:, k] = x
        np.testing.assert_allclose(estimate(gains, u, y), twin, rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(gains.covariance[-1], p, rtol=1e-6, atol=1e-8)


def certain(model, rng, kind):
    nothing = NormBound(np.zeros((model.samples, 2, 1)), np.ones((1, 3)), np.ones((1, 2)), np.ones((1, 2)))
    empty = NormBound(np.ones((model.samples, 2, 1)), np.zeros((1, 3)), np.zeros((1, 2)), np.zeros((1, 2)))
    flat = Derivatives(
        np.zeros((1, 3, 3)), np.zeros((1, 3, 2)), np.zeros((1, 3, 2)), np.zeros((model.samples, 1, 2, 3))
    )
    return {
        "no direction": lambda u, y: estimate(regularised_gains(model, nothing), u, y),
        "no rows": lambda u, y: estimate(regularised_gains(model, empty), u, y),
        "line search": lambda u, y: regularised_line_search(model, nothing, u, y).states,
        "no sensitivity": lambda u, y: estimate(sensitivity_gains(model, flat, 0.2), u, y),
        "gamma 1": lambda u, y: estimate(sensitivity_gains(model, derivatives(rng, model), 1.0), u, y),
        "plain": lambda u, y: estimate(kalman_gains(model), u, y),
    }[kind]


@pytest.mark.parametrize(
    "kind", ["no direction", "no rows", "line search", "no sensitivity", "gamma 1", "plain"]
)
def test_without_uncertainty_every_filter_is_the_kalman_filter(kind):
    rng, model, u, y = problem(5, samples=60)
    a, b, g, _ = first(model)
    twin = naive.kalman(a, b, g, model.c, model.process, model.sensor, model.initial_covariance, u, y)
    np.testing.assert_allclose(certain(model, rng, kind)(u, y), twin, rtol=1e-10, atol=1e-10)
