"""The contest of observers: what an observer is given, what the scores mean, how ranks and their intervals are made."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy import integrate

from contest import bench, compute, plants, ranking
from contest import table as tables
from contest.machines import BUILDERS, machine_numbers
from contest.noise_map import (
    PUBLICS,
    flexible_errors,
    stored_map,
)
from contest.nominal import OwnObserver, nominal_of
from contest.plants import PLANTS, plant_of
from contest.ranking import (
    KEYS,
    Block,
    against,
    block,
    critical_difference,
    mean_ranks,
)
from contest.record import FILE as RECORDED
from contest.scores import ENTRANTS, ORACLE, scores_of
from contest.table import written_table
from contest.tuning import TUNINGS, scans_of, settings_for
from contest.uncertainties import UNCERTAINTIES, sample_truth


def scan_on(name, uncertainty, samples=bench.SAMPLES, seed=1):
    plant = plant_of(name)
    truth = sample_truth(plant, UNCERTAINTIES[uncertainty], samples, np.random.default_rng([seed, 1]))
    return (
        plant,
        truth,
        bench.record(bench.assemble(plant, truth, bench.BANDWIDTH_RATIO_LOW, estimated=False)),
    )


SLOW_TO_FIT = [
    pytest.param(each, marks=[pytest.mark.slow] * (each == "measured structure")) for each in PLANTS
]


def test_frequencies_of_two_machines_have_closed_forms():
    # A chain of four equal disks has the frequencies 2 sin(i pi / 8); two masses on a spring that of k (1/m + 1/m).
    assert plant_of("four disks").machine.frequencies[1:] == pytest.approx(
        2 * np.sin(np.pi / 8 * np.arange(1, 4))
    )
    assert plant_of("two masses").machine.frequencies[1] == pytest.approx(np.sqrt(2))


@pytest.mark.parametrize("name", SLOW_TO_FIT)
def test_the_numbers_of_a_machine_are_those_of_its_source(name):
    assert list(BUILDERS) == list(PLANTS)
    numbers = json.loads(plants.FILE.read_text(encoding="utf-8"))
    for key, value in machine_numbers(name).items():
        assert np.allclose(numbers[name][key], value, rtol=1e-9, atol=1e-12), key


def test_the_slewing_beam_has_the_shapes_of_a_pinned_beam():
    machine = plant_of("slewing beam").machine
    x = np.linspace(0, 1, 20001)
    root = np.array([3.92660231, 7.06858275])
    shapes = (
        np.sin(np.outer(root, x)) / np.sin(root)[:, None]
        + np.sinh(np.outer(root, x)) / np.sinh(root)[:, None]
    )
    products = integrate.simpson(shapes[:, None] * np.vstack([shapes, np.sqrt(3) * x])[None], x=x)
    assert products == pytest.approx(
        np.eye(2, 3), abs=1e-6
    )  # of unit mass, and orthogonal, to the rigid body too
    slopes = (shapes[:, 1] - shapes[:, 0]) / x[1]
    assert machine.input_shapes[1:3, 0] == pytest.approx(slopes, rel=1e-5)
    assert machine.output_shapes[0, 1:3] == pytest.approx(shapes[:, -1], rel=1e-6)


@pytest.mark.parametrize("name", ENTRANTS)
def test_sample_by_sample_is_what_the_whole_scan_gives(name):
    plant, _, record = scan_on("drive", "lost 20 %", 60)
    given = *nominal_of(plant, 1.0), plant.sample_time
    observer = OwnObserver(ENTRANTS[name])
    observer.start(*given)
    whole = observer.run(record.inputs, record.measurements)
    observer.start(*given)
    for k, (u, y) in enumerate(zip(record.inputs, record.measurements, strict=True)):
        assert np.array_equal(observer.step(u, y), whole[k])
    # What comes later changes nothing: the same start of another scan gives the same estimates.
    observer.start(*given)
    changed = record.measurements.copy()
    changed[40:] += 1.0
    assert np.array_equal(observer.run(record.inputs, changed)[:40], whole[:40])


def synthetic(values, plants=None, seeds=None):
    """A block of cells x draws x entrants, the second of them called Kalman."""
    cells, draws, count = values.shape
    names = ("a", "Kalman", *"bcdefg")[:count]
    plants = np.array(plants if plants is not None else [f"machine {k}" for k in range(cells)])
    return Block(np.asarray(values, float), plants, np.arange(draws) % TUNINGS, names)


def test_nemenyis_difference_is_the_published_one():
    """Demsar 2006, section 3.2.2: four classifiers on fourteen data sets, 1.25 at 5 %."""
    values = np.random.default_rng(0).uniform(size=(14, 2, 4))
    assert critical_difference(synthetic(values))[1] == pytest.approx(1.25, abs=0.005)


def test_a_clear_order_is_found_and_ties_share_a_rank():
    rng = np.random.default_rng(1)
    values = rng.uniform(0, 0.01, (8, 4, 1)) + np.array([0.1, 0.5, 0.5])
    values[..., 2] = values[..., 1]
    of = synthetic(values)
    found = mean_ranks(of)
    assert found["rank"].tolist() == [1.0, 2.5, 2.5]
    assert found["best place"].tolist() == found["last place"].tolist() == [1, 2, 2]
    assert critical_difference(of)[0] < 0.01
    assert against(of).loc["a", ["verdict", "better"]].tolist() == ["better", 1.0]
    assert against(of)["verdict"].tolist()[1:] == ["level", "level"]


def test_the_interval_is_over_machines_and_there_is_none_of_few():
    """Machines that differ by a deviation of 1 in lead, and seeds by next to nothing."""
    rng = np.random.default_rng(2)
    leads = rng.normal(0, 0.3, 40)
    values = 1 + np.stack([leads, np.zeros(40)], axis=1)[:, None] + rng.normal(0, 1e-3, (40, 4, 2))
    found = against(synthetic(values)).loc["a"]
    assert found["high"] - found["low"] == pytest.approx(2 * 1.96 * leads.std() / np.sqrt(40), rel=0.1)
    for few in (values[:4], values[:, :1]):
        found = against(synthetic(few)).loc["a"]
        assert np.isnan(found["low"]) and found["verdict"] == ""
        assert mean_ranks(synthetic(few))[["low", "high"]].isna().all(axis=None)
    assert ranking.with_interval(1.0, np.nan, np.nan, ".1f") == "1.0"


def test_the_committed_table_is_whole_and_the_leaderboard_shows_it():
    table = written_table()
    flexible = block(table, "flexible", list(ENTRANTS))
    assert flexible.values.shape[::2] == (len(PLANTS) * len(UNCERTAINTIES), len(ENTRANTS))
    assert tuple(table["public"].unique()) == tables.PUBLICS and len(flexible.groups) >= ranking.FEWEST_DRAWS
    loops = block(table, "tracking", [*ENTRANTS, ORACLE])
    assert len(loops.groups) == 4 and set(loops.groups) == set(range(TUNINGS))
    shown = tables.leaderboard(table, pd.read_csv(RECORDED), pd.read_csv(compute.FILE))
    assert shown == tables.PAGE.read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_committed_table_is_of_this_code():
    table, public = written_table().set_index(KEYS), tables.PUBLICS[0]
    for track, score, plant in (("estimate", "flexible", "drive"), ("loop", "tracking", "stage")):
        scan = next(each for each in scans_of(plant, public, 0) if each.track == track)
        row = table.loc[(score, public, plant, scan.uncertainty, 0)]
        for name, knobs in settings_for(plant, 0, ["Kalman", "fictitious noise", "extended Kalman"]).items():
            assert scores_of(name, None, scan, knobs)[score] == pytest.approx(row[name], rel=2e-3), name


@pytest.mark.slow
def test_the_committed_map_is_of_this_code():
    """Of the second public number, whose settings are those of the first; the Kalman filter has none."""
    errors = stored_map(PUBLICS[1])
    kept = errors[(errors["size"] == 0.02) & (errors["noise"] == 30)]["Kalman"].to_numpy()[:5]
    found = flexible_errors(
        plant_of("stage"), 0.02, 30.0, PUBLICS[1], range(5), {"Kalman": OwnObserver(ENTRANTS["Kalman"])}
    )
    assert found["Kalman"] == pytest.approx(kept, rel=2e-3)
