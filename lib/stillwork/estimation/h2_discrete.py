"""H2-optimal controllers and observers of a plant in discrete time, by two Riccati equations."""

import numpy as np
from scipy import linalg

from stillwork.base.checks import InputError
from stillwork.base.validation import checked
from stillwork.lti.generalised_plant import GeneralisedPlant, with_feedthrough
from stillwork.lti.norms import h2_norm
from stillwork.lti.scaling import state_scale
from stillwork.lti.state_space import StateModel

WORST_SEPARATION = 1e-6  # of the loop's norm from that which the equations promise, relative


@checked
def discrete_h2(plant: GeneralisedPlant) -> tuple[StateModel, float]:
    r"""Controller u = K y with the smallest H2 norm, and that norm as it follows from the two equations.

    With :math:`R_b = D_{12}^TD_{12} + B_2^TXB_2` the cost of a control u is that of its distance from
    :math:`Fx + F_0w`, so the best one is the estimate of this from all measurements up to its own sample: it has
    feedthrough. Zhou, Doyle and Glover, Robust and Optimal Control (1996), section 21.7.
    """
    a, b1, b2, c1, c2, d11, d12, d21, d22 = _balanced(plant)
    x = _solution("control", a, b2, c1.T @ c1, d12.T @ d12, c1.T @ d12)
    y = _solution("estimation", a.T, c2.T, b1 @ b1.T, d21 @ d21.T, b1 @ d21.T)
    cost, innovation = d12.T @ d12 + b2.T @ x @ b2, d21 @ d21.T + c2 @ y @ c2.T
    feedback = -np.linalg.solve(cost, b2.T @ x @ a + d12.T @ c1)
    of_noise = -np.linalg.solve(cost, b2.T @ x @ b1 + d12.T @ d11)
    gain = np.linalg.solve(innovation, (a @ y @ c2.T + b1 @ d21.T).T).T
    direct = np.linalg.solve(innovation, (feedback @ y @ c2.T + of_noise @ d21.T).T).T
    steer = gain + b2 @ direct
    seen = feedback - direct @ c2
    controller = StateModel(a + b2 @ feedback - steer @ c2, steer, seen, direct, plant.model.sample_time)
    power = np.trace(d11.T @ d11 + b1.T @ x @ b1)
    power += np.trace(cost @ (feedback @ y @ feedback.T - direct @ innovation @ direct.T))
    return with_feedthrough(controller, d22), float(np.sqrt(max(power, 0.0)))


@checked
def require_promised(loop: StateModel, promised: float) -> float:
    """The norm of a loop; `InputError` where it is not stable or not what was promised."""
    norm = h2_norm(loop) if loop.is_stable else np.inf
    scale = np.linalg.norm(loop.b) * np.linalg.norm(loop.c) * np.sqrt(np.finfo(float).eps)
    if not abs(norm - promised) <= WORST_SEPARATION * promised + scale:
        raise InputError(
            f"the equations promise an H2 norm of {promised:.6g}, but the loop of their controller has {norm:.6g}; add "
            "effort or noise, or rescale the plant"
        )
    return norm


def _balanced(plant: GeneralisedPlant) -> tuple[np.ndarray, ...]:
    """The plant's blocks with balanced states."""
    a, b1, b2, c1, c2, *feedthrough = plant.blocks
    inputs, outputs = np.hstack([b1, b2]), np.vstack([c1, c2])
    out = state_scale(a, inputs / (np.linalg.norm(inputs) or 1.0), outputs / (np.linalg.norm(outputs) or 1.0))
    into = out[:, None]
    return a * out / into, b1 / into, b2 / into, c1 * out, c2 * out, *feedthrough


def _solution(name: str, a, b, q, r, s) -> np.ndarray:
    """Stabilising solution of a discrete Riccati equation."""
    try:
        found = linalg.solve_discrete_are(a, b, q, r, s=s)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise InputError(
            f"the Riccati equation of the {name} has no stabilising solution that could be found ({error}); check the "
            "plant, or add effort or noise"
        ) from None
    if not np.isfinite(found).all():
        raise InputError(f"the Riccati equation of the {name} has no finite solution; rescale the plant")
    return found
