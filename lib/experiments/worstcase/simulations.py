"""The simulations of Section 9: FIR identification (Fig. 1) and tracking (Fig. 2 and its variations).

The paper leaves open the true parameters and the square wave's period of Fig. 1, and the regressors, the
noise and the length of Fig. 2; what is assumed is a parameter here and named in the notebooks.
"""

import numpy as np
from scipy import signal, special

from stillwork.base.checks import InputError
from stillwork.estimation.recursive import track, worst_case_residuals
from stillwork.identification.regressors import fir_regressors

FIG_2_PARAMETERS = (-0.0134, -0.0316, 0.0265, -0.0114, 0.0132)


def fir_trial(
    rng: np.random.Generator,
    parameters: tuple[float, ...],
    period: int,
    samples: int,
    input_noise: float,
    output_noise: float,
    law: str = "uniform",
    update: str = "exact",
) -> dict[str, np.ndarray]:
    """One realisation of Fig. 1: square wave into an FIR filter, input and output measured with bounded noise.

    The `law` of both noises is ``uniform`` or ``cut Gaussian``, `update` ``exact`` or ``approximate``, algorithm (20).

    ``min_max``, ``total``, ``least`` (unknowns x samples): estimates from all rows up to t, NaN before
    there are more rows than unknowns. ``min_max_worst``, ``total_worst``, ``least_worst``: worst-case
    residuals |A x - b| + eta |x|. ``total_target``: norm of the correction of b. ``total_matrix``: norm
    of the correction of A. ``perturbation``: norm of the true perturbation. ``bound``: eta_t.
    """
    noises = {"input_noise": input_noise, "output_noise": output_noise, "law": law}
    regressors, outputs, errors = fir_record(rng, parameters, period, samples, **noises)
    taps = len(regressors)
    bounds = np.sqrt(taps) * input_noise * np.sqrt(np.arange(1.0, samples + 1))
    settings = {"bound": bounds, "iterations": int(update == "approximate"), "silent": True}
    found = {"min_max": track(regressors, outputs, **settings).estimates}
    found["least"], found["total"], correction = _growing_windows(regressors, outputs)
    found |= {
        f"{name}_worst": worst_case_residuals(regressors, outputs, values, bounds, 1.0)
        for name, values in found.items()
    }
    found = {name: np.where(np.arange(samples) < taps, np.nan, values) for name, values in found.items()}
    length = np.linalg.norm(found["total"], axis=0)
    found["total_matrix"] = correction * length / np.hypot(1, length)
    found["total_target"] = correction / np.hypot(1, length)
    outer = np.cumsum(errors[:, None] * errors[None], axis=2)
    found["perturbation"] = np.sqrt(np.linalg.eigvalsh(np.moveaxis(outer, 2, 0))[:, -1])
    found["bound"] = bounds
    return found


def fir_record(rng, parameters, period, samples, input_noise, output_noise, law="uniform"):
    """Measured regressors, outputs, and the errors of the regressors."""
    parameters = np.asarray(parameters, float)
    taps = len(parameters)
    clean = signal.square(2 * np.pi * (np.arange(samples + taps - 1) + 0.5) / period)
    error = sample_bounded(rng, law, input_noise, len(clean))
    full = slice(taps - 1, None)  # every row holds measured samples only
    outputs = parameters @ fir_regressors(clean, taps)[:, full]
    outputs += sample_bounded(rng, law, output_noise, samples)
    errors = fir_regressors(error, taps)[:, full]
    return fir_regressors(clean, taps)[:, full] + errors, outputs, errors


def sample_bounded(rng: np.random.Generator, law: str, bound: float, count: int) -> np.ndarray:
    """Independent noise within +-`bound`, ``uniform`` or ``cut Gaussian``; it is cut at two standard deviations."""
    if law == "uniform":
        return rng.uniform(-bound, bound, count)
    tail = special.ndtr(-2.0)
    return bound / 2 * special.ndtri(rng.uniform(tail, 1 - tail, count))


def _growing_windows(regressors, outputs):
    # least squares and total least squares of rows 0..t for all t, from sums of products: (A'A) x = A'b, and
    # the eigenvector of the smallest eigenvalue of [A b]'[A b]
    stacked = np.vstack([regressors, outputs])
    products = np.moveaxis(np.cumsum(stacked[:, None] * stacked[None], axis=2), 2, 0)
    unknowns = len(regressors)
    values, vectors = np.linalg.eigh(products)
    smallest = vectors[:, :, 0]
    least, total = np.zeros((2, *regressors.shape))
    late = products[unknowns:]  # from there on A has more rows than columns
    information, correlation = late[:, :unknowns, :unknowns], late[:, :unknowns, unknowns:]
    least[:, unknowns:] = np.linalg.solve(information, correlation)[..., 0].T
    total[:, unknowns:] = -(smallest[unknowns:, :unknowns] / smallest[unknowns:, unknowns:]).T
    return least, total, np.sqrt(np.maximum(values[:, 0], 0))


def path(kind: str, parameters: tuple[float, ...], samples: int) -> np.ndarray:
    """True parameters along time, shape (unknowns, samples): ``constant``, ``jump`` or ``drift``.

    A jump changes the sign of all parameters at half of the record. A drift turns the first two parameters
    by one revolution along it.
    """
    parameters = np.asarray(parameters, float)
    values = np.repeat(parameters[:, None], samples, axis=1)
    if kind == "jump":
        values[:, samples // 2 :] *= -1
    elif kind == "drift" and len(parameters) > 1:
        angle, (first, second) = 2 * np.pi * np.arange(samples) / samples, parameters[:2]
        values[0] = np.cos(angle) * first - np.sin(angle) * second
        values[1] = np.sin(angle) * first + np.cos(angle) * second
    elif kind != "constant":
        raise InputError(f"kind is {kind!r}; use 'constant', 'jump' or, for two parameters or more, 'drift'")
    return values


def sample_problem(seed: int, rows: int, unknowns: int, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Data A, b with standard normal regressors, parameters 1, -1/2, 1/3, ... and Gaussian noise on b."""
    rng = np.random.default_rng(seed)
    matrix = rng.standard_normal((rows, unknowns))
    truth = (-1.0) ** np.arange(unknowns) / np.arange(1.0, unknowns + 1)
    return matrix, matrix @ truth + noise * rng.standard_normal(rows)
