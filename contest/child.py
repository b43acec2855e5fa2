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
GUARD = 64  # numbers behind a library's estimate, which it has to leave alone


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
            *(array.ctypes.data_as(ctypes.c_void_p) for array in arrays),
            ctypes.c_double(sample_time),
            ctypes.c_int(len(settings)),
            self.settings.ctypes.data_as(ctypes.c_void_p),
        )

    def step(self, input, measurement):
        import numpy as np

        estimate = np.full(self.states + GUARD, np.nan)
        arrays = (input, measurement, estimate)
        self.library.observer_step(*(array.ctypes.data_as(ctypes.c_void_p) for array in arrays))
        if not np.isnan(estimate[self.states :]).all():
            raise ValueError(f"an estimate of more than {self.states} states")
        return estimate[: self.states]


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


def as_answer(estimate, states: int) -> list[float]:
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
    """Line of the observer's file that the error came through last; the error may be in the observer's output."""
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
            answer(as_answer(observer.step(*taken), len(model.a)))
    except MemoryError:
        answer({"error": "allocates more memory than it may"})
    except BaseException as error:  # whatever an entrant's code may raise
        answer({"error": f"raises {type(error).__name__}: {error}{place(error)}"[:500]})


# System calls that an observer needs, with their numbers on x86_64 and on aarch64; -1 where there is none.
CALLS = """
    read 0 63, write 1 64, open 2 -1, close 3 57, stat 4 -1, fstat 5 80, lstat 6 -1, poll 7 -1, lseek 8 62, mmap 9 222,
    mprotect 10 226, munmap 11 215, brk 12 214, rt_sigaction 13 134, rt_sigprocmask 14 135, rt_sigreturn 15 139,
    pread64 17 67, pwrite64 18 68, readv 19 65, writev 20 66, access 21 -1, select 23 -1, sched_yield 24 124,
    mremap 25 216, msync 26 227, dup 32 23, dup2 33 -1, nanosleep 35 101, alarm 37 -1, setitimer 38 103, getpid 39 172,
    exit 60 93, kill 62 129, uname 63 160, fsync 74 82, ftruncate 77 46, getdents 78 -1, getcwd 79 17, chdir 80 49,
    rename 82 -1, mkdir 83 -1, rmdir 84 -1, unlink 87 -1, symlink 88 -1, readlink 89 -1, chmod 90 -1, fchmod 91 52,
    gettimeofday 96 169, getrlimit 97 163, getrusage 98 165, times 100 153, getuid 102 174, getgid 104 176,
    geteuid 107 175, getegid 108 177, getppid 110 173, rt_sigpending 127 136, rt_sigtimedwait 128 137,
    rt_sigsuspend 130 133, sigaltstack 131 132, prctl 157 167, arch_prctl 158 -1, setrlimit 160 164, gettid 186 178,
    tkill 200 130, time 201 -1, sched_setaffinity 203 122, sched_getaffinity 204 123, getdents64 217 61,
    set_tid_address 218 96, restart_syscall 219 128, clock_gettime 228 113, clock_getres 229 114,
    clock_nanosleep 230 115, exit_group 231 94, tgkill 234 131, openat 257 56, mkdirat 258 34, newfstatat 262 79,
    unlinkat 263 35, renameat 264 38, symlinkat 266 36, readlinkat 267 78, fchmodat 268 53, faccessat 269 48,
    pselect6 270 72, ppoll 271 73, set_robust_list 273 99, utimensat 280 88, dup3 292 24, prlimit64 302 261,
    getcpu 309 168, renameat2 316 276, getrandom 318 278, membarrier 324 283, rseq 334 293,
    faccessat2 439 439
"""
# Calls that it needs with some values of one argument: the number of the argument, then values or a bit it has to have.
# A clone is a thread; no lock, lease or notice of a file; no page of a file thrown out; waits of its own threads alone.
BY_VALUE = {"fcntl 72 25": (1, (0, 1, 2, 3, 4, 1030)), "madvise 28 233": (2, (0, 4, 8, 14, 15))}
BY_BIT = {"clone 56 220": (0, 0x10000, errno.EPERM), "futex 202 98": (1, 0x80, errno.EAGAIN)}
ARCHITECTURES = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}


def _filter(machine: str) -> bytes:
    """A seccomp filter that allows these system calls; any other fails as if it did not exist."""
    load, equal, above, bit, end = 0x20, 0x15, 0x35, 0x45, 0x06  # of the kernel's filter language
    allow, refuse = 0x7FFF0000, 0x50000
    column = 1 + list(ARCHITECTURES).index(machine)

    def number(call: str) -> int:
        return int(call.split()[column])

    steps = [(load, 0, 0, 4), (equal, 1, 0, ARCHITECTURES[machine]), (end, 0, 0, refuse + errno.EPERM)]
    steps += [(load, 0, 0, 0), (above, 0, 1, 0x40000000), (end, 0, 0, refuse + errno.EPERM)]  # other numbers
    for call in CALLS.split(","):
        if number(call) >= 0:
            steps += [(equal, 0, 1, number(call)), (end, 0, 0, allow)]
    for call, (place, values) in BY_VALUE.items():
        steps += [(equal, 0, 2 * len(values) + 2, number(call)), (load, 0, 0, 16 + 8 * place)]
        for value in values:
            steps += [(equal, 0, 1, value), (end, 0, 0, allow)]
        steps += [(end, 0, 0, refuse + errno.EPERM)]
    for call, (place, mask, reason) in BY_BIT.items():
        steps += [(equal, 0, 4, number(call)), (load, 0, 0, 16 + 8 * place)]
        steps += [(bit, 0, 1, mask), (end, 0, 0, allow), (end, 0, 0, refuse + reason)]
    return b"".join(struct.pack("HBBI", *step) for step in [*steps, (end, 0, 0, refuse + errno.ENOSYS)])


def restrict() -> bool:
    """Leave this process the system calls of computing: none by which scans could communicate with each other or with another process.

    It may start threads, but no process, whose time might not count. Nothing lifts the filter again; returns whether the
    machine has it.
    """
    if sys.platform != "linux" or platform.machine() not in ARCHITECTURES:
        return False
    code = _filter(platform.machine())
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
