"""How a published statement stands, in a few words: over the readings of what the work leaves open, or as built."""

from workbook.claims import AGREEMENT, Claim
from workbook.readings.judging import Standing
from workbook.report import our_quantity


def stands(claim: Claim, standing: Standing | None) -> str:
    """The end of a sentence: under how many readings it is so, or where none were tried or judged, whether here."""
    if standing is None or standing.share is None:
        if claim.verdict in AGREEMENT:
            return "here, too"
        if claim.ours is None:
            return claim.verdict
        ours = our_quantity(claim)
        return f"not here ({ours})" if claim.verdict in ("deviates", "fails") else f"here {ours}"
    if standing.agree == standing.tried:
        return f"under every one of {standing.tried} readings"
    if standing.agree == 0:
        return f"under none of {standing.tried} readings"
    return f"under {standing.agree} of {standing.tried} readings"


def class_of(standing: Standing | None) -> str:
    """``holds``, ``depends`` or ``fails`` over the readings; else ``not tried``."""
    return (standing and standing.class_) or "not tried"
