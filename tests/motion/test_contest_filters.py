"""The contest's own filters against slow twins in plain numpy, filterpy's filters, limits and guarantees."""

import math
from functools import cache

import numpy as np
import pytest

from contest import bench
from contest.nominal import OwnObserver, nominal_of
from contest.plants import plant_of
from contest.scores import ENTRANTS
from contest.uncertainties import UNCERTAINTIES, sample_truth
from naive.fixedpoint import kalman_step, unscented_step

SAMPLES = 80


def scan(plant="drive", uncertainty="all 2 %", samples=SAMPLES):
    machine = plant_of(plant)
    truth = sample_truth(machine, UNCERTAINTIES[uncertainty], samples, np.random.default_rng(3))
    record = bench.record(bench.assemble(machine, truth, bench.BANDWIDTH_RATIO_LOW, estimated=False))
    return (*nominal_of(machine, UNCERTAINTIES[uncertainty].noise), machine.sample_time), record


def run(name, settings, given, record):
    observer = OwnObserver(ENTRANTS[name], settings)
    observer.start(*given)
    return observer.run(record.inputs, record.measurements), observer


def riccati(model, noise, factor=1.0):
    """Stationary covariance after a measurement, by running the recursion."""
    still, driven = np.zeros(len(model.a)), factor * model.b @ noise.process @ model.b.T
    p = 1e3 * driven
    for _ in range(4000):
        _, p = kalman_step(still, p, model.c @ still, still, model.a, model.c, 0.0, driven, noise.sensor)
    return p


def kalman(model, noise, record):
    """A textbook's Kalman filter begun from its stationary covariance."""
    x, p, out = np.zeros(len(model.a)), riccati(model, noise), []
    driven = model.b @ noise.process @ model.b.T
    for u, y in zip(record.inputs, record.measurements, strict=True):
        ahead = model.a @ x + model.b @ u
        x, p = kalman_step(x, p, y, ahead, model.a, model.c, model.c @ ahead, driven, noise.sensor)
        out.append(x)
    return np.array(out)


@cache
def kalman_of(plant):
    given, record = scan(plant)
    return kalman(*given[:2], record)


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
        ("gated extended Kalman", (1e-9, 1e-12, 1.0, 1e9)),
        ("unknown input", (1.0,)),
        ("disturbance observer", (1e-9,)),
        ("fictitious noise", (1e-9,)),
        ("sensitivity penalised", (1e30,)),
    ],
)
def test_without_uncertainty_every_filter_is_the_kalman_filter(plant, name, settings):
    given, record = scan(plant)
    found, _ = run(name, settings, given, record)
    # The gains of a recursion that ends after a finite horizon, and of a Riccati solver, differ by so much.
    assert_close(found, kalman_of(plant), 1e-5)


def drive_transition(state, inputs, parameters, out):
    """The drive with the errors of its frequency, its rigid body's gain and its flexible mode's gain as states."""
    sample_time, omega, damping, rigid, flexible = (
        parameters[0],
        parameters[1] * (1 + state[4]),
        parameters[2],
        parameters[3],
        parameters[4],
    )
    push = rigid * (1 + state[5]) * inputs[0]
    out[0] = state[0] + sample_time * state[1] + sample_time * sample_time / 2 * push
    out[1] = state[1] + sample_time * push
    push = flexible * (1 + state[6]) * inputs[0]
    # The exact solution about the deflection that the force holds.
    rest = push / (omega * omega)
    turning = omega * math.sqrt(1 - damping * damping)
    decay = math.exp(-damping * omega * sample_time)
    cosine, sine = math.cos(turning * sample_time), math.sin(turning * sample_time)
    from_rest = state[2] - rest
    swing = (state[3] + damping * omega * from_rest) / turning
    out[2] = rest + decay * (from_rest * cosine + swing * sine)
    out[3] = -damping * omega * (out[2] - rest) + decay * turning * (swing * cosine - from_rest * sine)
    out[4], out[5], out[6] = state[4], state[5], state[6]


def drive_measurement(state, inputs, parameters, out):
    out[0] = parameters[5] * state[0] + parameters[6] * state[2]


def parameters_of(given):
    model, _, sample_time = given
    shapes = *model.input_shapes[:, 0], *model.output_shapes[0]
    return sample_time, model.frequencies[1], model.damping[1], *shapes


def written_otherwise(given):
    """Next state and measurement as functions of the state, the first of the force, too."""
    parameters = parameters_of(given)

    def moved(state, u):
        out = np.empty(7)
        drive_transition(state, u, parameters, out)
        return out

    def seen(state):
        out = np.empty(1)
        drive_measurement(state, None, parameters, out)
        return out

    return moved, seen


def slopes(function, at):
    """Jacobian by central differences."""
    steps = np.diag(1e-5 * np.maximum(1.0, np.abs(at)))
    return np.stack([(function(at + d) - function(at - d)) / (2 * d.max()) for d in steps], axis=1)


def extended_step(x, p, y, moved, seen, q, r):
    """A textbook's extended Kalman filter."""
    there = moved(x)
    return kalman_step(x, p, y, there, slopes(moved, x), slopes(seen, there), seen(there), q, r)


def spread_step(x, p, y, moved, seen, q, r):
    """A textbook's unscented Kalman filter, points drawn anew for the measurement."""
    return unscented_step(x, p, y, moved, seen, q, r, 1.0, 0.0, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "twin"), [("extended Kalman", extended_step), ("unscented Kalman", spread_step)]
)
def test_filters_of_parameters_agree_with_textbooks_on_a_model_written_otherwise(name, twin):
    deviation, walk, factor = 0.03, 1e-5, 4.0
    given, record = scan()
    model, noise, _ = given
    found, _ = run(name, (deviation, walk, factor), given, record)
    process, initial = np.zeros((2, 7, 7))
    process[:4, :4] = factor * model.b @ noise.process @ model.b.T
    initial[:4, :4] = riccati(model, noise, factor)
    process[4:, 4:], initial[4:, 4:] = walk**2 * np.eye(3), deviation**2 * np.eye(3)
    moved, seen = written_otherwise(given)
    x, p, wanted = np.zeros(7), initial, []
    for u, y in zip(record.inputs, record.measurements, strict=True):
        x, p = twin(x, p, y, lambda state, u=u: moved(state, u), seen, process, noise.sensor)
        wanted.append(x[:4])
    assert_close(found, np.array(wanted), 1e-5)


@pytest.mark.slow
def test_the_schmidt_kalman_filter_considers_what_it_does_not_estimate():
    deviation, given_and_record = 0.05, scan()
    given, record = given_and_record
    model, noise, _ = given
    found, _ = run("Schmidt-Kalman", (deviation,), given, record)
    moved, _ = written_otherwise(given)
    p, added, h = np.zeros((7, 7)), np.zeros((7, 7)), np.zeros((1, 7))
    p[:4, :4], p[4:, 4:] = riccati(model, noise), deviation**2 * np.eye(3)
    added[:4, :4], h[:, :4] = model.b @ noise.process @ model.b.T, model.c

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
def test_the_set_holds_the_state_as_long_as_the_bounds_hold():
    machine = plant_of("stage")
    given = (*nominal_of(machine, 1.0), machine.sample_time)
    model, noise, _ = given
    rng = np.random.default_rng(5)
    sensor, process = 3.0, 10.0
    observer = OwnObserver(ENTRANTS["set membership"], (sensor, process))
    observer.start(*given)
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
