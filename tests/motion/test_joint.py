"""The joint design: its loops, scan and noise against simulation and python-control alone, its search against brute force."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg, signal

from experiments.motion.machines import stage
from naive import joint
from notebooks.motion.joint_design import (
    LEFT,
    SAMPLE_TIME,
    JointDesign,
    Problem,
    block,
    grid_of,
    judge,
    loops,
    noise_floor,
    sample_plants,
    scan,
    search,
    stored_designs,
    transform,
)
from stillwork.control.loops import closed_loop
from stillwork.lti.discretisation import tustin, zoh
from workbook import paths

ODD = replace(
    JointDesign(),
    bandwidth_hz=50.0,
    process=3.0,
    noise_model=50.0,
    damping=(0.03, 0.04, 0.05),
    selectivity=(1.5, 2.0, 3.0),
)
STORED = stored_designs()


@pytest.mark.parametrize("delay", [0.0, 1.0, 1.5, 2.0])
def test_what_a_step_leaves_is_that_of_the_simulated_loop(delay):
    """State space, sample by sample; its force acts as late as a command and its wraparound is none."""
    plant = loops(ODD, stage(), delay)[4].sampled_plant
    controller = tustin(ODD.controller.state_space(), SAMPLE_TIME)
    loop = closed_loop(plant, block(ODD, 4, delay), controller)
    model = (loop.a, loop.b[:, [2]], loop.c[:1], loop.d[:1, [2]], SAMPLE_TIME)
    step = signal.dlsim(model, np.ones(2500))[1][:, 0]
    found = scan(ODD, grid_of(stage(), transform(), delay), delay)
    moved = np.interp(np.arange(2490) + delay, np.arange(2500), step)
    np.testing.assert_allclose(found.step[:2490], moved, atol=2e-9)
    assert found.left == pytest.approx(np.sqrt(np.mean(step[LEFT] ** 2)), rel=0.02)


def test_the_search_for_one_number_ends_where_all_tried_ones_are_best():
    slow = replace(ODD, bandwidth_hz=30.0)
    found = search(Problem(slow, ("bandwidth_hz",), [stage()], limit=2.2))
    problem, tried = Problem(slow, ("bandwidth_hz",), [stage()], limit=2.2), {}
    for hertz in np.arange(30.0, 90.0, 0.5):
        error, excess = problem.ask(replace(slow, bandwidth_hz=hertz))
        if excess.max() <= 0 and judge(replace(slow, bandwidth_hz=hertz), [stage()]).stable[0]:
            tried[hertz] = np.exp(error)
    assert found.excess < 1e-3
    assert found.error == pytest.approx(min(tried.values()), rel=5e-3)


@pytest.mark.slow
def test_noise_floor_is_what_all_measurements_together_leave_unknown():
    """Conditional variance in the joint Gaussian of all positions and measurements: no recursion, no Riccati equation."""
    measured, plant = 1000, zoh(stage().at([0], [4]).state_space(), SAMPLE_TIME)
    pulses, state = np.zeros(measured + 2), plant.b[:, 0]
    for k in range(1, len(pulses)):
        pulses[k], state = plant.c[0] @ state, plant.a @ state
    moved = 0.01 * linalg.toeplitz(pulses, np.zeros(len(pulses)))  # by the force of every sample, 10 mN each
    covariance = 1e18 * moved @ moved.T
    seen = covariance[:measured, :measured] + 2.0 * np.eye(measured)  # nm^2: v and d
    cross = covariance[-1, :measured]
    unknown = covariance[-1, -1] - cross @ linalg.solve(seen, cross, assume_a="pos") + 1.0  # and v
    assert 1e9 * noise_floor(stage()) == pytest.approx(np.sqrt(unknown), rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", STORED)
def test_python_control_agrees_with_every_stored_design(name):
    """Poles, peaks and scan error without a line of the toolbox, at all masses: the numbers of the files go in."""
    machines = tomllib.loads((paths.data("motion") / "machines.toml").read_text())
    designs = tomllib.loads((paths.data("motion") / "joint.toml").read_text())
    assert set(designs) == set(STORED)
    radius, peak, error = joint.check(machines, designs[name])
    found = judge(STORED[name].design, [stage()])
    assert found.stable[0] and radius < 1
    # Python-control's peaks are met to 0.0003 dB, see there.
    assert peak == pytest.approx(found.peaks.max(), abs=5e-4)
    # The transform repeats after 1.6 s, when the slowest pole (0.9998 a sample) has not forgotten its last 4 %.
    assert error == pytest.approx(1e9 * found.error[0], rel=5e-3)


@pytest.mark.parametrize("name", STORED)
def test_stored_designs_keep_what_they_say(name):
    stored = STORED[name]
    found = judge(stored.design, [stage(), *sample_plants(stored.size, 3 if stored.size else 0, 5)])
    assert found.stable.all() if name.startswith("joint") else found.stable[0]
    assert found.feasible[0] or not stored.ends
    assert found.left[0] <= 1.01 * stored.left or not stored.left
