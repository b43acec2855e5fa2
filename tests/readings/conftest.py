from concurrent.futures import ThreadPoolExecutor

import pytest

from readings import toy_work
from workbook.readings.axes import load_axes
from workbook.readings.journal import Journal
from workbook.readings.running import run_readings


@pytest.fixture
def workbook(tmp_path, monkeypatch):
    """Writes the toy with these readings and this ledger, and loads its axes and multiverses."""
    monkeypatch.setenv("STILLWORK_ROOT", str(tmp_path))

    def make(readings=toy_work.TOY, ledger=toy_work.LEDGER):
        toy_work.write(tmp_path, readings, ledger)
        return load_axes("motion")

    return make


@pytest.fixture
def outcomes(workbook, tmp_path):
    """Runs the toy in one thread; returns its only study's outcomes."""

    def run(*arguments, **options):
        _, multiverses = workbook(*arguments, **options)
        journal = Journal(tmp_path / "journal.jsonl")
        (found,) = run_readings(multiverses, lambda: ThreadPoolExecutor(1), journal)
        return found

    return run
