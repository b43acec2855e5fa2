"""H2 synthesis: Riccati equations against matrix inequalities, against other controllers and integrals of the response."""

import numpy as np
import pytest
from scipy import linalg

from naive.motion import frequency_norm
from stillwork.base.checks import InputError
from stillwork.estimation import H2Synthesis, h2_lmi, h2_riccati, matrix_inequalities, mixed_lmi
from stillwork.estimation.h2 import regularised
from stillwork.lti import GeneralisedPlant, StateModel, h2_norm, hinf_norm


def toy(seed=0, n=4):
    """A small random plant, regular already, with one control and two measurements."""
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(n, n)) / np.sqrt(n)
    d = np.zeros((4, 5))
    model = StateModel(a, rng.normal(size=(n, 5)), rng.normal(size=(4, n)), d)
    return GeneralisedPlant(model, exogenous=4, performance=2)


LAG = 1.3  # rad/s, of the weight


def weighed(seed, n=4):
    """A small random plant with one performance output, and the same with this output through a lag as a second."""
    rng = np.random.default_rng(seed)
    a, b, c = rng.normal(size=(n, n)) / np.sqrt(n), rng.normal(size=(n, 5)), rng.normal(size=(3, n))
    plant = GeneralisedPlant(StateModel(a, b, c, np.zeros((3, 5))), exogenous=4, performance=1)
    a = np.block([[a, np.zeros((n, 1))], [LAG * c[:1], -LAG * np.eye(1)]])
    b, c = np.vstack([b, np.zeros((1, 5))]), np.insert(c, 1, 0.0, axis=0)
    c = np.hstack([c, np.eye(4, 1, -1)])
    return plant, GeneralisedPlant(StateModel(a, b, c, np.zeros((4, 5))), exogenous=4, performance=2)


def optimum(seed):
    """Both plants, the optimum of the two-norm and the weighted peak of its loop."""
    plant, two = weighed(seed)
    best = h2_riccati(plant, 0.7, 0.4)
    return plant, two, best, hinf_norm(two.close(best.controller).select([0], [1])).magnitude


@pytest.mark.parametrize("seed", [0, 1, 3])  # 2 is all but uncontrollable, see below
def test_riccati_and_inequalities_find_the_same_optimum(seed):
    plant = toy(seed)
    riccati, lmi = h2_riccati(plant, 0.7, 0.4), h2_lmi(plant, 0.7, 0.4)
    assert lmi.status == "optimal"
    np.testing.assert_allclose(lmi.claimed, riccati.regular_norm, rtol=1e-4)
    np.testing.assert_allclose(riccati.claimed, riccati.regular_norm, rtol=1e-9)
    assert lmi.regular_norm >= riccati.regular_norm * (1 - 1e-6)
    loop = regularised(plant, 0.7, 0.4).close(riccati.controller)
    np.testing.assert_allclose(frequency_norm(loop), riccati.regular_norm, rtol=1e-5)


def test_a_peak_limit_far_away_leaves_the_optimum_of_the_two_norm():
    _, two, best, peak = optimum(0)
    level = 1e4 * peak
    mixed = mixed_lmi(two, level, 0.1 * level, 0.7, 0.4)
    np.testing.assert_allclose([mixed.claimed, mixed.regular_norm], best.regular_norm, rtol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 3])
def test_mixed_inequalities_bound_the_norms_of_their_loop(seed):
    plant, two, best, peak = optimum(seed)
    level = 0.7 * peak
    mixed = mixed_lmi(two, level, 100.0, 0.7, 0.4)
    assert mixed.status == "optimal"
    assert best.regular_norm <= mixed.regular_norm <= mixed.claimed
    loop = plant.close(mixed.controller)
    assert mixed.norm == pytest.approx(h2_norm(loop), rel=1e-9)
    regular = regularised(plant, 0.7, 0.4).close(mixed.controller)
    assert mixed.regular_norm == pytest.approx(frequency_norm(regular), rel=1e-5)
    omega = np.geomspace(1e-3, 1e3, 20000)
    weighted = loop.frequency_response(omega)[0, 0] * LAG / (1j * omega + LAG)
    assert np.abs(weighted).max() <= level


@pytest.mark.slow
def test_a_level_below_what_can_be_kept_shows_status_and_residuals():
    _, two, _, peak = optimum(0)
    with pytest.raises(InputError, match=r"'\w*PrimalInfeasible'.*\d+ iterations.*\(primal\)"):
        mixed_lmi(two, 0.1 * peak, 100.0, 0.7, 0.4)


@pytest.mark.slow
@pytest.mark.parametrize("lie", ["claim", "level"])
def test_a_loop_that_breaks_what_the_solver_claims_is_refused(lie, monkeypatch):
    _, two, best, peak = optimum(0)
    solve = matrix_inequalities._by_inequalities

    def inaccurate(regular, size, level, ratio):
        status, claimed, controller = solve(regular, size, 1.3 * peak if lie == "level" else level, ratio)
        return status, 0.5 * best.regular_norm if lie == "claim" else claimed, controller

    monkeypatch.setattr(matrix_inequalities, "_by_inequalities", inaccurate)
    level = (0.7 if lie == "claim" else 0.5) * peak
    with pytest.raises(InputError, match=r"'optimal\w*'.*H2 norm.*level.*residual"):
        mixed_lmi(two, level, 100.0, 0.7, 0.4)


def test_arguments_of_the_mixed_problem_are_named():
    plant, two = weighed(0)
    with pytest.raises(InputError, match=r"^plant\b.*\b1 performance"):
        mixed_lmi(plant, 1.0, 1.0, 0.7, 0.4)
    with pytest.raises(InputError, match="level"):
        mixed_lmi(two, 0.0, 1.0, 0.7, 0.4)
    with pytest.raises(InputError, match="ratio"):
        mixed_lmi(two, 1.0, -1.0, 0.7, 0.4)


def test_infeasible_inequalities_show_the_status():
    # The control does not reach the unstable state, so no controller stabilises the loop.
    a = np.diag([1.0, -1.0])
    b = np.array([[1.0, 0.0], [1.0, 1.0]])
    model = StateModel(a, b, np.array([[1.0, 1.0], [1.0, 1.0]]), np.zeros((2, 2)))
    plant = GeneralisedPlant(model, exogenous=1, performance=1)
    with pytest.raises(InputError, match=r"Clarabel|residual"):
        h2_lmi(plant, 1.0, 1.0)
    with pytest.raises(InputError, match=r"Riccati|residual|stable"):
        h2_riccati(plant, 1.0, 1.0)


def mode(unit):
    """A mode at 600 rad/s of 1 kg in SI units, its displacement (and that through a lag) counted in `unit` m."""
    a = np.array([[0.0, 1.0, 0.0], [-(600.0**2), -12.0, 0.0], [100.0, 0.0, -100.0]])
    b = np.array([[0.0, 0.0], [1.0, 1.0], [0.0, 0.0]])
    c = np.array([[1 / unit, 0.0, 0.0], [0.0, 0.0, 1 / unit], [1.0, 0.0, 0.0]])
    both = GeneralisedPlant(StateModel(a, b, c, np.zeros((3, 2))), exogenous=1, performance=2)
    first = StateModel(a[:2, :2], b[:2], c[::2, :2], np.zeros((2, 2)))
    return GeneralisedPlant(first, exogenous=1, performance=1), both


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e-6, 1e6])
def test_a_machine_has_its_optimum_in_whatever_unit_its_performance_is_counted(unit):
    one, both = mode(unit)
    expected = h2_riccati(one, 1e-3 / unit, 1e-3).regular_norm
    found = h2_lmi(one, 1e-3 / unit, 1e-3)
    assert [found.claimed, found.regular_norm] == pytest.approx([expected] * 2, rel=1e-4)
    mixed = mixed_lmi(both, 1 / unit, 1.0 / unit, 1e-3 / unit, 1e-3)  # a level far away
    assert [mixed.claimed, mixed.regular_norm] == pytest.approx([expected] * 2, rel=1e-4)
    peak = hinf_norm(both.close(mixed.controller).select([0], [1])).magnitude
    near = mixed_lmi(both, 2 * peak, 0.01 / unit, 1e-3 / unit, 1e-3)
    assert near.claimed * unit == pytest.approx(1.05262e-3, rel=1e-3)  # its ratio is not the best


def modal(seed, modes):
    """A random lightly damped machine in SI units: a force that acts and one that disturbs, and their displacements."""
    rng = np.random.default_rng([seed, modes])
    omega, zeta = np.sort(10 ** rng.uniform(1, 3.5, modes)), 10 ** rng.uniform(-2.5, -1, modes)
    stiff, zero = -np.diag(omega**2), np.zeros((modes, modes))
    a = np.block([[zero, np.eye(modes)], [stiff, -np.diag(2 * zeta * omega)]])
    b = np.vstack([np.zeros((modes, 2)), rng.normal(size=(modes, 2))])
    c = np.hstack([rng.normal(size=(2, modes)), np.zeros((2, modes))])
    cost = 10 ** rng.uniform(-2, 0.5, 2) / omega[0] ** np.array([2, 2.5])
    return GeneralisedPlant(StateModel(a, b, c, np.zeros((2, 2))), 1, 1), *cost


@pytest.mark.slow
@pytest.mark.parametrize("modes", [1, 2, 3])
def test_inequalities_answer_for_lightly_damped_machines_in_si_units(modes):
    for seed in range(6):
        plant, effort, noise = modal(seed, modes)
        expected = h2_riccati(plant, effort, noise).regular_norm
        found = h2_lmi(plant, effort, noise)
        assert [found.claimed, found.regular_norm] == pytest.approx([expected] * 2, rel=3e-3)


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("deaf", [True, False])
def test_what_sees_or_moves_nothing_costs_nothing_at_rest(deaf):
    """And where the plant is unstable, what it costs to make it stable."""
    _, plant = mode(1.0)
    m = plant.model
    b, c = (m.b * [0.0, 1.0], m.c) if deaf else (m.b, m.c * [[0.0], [0.0], [1.0]])
    for synthesis in (h2_lmi, lambda *given: mixed_lmi(given[0], 1.0, 1.0, *given[1:])):
        resting = synthesis(GeneralisedPlant(StateModel(m.a, b, c, m.d), 1, 2), 1e-3, 1e-3)
        assert (resting.claimed, resting.norm, resting.regular_norm) == (0.0, 0.0, 0.0)
        unstable = GeneralisedPlant(StateModel(m.a + np.diag([0.0, 17.0, 0.0]), b, c, m.d), 1, 2)
        found = synthesis(unstable, 1e-3, 1e-3)
        if synthesis is h2_lmi:
            assert found.claimed == pytest.approx(h2_riccati(unstable, 1e-3, 1e-3).claimed, rel=1e-3)


def square(seed, noises, costs):
    """A random lightly damped machine with as many noises as measurements, costs as controls, and some more."""
    rng = np.random.default_rng([9, seed])
    modes, controls, measured = (int(rng.integers(1, high)) for high in (6, 3, 3))
    w, z = measured + noises, controls + costs
    omega, zeta = 10 ** rng.uniform(0, 4, modes), 10 ** rng.uniform(-3, -1.3, modes)
    a = np.block(
        [[np.zeros((modes, modes)), np.eye(modes)], [-np.diag(omega**2), -np.diag(2 * zeta * omega)]]
    )
    b = np.vstack([np.zeros((modes, w + controls)), rng.normal(size=(modes, w + controls))])
    c = np.hstack([rng.normal(size=(z + measured, modes)), np.zeros((z + measured, modes))])
    d = np.zeros((z + measured, w + controls))
    d[:z, w:] = rng.normal(size=(z, controls)) * 10 ** rng.uniform(-4, 0)
    d[z:, :w] = rng.normal(size=(measured, w)) * 10 ** rng.uniform(-4, 0)
    return GeneralisedPlant(StateModel(a, b, c, d), w, z)


@pytest.mark.slow
@pytest.mark.parametrize(("noises", "costs"), [(0, 0), (0, 1)])
def test_measurements_that_know_all_noise_and_controls_that_reach_all_costs_have_an_optimum(noises, costs):
    solved = 0
    for seed in range(40):
        try:
            found = h2_riccati(square(seed, noises, costs))
        except InputError:
            continue
        solved += 1
        assert found.norm <= max(1.00001 * found.claimed, 1e-6)
    assert solved >= 39


def test_an_optimum_far_above_the_first_guess_is_found_as_well():
    expected = h2_riccati(toy(2), 0.7, 0.4).regular_norm
    assert expected > 1e3
    assert h2_lmi(toy(2), 0.7, 0.4).regular_norm == pytest.approx(expected, rel=1e-2)


def test_an_inaccurate_solution_is_refused_with_its_residual(monkeypatch):
    solve, least = matrix_inequalities._by_inequalities, h2_riccati(toy(), 0.7, 0.4).regular_norm

    def inaccurate(*given):
        status, _, controller = solve(*given)
        return status, 0.99 * least, controller

    monkeypatch.setattr(matrix_inequalities, "_by_inequalities", inaccurate)
    with pytest.raises(InputError, match=r"'optimal\w*'.*H2 norm.*residual"):
        h2_lmi(toy(), 0.7, 0.4)


def test_a_gain_that_leaves_the_estimate_unstable_is_refused_where_its_equation_is_solved(monkeypatch):
    """An unstable state, which the zero solution does not hold; and one that stays, and that no noise moves."""
    d = np.array([[0.0, 0, 0], [0, 0, 1], [0, 1, 0]])
    b, c = np.array([[1.0, 0, 1], [0, 0, 1]]), np.array([[1.0, 0], [0, 0], [1, 1]])
    unstable, staying = (
        GeneralisedPlant(StateModel(np.diag([-1.0, pole]), b, c, d), 2, 2) for pole in (0.5, 0.0)
    )
    assert h2_riccati(unstable).norm > 0
    monkeypatch.setattr(linalg, "solve_continuous_are", lambda a, *_, **__: np.zeros_like(a))
    for plant in (unstable, staying):
        with pytest.raises(InputError, match=r"\bRiccati\b"):
            h2_riccati(plant)


def test_feedthrough_and_wrong_shapes_are_named():
    model = StateModel(-np.eye(1), np.ones((1, 2)), np.ones((2, 1)), np.array([[1.0, 0.0], [0.0, 0.0]]))
    with pytest.raises(InputError, match="feedthrough"):
        h2_riccati(GeneralisedPlant(model, 1, 1), 1.0, 1.0)
    with pytest.raises(InputError, match=r"\b2 exogenous.*\b1 performance"):
        GeneralisedPlant(model, 2, 1)
    with pytest.raises(InputError, match=r"^effort\b"):
        regularised(toy(), 0.0, 1.0)
    with pytest.raises(InputError, match=r"^controller\b"):
        toy().close(StateModel(np.eye(1), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1))))


def least_norm(plant):
    """The optimum by its closed form: what the start of the states costs, and what their estimation adds."""
    a, b1, b2, c1, c2, _, d12, d21, _ = plant.blocks
    x = linalg.solve_continuous_are(a, b2, c1.T @ c1, d12.T @ d12, s=c1.T @ d12)
    y = linalg.solve_continuous_are(a.T, c2.T, b1 @ b1.T, d21 @ d21.T, s=b1 @ d21.T)
    cost = d12.T @ d12
    f = np.linalg.solve(cost, b2.T @ x + d12.T @ c1)
    return np.sqrt(np.trace(b1.T @ x @ b1) + np.trace(f.T @ cost @ f @ y))


def regular(seed, unstable):
    """A random regular plant with correlated noises and costs, and a D22."""
    rng = np.random.default_rng(seed)
    n, controls, measurements = (int(rng.integers(*each)) for each in ((2, 10), (1, 4), (1, 4)))
    w, z = measurements + int(rng.integers(1, 4)), controls + int(rng.integers(1, 4))
    a = rng.normal(size=(n, n)) / np.sqrt(n) + unstable * np.eye(n)
    b, c, d = (
        rng.normal(size=size)
        for size in ((n, w + controls), (z + measurements, n), (z + measurements, w + controls))
    )
    d[:z, :w] = 0
    return GeneralisedPlant(StateModel(a, b, c, d), w, z)


def in_other_units(plant, rng, decades):
    """The same plant with other units for each state, control and measurement, and for time: norms stay."""
    m, w, z = plant.model, plant.exogenous, plant.performance
    (n, inputs), outputs, rate = m.b.shape, len(m.c), 10.0 ** rng.uniform(-decades, decades)
    states, controls, measured = (
        10.0 ** rng.uniform(-decades, decades, k) for k in (n, inputs - w, outputs - z)
    )
    into = np.concatenate(
        [np.full(w, 1 / np.sqrt(rate)), controls]
    )  # white noise of unit intensity stays one
    out = np.concatenate([np.ones(z), measured])[:, None]
    a, b, c = m.a * states / states[:, None], m.b * into / states[:, None], m.c * states * out
    return GeneralisedPlant(StateModel(a * rate, b * rate, c, m.d * into * out), w, z)


@pytest.mark.parametrize("unstable", [-1.0, 0.0, 0.5])
@pytest.mark.parametrize("decades", [0, 3, 9])
def test_the_optimum_has_its_closed_form_in_any_units(unstable, decades):
    rng = np.random.default_rng(decades)
    for seed in range(12):
        plant = regular(seed, unstable)
        found = h2_riccati(in_other_units(plant, rng, decades))
        assert [found.norm, found.regular_norm, found.claimed] == pytest.approx(
            [least_norm(plant)] * 3, rel=1e-5
        )


@pytest.mark.parametrize(("seed", "decades"), [(10, 3), (10, 9), (299, 3), (477, 9)])
def test_the_norm_of_a_loop_that_amplifies_its_rounding_is_right_or_refused(seed, decades):
    """Several unstable modes behind one measurement: the residual of the Lyapunov equation says nothing any more."""
    plant = regular(seed, 1.0)
    found = h2_riccati(in_other_units(plant, np.random.default_rng(seed), decades))
    assert [found.norm, found.regular_norm] == pytest.approx([least_norm(plant)] * 2, rel=1e-5)


def test_a_plant_in_discrete_time_is_refused_by_the_inequalities_and_closed_in_its_own():
    m = toy().model
    sampled = GeneralisedPlant(StateModel(m.a, m.b, m.c, m.d, sample_time=0.1), exogenous=4, performance=2)
    with pytest.raises(InputError, match=r"^plant\b.*discrete"):
        h2_lmi(sampled, 0.7, 0.4)
    gain = StateModel(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), -0.1 * np.ones((1, 2)))
    with pytest.raises(InputError, match=r"^models\b"):
        sampled.close(gain)
    assert toy().close(gain).sample_time == 0.0
    assert sampled.close(StateModel(gain.a, gain.b, gain.c, gain.d, 0.1)).sample_time == 0.1


def test_the_loop_has_the_response_of_the_linear_fractional_transformation():
    plant, k = regular(4, 0.0), regular(5, 0.0).model.select([0], [0])
    plant = GeneralisedPlant(
        plant.model.select(range(plant.exogenous + 1), range(plant.performance + 1)),
        plant.exogenous,
        plant.performance,
    )
    w, z, omega = plant.exogenous, plant.performance, np.array([0.0, 0.7, 20.0])
    whole, kk = plant.model.frequency_response(omega), k.frequency_response(omega)[0, 0]
    expected = whole[:z, :w] + whole[:z, w:] * whole[z:, :w] * kk / (1 - whole[z, w] * kk)
    np.testing.assert_allclose(plant.close(k).frequency_response(omega), expected, rtol=1e-9)


def test_a_loop_of_feedthroughs_without_a_solution_is_refused():
    plant = GeneralisedPlant(
        StateModel(-np.eye(1), np.ones((1, 2)), np.ones((2, 1)), np.diag([0.0, 2.0])), 1, 1
    )
    with pytest.raises(InputError, match="feedthrough"):
        plant.close(StateModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), 0.5 * np.eye(1)))


@pytest.mark.parametrize(
    "synthesis", [h2_riccati, h2_lmi, lambda plant, **cost: mixed_lmi(plant, 1.0, **cost)]
)
def test_what_no_synthesis_takes_is_named(synthesis):
    """Efforts and noises of a wrong number or sign, and a plant whose norm no controller makes finite."""
    _, two = weighed(0)
    with pytest.raises(InputError, match=r"^effort\b"):
        synthesis(two, effort=[0.1, 0.2], noise=0.1)
    with pytest.raises(InputError, match=r"^noise\b"):
        synthesis(two, effort=0.1, noise=[0.1, -0.1])
    with pytest.raises(InputError, match=r"^effort\b.*more effort"):
        synthesis(two)
    m = two.model
    fed = GeneralisedPlant(StateModel(m.a, m.b, m.c, np.eye(*m.d.shape)), two.exogenous, two.performance)
    with pytest.raises(InputError, match="feedthrough"):
        synthesis(fed, effort=0.1, noise=0.1)
    static = StateModel(np.zeros((0, 0)), np.zeros((0, 5)), np.zeros((4, 0)), m.d)
    with pytest.raises(InputError, match=r"^plant\b.*states"):
        synthesis(GeneralisedPlant(static, 4, 2), effort=0.1, noise=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2, 3])
def test_a_solver_that_stops_a_little_short_is_judged_by_its_loop(seed):
    plant = regular(seed, -1.0)
    found = h2_lmi(plant)
    assert found.status in ("optimal", "optimal_inaccurate")  # as the processor rounds
    assert found.norm == pytest.approx(least_norm(plant), rel=1e-3)


def test_a_norm_below_zero_is_refused():
    with pytest.raises(InputError, match=r"^claimed\b"):
        H2Synthesis(toy().model, 1.0, 1.0, -1.0)


def test_an_optimum_that_no_float_keeps_says_what_would_help():
    with pytest.raises(InputError, match=r"norm.*effort"):
        h2_riccati(regular(132, 1.0))
