"""What remains of a floor's motion with a self-tuned feedforward, predicted over a box of isolators."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import cycle

import numpy as np
from jaxtyping import Complex128, Float64

from stillwork.base.bounds import Natural, NonNegative
from stillwork.base.checks import InputError
from stillwork.base.validation import by_value, checked
from stillwork.estimation.adaptive import FeLms
from stillwork.estimation.mean_adaptation import mean_adaptation, sum_kronecker
from stillwork.machine.isolation import (
    HIGHEST,
    FloorSpectra,
    Isolator,
    by_drift,
)
from stillwork.machine.isolation_design import (
    DRAWS,
    LOWEST_HZ,
    IsolationDesign,
    MovingPaths,
    Responding,
    alike_ends,
    at_end,
    density_through,
    motion_density,
    moving_paths,
    paths_through,
)
from stillwork.signals.levels import expected_peak, next_peak, next_rms

WIDE = 3.0  # standard deviations over the draws that the band takes in
SLOWEST_HZ, LINES = 0.01, 4000  # of the responses through which a record runs: 0.27 % apart
FINER = 4  # samples between those of a record at which its peaks are sought


@by_value
@dataclass(frozen=True)
class IsolationPrediction:
    """Motion that remains on a floor: lowest, expected and highest over the box, the weights' scatter and the record."""

    band_hz: tuple[float, float]
    remains: Float64[np.ndarray, "3 axes"]  # rms acceleration in the band, m/s^2
    without: Float64[np.ndarray, " axes"]  # the same without any control
    feedback: Float64[np.ndarray, " axes"]  # and with the skyhook alone
    # of each command over all of the floor's frequencies, scatter of the weights included, largest over the box, N: the
    # expected rms, and over another time as long as the floor's record the highest rms and the highest peak, never below it
    force: Float64[np.ndarray, "3 axes"]
    # root of the sum over the floor sensors of |T|^2
    transmissibility: Float64[np.ndarray, "3 axes frequencies"]
    without_transmissibility: Float64[np.ndarray, "axes frequencies"]
    density: Float64[np.ndarray, "axes frequencies"]  # of the remaining acceleration, expected, (m/s^2)^2/Hz


@checked
def predict(
    design: IsolationDesign,
    around: list[IsolationDesign],
    floor: FloorSpectra,
    correction: Callable | None = None,
    seed: Natural = 0,
) -> IsolationPrediction:
    """Motion and transmissibility of a design and of the loops around it, each with weights drawn from their scatter.

    Where `floor` has its record, that runs through every loop with frozen weights: its peaks, scattered as its rms and as
    the largest of a Gaussian signal are, are those of the commands without sensor noise (`with_noise` adds that of
    `replay`), and its scatter is that of the floor's spectra, too. Without it the spectra count as known, and the peaks are
    Rice's at the highest rms. Noise of a measured path (`correction`) counts as a path that no weights cancel: of it no lowest
    is known, which is 0. The band is that of the first `DRAWS` loops; the others, ends of the box, are within it, too.
    """
    moves, step = design.moves, design.step
    if moves is None:
        raise InputError(
            "design has a given step, whose scatter is unknown; give a design whose step was searched"
        )
    if not around:
        raise InputError("around is empty; give the loops on isolators of the box")
    f, widths = floor.frequencies_hz, floor.widths_hz
    band = LOWEST_HZ, design.loop.shaping.lowpass_hz
    # A band of frequency that an end of the judged one cuts counts in part.
    cut = np.minimum(f + widths / 2, band[1]) - np.maximum(f - widths / 2, band[0])
    counted = np.clip(cut, 0.0, widths)
    noises = design.isolator.floor_noise, design.isolator.platform_noise
    weights, smoothing = design.steady.weights, design.loop.smoothing
    drawn, sizes = _drawn(design, around, floor, counted, np.random.default_rng(seed))
    fixed = motion_density(design.paths, weights, floor, noises)
    density = (
        fixed
        + step * moves.wandering(design.paths.seen)
        + step**2 * moves.jitter(design.paths.seen, smoothing)
    )
    power = np.einsum("f,fij->ij", widths, moves.regressors).real
    scattered = step * np.einsum(
        "aiaj,ij->a", moves.products, power
    )  # mean square of each command by weights that wander
    forces = [
        _forces(each, own, scattered, floor, noises, correction)
        for each, own in zip((design, *around), (weights, *drawn), strict=True)
    ]
    if floor.record is None:
        varies = _varying(density, counted, floor, density @ counted)
    else:
        moved = _followed(design, lambda paths: paths.transmissibility(weights), floor, correction, band)
        varies = np.log(next_rms(moved, HIGHEST))
    bare, silent = replace(design.paths, skyhook=0 * design.paths.skyhook), np.zeros_like(weights)
    gains = [_gain(each.paths.transmissibility(own)) for each, own in zip(around, drawn, strict=True)]
    expected = _gain(design.paths.transmissibility(weights))
    remains = _banded(np.array(sizes), np.sqrt(density @ counted), varies)
    remains[0] *= correction is None
    return IsolationPrediction(
        band_hz=band,
        remains=remains,
        without=np.sqrt(motion_density(bare, silent, floor, noises) @ counted),
        feedback=np.sqrt(motion_density(design.paths, silent, floor, noises) @ counted),
        force=np.max(forces, axis=0),
        transmissibility=_banded(np.array(gains), expected, np.zeros(1)),
        without_transmissibility=_gain(bare.transmissibility(silent)),
        density=density,
    )


@checked
def with_noise(found: IsolationPrediction, noise: Float64[np.ndarray, " axes"]) -> IsolationPrediction:
    """With the largest command (N, of each axis) that the sensors' noise alone made added to the peaks."""
    rms, highest, peak = found.force
    return replace(found, force=np.array([rms, highest, np.maximum(highest, peak + noise)]))


@checked
def settled_excess(
    design: IsolationDesign, isolator: Isolator, floor: FloorSpectra, correction: Callable | None = None
) -> float:
    """Share by which the weights at which the adaptation of a design settles leave more power in the band than the best do.

    They are those of an `isolator` on which the error through the path as estimated has no slope; the best are those of least
    motion, which is quadratic in them.
    """
    f, loop = floor.frequencies_hz, design.loop
    noises = isolator.floor_noise, isolator.platform_noise
    paths = moving_paths(loop, paths_through(isolator, loop.rate, correction), f)
    settled = mean_adaptation(paths.seen, floor.widths_hz, floor.density, *noises, 0.0).weights
    counted = floor.widths_hz * ((f >= LOWEST_HZ) & (f <= loop.shaping.lowpass_hz))
    pushed = paths.held @ (np.eye(isolator.axes) - paths.skyhook[:, None, None] * paths.seen.secondary)
    turned, psi = np.conj(pushed.transpose(0, 2, 1)) * counted[:, None, None], paths.seen.regressors
    seen = floor.density + noises[0] ** 2 * np.eye(isolator.sensors)
    back = np.conj(psi.transpose(0, 2, 1))
    slope = np.sum(turned @ paths.transmissibility(0 * settled) @ floor.density @ back, axis=0).real
    best = -np.linalg.solve(sum_kronecker(turned @ pushed, psi @ seen @ back), slope.ravel())
    powers = [
        np.sum(motion_density(paths, each, floor, noises) @ counted)
        for each in (settled, best.reshape(settled.shape))
    ]
    return float(powers[0] / powers[1] - 1)


@checked
def worst_excess(
    design: IsolationDesign, floor: FloorSpectra, spread: NonNegative, correction: Callable | None = None
) -> tuple[float, float]:
    """`settled_excess` of the isolator as given, and the largest at the ends of its box.

    To first order in what is off the excess is a convex square, largest at an end. From the worst of the ends at which all modes
    are off alike one number after the other is turned to its other end, while the excess grows.
    """

    def found(signs: list[float]) -> float:
        return settled_excess(design, at_end(design.isolator, spread, signs), floor, correction)

    worst, signs = max((found(each), each) for each in alike_ends(design.isolator.axes))
    left = len(signs)  # that were not tried since it grew last
    for place in cycle(range(len(signs))):
        turned = [-each if k == place else each for k, each in enumerate(signs)]
        left -= 1
        if (more := found(turned)) > worst:
            worst, signs, left = more, turned, len(signs)
        if left == 0:
            break
    return settled_excess(design, design.isolator, floor, correction), worst


def _gain(whole: Responding) -> np.ndarray:
    """Root of the sum over the floor sensors, (axes, frequencies)."""
    return np.sqrt(np.sum(np.abs(whole) ** 2, axis=2)).T


def _drawn(
    design: IsolationDesign,
    around: list[IsolationDesign],
    floor: FloorSpectra,
    counted,
    rng,
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Weights of each isolator of the box, drawn from their scatter, and the rms of what then remains of every axis."""
    moves, step = design.moves, design.step
    assert moves is not None  # `predict` has refused it
    values, vectors = np.linalg.eigh(step * moves.covariance)
    root = (vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T  # of whatever basis where values are alike
    noises = design.isolator.floor_noise, design.isolator.platform_noise
    drawn, sizes = [], []
    for each in around:
        weights = each.steady.weights
        if isinstance(design.settings, FeLms):  # its slow directions stay long where they started
            weights = weights + rng.uniform() * (design.steady.weights - weights)
        weights = weights + (root @ rng.standard_normal(weights.size)).reshape(weights.shape)
        drawn.append(weights)
        jitter = moves.surge ** rng.uniform(-1, 1) * moves.jitter(each.paths.seen, design.loop.smoothing)
        density = motion_density(each.paths, weights, floor, noises) + step**2 * jitter
        sizes.append(np.sqrt(density @ counted))
    return drawn, sizes


def _varying(density, widths, floor: FloorSpectra, power) -> np.ndarray:
    """How far the logarithm of an rms over the duration strays from known spectra: `WIDE` standard deviations.

    Of a Gaussian motion over T seconds the power varies by 1 / sqrt(T B), with B the bandwidth of its lines.
    """
    return WIDE / 2 * np.sqrt(density**2 @ widths * floor.bursts[0] / floor.duration) / power


def _rice(density: np.ndarray, rms: np.ndarray, floor: FloorSpectra) -> np.ndarray:
    f, widths = floor.frequencies_hz, floor.widths_hz
    rate = np.sqrt(density @ (widths * f**2) / np.maximum(density @ widths, np.finfo(float).tiny))
    return expected_peak(rms, rate, floor.duration)


def _forces(
    design: IsolationDesign,
    weights: np.ndarray,
    scattered: np.ndarray,
    floor: FloorSpectra,
    noises,
    correction,
) -> list[np.ndarray]:
    """Rms of each command, its highest and its peak with weights about those of the design."""
    whole = density_through(floor, noises, *design.paths.commands(design.steady.weights))
    expected = np.sqrt(whole @ floor.widths_hz + scattered)
    if floor.record is None:
        varies = _varying(whole, floor.widths_hz, floor, expected**2)
        highest = expected * np.exp(varies)
        return [expected, highest, _rice(whole, highest, floor)]
    command = _followed(design, lambda paths: paths.commands(weights)[0], floor, correction)
    pushed = np.abs(weights @ by_drift(design.loop, np.asarray(floor.drift)))
    highest = np.hypot(expected * next_rms(command, HIGHEST), pushed)
    return [expected, highest, np.maximum(highest, next_peak(command, HIGHEST) + pushed)]


def _followed(
    design: IsolationDesign,
    respond: Callable[[MovingPaths], np.ndarray],
    floor: FloorSpectra,
    correction: Callable | None,
    band_hz: tuple[float, float] = (0.0, np.inf),
) -> np.ndarray:
    """What the floor's record becomes over time through a response of the loop, in a band."""
    record = np.asarray(floor.record)
    grid = record_grid(design, floor)
    response = respond(
        moving_paths(design.loop, paths_through(design.isolator, design.loop.rate, correction), grid)
    )
    lines, f = np.fft.rfft(record, axis=1), np.fft.rfftfreq(record.shape[1], 1 / floor.record_hz)
    moved = through(f, lines, grid, response)
    moved *= (f >= band_hz[0]) & (f <= band_hz[1])
    return FINER * np.fft.irfft(moved, FINER * record.shape[1], axis=1)


def record_grid(
    design: IsolationDesign, floor: FloorSpectra, lines: int = LINES
) -> Float64[np.ndarray, " lines"]:
    """Frequencies (Hz) between which a response is taken for a straight line.

    Where they lie a share h apart, a mode of relative damping d is off by (h / d)^2 / 4 of its peak: by 2 % at d = 0.01.
    """
    return np.geomspace(SLOWEST_HZ, min(floor.frequencies_hz[-1], 0.49 * design.loop.rate), lines)


def through(
    f: np.ndarray, lines: np.ndarray, grid: np.ndarray, response: Responding
) -> Complex128[np.ndarray, "axes lines"]:
    """Lines (inputs, f) of signals through a response on a grid; slower or faster motion than the grid's is left out."""
    moved = np.zeros((response.shape[1], len(f)), complex)
    for axis, column in np.ndindex(response.shape[1:]):
        moved[axis] += np.interp(f, grid, response[:, axis, column], left=0.0, right=0.0) * lines[column]
    return moved


def _banded(draws: np.ndarray, expected: np.ndarray, varies: np.ndarray) -> np.ndarray:
    """Lowest, expected and highest: from the draws, `WIDE` standard deviations of their logarithms either way."""
    logs = np.log(draws)
    mean, width = logs[:DRAWS].mean(axis=0), WIDE * logs[:DRAWS].std(axis=0)
    low = np.minimum(logs.min(axis=0), mean - width)
    high = np.maximum(logs.max(axis=0), mean + width)
    shift = varies if expected.ndim == 1 else varies[:, None]
    return np.array([np.exp(low - shift), expected, np.exp(high + shift)])
