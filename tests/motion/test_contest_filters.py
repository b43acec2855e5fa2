"""The contest's own filters against slow twins in plain numpy, filterpy's filters, limits and guarantees."""

import math
from functools import cache

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from contest import bench
from contest.learned import FAST, FEATURES, FILE, FORCES, HIDDEN, SLOW
from contest.moving_horizon import HORIZON
from contest.nominal import OwnObserver, nominal_of
from contest.plants import plant_of
from contest.scores import ENTRANTS
from contest.training import evolve
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
        ("particles", (0.0, 0.0, 1.0)),
        ("gated extended Kalman", (1e-9, 1e-12, 1.0, 1e9)),
        ("unknown input", (1.0,)),
        ("disturbance observer", (1e-9,)),
        ("moving horizon", (1e9, 1.0)),
        ("fictitious noise", (1e-9,)),
        ("sensitivity penalised", (1e30,)),
        ("guaranteed cost", (1e-9, 1e-9)),
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


def peers(given, frequency_errors, deviation, factor):
    """A Kalman filter of filterpy for every frequency, of the drive's states and its two gains."""
    model, noise, _ = given
    (moved, _), some, settled = written_otherwise(given), [], riccati(model, noise, factor)
    for error in frequency_errors:
        peer = KalmanFilter(dim_x=6, dim_z=1, dim_u=1)
        peer.error, peer.H, peer.R = error, np.hstack([model.c, np.zeros((1, 2))]), noise.sensor
        peer.x, peer.P, peer.Q = np.zeros((6, 1)), np.zeros((6, 6)), np.zeros((6, 6))
        peer.Q[:4, :4] = factor * model.b @ noise.process @ model.b.T
        peer.P[:4, :4], peer.P[4:, 4:] = settled, deviation**2 * np.eye(2)
        some.append(peer)

    def set_force(u):
        """Given its frequency and the force the machine is affine."""
        for peer in some:
            points = np.insert(np.vstack([np.zeros(6), np.eye(6)]), 4, peer.error, axis=1)
            ends = np.delete([moved(point, u) for point in points], 4, axis=1)
            peer.B, peer.F = ends[:1].T, (ends[1:] - ends[0]).T

    return some, set_force


@pytest.mark.slow
def test_particles_are_filterpys_kalman_filters_weighed_by_what_they_predicted():
    """Until they are resampled, which does not happen in so few samples."""
    spread, factor, samples = 0.003, 9.0, slice(0, 17)
    given, record = scan(samples=150)
    parts = (record.inputs, record.measurements, record.states)
    short = bench.ScanRecord(*(each[samples] for each in parts))
    found, observer = run("particles", (spread, 0.0, factor), given, short)
    errors = observer.made.memory[2]
    assert np.array_equal(observer.memory[2], errors) and errors[:, 1].std() > spread / 2
    some, set_force = peers(given, errors[:, 1], spread, factor)
    scores = np.zeros(len(some))
    for u, y in zip(short.inputs, short.measurements, strict=True):
        set_force(u)
        for m, peer in enumerate(some):
            peer.predict(np.ones((1, 1)))
            peer.update(y)
            scores[m] += peer.log_likelihood
    weights = np.exp(scores - scores.max())
    weights /= weights.sum()
    assert 2 < 1 / np.sum(weights**2) < len(some) - 1
    assert_close(found[-1:], (weights @ np.array([peer.x[:4, 0] for peer in some]))[None], 1e-6)


def drive_feedback(given, size):
    """Derivatives of the drive's flexible states by frequency, damping and gain, in their deviations, times `size`."""
    model, noise, _ = given
    scale, nudge = np.sqrt(np.diag(riccati(model, noise)))[2:], 1e-5

    def moved(x, u, errors):
        parameters, out = np.array(parameters_of(given)), np.empty(7)
        parameters[2] *= 1 + errors[1]
        drive_transition(np.array([*x, errors[0], 0.0, errors[2]]), u, parameters, out)
        return out[2:4] / scale

    def fed(x, u):
        return np.concatenate(
            [size / (2 * nudge) * (moved(x, u, each) - moved(x, u, -each)) for each in nudge * np.eye(3)]
        )

    of_state = np.stack([fed(x, np.zeros(1)) for x in np.eye(4)], axis=1)
    returned = np.zeros((4, 6))
    returned[2:] = np.tile(np.diag(scale), 3)
    return of_state, fed(np.zeros(4), np.ones(1)), returned


@pytest.mark.slow
def test_the_guaranteed_cost_filter_ends_where_its_indefinite_sum_of_squares_stands_still():
    size, multiplier, samples = 0.003, 0.3, 160
    given, record = scan(samples=samples)
    model, noise, _ = given
    found, _ = run("guaranteed cost", (size, multiplier), given, record)
    of_state, of_force, returned = drive_feedback(given, size)
    p = riccati(model, noise)
    # Unknowns: the first state, then w and d of every sample.
    state, known = np.zeros((4, 4 + 7 * samples)), np.zeros(4)
    state[:, :4] = np.eye(4)
    rows, right = [np.linalg.solve(np.linalg.cholesky(p), state)], [np.zeros(4)]
    own = (
        np.eye(state.shape[1])[4:]
        / np.sqrt(np.tile([noise.process[0, 0], *[multiplier] * 6], samples))[:, None]
    )
    rows, right, signs = [*rows, own], [*right, np.zeros(len(own))], [np.ones(4 + len(own))]
    for k, (u, y) in enumerate(zip(record.inputs, record.measurements, strict=True)):
        rows += [of_state @ state / np.sqrt(multiplier)]
        right += [-(of_state @ known + of_force * u) / np.sqrt(multiplier)]
        state, known = model.a @ state, model.a @ known + model.b @ u
        state[:, 4 + 7 * k : 11 + 7 * k] = np.hstack([model.b, returned])
        rows += [model.c @ state / np.sqrt(noise.sensor)]
        right += [(y - model.c @ known) / np.sqrt(noise.sensor[0])]
        signs += [-np.ones(6), np.ones(1)]
    stacked, signs = np.vstack(rows), np.concatenate(signs)
    units, right = np.linalg.norm(stacked, axis=0), np.concatenate(right)

    def stands_still(signs):
        scaled = stacked / units
        best = np.linalg.solve(scaled.T @ (signs[:, None] * scaled), scaled.T @ (signs * right)) / units
        return (state @ best + known)[None]

    # The filter's gain is the last of a longer recursion, and its first state was known.
    assert_close(found[-1:], stands_still(signs), 1e-5)
    assert np.any(np.abs(found[-1] / stands_still(np.maximum(signs, 0))[0] - 1) > 1e-3)


@pytest.mark.slow
def test_the_moving_horizon_minimises_hubers_loss_with_its_arrival_cost():
    """Against a convex solver on the last window, which an outlier spoils."""
    import cvxpy as cp

    threshold, factor = 2.0, 9.0
    given, record = scan(samples=60)
    model, noise, _ = given
    record.measurements[50] += 40 * np.sqrt(noise.sensor[0])
    found, _ = run("moving horizon", (threshold, factor), given, record)
    first, p = len(record.inputs) - HORIZON, riccati(model, noise, factor)

    def solved(loss):
        scale = np.sqrt(np.diag(p))  # the solver likes numbers near one
        start, w, x, costs = cp.Variable(4), cp.Variable(HORIZON), None, []
        for k in range(HORIZON):
            last = found[first - 1] / scale + start if x is None else x
            push = record.inputs[first + k] + w[k : k + 1] * np.sqrt(factor * noise.process[0, 0])
            x = (model.a * scale / scale[:, None]) @ last + (model.b / scale[:, None]) @ push
            left = record.measurements[first + k] - (model.c * scale) @ x
            costs.append(loss(left / np.sqrt(noise.sensor[0, 0])))
        prior = np.linalg.inv(np.linalg.cholesky(p / np.outer(scale, scale)))
        cp.Problem(cp.Minimize(cp.sum_squares(prior @ start) + cp.sum_squares(w) + sum(costs))).solve(
            solver="CLARABEL"
        )
        return x.value * scale

    wanted, squares = solved(lambda left: cp.sum(cp.huber(left, threshold))), solved(cp.sum_squares)
    # Three rounds of reweighting come this near.
    assert np.all(np.abs(found[-1] - wanted) <= 0.1 * np.abs(squares - wanted))


@pytest.mark.slow
def test_the_learned_filter_is_its_slow_twin():
    given, record = scan("plate", "lost 20 %")
    model = given[0]
    found, observer = run("learned", (), given, record)
    gains, sizes = observer.made.data[3:5]
    first, second = np.split(np.loadtxt(FILE), [HIDDEN * FEATURES])
    first, second = first.reshape(HIDDEN, FEATURES), second.reshape(-1, HIDDEN)
    count = 1 + len(FORCES)
    x, slow, fast, turned, before = np.zeros((count, len(model.a))), np.ones(count), 1.0, 0.0, 0 * sizes
    shares, wanted = np.full(count, 1 / count), []
    for u, y in zip(record.inputs, record.measurements, strict=True):
        x = x @ model.a.T + model.b @ u
        if not np.isnan(y[0]):
            off = (y - x @ model.c.T) / sizes
            now = np.mean(off**2, axis=1)
            fast += FAST * (now[0] - fast)
            turned += SLOW * (np.mean(off[0] * before) - turned)
            slow, before = slow + SLOW * (now - slow), off[0]
            ratios = fast / (slow[0] + 1e-9), now[0] / (slow[0] + 1e-9)
            logs = np.log(np.array([*slow, *ratios]) + 1e-3) / 4
            out = second @ np.tanh(first @ np.array([*logs, turned / (slow[0] + 1e-9), 1.0]))
            shares = np.exp(out[:-1] - 4 * np.arange(count))
            shares /= shares.sum()
            x = x + np.einsum("mio,mo->mi", gains, off * sizes) / (1 + np.exp(-3 - out[-1]))
        wanted.append(shares @ x)
    assert_close(found, np.array(wanted), 1e-6)


def test_the_evolution_strategy_finds_the_minimum_of_a_quadratic():
    goal = np.linspace(-1, 1, 5)
    found = evolve(lambda x: np.sum((x - goal) ** 2), 5, 60, np.random.default_rng(0))
    assert np.abs(found - goal).max() < 0.05


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
