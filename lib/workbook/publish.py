"""Results appear whole or not at all: written beside their place, then put in it by one step."""

import contextlib
import errno
import hashlib
import json
import os
import shutil
import uuid
from pathlib import Path
from typing import NoReturn

from workbook.checks import InputError

RECORD = "record.json"

# Errors that mean that a path holds no file. Others (too many open files, a failing disk) do not.
NO_FILE = (errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.ELOOP)


def replace_record(
    target: Path, files: dict[str, bytes], inputs: dict[str, str], seconds: float | None = None
) -> None:
    """Make `target` a folder of exactly `files` and of the record that describes them.

    The folder itself stands hidden beside `target`, under a name of its own; `target` is a link to it, which one
    step moves from the last version to this one. Until then the last version stands, after it this one: a reader
    never sees a part.

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
    home = _home(target)
    new = home / uuid.uuid4().hex[:12]
    link = home / "link"
    outputs = {name: digest(content) for name, content in files.items()}
    record = _sealed({"inputs": inputs, "outputs": outputs, "seconds": seconds})
    try:
        for name, content in {**files, RECORD: record}.items():
            _write(new / name, content)
        link.unlink(missing_ok=True)
        link.symlink_to(Path(home.name, new.name))
        if target.is_dir() and not target.is_symlink():  # not ours: out of the way, and removed with the rest
            target.rename(home / uuid.uuid4().hex[:12])
        os.replace(link, target)
    except OSError:
        if not _shows(target, new):
            raise
    finally:
        tidy(target)


def read_record(target: Path) -> tuple[dict[str, str], list[str]] | None:
    """What the results in `target` were made from, and what of them is not as it was written.

    Returns
    -------
    (inputs, complaints) or None
        None where nothing was built.

    Raises
    ------
    OSError
        When the disk cannot be read.
    """
    if (text := content_of(target / RECORD)) is None:
        return None if _mode(target) is None else ({}, ["its record is missing"])
    if (record := _unsealed(text, "inputs", "outputs")) is None:
        return {}, ["its record is damaged"]
    complaints = []
    there = {path for path in _files(target) if path != RECORD}
    for name, wanted in record["outputs"].items():
        if name not in there:
            complaints.append(f"output {name} missing")
        elif _state(target / name) != wanted:
            complaints.append(f"output {name} was changed by hand")
    complaints += [f"output {name} is not the build's" for name in sorted(there - set(record["outputs"]))]
    return record["inputs"], complaints


def seconds_taken(target: Path) -> float | None:
    """How long it took to make the results in `target`; None where that is not known."""
    record = _unsealed(content_of(target / RECORD), "seconds")
    return record and record["seconds"]


def tidy(target: Path) -> None:
    """Remove what lies beside `target` and is not the version that it shows: older ones, and what a kill left.

    What cannot be removed stays for the next time.
    """
    home = _home(target)
    with contextlib.suppress(OSError):
        for each in home.iterdir() if home.is_dir() else ():
            if not _shows(target, each):
                shutil.rmtree(each) if each.is_dir() and not each.is_symlink() else each.unlink()
        home.rmdir()  # an error where one version is shown


def _shows(target: Path, version: Path) -> bool:
    """Whether `target` is the link to a version."""
    try:
        return os.readlink(target) == f"{version.parent.name}/{version.name}"
    except OSError as error:
        if error.errno in (*NO_FILE, errno.EINVAL):  # no link
            return False
        raise


def replace_folder(target: Path, files: dict[str, bytes]) -> None:
    """Make `target` a plain folder of exactly `files`, for what is copied elsewhere as it stands; the old one stands until
    all is written.
    """
    new = _beside(target, "new")
    shutil.rmtree(new, ignore_errors=True)
    try:
        for name, content in files.items():
            _write(new / name, content)
    except BaseException:
        shutil.rmtree(new, ignore_errors=True)
        raise
    shutil.rmtree(target, ignore_errors=True)
    new.rename(target)


def replace_file(target: Path, content: bytes) -> None:
    """Write one file whole or not at all."""
    target.parent.mkdir(parents=True, exist_ok=True)
    new = _beside(target, "new")
    try:
        new.write_bytes(content)
        os.replace(new, target)
    except BaseException:
        new.unlink(missing_ok=True)
        raise


def replace_all(root: Path, changed: dict[str, tuple[bytes | None, bytes | None]]) -> None:
    """Change many files below `root` as one, unless another process has changed one of them.

    All are written beside their places, and what stands in these is looked at again, before the first is put in its own:
    a full disk, or an editor that saved meanwhile, changes nothing. Only a kill or an error within the milliseconds of the
    renames leaves some old and some new: the same change again writes the rest, and `git restore` takes it back.

    Parameters
    ----------
    root : Path
    changed : dict of str to (bytes or None, bytes or None)
        By path below `root`, what must stand there and what shall; None for no file.

    Raises
    ------
    OSError
        When the disk refuses; nothing was changed.
    Edited
        When another process changed a file; then none was changed.
    InputError
        When the disk refuses a rename, with some done.
    """
    new = {
        name: _beside(root / name, "accepting") for name, (_, after) in changed.items() if after is not None
    }
    try:
        for name, beside in new.items():
            _write(beside, changed[name][1])
            with contextlib.suppress(FileNotFoundError):
                shutil.copymode(root / name, beside)
        if others := [
            each for each, (before, _) in sorted(changed.items()) if content_of(root / each) != before
        ]:
            raise Edited(others)
    except BaseException:
        for name, beside in new.items():
            with contextlib.suppress(OSError):  # a folder that holds something stays
                beside.unlink(missing_ok=True)
                for folder in [*Path(name).parents][:-1]:
                    (root / folder).rmdir()
        raise
    try:
        for name in changed:
            if name in new:
                os.replace(new[name], root / name)
            else:
                (root / name).unlink(missing_ok=True)
    except OSError as error:
        raise InputError(
            f"accepted in part, as the disk refuses more ({error}): `make accept` writes the rest, "
            "`git restore` takes it back"
        ) from None


class Edited(InputError):
    """Another process changed what was to be replaced."""

    def __init__(self, names: list[str]):
        shown = ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
        super().__init__(f"changed while accepting: {shown}; nothing was written, repeat")


def digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _raise(error: OSError) -> NoReturn:
    raise error


def content_of(file: Path) -> bytes | None:
    """None for no file, such as a link to nowhere. An error of the disk is none: it may be another the next time."""
    try:
        return file.read_bytes()
    except OSError as error:
        if error.errno in NO_FILE:
            return None
        raise


def _mode(path: Path) -> int | None:
    """Kind of what stands there, a link as itself; None for nothing."""
    try:
        return os.lstat(path).st_mode
    except OSError as error:
        if error.errno in NO_FILE:
            return None
        raise


def _state(file: Path) -> str | None:
    """Digest of what stands there: None for nothing, empty for what is no file."""
    if _mode(file) is None:
        return None
    return "" if (content := content_of(file)) is None else digest(content)


def _write(file: Path, content: bytes) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(content)


def _beside(target: Path, suffix: str) -> Path:
    return target.with_name(f".{target.name}.{suffix}")


def _home(target: Path) -> Path:
    return target.with_name(f".{target.name}")


def _files(folder: Path) -> set[str]:
    found = set()
    for place, _, names in os.walk(folder, onerror=_raise):
        found |= {Path(place, name).relative_to(folder).as_posix() for name in names}
    return found


def _sealed(record: dict) -> bytes:
    return json.dumps({**record, "seal": _seal(record)}, indent=1).encode()


def _unsealed(text: bytes | None, *keys: str) -> dict | None:
    """The record that was sealed; None when there is none, or a byte of it is another."""
    try:
        record = json.loads(text)
        seal = record.pop("seal")
    except (ValueError, TypeError, AttributeError, KeyError, RecursionError):
        return None
    return record if seal == _seal(record) and set(keys) <= set(record) else None


def _seal(record: dict) -> str:
    return digest(json.dumps(record, sort_keys=True).encode())
