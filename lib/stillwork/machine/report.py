"""The command ``report``: one page about a measured machine, a record or power spectral densities."""

import html
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import integrate, ndimage

from stillwork.base.checks import InputError, one_line, pluralise
from stillwork.base.extras import require_package
from stillwork.identification.machine import TRUSTED, Machine, build_machine, trusted
from stillwork.identification.machine_files import (
    complex_responses,
    kind_of,
    load_machine,
    response_names,
    stated_units,
)
from stillwork.machine import pictures
from stillwork.machine.design_page import paint_machine, paint_stabilisation, uses_table
from stillwork.machine.html_page import page, picture, require_new, table
from stillwork.machine.inspect import inspect_file
from stillwork.machine.machine_designs import DELAY, EACH, search_designs, stated_uncertainty, uses_of
from stillwork.machine.progress import count_steps
from stillwork.machine.promise import beyond
from stillwork.machine.readings import believed, require_explained
from stillwork.signals.datafiles import read_arrays, read_columns
from stillwork.signals.densities import (
    DENSITY_UNITS_TEXT,
    frequency_axis,
    read_densities,
    spectra_of,
    stated_density,
)
from stillwork.signals.headings import heading
from stillwork.signals.records import Record, channel_unit, is_time, load_unscaled, sampling_rate, stated_unit
from stillwork.signals.spectra import band_power, estimate_response, estimate_spectrum
from stillwork.signals.units import UNITS_TEXT, unit_factor

SEGMENTS = 16  # of a record, at least, in its spectra
MOST_CHANNELS = 8  # of a record or of spectra on one page
LISTED = 4  # modes in the answer; the page has all
NORMAL = 1.96  # standard deviations either side of a number, 95 %


class Answer(str):
    """A line that answers; the other findings are for who wants to know more."""


class Missing(InputError):
    """Information that is neither in a file nor given: the user is prompted for `name`."""

    def __init__(self, name: str, question: str, value: str = "UNIT"):
        super().__init__(f"{question}; give --{name.replace('_', '-')} {value}")
        self.name, self.question = name, question


def report_asking(file: str, out: str, **arguments) -> list[str]:
    """`report_file`, with a prompt at the terminal for each missing piece of information."""
    while True:
        try:
            return report_file(file, out, **arguments)
        except Missing as missed:
            if not sys.stdin.isatty():
                raise
            try:
                answer = input(f"{one_line(missed.question)}: ").strip()
            except EOFError:  # an end of the input instead of an answer
                raise missed from None
            arguments[missed.name] = _number(answer) if missed.name == "sample_rate" else answer


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{text!r} is not a number; give the rate in Hz") from None


def report_file(file: str, out: str = "", *, verbose: bool = False, **arguments) -> list[str]:
    """Write a new page about the measurement in `file`; returns what was found and where it is, with `verbose` all findings.

    `arguments` holds what the file may not state: `unit` of a record or of densities, `response_unit`, `force_unit`,
    `response`, `sample_rate` (Hz), `damping_ratio` and `fit_hz`; and the settings of the search for a controller, as in
    the command `design`: `rate` (Hz), `delay` (samples), `uncertainty` and `loop_hz`. Empty or None: not given. If
    necessary information is neither in the file nor given, `Missing` is raised; the search's settings have defaults,
    which the page prints.
    """
    require_package("matplotlib")
    source = Path(file)
    arguments = {
        name: value for name, value in arguments.items() if value or (name == "delay" and value is not None)
    }
    stated_uncertainty(arguments.get("uncertainty", ""))
    held = inspect_file(file)
    if source.suffix.lower() in (".toml", ".py"):
        raise InputError(
            f"{source.name} is a model, not a measurement; `stillwork inspect` lists the commands for it"
        )
    target = require_new(out or f"{source.name}.html")
    arrays = read_arrays(source)
    if all(array.size < 2 for array in arrays.values()):
        raise InputError(f"{source.name} holds no rows of numbers; export the measurement again")
    try:
        kind = kind_of(arrays)
    except InputError:
        kind = "densities" if frequency_axis(arrays) else "record"
    if kind == "frequency response" and spectra_of(arrays):
        kind = "densities"
    parts = {"densities": _densities, "record": _record}.get(kind, _machine)
    lines: list[str] = []
    sections: list[tuple[str, str]] = []
    for part in parts(source, arrays, arguments):
        if isinstance(part, str):
            lines.append(part)
        else:
            sections.append(part)
    answers = [line for line in lines if isinstance(line, Answer)]
    others = [line for line in lines if not isinstance(line, Answer)]
    body = [f"<p>{html.escape(line)}</p>" for line in (*answers, *others)]
    body += [f"<h2>{html.escape(title)}</h2>\n{content}" for title, content in sections]
    text = page("report.html", source=html.escape(source.name), body="\n".join(body), held=html.escape(held))
    target.write_text(text, encoding="utf-8")
    return [*answers, f"written: {target}", *(others if verbose else [])]


def _machine(source: Path, arrays, arguments) -> Iterator[str | tuple[str, str]]:
    names = ("response_unit", "force_unit", "sample_rate", "response", "damping_ratio")
    options = {key: arguments[key] for key in names if key in arguments}
    kind = kind_of(arrays)
    if kind == "frequency response":
        several = list(complex_responses(arrays))
        if len(several) > 1 and "response" not in arguments:
            raise Missing("response", f"{source.name} holds {', '.join(several)}; which one", "NAME")
    if kind == "hammer records":
        _rate(source, arrays, arguments)
    if kind != "matrices":
        try:
            units = stated_units(response_names(arrays))
        except InputError as error:
            raise InputError(f"{source.name}: {error}") from None
        for name, stated, usual in zip(
            ("response_unit", "force_unit"), units, ("m/s^2, g or um", "N or kN"), strict=True
        ):
            if not stated and name not in arguments:
                whose = name.partition("_")[0]
                raise Missing(name, f"{source.name} does not state the unit of the {whose} (e.g. {usual})")
    file = load_machine(source, **options)
    band = arguments.get("fit_hz", (0.0, 0.0))
    machine = build_machine(file, modes_hz=[], fit_hz=band, rigid=True)
    print(believed(file, machine), file=sys.stderr, flush=True)
    known = f" ± {100 * NORMAL * machine.fit.mass_deviation:.2g} %" if machine.fit else ""
    modes = [f"{hertz:.4g}" for hertz in machine.resonances_hz]
    further = f" and {pluralise(len(modes) - LISTED, 'other')}" if len(modes) > LISTED else ""
    flexible = f", flexible modes at {', '.join(modes[:LISTED])} Hz{further}" if modes else ""
    yield Answer(f"{kind} of a machine of {machine.mass:.4g} {machine.mass_unit}{known}{flexible}")
    yield from machine.notes
    yield from _trusted(machine)
    yield "Modes", _modes(machine) + picture(paint_machine(machine), "accelerance")
    if machine.fit:
        yield "Stabilisation", picture(paint_stabilisation(machine.fit), "poles over the order")
    asked = {"delay": DELAY} | {
        key: arguments[key] for key in ("rate", "delay", "uncertainty", "loop_hz") if key in arguments
    }
    try:
        require_explained(source, file, machine, band, options)
        made = search_designs(machine, **asked, on_step=count_steps(EACH * len(uses_of(machine)), "report"))
    except InputError as error:
        yield Answer(f"no loop was searched: {error}")
    else:
        yield Answer(made.ranking_line)
        if made.ranking and (without := beyond(made)):
            yield f"the 6 dB of {made.ranking[0]} hold {without}"
        yield from made.lines()[:-1]
        yield "Bandwidth with a PID controller, and what an observer adds", uses_table(made)


def _trusted(machine: Machine) -> Iterator[str]:
    """How far the coherence lets the response be trusted, and what a wider measurement would add."""
    if machine.measured is None or machine.fit is None:
        return
    hertz, coherence = machine.measured.omega / (2 * np.pi), machine.measured.coherence
    ends = machine.fit.omega[[0, -1]] / (2 * np.pi)
    if np.isfinite(coherence).any() and np.nanmin(coherence) < 1:
        places, count = ndimage.label(trusted(machine.measured))
        stretches = [hertz[places == k][[0, -1]] for k in range(1, count + 1)]
        if not stretches:
            yield f"at no line does the coherence let the response be trusted to {100 * TRUSTED:g} %: average more, or excite more"
            return
        low, high = max(stretches, key=lambda each: each[1] / max(each[0], hertz[0], 1e-9))
        cut = low > ends[0] or high < ends[1]
        beside = ": fit_hz reaches beyond it; average or excite more there, or narrow it" if cut else ""
        yield f"the coherence lets the response be trusted to {100 * TRUSTED:g} % from {low:.4g} to {high:.4g} Hz{beside}"
    further = machine.fit.cut
    seen = (
        f"; one shows at about {further[0] / (2 * np.pi):.4g} Hz: measure beyond it" if len(further) else ""
    )
    yield f"modes above {ends[1]:.4g} Hz, where the band of the fit ends, are not in the model{seen}"


def _modes(machine: Machine) -> str:
    """Table of the flexible modes, with intervals of 95 % where they were measured."""
    model, fit = machine.sensors[0], machine.fit
    first = model.rigid_modes
    rows = []
    for k in range(first, len(model.frequencies)):
        hertz, ratio = model.frequencies[k] / (2 * np.pi), 100 * model.damping[k]
        share = model.input_shapes[k, 0] * model.output_shapes[0, k] * machine.mass
        row = [f"{hertz:.6g}", f"{ratio:.3g}", f"{share:.3g}"]
        if fit:
            spread = fit.deviation[k - first] / (2 * np.pi), 100 * fit.damping_deviation[k - first]
            row[:2] = (f"{each} ± {NORMAL * by:.2g}" for each, by in zip(row[:2], spread, strict=True))
        rows.append(row)
    return table(["frequency (Hz)", "damping (%)", "share of the rigid body"], rows)


def _record(source: Path, arrays, arguments) -> Iterator[str | tuple[str, str]]:
    rate = _rate(source, arrays, arguments)
    record = load_unscaled(source, sample_rate=rate, most_channels=MOST_CHANNELS)
    given = arguments.get("unit", "")
    silent = [name for name in record.names if not stated_unit(name)]
    if silent and not given:
        raise Missing("unit", f"{source.name} does not state the unit of {silent[0]} ({UNITS_TEXT})")
    for name in () if silent else record.names:
        channel_unit(source.name, name, given)  # nothing is left that a given unit could mean
    units = [stated_unit(name) or given for name in record.names]
    factors, units = zip(*map(unit_factor, units), strict=True)
    signals = record.signals * np.array(factors)[:, None]
    signals -= signals.mean(axis=1, keepdims=True)
    yield Answer(
        f"a record: {record.sample_rate:.6g} Hz, {record.duration:.4g} s, {pluralise(len(units), 'channel')}"
    )
    rms = [
        f"{one_line(name)} {row.std():.4g} {unit}"
        for name, row, unit in zip(record.names, signals, units, strict=True)
    ]
    yield Answer(f"rms: {', '.join(rms)}")
    yield from record.notes
    rows = []
    for name, unit, row in zip(record.names, units, signals, strict=True):
        kurtosis = np.mean(row**4) / row.var() ** 2
        rows.append([name, unit, f"{row.std():.4g}", f"{np.abs(row).max():.4g}", f"{kurtosis:.3g}"])
    yield "Channels", table(["channel", "SI unit", "rms", "peak", "kurtosis (3: Gaussian)"], rows)
    resolution = max(1 / record.duration * SEGMENTS / 2, record.sample_rate / 2**14)
    spectrum = estimate_spectrum(signals, record.sample_rate, resolution)
    hertz, unit = spectrum.frequencies_hz[1:], " or ".join(dict.fromkeys(units))
    yield "Spectra", _densities_of(hertz, spectrum.density[:, 1:], record.names, unit)
    if len(signals) > 1:
        figure = paint_response(replace(record, signals=signals), resolution)
        yield "From the first channel to the others", picture(figure, "coherence")


def _densities(source: Path, arrays, arguments) -> Iterator[str | tuple[str, str]]:
    columns = read_columns(source)
    lines = columns[frequency_axis(columns)].size
    names = [n for n, each in columns.items() if each.size == lines and heading(n).quantity != "frequency"]
    unit = arguments.get("unit", "")
    if not (unit or all(map(stated_density, names))):
        raise Missing(
            "unit", f"{source.name} does not state the unit of its densities ({DENSITY_UNITS_TEXT})"
        )
    hertz, density = read_densities(source, unit, [], MOST_CHANNELS)
    yield Answer(
        f"power spectral densities, {len(hertz)} frequencies from {hertz[0]:.4g} to {hertz[-1]:.4g} Hz, as accelerations"
    )
    rows = []
    for name, row in zip(names, density, strict=True):
        motions = [row / (2 * np.pi * hertz) ** (2 * order) for order in (0, 1, 2)]
        powers = [band_power(hertz, motion, hertz[0], hertz[-1]) for motion in motions]
        rows.append([name, *(f"{np.sqrt(power):.4g}" for power in powers)])
    yield Answer(f"rms: {', '.join(f'{one_line(name)} {rms} m/s^2' for name, rms, *_ in rows)}")
    yield "Root mean squares", table(["spectrum", "m/s^2", "m/s", "m"], rows)
    yield "Spectra", _densities_of(hertz, density, names, "m/s^2")


def _densities_of(hertz, density, names, unit: str) -> str:
    return picture(paint_densities(hertz, density, names, unit), "power spectral densities")


@pictures.house_style()
def paint_densities(hertz, density, names, unit: str):
    """Power spectral densities over frequency, and the rms that gathers from the lowest one on."""
    power = integrate.cumulative_trapezoid(density, hertz, initial=0.0)
    seen = np.maximum(density, 1e-12 * density.max(axis=1, keepdims=True))
    figure, upper, lower = _two_panels(hertz, seen, np.sqrt(power), names)
    upper.set_ylabel(f"density (({unit})²/Hz)")
    lower.set_ylabel(f"cumulative rms ({unit})")
    return figure


@pictures.house_style()
def paint_response(record: Record, resolution: float):
    """Size of the response of every other channel to the first, and its coherence."""
    found = estimate_response(record.signals[:1], record.signals[1:], record.sample_rate, resolution)
    size, hertz = np.abs(found.response[:, 0, 1:]), found.frequencies_hz[1:]
    figure, upper, lower = _two_panels(hertz, size, found.coherence[:, 1:], record.names[1:])
    upper.set_ylabel(f"over {pictures.literal(record.names[0])}")
    lower.set(ylabel="coherence", ylim=(0, 1.05))
    return figure


def _two_panels(hertz, above, below, names):
    """Rows over frequency on two panels, the upper ones in decades."""
    figure, (upper, lower) = pictures.new(2, 1, height=4.6, sharex=True)
    for name, high, low in zip(names, above, below, strict=True):
        upper.loglog(hertz, high, linewidth=0.8, label=pictures.literal(name))
        lower.semilogx(hertz, low, linewidth=0.8)
    upper.legend()
    lower.set_xlabel("frequency (Hz)")
    return figure, upper, lower


def _rate(source: Path, arrays, arguments) -> float:
    stated = arguments.get("sample_rate")
    timed = any(is_time(name) and array.size > 1 for name, array in arrays.items())
    if stated is None and not timed and not any(array.size == 1 for array in arrays.values()):
        raise Missing(
            "sample_rate", f"{source.name} holds neither time nor sample rate; the rate in Hz", "HZ"
        )
    return sampling_rate(source.name, arrays, stated)
