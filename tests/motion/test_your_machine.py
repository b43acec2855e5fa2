"""A machine from its file: every form gives the same machine, whose response a plain solve of the matrices gives."""

import numpy as np
import pytest
from scipy import linalg, signal
from scipy.io import savemat

from stillwork.identification.machine import build_machine
from stillwork.identification.machine_files import load_machine
from workbook import paths

TEMPLATES = paths.data("motion", "your_machine")
MASS = np.diag([4.0, 4.0, 4.0])
STIFFNESS = 2e7 * np.array([[1.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
DAMPING = 1e-5 * STIFFNESS
HERTZ = np.arange(5.0, 1000.0)


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


def built(file, **options):
    return build_machine(load_machine(file, **options), modes_hz=[], fit_hz=(0.0, 0.0))


# --------------------------------------------------------------------------------------------------- the forms


def mobility(folder):
    np.savez(folder / "a.npz", omega=2 * np.pi * HERTZ, frf=1e3 * ACCELERANCE / (2j * np.pi * HERTZ))
    return folder / "a.npz", {"response_unit": "mm/s"}


def compliance_in_kilonewton(folder):
    values = ACCELERANCE / (2j * np.pi * HERTZ) ** 2
    savemat(folder / "a.mat", {"test": {"frequency": HERTZ, "response": values * 1e6 * 1e3}})
    return folder / "a.mat", {"response_unit": "um", "force_unit": "kN"}


@pytest.mark.slow
@pytest.mark.parametrize("form", [mobility, compliance_in_kilonewton])
def test_every_form_of_a_frequency_response_gives_the_same_accelerance(tmp_path, form):
    file, options = form(tmp_path)
    found = load_machine(file, **options)
    assert found.kind == "frequency response"
    assert found.accelerance.omega == pytest.approx(2 * np.pi * HERTZ, rel=1e-9)
    assert np.abs(found.accelerance.response / ACCELERANCE - 1).max() < 1e-9


@pytest.mark.slow
def test_templates_are_one_machine():
    """M and K by eigenvalues; the fits find the same frequencies, the same mass and the damping of 1 %."""
    wanted = np.sqrt(np.linalg.eigvals(np.linalg.solve(MASS, STIFFNESS)).real.clip(0))
    wanted = np.sort(wanted)[1:] / (2 * np.pi)
    for name in ("matrices", "frequency_response", "hammer_records"):
        machine = built(TEMPLATES / f"{name}.csv", damping_ratio=0.01)
        assert machine.resonances_hz == pytest.approx(wanted, rel=1e-5)
        assert machine.mass == pytest.approx(12.0, rel=1e-3)
        assert machine.sensors[0].damping[1:] == pytest.approx(0.01, rel=1e-3)


def test_matrices_with_damping_and_two_sensors_respond_as_the_equation_of_motion(tmp_path):
    np.savez(
        tmp_path / "a.npz", M=MASS, K=STIFFNESS, D=DAMPING, input=[1, 0, 0], output=[[1, 0, 0], [0, 0, 1]]
    )
    machine = built(tmp_path / "a.npz")
    omega = 2 * np.pi * HERTZ
    for sensor, place in zip(machine.sensors, (0, 2), strict=True):
        response = -(omega**2) * sensor.frequency_response(omega)[0, 0]
        assert np.abs(response / solved(HERTZ, place) - 1).max() < 1e-6


@pytest.mark.parametrize(
    ("rate", "lasts", "pulse", "width"),
    [
        (5e3, 0.5, "sine", 0.002),
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
