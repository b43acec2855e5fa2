"""Every numbered conclusion of the thesis is judged by entries of the ledger."""

import tomllib

from workbook import paths
from workbook.claims import load_entries

NUMBERS = {2: 3, 3: 8, 4: 7, 5: 9, 6: 2}  # conclusions of each chapter, section 7.1


def test_every_numbered_conclusion_is_judged():
    given = tomllib.loads(paths.data("motion", "conclusions.toml").read_text(encoding="utf-8"))
    assert list(given) == [f"{chapter}.{k}" for chapter, last in NUMBERS.items() for k in range(1, last + 1)]
    ledger = load_entries("motion")
    for number, conclusion in given.items():
        assert set(conclusion) == {"says", "entries"}, number
        assert not set(conclusion["entries"]) - set(ledger), number
        kinds = {ledger[name].kind for name in conclusion["entries"]}
        assert kinds & {"value", "exact", "slope", "ordering"}, number
