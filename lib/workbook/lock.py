"""One command at a time may write to a checkout, and none is torn halfway by an interrupt."""

import contextlib
import fcntl
import signal
from collections.abc import Callable, Iterator

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
def unwound() -> Iterator[None]:
    """Turn a signal to terminate into an exception, so that temporary files are removed."""

    def leave(number: int, _frame) -> None:
        raise SystemExit(128 + number)

    with _handled(leave, signal.SIGTERM, signal.SIGHUP):
        yield


@contextlib.contextmanager
def interrupts() -> Iterator[list[int]]:
    """Note an interrupt instead of raising it, so that it tears nothing halfway; yields what came."""
    caught: list[int] = []
    with _handled(lambda number, _frame: caught.append(number), signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        yield caught


@contextlib.contextmanager
def _handled(handler: Callable, *numbers: signal.Signals) -> Iterator[None]:
    """Let `handler` take these signals for a while, apart from those that the process was started to ignore.

    `nohup` ignores the end of a session so, and a shell the interrupts of its background jobs.
    """
    handled = [number for number in numbers if signal.getsignal(number) != signal.SIG_IGN]
    before = {each: signal.signal(each, handler) for each in handled}
    try:
        yield
    finally:
        for each, usual in before.items():
            signal.signal(each, usual)
