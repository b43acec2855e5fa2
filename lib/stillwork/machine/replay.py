"""A floor's record through the written C around the nominal isolator, with frozen and with adapting weights."""

import ctypes
import shutil
import subprocess
from contextlib import contextmanager
from pathlib import Path
from string import Template
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from scipy import linalg, signal

from stillwork.base.algebra import set_product
from stillwork.base.checks import InputError
from stillwork.base.kernels import inlined_kernel, kernel
from stillwork.estimation.adaptive import FeRls, felms_update, ferls_step
from stillwork.machine import pictures
from stillwork.machine.c_code import TEMPLATES, level_steps, waiting_samples
from stillwork.machine.isolation import POWERS, FloorSpectra, Isolator
from stillwork.machine.isolation_design import IsolationDesign
from stillwork.machine.isolation_prediction import IsolationPrediction, record_grid, through

COMPILERS = ("cc", "gcc", "clang")
MODES = ("frozen", "adapting")
MINUTE_S = 60
EDGE_S = 10.0  # before and after the record, in which motion fades: they do not count
# Of the paths, 0.018 % apart: the loop takes its part off the floor's, and what is left is no larger than where these are wrong
# by a hundredth of a mode's peak.
LINES = 64_000
SATURATED, FROZEN, LOUD = 1, 4, 16  # the flags of the C


class Replay(NamedTuple):
    """What a record makes of the platform and of the commands, second by second."""

    ran: str  # the compiled C, or the kernel
    motion: np.ndarray  # (3, axes, seconds): rms without control, frozen, adapting in the judged band, m/s^2
    peak: np.ndarray  # (2, axes, seconds): largest command, frozen and adapting, N
    saturated: tuple[int, int]  # samples at the limit
    kept: float  # share of the samples in which adapting weights were kept: the floor was too loud, or had just been so
    noise: np.ndarray  # (axes,): largest command by the sensors' noise alone, with frozen weights, N

    @property
    def minutes(self) -> np.ndarray:
        """Rms of each minute, m/s^2, (3, axes, minutes)."""
        parts = max(1, round(self.motion.shape[2] / MINUTE_S))
        squares = np.array_split(self.motion**2, parts, axis=2)
        return np.sqrt(np.stack([each.mean(axis=2) for each in squares], axis=2))

    def record(self) -> dict:
        """Its numbers, as the written JSON has them."""
        return {
            "ran": self.ran,
            "peak": dict(zip(MODES, self.peak.max(axis=2).tolist(), strict=True)),
            "minutes": dict(zip(("without", *MODES), self.minutes.tolist(), strict=True)),
            "noise": self.noise.tolist(),
            "saturated": dict(zip(MODES, self.saturated, strict=True)),
            "kept": self.kept,
        }


class Course:
    """What the sensors of an isolator read while a record runs round and round, and what its commands make of it.

    Before the time that counts, the filters settle and the feedforward rises; motion fades before it and after it, else slow
    motion leaks into the band. Sensor noise is white.
    """

    def __init__(
        self,
        design: IsolationDesign,
        isolator: Isolator,
        floor: FloorSpectra,
        pause_s: float,
        band_hz: tuple[float, float],
        *,
        seconds: float = 0.0,
        start_s: float = 0.0,
        lines: int = LINES,
        seed: int = 0,
    ):
        """Of the whole record, or of as many `seconds` from `start_s` on."""
        rate = design.loop.rate
        record = np.asarray(floor.record)
        once, self.edge = round(record.shape[1] / floor.record_hz * rate), round(EDGE_S * rate)
        self.rate, self.isolator, self.count = rate, isolator, round(seconds * rate) or once
        self.rises = sum(waiting_samples(design.loop, pause_s))  # samples until the feedforward is whole
        self.lead = self.rises + self.edge
        self.samples = self.lead + self.count + self.edge
        order = (np.arange(-self.lead, self.count + self.edge) + round(start_s * rate)) % once
        self.grid = record_grid(design, floor, lines)
        primary, self.held, _ = isolator.paths(self.grid, 1 / rate)
        read = signal.resample(record, once, axis=1)
        moved = through(np.fft.rfftfreq(once, 1 / rate), np.fft.rfft(read, axis=1), self.grid, primary)
        read, self.moved = read[:, order], np.fft.irfft(moved, once, axis=1)[:, order]
        white = np.random.default_rng(seed).standard_normal((len(read) + len(self.moved), len(order)))
        levels = np.repeat([isolator.floor_noise, isolator.platform_noise], [len(read), len(self.moved)])
        noise = np.sqrt(rate / 2) * levels[:, None] * white
        self.quiet = tuple(np.ascontiguousarray(each.T) for each in np.split(noise, [len(read)]))
        self.read = (
            np.ascontiguousarray(read.T) + self.quiet[0],
            np.ascontiguousarray(self.moved.T) + self.quiet[1],
        )
        self.f = np.fft.rfftfreq(len(order), 1 / rate)
        self.inside = (self.f >= band_hz[0]) & (self.f <= band_hz[1])
        self.rise = np.sin(np.linspace(0, np.pi / 2, self.edge)) ** 2

    @property
    def counted(self) -> slice:
        """Its samples that count."""
        return slice(self.lead, self.lead + self.count)

    def left(self, forces: np.ndarray | None = None) -> np.ndarray:
        """Rms of each second in the band with `forces` (samples, axes), or without control, (axes, seconds)."""
        motion = self.moved
        if forces is not None:
            if not np.isfinite(forces).all():
                raise InputError(
                    "not to be switched on: on the record itself the weights run away; adapt more slowly"
                )
            # From rest to rest, with the rise before it and a fade after: else its lines had a step of the commands.
            faded = forces.copy()
            faded[self.lead + self.count :] *= self.rise[::-1, None]
            pushed = through(self.f, np.fft.rfft(faded.T, axis=1), self.grid, self.held)
            motion = motion + np.fft.irfft(pushed, motion.shape[1], axis=1)
        fade = np.concatenate([np.zeros(self.rises), self.rise, np.ones(self.count), self.rise[::-1]])
        lines = np.fft.rfft(motion * fade, axis=1) * self.inside
        banded = np.fft.irfft(lines, motion.shape[1], axis=1)[:, self.counted]
        return np.sqrt(_seconds(banded**2, self.rate, np.mean))


def replay(
    design: IsolationDesign,
    files: dict[str, str],
    name: str,
    limit: float,
    pause_s: float,
    floor: FloorSpectra,
    band_hz: tuple[float, float],
    seed: int = 0,
) -> Replay:
    """Run the record of `floor` through the C in `files`, compiled where a compiler is, else through its kernel.

    The end of the record runs first, in which the filters settle and the feedforward rises.
    """
    course = Course(design, design.isolator, floor, pause_s, band_hz, seed=seed)
    motions, peaks, saturated = [course.left()], [], []
    weights, counted = design.steady.weights, course.counted
    with controller(design, files, name, pause_s) as (run, ran):
        for begins in (course.samples, 0):
            forces, flags, _ = run(design.isolator, weights, *course.read, limit, begins)
            motions.append(course.left(forces))
            peaks.append(_seconds(np.abs(forces[counted].T), course.rate, np.max))
            saturated.append(int(np.count_nonzero(flags[counted] & SATURATED)))
        kept = float(np.mean(flags[counted] & FROZEN > 0))
        alone, _, _ = run(design.isolator, weights, *course.quiet, np.inf, course.samples)
    largest = np.abs(alone[counted]).max(axis=0)
    return Replay(ran, np.array(motions), np.array(peaks), (saturated[0], saturated[1]), kept, largest)


def _seconds(rows: np.ndarray, rate: float, summary) -> np.ndarray:
    parts = np.array_split(rows, max(1, int(rows.shape[1] / rate)), axis=1)
    return np.stack([summary(each, axis=1) for each in parts], axis=1)


def plant_matrices(isolator: Isolator, sample_time: float):
    """A, B of a held command and of the one before, C to the acceleration; and the whole samples of its delay.

    States: relative positions, their velocities, forces behind the actuators' pole. Between two samples the earlier
    command acts for the fraction of a sample that the delay holds, then the later one.
    """
    n, inverse, pole = isolator.axes, np.linalg.inv(isolator.mass), isolator.actuator_pole
    zero, one = np.zeros((n, n)), np.eye(n)
    c = np.hstack([-inverse @ isolator.stiffness, -inverse @ isolator.damping, inverse])
    a = np.vstack([np.hstack([zero, one, zero]), c, np.hstack([zero, zero, -pole * one])])
    whole = np.zeros((4 * n, 4 * n))
    whole[: 3 * n] = np.hstack([a, np.vstack([zero, zero, pole * one])])
    late, part = divmod(isolator.delay / sample_time, 1.0)
    early, later = (linalg.expm(whole * share * sample_time)[: 3 * n] for share in (part, 1 - part))
    step = later[:, : 3 * n] @ early
    a, now, before = (
        np.ascontiguousarray(each) for each in (step[:, : 3 * n], later[:, 3 * n :], step[:, 3 * n :])
    )
    return a, now, before, c, int(late)


@contextmanager
def controller(design: IsolationDesign, files: dict[str, str], name: str, pause_s: float):
    """What runs sensors through the loop around an isolator, compiled once where a compiler is, and its name.

    It gives commands (samples, axes), flags of each sample, and the mean of the weights from the sample `averaged` on; weights
    adapt from the sample `begins` on.
    """
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    with TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        compiled = _compiled(compiler, files, name, Path(folder)) if compiler else None

        def run(isolator, weights, floors, seen, limit, begins, averaged=0):
            *plant, late = plant_matrices(isolator, design.loop.sample_time)
            forces, flags = np.zeros_like(seen), np.zeros(len(seen), np.uint8)
            if compiled is None:
                spans = (*waiting_samples(design.loop, pause_s), late, begins, design.loop.path_delay)
                mean = _run_kernel(
                    design,
                    weights.copy(),
                    limit,
                    (*spans, averaged),
                    floors,
                    seen,
                    tuple(plant),
                    forces,
                    flags,
                )
                return forces, flags, mean
            states = len(plant[0])
            work = np.zeros(states), np.zeros(states)
            whole = (ctypes.c_long(len(seen)), states, *map(ctypes.c_long, (late, begins, averaged)))
            mean = np.array(weights, dtype=float)
            arrays = [
                each.ctypes.data_as(ctypes.c_void_p)
                for each in (mean, *plant, floors, seen, forces, flags, *work)
            ]
            compiled(*whole, *arrays[:7], ctypes.c_double(limit), *arrays[7:])
            return forces, flags, mean

        found = "the written C, compiled" if compiled else "its kernel in Python, as no C compiler was found"
        yield run, found


def _compiled(compiler: str, files: dict[str, str], name: str, folder: Path):
    """The function `replay` of the C with its plant; None where it does not compile here."""
    driver = Template((TEMPLATES / "replay.c").read_text(encoding="utf-8")).substitute(
        name=name, guard=name.upper()
    )
    for file, text in {**files, "replay.c": driver}.items():
        (folder / file).write_text(text, encoding="utf-8")
    sources = [f"{name}.c", f"{name}_adapt.c", "replay.c"]
    command = [compiler, "-std=c99", "-O2", "-shared", "-fPIC", *sources, "-o", "replay.so", "-lm"]
    if subprocess.run(command, cwd=folder, capture_output=True).returncode:
        return None
    return ctypes.CDLL(str(folder / "replay.so")).replay


def _run_kernel(design, weights, limit, spans, floors, seen, plant, forces, flags) -> np.ndarray:
    """The loop of the C by the toolbox's filters and updates, into `forces` and `flags`; the mean of the weights."""
    loop, settings = design.loop, design.settings
    rows = [signal.sosfilt(loop.highpass, floors, axis=0)]
    rows.append(signal.sosfilt(loop.noise_shaping, rows[0], axis=0))
    stacks = [[each] for each in rows]
    for stack in stacks:
        for _ in range(POWERS):
            stack.append(signal.sosfilt(loop.integrator, stack[-1], axis=0))
    psi, filtered = (np.ascontiguousarray(np.hstack(stack)) for stack in stacks)
    recursive = isinstance(settings, FeRls)
    recursion = (
        FeRls(settings.initial_covariance, settings.forgetting, settings.growth_limit, form="UD")
        if recursive
        else FeRls(1.0, form="UD")
    )
    rates = (
        (0.0, 1.0, 1.0)
        if recursive
        else (settings.step_size, settings.regularisation, settings.trace_copies(len(weights)))
    )
    guard = design.guard, design.growth**2, *level_steps(loop.rate), loop.smooth
    filters = (
        loop.noise_shaping,
        loop.skyhook,
        *(np.ascontiguousarray(each) for each in loop.error),
        *loop.folded,
    )
    started = recursion.start(psi.shape[1])
    mean = np.zeros_like(weights)
    _step_through(
        weights, mean, started, *started[-2:], recursive, rates, psi, filtered, seen, plant, filters, guard, spans, float(limit), forces, flags
    )  # fmt: skip
    return mean


@inlined_kernel
def _filtered(sections, memory, value):
    """A sample through a cascade in transposed direct form II."""
    given = value
    for m in range(len(sections)):
        result = sections[m, 0] * given + memory[m, 0]
        memory[m, 0] = sections[m, 1] * given - sections[m, 4] * result + memory[m, 1]
        memory[m, 1] = sections[m, 2] * given - sections[m, 5] * result
        given = result
    return given


@kernel
def _step_through(
    weights,
    mean,
    recursion,
    inner,
    other,
    recursive,
    rates,
    psi,
    filtered,
    seen,
    plant,
    filters,
    guard,
    spans,
    limit,
    forces,
    flags,
):
    """Every sample: sensors, filtered error and skyhook, command and its limit, update, plant."""
    a, now, before_it, c = plant
    shaping, skyhook, before, modes, after, folded, stepped = filters
    start, fade, pause, late, begins, path_delay, averaged = spans
    matrix, form, forgetting, levels, allowance, gain, _, _ = recursion
    axes, states, level, (calm, highest, rise, fall, smooth) = seen.shape[1], len(a), 1.0, guard
    whole = weights.copy()  # of the command
    x, damped, error, turned = np.zeros(states), np.zeros(axes), np.zeros(axes), np.zeros(axes)
    skies, errors = np.zeros((axes, len(skyhook), 2)), np.zeros((axes, modes.shape[1], 2))
    sents, sent, turn = np.zeros((axes, len(shaping), 2)), np.zeros_like(seen), 0
    rest, wait = start + fade, start + fade + pause
    for k in range(len(seen)):
        for i in range(axes):
            error[i] = seen[k, i] + np.sum(c[i] * x)
            if k >= stepped:
                error[i] -= np.sum(folded[i] * forces[k - stepped])
            if k > stepped:
                error[i] += np.sum(folded[i] * forces[k - stepped - 1])
            damped[i] = _filtered(skyhook, skies[i], error[i])
        set_product(before, error, turned)
        for i in range(axes):
            turned[i] = _filtered(modes[i], errors[i], turned[i])
        set_product(after, turned, error)
        share = 1 - rest / fade if rest < fade else 0.0
        share = share * share * (3 - 2 * share)
        loud = np.sum((calm @ psi[k]) ** 2) > level
        level = max(1.0, min(highest, level * (rise if loud else fall)))
        for i in range(axes):
            whole[i] += smooth * (weights[i] - whole[i])
            forces[k, i] = share * np.sum(whole[i] * psi[k]) - damped[i]
            if not abs(forces[k, i]) <= limit:
                forces[k, i] = np.copysign(limit, forces[k, i])
                flags[k] = SATURATED
            sent[k, i] = _filtered(shaping, sents[i], forces[k, i])
        # The modified error, of as many samples ago: nothing is updated before these.
        regressor = filtered[k - path_delay]
        for i in range(axes):
            error[i] += np.sum(weights[i] * regressor) - sent[k - path_delay, i]
        if loud:
            flags[k] |= LOUD
        if flags[k]:
            wait = max(wait, pause)
        rest -= rest > 0
        if k < begins or wait > 0:
            wait -= wait > 0
            flags[k] |= FROZEN
        elif recursive:
            turn += 1
            ferls_step(
                weights, matrix, form, forgetting, levels, allowance, gain, inner, other, regressor, error, turn - 1
            )  # fmt: skip
        else:
            felms_update(weights, regressor, error, rates[0], rates[1], rates[2])
        if k >= averaged:
            mean += weights / (len(seen) - averaged)
        following = a @ x
        if k >= late:
            following += now @ forces[k - late]
        if k > late:
            following += before_it @ forces[k - late - 1]
        x = following


def require_kept(found: Replay, promised: IsolationPrediction) -> None:
    """Refuse a loop that on the record itself reaches its limit, or leaves more than what was called the highest."""
    if any(found.saturated):
        raise InputError(
            f"not to be switched on: on the record itself the limit acts in {max(found.saturated)} samples; give a higher "
            "limit, or start the band at a higher frequency"
        )
    frozen, adapting = np.sqrt(np.mean(found.motion[1:] ** 2, axis=2))
    whole, highest = np.maximum(frozen, adapting), promised.remains[2]
    if (over := np.flatnonzero(whole > highest)).size:
        axis = over[0]
        cure = "adapt more slowly (a smaller variance), or record longer"
        if frozen[axis] > highest[axis]:
            cure = "frozen weights leave that, too: record longer"
        raise InputError(
            f"not to be switched on: on the record itself axis {axis + 1} moves by {whole[axis]:.3g} m/s^2 rms, more than "
            f"the highest {highest[axis]:.3g} foretold; {cure}"
        )


def replay_rows(found: Replay) -> list[list[str]]:
    """Rms of each minute on every axis: without control, frozen, adapting."""
    return [
        [str(k + 1), *(", ".join(f"{value:.3g}" for value in each) for each in found.minutes[:, :, k])]
        for k in range(found.minutes.shape[2])
    ]


@pictures.house_style()
def paint_replay(found: Replay, promised: IsolationPrediction, limit: float):
    """Rms and largest command of each second, all axes together."""
    figure, (top, bottom) = pictures.new(2, 1, height=4.6, sharex=True)
    seconds = np.arange(found.motion.shape[2]) + 0.5
    whole = np.linalg.norm(found.motion, axis=1)
    styles = (
        (pictures.GREY, 1.0, "without control"),
        (pictures.ORANGE, 2.6, "frozen"),
        (pictures.BLUE, 0.9, "adapting"),
    )
    for row, (colour, width, label) in zip(whole, styles, strict=True):
        top.semilogy(seconds, row, color=colour, linewidth=width, label=label)
    highest = np.linalg.norm(promised.remains[2])
    top.axhline(
        highest,
        color=pictures.BLACK,
        linestyle="--",
        linewidth=1.0,
        label="highest foretold, over the record",
    )
    top.set_ylabel(f"rms of a second (m/s²)\n{promised.band_hz[0]:g} to {promised.band_hz[1]:.3g} Hz")
    top.legend(ncols=2)
    for row, (colour, width, label) in zip(found.peak.max(axis=1), styles[1:], strict=True):
        bottom.plot(seconds, row, color=colour, linewidth=width, label=label)
    if np.isfinite(limit):
        bottom.axhline(limit, color=pictures.RED, linestyle="--", linewidth=1.0, label="limit")
    bottom.set(xlabel="time on the record (s)", ylabel="largest command\nof a second (N)", ylim=(0, None))
    bottom.legend()
    return figure
