"""Static decoupling of a measured matrix response, and the loops of its axes on the whole of it.

With q = T_y y and u = T_u f the response from f to q is T_y H T_u. What the machine does at low frequencies is a real
matrix R: of its accelerance where it is free to move, of its compliance where springs hold it. T_y and T_u make it
diagonal; of the many that do, those are taken that leave least beside the diagonal above.
"""

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64
from scipy import linalg, signal

from stillwork.base.checks import InputError
from stillwork.base.validation import checked
from stillwork.machine.hardware import ALLOWED_DB

LEAST, ENDS = 10, 40  # lines of the fit at the low end; how many ends of it are tried
CLOSE = 2.0  # times the least misfit, up to which the low end is made longer
WORST_MISFIT, WORST_CONDITION = 0.3, 100.0  # of the fit, and of what it found, with all units scaled away
FREE = 0.3  # of the accelerance at the lowest lines, that R has at least where the machine is free
HIGHER, STARTS = 30.0, 12  # times the lowest line, up to which a later start is tried; how many are
CLEAR_MISFIT = 0.1  # of the fit from there
PEAKS = 4  # resonances that are tried to be kept in one axis
STANDS_OUT = 0.7  # of the logarithm of a response, by which they do
RESOLVED = 2.6  # radians, by which the determinant may turn from line to line


class LowEnd(NamedTuple):
    """R + j w D + (j w)^2 Q of the accelerance, or of the compliance, at low frequencies, all units scaled away."""

    free: bool  # accelerance
    matrix: Float64[np.ndarray, "axes axes"]  # R
    bend: Float64[np.ndarray, "axes axes"]  # Q
    end_hz: float
    misfit: float  # root mean square, relative
    condition: float  # of R
    sprung: bool = False  # whether the lines begin below or among the springs' modes


class Axes(NamedTuple):
    """A decoupling, with what is special about it in words."""

    sensing: Float64[np.ndarray, "axes outputs"]  # T_y
    actuation: Float64[np.ndarray, "inputs axes"]  # T_u
    words: str

    @checked
    def of(
        self, response: Complex128[np.ndarray, "lines outputs inputs"]
    ) -> Complex128[np.ndarray, "lines axes axes"]:
        """The response from the axes' forces to their positions."""
        return self.sensing @ response @ self.actuation


@checked
def scaled_alike(sizes: Float64[np.ndarray, "n n"]) -> tuple[np.ndarray, np.ndarray]:
    """Factors of rows and columns that make them alike (Sinkhorn), so that no unit of an input or output counts."""
    rows, columns = np.ones(len(sizes)), np.ones(len(sizes))
    for _ in range(200):
        rows = 1 / np.sqrt((sizes**2 * columns**2).sum(axis=1))
        columns = 1 / np.sqrt((sizes.T**2 * rows**2).sum(axis=1))
    return rows, columns


@checked
def real_terms(
    columns: Complex128[np.ndarray, "lines terms"], response: Complex128[np.ndarray, "lines n n"]
) -> tuple[Float64[np.ndarray, "terms n n"], float]:
    """Real matrices whose sum, each times its column, is the response by least squares, relative to its size at each line.

    With them the root mean square over the lines of what is left.
    """
    size = np.linalg.norm(response, axis=(1, 2))
    powers, target = columns / size[:, None], (response / size[:, None, None]).reshape(len(response), -1)
    whole, wanted = (np.vstack([each.real, each.imag]) for each in (powers, target))
    terms = np.linalg.lstsq(whole, wanted, rcond=None)[0]
    misfit = float(np.sqrt(np.mean(np.sum(np.abs(powers @ terms - target) ** 2, axis=1))))
    return terms.reshape(-1, *response.shape[1:]), misfit


@checked
def low_end(hertz: Float64[np.ndarray, " lines"], accelerance: Complex128[np.ndarray, "lines n n"]) -> LowEnd:
    """Fit the low end of a response whose rows and columns are alike, as far up as it goes on like that."""
    tried: dict[bool, list[tuple[float, float, np.ndarray]]] = {True: [], False: []}
    ends = np.unique(np.geomspace(LEAST, len(hertz), ENDS).astype(int))
    for free in tried:
        seen = accelerance if free else -accelerance / (2 * np.pi * hertz[:, None, None]) ** 2
        for end in ends:
            s = 1j * hertz[:end] / hertz[end - 1]
            terms, misfit = real_terms(np.stack([np.ones(end), s, s * s], axis=1), seen[:end])
            tried[free].append((misfit, float(hertz[end - 1]), terms))
    first = np.linalg.norm(accelerance[:LEAST], axis=(1, 2)).mean()
    free = bool(np.linalg.norm(tried[True][0][2][0]) > FREE * first)
    least = min(each[0] for each in tried[free])
    misfit, end_hz, (matrix, _, bend) = max(
        (each for each in tried[free] if each[0] <= max(CLOSE * least, 0.01)), key=lambda each: each[1]
    )
    return LowEnd(free, matrix, bend, end_hz, misfit, float(np.linalg.cond(matrix)))


def _above_springs(hertz: np.ndarray, seen: np.ndarray) -> Iterator[LowEnd]:
    """Low ends that begin at later lines and last for an octave, of a machine that is free above its suspension."""
    for first in np.geomspace(2, HIGHER, STARTS) * hertz[0]:
        start = np.searchsorted(hertz, first)
        if len(hertz) - start < 2 * LEAST:
            return
        low = low_end(hertz[start:], seen[start:])
        if low.free and low.misfit < CLEAR_MISFIT and low.end_hz > 2 * hertz[start]:
            yield low


def _through_springs(hertz: np.ndarray, seen: np.ndarray) -> Iterator[LowEnd]:
    """The low end of a machine that is free above springs among whose modes the lines begin: M + D/s + K/s^2 + s^2 E of 1/seen."""
    if np.linalg.cond(seen).max() > WORST_CONDITION**2:
        return
    dynamic = np.linalg.inv(seen)
    tried = []
    for end in np.unique(np.geomspace(2 * LEAST, len(hertz), ENDS).astype(int)):
        s = 1j * hertz[:end] / hertz[end - 1]
        terms, misfit = real_terms(np.stack([s**0, 1 / s, 1 / s**2, s**2], axis=1), dynamic[:end])
        mass, _, stiffness, _ = terms
        if (
            np.linalg.norm(mass) > FREE * np.linalg.norm(dynamic[end - 1])
            and np.linalg.cond(mass) < WORST_CONDITION
        ):
            free = np.linalg.inv(mass)
            condition = float(np.linalg.cond(mass))
            tried.append(
                LowEnd(True, free, -free @ stiffness @ free, float(hertz[end - 1]), misfit, condition, True)
            )
    least = min((each.misfit for each in tried), default=np.inf)
    if least < CLEAR_MISFIT:
        yield max((each for each in tried if each.misfit <= CLOSE * least), key=lambda each: each.end_hz)


@checked
def decouplings(
    hertz: Float64[np.ndarray, " lines"], accelerance: Complex128[np.ndarray, "lines n n"]
) -> tuple[LowEnd, list[Axes]]:
    """Decouplings of the low end, the one first that leaves least beside the diagonal above it.

    Tried are the positions of the sensors, the forces of the actuators, and the axes that two real matrices have in
    common: R, and either what bends the low end or the sum of the strongest resonances.
    """
    rows, columns = scaled_alike(np.sqrt(np.mean(np.abs(accelerance[:LEAST]) ** 2, axis=0)))
    seen = rows[:, None] * accelerance * columns
    low = low_end(hertz, seen)
    if not low.misfit < CLEAR_MISFIT:
        low = next((each for each in _through_springs(hertz, seen) if CLOSE * each.misfit < low.misfit), low)
    if not low.misfit < WORST_MISFIT:
        low = next(_above_springs(hertz, seen), low)
    if not (low.misfit < WORST_MISFIT and low.condition < WORST_CONDITION):
        raise InputError(
            f"below {low.end_hz:.4g} Hz the response is no real matrix that can be inverted (misfit {100 * low.misfit:.2g} %, "
            f"condition {low.condition:.3g} with all units scaled away): fewer rigid-body modes than axes, some axes free "
            "and others on springs, soft springs, or noise; choose outputs and inputs that move independently, begin above soft "
            "springs, with fit_hz, or below stiff ones, or give sensing and actuation"
        )
    inverse, one = np.linalg.inv(low.matrix), np.eye(len(rows))
    moved = np.abs(np.linalg.eigvals(seen @ inverse)).max(axis=1) / hertz**2  # no unit counts in them
    tops, about = signal.find_peaks(np.log(moved), prominence=STANDS_OUT)
    tops = tops[np.argsort(-about["prominences"])][:PEAKS]
    pairs = {"those of the sensors": (one, inverse), "those of the actuators": (inverse, one)}
    shared = {"shared with what bends the low end": low.bend}
    shared |= {f"shared with the resonance at {hertz[k]:.4g} Hz": seen[k].imag for k in tops}
    if len(tops) > 1:
        shared["shared with the strongest resonances"] = sum(seen[k].imag / hertz[k] ** 2 for k in tops)
    for words, other in shared.items():
        # Of values that are alike rounding makes a complex pair: a real basis of it makes R diagonal as well.
        values, vectors = linalg.cdf2rdf(*np.linalg.eig(inverse @ other))
        if np.linalg.cond(vectors) < WORST_CONDITION:
            vectors = vectors[:, np.argsort(-np.diag(values))]
            pairs[words] = np.linalg.inv(vectors) @ inverse, vectors
    above = hertz > (low.end_hz if low.free and not low.sprung and low.end_hz < hertz[-1] else 0.0)
    left = {}
    for words, (sensing, actuation) in pairs.items():
        inner = sensing @ seen[above] @ actuation / hertz[above, None, None] ** 2
        off = np.abs(inner * (1 - one))
        left[words] = float(np.abs(np.linalg.eigvals(off)).max())
    found = [
        scaled_to_sensors(sensing * rows, columns[:, None] * actuation, words)
        for words, (sensing, actuation) in sorted(pairs.items(), key=lambda each: left[each[0]])
    ]
    return low, found


@checked
def scaled_to_sensors(sensing: np.ndarray, actuation: np.ndarray, words: str) -> Axes:
    """Each axis in the unit of its largest sensor and of its largest actuator, counted along that sensor."""
    rows = np.take_along_axis(sensing, np.abs(sensing).argmax(axis=1)[:, None], axis=1)
    columns = np.sign(rows.T) * np.abs(actuation).max(axis=0)
    return Axes(sensing / rows, actuation / columns, words)


@checked
def interaction(response: Complex128[np.ndarray, "lines n n"]) -> Float64[np.ndarray, " lines"]:
    """Perron root of |E|, E = (G - G~) G~^-1 with G~ the diagonal of G: what is beside the diagonal, in no unit."""
    own = np.einsum("fii->fi", response)
    off = np.abs(response) * (1 - np.eye(response.shape[1])) / np.abs(own)[:, None, :]
    return np.abs(np.linalg.eigvals(off)).max(axis=1)


@checked
def own_sensitivities(whole: Complex128[np.ndarray, "lines n n"]) -> Complex128[np.ndarray, "lines n"]:
    """S_kk of I + L: the error of each axis over its own setpoint while all are controlled."""
    return np.einsum("fii->fi", np.linalg.inv(whole))


class Judged(NamedTuple):
    """The loops of all axes at once on the measured matrix; frequencies are lines."""

    stable: bool
    unstable: tuple[
        tuple[int, ...], ...
    ]  # axes whose loops, closed together, make other turns than each alone
    counted: bool  # whether the lines are enough to count the turns
    excess: Float64[np.ndarray, " axes"]  # largest |S_kk| over its limit; above 1: broken
    peaks_db: Float64[np.ndarray, " axes"]  # of S_kk on the measurement
    box_db: Float64[np.ndarray, " axes"]  # likewise at all places tried
    bound: Float64[
        np.ndarray, " lines"
    ]  # Perron root of |E| |T~|; below 1: stable, and whichever loops are open
    distance: float  # of the characteristic loci from -1
    worst: int  # of the places, that with the largest excess

    @property
    def holds(self) -> bool:
        """Whether all is kept."""
        return self.stable and bool(np.all(self.excess <= 1))


@checked
def turns(
    matrix: Complex128[np.ndarray, "lines n n"], own: Complex128[np.ndarray, "lines n"] | None = None
) -> tuple[int, bool]:
    """Turns around zero that det(I + L) makes more than a product, and whether lines are enough to count them.

    The product is that of its diagonal, or of `own`.
    """
    own = np.einsum("fii->fi", matrix) if own is None else own
    ratio = np.linalg.det(matrix) / np.prod(own, axis=1)
    steps = np.angle(ratio[1:] / ratio[:-1])
    ends = np.angle(ratio[[0, -1]])
    count = round(float(steps.sum() - ends[1] + ends[0]) / (2 * np.pi))
    return count, bool(np.abs(steps).max() < RESOLVED and np.abs(ends).max() < np.pi / 2)


@checked
def judge(
    places: list[Complex128[np.ndarray, "lines n n"]],
    alone: list[Complex128[np.ndarray, "lines n"]] | None = None,
) -> Judged:
    """Stability and peaks of the loop gains L = T_y P T_u K of all axes at once, at places of a box, the middle first.

    The loop of each axis alone is known to be stable. Then all are, closed together, if det(I + L) turns around zero
    as often as the product of its diagonal does; this is counted for every set of closed loops in the middle, and for
    all of them elsewhere. S_kk, the error of an axis over its own setpoint while all others are controlled, may reach
    6 dB: in the middle as measured, or what the axis has alone there where that is more, and everywhere as the product
    of what the others make of it and of what it has alone on its model, 1 + L of which is `alone`: in that the noise of
    the measurement cancels.
    """
    gain = places[0]
    n = gain.shape[1]
    one, allowed = np.eye(n), 10 ** (ALLOWED_DB / 20)
    counted, box, unstable, exceeded = True, np.zeros(n), [], []
    for number, each in enumerate(places):
        whole = one + each
        sets = [tuple(range(n))]
        if not number:
            sets = [kept for size in range(2, n + 1) for kept in combinations(range(n), size)]
        for kept in sets:
            count, enough = turns(whole[np.ix_(range(len(whole)), kept, kept)])
            counted &= enough
            if count or not enough:
                unstable.append(kept)
        sizes = np.abs(own_sensitivities(whole))
        if not number:
            measured = sizes.max(axis=0)
        own = np.abs(1 / np.einsum("fii->fi", whole))
        likely = sizes if alone is None else sizes / own / np.abs(alone[number])
        limit = np.maximum(allowed, (1 + 1e-9) * own) if not number else np.inf
        exceeded.append(np.maximum(sizes / limit, likely / allowed).max(axis=0))
        box = np.maximum(box, likely.max(axis=0))
    own = np.einsum("fii->fi", gain)
    bound = np.abs(gain) * (1 - one) / np.abs(1 + own)[:, None, :]  # |E| |T~|
    return Judged(
        not unstable,
        tuple(dict.fromkeys(unstable)),
        counted,
        np.max(exceeded, axis=0),
        20 * np.log10(measured),
        20 * np.log10(box),
        np.abs(np.linalg.eigvals(bound)).max(axis=1),
        float(np.abs(1 + np.linalg.eigvals(gain)).min()),
        int(np.argmax(np.max(exceeded, axis=1))),
    )
