"""Results appear whole or not at all: written beside their place, then renamed."""

import os
import shutil
from pathlib import Path


def replace_folder(target: Path, files: dict[str, bytes]) -> None:
    """Make `target` hold exactly `files`; until the last rename the old content stands untouched."""
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


def _beside(target: Path, suffix: str) -> Path:
    return target.with_name(f".{target.name}.{suffix}")
