"""Laws beside the fixed point: numpy twins, closed forms, energy, a solver."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fixedpoint.carts import cart_bias, cart_inertia
from naive import fixedpoint as naive
from stillwork.base.checks import InputError
from stillwork.control import (
    Controller,
    DisturbanceObserver,
    KinematicDesign,
    Mechanism,
    SlotineLi,
    asin_trajectory,
    simulate_adaptive,
    simulate_mechanism,
)
from stillwork.control.fixed_point_linear import linear_loop
from stillwork.control.regressor import regressor_at
from stillwork.estimation import LowPass
from stillwork.estimation.coordinate_filters import MovingWindow

DT = 1e-3


def lumped_inertia(position, parameters, out):
    c = np.cos(position[1])
    out[0, 0] = parameters[0] + 2 * parameters[1] * c
    out[0, 1] = parameters[2] + parameters[1] * c
    out[1, 0] = parameters[2] + parameters[1] * c
    out[1, 1] = parameters[2]


def lumped_bias(position, velocity, parameters, out):
    s = parameters[1] * np.sin(position[1])
    weight = 9.81 * parameters[4] * np.cos(position[0] + position[1])
    out[0] = -s * velocity[1] * (2 * velocity[0] + velocity[1]) + weight + parameters[5] * velocity[0]
    out[0] += 9.81 * parameters[3] * np.cos(position[0])
    out[1] = s * velocity[0] ** 2 + weight + parameters[6] * velocity[1]


def lumped(model):
    m1, c1, i1, l1, m2, c2, i2, _, d1, d2 = model.parameters[:10]
    numbers = [m1 * c1**2 + i1 + i2 + m2 * (l1**2 + c2**2), m2 * l1 * c2, i2 + m2 * c2**2, m1 * c1 + m2 * l1]
    return Mechanism(lumped_inertia, lumped_bias, 2, [*numbers, m2 * c2, d1, d2])


@pytest.mark.parametrize("gain", [0.0, 0.08])
def test_the_observer_is_its_twin(gain, arm, short, rng):
    """d of a textbook, kept and subtracted; without it computed torque."""
    noise = 1e-5 * rng.standard_normal((2, len(short.position)))
    controller = Controller(LowPass(), DisturbanceObserver(gain), KinematicDesign(16.0), arm.approximate)
    runs = simulate_mechanism(arm.exact, controller, [short] * 2, noise, integration="semi-implicit")
    d, command = np.zeros(2), None

    def answer(desired, response):
        nonlocal d, command
        if command is not None:
            d = d + gain * (response - command - d)
        command = desired - d
        return command

    nominal, gains = (short.position, short.velocity, short.acceleration), controller.kinematics.gains
    _, forces = naive.loop_of_coordinates(arm.exact, arm.approximate, gains, nominal, noise, DT, answer)
    found = np.array([run.force for run in runs])
    assert np.abs(forces - found).max() < 1e-7 * np.abs(found).max()


def test_a_constant_force_moves_computed_torque_by_its_share_of_the_stiffness_and_the_observer_not_at_all():
    """Without an integral, at rest: e = F / (m_model Lambda^2)."""
    still = asin_trajectory(amplitude=1e-9, duration=3.0)
    plant, model = (Mechanism(cart_inertia, cart_bias, 1, [mass, 0.0, 0.0]) for mass in (3.0, 2.0))
    errors = []
    for gain in (0.0, 0.02):
        design = KinematicDesign(10.0, integrals=0)
        parts = Controller(LowPass(), DisturbanceObserver(gain), design, model)
        force = np.full((1, len(still.position)), 5.0)
        errors.append(simulate_mechanism(plant, parts, [still], disturbance=force)[0].position_error[-1])
    assert errors[0] == pytest.approx(-5.0 / (2.0 * 10.0**2), rel=1e-6)
    assert abs(errors[1]) < 1e-6


def christoffel(mechanism, q, v, step=1e-5):
    """C(q, v) by differences of the inertia."""
    n = len(q)
    slopes = np.array(
        [(mechanism.mass(q + step * e) - mechanism.mass(q - step * e)) / (2 * step) for e in np.eye(n)]
    )  # [k, i, j]: dM_ij / dq_k
    return (
        np.einsum("kij,k->ij", slopes, v) / 2
        + (np.einsum("jik,k->ij", slopes, v) - np.einsum("ijk,k->ij", slopes, v)) / 2
    )


def test_the_regressor_holds_christoffel_s_matrix_whose_rest_is_skew(arm, rng):
    model = lumped(arm.approximate)
    for _ in range(10):
        q, v, w, a = rng.uniform(-2, 2, (4, 2))
        C = christoffel(model, q, v)
        weight = model.force(q, np.zeros(2), np.zeros(2))
        friction = model.parameters[5:] * v
        assert regressor_at(model, q, v, w, a) @ model.parameters == pytest.approx(
            model.mass(q) @ a + C @ w + weight + friction, abs=1e-8
        )
        assert regressor_at(model, q, v, v, a) @ model.parameters == pytest.approx(model.force(q, v, a))
        change = (model.mass(q + 1e-5 * v) - model.mass(q - 1e-5 * v)) / 2e-5
        columns = [
            (regressor_at(model, q, v, e, np.zeros(2)) - regressor_at(model, q, v, 0 * e, np.zeros(2)))
            @ model.parameters
            for e in np.eye(2)
        ]
        rest = change - 2 * np.array(columns).T
        assert rest + rest.T == pytest.approx(np.zeros((2, 2)), abs=1e-8)


@pytest.mark.slow
def test_slotine_and_li_s_energy_falls_at_its_rate_and_samples_converge_to_it(arm):
    """V' = -s' K s of the continuous loop, by a solver and Christoffel's symbols; the sampled one nears it with the sample time."""
    plant, model = lumped(arm.exact), lumped(arm.approximate)
    rate, K, Gamma = 6.0, np.array([4.0, 2.0]), 0.3 * model.parameters**2
    path = asin_trajectory(0.5, 0.9, frequency_hz=0.5, duration=1.0, sample_time=DT)
    fine = asin_trajectory(0.5, 0.9, frequency_hz=0.5, duration=1.001, sample_time=1e-5)

    def wanted(t):
        return [np.interp(t, fine.time, each) for each in (fine.position, fine.velocity, fine.acceleration)]

    def law(t, x):
        q, v, integral, p = x[:2], x[2:4], x[4:6], x[6:13]
        qn, vn, an = wanted(t)
        e, slip = qn - q, vn - v
        w, dw = vn + 2 * rate * e + rate**2 * integral, an + 2 * rate * slip + rate**2 * e
        believed = Mechanism(lumped_inertia, lumped_bias, 2, p)
        Y = regressor_at(model, q, v, w, dw)
        force = believed.mass(q) @ dw + christoffel(believed, q, v) @ w + K * (w - v)
        force += believed.force(q, np.zeros(2), np.zeros(2)) + p[5:] * v
        return w - v, e, force, Gamma * (Y.T @ (w - v))

    def motion(t, x):
        s, e, force, rates = law(t, x)
        return np.concatenate([x[2:4], plant.acceleration(x[:2], x[2:4], force), e, rates, [s @ (K * s)]])

    start = np.array([0.1, -0.1, path.velocity[0], path.velocity[0], 0, 0, *model.parameters, 0.0])
    solved = solve_ivp(motion, (0, 0.6), start, rtol=1e-8, atol=1e-10, dense_output=True, max_step=0.01)
    energies = []
    for t in np.linspace(0, 0.6, 13):
        x = solved.sol(t)
        s, away = law(t, x)[0], x[6:13] - plant.parameters
        energies.append(s @ plant.mass(x[:2]) @ s / 2 + away @ (away / Gamma) / 2 + x[13])
    assert np.ptp(energies) < 1e-5 * energies[0] and solved.sol(0.6)[13] > 0.1
    errors = []
    for dt in (1e-3, 5e-4):
        nominal = asin_trajectory(0.5, 0.9, frequency_hz=0.5, duration=0.6, sample_time=dt)
        design = SlotineLi(MovingWindow(1), KinematicDesign(rate, order=1), model, K, Gamma)
        run = simulate_adaptive(plant, design, [nominal] * 2, start=[start[:2], start[2:4]])
        at = solved.sol(nominal.time)
        moved = np.array([each.position for each in run.coordinates])
        errors.append((np.abs(moved - at[:2]).max(), np.abs(run.parameters - at[6:13]).max()))
    assert np.array(errors[0]) / np.array(errors[1]) == pytest.approx([2, 2], rel=0.15)
    assert errors[1][0] < 2e-3


def test_what_they_are_not_made_for_is_refused(arm, short):
    observer = Controller(LowPass(), DisturbanceObserver(0.1), KinematicDesign(9.0), arm.approximate)
    with pytest.raises(InputError, match="DisturbanceObserver"):
        linear_loop(arm.exact, observer, DT, [0.0, 0.0], [0.0, 0.0])
    guess, design = lumped(arm.approximate), KinematicDesign(9.0, order=1)
    with pytest.raises(InputError, match="linear in its parameters"):
        SlotineLi(LowPass(), design, arm.approximate, [1.0, 1.0], np.ones(13))
    law = SlotineLi(LowPass(), design, guess, [1.0, 1.0], np.ones(7))
    with pytest.raises(InputError, match=r"^trajectories\b"):
        simulate_adaptive(guess, law, [short])
    wild = SlotineLi(LowPass(), design, guess, [1e6, 1e6], np.ones(7))
    assert simulate_adaptive(lumped(arm.exact), wild, [short] * 2).coordinates[0].cause
