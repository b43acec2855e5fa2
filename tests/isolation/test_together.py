"""The guard against wind-up in runs side by side, compared with each run alone and against sums of its own."""

import numpy as np
import pytest
from scipy import signal

from experiments.isolation.lanes import lanes
from experiments.isolation.together import ferls_updates, hold_each
from stillwork.base.kernels import kernel
from stillwork.estimation.adaptive import FeRls, ferls_update, hold_triangle

RUNS, REGRESSORS, FORGETTING = 4, 3, 0.97


@kernel
def advance_together(weights, matrix, levels, gain, allowance, regressors, errors, together):
    wide_weights, wide_matrix, wide_levels = lanes((weights, matrix, levels), together)
    wide_gain, regressors, errors = lanes((gain, regressors, errors), together)
    for k in range(len(regressors)):
        _, within = ferls_updates(
            wide_weights,
            wide_matrix,
            FORGETTING,
            wide_levels,
            levels,
            allowance,
            wide_gain,
            regressors[k],
            errors[k],
        )
        if not within:
            hold_each(matrix, FORGETTING, levels, RUNS)


@kernel
def advance_alone(weights, matrix, levels, gain, allowance, regressors, errors):
    for k in range(len(regressors)):
        _, reached = ferls_update(
            weights, matrix, FORGETTING, levels, allowance, gain, regressors[k], errors[k]
        )
        if reached:
            hold_triangle(matrix, FORGETTING, levels, gain)


# Of P(-1): at 1e4 only the power sets the limits, at 1e-3 P(-1) alone does, between them both.
@pytest.mark.parametrize("initial", [1e4, 1.0, 1e-3])
@pytest.mark.parametrize("quiet", [1.0, 1e-3])
def test_the_limits_of_every_run_are_those_of_it_alone_and_of_its_power(initial, quiet):
    rng = np.random.default_rng(3)
    regressors = rng.standard_normal((200, REGRESSORS, RUNS)) * np.geomspace(0.3, 3.0, RUNS)
    regressors[60:] *= quiet  # nothing excites P any more, and it winds up
    errors = rng.standard_normal((200, 1, RUNS))
    settings = FeRls(initial, FORGETTING, growth_limit=2.0)
    alone = [settings.start(REGRESSORS) for _ in range(RUNS)]
    weights = np.zeros((1, REGRESSORS * RUNS))
    matrix, levels = (np.repeat(each, RUNS, axis=1) for each in (alone[0].matrix, alone[0].levels))
    advance_together(
        weights,
        matrix,
        levels,
        np.zeros(REGRESSORS * RUNS),
        alone[0].allowance,
        regressors.reshape(200, -1),
        errors.reshape(200, -1),
        (0,) * RUNS,
    )
    for run, one in enumerate(alone):
        own = np.zeros((1, REGRESSORS))
        mine = np.ascontiguousarray(regressors[..., run])
        given = one.matrix, one.levels, one.gain, one.allowance
        advance_alone(own, *given, mine, np.ascontiguousarray(errors[..., run]))
        np.testing.assert_array_equal(matrix[:, run::RUNS], one.matrix)
        np.testing.assert_array_equal(levels[:3, run::RUNS], one.levels[:3])
        np.testing.assert_array_equal(weights[:, run::RUNS], own)

        power = signal.lfilter([1.0], [1.0, -FORGETTING], mine**2, axis=0)
        limit = np.minimum(2.0 * initial, 20.0 / power.max(axis=0))
        np.testing.assert_allclose(levels[0, run::RUNS], limit, rtol=1e-12)
        np.testing.assert_allclose(levels[1, run::RUNS], power[-1], rtol=1e-12)
        assert np.all(np.diag(matrix[:, run::RUNS]) <= limit * (1 + 1e-9))
        assert quiet == 1.0 or levels[2, run::RUNS].min() > 0.1  # held down for a while
