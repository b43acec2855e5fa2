import numpy as np
import pytest
from scipy import optimize, signal

from experiments.worstcase import measured
from experiments.worstcase.pairs import open_pair
from experiments.worstcase.simulations import FIG_2_PARAMETERS, path
from experiments.worstcase.theory import counter_example
from naive import worstcase as naive
from notebooks.worstcase import real_record, tracking
from notebooks.worstcase.contraction import convergence_trial, scalar_trial
from notebooks.worstcase.fir_identification import criterion_trial, fir_trial, gain_trial, least_squares_limit
from notebooks.worstcase.geometry import solution_trial
from notebooks.worstcase.real_record import load_pair
from notebooks.worstcase.time_updates import weighting_trial
from notebooks.worstcase.tracking import settled, tracking_trial
from stillwork.estimation import min_max_solve
from stillwork.estimation.linear_fits import total_least_squares
from stillwork.identification import fir_regressors
from stillwork.identification.regressors import exponential_bound
from workbook import paths
from workbook.studies import run_study

FIG_1 = {"parameters": (1.0, 0.5), "period": 20, "samples": 60, "input_noise": 0.1, "output_noise": 1.0}


def fig_1_record(seed):
    """Regressors and outputs of `fir_trial`, made again with scalar loops."""
    rng = np.random.default_rng(seed)
    clean = np.array([1.0 if (k % 20) < 10 else -1.0 for k in range(61)])
    error = rng.uniform(-0.1, 0.1, 61)
    noise = rng.uniform(-1.0, 1.0, 60)
    rows = np.array([[clean[t] + error[t], clean[t - 1] + error[t - 1]] for t in range(1, 61)])
    outputs = np.array([clean[t] + 0.5 * clean[t - 1] + noise[t - 1] for t in range(1, 61)])
    return rows, outputs, np.array([[error[t], error[t - 1]] for t in range(1, 61)])


@pytest.mark.parametrize("gain", [0.8, 1.2])
def test_a_gain_error_alone_scales_the_estimates(gain):
    """Without noise the outputs are A (gain x), which least squares finds."""
    found = gain_trial(np.random.default_rng(1), (1.0, 0.5), 20, 60, gain, 0.0)
    assert found["least"] == pytest.approx(abs(gain - 1) * np.hypot(1.0, 0.5), rel=1e-9)
    assert gain_trial(np.random.default_rng(1), (1.0, 0.5), 20, 60, 1.0, 0.0)["min_max"] < 1e-9


def test_what_is_saved_of_the_worst_case_is_what_a_search_saves():
    saved = criterion_trial(np.random.default_rng(3), (0.3, 0.9), **FIG_1)["saved"]
    rows, outputs, _ = fig_1_record(3)
    least = np.linalg.lstsq(rows, outputs)[0]
    threshold = np.linalg.norm(rows.T @ outputs) / np.linalg.norm(outputs)
    for share, ours in zip((0.3, 0.9), saved, strict=True):

        def worst(x, eta=share * threshold):
            return np.linalg.norm(rows @ x - outputs) + eta * np.linalg.norm(x)

        best = optimize.minimize(worst, least, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12})
        assert ours == pytest.approx(1 - best.fun / worst(least), abs=1e-8)


def test_fir_trial_agrees_with_batch_solutions():
    found = fir_trial(np.random.default_rng(3), **FIG_1)
    rows, outputs, errors = fig_1_record(3)
    for t in (12, 30, 59):
        A, b = rows[: t + 1], outputs[: t + 1]
        bound = np.sqrt(2) * 0.1 * np.sqrt(t + 1)
        solution = min_max_solve(A, b, bound)
        assert found["bound"][t] == pytest.approx(bound)
        assert found["min_max"][:, t] == pytest.approx(solution.estimate, rel=1e-9)
        assert found["min_max_worst"][t] == pytest.approx(solution.worst_case_residual, rel=1e-9)
        assert found["least"][:, t] == pytest.approx(np.linalg.lstsq(A, b, rcond=None)[0], rel=1e-8)
        total = total_least_squares(A, b)
        assert found["total"][:, t] == pytest.approx(total, rel=1e-7)
        residual, length = np.linalg.norm(A @ total - b), np.linalg.norm(total)
        assert found["total_matrix"][t] == pytest.approx(residual * length / (1 + length**2), rel=1e-6)
        assert found["total_target"][t] == pytest.approx(residual / (1 + length**2), rel=1e-6)
        worst = residual + bound * length
        assert found["total_worst"][t] == pytest.approx(worst, rel=1e-7)
        assert found["perturbation"][t] == pytest.approx(np.linalg.norm(errors[: t + 1], 2), rel=1e-9)
    assert np.isnan(found["total"][:, :2]).all()


@pytest.mark.parametrize(("period", "noise"), [(20, 0.1), (4, 0.5)])
def test_least_squares_tends_to_its_limit(period, noise):
    settings = {**FIG_1, "period": period, "samples": 100_000, "input_noise": noise, "output_noise": 0.1}
    found = fir_trial(np.random.default_rng(0), **settings)["least"][:, -1]
    assert found == pytest.approx(least_squares_limit((1.0, 0.5), period, noise), abs=3e-3)


def test_tracking_trial_draws_rows_within_the_bound_and_reports_error_norms():
    truth = path("constant", FIG_2_PARAMETERS, 100)
    found = tracking_trial(np.random.default_rng(1), truth, 1.0, 0.95, 0.25, 0.1, 10.0)
    assert found["zero"] == pytest.approx(np.full(100, np.linalg.norm(FIG_2_PARAMETERS)))
    assert set(found) == {"min_max", "rls", "ridge", "zero", "norm", "weighted_norm", "vanished"}
    rows = np.random.default_rng(1).standard_normal(truth.shape).T
    products = sum(0.95 ** (len(rows) - 1 - t) * np.outer(row, row) for t, row in enumerate(rows))
    assert found["weighted_norm"] == pytest.approx(np.sqrt(np.linalg.eigvalsh(products)[-1]))
    # without noise and errors RLS finds the truth, and so does min-max for a small bound
    clean = tracking_trial(np.random.default_rng(1), 20 * truth, 1e-6, 0.95, 0.0, 0.0, 1e-6)
    assert clean["rls"][-1] < 1e-3
    assert clean["min_max"][-1] < 1e-3
    assert settled(np.full((3, 100), 2.0), 0.95) == pytest.approx([2, 2, 2])


def test_trials_of_the_theory_agree_with_naive_solutions():
    solution = run_study(solution_trial, 5, 0, progress=False, perturbations=20)
    assert solution["cost"].max() < 1e-7
    assert solution["attained"].max() < 1e-12
    assert (solution["crossings"] == 1).all()
    weights = weighting_trial(np.random.default_rng(0), 0.25, 0.95, 30)
    assert weights["over_limit"] == pytest.approx(
        weights["over_sum"] * exponential_bound(0.25, 0.95, 30) / exponential_bound(0.25, 0.95)
    )
    assert scalar_trial(np.random.default_rng(0))["bounded"] == 1
    assert convergence_trial(np.random.default_rng(0), 3, 400)["converged"] == 1


def test_break_even_noise_lies_where_the_map_crosses_one():
    noises, bounds = np.array([0.01, 0.1, 1.0]), np.array([0.5, 2.0])
    ratios = np.array([[2.0, 2.0, 0.5], [2.0, 2.0, 0.5]])
    assert tracking.break_even_noise(noises, bounds, ratios, 1.0) == pytest.approx(10**-0.5)


@pytest.mark.parametrize("samples", [1000, 20000])
def test_the_quietest_tenth_is_low_where_noise_fills_the_band_and_high_where_the_input_does(
    samples, tmp_path
):
    found = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        tone = np.sin(0.3 * np.arange(samples))
        loud = 0.3 * signal.lfilter([1.0], [1.0, -0.95], rng.standard_normal(samples))
        file = tmp_path / f"{seed}.csv"
        table = np.column_stack([tone, loud]) + 0.1 * rng.standard_normal((samples, 2))
        np.savetxt(file, table, delimiter=",", header="tone,loud", comments="")
        found.append(open_pair(file, sample_rate=1000.0)[0].noise)
    low, high = np.transpose(found) / 0.1
    assert 0.75 < low.min() <= low.max() < 1
    assert high.min() > 1.2


def test_counter_example_is_steep_by_plain_differences():
    function = counter_example(0.5, 0.02)
    A = np.array([[1.0, 0.0], [0.0, 0.1], [0.0, 0.0]])
    b = np.array([1.0, 0.1, 0.02])
    slopes = [
        (naive.secular_value(A, b, 0.5, a * 1.001) - naive.secular_value(A, b, 0.5, a)) / (0.001 * a)
        for a in np.geomspace(1e-4, 1e-1, 50)
    ]
    assert max(slopes) > 2
    assert function(0.01) == pytest.approx(naive.secular_value(A, b, 0.5, 0.01), rel=1e-12)


def test_measured_pair_is_the_shipped_record():
    pair, spectra = load_pair((100.0, 1500.0), (300.0, 600.0))
    assert pair.input.shape == pair.output.shape == (60_800,)
    assert pair.sample_rate == 3200
    assert 0.25 * pair.input.std() < pair.noise < pair.input.std()
    loud = spectra.frequency[np.argmax(spectra.coherence * (spectra.frequency > 50))]
    assert 100 < loud < 300  # the machine's line, see SOURCE.md
    found = measured.window_residuals(pair, 8, [64], 5)
    start = 8
    regressors = fir_regressors(pair.input, 8)
    x = np.linalg.lstsq(regressors[:, start : start + 64].T, pair.output[start : start + 64], rcond=None)[0]
    later = slice(start + 64, start + 128)
    miss = np.linalg.norm(pair.output[later] - x @ regressors[:, later]) / np.linalg.norm(pair.output[later])
    assert found["least squares"][0][0] == pytest.approx(miss, rel=1e-9)
    swept = real_record.bound_sweep(pair, 8, 64, np.array([1e-9, 1.0]), 5)
    medians = [np.median(found[name][0]) for name in ("least squares", "min-max, typical bound")]
    assert swept == pytest.approx(np.array(medians), rel=1e-7)


def test_an_exchanged_pair_has_the_other_sensor_s_noise():
    pair, spectra = load_pair((100.0, 1500.0), (300.0, 600.0))
    other = real_record.exchange(pair, spectra, (300.0, 600.0))
    assert np.array_equal(other.input, pair.output) and np.array_equal(other.output, pair.input)
    again = open_pair(
        paths.data("worstcase", "structure_accel_3k2/structure_accel_20s.npz"),
        band_hz=(100.0, 1500.0), quiet_hz=(300.0, 600.0),
    )[0]  # fmt: skip
    assert other.noise == pytest.approx(again.noise[1], rel=1e-12)


def test_a_tone_is_the_loudest_band():
    t = np.arange(32000) / 3200
    values = 3.0 * np.sin(2 * np.pi * 181.0 * t) + np.random.default_rng(1).standard_normal(len(t))
    low, high, share = measured.loudest_band(values, 3200.0)
    assert low < 181.0 < high and high - low <= 8.0
    assert share == pytest.approx(4.5 / 5.5, abs=0.01)
