"""From a record's file to the platform, the shipped record, and the explorers of the floor notebooks."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from experiments.isolation.performance import exact_transmissibility
from experiments.isolation.recorded_floors import (
    RecordedFloor,
    ground_floor,
    record_floor,
    synthesise_floor,
)
from experiments.isolation.simulation import simulate
from experiments.isolation.twin import load_twin, twin_from_table
from notebooks.isolation import your_floor
from notebooks.isolation.your_floor import (
    Isolated,
    crossing,
    described,
    findings,
    isolate,
    open_floor,
    select_floor_sensors,
)
from stillwork.base.checks import InputError
from stillwork.base.toml_files import read_toml
from stillwork.estimation.online import UnstableAdaptation
from stillwork.signals.records import load_record
from stillwork.signals.spectra import estimate_spectrum
from workbook import paths

GROUND = paths.data("isolation", "ligo_llo_ground/ground_velocity_density.npz")
SLAB = paths.data("isolation", "slab_footfall/slab_vertical.csv")


@pytest.fixture(scope="module")
def twin():
    return load_twin("rigid_body")


def opened(twin, record, unit="m/s^2", rate=0.0, channels=(), seconds=20.0):
    return open_floor(
        str(record),
        unit,
        rate,
        list(channels),
        twin=twin,
        ground_gain=1.0,
        common=0.9,
        duration_s=seconds,
        seed=1,
    )


def test_shipped_record_is_what_its_source_says():
    record = load_record(SLAB, "m/s^2")
    assert record.sample_rate == pytest.approx(425.08, abs=0.02)
    assert record.duration == pytest.approx(30.0, abs=0.01)
    assert record.names == ("vertical (m/s^2)",)


@pytest.mark.slow
def test_slab_is_isolated_in_z_and_not_tilted(twin):
    shaken = isolate(twin, opened(twin, SLAB), 1)
    assert list(shaken.moving) == [True, False, False]
    assert shaken.left("passive")[0] > shaken.left("feedback")[0] > 4 * shaken.left("FeRLS")[0]
    assert np.isnan(shaken.left("FeRLS")[1:]).all()
    assert shaken.adaptation.final_weights.shape == (6, 3)  # one sensor was there, one is heard


@pytest.mark.parametrize("channels", [1, 2])
def test_missing_sensors_read_the_mean_of_the_others(twin, channels):
    fewer, _ = select_floor_sensors(twin, channels)
    rng = np.random.default_rng(channels)
    measured = 1e-2 * rng.standard_normal((channels, 5000))
    mean = np.repeat(measured.mean(axis=0, keepdims=True), 3 - channels, axis=0)
    weights = 0.1 * rng.standard_normal((6, 3, 3))  # of the full rig: actuators, powers, sensors
    # A weight of a missing sensor acts on the others' mean, so each of them carries its share.
    shared = weights[..., :channels] + weights[..., channels:].sum(axis=2, keepdims=True) / channels
    runs = [
        simulate(
            rig,
            RecordedFloor(motion, 5000.0, "white"),
            weights=w.reshape(6, -1),
            noise=False,
            signals_from_s=0.0,
        )
        for rig, motion, w in (
            (twin, np.concatenate([measured, mean]), weights),
            (fewer, measured, shared),
        )
    ]
    np.testing.assert_allclose(
        runs[1].platform, runs[0].platform, atol=1e-9 * np.abs(runs[0].platform).max(), rtol=0
    )


@pytest.mark.slow
def test_a_rig_with_one_floor_sensor_is_a_rig():
    table = read_toml(paths.data("isolation", "rigid_body.toml"))
    table["floor_sensors"] = {"positions": [[0.0, 0.0, 0.0]], "directions": [[0.0, 0.0, 1.0]]}
    one = twin_from_table(table)
    floor = open_floor("", "m/s^2", 0.0, [], twin=one, ground_gain=100.0, common=0.9, duration_s=15.0, seed=1)
    shaken = isolate(one, floor, 1)
    assert floor.channels == 1 and list(shaken.moving) == [True, False, False]
    assert shaken.left("FeRLS")[0] < shaken.left("feedback")[0] / 2
    with pytest.raises(InputError, match="place"):
        exact_transmissibility(one, [10.0])


@pytest.mark.slow
def test_the_weights_never_see_the_part_they_are_judged_on(twin):
    floor = ground_floor(20.0, 1, gain=100.0)
    changed = floor.acceleration.copy()
    changed[:, 14 * 5000 :] *= 3
    other = RecordedFloor(changed, floor.sample_rate, "changed")
    one, two = (isolate(twin, each, 1) for each in (floor, other))
    assert np.array_equal(one.adaptation.final_weights, two.adaptation.final_weights)
    assert one.left("FeRLS", training=True) == pytest.approx(two.left("FeRLS", training=True))
    assert one.training == round((13.4 - 5.0) * 5000)  # two thirds of 20 s, in steps of 0.2 s
    test = slice(one.training, None)
    rms = np.sqrt(np.mean(one.platform["passive"][:, test] ** 2, axis=1))
    assert one.left("passive") == pytest.approx(
        rms / np.sqrt(np.mean(one.floor[:, test] ** 2, axis=1)), rel=1e-3
    )


@pytest.mark.slow
def test_a_csv_in_mm_per_s_moves_the_platform_as_the_same_motion_in_si(twin, tmp_path):
    rng = np.random.default_rng(0)
    t = np.arange(16_000) / 1000.0
    velocity = np.cumsum(rng.standard_normal((2, len(t))), axis=1) * 1e-3
    velocity -= np.outer(velocity[:, -1], t / t[-1])
    rows = [f"{a:.6f};{b!r};{c!r}" for a, b, c in zip(t, *velocity.tolist(), strict=True)]
    (tmp_path / "floor.csv").write_text("time;left;right\n" + "\n".join(rows))
    np.savez(tmp_path / "floor.npz", fs=1000.0, left=velocity[0] * 1e-3, right=velocity[1] * 1e-3)
    first = opened(twin, tmp_path / "floor.csv", "mm/s").acceleration
    second = opened(twin, tmp_path / "floor.npz", "m/s").acceleration
    np.testing.assert_allclose(first, second, rtol=1e-6, atol=1e-9 * np.abs(second).max())
    assert len(first) == 2
    spread = record_floor(load_record(tmp_path / "floor.npz", "m/s")).acceleration
    np.testing.assert_allclose(spread[2], spread[:2].mean(axis=0), rtol=0, atol=1e-12)


def test_ground_stands_in_for_a_missing_record(twin):
    floor = opened(twin, "")
    assert floor.duration == 20.0 and "measured ground" in floor.source


@pytest.mark.parametrize(
    ("rows", "options", "message"),
    [
        (1000, {}, r"^floor\.csv\b.*\b1 s\b"),
        (16_000, {"unit": "mm/ss"}, r"^unit\b.*'mm/s'"),
        (16_000, {"rate": 500.0}, r"^sample_rate\b"),
        (16_000, {"channels": ("righ",)}, r"^channel\b.*'right'"),
    ],
)
def test_records_that_cannot_be_used(twin, tmp_path, rows, options, message):
    lines = [f"{k / 1000},{k % 7},{k % 5}" for k in range(rows)]
    (tmp_path / "floor.csv").write_text("time,left,right\n" + "\n".join(lines))
    with pytest.raises(InputError, match=message):
        opened(twin, tmp_path / "floor.csv", **options)


@pytest.mark.parametrize("rate", [20, 50, 90])
def test_records_that_do_not_reach_the_suspension_are_refused(twin, tmp_path, rate):
    np.savez(
        tmp_path / "floor.npz", fs=float(rate), a=1e-2 * np.random.default_rng(0).standard_normal(30 * rate)
    )
    with pytest.raises(InputError, match=rf"^floor\.npz\b.*\b{rate} Hz.*40 Hz.*100 Hz"):
        opened(twin, tmp_path / "floor.npz")


@pytest.mark.parametrize(
    ("peak", "unit", "message"),
    [
        (2e4, "m/s^2", r"2\S*e\+04 m/s\^2"),
        (200.0, "m/s^2", r"2\d\d m/s\^2"),
        (10.0, "g", r"97\.9 m/s\^2.*'g'"),
        (1e-2, "nm/s^2", r"'nm/s\^2'"),
    ],
)
def test_implausible_floors_are_refused_by_their_unit_and_not_by_the_loop(
    twin, tmp_path, peak, unit, message
):
    # At 5 Hz, where a wrong unit makes metres: it is no drift.
    motion = np.sin(0.03 * np.arange(20_000)) * np.linspace(0, 1, 20_000)
    np.savez(tmp_path / "floor.npz", fs=1000.0, a=peak * motion / np.abs(motion).max())
    with pytest.raises(InputError, match=message):
        opened(twin, tmp_path / "floor.npz", unit)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("unit", "scale", "order", "power"),
    [
        ("(m/s^2)^2/Hz", 1.0, 0, 2),
        ("(mm/s)^2/Hz", 1e-3, 1, 2),
        ("m/s/sqrt(Hz)", 1.0, 1, 1),
        ("um/rtHz", 1e-6, 2, 1),
        ("mg^2/Hz", 9.80665e-3, 0, 2),
    ],
)
def test_spectra_move_the_floor_with_their_density(twin, tmp_path, unit, scale, order, power):
    f = np.geomspace(1.0, 200.0, 400)
    wanted = 1e-4 / (1 + (f / 30) ** 2)  # (m/s^2)^2/Hz
    written = (wanted / (2 * np.pi * f) ** (2 * order) / scale**2) ** (power / 2)
    rows = "\n".join(f"{a!r},{b!r}" for a, b in zip(f.tolist(), written.tolist(), strict=True))
    (tmp_path / "spectra.csv").write_text(f"frequency (Hz),floor\n{rows}")
    floor = opened(twin, tmp_path / "spectra.csv", unit, seconds=60.0)
    assert floor.channels == 3 and floor.duration == 60.0
    found = estimate_spectrum(floor.acceleration, floor.sample_rate, 1.0)
    for low, high in ((5.0, 20.0), (20.0, 60.0), (60.0, 150.0)):
        power_wanted = np.trapezoid(
            np.interp(np.linspace(low, high, 999), f, wanted), np.linspace(low, high, 999)
        )
        # 60 s times 15 Hz: 900 independent lines, each with the variance of its own square.
        assert found.power(low, high) == pytest.approx(power_wanted, rel=5 / np.sqrt(900))


def test_spectra_from_the_highest_frequency_on_are_the_same_floor(twin, tmp_path):
    f = np.geomspace(1.0, 200.0, 50)
    np.savez(tmp_path / "up.npz", frequency=f, a=1e-4 / f)
    np.savez(tmp_path / "down.npz", frequency=f[::-1], a=1e-4 / f[::-1])
    up, down = (opened(twin, tmp_path / name, "(m/s^2)^2/Hz").acceleration for name in ("up.npz", "down.npz"))
    assert np.array_equal(up, down)


def test_a_sensor_that_drifts_is_told_from_a_floor(twin, tmp_path):
    time = np.arange(20_000) / 1000
    for rms, refused in ((0.05, False), (0.2, True)):  # m, of a motion at 0.2 Hz beside what shakes the rig
        drift = rms * np.sqrt(2) * (0.4 * np.pi) ** 2 * np.sin(0.4 * np.pi * time)
        np.savez(tmp_path / "floor.npz", fs=1000.0, a=drift + 1e-3 * np.sin(2 * np.pi * 30 * time))
        if not refused:
            assert opened(twin, tmp_path / "floor.npz").channels == 1
            continue
        with pytest.raises(InputError, match=r"0\.2\d m\b"):
            opened(twin, tmp_path / "floor.npz")


@pytest.mark.slow
def test_a_record_that_begins_in_mid_motion_begins_at_rest(twin, tmp_path):
    np.savez(tmp_path / "floor.npz", fs=5000.0, a=np.cos(2 * np.pi * 30 * np.arange(100_000) / 5000))
    motion = opened(twin, tmp_path / "floor.npz").acceleration[0]
    assert motion[0] == 0 and np.abs(motion[:200]).max() < 0.01
    assert motion[5000:] == pytest.approx(np.cos(2 * np.pi * 30 * np.arange(5000, 100_000) / 5000), abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("quiet_first", [True, False])
def test_a_floor_that_begins_louder_or_ends_louder_than_the_rest_is_learnt(twin, tmp_path, quiet_first):
    time = np.arange(22_500) / 500
    loud = (time > 30) if quiet_first else (time < 4)
    motion = np.random.default_rng(3).standard_normal(len(time)) * np.where(loud, 0.3, 1e-3)
    np.savez(tmp_path / "floor.npz", fs=500.0, a=motion)
    isolated = isolate(twin, opened(twin, tmp_path / "floor.npz"), 1)
    assert isolated.left("FeRLS")[0] < isolated.left("feedback")[0]
    louder = [text for text in findings(isolated) if "times as much where it is judged" in text]
    assert len(louder) == quiet_first  # what is cut off before the judging counts on neither side


def test_the_shipped_ground_spectra_are_a_floor_and_each_of_several_its_own(twin, tmp_path):
    one = opened(twin, GROUND, "(m/s)^2/Hz", channels=("velocity_density_Z 1",))
    assert one.channels == 3 and one.acceleration.std() == pytest.approx(8e-5, rel=0.5)
    f = np.geomspace(1.0, 200.0, 400)
    np.savez(tmp_path / "two.npz", frequencies_hz=f, a=1e-8 + 0 * f, b=4e-8 + 0 * f)
    two = opened(twin, tmp_path / "two.npz", "(m/s^2)^2/Hz")
    levels = two.acceleration.std(axis=1)
    assert two.channels == 2 and levels[1] / levels[0] == pytest.approx(2, rel=0.05)


@pytest.mark.parametrize(
    ("columns", "unit", "message"),
    [
        ({"frequency": [1, 30], "a": [1, 1]}, "(m/s)^2/Hz", r"\b1 \w+ 30 Hz"),
        ({"frequency": [1, 300], "a": [1, -1]}, "(m/s)^2/Hz", "negative"),
        ({"frequency": [1, 300], "a": [1, 1]}, "N^2/Hz", r"^unit\b.*'N\^2/Hz'"),
        ({"frequency": [1, 300], "a": [1, 1]}, "m/s^2 per Hz", r"^unit\b.*'m/s\^2 per Hz'"),
        ({"frequency": [1, 300], "a": [1, 1]}, "m/s^2", r"\(m/s\^2\)\^2/Hz"),
        ({"frequency": [-1, 0], "a": [1, 1]}, "(m/s)^2/Hz", r"'frequency'.*\b0\b"),
        ({"x": [1, 300], "a": [1, 1]}, "(m/s)^2/Hz", r"\bfrequency\b"),
        ({"f": [1, 300], **{n: [1, 1] for n in "abcd"}}, "(m/s)^2/Hz", r"^spectra\.npz\b.*\b4\b"),
    ],
)
def test_spectra_that_cannot_be_used(twin, tmp_path, columns, unit, message):
    ends = np.array([0, 299])
    filled = {name: np.interp(np.arange(300), ends, values) for name, values in columns.items()}
    np.savez(tmp_path / "spectra.npz", **filled)
    with pytest.raises(InputError, match=message):
        opened(twin, tmp_path / "spectra.npz", unit)


def isolated_by(run, feedback, ferls, noise, progress, tilts=0.0, learnt=1.0):
    """A run whose ratios are known: the passive platform follows the floor, the others keep a share of it."""
    rng = np.random.default_rng(0)
    floor = rng.standard_normal((3, 3000)) * np.array([[1.0], [tilts], [tilts]])
    part = np.where(np.arange(3000) < 2000, learnt, 1.0)
    other = np.roll(floor, 7, axis=1)  # as large, and as good as uncorrelated
    return Isolated(
        floor,
        {"passive": floor, "feedback": feedback * floor, "FeRLS": ferls * part * floor},
        feedback * (floor - np.sqrt(noise) * other),
        2000,
        run,
        np.asarray(progress, dtype=float),
        1000.0,
    )


def test_every_sentence_follows_from_the_numbers(twin):
    run = simulate(twin, ground_floor(1.0, 1))
    falling, level = np.repeat([4.0, 3.0, 2.0, 1.0, 0.5], 20), np.ones(100)
    good = " ".join(findings(isolated_by(run, 0.5, 0.1, 0.0, falling)))
    assert "without tilting" in good and "θx" not in good
    assert "passive 1, feedback 0.5, FeRLS 0.1" in good
    assert re.search(r"feedback .*50 %.* passive", good)
    assert re.search(r"feedforward .*80 %.* feedback", good)
    assert "still falling" in good and "noise" not in good and "learnt on" not in good
    bad = " ".join(findings(isolated_by(run, 2.0, 2.02, 0.25, level, tilts=1.0, learnt=0.2)))
    assert "without tilting" not in bad and "θy: " in bad and "still falling" not in bad
    assert re.search(r"feedback .* 2 times .*passive", bad)
    assert re.search(r"25 % .*noise", bad)
    assert re.search(r"feedforward .*10 %", bad)
    assert "0.404" in bad


def test_the_level_at_which_feedforward_pays_is_interpolated():
    gains = np.geomspace(0.1, 100, 7)
    flat = np.ones(7)
    curves = {"passive": flat, "FeRLS": 2 / gains}
    assert "In z" in crossing(gains, curves) and "from 2 times" in crossing(gains, curves)
    assert "even on a floor 0.1 times" in crossing(gains, {"passive": flat, "FeRLS": 0.5 * flat})
    assert "more motion than the passive rig even on a floor 1e+02 times" in crossing(
        gains, {"passive": flat, "FeRLS": 2 * flat}
    )
    some = np.where(np.arange(len(gains)) == 1, 0.5, 2.0)
    assert f"only on a floor {gains[1]:.2g} times" in crossing(gains, {"passive": flat, "FeRLS": some * flat})
    twice = np.where(np.arange(len(gains)) == 1, 2.0, 0.5)  # it pays again from there on
    told = crossing(gains, {"passive": flat, "FeRLS": twice * flat})
    assert f"from {np.sqrt(gains[1] * gains[2]):.2g} times" in told


def test_a_floor_is_described_by_its_own_numbers():
    motion = np.zeros((2, 50_000))
    motion[0] = 1e-3 * np.sin(2 * np.pi * 20 * np.arange(50_000) / 5000)
    motion[1] = 3 * motion[0]
    text = " ".join(described(RecordedFloor(motion, 5000.0, "mine.csv")))
    assert "mine.csv: 2 floor sensors, 10 s." in text and "0.707, 2.12 mm/s², peak 3 mm/s²" in text
    # 1e-3 / sqrt(2) / (2 pi 20) = 5.6 um/s: VC-D allows 6.25; three times that: VC-B allows 25.
    assert "by sensor: VC-D (2.5 to 81 Hz), VC-B." in text


def test_more_channels_than_sensors_are_refused(twin, tmp_path):
    np.savez(tmp_path / "floor.npz", fs=500.0, a=np.zeros((4, 10_000)))
    with pytest.raises(InputError, match=r"^floor\.npz\b.*\b4\b.*channels"):
        opened(twin, tmp_path / "floor.npz")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_adaptation_stays_small_where_the_sensors_hear_mostly_noise(twin, seed):
    quiet = isolate(twin, ground_floor(20.0, seed, common=0.9), seed)
    assert np.abs(quiet.adaptation.final_weights).max() < 5
    assert quiet.left("FeRLS") == pytest.approx(quiet.left("feedback"), rel=0.1)


def record_of(rows):
    return RecordedFloor(np.atleast_2d(rows), 5000.0, "mine.csv")


def test_what_may_spoil_the_adaptation_is_reported_before_it_runs():
    rng = np.random.default_rng(1)
    quiet = rng.standard_normal((2, 100_000)) * 1e-3
    assert list(your_floor.warnings(record_of(quiet))) == []
    spike = quiet.copy()
    spike[1, 30_000] = 0.1
    [text] = your_floor.warnings(record_of(spike))
    assert text.startswith("Floor sensor 2") and "at 6 s" in text and "cut it out" in text
    stuck = quiet.copy()
    stuck[0, 50_000:55_000] = stuck[0, 50_000]
    [text] = your_floor.warnings(record_of(stuck))
    assert text.startswith("Floor sensor 1") and "1 s, from 10 s" in text and "sticks" in text
    # A tone of 0.75 Hz, spread over the band of 0.5 Hz: 20 times the density of the rest.
    level = 20 * 1e-3 / np.sqrt(2500)
    slow = level * np.sqrt(0.5) * np.sqrt(2) * np.sin(2 * np.pi * 0.75 * np.arange(100_000) / 5000)
    [text] = your_floor.warnings(record_of(quiet + slow))
    assert "high-pass of 2 Hz" in text and "a smaller start does not help" in text.replace("  ", " ")


@pytest.mark.slow
def test_slow_motion_that_is_reported_breaks_the_adaptation_and_a_high_pass_cures_it(twin):
    f = np.geomspace(0.3, 300, 500)
    for seed in (5, 6):
        for ratio, breaks in ((12.0, True), (4.0, False)):
            density = np.where((f >= 0.5) & (f <= 1.0), (ratio * 5e-4) ** 2, 0) + np.where(f > 3, 5e-4**2, 0)
            floor = synthesise_floor(f, density, 30.0, seed, common=0.3)
            assert bool(list(your_floor.warnings(floor))) == breaks
            if not breaks:
                isolate(twin, floor, seed)
                continue
            with pytest.raises(UnstableAdaptation):
                isolate(twin, floor, seed)
            passed = signal.sosfilt(
                signal.butter(4, 2.0, "highpass", fs=5000, output="sos"), floor.acceleration, axis=1
            )
            isolate(twin, replace(floor, acceleration=np.ascontiguousarray(passed)), seed)


def test_advice_takes_the_least_in_each_direction_and_names_its_price():
    tilts = np.array([1.0, 1.0, 1.0])
    trials = [
        your_floor.Trial(65.0, 225.0, tilts),
        your_floor.Trial(65.0, 0.0, np.array([0.3, 1.0, 2.0])),
        your_floor.Trial(5.0, 225.0, np.array([0.9, 1.0, 0.95])),
    ]
    text = list(your_floor.advice(trials))
    assert text[0].startswith("z: struts of 65 N s/m without the skyhook loop leave 0.3 instead of 1")
    assert text[1] == "  The price is 2 instead of 1 in θy."
    assert text[2].startswith("θx: no skyhook gain or damping tried") and len(text) == 4
