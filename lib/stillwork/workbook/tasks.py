"""What a build is made of: notebooks at their settings, and why their results are stale."""

import json
import re
from dataclasses import dataclass
from pathlib import Path

from stillwork import paths
from stillwork.workbook.inputs import changes, digest, notebook_inputs, room_inputs
from stillwork.workbook.notebooks import Notebook, assign, select


@dataclass(frozen=True)
class Task:
    """One notebook at one setting, and everything its results depend on."""

    notebook: Notebook
    settings: dict[str, object]  # what differs from the published settings
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
        return paths.root() / "figures" / self.notebook.name

    @property
    def executed(self) -> Path:
        """The executed notebook; a variant's lies with its results."""
        if self.settings:
            return self.target / f"{self.target.parent.name}.ipynb"
        return paths.root() / "build" / "notebooks" / f"{self.notebook.name}.ipynb"

    @property
    def state(self) -> Path:
        """What the last build saw: its inputs, and digests of the results."""
        folder = paths.root() / "build" / "state" / self.notebook.name
        return folder / (f"{self.variant}.json" if self.settings else "published.json")

    def reasons(self) -> list[str]:
        """Why the results are stale; empty when they are not."""
        try:
            state = json.loads(self.state.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return ["never built"]
        reasons = changes(state["inputs"], self.inputs)
        for name, wanted in state["outputs"].items():
            file = self.target / name
            if not file.exists():
                reasons.append(f"output {name} missing")
            elif digest(file.read_bytes()) != wanted:
                reasons.append(f"output {name} was changed by hand")
        return reasons + ([] if self.executed.exists() else ["executed notebook missing"])


def tasks(target: str | None = None, settings: dict[str, str] | None = None) -> list[Task]:
    """What `target` and the text of ``-p`` mean; raises `InputError` before anything runs."""
    assigned = assign(select(target), settings or {})
    rooms = {room: room_inputs(room) for room in {notebook.room for notebook, _ in assigned}}
    return [
        Task(notebook, changed, {**rooms[notebook.room], **notebook_inputs(notebook, changed)})
        for notebook, changed in assigned
    ]
