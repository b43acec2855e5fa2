"""The contest of observers: what an observer is given, what the scores mean, how ranks and their intervals are made."""

import hashlib
import json
import re
import shutil
import socketserver
import subprocess
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pandas as pd
import pytest
from scipy import integrate

from contest import bench, plants, ranking, tuning
from contest import table as tables
from contest.machines import BUILDERS, machine_numbers
from contest.noise_map import (
    FILE as MAP,
)
from contest.noise_map import (
    MAPPED,
    NOISES,
    PUBLICS,
    SEEDS,
    SIZES,
    flexible_errors,
    leads,
    map_variants,
    stored_map,
)
from contest.nominal import OwnObserver, nominal_of
from contest.plants import PLANTS, plant_of
from contest.ranking import (
    KEYS,
    Block,
    against,
    block,
    by_track,
    critical_difference,
    leave_one_out,
    mean_ranks,
    robustness,
    standings,
)
from contest.record import record_standings
from contest.runner import can_isolate
from contest.scores import ENTRANTS, ORACLE, Scan, opened, recorded, scores_of, truth_of
from contest.table import FILE, as_markdown, digest_of, joined, run_contest
from contest.tuning import TUNINGS, scans_of, settings_for
from contest.uncertainties import UNCERTAINTIES, hidden_seed, sample_truth
from stillwork.base.checks import InputError
from workbook import paths

GUIDE = (paths.root() / "docs" / "contest.md").read_text(encoding="utf-8")
# The guide's Kalman filter shares no code with ours: its Riccati equation is run until it stands still.
[KALMAN] = re.findall(r"^```python\n(.*?)^```$", GUIDE, re.DOTALL | re.MULTILINE)
[HEADER] = re.findall(r"^```c\n(.*?)^```$", GUIDE, re.DOTALL | re.MULTILINE)
LIBRARY = """
#include <stdlib.h>
#include <string.h>
static int n, m, p;
static double *a, *b, *x, *y;
static double *copy(const double *from, int count)
{
    return memcpy(malloc(count * sizeof(double)), from, count * sizeof(double));
}
void observer_start(int states, int inputs, int outputs, const double *A, const double *B, const double *C,
                    const double *process, const double *sensor, double sample_time, int knobs, const double *settings)
{
    n = states; m = inputs; p = outputs;
    a = copy(A, n * n); b = copy(B, n * m); x = calloc(n, sizeof(double)); y = calloc(n, sizeof(double));
}
void observer_step(const double *input, const double *measurement, double *estimate)
{
    for (int i = 0; i < n; i++) {
        y[i] = 0;
        for (int j = 0; j < n; j++) y[i] += a[i * n + j] * x[j];
        for (int j = 0; j < m; j++) y[i] += b[i * m + j] * input[j];
    }
    memcpy(x, y, n * sizeof(double));
    memcpy(estimate, x, n * sizeof(double));
}
"""
MODEL_ALONE = """
import numpy as np
class Observer:
    def start(self, model, noise, sample_time):
        self.model, self.x = model, np.zeros(len(model.a))
    def step(self, input, measurement):
        self.x = self.model.a @ self.x + self.model.b @ input
        return self.x
"""


CHECKED = "        assert size == 3.0\n        self.model,"


def estimates_of(source, scan):
    record, given = recorded(scan), scan.given()
    with opened("mine", str(source), given, ()) as observer:
        return bench.run_scan(bench.open_scan(record, len(given[0].a)), observer.step)


@pytest.fixture
def written(tmp_path):
    def write(text, name="mine.py"):
        (tmp_path / name).write_text(text, encoding="utf-8")
        return tmp_path / name

    return write


@pytest.mark.slow
def test_a_foreign_kalman_filter_gets_what_ours_gets(written):
    file = str(written(KALMAN))
    for scan in (
        Scan("estimate", "gantry", "lost 20 %", "a test", 0),
        Scan("loop", "stage", "all 5 %", "a test", 0),
    ):
        ours, theirs = (
            scores_of(name, source, scan, ()) for name, source in (("Kalman", None), ("mine", file))
        )
        names = {"flexible", "rigid", "tracking", "rejection"} & set(ours)
        assert [theirs[each] for each in names] == pytest.approx([ours[each] for each in names], rel=1e-5)


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("cc"), reason="there is no C compiler")
def test_a_library_in_c_enters(written, tmp_path):
    source, scan = written(LIBRARY, "mine.c"), Scan("estimate", "gantry", "lost 20 %", "a test", 0)
    for name in ("observer_start", "observer_step"):
        [declared] = re.findall(rf"void {name}\([^)]*\)", HEADER)
        assert declared.split("(")[0] in LIBRARY and declared.count(",") == re.search(
            rf"void {name}\([^)]*\)", LIBRARY
        )[0].count(",")
    subprocess.run(["cc", "-shared", "-fPIC", "-o", tmp_path / "mine.so", source], check=True)
    python = estimates_of(written(MODEL_ALONE), scan)
    np.testing.assert_allclose(estimates_of(tmp_path / "mine.so", scan), python, rtol=1e-9, atol=1e-18)


@pytest.mark.slow
def test_a_program_at_a_socket_enters_and_is_not_isolated(written):
    class Handler(socketserver.StreamRequestHandler):
        def handle(self):
            given = json.loads(self.rfile.readline())
            a, b = (np.array(given["model"][each]) for each in "ab")
            x, answer = np.zeros(len(a)), {}
            while True:
                self.wfile.write(json.dumps(answer).encode() + b"\n")
                if not (line := self.rfile.readline()):
                    return
                x = a @ x + b @ np.array(json.loads(line)[0])
                answer = x.tolist()

    scan = Scan("estimate", "gantry", "lost 20 %", "a test", 0)
    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        source = f"tcp:127.0.0.1:{server.server_address[1]}"
        found = estimates_of(source, scan)
        assert not tables.ExternalObserver(source).isolated
        server.shutdown()
    np.testing.assert_allclose(found, estimates_of(written(MODEL_ALONE), scan), rtol=1e-9, atol=1e-18)


def test_a_file_that_is_not_there_and_a_name_that_is_taken_are_reported(written):
    with pytest.raises(InputError, match=r"^nowhere\.py\b"):
        run_contest("a test", 1, ["nowhere.py"])
    with pytest.raises(InputError, match="'Kalman'"):
        run_contest("a test", 1, [str(written(KALMAN, "Kalman.py"))])
    with pytest.raises(InputError, match="cannot be reached"):  # two ports of a host are two observers
        run_contest("a test", 1, ["tcp:127.0.0.1:1", "tcp:127.0.0.1:2"])
    with pytest.raises(InputError, match="one name"):
        run_contest("a test", 1, [str(written(KALMAN)), str(written(KALMAN))])


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


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANTS)
@pytest.mark.parametrize("uncertainty", ["drift 5 %", "truncation", "delay"])
def test_scans_follow_the_equations_of_the_machine(name, uncertainty):
    _, truth, record = scan_on(name, uncertainty)
    pieces, samples = len(truth.a), len(record.states)
    scale = np.abs(record.states).max()
    for k in range(0, samples - 1, 37):
        piece = k * pieces // samples
        following = truth.a[piece] @ record.states[k] + truth.b[piece] @ (
            record.inputs[k + 1] + truth.process[k]
        )
        assert np.allclose(record.states[k + 1], following, rtol=1e-10, atol=1e-12 * scale)
        late = max(k - truth.delay, 0)
        seen = truth.c @ record.states[late] + truth.sensor[late]
        assert np.allclose(record.measurements[k], seen, rtol=1e-9, atol=1e-12 * np.abs(seen).max())


@pytest.mark.parametrize("name", SLOW_TO_FIT)
def test_without_uncertainty_the_machine_is_the_given_one_and_the_cautious_loop_holds(name):
    plant, truth, record = scan_on(name, "none")
    model, _ = nominal_of(plant, 1.0)
    for nominal, true in ((model.a, truth.a), (model.c, truth.c)):
        np.testing.assert_allclose(true, np.broadcast_to(nominal, true.shape), rtol=1e-12)
    machine = bench.assemble(plant, truth, bench.BANDWIDTH_RATIO_LOW, estimated=False)
    assert np.all(bench.loop_errors(machine, record.states) < 0.02 * machine.setpoint[-1, 0])
    assert bench.state_errors(record, np.zeros_like(record.states), model.rigid_modes) == (1.0, 1.0)
    assert bench.state_errors(record, record.states, model.rigid_modes) == (0.0, 0.0)
    lost = np.zeros_like(record.states)
    lost[-1, -1] = np.nan
    assert bench.state_errors(record, lost, model.rigid_modes) == (np.inf, np.inf)


def test_machines_are_of_four_kinds_at_least_and_of_named_sources():
    assert len(PLANTS) >= 12 and len({each.kind for each in PLANTS.values()}) >= 4
    for name, each in PLANTS.items():
        assert f"| {name} | {each.kind} | {each.source} |" in GUIDE
    words = " ".join(GUIDE.split())
    assert f"{len(UNCERTAINTIES)} uncertainties" in words and f"by less than {ranking.MARGIN}" in words
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


def test_a_loop_with_the_estimate_zero_is_the_loop_alone():
    plant, truth, record = scan_on("stage", "all 2 %")
    machine = bench.assemble(plant, truth, bench.BANDWIDTH_RATIO_LOW, estimated=True)
    width = machine.compensation.shape[1]
    moved = bench.run_scan(bench.loop_scan(machine), lambda *_: np.zeros(width))
    assert np.allclose(moved, record.states, rtol=1e-12, atol=0)


@pytest.mark.slow
def test_the_true_states_let_the_bold_loop_stand_and_zero_does_not():
    scan = Scan("loop", "stage", "none", "a test", 0)
    assert all(0 < each < 0.3 for each in scores_of(ORACLE, None, scan, ()).values())
    assert set(scores_of("zero", None, scan, ()).values()) == {np.inf}


@pytest.mark.slow
def test_the_measured_sensitivity_is_that_of_the_linear_loop():
    """The loop's equations solved at each line, with a gain that does not depend on the data."""
    scan = Scan("bandwidth", "stage", "all 2 %", "a test", 0)
    plant, truth, ratio = plant_of("stage"), truth_of(scan), 0.2
    observer = OwnObserver(ENTRANTS["Kalman"])
    observer.start(*scan.given())
    found = bench.sensitivity_peak(plant, truth, ratio, lambda task: bench.run_scan(task, observer.step))
    machine = bench.assemble(plant, truth, ratio, estimated=True)
    a, b, c = truth.a[0], truth.b[0], truth.c
    forward, onward, gain, seen = observer.made.data
    (ca, cb, cc), (to_rigid, to_force) = machine.control, machine.directions
    sizes = []
    for line in bench.LINES:
        z = np.exp(2j * np.pi * line / bench.PERIOD)
        to_state = np.linalg.solve(z * np.eye(len(a)) - a, b[:, 0])  # force to states
        predicts = np.eye(len(forward)) - gain @ seen
        of_force = predicts @ onward[:, 0] / z + gain @ (c @ to_state)
        estimate = np.linalg.solve(np.eye(len(forward)) - predicts @ forward / z, of_force)
        controller = cc @ np.linalg.solve(z * np.eye(len(ca)) - ca, cb) * to_force[0, 0]
        damped = 1 + machine.damping[0] @ estimate
        compensated = to_rigid[0] @ (c @ to_state - machine.compensation @ estimate)
        sizes.append(abs(1 / (1 + controller / damped * compensated)))
    assert found == pytest.approx(max(sizes), rel=0.03)  # noise is in the measurement


def test_hidden_seeds_follow_from_the_public_number_and_tracks_share_none():
    assert hidden_seed("20180628", "stage", 0) == hidden_seed("20180628", "stage", 0)
    scans = [
        Scan(track, plant, "none", public, k)
        for track in ("estimate", "loop")
        for plant in PLANTS
        for public in "12"
        for k in range(9)
    ]
    assert len({scan.stream for scan in scans}) == len(scans) and max(scan.stream for scan in scans) < 2**64


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


def test_the_tuner_takes_the_least_error_for_a_file_as_for_ours(written, monkeypatch):
    monkeypatch.setattr(tuning, "TUNED_ON", ("all 5 %",))
    monkeypatch.setattr(tuning, "TRIES", 3)
    knobs = ENTRANTS["unknown input"].knobs
    [scan] = tuning.development_scans("drive", 1)
    errors = [
        scores_of("unknown input", None, scan, tuple(each))["flexible"] for each in tuning.positions(knobs)
    ]
    best = tuning.positions(knobs)[np.argmin(errors)]
    assert tuning.tune("unknown input", None, knobs, "drive", 1) == pytest.approx(list(best), rel=1e-5)
    text = KALMAN.replace("sample_time):", "sample_time, factor):").replace(
        "noise.process", "(factor**2 * noise.process)"
    )
    assert tuning.tune("mine", str(written(text)), knobs, "drive", 1) == pytest.approx(list(best), rel=1e-5)
    assert tuning.positions(()).shape == (1, 0)
    with pytest.raises(InputError, match=r"^name\b.*'particle'"):
        tuning.main(["particle"])


def test_the_development_set_holds_what_is_given_and_the_truth(tmp_path, monkeypatch):
    monkeypatch.setattr(tuning, "PLANTS", {"drive": PLANTS["drive"]})
    monkeypatch.setattr(tuning, "UNCERTAINTIES", {"lost 20 %": None})
    tuning.write_development_set(tmp_path)
    files = sorted(tmp_path.iterdir())
    assert len(files) == TUNINGS
    with np.load(files[0]) as scan:
        assert scan["states"].shape == (bench.SAMPLES, len(scan["a"]))
        assert np.isnan(scan["measurements"]).mean() == pytest.approx(0.2, abs=0.05)


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


def test_one_machine_that_decides_is_seen():
    values = np.tile([0.49, 0.5, 0.51], (7, 4, 1))
    values[0, :, 0] = 9.0
    of = synthetic(values)
    assert leave_one_out(of)["machine 0"].tolist() == [1, 2, 3]
    assert robustness(of).loc["a", ["worst cell", "worse than Kalman", "worse than zero"]].tolist() == [
        9.0,
        1 / 7,
        1 / 7,
    ]
    values[1, 0, 2] = np.inf
    assert robustness(synthetic(values)).loc["b", "diverged"] == pytest.approx(1 / 28)


@pytest.fixture(scope="module")
def small():
    """Some entrants on two machines, one seed, with loops."""
    return run_contest("a test", 1, only=["zero", "open model"], plants=("drive", "stage"))[0]


@pytest.mark.slow
def test_the_table_says_what_the_scans_gave(small):
    assert list(small.columns) == [*KEYS, "zero", "open model", "Kalman", ORACLE]
    flexible = small[small["score"] == "flexible"]
    assert len(flexible) == 2 * len(UNCERTAINTIES) and (flexible["zero"] == 1).all()
    one = flexible[(flexible["plant"] == "stage") & (flexible["uncertainty"] == "delay")]["Kalman"].item()
    scan = Scan("estimate", "stage", "delay", "a test", 0)
    assert one == pytest.approx(scores_of("Kalman", None, scan, ())["flexible"], rel=1e-3)
    found = standings(small).set_index("observer")
    assert "[" not in found.loc["Kalman", "mean rank"] and ORACLE in found.index  # one seed has no interval
    loops = {(row.plant, row.uncertainty) for row in small[small["score"] == "tracking"].itertuples()}
    told = {
        (scan.plant, scan.uncertainty)
        for plant in ("drive", "stage")
        for scan in scans_of(plant, "a test", 0)
        if scan.track == "loop"
    }
    assert loops == told


@pytest.mark.slow
def test_who_comes_later_joins_and_workers_change_nothing(small, written):
    given = {"only": ["zero"], "plants": ("drive", "stage"), "loops": 0}
    file = str(written(MODEL_ALONE))
    with ThreadPoolExecutor(2) as pool:
        later, out = run_contest("a test", 1, [file], executor=pool, **given)
    assert not out and set(later["score"]) == {
        "flexible",
        "rigid",
        "microseconds",
        "bytes",
    }  # no loops at all
    whole = joined(small, later)
    assert list(whole.columns)[-1] == "mine" and len(whole) == len(small)
    assert whole["open model"].equals(small.set_index(KEYS)["open model"].sort_index().reset_index(drop=True))
    with pytest.raises(InputError, match="another edition"):
        joined(small.assign(Kalman=small["Kalman"] + 1), later)


@pytest.mark.slow
def test_the_contest_goes_on_without_the_disqualified(written, monkeypatch, capsys):
    bad = str(written(MODEL_ALONE.replace("return self.x", "return self.x * np.nan"), "hopeless.py"))
    monkeypatch.setattr(tables, "PLANTS", {"drive": PLANTS["drive"]})
    table, out = run_contest("a test", 1, [bad], only=["zero"], plants=("drive",), loops=0)
    assert (
        out == {"hopeless": "raises ValueError: an estimate that is not finite"} and "hopeless" not in table
    )


@pytest.mark.slow
def test_a_file_that_needs_its_knobs_runs_at_their_defaults(written):
    knob = 'KNOBS = [("size", 0.5, 8.0, 3.0)]\n' + MODEL_ALONE.replace("sample_time):", "sample_time, size):")
    file = written(
        knob.replace("return self.x", "return 0 * self.x").replace("        self.model,", CHECKED, 1)
    )
    assert "assert size == 3.0" in file.read_text()
    wrong = written('KNOBS = [("a", 1.0)]\n' + MODEL_ALONE, "wrong.py")
    given = {"only": ["zero"], "plants": ("drive",), "loops": 0}
    table, out = run_contest("a test", 1, [str(file), str(wrong)], **given)
    assert list(out) == ["wrong"] and "KNOBS" in out["wrong"]
    flexible = table[table["score"] == "flexible"]
    assert (flexible["mine"] == flexible["zero"]).all() and len(flexible) == 12


def test_the_results_say_what_ran_and_who_was_isolated(written, tmp_path):
    table = pd.read_csv(FILE)
    table = table.assign(mine=table["Kalman"], older=table["Kalman"])
    table["tcp:127.0.0.1:5"] = table["Kalman"]
    file = written(MODEL_ALONE)
    tables.write_table(table, tmp_path / "out.csv", tables.entries([file, "tcp:127.0.0.1:5"]))
    found = json.loads((tmp_path / "out.json").read_text())
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    assert found["entered"] == {
        "mine": {"sha256": digest, "isolated": can_isolate()},
        "older": {"sha256": None, "isolated": False},
        "tcp:127.0.0.1:5": {"sha256": None, "isolated": False},
    }
    assert found["edition"] == tables.EDITION and len(found["code"]) == 12 and "scipy" in found["environment"]
    tables.write_table(table, tmp_path / "out.csv")  # another run without it
    assert json.loads((tmp_path / "out.json").read_text())["entered"] == found["entered"]


def test_the_number_is_read_from_standard_input(monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", __import__("io").StringIO("\n"))
    with pytest.raises(InputError, match=r"^hidden"):
        tables.hold_contest([], seeds=1, hidden=True)


def test_the_committed_table_is_whole_and_the_leaderboard_shows_it():
    table, recorded = pd.read_csv(FILE), pd.read_csv(tables.RECORDED)
    entered = [name for name in ENTRANTS if name in table]
    flexible = block(table, "flexible", entered)
    assert flexible.values.shape[::2] == (len(PLANTS) * len(UNCERTAINTIES), len(entered))
    assert len(table["public"].unique()) == 2 and len(flexible.groups) >= ranking.FEWEST_DRAWS
    loops = block(table, "tracking", [*entered, ORACLE])
    assert len(loops.groups) == 4 and set(loops.groups) == set(range(TUNINGS))
    page = tables.PAGE.read_text(encoding="utf-8")
    for some in (*by_track(standings(table)).values(), record_standings(recorded)):
        assert as_markdown(some) in page
    late = ", ".join(name for name in ENTRANTS if name not in table)
    assert not late or f"entered after them: {late}." in page
    stored = json.loads(FILE.with_suffix(".json").read_text())
    assert stored["standings"] == standings(table).to_dict("records")
    assert stored["machines"] == {name: digest_of(name) for name in PLANTS}


def test_tracks_hold_their_yardsticks():
    tracks = by_track(standings(pd.read_csv(FILE)))
    assert {"zero", "Kalman"} <= set(tracks["Estimate"]["observer"]) and ORACLE not in set(
        tracks["Estimate"]["observer"]
    )
    assert {"zero", "Kalman", ORACLE} <= set(tracks["Loop"]["observer"])


@pytest.mark.slow
def test_the_committed_table_is_of_this_code():
    table = pd.read_csv(FILE).set_index(KEYS)
    public = str(table.index.get_level_values("public")[0])
    for track, score, plant in (("estimate", "flexible", "drive"), ("loop", "tracking", "stage")):
        scan = next(each for each in scans_of(plant, public, 0) if each.track == track)
        row = table.loc[(score, int(public), plant, scan.uncertainty, 0)]
        for name, knobs in settings_for(plant, 0, ["Kalman", "fictitious noise", "extended Kalman"]).items():
            assert scores_of(name, None, scan, knobs)[score] == pytest.approx(row[name], rel=2e-3), name


def test_the_committed_map_holds_every_cell_and_seed():
    rows = pd.read_csv(MAP)
    assert list(rows.columns) == ["public", "size", "noise", "seed", *MAPPED]
    assert set(rows["public"].astype(str)) == set(PUBLICS)
    cells = {(size, noise, seed) for size in SIZES for noise in NOISES for seed in range(SEEDS)}
    for public in PUBLICS:
        errors = stored_map(public)
        assert set(errors[["size", "noise", "seed"]].itertuples(index=False, name=None)) == cells
        assert len(errors) == len(cells)
        assert np.isfinite(errors.to_numpy()).all() and (errors[list(MAPPED)] > 0).all(axis=None)
    assert sorted(len(each) for each in map_variants().values()) == [600] * 4 + [1200] * 2


@pytest.mark.slow
def test_the_committed_map_is_of_this_code():
    """Of the second public number, whose settings are those of the first; the Kalman filter has none."""
    errors = stored_map(PUBLICS[1])
    kept = errors[(errors["size"] == 0.02) & (errors["noise"] == 30)]["Kalman"].to_numpy()[:5]
    found = flexible_errors(
        plant_of("stage"), 0.02, 30.0, PUBLICS[1], range(5), {"Kalman": OwnObserver(ENTRANTS["Kalman"])}
    )
    assert found["Kalman"] == pytest.approx(kept, rel=2e-3)


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


def test_a_seed_is_the_same_machine_in_every_cell_of_the_map_whoever_else_runs():
    plant = plant_of("stage")
    observers = {name: OwnObserver(ENTRANTS[name]) for name in ("Kalman", "open model", "zero")}
    all_three = flexible_errors(plant, 0.02, 1.0, "a test", range(2), observers)
    alone = flexible_errors(plant, 0.02, 1.0, "a test", [1], {"Kalman": OwnObserver(ENTRANTS["Kalman"])})
    assert all_three["Kalman"][1] == alone["Kalman"][0]
    assert all_three["zero"] == pytest.approx(1.0, abs=1e-12)
    # The model alone sees no noise: it has the same error in louder noise.
    louder = flexible_errors(
        plant, 0.02, 3.0, "a test", range(2), {"open model": OwnObserver(ENTRANTS["open model"])}
    )
    assert louder["open model"] == pytest.approx(all_three["open model"], rel=0.05)
