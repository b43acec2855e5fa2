"""Performance from simulation against the same from the model's responses, and modes against closed forms."""

import math

import numpy as np
import pytest

from experiments.isolation.floors import flat_floor
from experiments.isolation.performance import (
    central_axes,
    expected_density,
    record_case,
    reduction_db,
)
from experiments.isolation.steady import steady_state
from experiments.isolation.twin import load_twin
from notebooks.isolation import transmissibility
from notebooks.isolation.floor_and_paths import suspension_modes
from notebooks.isolation.power import without_lines
from notebooks.isolation.transmissibility import band_means, exact_transmissibility
from stillwork.signals.spectra import Spectrum


@pytest.fixture(scope="module")
def twin():
    return load_twin("rigid_body").varied(mains_hz=[], floor_mains=[], platform_mains=[])


@pytest.fixture(scope="module")
def weights(twin):
    return steady_state(twin, flat_floor()).weights


def expected_of(twin, case):
    """The twin without skyhook gain, where the simulation runs without feedback."""
    return twin.varied(gain=0.0) if case == "passive" else twin


def test_axes_undo_the_sensors_geometry(twin):
    axes = central_axes(twin.rig)
    assert axes.floor @ axes.floor_readings == pytest.approx(np.eye(3), abs=1e-12)
    motion = np.array([0.0, 0.0, 0.3, -0.2, 0.7, 0.0])
    assert axes.platform @ (twin.rig.platform_sensors.jacobian @ motion) == pytest.approx(motion[2:5])


@pytest.mark.slow
@pytest.mark.parametrize("case", ["passive", "feedback", "FeRLS"])
def test_simulated_spectra_agree_with_the_expected_ones(twin, weights, case):
    given = weights if case.startswith("Fe") else None
    record = record_case(twin, flat_floor(), case, 30.0, 3, weights=given)
    causes = expected_density(expected_of(twin, case), flat_floor(), np.arange(1.0, 401.0), weights=given)
    expected = sum(causes.values())
    spectrum = record.spectrum(1.0)
    # 59 half-overlapping segments of 1 s; the suspension's skirts leak below 20 Hz.
    for low, high in ((20, 100), (100, 200), (200, 300), (300, 400)):
        ratio = spectrum.density[:, low:high].sum(axis=1) / expected[:, low - 1 : high - 1].sum(axis=1)
        assert ratio == pytest.approx(1, abs=0.12)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["passive", "feedback", "FeRLS"])
def test_estimated_transmissibility_agrees_with_the_exact_one_without_noise(twin, weights, case):
    given = weights if case.startswith("Fe") else None
    estimate = record_case(twin, flat_floor(1500.0), case, 40.0, 5, weights=given, noise=False).response(0.5)
    band = (estimate.frequencies_hz > 8) & (estimate.frequencies_hz < 300)
    exact = exact_transmissibility(expected_of(twin, case), estimate.frequencies_hz[band], weights=given)
    scale = np.abs(np.einsum("iif->if", exact)).max(axis=1)
    error = np.abs(estimate.response[:, :, band] - exact)
    assert np.einsum("iif->if", error).max(axis=1) / scale == pytest.approx(0, abs=0.05)


def test_platform_follows_the_floor_at_low_frequency_and_rolls_off(twin):
    passive = exact_transmissibility(expected_of(twin, "passive"), np.array([0.5, 35.2, 1000.0]))
    assert np.abs(passive[:, :, 0]) == pytest.approx(np.eye(3), abs=2e-3)
    assert abs(passive[0, 0, 1]) == pytest.approx(1 / (2 * 0.12), rel=0.05)  # resonance: 1 / 2 zeta
    assert abs(passive[0, 0, 2]) < 0.02


def test_reduction_in_bands_of_a_constant_factor():
    f = np.arange(0.0, 260.0, 0.25)
    before = np.ones((3, 3, 1)) * np.exp(1j * f)
    centres, found = reduction_db(f, before, before / 100)
    assert found == pytest.approx(40.0) and centres[0] < 3.2 and centres[-1] > 200


def test_lines_are_bridged():
    f = np.arange(0.0, 100.0)
    density = 2.0 + 0.1 * f[None]
    spoiled = density.copy()
    spoiled[0, 49:52] = 50.0
    assert without_lines(Spectrum(f, spoiled, 9), [50.0]).density == pytest.approx(density)


def test_modes_of_the_open_loop_are_those_of_the_rig(twin):
    found = suspension_modes(twin, feedback=False)
    assert found.frequencies_hz == pytest.approx(twin.rig.frequencies_hz, rel=1e-3)
    assert found.damping == pytest.approx(twin.rig.damping_ratios(), rel=2e-3)


def test_skyhook_damps_every_mode_about_as_an_ideal_one(twin):
    closed, ideal = suspension_modes(twin), twin.rig.damping_ratios(twin.skyhook.gain)
    # Lag and delay act as a phase of w (T + tau), up to 16 degrees at 47 Hz.
    assert closed.damping == pytest.approx(ideal, rel=0.15)
    assert np.all(closed.damping > suspension_modes(twin, feedback=False).damping)


def test_a_band_holds_the_lines_of_a_twelfth_of_an_octave_and_a_line_near_the_mains_itself():
    f = np.arange(8, 400) / 4  # Hz; the mains at 50 keeps the five lines from 49.5 to 50.5
    response = np.random.default_rng(5).standard_normal((3, 3, f.size)).astype(complex)
    groups = {}
    for place, hertz in enumerate(f):
        alone = 49.4 < hertz < 50.6
        key = ("line", place) if alone else ("band", hertz > 50, math.floor(12 * math.log2(hertz)))
        groups.setdefault(key, []).append(place)
    centres, means = band_means(f, {"r": response}, [50.0])
    np.testing.assert_allclose(centres, [f[group].mean() for group in groups.values()])
    wanted = np.stack([response[:, :, group].mean(axis=2) for group in groups.values()], axis=2)
    np.testing.assert_allclose(means["r"], wanted)


@pytest.mark.slow
@pytest.mark.parametrize("damping, pole", [(65.0, 300.0), (5.0, 2400.0)])
def test_more_is_amplified_than_reduced_where_zeros_lie_outside_the_circle(damping, pole):
    """Jensen's formula, the zeros counted by the winding of the ratio's phase (argument principle)."""
    twin = transmissibility.rigid_body(damping, pole)
    weights = steady_state(twin, flat_floor(1500.0)).weights
    f = np.append(np.arange(0.005, 2500.0, 0.02), 2499.999)
    with_it, without = (
        np.einsum("iif->if", exact_transmissibility(twin, f, weights=each)) for each in (weights, None)
    )
    half_turns = np.diff(np.unwrap(np.angle(with_it / without))[:, [0, -1]], axis=1)[:, 0] / np.pi
    outside = -np.rint(half_turns)  # each zero outside takes half a turn from 0 to half the rate
    reduced, amplified = transmissibility.amplification(twin, weights).T
    assert np.array_equal(amplified > 1.001 * reduced, outside > 0)
    assert np.all(amplified > 0.999 * reduced)
