"""What a build makes, what it leaves alone, and what it says."""

import json
import re
import shutil
import subprocess
import sys

import pytest

from engine import toy as toys
from workbook.progress import Progress

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


def change_parameter(toy):
    toy.replace(f"notebooks/{FIRST}.ipynb", "seed: int = 1", "seed: int = 2")


def change_cell(toy):
    toy.replace(f"notebooks/{FIRST}.ipynb", "gain(level))", "gain(2 * level))")


def change_library(toy):
    toy.replace("lib/experiments/isolation/model.py", "2.0", "2.5")


def change_shared_module(toy):
    toy.replace("lib/workbook/checks.py", "import difflib", "import cmath\nimport difflib")


def change_data(toy):
    toy.write("data/motion/rig.toml", "mass = 2.0\n")


def change_ledger(toy):
    toy.replace("data/motion/published.toml", "published = 2.0", "published = 2.1")


def change_pin(toy):
    toy.replace("environment.txt", "numpy==2.4.5", "numpy==2.4.6")


def change_other_pin(toy):
    toy.replace("environment.txt", "ruff==1.0", "ruff==1.1")


def remove_output(toy):
    (toy.root / f"build/figures/{FIRST}/fig-1.csv").unlink()


def edit_output(toy):
    toy.write(f"build/figures/{FIRST}/fig-1.csv", "1,2\n")


def leave_a_file(toy):
    toy.write(f"build/figures/{FIRST}/extra.csv", "1,2\n")


def forget_state(toy):
    shutil.rmtree(toy.root / "build")


@pytest.mark.parametrize(
    ("change", "stale", "reason"),
    [
        (change_parameter, {FIRST}, "parameter seed: 1 -> 2"),
        (change_cell, {FIRST}, "cell claim changed"),
        (change_library, {FIRST, SECOND}, "lib/experiments/isolation/model.py changed"),
        (change_shared_module, ALL, "lib/workbook/checks.py changed"),
        (change_data, {OTHER}, "data/motion/rig.toml changed"),
        (change_ledger, {OTHER}, "ledger motion.gain changed"),
        (change_pin, ALL, "environment: numpy 2.4.5 -> 2.4.6"),
        (change_other_pin, set(), "of what no kernel loads"),
        (remove_output, {FIRST}, "output fig-1.csv missing"),
        (leave_a_file, {FIRST}, "output extra.csv is not the build's"),
        (edit_output, {FIRST}, "output fig-1.csv was changed by hand"),
        (forget_state, ALL, "never built"),
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


@pytest.mark.parametrize(
    ("edited", "said"),
    [
        ("lib/experiments/motion/late.py", "lib/experiments/motion/late.py changed"),
        ("data/motion/published.toml", "ledger motion.gain changed"),
    ],
)
def test_what_is_edited_while_it_is_built_is_noticed(toy, edited, said):
    edit = (
        f"from pathlib import Path\nfile = Path(paths.root(), '{edited}')\n"
        "from workbook.page import Page\nfrom experiments.motion.late import number\n"
        "verdict = Page('motion/02-late').check('motion.gain', 2.0)\n"
        "written = file.write_text(file.read_text().replace('2', '3'))"
    )
    toy.write("lib/experiments/motion/late.py", "number = 2\n")
    toy.add("motion/02-late", edit)
    done = toy.run("figures", "motion/02-late")
    assert done.returncode == 1
    assert f"changed while it was built: {said}" in done.stdout
    assert toy.reasons()["motion/02-late"] == "never built"


def test_a_build_builds_what_why_says_and_nothing_else(toy):
    before = toy.stamps()
    change_data(toy)
    done = toy.run("figures")
    assert "build motion/01-first: data/motion/rig.toml changed" in done.stdout.splitlines()
    assert "1 built, 0 failed, 2 up to date" in done.stdout
    after = toy.stamps()
    changed = {
        path for path in after if "build/figures/isolation" in path and before.get(path) != after[path]
    }
    assert not changed
    assert toy.reasons() == {}


def test_builds_are_byte_identical_whatever_the_number_of_kernels(toy):
    with_three = toy.results()
    assert {name.rpartition(".")[2] for name in with_three} == {"png", "csv", "json", "ipynb"}
    assert toy.run("figures", "--force", "--jobs", "1").returncode == 0
    assert toy.results() == with_three
    for part in ("isolation", "motion"):  # fewer than three: kernels that are started, not forked
        assert toy.run("figures", part, "--force").returncode == 0
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
    change_library(toy)
    assert list(toy.reasons(SECOND, "-p", "seed=3", "-p", "level=2").values()) == [
        "lib/experiments/isolation/model.py changed"
    ]


def test_settings_of_every_type_reach_the_notebook(toy):
    toy.add(
        "motion/02-types",
        "assert corner == (2.0, 'a\"b\\\\n'), corner",
        "assert bands == [0.5] and type(bands) is list",
        "assert record is None and fast is True and level == 3.0 and type(level) is float",
        parameters=(
            "seed: int = 1  # a\nlevel: float = 1.0  # b\nfast: bool = False  # c\nrecord: str | None = 'x'  # d\n"
            "corner: tuple[float, str] = (1.0, 'y')  # e\nbands: list[float] = []  # f"
        ),
    )
    settings = ["corner=(2, 'a\"b\\\\n')", "bands=[0.5]", "record=none", "fast=true", "level=3"]
    done = toy.run("figures", "motion/02-types", *(word for text in settings for word in ("-p", text)))
    assert done.returncode == 0, done.stdout


def test_kernels_are_alike_whatever_a_user_has_at_home(toy):
    toy.write("home/ipython/profile_default/startup/00.py", "seed_of_the_user = 1\n")
    toy.write("home/jupyter/kernels/python3/kernel.json", '{"argv": ["false"], "display_name": "Mine"}')
    toy.write("home/matplotlibrc", "lines.linewidth: 9\n")
    toy.add(
        "motion/02-home",
        "import os, stillwork, matplotlib\nassert stillwork.__file__.startswith(os.environ['TOY'])",
        "assert 'seed_of_the_user' not in globals()",
        "assert matplotlib.rcParams['lines.linewidth'] != 9",
        "assert os.environ['OPENBLAS_NUM_THREADS'] == os.environ['OMP_NUM_THREADS'] == '1'",
    )
    home = {
        "IPYTHONDIR": f"{toy.root}/home/ipython",
        "JUPYTER_DATA_DIR": f"{toy.root}/home/jupyter",
        "MATPLOTLIBRC": f"{toy.root}/home/matplotlibrc",
        "OMP_NUM_THREADS": "7",
    }
    command = toy.command("figures", "motion/02-home")
    done = subprocess.run(command, cwd=toy.root, env=toy.environment() | home, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def test_the_published_setting_given_by_hand_is_the_published_build(toy):
    assert toy.reasons("-p", "seed=1", "-p", "level=1") == {}


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
        (["-p", "seed"], "-p 'seed' is not a setting; give -p NAME=VALUE"),
        (["-p", "seed=2", "-p", "seed=3"], "-p seed is given twice"),
        (["isolaton"], "no notebook or topic 'isolaton'; did you mean 'isolation'?"),
        (["--jobs", "0"], "argument --jobs: '0' is no whole number; give 1 or more"),
        (["--jobs", "²"], "argument --jobs: '²' is no whole number; give 1 or more"),
        (["--scheduler", ""], "argument --scheduler: '' names nothing"),
        (["--job", "1"], "unrecognized arguments: --job"),
    ],
)
def test_wrong_input_is_refused_before_a_kernel_starts(toy, arguments, message):
    before = toy.stamps()
    done = toy.run("figures", *arguments)
    assert done.returncode == 2
    assert message in done.stderr
    assert toy.stamps() == before


def test_a_malformed_parameters_cell_is_refused_before_a_kernel_starts(toy):
    toy.replace(f"notebooks/{OTHER}.ipynb", "level: float = 1.0  # V", "level = 1.0  # V")
    done = toy.run("figures")
    assert done.returncode == 2
    assert "motion/01-first.ipynb: parameters cell, line 2: 'level = 1.0  # V'" in done.stderr


@pytest.mark.parametrize("name", [FIRST, f"notebooks/{FIRST}.ipynb"])
def test_a_notebook_may_be_named_by_its_file(toy, name):
    assert "nothing to do: 1 up to date" in toy.run("figures", name).stdout


def test_provenance(toy):
    record = json.loads((toy.root / f"build/figures/{FIRST}/provenance.json").read_text())
    assert record["parameters"] == {"seed": 1, "level": 1.0}
    assert record["seed"] == 1
    assert record["commit"] is None  # the toy is no git checkout
    assert record["python"] == ".".join(map(str, sys.version_info[:3]))
    assert len(record["environment_sha256"]) == 64


def test_provenance_names_the_commit_and_whether_inputs_differ_from_it(toy):
    toy.write(".gitignore", "build/\n__pycache__/\n")
    toy.commit()
    change_data(toy)
    assert toy.run("figures", "--force").returncode == 0
    records = {
        name: json.loads((toy.root / f"build/figures/{name}/provenance.json").read_text())
        for name in (FIRST, OTHER)
    }
    assert {record["commit"] for record in records.values()} == {toy.git("rev-parse", "HEAD")}
    assert not records[FIRST]["dirty"]
    assert records[OTHER]["dirty"]


def test_nothing_is_left_at_the_end_and_nothing_known_at_the_beginning():
    progress = Progress(4)
    assert progress.left() == ""
    progress.step(2)
    assert re.fullmatch(r", \d+ s left", progress.left())
    progress.step(2)
    assert progress.left() == ""
