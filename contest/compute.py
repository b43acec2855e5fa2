"""The compute track: time against the Kalman filter's, bytes, and floating-point operations a sample, of ours.

``python -m contest.compute`` makes the table: all entrants in one process on one core, in turn with the Kalman filter,
and counts what each does on a few samples.
"""

import ast
import inspect
import operator
import os
import textwrap
import time
from collections.abc import Callable
from functools import cache

import numpy as np
import pandas as pd

from contest.nominal import OwnObserver
from contest.plants import PLANTS
from contest.scores import ENTRANTS, Scan, recorded
from contest.tuning import DEVELOPMENT, settings_for
from workbook import paths

FILE = paths.data("motion", "contest_compute.csv")
UNCERTAINTY = "all 5 %"
ROUNDS, BLOCK = 15, 1000  # how often each entrant is timed, over so many samples
SETTLED, COUNTED = 600, 4  # samples before operations are counted, and on how many they are
ARITHMETIC = ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow
COLUMNS = ["observer", "time over Kalman's", "operations a sample", "bytes"]
FUNCTIONS = ("sqrt", "exp", "log", "sin", "cos", "tanh")  # of numpy, an operation each


class Counter:
    """Runs kernels as Python and counts additions, subtractions, products, quotients, powers and elementary functions.

    One of real numbers counts one; of arrays, one for each number that comes out. Comparisons, signs, absolute values
    and arithmetic of whole numbers count nothing.
    """

    def __init__(self):
        self.operations = 0
        self.counting = cache(self._counting)

    def count(self, value):
        """The value, whose making was an operation on each of its numbers where these are real."""
        if isinstance(value, (float, np.floating)):
            self.operations += 1
        elif isinstance(value, np.ndarray) and value.dtype.kind == "f":
            self.operations += value.size
        return value

    def _counting(self, kernel) -> Callable:
        """The kernel as a Python function that counts, and calls others that do."""
        function = inspect.unwrap(getattr(kernel, "py_func", kernel))
        tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
        definition = tree.body[0]
        assert isinstance(definition, ast.FunctionDef)
        definition.decorator_list = []
        names = set(function.__code__.co_names)
        known = {name: value for name, value in function.__globals__.items() if name in names}
        kernels = {name: self.counting(value) for name, value in known.items() if hasattr(value, "py_func")}
        space = function.__globals__ | kernels | IN_PLACE | {"_count": self.count}
        exec(compile(ast.fix_missing_locations(_Counted().visit(tree)), "counted", "exec"), space)
        return space[function.__name__]


class _Counted(ast.NodeTransformer):
    """Puts a call of `_count` around every operation that may count."""

    def visit_BinOp(self, node):
        self.generic_visit(node)
        if isinstance(node.op, ast.MatMult):
            raise NotImplementedError("a product of matrices in a kernel is not counted; write it as a loop")
        return _call(node) if isinstance(node.op, ARITHMETIC) else node

    def visit_Call(self, node):
        self.generic_visit(node)
        function = node.func
        counts = isinstance(function, ast.Attribute) and function.attr in FUNCTIONS
        if isinstance(function, ast.Attribute) and function.attr in ("sum", "dot", "mean", "prod"):
            raise NotImplementedError(f"{function.attr} in a kernel is not counted; write it as a loop")
        return _call(node) if counts else node

    def visit_AugAssign(self, node):
        self.generic_visit(node)
        read = ast.parse(ast.unparse(node.target), mode="eval").body
        function = ast.Name(f"_{type(node.op).__name__}", ast.Load())
        done = ast.Call(function, [read, node.value], [])
        return ast.Assign([node.target], _call(done) if isinstance(node.op, ARITHMETIC) else done)


def _call(node: ast.expr) -> ast.Call:
    return ast.Call(ast.Name("_count", ast.Load()), [node], [])


IN_PLACE = {  # what an array's other names hold changes, too
    f"_{each.__name__}": getattr(operator, f"i{name}")
    for each, name in (
        (ast.Add, "add"),
        (ast.Sub, "sub"),
        (ast.Mult, "mul"),
        (ast.Div, "truediv"),
        (ast.BitXor, "xor"),
    )
}


def operations_of(observer: OwnObserver, inputs: np.ndarray, measurements: np.ndarray) -> float:
    """Operations a sample that the observer makes on these, from where it stands."""
    counter, estimates = Counter(), np.empty((len(inputs), observer.states))
    with np.errstate(all="ignore"):
        advance = counter.counting(observer.made.advance)
        advance(observer.made.data, observer.memory, inputs, measurements, estimates)
    return counter.operations / len(inputs)


def begun(name: str, scan: Scan) -> OwnObserver:
    """One of ours at the beginning of a scan, with the contest's settings."""
    observer = OwnObserver(ENTRANTS[name], settings_for(scan.plant, scan.seed, [name])[name])
    observer.start(*scan.given())
    return observer


def seconds_of(observer: OwnObserver, done: tuple[np.ndarray, np.ndarray], given: tuple) -> float:
    """Time of this thread that a block of samples takes from the beginning of a scan, once all of it is at hand."""
    observer.start(*given)
    observer.run(*done)
    observer.start(*given)
    began = time.thread_time()
    observer.run(*done)
    return time.thread_time() - began


def rows_of(plant: str) -> list[tuple]:
    """What each entrant takes on a plant: times over the Kalman filter's, in turn with it; bytes; operations."""
    scan = Scan("estimate", plant, UNCERTAINTY, DEVELOPMENT, 0)
    record, given = recorded(scan), scan.given()
    block = record.inputs[:BLOCK], record.measurements[:BLOCK]
    observers = {name: begun(name, scan) for name in ENTRANTS}
    ratios: dict[str, list[float]] = {name: [] for name in observers}
    for observer in observers.values():
        seconds_of(observer, block, given)  # compiles it
    for _ in range(ROUNDS):
        for name, each in observers.items():
            usual = seconds_of(observers["Kalman"], block, given)
            ratios[name].append(seconds_of(each, block, given) / usual)
    kalman = [seconds_of(observers["Kalman"], block, given) for _ in range(ROUNDS)]
    unit, rows = 1e6 * float(np.median(kalman)) / BLOCK, []
    for name, each in observers.items():
        each.start(*given)
        each.run(record.inputs[:SETTLED], record.measurements[:SETTLED])
        some = slice(SETTLED, SETTLED + COUNTED)
        operations = operations_of(each, record.inputs[some], record.measurements[some])
        rows.append((plant, name, float(np.median(ratios[name])), unit, each.bytes, operations))
    return rows


def compute_standings(table: pd.DataFrame) -> pd.DataFrame:
    """A row an entrant: medians over machines, and between which machines they lie."""
    some = table.groupby("entrant", sort=False)[["ratio", "operations", "bytes"]]
    middle = some.median().sort_values("ratio", kind="stable")
    low, high = some.min().astype(float), some.max().astype(float)
    rows = [
        (
            name,
            *(
                f"{_short(row[k])} ({_short(low.loc[name, k])} to {_short(high.loc[name, k])})"
                for k in row.index
            ),
        )
        for name, row in middle.iterrows()
    ]
    return pd.DataFrame(rows, columns=COLUMNS)


def _short(value: float) -> str:
    return f"{value:.2g}" if value < 10 else f"{float(f'{value:.3g}'):.0f}"


def main() -> None:
    """Make the committed table."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    rows = [row for plant in PLANTS for row in rows_of(plant)]
    table = pd.DataFrame(rows, columns=["plant", "entrant", "ratio", "microseconds", "bytes", "operations"])
    table["microseconds"] = table["microseconds"].round(3)
    table["ratio"] = table["ratio"].round(3)
    table.to_csv(FILE, index=False, lineterminator="\n")
    print(compute_standings(table).to_string(index=False))


if __name__ == "__main__":
    main()
