"""The contest of observers: what an observer is given, who is shown to the door, and what the scores mean."""

import csv
import re
import textwrap
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pandas as pd
import pytest

from contest import bench, tuning
from contest import table as tables
from contest.noise_map import (
    FILE,
    MAPPED,
    NOISES,
    SEEDS,
    SIZES,
    ahead_of,
    crossings,
    flexible_errors,
    leads,
    turning,
)
from contest.nominal import OwnObserver, nominal_of
from contest.plants import PLANTS, sample_plant
from contest.runner import Disqualified, ExternalObserver
from contest.scores import ENTRANTS, contest_trial
from contest.table import (
    COLUMNS,
    as_markdown,
    joined,
    measured,
    median_interval,
    of_seeds,
    ranked,
    run_contest,
    standings,
    write_table,
)
from contest.tuning import WORST
from contest.uncertainties import UNCERTAINTIES, hidden_seed, sample_truth
from stillwork.base.checks import InputError
from workbook import paths

GUIDE = (paths.root() / "docs" / "contest.md").read_text(encoding="utf-8")
# The guide's Kalman filter shares no code with the house's: its Riccati equation is run until it stands still.
[KALMAN] = re.findall(r"^```python\n(.*?)^```$", GUIDE, re.DOTALL | re.MULTILINE)


def test_the_guide_counts_right():
    words = " ".join(GUIDE.split())
    assert {6: "Six machines"}[len(PLANTS)] in words
    assert f"{len(UNCERTAINTIES)} doubts: none at all, and {len(UNCERTAINTIES) - 1} ways" in words


def test_the_guide_shows_the_committed_ranking():
    file = paths.data("motion", "contest.csv")
    assert as_markdown(standings(pd.read_csv(file))) in GUIDE
    with open(file, encoding="utf-8") as stream:
        _, *lines = csv.reader(stream)
    mean = {line[0]: float(line[4]) for line in lines if line[2:4] == ["all", "mean error"]}
    shown = re.findall(r"^\| \d+ to \d+ \| ([^|]+) \| ([\d.]+) to ([\d.]+) \|", GUIDE, re.MULTILINE)
    assert [name for name, _, _ in shown] == sorted(mean, key=mean.get)
    assert all(float(low) - 0.005 <= mean[name] <= float(high) + 0.005 for name, low, high in shown)


@pytest.fixture
def told():
    plant = sample_plant("drive", np.random.default_rng(0))
    return plant, *nominal_of(plant, 1.0), plant.sample_time


@pytest.fixture
def written(tmp_path):
    def write(text, name="mine.py"):
        (tmp_path / name).write_text(textwrap.dedent(text), encoding="utf-8")
        return tmp_path / name

    return write


def step_of(body, start="pass"):
    """An observer whose `step` (and `start`) is this."""
    return f"""
import numpy as np
class Observer:
    def start(self, model, noise, sample_time):
        self.n = len(model.a)
        {start}
    def step(self, input, measurement):
        {body}
        return np.zeros(self.n)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "text, reason",
    [
        (step_of("raise ValueError('no idea')"), "raises ValueError: no idea (line 8)"),
        (step_of("return None"), "raises ValueError: step returns nothing"),
        (step_of("return np.full(self.n, np.nan)"), "not finite"),
        (step_of("return np.zeros(self.n + 1)"), "an estimate of shape (5,), not (4,)"),
        (step_of("return 'the truth'"), "not of real numbers"),
        (step_of("return np.zeros(self.n, complex)"), "an estimate of complex128, not of real numbers"),
        (step_of("while True: pass"), "hangs"),
        (step_of("print('look')"), "prints"),
        (step_of("import os; os.write(1, b'look')"), "prints"),
        (step_of("self.all = [np.empty(10**8) for _ in range(1000)]"), "allocates more memory"),
        (step_of("open('/etc/hostname').read()"), "reads files (/etc/hostname)"),
        (step_of("import contest.uncertainties"), "reads files ("),
        (step_of("import subprocess; subprocess.run(['true'])"), "asks for subprocess.Popen"),
        (step_of("import os; os.listdir('/etc')"), "reads files (/etc)"),
        (step_of("import os; os.kill(os.getppid(), 0)"), "asks for os.kill"),
        (step_of("import os; os._exit(0)"), "its process ends"),
        ("class Other: pass", "raises AttributeError"),
        ("class Observer(:", "raises SyntaxError"),
    ],
)
def test_who_breaks_the_rules_is_out_by_name_and_reason(text, reason, told, written):
    given = told[1:]
    with pytest.raises(Disqualified) as out, ExternalObserver(written(text), 60.0) as observer:
        observer.start([given])
        if "hangs" in reason:
            observer.deadline = time.monotonic() + 0.5
        for _ in range(2):
            observer.step([0], np.zeros((1, 1)), np.zeros((1, 1)))
    assert reason in str(out.value)


@pytest.mark.slow
def test_caught_errors_do_not_hide_what_was_tried(told, written):
    sly = step_of(
        """try:
            open('/etc/passwd')
        except PermissionError:
            pass"""
    )
    given = told[1:]
    with pytest.raises(Disqualified, match="files"), ExternalObserver(written(sly)) as observer:
        observer.start([given])
        observer.step([0], np.zeros((1, 1)), np.zeros((1, 1)))


@pytest.mark.slow
def test_an_observer_is_told_of_nothing_but_the_nominal_model(written):
    """It writes what it finds into its estimate: of all arrays that its process holds none knows what comes."""
    spy = """
    import gc
    import numpy as np
    class Observer:
        def start(self, model, noise, sample_time):
            self.n, self.seen = len(model.a), 0
            assert sorted(vars(model)) == [
                'a', 'b', 'c', 'damping', 'frequencies', 'input_shapes', 'output_shapes', 'rigid_modes'
            ]
            assert sorted(vars(noise)) == ['process', 'sensor']
        def step(self, input, measurement):
            self.seen += 1
            largest = max((each.size for each in gc.get_objects() if isinstance(each, np.ndarray)), default=0)
            out = np.zeros(self.n)
            out[0], out[1], out[2] = self.seen, largest, input.size + measurement.size
            return out
    """
    plant = sample_plant("drive", np.random.default_rng(0))
    with ExternalObserver(written(spy)) as observer:
        observer.start([(*nominal_of(plant, 1.0), plant.sample_time)])
        answers = np.array([observer.step([0], np.zeros((1, 1)), np.ones((1, 1)))[0] for _ in range(50)])
    assert answers[:, 0].tolist() == list(range(1, 51))  # one call a sample, each before the next is shown
    assert answers[:, 1].max() <= 1000  # not even a short scan fits in there; numpy's own tables do
    assert set(answers[:, 2]) == {2.0}


@pytest.mark.slow
def test_a_foreign_kalman_filter_stands_where_ours_does(written):
    scores, out = contest_trial(
        "random machine",
        0,
        "a test",
        {"Kalman": []},
        {"mine": str(written(KALMAN))},
        ("all 5 %", "lost 20 %"),
    )
    assert not out
    ours, theirs = (
        [(x.rigid, x.flexible, x.tracking, x.peak) for x in scores if x.entrant == name]
        for name in ("Kalman", "mine")
    )
    np.testing.assert_allclose(ours, theirs, rtol=1e-6)


@pytest.mark.slow
def test_an_observer_may_compile_itself_and_look_at_the_clock(told, written):
    compiled = """
    import time
    import numba
    import numpy as np
    import scipy.linalg
    from stillwork.base.kernels import kernel
    @numba.njit
    def twice(x):
        return 2 * x
    @kernel
    def half(x):
        return x / 2
    class Observer:
        def start(self, model, noise, sample_time):
            self.n, self.began = len(model.a), time.perf_counter()
        def step(self, input, measurement):
            assert time.perf_counter() > self.began
            return half(twice(np.full(self.n, 3.0)))
    """
    with ExternalObserver(written(compiled)) as observer:
        observer.start([told[1:]])
        assert observer.step([0], np.zeros((1, 1)), np.zeros((1, 1))).tolist() == [[3.0] * 4]


@pytest.mark.slow
def test_the_contest_goes_on_without_the_disqualified(written, capsys):
    bad = written(
        step_of("if self.k > 500: return np.full(self.n, np.nan)\n        self.k += 1", "self.k = 0"),
        "hopeless.py",
    )
    given = {"only": ["zero"], "plants": ("drive",), "doubts": ("none", "all 2 %")}
    scores, disqualified = run_contest("a test", 1, [bad], **given)
    assert disqualified == {"hopeless": "estimates that are not finite"}
    assert {each.entrant for each in scores} == {"zero", "Kalman"}


def test_a_file_that_is_not_there_and_a_name_that_is_taken_are_told(written):
    with pytest.raises(InputError, match=r"^nowhere\.py\b"):
        ExternalObserver("nowhere.py")
    with pytest.raises(InputError, match="'Kalman'"):
        run_contest("a test", 1, [str(written(KALMAN, "Kalman.py"))])
    with pytest.raises(InputError, match="observers"):
        run_contest("a test", 1, ["here/mine.py", "there/mine.py"])


def scan(name, doubt, samples=bench.SAMPLES, seed=1):
    plant = sample_plant(name, np.random.default_rng(seed))
    truth = sample_truth(plant, UNCERTAINTIES[doubt], samples, np.random.default_rng([seed, 1]))
    return (
        plant,
        truth,
        bench.record(bench.assemble(plant, truth, bench.BANDWIDTH_RATIO_LOW, estimated=False)),
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANTS)
@pytest.mark.parametrize("doubt", ["drift 5 %", "truncation", "delay"])
def test_scans_follow_the_equations_of_the_machine(name, doubt):
    _, truth, record = scan(name, doubt)
    pieces, samples = len(truth.a), len(record.states)
    for k in range(0, samples - 1, 37):
        piece = k * pieces // samples
        following = truth.a[piece] @ record.states[k] + truth.b[piece] @ (
            record.inputs[k + 1] + truth.process[k]
        )
        assert np.allclose(
            record.states[k + 1], following, rtol=1e-10, atol=1e-12 * np.abs(record.states).max()
        )
        late = max(k - truth.delay, 0)
        seen = truth.c @ record.states[late] + truth.sensor[late]
        assert np.allclose(record.measurements[k], seen, rtol=1e-9, atol=1e-12 * np.abs(seen).max())


@pytest.mark.parametrize(
    "name",
    # The machine of the measured structure is fitted first, for a second.
    [pytest.param(each, marks=[pytest.mark.slow] * (each == "measured structure")) for each in PLANTS],
)
def test_without_doubt_the_machine_is_the_one_told_of_and_the_cautious_loop_holds(name):
    plant, truth, record = scan(name, "none")
    model, _ = nominal_of(plant, 1.0)
    for told, true in ((model.a, truth.a), (model.c, truth.c)):
        np.testing.assert_allclose(true, np.broadcast_to(told, true.shape), rtol=1e-12)
    machine = bench.assemble(plant, truth, bench.BANDWIDTH_RATIO_LOW, estimated=False)
    stroke = machine.setpoint[-1, 0]
    mean, peak = bench.tracking_errors(machine, record.states)
    assert 0 < mean < peak < 0.01 * stroke
    assert bench.state_errors(record, np.zeros_like(record.states), model.rigid_modes) == (1.0, 1.0)
    perfect = bench.state_errors(record, record.states, model.rigid_modes)
    lost = np.zeros_like(record.states)
    lost[-1, -1] = np.nan
    assert bench.state_errors(record, lost, model.rigid_modes) == (np.inf, np.inf)
    assert perfect == (0.0, 0.0)


def test_a_loop_with_the_estimate_zero_is_the_loop_alone():
    plant, truth, record = scan("stage", "all 2 %")
    machine = bench.assemble(plant, truth, bench.BANDWIDTH_RATIO_LOW, estimated=True)
    width = machine.compensation.shape[1]
    moved = bench.run_scans([bench.loop_scan(machine)], lambda *_: [np.zeros(width)])[0]
    assert np.allclose(moved, record.states, rtol=1e-12, atol=0)


def test_the_true_states_let_the_bold_loop_stand_and_zero_does_not():
    """What measurement compensation and active damping are for, with the best estimate there could be."""
    plant, truth, record = scan("stage", "none")
    machine = bench.assemble(plant, truth, bench.BANDWIDTH_RATIO_HIGH, estimated=True)
    width, run = machine.compensation.shape[1], bench.loop_scan(machine)
    next(run)
    with pytest.raises(StopIteration) as end:
        while True:
            run.send(run.gi_frame.f_locals["memory"][0][:width].copy())
    moved = end.value.value
    steady = bench.tracking_errors(
        bench.assemble(plant, truth, bench.BANDWIDTH_RATIO_LOW, estimated=False), record.states
    )
    assert np.all(bench.tracking_errors(machine, moved) < 0.1 * steady)
    [alone] = bench.run_scans([bench.loop_scan(machine)], lambda *_: [np.zeros(width)])
    assert np.all(bench.tracking_errors(machine, alone) == np.inf)


def test_hidden_seeds_follow_from_the_public_number_alone():
    assert hidden_seed("20180628", "stage", 0) == hidden_seed("20180628", "stage", 0)
    others = {hidden_seed(public, plant, k) for public in "12" for plant in PLANTS for k in range(20)}
    assert len(others) == 2 * len(PLANTS) * 20 and max(others) < 2**64


@pytest.mark.parametrize("name", ENTRANTS)
def test_sample_by_sample_is_what_the_whole_scan_gives(name):
    plant, _, record = scan("drive", "lost 20 %", 60)
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


@pytest.mark.slow
def test_the_interval_of_a_median_holds_it_as_often_as_it_says():
    rng = np.random.default_rng(0)
    for runs in (6, 10, 25):
        held = 0
        for _ in range(2000):
            _, low, high = median_interval(rng.exponential(size=runs))
            held += low <= np.log(2) <= high
        assert held / 2000 > 0.94
    assert median_interval([3.0, np.inf, 1.0]) == (3.0, 1.0, np.inf)


@pytest.fixture(scope="module")
def small():
    """Three entrants and the Kalman filter on two seeds."""
    given = {"only": ["zero", "open model"], "plants": ("drive",), "doubts": ("all 2 %",), "loops": 1}
    return run_contest("a test", 2, **given)[0]


@pytest.mark.slow
def test_the_table_and_the_ranking_say_what_the_scores_say(small, tmp_path):
    table = ranked(measured(small))
    write_table(table, tmp_path / "table.csv")
    with open(tmp_path / "table.csv", encoding="utf-8") as stream:
        header, *lines = csv.reader(stream)
    assert tuple(header) == COLUMNS
    # Three of the ranking, two seeds, the bytes; rigid and flexible, tracking and peak.
    assert len(lines) == 10 * len({each.entrant for each in small}) == 30
    zero = [line for line in lines if line[0] == "zero" and line[3] in ("rigid", "flexible", "mean error")]
    assert {tuple(line[4:7]) for line in zero} == {("1", "1", "1")}
    own = [each.flexible for each in small if each.entrant == "Kalman"]
    row = table[(table["entrant"] == "Kalman") & (table["doubt"] == "all")].set_index("score")
    assert row.loc["mean error", "median"] == pytest.approx(np.mean(own), rel=1e-3)
    assert row.loc["mean error", ["low", "high"]].tolist() == pytest.approx(sorted(own), rel=1e-3)
    assert row.loc["less Kalman", ["median", "low", "high"]].tolist() == [0.0, 0.0, 0.0]
    found = standings(table)
    assert found["observer"].tolist() == table[table["score"] == "rank"]["entrant"].tolist()
    zero = found.set_index("observer").loc["zero"]
    assert zero[["rank", "seeds", "rigid"]].tolist() == ["3 to 3", "2", "1 to 1"]
    one = table[(table["entrant"] == "zero") & (table["score"] == "peak")]["median"].item()
    assert zero["peak"] == f"{one:.2g} to {one:.2g}"  # on one machine under one doubt
    # A tie is one place for both.
    twins = [each._replace(entrant="twin") for each in small if each.entrant == "Kalman"]
    stood = ranked(measured(small + twins))
    ranks = stood[stood["score"] == "rank"].set_index("entrant")["median"]
    assert ranks["twin"] == ranks["Kalman"]


def test_a_seed_on_which_the_estimate_is_lost_counts(small):
    """A median over the other seeds alone would stand too well."""
    lost = [
        each._replace(flexible=np.inf) if (each.entrant, each.seed) == ("Kalman", 1) else each
        for each in small
    ]
    table = ranked(measured(lost)).set_index(["entrant", "doubt", "score"])
    (doubt,) = {each.doubt for each in small}
    own = [each.flexible for each in small if (each.entrant, each.seed) == ("Kalman", 0)]
    found = table.loc[("Kalman", doubt, "flexible"), ["median", "low", "high"]]
    assert found.to_numpy(float).ravel().tolist() == pytest.approx([np.inf, own[0], np.inf], rel=1e-3)
    assert table.loc[("Kalman", "seed 1", "mean error"), "median"].item() == WORST


def test_who_has_no_knobs_has_nothing_to_tune(tmp_path, monkeypatch):
    assert tuning.positions("Kalman").shape == (1, 0)
    monkeypatch.setattr(tuning, "FILE", tmp_path / "settings.toml")
    for name in ("Kalman", "particle"):
        with pytest.raises(InputError, match=rf"^name\b.*'{name}'"):
            tuning.main([name])
    assert not tuning.FILE.exists()


def test_who_runs_on_fewer_seeds_is_compared_with_kalman_there(small):
    """A twin of the Kalman filter that ran on one seed alone stands where the filter does, whatever that seed."""
    for seed in (0, 1):
        twins = [
            each._replace(entrant="twin") for each in small if (each.entrant, each.seed) == ("Kalman", seed)
        ]
        both = ranked(measured(small + twins))
        stood = both[both["score"].isin(["mean error", "rank", "less Kalman"]) & (both["doubt"] == "all")]
        columns = ["score", "median", "low", "high"]
        twin, kalman = (
            stood.loc[stood["entrant"] == name, columns].reset_index(drop=True) for name in ("twin", "Kalman")
        )
        assert twin.equals(kalman)
        assert standings(both).set_index("observer").loc[["twin", "Kalman"], "seeds"].tolist() == ["1", "2"]


def test_heavy_entrants_run_on_the_first_seeds_alone():
    given = {"only": ["unscented Kalman"], "plants": ("drive",), "doubts": ("none",), "loops": 1}
    found = {(each.entrant, each.seed) for each in run_contest("a test", 2, heavy=1, **given)[0]}
    assert found == {("Kalman", 0), ("Kalman", 1), ("unscented Kalman", 0)}


@pytest.mark.slow
def test_an_entrant_that_comes_later_stands_where_it_would_have_stood(small):
    """Only it is run: the others' scans were the same."""
    whole, later = (
        ranked(measured(each))
        for each in (
            small,
            run_contest("a test", 2, only=["zero"], plants=("drive",), doubts=("all 2 %",), loops=1)[0],
        )
    )
    before = ranked(whole[whole["entrant"] != "zero"])
    found = joined(before, later)
    columns = [name for name in COLUMNS if name != "microseconds"]
    key = ["entrant", "plant", "doubt", "score"]
    assert (
        found[columns]
        .sort_values(key, ignore_index=True)
        .equals(whole[columns].sort_values(key, ignore_index=True))
    )
    assert of_seeds(found).shape == (3, 2)
    others = ranked(
        measured(run_contest("another", 2, only=["zero"], plants=("drive",), doubts=("none",), loops=1)[0])
    )
    with pytest.raises(InputError, match="scans"):
        joined(before, others)


@pytest.mark.slow
def test_workers_that_share_a_process_do_not_share_an_observer():
    """As a cluster's workers with several threads do."""
    given = {"only": ["open model"], "plants": ("drive", "stage"), "doubts": ("all 2 %", "delay")}
    alone, _ = run_contest("a test", 2, **given)
    with ThreadPoolExecutor(4) as pool:
        together, _ = run_contest("a test", 2, executor=pool, **given)
    kept = ["entrant", "plant", "doubt", "seed", "rigid", "flexible", "tracking", "peak"]
    assert pd.DataFrame(together)[kept].equals(pd.DataFrame(alone)[kept])


@pytest.mark.slow
def test_a_cluster_gives_the_table_that_this_machine_gives(written, tmp_path, monkeypatch):
    """6 s of CPU: only a real worker in another process shows what does not travel there."""
    from distributed import LocalCluster

    monkeypatch.setattr(tables, "run_contest", partial(run_contest, plants=("drive",), doubts=("all 2 %",)))
    given = {"seeds": 2, "public": "a test", "only": ["unscented Kalman"], "loops": 1, "heavy": 1}
    mine, here, there = [str(written(KALMAN))], str(tmp_path / "here.csv"), str(tmp_path / "there.csv")
    with LocalCluster(n_workers=1, threads_per_worker=2, dashboard_address=None) as cluster:
        assert tables.hold_contest(mine, scheduler=cluster.scheduler_address, out=there, **given) == 0
    assert tables.hold_contest(mine, jobs=1, out=here, **given) == 0
    one, other = (pd.read_csv(file).drop(columns="microseconds") for file in (here, there))
    assert one.equals(other) and set(one["entrant"]) == {"Kalman", "unscented Kalman", "mine"}


@pytest.mark.slow
def test_whoever_is_out_is_not_waited_for_again(written, monkeypatch):
    """Its process starts once, however many seeds and machines there are."""
    starts, enter = [], ExternalObserver.__enter__
    monkeypatch.setattr(ExternalObserver, "__enter__", lambda self: starts.append(self) or enter(self))
    bad = written(step_of("raise ValueError('no idea')"), "hopeless.py")
    _, disqualified = run_contest(
        "a test", 2, [bad], only=["zero"], plants=("drive", "stage"), doubts=("none",)
    )
    assert list(disqualified) == ["hopeless"] and len(starts) == 1


def test_the_committed_table_holds_every_entrant_plant_and_doubt():
    with open(paths.data("motion", "contest.csv"), encoding="utf-8") as stream:
        header, *lines = csv.reader(stream)
    assert tuple(header) == COLUMNS
    flexible = {tuple(line[:3]) for line in lines if line[3] == "flexible"}
    assert flexible == {
        (name, plant, doubt) for name in ENTRANTS for plant in PLANTS for doubt in UNCERTAINTIES
    }
    assert all(float(line[5]) <= float(line[4]) <= float(line[6]) for line in lines if line[1] != "all")


def test_the_committed_map_holds_every_cell_and_seed():
    errors = pd.read_csv(FILE)
    assert list(errors.columns) == ["size", "noise", "seed", *MAPPED]
    cells = {(size, noise, seed) for size in SIZES for noise in NOISES for seed in range(SEEDS)}
    assert set(errors[["size", "noise", "seed"]].itertuples(index=False, name=None)) == cells
    assert len(errors) == len(cells)
    assert np.isfinite(errors.to_numpy()).all() and (errors[list(MAPPED)] > 0).all(axis=None)


def test_a_lead_is_over_the_same_scans():
    # Errors of the scans differ by far more than the observers do: only pairs show the lead.
    kalman = np.array([0.2, 1.0, 3.0])
    errors = pd.DataFrame({"size": 0.01, "noise": 1.0, "seed": range(3), "Kalman": kalman})
    for place, name in enumerate(MAPPED[1:]):
        errors[name] = kalman - [0.1, 0.2, 0.3] + place
    found = leads(errors)
    assert list(found["entrant"]) == list(MAPPED[1:])
    assert found["lead"].to_numpy() == pytest.approx(0.2 - np.arange(len(found)))
    # Student's t with two degrees of freedom: 4.30265 deviations of 0.1 over the root of three.
    assert (found["high"] - found["lead"]).to_numpy() == pytest.approx(0.248414, rel=1e-5)
    assert (found["lead"] - found["low"]).to_numpy() == pytest.approx(0.248414, rel=1e-5)
    assert found["error at most"][0] > 1.2  # the mean of its errors


def test_where_a_lead_begins_is_interpolated_in_the_logarithm_of_the_noise():
    noises = [1.0, 10.0, 100.0, 1000.0]
    assert turning(noises, [-1, 3, 1, 1]) == pytest.approx(10**0.25)
    assert turning(noises, [-1, 3, -1, 1]) == pytest.approx(10**2.5)  # from there on it stays
    assert turning(noises, [1, 2, 3, 4]) == 0.0
    assert turning(noises, [1, 2, 3, -4]) == np.inf


@pytest.mark.slow
def test_the_line_of_a_known_map_has_the_interval_of_its_means():
    rng, deviation = np.random.default_rng(3), 0.3
    cells = [(size, noise, seed) for size in SIZES for noise in NOISES for seed in range(SEEDS)]
    errors = pd.DataFrame(cells, columns=["size", "noise", "seed"])
    errors["one"], errors["other"] = (
        0.0,
        np.log10(errors["noise"] / 7) + rng.normal(0, deviation, len(errors)),
    )
    line = crossings(errors, ahead_of("one", "other"))
    # Between three and ten times the noise the mean lead is a mean of two, weighed by their distances.
    share = np.log(7 / 3) / np.log(10 / 3)
    width = 2 * 1.96 * deviation / np.sqrt(SEEDS) * np.hypot(share, 1 - share)
    # The deviation of forty values is known to a tenth, and that of the quantiles to a twentieth.
    assert np.log10(line["high"] / line["low"]).mean() == pytest.approx(width, rel=0.15)
    assert (np.abs(np.log10(line["noise"] / 7)) < width).all() and (line["crosses"] == 1).all()
    backwards = crossings(errors, ahead_of("other", "one"))
    assert np.isinf(backwards["noise"]).all() and (backwards["crosses"] == 0).all()


def test_a_cell_of_the_map_is_its_seeds_whoever_else_runs():
    plant = sample_plant("stage", np.random.default_rng(0))
    observers = {name: OwnObserver(ENTRANTS[name]) for name in ("Kalman", "open model", "zero")}
    all_three = flexible_errors(plant, 0.02, 3.0, "a test", 2, observers)
    alone = flexible_errors(plant, 0.02, 3.0, "a test", 1, {"Kalman": OwnObserver(ENTRANTS["Kalman"])})
    assert all_three["Kalman"][0] == alone["Kalman"][0]
    assert not np.array_equal(all_three["Kalman"], all_three["open model"])
    assert all_three["zero"] == pytest.approx(1.0, abs=1e-12)
