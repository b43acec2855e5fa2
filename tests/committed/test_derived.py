"""What follows from the ledger and the notebooks is as they are: README, index notebook, manifests."""

import pytest

from stillwork.base import paths
from stillwork.site.derived import derived_files

FILES = derived_files()


def test_the_readme_has_a_place_for_the_ledger():
    assert "<!-- ledger:begin -->" in FILES["README.md"]


@pytest.mark.parametrize("name", FILES)
def test_a_derived_file_is_current(name):
    assert (paths.root() / name).read_text(encoding="utf-8") == FILES[name], (
        "run `python -m stillwork refresh`"
    )
