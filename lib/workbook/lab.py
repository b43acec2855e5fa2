"""An extension of Jupyter's server: a committed notebook is saved in its committed form, whatever a run changed.

The page shows what was run; the file keeps what a person wrote. Results come into it by `accept` alone.
"""

from pathlib import Path

import nbformat

from workbook import paths
from workbook.notebooks import METADATA
from workbook.provenance import committed

# "trusted" is between the page and the server, which takes it out before it writes.
KEPT = ("tags", "trusted")


def _jupyter_server_extension_points() -> list[dict[str, str]]:
    return [{"module": __name__}]


def _load_jupyter_server_extension(server) -> None:
    try:
        paths.root()
    except FileNotFoundError:  # the library alone has no notebooks
        return
    server.contents_manager.register_pre_save_hook(keep_committed_form)


def keep_committed_form(*, path: str, model: dict, contents_manager, **_) -> None:
    """Bring a notebook that is about to be saved into the form in which it is committed.

    It is for the workbook's notebooks that the last commit holds; all else is saved as it is. Bad content raises:
    the server then logs it and continues with what it was given.

    Parameters
    ----------
    path : str
        Where it is saved, from the root of `contents_manager`.
    model : dict
        With ``type`` and ``content``, which is replaced.
    contents_manager : jupyter_server.services.contents.manager.ContentsManager
        One that saves to a ``root_dir``.
    """
    root = paths.root().resolve()
    file = Path(contents_manager.root_dir, path).resolve()
    if model.get("type") != "notebook" or not file.is_relative_to(root / "notebooks"):
        return
    text = committed(file.relative_to(root).as_posix())
    if text is None:
        return
    on_disk = file.read_text(encoding="utf-8") if file.exists() else ""
    # The disk comes last and wins: it may hold what was accepted since the commit.
    model["content"] = committed_form(model["content"], [text, on_disk])


def committed_form(notebook: dict, before: list[str]) -> dict:
    """`notebook` as a person wrote it, with the results that stood beside the same source before.

    Parameters
    ----------
    notebook : dict
        As a page gives it: with what its run left in it.
    before : list of str
        Texts of the notebook in earlier states; of a cell's results the last counts.

    Returns
    -------
    dict
        Cells, ids, sources, tags and attachments are those of `notebook`; outputs and execution count of a code
        cell are those of the cell with its id and source in `before`, none where there is none.
    """
    known = {_key(cell): cell for text in before for cell in _code_cells(text)}
    cells = []
    for cell in notebook["cells"]:
        cell = {**cell, "metadata": {k: v for k, v in cell["metadata"].items() if k in KEPT and v}}
        if cell["cell_type"] == "code":
            same = known.get(_key(cell), {"outputs": [], "execution_count": None})
            cell |= {"outputs": same["outputs"], "execution_count": same["execution_count"]}
        cells.append(cell)
    return {**notebook, "cells": cells, "metadata": METADATA}


def _key(cell: dict) -> tuple[str, str]:
    return cell["id"], "".join(cell["source"])


def _code_cells(text: str) -> list[dict]:
    try:
        notebook = nbformat.reads(text, as_version=4)
    except Exception:  # however a file is broken, there are no results to keep
        return []
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
