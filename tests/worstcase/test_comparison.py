"""The estimators of the comparison against slow twins, brute force and what theory says of long records."""

import numpy as np
import pytest
from scipy import optimize

from notebooks.worstcase import comparison
from notebooks.worstcase.comparison import (
    EXCITATIONS,
    METHODS,
    SETTINGS,
    Setting,
    best_intervals,
    compare,
    comparison_trial,
    equal_to_best,
    estimates,
    over_best,
    sample_record,
    turning_points,
)
from stillwork.estimation.hinfinity import smallest_level
from stillwork.estimation.linear_fits import (
    cross_validated_penalty,
    evidence_penalty,
    hinfinity_estimate,
    hinfinity_model,
    huber_estimate,
    instrumental_variables,
)

FORGETTING = 0.9


def record(setting=SETTINGS["noise 0.5, 0.5"], excitation="low-pass", taps=3, rows=40, seed=1):
    return sample_record(np.random.default_rng(seed), setting, excitation, taps, rows)


def nearest(cost, start):
    return optimize.minimize(cost, start, method="BFGS", options={"gtol": 1e-10}).x


def test_every_estimate_minimises_its_own_criterion():
    """Sums over samples, written out; the minimum is left to a general optimiser."""
    one = record()
    found = estimates(one, FORGETTING)
    assert list(found) == list(METHODS)
    rows, taps = one.matrix.shape
    weight = [FORGETTING ** (rows - 1 - t) for t in range(rows)]
    square = sum(weight[t] * one.perturbation[t] @ one.perturbation[t] for t in range(rows)) / taps
    noise = sum(weight[t] * one.noise[t] ** 2 for t in range(rows))
    bound = np.sqrt(
        np.linalg.eigvalsh(sum(w * np.outer(e, e) for w, e in zip(weight, one.perturbation, strict=True)))[-1]
    )

    def misfit(x):
        return sum(weight[t] * (one.target[t] - one.matrix[t] @ x) ** 2 for t in range(rows))

    criteria = {
        "least": misfit,
        "ridge": lambda x: misfit(x) + square * x @ x,
        "bayes": lambda x: misfit(x) + taps * (noise + square) / sum(weight) * x @ x,
        "compensated": lambda x: misfit(x) - square * x @ x,
        "total": lambda x: misfit(x) / (square * x @ x + noise),
        "min_max": lambda x: np.sqrt(misfit(x)) + bound * np.linalg.norm(x),
    }
    for name, criterion in criteria.items():
        # a minimum found from differences of the criterion is good to the root of rounding, 1e-8, and some conditioning
        assert nearest(criterion, found["least"]) == pytest.approx(found[name], abs=2e-6), name
    mild = estimates(record(SETTINGS["noise 0.1, 0.1"]), FORGETTING)
    # one step of the iteration leaves a share f' of alpha's error, which is small for a small bound
    assert mild["approximate"] == pytest.approx(mild["min_max"], abs=1e-3)


@pytest.mark.parametrize("excitation", EXCITATIONS)
def test_a_record_is_what_it_says(excitation):
    one = record(Setting(0.3, 0.2), excitation, rows=4000)
    assert (one.matrix + one.perturbation) @ one.truth + one.noise == pytest.approx(one.target)
    assert np.linalg.norm(one.truth) == pytest.approx(1)
    clean = one.matrix + one.perturbation
    # three deviations of the variance of 4000 samples, fewer that are independent with a low-pass
    assert clean.std() == pytest.approx(1, rel=0.05)
    assert one.perturbation.std() == pytest.approx(0.3, rel=0.05) and one.noise.std() == pytest.approx(
        0.2, rel=0.05
    )
    assert one.instruments[3:, 0] == pytest.approx(one.matrix[:-3, 0])  # three samples older
    power = np.abs(np.fft.rfft(clean[:, 0])) ** 2
    near = slice(int(0.052 * 4000), int(0.062 * 4000))
    share = power[near].sum() / power.sum()
    assert (share > 0.7) == (excitation == "tone")


def test_gain_delay_jump_and_colour():
    assert (one := record(Setting(gain=1.2))).perturbation == pytest.approx(0.2 * one.matrix)
    late = record(Setting(delay=1.0))
    assert (late.matrix + late.perturbation)[1:] == pytest.approx(late.matrix[:-1])
    half = record(Setting(delay=0.5, output_noise=0.0), "tone", rows=500)
    true, measured = half.matrix + half.perturbation, half.matrix
    # the tone is most of it: over half a sample it turns by half of its angle over one
    assert np.corrcoef(true[:, 0], measured[:, 0])[0, 1] == pytest.approx(
        0.25 + 0.75 * np.cos(np.pi * 0.057), abs=0.05
    )
    jump = record(Setting(output_noise=0.0, jump=10))
    signs = np.sign(jump.target / (jump.matrix @ jump.truth))
    assert np.all(signs[:-10] == -1) and np.all(signs[-10:] == 1)
    noise = record(Setting(output_noise=1.0, output_pole=0.9), rows=20000).noise
    assert np.corrcoef(noise[1:], noise[:-1])[0, 1] == pytest.approx(0.9, abs=0.01)
    assert noise.std() == pytest.approx(1, rel=0.1)


def test_cells_can_be_made_again_and_nothing_has_a_smaller_worst_case_than_min_max():
    chosen = {name: SETTINGS[name] for name in ("noise 0.5, 0.5", "gain 0.8")}
    found = compare(chosen, 4, 3, 3, 60, FORGETTING)
    assert found["errors"].shape == (2, len(EXCITATIONS), 4, len(METHODS))
    stream = np.random.default_rng(np.random.SeedSequence(3 + 7).spawn(4)[2])
    again = comparison_trial(stream, SETTINGS["gain 0.8"], "tone", 3, 60, FORGETTING)
    assert np.array_equal(again["errors"], found["errors"][1, 3, 2])
    best = found["worst"][..., list(METHODS).index("min_max")]
    assert np.all(found["worst"] >= best[..., None] * (1 - 1e-12))


def test_the_judgement_of_a_cell():
    """Two runs a method, errors by hand: geometric means 2, 4 and 2; the third scatters too much to be behind."""
    errors = np.array([[[2.0, 4.0, 0.1], [2.0, 4.0, 44.1]]])
    assert over_best(errors)[0] == pytest.approx([1, 2, 1.05], abs=1e-4)
    # a method that is a tenth worse in every run is worse, one that scatters about the best by less than a per cent is equal
    rng = np.random.default_rng(1)
    runs = np.exp(rng.normal(0, 0.5, (40, 1)) + np.array([0.0, 0.1, 0.0]) + rng.normal(0, 0.005, (40, 3)))
    assert equal_to_best(runs).tolist() == [True, False, True]
    assert comparison.worse_than_best(runs).tolist() == [False, True, False]
    low, high = best_intervals(runs)
    assert low[1] < np.exp(0.1) < high[1]


def test_penalties_are_those_of_the_plain_criteria():
    """Leave-one-out and the likelihood of the data written out, on the grid that the functions search."""
    rng = np.random.default_rng(4)
    matrix, noise = rng.standard_normal((12, 3)), rng.standard_normal(12)
    target = matrix @ [0.3, -0.2, 0.1] + noise
    penalties = np.linalg.norm(matrix, 2) ** 2 * np.geomspace(1e-10, 1e6, 321)

    def cross_validated(penalty):
        hat = matrix @ np.linalg.inv(matrix.T @ matrix + penalty * np.eye(3)) @ matrix.T
        return np.sum((target - hat @ target) ** 2) / (12 - np.trace(hat)) ** 2

    def unlikely(
        penalty,
    ):  # minus twice the log of the best Gaussian density, of variance s (I + A A' / penalty)
        shape = np.eye(12) + matrix @ matrix.T / penalty
        return 12 * np.log(target @ np.linalg.solve(shape, target)) + np.linalg.slogdet(shape)[1]

    for found, criterion in ((cross_validated_penalty, cross_validated), (evidence_penalty, unlikely)):
        best = min(criterion(penalty) for penalty in penalties)
        assert criterion(found(matrix, target, 12)) == pytest.approx(best, rel=1e-9)


def test_turning_points_lie_where_the_errors_cross():
    """Min-max below least squares from a noise of 2 on, above 1 from 8 on, by straight lines between logarithms."""
    noises, methods = (1.0, 4.0, 16.0), list(METHODS)
    errors = np.ones((3, 1, 2, len(methods)))
    errors[:, 0, :, methods.index("min_max")] = np.array([0.25, 0.5, 2.0])[:, None]
    errors[:, 0, :, methods.index("least")] = np.array([0.125, 1.0, 8.0])[:, None]
    found = turning_points(errors, noises)
    assert found["worstcase.comparison.pays-from"] == pytest.approx(2.0)
    assert found["worstcase.comparison.pays-to"] == pytest.approx(8.0)


def test_instruments_are_two_regressions():
    one = record()
    projection = one.instruments @ np.linalg.pinv(one.instruments)
    inner = one.matrix.T @ projection
    expected = np.linalg.inv(inner @ one.matrix) @ inner @ one.target
    assert instrumental_variables(one.matrix, one.target, one.instruments) == pytest.approx(expected)


def gain_of(matrix, level):
    """Largest ratio of the errors' energy to that of what is unknown, by the filter run on each unknown of its own."""
    rows, taps = matrix.shape
    deviation = 0.7
    columns = []
    for unknown in np.eye(taps + rows):
        truth, noise = unknown[:taps] / np.sqrt(taps), deviation * unknown[taps:]
        # the state grows as forgetting^(-t/2) while white noise does not, so neither do the outputs of the model
        growth = FORGETTING ** (-np.arange(1, rows + 1) / 2)
        outputs = (matrix @ truth) + noise / growth
        errors = [truth]
        for t in range(1, rows):
            found = filtered(matrix[:t], outputs[:t], deviation, level)
            errors.append(growth[t - 1] * (truth - found))
        columns.append(np.concatenate(errors))
    return np.linalg.norm(np.array(columns).T, 2)


def filtered(matrix, outputs, deviation, level):
    # information form, with plain inverses: P^-1 - level^-2 I at the start of each step, then the sample
    taps = matrix.shape[1]
    information, state = taps * np.eye(taps), np.zeros(taps)
    for t, (row, output) in enumerate(zip(matrix, outputs, strict=True), 1):
        information = FORGETTING * (information - np.eye(taps) / level**2)
        assert np.linalg.eigvalsh(information)[0] > 0
        information = information + np.outer(row, row) / deviation**2
        state = state / np.sqrt(FORGETTING)
        scaled = FORGETTING ** (-t / 2) * output
        state = state + np.linalg.inv(information) @ row * (scaled - row @ state) / deviation**2
    return state * FORGETTING ** (len(outputs) / 2)


def test_hinfinity_keeps_its_level_and_nothing_keeps_less():
    matrix = record(rows=9).matrix
    model = hinfinity_model(matrix, 0.49, np.eye(3) / 3, FORGETTING)
    smallest = smallest_level(model, np.eye(3), 1e-3)
    target = np.random.default_rng(3).standard_normal(9)
    level = 1.1 * smallest_level(model, np.eye(3), 1e-2)
    twin = filtered(matrix, target, 0.7, level)
    found = hinfinity_estimate(matrix, target, 0.49, 1.0, FORGETTING)
    assert found == pytest.approx(twin, abs=1e-9)
    assert smallest / 1.001 < gain_of(matrix, level) < level
    with pytest.raises(AssertionError):  # below the smallest level the information loses its sign
        filtered(matrix, target, 0.7, 0.99 * smallest)


def test_huber_is_scikit_learn_s_at_its_scale():
    from sklearn.linear_model import HuberRegressor

    rng = np.random.default_rng(5)
    matrix = rng.standard_normal((400, 2))
    noise = rng.standard_normal(400) * np.where(rng.random(400) < 0.1, 30.0, 1.0)
    target = matrix @ [2.0, -1.0] + noise
    peer = HuberRegressor(alpha=0.0, fit_intercept=False, tol=1e-9).fit(matrix, target).coef_
    least = np.linalg.lstsq(matrix, target)[0]
    found = huber_estimate(matrix, target, np.ones(400))
    # their scales differ: his is estimated with the parameters, ours is the median's
    assert np.linalg.norm(found - peer) < 0.1 * np.linalg.norm(least - [2.0, -1.0])
