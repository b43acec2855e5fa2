"""Tracking errors of the rig against long simulations, and the study over geometries."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg

from experiments.motion.rig import (
    POSITIONS,
    assumed_geometry,
    rig_model,
)
from experiments.motion.rig_designs import (
    observer_model,
    published_settings,
    rig_controllers,
    rig_loops,
)
from experiments.motion.rig_study import levelling, levelling_rms, output_variance
from notebooks.motion.over_actuated_rig import levelling_error, placed_damping
from notebooks.motion.rig_over_geometries import flexible_peaks
from stillwork.base.checks import InputError
from stillwork.estimation.observer import NoiseIntensities

GEOMETRY = assumed_geometry()
SETTINGS = published_settings()
PIDS = rig_controllers(GEOMETRY.edge_masses)(4.0, 5.0)
SILENT = NoiseIntensities(1e-30, 1e-40)


@pytest.fixture(scope="module")
def loops():
    return rig_loops(GEOMETRY, SETTINGS, positions=POSITIONS[:1])


def test_output_variance_solves_the_lyapunov_equation():
    rng = np.random.default_rng(1)
    a = rng.standard_normal((6, 6))
    a *= 0.999 / np.abs(linalg.eigvals(a)).max()
    b, c, d = rng.standard_normal((6, 2)), rng.standard_normal((3, 6)), rng.standard_normal((3, 2))
    covariance = linalg.solve_discrete_lyapunov(a, b @ b.T)
    expected = np.diag(c @ covariance @ c.T + d @ d.T)
    np.testing.assert_allclose(output_variance(a, b, c, d), expected, rtol=1e-9)
    with pytest.raises(InputError, match=r"^a\b.*stable"):
        output_variance(np.eye(1), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)))


def test_rigid_plate_follows_the_trajectory_exactly(loops):
    """Without flexible modes and noise the held feedforward force moves the plate through every sample."""
    original = loops["Original"][0]
    rigid = replace(original, plant=original.plant.modes(slice(0, 3)))
    trajectory = levelling(np.random.default_rng(3))
    assert np.all(levelling_rms(rigid, PIDS, trajectory, SILENT) < 1e-10)
    flexible = levelling_rms(original, PIDS, trajectory, SILENT)
    assert np.all(flexible > 1e-9)


@pytest.mark.slow
def test_expected_rms_is_that_of_simulations(loops):
    """Without noise to the digits that settling leaves, with noise within the scatter of a few periods."""
    loop = loops["MC and AD"][0]
    trajectory = levelling(np.random.default_rng(4))
    error = levelling_error(loop, PIDS, trajectory, SILENT, np.random.default_rng(0), periods=2)
    np.testing.assert_allclose(
        np.sqrt((error**2).mean(axis=1)), levelling_rms(loop, PIDS, trajectory, SILENT), rtol=2e-3
    )
    noise = NoiseIntensities(1e-4, 1e-18)
    errors = [levelling_error(loop, PIDS, trajectory, noise, np.random.default_rng(k)) for k in range(6)]
    ratio = np.sqrt(np.mean(np.square(errors), axis=(0, 2))) / levelling_rms(loop, PIDS, trajectory, noise)
    np.testing.assert_allclose(ratio, 1, atol=0.25)


def test_flexible_part_is_that_of_the_modes(loops):
    """Without observer: the difference from the rigid body, mode by mode, at the first resonance."""
    found = flexible_peaks(loops["Original"])
    plant, d = loops["Original"][0].plant, loops["Original"][0].decoupling
    residue = d.sensing @ np.outer(plant.output_shapes[:, 3], plant.input_shapes[3]) @ d.actuation
    peak = np.linalg.norm(residue, 2) / (2 * plant.damping[3] * plant.frequencies[3] ** 2)
    assert found.peaks[0] == pytest.approx(peak, rel=0.02)
    static = d.sensing @ plant.compliance() @ d.actuation
    assert found.coupling == pytest.approx(np.abs(static[~np.eye(3, dtype=bool)]).mean(), rel=0.05)


@pytest.mark.slow
def test_placed_poles_have_the_wanted_damping():
    model = observer_model(rig_model(GEOMETRY)).at(GEOMETRY.used, POSITIONS[0])
    np.testing.assert_allclose(placed_damping(model, 0.04, SETTINGS.sample_time), 0.04, atol=1e-6)
