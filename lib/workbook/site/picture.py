"""A topic's published numbers against ours, as one drawing: a row a number, sorted by how far it is off."""

import math
from dataclasses import dataclass

from workbook.claims import Claim
from workbook.report import tally

FARTHEST = 4.0  # ratios beyond are drawn at the edge, as arrows
WIDTH, ROW, MARGIN = 360, 6, 16
AXIS = 34


@dataclass(frozen=True)
class Mark:
    """One number: where it stands, how far it may be off, and what it says when pointed at."""

    claim: Claim
    x: float
    y: float
    low: float | None
    high: float | None
    edge: str  # "", "left" or "right"
    text: str


@dataclass(frozen=True)
class Picture:
    """What the template draws: `marks` and the axis' `ticks`, in SVG units."""

    marks: tuple[Mark, ...]
    ticks: tuple[tuple[float, str], ...]
    height: float
    width: int = WIDTH

    @property
    def description(self) -> str:
        return f"{len(self.marks)} numbers, ours over published: {tally(mark.claim for mark in self.marks)}"


def draw(claims: list[Claim]) -> Picture:
    """Picture of a work's numbers that compare sizes; fractions have none, and zero published no ratio."""
    sized = [
        claim
        for claim in claims
        if claim.ours is not None
        and claim.entry.is_replication
        and not claim.entry.is_fraction
        and claim.entry.published
    ]
    sized.sort(key=_ratio)
    marks = tuple(_mark(claim, MARGIN + ROW * row) for row, claim in enumerate(sized))
    ticks = tuple(
        (_x(value), label) for value, label in ((1 / 4, "¼"), (1 / 2, "½"), (1, "1"), (2, "2"), (4, "4"))
    )
    return Picture(marks, ticks, MARGIN + ROW * len(sized) + AXIS)


def _ratio(claim: Claim) -> float:
    return claim.ours / claim.entry.published


def _x(ratio: float) -> float:
    """Logarithmic, the ratio 1 in the middle; zero and the wrong sign at the left edge."""
    share = math.log(ratio) / math.log(FARTHEST) if ratio > 0 else -1.0
    return WIDTH / 2 + (WIDTH / 2 - MARGIN) * max(-1.0, min(1.0, share))


def _mark(claim: Claim, y: float) -> Mark:
    ratio = _ratio(claim)
    edge = "left" if ratio < 1 / FARTHEST else "right" if ratio > FARTHEST else ""
    entry = claim.entry
    low, high = _allowed(claim)
    text = (
        f"{entry.id}: published {entry.published:.4g}, ours {claim.ours:.4g} {entry.unit} ({claim.verdict})"
    )
    return Mark(claim, _x(ratio), y, low and _x(low), high and _x(high), edge, text)


def _allowed(claim: Claim) -> tuple[float | None, float | None]:
    """Ratios between which the number counts as replicated; for an interval rule, the interval found."""
    entry, published = claim.entry, claim.entry.published
    if entry.tolerance is None:
        return None, None
    if claim.interval:
        ends = [end / published for end in claim.interval]
        return min(ends), max(ends)
    share = entry.tolerance.relative
    if share is None:
        share = (entry.tolerance.absolute or 0.0) / abs(published)
    return 1 - share, 1 + share
