"""Identification, the two-inertia drive and the fit of a known structure."""

import numpy as np
import pytest

from experiments.motion.machines import as_stage, drive, published_noise
from notebooks.motion.two_inertia_drive import (
    closed_loop_response,
    drive_loop,
    drive_observer,
    seen_by_controller,
)
from stillwork.control.applications import Application
from stillwork.control.machine_loops import encirclement_difference, observed_loops, on_measurement
from stillwork.control.pid import PidFamily
from stillwork.identification.frequency_response import Identified
from stillwork.identification.modal_fit import fit_modes
from stillwork.lti import ModalModel, StateModel, simulate
from stillwork.lti.modal import mirrored

PLANT = drive()
TRUE = ModalModel(
    2 * np.pi * np.array([0.0, 800.0, 1500.0]),
    np.array([0.0, 1e-3, 3e-3]),
    np.array([[1.0], [0.7], [0.4]]),
    np.array([[1.0, -0.7, 0.4]]),
    np.array([[2e-10]]),
)


def accelerance(model: ModalModel, hertz: np.ndarray) -> Identified:
    omega = 2 * np.pi * hertz
    return Identified(omega, -(omega**2) * model.frequency_response(omega)[0, 0], np.ones_like(omega))


@pytest.mark.slow
def test_closed_loop_estimate_is_free_of_the_bias_of_the_direct_one():
    """Integrator under feedback with strong noise: the direct ratio tends to the inverse of the controller."""
    rng = np.random.default_rng(0)
    n, noise = rng.normal(size=(2, 400_000))
    loop = StateModel(
        np.array([[0.8]]),
        np.array([[0.1, -0.2]]),
        np.array([[1.0], [-2.0]]),
        np.array([[0, 1.0], [1, -2]]),
        1.0,
    )
    y, u = simulate(loop, np.array([n, 2 * noise]))
    found = closed_loop_response(n, u, y, 1.0, 1024)
    exact = 0.1 / (np.exp(1j * found.omega) - 1)
    inside = (found.omega > 0.05) & (found.omega < 0.5)
    assert np.median(np.abs(found.response[inside] / exact[inside] - 1)) < 0.2
    direct = closed_loop_response(u, u, y, 1.0, 1024)
    assert np.median(np.abs(direct.response[inside] / exact[inside] - 1)) > 0.5


def test_drive_observer_separates_rigid_and_flexible():
    observer = drive_observer(PLANT)
    assert observer.residual < 1e-10
    assert PLANT.resonance / (2 * np.pi) == pytest.approx(18.94, abs=0.01)
    omega = np.array([10.0, PLANT.resonance, 300.0])
    loop = drive_loop(PLANT, PLANT, Application(compensate=True), 4.0)
    rigid = PLANT.motor_constant / (1j * omega * (2j * omega * PLANT.inertia + 2 * PLANT.friction))
    np.testing.assert_allclose(seen_by_controller(loop, omega), rigid, rtol=1e-8)


@pytest.mark.slow
def test_fit_recovers_a_known_structure():
    fit = fit_modes(accelerance(TRUE, np.arange(100.0, 2000.0, 0.5)), [797.0, 1505.0], (110.0, 1990.0))
    np.testing.assert_allclose(fit.model.frequencies, TRUE.frequencies, rtol=1e-6)
    np.testing.assert_allclose(fit.model.damping, TRUE.damping, rtol=1e-3)
    residues = fit.model.input_shapes[:, 0] * fit.model.output_shapes[0]
    np.testing.assert_allclose(residues, [1.0, -0.49, 0.16], rtol=1e-3)
    assert fit.model.feedthrough[0, 0] == pytest.approx(2e-10, rel=1e-2)
    assert fit.rms_error < 1e-4


def both_sensors(stage):
    return stage, mirrored(stage)


@pytest.mark.slow
def test_an_encirclement_is_counted():
    stage, factor = as_stage(
        fit_modes(accelerance(TRUE, np.arange(100.0, 2000.0, 0.5)), [797.0, 1505.0], (110.0, 1990.0)), 12.5
    )
    loop = observed_loops(both_sensors(stage), None, 3, published_noise(), None)[0]
    data = accelerance(TRUE, np.arange(100.0, 2000.0, 0.05))
    loops = observed_loops(both_sensors(stage), None, 3, published_noise(), None)
    for hertz, turns in ((40.0, 0), (100.0, -1)):
        controller = PidFamily(12.5)(hertz)
        # The mirror image is unstable where its loop turns around -1 more often than that of the stable model.
        unstable = [not each.is_stable(controller) for each in loops]
        assert unstable == [False, turns != 0]
        assert (
            encirclement_difference(
                on_measurement(loop, data, factor, (300.0, 1900.0), mirror=True), controller
            )
            == turns
        )
