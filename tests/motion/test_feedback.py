"""Active damping and its observer: definitions and invariants."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg

from experiments.motion.designs import stage_observer
from experiments.motion.machines import chain, published_noise, stage
from stillwork.control.applications import Application, compensator
from stillwork.control.feedback import damping_gain
from stillwork.estimation.observer import kalman_observer
from stillwork.lti.reduction import truncate


def test_state_feedback_leaves_the_zeros_where_they_are():
    """Remark 3.3.2: zeros of (A + BK, B, C) are those of (A, B, C)."""
    model = chain(np.full(4, 2.0)).at([0], [1])
    states = model.state_space()
    gain = damping_gain(model, 0.05)

    def zeros(a):
        pencil = np.block([[a, states.b], [states.c, states.d]])
        mass = np.zeros_like(pencil)
        mass[: len(a), : len(a)] = np.eye(len(a))
        values = linalg.eigvals(pencil, mass)
        values = values[np.isfinite(values) & (np.abs(values) < 1e6)]
        return np.sort(np.abs(values))

    before, after = zeros(states.a), zeros(states.a + states.b @ gain)
    np.testing.assert_allclose(before[:4], after[:4], rtol=1e-6)


def test_compensator_reads_what_the_definition_says():
    observer = stage_observer(5, noise_model=0.03)
    block = compensator(
        observer, Application(compensate=True, damping=0.035, selectivity=2.0, high_pass_hz=1.0)
    )
    omega = 2 * np.pi * np.array([0.3, 40.0, 469.0, 950.0])
    s = 1j * omega
    model, a_o = observer.model, observer.a - observer.gain @ observer.c
    b_o = np.hstack([observer.b - observer.gain @ model.feedthrough, observer.gain])
    estimate = np.stack([np.linalg.solve(p * np.eye(len(a_o)) - a_o, b_o) for p in s], axis=-1)
    flexible = np.einsum("m,mif->if", model.output_shapes[0, 1:], estimate[2:8:2])
    high_pass = s / (s + 2 * np.pi)
    damped = 0
    for k, (w, phi) in enumerate(zip(model.frequencies[1:], model.input_shapes[1:, 0], strict=True)):
        h = w / 2 * s / (s**2 + w / 2 * s + w**2)
        damped = damped - 2 * 0.035 * w / phi * h * estimate[3 + 2 * k]
    response = block.frequency_response(omega)
    assert np.allclose(response[0], damped, rtol=1e-7, atol=1e-9 * np.abs(damped).max())
    assert np.allclose(response[1], high_pass * flexible, rtol=1e-7, atol=1e-9 * np.abs(flexible).max())


def test_velocity_observer_leaves_the_rigid_position_out():
    reduced = replace(truncate(stage().at([0], [4]), 4), measures="velocity")
    observer = kalman_observer(reduced, published_noise())
    assert len(observer.a) == 7
    # It reads the velocities of the flexible modes, states 2, 4 and 6 after the rigid velocity.
    assert np.array_equal(np.flatnonzero(observer.flexible_outputs[0]), [2, 4, 6])
    # A constant force and no measured speed leave a constant innovation, which corrects the modal positions
    # at a constant rate: the estimated velocities do not vanish. The noise model takes the innovation away.
    plain, mended = (
        compensator(kalman_observer(reduced, published_noise(), q), Application(compensate=True))
        for q in (None, 0.03)
    )
    spoiled, kept = (np.abs(block.frequency_response([1e-4])[1, 0, 0]) for block in (plain, mended))
    innovation = reduced.input_shapes[0, 0] / observer.gain[0, 0]
    expected = abs(observer.flexible_outputs[0, 2::2] @ observer.gain[1::2, 0] * innovation)
    assert spoiled == pytest.approx(expected, rel=1e-6)
    assert kept < 1e-2 * spoiled
