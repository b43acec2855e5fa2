"""Results of a topic's combinations: ``data/<topic>/choices.csv``, a block a study, a row a combination.

A block begins with a comment, ``# study <name> code <digest> axes <digest>``, and the names of its columns: point
and seed, one column per axis, one per entry (with columns ``<entry> low`` and ``<entry> high`` where an interval was
found), and ``failure`` where a combination failed.
"""

import csv
import io
import math
from dataclasses import dataclass, field, replace

import numpy as np

from workbook import paths
from workbook.checks import InputError
from workbook.choices.axes import Multiverse

Value = float | tuple[float, tuple[float, float]]  # a number, or a number and its interval
DIGITS = 7


@dataclass(frozen=True)
class Outcomes:
    """What the combinations of one study gave.

    Attributes
    ----------
    multiverse : Multiverse
    design : list of tuple of int
        The points.
    values, low, high : dict of str to ndarray, shape (points, seeds)
        By entry; NaN where there is none. Only entries with intervals have `low` and `high`.
    failures : dict of (int, int) to str
        Why a combination, by point and place of its seed, gave nothing.
    code : str
        Digest of the code that computed them.
    """

    multiverse: Multiverse
    design: list[tuple[int, ...]]
    values: dict[str, np.ndarray]
    low: dict[str, np.ndarray] = field(default_factory=dict)
    high: dict[str, np.ndarray] = field(default_factory=dict)
    failures: dict[tuple[int, int], str] = field(default_factory=dict)
    code: str = ""

    @property
    def failed(self) -> np.ndarray:
        """Which combinations failed, shape (points, seeds)."""
        failed = np.zeros((len(self.design), len(self.multiverse.seeds)), bool)
        for at in self.failures:
            failed[at] = True
        return failed


def rounded(value: float) -> float:
    """To the digits that the results keep."""
    return float(f"{value:.{DIGITS}g}")


def collect(multiverse: Multiverse, design: list[tuple[int, ...]], found: dict, code: str = "") -> Outcomes:
    """Outcomes from what each combination gave.

    Parameters
    ----------
    multiverse : Multiverse
    design : list of tuple of int
    found : dict of (int, int) to dict or str
        By point and place of the seed: values by entry, or the reason of a failure.
    code : str
        Digest of the code.
    """
    shape = (len(design), len(multiverse.seeds))
    values, low, high = ({e: np.full(shape, np.nan) for e in multiverse.entries} for _ in range(3))
    failures = {}
    for at, outcome in found.items():
        if isinstance(outcome, str):
            failures[at] = outcome
            continue
        for entry, value in outcome.items():
            if isinstance(value, tuple | list):
                value, (low[entry][at], high[entry][at]) = value
            values[entry][at] = value
    low, high = ({e: a for e, a in ends.items() if not np.isnan(a).all()} for ends in (low, high))
    return Outcomes(multiverse, design, values, low, high, dict(sorted(failures.items())), code)


def results_text(studies: list[Outcomes]) -> str:
    """Text of ``choices.csv``."""
    text = io.StringIO()
    for number, one in enumerate(studies):
        multiverse = one.multiverse
        text.write("\n" * bool(number))
        text.write(f"# study {multiverse.study} code {one.code} axes {multiverse.digest}\n")
        writer = csv.writer(text, lineterminator="\n")
        columns = {}
        for entry in multiverse.entries:
            columns[entry] = one.values[entry]
            if entry in one.low:
                columns |= {f"{entry} low": one.low[entry], f"{entry} high": one.high[entry]}
        head = ["point", "seed", *(axis.name for axis in multiverse.axes), *columns]
        writer.writerow(head + ["failure"] * bool(one.failures))
        for at in np.ndindex(len(one.design), len(multiverse.seeds)):
            point, seed = at
            options = [axis.texts[k] for axis, k in zip(multiverse.axes, one.design[point], strict=True)]
            numbers = [_number(column[at]) for column in columns.values()]
            reason = [one.failures.get(at, "")] * bool(one.failures)
            writer.writerow([point, multiverse.seeds[seed], *options, *numbers, *reason])
    return text.getvalue()


def _number(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.{DIGITS}g}"


def read_results(multiverses: list[Multiverse]) -> list[Outcomes]:
    """Committed results of those studies whose axes are still the ones that were run.

    Parameters
    ----------
    multiverses : list of Multiverse
        Of one topic.

    Raises
    ------
    InputError
        When the file is damaged; the message names it and the study.
    """
    if not multiverses:
        return []
    file = paths.data(multiverses[0].topic, "choices.csv")
    if not file.exists():
        return []
    blocks = {}
    for block in file.read_text(encoding="utf-8").split("# study ")[1:]:
        head, _, text = block.partition("\n")
        name, _, code, _, axes = head.rsplit(" ", 4)
        blocks[name] = (code, axes, text.strip())
    found = []
    for multiverse in multiverses:
        code, axes, text = blocks.get(multiverse.study, ("", "", ""))
        if axes == multiverse.digest:
            try:
                found.append(replace(_parsed(multiverse, text), code=code))
            except (ValueError, KeyError, IndexError) as error:
                raise InputError(
                    f"{file}: study {multiverse.study} cannot be read ({error}); run `make choices` again"
                ) from None
    return found


def _parsed(multiverse: Multiverse, text: str) -> Outcomes:
    design, found = [], {}
    for number, row in enumerate(csv.DictReader(io.StringIO(text))):
        point, seed = divmod(number, len(multiverse.seeds))
        if seed == 0:
            design.append(tuple(axis.texts.index(row[axis.name]) for axis in multiverse.axes))
        found[point, seed] = row.get("failure") or _values(multiverse, row)
    return collect(multiverse, design, found)


def _values(multiverse: Multiverse, row: dict[str, str]) -> dict[str, Value]:
    values = {}
    for entry in multiverse.entries:
        value = float(row[entry] or "nan")
        ends = (row.get(f"{entry} low"), row.get(f"{entry} high"))
        values[entry] = (value, (float(ends[0]), float(ends[1]))) if all(ends) else value
    return values
