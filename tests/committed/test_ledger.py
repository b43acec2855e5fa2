"""The ledger: complete, accepted, explained, and what a fresh run finds again."""

import json

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
