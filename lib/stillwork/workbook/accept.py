"""Takes a build's results over: outputs into the notebooks, our values into the ledger and what follows from it."""

import json

import tomlkit

from stillwork import paths
from stillwork.claims import Claim, ledger
from stillwork.workbook import publish
from stillwork.workbook.notebooks import notebook_file
from stillwork.workbook.tasks import Task, tasks


def accept() -> int:
    """Accept the published-settings build of the whole workbook; returns 1 when it is missing or stale."""
    from stillwork.site.derived import refresh

    built = tasks()
    stale = [(task, reasons) for task in built if (reasons := task.reasons())]
    if stale:
        for task, reasons in stale:
            print(f"stale: {task.label}: {'; '.join(reasons[:3])}")
        print("nothing accepted; run `make figures` first")
        return 1
    claims = ledger()
    for task in built:
        _take_over_outputs(task)
    for room in paths.ROOMS:
        _write_ours(room, [claim for claim in claims if claim.entry.room == room])
    refresh()
    moved = [claim for claim in claims if claim.moved]
    for claim in moved:
        print(f"moved: {claim.entry.id}: {claim.entry.ours:.6g} -> {claim.ours:.6g}")
    for claim in claims:
        if claim.ours is None:
            print(f"claimed by no notebook: {claim.entry.id}")
        elif claim.verdict in ("deviates", "fails") and not claim.entry.reason:
            print(f"{claim.verdict} without a reason: {claim.entry.id}")
    for folder in sorted((paths.root() / "figures").glob("[!.]*/[!.]*/")):
        if folder not in {task.target for task in built}:
            print(f"belongs to no notebook, remove it: {folder.relative_to(paths.root())}")
    print(f"accepted {len(built)} notebooks and {len(claims)} ledger entries")
    return 0


def cleaned(notebook: dict, executed: dict) -> dict:
    """`notebook` with the text outputs of `executed`: no pictures, widgets, HTML, times or random ids."""
    outputs = {cell["id"]: cell for cell in executed["cells"] if cell["cell_type"] == "code"}
    cells = []
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            ran = outputs[cell["id"]]
            kept = [_text_only(output) for output in ran["outputs"]]
            cell = {**cell, "execution_count": ran["execution_count"], "outputs": [o for o in kept if o]}
            cell["metadata"] = {k: v for k, v in cell["metadata"].items() if k == "tags"}
        cells.append(cell)
    metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    return {**notebook, "cells": cells, "metadata": metadata}


def notebook_text(notebook: dict) -> str:
    """The file's text, in the one order that accepting writes."""
    return json.dumps(notebook, indent=1, ensure_ascii=False, sort_keys=True) + "\n"


def _text_only(output: dict) -> dict | None:
    if output["output_type"] == "stream":
        return output
    text = output["data"].get("text/plain")
    if text is None:
        return None
    return {**output, "data": {"text/plain": text}, "metadata": {}}


def _take_over_outputs(task: Task) -> None:
    file = notebook_file(task.notebook.name)
    notebook = json.loads(file.read_text(encoding="utf-8"))
    executed = json.loads(task.executed.read_text(encoding="utf-8"))
    publish.replace_file(file, notebook_text(cleaned(notebook, executed)).encode())


def _write_ours(room: str, claims: list[Claim]) -> None:
    file = paths.data(room, "published.toml")
    if not claims:
        return
    document = tomlkit.parse(file.read_text(encoding="utf-8"))
    for claim in claims:
        if claim.ours is not None:
            entry = document
            for part in claim.entry.id.split("."):
                entry = entry[part]
            if entry.get("ours") != claim.ours:
                _set_ours(entry, claim.ours)
    publish.replace_file(file, tomlkit.dumps(document).encode())


def _set_ours(entry: tomlkit.items.Table, value: float) -> None:
    """After the entry's own keys: comments behind them belong to what comes next."""
    body = entry.value.body
    following = []
    while body[-1][0] is None:
        following.insert(0, body.pop())
    entry["ours"] = value
    body.extend(following)
