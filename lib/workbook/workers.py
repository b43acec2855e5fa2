"""Who computes: cores and processes of this machine, or a cluster's workers."""

import contextlib
import multiprocessing
import os
import threading
from concurrent.futures import ProcessPoolExecutor
from multiprocessing.connection import wait

from workbook import paths
from workbook.checks import InputError
from workbook.pinned import environment

ANSWER_S = 5.0  # within which a scheduler responds


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def client_of(address: str):
    """Client of a Dask cluster.

    Raises
    ------
    InputError
        When no scheduler responds at `address`.
    """
    from distributed import Client

    try:
        return Client(address, timeout=ANSWER_S)
    except (OSError, ValueError) as error:
        raise InputError(f"scheduler {address!r} does not respond ({error}); give host:port") from None


@contextlib.contextmanager
def processes(jobs: int):
    """An executor of fresh processes with the settings of a build's kernels.

    They end with this process, and at once when its context is left by an exception.
    """
    others = set(multiprocessing.active_children())
    spawn = multiprocessing.get_context("spawn")
    # The processes, which start when they are needed, get it from here.
    with (
        paths.under(environment()),
        ProcessPoolExecutor(jobs, mp_context=spawn, initializer=_end_with_parent) as pool,
    ):
        try:
            yield pool
        except BaseException:
            for process in set(multiprocessing.active_children()) - others:
                process.terminate()
            raise


def _end_with_parent() -> None:
    """A killed parent closes no pipe that its processes wait on: watch it instead."""
    ended = multiprocessing.parent_process().sentinel

    def watch():
        wait([ended])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
