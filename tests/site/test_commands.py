"""The commands for one's own data and one's own result."""

import os
import shlex
import subprocess

import numpy as np
import pytest

from stillwork.__main__ import main
from stillwork.machine.inspect import inspect_file
from workbook import paths
from workbook.checks import InputError
from workbook.notebooks import read_notebook
from workbook.site.scaffold import new_result


@pytest.fixture
def toy(toy, monkeypatch):
    monkeypatch.setenv("STILLWORK_ROOT", str(toy.root))
    return toy


def commands(report):
    """Notebook and settings of every command in a report, each checked against the notebook's own parameters."""
    found = {}
    for line in report.splitlines():
        if not line.startswith("for "):
            continue
        notebook, settings = meant(shlex.split(line.partition(": ")[2]))
        found[notebook] = settings
    return found


def meant(words):
    """Notebook and settings of the words of a command."""
    assert words[:4] == ["python", "-m", "stillwork", "figures"]
    assert words[5::2] == ["-p"] * len(words[6::2])
    parameters = read_notebook(words[4]).parameters
    texts = dict(word.split("=", 1) for word in words[6::2])
    return words[4], {
        name: text if text == "UNIT" else parameters[name].read(text) for name, text in texts.items()
    }


def hostile_names():
    """Names that a shell, a terminal or the reader of ``-p`` could take for something else."""
    names = ["$(touch X)", "`touch X`", "$HOME", "; touch X", "> X", "'; touch X; '", '"; touch X; "', "a'b"]
    names += ["\\", "a\\nb", "$'\\n'", "-p seed=3", "a=b", "~", "*", "{a,b}", "!!", "# a"]
    names += [" a", "a,", "-3", "none"]
    names += ["['a']", "UNIT", "'a'", "0x10", "µ² (m)", "加速度", "\u202e", "\xa0"]
    names += ["a\nb", "a\ttab", "a\x1b[2Jb", "a\x07", "a\u2028b", "a\x85b", "a\nfor x: touch X"]
    return names


@pytest.fixture
def shell(tmp_path):
    """Run lines in a shell that finds a `python` which only notes its words; gives the words of each call."""
    tools, place = tmp_path / "tools", tmp_path / "place"
    tools.mkdir()
    place.mkdir()
    (tools / "python").write_text(
        '#!/bin/sh\nprintf \'%s\\0\' python "$@" >> "$CALLS"; printf \'\\1\' >> "$CALLS"\n'
    )
    (tools / "python").chmod(0o755)

    def run(lines):
        calls = tmp_path / "calls"
        calls.write_text("")
        own = {"PATH": f"{tools}:{os.environ['PATH']}", "HOME": str(place), "CALLS": str(calls)}
        done = subprocess.run(["sh", "-c", "\n".join(lines)], cwd=place, env=own, capture_output=True)
        assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")
        assert not list(place.iterdir())
        return [call.split("\0")[:-1] for call in calls.read_text(encoding="utf-8").split("\1")[:-1]]

    return run


@pytest.mark.slow
def test_no_name_in_a_file_becomes_a_command(tmp_path, shell):
    samples = np.arange(300)
    np.savez(tmp_path / "plain.npz", **{"fs": 10.0, "y": samples % 7.0, "z": samples % 3.0})
    usual = len(inspect_file(str(tmp_path / "plain.npz")).split("\n"))
    for number, name in enumerate(hostile_names()):
        folder = tmp_path / str(number)
        folder.mkdir()
        file = folder / f"{name.replace('/', '')}.npz"
        np.savez(file, **{"fs": 10.0, name: samples % 7.0, "z": samples % 3.0})
        report = inspect_file(str(file))
        lines = report.split("\n")
        assert len(lines) == usual and all(map(str.isprintable, lines)), name
        found = dict(map(meant, shell([line.partition(": ")[2] for line in lines if line[:4] == "for "])))
        # What stands in brackets is a unit that nobody knows: then no command has the name.
        unknown = "unknown units" in report
        assert len(found) == (3 - unknown if name.isprintable() else 0), name
        if unknown and found:
            assert set(name) & set(")]}")
            assert found["isolation/08-your-floor"]["floor_channels"] == ["z"]
        elif found:
            assert found["isolation/08-your-floor"]["floor_record"] == str(file.resolve())
            # A channel in metres and one without a unit do not go together.
            together = [name] if name.endswith("(m)") else [name, "z"]
            assert found["isolation/08-your-floor"]["floor_channels"] == together
            assert found["worstcase/07-your-record"]["record_file"] == str(file.resolve())
            assert found["worstcase/07-your-record"]["input_channel"] == name
            assert found["fixedpoint/09-your-plant"]["trajectory_channel"] == name
        else:
            assert [line.partition(":")[0] for line in lines if "rename it and run this again" in line] == [
                "no command for a feedforward in C",
                "no command for isolation/08-your-floor",
                *["no command for worstcase/07-your-record"][: not unknown],
                "no command for fixedpoint/09-your-plant",
            ]


MEASURED = {"response_unit": "m/s^2", "force_unit": "N", "fit_hz": (0.0, 0.0), "loop_hz": (0.0, 0.0)}


@pytest.mark.parametrize(
    ("name", "said", "settings"),
    [
        ("frequency_response", "frequency response of a machine: 996 lines from 5 to 1000 Hz", MEASURED),
        ("hammer_records", "hammer records of a machine: 2048 lines from 0.5 to 1024 Hz", MEASURED),
        ("matrices", "matrices of a machine of 12 kg, first resonances at 355.9, 616.4 Hz", {}),
    ],
)
def test_every_form_of_a_machine_is_recognised(name, said, settings):
    file = paths.data("motion", f"your_machine/{name}.csv")
    report = inspect_file(str(file))
    assert said in report
    assert commands(report) == {"motion/29-your-machine": {"machine_file": str(file), **settings}}
    lines = report.splitlines()
    design, page, notebook = (
        next(k for k, line in enumerate(lines) if f"stillwork {word} " in line)
        for word in ("design", "report", "figures")
    )
    assert design < page < notebook and str(file) in lines[design] and "--rate HZ" in lines[design]


def test_a_plant_is_looked_at_and_not_executed(tmp_path):
    plant = paths.data("fixedpoint", "your_plant.py")
    assert commands(inspect_file(str(plant))) == {"fixedpoint/09-your-plant": {"plant": str(plant)}}
    (tmp_path / "a.py").write_text("raise SystemExit('executed')\n")
    assert "acceleration" in inspect_file(str(tmp_path / "a.py"))
    oscillator = paths.data("fixedpoint", "oscillator.toml")
    assert commands(inspect_file(str(oscillator))) == {"fixedpoint/09-your-plant": {"plant": str(oscillator)}}
    motion = paths.data("fixedpoint", "your_trajectory.csv")
    assert commands(inspect_file(str(motion)))["fixedpoint/09-your-plant"]["trajectory_unit"] == "mm"


def test_a_machine_is_recognised_by_the_topic_that_reads_it(tmp_path):
    machine = str(paths.data("isolation", "rigid_body.toml"))
    report = inspect_file(machine)
    assert "isolation" in report
    assert commands(report) == {"isolation/08-your-floor": {"model": machine}}
    assert "not a machine" not in report  # one answer, without what it is not
    broken = tmp_path / "rig.toml"
    broken.write_text(
        paths.data("isolation", "rigid_body.toml").read_text(encoding="utf-8").replace("mass =", "mas =")
    )
    report = inspect_file(str(broken))
    assert "rig.toml" in report and "'mas'" in report
    assert "stillwork figures" not in report


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


def test_a_new_result_overwrites_nothing(toy):
    new_result("isolation", "09-a")
    before = toy.files("notebooks", "data", "tests")
    for name, message in [("09-a", r"09-a\.ipynb"), ("10-a", r"\ba\.py"), ("09-b", r"\b09-a\b")]:
        with pytest.raises(InputError, match=message):
            new_result("isolation", name)
    assert toy.files("notebooks", "data", "tests") == before


def test_a_floor_of_mixed_units_is_proposed_whole_and_an_unknown_unit_is_not(tmp_path):
    rows = np.random.default_rng(4).standard_normal((4, 10_000)) * 1e-3
    table = np.column_stack([np.arange(10_000) / 500, rows.T * [1, 1, 1e3, 0.1]])
    head = "time (s),tilt (gon),x (m/s^2),y (mm/s^2),z (g)"
    np.savetxt(tmp_path / "mixed.csv", table, delimiter=",", header=head, comments="")
    report = inspect_file(str(tmp_path / "mixed.csv"))
    assert "unknown units: gon; convert tilt (gon)" in report and "UNIT" not in report
    settings = commands(report)["isolation/08-your-floor"]
    assert "floor_unit" not in settings and settings["floor_channels"] == ["x (m/s^2)", "y (mm/s^2)", "z (g)"]
    [line] = [each for each in report.splitlines() if each.startswith("a feedforward")]
    words = shlex.split(line)
    assert "--unit" not in words and [w for w in words if w.startswith("--channel")] == [
        "--channel=x (m/s^2)", "--channel=y (mm/s^2)", "--channel=z (g)"
    ]  # fmt: skip
