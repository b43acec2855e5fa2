"""Sections 2, 5.1.2 and 5.2 at other open choices: the varied rig, and the studies against what was accepted."""

import numpy as np
import pytest

from choices.defaults import require_accepted
from experiments.isolation.floors import flat_floor
from experiments.isolation.performance import central_axes, expected_density
from experiments.isolation.responses import responses
from experiments.isolation.twin import equal_struts
from notebooks.isolation.power import correlated


def test_the_geometry_puts_the_modes_where_its_sources_say():
    # Closed forms: x and y with 3 k sin², z with 6 k cos² of the tilt, over the mass.
    twin = equal_struts(strut_damping=65.0, actuator_pole=300.0, strut_tilt=38.0, rotations=45.0)
    tilt = np.radians(38.0)
    sideways, vertical = np.sqrt([3 * 60e3 * np.sin(tilt) ** 2 / 5.4, 6 * 60e3 * np.cos(tilt) ** 2 / 5.4])
    expected = [sideways, sideways, vertical, *[2 * np.pi * 45] * 3]
    np.testing.assert_allclose(2 * np.pi * twin.rig.frequencies_hz, expected, rtol=1e-3)


def test_correlated_sensors_move_the_platform_as_their_cross_spectra_say():
    twin, floor = equal_struts(strut_damping=65.0, actuator_pole=300.0), flat_floor()
    f = np.array([5.0, 20.0, 35.0, 80.0])
    mixed = correlated(twin, 0.5)
    found = expected_density(mixed, floor, f)["floor"]
    cross = 0.5 * np.eye(3) + 0.5  # of the three sensors, over the power of one
    platform = central_axes(twin.rig).platform
    for k, path in enumerate(responses(twin, f).primary):
        gain = platform @ path
        expected = np.diag(gain @ cross @ gain.conj().T).real * floor.density(f)[0, k]
        np.testing.assert_allclose(found[:, k], expected, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("study", ["suspension", "edges", "power"])
def test_a_study_gives_at_its_defaults_what_the_notebook_gave(study):
    require_accepted("isolation", study)
