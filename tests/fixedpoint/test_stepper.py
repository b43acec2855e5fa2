"""One sample at a time, in Python and in C, against the simulation: on the oscillator and on the arm."""

import ctypes

import numpy as np
import pytest

from notebooks.fixedpoint.your_plant import load_models
from shared.compiled import compiled, pointer
from stillwork.base.checks import InputError
from stillwork.control import (
    Controller,
    FixedPointStepper,
    FlowTransformation,
    JointKalman,
    KinematicDesign,
    asin_trajectory,
    fixed_point_code,
    simulate,
    simulate_mechanism,
)
from stillwork.control.transformation import RobustTransformation
from stillwork.estimation import ExtendedKalman, LowPass, Plant, UnscentedKalman
from stillwork.estimation.coordinate_filters import MovingWindow, SavitzkyGolay
from stillwork.estimation.filtering import UNIT_MASS

DT = 1e-3
OSCILLATOR = """
static real rest(real q, real v, const real *p)
{
    return p[1] * q - p[3] * (p[2] * p[2] - q * q) * v + p[4] * v + p[5] * (v < 0 ? -v : v) * v;
}
void c_model_force(const real *q, const real *v, const real *a, const real *p, real *f) { f[0] = p[0] * a[0] + rest(q[0], v[0], p); }
void c_model_acceleration(const real *q, const real *v, const real *f, const real *p, real *a) { a[0] = (f[0] - rest(q[0], v[0], p)) / p[0]; }
real c_believed_acceleration(real q, real v, real f, const real *p) { return (f - rest(q, v, p)) / p[0]; }
"""
ARM = """
#include <math.h>
static void parts(const real *q, const real *v, const real *p, real m[3], real h[2])
{
    const real reach = p[3] * p[5] * cos(q[1]), s = p[4] * p[3] * p[5] * sin(q[1]);
    const real weight = p[7] * p[4] * p[5] * cos(q[0] + q[1]);
    int j;
    m[0] = p[0] * p[1] * p[1] + p[4] * (p[3] * p[3] + p[5] * p[5] + 2 * reach) + p[2] + p[6];
    m[1] = p[4] * (p[5] * p[5] + reach) + p[6];
    m[2] = p[4] * p[5] * p[5] + p[6];
    h[0] = -s * v[1] * (2 * v[0] + v[1]) + weight + p[7] * (p[0] * p[1] + p[4] * p[3]) * cos(q[0]);
    h[1] = s * v[0] * v[0] + weight;
    for (j = 0; j < 2; j++) h[j] += p[8 + j] * v[j] + p[10 + j] * tanh(v[j] / p[12]);
}
void c_model_force(const real *q, const real *v, const real *a, const real *p, real *f)
{
    real m[3], h[2];
    parts(q, v, p, m, h);
    f[0] = m[0] * a[0] + m[1] * a[1] + h[0];
    f[1] = m[1] * a[0] + m[2] * a[1] + h[1];
}
void c_model_acceleration(const real *q, const real *v, const real *f, const real *p, real *a)
{
    real m[3], h[2], d;
    parts(q, v, p, m, h);
    d = m[0] * m[2] - m[1] * m[1];
    a[0] = (m[2] * (f[0] - h[0]) - m[1] * (f[1] - h[1])) / d;
    a[1] = (m[0] * (f[1] - h[1]) - m[1] * (f[0] - h[0])) / d;
}
"""
DRIVER = """
#include "c.h"
typedef c_real real;
%s
int run(long samples, real *nominal, const real *measured, const real *start, real *force)
{
    c_state s;
    unsigned flags = 0u;
    c_start(&s, start, start + C_COORDINATES);
    for (long k = 0; k < samples; k++)
        flags |= c_step(&s, &c_designed, (real(*)[C_COORDINATES])(nominal + 3 * C_COORDINATES * k),
                        measured + C_COORDINATES * k, force + C_COORDINATES * k);
    return (int)flags;
}
"""
FILTERS = {
    "window": lambda model: MovingWindow(5),
    "low pass": lambda model: LowPass(400.0),
    "low pass from zero": lambda model: LowPass(400.0, from_zero=True),
    "unscented": lambda model: UnscentedKalman(model),
    "unscented, model's acceleration": lambda model: UnscentedKalman(model, model_acceleration=True),
    "extended": lambda model: ExtendedKalman(model),
    "Savitzky-Golay": lambda model: SavitzkyGolay(9),
}
WAYS = [
    ("predict", None),
    ("hold", None),
    ("predict", 0.7),
]  # what a lost sample does, share of the largest force


def in_c(controller, folder, model, nominal, measured, limits, lost, precision="double"):
    files = fixed_point_code(controller, DT, "c", precision, force_limits=limits, lost=lost)
    library = compiled(files, folder, DRIVER % model)
    dtype = np.float64 if precision == "double" else np.float32
    given = [np.ascontiguousarray(each, dtype) for each in (nominal, measured, nominal[0, :2])]
    force = np.zeros(given[1].shape, dtype)
    flags = library.run(ctypes.c_long(len(force)), *map(pointer, given), pointer(force))
    assert flags == 2 + (limits is not None)
    return force


def stepped(controller, nominal, measured, limits, lost):
    stepper = FixedPointStepper(controller, DT, force_limits=limits, lost=lost)
    return np.array([stepper.step(*each) for each in zip(nominal, measured, strict=True)])


def lost_noise(shape, size):
    rng = np.random.default_rng(3)
    noise = size * rng.standard_normal(shape)
    noise[..., 100:] = np.where(rng.random(noise[..., 100:].shape) < 0.05, np.nan, noise[..., 100:])
    return noise


@pytest.mark.parametrize(("lost", "share"), WAYS)
@pytest.mark.parametrize("name", FILTERS)
def test_the_oscillator(name, lost, share, exact, approximate, short, tmp_path):
    design = KinematicDesign(10.0), approximate
    controller = Controller(FILTERS[name](approximate), RobustTransformation(), *design)
    noise = lost_noise(short.position.shape, 1e-6)
    limit = None
    if share:
        limit = share * np.abs(simulate(exact, controller, short, noise, lost=lost).force).max()
    run = simulate(exact, controller, short, noise, lost=lost, force_limit=limit)
    assert not run.cause and (limit is None or np.abs(run.force).max() == limit)
    nominal = np.array([short.position, short.velocity, short.acceleration]).T[:, :, None]
    measured, limits = (run.position + noise)[:, None], None if limit is None else [float(limit)]
    found = stepped(controller, nominal, measured, limits, lost)[:, 0]
    size = np.abs(run.force).max()
    assert (
        np.abs(found - run.force).max() < 1e-7 * size
    )  # the unscented weights cost four digits, a quotient three
    if name != "Savitzky-Golay":
        in_double = in_c(controller, tmp_path, OSCILLATOR, nominal, measured, limits, lost)[:, 0]
        assert np.abs(in_double - found).max() < 1e-6 * size


# Of each joint one of its own numbers; one filter of both is not written in C.
OF_JOINTS = {
    "low pass": lambda model: [LowPass(300.0), LowPass(450.0)],
    "unscented": lambda model: [
        UnscentedKalman(UNIT_MASS, np.array([0.1, 1e-3]) * size, np.array([1e-2, 1e-3]) * size, 1e-3 * size)
        for size in (1.0, 0.5)
    ],
    "extended": lambda model: [
        ExtendedKalman(UNIT_MASS, step, noise, 1e-3 * step, (1e-2 * step, step, 10.0 * step))
        for step, noise in ((1.0, 1e-4), (2.0, 3e-4))
    ],
    "of both": lambda model: [JointKalman(model, np.array([1.0, 2.0]), np.array([1e-4, 3e-4]))] * 2,
}


@pytest.mark.parametrize("limited", [False, True])
@pytest.mark.parametrize("kind", OF_JOINTS)
def test_the_arm(kind, limited, tmp_path):
    arm = load_models("arm.py")
    paths = [asin_trajectory(each, 0.9, frequency_hz=0.5, duration=0.5) for each in (0.3, 0.2)]
    controllers = [
        Controller(device, FlowTransformation(gain, 10.0), KinematicDesign(each), arm.approximate)
        for device, gain, each in zip(
            OF_JOINTS[kind](arm.approximate), (-0.1, -0.15), (8.0, 12.0), strict=True
        )
    ]
    noise = lost_noise((2, len(paths[0].position)), 1e-6)
    limits = [20.0, 6.0] if limited else None
    runs = simulate_mechanism(arm.exact, controllers, paths, noise, force_limits=limits)
    assert not runs[0].cause
    nominal = np.array([[each.position, each.velocity, each.acceleration] for each in paths]).transpose(
        2, 1, 0
    )
    measured = np.array([run.position for run in runs]).T + noise.T
    found = stepped(controllers, nominal, measured, limits, "predict")
    expected = np.array([run.force for run in runs]).T
    assert not limited or np.any(np.abs(expected) == limits)
    assert np.abs(found - expected).max() < 1e-7 * np.abs(expected).max()
    if kind == "of both":
        return
    in_double = in_c(controllers, tmp_path, ARM, nominal, measured, limits, "predict")
    assert np.abs(in_double - found).max() < 1e-6 * np.abs(expected).max()


@pytest.mark.parametrize("name", [each for each in FILTERS if each != "Savitzky-Golay"])
def test_single_precision_keeps_what_its_numbers_can(name, exact, approximate, short, tmp_path):
    design = FlowTransformation(), KinematicDesign(10.0), approximate
    run = simulate(exact, Controller(LowPass(100.0), *design), short)  # one motion for all filters
    nominal = np.array([short.position, short.velocity, short.acceleration]).T[:, :, None]
    measured = run.position[:, None].copy()
    measured[300] = np.nan
    controller = Controller(FILTERS[name](approximate), *design)
    in_double = in_c(controller, tmp_path, OSCILLATOR, nominal, measured, None, "hold")
    (tmp_path / "single").mkdir()
    single = in_c(controller, tmp_path / "single", OSCILLATOR, nominal, measured, None, "hold", "single")
    assert np.abs(single - in_double).max() < 3e-4 * np.abs(in_double).max()


def test_what_cannot_be_stepped_leaves_everything_as_it_was(approximate):
    controller = Controller(LowPass(), FlowTransformation(), KinematicDesign(10.0), approximate)
    stepper = FixedPointStepper(controller, DT, [[0.0], [0.0]])
    wanted = [[0.0], [0.0], [1.0]]
    with pytest.raises(InputError, match=r"^measured is NaN at the first"):
        stepper.step(wanted, [np.nan])
    stepper.step(wanted, [0.0])
    before = stepper.estimate, stepper.deformed, stepper.samples
    for bad in ([[1e308], [1e308], [1e308]], [[0.0], [0.0]]):
        with pytest.raises(InputError):
            stepper.step(bad, [0.0])
    after = stepper.estimate, stepper.deformed, stepper.samples
    assert all(np.array_equal(one, two) for one, two in zip(before, after, strict=True))
    with pytest.raises(InputError, match=r"^force_limits"):
        FixedPointStepper(controller, DT, force_limits=[-1.0])
    for filters, message in (
        (SavitzkyGolay(), "Savitzky"),
        (UnscentedKalman(approximate, literal=True), "literal"),
    ):
        with pytest.raises(InputError, match=message):
            fixed_point_code(
                Controller(filters, FlowTransformation(), KinematicDesign(10.0), approximate), DT, "c"
            )


def test_a_limited_force_that_gives_no_acceleration_leaves_everything_as_it_was(tmp_path):
    slide = Plant(lambda q, v, f, p: f / p[0] if q < 1.0 else np.nan, lambda q, v, a, p: p[0] * a, [2.0])
    controller = Controller(LowPass(), FlowTransformation(), KinematicDesign(10.0), slide)
    nominal, measured = np.repeat([[[0.0], [0.0], [1.0]]], 2, axis=0), np.array([[0.0], [2.0]])
    stepper = FixedPointStepper(controller, DT, force_limits=[0.5])
    assert stepper.step(nominal[0], measured[0]) == 0.5
    before = stepper.deformed
    with pytest.raises(InputError, match="acceleration under the limited force"):
        stepper.step(nominal[1], measured[1])
    assert before == stepper.deformed == 0.25
    model = """
void c_model_force(const real *q, const real *v, const real *a, const real *p, real *f) { (void)q; (void)v; f[0] = p[0] * a[0]; }
void c_model_acceleration(const real *q, const real *v, const real *f, const real *p, real *a) { (void)v; a[0] = q[0] < 1 ? f[0] / p[0] : 0.0 / 0.0; }
"""
    library = compiled(fixed_point_code(controller, DT, "c", force_limits=[0.5]), tmp_path, DRIVER % model)
    force = np.zeros((2, 1))
    given = [np.ascontiguousarray(each) for each in (nominal, measured, nominal[0, :2])]
    assert (
        library.run(ctypes.c_long(2), *map(pointer, given), pointer(force)) == 1 + 4
    )  # limited, then invalid
    assert np.all(force == 0.5)
