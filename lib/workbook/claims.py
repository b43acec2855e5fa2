"""The ledger: every published number, the value replicated here, and the verdict on the pair.

A topic's published numbers stand in ``data/<topic>/published.toml``, entered by hand; what a notebook found stands in
``figures/<topic>/<notebook>/claims.json``, written by a build. A verdict is computed from the two and never written
down.
"""

import json
import math
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from html import escape
from itertools import zip_longest
from pathlib import Path
from typing import Any

from workbook import paths
from workbook.checks import (
    InputError,
    nearest,
    require_array,
    require_choice,
    require_fields,
    require_kind,
    require_number,
    short_repr,
)

KINDS = ("value", "exact", "ordering", "slope", "reported", "check")
REPLICATED, MOSTLY, RARELY, NOT_REPLICATED = VERDICT_WORDS = (
    "replicated",
    "mostly replicated",
    "rarely replicated",
    "not replicated",
)
LEAST = (0.95, 0.5, 0.05)  # share of the combinations that agree, from which on each of the first three holds
VERDICTS = (*VERDICT_WORDS, "not judged", "passes", "fails", "not built")
HERE = ("inside", "better", "outside", "passes", "fails", "not judged", "not built")
AGREEMENT = ("inside", "better", "passes")
DISAGREEMENT = ("outside", "fails")
BASES = ("predicted", "fitted", "calibrated")
MOST = 10  # claims that a page's table shows
SECOND = ("not judged", "passes", "fails")  # what it shows where there is room


@dataclass(frozen=True)
class Tolerance:
    """How far a value may lie from another; exactly one rule, and where the rule comes from."""

    source: str
    relative: float | None = None
    absolute: float | None = None
    interval: float | None = None  # level of the interval over runs that must hold the published value

    def __post_init__(self):
        rules = [self.relative, self.absolute, self.interval]
        if sum(rule is not None for rule in rules) != 1:
            raise InputError("tolerance: give exactly one of relative, absolute and interval")
        require_number("tolerance", next(r for r in rules if r is not None), at_least=0)
        if not isinstance(self.source, str) or not self.source:
            raise InputError("tolerance: state in source where it comes from")

    def allows(self, published: float, ours: float, interval: tuple[float, float] | None) -> bool:
        if self.interval is not None:
            if interval is None:
                raise InputError("this claim is judged by an interval; pass interval=(low, high)")
            return interval[0] <= published <= interval[1]
        return abs(ours - published) <= self.width(published)

    def width(self, value: float) -> float:
        """How far another value may lie from this one, by a relative or absolute rule."""
        return self.absolute if self.relative is None else self.relative * abs(value)


# How far a rebuilt value may lie from the accepted one, unless the entry states otherwise.
DRIFT = Tolerance("room for the rounding of another machine, far below any tolerance in use", relative=1e-3)


@dataclass(frozen=True)
class Entry:
    """One published number or statement, as the ledger's TOML gives it.

    Attributes
    ----------
    id : str
        Dotted name, topic first.
    place : str
        Where it stands in the work.
    quantity, unit : str
        What it is.
    published : float or None
        The published value; for an ordering the fraction of runs that must obey it, 1. None only for `reported`
        and `check`: what the work does not state.
    kind : str
        ``value``, ``exact``, ``ordering``, ``slope``, ``reported`` (shown, not judged) or ``check`` (of our own:
        no replication).
    tolerance : Tolerance or None
        None for `reported`, `ordering`, and a check that is a fraction of runs.
    drift : Tolerance
        How far a rebuilt value may lie from the accepted one, relative or absolute. A value that is a small
        difference of large ones, or a fit to rounding, moves by more than a part of itself.
    basis : str
        ``predicted``; ``fitted`` or ``calibrated`` when the published value itself went into the model.
    reason : str
        Why ours differs or cannot be judged.
    threshold : float or None
        For an ordering, and a check that is a fraction of runs: the least fraction that must obey it. The lower
        end of the fraction's interval over runs is compared with it. Without one, all runs must obey it.
    better : str or None
        ``larger`` or ``smaller`` where a value on that side of the published one is better.
    counterfactual : bool
        Whether it is a case that the paper did not run, e.g. with its filter corrected.
    headline : bool
        Whether the page of its notebook begins with it.
    expected : float or None
        For a check, what theory gives and the work does not state. Without it and without a published value a
        check is the residual of an identity: nothing should be left.
    open : str
        ``none: ...`` with the reason, where the paper leaves nothing open for it; else a study tries what is open.
    """

    id: str
    place: str
    quantity: str
    unit: str
    kind: str
    published: float | None = None
    tolerance: Tolerance | None = None
    drift: Tolerance = DRIFT
    basis: str = "predicted"
    reason: str = ""
    threshold: float | None = None
    better: str | None = None
    counterfactual: bool = False
    expected: float | None = None
    open: str = ""
    headline: bool = False

    def __post_init__(self):
        require_choice(f"{self.id}: kind", self.kind, KINDS)
        require_choice(f"{self.id}: basis", self.basis, BASES)
        for name in ("place", "quantity", "unit", "reason", "open"):
            require_kind(f"{self.id}: {name}", getattr(self, name), str)
            if name in ("place", "quantity") and not getattr(self, name):
                raise InputError(f"{self.id}: {name} is empty; fill it in")
        if self.published is not None:
            require_number(f"{self.id}: published", self.published)
        elif self.kind not in ("reported", "check"):
            raise InputError(
                f"{self.id}: published is missing; only a check or what is reported goes without"
            )
        if self.kind in ("value", "exact", "slope") and self.tolerance is None:
            raise InputError(f"{self.id}: a {self.kind} needs a tolerance with a source")
        if self.kind in ("reported", "ordering") and self.tolerance is not None:
            raise InputError(f"{self.id}: {self.kind} takes no tolerance; remove it")
        if self.drift.interval is not None:
            raise InputError(f"{self.id}: drift takes relative or absolute, not interval")
        if self.kind == "reported" and not self.reason:
            raise InputError(f"{self.id}: state in reason why it is not judged")
        self._require_threshold()
        if self.open and not self.open.startswith("none: "):
            raise InputError(
                f"{self.id}: open is {short_repr(self.open)}; give 'none: ' and the reason, or a study"
            )
        if self.expected is not None:
            require_number(f"{self.id}: expected", self.expected)
            if self.kind != "check" or self.tolerance is None or self.published is not None:
                raise InputError(
                    f"{self.id}: only a check of a size that is not published takes expected; remove it"
                )
        if self.better is not None:
            require_choice(f"{self.id}: better", self.better, ("larger", "smaller"))
            if self.kind not in ("value", "slope"):
                raise InputError(f"{self.id}: {self.kind} takes no better; remove it")

    def _require_threshold(self):
        if self.threshold is None:
            return
        if not self.is_fraction:
            raise InputError(f"{self.id}: only a fraction of runs takes a threshold; remove it")
        require_number(f"{self.id}: threshold", self.threshold, above=0, at_most=1)

    @property
    def is_fraction(self) -> bool:
        """Whether it is judged by the fraction of runs that obey it."""
        return self.kind == "ordering" or (self.kind == "check" and self.tolerance is None)

    @property
    def needs_interval(self) -> bool:
        """Whether it is judged by an interval over runs."""
        return self.threshold is not None or (
            self.tolerance is not None and self.tolerance.interval is not None
        )

    @property
    def is_residual(self) -> bool:
        """Whether it is what an identity leaves: rounding, judged by its tolerance alone."""
        if self.kind != "check":
            return self.kind == "exact"
        return self.tolerance is not None and self.published is None and self.expected is None

    @property
    def is_own(self) -> bool:
        """Whether it is ours alone: a check, or a number that the work does not state."""
        return self.kind == "check" or self.published is None

    @property
    def is_replication(self) -> bool:
        """Whether it counts among the published numbers that were compared with ours."""
        return not self.is_own and not self.counterfactual

    @property
    def topic(self) -> str:
        return self.id.partition(".")[0]


def rounded(value: float, digits: int) -> str:
    """So many digits, in thousands without an exponent: 4380, not 4.38e+03."""
    return f"{float(f'{value:.{digits}g}'):.10g}"


@dataclass(frozen=True)
class Claim:
    """An entry with the value found by a notebook (None: not built yet).

    `over` is how it fares over the open choices, as `workbook.choices.command.judged_ledger` gives it; without it nothing
    is open.
    """

    entry: Entry
    ours: float | None = None
    interval: tuple[float, float] | None = None
    notebook: str = ""
    over: Any = field(default=None, compare=False, repr=False)

    @property
    def verdict(self) -> str:
        """The one word on an entry, from the share of the combinations of open choices that agree.

        ``replicated`` from 95 %, or where nothing is open and ours agrees; ``mostly replicated`` from 50 %; ``rarely
        replicated`` from 5 %; else ``not replicated``; ``not judged``, see `unjudged`. An own check ``passes`` or
        ``fails``. ``not built`` where a notebook has not found it yet.
        """
        here = self.here
        if here in ("not built", "passes", "fails"):
            return here
        if self.entry.kind == "reported":
            return "not judged"
        share = None if self.over is None else self.over.share
        if share is None:
            share = float(here in AGREEMENT)
        word = next(
            (w for w, least in zip(VERDICT_WORDS, LEAST, strict=False) if share >= least), NOT_REPLICATED
        )
        return "not judged" if word != NOT_REPLICATED and self.is_too_wide else word

    @property
    def unjudged(self) -> str:
        """Why it is not judged; empty where it is."""
        if self.verdict != "not judged":
            return ""
        if self.entry.kind == "reported":
            return self.entry.reason
        return f"What agrees with it is wider than the printed value, {self.entry.published:.4g}."

    @property
    def is_too_wide(self) -> bool:
        """Whether a two-sided rule takes in more than the printed value's own size, so that it cannot replicate it."""
        entry, rule = self.entry, self.entry.tolerance
        if not entry.published or rule is None or entry.better or entry.kind == "check":
            return False
        if rule.interval is None:
            return 2 * rule.width(entry.published) > abs(entry.published)
        return self.interval is not None and self.interval[1] - self.interval[0] > abs(entry.published)

    @property
    def here(self) -> str:
        """What comes of ours at our settings alone: ``inside`` or ``outside`` the entry's tolerance.

        ``better`` where ours lies outside on the side that the entry calls better; ``passes`` or ``fails`` for a check;
        ``not judged``; ``not built``.
        """
        entry = self.entry
        if self.ours is None:
            return "not built"
        if entry.kind == "reported":
            return "not judged"
        if self._agrees():
            return "passes" if entry.kind == "check" else "inside"
        if entry.kind == "check":
            return "fails"
        larger = self.ours > entry.published
        return "better" if entry.better == ("larger" if larger else "smaller") else "outside"

    @property
    def shown_here(self) -> str:
        """`here` as a page shows it: ``not judged`` where the ledger does not judge it either."""
        return "not judged" if self.verdict == "not judged" else self.here

    def _agrees(self) -> bool:
        entry = self.entry
        if not entry.is_fraction:
            aim = entry.published if entry.expected is None else entry.expected
            return entry.tolerance.allows(aim or 0.0, self.ours, self.interval)
        if entry.threshold is None:
            return self.ours == (1.0 if entry.published is None else entry.published)
        if self.interval is None:
            raise InputError(
                f"{entry.id} is judged by the interval of a fraction over runs; pass interval=(low, high), "
                "e.g. from workbook.studies.proportion_interval"
            )
        return self.interval[0] >= entry.threshold

    @property
    def judgement(self) -> str:
        """The verdict, and in brackets ours at our settings, what it rests on, and that the work did no such thing."""
        entry, verdict = self.entry, self.verdict
        notes = [self.here] * (verdict in VERDICT_WORDS)
        notes += [entry.basis] * (verdict in VERDICT_WORDS) + ["counterfactual"] * entry.counterfactual
        return f"{verdict} ({', '.join(notes)})" if notes else verdict

    @property
    def deviation(self) -> float | None:
        """Relative distance from the published value; None where it has no meaning."""
        if self.ours is None or not self.entry.published:
            return None
        return abs(self.ours - self.entry.published) / abs(self.entry.published)

    def shown(self, digits: int) -> str:
        """Ours as text; of what is rounding the bound that it keeps: an identity's residual, or less than its drift."""
        entry = self.entry
        if entry.drift.absolute and abs(self.ours) <= entry.drift.absolute:
            return f"< {entry.drift.absolute:g}"
        if entry.is_residual and not entry.published and self.here in AGREEMENT:
            if bound := entry.tolerance.absolute:  # 0 where a count is judged
                return f"< {bound:g}"
        if self.ours and entry.drift.absolute:  # no digit that another processor may turn
            size, room = (math.log10(abs(each)) for each in (self.ours, entry.drift.absolute))
            digits = min(digits, max(1, 1 + math.floor(size) - math.ceil(room)))
        text = rounded(self.ours, digits)
        while entry.is_fraction and float(text) == 1 != self.ours and digits < 8:  # nearly all is not all
            digits += 1
            text = rounded(self.ours, digits)
        return text

    def row(self, digits: int) -> tuple[str, ...]:
        """Cells of a table: id, place, published value, ours, its interval, unit."""
        entry = self.entry
        ours = "" if self.ours is None else self.shown(digits)
        published = "" if entry.published is None else f"{entry.published:.4g}"
        spread = " .. ".join(rounded(end, 3) for end in self.interval) if self.interval else ""
        return entry.id, entry.place, published, ours, spread, entry.unit

    def as_dict(self) -> dict:
        """All of it as plain values, for JSON and for tables."""
        entry = self.entry
        return {
            "id": entry.id,
            "place": entry.place,
            "quantity": entry.quantity,
            "unit": entry.unit,
            "kind": entry.kind,
            "basis": entry.basis,
            "published": entry.published,
            "expected": entry.expected,
            "threshold": entry.threshold,
            "better": entry.better,
            "own": entry.is_own,
            "counterfactual": entry.counterfactual,
            "ours": self.ours,
            "interval": list(self.interval) if self.interval else None,
            "verdict": self.verdict,
            "here": self.here,
            "tolerance": entry.tolerance.source if entry.tolerance else "",
            "reason": entry.reason,
            "notebook": self.notebook,
        }


def load_entries(topic: str) -> dict[str, Entry]:
    """Read the published numbers of a topic, by id.

    Raises
    ------
    InputError
        When there is no such topic, or an entry is incomplete or holds an unknown field; the message names it.
    """
    file = paths.data(paths.require_topic(topic), "published.toml")
    try:
        text = file.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{file} is not text; give TOML in UTF-8") from None
    return dict(_parsed(file, text))


@lru_cache(maxsize=32)  # a notebook reads the same text at every check
def _parsed(file: Path, text: str) -> dict[str, Entry]:
    try:
        tree = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{file}: not valid TOML ({error}); correct that line") from None
    return {entry.id: entry for entry in _entries(tree, ())}


def _entries(tree: dict, path: tuple[str, ...]) -> Iterator[Entry]:
    if "place" in tree:
        yield _entry(".".join(path), tree)
        return
    for name, branch in tree.items():
        if not isinstance(branch, dict):
            raise InputError(f"{'.'.join((*path, name))}: a value outside any entry; give the entry a place")
        yield from _entries(branch, (*path, name))


def _entry(name: str, fields: dict) -> Entry:
    known = [key for key in Entry.__dataclass_fields__ if key != "id"]
    rules = {key: fields[key] for key in ("tolerance", "drift") if key in fields}
    require_fields(name, fields, known)
    for key, rule in rules.items():
        require_fields(f"{name}: {key}", rule, Tolerance.__dataclass_fields__)
    for flag in ("counterfactual", "headline"):
        require_kind(f"{name}: {flag}", fields.get(flag, False), bool)
    try:
        return Entry(id=name, **{**fields, **{key: Tolerance(**rule) for key, rule in rules.items()}})
    except (TypeError, InputError) as error:
        raise InputError(f"{name}: {error}") from None


@dataclass
class ClaimsTable:
    """What one run found, inside its tolerance or outside; prints as a text table."""

    claims: list[Claim] = field(default_factory=list)
    note: str = ""  # what a run with other settings says first
    most: int = MOST  # rows that are shown

    def add(self, claim: Claim) -> None:
        """Add a claim; a second value for the same id replaces the first."""
        self.claims = [c for c in self.claims if c.entry.id != claim.entry.id] + [claim]

    def write(self, file: Path) -> None:
        """Write the values (not the verdicts) as JSON."""
        found = {
            claim.entry.id: {
                "ours": claim.ours,
                **({"interval": list(claim.interval)} if claim.interval else {}),
            }
            for claim in self.claims
        }
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(claims_text(found), encoding="utf-8")

    @property
    def shown(self) -> list[Claim]:
        """At most `most`: the ledger's headlines, then what is judged and published, of each figure or table in turn."""
        groups: dict[str, list[Claim]] = {}
        for claim in self.claims:
            groups.setdefault(claim.entry.id.split(".")[1], []).append(claim)
        turns = [claim for turn in zip_longest(*groups.values()) for claim in turn if claim is not None]
        turns.sort(key=lambda claim: (not claim.entry.headline, claim.shown_here in SECOND))
        chosen = {claim.entry.id for claim in turns[: self.most]}
        return [claim for claim in self.claims if claim.entry.id in chosen]

    @property
    def rest(self) -> "ClaimsTable":
        """Those that a page does not show; its appendix lists them."""
        shown = {claim.entry.id for claim in self.shown}
        rest = [claim for claim in self.claims if claim.entry.id not in shown]
        return ClaimsTable(rest, most=len(rest))

    def _rows(self) -> list[tuple[str, ...]]:
        head = ("claim", "place", "published", "ours", "interval", "unit", "here")
        return [head, *((*claim.row(3), claim.shown_here) for claim in self.shown)]

    def _after(self) -> list[str]:
        """Where the others stand; then each reason once, with those that share it: reasons are of the accepted settings."""
        shared: dict[str, list[str]] = {}
        for claim in self.shown:
            if claim.entry.reason and claim.shown_here not in AGREEMENT and not self.note:
                shared.setdefault(claim.entry.reason, []).append(claim.entry.id)
        left = len(self.claims) - len(self.shown)
        return [f"{left} more: on the page of the site (`make site`)."] * bool(left) + [
            f"{', '.join(ids) if len(ids) < 4 else f'{ids[0]} and {len(ids) - 1} others'}: {why}"
            for why, ids in shared.items()
        ]

    def __repr__(self) -> str:
        rows = self._rows()
        widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
        lines = ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows]
        lines.insert(1, "-" * len(lines[0]))
        after = self._after()
        return "\n".join([*self.note.splitlines(), *lines, *(["", *after] if after else [])])

    def _repr_html_(self) -> str:
        head, *body = self._rows()
        lines = ["".join(f"<th>{word}</th>" for word in head)]
        lines += ["".join(f"<td>{escape(word)}</td>" for word in row) for row in body]
        table = "".join(f"<tr>{line}</tr>" for line in lines)
        note = "".join(f"<p>{escape(line)}</p>" for line in self.note.splitlines())
        return f"{note}<table>{table}</table>" + "".join(f"<p>{escape(why)}</p>" for why in self._after())


def claims_text(found: dict[str, dict]) -> str:
    """The text of a ``claims.json``."""
    return json.dumps(found, indent=1) + "\n"


def make_claim(
    name: str, ours: float, interval: tuple[float, float] | None = None, notebook: str = ""
) -> Claim:
    """Hold a value against the ledger's entry `name`.

    Raises
    ------
    InputError
        When the ledger has no such entry (the nearest is named), the value is not finite, or a fraction of runs
        leaves 0 to 1.
    """
    topic = require_kind("claim", name, str).partition(".")[0]
    entries = load_entries(topic)
    if name not in entries:
        raise InputError(f"the ledger has no entry {short_repr(name)}{nearest(name, entries)}")
    within = {"at_least": 0, "at_most": 1} if entries[name].is_fraction else {}
    value = require_number(name, ours, **within)
    if interval is not None:
        low, high = require_array(f"{name}: interval", interval, shape=(2,)).tolist()
        if low > high:
            raise InputError(f"{name}: interval is ({low:g}, {high:g}); give the lower end first")
        require_number(f"{name}: lower end of the interval", low, **within)
        require_number(f"{name}: upper end of the interval", high, **within)
        interval = _rounded(low), _rounded(high)
    return Claim(entries[name], _rounded(value), interval, notebook)


def _rounded(value: float) -> float:
    return float(f"{value:.8g}")


def ledger(figures: Path | None = None, topic: str | None = None) -> list[Claim]:
    """The whole ledger: every entry with what the built notebooks found.

    A value without the interval that its entry requires does not count: it is older than that requirement.

    Parameters
    ----------
    figures : Path, optional
        Folder of built figures; by default the workbook's own.
    topic : str, optional
        Only this topic.

    Raises
    ------
    InputError
        When a notebook recorded a value for an entry that the ledger lacks, or two notebooks claim one.
    """
    figures = figures or paths.root() / "figures"
    claims = {
        name: Claim(entry)
        for each in ([topic] if topic else paths.topics())
        for name, entry in load_entries(each).items()
    }
    pattern = f"{topic or '[!.]*'}/[!.]*/claims.json"  # a build's half-written folders are hidden
    for file in sorted(figures.glob(pattern)):
        notebook = file.parent.relative_to(figures).as_posix()
        for name, (ours, interval) in recorded_claims(file).items():
            if name not in claims:
                raise InputError(f"{file}: the ledger has no entry {name!r}{nearest(name, claims)}")
            if claims[name].notebook:
                raise InputError(f"{name} is claimed by {claims[name].notebook} and by {notebook}; keep one")
            if interval is None and claims[name].entry.needs_interval:
                ours = None
            claims[name] = replace(claims[name], ours=ours, interval=interval, notebook=notebook)
    return list(claims.values())


def recorded_claims(file: Path) -> dict[str, tuple[float, tuple[float, float] | None]]:
    """What a notebook recorded in its ``claims.json``: value and interval of every claim."""
    try:
        recorded = json.loads(file.read_text(encoding="utf-8"))
        return {
            name: (
                require_number(f"{name}: ours", entry["ours"]),
                tuple(require_array(f"{name}: interval", entry["interval"], shape=(2,)).tolist())
                if "interval" in entry
                else None,
            )
            for name, entry in recorded.items()
        }
    except (InputError, ValueError, RecursionError, AttributeError, KeyError, TypeError) as error:
        raise InputError(f"{file} is not what a build writes ({error}); build that notebook anew") from None
