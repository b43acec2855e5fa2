"""Builds under other processors' settings, and one table of what differs from what is committed.

Each simulated processor replaces the pins by its own choices (`workbook.pinned`): numpy's kernels,
OpenBLAS's, the C library's, and the instructions that numba may use. What then still agrees, agrees on a machine
that is not pinned at all.
"""

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from stillwork.base.checks import InputError
from workbook import paths
from workbook.compare import Comparison, compare
from workbook.lock import run_whole
from workbook.notebooks import select
from workbook.pinned import OTHER
from workbook.tasks import BUILT, tasks

NUMPY, BLAS, LIBC = "NPY_DISABLE_CPU_FEATURES", "OPENBLAS_CORETYPE", "GLIBC_TUNABLES"
WIDE = "X86_V4,AVX512_ICL,AVX512_SPR"


@dataclass(frozen=True)
class Processor:
    """A simulated processor: the settings that differ from the pins, and the flags that the machine needs to run it."""

    name: str
    settings: dict[str, str]
    needs: tuple[str, ...] = ()


PROCESSORS = (
    Processor(
        "2004, SSE2 alone",
        {BLAS: "Prescott", LIBC: "glibc.cpu.hwcaps=-AVX,-AVX2,-FMA,-FMA4", "NUMBA_CPU_NAME": "generic"}
        | {"NUMBA_CPU_FEATURES": "+sse2"},
    ),
    Processor(
        "2011, AVX (Sandy Bridge)",
        {BLAS: "Sandybridge", LIBC: "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4", "NUMBA_CPU_NAME": "sandybridge"}
        | {"NUMBA_CPU_FEATURES": "+sse4.2,+avx"},
        ("avx",),
    ),
    Processor(
        "2013, AVX2 (Haswell)",
        {BLAS: "Haswell", NUMPY: WIDE, LIBC: "", "NUMBA_CPU_NAME": "haswell"}
        | {"NUMBA_CPU_FEATURES": "+sse4.2,+avx,+avx2,+fma,+bmi,+bmi2"},
        ("avx2", "fma"),
    ),
    Processor(
        "2019, AVX2 (Zen 2)",
        {BLAS: "Zen", NUMPY: WIDE, LIBC: "", "NUMBA_CPU_NAME": "znver2"}
        | {"NUMBA_CPU_FEATURES": "+sse4.2,+avx,+avx2,+fma,+bmi,+bmi2"},
        ("avx2", "fma"),
    ),
    Processor(
        "2017, AVX-512 (Skylake-X)",
        {BLAS: "SkylakeX", NUMPY: "", LIBC: "", "NUMBA_CPU_NAME": "skylake-avx512"},
        ("avx512f", "avx512dq", "avx512bw", "avx512vl", "avx512cd"),
    ),
    Processor("this machine, nothing held", {BLAS: "", NUMPY: "", LIBC: ""}),
)

SAMPLED = ("2011, AVX (Sandy Bridge)", "2013, AVX2 (Haswell)")


def sampled() -> tuple[str, ...]:
    """Notebooks that pyproject.toml names: quick ones that were seen to move, or whose subject is rounding."""
    return tuple(paths.own_settings().get("sample", ()))


def portable(targets: Sequence[str] = (), processor: str = "", sample: bool = False) -> int:
    """Build under each simulated processor that runs here and print the table; returns the exit code.

    It is 0 when all agrees, 1 when something moved or failed or none runs, 128 + signal when interrupted.

    Parameters
    ----------
    targets : sequence of str
        Topics and notebooks; all without any.
    processor : str
        Only processors with this in their name.
    sample : bool
        Without targets, a few notebooks under two simulated processors.

    Raises
    ------
    InputError
        When there is no such processor, topic or notebook.
    """
    chosen = [
        each
        for each in PROCESSORS
        if processor in each.name and (processor or not sample or each.name in SAMPLED)
    ]
    if not chosen:
        names = "; ".join(each.name for each in PROCESSORS)
        raise InputError(f"no simulated processor is named {processor!r}; give part of: {names}")
    names = tuple(each.name for each in select(*(targets or (sampled() if sample else ()))))
    flags = _flags()
    rows, moved, failed = [], [], False
    for stand_in in chosen:
        if missing := [flag for flag in stand_in.needs if flag not in flags]:
            rows.append((stand_in.name, f"not run: this machine lacks {', '.join(missing)}"))
            continue
        found, code = _build(stand_in, names)
        if code > 128:  # interrupted
            return code
        failed |= bool(code)
        rows.append((stand_in.name, *_row(found)))
        moved += [(stand_in.name, each) for each in found if not each.agrees]
    _print(rows)
    for name, each in moved:
        what = (*each.files, *each.cells, *each.claims, *each.verdicts)
        print(f"{name}: {each.notebook}: {', '.join(what)}")
    ran = sum(len(row) > 2 for row in rows)
    told = "not all agree" if moved or failed else "all agree" if ran else "nothing was compared"
    print(f"{ran} of {len(rows)} processors ran: {told}")
    return int(bool(moved) or failed or not ran)


def _build(processor: Processor, names: tuple[str, ...]) -> tuple[list[Comparison], int]:
    """How the results compare, and the exit code of the build, which prints its own messages."""
    folder = paths.root() / "build" / "portable" / "".join(c if c.isalnum() else "-" for c in processor.name)
    variables = {
        **os.environ,
        OTHER: " ".join(f"{name}={value}" for name, value in processor.settings.items()),
        BUILT: str(folder),
    }
    print(f"{processor.name}: building", flush=True)
    command = [sys.executable, "-m", "workbook", "figures", *names]
    code = run_whole(command, env=variables)
    if code > 128:
        return [], code
    os.environ[BUILT] = str(folder)
    try:
        return [compare(task) for task in tasks(*names) if task.executed.is_file()], code
    finally:
        del os.environ[BUILT]


def _row(found: list[Comparison]) -> tuple[str, ...]:
    pictures = sum(each.pictures for each in found)
    return (
        str(len(found)),
        f"{sum(len(each.files) for each in found)} of {pictures}",
        f"{max((each.worst for each in found), default=0.0):.0e}",
        str(sum(len(each.cells) for each in found)),
        str(sum(len(each.claims) for each in found)),
        str(sum(len(each.verdicts) for each in found)),
    )


def _print(rows: list[tuple[str, ...]]) -> None:
    head = (
        "processor",
        "notebooks",
        "figures apart",
        "worst",
        "outputs apart",
        "values moved",
        "verdicts moved",
    )
    whole = [row for row in [head, *rows] if len(row) == len(head)]
    widths = [max(len(row[i]) for row in whole) for i in range(len(head))]
    widths[0] = max(len(row[0]) for row in [head, *rows])
    for row in [head, *rows]:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=False)).rstrip())


def _flags() -> set[str]:
    """What this machine's processor can do, as Linux names it."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return set()
    return {flag for line in text.splitlines() if line.startswith("flags") for flag in line.split()}
