"""The page of benchmarks: its ratios are those of the committed tables, and it names no place on a machine."""

import csv
import re
import shutil
import subprocess
import sys

import pytest

from workbook import paths
from workbook.timings import benchmarks


def test_ratios_are_those_of_the_committed_times():
    updates, response, *_, kalman, unknowns, filters = benchmarks()
    with paths.data("isolation", "update_times/update_times.csv").open(encoding="utf-8") as file:
        median = {row["form"]: float(row["median_us"]) for row in csv.DictReader(file)}
    found = dict(updates.rows)
    assert found["FeRLS of this library"] == ((median["recursion"], 1.0),)
    assert found["padasip FilterRLS, one an actuator"] == (
        (median["padasip"], median["padasip"] / median["recursion"]),
    )
    with paths.data("worstcase", "update_times/update_times.csv").open(encoding="utf-8") as file:
        exact = {
            row["unknowns"]: float(row["exact (us)"]) / float(row["RLS (us)"]) for row in csv.DictReader(file)
        }
    ratios = [ratio for _, ratio in dict(unknowns.rows)["min-max, exact update"]]
    assert unknowns.headings == ("5", "20", "100")
    assert ratios == [exact[size] for size in unknowns.headings]
    assert {ratio for _, ((_, ratio),) in filters.rows} >= {1.0}
    with paths.data("motion", "times/times.csv").open(encoding="utf-8") as file:
        times = {row["what"]: float(row["median_ms"]) for row in csv.DictReader(file)}
    mine, peer = times["modal residues"], times["control.frequency_response"]
    assert dict(response.rows)["python-control"] == ((peer, peer / mine),)
    assert dict(kalman.rows)["filterpy"][0][0] == times["Kalman step, filterpy"]


def test_a_table_says_on_what_it_was_measured_and_how_to_measure_it():
    for table in benchmarks():
        assert "Python" in table.machine and "/" not in table.machine
        assert (paths.root() / table.command.split()[1]).is_file()


def test_what_cannot_be_measured_is_refused_in_a_sentence():
    command = [sys.executable, paths.root() / "benchmarks" / "build.py", "motion/99-none"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2
    assert (
        "error: there is no notebook or topic 'motion/99-none'" in done.stderr
        and "Traceback" not in done.stderr
    )


def measured(toy, *arguments):
    """What the build's benchmark prints in a workbook of its own."""
    command = [sys.executable, toy.root / "benchmarks" / "build.py", *arguments]
    return subprocess.run(command, cwd=toy.root, env=toy.environment(), capture_output=True, text=True)


@pytest.mark.slow
def test_a_build_is_measured_beside_that_of_a_commit(toy):
    """Of the notebook that is named alone; the commit keeps the processor busy until it has worked five seconds."""
    (toy.root / "benchmarks").mkdir()
    shutil.copy(paths.root() / "benchmarks" / "build.py", toy.root / "benchmarks")
    toy.write(".gitignore", "build/\n__pycache__/\n")
    toy.add("isolation/01-first", "import time\nwhile time.process_time() < 5:\n    pass")
    toy.add("motion/01-first", "1 / 0")
    toy.commit()
    toy.add("isolation/01-first")
    done = measured(toy, "isolation", "--beside", "HEAD")
    rows = re.findall(r"^(as it stands|HEAD) +([\d.]+) +([\d.]+)$", done.stdout, re.MULTILINE)
    (now, spent, clock), (then, *before) = rows
    assert (now, then) == ("as it stands", "HEAD"), done.stderr
    assert float(before[0]) > float(spent) + 1
    assert float(before[1]) > 5 and float(clock) > 0
    assert not (toy.root / "build" / "figures").exists()
    refused = measured(toy, "--beside", "no-such-commit")
    assert refused.returncode == 1
    assert "'no-such-commit'" in refused.stderr and "Traceback" not in refused.stderr
