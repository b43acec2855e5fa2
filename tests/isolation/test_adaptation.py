import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from naive import adaptation as naive
from notebooks.isolation.numerical_stability import steady_start
from stillwork.base.checks import InputError
from stillwork.estimation.adaptive import (
    FeLms,
    FeRls,
    ferls_update,
    hold_triangle,
)
from stillwork.estimation.covariance_forms import FORMS, covariance_of, factor_of
from stillwork.estimation.online import (
    AdaptationStepper,
    UnstableAdaptation,
    adapt,
    identify,
)

FORGETTING = 0.99
PRINTED = {"forgetting": FORGETTING, "growth_limit": np.inf}


def record(n=4, actuators=3, samples=150, seed=0, spread=1.0):
    """Correlated regressors of unequal size, and a disturbance that they explain but for noise."""
    rng = np.random.default_rng(seed)
    mixing = np.eye(n) + 0.3 * rng.standard_normal((n, n))
    regressors = np.geomspace(1, spread, n)[:, None] * (mixing @ rng.standard_normal((n, samples)))
    optimum = rng.standard_normal((actuators, n))
    return regressors, -optimum @ regressors + 0.1 * rng.standard_normal((actuators, samples)), optimum


@pytest.mark.slow
@pytest.mark.parametrize(("n", "actuators", "samples"), [(9, 6, 120), (4, 2, 200), (1, 1, 50), (5, 1, 80)])
def test_efficient_form_is_the_full_inverse(n, actuators, samples):
    regressors, disturbance, _ = record(n, actuators, samples)
    epsilon = 0.05
    history, gain = naive.full_inverse_ferls(regressors, disturbance, epsilon, FORGETTING)
    run = identify(FeRls(1 / epsilon, **PRINTED), regressors, disturbance, every=1)
    # Rounding of a 54 x 54 inverse at a condition number of about 1e3, twice over.
    np.testing.assert_allclose(run.history, history, rtol=0, atol=1e-11 * np.abs(history).max())
    np.testing.assert_allclose(np.kron(np.eye(actuators), run.covariance), gain, atol=1e-11 * gain.max())


@given(
    seed=st.integers(0, 10**6),
    forgetting=st.floats(0.9, 1.0),
    n=st.integers(1, 8),
    actuators=st.integers(1, 5),
)
@settings(max_examples=30, deadline=None)
def test_identification_is_weighted_least_squares(seed, forgetting, n, actuators):
    regressors, disturbance, _ = record(n, actuators, 100, seed)
    start = np.diag(np.geomspace(0.5, 2, n))
    run = identify(FeRls(start, forgetting, np.inf), regressors, disturbance)
    weights, covariance = naive.weighted_least_squares(regressors, disturbance, start, forgetting)
    np.testing.assert_allclose(run.weights, weights, atol=1e-9)
    np.testing.assert_allclose(run.covariance, covariance, atol=1e-10 * np.abs(covariance).max())


@given(
    seed=st.integers(0, 10**6),
    scale=st.floats(-6, 6),
    spread=st.floats(1, 1e3),
    limit=st.sampled_from([1.0, 10.0, np.inf]),
)
@settings(max_examples=30, deadline=None)
def test_covariance_stays_symmetric_and_definite(seed, scale, spread, limit):
    regressors, disturbance, _ = record(6, 2, 400, seed, spread)
    regressors = 10**scale * regressors
    start = steady_start(regressors, FORGETTING)
    run = identify(FeRls(start, FORGETTING, limit), regressors, disturbance)
    assert np.array_equal(run.covariance, run.covariance.T)
    size = np.sqrt(np.diag(run.covariance))
    assert np.linalg.eigvalsh(run.covariance / np.outer(size, size))[0] > 0
    assert np.all(np.diag(run.covariance) <= limit * np.diag(start) * (1 + 1e-12))


@given(seed=st.integers(0, 10**6), powers=st.lists(st.integers(-12, 12), min_size=4, max_size=4))
@settings(max_examples=30, deadline=None)
def test_ferls_does_not_depend_on_the_units_of_a_regressor(seed, powers):
    regressors, disturbance, _ = record(4, 2, 100, seed)
    units = 2.0 ** np.array(powers)  # powers of two: no rounding of their own
    start = np.array([1.0, 2.0, 3.0, 4.0])
    run = identify(FeRls(start, FORGETTING, 2.0), regressors, disturbance)
    scaled = identify(FeRls(start / units**2, FORGETTING, 2.0), units[:, None] * regressors, disturbance)
    np.testing.assert_array_equal(scaled.weights * units, run.weights)


@given(seed=st.integers(0, 10**6), mixing=st.integers(0, 10**6), form=st.sampled_from(FORMS))
@settings(max_examples=30, deadline=None)
def test_printed_ferls_does_not_depend_on_the_basis_of_its_regressors(seed, mixing, form):
    """Section 6: no orthonormal basis and no whitening; any invertible mixture gives the same commands."""
    regressors, disturbance, _ = record(seed=seed)
    rng = np.random.default_rng(mixing)
    left, right = (np.linalg.qr(rng.standard_normal((4, 4)))[0] for _ in range(2))
    transform = left @ np.diag(np.geomspace(0.1, 10, 4)) @ right
    start = np.diag([0.1, 1.0, 2.0, 5.0])
    plain = identify(FeRls(start, form=form, **PRINTED), regressors, disturbance, every=1)
    back = np.linalg.inv(transform)
    mixed_start = back.T @ start @ back
    mixed = identify(
        FeRls((mixed_start + mixed_start.T) / 2, form=form, **PRINTED),
        transform @ regressors,
        disturbance,
        every=1,
    )
    # Rounding of 150 samples at condition numbers up to 1e4 times 1e3 of the record, with a margin.
    np.testing.assert_allclose(
        mixed.history @ transform, plain.history, rtol=0, atol=1e-7 * np.abs(plain.history).max()
    )


@pytest.mark.parametrize("trace", ["literal", "regressors"])
def test_felms_is_its_naive_twin(trace):
    regressors, disturbance, _ = record()
    run = identify(FeLms(0.02, 1e-3, trace), regressors, disturbance)
    twin = naive.felms(regressors, disturbance, 0.02, 1e-3, trace == "literal")
    np.testing.assert_allclose(run.weights, twin, atol=1e-13)


@pytest.mark.parametrize("delay", [0, 1, 3])
@pytest.mark.parametrize("kind", ["FeLMS", "FeRLS"])
def test_modified_error_is_its_naive_twin(kind, delay):
    regressors, errors, _ = record()
    commands = np.random.default_rng(9).standard_normal(errors.shape)
    start = np.diag([0.1, 1.0, 2.0, 5.0])
    used = FeLms(0.02, 1e-3, path_delay=delay)
    step = naive.felms_step(0.02, 1e-3)
    if kind == "FeRLS":
        used, step = FeRls(start, **PRINTED, path_delay=delay), naive.ferls_step(start, FORGETTING)
    wanted = naive.modified(step, regressors, errors, commands, delay, len(errors))
    run = adapt(used, regressors, errors, every=1, commands=commands)
    np.testing.assert_allclose(run.history, wanted, atol=1e-11)
    stepper = AdaptationStepper(used, np.zeros(wanted.shape[1:]))
    for psi, error, command in zip(regressors.T, errors.T, commands.T, strict=True):
        stepper.update(psi, error, command)
    np.testing.assert_allclose(stepper.weights, wanted[-1], atol=1e-11)
    plain = adapt(FeLms(0.02) if kind == "FeLMS" else FeRls(start, **PRINTED), regressors, errors, every=1)
    assert np.abs(plain.history - wanted).max() > 0.01  # what the exchange does


def test_what_belongs_to_the_modified_error_is_given_with_a_path_delay_alone():
    regressors, errors, _ = record()
    late = FeLms(0.1, path_delay=1)
    for wrong in (
        lambda: adapt(late, regressors, errors),
        lambda: adapt(FeLms(0.1), regressors, errors, commands=errors),
        lambda: adapt(late, regressors, errors, commands=errors[:1]),
        lambda: identify(late, regressors, errors),
        lambda: AdaptationStepper(late, np.zeros((3, 4))).update(np.ones(4), np.ones(3)),
        lambda: AdaptationStepper(FeLms(), np.zeros((3, 4))).update(np.ones(4), np.ones(3), np.ones(3)),
    ):
        with pytest.raises(InputError, match=r"commands?|path_delay"):
            wrong()


def test_limit_is_added_information():
    rng = np.random.default_rng(4)
    root = rng.standard_normal((5, 5))
    covariance = root @ root.T + 0.1 * np.eye(5)
    covariance = (covariance + covariance.T) / 2
    psi, e = rng.standard_normal(5), rng.standard_normal(2)
    unlimited, limits = covariance.copy(), 0.6 * np.diag(covariance)
    weights, same = np.zeros((2, 5)), np.zeros((2, 5))
    levels, free = np.zeros((4, 5)), np.zeros((4, 5))
    levels[0], free[0] = limits, np.inf
    _, reached = ferls_update(weights, covariance, 0.9, levels, np.inf, np.empty(5), psi, e)
    assert reached
    hold_triangle(covariance, 0.9, levels, np.empty(5))
    assert not ferls_update(same, unlimited, 0.9, free, np.inf, np.empty(5), psi, e)[1]
    np.testing.assert_allclose(levels[2], 0.1 * (np.diag(unlimited) > limits))
    assert np.any(np.diag(unlimited) > limits)  # the limit had something to do
    np.testing.assert_allclose(covariance, naive.limited(unlimited, limits), atol=1e-13)
    np.testing.assert_array_equal(weights, same)


def test_silent_direction_winds_up_as_the_inverse_of_the_forgetting():
    regressors, disturbance, _ = record(samples=500)
    regressors[2] = 0
    free = identify(FeRls(1.0, **PRINTED), regressors, disturbance)
    assert free.covariance[2, 2] == pytest.approx(FORGETTING**-500, rel=1e-10)
    limited = identify(FeRls(1.0, FORGETTING), regressors, disturbance)
    assert limited.covariance[2, 2] == pytest.approx(10.0, rel=1e-12)
    np.testing.assert_allclose(limited.weights[:, [0, 1, 3]], free.weights[:, [0, 1, 3]], atol=1e-9)


def test_silent_combination_is_bounded_though_every_regressor_is_excited():
    regressors, disturbance, _ = record(3, 2, 4000)
    regressors[2] = regressors[0] - regressors[1]
    limited = identify(FeRls(1.0, FORGETTING), regressors, disturbance)
    assert np.linalg.eigvalsh(limited.covariance)[-1] <= 30.0  # the trace of the limits
    free = identify(FeRls(1.0, **PRINTED), regressors[:, :2000], disturbance[:, :2000])
    assert np.linalg.eigvalsh(free.covariance)[-1] > 1e6


def test_the_three_ways_to_call_it_agree():
    regressors, disturbance, _ = record()
    errors = []
    for algorithm in (FeRls(1.0, FORGETTING), FeLms(0.1)):
        stepper = AdaptationStepper(algorithm, np.zeros((3, 4)))
        errors = []
        for psi, d in zip(regressors.T, disturbance.T, strict=True):
            errors.append(d + stepper.weights @ psi)
            stepper.update(psi, errors[-1])
        run = identify(algorithm, regressors, disturbance, every=50)
        replay = adapt(algorithm, regressors, np.array(errors).T, every=50)
        np.testing.assert_allclose(stepper.weights, run.weights, atol=1e-12)
        np.testing.assert_allclose(replay.history, run.history, atol=1e-12)
        np.testing.assert_array_equal(run.samples, [50, 100, 150])
        assert stepper.samples == 150


def test_diverging_step_names_sample_and_cause():
    regressors, disturbance, _ = record(samples=2000)
    with pytest.raises(UnstableAdaptation, match=r"sample \d+.*step_size") as caught:
        identify(FeLms(3.0), regressors, disturbance)
    assert 0 < caught.value.sample < 2000
    assert "without bound" in caught.value.cause


def test_lost_definiteness_names_sample_and_cause():
    # A regressor that is silent for forty time constants, in a combination: beyond what float64 resolves.
    regressors, disturbance, _ = record(3, 1, 20_000)
    regressors[2] = regressors[0] - regressors[1] * (1 + 1e-9)
    with pytest.raises(UnstableAdaptation, match="covariance"):
        identify(FeRls(1.0, 0.98, np.inf), regressors, disturbance)
    assert np.all(np.isfinite(identify(FeRls(1.0, 0.98), regressors, disturbance).weights))


@pytest.mark.parametrize(
    ("settings", "regressor", "error"),
    [
        (FeLms(step_size=1e300), [1.0, 1.0], [1e100]),
        (FeRls(1.0), [1e200, 1.0], [1.0]),
        (FeRls(1.0), [1.0, 1.0], [-1.7e308]),
    ],
)
def test_stepper_keeps_its_state_when_the_update_cannot_be_used(settings, regressor, error):
    stepper = AdaptationStepper(settings, np.full((1, 2), 1.7e308))
    weights = stepper.weights.copy()
    covariance = None if stepper.covariance is None else stepper.covariance.copy()
    with pytest.raises(UnstableAdaptation):
        stepper.update(regressor, error)
    np.testing.assert_array_equal(stepper.weights, weights)
    if covariance is not None:
        np.testing.assert_array_equal(stepper.covariance, covariance)
    assert stepper.samples == 0


@pytest.mark.parametrize(("settings", "burst"), [(FeLms(step_size=1e300), 1.0), (FeRls(1.0), 1e200)])
def test_replay_and_stepper_name_the_same_sample(settings, burst):
    regressors, errors = np.random.default_rng(0).standard_normal((2, 50)), np.zeros((1, 50))
    regressors[:, 37] *= burst
    errors[0, 37] = 1e300
    with pytest.raises(UnstableAdaptation) as replayed:
        adapt(settings, regressors, errors)
    stepper = AdaptationStepper(settings, np.zeros((1, 2)))
    with pytest.raises(UnstableAdaptation) as stepped:
        for psi, e in zip(regressors.T, errors.T, strict=True):
            stepper.update(psi, e)
    assert replayed.value.sample == stepped.value.sample == 37
    assert str(replayed.value) == str(stepped.value)


@pytest.mark.parametrize("form", FORMS)
def test_factor_holds_the_covariance(form):
    rng = np.random.default_rng(8)
    root = rng.standard_normal((5, 5))
    covariance = root @ root.T + np.diag([1e-3, 1.0, 10.0, 1.0, 1e3])
    np.testing.assert_allclose(covariance_of(form, factor_of(form, covariance)), covariance, rtol=1e-12)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("dtype", "tolerance"), [("float64", 1e-10), ("float32", 2e-3)])
@pytest.mark.parametrize("limit", [2.0, np.inf])
def test_every_form_is_weighted_least_squares(form, dtype, tolerance, limit):
    regressors, disturbance, _ = record(6, 3, 300)
    regressors[4] *= 0.01 if limit == 2.0 else 1.0  # the limit has something to do below
    regressors, disturbance = regressors.astype(np.float32), disturbance.astype(np.float32)
    start = 0.05 * np.eye(6)
    run = identify(FeRls(start, FORGETTING, limit, form, dtype), regressors, disturbance)
    rounded = float(np.dtype(dtype).type(FORGETTING))
    if limit == np.inf:
        weights, covariance = naive.weighted_least_squares(regressors, disturbance, start, rounded)
        assert not run.held.any()
    else:
        whole = identify(FeRls(start, rounded, limit, "triangle"), regressors, disturbance)
        weights, covariance = whole.weights, whole.covariance
        assert run.held[4] > 0.5 and not run.held[0]
        # A factor holds one element a sample against its limit, the triangle all: up to six samples of growth.
        tolerance = max(tolerance, 6 * (1 - FORGETTING))
    np.testing.assert_allclose(run.weights, weights, atol=tolerance * np.abs(weights).max())
    np.testing.assert_allclose(run.covariance, covariance, atol=tolerance * np.abs(covariance).max())


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("forgetting", [0.7, 0.99])
def test_what_is_held_all_the_time_is_held_for_a_share_of_1(form, dtype, forgetting):
    """Within a turn of the elements that a form with factors looks at one by one, and never more."""
    regressors, disturbance, _ = record(3, 1, 900)
    regressors[1, 100:] = 0
    settings = FeRls(1.0, forgetting, 1.0, form, dtype)
    ends = [identify(settings, regressors[:, :k], disturbance[:, :k]).held[1] for k in range(890, 900)]
    turn = 1 if form == "triangle" else 3
    assert 1 - 5e-3 < max(ends) <= 1.0 and min(ends) > forgetting ** (turn - 1) * (1 - 5e-3)


def test_safe_form_keeps_float32_definite_where_the_triangle_loses_it():
    # One motion on four sensors, each with a noise 70 dB below: scaled condition number 4e7.
    rng = np.random.default_rng(5)
    regressors = rng.standard_normal(40_000) + 3e-4 * rng.standard_normal((4, 40_000))
    disturbance = regressors.sum(axis=0, keepdims=True)
    start = steady_start(regressors, 0.999)
    with pytest.raises(UnstableAdaptation, match="covariance"):
        identify(FeRls(start, 0.999, np.inf, "triangle", "float32"), regressors, disturbance)
    run = identify(FeRls(start, 0.999, np.inf, dtype="float32"), regressors, disturbance)
    error = disturbance + run.weights @ regressors
    assert error.std() < 1e-3 * disturbance.std()


def test_limit_holds_though_the_start_is_as_large_as_one_likes():
    regressors, disturbance, _ = record(samples=4000)
    regressors[2, 2000:] = 0
    run = identify(FeRls(1e5, FORGETTING), regressors, disturbance)
    window = FORGETTING ** np.arange(2000)[::-1]
    power = max(window[-k:] @ regressors[2, :k] ** 2 for k in range(100, 2001, 100))
    # The granted hundred times the value that its own power gives, at the power's largest.
    assert 50 / power < run.covariance[2, 2] <= 101 / power
    assert run.held[2] > 0.9 and run.held[0] < 1e-6  # the start alone was held there


@pytest.mark.parametrize("form", ["safe", "UD"])
def test_regressors_that_are_alike_are_followed_in_the_memory_from_their_own_covariance(form):
    """Against weighted least squares, ten time constants on: their difference has a millionth of their power."""
    rng, count = np.random.default_rng(3), round(10 / (1 - FORGETTING))
    both, own = rng.standard_normal((2, count))
    psi = np.vstack([both, both + 1e-3 * own])
    disturbance = np.array([[300.0, -300.0]]) @ psi + 1e-3 * rng.standard_normal(count)
    power = np.array([[1.0, 1.0], [1.0, 1.0 + 1e-6]])
    settings = FeRls((1 - FORGETTING) * np.linalg.inv(power), FORGETTING, form=form)
    found = identify(settings, psi, disturbance).weights
    root = FORGETTING ** (np.arange(count)[::-1] / 2)
    best = np.linalg.lstsq((root * psi).T, -(root * disturbance[0]), rcond=None)[0]
    assert found == pytest.approx(best[None], rel=0.01)
