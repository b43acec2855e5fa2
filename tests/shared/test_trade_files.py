"""Files of the trade's programs: one frequency response or record comes back out of each as it went in, or is refused."""

import control
import h5py
import numpy as np
import pytest
from nptdms import ChannelObject, GroupObject, TdmsWriter
from scipy.io import savemat

from shared.universal_files import function, write_universal
from stillwork.base.checks import InputError
from stillwork.identification.machine_files import load_machine
from stillwork.machine.inspect import inspect_file
from stillwork.signals.datafiles import read_arrays
from stillwork.signals.records import load_record

TURN = 2 * np.pi
HZ = np.arange(10.0, 110.0)
ACCELERANCE = 0.125 - 0.4 * HZ**2 / (60.0**2 - HZ**2 + 1j * HZ)  # 1/kg
COMPLIANCE = -ACCELERANCE / (TURN * HZ) ** 2  # m/N
PARTS = np.array(
    list(zip(ACCELERANCE.real, ACCELERANCE.imag, strict=True)), dtype=[("real", float), ("imag", float)]
)
ROWS = np.random.default_rng(5).standard_normal((2, 500))


def hdf5(file, content):
    """An HDF5 file with these datasets; a pair is one with its unit."""
    with h5py.File(file, "w") as opened:
        for name, values in content.items():
            values, unit = values if isinstance(values, tuple) else (values, "")
            opened[name] = values
            if unit:
                opened[name].attrs["units"] = unit


def mat73(file, content):
    """A MAT file of version 7.3 as MATLAB writes it: 512 bytes that name it, columns first, structures as groups."""
    with h5py.File(file, "w", userblock_size=512) as opened:

        def put(group, name, value):
            if isinstance(value, dict):
                group.create_group(name).attrs["MATLAB_class"] = np.bytes_("struct")
                for member, each in value.items():
                    put(group[name], member, each)
            elif isinstance(value, list):  # a cell array: references to what stands apart
                places = []
                for each in value:
                    place = f"#refs#/{len(opened.require_group('#refs#'))}"
                    put(opened, place, each)
                    places.append(opened[place].ref)
                group.create_dataset(name, data=np.array(places)[None], dtype=h5py.ref_dtype)
                group[name].attrs["MATLAB_class"] = np.bytes_("cell")
            elif isinstance(value, str):
                group[name] = np.array([[ord(letter)] for letter in value], dtype=np.uint16)
                group[name].attrs["MATLAB_class"] = np.bytes_("char")
            else:
                values = np.atleast_2d(value)
                if np.iscomplexobj(values):
                    values = np.rec.fromarrays([values.real, values.imag], names="real,imag")
                group[name] = values.T
                group[name].attrs["MATLAB_class"] = np.bytes_("double")

        for name, value in content.items():
            put(opened, name, value)
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    with file.open("r+b") as opened:
        opened.write(head)


def tdms(file, channels, group="Untitled"):
    """A TDMS file of channels: name to (values, properties)."""
    with TdmsWriter(file) as writer:
        writer.write_segment(
            [
                GroupObject(group),
                *(ChannelObject(group, name, *content) for name, content in channels.items()),
            ]
        )


def attributes(file):
    """As other writers state units: by a name with capitals, in an array of one text."""
    hdf5(file, {"freq": HZ, "mag": DECIBELS, "phase": ANGLE})
    with h5py.File(file, "r+") as opened:
        opened["mag"].attrs["Unit"] = "dB"
        opened["phase"].attrs["UNITS"] = np.array([b"rad"])


def savetxt(columns, **options):
    return lambda file: np.savetxt(file, np.column_stack(columns), **options)


def text(names, *columns):
    rows = "\n".join(",".join(f"{x:.15g}" for x in row) for row in zip(*columns, strict=True))
    return lambda file: file.write_text(f"{names}\n{rows}\n")


def saved_table(file):
    control.frd(ACCELERANCE, TURN * HZ).to_pandas().to_csv(file)


def saved_response(file):
    found = control.frd(ACCELERANCE, TURN * HZ)
    np.savez(file, omega=found.omega, frdata=found.frdata)


def universal(code, factors, data, kinds, **more):
    """A response beside a dataset of units: its system's code, how many units make 1 m and 1 N, and the kinds of its data."""
    system = {"type": 164, "units_code": code, "units_description": "by hand", "temp_mode": 1, "temp": 1.0}
    system |= {"temp_offset": 0.0, "length": factors[0], "force": factors[1]}
    axes = {"ordinate_spec_data_type": kinds[0], "orddenom_spec_data_type": kinds[1]}
    return lambda file: write_universal(file, [system, function("frf", HZ, data, **axes, **more)])


DECIBELS, ANGLE = 20 * np.log10(np.abs(ACCELERANCE)), np.angle(ACCELERANCE)
POLAR = [HZ, np.abs(ACCELERANCE), np.degrees(np.angle(ACCELERANCE))]
PAIR = [HZ, ACCELERANCE.real, ACCELERANCE.imag]
SHAPED = {"shapeit_data": {"w": TURN * HZ[:, None], "P": {"frf": ACCELERANCE[:, None], "name": "stage"}}}
WRITTEN = {
    "two.h5": lambda file: hdf5(file, {"f": HZ, "frf": ACCELERANCE}),
    "units.hdf5": lambda file: hdf5(file, {"m/w": (TURN * HZ, "rad/s"), "m/H": (1e6 * COMPLIANCE, "um/N"), "by": "me"}),
    "parts.h5": lambda file: hdf5(file, {"frequency": HZ, "H": PARTS}),
    "attributes.h5": attributes,
    "outputs.h5": lambda file: hdf5(file, {"freq": HZ, "H": ACCELERANCE[:, None, None]}),
    "structure.mat": lambda file: savemat(file, SHAPED),
    "array.mat": lambda file: savemat(file, {"s": np.array([SHAPED["shapeit_data"], {"note": "x"}], dtype=object)}),
    "new.mat": lambda file: mat73(file, {"freq": HZ, "H": ACCELERANCE}),
    "shaped.mat": lambda file: mat73(file, SHAPED),
    "cells.mat": lambda file: mat73(file, {"all": ["stage", HZ], "f": HZ, "H": ACCELERANCE}),
    "control.csv": saved_table,
    "control.npz": saved_response,
    "numpy.txt": savetxt(POLAR, header="Freq Mag Phase"),
    "numpy.csv": savetxt(POLAR, header="hammer 7\nFreq [Hz], Mag [m/s^2/N], Phase [deg]", delimiter=","),
    "two lines.txt": savetxt(PAIR, header="f Re Im\nHz m/s^2/N m/s^2/N", delimiter="\t"),
    "brackets.csv": text("Freq,Real H1(2,1),Imag H1(2,1)", *PAIR),
    "arguments.csv": text("Freq,Re(H1(2,1)),Im(H1(2,1))", *PAIR),
    "names alone.csv": text("freq_rad_s,mag_db,phase_rad", TURN * HZ, DECIBELS, ANGLE),
    "kilohertz.csv": text("frequency_khz,magnitude_dB,phase", HZ / 1000, DECIBELS, np.degrees(ANGLE)),
    "analyser.csv": text("Frequency(Hz),CH1 Amplitude(dB),CH1 Phase(Deg)", HZ, DECIBELS, np.degrees(ANGLE)),
    "compliance.csv": text("f [Hz],mag [um/N],phase [rad]", HZ, 1e6 * np.abs(COMPLIANCE), np.angle(COMPLIANCE)),
    "bare.csv": text("X-Axis,Real,Imag", *PAIR),
    "axis.csv": text("X-Axis Hz,Y-Axis Real,Y-Axis Imag", *PAIR),
    "millimetres.uff": universal(5, (1e3, 1e3), ACCELERANCE, (12, 13)),
    "newtons.uff": universal(10, (1e3, 1.0), 1e3 * COMPLIANCE, (8, 13)),
    "inches.uff": universal(7, (39.37007874, 0.22480894), ACCELERANCE * 39.37007874 / 0.22480894, (12, 13)),
    "labels.uff": universal(5, (1e3, 1e3), ACCELERANCE / 9.80665, (12, 13), unit="g", orddenom_axis_units_lab="N"),
    "one label.uff": universal(5, (1e3, 1e3), ACCELERANCE / 9806.65, (12, 13), unit="g"),
    "its own.uff": universal(9, (3.0, 7.0), 1e3 * ACCELERANCE, (12, 13), unit="mm/s^2/N"),
    "by kind.uff": universal(0, (0.0, 0.0), COMPLIANCE, (8, 13)),
    "angle.csv": text("f [Hz],|H| [um/N],phi [rad]", HZ, 1e6 * np.abs(COMPLIANCE), np.angle(COMPLIANCE)),
    "no channel.csv": lambda file: file.write_text(
        "AWG,C1,out\nData:\nFreq(Hz),CH2 Amplitude(dB),CH2 Phase(deg),CH3 note\n"
        + "".join(f"{x:.9g},{y:.9g},{z:.9g},--\n" for x, y, z in zip(HZ, DECIBELS, np.degrees(ANGLE), strict=True))
    ),
    "hertz.tdms": lambda file: tdms(
        file, {"H": (ACCELERANCE, {"wf_increment": 1.0, "wf_start_offset": 10.0, "wf_xunit_string": "Hz"})}
    ),
    "slashes.h5": lambda file: hdf5(file, {"frequency (Hz)": HZ, "h (m/s^2/N)": ACCELERANCE}),  # two groups for HDF5
    "waveform.tdms": lambda file: tdms(
        file, {"H": (ACCELERANCE, {"wf_increment": 1.0, "wf_start_offset": 10.0, "wf_xname": "Frequency", "wf_xunit_string": "Hz"})}
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITTEN)
def test_a_response_comes_back_in_si(tmp_path, name):
    WRITTEN[name](tmp_path / name)
    found = load_machine(tmp_path / name).accelerance
    assert found.omega == pytest.approx(TURN * HZ, rel=1e-6)
    assert np.abs(found.response / ACCELERANCE - 1).max() < 1e-6
    assert "frequency response of a machine" in inspect_file(str(tmp_path / name))


def test_a_waveform_of_labview_is_a_record(tmp_path):
    wave = {"wf_increment": 1 / 512, "wf_start_offset": 0.0}
    channels = {"left": (ROWS[0], wave | {"unit_string": "g"}), "right": (ROWS[1], wave)}
    tdms(tmp_path / "a.tdms", channels | {"note": (np.array(["x", "y"]), {})})
    found = load_record(tmp_path / "a.tdms", "g")
    assert found.names == ("left (g)", "right") and found.sample_rate == pytest.approx(512)
    assert found.signals == pytest.approx(9.80665 * ROWS)
    start = np.datetime64("2026-01-02T03:04:05")
    tdms(
        tmp_path / "b.tdms",
        {"Time": (start + np.arange(500) * np.timedelta64(10, "ms"), {}), "z": (ROWS[0], {})},
    )
    assert load_record(tmp_path / "b.tdms", "m").sample_rate == pytest.approx(100)


def test_one_of_several_columns_is_chosen_by_a_part_of_its_name(tmp_path):
    """As an oscilloscope lists it, with the drive beside the gain; and a number of another unit beside a response."""
    text("#,Frequency (Hz),Amplitude (Vpp),Gain (dB),Phase (deg)", HZ, HZ, HZ, DECIBELS, np.degrees(ANGLE))(
        tmp_path / "a.csv"
    )
    with pytest.raises(InputError, match=r"Vpp.*a part of the name"):
        load_machine(tmp_path / "a.csv")
    assert load_machine(tmp_path / "a.csv", response="Gain").accelerance.response == pytest.approx(
        ACCELERANCE
    )
    tdms(
        tmp_path / "a.tdms",
        {"f": (HZ, {}), "H": (ACCELERANCE, {}), "temp": (np.ones(1), {"unit_string": "degC"})},
    )
    assert load_machine(tmp_path / "a.tdms").accelerance.response == pytest.approx(ACCELERANCE)


def test_one_of_several_members_is_chosen_by_a_part_of_its_name(tmp_path):
    shaped = {"shapeit_data": SHAPED["shapeit_data"] | {"C": {"frf": 2 * ACCELERANCE[:, None]}}}
    savemat(tmp_path / "a.mat", shaped)
    with pytest.raises(InputError, match=r"2 responses \(.*P\.frf.*\); choose one as response") as refused:
        load_machine(tmp_path / "a.mat")
    assert "C.frf" in str(refused.value)
    assert load_machine(tmp_path / "a.mat", response="P.frf").accelerance.response == pytest.approx(
        ACCELERANCE
    )
    with pytest.raises(InputError, match="response"):
        load_machine(tmp_path / "a.mat", response="frf")


def test_a_trace_in_memory_is_a_response_beside_the_measured_one(tmp_path):
    names = [
        f"Trace 1{memory}: Gain: {part}"
        for memory in ("", " (Memory)")
        for part in ("Magnitude (dB)", "Phase (°)")
    ]
    columns = DECIBELS, np.degrees(ANGLE), DECIBELS + 20, np.degrees(ANGLE)
    text(",".join(["Frequency (Hz)", *names]), HZ, *columns)(tmp_path / "a.csv")
    with pytest.raises(InputError, match=r"several responses.*choose with a part of their names"):
        load_machine(tmp_path / "a.csv")
    for part, factor in (("Trace 1:", 1), ("Memory", 10)):
        found = load_machine(tmp_path / "a.csv", response=part).accelerance.response
        assert found == pytest.approx(factor * ACCELERANCE)


@pytest.mark.parametrize("unit", ["N/(m/s^2)", "N/m", "N/mm", "N/(m/s)", "kN/um"])
def test_an_apparent_mass_or_stiffness_is_refused_with_the_unit_of_its_inverse(tmp_path, unit):
    text(f"frequency (Hz),magnitude ({unit}),phase (deg)", HZ, 1 / np.abs(ACCELERANCE), -np.degrees(ANGLE))(
        tmp_path / "a.csv"
    )
    upper, lower = unit.replace("(", "").replace(")", "").split("/", 1)
    with pytest.raises(InputError, match="the inverse of a response; give 1 over its numbers") as refused:
        load_machine(tmp_path / "a.csv")
    assert str(refused.value).endswith(f"name them so: {lower}/{upper}")


def test_channels_of_one_name_are_told_apart_by_their_groups(tmp_path):
    with TdmsWriter(tmp_path / "a.tdms") as writer:
        for number, row in enumerate(ROWS, 1):
            writer.write_segment([ChannelObject(f"Hit {number}", "Force", row, {"unit_string": "N"})])
    assert list(read_arrays(tmp_path / "a.tdms")) == ["Hit_1.Force (N)", "Hit_2.Force (N)"]


REFUSED = {
    "commas.csv": (
        lambda file: file.write_text("f_Hz,re,im\n" + "1,5,2,25,3,5\n" * 40),
        "where commas are decimal marks, let semicolons",
    ),
    "words.h5": (lambda file: hdf5(file, {"m/by": "me"}), r"m\.by \(text\)\); save arrays of numbers"),
    "words.mat": (lambda file: mat73(file, {"s": {"by": "me"}}), r"s\.by \(text\)\); save it with -v7"),
    "words.tdms": (lambda file: tdms(file, {"note": (np.array(["x"]), {})}), r"Untitled\.note \(1 of "),
    "damaged.h5": (lambda file: file.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(200)), "cannot be read"),
    "damaged.tdms": (lambda file: file.write_bytes(b"no TDMS " * 20), "cannot be read as TDMS"),
    "grids.tdms": (
        lambda file: tdms(file, {"a": (ROWS[0], {"wf_increment": 0.1}), "b": (ROWS[1], {"wf_increment": 0.2})}),
        "different axes",
    ),
    "factors.uff": (universal(5, (1.0, 1.0), ACCELERANCE, (12, 13)), "unit system 5 .* do not belong together"),
    "no kind.uff": (universal(5, (1e3, 1e3), ACCELERANCE, (0, 13)), "without a label"),
    "unnamed.txt": (savetxt(POLAR, header="measured on monday"), r"column 1 \(100\).*not a frequency response"),
    "shapes.npz": (lambda file: np.savez(file, A=np.ones((2, 3)), b=1.0), r"A \(2 x 3\), b \(1\)"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_understood_names_what_the_file_holds(tmp_path, name):
    write, why = REFUSED[name]
    write(tmp_path / name)
    with pytest.raises(InputError, match=rf"^{name}\b.*{why}"):
        load_machine(tmp_path / name)


@pytest.mark.parametrize("package", ["h5py", "pymatreader"])
def test_a_missing_reader_is_named_with_the_extra_that_brings_it(tmp_path, monkeypatch, package):
    mat73(tmp_path / "new.mat", {"freq": HZ, "H": ACCELERANCE})
    (tmp_path / f"{package}.py").write_text(f"raise ModuleNotFoundError('none', name={package!r})")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(
        InputError, match=rf"^new\.mat: {package} is not installed; python -m pip install .*\[data\]"
    ):
        read_arrays(tmp_path / "new.mat")
