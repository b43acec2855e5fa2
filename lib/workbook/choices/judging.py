"""How often an entry agrees over the combinations of open choices and what decides that.

Only the axes that touch an entry count: points that differ in other axes alone are copies of one setting. The default
setting has the value and the verdict of the ledger.
"""

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from workbook.checks import InputError
from workbook.choices.axes import Axis
from workbook.choices.results import Outcomes
from workbook.choices.variance import SEED, Shares, variance_shares
from workbook.claims import AGREEMENT, LEAST, Claim, Entry

DECIDES = 0.1  # least share of variance, joint effects included, of an axis that is named
NAMED = 2  # axes at most


@dataclass(frozen=True)
class Robustness:
    """How an entry fares over all combinations of the open choices that touch it.

    Attributes
    ----------
    entry : Entry
    axes : tuple of Axis
        Those that touch it; one of kind ``seed`` among them where the seeds do.
    settings : tuple of tuple of int
        Distinct settings of these axes without the seeds: the place of the option on each, in their order.
    values, agrees : ndarray, shape (settings, seeds)
        What was found, NaN where there is nothing, and whether it agrees. One column where no seed touches it.
    failed : ndarray of bool, shape (settings, seeds)
        Combinations that could not be computed; they count neither way.
    shares : Shares or None
        Of its variance: of the value's, or of the agreement's where there is no size.
    undeclared : tuple of str
        Axes that move it and are not declared to; known only where all combinations were computed.
    age : str
        What is to be noted of values that older code has computed; empty for those of the code as it is.
    differs : str
        Where the study's own verdict at the default is not that of the ledger: both values; else empty.
    """

    entry: Entry
    axes: tuple[Axis, ...]
    settings: tuple[tuple[int, ...], ...]
    values: np.ndarray
    agrees: np.ndarray
    failed: np.ndarray
    shares: Shares | None = None
    undeclared: tuple[str, ...] = ()
    age: str = ""
    differs: str = ""
    lean: str = ""  # of a study by a short form what that leaves out

    @property
    def options(self) -> tuple[Axis, ...]:
        """The axes of `settings`: without the seeds."""
        return tuple(axis for axis in self.axes if axis.kind != "seed")

    @property
    def size(self) -> int:
        """How many distinct settings there are; as many as were tried where all were."""
        return math.prod(len(axis.options) for axis in self.options)

    @property
    def tried(self) -> int:
        """Distinct combinations, with every seed that touches it, without those that failed."""
        return int((~self.failed).sum())

    @property
    def agree(self) -> int | None:
        """Combinations under which it agrees; None for what is not judged."""
        return None if self.entry.kind == "reported" else int(self.agrees.sum())

    @property
    def share(self) -> float | None:
        """Of the combinations under which it agrees."""
        return None if self.agree is None or not self.tried else self.agree / self.tried

    @property
    def interval(self) -> tuple[float, float] | None:
        """Wilson's interval of the share over distinct settings; several seeds at one are no further settings."""
        if self.share is None:
            return None
        from workbook.studies import proportion_interval  # imported here, since scipy is slow to import

        settings = int((~self.failed).any(axis=1).sum())
        independent = settings if settings > 1 else self.tried
        return proportion_interval(self.share * independent, independent)

    @property
    def decided_by(self) -> list[str]:
        """Of an entry that is mostly or rarely replicated, the one or two axes that move it most, joint effects included."""
        if self.share is None or self.shares is None or not LEAST[-1] <= self.share < LEAST[0]:
            return []
        ranked = sorted(self.shares.total, key=lambda name: (-self.shares.total[name], name))
        return [name for name in ranked[:NAMED] if self.shares.total[name] >= DECIDES]

    def as_dict(self) -> dict:
        """All of it as plain values, for JSON."""
        there = self.values[np.isfinite(self.values)]
        return {
            "tried": self.tried,
            "settings": len(self.settings),
            "of": self.size,
            "failed": int(self.failed.sum()),
            "agree": self.agree,
            "share": self.share,
            "interval": list(self.interval) if self.interval else None,
            "range": [float(there.min()), float(there.max())] if there.size else None,
            "decided_by": [
                {"axis": name, "first_order": self.shares.first[name], "total": self.shares.total[name]}
                for name in self.decided_by
            ],
            "axes": [
                {"axis": axis.name, "options": list(axis.options), "unit": axis.unit, "after": axis.after}
                for axis in self.axes
            ],
            "age": self.age,
            "differs": self.differs,
            "short form": self.lean,
        }


def judge(
    studies: list[Outcomes],
    entries: dict[str, Entry],
    axes: dict[str, Axis],
    claims: Mapping[str, Claim] = MappingProxyType({}),
) -> dict[str, Robustness]:
    """Robustness of every entry that the studies of a topic give, by id.

    Parameters
    ----------
    studies : list of Outcomes
    entries : dict of str to Entry
        The topic's ledger.
    axes : dict of str to Axis
        By name, as declared.
    claims : mapping of str to Claim
        The ledger's values; the default combination uses them, so that it has one result.
    """
    parts = {
        name: _Part(study, entries[name], claims.get(name))
        for study in studies
        for name in study.multiverse.entries
    }
    return {name: _robustness(part, axes) for name, part in parts.items()}


def agreement(study: Outcomes, entry: Entry) -> np.ndarray:
    """Whether an entry agrees, by the ledger's own rule, under each combination: (points, seeds).

    If the rule needs an interval over runs and the study gives none, it is the one over the seeds at the point;
    of a fraction of runs, each seed's own fraction is compared with the threshold.
    """
    values = study.values[entry.id]
    nothing = np.full(values.shape, np.nan)
    low, high = study.low.get(entry.id, nothing), study.high.get(entry.id, nothing)
    by_interval = entry.tolerance is not None and entry.tolerance.interval is not None
    agrees = np.zeros(values.shape, bool)
    for at in zip(*np.nonzero(np.isfinite(values)), strict=True):
        ours, interval = float(values[at]), (float(low[at]), float(high[at]))
        if math.isnan(interval[0]):
            interval = _over_seeds(entry, values[at[0]]) if by_interval else (ours, ours)
        agrees[at] = Claim(entry, ours, interval).here in AGREEMENT
    return agrees


def _over_seeds(entry: Entry, values: np.ndarray) -> tuple[float, float]:
    from workbook.studies import spread_interval

    there = values[np.isfinite(values)]
    if len(values) < 2:
        raise InputError(
            f"{entry.id} is judged by an interval; give its study an axis of kind 'seed', or let it return one"
        )
    return spread_interval(there, entry.tolerance.interval) if len(there) > 1 else (math.nan, math.nan)


class _Part:
    """An entry within its study: values and agreement by point and seed, the ledger's at the default."""

    def __init__(self, study: Outcomes, entry: Entry, claim: Claim | None):
        self.study, self.entry = study, entry
        self.values, self.failed = study.values[entry.id].copy(), study.failed
        judged = entry.kind != "reported"
        self.agrees = agreement(study, entry) if judged else np.zeros(self.values.shape, bool)
        self.differs = ""
        self.default = None  # value and agreement at the default combination, of the ledger
        self.own = None  # and the point and seed that have them
        if claim is not None and claim.ours is not None:
            self._take_over(claim, judged)

    def _take_over(self, claim: Claim, judged: bool) -> None:
        at = self.study.multiverse.default_point
        agrees = judged and claim.here in AGREEMENT
        self.default = (claim.ours, agrees)
        if at not in self.study.design or self.failed[point := self.study.design.index(at), 0]:
            return
        if judged and bool(self.agrees[point, 0]) != agrees:
            self.differs = f"{self.values[point, 0]:.4g} in its study, {claim.ours:.4g} in the ledger"
        self.own = (point, 0)
        self.values[self.own], self.agrees[self.own] = claim.ours, agrees


def _robustness(part: _Part, axes: dict[str, Axis]) -> Robustness:
    study, entry = part.study, part.entry
    multiverse = study.multiverse
    touched = multiverse.touched[entry.id]
    columns = multiverse.columns(entry.id)
    seeded = multiverse.seeded and any(axes[name].kind == "seed" for name in touched)
    copies = defaultdict(list)
    for point, places in enumerate(study.design):
        copies[tuple(places[k] for k in columns)].append(point)
    shape = (len(copies), len(multiverse.seeds) if seeded else 1)
    values, agrees, failed = np.full(shape, np.nan), np.zeros(shape, bool), np.ones(shape, bool)
    for row, points in enumerate(copies.values()):
        for seed in range(shape[1]):
            cells = [
                (point, each)
                for point in points
                for each in ([seed] if seeded else range(part.values.shape[1]))
            ]
            there = [cell for cell in cells if not part.failed[cell]]
            if there:  # copies of one setting have one value; the first point is the default
                values[row, seed], failed[row, seed] = part.values[there[0]], False
                most = 2 * sum(part.agrees[cell] for cell in there) >= len(there)
                agrees[row, seed] = part.default[1] if there[0] == part.own else most
    is_fraction = entry.kind != "reported" and entry.is_fraction
    quantity = np.where(failed, np.nan, agrees.astype(float)) if is_fraction else values
    sizes = {multiverse.axes[k].name: len(multiverse.axes[k].options) for k in columns}
    return Robustness(
        entry,
        tuple(axes[name] for name in axes if name in touched),
        tuple(copies),
        values,
        agrees,
        failed,
        _under_own_names(variance_shares(quantity, list(copies), sizes, seeded), axes, touched),
        _undeclared(part),
        differs=part.differs,
        lean=multiverse.lean,
    )


def _undeclared(part: _Part) -> tuple[str, ...]:
    """Axes that move an entry and are not declared to; where all was computed, for a sample is too small to decide."""
    study = part.study
    multiverse, touched = study.multiverse, study.multiverse.touched[part.entry.id]
    if len(study.design) < multiverse.size:
        return ()
    values, is_fraction = (
        study.values[part.entry.id],
        part.entry.kind != "reported" and part.entry.is_fraction,
    )
    if is_fraction:
        values = np.where(study.failed, np.nan, agreement(study, part.entry).astype(float))
    sizes = {axis.name: len(axis.options) for axis in multiverse.axes}
    shares = variance_shares(values, study.design, sizes, multiverse.seeded)
    if shares is None:
        return ()
    return tuple(name for name in sizes if name not in touched and shares.total[name] > 1e-6)


def _under_own_names(shares: Shares | None, axes, touched) -> Shares | None:
    """Shares of the axes that touch an entry; the seeds under the name of the axis that lists them."""
    if shares is None:
        return None
    names = {name: name for name in touched if name in shares.first}
    names |= {name: SEED for name in touched if axes[name].kind == "seed" and SEED in shares.first}
    return Shares(
        {own: shares.first[name] for own, name in names.items()},
        {own: shares.total[name] for own, name in names.items()},
    )
