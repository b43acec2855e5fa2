"""What a build is made of: notebooks at their settings, why their results are stale, and how long each took as accepted."""

import json
import os
import re
import statistics
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from workbook import paths
from workbook.dependencies import keep_facts
from workbook.inputs import changes, notebook_inputs, present_again
from workbook.notebooks import Notebook, assign, select
from workbook.publish import digest, read_record

BUILT = "STILLWORK_BUILT"  # an environment variable that names another folder for the results
DURATIONS = "figures/durations.json"  # below the checkout; no notebook reads it


def built() -> Path:
    """Folder of the results at the published settings; what is committed stands in ``figures/``."""
    return Path(os.environ.get(BUILT) or paths.root() / "build" / "figures")


@dataclass(frozen=True)
class Task:
    """One notebook at one setting.

    Attributes
    ----------
    notebook : Notebook
    settings : dict
        Parameters that differ from the published settings.
    inputs : dict of str to str
        What its results depend on, but for the entries of the ledger that it claims.
    """

    notebook: Notebook
    settings: dict[str, object]
    inputs: dict[str, str]

    @property
    def variant(self) -> str:
        """Folder name of the settings; empty for the published ones."""
        text = ",".join(f"{name}={value}" for name, value in self.settings.items())
        safe = re.sub(r"[^\w.,=+\-\[\]()]", "_", text, flags=re.ASCII)  # a file's name is limited in bytes
        return safe if safe == text and len(safe) < 120 else f"{safe[:100]}-{digest(text.encode())[:8]}"

    @property
    def cells(self) -> int:
        """Number of code cells."""
        return len(self.notebook.cells) + bool(self.notebook.parameters)

    @property
    def label(self) -> str:
        shown = ", ".join(f"{name}={value!r}" for name, value in self.settings.items())
        return self.notebook.name + (f" ({shown})" if shown else "")

    @property
    def target(self) -> Path:
        """Folder of the results."""
        if self.settings:
            return paths.root() / "build" / "variants" / self.notebook.name / self.variant
        return built() / self.notebook.name

    @property
    def executed(self) -> Path:
        """The executed notebook, among the results."""
        return self.target / f"{self.notebook.name.partition('/')[2]}.ipynb"

    @property
    def committed(self) -> Path:
        """Folder of the accepted results."""
        return paths.root() / "figures" / self.notebook.name

    def reasons(self) -> list[str]:
        """Why the results are stale; empty when they are not."""
        if (found := read_record(self.target)) is None:
            return ["never built"]
        before, complaints = found
        return complaints or changes(before, {**self.inputs, **present_again(before)})

    def outputs(self) -> dict[str, list[dict]]:
        """What each code cell gave when the notebook was executed, by the cell's id."""
        executed = json.loads(self.executed.read_text(encoding="utf-8"))["cells"]
        return {cell.get("id"): cell["outputs"] for cell in executed if cell["cell_type"] == "code"}


def tasks(*targets: str, settings: dict[str, str] | None = None) -> list[Task]:
    """What topics and notebooks (all without any) and the text of ``-p`` mean; `InputError` before anything runs."""
    chosen = assign(select(*targets), settings or {})
    found = [Task(notebook, changed, notebook_inputs(notebook, changed)) for notebook, changed in chosen]
    keep_facts()
    return found


def durations() -> dict[str, float]:
    """Seconds of the clock by notebook, so that a build begins with the longest; none if unreadable."""
    try:
        noted = json.loads((paths.root() / DURATIONS).read_text(encoding="utf-8"))
        return {name: float(seconds) for name, seconds in noted.items()}
    except (OSError, ValueError, TypeError, AttributeError, RecursionError):
        return {}


def updated_durations(before: Mapping[str, float], found: Mapping[str, float | None]) -> dict[str, float]:
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
