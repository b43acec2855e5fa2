"""Models of python-control and SciPy at every door, and back; algebra, minimal models, zeros and margins beside theirs."""

import warnings

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg
from scipy import signal as scipy_signal

from stillwork import control, estimation, identification, lti, signals
from stillwork.base.checks import InputError

W = np.geomspace(0.01, 100, 60)
SEEDS = st.integers(0, 2**32 - 1)


def drawn(rng, outputs, inputs, states=None):
    """A random stable model by Scott's recipe without the library that is tested: poles in pairs, mixed states."""
    n = int(rng.integers(1, 6)) if states is None else states
    blocks = [
        np.array([[-rng.uniform(0.1, 3), w], [-w, -rng.uniform(0.1, 3)]])
        for w in rng.uniform(0.1, 20, (n + 1) // 2)
    ]
    a = linalg.block_diag(*blocks)[:n, :n]
    turn = linalg.qr(rng.normal(size=(n, n)))[0]
    b, c = rng.normal(size=(n, inputs)), rng.normal(size=(outputs, n))
    return ct.ss(turn @ a @ turn.T, turn @ b, c @ turn.T, rng.normal(size=(outputs, inputs)), 0)


def agrees(ours, theirs, tolerance=1e-8):
    wanted = theirs(1j * W, squeeze=False)
    found = lti.from_control(ours).frequency_response(W)
    return np.abs(found - wanted).max() <= tolerance * np.abs(wanted).max()


@settings(max_examples=30)
@given(SEEDS)
def test_sums_products_and_feedback_are_those_of_python_control_from_either_side(seed):
    rng = np.random.default_rng(seed)
    m, p, k = (int(each) for each in rng.integers(1, 4, 3))
    one, other, beside, back = drawn(rng, p, m), drawn(rng, m, k), drawn(rng, p, m), drawn(rng, m, p)
    a, b, c = (lti.from_control(each) for each in (one, other, beside))
    gain = rng.normal(size=(2, p))
    for mixed in (a * b, one * b, a * other):
        assert isinstance(mixed, lti.StateModel) and agrees(mixed, one * other)
    for mixed, theirs in (
        *((each, one + beside) for each in (a + c, one + c, a + beside)),
        *((each, one - beside) for each in (a - c, one - c, a - beside)),
        (-a, -one),
        (2 * a, 2 * one),
        (a + 1.5, one + 1.5),
        (gain * a, gain * one),
        (a[0, :], one[0, :]),
        (a.feedback(back, sign=1), ct.feedback(one, back, 1)),
    ):
        assert agrees(mixed, theirs)
    closed = ct.feedback(one, back)
    assert agrees(a.feedback(back), closed) and agrees(ct.feedback(a, back), closed)
    single, square = drawn(rng, 1, 1), drawn(rng, p, p)
    s, q = lti.from_control(single), lti.from_control(square)
    for mixed, theirs in (
        *((each, single * one) for each in (s * a, single * a, s * one)),
        *((each, one * single) for each in (a * s, one * s, a * single)),
        *((each, single + one) for each in (s + a, single + a, a + single)),
        *((q**n, square**n) for n in (-1, 0, 1, 3)),
        (q / s, square * (1 / single)),
        (single / s, ct.ss([], [], [], 1.0)),
        (2 / q, 2 * square**-1),
    ):
        assert agrees(mixed, theirs, 1e-6)
    plane = rng.normal(size=(2, 3)) + 1j * rng.normal(size=(2, 3))
    np.testing.assert_allclose(s(plane).ravel(), single(plane.ravel()), rtol=1e-8)
    np.testing.assert_allclose(a(plane[0]), one(plane[0]), rtol=1e-7, atol=1e-9)
    assert s(1j) == pytest.approx(single(1j)) and np.shape(a(1j)) == (() if p == m == 1 else (p, m))
    measured = ct.frd(square, W)
    for mixed, theirs in (
        (q * measured, square * square),
        (q + measured, 2 * square),
        (s / ct.frd(single, W), ct.ss([], [], [], 1.0)),
    ):
        np.testing.assert_allclose(mixed.frdata, theirs(1j * W, squeeze=False), rtol=1e-6, atol=1e-9)


def test_what_has_no_power_and_no_value_is_refused():
    lag = lti.from_control(ct.tf([1.0], [1.0, 1.0]))
    for wrong, said in (
        (lambda: lag**0.5, "no power 0.5"),
        (lambda: 1 / lag, "d is singular"),
        (lambda: lag / 0, "d is singular"),
        (lambda: lti.from_control(ct.ss(-1.0, [[1.0, 1.0]], 1.0, 0)) ** 2, "as many inputs as outputs"),
        (lambda: lag(-1.0), "s holds a pole"),
        (lambda: lag([]), "s is empty"),
        (lambda: lag("fast"), "s is not an array"),
    ):
        with pytest.raises(InputError, match=said):
            wrong()


def test_states_keep_their_names_while_these_differ():
    one = ct.ss(-1.0, 1.0, 1.0, 0.0, inputs="F", outputs="x", states="slow")
    other = ct.ss(-9.0, 1.0, 1.0, 0.0, inputs="u", outputs="F", states="fast")
    a, b = lti.from_control(one), lti.from_control(other)
    assert (a * b).state_labels == ("fast", "slow") and (a + b).state_labels == ("slow", "fast")
    assert a.feedback(b).state_labels == ("slow", "fast") == (a - other).state_labels
    assert (a * b).input_labels == ("u",) and (a * b).output_labels == ("x",)
    assert (2 * a).state_labels == ("slow",) == a.feedback().state_labels == (a + 1).state_labels
    assert (a + a).state_labels == () == (a * lti.StateModel(b.a, b.b, b.c, b.d)).state_labels
    inverse = (a + 1) ** -1
    assert (inverse.input_labels, inverse.output_labels, inverse.state_labels) == (("x",), ("F",), ("slow",))


@settings(max_examples=30)
@given(SEEDS)
def test_round_trips_keep_values_time_and_names(seed):
    rng = np.random.default_rng(seed)
    theirs = drawn(rng, 2, 3)
    for time in (0, 0.25):
        names = {
            "inputs": ["F", "G", "H"],
            "outputs": ["x", "v"],
            "states": [f"s{k}" for k in range(theirs.nstates)],
        }
        named = ct.ss(theirs.A, theirs.B, theirs.C, theirs.D, time, **names)
        model = lti.from_control(named)
        again = model.to_control()
        assert all(np.array_equal(getattr(again, each), getattr(named, each)) for each in "ABCD")
        assert again.dt == time and (again.input_labels, again.output_labels) == (
            named.input_labels,
            named.output_labels,
        )
        assert again.state_labels == named.state_labels and lti.from_control(again) == model
        assert lti.from_control(model.to_scipy()) == lti.StateModel(model.a, model.b, model.c, model.d, time)
        assert model["v", ["H", "F"]].input_labels == ("H", "F")
    with pytest.raises(InputError, match=r"'speed'.*'x', 'v'"):
        model["speed", "F"]


@settings(max_examples=40)
@given(SEEDS, st.booleans())
def test_a_transfer_function_becomes_a_minimal_model(seed, discrete):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 7))
    scale = 1.0 if discrete else 10.0 ** rng.uniform(-2, 3)
    pairs = rng.uniform(0.1, 0.9, n // 2) * np.exp(1j * rng.uniform(0.3, 2.8, n // 2))
    poles = np.concatenate([pairs, pairs.conj(), rng.uniform(0.1, 0.8, n % 2)]) * (1 if discrete else -scale)
    zeros = -scale * rng.uniform(1.1, 3, int(rng.integers(0, n + 1)))
    num, den = 2.5 * np.atleast_1d(np.poly(zeros)).real, np.atleast_1d(np.poly(poles)).real
    point = np.exp(1j * np.linspace(0.1, 3, 40)) if discrete else 1j * scale * W
    wanted = np.polyval(num, point) / np.polyval(den, point)
    time = {"dt": 0.5} if discrete else {}
    omega = np.linspace(0.1, 3, 40) / 0.5 if discrete else scale * W
    extra = scale * 5.0  # a pole that a zero cancels
    cancelled = ct.tf(np.polymul(num, [1, extra]), np.polymul(den, [1, extra]), time.get("dt", 0))
    for system in (
        ct.tf(num, den, time.get("dt", 0)),
        scipy_signal.TransferFunction(num, den, **time),
        cancelled,
    ):
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            model = lti.from_control(system)
        assert len(model.a) == n and (model.sample_time or 0) == time.get("dt", 0)
        np.testing.assert_allclose(
            model.frequency_response(omega)[0, 0], wanted, rtol=1e-6, atol=1e-9 * abs(wanted).max()
        )
        assert (f"{-extra:.6g}" in "".join(str(each.message) for each in said)) == (system is cancelled)


def test_a_gain_has_any_sample_time():
    held = lti.zoh(ct.tf([1.0], [1.0, 2.0]), 0.1)
    for gain in (ct.tf([3.0], [1.0]), ct.ss([], [], [], 3.0)):
        assert (held * gain).sample_time == (gain * held).sample_time == 0.1
        np.testing.assert_allclose(
            (gain * held).frequency_response([1.0]), 3 * held.frequency_response([1.0])
        )


REFUSED = {
    "unspecified; give 0": ct.ss(-1.0, 1.0, 1.0, 0.0, None),
    "improper": ct.tf([1.0, 0.0, 0.0], [1.0, 1.0]),
    "frequency response; fit": ct.frd([1.0, 2.0], [1.0, 2.0]),
    "tuple of 2": ([1.0], [1.0, 2.0]),
    "is 5; give": 5,
}


@pytest.mark.parametrize("said", REFUSED)
def test_what_is_no_model_is_refused_with_what_to_give(said):
    for function in (lti.hinf_norm, lti.from_control):
        with pytest.raises(InputError, match=said):
            function(REFUSED[said])


def test_a_compensator_has_two_inputs_and_outputs():
    with pytest.raises(InputError, match=r"compensator has shape \(1, 1\); give 2"):
        control.make_loop(ct.tf([1.0], [8.0, 0.0, 0.0]), ct.tf([1.0], [1.0, 1.0]))


def test_functions_take_models_of_other_libraries():
    lag = ct.tf([3.0], [1.0, 2.0])
    for each in (
        lag,
        ct.ss(lag),
        lag.to_scipy() if hasattr(lag, "to_scipy") else scipy_signal.TransferFunction([3.0], [1.0, 2.0]),
    ):
        assert lti.hinf_norm(each).magnitude == pytest.approx(1.5, rel=1e-9)
        assert lti.h2_norm(each) == pytest.approx(3 / np.sqrt(4), rel=1e-9)
        assert lti.zoh(each, 0.1).poles == pytest.approx(np.exp(-0.2))
    assert lti.zoh(scipy_signal.ZerosPolesGain([], [-2.0], 3.0), 0.1).poles == pytest.approx(np.exp(-0.2))
    assert lti.hinf_norm((-2.0, 1.0, 3.0, 0.0)).magnitude == pytest.approx(1.5)
    noise = estimation.NoiseIntensities(process=1.0, sensor=1e-6)
    gain = estimation.kalman_observer(ct.tf([1.0], [1.0, 0.2, 100.0]), noise).gain
    theirs = ct.lqe([[0.0, 1.0], [-100.0, -0.2]], [[0.0], [1.0]], [[1.0, 0.0]], [[1.0]], [[1e-6]])[0]
    np.testing.assert_allclose(gain, theirs, rtol=1e-7)


@settings(max_examples=30)
@given(SEEDS)
def test_modes_are_found_in_any_states_and_units(seed):
    rng = np.random.default_rng(seed)
    free, modes = int(rng.integers(0, 2)), int(rng.integers(1, 5))
    hertz = np.cumsum(rng.uniform(20, 400, modes))
    model = lti.ModalModel(
        np.append(np.zeros(free), hertz),
        np.append(np.zeros(free), rng.uniform(0.002, 0.3, modes)),
        rng.uniform(0.2, 1, (free + modes, 2)),
        rng.uniform(0.2, 1, (3, free + modes)),
        1e-7 * rng.normal(size=(3, 2)),
        measures="velocity" if not free and seed % 2 else "position",
    )
    theirs = model.to_control()
    turn = linalg.qr(rng.normal(size=theirs.A.shape))[0]
    found = lti.ModalModel.converted(
        "model", ct.ss(turn @ theirs.A @ turn.T, turn @ theirs.B, theirs.C @ turn.T, theirs.D)
    )
    np.testing.assert_allclose(found.frequencies, model.frequencies, rtol=1e-6, atol=1e-3)
    np.testing.assert_allclose(
        found.frequency_response(10 * W), model.frequency_response(10 * W), rtol=1e-4, atol=1e-12
    )


@pytest.mark.parametrize(
    ("system", "said"),
    [
        (ct.tf([1.0], [1.0, 1.0]), "others: -1 rad/s"),
        (ct.tf([1.0, 1.0], [1.0, 0.2, 100.0]), "real shapes"),
        (ct.tf([1.0], [1.0, -0.2, 100.0]), "do not grow"),
        (ct.tf([1.0], [1.0, -0.2, 0.1], 0.1), "discrete time"),
    ],
)
def test_what_has_no_modes_is_refused(system, said):
    with pytest.raises(InputError, match=said):
        lti.ModalModel.converted("model", system)


def test_zeros_of_the_example_of_slicot():
    """AB08ND's example program: zeros -1 and 2."""
    a = np.diag([1.0, 1.0, 3.0, -4.0, -1.0, 3.0])
    b = np.array([[0, -1], [-1, 0], [1, -1], [0, 0], [0, 1], [-1, -1.0]])
    c = np.array([[1, 0, 0, 1, 0, 0], [0, 1, 0, 1, 0, 1], [0, 0, 1, 0, 0, 1.0]])
    np.testing.assert_allclose(
        np.sort(lti.StateModel(a, b, c, np.zeros((3, 2))).zeros.real), [-1, 2], atol=1e-9
    )


@settings(max_examples=40)
@given(SEEDS)
def test_zeros_do_not_depend_on_states_and_units(seed):
    rng = np.random.default_rng(seed)
    n, m, p = (int(each) for each in rng.integers([2, 1, 1], [8, 4, 4]))
    a, b, c = rng.normal(size=(n, n)), rng.normal(size=(n, m)), rng.normal(size=(p, n))
    d = rng.normal(size=(p, m)) if m == p else np.zeros((p, m))
    at = rng.normal()
    if (
        m != p
    ):  # a mode that the inputs do not reach, or the outputs do not see, is a zero of a wide, or a tall, model
        side = (
            (np.zeros((1, m)), rng.normal(size=(p, 1)))
            if m > p
            else (rng.normal(size=(1, m)), np.zeros((p, 1)))
        )
        aside = rng.normal(size=(n, 1)) * (m > p), rng.normal(size=(1, n)) * (m < p)
        a, b, c = (
            np.block([[a, aside[0]], [aside[1], np.array([[at]])]]),
            np.vstack([b, side[0]]),
            np.hstack([c, side[1]]),
        )
    turn = linalg.qr(rng.normal(size=a.shape))[0] * 10.0 ** rng.uniform(-2, 2, len(a))
    rate = 10.0 ** rng.uniform(-3, 3)
    found = lti.StateModel(
        rate * linalg.solve(turn, a @ turn), linalg.solve(turn, b), rate * c @ turn, d
    ).zeros
    wanted = [rate * at] if m != p else rate * linalg.eigvals(a - b @ linalg.solve(d, c))
    assert len(found) == len(wanted)
    for each in wanted:
        assert np.abs(found - each).min() < 1e-5 * max(abs(each), 1e-2 * rate)


@settings(max_examples=30)
@given(SEEDS)
def test_a_minimal_realisation_has_the_response_and_no_state_too_many(seed):
    rng = np.random.default_rng(seed)
    theirs = drawn(rng, 2, 2, 4)
    hidden, unseen = rng.normal(size=(4, 1)), rng.normal(size=(1, 4))
    a = np.block(
        [
            [theirs.A, hidden, np.zeros((4, 1))],
            [np.zeros((1, 4)), -3 * np.eye(1), np.zeros((1, 1))],
            [unseen, np.zeros((1, 1)), -7 * np.eye(1)],
        ]
    )
    b, c = (
        np.vstack([theirs.B, np.zeros((1, 2)), rng.normal(size=(1, 2))]),
        np.hstack([theirs.C, rng.normal(size=(2, 1)), np.zeros((2, 1))]),
    )
    turn = linalg.qr(rng.normal(size=(6, 6)))[0]
    found = lti.minimal_realisation((turn @ a @ turn.T, turn @ b, c @ turn.T, theirs.D))
    assert len(found.model.a) == 4 and len(found.removed) == 2 and found.removed.max() < 1e-12
    assert agrees(found.model, theirs)


def test_slow_states_that_matter_stay():
    """Poles over twelve decades: a small singular value may carry most of the response."""
    plain = ct.ss(np.diag([-1e-6, -2e-6, -1e6]), np.ones((3, 1)), np.ones((1, 3)), 0)
    found = lti.minimal_realisation(plain)
    assert found.model.frequency_response([0.0])[0, 0, 0] == pytest.approx(1.5e6, rel=1e-9)
    slow = [[np.poly([-1e-3, -2e-3, -1e5]), [1.0, 1.0]], [[1.0, 2.0], [1.0, 3.0]]]
    system = ct.tf([[[2e-1], [1.0]], [[1.0], [1.0]]], slow)
    at_rest = lti.from_control(system).frequency_response([0.0])[:, :, 0]
    np.testing.assert_allclose(at_rest, [[1.0, 1.0], [0.5, 1 / 3]], rtol=1e-5)


def test_equal_modes_and_odd_roots():
    model = lti.ModalModel(
        *(np.full(2, 100.0), np.full(2, 0.01), np.array([[1.0, 0.2], [0.3, 1.0]])),
        *(np.array([[1.0, 0.1], [0.5, 0.7]]), np.zeros((2, 2))),
    )
    found = lti.ModalModel.converted("model", model.to_control())
    assert len(found.frequencies) == 2
    np.testing.assert_allclose(
        found.frequency_response([90.0, 101.0]), model.frequency_response([90.0, 101.0]), rtol=1e-5
    )
    with pytest.raises(InputError, match="without its conjugate"):
        lti.from_control(scipy_signal.ZerosPolesGain([1j], [-1.0, -2.0], 2.0))
    named = ct.ss(-1.0, 1.0, 1.0, 0.0, inputs="F", outputs="x", states="v")
    for held in (lti.zoh(named, 0.1), lti.tustin(named, 0.1)):
        assert (held.input_labels, held.output_labels, held.state_labels) == (("F",), ("x",), ("v",))
    assert (lti.from_control(named) / 2).frequency_response([0.0]) == 0.5


def test_responses_of_python_control_are_read_and_written():
    omega = 2 * np.pi * np.linspace(10, 500, 400)
    plant = ct.tf([1.0], [8.0, 0.0, 0.0])
    for response in (ct.frd(plant, omega), (omega / 2 / np.pi, plant(1j * omega))):
        read = identification.load_machine(response, "m", "N")
        np.testing.assert_allclose(read.accelerance.response, 1 / 8, rtol=1e-12)
        np.testing.assert_allclose(read.accelerance.omega, omega, rtol=1e-12)
    with pytest.raises(InputError, match="give a path"):
        identification.load_machine(5)
    accelerance = ct.tf([1.0, 0.0, 0.0], [8.0, 0.0, 0.0]) + ct.tf([0.05, 0.0, 0.0], [1.0, 12.0, 1256.0**2])
    for response in (ct.frd(accelerance, omega), (omega / 2 / np.pi, accelerance(1j * omega))):
        fit = identification.identify_modes(response, (20.0, 450.0))
        np.testing.assert_allclose(fit.model.frequencies, [0.0, 1256.0], rtol=1e-6)
    for wrong, said in (
        (5, "measured is 5; give a control"),
        (ct.frd(np.ones((2, 1, 2)), [1.0, 2.0]), "2 channels"),
    ):
        with pytest.raises(InputError, match=said):
            identification.identify_modes(wrong, (20.0, 450.0))
    noise = np.random.default_rng(2).normal(size=(2, 4000))
    found = signals.estimate_response(noise, np.array([[1.0, 2.0], [0.0, 3.0]]) @ noise, 100.0, 1.0)
    theirs = found.to_control()
    np.testing.assert_allclose(theirs.omega, 2 * np.pi * found.frequencies_hz)
    np.testing.assert_allclose(theirs(1j * theirs.omega[20], squeeze=False), [[1, 2], [0, 3]], atol=1e-9)


@pytest.mark.parametrize("quarters", [1, 3, 4, 7, 8, 13])
def test_a_delay_of_any_part_of_a_sample_is_that_of_four_times_the_rate(quarters):
    plant = ct.ss(drawn(np.random.default_rng(quarters), 2, 2), inputs=["F", "G"])
    held = np.random.default_rng(1).normal(size=(2, 120))
    fine = np.repeat(held, 4, axis=1)
    late = np.hstack([np.zeros((2, quarters)), fine[:, :-quarters]])
    wanted = ct.forced_response(ct.sample_system(plant, 0.01), inputs=late).outputs[:, ::4]
    model = lti.zoh(plant, 0.04, delay=0.01 * quarters)
    np.testing.assert_allclose(lti.simulate(model, held), wanted, atol=1e-11)
    assert model.input_labels == ("F", "G")


def test_a_record_of_one_input_may_be_a_row():
    lag = lti.zoh(ct.tf([1.0], [1.0, 1.0]), 0.1)
    np.testing.assert_array_equal(lti.simulate(lag, np.ones(9)), lti.simulate(lag, np.ones((1, 9))))
