"""Machines that show no flexible mode: designed as rigid bodies, judged by their C around SciPy's plant; noise is refused."""

from dataclasses import replace

import numpy as np
import pytest

from motion.true_machines import CompiledLoop, TrueMachine
from stillwork.base.checks import InputError
from stillwork.identification.machine import build_machine
from stillwork.identification.machine_files import load_machine
from stillwork.machine.design import design_file
from stillwork.machine.retest import retest_file

RATE, MASS, LATE = 4e3, 7.0, 2e-4
HZ = np.arange(3.0, 500.0)
FREE = TrueMachine(MASS, (), (), (), delay=LATE)
KINDS = {
    "free": FREE,
    "on springs": replace(FREE, springs=25.0, friction=5.0),
    "rubbed": replace(FREE, friction=40.0),
    # A mode beyond the band, which is the compliance in it.
    "above": replace(FREE, hertz=(1.6 * HZ[-1],), damping=(0.01,), position=(0.2,)),
}


def saved(folder, machine, name="machine"):
    """A file of its accelerance, with a hundredth of noise."""
    noise = np.random.default_rng(0).standard_normal((2, len(HZ)))
    seen = -((2 * np.pi * HZ) ** 2) * machine.response(HZ) * (1 + 0.01 * (noise[0] + 1j * noise[1]))
    np.savez(folder / f"{name}.npz", **{"frequency (Hz)": HZ, "h (m/s^2/N)": seen})
    return str(folder / f"{name}.npz")


@pytest.mark.parametrize("kind", KINDS)
def test_mass_springs_and_friction_are_those_of_the_machine(tmp_path, kind):
    file, true = saved(tmp_path, KINDS[kind]), KINDS[kind]
    machine = build_machine(load_machine(file), modes_hz=[], fit_hz=(0, 0), rigid=True)
    assert not len(machine.resonances_hz) and machine.mass == pytest.approx(MASS, rel=0.02)
    assert machine.sensors[0].frequencies == pytest.approx([2 * np.pi * true.springs], rel=1e-3)
    assert machine.fit.delay == pytest.approx(LATE, abs=4 * machine.fit.delay_deviation)
    if not true.springs:
        assert machine.sensors[0].drag == pytest.approx(true.friction, rel=0.02)
    with pytest.raises(InputError, match=r"no resonance stands out|no flexible mode beside it"):
        build_machine(load_machine(file), modes_hz=[], fit_hz=(0, 0))


def test_noise_is_no_rigid_body(tmp_path):
    rng = np.random.default_rng(1)
    noise = rng.standard_normal(len(HZ)) + 1j * rng.standard_normal(len(HZ))
    np.savez(tmp_path / "noise.npz", **{"frequency (Hz)": HZ, "h (m/s^2/N)": noise})
    with pytest.raises(InputError, match=r"rigid body alone is off by .* with less of it"):
        design_file(str(tmp_path / "noise.npz"), str(tmp_path / "out"), RATE)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_true_machine_keeps_its_peak_and_a_changed_one_is_found_out(tmp_path, kind):
    true = KINDS[kind]
    file = saved(tmp_path, true)
    said = design_file(file, str(tmp_path / "out"), RATE)
    assert ": PID" in said[0] and "as large as the rigid body and damped by 0.5 %" in said[1]
    held = tmp_path / "out" / "controller.json"
    loop = CompiledLoop(tmp_path / "out", RATE)
    late = replace(true, delay=LATE + 1 / RATE)
    sizes = [loop.peak_db(replace(late, mass=MASS / gain)) for gain in (0.95, 1.0, 1.05)]
    assert 5.0 < max(sizes) < 6.1, sizes
    page = (tmp_path / "out" / "report.html").read_text()
    assert "none up to 499 Hz" in page
    said = retest_file(str(held), file, str(tmp_path / "same.html"))
    assert "the promise holds" in said[0] and "not in the box" not in said[0]
    other = saved(tmp_path, replace(true, mass=MASS / 2.6), "other")
    said = retest_file(str(held), other, str(tmp_path / "other.html"))
    assert "does not hold" in said[0] and "mass" in said[0]
