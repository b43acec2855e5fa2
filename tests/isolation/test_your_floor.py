"""From a record's file to the platform, the shipped record, and the explorers of the floor notebooks."""

import numpy as np
import pytest

from experiments.isolation import performance_pictures, rig_pictures, your_floor_pictures
from experiments.isolation.recorded_floors import ground_floor
from experiments.isolation.twin import load_twin
from experiments.isolation.your_floor import isolate, open_floor, optimum_left
from stillwork.base import paths
from stillwork.base.checks import InputError
from stillwork.signals.records import load_record

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
    assert shaken.left("passive")[0] > shaken.left("feedback")[0] > 10 * shaken.left("FeRLS")[0]
    assert np.isnan(shaken.left("FeRLS")[1:]).all()
    # One channel: the three sensors share what is learnt.
    weights = shaken.adaptation.final_weights.reshape(6, 3, 3)
    assert np.ptp(weights[:, 1:], axis=2).max() < 0.02


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
    np.testing.assert_allclose(first[2], first[:2].mean(axis=0), rtol=0, atol=1e-12)


def test_ground_stands_in_for_a_missing_record(twin):
    floor = opened(twin, "")
    assert floor.duration == 20.0 and "measured ground" in floor.source


@pytest.mark.parametrize(
    ("rows", "options", "message"),
    [
        (1000, {}, "too short for an adaptation"),
        (16_000, {"unit": "mm/ss"}, "did you mean"),
        (16_000, {"rate": 500.0}, "leave one out"),
        (16_000, {"channels": ("righ",)}, "did you mean 'right'"),
    ],
)
def test_records_that_cannot_be_used(twin, tmp_path, rows, options, message):
    lines = [f"{k / 1000},{k % 7},{k % 5}" for k in range(rows)]
    (tmp_path / "floor.csv").write_text("time,left,right\n" + "\n".join(lines))
    with pytest.raises(InputError, match=message):
        opened(twin, tmp_path / "floor.csv", **options)


def test_more_channels_than_sensors_are_refused(twin, tmp_path):
    np.savez(tmp_path / "floor.npz", fs=500.0, a=np.zeros((4, 10_000)))
    with pytest.raises(InputError, match="at most 3 can be used; choose with channels"):
        opened(twin, tmp_path / "floor.npz")


@pytest.mark.parametrize("seed", [1, 2])
def test_adaptation_stays_small_where_the_sensors_hear_mostly_noise(twin, seed):
    quiet = isolate(twin, ground_floor(20.0, seed, common=0.9), seed)
    assert np.abs(quiet.adaptation.final_weights).max() < 5
    assert quiet.left("FeRLS") == pytest.approx(quiet.left("feedback"), rel=0.1)


def test_a_louder_ground_is_isolated_better(twin):
    left = optimum_left(twin, [1.0, 30.0, 1000.0])
    assert np.ptp(left["passive"]) < 1e-9  # linear, and no sensor takes part
    assert left["feedback"][0] > 1 and left["FeRLS"][0] == pytest.approx(left["feedback"][0], rel=0.01)
    assert np.all(np.diff(left["FeRLS"]) < 0) and left["FeRLS"][2] < 0.05


@pytest.mark.parametrize(
    ("draw", "settings"),
    [
        (rig_pictures.explore_floor, {"low_pass_hz": 300.0, "gain": 2.0}),
        (
            performance_pictures.explore_transmissibility,
            {"integrator_cutoff_hz": 1.0, "lowpass_hz": 200.0, "low_pass_hz": 300.0},
        ),
        (
            performance_pictures.explore_power,
            {"output_noise": 0.5, "floor_noise": 3.0, "low_pass_hz": 300.0},
        ),
        (your_floor_pictures.explore_ground, {"gain": 50.0, "output_noise": 0.1}),
    ],
)
def test_explorers_draw_away_from_home(draw, settings):
    figure = draw(**settings)
    assert all(np.isfinite(line.get_ydata()).all() for axes in figure.axes for line in axes.lines)
