"""The commands for one's own data and one's own result."""

import json
import os
import re
import shlex
import subprocess
from importlib.metadata import EntryPoint

import numpy as np
import pytest

from shared.universal_files import function, write_universal
from stillwork.__main__ import main
from stillwork.base import command_line
from stillwork.machine import inspect as inspecting
from stillwork.machine.inspect import inspect_file
from workbook import paths
from workbook.checks import InputError
from workbook.claims import load_entries
from workbook.notebooks import read_notebook
from workbook.site.mathematics import markdown
from workbook.site.metadata import papers
from workbook.site.scaffold import new_result

SLAB = paths.data("isolation", "slab_footfall/slab_vertical.csv")


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


@pytest.mark.slow
def test_a_record_gets_the_command_that_uses_it():
    report = inspect_file(str(SLAB))
    assert "a record of 1 channel: 425.077 Hz, 30 s" in report
    wanted = f"isolation/08-your-floor -p {shlex.quote(f'floor_record={SLAB}')} -p 'floor_unit=m/s^2'"
    assert f"for isolation/08-your-floor: python -m stillwork figures {wanted}" in report
    assert commands(report) == {"isolation/08-your-floor": {"floor_record": str(SLAB), "floor_unit": "m/s^2"}}


def test_the_numbers_of_a_column_are_those_of_the_file(tmp_path):
    file = tmp_path / "two.csv"
    samples = np.arange(300)
    rows = "\n".join(f"{i / 10},{i % 7},{i % 3 - 1}" for i in samples)
    file.write_text(f"time,a,b\n{rows}\n")
    report = inspect_file(str(file))
    assert f"300 values from 0 to 6, mean {np.mean(samples % 7):.4g}" in report
    assert "a record of 2 channels: 10 Hz, 30 s" in report
    assert "one of these: m/s^2, m/s, m, N" in report
    found = commands(report)
    assert found["isolation/08-your-floor"]["floor_channels"] == ["a", "b"]
    assert found["worstcase/07-your-record"]["output_channel"] == "b"
    assert found["fixedpoint/09-your-plant"]["trajectory_channel"] == "a"


def hostile_names():
    """Names that a shell, a terminal or the reader of ``-p`` could take for something else."""
    names = ["$(touch X)", "`touch X`", "$HOME", "; touch X", "> X", "'; touch X; '", '"; touch X; "', "a'b"]
    names += ["\\", "a\\nb", "$'\\n'", "-p seed=3", "a=b", "~", "*", "{a,b}", "!!", "# a"]
    names += [" a", "a,", "-3", "none"]
    names += ["['a']", "UNIT", "'a'", "0x10", "µ² (m)", "加速度", "\u202e", "\xa0"]
    names += ["a\nb", "a\ttab", "a\x1b[2Jb", "a\x07", "a\u2028b", "a\x85b", "a\nfor x: touch X"]
    random = np.random.default_rng(11)
    signs = [*"abAB01 \t\n'\"`$\\(){}[]<>|&;*?~!#%^=,.:+-_@éß加", "touch X"]
    while len(names) < 200:
        names.append("".join(random.choice(signs) for _ in range(random.integers(2, 9))))
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


def test_an_error_is_one_line_whatever_the_file_is_called(tmp_path, capsys):
    for name in (b"a\nfor x: y.csv", b"a\x1b[2J.csv", b"\xff.csv"):
        assert main(["inspect", os.fsdecode(os.fsencode(tmp_path) + b"/" + name)]) == 2
        said = capsys.readouterr().err
        assert said.endswith("\n") and said[:-1].isprintable() and "no such file" in said


def test_what_a_command_prints_steers_no_terminal(monkeypatch, capsys):
    monkeypatch.setattr(inspecting, "inspect_file", lambda file: "one \x1b[2J\ntwo")
    main(["inspect", "a.csv"])
    assert capsys.readouterr().out == "one \\x1b[2J\ntwo\n"


def test_an_input_output_record_in_volts_is_for_the_topic_that_takes_it():
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


@pytest.mark.parametrize(
    ("column", "unit"),
    [
        ("ground_m_rthz", "m/sqrt(Hz)"),
        ("floor_nm_s_rthz", "nm/s/sqrt(Hz)"),
        ("floor_um_s2_2_hz", "(um/s^2)^2/Hz"),
        ("floor ((m/s)^2/Hz)", "(m/s)^2/Hz"),
        ("floor", "UNIT"),
    ],
)
def test_spectra_are_recognised_as_spectra(tmp_path, column, unit):
    hertz = np.arange(1.0, 100.0)
    np.savez(tmp_path / "a.npz", **{"f_hz": hertz, column: 1 / hertz})
    report = inspect_file(str(tmp_path / "a.npz"))
    assert commands(report) == {
        "isolation/08-your-floor": {"floor_record": str(tmp_path / "a.npz"), "floor_unit": unit}
    }
    assert f"spectra over 99 frequencies up to 99 Hz: {column}" in report and "not a" not in report
    assert ("replace UNIT by one of these" in report) == (unit == "UNIT")


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
    assert "acceleration" in inspect_file(str(tmp_path / "a.py"))
    oscillator = paths.data("fixedpoint", "oscillator.toml")
    assert commands(inspect_file(str(oscillator))) == {"fixedpoint/09-your-plant": {"plant": str(oscillator)}}
    motion = paths.data("fixedpoint", "your_trajectory.csv")
    assert commands(inspect_file(str(motion)))["fixedpoint/09-your-plant"]["trajectory_unit"] == "mm"


@pytest.mark.filterwarnings("error")
def test_what_is_wrong_with_a_record_is_said(tmp_path):
    file = tmp_path / "gap.csv"
    file.write_text("time,a\n" + "\n".join(f"{i + (i > 150)},1" for i in range(300)))
    assert "gap.csv: 1 gap(s)" in inspect_file(str(file))
    assert "stillwork figures" not in inspect_file(str(file))
    file.write_text("time,a\n0,1\n1,\n2,nan\n")
    assert "2 missing or infinite" in inspect_file(str(file))
    file.write_text("time,a\n0,1,,\n1,2,,\n2,3,,\n")
    assert "3 values from 1 to 3" in inspect_file(str(file))
    file.write_text("time,a\n0,1e308\n1,-1e308\n2,1e308\n")
    assert "mean 3.333e+307, standard deviation 9.428e+307" in inspect_file(str(file))


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


@pytest.mark.parametrize(
    "words",
    [
        *(
            "inspect ''",
            "report ''",
            "design '' --rate 5000 --out x",
            "export '' --out x",
            "claims --entry ''",
        ),
        *("export a.json --out ''", "choices --scheduler ''", "contest --out ''"),
    ],
)
def test_an_empty_name_is_refused_with_its_argument(words, capsys):
    with pytest.raises(SystemExit):
        main(shlex.split(words))
    assert re.search(r"error: argument \S+: '' names nothing", capsys.readouterr().err)


def test_commands_of_others_are_those_of_the_entry_points_or_of_what_stands_beside(monkeypatch):
    named = [EntryPoint("mine", "workbook.lock", "stillwork.commands")]
    monkeypatch.setattr(command_line, "entry_points", lambda group: named)
    assert [each.__name__ for each in command_line.others()] == ["workbook.lock"]
    named.clear()
    assert [each.__name__ for each in command_line.others()] == ["workbook.__main__"]


@pytest.mark.slow
def test_a_new_result_has_a_notebook_a_module_a_test_and_an_entry(toy):
    before = toy.files("data/isolation")["data/isolation/published.toml"]
    written = new_result("isolation", "09-heavy-payload")
    assert written == [
        "notebooks/isolation/09-heavy-payload.ipynb",
        "notebooks/isolation/heavy_payload.py",
        "tests/isolation/test_heavy_payload.py",
        "data/isolation/published.toml",
    ]
    assert toy.files("data/isolation")["data/isolation/published.toml"].startswith(before)
    assert "isolation.heavy-payload.deviation" in load_entries("isolation")
    assert read_notebook("isolation/09-heavy-payload").parameters["divisor"].value == "n - 1"
    notebook = toy.root / "notebooks/isolation/09-heavy-payload.ipynb"
    words = [cell for cell in json.loads(notebook.read_text())["cells"] if cell["cell_type"] == "markdown"]
    assert any('<math display="block"' in markdown("".join(cell["source"])) for cell in words)


@pytest.mark.parametrize(
    ("topic", "name", "message"),
    [
        ("isolaton", "09-a", r"\btopic\b.*'isolation'"),
        ("isolation", "payload", r"^name\b"),
        ("isolation", "../09-a", r"^name\b"),
        ("crane", "01-a", "--create"),
    ],
)
def test_a_new_result_needs_a_topic_and_a_name(toy, topic, name, message):
    with pytest.raises(InputError, match=message):
        new_result(topic, name)


def test_a_new_topic_has_a_ledger_and_a_paper_and_is_the_last(toy):
    before = paths.topics()
    written = new_result("crane", "01-sway", create=True)
    assert written[3:] == [f"data/crane/{name}.toml" for name in ("published", "paper", "choices")]
    assert paths.topics() == ("crane", *before)  # by name: none of them says its order
    toy.write("data/motion/paper.toml", "order = 1")
    assert paths.topics() == ("motion", "crane", "isolation")
    assert list(load_entries("crane")) == ["crane.sway.deviation"]
    paper = papers()["crane"]
    assert (paper["title"], paper["headline"], paper["source"]) == ("Crane", [], "")


@pytest.mark.parametrize("topic", ["isolation", "Crane", "a-b", "../a", "class", ""])
def test_a_topic_is_created_once_and_is_a_name_of_python(toy, topic):
    before = toy.files("notebooks", "data", "tests")
    with pytest.raises(InputError, match="topic"):
        new_result(topic, "09-a", create=True)
    assert toy.files("notebooks", "data", "tests") == before


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
