"""The motion controller in C on a plant that SciPy alone simulates: moves, friction, lost samples, and a start in motion."""

import ctypes
import re
import shutil
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy import signal

from naive.moves import plan_move, run_motion
from shared.compiled import STRICT, call, compiled
from stillwork.base.checks import InputError
from stillwork.control.applications import Application
from stillwork.control.digital import (
    HELD,
    INVALID,
    SATURATED,
    DigitalController,
    anti_windup,
    error_driven,
    observed_controller,
)
from stillwork.control.discrete_observer import discrete_compensator, discrete_kalman_observer
from stillwork.control.feedforward import Feedforward, Motion, inverse_gains, modified_feedforward
from stillwork.control.pid import PidFamily
from stillwork.control.setpoint import MoveLimits
from stillwork.estimation.adaptive import FeLms, FeRls
from stillwork.estimation.observer import NoiseIntensities
from stillwork.lti.discretisation import tustin
from stillwork.lti.modal import ModalModel
from stillwork.lti.simulation import simulate
from stillwork.machine.c_code import adaptation_code, controller_code

pytestmark = pytest.mark.slow  # a compiler runs in each
SAMPLE_TIME = 1e-4
MOVING = 8
LIMITS = MoveLimits(velocity=0.2, acceleration=3.0, jerk=300.0, snap=1e5)
# 12.5 kg, and a mode at 318 Hz that the sensor sees the other way round.
SHAPES = np.array([[12.5**-0.5], [0.15]])
STAGE = ModalModel(
    np.array([0.0, 2000.0]), np.array([0.0, 0.01]), SHAPES, SHAPES.T * [[1, -1]], np.zeros((1, 1)), drag=2.0
)
PID = tustin(PidFamily(12.5)(25.0).state_space(), SAMPLE_TIME)
OBSERVER = discrete_kalman_observer(STAGE, NoiseIntensities(1.0, 1e-12), SAMPLE_TIME)
COMPENSATOR = discrete_compensator(
    OBSERVER, Application(compensate=True, damping=0.05, selectivity=2.0), "filter", 0
)
DRIVER = """
#include "axis_motion.h"
static axis_motion m;
static axis_tuning t;
static axis_move plan;
void tune(double gain, double high)
{
    t = axis_designed;
    t.gain[0] = (axis_real)gain;
    t.high[0] = (axis_real)high;
}
int enable(double position, double velocity, double force)
{
    return (int)axis_enable(&m, &t, position, velocity, (axis_real)force);
}
int go(double target)
{
    return axis_plan(&plan, &t, target - axis_rest(&m)) ? (int)axis_go(&m, &t, &plan) : -1;
}
int run(double measured, double *force)
{
    axis_real out[1];
    int flags = (int)axis_run(&m, &t, measured, out);
    *force = (double)out[0];
    return flags;
}
int finite(void)
{
    for (int i = 0; i < AXIS_STATES; i++)
        if (!(m.loop.state[i] - m.loop.state[i] == 0 && m.loop.rest[i] - m.loop.rest[i] == 0))
            return 0;
    return 1;
}
"""


def axis(motion, *, observed=True, limit=150.0, **options):
    """The controller of r and y that a design has, as one of the error."""
    model = observed_controller(PID, COMPENSATOR) if observed else None
    winding = np.vstack([np.zeros((len(COMPENSATOR.a), 1)), anti_windup(PID, 0.02)])
    if observed:
        whole = DigitalController(model, ("r (m)", "y (m)"), ("f (N)",), -limit, limit, winding, **options)
        return error_driven(whole, motion)
    return DigitalController(
        PID, ("e (m)",), ("f (N)",), -limit, limit, winding[-len(PID.a) :], motion=motion, **options
    )


class Plant:
    """The stage by SciPy's zero-order hold, its force `late` samples behind the command, with Coulomb's friction."""

    def __init__(self, late=1, coulomb=0.0, velocity=0.0):
        w, z, drag = 2000.0, 0.01, STAGE.drag
        a = [[0, 1, 0, 0], [0, -drag, 0, 0], [0, 0, 0, 1], [0, 0, -w * w, -2 * z * w]]
        b = [[0], [SHAPES[0, 0]], [0], [SHAPES[1, 0]]]
        c = [[SHAPES[0, 0], 0, -SHAPES[1, 0], 0]]
        whole = tuple(np.array(each, float) for each in (a, b, c, [[0]]))
        self.a, self.b, self.c, *_ = signal.cont2discrete(whole, SAMPLE_TIME)
        self.x = np.array([0.0, velocity / SHAPES[0, 0], 0.0, 0.0])
        self.line, self.coulomb = [0.0] * late, coulomb

    @property
    def position(self):
        return float(self.c[0] @ self.x)

    def push(self, force):
        self.line.append(force)
        acts = self.line.pop(0) - self.coulomb * np.sign(self.x[1])
        self.x = self.a @ self.x + self.b[:, 0] * acts


def built(controller, folder, precision="double"):
    library = compiled(controller_code(controller, "axis", precision), folder, DRIVER)
    library.tune.argtypes = library.enable.argtypes = [ctypes.c_double] * 3
    library.tune.argtypes = [ctypes.c_double] * 2
    library.go.argtypes = [ctypes.c_double]
    library.run.argtypes = [ctypes.c_double, ctypes.POINTER(ctypes.c_double)]
    library.tune(1.0, controller.high[0])
    return library


def follow(library, plant, samples, offset=0.0, lost=()):
    """Positions, forces and flags of the closed loop; the measurement of the samples in `lost` is missing."""
    rows, force = np.zeros((3, samples)), ctypes.c_double()
    for k in range(samples):
        position = offset + plant.position
        flags = library.run(np.nan if k in lost else position, ctypes.byref(force))
        rows[:, k] = position, force.value, flags
        plant.push(force.value)
    return rows


def moved(controller, folder, plant, distance=0.032, **options):
    """Largest error (m) of a move and afterwards, from what Python's setpoint has; and the forces and flags."""
    library = built(controller, folder)
    assert library.enable(0.0, 0.0, 0.0) == 0 and library.go(distance) == 0
    positions, forces, flags = follow(library, plant, 4000, **options)
    wanted, _ = run_motion(
        controller.motion, plan_move(distance, controller.motion.limits), 4000, SAMPLE_TIME
    )
    return np.abs(wanted - positions), forces, flags.astype(int)


# ----------------------------------------------------------------------------------------------- moves of the true plant


@pytest.mark.parametrize("observed", [False, True])
def test_feedforward_takes_a_move_of_32_mm_from_300_micrometres_to_one(tmp_path, observed):
    """The mass with the friction, then Appendix A's four gains: with an observer as without."""
    lag, series = 1.5 * SAMPLE_TIME, inverse_gains(STAGE)
    peaks = {}
    for name, gains in {
        "none": Feedforward(),
        "mass and friction": Feedforward(velocity=25.0, acceleration=12.5),
        "all": series,
    }.items():
        controller = axis(Motion(gains, lag, LIMITS), observed=observed)
        error, forces, flags = moved(controller, tmp_path / name, Plant())
        peaks[name] = error.max()
        assert error[-1] < 0.1 * error.max() and np.abs(forces).max() < 150
        assert not np.any(flags & (SATURATED | HELD | INVALID)) and flags[0] == MOVING and flags[-1] == 0
    assert peaks["none"] > 1e-4
    assert peaks["mass and friction"] < 2e-6 and peaks["all"] < 1e-8


def test_friction_is_fed_forward_in_the_direction_of_the_motion(tmp_path):
    plain = inverse_gains(STAGE)
    peaks = []
    for coulomb in (0.0, 4.0):
        gains = Feedforward(plain.velocity, plain.acceleration, plain.jerk, plain.snap, coulomb)
        controller = axis(Motion(gains, 1.5 * SAMPLE_TIME, LIMITS))
        error, *_ = moved(controller, tmp_path / str(coulomb), Plant(coulomb=4.0), distance=-0.032)
        peaks.append(error[:2000].max())
    assert peaks[1] < peaks[0] / 3


def test_the_gains_are_the_series_of_the_inverse_plant():
    gains = inverse_gains(STAGE)
    s = 1j * np.array([3.0, 6.0])
    parts = SHAPES[:, 0] ** 2 * [1, -1]
    inverse = 1 / (parts[0] / (s * (s + 2.0)) + parts[1] / (s * s + 2 * 0.01 * 2000 * s + 2000.0**2))
    found = sum(gain * s**order for order, gain in enumerate(gains.gains, 1))
    missed = np.abs(inverse - found)
    assert missed[0] < 1e-8 * np.abs(inverse[0]) and 20 < missed[1] / missed[0] < 70  # of fifth order
    with pytest.raises(InputError, match=r"^model\b"):
        inverse_gains(STAGE.modes([1]))


def test_the_controller_of_the_error_is_the_modified_feedforward_without_a_second_observer():
    """Fig. A.2: the controller of r and y, with a copy of the observer on (u0, r) that corrects the feedforward."""
    rng = np.random.default_rng(4)
    r, y, u0 = (np.cumsum(rng.standard_normal(600)) * size for size in (1e-3, 1e-3, 1.0))
    added = simulate(modified_feedforward(COMPENSATOR, PID), np.array([u0, r]))[0]
    model, x, wanted = observed_controller(PID, COMPENSATOR), 0.0, []
    x = np.zeros(len(model.a))
    for k in range(600):
        force = model.c[0] @ x + model.d[0, :2] @ [r[k], y[k]] + added[k]
        x = model.a @ x + model.b @ [r[k], y[k], force]
        wanted.append(force)
    found = axis(None, limit=np.inf).run([r - y], known=[u0])[0]
    assert found == pytest.approx(wanted, abs=1e-9 * np.abs(wanted).max())


@pytest.mark.parametrize(
    ("precision", "limits"),
    [("double", LIMITS), ("double", MoveLimits(0.2, 3.0, 300.0)), ("single", LIMITS)],
)
def test_setpoint_and_feedforward_in_c_are_those_of_python(tmp_path, limits, precision):
    """Moves that reach each limit or none, either way, one after the other, on a given record of measurements."""
    controller = axis(
        Motion(Feedforward(3.0, 12.5, 1e-3, 2e-6, 0.5), 1.5 * SAMPLE_TIME, limits), observed=False
    )
    library = built(controller, tmp_path, precision)
    assert library.enable(0.3, 0.0, 1.0) == 0
    place, force = 0.3, ctypes.c_double()
    library.run(place, ctypes.byref(force))  # at rest
    errors, known, found = [0.0], [0.0], [force.value]
    for target in (0.332, 0.331, 0.2, 0.2, 0.20001):
        assert library.go(target) == 0
        move = plan_move(target - place, limits, place)
        samples = int(np.ceil((move.duration + controller.motion.lag) / SAMPLE_TIME)) + 1
        wanted, fed = run_motion(controller.motion, move, samples, SAMPLE_TIME)
        measured = wanted - 1e-6 * np.sin(0.1 * np.arange(samples))
        for value in measured:
            library.run(value, ctypes.byref(force))
            found.append(force.value)
        errors, known, place = [*errors, *(wanted - measured)], [*known, *fed], target
    wanted = controller.run([errors], first=[1.0], known=[known])[0]
    jumps = np.abs(np.diff(known, prepend=0.0)) > 0.1  # where jerk or direction jumps a last place decides
    tolerance = 1e-9 if precision == "double" else 2e-4
    close = np.abs(wanted - found) <= tolerance * np.abs(wanted).max()
    assert np.mean(close) > 0.98 and np.all(close | jumps)


def test_a_plan_keeps_its_limits_and_is_the_integral_of_its_snap():
    rng = np.random.default_rng(8)
    for _ in range(20):
        velocity, acceleration, jerk = 10 ** rng.uniform([-2, -1, 1], [0, 1, 3])
        limits = MoveLimits(velocity, acceleration, jerk, rng.choice([np.inf, 10 ** rng.uniform(3, 6)]))
        move = plan_move(10 ** rng.uniform(-6, 0) * rng.choice([-1, 1]), limits, start=0.5)
        time = np.linspace(0, move.duration, 5001)
        rows = move.at(time)
        most = np.abs(rows).max(axis=1)[1:]
        allowed = np.array([velocity, acceleration, jerk, limits.snap])
        assert np.all(most <= allowed * (1 + 1e-9))
        assert np.max(most / allowed) > 0.999 or limits.snap == np.inf
        assert rows[0, [0, -1]] == pytest.approx([0.5, 0.5 + move.distance], abs=1e-12)
        step = time[1]
        for below, above in pairwise(rows[:4]):
            grown = np.concatenate([[0.0], np.cumsum((above[1:] + above[:-1]) / 2) * step])
            allowed = 2 * step * np.abs(np.diff(above)).sum() + 1e-9 * np.abs(below).max()
            assert np.abs(below - below[0] - grown).max() <= allowed


def braking(velocity, time):
    """Way from a velocity to rest within `LIMITS`: the end of a move that has reached it."""
    move = plan_move(velocity * 10.0, replace(LIMITS, velocity=velocity))
    rise = move.knots[-1, 0]
    assert move.at([move.duration - rise])[1:4, 0] == pytest.approx([velocity, 0.0, 0.0], abs=1e-9)
    begun, *way = move.at(move.duration - rise + np.concatenate([[0.0], time]))[0]
    return np.array(way) - begun


def test_limits_count_against_the_force_in_sum(tmp_path):
    """Mass, friction and snap stay below the limit each; in sum they are above it."""
    gains = Feedforward(velocity=100.0, acceleration=12.5, snap=2e-4, coulomb=5.0)
    each = [100.0 * 0.2, 12.5 * 3.0, 2e-4 * 1e5, 5.0]
    assert max(each) < 40.0 < sum(each)
    with pytest.raises(InputError, match=r"^limits\b.*sum to up to 82\.5.*40"):
        axis(Motion(gains, 0.0, LIMITS), limit=40.0)
    library = built(axis(Motion(gains, 0.0, LIMITS), limit=90.0), tmp_path)
    library.enable(0.0, 0.0, 0.0)
    library.tune(1.0, 40.0)
    assert library.go(0.1) == -1
    assert library.go(1e-7) == 0  # a short move stays below all of them


# ------------------------------------------------------------------------------------- a start in motion, lost samples


@pytest.mark.parametrize("observed", [False, True])
def test_it_takes_over_at_a_tenth_of_a_metre_a_second_without_a_bump(tmp_path, observed):
    controller = axis(Motion(inverse_gains(STAGE), 1.5 * SAMPLE_TIME, LIMITS), observed=observed)
    library, plant = built(controller, tmp_path), Plant(velocity=0.1)
    for _ in range(3):
        plant.push(12.5 * 2.0 * 0.1)  # the drag
    begun = plant.position
    assert library.enable(0.7 + begun, 0.1, 12.5 * 2.0 * 0.1) == 0
    positions, forces, flags = follow(library, plant, 3000, offset=0.7)
    wanted = 0.7 + begun + braking(0.1, np.arange(3000) * SAMPLE_TIME)
    assert np.abs(positions - wanted).max() < 1e-6
    assert abs(forces[0] - 2.5) < 0.01 and np.abs(np.diff(forces)).max() < 2
    assert np.abs(forces).max() < 1.2 * 12.5 * 3.0 and flags[0] == MOVING and flags[-1] == 0


def test_numbers_that_are_missing_start_nothing_and_moves_wait_for_each_other(tmp_path):
    library = built(axis(Motion(inverse_gains(STAGE), 0.0, None)), tmp_path)
    assert library.enable(np.nan, 0.0, 0.0) == library.enable(0.0, np.inf, 0.0) == INVALID
    assert library.enable(0.0, 0.0, np.nan) == library.enable(0.0, 0.1, 0.0) == INVALID  # no limits are set
    assert library.enable(0.0, 0.0, 0.0) == 0 and library.go(0.1) == -1
    library = built(axis(Motion(inverse_gains(STAGE), 0.0, LIMITS)), tmp_path / "limits")
    assert library.enable(0.0, 0.0, 0.0) == 0 and library.go(np.nan) == -1
    assert library.go(0.1) == 0 and library.go(0.2) == INVALID


def test_lost_samples_are_held_and_then_forgotten(tmp_path):
    """Ten in the middle of a move cost micrometres; more stop the output, which goes on when they are back."""
    controller = axis(Motion(inverse_gains(STAGE), 1.5 * SAMPLE_TIME, LIMITS))
    library, plant = built(controller, tmp_path), Plant()
    library.enable(0.0, 0.0, 0.0)
    library.go(0.032)
    lost = {*range(800, 810), *range(3000, 3020)}
    positions, forces, flags = follow(library, plant, 6000, lost=lost)
    flags = flags.astype(int)
    wanted, _ = run_motion(controller.motion, plan_move(0.032, LIMITS), 6000, SAMPLE_TIME)
    assert np.abs(positions - wanted)[:3000].max() < 2e-6 and abs(positions[-1] - 0.032) < 1e-8
    assert np.flatnonzero(flags & HELD).tolist() == sorted(lost)
    assert np.flatnonzero(flags & INVALID).tolist() == list(range(3010, 3020))
    assert np.ptp(forces[3010:3020]) == 0 and library.finite()


# -------------------------------------------------------------------------------------------------------- how it builds

WHOLE = """
#include <math.h>
#include <stdio.h>
#include "axis_motion.h"
int main(void)
{
    static axis_motion m;
    static axis_move plan;
    axis_tuning t = axis_designed;
    axis_real force = 0;
    unsigned all = axis_enable(&m, &t, 0.5, 0.1, 0);
    double y = 0.5;
    for (int k = 0; k < 20000; k++) {
        if (k == 5000 && axis_plan(&plan, &t, -0.2))
            all |= axis_go(&m, &t, &plan);
        all |= axis_run(&m, &t, k % 1000 < 12 ? (k % 2000 < 12 ? NAN : 1e300) : y, &force);
        y = axis_rest(&m) - 1e-9 * (double)force;
    }
    printf("%u %d", all, (int)isfinite(force));
    return 0;
}
"""


def test_it_links_from_cpp_and_the_sanitizers_find_nothing(tmp_path):
    """C compiled as C, called from C++; and all of it under the address and undefined-behaviour sanitizers."""
    files = controller_code(
        axis(Motion(inverse_gains(STAGE), 1.5 * SAMPLE_TIME, LIMITS), delay=2), "axis", "single"
    )
    for name, text in {**files, "main.cpp": WHOLE, "main.c": WHOLE}.items():
        (tmp_path / name).write_text(text)
    sources = ["axis.c", "axis_motion.c"]
    call(["gcc", "-std=c99", *STRICT, "-O1", "-c", *sources], tmp_path)
    call(["g++", "-std=c++17", "main.cpp", "axis.o", "axis_motion.o", "-o", "linked"], tmp_path)
    checks = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    call(["gcc", "-std=c99", "-g", "-O1", *checks, "main.c", *sources, "-o", "checked", "-lm"], tmp_path)
    said = [call([f"./{name}"], tmp_path) for name in ("linked", "checked")]
    assert said[0] == said[1] == f"{SATURATED | HELD | INVALID | MOVING} 1"


@pytest.mark.skipif(
    not shutil.which("cppcheck"), reason="cppcheck is not installed: apt-get install cppcheck"
)
def test_misra_rules_are_kept_but_for_the_one_that_the_guide_names(tmp_path):
    """As far as cppcheck's addon knows MISRA C:2012; macros of a header that its source does not use are for the user."""
    motion = Motion(inverse_gains(STAGE), 1.5 * SAMPLE_TIME, LIMITS)
    axis_files = controller_code(axis(motion, delay=2), "axis", "single")
    files = axis_files | adaptation_code(FeRls(1e-2), 2, 5, "rls") | adaptation_code(FeLms(1e-2), 2, 5, "lms")
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    for names in (sorted(axis_files), *([name] for name in files if name.endswith(".c"))):
        names = [name for name in names if name.endswith(".c")]
        said = call(
            ["cppcheck", "--std=c99", "--addon=misra", "--quiet", "--template={file}:{line}: {id}", *names], tmp_path,
            errors=True,
        )  # fmt: skip
        assert set(re.findall(r"misra-c2012-(\S+)", said)) <= {"2.5"}, said
