"""What keeps the covariance bounded when a direction of the floor falls silent, compared in closed loop.

The loop is the smallest one that has what matters: one actuator, a secondary path that is known exactly but for
its sample of delay, and weights w that cancel the floor perfectly:

    e(k) = N [ (W(k-1) - w) psi(k-1) + n(k) ]
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64
from numpy.typing import ArrayLike
from scipy import signal

from experiments.isolation.simulation import Run
from stillwork.base.algebra import inner_product, plus_row, set_product
from stillwork.base.checks import require_array, require_choice, require_count, require_number
from stillwork.base.kernels import inlined_kernel, kernel
from stillwork.estimation.adaptive import ferls_update, hold_triangle
from stillwork.estimation.covariance_forms import add_triangle_information

CURES = ("none", "trace bound", "leakage", "limit", "directional", "no forgetting", "variable", "resetting")
NONE, TRACE_BOUND, LEAKAGE, LIMIT, DIRECTIONAL, NO_FORGETTING, VARIABLE, RESETTING = range(8)

FASTEST = 10.0  # times the printed 1 - lambda: as fast as variable forgetting may forget (chosen)
RESET_SHARE = 0.01  # of its start, to which resetting lets P fall at most (chosen)
# A command this many times the largest one that the right weights would give has left every actuator's range.
OVERLOAD = 1e3


class SmallestLoop(NamedTuple):
    """What the floor alone decides of the module's loop, the same whatever becomes of P.

    Kept whole for all cures: 16 bytes a sample and regressor.
    """

    regressors: Float64[np.ndarray, "samples n"]  # psi
    filtered: Float64[np.ndarray, "samples n"]  # psi_N
    optima: Float64[np.ndarray, "segments n"]  # w of each segment
    segment: Int64[np.ndarray, "samples"]  # to which a sample belongs
    shaping: Float64[np.ndarray, "sections 6"]  # N


def smallest_loop(
    segments: Sequence[tuple[ArrayLike, ArrayLike]], integrator: ArrayLike, shaping: ArrayLike
) -> SmallestLoop:
    """Loop on (floor (sensors, samples) in m/s², optimum w) that follow one another, from rest."""
    floors = [require_array("floor", floor, ndim=2) for floor, _ in segments]
    optima = np.array([require_array("optimum", w, ndim=1) for _, w in segments])
    integrator = require_array("integrator", integrator, shape=(None, 6))
    shaping = require_array("shaping", shaping, shape=(None, 6))
    direct = np.concatenate(floors, axis=1)
    band, (sensors, samples) = signal.sosfilt(shaping, direct), direct.shape
    regressors, filtered = np.empty((2, samples, optima.shape[1]))
    for first in range(0, optima.shape[1], sensors):
        if first:
            direct, band = signal.sosfilt(integrator, direct), signal.sosfilt(integrator, band)
        columns = slice(first, first + sensors)
        regressors[:, columns], filtered[:, columns] = direct.T, band.T
    segment = np.repeat(np.arange(len(floors)), [part.shape[1] for part in floors])
    return SmallestLoop(regressors, filtered, optima, segment, shaping)


@dataclass(frozen=True)
class CureRun:
    """Closed-loop adaptation with one cure, at equally spaced moments; NaN after an overload."""

    samples: Float64[np.ndarray, "kept"]  # samples seen
    growth: Float64[np.ndarray, "kept n"]  # diagonal of P over that of P(-1)
    misalignment: Float64[np.ndarray, "kept"]  # size of W - w in the metric of P(-1), over its start
    error_power: Float64[np.ndarray, "kept"]  # mean square of e over the interval

    def decay(self, start: int, stop: int) -> float:
        """Time constant of the misalignment in samples, fitted to the kept moments `start` to `stop`."""
        rows = slice(start, stop)
        return float(-1 / np.polyfit(self.samples[rows], np.log(self.misalignment[rows]), 1)[0])


def run_cure(
    cure: str,
    loop: SmallestLoop,
    covariance: ArrayLike,
    forgetting: float,
    *,
    growth: float = 10.0,
    noise: ArrayLike | float = 0.0,
    noise_power: float = 1.0,
    keep_every: int = 1000,
) -> CureRun:
    """Adapt in closed loop from zero weights.

    Of the cures, ``limit`` is the library's: the diagonal of P stays below `growth` times its start;
    ``leakage`` after Levenberg and Marquardt: every sample adds information along every axis, so that a
    silent one settles at `growth`; ``directional`` after Kulhavy: only what the regressor says anew is forgotten,
    R + (lambda - (1 - lambda) / psi' P psi) psi psi'; ``no forgetting``: lambda = 1; ``trace bound``: P is
    scaled down as a whole when its trace exceeds `growth` times its start; ``variable`` after Fortescue,
    Kershenbaum and Ydstie: 1 - lambda grows with the error, (1 - lambda) e² / (noise (1 + psi' P psi)), at
    most `FASTEST` times, noise being `noise_power` (N²), the error's when all is learnt; ``resetting`` after Salgado,
    Goodwin and Middleton, in units of the start D, P / lambda - P psi psi' P / (1 + psi' P psi) + b D - d P D^-1 P, which
    without excitation settles at `growth`. `covariance` is the diagonal of P(-1), steady values; `noise` runs over all
    segments together (N).
    """
    code = CURES.index(require_choice("cure", cure, CURES))
    start = require_array("covariance", covariance, shape=loop.optima.shape[1:])
    forgetting = require_number("forgetting", forgetting, above=0.0, below=1.0)
    growth = require_number("growth", growth, above=1.0)
    every = require_count("keep_every", keep_every)
    noise_power = require_number("noise_power", noise_power, above=0.0)
    samples = len(loop.segment)
    noise = np.broadcast_to(require_array("noise", noise), samples).astype(float)
    kept = np.full((samples // every, len(start) + 2), np.nan)
    _cure_run(code, loop, noise, start, forgetting, growth, noise_power, every, kept)
    return CureRun(every * np.arange(1.0, len(kept) + 1), kept[:, 2:], kept[:, 0], kept[:, 1])


@inlined_kernel
def _cascade(sections, state, value):
    """One sample through second-order sections in transposed direct form II."""
    for s in range(len(sections)):
        out = sections[s, 0] * value + state[s, 0]
        state[s, 0] = sections[s, 1] * value - sections[s, 4] * out + state[s, 1]
        state[s, 1] = sections[s, 2] * value - sections[s, 5] * out
        value = out
    return value


@kernel
def _leverage(covariance, psi, gain):
    """P psi into `gain`; returns psi' P psi."""
    set_product(covariance, psi, gain)
    return inner_product(gain, psi)


@kernel
def _reset(weights, covariance, psi, error, forgetting, growth, start, gain, spare):
    """One sample of exponential resetting and forgetting."""
    n, power = len(psi), _leverage(covariance, psi, gain)
    grow = 1.0 / forgetting - 1.0
    for i in range(n):
        weights[0, i] -= error * gain[i] / (1.0 + power)
        for j in range(i + 1):
            total = 0.0
            for k in range(n):
                total += covariance[i, k] * covariance[k, j] / start[k]
            spare[i, j] = (
                covariance[i, j] / forgetting - gain[i] * gain[j] / (1.0 + power) - grow / growth * total
            )
        spare[i, i] += grow * RESET_SHARE * start[i]
    for i in range(n):
        for j in range(i + 1):
            covariance[i, j] = covariance[j, i] = spare[i, j]


@kernel
def _forget_along(weights, covariance, psi, error, forgetting, gain):
    """One sample of directional forgetting: the information of directions that are not excited stays."""
    n, power = len(psi), _leverage(covariance, psi, gain)
    if not power > 0.0:
        return
    for i in range(n):
        weights[0, i] -= error * gain[i] / (1.0 + power)
    share = forgetting - (1.0 - forgetting) / power
    share = share / (1.0 + share * power)
    for i in range(n):
        for j in range(i + 1):
            covariance[i, j] -= share * gain[i] * gain[j]
            covariance[j, i] = covariance[i, j]


@kernel
def _cure_run(cure, loop, noise, start, forgetting, growth, noise_power, every, kept):
    regressors, filtered, optima, segment, shaping = loop
    n, memory = len(start), np.zeros((len(shaping), 2))
    weights, covariance, levels = np.zeros((1, n)), np.zeros((n, n)), np.zeros((3, n))
    bound = 0.0
    for i in range(n):
        covariance[i, i] = start[i]
        levels[0, i] = growth * start[i] if cure == LIMIT else np.inf
        bound += growth * start[i]
    gain, spare = np.empty(n), np.empty((n, n))
    error = np.empty(1)
    command, wanted, squares, largest, first = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        first += optima[0, i] ** 2 / start[i]
    for k in range(len(noise)):
        psi, shaped = regressors[k], filtered[k]
        error[0] = _cascade(shaping, memory, command - wanted + noise[k])
        squares += error[0] * error[0]
        optimum = optima[segment[k]]
        command, wanted = plus_row(0.0, weights, 0, psi), inner_product(optimum, psi)
        largest = max(largest, abs(wanted))
        if not abs(command) <= OVERLOAD * largest:
            return

        reached = False
        if cure == DIRECTIONAL:
            _forget_along(weights, covariance, shaped, error[0], forgetting, gain)
        elif cure == RESETTING:
            _reset(weights, covariance, shaped, error[0], forgetting, growth, start, gain, spare)
        else:
            kept_share = 1.0 if cure == NO_FORGETTING else forgetting
            if cure == VARIABLE:
                surprise = error[0] ** 2 / noise_power / (1.0 + _leverage(covariance, shaped, gain))
                kept_share = 1.0 - (1.0 - forgetting) * min(surprise, FASTEST)
            _, reached = ferls_update(weights, covariance, kept_share, levels, np.inf, gain, shaped, error)
        if reached:
            hold_triangle(covariance, forgetting, levels, gain)
        if cure == LEAKAGE:
            # One axis a sample with n times the amount: the same on average at the cost of one.
            axis = k % n
            information = n * (1 - forgetting) / (growth * start[axis])
            add_triangle_information(covariance, axis, information, gain)
        elif cure == TRACE_BOUND:
            trace = 0.0
            for i in range(n):
                trace += covariance[i, i]
            excess = trace / bound
            if excess > 1.0:
                for i in range(n):
                    for j in range(n):
                        covariance[i, j] /= excess
        if (k + 1) % every == 0:
            row, distance = k // every, 0.0
            for i in range(n):
                distance += (weights[0, i] - optimum[i]) ** 2 / start[i]
                kept[row, 2 + i] = covariance[i, i] / start[i]
            kept[row, 0] = np.sqrt(distance / first)
            kept[row, 1] = squares / every
            squares = 0.0


def peak_error(run: Run, from_s: float) -> float:
    """Largest filtered error from a moment on over its mean in the ten seconds before; infinite if the run broke."""
    if run.broke_s is not None:
        return float("inf")
    error, before = np.sqrt(run.error_power), (run.time_s > from_s - 10) & (run.time_s <= from_s)
    return float(error[run.time_s > from_s].max() / error[before].mean())
