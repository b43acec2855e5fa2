import numpy as np
import pytest
from scipy.integrate import solve_ivp

from experiments.fixedpoint import Noise, added_controllers, compare, judge, published_controllers
from naive import fixedpoint as naive
from stillwork.base.checks import InputError
from stillwork.control import Controller, FlowTransformation, KinematicDesign, asin_trajectory, simulate
from stillwork.control.transformation import RobustTransformation
from stillwork.estimation import LowPass, Plant
from stillwork.estimation.coordinate_filters import MovingWindow, SavitzkyGolay
from workbook.studies import Study

SAMPLE_TIME = 1e-3


def twin_filter(controller, parameters):
    signal_filter = controller.signal_filter
    if isinstance(signal_filter, MovingWindow):
        return naive.MovingWindow(signal_filter.length, SAMPLE_TIME)
    if isinstance(signal_filter, LowPass):
        return naive.LowPass(signal_filter.bandwidth, SAMPLE_TIME, 0 if signal_filter.from_zero else 1000)
    if isinstance(signal_filter, SavitzkyGolay):
        return naive.SavitzkyGolay(signal_filter.samples, signal_filter.degree, SAMPLE_TIME)
    packed = signal_filter.packed()
    return naive.PlantUnscented(
        parameters, packed.process, packed.noise, 1e-3, SAMPLE_TIME, signal_filter.literal
    )


NAMES = [
    "moving window",
    "low pass",
    "Kalman filter",
    "Kalman, literal (14)",
    "Savitzky-Golay",
]


@pytest.mark.parametrize("integration", ["semi-implicit", "explicit"])
@pytest.mark.parametrize("name", NAMES)
def test_loop_is_its_naive_twin(name, integration, exact, approximate, short, rng):
    controller = (published_controllers(approximate) | added_controllers(approximate))[name]
    noise = 1e-5 * rng.standard_normal(len(short.position))
    run = simulate(exact, controller, short, noise, integration=integration)
    flow = isinstance(controller.transformation, FlowTransformation)
    expected = naive.closed_loop(
        twin_filter(controller, approximate.parameters),
        naive.flow(-1.1, 3.0) if flow else naive.robust(4e7, -1.05, 9e-2 / 4e7),
        controller.kinematics.gains,
        controller.signal_filter.error_from_measurement,
        exact.parameters,
        approximate.parameters,
        (short.position, short.velocity, short.acceleration),
        noise,
        SAMPLE_TIME,
        integration == "semi-implicit",
    )
    found = (run.position, run.velocity, run.acceleration, run.deformed, run.force)
    for got, want in zip(found, expected, strict=True):
        # The printed form of (8) rounds to 4e7 x 1e-16, the unscented weights cost four digits.
        assert np.abs(got - want).max() < 1e-6 * max(1.0, np.abs(want).max())


@pytest.mark.parametrize("integrals", [0, 2])
def test_any_order_of_kinematics(integrals, exact, approximate, short):
    controller = Controller(LowPass(), RobustTransformation(), KinematicDesign(16.0, integrals), approximate)
    run = simulate(exact, controller, short, resolution=1e-4, integration="semi-implicit")
    expected = naive.closed_loop(
        naive.LowPass(350.0, SAMPLE_TIME, past=1000),
        naive.robust(4e7, -1.05, 9e-2 / 4e7),
        controller.kinematics.gains,
        True,
        exact.parameters,
        approximate.parameters,
        (short.position, short.velocity, short.acceleration),
        np.zeros(len(short.position)),
        SAMPLE_TIME,
        resolution=1e-4,
    )
    assert run.position == pytest.approx(expected[0], abs=1e-7)


def van_der_pol(position, velocity, force, parameters):
    return (force - parameters[1] * position + (1.0 - position**2) * velocity) / parameters[0]


def van_der_pol_force(position, velocity, acceleration, parameters):
    return parameters[0] * acceleration + parameters[1] * position - (1.0 - position**2) * velocity


@pytest.mark.slow
@pytest.mark.parametrize("mode_hz", [1.0, 50.0, 150.0, 400.0])
def test_the_plant_moves_as_a_solver_moves_it_under_the_held_force(mode_hz):
    plant = Plant(van_der_pol, van_der_pol_force, [1.0, (2 * np.pi * mode_hz) ** 2])
    controller = Controller(LowPass(), RobustTransformation(), KinematicDesign(16.0), plant)
    push = np.random.default_rng(1).normal(size=301)
    loaded = [1.5, plant.parameters[1]]
    path = asin_trajectory(amplitude=0.05, duration=0.3)
    run = simulate(plant, controller, path, disturbance=push[: len(path.position)], change=(0.15, loaded))
    for i in range(0, 290, 7):
        parameters = plant.parameters if i < 150 else np.array(loaded)
        force = run.force[i] + push[i]
        state = solve_ivp(
            lambda t, x, force=force, p=parameters: [x[1], van_der_pol(x[0], x[1], force, p)],
            (0, SAMPLE_TIME),
            [run.position[i], run.velocity[i]],
            rtol=1e-11,
            atol=1e-14,
        ).y[:, -1]
        assert run.position[i + 1] == pytest.approx(state[0], rel=1e-7, abs=1e-11)
        assert run.velocity[i + 1] == pytest.approx(state[1], rel=1e-7, abs=1e-9)
    for given, message in (({"disturbance": [1.0]}, "disturbance"), ({"change": (0.1, [1.0])}, "change")):
        with pytest.raises(InputError, match=message):
            simulate(plant, controller, path, **given)


def test_divergence_is_reported_with_time_and_cause(exact, approximate, short):
    wild = Controller(SavitzkyGolay(40), RobustTransformation(), KinematicDesign(36.0), approximate)
    run = simulate(exact, wild, short, start=(0.0, 0.0))
    assert run.diverged_at == pytest.approx(0.1, abs=0.1)
    assert "bound of 10" in run.cause
    done = round(run.diverged_at / SAMPLE_TIME)
    assert np.isfinite(run.position[:done]).all() and np.isnan(run.position[done + 1 :]).all()
    assert all(np.isinf(value) for value in judge(run, settle=0.1).values())


def infinite_force(position, velocity, acceleration, parameters):
    return acceleration / (1.0 - 1.0 * (abs(acceleration) > 40.0))


def plain(position, velocity, force, parameters):
    return force


def test_an_infinite_force_is_reported(exact, short):
    model = Plant(plain, infinite_force, np.zeros(0))
    controller = Controller(LowPass(), RobustTransformation(), KinematicDesign(16.0), model)
    run = simulate(exact, controller, short)
    assert "force" in run.cause and "finite" in run.cause


def test_every_controller_sees_the_same_noise(exact, approximate):
    controllers = published_controllers(approximate)
    twice = {"one": controllers["low pass"], "two": controllers["low pass"]}
    found = compare(exact, twice, asin_trajectory(duration=2.2), Noise("gaussian", 1e-4), runs=3, seed=1)
    assert isinstance(found["one"], Study)
    assert (found["one"]["position"] == found["two"]["position"]).all()
    assert len(set(found["one"]["position"])) == 3


def test_judge_by_hand(exact, approximate, short):
    run = simulate(exact, published_controllers(approximate)["Kalman filter"], short)
    numbers = judge(run, settle=0.3)
    error = short.position[300:] - run.position[300:]
    assert numbers["position"] == pytest.approx(np.sqrt(np.mean(error**2)))
    assert numbers["roughness"] == pytest.approx(np.sqrt(np.mean(np.diff(run.acceleration[300:]) ** 2)))
    literal = simulate(exact, published_controllers(approximate)["Kalman, literal (14)"], short)
    numbers = judge(literal, settle=0.3)
    assert numbers["position_shift"] == pytest.approx(SAMPLE_TIME, rel=0.05)
    # A straight line through the origin, over means of 50 samples.
    means = np.array([literal.velocity_estimate - literal.velocity, literal.deformed])[:, 300:]
    error, believed = means.reshape(2, -1, 50).mean(axis=2)
    (slope,), *_ = np.linalg.lstsq(believed[:, None], error)
    assert numbers["velocity_shift"] == pytest.approx(slope)


def test_an_encoder_in_the_loop_sees_its_own_lines(exact, approximate, short):
    run = simulate(exact, published_controllers(approximate)["low pass"], short, resolution=1e-3, grid=3e-4)
    lines = (run.measured - 3e-4) / 1e-3
    assert lines == pytest.approx(np.round(lines), abs=1e-9)
    assert np.abs(run.measured - run.position).max() <= 0.5e-3 + 1e-12
