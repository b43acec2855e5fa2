"""The machine of the topic, who tunes its feedforward, and who differentiates: each against a formula or a simulation."""

import itertools

import numpy as np
import pytest
from scipy import linalg

from experiments.budget.machine import FLOORS, budget_of, machine, on_every_floor, stage
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
