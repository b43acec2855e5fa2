"""The command ``retest``: check a new response against what `design` promised, on one page."""

import html
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from stillwork.base.checks import InputError, pluralise
from stillwork.base.extras import require_package
from stillwork.base.toml_files import Table
from stillwork.control.bandwidth import SIX_DB, Loop, make_loop
from stillwork.control.digital import DigitalController, read_json
from stillwork.control.machine_loops import HELD, SHOWN, encirclement_difference, on_measurement
from stillwork.control.pid import Pid
from stillwork.control.uncertainty import NORMAL
from stillwork.identification.frequency_response import Identified
from stillwork.identification.machine import (
    TURNED,
    Machine,
    build_machine,
    measured_band,
    remove_delay,
    whole_band,
)
from stillwork.identification.machine_files import MachineFile, load_machine, load_ratio
from stillwork.identification.matrix_files import load_matrix
from stillwork.lti.modal import ModalModel
from stillwork.machine import pictures
from stillwork.machine.axes_loops import (
    FORMAT,
    LOWEST,
    UNCOUNTED,
    AxesLoops,
    Place,
    paint_axes,
    paint_decoupling,
)
from stillwork.machine.decoupled import own_sensitivities, turns
from stillwork.machine.designed_loop import DesignedLoop, load_design
from stillwork.machine.hardware import ALLOWED_DB, own_functions
from stillwork.machine.html_page import page, picture, require_new, table
from stillwork.machine.inspect import inspect_file
from stillwork.machine.noisy_peak import ABOUT, largest
from stillwork.machine.readings import believed

AROUND = 1.5  # the crossing: lines from which the gain of a machine in its loop is read
MEDIAN = (
    1.4826 * 1.2533
)  # deviation of a median of Gaussian numbers, over their median deviation by the root of how many
STRANGE = 5.0  # times the machine of the design, or less of it: another machine, or another quantity


CHANGED = ["", "at the design", "now", "change", ""]


class _Change(NamedTuple):
    """A number of the machine at the design and now, in words, and whether it is in the box; None: not sure."""

    what: str
    before: str
    now: str
    change: str
    inside: bool | None

    @property
    def row(self) -> list[str]:
        """For a table with the head `CHANGED`."""
        held = {True: "in the box", False: "outside the box", None: "not sure to be in the box"}
        return [*self[:-1], held[self.inside]]


def retest_file(
    controller: str,
    file: str,
    out: str = "",
    *,
    verbose: bool = False,
    closed_loop: bool = False,
    fit_hz: tuple[float, float] = (0.0, 0.0),
    loop_hz: tuple[float, float] = (0.0, 0.0),
    **load_options,
) -> list[str]:
    """Close the loop of a written controller around a new response, and report whether the promise of `design` holds.

    Parameters
    ----------
    controller : str
        JSON file that `design` wrote; ``axes.json`` is that of all axes of a matrix response.
    file : str
        New measurement of the machine, as for `design` and in the same units; see `load_machine`.
    out : str
        Path of the page, which must not exist; empty: the name of `file` with ``.retest.html``.
    verbose : bool
        Whether to return all findings, which are on the page.
    closed_loop : bool
        Whether `file` was measured in closed loop: the force on the machine over the force injected at the controller's
        output, both sampled as the controller samples. That is the output sensitivity; the machine follows from it and
        from the controller.
    fit_hz, loop_hz : tuple of float
        See `design_file`; in closed loop, `loop_hz` is the band that is judged.
    **load_options
        Other arguments of `load_machine`.

    Returns
    -------
    list of str
        The verdict, the peaks and where the page is, one line each; with `verbose` then the changes of the machine.

    Raises
    ------
    InputError
        When a file cannot be used, or the page exists.
    """
    require_package("matplotlib")
    target = require_new(out or f"{Path(file).name}.retest.html")
    about = read_json(controller)
    if about.get("format") == FORMAT:
        if closed_loop:
            raise InputError("closed_loop is for one axis; measure the matrix response of the machine")
        return _retest_axes(Path(controller), about, file, target, loop_hz, load_options, verbose)
    designed = load_design(controller)
    if closed_loop:
        found = _measured_in_the_loop(designed, file, loop_hz, load_options)
    else:
        found = _measured_machine(designed, file, fit_hz, loop_hz, load_options)
    peaks = {where: _peaks(loop, designed.controller) for where, loop in found.loops.items()}
    verdict = _verdict(found.stable and not found.turns, peaks)
    answer = [
        f"{Path(file).name} with {Path(controller).name}: {verdict}{_outside(found.changes)}",
        "; ".join(
            f"{where}: {', '.join(f'{SHOWN[name]} {peak}' for name, peak in each.items())}"
            for where, each in peaks.items()
        ),
    ]
    findings = [
        *([] if found.stable else ["the loop is unstable on the model of this response"]),
        *([f"extra turns around -1 on the measurement: {found.turns}"] if found.turns is not None else []),
        *(" ".join(each.row) for each in found.changes if not each.inside),
    ]
    target.write_text(_page(designed, found, file, [*answer, *findings]), encoding="utf-8")
    return [*answer, f"written: {target}", *(findings if verbose else [])]


def _retest_axes(
    controller: Path, about: Table, file: str, target: Path, loop_hz, load_options, verbose: bool
) -> list[str]:
    """As `retest_file`, of all axes at once around a new matrix response."""
    matrix = load_matrix(file, load_options.get("response_unit", ""), load_options.get("force_unit", ""))
    if matrix is None:
        raise InputError(f"{Path(file).name} holds no matrix response; give all entries of the design's")
    closed = AxesLoops.read(controller, about, matrix, loop_hz)
    omega, middle = closed.lines(), [Place(0.0, np.ones(len(matrix.inputs)))]
    (alone,), (gain,) = closed.alone(middle), closed.gains(middle)
    whole = np.eye(len(closed.loops)) + gain
    count, enough = turns(whole, alone)
    own = own_sensitivities(whole)
    peaks = {
        name: {"|S_kk|": _peak(omega, own[:, k], 1 / alone[:, k])} for k, name in enumerate(closed.names)
    }
    changes = _changed_axes(closed, about)
    stability = f"extra turns of det(I + L) around zero: {count}" if enough else UNCOUNTED
    verdict = _verdict(not count if enough else None, peaks)
    if (count or not enough) and (strange := _strange(gain, alone)):
        verdict = f"the promise does not hold: {strange}"
    answer = [
        f"{matrix.source} with {controller.name}: {verdict}{_outside(changes)}",
        "; ".join(f"{name} |S_kk| {each['|S_kk|']}" for name, each in peaks.items()),
    ]
    findings = [stability, closed.matrix.order, *matrix.notes]
    body = "".join(f"<p>{html.escape(line)}</p>\n" for line in [*answer, *findings])
    body += f"<h2>What has changed</h2>\n{table(CHANGED, [each.row for each in changes])}"
    body += picture(paint_decoupling(closed), "responses before and behind the decoupling")
    body += picture(paint_axes(closed), "sensitivities of all axes")
    held = html.escape(inspect_file(file))
    text = page("report.html", source=html.escape(matrix.source), body=body, held=held)
    target.write_text(text, encoding="utf-8")
    return [*answer, f"written: {target}", *(findings if verbose else [])]


def _strange(gain: np.ndarray, alone: np.ndarray) -> str:
    """Why a matrix is another than the design's: by the eigenvalues of what it is over the models of the axes at low lines.

    They are near 1 for the machine of the design. A negative one lets an integrator run away, and says that an order of
    inputs or outputs, or a sign, is another. Among the modes of soft springs they may be negative of the same machine:
    it is asked where the turns of det(I + L) do not show the loops stable.
    """
    ratio = (gain / (alone - 1)[:, None, :])[:LOWEST]
    middle = np.median(ratio.real, axis=0) + 1j * np.median(ratio.imag, axis=0)
    found, own = np.linalg.eigvals(middle), np.abs(np.diag(middle))
    if np.all(found.real > 0) and np.all((own < STRANGE) & (own > 1 / STRANGE)):
        return ""
    numbers = ", ".join(f"{each:.2g}" for each in np.sort(found.real))
    return (
        "another machine, or another order or sign of its inputs or outputs; at the lowest lines it is by directions "
        f"{numbers} times that of the design, and 1 is wanted; correct the file, or design again from it"
    )


def _changed_axes(closed: AxesLoops, about: Table) -> list[_Change]:
    """`_changes` of each axis, of the model that is fitted to its own entry of the new matrix."""
    omega, changes = 2 * np.pi * closed.matrix.hertz, []
    inner = closed.axes.of(closed.matrix.accelerance)
    for k, (named, designed) in enumerate(zip(about["axes"], closed.loops, strict=True)):
        seen = Identified(omega, inner[:, k, k], np.full(len(omega), np.nan))
        file = MachineFile("frequency response", closed.matrix.source, seen, units=tuple(named["units"]))
        try:
            machine = build_machine(file, modes_hz=[], fit_hz=closed.band_hz, rigid=True)
        except InputError as error:
            changes.append(_Change(f"{named['name']}: model", "", "none", str(error), False))
            continue
        late = max(machine.fit.delay, 0.0) if machine.fit else 0.0
        found = _changes(designed.loop.plant, machine, designed.made, late)
        if TURNED in machine.notes:
            found.append(_Change("sign", "along its force", "against it", "", False))
        changes += [each._replace(what=f"{named['name']}: {each.what}") for each in found]
    return changes


def _outside(changes: list[_Change]) -> str:
    """What is not in the box, behind a verdict."""
    outside = ", ".join(each.what for each in changes if not each.inside)
    return f"; not in the box: {outside}" if outside else ""


class _Found(NamedTuple):
    """The loop of a written controller around a new response."""

    loops: dict[str, Loop]  # on the model, on the measurement
    stable: bool
    turns: int | None  # around -1, that the measured loop makes more than that of the model
    changes: list[_Change]  # of the machine


def _measured_in_the_loop(designed: DesignedLoop, file: str, loop_hz, load_options: Mapping) -> _Found:
    seen = _from_sensitivity(designed.loop, designed.controller, file, loop_hz, load_options)
    changes = _gain_change(designed.loop, seen, designed.pid, designed.made, Path(file).name)
    return _Found({"measured": seen}, True, None, changes)  # it ran


def _measured_machine(designed: DesignedLoop, file: str, fit_hz, loop_hz, load_options: Mapping) -> _Found:
    made, sample_time = designed.made, designed.loop.sample_time
    taken = load_machine(file, **load_options)
    machine = build_machine(taken, modes_hz=[], fit_hz=fit_hz, rigid=True)
    print(believed(taken, machine), file=sys.stderr, flush=True)
    if machine.mass_unit != made["mass_unit"]:
        raise InputError(
            f"{Path(file).name} is of a machine in {machine.mass_unit}, the controller of one in {made['mass_unit']}; "
            "give the response in the units of the design"
        )
    if not 1 / STRANGE < machine.mass / made["mass"] < STRANGE:
        raise InputError(
            f"{Path(file).name} is of another machine or in another unit: it moves as {machine.mass:.4g} {machine.mass_unit}, that of "
            f"the design as {made['mass']:.4g} (read were {believed(taken, machine).partition('; ')[2]}); give response_unit and force_unit"
        )
    if (TURNED in machine.notes) != (TURNED in made.get("notes", [])):
        raise InputError(
            f"{Path(file).name} moves opposite to the machine of the design under the same force, and the written loop would run "
            "away; correct the sign of the file, or design again from it"
        )
    late = max(machine.fit.delay, 0.0) if machine.fit else 0.0
    modelled = make_loop(
        machine.sensors[0],
        designed.loop.compensator,
        sample_time=sample_time,
        delay=made["delay_samples_asked"] + late / sample_time,
    )
    loops, turns = {"model": modelled}, None
    if machine.measured is not None:
        machine = remove_delay(machine, machine.fit.delay)
        loops["measured"] = on_measurement(modelled, machine.measured, 1.0, measured_band(machine, loop_hz))
        turns = encirclement_difference(loops["measured"], designed.pid)
    changes = _changes(designed.loop.plant, machine, made, late)
    return _Found(loops, modelled.is_stable(designed.pid), turns, changes)


def _verdict(stable: bool | None, peaks: dict[str, dict[str, "Peak"]]) -> str:
    """By whether the loops are stable, None where that is not known, and by the limits of their peaks."""
    lowest, highest = np.max([peak.limits for each in peaks.values() for peak in each.values()], axis=0)
    if stable is False or lowest > ALLOWED_DB:
        return "the promise does not hold; design again from this response"
    if highest > ALLOWED_DB:
        return "not decided: at this noise the promise may hold or not; average longer near the peaks, or measure more lines"
    return "the promise holds" if stable else f"not decided: {UNCOUNTED}; measure finer"


def _page(designed: DesignedLoop, found: _Found, file: str, lines: list[str]) -> str:
    body = [f"<p>{html.escape(line)}</p>" for line in lines]
    if found.changes:
        body.append(f"<h2>What has changed</h2>\n{table(CHANGED, [each.row for each in found.changes])}")
    drawn = paint_retest(designed.loop, found.loops, designed.controller)
    body += [f"<h2>The loop</h2>\n{picture(drawn, 'sensitivities, at the design and now')}"]
    return page(
        "report.html",
        source=html.escape(Path(file).name),
        body="\n".join(body),
        held=html.escape(inspect_file(file)),
    )


def _from_sensitivity(
    before: Loop,
    controller: DigitalController,
    file: str,
    loop_hz: tuple[float, float],
    load_options: Mapping,
) -> Loop:
    """The loop with the plant that follows from a measured output sensitivity S: S = 1 / (1 - K P)."""
    ratio = load_ratio(file, response=load_options.get("response", ""))
    low, high = whole_band(ratio, loop_hz)
    inside = (ratio.omega >= 2 * np.pi * low) & (ratio.omega <= 2 * np.pi * high)
    inside &= ratio.omega < np.pi / before.sample_time
    seen = Identified(*(each[inside] for each in ratio))
    if len(seen.omega) and np.abs(seen.response).max() < 0.5:
        raise InputError(
            f"{Path(file).name} stays below {np.abs(seen.response).max():.2g}, but an output sensitivity reaches 1; give "
            "the force on the machine over the injected one, to above the crossover frequency"
        )
    if len(seen.omega) < ABOUT:
        raise InputError(
            f"{Path(file).name} holds {pluralise(len(seen.omega), 'line')} below half the controller's rate, too few to "
            f"separate noise from response; give {ABOUT} or more"
        )
    _, k_y, k_f = controller.model.frequency_response(seen.omega)[0]
    return replace(
        before,
        omega=seen.omega,
        plant_response=(1 - 1 / seen.response) * (1 - k_f) / k_y,
        compensator_response=before.compensator.frequency_response(seen.omega),
    )


def _gain_change(before: Loop, seen: Loop, pid: Pid, made: Table, name: str) -> list[_Change]:
    """The machine that follows from a measured sensitivity over that of the design, about the crossing."""
    crossing = before.crossing_hz(pid)
    near = np.abs(np.log(seen.omega / (2 * np.pi * crossing))) < np.log(AROUND)
    if not near.any():
        raise InputError(
            f"{name} holds no line from {crossing / AROUND:.3g} to {crossing * AROUND:.3g} Hz, near the loop's crossover; "
            "measure there, or widen loop_hz"
        )
    ratios = seen.plant_response[near] / before.plant_at(seen.omega[near])
    ratio = complex(np.median(ratios.real), np.median(ratios.imag))
    if abs(np.angle(ratio)) > np.pi / 4 or not 1 / STRANGE < abs(ratio) < STRANGE:
        raise InputError(
            f"{name} is of another machine, or no output sensitivity: near the crossover at {crossing:.3g} Hz the machine "
            f"that follows from it has {abs(ratio):.3g} times the gain of the design and its phase is off by "
            f"{np.degrees(np.angle(ratio)):.0f} degrees; give the force on the machine over the injected one"
        )
    # Of a median of independent lines, by the median of what they deviate along it.
    along = (ratios / ratio).real
    spread = (
        NORMAL * abs(ratio) * MEDIAN * float(np.median(np.abs(along - np.median(along)))) / len(along) ** 0.5
    )
    change, box = abs(ratio) - 1, made.table("uncertainty")
    share = box["mass"] + box["gain"]
    held = True if abs(change) + spread <= share else None
    held = False if abs(change) - spread > share else held
    shown = f"{100 * change:+.2g}{f' ± {100 * spread:.2g}' * (spread > 1e-5)} %"
    return [_Change(f"gain near {crossing:.3g} Hz", "1", f"{abs(ratio):.4g}", shown, held)]


def _changes(designed: ModalModel, machine: Machine, made: Table, late: float) -> list[_Change]:
    """Each resonance and the nearest that was found, the rigid body, the delay."""
    now, box = machine.sensors[0], made.table("uncertainty")
    masses = made["mass"], machine.mass
    found, parts = [], [model.input_shapes[:, 0] * model.output_shapes[0] for model in (designed, now)]
    spread = np.zeros(len(now.frequencies))
    if machine.fit and machine.fit.residue_deviation.size:
        spread = NORMAL * machine.fit.residue_deviation[1 - now.rigid_modes :]
    frequency, residue = (
        np.broadcast_to(box[name], designed.frequencies.shape) for name in ("frequency", "residue")
    )
    for k in range(1, len(designed.frequencies)):
        then = designed.frequencies[k]
        hertz = then / (2 * np.pi)
        if len(now.frequencies) < 2:
            found.append(_Change("resonance", f"{hertz:.5g} Hz", "none", "", False))
            continue
        j = 1 + int(np.abs(np.log(now.frequencies[1:] / then)).argmin())
        before, after = [f"{each / (2 * np.pi):.5g} Hz" for each in (then, now.frequencies[j])]
        found.append(_relative("resonance", before, after, now.frequencies[j] / then - 1, frequency[k]))
        before, after = [f"{part[n] * mass:.3g}" for part, n, mass in zip(parts, (k, j), masses, strict=True)]
        share = residue[k] + box["gain"] + spread[j - 1] + 1e-6
        change = parts[1][j] / parts[0][k] - 1
        found.append(_relative(f"part of the mode at {hertz:.4g} Hz", before, after, change, share))
    before, after = [f"{each:.4g} {machine.mass_unit}" for each in masses]
    found.append(_relative("mass", before, after, masses[1] / masses[0] - 1, box["mass"] + box["gain"]))
    if designed.drag or now.drag:
        before, after = [f"{each:.3g} 1/s" for each in (designed.drag, now.drag)]
        change = now.drag - designed.drag
        held = abs(change) <= box.get("friction", 0.0) + 1e-9
        found.append(_Change("viscous friction over mass", before, after, f"{change:+.2g} 1/s", held))
    then = (made["delay_samples_of_the_loop"] - made["delay_samples_asked"]) / made["rate_hz"]
    before, after = [f"{1e6 * each:.3g} us" for each in (then, late)]
    held = abs(late - then) <= box["delay"] + 1e-9
    found.append(_Change("delay of the response", before, after, f"{1e6 * (late - then):+.2g} us", held))
    return found


def _relative(what: str, before: str, now: str, change: float, share: float) -> _Change:
    return _Change(what, before, now, f"{100 * change:+.2g} %", bool(abs(change) <= share))


class Peak(NamedTuple):
    """The largest magnitude of a function, dB, where, Hz, and between which limits it lies with 95 %, dB."""

    size: float
    hertz: float
    limits: tuple[float, float]

    def __str__(self) -> str:
        low, high = (f"{limit:.2f}" for limit in self.limits)
        about = "" if low == high else f" ({low} to {high})"
        return f"{self.size:.2f} dB{about} at {self.hertz:.4g} Hz"


def _peaks(loop: Loop, controller: DigitalController) -> dict[str, Peak]:
    """Of each function; a measured loop's is judged by what it is over that of its model, which noise alone roughens."""
    expected = replace(loop, plant_response=loop.plant_at(loop.omega))
    pairs = zip(HELD, own_functions(loop, controller), own_functions(expected, controller), strict=True)
    return {name: _peak(loop.omega, seen, modelled) for name, seen, modelled in pairs}


def _peak(omega: np.ndarray, seen: np.ndarray, modelled: np.ndarray) -> Peak:
    """The largest magnitude of a measured function, by what it is over that of its model."""
    place, *sizes = largest(omega, seen, modelled)
    size, low, high = 20 * np.log10(sizes)
    return Peak(float(size), float(omega[place] / (2 * np.pi)), (float(low), float(high)))


@pictures.house_style()
def paint_retest(before: Loop, loops: Mapping[str, Loop], controller: DigitalController):
    """Both sensitivities of the design on its model, and on the new response."""
    figure, axes = pictures.new(1, 2, height=2.8, sharey=True)
    shown = {"designed": before, **loops}
    colours = (pictures.GREY, pictures.BLUE, pictures.RED)
    for (where, loop), colour in zip(shown.items(), colours, strict=False):
        for axis, name, response in zip(axes, HELD, own_functions(loop, controller), strict=True):
            hertz = loop.omega / (2 * np.pi)
            axis.semilogx(hertz, 20 * np.log10(np.abs(response)), linewidth=0.8, color=colour, label=where)
            axis.axhline(20 * np.log10(SIX_DB), color=pictures.BLACK, linestyle=":", linewidth=1.0)
            axis.set(title=SHOWN[name], xlabel="frequency (Hz)", ylim=(-50, 15))
    axes[0].set_ylabel("magnitude (dB)")
    axes[0].legend()
    return figure
