"""Files of a machine as they come from other people's programs: obeyed, or refused with what, where and what to do."""

import json
import os
import re

import numpy as np
import pytest

from motion.true_machines import TrueMachine
from stillwork.__main__ import main

TRUE = TrueMachine(mass=12.0, hertz=(180.0,), damping=(0.01,), position=(-0.5,))
HERTZ = np.geomspace(10, 800, 300)
RESPONSE = TRUE.response(HERTZ)
PARTS = "frequency (Hz),real (m/N),imag (m/N)"


def table(rows, head=PARTS, mark=",", end="\n"):
    return end.join([head, *(mark.join(str(each) for each in row) for row in rows)]) + end


ROWS = [(f"{f:.8g}", f"{z.real:.8g}", f"{z.imag:.8g}") for f, z in zip(HERTZ, RESPONSE, strict=True)]


def complex_rows(write):
    return table(
        [(row[0], write(z)) for row, z in zip(ROWS, RESPONSE, strict=True)], "frequency (Hz),h (m/N)"
    )


OBEYED = {
    "byte order mark": table(ROWS).encode("utf-8-sig"),
    "utf-16": table(ROWS).encode("utf-16"),
    "complex with spaces": complex_rows(
        lambda z: f"{z.real:.8g} {'+-'[int(z.imag < 0)]} {abs(z.imag):.8g}i"
    ).encode(),
    "negative frequencies, too": table(
        [(f"-{f}", re, f"{-float(im):.8g}") for f, re, im in ROWS[::-1]] + ROWS
    ).encode(),
}
GAP = [*ROWS[:50], (ROWS[50][0], "nan", ROWS[50][2]), *ROWS[51:]]
REFUSED = {
    "nan": (table(GAP), "1 NaN .* first at index .50.* remove or repair"),
    "word": (table([("10", "oops", "0"), *ROWS]), "column real .*'oops' in row 1"),
    "complex word": (
        table([("10", "1+j2"), ("20", "3i")], "frequency (Hz),h (m/N)"),
        "in row 1 is not a number",
    ),
    "empty": ("", "is empty; give a line of names"),
    "names alone": (PARTS + "\n", "no rows; give rows"),
    "five lines": (table(ROWS[:5]), "5 usable lines are too few.* at least 32"),
    "unsorted": (table(ROWS[::-1]), "does not rise from line to line; sort"),
    "no text": (bytes(range(1, 256)), "not text in UTF-8; save it"),
}


def run(capsys, *arguments):
    status = main([str(each) for each in arguments])
    shown = capsys.readouterr()
    return status, shown.err


@pytest.mark.slow
@pytest.mark.parametrize("kind", OBEYED)
def test_a_file_is_read_however_it_was_written(tmp_path, capsys, kind):
    file = tmp_path / "of a machine" / "my file.csv"
    file.parent.mkdir()
    file.write_bytes(OBEYED[kind])
    assert run(capsys, "desk", file, "--out", tmp_path / "machine.json")[0] == 0
    machine = json.loads((tmp_path / "machine.json").read_text(encoding="utf-8"))
    assert machine["mass"] == pytest.approx(12, rel=1e-4) and machine["units"]["position"] == "m"
    assert np.divide(machine["model"]["omega"][1:], 2 * np.pi) == pytest.approx([180], rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("kind", REFUSED)
def test_a_file_that_is_wrong_is_refused_and_nothing_written(tmp_path, capsys, kind):
    content, message = REFUSED[kind]
    file = tmp_path / "mine.csv"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    status, said = run(capsys, "design", file, "--rate", "8000", "--out", tmp_path / "out")
    assert status == 2 and "mine.csv" in said and os.listdir(tmp_path) == ["mine.csv"]
    assert re.search(message, " ".join(said.split()))
