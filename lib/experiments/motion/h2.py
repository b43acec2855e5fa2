"""H2-optimal observers by two scaled Riccati equations.

They need a regular problem. The one of Fig. 5.2 is singular twice (the estimate does not enter the performance,
and the plant input is measured without noise), so a small cost and a small noise are added; what comes back
is judged by the norm of the original loop, computed apart.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from experiments.motion.generalised_plant import GeneralisedPlant
from stillwork.base.checks import InputError, require_array
from stillwork.base.front_door import checked
from stillwork.lti.norms import h2_norm
from stillwork.lti.state_space import StateModel


@dataclass(frozen=True)
class Synthesis:
    """An observer and the norms of its loop."""

    observer: StateModel
    regular_norm: float  # H2 norm of the regularised loop, recomputed on the closed loop
    norm: float  # H2 norm of the loop as it was posed
    claimed: float  # what the synthesis itself says of the regularised loop
    status: str = "solved"


@checked
def regularised(
    plant: GeneralisedPlant, effort: float | ArrayLike, noise: float | ArrayLike
) -> GeneralisedPlant:
    """Add `effort` times every control to the performance, and white noise to every measurement.

    The effort is in performance units a unit of control, the noise the root of an intensity; they may be zero where
    D12 has full column rank and D21 full row rank.
    """
    a, b1, b2, c1, c2, d11, d12, d21, d22 = plant.blocks
    controls, measurements = b2.shape[1], len(c2)
    effort = np.broadcast_to(require_array("effort", effort), (controls,))
    noise = np.broadcast_to(require_array("noise", noise), (measurements,))
    if np.any(effort < 0) or np.any(noise < 0):
        raise InputError("effort and noise must be positive; they make the problem regular")
    z, w = len(c1), b1.shape[1]
    d = np.block(
        [
            [d11, np.zeros((z, measurements)), d12],
            [np.zeros((controls, w + measurements)), np.diag(effort)],
            [d21, np.diag(noise), d22],
        ]
    )
    b = np.hstack([b1, np.zeros((len(a), measurements)), b2])
    c = np.vstack([c1, np.zeros((controls, len(a))), c2])
    regular = GeneralisedPlant(StateModel(a, b, c, d), w + measurements, z + controls)
    *_, d12, d21, _ = regular.blocks
    for name, matrix in (("effort", d12.T), ("noise", d21)):
        lengths = np.linalg.norm(matrix, axis=1)[:, None]
        if not np.all(lengths) or np.linalg.matrix_rank(matrix / lengths) < len(matrix):
            raise InputError(f"effort and noise must make the problem regular; it takes more {name}")
    return regular


@checked
def h2_riccati(plant: GeneralisedPlant, effort: float | ArrayLike, noise: float | ArrayLike) -> Synthesis:
    """H2-optimal observer of the regularised plant from two Riccati equations, scaled before and checked after.

    The check is the separation theorem: the cost of full information and that of estimating, each from its own
    half of the solution, must add up to the norm of the closed loop.
    """
    regular = regularised(plant, effort, noise)
    scaled, units = scaled_plant(regular)
    a, b1, b2, c1, c2, d11, d12, d21, d22 = scaled.blocks
    if np.any(d11):
        raise InputError("the plant has feedthrough from w to z; its H2 norm is infinite, add a low-pass")
    gain = _filter_gain(a, b1, c2, d21)
    feedback = _filter_gain(a.T, c1.T, b2.T, d12.T).T
    driven = StateModel(a - b2 @ feedback, b1, c1 - d12 @ feedback, d11)
    missed = StateModel(a - gain @ c2, b1 - gain @ d21, d12 @ feedback, np.zeros_like(d11))
    claimed = float(np.hypot(h2_norm(driven), h2_norm(missed)))
    core = a - b2 @ feedback - gain @ c2 + gain @ d22 @ feedback
    observer = in_units(units, core, gain, -feedback)
    return judged(plant, regular, observer, claimed, "solved", WORST_SEPARATION)


# A scaled pair of Riccati equations leaves 1e-8 at worst; the norms of unbalanced loops scatter above that.
WORST_SEPARATION = 1e-5


# Norms below this share of |B1| |C1| of the scaled plant are compared as if they were as large.
LEAST_SHARE = 1e-6


def judged(plant, regular, observer, claimed: float, status: str, tolerance: float) -> Synthesis:
    """An observer with its norms; `InputError` when its loop does not have the norm that its synthesis claims."""
    loop = regular.close(observer)
    achieved = h2_norm(loop) if loop.is_stable else np.inf
    _, b1, _, c1, *_ = scaled_plant(regular)[0].blocks
    scale = float(np.linalg.norm(b1) * np.linalg.norm(c1))
    size = max(claimed, LEAST_SHARE * scale)
    # A norm is the root of a sum that is known to rounding units: near zero to the root of these.
    rounding = 4 * np.sqrt(np.finfo(float).eps) * scale
    if not abs(achieved - claimed) <= tolerance * size + rounding:
        raise InputError(
            f"the solver reports {status!r} with H2 norm {claimed:.6g}, but the loop of its observer has "
            f"{achieved:.6g}: relative residual {(achieved - claimed) / size:.1e}, allowed {tolerance:.1e}"
        )
    return Synthesis(observer, achieved, h2_norm(plant.close(observer)), claimed, status)


def _filter_gain(a, b, c, d) -> np.ndarray:
    """Kalman gain for correlated noise, L = (P C' + B D') (D D')^-1."""
    r = d @ d.T
    try:
        p = linalg.solve_continuous_are(a.T, c.T, b @ b.T, r, s=b @ d.T)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise InputError(
            f"a Riccati equation has no stabilising solution ({error}); check the plant"
        ) from None
    gain = np.linalg.solve(r, (p @ c.T + b @ d.T).T).T
    if not np.all(linalg.eigvals(a - gain @ c).real < 0):
        raise InputError(
            "a Riccati equation has no stabilising solution that could be found; add effort or noise, or rescale"
        )
    return gain


def in_units(units: "Units", a, b, c) -> StateModel:
    """An observer of the scaled plant in the plant's own units."""
    b, c = b * units.rate / units.measurements, c * units.controls[:, None]
    return StateModel(a * units.rate, b, c, np.zeros((len(c), b.shape[1])))


@dataclass(frozen=True)
class Units:
    """Units in which a synthesis is solved."""

    rate: float  # rad/s: time runs in 1/rate
    controls: np.ndarray  # their cost becomes 1
    measurements: np.ndarray  # their noise becomes 1


def scaled_plant(plant: GeneralisedPlant) -> tuple[GeneralisedPlant, Units]:
    """Slow time, unit cost and noise, balanced states; H2 norms stay what they are."""
    a, b1, b2, c1, c2, d11, d12, d21, d22 = plant.blocks
    rate = float(np.median(np.abs(linalg.eigvals(a)))) or 1.0  # most of them may be zero
    controls = 1 / np.linalg.norm(d12, axis=0)
    measurements = np.linalg.norm(d21, axis=1) * np.sqrt(rate)
    each = measurements[:, None]
    b = np.hstack([b1 / np.sqrt(rate), b2 * controls / rate])
    c = np.vstack([c1, c2 / each])
    d = np.block([[d11, d12 * controls], [d21 * np.sqrt(rate) / each, d22 * controls / each]])
    n, size = len(a), len(a) + max(b.shape[1], len(c))
    whole = np.zeros((size, size))
    whole[:n, :n], whole[:n, n : n + b.shape[1]], whole[n : n + len(c), :n] = a / rate, b, c
    _, (scale, _) = linalg.matrix_balance(whole, permute=False, separate=True)
    scale = scale[:n]
    model = StateModel(a * scale / scale[:, None] / rate, b / scale[:, None], c * scale, d)
    return GeneralisedPlant(model, plant.exogenous, plant.performance), Units(rate, controls, measurements)
