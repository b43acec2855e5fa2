"""The tables of a machine's TOML that ``budget`` reads: its machine and its sources."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from stillwork.base.checks import InputError, require_array, require_choice, require_number
from stillwork.base.toml_files import Table
from stillwork.base.validation import by_value
from stillwork.control.budget import Source
from stillwork.control.budget_sources import (
    criterion_floor,
    measured,
    periodic,
    quantiser,
    setpoint,
    tabulated,
    white,
)
from stillwork.control.digital import load_controller, of_reference
from stillwork.control.floor_machine import COMMANDS, DISTURBANCES, MEASUREMENTS, FloorMachine, force_law
from stillwork.control.pid import PidFamily
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel
from stillwork.machine.budget_isolator import WrittenIsolator, read_isolator_design
from stillwork.machine.designed_loop import in_the_units_of_the_file, model_of
from stillwork.machine.machine_toml import KNOWN, open_machine_toml, own_table
from stillwork.signals.datafiles import read_columns
from stillwork.signals.densities import agreed_density, density_unit, frequency_axis, hertz_in, read_densities
from stillwork.signals.records import Record, is_time, load_record, to_acceleration
from stillwork.signals.spectra import estimate_spectrum
from stillwork.signals.units import unit_factor

PLACES = {**DISTURBANCES, **MEASUREMENTS, **COMMANDS}
KINDS = ("criterion", "file", "white", "quantiser", "tone_hz", "periodic", "setpoint", "move")
MOVE_SAMPLES = 500  # in a stroke and in a rest
# Numbers of a file that "what to buy next" changes: table, field, default.
NUMBERS = {
    "suspension frequency": ("machine", "suspension_hz", 0.0),
    "passive damping": ("machine", "suspension_damping", 0.0),
    "skyhook": ("controller", "skyhook_damping", 0.0),
    "frame mass": ("machine", "frame_mass_kg", 0.0),
    "delay": ("controller", "delay_samples", 1.0),
    "remainder of the feedforward": ("controller", "feedforward_db", 0.0),
    "damping of the stage's modes": ("machine", "modes_damping", 0.01),
    "bandwidth": ("controller", "bandwidth_hz", 0.0),
    "stage mass": ("machine", "stage_mass_kg", 0.0),  # at the same bandwidth
}
OF_DESIGN = ("delay", "damping of the stage's modes", "bandwidth", "stage mass")  # fixed by a design's folder
OF_ISOLATE = (  # likewise by an isolator's
    *("suspension frequency", "passive damping", "skyhook"),
    *("frame mass", "remainder of the feedforward"),
)


@by_value
@dataclass(frozen=True)
class MachineFile:
    """A machine's TOML: its machine, sources and band, with the files of floor, design and isolator that replace parts."""

    entries: Table
    folder: Path  # of the files that it names
    floor: str = ""
    design: str = ""
    isolate: str = ""

    @cached_property
    def machine(self) -> FloorMachine:
        """As `machine_of` builds it."""
        return machine_of(self.entries, self.design, isolate=self.isolate)

    @cached_property
    def sources(self) -> list[Source]:
        """As `sources_of` reads them."""
        time = self.machine.sample_time
        found = sources_of(
            self.entries, self.floor, self.folder, 1 / time if time else 0.0, self.machine.stage_mass
        )
        if self.isolate:
            known = {place for source in found for place in source.places}
            for place, level in read_isolator_design(self.isolate).noises.items():
                if place not in known:
                    found.append(white(f"the isolator's {place}", place, PLACES[place], level))
        return found

    @property
    def band(self) -> tuple[float, float]:
        """Hz."""
        low, high = require_array("band_hz", self.entries.get("band_hz", [0.5, 2000.0]), shape=(2,))
        return float(low), float(high)

    def changed(self, name: str, ratio: float) -> "MachineFile | None":
        """The file with a number of `NUMBERS` times `ratio`; None if it has no effect, or the design fixes it."""
        fixed = OF_DESIGN * bool(self.design) + OF_ISOLATE * bool(self.isolate)
        if name in fixed:
            return None
        where, field, default = NUMBERS[name]
        value = number_of(self.entries.table(where), field, default)
        if field == "feedforward_db":  # the remainder is 10^(-dB/20)
            fresh = value - 20 * np.log10(ratio) if value else 0.0
        else:
            fresh = value * ratio
        sampled = bool(self.machine.sample_time)
        if fresh <= 0 or (name == "delay" and not sampled):
            return None
        if name == "damping of the stage's modes" and not self.machine.stage.damping.any():
            return None
        table_of = {**self.entries[where], field: fresh}
        other = replace(self, entries=Table({**self.entries, where: table_of}, self.entries.where))
        if name != "stage mass":  # the sources stay, and with them what was read from files
            other.__dict__["sources"] = self.sources
        return other


def open_machine(file: str, floor: str = "", design: str = "", isolate: str = "") -> MachineFile:
    """Read a machine's TOML."""
    return MachineFile(open_machine_toml(file), Path(file).parent, floor, design, isolate)


def machine_of(entries: Table, design: str = "", position: str = "", isolate: str = "") -> FloorMachine:
    """The machine of a file, at one of its positions; with folders of `design` and `isolate`, with what these hold."""
    if design and isolate:  # they hold all of it
        body = law = Table({}, entries.where)
    else:
        body, law = (_known(entries, name) for name in ("machine", "controller"))
    for name in ("rate_hz", "delay_samples", "feedforward_db"):
        require_number(f"controller: {name}", law.get(name, 0.0), at_least=0.0)
    rate = number_of(law, "rate_hz", 0.0)
    settings: dict[str, Any] = {
        "skyhook": number_of(law, "skyhook_damping", 0.0),
        "feedforward": 1 - 10 ** (-number_of(law, "feedforward_db", 0.0) / 20),
        "integrator_hz": number_of(law, "feedforward_from_hz", 2.0),
        "sample_time": 1 / rate if rate else 0.0,
        "delay": number_of(law, "delay_samples", 1.0) if rate else 0.0,
    }
    if design:
        stage, law_of_stage, settings["sample_time"], settings["delay"] = _designed(design)
    else:
        stage = _stage(body, position)
        hertz = require_number("controller: bandwidth_hz", law["bandwidth_hz"], above=0.0)
        law_of_stage = PidFamily(require_number("machine: stage_mass_kg", body["stage_mass_kg"]))(hertz)
    if isolate:
        return _isolated(read_isolator_design(isolate), stage, law_of_stage, settings)
    frame, hertz, damping = (
        float(require_number(f"machine: {name}", body[name]))
        for name in ("frame_mass_kg", "suspension_hz", "suspension_damping")
    )
    return FloorMachine(frame, hertz, damping, stage, law_of_stage, **settings)


def _known(entries: Table, name: str) -> Table:
    """A table of the file, of whose names none is unknown."""
    table = own_table(entries, name, "budget")
    table.require_known(KNOWN[name])
    return table


def _stage(body: Table, position: str) -> ModalModel:
    """The free stage of a file, with the modes' shares at one of its positions."""
    mass = require_number("machine: stage_mass_kg", body["stage_mass_kg"], above=0.0)
    modes = require_array("machine: modes_hz", body.get("modes_hz", []), ndim=1)
    seen = body.table("modes_share_at")[position] if position else body.get("modes_share", [])
    name = f"machine: modes_share{'_at: ' * bool(position)}{position}"
    shares = np.append(1.0, require_array(name, seen, shape=modes.shape))
    sizes = np.sqrt(np.abs(shares) / mass)
    return ModalModel(
        np.append(0.0, 2 * np.pi * modes),
        np.append(0.0, np.full(len(modes), number_of(body, "modes_damping", 0.01))),
        sizes[:, None],
        (sizes * np.sign(shares))[None],
        np.zeros((1, 1)),
    )


def _designed(design: str) -> tuple[ModalModel, StateModel, float, float]:
    """Stage, its controller, sample time (s) and delay (samples), as `design` wrote them."""
    files = [Path(design)] if design.endswith(".json") else sorted(Path(design).glob("*.json"))
    if len(files) != 1:
        raise InputError(
            f"{design} holds {len(files)} controllers; give one of the JSON files that stillwork design wrote"
        )
    written = load_controller(files[0])
    about, controller = Table(dict(written.about), files[0].name), of_reference(written)
    made = about.table("provenance")
    controller, delay = (
        in_the_units_of_the_file(controller, made).model,
        float(made["delay_samples_of_the_loop"]),
    )
    return model_of(about.table("model")), force_law(controller), controller.sample_time, delay


def _isolated(own: WrittenIsolator, stage: ModalModel, law, settings: dict[str, Any]) -> FloorMachine:
    """A stage on the isolator that `isolate` designed for."""
    if not settings["sample_time"]:
        raise InputError("controller: rate_hz is 0, but isolate wrote a sampled loop; give rate_hz")
    carried = float(1 / (stage.input_shapes[0, 0] * stage.output_shapes[0, 0]))
    if own.mass <= carried:
        raise InputError(
            f"the isolator's mass is {own.mass:.4g} kg, the stage's {carried:.4g} kg; give isolate the mass of both together"
        )
    isolator = own.law(settings["sample_time"], settings["delay"])
    settings = {name: value for name, value in settings.items() if name in ("sample_time", "delay")}
    suspended = own.mass - carried, own.suspension_hz, own.suspension_damping
    return FloorMachine(*suspended, stage, law, isolator=isolator, isolator_pole_hz=own.pole_hz, **settings)


def number_of(entries: Table, name: str, default: float) -> float:
    return float(require_number(f"{entries.where}: {name}", entries.get(name, default)))


def sources_of(entries: Table, floor: str, folder: Path, rate_hz: float, mass: float = 0.0) -> list[Source]:
    """The sources of a file; the file `floor` replaces those that act at the floor.

    A feedforward of the setpoint assumes `mass` (kg) for the stage's if the file does not state one.
    """
    given = own_table(entries, "sources", "budget")
    found = [_source(name, given.table(name), folder, rate_hz, mass) for name in given]
    if floor:
        found = [source for source in found if source.places != ("floor",)] + [
            measured_at("floor", Path(floor), "", "floor")
        ]
    return found


def _source(name: str, entries: Table, folder: Path, rate_hz: float, mass: float) -> Source:
    entries.require_known(KNOWN["sources"])
    place = require_choice(f"{name}: place", entries["place"], PLACES)
    kinds = [kind for kind in KINDS if kind in entries]
    if len(kinds) != 1:
        raise InputError(f"{name}: holds {' and '.join(kinds) or 'no kind'}; give one of {', '.join(KINDS)}")
    kind = kinds[0]
    moves = kind in ("setpoint", "move")
    if (kind == "criterion" and place != "floor") or moves != (place == "setpoint"):
        suits = {"floor": "criterion or file", "setpoint": "setpoint or move"}.get(
            place, "file, white, quantiser, tone_hz or periodic"
        )
        raise InputError(f"{name}: {kind} is not for the place {place!r}; give {suits}")
    if kind == "criterion":
        return criterion_floor(name, place, entries["criterion"])
    if kind == "file":
        return measured_at(name, folder / entries["file"], entries.get("unit", ""), place)
    if kind == "periodic":
        record = _one_record(name, folder / entries["periodic"], entries.get("unit", ""), place)
        return periodic(name, place, PLACES[place], record.signals[0], record.sample_rate)
    if moves:
        return _setpoint(name, entries, folder, mass)
    if kind == "tone_hz":
        tone = float(require_number(f"{name}: tone_hz", entries["tone_hz"], above=0.0))
        return Source(
            name, (place,), PLACES[place], tones=((tone, _amount(name, entries["amplitude"], place, "")),)
        )
    if kind == "quantiser":
        if not rate_hz:
            raise InputError(f"{name}: a quantiser needs rate_hz of the controller; give it")
        return quantiser(name, place, PLACES[place], _amount(name, entries["quantiser"], place, ""), rate_hz)
    level = _amount(name, entries["white"], place, "/sqrt(Hz)")
    return white(name, place, PLACES[place], level, number_of(entries, "corner_hz", 0.0))


def _amount(name: str, text, place: str, density: str) -> float:
    """A number with its unit, as ``0.3 nm/sqrt(Hz)`` or ``0.09 nm^2/Hz``, in the unit of a place."""
    words = str(text).split(maxsplit=1)
    wanted = f"{PLACES[place]}{density}"
    try:
        size = float(words[0])
    except (ValueError, IndexError):
        size = np.nan
    if len(words) < 2 or not np.isfinite(size) or size < 0:
        raise InputError(f"{name}: is {text!r}; give a number of at least 0 and its unit, as '1.0 {wanted}'")
    known = density_unit(words[1])
    if (known is None) == bool(density):
        raise InputError(f"{name}: unit is {words[1]!r}, but {place!r} needs {wanted}; convert it")
    factor = _factor(name, known[0] if known else words[1], place, words[1], wanted)
    return factor * (np.sqrt(size) if known and known[1] == 2 else size)


def _factor(name: str, unit: str, place: str, stated: str, wanted: str) -> float:
    try:
        factor, known = unit_factor(unit)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
    if known != PLACES[place]:
        raise InputError(f"{name}: unit is {stated!r}, but {place!r} needs {wanted}; convert it")
    return factor


def measured_at(name: str, file: Path, unit: str, place: str) -> Source:
    """A measured source: densities with a column of frequencies, or a record; that of a floor in any unit of motion."""
    columns = read_columns(file)
    axis = frequency_axis(columns)
    if not axis or any(is_time(each) for each in columns):
        record = _one_record(name, file, unit, place)
        resolution = max(16 / record.duration, 0.25)
        spectrum = estimate_spectrum(record.signals, record.sample_rate, resolution)
        return replace(
            measured(name, place, PLACES[place], spectrum), band_hz=(resolution, 0.4 * record.sample_rate)
        )
    if PLACES[place] == "m/s^2":
        f, rows = read_densities(file, unit, [], 1)
        return tabulated(name, place, "m/s^2", f, rows[0])
    f = hertz_in(axis) * columns.pop(axis)
    if len(columns) != 1:
        raise InputError(
            f"{name}: {file.name} holds {len(columns)} columns besides {axis!r}; keep the one that acts here"
        )
    ((column, row),) = columns.items()
    stated = agreed_density(file.name, column, unit)
    known, wanted = density_unit(stated) if stated else None, f"{PLACES[place]}/sqrt(Hz)"
    if known is None:
        raise InputError(
            f"{name}: {file.name}: column {column!r} has no unit of a density; add it in brackets, as ({wanted})"
        )
    level = _factor(name, known[0], place, stated, wanted) ** 2 * (row**2 if known[1] == 1 else row)
    return tabulated(name, place, PLACES[place], f[f > 0], level[f > 0])


def _one_record(name: str, file: Path, unit: str, place: str) -> Record:
    """One channel over time, in the unit of its place."""
    record = load_record(file, unit, most_channels=1)
    if PLACES[place] == "m/s^2":
        return to_acceleration(record)
    if record.unit != PLACES[place]:
        raise InputError(
            f"{name}: {file.name} is in {record.unit}, but {place!r} needs {PLACES[place]}; convert it"
        )
    return record


def _setpoint(name: str, entries: Table, folder: Path, mass: float) -> Source:
    """A setpoint from a file of one period, or a stroke there and back, with the feedforward of mass and acceleration."""
    if "move" in entries:
        stroke = _amount(name, entries["move"], "setpoint", "")
        seconds, rest = (
            float(require_number(f"{name}: {field}", entries[field], above=0.0))
            for field in ("move_s", "rest_s")
        )
        rate = max(MOVE_SAMPLES / seconds, MOVE_SAMPLES / rest)
        way = np.clip(np.arange(round((seconds + rest) * rate)) / (seconds * rate), 0.0, 1.0)
        there = stroke * way**4 * (35 - 84 * way + 70 * way**2 - 20 * way**3)  # jerk begins and ends at 0
        period = np.concatenate([there, stroke - there])
    else:
        record = _one_record(name, folder / entries["setpoint"], entries.get("unit", ""), "setpoint")
        period, rate = record.signals[0], record.sample_rate
    believed = number_of(entries, "feedforward_mass_kg", mass)
    return setpoint(
        name,
        period,
        rate,
        require_number(f"{name}: feedforward_mass_kg", believed, at_least=0.0),
        number_of(entries, "feedforward_advance_s", 0.0),
    )
