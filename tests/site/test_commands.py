"""The commands for one's own data and one's own result."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from shared.universal_files import function, write_universal
from stillwork import paths
from stillwork.__main__ import main
from stillwork.checks import InputError
from stillwork.claims import load_entries
from stillwork.isolation.your_floor import SHORTEST_S
from stillwork.site import inspecting
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


def commands(report):
    """Notebook and settings of every command in a report, each checked against the notebook's own parameters."""
    found = {}
    for line in report.splitlines():
        if not line.startswith("for "):
            continue
        words = shlex.split(shlex.split(line.partition(": ")[2])[2].removeprefix("ARGS="))
        notebook = read_notebook(words[0])
        settings = dict(word.split("=", 1) for word in words[2::2])
        assert words[1::2] == ["-p"] * len(settings)
        found[words[0]] = {
            name: text if text == "UNIT" else notebook.parameters[name].read(text)
            for name, text in settings.items()
        }
    return found


def test_a_record_gets_the_command_that_uses_it():
    report = inspect_file(str(SLAB))
    assert "a record of 1 channel: 425.077 Hz, 30 s" in report
    wanted = f"-p floor_record={SLAB} -p 'floor_unit=m/s^2'"
    assert f'for isolation/08-your-floor: make figures ARGS="isolation/08-your-floor {wanted}"' in report
    assert commands(report) == {"isolation/08-your-floor": {"floor_record": str(SLAB), "floor_unit": "m/s^2"}}


def test_the_numbers_of_a_column_are_those_of_the_file(tmp_path):
    file = tmp_path / "two.csv"
    samples = np.arange(300)
    rows = "\n".join(f"{i / 10},{i % 7},{i % 3 - 1}" for i in samples)
    file.write_text(f"time,a,b\n{rows}\n")
    report = inspect_file(str(file))
    assert f"300 values from 0 to 6, mean {np.mean(samples % 7):.4g}" in report
    assert "a record of 2 channels: 10 Hz, 30 s" in report
    assert "it does not say every unit; put one of these for UNIT: m/s^2, m/s, m, N" in report
    found = commands(report)
    assert found["isolation/08-your-floor"]["floor_channels"] == ["a"]
    assert found["worstcase/07-your-record"]["output_channel"] == "b"
    assert found["fixedpoint/09-your-plant"]["trajectory_channel"] == "a"


def test_a_record_too_short_for_a_floor_gets_no_command_for_it(tmp_path):
    assert inspecting.SHORTEST_FLOOR_S == SHORTEST_S
    rows = "\n".join(f"{i / 100},{i % 7}" for i in range(1400))
    (tmp_path / "a.csv").write_text(f"time,a\n{rows}\n")
    assert list(commands(inspect_file(str(tmp_path / "a.csv")))) == ["fixedpoint/09-your-plant"]


def test_an_input_output_record_in_volts_is_for_the_room_that_takes_it():
    file = paths.data("worstcase", "your_record/template.csv")
    assert commands(inspect_file(str(file))) == {
        "worstcase/07-your-record": {
            "record_file": str(file),
            "input_channel": "drive (V)",
            "input_unit": "V",
            "output_channel": "plate (m/s^2)",
            "output_unit": "m/s^2",
            "band_hz": (0.0, 0.0),
            "quiet_hz": (0.0, 0.0),
        }
    }


@pytest.mark.parametrize(
    ("name", "said", "settings"),
    [
        (
            "frequency_response",
            "frequency response of a machine: 996 lines from 5 to 1000 Hz",
            {"response_unit": "m/s^2", "force_unit": "N", "fit_hz": (0.0, 0.0), "loop_hz": (0.0, 0.0)},
        ),
        (
            "hammer_records",
            "hammer records of a machine: 2048 lines from 0.5 to 1024 Hz",
            {"response_unit": "m/s^2", "force_unit": "N", "fit_hz": (0.0, 0.0), "loop_hz": (0.0, 0.0)},
        ),
        (
            "matrices",
            "matrices of a machine of 12 kg, first resonances at 355.9, 616.4 Hz",
            {"mirrored_sensor": False},
        ),
    ],
)
def test_every_form_of_a_machine_is_recognised(name, said, settings):
    file = paths.data("motion", f"your_machine/{name}.csv")
    report = inspect_file(str(file))
    assert said in report
    assert commands(report) == {"motion/29-your-machine": {"machine_file": str(file), **settings}}


def test_hits_side_by_side_are_no_input_output_record():
    file = paths.data("motion", "impact_frf_25k6/impact_hammer_5_hits.npz")
    assert list(commands(inspect_file(str(file)))) == ["motion/29-your-machine"]


def test_several_complex_responses_name_the_first(tmp_path):
    hertz = np.arange(1.0, 100.0)
    np.savez(tmp_path / "a.npz", frequency=hertz, h1=1 + 1j / hertz, h2=2 + 1j / hertz)
    report = inspect_file(str(tmp_path / "a.npz"))
    assert "99 complex values of magnitude" in report
    assert "it does not say the unit of the response" in report
    found = commands(report)["motion/29-your-machine"]
    assert found["response"] == "h1" and found["response_unit"] == "UNIT"


def test_a_machine_that_cannot_be_used_says_why(tmp_path):
    np.savez(tmp_path / "a.npz", M=np.eye(2), K=np.eye(2), input=[1.0, 0.0])
    report = inspect_file(str(tmp_path / "a.npz"))
    assert "not a machine as it stands: a.npz has 0 rigid-body modes" in report
    assert "make figures" not in report


def test_a_universal_file_is_read_with_its_units(tmp_path):
    t = np.arange(300) / 10
    rows = np.random.default_rng(0).standard_normal((2, 300))
    channels = [function("time", t, row, node=n, unit="m/s2") for n, row in enumerate(rows, 1)]
    found = commands(inspect_file(str(write_universal(tmp_path / "a.uff", channels))))
    assert found["isolation/08-your-floor"]["floor_unit"] == "m/s2"
    assert found["worstcase/07-your-record"]["input_channel"] == "acceleration 1+Z (m/s2)"
    one = function("frf", 1.0 + np.arange(64), np.exp(1j * np.arange(64)), reference=1, unit="(mm/s)/N")
    found = commands(inspect_file(str(write_universal(tmp_path / "b.uff", [one]))))
    assert found["motion/29-your-machine"]["response_unit"] == "mm/s"


def test_a_plant_is_looked_at_and_not_executed(tmp_path):
    plant = paths.data("fixedpoint", "your_plant.py")
    assert commands(inspect_file(str(plant))) == {"fixedpoint/09-your-plant": {"plant": str(plant)}}
    (tmp_path / "a.py").write_text("raise SystemExit('executed')\n")
    assert "not a plant as it stands: no function acceleration" in inspect_file(str(tmp_path / "a.py"))
    oscillator = paths.data("fixedpoint", "oscillator.toml")
    assert commands(inspect_file(str(oscillator))) == {"fixedpoint/09-your-plant": {"plant": str(oscillator)}}
    motion = paths.data("fixedpoint", "your_trajectory.csv")
    assert commands(inspect_file(str(motion)))["fixedpoint/09-your-plant"]["trajectory_unit"] == "mm"


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
        (".", None, "this is a folder; name a file in it"),
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
    style += ["--config", 'lint.isort.known-first-party=["stillwork"]']  # the toy has no library of its own
    notebook = toy.root / "notebooks/isolation/09-heavy-payload.ipynb"
    done = subprocess.run([*style, str(test), str(notebook)], cwd=toy.root, capture_output=True, text=True)
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
