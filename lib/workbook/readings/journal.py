"""What a run has found so far, a line a reading, written as it comes: a killed run goes on where it stopped."""

import json
from pathlib import Path


class Journal:
    """Lines ``{"key": ..., "found": ...}`` of a file that only grows; a torn last line is left out.

    Parameters
    ----------
    file : Path
        Made with its folder when the first line is written.
    """

    def __init__(self, file: Path):
        self.file = file
        self.found: dict[str, dict | str] = {}
        self._torn = False
        if file.exists():
            text = file.read_text(encoding="utf-8", errors="replace")
            self._torn = bool(text) and not text.endswith("\n")
            for line in text.splitlines():
                try:
                    record = json.loads(line)
                    self.found[record["key"]] = record["found"]
                except (ValueError, TypeError, KeyError):  # the line that a kill cut short
                    continue

    def add(self, key: str, found: dict | str) -> None:
        """Keep what a reading gave: values by entry, or why it failed."""
        self.file.parent.mkdir(parents=True, exist_ok=True)
        with self.file.open("a", encoding="utf-8") as file:
            file.write("\n" * self._torn + json.dumps({"key": key, "found": found}) + "\n")
        self._torn = False
        self.found[key] = found
