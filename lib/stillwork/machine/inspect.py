"""The command ``inspect``: what a file holds, and which notebooks can use it."""

import ast
import contextlib
import json
import os
import shlex
from collections.abc import Collection, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from stillwork.base.checks import InputError, one_line, pluralise, short_repr
from stillwork.base.command_line import others
from stillwork.base.toml_files import Table, read_toml
from stillwork.signals.datafiles import read_arrays, read_columns
from stillwork.signals.densities import DENSITY_UNITS_TEXT, frequency_axis, hertz_in, spectra_of
from stillwork.signals.records import is_time, load_unscaled, stated_unit, unknown_unit
from stillwork.signals.units import MOTION_UNITS, UNITS_TEXT, unit_factor

# What a Python file must define to be a plant, with one coordinate or with several: functions with their numbers of
# arguments, tables of parameters.
FORMS = ({"acceleration": 4, "force": 4}, {"inertia": 3, "bias": 4})
TABLES = ("EXACT", "APPROXIMATE")

FLOOR_SENSORS = 3  # of the shipped rig: more channels than these its notebook does not take
SHORTEST_FLOOR_S = 15.0  # of a floor, for some averaging of its spectra (chosen)


def inspect_file(file: str) -> str:
    """List what a file holds, what is wrong with it, and the commands that use it; nothing in it is executed."""
    path = Path(file)
    if not os.path.isfile(path):  # False as well, as for a folder, for a name that no system takes
        if os.path.isdir(path):
            raise InputError(f"{file}: this is a folder; name a file in it")
        raise InputError(
            f"{short_repr(file)}: no such file; give a CSV, TDMS, MAT, HDF5, NPZ, UFF, TOML or Python file"
        )
    kinds = {".toml": _toml, ".py": _plant}
    with np.errstate(all="ignore"):  # a line reports what is not finite
        lines = list(kinds.get(path.suffix.lower(), _data)(path))
    if not in_checkout() and any(line.startswith("for ") for line in lines):
        lines.append("the commands after 'for' require the cloned repository of stillwork")
    return "\n".join(map(one_line, lines))


def _data(path: Path) -> Iterator[str]:
    arrays = read_arrays(path)
    yield f"{path.name}: {'1 column or array' if len(arrays) == 1 else f'{len(arrays)} columns or arrays'}"
    width = max(map(len, arrays), default=0)
    for name, values in arrays.items():
        yield f"  {name:{width}}  {_described(values)}"
    if spectra_of(arrays):
        yield from _spectra(path)
        return
    machine = list(_machine(path, arrays))
    yield from machine
    if any(values.dtype.kind == "c" for values in arrays.values()) and not frequency_axis(arrays):
        yield "complex values without frequencies: put them into a separate file, with a column frequency (Hz) of the same length"
        return
    # One hit's force and response may be an input-output record, too; several hits side by side are none.
    signals = [array for name, array in arrays.items() if array.size > 1 and not is_time(name)]
    if not machine or [np.squeeze(array).ndim for array in signals] == [1, 1]:
        yield from _record(path)


def _toml(path: Path) -> Iterator[str]:
    """What a machine's TOML holds for each command that reads it, or what else the file is."""
    table = read_toml(path)
    uses = {"sources": _budgeted, "isolator": _isolated, "decoupling": _decoupled}
    found = [use for name, use in uses.items() if name in table]
    if not found:
        yield from _model(path, table)
    for use in found:
        try:
            yield from use(path, table)
        except InputError as error:
            yield f"{path.name}: not usable {use.__doc__}: {error}"


def _budgeted(path: Path, table: Table) -> Iterator[str]:
    """for an error budget"""
    from stillwork.machine.budget_tables import open_machine

    built = open_machine(str(path)).machine
    yield (
        f"{path.name}: a stage of {built.stage_mass:.4g} kg over a frame of {built.frame_mass:.4g} kg, "
        f"suspension at {built.suspension_hz:.4g} Hz"
    )
    yield command("its error budget", ["budget", str(path.resolve())])


def _isolated(path: Path, table: Table) -> Iterator[str]:
    """as an isolator"""
    from stillwork.machine.isolate import read_isolator

    own = table.table("isolator")
    if "response" in own and "mass" not in own:
        yield f"{path.name}: the measured response {one_line(str(own['response']))} of an isolator"
    else:
        isolator, *_ = read_isolator(str(path), 1000.0)  # of the rate nothing here depends on
        modes = ", ".join(f"{hertz:.4g}" for hertz in isolator.frequencies_hz)
        yield f"{path.name}: an isolator of {pluralise(isolator.axes, 'actuator')}, modes at {modes} Hz"
    yield _isolate(str(path.resolve()), "FLOOR")


def _decoupled(path: Path, table: Table) -> Iterator[str]:
    """as a machine of several axes"""
    from stillwork.identification.matrix_files import load_matrix

    file = path.parent / str(table.table("decoupling")["response"])
    if (matrix := load_matrix(file)) is None:
        raise InputError(f"{file.name} holds no matrix response; name its entries h11, h12, ...")
    outputs, inputs = len(matrix.outputs), len(matrix.inputs)
    yield f"{path.name}: the matrix response {matrix.source} of {outputs} outputs and {inputs} inputs"
    words = ["design", str(path.resolve()), "--rate", "HZ", "--out", "my_controllers"]
    yield command("controllers in C of its decoupled axes", words)


def _model(path: Path, table: dict) -> Iterator[str]:
    """What a TOML file holds, and what else is installed says of it as a machine."""
    yield f"{path.name}: {pluralise(len(table), 'entry')}"
    for name, value in table.items():
        shown = f"table of {', '.join(value)}" if isinstance(value, dict) else repr(value)
        yield f"  {name}: {shown}"
    if not in_checkout():
        yield "run this in the cloned repository to check whether it is a machine of the workbook"
        return
    for other in others():
        for each in other.model_file(path):
            yield each if isinstance(each, str) else figures_command(*each)


def figures_command(notebook: str, settings: dict) -> str:
    """The line for a shell that runs a notebook with these settings."""
    words = [word for key, value in settings.items() for word in ("-p", f"{key}={value}")]
    return command(f"for {notebook}", ["figures", notebook, *words])


def command(purpose: str, words: list[str]) -> str:
    """A line for a shell, with every name as one word of it."""
    for word in words:
        if not word.isprintable():  # a terminal acts on a control code that is pasted, quoted or not
            held = word.partition("=")[2] or word
            return f"no command {purpose if purpose.startswith('for ') else 'for ' + purpose}: {held} holds characters that cannot be typed; rename it and run this again"
    return f"{purpose}: {shlex.join(['python', '-m', 'stillwork', *words])}"


def in_checkout() -> bool:
    """Whether the experiments and the notebooks are at hand, which a wheel does not hold."""
    found = find_spec("experiments")
    places = [] if found is None else found.submodule_search_locations or []
    return any((Path(place).parents[1] / "notebooks").is_dir() for place in places)


def _isolate(machine: str, floor: str, unit: str = "", channels: Collection[str] = ()) -> str:
    """The command for the feedforward, unknown arguments in capitals."""
    words = [machine, floor, "--rate", "HZ", "--out", "my_isolator"]
    words += ["--unit", unit] if unit else []
    return command("a feedforward in C", ["isolate", *words, *(f"--channel={name}" for name in channels)])


def _spectra(path: Path) -> Iterator[str]:
    """The commands for spectra of a motion."""
    columns = read_columns(path)
    axis, spectra = frequency_axis(columns), spectra_of(columns)
    hertz = hertz_in(axis) * columns[axis]
    unit = next(iter(spectra.values()))
    alike = [name for name, other in spectra.items() if other == unit]
    yield f"spectra over {len(hertz)} frequencies up to {hertz.max():.4g} Hz: {', '.join(spectra)}"
    if not unit:
        yield f"the unit of its densities is not stated; replace UNIT by one of these: {DENSITY_UNITS_TEXT}"
    unit = unit or "UNIT"
    yield command("one page about it", ["report", str(path.resolve()), "--unit", unit])
    yield _isolate("MACHINE", str(path.resolve()), unit, alike if len(alike) < len(spectra) else ())
    settings = {"floor_record": path.resolve(), "floor_unit": unit}
    if len(spectra) > 1:
        settings["floor_channels"] = json.dumps(alike[:FLOOR_SENSORS], ensure_ascii=False)
    yield figures_command("isolation/08-your-floor", settings)


def _record(path: Path) -> Iterator[str]:
    """The commands for signals over time."""
    try:
        record = load_unscaled(path)
    except InputError as error:
        yield f"not usable as a record: {error}"
        return
    units = [stated_unit(name) for name in record.names]
    odd = {name: said for name in record.names if (said := unknown_unit(name))}
    known = [(name, unit) for name, unit in zip(record.names, units, strict=True) if name not in odd]
    yield f"a record of {pluralise(len(record.names), 'channel')}: {record.sample_rate:.6g} Hz, {record.duration:.4g} s"
    yield from record.notes
    if odd:
        yield f"unknown units: {', '.join(odd.values())}; convert {', '.join(odd)} to one of these: {UNITS_TEXT}"
    if any(not unit for _, unit in known):
        yield f"not every unit is stated; replace UNIT by one of these: {UNITS_TEXT}"

    def measuring(wanted: tuple[str, ...]) -> list[tuple[str, str]]:
        """Channels in one of these SI units, or in a unit that the file does not state."""
        return [(name, unit) for name, unit in known if not unit or unit_factor(unit)[1] in wanted]

    motions = measuring(MOTION_UNITS)
    if motions and record.duration >= SHORTEST_FLOOR_S:
        unit = motions[0][1]
        # Each in its own unit of the same quantity, as in its name; then no unit is given.
        quantity = unit and unit_factor(unit)[1]
        alike = [name for name, other in motions if (other and unit_factor(other)[1]) == quantity]
        own = {other for name, other in motions if name in alike}
        given = "" if len(own) > 1 else unit or "UNIT"
        yield _isolate("MACHINE", str(path.resolve()), given, alike if len(alike) < len(record.names) else ())
        settings: dict[str, Any] = {"floor_record": path.resolve()} | ({"floor_unit": given} if given else {})
        if len(record.names) > 1:
            settings["floor_channels"] = json.dumps(alike[:FLOOR_SENSORS], ensure_ascii=False)
        yield figures_command("isolation/08-your-floor", settings)
    if len(known) >= 2:
        settings = {"record_file": path.resolve()}
        for side, (name, unit) in zip(("input", "output"), known, strict=False):
            settings |= {f"{side}_channel": name, f"{side}_unit": unit or "UNIT"}
        settings |= {"band_hz": "0,0", "quiet_hz": "0,0"}  # the defaults are those of the shipped record
        yield figures_command("worstcase/07-your-record", settings)
    positions = measuring(("m", "rad"))
    if positions:
        name, unit = positions[0]
        settings = {"trajectory_record": path.resolve(), "trajectory_unit": unit or "UNIT"}
        if len(record.names) > 1:
            settings["trajectory_channel"] = name
        yield figures_command("fixedpoint/09-your-plant", settings)


def _machine(path: Path, arrays: dict[str, np.ndarray]) -> Iterator[str]:
    """The commands for a machine; nothing if no name in the file belongs to one."""
    from stillwork.identification.machine_files import complex_responses, kind_of, load_machine
    from stillwork.identification.matrix_files import load_matrix

    try:
        kind = kind_of(arrays)
    except InputError:
        return
    with contextlib.suppress(InputError):
        if matrix := load_matrix(path):
            outputs, inputs = len(matrix.outputs), len(matrix.inputs)
            yield f"responses of a machine of {outputs} outputs and {inputs} inputs: {pluralise(len(matrix.hertz), 'line')}"
            if outputs == inputs:
                words = ["design", str(path.resolve()), "--rate", "HZ", "--out", "my_controllers"]
                yield command("controllers in C of its decoupled axes", words)
            if not list(complex_responses(arrays)):
                return
    try:
        several = list(complex_responses(arrays)) if kind == "frequency response" else []
        chosen = several[0] if len(several) > 1 else ""
        file = load_machine(path, response=chosen)
        settings, said = _of_machine(path, arrays, kind, file)
    except InputError as error:
        yield f"not usable as a machine: {error}"
        return
    yield from said
    if chosen and file.model is None:
        settings["response"] = chosen
    words = [str(path.resolve())]
    for name in ("response_unit", "force_unit", "response"):
        if settings.get(name):
            words += [f"--{name.replace('_', '-')}", settings[name]]
    yield command("a controller in C", ["design", *words, "--rate", "HZ", "--out", "my_controller"])
    yield command("one page about it", ["report", *words])
    count = max(len(several), 1)  # of an isolator one of each actuator to each sensor
    if kind == "frequency response" and file.units == ("m", "N") and round(count**0.5) ** 2 == count:
        yield _isolate(str(path.resolve()), "FLOOR")
    yield command("a loop shaped by hand", ["desk", *words])
    yield figures_command("motion/29-your-machine", settings)


def _of_machine(
    path: Path, arrays: dict[str, np.ndarray], kind: str, file: Any
) -> tuple[dict[str, Any], list[str]]:
    """Settings of a page about a machine, and what it is."""
    from stillwork.identification.machine import build_machine
    from stillwork.identification.machine_files import response_names, stated_units

    settings: dict[str, Any] = {"machine_file": path.resolve()}
    if file.model is not None:
        machine = build_machine(file, modes_hz=[], fit_hz=(0.0, 0.0))
        resonances = ", ".join(f"{hertz:.4g}" for hertz in machine.resonances_hz[:5])
        what = f"{kind} of a machine of {machine.mass:.4g} {machine.mass_unit}, first resonances at {resonances} Hz"
        return settings, [what]
    hertz = file.accelerance.omega / (2 * np.pi)
    said = [f"{kind} of a machine: {pluralise(len(hertz), 'line')} from {hertz[0]:.4g} to {hertz[-1]:.4g} Hz"]
    response, force = stated_units(response_names(arrays))
    settings |= {"response_unit": response or "UNIT", "force_unit": force or "N"}
    if not response:
        said.append(
            "the unit of the response is not stated; replace UNIT by m/s^2, g, m/s, mm/s, m, mm or um"
        )
    return settings | {"fit_hz": "0,0", "loop_hz": "0,0"}, said


def _plant(path: Path) -> Iterator[str]:
    missing = outline(path)
    if missing:
        yield f"{path.name}: not usable as a plant: {', '.join(missing)}; see data/fixedpoint/your_plant.py and arm.py"
        return
    yield f"{path.name}: the model functions of a plant; the notebook executes the file, this command did not"
    yield figures_command("fixedpoint/09-your-plant", {"plant": path.resolve()})


def _described(values: np.ndarray) -> str:
    shape = f" ({' x '.join(map(str, values.shape))})" if values.ndim > 1 else ""
    if values.dtype.kind == "c":
        sizes = np.abs(values[np.isfinite(values)])
        return f"{pluralise(values.size, 'complex value')}{shape}" + (
            f" of magnitude {sizes.min():.4g} to {sizes.max():.4g}" if sizes.size else ""
        )
    good = values[np.isfinite(values)]
    missing = f", {values.size - good.size} missing or infinite" if good.size < values.size else ""
    if not good.size:
        return f"{pluralise(values.size, 'value')}{shape}{missing}"
    if values.size == 1:
        return f"{values.item():.6g}"
    size = np.abs(good).max() or 1.0  # sums of the largest numbers and of their squares would overflow
    spread = f"mean {size * (good / size).mean():.4g}, standard deviation {size * (good / size).std():.4g}"
    return f"{values.size} values{shape} from {good.min():.4g} to {good.max():.4g}, {spread}{missing}"


def plant_form(names: Collection[str]) -> dict[str, int]:
    """Which of `FORMS` a file that defines these names means: the first, unless it holds more of the second."""
    return max(FORMS, key=lambda form: len(form.keys() & set(names)))


def outline(file: Path) -> list[str]:
    """What a Python file lacks to be a plant, from its source without executing it; empty if nothing."""
    try:
        tree = ast.parse(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{file}: no such file; give the path of a Python file") from None
    except (SyntaxError, UnicodeDecodeError, ValueError) as error:
        raise InputError(f"{file.name} is not Python ({error}); correct it") from None
    functions = {node.name: len(node.args.args) for node in tree.body if isinstance(node, ast.FunctionDef)}
    names = {
        target.id
        for node in tree.body
        if isinstance(node, ast.Assign | ast.AnnAssign)
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
        if isinstance(target, ast.Name)
    }
    missing = [
        f"{name} takes {functions[name]} arguments, not {count}"
        if name in functions
        else f"no function {name}"
        for name, count in plant_form(functions).items()
        if functions.get(name) != count
    ]
    return missing + [f"no table {name}" for name in TABLES if name not in names]
