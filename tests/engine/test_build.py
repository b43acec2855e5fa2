"""What a build makes, what it leaves alone, and what it says."""

import json
import os
import py_compile
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest

from engine import toy as toys
from workbook import publish
from workbook.inputs import read_inputs
from workbook.kernel_process import IgnoredPaths
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
        "import sys\nfrom stillwork.__main__ import main\nassert main(['figures']) == 0\n"
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
    toy.replace("lib/stillwork/base/checks.py", "import difflib", "import cmath\nimport difflib")


def change_data(toy):
    toy.write("data/motion/rig.toml", "mass = 2.0\n")


def change_ledger(toy):
    toy.replace("data/motion/published.toml", "published = 2.0", "published = 2.1")


def change_pin(toy):
    toy.replace("environment.txt", "numpy==2.4.5", "numpy==2.4.6")


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
        (change_shared_module, ALL, "lib/stillwork/base/checks.py changed"),
        (change_data, {OTHER}, "data/motion/rig.toml changed"),
        (change_ledger, {OTHER}, "ledger motion.gain changed"),
        (change_pin, ALL, "environment: numpy 2.4.5 -> 2.4.6"),
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


def test_what_a_notebook_read_is_what_makes_it_stale(toy):
    toy.write("mylab/stage.py", "from mylab.parts import mass\n")
    toy.write("mylab/parts.py", "mass = 1.0\n")
    toy.write("lib/experiments/motion/paint.py", "LABEL = 'time (s)'\n")
    toy.add(
        "motion/02-reads",
        "import importlib, sys\nsys.path.append(str(paths.root()))\nimportlib.import_module(plant)",
        "from experiments.motion import paint",
        "records = sorted(paths.data('motion', 'records').iterdir())\nrecords[0].read_text()",
        parameters="seed: int = 1  # of the noise\nlevel: float = 1.0  # V\nplant: str = 'mylab.stage'  # module",
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
        assert toy.reasons() == {"motion/02-reads": f"{name} changed"}
        toy.write(name, before)
    toy.write("data/motion/records/second.csv", "1,2\n")
    assert toy.reasons() == {"motion/02-reads": "data/motion/records/ changed"}


def test_what_a_notebook_read_elsewhere_makes_it_stale_too(toy, tmp_path):
    plant = tmp_path / "plant.py"
    plant.write_text("mass = 1.0\n")
    toy.add("motion/02-own", f"import runpy\nlevel = runpy.run_path({str(plant)!r})['mass']")
    assert toy.run("figures", "motion/02-own").returncode == 0
    assert toy.reasons() == {}
    plant.write_text("mass = 2.0\n")
    (reason,) = toy.reasons().values()
    assert reason.removeprefix("file ") == f"{plant} changed"


@pytest.mark.parametrize(
    ("path", "left_out"),
    [
        ("{home}/.local/share/lab/plant.py", False),
        ("{home}/.cache/x/record.csv", False),
        ("{home}/.config/lab/rig.toml", False),
        ("{home}/.ipython/lab.py", False),
        ("/run/media/me/disk/record.csv", False),
        ("/run/user/1000/gvfs/share/record.csv", False),
        ("/usr/local/share/lab/plant.py", False),
        (json.__file__, True),
        (np.__file__, True),
        ("/usr/share/zoneinfo/UTC", True),
        ("/proc/cpuinfo", True),
        ("{home}/.cache/matplotlib/fontlist-v390.json", True),
        ("{home}/.config/matplotlib/stylelib/mine.mplstyle", True),
        ("{home}/.local/share/fonts/Mine.TTF", True),
        ("{home}/.cache/numba/plant-1.py311.nbi", True),
        ("/tmp/stillwork-1/ipython/profile_default/history.sqlite", True),
        ("{root}/build/kernels/0/a.nbi", True),
        ("{home}/lab/__pycache__/plant.cpython-312.pyc", True),
        ("{home}/lab/__pycache__/record.csv", False),
        ("{home}/lab/plant.pyc", False),
        ("{root}/lib/experiments/motion/model.py", False),
    ],
)
def test_what_is_left_out_has_a_reason(path, left_out, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("STILLWORK_ROOT", str(tmp_path / "root"))
    for name in ("XDG_CACHE_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.delenv(name, raising=False)
    path = path.format(home=tmp_path / "home", root=tmp_path / "root")
    assert IgnoredPaths("/tmp/stillwork-1/reads").holds(path) == left_out


def test_a_checkout_in_a_place_that_is_left_out_is_watched(monkeypatch):
    monkeypatch.setenv("STILLWORK_ROOT", "/usr/share/toy")
    left_out = IgnoredPaths("/nowhere/reads")
    assert not left_out.holds("/usr/share/toy/data/motion/rig.toml")
    assert left_out.holds("/usr/share/toy/build/a.csv") and left_out.holds("/usr/share/toys/a.csv")


def test_an_installed_package_that_no_pin_speaks_for_is_watched(tmp_path, monkeypatch):
    packages = tmp_path / "venv" / "site-packages"
    for name, record in {
        "My_Lab-1.0": "mylab/__init__.py,,\nmylab_units.py,,\n../../bin/mylab,,\n",
        "Pinned_One-2.0": "pinned/__init__.py,,\n",
    }.items():
        (packages / f"{name}.dist-info").mkdir(parents=True)
        (packages / f"{name}.dist-info" / "RECORD").write_text(record)
    (tmp_path / "root").mkdir()
    pins = "--only-binary :all:\nnumpy==2.4.5\npinned-one==2.0 ; x \\\n    --hash=a\n"
    (tmp_path / "root" / "environment.txt").write_text(pins)
    monkeypatch.setenv("STILLWORK_ROOT", str(tmp_path / "root"))
    monkeypatch.syspath_prepend(packages)
    left_out = IgnoredPaths("/nowhere/reads")
    for name in ("mylab/stage.py", "mylab_units.py"):
        assert not left_out.holds(str(packages / name))
    for name in ("pinned/__init__.py", "mylab/__pycache__/stage.cpython-312.pyc", "mylab_other/a.py"):
        assert left_out.holds(str(packages / name))


def test_a_variable_of_the_user_s_hides_no_tree(tmp_path, monkeypatch):
    monkeypatch.setenv("STILLWORK_ROOT", str(tmp_path / "root"))
    monkeypatch.setattr(sys, "pycache_prefix", str(tmp_path))
    for name in ("MPLCONFIGDIR", "NUMBA_CACHE_DIR", "STILLWORK_KERNELS"):
        monkeypatch.setenv(name, str(tmp_path))
    left_out = IgnoredPaths("/nowhere/reads")
    for name in ("record.csv", "lab/plant.py", "root/lib/experiments/motion/model.py"):
        assert not left_out.holds(str(tmp_path / name))
    for name in "fontlist-v390.json stylelib/a.mplstyle matplotlibrc base_0/a.nbi lab/a.nbc a.pyc".split():
        assert left_out.holds(str(tmp_path / name))


def test_a_library_that_was_edited_and_put_back_in_mid_build_is_noticed(toy):
    edit = (
        "from pathlib import Path\nfile = Path(paths.root(), 'lib/experiments/motion/late.py')\n"
        "before = file.read_text()\nwritten = file.write_text('number = 2')\n"
        "from experiments.motion.late import number\nwritten = file.write_text(before)"
    )
    toy.write("lib/experiments/motion/late.py", "number = 1\n")
    toy.add("motion/02-late", edit)
    done = toy.run("figures", "motion/02-late")
    assert done.returncode == 1
    assert "lib/experiments/motion/late.py changed" in done.stdout
    assert toy.reasons() == {"motion/02-late": "never built"}


def test_bytecode_of_another_source_is_not_run(toy):
    """Python matches it by size and second of change, which an edit right after an import keeps."""
    model = toy.root / "lib/experiments/isolation/model.py"
    now = model.stat()
    change_library(toy)
    os.utime(model, ns=(now.st_atime_ns, now.st_mtime_ns))
    py_compile.compile(str(model))
    toy.replace("lib/experiments/isolation/model.py", "2.5", "3.5")
    os.utime(model, ns=(now.st_atime_ns, now.st_mtime_ns))
    assert toy.run("figures", SECOND).returncode == 0
    assert toy.results()[f"build/figures/{SECOND}/out.csv"] == b"1,3.5\n"


@pytest.mark.parametrize("text", [None, "", '{"path": "a", "dig'])
def test_what_was_read_is_not_guessed(tmp_path, text):
    log = tmp_path / "reads"
    if text is not None:
        log.write_text(text)
    with pytest.raises(ValueError, match="kernel"):
        read_inputs(log)


@pytest.mark.parametrize(("room", "noted"), [(10_000, True), (10, False)])
def test_a_log_that_does_not_fit_on_the_disk_is_removed(toy, room, noted):
    script = (
        "import os, resource, sys\nfrom workbook.kernel_process import IgnoredPaths, watch\n"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({room}, {room}))\n"
        "watch('reads', IgnoredPaths('/nowhere/reads'))\nopen('environment.txt').close()"
    )
    environment = toy.environment() | {"STILLWORK_ROOT": str(toy.root)}
    subprocess.run([sys.executable, "-c", script], cwd=toy.root, env=environment, check=True)
    assert (toy.root / "reads").exists() == noted


def read_by(folder, imports, code):
    """What a kernel notes as read by some code that runs in a folder, once all is imported that the code needs."""
    script = (
        f"{imports}\nfrom workbook.kernel_process import IgnoredPaths, watch\n"
        f"watch('reads', IgnoredPaths('/nowhere/reads'))\n{code}"
    )
    environment = os.environ | {"STILLWORK_ROOT": str(folder / "root")}  # outside of which they read
    subprocess.run([sys.executable, "-c", script], cwd=folder, env=environment, check=True)
    return [json.loads(line) for line in (folder / "reads").read_text().splitlines()]


@pytest.mark.parametrize(
    "load", ["ctypes.CDLL('model.so')", "ExtensionFileLoader('model', 'model.so').create_module(spec)"]
)
def test_a_library_of_machine_code_is_read_without_being_opened(tmp_path, load):
    (tmp_path / "model.so").write_bytes(b"no machine code")
    imports = (
        "import contextlib, ctypes\nfrom importlib.machinery import ExtensionFileLoader, ModuleSpec\n"
        "spec = ModuleSpec('model', None, origin='model.so')"
    )
    (read,) = read_by(tmp_path, imports, f"with contextlib.suppress(OSError, ImportError):\n    {load}")
    assert read == {"path": str(tmp_path / "model.so"), "digest": publish.digest(b"no machine code")}


@pytest.mark.parametrize(
    ("code", "noted"),
    [
        ("np.memmap('record.bin')", True),
        ("open('record.bin', 'r+b').close()", True),
        ("open('record.bin', 'a+b').close()", True),
        ("os.open('record.bin', os.O_RDWR)", True),
        ("os.open('record.bin', os.O_RDWR | os.O_CREAT)", True),
        ("sqlite3.connect('record.bin')", True),
        ("sqlite3.connect(f'file:{os.getcwd()}/record.bin?mode=ro', uri=True)", True),
        ("open('record.bin', 'ab').close()\nopen('record.bin').close()", True),
        ("open('record.bin').close()\nopen('record.bin', 'w').close()", True),
        (
            "os.rename('record.bin', 'a')\ntry: open('record.bin')\n"
            "except OSError: os.rename('a', 'record.bin')\nopen('record.bin').close()",
            True,
        ),
        ("open('record.bin', 'ab').close()", False),
        ("os.open('record.bin', os.O_WRONLY)", False),
        ("open('record.bin', 'wb').close()\nopen('record.bin').close()", False),
        ("os.open('record.bin', os.O_RDWR | os.O_TRUNC)\nopen('record.bin').close()", False),
        ("np.memmap('new.bin', mode='w+', shape=9)[:] = 1\nnp.memmap('new.bin')", False),
        ("sqlite3.connect('new.bin').execute('create table a (b)')\nsqlite3.connect('new.bin')", False),
    ],
)
def test_what_is_opened_for_reading_too_is_read_unless_it_was_made_here(tmp_path, code, noted):
    (tmp_path / "record.bin").write_bytes(b"volts")
    read = read_by(tmp_path, "import os, sqlite3\nimport numpy as np", code)
    expected = [{"path": str(tmp_path / "record.bin"), "digest": publish.digest(b"volts")}] * noted
    assert [each for each in read if each["path"].startswith(str(tmp_path))] == expected


@pytest.mark.parametrize(
    ("code", "noted"),
    [
        ("os.listdir('records')", True),
        ("os.chdir('records')\nos.listdir()", True),
        ("glob.glob('records/*.csv')", True),
        ("sorted(Path('records').glob('*.csv'))", True),
        ("list(os.walk('records'))", True),
        ("sys.path.append('records')\nimport plant", False),
        ("sys.path.append('records')\nlist(pkgutil.iter_modules())\nlist(metadata.distributions())", False),
        ("os.mkdir('mine')\nos.listdir('mine')", False),
    ],
)
def test_a_folder_that_is_listed_is_read_wherever_it_lies(tmp_path, code, noted):
    (tmp_path / "records").mkdir()
    (tmp_path / "records" / "plant.py").touch()
    imports = "import glob, os, pkgutil, sys\nfrom importlib import metadata\nfrom pathlib import Path"
    read = [each["path"] for each in read_by(tmp_path, imports, code)]
    assert [path for path in read if path.endswith("/")] == [f"{tmp_path}/records/"] * noted


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
        (["--job", "1"], "did you mean '--jobs'?"),
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
