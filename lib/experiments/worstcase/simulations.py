"""The simulations of Section 9: FIR identification (Fig. 1) and tracking (Fig. 2 and its variations).

The paper leaves open the true parameters and the square wave's period of Fig. 1, and the regressors, the
noise and the length of Fig. 2; what is assumed is a parameter here and named in the notebooks.
"""

import numpy as np
from scipy import signal, special

from stillwork.base.checks import InputError
from stillwork.estimation.min_max import min_max_solve
from stillwork.estimation.recursive import run_silently, worst_case_residuals
from stillwork.estimation.recursive_settings import GrowingMinMax, LeastSquares, MinMax, Ridge
from stillwork.identification.regressors import exponential_bound, exponential_weights, fir_regressors

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

    The `law` of both noises is ``uniform`` or ``cut Gaussian``, `update` that of `GrowingMinMax`.

    ``min_max``, ``total``, ``least`` (unknowns x samples): estimates from all rows up to t, NaN before
    there are more rows than unknowns. ``min_max_worst``, ``total_worst``, ``least_worst``: worst-case
    residuals |A x - b| + eta |x|. ``total_target``: norm of the correction of b. ``total_matrix``: norm
    of the correction of A. ``perturbation``: norm of the true perturbation. ``bound``: eta_t.
    """
    noises = {"input_noise": input_noise, "output_noise": output_noise, "law": law}
    regressors, outputs, errors = _fir_record(rng, parameters, period, samples, **noises)
    taps = len(regressors)
    estimator = GrowingMinMax(np.sqrt(taps) * input_noise, update)
    bounds = estimator.bounds(0, samples)
    found = {"min_max": run_silently(estimator, regressors, outputs).estimates}
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


def _fir_record(rng, parameters, period, samples, input_noise, output_noise, law="uniform"):
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


def gain_trial(
    rng: np.random.Generator,
    parameters: tuple[float, ...],
    period: int,
    samples: int,
    gain: float,
    output_noise: float,
) -> dict[str, float]:
    """One record whose true input is `gain` times the measured one: a perturbation that is the same at every instant.

    Distances from the true parameters: of ``min_max``, given the norm of that perturbation, and of ``least`` squares.
    """
    regressors, outputs, _ = _fir_record(rng, gain * np.array(parameters), period, samples, 0.0, output_noise)
    bound = abs(gain - 1) * np.linalg.norm(regressors, 2)
    estimates = {
        "min_max": min_max_solve(regressors.T, outputs, bound).estimate,
        "least": np.linalg.lstsq(regressors.T, outputs)[0],
    }
    return {name: float(np.linalg.norm(estimate - parameters)) for name, estimate in estimates.items()}


def criterion_trial(
    rng: np.random.Generator, shares: tuple[float, ...], parameters: tuple[float, ...], **record
) -> dict[str, np.ndarray]:
    """``saved``: by how much the smallest worst-case residual is below that of least squares, as a share of it.

    The bound is each of `shares` of the one at which the estimate becomes zero; `record` as of `fir_trial`.
    """
    regressors, outputs, _ = _fir_record(rng, parameters, **record)
    matrix = regressors.T
    least = np.linalg.lstsq(matrix, outputs)[0]
    residual, length = np.linalg.norm(matrix @ least - outputs), np.linalg.norm(least)
    bounds = np.array(shares) * np.linalg.norm(matrix.T @ outputs) / np.linalg.norm(outputs)
    worst = [min_max_solve(matrix, outputs, bound).worst_case_residual for bound in bounds]
    return {"saved": 1 - np.array(worst) / (residual + bounds * length)}


def least_squares_limit(parameters: tuple[float, float], period: int, input_noise: float) -> np.ndarray:
    """What least squares tends to in Fig. 1's setting: (R + s I)^-1 R x.

    R is the input's covariance, for two taps of a square wave of amplitude 1 with an even `period`; s the
    variance of the uniform input noise, input_noise^2 / 3.
    """
    parameters = np.asarray(parameters, float)
    neighbour = 1 - 4 / period
    covariance = np.array([[1, neighbour], [neighbour, 1]])
    return np.linalg.solve(covariance + input_noise**2 / 3 * np.eye(2), covariance @ parameters)


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


def tracking_record(
    rng: np.random.Generator,
    truth: np.ndarray,
    row_error: float,
    noise: float,
    amplitude: float = 1.0,
    delay_line: bool = False,
    error_law: str = "ball",
) -> tuple[np.ndarray, np.ndarray]:
    """Regressors as measured (unknowns, samples) and outputs of a trial of Fig. 2; arguments as of `tracking_trial`."""
    unknowns, samples = truth.shape
    if delay_line:
        regressors = fir_regressors(rng.standard_normal(samples + unknowns - 1), unknowns)[:, unknowns - 1 :]
    else:
        regressors = rng.standard_normal((unknowns, samples))
    regressors *= amplitude
    directions = rng.standard_normal((unknowns, samples))
    radius = row_error * rng.random(samples) ** (1 / unknowns)
    if error_law != "ball":
        radius[:] = row_error
    if error_law == "one direction":
        directions[:] = directions[:, :1]
    errors = directions * (radius / np.linalg.norm(directions, axis=0))
    outputs = np.sum((regressors + errors) * truth, axis=0) + noise * rng.standard_normal(samples)
    return regressors, outputs


def forgetting_trial(
    rng: np.random.Generator, truth: np.ndarray, forgetting: float, row_error: float, noise: float
) -> dict[str, float]:
    """RMS error norm over the second half of a trial of Fig. 2, with forgetting and without.

    ``min_max``, ``least``: with `forgetting`; ``min_max_kept``, ``least_kept``: all rows count alike.
    """
    rows, outputs = tracking_record(rng, truth, row_error, noise)
    estimators = {
        "min_max": MinMax(exponential_bound(row_error, forgetting), forgetting),
        "min_max_kept": GrowingMinMax(row_error),
        "least": LeastSquares(forgetting, 1e4),
        "least_kept": LeastSquares(1 - 1e-12, 1e4),
    }
    late = slice(truth.shape[1] // 2, None)
    tracks = {
        name: run_silently(estimator, rows, outputs).estimates for name, estimator in estimators.items()
    }
    return {
        name: float(np.sqrt(np.mean(np.sum((track - truth)[:, late] ** 2, axis=0))))
        for name, track in tracks.items()
    }


def tracking_trial(
    rng: np.random.Generator,
    truth: np.ndarray,
    bound: float,
    forgetting: float,
    row_error: float,
    noise: float,
    penalty: float,
    update: str = "exact",
    amplitude: float = 1.0,
    delay_line: bool = False,
    error_law: str = "ball",
) -> dict[str, np.ndarray]:
    """One trial of Fig. 2: white regressors that are off by a bounded error, outputs with Gaussian noise.

    `truth` is from `path`; RLS and ridge, with its constant `penalty`, forget like min-max. The regressors have the
    standard deviation `amplitude`, each row anew or, in a `delay_line`, one sample a row. Their errors are drawn
    uniformly from the ``ball`` of radius `row_error` or its ``sphere``, or have all ``one direction`` and that length.
    ``min_max``, ``rls``, ``ridge``, ``zero``: error norms |x_t - estimate|, shape (samples,); ``norm``: |A|_2 of the
    unweighted regressors, ``weighted_norm`` of the weighted ones at the end; ``vanished``: share of the time with a
    zero estimate.
    """
    unknowns = len(truth)
    regressors, outputs = tracking_record(rng, truth, row_error, noise, amplitude, delay_line, error_law)
    min_max = run_silently(MinMax(bound, forgetting, update), regressors, outputs)
    tracks = {
        "min_max": min_max.estimates,
        "rls": run_silently(LeastSquares(forgetting, 1e4), regressors, outputs).estimates,
        "ridge": run_silently(Ridge(penalty, forgetting), regressors, outputs).estimates,
        "zero": np.zeros_like(truth),
    }
    found = {name: np.linalg.norm(truth - values, axis=0) for name, values in tracks.items()}
    found["norm"] = np.linalg.norm(regressors, 2)
    weights = exponential_weights(truth.shape[1], forgetting)
    found["weighted_norm"] = np.linalg.norm(regressors * weights, 2)
    found["vanished"] = np.isinf(min_max.alphas[unknowns:]).mean()
    return found


def settled(errors: np.ndarray, forgetting: float, memories: float = 3.0) -> np.ndarray:
    """Root mean square of error norms (..., samples) after so many memory lengths 1 / (1 - forgetting)."""
    start = settled_from(forgetting, memories)
    return np.sqrt(np.mean(np.square(errors[..., start:]), axis=-1))


def settled_from(forgetting: float, memories: float = 3.0) -> int:
    """The sample after so many memory lengths."""
    return int(np.ceil(memories / (1 - forgetting)))


def sample_problem(seed: int, rows: int, unknowns: int, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Data A, b with standard normal regressors, parameters 1, -1/2, 1/3, ... and Gaussian noise on b."""
    rng = np.random.default_rng(seed)
    matrix = rng.standard_normal((rows, unknowns))
    truth = (-1.0) ** np.arange(unknowns) / np.arange(1.0, unknowns + 1)
    return matrix, matrix @ truth + noise * rng.standard_normal(rows)
