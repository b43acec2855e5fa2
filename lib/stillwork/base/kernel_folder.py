"""The folder that holds the kernels' machine code. Knows nothing of numba, so that a build can ask for it."""

import contextlib
import hashlib
import os
import re
import shutil
import time
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from stillwork.base.source_digest import code_digest

try:
    import fcntl
except ImportError:  # not a Unix: a folder counts as used by its time alone
    fcntl = None  # type: ignore[assignment]

FOLDER_VARIABLE, ROOT_VARIABLE = "STILLWORK_KERNELS", "STILLWORK_ROOT"
PACKAGES = ("stillwork", "workbook", "experiments")  # those beside each other that have kernels
NAME = re.compile("[0-9a-f]{16}")
KEPT = 7 * 24 * 3600  # s, without use


def cache_folder() -> str:
    """Folder for the machine code of the kernels as they are written now.

    Numba's own rule looks at the file of a kernel, not at those of the kernels it calls: after a change of one
    of these it would go on with the old code. So the folder's name is a digest of the code (`code_digest`) of every
    file that has kernels, which all import what makes them from `stillwork.base`.
    Who starts many processes asks once and hands the answer on in ``STILLWORK_KERNELS``. Empty, which is numba's
    rule, where there is no workbook to write to.
    """
    folder = os.environ.get(FOLDER_VARIABLE) or _folder_by_content()
    if folder:
        _use(folder)
    return folder


@cache
def kernels_digest() -> str:
    """Digest of the code of every file that has kernels: machine code follows from kernels that it calls, too.

    The name of the folder that was handed on, where one was: then no folder is searched.
    """
    if handed := os.environ.get(FOLDER_VARIABLE):
        return Path(handed).name
    library = Path(__file__).parents[2]
    files = sorted(each for package in PACKAGES for each in (library / package).rglob("*.py"))
    texts = [text for file in files if b"stillwork.base.kernel" in (text := file.read_bytes())]
    name, known = "", None
    # To parse them takes a quarter of a second, so what it gave is kept.
    with contextlib.suppress(OSError, UnicodeDecodeError):
        known = _every_folder() / f"{_digest(texts)}.code"
        name = known.read_text()
    if not NAME.fullmatch(name):
        name = _digest(code_digest(text).encode() for text in texts)
        if known and known.parent.is_dir():
            with contextlib.suppress(OSError):
                known.write_text(name)
    return name


def _every_folder() -> Path:
    """What holds the folders of all digests: in the workbook that ``STILLWORK_ROOT`` names, or in this checkout."""
    root = Path(os.environ.get(ROOT_VARIABLE) or Path(__file__).parents[3])
    if not (root / "data").is_dir():
        raise FileNotFoundError(f"no workbook at {root}")
    return root / "build" / "kernels"


@cache
def _folder_by_content() -> str:
    try:
        folder = _every_folder() / kernels_digest()
        if not folder.exists():
            folder.mkdir(parents=True, exist_ok=True)
            _remove_unused(folder.parent)
    except OSError:
        return ""
    return str(folder)


def _digest(texts: Iterable[bytes]) -> str:
    return hashlib.sha256(b"\0".join(texts)).hexdigest()[:16]


@cache
def _use(folder: str) -> None:
    """Mark the folder as used now, and as in use while this process lives."""
    with contextlib.suppress(OSError):
        os.utime(folder)
        if fcntl is not None:
            fcntl.flock(os.open(folder, os.O_RDONLY), fcntl.LOCK_SH | fcntl.LOCK_NB)


def _remove_unused(every: Path) -> None:
    """Remove the folders of other digests that were not used for a week and are not in use, and what led there."""
    for each in every.iterdir():
        if not NAME.fullmatch(each.stem):
            continue
        with contextlib.suppress(OSError):
            if time.time() - each.stat().st_mtime > KEPT:
                if each.suffix == ".code":
                    each.unlink()
                elif not _in_use(each):
                    shutil.rmtree(each, ignore_errors=True)


def _in_use(folder: Path) -> bool:
    if fcntl is None:
        return False
    opened = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # held by another process, or no locks here: rather keep it
        return True
    finally:
        os.close(opened)
    return False
