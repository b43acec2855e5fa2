"""H2 and H-infinity synthesis in discrete time, and H-infinity in continuous time, against published cases and LMIs."""

import numpy as np
import pytest

from stillwork.base.checks import InputError
from stillwork.estimation import h2_lmi, h2_riccati, hinf_riccati
from stillwork.lti import GeneralisedPlant, StateModel, h2_norm, hinf_norm, tustin
from tests.motion.test_published_synthesis import SB10ED, SB10HD, matrices, responses

# SLICOT library, example data and results of SB10FD (A, B and C are those of SB10HD) and SB10DD (the plant of SB10ED).
SB10FD_D = "1 -2 -3 0 0; 0 4 0 1 0; 5 -3 -4 0 1; 0 1 0 1 -3; 0 0 1 7 1"
SB10FD = (
    """-2.8043 14.7367 4.6658 8.1596 0.0848 2.5290; 4.6609 3.2756 -3.5754 -2.8941 0.2393 8.2920;
    -15.3127 23.5592 -7.1229 2.7599 5.9775 -2.0285; -22.0691 16.4758 12.5523 -16.3602 4.4300 -3.3168;
    30.6789 -3.9026 -1.3868 26.2357 -8.8267 10.4860; -5.7429 0.0577 10.8216 -11.2275 1.5074 -10.7244""",
    "-0.1581 -0.0793; -0.9237 -0.5718; 0.7984 0.6627; 0.1145 0.1496; -0.6743 -0.2376; 0.0196 -0.7598",
    "-0.2480 -0.1713 -0.0880 0.1534 0.5016 -0.0730; 2.8810 -0.3658 1.3007 0.3945 1.2244 2.5690",
    "0.0554 0.1334; -0.3195 0.0333",
)
SB10DD_LEVEL = 111.294
SB10ED_CONTROLLER = (
    """-0.0551 -2.1891 -0.6607 -0.2532 0.6674 -1.0044; -1.0379 2.3804 0.5031 0.3960 -0.6605 1.2673;
    -0.0876 -2.1320 -0.4701 -1.1461 1.2927 -1.5116; -0.1358 -2.1237 -0.9560 -0.7144 0.6673 -0.7957;
    0.4900 0.0895 0.2634 -0.2354 0.1623 -0.2663; 0.1672 -0.4163 0.2871 -0.1983 0.4944 -0.6967""",
    "-0.5985 -0.5464; 0.5285 0.6087; -0.7600 -0.4472; -0.7288 -0.6090; 0.0532 0.0658; -0.0663 0.0059",
    "0.2500 -1.0200 -0.3371 -0.2733 0.2747 -0.4444; 0.0654 0.2095 0.0632 0.2089 -0.1895 0.1834",
    "-0.2181 -0.2070; 0.1094 0.1159",
)


def drawn(seed, states=3, sample_time=0.0):
    """A random regular plant with feedthrough everywhere, of two of each signal, and an unstable pole now and then."""
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(states, states))
    if sample_time:
        a *= rng.uniform(0.6, 1.2) / np.abs(np.linalg.eigvals(a)).max()
    d = 0.3 * rng.normal(size=(5, 5))
    d[1:3, 3:] += np.eye(2)
    d[3:, 1:3] += np.eye(2)
    model = StateModel(a, rng.normal(size=(states, 5)), rng.normal(size=(5, states)), d, sample_time)
    return GeneralisedPlant(model, exogenous=3, performance=3)


def test_discrete_h2_controller_of_slicot():
    """Printed to four decimals, in the plant's own states."""
    plant = GeneralisedPlant(StateModel(*matrices(SB10ED), 1.0), 3, 3)
    found = h2_riccati(plant)
    theirs = StateModel(*matrices(SB10ED_CONTROLLER), 1.0)
    point = np.linspace(0.0, 3.0, 7)
    assert found.controller.frequency_response(point) == pytest.approx(
        theirs.frequency_response(point), rel=2e-3, abs=2e-3
    )
    assert found.controller.d == pytest.approx(theirs.d, abs=6e-5)
    assert found.norm == pytest.approx(found.claimed, rel=1e-9)


def test_hinf_controller_of_slicot():
    """The central controller of a level is unique, its states up to a transformation."""
    a, b, c, _ = matrices(SB10HD)
    plant = GeneralisedPlant(StateModel(a, b, c, *matrices([SB10FD_D])), 3, 3)
    found = hinf_riccati(plant, level=15.0)
    theirs = StateModel(*matrices(SB10FD))
    for omega in (0.0, 0.3, 3.0, 30.0, 300.0):
        expected = responses(theirs, omega)
        assert responses(found.controller, omega) == pytest.approx(
            expected, rel=2e-3, abs=2e-3 * np.abs(expected).max()
        )
    assert found.norm < 15.0


def test_discrete_hinf_level_of_slicot():
    """Its example stands at the smallest level but for the last digit that is printed of it."""
    plant = GeneralisedPlant(StateModel(*matrices(SB10ED), 1.0), 3, 3)
    assert hinf_riccati(plant, SB10DD_LEVEL).norm <= SB10DD_LEVEL * (1 + 1e-6)
    assert hinf_riccati(plant, tolerance=1e-5).level == pytest.approx(SB10DD_LEVEL, rel=2e-5)
    with pytest.raises(InputError, match="level"):
        hinf_riccati(plant, 0.9999 * SB10DD_LEVEL)


def existence_level(plant):
    """Smallest level by the projected inequalities of Gahinet and Apkarian (1994), R and S for the two Riccati equations."""
    cvxpy = pytest.importorskip("cvxpy")
    a, b1, b2, c1, c2, d11, d12, d21, _ = plant.blocks
    n, w, z = len(a), b1.shape[1], len(c1)
    r, s = cvxpy.Variable((n, n), symmetric=True), cvxpy.Variable((n, n), symmetric=True)
    level = cvxpy.Variable()

    def null(rows):
        _, size, vectors = np.linalg.svd(rows)
        return vectors[np.sum(size > 1e-10) :].T

    def parts(x, a, b, c, d, inputs, outputs):
        if plant.model.sample_time:
            first = [a @ x @ a.T - x, a @ x @ c.T, b]
            second = [c @ x @ a.T, -level * np.eye(outputs) + c @ x @ c.T, d]
        else:
            first = [a @ x + x @ a.T, x @ c.T, b]
            second = [c @ x, -level * np.eye(outputs), d]
        return cvxpy.bmat([first, second, [b.T, d.T, -level * np.eye(inputs)]])

    def projected(matrix, basis, identity):
        whole = np.block(
            [
                [basis, np.zeros((len(basis), identity))],
                [np.zeros((identity, basis.shape[1])), np.eye(identity)],
            ]
        )
        return whole.T @ matrix @ whole

    upper = projected(parts(r, a, b1, c1, d11, w, z), null(np.hstack([b2.T, d12.T])), w)
    lower = projected(parts(s, a.T, c1.T, b1.T, d11.T, z, w), null(np.hstack([c2, d21])), z)
    joint = cvxpy.bmat([[r, np.eye(n)], [np.eye(n), s]])
    constraints = [upper + upper.T << 0, lower + lower.T << 0, joint + joint.T >> 0]
    problem = cvxpy.Problem(cvxpy.Minimize(level), constraints)
    return problem.solve(solver="CLARABEL")


@pytest.mark.slow
@pytest.mark.parametrize("sample_time", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(6))
def test_the_smallest_level_is_that_of_matrix_inequalities(seed, sample_time):
    plant = drawn(seed, sample_time=sample_time)
    found = hinf_riccati(plant)
    assert found.level == pytest.approx(existence_level(plant), rel=1e-3)
    loop = plant.close(found.controller)
    omega = np.linspace(0.0, np.pi / 0.1, 2000) if sample_time else np.geomspace(1e-3, 1e4, 2000)
    gains = np.linalg.norm(np.moveaxis(loop.frequency_response(omega), -1, 0), 2, axis=(1, 2))
    assert gains.max() <= found.level * (1 + 1e-6)
    assert found.norm == pytest.approx(gains.max(), rel=2e-2)


@pytest.mark.parametrize("sample_time", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(10, 14))
def test_no_controller_nearby_has_a_smaller_h2_norm(seed, sample_time):
    plant = drawn(seed, sample_time=sample_time)
    if not sample_time:  # without feedthrough from w to z
        d = plant.model.d.copy()
        d[:3, :3] = 0.0
        plant = GeneralisedPlant(StateModel(plant.model.a, plant.model.b, plant.model.c, d), 3, 3)
    found = h2_riccati(plant)
    assert found.norm == pytest.approx(found.claimed, rel=1e-7)
    rng, k = np.random.default_rng(seed), found.controller
    for _ in range(20):
        moved = [part * (1 + 1e-3 * rng.normal(size=part.shape)) for part in (k.a, k.b, k.c, k.d)]
        loop = plant.close(StateModel(*moved, sample_time))
        if loop.is_stable:
            assert h2_norm(loop) >= found.norm * (1 - 1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_discrete_norms_are_those_of_responses(seed):
    plant = drawn(seed, sample_time=0.1)
    loop = plant.close(h2_riccati(plant).controller)
    power, x = np.sum(loop.d**2), loop.b
    for _ in range(3000):
        power, x = power + np.sum((loop.c @ x) ** 2), loop.a @ x
    assert h2_norm(loop) == pytest.approx(np.sqrt(power), rel=1e-9)
    omega = np.linspace(0.0, np.pi / 0.1, 20001)
    gains = np.linalg.norm(np.moveaxis(loop.frequency_response(omega), -1, 0), 2, axis=(1, 2))
    peak = hinf_norm(loop)
    assert peak.magnitude == pytest.approx(gains.max(), rel=1e-6)
    at = np.linalg.norm(loop.frequency_response([peak.omega])[:, :, 0], 2)
    assert at == pytest.approx(peak.magnitude, rel=1e-8)


@pytest.mark.parametrize("unit", [1e-9, 1e-3, 1e9])
@pytest.mark.parametrize("sample_time", [0.0, 0.1])
def test_levels_follow_the_units(unit, sample_time):
    """Of performance, disturbance, control and measurement, each in units of its own."""
    plant = drawn(4, sample_time=sample_time)
    m = plant.model
    inputs, outputs = np.r_[np.ones(3), np.full(2, unit)], np.r_[np.full(3, unit), np.ones(2)]
    other = StateModel(
        m.a, m.b * inputs, m.c * outputs[:, None], m.d * inputs * outputs[:, None], sample_time
    )
    found = hinf_riccati(GeneralisedPlant(other, 3, 3))
    assert found.level / unit == pytest.approx(hinf_riccati(plant).level, rel=2e-4)


def test_what_has_no_controller_is_refused():
    plant = drawn(0)
    m = plant.model
    with pytest.raises(InputError, match="level"):
        hinf_riccati(plant, 1e-6)
    with pytest.raises(InputError, match="regular"):
        hinf_riccati(GeneralisedPlant(StateModel(m.a, m.b, m.c, np.zeros_like(m.d)), 3, 3))
    unseen = StateModel(np.diag([1.0, -1.0, -2.0]), m.b, np.hstack([np.zeros((5, 1)), m.c[:, 1:]]), m.d)
    with pytest.raises(InputError, match="no controller"):
        hinf_riccati(GeneralisedPlant(unseen, 3, 3))
    with pytest.raises(InputError, match="discrete"):
        h2_lmi(drawn(0, sample_time=0.1), 0.0, 0.0)


@pytest.mark.parametrize("factor", [1.001, 1.05, 3.0, 100.0, 1e6])
@pytest.mark.parametrize("sample_time", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(4))
def test_where_a_riccati_solution_is_zero_every_level_above_the_smallest_is_kept(seed, sample_time, factor):
    """Model matching: (3.6 s + 1.8) / (s + 1) less (2 - s) / (s + 4) times anything is 3 at s = 2, and need not be more.

    Controls and performances are as many, and so are noises and measurements; the solution left at zero has rounding
    of either sign.
    """
    rng = np.random.default_rng(seed)
    turn, (drive, sensor) = rng.normal(size=(3, 3)), 10 ** rng.uniform(-5, 5, 2)
    a, b = np.diag([-1.0, -4.0, -3.0]), [[1.0, 0.0], [0.0, 1.0], [1.0, 0.0]]
    c = [[-1.8, 6.0, 0.0], [0.0, 0.0, 2.0]]
    back, into, seen = np.linalg.inv(turn), np.diag([1.0, drive]), np.diag([1.0, sensor])
    d = seen @ [[3.6, -1.0], [1.0, 0.0]] @ into
    model = StateModel(turn @ a @ back, turn @ b @ into, seen @ c @ back, d)
    plant = GeneralisedPlant(tustin(model, sample_time) if sample_time else model, 1, 1)
    assert hinf_riccati(plant, level=3 * factor).norm <= 3 * factor * (1 + 1e-6)
    if factor == 3.0:
        assert hinf_riccati(plant).level == pytest.approx(3.0, rel=2e-4)
