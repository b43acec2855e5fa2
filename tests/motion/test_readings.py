"""Columns written in one unit and read in another never become a controller; those read as written do."""

from itertools import product

import numpy as np
import pytest
from scipy import signal

from stillwork import lti
from stillwork.base.checks import InputError
from stillwork.identification.machine_files import load_machine
from stillwork.machine.readings import build_explained
from stillwork.machine.report import report_file

READINGS = [*product(("dB", "1"), ("deg", "rad"))]


def drawn(seed):
    """Lines and receptance of a random machine, 50 g to 300 kg, with noise."""
    rng = np.random.default_rng(seed)
    mass, first, ratio = np.exp(rng.uniform(np.log([0.05, 30, 1.5]), np.log([300, 600, 2.6])))
    hertz = np.array([first, ratio * first])
    shares = rng.uniform(0.4, 1.0, 2) * [1, rng.choice([-1, 1])]
    shapes = np.sqrt(np.abs(np.append(1.0, shares)) / mass)
    model = lti.ModalModel(
        np.append(0.0, 2 * np.pi * hertz),
        np.append(0.0, rng.uniform(0.005, 0.03, 2)),
        shapes[:, None],
        (shapes * np.sign(np.append(1.0, shares)))[None],
        np.zeros((1, 1)),
    )
    lines = np.linspace(first / 15, 2 * hertz[-1], 600)
    noise = rng.choice([0.0, 0.02, 0.2]) * (rng.standard_normal((2, 600)).T @ [1, 1j]) / np.sqrt(2)
    return lines, model.frequency_response(2 * np.pi * lines)[0, 0] * (1 + noise), mass


def write(path, lines, response, written, stated):
    size = 20 * np.log10(np.abs(response)) if written[0] == "dB" else np.abs(response)
    angle = np.angle(response, deg=written[1] == "deg")
    unit = "dB re 1 m/N" if stated[0] == "dB" else "m/N"
    names = f"frequency (Hz),magnitude ({unit}),phase ({stated[1]})"
    np.savetxt(path, np.column_stack([lines, size, angle]), delimiter=",", header=names, comments="")
    return path


def explained(path):
    return build_explained(path, load_machine(path), fit_hz=(0.0, 0.0), options={})


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_no_wrong_reading_passes_and_no_right_one_is_refused(tmp_path, seed):
    lines, response, mass = drawn(seed)
    rng = np.random.default_rng(seed)
    written = READINGS[seed % 4]
    right = explained(write(tmp_path / "right.csv", lines, response, written, written))
    assert right.mass == pytest.approx(mass, rel=0.1)
    wrong = [each for each in READINGS if each != written]
    stated = wrong[rng.integers(len(wrong))]
    linear = written[0] == "dB" != stated[0]
    said = "no linear magnitude is negative" if linear else r"explains|off by|no resonance"
    with pytest.raises(InputError, match=said):
        explained(write(tmp_path / "wrong.csv", lines, response, written, stated))


def test_records_that_still_ring_at_their_ends_are_refused(tmp_path):
    """8 kg with lightly damped modes, hit for half a second: SciPy's sampled response to a half sine of 2 ms."""
    rate, samples = 5000, 2500
    force = np.zeros(samples)
    force[50:60] = 100 * np.sin(np.pi * np.arange(10) / 10)
    rows = force / 8
    for hertz, share in ((40.0, 0.9), (95.0, 0.7)):
        omega = 2 * np.pi * hertz
        path = signal.cont2discrete(
            ([share / 8, 0, 0], [1, 2 * 0.001 * omega, omega**2]), 1 / rate, method="bilinear"
        )
        rows = rows + signal.lfilter(np.ravel(path[0]), np.ravel(path[1]), force)
    assert np.abs(rows[-250:]).max() > 0.2 * np.abs(rows).max()
    hits = {"force (N)": np.stack([force, force]), "acceleration (m/s^2)": np.stack([rows, 1.001 * rows])}
    np.savez(tmp_path / "ringing.npz", fs=float(rate), **hits)
    with pytest.raises(InputError, match="off by"):
        explained(tmp_path / "ringing.npz")
    lines = report_file(
        str(tmp_path / "ringing.npz"), str(tmp_path / "a.html"), response_unit="m/s^2", force_unit="N"
    )
    assert any("no loop was searched" in line and "nothing can be promised" in line for line in lines)
