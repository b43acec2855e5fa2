"""The oracle of the steady state against closed forms, against simulation, and where it must refuse."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from experiments.isolation.floors import ShapedFloor, flat_floor
from experiments.isolation.simulation import simulate
from experiments.isolation.steady import default_grid, steady_state
from experiments.isolation.twin import load_twin
from stillwork.base.checks import InputError
from stillwork.estimation.adaptive import FeRls

RIGID, FITTED = load_twin("rigid_body"), load_twin("fitted")
NOISELESS = {"floor_noise": 0.0, "platform_noise": 0.0}
QUIET = {"mains_hz": [], "floor_mains": [], "platform_mains": []}


def band_floor(low_hz, high_hz):
    sections = signal.butter(2, [low_hz, high_hz], "bandpass", fs=5000, output="sos")
    return ShapedFloor(np.repeat(sections[None], 3, axis=0), np.full(3, 1.5e-3 * 50))


@pytest.mark.slow
@pytest.mark.parametrize("twin", [RIGID, FITTED])
@pytest.mark.parametrize("low_pass_hz", [80.0, 1500.0])
def test_grid_is_fine_enough(twin, low_pass_hz):
    floor = flat_floor(low_pass_hz)
    grid = default_grid(twin)
    finer = np.sort(np.concatenate([grid, (grid[1:] + grid[:-1]) / 2]))
    one, two = steady_state(twin, floor), steady_state(twin, floor, frequencies_hz=finer)
    assert one.weights == pytest.approx(two.weights, abs=2e-4)
    assert one.covariance == pytest.approx(two.covariance, rel=1e-3, abs=1e-4)
    assert one.error_power == pytest.approx(two.error_power, rel=1e-3)


def test_a_perfect_estimate_without_delay_converges_like_one():
    """Without the skyhook's and the conditioner's phase the path error is one sample of delay alone."""
    path, one = FITTED.feedforward.path, np.eye(6)
    perfect = replace(
        FITTED.plant, mass=path.mass * one, damping=path.damping * one, stiffness=path.stiffness * one
    )
    twin = replace(FITTED, plant=perfect).varied(
        gain=0.0, parasitic_gain=0.0, conditioning_highpass_hz=1e-3, conditioning_lowpass_hz=1e6
    )
    steady = steady_state(twin.varied(**NOISELESS), flat_floor(30.0))
    assert steady.rls_eigenvalues.real == pytest.approx(1, abs=5e-3)
    # FeLMS then sees the spread of R itself, the same for every actuator.
    spread = np.repeat(np.linalg.eigvalsh(steady.correlation) / np.trace(steady.correlation), 6)
    assert np.sort(steady.lms_eigenvalues.real) == pytest.approx(spread, rel=1e-2)
    assert steady.least_error_power <= steady.error_power <= 1.001 * steady.least_error_power


@pytest.mark.slow
@pytest.mark.parametrize("twin", [RIGID, FITTED])
def test_simulated_moments_agree(twin):
    floor = flat_floor(80.0)
    twin = twin.varied(**QUIET)
    steady = steady_state(twin, floor)
    run = simulate(twin, floor, 125.0, weights=steady.weights, seed=2, signals_from_s=5.0)
    psi = run.filtered_regressors
    scale = np.sqrt(np.diag(steady.correlation))
    found = psi @ psi.T / psi.shape[1]
    # About 7000 independent samples in 120 s of an 80 Hz band above 6 Hz.
    assert found / np.outer(scale, scale) == pytest.approx(
        steady.correlation / np.outer(scale, scale), abs=0.08
    )
    power = np.mean(np.sum(run.error**2, axis=0))
    assert power == pytest.approx(steady.error_power, rel=0.03)
    cross = run.error @ psi.T / psi.shape[1] / np.outer(np.sqrt(np.mean(run.error**2, axis=1)), scale)
    assert np.abs(cross).max() < 0.06


@pytest.mark.slow
def test_adaptation_ends_at_the_fixed_point():
    floor = flat_floor(80.0)
    twin = FITTED.varied(**QUIET, platform_noise=1e-6)
    steady = steady_state(twin, floor)
    start = FeRls(np.diag(steady.covariance), forgetting=1 - 1e-5)
    run = simulate(twin, floor, 150.0, adaptation=start, weights=0.5 * steady.weights, seed=1)
    assert run.final_weights == pytest.approx(steady.weights, abs=2e-3)
    assert run.covariance.diagonal() == pytest.approx(
        np.diag(steady_state(twin, floor, forgetting=1 - 1e-5).covariance), rel=0.25
    )


@pytest.mark.slow
@pytest.mark.parametrize(("floor", "stable"), [(band_floor(20.0, 24.0), False), (flat_floor(80.0), True)])
def test_growth_of_a_horizontal_error_is_predicted(floor, stable):
    """Weights that push the platform sideways: slowest eigenvalue against the simulated rate."""
    steady = steady_state(RIGID.varied(**NOISELESS), floor)
    slowest = steady.rls_eigenvalues.real.min()
    assert (slowest > 0) == stable
    sideways = RIGID.rig.struts.jacobian[:, 0] / np.linalg.norm(RIGID.rig.struts.jacobian[:, 0])
    run = simulate(
        RIGID,
        floor,
        150.0,
        adaptation=FeRls(steady.covariance, growth_limit=np.inf),
        weights=steady.weights + 1e-3 * np.outer(sideways, np.ones(9)),
        noise=False,
        seed=1,
    )
    off = np.einsum("a,kar->kr", sideways, run.weights - steady.weights)
    size = np.sqrt(np.einsum("ki,ij,kj->k", off, steady.correlation, off))
    rate = 10 * np.polyfit(run.time_s[500:], np.log(size[500:]), 1)[0]
    assert rate == pytest.approx(-slowest, rel=0.15)


def test_a_silent_floor_is_refused():
    silent = ShapedFloor(flat_floor(80.0).sections, np.array([0.0, 1.0, 1.0]))
    with pytest.raises(InputError, match=r"^floor\b"):
        steady_state(RIGID.varied(**NOISELESS), silent)
    with pytest.raises(InputError, match=r"^forgetting\b"):
        steady_state(RIGID, flat_floor(80.0), forgetting=1.0)


@pytest.mark.parametrize("pole_hz", [300.0, 2400.0, 16e3])
@pytest.mark.parametrize("twin", [RIGID, FITTED])
@pytest.mark.parametrize("low_pass_hz", [80.0, 1500.0])
def test_the_mean_converges_with_any_pole_in_the_path_estimate_and_faster_with_the_printed_one(
    twin, low_pass_hz, pole_hz
):
    """16 kHz is as good as none: the statement that it takes the pole hangs on no choice of it."""
    printed, other = (
        steady_state(
            twin.varied(path=replace(twin.feedforward.path, actuator_pole=2 * np.pi * hz)),
            flat_floor(low_pass_hz),
        ).rls_eigenvalues.real.min()
        for hz in (300.0, pole_hz)
    )
    assert 0 < other <= printed
