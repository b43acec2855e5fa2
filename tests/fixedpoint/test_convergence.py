"""The linear loop and its limit cycles against simulation, closed forms and python-control."""

import warnings
from dataclasses import replace

import control
import numpy as np
import pytest

from experiments.fixedpoint import added_controllers, published_controllers
from stillwork.control import (
    Controller,
    FlowTransformation,
    KinematicDesign,
    fixed_point_convergence,
    simulate,
)
from stillwork.control.fixed_point import response_gain
from stillwork.control.fixed_point_convergence import (
    describing_function,
    limit_cycles,
    random_gain,
    stable_range,
    strongest_oscillation,
)
from stillwork.control.fixed_point_linear import linear_filter, linear_loop
from stillwork.control.trajectory import Trajectory
from stillwork.control.transformation import ContractionWarning, RobustTransformation, contraction_range
from stillwork.estimation import LowPass, filter_signal
from stillwork.estimation.coordinate_filters import (
    ExtendedKalman,
    MovingWindow,
    SavitzkyGolay,
    UnscentedKalman,
)

SAMPLE_TIME = 1e-3


def at_rest(samples):
    return Trajectory(SAMPLE_TIME, np.zeros(samples), np.zeros(samples), np.zeros(samples))


@pytest.mark.parametrize(
    "signal_filter",
    [MovingWindow(), MovingWindow(3), LowPass(), SavitzkyGolay(11, 3)],
    ids=["window", "short window", "low pass", "Savitzky-Golay"],
)
def test_linear_filter_is_the_kernel(signal_filter, rng):
    z = rng.standard_normal(80)
    z[:30] = 0.0
    model = linear_filter(signal_filter, SAMPLE_TIME)
    x, expected = np.zeros(len(model.A)), []
    for value in z:
        inputs = np.array([value, 0.0])
        expected.append(model.C @ x + model.D @ inputs)
        x = model.A @ x + model.B @ inputs
    found = filter_signal(signal_filter, z)
    for row, got in enumerate((found.position, found.velocity, found.acceleration)):
        want = np.array(expected)[:, row]
        assert np.abs(got - want).max() < 1e-9 * np.abs(want).max()


@pytest.mark.parametrize("kind", ["UKF", "literal", "model", "EKF"])
def test_linear_kalman_is_the_settled_kernel(kind, models, rng):
    """On a linear plant nothing but the gain's transient separates the two."""
    linear = replace(models["approximate"], excitation=0.0, drag=0.0).plant
    signal_filter = {
        "UKF": UnscentedKalman(linear),
        "literal": UnscentedKalman(linear, literal=True),
        "model": UnscentedKalman(linear, model_acceleration=True),
        "EKF": ExtendedKalman(linear),
    }[kind]
    z, u = 1e-3 * rng.standard_normal(4000), rng.standard_normal(4000)
    model = linear_filter(signal_filter, SAMPLE_TIME)
    x, last, expected = np.zeros(len(model.A)), 0.0, []
    for value, force in zip(z, u, strict=True):
        inputs = np.array([value, last])
        expected.append(model.C @ x + model.D @ inputs)
        x = model.A @ x + model.B @ inputs
        last = force
    found, expected = filter_signal(signal_filter, z, u), np.array(expected).T
    for got, want in zip((found.position, found.velocity, found.acceleration), expected, strict=True):
        assert np.abs(got - want)[3000:].max() < 1e-6 * np.abs(want).max()


NAMES = ["moving window", "low pass", "Kalman filter", "Kalman, literal (14)", "EKF with disturbance"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("inside", "integration"), [(True, "exact"), (False, "exact"), (False, "semi-implicit")]
)
def test_stability_is_what_the_simulation_does(name, inside, integration, exact, approximate):
    """Just within the strongest stable gain a small kick decays, just beyond it grows."""
    controller = (published_controllers(approximate) | added_controllers(approximate))[name]
    strongest, _ = stable_range(linear_loop(exact, controller, SAMPLE_TIME, integration=integration)).limits
    gain = strongest * (0.97 if inside else 1.03)
    controller = replace(controller, transformation=FlowTransformation(gain * 3.0, 3.0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ContractionWarning)  # a Kalman filter's edge is near Banach's
        run = simulate(exact, controller, at_rest(8000), start=(0.0, 1e-6), integration=integration)
    rest = np.abs(run.deformed[7000:]).max()  # the kick itself moves it by 1e-4 m/s^2
    assert rest < 1e-7 if inside else rest > 2e-2


def test_open_loop_response_matches_python_control(exact, approximate):
    loop = linear_loop(exact, published_controllers(approximate)["low pass"], SAMPLE_TIME)
    peer = control.ss(loop.A, loop.B, loop.C, 0, SAMPLE_TIME)
    rates = np.array([5.0, 50.0, 500.0, 3000.0])
    assert loop.response(rates) == pytest.approx(peer(np.exp(1j * rates * SAMPLE_TIME)), rel=1e-9)


def test_without_delay_the_edge_is_banach_s(exact, approximate):
    """A low pass that settles in one sample and a slow kinematic block leave the bare iteration: -2 / f'."""
    quick = Controller(LowPass(999.0), RobustTransformation(), KinematicDesign(1.0), approximate)
    strongest, _ = stable_range(linear_loop(exact, quick, SAMPLE_TIME)).limits
    assert strongest == pytest.approx(contraction_range(response_gain(exact, approximate))[0], rel=0.01)


def test_describing_function_closed_form():
    assert describing_function(0.0) == pytest.approx(1.0)
    for x in (0.1, 0.5, 2.0, 30.0):
        if x < 1:
            integral = 2 * np.arccos(x) / np.sqrt(1 - x**2)
        else:
            integral = 2 * np.arccosh(x) / np.sqrt(x**2 - 1)
        expected = 2 / np.pi * (2 / x - np.pi / x**2 + integral / x**2)
        assert describing_function(x) == pytest.approx(expected, rel=1e-9)


def test_random_gain_is_the_mean_slope(rng):
    for deviation in (0.3, 3.0):
        x = deviation * rng.standard_normal(400_000)
        slope = 1 / (1 + np.abs(x)) ** 2
        assert random_gain(deviation) == pytest.approx(slope.mean(), abs=5 * slope.std() / 632)
    assert random_gain(0.0) == pytest.approx(1.0)


def test_predicted_limit_cycle_is_the_simulated_one(exact, approximate):
    """A describing function keeps one harmonic of three filters' worth of low pass: a per cent is its size."""
    controller = published_controllers(approximate)["moving window"]
    stable, unstable = limit_cycles(linear_loop(exact, controller, SAMPLE_TIME), controller.transformation)
    assert stable.stable and not unstable.stable
    run = simulate(exact, controller, at_rest(8000), start=(0.0, 1e-3))
    part = slice(4000, None)
    error = strongest_oscillation(run.acceleration_estimate[part] - run.desired[part], SAMPLE_TIME)
    assert error.frequency_hz == pytest.approx(stable.frequency_hz, rel=0.01)
    assert error.amplitude == pytest.approx(stable.iteration_error, rel=0.01)
    speed = strongest_oscillation(run.velocity[part], SAMPLE_TIME)
    assert speed.amplitude == pytest.approx(stable.velocity, rel=0.01)


def test_the_unstable_cycle_separates_return_from_divergence(exact, approximate):
    controller = published_controllers(approximate)["Kalman filter"]
    controller = replace(controller, transformation=FlowTransformation())
    (cycle,) = limit_cycles(linear_loop(exact, controller, SAMPLE_TIME), controller.transformation)
    assert not cycle.stable
    calm = simulate(exact, controller, at_rest(3000), start=(0.0, 0.3 * cycle.velocity))
    wild = simulate(exact, controller, at_rest(3000), start=(0.0, 4 * cycle.velocity))
    assert calm.diverged_at is None and np.abs(calm.velocity[-500:]).max() < 1e-2 * cycle.velocity
    assert wild.diverged_at is not None


def test_a_right_model_has_a_weak_edge_too(exact, approximate):
    """Both edges are those with the wrong mass times f': a gain acts by its product with the plant's response."""
    controller = replace(
        published_controllers(approximate)["low pass"], transformation=RobustTransformation()
    )
    wrong, right = (
        stable_range(linear_loop(plant, controller, SAMPLE_TIME)).limits for plant in (exact, approximate)
    )
    assert np.divide(right, wrong) == pytest.approx(np.full(2, response_gain(exact, approximate)), rel=0.02)


def test_no_stable_gain_and_no_cycle(exact, approximate):
    slow = Controller(LowPass(20.0), FlowTransformation(), KinematicDesign(36.0), approximate)
    region = stable_range(linear_loop(exact, slow, SAMPLE_TIME))
    assert np.isnan(region.limits).all() and -0.1 not in region
    assert limit_cycles(linear_loop(exact, slow, SAMPLE_TIME), slow.transformation) == []
    edge = fixed_point_convergence.Crossing(-2.0, 1.0)
    for half in (
        fixed_point_convergence.StableRange(edge, None),
        fixed_point_convergence.StableRange(None, edge),
    ):
        assert np.isnan(half.limits).all()
        assert limit_cycles(linear_loop(exact, slow, SAMPLE_TIME), slow.transformation, half) == []


@pytest.mark.parametrize("frequency_hz", [41.37, 41.0])  # lines are a third of a Hz apart
def test_strongest_oscillation_finds_a_sine_wherever_it_lies_between_lines(frequency_hz, rng):
    time = np.arange(3000) * SAMPLE_TIME
    values = 0.3 + 0.02 * np.sin(2 * np.pi * frequency_hz * time + 0.4) + 1e-4 * rng.standard_normal(3000)
    found = strongest_oscillation(values, SAMPLE_TIME)
    assert found.frequency_hz == pytest.approx(frequency_hz, abs=1e-2)
    assert found.amplitude == pytest.approx(0.02, rel=1e-2)
