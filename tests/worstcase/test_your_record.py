"""A record from its file to the judged models: known noise is found, estimates are those of the plain problem."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from experiments.worstcase.pairs import MeasuredPair, open_pair, residual
from notebooks.worstcase.your_record import (
    delay_of,
    fit_pair,
    parts,
    spikes_in,
    warnings_of,
    weighted_corner,
)
from stillwork.estimation.min_max import solve_silently
from stillwork.estimation.recursive import track
from stillwork.identification.regressors import fir_regressors, noise_bound
from workbook import paths

TEMPLATE = paths.data("worstcase", "your_record/template.csv")
LAGS = np.arange(24)
RESPONSE = 0.8 * np.exp(-LAGS / 6) * np.cos(2 * np.pi * 0.09 * LAGS)


@pytest.fixture(scope="module")
def template():
    pair, spectra = open_pair(TEMPLATE, units=("V", "m/s^2"))
    return pair, spectra, fit_pair(pair, 24, 640)


def test_the_template_gives_back_how_it_was_made(template):
    pair, _, fitted = template
    assert pair.names == ("drive (V)", "plate (m/s^2)") and pair.sample_rate == pytest.approx(1000, rel=1e-6)
    assert pair.noise == pytest.approx((0.1, 0.05), rel=0.1)
    # Noise on the output alone leaves sqrt(0.05^2 + |h|^2 0.1^2) over the output.
    floor = np.hypot(0.05, 0.1 * np.linalg.norm(RESPONSE)) / pair.output.std()
    assert fitted.held_out["RLS"] == pytest.approx(floor, rel=0.15)
    assert np.linalg.norm(fitted.estimates["RLS"] - RESPONSE) < 0.1 * np.linalg.norm(RESPONSE)


def test_estimates_solve_the_weighted_problem_of_the_whole_fitted_part(template):
    pair, _, fitted = template
    forgetting = 1 - 1 / 640
    part = parts(len(pair.output))[0]
    rows = fir_regressors(pair.input, 24)[:, part].T
    weights = forgetting ** (np.arange(len(rows))[::-1] / 2)
    matrix, target = rows * weights[:, None], pair.output[part] * weights
    plain = np.linalg.lstsq(matrix, target, rcond=None)[0]
    assert fitted.estimates["RLS"] == pytest.approx(plain, abs=2e-3)  # the start at zero is forgotten to e^-3
    eta, name = fitted.bounds["min-max, typical bound"], "min-max, typical bound"

    # In the scaled problem |Ax - b| + eta |x| both terms are over the output's noise, so eta has the input's unit.
    def worst(x):
        return np.linalg.norm(matrix @ x - target) / pair.noise[1] + eta * np.linalg.norm(x) / pair.noise[1]

    assert worst(fitted.estimates[name]) <= minimize(worst, plain, method="BFGS").fun * (1 + 1e-7)


@pytest.mark.parametrize("band", [(0.0, 1600.0), (100.0, 1500.0), (100.0, 600.0), (400.0, 600.0)])
def test_the_typical_bound_is_the_norm_of_noise_of_the_band(band):
    """White noise with an ideal pass band, against the norm of its weighted rows."""
    rng, taps, forgetting = np.random.default_rng(4), 16, 1 - 1 / 200
    norms = []
    for _ in range(20):
        lines = np.fft.rfft(rng.standard_normal(2048))
        frequency = np.fft.rfftfreq(2048, 1 / 3200)
        lines[(frequency < band[0]) | (frequency > band[1])] = 0
        noise = np.fft.irfft(lines)
        rows = np.array([noise[t : t + taps] for t in range(1600)])
        norms.append(
            np.linalg.norm(forgetting ** (np.arange(1600)[::-1] / 2)[:, None] * rows / noise.std(), 2)
        )
    nothing = np.zeros(1)
    bound = MeasuredPair(nothing, nothing, 3200.0, band, 0.5).typical_bound(taps, forgetting)
    # 24 samples independent of one another in the narrowest band's memory: a mean of 20 is good to a few per cent
    assert 0.8 < 0.5 * np.mean(norms) / bound < 1.0
    assert (bound / (0.5 * noise_bound(1.0, taps, forgetting)) > 1.4) == (band[1] == 600.0)


def test_the_corner_says_the_same_as_all_rows(template):
    pair, *_ = template
    scaled = pair.normalised
    regressors, output = fir_regressors(scaled.input, 8)[:, :900], scaled.output[:900]
    matrix, target = weighted_corner(regressors, output, 0.99)
    assert matrix.shape == (9, 8)
    rows = regressors.T * 0.99 ** (np.arange(900)[::-1] / 2)[:, None]
    assert matrix.T @ matrix == pytest.approx(rows.T @ rows, rel=1e-9)
    last = track(regressors, output, 0.99, bound=noise_bound(1.0, 8, 0.99)).estimates[:, -1]
    assert solve_silently(matrix, target, noise_bound(1.0, 8, 0.99)).estimate == pytest.approx(last, abs=1e-7)


def test_units_scale_what_they_should(template, tmp_path):
    pair, _, fitted = template
    silent = tmp_path / "silent.csv"
    silent.write_text(TEMPLATE.read_text().replace(" (V)", "").replace(" (m/s^2)", ""))
    other, _ = open_pair(silent, units=("mV", "g"), noise=(0.1, 0.0))
    assert other.input == pytest.approx(1e-3 * pair.input, rel=1e-12)
    assert other.noise[0] == pytest.approx(1e-4) and other.units == ("V", "m/s^2")
    same, _ = open_pair(silent, units=("mV", "g"))
    again = fit_pair(same, 24, 640)
    assert again.held_out["min-max, typical bound"] == pytest.approx(
        fitted.held_out["min-max, typical bound"], rel=1e-6
    )
    assert again.estimates["RLS"] == pytest.approx(9806.65 * fitted.estimates["RLS"], rel=1e-6, abs=1e-3)


def test_the_zero_model_leaves_everything_and_the_threshold_is_where_it_begins(template):
    *_, fitted = template
    assert fitted.held_out["min-max, guaranteed bound"] == pytest.approx(1.0)
    etas = fitted.factors * fitted.bounds["min-max, typical bound"]
    assert np.all(fitted.judging[etas > fitted.threshold] == 1.0)
    assert np.all(fitted.judging[etas < 0.9 * fitted.threshold] < 1.0)
    assert fitted.chosen == fitted.factors[fitted.choosing.argmin()]
    assert residual(np.ones((3, 1)), np.ones(3), np.zeros(1)) == 1.0


def test_what_makes_a_table_misleading_is_named(template):
    pair, _, fitted = template
    assert warnings_of(pair, fitted, 24) == []
    late = replace(pair, output=np.roll(pair.output, 40))
    assert delay_of(pair) < 24 and delay_of(late) == delay_of(pair) + 40
    assert delay_of(replace(pair, input=pair.output, output=pair.input)) == -delay_of(pair)
    spoiled = pair.output.copy()
    spoiled[[500, 900]] = 40 * pair.output.std()
    assert spikes_in(spoiled) == 2 and spikes_in(np.sin(np.arange(999.0))) == 0
    edge = replace(fitted, choosing=np.arange(len(fitted.factors), dtype=float))
    near = replace(fitted, threshold=1.5 * fitted.bounds["min-max, typical bound"])
    for wrong, found, word in (
        (late, fitted, "outside the 24 taps"),
        (replace(pair, output=spoiled), fitted, "2 samples beyond"),
        (replace(pair, output=2 * pair.input), fitted, "one channel"),
        (pair, edge, "end of the range"),
        (pair, near, "half of the threshold"),
    ):
        assert sum(word in sentence for sentence in warnings_of(wrong, found, 24)) == 1, word
