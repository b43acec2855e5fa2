"""How far a build's results lie from the committed ones: tables, pictures, claims and printed text.

On another processor, or with another C library, the last bits of a number differ. What agrees within the
tolerances here is the same result; each states where it comes from.
"""

import itertools
import json
import os
import re
from collections.abc import Collection
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from workbook import paths
from workbook.appendix import KIND as APPENDIX
from workbook.checks import InputError
from workbook.claims import Claim, load_entries
from workbook.figures import read_table
from workbook.notebooks import cleaned, joined
from workbook.publish import content_of
from workbook.tasks import Task, built

# Of the range that a series spans: chosen, a ninth of a pixel in the tallest picture (1155 pixels with its frame), so
# what agrees looks the same. How much of it is used is the `worst` that a build prints, and most
# where an adaptive filter carries rounding on. The rest is room for another system's libm.
TABLE = 1e-4

# A number is printed rounded: numbers that agree may still fall on two sides of a rounding. Of a number with a single
# digit that is a factor of two, at most; what a statement rests on is a claim or a plotted number, held more closely.
PRINTED = 1.0  # units of the last printed digit

# Decades: a series that a page notes as rounding itself (`Page.save`) keeps its size, not its digits.
ROUNDING = 1.0

# Levels of 256 by which any pixel may be off. The settings of other processors moved none by more than 43, along the
# edge of a line whose numbers moved; none by more than 31 where the table is the same to the byte: a picture's own
# palette has another mixture of two lines' colours. A line in another colour of the palette (`workbook.figures`) or a new
# mark moves some by more.
SHADE, SAME_NUMBERS = 48, 40

NUMBER = re.compile(r"(?<![\w.])[-+−]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


@dataclass(frozen=True)
class Comparison:
    """One notebook's results beside the committed ones.

    Attributes
    ----------
    notebook : str
        Topic and name.
    pictures : int
        How many pictures were compared.
    worst : float
        Largest difference of a plotted number among those that agree, of the range that its series spans.
    files : tuple of str
        Names of the figures (without suffix) that do not agree, are new or are gone.
    cells : tuple of str
        Ids of the code cells that print something else.
    claims : tuple of str
        Ids of the ledger's entries whose value left the committed one by more than its drift.
    moved : tuple of str
        Those of them that had a value before, with both values.
    verdicts : tuple of str
        Those of them whose verdict is another, with both.
    """

    notebook: str
    pictures: int
    worst: float
    files: tuple[str, ...]
    cells: tuple[str, ...]
    claims: tuple[str, ...]
    moved: tuple[str, ...]
    verdicts: tuple[str, ...]

    @property
    def agrees(self) -> bool:
        return not (self.files or self.cells or self.claims)


def compare(task: Task) -> Comparison:
    """Hold what was built of a notebook against what is committed of it."""
    names = {file.stem for folder in (task.target, task.committed) for file in folder.glob("*.png")}
    names |= {file.stem for folder in (task.target, task.committed) for file in folder.glob("*.csv")}
    off = {name: difference(task.target / name, task.committed / name) for name in sorted(names)}
    apart = tuple(name for name, each in off.items() if each is None)
    claims, moved, verdicts = _claims(task)
    return Comparison(
        task.notebook.name,
        len(names),
        max((each for each in off.values() if each is not None), default=0.0),
        apart,
        tuple(cells_apart(task)),
        claims,
        moved,
        verdicts,
    )


def summary(found: list[Comparison]) -> list[str]:
    """What is printed at the end of a build."""
    lines = []
    for each in found:
        what = [f"figure {name}" for name in each.files] + [f"cell {name}" for name in each.cells]
        what += [f"claim {name}" for name in each.claims]
        if what:
            shown = ", ".join(what[:4]) + (f" and {len(what) - 4} more" if len(what) > 4 else "")
            lines.append(f"moved: {each.notebook}: {shown}")
        lines += [f"verdict moved: {line}" for line in each.verdicts]
    agree = sum(each.pictures - len(each.files) for each in found)
    pictures = sum(each.pictures for each in found)
    worst = max((each.worst for each in found), default=0.0)
    which = f"{agree} pictures agree" if agree == pictures else f"{agree} of {pictures} pictures agree"
    verdicts = sum(len(each.verdicts) for each in found)
    lines.append(
        f"{which} with the committed ones (worst {worst:.0e} of the range), {verdicts} verdicts moved; "
        f"pictures and tables: {os.path.relpath(built(), paths.root())}/"
    )
    return lines


def difference(now: Path, before: Path) -> float | None:
    """Largest difference between two figures, given without suffix; None when they are not the same figure."""
    tables = [content_of(each.with_name(each.name + ".csv")) for each in (now, before)]
    pictures = [content_of(each.with_name(each.name + ".png")) for each in (now, before)]
    if pictures == [None, None] and tables[0] == tables[1]:  # numbers of a notebook's own making
        return 0.0
    if None in pictures or (tables[0] is None) != (tables[1] is None):
        return None
    noted = _noted(before)
    if noted != _noted(now):
        return None
    same = tables[0] == tables[1] or (noted and _same_numbers(now, before))
    # Rounding moves a line by any amount, so of a picture with noted series only the same numbers can be compared.
    comparable = pictures[0] != pictures[1] and (same or not noted)
    if comparable and not same_picture(*pictures, SAME_NUMBERS if same else SHADE):
        return None
    return numbers_difference(now, before)


def numbers_difference(now: Path, before: Path) -> float | None:
    """As `difference`, of the plotted numbers alone."""
    tables = [each.with_name(each.name + ".csv") for each in (now, before)]
    if content_of(tables[0]) == content_of(tables[1]) is not None:
        return 0.0
    if not all(table.is_file() for table in tables):
        return None
    try:
        return table_difference(*tables, set(_noted(before)))
    except (InputError, UnicodeDecodeError):  # a damaged table is not this one
        return None


def _same_numbers(now: Path, before: Path) -> bool:
    """Whether two figures have the same series with the same numbers, in whatever order they were drawn."""
    try:
        built, committed = (read_table(each.with_name(each.name + ".csv")) for each in (now, before))
    except (InputError, OSError, UnicodeDecodeError):
        return False
    return built.keys() == committed.keys() and all(
        np.array_equal(built[key], values, equal_nan=True) for key, values in committed.items()
    )


def table_difference(now: Path, before: Path, rounding: Collection[str] = ()) -> float | None:
    """Largest difference of the numbers in two tables, as a part of the range of their series; None when too large.

    Parameters
    ----------
    now, before : Path
    rounding : collection of str
        Series whose numbers are rounding itself: their sizes are compared, and do not count as a difference.
    """
    built, committed = read_table(now), read_table(before)
    if list(built) != list(committed):
        return None
    worst = 0.0
    for key, values in committed.items():
        if key[1] in rounding:
            if not same_size(built[key], values):
                return None
            continue
        off = np.inf
        if built[key].shape == values.shape:
            off = max(distance(built[key][:, column], values[:, column]) for column in range(3))
        if not off <= TABLE:
            return None
        worst = max(worst, off)
    return worst


def same_size(now: np.ndarray, before: np.ndarray) -> bool:
    """Whether two series of rounding are of one size: their quartiles, in decades.

    The largest number is left to chance, and after a breakdown to chaos. A residual that is exactly zero has no
    decade: it agrees with any that is a few rounding units.
    """
    sizes = []
    for each in (now, before):
        size = np.abs(each[:, 1][np.isfinite(each[:, 1])])
        sizes.append(np.quantile(size, [0.25, 0.5, 0.75]) if len(size) else np.zeros(3))
    low, high = np.minimum(*sizes), np.maximum(*sizes)
    small = (low == 0) & (high <= 1e3 * np.finfo(float).eps)
    return bool(np.all(small | (high <= 10**ROUNDING * low)))


def same_picture(now: bytes, before: bytes, shade: int = SHADE) -> bool:
    """Whether two PNG pictures differ in no more than the shades along their lines."""
    import io

    from matplotlib.image import imread

    try:
        shades = [np.atleast_3d(imread(io.BytesIO(each)))[..., :3] for each in (now, before)]
    except (OSError, SyntaxError, ValueError):  # what Pillow raises for a damaged file
        return False
    if shades[0].shape != shades[1].shape:
        return False
    return float(np.abs(shades[0] - shades[1]).max()) <= (shade + 0.5) / 255


# A place in a work is a name, not a number that is rounded.
REFERENCE = re.compile(
    r"\b(?:Table|Fig|Eq|eq|equation|Equation|Section|section|Chapter|Remark|Definition|Example|Theorem|Corollary|"
    r"Lemma|Conclusion|Algorithm)s?\.?\s*\(?[A-Z]?\d[\d.]*"
)
LETTERS = str.maketrans("0123456789.", "abcdefghij_")


def same_text(now: str, before: str) -> bool:
    """Whether two printed texts differ in nothing but the last digit of a number that is not whole.

    Widths of columns do not count: they follow from the numbers. A blank behind a number does: "5%" is not "5 %".
    """
    if now == before:
        return True
    now, before = (REFERENCE.sub(lambda found: found[0].translate(LETTERS), text) for text in (now, before))
    words = [[_plain(word) for word in NUMBER.split(text)] for text in (now, before)]
    numbers = [NUMBER.findall(text) for text in (now, before)]
    return words[0] == words[1] and all(itertools.starmap(_same_number, zip(*numbers, strict=True)))


def _same_number(now: str, before: str) -> bool:
    if now == before:
        return True
    if not any(mark in now + before for mark in ".eE"):
        return False
    unit = min(_last_digit(now), _last_digit(before))  # "2" may be 2.00 without its zeros, but not 1.01
    values = [float(each.replace("−", "-")) for each in (now, before)]
    return abs(values[0] - values[1]) <= PRINTED * unit * (1 + 1e-9)


def _last_digit(number: str) -> float:
    """What one unit of the last digit stands for."""
    mantissa, _, exponent = number.lower().partition("e")
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


def _plain(text: str) -> str:
    return re.sub(r"[ \t]+", " ", re.sub(r"-{3,}", "---", text)).replace(" \n", "\n").rstrip(" ")


def distance(now: np.ndarray, before: np.ndarray) -> float:
    """Largest difference, as a part of the range that the committed numbers span.

    Positive numbers that span more than a decade are drawn on a logarithmic axis and compared on one.
    """
    known = np.isfinite(before)
    if not np.array_equal(now[~known], before[~known], equal_nan=True) or not np.isfinite(now[known]).all():
        return np.inf
    if not known.any():
        return 0.0
    now, before = now[known], before[known]
    if before.min() > 0 and before.max() > 10 * before.min():
        if now.min() <= 0:
            return np.inf
        now, before = np.log(now), np.log(before)
    span = np.ptp(before) or np.abs(before).max() or 1.0
    return float(np.abs(now - before).max() / span)


def _noted(figure: Path) -> dict[str, str]:
    """Series of a figure (given without suffix) that its page notes as rounding, with the reasons."""
    file = figure.with_name("rounding.json")
    return json.loads(file.read_text(encoding="utf-8")).get(figure.name, {}) if file.is_file() else {}


def cells_apart(task: Task) -> list[str]:
    """Ids of the code cells whose printed text is not the committed one."""
    notebook = json.loads(task.notebook.source)
    executed = cleaned(notebook, json.loads(task.executed.read_text(encoding="utf-8")))
    found = []
    for before, now in zip(notebook["cells"], executed["cells"], strict=True):
        if before["cell_type"] == "code" and not same_outputs(now["outputs"], before["outputs"]):
            found.append(before["id"])
    return found


def same_outputs(now: list[dict], before: list[dict]) -> bool:
    """Whether two lists of a cell's text outputs are of one kind and print the same."""
    now, before = joined(now), joined(before)
    if len(now) != len(before):
        return False
    return all(
        a["output_type"] == b["output_type"]
        and _is_table(a) == _is_table(b)
        and same_text(printed(a), printed(b))
        for a, b in zip(now, before, strict=True)
    )


def _is_table(output: dict) -> bool:
    return "text/html" in output.get("data", {})


def printed(output: dict) -> str:
    """The text of an output."""
    data = output.get("data", {})
    text = output.get("text") if output["output_type"] == "stream" else data.get("text/plain", "")
    return "".join(text or "") + "".join(data.get(APPENDIX, ""))


def _claims(task: Task) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
    """Entries whose claim is another; of these, where it had one before, values and verdicts, each before and now."""
    now, before = (found_claims(folder / "claims.json") for folder in (task.target, task.committed))
    entries = _entries(task.notebook.topic, (task.committed.parents[2] / "data").as_posix())
    claims, moved, verdicts = [], [], []
    for name in sorted(set(now) | set(before)):
        if name not in now or name not in before or name not in entries:
            claims.append(name)
            continue
        if entries[name].needs_interval and not ("interval" in now[name] and "interval" in before[name]):
            claims.append(name)
            continue
        new, old = (
            Claim(entries[name], each["ours"], tuple(each["interval"]) if "interval" in each else None)
            for each in (now[name], before[name])
        )
        if new.here != old.here:
            verdicts.append(f"{name}: {old.here} -> {new.here}")
        if new.here != old.here or not same_value(new, old):
            claims.append(name)
            moved.append(f"{name}: {old.ours:.6g} -> {new.ours:.6g}")
    return tuple(claims), tuple(moved), tuple(verdicts)


def same_value(now: Claim, before: Claim) -> bool:
    """Whether value and interval lie within the entry's drift; of an interval, drift of its larger end."""
    entry = before.entry
    if entry.is_residual:
        return True
    if bool(now.interval) != bool(before.interval):
        return False
    wide = max(map(abs, before.interval or (0.0,)))
    for a, b in zip((now.ours, *(now.interval or ())), (before.ours, *(before.interval or ())), strict=True):
        if abs(a - b) > 1e-12 + entry.drift.width(max(abs(b), wide)):
            return False
    return True


@cache
def _entries(topic: str, _data: str) -> dict:
    return load_entries(topic)


def found_claims(file: Path) -> dict:
    """The claims in a file; none where it is missing or damaged, so that all of them count as moved."""
    try:
        found = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    except ValueError:
        return {}
    whole = isinstance(found, dict) and all(
        isinstance(each, dict) and "ours" in each for each in found.values()
    )
    return found if whole else {}
