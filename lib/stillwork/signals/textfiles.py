"""Tables of numbers in texts: separators, decimal marks, notes above the names, and units below them."""

import codecs
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
    "-",
    "--",
)  # fields without a number
X = "X_Value"  # of LabVIEW, a column of what the others stand over
SPACES = "'\u2019\u00a0\u202f\u2009 "  # that may stand between thousands
MOMENT = re.compile(  # a date, a time of day
    r"\s*(\d{1,4}[-/]\d{1,2}[-/]\d{1,4}|\d{1,2}\.\d{1,2}\.\d{4}|\d{1,2}:\d{2}).*"
)


@checked
def read_csv(path: Path) -> dict[str, np.ndarray]:
    """Each column of a text by its name, real or complex."""
    pd = require_package("pandas")

    try:
        encoding = _encoding(path)
        text = _look_through(path, encoding)
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
                encoding=encoding,
                na_values=MISSING[-2:],
            )
    except UnicodeError:
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
        elif len(words) and (whole := _ungrouped(column, text)) is not None:
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
    """A text of LabVIEW: its header states what X is, and the units; X may stand beside each channel, or be left out."""
    columns = read_csv(path)
    stated: dict[str, list[str]] = {}
    mark = "\t"
    with path.open(encoding=_encoding(path)) as file:
        for line in itertools.islice(file, MOST_ABOVE):
            mark = "," if line.startswith("Separator,") else mark
            key, *values = (each.strip() for each in line.split(mark))
            stated.setdefault(key, values)
    axes = [columns.pop(name) for name in [*columns] if name.partition(" #")[0] == X]
    x = axes[0] if axes else np.full(0, np.nan)
    if any(not np.array_equal(x, other, equal_nan=True) for other in axes):
        raise InputError(f"{path.name} holds channels over different X; export those that belong together")
    if np.isnan(columns.get("Comment", [0.0])).all():
        del columns["Comment"]
    pairs = itertools.zip_longest(columns, stated.get("Y_Unit_Label", [])[: len(columns)], fillvalue="")
    names = [f"{name} ({unit})" if unit else name for name, unit in pairs]
    channels = dict(zip(names, columns.values(), strict=True))
    what, unit = (stated.get(key, [""])[0] for key in ("X_Dimension", "X_Unit_Label"))
    axis = {"Time": f"time ({unit or 's'})", "Frequency": f"frequency ({unit or 'Hz'})"}.get(what)
    if axis is None:
        return channels | ({X: x} if np.isfinite(x).any() else {})
    if not np.isfinite(x).any():
        try:
            first, step = (float(stated[key][0].replace(",", ".")) for key in ("X0", "Delta_X"))
        except (KeyError, IndexError, ValueError):
            raise InputError(f"{path.name} states no X0 and Delta_X; export it with its X column") from None
        x = first + step * np.arange(len(next(iter(columns.values()), x)))
    return {axis: x} | channels


@by_value
@dataclass(frozen=True)
class _Text:
    """How the numbers of a text stand in it."""

    separator: str
    decimal: str
    apart: str  # what may stand between thousands
    names: list[str]
    skipped: list[int]  # lines that hold no numbers, from 0


def _encoding(path: Path) -> str:
    """Of a text: UTF-16 by its mark, UTF-8, or else that of Windows, in which instruments write degrees and micrometres."""
    with path.open("rb") as file:
        if file.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
            return "utf-16"
    with path.open("rb") as file:
        try:
            for _ in codecs.iterdecode(iter(lambda: file.read(2**20), b""), "utf-8"):
                pass
        except UnicodeDecodeError:
            return "cp1252"
    return "utf-8-sig"


def _look_through(path: Path, encoding: str) -> _Text:
    """Look through a text once: its separator, the decimal mark of all its rows, its names, and the lines to skip."""
    skipped: list[int] = []
    comments: list[str] = []
    lines = _lines(path, encoding, skipped, comments)
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
    last = ""  # of both marks in one number, the one behind
    widest, at = 0, 0
    for row, line in enumerate(rows, 1):
        quoted = separator == "," and '"' in line and any("," in each for each in _fields(line, separator, 0))
        points, commas = points or "." in line, commas or quoted or (separator != "," and "," in line)
        if not last and points and commas:
            each = "\t".join(_fields(line, separator, 0)) if separator == "," else line
            last = both[2] if (both := re.search(r"\d([.,])\d{3}(?!\1)([.,])\d", each)) else ""
        if (width := _width(line, separator)) > widest:
            widest, at = width, row
    if not widest:
        raise InputError(f"{path.name} holds a line of names and no rows; give rows of numbers below it")
    if names and widest > len(names):
        cure = "give every column a name, or none, and every row as many values"
        if separator == "," and widest == 2 * len(names):
            cure = "where commas are decimal marks, let semicolons or tabs stand between the columns"
        raise InputError(
            f"{path.name} is not a table: row {at} holds {pluralise(widest, 'value')} for {pluralise(len(names), 'name')}; {cure}"
        )
    names = [name or f"column {number}" for number, name in enumerate(names or [""] * widest, 1)]
    # LabVIEW may put X beside each channel.
    names = [f"{X} #{k}" if name == X and X in names[:k] else name for k, name in enumerate(names)]
    if again := next((name for name in names if names.count(name) > 1), ""):
        raise InputError(f"{path.name} names two columns {again!r}; give each a name of its own")
    decimal = last or ("," if commas and not points else ".")
    return _Text(separator, decimal, SPACES + ".,".strip(decimal) * bool(last), names, skipped)


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
    known = _units(above[-1])
    if (
        first > 1
        and 2 * len(known) >= max(len([*filter(None, above[-1])]), 1)
        and len(above[-2]) >= len(above[-1])
    ):
        return _with_units(above[-2], above[-1]), first
    at = first - 1
    while at and len(above[at - 1]) == len(above[at]) and any(map(_is_number, above[at])):
        at -= 1
    if at and len(_units(above[at - 1])) == len(above[at]):
        return _with_units(above[at], above[at - 1]), at + 1
    return above[at], at + 1


def _units(fields: list[str]) -> list[str]:
    """Those that are units."""
    return [each for each in fields if meaning(each.strip("()[] ")) and not _is_number(each)]


def _with_units(names: list[str], units: list[str]) -> list[str]:
    pairs = itertools.zip_longest(names, (each.strip("()[] ") for each in units), fillvalue="")
    return [f"{name} ({unit})" if unit else name for name, unit in pairs]


def _commented(comments: list[str], separator: str, width: int) -> list[str]:
    """The names in comments right above rows without any, as `numpy.savetxt` writes them; none where they hold no name of a column."""
    for mark in (separator, ",", ";", "\t", r"\s+"):
        row = (" " if mark == r"\s+" else mark).join("0" * width)
        names = _names([*comments, row], mark, len(comments))[0] if comments else []
        stated = [heading(name) for name in names if not _is_number(name)]
        if len(stated) == len(names) == width and any(each.quantity or each.meaning for each in stated):
            return names
    return []


def _lines(path: Path, encoding: str, skipped: list[int], comments: list[str]) -> Iterator[tuple[int, str]]:
    """The lines of a text with their numbers from 0; those that hold nothing or begin with # are `skipped`.

    `comments` takes what stands behind the # right above the first of them.
    """
    first = True
    with path.open(encoding=encoding) as file:
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


def _grouped(apart: str, decimal: str) -> str:
    """The pattern of a number whose thousands stand apart, by one of these marks."""
    return rf"[+-]?[1-9]\d{{0,2}}(?P<apart>[{apart}])\d{{3}}(?:(?P=apart)\d{{3}})*(?:[{decimal}]\d*)?(?:[eE][+-]?\d+)?"


def _ungrouped(column, text: _Text) -> np.ndarray | None:
    """A column of numbers of which some have their thousands apart; None where one is none."""
    plain = column.fillna("nan").astype(str).str.strip()
    whole = plain.str.fullmatch(_grouped(text.apart, text.decimal))
    if not whole.any() or plain[~whole].str.contains(f"[{text.apart}]").any():
        return None
    plain = plain.str.replace(f"[{text.apart}]", "", regex=True).str.replace(text.decimal, ".", regex=False)
    try:
        return plain.to_numpy(dtype=float)
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
    """Whether a text is a number, with a decimal comma or thousands apart too, or a complex one."""
    if re.fullmatch(_grouped(f"{SPACES}.,", ".,"), text):
        return True
    try:
        complex(re.sub(r"[()]|\s+(?=[+-])|(?<=[+-])\s+", "", text).replace(",", ".").replace("i", "j"))
    except ValueError:
        return False
    return text not in MISSING
