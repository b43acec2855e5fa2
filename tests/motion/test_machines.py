"""Machines and their reduction, compared with the published parameters and direct solutions in nodal form."""

import numpy as np
import pytest

from experiments.motion.machines import chain, chain_matrix, drive, parameters, stage, stage_mass
from notebooks.motion.discretisation import discrete_compliance, transition
from stillwork.lti.discretisation import zoh_modes
from stillwork.lti.reduction import truncate


def test_stage_is_the_published_one():
    model = stage()
    assert stage_mass() == pytest.approx(12.5, rel=1e-12)
    assert model.rigid_modes == 1
    assert len(model.frequencies) == 8
    # A rigid body: phi_s phi_a = 1/M for every mass.
    np.testing.assert_allclose(model.output_shapes[:, 0] * model.input_shapes[0, 0], 1 / 12.5, rtol=1e-10)


def test_chain_in_nodal_form():
    masses = np.array([1.6, 2.6, 1.6, 1.6, 1.6])
    model, p = chain(masses), parameters("chain")
    links = chain_matrix(np.ones(4))
    omega = np.array([1.0, 200.0, 400.0])
    direct = [
        np.linalg.inv((p["stiffness"] + 1j * w * p["damper"]) * links - w**2 * np.diag(masses)) for w in omega
    ]
    np.testing.assert_allclose(model.frequency_response(omega), np.moveaxis(direct, 0, -1), rtol=1e-8)


def test_drive_in_nodal_form():
    d = drive()
    omega = np.array([5.0, 118.0, 700.0])
    link = np.array([[1, -1], [-1, 1]])
    direct = [
        np.linalg.inv(
            (d.stiffness + 1j * w * d.damper) * link + (1j * w * d.friction - w**2 * d.inertia) * np.eye(2)
        )
        for w in omega
    ]
    expected = d.motor_constant * np.array([h[0, 1] for h in direct])
    np.testing.assert_allclose(d.modal_states().frequency_response(omega)[0, 0], expected, rtol=1e-8)


def test_reduction_and_discretisation_commute():
    """Theorem 2.4.1: truncate then discretise, or discretise then truncate."""
    model = stage().at([0], [4])
    first = zoh_modes(truncate(model, 4, 4), 1e-4)
    whole = zoh_modes(model, 1e-4)
    kept = slice(0, 8)
    assert np.array_equal(first.a, whole.a[kept, kept])
    assert np.array_equal(first.b, whole.b[kept])
    discarded = zoh_modes(model.modes(slice(4, None)), 1e-4)
    np.testing.assert_allclose(discrete_compliance(discarded), first.d, rtol=1e-10)


def test_printed_transition_lacks_a_factor():
    w, z, sample_time = 3e3, 0.3, 1e-4
    exact, printed = (transition(w, z, sample_time, name) for name in ("exact", "printed"))
    np.testing.assert_allclose(np.diag(printed), np.diag(exact), rtol=1e-14)
    assert printed[0, 1] / exact[0, 1] == pytest.approx(np.sqrt(1 - z**2), rel=1e-12)
    small = [transition(w, 1e-4, sample_time, name) for name in ("exact", "lightly damped")]
    assert np.allclose(*small, rtol=1e-3, atol=1e-3 * np.abs(small[0]).max())
    mode = stage().modes([3])
    z, w = mode.damping[0], mode.frequencies[0]
    np.testing.assert_allclose(zoh_modes(mode, sample_time).a, transition(w, z, sample_time), rtol=1e-12)
