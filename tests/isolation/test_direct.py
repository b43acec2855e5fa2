import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from naive import adaptation as naive
from naive import counting
from notebooks.isolation.efficient_update import (
    FORMS,
    average_gain,
    direct_run,
    largest_condition,
    multiplications,
)
from stillwork.base import algebra
from stillwork.estimation import adaptive, covariance_forms


def record(n=3, actuators=2, samples=60):
    rng = np.random.default_rng(0)
    regressors = rng.standard_normal((n, samples))
    return regressors, rng.standard_normal((actuators, n)) @ regressors + 0.1 * rng.standard_normal(
        (actuators, samples)
    )


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("forgetting", [0.95, 1.0])
def test_every_form_is_the_naive_full_inverse(form, forgetting):
    regressors, disturbance = record()
    history, gain = naive.full_inverse_ferls(regressors, disturbance, 0.1, forgetting)
    run = direct_run(form, regressors, disturbance, 0.1, forgetting)
    np.testing.assert_allclose(run.weights, history, atol=1e-12)
    for i in range(len(run.blocks)):
        np.testing.assert_allclose(run.blocks[i, i], gain[:3, :3], atol=1e-13)
        for j in range(len(run.blocks)):
            assert i == j or not run.blocks[i, j].any()


@given(forgetting=st.floats(0.5, 1.0), samples=st.integers(1, 200))
def test_average_gain_makes_an_average(forgetting, samples):
    alpha = average_gain(forgetting, samples)
    for k in {0, samples // 2, samples - 1}:
        assert alpha[k] * sum(forgetting ** (k - j) for j in range(k + 1)) == pytest.approx(1, rel=1e-9)
    assert alpha[0] == pytest.approx(1.0)


def test_largest_condition_is_seen_on_the_way():
    # One direction at a time: after the first sample (1 + 0.01) / 0.01, after the second as good as one.
    assert largest_condition([[1.0, 0.0], [0.0, 1.0]], 0.01, 1.0) == pytest.approx(101.0)
    regressors, disturbance = record()
    last = np.linalg.cond(direct_run("block inverse", regressors, disturbance, 0.1, 0.95).gain)
    assert largest_condition(regressors, 0.1, 0.95) > last


@pytest.mark.parametrize(("actuators", "n"), [(1, 1), (2, 3), (3, 2)])
def test_multiplications_are_those_of_the_update_written_out(actuators, n, monkeypatch):
    rng = np.random.default_rng(1)
    expected = multiplications(actuators, n)
    assert expected["full inverse"] == _count_inverse(rng, actuators, actuators * n, actuators)
    assert expected["block inverse"] == _count_inverse(rng, actuators, n, 1)
    assert expected["FxRLS"] == _count_fxrls(rng, actuators, actuators * n)
    psi, error = rng.standard_normal(n), rng.standard_normal(actuators)
    one = counting.Counted(1.0)

    # The kernels themselves, interpreted on numbers that count.
    def objects(array):
        return np.array(counting.counted(array), dtype=object)

    for module, name in (
        (adaptive, "update_covariance"),
        (adaptive, "step_weights"),
        (adaptive, "add_scaled"),
        (adaptive, "inner_product"),
        (covariance_forms, "project"),
        (covariance_forms, "downdate"),
        (algebra, "plus_row"),
    ):
        monkeypatch.setattr(module, name, getattr(module, name).py_func)
    monkeypatch.setattr(adaptive, "check_powers", lambda *_: None)  # of the limit, which is not the paper's
    counting.Counted.count = 0
    adaptive.ferls_update.py_func(
        objects(np.zeros((actuators, n))),
        objects(np.eye(n)),
        one,
        np.full((4, n), np.inf),
        np.inf,
        np.empty(n, dtype=object),
        objects(psi),
        objects(error),
    )
    assert counting.Counted.count == expected["recursion"]
    counting.Counted.count = 0
    adaptive.felms_update.py_func(
        objects(np.zeros((actuators, n))), objects(psi), objects(error), one, one, one
    )
    assert counting.Counted.count == expected["FeLMS"]


def _count_fxrls(rng, outputs, size):
    """One update of recursive least squares with `outputs` rows of `size` filtered regressors."""
    covariance = counting.counted(np.eye(size))
    psi = counting.counted(rng.standard_normal((outputs, size)))
    error = counting.counted(rng.standard_normal((outputs, 1)))
    counting.Counted.count = 0
    side = counting.product(covariance, list(zip(*psi, strict=True)))
    innovation = counting.product(psi, side)
    for i in range(outputs):
        innovation[i][i] = innovation[i][i] + 0.9
    gain = counting.product(side, counting.inverse(innovation))
    taken = counting.product(gain, list(zip(*side, strict=True)))
    for row, less in zip(covariance, taken, strict=True):
        for a, b in zip(row, less, strict=True):
            (a - b) / 0.9
    counting.product(gain, error)
    return counting.Counted.count


def _count_inverse(rng, actuators, size, rows):
    """One update with dense matrices: `rows` rows of the regression matrix, `size` parameters in the inverse."""
    information = counting.counted(np.diag(rng.uniform(1, 2, size)))
    matrix = counting.counted(rng.standard_normal((rows, size)))
    error = counting.counted(rng.standard_normal(actuators))
    counting.Counted.count = 0
    forgotten = [[0.9 * x for x in row] for row in information]
    squares = counting.product(list(zip(*matrix, strict=True)), matrix)
    summed = [[a + b for a, b in zip(x, y, strict=True)] for x, y in zip(forgotten, squares, strict=True)]
    gain = counting.inverse(summed)
    if rows > 1 or (actuators == 1 == rows and size == 1):
        gradient = counting.product(list(zip(*matrix, strict=True)), [[e] for e in error])
        counting.product(gain, gradient)
    else:
        direction = counting.product(gain, [[x] for x in matrix[0]])
        counting.product(direction, [error])
    return counting.Counted.count
