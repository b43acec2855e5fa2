"""What each paper concludes, a line each: in a few own words, what was found, one verdict."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from workbook import paths
from workbook.checks import InputError, read_toml
from workbook.claims import VERDICT_WORDS, Claim
from workbook.report import our_quantity, published_quantity
from workbook.site.specification import over_combinations

STATEMENTS = ("ordering", "slope", "exact")
PAGE = "docs/conclusions.md"


@dataclass(frozen=True)
class Stated:
    """A conclusion of a paper, from ``data/<topic>/conclusions.toml``."""

    place: str  # its number, or where the paper states it
    says: str  # in a few own words
    entries: tuple[str, ...]  # of the ledger that judge it
    proxy: str = ""  # why they judge it by something else; empty where they do not


def stated(topic: str, ledger: Iterable[str]) -> list[Stated]:
    """The conclusions of a topic's paper; none without its file.

    Raises
    ------
    InputError
        When one names no entry of the ledger, or an unknown one.
    """
    file, known, found = paths.data(topic, "conclusions.toml"), set(ledger), []
    for place, given in (read_toml(file) if file.exists() else {}).items():
        entries = tuple(given["entries"])
        if not entries or set(entries) - known:
            raise InputError(
                f"{file.name}: {place}: entries name {sorted(set(entries) - known)}; give entries of the ledger"
            )
        found.append(Stated(place, given["says"], entries, given.get("proxy", "")))
    return found


def verdict_of(claims: Sequence[Claim]) -> str:
    """The weakest verdict of the statements among some claims, of the numbers where none is one; ``not judged`` where none is."""
    judged = [claim for claim in claims if claim.verdict in VERDICT_WORDS]
    words = {each.verdict for each in judged if each.entry.kind in STATEMENTS} or {
        each.verdict for each in judged
    }
    return next((word for word in reversed(VERDICT_WORDS) if word in words), "not judged")


def page_of(topics: Iterable[tuple[str, str]], claims: Sequence[Claim]) -> str:
    """The page in Markdown: `topics` are pairs of a topic and its paper."""
    by_id = {claim.entry.id: claim for claim in claims}
    lines = [
        "# What the papers conclude, and what we find",
        "",
        "A line for each conclusion, and for each claim of an abstract. Its verdict is the weakest of the statements that judge",
        "it, over all combinations of open choices, of the numbers where no statement does. A value is that of our own",
        "settings. *Not judged*: the paper states no number, or one that we cannot test.",
    ]
    for topic, paper in topics:
        if mine := stated(topic, by_id):
            lines += ["", f"## {paper}", "", "| | in short | found | verdict |", "|---|---|---|---|"]
            lines += [_row(each, [by_id[name] for name in each.entries]) for each in mine]
    return "\n".join([*lines, ""])


def _row(each: Stated, claims: list[Claim]) -> str:
    proxy = f"<br>*by proxy: {each.proxy}*" if each.proxy else ""
    cells = (each.place, each.says + proxy, "<br>".join(map(_found, claims)), verdict_of(claims))
    return f"| {' | '.join(cell.replace('|', '&#124;') for cell in cells)} |"


def _found(claim: Claim) -> str:
    quantity, ours, printed = (
        claim.entry.quantity,
        our_quantity(claim) or "not built",
        published_quantity(claim),
    )
    text = f"[{quantity}](../notebooks/{claim.notebook}.ipynb)" if claim.notebook else quantity
    text += f": {ours}" + (f" (printed {printed})" if printed not in ("", ours) else "")
    over = claim.over
    return text if over is None or over.share is None else f"{text}, {over_combinations(over)}"
