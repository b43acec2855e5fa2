"""Results appear whole or not at all: written beside their place, then renamed."""

import contextlib
import hashlib
import json
import os
import shutil
from pathlib import Path

RECORD = "record.json"


def replace_record(
    target: Path, files: dict[str, bytes], inputs: dict[str, str], seconds: float | None = None
) -> None:
    """Make `target` a folder of exactly `files` and of the record that describes them.

    Parameters
    ----------
    target : Path
        Where the results are looked for.
    files : dict of str to bytes
        By path below `target`.
    inputs : dict of str to str
        What they were made from, by name, as a value or a digest.
    seconds : float, optional
        How long it took to make them.
    """
    outputs = {name: digest(content) for name, content in files.items()}
    record = {"inputs": inputs, "outputs": outputs, "seconds": seconds}
    replace_folder(target, {**files, RECORD: json.dumps(record, indent=1).encode()})


def read_record(target: Path) -> tuple[dict[str, str], list[str]] | None:
    """What the results in `target` were made from, and what of them is not as it was written.

    Returns
    -------
    (inputs, complaints) or None
        None where nothing was built.
    """
    if not target.is_dir():
        return None
    if (text := content_of(target / RECORD)) is None:
        return {}, ["its record is missing"]
    try:
        record = json.loads(text)
        inputs, outputs = dict(record["inputs"]), dict(record["outputs"])
    except (ValueError, TypeError, KeyError, RecursionError):
        return {}, ["its record is damaged"]
    complaints = []
    there = {path.relative_to(target).as_posix() for path in target.rglob("*") if not path.is_dir()} - {
        RECORD
    }
    for name, wanted in outputs.items():
        if name not in there:
            complaints.append(f"output {name} missing")
        elif digest(content_of(target / name) or b"") != wanted:
            complaints.append(f"output {name} was changed by hand")
    complaints += [f"output {name} is not the build's" for name in sorted(there - set(outputs))]
    return inputs, complaints


def seconds_taken(target: Path) -> float | None:
    """How long it took to make the results in `target`, whose record is whole; None where that was not noted."""
    return json.loads((target / RECORD).read_bytes()).get("seconds")


def replace_folder(target: Path, files: dict[str, bytes]) -> None:
    """Make `target` a folder of exactly `files`; the old one stands until all is written."""
    new, old = _beside(target, "new"), _beside(target, "old")
    tidy(target)
    try:
        for name, content in files.items():
            (new / name).parent.mkdir(parents=True, exist_ok=True)
            (new / name).write_bytes(content)
        if os.path.lexists(target):
            target.rename(old)
        new.rename(target)
    finally:
        tidy(target)


def tidy(target: Path) -> None:
    """Put back the folder where it was torn from `new` by a kill, and remove what lies beside it."""
    new, old = _beside(target, "new"), _beside(target, "old")
    if os.path.lexists(old) and not os.path.lexists(target):
        old.rename(target)
    for each in (new, old):
        if each.is_symlink():
            each.unlink()
        shutil.rmtree(each, ignore_errors=True)


def replace_file(target: Path, content: bytes) -> None:
    """Write one file whole or not at all; it keeps its mode."""
    target.parent.mkdir(parents=True, exist_ok=True)
    new = _beside(target, "new")
    try:
        new.write_bytes(content)
        with contextlib.suppress(FileNotFoundError):
            shutil.copymode(target, new)
        os.replace(new, target)
    except BaseException:
        new.unlink(missing_ok=True)
        raise


def digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def content_of(file: Path) -> bytes | None:
    """None for no file, such as a link to nowhere. An error of the disk is none: it may be another the next time."""
    try:
        return file.read_bytes()
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
        return None


def _beside(target: Path, suffix: str) -> Path:
    return target.with_name(f".{target.name}.{suffix}")
