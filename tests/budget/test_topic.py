"""The machine of the topic, who tunes its feedforward, and who differentiates: each against a formula or a simulation."""

import itertools

import numpy as np
import pytest
from scipy import linalg

from experiments.budget.machine import FLOORS, budget_of, machine, on_every_floor, parameters, stage
from notebooks.budget import the_machine, which_one_pays
from notebooks.budget.which_one_pays import (
    CHOICES,
    NOISES,
    SAMPLE_S,
    differentiator,
    order_of_purchase,
    tuning_trial,
)


def test_the_machine_has_the_printed_mass_and_the_first_estimates_suspension():
    built = machine()
    assert built.stage_mass == pytest.approx(12.5) and built.suspension_hz == pytest.approx(12.3, abs=0.05)
    k = (
        np.diag([1e8, *[1e8 + 9.6e7], *[2 * 9.6e7] * 5, 9.6e7])
        - np.diag([1e8, *[9.6e7] * 6], 1)
        - np.diag([1e8, *[9.6e7] * 6], -1)
    )
    squares = linalg.eigvalsh(k, np.diag([2.5, *[10 / 7] * 7]))
    np.testing.assert_allclose(stage().frequencies[1:], np.sqrt(squares[1:]), rtol=1e-9)


def test_floors_at_once_are_those_of_one_budget_each():
    built = machine(skyhook=True)
    by_floor, others = on_every_floor(built)
    for name in ("VC-C", "slab under footfall"):
        powers = budget_of(built, name).powers[:, 0]
        np.testing.assert_allclose([by_floor[FLOORS.index(name)], *others], powers, rtol=1e-5)


def test_purchases_end_where_none_saves_enough_and_are_greedy():
    order = order_of_purchase(FLOORS.index("VC-A"), 1.4, 0.0)
    errors = [
        which_one_pays.error(frozenset(order[:k]), FLOORS.index("VC-A"), 1.4, 0.0)
        for k in range(len(order) + 1)
    ]
    assert order[0] == "feedforward" and all(
        after < 0.95 * before for before, after in itertools.pairwise(errors)
    )


@pytest.mark.parametrize("noise", NOISES)
def test_no_weights_leave_less_than_the_best_and_quiet_sensors_allow_more(noise):
    trial = tuning_trial("VC-D", noise, 1)
    assert all(value > -1e-12 for value in trial.excess.values()) and 0 < trial.optimum < 1
    assert tuning_trial("VC-D", noise / 10, 1).optimum < trial.optimum


@pytest.mark.parametrize("name", ["quotient", "low pass", "window", "Kalman"])
def test_a_law_is_the_pid_where_its_filter_passes(name):
    """At a tenth of the bandwidth: gain, integral and derivative of the rules of Table 3.3, written by hand."""
    hertz, mass = 60.0, 12.5
    w, s = 2 * np.pi * hertz, 2j * np.pi * 0.1 * hertz
    wanted = -mass * (w**2 / 3 + w**3 / 27 / s + w * s)
    found = differentiator(
        name, CHOICES[name][-1 if name != "window" else 0], hertz, mass
    ).frequency_response([s.imag])[0, 0, 0]
    assert found == pytest.approx(wanted, rel=0.05)


def test_the_observers_velocity_is_the_true_one_of_a_body_that_its_force_moves():
    """Closed on a free mass sample by sample: after the start the law's command is the PID's of the true state."""
    hertz, mass, t = 60.0, 12.5, SAMPLE_S
    law = differentiator("observer of the stage", 4.0, hertz, mass)
    w = 2 * np.pi * hertz
    x, v, z, integral = 1e-6, 0.0, np.zeros(len(law.a)), 0.0
    for _ in range(400):
        force = float((law.c @ z + law.d[:, 0] * x)[0])
        z = law.a @ z + law.b[:, 0] * x
        pid = -mass * (w**2 / 3 * x + w**3 / 27 * t * (integral + x) + w * v)
        integral += x
        x, v = x + t * v + t**2 / 2 * force / mass, v + t * force / mass
    assert force == pytest.approx(pid, rel=1e-6, abs=1e-9) and abs(x) < 1e-6


def test_the_printed_specification_and_the_estimate():
    found = the_machine.printed_specification()
    assert (round(found["Dx"], 1), round(found["Rx"], 1)) == (12.1, 241.8)
    again = the_machine.estimate_again()
    assert again["37"][1][0] == pytest.approx(again["37"][0][0] / 10**1.5, rel=0.02)  # 30 dB


@pytest.mark.parametrize("offset", [0.0, 0.12])
def test_six_axes_are_what_the_equations_of_motion_give(offset):
    """Passive, by dynamic stiffness at each frequency: six equations of the body, one of the stage, one of its PID."""
    network = the_machine.six_axis_network(False, False, offset)
    built, (ends, along) = machine(), the_machine.struts()
    p = parameters().table("six_axes")
    vertical = np.sum(along[:, 2] ** 2)
    k, d, _ = np.array(built.suspension) / vertical
    lines = np.hstack([along, np.cross(ends, along)])
    m, own = built.frame_mass, built.stage_mass
    masses = np.diag([m + own, m + own, m, *(m * np.square(p["gyration"]))])
    beside = np.array([0, 0, 1, 0, -offset, 0])
    for hertz in (0.7, 5.0, 14.0, 40.0):
        w = 2 * np.pi * hertz
        stiffness = lines.T @ lines * (k + 1j * w * d) - w**2 * masses
        compliance = built.stage.frequency_response([w])[0, 0, 0]
        pid = built.controller.frequency_response(np.array([w]))[0]
        for axis in range(3):
            push = (
                -np.diag(masses)[:3][axis] * np.eye(6)[axis]
            )  # of 1 m/s^2, in motions relative to the floor
            # unknown: motion of the body q, position of the stage x, force on it f
            a = np.zeros((8, 8), complex)
            a[:6, :6], a[:6, 7] = stiffness, beside
            a[6, 6], a[6, 7] = 1, -compliance
            a[7, :6], a[7, 6], a[7, 7] = -pid * beside, pid, 1
            x = np.linalg.solve(a, np.concatenate([push, [1 / w**2 * (axis == 2), 0]]))
            wanted = x[6] - beside @ x[:6]
            found = network.paths([hertz])[0, axis, 0]
            assert abs(found - wanted) < 1e-6 * max(abs(wanted), 1e-9)
