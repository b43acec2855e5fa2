"""A controller that waits: the same as one on a later machine, and more freedom never costs bandwidth."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from motion.true_machines import CompiledLoop, TrueMachine
from stillwork.control.applications import Application
from stillwork.control.machine_loops import DesignSettings, Intensities, SearchSettings, reach
from stillwork.control.pid import PidFamily
from stillwork.identification.machine import Machine
from stillwork.lti.modal import ModalModel
from stillwork.machine.design import design_file
from stillwork.machine.machine_designs import crossing, search_designs
from stillwork.machine.retest import retest_file
from stillwork.machine.waiting import waited

RATE = 1e4
INTENSITIES = Intensities(8e-4, 1.41e-9, 1.92e-4)
ALONE = DesignSettings(None, 5, INTENSITIES)
# Hz, damping and share of modes against the force, whose phases a few samples turn to advantage.
WAITS = (154.36, 213.44, 392.74), (0.016926, 0.0048742, 0.0035904), (-0.18835, -0.45439, -0.36498)


def modal(hertz, damping, shares, mass=10.0):
    """A free body with modes of either sign."""
    shapes = np.sqrt(np.abs(np.append(1.0, shares)) / mass)
    signs = np.sign(np.append(1.0, shares))
    frequencies = 2 * np.pi * np.append(0.0, hertz)
    return ModalModel(
        frequencies, np.append(0.0, damping), shapes[:, None], (signs * shapes)[None], np.zeros((1, 1))
    )


def random_machine(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 4))
    hertz = 10 ** rng.uniform(1.7, 2.3) * np.cumprod(np.append(1.0, rng.uniform(1.3, 2.2, count - 1)))
    shares = 10 ** rng.uniform(-1, 0, count) * rng.choice([-1.0, 1.0], count)
    return Machine((modal(hertz, 10 ** rng.uniform(-2.5, -1.5, count), shares),), 10.0, f"random {seed}")


@pytest.mark.parametrize("samples", [1, 2.5])
def test_a_loop_that_waits_is_that_of_scipy(samples):
    """Tustin's PID, the delays and the held machine as fractions of polynomials; the all-pass has its own closed form."""
    plant, pid, omega = (
        modal([150.0], [0.01], [-0.5]),
        PidFamily(10.0)(15.0),
        2 * np.pi * np.geomspace(2, 4e3, 80),
    )
    use, search = replace(ALONE, wait=samples), SearchSettings(1 / RATE, 1.0)
    (loop,), _ = search.loops_of(Machine((plant,), 10.0, "one"), use)
    w, z = 2 * np.pi * 150.0, np.exp(1j * omega / RATE)
    held = sum(
        share / 10.0 * part
        for share, part in (
            (1.0, hold([1.0], [1.0, 0.0, 0.0], z)),
            (-0.5, hold([1.0], [1.0, 2 * 0.01 * w, w * w], z)),
        )
    )
    s = 2 * RATE * (z - 1) / (z + 1)
    controller = pid.gain * (s + pid.integrator) / s * (s / pid.differentiator + 1)
    controller /= (s / pid.low_pass) ** 2 + 2 * pid.low_pass_damping * s / pid.low_pass + 1
    part = samples % 1
    late = z ** -float(samples - part) * (1 - s / RATE * part / 2) / (1 + s / RATE * part / 2)
    sensitivity = 1 / (1 + controller * late * held / z)
    assert loop.at(pid, omega).output_sensitivity == pytest.approx(sensitivity, rel=1e-6)
    assert np.abs(late) == pytest.approx(1.0) and np.angle(late[0]) == pytest.approx(
        -samples * omega[0] / RATE, rel=1e-5
    )


def hold(numerator, denominator, z):
    """Response of SciPy's zero-order hold."""
    top, bottom, _ = signal.cont2discrete((numerator, denominator), 1 / RATE)
    return np.polyval(np.ravel(top), z) / np.polyval(bottom, z)


@pytest.mark.parametrize(
    "application", [None, Application(compensate=True), Application(damping=0.02, selectivity=2.0)]
)
def test_waiting_is_a_later_machine(application):
    machine, use = Machine((modal([150.0, 260.0], [0.01, 0.02], [-0.5, 0.3]),), 10.0, "two"), ALONE
    use, pid = replace(use, application=application), PidFamily(10.0)(15.0)
    (waits,), _ = SearchSettings(1 / RATE, 1.0).loops_of(machine, replace(use, wait=3.0))
    (later,), _ = SearchSettings(1 / RATE, 4.0).loops_of(machine, use)
    omega = 2 * np.pi * np.geomspace(2, 4e3, 80)
    one, other = waits.at(pid, omega), later.at(pid, omega)
    for name in ("input_sensitivity", "output_sensitivity"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-7)
    assert waits.is_stable(pid) == later.is_stable(pid)


def furthest(machine, use, search):
    """First crossing with the best lead and own delay."""
    known = reach(machine, use, search)
    trial = waited(machine, use, search, known, crossing(known))
    return max(crossing(known), crossing(reach(machine, trial, search)))


@pytest.mark.parametrize("seed", range(4))
def test_a_later_machine_never_gets_further(seed):
    machine = random_machine(seed)
    found = [furthest(machine, ALONE, SearchSettings(1 / RATE, float(delay))) for delay in range(2)]
    assert found[0] > 0
    assert found[1] <= 1.005 * found[0]


@pytest.mark.slow
def test_more_freedom_never_costs_bandwidth():
    """Of the whole search: a use that contains another, and a machine that is earlier by whole samples."""
    machine, reached = random_machine(21), []
    for delay in (0.0, 2.0):
        found = search_designs(machine, rate=RATE, delay=delay, uncertainty="none,gain=0.05").found
        hertz = {use: crossing(each) for use, each in found.items()}
        assert min(hertz["PID with notches"], hertz["MC"], hertz["AD"]) >= 0.995 * hertz["PID"] > 0
        assert hertz["MC and AD"] >= 0.995 * max(hertz["MC"], hertz["AD"])
        reached.append(hertz)
    assert all(reached[1][use] <= 1.005 * hertz for use, hertz in reached[0].items())


@pytest.mark.slow
def test_a_written_controller_that_waits_keeps_its_promise_on_the_true_machine(tmp_path):
    """The compiled C around the machine by SciPy, all over the box; then the same file around the machine retested."""
    hertz, damping, shares = map(np.array, WAITS)
    true = TrueMachine(10.0, *WAITS, delay=0.0)
    w = 2 * np.pi * np.append(0.0, hertz)
    shapes = np.sqrt(np.abs(np.append(1.0, shares)) / 10.0)
    arrays = {"M": np.eye(4), "K": np.diag(w * w), "D": np.diag(2 * np.append(0.0, damping) * w)}
    output = shapes * np.sign(np.append(1.0, shares))
    np.savez(tmp_path / "machine.npz", **arrays, input=shapes, output=output[None])
    box = {"frequency": 0.05, "gain": 0.1}
    file, out = str(tmp_path / "machine.npz"), tmp_path / "out"
    said = design_file(file, str(out), RATE, delay=0.0, uncertainty=box)
    wait = float(re.search(r"waiting ([\d.]+) samples", said[0])[1])
    held = json.loads((out / "controller.json").read_text())
    assert wait > 0 and held["provenance"]["settings"]["wait"] == wait
    assert held["provenance"]["delay_samples_of_the_loop"] == 0
    worst = CompiledLoop(out, RATE).worst_db(true, box, 40, np.random.default_rng(1))
    assert 5.5 < worst <= 6.01
    page = tmp_path / "again.html"
    assert "the promise holds" in retest_file(str(out / "controller.json"), file, str(page))[0]
