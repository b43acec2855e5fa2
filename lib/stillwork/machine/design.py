"""The command ``design``: from the file of a machine to a controller in C, and one page with the reasons."""

import hashlib
import html
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

import stillwork
from stillwork.base.checks import InputError, one_line, pluralise, require_number
from stillwork.base.extras import require_package
from stillwork.control.bandwidth import SIX_DB, Loop
from stillwork.control.digital import (
    DigitalController,
    equivalent_biquads,
    error_driven,
    from_biquads,
    in_units,
    runnable,
    tied_to_error,
)
from stillwork.control.feedforward import motion_of
from stillwork.control.loop_noise import SHARE
from stillwork.control.machine_loops import (
    HELD,
    OF_ERROR,
    SHOWN,
    AchievableBandwidth,
    encirclement_difference,
    search_range,
)
from stillwork.control.phased_loops import phased_loops, phased_places
from stillwork.control.setpoint import MoveLimits
from stillwork.control.uncertainty import NAMES, Uncertainty, make_box
from stillwork.identification.machine import TURNED, Machine
from stillwork.identification.machine_files import load_machine
from stillwork.identification.modal_fit import ModalFit
from stillwork.lti.modal import ModalModel
from stillwork.machine import pictures
from stillwork.machine.c_code import controller_code, require_names
from stillwork.machine.export import require_free, write_folder
from stillwork.machine.hardware import (
    ALLOWED_DB,
    noise_rows,
    own_functions,
    peak_with,
    section_response,
    sensor_noise,
    single_rows,
)
from stillwork.machine.html_page import page, picture, table
from stillwork.machine.loop_margins import computed_numbers
from stillwork.machine.machine_designs import (
    DELAY,
    EACH,
    Designed,
    reach_one,
    search_designs,
    stated_uncertainty,
)
from stillwork.machine.machine_tuning import DesignSettings
from stillwork.machine.progress import count_steps
from stillwork.machine.readings import build_explained

MOST_LATE = 20  # samples either way, of a delay's uncertainty
USES = 5  # that are searched
CHANGES = 4  # of the machine or its processor, of which each is tried for what it would help
SHOWN_FROM = 0.01  # %, of what the box holds
WITHOUT_BIQUADS = (
    "left out: written as biquads, the controller would exceed 6 dB or not stabilise the model on its own"
)
WORTH = 0.01  # relative gain in bandwidth below which a change of the machine is not listed


def design_file(
    files: str | Sequence[str],
    folder: str,
    rate: float,
    *,
    delay: float = DELAY,
    limit: float = np.inf,
    limits: Sequence[float] = (),
    name: str = "controller",
    precision: str = "double",
    fit_hz: tuple[float, float] = (0.0, 0.0),
    loop_hz: tuple[float, float] = (0.0, 0.0),
    mirrored_sensor: bool = False,
    uncertainty: str | Mapping[str, float] = "",
    counts: float = 0.0,
    motor_constant: float = 0.0,
    noise: float = 0.0,
    noise_share: float = SHARE,
    noise_ratio: float = 0.0,
    **load_options,
) -> list[str]:
    """Design a controller for the machine in `files` and write it, as C and as JSON, into a new folder.

    Parameters
    ----------
    files : str or sequence of str
        See `load_machine`. Several files hold the same machine at other positions or with other loads: the observer is
        made for the first; the constraints hold for all of them, and in the box around each.
    folder : str
        New or empty folder.
    rate : float
        Sample rate of the controller, Hz.
    delay : float
        See `search_designs`.
    limit : float
        Largest output of the controller: force in N, torque in N m, or current in A.
    limits : sequence of float
        Largest velocity, acceleration, jerk and optionally snap of the setpoint, in the unit of the controller's
        position; empty: they are set in the C code. Refused if the sum of the feedforward's terms could exceed `limit`.
    name, precision : str
        See `controller_code`. With several sensors each has its own controller, numbered behind the name.
    fit_hz : tuple of float
        Frequency band of the fit, Hz; (0, 0): the whole measurement.
    loop_hz : tuple of float
        Band in which the measurement is reliable and represents the plant, Hz; (0, 0): the band of the fit.
    mirrored_sensor : bool
        Whether to design for a second sensor, too, at which every flexible mode has the opposite sign.
    uncertainty : str or mapping of str to float
        How far the machine may deviate from the model, e.g. ``frequency=0.05,gain=0.1``: relative, for the
        ``frequency``, ``residue`` and ``damping`` of each mode and for ``gain`` and ``mass``; ``delay`` in s, and
        ``friction``, b/m, in 1/s. What is not named has the value of `UNCERTAINTY`, or is certain if ``none`` is named.
        Confidence intervals of the fit are added, that of the friction only if it is named. Every constraint holds
        everywhere in this box; see `reach`.
    counts : float
        Encoder counts per unit of position (m or rad): the controller then reads r and y in counts. 0: it reads the
        unit itself.
    motor_constant : float
        N/A or N m/A: the output of the controller is then a current, A. 0: it is the input of the machine in the file.
    noise : float
        Root mean square of the sensor's noise in one sample, white, in the unit of the controller's position. 0: the
        rounding to whole counts if there are counts, else unknown.
    noise_share : float
        Share of `limit` that the noise may take at the output, root mean square.
    noise_ratio : float
        See `NoiseBound`; 0: `RATIO` if the noise or the limit is unknown.
    **load_options
        Other arguments of `load_machine`.

    Returns
    -------
    list of str
        The findings, one line each.

    Raises
    ------
    MissingPackage
        When the page cannot be drawn, before anything is computed.
    InputError
        When the file cannot be used, no use of an observer has a safe loop, or the folder is not empty.
    """
    require_package("matplotlib")
    require_free(folder)
    require_names(name, precision)
    if limit != np.inf:
        require_number("limit", limit, above=0.0)
    moves = _move_limits(limits)
    require_number("rate", rate, above=0.0)
    asked = require_number("delay", delay, at_least=0.0)
    shares = stated_uncertainty(uncertainty)
    if shares.get("delay", 0.0) * rate > MOST_LATE:
        raise InputError(
            f"uncertainty: delay is {shares['delay']:g} s, {shares['delay'] * rate:.3g} samples at {rate:g} Hz, too much for any "
            f"loop; give seconds, at most {MOST_LATE} samples ({MOST_LATE / rate:.3g} s)"
        )
    for each, value in (("counts", counts), ("motor_constant", motor_constant)):
        require_number(each, value, at_least=0.0)
    sources = [Path(each) for each in ([files] if isinstance(files, str) else files)]
    if not sources:
        raise InputError("files is empty; name the file of a machine")
    source = sources[0]
    every = [load_machine(each, **load_options) for each in sources]
    taken = every[0]
    position, drive = taken.units
    if counts and position == "count":
        raise InputError(f"{source.name} is in counts already; leave counts out")
    if motor_constant and drive not in ("N", "N m"):
        raise InputError(
            f"{source.name} has its input in {drive}; motor_constant is for N or N m, leave it out"
        )
    own_units = "count" if counts else position, "A" if motor_constant else drive
    scales = counts or 1.0, 1 / motor_constant if motor_constant else 1.0
    sensor_spec = sensor_noise(own_units[0], limit, noise, noise_share, noise_ratio)
    machines = [
        build_explained(path, each, fit_hz=fit_hz, mirrored_sensor=mirrored_sensor, options=load_options)
        for path, each in zip(sources, every, strict=True)
    ]
    for sensor in machines[0].sensors:
        motion_of(sensor, 0.0, *scales, moves).require_within(limit)
    against = [each for each in machines if (TURNED in each.notes) != (TURNED in machines[0].notes)]
    if against:
        raise InputError(
            f"{against[0].source} moves opposite to {source.name} under the same force; correct the sign of one of them"
        )
    step = count_steps(EACH * USES + CHANGES, "design")
    made = search_designs(
        machines[0],
        machines[1:],
        rate=rate,
        delay=delay,
        uncertainty=shares,
        loop_hz=loop_hz,
        noise=sensor_spec.bound(*scales),
        on_step=step,
    )
    if not made.ranking:
        raise NoSafeLoop(source.name, rate, made)
    machine, delay, found, spread = made.machine, made.delay, made.found, made.spreads[0]
    best = made.ranking[0]
    reached = found[best]
    helps = improvements(machine, made.settings[best], made.how, reached, step)
    pid, loops = reached.recommended.controller, reached.model_loops
    about = {
        "gains": asdict(pid),
        "units": f"input {own_units[0]}, output {own_units[1]}; gain {drive}/{position}, integrator, differentiator and "
        "low_pass rad/s",
        "provenance": {
            "made_by": f"stillwork {stillwork.__version__} design",
            "file": source.name,
            "sha256": _sha256(source),
            "machine": taken.kind,
            "notes": list(machine.notes),
            "mass": machine.mass,
            "mass_unit": machine.mass_unit,
            "encoder_counts": counts or None,
            "motor_constant": motor_constant or None,
            "resonances_hz": machine.resonances_hz.tolist(),
            "use": best,
            "settings": asdict(made.settings[best]),
            "uncertainty": {name: np.asarray(getattr(spread, name)).tolist() for name in NAMES},
            "rate_hz": rate,
            "delay_samples_asked": asked,
            "delay_samples_of_the_loop": delay,
            "design_hz": reached.recommended.design_hz,
            "others": [
                {"file": each.name, "sha256": _sha256(each), "resonances_hz": other.resonances_hz.tolist()}
                for each, other in zip(sources[1:], made.others, strict=True)
            ],
        },
    }
    controllers = [
        # Of the error: with the feedforward it is (A.7), and without the error under the reference is S_O.
        tied_to_error(runnable(pid, loop.compensator, limit / scales[1], about, taken.units))
        for loop in loops
    ]
    peaks = recheck(reached, controllers)
    worst = max(size for peak in peaks.values() for size in peak.values())
    if worst > ALLOWED_DB:
        raise InputError(f"{source.name}: the sampled controller peaks at {worst:.2f} dB; sample faster")
    margins = over_the_box(reached, made.spreads)
    if margins and (worst := 20 * np.log10(max(margins.values()))) > ALLOWED_DB:
        raise InputError(
            f"{source.name}: a final search of the uncertainty box found a peak of {worst:.2f} dB; state a little more uncertainty"
        )
    phases = over_the_phases(made, reached, controllers)
    lag = (delay + 0.5) / rate  # the hold's half a sample
    owned = [each if own_units == taken.units else in_units(each, *scales, own_units) for each in controllers]
    written = [
        error_driven(each, motion_of(sensor, lag, *scales, moves))
        for each, sensor in zip(owned, machine.sensors, strict=True)
    ]
    judged = [*loops, *reached.perturbed, *(reached.loops if reached.loops is not loops else ())]
    pairs = [(loop, controllers[k % len(controllers)]) for k, loop in enumerate(judged)]
    of_each = [pairs[k :: len(controllers)] for k in range(len(controllers))]
    written = [
        replace(each, about=about | retest_data(loop) | {"biquads": checked_biquads(each, own, *scales)})
        for each, loop, own in zip(written, loops, of_each, strict=True)
    ]
    rounded = single_rows(written, of_each, scales) if precision == "single" else []
    noises = noise_rows(sensor_spec, written, loops, pid, own_units, scales)
    code = {}
    for number, controller in enumerate(written, 1):
        own = name if len(written) == 1 else f"{name}_{number}"
        code[f"{own}.json"] = json.dumps(controller.as_dict(), indent=1, allow_nan=False) + "\n"
        code |= controller_code(controller, own, precision)
    write_folder(folder, code)  # before the page: what was computed is not lost with a picture
    rates = f"{rate:g} Hz", f"{delay:.4g} samples ({1e6 * delay / rate:.4g} us) plus the hold"
    most = f"{limit:g} {own_units[1]}" if np.isfinite(limit) else "none: give --limit"
    facts = [*zip(("rate", "delay of the loop", "limit of the output"), (*rates, most), strict=True)]
    facts += [*noises, *rounded]
    if own_units != taken.units:
        facts.append(("units of the controller", f"{own_units[0]} in, {own_units[1]} out"))
    if any(each.about["biquads"] is None for each in written):
        facts.append(("biquads for a drive", WITHOUT_BIQUADS))
    if made.others:
        facts.append(("other responses", ", ".join(each.source for each in made.others)))
    held = [*box_table(machine, spread, margins), *phases]
    computed = computed_numbers([*loops, *reached.perturbed], pid, [each.model for each in controllers])
    text = report(made, best, controllers, peaks, computed, helps, held, facts, sorted(code))
    (Path(folder) / "report.html").write_text(text, encoding="utf-8")
    return [
        f"{machine.source}: {taken.kind}; {machine.mass:.4g} {machine.mass_unit}; first resonance at {machine.resonances_hz[0]:.4g} Hz",
        *machine.notes,
        *(
            note
            for each in made.others
            for note in (f"{each.source}: {each.mass:.4g} {each.mass_unit}", *each.notes)
        ),
        *made.lines(),
        f"the written controller over {pluralise(len(loops) + len(reached.perturbed), 'loop')}: {'; '.join(map(' '.join, computed))}",
        *(f"{name}: {words}" for name, words in (*noises, *rounded)),
        f"taken: {best}, stopped by {reached.summary['stopped by']}",
        f"the promise holds for {'; '.join(map(' '.join, held))}",
        *(f"biquads for a drive: {value}" for _, value in facts if value == WITHOUT_BIQUADS),
        f"what would help most, on the model with the same settings, beyond which a new design may reach: {'; '.join(' '.join(row) + ' Hz' for row in helps[:2]) or 'nothing that was tried'}",
        f"{folder}: {', '.join(sorted([*code, 'report.html']))}",
    ]


class NoSafeLoop(InputError):
    """Why none was found, a short line for uses that share a reason, and what to do."""

    def __init__(self, name: str, rate: float, made: Designed):
        uses: dict[str, list[str]] = {}
        for use, each in made.found.items():
            uses.setdefault(each.reason.partition(";")[0] or "unstable on the measurement", []).append(use)
        rows = [f"  {', '.join(names)}: {reason}" for reason, names in uses.items()]
        advice = "sample faster, add damping, or state less --uncertainty"
        lines = [f"{name}: no safe loop at {rate:g} Hz; {advice}", *rows]
        ValueError.__init__(self, "\n".join(map(one_line, lines)))


def _move_limits(limits: Sequence[float]) -> MoveLimits | None:
    if not len(limits):
        return None
    if len(limits) not in (3, 4):
        raise InputError(
            f"limits holds {pluralise(len(limits), 'number')}; give velocity, acceleration, jerk and optionally snap"
        )
    return MoveLimits(*map(float, limits))


def _sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def retest_data(loop: Loop) -> dict:
    """What the command `retest` needs of a loop beside the controller: the observer's part and the model, in the file's units."""
    observer, model = loop.compensator, loop.plant
    return {
        "compensator": {name: getattr(observer, name).tolist() for name in "abcd"},
        "model": {
            "frequencies_rad_s": model.frequencies.tolist(),
            "damping": model.damping.tolist(),
            "residues": (model.output_shapes[0] * model.input_shapes[:, 0]).tolist(),
            "compliance": float(model.feedthrough[0, 0]),
            "drag_1_s": float(model.drag),
        },
    }


def over_the_box(reached: AchievableBandwidth, spreads: Sequence[Uncertainty]) -> dict[str, float]:
    """Largest magnitude of each loop function all over the boxes, by another search than the design's: more starts."""
    if all(spread.is_empty for spread in spreads):
        return {}
    pid = reached.recommended.controller
    pairs = [(loop, spreads[0]) for loop in reached.model_loops]
    pairs += zip(reached.elsewhere, spreads[1:], strict=True)
    sizes = [
        [size for size, _ in make_box(loop, spread).worst(loop, pid, OF_ERROR, every=True, starts=24)]
        for loop, spread in pairs
    ]
    return dict(zip(HELD, np.max(sizes, axis=0).tolist(), strict=True))


def over_the_phases(
    made: Designed, reached: AchievableBandwidth, controllers: Sequence[DigitalController]
) -> list[list[str]]:
    """A row for the table of the box: the peak at places of it with the phases of the modes; none where they have none."""
    pid, rng = reached.recommended.controller, np.random.default_rng(0)
    groups = [reached.model_loops, *((loop,) for loop in reached.elsewhere)]
    worst, count = 0.0, 0
    for group, machine, spread in zip(groups, (made.machine, *made.others), made.spreads, strict=True):
        if machine.fit is None or machine.fit.phased is None or spread.is_empty:
            continue
        for loop in phased_loops(group, machine.fit.phased, machine.mirrored, phased_places(spread, rng)):
            turns = encirclement_difference(loop, pid)
            controller = controllers[count % len(controllers)]
            worst = max(worst, np.inf if turns else float(np.abs(own_functions(loop, controller)).max()))
            count += 1
    if not count:
        return []
    if (size := 20 * np.log10(worst)) > ALLOWED_DB:
        raise InputError(
            f"{made.machine.source}: with the phases of its modes a peak of {size:.2f} dB was found in the box; state a "
            "little more uncertainty"
        )
    return [["largest with the phases of the modes", f"{size:.2f} dB at the {count} points tried"]]


def box_table(machine: Machine, spread: Uncertainty, margins: dict[str, float]) -> list[list[str]]:
    """Widths of the box and the largest peaks in it, as rows; the box around another response differs by its fit alone."""
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
    if spread.friction > SHOWN_FROM / 100 * (drag := machine.sensors[0].drag):
        rows.append(
            [
                "viscous friction over mass",
                f"{max(drag - spread.friction, 0):.3g} to {drag + spread.friction:.3g} 1/s",
            ]
        )
    if margins:
        sizes = ", ".join(f"{SHOWN[name]} {20 * np.log10(size):.2f} dB" for name, size in margins.items())
        rows.append(
            ["largest in the box", f"{sizes}; modulus margin {1 / margins['output_sensitivity']:.3f}"]
        )
    return rows


def improvements(
    machine: Machine,
    settings: DesignSettings,
    how: dict,
    reached: AchievableBandwidth,
    on_step: Callable[[str], None] = lambda _: None,
) -> list[list[str]]:
    """Changes of the machine that raise the bandwidth of the model with the same settings, the best first."""

    def damped(model: ModalModel) -> ModalModel:
        factor = np.append(1.0, np.full(len(model.damping) - 1, 2.0))
        return replace(model, damping=np.minimum(factor * model.damping, np.maximum(model.damping, 0.5)))

    def beside(model: ModalModel) -> ModalModel:
        shapes = np.abs(model.output_shapes) * np.sign(model.input_shapes.T)
        return replace(model, output_shapes=shapes, feedthrough=np.abs(model.feedthrough))

    trials: dict[str, tuple[Callable[[ModalModel], ModalModel], dict]] = {
        "twice the damping of its modes:": (damped, {}),
        "the sensor where the force acts:": (beside, {}),
        "twice the rate:": (lambda model: model, {"sample_time": how["sample_time"] / 2}),
        "no delay:": (lambda model: model, {"delay": 0.0}),
    }
    if not how["delay"]:
        del trials["no delay:"]
    before = reached.on_model.crossing_hz.min() if reached.on_model else 0.0
    gains = []
    for words, (change, settled) in trials.items():
        on_step(words)
        changed, *others = (
            replace(each, measured=None, fit=None, sensors=tuple(map(change, each.sensors)))
            for each in (machine, *(other for other, _ in how.get("others", ())))
        )
        late = [settled.get("delay", delay) for _, delay in how.get("others", ())]
        changes = how | settled | {"others": tuple(zip(others, late, strict=True))}
        low, high = search_range(changed, changes["sample_time"])
        if reached.on_model:  # only what exceeds it is listed
            low = min(reached.on_model.design_hz, 0.99 * high)
        found = reach_one(changed, settings, changes | {"search_hz": (low, high)}).on_model
        if found is not None and found.crossing_hz.min() > (1 + WORTH) * before:
            gains.append([float(found.crossing_hz.min()), words])
    return [[words, f"{hertz:.1f}"] for hertz, words in sorted(gains, key=lambda each: -each[0])]


def recheck(
    reached: AchievableBandwidth, controllers: list[DigitalController]
) -> dict[str, dict[str, float]]:
    """Largest peaks in dB with the written coefficients, by function and by loops: all loops of the search."""
    looked = {"on the model (dB)": reached.model_loops}
    if reached.perturbed:
        looked["at the worst places of the box (dB)"] = reached.perturbed
    if reached.loops is not reached.model_loops:
        looked["on the measurement (dB)"] = reached.loops
    found: dict[str, dict[str, float]] = {name: {} for name in HELD}
    for where, loops in looked.items():
        pairs = [(loop, controllers[k % len(controllers)]) for k, loop in enumerate(loops)]
        peaks = np.max([np.abs(own_functions(*pair)).max(axis=1) for pair in pairs], axis=0)
        for name, size in zip(HELD, peaks, strict=True):
            found[name][where] = float(20 * np.log10(size))
    return found


def checked_biquads(
    controller: DigitalController,
    judged: Sequence[tuple[Loop, DigitalController]],
    position: float = 1.0,
    drive: float = 1.0,
) -> dict | None:
    """The biquads of the whole controller as in its file; None unless they stabilise the model and stay below 6 dB.

    `judged` are the loops, the model's first, each with the controller in the loop's units; `position` and `drive` are
    the written controller's units per unit of the loop.
    """
    found = equivalent_biquads(controller)
    if found is None:
        return None
    loop = judged[0][0]
    peak = max(
        peak_with(each, own, section_response(found.feedback, each) * position / drive)
        for each, own in judged
    )
    if peak > ALLOWED_DB:
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
        "peak_db": peak,
        "spectral_radius_with_the_model": radius,
    }


def report(
    made: Designed,
    best: str,
    controllers: list[DigitalController],
    peaks: dict[str, dict[str, float]],
    computed: list[tuple[str, str]],
    helps: list[list[str]],
    box: list[list[str]],
    about: list,
    files: list[str],
) -> str:
    """One page: the machine, the bandwidth of each use of an observer, the choice, its peaks, and how to run it."""
    machine, reached = made.machine, made.found[best]
    where = list(next(iter(peaks.values())))
    sizes = [[SHOWN[name], *(f"{peak[column]:.2f}" for column in where)] for name, peak in peaks.items()]
    facts = [
        ["mass" if machine.units[0] == "m" else "inertia", f"{machine.mass:.4g} {machine.mass_unit}"],
        ["resonances", ", ".join(f"{hertz:.4g}" for hertz in machine.resonances_hz) + " Hz"],
        *map(list, about),
        *(["note", note] for note in machine.notes),
    ]
    return page(
        "design.html",
        source=html.escape(machine.source),
        kind=": a controller",
        taken=html.escape(best),
        stopped=html.escape(reached.summary["stopped by"]),
        facts=table([], facts),
        box=table([], box or [["everything", "exactly as in the model: no uncertainty was stated"]]),
        uses=uses_table(made),
        peaks=table(["peak", *where], sizes),
        computed=table([], list(map(list, computed))),
        helps=table(["change", "bandwidth (Hz)"], helps or [["none of those tried", ""]]),
        machine=picture(paint_machine(machine), "accelerance of the model and of the measurement"),
        loops=picture(paint_loops(reached, controllers), "sensitivities of the sampled loop"),
        files=html.escape(", ".join(files)),
    )


def uses_table(made: Designed) -> str:
    """Bandwidth of each use of an observer, or why it has none, and their order."""
    columns = list(dict.fromkeys(key for each in made.found.values() for key in each.summary))
    rows = [
        [use, *(each.summary.get(key, "") for key in columns), each.reason]
        for use, each in made.found.items()
    ]
    words = "".join(f"<p>{html.escape(line)}</p>\n" for line in (*made.notes, made.ranking_line))
    return words + table(["use", *columns, "why not"], rows)


@pictures.house_style()
def paint_machine(machine: Machine):
    """Accelerance of the model at every sensor, and of the measurement at the first."""
    figure, axis = pictures.new(1, 1, height=3.0)
    resonances = machine.resonances_hz
    hertz = np.unique(
        np.concatenate([np.geomspace(resonances[0] / 10, 2 * resonances[-1], 3000), resonances])
    )
    if machine.measured is not None:
        seen = machine.measured.omega / (2 * np.pi)
        shown = (seen >= hertz[0]) & (seen <= hertz[-1])
        size = 20 * np.log10(np.abs(machine.measured.response[shown]))
        axis.semilogx(seen[shown], size, linewidth=0.6, color=pictures.GREY, label="measured, sensor 1")
    for number, sensor in enumerate(machine.sensors, 1):
        omega = 2 * np.pi * hertz
        size = 20 * np.log10(np.abs(omega**2 * sensor.frequency_response(omega)[0, 0]))
        axis.semilogx(hertz, size, linewidth=1.0, label=f"model, sensor {number}")
    axis.set(xlabel="frequency (Hz)", ylabel=f"acceleration over force (dB re 1/({machine.mass_unit}))")
    axis.legend()
    return figure


@pictures.house_style()
def paint_stabilisation(fit: ModalFit):
    """Poles over the model order: those that stay from order to order, and those taken for modes, are marked."""
    diagram = fit.diagram
    figure, axis = pictures.new(1, 1, height=3.2)
    for chosen, colour, label in (
        (~diagram.stable, pictures.GREY, "pole that moves with the order"),
        (diagram.stable, pictures.BLUE, "pole that stays"),
    ):
        hertz = diagram.frequency[chosen] / (2 * np.pi)
        axis.semilogx(hertz, diagram.order[chosen], ".", markersize=3, color=colour, label=label)
    for number, hertz in enumerate(fit.model.frequencies[fit.model.rigid_modes :] / (2 * np.pi)):
        label = "_mode" if number else "taken as a mode"
        axis.axvline(hertz, color=pictures.RED, linewidth=0.8, zorder=1, label=label)
    axis.set(xlabel="frequency (Hz)", ylabel="order of the polynomial fraction")
    pictures.legend_below(axis, 3)
    return figure


@pictures.house_style()
def paint_loops(reached: AchievableBandwidth, controllers: list[DigitalController]):
    """Both sensitivities of every sensor with the written coefficients, and their limit."""
    figure, axes = pictures.new(1, 2, height=2.8, sharey=True)
    colours = (pictures.RED, pictures.BLUE, pictures.GREEN, pictures.ORANGE)
    for number, loop in enumerate(reached.loops):
        pair = loop, controllers[number % len(controllers)]
        hertz = loop.omega / (2 * np.pi)
        for axis, name, response in zip(axes, HELD, own_functions(*pair), strict=True):
            axis.semilogx(hertz, 20 * np.log10(np.abs(response)), linewidth=0.8, color=colours[number % 4])
            axis.axhline(20 * np.log10(SIX_DB), color=pictures.BLACK, linestyle=":", linewidth=1.0)
            axis.set(title=SHOWN[name], xlabel="frequency (Hz)", ylim=(-50, 15))
    axes[0].set_ylabel("magnitude (dB)")
    return figure
