"""The ledger as text: what a terminal shows, and what is counted where."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillwork.base.checks import InputError
from stillwork.workbook.claims import Claim, Entry, Tolerance
from stillwork.workbook.report import column, columns, entry_text, find, ledger_text, paragraph, table

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


def test_a_table_that_fits_has_a_line_a_row():
    assert table([("claim", "ours"), ("motion.gain", "2")], 80) == [
        "claim        ours",
        "-----------------",
        "motion.gain  2",
    ]


def test_a_table_that_does_not_fit_puts_the_first_cell_above():
    lines = table([("claim", "place", "ours"), ("motion.a.long.name", "section 2 and section 3", "2")], 24)
    assert lines == [
        "claim",
        "  place             ours",
        "------------------------",
        "motion.a.long.name",
        "  section 2 and     2",
        "  section 3",
    ]


def test_reasons_are_wrapped_and_those_of_what_agrees_left_out():
    reason = "the rig is not described " * 5
    claims = [claim("motion.off", 3.0, reason=reason), claim("motion.on", reason="a remark")]
    lines = ledger_text(claims, 60).splitlines()
    assert max(map(len, lines)) <= 60
    assert "a remark" not in " ".join(lines)
    assert lines[-1] == "1 replicated, 1 deviates"
    assert paragraph(f"motion.off: {reason}", 60).splitlines()[1].startswith("  ")


def test_an_entry_is_shown_whole_and_without_what_is_empty():
    fields = {
        "id": "motion.gain",
        "unit": "",
        "own": False,
        "published": 2.0,
        "interval": [1.0, 3.0],
        "readings": {"share": 1 / 3, "decided_by": [{"axis": "a", "total": 0.25, "unit": ""}], "failed": 0},
    }
    assert entry_text(fields, 40).splitlines() == [
        "id: motion.gain",
        "published: 2",
        "interval: 1 .. 3",
        "readings:",
        "  share: 0.33333",
        "  decided_by:",
        "    axis a; total 0.25",
        "  failed: 0",
    ]


def test_an_unknown_entry_names_the_nearest():
    with pytest.raises(InputError, match=r"no entry 'motion.gian'; did you mean 'motion.gain'\?"):
        find([claim()], "motion.gian")


def test_checks_and_counterfactuals_are_counted_apart():
    claims = [
        claim("motion.a"),
        claim("motion.b", 3.0),
        claim("motion.c", counterfactual=True),
        claim("motion.d", 0.0, kind="check", published=None),
        claim("motion.e", 3.0, better="larger"),
    ]
    found = [column(each) for each in claims]
    assert found == ["replicated", "deviates", "counterfactual", "own checks", "better"]
    assert columns(claims[:2]) == ["replicated", "deviates", "reported"]
    assert columns(claims) == ["replicated", "better", "deviates", "reported", "own checks", "counterfactual"]
