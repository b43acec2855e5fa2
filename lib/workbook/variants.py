"""A variant beside the published settings: where it is, and which claims moved."""

from workbook import paths
from workbook.claims import ledger, make_claim, recorded_claims
from workbook.conclusions import accepted_settings, banner, changed
from workbook.tasks import Task


def difference(task: Task) -> list[str]:
    """Lines for the terminal on a built variant."""
    where = task.target.relative_to(paths.root()).as_posix()
    lines = [f"{task.label}: {where}"]
    if not task.committed.is_dir():
        return [*lines, "  the published settings have no accepted results yet to hold it against"]
    accepted = {claim.entry.id: claim for claim in ledger(topic=task.notebook.topic)}
    file = task.target / "claims.json"
    found = [
        make_claim(name, *each) for name, each in (recorded_claims(file) if file.is_file() else {}).items()
    ]
    settings = changed(task.settings, accepted_settings(task.notebook.name))
    return [*lines, *(f"  {line}" for line in banner(settings, found, accepted).splitlines())]
