"""nbval for this workbook: numbers are compared as numbers, and a part of the notebooks has its turn each day.

A plugin of pytest in the place of nbval's own (``-p no:nbval -p workbook.nbval_check``): its options, its
checks and its reports. Two things are added. An output that differs from the committed one in nothing but the last
digits of its numbers passes (`workbook.compare.same_text`). And ``--nbval-rerun N`` executes N of the notebooks, others
on each day, where the rest is left to what compares their builds (`tests/committed`).
"""

import datetime
import importlib
import itertools
import sys
from functools import cache
from pathlib import Path

from workbook.compare import printed, same_text
from workbook.notebooks import notebook_file, select

# As in `stillwork.base.command_line`: a second or two of every process that loads nbformat, as nbval does.
sys.modules.setdefault("rfc3987_syntax", None)
nbval = importlib.import_module("nbval.plugin")


def pytest_addoption(parser):
    nbval.pytest_addoption(parser)
    group = parser.getgroup("nbval")
    group.addoption(
        "--nbval-rerun", type=int, default=None, help="execute N of the notebooks, others each day"
    )


def pytest_configure(config):
    nbval.pytest_configure(config)


def pytest_collect_file(file_path, parent):
    """A notebook whose turn it is, or None if nbval is not used."""
    if parent.config.option.nbval and file_path.suffix == ".ipynb" and _has_turn(file_path, parent.config):
        return ComparedNotebook.from_parent(parent, path=file_path)


def _has_turn(file: Path, config) -> bool:
    count = config.option.nbval_rerun
    return count is None or file.resolve() in _chosen(count, datetime.date.today().toordinal())


@cache
def _chosen(count: int, day: int) -> set[Path]:
    names = [notebook.name for notebook in select()]
    return {notebook_file(name).resolve() for name in chosen_to_run(count, names, day)}


def chosen_to_run(count: int, names: list[str], day: int) -> set[str]:
    """The notebooks that are executed again on a day: each has its turn before the first comes again."""
    return {names[(day * count + offset) % len(names)] for offset in range(min(count, len(names)))}


class ComparedNotebook(nbval.IPyNbFile):
    """A notebook whose cells compare numbers as numbers."""

    def collect(self):
        for cell in super().collect():
            yield ComparedCell.from_parent(
                self, name=cell.name, cell_num=cell.cell_num, cell=cell.cell, options=cell.options
            )


class ComparedCell(nbval.IPyNbCell):
    """A cell for whose output the committed text is taken where it differs from it by rounding alone."""

    def compare_outputs(self, test, ref, skip_compare=None):
        for now, before in itertools.zip_longest(test, ref):
            if now and before and now["output_type"] == before["output_type"]:
                if same_text(printed(now), printed(before)):
                    if now["output_type"] == "stream":
                        now["text"] = before["text"]
                    elif "text/plain" in now["data"] and "text/plain" in before["data"]:
                        now["data"]["text/plain"] = before["data"]["text/plain"]
        return super().compare_outputs(test, ref, skip_compare)
