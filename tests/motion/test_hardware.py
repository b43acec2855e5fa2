"""What a written controller makes of its sensor's noise and of single precision: predicted, and simulated sample by sample."""

from dataclasses import replace

import numpy as np
import pytest

from motion.true_machines import TrueMachine
from shared.compiled import run_controller
from stillwork.base.checks import InputError
from stillwork.control.applications import Application
from stillwork.control.bandwidth import make_loop
from stillwork.control.digital import error_driven, runnable, tied_to_error
from stillwork.control.loop_noise import NOISE, NoiseBound, crossing_noise, noise_gain, written_noise
from stillwork.control.machine_loops import (
    DesignSettings,
    Intensities,
    SearchSettings,
    observed_loops,
    observer_settings,
    reach,
)
from stillwork.control.pid import PidFamily
from stillwork.estimation.observer import NoiseIntensities
from stillwork.identification.machine import build_machine
from stillwork.identification.machine_files import load_machine
from stillwork.lti.modal import modal_model
from stillwork.machine import single_precision
from stillwork.machine.c_code import controller_code
from stillwork.machine.hardware import QUANTISED, single_rows
from stillwork.machine.promise import checked_biquads
from stillwork.machine.single_precision import (
    LOST_LITTLE,
    balanced_form,
    by_modes,
    in_single_precision,
    rounding_error,
)

RATE = 2e3
INERTIA, FRICTION = 3e-3, 2.0  # kg m^2, 1/s
HERTZ, DAMPING, SHARE = 31.0, 0.012, 0.4  # of the mode: its share of 1/J


def sampled(delay):
    """A, b, c of an inertia on friction with one mode, force late by 0 to 1 samples: by SciPy, from poles and residues."""
    return TrueMachine(
        INERTIA, (HERTZ,), (DAMPING,), (SHARE,), friction=FRICTION, delay=delay / RATE
    ).sampled(RATE)


def write_machine(folder):
    """The same as matrices in the coordinates of its modes, turned by some angle."""
    turn = np.array([[0.6, 0.8], [-0.8, 0.6]])
    stiffness = np.diag([0.0, (2 * np.pi * HERTZ) ** 2])
    loss = np.diag([FRICTION, 4 * np.pi * DAMPING * HERTZ])
    shape = np.sqrt(np.array([1.0, SHARE]) / INERTIA)
    file = folder / "arm.npz"
    arrays = {"M": np.eye(2), "K": turn @ stiffness @ turn.T, "D": turn @ loss @ turn.T}
    np.savez(file, **arrays, input=turn @ shape, output=(turn @ shape)[None])
    return file


def simulated(controller, plant, noise):
    """Output of the loop, sample by sample, for numbers of noise on the measurement."""
    a, b, c = plant
    model = controller.linear
    x, s = np.zeros(len(a)), np.zeros(len(model.a))
    found = np.empty(len(noise))
    for k, each in enumerate(noise):
        error = -(c @ x + each)
        found[k] = model.c[0] @ s + model.d[0, 0] * error
        s = model.a @ s + model.b[:, 0] * error
        x = a @ x + b * found[k]
    return found


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    file = write_machine(tmp_path_factory.mktemp("noise"))
    reading = {"response_unit": "rad", "force_unit": "N m"}
    return file, build_machine(load_machine(file, **reading), modes_hz=[], fit_hz=(0, 0))


@pytest.mark.parametrize("delay", [0.0, 0.37])
@pytest.mark.parametrize("observed", [False, True])
def test_the_noise_at_the_output_is_that_of_a_simulation(machine, delay, observed):
    application = Application(compensate=True) if observed else None
    settings = observer_settings(machine[1], application, 2, Intensities(8e-4, 1e-8, 2e-4))
    (loop,) = observed_loops(machine[1].sensors, application, *settings, 1 / RATE, delay)
    pid = PidFamily(INERTIA)(4.0)
    controller = error_driven(tied_to_error(runnable(pid, loop.compensator, np.inf, {}, ("rad", "N m"))))
    rms, largest = written_noise(controller.linear, loop.sampled_plant)
    assert noise_gain(loop, pid) == pytest.approx(rms, rel=5e-3)
    rng = np.random.default_rng(5)
    noise = rng.uniform(-0.5, 0.5, 40_000)
    seen = simulated(controller, sampled(delay), noise)[2000:]
    assert seen.std() == pytest.approx(rms * QUANTISED, rel=0.04)
    # At one frequency: what comes through is never more than the largest gain, and at its own it is that.
    omega = 2 * np.pi * np.geomspace(0.5, 990, 3000)
    response = loop.at(pid, omega)
    sizes = np.abs(response.output_controller * response.output_sensitivity)
    assert sizes.max() == pytest.approx(largest, rel=0.03) and sizes.max() <= 1.001 * largest


def test_the_ratio_of_noise_is_that_of_every_rate():
    """A PID far below both rates: the rms of white samples falls by the root of the rate, the ratio stays."""
    mass = modal_model(np.array([[1.0]]), np.array([[0.0]]), [[1.0]], [[1.0]])
    pid = PidFamily(1.0)(20.0)
    loops = [make_loop(mass, sample_time=1 / rate) for rate in (1e4, 4e4)]
    slow, fast = (noise_gain(loop, pid) for loop in loops)
    assert slow == pytest.approx(2 * fast, rel=0.02)
    ratios = [noise_gain(loop, pid) / crossing_noise(loop, pid) for loop in loops]
    assert ratios[0] == pytest.approx(ratios[1], rel=0.02) and 5 < ratios[0] < 10
    with pytest.raises(InputError, match="continuous time"):
        noise_gain(make_loop(mass), pid)


@pytest.mark.parametrize("uncertainty", [{}, {"frequency": 0.05}])
def test_a_bound_of_the_noise_stops_a_search(machine, uncertainty):
    """What is allowed is what is reached, and the peaks hold there; a bound that nothing meets is a reason."""
    use = DesignSettings(None, 2, Intensities(8e-4, 1e-8, 2e-4))
    search = SearchSettings(1 / RATE, 1.0, uncertainty)
    free = reach(machine[1], use, search)
    loop, most = free.model_loops[0], free.recommended
    allowed = noise_gain(loop, most.controller) / 3
    held = reach(machine[1], use, replace(search, noise=NoiseBound(gain=allowed)))
    found = held.recommended
    assert held.stopped_by_noise and found.function == NOISE and "noise" in held.summary["stopped by"]
    assert noise_gain(loop, found.controller) == pytest.approx(allowed, rel=1e-3)
    assert found.design_hz < most.design_hz and max(size for size, _ in held.peaks_db().values()) < 6
    ratio = noise_gain(loop, most.controller) / crossing_noise(loop, most.controller)
    assert not reach(machine[1], use, replace(search, noise=NoiseBound(ratio=1.01 * ratio))).stopped_by_noise
    none = reach(machine[1], use, replace(search, noise=NoiseBound(ratio=0.1)))
    assert none.recommended is None and none.stopped_by_noise and "times what is allowed" in none.reason


def slow_controller(limit=np.inf):
    """Of a machine with its first mode at 1.3 Hz, at 1 kHz: an observer whose states nearly cancel."""
    mass, stiffness = np.diag([3.0, 1.0]), 50.0 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    plant = modal_model(mass, stiffness, [[1.0], [0.0]], [[0.0, 1.0]], damping_ratio=0.01)
    noise = NoiseIntensities(8e-4**2 * 16, 1.41e-10**2)
    (loop,) = observed_loops([plant], Application(compensate=True), 2, noise, (2e-4 * 16) ** 2, 1e-3, 1.37)
    return loop, PidFamily(4.0)(0.2), runnable(PidFamily(4.0)(0.2), loop.compensator, limit, {})


@pytest.mark.parametrize("limit", [np.inf, 0.05])
def test_single_precision_takes_the_form_that_it_holds(tmp_path, limit):
    """As designed the output errs by more than 1e-5 of itself; the C that is written does not, at a limit either."""
    _, _, whole = slow_controller(limit)
    controller = error_driven(whole)
    held = in_single_precision(controller)
    assert rounding_error(controller) > 1e-5 and held.error < LOST_LITTLE and held.form != "as designed"
    rng = np.random.default_rng(2)
    given = 1e-3 * (rng.standard_normal((1, 20_000)) + np.cumsum(rng.standard_normal(20_000)) / 50).astype(
        np.float32
    )
    flags = np.zeros(given.shape[1], np.int32)
    found = run_controller(
        controller_code(controller, "slow", "single"), tmp_path, given, 1, np.float32, flags=flags
    )
    wanted = controller.run(given.astype(float))
    if limit == np.inf:
        assert np.std(found - wanted) < 5 * LOST_LITTLE * np.std(wanted)
    else:
        assert np.mean(flags & 1) > 0.02 and np.abs(found - wanted).max() < 1e-4 * limit
    # Each form is the same controller, in double precision.
    omega = np.geomspace(0.1, 3000, 200)
    for form in (by_modes, balanced_form):
        other = form(controller)
        ours, theirs = (each.linear.frequency_response(omega)[0, 0] for each in (controller, other))
        assert theirs == pytest.approx(ours, rel=1e-7)
        assert other.run(given[:, :500].astype(float)) == pytest.approx(
            wanted[:, :500], abs=1e-7 * np.abs(wanted).max()
        )


def test_single_precision_is_refused_where_no_form_holds_the_output(monkeypatch):
    loop, _, whole = slow_controller()
    written = error_driven(whole)
    rows = dict(single_rows([written], [[(loop, whole)]], (1.0, 1.0)))
    assert "error of the output" in rows["single precision"]
    with pytest.raises(InputError, match=r"^precision: .* peaks at .* use double"):
        single_rows([written], [[(loop, whole)]], (1.0, 40.0))
    monkeypatch.setattr(single_precision, "LOST_MOST", 1e-12)
    with pytest.raises(InputError, match=r"^precision: in single precision .* use double"):
        controller_code(written, "slow", "single")


def test_biquads_are_judged_by_what_the_loop_makes_of_them():
    """At 10 kHz a PID of 0.5 Hz loses digits in its sections, and keeps its peaks; with a mode it would ring it is none."""
    mass = modal_model(np.array([[2.0]]), np.array([[0.0]]), [[1.0]], [[1.0]])
    loop, pid = make_loop(mass, sample_time=1e-4, delay=1.0), PidFamily(2.0)(0.3)
    whole = tied_to_error(runnable(pid, loop.compensator, np.inf, {}))
    found = checked_biquads(error_driven(whole), [(loop, whole)])
    assert 1e-9 < found["relative_error"] < 1e-3
    peak = 20 * np.log10(loop.peak(pid, "output_sensitivity").magnitude)
    assert found["peak_db"] == pytest.approx(peak, abs=1e-3)
    assert checked_biquads(error_driven(whole), [(loop, whole)], drive=0.2) is None
