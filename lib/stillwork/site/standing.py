"""How a published statement stands, in a few words: over the readings of what the work leaves open, or as built."""

from stillwork.workbook.claims import Claim
from stillwork.workbook.readings.judging import Standing
from stillwork.workbook.report import our_quantity


def stands(claim: Claim, standing: Standing | None) -> str:
    """Under how many readings a claim agrees; its verdict and value where no readings were tried or none is judged."""
    if standing is None or standing.share is None:
        ours = our_quantity(claim)
        return f"{claim.verdict}, here {ours}" if ours else claim.verdict
    if standing.agree == standing.tried:
        return f"under every one of {standing.tried} readings"
    if standing.agree == 0:
        return f"under none of {standing.tried} readings"
    return f"under {standing.agree} of {standing.tried} readings"


def class_of(standing: Standing | None) -> str:
    """``holds``, ``depends`` or ``fails`` over the readings; else ``not tried``."""
    return (standing and standing.class_) or "not tried"
