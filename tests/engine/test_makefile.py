"""The commands of make: as they are documented, wherever they are called, and never in a half-made environment."""

import json
import os
import re
import shlex
import shutil
import stat
import subprocess
from pathlib import Path

import pytest

from workbook.pinned import FILE, pins

ROOT = Path(__file__).parents[2]

STUB = """\
#!/bin/sh
echo "$@" >> calls
for each; do printf '%s\\0' "$each"; done > last
case "$*" in
    "-m venv --clear .venv") rm -rf .venv && mkdir -p .venv/bin && cp stub .venv/bin/python && cp stub .venv/bin/ruff ;;
    *"-r environment.txt") test ! -e broken ;;
    -c*) test ! -e old ;;
esac
"""


@pytest.fixture
def checkout(tmp_path):
    """A folder with the Makefile and a Python that only notes how it was called; no path of it is a plain word."""
    root = tmp_path / "ein Ort für alle"
    root.mkdir()
    for name in ("Makefile", "environment.txt", "environment-tests.txt", "pyproject.toml"):
        shutil.copy(ROOT / name, root)
    (root / FILE.relative_to(ROOT)).parent.mkdir(parents=True)
    shutil.copy(FILE, root / FILE.relative_to(ROOT))
    stub = root / "stub"
    stub.write_text(STUB)
    stub.chmod(stub.stat().st_mode | stat.S_IEXEC)
    for name in ("python", "ruff"):
        (root / "own one" / "bin").mkdir(parents=True, exist_ok=True)
        shutil.copy(stub, root / "own one" / "bin" / name)
    return root


OWN = "ENVIRONMENT=own one"


def run(checkout, command, **around):
    """A process in the checkout; an outer make hands down nothing to it, nor does anything else."""
    around = {"PATH": os.environ["PATH"], "PWD": str(checkout)} | around
    return subprocess.run(command, cwd=checkout, env=around, capture_output=True, text=True)


def make(checkout, *arguments):
    return run(checkout, ["make", "PYTHON=./stub", *arguments])


def calls(checkout) -> list[str]:
    """Calls since the last look."""
    log = checkout / "calls"
    lines = log.read_text().splitlines() if log.exists() else []
    log.unlink(missing_ok=True)
    return [line for line in lines if not line.startswith("-c")]


MADE = ["-m venv --clear .venv", "pip install -r environment.txt", "pip install -e", "-m stillwork compile"]
ADDED = "pip install -r environment-tests.txt"


def short(lines: list[str]) -> list[str]:
    """Calls without pip's options."""
    kept = []
    for line in lines:
        if "pip install" in line:
            file = re.search(r"--require-hashes -r (\S+)", line)
            line = f"pip install -r {file[1]}" if file else "pip install -e"
        kept.append(line)
    return kept


def test_a_half_made_environment_is_made_again(checkout):
    (checkout / "broken").touch()
    assert make(checkout, "figures").returncode != 0
    assert short(calls(checkout)) == MADE[:2]
    (checkout / "broken").unlink()
    assert make(checkout, "figures").returncode == 0
    assert short(calls(checkout)) == [*MADE, "-m workbook figures"]


def test_another_pin_makes_the_environment_again(checkout):
    make(checkout, "figures")
    calls(checkout)
    later = (checkout / ".venv" / "complete").stat().st_mtime + 10
    os.utime(checkout / "pyproject.toml", (later, later))
    assert make(checkout, "figures").returncode == 0
    assert short(calls(checkout)) == ["-m workbook figures"]  # nothing that is installed comes from there
    os.utime(checkout / "environment.txt", (later, later))
    assert make(checkout, "figures").returncode == 0
    assert short(calls(checkout))[: len(MADE)] == MADE


def test_only_what_tests_adds_what_tests_need(checkout):
    make(checkout, "figures")
    assert ADDED not in short(calls(checkout))
    for _ in range(2):
        make(checkout, "course")
    assert short(calls(checkout)).count(ADDED) == 1


def test_another_python_is_refused(checkout):
    (checkout / "old").touch()
    done = make(checkout, "figures")
    assert done.returncode != 0
    assert "./stub is not a Python 3.11, 3.12, 3.13 or 3.14; name one: make PYTHON=" in done.stdout
    assert calls(checkout) == []


def documented() -> list[str]:
    """Each way of calling make that a text shows, as somebody types it."""
    found = []
    texts = [
        file.read_text("utf-8")
        for file in [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), ROOT / ".ci/run"]
        if file.name != "CHANGELOG.md"  # it names what is gone
    ]
    for file in sorted((ROOT / "notebooks").rglob("*.ipynb")):
        cells = json.loads(file.read_text("utf-8"))["cells"]
        texts += ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown"]
    for text in texts:
        found += re.findall(r"^make [a-z].*", text, re.MULTILINE) + re.findall(r"`(make [a-z][^`]*)`", text)
    head = "".join((ROOT / "Makefile").read_text(encoding="utf-8").splitlines()[:2])
    ways = re.findall(r"(make [A-Z]+=\S+) \.\.\.", head)
    found += [f"{way} {target}" for way in ways for target in ("figures", "test")]
    return sorted({line.partition("#")[0].strip() for line in found})


DOCUMENTED = documented()


@pytest.mark.parametrize("line", DOCUMENTED)
def test_what_is_documented_runs_as_it_is_typed(checkout, line):
    """By a shell, in a folder whose name has blanks; what `ARGS` says arrives in words as a shell parts them."""
    (checkout / "tools").mkdir()
    for name in ("python3", "python3.12"):
        shutil.copy(checkout / "stub", checkout / "tools" / name)
    asked = shlex.quote(f"{checkout}/own one") if "ENVIRONMENT" in line else None
    typed = line.replace("/path/to/it", asked) if asked else line
    done = run(checkout, ["sh", "-c", typed], PATH=f"{checkout}/tools:{os.environ['PATH']}")
    assert done.returncode == 0, done.stdout + done.stderr
    given = [word for word in shlex.split(line) if word.startswith("ARGS=")]
    for text in given:
        words = shlex.split(text.removeprefix("ARGS=").replace("$PWD", str(checkout)))
        assert (checkout / "last").read_text().split("\0")[-len(words) - 1 : -1] == words
    assert (checkout / ".venv" / "complete").exists() == (asked is None and not re.search("help|clean", line))


def test_the_tests_run_under_the_settings_of_a_build_and_on_the_days_examples(checkout):
    (checkout / "own one/bin/python").write_text(STUB + "env >> settings\n")
    assert make(checkout, OWN, "test", "EXAMPLES=new", "DAY=20260101").returncode == 0
    assert [line.partition(" ")[2] for line in calls(checkout) if "--hypothesis-seed=20260101" in line]
    settings = set((checkout / "settings").read_text().splitlines())
    assert {f"{name}={value}" for name, value in pins().items()} <= settings
    assert f"STILLWORK_OUTPUT={checkout}/build/nbval" in settings


PARTS = ["style", "types", "unit tests", "build", "notebooks", "what is committed"]


def test_a_test_run_ends_with_all_its_parts_whatever_became_of_them(checkout):
    for name in ("python", "ruff"):
        fails = f'case "{name} $*" in *pytest\\ tests\\ *) exit 1 ;; esac\n'
        (checkout / "own one" / "bin" / name).write_text(STUB + fails)
    done = make(checkout, OWN, "test")
    assert done.returncode
    rows = re.findall(r"^(\S.*?) +\d+ s  (passed|FAILED)$", done.stdout, re.MULTILINE)
    assert dict(rows) == dict.fromkeys(PARTS, "passed") | {"unit tests": "FAILED"}
