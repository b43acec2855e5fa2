"""The command ``budget``: how still a machine can be, what limits it and what to buy next, on one page."""

import html
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from stillwork.base.checks import InputError
from stillwork.base.extras import require_package
from stillwork.base.toml_files import Table
from stillwork.control.budget import (
    ErrorBudget,
    Network,
    Source,
    UnstableLoop,
    error_budget,
    tone_response,
)
from stillwork.control.budget_sources import (
    white,
)
from stillwork.control.floor_machine import FloorMachine
from stillwork.control.pid import Pid, PidFamily
from stillwork.machine import pictures
from stillwork.machine.budget_tables import NUMBERS, PLACES, MachineFile, machine_of, number_of, open_machine
from stillwork.machine.html_page import page, picture, table

STABLE_SHARES = (
    0.8,
    0.6,
    0.4,
    0.2,
    0.1,
    0.05,
    0.02,
)  # of the bandwidth, tried if the loop is unstable
CALM = 0.01  # of its largest acceleration, below which a setpoint counts as not accelerating
EDGE = 0.05  # share of a source's power in the third of an octave at the end of its band, above which it is reported
# Typical levels of such parts, in words and as the upper end.
TYPICAL = {
    "floor": ("VC-A (general laboratory) to VC-G (quiet)", 1e-3),
    "stage force": ("cables, hoses and air: 1e-4 to 1e-2 N/sqrt(Hz)", 1e-2),
    "frame force": ("acoustics and pumps: 1e-3 to 1e-1 N/sqrt(Hz)", 1e-1),
    "stage sensor": ("encoder 0.01 to 1 nm/sqrt(Hz), interferometer 1e-3 to 0.1", 1e-9),
    "frame sensor": ("piezo accelerometer 1e-7 to 1e-5 m/s^2/sqrt(Hz)", 1e-5),
    "floor sensor": ("piezo accelerometer 1e-7 to 1e-5 m/s^2/sqrt(Hz)", 1e-5),
    "stage drive": ("amplifier and DAC: 1e-5 to 1e-3 N/sqrt(Hz)", 1e-3),
    "isolator drive": ("amplifier and DAC: 1e-4 to 1e-2 N/sqrt(Hz)", 1e-2),
}
# Methods that are offered to a machine without them, with usual sizes (chosen).
OFFERED: dict[str, dict[str, Any]] = {
    "a skyhook of 0.6": {"skyhook": 0.6},
    "a feedforward of 20 dB": {"feedforward": 0.9},
    "both": {"skyhook": 0.6, "feedforward": 0.9},
}
SENSORS = {"skyhook": "frame sensor", "feedforward": "floor sensor"}  # that a method needs
WAYS = {"lower": 0.9, "higher": 1.1}
SEEN = 1e-3  # of the error, which is printed to three digits: a smaller change is not shown
COUNTS, NOTHING = (
    7.0,
    1e6,
)  # times the typical level: adds 2 % of the power; only rounding, so there is no path


def budget_file(
    machine: str, floor: str = "", design: str = "", isolate: str = "", out: str = "", verbose: bool = False
) -> list[str]:
    """Compute the error budget of a machine and write it on one page.

    Parameters
    ----------
    machine : str
        TOML of machine, controllers and sources; ``stillwork new`` writes a template.
    floor : str
        A record or spectral densities of the floor that replace the file's; their columns state the unit.
    design : str
        Folder that ``stillwork design`` wrote, or one controller's JSON file in it: its model and controller replace the
        stage and its PID.
    isolate : str
        Folder that ``stillwork isolate`` wrote, or the JSON file in it, of one axis: its isolator and settled feedforward
        replace the frame's mass, the suspension, skyhook and feedforward, and the noise of its sensors where the file has none.
    out : str
        Folder of the page; empty: the current folder.
    verbose : bool
        Whether to return all findings, which are on the page.

    Returns
    -------
    list of str
        How still it is, what limits it and what to buy next, and where the page is; with `verbose` then the findings.

    Raises
    ------
    InputError
        When a source has another unit than its place, a file cannot be used, or the loop is unstable.
    """
    require_package("matplotlib")
    file = open_machine(machine, floor, design, isolate)
    entries, built, sources, band = file.entries, file.machine, file.sources, file.band
    target = Path(out or ".") / f"{Path(machine).stem}.budget.html"
    if target.exists():
        raise InputError(f"{target} exists; move it away, or give another --out")
    try:
        network = built.network()
    except UnstableLoop as error:
        raise UnstableLoop(f"{error}; {_what_would_be_stable(built)}") from None
    budget = error_budget(network, sources, band)
    rows = {
        "what it is": _summary(entries, budget),
        "where it comes from": _parts(budget),
        "while it moves": _moving(network, sources, band),
        "over the stage's positions": [] if design else _positions(file),
        "what to buy next": purchases(file, budget),
        "what each method gives": waterfall(file),
        "what is not known": _unknown(network, sources, band, budget),
    }
    body = [f"<h2>{title.capitalize()}</h2>\n{table([], each)}" for title, each in rows.items() if each]
    body.insert(
        min(2, len(body)),
        picture(paint_budget(budget), "spectra and cumulative spectra of the error by source"),
    )
    target.parent.mkdir(parents=True, exist_ok=True)
    held = html.escape(Path(machine).read_text(encoding="utf-8"))
    title = html.escape(str(entries.get("name", Path(machine).stem)))
    answer = _answer(rows, str(entries.get("name", Path(machine).stem)))
    body[:0] = [f"<p>{html.escape(line)}</p>" for line in answer]
    target.write_text(page("report.html", source=title, body="\n".join(body), held=held), encoding="utf-8")
    answer = [*answer, f"page: {target}"]
    if not verbose:
        return answer
    return [*answer, *(f"{name}: {'; '.join(map(' '.join, each))}" for name, each in rows.items() if each)]


def _answer(rows: dict[str, list[list[str]]], name: str) -> list[str]:
    """How still the machine is, what limits it and what to buy next."""
    parts, bought = rows["where it comes from"], rows["what to buy next"]
    still = ", ".join(map(" ".join, rows["what it is"]))
    return [
        f"{name}: {still}",
        f"it is limited by {parts[0][0]} ({parts[0][2]} of the power); "
        + (
            f"to buy next: {' '.join(bought[0][1:])}"
            if bought
            else "nothing that was tried saves a thousandth"
        ),
    ]


def _what_would_be_stable(built: FloorMachine) -> str:
    """A change of one of the machine's two loops that makes it stable, in words."""
    changes: dict[str, dict[str, Any]] = {}
    if built.skyhook:
        changes["without the skyhook (skyhook_damping = 0)"] = {"skyhook": 0.0}
    if isinstance(built.controller, Pid):
        hertz = 3 * built.controller.differentiator / (2 * np.pi)
        for share in STABLE_SHARES:
            law = PidFamily(built.stage_mass)(share * hertz)
            changes[f"with a bandwidth of {share * hertz:.3g} Hz"] = {"controller": law}
    if built.delay:
        changes["without the delay"] = {"delay": 0.0}
    for words, changed in changes.items():
        try:
            replace(built, **changed).network()
        except UnstableLoop:
            continue
        return f"it is stable {words}"
    return "no smaller bandwidth, skyhook or delay alone makes it stable; check the modes' shares and their signs"


def _summary(entries: Table, budget: ErrorBudget) -> list[list[str]]:
    rms, (low, high) = budget.rms[0], budget.interval()[:, 0]
    exposure, duration = (
        number_of(entries, name, default) for name, default in (("exposure_s", 0.01), ("duration_s", 60.0))
    )
    average, deviation = budget.moving(exposure)
    rows = [
        ["rms", nanometres(rms)],
        ["3 sigma", nanometres(3 * rms)],
        [f"peak in {duration:g} s", nanometres(budget.peak(duration)[0])],
    ]
    if high - low > 1e-5 * rms:
        rows.insert(1, ["95 % interval from the records' length", f"{nanometres(low)} to {nanometres(high)}"])
    return [
        *rows,
        [f"MA over {exposure:g} s", nanometres(average[0])],
        [f"MSD over {exposure:g} s", nanometres(deviation[0])],
    ]


def _moving(network: Network, sources: list[Source], band: tuple[float, float]) -> list[list[str]]:
    """Error under each periodic setpoint: rms over the period, largest, and rms while it does not accelerate."""
    rows = []
    for source in sources:
        if source.places[0] != "setpoint":
            continue
        lines = np.array(source.tones)
        period = 1 / lines[0, 0].real
        t = np.linspace(0.0, period, 4 * len(lines), endpoint=False)
        error = tone_response(network, source, t, band)[0]
        waves = np.exp(2j * np.pi * np.outer(t, lines[:, 0].real))
        pull = np.abs((waves @ (-((2 * np.pi * lines[:, 0]) ** 2) * lines[:, 1])).real)
        calm = pull < CALM * pull.max()
        rows.append([f"{source.name}: rms over the period", nanometres(error.std())])
        rows.append(["at most", nanometres(np.abs(error).max())])
        if calm.any():
            rows.append(["rms while it does not accelerate", nanometres(np.sqrt(np.mean(error[calm] ** 2)))])
    return rows


def _positions(file: MachineFile) -> list[list[str]]:
    """The error with the stage elsewhere, where its modes have other shares."""
    rows, body = [], file.entries.table("machine")
    for position in body.table("modes_share_at") if "modes_share_at" in body else []:
        try:
            network = machine_of(file.entries, position=position, isolate=file.isolate).network()
            rows.append([position, nanometres(error_budget(network, file.sources, file.band).rms[0])])
        except UnstableLoop as error:
            rows.append([position, str(error)])
    return rows


def nanometres(metres: float) -> str:
    """Three digits, without an exponent where the error is of any interest.

    Examples
    --------
    >>> nanometres(3.5278e-6), nanometres(6.163e-9)
    ('3530 nm', '6.16 nm')
    """
    return f"{float(f'{1e9 * metres:.3g}'):.12g} nm"


def _parts(budget: ErrorBudget) -> list[list[str]]:
    order = np.argsort(-budget.powers[:, 0], kind="stable")
    rows = [
        [budget.names[k], nanometres(budget.rms_by_source[k, 0]), f"{100 * budget.shares[k, 0]:.1f} %"]
        for k in order
    ]
    edges = budget.edges()
    for k, side in zip(*np.nonzero(edges > EDGE), strict=True):
        end = budget.bands_hz[k, side]
        rows.append(
            [
                "warning:",
                f"{budget.names[k]} ends at {end:.4g} Hz in the band,",
                f"{100 * edges[k, side]:.0f} % of its part lies in the last third of an octave; measure further",
            ]
        )
    return rows


def purchases(file: MachineFile, budget: ErrorBudget) -> list[list[str]]:
    """What a change saves (nm), the largest first: each source at half its level, each number of the file 10 % off.

    Each number is changed in the file, either way, and the error computed again. What changes the error by less than
    `SEEN` of it is left out.
    """
    now, offers = budget.rms[0], []
    moving = {source.name for source in file.sources if source.places[0] == "setpoint"}
    for name, saved in zip(budget.names, budget.saved()[:, 0], strict=True):
        half = "half the error that its feedforward leaves" if name in moving else ""
        offers.append((saved, f"{name}: {half}" if half else f"{name} at half its level", {"": now - saved}))
    for name in NUMBERS:
        found = {}
        for way, ratio in WAYS.items():
            if name == "delay" and ratio > 1:
                continue  # a longer one is not an improvement to buy
            changed = file.changed(name, ratio)
            if changed:
                found[f"10 % {way}"] = _error(changed.machine, changed.sources, file.band)
        if found:
            offers.append((now - min(found.values()), f"{name}{_following(file, name)}", found))
    rows: list[list[str]] = []
    for _, words, found in sorted(offers, key=lambda offer: -offer[0]):
        ways = sorted(found, key=lambda way: found[way])
        if any(abs(found[way] - now) > SEEN * now for way in ways):
            told = [f"{way} {_changed(found[way] - now, now)}".strip() for way in ways]
            rows.append([f"{len(rows) + 1}.", f"{words} {told[0]}", *(f"({each})" for each in told[1:])])
    return rows


def _changed(more: float, now: float) -> str:
    if np.isinf(more):
        return "is unstable"
    if abs(more) <= SEEN * now:
        return "changes nothing"
    return f"{'saves' if more < 0 else 'costs'} {nanometres(abs(more))}"


def _following(file: MachineFile, name: str) -> str:
    """Whether the setpoint's feedforward assumes the changed mass."""
    if name != "stage mass":
        return ""
    stated = [
        "feedforward_mass_kg" in file.entries.table("sources").table(source.name)
        for source in file.sources
        if source.places[0] == "setpoint"
    ]
    if not stated:
        return ""
    both = "of some stays as the file states" if any(stated) else "follows"
    return f", whose feedforward {'stays as the file states' if all(stated) else both},"


def waterfall(file: MachineFile) -> list[list[str]]:
    """The error of the passive machine, then with each of its methods in turn, and with those that it lacks.

    A method that is offered comes with the noise of its sensor: that of the file, or the upper end of `TYPICAL`.
    """
    machine, sources, band = file.machine, file.sources, file.band
    if machine.isolator is not None:
        bare = _rms_of(replace(machine, isolator=None), sources, band)
        return [["passive", bare], ["with what isolate wrote", _rms_of(machine, sources, band)]]
    steps = {
        "passive": {"skyhook": 0.0, "feedforward": 0.0},
        "skyhook": {"skyhook": machine.skyhook},
        "feedforward": {"feedforward": machine.feedforward},
    }
    rows, chosen = [], dict[str, Any]()
    for name, changed in steps.items():
        if name == "passive" or any(changed.values()):
            chosen |= changed
            left = _rms_of(replace(machine, **chosen), sources, band)
            rows.append([name if name == "passive" else f"and {name}", left])
    known = {place for source in sources for place in source.places}
    for words, changed in OFFERED.items():
        if any(getattr(machine, name) for name in changed):
            continue
        assumed = [SENSORS[name] for name in changed if SENSORS[name] not in known]
        noises = [white(f"its {place}", place, PLACES[place], TYPICAL[place][1]) for place in assumed]
        left = _rms_of(replace(machine, **changed), [*sources, *noises], band)
        corner = machine.integrator_hz if "feedforward" in changed else machine.skyhook_hz
        row = [f"not present: {words}, acting above {corner:.3g} Hz, would leave", left]
        if assumed:
            levels = " and ".join(
                f"{TYPICAL[place][1]:g} {PLACES[place]}/sqrt(Hz) at the {place}" for place in assumed
            )
            row.append(f"(assumed: {levels})")
        rows.append(row)
    return rows


def _error(machine: FloorMachine, sources: list[Source], band: tuple[float, float]) -> float:
    """Rms of the error, m; infinite if the loop is unstable."""
    try:
        return float(error_budget(machine.network(), sources, band).rms[0])
    except UnstableLoop:
        return np.inf


def _rms_of(machine: FloorMachine, sources: list[Source], band: tuple[float, float]) -> str:
    """The error in words, or that the loop is unstable."""
    try:
        return nanometres(error_budget(machine.network(), sources, band).rms[0])
    except UnstableLoop as error:
        return str(error)


def _unknown(
    network, sources: list[Source], band: tuple[float, float], budget: ErrorBudget
) -> list[list[str]]:
    """Places without a source, the level at which each would double the power, and typical values."""
    known = {place for source in sources for place in source.places}
    missing = [
        place
        for place in PLACES
        if place not in known
        and place in TYPICAL
        and np.any(network.paths([np.sqrt(band[0] * band[1])])[0, list(PLACES).index(place)])
    ]
    if not missing:
        return []
    unit = error_budget(network, [white(place, place, PLACES[place], 1.0) for place in missing], band)
    rows = []
    for place, power in zip(missing, unit.powers[:, 0], strict=True):
        level, (typical, high) = budget.rms[0] / np.sqrt(power), TYPICAL[place]
        if level < NOTHING * high:
            found = "may matter" if level < COUNTS * high else "hardly matters"
            text = f"{level:.2g} {PLACES[place]}/sqrt(Hz) would double the power;"
            rows.append([f"{place}: no source given;", text, f"typical: {typical}; {found}"])
    return rows


@pictures.house_style()
def paint_budget(budget: ErrorBudget):
    """Density and backward cumulative spectrum of the error, by source."""
    figure, (left, right) = pictures.new(1, 2, height=3.2)
    f, smooth = budget.frequencies_hz, ~budget.is_tone
    below = budget.cumulative()[:, 0]
    for number, (name, density) in enumerate(zip(budget.names, budget.density[:, 0], strict=True)):
        # By number, since a tone is drawn on the right alone.
        style = {"color": f"C{number}", "linewidth": 0.9, "label": pictures.literal(name)}
        if density[smooth].any():
            seen = smooth & (density > 0)  # where it is known
            left.loglog(f[seen], 1e9 * np.sqrt(density[seen]), **style)
        right.semilogx(f, 1e9 * np.sqrt(below[number]), **style)
    whole = budget.cumulative()[:, 0].sum(axis=0)
    right.semilogx(f, 1e9 * np.sqrt(whole), color=pictures.BLACK, linewidth=1.3, label="all")
    left.set(
        xlabel="frequency (Hz)", ylabel="error (nm/√Hz)", ylim=(1e-6 * max(left.get_ylim()[1], 1e-12), None)
    )
    right.set(xlabel="frequency (Hz)", ylabel="rms error from all\nhigher frequencies (nm)")
    right.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return figure
