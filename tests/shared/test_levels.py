"""Peaks, and the rms of the next stretch: exceeded as often as is said, by processes that know nothing of the formula."""

import numpy as np
import pytest

from stillwork.signals.levels import expected_peak, next_peak, next_rms

RATE, DRAWS = 8.0, 300


def peak_at(hertz, width):
    return lambda f: np.exp(-0.5 * (np.log(np.maximum(f, 1e-9) / hertz) / width) ** 2)


def gaussian(rng, shape, seconds):
    """Two stretches of each of the draws of a Gaussian process, one length apart."""
    count = round(seconds * RATE)
    f = np.fft.rfftfreq(4 * count, 1 / RATE)
    size = np.sqrt(np.where(f > 0, shape(f), 0.0))
    draws = rng.standard_normal((2, DRAWS, len(f)))
    rows = np.fft.irfft((draws[0] + 1j * draws[1]) * size, axis=1)
    return rows[:, :count], rows[:, 2 * count : 3 * count]


def footfalls(rng, seconds):
    """Walkers that come and go: spells of 5 to 19 steps of uneven strength, each a decaying 2 Hz, in weak noise."""
    count = round(seconds * RATE)
    k = np.arange(round(2 * RATE))
    step = np.exp(-k / (0.3 * RATE)) * np.sin(4 * np.pi * k / RATE)
    rows = 0.05 * rng.standard_normal((DRAWS, 4 * count))
    for row in rows:
        at = 0.0
        while at < len(row):
            at += rng.exponential(5 * RATE)
            for _ in range(rng.integers(5, 20)):
                at += 0.6 * RATE * rng.uniform(0.9, 1.1)
                if at < len(row) - len(step):
                    row[int(at) : int(at) + len(step)] += rng.lognormal(0, 0.7) * step
    return rows[:, :count], rows[:, 2 * count : 3 * count]


SHAPES = {
    "narrow microseism": peak_at(0.2, 0.05),
    "wide microseism": peak_at(0.2, 0.3),
    "two peaks and noise": lambda f: peak_at(0.2, 0.05)(f) + 0.3 * peak_at(0.12, 0.2)(f) + 0.01 / (1 + f**2),
    "footfalls": None,
}


@pytest.mark.parametrize(
    ("name", "seconds"),
    [
        *((name, seconds) for name in SHAPES for seconds in (120.0, 300.0)),
        ("wide microseism", 900.0),
        ("footfalls", 30.0),
    ],
)
def test_the_next_stretch_is_louder_as_often_as_is_said(name, seconds):
    rng = np.random.default_rng(round(seconds))
    shape = SHAPES[name]
    record, later = gaussian(rng, shape, seconds) if shape else footfalls(rng, seconds)
    ratios = later.std(axis=1) / record.std(axis=1)
    # Of 300 draws; the degrees of freedom come from the record, too, so somewhat more often than if they were known.
    for probability, least, most in ((0.9, 0.02, 0.16), (0.99, 0.0, 0.035)):
        exceeded = np.mean(ratios > next_rms(record, probability))
        assert least <= exceeded <= most
    # The scatter of the next stretch alone, with the record's power taken for the truth, is exceeded far too often.
    lines = np.abs(np.fft.rfft(record - record.mean(axis=1, keepdims=True), axis=1)) ** 2
    alone = np.sqrt(0.5 * (lines**2).sum(axis=1)) / lines.sum(axis=1) / 2
    assert np.mean(np.log(ratios) > 2.326 * alone) > 0.03


@pytest.mark.parametrize(("seconds", "wanders", "share"), [(300.0, 20.0, 1 / 12), (120.0, 20.0, 1 / 6)])
def test_a_strength_that_wanders_is_louder_next_as_often_as_the_page_says(seconds, wanders, share):
    """White noise times the exponential of a first-order process: what `isolate` prints for a 15th and a 6th of a record."""
    rng, count = np.random.default_rng(9), round(2.5 * seconds * RATE)
    strength = rng.standard_normal(DRAWS)
    keep, rows = np.exp(-1 / (wanders * RATE)), rng.standard_normal((DRAWS, count))
    for k in range(count):
        rows[:, k] *= np.exp(0.5 * strength)
        strength = keep * strength + np.sqrt(1 - keep**2) * rng.standard_normal(DRAWS)
    record, later = rows[:, : round(seconds * RATE)], rows[:, -round(seconds * RATE) :]
    exceeded = np.mean(later.std(axis=1) / record.std(axis=1) > next_rms(record, 0.99))
    assert 0.02 < exceeded < share


@pytest.mark.parametrize("name", SHAPES)
def test_the_next_peak_is_larger_as_often_as_is_said(name):
    rng, shape = np.random.default_rng(3), SHAPES[name]
    record, later = gaussian(rng, shape, 300.0) if shape else footfalls(rng, 300.0)
    peaks = np.abs(later).max(axis=1)
    assert np.mean(peaks > next_peak(record, 0.99)) < (0.035 if shape else 1 / 12)  # as the page says
    assert np.mean(peaks > np.abs(record).max(axis=1)) > 0.4  # the record's own is exceeded every other time


def test_the_factor_does_not_depend_on_the_unit_and_falls_with_length():
    rows = gaussian(np.random.default_rng(1), peak_at(0.2, 0.1), 900.0)[0][:3]
    found = next_rms(rows, 0.99)
    assert next_rms(1e-9 * rows + 5.0, 0.99) == pytest.approx(found, rel=1e-5)
    assert np.all(found < next_rms(rows[:, : rows.shape[1] // 6], 0.99))


def test_the_expected_peak_is_the_mean_of_the_largest_of_many_records():
    rng = np.random.default_rng(2)
    rows = gaussian(rng, lambda f: (f < 2.0) * 1.0, 120.0)[0]
    wanted = np.mean(np.abs(rows).max(axis=1)) / rows.std()
    assert expected_peak([1.0], [2.0 / np.sqrt(3)], 120.0) == pytest.approx(wanted, rel=0.04)
