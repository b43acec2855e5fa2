"""Tables of numbers in texts: separators, decimal marks, notes above the names, and units below them."""

import csv
import itertools
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillwork.base.checks import InputError, pluralise
from stillwork.base.extras import require_package
from stillwork.base.validation import by_value, checked
from stillwork.signals.headings import heading
from stillwork.signals.units import meaning

LONGEST_LINE = 2**17  # characters; the csv module takes no longer field
MOST_ABOVE = 1000  # lines of notes and names above the rows of a text
MISSING = (
    "",
    "#N/A",
    "#NA",
    "N/A",
    "n/a",
    "NA",
    "NaN",
    "nan",
    "-nan",
    "null",
    "NULL",
    "None",
)  # fields without a number
MOMENT = re.compile(  # a date, a time of day
    r"\s*(\d{1,4}[-/]\d{1,2}[-/]\d{1,4}|\d{1,2}\.\d{1,2}\.\d{4}|\d{1,2}:\d{2}).*"
)


@checked
def read_csv(path: Path) -> dict[str, np.ndarray]:
    """Each column of a text by its name, real or complex."""
    pd = require_package("pandas")

    text = _look_through(path)
    try:
        with warnings.catch_warnings():
            # It warns of columns without a name that it drops: they were seen to be empty.
            warnings.simplefilter("ignore", pd.errors.ParserWarning)
            table = pd.read_csv(
                path,
                sep=text.separator,
                decimal=text.decimal,
                header=None,
                names=text.names,
                skiprows=text.skipped,
                index_col=False,
                skipinitialspace=True,
                encoding="utf-8-sig",
            )
    except UnicodeDecodeError:
        raise InputError(f"{path.name} is not text in UTF-8; save it as such") from None
    except (pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise InputError(f"{path.name} is not a table ({error}); give rows of equally many numbers") from None
    columns = {}
    for name, column in table.items():
        try:
            numbers = pd.to_numeric(column, errors="coerce").to_numpy(dtype=float)
        except OverflowError:
            raise InputError(
                f"{path.name}, column {name}: a number is beyond the largest floating-point number; correct it"
            ) from None
        words = column[np.isnan(numbers) & column.notna().to_numpy()]
        if len(words) and (whole := _complex(column)) is not None:
            numbers = whole
        elif len(words):
            wrong = "not a number; correct it"
            if MOMENT.fullmatch(words.iloc[0]):
                wrong = "a date or a time of day; give seconds from any start, or leave the column out"
            raise InputError(
                f"{path.name}, column {name}: {words.iloc[0]!r} in row {words.index[0] + 1} is {wrong}"
            )
        columns[str(name)] = numbers
    return columns


@checked
def read_lvm(path: Path) -> dict[str, np.ndarray]:
    """A text of LabVIEW: its header states what X is, and the units; X may be left out of the rows."""
    columns = read_csv(path)
    stated: dict[str, list[str]] = {}
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for line in itertools.islice(file, MOST_ABOVE):
            key, *values = (each.strip() for each in line.split("\t"))
            stated.setdefault(key, values)
    x = columns.pop("X_Value", np.full(0, np.nan))
    if np.isnan(columns.get("Comment", [0.0])).all():
        del columns["Comment"]
    pairs = itertools.zip_longest(columns, stated.get("Y_Unit_Label", [])[: len(columns)], fillvalue="")
    names = [f"{name} ({unit})" if unit else name for name, unit in pairs]
    channels = dict(zip(names, columns.values(), strict=True))
    if stated.get("X_Dimension", [""])[0] != "Time":
        return channels | ({"X_Value": x} if np.isfinite(x).any() else {})
    if not np.isfinite(x).any():
        try:
            step = float(stated["Delta_X"][0].replace(",", "."))
        except (KeyError, IndexError, ValueError):
            raise InputError(f"{path.name} states no Delta_X; export it with its X column") from None
        x = step * np.arange(len(next(iter(columns.values()), x)))
    return {"time (s)": x} | channels


@by_value
@dataclass(frozen=True)
class _Text:
    """How the numbers of a text stand in it."""

    separator: str
    decimal: str
    names: list[str]
    skipped: list[int]  # lines that hold no numbers, from 0


def _look_through(path: Path) -> _Text:
    """Look through a text once: its separator, the decimal mark of all its rows, its names, and the lines to skip."""
    skipped: list[int] = []
    comments: list[str] = []
    lines = _lines(path, skipped, comments)
    head = list(itertools.islice(lines, MOST_ABOVE))
    given = ""
    if head and (found := re.fullmatch(r'"?sep=(.)"?', head[0][1])):  # of Excel
        given = found[1]
        skipped.append(head.pop(0)[0])
    if not head:
        raise InputError(f"{path.name} is empty; give a line of names and rows of numbers")
    separator, below = _first_row([line for _, line in head], given)
    if below:
        names, below = _names([line for _, line in head], separator, below)
    else:
        names = _commented(comments, separator, len(_fields(head[0][1], separator, 0)))
    skipped += [number for number, _ in head[:below]]
    rows = (line for _, line in itertools.chain(head[below:], lines))
    points = commas = False
    widest, at = 0, 0
    for row, line in enumerate(rows, 1):
        quoted = separator == "," and '"' in line and any("," in each for each in _fields(line, separator, 0))
        points, commas = points or "." in line, commas or quoted or (separator != "," and "," in line)
        if (width := _width(line, separator)) > widest:
            widest, at = width, row
    if not widest:
        raise InputError(f"{path.name} holds a line of names and no rows; give rows of numbers below it")
    if names and widest > len(names):
        raise InputError(
            f"{path.name} is not a table: row {at} holds {pluralise(widest, 'value')} for {pluralise(len(names), 'name')}; give every "
            "column a name, or none, and every row as many values"
        )
    names = [name or f"column {number}" for number, name in enumerate(names or [""] * widest, 1)]
    if again := next((name for name in names if names.count(name) > 1), ""):
        raise InputError(f"{path.name} names two columns {again!r}; give each a name of its own")
    return _Text(separator, "," if commas and not points else ".", names, skipped)


def _first_row(lines: list[str], given: str) -> tuple[str, int]:
    """The separator, and the first line that holds numbers alone, as the next one does; or the second line."""
    marks = [given] if given else ["\t", ";", ",", r"\s+"]
    for number, line in enumerate(lines):
        for mark in marks:
            if (mark in line or mark == marks[-1]) and all(
                _is_row(each, mark) for each in lines[number : number + 2]
            ):
                return mark, number
    body = lines[min(1, len(lines) - 1)]
    return next((mark for mark in marks[:-1] if mark in body), marks[-1]), 1


def _is_row(line: str, separator: str) -> bool:
    fields = _fields(line, separator, 0)
    return any(map(_is_number, fields)) and all(_is_number(each) or each in MISSING for each in fields)


def _names(lines: list[str], separator: str, first: int) -> tuple[list[str], int]:
    """The names above the first row of numbers, with units that stand in a row below them, and where the rows begin.

    Lines above the names are an instrument's notes. A line with a number among others is a row that holds a fault.
    """
    width = len(_fields(lines[first], separator, 0)) if first < len(lines) else 0
    above = [_fields(line, separator, width) for line in lines[:first]]
    units = [each.strip("()[] ") for each in above[-1]]
    known = [each for each in units if meaning(each) and not _is_number(each)]
    if first > 1 and 2 * len(known) >= max(len([*filter(None, units)]), 1) and len(above[-2]) >= len(units):
        pairs = itertools.zip_longest(above[-2], units, fillvalue="")
        return [f"{name} ({unit})" if unit else name for name, unit in pairs], first
    at = first - 1
    while at and len(above[at - 1]) == len(above[at]) and any(map(_is_number, above[at])):
        at -= 1
    return above[at], at + 1


def _commented(comments: list[str], separator: str, width: int) -> list[str]:
    """The names in comments right above rows without any, as `numpy.savetxt` writes them; none where they hold no name of a column."""
    for mark in (separator, ",", ";", "\t", r"\s+"):
        row = (" " if mark == r"\s+" else mark).join("0" * width)
        names = _names([*comments, row], mark, len(comments))[0] if comments else []
        stated = [heading(name) for name in names if not _is_number(name)]
        if len(stated) == len(names) == width and any(each.quantity or each.meaning for each in stated):
            return names
    return []


def _lines(path: Path, skipped: list[int], comments: list[str]) -> Iterator[tuple[int, str]]:
    """The lines of a text with their numbers from 0; those that hold nothing or begin with # are `skipped`.

    `comments` takes what stands behind the # right above the first of them.
    """
    first = True
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for number, line in enumerate(iter(lambda: file.readline(LONGEST_LINE + 1), "")):
            if len(line) > LONGEST_LINE:
                raise InputError(
                    f"{path.name} has a line of more than {LONGEST_LINE} characters; it is no table of numbers"
                )
            line = line.strip(" \r\n")
            if not line.strip() or (line.startswith("#") and not line.startswith("#N/A")):
                skipped.append(number)
                if first:
                    comments.append(line.lstrip("# "))
            else:
                first = False
                yield number, line


def _complex(column) -> np.ndarray | None:
    """A column of complex numbers in the usual forms, 1+2j, (1+2i) or 1 + 2i; None where one of them is none."""
    plain = column.fillna("nan").astype(str).str.replace(r"[\s()]", "", regex=True)
    try:
        return np.array([complex(each.replace("i", "j") if each[-1:] == "i" else each) for each in plain])
    except ValueError:
        return None


def _fields(line: str, separator: str, width: int) -> list[str]:
    """The fields of a line but empty ones at its end; a name's brackets may hold the separator where there are `width` names."""
    if separator == r"\s+":
        bracketed = re.findall(r"[^\s(\[{]+(?:\s*[(\[{][^)\]}]*[)\]}]+)?", line)
        return bracketed if len(bracketed) == width else line.split()
    fields = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    if 0 < width < len(fields) and '"' not in line:  # H(2,1) is one name
        outside = re.split(rf"{re.escape(separator)}(?![^(\[{{]*[)\]}}])", line)
        fields = outside if len(outside) == width else fields
    while fields and not fields[-1].strip():
        fields.pop()
    return [each.strip() for each in fields]


def _width(line: str, separator: str) -> int:
    """How many values a row holds, without empty ones at its end."""
    if separator == r"\s+" or '"' in line:
        return len(_fields(line, separator, 0))
    return line.rstrip(f"{separator} ").count(separator) + 1


def _is_number(text: str) -> bool:
    """Whether a text is a number, with a decimal comma too, or a complex one."""
    try:
        complex(re.sub(r"[()]|\s+(?=[+-])|(?<=[+-])\s+", "", text).replace(",", ".").replace("i", "j"))
    except ValueError:
        return False
    return text not in MISSING
