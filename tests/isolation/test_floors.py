"""Floors against the densities they promise, independent draws of noise, and the shipped ground spectra."""

import numpy as np
import pytest

from experiments.isolation.floors import FLAT_LEVEL, SAMPLE_RATE, coloured_floor, flat_floor
from experiments.isolation.recorded_floors import (
    GROUND_CRITERION,
    ground_spectrum,
    measured_ground_density,
)
from notebooks.isolation.numerical_stability import ground_floor, record_floor, synthesise_floor
from stillwork.signals.criteria import CRITERIA, criterion_density, one_third_octave_velocity
from stillwork.signals.records import Record
from stillwork.signals.spectra import estimate_spectrum


def relative_spread(spectrum, lines):
    """Standard deviation of a mean over `lines` lines; half-overlapping Hann segments count about half each twice."""
    return 1 / np.sqrt(0.9 * spectrum.averages * lines)


def test_flat_floor_has_the_published_plateau_and_corners():
    literal = flat_floor(1500.0)
    plateau = np.sqrt(literal.density(np.array([20.0, 100.0, 300.0])))
    assert plateau == pytest.approx(FLAT_LEVEL, rel=1e-3)
    corners = np.sqrt(flat_floor(80.0).density(np.array([3.0, 80.0])))
    assert corners == pytest.approx(FLAT_LEVEL / np.sqrt(2), rel=2e-3)
    decade = np.sqrt(literal.density(np.array([0.03, 0.3])))
    assert decade[:, 1] / decade[:, 0] == pytest.approx(100, rel=2e-2)  # second order


def test_coloured_floor_raises_only_its_bands():
    f = np.array([5.0, 40.0, 60.0, 90.0, 150.0, 400.0])
    ratio = np.sqrt(coloured_floor(1500.0, gain=4.0).density(f) / flat_floor(1500.0).density(f))[0]
    assert ratio[[2, 4]] == pytest.approx(4.0, rel=0.15)  # the tail of the other peak
    assert np.all(ratio[[1, 3]] > 2.5) and np.all(ratio[[0, 5]] < 1.3)


@pytest.mark.slow
@pytest.mark.parametrize("floor", [flat_floor(80.0), flat_floor(1500.0), coloured_floor(80.0)])
def test_realisation_has_the_promised_density(floor):
    motion = floor.acceleration(400_000, seed=3)
    spectrum = estimate_spectrum(motion[:, 20_000:], SAMPLE_RATE, 2.0)
    f = spectrum.frequencies_hz
    for low, high in ((5, 30), (30, 100), (100, 300)):
        band = (f >= low) & (f < high)
        ratio = np.mean(spectrum.density[:, band] / floor.density(f[band]), axis=1)
        assert ratio == pytest.approx(1, abs=5 * relative_spread(spectrum, band.sum()) + 0.005)


def test_sensors_are_shaken_independently_and_reproducibly():
    motion = flat_floor().acceleration(200_000, seed=1)
    assert np.abs(np.corrcoef(motion) - np.eye(3)).max() < 0.05
    assert np.array_equal(motion, flat_floor().acceleration(200_000, seed=1))
    assert not np.array_equal(motion, flat_floor().acceleration(200_000, seed=2))


def test_synthesis_has_exactly_the_expected_density_line_by_line():
    f = np.array([2.0, 40.0, 200.0])
    s = np.array([1e-6, 4e-6, 1e-8])

    def one_second(seed):
        return synthesise_floor(f, s, 1.0, seed, sample_rate=500.0).acceleration

    lines = np.mean(
        [2 * np.abs(np.fft.rfft(one_second(seed), axis=1)) ** 2 / 500**2 for seed in range(400)],
        axis=(0, 1),
    )
    grid = np.arange(len(lines))  # Hz
    inside = (grid >= 2) & (grid <= 200)
    expected = np.interp(grid[inside], f, s)
    ratio = lines[inside] / expected  # 1200 independent exponential draws each
    assert np.abs(ratio - 1).max() < 5 / np.sqrt(1200)
    assert np.mean(ratio) == pytest.approx(1, abs=4 / np.sqrt(1200 * inside.sum()))
    assert np.all(lines[~inside] < 1e-20)


@pytest.mark.slow
def test_synthesis_up_to_the_nyquist_line_keeps_the_power():
    f, s = np.array([1.0, 50.0]), np.array([1.0, 1.0])
    power = [synthesise_floor(f, s, 0.2, seed, sample_rate=100.0).acceleration.var() for seed in range(2000)]
    # Ten lines of 5 Hz, the last at the Nyquist frequency.
    assert np.mean(power) == pytest.approx(50.0, abs=5 * np.std(power) / np.sqrt(2000))


def just_meeting(criterion, duration, seed, **options):
    """A floor that just meets a criterion in every band from 1 Hz on."""
    f = np.geomspace(1.0, 300.0, 400)
    return synthesise_floor(f, criterion_density(criterion, f), duration, seed, **options)


def test_common_share_is_the_correlation_between_sensors():
    for share in (0.0, 0.6, 1.0):
        motion = just_meeting("VC-C", 20.0, 0, common=share).acceleration
        assert np.corrcoef(motion)[np.triu_indices(3, 1)] == pytest.approx(share, abs=0.06)


def test_a_floor_of_a_criterions_density_meets_it():
    floor = just_meeting("VC-D", 100.0, 1)
    spectrum = estimate_spectrum(floor.acceleration, SAMPLE_RATE, 0.1)
    centres, velocity = one_third_octave_velocity(spectrum.frequencies_hz, spectrum.density.mean(axis=0))
    judged = (centres > 1.9) & (centres < 81)
    assert velocity[judged] == pytest.approx(6.25e-6, rel=0.06)


@pytest.mark.slow
def test_ground_is_the_measured_one_below_100_hz_and_the_criterion_above():
    f, density = measured_ground_density()
    spectrum = estimate_spectrum(ground_floor(200.0, 1).acceleration, SAMPLE_RATE, 0.5)
    for low, high in ((2.0, 20.0), (20.0, 95.0)):
        band = spectrum.power(low, high).mean()
        inside = (f > low) & (f < high)
        assert band == pytest.approx(np.trapezoid(density[inside], f[inside]), rel=0.05)
    above = spectrum.power(120.0, 290.0).mean()
    grid = np.linspace(120, 290, 500)
    assert above == pytest.approx(np.trapezoid(criterion_density(GROUND_CRITERION, grid), grid), rel=0.02)
    assert ground_spectrum().density(np.array([150.0, 400.0])) == pytest.approx(
        np.tile([criterion_density(GROUND_CRITERION, [150.0])[0], 0.0], (3, 1)), rel=1e-3
    )
    loud = ground_floor(5.0, 1, gain=10.0).acceleration
    np.testing.assert_allclose(loud, 10 * ground_floor(5.0, 1).acceleration, rtol=1e-12, atol=1e-12)


def test_the_criterion_above_is_the_nearest_one():
    f, density = measured_ground_density()
    end = np.median(density[f > 95])
    names = [name for name in CRITERIA if name.startswith("VC")]
    distance = [abs(np.log(criterion_density(name, [100.0])[0] / end)) for name in names]
    assert names[int(np.argmin(distance))] == GROUND_CRITERION


def test_record_becomes_a_floor():
    t = np.arange(4000) / 800.0
    record = Record(np.sin(2 * np.pi * 30 * t)[None] + 9.81, 800.0, "m/s^2", ("z",), "z.csv")
    floor = record_floor(record)
    assert floor.channels == 3 and floor.sample_rate == SAMPLE_RATE and floor.source == "z.csv"
    assert floor.duration == pytest.approx(5.0)
    fine = np.sin(2 * np.pi * 30 * np.arange(25_000) / SAMPLE_RATE)
    assert np.abs(floor.acceleration - fine)[:, 1000:-1000].max() < 2e-3
