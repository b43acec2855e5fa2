"""A notebook as a study of open choices: its own cells, run with other parameters, give the values that it claims."""

import contextlib
import io
import json
from collections.abc import Mapping
from functools import cache

from workbook import paths
from workbook.appendix import Appendix, function_of
from workbook.checks import InputError, nearest
from workbook.dependencies import dependencies
from workbook.parameters import read_parameters
from workbook.publish import digest

Value = float | tuple[float, tuple[float, float]]


class _Recorder:
    """Stands for the notebook's page: keeps what is checked and writes nothing."""

    claims = ()

    def __init__(self, notebook: str, entries: tuple[str, ...]):
        self.notebook, self.entries = notebook, entries
        self.found: dict[str, Value] = {}

    def save(self, name, figure, rounding=None, shown=True):
        return figure

    def check(self, claim: str, ours: float, interval: tuple[float, float] | None = None) -> None:
        self.found[claim] = ours if interval is None else (ours, tuple(map(float, interval)))

    def conclude(self, text, otherwise=None, /, when=True, **values):
        """Nothing: a study asks for values alone."""

    def show(self, *values, **options):
        """Nothing, as `conclude`."""

    def sentence(self, text, otherwise, when, values) -> str:
        return ""

    def appendix(self, **settings) -> None:
        """As of the page, where one of the entries is not found before it."""
        if not set(self.entries) <= set(self.found):
            function_of(self.notebook)(Appendix(self), **settings)


def code_cells(notebook: str) -> list[tuple[str, bool]]:
    """Source of a notebook's code cells without its explorer, and whether a cell declares the parameters."""
    file = paths.root() / "notebooks" / f"{notebook}.ipynb"
    try:
        cells = json.loads(file.read_text(encoding="utf-8"))["cells"]
    except OSError:
        raise InputError(f"there is no notebook {notebook!r}; give 'topic/name'") from None
    found = [("".join(cell["source"]), cell) for cell in cells if cell["cell_type"] == "code"]
    return [
        (source, "parameters" in cell["metadata"].get("tags", []))
        for source, cell in found
        if "explore(" not in source
    ]


@cache  # for the life of the process: what it has imported does not change under it either
def study_digest(function: str) -> str:
    """Digest of what a study depends on (`workbook.dependencies`): one of ``package.module:function``, or a notebook's cells.

    The ledger and the combinations are left out: they state what is computed, not what comes out.
    """
    if "/" in function:
        sources = [source for source, _ in code_cells(function)]
        found = {"cells": digest("\n".join(sources).encode()), **dependencies(sources)}
    else:
        found = dependencies(modules=[function.partition(":")[0]])
    return digest(json.dumps([function, sorted(found.items())]).encode())


def run_notebook(notebook: str, entries: tuple[str, ...], options: Mapping) -> dict[str, Value]:
    """What a notebook claims of `entries` when some of its parameters have other values.

    Raises
    ------
    InputError
        When the notebook has no such parameter.
    """
    names: dict = {"__name__": "__main__"}
    page = None
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        for source, declares in code_cells(notebook):
            exec(compile(source, notebook, "exec"), names)
            if declares:
                known = read_parameters(notebook, source)
                for name in options:
                    if name not in known:
                        raise InputError(f"{notebook} has no parameter {name!r}{nearest(name, known)}")
                names |= options
            if page is None and "page" in names:
                page = names["page"] = _Recorder(notebook, entries)
    return {entry: page.found[entry] for entry in entries}
