"""`tests/committed` passes on an accepted workbook and on what a contributor adds first, and notices what differs."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from nbval.plugin import get_sanitize_patterns

from engine import toy as toys
from layering import modules

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
    toy.write("data/isolation/paper.toml", "order = 1\n")
    (toy.root / "environment.txt").write_text("")
    toy.write("README.md", README)
    toy.write(".gitignore", "build/\n__pycache__/\n")
    toy.commit()
    build_and_accept(toy)
    done = nbval(toy)
    assert done.returncode == 0, done.stdout
    yield toy
    toys.clean_up(toy)


@pytest.fixture
def toy(accepted, tmp_path):
    """A copy of the accepted workbook that a test may change."""
    with toys.copy_of(accepted, tmp_path) as copy:
        yield copy


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
    toy.replace(f"notebooks/{NAME}.ipynb", "inside", "outside")
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


def test_an_accepted_workbook_passes_on_another_machine(toy, monkeypatch):
    scale_a_number(toy, 1 + 1e-5)
    outcomes = committed(toy, monkeypatch)
    assert outcomes.failed == set()
    # It has no topic with studies of open choices.
    assert outcomes.skipped <= {
        "test_settings_are_those_of_these_combinations",
        "test_the_window_whose_turn_it_is_today_comes_out_again",
    }


def test_what_a_fresh_run_gives_otherwise_is_noticed(toy, monkeypatch):
    scale_a_number(toy, 1.0, 0.01)
    toy.replace(f"figures/{NAME}/claims.json", '"ours": 2.0', '"ours": 2.01')
    toy.add_page(NAME)  # as its author wrote it, without outputs
    toy.replace(f"figures/{NAME}/provenance.json", '"environment_sha256": "', '"environment_sha256": "0')
    assert committed(toy, monkeypatch).failed == {
        "test_a_fresh_run_plots_the_committed_numbers",
        "test_a_fresh_run_finds_the_accepted_value_and_verdict",
        "test_was_accepted_with_clean_text_outputs",
        "test_a_fresh_run_prints_what_is_committed",
        "test_its_file_is_the_one_that_accept_writes",
        "test_figures_come_from_a_commit_and_the_pinned_environment",
    }


def test_what_is_missing_or_not_current_is_noticed(toy, monkeypatch):
    (toy.root / f"figures/{NAME}/fig-1.csv").unlink()
    toy.write(f"figures/{NAME}/fig-2.csv", "panel,series,x,y,z\n")
    toy.replace("data/isolation/published.toml", "published = 2.0", "published = 2.5")
    toy.replace("README.md", "| `isolation` | 1 |", "| `isolation` | 2 |")
    toy.replace(f"notebooks/{NAME}.ipynb", "/01-first')", "/01-frst')")
    assert committed(toy, monkeypatch).failed == {
        "test_every_figure_was_rebuilt_and_every_rebuilt_one_is_committed",
        "test_every_table_has_its_picture",
        "test_a_fresh_run_plots_the_committed_numbers",
        "test_every_entry_is_accepted_and_explained",
        "test_a_derived_file_is_current",
        "test_its_page_is_named_after_its_file",
    }


# As Jupyter saves them: ids of chance, lines as a list; it leaves an empty cell behind the last that was run.
ADDED = [
    {"id": "3f2a9c1b", "source": ["def double(value):\n", "    return 2*value\n", "double( 2 )"]},
    {
        "id": "0c41d7aa",
        "source": [
            "import os, sys\n",
            "import  math\n",
            "f = lambda x: x; x = [1]; x\n",
            "%time 1+1\n",
            "!true",
        ],
    },
    {"id": "70b1e4d2-9a51-4c0e", "source": []},
]


def build_and_accept(toy):
    for command in ("figures", "accept"):
        done = toy.run(command)
        assert done.returncode == 0, done.stdout + done.stderr
    toy.commit()


def require_style(toy, *places):
    """The style of this checkout; the toy has a library of its own, which ruff takes for the first party's."""
    settings = ["--config", f"{Path(__file__).parents[2]}/pyproject.toml"]
    settings += ["--config", 'lint.isort.known-first-party=["notebooks", "workbook"]']
    for style in (["format", "--check"], ["check"]):
        done = subprocess.run([sys.executable, "-m", "ruff", *style, *settings, *places], cwd=toy.root)
        assert done.returncode == 0


def test_a_cell_added_in_jupyter_is_accepted_as_it_is(toy, monkeypatch):
    file = toy.root / f"notebooks/{NAME}.ipynb"
    notebook = json.loads(file.read_text(encoding="utf-8"))
    for cell in ADDED:
        made = {"cell_type": "code", "metadata": {}, "outputs": [], "execution_count": None}
        notebook["cells"].append(made | cell)
    file.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    toy.commit()
    build_and_accept(toy)
    cells = json.loads(file.read_text(encoding="utf-8"))["cells"]
    assert [cell["id"] for cell in cells[-3:]] == [cell["id"] for cell in ADDED]
    assert cells[-3]["outputs"][0]["data"] == {"text/plain": ["4"]}
    assert committed(toy, monkeypatch).failed == set()
    require_style(toy, "notebooks")
    assert f"notebooks.{NAME.replace('/', '.')}" in modules(toy.root)  # the rules of imports read it


def test_a_new_result_and_a_new_topic_pass_as_they_are_written(toy, monkeypatch):
    first = toy.run("new", "isolation", "09-payload")
    assert first.returncode == 0, first.stderr
    other = toy.run("new", "crane", "01-sway", "--create")
    assert other.returncode == 0, other.stderr
    toy.commit()
    assert toy.reasons().keys() == {"isolation/09-payload", "crane/01-sway"}
    build_and_accept(toy)
    assert committed(toy, monkeypatch).failed == set()
    readme = (toy.root / "README.md").read_text(encoding="utf-8")
    assert readme.index("| `isolation` | 2 |") < readme.index("| `crane` | 1 |")
    index = (toy.root / "notebooks/index.ipynb").read_text(encoding="utf-8")
    assert "## Crane (`crane`)" in index and "(crane/01-sway.ipynb)" in index
    require_style(toy, "notebooks", "tests")
    options = [*"-p no:cacheprovider -o addopts= -o".split(), "pythonpath=lib ."]
    command = [sys.executable, "-m", "pytest", *options, "tests"]
    done = subprocess.run(command, cwd=toy.root, env=toy.environment(), capture_output=True, text=True)
    assert "4 passed" in done.stdout, done.stdout
