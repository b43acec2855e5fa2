"""The command ``design``: from the file of a machine to a controller in C, and one page with the reasons."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

import stillwork
from stillwork.base.checks import InputError, one_line, pluralise, require_number
from stillwork.base.extras import require_package
from stillwork.base.validation import by_value
from stillwork.control.bandwidth import Loop
from stillwork.control.digital import DigitalController, error_driven, in_units, runnable, tied_to_error
from stillwork.control.feedforward import motion_of
from stillwork.control.loop_noise import SHARE
from stillwork.control.machine_loops import SHOWN, in_hertz, search_range
from stillwork.control.setpoint import MoveLimits
from stillwork.control.uncertainty import NAMES
from stillwork.identification.machine import TURNED, Machine
from stillwork.identification.machine_files import MachineFile, load_machine
from stillwork.machine.axes import design_axes, read_axes
from stillwork.machine.c_code import controller_code, require_names
from stillwork.machine.design_page import box_table, report
from stillwork.machine.export import require_free, write_folder
from stillwork.machine.hardware import ALLOWED_DB, SensorNoise, noise_rows, sensor_noise, single_rows
from stillwork.machine.machine_designs import (
    CHANGES,
    DELAY,
    EACH,
    Designed,
    crossing,
    improvements,
    search_designs,
    stated_uncertainty,
    uses_of,
)
from stillwork.machine.margins import computed_numbers
from stillwork.machine.progress import count_steps
from stillwork.machine.promise import (
    beyond,
    breaking_hz,
    checked_biquads,
    over_the_box,
    over_the_phases,
    recheck,
)
from stillwork.machine.readings import build_explained

MOST_LATE = 20  # samples either way, of a delay's uncertainty
AGAINST = (
    "sign: the motion was counted against the force; the C is for a motion counted along it, so turn the sensor's sign "
    "before it, or the loop runs away"
)
UNSTABLE = "unstable on the measurement"
WITHOUT_BIQUADS = (
    "left out: written as biquads, the controller would exceed 6 dB or not stabilise the model on its own"
)


@by_value
@dataclass(frozen=True)
class DesignRequest:
    """What is asked of a controller.

    Attributes
    ----------
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
        Band in which the measurement is reliable and represents the plant, Hz; (0, 0): that of the fit, without the
        lines at its ends that the coherence does not let be trusted.
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
    highest_hz : float
        Highest design bandwidth that is sought, Hz; 0: see `search_range`.
    what_helps : bool
        Whether to search for the machine with more damping, another place of its sensor, a faster or prompter
        processor, too: four more searches.
    """

    rate: float
    delay: float = DELAY
    limit: float = np.inf
    limits: Sequence[float] = ()
    name: str = "controller"
    precision: str = "double"
    fit_hz: tuple[float, float] = (0.0, 0.0)
    loop_hz: tuple[float, float] = (0.0, 0.0)
    uncertainty: str | Mapping[str, float] = ""
    counts: float = 0.0
    motor_constant: float = 0.0
    noise: float = 0.0
    noise_share: float = SHARE
    noise_ratio: float = 0.0
    highest_hz: float = 0.0
    what_helps: bool = False

    def __post_init__(self):
        require_names(self.name, self.precision)
        if self.limit != np.inf:
            require_number("limit", self.limit, above=0.0)
        _ = self.moves
        require_number("rate", self.rate, above=0.0)
        require_number("delay", self.delay, at_least=0.0)
        late = self.shares.get("delay", 0.0)
        if late * self.rate > MOST_LATE:
            raise InputError(
                f"uncertainty: delay is {late:g} s, {late * self.rate:.3g} samples at {self.rate:g} Hz, too much for any "
                f"loop; give seconds, at most {MOST_LATE} samples ({MOST_LATE / self.rate:.3g} s)"
            )
        for name in ("counts", "motor_constant", "highest_hz"):
            require_number(name, getattr(self, name), at_least=0.0)

    @property
    def shares(self) -> dict[str, float]:
        """The uncertainty by names."""
        return stated_uncertainty(self.uncertainty)

    @property
    def moves(self) -> MoveLimits | None:
        """Limits of the setpoint."""
        limits = self.limits
        if not len(limits):
            return None
        if len(limits) not in (3, 4):
            raise InputError(
                f"limits holds {pluralise(len(limits), 'number')}; give velocity, acceleration, jerk and optionally snap"
            )
        return MoveLimits(*map(float, limits))

    @property
    def scales(self) -> tuple[float, float]:
        """The controller's units of position and drive per unit of the machine."""
        return self.counts or 1.0, 1 / self.motor_constant if self.motor_constant else 1.0


def design_file(
    files: str | Sequence[str], folder: str, rate: float, *, verbose: bool = False, **asked
) -> list[str]:
    """Design a controller for the machine in `files` and write it, as C and as JSON, into a new folder.

    Parameters
    ----------
    files : str or sequence of str
        See `load_machine`. A matrix response, or a TOML whose table [decoupling] names it, is decoupled into
        axes, see `design_axes`. Several files hold the same machine at other positions or with other loads: the observer is
        made for the first; the constraints hold for all of them, and in the box around each.
    folder : str
        New or empty folder.
    rate : float
        Sample rate of the controller, Hz.
    verbose : bool
        Whether to return all findings, which are on the page.
    **asked
        Other fields of `DesignRequest`, and arguments of `load_machine`.

    Returns
    -------
    list of str
        What was chosen, what it promises and where it is, one line each; with `verbose` then the findings.

    Raises
    ------
    MissingPackage
        When the page cannot be drawn, before anything is computed.
    InputError
        When the file cannot be used, no use of an observer has a safe loop, or the folder is not empty.
    """
    require_package("matplotlib")
    require_free(folder)
    own = {each.name for each in fields(DesignRequest)} & asked.keys()
    request = DesignRequest(rate, **{name: asked[name] for name in own})
    options = {name: value for name, value in asked.items() if name not in own}
    single = [files] if isinstance(files, str) else files
    if single and (wanted := read_axes(single[0], options)):
        if len(single) > 1:
            raise InputError(
                f"{wanted.matrix.source} holds a matrix response; give one matrix at a time, or one response with response"
            )
        make = partial(design_file, rate=rate, verbose=True, **{name: asked[name] for name in own})
        return design_axes(wanted, folder, request, make, verbose)
    return _design_one(_read(request, files, options), folder, verbose)


def _answer(
    made: Designed, held: list[list[str]], peaks: dict[str, dict[str, float]], without: str
) -> list[str]:
    """What was chosen and what it promises, one line each."""
    best = made.ranking[0]
    found = made.found[best]
    waits = f", waiting {made.settings[best].wait:g} samples by itself" if made.settings[best].wait else ""
    box = "; ".join(map(" ".join, held))
    if not box:
        sizes = ", ".join(f"{SHOWN[name]} {max(each.values()):.2f} dB" for name, each in peaks.items())
        box = f"the model alone, as no uncertainty was stated: {sizes}"
    return [
        f"{made.machine.source}: {best}{waits}, with a bandwidth of {in_hertz(crossing(found))} Hz, stopped by {found.summary['stopped by']}",
        f"the promise of 6 dB holds for {box}{without and '; ' + without}",
    ]


class _Given(NamedTuple):
    """What a request refers to: its files, the machines in them, and the units of the controller."""

    request: DesignRequest
    sources: list[Path]
    file: MachineFile  # the first
    machines: list[Machine]
    units: tuple[str, str]  # of the controller's position and output
    noise: SensorNoise


def _read(request: DesignRequest, files: str | Sequence[str], load_options: dict) -> _Given:
    sources = [Path(each) for each in ([files] if isinstance(files, str) else files)]
    if not sources:
        raise InputError("files is empty; name the file of a machine")
    source = sources[0]
    every = [load_machine(each, **load_options) for each in sources]
    position, drive = every[0].units
    if request.counts and position == "count":
        raise InputError(f"{source.name} is in counts already; leave counts out")
    if request.motor_constant and drive not in ("N", "N m"):
        raise InputError(
            f"{source.name} has its input in {drive}; motor_constant is for N or N m, leave it out"
        )
    units = "count" if request.counts else position, "A" if request.motor_constant else drive
    noise = sensor_noise(units[0], request.limit, request.noise, request.noise_share, request.noise_ratio)
    how = {"fit_hz": request.fit_hz, "options": load_options}
    machines = [build_explained(path, each, **how) for path, each in zip(sources, every, strict=True)]
    for sensor in machines[0].sensors:
        motion_of(sensor, 0.0, *request.scales, request.moves).require_within(request.limit)
    against = [each for each in machines if (TURNED in each.notes) != (TURNED in machines[0].notes)]
    if against:
        raise InputError(
            f"{against[0].source} moves opposite to {source.name} under the same force; correct the sign of one of them"
        )
    return _Given(request, sources, every[0], machines, units, noise)


def _design_one(given: _Given, folder: str, verbose: bool) -> list[str]:
    """A controller of one axis, written; what was chosen and promised, one line each."""
    request, rate = given.request, given.request.rate
    uses = len(uses_of(given.machines[0]))
    step = count_steps(EACH * uses * (1 + CHANGES * request.what_helps), "design")
    lowest = search_range(given.machines[0], 1 / rate)[0]
    made = search_designs(
        given.machines[0],
        given.machines[1:],
        rate=rate,
        delay=request.delay,
        uncertainty=request.shares,
        loop_hz=request.loop_hz,
        search_hz=(min(lowest, request.highest_hz / 2), request.highest_hz),
        noise=given.noise.bound(*request.scales),
        on_step=step,
    )
    if not made.ranking:
        raise NoSafeLoop(given.sources[0].name, rate, made)
    helps = improvements(given.machines, made, request.delay, step) if request.what_helps else None
    controllers, held, peaks = _first_proven(given, made)
    written, facts = _in_own_units(given, made, controllers)
    code = _code(request, written)
    write_folder(folder, code)  # before the page: what was computed is not lost with a picture
    reached = made.found[made.ranking[0]]
    pid, loops = reached.safe.controller, reached.model_loops
    computed = computed_numbers([*loops, *reached.perturbed], pid, [each.model for each in controllers])
    without = beyond(made)
    answer = [
        *_answer(made, held, peaks, without),
        f"C and reasons: {folder}: {', '.join(sorted([*code, 'report.html']))}",
        *([AGAINST] if TURNED in made.machine.notes else []),
    ]
    about = [*_facts(given, made), *facts]
    text = report(made, answer[:2], controllers, peaks, computed, helps, held, about, without)
    (Path(folder) / "report.html").write_text(text, encoding="utf-8")
    if not verbose:
        return answer
    many = pluralise(len(loops) + len(reached.perturbed), "loop")
    answer += [
        *_findings(given, made),
        f"the written controller over {many}: {'; '.join(map(' '.join, computed))}",
        *(f"{name}: {words}" for name, words in facts),
    ]
    if helps is not None:
        best = "; ".join(" ".join(row) + " Hz" for row in helps)
        answer.append(f"what would help most: {best or 'nothing that was tried'}")
    return answer


def _first_proven(given: _Given, made: Designed) -> tuple[list[DigitalController], list[list[str]], dict]:
    """As `_proven`, of the use that gets furthest and whose promise holds when it is looked at once more."""
    while True:
        reached = made.found[made.ranking[0]]
        try:
            return _proven(given, made)
        except InputError as error:
            for use, each in made.found.items():
                if each is reached:
                    made.found[use] = replace(each, reason=str(error))
            if not made.ranking:
                raise


def _proven(given: _Given, made: Designed) -> tuple[list[DigitalController], list[list[str]], dict]:
    """Controllers in the units of the machine, rows on the box for which their promise holds, and their peaks."""
    source, reached, limit = given.sources[0].name, made.found[made.ranking[0]], given.request.limit
    pid, about = reached.safe.controller, _about(given, made)
    controllers = [
        # Of the error: with the feedforward it is (A.7), and without the error under the reference is S_O.
        tied_to_error(
            runnable(pid, loop.compensator, limit / given.request.scales[1], about, given.file.units)
        )
        for loop in reached.model_loops
    ]
    peaks = recheck(reached, controllers)
    worst = max(size for peak in peaks.values() for size in peak.values())
    if worst > ALLOWED_DB:
        raise InputError(f"{source}: the sampled controller peaks at {worst:.2f} dB; sample faster")
    margins = over_the_box(reached, made.spreads)
    if margins and (worst := 20 * np.log10(max(margins.values()))) > ALLOWED_DB:
        raise InputError(
            f"{source}: a final search of the uncertainty box found a peak of {worst:.2f} dB; state a little more uncertainty"
        )
    phases = over_the_phases(made, reached, controllers)
    return controllers, [*box_table(made.machine, made.spreads[0], margins), *phases], peaks


def _in_own_units(
    given: _Given, made: Designed, controllers: list[DigitalController]
) -> tuple[list[DigitalController], list[list[str]]]:
    """The controllers that are written, of the error and in their own units, and rows on what these make of them."""
    request, reached, scales = given.request, made.found[made.ranking[0]], given.request.scales
    loops, lag = reached.model_loops, (made.delay + 0.5) / made.rate  # the hold's half a sample
    plain = given.units == given.file.units
    owned = [each if plain else in_units(each, *scales, given.units) for each in controllers]
    written = [
        error_driven(each, motion_of(sensor, lag, *scales, request.moves))
        for each, sensor in zip(owned, made.machine.sensors, strict=True)
    ]
    judged = [*loops, *reached.perturbed, *(reached.loops if reached.loops is not loops else ())]
    pairs = [(loop, controllers[k % len(controllers)]) for k, loop in enumerate(judged)]
    of_each = [pairs[k :: len(controllers)] for k in range(len(controllers))]
    written = [
        replace(each, about=each.about | retest_data(loop) | {"biquads": checked_biquads(each, own, *scales)})
        for each, loop, own in zip(written, loops, of_each, strict=True)
    ]
    rounded = single_rows(written, of_each, scales) if request.precision == "single" else []
    pid = reached.safe.controller
    facts = [*noise_rows(given.noise, written, loops, pid, given.units, scales), *rounded]
    if not plain:
        facts.append(["units of the controller", f"{given.units[0]} in, {given.units[1]} out"])
    if any(each.about["biquads"] is None for each in written):
        facts.append(["biquads for a drive", WITHOUT_BIQUADS])
    return written, facts


def _about(given: _Given, made: Designed) -> dict:
    """Gains and provenance, for the controller's file."""
    request, machine, best = given.request, made.machine, made.ranking[0]
    position, drive = given.file.units
    safe, spread = made.found[best].safe, made.spreads[0]
    provenance = {
        "made_by": f"stillwork {stillwork.__version__} design",
        "file": given.sources[0].name,
        "sha256": _sha256(given.sources[0]),
        "machine": given.file.kind,
        "notes": list(machine.notes),
        "mass": machine.mass,
        "mass_unit": machine.mass_unit,
        "encoder_counts": request.counts or None,
        "motor_constant": request.motor_constant or None,
        "resonances_hz": machine.resonances_hz.tolist(),
        "use": best,
        "settings": asdict(made.settings[best]),
        "uncertainty": {name: np.asarray(getattr(spread, name)).tolist() for name in NAMES},
        "rate_hz": made.rate,
        "delay_samples_asked": request.delay,
        "delay_samples_of_the_loop": made.delay,
        "design_hz": safe.design_hz,
        "breaking_hz": breaking_hz(made, best),
        "others": [
            {"file": each.name, "sha256": _sha256(each), "resonances_hz": other.resonances_hz.tolist()}
            for each, other in zip(given.sources[1:], made.others, strict=True)
        ],
    }
    return {
        "gains": asdict(safe.controller),
        "units": f"input {given.units[0]}, output {given.units[1]}; gain {drive}/{position}, integrator, differentiator and "
        "low_pass rad/s",
        "provenance": provenance,
    }


def _code(request: DesignRequest, written: list[DigitalController]) -> dict[str, str]:
    """The files of the controllers by their names."""
    code = {}
    for number, controller in enumerate(written, 1):
        own = request.name if len(written) == 1 else f"{request.name}_{number}"
        code[f"{own}.json"] = json.dumps(controller.as_dict(), indent=1, allow_nan=False) + "\n"
        code |= controller_code(controller, own, request.precision)
    return code


def _facts(given: _Given, made: Designed) -> list[list[str]]:
    """Rows on what the controller was made for."""
    rate, delay, limit = made.rate, made.delay, given.request.limit
    facts = [
        ["rate", f"{rate:g} Hz"],
        ["delay of the loop", f"{delay:.4g} samples ({1e6 * delay / rate:.4g} us) plus the hold"],
        [
            "limit of the output",
            f"{limit:g} {given.units[1]}" if np.isfinite(limit) else "none: give --limit",
        ],
    ]
    if made.others:
        facts.append(["other responses", ", ".join(each.source for each in made.others)])
    return facts


def _findings(given: _Given, made: Designed) -> list[str]:
    """Lines on the machine and on the search."""
    machine = made.machine
    hertz = machine.resonances_hz
    first = f"first resonance at {hertz[0]:.4g} Hz" if len(hertz) else "no flexible mode"
    return [
        f"{machine.source}: {given.file.kind}; {machine.mass:.4g} {machine.mass_unit}; {first}",
        *machine.notes,
        *(
            note
            for each in made.others
            for note in (f"{each.source}: {each.mass:.4g} {each.mass_unit}", *each.notes)
        ),
        *made.lines(),
    ]


class NoSafeLoop(InputError):
    """Why none was found, a short line for uses that share a reason, and what to do."""

    def __init__(self, name: str, rate: float, made: Designed):
        uses: dict[str, list[str]] = {}
        for use, each in made.found.items():
            uses.setdefault(each.reason.partition(";")[0] or UNSTABLE, []).append(use)
        rows = [f"  {', '.join(names)}: {reason}" for reason, names in uses.items()]
        advice = "sample faster, add damping, or state less --uncertainty"
        if UNSTABLE in uses:
            advice += (
                "; the model is stable where the measurement is not: give --loop-hz, the band in which the response stands out of its "
                "noise, or --fit-hz, one that holds all modes"
            )
        lines = [f"{name}: no safe loop at {rate:g} Hz; {advice}", *rows]
        ValueError.__init__(self, "\n".join(map(one_line, lines)))


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
