"""Every numbered conclusion of the thesis is judged by entries of the ledger, and the page of all papers knows them."""

from workbook.claims import load_entries
from workbook.site.stated import stated

NUMBERS = {2: 3, 3: 8, 4: 7, 5: 9, 6: 2}  # conclusions of each chapter, section 7.1


def test_every_numbered_conclusion_is_judged():
    ledger = load_entries("motion")
    found = [each for each in stated("motion", ledger) if not each.place.startswith("Remark")]
    assert [each.place for each in found] == [
        f"{c}.{k}" for c, last in NUMBERS.items() for k in range(1, last + 1)
    ]
    for each in found:
        kinds = {ledger[name].kind for name in each.entries}
        assert kinds & {"value", "exact", "slope", "ordering"}, each.place
