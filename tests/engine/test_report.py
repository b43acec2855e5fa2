"""The ledger as text: what a terminal shows, and what is counted where."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from workbook.checks import InputError
from workbook.claims import Claim, Entry, Tolerance
from workbook.report import (
    column,
    columns,
    entry_text,
    find,
    ledger_text,
    our_quantity,
    paragraph,
    summary,
    table,
    tally,
)

words = st.text("ab.-c ", min_size=1, max_size=30).map(str.strip)


def claim(name="motion.gain", ours=2.0, kind="value", **fields):
    tolerance = Tolerance("printed digits", relative=0.01) if kind in ("value", "check") else None
    fields = {"published": 2.0, "unit": "Hz", "tolerance": tolerance, **fields}
    return Claim(Entry(name, "Table 1", "gain", kind=kind, **fields), ours)


@given(st.lists(st.tuples(words, words, words), min_size=1, max_size=6), st.integers(30, 100))
def test_a_table_fits_and_keeps_every_letter(rows, width):
    head = ("claim", "place", "verdict")
    lines = table([head, *rows], width)
    assert max(map(len, lines)) <= width
    letters = sorted("".join("".join(row) for row in [head, *rows]).replace(" ", ""))
    assert sorted("".join(line for line in lines if set(line) != {"-"}).replace(" ", "")) == letters or any(
        set(cell) == {"-"} for row in rows for cell in row
    )


def test_reasons_are_wrapped_and_those_of_what_agrees_left_out():
    reason = "the rig is not described " * 5
    claims = [claim("motion.off", 3.0, reason=reason), claim("motion.on", reason="a remark")]
    lines = ledger_text(claims, 60).splitlines()
    assert max(map(len, lines)) <= 60
    assert "a remark" not in " ".join(lines)
    assert lines[-1] == "1 replicated, predicted; 1 deviates"
    assert paragraph(f"motion.off: {reason}", 60).splitlines()[1].startswith("  ")


def test_an_entry_is_shown_whole_and_without_what_is_empty():
    fields = {
        "id": "motion.gain",
        "unit": "",
        "own": False,
        "published": 2.0,
        "interval": [1.0, 3.0],
        "choices": {"share": 1 / 3, "decided_by": [{"axis": "a", "total": 0.25, "unit": ""}], "failed": 0},
        "joint": {"combination": {"noise": False, "law": "ends"}, "agrees": False},
    }
    assert entry_text(fields, 40).splitlines() == [
        "id: motion.gain",
        "published: 2",
        "interval: 1 .. 3",
        "choices:",
        "  share: 0.33333",
        "  decided_by:",
        "    axis a; total 0.25",
        "  failed: 0",
        "joint:",
        "  combination:",
        "    noise: False",
        "    law: ends",
        "  agrees: False",
    ]


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


def test_an_unknown_entry_names_the_nearest():
    with pytest.raises(InputError, match=r"'motion\.gian'.*'motion\.gain'"):
        find([claim()], "motion.gian")


# One claim for each way to be counted: what it is counted as, its value, its entry.
COUNTED = [
    ("replicated, predicted", 2.0, {}),
    ("replicated, fitted", 2.0, {"basis": "fitted"}),
    ("replicated, calibrated", 2.0, {"basis": "calibrated"}),
    ("better, predicted", 3.0, {"better": "larger"}),
    ("deviates", 3.0, {}),
    ("deviates", 3.0, {"basis": "calibrated"}),
    ("reported", 3.0, {"kind": "reported", "reason": "rig not described"}),
    ("no number published", 3.0, {"kind": "reported", "reason": "words alone", "published": None}),
    ("checks passed", 0.0, {"kind": "check", "published": None}),
    ("checks failed", 3.0, {"kind": "check"}),
    ("counterfactual", 2.0, {"counterfactual": True}),
    ("not built", None, {}),
]
NAMES = list(dict.fromkeys(name for name, *_ in COUNTED))


def each_way() -> list[Claim]:
    return [claim(f"motion.{n}", ours, **fields) for n, (_, ours, fields) in enumerate(COUNTED)]


def test_every_claim_is_counted_under_one_name():
    claims = each_way()
    assert [column(each) for each in claims] == [name for name, *_ in COUNTED]
    assert columns(claims) == NAMES
    assert columns(claims[:1]) == [*NAMES[:3], "deviates", "reported"]
    assert tally(claims[3:6]) == "1 better, predicted; 2 deviates"
    assert tally([]) == ""


def test_the_summary_counts_only_the_work_s_numbers_as_such(monkeypatch):
    monkeypatch.setattr("workbook.report.ledger", each_way)
    head, _, row = summary().splitlines()
    counts = dict(zip(head.split("|")[2:-1], row.split("|")[2:-1], strict=True))
    found = {name.strip(): int(count) for name, count in counts.items()}
    assert found == {"numbers": 8, **dict.fromkeys(NAMES, 1), "deviates": 2}


def test_a_verdict_is_shown_with_what_keeps_it_from_being_evidence():
    judged = [claim(), claim(basis="fitted"), claim(ours=3.0, basis="calibrated", counterfactual=True)]
    assert [each.judgement for each in judged] == [
        "replicated",
        "replicated (fitted)",
        "deviates (calibrated, counterfactual)",
    ]
    assert "replicated (fitted)" in ledger_text(judged, 200)
