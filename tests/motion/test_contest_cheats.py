"""What an observer might try to know more than it is given: each is harmless, or disqualifies it."""

import contextlib
import ctypes
import os
import socket
import textwrap
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from contest import bench, runner, scores
from contest.nominal import nominal_of
from contest.plants import plant_of
from contest.runner import Disqualified, ExternalObserver, can_isolate, declared_knobs
from contest.scores import opened
from contest.table import run_contest
from stillwork.base.checks import InputError
from workbook import paths

pytestmark = pytest.mark.slow
isolated = pytest.mark.skipif(not can_isolate(), reason="this machine has no namespaces for an observer")
SECRET = "contest/uncertainties.py"


@pytest.fixture
def given():
    plant = plant_of("drive")
    return *nominal_of(plant, 1.0), plant.sample_time


OBSERVER = """
import ctypes, gc, glob, os, socket, sys, time
import numpy as np
ROOT, SECRET = {root!r}, {secret!r}
def trick():
{body}
class Observer:
    def start(self, model, noise, sample_time):
        self.states = len(model.a)
    def step(self, input, measurement):
        return np.full(self.states, float(trick()))
"""


@pytest.fixture
def estimate(tmp_path, given):
    """The estimates of an observer at some samples; `trick` is the body of a function that returns what it gained."""

    def run(trick, samples=1, name="mine.py"):
        body = textwrap.indent(textwrap.dedent(trick).strip(), " " * 4)
        file = tmp_path / name
        file.write_text(OBSERVER.format(body=body, root=str(paths.root()), secret=SECRET))
        with ExternalObserver(file) as observer:
            observer.start(*given)
            return [observer.step(np.zeros(1), np.zeros(1)) for _ in range(samples)]

    return run


KEEP_COUNT = """
count = 0
for place in {*map(os.path.realpath, ("/tmp", ".", "/dev/shm", "/var/tmp", os.path.dirname(np.__file__)))}:
    try:
        with open(os.path.join(place, "count"), "a+") as file:
            file.seek(0)
            count += len(file.read())
            file.write("x")
    except OSError:
        pass
return count
"""
CHEATS = {
    "an ancestor's command line": """
        seen = [open(each, "rb").read() for each in glob.glob("/proc/[0-9]*/cmdline")]
        return sum(b"child.py" not in each and b"" != each for each in seen)
    """,
    "the parent's memory and files": """
        found = os.getppid()
        for each in ("root/", "environ", "mem", "cwd/"):
            found += sum(os.path.exists(f"{place}/{each}{SECRET}") for place in glob.glob("/proc/[0-9]*"))
        return found
    """,
    "objects that the garbage collector knows": """
        arrays = [each for each in gc.get_objects() if isinstance(each, np.ndarray)]
        return any(each.size > 1000 for each in arrays) or any(name.startswith("contest") for name in sys.modules)
    """,
    "frames and what they close over": """
        frame, seen = sys._getframe(), []
        while frame:
            for value in list(frame.f_locals.values()):
                cells = getattr(value, "__closure__", None) or ()
                seen += [value, *(cell.cell_contents for cell in cells)]
            frame = frame.f_back
        return any(isinstance(each, np.ndarray) and each.size > 100 for each in seen)
    """,
    "the C library's open and system": """
        libc = ctypes.CDLL(None)
        opened = libc.open(f"{ROOT}/{SECRET}".encode(), 0)
        return (opened >= 0) + (libc.system(f"cat {ROOT}/{SECRET}".encode()) == 0)
    """,
    "a symbolic link in the working folder": """
        if not os.path.islink("way"):
            os.symlink(ROOT, "way")
        return os.path.exists(f"way/{SECRET}")
    """,
    "the environment": """
        return len(set(os.environ) - {"PATH", "LANG", "PYTHONPATH", "HOME", "TMPDIR", "PYTHONDONTWRITEBYTECODE", "PWD",
            "NUMBA_CACHE_DIR", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS",
            "OLDPWD", "SHLVL", "_"})
    """,
    "a table written beside the packages": """
        written = 0
        for place in (os.path.dirname(np.__file__), sys.prefix, "/usr/lib", ROOT + "/lib/stillwork"):
            try:
                open(place + "/table", "w").close()
                written += 1
            except OSError:
                pass
        return written
    """,
    "a setting of the kernel": """
        files = [*glob.glob("/proc/sys/kernel/*"), *glob.glob("/proc/sys/vm/*"), *glob.glob("/proc/*")]
        written = 0
        for each in filter(os.path.isfile, files):
            try:
                os.close(os.open(each, os.O_WRONLY))
                written += 1
            except OSError:
                pass
        return written
    """,
    "a system call of the 32-bit numbering": """
        import mmap
        if os.uname().machine != "x86_64":
            return 0
        page = mmap.mmap(-1, 4096, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC)
        page.write(bytes.fromhex("53b802000000cd805bc3"))  # push rbx; mov eax, 2; int 0x80; pop rbx; ret: fork
        address = ctypes.addressof(ctypes.c_char.from_buffer(page))
        mine, started = os.getpid(), ctypes.CFUNCTYPE(ctypes.c_int)(address)()
        if os.getpid() != mine:
            os._exit(0)
        return started > 0
    """,
    "limits that are raised": """
        import resource
        raised = 0
        for each in (resource.RLIMIT_CPU, resource.RLIMIT_AS, resource.RLIMIT_FSIZE):
            try:
                resource.setrlimit(each, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
                raised += 1
            except (ValueError, OSError):
                pass
        return raised
    """,
    "a program that takes this one's place, and filters of its own": """
        libc = ctypes.CDLL(None)
        libc.prctl(22, 1, 0, 0, 0)  # strict mode instead of the filter
        return libc.fork() >= 0 if libc.prctl(21, 0, 0, 0, 0) == 2 else 1
    """,
    "the parent's memory by its number": """
        libc = ctypes.CDLL(None)
        own, there = ctypes.create_string_buffer(8), (ctypes.c_uint64 * 2)(0x400000, 8)
        here = (ctypes.c_uint64 * 2)(ctypes.addressof(own), 8)
        others = [k for k in range(2, 400) if k != os.getpid()]
        return sum(libc.process_vm_readv(k, here, 1, there, 1, 0) > 0 or libc.ptrace(16, k, 0, 0) == 0 for k in others)
    """,
    "signals to everybody": """
        sent = 0
        for each in (-1, os.getppid() or 1 << 20, *range(2, 50)):
            try:
                os.kill(each, 0)
                sent += each != os.getpid()
            except OSError:
                pass
        return sent
    """,
    "memory shared by a key": """
        libc = ctypes.CDLL(None)
        return sum(libc.shmget(key, 0, 0) >= 0 for key in (0x5EED, 1, 2, 3))
    """,
    "a socket without a file": """
        try:
            with socket.socket(socket.AF_UNIX) as s:
                return s.connect_ex("\\0contest-of-observers") == 0
        except OSError:
            return 0
    """,
    "roots of other processes and devices": """
        places = [*glob.glob("/proc/[0-9]*/root/home"), *glob.glob("/proc/[0-9]*/fd/*")]
        leads = {os.readlink(each) for each in places if os.path.islink(each)}
        return sum(each.startswith(ROOT) for each in leads) + len(set(os.listdir("/dev")) - {"null", "urandom"})
    """,
    "another file system mounted": """
        libc = ctypes.CDLL(None)
        return libc.mount(b"none", b"/tmp", b"proc", 0, None) == 0
    """,
    "a socket of any kind": """
        opened = 0
        for family, kind in ((1, 1), (1, 2), (2, 1), (2, 2), (10, 1), (16, 3), (17, 3), (38, 5), (40, 1)):
            for call in (socket.socket, socket.socketpair):
                try:
                    call(family, kind).close()
                    opened += 1
                except OSError:
                    pass
        return opened
    """,
    "the times and rights of a device": """
        changed = 0
        for change in (lambda: os.utime("/dev/null", (5, 5)), lambda: os.chmod("/dev/null", 0o666)):
            try:
                change()
                changed += 1
            except OSError:
                pass
        return changed
    """,
    "which pages of a file are in memory": """
        libc, file = ctypes.CDLL(None), open(np.__file__, "rb")
        libc.mmap.restype = ctypes.c_void_p
        libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, *[ctypes.c_int] * 3, ctypes.c_long]
        place, seen = ctypes.c_void_p(libc.mmap(None, 4096, 1, 1, file.fileno(), 0)), (ctypes.c_ubyte * 1)()
        gained = libc.mincore(place, 4096, seen) == 0
        for way in (lambda: os.preadv(file.fileno(), [bytearray(1)], 0, os.RWF_NOWAIT),
                    lambda: os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)):
            try:
                way()
                gained += 1
            except OSError:
                pass
        return gained + sum(libc.madvise(place, 4096, advice) == 0 for advice in (20, 21))
    """,
    "the machine's counters": """
        held, seen = ctypes.create_string_buffer(4096), 0
        for each in ("stat", "loadavg", "meminfo", "sys/fs/file-nr", "sys/fs/inode-nr", "self/maps", "self/ns/net"):
            seen += os.path.lexists("/proc/" + each)
        return seen + (ctypes.CDLL(None).sysinfo(held) == 0) + (ctypes.CDLL(None).statfs(b"/usr", held) == 0)
    """,
    "the number of the next mount": """
        # A number that is never used again grows by as much with each scan.
        number, held = {"x86_64": 332, "aarch64": 291}[os.uname().machine], ctypes.create_string_buffer(256)
        return ctypes.CDLL(None).syscall(number, -100, b"/tmp", 0, 0x5000, held) == 0
    """,
    "the number of the next pipe": """
        made = 0
        for way in (os.pipe, lambda: os.memfd_create("x"), lambda: os.eventfd(0)):
            try:
                way()
                made += 1
            except OSError:
                pass
        return made
    """,
}


@isolated
@pytest.mark.parametrize("cheat", CHEATS)
def test_a_cheat_gains_nothing(cheat, estimate):
    assert estimate(CHEATS[cheat])[0].tolist() == [0.0] * 4


@isolated
def test_what_another_process_shares_by_name_is_out_of_reach(estimate):
    """The key and the socket are there outside, where the cheats above look for them in vain."""
    libc = ctypes.CDLL(None)
    shared = libc.shmget(0x5EED, 4096, 0o1666)
    with socket.socket(socket.AF_UNIX) as server:
        server.bind("\0contest-of-observers")
        server.listen()
        try:
            assert shared >= 0 and libc.shmget(0x5EED, 0, 0) == shared
            for cheat in ("memory shared by a key", "a socket without a file"):
                assert estimate(CHEATS[cheat])[0].tolist() == [0.0] * 4
        finally:
            libc.shmctl(shared, 0, None)


@pytest.mark.parametrize("name", ["seed", "score", "a|b", "oracle", "Kalman", "x\n1"])
def test_a_name_that_would_spoil_the_table_is_refused(name, tmp_path):
    file = tmp_path / f"{name}.py"
    file.write_text("class Observer: pass\n")
    with pytest.raises(InputError, match="name"):
        run_contest("a test", 1, [str(file)])


def test_an_estimate_that_overflows_is_only_a_bad_one():
    states = np.ones((bench.SAMPLES, 4))
    record = bench.ScanRecord(states[:, :1], states[:, :1], states)
    assert bench.state_errors(record, np.full((bench.SAMPLES, 4), 1e300), 1) == (np.inf, np.inf)


@isolated
def test_a_scan_cannot_be_counted(estimate):
    """What is written on one scan is not there on the next: in no file, in no module."""
    assert [estimate(KEEP_COUNT)[0][0] for _ in range(2)] == [0.0, 0.0]


@isolated
def test_a_scan_leaves_no_key_in_the_session(estimate):
    # As after a login, where all scans would have one keyring.
    ctypes.CDLL(None).syscall({"x86_64": 250, "aarch64": 219}[os.uname().machine], 1, None)
    assert [estimate(KEEP_KEY)[0][0] for _ in range(2)] == [0.0, 0.0]


SIGNS = {
    "a lock": ("fcntl.flock(file, 6)", "fcntl.flock(file, 6)"),
    "a lock of bytes": ("fcntl.lockf(file, 5, 1, 7)", "look(fcntl.F_GETLK)"),
    "a lock of an open file": ("fcntl.fcntl(file, 37, record(fcntl.F_RDLCK))", "look(36)"),
    "a lease": ("fcntl.fcntl(file, fcntl.F_SETLEASE, fcntl.F_RDLCK)", "fcntl.fcntl(file, 1024, 0)"),
    "a notice of access": ("fcntl.fcntl(os.open(folder, 0), fcntl.F_NOTIFY, 1 << 31 | 1)", "raise OSError"),
    "a watch": (
        "assert libc.inotify_add_watch(libc.inotify_init(), folder.encode(), 1) >= 0",
        "raise OSError",
    ),
    "a ring of calls": ("assert libc.syscall(425, 4, (ctypes.c_char * 200)()) >= 0", "raise OSError"),
    "a socket of a virtual machine": ("socket.socket(40, 1).bind((2**32 - 1, 5555))", "socket.socket(40, 1)"),
}
SIGN = """
import fcntl, struct
libc, folder = ctypes.CDLL(None), os.path.dirname(np.__file__)
record = lambda kind: struct.pack("hhqqi4x", kind, 0, 7, 1, 0)
def look(command):
    if struct.unpack("hhqqi4x", fcntl.fcntl(file, command, record(fcntl.F_WRLCK)))[0] != fcntl.F_UNLCK:
        raise BlockingIOError
try:
    file = globals().setdefault("kept", open(np.__file__))
    {}
    return 1
except BlockingIOError:
    return 2
except (OSError, AssertionError):
    return 0
"""


@isolated
@pytest.mark.parametrize("sign", SIGNS)
def test_scans_that_overlap_give_each_other_no_sign(sign, tmp_path, given):
    """On a file that both see, read-only as it is."""
    found = []
    with contextlib.ExitStack() as running:
        for who, step in enumerate(SIGNS[sign]):
            body = textwrap.indent(SIGN.replace("{}", step, 1).strip(), " " * 4)
            file = tmp_path / f"of_{who}.py"
            file.write_text(OBSERVER.format(body=body, root=str(paths.root()), secret=SECRET))
            observer = running.enter_context(ExternalObserver(file))
            observer.start(*given)
            found.append(observer.step(np.zeros(1), np.zeros(1))[0])
    assert found == [0.0, 0.0]


# What all processes of a user, or of the machine, have in common: one step takes of it, the other looks what is left.
SHARED = {
    "a page of a file that somebody waits on": (
        "threading.Thread(target=wait, daemon=True).start()",
        "wake()",
    ),
    "signals that may be queued": ("queue(10**6)", "queue(1000)"),
    "asynchronous reads that may be begun": ("[ring(4096) for _ in range(99)]", "ring(1024)"),
    "pages that pipes may have": ("kept.extend(wide() for _ in range(99))", "wide()"),
    "names of sockets": ("named()", "named()"),
}
USE = """
import fcntl, signal, threading
libc = ctypes.CDLL(None)
libc.mmap.restype = ctypes.c_void_p
libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, *[ctypes.c_int] * 3, ctypes.c_long]
futex, begin = {"x86_64": (202, 206), "aarch64": (98, 0)}[os.uname().machine]
kept = globals().setdefault("kept", [open(np.__file__, "rb")])
page = libc.mmap(None, 4096, 1, 1, kept[0].fileno(), 0)
def wait():
    libc.syscall(futex, ctypes.c_void_p(page), 0, ctypes.c_int.from_address(page).value, None, None, 0)
def wake():
    return max(libc.syscall(futex, ctypes.c_void_p(page), 1, 9, None, None, 0), 0)
def queue(most):
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGRTMIN])
    mine, kind, value = os.getpid(), int(signal.SIGRTMIN), ctypes.c_long(1)
    return next((k for k in range(most) if libc.sigqueue(mine, kind, value)), most)
def ring(size):
    return libc.syscall(begin, size, ctypes.byref(ctypes.c_ulong(0))) == 0
def wide():
    try:
        kept.append(os.pipe())
        return fcntl.fcntl(kept[-1][1], 1031, 1 << 20)
    except OSError:
        return 0
def named():
    try:
        kept.append(socket.socket(socket.AF_UNIX))
        kept[-1].bind("\\0observers")
        return 1
    except OSError:
        return 0
step = {}
time.sleep(0.2)
return step or 0
"""


@isolated
@pytest.mark.parametrize("what", SHARED)
def test_what_scans_that_overlap_have_in_common_is_no_sign(what, tmp_path, given):
    """What is left is the same whether another scan takes of it or not."""

    def scan(step, running):
        file = tmp_path / f"of_{len(list(tmp_path.iterdir()))}.py"
        body = textwrap.indent(USE.replace("{}", f"[{step}][0]", 1).strip(), " " * 4)
        file.write_text(OBSERVER.format(body=body, root=str(paths.root()), secret=SECRET))
        observer = running.enter_context(ExternalObserver(file))
        observer.start(*given)
        return observer.step(np.zeros(1), np.zeros(1))[0]

    take, look = SHARED[what]
    with contextlib.ExitStack() as running:
        before = scan(look, running)
    with contextlib.ExitStack() as running:
        scan(f"({take}, 0)[1]", running)
        assert scan(look, running) == before == 0


def test_scans_of_files_do_not_overlap_so_that_load_is_no_sign(given, monkeypatch):
    running, most = [], []

    class Slow:
        def __init__(self, source):
            self.source = source

        def __enter__(self):
            running.append(self.source)
            most.append(len(running))
            return self

        def __exit__(self, *_):
            running.remove(self.source)

        def start(self, *_):
            time.sleep(0.05)

    def scan(k):
        with opened(f"observer {k}", f"{k}.py", given, ()):
            pass

    monkeypatch.setattr(scores, "ExternalObserver", Slow)
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(scan, range(4)))
    assert most == [1] * 4


@isolated
def test_no_program_of_this_machine_can_be_asked(estimate):
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.2)
        ask = f"""
        try:
            with socket.socket() as s:
                s.settimeout(1)
                return s.connect_ex(("127.0.0.1", {server.getsockname()[1]})) == 0
        except OSError:
            return 0
        """
        assert estimate(ask)[0][0] == 0.0
        with pytest.raises(TimeoutError):
            server.accept()


@isolated
def test_who_imports_the_contest_is_out(estimate):
    with pytest.raises(Disqualified, match=r"raises (ModuleNotFound|Import)Error: .*contest"):
        estimate("import contest.uncertainties")


@pytest.mark.parametrize(
    ("trick", "reason"),
    [
        ("raise ValueError('no idea')", r"raises ValueError: no idea \(line 6\)"),
        ("return np.nan", "raises ValueError: an estimate that is not finite"),
        ("return 1j", "raises TypeError"),
        ("os._exit(0)", "its process ends"),
        (
            r"raise ValueError('\x1b[2J\n1 mine\n')",
            r"ValueError: \?\[2J\?1 mine\? \(line 6\)$",
        ),  # a rank of its own
        ("return [np.empty(10**8) for _ in range(1000)]", "allocates more memory"),
        ("while True: pass", "takes more than 1 s of the processor"),
        ("time.sleep(60)", "hangs: a scan takes more than 3 s"),
        ("time.sleep(1.6); return 0", "hangs: a scan takes more than 3 s"),  # each answer in time
        ("os.write(4, b'look\\n')", "JSON"),
        ("os.write(4, b'[[1], [2, 3]]\\n')", "no estimate"),
        ("os.write(4, b'[' * 100000 + b'\\n')", "JSON"),
        ("[os.write(4, bytes(1 << 16)) for _ in range(100)]", "more than"),
    ],
)
def test_who_breaks_the_rules_is_out_by_reason(trick, reason, estimate, monkeypatch):
    if "processor" in reason or "hangs" in reason:
        monkeypatch.setattr(runner, "CPU_SECONDS", 1)
        monkeypatch.setattr(runner, "PATIENCE", 20 if "processor" in reason else 3)
    with pytest.raises(Disqualified, match=reason):
        estimate(trick, samples=2)


BUSY = """
import atexit
ctypes.CDLL(None).prctl(1, 0)  # it would die with its parent
atexit.register(time.sleep, 1000)
while time.process_time() < 1.2:
    pass
return 0
"""
KEEP_KEY = """
libc, session = ctypes.CDLL(None), -3
add, control = {"x86_64": (248, 250), "aarch64": (217, 219)}[os.uname().machine]
found = libc.syscall(control, 10, session, b"user", b"scans", 0) > 0
libc.syscall(add, b"user", b"scans", b"x", ctypes.c_size_t(1), session)
return found
"""


FORKS = {
    "of Python": "os.fork()",
    "of the C library": "libc.fork()",
    "of the kernel": "libc.syscall({'x86_64': 57, 'aarch64': 220}[os.uname().machine], 17, 0, 0, 0, 0)",
    "that shares its memory": "libc.syscall({'x86_64': 58, 'aarch64': 220}[os.uname().machine], 0x4111, 0, 0, 0, 0)",
    "as a clone": "libc.syscall({'x86_64': 56, 'aarch64': 220}[os.uname().machine], 17, 0, 0, 0, 0)",
    "as a clone of another numbering": "libc.syscall(0x40000000 + 56, 17, 0, 0, 0, 0)",
    "as a clone by structure": "libc.syscall(435, ctypes.byref((ctypes.c_uint64 * 11)(0, 0, 0, 0, 17)), 88)",
    "spawned": "os.posix_spawn(sys.executable, [sys.executable, '-c', 'pass'], {})",
    "of a program": "__import__('subprocess').Popen([sys.executable, '-c', 'pass']).pid",
    "in namespaces of its own": "libc.unshare(0x10000000)",
}
FORK = """
import signal
signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits, so nobody is charged
libc, mine = ctypes.CDLL(None), os.getpid()
try:
    started = {}
except OSError:
    started = -1
if os.getpid() != mine:
    while time.process_time() < 20:
        pass
    os._exit(0)
return started >= 0
"""


@isolated
@pytest.mark.parametrize("way", FORKS)
def test_no_process_can_be_started_whose_time_would_not_count(way, estimate):
    assert estimate(FORK.replace("{}", FORKS[way], 1))[0].tolist() == [0.0] * 4


@isolated
def test_threads_may_run_and_their_time_counts(estimate, monkeypatch):
    opened, end = [], ExternalObserver._end
    monkeypatch.setattr(
        ExternalObserver, "_end", lambda self, patience: [opened.append(self), end(self, patience)]
    )
    spend = """
        import threading
        def work():
            while time.thread_time() < 0.7:
                pass
        both = [threading.Thread(target=work) for _ in range(2)]
        [each.start() for each in both], [each.join() for each in both]
        return 1
    """
    assert estimate(spend)[0].tolist() == [1.0] * 4
    assert opened[0].cpu_seconds > 1.4


@isolated
def test_who_does_not_end_is_ended_and_its_time_counts(estimate, monkeypatch):
    opened, end = [], ExternalObserver._end
    monkeypatch.setattr(
        ExternalObserver, "_end", lambda self, patience: [opened.append(self), end(self, patience)]
    )
    estimate(BUSY)
    assert opened[0].cpu_seconds > 1.2


def test_an_observer_may_print_compile_and_look_at_the_clock(estimate):
    trick = """
        import numba
        from stillwork.base.kernels import kernel
        print("look", file=sys.stderr)
        return kernel(lambda x: x / 2)(numba.njit(lambda x: 2 * x)(3.0)) * (time.perf_counter() > 0)
    """
    assert estimate(trick)[0].tolist() == [3.0] * 4


def test_knobs_are_what_a_file_declares(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text("KNOBS = [('size', 0.1, 10.0, 1.0)]\nclass Observer: pass\n")
    assert declared_knobs(file) == (("size", 0.1, 10.0, 1.0),)
    assert declared_knobs("tcp:127.0.0.1:1") == ()


MANY = {"knobs": [["a", 1, 3, 2]] * 33}  # the tuner would take for ever


@pytest.mark.parametrize(
    "answer", [5, {}, {"knobs": 3}, {"knobs": [["a"]]}, {"knobs": [["a", -1, 2, 1]]}, MANY]
)
def test_knobs_that_are_none_are_out(answer):
    with pytest.raises(Disqualified, match="KNOBS"):
        runner.knobs_of(answer)
