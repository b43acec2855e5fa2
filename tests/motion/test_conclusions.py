"""Every numbered conclusion of the thesis is judged by entries of the ledger, or says why none can."""

import tomllib

from workbook import paths
from workbook.claims import load_entries

NUMBERS = {2: 3, 3: 8, 4: 7, 5: 9, 6: 2}  # conclusions of each chapter, section 7.1


def test_every_numbered_conclusion_is_judged_or_says_why_not():
    given = tomllib.loads(paths.data("motion", "conclusions.toml").read_text(encoding="utf-8"))
    assert list(given) == [f"{chapter}.{k}" for chapter, last in NUMBERS.items() for k in range(1, last + 1)]
    ledger = load_entries("motion")
    for number, conclusion in given.items():
        assert set(conclusion) in ({"says", "entries"}, {"says", "open"}), number
        named = conclusion.get("entries", [])
        assert not set(named) - set(ledger), number
        kinds = {ledger[name].kind for name in named}
        assert not named or kinds & {"value", "exact", "slope", "ordering"}, number
