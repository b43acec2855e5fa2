"""Explorers draw at their published setting and away from it, labelled; the table of costs reads."""

import numpy as np
import pytest

from experiments.fixedpoint import error_lines, published_controllers, run_pictures
from experiments.fixedpoint.convergence_pictures import paint_limit_cycle
from experiments.fixedpoint.noise_pictures import (
    motion_at_rest,
    paint_cost_against_error,
    paint_expected_beliefs,
)
from experiments.fixedpoint.published import KALMAN, LITERAL, LOW_PASS, WINDOW
from stillwork.base.checks import InputError
from stillwork.control import asin_trajectory, simulate
from stillwork.control.fixed_point_convergence import strongest_oscillation
from workbook import figures
from workbook.timings import measured_times

DRAWINGS = [
    (
        error_lines.paint_noise_free,
        {"frequency_hz": 0.2, "sharpness": 0.98, "window_length": 12, "bandwidth": 350.0},
    ),
    (
        error_lines.paint_noise_free,
        {"frequency_hz": 0.6, "sharpness": 0.1, "window_length": 20, "bandwidth": 150.0},
    ),
    (
        error_lines.paint_noisy,
        {"kind": "encoder", "amplitude": 1e-3, "frequency_hz": 0.5, "integration": "explicit"},
    ),
    (run_pictures.paint_ranking, {"frequency_hz": 0.2, "sharpness": 0.98, "amplitude": 1e-4}),
    (paint_expected_beliefs, {"assumed_scale": 1.0, "noise_deviation": 1e-4}),
    (paint_limit_cycle, {"gain": 1.1, "window_length": 12, "exponent": 24.0}),
    (paint_limit_cycle, {"gain": 0.1, "window_length": 3, "exponent": 4.0}),
    (error_lines.paint_low_pass, {"exponent": 60.0, "bandwidth": 100.0, "strength": 0.5}),
    (error_lines.paint_shift, {"frequency_hz": 0.2, "exponent": 36.0}),
]


@pytest.mark.parametrize(("draw", "settings"), DRAWINGS)
def test_explorer_draws_labelled_numbers(draw, settings):
    rows = figures.plotted(draw(**settings))
    assert len(rows) > 5
    assert not any(name.startswith(("line ", "_")) for _, name, *_ in rows)


def test_a_diverged_run_is_named_in_the_legend():
    figure = error_lines.paint_low_pass(exponent=60.0, bandwidth=100.0, strength=0.5)
    (text,) = [t.get_text() for t in figure.axes[0].get_legend().get_texts()]
    assert "diverged at" in text


def test_cost_table():
    times = measured_times("fixedpoint", "filter_times.csv")
    assert times[LOW_PASS]["median_ns"] > 0 and times[KALMAN]["median_ns"] > 0


def test_a_table_of_times_is_read_by_row_and_heading(tmp_path, monkeypatch):
    folder = tmp_path / "data" / "fixedpoint"
    folder.mkdir(parents=True)
    (folder / "filter_times.csv").write_text('filter,median_ns,lowest_ns,highest_ns\n"low pass",5,4,9\n')
    monkeypatch.setenv("STILLWORK_ROOT", str(tmp_path))
    numbers = {"median_ns": 5.0, "lowest_ns": 4.0, "highest_ns": 9.0}
    assert measured_times("fixedpoint", "filter_times.csv") == {"low pass": numbers}


def lines(figure, panel):
    return {line.get_label(): line.get_xydata() for line in figure.axes[panel].lines}


def test_tracking_shows_the_window_s_cycle(exact, approximate):
    """The drawn points keep the amplitude of 40 Hz: coarser ones would show another, slow motion."""
    run = simulate(
        exact,
        published_controllers(approximate)[WINDOW],
        asin_trajectory(duration=4.0),
        integration="semi-implicit",
    )
    figure = run_pictures.paint_tracking({WINDOW: run}, "velocity")
    drawn, nominal = lines(figure, 0)[WINDOW], lines(figure, 0)["nominal"]
    late = drawn[:, 0] > 2.0
    assert strongest_oscillation((drawn - nominal)[late, 1], 0.01).frequency_hz == pytest.approx(40, abs=0.5)
    stretch = lines(figure, 2)[WINDOW]
    corner = run_pictures.hardest_turn(run.trajectory)
    assert stretch[[0, -1], 0] == pytest.approx([corner - 0.15, corner + 0.15], abs=2e-3)


def test_hardest_turn():
    assert run_pictures.hardest_turn(asin_trajectory()) == pytest.approx(6.25, abs=0.01)
    assert run_pictures.hardest_turn(asin_trajectory(frequency_hz=0.5, sample_time=2e-3)) == pytest.approx(
        6.5, abs=0.01
    )


def test_one_sample_ahead_is_the_run_s_sample(exact, approximate):
    literal = published_controllers(approximate)[LITERAL]
    trajectory = asin_trajectory(sample_time=2e-3, frequency_hz=0.1)
    figure = run_pictures.paint_estimate_shift({LITERAL: simulate(exact, literal, trajectory)})
    (low, high) = lines(figure, 0)["one sample (2 ms) ahead"]
    assert (high - low)[1] / (high - low)[0] == pytest.approx(2.0)  # mm a m/s


def test_statement_map_draws_every_fraction():
    rows = figures.plotted(
        run_pictures.paint_statement_map(["a", "b"], {"x": [0.0, 1.0], "y": [0.5, 0.25]}, "setting")
    )
    assert [float(row[-1]) for row in rows if row[-1]] == [0.0, 1.0, 0.5, 0.25]


def test_missing_cost_table(tmp_path, monkeypatch):
    (tmp_path / "data").mkdir()
    monkeypatch.setenv("STILLWORK_ROOT", str(tmp_path))
    with pytest.raises(InputError, match=r"filter_times\.csv"):
        measured_times("fixedpoint", "filter_times.csv")


def test_motion_at_rest_is_the_semi_implicit_model(approximate):
    sample_time, state = 1e-3, np.array([0.01, 0.002])
    acceleration = approximate.acceleration(state[1], state[0], 0.0, approximate.parameters)
    velocity = state[0] + sample_time * acceleration
    # The quadratic and cubic terms are of the order of 1e-4 of the state here.
    expected = [velocity, state[1] + sample_time * velocity]
    assert motion_at_rest(sample_time) @ state == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("scale", [0.01, 1.0, 100.0])
def test_every_filter_stands_in_the_picture_of_costs_on_a_slow_machine_and_on_a_fast_one(scale):
    errors = {LOW_PASS: 3.5, WINDOW: 4.0, KALMAN: 2.6}
    cost = dict(zip(errors, scale * np.array([20.0, 40.0, 150.0]), strict=True))
    [axes] = paint_cost_against_error(cost, errors, "error (mm/s)").axes
    low, high = axes.get_xlim()
    assert low < min(cost.values()) and 2 * max(cost.values()) < high
