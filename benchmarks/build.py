"""What a build from nothing costs: seconds of the processor and of the clock, without kept machine code.

``--beside COMMIT`` builds the same, everything or what is named, in the checkout as it was at a commit, too, in the same
environment and the same run. Processor time, which other programs disturb less than the clock; the clock counts on a
machine that has nothing else to do.
"""

import argparse
import contextlib
import io
import os
import platform
import resource
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "lib"), str(ROOT)]

from stillwork.base.checks import InputError  # noqa: E402
from workbook.notebooks import select  # noqa: E402
from workbook.tasks import BUILT  # noqa: E402


def from_nothing(root: Path, targets: Sequence[str]) -> tuple[float, float]:
    """Seconds of the processor and of the clock that a build of `targets`, or everything, takes in the checkout `root`."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as kernels:
        plain = {name: value for name, value in os.environ.items() if not name.startswith("STILLWORK")}
        places = f"{root / 'lib'}{os.pathsep}{root}"
        kept = {"NUMBA_CACHE_DIR": kernels, "STILLWORK_KERNELS": kernels}  # the latter before version 0.1.0
        under = plain | kept | {BUILT: folder, "PYTHONPATH": places}
        build = [sys.executable, "-m", "workbook", "figures", *targets]
        code = subprocess.run(build, env=under, cwd=root, stdin=subprocess.DEVNULL).returncode
    if code:
        raise SystemExit(f"the build failed with {code}: its time does not count")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return spent, time.monotonic() - begin


@contextlib.contextmanager
def checkout(commit: str) -> Iterator[Path]:
    """A folder with all that a commit holds."""
    done = subprocess.run(["git", "archive", commit], cwd=ROOT, capture_output=True)
    if done.returncode:
        raise SystemExit(f"there is no checkout of {commit!r}: {done.stderr.decode().strip()}")
    with tempfile.TemporaryDirectory() as folder:
        with tarfile.open(fileobj=io.BytesIO(done.stdout)) as whole:
            whole.extraction_filter = getattr(tarfile, "data_filter", None)  # none before Python 3.11.4
            whole.extractall(folder)
        yield Path(folder)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="*", metavar="TOPIC[/NOTEBOOK]")
    parser.add_argument("--beside", metavar="COMMIT", help="a build of this commit, too")
    options = parser.parse_args()
    try:
        select(*options.targets)
    except InputError as error:
        parser.error(str(error))
    with contextlib.ExitStack() as opened:
        roots = {"as it stands": ROOT}
        if options.beside:
            roots[options.beside] = opened.enter_context(checkout(options.beside))
        rows = {label: from_nothing(root, options.targets) for label, root in roots.items()}
    print(f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}")
    print(f"{'from nothing':40}{'processor':>11}{'clock':>9}")
    for label, (spent, clock) in rows.items():
        print(f"{label:40}{spent:11.1f}{clock:9.1f}")


if __name__ == "__main__":
    main()
