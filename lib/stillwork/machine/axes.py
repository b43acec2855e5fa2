"""The command ``design`` of several axes: a measured matrix, decoupled, a controller an axis, and all of them checked on it."""

import hashlib
import html
import json
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from stillwork.base.checks import InputError, one_line, require_array
from stillwork.base.toml_files import Table
from stillwork.control.machine_loops import in_hertz
from stillwork.identification.machine import TURNED, build_machine
from stillwork.identification.machine_files import load_machine
from stillwork.identification.matrix_files import LEAST_LINES, MatrixFile, load_matrix, natural
from stillwork.machine.axes_loops import FORMAT, AxesLoops, Place, paint_axes, paint_decoupling, sizes
from stillwork.machine.axes_modes import MatrixModes
from stillwork.machine.c_code import axes_code
from stillwork.machine.decoupled import (
    Axes,
    Judged,
    LowEnd,
    decouplings,
    interaction,
)
from stillwork.machine.designed_loop import DesignedLoop, load_design
from stillwork.machine.export import require_free
from stillwork.machine.html_page import page, picture, table
from stillwork.machine.inspect import inspect_file
from stillwork.machine.machine_toml import KNOWN, open_machine_toml, own_table

SLOWER = 0.97  # of a bandwidth that would just do
LEAST = 0.05  # of a bandwidth, the least share that is tried
ROUNDS = 8  # of designs, after which the axes are refused
HALVINGS = 7
# A peak that is so little too large, as a factor: the axis is designed for more gain, by so many times as much and more.
LITTLE, MORE, LEAST_MORE, AGAIN = 1.06, 1.5, 0.005, 2.0  # AGAIN: times, each time that it was not enough
HIGHEST = 0.499  # of the rate


class Wanted(NamedTuple):
    """A matrix, and the decoupling that is given for it, where one is."""

    matrix: MatrixFile
    file: Path
    sensing: np.ndarray | None
    actuation: np.ndarray | None
    names: tuple[str, ...]
    units: tuple[tuple[str, str], ...]


def read_axes(file: str, load_options: Mapping) -> Wanted | None:
    """The matrix response of a file, or of [decoupling] in a machine's TOML; None where it is none."""
    path, table = Path(file), Table({}, file)
    if path.suffix.lower() == ".toml":
        table = own_table(open_machine_toml(path), "decoupling", "design")
        table.require_known(KNOWN["decoupling"])
        path = path.parent / str(table["response"])
    if load_options.get("response"):
        return None
    matrix = load_matrix(path, load_options.get("response_unit", ""), load_options.get("force_unit", ""))
    if matrix is None:
        if table:
            raise InputError(f"{path.name} holds no matrix response; name its entries h11, h12, ...")
        return None
    matrix = _ordered(matrix, table)
    ends = {"sensing": (None, len(matrix.outputs)), "actuation": (len(matrix.inputs), None)}
    given = {
        name: require_array(name, table[name], shape=shape) if name in table else None
        for name, shape in ends.items()
    }
    sensing, actuation = given.values()
    count = (
        len(sensing)
        if sensing is not None
        else len(matrix.outputs)
        if actuation is None
        else actuation.shape[1]
    )
    if actuation is not None and actuation.shape[1] != count:
        raise InputError(f"sensing is for {count} axes, actuation for {actuation.shape[1]}; give the same")
    if (sensing is None and len(matrix.outputs) != count) or (
        actuation is None and len(matrix.inputs) != count
    ):
        raise InputError(
            f"{matrix.source} holds {len(matrix.outputs)} outputs and {len(matrix.inputs)} inputs ({matrix.example}); choose as "
            "many of each, or give both sensing and actuation of a table [decoupling], or one response with --response"
        )
    for name, each in given.items():
        if each is not None and (rank := np.linalg.matrix_rank(each)) < count:
            raise InputError(
                f"{name} has rank {rank}, and {count} axes: its {'rows' if name == 'sensing' else 'columns'} depend on each other; "
                "give one of its own to each axis"
            )
    names, units = _labels(table, count, matrix.units)
    if actuation is None and (drives := {u for _, u in units} - {matrix.units[1]}):
        # Each axis of a computed T_u has the unit of its largest actuator.
        if not matrix.notes:
            raise InputError(
                f"units has forces in {' and '.join(sorted(drives))}, but those of the actuators are in {matrix.units[1]}, and so are the "
                f"axes' without actuation; give actuation, of the geometry, or units with {matrix.units[1]}"
            )
        held = "the axes' forces are in the unit of each one's largest actuator, taken to be as units states"
        matrix = matrix._replace(notes=(*matrix.notes, held))
    return Wanted(matrix, path, sensing, actuation, names, units)


def _labels(
    table: Table, count: int, units: tuple[str, str]
) -> tuple[tuple[str, ...], tuple[tuple[str, str], ...]]:
    """Names and units of the axes; those of axes that are not known before they are found are refused."""
    for name, needed in (("axes", ("sensing", "actuation")), ("units", ("sensing",))):
        if name in table and not any(each in table for each in needed):
            raise InputError(
                f"{name} is given without {' or '.join(needed)}: which axes are found, in what order and in whose unit, is not known "
                f"before; give sensing, whose rows are the axes, or leave {name} out"
            )
    names = tuple(map(str, table.get("axes", [f"axis {k + 1}" for k in range(count)])))
    pairs = table.get("units", [units] * count)
    formed = isinstance(pairs, Sequence) and not isinstance(pairs, str)
    if not formed or not all(
        isinstance(each, Sequence) and not isinstance(each, str) and len(each) == 2 for each in pairs
    ):
        raise InputError(
            f"units is {pairs!r}; give a pair an axis, of its position and of its force, such as "
            'units = [["m", "N"], ["rad", "N m"]]'
        )
    if not len(names) == len(pairs) == count:
        raise InputError(f"axes and units name {len(names)} and {len(pairs)} of {count} axes; name each")
    return names, tuple((str(y), str(u)) for y, u in pairs)


def _ordered(matrix: MatrixFile, table: Table) -> MatrixFile:
    """The matrix in the order in which [decoupling] states its outputs and inputs; one that is not clear is refused."""
    order = {"outputs": matrix.outputs, "inputs": matrix.inputs}
    for (name, labels), given in zip(order.items(), ("sensing", "actuation"), strict=True):
        if name in table:
            order[name] = tuple(map(str, table[name]))
        elif given in table and list(labels) != sorted(labels, key=natural):
            raise InputError(
                f"{matrix.source} holds its {name} in the order {', '.join(labels)}; state beside {given} the order in which it "
                f"is, such as {name} = [{', '.join(map(json.dumps, labels))}]"
            )
    return matrix.ordered(**order)


def _candidates(wanted: Wanted, fit_hz: tuple[float, float] = (0.0, 0.0)) -> tuple[LowEnd | None, list[Axes]]:
    """Decouplings, the best first; what is given is taken as it is, and what is not made for it."""
    matrix, sensing, actuation = wanted.matrix, wanted.sensing, wanted.actuation
    low, high = fit_hz if any(fit_hz) else (0.0, np.inf)
    fitted = (matrix.hertz >= low) & (matrix.hertz <= high)
    if fitted.sum() < LEAST_LINES:
        raise InputError(
            f"{matrix.source}: {int(fitted.sum())} lines from {low:g} to {high:g} Hz are too few; widen fit_hz"
        )
    matrix = matrix._replace(hertz=matrix.hertz[fitted], accelerance=matrix.accelerance[fitted])
    try:
        if sensing is None and actuation is None:
            return decouplings(matrix.hertz, matrix.accelerance)
        if sensing is not None and actuation is not None:
            return None, [Axes(sensing, actuation, "as given")]
        left = matrix.accelerance if sensing is None else sensing @ matrix.accelerance
        seen = left if actuation is None else left @ actuation
        low, found = decouplings(matrix.hertz, seen)
        words = "those of the actuators" if sensing is None else "those of the sensors"
        (one,) = [each for each in found if each.words == words]
    except InputError as error:
        raise InputError(f"{matrix.source}: {error}") from None
    if sensing is None:
        return low, [Axes(one.sensing, actuation @ one.actuation, "actuation as given")]
    return low, [Axes(one.sensing @ sensing, one.actuation, "sensing as given")]


def design_axes(
    wanted: Wanted, folder: str, request: Any, make: Callable[..., list[str]], verbose: bool
) -> list[str]:
    """As `design_file`, of a matrix response: a folder with one of its own for each axis.

    `request` is the `DesignRequest` of all axes, `make` designs one: of a file, into a folder, with changes of the request.
    """
    low, found = _candidates(wanted, request.fit_hz)
    whole = Path(folder).resolve()
    whole.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=whole.parent, prefix=f".{whole.name}-") as beside:
        new = Path(beside) / whole.name
        new.mkdir()
        axes = _first_fitted(wanted, found, new, request.fit_hz)
        task = _Task(wanted, axes, new, request, make)
        lines = [task.design(k) for k in range(len(wanted.names))]
        history = task.slow_down(lines)
        answer = _write(task, low, history, Path(folder))
        require_free(folder)
        if whole.exists():
            whole.rmdir()
        new.rename(whole)
    said = [line.replace(str(new), str(folder)) for each in lines for line in each]
    return [*answer, *said] if verbose else answer


def _first_fitted(wanted: Wanted, found: list[Axes], new: Path, fit_hz: tuple[float, float]) -> Axes:
    """The first decoupling each of whose axes is a machine, with its axes' responses in files."""
    first, named = None, ""
    for axes in found:
        inner = axes.of(wanted.matrix.accelerance)
        unsure = _unsure(wanted.matrix, axes)
        try:
            for k, units in enumerate(wanted.units):
                named = wanted.names[k]
                arrays = {"frequency (Hz)": wanted.matrix.hertz, _heading(wanted, units): inner[:, k, k]}
                if np.isfinite(unsure).any():
                    arrays["coherence"] = unsure[:, k]
                file = new / f"axis-{k + 1}.npz"
                np.savez(file, **arrays)
                machine = build_machine(load_machine(file), modes_hz=[], fit_hz=fit_hz, rigid=True)
                if TURNED in machine.notes:
                    raise InputError(
                        "it moves against its force; turn the signs of its column of actuation, or of its row of sensing"
                    )
            return axes
        except InputError as error:
            first = first or InputError(f"{named}, {axes.words}: {error}")
    raise InputError(f"{wanted.matrix.source}: {first}")


def _heading(wanted: Wanted, units: tuple[str, str]) -> str:
    """Of an axis's response, with its unit unless that is only assumed."""
    if wanted.matrix.notes and units == ("m", "N"):
        return "h"
    position, drive = units
    return f"h (({position if position.isalpha() else f'({position})'}/s^2)/({drive}))"


def _unsure(matrix: MatrixFile, axes: Axes) -> np.ndarray:
    """Coherence of each axis from those of all responses, whose errors are independent: (lines, axes)."""
    response, seen = matrix.accelerance, np.clip(matrix.coherence, 1e-9, 1.0)
    variance = (1 - seen) / seen * np.abs(response) ** 2
    inner = np.abs(np.einsum("fii->fi", axes.of(response))) ** 2
    added = np.einsum("ai,fij,ja->fa", axes.sensing**2, variance, axes.actuation**2)
    with np.errstate(invalid="ignore"):
        return np.where(added > 0, inner / (inner + added), 1.0) + 0 * added


class _Task:
    """The axes of a matrix, with the design of each as it is now."""

    def __init__(
        self, wanted: Wanted, axes: Axes, folder: Path, request: Any, make: Callable[..., list[str]]
    ):
        self.wanted, self.axes, self.folder, self.request = wanted, axes, folder, request
        self.make, self.highest = make, [request.highest_hz] * len(wanted.names)
        self.loops: list[DesignedLoop] = []
        self.modes: MatrixModes | None = None
        parts = np.abs(self.closed.parts()).sum(axis=1) / np.abs(self.closed.parts().sum(axis=1))
        # Where actuators pull against each other an axis's gain moves by more than theirs do.
        self.gain = request.shares.get("gain", 0.0) * parts

    @property
    def closed(self) -> AxesLoops:
        """All axes closed around the matrix."""
        hertz, request = self.wanted.matrix.hertz, self.request
        ends = (request.loop_hz, request.fit_hz, (hertz[0], hertz[-1]))
        low, high = next(each for each in ends if any(each))
        band = max(float(low), hertz[0]), min(float(high), hertz[-1], HIGHEST * request.rate)
        return AxesLoops(
            *(self.wanted.matrix, self.axes, self.wanted.names, self.loops, request.rate, request.delay),
            *(band, request.shares, self.modes),
        )

    def design(self, k: int) -> list[str]:
        """Design an axis, no faster than it may be."""
        request, axes, name = self.request, self.axes, f"{self.request.name}_{k + 1}"
        folder = self.folder / f"axis-{k + 1}"
        shutil.rmtree(folder, ignore_errors=True)
        print(f"{self.wanted.names[k]}:", file=sys.stderr, flush=True)
        # All axes' limits together keep that of each actuator; the sensors' noises are independent.
        share = len(self.wanted.names) * np.abs(axes.actuation[:, k]).max()
        lines = self.make(
            f"{folder}.npz",
            str(folder),
            name=name,
            limit=request.limit / float(share),
            noise=request.noise * float(np.linalg.norm(axes.sensing[k])),
            highest_hz=self.highest[k],
            uncertainty=request.shares | ({"gain": float(self.gain[k])} if self.gain[k] else {}),
        )
        self.loops[k : k + 1] = [load_design(str(folder / f"{name}.json"))]
        return lines

    def slow_down(self, lines: list[list[str]]) -> list[tuple[int, str]]:
        """Lower bandwidths until all that is checked holds: of one axis, or of all, whatever costs least.

        Returns the axes that were designed again, in order, and what for.
        """
        history: list[tuple[int, str]] = []
        again = np.zeros(len(self.loops))
        hard = [Place(0.0, np.ones(len(self.wanted.matrix.inputs)))]
        self.modes = self.closed.with_modes().modes
        for _ in range(ROUNDS):
            judged = self.closed.judged()
            if judged.holds:
                return history
            if judged.stable and judged.excess.max() < LITTLE:
                for k in np.flatnonzero(judged.excess > 1):
                    self.gain[k] += (MORE * (judged.excess[k] - 1) + LEAST_MORE) * AGAIN ** again[k]
                    again[k] += 1
                    lines[k] = self.design(int(k))
                    gain = f"{100 * self.gain[k]:.2g} %, for what the others make of it"
                    history.append((int(k), f"designed for a gain of ± {gain}"))
                continue
            hard.append(self.closed.places()[judged.worst])
            slower = self._least_slower(hard)
            if slower is None:
                break
            for k in np.flatnonzero(slower < 1):
                before = self.loops[k].made["design_hz"]
                self.highest[k] = float(SLOWER * slower[k] * before)
                lines[k] = self.design(int(k))
                hertz = f"{in_hertz(before)} to {in_hertz(self.highest[k])} Hz (design parameter)"
                history.append((int(k), f"slowed from {hertz}"))
        raise InputError(f"{self.wanted.matrix.source}: {_why_not(self, judged)}")

    def _least_slower(self, places: Sequence[Place]) -> np.ndarray | None:
        """Shares of the bandwidths at which these places would hold, by the PID's rules."""
        count, best = len(self.loops), None
        for which in [*np.eye(count, dtype=bool), np.ones(count, dtype=bool)]:
            low, high = LEAST, 1.0
            if not self.closed.judge(places, np.where(which, low, 1.0)).holds:
                continue
            for _ in range(HALVINGS):
                middle = np.sqrt(low * high)
                holds = self.closed.judge(places, np.where(which, middle, 1.0)).holds
                low, high = (middle, high) if holds else (low, middle)
            shares = np.where(which, low, 1.0)
            best = shares if best is None or np.prod(shares) > np.prod(best) else best
        return best


def _why_not(task: _Task, judged: Judged) -> str:
    return (
        f"no bandwidths were found at which all axes hold together: {task.closed.stability(judged)}, largest "
        f"|S_kk| {sizes(judged.box_db)} dB; the axes act on each other too much: measure finer, give sensing and "
        "actuation of the machine's geometry, or state less uncertainty"
    )


def _write(task: _Task, low: LowEnd | None, history: list[tuple[int, str]], out: Path) -> list[str]:
    """The files of the whole, and the answer in lines."""
    request, axes, judged = task.request, task.axes, task.closed.judged()
    matrix = task.wanted.matrix
    folders = [f"axis-{k + 1}" for k in range(len(task.wanted.names))]
    # Sensors of a file that states no unit may be of several kinds.
    stated = [f" in {unit}" if not matrix.notes else ", unit not stated" for unit in matrix.units]
    code = axes_code(
        *(axes.sensing, axes.actuation, folders, request.name, request.precision),
        signals=(
            f"error[]{stated[0]}: {', '.join(matrix.outputs)}",
            f"out[]{stated[1]}: {', '.join(matrix.inputs)}",
        ),
    )
    matrices = task.closed.sensitivities()
    sigma = {name: float(np.linalg.norm(each, 2, axis=(1, 2)).max()) for name, each in matrices.items()}
    answer = _answer(task, judged, history)
    about = _about(task, folders, _held(task, judged, sigma))
    files = {**code, "axes.json": json.dumps(about, indent=1, allow_nan=False) + "\n"}
    files["report.html"] = _page(task, low, judged, sigma, answer)
    for number, folder in enumerate(folders):
        own = task.folder / folder / "report.html"
        said = "".join(
            f"\n<p>Among the other axes: {html.escape(words)}</p>" for k, words in history if k == number
        )
        own.write_text(own.read_text(encoding="utf-8").replace("</h1>", f"</h1>{said}", 1), encoding="utf-8")
    for name, text in files.items():
        (task.folder / name).write_text(text, encoding="utf-8")
    where = f"C and reasons: {out}: {', '.join(sorted([*files, *folders]))}"
    return [*answer[:2], where, *answer[2:]]


def _answer(task: _Task, judged: Judged, history: list[tuple[int, str]]) -> list[str]:
    """What was chosen, what holds of it, and what is assumed."""
    matrix, names = task.wanted.matrix, task.wanted.names
    shown = [
        f"{name}: {each.made['use']} {in_hertz(each.loop.crossing_hz(each.pid))} Hz"
        for name, each in zip(names, task.loops, strict=True)
    ]
    low_hz, high_hz = task.closed.lines()[[0, -1]] / (2 * np.pi)
    return [
        f"{matrix.source}: {'1 axis' if len(names) == 1 else f'{len(names)} axes'}, {task.axes.words}; {', '.join(shown)}",
        f"checked on the measured matrix from {low_hz:.4g} to {high_hz:.4g} Hz: {task.closed.stability(judged)}; largest |S_kk|, "
        f"all axes closed, {sizes(judged.peaks_db)} dB, and {sizes(judged.box_db)} dB at {len(task.closed.places())} places of the box",
        f"{_of_modes(task)}; not promised: what lies between the lines or beyond them{_unseen(task)}",
        matrix.order,
        *matrix.notes,
        *(f"{names[k]} {words}" for k, words in history),
    ]


def _held(task: _Task, judged: Judged, sigma: dict[str, float]) -> dict:
    """What was checked of all axes together, as `axes.json` keeps it."""
    low_hz, high_hz = task.closed.lines()[[0, -1]] / (2 * np.pi)
    return {
        "stable": judged.stable,
        "sensitivity_db": judged.peaks_db.tolist(),
        "sensitivity_in_the_box_db": judged.box_db.tolist(),
        "places_of_the_box": len(task.closed.places()),
        "largest_singular_value": sigma,
        "distance_of_characteristic_loci": judged.distance,
        "interaction_bound": float(judged.bound.max()),
        "band_hz": [float(low_hz), float(high_hz)],
    }


def _about(task: _Task, folders: list[str], held: dict) -> dict:
    """The decoupling and its axes, as `axes.json` keeps them."""
    request, axes, wanted, matrix = task.request, task.axes, task.wanted, task.wanted.matrix
    return {
        "format": FORMAT,
        "law": "f_k = controller of axis k applied to (T_y (r - y))_k; u = T_u f",
        "rate_hz": request.rate,
        "delay_samples": request.delay,
        "sensing": axes.sensing.tolist(),
        "actuation": axes.actuation.tolist(),
        "decoupling": axes.words,
        "outputs": matrix.outputs,
        "inputs": matrix.inputs,
        "units": matrix.units,
        "axes": [
            {"name": name, "units": units, "controller": f"{folder}/{request.name}_{k}.json"}
            for k, (name, units, folder) in enumerate(
                zip(wanted.names, wanted.units, folders, strict=True), 1
            )
        ],
        "checked": held,
        "file": matrix.source,
        "sha256": hashlib.sha256(wanted.file.read_bytes()).hexdigest(),
        "band_hz": task.closed.band_hz,
    }


def _page(
    task: _Task, low: LowEnd | None, judged: Judged, sigma: Mapping[str, float], answer: Sequence[str]
) -> str:
    wanted, axes, matrix = task.wanted, task.axes, task.wanted.matrix
    units = [f"{y} and {u}" for y, u in wanted.units]
    rows = [
        [name, unit, f"{each.made['mass']:.4g} {each.made['mass_unit']}", each.made["use"],
         f"{in_hertz(each.loop.crossing_hz(each.pid))}", f"{peak:.2f}", f"{most:.2f}"]
        for name, unit, each, peak, most in zip(wanted.names, units, task.loops, judged.peaks_db, judged.box_db, strict=True)
    ]  # fmt: skip
    head = ["axis", "units", "mass", "use", "bandwidth (Hz)", "|S_kk| (dB)", "in the box (dB)"]
    inner = interaction(axes.of(matrix.accelerance))
    facts = [
        ["largest singular value of S_O at the sensors, S_I at the actuators, in the middle of the box only; not promised",
         ", ".join(f"{name} {20 * np.log10(size):.2f} dB" for name, size in sigma.items())],
        ["distance of the characteristic loci from -1", f"{judged.distance:.3f}"],
        ["largest Perron root of |E| |T|", f"{judged.bound.max():.3g}: {_proof(judged)}"],
        ["beside the diagonal of the decoupled response (Perron root of |E|)",
         f"{np.median(inner[: max(8, len(inner) // 20)]):.2g} at the lowest lines, 0.1 passed at "
         f"{next((f'{f:.4g} Hz' for f, e in zip(matrix.hertz, inner, strict=True) if e > 0.1), 'none')}"],
        ["decoupling", axes.words],
    ]  # fmt: skip
    if low is not None:
        kind = "free to move: the accelerance" if low.free else "on springs: the compliance"
        facts.append(
            ["low end", f"{kind} is a real matrix up to {low.end_hz:.4g} Hz within {100 * low.misfit:.2g} %, condition "
             f"{low.condition:.3g} with all units scaled away"]
        )  # fmt: skip
    tables = [
        ("T_y, rows: axes", axes.sensing, matrix.outputs, wanted.names),
        ("T_u, columns: axes", axes.actuation, wanted.names, matrix.inputs),
    ]
    body = "".join(f"<p>{html.escape(one_line(line))}</p>\n" for line in answer)
    body += table(head, rows) + table([], facts)
    body += _crossing(task) if len(wanted.names) > 1 else ""
    body += "<h2>The decoupling</h2>\n" + "".join(
        f"<p>{words}</p>" + table(["", *columns], [[n, *(f"{x:.5g}" for x in row)] for n, row in zip(side, values, strict=True)])
        for words, values, columns, side in tables
    )  # fmt: skip
    body += picture(paint_decoupling(task.closed), "responses before and behind the decoupling")
    body += f"<h2>The loops</h2>\n{picture(paint_axes(task.closed), 'sensitivities of all axes')}"
    body += "".join(
        f'<p><a href="axis-{k}/report.html">{html.escape(name)}</a></p>'
        for k, name in enumerate(wanted.names, 1)
    )
    return page(
        "report.html", source=html.escape(matrix.source), kind=": controllers of its axes", body=body,
        held=html.escape(inspect_file(str(wanted.file))),
    )  # fmt: skip


def _crossing(task: _Task) -> str:
    """What the axes make of each other's setpoints, in the middle of the box and all over it."""
    names, places = task.wanted.names, task.closed.places()
    rows = [
        [name, *(f"{here:.3g} ({most:.3g})" for here, most in zip(*pair, strict=True))]
        for name, *pair in zip(
            names, task.closed.crossed(places[:1]), task.closed.crossed(places), strict=True
        )
    ]
    return (
        "<p>Largest |S_jk| as factors, in the middle (in brackets: at all places of the box): error of the row's axis over the "
        "setpoint of the column's, each in its own unit. Beside the diagonal nothing is promised.</p>"
    ) + table(["", *names], rows)


def _unseen(task: _Task) -> str:
    """Up to where one mode beyond the band could break the promise of each axis."""
    pairs = zip(task.wanted.names, task.loops, strict=True)
    found = [f"{name} up to {hertz:.4g} Hz" for name, each in pairs if (hertz := each.made["breaking_hz"])]
    return f"; one mode more there could break the promise of {', of '.join(found)}" if found else ""


def _of_modes(task: _Task) -> str:
    """What the places of the box hold for single modes."""
    modes = task.modes
    if modes is None or not task.request.shares.get("frequency"):
        return "no mode was moved by itself"
    hertz = ", ".join(f"{each:.4g}" for each in np.sort(modes.frequencies) / (2 * np.pi))
    return (
        f"among the places each mode moves by itself in all entries together ({hertz} Hz; they and a rigid body explain the matrix "
        f"to {100 * modes.misfit:.2g} %), those at one frequency as one"
    )


def _proof(judged: Judged) -> str:
    if judged.bound.max() < 1:
        return "below 1, which alone proves the loops stable, whichever are open or have less gain"
    return "not below 1, so that this bound proves nothing: the turns of det(I + L) do"
