"""The largest magnitude of a response that was measured with noise, between limits, from the scatter of neighbouring lines."""

import numpy as np
from jaxtyping import Complex128, Float64
from numpy.lib.stride_tricks import sliding_window_view
from scipy.stats import norm

WIDTHS = (1, 5, 9, 17, 33, 65, 129, 257)  # lines that are averaged
AGREE = 2.0  # standard deviations to which a wider average must agree with narrower ones; by what intervals then hold
ABOUT = 25  # lines over which the noise's share of the response is the same
TAIL = 0.025  # probability either way


def smooth(
    omega: Float64[np.ndarray, " lines"],
    response: Complex128[np.ndarray, " lines"],
    expected: Complex128[np.ndarray, " lines"],
) -> tuple[Complex128[np.ndarray, " lines"], Float64[np.ndarray, " lines"], Float64[np.ndarray, " lines"]]:
    """The response averaged by a parabola of its ratio to what is expected, its deviation, and over how many lines.

    Errors are those of independent lines, the same share of the response within `ABOUT`. Each line takes the most
    neighbours with which its value agrees with that of fewer, within the noise.
    """
    ratio, count = response / expected, len(response)
    widths = [width for width in WIDTHS if width <= count]
    noise = np.abs(ratio) * _noise(omega, ratio)
    kept, spread, taken = ratio, noise, np.ones(count)
    means, spreads, going = [ratio], [noise], np.ones(count, bool)
    for width in widths[1:]:
        mean, size, _ = _parabola(omega, ratio, width)
        for before, deviation in zip(means, spreads, strict=True):
            going &= np.abs(mean - before) <= AGREE * deviation
        means.append(mean)
        spreads.append(noise * size)
        kept, spread = np.where(going, mean, kept), np.where(going, noise * size, spread)
        taken = np.where(going, width, taken)
    return kept * expected, spread * np.abs(expected), taken


def largest(
    omega: Float64[np.ndarray, " lines"],
    response: Complex128[np.ndarray, " lines"],
    expected: Complex128[np.ndarray, " lines"],
) -> tuple[int, float, float, float]:
    """Line of the largest magnitude, the magnitude, and between which limits it lies with 95 %."""
    mean, spread, taken = smooth(omega, response, expected)
    size = np.abs(mean)
    # Half of the noise's power lies along the response; so many averages share no line.
    reach = float(norm.isf(TAIL / np.sum(1 / taken))) * spread / np.sqrt(2)
    place = int(size.argmax())
    return place, float(size[place]), float((size - reach).max()), float((size + reach).max())


def _noise(omega: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """Standard deviation of each line's noise, a share of the response: what a parabola of seven lines leaves, as a median."""
    mean, size, own = _parabola(omega, ratio, 7)
    # Of noise alone a line leaves 1 - 2 own + size^2 of its power; the median of that power is ln 2 of its mean.
    left = np.abs(ratio - mean) ** 2 / (1 - 2 * own + size**2) / np.abs(mean) ** 2
    sides = np.pad(left, ABOUT // 2, mode="reflect")
    return np.sqrt(np.median(sliding_window_view(sides, ABOUT), axis=1) / np.log(2))


def _parabola(omega: np.ndarray, ratio: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parabolas through `width` neighbours of each line: their value there, its deviation, and the line's own weight."""
    count = len(ratio)
    first = np.clip(np.arange(count) - width // 2, 0, count - width)
    x = sliding_window_view(omega, width)[first] - omega[:, None]
    powers = (x / np.abs(x).max(axis=1, keepdims=True))[..., None] ** np.arange(3)
    normal = powers.transpose(0, 2, 1) @ powers
    weights = (powers @ np.linalg.solve(normal, np.eye(3)[:, :1]))[..., 0]
    mean = np.sum(weights * sliding_window_view(ratio, width)[first], axis=1)
    return mean, np.linalg.norm(weights, axis=1), weights[np.arange(count), np.arange(count) - first]
