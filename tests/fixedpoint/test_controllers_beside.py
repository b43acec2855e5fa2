"""The machines of notebook 10 against energies and the paper's oscillator, its scores, and one of its searches again."""

import numpy as np
import pytest

from experiments.fixedpoint.oscillator import load_oscillator
from notebooks.fixedpoint import controllers_beside as beside
from stillwork.control.regressor import regressor_at


def kinetic(machine, q, v):
    """Of a column, two slender links and their loads, from velocities of points; without the column that of the plane arm."""
    p = beside.ARM | {"J": 0.1}
    turn, shoulder, elbow = q if len(q) == 3 else np.r_[0.0, q]

    def at(distances):
        a, b = shoulder, shoulder + elbow
        out = distances[0] * np.cos(a) + distances[1] * np.cos(b)
        return np.array(
            [out * np.cos(turn), out * np.sin(turn), distances[0] * np.sin(a) + distances[1] * np.sin(b)]
        )

    speeds = v if len(v) == 3 else np.r_[0.0, v]
    place = np.array([turn, shoulder, elbow])

    def speed_of(distances):
        nonlocal turn, shoulder, elbow
        turn, shoulder, elbow = place + 1e-6 * speeds
        ahead = at(distances)
        turn, shoulder, elbow = place - 1e-6 * speeds
        behind = at(distances)
        turn, shoulder, elbow = place
        return (ahead - behind) / 2e-6

    total = p["J"] * speeds[0] ** 2 / 2
    for mass, inertia, distances, angle, rate in (
        (p["m1"], p["I1"], (p["c1"], 0.0), place[1], speeds[1]),
        (p["m2"], p["I2"], (p["l1"], p["c2"]), place[1] + place[2], speeds[1] + speeds[2]),
    ):
        moved = speed_of(distances)
        # A slender link turns about the two axes across it.
        total += mass * moved @ moved / 2 + inertia * (rate**2 + (speeds[0] * np.cos(angle)) ** 2) / 2
    return total


@pytest.mark.parametrize("name", ["two-link arm", "3-axis arm"])
def test_an_arm_is_its_energy(name, rng):
    """M from the kinetic energy of points, C from Christoffel's symbols, weight from the height."""
    machine = beside.MACHINES[name]
    model, n = machine.model, machine.axes
    for _ in range(5):
        q, v, a = rng.uniform(-1.5, 1.5, (3, n))
        assert v @ model.mass(q) @ v / 2 == pytest.approx(kinetic(machine, q, v), rel=1e-7)
        slopes = np.array([(model.mass(q + 1e-5 * e) - model.mass(q - 1e-5 * e)) / 2e-5 for e in np.eye(n)])
        turning = np.einsum("kij,k,j->i", slopes, v, v) - np.einsum("ijk,j,k->i", slopes, v, v) / 2
        weight = model.force(q, np.zeros(n), np.zeros(n))
        friction = model.parameters[-2 * n : -n] * v
        assert model.force(q, v, a) == pytest.approx(
            model.mass(q) @ a + turning + weight + friction, abs=1e-7
        )
        arm, (shoulder, elbow) = beside.ARM, q[-2:]

        def potential(shoulder, elbow, p=arm):
            near = (p["m1"] * p["c1"] + p["m2"] * p["l1"]) * np.sin(shoulder)
            return 9.81 * (near + p["m2"] * p["c2"] * np.sin(shoulder + elbow))

        slope = [
            (potential(shoulder + d, elbow + e) - potential(shoulder - d, elbow - e)) / 2e-6
            for d, e in ((1e-6, 0.0), (0.0, 1e-6))
        ]
        assert weight[-2:] == pytest.approx(slope, abs=1e-6)
        assert regressor_at(model, q, v, v, a) @ model.parameters == pytest.approx(model.force(q, v, a))


def test_a_payload_is_a_point_at_the_end(rng):
    """It adds the kinetic energy of its own velocity."""
    machine = beside.MACHINES["two-link arm"]
    numbers = beside.ARM | {"payload": 0.0, "f1": 0.0, "f2": 0.0}
    light, laden = machine.mechanism(numbers), machine.mechanism(numbers | {"payload": 1.3})
    q, v = rng.uniform(-1, 1, (2, 2))
    a, b = q[0], q[0] + q[1]
    speed = beside.ARM["l1"] * v[0] * np.array([-np.sin(a), np.cos(a)])
    speed = speed + beside.ARM["l2"] * (v[0] + v[1]) * np.array([-np.sin(b), np.cos(b)])
    more = v @ (laden.mass(q) - light.mass(q)) @ v / 2
    assert more == pytest.approx(1.3 * speed @ speed / 2)


def test_the_oscillator_is_the_paper_s(rng):
    machine, known = beside.MACHINES["oscillator"], load_oscillator()["approximate"].plant
    for _ in range(5):
        q, v, a = rng.uniform(-2, 2, 3)
        expected = known.force(q, v, a, known.parameters)
        assert machine.model.force([q], [v], [a]) == pytest.approx(expected)


def test_runs_that_diverge_can_be_left_out():
    """A diverged run is an error of 1; a plant on which all runs diverge is left out with them."""
    errors = {law: np.full((4, 2, 3), value) for law, value in ((beside.FIXED, 0.1), (beside.COMPUTED, 0.2))}
    errors[beside.FIXED][0, 0, 0] = errors[beside.COMPUTED][1, 1, 0] = 1.0
    errors[beside.FIXED][:, :, 2] = 1.0
    how = {"oscillator": errors}, beside.FIXED, beside.COMPUTED, ("oscillator",)
    value, (low, high) = beside.compared(*how, held=True)
    assert [value, low, high] == pytest.approx([0.5, 0.5, 0.5])
    plants = [(6 * np.log(0.5) + np.log(5) + np.log(0.1)) / 8, np.log(0.5), np.log(5)]
    assert beside.compared(*how)[0] == pytest.approx(np.exp(np.mean(plants)))


@pytest.mark.slow
def test_a_search_finds_again_what_is_stored():
    found = beside.tune("oscillator", beside.COMPUTED, 13, "position")
    assert found == pytest.approx(beside.tuned("oscillator", beside.COMPUTED, 13), rel=1e-2)
