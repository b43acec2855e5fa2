"""The command ``design``: from a file of a machine to a controller that runs on it, and one page that says why."""

import hashlib
import html
import json
from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np

import stillwork
from stillwork.base.checks import InputError, require_choice, require_number
from stillwork.control.bandwidth import FUNCTIONS, SIX_DB, Loop, PeakConstraint
from stillwork.control.c_code import controller_code, require_names
from stillwork.control.digital import (
    DigitalController,
    equivalent_biquads,
    error_driven,
    from_biquads,
    in_units,
    runnable,
)
from stillwork.control.feedforward import motion_of
from stillwork.control.loop_enclosures import proven_peaks
from stillwork.control.machine_loops import SHOWN, Intensities, Reached, applications, reach, search_range
from stillwork.control.machine_tuning import DesignSettings, tuned
from stillwork.control.uncertainty import NAMES, Uncertainty, make_box, uncertainty_of
from stillwork.exporting import require_free, write_folder
from stillwork.html_page import page, picture, table
from stillwork.identification.machine import Machine, brought_forward, build_machine
from stillwork.identification.machine_files import load_machine
from stillwork.identification.modal_fit import ModalFit
from stillwork.lti.modal import ModalModel
from stillwork.workbook import figures

# What the observer is made for where nothing is known: accelerations and noise of a machine that moves by nanometres.
INTENSITIES = Intensities(disturbance=8e-4, sensor=1.41e-9, drift=1.92e-4)
ADDED_DAMPING, SELECTIVITY, RETAINED = 0.02, 2.0, 5
ALLOWED_DB = 6.01  # of a loop that is handed out; the search keeps 6 dB
NOTCHED = "PID with notches"
UNCERTAINTY = {"frequency": 0.05, "gain": 0.05}  # of a machine of which nothing else is said
SHOWN_FROM = 0.01  # %, of what the box holds
WORTH = 0.01  # relative gain of bandwidth below which a change of the machine is none


def design_file(
    file: str,
    folder: str,
    rate: float,
    *,
    delay: float = 1.0,
    limit: float = np.inf,
    name: str = "controller",
    precision: str = "double",
    fit_hz: tuple[float, float] = (0.0, 0.0),
    loop_hz: tuple[float, float] = (0.0, 0.0),
    mirrored_sensor: bool = False,
    uncertainty: str | Mapping[str, float] = "",
    counts: float = 0.0,
    motor_constant: float = 0.0,
    **reading,
) -> list[str]:
    """Design a controller for the machine in `file` and write it, in C and otherwise, into a new folder.

    Parameters
    ----------
    file, folder : str
        See `load_machine`; the folder is new or empty.
    rate : float
        Samples a second of the controller, Hz.
    delay : float
        Samples from a measurement to the force that follows from it, whole or not, beside the hold and beside a delay
        that the measured response itself holds, which is found and added as it is.
    limit : float
        Largest output of the controller: force in N, torque in N m, or current in A.
    name, precision : str
        See `controller_code`. Of several sensors each gets a controller, with its number behind the name.
    fit_hz : tuple of float
        Band of the fit of a measurement; (0, 0): all of it.
    loop_hz : tuple of float
        Band in which the measurement stands for the plant, where it can be trusted; (0, 0): that of the fit.
    mirrored_sensor : bool
        Serve a second sensor, too, at which every flexible mode has the other sign.
    uncertainty : str or mapping of str to float
        How far the machine may be from what was found, e.g. ``frequency=0.05,gain=0.1``: shares of ``frequency``,
        ``residue`` and ``damping`` of each mode, of ``gain`` and ``mass``, and ``delay`` in s. What is not named is
        that of `UNCERTAINTY`, or nothing after ``none``. The intervals of a fit come on top. Every constraint holds
        all over that box; see `reach`.
    counts : float
        Encoder counts of a unit of the position, m or rad: the controller then reads r and y in counts. 0: it reads the
        unit itself.
    motor_constant : float
        N/A or N m/A: the controller then sets a current, A. 0: it sets what drives the machine in the file.
    **reading
        Other arguments of `load_machine`.

    Returns
    -------
    list of str
        What was found, a line each.

    Raises
    ------
    InputError
        When the file cannot be used, no use of an observer has a safe loop, or something stands in the folder.
    """
    require_free(folder)
    require_names(name, precision)
    if limit != np.inf:
        require_number("limit", limit, above=0.0)
    sample_time = 1 / require_number("rate", rate, above=0.0)
    for each, value in (("counts", counts), ("motor_constant", motor_constant)):
        require_number(each, value, at_least=0.0)
    delay = require_number("delay", delay, at_least=0.0)
    uncertainty = asked_uncertainty(uncertainty)
    source = Path(file)
    taken = load_machine(source, **reading)
    position, drive = taken.units
    if counts and position == "count":
        raise InputError(f"{source.name} is in counts already; leave counts out")
    if motor_constant and drive not in ("N", "N m"):
        raise InputError(
            f"{source.name} is driven in {drive}; a motor_constant is for N or N m, leave it out"
        )
    own_units = "count" if counts else position, "A" if motor_constant else drive
    scales = counts or 1.0, 1 / motor_constant if motor_constant else 1.0
    machine = build_machine(taken, modes_hz=[], fit_hz=fit_hz, mirrored_sensor=mirrored_sensor)
    lowest, resonance = search_range(machine, 0.0)[0], float(machine.resonances_hz[0])
    # Bandwidths are sought to a tenth of the rate; a mode's part in the coefficients is the square of its angle a sample.
    require_number("rate", rate, above=10 * lowest, at_most=resonance / np.sqrt(np.finfo(float).eps))
    if delay * sample_time * lowest >= 1:
        raise InputError(
            f"delay is {delay:g}, a period of the lowest bandwidth ({lowest:.3g} Hz) or more; give fewer samples"
        )
    if (
        machine.fit
    ):  # what is early is no part of a machine: the measurement is only made to agree with the model
        machine = brought_forward(machine, machine.fit.delay)
        delay += max(machine.fit.delay, 0.0) / sample_time
    spread = uncertainty_of(machine, uncertainty)
    how = {"uncertainty": uncertainty, "sample_time": sample_time, "delay": delay}
    settings, found = {}, {}
    for use, application in ({"PID": None, NOTCHED: None} | applications(ADDED_DAMPING, SELECTIVITY)).items():
        first = DesignSettings(application, RETAINED, INTENSITIES, use == NOTCHED)
        settings[use], found[use] = _furthest(machine, first, how, loop_hz)
    safe = {use: each for use, each in found.items() if each.recommended is not None}
    if not safe:
        reasons = "; ".join(
            f"{use}: {each.reason or 'unstable on the measurement'}" for use, each in found.items()
        )
        raise InputError(
            f"{source.name}: no safe loop at {rate:g} Hz ({reasons}); sample faster or add damping"
        )
    # In the order of the uses, so that of equals the simplest is taken.
    best = max(safe, key=lambda use: round(_crossing(safe[use]), 2))
    pid, loops = safe[best].recommended.controller, safe[best].model_loops
    about = {
        "gains": asdict(pid),
        "units": f"input {own_units[0]}, output {own_units[1]}; gain {drive}/{position}, integrator, differentiator and "
        "low_pass rad/s",
        "provenance": {
            "made_by": f"stillwork {stillwork.__version__} design",
            "file": source.name,
            "sha256": hashlib.sha256(source.read_bytes()).hexdigest(),
            "machine": taken.kind,
            "notes": list(machine.notes),
            "mass": machine.mass,
            "mass_unit": machine.mass_unit,
            "encoder_counts": counts or None,
            "motor_constant": motor_constant or None,
            "resonances_hz": machine.resonances_hz.tolist(),
            "use": best,
            "settings": asdict(settings[best]),
            "uncertainty": {name: np.asarray(getattr(spread, name)).tolist() for name in NAMES},
            "delay_samples_of_the_loop": delay,
            "design_hz": safe[best].recommended.design_hz,
        },
    }
    controllers = [runnable(pid, loop.compensator, limit / scales[1], about, taken.units) for loop in loops]
    peaks = recheck(safe[best], controllers)
    worst = max(size for each in peaks.values() for size in each.values())
    if worst > ALLOWED_DB:
        raise InputError(f"{source.name}: the sampled controller peaks at {worst:.2f} dB; sample faster")
    margins = over_the_box(safe[best], spread)
    if margins and (worst := 20 * np.log10(max(margins.values()))) > ALLOWED_DB:
        raise InputError(
            f"{source.name}: somewhere in the box a peak of {worst:.2f} dB was found at last; ask for a little more uncertainty"
        )
    helps = improvements(machine, settings[best], how, safe[best])
    lag = (delay + 0.5) * sample_time  # the hold's half a sample
    own = [each if own_units == taken.units else in_units(each, *scales, own_units) for each in controllers]
    # Of the error: with the feedforward it is (A.7), and without the error under the reference is S_O.
    written = [
        error_driven(each, motion_of(sensor, lag, *scales))
        for each, sensor in zip(own, machine.sensors, strict=True)
    ]
    written = [
        replace(each, about=about | {"biquads": checked_biquads(each, loop, *scales)})
        for each, loop in zip(written, loops, strict=True)
    ]
    files = {}
    for number, controller in enumerate(written, 1):
        own = name if len(written) == 1 else f"{name}_{number}"
        files[f"{own}.json"] = json.dumps(controller.as_dict(), indent=1, allow_nan=False) + "\n"
        files |= controller_code(controller, own, precision)
    rates = f"{rate:g} Hz", f"{delay:.4g} samples ({1e6 * delay / rate:.4g} us) and the hold"
    most = f"{limit:g} {own_units[1]}" if np.isfinite(limit) else "none: give --limit"
    facts = [*zip(("rate", "delay of the loop", "limit of the output"), (*rates, most), strict=True)]
    if own_units != taken.units:
        facts.append(("the controller's own units", f"{own_units[0]} in, {own_units[1]} out"))
    pages = machine, found, best, controllers, peaks, helps, box_table(machine, spread, margins), facts
    files["report.html"] = report(*pages, sorted(files))
    write_folder(folder, files)
    rows = {
        use: ", ".join(f"{key} {value}" for key, value in each.summary.items()) for use, each in found.items()
    }
    return [
        f"{machine.source}: {taken.kind}; {machine.mass:.4g} {machine.mass_unit}; first resonance at {machine.resonances_hz[0]:.4g} Hz",
        *machine.notes,
        *(f"{use}: {row}{found[use].reason and '; ' + found[use].reason}" for use, row in rows.items()),
        proven_peaks((*loops, *safe[best].perturbed), pid, [each.model for each in controllers]),
        f"taken: {best}, stopped by {safe[best].summary['stopped by']}",
        f"the promise holds for {'; '.join(map(' '.join, box_table(machine, spread, margins)))}",
        f"what would help most: {'; '.join(' '.join(row) + ' Hz' for row in helps[:2]) or 'nothing that was tried'}",
        f"{folder}: {', '.join(sorted(files))}",
    ]


def asked_uncertainty(said: str | Mapping[str, float]) -> dict[str, float]:
    """Shares by `NAMES`: those of `UNCERTAINTY`, and what is said; ``none``: nothing but what is said."""
    if not isinstance(said, str):
        named = dict(said)
    else:
        words = [each.strip() for each in said.split(",") if each.strip()]
        named = {}
        for word in words:
            name, _, value = word.partition("=")
            if word == "none":
                continue
            try:
                named[name.strip()] = float(value)
            except ValueError:
                raise InputError(
                    f"uncertainty holds {word!r}; give NAME=SHARE of {', '.join(NAMES)}, commas between, or none"
                ) from None
        if "none" not in words:
            named = UNCERTAINTY | named
    for name, value in named.items():
        require_choice("uncertainty", name, NAMES)
        below = {} if name == "delay" else {"below": 1.0}
        require_number(f"uncertainty: {name}", value, at_least=0.0, **below)
    return {name: value for name, value in named.items() if value}


def over_the_box(reached: Reached, spread: Uncertainty) -> dict[str, float]:
    """Largest magnitude of each loop function all over the box, by another search than the design's: more starts."""
    if spread.is_empty:
        return {}
    pid = reached.recommended.controller
    constraints = [PeakConstraint(name) for name in FUNCTIONS]
    sizes = [
        [size for size, _ in make_box(loop, spread).worst(loop, pid, constraints, every=True, starts=24)]
        for loop in reached.model_loops
    ]
    return dict(zip(FUNCTIONS, np.max(sizes, axis=0).tolist(), strict=True))


def box_table(machine: Machine, spread: Uncertainty, margins: dict[str, float]) -> list[list[str]]:
    """What the box holds and what is left over it, in words."""
    rows = []
    hertz = machine.sensors[0].frequencies / (2 * np.pi)
    words = {"frequency": "resonances", "residue": "parts of the modes", "damping": "damping ratios"}
    for name, title in words.items():
        shares = 100 * np.asarray(getattr(spread, name))[1:]
        if np.any(shares >= SHOWN_FROM):
            same = np.ptp(shares) < 0.05 * shares.max()
            each = [f"± {share:.2g} % at {at:.4g} Hz" for share, at in zip(shares, hertz[1:], strict=True)]
            rows.append([title, f"± {shares.max():.3g} %" if same else ", ".join(each)])
    for name, title in (("gain", "gain, motor constant"), ("mass", "mass")):
        if (share := 100 * getattr(spread, name)) >= SHOWN_FROM:
            rows.append([title, f"± {share:.2g} %"])
    if spread.delay > 1e-9:
        rows.append(["delay", f"± {1e6 * spread.delay:.2g} us"])
    if margins:
        largest = max(margins["input_sensitivity"], margins["output_sensitivity"])
        sizes = ", ".join(f"{SHOWN[name]} {20 * np.log10(size):.2f} dB" for name, size in margins.items())
        rows.append(["largest over all of it", f"{sizes}; modulus margin {1 / largest:.3f}"])
    return rows


def _reached(machine: Machine, settings: DesignSettings, how: dict) -> Reached:
    own = {each.name: getattr(settings, each.name) for each in fields(settings) if each.name != "application"}
    return reach(machine, {"": settings.application}, **own, **how)[""]


def _furthest(
    machine: Machine, settings: DesignSettings, how: dict, loop_hz: tuple[float, float]
) -> tuple[DesignSettings, Reached]:
    """The settings, tuned where that leads further, and how far they get."""
    found = _reached(machine, settings, how | {"loop_hz": loop_hz})
    lowest, _ = search_range(machine, how["sample_time"])
    trial = tuned(machine, settings, found.recommended.design_hz if found.recommended else lowest, **how)
    further = found if trial == settings else _reached(machine, trial, how | {"loop_hz": loop_hz})
    if further.recommended is None or _crossing(further) <= _crossing(found):
        return settings, found
    return trial, further


def _crossing(reached: Reached) -> float:
    return float(reached.recommended.crossing_hz.min()) if reached.recommended else 0.0


def improvements(machine: Machine, settings: DesignSettings, how: dict, reached: Reached) -> list[list[str]]:
    """Changes of the machine that raise the bandwidth of the same settings on the model, and to what, the best first."""

    def changed(change) -> Machine:
        return replace(machine, measured=None, fit=None, sensors=tuple(map(change, machine.sensors)))

    def damped(model: ModalModel) -> ModalModel:
        factor = np.append(1.0, np.full(len(model.damping) - 1, 2.0))
        return replace(model, damping=np.minimum(factor * model.damping, np.maximum(model.damping, 0.5)))

    def beside(model: ModalModel) -> ModalModel:
        shapes = np.abs(model.output_shapes) * np.sign(model.input_shapes.T)
        return replace(model, output_shapes=shapes, feedthrough=np.abs(model.feedthrough))

    trials = {
        "twice the damping of its modes:": (changed(damped), how),
        "the sensor where the force acts:": (changed(beside), how),
        "twice the rate:": (changed(lambda model: model), how | {"sample_time": how["sample_time"] / 2}),
        "no delay:": (changed(lambda model: model), how | {"delay": 0}),
    }
    if not how["delay"]:
        del trials["no delay:"]
    before = reached.on_model.crossing_hz.min() if reached.on_model else 0.0
    gains = []
    for words, (other, changes) in trials.items():
        found = _reached(other, settings, changes).on_model
        if found is not None and found.crossing_hz.min() > (1 + WORTH) * before:
            gains.append([float(found.crossing_hz.min()), words])
    return [[words, f"{hertz:.1f}"] for hertz, words in sorted(gains, key=lambda each: -each[0])]


def recheck(reached: Reached, controllers: list[DigitalController]) -> dict[str, dict[str, float]]:
    """Largest peaks in dB of the controllers' own numbers, by function and by loops: all that the search looked at."""
    looked = {"on the model (dB)": reached.model_loops}
    if reached.perturbed:
        looked["at the worst places of the box (dB)"] = reached.perturbed
    if reached.loops is not reached.model_loops:
        looked["on the measurement (dB)"] = reached.loops
    found: dict[str, dict[str, float]] = {name: {} for name in FUNCTIONS}
    for where, loops in looked.items():
        pairs = [(loop, controllers[k % len(controllers)]) for k, loop in enumerate(loops)]
        peaks = np.max([np.abs(own_functions(*pair)).max(axis=1) for pair in pairs], axis=0)
        for name, size in zip(FUNCTIONS, peaks, strict=True):
            found[name][where] = float(20 * np.log10(size))
    return found


def checked_biquads(
    controller: DigitalController, loop: Loop, position: float = 1.0, drive: float = 1.0
) -> dict | None:
    """The sections of the whole controller as its file holds them; None unless they alone stabilise the model.

    A unit of the loop's position and of its force hold so many of the controller's.
    """
    found = equivalent_biquads(controller)
    if found is None:
        return None
    own = from_biquads(found.feedback, loop.sample_time)
    plant = loop.sampled_plant
    into, out = plant.b / drive, plant.c * position
    a = np.block([[plant.a - into @ own.d @ out, into @ own.c], [-own.b @ out, own.a]])
    radius = float(np.abs(np.linalg.eigvals(a)).max())
    if radius >= 1:
        return None
    return {
        "law": "f = feedback(r - y) + reference(r), without limits; null: nothing is added",
        "feedback": found.feedback.tolist(),
        "reference": None if found.reference is None else found.reference.tolist(),
        "relative_error": found.error,
        "spectral_radius_with_the_model": radius,
    }


def own_functions(loop: Loop, controller: DigitalController) -> np.ndarray:
    """S_I, S_O and r to e_true with a controller's own matrices, on the loop's grid: shape (3, frequencies)."""
    k_r, k_y, k_f = controller.model.frequency_response(loop.omega)[0]
    (o_uu, o_uy), _ = loop.compensator_response
    plant = loop.plant_response
    turn = 1 - k_f - k_y * plant  # f = K_r r + K_y y + K_f f + u_ff
    return np.array([1 - o_uu - o_uy * plant, 1 - k_f, turn - plant * k_r]) / turn


def report(
    machine: Machine,
    found: dict[str, Reached],
    best: str,
    controllers: list[DigitalController],
    peaks: dict[str, dict[str, float]],
    helps: list[list[str]],
    box: list[list[str]],
    about: list[tuple[str, str]],
    files: list[str],
) -> str:
    """One page: the machine, how far each use of an observer gets, what was taken, its peaks, and how to run it."""
    reached = found[best]
    where = list(next(iter(peaks.values())))
    sizes = [[SHOWN[name], *(f"{each[column]:.2f}" for column in where)] for name, each in peaks.items()]
    facts = [
        ["mass" if machine.units[0] == "m" else "inertia", f"{machine.mass:.4g} {machine.mass_unit}"],
        ["resonances", ", ".join(f"{hertz:.4g}" for hertz in machine.resonances_hz) + " Hz"],
        *map(list, about),
        *(["note", note] for note in machine.notes),
    ]
    return page(
        "design.html",
        source=html.escape(machine.source),
        taken=html.escape(best),
        stopped=html.escape(reached.summary["stopped by"]),
        facts=table([], facts),
        box=table([], box or [["everything", "as the model has it: no uncertainty was asked for"]]),
        uses=uses_table(found),
        peaks=table(["peak", *where], sizes),
        helps=table(["change", "bandwidth (Hz)"], helps or [["nothing that was tried", ""]]),
        machine=picture(paint_machine(machine), "accelerance of the model and of the measurement"),
        loops=picture(
            paint_loops(reached, controllers), "sensitivities and true tracking of the sampled loop"
        ),
        files=html.escape(", ".join(files)),
    )


def uses_table(found: dict[str, Reached]) -> str:
    """How far each use of an observer gets, or why it gets nowhere."""
    columns = list(dict.fromkeys(key for each in found.values() for key in each.summary))
    rows = [
        [use, *(each.summary.get(key, "") for key in columns), each.reason] for use, each in found.items()
    ]
    return table(["use", *columns, "why none"], rows)


def paint_machine(machine: Machine):
    """Accelerance of the model at every sensor, and of the measurement at the first."""
    figure, axis = figures.new(1, 1, height=3.0)
    resonances = machine.resonances_hz
    hertz = np.unique(
        np.concatenate([np.geomspace(resonances[0] / 10, 2 * resonances[-1], 3000), resonances])
    )
    if machine.measured is not None:
        seen = machine.measured.omega / (2 * np.pi)
        shown = (seen >= hertz[0]) & (seen <= hertz[-1])
        size = 20 * np.log10(np.abs(machine.measured.response[shown]))
        axis.semilogx(seen[shown], size, linewidth=0.6, color=figures.GREY, label="measured, sensor 1")
    for number, sensor in enumerate(machine.sensors, 1):
        omega = 2 * np.pi * hertz
        size = 20 * np.log10(np.abs(omega**2 * sensor.frequency_response(omega)[0, 0]))
        axis.semilogx(hertz, size, linewidth=1.0, label=f"model, sensor {number}")
    axis.set(xlabel="frequency (Hz)", ylabel=f"acceleration over force (dB re 1/({machine.mass_unit}))")
    axis.legend()
    return figure


def paint_stabilisation(fit: ModalFit):
    """Poles over their orders: those that stay from order to order stand out, and those that were taken for modes."""
    diagram = fit.diagram
    figure, axis = figures.new(1, 1, height=3.0)
    for hertz in fit.model.frequencies[fit.model.rigid_modes :] / (2 * np.pi):
        axis.axvline(hertz, color=figures.RED, linewidth=0.8)
    for chosen, colour, label in (
        (~diagram.stable, figures.GREY, "moves"),
        (diagram.stable, figures.BLUE, "stays; red: a mode"),
    ):
        hertz = diagram.frequency[chosen] / (2 * np.pi)
        axis.semilogx(hertz, diagram.order[chosen], ".", markersize=2, color=colour, label=label)
    axis.set(xlabel="frequency (Hz)", ylabel="order")
    axis.legend()
    return figure


def paint_loops(reached: Reached, controllers: list[DigitalController]):
    """The three loop functions of every sensor with the controllers' own numbers, and what they may reach."""
    figure, axes = figures.new(1, 3, height=2.8, sharey=True)
    colours = (figures.RED, figures.BLUE, figures.GREEN, figures.ORANGE)
    for number, pair in enumerate(zip(reached.loops, controllers, strict=True)):
        hertz = pair[0].omega / (2 * np.pi)
        for axis, name, response in zip(axes, FUNCTIONS, own_functions(*pair), strict=True):
            axis.semilogx(hertz, 20 * np.log10(np.abs(response)), linewidth=0.8, color=colours[number % 4])
            axis.axhline(20 * np.log10(SIX_DB), color=figures.BLACK, linestyle=":", linewidth=1.0)
            axis.set(title=SHOWN[name], xlabel="frequency (Hz)", ylim=(-50, 15))
    axes[0].set_ylabel("magnitude (dB)")
    return figure
