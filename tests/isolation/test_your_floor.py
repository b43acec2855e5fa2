"""The paper's rig as the command `isolate` takes it, floors from files, and the page's answer beside the command's own."""

import numpy as np
import pytest

from experiments.isolation.twin import load_twin
from notebooks.isolation.your_floor import (
    crossing,
    decision,
    described,
    feedforward,
    isolate,
    isolator_of,
    open_floor,
    residuals,
)
from stillwork.machine import isolation_design
from stillwork.machine.isolate import isolate_file
from stillwork.machine.isolation_design import floor_spectra
from workbook import paths

SLAB = paths.data("isolation", "slab_footfall/slab_vertical.csv")


@pytest.fixture(scope="module")
def twin():
    return load_twin("rigid_body")


@pytest.fixture
def few(monkeypatch):
    """One loop and three isolators of the box, so that a design takes seconds."""
    for name, value in {"RATIOS": (0.2,), "CUTOFFS_HZ": (2.0,), "HIGHPASSES": (1,), "DRAWS": 3}.items():
        monkeypatch.setattr(isolation_design, name, value)


def opened(twin, file="", unit="", channels=(), gain=1.0, common=0.9, rate=0.0):
    return open_floor(str(file), unit, rate, list(channels), twin, gain=gain, common=common, duration_s=60.0)


def test_the_rig_along_its_struts_is_the_rig(twin):
    """P1 in the body's coordinates, from the matrices of the plant, without a change of coordinates."""
    plant, f = twin.plant, np.geomspace(1, 400, 50)
    s = 2j * np.pi * f[:, None, None]
    whole = s**2 * plant.mass + s * plant.damping + plant.stiffness
    wanted = plant.observation @ np.linalg.solve(whole, s * plant.floor_damping + plant.floor_stiffness)
    found = isolator_of(twin).paths(f, twin.sample_time)
    assert np.abs(found[0] - wanted).max() < 1e-9 * np.abs(wanted).max()
    pushed = s**2 * (plant.observation @ np.linalg.solve(whole, plant.actuation))
    pole, step = 2 * np.pi * twin.instruments.actuator_pole_hz, s * twin.sample_time
    held = pole / (s + pole) * np.exp(-step) * -np.expm1(-step) / step * pushed  # a sample late, and held
    assert np.abs(found[1] - held).max() < 1e-9 * np.abs(held).max()


@pytest.mark.parametrize(("unit", "scale"), [("(m/s^2)^2/Hz", 1.0), ("(mm/s^2)^2/Hz", 1e-6)])
def test_spectra_are_scaled_and_share_a_part(twin, tmp_path, unit, scale):
    f = np.linspace(0.5, 400, 800)
    np.savez(tmp_path / "s.npz", frequency=f, a=1e-6 / (1 + f))
    floor, notes = opened(twin, tmp_path / "s.npz", unit, gain=3.0, common=0.25)
    wanted = 9 * scale * 1e-6 / (1 + floor.frequencies_hz)
    inside = (floor.frequencies_hz > 2) & (floor.frequencies_hz < 300)
    assert floor.density[inside, 1, 1].real == pytest.approx(wanted[inside], rel=0.02)
    assert floor.density[:, 0, 2].real == pytest.approx(0.25 * floor.density[:, 1, 1].real)
    assert floor.duration == 60.0 and not any("independent" in each for each in notes)


def test_a_floor_is_described_by_its_own_numbers():
    time = np.arange(50_000) / 5000
    motion = np.array([[1e-3], [3e-3]]) * np.sin(2 * np.pi * 20 * time)
    text = " ".join(described(floor_spectra(motion, 5000.0, "mine.csv"), ["Odd."]))
    assert "mine.csv: 2 floor sensors, 10 s." in text and "0.707, 2.12 mm/s²" in text and "Odd." in text
    # 1e-3 / sqrt(2) / (2 pi 20) = 5.6 um/s: VC-D allows 6.25; three times that: VC-B allows 25.
    assert "by sensor: VC-D (2.5 to 81 Hz), VC-B." in text


def test_the_page_answers_as_the_command(twin, tmp_path, few):
    """The same numbers from a TOML of the rig's matrices along its struts, through the command's own door."""
    floor, _ = opened(twin, SLAB, "m/s^2")
    own = isolate(twin, floor, 0)
    rig = isolator_of(twin)
    values = {name: getattr(rig, name).tolist() for name in ("mass", "damping", "stiffness", "floor")}
    table = [f"{name} = {value}" for name, value in values.items()]
    (tmp_path / "rig.toml").write_text(
        "[isolator]\n" + "\n".join(table) + f"\nactuator_pole_hz = {twin.instruments.actuator_pole_hz}\n"
        f"[noise]\nfloor = {rig.floor_noise}\nplatform = {rig.platform_noise}\n"
    )
    lines = isolate_file(
        str(tmp_path / "rig.toml"),
        str(SLAB),
        str(tmp_path / "out"),
        twin.instruments.sample_rate,
        unit="m/s^2",
        verbose=True,
    )
    # To its commands isolate adds what the noise of the sensors made in the replay.
    own_lines = [each for each in own.lines() if not each.startswith("command: ")]
    assert len(own_lines) > 15 and set(own_lines) <= set(lines)
    gains = np.array([1e-3, 1.0, 10.0])
    left = residuals(own, gains)
    assert left["passive"] == pytest.approx(
        left["passive"][0]
    )  # a louder floor moves the passive rig in proportion
    assert np.all(np.diff(left["FeRLS"]) < 0) and left["FeRLS"][1] < 0.1 < 1 < left["FeRLS"][0]
    assert "from 0.0" in crossing(gains, left)


def test_of_two_channels_the_third_sensor_reads_the_mean(twin, tmp_path, few):
    rows = 1e-2 * np.random.default_rng(1).standard_normal((2, 20_000))
    np.savez(tmp_path / "two.npz", fs=1000.0, **{"a (m/s^2)": rows[0], "b (m/s^2)": rows[1]})
    floor, _ = opened(twin, tmp_path / "two.npz")
    feet = isolate(twin, floor, 0).design.isolator.floor
    whole = isolator_of(twin).floor
    assert feet == pytest.approx(whole[:, :2] + whole[:, 2:] / 2)


def test_the_level_at_which_the_loop_pays_is_interpolated():
    gains, flat = np.geomspace(0.1, 100, 7), np.ones(7)
    assert "from 2 times" in crossing(gains, {"passive": flat, "FeRLS": 2 / gains})
    assert "even on a floor 0.1 times" in crossing(gains, {"passive": flat, "FeRLS": 0.5 * flat})
    assert "more motion than the passive rig even on a floor 1e+02" in crossing(
        gains, {"passive": flat, "FeRLS": 2 * flat}
    )
    twice = np.where(np.arange(7) == 1, 2.0, 0.5)  # it pays again from there on
    told = crossing(gains, {"passive": flat, "FeRLS": twice * flat})
    assert f"from {np.sqrt(gains[1] * gains[2]):.2g} times" in told


def test_the_feedforward_pays_where_it_takes_a_tenth_off_the_loop_alone():
    gains, flat = np.geomspace(0.1, 100, 7), np.ones(7)
    pays, where = feedforward(gains, {"feedback": flat, "FeRLS": 1.8 / gains})
    assert "does not pay" in pays and "1.80 of" in pays and "from 2 times this floor's" in where
    pays, where = feedforward(gains, {"feedback": flat, "FeRLS": 0.5 * flat})
    assert "feedforward pays" in pays and "0.50 of" in pays and "on any floor" in where
    assert "no floor up to 1e+02 times" in feedforward(gains, {"feedback": flat, "FeRLS": 0.95 * flat})[1]


def test_what_to_do_is_what_leaves_least():
    gains, flat = np.geomspace(0.1, 100, 7), np.ones(7)
    told = {
        "Build both loops": {"feedback": 0.5 * flat, "FeRLS": 0.3 * flat},
        "the feedforward alone": {"feedback": flat, "FeRLS": 0.3 * flat},
        "the skyhook loop alone": {"feedback": 0.5 * flat, "FeRLS": 0.48 * flat},
        "passive on this floor, or take sensors 2 times": {"feedback": 1.5 * flat, "FeRLS": 2 / gains},
        "passive on this floor.": {"feedback": 1.5 * flat, "FeRLS": 2 * flat},
    }
    for words, left in told.items():
        assert words in decision(gains, {"passive": flat, **left})
