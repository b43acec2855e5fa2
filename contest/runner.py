"""The runner: anybody's observer on one scan, in a process that holds neither the truth nor any other scan.

Where the machine has them (Linux with ``unshare``), the process gets a root folder, processes, network and users of its
own: it sees Python, its packages and the toolbox, read-only, and no other process; and it may start threads, but no
process. Elsewhere it is not isolated, which the result states.
"""

import base64
import contextlib
import json
import os
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from functools import cache
from pathlib import Path

import numpy as np

from contest.nominal import NominalModel, NominalNoise, TuningParameter
from stillwork.base.checks import InputError

CPU_SECONDS = 60  # that a scan may take, with its start
PATIENCE = 10  # seconds of the clock for each of them: a busy machine is not the observer's fault
MOST_MEMORY, MOST_WRITTEN = 4 << 20, 64 << 10  # kB of address space, and of any file
MOST_ANSWERED = 1 << 20  # bytes of a line
MOST_KNOBS = 32
UNREACHED = "cannot be reached"
SYSTEM_PATH = "/usr/sbin:/usr/bin:/sbin:/bin"
SERVER, LIBRARY = Path(__file__).with_name("child.py"), Path(__file__).parents[1] / "lib"
PROGRAMS = ("unshare", "mount", "umount", "pivot_root", "setpriv")
NAMESPACES = (
    "--user",
    "--map-root-user",
    "--mount",
    "--pid",
    "--net",
    "--ipc",
    "--uts",
    "--fork",
    "--kill-child",
)
LIMITS = f"ulimit -c 0; ulimit -t $0; ulimit -v {MOST_MEMORY}; ulimit -f {2 * MOST_WRITTEN}; "
# A root in memory with what is given, read-only, at the paths it has outside; then everything else is let go.
JAIL = """set -e; root=$1; shift
mount -t tmpfs -o size=128m none "$root"
while [ "$1" != -- ]; do
    if [ -d "$1" ]; then mkdir -p "$root$1"; else mkdir -p "$root${1%/*}"; : > "$root$1"; fi
    mount --bind "$1" "$root$1"
    case "$1" in /dev/*) device=dev ;; *) device=nodev ;; esac
    mount -o "remount,bind,ro,nosuid,$device" "$root$1"
    shift
done; shift
for link in /bin /lib /lib64 /sbin; do [ ! -L $link ] || ln -s "$(readlink $link)" "$root$link"; done
mkdir -p "$root/proc" "$root/tmp" "$root/outside"; mount -t proc -o ro none "$root/proc"
cd "$root"; pivot_root . outside; umount -l /outside; umount /proc; rmdir /outside /proc; cd /tmp
exec setpriv --no-new-privs --inh-caps=-all --bounding-set=-all "$@" """


class Disqualified(Exception):
    """Why an observer is out of the contest."""


def _visible() -> list[str]:
    """What an observer sees of this machine's files: Python, its packages, the toolbox."""
    system = [each for each in ("/usr", "/bin", "/lib", "/lib64") if not os.path.islink(each)]
    # A virtual environment may itself be a link: what it leads to appears at both places.
    places = [
        sys.base_prefix,
        sys.prefix,
        os.path.realpath(sys.prefix),
        str(LIBRARY / "stillwork"),
        str(SERVER),
    ]
    kept = [place for place in places if not place.startswith("/usr/")]
    return [
        path for path in dict.fromkeys([*system, *kept, "/dev/null", "/dev/urandom"]) if os.path.exists(path)
    ]


def _command(isolated: bool, folder: str) -> list[str]:
    python = [sys.executable, "-P", str(SERVER)]
    if isolated:
        return [*_jail(folder), *python]
    return ["/bin/sh", "-c", LIMITS + 'exec "$@"', str(CPU_SECONDS), *python]


def _jail(folder: str) -> list[str]:
    shell = ["/bin/sh", "-c", LIMITS + JAIL, str(CPU_SECONDS), folder, *_visible(), "--"]
    return ["unshare", *NAMESPACES, *shell]


@cache
def can_isolate() -> bool:
    """Whether this machine gives an observer namespaces of its own, and can forbid it to start processes."""
    if not all(map(shutil.which, PROGRAMS)):
        return False
    with tempfile.TemporaryDirectory() as folder:
        command = [*_command(True, folder), "--probe"]
        return subprocess.run(command, capture_output=True, env={"PATH": SYSTEM_PATH}).returncode == 0


class ExternalObserver:
    """An observer on one scan: a context whose `start` and `step` are those of the observer.

    `source` is a Python file with a class ``Observer``, a shared library (``.so``), or ``tcp:HOST:PORT``, where a program
    speaks the same lines of JSON and gets a connection for each scan.
    """

    def __init__(self, source: str | Path):
        self.source, self.remote = str(source), str(source).startswith("tcp:")
        self.isolated, self.cpu_seconds, self.why = not self.remote and can_isolate(), np.nan, ""
        try:
            if self.remote:
                _, host, port = self.source.split(":")
                self.address = host, int(port)
            else:
                self.content = Path(source).read_bytes()
        except (ValueError, OSError) as error:
            raise InputError(f"{source} cannot be read ({error}); give a file or tcp:HOST:PORT") from None

    def __enter__(self) -> "ExternalObserver":
        self.buffer = b""
        self.deadline = time.monotonic() + PATIENCE * CPU_SECONDS
        if self.remote:
            try:
                self.socket = socket.create_connection(self.address, timeout=10)
            except OSError as error:
                raise Disqualified(f"{UNREACHED} ({error})") from None
            self.socket.setblocking(False)
            self.reading = self.writing = self.socket.fileno()
            return self
        self.folder = tempfile.TemporaryDirectory(prefix="observer-")
        environment = {"PATH": SYSTEM_PATH, "LANG": "C.UTF-8", "PYTHONPATH": str(LIBRARY)}
        own = "/tmp" if self.isolated else self.folder.name
        environment |= dict.fromkeys(("HOME", "TMPDIR", "NUMBA_CACHE_DIR"), own)
        environment |= dict.fromkeys(
            ("PYTHONDONTWRITEBYTECODE", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
        )
        self.process = subprocess.Popen(
            _command(self.isolated, self.folder.name),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd=self.folder.name,
            env=environment,
            start_new_session=True,
        )
        self.reading, self.writing = self.process.stdout.fileno(), self.process.stdin.fileno()
        os.set_blocking(self.writing, False)  # an observer that writes without reading is not waited for
        try:
            message = {
                "content": base64.b64encode(self.content).decode(),
                "library": self.source.endswith(".so"),
            }
            self.knobs = knobs_of(self._ask(message))
        except BaseException as error:
            self.__exit__(error)
            raise
        return self

    def __exit__(self, error=None, *_) -> None:
        if self.remote:
            self.socket.close()
            return
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.close()
        self._end(0.5)
        self.process.stdout.close()
        self.folder.cleanup()
        if (
            error is None and self.cpu_seconds > CPU_SECONDS
        ):  # the limit of a process is none of its children's
            raise Disqualified(_too_long())

    def _end(self, patience: float) -> None:
        """Let the process end by itself, or end it; then its time is known."""
        if self.process.returncode is None:
            select.select([self.reading], [], [], patience)  # its end of the pipe closes
            self._kill()
            _, status, usage = os.wait4(self.process.pid, 0)
            self.process.returncode = os.waitstatus_to_exitcode(status)
            self.cpu_seconds = usage.ru_utime + usage.ru_stime

    def _kill(self) -> None:
        """End the first process of its namespace, and with it all others; its time is then that of who waits for it."""
        pid = self.process.pid
        if self.isolated:
            with contextlib.suppress(OSError):
                for first in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
                    os.kill(int(first), signal.SIGKILL)
                    os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(pid, signal.SIGKILL)

    def start(
        self, model: NominalModel, noise: NominalNoise, sample_time: float, settings: tuple[float, ...] = ()
    ) -> None:
        """Give the observer what is known of the machine, and where its knobs stand."""
        self.states = len(model.a)
        known = vars(model) | {"rigid_modes": model.rigid_modes}
        given = {
            part: {name: x.tolist() if isinstance(x, np.ndarray) else x for name, x in values.items()}
            for part, values in (("model", known), ("noise", vars(noise)))
        }
        self._ask(given | {"sample_time": sample_time, "settings": list(settings)})

    def step(self, input: np.ndarray, measurement: np.ndarray, *_) -> np.ndarray:
        """The estimate at the sample of this measurement."""
        estimate = self._ask([input.tolist(), [None if np.isnan(y) else y for y in measurement.tolist()]])
        if not (isinstance(estimate, list) and len(estimate) == self.states and all(map(_finite, estimate))):
            raise Disqualified(f"an answer that is no estimate: {self.states} finite numbers in a list")
        return np.array(estimate, dtype=float)

    def _ask(self, message):
        if self.buffer:
            raise Disqualified("an answer before it is asked")
        view = memoryview(json.dumps(message).encode() + b"\n")
        with contextlib.suppress(BrokenPipeError, ConnectionError):
            while view:
                self._wait([], [self.writing])
                with contextlib.suppress(BlockingIOError):
                    view = view[os.write(self.writing, view) :]
        while b"\n" not in self.buffer:
            self._wait([self.reading], [])
            try:
                piece = os.read(self.reading, 1 << 16)
            except ConnectionError:
                piece = b""
            if not piece:
                raise Disqualified(self._reason())
            self.buffer += piece
            if len(self.buffer) > MOST_ANSWERED:
                raise Disqualified(f"an answer of more than {MOST_ANSWERED} bytes")
        line, _, self.buffer = self.buffer.partition(b"\n")
        try:
            answer = json.loads(line)
        except (ValueError, RecursionError):
            raise Disqualified("an answer that is not JSON") from None
        if isinstance(answer, dict) and "error" in answer:
            reason = str(answer["error"])[:500]  # an observer's words, which are printed beside the ranks
            raise Disqualified("".join(each if each.isprintable() else "?" for each in reason))
        return answer

    def _wait(self, reading: list[int], writing: list[int]) -> None:
        left = max(self.deadline - time.monotonic(), 0.0)
        if not any(select.select(reading, writing, [], left)):
            raise Disqualified(f"hangs: a scan takes more than {PATIENCE * CPU_SECONDS} s of the clock")

    def _reason(self) -> str:
        if self.remote:
            return "its connection closes"
        ended, until = None, time.monotonic() + 1.0
        while ended is None and time.monotonic() < until:  # before it is killed, it may report its error
            time.sleep(0.01)
            ended = os.waitid(os.P_PID, self.process.pid, os.WEXITED | os.WNOWAIT | os.WNOHANG)
        self._end(5.0)
        if self.cpu_seconds > CPU_SECONDS - 0.5:  # the kernel's limit counts ticks
            return _too_long()
        code = self.process.returncode
        return "its process ends" + (f" by {signal.Signals(-code).name}" if ended and code < 0 else "")


def _finite(number) -> bool:
    """Whether what JSON gives is a number that a float holds: no truth value, no text."""
    return type(number) in (int, float) and abs(number) <= sys.float_info.max


def _too_long() -> str:
    return f"takes more than {CPU_SECONDS} s of the processor on one scan"


def knobs_of(answer) -> tuple[TuningParameter, ...]:
    """The tuning parameters that an observer's file declares, from its process."""
    try:
        knobs = tuple(TuningParameter(str(name), *map(float, rest)) for name, *rest in answer["knobs"])
    except (TypeError, KeyError, ValueError, OverflowError):
        knobs = None
    right = knobs is not None and all(0 < one.low <= one.default <= one.high < np.inf for one in knobs)
    if not right or len(knobs) > MOST_KNOBS:
        raise Disqualified(
            f"KNOBS that are not up to {MOST_KNOBS} (name, low, high, default), numbers above zero in order"
        )
    return knobs


def declared_knobs(source: str | Path) -> tuple[TuningParameter, ...]:
    """The knobs ``(name, low, high, default)`` that a Python file lists as ``KNOBS``; none of a library or a socket."""
    if str(source).startswith("tcp:"):
        return ()
    with ExternalObserver(source) as observer:
        return observer.knobs
