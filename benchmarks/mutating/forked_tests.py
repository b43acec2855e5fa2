"""Tests on faults, in forks of a process that has imported them all: `pytest -p forked_tests`, as `mutants.py` calls it.

A fork takes a hundredth of a second where a new process takes ten. In it the function with the fault gets the faulty
code, and those tests run that execute its line without the fault: which ones, and how long they take, is recorded once
for each file of tests. With NUMBA_DISABLE_JIT=1 kernels are functions as well.
"""

import contextlib
import gc
import hashlib
import json
import os
import signal
import time
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from types import CodeType, FunctionType

import coverage
import pytest
from _pytest.runner import runtestprotocol

FAULTS, ANSWERS, RECORDS = (Path(os.environ[f"FAULTS_{name}"]) for name in ("TRIED", "ANSWERS", "RECORDS"))
LIMIT = float(os.environ["FAULTS_LIMIT"])  # s of CPU for the tests of a fault, as recorded
LONGEST = (
    1.5 if os.environ.get("NUMBA_DISABLE_JIT") == "1" else 30.0
)  # s of CPU of a test, else it is not used
WAITING = 20  # times the CPU of a test it may take of the clock
SAID = RECORDS.with_suffix(".said")

RECORDED: dict[Path, dict] = {}


class TooLong(BaseException):
    """Not an Exception, for what is tested, and hypothesis, may catch those."""


def pytest_runtestloop(session: pytest.Session) -> bool:
    """Try each fault, in place of running the tests."""
    files: dict[Path, list[pytest.Item]] = {}
    for item in session.items:
        files.setdefault(item.path, []).append(item)
    for fault in json.loads(FAULTS.read_text()):
        answer = {"mutant": fault["mutant"], **tried(fault, files)}
        with ANSWERS.open("a") as out:
            print(json.dumps(answer), file=out)
        print(f"{answer['end']:14s}  {answer['mutant']}  {answer['by']}", flush=True)
    return True


def recorded(file: Path, items: list[pytest.Item], fault: dict) -> dict:
    """Of each test of a file its time, its lines in each file of the library, and whether it passed.

    It is recorded again after a change of the tests, or of the file of the fault.
    """
    kept, source = RECORDS / f"{digest(file)}.json", digest(Path(fault["path"]))
    if kept not in RECORDED and kept.is_file():
        RECORDED[kept] = json.loads(kept.read_text())
    if kept not in RECORDED or RECORDED[kept]["sources"].get(fault["file"], source) != source:
        RECORDS.mkdir(parents=True, exist_ok=True)
        print(f"recording {file.parent.name}/{file.name}", flush=True)
        kept.write_text(json.dumps({"sources": {}, "tests": {}}))  # where the process ends early
        forked(partial(record, items, file.parents[2] / "lib", kept))
        RECORDED[kept] = json.loads(kept.read_text())
    return RECORDED[kept]["tests"]


def digest(file: Path) -> str:
    """Of a file as it is."""
    return hashlib.sha256(file.read_bytes()).hexdigest()[:16]


def record(items: list[pytest.Item], library: Path, kept: Path) -> None:
    """Run the tests of a file and write what they reach."""

    def too_long(*_):
        raise TooLong

    for each in (signal.SIGPROF, signal.SIGALRM):
        signal.signal(each, too_long)
    tracer = coverage.Coverage(data_file=None, source=[str(library)], config_file=False, messages=False)
    tracer.start()
    found = {}
    for item, following in zip(items, [*items[1:], None], strict=True):
        tracer.switch_context(item.nodeid)
        begin = time.process_time()
        passed = False
        with contextlib.suppress(TooLong):  # one that comes between two parts of a test
            signal.setitimer(signal.ITIMER_PROF, LONGEST, 1.0)
            signal.setitimer(signal.ITIMER_REAL, WAITING * LONGEST, 1.0)  # one that waits takes no CPU
            passed = passes(item, following)
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        found[item.nodeid] = {"seconds": time.process_time() - begin, "passed": passed, "lines": {}}
    tracer.stop()
    data, sources = tracer.get_data(), {}
    for file in data.measured_files():
        for line, tests in data.contexts_by_lineno(file).items():
            for test in tests:
                if test in found:
                    found[test]["lines"].setdefault(os.path.relpath(file, library), []).append(line)
        sources[os.path.relpath(file, library)] = digest(Path(file))
    kept.write_text(json.dumps({"sources": sources, "tests": found}))


def passes(item: pytest.Item, following: pytest.Item | None) -> bool:
    """Run a test with its fixtures."""
    return not any(each.failed for each in runtestprotocol(item, log=False, nextitem=following))


def tried(fault: dict, files: dict[Path, list[pytest.Item]]) -> dict:
    """Results of the tests that reach a fault, those of the nearest file first, until one fails or time is up.

    A failure counts when the test passes without the fault.
    """
    first, last = fault["lines"]
    answer: dict = {"end": "not reached", "by": "", "tests": 0}
    seconds = 0.0
    for file in (each for name in fault["near"] if (each := Path(name)) in files):
        known = recorded(file, files[file], fault)
        chosen = [
            (item, known[item.nodeid]["seconds"])
            for item in files[file]
            if (test := known.get(item.nodeid)) and test["passed"]
            if any(first <= line <= last for line in test["lines"].get(fault["file"], ()))
        ]
        if seconds > LIMIT:
            break
        while chosen:
            end, by = ended(fault, chosen)
            if by is None or passes_without(by):
                answer |= {"end": end, "by": by.nodeid if by else "", "tests": answer["tests"] + len(chosen)}
                break
            chosen = [each for each in chosen if each[0] is not by]
        if answer["end"] not in ("not reached", "survived"):
            return answer
        seconds += sum(cost for _, cost in chosen)
    return answer


def ended(fault: dict, chosen: list[tuple[pytest.Item, float]]) -> tuple[str, pytest.Item | None]:
    """How the tests end, and the one that failed."""
    status = forked(partial(run_until_one_fails, fault, chosen))
    *begun, last = SAID.read_text().splitlines() or ["not put"]
    if last in ("passed", "not put"):
        return ("survived" if last == "passed" else last), None
    name = begun[-1] if last == "failed" else last
    late = os.WIFSIGNALED(status) and os.WTERMSIG(status) in (signal.SIGPROF, signal.SIGALRM)
    by = next(item for item, _ in chosen if item.nodeid == name)
    return ("killed by time" if late else "killed"), by


@cache
def passes_without(item: pytest.Item) -> bool:
    """Whether a test passes by itself without a fault."""
    forked(partial(run_until_one_fails, None, [(item, LONGEST)]))
    return SAID.read_text().splitlines()[-1:] == ["passed"]


def run_until_one_fails(fault: dict | None, chosen: list[tuple[pytest.Item, float]]) -> None:
    """Report each test as it begins, and how it ended: a test that takes far too long ends the process."""
    if fault is not None and not put(fault):
        say("not put")
        return
    for place, (item, seconds) in enumerate(chosen):
        say(item.nodeid)
        following = chosen[place + 1][0] if place + 1 < len(chosen) else None
        signal.setitimer(signal.ITIMER_PROF, 10 + 5 * seconds)
        signal.setitimer(signal.ITIMER_REAL, WAITING * (10 + 5 * seconds))
        if not passes(item, following):
            say("failed")
            return
    say("passed")


def put(fault: dict) -> bool:
    """Give the function that holds a fault the faulty code; no, where that is not one function."""
    file = fault["path"]
    faulty = [
        code for code in codes(compile(fault["text"], file, "exec")) if code.co_qualname == fault["outermost"]
    ]
    gc.unfreeze()
    own = [
        candidate
        for candidate in gc.get_objects()
        if type(candidate) is FunctionType
        and candidate.__code__.co_filename == file
        and candidate.__code__.co_qualname == fault["outermost"]
    ]
    gc.freeze()
    if len(faulty) != 1 or not own or any(f.__code__.co_freevars != faulty[0].co_freevars for f in own):
        return False
    for each in own:
        each.__code__ = faulty[0]
    return True


def codes(code: CodeType) -> Iterator[CodeType]:
    """A module's code and all in it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from codes(constant)


def forked(work: Callable[[], None]) -> int:
    """Do something in a process of its own with what it starts, and give its status."""
    SAID.write_text("")
    child = os.fork()
    if not child:
        with contextlib.suppress(BaseException):
            os.setsid()
            silent = os.open(os.devnull, os.O_RDWR)
            for each in (0, 1, 2):
                os.dup2(silent, each)
            work()
        os._exit(0)
    status = os.waitpid(child, 0)[1]
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    return status


def say(line: str) -> None:
    """Where the parent reads it, even when this process ends at once."""
    with SAID.open("a") as out:
        print(line, file=out)
