"""Sentences that a run computes from its own numbers, and what it says where its settings are not the accepted ones."""

import ast
import json
import string
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

from workbook import paths
from workbook.checks import InputError, require_array, require_kind
from workbook.claims import AGREEMENT, DISAGREEMENT, Claim


@dataclass(frozen=True)
class Sentence:
    """A sentence as a notebook shows it: Markdown, in a terminal as it stands."""

    text: str

    def __repr__(self) -> str:
        return self.text

    def _repr_markdown_(self) -> str:
        return self.text


class _Words(string.Formatter):
    """`str.format`, with a space before the sign of per cent, as in the text around it."""

    def format_field(self, value, spec):
        text = super().format_field(value, spec)
        return f"{text[:-1]} %" if spec.endswith("%") else text


def sentence(text: str, otherwise: str | None, holds: bool, values: Mapping[str, object]) -> str:
    """`text` where it holds, else `otherwise`, with the values in their places.

    Without `otherwise`, a sentence that does not hold stands behind "Not found in this run:".

    Raises
    ------
    InputError
        When a place has no value, or a value no place in either of both.
    """
    forms = [require_kind("text", text, str)]
    if otherwise is not None:
        forms.append(require_kind("otherwise", otherwise, str))
    places = {name for form in forms for _, name, *_ in string.Formatter().parse(form) if name is not None}
    if missing := sorted(places - set(values)):
        raise InputError(f"conclude: {{{missing[0]}}} has no value; give {missing[0]}=...")
    if unused := sorted(set(values) - places):
        raise InputError(
            f"conclude: no sentence shows {unused[0]}; write {{{unused[0]}:.3g}} in one, or leave it out"
        )
    if holds or otherwise is not None:
        return _Words().format(forms[0 if holds else 1], **values)
    return f"Not found in this run: {_Words().format(text, **values)}"


def sense(
    ratio: float | Sequence[float], words: tuple[str, str, str] = ("ahead of", "level with", "behind")
) -> str:
    """The word for a ratio of errors: the first below 1, the last above, the middle where its interval holds 1.

    Parameters
    ----------
    ratio : float or (low, high)
        A bare number is level at 1 alone.
    words : tuple of str

    Examples
    --------
    >>> sense((0.8, 0.9)), sense((0.8, 1.1)), sense(1.2)
    ('ahead of', 'level with', 'behind')
    """
    ends = require_array("ratio", ratio).ravel()
    return words[0] if ends.max() < 1 else words[2] if ends.min() > 1 else words[1]


def found_here(names: str | Sequence[str], claims: Iterable[Claim]) -> bool:
    """Whether all these entries agree in this run.

    Raises
    ------
    InputError
        When this run has not checked one of them, or it is shown without being judged.
    """
    by_id = {claim.entry.id: claim for claim in claims}
    names = [names] if isinstance(names, str) else list(names)
    for name in names:
        if name not in by_id or by_id[name].here not in (*AGREEMENT, *DISAGREEMENT):
            raise InputError(f"conclude: when is {name!r}; check a judged entry of that name before")
    return all(by_id[name].here in AGREEMENT for name in names)


def accepted_settings(notebook: str) -> dict[str, object]:
    """The parameters with which the committed results of a notebook were computed; empty where there are none."""
    file = paths.root() / "figures" / notebook / "provenance.json"
    return json.loads(file.read_text(encoding="utf-8"))["parameters"] if file.is_file() else {}


def run_settings(cells: Iterable[str]) -> dict[str, object]:
    """What cells of literal assignments alone set, the last one counting: the parameters of a run, and those injected.

    A loop elsewhere that takes the name of a parameter does not count.
    """
    return {name: value for cell in cells for name, value in _assigned(cell)}


@lru_cache(maxsize=256)
def _assigned(cell: str) -> tuple[tuple[str, object], ...]:
    found = []
    try:
        for statement in ast.parse(cell).body:
            targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
            found += [(target.id, ast.literal_eval(statement.value)) for target in targets]
    except (SyntaxError, ValueError, TypeError, AttributeError):
        return ()
    return tuple(found)


def other_settings(notebook: str, cells: Iterable[str]) -> str:
    """Which parameters of a run are not the accepted ones, ``noise 0.05 for 0.1``; empty where all are."""
    return changed(run_settings(cells), accepted_settings(notebook))


def changed(here: Mapping[str, object], accepted: Mapping[str, object]) -> str:
    """Which settings are not the accepted ones, in words."""
    plain = {name: json.loads(json.dumps(here[name])) for name in accepted if name in here}
    return ", ".join(
        f"{name} {now} for {accepted[name]}" for name, now in plain.items() if now != accepted[name]
    )


def banner(settings: str, claims: Sequence[Claim], accepted: Mapping[str, Claim]) -> str:
    """What a run with other settings says first: which they are, and which numbers left or entered their tolerance.

    Parameters
    ----------
    settings : str
        As `other_settings` gives them; without any there is nothing to say.
    claims : sequence of Claim
        What the run has found so far.
    accepted : mapping of str to Claim
        The committed results, by id.
    """
    if not settings:
        return ""
    both = [(claim, accepted[claim.entry.id]) for claim in claims if claim.entry.id in accepted]
    left = [now for now, was in both if was.here in AGREEMENT and now.here in DISAGREEMENT]
    entered = [now for now, was in both if was.here in DISAGREEMENT and now.here in AGREEMENT]
    judged = sum(now.here in (*AGREEMENT, *DISAGREEMENT) for now, _ in both)
    lines = [
        f"Other settings than the accepted: {settings}; "
        f"{len(left)} of {judged} numbers left their tolerance, {len(entered)} entered."
    ]
    for word, which in (("left", left), ("entered", entered)):
        lines += [
            f"{word}: {claim.entry.id} ({claim.entry.quantity}): {claim.shown(4)} for {accepted[claim.entry.id].shown(4)}"
            for claim in which
        ]
    return "\n".join(lines)
