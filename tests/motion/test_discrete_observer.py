from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg, signal

from experiments.motion.machines import published_noise, stage
from notebooks.motion.discrete_observer import (
    equivalent_plant,
    gain_by_placement,
    placement_error,
    typical_placement_error,
)
from stillwork.base.checks import InputError
from stillwork.control.applications import Application
from stillwork.control.discrete_damping import discrete_damping_gain, sampled_feedback
from stillwork.control.discrete_observer import discrete_compensator, discrete_kalman_observer
from stillwork.control.feedback import band_pass, damping_gain
from stillwork.estimation.observer import NoiseIntensities
from stillwork.lti import simulate, zoh
from stillwork.lti.discretisation import late_modes, zoh_modes
from stillwork.lti.modal import ModalModel
from stillwork.lti.reduction import truncate

SAMPLE_TIME = 1e-4


@pytest.fixture(scope="module")
def reduced():
    return truncate(stage().at([0], [4]), 4, 3)


@pytest.fixture(scope="module")
def observer(reduced):
    return discrete_kalman_observer(reduced, published_noise(), SAMPLE_TIME, 0.03)


# --- damping gains -------------------------------------------------------------------------------------------


@given(sample_time=st.floats(1e-6, 3e-4), increase=st.floats(1e-3, 0.5))
@settings(max_examples=40)
def test_the_closed_form_places_the_poles_at_any_rate(reduced, sample_time, increase):
    gain = discrete_damping_gain(reduced, increase, sample_time)
    assert placement_error(reduced, gain, increase, sample_time) < 1e-6


def test_the_closed_form_is_what_general_placement_finds(reduced):
    gain = discrete_damping_gain(reduced, [0.03, 0.05, 0.01], SAMPLE_TIME)
    flexible = zoh_modes(reduced.modes([1, 2, 3]), SAMPLE_TIME)
    w, z = reduced.frequencies[1:], reduced.damping[1:] + np.array([0.03, 0.05, 0.01])
    wanted = np.exp(w * (-z + 1j * np.sqrt(1 - z**2)) * SAMPLE_TIME)
    placed = signal.place_poles(flexible.a, flexible.b, np.concatenate([wanted, wanted.conj()]))
    np.testing.assert_allclose(gain[:, 2:], -placed.gain_matrix, rtol=1e-6, atol=1e-6 * np.abs(gain).max())
    for method in ("Ackermann", "robust"):
        other = gain_by_placement(reduced, [0.03, 0.05, 0.01], SAMPLE_TIME, method)
        np.testing.assert_allclose(other, gain, rtol=1e-6, atol=1e-6 * np.abs(gain).max())


def test_the_typical_error_is_rounding_times_the_condition_of_the_poles(reduced):
    # First-order perturbation theory of the balanced matrix, over the way that the poles move.
    for sample_time in (1e-4, 1e-5, 1e-6):
        flexible = zoh_modes(reduced.modes([1, 2, 3]), sample_time)
        closed = flexible.a + flexible.b @ discrete_damping_gain(reduced, 0.035, sample_time)[:, 2:]
        _, left, right = linalg.eig(linalg.matrix_balance(closed)[0], left=True)
        condition = 1 / np.abs((left.conj() * right).sum(axis=0)).min()
        w, z = reduced.frequencies[1:], reduced.damping[1:]
        before, after = (
            np.exp(w * (-ratio + 1j * np.sqrt(1 - ratio**2)) * sample_time) for ratio in (z, z + 0.035)
        )
        expected = np.finfo(float).eps * condition / np.abs(after - before).min()
        found = typical_placement_error(reduced, 0.035, sample_time, "closed form")
        assert expected / 10 < found < 10 * expected


def test_a_late_force_damps_as_the_loop_stepped_by_hand_decays(reduced):
    one = reduced.modes([0, 1])
    gain = discrete_damping_gain(one, 0.035, SAMPLE_TIME)
    sampled = zoh_modes(one, SAMPLE_TIME)
    x, before, track = np.array([0.0, 0.0, 1.0, 0.0]), 0.0, []
    for _ in range(1500):
        now = float(gain[0] @ x)
        x, before = sampled.a @ x + sampled.b[:, 0] * before, now
        track.append(np.hypot(x[2], x[3] / one.frequencies[1]))
    late = sampled_feedback(one, gain, SAMPLE_TIME, delay=1)
    rate = np.polyfit(np.arange(500, 1500) * SAMPLE_TIME, np.log(track[500:]), 1)[0]
    assert -rate == pytest.approx(late.damping[1] * late.frequencies[1], rel=1e-2)


def test_bad_gains_and_machines_are_refused(reduced):
    with pytest.raises(InputError, match=r"^gain\b.*rigid"):
        sampled_feedback(reduced, np.ones((1, 8)), SAMPLE_TIME)
    with pytest.raises(InputError, match=r"^sample_time\b.*1396 Hz"):
        discrete_damping_gain(reduced, 0.03, 4e-4)
    with pytest.raises(InputError, match=r"^model\b.*frequency"):
        discrete_damping_gain(
            replace(reduced, frequencies=reduced.frequencies[[0, 1, 1, 2]]), 0.03, SAMPLE_TIME
        )


# --- the observer --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "form, delay", [("filter", 0), ("filter", 1), ("filter", 2), ("predictor", 1), ("predictor", 2)]
)
def test_estimators_are_the_textbook_recursion_late_by_the_delay(observer, form, delay):
    rng = np.random.default_rng(1)
    u, y = rng.standard_normal((2, 40))
    y *= 1e-9
    rows = rng.standard_normal((3, len(observer.a)))
    d = observer.model.feedthrough[0, 0]
    predicted, last, filtered, ahead = np.zeros(len(observer.a)), 0.0, [], []
    for k in range(40):
        x = predicted + observer.gain[:, 0] * (y[k] - observer.c[0] @ predicted - d * last)
        predicted, last = observer.a @ x + observer.b[:, 0] * u[k], u[k]
        filtered.append(rows @ x)
        ahead.append(rows @ predicted)
    wanted = np.array(filtered if form == "filter" else ahead).T
    found = simulate(observer.estimator(rows, form, delay), np.vstack([u, y]))
    np.testing.assert_allclose(
        found[:, delay:], wanted[:, : 40 - delay], rtol=1e-6, atol=1e-9 * np.abs(wanted).max()
    )
    assert not np.any(found[:, :delay])


def test_plant_and_predictor_have_the_poles_of_both_alone():
    model = stage().at([0], [4]).modes([0, 1, 2])
    found = discrete_kalman_observer(model, published_noise(), SAMPLE_TIME)
    application = Application(damping=0.035, selection="pole placement")
    plant = zoh_modes(model, SAMPLE_TIME)
    gain = discrete_damping_gain(model, 0.035, SAMPLE_TIME)
    separate = np.concatenate(
        [
            np.linalg.eigvals(plant.a + plant.b @ gain),
            np.linalg.eigvals(found.a - found.a @ found.gain @ found.c),
            [0.0],
        ]
    )

    def far(form, delay):
        poles = equivalent_plant(plant, discrete_compensator(found, application, form, delay)).poles
        return np.abs(separate[:, None] - poles).min(axis=1).max()

    assert far("predictor", 1) < 1e-6
    assert far("filter", 1) > 1e-3


def test_a_compensator_with_band_passes_is_its_parts_in_a_row(observer):
    application = Application(compensate=True, damping=0.035, selectivity=2.0)
    block = discrete_compensator(observer, application, "predictor", 1)
    omega = 2 * np.pi * np.array([30.0, 470.0, 1400.0])
    velocities = observer.estimator(observer.read(np.eye(3), "velocity"), "predictor", 1)
    parts = velocities.frequency_response(omega)
    gain = damping_gain(observer.model, 0.035)[0, 3::2]
    wanted = sum(
        k * zoh(band_pass(w, 2.0), SAMPLE_TIME).frequency_response(omega)[0, 0] * parts[i]
        for i, (k, w) in enumerate(zip(gain, observer.model.frequencies[1:], strict=True))
    )
    np.testing.assert_allclose(block.frequency_response(omega)[0], wanted, rtol=1e-6)


def test_bad_delays_forms_and_models_are_refused(reduced, observer):
    with pytest.raises(InputError, match=r"^delay\b"):
        observer.estimator(observer.flexible_outputs, "predictor", 0)
    with pytest.raises(InputError, match="unstable"):
        replace(observer, gain=np.zeros_like(observer.gain))
    with pytest.raises(InputError, match=r"^model\b.*velocities"):
        discrete_kalman_observer(replace(reduced, measures="velocity"), published_noise(), SAMPLE_TIME)


def braked(drag):
    """A free body with one mode, on viscous friction."""
    shapes = np.array([[0.3], [0.2]])
    frequencies, damping = np.array([0.0, 900.0]), np.array([0.0, 0.01])
    return ModalModel(frequencies, damping, shapes, np.array([[0.3, -0.2]]), np.zeros((1, 1)), drag=drag)


@pytest.mark.parametrize("late", [0.0, 0.3, 0.8])
def test_the_observer_of_a_late_force_follows_its_machine(late):
    """Without noise it has what there is at every sample, and one that takes the force for prompt has not."""
    model = braked(2.0)
    noise, forces = NoiseIntensities(1.0, 1e-12), np.random.default_rng(0).standard_normal(200)
    sampled, old = late_modes(model, SAMPLE_TIME, late)
    x, y = np.zeros((201, 4)), np.zeros(200)
    for k in range(200):
        y[k] = (sampled.c @ x[k])[0]
        before = forces[k - 1] if k else 0.0
        x[k + 1] = sampled.a @ x[k] + sampled.b[:, 0] * forces[k] + old[:, 0] * before
    missed = []
    for known in (late, 0.0):
        estimator = discrete_kalman_observer(model, noise, SAMPLE_TIME, late=known).estimator(np.eye(4))
        state, errors = np.zeros(len(estimator.a)), []
        for k in range(200):
            given = np.array([forces[k], y[k]])
            errors.append(estimator.c @ state + estimator.d @ given - x[k])
            state = estimator.a @ state + estimator.b @ given
        missed.append(np.abs(errors).max(axis=0) / np.abs(x).max(axis=0))
    assert missed[0].max() < 1e-9
    assert not late or missed[1].max() > 1e-3
