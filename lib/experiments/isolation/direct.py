"""The FeRLS update before it is made efficient: Section 4.3 and the appendices, equation by equation.

These forms exist to be compared with: they give the same weights as the recursion of `adaptation` at a cost that
grows with the third power of the number of parameters.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.checks import require_array, require_choice, require_count, require_number

FORMS = ("full inverse", "Newton", "block inverse")


@dataclass(frozen=True)
class DirectRun:
    """Identification with one of the direct forms."""

    weights: Float64[np.ndarray, "samples actuators n"]  # W after every sample
    # adaptation gain matrix after the last sample: of all parameters (26), or P (28)
    gain: Float64[np.ndarray, "parameters parameters"]

    @property
    def blocks(self) -> Float64[np.ndarray, "actuators actuators n n"]:
        """Blocks of the gain matrix, eq. (27)."""
        n = self.weights.shape[2]
        count = len(self.gain) // n
        return np.ascontiguousarray(self.gain.reshape(count, n, count, n).transpose(0, 2, 1, 3))


def direct_run(
    form: str, regressors: ArrayLike, disturbance: ArrayLike, epsilon: float, forgetting: float
) -> DirectRun:
    """Fit weights to a record as `identify` does, with a matrix inverse at every sample; the error is e = d + W psi_N.

    ``full inverse``: eq. (25)-(26), the information matrix of all parameters. ``Newton``: eq. (20)-(24), the same
    with the Hessian as a sample average and the step alpha. ``block inverse``: eq. (28), one block. P(-1) = I /
    epsilon.
    """
    require_choice("form", form, FORMS)
    regressors = require_array("regressors", regressors, ndim=2)
    n, samples = regressors.shape
    disturbance = require_array("disturbance", disturbance, shape=(None, samples))
    actuators = len(disturbance)
    require_number("epsilon", epsilon, above=0.0)
    require_number("forgetting", forgetting, above=0.0, at_most=1.0)
    alpha = average_gain(forgetting, samples)
    copies = 1 if form == "block inverse" else actuators
    information = epsilon * np.eye(copies * n)
    w = np.zeros((actuators, n))
    history = np.empty((samples, actuators, n))
    for k, (psi, d) in enumerate(zip(regressors.T, disturbance.T, strict=True)):
        error = d + w @ psi
        matrix = np.kron(np.eye(copies), psi)  # Psi_N, eq. (14)
        information = forgetting * information + matrix.T @ matrix
        if form == "Newton":
            hessian = alpha[k] * information  # eq. (21)
            gain = alpha[k] * np.linalg.inv(hessian)
        else:
            gain = np.linalg.inv(information)
        if copies == actuators:
            w = w - (gain @ matrix.T @ error).reshape(actuators, n)
        else:
            w = w - np.outer(error, gain @ psi)
        history[k] = w
    return DirectRun(history, gain)


def largest_condition(regressors: ArrayLike, epsilon: float, forgetting: float) -> float:
    """Largest condition number of the information matrix of one block on the way, eq. (28).

    The matrix of all parameters repeats the block, so it has the same one.
    """
    regressors = require_array("regressors", regressors, ndim=2)
    require_number("epsilon", epsilon, above=0.0)
    require_number("forgetting", forgetting, above=0.0, at_most=1.0)
    information, largest = epsilon * np.eye(len(regressors)), 1.0
    for psi in regressors.T:
        information = forgetting * information + np.outer(psi, psi)
        largest = max(largest, float(np.linalg.cond(information)))
    return largest


def average_gain(forgetting: float, samples: int) -> Float64[np.ndarray, "samples"]:
    """alpha(k) that makes an exponentially weighted sum an average, eq. (22) and (B.4)."""
    require_number("forgetting", forgetting, above=0.0, at_most=1.0)
    count = np.arange(1.0, require_count("samples", samples) + 1)
    if forgetting == 1:
        return 1 / count
    # expm1 keeps the digits of 1 - lambda^(k+1) while that is small.
    return (1 - forgetting) / -np.expm1(count * np.log(forgetting))


def multiplications(actuators: int, regressors: int) -> Mapping[str, int]:
    """Multiplications and divisions of one update in each form, every matrix taken as dense.

    An inverse by Gauss and Jordan takes N³ of them.
    """
    m = require_count("actuators", actuators)
    n = require_count("regressors", regressors)
    full = m * n
    return {
        # lambda A, Psi' Psi, inverse, Psi' e, gain times that
        "full inverse": full**2 + full**2 * m + full**3 + full * m + full**2,
        # the same for one block: lambda A, psi psi', inverse, P psi, W
        "block inverse": 2 * n**2 + n**3 + n**2 + m * n,
        # P psi, psi' P psi, its share; two reciprocals; the triangle; W
        "recursion": n**2 + 2 * n + 2 + n + n * (n + 1) + m * n,
        # psi' psi, trace and rate, rate times e, W
        "FeLMS": n + 2 + m + m * n,
    }
