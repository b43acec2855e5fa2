"""A machine in one TOML: of its tables `budget` reads some, `isolate` others; and the templates of it."""

import math
from pathlib import Path
from string import Template
from typing import Any

from stillwork.base.checks import InputError
from stillwork.base.toml_files import Table, read_toml

# All that may stand at the top of a file; each command holds the names within its own tables against its own list.
BUDGET = ("name", "band_hz", "exposure_s", "duration_s", "machine", "controller", "sources")
ISOLATE = ("response", "notches_hz", "isolator", "estimate", "noise", "floor")
DESIGN = ("decoupling",)
TEMPLATE = Path(__file__).with_name("machine.toml")
MACHINES: dict[str, dict[str, Any]] = {
    "wafer-stage": {
        "name": "a wafer-like stage", "frame": 180.0, "suspension": 4.0, "damping": 0.05, "stage": 20.0,
        "modes": "[450.0, 700.0]", "shares": "[0.15, -0.1]", "bandwidth": 80.0, "rate": 10000.0, "skyhook": 0.6,
        "feedforward": 20.0, "floor": "VC-C", "sensor": "0.3 nm/sqrt(Hz)", "exposure": 0.01, "dac": "2 mN", "air": "0.2 mN/sqrt(Hz)",
    },
    "microscope-stage": {
        "name": "a microscope stage on a laboratory floor", "frame": 60.0, "suspension": 1.5, "damping": 0.08, "stage": 0.8,
        "modes": "[300.0]", "shares": "[0.2]", "bandwidth": 25.0, "rate": 2000.0, "skyhook": 0.0, "feedforward": 0.0,
        "floor": "VC-A", "sensor": "1 nm/sqrt(Hz)", "exposure": 0.1, "dac": "0.1 mN", "air": "20 uN/sqrt(Hz)",
    },
    "telescope-mirror": {
        "name": "a telescope mirror on its cell", "frame": 400.0, "suspension": 8.0, "damping": 0.01, "stage": 120.0,
        "modes": "[60.0, 95.0]", "shares": "[0.1, 0.05]", "bandwidth": 10.0, "rate": 1000.0, "skyhook": 0.3,
        "feedforward": 0.0, "floor": "VC-B", "sensor": "2 nm/sqrt(Hz)", "exposure": 1.0, "dac": "5 mN", "air": "5 mN/sqrt(Hz)",
    },
}  # fmt: skip
ISOLATOR = MACHINES["wafer-stage"] | {
    "name": "a small stage on an isolator", "frame": 4.0, "suspension": 20.13, "damping": 0.0474, "stage": 1.0,
}  # fmt: skip


def open_machine_toml(file: str | Path) -> Table:
    """Read a machine's TOML; a table that no command knows is refused, since a misspelt one would count as not given."""
    entries = read_toml(file)
    entries.require_known((*BUDGET, *ISOLATE, *DESIGN))
    return entries


def new_budget(folder: str = ".") -> list[str]:
    """Write the commented template of each machine of `MACHINES`; returns their paths, and the next step."""
    files = [Path(folder) / f"{name}.toml" for name in MACHINES]
    for file, values in zip(files, MACHINES.values(), strict=True):
        if file.exists():
            raise InputError(f"{file} exists; move it away, or start in another folder")
        file.write_text(_filled(values), encoding="utf-8")
    return [*map(str, files), f"enter your numbers, then: python -m stillwork budget {files[0]}"]


def new_isolator(file: str) -> list[str]:
    """Write the same template for an isolator with a small stage to a new `file`."""
    with Path(file).open("x", encoding="utf-8") as out:
        out.write(_filled(ISOLATOR))
    return [f"{file}: fill it in, then python -m stillwork isolate {file} FLOOR --rate HZ --out DIR"]


def _filled(values: dict[str, Any]) -> str:
    mass, omega = values["frame"] + values["stage"], 2 * math.pi * values["suspension"]
    mechanics = {
        "mass": f"{mass:.4g}",
        "loss": f"{2 * values['damping'] * omega * mass:.3g}",
        "stiffness": f"{omega**2 * mass:.3g}",
    }
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(values | mechanics)
