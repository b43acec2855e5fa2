"""Records: every format gives the same numbers, every defect its own error, resampling its stated quality."""

import io
import pickle
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from stillwork.base.checks import InputError
from stillwork.signals.densities import read_densities
from stillwork.signals.records import (
    Record,
    load_record,
    resample,
    sample_rate_of,
    to_acceleration,
)

RATE = 500.0
SAMPLES = 1000
TIME = np.arange(SAMPLES) / RATE
SIGNALS = np.random.default_rng(0).standard_normal((2, SAMPLES))


def write_csv(path, columns, names):
    rows = [",".join(names), *(",".join(map(repr, row)) for row in np.column_stack(columns).tolist())]
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.slow
def test_npz_and_mat_agree_with_csv(tmp_path):
    np.savez(tmp_path / "a.npz", acceleration=SIGNALS, fs_hz=RATE, note="text is left out")
    savemat(tmp_path / "a.mat", {"run": {"acceleration": SIGNALS.T, "fs": RATE}})
    npz = load_record(tmp_path / "a.npz", "m/s^2")
    mat = load_record(tmp_path / "a.mat", "m/s^2")
    assert npz.names == ("acceleration 1", "acceleration 2")
    assert mat.names == ("run.acceleration 1", "run.acceleration 2")
    for record in (npz, mat):
        assert record.sample_rate == RATE
        assert np.array_equal(record.signals, SIGNALS)


# ---------------------------------------------------------------------------------------------- bad records


def defect(name, time=TIME, signals=SIGNALS):
    time, signals = time.copy(), signals.copy()
    match name:
        case "gap":
            time[400:] += 0.5
        case "backwards":
            time[300] = time[10]
        case "uneven":
            time += np.random.default_rng(1).uniform(-0.15, 0.15, len(time)) / RATE
        case "drifting":
            time = TIME + 0.02 * TIME**2
        case "milliseconds":
            time *= 1000
        case "microseconds as seconds":
            time *= 1e-6
        case "short":
            time, signals = time[:100], signals[:, :100]
    return [time, *signals]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("gap", r"0\.502 s.*t = 0\.798 s"),
        ("backwards", r"\btime\b.*row 300\b"),
        ("uneven", r"\btime\b.*t = 0\.6\d* s"),
        ("drifting", r"\btime\b.*t = 2\.0\d* s"),
        ("milliseconds", r"0\.5 Hz"),
        ("microseconds as seconds", r"5e\+08 Hz"),
        ("short", r"\b100\b.*\b256\b"),
    ],
)
def test_defects_are_named_with_the_way_out(tmp_path, name, message):
    path = write_csv(tmp_path / "bad.csv", defect(name), ["time", "left", "right"])
    with pytest.raises(InputError, match=message):
        load_record(path, "m/s^2")


@pytest.mark.parametrize(
    ("lost", "message"), [({5}, r"right\b.* 1 .*\brow 6\b"), (range(SAMPLES), r"right\b.*\b1000\b")]
)
def test_missing_values_in_a_csv_are_found_and_no_empty_channel_dropped(tmp_path, lost, message):
    rows = [
        f"{t},{a},{'' if n in lost else b}" for n, (t, a, b) in enumerate(zip(TIME, *SIGNALS, strict=True))
    ]
    (tmp_path / "a.csv").write_text("time,left,right\n" + "\n".join(rows))
    with pytest.raises(InputError, match=f"channel {message}"):
        load_record(tmp_path / "a.csv", "m/s^2")


class Bomb:
    def __reduce__(self):
        return (exec, ("raise SystemExit('executed')",))


def test_reading_executes_nothing(tmp_path):
    np.savez(tmp_path / "a.npz", a=np.array([Bomb()], dtype=object), fs=RATE)
    (tmp_path / "b.npz").write_bytes(pickle.dumps(Bomb()))
    for name in ("a.npz", "b.npz"):
        with pytest.raises(InputError, match=rf"^{name}\b"):
            load_record(tmp_path / name, "m/s^2")


def archive(path, members, compression=zipfile.ZIP_DEFLATED, said=None):
    """An archive of these members, each of which is `said` to unpack to so many bytes."""
    path.parent.mkdir(exist_ok=True)
    with zipfile.ZipFile(path, "w", compression) as file:
        for name, content in members:
            file.writestr(name, content)
        for each in file.infolist():
            each.file_size = each.file_size if said is None else said
    return path


def npy(array):
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("members", "options", "message"),
    [
        ([("a.npy", npy(SIGNALS)), ("read.me", b"notes")], {}, r"'read\.me'"),
        ([("a.npy", npy(np.zeros(10**6)))], {"said": 2**33}, r"8\.6e[+]09.*0\.5 GB"),
        ([("a.npy", npy(np.zeros(10**6)))] * 2, {"compression": zipfile.ZIP_BZIP2}, r"'a\.npy'"),
        ([(f"{n}.npy", b"") for n in range(10_001)], {}, r"\b10001\b.*\b10000\b"),
        ([("a.npy", npy(SIGNALS).replace(b"(2, 1000), }   ", b"(2, 10000000),}"))], {}, r"^a\.npz\b"),
        ([], {}, r"^a\.npz\b.*channel"),
    ],
)
@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_an_archive_that_is_no_file_of_arrays_is_refused(tmp_path, members, options, message):
    """Before it fills the memory: an archive of a few kB may unpack to any size."""
    path = archive(tmp_path / "a.npz", members, **options)
    with pytest.raises(InputError, match=message) as refusal:
        load_record(path, "m/s^2", sample_rate=RATE)
    assert "\n" not in str(refusal.value)


@settings(max_examples=60, deadline=None)
@given(content=st.binary(max_size=400), suffix=st.sampled_from([".csv", ".npz", ".uff"]))
def test_any_bytes_give_our_error(tmp_path_factory, content, suffix):
    path = tmp_path_factory.mktemp("fuzz") / f"a{suffix}"
    path.write_bytes(content)
    with pytest.raises(InputError):
        load_record(path, "m/s^2", sample_rate=RATE)


@pytest.mark.slow
@pytest.mark.filterwarnings("error")  # our message, not a warning of pandas before it
@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.csv", "", r"^a\.csv\b.*empty"),
        ("a.csv", "time,left\n", r"^a\.csv\b.*\bnames\b"),
        ("a.csv", "time,x\n0,1\n0.1,oops\n", r"column x: 'oops'.*row 2\b"),
        ("a.csv", "time,x\n2024-01-31T10:00:00.5,1\n", r"column time\b.*\brow 1\b"),
        ("a.csv", "time,x\n1.2.3,1\n", r"column time: '1\.2\.3'"),
        ("a.csv", "time,x\n0,1\n0.1,1,2,3\n", r"row 2 .*\b4\b.*\b2\b"),
        ("a.tsv", "\r,", r"^a\.tsv\b"),
        ("a.xlsx", "", r"\bfiles\b"),
        ("a.mat", "not a mat file" * 20, r"^a\.mat\b.*-v7"),
    ],
)
def test_files_that_are_no_records(tmp_path, name, content, message):
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=message):
        load_record(tmp_path / name, "m/s^2", sample_rate=RATE)


def test_printed_times_of_a_real_logger_are_even_enough():
    period = 2.3525e-3
    drift = 0.15 * period * np.sin(np.arange(20_000) / 5000)
    assert sample_rate_of(np.round(np.arange(20_000) * period + drift, 6)) == pytest.approx(
        1 / period, rel=1e-4
    )


# ----------------------------------------------------------------------------------------------- resampling


def sine(frequency, rate, seconds=4.0):
    t = np.arange(int(seconds * rate)) / rate
    return Record(np.sin(2 * np.pi * frequency * t)[None], rate, "m/s^2", ("x",), "sine")


def middle(record):
    """Samples away from the ends, where the filter sees the record's edges."""
    edge = int(0.5 * record.sample_rate)
    return record.signals[0, edge:-edge]


RATES = [
    *[(425.08, 5000.0), (25_600.0, 5000.0), (1000.3, 1000.0), (1000.0, 1000.3), (44_100.0, 48_000.0)],
    *[(1000.0, 100 * np.pi), (512.0, 513.0), (1000.0, 1000.0 + 1e-6)],
]


@pytest.mark.parametrize(("old", "new"), RATES)
@pytest.mark.parametrize("share", [0.02, 0.3, 0.79])
def test_passband_is_kept_to_a_tenth_of_a_per_cent_without_delay(old, new, share):
    frequency = share * min(old, new) / 2
    moved = resample(sine(frequency, old), new)
    t = np.arange(moved.signals.shape[1]) / new
    edge = int(0.5 * new)
    error = np.abs(moved.signals[0] - np.sin(2 * np.pi * frequency * t))[edge:-edge].max()
    samples = np.floor(4 * old)
    assert error < 4e-4 and len(t) == np.ceil(samples * new / old - 1e-4)
    assert (
        (samples - 1) / old - 1 / new < t[-1] < samples / old
    )  # behind the last sample by less than its period


@pytest.mark.parametrize(("old", "new"), [pair for pair in RATES if pair[0] > pair[1]])
@pytest.mark.parametrize("share", [1.0001, 1.3, 1.9, 2.0, 3.1])
def test_aliases_are_80_db_down(old, new, share):
    frequency = share * new / 2
    if frequency < old / 2:
        assert np.abs(middle(resample(sine(frequency, old), new))).max() < 1e-4


@pytest.mark.parametrize(("old", "new"), [pair for pair in RATES if pair[0] < pair[1]])
def test_images_are_80_db_down(old, new):
    moved = middle(resample(sine(0.7 * old / 2, old), new))
    spectrum = np.abs(np.fft.rfft(moved * np.kaiser(len(moved), 20.0)))
    f = np.fft.rfftfreq(len(moved), 1 / new)
    assert spectrum[f > old / 2].max() < 1e-4 * spectrum.max()


@pytest.mark.parametrize(("unit", "order"), [("m/s^2", 0), ("m/s", 1), ("m", 2)])
@pytest.mark.parametrize("frequency", [3.0, 220.0])
def test_acceleration_of_a_sine(unit, order, frequency):
    base = sine(frequency, RATE)
    moved = to_acceleration(Record(base.signals, RATE, unit, ("x",), "sine"))
    omega = 2 * np.pi * frequency
    t = np.arange(base.signals.shape[1]) / RATE
    expected = omega**order * np.sin(omega * t + order * np.pi / 2)
    error = np.abs(moved.signals[0] - expected)[500:-500].max() / omega**order
    # The line taken off and the fading leave a little of a dozen periods.
    assert moved.unit == "m/s^2" and error < (1e-12 if order == 0 else 5e-3)


def test_a_channel_that_never_moves_is_refused(tmp_path):
    rows = "\n".join(f"{n / 100},{n % 7},9.81" for n in range(400))
    file = tmp_path / "floor.csv"
    file.write_text(f"time,a,stuck\n{rows}\n")
    with pytest.raises(InputError, match=r"channel stuck\b"):
        load_record(file, "m/s^2")
    assert load_record(file, "m/s^2", channels=["a"]).names == ("a",)


def test_a_unit_in_the_header_is_obeyed(tmp_path):
    for unit, factor in (("mm/s^2", 1e-3), ("cm/s^2", 0.01), ("Gal", 0.01), ("g", 9.80665), ("m/s²", 1.0)):
        file = write_csv(tmp_path / "floor.csv", [TIME, *SIGNALS], ["time (s)", f"a ({unit})", f"b [{unit}]"])
        for asked in ("", unit):
            record = load_record(file, asked)
            assert record.unit == "m/s^2" and record.signals == pytest.approx(factor * SIGNALS)
        with pytest.raises(InputError, match=r"^unit\b.*'m/s'"):
            load_record(file, "m/s")


def test_a_unit_is_asked_for_where_the_header_has_none_and_channels_of_one_quantity_are_taken(tmp_path):
    file = write_csv(tmp_path / "a.csv", [TIME, *SIGNALS], ["time", "left", "right (mV)"])
    with pytest.raises(InputError, match=r"^unit\b.*left"):
        load_record(file)
    assert load_record(file, "mV").signals == pytest.approx(1e-3 * SIGNALS)
    assert load_record(file, channels=["right (mV)"]).unit == "V"
    write_csv(file, [TIME, *SIGNALS], ["time", "left (m/s)", "right (mV)"])
    with pytest.raises(InputError, match=r"\bchannels\b"):
        load_record(file)


def test_a_unit_in_the_header_of_spectra_is_obeyed(tmp_path):
    hertz, asd = np.array([1.0, 10.0, 100.0]), np.array([2.0, 1.0, 3.0])
    np.savez(tmp_path / "a.npz", **{"frequency": hertz, "x (mm/s^2/sqrt(Hz))": asd, "y ((m/s)^2/Hz)": asd})
    f, found = read_densities(tmp_path / "a.npz", "", [], 3)
    assert np.array_equal(f, hertz)
    assert found == pytest.approx(np.array([1e-6 * asd**2, asd * (2 * np.pi * hertz) ** 2]))
    with pytest.raises(InputError, match=r"^unit\b.*g\^2/Hz"):
        read_densities(tmp_path / "a.npz", "g^2/Hz", [], 3)
    np.savez(tmp_path / "b.npz", frequency=hertz, x=asd)
    with pytest.raises(InputError, match=r"^unit\b.*'x'"):
        read_densities(tmp_path / "b.npz", "", [], 3)
    assert read_densities(tmp_path / "b.npz", "g^2/Hz", [], 3)[1][0] == pytest.approx(9.80665**2 * asd)
