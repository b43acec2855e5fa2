"""Results appear whole or not at all: written beside their place, then put in it by one step."""

import contextlib
import errno
import hashlib
import json
import os
import shutil
import stat
import uuid
from itertools import count
from pathlib import Path
from typing import NoReturn

from stillwork.base.checks import InputError

RECORD, MANIFEST = "record.json", "manifest.json"

# What an error says of a path that holds no file. Any other (too many open files, a disk that fails) says nothing of it.
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
        When the disk does not say.
    """
    if (text := _content(target / RECORD)) is None:
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
    record = _unsealed(_content(target / RECORD), "seconds")
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
    """Make `target` a plain folder of exactly `files`, for what is copied elsewhere as it stands.

    Between two renames a kill may leave no folder there: the next call, whatever becomes of it, puts the old one back.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    new, old = _beside(target, "new"), _beside(target, "old")
    if old.exists() and not target.exists():
        old.rename(target)
    for left in (new, old):
        if left.exists():
            shutil.rmtree(left)
    try:
        for name, content in files.items():
            _write(new / name, content)
    except BaseException:
        shutil.rmtree(new, ignore_errors=True)
        raise
    if target.exists():
        target.rename(old)
    new.rename(target)
    shutil.rmtree(old, ignore_errors=True)


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
    """Change many files below `root` as one, unless somebody else has changed one of them.

    All are written beside, and are on the disk, before the first is put in its place. A kill before that leaves
    everything as it was. After it, `finish` does the rest; whoever reads or writes these files calls it first
    (`workbook.lock`).

    What stands in a place is looked at until just before it is replaced, and kept until all is done: where it is not
    what it should be, all that was put in its place is taken back, and what somebody wrote is left, or put back.
    What remains: a file that an editor makes or renames into a place in the microseconds between the last look and
    our own rename is replaced unseen, and one that an editor opened before may be written to when all is done.

    Parameters
    ----------
    root : Path
    changed : dict of str to (bytes or None, bytes or None)
        By path below `root`, what must stand there and what shall; None for no file.

    Raises
    ------
    OSError
        When nothing was changed.
    Edited
        When somebody else changed a file, and nothing of this stands.
    InputError
        When it was decided, but not all could be put in its place.
    """
    new, decided = _journal(root)
    planned = {name: [_digest(before), _digest(after)] for name, (before, after) in sorted(changed.items())}
    if others := [name for name, (before, _) in planned.items() if _state(root / name) != before]:
        raise Edited(others)
    try:
        shutil.rmtree(new, ignore_errors=True)
        for name, (before, after) in changed.items():
            if after is not None:
                _write(new / "new" / name, after)
                with contextlib.suppress(FileNotFoundError, NotADirectoryError):
                    shutil.copymode(root / name, new / "new" / name)
            if before is not None:
                _keep(root, name, new / "old")
        _write(new / MANIFEST, _sealed({"files": planned}))
        for place, _, names in os.walk(new, onerror=_raise):
            for each in (*names, "."):
                _flush(Path(place, each))
        new.rename(decided)
    except BaseException as error:
        if not isinstance(error, OSError) or not unfinished(
            root
        ):  # else it is decided, whatever the rename says
            shutil.rmtree(new, ignore_errors=True)
            raise
    if others := _carry_out(root):
        raise Edited(others)


class Edited(InputError):
    """Somebody else changed what was to be replaced."""

    def __init__(self, names: list[str]):
        super().__init__(f"changed while accepting: {_listed(names)}; nothing was written, repeat")


def finish(root: Path) -> None:
    """Do what is left of a `replace_all` that was decided and then cut short; remove one that was not decided.

    Raises
    ------
    InputError
        When a file cannot be put in its place (the next call tries again); when one was changed since, for which
        all is taken back; when the journal is damaged, which is then set aside.
    """
    if unfinished(root) and (others := _carry_out(root)):
        raise InputError(
            f"an accept that was cut short is taken back, as these were changed since: {_listed(others)}; "
            "repeat the command, and the accept when you want it"
        )
    for left in (_journal(root)[0], trial(root)):
        shutil.rmtree(left, ignore_errors=True)


def _carry_out(root: Path) -> list[str]:
    """Put what was decided in its place, or take it back for what others changed; returns the names of that."""
    new, decided = _journal(root)
    try:
        _flush(root)
        record = _unsealed(_content(decided / MANIFEST), "files")
        if record is None:
            _set_aside(decided, MANIFEST)
        if others := _put(root, record["files"]):
            _take_back(root, record["files"])
        for folder in {folder for name in record["files"] for folder in Path(name).parents}:
            _flush(root / folder)
        shutil.rmtree(new, ignore_errors=True)
        decided.rename(new)  # done: what is removed piece by piece must not be taken for a journal
        shutil.rmtree(new, ignore_errors=True)
    except OSError as error:
        raise InputError(
            f"accepted, but not all of it is in its place ({error}); repair that and repeat the command"
        ) from None
    return others


def _put(root: Path, planned: dict[str, list]) -> list[str]:
    """Put all in its place; returns the names of what stands in the way, or came in between."""
    decided = _journal(root)[1]
    others = [
        name
        for name, (before, after) in planned.items()
        if (state := _state(root / name)) not in (before, after)
        or (state == before and after not in (None, _state(decided / "new" / name)))
    ]
    if others:
        return others
    for name, (before, after) in planned.items():
        target = root / name
        try:
            if after is not None:
                target.parent.mkdir(parents=True, exist_ok=True)
        except FileExistsError:  # somebody's file in the place of a folder
            return [name]
        seen = _stamp(target)
        if (state := _state(target)) == after:
            continue
        if state != before or _stamp(target) != seen:
            return [name]
        if after is None:
            target.unlink()
        else:
            os.replace(decided / "new" / name, target)
    kept = {name: before for name, (before, _) in planned.items() if before is not None}
    return [name for name, before in kept.items() if _state(decided / "old" / name) not in (before, None)]


def _take_back(root: Path, planned: dict[str, list]) -> None:
    """Put back what stood in each place, apart from what others have put there since."""
    decided = _journal(root)[1]
    for name, (before, after) in planned.items():
        if before is not None and _state(root / name) == after and _state(decided / "old" / name) is None:
            _set_aside(decided, f"old/{name}")
    for name, (before, after) in planned.items():
        if _state(root / name) != after:
            continue
        if before is not None:
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            os.replace(decided / "old" / name, root / name)
            continue
        (root / name).unlink()
        with contextlib.suppress(OSError):  # not empty
            for folder in Path(name).parents:
                (root / folder).rmdir()


def _listed(names: list[str]) -> str:
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")


def _set_aside(decided: Path, lacking: str) -> NoReturn:
    names = (decided.with_name(f"{decided.name}.damaged{number or ''}") for number in count())
    aside = next(name for name in names if not name.exists())
    decided.rename(aside)
    raise InputError(
        f"an accept was cut short, and its journal is damaged ({lacking}): it is set aside as {aside.name}/. `git "
        "status` shows what the accept wrote: `make accept` writes all of it, `git restore` takes it back. Then "
        f"remove {aside.name}/, and repeat the command"
    )


def trial(root: Path) -> Path:
    """Folder where accepting tries the change; `finish` removes it."""
    return root / ".accepting.trial"


def unfinished(root: Path) -> bool:
    """Whether a `replace_all` was decided and then cut short."""
    mode = _mode(_journal(root)[1])
    return mode is not None and stat.S_ISDIR(mode)


def leftovers(root: Path) -> bool:
    """Whether something lies about that `finish` removes."""
    return _journal(root)[0].exists() or trial(root).exists()


def _journal(root: Path) -> tuple[Path, Path]:
    return root / ".accepting.new", root / ".accepting"  # not below build/, which may be on another disk


def digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _digest(content: bytes | None) -> str | None:
    return None if content is None else digest(content)


def _raise(error: OSError) -> NoReturn:
    raise error


def _content(file: Path) -> bytes | None:
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
    return None if _mode(file) is None else _digest(_content(file)) or ""


def _stamp(file: Path) -> tuple[int, ...] | None:
    """What changes with every change of a file."""
    try:
        found = os.stat(file)
    except OSError as error:
        if error.errno in NO_FILE:
            return None
        raise
    return found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns


def _write(file: Path, content: bytes) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(content)


def _keep(root: Path, name: str, folder: Path) -> None:
    """Give a file a second name, through which what is written to it later is seen, too."""
    beside = folder / name
    beside.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(os.path.realpath(root / name), beside)
    except FileNotFoundError:
        raise Edited([name]) from None
    except OSError:  # a file system without links
        beside.write_bytes((root / name).read_bytes())


def _flush(place: Path) -> None:
    """Wait until a file, or which names a folder holds, is on the disk."""
    with contextlib.suppress(FileNotFoundError, NotADirectoryError):
        descriptor = os.open(place, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


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
