"""What a build makes, what it leaves alone, and what it says."""

import json
import shutil
from contextlib import nullcontext

import pytest

from engine import toy as toys
from workbook.__main__ import main

pytestmark = pytest.mark.slow

FIRST, SECOND, OTHER = "isolation/01-first", "isolation/02-second", "motion/01-first"
ALL = {FIRST, SECOND, OTHER}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Three notebooks in two topics, built once; tests work on copies."""
    toy = toys.make(tmp_path_factory.mktemp("built"))
    toy.add_page(FIRST)
    toy.add(
        SECOND, parameters="seed: int = 1  # of the noise\nlevel: float = 1.0  # V\nrecord: str = ''  # file"
    )
    toy.add_page(OTHER)
    assert toy.run("figures", "--jobs", "3").returncode == 0
    yield toy
    toys.clean_up(toy)


@pytest.fixture
def toy(built, tmp_path):
    """A built workbook that a test may change."""
    with toys.copy_of(built, tmp_path) as copy:
        yield copy


def test_a_second_build_touches_nothing_and_loads_little(toy):
    before = toy.stamps()
    script = (
        "import sys\nfrom workbook.__main__ import main\nassert main(['figures']) == 0\n"
        "print([name for name in ('papermill', 'nbformat', 'matplotlib', 'pandas', 'numba') if name in sys.modules])"
    )
    done = toy.run(script=script)
    assert done.stdout == "nothing to do: 3 up to date in build/figures/\n[]\n", done.stderr
    assert toy.stamps() == before


def replaced(file, old, new):
    return lambda toy: toy.replace(file, old, new)


NOTEBOOK, MODEL = f"notebooks/{FIRST}.ipynb", "lib/experiments/isolation/model.py"
OUTPUT = f"build/figures/{FIRST}/fig-1.csv"
LIBRARY, DATA = replaced(MODEL, "2.0", "2.5"), replaced("data/motion/rig.toml", "1.0", "2.0")


@pytest.mark.parametrize(
    ("change", "stale", "reason"),
    [
        (replaced(NOTEBOOK, "seed: int = 1", "seed: int = 2"), {FIRST}, "parameter seed: 1 -> 2"),
        (replaced(NOTEBOOK, "gain(level))", "gain(2 * level))"), {FIRST}, "cell claim changed"),
        (LIBRARY, {FIRST, SECOND}, f"{MODEL} changed"),
        (
            replaced("lib/workbook/checks.py", "import difflib", "import cmath, difflib"),
            ALL,
            "lib/workbook/checks.py changed",
        ),
        (DATA, {OTHER}, "data/motion/rig.toml changed"),
        (replaced("data/motion/published.toml", "= 2.0", "= 2.1"), {OTHER}, "ledger motion.gain changed"),
        (
            replaced("environment.txt", "numpy==2.4.5", "numpy==2.4.6"),
            ALL,
            "environment: numpy 2.4.5 -> 2.4.6",
        ),
        (replaced("environment.txt", "ruff==1.0", "ruff==1.1"), set(), "of what no kernel loads"),
        (lambda toy: (toy.root / OUTPUT).unlink(), {FIRST}, "output fig-1.csv missing"),
        (lambda toy: toy.write(OUTPUT, "1,2\n"), {FIRST}, "output fig-1.csv was changed by hand"),
        (lambda toy: shutil.rmtree(toy.root / "build"), ALL, "never built"),
    ],
)
def test_a_change_makes_exactly_its_dependents_stale(toy, change, stale, reason):
    change(toy)
    assert toy.reasons() == dict.fromkeys(stale, reason)


def test_what_cannot_change_a_result_makes_nothing_stale(toy):
    toy.write("data/motion/records/floor.csv", "1,2\n")  # which no notebook reads
    toy.write("lib/experiments/motion/paint.py", "LABEL = 'time (s)'\n")  # nor imports
    toy.replace("data/motion/published.toml", "# as printed", "# as printed in Table 1")
    toy.replace(f"notebooks/{FIRST}.ipynb", "# of the noise", "# root of the streams")
    toy.replace(f"notebooks/{FIRST}.ipynb", "# A toy", "# Another story")
    toy.replace("lib/workbook/report.py", '"""The ledger', '"""A ledger')
    toy.replace("lib/stillwork/__main__.py", '"""Command line', '"""A command line')
    # Of what all import, the wording and the layout, and annotations that nobody reads.
    toy.replace("lib/stillwork/base/checks.py", '"""Input', '"""Otherwise: input')
    toy.replace("lib/stillwork/base/checks.py", "import difflib", "import difflib  # again\n")
    toy.replace(
        "lib/experiments/isolation/model.py",
        "def gain(level):\n    return 2.0 * level",
        'def gain(level: float) -> float:\n    """In V."""\n\n    return (2.0 * level)',
    )
    assert toy.reasons() == {}


def test_what_a_notebook_leads_to_is_what_makes_it_stale(toy):
    toy.write("mylab/stage.py", "from mylab.parts import mass\n")
    toy.write("mylab/parts.py", "mass = 1.0\n")
    toy.write("lib/experiments/motion/paint.py", "LABEL = 'time (s)'\n")
    toy.add(
        "motion/02-leads",
        "from mylab import stage\nfrom experiments.motion import paint",
        "records = sorted(paths.data('motion', 'records').iterdir())\nrecords[0].read_text()",
    )
    toy.write("data/motion/records/floor.csv", "1,2\n")
    assert toy.run("figures").returncode == 0
    assert toy.reasons() == {}
    for name in (
        "mylab/stage.py",
        "mylab/parts.py",
        "lib/experiments/motion/paint.py",
        "data/motion/records/floor.csv",
    ):
        before = (toy.root / name).read_text()
        toy.write(name, before + "more = 1\n")
        assert toy.reasons() == {"motion/02-leads": f"{name} changed"}
        toy.write(name, before)
    toy.write("data/motion/records/second.csv", "1,2\n")
    assert toy.reasons() == {"motion/02-leads": "data/motion/records/second.csv added"}


def test_what_is_edited_while_it_is_built_is_noticed(toy):
    edit = (
        "from pathlib import Path\nfrom workbook.page import Page\nfrom experiments.motion.late import number\n"
        "verdict = Page('motion/02-late').check('motion.gain', 2.0)\n"
        "for name in ('lib/experiments/motion/late.py', 'data/motion/published.toml'):\n"
        "    file = Path(paths.root(), name)\n"
        "    written = file.write_text(file.read_text().replace('2', '3'))"
    )
    toy.write("lib/experiments/motion/late.py", "number = 2\n")
    toy.add("motion/02-late", edit)
    done = toy.run("figures", "motion/02-late")
    assert done.returncode == 1
    (line,) = [each for each in done.stdout.splitlines() if "changed while it was built: " in each]
    assert "lib/experiments/motion/late.py changed" in line and "ledger motion.gain changed" in line
    assert toy.reasons()["motion/02-late"] == "never built"


def test_a_build_builds_what_is_stale_and_notes_what_it_was_made_from(toy):
    toy.write(".gitignore", "build/\n__pycache__/\n")
    toy.commit()
    before = toy.stamps()
    DATA(toy)
    done = toy.run("figures")
    assert "build motion/01-first: data/motion/rig.toml changed" in done.stdout.splitlines()
    assert "1 built, 0 failed, 2 up to date" in done.stdout
    after = toy.stamps()
    assert not [
        each for each in after if "build/figures/isolation" in each and before.get(each) != after[each]
    ]
    assert toy.reasons() == {}
    record = json.loads((toy.root / f"build/figures/{OTHER}/provenance.json").read_text())
    assert record["commit"] == toy.git("rev-parse", "HEAD") and record["dirty"]


def test_builds_are_byte_identical_whatever_the_number_of_kernels(toy):
    with_three = toy.results()
    assert {name.rpartition(".")[2] for name in with_three} == {"png", "csv", "json", "ipynb"}
    assert toy.run("figures", "--force", "--jobs", "1").returncode == 0
    assert toy.results() == with_three
    assert toy.run("figures", OTHER, "--force").returncode == 0  # a kernel that is started, not forked
    assert toy.results() == with_three


def test_other_settings_go_to_a_folder_of_their_own(toy):
    before = toy.files("data", "notebooks", "build/figures")
    done = toy.run("figures", SECOND, "-p", "seed=3", "-p", "level=2")
    assert done.returncode == 0, done.stdout
    variant = "build/variants/isolation/02-second/seed=3,level=2.0"
    assert toy.files(variant)[f"{variant}/out.csv"] == b"3,4.0\n"
    assert set(toy.files(variant)) == {
        f"{variant}/{n}" for n in ("out.csv", "provenance.json", "record.json", "02-second.ipynb")
    }
    assert toy.files("data", "notebooks", "build/figures") == before
    assert toy.reasons(SECOND, "-p", "seed=3", "-p", "level=2") == {}
    LIBRARY(toy)
    assert list(toy.reasons(SECOND, "-p", "seed=3", "-p", "level=2").values()) == [
        "lib/experiments/isolation/model.py changed"
    ]


def test_a_setting_goes_to_every_notebook_that_has_the_parameter(toy):
    assert set(toy.reasons("-p", "record=a.csv")) == {f"{SECOND} (record='a.csv')"}
    assert len(toy.reasons("-p", "seed=2")) == 3
    assert len(toy.reasons("isolation", "-p", "seed=2")) == 2


def test_a_file_named_by_a_parameter_is_an_input(toy):
    toy.write("mine.csv", "1\n")
    assert toy.run("figures", "-p", "record=mine.csv").returncode == 0
    assert toy.reasons("-p", "record=mine.csv") == {}
    toy.write("mine.csv", "2\n")
    assert list(toy.reasons("-p", "record=mine.csv").values()) == ["file mine.csv changed"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-p", "sed=3"], "no notebook here has a parameter 'sed'; did you mean 'seed'?"),
        (["-p", "seed=1.5"], "isolation/01-first: parameter seed is '1.5'; give an int (in the notebook: 1)"),
        (["isolaton"], "no notebook or topic 'isolaton'; did you mean 'isolation'?"),
        (["--jobs", "0"], "argument --jobs: '0' is no whole number above 0; give one"),
    ],
)
def test_wrong_input_is_refused_before_a_kernel_starts(toy, arguments, message, monkeypatch, capsys):
    monkeypatch.setenv("STILLWORK_ROOT", str(toy.root))
    before = toy.stamps()
    with pytest.raises(SystemExit) if message.startswith("argument") else nullcontext():
        assert main(["figures", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert toy.stamps() == before
