"""A machine in one TOML, of which each command reads its own tables; and the template of it."""

import math
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from stillwork.base.checks import InputError, require_array, require_choice, require_number, short_repr
from stillwork.base.toml_files import Table, read_toml

TOP = ("name", "band_hz", "exposure_s", "duration_s")  # what stands above all tables, of `budget`
# The tables, and the names that each may hold; of `sources` those of each source.
KNOWN = {
    "machine": (
        *("frame_mass_kg", "suspension_hz", "suspension_damping"),
        *("stage_mass_kg", "modes_hz", "modes_share", "modes_damping", "modes_share_at"),
    ),
    "controller": (
        *("bandwidth_hz", "rate_hz", "delay_samples"),
        *("skyhook_damping", "feedforward_db", "feedforward_from_hz"),
    ),
    "sources": (
        *("place", "criterion", "file", "unit", "white", "corner_hz", "quantiser", "tone_hz", "amplitude"),
        *("periodic", "setpoint", "move", "move_s", "rest_s", "feedforward_mass_kg", "feedforward_advance_s"),
    ),
    "isolator": (
        *("response", "mass", "damping", "stiffness", "actuator_pole_hz"),
        *("delay_s", "floor", "notches_hz", "anti_alias"),
    ),
    "estimate": ("mass", "damping", "stiffness", "actuator_pole_hz"),
    "noise": ("floor", "platform"),
    "decoupling": ("response", "sensing", "actuation", "axes", "units", "outputs", "inputs"),
}
CONTENT = {
    "machine": "frame, springs and stage",
    "controller": "the stage's controller, skyhook and feedforward",
    "sources": "what moves the stage, one table [sources.NAME] each",
    "isolator": "the isolator's response or mechanics, actuator pole and delay",
    "decoupling": "the measured response of several sensors and actuators; of one axis give design that response itself",
}
SUSPENDED = ("frame_mass_kg", "stage_mass_kg", "suspension_hz", "suspension_damping")
ALIKE = 0.02  # by which the mechanics of [machine] and [isolator] may differ: they are rounded in a file
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
    "small-isolator": {
        "name": "a small stage on an isolator", "frame": 4.0, "suspension": 20.1317, "damping": 0.04743, "stage": 1.0,
        "modes": "[450.0, 700.0]", "shares": "[0.15, -0.1]", "bandwidth": 80.0, "rate": 10000.0, "skyhook": 0.6,
        "feedforward": 20.0, "floor": "VC-C", "sensor": "0.3 nm/sqrt(Hz)", "exposure": 0.01, "dac": "2 mN", "air": "0.2 mN/sqrt(Hz)",
    },
}  # fmt: skip


def open_machine_toml(file: str | Path) -> Table:
    """Read a machine's TOML; a name at its top that no command knows is refused, since a misspelt one would count as not given."""
    entries = read_toml(file)
    for name in entries:
        homes = [f"[{table}]" for table, names in KNOWN.items() if name in names and table != "sources"]
        if name not in (*TOP, *KNOWN) and homes:
            raise InputError(
                f"{entries.where}: {name!r} stands above all tables; move it into {' or '.join(homes)}"
            )
    entries.require_known((*TOP, *KNOWN))
    _require_alike(entries)
    return entries


def _require_alike(entries: Table) -> None:
    """Refuse mechanics along one axis that [isolator] and [machine] state differently: two commands would take two machines."""
    names = ("mass", "damping", "stiffness")
    own, body = (
        entries.table(name) if name in entries else Table({}, entries.where)
        for name in ("isolator", "machine")
    )
    if not {*names} <= {*own} or not {*SUSPENDED} <= {*body}:
        return
    for name, value in suspended(entries).items():
        stated = require_array(f"isolator: {name}", own[name])
        if stated.size == 1 and not np.isclose(stated.item(), value, rtol=ALIKE, atol=0.0):
            raise InputError(
                f"{entries.where}: {name} is {stated.item():.4g} in [isolator], but {value:.4g} by [machine] (frame and stage "
                "together on their springs); leave mass, damping and stiffness out of [isolator], or correct one"
            )


def own_table(entries: Table, name: str, command: str) -> Table:
    """A table of the file without which a command has nothing to read.

    Raises
    ------
    InputError
        When the file has no such table: the message says what it holds and where it is shown.
    """
    if name not in entries:
        raise InputError(
            f"{entries.where}: no table [{name}], which {command} reads ({CONTENT[name]}); add it, as "
            f"`python -m stillwork new FILE.toml` writes it{' (behind #, which you take off)' * (name == 'decoupling')}"
        )
    return entries.table(name)


def suspended(entries: Table) -> dict[str, float]:
    """Mass (kg) of frame and stage together, damping (N s/m) and stiffness (N/m) of their springs, by [machine]."""
    body = own_table(entries, "machine", "isolate")
    frame, stage, hertz, ratio = (
        float(require_number(f"machine: {name}", body[name], above=0.0)) for name in SUSPENDED
    )
    mass, omega = frame + stage, 2 * math.pi * hertz
    return {"mass": mass, "damping": 2 * ratio * omega * mass, "stiffness": omega**2 * mass}


def new_machine(file: str, like: str = "wafer-stage") -> list[str]:
    """Write the commented template of a machine's TOML to a new file.

    Parameters
    ----------
    file : str
        A new file, its name ending in .toml.
    like : str
        Whose numbers it holds: one of `MACHINES`.

    Returns
    -------
    list of str
        What it is, what it holds, and the next steps.

    Raises
    ------
    InputError
        When the file exists, or no such machine is known.
    """
    values = MACHINES[require_choice("like", like, MACHINES)]
    path = Path(file)
    if path.suffix.lower() != ".toml":
        raise InputError(f"file is {short_repr(file)}; give the name of a new file that ends in .toml")
    if path.exists():
        raise InputError(f"{file} exists; move it away, or give another name")
    path.write_text(Template(TEMPLATE.read_text(encoding="utf-8")).substitute(values), encoding="utf-8")
    return [
        f"{file}: {values['name']}, with typical numbers; enter yours",
        f"its error budget: python -m stillwork budget {file}",
        f"its feedforward: python -m stillwork isolate {file} FLOOR --rate HZ --out DIR",
        f"controllers of several axes: take the # off its table [decoupling]; python -m stillwork design {file} --rate HZ --out DIR",
    ]
