"""The record track: the measured beam, what is fitted to it, and the yardsticks."""

import numpy as np
import pandas as pd
import pytest
from scipy.signal import cont2discrete, lfilter

from contest.record import (
    FILE,
    LAGS,
    LINEAR,
    RUNNING,
    TASKS,
    errors_of,
    fitted,
    linear_estimate,
    record_standings,
    record_table,
    run_of,
)


@pytest.mark.parametrize("task", TASKS)
def test_the_model_is_the_laser_again(task):
    """Simulated by SciPy's own filter from the transfer function of the fitted mode, it follows the ringing."""
    run, (model, noise, step) = run_of(task, 0), fitted(task, 0)
    omega, zeta = model.frequencies[0], model.damping[0]
    numerator, denominator, _ = cont2discrete(
        ([model.input_shapes[0, 0]], [1, 2 * zeta * omega, omega**2]), step, "zoh"
    )
    assert 8 < omega / (2 * np.pi) < 8.4
    part = slice(212, 362)
    # What it does freely is two numbers more, which least squares finds.
    forced = lfilter(numerator[0, 1:], denominator, run.voltage)[part]  # held until the sample
    free = np.array([lfilter([1.0, 0.0], denominator, np.eye(200)[k])[:150] for k in (0, 1)]).T
    left = run.laser[part] - forced
    left = left - free @ np.linalg.lstsq(free, left, rcond=None)[0]
    assert np.sqrt(np.mean(left**2)) < 0.06 * run.laser[part].std()
    assert (np.diag(noise.sensor) > 0).all()


def test_zero_has_one_and_the_truth_none():
    run = run_of("piezo alone", 1)
    assert errors_of(run, np.zeros(600)) == dict.fromkeys(("pushed", "ringing", "whole"), 1.0)
    assert errors_of(run, run.laser) == dict.fromkeys(("pushed", "ringing", "whole"), 0.0)
    assert errors_of(run, run.laser + np.inf)["whole"] == np.inf


def test_no_linear_filter_is_better_than_the_oracle_and_none_looks_ahead():
    judged, trained = run_of("piezo alone", 1), run_of("piezo alone", 0)
    oracle, other = (errors_of(judged, linear_estimate(judged, each))["whole"] for each in (judged, trained))
    assert 0 < oracle < other < 1
    later = run_of("piezo alone", 1)
    changed = type(later)(later.voltage.copy(), later.measured.copy(), later.laser)
    changed.measured[300:] += 1.0
    same, moved = (linear_estimate(each, trained) for each in (later, changed))
    assert np.array_equal(same[:300], moved[:300]) and moved[300] != same[300] and LAGS < 100


@pytest.mark.slow
def test_the_committed_table_is_of_this_code_and_whole():
    table = pd.read_csv(FILE)
    assert set(table["entrant"]) == {*RUNNING, *LINEAR} and len(table) == 2 * 6 * 2 * (len(RUNNING) + 2)
    fresh = record_table(["zero", "Kalman", "fictitious noise"])
    keys = ["task", "part", "trained", "judged", "entrant"]
    both = fresh.merge(table, on=keys)
    assert len(both) == len(fresh)
    assert both["error_x"].to_numpy() == pytest.approx(both["error_y"].to_numpy(), abs=2e-4)
    assert record_standings(fresh)["observer"].tolist()[:2] == [LINEAR[1], LINEAR[0]]
