"""A kernel of its own for one notebook: this Python, this checkout, fixed settings, and a sure end."""

import os
import signal
import sys
import threading
from pathlib import Path

import stillwork
from stillwork import paths

# One thread a kernel, and the kernels of BLAS that every x86-64 on which numpy runs can take: sums in the
# same order on every machine. Experiments on rounding would otherwise show another run on another processor.
KERNEL_SETTINGS = {
    "OPENBLAS_CORETYPE": "Nehalem",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMEXPR_NUM_THREADS": "1",
    "VECLIB_MAXIMUM_THREADS": "1",
    "PYTHONHASHSEED": "0",
    "MPLBACKEND": "Agg",
    "MATPLOTLIBRC": os.devnull,  # a user's own style would change the pictures
}

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


def kernel_manager(build: str, folder: Path, output: Path):
    """A class of managers for one kernel, as nbclient wants it: it knows no other way in for the settings."""
    from jupyter_client.kernelspec import KernelSpec
    from jupyter_client.manager import AsyncKernelManager

    library = str(Path(stillwork.__file__).parents[1])
    environment = {
        **os.environ,
        **KERNEL_SETTINGS,
        paths.OUTPUT_VARIABLE: str(output),
        "IPYTHONDIR": str(folder / "ipython"),  # no user's startup files
        "PYTHONPATH": os.pathsep.join(filter(None, [library, os.environ.get("PYTHONPATH")])),
    }
    command = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]

    class Kernel(AsyncKernelManager):
        process = None

        def __init__(self, **options):
            super().__init__(**{**options, "transport": "ipc", "connection_file": str(folder / "kernel")})
            self._kernel_spec = KernelSpec(argv=command, language="python")  # this Python, this checkout

        async def start_kernel(self, **options):
            with _lock:
                if build in _stopped:
                    raise RuntimeError("interrupted")
            await super().start_kernel(env=environment, **options)
            Kernel.process = self.provisioner.process
            with _lock:
                _groups[self.process.pid] = build
                late = build in _stopped
            if late:
                _kill(self.process.pid)

        @classmethod
        def last_words(cls) -> str:
            code = cls.process.poll() if cls.process else None
            if code is not None and code < 0:
                return f"the kernel was killed by {signal.Signals(-code).name} (out of memory?)"
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
