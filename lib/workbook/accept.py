"""Copies a build into the tree: figures and claims, outputs into the notebooks, and what follows from them.

What agrees with the committed results keeps its committed bytes, so an accept that moves nothing changes nothing.
Concurrent changes in the tree are kept: accepting writes only its own changes, and nothing
where that is no longer what it read (`workbook.publish.replace_all`).
"""

import contextlib
import json
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

from workbook import paths
from workbook.claims import DISAGREEMENT, Claim, claims_text, ledger, load_entries
from workbook.compare import Comparison, compare, found_claims, same_outputs
from workbook.lock import exclusive_lock, interrupts, unwound
from workbook.notebooks import cleaned, notebook_text, select, with_pictures
from workbook.provenance import commit, is_traceable, with_commit
from workbook.publish import RECORD, Edited, content_of, read_record, replace_all, replace_file, seconds_taken
from workbook.tasks import DURATIONS, Task, durations, tasks, updated_durations

FOLDERS = ("notebooks", "data", "figures")  # what accepting reads; it writes to the first and the last
OWN = (".png", ".csv", ".json")  # what builds write there; anything else is not theirs


def accept(refresh: Callable[[], object]) -> int:
    """Accept the published-settings build of the whole workbook, or nothing of it.

    Parameters
    ----------
    refresh : callable
        Rewrites what follows from ledger and notebooks.

    Returns
    -------
    int
        1 when the build is missing or stale, or the results cannot be written, or were edited meanwhile; 128 + signal
        when a signal came while they were put in their places.
    """
    with unwound(), exclusive_lock():
        try:
            with committed_copy() as (copy, before):
                built = _built(copy)
                stale = [(task, reasons) for task in built if (reasons := task.reasons())]
                if stale:
                    for task, reasons in stale:
                        print(f"stale: {task.label}: {'; '.join(reasons[:3])}")
                    print("nothing accepted; run `make figures` first")
                    return 1
                compared = [(task, compare(task)) for task in built]
                for task, comparison in compared:
                    _take_over(task, comparison, copy)
                _note_durations(built, copy)
                with paths.rooted(copy):
                    claims = ledger()
                    refresh()
                after = _committed(copy)
            with interrupts() as caught:
                names = _differing(before, after)
                replace_all(paths.root(), {name: (before.get(name), after.get(name)) for name in names})
        except (OSError, Edited) as error:
            print(f"nothing accepted: {error}")
            return 1
    for _, comparison in compared:
        for line in comparison.moved:
            print(f"moved: {line}")
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
        for file in sorted(task.committed.rglob("*")):
            if (
                file.is_file()
                and not file.name.endswith(OWN)
                and not (task.target / file.relative_to(task.committed)).exists()
            ):
                print(f"of no build, and left there: {file.relative_to(paths.root())}")


@contextlib.contextmanager
def committed_copy() -> Iterator[tuple[Path, dict[str, bytes]]]:
    """A copy of what is committed, to try the whole change on, and its files as they were.

    No file of it is one that stands in the tree, since an editor may write into that at any time.
    """
    root, copy = paths.root(), paths.root() / "build" / "accepting"
    before = _committed(root)
    shutil.rmtree(copy, ignore_errors=True)  # of one that was killed
    try:
        for name, content in before.items():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            (copy / name).write_bytes(content)
        yield copy, before
    finally:
        shutil.rmtree(copy, ignore_errors=True)


def _differing(one: dict[str, bytes], other: dict[str, bytes]) -> list[str]:
    return sorted(name for name in one | other if one.get(name) != other.get(name))


def _committed(folder: Path) -> dict[str, bytes]:
    """Files of these folders and beside them, by path below `folder`."""
    files, seen = list(folder.iterdir()), set()
    for top in FOLDERS:
        for place, below, names in os.walk(folder / top, onerror=_unless_gone, followlinks=True):
            files += [Path(place, name) for name in names]
            if (real := os.path.realpath(place)) in seen:  # a link that leads back
                below.clear()
            seen.add(real)
    found = {}
    for file in files:
        if not file.is_file():  # but a pipe, a socket, a link to nowhere
            continue
        with contextlib.suppress(FileNotFoundError):  # an editor's own, gone since
            found[file.relative_to(folder).as_posix()] = file.read_bytes()
    return found


def _unless_gone(error: OSError) -> None:
    """The content of a folder that cannot be listed is unknown."""
    if not isinstance(error, FileNotFoundError):
        raise error


def _built(copy: Path) -> list[Task]:
    """The tasks of the notebooks that are in the copy, all of them."""
    built = tasks()
    with paths.rooted(copy):
        others = {each.name for each in select()} ^ {task.notebook.name for task in built}
    if others:
        raise Edited([f"notebooks/{name}.ipynb" for name in sorted(others)])
    return built


def _take_over(task: Task, comparison: Comparison, copy: Path) -> None:
    """Put what does not agree of one notebook's results into the copy."""
    home = copy / "figures" / task.notebook.name
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
        replace_file(home / name, content[name])
    for name in before - now:
        if name.endswith(OWN):
            (home / name).unlink()
    _take_over_outputs(task, copy / "notebooks" / f"{task.notebook.name}.ipynb", home)


def _note_durations(built: list[Task], copy: Path) -> None:
    noted = updated_durations(durations(), {task.notebook.name: seconds_taken(task.target) for task in built})
    if noted != durations():
        replace_file(copy / DURATIONS, (json.dumps(noted, indent=1) + "\n").encode())


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


def _take_over_outputs(task: Task, file: Path, home: Path) -> None:
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
    executed = with_pictures(executed, home, published)
    if (text := notebook_text(executed)) != file.read_text(encoding="utf-8"):
        replace_file(file, text.encode())
