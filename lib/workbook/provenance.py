"""Where a result comes from: the commit, the settings and the software that made it."""

import json
import subprocess
from collections.abc import Iterable

from workbook import paths
from workbook.notebooks import Notebook
from workbook.publish import digest


def commit() -> str | None:
    """The checkout's commit; None where there is no git."""
    return _git("rev-parse", "HEAD") or None


def modified() -> set[str]:
    """Paths that differ from the commit."""
    lines = _git("status", "--porcelain", "-z", "--untracked-files=all", "--no-renames").split("\0")
    return {line[3:] for line in lines if line}


def provenance(
    notebook: Notebook,
    settings: dict[str, object],
    inputs: Iterable[str],
    software: dict[str, object],
    made_from: tuple[str | None, set[str]],
) -> bytes:
    """JSON record of a build, free of times and places; `made_from` is the commit and the modified paths."""
    revision, changed = made_from
    parameters = {name: settings.get(name, p.value) for name, p in notebook.parameters.items()}
    environment = digest((paths.root() / "environment.txt").read_bytes())
    record = {
        "notebook": notebook.name,
        "commit": revision,
        "dirty": bool(_used(notebook, inputs) & changed),
        "parameters": parameters,
        "seed": parameters.get("seed"),
        "environment_sha256": environment,
        **software,
    }
    return (json.dumps(record, indent=1) + "\n").encode()


def _used(notebook: Notebook, inputs: Iterable[str]) -> set[str]:
    """Files of the tree that a build's results rest on."""
    ledger = f"data/{notebook.topic}/published.toml"
    return {*inputs, ledger, f"notebooks/{notebook.name}.ipynb", "environment.txt"}


def with_commit(record: bytes, notebook: Notebook, inputs: Iterable[str]) -> bytes:
    """The record of an up-to-date build; of one from files that were not committed then and are now, with this commit."""
    content = json.loads(record)
    if is_traceable(content) or not (revision := commit()) or _used(notebook, inputs) & modified():
        return record
    content |= {"commit": revision, "dirty": False}
    return (json.dumps(content, indent=1) + "\n").encode()


def is_traceable(record: dict) -> bool:
    """Whether a commit holds what a build was made from."""
    return bool(record.get("commit")) and not record.get("dirty")


def _git(*arguments: str) -> str:
    try:
        done = subprocess.run(
            ["git", *arguments], cwd=paths.root(), capture_output=True, encoding="utf-8", check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return ""
    return done.stdout.rstrip("\n")
