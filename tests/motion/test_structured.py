"""Gains proven over uncertain numbers: never below what a perturbed model shows, and hardly above it."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.motion import stage
from stillwork.control import PidFamily, closed_loop, uncertain_channel
from stillwork.control.loops import channel as pick
from stillwork.lti import StateModel, hinf_norm, prove_gain


def drawn(seed, numbers=3):
    """A random stable model of a few states with uncertain numbers that leave it stable."""
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(4, 4))
    a -= (0.3 + np.linalg.eigvals(a).real.max()) * np.eye(4)
    size = 0.25
    b, c, d = (
        rng.normal(size=(4, numbers + 1)),
        rng.normal(size=(numbers + 1, 4)),
        np.zeros((numbers + 1,) * 2),
    )
    b[:, :numbers] *= size
    d[-1, -1] = rng.normal()
    return StateModel(a, b, c, d)


def closed(model, delta):
    n = len(delta)
    a = model.a + model.b[:, :n] @ np.diag(delta) @ model.c[:n]
    return StateModel(a, model.b[:, n:], model.c[n:], model.d[n:, n:])


def worst(model, numbers, seed, count=120):
    rng = np.random.default_rng(seed)
    draws = [*rng.choice([-1.0, 1.0], (count // 2, numbers)), *rng.uniform(-1, 1, (count // 2, numbers))]
    models = [closed(model, delta) for delta in draws]
    return max(hinf_norm(each).magnitude if each.is_stable else np.inf for each in models)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_what_is_proven_no_perturbed_model_exceeds(seed):
    model = drawn(seed)
    reached = worst(model, 3, seed)
    if np.isinf(reached):
        assert not prove_gain(model, 3, 1e6).proven
        return
    assert not prove_gain(model, 3, 0.999 * reached).proven
    assert prove_gain(model, 3, 1.5 * reached).proven


def test_without_uncertain_numbers_it_is_the_norm():
    model = closed(drawn(3), np.zeros(3))
    norm = hinf_norm(model).magnitude
    assert prove_gain(model, 0, 1.001 * norm).proven
    assert not prove_gain(model, 0, 0.999 * norm).proven


def test_the_edge_of_stability_is_found():
    """A mode whose stiffness is uncertain by all of it has a pole at zero at the end."""
    model = StateModel(
        np.array([[0.0, 1.0], [-1.0, -0.5]]),
        np.array([[0.0, 0.0], [1.0, 1.0]]),
        np.array([[-1.0, 0], [1, 0]]),
        np.zeros((2, 2)),
    )
    assert not prove_gain(model, 1, 1e9).proven
    scaled = StateModel(model.a, model.b * [0.9, 1.0], model.c, model.d)
    assert prove_gain(
        scaled, 1, 10.2
    ).proven  # 1 / (1 - 0.9) at standstill, and the resonance of what is left
    assert not prove_gain(scaled, 1, 9.9).proven


@pytest.mark.slow
@pytest.mark.parametrize(
    ("frequency", "channel"), [(0.01, ("u_ff", "u")), (0.03, ("v", "e_true")), (0.03, ("r", "e_true"))]
)
def test_perturbed_stages_stay_below_what_is_proven_of_their_loop(frequency, channel):
    """Modes at any frequency within the bound, damping that follows, and the actuator's gain by itself."""
    plant = stage().at([0], [4]).modes(slice(0, 3))
    pid = PidFamily(12.5)(20.0).state_space()
    model, count = uncertain_channel(plant, None, pid, *channel, frequency=frequency, gain=0.05)
    rng, reached = np.random.default_rng(1), 0.0
    for _ in range(30):
        off, gain = rng.choice([-1, 1, *rng.uniform(-1, 1, 2)], 3), 1 + 0.05 * rng.choice([-1, 0, 1])
        moved = replace(
            plant,
            frequencies=plant.frequencies * (1 + frequency * off),
            input_shapes=gain * plant.input_shapes,
        )
        loop = closed_loop(moved, None, pid)
        reached = max(reached, hinf_norm(pick(loop, *channel)).magnitude)
    assert not prove_gain(model, count, 0.99 * reached).proven
    assert prove_gain(model, count, 1.1 * reached).proven


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1e-9, 1e-6, 1e6, 1e9])
def test_a_proof_does_not_hang_on_the_unit_of_an_input(unit):
    model = StateModel(
        np.array([[-1.0]]), np.array([[0.5, unit]]), np.array([[-1.0], [1.0]]), np.zeros((2, 2))
    )
    assert [prove_gain(model, 1, level * unit).proven for level in (1.99, 2.01, 1000.0)] == [
        False,
        True,
        True,
    ]
