"""A kernel of its own for one notebook: this Python, this checkout, fixed settings, and a sure end.

A kernel is started, or forked by multiprocessing's fork server from a process that has imported what is slow
(`workbook.warm`). It ends with the process that builds.
"""

import contextlib
import multiprocessing
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from multiprocessing import forkserver
from multiprocessing.connection import wait
from pathlib import Path

from workbook import paths
from workbook.pinned import environment

LIBRARY = Path(__file__).parents[1]

_lock = threading.Lock()
_kernels: dict[int, str] = {}  # process of each running kernel, and its build
_stopped: set[str] = set()


def stop(build: str) -> None:
    """Kill every kernel of a build in this process, and those that are about to start."""
    with _lock:
        _stopped.add(build)
        running = [pid for pid, owner in _kernels.items() if owner == build]
    for pid in running:
        _kill(pid)


def _kill(pid: int) -> None:
    """End a kernel and all that it started, which are a group of processes."""
    for end in (os.killpg, os.kill):  # just forked it leads no group yet
        with contextlib.suppress(ProcessLookupError, PermissionError):
            end(pid, signal.SIGKILL)


def kernel_environment(folder: Path, output: Path) -> dict[str, str]:
    """Environment of a kernel that works in `folder` and writes its results to `output`."""
    places = (str(LIBRARY), str(paths.root()), os.environ.get("PYTHONPATH"))
    return {
        **environment(),
        paths.OUTPUT_VARIABLE: str(output),
        paths.ROOT_VARIABLE: str(paths.root()),
        "IPYTHONDIR": str(folder / "ipython"),  # no user's startup files
        # Machine code of functions in cells is kept there, by their own source alone: nothing of another build.
        "XDG_CACHE_HOME": str(folder / "cache"),
        "TMPDIR": str(folder),  # what is left in it goes with the kernel
        "PYTHONPATH": os.pathsep.join(dict.fromkeys(filter(None, places))),
    }


@contextlib.contextmanager
def warmed(wanted: bool) -> Iterator[bool]:
    """Begins the process that kernels are forked from, where it is wanted and a fork is safe; yields whether it is there."""
    if not wanted or sys.platform != "linux":
        yield False
        return
    multiprocessing.get_context("forkserver").set_forkserver_preload(["workbook.warm"])
    with paths.under(kernel_environment(Path(tempfile.gettempdir()), Path(os.devnull))):
        forkserver.ensure_running()  # it keeps this environment: libraries read theirs when they are loaded
    yield True


def _serve(connection: str, variables: dict[str, str], folder: str) -> None:
    """Be a forked kernel until the notebook has run."""
    os.setpgid(0, 0)
    threading.Thread(target=_end_with_builder, daemon=True).start()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    here = os.getcwd()
    os.environ.clear()
    os.environ.update(variables)
    own = variables["PYTHONPATH"].split(os.pathsep)
    sys.path[:] = dict.fromkeys([*own, *(each for each in sys.path if each not in ("", here))])
    os.chdir(folder)
    tempfile.tempdir = variables["TMPDIR"]
    _reseed()
    from ipykernel import kernelapp

    kernelapp.launch_new_instance(argv=["-f", connection, f"--IPKernelApp.parent_handle={os.getppid()}"])


def _end_with_builder() -> None:
    builder = multiprocessing.parent_process()
    wait([builder.sentinel])
    os.killpg(0, signal.SIGKILL)


def _reseed() -> None:
    """Processes of one origin must not share their streams of random numbers."""
    import numpy

    random.seed()
    numpy.random.seed()  # noqa: NPY002  the global state that a notebook may use is what is meant


class ForkedKernel:
    """A forked kernel as `subprocess.Popen` shows a process, for Jupyter."""

    stdin = stdout = stderr = None

    def __init__(self, connection: str, variables: dict[str, str], folder: str):
        context = multiprocessing.get_context("forkserver")
        self._process = context.Process(target=_serve, args=(connection, variables, folder))
        with _lock:  # multiprocessing looks after all its processes at each start of one
            self._process.start()
        self.pid = self._process.pid

    def poll(self) -> int | None:
        with _lock:
            return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        end = None if timeout is None else time.monotonic() + timeout
        while (code := self.poll()) is None:
            if end is not None and time.monotonic() > end:
                raise subprocess.TimeoutExpired("kernel", timeout)
            time.sleep(0.02)
        return code

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


def kernel_manager(build: str, folder: Path, output: Path, forks: bool = False):
    """A class of managers for one kernel, as nbclient requires: it has no other way to pass the settings.

    Parameters
    ----------
    build : str
        Which build it belongs to; `stop` ends all its kernels.
    folder, output : Path
        Where it works, and where it writes results.
    forks : bool
        Whether to fork it, inside of `warmed`.
    """
    from jupyter_client.kernelspec import KernelSpec
    from jupyter_client.manager import AsyncKernelManager
    from jupyter_client.provisioning import LocalProvisioner

    variables, connection = kernel_environment(folder, output), str(folder / "kernel")
    command = [sys.executable, "-P", "-m", "ipykernel_launcher", "-f", "{connection_file}"]

    class Provisioner(LocalProvisioner):
        async def launch_kernel(self, cmd, **options):
            if not forks:
                return await super().launch_kernel(cmd, **options)
            self.process = ForkedKernel(connection, variables, str(options["cwd"]))
            self.pid = self.pgid = self.process.pid
            return self.connection_info

    class Kernel(AsyncKernelManager):
        process = None

        def __init__(self, **options):
            super().__init__(**{**options, "transport": "ipc", "connection_file": connection})
            self._kernel_spec = KernelSpec(argv=command, language="python")  # this Python, this checkout

        async def start_kernel(self, **options):
            if build in _stopped:
                raise RuntimeError("interrupted")
            self.provisioner = Provisioner(kernel_id="", kernel_spec=self.kernel_spec, parent=self)
            await super().start_kernel(env=variables, **options)
            Kernel.process = self.provisioner.process
            with _lock:
                _kernels[self.process.pid] = build
                late = build in _stopped
            if late:
                _kill(self.process.pid)

        @classmethod
        def last_words(cls) -> str:
            if not folder.is_dir():
                return f"its folder {folder} was removed from outside"
            code = cls.process.poll() if cls.process else None
            if code is not None and code < 0:
                return f"the kernel was killed by {signal.Signals(-code).name} (out of memory?)"
            return "the kernel did not start" if code is None else f"the kernel ended with exit code {code}"

        @classmethod
        def end(cls) -> None:
            """Kill what the kernel may have started, even when it is dead itself."""
            if cls.process:
                with _lock:
                    _kernels.pop(cls.process.pid, None)
                _kill(cls.process.pid)
                cls.process.wait()

    return Kernel
