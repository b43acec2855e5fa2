"""The shared linear models, compared with python-control, high precision and closed forms."""

import warnings
from contextlib import suppress
from dataclasses import replace
from math import comb

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg, signal

from experiments.motion.machines import chain, stage
from naive.motion import exponential, step_by_step
from naive.precise import judged_norm, precise_h2_norm, sample_model
from stillwork import lti
from stillwork.base.checks import InputError
from stillwork.lti.delays import delayed, split_delay
from stillwork.lti.discretisation import (
    late_modes,
    prewarped,
    tustin,
    tustin_sections,
    zoh_modes,
    zoh_response,
)
from stillwork.lti.modal import ModalModel, modal_model
from stillwork.lti.norms import solve_lyapunov
from stillwork.lti.peaks import refine_peak
from stillwork.lti.state_space import constant, response_between

GRID = lti.resonance_grid(stage().poles, 1.0, 1e4, 400, 20)


def unstable(rate: float = 200.0) -> lti.StateModel:
    return lti.StateModel(np.array([[rate]]), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)))


def random_modal(seed: int, inputs: int = 2, outputs: int = 3) -> lti.ModalModel:
    rng = np.random.default_rng(seed)
    w = np.concatenate([[0.0], np.sort(rng.uniform(50, 5e3, 5))])
    z = np.concatenate([[0.0], rng.uniform(1e-4, 0.2, 5)])
    return lti.ModalModel(
        w, z, rng.normal(size=(6, inputs)), rng.normal(size=(outputs, 6)), rng.normal(size=(outputs, inputs))
    )


@pytest.mark.parametrize("model", [stage(), chain(np.full(5, 2.0)), random_modal(3)])
def test_modal_response_is_that_of_python_control(model):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # slycot is absent on purpose
        theirs = model.to_control()(1j * GRID, squeeze=False)
    ours = model.frequency_response(GRID)
    assert np.abs(ours - theirs).max() <= 1e-9 * np.abs(theirs).max()
    assert np.all(np.abs(ours - theirs) <= 1e-9 * np.linalg.norm(theirs, axis=(0, 1)))


def test_a_grid_of_resonances_hangs_on_no_last_bit():
    """Conjugates, and poles of one distance, may differ by rounding: each distance counts once, at its least width."""
    pair = np.array([-0.5 + 500j, -0.5 - 500j, -3 + 40j, -3 - 40j])
    corner = 70 * np.exp(1j * np.pi * np.array([0.75, 1.25, 1.0]))  # third order, Butterworth
    poles = np.concatenate([pair, corner, [0.0, 0.0]])
    grid = lti.resonance_grid(poles, 1.0, 200.0, 100, 10)
    rng = np.random.default_rng(5)
    for _ in range(5):
        off = rng.permutation(poles * (1 + 4e-16 * rng.integers(-2, 3, len(poles))))
        np.testing.assert_allclose(lti.resonance_grid(off, 1.0, 200.0, 100, 10), grid, rtol=1e-12)
    assert np.diff(grid).min() > 1e-9 * grid.max()


def test_state_response_agrees_with_the_modal_one():
    model = chain(np.full(5, 2.0)).at([0], [0, 4])
    flexible = model.modes(slice(1, None))
    by_residues = flexible.state_space().frequency_response(GRID)
    assert np.allclose(by_residues, flexible.frequency_response(GRID), rtol=1e-9, atol=0)
    # The rigid body makes A defective: the response then comes from solving.
    by_solving, expected = model.state_space().frequency_response(GRID), model.frequency_response(GRID)
    assert np.all(np.abs(by_solving - expected) <= 1e-8 * np.linalg.norm(expected, axis=(0, 1)))


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("gap", [1e-6, 1e-9, 1e-12])
def test_two_poles_that_rounding_parts_respond_as_in_any_units(unit, gap):
    def lag(pole, gain):
        return lti.StateModel(*(np.array([[each]]) for each in (-pole, gain, 1.0, 0.0)))

    product, s = lag(1.0, unit) * lag(1.0 + gap, 1.0), 1j * np.array([0.3, 1.0, 10.0])
    np.testing.assert_allclose(product(s), unit / ((s + 1) * (s + 1 + gap)), rtol=1e-9)
    sampled = lti.StateModel(*(getattr(product, each) for each in "abcd"), sample_time=1.0)
    sampled = replace(sampled, a=0.7 * sampled.a + 1.4 * np.eye(2))  # poles at 0.7
    force = np.random.default_rng(4).normal(size=(1, 50))
    plain = ct.forced_response(sampled.to_control(), inputs=force[0]).outputs
    np.testing.assert_allclose(lti.simulate(sampled, force)[0], plain, rtol=0, atol=1e-9 * unit)


def test_a_pole_among_the_points_is_refused_by_its_name():
    body = lti.StateModel(np.eye(2, k=1), np.eye(2)[:, 1:], np.eye(2)[:1], np.zeros((1, 1)))
    with pytest.raises(InputError, match=r"^s holds a pole"):
        body(np.array([1j, 0]))
    with pytest.raises(InputError, match=r"^omega holds a pole"):
        body.frequency_response(np.zeros(1))


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.floats(0.0, 0.5))
def test_parts_that_drive_only_later_ones_respond_as_the_whole(seed, states, dense):
    rng = np.random.default_rng(seed)
    part = rng.normal(size=(states, states)) * (rng.random((states, states)) < dense)
    a = np.block(
        [[part, np.zeros_like(part)], [np.eye(states), part]]
    )  # every pole twice, its eigenvector once
    mixed = rng.permutation(2 * states)
    a, b, c = a[np.ix_(mixed, mixed)], rng.normal(size=(2 * states, 2)), rng.normal(size=(3, 2 * states))
    omega = rng.uniform(8.0, 20.0, 4)  # beyond the poles
    whole = c @ np.linalg.solve(1j * omega[:, None, None] * np.eye(2 * states) - a, b[None] + 0j)
    found = lti.StateModel(a, b, c, np.zeros((3, 2))).frequency_response(omega)
    np.testing.assert_allclose(found, np.moveaxis(whole, 0, -1), rtol=1e-9, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("samples", [1, 30, 150])
def test_a_line_of_delays_responds_as_it_turns(samples):
    line = delayed(constant(np.array([[2.0, 0.0], [-1.0, 3.0]]), 1e-3), samples)
    omega = np.linspace(1.0, 3000.0, 700)
    expected = np.array([[2.0, 0.0], [-1.0, 3.0]])[:, :, None] * np.exp(-1e-3j * samples * omega)
    np.testing.assert_allclose(line.frequency_response(omega), expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("size", [(2, 3), (4, 1)])
@pytest.mark.parametrize("samples", [0, 3, None])
def test_between_the_points_of_a_grid_the_response_is_the_same(samples, size):
    """Of a model whose eigenvectors are too skew, as a line of delays makes them, of one where they are not, of a gain."""
    modes = random_modal(5, *size)
    model = constant([[2.0, 3.0]]) if samples is None else delayed(zoh_modes(modes, 1e-4), samples)
    omega = np.linspace(20.0, 6e3, 41)
    expected = model.frequency_response(omega)
    found = response_between(model, omega)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


def test_lyapunov_equations_are_solved_and_scipy_says_nothing_of_those_that_are_singular():
    rng = np.random.default_rng(3)
    a, q = 0.3 * rng.standard_normal((4, 4)), rng.standard_normal((4, 4))
    x = solve_lyapunov(a, q)
    np.testing.assert_allclose(a @ x + x @ a.T + q, 0.0, atol=1e-12)
    x = solve_lyapunov(a, q, discrete=True)
    np.testing.assert_allclose(a @ x @ a.T - x + q, 0.0, atol=1e-12)
    with warnings.catch_warnings(action="error"):
        solve_lyapunov(np.ones((2, 2)), np.eye(2))


def test_modal_model_diagonalises_the_machine():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(4, 4))
    mass, stiffness = root @ root.T + 4 * np.eye(4), np.diag([1e5, 2e5, 3e5, 5e5])
    model = lti.modal_model(mass, stiffness, np.eye(4), np.eye(4), 0.0)
    omega = np.array([7.0, 90.0])
    direct = np.stack([np.linalg.inv(stiffness - w**2 * mass) for w in omega], axis=-1)
    assert np.allclose(model.frequency_response(omega), direct, rtol=1e-10, atol=1e-16)


def test_proportional_damping_decouples_and_other_damping_is_refused():
    mass, stiffness = np.diag([1.0, 2.0]), np.array([[2e4, -1e4], [-1e4, 2e4]])
    model = lti.modal_model(mass, stiffness, np.eye(2), np.eye(2), damping_matrix=1e-4 * stiffness)
    np.testing.assert_allclose(model.damping, 1e-4 * model.frequencies / 2, rtol=1e-12)
    with pytest.raises(InputError, match=r"^damping_matrix\b"):
        lti.modal_model(mass, stiffness, np.eye(2), np.eye(2), damping_matrix=np.diag([1.0, 5.0]))


@pytest.mark.parametrize("sample_time", [1e-5, 1e-4, 1e-3])
def test_discretisation_mode_by_mode_is_the_exact_exponential(sample_time):
    model = random_modal(11)
    discrete, states = zoh_modes(model, sample_time), model.state_space()
    transition, drive = exponential(states.a, states.b, sample_time)
    assert np.allclose(discrete.a, transition, rtol=1e-11, atol=1e-15 * np.abs(transition).max())
    assert np.allclose(discrete.b, drive, rtol=1e-9, atol=1e-16 * np.abs(drive).max())


def test_balanced_exponential_of_a_stiff_machine():
    states = stage().state_space()
    discrete = lti.zoh(states, 1e-4)
    transition, drive = exponential(states.a, states.b, 1e-4)
    assert np.abs(discrete.a - transition).max() <= 1e-12 * np.abs(transition).max()
    assert np.abs(discrete.b - drive).max() <= 1e-12 * np.abs(drive).max()


@pytest.mark.parametrize("rigid", [0, 1])
def test_simulation_is_the_plain_recursion(rigid):
    # One with the rigid body is stepped as it stands, one without is decoupled.
    model = zoh_modes(random_modal(2).modes(slice(1 - rigid, None)), 1e-4)
    rng = np.random.default_rng(4)
    inputs, initial = rng.normal(size=(2, 300)), rng.normal(size=len(model.a))
    expected = step_by_step(model.a, model.b, model.c, model.d, inputs, initial)
    assert np.allclose(
        lti.simulate(model, inputs, initial), expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max()
    )


@settings(max_examples=20, deadline=None)
@given(st.floats(1e-4, 0.6), st.floats(1.0, 1e4))
def test_norms_of_one_mode_have_their_closed_form(damping, omega):
    mode = lti.ModalModel(np.array([omega]), np.array([damping]), np.eye(1), np.eye(1), np.zeros((1, 1)))
    peak = lti.hinf_norm(mode.state_space())
    exact = 1 / (2 * damping * np.sqrt(1 - damping**2) * omega**2)
    assert peak.magnitude == pytest.approx(exact, rel=1e-8, abs=0)
    assert lti.h2_norm(mode.state_space()) == pytest.approx(
        1 / np.sqrt(4 * damping * omega**3), rel=1e-9, abs=0
    )


def test_refined_peak_finds_what_the_grid_steps_over():
    mode = lti.ModalModel(np.array([1e3]), np.array([1e-3]), np.eye(1), np.eye(1), np.zeros((1, 1)))
    grid = np.geomspace(1e2, 1e4, 150)
    response = lambda w: mode.frequency_response(w)[0, 0]  # noqa: E731
    coarse = np.abs(response(grid))
    peak = refine_peak(response, grid, coarse)
    exact = 1 / (2e-3 * np.sqrt(1 - 1e-6) * 1e6)
    assert coarse.max() < 0.9 * exact
    assert peak.magnitude == pytest.approx(exact, rel=1e-4)


@pytest.mark.parametrize("unit", [1.0, 1e-9, 1e9])
def test_units_do_not_make_a_loop_ill_posed(unit):
    """Two gains in a ring, of N by m and back: solvable but for a product of one, however large each is."""

    def ring(product):
        gains = [
            lti.StateModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[g]]))
            for g in (1e9 / unit, unit * product / 1e9)
        ]
        return lti.interconnect(gains, np.eye(2)[::-1].copy(), np.eye(2, 1), np.eye(1, 2))

    assert ring(0.5).d[0, 0] == pytest.approx(2e9 / unit)
    with pytest.raises(InputError, match="feedthrough"):
        ring(1.0)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-4, 2e-3, 0.5]))
def test_a_rule_by_tustin_responds_at_a_frequency_as_it_did_at_the_prewarped_one(seed, sample_time):
    rng = np.random.default_rng(seed)
    pairs = rng.uniform(0.01, 3.0, 2) * np.exp(1j * rng.uniform(np.pi / 2, np.pi, 2)) / sample_time
    poles = np.concatenate([pairs, pairs.conj(), -rng.uniform(0.01, 3.0, 1) / sample_time])
    zeros, gain = rng.normal(size=rng.integers(0, 5)) / sample_time, rng.uniform(0.1, 10.0)
    omega = rng.uniform(0.05, 0.95, 20) * np.pi / sample_time
    s = 1j * prewarped(omega, sample_time)[:, None]
    expected = gain * np.prod(s - zeros, axis=1) / np.prod(s - poles, axis=1)
    digital = signal.freqz_sos(tustin_sections(zeros, poles, gain, sample_time), omega * sample_time)[1]
    np.testing.assert_allclose(digital, expected, rtol=1e-8)
    lag = tustin(unstable(float(poles[-1].real)), sample_time)
    np.testing.assert_allclose(lag.frequency_response(omega)[0, 0], 1 / (s[:, 0] - poles[-1]), rtol=1e-9)


def heat_capacities(rng):
    """Four in a row, driven and measured at the far end: A is symmetric, its slowest pole nearly an integrator."""
    walls = 10 ** rng.uniform(-1, 1, 3)
    a = np.diag(walls, 1) + np.diag(walls, -1)
    a -= np.diag(a.sum(axis=1) + np.array([10 ** rng.uniform(-13, -3), 0, 0, 0]))
    return a, np.eye(4)[:, 3:], np.eye(4)[3:], 0.0


def nearly_integrating(rng):
    shapes, rates = rng.normal(size=(3, 3)), -np.array([10 ** rng.uniform(-13, -3), *rng.uniform(0.3, 2, 2)])
    return (
        shapes @ np.diag(rates) @ np.linalg.inv(shapes),
        rng.normal(size=(3, 1)),
        rng.normal(size=(1, 3)),
        0.0,
    )


def light_modes(rng):
    """In both time domains, in skew states in units over 8 decades."""
    modes = int(rng.integers(1, 4))
    rates, ratios = 10 ** rng.uniform(0, 3, modes), 10 ** rng.uniform(-7, -1, modes)
    blocks = [f * np.array([[-z, 1.0], [-1.0, -z]]) for f, z in zip(rates, ratios, strict=True)]
    a, step = linalg.block_diag(*blocks), 0.0
    if rng.integers(2):
        step = 10 ** rng.uniform(-1, 1) / rates.max()
        a = linalg.expm(a * step)
    turn = rng.normal(size=a.shape) * 10 ** (rng.integers(2) * rng.uniform(-4, 4, len(a)))
    inverse = np.linalg.inv(turn)
    return (
        turn @ a @ inverse,
        turn @ rng.normal(size=(len(a), 1)),
        rng.normal(size=(1, len(a))) @ inverse,
        step,
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "tries", "least"),
    [(heat_capacities, 25, 8), (nearly_integrating, 25, 8), (light_modes, 200, 75)],
)
def test_a_two_norm_is_right_or_refused(make, tries, least):
    """Against elimination in many digits."""
    rng, answered = np.random.default_rng(7), 0
    for _ in range(tries):
        a, b, c, step = make(rng)
        model = lti.StateModel(a, b, c, np.zeros((1, 1)), step)
        with suppress(InputError):
            norm = lti.h2_norm(model)
            assert norm == pytest.approx(precise_h2_norm(model), rel=1e-5)
            answered += 1
    assert answered >= least


def companion(poles, gain=1.0, sample_time=0.0):
    """Gain over the polynomial with these real poles, in companion form: of a multiple one a single Jordan block."""
    n = len(poles)
    a = np.diag(np.ones(n - 1), -1)
    a[0] = -np.poly(poles)[1:]
    return lti.StateModel(a, gain * np.eye(n)[:, :1], np.eye(n)[-1:], np.zeros((1, 1)), sample_time)


@pytest.mark.parametrize("multiplicity", [2, 3, 4])
@pytest.mark.parametrize("form", ["companion", "series"])
def test_the_two_norm_of_a_multiple_pole_is_its_closed_form(form, multiplicity):
    """1 / (s + a)^k: binomial(2k - 2, k - 1) / (2a)^(2k - 1), from the integral of its response squared."""
    rng, k = np.random.default_rng(multiplicity), multiplicity
    for rate in 10 ** rng.uniform(-3, 3, 15):
        series = -rate * np.eye(k) + np.diag(np.ones(k - 1), -1)
        lags = lti.StateModel(series, np.eye(k)[:, :1], np.eye(k)[-1:], np.zeros((1, 1)))
        expected = np.sqrt(comb(2 * k - 2, k - 1) / (2 * rate) ** (2 * k - 1))
        model = companion([-rate] * k) if form == "companion" else lags
        assert lti.h2_norm(model) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("multiplicity", [2, 3])
def test_the_two_norm_of_a_multiple_sampled_pole_is_the_sum_of_its_impulses(multiplicity):
    rng = np.random.default_rng(multiplicity)
    for pole in rng.uniform(-0.9, 0.9, 15):
        impulse = signal.lfilter([1.0], np.poly([pole] * multiplicity), np.eye(1, 2000)[0])
        model = companion([pole] * multiplicity, sample_time=0.1)
        assert lti.h2_norm(model) == pytest.approx(np.linalg.norm(impulse), rel=1e-9)


@pytest.mark.parametrize(("multiplicity", "near", "nearer"), [(2, 0.003, 0.001), (3, 0.03, 0.01)])
def test_a_multiple_pole_near_one_is_known_to_six_digits_or_refused(multiplicity, near, nearer):
    model = companion([1 - near] * multiplicity, sample_time=1.0)
    assert lti.h2_norm(model) == pytest.approx(precise_h2_norm(model), rel=1e-6)
    with pytest.raises(InputError, match="too close to instability"):
        lti.h2_norm(companion([1 - nearer] * multiplicity, sample_time=1.0))


def test_a_small_norm_that_rounding_hides_is_refused_and_not_called_zero():
    """A triple pole at -4.76 in skew states: 2.289e-4 by 60 digits, of |B| |C| = 898; its Markov parameters round to zero."""
    a = [
        [-468820.7279425955, -110413.18633064113, -305261.3763691271],
        [967367.4063535277, 227824.75954709327, 629884.4932922936],
        [370103.4560419603, 87164.9111665838, 240981.67649675874],
    ]
    b = [[-0.30122678345494547], [-0.7816544496190657], [0.7310964259882605]]
    c = [[-661.7444113786888, -153.57066152535123, -436.8429663561934]]
    model = lti.StateModel(*(np.array(each) for each in (a, b, c, [[0.0]])))
    with pytest.raises(InputError, match="uncertainty"):
        lti.h2_norm(model)


@pytest.mark.parametrize("distance", [1e-9, 1e-12, 0.0, -1e-3])
def test_a_double_pole_that_rounding_may_move_to_instability_has_no_two_norm(distance):
    """It moves by the root of the rounding, 1e-8."""
    turn = linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    double = np.array([[-distance, 1.0, 0.0], [0.0, -distance, 0.0], [0.0, 0.0, -1.0]])
    b, c = turn @ np.array([[0.0], [1.0], [1.0]]), np.array([[1.0, 0.0, 1.0]]) @ turn.T
    for model in (
        lti.StateModel(turn @ double @ turn.T, b, c, np.zeros((1, 1))),
        companion([1 - distance] * 2, sample_time=1.0),
        companion([distance - 1] * 2, sample_time=1.0),
    ):
        with pytest.raises(InputError, match=r"^model\b|uncertainty"):
            lti.h2_norm(model)


@pytest.mark.parametrize("omega", [1e-150, 1e-100, 1e100, 1e140, 1e150])
def test_a_peak_is_found_at_any_frequency(omega):
    """Of C = 1 / omega^2, through states of unlike units: their A, and the square of a gain, leave the range of numbers."""
    one, nothing = np.ones((1, 1)), np.zeros((1, 1))
    peak = lti.hinf_norm(lti.ModalModel(np.array([omega]), np.array([0.01]), one, one, nothing).state_space())
    assert peak.omega == pytest.approx(omega * np.sqrt(1 - 2 * 0.01**2), rel=1e-4)
    assert peak.magnitude * omega * omega == pytest.approx(1 / (0.02 * np.sqrt(1 - 0.01**2)), rel=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "unit"), [(1, 1.0), (2, 1e-9), (3, 1e9)])
def test_a_peak_of_light_modes_in_a_random_basis_is_right_or_refused(seed, unit):
    """In a random basis the rounding of A moves poles that are as near to the axis as a millionth of their frequency."""
    rng, answered, wrong = np.random.default_rng(seed), 0, 0
    for _ in range(4):
        modes = int(rng.integers(2, 6))
        damping = 10 ** rng.uniform(-6, -2, modes)
        shapes = rng.normal(size=(modes, 1)), rng.normal(size=(1, modes))
        plain = lti.ModalModel(
            np.sort(10 ** rng.uniform(0, 3, modes)), damping, *shapes, np.zeros((1, 1))
        ).state_space()
        basis = rng.normal(size=(2 * modes, 2 * modes))
        back = np.linalg.inv(basis)
        skew = lti.StateModel(basis @ plain.a @ back, unit * basis @ plain.b, plain.c @ back, plain.d)
        with suppress(InputError):
            norm = lti.hinf_norm(skew).magnitude
            assert norm == pytest.approx(judged_norm(skew), rel=1e-4)  # of these very numbers
            answered += 1
            wrong += not norm == pytest.approx(unit * lti.hinf_norm(plain).magnitude, rel=1e-3)
    assert answered and not wrong


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(14))
def test_a_peak_is_that_of_seventy_digits(seed):
    kind, model = sample_model(np.random.default_rng(seed))
    assert lti.hinf_norm(model).magnitude == pytest.approx(judged_norm(model), rel=1e-6), kind


# ------------------------------------------------------------------------------------------ parts of a sample, friction


def braked(drag):
    """A free body with one mode, on viscous friction."""
    shapes = np.array([[0.3], [0.2]])
    frequencies, damping = np.array([0.0, 900.0]), np.array([0.0, 0.01])
    return ModalModel(frequencies, damping, shapes, np.array([[0.3, -0.2]]), np.zeros((1, 1)), drag=drag)


def held_by_steps(model, sample_time, late, samples, forces):
    """States at the samples, by the exponential over each stretch of constant force."""
    continuous = model.state_space()
    n = len(continuous.a)

    def stretch(length):
        whole = linalg.expm(np.block([[continuous.a, continuous.b], [np.zeros((1, n + 1))]]) * length)
        return whole[:n, :n], whole[:n, n]

    (before, old), (after, new) = stretch(late * sample_time), stretch((1 - late) * sample_time)
    states, x = np.zeros((samples + 1, n)), np.zeros(n)
    for k in range(samples):
        x = before @ x + old * (forces[k - 1] if k else 0.0)
        x = after @ x + new * forces[k]
        states[k + 1] = x
    return states


@pytest.mark.parametrize("late", [0.0, 1e-6, 0.5, 0.999])
@pytest.mark.parametrize("drag", [0.0, 1e-6, 1e6])
def test_a_force_that_is_late_by_a_part_of_a_sample_acts_so_on_a_body_with_friction(late, drag):
    model = braked(drag)
    sample_time, forces = 1e-3, np.random.default_rng(0).standard_normal(40)
    sampled, old = late_modes(model, sample_time, late)
    wanted = held_by_steps(model, sample_time, late, 40, forces)
    x = np.zeros(4)
    for k in range(40):
        x = sampled.a @ x + sampled.b[:, 0] * forces[k] + old[:, 0] * (forces[k - 1] if k else 0.0)
        assert x == pytest.approx(wanted[k + 1], rel=1e-8, abs=1e-9 * np.abs(wanted[1:]).max())
    assert np.array_equal(late_modes(model, sample_time, 0.0)[0].b, zoh_modes(model, sample_time).b)


@pytest.mark.parametrize("drag", [0.0, 5.0])
def test_the_late_response_is_that_of_the_late_states(drag):
    model = braked(drag)
    omega = np.array([20.0, 300.0, 905.0, 3000.0])
    sampled, old = late_modes(model, 1e-3, 0.37)
    z = np.exp(1j * omega * 1e-3)
    wanted = [
        (sampled.c @ np.linalg.solve(each * np.eye(4) - sampled.a, sampled.b + old / each))[0, 0]
        for each in z
    ]
    assert zoh_response(model, 1e-3, omega, 0.37)[0, 0] == pytest.approx(np.array(wanted), rel=1e-9)


def test_friction_is_in_poles_response_and_states_alike():
    model = braked(7.0)
    states, omega = model.state_space(), np.array([0.5, 7.0, 900.0])
    assert np.sort_complex(model.poles) == pytest.approx(np.sort_complex(linalg.eigvals(states.a)), abs=1e-9)
    assert model.frequency_response(omega) == pytest.approx(states.frequency_response(omega), rel=1e-9)
    with pytest.raises(InputError, match="drag"):
        replace(model, drag=-1.0)


def test_matrices_keep_the_friction_of_the_whole_body():
    """Rayleigh damping alpha M + beta K brakes the free body at the rate alpha."""
    mass = np.diag([3.0, 1.0])
    stiffness = 1e6 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    made = modal_model(
        mass, stiffness, [[1.0], [0.0]], [[0.0, 1.0]], damping_matrix=4.0 * mass + 1e-5 * stiffness
    )
    omega = np.array([1.0, 50.0, 1150.0])
    wanted = [
        np.linalg.solve(stiffness + 1j * w * (4.0 * mass + 1e-5 * stiffness) - w**2 * mass, [1.0, 0.0])[1]
        for w in omega
    ]
    assert made.drag == pytest.approx(4.0, rel=1e-6)
    assert made.frequency_response(omega)[0, 0] == pytest.approx(np.array(wanted), rel=1e-6)


@pytest.mark.parametrize(
    ("samples", "wanted"), [(0.0, (0, 0.0)), (2.0, (2, 0.0)), (1.25, (1, 0.25)), (2.9999999999, (3, 0.0))]
)
def test_a_delay_is_whole_samples_and_a_part(samples, wanted):
    assert split_delay(samples) == pytest.approx(wanted)
    with pytest.raises(InputError, match="samples"):
        split_delay(-0.1)
