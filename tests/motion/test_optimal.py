import numpy as np
import pytest
from scipy import linalg

from experiments.motion.designs import DAMPING
from experiments.motion.machines import published_noise, stage, stage_mass
from notebooks.motion.optimal_observer import (
    ObserverProblem,
    control_bandwidth_hz,
    emphasised,
    front,
    front_values,
    published_norms,
    sensitivity_weight,
    tipping_corner,
    weighted_peak,
)
from stillwork.base.checks import InputError
from stillwork.control.applications import Application, compensator
from stillwork.control.loops import INPUTS, OUTPUTS, closed_loop
from stillwork.control.pid import PidFamily
from stillwork.estimation import h2_riccati
from stillwork.estimation.observer import kalman_observer
from stillwork.lti import h2_norm
from stillwork.lti.reduction import truncate
from workbook.choices.kept import read_settings
from workbook.claims import load_entries

SCALES = (0.06, 6e-9, 6e-9)


@pytest.fixture(scope="module")
def problem():
    return on_stage(4)


def on_stage(modes):
    plant = truncate(stage().at([0], [4]), modes, 0)
    return ObserverProblem(plant, PidFamily(stage_mass())(83.0), DAMPING, 2.0, SCALES)


def regularisation(problem, size=0.01):
    effort = size * np.concatenate([[1.0], 1 / problem.plant.frequencies[1:]])
    return effort, size * np.array([4e6, 1.0]) / np.sqrt(2 * np.pi * 700)


def test_closing_it_with_a_kalman_observer_is_the_loop_of_chapter_3(problem):
    observer = kalman_observer(problem.plant, published_noise(), 1e3)
    loop = problem.generalised().close(problem.read(observer))
    application = Application(compensate=True, damping=DAMPING, selectivity=2.0)
    other = closed_loop(problem.plant, compensator(observer, application), problem.controller.state_space())
    omega = 2 * np.pi * np.geomspace(1, 1000, 60)
    ours = loop.frequency_response(omega)[0]
    twin = other.frequency_response(omega)[OUTPUTS.index("e_true")]
    corners = (700.0, 200.0, 200.0)
    for k, (name, scale) in enumerate(zip(("r", "w", "v"), (1.0, *SCALES[:2]), strict=True)):
        weight = scale / (1 + 1j * omega / (2 * np.pi * corners[k]))
        np.testing.assert_allclose(ours[k], twin[INPUTS.index(name)] * weight, rtol=1e-6, atol=1e-18)
    np.testing.assert_allclose(ours[3], twin[INPUTS.index("d")] * SCALES[2], rtol=1e-6, atol=1e-18)
    same = closed_loop(
        problem.plant, problem.compensator(problem.read(observer)), problem.controller.state_space()
    )
    np.testing.assert_allclose(
        same.frequency_response(omega)[0, 0], twin[INPUTS.index("r")], rtol=1e-6, atol=1e-12
    )


def test_norm_of_the_kalman_loop_does_not_know_the_noise_model(problem):
    generalised = problem.generalised()
    norms = [
        h2_norm(generalised.close(problem.read(kalman_observer(problem.plant, published_noise(), q))))
        for q in (1e-2, 1.0, 1e3, 1e5)
    ]
    np.testing.assert_allclose(norms, norms[0], rtol=1e-9)


def test_the_optimum_of_the_stage_tracks_nothing(problem):
    """Inequalities reach it in notebook 20, within a thousandth, and on small plants above."""
    generalised = problem.generalised()
    riccati = h2_riccati(generalised, *regularisation(problem))
    assert riccati.norm < np.sqrt(700 * np.pi)


@pytest.mark.slow
def test_the_front_is_verified_and_monotone(problem):
    generalised = problem.generalised()
    kalman = generalised.close(problem.read(kalman_observer(problem.plant, published_noise(), 1e3)))
    corner = tipping_corner(kalman)
    weight = sensitivity_weight(corner)
    assert weighted_peak(kalman, weight) == pytest.approx(1, abs=1e-6)
    points = front(generalised, weight, [0.03, 0.3, 3.0], *regularisation(problem))
    assert np.all(np.diff([p.h2 for p in points]) > 0)
    assert np.all(np.diff([p.weighted_peak for p in points]) < 0)
    last = generalised.close(points[-1].synthesis.controller).select([0], [0])
    omega = np.geomspace(1e-2, 1e5, 40000)
    response = np.abs(last.frequency_response(omega)[0, 0] * weight.frequency_response(omega)[0, 0])
    assert points[-1].weighted_peak == pytest.approx(response.max(), rel=1e-4)
    assert points[-1].weighted_peak >= response.max() * (1 - 1e-9)
    assert len(emphasised(generalised, weight, 1.0).model.a) == 23


def test_the_bound_is_the_norm_of_the_shortest_error_that_the_zeros_allow(problem):
    model = problem.plant.state_space()
    pencil = np.block([[model.a, model.b], [model.c, model.d]])
    zeros = linalg.eigvals(pencil, linalg.block_diag(np.eye(len(model.a)), 0))
    zeros = zeros[np.isfinite(zeros)]
    zeros = zeros[(zeros.real > 1.0) & (np.abs(zeros) < 1e5)]
    assert len(zeros) == 2
    rate = 2 * np.pi * 700
    # Least squares over a rational basis with the values at the zeros as constraints, in another basis than the kernel.
    omega, poles = rate * np.tan(np.linspace(1e-4, np.pi / 2 - 1e-4, 40001)), rate * np.geomspace(0.2, 5, 12)
    weight = np.gradient(omega)
    basis = 1 / (1j * omega[:, None] + poles)
    gram = (basis.conj().T @ (weight[:, None] * basis)).real / np.pi
    at = 1 / (zeros[:1, None] + poles)
    constraints, values = np.vstack([at.real, at.imag]), rate / (zeros[:1] + rate)
    solved = np.linalg.solve(
        np.block([[gram, constraints.T], [constraints, np.zeros((2, 2))]]),
        np.concatenate([np.zeros(12), values.real, values.imag]),
    )[:12]
    np.testing.assert_allclose(np.sqrt(solved @ gram @ solved), problem.bound, rtol=2e-4)


def test_control_bandwidth_is_where_the_open_loop_and_the_sensitivity_cross():
    """By a root of the responses themselves; an unstable loop and one that never tracks have none."""
    plant = truncate(stage().at([0], [4]), 4, 0)
    controller = PidFamily(stage_mass())(40.0).state_space()
    loop = closed_loop(plant, None, controller)
    open_loop = control_bandwidth_hz(loop)
    at = np.array([2 * np.pi * open_loop])
    gain = np.abs(plant.frequency_response(at)[0, 0] * controller.frequency_response(at)[0, 0])[0]
    assert gain == pytest.approx(1.0, abs=1e-4)
    tracking = control_bandwidth_hz(loop, "r to e_true")
    error = loop.frequency_response(np.array([2 * np.pi * tracking]))[0, INPUTS.index("r"), 0]
    assert abs(error) == pytest.approx(np.sqrt(0.5), abs=1e-4)
    assert 0 < tracking < open_loop
    unstable = closed_loop(plant, None, PidFamily(stage_mass())(400.0).state_space())
    assert np.isnan(control_bandwidth_hz(unstable))
    with pytest.raises(InputError, match="1 of 3 loops are unstable"):
        front_values(open_loop, np.array([control_bandwidth_hz(unstable), open_loop]))


@pytest.mark.slow
def test_the_windows_of_table_5_1_end_where_a_norm_leaves_its_printed_digits():
    """In settings.csv, found by the search of all studies."""
    kept = [each for each in read_settings("motion").windows if each.number.startswith("motion.table-5-1.")]
    chosen = [each for each in kept if dict(each.others)["measured-mass"] == "5"]
    assert len(chosen) == 3
    for each in chosen:
        modes, printed = (
            int(dict(each.others).get("baseline-modes", "4")),
            load_entries("motion")[each.number].published,
        )
        given = {"measured_mass": 5, "baseline_modes": modes, "reference_size": 0.17, "seed": 0}
        ((low, high),) = each.pieces
        found = [
            published_norms(f_bw=hertz, **given)[each.number]
            for hertz in (low - 2e-3, low + 2e-3, high - 2e-3, high + 2e-3)
        ]
        assert [round(norm, 2) == printed for norm in found] == [False, True, True, False]
