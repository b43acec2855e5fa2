"""Universal files: the numbers that pyuff wrote come back, names and units tell what they are, damage is said."""

import numpy as np
import pytest

from shared.universal_files import function, write_universal
from stillwork.base.checks import InputError
from stillwork.signals.datafiles import read_arrays
from stillwork.signals.records import load_record
from stillwork.signals.universal import read_universal

RATE = 512.0
TIME = np.arange(600) / RATE
ROWS = np.random.default_rng(3).standard_normal((2, 600))
HERTZ = 0.5 * np.arange(1, 41)
RESPONSE = (ROWS[0] + 1j * ROWS[1])[:40]


@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("spacing", [0, 1])
@pytest.mark.parametrize("kind", ["time", "frf"])
def test_every_layout_of_dataset_58_comes_back(tmp_path, binary, spacing, kind):
    x, data = (TIME, ROWS[0]) if kind == "time" else (HERTZ, RESPONSE)
    one = function(kind, x, data, binary=binary, abscissa_spacing=spacing)
    found = read_universal(write_universal(tmp_path / "a.uff", [one]))
    axis, name = found
    assert axis == {"time": "time (s)", "frf": "frequency (Hz)"}[kind]
    assert name == {"time": "acceleration 1+Z", "frf": "frf 1+Z"}[kind]
    assert found[axis] == pytest.approx(x, rel=1e-5)  # an axis is stored with six digits
    assert np.abs(found[name] - data).max() < 1e-9
    assert np.iscomplexobj(found[name]) == (kind == "frf")


def test_a_file_written_by_hand_after_the_form_of_dataset_58(tmp_path):
    """Single precision, ASCII, even spacing: 6E13.5, the last line not full; 80 columns of the header by hand."""
    values = [1.5, -2.25, 3.0, 4.0, 5.0, 6.0, -7.125, 0.0]
    lines = ["    -1", "    58", *["NONE"] * 5]
    lines += [
        f"{1:5d}{0:10d}{0:5d}{0:10d} {'NONE':<10}{7:10d}{-2:4d} {'NONE':<10}{0:10d}{0:4d}",
        f"{2:10d}{len(values):10d}{1:10d}{0:13.5E}{0.01:13.5E}{0:13.5E}",
    ]
    for code, label, unit in (
        (17, "Time", "s"),
        (13, "Force", "N"),
        (0, "NONE", "NONE"),
        (0, "NONE", "NONE"),
    ):
        lines.append(f"{code:10d}{0:5d}{0:5d}{0:5d} {label:<20} {unit:<20}")
    numbers = [f"{value:13.5E}" for value in values]
    lines += ["".join(numbers[:6]), "".join(numbers[6:]), "    -1"]
    (tmp_path / "a.unv").write_text("\n".join(lines) + "\n")
    found = read_arrays(tmp_path / "a.unv")
    assert list(found) == ["time (s)", "force 7-Y (N)"]
    assert found["force 7-Y (N)"].tolist() == values
    assert found["time (s)"] == pytest.approx(0.01 * np.arange(8), rel=1e-12)


def test_a_universal_file_is_a_record(tmp_path):
    channels = [function("time", TIME, row, node=n, unit="g") for n, row in enumerate(ROWS, 1)]
    file = write_universal(tmp_path / "a.uff", channels)
    with pytest.raises(InputError, match=r"^unit\b.*'mg'"):
        load_record(file, "mg")
    record = load_record(file)
    assert record.names == ("acceleration 1+Z (g)", "acceleration 2+Z (g)")
    assert record.sample_rate == pytest.approx(RATE, rel=1e-5)
    assert record.signals == pytest.approx(9.80665 * ROWS, abs=1e-6)


def test_names_tell_the_two_ends_and_never_collide(tmp_path):
    functions = [
        function("frf", HERTZ, RESPONSE, node=2, reference=1, unit="(m/s2)/N"),
        function("frf", HERTZ, 2 * RESPONSE, node=2, reference=1, unit="(m/s2)/N"),
        function("coherence", HERTZ, np.abs(RESPONSE), node=2, reference=1),
        function("frf", HERTZ, RESPONSE, node=0, rsp_ent_name="table", id1="x"),
    ]
    found = read_universal(write_universal(tmp_path / "a.uff", functions))
    assert list(found)[1:] == [
        "frf 2+Z/1+Z ((m/s2)/N)",
        "frf 2+Z/1+Z #2 ((m/s2)/N)",
        "coherence 2+Z/1+Z",
        "frf table",
    ]
