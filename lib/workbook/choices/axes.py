"""Axes of a topic: the choices that its source leaves open, and the studies that can be computed at any of them."""

import hashlib
import json
import math
from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

from workbook import paths
from workbook.checks import (
    InputError,
    nearest,
    read_toml,
    require_choice,
    require_count,
    require_fields,
    require_kind,
    require_number,
)
from workbook.claims import load_entries

AXIS_KINDS = ("text", "number", "definition", "procedure", "seed")
CELLS = 24  # of the range of a window, where the study does not say how many
POINTS = 64  # up to so many points all are tried, and so many are sampled of more

Option = str | int | float | bool

_RESERVED = ("seed", "lean", "point", "failure")  # arguments of a study, columns of the results


@dataclass(frozen=True)
class Axis:
    """One choice that the source leaves open.

    Attributes
    ----------
    id : str
        Topic and name.
    question : str
        What is to be chosen.
    options : tuple
        What a careful reader could choose: texts, numbers or flags.
    default : str, int, float or bool
        The option that the notebooks take; a study whose notebook takes another has its own.
    source : str
        What the source states, and why each option can be defended.
    touches : tuple of str
        Entries of the ledger, or first parts of their ids, that may depend on the choice.
    kind : str
        ``text`` (an interpretation of the text), ``number`` (unpublished), ``definition``, ``procedure`` or ``seed``.
    unit : str
        Of the options.
    after : bool
        Whether it was thought of after the numbers had been seen.
    """

    id: str
    question: str
    options: tuple[Option, ...]
    default: Option
    source: str
    touches: tuple[str, ...]
    kind: str
    unit: str = ""
    after: bool = False

    def __post_init__(self):
        require_choice(f"{self.id}: kind", self.kind, AXIS_KINDS)
        for name in ("question", "source"):
            if not getattr(self, name):
                raise InputError(f"{self.id}: {name} is empty; fill it in")
        if self.kind == "seed":
            for option in self.options:
                require_count(f"{self.id}: option", option, at_least=0)
        if len(self.options) < 2:
            raise InputError(f"{self.id}: options holds {len(self.options)}; give at least 2")
        if len(set(self.texts)) < len(self.options):
            raise InputError(f"{self.id}: two options have the same text; remove one")
        if option_text(self.default) not in self.texts:
            hint = nearest(option_text(self.default), self.texts)
            raise InputError(f"{self.id}: default {self.default!r} is not among its options{hint}")
        if not self.keyword.isidentifier() or (self.keyword in _RESERVED and self.kind != "seed"):
            raise InputError(f"{self.id}: {self.name!r} cannot be an argument of a study; take another name")

    @property
    def name(self) -> str:
        """The id without the topic."""
        return self.id.partition(".")[2]

    @property
    def keyword(self) -> str:
        """Argument under which a study gets the option."""
        return self.name.replace("-", "_")

    @cached_property
    def texts(self) -> tuple[str, ...]:
        """The options as they are written in the results."""
        return tuple(map(option_text, self.options))

    @cached_property
    def default_index(self) -> int:
        """Place of the default among the options."""
        return self.texts.index(option_text(self.default))


def option_text(option: Option) -> str:
    """An option as it is written in the results."""
    return option if isinstance(option, str) else json.dumps(option)


@dataclass(frozen=True)
class Multiverse:
    """All combinations of one study: a function, and the axes that touch its entries.

    Attributes
    ----------
    topic, study : str
    function : str
        ``package.module:function``. It takes each axis' option by name, ``seed``, and ``lean`` where it has such a
        form; it returns for each of `entries` a number, or a number and its interval ``(value, (low, high))``; NaN
        where there is none.
        Or a notebook, ``topic/name``, whose parameters the axes are; its ``seed`` stays where no axis lists seeds.
    entries : tuple of str
        Ids that it returns.
    axes : tuple of Axis
        Without the one of kind ``seed``; their defaults are what the study's notebook takes.
    seeds : tuple of int
        All are run at each point; the first is the default.
    seeded : bool
        Whether an axis lists the seeds; otherwise the study is taken as one that needs none.
    touched : dict of str to frozenset of str
        For each entry the names of the axes declared to touch it.
    lean : str
        What the lean form of the study leaves out and what difference that makes; empty without a lean form.
    points : int
        Size of the sample where the axes have more than 64 combinations.
    windows : dict of str to tuple of float, float and int
        Of axes with numbers for options, where others could stand between them, the range that
        `workbook.choices.windows` searches with this study, and into how many cells it divides it first.
    """

    topic: str
    study: str
    function: str
    entries: tuple[str, ...]
    axes: tuple[Axis, ...]
    seeds: tuple[int, ...] = (1,)
    seeded: bool = False
    touched: dict[str, frozenset[str]] = field(default_factory=dict)
    lean: str = ""
    points: int = POINTS
    windows: dict[str, tuple[float, float, int]] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Number of points: combinations of the options."""
        return math.prod(len(axis.options) for axis in self.axes)

    @cached_property
    def default_point(self) -> tuple[int, ...]:
        """Places of the defaults among the options."""
        return tuple(axis.default_index for axis in self.axes)

    def columns(self, entry: str) -> tuple[int, ...]:
        """Places of the axes that touch an entry."""
        return tuple(k for k, axis in enumerate(self.axes) if axis.name in self.touched[entry])

    def options(self, point: tuple[int, ...]) -> dict[str, Option]:
        """Arguments of the function at a point."""
        return {axis.keyword: axis.options[k] for axis, k in zip(self.axes, point, strict=True)}

    def combination(self, point: tuple[int, ...]) -> dict[str, Option]:
        """Option of each axis, by the axis' name."""
        return {axis.name: axis.options[k] for axis, k in zip(self.axes, point, strict=True)}

    @property
    def digest(self) -> str:
        """Of what decides which points are computed and how they are called; wording is no part of it."""
        axes = [(axis.name, axis.texts, axis.default_index) for axis in self.axes]
        facts = (self.function, self.entries, axes, self.seeds, bool(self.lean), self.points)
        return hashlib.sha256(json.dumps(facts).encode()).hexdigest()


_STUDY_FIELDS = ("function", "entries", "defaults", "lean", "points", "windows")


def load_axes(topic: str) -> tuple[dict[str, Axis], list[Multiverse]]:
    """Axes of a topic by name, and the multiverse of each of its studies, as ``choices.toml`` declares them.

    Raises
    ------
    InputError
        When a field is unknown or missing, a default is not among the options, or an entry does not exist.
    """
    tree = _read(topic)
    ledger = tuple(load_entries(topic))
    axes = {name: _axis(f"{topic}.{name}", given, ledger) for name, given in tree.get(topic, {}).items()}
    touching = {key: set(_matching(key, axis.touches, ledger)) for key, axis in axes.items()}
    multiverses = [
        _multiverse(topic, name, given, axes, touching, ledger)
        for name, given in tree.get("studies", {}).items()
    ]
    owner: dict[str, str] = {}
    for multiverse in multiverses:
        for entry in multiverse.entries:
            if owner.setdefault(entry, multiverse.study) != multiverse.study:
                raise InputError(
                    f"{entry} is given by studies {owner[entry]} and {multiverse.study}; keep one"
                )
    return axes, multiverses


def load_digits(topic: str) -> dict[str, float]:
    """Half a unit of the last printed digit of entries whose tolerance is wider: ``[digits]``.

    Raises
    ------
    InputError
        When an entry does not exist.
    """
    given = _read(topic).get("digits", {})
    for name, half in given.items():
        _matching("digits", [name], tuple(load_entries(topic)))
        require_number(f"digits: {name}", half, above=0)
    return given


def _read(topic: str) -> dict:
    """The tables of ``choices.toml``; none without the file."""
    file = paths.data(paths.require_topic(topic), "choices.toml")
    if not file.exists():
        return {}
    tree = read_toml(file)
    for name in tree:
        if name not in (topic, "studies", "digits"):
            raise InputError(f"{file}: table {name!r} is none of {topic!r}, 'studies', 'digits'; rename it")
    return tree


def _axis(name: str, given, ledger: tuple[str, ...]) -> Axis:
    known = [each.name for each in fields(Axis) if each.name != "id"]
    require_fields(name, given, known, ("question", "options", "default", "source", "touches", "kind"))
    for key in ("options", "touches"):
        require_kind(f"{name}: {key}", given[key], list)
    for key in ("question", "source", "kind", "unit"):
        require_kind(f"{name}: {key}", given.get(key, ""), str)
    require_kind(f"{name}: after", given.get("after", False), bool)
    for option in (*given["options"], given["default"]):
        if not isinstance(option, Option) or (isinstance(option, float) and not math.isfinite(option)):
            raise InputError(f"{name}: option {option!r} is no text, number or flag; give one of these")
    _matching(f"{name}: touches", given["touches"], ledger)
    return Axis(id=name, **{**given, "options": tuple(given["options"]), "touches": tuple(given["touches"])})


def _multiverse(
    topic: str,
    study: str,
    given,
    axes: dict[str, Axis],
    touching: dict[str, set[str]],
    ledger: tuple[str, ...],
) -> Multiverse:
    name = f"studies.{study}"
    require_fields(name, given, _STUDY_FIELDS, ("function", "entries"))
    module, colon, function = given["function"].partition(":")
    whole = colon and function.isidentifier() and all(p.isidentifier() for p in module.split("."))
    if not whole and not given["function"].startswith(f"{topic}/"):
        raise InputError(
            f"{name}: function is {given['function']!r}; give 'package.module:function' or a notebook, '{topic}/...'"
        )
    entries = _matching(f"{name}: entries", given["entries"], ledger)
    mine = [axis for key, axis in axes.items() if touching[key] & set(entries)]
    mine = _with_defaults(name, given.get("defaults", {}), mine)
    seeds = [axis for axis in mine if axis.kind == "seed"]
    if len(seeds) > 1:
        raise InputError(f"{name}: {seeds[0].id} and {seeds[1].id} are both its seeds; keep one")
    order = (1,)
    if seeds:
        order = (seeds[0].default, *(option for option in seeds[0].options if option != seeds[0].default))
    return Multiverse(
        topic=topic,
        study=study,
        function=given["function"],
        entries=entries,
        axes=tuple(axis for axis in mine if axis.kind != "seed"),
        seeds=order,
        seeded=bool(seeds),
        touched={entry: frozenset(key for key in axes if entry in touching[key]) for entry in entries},
        lean=given.get("lean", ""),
        points=require_count(f"{name}: points", given.get("points", POINTS), at_least=2),
        windows=_windows(f"{name}: windows", given.get("windows", {}), mine),
    )


def _windows(name: str, given, axes: list[Axis]) -> dict[str, tuple[float, float, int]]:
    numeric = [axis for axis in axes if all(isinstance(each, int | float) for each in axis.options)]
    found = {}
    for key, ends in given.items():
        require_choice(name, key, [axis.name for axis in numeric])
        if not isinstance(ends, list) or len(ends) not in (2, 3):
            raise InputError(f"{name}: {key} is {ends!r}; give [low, high] or [low, high, cells]")
        low = require_number(f"{name}: low end of {key}", ends[0])
        high = require_number(f"{name}: high end of {key}", ends[1], above=low)
        found[key] = (low, high, require_count(f"{name}: cells of {key}", [*ends, CELLS][2], at_least=2))
    return found


def _with_defaults(name: str, defaults, axes: list[Axis]) -> list[Axis]:
    """The axes as one study sees them."""
    require_fields(f"{name}: defaults", defaults, [axis.name for axis in axes])
    return [replace(axis, default=defaults.get(axis.name, axis.default)) for axis in axes]


def _matching(name: str, starts: Iterable[str], ledger: tuple[str, ...]) -> tuple[str, ...]:
    """Entries whose id is one of `starts`, or begins with one and a dot; in the ledger's order."""
    for start in starts:
        if not any(begins_with(entry, start) for entry in ledger):
            raise InputError(f"{name}: the ledger has no entry {start!r}{nearest(start, ledger)}")
    return tuple(entry for entry in ledger if any(begins_with(entry, start) for start in starts))


def begins_with(entry: str, start: str) -> bool:
    """Whether an id is `start` or lies under it."""
    return entry == start or entry.startswith(f"{start}.")
