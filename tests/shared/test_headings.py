"""Names of columns: what each states is read right or refused, in every file and on the desk's page alike."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from stillwork.base.checks import InputError
from stillwork.base.toml_files import read_toml
from stillwork.identification.machine_files import load_machine, load_ratio
from stillwork.machine.inspect import inspect_file
from stillwork.machine.report import report_file
from stillwork.signals.datafiles import read_arrays
from stillwork.signals.densities import read_densities
from stillwork.signals.headings import column_unit, heading
from stillwork.signals.records import load_record
from stillwork.signals.spectra import band_power

TURN, DEGREE, G = 2 * math.pi, math.pi / 180, 9.80665
LBF = 4.4482216152605  # N, exactly: a pound of 0.45359237 kg
REFUSED = None
# What one step of the column is: in Hz, s, rad, per one; of a magnitude ("dB", factor of the motion over the force) or the
# factor alone; of a channel the factor to SI and the SI unit. A second entry: refused.
DEFAULT = "default"  # no unit is stated: the documented one, which is reported
HEADERS = {
    # Bode 100, Siglent, Keysight, PicoScope, FRA4PicoScope
    "Trace 1: Gain: Magnitude (dB)": ("magnitude", ("dB", 1)),
    "Trace 2: Gain: Phase (°)": ("phase", DEGREE),
    "Trace 1 (Memory): Gain: Magnitude (dB)": ("magnitude", ("dB", 1)),
    "Trace 1 (Memory): Gain: Phase (°)": ("phase", DEGREE),
    "Trace 2: Gain: Phase (deg)": ("phase", DEGREE),
    "Trace 1: Gain: Real ": ("real", DEFAULT),
    "Frequency Log(Hz)": ("", 1),
    "Frequency log(Hz)": ("", 1),
    "Gain dB": ("magnitude", ("dB", 1)),
    "Phase degrees": ("phase", DEGREE),
    "Log Mag(dB)": ("magnitude", ("dB", 1)),
    "Lin Mag": ("magnitude", DEFAULT),
    # LMS and Siemens Test.Lab, B&K, SR785, Polytec, National Instruments, Zurich Instruments
    "Amplitude [(m/s^2)/N]": ("magnitude", 1),
    "FRF Magnitude [g/N]": ("magnitude", G),
    "Magnitude dB[m/s²/N]": ("magnitude", ("dB", 1)),
    "Magnitude [dB/1m (m/s²)/N]": REFUSED,
    "Coherence [-]": ("coherence", 1),
    "Coherence [%]": ("coherence", 0.01),
    "Mag (dBVpk)": REFUSED,
    "Velocity [mm/s]": ("velocity", (1e-3, "m/s")),
    "Frequency - Plot 0": REFUSED,
    "Amplitude - Voltage (dBV)": REFUSED,
    "chunk;timestamp (ticks)": REFUSED,
    "r (V)": ("", (1, "V")),
    "f (mN)": ("", (1e-3, "N")),
    # MATLAB, python-control, SciPy, ObsPy
    "freq_rad_s": ("frequency", 1 / TURN),
    "freqHz": ("frequency", 1),
    "magdB": ("", DEFAULT),
    "bode.mag": ("magnitude", DEFAULT),
    "bode.wout_rad_per_s": ("", (1, "rad/s")),
    "omega": ("frequency", 1 / TURN),
    "w": ("frequency", 1 / TURN),
    "frequency": ("frequency", DEFAULT),
    "Frequency [rad/sec]": ("frequency", 1 / TURN),
    "time (msec)": ("time", 1e-3),
    "sampling_rate": ("rate", DEFAULT),
    "fs_kHz": ("rate", 1000),
    "acc_z_counts": ("acceleration", (1, "count")),  # of a record; of a machine it is refused
    "Magnitude Acc/Force (g/N)": ("magnitude", G),
    "Acc/Force (g/N)": ("", (G, "m/s^2")),
    "Level (dBm)": REFUSED,
    "Gain [dB20]": REFUSED,
    "Gain (dB10)": REFUSED,
    "acc milli-g": ("acceleration", (G / 1000, "m/s^2")),
    "acc_micro_g": ("acceleration", (G / 1e6, "m/s^2")),
    "N/um": REFUSED,
    "Stiffness N / um": REFUSED,
    "Magnitude N/um": REFUSED,
    "Apparent mass magnitude": ("", DEFAULT),
    "Magnitude [dB ref 1 um/V]": ("magnitude", ("dB", 1e-6)),
    # French, Dutch
    "Fr\u00e9quence [kHz]": ("frequency", 1000),
    "Pulsation": ("frequency", 1 / TURN),
    "\u03c9": ("frequency", 1 / TURN),
    "freq in radians per second": ("frequency", 1 / TURN),
    "Magnitude (micrometers per volt)": ("magnitude", 1e-6),
    "Velocity (mm/s RMS)": REFUSED,
    # Excel in German
    "Betrag in dB": ("magnitude", ("dB", 1)),
    "Phase in Grad": ("phase", DEGREE),
    "Kraft in N": ("force", (1, "N")),
    "Beschleunigung / (m/s²)": ("acceleration", (1, "m/s^2")),
    "Weg in µm": ("position", (1e-6, "m")),
    "Kreisfrequenz": ("frequency", 1 / TURN),
    # Whatever else a table has
    "Frequency (MHz)": REFUSED,
    "Frequency (cycles/min)": REFUSED,
    "frequency_bins": ("", DEFAULT),
    "normalized frequency": ("", DEFAULT),
    "time (counts)": REFUSED,
    "time_ticks": REFUSED,
    "phase (gon)": REFUSED,
    "phase_turns": REFUSED,
    "Phase lag (deg)": ("", DEGREE),
    "mag x10^6 (m/N)": REFUSED,
    "magnitude (dB re 1e-6 m/N)": ("magnitude", ("dB", 1e-6)),
    "Magnitude dB (re 1 g/kN)": ("magnitude", ("dB", G / 1000)),
    "coherence_percent": ("coherence", 0.01),
    "sensor #1 (m/s^2)": ("", (1, "m/s^2")),
    "accel_m_s2": ("acceleration", (1, "m/s^2")),
    "torque_nm": REFUSED,
    "force_lbf": ("force", (LBF, "N")),
    # Abbreviations, plurals and dots
    "Acceleration (g's)": ("acceleration", (G, "m/s^2")),
    "Accel [gs]": ("acceleration", (G, "m/s^2")),
    "acc in g's": ("acceleration", (G, "m/s^2")),
    "Field (Gs)": REFUSED,
    "Acceleration (g pk)": REFUSED,
    "Time (Sec.)": ("time", 1),
    "Gain (dB.)": ("magnitude", ("dB", 1)),
    "Frequency (cycles/s)": ("frequency", 1),
    "Freq. [cycles/sec]": ("frequency", 1),
    "Frequency (CPS)": ("frequency", 1),
    "Frequency (c/s)": REFUSED,
    "Stimulus(Hz)": ("frequency", 1),
    "x-axis (second)": ("time", 1),
    "X-Axis Hz": ("frequency", 1),
    "x_axis_ms": ("time", 1e-3),
    "X-Axis": ("", DEFAULT),
    "Y-Axis Real": ("real", DEFAULT),
    "Real H(2,1)": ("real", DEFAULT),
    "Mag H [um/N]": ("magnitude", 1e-6),
    "Re(H1(2,1)) [um/N]": ("real", 1e-6),
    "H_{y[0], u[0]}": ("", DEFAULT),
    "X (ms)": ("time", 1e-3),
    "Group Delay (s)": ("", (1, "s")),
    # Inches, pounds, pressures, angles
    "Accel (in/s^2)": ("acceleration", (0.0254, "m/s^2")),
    "Accel (ft/s^2)": ("acceleration", (0.3048, "m/s^2")),
    "accel_in_s2": ("acceleration", (0.0254, "m/s^2")),
    "Velocity (ips)": ("velocity", (0.0254, "m/s")),
    "Vel. (in./s)": ("velocity", (0.0254, "m/s")),
    "Displacement (in)": ("position", (0.0254, "m")),
    "Displacement (mils)": ("position", (25.4e-6, "m")),
    "pos_in": REFUSED,  # inches, or an input
    "time_in_s": ("time", 1),
    "pos_in_m": ("position", (1, "m")),
    "force_in_N": ("force", (1, "N")),
    "v_in": ("", DEFAULT),
    "Hammer (lbf)": ("force", (LBF, "N")),
    "Force (kgf)": ("force", (G, "N")),
    "Force (dyn)": REFUSED,
    "Torque (in-lbf)": ("force", (0.0254 * LBF, "N m")),
    "Torque (oz-in)": ("force", (0.0254 * LBF / 16, "N m")),
    "Magnitude (g/lbf)": ("magnitude", G / LBF),
    "Magnitude (in/s^2/lbf)": ("magnitude", 0.0254 / LBF),
    "Amplitude (dB ref 1 g/lbf)": ("magnitude", ("dB", G / LBF)),
    "Mobility (in/s/lbf)": ("", (0.0254 / LBF, "m/s")),
    "Pressure (psi)": ("", (LBF / 0.0254**2, "Pa")),
    "Pressure [mbar]": ("", (100, "Pa")),
    "Temperature (degF)": REFUSED,
    "temp_degC": REFUSED,
    "speed_rpm": REFUSED,
    "theta (arcsec)": ("", DEGREE / 3600),
    "Acceleration (milligal)": ("acceleration", (1e-5, "m/s^2")),
    "EncPos (cnt)": ("", (1, "count")),
    # Signs, arguments, factors
    "-Phase (deg)": REFUSED,
    "Phase (-deg)": REFUSED,
    "Negative phase [deg]": REFUSED,
    "-Im{H} (m/N)": REFUSED,
    "-Gain (dB)": REFUSED,
    "-Z acceleration (g)": ("acceleration", (G, "m/s^2")),
    "Attenuation Magnitude (dB)": ("", ("dB", 1)),
    "|H(f)| [dB re 1 m/N]": ("magnitude", ("dB", 1)),
    "|G| [dB]": ("magnitude", ("dB", 1)),
    "\u2220H (deg)": ("phase", DEGREE),
    "arg(H) [deg]": ("phase", DEGREE),
    "Abs(x)[um/N]": ("magnitude", 1e-6),
    "Phi(x)[rad]": ("phase", 1),
    "20log10|H|": ("", DEFAULT),
    "Magnitude^2": REFUSED,
    "CH2 Amplitude(dBV)": REFUSED,
    "damping N s/m": REFUSED,
    "x N/um": REFUSED,
    "Channel 1 (N/um)": REFUSED,
    # Rates
    "sample_frequency": ("rate", DEFAULT),
    "sampling rate [kSa/s]": ("rate", 1000),
    "Sampling Interval (s)": ("", (1, "s")),
}  # fmt: skip


def found_in(name):
    """What `HEADERS` lists, of a name."""
    found = heading(name)
    if found.unknown or found.strange:
        return REFUSED
    quantity, unit = found.quantity, found.meaning
    if quantity == "frequency" and (unit or name in ("omega", "w", "Kreisfrequenz", "Pulsation", "\u03c9")):
        unit = column_unit(name, "frequency")[0]
        return quantity, unit.factor / TURN if unit.si == "rad/s" else unit.factor
    if unit is None:
        return quantity, DEFAULT
    if unit.decibels:
        return quantity, ("dB", unit.reference * unit.factor)
    plain = quantity in ("", "acceleration", "velocity", "position", "force") and unit.si not in ("Hz", "rad")
    return quantity, (unit.factor, unit.si) if plain else unit.factor


def near(value):
    if isinstance(value, tuple):
        return tuple(map(near, value))
    return value if isinstance(value, str) or value is REFUSED else pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize("name", HEADERS)
def test_a_header_of_the_trade_is_read_right_or_refused(name):
    assert found_in(name) == near(HEADERS[name])


@pytest.mark.slow
def test_a_header_says_on_the_page_what_it_says_in_a_file(node):
    names = list(HEADERS) + [written for written, *_ in every_writing()]
    found = node([("headings.js", "heading", name) for name in names])
    for name, result in zip(names, found, strict=True):
        there = result["value"]
        here, unit = heading(name), there["means"] or {}
        assert (here.quantity, here.unit, here.unknown, here.strange) == tuple(
            there[each] for each in ("quantity", "unit", "unknown", "strange")
        ), name
        if here.meaning is None:
            assert unit == {}, name
        else:
            assert unit["factor"] == pytest.approx(here.meaning.factor, rel=1e-12), name
            assert [unit[each] for each in ("si", "lowerSi", "decibels", "reference", "power")] == [
                here.meaning.si,
                here.meaning.lower_si,
                here.meaning.decibels,
                here.meaning.reference,
                here.meaning.power,
            ], name


# Quantity, how names call it, and units with what one of them is.
PREFIXED = {"": 1.0, "m": 1e-3, "u": 1e-6, "n": 1e-9, "k": 1e3}
KINDS = {
    "frequency": (("frequency", "Freq", "f"), {"Hz": 1.0, "rad/s": 1 / TURN}),
    "time": (("time", "Time", "t", "Zeit"), {"s": 1.0}),
    "phase": (("phase", "Phase", "CH1 Phase"), {"rad": 1.0, "deg": DEGREE}),
    "force": (("force", "Force", "hammer"), {"N": 1.0, "V": 1.0}),
    "acceleration": (("acceleration", "accel"), {"m/s^2": 1.0, "g": G}),
    "magnitude": (("magnitude", "Gain", "CH2 Amplitude"), {"m/s^2/N": 1.0, "m/N": 1.0, "rad/s/A": 1.0}),
}
WRITINGS = (
    "{name} ({unit})", "{name}[{unit}]", "{name} {{{unit}}}", "{name}（{unit}）", "{name} {unit}", "{name}_{unit}", "{name}, {unit}",
    "{name} / {unit}", "{name} in {unit}", "{name}_{flat}", "{name}-{unit}", "{NAME} ({UNIT})", "{name}_{low}", "run.{name} ({unit})",
)  # fmt: skip


def every_writing():
    """A name, its quantity, and what one step of its column is, over quantities, units, prefixes and forms of writing."""
    for quantity, (names, units) in KINDS.items():
        for name, (unit, size), (prefix, factor), form in itertools.product(
            names, units.items(), PREFIXED.items(), WRITINGS
        ):
            if (prefix and unit[:3] == "deg") or (prefix == "k" and unit in ("g", "s")):
                continue
            text = f"{prefix}{unit}"
            written = form.format(
                name=name, unit=text, flat=text.replace("/", "_").replace("^", ""), low=text.lower(),
                NAME=name.upper(), UNIT=text.upper()
            )  # fmt: skip
            yield written, quantity, factor * size, text


WHOLE = list(every_writing())


def test_a_unit_in_any_writing_is_read_right_or_refused():
    right = 0
    for written, quantity, wanted, _ in WHOLE:
        try:
            unit, reading = column_unit(written, quantity)
        except InputError:
            continue
        factor = unit.factor / TURN if quantity == "frequency" and unit.si == "rad/s" else unit.factor
        if reading.written:
            assert factor == pytest.approx(wanted, rel=1e-12), written
            right += 1
        else:
            raise AssertionError(f"{written}: its unit was passed over")
    assert right > 0.8 * len(WHOLE)


@pytest.mark.slow
@settings(max_examples=300, derandomize=True)
@given(
    st.sampled_from(sorted(KINDS)), st.text("abcdefghijklmnopqrstuvwxyzHNVA/^_ ()[]0123456789%.", max_size=12)
)
def test_what_stands_behind_a_quantity_is_understood_or_refused(quantity, more):
    """Whatever follows, a unit is one of the table, or the name is refused, or holds nothing but labels and numbers."""
    name = f"{KINDS[quantity][0][0]} {more}"
    found = heading(name)
    if found.quantity == quantity and quantity != "acceleration" and not (found.unknown or found.strange):
        if found.meaning is None:
            column_unit(name, quantity)  # the documented default
        else:
            assert column_unit(name, quantity)[1].written


# ------------------------------------------------------------------------------------------------- whole files

HZ = np.arange(10.0, 110.0)
ACCELERANCE = 0.125 - 0.4 * HZ**2 / (60.0**2 - HZ**2 + 1j * HZ)


def table(path, columns, separator=",", decimal=".", head=""):
    rows = [separator.join(columns)] + [
        separator.join(f"{x:.12g}".replace(".", decimal) for x in row)
        for row in np.column_stack(list(columns.values()))
    ]
    path.write_text(head + "\n".join(rows) + "\n", encoding="utf-8")
    return path


SIZE, ANGLE = np.abs(ACCELERANCE), np.angle(ACCELERANCE)


def test_several_responses_in_one_table_need_a_choice(tmp_path):
    columns = {"Frequency(Hz)": HZ}
    for number, factor in ((1, 1.0), (2, 3.0)):
        columns |= {
            f"CH{number} Amplitude(dB)": 20 * np.log10(factor * SIZE),
            f"CH{number} Phase(Deg)": ANGLE / DEGREE,
        }
    file = table(tmp_path / "a.csv", columns)
    with pytest.raises(InputError, match=r"CH1 Amplitude.*CH2 Amplitude"):
        load_machine(file)
    chosen = load_machine(file, response="CH2").accelerance.response
    assert np.abs(chosen / (3 * ACCELERANCE) - 1).max() < 1e-8


def test_a_ratio_has_no_unit(tmp_path):
    columns = {"frequency": HZ, "mag (m/m)": SIZE, "phase": ANGLE / DEGREE}
    assert np.abs(load_ratio(table(tmp_path / "a.csv", columns)).response) == pytest.approx(SIZE)
    columns = {"frequency": HZ, "mag (m/N)": SIZE, "phase": ANGLE / DEGREE}
    with pytest.raises(InputError, match="ratio"):
        load_ratio(table(tmp_path / "a.csv", columns))


@pytest.mark.parametrize(
    ("name", "factor", "taken"),
    [("coherence (%)", 100, True), ("coherence_percent", 100, True), ("coherence", 1, True), ("coherence", 100, False)],
)  # fmt: skip
def test_a_coherence_is_at_most_one(tmp_path, name, factor, taken):
    columns = {
        "frequency": HZ,
        "real": ACCELERANCE.real,
        "imag": ACCELERANCE.imag,
        name: factor * np.full(100, 0.9),
    }
    file = table(tmp_path / "a.csv", columns)
    if taken:
        assert load_machine(file).accelerance.coherence == pytest.approx(0.9)
    else:
        with pytest.raises(InputError, match=r"coherence reaches 90.*per cent"):
            load_machine(file)


@pytest.mark.parametrize(
    "text",
    [
        "sep=;\nZeit in s;Weg in mm\n0;0\n0,5;1,5\n1;2\n",
        "Zeit in s\tWeg in mm\n0\t0\n0,5\t1,5\n1\t2\n",
        "Zeit in s;Weg in mm\n0;0\n0,5;1,5\n1;2\n",
        "Zeit;Weg\n(s);(mm)\n0;0\n0,5;1,5\n1;2\n",
        "# a note\nZeit in s,Weg in mm\n0,0\n# another\n0.5,1.5\n1,2\n",
        'Zeit (s),Weg (mm)\n"0","0"\n"0,5","1,5"\n"1","2"\n',
        "Zeit/s Weg/mm\n0 0\n0,5 1,5\n1 2\n",
        "\ufeffZeit in s, Weg in mm\n0, 0,\n0.5, 1.5,\n1, 2,\n",
        # Notes above the names, and units below them
        "Model,MSO44\nRecord Length,3\nSample Interval,0.5\n\ntime (s),way (mm)\n0,0\n0.5,1.5\n1,2\n",
        "x-axis,1\nsecond,mm\n0,0\n0.5,1.5\n1,2\n",
        "File:\ta.svd\nIndex:\t1\nTime\tWay\n[ s ]\t[ mm ]\n0\t0\n0.5\t1.5\n1\t2\n",
        "! VENDOR, X, 1\n! Date: 1.2.2024\n! time (s), way (mm)\n0,0\n0.5,1.5\n1,2\n",
        "Trace 1;Trace 1\nTime (s);Way (mm)\n0;0\n0,5;1,5\n1;2\n",
        "s,mm\ntime,way\n0,0\n0.5,1.5\n1,2\n",  # units above the names
    ],
)
def test_the_decimal_mark_is_that_of_all_rows(tmp_path, text):
    (tmp_path / "a.csv").write_text(text)
    found = read_arrays(tmp_path / "a.csv")
    time, way = found.values()
    assert (time.tolist(), way.tolist()) == ([0, 0.5, 1], [0, 1.5, 2])
    assert [heading(name).meaning.si for name in found] == ["s", "m"]


@pytest.mark.parametrize(
    "text",
    [
        "Zeit in s;Weg in mm\n0,5;1.020,5\n1;2.040\n",
        "time (s);way (mm)\n0.5;1,020.5\n1;2,040\n",
        'time (s),way (mm)\n0.5,"1,020.5"\n1,"2,040"\n',
        "Zeit in s;Weg in mm\n0,5;1\u202f020,5\n1;2\u202f040\n",
        "time (s)\tway (mm)\n0.5\t1'020.5\n1\t2'040\n",
    ],
)
def test_thousands_may_stand_apart(tmp_path, text):
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    assert [each.tolist() for each in read_arrays(tmp_path / "a.csv").values()] == [[0.5, 1], [1020.5, 2040]]


@pytest.mark.parametrize("rows", ["0.5;1,020\n1;2,040\n", "0,5;10.5\n1;1.020,5\n", "0,5;0.998\n1;1.020,5\n"])
def test_a_mark_that_may_stand_for_either_is_refused(tmp_path, rows):
    (tmp_path / "a.csv").write_text(f"time (s);way (mm)\n{rows}")
    with pytest.raises(InputError, match="is not a number"):
        read_arrays(tmp_path / "a.csv")


@pytest.mark.parametrize("encoding", ["cp1252", "utf-16", "utf-8-sig"])
def test_a_text_is_read_in_the_letters_of_windows(tmp_path, encoding):
    (tmp_path / "a.csv").write_text("time (s),Weg (\u00b5m)\n0,1\n1,2\n", encoding=encoding)
    assert heading([*read_arrays(tmp_path / "a.csv")][1]).meaning.factor == 1e-6


@pytest.mark.parametrize("above", ["", "a note\n", "made,by,hand\nLength,3\n"])
def test_a_fault_in_the_first_row_makes_no_names_of_it(tmp_path, above):
    (tmp_path / "a.csv").write_text(above + "time,x\n0,oops\n1,2\n2,3\n")
    with pytest.raises(InputError, match="column x: 'oops' in row 1"):
        read_arrays(tmp_path / "a.csv")


def lvm(x_column, comma):
    """A text as LabVIEW writes it: two headers, X in the first column, beside each channel or not, a column for comments."""
    rows = [(k / 500, math.sin(k), math.cos(k)) for k in range(300)]
    lines = ["LabVIEW Measurement", "Separator\tTab", f"Decimal_Separator\t{',' if comma else '.'}"]
    lines += [f"X_Columns\t{x_column}", "***End_of_Header***", "", "Channels\t2"]
    lines += ["Y_Unit_Label\tg\tNewtons", "X_Dimension\tTime\tTime", "X0\t0.0E+0\t0.0E+0"]
    lines += ["Delta_X\t2.000000E-3\t2.000000E-3", "***End_of_Header***"]
    again = ["X_Value"] * (x_column == "Multi")
    lines += ["\t".join(["X_Value", "Plate", *again, "Hammer", "Comment"])]
    for x, y, z in rows:
        at = "" if x_column == "No" else repr(x)
        lines += ["\t".join([at, f"{y:.9f}", *[at for _ in again], f"{z:.9f}"])]
    text = "\n".join(lines) + "\n"
    return text.replace(".", ",") if comma else text


@pytest.mark.parametrize(("x_column", "comma"), [("One", True), ("No", False), ("Multi", True)])
def test_a_text_of_labview_has_its_time_and_units(tmp_path, x_column, comma):
    (tmp_path / "a.lvm").write_text(lvm(x_column, comma))
    record = load_record(tmp_path / "a.lvm", channels=["Plate (g)"])
    assert record.sample_rate == pytest.approx(500) and record.unit == "m/s^2"
    np.testing.assert_allclose(record.signals[0], G * np.sin(np.arange(300)), atol=1e-7)
    assert "Hammer (Newtons)" in read_arrays(tmp_path / "a.lvm")


def test_a_text_of_labview_states_its_frequencies_alone(tmp_path):
    text = (
        lvm("No", comma=True)
        .replace("Time\tTime", "Frequency\tFrequency")
        .replace("X0\t0,0E+0", "X0\t5,0E+0")
    )
    (tmp_path / "a.lvm").write_text(text)
    assert read_arrays(tmp_path / "a.lvm")["frequency (Hz)"][:2] == pytest.approx([5.0, 5.002])


def test_a_unit_beside_a_member_of_a_structure_is_that_of_its_name(tmp_path):
    table = {"Frequency": TURN * HZ, "FrequencyUnit": "rad/s", "ResponseData": ACCELERANCE[None, None]}
    savemat(tmp_path / "a.mat", {"frd": table})
    assert load_machine(tmp_path / "a.mat").accelerance.omega == pytest.approx(TURN * HZ)
    savemat(tmp_path / "a.mat", {"frd": table | {"FrequencyUnit": "rad/TimeUnit"}})
    with pytest.raises(InputError, match="rad/TimeUnit"):
        load_machine(tmp_path / "a.mat")
    savemat(tmp_path / "a.mat", {"frd": table | {"FrequencyUnit": "rad/TimeUnit", "TimeUnit": "seconds"}})
    assert load_machine(tmp_path / "a.mat").accelerance.omega == pytest.approx(TURN * HZ)
    savemat(tmp_path / "a.mat", {"frd": table | {"FrequencyUnit": "rad/TimeUnit", "TimeUnit": "minutes"}})
    with pytest.raises(InputError, match="rad/TimeUnit"):
        load_machine(tmp_path / "a.mat")
    savemat(tmp_path / "b.mat", {"s": {"title": "a plate", "parts": np.array(["x", "y"], dtype=object)}})
    with pytest.raises(InputError, match=r"s\.title \(text\), s\.parts_1"):
        read_arrays(tmp_path / "b.mat")


def test_a_sign_of_a_number_within_a_row_is_no_comment(tmp_path):
    (tmp_path / "a.csv").write_text("time,x,y\n0,#N/A,1\n#N/A,3,4\n1,2,3\n")
    found = read_arrays(tmp_path / "a.csv")
    np.testing.assert_array_equal(found["x"], [np.nan, 3, 2])
    np.testing.assert_array_equal(found["time"], [0, np.nan, 1])


def test_equal_frequencies_of_a_density_are_refused(tmp_path):
    with pytest.raises(InputError, match="rise"):
        band_power([1.0, 10.0, 10.0, 100.0], [1e-8, 1e-8, 1e-6, 1e-6], 1.0, 10.0)
    file = table(tmp_path / "a.csv", {"frequency": np.array([1.0, 10, 10, 100]), "x (m^2/Hz)": np.ones(4)})
    with pytest.raises(InputError, match="10 Hz twice"):
        read_densities(file, "", [], 1)


def sparse(path, size):
    with path.open("wb") as file:
        file.truncate(size)
    return path


def test_two_frequencies_agree_or_are_refused(tmp_path):
    hertz, path = np.linspace(1.0, 200.0, 100), tmp_path / "two.csv"
    for factor in (2 * np.pi, 1.0):
        rows = np.column_stack([factor * hertz, hertz, np.cos(hertz), np.sin(hertz)])
        np.savetxt(path, rows, delimiter=",", header="omega,Frequency (Hz),real,imaginary", comments="")
        if factor > 1:
            assert load_machine(path).accelerance.omega == pytest.approx(2 * np.pi * hertz, rel=1e-12)
        else:
            with pytest.raises(InputError, match="not the same frequencies"):
                load_machine(path)


def test_of_two_columns_of_frequencies_none_is_a_density(tmp_path):
    file = table(
        tmp_path / "a.csv", {"omega": TURN * HZ, "Frequency (Hz)": HZ, "x (m/s^2/sqrt(Hz))": 0.5 + 0 * HZ}
    )
    hertz, density = read_densities(file, "", [], 8)
    np.testing.assert_allclose(hertz, HZ)
    np.testing.assert_allclose(density, 0.25 + 0 * HZ[None])
    assert any("100 frequencies" in line for line in report_file(str(file), str(tmp_path / "a.html")))


def test_the_size_is_looked_at_before_reading(tmp_path):
    for file in (sparse(tmp_path / "a.csv", 3 * 2**30), sparse(tmp_path / "b.csv", 2**29)):
        with pytest.raises(InputError, match=r"bytes|characters"):
            read_arrays(file)
    with pytest.raises(InputError, match="bytes"):
        read_toml(sparse(tmp_path / "a.toml", 3 * 2**30))
    for text, told in ((f"a = 0x{'F' * 100_000}", "400000 bits"), (f"{'a.' * 100_000}a = 1", "100001 parts")):
        (tmp_path / "a.toml").write_text(text)
        with pytest.raises(InputError, match=told) as refusal:
            read_toml(tmp_path / "a.toml")
        assert "\n" not in str(refusal.value) and len(str(refusal.value)) < 500


@pytest.mark.parametrize(
    "columns, told",
    [
        ({"time": np.arange(20000) / 1000}, ["'time' states no unit; taken as s"]),
        *(
            ({name: np.arange(20000) / 1000 * step}, [])
            for name, step in (("time_msec", 1e3), ("Zeit in s", 1))
        ),
        ({"t_us": np.arange(20000) * 1e3}, []),
        ({"fs": np.array(1000.0)}, ["'fs' states no unit; taken as Hz"]),
        ({"fs_kHz": np.array(1.0)}, []),
    ],
)
def test_a_record_tells_the_unit_that_its_time_was_taken_in(tmp_path, columns, told):
    file = tmp_path / "floor.npz"
    np.savez(file, **columns, **{"floor (mm/s)": np.random.default_rng(1).standard_normal(20000)})
    record = load_record(file)
    assert record.sample_rate == pytest.approx(1000)
    assert list(record.notes) == told
    assert [line for line in inspect_file(str(file)).splitlines() if "states no unit" in line] == told
