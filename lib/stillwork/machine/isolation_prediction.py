"""What remains of a floor's motion with a self-tuned feedforward, predicted over a box of isolators."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64

from stillwork.base.bounds import Natural
from stillwork.base.checks import InputError
from stillwork.base.validation import by_value, checked
from stillwork.estimation.adaptive import FeLms
from stillwork.machine.isolation import FloorSpectra
from stillwork.machine.isolation_design import (
    DRAWS,
    JITTER,
    LOWEST_HZ,
    IsolationDesign,
    MovingPaths,
    Responding,
    density_through,
    jitter_density,
    motion_density,
    moving_paths,
    paths_through,
)
from stillwork.signals.levels import expected_peak, next_peak, next_rms

WIDE = 3.0  # standard deviations over the draws that the band takes in
HIGHEST = (
    0.99  # probability that another stretch as long as the record stays below what is called the highest
)
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
    Rice's at the highest rms. The band is that of the first `DRAWS` loops; the others, ends of the box, are within it, too.
    """
    if design.scatter is None:
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
    moves = _moving_weights(design, floor)
    weights = design.steady.weights
    drawn, sizes = _drawn(design, around, moves, floor, counted, np.random.default_rng(seed))
    fixed = motion_density(design.paths, weights, floor, noises)
    density = fixed + moves.wandering(design.paths.seen.secondary) + moves.jitter(design.paths)
    forces = [
        _forces(each, own, moves.commands(), floor, noises, correction)
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
    return IsolationPrediction(
        band_hz=band,
        remains=_banded(np.array(sizes), np.sqrt(density @ counted), varies),
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


def _gain(whole: Responding) -> np.ndarray:
    """Root of the sum over the floor sensors, (axes, frequencies)."""
    return np.sqrt(np.sum(np.abs(whole) ** 2, axis=2)).T


class _MovingWeights(NamedTuple):
    """What weights that move about their fixed point add."""

    frequencies_hz: np.ndarray
    covariance: np.ndarray  # of the weights as they wander
    plain: np.ndarray  # density of the regressors, (frequencies, regressors, regressors)
    power: np.ndarray  # of them
    force: (
        np.ndarray
    )  # density of the force by weights that move within the band, times f^2: (frequencies, axes, axes)
    shape: tuple[int, int]  # of the weights
    smoothing: float  # s

    def jitter(self, paths: MovingPaths) -> np.ndarray:
        """Density of the motion by weights that move within the band, (axes, frequencies)."""
        through = paths.seen.secondary
        each = np.einsum("fab,fbc,fac->af", through, self.force, np.conj(through))
        return each.real / (
            self.frequencies_hz**2 * (1 + (2 * np.pi * self.frequencies_hz * self.smoothing) ** 2)
        )

    def wandering(self, secondary: np.ndarray) -> np.ndarray:
        """Density of the motion by weights that wander, (axes, frequencies)."""
        covariance = self.covariance.reshape(*self.shape, *self.shape)
        return np.einsum(
            "fab,fac,bicj,fij->af", secondary, np.conj(secondary), covariance, self.plain, optimize=True
        ).real

    def commands(self) -> np.ndarray:
        """Mean square of each command by weights that wander, N^2."""
        return np.einsum("aiaj,ij->a", self.covariance.reshape(*self.shape, *self.shape), self.power)


def _moving_weights(design: IsolationDesign, floor: FloorSpectra) -> _MovingWeights:
    assert design.scatter is not None  # `predict` has refused it
    covariance = design.step * floor.bursts[0] * design.scatter.covariance
    seen = floor.density + design.isolator.floor_noise**2 * np.eye(design.isolator.sensors)
    psi = design.paths.seen.regressors
    plain = np.einsum("fis,fst,fjt->fij", psi, seen, np.conj(psi), optimize=True)
    power = np.einsum("f,fij->ij", floor.widths_hz, plain).real
    algorithm = type(design.settings).__name__
    noises = design.isolator.floor_noise, design.isolator.platform_noise
    force = jitter_density(design.paths.seen, design.steady, floor, noises, design.loop.rate, algorithm)
    return _MovingWeights(
        floor.frequencies_hz,
        covariance,
        plain,
        power,
        design.step**2 * floor.bursts[1] * force,
        design.steady.weights.shape,
        design.loop.smoothing,
    )


def _drawn(
    design: IsolationDesign,
    around: list[IsolationDesign],
    moves: _MovingWeights,
    floor: FloorSpectra,
    counted,
    rng,
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Weights of each isolator of the box, drawn from their scatter, and the rms of what then remains of every axis."""
    values, vectors = np.linalg.eigh(moves.covariance)
    root = (vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T  # of whatever basis where values are alike
    noises = design.isolator.floor_noise, design.isolator.platform_noise
    drawn, sizes = [], []
    for each in around:
        weights = each.steady.weights
        if isinstance(design.settings, FeLms):  # its slow directions stay long where they started
            weights = weights + rng.uniform() * (design.steady.weights - weights)
        weights = weights + (root @ rng.standard_normal(weights.size)).reshape(weights.shape)
        drawn.append(weights)
        strength = JITTER ** rng.uniform(0, 1.5)
        density = motion_density(each.paths, weights, floor, noises) + strength * moves.jitter(each.paths)
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
    highest = expected * next_rms(command, HIGHEST)
    return [expected, highest, np.maximum(highest, next_peak(command, HIGHEST))]


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
