"""What a floor's file says of slow motion before an adaptation listens to it."""

import numpy as np
import pytest

from naive.isolators import coloured
from stillwork.machine.isolate import SLOWEST_HZ, read_floor
from stillwork.machine.isolation_design import floor_spectra

RATE = 200.0


def microseism(level: float, low_hz: float = 0.02):
    """Acceleration from 3 Hz on, and a narrow band at 0.15 Hz."""
    f = np.arange(low_hz, 90.0, 0.01)
    return f, 1e-12 / (1 + (3 / f) ** 4) + level * np.exp(-(((f - 0.15) / 0.02) ** 2))


@pytest.mark.parametrize("level", [1e-8, 1e-6])
def test_a_microseism_is_in_the_spectra_that_a_design_is_certified_on(tmp_path, level):
    f, density = microseism(level)
    np.savez(tmp_path / "floor.npz", **{"frequency (Hz)": f, "a ((m/s^2)^2/Hz)": density})
    found, notes, _ = read_floor(str(tmp_path / "floor.npz"), "", 1, 2 * RATE, [])
    assert found.frequencies_hz[0] == SLOWEST_HZ and not any("below" in each for each in notes)
    power = level * 0.02 * np.sqrt(np.pi)
    slow = found.frequencies_hz < 1
    assert found.density[slow, 0, 0].real @ found.widths_hz[slow] == pytest.approx(power, rel=0.01)
    record = coloured(np.random.default_rng(0), f, density, 400_000, RATE, 1)
    own = floor_spectra(record, RATE, "record")
    slow = own.frequencies_hz < 0.875
    assert own.density[slow, 0, 0].real @ own.widths_hz[slow] == pytest.approx(power, rel=0.2)
    ends = own.frequencies_hz + own.widths_hz / 2
    assert ends[:-1] == pytest.approx((own.frequencies_hz - own.widths_hz / 2)[1:], abs=0.01)
    whole = own.density[:, 0, 0].real @ own.widths_hz
    assert whole == pytest.approx(record.var(), rel=0.2)


@pytest.mark.parametrize("kind", ["spectra", "record"])
def test_below_what_is_known_a_floor_stays_as_it_is_there(tmp_path, kind):
    f, density = microseism(0.0, 0.3)
    columns = {"frequency (Hz)": f, "a ((m/s^2)^2/Hz)": density}
    if kind == "record":
        columns = {"fs": RATE, "a (m/s^2)": coloured(np.random.default_rng(0), f, density, 2000, RATE, 1)[0]}
    np.savez(tmp_path / "floor.npz", **columns)
    found, notes, _ = read_floor(str(tmp_path / "floor.npz"), "", 1, 2 * RATE, [])
    first = {"spectra": 0.3, "record": 0.25}[kind]
    assert f"below {first:g} Hz, where the floor is unknown, its density is that at {first:g} Hz" in notes
    below = found.frequencies_hz < 0.9 * first
    assert found.frequencies_hz[0] < 1.5 * SLOWEST_HZ and below.sum() > 4
    assert np.ptp(found.density[below]) == 0 < found.density[below].real.min()


@pytest.mark.parametrize("ramp", [0.0, 1e-4])
def test_a_drift_of_a_record_is_noted(tmp_path, ramp):
    """Of 1e-4 m/s^3, which is twenty times as large after the record's 100 s as its motion."""
    f, density = microseism(1e-5)
    motion = coloured(np.random.default_rng(0), f, density, 20_000, RATE, 1)[0]
    np.savez(tmp_path / "floor.npz", **{"fs": RATE, "a (m/s^2)": motion + ramp * np.arange(20_000) / RATE})
    found, notes, _ = read_floor(str(tmp_path / "floor.npz"), "", 1, 2 * RATE, [])
    assert found.drift == pytest.approx([ramp], abs=0.1 * ramp)
    assert [each for each in notes if f"{60 * found.drift[0]:.2g} m/s^2 a minute" in each] == notes[
        : bool(ramp)
    ]


@pytest.mark.parametrize("seconds", [60.0, 300.0])
def test_sensors_that_warm_up_leave_the_record_as_it_is_without(seconds):
    """Over five time constants, by five hundred times the motion; of a straight line more than a hundred would be left."""
    f, density = microseism(1e-8)
    count = round(5 * seconds * RATE)
    motion = coloured(np.random.default_rng(0), f, density, count, RATE, 1)
    warm = 0.01 * (1 - np.exp(-np.arange(count) / RATE / seconds))
    plain, drifting = (floor_spectra(each, RATE, "record") for each in (motion, motion + warm))
    assert not plain.drift.any() and drifting.drift == pytest.approx([0.01 / seconds], rel=0.02)
    assert np.abs(drifting.record - plain.record).max() < 0.5 * motion.std()
    assert drifting.density.real == pytest.approx(
        plain.density.real, rel=0.1, abs=0.01 * plain.density.real.max()
    )
