"""What follows from the ledger and the notebooks is as they are: README, index notebook, manifests."""

from workbook import paths
from workbook.site.derived import derived_files


def test_the_readme_has_a_place_for_the_ledger():
    assert "<!-- ledger:begin -->" in (paths.root() / "README.md").read_text(encoding="utf-8")


def test_a_derived_file_is_current():
    made = derived_files()  # once, by the worker that takes this test
    assert "README.md" in made
    stale = [name for name, text in made.items() if (paths.root() / name).read_text(encoding="utf-8") != text]
    assert stale == [], "run `python -m workbook refresh`"
