"""The ledger as text: for a terminal, one entry whole, and as the summary that stands in the README."""

import difflib
import re
import shutil
import sys
import textwrap
from collections import Counter
from collections.abc import Iterable

from workbook import paths
from workbook.checks import InputError
from workbook.claims import DISAGREEMENT, NOT_REPLICATED, VERDICT_WORDS, Claim

FITTED = "fitted or calibrated"
BASIS = {"predicted": "predicted", "fitted": FITTED, "calibrated": FITTED}
# What a claim is counted as: first the work's numbers, then what is none of them.
REPLICATIONS = (
    *(f"{word}, {basis}" for basis in ("predicted", FITTED) for word in VERDICT_WORDS[:-1]),
    NOT_REPLICATED,
    "not judged",
)
APART = ("no number published", "checks passed", "checks failed", "counterfactual", "not built")
GAP = "  "
NARROWEST = 8  # characters to which a column may shrink
PLACE = 44  # characters of a place in the table of all


def published_quantity(claim: Claim) -> str:
    """The published value with its unit; of a fraction of runs, the share of cases in which it holds."""
    published = claim.entry.published
    return "" if published is None else _quantity(claim, published, f"{published:.4g}")


def our_quantity(claim: Claim) -> str:
    """The value found, as `published_quantity`; empty where nothing was."""
    return "" if claim.ours is None else _quantity(claim, claim.ours, claim.shown(4))


def interval_text(claim: Claim) -> str:
    """The interval found, in per cent of the cases for a fraction of them; empty where there is none or it is a point.

    Where it holds the aim and the claim still does not agree, since the value itself is judged, it is followed by that.
    """
    entry, ends = claim.entry, claim.interval
    if not ends or ends[0] == ends[1]:
        return ""
    if entry.is_fraction:
        of_cases = " of cases" if claim.ours in (0, 1) else ""  # beside "always" and "never"
        text = f"{_percent(ends[0])} to {_percent(ends[1])} %{of_cases}"
    else:
        text = f"{ends[0]:.3g} to {ends[1]:.3g}"
    aim, rule = entry.published if entry.expected is None else entry.expected, entry.tolerance
    if claim.here not in DISAGREEMENT or rule is None or not ends[0] <= (aim or 0.0) <= ends[1]:
        return text
    room = f"{rule.absolute:.3g}" if rule.relative is None else f"{100 * rule.relative:.3g} %"
    return f"{text}; {claim.ours:.3g} is judged, to within {room}"


def _quantity(claim: Claim, value: float, text: str) -> str:
    if claim.entry.is_fraction:
        return "always" if value == 1 else "never" if value == 0 else f"in {_percent(value)} % of cases"
    unit = claim.entry.unit
    return text if unit in ("", "1") else f"{text} {unit}"


def _percent(share: float) -> str:
    """A share that is not whole, in per cent; what three digits round to the whole gets more of them."""
    texts = [f"{100 * share:.{digits}g}" for digits in range(3, 9)]
    return next((text for text in texts if float(text) != 100), texts[-1])


def screen() -> int:
    """Characters in a line of the terminal; where the text goes elsewhere, no line is too long."""
    return shutil.get_terminal_size((sys.maxsize, 24)).columns


def table(rows: list[tuple[str, ...]], width: int) -> list[str]:
    """Lines of a table, the first row its head.

    Where it is wider than `width`, the first cell of a row stands on a line of its own, the others below it, and the
    widest columns wrap.

    Parameters
    ----------
    rows : list of tuple of str
        As many cells in each.
    width : int
        Characters; a table of many columns keeps eight for each even where that is too much.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    stacked = _length(widths) > width
    if stacked:
        widths = widths[1:]
        while _length(widths) + len(GAP) > width and max(widths) > NARROWEST:
            widths[widths.index(max(widths))] -= 1
    lines = []
    for number, row in enumerate(rows):
        if stacked:
            lines += textwrap.wrap(row[0], width)
            row = row[1:]
        cells = [textwrap.wrap(cell, columns) or [""] for cell, columns in zip(row, widths, strict=True)]
        for k in range(max(map(len, cells))):
            parts = (cell[k] if k < len(cell) else "" for cell in cells)
            line = GAP.join(p.ljust(w) for p, w in zip(parts, widths, strict=True))
            lines.append((GAP * stacked + line).rstrip())
        if number == 0:
            lines.append("-" * (_length(widths) + len(GAP) * stacked))
    return lines


def _length(widths: list[int]) -> int:
    return sum(widths) + len(GAP) * (len(widths) - 1)


def ledger_text(claims: list[Claim], width: int) -> str:
    """Table of all claims, and the counts.

    Parameters
    ----------
    claims : list of Claim
    width : int
        Characters in a line.
    """
    rows = [("claim", "place", "published", "ours", "verdict")]
    for claim in claims:
        place = textwrap.shorten(claim.entry.place, PLACE, placeholder=" ...")
        rows.append((claim.entry.id, place, published_quantity(claim), our_quantity(claim), claim.judgement))
    total = textwrap.fill(tally(claims) or "no entries", width)
    return "\n".join([*table(rows, width), "", total, "One in full, with its reason: --entry CLAIM"])


def find(claims: list[Claim], name: str) -> Claim:
    """The claim of the entry `name`.

    Raises
    ------
    InputError
        When the ledger has no such entry; those that may be meant are named.
    """
    by_id = {claim.entry.id: claim for claim in claims}
    if name not in by_id:
        raise InputError(f"the ledger has no entry {name!r}{_meant(name, claims)}")
    return by_id[name]


def _meant(name: str, claims: list[Claim]) -> str:
    """The entry that is spelt alike, else those whose id and place hold most of the words; all have its numbers."""
    wanted = _words(name)
    held = {each.entry.id: wanted & _words(f"{each.entry.id} {each.entry.place}") for each in claims}
    held = {each: words for each, words in held.items() if not any(w[0].isdigit() for w in wanted - words)}
    most = max(map(len, held.values()), default=0)
    near = [each for each, words in held.items() if 2 * len(words) > len(wanted) and len(words) == most]
    found = difflib.get_close_matches(name, held, n=1, cutoff=0.85) or near[:3]
    return f"; did you mean {' or '.join(map(repr, found))}?" if found else ""


def _words(text: str) -> set[str]:
    """Words and numbers, a number of a table as in an id: 3-5 for 3.5."""
    return {each.replace(".", "-") for each in re.findall(r"\d+(?:[.-]\d+)*|[a-z]+", text.lower())}


def entry_text(fields: dict, width: int) -> str:
    """All fields of one entry as YAML, without what is empty.

    Parameters
    ----------
    fields : dict
        As `Claim.as_dict` gives them.
    width : int
        Characters in a line.
    """
    import yaml

    return yaml.safe_dump(
        _told(fields), sort_keys=False, default_flow_style=None, allow_unicode=True, width=width
    ).rstrip()


def _told(value):
    """`value` without empty fields, numbers to five digits."""
    if isinstance(value, dict):
        return {
            name: _told(each)
            for name, each in value.items()
            if each is not None
            and each is not False
            and not (isinstance(each, str | list | dict) and not each)
        }
    if isinstance(value, list | tuple):
        return [_told(each) for each in value]
    return float(f"{value:.5g}") if isinstance(value, float) else value


def column(claim: Claim) -> str:
    """Under what a claim is counted.

    What is replicated is split by what it rests on, so that only what was predicted stands at the head. Checks of our own,
    what the work gives no number for and counterfactuals are no replications and have names of their own.
    """
    entry, verdict = claim.entry, claim.verdict
    if verdict == "not built":
        return verdict
    if entry.counterfactual:
        return "counterfactual"
    if entry.kind == "check":
        return "checks passed" if verdict == "passes" else "checks failed"
    if entry.published is None:
        return "no number published"
    return f"{verdict}, {BASIS[entry.basis]}" if verdict in VERDICT_WORDS[:-1] else verdict


def tally(claims: Iterable[Claim]) -> str:
    """How many claims are counted as what, in words; empty where there are none."""
    counts = Counter(map(column, claims))
    return "; ".join(f"{counts[name]} {name}" for name in (*REPLICATIONS, *APART) if counts[name])


def summary(claims: list[Claim]) -> str:
    """Two Markdown tables of counts, a row per topic: the numbers that the work publishes, then what is none of them."""
    parts = [_counts(claims, "numbers", REPLICATIONS), _counts(claims, "others", APART)]
    return "\n\n".join(filter(None, parts))


def _counts(claims: list[Claim], head: str, names: tuple[str, ...]) -> str:
    counts = Counter((claim.entry.topic, column(claim)) for claim in claims)
    shown = [name for name in names if any(counts[topic, name] for topic in paths.topics())]
    lines = [f"| topic | {head} | " + " | ".join(shown) + " |", "|---|" + "---:|" * (len(shown) + 1)]
    for topic in paths.topics():
        numbers = [counts[topic, name] for name in shown]
        if any(numbers):
            lines.append(f"| `{topic}` | {' | '.join(map(str, (sum(numbers), *numbers)))} |")
    return "\n".join(lines) if shown else ""
