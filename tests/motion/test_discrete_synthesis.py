"""H2 synthesis and norms in discrete time, against a published case, other controllers and responses."""

import numpy as np
import pytest

from stillwork.estimation import h2_riccati
from stillwork.lti import GeneralisedPlant, StateModel, h2_norm
from tests.motion.test_published_synthesis import matrices

# SLICOT library, example data and results of SB10ED: A, B, C and D.
SB10ED = (
    """-0.7 0 0.3 0 -0.5 -0.1; -0.6 0.2 -0.4 -0.3 0 0; -0.5 0.7 -0.1 0 0 -0.8; -0.7 0 0 -0.5 -1 0;
    0 0.3 0.6 -0.9 0.1 -0.4; 0.5 -0.8 0 0 0.2 -0.9""",
    "-1 -2 -2 1 0; 1 0 1 -2 1; -3 -4 0 2 -2; 1 -2 1 0 -1; 0 1 -2 0 3; 1 0 3 -1 -2",
    "1 -1 2 -2 0 -3; -3 0 1 -1 1 0; 0 2 0 -4 0 -2; 1 -3 0 0 3 1; 0 1 -2 1 0 -2",
    "1 -1 -2 0 0; 0 1 0 1 0; 2 -1 -3 0 1; 0 1 0 1 -1; 0 0 1 2 1",
)
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
