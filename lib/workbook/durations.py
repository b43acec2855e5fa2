"""How long each notebook took, as accepted: a build begins with the longest, so that no core is left with it."""

import json
import statistics
from collections.abc import Mapping

from workbook import paths

FILE = "figures/durations.json"  # below the checkout; no notebook reads it


def durations() -> dict[str, float]:
    """Seconds of the clock by notebook; without those that nobody can read, for only the order of a build needs them."""
    try:
        noted = json.loads((paths.root() / FILE).read_text(encoding="utf-8"))
        return {name: float(seconds) for name, seconds in noted.items()}
    except (OSError, ValueError, TypeError, AttributeError, RecursionError):
        return {}


def updated(before: Mapping[str, float], found: Mapping[str, float | None]) -> dict[str, float]:
    """What to note of the notebooks in `found`, whose seconds (None where none are known) are those of this machine.

    A faster machine, or a busy one, is no news, and neither are a few seconds, or less than half of what was noted.
    """
    ratios = [found[name] / seconds for name, seconds in before.items() if seconds > 0 and found.get(name)]
    pace = statistics.median(ratios) if ratios else 1.0
    noted = {}
    for name, seconds in sorted(found.items()):
        known = before.get(name)
        if seconds is not None and (known is None or abs(seconds / pace - known) > 5.0 + 0.5 * known):
            known = float(f"{seconds / pace:.2g}")
        if known is not None:
            noted[name] = known
    return noted
