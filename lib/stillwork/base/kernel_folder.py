"""The folder that holds the kernels' machine code. Independent of numba, so that a build can use it."""

import contextlib
import os
import re
import shutil
import time
from functools import cache
from pathlib import Path

FOLDER_VARIABLE, ROOT_VARIABLE = "STILLWORK_KERNELS", "STILLWORK_ROOT"
NAME = re.compile(
    "(.*_)?[0-9a-f]{16}"
)  # of what a file's kernels are kept in, and of what earlier versions left
KEPT = 7 * 24 * 3600  # s, without use


def cache_folder() -> str:
    """Folder for the machine code of all kernels, in the workbook that ``STILLWORK_ROOT`` names or in this checkout.

    ``STILLWORK_KERNELS`` names another one. Empty, which is numba's rule, where there is no workbook to write to.
    """
    return os.environ.get(FOLDER_VARIABLE) or _folder_of_workbook()


@cache
def _folder_of_workbook() -> str:
    root = Path(os.environ.get(ROOT_VARIABLE) or Path(__file__).parents[3])
    folder = root / "build" / "kernels"
    try:
        if not (root / "data").is_dir():
            return ""
        folder.mkdir(parents=True, exist_ok=True)
        _remove_unused(folder)
    except OSError:
        return ""
    return str(folder)


def _remove_unused(every: Path) -> None:
    """Remove the machine code that was not used for a week; who still runs it has it in memory."""
    for each in every.iterdir():
        with contextlib.suppress(OSError):
            if NAME.fullmatch(each.stem) and time.time() - each.stat().st_mtime > KEPT:
                if each.is_dir():
                    shutil.rmtree(each, ignore_errors=True)
                else:
                    each.unlink()
