"""Copies a build into the tree: figures and claims, outputs into the notebooks, and what follows from them.

What agrees with the committed results keeps its committed bytes, so an accept that moves nothing changes nothing.
`git restore` takes an accept back.
"""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

from workbook import paths
from workbook.claims import DISAGREEMENT, Claim, claims_text, ledger, load_entries
from workbook.compare import Comparison, compare, found_claims, same_outputs
from workbook.lock import exclusive_lock, interrupts
from workbook.notebooks import cleaned, notebook_file, notebook_text, with_pictures
from workbook.provenance import commit, is_traceable, with_commit
from workbook.publish import RECORD, content_of, read_record, replace_file, seconds_taken
from workbook.tasks import DURATIONS, Task, durations, tasks, updated_durations

OWN = (".png", ".csv", ".json")  # what builds write there; anything else is not theirs


def accept(refresh: Callable[[], list[str]]) -> int:
    """Accept the published-settings build of the whole workbook; nothing while any of it is stale.

    Parameters
    ----------
    refresh : callable
        Rewrites what follows from ledger and notebooks; returns the names of the files.

    Returns
    -------
    int
        1 when the build is missing or stale, or the results cannot be written; 128 + signal when a signal came while
        they were put in their places, which it does not cut short.
    """
    with exclusive_lock():
        built = tasks()
        if stale := [(task, reasons) for task in built if (reasons := task.reasons())]:
            for task, reasons in stale:
                print(f"stale: {task.label}: {'; '.join(reasons[:3])}")
            print("nothing accepted; run `make figures` first")
            return 1
        compared = [(task, compare(task)) for task in built]
        try:
            with interrupts() as caught:
                names = [name for each in compared for name in _take_over(*each)]
                names += [*_note_durations(built), *refresh()]
        except OSError as error:
            print(f"accepted in part ({error}): `make accept` writes the rest, `git restore` takes it back")
            return 1
    for _, comparison in compared:
        for line in comparison.moved:
            print(f"moved: {line}")
    claims = ledger()
    _print_summary(claims, built)
    print(f"accepted {len(built)} notebooks and {len(claims)} ledger entries: {len(names)} files changed")
    return 128 + caught[0] if caught else 0


def _print_summary(claims: list[Claim], built: list[Task]) -> None:
    for claim in claims:
        if claim.ours is None:
            print(f"claimed by no notebook: {claim.entry.id}")
        elif claim.here in DISAGREEMENT and not claim.entry.reason:
            print(f"{claim.here} without a reason: {claim.entry.id}")
    for folder in sorted((paths.root() / "figures").glob("[!.]*/[!.]*/")):
        if folder not in {task.committed for task in built}:
            print(f"belongs to no notebook, remove it: {folder.relative_to(paths.root())}")
    for task in built:
        if not is_traceable(_provenance(content_of(task.committed / "provenance.json"))) and commit():
            print(f"made from what no commit holds: {task.label}; commit it, then accept again")


def _take_over(task: Task, comparison: Comparison) -> Iterator[Path]:
    """Put what does not agree of one notebook's results into the tree; gives the files that changed."""
    home = task.committed
    before = {file.relative_to(home).as_posix() for file in home.rglob("*") if file.is_file()}
    now = {file.relative_to(task.target).as_posix() for file in task.target.rglob("*") if file.is_file()}
    now -= {RECORD, task.executed.name}
    taken = {name for name in now if name.rpartition(".")[0] in comparison.files}
    taken |= {name for name in now if not name.endswith((".png", ".csv", ".json"))}
    if "rounding.json" in now:
        taken.add("rounding.json")
    content = {name: (task.target / name).read_bytes() for name in now}
    if "claims.json" in now:
        content["claims.json"] = _claims_kept(task, home / "claims.json", comparison)
        taken.add("claims.json")
    taken = {name for name in taken & now if content_of(home / name) != content[name]}
    if "provenance.json" in now:
        inputs, _ = read_record(task.target) or ({}, [])
        content["provenance.json"] = with_commit(content["provenance.json"], task.notebook, inputs)
    new, old = (
        _provenance(content.get("provenance.json")),
        _provenance(content_of(home / "provenance.json")),
    )
    if taken or now - before or _made_under(old) != _made_under(new) or _is_first_traceable(old, new):
        taken |= (now - before) | {"provenance.json"}
    for name in taken:
        yield from _put(home / name, content[name])
    for name in before - now:
        if name.endswith(OWN):
            (home / name).unlink()
            yield home / name
    yield from _take_over_outputs(task, home)


def _put(file: Path, content: bytes) -> Iterator[Path]:
    if content_of(file) != content:
        replace_file(file, content)
        yield file


def _note_durations(built: list[Task]) -> Iterator[Path]:
    noted = updated_durations(durations(), {task.notebook.name: seconds_taken(task.target) for task in built})
    if noted != durations():
        yield from _put(paths.root() / DURATIONS, (json.dumps(noted, indent=1) + "\n").encode())


def _provenance(content: bytes | None) -> dict:
    return json.loads(content) if content else {}


def _made_under(provenance: dict) -> list:
    """The pins and the parameters, by their present names, that results were made under."""
    return [provenance.get("environment_sha256"), provenance.get("parameters")]


def _is_first_traceable(old: dict, new: dict) -> bool:
    """Whether a commit holds what the new results were made from, and none what the committed ones were."""
    return is_traceable(new) and not is_traceable(old)


def _claims_kept(task: Task, committed: Path, comparison: Comparison) -> bytes:
    """What was found, with the committed value wherever it agrees: then many small steps cannot add up unseen."""
    now, before = found_claims(task.target / "claims.json"), found_claims(committed)
    return claims_text(
        {name: each if name in comparison.claims else before[name] for name, each in now.items()}
    ).encode()


def _take_over_outputs(task: Task, home: Path) -> Iterator[Path]:
    file = notebook_file(task.notebook.name)
    notebook = json.loads(file.read_text(encoding="utf-8"))
    executed = cleaned(notebook, json.loads(task.executed.read_text(encoding="utf-8")))
    for cell, before in zip(executed["cells"], notebook["cells"], strict=True):
        if cell["cell_type"] == "code" and same_outputs(cell["outputs"], before["outputs"]):
            cell["outputs"] = before["outputs"]
    published = {
        name.split(".")[1]
        for name, entry in load_entries(task.notebook.topic).items()
        if entry.is_replication
    }
    yield from _put(file, notebook_text(with_pictures(executed, home, published)).encode())
