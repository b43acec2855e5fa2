"""Every judged entry is tried over the open choices of its paper, or the ledger gives the reason why none is open."""

import pytest

from workbook import paths
from workbook.choices.axes import load_axes
from workbook.claims import load_entries


def uncovered(topic: str) -> set[str]:
    tried = {entry for study in load_axes(topic)[1] for entry in study.entries}
    judged = [each for each in load_entries(topic).values() if each.kind not in ("reported", "check")]
    return {each.id for each in judged if not each.open and each.id not in tried}


@pytest.mark.parametrize("topic", paths.topics())
def test_every_judged_entry_has_a_study_or_says_that_nothing_is_open(topic):
    assert uncovered(topic) == set(), "give it a study in choices.toml, or open = 'none: ...' in the ledger"


@pytest.mark.parametrize("topic", paths.topics())
def test_none_says_that_nothing_is_open_and_is_tried_all_the_same(topic):
    tried = {entry for study in load_axes(topic)[1] for entry in study.entries}
    assert [name for name, each in load_entries(topic).items() if each.open and name in tried] == []
