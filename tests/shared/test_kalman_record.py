"""The Kalman filter and smoother of a record against the joint Gaussian of all states and measurements, conditioned."""

import numpy as np
import pytest
from scipy import stats

from stillwork.estimation import NoiseCovariances, kalman_filter, kalman_gain
from stillwork.lti import StateModel


def drawn(seed, states=3, inputs=2, outputs=2, samples=7, crossed=True, missing=0.3):
    """A random model with its noises, and a record of it with holes."""
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(states, states))
    a *= rng.uniform(0.5, 1.2) / np.abs(np.linalg.eigvals(a)).max()
    model = StateModel(
        a,
        rng.normal(size=(states, inputs)),
        rng.normal(size=(outputs, states)),
        rng.normal(size=(outputs, inputs)),
        0.01,
    )
    root = rng.normal(size=(states + outputs, states + outputs))
    whole = root @ root.T
    if not crossed:
        whole[:states, states:] = whole[states:, :states] = 0.0
    noise = NoiseCovariances(whole[:states, :states], whole[states:, states:], whole[:states, states:])
    start = rng.normal(size=(states, states))
    start, mean = start @ start.T, rng.normal(size=states)
    u = rng.normal(size=(inputs, samples))
    x, y = rng.multivariate_normal(mean, start), np.empty((outputs, samples))
    for k in range(samples):
        w = rng.multivariate_normal(np.zeros(states + outputs), whole)
        y[:, k] = model.c @ x + model.d @ u[:, k] + w[states:]
        x = model.a @ x + model.b @ u[:, k] + w[:states]
    y[rng.random(y.shape) < missing] = np.nan
    return model, noise, u, y, start, mean


def joint(model, noise, u, samples, start, mean):
    """Mean and covariance of all states, then of all measurements, from the noises that they are sums of."""
    n, outputs = len(model.a), len(model.c)
    width = n + samples * (n + outputs)  # the first state, then w and v of each sample
    causes = np.zeros((width, width))
    causes[:n, :n] = start
    for k in range(samples):
        at = n + k * (n + outputs)
        causes[at : at + n + outputs, at : at + n + outputs] = np.block(
            [[noise.process, noise.cross], [noise.cross.T, noise.sensor]]
        )
    rows, x, center = np.eye(n, width), [], mean
    y, centers, seen = [], [], []
    for k in range(samples):
        at = n + k * (n + outputs)
        x.append(rows)
        centers.append(center)
        y.append(model.c @ rows + np.eye(outputs, width, at + n))
        seen.append(model.c @ center + model.d @ u[:, k])
        rows = model.a @ rows + np.eye(n, width, at)
        center = model.a @ center + model.b @ u[:, k]
    whole = np.vstack([*x, *y])
    return np.concatenate([*centers, *seen]), whole @ causes @ whole.T


def conditioned(center, covariance, wanted, given, values):
    gain = np.linalg.solve(covariance[np.ix_(given, given)], covariance[np.ix_(given, wanted)]).T
    mean = center[wanted] + gain @ (values - center[given])
    return mean, covariance[np.ix_(wanted, wanted)] - gain @ covariance[np.ix_(given, wanted)]


@pytest.mark.parametrize("crossed", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_estimates_are_those_of_the_joint_gaussian(seed, crossed):
    model, noise, u, y, start, mean = drawn(seed, crossed=crossed)
    n, (outputs, samples) = len(model.a), y.shape
    record = kalman_filter(model, noise, u, y, start, mean)
    smoothed, spread = record.smooth()
    center, covariance = joint(model, noise, u, samples, start, mean)
    first = n * samples
    measured = y.T.ravel()
    for k in range(samples):
        wanted = np.arange(n * k, n * (k + 1))
        for until, found, error in (
            (k, record.predicted, record.predicted_covariance),
            (k + 1, record.filtered, record.filtered_covariance),
            (samples, smoothed, spread),
        ):
            there = np.flatnonzero(~np.isnan(measured[: until * outputs]))
            expected, left = conditioned(center, covariance, wanted, first + there, measured[there])
            assert found[:, k] == pytest.approx(expected, rel=1e-8, abs=1e-8)
            assert error[k] == pytest.approx(left, rel=1e-8, abs=1e-8 * np.abs(start).max())
    there = np.flatnonzero(~np.isnan(measured))
    density = stats.multivariate_normal(
        center[first + there], covariance[np.ix_(first + there, first + there)], allow_singular=False
    )
    assert record.log_likelihood == pytest.approx(density.logpdf(measured[there]), rel=1e-9)


def test_three_steps_of_slicot():
    """SLICOT library, example data and results of FB01QD: the root of the covariance, and the predictor's gain."""

    def matrix(text):
        return np.array([row.split() for row in text.split(";")], dtype=float)

    a = matrix(
        ".2113 .8497 .7263 .8833; .7560 .6857 .1985 .6525; .0002 .8782 .5442 .3076; .3303 .0683 .2320 .9329"
    )
    b = matrix(".5618 .5042; .5896 .3493; .6853 .3873; .8906 .9222")
    c = matrix(".3616 .5664 .5015 .2693; .2922 .4826 .4368 .6325")
    sensor = matrix(".9488 0; .3760 .7340")
    root = matrix("-1.2936 0 0 0; -1.1382 -.2579 0 0; -.9622 -.1529 .2974 0; -1.3076 .0936 .4508 -.4897")
    printed = matrix(".3638 .9469; .3532 .8179; .2471 .5542; .1982 .6471")
    model = StateModel(a, np.zeros((4, 1)), c, np.zeros((2, 1)), 1.0)
    noise = NoiseCovariances(b @ b.T, sensor @ sensor.T)
    y = np.zeros((2, 4))
    y[:, 2] = 1.0, 0.0
    one = kalman_filter(model, noise, np.zeros((1, 4)), y, np.zeros((4, 4)))
    two = kalman_filter(model, noise, np.zeros((1, 4)), y[::-1], np.zeros((4, 4)))
    assert one.predicted_covariance[3] == pytest.approx(root @ root.T, abs=4e-4)
    assert np.column_stack([one.predicted[:, 3], two.predicted[:, 3]]) == pytest.approx(printed, abs=6e-5)


def test_filterpy_gives_the_same_record():
    filterpy = pytest.importorskip("filterpy.kalman")
    model, noise, u, y, start, mean = drawn(8, crossed=False, missing=0.0, samples=50)
    other = filterpy.KalmanFilter(dim_x=3, dim_z=2, dim_u=2)
    other.x, other.P = mean[:, None].copy(), start.copy()
    other.F, other.B, other.H = model.a, model.b, model.c
    other.Q, other.R = noise.process, noise.sensor
    states, covariances = [], []
    for k in range(50):
        other.update((y[:, k] - model.d @ u[:, k])[:, None])
        states.append(other.x.copy())
        covariances.append(other.P.copy())
        other.predict(u=u[:, k : k + 1])
    record = kalman_filter(model, noise, u, y, start, mean)
    assert record.filtered == pytest.approx(np.array(states)[:, :, 0].T, rel=1e-9, abs=1e-9)
    assert record.filtered_covariance == pytest.approx(np.array(covariances), rel=1e-9, abs=1e-9)
    # Its smoother knows no input: what is left after the input's own part is smoothed.
    forced, moved = np.zeros(3), []
    for k in range(50):
        moved.append(forced)
        forced = model.a @ forced + model.b @ u[:, k]
    free = np.array(states)[:, :, 0] - np.array(moved)
    smoothed, spread, *_ = other.rts_smoother(free, np.array(covariances))
    assert record.smooth()[0] == pytest.approx((smoothed + np.array(moved)).T, rel=1e-8, abs=1e-8)
    assert record.smooth()[1] == pytest.approx(spread, rel=1e-8, abs=1e-8)


@pytest.mark.parametrize("missing", [0.0, 1.0])
def test_all_measured_and_nothing_measured(missing):
    model, noise, u, y, start, mean = drawn(11, missing=missing)
    record = kalman_filter(model, noise, u, y, start, mean)
    if missing:
        x = mean
        for k in range(y.shape[1]):
            assert record.filtered[:, k] == pytest.approx(x)
            x = model.a @ x + model.b @ u[:, k]
        assert record.log_likelihood == 0.0
        assert record.smooth()[0] == pytest.approx(record.predicted)
    else:
        assert record.smooth()[0][:, -1] == pytest.approx(record.filtered[:, -1])


def test_a_long_record_ends_at_the_stationary_gain():
    """Which a Riccati equation gives, in discrete time; and with Q, R and S of correlated noises."""
    model, noise, u, y, start, mean = drawn(3, samples=4000, missing=0.0)
    found = kalman_gain(model, noise)
    record = kalman_filter(model, noise, u, y, start, mean)
    assert record.predicted_covariance[-1] == pytest.approx(found.covariance, rel=1e-7, abs=1e-9)
    step = record.predicted[:, -1] - model.a @ record.predicted[:, -2] - model.b @ u[:, -2]
    assert step == pytest.approx(found.gain @ record.innovations[:, -2], rel=1e-6, abs=1e-8)
    correction = record.filtered[:, -1] - record.predicted[:, -1]
    assert correction == pytest.approx(found.filter_gain @ record.innovations[:, -1], rel=1e-6, abs=1e-8)


def test_a_continuous_gain_takes_correlated_noise():
    """A P + P A' + Q - (P C' + S) R^-1 (P C' + S)' = 0."""
    model, noise, *_ = drawn(5)
    found = kalman_gain(StateModel(model.a, model.b, model.c, model.d), noise)
    p, both = found.covariance, found.covariance @ model.c.T + noise.cross
    residual = model.a @ p + p @ model.a.T + noise.process - both @ np.linalg.solve(noise.sensor, both.T)
    assert residual == pytest.approx(np.zeros_like(p), abs=1e-8 * np.abs(noise.process).max())
    assert found.gain == pytest.approx(np.linalg.solve(noise.sensor, both.T).T)


def test_a_line_of_delays_is_smoothed_although_its_covariance_is_singular():
    a = np.diag(np.ones(3), -1)
    model = StateModel(a, np.eye(4, 1), np.eye(1, 4, 3), np.zeros((1, 1)), 1.0)
    noise = NoiseCovariances(np.zeros((4, 4)), np.array([[0.1]]))
    u = np.arange(1.0, 9.0)[None]
    y = np.r_[np.zeros(4), u[0, :4]][None]
    record = kalman_filter(model, noise, u, y, np.zeros((4, 4)))
    assert record.smooth()[0] == pytest.approx(record.filtered)
    assert record.filtered[3, 4:] == pytest.approx(u[0, :4])


@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_units_of_states_and_outputs_do_not_matter(unit):
    model, noise, u, y, start, mean = drawn(2)
    other = StateModel(model.a, unit * model.b, model.c, unit * model.d, 0.01)
    scaled = NoiseCovariances(unit**2 * noise.process, unit**2 * noise.sensor, unit**2 * noise.cross)
    one = kalman_filter(model, noise, u, y, start, mean)
    two = kalman_filter(other, scaled, u, unit * y, unit**2 * start, unit * mean)
    assert two.filtered / unit == pytest.approx(one.filtered, rel=1e-9)
    assert two.smooth()[0] / unit == pytest.approx(one.smooth()[0], rel=1e-9)
