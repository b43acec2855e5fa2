from concurrent.futures import ThreadPoolExecutor

import pytest

from choices import toy_work
from workbook.choices.axes import load_axes
from workbook.choices.running import Journal, run_combinations


@pytest.fixture
def workbook(tmp_path, monkeypatch):
    """Writes the toy with these combinations and this ledger, and loads its axes and multiverses."""
    monkeypatch.setenv("STILLWORK_ROOT", str(tmp_path))

    def make(combinations=toy_work.TOY, ledger=toy_work.LEDGER):
        toy_work.write(tmp_path, combinations, ledger)
        return load_axes("motion")

    return make


@pytest.fixture
def outcomes(workbook, tmp_path):
    """Runs the toy in one thread; returns its only study's outcomes."""

    def run(*arguments, **options):
        _, multiverses = workbook(*arguments, **options)
        journal = Journal(tmp_path / "journal.jsonl")
        (found,) = run_combinations(multiverses, lambda: ThreadPoolExecutor(1), journal)
        return found

    return run
