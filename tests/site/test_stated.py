"""What the papers conclude, a line each: the verdict of a line, and a row of the page."""

from dataclasses import dataclass

import pytest

from workbook.checks import InputError
from workbook.claims import Claim, load_entries
from workbook.site.stated import page_of, stated, verdict_of


@dataclass(frozen=True)
class Judged(Claim):
    """A claim with a verdict of its own."""

    verdict: str = ""


def claim(verdict, kind="ordering"):
    return Judged(
        next(each for each in load_entries("motion").values() if each.kind == kind), verdict=verdict
    )


@pytest.mark.parametrize(
    ("claims", "word"),
    [
        ([claim("replicated"), claim("mostly replicated")], "mostly replicated"),
        ([claim("replicated", "exact"), claim("not replicated", "value")], "replicated"),
        ([claim("rarely replicated", "value"), claim("replicated", "value")], "rarely replicated"),
        ([claim("not judged", "reported"), claim("not built")], "not judged"),
        ([claim("not judged", "reported"), claim("replicated", "value")], "replicated"),
    ],
)
def test_a_line_has_the_weakest_verdict_of_its_statements_else_of_its_numbers(claims, word):
    assert verdict_of(claims) == word


def test_a_conclusion_names_entries_of_the_ledger():
    ledger = load_entries("motion")
    assert len(stated("motion", ledger)) == 34
    with pytest.raises(InputError, match=r"conclusions\.toml: 2\.1"):
        stated("motion", set(ledger) - {"motion.fig-2-3.converges"})
    assert stated("budget", ledger) == []
    assert page_of([("budget", "A machine")], []).count("|") == 0
