"""Machines that show no flexible mode: designed as rigid bodies with PID, judged by SciPy's own plant; noise is refused."""

import json

import numpy as np
import pytest
from scipy import signal

from stillwork.base.checks import InputError
from stillwork.identification.machine import build_machine
from stillwork.identification.machine_files import load_machine
from stillwork.machine.design import design_file
from stillwork.machine.retest import retest_file

RATE, MASS, LATE = 4e3, 7.0, 2e-4
HZ = np.arange(3.0, 500.0)
KINDS = {"free": (0.0, 0.0), "on springs": (25.0, 5.0), "rubbed": (0.0, 40.0), "above": (0.0, 0.0)}


def true(kind, share=0.0, hertz=HZ, seed=0):
    """Accelerance with noise, and numerator and denominator of the position."""
    springs, drag = KINDS[kind]
    over, under = [1 / MASS], [1.0, drag, (2 * np.pi * springs) ** 2]
    if kind == "above":  # a mode beyond the band, which is the compliance in it
        w = 2 * np.pi * 1.6 * hertz[-1]
        mode = [1.0, 0.02 * w, w * w]
        over, under = (
            np.polyadd(np.polymul(over, mode), np.polymul([0.2 / MASS], under)),
            np.polymul(under, mode),
        )
    s, rng = 2j * np.pi * hertz, np.random.default_rng(seed)
    seen = s**2 * np.polyval(over, s) / np.polyval(under, s) * np.exp(-s * LATE)
    noise = rng.standard_normal((2, len(s)))
    return seen * (1 + share * (noise[0] + 1j * noise[1])), over, under


def saved(folder, kind, share=0.01):
    seen, over, under = true(kind, share)
    np.savez(folder / "machine.npz", **{"frequency (Hz)": HZ, "h (m/s^2/N)": seen})
    return str(folder / "machine.npz"), over, under


def peak(over, under, space, gain=1.0):
    """Largest magnitude of S and of a pole, by SciPy: the force held, LATE and a sample later."""
    a, b, c, d = (np.array(space[name], dtype=float) for name in "abcd")
    law = a + b[:, 1:] @ c, b[:, :1] + b[:, 1:] @ d[:, :1], c, d[:, :1]
    w = np.concatenate([np.geomspace(1e-4, np.pi, 20000)])
    z = np.exp(1j * w)
    k = signal.freqz(*signal.ss2tf(*law), worN=w)[1] if len(a) < 3 else _response(law, z)
    # Of the plant with its delay: what is held from LATE on, then what was before it.
    early = signal.cont2discrete(signal.tf2ss(gain * np.array(over), under), (1 - LATE * RATE) / RATE)
    whole = signal.cont2discrete(signal.tf2ss(gain * np.array(over), under), 1 / RATE)
    first, all_of = early[1], whole[1]
    after = all_of - first  # by the force of the sample before, moved on by `early`
    plant = np.array(
        [
            (whole[2] @ np.linalg.solve(x * np.eye(len(whole[0])) - whole[0], first + after / x)).item()
            for x in z
        ]
    )
    return float(np.abs(1 / (1 + k * plant / z)).max())


def _response(law, z):
    a, b, c, d = law
    return np.array([(c @ np.linalg.solve(x * np.eye(len(a)) - a, b) + d).item() for x in z])


@pytest.mark.parametrize("kind", KINDS)
def test_mass_springs_and_friction_are_those_of_the_machine(tmp_path, kind):
    file, *_ = saved(tmp_path, kind)
    machine = build_machine(load_machine(file), modes_hz=[], fit_hz=(0, 0), mirrored_sensor=False, rigid=True)
    springs, drag = KINDS[kind]
    assert not len(machine.resonances_hz) and machine.mass == pytest.approx(MASS, rel=0.02)
    assert machine.sensors[0].frequencies == pytest.approx([2 * np.pi * springs], rel=1e-3)
    assert machine.fit.delay == pytest.approx(LATE, abs=4 * machine.fit.delay_deviation)
    if not springs:
        assert machine.sensors[0].drag == pytest.approx(drag, rel=0.02)
    with pytest.raises(InputError, match=r"no resonance stands out|no flexible mode beside it"):
        build_machine(load_machine(file), modes_hz=[], fit_hz=(0, 0), mirrored_sensor=False)


def test_noise_is_no_rigid_body(tmp_path):
    rng = np.random.default_rng(1)
    noise = rng.standard_normal(len(HZ)) + 1j * rng.standard_normal(len(HZ))
    np.savez(tmp_path / "noise.npz", **{"frequency (Hz)": HZ, "h (m/s^2/N)": noise})
    with pytest.raises(InputError, match=r"rigid body alone is off by .* with less of it"):
        design_file(str(tmp_path / "noise.npz"), str(tmp_path / "out"), RATE)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_true_machine_keeps_its_peak_and_a_changed_one_is_found_out(tmp_path, kind):
    file, over, under = saved(tmp_path, kind)
    said = design_file(file, str(tmp_path / "out"), RATE)
    assert ": PID" in said[0] and "as large as the rigid body and damped by 0.5 %" in said[1]
    held = tmp_path / "out" / "controller.json"
    space = json.loads(held.read_text())["state_space"]
    sizes = [20 * np.log10(peak(over, under, space, gain)) for gain in (0.95, 1.0, 1.05)]
    assert 5.0 < max(sizes) < 6.1, sizes
    page = (tmp_path / "out" / "report.html").read_text()
    assert "none up to 499 Hz" in page
    said = retest_file(str(held), file, str(tmp_path / "same.html"))
    assert "the promise holds" in said[0] and "not in the box" not in said[0]
    np.savez(tmp_path / "other.npz", **{"frequency (Hz)": HZ, "h (m/s^2/N)": 2.6 * true(kind, 0.01)[0]})
    said = retest_file(str(held), str(tmp_path / "other.npz"), str(tmp_path / "other.html"))
    assert "does not hold" in said[0] and "mass" in said[0]
