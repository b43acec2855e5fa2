"""Wrong values for every public function, reader, table and setting: nothing but results and documented errors.

``python benchmarks/fuzz.py --cases 50000`` throws that many, each made from the seed and its number alone, in
processes of their own, and lists what ended in another exception, in a result with NaN, in a crash, or never,
and what a library printed or warned of on the way. ``--unnamed`` lists the refusals whose message holds none of the
spoiled arguments by name (nor a field of one). ``--only KIND`` and ``--case NUMBER`` repeat some of it. ``--only forms`` calls every function with good arrays in
every form that holds the same numbers instead.
"""

import argparse
import collections
import ctypes
import faulthandler
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from dataclasses import fields, is_dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
SECONDS = 20  # of processor time; a case that takes more is a finding
BATCH = 5000  # cases a process
MEMORY = 8 * 2**30  # bytes of address space
sys.path[:0] = [str(HERE), str(HERE.parent / "lib"), str(HERE.parent)]


class TooSlow(BaseException):
    """A case took longer than it may; no handler of the tested code takes it."""


def main() -> int:
    """Run the cases and print each that goes wrong; returns 1 when one did."""
    options = _options()
    if options.first is not None:
        return _worker(options)
    if options.only == "forms":
        from fuzzing import forms

        warnings.simplefilter("ignore")
        return min(forms.main(), 1)
    wrong, done, refused = collections.Counter(), collections.Counter(), collections.Counter()
    start = time.monotonic()
    first, end = (options.case, options.case + 1) if options.case is not None else (0, options.cases)
    while first < end:
        last = min(first + BATCH, end)
        command = [
            sys.executable,
            __file__,
            "--first",
            str(first),
            "--cases",
            str(last),
            "--seed",
            str(options.seed),
        ]
        with tempfile.TemporaryFile("w+") as said:
            worker = subprocess.Popen(
                [*command, "--only", options.only], stdout=subprocess.PIPE, stderr=said, text=True
            )
            begun = False
            for line in worker.stdout:
                begun = True
                number, kind, outcome, what = json.loads(line)
                first = number + (outcome != "begun")
                done[kind] += outcome != "begun"
                refused[outcome] += outcome in ("refused", "unnamed")
                if outcome == "unnamed" and options.unnamed:
                    print(f"unnamed: {number} {kind}: {what}", flush=True)
                if outcome not in ("begun", "result", "refused", "unnamed"):
                    wrong[outcome] += 1
                    print(f"{outcome}: {number} {kind}: {what}", flush=True)
            if worker.wait():
                said.seek(0)
                print(f"crash: {first}: {said.read().strip()[-2000:]}", flush=True)
                wrong["crash"] += 1
                first += 1  # the process died in the case that it had begun
                if not begun:
                    return 1
    kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(done.items()))
    print(
        f"{sum(done.values())} cases ({kinds}), {wrong.total()} wrong, {refused.total()} refused, of which "
        f"{refused['unnamed']} name no spoiled argument, in {time.monotonic() - start:.0f} s"
    )
    return min(wrong.total(), 1)


def _options():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--only", choices=("all", "calls", "files", "tables", "settings", "forms"), default="all"
    )
    parser.add_argument("--unnamed", action="store_true", help="list refusals that name no argument")
    parser.add_argument("--case", type=int, help="this one alone")
    parser.add_argument("--first", type=int, help=argparse.SUPPRESS)
    return parser.parse_args()


def _worker(options) -> int:
    """The cases from `first` on, one line of JSON when each begins and when it ends."""
    from fuzzing import calls, files, settings, tables

    makers = {"calls": calls.case, "files": files.case, "tables": tables.case, "settings": settings.case}
    shares = {"calls": 0.7, "files": 0.12, "tables": 0.1, "settings": 0.08}
    if absent := calls.missing():
        print(f"no call for {', '.join(absent)}", file=sys.stderr)
        return 1
    report = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # LAPACK complains of its arguments there
    faulthandler.enable()
    with warnings.catch_warnings(action="ignore"):
        calls.warm()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    signal.signal(signal.SIGPROF, _stop)
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        for number in range(options.first, options.cases):
            rng = np.random.default_rng([options.seed, number])
            kind = str(rng.choice(list(shares), p=list(shares.values())))
            kind = kind if options.only == "all" else options.only
            print(json.dumps([number, kind, "begun", ""]), file=report)
            print(json.dumps([number, kind, *_watched(kind, makers[kind], rng)]), file=report)
    return 0


def _stop(*_):
    raise TooSlow


def _watched(kind, make, rng) -> tuple[str, str]:
    """What became of a case, and ``leak`` where it was well but something else printed or warned of it."""
    case = make(rng)
    before = os.lseek(2, 0, os.SEEK_CUR)
    with warnings.catch_warnings(record=True, action="always") as caught:
        outcome, what = _outcome(kind, *case)
    sys.stderr.flush()
    ctypes.CDLL(None).fflush(None)
    said = os.pread(2, 300, before).decode(errors="replace") if os.lseek(2, 0, os.SEEK_CUR) > before else ""
    # What a reader's own function divides by is the reader's; calls.py plays the reader.
    foreign = [
        each
        for each in caught
        if not each.category.__module__.startswith("stillwork") and Path(each.filename).name != "calls.py"
    ]
    said += "; ".join(f"{each.message} at {Path(each.filename).name}:{each.lineno}" for each in foreign[:3])
    if said and outcome in ("result", "refused", "unnamed"):
        return "leak", f"{case[0]} {case[1]}: {' '.join(said.split())}"
    return outcome, what


def _outcome(kind, name, told, must_work, call) -> tuple[str, str]:
    """What became of a case: ``result``, ``refused`` or ``unnamed`` (a documented error), or what is wrong."""
    from fuzzing import calls

    from stillwork.base.checks import InputError
    from stillwork.estimation.online import UnstableAdaptation

    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        result = call()
        result = result, _properties(result)
    except (InputError, FileNotFoundError, UnstableAdaptation) as error:
        what = f"{name} {told}: {error}"
        if must_work:
            return "refused a good value", what
        unnamed = kind == "calls" and not calls.is_named(name, told, str(error))
        return "unnamed" if unnamed else "refused", what
    except TooSlow:
        return "too slow", f"{name} {told}"
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(place.filename).name}:{place.lineno}"
        return "other exception", f"{name} {told}: {type(error).__name__}: {str(error)[:150]!r} at {where}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    if name.split(",")[0] not in _unbounded() and _has_nan(result):
        return "silent NaN", f"{name} {told}"
    return "result", ""


def _properties(result) -> list:
    """What can be read off a result: all of it is computed, except what takes long (zeros)."""
    from stillwork.base.checks import InputError

    owner = type(result)
    if not is_dataclass(owner):
        return []
    found = []
    for name, var in vars(owner).items():
        asked = isinstance(var, property | cached_property) and not name.startswith("_") and name != "zeros"
        try:
            found += [getattr(result, name)] if asked else []
        except InputError:  # its message states why it has none
            continue
    return found


def _unbounded() -> set[str]:
    from fuzzing.calls import MAY_BE_INFINITE, behind

    return MAY_BE_INFINITE | behind().keys()  # these validate themselves


def _has_nan(value, depth: int = 0) -> bool:
    if isinstance(value, float | complex | np.inexact):
        return not np.isfinite(value)
    if isinstance(value, np.ndarray):
        return value.dtype.kind in "fc" and not np.isfinite(value).all()
    if depth > 4:
        return False
    if is_dataclass(value) and not isinstance(value, type):
        return any(_has_nan(getattr(value, field.name), depth + 1) for field in fields(value))
    return isinstance(value, tuple | list) and any(_has_nan(each, depth + 1) for each in value)


if __name__ == "__main__":
    sys.exit(main())
