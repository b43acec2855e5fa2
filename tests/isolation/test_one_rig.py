"""One rig for the whole paper: its building against the shipped rig, its inference against closed forms."""

import numpy as np
import pytest

from experiments.isolation import load_twin, one_rig, steady_state
from experiments.isolation.floors import flat_floor
from notebooks.isolation import power as search

SEARCHED = [name for name in search.published() if name not in search.EDGES]


@pytest.fixture(scope="module")
def shipped():
    """Parameters of the shipped rigid body: equal struts, nothing across them."""
    given = one_rig.parameters(np.zeros(len(one_rig.ranges())))
    given |= {name: 65.0 for name in given if name.startswith("damping")}
    given |= {name: 1.0 for name in given if name.startswith("stiffness")}
    given |= {name: 0.0648 for name in given if name.startswith("sensor_radius")}
    given |= {name: 0.0 for name in given if name.startswith("sensor_angle")}
    given |= {name: 1.5e-3 for name in given if name.startswith("floor_level")}
    return given | {
        "tilt": 31.08,
        "rotation": 40.0,
        "flatness": 0.0151886 / 2 / 0.0209023,
        "pair": 15.0,
        "radius": 0.1,
        "lateral_stiffness": 1e-12,
        "lateral_damping": 0.0,
        "azimuth": -70.5,
        "beta": 200.0,
        "actuator_pole": 300.0,
        "output_noise": 1.8e-4,
        "floor_upper_end": 80.0,
        "initial_covariance": 1.0,
    }


@pytest.mark.slow
def test_the_shipped_rigid_body_is_one_of_these_rigs(shipped):
    rigid = load_twin("rigid_body")
    twin, _ = one_rig.build(shipped)
    for name in ("mass_matrix", "stiffness_matrix", "damping_matrix"):
        ours, theirs = getattr(twin.rig, name), getattr(rigid.rig, name)
        assert ours == pytest.approx(theirs, rel=1e-4, abs=1e-4 * np.abs(theirs).max()), name
    found, wanted = one_rig.numbers(shipped), steady_state(rigid, flat_floor()).weights[0]
    for k in range(9):  # the coarse grid and the printed digits of the azimuth
        assert found[f"table-1.ferls.final-w{k + 1}"] == pytest.approx(wanted[k], abs=2e-3)


def test_unequal_struts_alone_leave_the_weights_in_proportion(shipped):
    rng = np.random.default_rng(5)
    for name in shipped:
        if name.startswith(("stiffness", "damping")):
            shipped[name] *= rng.uniform(0.6, 1.0)
    found = one_rig.numbers(shipped)
    parts = [found[f"table-1.ferls.final-w{k}"] / found[f"table-1.ferls.final-w{k + 3}"] for k in (4, 5, 6)]
    assert max(parts) / min(parts) < 1.02  # printed: 2.2


def test_parameters_fill_their_ranges():
    middle, ends = one_rig.parameters(np.zeros(34)), one_rig.parameters(np.full(34, 9.0))
    assert middle["tilt"] == 45.5 and middle["beta"] == pytest.approx(np.sqrt(100 * 300))
    assert ends["azimuth"] == pytest.approx(180) and ends["floor_level2"] == pytest.approx(4.5e-3)


def test_an_exponential_settles_when_it_should():
    time = np.geomspace(0.1, 50, 400)
    off = np.exp(-np.outer(time, [1 / 3, 1 / 8, 0.0]))
    settled = one_rig.times_to_settle(time, off)
    assert settled[:2] == pytest.approx(np.array([3, 8]) * np.log(1 / 0.63), rel=1e-3)
    assert settled[2] == 50


def test_laplace_is_the_posterior_of_a_linear_model():
    rng = np.random.default_rng(2)
    matrix, deviation = rng.standard_normal((5, 3)), np.array([0.1, 0.2, 0.3, 1.0])
    seen = np.array([0, 1, 2, 4])
    middle, covariance, cost = search.laplace(
        lambda z: matrix @ z, np.ones(3), seen.tolist(), np.zeros(4), deviation
    )
    part = matrix[seen] / deviation[:, None]
    assert middle == pytest.approx(np.zeros(3), abs=1e-3) and cost == pytest.approx(0, abs=1e-5)
    assert covariance == pytest.approx(np.linalg.inv(np.eye(3) + part.T @ part), rel=1e-2, abs=1e-4)


def test_a_number_out_of_reach_does_not_pull_the_rest():
    # Two numbers of one parameter disagree: the far one counts by its distance, not by the square of it.
    middle, _, _ = search.laplace(
        lambda z: np.array([z[0], z[0]]), np.zeros(1), [0, 1], np.array([0.0, 3.0]), np.full(2, 0.1)
    )
    assert search.robust_loss(np.array([30.0])) ** 2 == pytest.approx(2 * (np.sqrt(901) - 1))
    assert 0 < middle[0] < 1.5  # the mean would be just below 1.5; the prior decides between two equal pulls


def test_every_number_is_held_out_once_and_leaves_its_scatter_alone():
    for fold in range(search.FOLDS):
        out = [name for name in SEARCHED if search.fold_of(name) == fold]
        columns = {int(name[-1]) for name in out if name.startswith("table-1")}
        assert {(k - 1) // 3 for k in columns} == {(k - 1) % 3 for k in columns} == {0, 1, 2}
        assert sum(name.startswith("fig-8") for name in out) == 1
    assert [name for name in SEARCHED if search.fold_of(name) is None] == ["setup.equivalent-mass"]
    apart = search.published()["table-1.ferls.final-w9"] - search.published()["table-1.felms.final-w9"]
    seen = ["table-1.ferls.final-w9"]
    assert search.scatter(seen)("table-1.ferls.final-w1") == pytest.approx(abs(apart) / np.sqrt(2))


def test_bands_are_those_of_a_normal_distribution():
    low, high = search.band("table-1.ferls.final-w1", np.full(200, 0.5), 0.1)
    assert (low, high) == pytest.approx((0.5 - 0.196, 0.5 + 0.196), abs=0.01)
    low, high = search.band("fig-8.removed.z", np.full(200, np.log(6.0)), 0.1)
    assert (low, high) == pytest.approx((100 - 6 * np.exp(0.196), 100 - 6 * np.exp(-0.196)), abs=0.1)


@pytest.mark.slow
def test_what_is_stored_was_found_by_this_code():
    best, found = search.stored()
    assert list(best) == list(one_rig.ranges()) and set(found) == set(search.published())
    for name, value in one_rig.numbers(best).items():
        if name in SEARCHED:
            low, high = found[name]["seen"]
            assert low < value < high, name
    drawn = search.sample_prior(SEARCHED, 20)[1]  # the first of those that the search began with
    for name, values in zip(SEARCHED, drawn.T, strict=True):
        low, high = sorted(search.from_log(name, np.array([values.min(), values.max()])))
        wide = 1e-3 * abs(high - low)
        assert found[name]["drawn"][0] - wide <= low and high <= found[name]["drawn"][1] + wide, name
