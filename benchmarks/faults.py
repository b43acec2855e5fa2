"""Random faults in builds and accepts of a toy workbook, and what stands after each.

What stands must be wholly the old or wholly the new version, nothing stale may pass for fresh, exit code and
message must agree with it, nothing may be left behind, and the next undisturbed build must give a clean one's
bytes. What a notebook must give is computed here from the present sources, without the runner.

A fault is drawn from ``--seed`` and its number alone, so ``--only NUMBER`` repeats one. Processes of the runner are
forked from one that has its imports; kernels are real ones. Where it may (as root), the toy stands on a small
tmpfs that is really filled up; elsewhere a limit on the size of files stands for a full disk.
"""

import argparse
import atexit
import contextlib
import errno
import gc
import hashlib
import json
import os
import pickle
import py_compile
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import psutil

TESTS = Path(__file__).parents[1] / "tests"
sys.path.insert(0, str(TESTS))

from engine import toy as toys  # noqa: E402

FIRST, SECOND, OTHER = NOTEBOOKS = ("isolation/01-first", "isolation/02-second", "motion/01-first")
READS = "rig = paths.data('{}', 'rig.toml').read_text()", "written = (folder / 'rig.csv').write_text(rig)"
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
STALL_S = 200.0  # a kernel that does not come up is given up after 120 s
NOISE = re.compile(r"^Traceback|asyncio|Task was destroyed|Exception ignored", re.MULTILINE)
# Messages of a kernel that cannot start.
LAST_WORDS = re.compile(
    r"^Traceback .*\n  File .*kernel_process.py.*, in (?:<module>|_become_kernel)\n(?!    warm)(?: .*\n)*(?:\S.*\n?)?",
    re.MULTILINE,
)
CHANGED = ("notebooks", "data", "figures", "build", "lib/experiments/isolation", "lib/experiments/motion")

Files = dict[str, bytes]


# What a notebook must give, and what stands of it.


def sources(root: Path, name: str) -> tuple[str, str, str]:
    """Seed, gain and rig of a notebook, as its sources have them now."""
    topic = name.partition("/")[0]
    cells = json.loads((root / "notebooks" / f"{name}.ipynb").read_text())["cells"]
    seed = re.search(r"seed: int = (\d+)", next(c["source"] for c in cells if c["id"] == "parameters"))[1]
    gain = re.search(r"([\d.]+) \* level", (root / f"lib/experiments/{topic}/model.py").read_text())[1]
    return seed, gain, (root / f"data/{topic}/rig.toml").read_text()


def expected(state: tuple[str, str, str]) -> Files:
    seed, gain, rig = state
    return {"out.csv": f"{seed},{float(gain)}\n".encode(), "rig.csv": rig.encode()}


def standing(root: Path, name: str) -> Files | None:
    """Every file of a notebook's results; None where there are none."""
    target = root / "build/figures" / name
    return contents(target) if target.is_dir() else None


def contents(folder: Path) -> Files:
    """Every file below `folder`; a link that leads nowhere is a file that holds nothing."""
    found = {}
    for place, _, names in os.walk(folder):
        for file in (Path(place, name) for name in names):
            with contextlib.suppress(OSError):
                found[file.relative_to(folder).as_posix()] = b""
                found[file.relative_to(folder).as_posix()] = file.read_bytes()
    return found


def whole(files: Files) -> bool:
    """Whether a record describes exactly these files."""
    try:
        record = json.loads(files["record.json"])
        seal = record.pop("seal")
        outputs = record["outputs"]
    except (ValueError, TypeError, AttributeError, KeyError):
        return False
    sealed = hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest() == seal
    there = {name: hashlib.sha256(text).hexdigest() for name, text in files.items() if name != "record.json"}
    return sealed and there == outputs


def holds(files: Files, state: tuple[str, str, str]) -> bool:
    return all(files.get(name) == text for name, text in expected(state).items())


# Processes of the runner.


@dataclass
class Run:
    """A command of the runner that is under way, in a session of its own."""

    pid: int
    log: Path
    code: int | None = None
    copying: subprocess.Popen | None = None

    def wait(self) -> int:
        """Its exit code, negative for a signal; it is killed when it stalls."""
        end = time.monotonic() + STALL_S
        while self.code is None:
            done, status = os.waitpid(self.pid, os.WNOHANG)
            if done:
                self.code = os.waitstatus_to_exitcode(status)
            elif time.monotonic() > end:
                os.killpg(self.pid, signal.SIGKILL)
                os.waitpid(self.pid, 0)
                raise Broken(f"stalled: {self.said()[-300:]}")
            else:
                time.sleep(0.005)
        if self.copying:
            self.copying.wait(STALL_S)
        return self.code

    def said(self) -> str:
        return self.log.read_text(errors="replace")

    def signal(self, number: int, group: bool = False) -> None:
        if self.code is None:
            with contextlib.suppress(ProcessLookupError):
                (os.killpg if group else os.kill)(self.pid, number)


class Broken(Exception):
    """What a fault broke."""


def _end(call: Callable[[], int]) -> None:
    """End a forked process with the exit code of `call`, as Python ends one of its own."""
    code = 1
    try:
        code = call()
    except SystemExit as ended:
        code = ended.code
    except BaseException:
        traceback.print_exc()
    try:
        threading._shutdown()
        atexit._run_exitfuncs()
        sys.stdout.flush()
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(code)


@dataclass
class Bench:
    """A worker's toy, its saved states, and ways to run the runner on it."""

    home: Path
    mounted: bool
    toy: toys.Toy
    seconds: float = 2.0  # of an undisturbed build
    clean: dict[tuple, Files] = field(default_factory=dict)
    steps: dict[str, int] = field(default_factory=dict)
    runs: int = 0

    @property
    def root(self) -> Path:
        return self.toy.root

    def fork(self, *arguments: str, before: Callable = lambda: None, root: Path | None = None) -> Run:
        """Run a command as ``python -m stillwork`` does, `before` it something in its process."""
        from stillwork.__main__ import main

        return self.fork_call(lambda: main(list(arguments)), before, root)

    def fork_call(self, call: Callable, before: Callable = lambda: None, root: Path | None = None) -> Run:
        self.runs += 1
        log = self.home / "logs" / f"{self.runs % 4}"
        log.unlink(missing_ok=True)
        descriptor, copying = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND), None
        # Without a disk to fill it is files that are limited: then the output goes through a process that writes it.
        if not self.mounted:
            copying = subprocess.Popen(["cat"], stdin=subprocess.PIPE, stdout=descriptor, bufsize=0)
            os.dup2(copying.stdin.fileno(), descriptor)
            copying.stdin.close()
        if pid := os.fork():
            os.close(descriptor)
            with contextlib.suppress(OSError):
                os.setpgid(pid, pid)
            return Run(pid, log, copying=copying)
        with contextlib.suppress(OSError):
            os.setsid()
        os.dup2(descriptor, 1)
        os.dup2(descriptor, 2)
        os.close(descriptor)
        os.environ.update(TOY_MARK=self.toy.mark, TOY=str(self.root))
        if root:
            os.environ["STILLWORK_ROOT"] = str(root)
        os.chdir(root or self.root)
        before()
        _end(call)

    def run(self, *arguments: str, root: Path | None = None) -> tuple[int, str]:
        run = self.fork(*arguments, root=root)
        return run.wait(), run.said()

    def restore(self, saved: str, root: Path | None = None, folders: tuple[str, ...] = CHANGED) -> None:
        root = root or self.root
        for folder in folders:
            shutil.rmtree(root / folder, ignore_errors=True)
            if (self.home / saved / folder).is_dir():
                shutil.copytree(self.home / saved / folder, root / folder, symlinks=True)
        for each in [*self.toy.temporary.iterdir(), root / "build/accepting"]:
            shutil.rmtree(each, ignore_errors=True)

    def save(self, saved: str, root: Path | None = None, folders: tuple[str, ...] = CHANGED) -> None:
        for folder in folders:
            if ((root or self.root) / folder).is_dir():
                shutil.copytree((root or self.root) / folder, self.home / saved / folder, symlinks=True)

    def states(self) -> dict[str, tuple]:
        return {name: sources(self.root, name) for name in NOTEBOOKS}

    def results(self) -> dict[str, Files | None]:
        return {name: standing(self.root, name) for name in NOTEBOOKS}

    def children(self) -> list[psutil.Process]:
        return self.toy.processes()

    def build(self, *names: str) -> str:
        """An undisturbed build, of some notebooks or all."""
        begin = time.monotonic()
        code, said = self.run("figures", *names, "--jobs", "2")
        if not names:
            self.seconds = 0.8 * self.seconds + 0.2 * (time.monotonic() - begin)
        if code or NOISE.search(said):
            raise Broken(f"the next build: exit code {code}: {said[-600:]}")
        return said

    def clean_files(self, name: str) -> Files:
        """What a build from nothing gives, without the record; each notebook's state of the sources is built once."""
        states = self.states()
        if missing := [state for state, now in states.items() if (state, now) not in self.clean]:
            kept = self.root / "kept"
            (self.root / "build").rename(kept)
            try:
                self.build(*missing)
                for each in missing:
                    self.clean[each, states[each]] = without_record(standing(self.root, each))
            finally:
                shutil.rmtree(self.root / "build", ignore_errors=True)
                kept.rename(self.root / "build")
        return self.clean[name, states[name]]


# Faults.


def edit(bench: Bench, draw: random.Random, often: float = 0.5) -> None:
    """Change the sources of at least one notebook, in a few ways."""
    ways = [
        lambda: bench.toy.replace(f"notebooks/{FIRST}.ipynb", "seed: int = 1", "seed: int = 2"),
        lambda: bench.toy.replace("lib/experiments/isolation/model.py", "2.0", "3.0"),
        lambda: bench.toy.write("data/isolation/rig.toml", "mass = 2.0\n"),
        lambda: bench.toy.replace("lib/experiments/motion/model.py", "2.0", "3.0"),
    ]
    for way in [w for w in ways if draw.random() < often] or [draw.choice(ways)]:
        way()


def step_hook(place: Path, at: int, act: Callable, count: list[int]) -> Callable:
    """Install in a forked process: `act` at the change number `at` of the file system below `place`."""

    def install():
        names = ("open", "os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.symlink", "os.link")

        def hook(event, arguments):
            if event not in names:
                return
            if event == "open" and not (isinstance(arguments[1], str) and set("wax+") & set(arguments[1])):
                return
            paths = [a for a in arguments if isinstance(a, str | os.PathLike)]
            if event not in ("os.rmdir", "os.remove") and not any(
                str(p).startswith(str(place)) for p in paths
            ):
                return
            count[0] += 1
            if count[0] == at:
                act(event, *map(Path, paths))

        sys.addaudithook(hook)

    return install


def killer(number: int) -> Callable:
    return lambda *_: os.kill(os.getpid(), number)


def no_topic(event: str, *_paths: Path) -> None:
    if event not in ("os.remove", "os.rmdir"):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def count_steps(bench: Bench, what: str, start: Callable[[Callable], Run], place: Path) -> int:
    """How many changes of the file system an undisturbed run makes; counted once."""
    if what not in bench.steps:
        note = bench.home / "steps"
        count = [0]

        def install():
            step_hook(place, 0, lambda *_: None, count)()
            atexit.register(lambda: note.write_text(str(count[0])))

        start(install).wait()
        bench.steps[what] = int(note.read_text())
    return bench.steps[what]


def limited(size: int, kill: bool) -> Callable:
    """Writing ends at `size` bytes of a file: with an error, or with the process in the midst of it."""

    def install():
        if kill:
            signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))

    return install


@contextlib.contextmanager
def filled(place: Path, left: int) -> Iterator[Callable]:
    """Leave so many bytes of the file system of `place`; yields what gives the rest back."""
    ballast = place / ".ballast"
    with ballast.open("wb") as file:
        free = os.statvfs(place).f_bavail * os.statvfs(place).f_frsize
        with contextlib.suppress(OSError):
            os.posix_fallocate(file.fileno(), 0, max(free - left, 1))

    def empty():
        ballast.unlink(missing_ok=True)

    try:
        yield empty
    finally:
        empty()


def random_files(draw: random.Random, version: str) -> Files:
    names = draw.sample(
        ["a.csv", "b.png", "claims.json", "deep/c.csv", "deep/er/d.csv", "e.csv"], draw.randint(1, 6)
    )
    return {name: version.encode() * draw.choice([0, 1, 100, 9000, 200_000]) for name in names}


def publish_fault(bench: Bench, draw: random.Random, way: str) -> str:
    """One notebook's results, cut."""
    from workbook.publish import replace_record, tidy

    place = bench.root / "build" / "bench"
    shutil.rmtree(place, ignore_errors=True)
    target = place / "topic" / "01-x"
    old, new = random_files(draw, "old"), random_files(draw, "newer")
    there = draw.random() < 0.8
    if there:
        replace_record(target, old, {"cell a": "1"})
    elif draw.random() < 0.5:
        target.mkdir(parents=True)  # not ours
    before = contents(target) if target.is_dir() else None

    def call() -> int:
        try:
            replace_record(target, new, {"cell a": "2"})
        except OSError:
            return 1
        return 0

    code = disturbed(
        bench, draw, way, lambda install: bench.fork_call(call, install), place, 8 + 3 * len({**old, **new})
    )
    now = contents(target) if target.is_dir() else None
    inputs = json.loads(now["record.json"])["inputs"]["cell a"] if now and whole(now) else None
    stands = "new" if inputs == "2" and without_record(now) == new else "old" if now == before else "half"
    if stands == "half" and not there:
        stands = "old" if now in (None, {}) else "half"
    if stands == "half":
        raise Broken(f"half of {sorted(now or {})}")
    if code >= 0 and code != (stands == "old"):
        raise Broken(f"exit code {code}, but the {stands} version stands")
    tidy(target)
    beside = os.listdir(place / "topic" / ".01-x") if (place / "topic" / ".01-x").exists() else []
    if len(beside) > (target.is_symlink()):
        raise Broken(f"left behind: {beside}")
    replace_record(target, new, {"cell a": "2"})
    if without_record(contents(target)) != new:
        raise Broken("the next one differs")
    shutil.rmtree(place)
    return stands


def without_record(files: Files) -> Files:
    return {name: text for name, text in files.items() if name != "record.json"}


def disturbed(
    bench: Bench, draw: random.Random, way: str, start: Callable[[Callable], Run], place: Path, steps: int
) -> int:
    """Run something with a fault of its own making; returns its exit code."""
    if way == "killed":
        number = draw.choice(SIGNALS[:2])
        return start(step_hook(place, draw.randint(1, steps), killer(number), [0])).wait()
    if way == "fails":
        return start(step_hook(place, draw.randint(1, steps), no_topic, [0])).wait()
    if way == "half":
        return start(limited(int(10 ** draw.uniform(0, 5.5)), True)).wait()
    if not bench.mounted:
        return start(limited(int(10 ** draw.uniform(0, 5.5)), False)).wait()
    with filled(bench.root, draw.choice([0, 4096, int(10 ** draw.uniform(3.6, 6))])):
        return start(lambda: None).wait()


def accepted_files(root: Path) -> Files:
    return {
        n: t
        for n, t in contents(root).items()
        if n.split("/")[0] in ("notebooks", "data", "figures", "README.md")
    }


def accept_again(bench: Bench) -> tuple[Path, Files, Files]:
    """The toy that is to be accepted, its accepted files, and those to be accepted."""
    root = bench.root / "accept"
    bench.restore("accepted", root, CHANGED[:4])
    shutil.copy(bench.home / "accepted" / "README.md", root)
    return root, accepted_files(root), bench.clean["accepted"]


def accept_fault(bench: Bench, draw: random.Random, way: str) -> str:
    """A whole accept, cut."""
    root, old, new = accept_again(bench)

    def start(install) -> Run:
        return bench.fork("accept", before=install, root=root)

    steps = bench.steps["accept"]
    if way == "signal":
        number = draw.choice(SIGNALS)
        run = start(step_hook(root, draw.randint(1, steps), killer(number), [0]))
        code = run.wait()
    elif way == "parallel":
        run = start(lambda: None)
        time.sleep(draw.uniform(0, 0.2))
        other = bench.fork("figures", root=root)
        code, other_code = run.wait(), other.wait()
        for each in (run, other):
            if NOISE.search(each.said()):
                raise Broken(each.said()[-400:])
        if other_code not in (0, 2) or code not in (0, 2):
            raise Broken(f"exit codes {code} and {other_code}: {run.said()[-300:]}")
        if code == 2 and other_code == 2:
            raise Broken("both refused")
    else:
        code = disturbed(bench, draw, way, start, root, steps)
        run = Run(0, bench.home / "logs" / f"{bench.runs % 4}")
    said = run.said()
    if NOISE.search(said):
        raise Broken(said[-500:])
    at_once, in_part = accepted_files(root), "stillwork: accepted in part" in said
    if code >= 0:
        right = {
            0: at_once == new and "accepted 2" in said,
            1: at_once == old and "nothing accepted" in said,
            2: in_part or (at_once == old and "stillwork: " in said),
        }.get(code, at_once in (old, new) and code - 128 in SIGNALS)
        if not right:
            what = "old" if at_once == old else "new" if at_once == new else "half"
            raise Broken(f"exit code {code}, the {what} state is in place: {said[-300:]}")
    code, said = bench.run("figures", root=root)
    if code or not said.startswith("nothing to do"):
        raise Broken(f"the next build: {said[-300:]}")
    now = accepted_files(root)
    code, said = bench.run("accept", root=root)  # after a kill among the renames it writes the rest
    if code or accepted_files(root) != new:
        raise Broken(f"the next accept: {code} {said[-300:]}")
    if (root / "build/accepting").exists():
        raise Broken("left behind: build/accepting")
    return "old" if now == old else "new"


def edited_accept(bench: Bench, draw: random.Random) -> str:
    """A file is changed, added or removed at a step of an accept; it must stay like that.

    The moment between the last look at a place and the accept's own rename is left out.
    """
    root, old, new = accept_again(bench)
    if "edits" not in bench.steps:  # those after the tree has been read
        count_steps(bench, "edits", lambda hook: bench.fork("accept", before=hook, root=root), root)
        root, old, new = accept_again(bench)
    steps = bench.steps["edits"]
    name = draw.choice(
        [*(n for n in {**old, **new} if old.get(n) != new.get(n)), "data/motion/rig.toml", "data/own"]
    )
    way = draw.choice(["in place", "in place", "by a rename", "removed"])
    file, note, mine = root / name, bench.home / "edited", b"\n"
    note.unlink(missing_ok=True)

    def edit(event: str, *paths: Path) -> None:
        base = file.read_bytes() if file.exists() else None
        if (event in ("os.rename", "os.remove") and file in paths) or (way == "removed" and base is None):
            return
        if way == "removed":
            file.unlink()
        elif way == "in place" and base is not None:
            with file.open("ab") as stream:
                stream.write(mine)
        else:
            beside = file.with_name("~")
            beside.write_bytes((base or b"") + mine)
            beside.rename(file)
        note.write_bytes(pickle.dumps((base, None if way == "removed" else (base or b"") + mine)))

    at = draw.choice([draw.randint(1, steps), draw.randint(steps // 2, steps)])  # the places come late
    run = bench.fork("accept", before=step_hook(root, at, edit, [0]), root=root)
    code, said, now = run.wait(), run.said(), accepted_files(root)
    if NOISE.search(said):
        raise Broken(said[-500:])
    base, theirs = pickle.loads(note.read_bytes()) if note.exists() else (now.get(name), now.get(name))
    what = f"{name} {way} at step {at}, exit code {code}: {said[-300:]}"
    if now.get(name) != theirs:
        raise Broken(f"what they left is gone: {what}")
    others = [{n: text for n, text in files.items() if n != name} for files in (now, old, new)]
    if others[0] != others[2 if code == 0 else 1]:
        raise Broken(f"half accepted: {what}")
    if (
        code == 0
        and name in {**old, **new}
        and new.get(name) not in (base, theirs)
        and old.get(name) != new.get(name)
    ):
        raise Broken(f"accepted beside an older file: {what}")
    if code and "changed while accepting: " + name not in said and "stale: " not in said and code != 2:
        raise Broken(f"refused for another reason: {what}")
    return "new" if code == 0 else "old"


def damage(draw: random.Random, place: Path) -> str:
    """Harm something of what builds made below `place`; returns what."""
    files = [p for p in sorted(place.rglob("*")) if not p.is_dir() or p.is_symlink()]
    homes = sorted(p for p in place.glob("*/.*") if p.is_dir())
    for home in homes:
        for version in home.iterdir():
            files += sorted(p for p in version.rglob("*") if p.is_file())
    file = draw.choice(files) if files else place / "x"
    way = draw.choice(
        [
            "empty",
            "truncate",
            "byte",
            "remove",
            "record",
            "extra",
            "folder",
            "topic",
            "link",
            "dangling",
            "all",
            "plain",
        ]
    )
    if way in ("empty", "truncate", "byte") and file.is_file():
        text = file.read_bytes()
        cut = draw.randrange(len(text)) if text else 0
        flipped = text[:cut] + bytes([text[cut] ^ 1 << draw.randrange(8)]) + text[cut + 1 :] if text else b""
        file.write_bytes({"empty": b"", "truncate": text[:cut], "byte": flipped}[way])
    elif way == "remove" and files:
        file.unlink()
    elif way == "record":
        for record in draw.sample(homes, min(1, len(homes))):
            for each in record.glob("*/record.json"):
                each.write_text(
                    draw.choice(["{}", "[]", "null", "", "0", '"x"', '{"seal": ""}', "\0", "[" * 100_000])
                )
    elif way == "extra":
        extra = file.parent / draw.choice(["extra.csv", "deep/extra.csv", ".hidden"])
        extra.parent.mkdir(exist_ok=True)
        extra.write_text("1,2\n")
    elif way == "folder" and homes:
        shutil.rmtree(draw.choice(homes))
    elif way == "topic" and place.is_dir():
        shutil.rmtree(draw.choice([p for p in place.iterdir() if p.is_dir()] or [place]))
    elif way in ("link", "dangling"):
        links = sorted(p for p in place.glob("*/*") if p.is_symlink())
        for link in draw.sample(links, min(1, len(links))):
            link.unlink()
            if way == "dangling":
                link.symlink_to(draw.choice(["nowhere", ".", str(place), f".{link.name}", link.name]))
    elif way == "all":
        shutil.rmtree(place.parent, ignore_errors=True)  # another harm may have taken it
    elif way == "plain" and file.is_file():
        name = file.parent / file.name
        name.unlink()
        draw.choice([name.mkdir, lambda: name.symlink_to("nowhere"), lambda: name.symlink_to(name.name)])()
    return way


def judged(
    bench: Bench,
    before: dict,
    possible: list[dict],
    runs: list[Run],
    sent: set[int],
    harmed: bool = False,
    changing: bool = False,
    ending: bool = False,
    harmed_since: Collection[str] = (),
) -> str:
    """Hold what stands after a fault against what must; returns which version stands.

    What was harmed when it had been built (`harmed_since`) may have been reported as built; the next build detects it.
    """
    for run in runs:
        run.wait()
    with contextlib.suppress(AssertionError):
        toys.until(lambda: not bench.children(), 30)
    if stray := bench.children():
        raise Broken(f"stray processes: {[p.cmdline()[-4:] for p in stray]}")
    said = "".join(run.said() for run in runs)
    if NOISE.search(LAST_WORDS.sub("", said) if ending else said):
        raise Broken(said[-1500:])
    now = bench.results()
    versions = {}
    for name, files in now.items():
        new = files is not None and whole(files) and any(holds(files, state[name]) for state in possible)
        versions[name] = "old" if files == before[name] else "new" if new else "half"
        if versions[name] == "half" and not harmed:
            raise Broken(f"half of {name}: {sorted(files or {})}")
    for name in set(re.findall(r"^built (\S+) in", said, re.MULTILINE)) - set(harmed_since):
        if versions[name] == "half" or (
            not changing and not harmed and not holds(now[name] or {}, sources(bench.root, name))
        ):
            raise Broken(f"reported as built, but is not: {name}")
    for name in re.findall(r"^FAILED (\S+)", said, re.MULTILINE):
        if versions[name] != "old" and len(runs) == 1 and not harmed:
            raise Broken(f"reported as failed, but was changed: {name}")
    for run in runs:
        code, text = run.code, run.said()
        right = {
            0: "FAILED" not in text and ("0 failed" in text or "nothing to do" in text),
            1: "FAILED" in text and " 0 failed" not in text,
            2: "stillwork: " in text,
        }
        if not right.get(code, -code in sent or code - 128 in sent):
            raise Broken(f"exit code {code}: {text[-500:]}")
        if code == 0 and not changing and not harmed:
            for name, files in now.items():
                if not holds(files or {}, sources(bench.root, name)):
                    raise Broken(f"exit code 0, but {name} is not built")
    check_fresh(bench, now)
    recover(bench)
    return "old" if "old" in versions.values() else "new"


def check_fresh(bench: Bench, now: dict[str, Files | None]) -> None:
    """Nothing that is called up to date may be harmed, or differ from what the present sources give."""
    code, said = bench.run("figures", "--why")
    if code or NOISE.search(said):
        raise Broken(f"--why: {code} {said[-500:]}")
    for name in re.findall(r"^(\S+): up to date", said, re.MULTILINE):
        if now[name] is None or not whole(now[name]) or not holds(now[name], sources(bench.root, name)):
            raise Broken(f"called up to date: {name}")


def recover(bench: Bench) -> None:
    """Build undisturbed; it must give what a clean build gives and leave nothing behind."""
    for each in bench.toy.temporary.iterdir():
        os.utime(each, (0, 0))  # as if some time had passed
    bench.build()
    for name in NOTEBOOKS:
        files = standing(bench.root, name) or {}
        if not whole(files) or not holds(files, sources(bench.root, name)):
            raise Broken(
                f"the next build gives something else for {name}: {files.get('out.csv')}, {files.get('rig.csv')}"
            )
        if without_record(files) != bench.clean_files(name):
            raise Broken(f"the next build differs from a clean one in {name}")
    if left := [leftover for leftover in bench.toy.leftovers() if "/accept/" not in leftover]:
        raise Broken(f"left behind: {left}")


def signalled(bench: Bench, draw: random.Random, whom: str) -> str:
    bench.restore("built")
    before, old = bench.results(), bench.states()
    edit(bench, draw, 1.0 if whom == "warm" else 0.5)
    number = draw.choice(SIGNALS)
    if whom == "started":  # with its imports
        process = subprocess.Popen(
            bench.toy.command("figures", "--jobs", "2"), cwd=bench.root, env=bench.toy.environment(),
            stdout=(bench.home / "logs/started").open("w"), stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip
        run = Run(process.pid, bench.home / "logs/started")
        time.sleep(draw.uniform(0.4, 0.8 + bench.seconds))
        run.signal(number, draw.random() < 0.5)
        stands = judged(bench, before, [old, bench.states()], [run], {number})
        process.returncode = 0
        return stands
    if whom == "step":

        def start(install):
            return bench.fork("figures", "--jobs", "2", before=install)

        steps = (
            count_steps(bench, "build", start, bench.root / "build")
            if "build" not in bench.steps
            else bench.steps["build"]
        )
        if before != bench.results():
            bench.restore("built")
            before = bench.results()
            edit(bench, draw)
        act = draw.choice([*(killer(each) for each in SIGNALS), no_topic])
        run = start(step_hook(bench.root / "build", draw.randint(1, steps), act, [0]))
        return judged(bench, before, [old, bench.states()], [run], set(SIGNALS))
    run = bench.fork("figures", "--jobs", "2")
    if whom == "driver":
        time.sleep(draw.uniform(0.02, bench.seconds))
        run.signal(number, draw.random() < 0.5)
        return judged(bench, before, [old, bench.states()], [run], {number})
    with contextlib.suppress(AssertionError):
        toys.until(lambda: bench.children(), 5)
    time.sleep(draw.uniform(0, bench.seconds / 2))
    found = bench.children()
    warms = [p for p in found if "warm" in words(p) and not is_child(p, found)]
    chosen = warms if whom == "warm" else [p for p in found if p not in warms] or warms
    for process in draw.sample(chosen, min(1, len(chosen))):
        with contextlib.suppress(psutil.NoSuchProcess):
            process.send_signal(number)
    return judged(bench, before, [old, bench.states()], [run], set(), ending=whom == "kernel")


def words(process: psutil.Process) -> list[str]:
    try:
        return process.cmdline()
    except psutil.Error:
        return []


def is_child(process: psutil.Process, of: list[psutil.Process]) -> bool:
    try:
        return process.ppid() in {each.pid for each in of}
    except psutil.Error:
        return True


def temporary_fault(bench: Bench, draw: random.Random) -> str:
    """What kernels work in is emptied, in parts or whole, in mid-build."""
    bench.restore("built")
    before, old = bench.results(), bench.states()
    edit(bench, draw)
    run = bench.fork("figures", "--jobs", "2")
    time.sleep(draw.uniform(0.02, bench.seconds))
    way = draw.choice(["all", "all", "files", "reads", "truncate", "connection"])
    place = bench.toy.temporary
    if way == "all":
        for each in place.iterdir():
            shutil.rmtree(each, ignore_errors=True)
    else:
        for each in sorted(place.rglob("*")):
            wanted = {"reads": ("reads",), "truncate": ("reads",), "connection": ("kernel",)}.get(way)
            with contextlib.suppress(OSError):
                if not each.is_dir() and (wanted is None or each.name.startswith(wanted)):
                    os.truncate(
                        each, draw.choice([0, each.stat().st_size // 2])
                    ) if way == "truncate" else each.unlink()
    return judged(bench, before, [old, bench.states()], [run], set(), ending=True)


def two_at_once(bench: Bench, draw: random.Random) -> str:
    bench.restore("built")
    before, old = bench.results(), bench.states()
    edit(bench, draw)
    runs = [bench.fork("figures", "--jobs", "1")]
    time.sleep(draw.choice([0, draw.uniform(0, bench.seconds)]))
    runs.append(bench.fork("figures", "--jobs", "1"))
    return judged(bench, before, [old, bench.states()], runs, set(), changing=True)


def edited(bench: Bench, draw: random.Random) -> str:
    """Sources change in mid-build, and may be put back, with the times they had."""
    bench.restore("built")
    before, old = bench.results(), bench.states()
    edit(bench, draw)
    possible = [old, bench.states()]
    file, one, other = draw.choice(
        [
            ("lib/experiments/isolation/model.py", "* level", "* level * 1.0"),
            ("lib/experiments/isolation/model.py", draw.choice(["2.0", "3.0"]), "5.0"),
            (f"notebooks/{FIRST}.ipynb", "seed: int = ", "seed: int = 7"),
            ("data/isolation/rig.toml", "mass = ", "mass = 4"),
        ]
    )
    path = bench.root / file
    text, stat = path.read_text(), path.stat()
    run = bench.fork("figures", "--jobs", "2")
    time.sleep(draw.uniform(0.02, 0.9 * bench.seconds))
    replaced = draw.random() < 0.5

    def put(content: str) -> None:
        if replaced:
            beside = path.with_name("." + path.name)
            beside.write_text(content)
            beside.rename(path)
        else:
            path.write_text(content)
        if keep_time:
            os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))

    keep_time = draw.random() < 0.3
    put(text.replace(one, other))
    possible.append(bench.states())
    if draw.random() < 0.5:
        time.sleep(draw.uniform(0, bench.seconds / 2))
        put(text)
    return judged(bench, before, possible, [run], set(), changing=True)


def clocks(bench: Bench, draw: random.Random) -> str:
    """Times of change far in the past and in the future, then edits that keep size and time."""
    bench.restore("built")
    before, old = bench.results(), bench.states()
    for file in sorted(bench.root.rglob("*")):
        if "accept" not in file.parts and draw.random() < 0.3:
            at = draw.choice([0, 10**9, time.time() + draw.uniform(-1e6, 1e8)])
            os.utime(file, (at, at), follow_symlinks=False)
    code, said = bench.run("figures", "--why")
    if code or said.count("up to date") != len(NOTEBOOKS):
        raise Broken(f"a time of change made something stale: {said}")
    kept = {p: p.stat().st_mtime_ns for p in bench.root.glob("lib/stillwork/*/model.py")}
    edit(bench, draw)
    for file, at in kept.items():
        os.utime(file, ns=(at, at))
    run = bench.fork("figures", "--jobs", "2")
    return judged(bench, before, [old, bench.states()], [run], set())


def stale_bytecode(bench: Bench, draw: random.Random) -> str:
    """Bytecode of another source, of the same size and time of change, lies beside a module."""
    bench.restore("built")
    before, old = bench.results(), bench.states()
    edit(bench, draw)
    for model in bench.root.glob("lib/stillwork/*/model.py"):
        text, stat = model.read_text(), model.stat()
        model.write_text(re.sub(r"[\d.]+ \* level", "9.0 * level", text))
        os.utime(model, ns=(stat.st_atime_ns, stat.st_mtime_ns))
        py_compile.compile(str(model))
        model.write_text(text)
        os.utime(model, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    run = bench.fork("figures", "--jobs", "2")
    return judged(bench, before, [old, bench.states()], [run], set())


def full_build(bench: Bench, draw: random.Random) -> str:
    """The disk is full where results go, or where kernels work; perhaps for a while only."""
    bench.restore("built")
    before, old = bench.results(), bench.states()
    edit(bench, draw)
    states = [old, bench.states()]
    if not bench.mounted:
        run = bench.fork("figures", "--jobs", "2", before=limited(int(10 ** draw.uniform(0, 4)), False))
        return judged(bench, before, states, [run], set(), ending=True)
    place = draw.choice([bench.root, bench.toy.temporary])
    with filled(place, draw.choice([0, 4096, int(10 ** draw.uniform(3.6, 5.3))])) as empty:
        run = bench.fork("figures", "--jobs", "2")
        if draw.random() < 0.5:
            time.sleep(draw.uniform(0.02, bench.seconds))
            empty()
        run.wait()
    return judged(bench, before, states, [run], set(), ending=True)


def damaged(bench: Bench, draw: random.Random) -> str:
    """What builds made is harmed between two builds."""
    bench.restore("built")
    states = [bench.states()]
    for _ in range(draw.randint(1, 3)):
        damage(draw, bench.root / "build/figures")
    before = bench.results()
    run = bench.fork("figures", "--jobs", "2")
    return judged(bench, before, states, [run], set(), harmed=True)


def damaged_meanwhile(bench: Bench, draw: random.Random) -> str:
    bench.restore("built")
    before, old = bench.results(), bench.states()
    edit(bench, draw)
    shown = versions_shown(bench)
    run = bench.fork("figures", "--jobs", "2")
    time.sleep(draw.uniform(0.02, bench.seconds))
    done = {name for name, version in versions_shown(bench).items() if version != shown[name]}
    with contextlib.suppress(OSError):
        damage(draw, bench.root / "build/figures")
    return judged(bench, before, [old, bench.states()], [run], set(), harmed=True, harmed_since=done)


def versions_shown(bench: Bench) -> dict[str, str]:
    """By notebook, which version of its results stands in its place."""
    places = {name: bench.root / "build/figures" / name for name in bench.results()}
    return {name: os.readlink(place) if place.is_symlink() else "" for name, place in places.items()}


# Of every 2,000.
KINDS: dict[str, tuple[int, Callable[[Bench, random.Random], str]]] = {
    "publish: killed at a step": (200, lambda b, d: publish_fault(b, d, "killed")),
    "publish: killed in a write": (150, lambda b, d: publish_fault(b, d, "half")),
    "publish: the disk is full at a step": (150, lambda b, d: publish_fault(b, d, "fails")),
    "publish: disk full": (100, lambda b, d: publish_fault(b, d, "full")),
    "accept: signal at a step": (100, lambda b, d: accept_fault(b, d, "signal")),
    "accept: killed in a write": (50, lambda b, d: accept_fault(b, d, "half")),
    "accept: the disk is full at a step": (50, lambda b, d: accept_fault(b, d, "fails")),
    "accept: disk full": (50, lambda b, d: accept_fault(b, d, "full")),
    "accept: parallel build": (30, lambda b, d: accept_fault(b, d, "parallel")),
    "accept: edited meanwhile": (100, edited_accept),
    "build: signal at a step": (60, lambda b, d: signalled(b, d, "step")),
    "build: signal to the driver": (60, lambda b, d: signalled(b, d, "driver")),
    "build: signal while it starts": (20, lambda b, d: signalled(b, d, "started")),
    "build: signal to a kernel": (40, lambda b, d: signalled(b, d, "kernel")),
    "build: signal to the warmed process": (30, lambda b, d: signalled(b, d, "warm")),
    "build: TMPDIR emptied": (40, temporary_fault),
    "build: two at once": (20, two_at_once),
    "build: sources edited meanwhile": (50, edited),
    "build: clock set back or forward": (20, clocks),
    "build: stale bytecode": (15, stale_bytecode),
    "build: disk full": (35, full_build),
    "build: results harmed before": (60, damaged),
    "build: results harmed meanwhile": (20, damaged_meanwhile),
}


def plan(faults: int) -> list[str]:
    """Kinds of so many faults, mixed, each in its proportion."""
    total = sum(weight for weight, _ in KINDS.values())
    counts = {kind: max(1, round(faults * weight / total)) for kind, (weight, _) in KINDS.items()}
    places = [((number + 0.5) / count, kind) for kind, count in counts.items() for number in range(count)]
    return [kind for _, kind in sorted(places)]


# Workers.


def prepare(home: Path) -> bool:
    """A built toy below `home`, and a second one to accept; returns whether it stands on a disk that can be filled."""
    root, temporary = home / "root", home / "tmp"
    for each in (root, temporary, home / "logs"):
        each.mkdir(parents=True)
    mount = ["mount", "-t", "tmpfs", "-o"]
    mounted = subprocess.run([*mount, "size=64m", "tmpfs", root], capture_output=True).returncode == 0
    mounted = (
        mounted
        and subprocess.run([*mount, "size=2m", "tmpfs", temporary], capture_output=True).returncode == 0
    )
    toy = toys.make(root)
    toy.temporary.rmdir()
    for name in NOTEBOOKS:
        toy.add(name, *(read.format(name.partition("/")[0]) for read in READS))
    return mounted


def work(home: Path, mounted: bool, chosen: list[tuple[int, str]], seed: int) -> None:
    """Inject the chosen faults, a line of JSON each on standard output."""
    toy = toys.Toy(home / "root", home / "tmp")
    bench = Bench(home, mounted, toy)
    import papermill  # noqa: F401

    from workbook import accept, compare  # noqa: F401
    from workbook.site import derived  # noqa: F401

    gc.freeze()
    if any(kind.startswith("build") for _, kind in chosen):
        bench.build()
        bench.save("built")
    if any(kind.startswith("accept") for _, kind in chosen):
        prepare_accept(bench)
    for number, kind in chosen:
        draw = random.Random(f"{seed} {number} {kind}")
        begin = time.monotonic()
        try:
            stands, broken = KINDS[kind][1](bench, draw), None
        except Exception as error:  # of a check or of the runner's own functions
            stands, broken = None, str(error) if isinstance(error, Broken) else traceback.format_exc(limit=-3)
            toys.clean_up(toy)
            (home / "tmp").mkdir(exist_ok=True)
        seconds = time.monotonic() - begin
        print(
            json.dumps({"number": number, "kind": kind, "stands": stands, "broken": broken, "s": seconds}),
            flush=True,
        )


def prepare_accept(bench: Bench) -> None:
    """A second toy with a page, built and accepted, then built anew from other sources."""
    root = bench.root / "accept"
    toy = toys.make(root)
    shutil.rmtree(toy.temporary)
    toy.temporary = bench.toy.temporary
    toy.add_page("isolation/01-page")
    toy.add("motion/01-first", "print(gain(level))")
    toy.write("README.md", "# Toy\n\n<!-- ledger:begin -->\nold\n<!-- ledger:end -->\n")
    toy.write("figures/isolation/01-page/gone.csv", "panel,series,x,y,z\n")
    assert toy.run("figures").returncode == toy.run("accept").returncode == 0
    toy.replace("lib/experiments/isolation/model.py", "2.0", "2.1")
    toy.replace("lib/experiments/motion/model.py", "2.0", "2.1")
    toy.replace("notebooks/isolation/01-page.ipynb", "size=3)", "size=3) + gain(level)")
    toy.replace("notebooks/isolation/01-page.ipynb", "fig-1", "fig-2")
    done = toy.run("figures")
    assert done.returncode == 0, done.stdout + done.stderr
    bench.save("accepted", root, CHANGED[:4])
    shutil.copy(root / "README.md", bench.home / "accepted")
    bench.steps["accept"] = 0
    del bench.steps["accept"]
    count_steps(bench, "accept", lambda install: bench.fork("accept", before=install, root=root), root)
    bench.clean["accepted"] = accepted_files(root)


# The table.


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--faults", type=int, default=2000, help="about how many (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2, help="workers at once (default: %(default)s)")
    parser.add_argument("--kinds", default="", help="only kinds whose name begins so, e.g. 'accept'")
    parser.add_argument("--only", type=int, help="only the fault of this number")
    parser.add_argument("--worker", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    chosen = [
        (number, kind)
        for number, kind in enumerate(plan(options.faults))
        if kind.startswith(options.kinds) and options.only in (None, number)
    ]
    if options.worker:
        part, home = int(options.worker[0]), Path(options.worker[1])
        mounted = os.path.ismount(home / "root")
        work(home, mounted, chosen[part :: options.jobs], options.seed)
        return 0
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # unmounts, as an interrupt does
    begin = time.monotonic()
    home = Path(tempfile.mkdtemp(prefix="faults-", dir="/tmp"))  # short: sockets stand in it
    try:
        rows, mounted = _table(home, options.jobs)
    finally:
        for each in home.glob("*/*"):
            if os.path.ismount(each):
                subprocess.run(["umount", "--lazy", each], check=False)
        shutil.rmtree(home)
    _show(rows, mounted, time.monotonic() - begin)
    return int(any(row["broken"] for row in rows) or len(rows) < len(chosen))


def _table(home: Path, jobs: int) -> tuple[list[dict], bool]:
    """Let the workers work; returns what became of each fault."""
    workers, mounted = [], False
    for part in range(jobs):
        mounted = prepare(home / str(part))
        environment = toys.Toy(home / str(part) / "root", home / str(part) / "tmp").environment()
        del environment["TOY_MARK"], environment["TOY"]  # it is not one of the processes that it looks for
        command = [sys.executable, __file__, *sys.argv[1:], "--worker", str(part), str(home / str(part))]
        out = (home / f"{part}.json").open("w")
        workers.append(subprocess.Popen(command, env=environment, stdout=out, preexec_fn=toys.set_signals))
    try:
        for worker in workers:
            worker.wait()
    finally:
        for worker in workers:
            worker.terminate()
            worker.wait()
    lines = [line for part in range(jobs) for line in (home / f"{part}.json").read_text().splitlines()]
    return [json.loads(line) for line in lines], mounted


def _show(rows: list[dict], mounted: bool, seconds: float) -> None:
    width = max(map(len, KINDS))
    print(f"{'kind':{width}}  count  old stands  new stands  broken      s")
    for kind in [kind for kind in KINDS if any(row["kind"] == kind for row in rows)]:
        mine = [row for row in rows if row["kind"] == kind]
        stands = Counter(row["stands"] for row in mine)
        broken = sum(row["broken"] is not None for row in mine)
        spent = sum(row["s"] for row in mine)
        print(
            f"{kind:{width}}  {len(mine):5}  {stands['old']:10}  {stands['new']:10}  {broken:6}  {spent:5.0f}"
        )
    for row in rows:
        if row["broken"]:
            print(f"broken: fault {row['number']}, {row['kind']}: {row['broken']}")
    disk = "a full tmpfs" if mounted else "a limit on the size of files"
    broken = sum(bool(row["broken"]) for row in rows)
    print(f"{len(rows)} faults in {seconds:.0f} s, {broken} broken; a full disk is {disk}")


if __name__ == "__main__":
    sys.exit(main())
