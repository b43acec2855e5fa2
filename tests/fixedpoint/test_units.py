"""A machine with a rotary and a sliding joint: a joint in another unit, all its numbers with it, moves as before."""

import numpy as np
import pytest

from stillwork.control import (
    Controller,
    FlowTransformation,
    KinematicDesign,
    Mechanism,
    SlotineLi,
    asin_trajectory,
    simulate_adaptive,
    simulate_mechanism,
)
from stillwork.control.fixed_point_convergence import stable_range
from stillwork.control.fixed_point_linear import linear_loop
from stillwork.control.mechanism import iteration_radius
from stillwork.control.transformation import RobustTransformation
from stillwork.estimation import ExtendedKalman, LowPass, UnscentedKalman
from stillwork.estimation.coordinate_filters import MovingWindow
from stillwork.estimation.filtering import UNIT_MASS

# Parameters: the rotary joint's unit in rad over 1, moment of the beam, load on the slide, friction of both.
EXACT, BELIEVED = (0.8, 3.0, 2.0, 5.0), (0.6, 3.5, 1.5, 4.0)
FILTERS = {
    "moving window": lambda size: MovingWindow(5),
    "low pass": lambda size: LowPass(400.0),
    "unscented": lambda size: UnscentedKalman(
        UNIT_MASS, np.array([0.1, 1e-3]) * size**2, np.array([1e-2, 1e-3]) * size**2, 1e-3 * size**2
    ),
    "extended": lambda size: ExtendedKalman(
        UNIT_MASS, size, 1e-4 * size, initial_deviation=(1e-2 * size, size, 10.0 * size)
    ),
}


def polar_inertia(position, parameters, out):
    unit, beam, load = parameters[0], parameters[1], parameters[2]
    out[0, 0] = (beam + load * (1.0 + position[1]) ** 2) / unit**2
    out[1, 1] = load
    out[0, 1] = 0.0
    out[1, 0] = 0.0


def polar_bias(position, velocity, parameters, out):
    unit, load, reach = parameters[0], parameters[2], 1.0 + position[1]
    turn = velocity[0] / unit
    out[0] = (2.0 * load * reach * turn * velocity[1] + parameters[3] * turn) / unit
    out[1] = -load * reach * turn**2 + parameters[4] * velocity[1]


def polar(unit, numbers):
    return Mechanism(polar_inertia, polar_bias, 2, [unit, *numbers])


def loop_of(kind, unit):
    """Plant, controllers and trajectories, the first joint in this unit."""
    plant, model = polar(unit, EXACT), polar(unit, BELIEVED)
    sizes = np.array([unit, 1.0])
    robust = kind == "unscented"
    controllers = [
        Controller(
            FILTERS[kind](size),
            RobustTransformation(4e7 * size, -1.05, strength / 4e7 / size)
            if robust
            else FlowTransformation(-strength * 20.0 * size, 20.0 * size),
            KinematicDesign(exponent),
            model,
        )
        for size, strength, exponent in zip(sizes, (0.09, 0.05), (10.0, 14.0), strict=True)
    ]
    paths = [asin_trajectory(0.5 * unit, 0.9, 0.5, 2.0), asin_trajectory(0.2, 0.9, 0.7, 2.0)]
    return plant, controllers, paths


@pytest.mark.parametrize("kind", FILTERS)
def test_a_joint_in_thousandths_of_its_unit_moves_as_before(kind):
    noise = 1e-5 * np.random.default_rng(4).standard_normal((2, 2000))
    noise[:, 700:705] = np.nan
    found = []
    for unit in (1.0, 1000.0):
        plant, controllers, paths = loop_of(kind, unit)
        sizes = np.array([unit, 1.0])
        runs = simulate_mechanism(
            plant,
            controllers,
            paths,
            sizes[:, None] * noise,
            force_limits=np.array([6.0, 8.0]) / sizes,
            resolution=1e-6 * sizes,
        )
        assert not runs[0].cause and np.abs(runs[0].force).max() == pytest.approx(6.0 / unit)
        errors = np.array([each.position_error for each in runs]) / sizes[:, None]
        loop = linear_loop(plant, controllers, 1e-3, 0.1 * sizes, 0.2 * sizes)
        limits = stable_range(loop).limits
        gains = [each.transformation.local_gain for each in controllers]
        radii = iteration_radius(plant, controllers[0].model, 0.1 * sizes, gains), loop.radius(gains[0])
        assert radii[1] < 1 and limits[0] < gains[0] < limits[1]
        found.append((errors, (*limits, *radii)))
    found, linear = zip(*found, strict=True)
    assert linear[1] == pytest.approx(linear[0], rel=1e-6)
    size = np.abs(found[0]).max()
    assert size > 1e-4
    assert np.abs(found[1] - found[0]).max() < 1e-6 * size


def lumped_inertia(position, parameters, out):
    out[0, 0] = parameters[0]
    out[1, 1] = parameters[1]
    out[0, 1] = 0.0
    out[1, 0] = 0.0


def lumped_bias(position, velocity, parameters, out):
    out[0] = parameters[2] * velocity[0]
    out[1] = parameters[3] * velocity[1]


def test_slotine_and_li_s_law_in_another_unit():
    noise, runs = 1e-5 * np.random.default_rng(5).standard_normal((2, 2000)), []
    for unit in (1.0, 1000.0):
        force = np.array([unit, 1.0, unit, 1.0])
        exact, guess = np.array([2.8, 3.0, 2.0, 5.0]) / force**2, np.array([2.2, 3.5, 1.5, 4.0]) / force**2
        plant, model = (Mechanism(lumped_inertia, lumped_bias, 2, each) for each in (exact, guess))
        design = LowPass(400.0), KinematicDesign(8.0, order=1), model
        law = SlotineLi(*design, np.array([60.0, 40.0]) / force[:2] ** 2, 10.0 / force**4)
        _, _, paths = loop_of("low pass", unit)
        run = simulate_adaptive(plant, law, paths, force[:2, None] * noise)
        runs.append(np.array([each.position_error for each in run.coordinates]) / force[:2, None])
    assert np.abs(runs[1] - runs[0]).max() < 1e-9 * np.abs(runs[0]).max() + 1e-12
