"""The ledger: complete, accepted, explained, and what a fresh run finds again."""

import json
import re
from decimal import Decimal

import pytest

from workbook import paths
from workbook.claims import AGREEMENT, Claim, ledger
from workbook.compare import same_value
from workbook.publish import digest

from .test_figures import COMMITTED, REBUILT

ENTRIES = ledger()
LEDGER = [claim.entry for claim in ENTRIES]


def test_there_is_a_ledger():
    assert ENTRIES


def lacking(claim: Claim) -> str:
    if claim.verdict == "not built":
        return "run `make accept`" if claim.notebook else "no notebook claims it"
    return "" if claim.here in AGREEMENT or claim.entry.reason else "give the reason"


def test_every_entry_is_accepted_and_explained():
    assert {claim.entry.id: what for claim in ENTRIES if (what := lacking(claim))} == {}


def test_a_name_in_a_table_has_fifteen_words_at_most():
    assert [each.id for each in LEDGER if len(each.quantity.split()) > 15] == []


def test_every_tolerance_says_in_words_where_it_comes_from():
    sources = {each.id: each.tolerance.source for each in LEDGER if each.tolerance}
    assert [name for name, source in sources.items() if not any(map(str.isalpha, source))] == []


# The works are at hand as texts. What only a picture shows cannot be where a number comes from.
FROM_A_PICTURE = re.compile(
    r"\b(read|reading|seen|measured) (off|from|of|in|on) (a |the )?(fig|figure|plot|curve|axis|bode)|by eye|line'?s? width|\baxis\b",
    re.IGNORECASE,
)


def test_no_tolerance_comes_from_a_picture():
    rules = [(each.id, rule) for each in LEDGER for rule in (each.tolerance, each.drift) if rule]
    assert [name for name, rule in rules if FROM_A_PICTURE.search(rule.source)] == []


def is_half_a_digit(published: float, half: float) -> bool:
    """Whether a number can have been printed with a last digit of which `half` is the half."""
    unit = 2 * Decimal(str(half))
    return unit.normalize().as_tuple().digits == (1,) and Decimal(str(published)) % unit == 0


def test_half_the_last_printed_digit_is_that():
    stated = "half the last printed digit"
    printed = [each for each in LEDGER if each.tolerance and each.tolerance.source.startswith(stated)]
    wrong = [
        each.id
        for each in printed
        if not is_half_a_digit(each.published, each.tolerance.width(each.published))
    ]
    assert wrong == []


NO_NUMBER = re.compile(r"stands? for|gives? no number|is no number|without a number")


def test_a_published_number_stands_for_no_word():
    reported = [each for each in LEDGER if each.kind == "reported" and each.published is not None]
    assert [each.id for each in reported if NO_NUMBER.search(each.reason)] == []


AFTER_A_LOOK = re.compile(r"chosen after|added after|after a first look|sized by|was sized", re.IGNORECASE)


def test_what_was_chosen_after_a_look_is_no_prediction():
    predicted = [each for each in LEDGER if each.is_replication and each.basis == "predicted"]
    said = {each.id: f"{each.reason} {each.tolerance.source if each.tolerance else ''}" for each in predicted}
    assert [name for name, text in said.items() if AFTER_A_LOOK.search(text)] == []


def test_corrected_filters_are_counterfactuals():
    corrected = [each for each in LEDGER if each.id.endswith(".corrected")]
    assert all(entry.counterfactual for entry in corrected)


def found_otherwise(now: Claim, committed: Claim) -> str:
    if (now.here, now.notebook) != (committed.here, committed.notebook):
        return f"was {committed.here} by {committed.notebook}, now {now.here} by {now.notebook}"
    if now.here != "not built" and not same_value(now, committed):
        return f"was {committed.ours}, now {now.ours}"
    return ""


def test_a_fresh_run_finds_the_accepted_value_and_verdict():
    committed = {claim.entry.id: claim for claim in ENTRIES}
    found = {now.entry.id: found_otherwise(now, committed[now.entry.id]) for now in ledger(REBUILT)}
    assert {name: what for name, what in found.items() if what} == {}


@pytest.mark.parametrize("file", sorted(COMMITTED.glob("*/*/provenance.json")), ids=lambda f: f.parent.name)
def test_figures_come_from_a_commit_and_the_pinned_environment(file):
    record = json.loads(file.read_text(encoding="utf-8"))
    assert record["commit"], "built outside git"
    assert not record["dirty"], "commit the inputs, then run `make accept`"
    assert record["environment_sha256"] == digest((paths.root() / "environment.txt").read_bytes())
    assert record["drift"] == []
