"""What a notebook's results depend on, and what of it changed since they were built.

Some of it is known before anything runs: code cells, parameters, the pins of environment.txt, the processor's
settings. The rest is what the kernel was seen to read (`workbook.kernel_process.watch`): the modules of
the library that it imported, the data it opened, files and modules that a parameter led to. A module that no cell
leads to is no input, so an edit of it makes nothing stale.

A module below `MODULES` stands with two digests, of its bytes and of its code (`code_digest`): while its bytes are the
same nothing is parsed, and when they are not, its code decides. All else stands with one, of its bytes.
"""

import errno
import json
import os
import platform
import re
import tomllib
from functools import lru_cache
from pathlib import Path

from stillwork.base.source_digest import code_digest
from workbook import paths
from workbook.environment import pins
from workbook.notebooks import Notebook
from workbook.pinned import passed_inputs, settings
from workbook.publish import digest

ENVIRONMENT = ("environment: ", "setting ")
KNOWN_BEFORE = ("cell ", "order ", "parameter ", "file ", *ENVIRONMENT)
LEDGER = "ledger "
VALUES = ("parameter ", *ENVIRONMENT)  # inputs kept as they are; of the others a digest
ABSENT = (errno.ENOENT, errno.ENOTDIR, errno.ENAMETOOLONG, errno.ELOOP)  # of what no file has as its name
MODULES = ("lib/", "notebooks/")

_digests: dict[tuple, str] = {}
_codes: dict[str, str] = {}  # of modules, by the digest of their bytes


def environment_inputs() -> dict[str, str]:
    """The pins of environment.txt, the Python, the processor's settings and variables that may move numbers."""
    found = {f"environment: {name}": version for name, version in pins().items()}
    found["environment: Python"] = platform.python_version()
    return found | {f"setting {name}": value for name, value in {**passed_inputs(), **settings()}.items()}


def notebook_inputs(notebook: Notebook, values: dict[str, object]) -> dict[str, str]:
    """A notebook's code cells, its parameters, and the files that these name."""
    found = {f"cell {name}": digest(source.encode()) for name, source in notebook.cells.items()}
    found["order of the cells"] = digest("\n".join(notebook.cells).encode())
    for name, parameter in notebook.parameters.items():
        value = values.get(name, parameter.value)
        found[f"parameter {name}"] = repr(value)
        if isinstance(value, str) and (now := present(value)) is not None and not value.endswith("/"):
            found[f"file {value}"] = now
    return found


def read_inputs(log: Path) -> dict[str, str]:
    """What a kernel read, by its path below the workbook or whole, with the digests that it had then.

    A file that changed between two readings has no digest that any file could have: it will be found to differ.

    Raises
    ------
    ValueError
        When the log is missing or damaged: then the inputs are unknown.
    """
    try:
        lines = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
    except (OSError, ValueError):
        lines = []
    if not lines:
        raise ValueError(
            "what the kernel read is not known: its log was removed or damaged, or the disk is full"
        )
    found: dict[str, str] = {}
    for read in lines:
        name = _name(read["path"])
        found[name] = read["digest"] if found.get(name, read["digest"]) == read["digest"] else "two"
    return {name: " ".join(filter(None, (value, _code(name, value)))) for name, value in found.items()}


def _code(name: str, wanted: str | None) -> str | None:
    """Digest of a module's code, if its bytes have the digest `wanted`; None for anything else."""
    if wanted is None or not (name.startswith(MODULES) and name.endswith(".py")):
        return None
    if wanted not in _codes:
        try:
            source = (paths.root() / name).read_bytes()
        except FileNotFoundError:
            return None
        if digest(source) != wanted:  # it changed meanwhile
            return None
        _codes[wanted] = code_digest(source)
    return _codes[wanted]


def still(name: str, before: str) -> str | None:
    """`before`, if a file or the listing of a folder is still what had it; else what it has now, None without it."""
    now = present(name)
    content, _, code = before.partition(" ")
    return before if now == content or (code and code == _code(name, now)) else now


def present(name: str) -> str | None:
    """The digest that a file, or the listing of a folder (``name/``), has now; None when there is none.

    An error of the disk is raised: what could not be read is not gone, and would be missing among a result's inputs.
    """
    path = paths.root() / name
    try:
        if name.endswith("/"):
            return digest("\n".join(sorted(os.listdir(path))).encode())
        if not path.is_file():
            return None
        stat = path.stat()
        key = (str(path), stat.st_mtime_ns, stat.st_size, stat.st_ino)
        if key not in _digests:
            _digests[key] = digest(path.read_bytes())
        return _digests[key]
    except ValueError:  # no path, such as a text with a null
        return None
    except OSError as error:
        if error.errno in ABSENT:
            return None
        raise


def present_again(before: dict[str, str]) -> dict[str, str]:
    """Of the inputs that a build saw, those that are known only after it, as they are now."""
    found = {}
    for name in before:
        if name.startswith(LEDGER):
            continue
        if not name.startswith(KNOWN_BEFORE) and (now := still(name, before[name])) is not None:
            found[name] = now
    entries: dict[str, str] = {}
    for topic in {name.removeprefix(LEDGER).partition(".")[0] for name in before if name.startswith(LEDGER)}:
        entries |= ledger_inputs(topic)
    return found | {name: entries[name] for name in before if name in entries}


def with_ledger(reads: dict[str, str], claimed: set[str]) -> dict[str, str]:
    """`reads` with the ledger's entries in place of its files: those that the notebook claims.

    All of a topic's entries where a module that it imported takes published values from the ledger by itself.
    """
    topics = {found[1] for name in reads if (found := re.fullmatch(r"data/(\w+)/published\.toml", name))}
    kept = {
        name: value
        for name, value in reads.items()
        if name not in {f"data/{r}/published.toml" for r in topics}
    }
    takes = any(_takes_published_values(name) for name in kept)
    for topic in topics:
        for name, value in ledger_inputs(topic).items():
            if takes or name.removeprefix(LEDGER) in claimed or "." not in name:
                kept[name] = value
    return kept


def _takes_published_values(name: str) -> bool:
    if not name.endswith(".py") or Path(name).name in ("claims.py", "page.py"):
        return False
    return b"load_entries" in (paths.root() / name).read_bytes()


def changes(before: dict[str, str], now: dict[str, str]) -> list[str]:
    """One reason for each input that differs."""
    reasons = []
    for name in [*now, *(name for name in before if name not in now)]:
        if name not in before:
            reasons.append(f"{name} added")
        elif name not in now:
            reasons.append(f"{name} removed")
        elif before[name] != now[name]:
            shown = f"{before[name]} -> {now[name]}" if name.startswith(VALUES) else "changed"
            space = ": " if name.startswith("parameter ") else " "
            reasons.append(f"{name}{space}{shown}")
    if len(reasons) > 1:  # a cell that came or went moved the order, too
        reasons = [reason for reason in reasons if not reason.startswith("order of the cells")]
    return reasons


def ledger_inputs(topic: str) -> dict[str, str]:
    """A digest of every entry of a topic; of the whole file where it is malformed."""
    try:
        return dict(_entries(topic, paths.data(topic, "published.toml").read_bytes()))
    except FileNotFoundError:
        return {}


@lru_cache(maxsize=32)  # needed by every notebook of a topic; parsing takes 20 ms
def _entries(topic: str, text: bytes) -> dict[str, str]:
    try:
        tree = tomllib.loads(text.decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError):  # the notebooks will report what is wrong with it
        return {f"{LEDGER}{topic}": digest(text)}
    found = {}

    def walk(branch, path):
        if not isinstance(branch, dict) or "place" in branch:
            found[f"{LEDGER}{'.'.join(path)}"] = digest(json.dumps(branch, default=str).encode())
        else:
            for name, twig in branch.items():
                walk(twig, (*path, name))

    walk(tree, ())
    return found


def _name(path: str) -> str:
    """Below the workbook's folder relative to it; a folder keeps the slash at its end."""
    slash = "/" if path.endswith("/") else ""
    try:
        return Path(path).relative_to(paths.root()).as_posix() + slash
    except ValueError:
        return path
