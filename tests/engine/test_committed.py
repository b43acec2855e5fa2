"""`tests/committed` passes on an accepted workbook and notices what differs."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from nbval.plugin import get_sanitize_patterns

from engine import toy as toys

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
NAME = "isolation/01-first"
README = "# Toy\n\n<!-- ledger:begin -->\n<!-- ledger:end -->\n"


def nbval(toy) -> subprocess.CompletedProcess:
    """Execute the notebooks again, and compare what they print with what is committed."""
    environment = toy.environment() | {
        "STILLWORK_ROOT": str(toy.root),
        "STILLWORK_OUTPUT": str(toy.root / "build" / "nbval"),
        "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
    }
    command = [
        sys.executable,
        *"-m pytest -p nbval.plugin -p no:cacheprovider --color=no -o addopts=".split(),
    ]
    command += [str(toy.root / "notebooks"), "--nbval", "--nbval-current-env"]
    command += ["--nbval-sanitize-with", str(ROOT / "tests/nbval.cfg")]
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)


class Outcomes:
    """A plugin that notes what did not pass: names of tests without their parameters, and skips."""

    def __init__(self):
        self.failed: set[str] = set()
        self.skipped: set[str] = set()

    def pytest_runtest_logreport(self, report):
        name = report.location[2].partition("[")[0].rpartition(".")[2]
        if report.failed:
            self.failed.add(name)
        if report.skipped:
            self.skipped.add(name)


def committed(toy, monkeypatch) -> Outcomes:
    """Run `tests/committed` on the toy within this process: a new one would import for seconds, a dozen times."""
    monkeypatch.setenv("STILLWORK_ROOT", str(toy.root))
    monkeypatch.chdir(ROOT)
    outcomes = Outcomes()
    quiet = [
        f"-pno:{name}"
        for name in ("cacheprovider", "faulthandler", "jaxtyping", "nbval", "terminal", "xdist")
    ]
    try:
        code = pytest.main(
            [*quiet, "-o", "addopts=--import-mode=importlib", "--capture=no", "tests/committed"],
            plugins=[outcomes],
        )
    finally:
        for name in [each for each in sys.modules if each.split(".")[0] == "committed"]:
            del sys.modules[name]  # these modules hold what they read when they were imported
    assert code == (pytest.ExitCode.TESTS_FAILED if outcomes.failed else pytest.ExitCode.OK)
    return outcomes


@pytest.fixture(scope="module")
def accepted(tmp_path_factory):
    """A workbook of one notebook: built at a commit, accepted, run again by nbval."""
    toy = toys.make(tmp_path_factory.mktemp("accepted"))
    toy.add_page(NAME)
    cells = toy.root / f"notebooks/{NAME}.ipynb"
    end = ', {"cell_type": "markdown", "id": "end", "metadata": {}, "source": "All agrees."}]}'
    cells.write_text(cells.read_text().removesuffix("]}") + end)
    (toy.root / "data/motion/published.toml").unlink()
    (toy.root / "environment.txt").write_text("")
    toy.write("README.md", README)
    toy.write(".gitignore", "build/\n__pycache__/\n")
    toy.commit()
    assert toy.run("figures").returncode == 0
    assert toy.run("accept").returncode == 0
    done = nbval(toy)
    assert done.returncode == 0, done.stdout
    yield toy
    toys.clean_up(toy)


@pytest.fixture
def toy(accepted):
    """The accepted workbook; what a test does to it is undone."""
    before = accepted.files("figures", "data", "notebooks", "build/figures") | {
        "README.md": (accepted.root / "README.md").read_bytes()
    }
    yield accepted
    for name in accepted.files("figures", "data", "notebooks", "build/figures"):
        if name not in before:
            (accepted.root / name).unlink()
    for name, content in before.items():
        (accepted.root / name).write_bytes(content)


def test_an_accepted_workbook_passes(toy, monkeypatch):
    outcomes = committed(toy, monkeypatch)
    assert outcomes.failed == set()
    # It has no topic with studies of open choices.
    assert outcomes.skipped <= {
        "test_settings_are_those_of_these_combinations",
        "test_the_window_whose_turn_it_is_today_comes_out_again",
    }


@pytest.mark.parametrize(
    ("text", "same"),
    [("a  -1.5e-3", True), ("a 2.0", True), ("a     2.25", True), ("b 2.0", False), ("a 3", False)],
)
def test_only_digits_of_numbers_that_are_not_whole_are_left_out(text, same):
    patterns = get_sanitize_patterns((ROOT / "tests/nbval.cfg").read_text(encoding="utf-8"))
    left = []
    for each in (text, "a 1.9"):
        for pattern, instead in patterns:
            each = re.sub(pattern, instead, each)
        left.append(each)
    assert (left[0] == left[1]) is same


def test_nbval_notices_another_output(toy):
    toy.replace(f"notebooks/{NAME}.ipynb", "'inside'", "'outside'")
    done = nbval(toy)
    assert done.returncode == 1
    assert "1 failed" in done.stdout


def scale_a_number(toy, factor, more=0.0):
    """One of the fresh run's figure; a little is what another machine may do."""
    file = toy.root / f"build/figures/{NAME}/fig-1.csv"
    lines = file.read_text().splitlines()
    *start, y, z = lines[2].split(",")
    lines[2] = ",".join([*start, str(float(y) * factor + more), z])
    file.write_text("\n".join(lines) + "\n")


def drop_a_figure(toy):
    (toy.root / f"figures/{NAME}/fig-1.csv").unlink()
    toy.write(f"figures/{NAME}/fig-2.csv", "panel,series,x,y,z\n")


def add_an_entry(toy):
    ledger = toy.root / "data/isolation/published.toml"
    ledger.write_text(ledger.read_text() + toys.LEDGER.format(topic="isolation").replace(".gain", ".other"))


def forget_the_outputs(toy):
    toy.add_page(NAME)


def replaced(*text: str):
    return lambda toy: toy.replace(*text)


def moved(factor: float, more: float = 0.0):
    return lambda toy: scale_a_number(toy, factor, more)


LEDGER, FRESH = (
    "test_every_entry_is_accepted_and_explained",
    "test_a_fresh_run_finds_the_accepted_value_and_verdict",
)
DERIVED, PLOTTED = "test_a_derived_file_is_current", "test_a_fresh_run_plots_the_committed_numbers"
REBUILT = "test_every_figure_was_rebuilt_and_every_rebuilt_one_is_committed"
CLEAN, PRINTED = "test_was_accepted_with_clean_text_outputs", "test_a_fresh_run_prints_what_is_committed"
BOOK, FOUND, MADE = (
    f"notebooks/{NAME}.ipynb",
    f"figures/{NAME}/claims.json",
    f"figures/{NAME}/provenance.json",
)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (moved(1 + 1e-5), set()),
        (moved(1.0, 0.01), {PLOTTED}),
        (drop_a_figure, {REBUILT, "test_every_table_has_its_picture", PLOTTED}),
        (replaced(FOUND, '"ours": 2.0', '"ours": 2.01'), {FRESH}),
        (add_an_entry, {LEDGER, DERIVED}),
        (replaced("data/isolation/published.toml", "published = 2.0", "published = 2.5"), {LEDGER, DERIVED}),
        (replaced("README.md", "| `isolation` | 1 |", "| `isolation` | 2 |"), {DERIVED}),
        (forget_the_outputs, {CLEAN, PRINTED, "test_its_file_is_the_one_that_accept_writes"}),
        (replaced(BOOK, "/01-first')", "/01-frst')"), {"test_its_page_is_named_after_its_file"}),
        (
            replaced(MADE, '"environment_sha256": "', '"environment_sha256": "0'),
            {"test_figures_come_from_a_commit_and_the_pinned_environment"},
        ),
    ],
)
def test_what_differs_is_noticed(toy, monkeypatch, change, expected):
    change(toy)
    assert committed(toy, monkeypatch).failed == expected
