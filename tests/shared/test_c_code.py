"""Controllers in C against the same in Python, over long records, at limits, late, and started in mid-motion."""

import ctypes

import numpy as np
import pytest

from shared.compiled import compiled, pointer, run_controller
from stillwork.control.applications import Application
from stillwork.control.digital import (
    HELD,
    INVALID,
    SATURATED,
    DigitalController,
    anti_windup,
    observed_controller,
)
from stillwork.control.discrete_observer import discrete_compensator, discrete_kalman_observer
from stillwork.control.pid import Notch, Pid
from stillwork.estimation.adaptive import FeLms, FeRls
from stillwork.estimation.observer import NoiseIntensities
from stillwork.estimation.online import adapt
from stillwork.estimation.recursive_least_squares import RecursiveLeastSquares
from stillwork.lti.delays import delayed
from stillwork.lti.discretisation import tustin
from stillwork.lti.modal import ModalModel
from stillwork.lti.simulation import simulate
from stillwork.lti.state_space import StateModel
from stillwork.machine.c_code import adaptation_code, controller_code, least_squares_code

SAMPLES = 20_000
SAMPLE_TIME = 1e-4
EPS = 2.0**-24  # half a unit in the last place of single precision


def pid(gain=1e4):
    controller = Pid(
        gain, 2 * np.pi * 2, 2 * np.pi * 20, 2 * np.pi * 200, notches=(Notch(2 * np.pi * 300.0),)
    )
    return tustin(controller.state_space(), SAMPLE_TIME)


def observing():
    """(r, y), then what acts, to the command: a PID behind measurement compensation and active damping."""
    shapes = np.array([[0.3], [0.3]])
    stage = ModalModel(
        np.array([0.0, 2000.0]), np.array([0.0, 0.01]), shapes, shapes.T * [[1, -1]], np.zeros((1, 1))
    )
    observer = discrete_kalman_observer(stage, NoiseIntensities(1.0, 1e-12), SAMPLE_TIME)
    application = Application(compensate=True, damping=0.05, selectivity=2.0)
    return observed_controller(pid(), discrete_compensator(observer, application, "filter", 0))


def turning():
    a, b = np.array([[0.9, 0.2], [-0.2, 0.9]]), np.array([[1.0, 0.0], [0.5, 1.0]])
    return StateModel(
        a, b, np.array([[1.0, 2.0], [0.0, 1.0]]), np.array([[0.0, 1.0], [2.0, 0.0]]), SAMPLE_TIME
    )


def noise(rows, seed=1, samples=SAMPLES):
    return np.random.default_rng(seed).standard_normal((rows, samples))


CONTROLLERS = {
    "PID with a notch": (pid(), 1),
    "observer in the loop": (observing(), 2),
    "late and of two outputs": (delayed(turning(), 3), 2),
    "a gain": (
        StateModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[2.5]]), SAMPLE_TIME),
        1,
    ),
}


def named(model, inputs, **options):
    return DigitalController(
        model,
        tuple(f"in {k} (m)" for k in range(inputs)),
        tuple(f"out {k} (N)" for k in range(len(model.c))),
        **options,
    )


@pytest.mark.slow
@pytest.mark.parametrize("which", CONTROLLERS)
def test_double_precision_gives_what_python_gives(tmp_path, which):
    controller = named(*CONTROLLERS[which])
    inputs = 1e-6 * noise(len(controller.inputs))
    found = run_controller(
        controller_code(controller, "loop"), tmp_path, inputs, len(controller.outputs), np.float64
    )
    wanted = simulate(controller.linear, inputs)
    assert np.abs(found - wanted).max() < 1e-9 * np.abs(wanted).max()


def rounding_bound(controller, inputs):
    """Bound on the error of single precision at each sample, to first order in the rounding unit.

    What a sample adds to a state is a sum of products: with as many terms as the row has, its error is at most
    terms + 1 units of the sum of magnitudes, the rounding of each coefficient and of the input included (Higham,
    Accuracy and Stability of Numerical Algorithms, 2002, (3.5)). The sum over samples is compensated: 2 units of the
    change and 2 eps^2 of the state (ibid., (4.8)). From there the error moves as the loop does; at worst all signs of
    its impulse response meet.
    """
    model, whole, n = controller.model, controller.linear, len(controller.model.a)
    states, x = np.empty((SAMPLES, n)), np.zeros(n)
    for k in range(SAMPLES):
        states[k] = x
        x = whole.a @ x + whole.b @ inputs[:, k]
    sizes, given = np.abs(states), np.abs(inputs.T)
    out = sizes @ np.abs(model.c[0]) + given @ np.abs(whole.d[0])
    out_error = EPS * (n + whole.d.shape[1] + 2) * out
    change = np.abs(model.a - np.diag((np.diag(model.a) > 0.5).astype(float)))
    terms = np.count_nonzero(change, axis=1) + np.count_nonzero(model.b, axis=1)
    fed = np.abs(model.b)
    moved = sizes @ change.T + np.hstack([given, out[:, None]])[:, : fed.shape[1]] @ fed.T
    added = EPS * (terms + 4) * moved + 2 * EPS**2 * sizes
    if controller.fed_back:
        added += out_error[:, None] * fed[:, -1]
    response, row = np.empty((SAMPLES, n)), model.c[0]
    for k in range(SAMPLES):
        response[k] = np.abs(row)
        row = row @ whole.a
    size = 2 * SAMPLES
    spread = np.fft.irfft(
        np.fft.rfft(response, size, axis=0) * np.fft.rfft(added, size, axis=0), size, axis=0
    )
    return np.concatenate([[0.0], spread[: SAMPLES - 1].sum(axis=1)]) + out_error


@pytest.mark.slow
@pytest.mark.parametrize("which", ["PID with a notch", "observer in the loop"])
def test_single_precision_stays_within_its_rounding(tmp_path, which):
    controller = named(*CONTROLLERS[which])
    inputs = 1e-6 * noise(len(controller.inputs), 2).astype(np.float32).astype(float)
    found = run_controller(controller_code(controller, "loop", "single"), tmp_path, inputs, 1, np.float32)
    wanted, bound = simulate(controller.linear, inputs)[0], rounding_bound(controller, inputs)
    assert np.all(np.abs(found[0] - wanted) <= bound)
    assert bound.max() < 1e-3 * np.abs(wanted).max()  # a bound that says something


@pytest.mark.slow
def test_an_integrator_in_single_precision_takes_in_steps_below_its_last_place(tmp_path):
    """A held input of 1 beside 1e8 of state: a plain sum would stay where it is."""
    model = StateModel(np.eye(1), np.array([[1.0]]), np.array([[1.0]]), np.zeros((1, 1)), SAMPLE_TIME)
    controller = named(model, 1)
    inputs = np.ones((1, SAMPLES))
    code = controller_code(controller, "sum", "single")
    found = run_controller(code, tmp_path, inputs, 1, np.float32, first=[1e8])
    assert found[0, -1] == pytest.approx(1e8 + SAMPLES - 1, rel=1.2e-7)
    assert np.float32(1e8) + np.float32(1) == np.float32(1e8)


# --------------------------------------------------------------------------------- limits, delay and the first sample


def limited(model, inputs, **options):
    """With half of what a record asks for, and every integrator led back within 10 ms."""
    return named(model, inputs, anti_windup=anti_windup(model, 0.01), low=[-0.2], high=[0.1], **options)


@pytest.mark.slow
@pytest.mark.parametrize(("which", "delay"), [("PID with a notch", 0), ("observer in the loop", 2)])
def test_limits_delay_and_a_start_in_motion_are_those_of_python(tmp_path, which, delay):
    controller = limited(*CONTROLLERS[which], delay=delay)
    inputs = 2e-5 * noise(len(controller.inputs), 3, 20_000)
    found = run_controller(controller_code(controller, "loop"), tmp_path, inputs, 1, np.float64, first=[0.05])
    wanted = controller.run(inputs, first=[0.05])
    assert np.mean((wanted == 0.1) | (wanted == -0.2)) > 0.1
    assert np.abs(found - wanted).max() < 1e-9
    assert np.all(found[0, : 1 + delay] == pytest.approx(0.05, abs=1e-12))


@pytest.mark.slow
def test_without_limits_a_run_is_the_linear_model():
    for which in CONTROLLERS:
        controller = named(*CONTROLLERS[which])
        inputs = noise(len(controller.inputs), 4, 500)
        wanted = simulate(controller.linear, inputs)
        assert controller.run(inputs) == pytest.approx(wanted, abs=1e-9 * np.abs(wanted).max())
        late = named(*CONTROLLERS[which], delay=3).run(inputs)
        assert np.all(late[:, :3] == 0) and np.all(late[:, 3:] == controller.run(inputs)[:, :-3])


def test_it_takes_over_where_it_rests_and_stays_there():
    """A PID with no error keeps any force; with an observer also where the machine pushes against a constant."""
    for which, e in (("PID with a notch", [0.0]), ("observer in the loop", [3e-3, 3e-3])):
        controller = named(*CONTROLLERS[which])
        held = np.repeat(np.array(e)[:, None], 2000, axis=1)
        found = controller.run(held, first=[7.0])[0]
        assert found[0] == pytest.approx(7.0, rel=1e-9)
        if which == "PID with a notch":
            assert found == pytest.approx(np.full(2000, 7.0), rel=1e-6)


def test_anti_windup_moves_the_integrator_alone():
    model = pid()
    gain = anti_windup(model, 0.01)
    before, after = (np.sort_complex(np.linalg.eigvals(a)) for a in (model.a, model.a - gain @ model.c))
    kept = np.abs(before - 1) > 1e-6
    assert np.count_nonzero(~kept) == 1
    assert np.abs(after[:, None] - before[None, kept]).min(axis=0).max() < 1e-7
    assert np.abs(after - np.exp(-SAMPLE_TIME / 0.01)).min() < 1e-9


@pytest.mark.slow
def test_a_limited_integrator_lets_go_at_once():
    """After a second at the limit the output leaves it within two tracking times of the sign's change."""
    inputs = 1e-6 * np.where(np.arange(12_000) < 10_000, 1.0, -1.0)[None]
    model = tustin(Pid(1e6, 20.0, 100.0, 2000.0).state_space(), SAMPLE_TIME)
    options = {"low": [-0.5], "high": [0.5]}
    wound = named(model, 1, **options).run(inputs)[0]
    free = named(model, 1, anti_windup=anti_windup(model, 0.02), **options).run(inputs)[0]
    assert free[9_999] == wound[9_999] == 0.5
    assert free[10_400] < 0 < wound[10_400]


# ------------------------------------------------------------------------- what is missing, out of range, or known


def drawn(rng):
    """A controller of up to 7 states, 3 inputs and 2 outputs, which may know them, with limits and a delay."""
    n, inputs, outputs = rng.integers([0, 1, 1], [8, 4, 3])
    back = outputs * rng.integers(2)
    a = rng.standard_normal((n, n))
    a *= 0.95 / max(np.abs(np.linalg.eigvals(a)).max(), 1e-3) if n else 1.0
    b, c = rng.standard_normal((n, inputs + back)), rng.standard_normal((outputs, n))
    d = np.hstack([rng.standard_normal((outputs, inputs)), np.zeros((outputs, back))])
    b[:, inputs:] *= 0.1
    winding = 0.05 * rng.standard_normal((n, outputs))
    if n and np.abs(np.linalg.eigvals(a - winding @ c)).max() >= 1:
        winding = np.zeros((n, outputs))
    options = {"delay": int(rng.integers(4)), "patience": int(rng.integers(5)), "low": -2.0, "high": 3.0}
    return named(StateModel(a, b, c, d, SAMPLE_TIME), int(inputs), anti_windup=winding, **options)


@pytest.mark.slow
def test_of_random_controllers_missing_samples_limits_and_what_is_known_are_those_of_python(tmp_path):
    """Outputs and flags, sample by sample; the runs that are lost are shorter and longer than the patience."""
    rng = np.random.default_rng(11)
    seen = 0
    for number in range(4):
        controller = drawn(rng)
        inputs, known = (
            noise(len(controller.inputs), number, 600),
            noise(len(controller.outputs), 50 + number, 600),
        )
        for begin in rng.integers(1, 590, 12):
            rows = inputs if rng.integers(3) else known
            rows[rng.integers(len(rows)), begin : begin + rng.integers(1, 8)] = np.nan
        first = [0.5] * len(controller.outputs)
        wanted = controller.trace(inputs, first, known)
        flags = np.zeros(600, np.int32)
        found = run_controller(
            controller_code(controller, "loop"), tmp_path / str(number), inputs, len(first), np.float64, first, known, flags
        )  # fmt: skip
        assert np.abs(found - wanted.outputs).max() < 1e-9
        assert np.array_equal(flags, wanted.flags)
        seen |= int(np.bitwise_or.reduce(flags))
    assert seen == SATURATED | HELD | INVALID


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "single"])
def test_no_input_spoils_the_states(tmp_path, precision):
    """Infinities are missing; what is finite but runs out of range is left out, and the controller goes on."""
    dtype = np.float64 if precision == "double" else np.float32
    controller = named(*CONTROLLERS["observer in the loop"], patience=3)
    inputs = 1e-6 * noise(2, 9, 400)
    inputs[0, 100:104], inputs[1, 200], inputs[0, 300:310] = np.inf, np.finfo(dtype).max, -np.finfo(dtype).max
    flags = np.zeros(400, np.int32)
    found = run_controller(
        controller_code(controller, "loop", precision), tmp_path, inputs, 1, dtype, flags=flags
    )
    assert np.all(np.isfinite(found)) and np.abs(found[0, 320:]).max() < 1
    assert np.flatnonzero(flags & HELD).tolist() == [100, 101, 102, 103]
    assert np.flatnonzero(flags & INVALID).tolist() == [103, 200, *range(300, 310)]


# --------------------------------------------------------------------------------------------------------- adaptation


def run_adaptation(files, folder, regressors, errors, dtype):
    """Weights after each sample, by the C code."""
    (name,) = {file.removesuffix(".c") for file in files if file.endswith(".c")}
    actuators, n, samples = len(errors), *regressors.shape
    driver = f"""
#include "{name}.h"
long run(long samples, const {name}_real *psi, const {name}_real *e, {name}_real *out)
{{
    {name}_state s;
    {name}_start(&s);
    for (long k = 0; k < samples; k++) {{
        if (!{name}_update(&s, psi + k * {n}, e + k * {actuators}))
            return k;
        for (int a = 0; a < {actuators}; a++)
            for (int i = 0; i < {n}; i++)
                out[(k * {actuators} + a) * {n} + i] = s.weights[a][i];
    }}
    return samples;
}}
"""
    library = compiled(files, folder, driver)
    library.run.restype = ctypes.c_long
    given = [np.ascontiguousarray(each.T, dtype) for each in (regressors, errors)]
    out = np.zeros((samples, actuators, n), dtype)
    used = library.run(ctypes.c_long(samples), *map(pointer, given), pointer(out))
    return used, out


def floor(samples, n=5, actuators=2):
    """Coloured regressors of which two are nearly one, and the error that fixed weights leave, by a plain product."""
    rng = np.random.default_rng(7)
    psi = np.cumsum(rng.standard_normal((n, samples)), axis=1)
    psi -= psi.mean(axis=1, keepdims=True)
    psi[-1] = psi[-2] + 1e-2 * psi[-1]
    errors = rng.standard_normal((actuators, n)) @ psi * np.exp(-np.arange(samples) / 2000)
    return psi.astype(np.float32).astype(float), errors.astype(np.float32).astype(float)


RLS = {"initial_covariance": 1e-2, "forgetting": 0.999}


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings", [FeRls(**RLS, form="UD"), FeRls(**RLS, growth_limit=np.inf), FeLms(1e-2, trace="literal")]
)
def test_an_adaptation_in_double_precision_gives_what_python_gives(tmp_path, settings):
    psi, errors = floor(SAMPLES)
    used, found = run_adaptation(adaptation_code(settings, 2, 5, "feed"), tmp_path, psi, errors, np.float64)
    wanted = adapt(settings, psi, errors, every=100).history
    assert used == SAMPLES
    assert np.abs(found[99::100] - wanted).max() < 1e-9 * np.abs(wanted).max()


@pytest.mark.slow
def test_ferls_in_single_precision_is_the_single_precision_of_python(tmp_path):
    """The same operations in the same order, in IEEE arithmetic: not a bit may differ."""
    psi, errors = floor(SAMPLES)
    settings = FeRls(**RLS, form="UD", dtype="float32")
    code = adaptation_code(FeRls(**RLS), 2, 5, "feed", "single")
    used, found = run_adaptation(code, tmp_path, psi, errors, np.float32)
    wanted = adapt(settings, psi, errors, every=100).history
    assert used == SAMPLES and np.array_equal(found[99::100], wanted)


@pytest.mark.slow
def test_felms_in_single_precision_stays_within_its_rounding(tmp_path):
    """Errors are given, so roundings add up: of each step 8 + n units, of the compensated sum 2 and the last place."""
    psi, errors = floor(SAMPLES)
    code = adaptation_code(FeLms(1e-4), 2, 5, "feed", "single")
    used, found = run_adaptation(code, tmp_path, psi, errors, np.float32)
    history = adapt(FeLms(1e-4), psi, errors, every=1).history
    steps = np.abs(np.diff(history, axis=0, prepend=0))
    bound = EPS * (10 + 5) * np.cumsum(steps, axis=0) + 2 * EPS * np.abs(history)
    assert used == SAMPLES and np.all(np.abs(found - history) <= bound)
    assert bound.max() < 1e-3 * np.abs(history).max()


# ------------------------------------------------------------------------------------------------------ least squares


@pytest.mark.slow
@pytest.mark.parametrize(
    ("intercept", "forgetting", "prior"),
    [(True, 0.97, None), (True, 1.0, 10.0), (False, 0.97, 10.0), (False, 1.0, None)],
)
def test_recursive_least_squares_in_double_precision_are_those_of_python_bit_by_bit(
    tmp_path, intercept, forgetting, prior
):
    """Through rests, a feature that another explains, two levels, steps, lost rows and weights."""
    rng = np.random.default_rng(3)
    x, weights = rng.standard_normal((900, 4)), rng.uniform(0, 2, 900)
    x[200:500] = x[200]
    x[:, 3] = np.sign(x[:, 3])
    x[:80, 1] = 2 * x[:80, 0] - 1
    x[600:] *= 1e3
    y = x @ rng.standard_normal((4, 2)) + 0.1 * rng.standard_normal((900, 2)) + 5.0
    x[[7, 300]], y[[8, 9], 1], weights[[20, 21]] = np.nan, np.nan, 0.0
    kept = {"forgetting": forgetting, "initial_covariance": prior, "fit_intercept": intercept}
    start = {} if prior is None else {"initial_coef": [[1.0, 2.0, 3.0, 4.0], [0.0, 1.0, 0.0, 1.0]]}
    estimator = RecursiveLeastSquares(**kept, **start)
    driver = """
#include "rls.h"
void run(long samples, const double *x, const double *y, const double *w, double *out)
{
    rls_state s;
    rls_start(&s);
    for (long k = 0; k < samples; k++) {
        double coef[2][4];
        double intercept[2];
        (void)rls_learn(&s, x + k * 4, y + k * 2, w[k]);
        rls_solve(&s, coef, intercept);
        for (int o = 0; o < 2; o++) {
            for (int i = 0; i < 4; i++)
                out[k * 10 + o * 5 + i] = coef[o][i];
            out[k * 10 + o * 5 + 4] = intercept[o];
        }
    }
}
"""
    library = compiled(least_squares_code(estimator, 4, 2, "rls"), tmp_path, driver)
    found = np.zeros((900, 2, 5))
    library.run(ctypes.c_long(900), pointer(x), pointer(y), pointer(weights), pointer(found))
    for k in range(900):
        estimator.partial_fit(x[k : k + 1], y[k : k + 1], weights[k : k + 1])
        assert np.array_equal(found[k, :, :4], estimator.coef_), k
        assert np.array_equal(found[k, :, 4], estimator.intercept_), k
