"""Where things stand: the workbook's root folder, its rooms, and where a notebook writes."""

import os
from pathlib import Path

ROOMS = ("isolation", "motion", "worstcase", "fixedpoint")

OUTPUT_VARIABLE, ROOT_VARIABLE = "STILLWORK_OUTPUT", "STILLWORK_ROOT"


def root() -> Path:
    """Folder that holds `notebooks/`, `data/` and `figures/`.

    It is the checkout that this package runs from; the environment variable `STILLWORK_ROOT` names another.
    """
    folder = Path(os.environ.get(ROOT_VARIABLE) or Path(__file__).parents[3])
    if not (folder / "data").is_dir():
        raise FileNotFoundError(
            f"no workbook at {folder} (no data/ folder); set STILLWORK_ROOT to a checkout of stillwork"
        )
    return folder


def data(room: str, name: str = "") -> Path:
    """Path of a shipped data file of a room, e.g. ``data("isolation", "rigid_body.toml")``."""
    return root() / "data" / room / name


def in_batch() -> bool:
    """Whether the runner or the tests, not a person, execute the notebook."""
    return OUTPUT_VARIABLE in os.environ


def output(notebook: str) -> Path:
    """Folder that `notebook` (``room/name``) writes to: the runner's, or ``build/interactive``."""
    base = os.environ.get(OUTPUT_VARIABLE)
    return (Path(base) if base else root() / "build" / "interactive") / notebook
