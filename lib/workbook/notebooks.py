"""The workbook's notebooks, and which of them a command means."""

import json
import re
from base64 import b64encode
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from workbook import paths
from workbook.appendix import KIND as APPENDIX
from workbook.checks import InputError, nearest
from workbook.parameters import Parameter, read_parameters

LISTED = 12  # parameters that are named where none is near
PICTURES = 3  # that a committed notebook shows
# What is kept of an output; Markdown is a sentence of `Page.conclude`, HTML a table of `Page.show` or the claims.
TEXT = ("text/plain", "text/markdown", "text/html", APPENDIX)
SAVED = re.compile(r"([\w.-]+)\.png, \1\.csv")  # the text of a saved figure

# A notebook's own, in the form that is committed: no version of whatever ran it.
METADATA = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}


@dataclass(frozen=True)
class Notebook:
    """A notebook as it stands in the workbook.

    Attributes
    ----------
    name : str
        ``topic/nn-result``.
    source : str
        The file's text.
    cells : dict of str to str
        Code cells by id, without the parameters cell.
    parameters : dict of str to Parameter
        In the order of the notebook.
    """

    name: str
    source: str
    cells: dict[str, str]
    parameters: dict[str, Parameter]

    @property
    def topic(self) -> str:
        return self.name.partition("/")[0]


def read_notebook(name: str) -> Notebook:
    """Read ``notebooks/<name>.ipynb``.

    Raises
    ------
    InputError
        When it is no notebook, two of its cells have one id, or its parameters cell has another form; the message
        names the id or the line.
    """
    file = notebook_file(name)
    source = file.read_text(encoding="utf-8")
    try:
        every = json.loads(source)["cells"]
        cells = [cell for cell in every if cell["cell_type"] == "code"]
        tagged = [cell for cell in cells if "parameters" in cell["metadata"].get("tags", [])]
        code = {cell["id"]: _text(cell) for cell in cells if cell not in tagged}
        twice = [name for name, count in Counter(cell["id"] for cell in every).items() if count > 1]
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InputError(
            f"{file}: not a notebook whose cells have ids (nbformat 4.5); save it again from Jupyter"
        ) from None
    if twice:
        raise InputError(f"{file}: several cells have the id {twice[0]!r}; give each its own")
    if len(tagged) > 1:
        raise InputError(f"{file}: {len(tagged)} cells are tagged 'parameters'; keep one")
    parameters = read_parameters(str(file), _text(tagged[0])) if tagged else {}
    return Notebook(name, source, code, parameters)


def notebook_file(name: str) -> Path:
    """Path of the notebook ``topic/nn-result``."""
    return paths.root() / "notebooks" / f"{name}.ipynb"


def select(*targets: str) -> list[Notebook]:
    """Read the notebooks that `targets` mean: notebooks, topics, or (without any) all of the workbook.

    Raises
    ------
    InputError
        When there is no such topic or notebook; the nearest is named.
    """
    folder = paths.root() / "notebooks"
    names = [
        f"{topic}/{file.stem}"
        for topic in paths.topics()
        for file in sorted((folder / topic).glob("[!.]*.ipynb"))
    ]
    wanted = {
        target: target.removeprefix("notebooks/").removesuffix(".ipynb").rstrip("/") for target in targets
    }
    for target, name in wanted.items():
        if not any(name in (each, each.partition("/")[0]) for each in names):
            raise InputError(f"there is no notebook or topic {target!r}{_meant(name, names)}")
    chosen = {name for name in names if {name, name.partition("/")[0]} & set(wanted.values())}
    return [read_notebook(name) for name in names if name in chosen or not targets]


def _meant(name: str, names: list[str]) -> str:
    """Suggestion of notebooks or a topic, as `nearest` writes it."""
    begun = [each for each in names if each.startswith(name)]  # a number without its words
    if len(begun) == 1:
        return f"; did you mean {begun[0]!r}?"
    return nearest(name, [*names, *{each.partition("/")[0] for each in names}])


def assign(notebooks: list[Notebook], settings: dict[str, str]) -> list[tuple[Notebook, dict[str, object]]]:
    """Give each notebook the `settings` that it declares; those that declare none of them drop out.

    Returns
    -------
    list of (Notebook, dict)
        The values that differ from those in the notebook.

    Raises
    ------
    InputError
        When no notebook has a parameter of that name, or its type is another.
    """
    known = list(dict.fromkeys(name for notebook in notebooks for name in notebook.parameters))
    for name in settings:
        if name not in known:
            where = notebooks[0].name if len(notebooks) == 1 else "no notebook here"
            has = "has no" if len(notebooks) == 1 else "has a"
            hint = nearest(name, known)
            if known and not hint:
                hint = f"; {'it has' if len(notebooks) == 1 else 'they have'} {', '.join(known[:LISTED])}"
            raise InputError(f"{where} {has} parameter {name!r}{hint}")
    chosen = []
    for notebook in notebooks:
        mine = {name: text for name, text in settings.items() if name in notebook.parameters}
        if settings and not mine:
            continue
        try:
            values = {name: notebook.parameters[name].read(text) for name, text in mine.items()}
        except InputError as error:
            raise InputError(f"{notebook.name}: {error}") from None
        changed = {k: v for k, v in values.items() if repr(v) != repr(notebook.parameters[k].value)}
        chosen.append((notebook, changed))
    return chosen


def cleaned(notebook: dict, executed: dict) -> dict:
    """`notebook` with the text outputs of `executed`: no pictures, widgets, times or random ids."""
    outputs = {cell["id"]: cell for cell in executed["cells"] if cell["cell_type"] == "code"}
    cells = []
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            ran = outputs[cell["id"]]
            kept = [text for output in ran["outputs"] if (text := _text_only(output))]
            cell = {**cell, "execution_count": ran["execution_count"], "outputs": joined(kept)}
            cell["metadata"] = {k: v for k, v in cell["metadata"].items() if k == "tags"}
        cells.append(cell)
    return {**notebook, "cells": cells, "metadata": METADATA}


def with_pictures(notebook: dict, folder: Path, published: Collection[str]) -> dict:
    """A cleaned notebook with the first picture that it saves and the `published` ones, `PICTURES` at most.

    Parameters
    ----------
    notebook : dict
    folder : Path
        Where its accepted pictures are, as PNG.
    published : collection of str
        Names of the pictures that stand in the source.
    """
    every = [output for cell in notebook["cells"] for output in cell.get("outputs", [])]
    saved = [name for output in every if (name := _saved(output))]
    shown = [*saved[:1], *(name for name in saved[1:] if name in published)][:PICTURES]
    cells = []
    for cell in notebook["cells"]:
        if "outputs" in cell:
            outputs = [output for each in cell["outputs"] if (output := _text_only(each))]
            for output in outputs:
                name = _saved(output)
                if name in shown and (folder / f"{name}.png").is_file():
                    output["data"]["image/png"] = b64encode((folder / f"{name}.png").read_bytes()).decode()
            cell = {**cell, "outputs": outputs}
        cells.append(cell)
    return {**notebook, "cells": cells}


def _saved(output: dict) -> str | None:
    """Name of the figure that an output of `workbook.page.Page.save` shows."""
    found = SAVED.fullmatch("".join(output.get("data", {}).get("text/plain", "")))
    return found and found[1]


def notebook_text(notebook: dict) -> str:
    """The file's text, in the one order that accepting writes."""
    return json.dumps(notebook, indent=1, ensure_ascii=False, sort_keys=True) + "\n"


def joined(outputs: list[dict]) -> list[dict]:
    """Outputs with one stream where several of its name follow each other: how many came is a matter of time."""
    found: list[dict] = []
    for output in outputs:
        last = found[-1] if found else {}
        if output["output_type"] == "stream" and last.get("name") == output["name"]:
            text = "".join(last["text"]) + "".join(output["text"])
            as_lines = isinstance(output["text"], list)
            found[-1] = {**last, "text": text.splitlines(True) if as_lines else text}
        else:
            found.append(output)
    return found


def _text_only(output: dict) -> dict | None:
    if output["output_type"] == "stream":
        return output
    data = output.get("data", {})  # an error has none
    if "text/plain" not in data:
        return None
    return {**output, "data": {kind: data[kind] for kind in TEXT if kind in data}, "metadata": {}}


def _text(cell: dict) -> str:
    return "".join(cell["source"])
