"""Explorers draw at their published setting and away from it, labelled; the table of costs reads."""

import numpy as np
import pytest

from stillwork import figures
from stillwork.checks import InputError
from stillwork.fixedpoint import explorers
from stillwork.fixedpoint.costs import load_filter_times
from stillwork.fixedpoint.published import KALMAN, LOW_PASS

DRAWINGS = [
    (
        explorers.draw_noise_free,
        {"frequency_hz": 0.2, "sharpness": 0.98, "window_length": 12, "bandwidth": 350.0},
    ),
    (
        explorers.draw_noise_free,
        {"frequency_hz": 0.6, "sharpness": 0.1, "window_length": 20, "bandwidth": 150.0},
    ),
    (
        explorers.draw_noisy,
        {"kind": "encoder", "amplitude": 1e-3, "frequency_hz": 0.5, "integration": "explicit"},
    ),
    (explorers.draw_ranking, {"frequency_hz": 0.2, "sharpness": 0.98, "amplitude": 1e-4}),
    (explorers.draw_beliefs, {"assumed_scale": 1.0, "noise_deviation": 1e-4}),
    (explorers.draw_limit_cycle, {"gain": 1.1, "window_length": 12, "exponent": 24.0}),
    (explorers.draw_limit_cycle, {"gain": 0.1, "window_length": 3, "exponent": 4.0}),
    (explorers.draw_low_pass, {"exponent": 60.0, "bandwidth": 100.0, "strength": 0.5}),
    (explorers.draw_shift, {"frequency_hz": 0.2, "exponent": 36.0}),
]


@pytest.mark.parametrize(("draw", "settings"), DRAWINGS)
def test_explorer_draws_labelled_numbers(draw, settings):
    rows = figures.plotted(draw(**settings))
    assert len(rows) > 5
    assert not any(name.startswith(("line ", "_")) for _, name, *_ in rows)


def test_a_diverged_run_is_named_in_the_legend():
    figure = explorers.draw_low_pass(exponent=60.0, bandwidth=100.0, strength=0.5)
    (text,) = [t.get_text() for t in figure.axes[0].get_legend().get_texts()]
    assert "diverged at" in text


def test_cost_table():
    times = load_filter_times()
    assert times[LOW_PASS] > 0 and times[KALMAN] > 0


def test_missing_cost_table(tmp_path, monkeypatch):
    (tmp_path / "data").mkdir()
    monkeypatch.setenv("STILLWORK_ROOT", str(tmp_path))
    with pytest.raises(InputError, match="write it with `python benchmarks"):
        load_filter_times()


def test_motion_at_rest_is_the_semi_implicit_model(approximate):
    step, state = 1e-3, np.array([0.01, 0.002])
    acceleration = approximate.acceleration(state[1], state[0], 0.0, approximate.parameters)
    velocity = state[0] + step * acceleration
    # The quadratic and cubic terms are of the order of 1e-4 of the state here.
    expected = [velocity, state[1] + step * velocity]
    assert explorers.motion_at_rest(step) @ state == pytest.approx(expected, rel=2e-3)
