"""Explorers draw at their published setting and away from it, labelled; the table of costs reads."""

import numpy as np
import pytest

from experiments.fixedpoint.noise_pictures import (
    motion_at_rest,
)
from stillwork.base.checks import InputError
from workbook.timings import measured_times


def test_a_table_of_times_is_read_by_row_and_heading(tmp_path, monkeypatch):
    folder = tmp_path / "data" / "fixedpoint"
    folder.mkdir(parents=True)
    (folder / "filter_times.csv").write_text('filter,median_ns,lowest_ns,highest_ns\n"low pass",5,4,9\n')
    monkeypatch.setenv("STILLWORK_ROOT", str(tmp_path))
    numbers = {"median_ns": 5.0, "lowest_ns": 4.0, "highest_ns": 9.0}
    assert measured_times("fixedpoint", "filter_times.csv") == {"low pass": numbers}


def lines(figure, panel):
    return {line.get_label(): line.get_xydata() for line in figure.axes[panel].lines}


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
