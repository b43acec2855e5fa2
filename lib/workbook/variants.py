"""A variant beside the published settings: where it is, and which claims moved."""

from workbook import paths
from workbook.claims import Claim, ledger, make_claim, recorded_claims
from workbook.report import screen, table
from workbook.tasks import Task


def difference(task: Task) -> list[str]:
    """Lines for the terminal on a built variant."""
    where = task.target.relative_to(paths.root()).as_posix()
    lines = [f"{task.label}: {where}"]
    if not task.committed.is_dir():
        return [*lines, "  the published settings have no accepted results yet to hold it against"]
    moved = _moved(task)
    if moved:
        rows = [("claim", "published", "at its settings", "here", "tolerance"), *moved]
        lines += [f"  {line}" for line in table(rows, screen() - 2)]
    else:
        lines.append("  no claim moved")
    return lines


def _moved(task: Task) -> list[tuple[str, ...]]:
    """Of each claim whose value is another, or inside where it was outside: what is published, accepted and found."""
    accepted = {claim.entry.id: claim for claim in ledger(topic=task.notebook.topic)}
    file = task.target / "claims.json"
    found = recorded_claims(file) if file.is_file() else {}
    rows = []
    for name, (ours, interval) in found.items():
        before, now = accepted[name], make_claim(name, ours, interval)
        if (before.ours, before.here) != (now.ours, now.here):
            published = "" if now.entry.published is None else f"{now.entry.published:.4g}"
            stands = now.here if now.here == before.here else f"{before.here} -> {now.here}"
            rows.append((name, published, _shown(before), _shown(now), stands))
    return rows


def _shown(claim: Claim) -> str:
    return "" if claim.ours is None else claim.shown(4)
