"""One command at a time may write to a checkout."""

import contextlib
import fcntl
from collections.abc import Iterator

from stillwork.base import paths
from stillwork.base.checks import InputError


@contextlib.contextmanager
def alone() -> Iterator[None]:
    """Hold the checkout's lock; two writers would swap the same files.

    Raises
    ------
    InputError
        When another command holds it.
    """
    file = paths.root() / "build" / "lock"
    file.parent.mkdir(exist_ok=True)
    with file.open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(
                "another build or accept of this checkout is running; wait for it or stop it"
            ) from None
        yield
