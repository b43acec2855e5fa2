import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from naive import fixedpoint as naive
from stillwork.control import Controller, FlowTransformation, KinematicDesign, simulate
from stillwork.control.fixed_point import response_gain
from stillwork.control.fixed_point_convergence import iterate
from stillwork.control.trajectory import sine_trajectory
from stillwork.control.transformation import (
    ContractionWarning,
    RobustTransformation,
    contraction_range,
    deform,
)
from stillwork.estimation import LowPass

NUMBERS = st.floats(-1e3, 1e3)


@given(NUMBERS, NUMBERS, NUMBERS)
def test_twins(previous, response, desired):
    assert deform(FlowTransformation(), previous, response, desired) == pytest.approx(
        naive.flow(-1.1, 3.0)(previous, response, desired), rel=1e-12, abs=1e-12
    )
    # The printed form of (8) adds and subtracts 4e7: it has an accuracy of 1e-7 m/s^2 only.
    assert deform(RobustTransformation(), previous, response, desired) == pytest.approx(
        naive.robust(4e7, -1.05, 9e-2 / 4e7)(previous, response, desired), abs=1e-7
    )


@given(NUMBERS, NUMBERS)
def test_the_desired_response_is_the_fixed_point(previous, desired):
    for transformation in (FlowTransformation(), RobustTransformation()):
        assert deform(transformation, previous, desired, desired) == previous


@given(st.floats(0.2, 4.0), st.floats(0.05, 0.95), st.floats(-50, 50))
def test_contraction_inside_the_range(gain, place, desired):
    low, high = contraction_range(gain)
    inside = FlowTransformation(gain=3.0 * (low + place * (high - low)), width=3.0)
    # Far away a step is at most 3 x 0.05 x 2 / gain, of 40 at the gain of 4: 530 steps, then 140 at a rate of 0.9.
    found = iterate(inside, desired, 1000, response_gain=gain, start=desired + 1.0)
    assert gain * found[-1] == pytest.approx(desired, abs=1e-6)


def test_no_contraction_outside_the_range():
    low, _ = contraction_range(1.0)
    found = iterate(FlowTransformation(gain=3.0 * 1.2 * low), 0.0, 500, start=1.0)
    assert abs(found[-1]) > 0.1  # a cycle of two
    assert found[-1] == pytest.approx(-found[-2], rel=1e-6)
    with np.errstate(over="ignore"):
        assert abs(iterate(RobustTransformation(slope=1e-5), 0.0, 50, start=1.0)[-1]) > 1e5


def test_multiplier_near_the_fixed_point():
    for transformation in (FlowTransformation(), RobustTransformation()):
        errors = iterate(transformation, 2.0, 3, response_gain=4 / 3, start=2.0 * 3 / 4 + 1e-5) - 1.5
        assert errors[1] / errors[0] == pytest.approx(1 + transformation.local_gain * 4 / 3, abs=1e-4)


def test_a_gain_outside_the_range_warns_with_the_range(exact, approximate):
    assert response_gain(exact, approximate) == pytest.approx(2.0 / 1.5)
    strong = Controller(LowPass(), FlowTransformation(gain=-6.0), KinematicDesign(16.0), approximate)
    with pytest.warns(ContractionWarning, match=r"-2\b.*\(-1\.5, 0\)"):
        simulate(exact, strong, sine_trajectory(duration=0.05))
    wrong_sign = Controller(LowPass(), FlowTransformation(gain=1.1), KinematicDesign(16.0), approximate)
    with pytest.warns(ContractionWarning):
        simulate(exact, wrong_sign, sine_trajectory(duration=0.05))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        good = Controller(LowPass(), RobustTransformation(), KinematicDesign(16.0), approximate)
        simulate(exact, good, sine_trajectory(duration=0.05))
