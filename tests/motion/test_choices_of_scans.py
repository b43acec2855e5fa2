"""Chapters 4 to 6 at other options."""

import numpy as np
import pytest

from experiments.motion.intervals import key
from experiments.motion.machines import chain_matrix, published_setpoint
from experiments.motion.position_dependence import at_place
from notebooks.motion.twenty_nine_scans import (
    CASES,
    LocationStudy,
    locations,
    structure,
    table_agreement,
    table_statements,
)


def test_the_eighth_place_is_the_mass_that_the_force_acts_on():
    plant, grid = structure(8)
    mass, stiffness = np.diag([2.5, *[10 / 7] * 7]), chain_matrix([1e8, *[9.6e7] * 6])
    for omega in (300.0, 20000.0):  # where damping hardly matters
        direct = np.linalg.inv(stiffness - omega**2 * mass)[:, 0]
        found = [
            at_place(plant, grid, place).frequency_response(np.array([omega]))[0, 0, 0] for place in grid
        ]
        np.testing.assert_allclose(np.real(found), direct, rtol=0, atol=5e-4 * np.abs(direct).max())
    assert len(structure(7)[1]) == 7


def _study(scale: dict[str, float]) -> LocationStudy:
    setpoint = published_setpoint(2e-4)
    shape = 1e-8 * np.linspace(1, 2, 4)[:, None] * np.ones_like(setpoint.time)
    return LocationStudy(np.arange(4.0), setpoint, {case: scale.get(case, 1.0) * shape for case in CASES})


def test_statements_of_a_table_that_obeys_and_of_one_that_does_not():
    obeying = {"original": 3.0, "MC": 4.0, "AD": 1.0, "MC and AD": 0.9}
    obeying |= {"MC, redesigned": 3.5, "AD, redesigned": 0.5, "MC and AD, redesigned": 0.4}
    assert all(table_statements(_study(obeying)).values())
    for case, value, broken in (
        ("AD", 3.1, {"damping-mean", "damping-variance"}),
        ("MC", 2.9, {"compensation", "redesign", "transient"}),
        ("MC and AD", 1.1, {"both-best"}),
        ("AD, redesigned", 4.0, {"redesign", "settling"}),
    ):
        said = table_statements(_study(obeying | {case: value}))
        assert {claim for claim, holds in said.items() if not holds} == broken


def test_distance_from_a_published_table_by_hand():
    found = table_agreement(_study({"AD": 0.5}), {"original": (10.0, 15.0, 25.0), "AD": (5.0, 5.0, 20.0)})
    np.testing.assert_allclose(found, [[0, 0, 0.2], [0, 0.5, 0.5]], atol=1e-12)


@pytest.mark.slow
def test_readings_change_what_they_say_they_change():
    usual = {
        "error_channel": "seen by the observer",
        "location_noise": False,
        "location_masses": 7,
        "gains_from": "quiet move",
        "gains_in": "37 Hz",
        "location_sample_time": 2e-4,
        "seed": 1,
        "lean": True,
    }
    seen, unseen = (
        locations(**usual | {"error_channel": each}) for each in ("seen by the observer", "unseen")
    )
    bare = [f"motion.table-4-1.original.{part}" for part in ("min", "mean", "max")]
    assert all(seen[entry] == unseen[entry] for entry in bare)
    assert unseen["motion.table-4-1.ad.mean"][0] > 1.5 * seen["motion.table-4-1.ad.mean"][0]
    loud = locations(**usual | {"location_noise": True})
    assert all(
        loud[f"motion.table-4-1.{key(case)}.mean"][0] > seen[f"motion.table-4-1.{key(case)}.mean"][0]
        for case in CASES
    )
    eight = locations(**usual | {"location_masses": 8})
    assert eight[bare[2]][0] > 1.4 * seen[bare[2]][0]
