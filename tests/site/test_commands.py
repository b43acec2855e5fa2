"""The commands for one's own data and one's own result."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from stillwork import paths
from stillwork.__main__ import main
from stillwork.checks import InputError
from stillwork.claims import load_entries
from stillwork.site.inspecting import inspect_file
from stillwork.site.scaffold import new_result
from stillwork.workbook.notebooks import read_notebook
from workbook import toy as toys

SLAB = paths.data("isolation", "slab_footfall/slab_vertical.csv")


@pytest.fixture
def toy(tmp_path, monkeypatch):
    made = toys.make(tmp_path / "toy")
    monkeypatch.setenv("STILLWORK_ROOT", str(made.root))
    yield made
    toys.clean_up(made)


def test_a_record_gets_the_command_that_uses_it():
    report = inspect_file(str(SLAB))
    assert "a record of 1 channel: 425.077 Hz, 30 s" in report
    wanted = f"-p floor_record={SLAB} -p 'floor_unit=m/s^2'"
    assert f'for isolation/08-your-floor: make figures ARGS="isolation/08-your-floor {wanted}"' in report


def test_the_numbers_of_a_column_are_those_of_the_file(tmp_path):
    file = tmp_path / "two.csv"
    samples = np.arange(300)
    rows = "\n".join(f"{i / 100},{i % 7},{i % 3 - 1}" for i in samples)
    file.write_text(f"time,a,b\n{rows}\n")
    report = inspect_file(str(file))
    assert f"300 values from 0 to 6, mean {np.mean(samples % 7):.4g}" in report
    assert "a record of 2 channels: 100 Hz, 3 s" in report
    assert "it does not say its unit; put one of these for UNIT: m/s^2, mm/s^2" in report
    assert "floor_channels=a," in report


def test_what_is_wrong_with_a_record_is_said(tmp_path):
    file = tmp_path / "gap.csv"
    file.write_text("time,a\n" + "\n".join(f"{i + (i > 150)},1" for i in range(300)))
    assert "not a record as it stands: gap.csv: 1 gap(s) in time" in inspect_file(str(file))
    assert "make figures" not in inspect_file(str(file))
    file.write_text("time,a\n0,1\n1,\n2,nan\n")
    assert "2 missing or infinite" in inspect_file(str(file))


def test_a_machine_is_recognised_by_the_room_that_reads_it(tmp_path):
    report = inspect_file(str(paths.data("isolation", "rigid_body.toml")))
    assert "a machine of the room isolation" in report
    assert "-p model=" in report
    broken = tmp_path / "rig.toml"
    broken.write_text(
        paths.data("isolation", "rigid_body.toml").read_text(encoding="utf-8").replace("mass =", "mas =")
    )
    report = inspect_file(str(broken))
    assert "not a machine of the room isolation: rig.toml" in report
    assert "make figures" not in report


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("none.csv", None, "no such file"),
        ("a.xlsx", "x", "not read; export CSV"),
        ("a.toml", "= 1", "not valid TOML"),
    ],
)
def test_a_file_that_cannot_be_read_is_refused(tmp_path, capsys, name, content, message):
    if content is not None:
        (tmp_path / name).write_text(content)
    assert main(["inspect", str(tmp_path / name)]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.slow
def test_a_new_result_builds_claims_and_passes_its_test(toy):
    before = toy.files("data/isolation")["data/isolation/published.toml"]
    written = new_result("isolation", "09-heavy-payload")
    assert written == [
        "notebooks/isolation/09-heavy-payload.ipynb",
        "tests/isolation/test_heavy_payload.py",
        "data/isolation/published.toml",
    ]
    assert toy.files("data/isolation")["data/isolation/published.toml"].startswith(before)
    assert "isolation.heavy-payload.decrement" in load_entries("isolation")
    assert read_notebook("isolation/09-heavy-payload").parameters["damping"].value == 0.1
    done = toy.run("figures", "isolation/09-heavy-payload")
    assert done.returncode == 0, done.stdout + done.stderr
    claims = toy.run("claims").stdout
    assert "isolation.heavy-payload.decrement  section 0" in claims
    assert "1 replicated" in claims
    test = toy.root / "tests/isolation/test_heavy_payload.py"
    # Without plugins: they take longer to load than the test to run.
    bare = os.environ | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-o", "addopts=", str(test)]
    done = subprocess.run(command, cwd=toy.root, env=bare, capture_output=True, text=True)
    assert "3 passed" in done.stdout, done.stdout
    style = [
        sys.executable,
        "-m",
        "ruff",
        "check",
        "--config",
        str(Path(__file__).parents[2] / "pyproject.toml"),
    ]
    done = subprocess.run([*style, str(test)], cwd=toy.root, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("room", "name", "message"),
    [
        ("isolaton", "09-a", "did you mean 'isolation'"),
        ("isolation", "payload", "give a number and words"),
        ("isolation", "../09-a", "give a number and words"),
    ],
)
def test_a_new_result_needs_a_room_and_a_name(toy, room, name, message):
    with pytest.raises(InputError, match=message):
        new_result(room, name)


def test_a_new_result_overwrites_nothing(toy):
    new_result("isolation", "09-a")
    before = toy.files("notebooks", "data", "tests")
    for name, message in [
        ("09-a", "09-a.ipynb exists already; choose another name"),
        ("10-a", "test_a.py exists already; choose another name"),
        ("09-b", "the number 09 is taken by 09-a; the last one is 09"),
    ]:
        with pytest.raises(InputError, match=message):
            new_result("isolation", name)
    assert toy.files("notebooks", "data", "tests") == before
