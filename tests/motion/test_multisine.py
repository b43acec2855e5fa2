"""Multisine identification: exactness without noise, the expected variance with it, the bias that it avoids."""

from dataclasses import astuple, replace

import numpy as np
import pytest

from experiments.motion.rig import assumed_geometry, rig_model
from experiments.motion.rig_designs import published_settings
from notebooks.motion.rig_identification import (
    direct_response,
    fit_modal_matrix,
    joint_input_output,
    rig_experiment,
    run_multisine,
)
from stillwork.estimation.observer import NoiseIntensities
from stillwork.lti import ModalModel, simulate
from stillwork.lti.discretisation import zoh_modes, zoh_response

GEOMETRY = assumed_geometry()
SETTINGS = published_settings()
QUIET = replace(SETTINGS, noise=NoiseIntensities(1e-24, 1e-36))


def records_of(settings, bandwidth_hz, seed, rms, realisations, **experiment):
    """The four experiments with the noise of the settings, at every actuator and sensor."""
    loop, rng = rig_experiment(GEOMETRY, settings, bandwidth_hz).loop(), np.random.default_rng(seed)
    deviations = tuple(np.sqrt(astuple(settings.noise)))
    return run_multisine(loop, 4, 4, deviations, rng, rms=rms, realisations=realisations, **experiment)


def test_identification_loop_is_the_loop_by_hand():
    """Sample by sample: plant, controller in difference form, every signal where it belongs."""
    experiment = rig_experiment(GEOMETRY, SETTINGS, 4.0)
    loop = experiment.loop()
    rng = np.random.default_rng(2)
    signals = rng.standard_normal((12, 40)) * np.repeat([1.0, 0.5, 1e-7], 4)[:, None]
    ours = simulate(loop, signals)
    plant = zoh_modes(rig_model(GEOMETRY), SETTINGS.sample_time)
    controller = experiment.controller
    x, s = np.zeros(len(plant.a)), np.zeros(len(controller.a))
    for k in range(40):
        added, disturbance, noise = signals[:4, k], signals[4:8, k], signals[8:, k]
        y = plant.c @ x + noise
        f = controller.c @ s - controller.d @ y + added
        np.testing.assert_allclose(ours[:4, k], f, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(ours[4:, k], y, rtol=1e-6, atol=1e-14)
        s = controller.a @ s - controller.b @ y
        x = plant.a @ x + plant.b @ (f + disturbance)


@pytest.fixture(scope="module")
def noisy():
    """Sensor noise only: force noise leaks between lines, because what it leaves in the plant is not periodic."""
    noise = replace(SETTINGS, noise=NoiseIntensities(1e-20, 1e-18))
    return records_of(noise, 4.0, 3, 0.3, 6, samples=4096, settling=9)


def test_without_noise_the_plant_comes_out():
    experiment = rig_experiment(GEOMETRY, QUIET, 5.0)
    records = run_multisine(
        experiment.loop(),
        4,
        4,
        (0.0, 0.0),
        np.random.default_rng(1),
        samples=4096,
        realisations=2,
        periods=1,
        settling=8,  # 3.3 s: the first mode has died out to 1e-3
    )
    for estimate in (joint_input_output(records).response, direct_response(records)):
        truth = experiment.response(records.omega)
        assert np.linalg.norm(estimate - truth) < 2e-3 * np.linalg.norm(truth)


@pytest.mark.slow
def test_deviation_is_what_the_noise_predicts(noisy):
    estimate = joint_input_output(noisy)
    noise = replace(SETTINGS, noise=NoiseIntensities(1e-20, 1e-18))
    experiment = rig_experiment(GEOMETRY, noise, 4.0)
    expected = experiment.deviation(estimate.omega, 0.3, 6 * 2)
    chosen = estimate.omega > 2 * np.pi * 20
    ratio = np.mean((estimate.deviation / expected)[chosen] ** 2)
    assert ratio == pytest.approx(1, abs=0.05)
    slow = (estimate.omega > 2 * np.pi * 2) & (estimate.omega < 2 * np.pi * 20)  # where the loop acts
    assert np.mean((estimate.deviation / expected)[slow] ** 2) == pytest.approx(1, abs=0.3)
    error = np.abs(estimate.response - experiment.response(estimate.omega))
    assert np.mean((error / expected)[chosen] ** 2) == pytest.approx(1, abs=0.1)


def _small_plant():
    return ModalModel(
        np.array([0.0, 0.0, 600.0, 640.0, 2500.0]),
        np.array([0.0, 0.0, 0.01, 0.004, 0.002]),
        np.array([[1.0, 1.0], [1.0, -1.0], [1.0, 0.3], [-0.5, 0.8], [0.7, 0.6]]),
        np.array([[1.0, 1.0, 0.9, 0.4, 0.5], [1.0, -1.0, -0.7, 0.8, 0.2]]),
        np.array([[2e-8, 1e-8], [0.0, 1e-8]]),
    )


def test_exact_response_gives_back_the_modes():
    plant, sample_time = _small_plant(), 2e-4
    omega = 2 * np.pi * np.linspace(5, 600, 600)
    response = _held(plant, sample_time, omega)
    fit = fit_modal_matrix(omega, response, np.full(len(omega), 1e-9), 3, sample_time, 2)
    np.testing.assert_allclose(fit.model.frequencies[2:], plant.frequencies[2:], rtol=1e-6)
    np.testing.assert_allclose(fit.model.damping[2:], plant.damping[2:], rtol=1e-4)
    np.testing.assert_allclose(fit.model.feedthrough, plant.feedthrough, atol=1e-10)
    for k in range(2, 5):
        residue = np.outer(fit.model.output_shapes[:, k], fit.model.input_shapes[k])
        np.testing.assert_allclose(
            residue, np.outer(plant.output_shapes[:, k], plant.input_shapes[k]), rtol=1e-3, atol=1e-4
        )
    assert fit.rank_one.max() < 1e-3


def _held(plant, sample_time, omega):
    """Sampled response, the compliance late by half a sample."""
    modes = zoh_response(replace(plant, feedthrough=0 * plant.feedthrough), sample_time, omega)
    late = (1 + np.exp(-1j * omega * sample_time)) / 2
    return np.moveaxis(modes + plant.feedthrough[:, :, None] * late, -1, 0)


@pytest.mark.slow
def test_stated_deviations_are_those_of_many_draws():
    plant, sample_time, rng = _small_plant(), 2e-4, np.random.default_rng(5)
    omega = 2 * np.pi * np.linspace(20, 500, 120)
    response = _held(plant, sample_time, omega)
    size = np.full(len(omega), 2e-8)
    found = []
    for _ in range(9):
        noise = (rng.standard_normal(response.shape) + 1j * rng.standard_normal(response.shape)) / np.sqrt(2)
        found.append(fit_modal_matrix(omega, response + 2e-8 * noise, size, 3, sample_time, 2))
    frequencies = np.array([each.model.frequencies[2:] for each in found])
    spread = np.sqrt(np.mean((frequencies - plant.frequencies[2:]) ** 2, axis=0))
    stated = np.mean([each.deviation for each in found], axis=0)
    np.testing.assert_allclose(spread / stated, 1, atol=0.55)
    damping = np.array([each.model.damping[2:] for each in found])
    spread = np.sqrt(np.mean((damping - plant.damping[2:]) ** 2, axis=0))
    np.testing.assert_allclose(spread / np.mean([f.damping_deviation for f in found], axis=0), 1, atol=0.55)
    assert np.mean([each.misfit for each in found]) == pytest.approx(1, abs=0.08)


def test_compliance_of_a_mode_above_the_band_is_found():
    """A constant would take the growth towards the resonance for compliance: 26 % off."""
    plant, sample_time = _small_plant(), 1e-4
    plant = replace(plant, feedthrough=0 * plant.feedthrough)
    omega = 2 * np.pi * np.linspace(5, 280, 200)  # the last mode stands at 398 Hz
    response = np.moveaxis(zoh_response(plant, sample_time, omega), -1, 0)
    fit = fit_modal_matrix(omega, response, np.full(len(omega), 1e-9), 2, sample_time, 2)
    exact = plant.modes([4]).compliance()
    assert np.linalg.norm(fit.model.feedthrough - exact) < 0.015 * np.linalg.norm(exact)  # two terms: 5 %
