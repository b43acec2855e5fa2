"""Damaged data files for every reader, and for ``stillwork inspect``."""

import io
import zipfile
from pathlib import Path

import numpy as np

from stillwork.design.inspect import inspect_file
from stillwork.identification import build_machine, load_machine
from stillwork.signals import load_record

UNIVERSAL = """    -1
    58
NONE
NONE
NONE
NONE
NONE
    4         0    1         0       NONE         1   3       NONE         1   3
         2         6         1  0.00000e+00  1.00000e-01  0.00000e+00
        18    0    0    0                 NONE                 Hz
        12    0    0    0                 NONE              m/s^2
        13    0    0    0                 NONE                  N
         0    0    0    0                 NONE                 NONE
  1.00000e+00  2.00000e+00  3.00000e+00  4.00000e+00  5.00000e+00  6.00000e+00
    -1
"""
SPOILS = (
    "",
    "nan",
    "inf",
    "1e400",
    "-",
    "x" * 5,
    '"',
    ",",
    ";",
    "\t",
    "#",
    "\x00",
    "é",
    "1,5",
    "9" * 400,
    "1 2",
    "\r",
    "=",
    "'",
)


def case(rng: np.random.Generator) -> tuple:
    """A file with a few spoiled places, for one of its readers."""
    maker = (_table, _table, _table, _arrays, _archive, _universal)[rng.integers(6)]
    name, content = maker(rng)
    readers = {
        "load_record": lambda: load_record(name, "m/s^2", sample_rate=100.0),
        "load_machine": lambda: load_machine(name),
        "build_machine": lambda: build_machine(
            load_machine(name), modes_hz=[], fit_hz=(0.0, 0.0), mirrored_sensor=False
        ),
        "inspect": lambda: inspect_file(name),
    }
    reader = list(readers)[rng.integers(4)]

    def call():
        Path(name).write_bytes(content)
        readers[reader]()

    return f"{reader} of {name}", [repr(content[:60])], False, call


def _damaged(rng, content: bytes) -> bytes:
    """A few bytes changed, left out or doubled."""
    data = bytearray(content)
    for _ in range(rng.integers(4)):
        if data:
            place = int(rng.integers(len(data)))
            action = rng.integers(3)
            if action == 0:
                data[place] = rng.integers(256)
            elif action == 1:
                del data[place : place + int(rng.integers(1, 40))]
            else:
                data[place:place] = data[place : place + int(rng.integers(1, 40))]
    return bytes(data)


def _table(rng):
    heads = (
        ["time (s)", "a (m/s^2)", "b (m)"], ["frequency (Hz)", "real", "imag"], ["frequency", "magnitude (dB)", "phase"],
        ["force 1", "force 2", "response 1", "response 2", "fs"], ["M 1", "M 2", "K 1", "K 2", "input", "output"], ["M", "K", "input"],
        ["a", "a", ""], ["frequency (foo)", "real", "imag", "coherence"],
    )  # fmt: skip
    head = list(heads[rng.integers(len(heads))])
    rows = int(rng.choice([0, 1, 2, 40, 300]))
    values = rng.standard_normal((rows, len(head)))
    if head[0].startswith(("time", "freq")):
        values[:, 0] = 1.0 + np.arange(rows) * 0.01
    if head[0].startswith("M"):
        values = np.abs(values[:2]) + np.eye(*values[:2].shape)
    lines = [[f"{each:.5g}" for each in row] for row in values]
    for _ in range(rng.integers(3)):
        target = lines[rng.integers(len(lines))] if lines and rng.random() < 0.7 else head
        target[rng.integers(len(target))] = SPOILS[rng.integers(len(SPOILS))]
    if rng.random() < 0.05:
        head[0] = f'"{"x" * 140_000}"'
    mark = (",", ";", "\t", " ")[rng.integers(4)]
    text = "\n".join(mark.join(row) for row in [head, *lines])
    return f"table{('.csv', '.txt', '.tsv')[rng.integers(3)]}", _damaged(rng, text.encode())


def _arrays(rng):
    names = (
        "M",
        "K",
        "D",
        "input",
        "output",
        "force",
        "response",
        "fs",
        "t",
        "frequency",
        "h",
        "coherence",
        "a",
    )
    shapes = ((), (1,), (2,), (2, 2), (300,), (2, 300), (40, 2, 2), (0,), (1, 1))
    arrays = {}
    for name in rng.choice(names, size=rng.integers(1, 6), replace=False):
        array = rng.standard_normal(shapes[rng.integers(len(shapes))])
        array = (
            array,
            np.abs(array),
            array + 1j,
            np.sort(array, axis=None),
            array.astype(np.float32),
            array * 1e300,
        )[rng.integers(6)]
        if rng.random() < 0.1 and array.size:
            array.flat[0] = np.nan
        arrays[str(name)] = array if rng.random() < 0.95 else np.array(["text"])
    file = io.BytesIO()
    np.savez(file, **arrays)
    content = file.getvalue()
    return "arrays.npz", _damaged(rng, content) if rng.random() < 0.3 else content


def _archive(rng):
    """Members that numpy would not write, and sizes that are not so."""
    contents = [np.arange(3.0), np.zeros(10**5), np.array([object()]), np.array(["text"]), np.zeros(0)]
    packed = io.BytesIO()
    names = (
        "a.npy",
        "../x.npy",
        "/x.npy",
        "x\ny.npy",
        "read.me",
        ".npy",
        "fs.npy",
        "t.npy",
        "\x1b[2J.npy",
        "n" * 3000,
    )
    ways = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)
    with zipfile.ZipFile(packed, "w", ways[rng.choice(4, p=[0.4, 0.4, 0.1, 0.1])]) as file:
        for number in range(int(rng.choice([0, 1, 2, 3, 11_000], p=[0.05, 0.35, 0.3, 0.28, 0.02]))):
            member = io.BytesIO()
            np.save(member, contents[rng.integers(5)], allow_pickle=True)
            content = member.getvalue() if number < 100 and rng.random() < 0.8 else b"no array"
            if rng.random() < 0.2:
                content = content.replace(b"(3,), }       ", b"(9999999999,)}")
            file.writestr(names[rng.integers(len(names))] if number < 100 else str(number), content)
        for each in file.infolist():
            if rng.random() < 0.1:
                each.file_size = int(rng.choice([0, 10, 2**31, 2**40]))
    return "archive.npz", packed.getvalue()


def _universal(rng):
    return ("functions.uff", "functions.unv")[rng.integers(2)], _damaged(
        rng, UNIVERSAL.encode() * int(rng.integers(1, 3))
    )
