"""The ledger: complete, accepted, explained, and what a fresh run finds again."""

import json
import re
from decimal import Decimal

import pytest

from stillwork.base import paths
from stillwork.workbook.claims import AGREEMENT, ledger
from stillwork.workbook.compare import same_value
from stillwork.workbook.publish import digest

from .test_figures import COMMITTED, REBUILT

ENTRIES = ledger()
IDS = [claim.entry.id for claim in ENTRIES]


def test_there_is_a_ledger():
    assert ENTRIES


@pytest.mark.parametrize("claim", ENTRIES, ids=IDS)
def test_every_entry_is_built_accepted_and_explained(claim):
    assert claim.verdict != "not built", "no notebook claims it"
    assert claim.entry.ours is not None, "run `make accept`"
    assert not claim.moved, f"accepted {claim.entry.ours}, the committed figures have {claim.ours}"
    assert claim.verdict in AGREEMENT or claim.entry.reason, "give the reason"


@pytest.mark.parametrize("claim", ENTRIES, ids=IDS)
def test_every_tolerance_says_in_words_where_it_comes_from(claim):
    tolerance = claim.entry.tolerance
    assert tolerance is None or any(map(str.isalpha, tolerance.source))


# The works are at hand as texts. What only a picture shows cannot be where a number comes from.
FROM_A_PICTURE = re.compile(
    r"\b(read|reading|seen|measured) (off|from|of|in|on) (a |the )?(fig|figure|plot|curve|axis|bode)|by eye|line'?s? width|\baxis\b",
    re.IGNORECASE,
)


@pytest.mark.parametrize("claim", ENTRIES, ids=IDS)
def test_no_tolerance_comes_from_a_picture(claim):
    entry = claim.entry
    for rule in filter(None, (entry.tolerance, entry.drift)):
        assert not FROM_A_PICTURE.search(rule.source)


@pytest.mark.parametrize(
    "source",
    [
        "reading of Fig. 7's logarithmic frequency axis",
        "read from Fig. 7",
        "a line's width in Fig. 7",
        "a comparison by eye",
        "seen in a Bode plot",
    ],
)
def test_such_a_source_is_recognised(source):
    assert FROM_A_PICTURE.search(source)


def is_half_a_digit(published: float, half: float) -> bool:
    """Whether a number can have been printed with a last digit of which `half` is the half."""
    unit = 2 * Decimal(str(half))
    return unit.normalize().as_tuple().digits == (1,) and Decimal(str(published)) % unit == 0


@pytest.mark.parametrize(
    ("published", "half", "whole"),
    [
        (9.6, 0.05, True),
        (37.0, 0.5, True),
        (40.0, 5.0, True),
        (0.04, 5e-5, True),
        (9.6, 0.5, False),
        (9.6, 0.04, False),
        (35.0, 5.0, False),
    ],
)
def test_half_a_digit_is_half_a_power_of_ten_that_the_number_is_a_multiple_of(published, half, whole):
    assert is_half_a_digit(published, half) == whole


@pytest.mark.parametrize("claim", ENTRIES, ids=IDS)
def test_half_the_last_printed_digit_is_that(claim):
    entry = claim.entry
    if entry.tolerance and entry.tolerance.source.startswith("half the last printed digit"):
        assert is_half_a_digit(entry.published, entry.tolerance.width(entry.published))


@pytest.mark.parametrize("claim", ENTRIES, ids=IDS)
def test_a_published_number_stands_for_no_word(claim):
    entry = claim.entry
    if entry.kind == "reported" and entry.published is not None:
        assert not re.search(r"stands? for|gives? no number|is no number|without a number", entry.reason)


@pytest.mark.parametrize("claim", ENTRIES, ids=IDS)
def test_what_was_chosen_after_a_look_is_no_prediction(claim):
    entry = claim.entry
    said = f"{entry.reason} {entry.tolerance.source if entry.tolerance else ''}"
    if entry.is_replication and re.search(
        r"chosen after|added after|after a first look|sized by|was sized", said, re.IGNORECASE
    ):
        assert entry.basis != "predicted"


def test_corrected_filters_are_counterfactuals():
    corrected = [claim.entry for claim in ENTRIES if claim.entry.id.endswith(".corrected")]
    assert all(entry.counterfactual for entry in corrected)


@pytest.mark.parametrize("claim", ledger(REBUILT), ids=IDS)
def test_a_fresh_run_finds_the_accepted_value_and_verdict(claim):
    committed = ENTRIES[IDS.index(claim.entry.id)]
    assert not claim.moved, f"accepted {claim.entry.ours}, now {claim.ours}"
    assert claim.verdict == committed.verdict
    assert claim.notebook == committed.notebook
    if claim.verdict != "not built":
        assert same_value(claim, committed)


@pytest.mark.parametrize("file", sorted(COMMITTED.glob("*/*/provenance.json")), ids=lambda f: f.parent.name)
def test_figures_come_from_a_commit_and_the_pinned_environment(file):
    record = json.loads(file.read_text(encoding="utf-8"))
    assert record["commit"], "built outside git"
    assert not record["dirty"], "commit the inputs, then build again"
    assert record["environment_sha256"] == digest((paths.root() / "environment.txt").read_bytes())
    assert record["drift"] == []
