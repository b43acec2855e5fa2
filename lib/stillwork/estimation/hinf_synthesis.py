"""H-infinity controllers of a generalised plant, by two Riccati equations a level, in continuous or discrete time."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy import linalg

from stillwork.base.bounds import Fraction, Positive
from stillwork.base.checks import InputError
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.lti.discretisation import tustin
from stillwork.lti.generalised_plant import GeneralisedPlant, with_feedthrough
from stillwork.lti.norms import hinf_norm, to_bilinear
from stillwork.lti.state_space import StateModel, state_scale

SEARCHES = 200  # levels that a search may try
SEMIDEFINITE = 1e-7  # a solution's eigenvalues this far below zero are rounding, of the largest or of 1
EXCEEDED = 1e-6  # by how much, relative, a loop's norm may exceed its level by rounding


@by_value
@dataclass(frozen=True)
class HinfSynthesis:
    """A controller and the H-infinity norm of its loop.

    Attributes
    ----------
    controller : StateModel
        From the measurements y to the controls u.
    level : float
        Design level: the norm of the loop is below it.
    norm : float
        H-infinity norm of the closed loop from w to z, computed on the loop.
    omega : float
        Frequency at which it is reached, rad/s.

    Examples
    --------
    >>> model = lti.StateModel([[-1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    >>> found = estimation.hinf_riccati(lti.GeneralisedPlant(model, exogenous=2, performance=2), level=1.0)
    >>> bool(found.norm < found.level)
    True
    """

    controller: StateModel
    level: float
    norm: float
    omega: float

    def __post_init__(self):
        check_fields(self)


@by_value
@dataclass(frozen=True)
class _Normal:
    """A plant in continuous time with D12 = [0; I], D21 = [0 I] and D22 = 0, and the way back."""

    blocks: tuple[np.ndarray, ...]  # A, B1, B2, C1, C2, D11
    feedthrough: Float64[np.ndarray, "measurements controls"]  # D22, which was taken out
    controls: Float64[np.ndarray, "controls controls"]  # u = this times the normal plant's
    measurements: Float64[np.ndarray, "measurements measurements"]  # the normal plant's y = this times y
    rate: float  # rad/s: time runs in 1/rate


@checked
def hinf_riccati(
    plant: GeneralisedPlant,
    level: Positive | None = None,
    tolerance: Fraction = 1e-4,
) -> HinfSynthesis:
    r"""Controller u = K y that keeps the H-infinity norm from w to z below a level, or makes it as small as can be.

    The central controller of Glover and Doyle. A plant in discrete time is solved by the bilinear transformation,
    which keeps the norm. Every result is checked in closed loop: one that is unstable or exceeds its level is never returned.

    Parameters
    ----------
    plant : GeneralisedPlant
        In continuous or discrete time; it may be unstable, and have feedthrough in all of its blocks. Every control
        must reach the performance directly (:math:`D_{12}` of full column rank) and every measurement must have noise
        of its own (:math:`D_{21}` of full row rank).
    level : float, optional
        Largest allowed norm. By default the smallest one is sought.
    tolerance : float
        Relative tolerance of the search for the smallest level.

    Returns
    -------
    HinfSynthesis
        The controller, proper, of as many states as the plant.

    Raises
    ------
    InputError
        When no controller reaches the level, the problem is not regular, or no solution is accurate.

    References
    ----------
    Glover and Doyle, Systems & Control Letters 11 (1988), 167-172; Zhou, Doyle and Glover, Robust and Optimal Control
    (1996), theorem 17.1.

    Examples
    --------
    An integrator whose input is disturbed and whose output is measured with noise; its output and effort count.

    >>> a, b, c = [[0.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]]
    >>> model = lti.StateModel(a, b, c, [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    >>> found = estimation.hinf_riccati(lti.GeneralisedPlant(model, exogenous=2, performance=2))
    >>> round(found.level, 3)  # the root of 2
    1.414
    """
    normal = _normalised(plant)
    if level is not None:
        found = _closed(plant, normal, level)
        if found is None:
            raise InputError(
                f"no controller keeps the norm below level {level:.6g}, or no accurate one; raise it, or "
                "leave it out to find the smallest"
            )
        return found
    low, high, best = _least_level(normal), _least_level(normal) or 1.0, None
    for _ in range(SEARCHES):
        if best is None:  # upwards until there is one
            high *= 2
        middle = high if best is None else np.sqrt(low * high) if low > high / 1e3 else high / 10
        found = _closed(plant, normal, middle)
        if found is None:
            low = middle
        else:
            best, high = found, middle
        if best is not None and high <= (1 + tolerance) * low:
            break
    if best is None:
        raise InputError(
            "no controller was found at any level; check that the controls reach, and the measurements see, all that "
            "is not stable"
        )
    return best


def _normalised(plant: GeneralisedPlant) -> _Normal:
    """Slow time, balanced states, controls and measurements in units and directions in which D12 and D21 are units."""
    discrete = plant.model.sample_time > 0
    model = to_bilinear(plant.model) if discrete else plant.model
    shifted = GeneralisedPlant(model, plant.exogenous, plant.performance)
    a, b1, b2, c1, c2, d11, d12, d21, d22 = shifted.blocks
    if not len(a):
        raise InputError("plant has no states; there is nothing to control")
    turns = []
    for name, matrix in (("control reaches the performance", d12), ("measurement has noise", d21.T)):
        lengths = np.linalg.norm(matrix, axis=0)
        if matrix.shape[0] < matrix.shape[1] or not np.all(lengths):
            raise InputError(f"plant is not regular: not every {name}; add effort or noise")
        q, r = linalg.qr(matrix)
        k = matrix.shape[1]
        if np.linalg.cond(r[:k] / np.linalg.norm(r[:k], axis=0)) > 1e12:
            raise InputError(f"plant is not regular: not every {name} by itself; add effort or noise")
        turns.append((np.hstack([q[:, k:], q[:, :k]]), r[:k]))
    (left, effort), (right, noise) = turns
    rate = float(np.median(np.abs(linalg.eigvals(a)))) or 1.0
    inputs = np.hstack([b1 @ right, np.linalg.solve(effort.T, b2.T).T]) / rate
    outputs = np.vstack([left.T @ c1, np.linalg.solve(noise.T, c2)])
    scale = state_scale(a / rate, inputs, outputs)
    inputs, outputs = inputs / scale[:, None], outputs * scale
    w, z = b1.shape[1], len(c1)
    blocks = (
        a * scale / scale[:, None] / rate,
        inputs[:, :w],
        inputs[:, w:],
        outputs[:z],
        outputs[z:],
        left.T @ d11 @ right,
    )
    return _Normal(blocks, d22, np.linalg.inv(effort), np.linalg.inv(noise.T), rate)


def _least_level(normal: _Normal) -> float:
    """Below this level the feedthrough that no controller touches is too large."""
    *_, b2, _, c2, d11 = normal.blocks
    rows, columns = len(d11) - b2.shape[1], d11.shape[1] - len(c2)
    parts = (d11[:rows], d11[:, :columns])
    return max((float(np.linalg.norm(part, 2)) for part in parts if part.size), default=0.0)


def _stabilising(hamiltonian: np.ndarray) -> np.ndarray | None:
    """Solution of the Riccati equation of a Hamiltonian matrix: of its stable subspace; None where it has none."""
    n = len(hamiltonian) // 2
    if not np.isfinite(hamiltonian).all():
        return None
    balanced, (scale, _) = linalg.matrix_balance(hamiltonian, permute=False, separate=True)
    try:
        _, basis, stable = linalg.schur(balanced, sort="lhp")
    except linalg.LinAlgError:
        return None
    if stable != n:
        return None
    basis = basis[:, :n] * scale[:, None]
    upper, lower = basis[:n], basis[n:]
    if np.linalg.cond(upper) > 1e14:
        return None
    solution = np.linalg.solve(upper.T, lower.T).T
    solution = (solution + solution.T) / 2
    # In balanced states the rounding of a solution of zero, of square D12 or D21, is that of 1.
    unit = np.sqrt(scale[n:] / scale[:n])
    values = linalg.eigvalsh(solution / unit / unit[:, None])
    return solution if values[0] >= -SEMIDEFINITE * max(abs(values[-1]), 1.0) else None


def _central(normal: _Normal, level: float) -> StateModel | None:
    """The central controller of a normal plant; None where there is none at this level."""
    if level <= _least_level(normal):
        return None
    a, b1, b2, c1, c2, d11 = normal.blocks
    b1, c2, d11 = b1 / level, c2 * level, d11 / level  # w and y in units in which the level is 1
    n, w, z, m, p = len(a), b1.shape[1], len(c1), b2.shape[1], len(c2)
    d12, d21 = np.eye(z, m, m - z), np.eye(p, w, w - p)
    b, c = np.hstack([b1, b2]), np.vstack([c1, c2])
    across, down = np.hstack([d11, d12]), np.vstack([d11, d21])
    r = across.T @ across - linalg.block_diag(np.eye(w), np.zeros((m, m)))
    s = down @ down.T - linalg.block_diag(np.eye(z), np.zeros((p, p)))
    try:
        forward = np.linalg.solve(r, np.hstack([across.T @ c1, b.T]))
        backward = np.linalg.solve(s, np.hstack([down @ b1.T, c]))
    except np.linalg.LinAlgError:
        return None
    zero = np.zeros((n, n))
    x = _stabilising(np.block([[a, zero], [-c1.T @ c1, -a.T]]) - np.vstack([b, -c1.T @ across]) @ forward)
    y = _stabilising(np.block([[a.T, zero], [-b1 @ b1.T, -a]]) - np.vstack([c.T, -b1 @ down.T]) @ backward)
    if x is None or y is None or np.abs(linalg.eigvals(x @ y)).max() >= 1:
        return None
    f = -np.linalg.solve(r, across.T @ c1 + b.T @ x)
    gain = -np.linalg.solve(s, (b1 @ down.T + y @ c.T).T).T
    f12, f2 = f[w - p : w], f[w:]
    l12, l2 = gain[:, z - m : z], gain[:, z:]
    d1111, d1112 = d11[: z - m, : w - p], d11[: z - m, w - p :]
    d1121, d1122 = d11[z - m :, : w - p], d11[z - m :, w - p :]
    feed = -d1122 - d1121 @ d1111.T @ np.linalg.solve(np.eye(z - m) - d1111 @ d1111.T, d1112)
    coupling = np.eye(n) - y @ x
    into = np.linalg.solve(coupling, np.hstack([l2, b2 + l12]))
    seen = c2 + f12
    steer = -into[:, :p] + into[:, p:] @ feed
    parts = (a + b @ f - steer @ seen, steer * level, f2 - feed @ seen, feed * level)
    return StateModel(*parts) if all(np.isfinite(part).all() for part in parts) else None


def _closed(plant: GeneralisedPlant, normal: _Normal, level: float) -> HinfSynthesis | None:
    """The controller of a level in the plant's own units, where its loop keeps it."""
    found = _central(normal, level)
    if found is None:
        return None
    b, c = found.b @ normal.measurements, normal.controls @ found.c
    d = normal.controls @ found.d @ normal.measurements
    controller = StateModel(found.a * normal.rate, b * normal.rate, c, d)
    sample_time = plant.model.sample_time
    try:
        controller = with_feedthrough(controller, normal.feedthrough)
        if sample_time:  # s of `to_bilinear` counts in half the rate
            rate = 2 / sample_time
            slow = StateModel(controller.a * rate, controller.b * rate, controller.c, controller.d)
            controller = tustin(slow, sample_time)
        loop = plant.close(controller)
        peak = hinf_norm(loop) if loop.is_stable else None
    except (InputError, np.linalg.LinAlgError):
        return None
    if peak is None or not peak.magnitude <= level * (1 + EXCEEDED):
        return None
    return HinfSynthesis(controller, float(level), peak.magnitude, peak.omega)
