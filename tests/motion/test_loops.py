"""Loop functions and the bandwidth search, compared with state-space loops, exact norms and python-control."""

from types import SimpleNamespace

import control
import numpy as np
import pytest

from experiments.motion.designs import (
    DESIGNS,
    stage_compensator,
    stage_loops,
    stage_observer,
)
from experiments.motion.machines import chain, published_noise, stage, stage_mass
from stillwork.base.checks import InputError
from stillwork.control.applications import Application, compensator, soft_sensor
from stillwork.control.bandwidth import (
    SIX_DB,
    Infeasible,
    PeakConstraint,
    SearchLoop,
    highest_peaks,
    is_feasible,
    make_loop,
    maximise_bandwidth,
)
from stillwork.control.loops import channel, closed_loop
from stillwork.control.pid import Notch, PidFamily
from stillwork.estimation.observer import kalman_observer
from stillwork.lti import StateModel, interconnect

FAMILY = PidFamily(stage_mass())
OMEGA = 2 * np.pi * np.array([0.5, 20.0, 60.0, 140.0, 469.0, 900.0])


@pytest.mark.parametrize(("notches", "lead"), [((), 3.0), ((3000.0, 6000.0), 2.0)])
def test_controller_realisation(notches, lead):
    pid = PidFamily(12.5, notches, lead)(40.0)
    s, w = 1j * OMEGA, 2 * np.pi * 40
    low_pass = (lead * w) ** 2 / (s**2 + 1.4 * lead * w * s + (lead * w) ** 2)
    expected = 12.5 * w**2 / lead * (s + w / lead**2) / s * (lead * s / w + 1) * low_pass
    for each in notches:
        expected = expected * Notch(each).at(s)
    np.testing.assert_allclose(pid.frequency_response(OMEGA), expected, rtol=1e-12)
    np.testing.assert_allclose(pid.state_space().frequency_response(OMEGA)[0, 0], expected, rtol=1e-9)


def test_an_unstable_loop_has_an_infinite_peak_and_no_loops_are_refused():
    loops = stage_loops(DESIGNS["PID"])
    assert not all(loop.is_stable(FAMILY(300.0)) for loop in loops)
    assert highest_peaks(loops, FAMILY(300.0), ["true_tracking"])["true_tracking"].magnitude == np.inf
    with pytest.raises(InputError, match=r"^loops"):
        highest_peaks([], FAMILY(300.0), ["true_tracking"])
    with pytest.raises(InputError, match=r"^functions"):
        highest_peaks(loops, FAMILY(300.0), ["true_trackin"])


@pytest.mark.parametrize("name", ["MC", "AD", "MC and AD"])
def test_closed_forms_agree_with_the_state_space_loop(name):
    plant, pid = stage().at([0], [4]), FAMILY(40.0)
    block = stage_compensator(5, DESIGNS[name])
    response = make_loop(plant, block).at(pid, OMEGA)
    loop = closed_loop(plant, block, pid.state_space())
    for ours, (source, target) in {
        "input_sensitivity": ("u_ff", "u"),
        "output_sensitivity": ("v", "e_true"),
        "true_tracking": ("r", "e_true"),
    }.items():
        theirs = channel(loop, source, target).frequency_response(OMEGA)[0, 0]
        np.testing.assert_allclose(getattr(response, ours), theirs, rtol=1e-6, err_msg=ours)
    np.testing.assert_allclose(
        response.input_sensitivity, channel(loop, "r", "e_meas").frequency_response(OMEGA)[0, 0], rtol=1e-6
    )


def test_loop_without_observer_is_that_of_python_control():
    plant, pid = stage().at([0], [4]), FAMILY(30.0)
    loop = closed_loop(plant, None, pid.state_space())
    theirs = control.feedback(control.ss([], [], [], 1), plant.to_control() * pid.state_space().to_control())
    ours = channel(loop, "r", "e_true").frequency_response(OMEGA)[0, 0]
    np.testing.assert_allclose(ours, theirs(1j * OMEGA), rtol=1e-7)
    assert np.abs(channel(loop, "d", "e_true").frequency_response(OMEGA)[0, 0] + ours - 1).max() < 1e-7


def test_two_by_two_loop_obeys_its_definition():
    plant = chain(np.full(4, 2.0)).at([0, 3], [0, 3])
    one = PidFamily(4.0)(2.0).state_space()
    two = interconnect([one, one], np.zeros((2, 2)), np.eye(2), np.eye(2))
    loop = closed_loop(plant, None, two)
    omega = np.array([5.0, 30.0, 200.0])
    p, c = plant.frequency_response(omega), two.frequency_response(omega)
    s_i, s_o = (
        channel(loop, a, b, 2, 2).frequency_response(omega) for a, b in (("u_ff", "u"), ("v", "e_true"))
    )
    for k in range(len(omega)):
        assert np.allclose(
            s_i[..., k], np.linalg.inv(np.eye(2) + c[..., k] @ p[..., k]), rtol=1e-7, atol=1e-9
        )
        assert np.allclose(
            s_o[..., k], np.linalg.inv(np.eye(2) + p[..., k] @ c[..., k]), rtol=1e-7, atol=1e-9
        )


def test_separation_of_observer_and_controller():
    """(3.46): without discarded modes the closed loop has the poles of the observer and of the state feedback."""
    plant = stage().at([0], [4]).modes(slice(0, 4))
    observer = kalman_observer(plant, published_noise())
    block = compensator(observer, Application(compensate=True, damping=0.035))
    poles = closed_loop(plant, block, FAMILY(40.0).state_space()).poles
    for pole in np.linalg.eigvals(observer.a - observer.gain @ observer.c):
        assert np.abs(poles - pole).min() < 1e-4 * abs(pole)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["PID", "MC", "AD"])
def test_the_search_ends_where_looking_at_everything_at_every_step_ends(name):
    """A scan so coarse that two or three other constraints stop the search on its way to the end."""
    limits = [PeakConstraint(function) for function in DESIGNS[name].constraints]
    loops = stage_loops(DESIGNS[name])
    found = maximise_bandwidth(loops, FAMILY, limits, 20.0, 150.0, 3, tolerance_hz=0.01)
    good, bad = 20.0, 85.0
    while bad - good > 0.01:
        middle = (good + bad) / 2
        good, bad = (middle, bad) if is_feasible(loops, FAMILY(middle), limits) else (good, middle)
    assert found.design_hz == good
    peaks = [
        (loops[k].peak(FAMILY(bad), each.function), each.function, k) for each in limits for k in range(7)
    ]
    assert (found.peak, found.function, found.loop) == max(peaks)


class CoupledCarts:
    """A reader's own loop of two axes: two carts that one spring joins, each with a slow drive and its PID."""

    omega = 2 * np.pi * np.geomspace(0.1, 500.0, 800)
    spring = 1e4 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    drive = StateModel(*map(np.array, ([[0.0, 1.0], [-9e4, -480.0]], [[0.0], [9e4]], [[1.0, 0.0]], [[0.0]])))

    def at(self, pids, omega=None):
        w = (self.omega if omega is None else omega)[:, None, None]
        plant = (
            np.linalg.inv(self.spring + (40j * w - 5.0 * w**2) * np.eye(2)) * 9e4 / (9e4 + 480j * w - w**2)
        )
        loop = plant * np.array([pid.frequency_response(w[:, 0, 0]) for pid in pids]).T[:, None, :]
        return SimpleNamespace(
            input_sensitivity=np.linalg.norm(np.linalg.inv(np.eye(2) + loop), 2, axis=(1, 2))
        )

    def within(self, pids, part):
        return self.at(pids, self.omega[part])

    def poles(self, pids):
        a = np.block([[np.zeros((2, 2)), np.eye(2)], [-self.spring / 5.0, -8.0 * np.eye(2)]])
        carts = StateModel(a, np.eye(4)[:, 2:] / 5.0, np.eye(4)[:2], np.zeros((2, 2)))
        wired = np.kron([[0, 1, 0], [0, 0, 1], [-1, 0, 0]], np.eye(2))  # each takes the next one's output
        blocks = [carts, self.drive, self.drive, *(pid.state_space() for pid in pids)]
        return interconnect(blocks, wired, np.zeros((6, 1)), np.zeros((1, 6))).poles

    def crossing_hz(self, pids):
        return np.array([1.0, 2.0])


@pytest.mark.slow
@pytest.mark.parametrize("refine", [True, False])
@pytest.mark.parametrize("lowest", [True, False])
def test_a_loop_of_several_axes_is_searched_alike(lowest, refine):
    loop, limits = CoupledCarts(), [PeakConstraint("input_sensitivity")]
    assert isinstance(loop, SearchLoop)
    axis = PidFamily(5.0)

    def family(hertz):
        return axis(hertz), axis(hertz / 2)

    found = maximise_bandwidth([loop], family, limits, 1.5, 50.0, lowest=lowest, refine=refine)
    assert found.controller == family(found.design_hz) and found.crossing_hz.shape == (1, 2)

    def feasible(hertz):
        return loop.at(family(hertz)).input_sensitivity.max() < SIX_DB and np.all(
            loop.poles(family(hertz)).real < 0
        )

    scanned = np.geomspace(1.5, 50.0, 120)
    kept = np.array([feasible(hertz) for hertz in scanned])
    assert kept.any() and not kept.all()
    last = np.flatnonzero(kept)[-1] if not lowest else np.flatnonzero(np.diff(kept.astype(int)) < 0)[0]
    assert scanned[last] - 1e-3 <= found.design_hz <= scanned[last + 1]


def test_a_search_does_not_end_at_an_unstable_design_whose_peaks_are_low():
    unstable = SimpleNamespace(
        omega=np.ones(3),
        at=lambda pid, omega=(1.0,) * 3: SimpleNamespace(input_sensitivity=np.full(len(omega), 1.5)),
        within=lambda pid, part: None,
        poles=lambda pid: np.array([-1.0 + 0j if pid.gain < FAMILY(30.0).gain else 1.0 + 0j]),
        crossing_hz=lambda pid: 1.0,
    )
    for limit in (SIX_DB, 100.0):
        found = maximise_bandwidth(
            [unstable], FAMILY, [PeakConstraint("input_sensitivity", limit)], 20.0, 60.0, lowest=True
        )
        assert found.design_hz == pytest.approx(30.0, abs=1e-3) and found.function == "stability"
    with pytest.raises(Infeasible, match=r"\b40 \w+ 60 Hz.*stability"):
        maximise_bandwidth([unstable], FAMILY, [PeakConstraint("input_sensitivity")], 40.0, 60.0, lowest=True)


def test_soft_sensor_gives_the_other_mass():
    plant = stage()
    observer = stage_observer(5)
    sensor = soft_sensor(observer, observer.model.output_shapes * 0 + plant.output_shapes[1:2, :4])
    omega = np.array([2 * np.pi * 30.0])
    p5, p2 = (plant.at([0], [k]).frequency_response(omega)[0, 0] for k in (4, 1))
    force, measured = sensor.frequency_response(omega)[0]
    # Modes that the observer does not hold are missing: their compliance is all that is left.
    estimate = force + measured * p5
    hidden = plant.modes(slice(4, None)).at([0], [4, 1]).compliance()[:, 0]
    assert abs(estimate - p2) < 1.5 * np.abs(hidden).sum()
    assert abs(estimate - p2) < 0.2 * abs(p5 - p2)
