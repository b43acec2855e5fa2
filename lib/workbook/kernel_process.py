"""A Jupyter kernel for one notebook, and the warmed process that such kernels are forked from.

Run as a file with ``python -P``, it imports nothing of the package before it watches: what a notebook reads, the
library's own modules first of all, is written down as it is opened, with a digest of what was there.

``kernel_process.py kernel LOG -f CONNECTION_FILE`` becomes a kernel. ``kernel_process.py warm SOCKET`` imports what
is slow to import and nothing of the workbook, then forks a kernel for each line of JSON that comes in by the
inherited socket, and reports how each one ended.
"""

import contextlib
import hashlib
import importlib
import json
import os
import re
import select
import signal
import socket
import stat
import sys
import sysconfig
import tempfile
import types
from collections.abc import Iterator
from importlib.machinery import SourceFileLoader
from urllib.parse import unquote, urlsplit

# Where the notebooks spend their imports.
SLOW = (
    "numpy",
    "scipy.interpolate",
    "scipy.linalg",
    "scipy.optimize",
    "scipy.signal",
    "scipy.stats",
    "matplotlib.backends.backend_agg",
    "matplotlib.figure",
    "numba",
    "control",
    "jaxtyping",
    "pandas",
    "ipywidgets",
    "ipykernel.kernelapp",
)

# Modules that list folders for others, and those that look for modules or fonts there.
LISTERS = ("glob", "os", "pathlib", "pathlib._abc", "pathlib._local", "posixpath")
SEARCHERS = ("importlib", "_frozen_importlib", "pkgutil", "matplotlib.font_manager")


class IgnoredPaths:
    """What is no notebook's input although it is read: `places` and `KINDS` name it, with the reason.

    All else counts, wherever it lies. Of what lies in the checkout only that is left out which has its place there:
    the checkout itself may lie in one of the places. A place that a variable of the user's names (a cache of
    numba's or matplotlib's) may hold anything: there, and anywhere, files are left out by kind.
    """

    KINDS = re.compile(
        # Matplotlib looks into every font of the machine when it makes its list anew, and draws with its own.
        r".*\.(afm|otf|ttc|ttf)|fontlist-[^/]*\.json"
        # The user's settings of matplotlib are turned off (`pinned.env`).
        r"|matplotlibrc"
        # Machine code that numba keeps follows from sources that count.
        r"|.*\.nb[ci]",
        re.IGNORECASE,
    )

    def __init__(self, log: str):
        self._root = os.environ["STILLWORK_ROOT"].rstrip("/") + "/"
        found = {place for place in self.places(log) if place}
        found |= {os.path.realpath(each) for each in found}
        self._places = tuple(each.rstrip("/") + "/" for each in found)
        self._inner = tuple(
            each for each in self._places if each.startswith(self._root) and each != self._root
        )
        folders = set(self._packages())
        folders |= {os.path.realpath(folder) for folder in folders}
        self.packages = tuple(each.rstrip("/") + "/" for each in folders)
        self._own = tuple(self._unpinned(folders))

    def places(self, log: str) -> Iterator[str | None]:
        # Python and its packages: the pins of environment.txt are inputs in their stead.
        yield from (sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "include"))
        yield from self._packages()
        # The system's libraries, time zones and settings, another on each worker: what of them moves numbers is
        # pinned (`pinned.env`). What was put into /usr/local or /opt is not part of the system.
        yield from ("/etc", "/lib", "/lib64", "/usr/lib", "/usr/lib64", "/usr/share", "/Library", "/System")
        # The system's present state, devices, and memory that processes share until they end.
        yield from ("/dev", "/proc", "/sys")
        # The kernel's own folder: its connection file, IPython's settings and history, temporary files, results.
        yield os.path.dirname(log)
        # What builds write, and what git keeps of all that is committed.
        yield from (os.path.join(self._root, each) for each in ("build", ".git"))
        home = os.path.expanduser("~")
        caches = os.environ.get("XDG_CACHE_HOME") or os.path.join(home, ".cache")
        # Matplotlib's list of fonts, and styles of the user's own, which are turned off (`pinned.env`).
        own = os.environ.get("MPLCONFIGDIR")
        yield own and os.path.join(own, "stylelib")
        settings = os.environ.get("XDG_CONFIG_HOME") or os.path.join(home, ".config")
        yield from (os.path.join(each, "matplotlib") for each in (caches, settings))
        yield os.path.join(home, ".matplotlib")

    @staticmethod
    def _packages() -> Iterator[str]:
        yield from (sysconfig.get_path(name) for name in ("purelib", "platlib"))
        yield from (each for each in sys.path if os.path.basename(each) in ("site-packages", "dist-packages"))

    def _unpinned(self, folders: set[str]) -> Iterator[str]:
        """Files and folders of installed packages that environment.txt does not pin, say a laboratory's own."""
        try:
            with open(f"{self._root}environment.txt", encoding="utf-8") as file:
                pins = {_normal(line.partition("==")[0]) for line in file if line[:1].isalnum()}
        except OSError:
            return
        for folder in folders:
            for name in os.listdir(folder) if os.path.isdir(folder) else ():
                if not name.endswith(".dist-info") or _normal(name.partition("-")[0]) in pins:
                    continue
                with contextlib.suppress(OSError), open(f"{folder}/{name}/RECORD", encoding="utf-8") as file:
                    tops = {"".join(line.partition(",")[0].partition("/")[:2]) for line in file}
                    yield from (f"{folder}/{top}" for top in tops - {"", "/", "../", "__pycache__/"})

    def holds(self, path: str) -> bool:
        inside = self._inner if path.startswith(self._root) else self._places
        return (
            (path.startswith(inside) and not path.startswith(self._own))
            or self._follows(path)
            or bool(self.KINDS.fullmatch(os.path.basename(path)))
        )

    @staticmethod
    def _follows(path: str) -> bool:
        """Whether it is the bytecode of a source, which counts; without a source beside it bytecode counts itself."""
        kept = os.path.basename(os.path.dirname(path)) == "__pycache__"
        return path.endswith(".pyc") and (kept or path.startswith(f"{sys.pycache_prefix or os.devnull}/"))


def _normal(name: str) -> str:
    """A package's name as the index compares it."""
    return re.sub(r"[-_.]+", "-", name.strip()).lower()


def watch(log: str, left_out: IgnoredPaths) -> None:
    """Append to `log`, from now on, a line of JSON for each file that is read and each folder that is listed.

    The pins of the environment speak for what is left out, and the notebook's code for what it made itself. A log
    that cannot be written is removed: without one the results are not taken.
    """
    out = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    seen: dict[str, tuple] = {}
    made: dict[str, tuple | None] = {}  # by this process, with the stamp of what was there before
    state = {"busy": False}
    # What is watched, and which of its arguments is the path; `import` has one where it loads machine code.
    place = {
        "open": 0,
        "import": 1,
        "ctypes.dlopen": 0,
        "sqlite3.connect": 0,
        "os.listdir": 0,
        "os.scandir": 0,
        "os.mkdir": 0,
    }

    def note(path: str, digest: str) -> None:
        line = (json.dumps({"path": path, "digest": digest}) + "\n").encode()
        try:
            noted = os.write(out, line) == len(line)
        except OSError:  # a full disk
            noted = False
        if not noted:
            os.unlink(log)

    def note_file(path: str, event: str, mode: str | None = None, flags: int = 0) -> None:
        if left_out.holds(path):
            return
        now = _stamp(path)
        if event == "sqlite3.connect":
            flags = os.O_RDWR | os.O_CREAT
        if _empties(mode, flags) or (now is None and _creates(mode, flags)):
            if path not in seen:
                made.setdefault(path, now)
            return
        if now is None or _only_writes(mode, flags):
            return
        if seen.get(path) == now or made.get(path, now) != now:
            return
        seen[path] = now
        with open(path, "rb") as file:
            note(path, hashlib.file_digest(file, "sha256").hexdigest())

    def note_folder(path: str, frame: types.FrameType) -> None:
        if f"{path}/" in seen or path in made or left_out.holds(f"{path}/") or _searches(frame):
            return
        names = "\n".join(sorted(os.listdir(path)))
        seen[f"{path}/"] = ()
        note(f"{path}/", hashlib.sha256(names.encode()).hexdigest())

    def hook(event: str, arguments: tuple) -> None:
        if state["busy"] or event not in place:
            return
        path = arguments[place[event]]
        if path is None and event in ("os.listdir", "os.scandir"):
            path = "."
        if not isinstance(path, str | bytes | os.PathLike):
            return
        state["busy"] = True
        try:
            path = os.fsdecode(path)
            if event == "sqlite3.connect" and path.startswith("file:"):
                path = unquote(urlsplit(path).path)
            path = os.path.abspath(path)
            if event in ("os.listdir", "os.scandir"):
                note_folder(path, sys._getframe(1))
            elif event == "os.mkdir":
                if not os.path.exists(path):
                    made[path] = None
            else:
                note_file(path, event, *arguments[1:] if event == "open" else ())
        except (OSError, ValueError):  # what is not there was not read
            return
        finally:
            state["busy"] = False

    sys.addaudithook(hook)


def _searches(frame: types.FrameType | None) -> bool:
    """Whether who lists a folder looks for modules or for fonts: a new file there is no news until it is opened."""
    while frame is not None and frame.f_globals.get("__name__") in LISTERS:
        frame = frame.f_back
    return frame is not None and str(frame.f_globals.get("__name__")).startswith(SEARCHERS)


def _stamp(path: str) -> tuple | None:
    """What distinguishes a file's states; None if there is none.

    Raises
    ------
    ValueError
        When something else is there.
    """
    try:
        now = os.stat(path)
    except FileNotFoundError:
        return None
    if not stat.S_ISREG(now.st_mode):
        raise ValueError("no file")
    return now.st_ino, now.st_size, now.st_mtime_ns, now.st_ctime_ns


def _empties(mode: str | None, flags: int) -> bool:
    """Whether what was in a file that is opened so goes first."""
    return bool(flags & os.O_TRUNC) or "w" in (mode or "")


def _creates(mode: str | None, flags: int) -> bool:
    """Whether a file that is opened so comes to be where there was none."""
    return bool(flags & os.O_CREAT) or bool({"a", "x"} & set(mode or ""))


def _only_writes(mode: str | None, flags: int) -> bool:
    """Whether a file that is opened so, with all that is in it, cannot be read."""
    if mode is None:
        return flags & (os.O_WRONLY | os.O_RDWR) == os.O_WRONLY
    return "+" not in mode and bool({"a", "x"} & set(mode))


def compile_sources(left_out: IgnoredPaths) -> None:
    """Import the workbook's modules from their sources only.

    Python takes kept bytecode for a source's when both have one size and one second of change, so an edit right
    after an import would run as it was before.
    """
    usual = SourceFileLoader.get_code

    def get_code(self, name):
        path = os.path.abspath(self.get_filename(name))
        if left_out.holds(path) or path.startswith(left_out.packages):
            return usual(self, name)
        return self.source_to_code(self.get_data(path), path)

    SourceFileLoader.get_code = get_code


def kernel(log: str, *options: str) -> None:
    """Serve a notebook until it reports that it is done."""
    folder = os.path.dirname(log)
    try:
        left_out = IgnoredPaths(log)
        watch(log, left_out)
        compile_sources(left_out)
        tempfile.tempdir = folder  # what is left in it goes with the kernel
        sys.argv = ["ipykernel_launcher", *options]
        from ipykernel import kernelapp

        kernelapp.launch_new_instance()
    except Exception:
        if os.path.isdir(folder):
            raise
        sys.exit(1)  # the driver reports that the folder was removed


def warm(descriptor: int) -> None:
    """Fork kernels on demand until the other end of the socket closes; then end them all."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # it ends without a message, the driver reports it
    for name in SLOW:
        importlib.import_module(name)
    _first_use()
    import gc

    gc.collect()
    gc.freeze()  # what is here is shared by all: let no collection touch it
    driver = socket.socket(fileno=descriptor)
    woken, wake = os.pipe()
    for end in (woken, wake):
        os.set_blocking(end, False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    running: set[int] = set()
    with contextlib.suppress(ConnectionError):  # a driver that was killed
        _serve(driver, woken, wake, running)
    for pid in running:
        try:
            os.killpg(pid, signal.SIGKILL)
        except OSError:
            continue


def _serve(driver: socket.socket, woken: int, wake: int, running: set[int]) -> None:
    """Fork and report until the driver closes its end; `running` are the kernels that have not ended."""
    pending = b""
    while True:
        ready, _, _ = select.select([driver, woken], [], [])
        if woken in ready:
            os.read(woken, 4096)
        if driver in ready:
            received = driver.recv(65536)
            if not received:
                break
            *lines, pending = (pending + received).split(b"\n")
            for line in lines:
                wanted = json.loads(line)
                if pid := os.fork():
                    _lead(pid)
                    running.add(pid)
                    driver.sendall(json.dumps({"asked": wanted["asked"], "pid": pid}).encode() + b"\n")
                else:
                    _become_kernel(wanted, (driver, woken, wake))
        for pid in list(running):
            done, status = os.waitpid(pid, os.WNOHANG)
            if done:
                running.discard(pid)
                ended = {"pid": pid, "code": os.waitstatus_to_exitcode(status)}
                driver.sendall(json.dumps(ended).encode() + b"\n")


def _lead(pid: int) -> None:
    """Give a kernel a process group of its own; parent and child both do, so that nobody sees it without."""
    try:
        os.setpgid(pid, pid)
    except OSError:  # it has one by now, or has ended
        pass


def _become_kernel(wanted: dict, inherited: tuple) -> None:
    code = 1
    try:
        _lead(0)
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        driver, woken, wake = inherited
        driver.close()
        os.close(woken)
        os.close(wake)
        parent = os.getppid()
        _die_with_parent()
        if os.getppid() != parent:
            os._exit(1)
        os.environ.clear()
        os.environ.update(wanted["environment"])
        os.chdir(wanted["folder"])
        _reseed()
        kernel(*wanted["arguments"], f"--IPKernelApp.parent_handle={parent}")
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(bool(ended.code))
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _reseed() -> None:
    """Processes of one origin must not share their streams of random numbers."""
    import random

    import numpy

    random.seed()
    numpy.random.seed()  # noqa: NPY002  the global state that a notebook may use is what is meant


def _die_with_parent() -> None:
    import ctypes

    ctypes.CDLL(None, use_errno=True).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


def _first_use() -> None:
    """What is slow the first time: numba's compiler, the fonts and the parser of formulas."""
    import numba
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    numba.njit(lambda number: number + 1.0)(1.0)
    figure = Figure(layout="constrained")
    axes = figure.subplots()
    axes.loglog([1, 10], [1, 10], label=r"$\omega_1^{2}$")
    axes.set_xlabel("time (s)")
    axes.legend()
    FigureCanvasAgg(figure).draw()


if __name__ == "__main__":
    if sys.argv[1] == "warm":
        warm(int(sys.argv[2]))
    else:
        kernel(*sys.argv[2:])
