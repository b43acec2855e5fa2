"""The process of an observer from a file: it answers one scan, sample by sample, in lines of JSON.

It runs as a script of its own, imports nothing of the contest and is given nothing but the file, the nominal model and
the measurements. `contest.runner` puts it into namespaces of its own.
"""

import base64
import ctypes
import errno
import json
import os
import platform
import struct
import sys
import types
import warnings

FILE = os.path.abspath("entrant")  # in the working folder


class Library:
    """A shared library with `observer_start` and `observer_step` as an ``Observer``; `docs/contest.md` has the header."""

    def __init__(self, path: str):
        self.library = ctypes.CDLL(path)

    def start(self, model, noise, sample_time, *settings):
        import numpy as np

        sizes = (*model.b.shape, len(model.c))
        arrays = (model.a, model.b, model.c, noise.process, noise.sensor)
        self.states, self.settings = sizes[0], np.array(settings, dtype=float)
        self.library.observer_start(
            *map(ctypes.c_int, sizes),
            *(each.ctypes.data_as(ctypes.c_void_p) for each in arrays),
            ctypes.c_double(sample_time),
            ctypes.c_int(len(settings)),
            self.settings.ctypes.data_as(ctypes.c_void_p),
        )

    def step(self, input, measurement):
        import numpy as np

        estimate = np.empty(self.states)
        arrays = (input, measurement, estimate)
        self.library.observer_step(*(each.ctypes.data_as(ctypes.c_void_p) for each in arrays))
        return estimate


def load(content: bytes, is_library: bool) -> tuple:
    """A new observer of a file's content, and the knobs that it declares."""
    with open(FILE, "wb") as file:  # a compiler looks for it, too
        file.write(content)
    if is_library:
        return Library(FILE), ()
    module = types.ModuleType("entrant")
    module.__file__ = FILE
    sys.modules["entrant"] = module
    exec(compile(content, FILE, "exec"), module.__dict__)
    return module.Observer(), getattr(module, "KNOBS", ())


def checked(estimate, states: int) -> list[float]:
    """An estimate as a list of so many real numbers."""
    import numpy as np

    if estimate is None:
        raise ValueError("step returns nothing; it has to return the estimate")
    estimate = np.asarray(estimate)
    if estimate.dtype.kind not in "fiu":
        raise ValueError(f"an estimate of {estimate.dtype}, not of real numbers")
    if estimate.shape != (states,):
        raise ValueError(f"an estimate of shape {estimate.shape}, not ({states},)")
    if not np.isfinite(estimate).all():
        raise ValueError("an estimate that is not finite")
    return estimate.astype(float).tolist()


def place(error: BaseException) -> str:
    """Line of the observer's file that the error came through last; the error may be of the observer's answer."""
    lines, step = [], error.__traceback__
    while step:
        if step.tb_frame.f_code.co_filename == FILE:
            lines.append(step.tb_lineno)
        step = step.tb_next
    return f" (line {lines[-1]})" if lines else ""


def serve(requests, answers) -> None:
    """One scan: the file, then what is known of the machine, then samples until nothing more comes."""
    import numpy as np

    def answer(message) -> None:
        answers.write(json.dumps(message) + "\n")
        answers.flush()

    try:
        first = json.loads(requests.readline())
        observer, knobs = load(base64.b64decode(first["content"]), first["library"])
        answer({"knobs": [list(knob) for knob in knobs]})
        if line := requests.readline():
            given = json.loads(line)
            model, noise = (
                types.SimpleNamespace(
                    **{
                        name: np.array(x, dtype=float) if isinstance(x, list) else x
                        for name, x in given[part].items()
                    }
                )
                for part in ("model", "noise")
            )
            observer.start(model, noise, given["sample_time"], *given["settings"])
            answer({})
        for line in requests:
            taken = (
                np.array(each, dtype=float) for each in json.loads(line)
            )  # null, where it is lost, is NaN
            answer(checked(observer.step(*taken), len(model.a)))
    except MemoryError:
        answer({"error": "allocates more memory than it may"})
    except BaseException as error:  # whatever an entrant's code may raise
        answer({"error": f"raises {type(error).__name__}: {error}{place(error)}"[:500]})


def restrict() -> bool:
    """Let this process start threads, but no process, whose time might not count, and leave no sign to other scans.

    Signs are keys of the kernel, locks, leases and watches of files that all see, and sockets beyond its network. By a
    filter of system calls that nothing lifts again; returns whether the machine has it.
    """
    # Refused: fork, vfork; keyrings; unshare, setns; flock, inotify, fanotify, io_uring, which knows other ways.
    numbers = {
        "x86_64": (0xC000003E, 56, 72, 41, (57, 58, 248, 249, 250, 272, 308, 73, 253, 294, 300, 425)),
        "aarch64": (0xC00000B7, 220, 25, 198, (217, 218, 219, 97, 268, 32, 26, 262, 425)),
    }
    if sys.platform != "linux" or platform.machine() not in numbers:
        return False
    architecture, clone, fcntl, socket, refused = numbers[platform.machine()]
    load, equal, above, bit, end = 0x20, 0x15, 0x35, 0x45, 0x06  # of the kernel's filter language
    allow, denied, unknown = 0x7FFF0000, 0x50000 + errno.EPERM, 0x50000 + errno.ENOSYS
    steps = [(load, 0, 0, 4), (equal, 1, 0, architecture), (end, 0, 0, denied), (load, 0, 0, 0)]
    steps += [(above, 0, 1, 0x40000000), (end, 0, 0, denied)]  # another numbering of the same processor
    for call in refused:
        steps += [(equal, 0, 1, call), (end, 0, 0, denied)]
    # Of two calls some values of an argument: locks, leases and notices of files, by its second; the socket of a virtual
    # machine, by its first.
    for call, place, values in ((fcntl, 24, (5, 6, 7, 36, 37, 38, 1024, 1026)), (socket, 16, (40,))):
        steps += [(equal, 0, 2 * len(values) + 2, call), (load, 0, 0, place)]
        for value in values:
            steps += [(equal, 0, 1, value), (end, 0, 0, denied)]
        steps += [(end, 0, 0, allow)]
    # clone3 hides its flags; the C library then takes clone, which may start a thread.
    steps += [(equal, 0, 1, 435), (end, 0, 0, unknown), (equal, 1, 0, clone), (end, 0, 0, allow)]
    steps += [(load, 0, 0, 16), (bit, 0, 1, 0x10000), (end, 0, 0, allow)]
    code = b"".join(struct.pack("HBBI", *step) for step in [*steps, (end, 0, 0, denied)])
    held = ctypes.create_string_buffer(code, len(code))
    program = struct.pack("HxxxxxxQ", len(code) // 8, ctypes.addressof(held))
    libc = ctypes.CDLL(None)
    # No new privileges; then the filter. Numbers without an end would be taken for those of 32 bits.
    rest = [ctypes.c_ulong(0)] * 3
    first = libc.prctl(38, ctypes.c_ulong(1), *rest)
    return first == 0 and libc.prctl(22, ctypes.c_ulong(2), ctypes.c_char_p(program), *rest[1:]) == 0


def main() -> None:
    """Keep the pipes to the runner apart from what the observer may print, and serve."""
    requests, answers = os.fdopen(os.dup(0), encoding="ascii"), os.fdopen(os.dup(1), "w", encoding="ascii")
    nothing = os.open(os.devnull, os.O_RDWR)
    for standard in range(3):
        os.dup2(nothing, standard)
    warnings.simplefilter("ignore")
    restrict()
    serve(requests, answers)


if __name__ == "__main__":
    sys.exit(not restrict()) if "--probe" in sys.argv else main()
