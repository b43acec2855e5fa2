"""The same numbers on any workers, after any interruption, whatever fails."""

import json
import signal
import subprocess
import sys
import time
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial

import numpy as np
import psutil
import pytest

from choices import toy_work
from choices.toy_work import SEEDS, A, B, study
from stillwork.__main__ import main
from workbook.checks import InputError
from workbook.choices.command import robustness_of
from workbook.choices.results import results_text
from workbook.choices.running import DIED, Journal, calls_of, run_combinations
from workbook.lock import held
from workbook.workers import processes

NOISY = A + B + SEEDS + study("noisy")


def run(multiverses, folder, executor=None, **options):
    executor = executor or partial(ThreadPoolExecutor, 1)
    return run_combinations(multiverses, executor, Journal(folder / "journal.jsonl"), **options)


def test_one_thread_or_three_give_the_same(workbook, tmp_path):
    _, multiverses = workbook(NOISY)
    one = run(multiverses, tmp_path / "1")
    three = run(multiverses, tmp_path / "3", partial(ThreadPoolExecutor, 3), at_once=6)
    assert results_text(one) == results_text(three)
    expected = [[a + 2 * b + a * b + noise for noise in (0, -1, 1)] for a, b in one[0].design]
    np.testing.assert_array_equal(one[0].values["motion.table-1.sum"], expected)


@pytest.mark.slow
def test_a_cluster_gives_the_same(workbook, tmp_path):
    from distributed import Client, LocalCluster

    _, multiverses = workbook(NOISY)
    with (
        LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        there = run(multiverses, tmp_path / "there", partial(client.get_executor, pure=False), at_once=4)
    assert results_text(there) == results_text(run(multiverses, tmp_path / "here"))


def test_what_the_journal_holds_is_not_computed_again(workbook, tmp_path):
    _, multiverses = workbook(NOISY)
    before = run(multiverses, tmp_path)
    lines = (tmp_path / "journal.jsonl").read_text()
    assert lines.count("\n") == 18
    (tmp_path / "journal.jsonl").write_text(lines[: len(lines) // 2])  # torn within a line
    kept = lines[: len(lines) // 2].count("\n")
    after = run(multiverses, tmp_path)
    assert results_text(after) == results_text(before)
    again = (tmp_path / "journal.jsonl").read_text()
    assert again.startswith(lines[: len(lines) // 2] + "\n")
    assert again.count("\n") - 1 - kept == 18 - kept


def test_new_options_keep_the_old_combinations_and_other_entries_do_not(workbook, tmp_path):
    _, multiverses = workbook(A.replace("[0, 1, 2]", "[0, 1]") + B + study())
    run(multiverses, tmp_path)
    counts = []
    for text in (A + B + study(), A + B + study(entries='["motion.order"]')):
        _, multiverses = workbook(text)
        missing = {r.key for m in multiverses for r in calls_of(m).values()}
        counts.append(len(missing - set(Journal(tmp_path / "journal.jsonl").found)))
    assert counts == [2, 6]


def test_a_combination_that_raises_is_told_and_the_others_go_on(workbook, tmp_path):
    _, multiverses = workbook(A + B + study("raising"))
    (found,) = run(multiverses, tmp_path)
    places = {at: found.design[at[0]] for at in found.failures}
    assert {places[at]: reason for at, reason in found.failures.items()} == {
        (2, 0): "ValueError: no such thing at b = 0",
        (2, 1): "ValueError: no such thing at b = 1",
    }
    assert np.isfinite(found.values["motion.order"]).sum() == 4


@pytest.mark.slow
def test_a_combination_that_kills_its_process_is_told_and_the_others_go_on(workbook, tmp_path):
    _, multiverses = workbook(A + B + study("dying"))
    (found,) = run(multiverses, tmp_path, partial(processes, 2), at_once=4)
    assert {found.design[point]: reason for (point, _), reason in found.failures.items()} == {(1, 1): DIED}
    assert np.isfinite(found.values["motion.order"]).sum() == 5


@pytest.mark.parametrize("broken_at", [0, 3])
def test_a_combination_that_a_broken_pool_refuses_is_not_lost(workbook, tmp_path, broken_at):
    handed_out = []

    class Breaking(ThreadPoolExecutor):
        def submit(self, *args):
            handed_out.append(args)
            if len(handed_out) == broken_at + 1:
                raise BrokenExecutor
            return super().submit(*args)

    _, multiverses = workbook(A + B + study())
    (found,) = run(multiverses, tmp_path, partial(Breaking, 2), at_once=4)
    assert not found.failures
    assert np.isfinite(found.values["motion.order"]).all()


@pytest.mark.parametrize(
    ("function", "message"),
    [
        ("incomplete", r"\bincomplete: motion\.table-1\.sum\b"),
        ("talkative", r"\btalkative: motion\.other\b"),
        ("deaf", r"\bdeaf\b.*'b'"),
        ("absent", r"choices\.toy_work\b.*'absent'"),
    ],
)
def test_a_study_that_does_not_keep_to_its_form_stops_the_run(workbook, tmp_path, function, message):
    _, multiverses = workbook(A + B + study(function))
    with pytest.raises(InputError, match=message):
        run(multiverses, tmp_path)


def test_after_the_budget_nothing_begins(workbook, tmp_path):
    _, multiverses = workbook(A + B + study())
    assert run(multiverses, tmp_path, budget_s=0.0) == []
    assert not (tmp_path / "journal.jsonl").exists()


@pytest.mark.slow
def test_an_interrupt_does_not_wait_for_a_long_combination(workbook, tmp_path):
    _, multiverses = workbook(A + B + study("endless"))
    begin = time.monotonic()
    assert run(multiverses, tmp_path, partial(processes, 1), stopped=(tmp_path / "begun").exists) == []
    assert time.monotonic() - begin < 500  # of 1000 s


def test_another_checkout_on_a_worker_is_refused(workbook, tmp_path, monkeypatch):
    from workbook.choices import running

    _, multiverses = workbook()
    own = running.study_digest
    answers = iter(["0" * 64])
    monkeypatch.setattr(running, "study_digest", lambda *given: next(answers, own(*given)))
    with pytest.raises(InputError, match=r"choices\.toy_work:sums\b"):
        run(multiverses, tmp_path)


@contextmanager
def command(root, *arguments):
    """``python -m workbook choices`` on the toy, ended at the end with all it started."""
    process = subprocess.Popen(
        [sys.executable, "-m", "workbook", "choices", "motion", *arguments],
        env=toy_work.environment(root),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def wait_until(condition, seconds=300):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.02)


@pytest.mark.slow
def test_a_killed_run_goes_on_where_it_stopped(workbook, tmp_path):
    _, multiverses = workbook(A + B + SEEDS + study("slow"))
    whole = run(multiverses, tmp_path, partial(ThreadPoolExecutor, 18), at_once=18)
    torn = tmp_path / "torn"
    toy_work.write(torn, A + B + SEEDS + study("slow"))
    journal = torn / "build/choices/motion.jsonl"
    with command(torn, "--jobs", "2") as process:
        wait_until(lambda: journal.exists() and journal.read_text().count("\n") >= 4)
        children = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(signal.SIGKILL)
        wait_until(lambda: not any(each.is_running() and each.status() != "zombie" for each in children))
    done = journal.read_text().count("\n")
    assert done < 18
    assert not (torn / "data/motion/choices.csv").exists()
    with command(torn, "--jobs", "1") as process:
        text = process.communicate(timeout=600)[0]
    assert process.returncode == 0, text
    assert f"of {18 - done}" in text
    assert journal.read_text().count("\n") in (18, 19)  # 19: a line was torn
    assert (torn / "data/motion/choices.csv").read_text(encoding="utf-8") == results_text(whole)
    assert "the site shows every entry over its combinations" in text


@pytest.mark.slow
def test_the_command_runs_while_a_build_does_and_the_ledger_tells_of_combinations(
    workbook, tmp_path, monkeypatch, capsys
):
    """While a build runs."""
    workbook(NOISY)
    with held("lock", ""), command(tmp_path) as process:
        text = process.communicate(timeout=600)[0]
    assert process.returncode == 0, text
    assert main(["claims", "motion", "--json"]) == 0
    claims = {each["id"]: each for each in json.loads(capsys.readouterr().out)}
    order = [a <= b for a in range(3) for b in range(2)] * 3
    combinations = claims["motion.order"]["choices"]
    assert (combinations["tried"], combinations["agree"]) == (18, sum(order))
    assert combinations["decided_by"][0]["axis"] == "a"
    monkeypatch.setenv("COLUMNS", "60")
    assert main(["claims", "--entry", "motion.order"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "verdict: not built" in lines
    assert max(map(len, lines)) <= 60


def test_axes_that_changed_since_are_told_and_not_judged(workbook, outcomes, tmp_path, capsys):
    text = results_text([outcomes()])
    (tmp_path / "data/motion/choices.csv").write_text(text, encoding="utf-8")
    assert len(robustness_of("motion")) == 6
    workbook(A.replace("[0, 1, 2]", "[0, 1]") + B + study() + study("one", "[]").replace("toy", "other"))
    assert robustness_of("motion") == {}
    assert "the axes of toy, other changed: run `make choices`" in capsys.readouterr().err
