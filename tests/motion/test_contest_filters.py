"""The contest's own filters against slow twins in plain numpy, the toolbox's filters, limits and guarantees."""

import math

import numpy as np
import pytest

from experiments.motion.observer_contest import bench
from experiments.motion.observer_contest.doubts import DOUBTS, sample_truth
from experiments.motion.observer_contest.entrants import ENTRANTS
from experiments.motion.observer_contest.modes import detuned
from experiments.motion.observer_contest.multi_model import SWITCHING
from experiments.motion.observer_contest.plants import sample_plant
from experiments.motion.observer_contest.told import OwnObserver, told_of
from stillwork.estimation.nonlinear import NonlinearModel, extended_filter, unscented_filter

SAMPLES = 150


def scan(plant="drive", doubt="all 2 %", samples=SAMPLES):
    machine = sample_plant(plant, np.random.default_rng(2))
    truth = sample_truth(machine, DOUBTS[doubt], samples, np.random.default_rng(3))
    record = bench.record(bench.assemble(machine, truth, bench.CAUTIOUS, estimated=False))
    return (*told_of(machine, DOUBTS[doubt].noise), machine.sample_time), record


def run(name, settings, told, record):
    observer = OwnObserver(ENTRANTS[name], settings)
    observer.start(*told)
    return observer.run(record.inputs, record.measurements), observer


def riccati(model, noise, factor=1.0):
    """Stationary covariance after a measurement, and the gain, by running the recursion."""
    driven = factor * model.b @ noise.process @ model.b.T
    p = 1e3 * driven
    for _ in range(4000):
        p = model.a @ p @ model.a.T + driven
        gain = p @ model.c.T @ np.linalg.inv(model.c @ p @ model.c.T + noise.sensor)
        keep = np.eye(len(p)) - gain @ model.c
        p = keep @ p @ keep.T + gain @ noise.sensor @ gain.T
    return p, gain


def kalman(model, noise, record):
    """A textbook's Kalman filter begun from its stationary covariance."""
    p, _ = riccati(model, noise)
    x, out = np.zeros(len(model.a)), []
    for u, y in zip(record.inputs, record.measurements, strict=True):
        x = model.a @ x + model.b @ u
        p = model.a @ p @ model.a.T + model.b @ noise.process @ model.b.T
        gain = p @ model.c.T @ np.linalg.inv(model.c @ p @ model.c.T + noise.sensor)
        x = x + gain @ (y - model.c @ x)
        keep = np.eye(len(p)) - gain @ model.c
        p = keep @ p @ keep.T + gain @ noise.sensor @ gain.T
        out.append(x)
    return np.array(out)


def assert_close(found, wanted, relative):
    assert np.all(np.abs(found - wanted) <= relative * np.abs(wanted).max(axis=0))


@pytest.mark.slow
@pytest.mark.parametrize("plant", ["drive", "plate"])
@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("Kalman", ()),
        ("extended Kalman", (1e-9, 1e-12, 1.0)),
        ("unscented Kalman", (1e-9, 1e-12, 1.0)),
        ("Schmidt-Kalman", (1e-9,)),
        ("interacting models", (0.0, 1.0)),
        ("adaptive process noise", (0.0,)),
        ("fictitious noise", (1e-9,)),
        ("sensitivity penalised", (1e30,)),
    ],
)
def test_without_doubt_every_filter_is_the_kalman_filter(plant, name, settings):
    told, record = scan(plant)
    found, _ = run(name, settings, told, record)
    # The gains of a recursion that ends after a finite horizon, and of a Riccati solver, differ by so much.
    assert_close(found, kalman(*told[:2], record), 1e-5)


def drive_transition(state, inputs, parameters, out):
    """The drive with the errors of its frequency, its rigid body's gain and its flexible mode's gain as states."""
    step, omega, damping, rigid, flexible = (
        parameters[0],
        parameters[1] * (1 + state[4]),
        parameters[2],
        parameters[3],
        parameters[4],
    )
    push = rigid * (1 + state[5]) * inputs[0]
    out[0] = state[0] + step * state[1] + step * step / 2 * push
    out[1] = state[1] + step * push
    push = flexible * (1 + state[6]) * inputs[0]
    # The exact solution about the deflection that the force holds.
    rest = push / (omega * omega)
    turning = omega * math.sqrt(1 - damping * damping)
    decay = math.exp(-damping * omega * step)
    cosine, sine = math.cos(turning * step), math.sin(turning * step)
    from_rest = state[2] - rest
    swing = (state[3] + damping * omega * from_rest) / turning
    out[2] = rest + decay * (from_rest * cosine + swing * sine)
    out[3] = -damping * omega * (out[2] - rest) + decay * turning * (swing * cosine - from_rest * sine)
    out[4], out[5], out[6] = state[4], state[5], state[6]


def drive_measurement(state, inputs, parameters, out):
    out[0] = parameters[5] * state[0] + parameters[6] * state[2]


def nonlinear(told):
    model, _, step = told
    parameters = [
        step,
        model.frequencies[1],
        model.damping[1],
        *model.input_shapes[:, 0],
        *model.output_shapes[0],
    ]
    return NonlinearModel(drive_transition, drive_measurement, 7, 1, 1, parameters)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "twin"), [("extended Kalman", extended_filter), ("unscented Kalman", unscented_filter)]
)
def test_filters_of_parameters_agree_with_the_toolbox_on_a_model_written_otherwise(name, twin):
    deviation, walk, factor = 0.03, 1e-5, 4.0
    told, record = scan()
    model, noise, _ = told
    found, _ = run(name, (deviation, walk, factor), told, record)
    process, initial = np.zeros((2, 7, 7))
    process[:4, :4] = factor * model.b @ noise.process @ model.b.T
    initial[:4, :4] = riccati(model, noise, factor)[0]
    process[4:, 4:], initial[4:, 4:] = walk**2 * np.eye(3), deviation**2 * np.eye(3)
    wanted = twin(
        nonlinear(told),
        record.measurements.T,
        record.inputs.T,
        process=process,
        noise=noise.sensor,
        initial_mean=np.zeros(7),
        initial_covariance=initial,
    )
    assert_close(found, wanted.mean[:4].T, 1e-5)


@pytest.mark.slow
def test_the_schmidt_kalman_filter_considers_what_it_does_not_estimate():
    deviation, told_and_record = 0.05, scan()
    told, record = told_and_record
    model, noise, _ = told
    found, _ = run("Schmidt-Kalman", (deviation,), told, record)
    twin = nonlinear(told)
    p, added, h = np.zeros((7, 7)), np.zeros((7, 7)), np.zeros((1, 7))
    p[:4, :4], p[4:, 4:] = riccati(model, noise)[0], deviation**2 * np.eye(3)
    added[:4, :4], h[:, :4] = model.b @ noise.process @ model.b.T, model.c

    def moved(state, u):
        out = np.empty(7)
        drive_transition(state, u, twin.parameters, out)
        return out

    z, wanted = np.zeros(7), []
    for u, y in zip(record.inputs, record.measurements, strict=True):
        scale = np.sqrt(np.diag(p)) + 1e-3 * np.abs(z)
        jacobian = np.stack(
            [(moved(z + d, u) - moved(z - d, u)) / (2 * d.max()) for d in np.diag(1e-2 * scale)], axis=1
        )
        z, p = moved(z, u), jacobian @ p @ jacobian.T + added
        gain = p @ h.T / (h @ p @ h.T + noise.sensor)
        gain[4:] = 0
        z = z + gain @ (y - h @ z)
        keep = np.eye(7) - gain @ h
        p = keep @ p @ keep.T + gain @ noise.sensor @ gain.T
        wanted.append(z[:4])
    assert not z[4:].any()
    # Differences over a hundredth of a deviation leave an error of the second order.
    assert_close(found, np.array(wanted), 1e-4)


@pytest.mark.slow
def test_the_bank_mixes_as_interacting_models_do():
    spread, factor = 0.03, 9.0
    told, record = scan()
    model, noise, step = told
    found, _ = run("interacting models", (spread, factor), told, record)
    models = [detuned(model, step, np.array([1]), np.array([e])) for e in spread * np.linspace(-1, 1, 11)]
    gains, covariances = [], []
    for each in models:
        p, gain = riccati(each, noise, factor)
        gains.append(gain)
        before = each.a @ p @ each.a.T + factor * each.b @ noise.process @ each.b.T
        covariances.append(float((each.c @ before @ each.c.T + noise.sensor)[0, 0]))
    count = len(models)
    chain = np.full((count, count), SWITCHING / (count - 1)) + (1 - SWITCHING * count / (count - 1)) * np.eye(
        count
    )
    assert np.allclose(chain.sum(axis=1), 1)
    weights, x, wanted = np.full(count, 1 / count), np.zeros((count, 4)), []
    for u, y in zip(record.inputs, record.measurements, strict=True):
        before = chain.T @ weights
        mixed = (chain * weights[:, None]).T @ x / before[:, None]
        likelihood = np.zeros(count)
        for m, each in enumerate(models):
            x[m] = each.a @ mixed[m] + each.b @ u
            innovation = y - each.c @ x[m]
            likelihood[m] = -(innovation[0] ** 2) / covariances[m] / 2 - np.log(covariances[m]) / 2
            x[m] += gains[m] @ innovation
        weights = before * np.exp(likelihood - likelihood.max())
        weights /= weights.sum()
        wanted.append(weights @ x)
    assert_close(found, np.array(wanted), 1e-5)


@pytest.mark.slow
def test_the_set_holds_the_state_as_long_as_the_bounds_hold():
    machine = sample_plant("stage", np.random.default_rng(2))
    told = (*told_of(machine, 1.0), machine.sample_time)
    model, noise, _ = told
    rng = np.random.default_rng(5)
    sensor, process = 3.0, 10.0
    observer = OwnObserver(ENTRANTS["set membership"], (sensor, process))
    observer.start(*told)
    x, sizes = np.zeros(len(model.a)), []
    for _ in range(400):
        u = rng.normal(size=1)
        w = process * np.sqrt(noise.process[0, 0]) * rng.uniform(-1, 1, 1)
        x = model.a @ x + model.b @ (u + w)
        y = model.c @ x + sensor * np.sqrt(noise.sensor[0, 0]) * rng.uniform(-1, 1, 1)
        found = observer.step(u, y)
        p = observer.memory[1]
        sizes.append(np.sqrt(model.c[0] @ p @ model.c[0]))
        scale = np.sqrt(np.diag(p))
        apart = (x - found) / scale
        assert apart @ np.linalg.solve(p / np.outer(scale, scale), apart) <= 1 + 1e-9
    assert max(sizes[200:]) < 20 * np.sqrt(noise.sensor[0, 0])  # and does not hold everything


@pytest.mark.slow
@pytest.mark.parametrize(("true", "low", "high"), [(1.0, 1.0, 30.0), (1e3, 1e4, 1e8)])
def test_the_adaptive_filter_finds_the_process_noise(true, low, high):
    """A force with `true` times its deviation: the factor on the variance is the square, within a decade or two."""
    machine = sample_plant("stage", np.random.default_rng(2))
    told = (*told_of(machine, 1.0), machine.sample_time)
    model, noise, _ = told
    rng = np.random.default_rng(5)
    observer = OwnObserver(ENTRANTS["adaptive process noise"], (0.02,))
    observer.start(*told)
    x, factors = np.zeros(len(model.a)), []
    for _ in range(3000):
        w = true * np.sqrt(noise.process[0, 0]) * rng.standard_normal(1)
        x = model.a @ x + model.b @ w
        observer.step(np.zeros(1), model.c @ x + np.sqrt(noise.sensor[0, 0]) * rng.standard_normal(1))
        factors.append(observer.memory[2][0])
    assert low <= np.median(factors[1500:]) <= high


def test_detuned_models_keep_the_order_of_the_states():
    """Two modes that change places stay where they were among the states."""
    model, _ = told_of(sample_plant("measured structure", np.random.default_rng(0)), 1.0)
    step = 5e-5
    changed = detuned(model, step, np.array([1, 2]), np.array([0.05, -0.05]))
    for mode, factor in ((1, 1.05), (2, 0.95), (3, 1.0)):
        pair = slice(2 * mode, 2 * mode + 2)
        angle = np.abs(np.angle(np.linalg.eigvals(changed.a[pair, pair])))[0]
        wanted = factor * model.frequencies[mode] * np.sqrt(1 - model.damping[mode] ** 2) * step
        assert angle == pytest.approx(wanted, rel=1e-9)
