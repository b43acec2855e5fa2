"""A kernel of its own for one notebook: this Python, this checkout, fixed settings, and a sure end."""

import os
import signal
import sys
import threading
from pathlib import Path

import stillwork
from workbook import paths
from workbook.pinned import environment
from workbook.warm import PROGRAM, ForkServer

_lock = threading.Lock()
_groups: dict[int, str] = {}  # process group of each running kernel, and its build
_stopped: set[str] = set()


def stop(build: str) -> None:
    """Kill every kernel of a build in this process, and those that are about to start."""
    with _lock:
        _stopped.add(build)
        groups = [group for group, owner in _groups.items() if owner == build]
    for group in groups:
        _kill(group)


def _kill(group: int) -> None:
    try:
        os.killpg(group, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):  # nobody is left in it
        pass


def stamp(file: Path) -> tuple[int, int] | None:
    """Which file stands there: of another content, or removed and written again, it is another."""
    try:
        found = file.stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns


def kernel_environment(folder: Path, output: Path) -> dict[str, str]:
    """Environment of a kernel that works in `folder` and writes its results to `output`."""
    library = str(Path(stillwork.__file__).parents[1])
    return {
        **environment(),
        paths.OUTPUT_VARIABLE: str(output),
        paths.ROOT_VARIABLE: str(paths.root()),
        "IPYTHONDIR": str(folder / "ipython"),  # no user's startup files
        # Machine code of functions in cells is kept there, by their own source alone: nothing of another build.
        "XDG_CACHE_HOME": str(folder / "cache"),
        "PYTHONPATH": os.pathsep.join(
            filter(None, [library, str(paths.root()), os.environ.get("PYTHONPATH")])
        ),
    }


def kernel_manager(build: str, folder: Path, output: Path, reads: Path, warm: ForkServer | None = None):
    """A class of managers for one kernel, as nbclient requires: it has no other way to pass the settings.

    Parameters
    ----------
    build : str
        Which build it belongs to; `stop` ends all its kernels.
    folder, output : Path
        Where it works, and where it writes results.
    reads : Path
        Where it notes what it reads.
    warm : ForkServer, optional
        The process to fork it from; without, one is started.
    """
    from jupyter_client.kernelspec import KernelSpec
    from jupyter_client.manager import AsyncKernelManager
    from jupyter_client.provisioning import LocalProvisioner

    variables, connection = kernel_environment(folder, output), folder / "kernel"
    command = [sys.executable, "-P", str(PROGRAM), "kernel", str(reads), "-f", "{connection_file}"]

    class Provisioner(LocalProvisioner):
        async def launch_kernel(self, cmd, **options):
            Kernel.written = stamp(connection)
            if warm is None:
                return await super().launch_kernel(cmd, **options)
            arguments = cmd[cmd.index("kernel") + 1 :]
            self.process = warm.fork(arguments, options["env"], str(options["cwd"]))
            self.pid = self.pgid = self.process.pid
            return self.connection_info

    class Kernel(AsyncKernelManager):
        process = None
        written = None  # the file of its sockets, as it was before the launch

        def __init__(self, **options):
            super().__init__(**{**options, "transport": "ipc", "connection_file": str(connection)})
            self._kernel_spec = KernelSpec(argv=command, language="python")  # this Python, this checkout

        async def start_kernel(self, **options):
            with _lock:
                if build in _stopped:
                    raise RuntimeError("interrupted")
            self.provisioner = Provisioner(kernel_id="", kernel_spec=self.kernel_spec, parent=self)
            await super().start_kernel(env=variables, **options)
            Kernel.process = self.provisioner.process
            with _lock:
                _groups[self.process.pid] = build
                late = build in _stopped
            if late:
                _kill(self.process.pid)

        async def _async_is_alive(self) -> bool:
            # Where the file of its sockets was removed, so were they perhaps, and a kernel that is starting writes the
            # file again without them: it could not be reached.
            return stamp(connection) == Kernel.written and await super()._async_is_alive()

        is_alive = _async_is_alive

        @classmethod
        def last_words(cls) -> str:
            if not folder.is_dir():
                return f"its folder {folder} was removed from outside"
            code = cls.process.poll() if cls.process else None
            if code is not None and code < 0:
                return f"the kernel was killed by {signal.Signals(-code).name} (out of memory?)"
            if code is None and stamp(connection) != cls.written:
                return f"its file {connection} was removed from outside"
            return "the kernel did not start" if code is None else f"the kernel ended with exit code {code}"

        @classmethod
        def end(cls) -> None:
            """Kill what the kernel may have started, even when it is dead itself."""
            if cls.process:
                with _lock:
                    _groups.pop(cls.process.pid, None)
                _kill(cls.process.pid)
                cls.process.wait()

    return Kernel
