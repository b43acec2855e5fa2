"""The ledger as text: what a terminal shows, and what is counted where."""

from collections import Counter

import numpy as np
import pytest

from workbook.checks import InputError
from workbook.claims import Claim, Entry, Tolerance
from workbook.report import (
    column,
    entry_text,
    find,
    ledger_text,
    our_quantity,
    summary,
    tally,
)


def claim(name="motion.gain", ours=2.0, kind="value", **fields):
    tolerance = Tolerance("printed digits", relative=0.01) if kind in ("value", "check") else None
    fields = {"published": 2.0, "unit": "Hz", "tolerance": tolerance, **fields}
    return Claim(Entry(name, "Table 1", "gain", kind=kind, **fields), ours)


@pytest.mark.parametrize(
    ("ours", "text", "cases"),
    [
        (1.0, "1", "always"),
        (0.99982199, "0.9998", "in 99.98 % of cases"),
        (0.9999999, "0.9999999", "in 99.99999 % of cases"),
        (0.96, "0.96", "in 96 % of cases"),
        (0.0, "0", "never"),
    ],
)
def test_nearly_all_runs_are_not_shown_as_all(ours, text, cases):
    found = claim(ours=ours, kind="ordering", published=1.0)
    assert (found.shown(3), our_quantity(found)) == (text, cases)


# One claim for each way to be counted: what it is counted as, its value, its entry.
COUNTED = [
    ("replicated, predicted", 2.0, {}),
    ("replicated, fitted or calibrated", 2.0, {"basis": "fitted"}),
    ("replicated, fitted or calibrated", 2.0, {"basis": "calibrated"}),
    ("replicated, predicted", 3.0, {"better": "larger"}),
    ("not replicated", 3.0, {}),
    ("not replicated", 3.0, {"basis": "calibrated"}),
    ("not judged", 3.0, {"kind": "reported", "reason": "rig not described"}),
    ("no number published", 3.0, {"kind": "reported", "reason": "words alone", "published": None}),
    ("checks passed", 0.0, {"kind": "check", "published": None}),
    ("checks failed", 3.0, {"kind": "check"}),
    ("counterfactual", 2.0, {"counterfactual": True}),
    ("not built", None, {}),
]


def each_way() -> list[Claim]:
    return [claim(f"motion.{n}", ours, **fields) for n, (_, ours, fields) in enumerate(COUNTED)]


def test_every_claim_is_counted_under_one_name():
    claims = each_way()
    assert [column(each) for each in claims] == [name for name, *_ in COUNTED]
    assert tally(claims[3:6]) == "1 replicated, predicted; 2 not replicated"
    assert tally([]) == ""


def test_the_summary_counts_only_the_work_s_numbers_as_such():
    numbers, others = (part.splitlines() for part in summary(each_way()).split("\n\n"))
    found = []
    for head, _, row in (numbers, others):
        counts = dict(zip(head.split("|")[2:-1], row.split("|")[2:-1], strict=True))
        found.append({name.strip(): int(count) for name, count in counts.items()})
    of = Counter(name for name, *_ in COUNTED)
    assert found[0] == {"numbers": 7, **{name: of[name] for name in list(of)[:4]}}
    assert found[1] == {"others": 5, **{name: of[name] for name in list(of)[4:]}}


def test_a_verdict_is_shown_with_what_keeps_it_from_being_evidence():
    judged = [claim(), claim(basis="fitted"), claim(ours=3.0, basis="calibrated", counterfactual=True)]
    assert [each.judgement for each in judged] == [
        "replicated (inside, predicted)",
        "replicated (inside, fitted)",
        "not replicated (outside, calibrated, counterfactual)",
    ]
    assert "replicated (inside, fitted)" in ledger_text(judged, 200)


@pytest.mark.parametrize(
    ("guess", "meant"),
    [
        ("table-1.gain", "; did you mean 'motion.bandwidth.gain'?"),  # by its table
        ("motion.bandwidth.gian", "; did you mean 'motion.bandwidth.gain'?"),  # spelt alike
        ("table-2.gain", ""),  # no such table
        ("table-1", "; did you mean 'motion.bandwidth.gain' or 'motion.bandwidth.loss'?"),
    ],
)
def test_what_a_guessed_name_may_mean_is_named(guess, meant):
    entries = [
        Entry(f"motion.bandwidth.{name}", "Table 1", name, "1", "reported", reason="x")
        for name in ("gain", "loss")
    ]
    with pytest.raises(InputError) as told:
        find([Claim(each) for each in entries], guess)
    assert str(told.value) == f"the ledger has no entry {guess!r}{meant}"


def test_an_entry_is_told_with_numbers_of_numpy_and_without_empty_fields():
    fields = {"share": np.float64(0.25), "range": [np.float64(0.0), 1.0], "basis": "", "axes": [], "count": 0}
    assert entry_text(fields, 80).splitlines() == ["share: 0.25", "range: [0.0, 1.0]", "count: 0"]
