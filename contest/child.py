"""The process of a foreign observer: it answers sample by sample and is given nothing but its measurements.

It runs as a script of its own and imports nothing of the contest. The limits keep honest mistakes and simple tricks
out of the result; they are no prison for hostile code.
"""

import os
import sys
import types
import warnings
from contextlib import suppress
from multiprocessing.connection import Connection

MOST_BYTES = 4 << 30  # of address space, of which the numerical libraries take the first gigabyte
MOST_WRITTEN = 64 << 20  # of any file: a compiler's cache
# What a process asks for that wants more than its measurements.
FORBIDDEN = (
    "subprocess.",
    "socket.",
    "os.system",
    "os.exec",
    "os.fork",
    "os.spawn",
    "os.posix_spawn",
    "os.kill",
)


class _Loud:
    """In place of standard output: whoever writes to it is noted."""

    encoding, errors = "utf-8", "strict"

    def __init__(self, offences: list[str]):
        self.offences = offences

    def write(self, text: str) -> int:
        self.offences.append("prints")
        return len(text)

    def flush(self) -> None:
        """Nothing is kept."""

    def isatty(self) -> bool:
        return False


def _limit() -> None:
    with suppress(ImportError, ValueError, OSError):  # Windows has none, macOS refuses one on memory
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_FSIZE, (MOST_WRITTEN, MOST_WRITTEN))
        resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))


def _watch(offences: list[str], folders: tuple[str, ...], single: tuple[str, ...]) -> None:
    def hook(event: str, arguments: tuple) -> None:
        if event in ("open", "os.listdir", "os.scandir") and isinstance(arguments[0], str | bytes):
            path = os.path.abspath(os.fsdecode(arguments[0]))
            if not path.startswith(folders) and path not in single:
                offences.append(f"reads files ({path})")
                raise PermissionError(path)
        elif event.startswith(FORBIDDEN):
            offences.append(f"asks for {event}")
            raise PermissionError(event)

    sys.addaudithook(hook)


def _serve(file: str, requests: Connection, answers: Connection, offences: list[str]) -> None:
    import numpy as np

    module = types.ModuleType("entrant")
    module.__file__ = file
    sys.modules["entrant"] = module
    observers, states = [], 0
    while True:
        kind, message = requests.recv()
        answer = b""
        if kind == "load":
            exec(compile(message, file, "exec"), module.__dict__)
            module.Observer  # noqa: B018 - the name that a file has to define
        elif kind == "start":
            states = len(message[0][0]["a"])
            observers = [module.Observer() for _ in message]
            for observer, (model, noise, sample_time) in zip(observers, message, strict=True):
                observer.start(types.SimpleNamespace(**model), types.SimpleNamespace(**noise), sample_time)
        else:
            for number, given, measured in zip(*message, strict=True):
                estimate = observers[number].step(given, measured)
                if estimate is None:
                    raise ValueError("step returns nothing; it has to return the estimate")
                estimate = np.asarray(estimate)
                if estimate.dtype.kind not in "fiu":
                    raise ValueError(f"an estimate of {estimate.dtype}, not of real numbers")
                estimate = estimate.astype(float)
                if estimate.shape != (states,):
                    raise ValueError(f"an estimate of shape {estimate.shape}, not ({states},)")
                answer += estimate.tobytes()
        if offences:
            raise PermissionError(offences[0])
        answers.send_bytes(b"+" + answer)


def _place(error: BaseException, file: str) -> str:
    """Line of the observer's file that the error came through last; the error may be of the observer's answer."""
    lines, step = [], error.__traceback__
    while step:
        if step.tb_frame.f_code.co_filename == file:
            lines.append(step.tb_lineno)
        step = step.tb_next
    return f" (line {lines[-1]})" if lines else ""


def main() -> int:
    """Serve one file until the referee closes the pipe."""
    file, folder, toolbox, *numbers = sys.argv[1:]
    requests, answers = (Connection(int(number)) for number in numbers)
    offences: list[str] = []
    warnings.simplefilter("ignore")  # an overflow on the way is no print
    import numpy  # noqa: F401 - its libraries are no offence

    sys.stdout = sys.stderr = _Loud(offences)
    _limit()
    installed = tuple(os.path.realpath(each) + os.sep for each in (sys.prefix, sys.base_prefix))
    links = tuple(each + os.sep for each in (sys.prefix, sys.base_prefix, folder, toolbox))
    # An import lists the folders that it looks in, numba asks for the processor.
    single = (file, toolbox, *map(os.path.abspath, sys.path), "/dev/urandom", "/dev/null", "/proc/cpuinfo")
    _watch(offences, (*installed, *links), single)
    try:
        _serve(file, requests, answers, offences)
    except EOFError:  # the referee has seen enough
        return 0
    except MemoryError:
        reason = "allocates more memory than it may"
    except BaseException as error:  # whatever a stranger's code may raise
        reason = offences[0] if offences else f"raises {type(error).__name__}: {error}{_place(error, file)}"
    answers.send_bytes(b"-" + reason.encode(errors="replace")[:500])
    return 1


if __name__ == "__main__":
    os._exit(main())
