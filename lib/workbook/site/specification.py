"""How an entry stands over all combinations, in words and as a specification curve: an entry's values under all combinations, sorted, and which options were on below each."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from workbook.choices.axes import load_axes
from workbook.choices.judging import Robustness
from workbook.choices.results import Outcomes, read_results
from workbook.claims import DISAGREEMENT, LEAST, NOT_REPLICATED, RARELY, VERDICTS, Claim
from workbook.report import find, our_quantity, published_quantity

WIDTH, TOP = 460, 10  # of the values and dots; a page stretches the width to what it has
HEIGHT, ROW = 120, 15  # of the values; of an option
LETTER = 7  # width of one in the words beside them
SPREAD = 30.0  # largest over smallest value from which on the scale is logarithmic


@dataclass(frozen=True)
class Curve:
    """What the template draws of an entry, in SVG units: words in one picture and, beside it, what they tell of.

    Attributes
    ----------
    claim : Claim
    dots : dict of str to str
        Path of each kind of combinations: those under which the entry agrees, differs, or is not judged.
    seeds : str
        Path of the ranges over seeds.
    ticks : tuple of (float, str)
        Heights and texts on the axis of values.
    published : float or None
        Height of the published value; None where there is none, or it lies beyond all values.
    band : tuple of float or None
        Top and height of what agrees with it, inside the picture.
    axes : tuple of (float, str)
        Height and name of each axis, which stands above its options.
    options : tuple of (float, str, dict of str to str)
        Height and name of each option, and paths as of `dots` where it was on.
    height : float
    """

    claim: Claim
    dots: dict[str, str]
    seeds: str
    ticks: tuple[tuple[float, str], ...]
    published: float | None
    band: tuple[float, float] | None
    axes: tuple[tuple[float, str], ...]
    options: tuple[tuple[float, str, dict[str, str]], ...]
    height: float
    width: int = WIDTH

    @property
    def standing(self) -> Robustness:
        """Over the open choices."""
        return self.claim.over

    @property
    def words(self) -> int:
        """Width of the longest word beside the dots."""
        beside = [text for _, text in self.ticks] + [text for _, text, _ in self.options]
        return 10 + LETTER * max(map(len, beside))


def curves(topic: str, claims: list[Claim]) -> list[Curve]:
    """Of the claims of a topic that have a value under some combination: what is replicated most first."""
    judged = {claim.entry.id: claim for claim in claims if claim.over is not None}
    found = [
        curve_of(study, judged[entry])
        for study in read_results(load_axes(topic)[1])
        for entry, values in study.values.items()
        if np.isfinite(values).any()
    ]
    return sorted(found, key=lambda curve: VERDICTS.index(curve.claim.verdict))


def curve_of(study: Outcomes, claim: Claim) -> Curve:
    standing = claim.over
    points = np.flatnonzero(np.isfinite(standing.values).any(axis=1))
    middle = np.nanmean(standing.values[points], axis=1)
    order = np.argsort(middle, kind="stable")
    points, middle = points[order], middle[order]
    kinds = np.where(standing.agrees[points].mean(axis=1) >= 0.5, "agrees", "differs")
    if standing.agree is None:
        kinds[:] = "open"
    x = (np.arange(len(points)) + 0.5) * WIDTH / len(points)
    scale, ticks, published, band = _scale(standing, standing.values[points])
    low, high = (scale(pick(standing.values[points], axis=1)) for pick in (np.nanmin, np.nanmax))
    ranges = "".join(f"M{a:.1f} {b:.1f}V{c:.1f}" for a, b, c in zip(x, low, high, strict=True))

    touching = {axis.name for axis in standing.axes}
    axes, options, y = [], [], TOP + HEIGHT + 18.0
    for column, axis in enumerate(axis for axis in study.multiverse.axes if axis.name in touching):
        places = np.array([standing.settings[point][column] for point in points])
        axes.append((y, f"{axis.name}, {axis.texts[axis.default_index]} taken"))
        y += ROW
        for place, text in enumerate(axis.texts):
            options.append((y, text, _paths(x, y, kinds, places == place)))
            y += ROW
        y += ROW / 2
    dots = _paths(x, scale(middle), kinds, np.ones(len(points), bool))
    ranged = ranges if standing.values.shape[1] > 1 else ""
    return Curve(claim, dots, ranged, ticks, published, band, tuple(axes), tuple(options), y)


def _scale(standing: Robustness, values: np.ndarray):
    """From a value to a height; the ends of the axis, the published value and what agrees with it in heights."""
    entry, ends = standing.entry, [float(np.nanmin(values)), float(np.nanmax(values))]
    published = entry.published
    if published is not None and abs(published - np.mean(ends)) < 3 * max(np.ptp(ends), 0.1 * abs(published)):
        ends = [min(*ends, published), max(*ends, published)]
    if np.ptp(ends) == 0:
        ends = [ends[0] - 0.5 * abs(ends[0] or 1), ends[1] + 0.5 * abs(ends[1] or 1)]
    logarithmic = ends[0] > 0 and ends[1] / ends[0] > SPREAD
    shape = np.log if logarithmic else np.asarray
    bottom, top = shape(ends[0]), shape(ends[1])

    def height(value):
        return TOP + HEIGHT * (1 - (shape(value) - bottom) / (top - bottom))

    def inside(value: float) -> float:
        return ends[0] if value < ends[0] else min(value, ends[1])

    ticks = tuple((float(height(end)), f"{end:.3g}") for end in ends)
    if published is None or not ends[0] <= published <= ends[1]:
        return height, ticks, None, None
    band, tolerance = None, entry.tolerance
    if tolerance is not None and (
        reach := tolerance.absolute or (tolerance.relative or 0.0) * abs(published)
    ):
        upper, lower = (float(height(inside(published + sign * reach))) for sign in (1, -1))
        band = (upper, lower - upper)
    return height, ticks, float(height(published)), band


def _paths(x: np.ndarray, y: float | np.ndarray, kinds: np.ndarray, shown: np.ndarray) -> dict[str, str]:
    """A path of dots for each kind; of many elements a browser would make a slow page."""
    found: dict[str, str] = {}
    for at, height, kind in zip(x[shown], np.broadcast_to(y, len(x))[shown], kinds[shown], strict=True):
        found[kind] = found.get(kind, "") + f"M{at:.1f} {height:.1f}h0"
    return found


def over_combinations(standing: Robustness) -> str:
    """Under how many combinations of open choices a judged entry agrees, and what decides it.

    Parameters
    ----------
    standing : Robustness
    """
    tried, failed = standing.tried, int(standing.failed.sum())
    left = f" ({failed} more could not be judged)" if failed else ""
    if standing.agree == 0:
        return f"differs under all {tried} combinations{left}"
    number = f"all {tried}" if standing.agree == tried else f"{standing.agree} of {tried}"
    decided = f", decided by {' and '.join(standing.decided_by)}" if standing.decided_by else ""
    return f"agrees under {number} combinations{left}{decided}"


def status(claim: Claim) -> str:
    """Ours at our settings, inside its tolerance or outside; under how many combinations it agrees, and what decides."""
    words = [f"{claim.here} at our settings"] if claim.here in ("inside", "outside", "better") else []
    if (over := claim.over) is not None and over.share is not None:
        words.append(over_combinations(over))
    return "; ".join(words)


def said_of(statements: Iterable[Mapping[str, str]], claims: list[Claim]) -> list[tuple[dict, Claim]]:
    """What a paper says, each with the claim that judges it and the values of the other entries that it names."""
    by_id = {claim.entry.id: claim for claim in claims}
    pick = {"ours": our_quantity, "published": published_quantity}

    def filled(text: str) -> str:
        return re.sub(
            r"\{(ours|published):(\S+?)\}", lambda named: pick[named[1]](find(claims, named[2])), text
        )

    return [
        ({name: filled(text) for name, text in each.items()}, by_id[each["entry"]])
        for each in statements
        if each["entry"] in by_id
    ]


def sentence(said: Mapping[str, str], claim: Claim) -> str:
    """What came out, as a sentence: what the paper says, or its negation where that is not found.

    Parameters
    ----------
    said : mapping of str to str
        ``says``, what the paper says; ``otherwise``, the sentence where it is not found; without it the negation is general.
        In both ``{ours}`` and ``{published}`` stand for the values, behind a colon.
    claim : Claim
        The entry that judges it. What most combinations give decides which of the two it is; where our settings give
        the other, the sentence says that it is about most combinations, and leaves out what stands behind the colon.
    """
    if claim.ours is None and (claim.over is None or claim.over.share is None):
        return f"Not computed yet: {_begun_small(said['says'])}."
    holds = _holds(claim)
    as_by_default = holds == (claim.here not in DISAGREEMENT)
    if holds:
        words = said["says"]
    else:
        words = said.get(
            "otherwise", f"We did not find this: {_begun_small(said['says'].partition(': ')[0])}"
        )
    values = {"ours": our_quantity(claim), "published": published_quantity(claim)}
    words = re.sub(r"\{(ours|published)\}", lambda found: values[found[1]], words)
    if not as_by_default:
        if holds or "otherwise" in said:
            words = words.partition(": ")[0]
        words = f"Under most combinations of open choices, {_begun_small(words)}"
    return f"{words[:1].upper()}{words[1:]}."


def _holds(claim: Claim) -> bool:
    """Whether the verdict is that of a number found under most combinations; of what is not built, whether they agree."""
    if claim.verdict == "not built":
        return claim.over.share >= LEAST[1]
    return claim.verdict not in (RARELY, NOT_REPLICATED, "fails")


def _begun_small(words: str) -> str:
    """Within a sentence; an abbreviation keeps its letters."""
    return words if words[1:2].isupper() else words[:1].lower() + words[1:]
