"""Every notebook's explorer: names, starts and stops of its controls, and its named designs."""

import contextlib

import numpy as np
import pytest

from workbook.explorer import Slider, label
from workbook.notebooks import select
from workbook.site.explorers import read_explorer, statements
from workbook.site.states import MAIN
from workbook.site.stops import ladder, shares

pytestmark = pytest.mark.slow

# Pages that name no design but the one that their explorer starts from.
WITHOUT_PRESETS = {
    "budget/05-your-budget": "the reader's machine",
    "fixedpoint/09-your-plant": "the reader's plant",
    "isolation/06-efficient-update": "one size, the paper's",
    "isolation/08-your-floor": "the reader's floor",
    "motion/01-scan-performance": "one controller, of Example 1.5.1",
    "motion/02-model-reduction": "one reduction, of three modes",
    "motion/25-rig-over-geometries": "geometries are drawn, none has a name",
    "motion/29-your-machine": "the reader's machine",
    "worstcase/02-contraction": "one counter-example",
    "worstcase/07-your-record": "the reader's record",
}


@pytest.fixture(scope="module")
def explorers(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(None):
        patch.setenv("STILLWORK_OUTPUT", str(tmp_path_factory.mktemp("explorers")))
        return {each.name: read_explorer(each) for each in select() if statements(each.source)}


def sliders(explorer):
    return {name: each for name, each in explorer.controls.items() if isinstance(each, Slider)}


def test_no_two_controls_of_a_page_have_one_name_and_none_repeats_its_unit(explorers):
    for page, explorer in explorers.items():
        units = {name: getattr(each, "unit", "") for name, each in explorer.controls.items()}
        words = [label(name, unit).removesuffix(f" ({unit})") for name, unit in units.items()]
        assert len({"".join(each.split()) for each in words}) == len(words), page
        doubled = [
            each for each, unit in zip(words, units.values(), strict=True) if each.split()[-1] == unit.lower()
        ]
        assert doubled == [], page


def test_the_first_control_has_fifteen_stops(explorers):
    few = {}
    for page, explorer in explorers.items():
        name, first = next(iter(explorer.controls.items()))
        if isinstance(first, Slider) and len(shares(first)) < MAIN:
            few[page] = name
            assert first.whole and len(shares(first)) == first.high - first.low + 1, "every whole number"
    known = {"motion/02-model-reduction": "retained", "motion/03-position-dependence": "place"}
    assert few == {page: name for page, name in known.items() if page in explorers}


def test_every_slider_stands_on_a_stop_at_its_start(explorers):
    for page, explorer in explorers.items():
        for name, slider in sliders(explorer).items():
            widget = slider.widget(name)
            way = np.log10(slider.start) - widget.min if slider.log else slider.start - widget.min
            assert way / widget.step == pytest.approx(round(way / widget.step), abs=1e-6), f"{page}: {name}"


def test_every_named_design_has_its_stops_and_a_picture(explorers):
    assert {
        page for page, each in explorers.items() if not each.presets
    } == WITHOUT_PRESETS.keys() & explorers.keys()
    for page, explorer in explorers.items():
        for design, settings in explorer.presets.items():
            assert explorer.draw(**settings).axes, (
                f"{page}: {design}"
            )  # an impossible one raises an InputError
        for name, slider in sliders(explorer).items():
            also = {each[name] for each in explorer.presets.values()}
            assert also <= set(ladder(slider, lambda value: [], MAIN, also).values), f"{page}: {name}"
