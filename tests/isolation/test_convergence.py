"""Time constants against closed forms, expected courses against simulation, and tracking of a switch."""

import numpy as np
import pytest
from scipy import signal

from experiments.isolation.floors import coloured_floor, flat_floor
from experiments.isolation.mean_convergence import mean_course
from experiments.isolation.steady import steady_state
from experiments.isolation.twin import load_twin
from notebooks.isolation.convergence import (
    Case,
    converge,
    convergence_trial,
    printed_algorithms,
    repeat_all,
    settling_times,
)
from notebooks.isolation.tracking import (
    Response,
    gain_by_trace,
    respond,
    settled,
    switch_between,
    tracking_trial,
    with_microseism,
)
from stillwork.base.checks import InputError
from workbook.studies import run_study

FITTED = load_twin("fitted").varied(platform_noise=1e-6, mains_hz=[], floor_mains=[], platform_mains=[])
FLOOR = flat_floor(80.0)
STEADY = steady_state(FITTED, FLOOR)
SETTINGS = {
    "step_size": 1e-4,
    "trace": "regressors",
    "memory_s": 10.0,
    "initial_covariance": 1.0,
    "sample_time": 2e-4,
}


@pytest.mark.parametrize("share", [0.63, 0.37])
def test_settling_time_of_a_first_order_course(share):
    time = np.arange(1, 5001) * 1e-2
    final = np.array([2.0, -0.5])
    traces = final * (1 - np.exp(-time[:, None] / np.array([4.0, 1.5])))
    expected = -np.log(share) * np.array([4.0, 1.5])
    assert settling_times(time, traces, final, share) == pytest.approx(expected, abs=0.0101)


def test_settling_time_counts_the_last_excursion():
    time = np.arange(1.0, 11.0)
    trace = np.array([0, 1, 1, 1, 1.7, 1, 1, 1, 1, 1.0])
    late = np.where(time == 10, 3.0, 1.0)
    inside = np.full(10, 0.9)
    traces = np.stack([trace, late, inside], axis=1)
    assert settling_times(time, traces, np.ones(3)).tolist() == [6.0, 10.0, 1.0]


def course_of(adaptation, duration, seed):
    return converge(FITTED, FLOOR, {"": adaptation}, duration, [seed])[0][""]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "duration"), [("FeLMS", 60.0), ("FeRLS", 30.0)])
def test_expected_course_is_the_mean_of_simulations(name, duration):
    adaptation = printed_algorithms(STEADY, **SETTINGS)[name]
    runs = [course_of(adaptation, duration, seed) for seed in range(4)]
    mean = np.mean([run.weights for run in runs], axis=0)[49::50]
    expected = mean_course(FITTED, STEADY, name, runs[0].time_s[49::50])
    # The course of FeLMS is for weights that follow slowly; its step is normalised with a noisy trace.
    assert np.abs(mean - expected).max() < (0.08 if name == "FeLMS" else 0.06)
    assert np.sqrt(np.mean((mean - expected) ** 2)) < 0.025


def test_a_short_run_is_judged_by_where_the_weights_settle():
    both = printed_algorithms(STEADY, **SETTINGS)
    options = {"twin": FITTED, "floor": FLOOR, "both": both, "duration_s": 6.0}
    final = STEADY.weights[0]
    own, given = (
        convergence_trial([np.random.default_rng(3)], **options, final=each)[0] for each in (None, final)
    )
    course = course_of(both["FeRLS"], 6.0, int(np.random.default_rng(3).integers(2**31)))
    for found, towards in ((own, course.final), (given, final)):
        for key, share in (("FeRLS tau", 0.63), ("FeRLS tau 37", 0.37)):
            assert found[key] == pytest.approx(settling_times(course.time_s, course.weights, towards, share))
        assert np.all(found["FeRLS tau 37"] >= found["FeRLS tau"])
    assert np.any(own["FeRLS tau"] != given["FeRLS tau"])


@pytest.mark.slow
def test_weights_follow_a_switch_to_the_new_optimum_and_as_expected():
    switch = switch_between(FITTED, FLOOR, coloured_floor(80.0))
    both = settled(switch, 1e-4, float(np.exp(-2e-5)))
    later, response = respond(FITTED, switch, both, 40.0, [1])[0].values()
    assert response.left()[response.time_s < 0] == pytest.approx(1, abs=0.25)
    assert response.left()[-100:].mean() == pytest.approx(0, abs=0.1)
    time = np.array([20.0, 40.0])
    expected = mean_course(FITTED, switch.end, "FeLMS", time, start=switch.start)
    left = (switch.end.weights[0] - expected) @ switch.shift / (switch.shift @ switch.shift)
    seen = [later.left()[np.argmin(np.abs(later.time_s - t))] for t in time]
    assert seen == pytest.approx(left, abs=0.15)
    assert response.settling_s() < later.settling_s()
    (found,) = tracking_trial(
        [np.random.default_rng(1)], twin=FITTED, switch=switch, both=both, duration_s=5.0
    )
    assert set(found) >= {"FeLMS all", "FeRLS w4-w6", "FeRLS noise"}
    with pytest.raises(InputError, match="'w4-w6'"):
        response.left("w4-w5")


@pytest.mark.slow
def test_a_run_that_still_leaves_the_band_at_its_end_has_not_settled():
    switch = switch_between(FITTED, FLOOR, coloured_floor(80.0))
    time = np.arange(1.0, 101.0)
    left = np.where(time <= 20, 1.0, 0.0)

    def settling(left):
        weights = switch.end.weights[0] - left[:, None] * switch.shift
        return Response(time, weights, switch).settling_s()

    assert settling(left) == 21.0
    assert settling(np.where(time == 50, -0.4, left)) == 51.0  # an overshoot
    assert settling(np.where(time == 95, 0.4, left)) == np.inf


@pytest.mark.slow
def test_cases_run_together_and_in_part_again_are_those_of_each_alone():
    cases = [
        Case("FeLMS", step_size=2e-4),
        Case("FeRLS", memory_s=20.0),
        Case("FeRLS", step_size=9.0),
        Case("FeRLS"),
    ]
    brief = {"seed": 11, "duration_s": 2.0}
    first = repeat_all(cases[:2], runs=3, **brief)
    found = repeat_all(cases, runs=10, **brief)
    twin, floor = load_twin("fitted"), flat_floor(80.0)
    steady = steady_state(twin, floor)
    for case, study in zip(cases, found, strict=True):
        adaptation = printed_algorithms(steady, **case.settings, sample_time=twin.sample_time)[case.name]
        settings = {"twin": twin, "floor": floor, "duration_s": 2.0, "final": steady.weights[0]}
        alone = run_study(convergence_trial, 10, 11, together=8, both={case.name: adaptation}, **settings)
        assert study.values.keys() == alone.values.keys() and study.runs == 10
        for quantity, values in alone.values.items():
            assert np.array_equal(study[quantity], values)
            if case in cases[:2]:
                assert np.array_equal(first[cases.index(case)][quantity], values[:3])
    assert found[2].values.keys() == found[3].values.keys() and found[2]["FeRLS tau"] is found[3]["FeRLS tau"]


def test_the_trace_of_each_sample_speeds_up_weak_directions():
    powers = np.array([0.1, 1.0, 1.0, 3.0])
    turn, _ = np.linalg.qr(np.random.default_rng(3).standard_normal((4, 4)))
    gain = gain_by_trace(turn * powers @ turn.T)
    drawn = np.random.default_rng(4).standard_normal((4, 400_000)) * np.sqrt(powers)[:, None]
    mean = (drawn**2 / np.sum(drawn**2, axis=0)).mean(axis=1)
    assert gain == pytest.approx(mean / (powers / powers.sum()), rel=0.01)
    assert gain_by_trace(np.eye(3)) == pytest.approx(np.ones(3), rel=1e-6)


@pytest.mark.parametrize("times", [100.0, 1e3, 1e4])
def test_a_microseism_is_a_peak_and_leaves_the_band_as_it_is(times):
    """Its density over the plateau's is as stated at 0.2 Hz, and from 5 Hz on the floor's own, within a twentieth."""
    slow, f = with_microseism(FLOOR, times), np.r_[0.2, np.geomspace(5, 300, 200)]
    for own, rows in zip(FLOOR.sections, slow.sections, strict=True):
        before, after = (
            np.prod(
                [
                    np.abs(signal.freqz(each[:3], each[3:], 2 * np.pi * f / FLOOR.sample_rate)[1]) ** 2
                    for each in part
                ],
                axis=0,
            )
            for part in (own, rows[len(own) :])
        )
        assert before[0] * after[0] == pytest.approx(times, rel=0.05)
        np.testing.assert_allclose(after[1:], 1.0, rtol=0.05)
