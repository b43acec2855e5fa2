"""Results appear whole or not at all: written beside their place, then put in it by one step."""

import hashlib
import json
import os
import shutil
import uuid
from pathlib import Path

from stillwork.base.checks import InputError

RECORD = "record.json"


def replace_record(target: Path, files: dict[str, bytes], inputs: dict[str, str]) -> None:
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
    """
    home = _home(target)
    new = home / uuid.uuid4().hex[:12]
    link = home / "link"
    outputs = {name: digest(content) for name, content in files.items()}
    record = _sealed({"inputs": inputs, "outputs": outputs})
    try:
        for name, content in {**files, RECORD: record}.items():
            file = new / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)
        link.unlink(missing_ok=True)
        link.symlink_to(Path(home.name, new.name))
        if target.is_dir() and not target.is_symlink():  # not ours: out of the way, and removed with the rest
            target.rename(home / uuid.uuid4().hex[:12])
        os.replace(link, target)
    except BaseException:
        shutil.rmtree(new, ignore_errors=True)
        raise
    finally:
        tidy(target)


def read_record(target: Path) -> tuple[dict[str, str], list[str]] | None:
    """What the results in `target` were made from, and what of them is not as it was written.

    Returns
    -------
    (inputs, complaints) or None
        None where nothing was built.
    """
    try:
        text = (target / RECORD).read_bytes()
    except OSError:
        return None if not target.exists() else ({}, ["its record is missing"])
    if (record := _unsealed(text)) is None:
        return {}, ["its record is damaged"]
    complaints = []
    there = {path for path in _files(target) if path != RECORD}
    for name, wanted in record["outputs"].items():
        if name not in there:
            complaints.append(f"output {name} missing")
        elif _digest_of(target / name) != wanted:
            complaints.append(f"output {name} was changed by hand")
    complaints += [f"output {name} is not the build's" for name in sorted(there - set(record["outputs"]))]
    return record["inputs"], complaints


def tidy(target: Path) -> None:
    """Remove what lies beside `target` and is not the version that it shows: older ones, and what a kill left."""
    home = _home(target)
    if home.is_dir():
        shown = os.readlink(target) if target.is_symlink() else ""
        for each in home.iterdir():
            if shown != f"{home.name}/{each.name}":
                shutil.rmtree(each) if each.is_dir() and not each.is_symlink() else each.unlink()
        if not any(home.iterdir()):
            home.rmdir()


def replace_folder(target: Path, files: dict[str, bytes]) -> None:
    """Make `target` a plain folder of exactly `files`, for what is copied elsewhere as it stands.

    Between two renames a kill may leave no folder there: `recover` puts the old one back.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    new, old = _beside(target, "new"), _beside(target, "old")
    try:
        for name, content in files.items():
            file = new / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)
    except BaseException:
        shutil.rmtree(new, ignore_errors=True)
        raise
    if target.exists():
        target.rename(old)
    new.rename(target)
    shutil.rmtree(old, ignore_errors=True)


def recover(target: Path) -> None:
    """Finish what a killed `replace_folder` left: the last good content stands, nothing lies beside it."""
    new, old = _beside(target, "new"), _beside(target, "old")
    if old.exists():
        if target.exists():
            shutil.rmtree(old)
        else:
            old.rename(target)
    if new.exists():
        shutil.rmtree(new)


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


def replace_all(root: Path, changed: dict[str, bytes | None]) -> None:
    """Change many files below `root` as one: all of them are written beside before the first is put in its place.

    A kill before that leaves everything as it was. After it, `finish` does the rest; whoever reads or writes these
    files calls it first (`stillwork.workbook.lock`).

    Parameters
    ----------
    root : Path
    changed : dict of str to bytes or None
        New content by path below `root`; None removes a file.

    Raises
    ------
    OSError
        When nothing was changed.
    InputError
        When it was decided, but not all could be put in its place.
    """
    new, decided = _journal(root)
    try:
        shutil.rmtree(new, ignore_errors=True)
        (new / "files").mkdir(parents=True)
        for name, content in changed.items():
            if content is not None:
                file = new / "files" / name
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(content)
        gone = [name for name, content in changed.items() if content is None]
        (new / "gone.json").write_text(json.dumps(gone))
        new.rename(decided)
    except BaseException:
        shutil.rmtree(new, ignore_errors=True)
        raise
    finish(root)


def finish(root: Path) -> None:
    """Do what is left of a `replace_all` that was decided and then cut short; remove one that was not decided.

    Raises
    ------
    InputError
        When a file cannot be put in its place; the next call tries again.
    """
    new, decided = _journal(root)
    if decided.is_dir():
        try:
            for name in sorted(_files(decided / "files")):
                target = root / name
                target.parent.mkdir(parents=True, exist_ok=True)
                os.replace(decided / "files" / name, target)
            for name in json.loads((decided / "gone.json").read_text()):
                (root / name).unlink(missing_ok=True)
            shutil.rmtree(new, ignore_errors=True)
            decided.rename(new)  # done: what is removed piece by piece must not be taken for a journal
        except OSError as error:
            raise InputError(
                f"accepted, but not all of it is in its place ({error}); mend that and repeat the command"
            ) from None
    for left in (new, trial(root)):
        shutil.rmtree(left, ignore_errors=True)


def trial(root: Path) -> Path:
    """Folder where accepting tries the change; `finish` removes it."""
    return root / ".accepting.trial"


def unfinished(root: Path) -> bool:
    """Whether a `replace_all` was decided and then cut short."""
    return _journal(root)[1].is_dir()


def _journal(root: Path) -> tuple[Path, Path]:
    return root / ".accepting.new", root / ".accepting"  # not below build/, which may be on another disk


def digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _digest_of(file: Path) -> str | None:
    """None for what cannot be read, such as a link to nowhere."""
    try:
        return digest(file.read_bytes())
    except OSError:
        return None


def _beside(target: Path, suffix: str) -> Path:
    return target.with_name(f".{target.name}.{suffix}")


def _home(target: Path) -> Path:
    return target.with_name(f".{target.name}")


def _files(folder: Path) -> set[str]:
    found = set()
    for place, _, names in os.walk(folder):
        found |= {Path(place, name).relative_to(folder).as_posix() for name in names}
    return found


def _sealed(record: dict) -> bytes:
    return json.dumps({**record, "seal": _seal(record)}, indent=1).encode()


def _unsealed(text: bytes) -> dict | None:
    """The record that was sealed; None when a byte of it is another."""
    try:
        record = json.loads(text)
        seal = record.pop("seal")
    except (ValueError, TypeError, AttributeError, KeyError, RecursionError):
        return None
    return record if seal == _seal(record) and {"inputs", "outputs"} <= set(record) else None


def _seal(record: dict) -> str:
    return digest(json.dumps(record, sort_keys=True).encode())
