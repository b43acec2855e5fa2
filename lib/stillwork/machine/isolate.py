"""The command ``isolate``: a self-tuned feedforward in C for an isolator and its floor, with certificate and prediction."""

import html
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

import stillwork
from stillwork.base.checks import InputError, pluralise, require_array, require_flag, require_number
from stillwork.base.extras import require_package
from stillwork.base.toml_files import Table
from stillwork.control.isolation_filters import FrequencyNotch
from stillwork.estimation.adaptive import FeRls
from stillwork.identification.machine_files import complex_responses, load_machine
from stillwork.machine import pictures
from stillwork.machine.c_code import isolation_code, require_names
from stillwork.machine.export import require_free, write_folder
from stillwork.machine.floor_checks import (
    HEARD_HZ,
    SLOW_HZ,
    require_floor_level,
    sensor_faults,
    slow_ratio,
)
from stillwork.machine.html_page import page, picture, table
from stillwork.machine.isolation import FloorSpectra, Isolator
from stillwork.machine.isolation_design import (
    CREST,
    DRAWS,
    ENDS,
    FASTER,
    HIGHEST_PHASE,
    HIGHEST_SENSITIVITY_DB,
    LIMIT,
    PERIODS,
    SLOWEST,
    WITHIN,
    IsolationDesign,
    binned,
    design_isolation,
    floor_spectra,
)
from stillwork.machine.isolation_prediction import IsolationPrediction, predict, with_noise, worst_excess
from stillwork.machine.machine_toml import KNOWN, open_machine_toml, own_table, suspended
from stillwork.machine.path_fit import PathFit, fit_path
from stillwork.machine.replay import Replay, paint_replay, replay_rows, require_kept
from stillwork.machine.settling import Learning, paint_learning, settle_on_record, settling_times
from stillwork.signals.criteria import criterion_met, one_third_octave_velocity
from stillwork.signals.datafiles import read_arrays, read_columns
from stillwork.signals.densities import (
    DENSITY_UNITS_TEXT,
    density_unit,
    frequency_axis,
    read_densities,
    stated_density,
)
from stillwork.signals.records import PASS_SHARE, load_record, to_acceleration
from stillwork.signals.spectra import estimate_spectrum

QUIET = 1e-5  # m/s^2/sqrt(Hz): noise of a sensor for which none is given
MAINS_WIDTH = 0.1  # of a notch, bandwidth over frequency
LINE_HZ = 0.25  # between lines of a record
SLOWEST_HZ = 0.02  # lowest frequency at which a floor is judged, and the resolution of spectra and of a record that is long enough
SLOW_RATIO = 5.0  # of slow motion per root Hz over that in band, above which it is reported (chosen)
LISTENED_S = 60.0  # duration over which the motion predicted by spectra is judged
OFTEN = 0.05  # share of a record in which weights are kept, above which the answer says so
# Noted where a response is given and no `anti_alias`.
THROUGH = (
    "the response was measured, and the platform's sensors are sampled, through an anti-alias filter; without one give a TOML "
    "file with anti_alias = false"
)
PAUSES = 5.0  # of the band's slowest time constant, for which the weights are kept after the limit acted


def isolate_file(
    machine: str,
    floor: str,
    folder: str,
    rate: float,
    *,
    unit: str = "",
    channel: Sequence[str] = (),
    limit: float = np.inf,
    algorithm: str = "FeRls",
    variance: float = 0.1,
    spread: float = 0.05,
    band_hz: tuple[float, float] = (0.0, 0.0),
    name: str = "isolator",
    precision: str = "double",
    verbose: bool = False,
) -> list[str]:
    """Design a self-tuned feedforward for an isolator on a floor; write it as C99 with a page into a new folder.

    Parameters
    ----------
    machine : str
        TOML with a table [isolator], or the measured response of its acceleration to its actuators; see `read_isolator`.
    floor : str
        A record of the floor sensors, or their power spectral densities; a single channel gives the spectrum of every
        sensor, their motions being independent.
    folder : str
        New or empty folder.
    rate : float
        Sample rate of the controller, Hz.
    unit : str
        Unit of the floor's channels; empty: as stated in the file.
    channel : sequence of str
        Channels of the floor to use; empty: all.
    limit : float
        Limit of each command, N.
    algorithm : str
        ``FeRls`` or ``FeLms``.
    variance : float
        Share by which the scatter of the weights may raise the power of what remains: it sets lambda or mu.
    spread : float
        Relative uncertainty of the isolator; see `isolation_design.SPREADS`.
    band_hz : tuple of float
        Band of the filtered error, Hz; (0, 0): chosen.
    name, precision : str
        See `isolation_code`.
    verbose : bool
        Whether to return all findings, which are on the page.

    Returns
    -------
    list of str
        What was chosen, what it promises and where it is, one line each; with `verbose` then the findings.

    Raises
    ------
    MissingPackage
        When the page cannot be drawn, before anything is computed.
    InputError
        When a file cannot be used, the loop may not be switched on, or the folder is not empty.
    """
    require_package("matplotlib")
    require_free(folder)
    require_names(name, precision)
    require_number("rate", rate, above=0.0)
    if limit != np.inf:
        require_number("limit", limit, above=0.0)
    isolator, estimate, measured, notches, notes, filtered = read_isolator(machine, rate)
    spectra, floor_notes, seen = read_floor(floor, unit, isolator.sensors, rate, list(channel))
    spectra = at_sensors(spectra, isolator.sensors, floor_notes)
    for each in seen:  # a design takes a minute, and may be refused for just that
        print(f"{Path(floor).name}: {each}", file=sys.stderr, flush=True)
    correction = None if measured is None else unmodelled(isolator, measured, rate, filtered)
    design, around = design_isolation(
        isolator,
        spectra,
        rate,
        estimate=estimate,
        correction=correction,
        band_hz=band_hz,
        notches=tuple(FrequencyNotch(notch, MAINS_WIDTH) for notch in notches),
        algorithm=algorithm,
        variance=variance,
        spread=spread,
    )
    made = _made(
        design,
        around,
        spectra,
        name,
        precision,
        limit=limit,
        variance=variance,
        spread=spread,
        correction=correction,
    )
    if filtered:  # what the design takes off the readings is not in them
        made = made.of_filtered_readings(limit, name, precision)
    about = _about(machine, made, spectra) | {"anti_alias": filtered}
    files = made.files | {f"{name}.json": json.dumps(about, indent=1, allow_nan=False) + "\n"}
    write_folder(folder, files)  # before the page: what was computed is not lost with a picture
    facts = [
        *made.facts(spectra, limit),
        *(["assumed", each] for each in (*notes, *floor_notes)),
        *(["check the floor", each] for each in seen),
    ]
    answer = _answer(f"{Path(machine).name} on {spectra.source}", made, spectra, spread)
    given = {
        "answer": "".join(f"<p>{html.escape(line)}</p>" for line in answer),
        "budget": _budget_link(machine, floor, folder) if isolator.axes == isolator.sensors == 1 else "",
        "source": html.escape(Path(machine).name),
        "spread": f"{100 * spread:g}",
        "name": name,
        "guard": name.upper(),
        "replay": _replayed(made, limit),
        "files": html.escape(", ".join(sorted(files))),
    }
    text = _report(made, spectra, facts, **given)
    (Path(folder) / "report.html").write_text(text, encoding="utf-8")
    answer.append(f"C and reasons: {folder}: {', '.join(sorted([*files, 'report.html']))}")
    if not verbose:
        return answer
    return [
        *answer,
        *(": ".join(row) for row in facts),
        *findings(made.design, made.around, made.found, spectra),
    ]


class _Made(NamedTuple):
    """A design that was accepted, its C and what it is expected to do."""

    design: IsolationDesign
    around: list[IsolationDesign]
    files: dict[str, str]
    found: IsolationPrediction
    settling: tuple[float, float]  # s: nominal, and at most in the box
    excess: tuple[float, float]  # of weights that do not move; see `worst_excess`
    run: Replay | None  # of the floor's record, as `learning`
    learning: Learning | None

    def of_filtered_readings(self, limit: float, name: str, precision: str) -> Self:
        """The same design, with the C for readings that come through an anti-alias filter."""
        loop = replace(self.design.loop, clearing=False)
        return self._replace(files=_written(replace(self.design, loop=loop), limit, name, precision))

    def remainder(self) -> str:
        """What settled weights leave more than the best ones."""
        moves = max(self.design.variance, self.learning.excess if self.learning else 0.0)
        given, worst = (f"{100 * ((1 + each) * (1 + moves) - 1):.3g} %" for each in self.excess)
        return (
            f"and move leave {given} more power than the best frozen ones on the isolator as given, {worst} at the worst end of its "
            "box, expected of the floor's spectra"
        )

    def facts(self, spectra: FloorSpectra, limit: float) -> list[list[str]]:
        """What was chosen, and what follows."""
        shown = self.learning.sentence() if self.learning else "on a floor whose strength is even"
        return [
            *facts_of(self.design, self.found, spectra),
            ["settling from zero weights", _settling_words(self.settling, shown)],
            ["weights that have settled", self.remainder()],
            ["limit of each force", f"{limit:g} N" if np.isfinite(limit) else "none: give --limit"],
        ]


def _made(
    design: IsolationDesign,
    around: list[IsolationDesign],
    spectra: FloorSpectra,
    name: str,
    precision: str,
    *,
    limit: float,
    variance: float,
    spread: float,
    correction: Callable | None,
) -> _Made:
    """What a design becomes on the floor's record, where there is one, and its prediction; refused where these forbid it."""

    def written(each: IsolationDesign) -> dict[str, str]:
        return _written(each, limit, name, precision)

    if spectra.record is None:
        found, times = predict(design, around, spectra, correction), settling_times(design, around, spectra)
        require_force(found, limit)
        excess = worst_excess(design, spectra, spread, correction)
        return _Made(design, around, written(design), found, times, excess, None, None)
    steps: dict = {
        "name": name,
        "limit": limit,
        "pause_s": _pause(design),
        "variance": variance,
        "spread": spread,
    }
    design, around, files, run, learning = settle_on_record(
        design, around, spectra, written, **steps, correction=correction
    )
    found = with_noise(predict(design, around, spectra, correction), run.noise)
    require_force(found, limit)
    require_kept(run, found)
    excess = worst_excess(design, spectra, spread, correction)
    return _Made(design, around, files, found, learning.settled, excess, run, learning)


def _pause(design: IsolationDesign) -> float:
    """s from switching on to the first update."""
    return PAUSES / (2 * np.pi * design.loop.shaping.highpass_hz)


def _written(design: IsolationDesign, limit: float, name: str, precision: str) -> dict[str, str]:
    """Its C, by file."""
    kept = design.steady.weights, design.guard, design.growth
    return isolation_code(design.loop, design.settings, *kept, limit, _pause(design), name, precision)


def _about(machine: str, made: _Made, spectra: FloorSpectra) -> dict:
    """The written JSON."""
    about = {
        "made_by": f"stillwork {stillwork.__version__} isolate",
        "machine": Path(machine).name,
        "floor": spectra.source,
        "rate_hz": made.design.loop.rate,
    } | _record_of(made.design, made.found)
    about["excess"] = list(made.excess)
    about["settling_s"] = [each if np.isfinite(each) else None for each in made.settling]
    if made.run and made.learning:
        about["replay"] = made.run.record() | {"settling": made.learning.record()}
    return about


def _budget_link(machine: str, floor: str, folder: str) -> str:
    """The part of the page on the budget of one axis, whose page stands beside it; of a file that describes a machine, too."""
    if not machine.lower().endswith(".toml") or "machine" not in open_machine_toml(machine):
        return ""
    command = f"python -m stillwork budget {machine} --isolate {folder} --floor {floor} --out {folder}"
    return (
        f"<h2>How still a stage on it stands</h2>\n<p><code>{html.escape(command)}</code> writes "
        f'<a href="{html.escape(Path(machine).stem)}.budget.html">the error budget</a> beside this page: the stage, its controller '
        "and the other sources are tables of the TOML file.</p>"
    )


def _answer(source: str, made: _Made, spectra: FloorSpectra, spread: float) -> list[str]:
    """What was chosen and what it promises, one line each."""
    design, found, settling = made.design, made.found, made.settling[1]
    loop, rows = design.loop, remains_rows(found, spectra)
    columns = [", ".join(row[k] for row in rows) for k in (1, 4, 5, 6)]
    least = f"at least {columns[1]}; " if found.remains[0].all() else ""
    settles = f"settled from zero weights in {settling:.3g} s at most"
    if settling == 0:
        settles = "for which zero weights are as good"
    return [
        *_does_not_pay(found),
        f"{source}: {type(design.settings).__name__} at {loop.shaping.highpass_hz:.3g} to {loop.shaping.lowpass_hz:.4g} Hz with a "
        f"time constant of {design.time_constant:.3g} s, {settles}, and a skyhook of "
        f"{loop.gain:.3g} N s/m",
        f"it leaves at most {columns[2]} m/s^2 rms ({least}{columns[0]} without control) at {found.band_hz[0]:g} to "
        f"{found.band_hz[1]:.4g} Hz, at all {ENDS + DRAWS} isolators tried within {100 * spread:g} %: {columns[3]}; commands reach at most "
        f"{_listed(found.force[2])} N{_kept_often(made.run)}",
        f"weights that have settled {made.remainder()}",
    ]


def _kept_often(run: Replay | None) -> str:
    """What is said of a record that keeps the weights for more than `OFTEN` of its time."""
    if run is None or run.kept <= OFTEN:
        return ""
    return f"; weights are kept {100 * run.kept:.0f} % of the time on this record"


def _does_not_pay(found: IsolationPrediction) -> list[str]:
    """A sentence where the feedforward is not expected to leave less than the skyhook alone, or than no control."""
    expected, alone, bare = map(np.linalg.norm, (found.remains[1], found.feedback, found.without))
    if expected < min(alone, bare):
        return []
    cure = "take the passive isolator" if bare <= alone else "take the skyhook alone"
    return [
        f"the feedforward does not pay on this floor: all axes together {expected:.3g} m/s^2 rms are expected with it, {alone:.3g} "
        f"with the skyhook alone, {bare:.3g} without control; {cure}, or give quieter sensors"
    ]


def _settling_words(settling: tuple[float, float], shown: str) -> str:
    """How long weights take from zero."""
    goal = f"to {WITHIN:g} times the power of what remains: "
    if settling[1] == 0:
        return goal + "zero weights leave no more than that, as designed and in the box"
    return goal + f"{settling[0]:.3g} s, in the box at most {settling[1]:.3g} s; {shown}"


def _record_of(design: IsolationDesign, found: IsolationPrediction) -> dict:
    """The numbers of a design and its prediction, as the written JSON has them."""
    loop, own = design.loop, design.isolator
    return {
        "isolator": {
            **{name: getattr(own, name).tolist() for name in ("mass", "damping", "stiffness", "floor")},
            "actuator_pole_hz": own.actuator_pole / (2 * np.pi),
            "delay_s": own.delay,
            "floor_noise": own.floor_noise,
            "platform_noise": own.platform_noise,
        },
        "skyhook_gain": loop.gain,
        "cutoff_hz": loop.cutoff_hz,
        "beta": loop.beta,
        "highpasses": loop.highpasses,
        "band_hz": [loop.shaping.highpass_hz, loop.shaping.lowpass_hz],
        "algorithm": type(design.settings).__name__,
        "step": design.step,
        "time_constant_s": design.time_constant,
        "variance": design.variance,
        "smoothing_s": loop.smoothing,
        "path_delay": loop.path_delay,
        "weights": design.steady.weights.tolist(),
        "judged_hz": list(found.band_hz),
        "remains": found.remains.tolist(),
        "without": found.without.tolist(),
        "command_rms": found.force[0].tolist(),
        "command_rms_highest": found.force[1].tolist(),
        "command_peak": found.force[2].tolist(),
    }


def _report(made: _Made, spectra: FloorSpectra, facts: list[list[str]], **given: str) -> str:
    """The page of a design; `given` are its other words."""
    design, around, found = made.design, made.around, made.found
    columns = ["axis", "without control", "skyhook alone", "expected", "lowest", "highest", "class"]
    return page(
        "isolate.html",
        kind=": a feedforward",
        floor=html.escape(spectra.source),
        facts=table([], facts),
        remains=table(columns, remains_rows(found, spectra)),
        low=f"{found.band_hz[0]:g}",
        time=f"{spectra.duration:.3g}",
        high=f"{found.band_hz[1]:.4g}",
        transmissibility=picture(paint_transmissibility(design, found), "transmissibility of every axis"),
        certificate=table(
            ["", "found", f"worst at {ENDS} ends of the box and {DRAWS} places in it", "limit"],
            certificate_rows(design, around),
        ),
        **given,
    )


def _replayed(made: _Made, limit: float) -> str:
    """The part of the page on the record that ran through the loop."""
    run, learning, found = made.run, made.learning, made.found
    if run is None or learning is None:
        return ""
    saturated = (
        f"{run.saturated[0]} samples frozen and {run.saturated[1]} adapting at the limit of {limit:g} N"
        if np.isfinite(limit)
        else "no limit was given"
    )
    return (
        f"<h2>The record, run through the loop</h2>\n<p>{run.ran}, around the isolator as given, from settled filters on and "
        f"with noise at its sensors. Largest command: {_listed(run.peak[0].max(axis=1))} N with frozen weights, "
        f"{_listed(run.peak[1].max(axis=1))} N adapting, of which the sensors' noise alone makes up to {_listed(run.noise)} N, which "
        f"is added to what commands reach; {saturated}. While the floor was too loud to learn from, and some "
        f"periods of the band after it, the weights were kept: {100 * run.kept:.2g} % of the time. Each minute (rms, m/s<sup>2</sup>, of every axis):</p>\n"
        + table(["minute", "without control", "frozen", "adapting"], replay_rows(run))
        + picture(paint_replay(run, found, limit), "motion and command over the record")
        + f"<p>Weights from zero: {html.escape(learning.sentence())}.</p>\n"
        + picture(paint_learning(learning), "remaining motion while weights learn from zero")
    )


def facts_of(design: IsolationDesign, found: IsolationPrediction, spectra: FloorSpectra) -> list[list[str]]:
    """What was chosen, and the commands that follow."""
    loop, isolator = design.loop, design.isolator
    algorithm = type(design.settings).__name__
    return [
        [
            "isolator",
            f"{pluralise(isolator.axes, 'actuator')}, modes at {_listed(isolator.frequencies_hz)} Hz",
        ],
        ["skyhook gain", f"{loop.gain:.4g} N s/m on each axis"],
        ["weak integrators", f"third order, cut-off {loop.cutoff_hz:g} Hz, beta {loop.beta:.4g} 1/s"],
        [
            "high-pass of the floor sensors",
            f"{pluralise(loop.highpasses, 'time')} 1 - (a / (s + a))^3 with that cut-off",
        ],
        ["band", f"{loop.shaping.highpass_hz:.3g} to {loop.shaping.lowpass_hz:.4g} Hz"],
        [
            "adaptation",
            f"{algorithm} of the modified filtered error, path {pluralise(loop.path_delay, 'sample')} late, "
            f"{_step(design, algorithm)}, time constant {design.time_constant:.3g} s; a low-pass of {loop.smoothing:.2g} s from "
            "the weights to the command",
        ],
        ["what sets the time constant", _slowed(design)],
        [
            "weights are kept",
            f"while slow motion is above {CREST:g} times its rms on this floor; where a floor stays louder, above up to "
            f"{design.growth:.3g} times that",
        ],
        [
            "scatter of the weights",
            f"raises the power of what remains by {100 * design.variance:.2g} %, by theory with an allowance for bursts"
            + ("" if spectra.record is None else "; what the record itself shows is measured"),
        ],
        [
            "command",
            f"{_listed(found.force[0])} N rms, the largest expected at {ENDS} ends of the box and {DRAWS} places in it; over "
            f"another {spectra.duration:.3g} s up to {_listed(found.force[1])} N rms, and at most {_listed(found.force[2])} N: "
            + (
                "Rice's peak at that rms"
                if spectra.record is None
                else "the record's peak, scattered as the rms and the peaks of Gaussian motion are; footfalls of uneven strength exceed "
                "it in one stretch of 12 or fewer"
            ),
        ],
        *_condition(spectra),
    ]


def _slowed(design: IsolationDesign) -> str:
    """Why it adapts no faster, and what would let it."""
    count, low = len(design.steady.correlation), design.loop.shaping.highpass_hz
    if design.time_constant < FASTER * PERIODS * count / low:
        return (
            f"{PERIODS:g} periods of the band's lower end for each of {pluralise(count, 'regressor')}: shorter with a band that "
            "begins higher or with fewer floor sensors"
        )
    if FASTER * design.certificate.slow > LIMIT:
        return "slow motion through what is not known of the path: shorter with a smaller spread"
    return "the scatter of the weights, expected or on the record itself: shorter with a larger variance"


def _condition(spectra: FloorSpectra) -> list[list[str]]:
    """What a record cannot show of how far its floor's strength goes; the shares are those of `tests/shared/test_levels.py`."""
    if spectra.record is None:
        return []
    slow, slower = spectra.duration / 15, spectra.duration / 6
    return [
        [
            "what is called highest",
            f"is meant to be exceeded by one stretch of {spectra.duration:.3g} s in a hundred; but where the floor's strength "
            f"wanders over {slow:.2g} s, by one in 12 or fewer, over {slower:.2g} s by one in 6 or fewer: then record longer",
        ]
    ]


def findings(
    design: IsolationDesign, around: list[IsolationDesign], found: IsolationPrediction, spectra: FloorSpectra
) -> list[str]:
    """The certificate and what remains, one line each."""
    return [
        *(
            f"{row[0]}: {row[1]}, worst that was tried in the box {row[2]}, limit {row[3]}"
            for row in certificate_rows(design, around)
        ),
        f"remains at {found.band_hz[0]:g} to {found.band_hz[1]:.4g} Hz (m/s^2):",
        *(
            f"  axis {row[0]}: {row[4]} to {row[5]}, without control {row[1]}; {row[6]}"
            for row in remains_rows(found, spectra)
        ),
    ]


def require_force(found: IsolationPrediction, limit: float) -> None:
    """Refuse a `limit` that commands may reach: a command at its limit isolates nothing."""
    largest = float(found.force[2].max())
    if limit < largest:
        raise InputError(
            f"not to be switched on: limit is {limit:g} N, and on this floor a command reaches {largest:.4g} N; give "
            f"{1.001 * largest:.4g} N or more, or start the band at a higher frequency"
        )


def read_isolator(file: str, rate: float):
    """Isolator, the controller's estimate of it, its measured response or None, frequencies to notch in Hz, and notes.

    The file is TOML with [isolator] (``mass`` in kg, ``damping`` in N s/m and ``stiffness`` in N/m along the actuators, a
    number or a matrix, of one axis by default those of [machine]; ``actuator_pole_hz``; ``delay_s`` from sample to force, by
    default one sample; ``floor``, the motion of each axis's foot per floor sensor, by default one sensor for each;
    ``notches_hz``; ``anti_alias``, whether the platform's sensors are sampled through a filter below half the rate, by default
    where a response is given; ``response``, a file in the same folder of the measured response, to which what is left out is fitted)
    and optionally [noise] (``floor`` and ``platform``, m/s^2/sqrt(Hz)) and [estimate] (values of the mechanics other than
    delay and floor that the controller assumes instead). Or it is the measured response alone.
    """
    path = Path(file)
    if path.suffix.lower() != ".toml":
        f, seen, notes = read_response(path)
        fitted = _fitted((f, seen), rate, True, notes)
        notes.append(
            f"one floor sensor for each axis, sensor noise {QUIET:g} m/s^2/sqrt(Hz); to change this give a TOML file"
        )
        own = Isolator(
            fitted.mass, fitted.damping, fitted.stiffness, np.eye(len(fitted.mass)), fitted.actuator_pole, fitted.delay,
            QUIET, QUIET,
        )  # fmt: skip
        notes.append(THROUGH)
        return own, own, (f, seen), (), notes, True
    whole = open_machine_toml(file)
    own = own_table(whole, "isolator", "isolate")
    own.require_known(KNOWN["isolator"])
    noise, other = (
        whole.table(name) if name in whole else Table({}, whole.where) for name in ("noise", "estimate")
    )
    noise.require_known(KNOWN["noise"])
    other.require_known(KNOWN["estimate"])  # the filters invert no delay, and the floor's path is learnt
    notes, measured = [], None
    if "response" in own:
        f, seen, notes = read_response(path.parent / str(own["response"]))
        measured = f, seen
    filtered = require_flag("anti_alias", own.get("anti_alias", measured is not None))
    table_of = Table({**_mechanics_of(whole, own, measured, rate, filtered, notes), **own}, own.where)
    isolator = _isolator(table_of, noise, rate)
    estimate = _isolator(Table({**table_of, **other}, whole.where), noise, rate) if other else isolator
    notches = require_array("notches_hz", own.get("notches_hz", []), ndim=1).tolist()
    if measured is not None and measured[1].shape[1] != isolator.axes:
        raise InputError(
            f"response is of {measured[1].shape[1]} axes, the isolator has {isolator.axes}; give the same"
        )
    if measured is not None and "anti_alias" not in own:
        notes.append(THROUGH)
    if not filtered:
        notes.append(
            "the platform's sensors are sampled without an anti-alias filter: what the steps of the held command fold into their "
            "readings is taken off; with such a filter give anti_alias = true"
        )
    return isolator, estimate, measured, tuple(notches), notes, filtered


def _mechanics_of(whole: Table, own: Table, measured, rate: float, filtered: bool, notes: list[str]) -> dict:
    """What [isolator] leaves out of the mechanics: of a measured response fitted to it, else by [machine]."""
    if {"mass", "damping", "stiffness"} & {*own}:
        return {}
    if measured is None:
        if "machine" not in whole:
            raise InputError(
                f"{own.where}: holds neither mass, damping and stiffness nor a response, and the file no table [machine]; "
                "give one of the three"
            )
        return suspended(whole)
    fitted = _fitted(measured, rate, filtered, notes)
    return {
        **{name: getattr(fitted, name) for name in ("mass", "damping", "stiffness")},
        "actuator_pole_hz": fitted.actuator_pole / (2 * np.pi),
        "delay_s": fitted.delay,
    }


def _fitted(
    measured: tuple[np.ndarray, np.ndarray], rate: float, filtered: bool, notes: list[str]
) -> PathFit:
    """The mechanics fitted to a measured response (lines in Hz, their values); the relative error is noted."""
    f, seen = measured
    fitted = fit_path(f, seen, rate, folds=not filtered)
    notes.append(f"mechanics fitted to {len(f)} lines, error {100 * fitted.residual:.2g} % of the response")
    return fitted


def _isolator(given: Table, noise: Table, rate: float) -> Isolator:
    read = (require_array(name, given[name]) for name in ("mass", "damping", "stiffness"))
    mass, damping, stiffness = (each if each.ndim == 2 else np.diag(np.atleast_1d(each)) for each in read)
    return Isolator(
        mass,
        damping,
        stiffness,
        floor=require_array("floor", given.get("floor", np.eye(len(mass))), ndim=2),
        actuator_pole=2 * np.pi * require_number("actuator_pole_hz", given["actuator_pole_hz"], above=0.0),
        delay=require_number("delay_s", given.get("delay_s", 1 / rate)),
        floor_noise=require_number("noise: floor", noise.get("floor", QUIET)),
        platform_noise=require_number("noise: platform", noise.get("platform", QUIET)),
    )


def read_response(path: Path) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Frequencies in Hz, (lines, axes, axes) of (m/s^2)/N, and notes: one response, or a matrix of outputs by inputs."""
    names = list(complex_responses(read_arrays(path)))
    several = names if len(names) > 1 else [""]
    axes = round(np.sqrt(len(several)))
    if axes**2 != len(several):
        raise InputError(
            f"{path.name} holds {len(several)} responses; give one from each actuator to each sensor"
        )
    read = [load_machine(path, response=each) for each in several]
    if any(each.accelerance is None or each.units[0] != "m" for each in read):
        raise InputError(
            f"{path.name} is no frequency response of an acceleration; give that of the platform per command"
        )
    omega = read[0].accelerance.omega
    if any(len(each.accelerance.omega) != len(omega) for each in read):
        raise InputError(f"{path.name}: some responses are zero at some lines; leave these lines out")
    rows = np.array([each.accelerance.response for each in read]).reshape(axes, axes, -1)
    notes = [note for note in read[0].notes if "unit" in note]
    return omega / (2 * np.pi), np.moveaxis(rows, -1, 0).astype(complex), notes


def unmodelled(isolator: Isolator, measured, rate: float, filtered: bool = True):
    """Measured P2 less the isolator's, at frequencies in Hz: linear between lines, zero beyond them.

    What was measured through an anti-alias filter (`filtered`) is without what sampling folds, else with it.
    """
    lines, seen = measured
    _, held, sampled = isolator.paths(lines, 1 / rate)
    off = (seen - (held if filtered else sampled)).reshape(len(lines), -1)

    def more(f):
        moved = np.stack([np.interp(f, lines, each, left=0.0, right=0.0) for each in off.T], axis=1)
        return moved.reshape(-1, isolator.axes, isolator.axes)

    return more


def read_floor(
    file: str, unit: str, sensors: int, rate: float, channels: list[str], record_hz: float = 0.0
) -> tuple[FloorSpectra, list[str], list[str]]:
    """Cross spectra of a file's channels, of as many as `sensors` at most, below 0.45 times the rate.

    Also notes, and what may disturb the adaptation. `record_hz` is a record's sample rate; 0: as the file states.
    """
    path = Path(file)
    columns = read_columns(path)
    spectral = density_unit(unit) if unit else any(map(stated_density, columns))
    if not unit and not spectral and frequency_axis(columns):
        raise InputError(
            f"{path.name} holds spectra over frequency, whose unit neither it nor --unit states; give --unit, a density as "
            f"{DENSITY_UNITS_TEXT}"
        )
    notes = []
    if spectral:
        f, rows = read_densities(path, unit, channels, sensors)
        lines = np.arange(SLOWEST_HZ, min(f[-1], 0.45 * rate), SLOWEST_HZ)
        rows = np.array([np.interp(lines, f, row) for row in rows])
        density = rows.T[:, :, None] * np.eye(len(rows))
        notes.append("the signals of the floor sensors are independent of each other")
        rms = float(np.sqrt(SLOWEST_HZ * rows.sum(axis=1).max()))
        require_floor_level(path.name, unit, rms, rms)
        spectra, known = binned(lines, density, LISTENED_S, f"spectra of {path.name}"), float(f[0])
        seen, slow = [], slow_ratio(lines, rows)
    else:
        record = to_acceleration(
            load_record(
                path,
                unit,
                sample_rate=record_hz or None,
                channels=channels or None,
                most_channels=sensors,
            )
        )
        peak, rms = np.abs(record.signals).max(), record.signals.std(axis=1).max()
        require_floor_level(record.source, unit, float(peak), float(rms))
        spectra = floor_spectra(record.signals, record.sample_rate, record.source, LINE_HZ, SLOWEST_HZ)
        if (drift := np.abs(np.asarray(spectra.drift)).max()) > 0:
            notes.append(
                f"what of the record is slower than 0.01 Hz, by up to {60 * drift:.2g} m/s^2 a minute, is a drift of its sensors: it is "
                "taken off, and the force that it makes is added to what commands reach"
            )
        top = min(0.45 * rate, PASS_SHARE * record.sample_rate / 2)
        kept = spectra.frequencies_hz < top
        spectra = replace(
            spectra, frequencies_hz=spectra.frequencies_hz[kept], widths_hz=spectra.widths_hz[kept],
            density=spectra.density[kept],
        )  # fmt: skip
        seen = [*record.notes, *sensor_faults(record.signals, record.sample_rate)]
        whole = estimate_spectrum(record.signals, record.sample_rate, LINE_HZ)
        slow, known = slow_ratio(whole.frequencies_hz, whole.density), float(spectra.frequencies_hz[0])
        spectra = _down_to(SLOWEST_HZ, spectra)
    if known > 2 * SLOWEST_HZ:
        notes.append(
            f"below {known:.3g} Hz, where the floor is unknown, its density is that at {known:.3g} Hz"
        )
    if slow > SLOW_RATIO:
        seen.append(
            f"At {SLOW_HZ[0]:g} to {SLOW_HZ[1]:g} Hz the floor's acceleration per √Hz is {slow:.2g} times that at "
            f"{HEARD_HZ[0]:g} to {HEARD_HZ[1]:g} Hz: the weak integrators pass it on, so the adaptation is made slower and "
            "the high-pass of the floor sensors stronger, which isolates less in the band."
        )
    return spectra, notes, seen


def at_sensors(spectra: FloorSpectra, sensors: int, notes: list[str]) -> FloorSpectra:
    """The spectra of every sensor; one channel gives that of each, their motions being independent, which is noted."""
    channels = spectra.density.shape[1]
    if channels == 1 < sensors:
        notes.append(f"each of the {sensors} floor sensors has the spectrum of this one, independently")
        record = spectra.record
        if record is not None:  # each sensor at another time of it
            record = np.array([np.roll(record[0], k * (record.shape[1] // sensors)) for k in range(sensors)])
        drift = None if spectra.drift is None else np.repeat(spectra.drift, sensors)
        spectra = replace(spectra, density=spectra.density * np.eye(sensors), record=record, drift=drift)
    elif channels != sensors:
        raise InputError(
            f"{spectra.source} holds {pluralise(channels, 'channel')}, the isolator has {pluralise(sensors, 'floor sensor')}; "
            "give as many, or one"
        )
    return spectra


def _down_to(lowest_hz: float, spectra: FloorSpectra) -> FloorSpectra:
    """Lines from `lowest_hz` on: below the first line of a short record the density is that of the first line."""
    first, width = spectra.frequencies_hz[0], spectra.widths_hz[0]
    count = int((first - width / 2) / lowest_hz)
    if count < 1:
        return spectra
    widths = np.full(count, (first - width / 2) / count)
    return replace(
        spectra,
        frequencies_hz=np.concatenate([np.cumsum(widths) - widths / 2, spectra.frequencies_hz]),
        widths_hz=np.concatenate([widths, spectra.widths_hz]),
        density=np.concatenate([np.repeat(spectra.density[:1], count, axis=0), spectra.density]),
    )


def _step(design: IsolationDesign, algorithm: str) -> str:
    return f"lambda = 1 - {design.step:.4g}" if algorithm == "FeRls" else f"mu = {design.step:.4g}"


def _listed(values) -> str:
    return ", ".join(f"{value:.4g}" for value in values)


def certificate_rows(design: IsolationDesign, around: list[IsolationDesign]) -> list[list[str]]:
    """Each quantity of the certificate: as designed, worst of those tried in the box, and its limit."""
    own, box = design.certificate, [each.certificate for each in around]
    phase = max(box, key=lambda each: each.phase_deg)
    slow = max(each.slow for each in box)
    lowest = SLOWEST if isinstance(design.settings, FeRls) else 0.0
    return [
        [
            "phase of the path error (degrees)",
            f"{own.phase_deg:.0f} at {own.phase_hz:.3g} Hz",
            f"{phase.phase_deg:.0f} at {phase.phase_hz:.3g} Hz",
            f"{HIGHEST_PHASE:g}",
        ],
        [
            "smallest eigenvalue of the mean update",
            f"{own.slowest:.3g}",
            f"{min(each.slowest for each in box):.3g}",
            f"{lowest:g}",
        ],
        [
            "peak of the skyhook loop (dB)",
            f"{own.sensitivity_db:.2f}",
            f"{max(each.sensitivity_db for each in box):.2f}",
            f"{HIGHEST_SENSITIVITY_DB:g}",
        ],
        [
            "gain of the floor's slow motion through what the error does not know of the path",
            f"{own.slow:.3g} (could be {LIMIT / own.slow:.3g} times larger)",
            f"{slow:.3g}",
            f"{LIMIT:g}",
        ],
    ]


def remains_rows(found: IsolationPrediction, floor: FloorSpectra) -> list[list[str]]:
    """Rms of every axis without control, with the skyhook, expected, lowest, highest, and the class of the highest."""
    rows = []
    f = floor.frequencies_hz
    for k in range(len(found.without)):
        low, expected, high = found.remains[:, k]
        # The class of the highest: the expected spectrum as much larger.
        name = "not judged: the floor's spectrum ends below 90 Hz"
        if f[-1] > 90:
            name = criterion_met(*one_third_octave_velocity(f, found.density[k] * (high / expected) ** 2))
        values = (found.without[k], found.feedback[k], expected, low, high)
        rows.append([str(k + 1), *(f"{value:.3g}" if value else "unknown" for value in values), name])
    return rows


@pictures.house_style()
def paint_transmissibility(design: IsolationDesign, found: IsolationPrediction):
    """Transmissibility of every axis: without control, expected, and the band over the box."""
    axes_count = len(found.without)
    columns = min(axes_count, 3)
    figure, panels = pictures.new(-(-axes_count // columns), columns, squeeze=False, sharex=True, sharey=True)
    f = design.paths.seen.frequencies_hz
    shown = (f > 0.3) & (f < 2 * design.loop.shaping.lowpass_hz)

    def decibels(values):
        return 20 * np.log10(values[shown])

    for k, axis in enumerate(panels.flat[:axes_count]):
        low, expected, high = found.transmissibility[:, k]
        axis.fill_between(
            f[shown], decibels(low), decibels(high), color=pictures.SKY, alpha=0.5, label="over the box"
        )
        axis.semilogx(
            f[shown],
            decibels(found.without_transmissibility[k]),
            color=pictures.GREY,
            label="without control",
        )
        axis.semilogx(f[shown], decibels(expected), color=pictures.BLUE, label="expected")
        axis.set(title=f"axis {k + 1}", xlabel="frequency (Hz)")
    panels[0, 0].set_ylabel("transmissibility (dB)")
    panels[0, 0].legend()
    return figure
