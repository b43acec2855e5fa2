"""The driver's side of the warmed process that kernels are forked from."""

import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from workbook.pinned import environment

PROGRAM = Path(__file__).with_name("kernel_process.py")
START_S = 60.0  # longer than the slowest import seen


class ForkedKernel:
    """A forked kernel, as `subprocess.Popen` shows a process; its parent is the warmed process, which reports its end."""

    stdin = stdout = stderr = None

    def __init__(self, warm: "ForkServer", pid: int):
        self._warm = warm
        self.pid = pid

    def poll(self) -> int | None:
        return self._warm.code(self.pid)

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


class ForkServer:
    """The warmed process; `fork` may be called from several threads.

    It is a process of its own, begun by this one: a driver or a worker with threads is never forked.
    """

    def __init__(self):
        mine, theirs = socket.socketpair()
        command = [sys.executable, "-P", str(PROGRAM), "warm", str(theirs.fileno())]
        self._process = subprocess.Popen(
            command,
            env=environment(),
            stdin=subprocess.DEVNULL,
            pass_fds=[theirs.fileno()],
            start_new_session=True,  # a terminal's interrupt is the driver's to handle
        )
        theirs.close()
        self._socket = mine
        self._lock = threading.Lock()
        self._pending = b""
        self._pids: dict[int, int] = {}
        self._codes: dict[int, int] = {}
        self._asked = 0
        self._lost = False

    def fork(self, arguments: list[str], variables: dict[str, str], folder: str) -> ForkedKernel:
        """A kernel with these arguments, environment and working directory.

        Raises
        ------
        RuntimeError
            When the warmed process is gone.
        """
        with self._lock:
            self._asked += 1
            asked = self._asked
        wanted = {"asked": asked, "arguments": arguments, "environment": variables, "folder": folder}
        try:
            with self._lock:
                self._socket.sendall(json.dumps(wanted).encode() + b"\n")
        except OSError:
            self._lost = True
        end = time.monotonic() + START_S
        while asked not in self._pids:
            self._read(0.05)
            if self._lost or time.monotonic() > end:
                raise RuntimeError("the process that kernels are forked from has ended")
        return ForkedKernel(self, self._pids[asked])

    def code(self, pid: int) -> int | None:
        """Exit code of a kernel, negative for a signal; None while it runs."""
        self._read(0.0)
        if pid not in self._codes and self._lost:
            self._codes[pid] = -signal.SIGKILL  # its kernels die with it
        return self._codes.get(pid)

    def close(self) -> None:
        """End the process, and with it every kernel that still runs."""
        self._socket.close()
        self._lost = True
        try:
            self._process.wait(timeout=10)
        except subprocess.TimeoutExpired:  # in the midst of its imports
            self._process.kill()
            self._process.wait()

    def _read(self, seconds: float) -> None:
        with self._lock:
            if self._lost:
                return
            while select.select([self._socket], [], [], seconds)[0]:
                try:
                    received = self._socket.recv(65536)
                except ConnectionError:  # killed before it had read all
                    received = b""
                if not received:
                    self._lost = True
                    return
                *lines, self._pending = (self._pending + received).split(b"\n")
                for line in lines:
                    self._note(json.loads(line))
                seconds = 0.0

    def _note(self, told: dict) -> None:
        if "asked" in told:
            self._codes.pop(told["pid"], None)  # of a process before it that had the same number
            self._pids[told["asked"]] = told["pid"]
        elif "code" in told:
            self._codes[told["pid"]] = told["code"]


@contextlib.contextmanager
def warmed(wanted: bool) -> Iterator[ForkServer | None]:
    """Yields a warmed process for kernels, or None if it is not used or a fork is not safe."""
    if not wanted or sys.platform != "linux":
        yield None
        return
    warm = ForkServer()
    try:
        yield warm
    finally:
        warm.close()
