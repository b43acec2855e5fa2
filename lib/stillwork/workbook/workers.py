"""Who computes, and how it ends: cores, processes of this machine, a cluster's workers, signals, one run at a time."""

import contextlib
import fcntl
import multiprocessing
import os
import signal
import threading
from concurrent.futures import ProcessPoolExecutor
from multiprocessing.connection import wait

from stillwork import paths
from stillwork.checks import InputError
from stillwork.workbook.jupyter_kernel import KERNEL_SETTINGS


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def client_of(address: str):
    """Client of a Dask cluster.

    Raises
    ------
    InputError
        When no scheduler answers at `address`.
    """
    from distributed import Client

    try:
        return Client(address, timeout=5)
    except (OSError, ValueError) as error:
        raise InputError(f"scheduler {address!r} does not answer ({error}); give host:port") from None


@contextlib.contextmanager
def processes(jobs: int):
    """An executor of fresh processes with the settings of a build's kernels.

    They end with this process, and at once when its context is left by an exception.
    """
    before = {name: os.environ.get(name) for name in KERNEL_SETTINGS}
    os.environ.update(KERNEL_SETTINGS)  # the processes, which start when they are needed, get them from here
    others = set(multiprocessing.active_children())
    spawn = multiprocessing.get_context("spawn")
    try:
        with ProcessPoolExecutor(jobs, mp_context=spawn, initializer=_end_with_parent) as pool:
            try:
                yield pool
            except BaseException:
                for process in set(multiprocessing.active_children()) - others:
                    process.terminate()
                raise
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _end_with_parent() -> None:
    """A killed parent closes no pipe that its processes wait on: watch it instead."""
    ended = multiprocessing.parent_process().sentinel

    def watch():
        wait([ended])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextlib.contextmanager
def noted_signals():
    """Note an interrupt instead of raising it, so that it tears nothing halfway; yields what came."""
    caught: list[int] = []
    wanted = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {each: signal.signal(each, lambda number, _frame: caught.append(number)) for each in wanted}
    try:
        yield caught
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)


@contextlib.contextmanager
def alone(name: str = "lock"):
    """Two runs of one checkout would write the same files: the second is refused."""
    file = paths.root() / "build" / name
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError("another build of this checkout is running; wait for it or stop it") from None
        yield
