"""Mutants of the toolbox against the tests that reach them: `make mutants ARGS="--count 200 --seed 1"`.

A mutant is the toolbox with one small fault: an operator, a constant or an index changed, two arguments swapped, another
local returned, a statement left out. It is killed when a test fails that passes without it. Of those that survive it
prints the place, the old and the new text; each needs a test, or a reason why it changes nothing, which goes into
`mutating/equivalent.toml`. The tests that execute its line are tried first, in forks of one process
(`mutating/forked_tests.py`), kernels without compilation; then, of those that are left, the slow tests, and all tests of
what the forks cannot decide, in separate processes. It works in a copy, `build/mutants`, where `SEED.jsonl` keeps what
was tried: a run that was stopped goes on, and those that survived are tried again.
"""

import argparse
import ast
import copy
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "lib")]

from stillwork.base.kernel_folder import cache_folder  # noqa: E402
from stillwork.base.toml_files import read_toml  # noqa: E402
from workbook.choices.closure import imports  # noqa: E402
from workbook.pinned import pins  # noqa: E402

PLACE = ROOT / "build" / "mutants"
TREE, KERNELS, RECORDS = PLACE / "tree", PLACE / "kernels", PLACE / "records"
FORKED = Path(__file__).with_name("mutating")
PARTS = ("base", "signals", "lti", "identification", "estimation", "control")
OTHERS = ("stillwork/design/design.py", "experiments/isolation/loop.py", "experiments/isolation/together.py")
# Their mutants would change how the tests run, not what they find.
LEFT_OUT = {"__init__", "kernel_cache", "kernel_folder", "kernel_sources", "kernels", "garbage"}
TESTS = ("shared", "isolation", "motion", "worstcase", "fixedpoint", "budget")
# They read the library as text.
READERS = re.compile("test_(dead_code|wording|layers|readme|wheel|types|source_digest|rendering|import)")
SYMMETRIC = re.compile(
    r"\b(max|min|maximum|minimum|hypot|add|multiply|allclose|array_equal)$"
)  # whose two arguments may change places
FILES = 6  # of tests, for a mutant
PATIENCE = 120.0  # s of CPU, for one test
OPPOSITE = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.And: ast.Or,
    ast.Or: ast.And,
}


@dataclass(frozen=True)
class Mutant:
    """One fault: the text from `start` to `end` of a file, in bytes, becomes `new`."""

    kind: str
    file: str  # below lib/
    line: int
    column: int
    lines: tuple[int, int]  # of the statement, or of its head
    function: str
    outermost: str  # function that holds it, with its class, or nothing
    in_kernel: bool
    start: int
    end: int
    old: str
    new: str

    def applied(self, text: bytes) -> bytes:
        """The text of its file with the fault."""
        return text[: self.start] + self.new.encode() + text[self.end :]

    def __str__(self):
        return f"lib/{self.file}:{self.line}:{self.column} {self.kind}: {self.old} -> {self.new}"


def mutants_of(file: str, text: bytes) -> Iterator[Mutant]:
    """All mutants of a module."""
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))

    def walk(node, function, place, in_kernel, local, lines):
        # Printing and type annotations are not arithmetic.
        if isinstance(node, ast.JoinedStr | ast.Import | ast.ImportFrom):
            return
        if isinstance(node, ast.stmt):
            inner = getattr(node, "body", None)
            lines = (node.lineno, max(node.lineno, inner[0].lineno - 1) if inner else node.end_lineno)
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            function = node.name
            if isinstance(node, ast.FunctionDef):
                in_kernel = "kernel" in " ".join(map(ast.unparse, node.decorator_list))
                names = (each for each in ast.walk(node) if isinstance(each, ast.Name))
                local = sorted({each.id for each in names if isinstance(each.ctx, ast.Store)})
        for kind, new in changes(node, local):
            start = starts[node.lineno - 1] + node.col_offset
            end = starts[node.end_lineno - 1] + node.end_col_offset
            old = " ".join(text[start:end].decode().split())
            outermost = "" if place.endswith(".") else place
            where = (file, node.lineno, node.col_offset + 1)
            yield Mutant(kind, *where, lines, function, outermost, in_kernel, start, end, old, new)
        if isinstance(node, ast.Raise):
            return
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list"):
                continue
            within = place
            if name == "body" and (not place or place.endswith(".")):
                within += f"{node.name}." if isinstance(node, ast.ClassDef) else ""
                within += node.name if isinstance(node, ast.FunctionDef) else ""
            for each in value if isinstance(value, list) else [value]:
                if isinstance(each, ast.AST):
                    yield from walk(each, function, within, in_kernel, local, lines)

    yield from walk(ast.parse(text), "", "", False, [], (0, 0))


def changes(node: ast.AST, local: list[str]) -> Iterator[tuple[str, str]]:
    """Kinds of fault that a node may have, each with its text."""

    def with_(**fields):
        changed = copy.copy(node)
        for name, value in fields.items():
            setattr(changed, name, value)
        return f"({ast.unparse(changed)})"

    match node:
        case ast.BinOp(op=op) if type(op) in OPPOSITE:
            yield "operator", with_(op=OPPOSITE[type(op)]())
        case ast.Compare(ops=[op]) if type(op) in OPPOSITE:
            yield "comparison", with_(ops=[OPPOSITE[type(op)]()])
        case ast.BoolOp(op=op):
            yield "and, or", with_(op=OPPOSITE[type(op)]())
        case ast.UnaryOp(op=ast.Not()):
            yield "not", f"({ast.unparse(node.operand)})"
        case ast.Constant(value=int() as value) if not isinstance(value, bool):
            yield "constant", str(value + 1)
        case ast.Constant(value=float() as value):
            yield "constant", str(2 * value if value else 1.0)
        case ast.Subscript(slice=ast.Name(id=name), ctx=ast.Load()):
            yield "index", f"{ast.unparse(node.value)}[{name} + 1]"
        case ast.Call(args=[first, second, *rest]) if ast.unparse(first) != ast.unparse(second) and (
            rest or not SYMMETRIC.search(ast.unparse(node.func))
        ):
            if not any(isinstance(each, ast.Starred) for each in (first, second)):
                yield "arguments", with_(args=[second, first, *rest])
        case ast.Return(value=ast.Name(id=name)):
            for other in [each for each in local if each != name][:2]:
                yield "return", f"return {other}"
        case ast.AugAssign() | ast.Raise() | ast.Expr(value=ast.Call()):
            yield "statement", "pass"
        case ast.Assign(targets=[ast.Subscript() | ast.Attribute()]):
            yield "statement", "pass"


def draw(count: int, seed: int) -> list[Mutant]:
    """So many mutants, of every kind about as many."""
    files = [*(f for part in PARTS for f in sorted((ROOT / "lib" / "stillwork" / part).glob("*.py")))]
    files = [f for f in files if f.stem not in LEFT_OUT] + [ROOT / "lib" / other for other in OTHERS]
    kinds: dict[str, list[Mutant]] = {}
    for file in files:
        for each in mutants_of(file.relative_to(ROOT / "lib").as_posix(), file.read_bytes()):
            kinds.setdefault(each.kind, []).append(each)
    rng = random.Random(seed)
    for kind in kinds.values():
        rng.shuffle(kind)
    drawn: list[Mutant] = []
    while len(drawn) < count and any(kinds.values()):
        drawn += [each.pop() for each in kinds.values() if each][: count - len(drawn)]
    rng.shuffle(drawn)
    return drawn


@cache
def imported(file: Path) -> tuple[Path, ...]:
    """Files of the library and of the tests that a file imports."""
    found, roots = set(), [TREE / "lib", TREE / "tests", TREE]
    root = next(each for each in roots if file.is_relative_to(each))
    parts = file.relative_to(root).with_suffix("").parts
    for name in imports(".".join(parts[:-1] if parts[-1] == "__init__" else parts), file, roots):
        for each in roots:
            if (path := each.joinpath(*name.split(".")).with_suffix(".py")).is_file():
                found.add(path)
    return tuple(found)


@cache
def distances(test: Path) -> dict[Path, int]:
    """Files that a test leads to, with the number of imports on the way."""
    found, edge = {test: 0}, [test]
    while edge:
        edge = [
            new
            for file in edge
            for new in imported(file)
            if new not in found and not found.update({new: found[file] + 1})
        ]
    return found


def copy_tree() -> None:
    """The files as they are, committed or not, with an order of tests that `run` sets."""
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    shutil.rmtree(TREE, ignore_errors=True)
    for name in listed.stdout.splitlines():
        if (ROOT / name).is_file():
            (TREE / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, TREE / name)
    (TREE / "tests" / "order.py").write_text(
        'import os\n\nORDER = os.environ["ORDER"].split("|")\n\n\ndef rank(file):\n    return ORDER.index(str(file))\n'
    )
    KERNELS.mkdir(parents=True, exist_ok=True)
    shutil.copytree(cache_folder(), KERNELS, dirs_exist_ok=True)


def environment() -> dict[str, str]:
    """What tests of the copy run under."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    kept.pop("NUMBA_CACHE_DIR", None)
    return {
        **kept,
        **pins(),
        "PYTHONPATH": f"{TREE / 'lib'}:{TREE}:{FORKED}",
        "STILLWORK_KERNELS": str(KERNELS),
    }


PYTEST = [
    sys.executable,
    "-m",
    "pytest",
    "-p",
    "no:nbval",
    "-p",
    "no:anyio",
    "-p",
    "no:cacheprovider",
    "--tb=no",
]


def ask_forks(mutants: list[Mutant], answers: Path, limit: float, compiled: bool) -> subprocess.Popen:
    """A process that adds to `answers` the results of the tests that are not slow, in its forks."""
    faults = PLACE / f"{'compiled' if compiled else 'plain'}.json"
    described = []
    for mutant in mutants:
        file = TREE / "lib" / mutant.file
        told = {"mutant": str(mutant), "path": str(file), "text": mutant.applied(file.read_bytes()).decode()}
        # Without compilation even the nearest are slow.
        told |= {"near": list(map(str, nearest(mutant)[: 2 * FILES if compiled else FILES]))}
        told |= {name: getattr(mutant, name) for name in ("file", "lines", "function", "outermost")}
        described.append(told)
    faults.write_text(json.dumps(described))
    variables = {"FAULTS_TRIED": str(faults), "FAULTS_ANSWERS": str(answers), "FAULTS_LIMIT": str(limit)}
    variables |= {"FAULTS_RECORDS": str(RECORDS / ("compiled" if compiled else "plain"))}
    variables |= {} if compiled else {"NUMBA_DISABLE_JIT": "1"}
    tests = [str(test) for test in all_tests()]
    variables["ORDER"] = "|".join(tests)
    command = [*PYTEST, "-s", "-p", "forked_tests", "-m", "not slow", *tests]
    return subprocess.Popen(command, cwd=TREE, env={**environment(), **variables})


def all_tests() -> list[Path]:
    """Files of tests that may notice a fault."""
    every = (f for part in TESTS for f in (TREE / "tests" / part).glob("test_*.py"))
    return sorted(f for f in every if not READERS.match(f.name))


def nearest(mutant: Mutant) -> list[Path]:
    """Files of tests that lead to the file of a mutant: those that name its function, those with few imports between."""
    file = TREE / "lib" / mutant.file
    near = {f: distances(f)[file] for f in all_tests() if file in distances(f)}
    return sorted(near, key=lambda f: (mutant.function not in names(f), near[f], f.stat().st_size))


@cache
def names(file: Path) -> set[str]:
    """Names in a file's code; its words would be too many, for functions are called as words are."""
    nodes = list(ast.walk(ast.parse(file.read_text())))
    brought = {node.name for node in nodes if isinstance(node, ast.alias)}
    read = {node.id for node in nodes if isinstance(node, ast.Name)}
    return brought | read | {node.attr for node in nodes if isinstance(node, ast.Attribute)}


def run(tests: list[Path], limit: float, *options: str) -> tuple[str, str]:
    """What pytest found: passed, failed or late, and its last lines."""
    variables = {"ORDER": "|".join(str(test).partition("::")[0] for test in tests)}
    try:
        done = subprocess.run(
            [*PYTEST, *options, *map(str, tests)],
            cwd=TREE,
            env={**environment(), **variables},
            capture_output=True,
            text=True,
            timeout=20 * limit,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (int(limit), int(limit))),
        )
    except subprocess.TimeoutExpired:
        return "late", ""
    if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        return "late", ""
    return "passed" if done.returncode in (0, 5) else "failed", done.stdout


@cache
def passes(test: str) -> bool:
    """Whether a test passes in the copy without a fault."""
    return run([TREE / test], PATIENCE)[0] == "passed"


def judge(mutant: Mutant, limit: float, marks: Iterable[str]) -> dict:
    """Apply a mutant in the copy, run the tests that reach it, nearest first, and take it back.

    A failure counts when the test passes without the fault; being late, when the same tests are not so without it.
    """
    file, tests = TREE / "lib" / mutant.file, nearest(mutant)[:FILES]
    text, before = file.read_bytes(), file.stat().st_mtime
    end, by, failing = "survived", "", []
    for marked in marks if tests else ():
        options = ["-x", "-rfE", "-m", marked]
        while end == "survived":
            try:
                file.write_bytes(mutant.applied(text))
                # For Python's bytecode, which looks at whole seconds.
                os.utime(file, (before + 10, before + 10))
                state, said = run(tests, limit, *options, *failing)
            finally:
                file.write_bytes(text)
                os.utime(file, (before, before))
            if state == "passed":
                break
            if state == "late":
                late = run(tests, limit, *options, *failing)[0] == "late"
                end = "not decided" if late else "killed by time"
                break
            found = re.findall(r"^(?:FAILED|ERROR) (\S+?)(?: - .*)?$", said, re.MULTILINE)
            by = found[0] if found else "the process"
            if not found or passes(by):
                end = "killed"
            failing += ["--deselect", by]
    return {"mutant": str(mutant), "end": end, "by": by if end == "killed" else "", "tests": len(tests)}


def equivalent(mutant: Mutant) -> bool:
    """Whether it is listed as one that changes nothing."""
    line = (ROOT / "lib" / mutant.file).read_text().splitlines()[mutant.line - 1].strip()
    return any(
        (each["file"], each["line"]) == (mutant.file, line)
        and f"{mutant.old} -> {mutant.new}" in each["changes"]
        for each in read_toml(FORKED / "equivalent.toml")["mutant"]
    )


def main() -> None:
    """Try mutants of a seed, those that were tried before left out, and print who survives."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit", type=float, default=60.0, help="seconds of CPU for the tests of a mutant")
    parser.add_argument("--forks", action="store_true", help="the tests that are not slow alone, in forks")
    options = parser.parse_args()
    copy_tree()
    kept = PLACE / f"{options.seed}.jsonl"

    def known() -> dict[str, dict]:
        """The last result of each mutant."""
        lines = kept.read_text().splitlines() if kept.is_file() else []
        return {answer["mutant"]: answer for answer in map(json.loads, lines)}

    drawn = draw(options.count, options.seed)
    same = [each for each in drawn if equivalent(each)]
    survivors = [each for each in drawn if each not in same and not killed(known().get(str(each)))]
    in_forks = [survivor for survivor in survivors if survivor.outermost]
    asked = [
        [mutant for mutant in in_forks if mutant.in_kernel is not compiled] for compiled in (True, False)
    ]
    begun = [ask_forks(those, kept, options.limit, those is asked[0]) for those in asked if those]
    for process in begun:
        process.wait()
    said = known()
    survivors = [each for each in survivors if not killed(said.get(str(each)))]
    for each in survivors if not options.forks else ():
        # The forks have tried what is not slow, of a kernel not its machine code.
        tried = said.get(str(each), {"end": ""})["end"] == "survived" and not each.in_kernel
        answer = judge(each, 5 * options.limit, ["slow"] if tried else ["not slow", "slow"])
        with kept.open("a") as file:
            print(json.dumps(answer), file=file)
        print(f"{answer['end']:14s}  {each}  {answer['by']}", flush=True)
    said = known()
    survivors = [each for each in survivors if not killed(said.get(str(each)))]
    print(
        f"\nseed {options.seed}: {len(drawn)} mutants, {len(drawn) - len(same) - len(survivors)} killed, "
        f"{len(same)} equivalent, {len(survivors)} survive"
    )
    for each in survivors:
        print(f"  {each}  ({said.get(str(each), {'tests': 0})['tests']} tests)")


def killed(answer: dict | None) -> bool:
    """Whether a test noticed."""
    return answer is not None and answer["end"].startswith("killed")


if __name__ == "__main__":
    main()
