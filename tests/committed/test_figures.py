"""The figures of a fresh run, `make figures` in build/figures, against the committed ones.

STILLWORK_REBUILT names another fresh build.
"""

import os
from pathlib import Path

import pytest

from workbook import paths
from workbook.compare import numbers_difference
from workbook.tasks import built

COMMITTED = paths.root() / "figures"
REBUILT = Path(os.environ.get("STILLWORK_REBUILT") or built())
AGAIN = paths.root() / "build" / "nbval"  # what nbval executed again


def tables(folder: Path) -> set[str]:
    return {file.relative_to(folder).with_suffix("").as_posix() for file in folder.glob("[!.]*/[!.]*/*.csv")}


def test_every_figure_was_rebuilt_and_every_rebuilt_one_is_committed():
    assert tables(COMMITTED)
    assert tables(REBUILT) == tables(COMMITTED)


def test_every_table_has_its_picture():
    for name in tables(COMMITTED):
        assert (COMMITTED / f"{name}.png").read_bytes().startswith(b"\x89PNG"), name


@pytest.mark.parametrize("name", sorted(tables(COMMITTED)))
def test_a_fresh_run_plots_the_committed_numbers(name):
    assert numbers_difference(REBUILT / name, COMMITTED / name) is not None


def test_what_was_executed_again_plots_them_too():
    for name in sorted(tables(AGAIN) & tables(COMMITTED)):
        assert numbers_difference(AGAIN / name, COMMITTED / name) is not None, name
