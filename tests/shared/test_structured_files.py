"""MAT files: what a damaged one does to its reader, it does not do to us."""

import io

import numpy as np
import pytest
from scipy.io import savemat

from stillwork.base.checks import InputError
from stillwork.signals import structured_files
from stillwork.signals.structured_files import read_structured

SIGNALS = np.random.default_rng(0).standard_normal((2, 300))
CONTENT = {
    "a": SIGNALS,
    "fs": 500.0,
    "counts": np.arange(5, dtype=np.int16),
    "response": SIGNALS[0] + 1j * SIGNALS[1],
    "run": {"sensor": {"left": SIGNALS[0]}, "note": "text", "cells": np.array([SIGNALS, "x"], dtype=object)},
}


def saved(**options) -> bytes:
    file = io.BytesIO()
    savemat(file, CONTENT, **options)
    return file.getvalue()


@pytest.fixture
def other_reader(tmp_path, monkeypatch):
    """Have the process find a `loadmat` with this body instead of scipy's; the path of a file for it."""

    def write(body: str):
        (tmp_path / "scipy").mkdir()
        (tmp_path / "scipy" / "__init__.py").touch()
        code = f"import os, signal, sys\ndef loadmat(path, simplify_cells):\n    {body}\n"
        (tmp_path / "scipy" / "io.py").write_text(code)
        (tmp_path / "hers.mat").touch()
        monkeypatch.syspath_prepend(tmp_path)
        return tmp_path / "hers.mat"

    return write


@pytest.mark.slow
def test_every_array_of_numbers_comes_back(tmp_path):
    (tmp_path / "-a b'.mat").write_bytes(saved(do_compression=True))
    found = read_structured(tmp_path / "-a b'.mat")
    assert list(found) == ["a", "fs", "counts", "response", "run.sensor.left", "run.cells_1"]
    for name in ("a", "counts", "response"):
        assert np.array_equal(found[name], CONTENT[name]) and found[name].dtype == CONTENT[name].dtype
    assert found["fs"] == 500.0 and found["fs"].shape == ()
    assert np.array_equal(found["run.sensor.left"], SIGNALS[0])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("body", "why"),
    [
        ("os.kill(os.getpid(), signal.SIGSEGV)", "SIGSEGV"),
        ("bytearray(64 << 30)", "4 GB"),
        ("sys.exit('gone')", "gone"),
        ("sys.exit(9)", r"\b9\b"),
        ("raise ValueError('Unknown mat file type')", "Unknown"),
    ],
)
def test_a_reader_that_dies_gives_our_error(other_reader, body, why):
    with pytest.raises(InputError, match=rf"^hers\.mat\b.*{why}"):
        read_structured(other_reader(body))


@pytest.mark.slow
def test_a_reader_that_does_not_end_is_ended(other_reader, monkeypatch):
    monkeypatch.setattr(structured_files, "MOST_SECONDS", 0.5)
    with pytest.raises(InputError, match=r"^hers\.mat\b.*0\.5 s\b"):
        read_structured(other_reader("while True: pass"))


@pytest.mark.slow
def test_damaged_bytes_give_arrays_or_our_error(tmp_path):
    """A process a file: only there a crash of the parser is seen, which would end the tests otherwise."""
    random = np.random.default_rng(7)
    whole = [saved(), saved(do_compression=True), saved()[:130] + random.bytes(1200), random.bytes(1200)]
    for number in range(8):
        damaged = bytearray(whole[number % 4])
        for at in random.integers(0, 1200, size=4):
            damaged[at] = random.choice([0, 127, 128, 255])
        path = tmp_path / f"{number}.mat"
        path.write_bytes(damaged)
        try:
            assert all(array.dtype.kind in "fiuc" for array in read_structured(path).values())
        except InputError as error:
            assert str(error).startswith(f"{number}.mat cannot be read (")
            assert str(error).endswith("save it with -v7, or export CSV or NPZ")
