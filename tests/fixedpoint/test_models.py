"""Own models: against filterpy, against the plain Kalman filter, and without recompiling."""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from fixedpoint import own_model
from fixedpoint.reuse import use
from naive import fixedpoint as naive
from stillwork.base.checks import InputError
from stillwork.base.kernels import callback
from stillwork.estimation.nonlinear import NonlinearModel, extended_filter, unscented_filter
from stillwork.estimation.plant import SIGNATURE
from stillwork.estimation.unscented import SigmaPoints

A = np.array([[0.9, 0.1, 0.0], [-0.1, 0.8, 0.05], [0.02, 0.0, 0.95]])
B = np.array([0.1, 0.0, 0.5])
H = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, -1.0]])
Q, R = np.diag([0.01, 0.02, 0.005]), np.array([[0.1, 0.02], [0.02, 0.3]])


@pytest.fixture
def linear(rng):
    model = NonlinearModel(
        own_model.three_masses, own_model.two_sums, 3, 1, 2, np.concatenate([A.ravel(), B])
    )
    u = rng.standard_normal((1, 300))
    x, z = np.zeros(3), []
    for k in range(300):
        x = A @ x + B * u[0, k] + rng.multivariate_normal(np.zeros(3), Q)
        z.append(H @ x + rng.multivariate_normal(np.zeros(2), R))
    return model, np.array(z).T, u


def test_unscented_extended_and_kalman_coincide_on_a_linear_plant(linear):
    model, z, u = linear
    settings = {
        "process": Q,
        "noise": R,
        "initial_mean": np.array([1.0, -1.0, 0.5]),
        "initial_covariance": np.array([1.0, 2.0, 3.0]),
    }
    unscented = unscented_filter(model, z, u, **settings)
    extended = extended_filter(model, z, u, **settings)
    x, P = np.array([1.0, -1.0, 0.5]), np.diag([1.0, 2.0, 3.0])
    for k in range(z.shape[1]):
        predicted = A @ x + B * u[0, k]
        x, P = naive.kalman_step(x, P, z[:, k], predicted, A, H, H @ predicted, Q, R)
        for found in (unscented, extended):
            assert np.abs(found.mean[:, k] - x).max() < 1e-10
            assert np.abs(found.covariance[k] - P).max() < 1e-10


def test_missing_measurements_are_marginalised(linear):
    """Against the joint Gaussian of all states and measurements, conditioned on those that there are."""
    model, z, u = linear
    z, u = z[:, :12].copy(), u[:, :12]
    z[0, 3], z[:, 6:9], z[1, 11] = np.nan, np.nan, np.nan
    start, spread = np.array([1.0, -1.0, 0.5]), np.diag([1.0, 2.0, 3.0])
    mean, joint, moved = np.zeros((12, 3)), np.zeros((12, 3, 12, 3)), start
    for k in range(12):
        mean[k] = moved = A @ moved + B * u[0, k]
        spread = A @ spread @ A.T + Q
        forward = spread
        for j in range(k, 12):
            joint[j, :, k, :], joint[k, :, j, :] = forward, forward.T
            forward = A @ forward
    settings = {
        "process": Q,
        "noise": R,
        "initial_mean": start,
        "initial_covariance": np.array([1.0, 2.0, 3.0]),
    }
    seen = [k for k in range(12) if np.isfinite(z[:, k]).all()]
    for found in (unscented_filter(model, z, u, **settings), extended_filter(model, z, u, **settings)):
        for k in range(12):
            rows = [j for j in seen if j <= k]
            cross = np.hstack([joint[k, :, j, :] @ H.T for j in rows])
            inner = np.block([[H @ joint[i, :, j, :] @ H.T + (i == j) * R for j in rows] for i in rows])
            news = np.concatenate([z[:, j] - H @ mean[j] for j in rows])
            gain = cross @ np.linalg.inv(inner)
            assert found.mean[:, k] == pytest.approx(mean[k] + gain @ news, abs=1e-10)
            assert found.covariance[k] == pytest.approx(joint[k, :, k, :] - gain @ cross.T, abs=1e-10)


def test_small_alpha_loses_digits_only(linear):
    model, z, u = linear
    settings = {"process": Q, "noise": R, "initial_mean": np.zeros(3), "initial_covariance": np.eye(3)}
    wide = unscented_filter(model, z, u, **settings)
    narrow = unscented_filter(model, z, u, points=SigmaPoints(), **settings)
    assert np.abs(wide.mean - narrow.mean).max() < 1e-7


def pendulum_record(rng):
    parameters = np.array([0.01, 9.81, 0.1])
    model = NonlinearModel(own_model.pendulum, own_model.seen, 2, 1, 1, parameters)
    torque = 5 * rng.standard_normal((1, 200))
    state, out, z = np.array([0.4, 0.0]), np.zeros(2), []
    for k in range(200):
        own_model.pendulum(state, torque[:, k], parameters, out)
        state = out.copy()
        z.append(np.sin(state[0]) + 0.01 * rng.standard_normal())
    return model, np.array([z]), torque


def test_own_nonlinear_model_is_filterpy_s(rng):
    model, z, torque = pendulum_record(rng)
    process, noise = np.diag([1e-6, 1e-3]), np.array([[1e-4]])
    found = unscented_filter(
        model,
        z,
        torque,
        process=process,
        noise=noise,
        initial_mean=np.zeros(2),
        initial_covariance=np.ones(2),
    )

    def move(x, dt, u):
        out = np.zeros(2)
        own_model.pendulum(x, np.array([u]), model.parameters, out)
        return out

    peer = UnscentedKalmanFilter(
        2, 1, 0.01, lambda x: np.sin(x[:1]), move, MerweScaledSigmaPoints(2, 1.0, 0.0, 0.0)
    )
    peer.x, peer.P, peer.Q, peer.R = np.zeros(2), np.eye(2), process, noise
    for k in range(z.shape[1]):
        peer.predict(u=torque[0, k])
        peer.update(z[:, k])
        assert np.abs(found.mean[:, k] - peer.x).max() < 1e-9


def test_own_nonlinear_model_extended(rng):
    """Against the textbook filter with Jacobians by hand."""
    model, z, torque = pendulum_record(rng)
    dt, pull, damping = model.parameters
    process, noise = np.diag([1e-6, 1e-3]), np.array([[1e-4]])
    found = extended_filter(
        model,
        z,
        torque,
        process=process,
        noise=noise,
        initial_mean=np.array([0.3, 0.0]),
        initial_covariance=np.array([0.1, 1.0]),
    )
    x, P, out = np.array([0.3, 0.0]), np.diag([0.1, 1.0]), np.zeros(2)
    for k in range(z.shape[1]):
        row = np.array([-dt * pull * np.cos(x[0]), 1 - dt * damping])
        F = np.array([[1.0, 0.0] + dt * row, row])
        own_model.pendulum(x, torque[:, k], model.parameters, out)
        predicted = out.copy()
        slope = np.array([[np.cos(predicted[0]), 0.0]])
        x, P = naive.kalman_step(x, P, z[:, k], predicted, F, slope, np.sin(predicted[:1]), process, noise)
        assert np.abs(found.mean[:, k] - x).max() < 1e-8


def load(folder):
    """The module of own functions out of a copy in `folder`."""
    spec = importlib.util.spec_from_file_location("own_model", shutil.copy(own_model.__file__, folder))
    return importlib.util.module_from_spec(spec), spec.loader


def elsewhere(folder) -> list[str]:
    """What `use` returns in another process that imports the module from `folder`."""
    code = "import sys; sys.path[:0] = sys.argv[1:]; import own_model, reuse; print(*reuse.use(own_model))"
    command = [sys.executable, "-c", code, str(folder), str(Path(__file__).parent)]
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2] / "lib")}
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.stderr == ""
    return done.stdout.split()


@pytest.mark.slow
def test_a_second_process_compiles_nothing(tmp_path, monkeypatch):
    """An own plant in an own file: compiled and cached beside it here, found there by another process."""
    module, loader = load(tmp_path)
    monkeypatch.setitem(sys.modules, "own_model", module)
    loader.exec_module(module)
    _, hits, error = use(module)
    assert hits == 0 and error < 1e-3
    assert elsewhere(tmp_path) == ["0", "4", str(error)]


def test_a_module_that_no_other_process_can_import_leaves_no_cache(tmp_path):
    """Loaded by its path alone: numba would write a cache that it cannot read again."""
    module, loader = load(tmp_path)
    loader.exec_module(module)
    callback(module.cart_acceleration, SIGNATURE)
    assert not list(tmp_path.rglob("*.nbc"))


def leaves_one_out(state, inputs, parameters, out):
    out[0] = state[0]


def reads_too_far(state, inputs, parameters, out):
    out[0] = state[7]


def divides_by_zero(state, inputs, parameters, out):
    out[0] = 1 / len(inputs[1:])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"transition": divides_by_zero}, "transition fails on 2 states.*division by zero"),
        ({"transition": leaves_one_out}, r"transition leaves out\[1\] unset"),
        ({"measurement": reads_too_far}, "measurement fails on 2 states"),
        ({"states": 0}, "states"),
        ({"parameters": np.array([np.inf])}, "parameters holds"),
    ],
)
def test_a_wrong_model_is_named(change, message):
    good = {
        "transition": own_model.pendulum,
        "measurement": own_model.seen,
        "states": 2,
        "inputs": 1,
        "outputs": 1,
        "parameters": np.array([0.01, 9.81, 0.1]),
    }
    with pytest.raises(InputError, match=message):
        NonlinearModel(**(good | change))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"process": np.array([1.0, -1.0, 1.0])}, "process is not positive semidefinite"),
        ({"noise": np.array([[1.0, 2.0], [2.0, 1.0]])}, "noise is not positive definite"),
        ({"initial_covariance": np.zeros((3, 3))}, "initial_covariance is not positive definite"),
        ({"initial_mean": np.zeros(1)}, "initial_mean has shape"),
    ],
)
def test_wrong_covariances(change, message, linear):
    model, z, u = linear
    good = {"process": Q, "noise": R, "initial_mean": np.zeros(3), "initial_covariance": np.eye(3)}
    with pytest.raises(InputError, match=message):
        unscented_filter(model, z, u, **(good | change))


def test_wrong_shapes(linear):
    model, z, u = linear
    good = {"process": Q, "noise": R, "initial_mean": np.zeros(3), "initial_covariance": np.eye(3)}
    with pytest.raises(InputError, match="measurements has shape"):
        extended_filter(model, z[:1], u, **good)
    with pytest.raises(InputError, match="inputs has shape"):
        extended_filter(model, z, u[:, :5], **good)
