"""What `docs/your-rig.md` tells a reader to type works as it stands there; the long builds only as far as they parse."""

import re
import shlex

import numpy as np
import pytest

from shared.compiled import compiled
from stillwork.__main__ import main
from stillwork.control.digital import load_controller
from stillwork.identification.machine_files import load_machine
from stillwork.signals.records import load_record, load_unscaled
from workbook import paths

GUIDE = (paths.root() / "docs/your-rig.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```$", GUIDE, re.DOTALL | re.MULTILINE)
LINES = [line for language, block in BLOCKS if not language for line in block.splitlines()]
BUILDS = [line for line in LINES if line.startswith("make figures")]
INSPECTIONS = [line for line in LINES if line.startswith("python -m stillwork inspect")]
CODE = [line for line in LINES if line.startswith("python -m stillwork design")]
RETESTS = [line for line in LINES if line.startswith("python -m stillwork retest")]
REPORTS = [line for line in LINES if line.startswith("python -m stillwork report")]
SNIPPETS = [block for language, block in BLOCKS if language == "python"]
COPIES = dict(line.split()[:0:-1] for line in LINES if line.startswith("cp "))


# What the loop of the guide calls, and what it is called by.
MACHINE = """double read_position(void);
double read_velocity(void);
void drive_on(void);
void drive_off(void);
void write_force(double force);
void close_the_loop(void);
void move_to(double target);
void each_sample(void);
"""


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """The root as the reader's folder, with copies made elsewhere."""
    monkeypatch.chdir(paths.root())
    for copy, original in COPIES.items():
        (tmp_path / copy).write_text((paths.root() / original).read_text(encoding="utf-8"), encoding="utf-8")

    def found(line: str) -> str:
        for copy in COPIES:
            line = line.replace(f"$PWD/{copy}", copy).replace(copy, str(tmp_path / copy))
        return line.replace("$PWD", str(paths.root()))

    return found


@pytest.mark.slow
def test_the_report_is_written(checkout, tmp_path, capsys):
    words = shlex.split(REPORTS[0])[3:]
    assert main([*words[:-1], str(tmp_path / words[-1])]) == 0
    assert "12 kg" in capsys.readouterr().out
    page = (tmp_path / words[-1]).read_text(encoding="utf-8")
    assert page.count("<img") == 2 and "MC and AD" in page and "stopped by" in page


@pytest.mark.parametrize("line", BUILDS)
def test_builds_have_parameters_and_files_that_exist(line, checkout, capsys):
    [_, _, arguments] = shlex.split(checkout(line))
    words = shlex.split(arguments.removeprefix("ARGS="))
    assert main(["figures", *words, "--why"]) == 0
    assert words[0] in capsys.readouterr().out
    files = [text.partition("=")[2] for text in words if str(paths.root()) in text or "/my_" in text]
    assert files and all(paths.Path(file).is_file() for file in files)


@pytest.mark.slow
@pytest.mark.parametrize("line", INSPECTIONS)
def test_inspections_end_in_a_command(line, checkout, capsys):
    assert main(shlex.split(checkout(line))[3:]) == 0
    assert ": python -m stillwork figures " in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("line", CODE)
def test_a_design_writes_the_files_that_the_guide_names(line, checkout, tmp_path):
    """Without its box, whose search other tests hold; six decibels on what was measured, by the loop's equation."""
    words = [*shlex.split(line)[3:], "--uncertainty", "none"]
    words[words.index("--out") + 1] = str(tmp_path / "code")
    assert main(words) == 0
    told = set(re.findall(r"`((?:controller|controller_motion|report)\.\w+)`", GUIDE))
    assert told == {each.name for each in (tmp_path / "code").iterdir()}
    [snippet] = [block for language, block in BLOCKS if language == "c"]
    files = {
        file.name: file.read_text() for file in (tmp_path / "code").iterdir() if file.suffix in (".c", ".h")
    }
    assert all(f"{name}(" in "".join(files.values()) for name in re.findall(r"(controller_\w+)\(", GUIDE))
    body = re.sub(r"double (read_\w+)\(void\);", r"double \1(void) { return 0; }", MACHINE)
    body = re.sub(r"void (drive_\w+|write_force)\((.*)\);", r"void \1(\2) { }", body).replace(
        "double force", "double f"
    )
    compiled(
        {**files, "loop.c": MACHINE + snippet},
        tmp_path / "built",
        body.replace("(double f) {", "(double f) { (void)f;"),
    )
    controller = load_controller(tmp_path / "code" / "controller.json")
    measured = load_machine(words[1], "m/s^2", "N").accelerance
    inside = (measured.omega > 2 * np.pi * 300) & (measured.omega < 2 * np.pi * 2000)
    omega, accelerance = measured.omega[inside], measured.response[inside]  # counted against the force
    turn = 1j * omega / 20_000
    plant = accelerance / omega**2 * -np.expm1(-turn) / turn * np.exp(-turn)
    size = 1 / (1 + controller.linear.frequency_response(omega)[0, 0] * plant)
    assert 1.5 < np.abs(size).max() < 10 ** (6.01 / 20)
    [again] = [shlex.split(each)[3:] for each in RETESTS]
    again[1], again[-1] = str(tmp_path / "code" / "controller.json"), str(tmp_path / again[-1])
    assert main(again) == 0
    # Without its box the design goes to 6 dB, which leaves nothing for the scatter of five hits.
    assert "not decided: at this noise the promise may hold" in (tmp_path / "retest.html").read_text(
        encoding="utf-8"
    )


def test_the_table_of_a_controller_is_exported(tmp_path):
    [table] = [block for language, block in BLOCKS if language == "toml"]
    (tmp_path / "my.toml").write_text(table, encoding="utf-8")
    assert main(["export", str(tmp_path / "my.toml"), "--out", str(tmp_path / "my_code")]) == 0
    written = (tmp_path / "my_code" / "controller.c").read_text(encoding="utf-8")
    assert re.search(r"\{-10\.0\},\s+\{10\.0\},", written)
    assert load_controller(tmp_path / "my.toml").motion.limits.jerk == 100.0


@pytest.mark.slow
def test_the_snippet_writes_a_record_without_drift(tmp_path, monkeypatch):
    [snippet] = SNIPPETS
    monkeypatch.chdir(tmp_path)
    exec(snippet.replace('"data/', f'"{paths.root().as_posix()}/data/'), {})
    record = load_record(tmp_path / "without_drift.npz", "m/s^2")
    assert record.sample_rate == 3200 and record.duration == pytest.approx(20)
    slow = np.abs(np.fft.rfft(record.signals[0]))[:40]  # below 2 Hz
    original = load_record(paths.data("worstcase", "structure_accel_3k2/structure_accel_20s.npz"), "m/s^2")
    assert slow[1:].max() < 0.05 * np.abs(np.fft.rfft(original.signals[0]))[1:40].max()


def test_every_template_in_the_table_exists_and_loads():
    templates = set(re.findall(r"`(data/[^`]*)`", GUIDE.partition("## A floor")[0]))
    assert len(templates) == 8
    for name in templates:
        file = paths.root() / name
        if "your_machine" in name:
            load_machine(file)
        elif file.suffix == ".csv":
            load_unscaled(file)
        else:
            assert main(["inspect", str(file)]) == 0
