"""The published settings, typed again from the paper."""

import numpy as np
import pytest

from experiments.fixedpoint import published_controllers
from experiments.fixedpoint.published import KALMAN, LITERAL, LOW_PASS, WINDOW
from stillwork.control import FlowTransformation
from stillwork.control.transformation import RobustTransformation
from workbook.claims import ledger


def test_settings_of_section_ii(approximate):
    published = published_controllers(approximate)
    assert {name: c.kinematics.exponent for name, c in published.items()} == {
        WINDOW: 24.0,
        LOW_PASS: 16.0,
        KALMAN: 36.0,
        LITERAL: 36.0,
    }
    assert published[WINDOW].transformation == FlowTransformation(gain=-1.1, width=3.0)
    assert published[WINDOW].signal_filter.length == 12
    assert published[LOW_PASS].signal_filter.bandwidth == 350.0
    for name in (LOW_PASS, KALMAN, LITERAL):
        assert published[name].transformation == RobustTransformation(4e7, -1.05, 9e-2 / 4e7)
    assert all(c.kinematics.integrals == 1 for c in published.values())


@pytest.mark.parametrize("name", [KALMAN, LITERAL])
def test_settings_of_table_ii(name, approximate):
    kalman = published_controllers(approximate)[name].signal_filter
    assert (kalman.process == np.diag([1e-1, 1e-3])).all()
    assert (kalman.noise == np.diag([1e-2, 1e-3])).all()
    assert (kalman.points.alpha, kalman.points.beta, kalman.points.kappa) == (1e-2, 1e-3, 0.0)
    assert kalman.literal == (name == LITERAL)


def test_three_rankings_of_the_corrected_filter_are_kept():
    ids = {claim.entry.id for claim in ledger()}
    rankings = ("fig-5.window-most-precise", "fig-11.low-pass-best", "section-4.kalman-worst")
    assert {each for each in ids if each.endswith(".corrected") and each.startswith("fixedpoint.")} == {
        f"fixedpoint.{name}.corrected" for name in rankings
    }
