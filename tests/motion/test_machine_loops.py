"""Loops that are recommended on four machines, compared with the equations of motion; sampled loops against python-control."""

import numpy as np
import pytest

from stillwork.control.bandwidth import make_loop
from stillwork.control.machine_loops import (
    DesignSettings,
    Intensities,
    SearchSettings,
    applications,
    on_measurement,
    reach,
)
from stillwork.control.pid import PidFamily
from stillwork.identification.frequency_response import Identified
from stillwork.identification.machine import build_machine
from stillwork.identification.machine_files import load_machine

INTENSITIES = Intensities(8e-4, 1.41e-9, 1.92e-4)
PAIR = {"masses": (30.0, 10.0), "springs": (1.5e7,)}
CHAIN = {"masses": (20.0, 10.0, 10.0), "springs": (3e7, 2e7), "sensors": (0, 2)}
MACHINES = {
    "non-collocated": (PAIR | {"sensors": (1,)}, {}),
    "lightly damped": (CHAIN | {"damping": 5e-4}, {}),
    "late": (PAIR | {"sensors": (1,)}, {"sample_time": 1e-4, "delay": 1}),
    "on springs to the ground": (PAIR | {"sensors": (1,), "ground": 4e4}, {}),
}


def chain(masses, springs, sensors, damping=0.005, ground=0.0):
    """Mass and stiffness of a chain pushed at its first mass, and where its sensors are."""
    n = len(masses)
    stiffness = np.zeros((n, n))
    stiffness[0, 0] = ground
    for k, spring in enumerate(springs):
        stiffness[k : k + 2, k : k + 2] += spring * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return np.diag(masses), stiffness, np.eye(n)[list(sensors)], damping


def machine_of(folder, name):
    mass, stiffness, outputs, damping = chain(**MACHINES[name][0])
    np.savez(folder / "m.npz", M=mass, K=stiffness, input=np.eye(len(mass))[0], output=outputs)
    file = load_machine(folder / "m.npz", damping_ratio=damping)
    return build_machine(file, modes_hz=[], fit_hz=(0.0, 0.0))


def responses(name, omega):
    """Force to every sensor by solving the equations of motion, with the damping of each mode from a generalised
    eigenvalue problem: D = M V diag(2 zeta w) V' M."""
    mass, stiffness, outputs, damping = chain(**MACHINES[name][0])
    root = np.diag(1 / np.sqrt(np.diag(mass)))
    squares, vectors = np.linalg.eigh(root @ stiffness @ root)
    vectors = root @ vectors
    rates = 2 * damping * np.sqrt(np.clip(squares, 0, None))
    matrix = mass @ vectors @ np.diag(rates) @ vectors.T @ mass
    found = [
        outputs @ np.linalg.solve(stiffness + 1j * w * matrix - w**2 * mass, np.eye(len(mass))[0])
        for w in omega
    ]
    return np.array(found).T


def loop_peaks(plant, block, controller, omega):
    """S_I, S_O and r to e, dB, of a controller that runs on r - y, from the equations of the loop at each frequency."""
    found = np.empty((3, len(omega)))
    for k in range(len(omega)):
        (o_uf, o_uy), (o_yf, o_yy) = block[..., k]
        p, c = plant[k], controller[k]
        # Unknown: y = P f - v, f = u + u_d, u = C (r - y + y_flex) + u_ff; the observer sees f and y - r.
        matrix = np.array([[1, -p, 0], [-o_uy, 1 - o_uf, -1], [c * (1 - o_yy), -c * o_yf, 1]])
        sources = np.array([[0, 0, 1], [-1, 0, 0], [0, -o_uy, c * (1 - o_yy)]]).T  # u_ff, v, r
        y, _, u = np.linalg.solve(matrix, sources)
        found[:, k] = np.abs([u[0], -y[1], 1 - y[2]])
    return 20 * np.log10(found.max(axis=1))


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_no_recommended_loop_exceeds_six_decibels(tmp_path, name):
    machine = machine_of(tmp_path, name)
    options = MACHINES[name][1]
    uses = applications(0.02, 2.0)
    assert set(uses) == {"PID", "MC", "AD", "MC and AD"}
    for use in uses.values():
        each = reach(machine, DesignSettings(use, 5, INTENSITIES), SearchSettings(**options))
        best = each.recommended
        assert best is not None and not each.reason
        sample_time, pid = options.get("sample_time", 0.0), best.controller
        for number, loop in enumerate(each.model_loops):
            assert loop.is_stable(pid)
            top = min(loop.omega[-1], 2 * np.pi * 2000)
            peaks = [2 * np.pi * f + np.linspace(-60, 60, 200) for f in machine.resonances_hz]
            omega = np.concatenate([2 * np.pi * np.geomspace(0.5, top / (2 * np.pi), 300), *peaks])
            omega = omega[(omega > 0) & (omega <= top)]
            plant, s = responses(name, omega)[number], 1j * omega
            if sample_time:  # held, late, and folded: the images from the rates around
                rates = 2 * np.pi / sample_time * np.arange(-6, 7)
                plant = sum(
                    responses(name, omega + rate)[number]
                    * -np.expm1(-s * sample_time)
                    / ((s + 1j * rate) * sample_time)
                    for rate in rates
                ) * np.exp(-s * sample_time * options["delay"])
                s = 2 / sample_time * np.tanh(s * sample_time / 2)
            controller = pid.gain * (s + pid.integrator) / s * (s / pid.differentiator + 1)
            controller *= pid.low_pass**2 / (
                s**2 + 2 * pid.low_pass_damping * pid.low_pass * s + pid.low_pass**2
            )
            block = loop.compensator.frequency_response(omega)
            assert loop_peaks(plant, block, controller, omega).max() < 6.01


# ----------------------------------------------------------------------------------------------------- sampled loops


@pytest.mark.slow
def test_a_sampled_loop_is_that_of_python_control(tmp_path):
    import control

    sample_time, delay = 1e-4, 2
    plant = machine_of(tmp_path, "non-collocated").sensors[0]
    loop, pid = make_loop(plant, sample_time=sample_time, delay=delay), PidFamily(40.0)(20.0)
    held = control.sample_system(plant.to_control(), sample_time, "zoh")
    late = control.tf([1.0], [1.0, 0.0, 0.0], sample_time)
    sampled = control.sample_system(pid.state_space().to_control(), sample_time, "tustin")
    omega = 2 * np.pi * np.geomspace(5, 1000, 50)
    whole = [each(np.exp(1j * omega * sample_time)) for each in (held, late, sampled)]
    assert loop.at(pid, omega).loop == pytest.approx(whole[0] * whole[1] * whole[2], rel=1e-6)
    poles = control.feedback(held * control.ss(late) * sampled, 1).poles()
    wanted = np.log(poles[np.abs(poles) > 1e-3].astype(complex)) / sample_time
    for pole in wanted:
        assert np.abs(loop.poles(pid) - pole).min() < 1e-3 * abs(pole) + 1e-2


def test_a_measurement_of_the_model_gives_the_model_sampled_or_not(tmp_path):
    plant = machine_of(tmp_path, "non-collocated").sensors[0]
    omega = 2 * np.pi * np.arange(20.0, 800.0)
    accelerance = -(omega**2) * plant.frequency_response(omega)[0, 0]
    measured = Identified(omega, accelerance, np.ones(len(omega)))
    for options in ({}, {"sample_time": 2e-4, "delay": 1}):
        loop = on_measurement(make_loop(plant, **options), measured, 1.0, (30.0, 700.0))
        assert loop.plant_response == pytest.approx(loop.plant_at(loop.omega), rel=1e-9)
        assert loop.omega[-1] == pytest.approx(2 * np.pi * 700)
