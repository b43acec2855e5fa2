"""A machine from its file: every form gives the same machine, whose response a plain solve of the matrices gives."""

import numpy as np
import pytest
from scipy import linalg, signal
from scipy.io import savemat

from experiments.motion.machines import measured_accelerance
from shared.universal_files import function, write_universal
from stillwork.control.machine_loops import DesignSettings, Intensities, applications, reach
from stillwork.identification.machine import build_machine
from stillwork.identification.machine_files import load_machine
from stillwork.identification.modal_fit import fit_modes
from workbook import paths

TEMPLATES = paths.data("motion", "your_machine")
HAMMER = paths.data("motion", "impact_frf_25k6/impact_hammer_5_hits.npz")
MASS = np.diag([4.0, 4.0, 4.0])
STIFFNESS = 2e7 * np.array([[1.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
DAMPING = 1e-5 * STIFFNESS
HERTZ = np.arange(5.0, 1000.0)
INTENSITIES = Intensities(8e-4, 1.41e-9, 1.92e-4)


def solved(hertz, place=0):
    """Acceleration of a mass over the force on the first, by solving the equation of motion at each frequency."""
    found = []
    for w in 2 * np.pi * np.asarray(hertz):
        dynamic = STIFFNESS + 1j * w * DAMPING - w**2 * MASS
        found.append(-(w**2) * np.linalg.solve(dynamic, np.eye(3)[0])[place])
    return np.array(found)


ACCELERANCE = solved(HERTZ)


def write_csv(path, **columns):
    rows = np.column_stack(list(columns.values()))
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows.tolist())]
    path.write_text("\n".join(lines))
    return path


def built(file, sensors=1, **options):
    machine = build_machine(
        load_machine(file, **options), modes_hz=[], fit_hz=(0.0, 0.0), mirrored_sensor=sensors == 2
    )
    assert len(machine.sensors) == sensors
    return machine


# --------------------------------------------------------------------------------------------------- the forms


def mobility(folder):
    np.savez(folder / "a.npz", omega=2 * np.pi * HERTZ, frf=1e3 * ACCELERANCE / (2j * np.pi * HERTZ))
    return folder / "a.npz", {"response_unit": "mm/s"}


def compliance_in_kilonewton(folder):
    values = ACCELERANCE / (2j * np.pi * HERTZ) ** 2
    savemat(folder / "a.mat", {"test": {"frequency": HERTZ, "response": values * 1e6 * 1e3}})
    return folder / "a.mat", {"response_unit": "um", "force_unit": "kN"}


def decibels(folder):
    sizes, angles = 20 * np.log10(np.abs(ACCELERANCE)), np.angle(ACCELERANCE)
    columns = {"freq (kHz)": HERTZ / 1e3, "magnitude (dB)": sizes, "phase (rad)": angles}
    return write_csv(folder / "a.csv", **columns), {}


def two_parts(folder):
    columns = {
        "f": HERTZ,
        "real": ACCELERANCE.real,
        "imag": ACCELERANCE.imag,
        "coherence": np.ones_like(HERTZ),
    }
    return write_csv(folder / "a.csv", **columns), {}


def universal(folder):
    one = function("frf", HERTZ, ACCELERANCE, reference=1, unit="(m/s2)/N", binary=1)
    return write_universal(folder / "a.uff", [one]), {}


@pytest.mark.slow
@pytest.mark.parametrize("form", [mobility, compliance_in_kilonewton, decibels, two_parts, universal])
def test_every_form_of_a_frequency_response_gives_the_same_accelerance(tmp_path, form):
    file, options = form(tmp_path)
    found = load_machine(file, **options)
    assert found.kind == "frequency response"
    assert found.accelerance.omega == pytest.approx(2 * np.pi * HERTZ, rel=1e-9)
    assert np.abs(found.accelerance.response / ACCELERANCE - 1).max() < 1e-9


UNITS = {"(g/N)": (1 / 9.80665, 0), "[mm/s / kN]": (1e6, -1), "((m/s2)/N)": (1.0, 0), "(um/N)": (1e6, -2)}


@pytest.mark.parametrize("bracket", UNITS)
def test_units_in_the_file_are_obeyed(tmp_path, bracket):
    """Numbers in the file's unit by hand: g, mm/s over kN, um; the accelerance comes back."""
    factor, order = UNITS[bracket]
    values = factor * ACCELERANCE * (2j * np.pi * HERTZ) ** order
    columns = {f"real {bracket}": values.real, f"imag {bracket}": values.imag}
    found = load_machine(write_csv(tmp_path / "a.csv", frequency=HERTZ, **columns))
    assert np.abs(found.accelerance.response / ACCELERANCE - 1).max() < 1e-9
    assert not any("is not stated" in note for note in found.notes)


def test_what_each_column_was_taken_for_is_reported(tmp_path):
    polar = {"magnitude (dB re 1 g/N)": 20 * np.log10(np.abs(ACCELERANCE)), "phase": np.angle(ACCELERANCE)}
    file = write_csv(tmp_path / "a.csv", **{"frequency (rad/s)": 2 * np.pi * HERTZ}, **polar)
    taken = {
        each.quantity: (each.unit, each.column, each.written)
        for each in load_machine(file, read_as={"phase": "rad"}).readings
    }
    assert taken == {
        "frequency": ("rad/s", "frequency (rad/s)", True),
        "magnitude": ("dB re 1 g/N", "magnitude (dB re 1 g/N)", True),
        "phase": ("rad", "phase", True),
    }
    again = load_machine(file, read_as={"frequency": "Hz", "magnitude": "1", "phase": "rad"}).accelerance
    assert again.omega == pytest.approx(2 * np.pi * 2 * np.pi * HERTZ)
    assert np.abs(again.response) == pytest.approx(9.80665 * np.abs(polar["magnitude (dB re 1 g/N)"]))


@pytest.mark.slow
def test_templates_are_one_machine():
    """M and K by eigenvalues; the fits find the same frequencies, the same mass and the damping of 1 %."""
    wanted = np.sqrt(np.linalg.eigvals(np.linalg.solve(MASS, STIFFNESS)).real.clip(0))
    wanted = np.sort(wanted)[1:] / (2 * np.pi)
    for name in ("matrices", "frequency_response", "hammer_records"):
        machine = built(TEMPLATES / f"{name}.csv", 2, damping_ratio=0.01)
        assert machine.resonances_hz == pytest.approx(wanted, rel=1e-5)
        assert machine.mass == pytest.approx(12.0, rel=1e-3)
        assert machine.sensors[0].damping[1:] == pytest.approx(0.01, rel=1e-3)


def test_matrices_with_damping_and_two_sensors_respond_as_the_equation_of_motion(tmp_path):
    np.savez(
        tmp_path / "a.npz", M=MASS, K=STIFFNESS, D=DAMPING, input=[1, 0, 0], output=[[1, 0, 0], [0, 0, 1]]
    )
    machine = built(tmp_path / "a.npz", 2)
    assert machine.mirrored == (False, False)
    omega = 2 * np.pi * HERTZ
    for sensor, place in zip(machine.sensors, (0, 2), strict=True):
        response = -(omega**2) * sensor.frequency_response(omega)[0, 0]
        assert np.abs(response / solved(HERTZ, place) - 1).max() < 1e-6


@pytest.mark.slow
def test_the_shipped_record_gives_the_machine_of_the_structure_module():
    machine = build_machine(load_machine(HAMMER), modes_hz=[], fit_hz=(300.0, 1200.0), mirrored_sensor=True)
    assert "counted against the force, turned" in machine.notes
    fit = fit_modes(measured_accelerance(1), [810.0, 824.0, 851.0, 900.0], (300.0, 1200.0))
    assert machine.resonances_hz == pytest.approx(fit.model.frequencies[1:] / (2 * np.pi), rel=1e-3)
    assert machine.mass == pytest.approx(
        1 / (fit.model.input_shapes[0, 0] * fit.model.output_shapes[0, 0]), rel=0.03
    )
    assert machine.fit.rms_error == pytest.approx(fit.rms_error, rel=0.3)


# ------------------------------------------------------------------------------------------------- the bandwidths


@pytest.fixture(scope="module")
def found():
    machine = built(TEMPLATES / "frequency_response.csv", 2)
    uses = applications(0.02, 2.0)
    return machine, {name: reach(machine, DesignSettings(use, 3, INTENSITIES)) for name, use in uses.items()}


@pytest.mark.slow
def test_measurement_and_model_agree_where_the_fit_is_exact(found):
    _, reached = found
    for each in reached.values():
        assert each.encirclement_difference == 0 and not each.reason and each.recommended is not None
        assert each.on_measurement.crossing_hz == pytest.approx(each.on_model.crossing_hz, rel=0.01)
        assert (
            each.on_measurement.design_hz > 0.999 * each.on_model.design_hz
        )  # lines miss the peaks between them


@pytest.mark.slow
def test_bandwidths_do_not_depend_on_the_unit_of_force(tmp_path):
    """A machine a thousand times heavier, disturbed a thousand times more, is the same machine."""
    for unit in ("N", "kN"):
        columns = {f"real (m/s^2/{unit})": ACCELERANCE.real, f"imag (m/s^2/{unit})": ACCELERANCE.imag}
        write_csv(tmp_path / f"{unit}.csv", frequency=HERTZ, **columns)
    machines = [built(tmp_path / f"{unit}.csv", 2) for unit in ("N", "kN")]
    assert machines[1].mass == pytest.approx(1e3 * machines[0].mass, rel=1e-9)
    use = DesignSettings(applications(0.02, 2.0)["MC"], 3, INTENSITIES)
    one, other = (reach(machine, use) for machine in machines)
    assert other.on_model.crossing_hz == pytest.approx(one.on_model.crossing_hz, rel=1e-3)


# ------------------------------------------------------------------------------------------------- bad input


def hits(folder, n=512, responses=2, tail=False, **more):
    t = np.arange(n) / 1000.0
    pulse = np.exp(-(((t - 0.02) / 1e-3) ** 2))
    rings = np.exp(-t * (1 if tail else 40)) * np.sin(2 * np.pi * 80 * t)
    columns = {"time (s)": t, "force 1": pulse, "force 2": 0.8 * pulse}
    columns |= {f"acceleration {k + 1}": rings for k in range(responses)}
    return write_csv(folder / "hits.csv", **{**columns, **more})


def test_a_record_that_is_cut_is_noted_and_not_padded(tmp_path):
    whole, cut = load_machine(hits(tmp_path)), load_machine(hits(tmp_path, tail=True))
    assert len(whole.accelerance.omega) == 4 * len(cut.accelerance.omega)
    assert "peak" in cut.notes[1] and "end" in cut.notes[1]


@pytest.mark.parametrize(
    ("rate", "lasts", "pulse", "width"),
    [
        (2e3, 0.5, "hann", 0.008),
        (5e3, 0.5, "sine", 0.002),
        (5e3, 1.0, "hann", 0.002),
        (1e4, 0.5, "hann", 0.016),
    ],
)
def test_hits_without_noise_give_their_machine(tmp_path, rate, lasts, pulse, width):
    """Where the force's spectrum is zero a line holds nothing; SciPy integrates the same three masses."""
    time = np.arange(round(rate * lasts)) / rate
    share = np.minimum(time / width, 1.0)
    force = 100 * (np.sin(np.pi * share) if pulse == "sine" else 0.5 * (1 - np.cos(2 * np.pi * share)))
    inverse = np.linalg.inv(MASS)
    a = np.block([[np.zeros((3, 3)), np.eye(3)], [-inverse @ STIFFNESS, -inverse @ DAMPING]])
    b = np.append(np.zeros(3), inverse[0])[:, None]
    _, seen, _ = signal.lsim((a, b, a[3:4], b[3:4]), force, time)
    columns = {"force (N)": force, "response (m/s^2)": seen}
    found = built(write_csv(tmp_path / "hit.csv", **{"time (s)": time}, **columns))
    wanted = np.sqrt(linalg.eigvalsh(STIFFNESS, MASS)[1:]) / (2 * np.pi)
    nearest = [np.abs(found.resonances_hz / hertz - 1).min() for hertz in wanted]
    assert max(nearest) < 1e-3 and found.mass == pytest.approx(12.0, rel=2e-3)
