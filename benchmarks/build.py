"""Where a build's processor time goes: imports, compilation, computing, drawing, saving, and the runner around them.

First every notebook's code runs in a process of its own, under the settings of a build, with a watch on each kind of
work. Then, unless topics or notebooks are named, everything is built from nothing into a folder that is thrown away;
what that costs beyond the notebooks' own work is the runner's. Either begins without machine code, and a kernel that
several notebooks call is compiled in the first of them. Processor time, which other programs disturb less
than the clock; the clock counts on a machine that has nothing else to do.

``--beside COMMIT`` builds instead everything, or what is named, from nothing in the checkout as it stands and as it was
at a commit, in the same environment and the same run.

``--pins`` measures instead what the pins of the processor (`pinned.env`) cost: the same notebooks, by default the
sample of `make portable`, with all of them, without each one and without any, in turn.
"""

import argparse
import builtins
import contextlib
import io
import json
import os
import platform
import resource
import statistics
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "lib"), str(ROOT)]

from stillwork.base.checks import InputError  # noqa: E402
from stillwork.base.kernel_folder import FOLDER_VARIABLE  # noqa: E402
from workbook.lock import run_whole  # noqa: E402
from workbook.notebooks import read_notebook, select  # noqa: E402
from workbook.pinned import environment  # noqa: E402
from workbook.portable import BLAS, LIBC, NUMPY, sampled  # noqa: E402
from workbook.tasks import BUILT  # noqa: E402

PROCESSOR_S, CLOCK_S = 375, 200  # what a build from nothing is to take at most; the clock's on two cores

KINDS = ("imports", "compile", "compute", "draw", "save")
WITHOUT = {
    "none": (),
    "numpy": (NUMPY,),
    "OpenBLAS": (BLAS,),
    "C library": (LIBC,),
    "all": (NUMPY, BLAS, LIBC),
}


class Watch:
    """Processor seconds by kind of work; of nested work the innermost kind counts."""

    def __init__(self):
        self.seconds = dict.fromkeys(KINDS, 0.0)
        self._kinds = ["compute"]
        self._since = time.process_time()

    def enter(self, kind: str) -> None:
        self._count()
        self._kinds.append(kind)

    def leave(self) -> None:
        self._count()
        self._kinds.pop()

    def around(self, kind: str, function):
        def timed(*arguments, **options):
            self.enter(kind)
            try:
                return function(*arguments, **options)
            finally:
                self.leave()

        return timed

    def _count(self) -> None:
        now = time.process_time()
        self.seconds[self._kinds[-1]] += now - self._since
        self._since = now


def measure(name: str) -> dict[str, float]:
    """Run a notebook's code cells in this process; call it in one that does nothing else."""
    watch = Watch()
    plain = builtins.__import__
    builtins.__import__ = watch.around("imports", plain)
    from matplotlib.figure import Figure
    from numba.core import event

    from workbook import page

    class Compilation(event.Listener):
        def on_start(self, _event):
            watch.enter("compile")

        def on_end(self, _event):
            watch.leave()

    event.register("numba:compile", Compilation())
    page.save = watch.around("save", page.save)
    Figure.draw = watch.around("draw", Figure.draw)
    notebook = read_notebook(name)
    cells = [
        "".join(cell["source"])
        for cell in json.loads(notebook.source)["cells"]
        if cell["cell_type"] == "code"
    ]
    scope = {"__name__": "__main__"}
    with contextlib.redirect_stdout(sys.stderr):
        for source in cells:
            exec(compile(source, name, "exec"), scope)
    watch.enter("compute")
    return watch.seconds


def in_a_process_of_its_own(name: str, kernels: str, without: tuple[str, ...] = ()) -> dict[str, float]:
    """Seconds by kind of work of a notebook's code; machine code is taken from the folder `kernels` and added to it."""
    with tempfile.TemporaryDirectory() as folder:
        pinned = {key: value for key, value in environment().items() if key not in without}
        under = _compiling(pinned, kernels) | {"STILLWORK_OUTPUT": folder}
        told, complaints = Path(folder, "told"), Path(folder, "complaints")
        with told.open("w") as out, complaints.open("w") as errors:
            command = [sys.executable, __file__, "--measure", name]
            code = run_whole(command, env=under, stdout=out, stderr=errors)
        if code:
            raise SystemExit(code if code > 128 else f"{name}:\n{complaints.read_text()}")
        return json.loads(told.read_text())


def from_nothing(root: Path = ROOT, targets: Sequence[str] = ()) -> tuple[float, float]:
    """Seconds of the processor and of the clock that a build of `targets`, or everything, takes in the checkout `root`."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as kernels:
        plain = {name: value for name, value in os.environ.items() if not name.startswith("STILLWORK")}
        places = f"{root / 'lib'}{os.pathsep}{root}"
        under = _compiling(plain, kernels) | {BUILT: folder, "PYTHONPATH": places}
        code = run_whole([sys.executable, "-m", "stillwork", "figures", *targets], env=under, cwd=root)
    if code:
        raise SystemExit(code if code > 128 else f"the build failed with {code}: its time does not count")
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


def print_beside(commit: str, targets: list[str]) -> None:
    """A row for the checkout as it stands and one for the commit: seconds of the processor and of the clock."""
    with checkout(commit) as other:
        rows = {"as it stands": from_nothing(ROOT, targets), commit: from_nothing(other, targets)}
    print(f"{'from nothing':40}{'processor':>11}{'clock':>9}")
    for label, (spent, clock) in rows.items():
        print(f"{label:40}{spent:11.1f}{clock:9.1f}")


def _compiling(under: Mapping[str, str], kernels: str) -> dict[str, str]:
    """An environment that keeps its machine code in the folder `kernels`, whatever else is set."""
    return {name: under[name] for name in under if name != "NUMBA_CACHE_DIR"} | {FOLDER_VARIABLE: kernels}


def work(name: str, kernels: str, without: tuple[str, ...]) -> float:
    """Seconds of a notebook's own work; what is imported and compiled, no pin touches."""
    seconds = in_a_process_of_its_own(name, kernels, without)
    return sum(seconds[kind] for kind in ("compute", "draw", "save"))


def print_pins(targets: list[str], rounds: int, kernels: str) -> None:
    """A row per notebook: seconds under all pins, and these over the seconds without one of them and without any."""
    print(f"{'notebook':40}{'pinned':>9}" + "".join(f"{f'x {name}':>12}" for name in list(WITHOUT)[1:]))
    total = dict.fromkeys(WITHOUT, 0.0)
    for notebook in select(*(targets or sampled())):
        in_a_process_of_its_own(notebook.name, kernels)  # compiles
        taken = [
            {pin: work(notebook.name, kernels, names) for pin, names in WITHOUT.items()}
            for _ in range(rounds)
        ]
        middle = {pin: statistics.median(each[pin] for each in taken) for pin in WITHOUT}
        print(pins_row(notebook.name, middle), flush=True)
        total = {pin: total[pin] + middle[pin] for pin in WITHOUT}
    print(pins_row("all of them", total))


def pins_row(label: str, seconds: dict[str, float]) -> str:
    pinned, *others = seconds.values()
    return f"{label:40}{pinned:9.2f}" + "".join(f"{pinned / other:12.2f}" for other in others)


def row(label: str, seconds: dict[str, float]) -> str:
    shown = "".join(f"{seconds[kind]:9.1f}" for kind in KINDS)
    return f"{label:40}{shown}{sum(seconds.values()):9.1f}"


def print_kinds(targets: list[str], kernels: str) -> None:
    """A row per notebook: seconds by kind of work; of everything, then, beside those of a build."""
    print(f"{'notebook':40}" + "".join(f"{kind:>9}" for kind in (*KINDS, "all")))
    total = dict.fromkeys(KINDS, 0.0)
    for notebook in select(*targets):
        seconds = in_a_process_of_its_own(notebook.name, kernels)
        print(row(notebook.name, seconds), flush=True)
        total = {kind: total[kind] + seconds[kind] for kind in KINDS}
    print(row("all of them, each on its own", total), flush=True)
    if not targets:
        spent, clock = from_nothing()
        own = sum(total.values()) - total["imports"]
        print(
            f"a build from nothing: {spent:.0f} s of the processor (goal {PROCESSOR_S}), "
            f"{clock:.0f} s of the clock (goal {CLOCK_S} on two cores)"
        )
        print(f"of it Jupyter's kernels, imports, reports and comparison: {spent - own:.0f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="*", metavar="TOPIC[/NOTEBOOK]")
    parser.add_argument("--pins", action="store_true", help="what each pin of the processor costs")
    parser.add_argument(
        "--rounds", type=int, default=3, metavar="N", help="of --pins; medians of them are shown"
    )
    parser.add_argument("--beside", metavar="COMMIT", help="a build from nothing, and one of this commit")
    parser.add_argument("--measure", metavar="NOTEBOOK", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        print(json.dumps(measure(options.measure)))
        return
    if options.rounds < 1:
        parser.error(f"--rounds is {options.rounds}; give 1 or more")
    try:
        select(*options.targets)
    except InputError as error:
        parser.error(str(error))
    print(
        f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}; seconds of the processor"
    )
    if options.beside:
        print_beside(options.beside, options.targets)
        return
    with tempfile.TemporaryDirectory() as kernels:
        if options.pins:
            print_pins(options.targets, options.rounds, kernels)
        else:
            print_kinds(options.targets, kernels)


if __name__ == "__main__":
    main()
