"""The explorer of the budget's pages."""

import pytest

from experiments.budget import waterfall

pytestmark = pytest.mark.slow


def test_a_preset_of_the_budget_shows_the_page_s_own_bar():
    for floor, name in (
        ("slab under footfall", "slab, all methods"),
        ("LIGO ground", "LIGO ground, all methods"),
    ):
        controls = waterfall.controls()
        settings = {key: each.start for key, each in controls.items()} | waterfall.presets()[name]
        axes = waterfall.explore_waterfall(**settings).axes[0]
        own = waterfall.waterfall(floor)["all"].rms[0]
        assert axes.patches[-1].get_height() == pytest.approx(1e9 * own, rel=1e-9)
