from dataclasses import replace

import numpy as np
import pytest

from experiments.fixedpoint import Noise, load_oscillator
from notebooks.fixedpoint import fair_comparison as tuning
from notebooks.fixedpoint.fair_comparison import break_even, families, prediction_trial, statements_of, tune
from stillwork.control import asin_trajectory
from workbook.studies import Study, run_study

NOISE = Noise("gaussian", 1e-4)


@pytest.fixture(scope="module")
def training():
    return asin_trajectory(duration=3.0)


def narrow(monkeypatch, cost):
    """The low pass's family, whose runs cost what `cost` makes of the controller."""
    monkeypatch.setattr(tuning, "simulate", lambda plant, controller, *_, **__: controller)
    monkeypatch.setattr(tuning, "judge", lambda controller: {"velocity": cost(controller)})
    return families()["low pass"]


def test_the_search_finds_a_minimum(monkeypatch, exact, approximate, training):
    def bowl(controller):
        strength = -controller.transformation.local_gain
        off = controller.signal_filter.bandwidth / 400, controller.kinematics.exponent / 30, strength / 0.1
        return 1.0 + sum(np.log(knob) ** 2 for knob in off)

    family = narrow(monkeypatch, bowl)
    [found] = tune(family, exact, approximate, training, NOISE, budget=256, runs=1, seed=1)
    assert found.settings["bandwidth"] == pytest.approx(400, rel=0.1)
    assert found.settings["exponent"] == pytest.approx(30, rel=0.1)
    assert found.settings["strength"] == pytest.approx(0.1, rel=0.1)
    assert found.at_edge == () and found.diverged == 0


def test_statements_of_filters_that_were_tuned_alike():
    """Three runs by hand: the Kalman filter is behind both in one; the printed settings are no worse in two."""

    def study(*errors):
        return Study(1, {"velocity": np.array(errors)})

    tuned = {
        "moving window": study(2.0, 4.0, 4.0),
        "low pass": study(1.0, 3.0, 3.0),
        "Kalman filter": study(2.5, 2.0, 3.5),
    }
    found = statements_of(tuned, study(1.0, 2.0, 3.0), study(1.0, 3.0, 2.0))
    assert found["fixedpoint.abstract.simpler-can-replace"] == pytest.approx(7 / 8)
    assert found["fixedpoint.section-4.kalman-does-not-work"][0] == pytest.approx(1 / 3)
    assert found["fixedpoint.section-2c.best-settings"][0] == pytest.approx(2 / 3)


def test_break_even_is_where_a_line_between_plants_meets_one():
    assert break_even([75.0, 125.0, 175.0, 250.0], np.array([0.5, 1.4, 0.9, 0.5])) == pytest.approx(165.0)
    assert break_even([75.0, 125.0, 175.0], np.array([0.9, 1.4, 1.2])) == 175.0


def test_on_a_linear_model_both_predictions_are_exact_and_sigma_points_follow_a_curve():
    model = load_oscillator()["approximate"]
    linear = replace(model, excitation=0.0, drag=0.0)
    settings = {"deviations": (0.3, 0.1), "progress": False}
    straight = run_study(prediction_trial, 5, 1, model=linear, **settings)
    for kind in ("mean", "covariance"):
        assert straight[f"extended_{kind}"].max() < 1e-9 and straight[f"unscented_{kind}"].max() < 1e-8
    curved = run_study(prediction_trial, 20, 1, model=model, **settings)
    assert np.median(curved["unscented_mean"]) < 0.1 * np.median(curved["extended_mean"])
    assert np.median(curved["extended_mean"]) > 1e-5
