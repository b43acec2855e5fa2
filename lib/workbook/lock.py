"""One command at a time may write to a checkout, and none is torn halfway by an interrupt."""

import contextlib
import fcntl
import signal
from collections.abc import Iterator

from workbook import paths
from workbook.checks import InputError


@contextlib.contextmanager
def exclusive_lock() -> Iterator[None]:
    """Hold the checkout's lock; two writers would swap the same files.

    Raises
    ------
    InputError
        When another command holds it.
    """
    refusal = "another build or accept of this checkout is running; wait for it or stop it"
    with held("lock", refusal):
        yield


@contextlib.contextmanager
def held(name: str, refusal: str) -> Iterator[None]:
    """Hold the file ``build/<name>`` against other processes.

    Raises
    ------
    InputError
        With `refusal`, when another one holds it.
    """
    file = paths.root() / "build" / name
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(refusal) from None
        yield


@contextlib.contextmanager
def interrupts() -> Iterator[list[int]]:
    """Note an interrupt instead of raising it, so that it tears nothing halfway; yields what came.

    Signals stay ignored that the process was started to ignore: `nohup` ignores the end of a session so, and a shell the
    interrupts of its background jobs.
    """
    caught: list[int] = []
    handled = [
        number
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        if signal.getsignal(number) != signal.SIG_IGN
    ]
    before = {each: signal.signal(each, lambda number, _frame: caught.append(number)) for each in handled}
    try:
        yield caught
    finally:
        for each, usual in before.items():
            signal.signal(each, usual)
