"""A topic's studies at the defaults of their axes, where they are to give what the notebooks gave."""

from dataclasses import replace

from workbook.choices.axes import load_axes
from workbook.choices.running import calls_of, compute
from workbook.claims import Claim, ledger


def at_the_defaults(topic: str, study: str, lean: bool) -> dict[str, float]:
    """Values of a study's entries, without their intervals."""
    multiverse = next(each for each in load_axes(topic)[1] if each.study == study)
    found = compute(replace(calls_of(multiverse)[0, 0], lean=lean))  # the default point is tried first
    assert isinstance(found, dict), found
    return {name: value[0] if isinstance(value, tuple) else value for name, value in found.items()}


def require_accepted(topic: str, study: str) -> None:
    """With nothing left out every entry has the value that was accepted, but for its drift."""
    accepted = accepted_claims(topic)
    for name, value in at_the_defaults(topic, study, lean=False).items():
        ours = accepted[name].ours
        assert abs(value - ours) <= accepted[name].entry.drift.width(ours) + 1e-12, name


def accepted_claims(topic: str) -> dict[str, Claim]:
    """What the committed figures hold, by entry."""
    return {claim.entry.id: claim for claim in ledger(topic=topic)}
