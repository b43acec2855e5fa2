"""What the combinations say of each entry: how often it agrees, what decides that, and the best joint combination."""

import itertools
import math
from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np

from stillwork.base.checks import InputError
from workbook.choices.axes import Axis, Option
from workbook.choices.results import Outcomes
from workbook.choices.variance import SEED, Shares, variance_shares
from workbook.claims import AGREEMENT, Claim, Entry

ROBUST, DEPENDS, NOT_REPRODUCED = "robust", "depends", "not reproduced"
CERTAIN = (
    0.95  # share of combinations from which on an entry is robust; up to the rest of 1 it is not reproduced
)
DECIDES = 0.1  # least share of variance, joint effects included, of an axis that is named
NAMED = 2  # axes at most
NEAR = (
    0.05,
    0.15,
    0.25,
)  # of a published value: relative distances within which a table's numbers are counted


@dataclass(frozen=True)
class Joint:
    """The best combination of a group that was published together: one combination for all its numbers.

    Attributes
    ----------
    group : str
        First two parts of the ids.
    combination : dict of str to option
        By axis.
    moved : tuple of str
        Axes that are not at their default there.
    agreeing : tuple of str
        Entries that agree there in at least half of the seeds.
    ours : dict of str to float
        Mean over the seeds there, by entry.
    near : dict of str to int
        How many of the published values are within 5, 15 and 25 % there, and of how many: ``{"5%": 3, ..., "of": 9}``.
    tried : int
        Combinations among which it is the best.
    """

    group: str
    combination: dict[str, Option]
    moved: tuple[str, ...]
    agreeing: tuple[str, ...]
    ours: dict[str, float]
    near: dict[str, int]
    tried: int


@dataclass(frozen=True)
class Robustness:
    """How an entry stands over all combinations.

    Attributes
    ----------
    entry : Entry
    axes : tuple of Axis
        Those that touch it.
    values, agrees : ndarray, shape (points, seeds)
        What was found, NaN where there is nothing, and whether it agrees.
    failed : ndarray of bool, shape (points, seeds)
        Combinations that could not be computed; they count neither way.
    shares : Shares or None
        Of its variance: of the value's, or of the agreement's where there is no size.
    undeclared : tuple of str
        Axes that move it and do not say so; known only where all combinations were computed.
    joint : Joint or None
    age : str
        What is to be said of values that older code has computed; empty for those of the code as it is.
    """

    entry: Entry
    axes: tuple[Axis, ...]
    values: np.ndarray
    agrees: np.ndarray
    failed: np.ndarray
    shares: Shares | None = None
    undeclared: tuple[str, ...] = ()
    joint: Joint | None = None
    age: str = ""

    @property
    def tried(self) -> int:
        """Combinations with every seed, without those that failed."""
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
        """Wilson's interval of the share; runs at one point with several seeds are no independent combinations."""
        if self.share is None:
            return None
        from workbook.studies import proportion_interval  # whose scipy only who asks for it waits for

        points = int((~self.failed).any(axis=1).sum())
        independent = points if points > 1 else self.tried
        return proportion_interval(self.share * independent, independent)

    @property
    def class_(self) -> str | None:
        """``robust``, ``depends`` or ``not reproduced``."""
        if self.share is None:
            return None
        return ROBUST if self.share >= CERTAIN else NOT_REPRODUCED if self.share <= 1 - CERTAIN else DEPENDS

    @property
    def decided_by(self) -> list[str]:
        """Of an entry that depends, the one or two axes that move it most, joint effects included."""
        if self.class_ != DEPENDS or self.shares is None:
            return []
        ranked = sorted(self.shares.total, key=lambda name: (-self.shares.total[name], name))
        return [name for name in ranked[:NAMED] if self.shares.total[name] >= DECIDES]

    def as_dict(self) -> dict:
        """All of it as plain values, for JSON."""
        there = self.values[np.isfinite(self.values)]
        return {
            "tried": self.tried,
            "failed": int(self.failed.sum()),
            "agree": self.agree,
            "share": self.share,
            "interval": list(self.interval) if self.interval else None,
            "class": self.class_,
            "range": [float(there.min()), float(there.max())] if there.size else None,
            "decided_by": [
                {"axis": name, "first_order": self.shares.first[name], "total": self.shares.total[name]}
                for name in self.decided_by
            ],
            "axes": [
                {"axis": axis.name, "options": list(axis.options), "unit": axis.unit, "after": axis.after}
                for axis in self.axes
            ],
            "joint": self._joint(),
            "age": self.age,
        }

    def _joint(self) -> dict | None:
        joint, name = self.joint, self.entry.id
        if joint is None:
            return None
        ours = joint.ours[name]
        return {
            "group": joint.group,
            "ours": ours if math.isfinite(ours) else None,
            "agrees": name in joint.agreeing,
            "basis": "calibrated" if joint.moved else self.entry.basis,
            "combination": joint.combination,
            "tried": joint.tried,
            "agreeing": len(joint.agreeing),
            "of": len(joint.ours),
            "within": joint.near,
        }


def judge(studies: list[Outcomes], entries: dict[str, Entry], axes: dict[str, Axis]) -> dict[str, Robustness]:
    """Robustness of every entry that the studies of a topic give, by id.

    Parameters
    ----------
    studies : list of Outcomes
    entries : dict of str to Entry
        The topic's ledger.
    axes : dict of str to Axis
        By name, as declared.
    """
    standings = {}
    for study in studies:
        for name in study.multiverse.entries:
            standings[name] = _standing(study, entries[name], axes)
    groups = defaultdict(list)
    for name, standing in standings.items():
        if standing.entry.is_replication and standing.agree is not None:
            groups[group_of(name)].append(name)
    for group, names in groups.items():
        joint = _best_joint(group, names, studies, standings)
        if joint is not None:
            for name in names:
                standings[name] = replace(standings[name], joint=joint)
    return standings


def group_of(entry: str) -> str:
    """What was published together: the first two parts of an id, a topic and its table or figure."""
    return ".".join(entry.split(".")[:2])


def agreement(study: Outcomes, entry: Entry) -> np.ndarray:
    """Whether an entry agrees, by the ledger's own rule, under each combination: (points, seeds).

    Where the rule asks for an interval over runs and the study gives none, it is the one over the seeds at the point;
    of a fraction of runs, each seed's own fraction is held against the threshold.
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
        agrees[at] = Claim(entry, ours, interval).verdict in AGREEMENT
    return agrees


def _over_seeds(entry: Entry, values: np.ndarray) -> tuple[float, float]:
    from workbook.studies import spread_interval

    there = values[np.isfinite(values)]
    if len(values) < 2:
        raise InputError(
            f"{entry.id} is judged by an interval; give its study an axis of kind 'seed', or let it return one"
        )
    return spread_interval(there, entry.tolerance.interval) if len(there) > 1 else (math.nan, math.nan)


def _standing(study: Outcomes, entry: Entry, axes: dict[str, Axis]) -> Robustness:
    multiverse = study.multiverse
    values, failed = study.values[entry.id], study.failed
    judged = entry.kind != "reported"
    agrees = agreement(study, entry) if judged else np.zeros(values.shape, bool)
    quantity = values
    if judged and entry.is_fraction:
        quantity = np.where(failed, np.nan, agrees.astype(float))
    touched = multiverse.touched[entry.id]
    full = len(study.design) == multiverse.size
    # Where all was computed, an axis that moves the entry unannounced is found out; a sample is too small for that.
    looked_at = [k for k, axis in enumerate(multiverse.axes) if full or axis.name in touched]
    sizes = {multiverse.axes[k].name: len(multiverse.axes[k].options) for k in looked_at}
    design = [tuple(point[k] for k in looked_at) for point in study.design]
    shares = variance_shares(quantity, design, sizes, multiverse.seeded)
    undeclared = ()
    if full and shares is not None:
        undeclared = tuple(name for name in sizes if name not in touched and shares.total[name] > 1e-6)
    return Robustness(
        entry,
        tuple(axes[name] for name in axes if name in touched),
        values,
        agrees,
        failed,
        _under_own_names(shares, axes, touched),
        undeclared,
    )


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


def _best_joint(group: str, names: list[str], studies: list[Outcomes], standings) -> Joint | None:
    """Best combination for all entries of a group; where several studies give them, one that all of them tried."""
    parts = []
    for study in studies:
        mine = [name for name in names if name in study.values]
        if mine:
            parts.append((study, mine))
    counts = defaultdict(int)
    for study, _ in parts:
        for axis in study.multiverse.axes:
            counts[axis.name] += 1
    shared = sorted(name for name, count in counts.items() if count > 1)
    whole: dict[tuple, _Pick] = {(): _Pick((0, 0.0, 0), (), 1)}
    for study, mine in parts:
        more = _best_by_shared(study, mine, shared, standings)
        whole = {
            tuple(sorted((dict(key) | dict(other)).items())): one.with_(two)
            for (key, one), (other, two) in itertools.product(whole.items(), more.items())
            if all(dict(key).get(name, option) == option for name, option in other)
        }
    if not whole:
        return None
    best = max(whole.values(), key=lambda pick: pick.score)
    places = [(*part, point) for part, point in zip(parts, best.points, strict=True)]
    return _joint_at(group, places, standings, sum(pick.count for pick in whole.values()))


@dataclass(frozen=True)
class _Pick:
    """The best of those points, one of each study, that share an option on every shared axis."""

    score: tuple[int, float, int]  # entries that agree, their shares of seeds, minus axes moved
    points: tuple[int, ...]
    count: int  # among so many

    def with_(self, other: "_Pick") -> "_Pick":
        """This and the pick of a further study."""
        score = tuple(a + b for a, b in zip(self.score, other.score, strict=True))
        return _Pick(score, self.points + other.points, self.count * other.count)


def _best_by_shared(study: Outcomes, names: list[str], shared: list[str], standings) -> dict:
    multiverse = study.multiverse
    rates = np.stack([standings[name].agrees.mean(axis=1) for name in names])
    columns = [k for k, axis in enumerate(multiverse.axes) if axis.name in shared]
    found: dict[tuple, _Pick] = {}
    for point, places in enumerate(study.design):
        if study.failed[point].all():
            continue
        key = tuple((multiverse.axes[k].name, multiverse.axes[k].texts[places[k]]) for k in columns)
        moved = sum(a != b for a, b in zip(places, multiverse.default_point, strict=True))
        score = (int((rates[:, point] >= 0.5).sum()), float(rates[:, point].sum()), -moved)
        before = found.get(key, _Pick(score, (point,), 0))
        better = _Pick(score, (point,), 0) if score > before.score else before
        found[key] = replace(better, count=before.count + 1)
    return found


def _joint_at(group: str, places, standings, tried: int) -> Joint:
    combination: dict[str, Option] = {}
    moved: list[str] = []
    agreeing, ours = [], {}
    for study, names, point in places:
        multiverse = study.multiverse
        combination |= multiverse.combination(study.design[point])
        for axis, k in zip(multiverse.axes, study.design[point], strict=True):
            if k != axis.default_index and axis.name not in moved:
                moved.append(axis.name)
        for name in names:
            there = standings[name].values[point]
            there = there[np.isfinite(there)]
            ours[name] = float(there.mean()) if there.size else math.nan
            if standings[name].agrees[point].mean() >= 0.5:
                agreeing.append(name)
    entries = [standings[name].entry for name in ours]
    off = [
        abs(ours[each.id] / each.published - 1) for each in entries if each.kind == "value" and each.published
    ]
    near = {f"{size:.0%}": sum(each <= size for each in off) for size in NEAR} | {"of": len(off)}
    return Joint(group, combination, tuple(moved), tuple(agreeing), ours, near, tried)
