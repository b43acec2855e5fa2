"""The command ``desk``: one page on which you shape a loop by hand on a measurement, in any browser, offline."""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from stillwork.base.checks import InputError, require_number
from stillwork.control.uncertainty import NAMES, uncertainty_of
from stillwork.identification.frequency_response import Identified
from stillwork.identification.machine import Machine, build_machine, measured_band, remove_delay, whole_band
from stillwork.identification.machine_files import load_machine
from stillwork.lti.modal import ModalModel
from stillwork.machine.desk_page import offline_page
from stillwork.machine.html_page import require_new
from stillwork.machine.machine_designs import UNCERTAINTY, stated_uncertainty
from stillwork.machine.readings import believed

MOST_LINES = 2000  # of a measurement that a page holds
NEAR = 12.0  # half widths either side of a resonance, within which every line is kept
DIGITS = 7  # of a measured number
EXAMPLE = ModalModel(
    np.array([0.0, 565.0, 1320.0]),
    np.array([0.0, 0.01, 0.01]),
    np.array([[1.0], [0.7], [0.8]]) / np.sqrt(10.0),
    np.array([[1.0, -0.5, 0.6]]) / np.sqrt(10.0),
    np.array([[0.0]]),
)  # 10 kg with resonances at 90 and 210 Hz


def desk_file(file: str = "", out: str = "", **options) -> list[str]:
    """Write the page for the machine in `file`, or for an example; returns the findings, one line each.

    If `out` ends in ``.json``, only the machine is written, which any such page opens. `options` are those of
    `machine_to_begin_with`.
    """
    target = require_new(out or f"{Path(file).name or 'desk'}.html")
    machine = machine_to_begin_with(file, **options)
    if target.suffix == ".json":
        text = json.dumps(machine, allow_nan=False) + "\n"
    else:
        text = offline_page([machine])
    target.write_text(text, encoding="utf-8")
    return [
        f"{machine['name']}: {'{mass:.4g} {mass_unit}'.format_map(machine) if machine['model'] else 'a measurement alone'}",
        *machine["notes"],
        f"written: {target}",
    ]


def machine_to_begin_with(
    file: str = "",
    *,
    rate: float = 0.0,
    delay: float = 1.0,
    fit_hz: tuple[float, float] = (0.0, 0.0),
    loop_hz: tuple[float, float] = (0.0, 0.0),
    uncertainty: str | Mapping[str, float] = "",
    **load_options,
) -> dict[str, Any]:
    """The page's data of the machine in `file`, or of an example, with rate and delay of the first design.

    The design begins with `rate` (Hz; 0: chosen from the resonances) and `delay` (samples); see `design.design_file` for
    `fit_hz`, `loop_hz`, `uncertainty` and the arguments in `load_options`.
    """
    require_number("rate", rate, at_least=0.0)
    require_number("delay", delay, at_least=0.0)
    asked = stated_uncertainty(uncertainty)
    if file:
        machine = read_machine(file, fit_hz=fit_hz, loop_hz=loop_hz, uncertainty=asked, **load_options)
    else:
        machine = entry(Machine((EXAMPLE,), 10.0, "an example of 10 kg"), asked)
    machine["start"] = {"delay_samples": delay} | ({"rate_hz": rate} if rate else {})
    return machine


def read_machine(
    file: str | Path,
    *,
    fit_hz: tuple[float, float] = (0.0, 0.0),
    loop_hz: tuple[float, float] = (0.0, 0.0),
    uncertainty: Mapping[str, float] = UNCERTAINTY,
    **load_options,
) -> dict[str, Any]:
    """The page's data of the machine in a file, see `entry`; without a model if none can be fitted to the measurement."""
    taken = load_machine(file, **load_options)
    try:
        machine = build_machine(taken, modes_hz=[], fit_hz=fit_hz)
    except InputError as error:
        if taken.accelerance is None:
            raise
        return _measured_alone(taken, str(error), loop_hz, uncertainty)
    print(believed(taken, machine), file=sys.stderr, flush=True)
    return entry(machine, uncertainty, loop_hz)


def entry(
    machine: Machine, uncertainty: Mapping[str, float], loop_hz: tuple[float, float] = (0.0, 0.0)
) -> dict[str, Any]:
    """A machine as input of the page's modules: model, box, and the measurement with its delay removed."""
    model, fit = machine.sensors[0], machine.fit
    spread = uncertainty_of(machine, uncertainty)
    found: dict[str, Any] = {
        "name": machine.source,
        "units": dict(zip(("position", "drive"), machine.units, strict=True)),
        "mass": machine.mass,
        "mass_unit": machine.mass_unit,
        "notes": list(machine.notes),
        "delay_s": max(fit.delay, 0.0) if fit else 0.0,
        "model": {
            "omega": model.frequencies.tolist(),
            "damping": model.damping.tolist(),
            "input": model.input_shapes[:, 0].tolist(),
            "output": model.output_shapes[0].tolist(),
            "feedthrough": float(model.feedthrough[0, 0]),
            "drag": model.drag,
            "uncertainty": {name: np.asarray(getattr(spread, name)).tolist() for name in NAMES},
        },
        "measured": None,
        "band_hz": None,
    }
    if fit is not None and fit.phased is not None:
        found["notes"].append(
            "the box of this page ignores these phases: check your controller with `design`"
        )
    if machine.measured is not None and fit is not None:
        measured = remove_delay(machine, fit.delay).measured
        band = measured_band(machine, loop_hz)
        widths = model.damping * model.frequencies / (2 * np.pi)
        found["measured"] = _lines(measured, band, model.frequencies / (2 * np.pi), widths)
        found["band_hz"] = list(band)
    return found


def _measured_alone(taken, reason, loop_hz, uncertainty) -> dict[str, Any]:
    """A measurement without a model; the page itself estimates its mass and extends it below its first line."""
    band = whole_band(taken.accelerance, loop_hz)
    return {
        "name": taken.source,
        "units": dict(zip(("position", "drive"), taken.units, strict=True)),
        "notes": [*taken.notes, f"no model was fitted: {reason}"],
        "delay_s": 0.0,
        "model": None,
        "measured": _lines(taken.accelerance, band, np.zeros(0), np.zeros(0)),
        "band_hz": list(band),
        "uncertainty": {name: uncertainty.get(name, 0.0) for name in ("gain", "delay")},
    }


def _lines(measured: Identified, band_hz, resonances_hz, widths_hz) -> dict[str, list[float]]:
    """The measured lines of a band: all near a resonance, the others thinned to logarithmic spacing."""
    hertz = measured.omega / (2 * np.pi)
    inside = np.flatnonzero((hertz >= band_hz[0]) & (hertz <= band_hz[1]))
    if len(inside) > MOST_LINES:
        near = np.zeros(len(hertz), bool)
        for centre, width in zip(resonances_hz, widths_hz, strict=True):
            near |= np.abs(hertz - centre) <= NEAR * width
        near = inside[near[inside]]
        near = near[:: 1 + 2 * len(near) // MOST_LINES]
        wanted = np.geomspace(hertz[inside[0]], hertz[inside[-1]], MOST_LINES - len(near))
        inside = np.union1d(near, inside[np.searchsorted(hertz[inside], wanted).clip(0, len(inside) - 1)])
    response = measured.response[inside]
    columns = {"hz": hertz[inside], "re": response.real, "im": response.imag}
    return {name: [float(f"{x:.{DIGITS}g}") for x in values] for name, values in columns.items()}
