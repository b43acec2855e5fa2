"""What section 5.4.3 of the observer thesis says of Fig. 5.10 and of its cause, asked of recorded scans."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64
from numpy.typing import ArrayLike

from experiments.motion.contest import Contest, run_entrant
from experiments.motion.scan_study import Errors, Records, Scan, record_scans, rms
from experiments.motion.uncertainty import sample_errors
from stillwork.base.checks import require_array

AS_KALMAN = 0.05  # "identical" rigid-body errors of two filters: the width of a line in the figure
_FLEXIBLE, _POSITIONS = slice(2, 6), [2, 4]


def figure_statements(
    kalman: Errors, penalised: Errors, regularised: Errors
) -> dict[str, Bool[np.ndarray, " runs"]]:
    """On which plants each statement about Fig. 5.10 holds; the figure shows rigid body, first and second mode."""

    def all_of(holds):
        return np.all(holds, axis=1)

    rigid = penalised.rms[:, :2] / kalman.rms[:, :2]
    return {
        "regularised-best-on-rigid": regularised.rms[:, 0] < np.minimum(kalman.rms, penalised.rms)[:, 0],
        "sensitivity-rigid-as-kalman": all_of(np.abs(rigid - 1) < AS_KALMAN),
        "regularised-worst-on-flexible": all_of(
            (regularised.rms > np.maximum(kalman.rms, penalised.rms))[:, _FLEXIBLE]
        ),
        "regularised-above-state": all_of((regularised.rms > regularised.size)[:, _FLEXIBLE]),
        "sensitivity-drift": all_of((np.abs(penalised.drift) > np.abs(kalman.drift))[:, _POSITIONS]),
        "sensitivity-end-above-state": all_of((np.abs(penalised.end) > penalised.size)[:, _POSITIONS]),
        "kalman-below-state-move": all_of((kalman.move < kalman.move_size)[:, _FLEXIBLE]),
        "kalman-below-state-scan": all_of((kalman.rms < kalman.size)[:, _FLEXIBLE]),
        "larger-in-acceleration": np.all(
            [(e.accelerating > e.rms)[:, _POSITIONS] for e in (kalman, penalised, regularised)], axis=(0, 2)
        ),
    }


@dataclass(frozen=True)
class OutputErrors:
    """Of an estimate what MC lives on, and what (5.26) says of it; rms in the scanning phase, a value a plant."""

    noise: Float64[np.ndarray, " runs"]  # m, -v + d
    innovation: Float64[np.ndarray, " runs"]  # m, e_y = y - C x_hat
    deformation: Float64[np.ndarray, " runs"]  # m, y_flex: what the flexible modes add to the position
    deformation_error: Float64[np.ndarray, " runs"]  # m, y_flex less its estimate
    position_errors: Float64[np.ndarray, "runs modes"]  # of the modal positions, sqrt(kg) m
    by_pseudo_inverse: Float64[np.ndarray, "runs modes"]  # the same by (5.26)


def output_errors(scan: Scan, errors: ArrayLike, records: Records, estimates: ArrayLike) -> OutputErrors:
    r"""Errors of the predicted output, and :math:`C^\dagger(-v+d+C^\delta x)` of (5.26).

    `errors` (runs, modes, 4) are those of `uncertainty.perturbed` under which the scans were recorded. From
    :math:`e_y = (C+C^\delta)x - v + d - C\hat x\approx 0` follows :math:`C(\hat x - x) = -v + d + C^\delta x`.
    """
    errors = require_array("errors", errors, shape=(len(records.states), len(scan.nominal.frequencies), 4))
    estimates = require_array("estimates", estimates, shape=records.states.shape)
    window = scan.setpoint.scanning
    true, told = (each[:, ::2, window] for each in (records.states, estimates))  # positions
    model = scan.shapes[window].T
    shapes = model * (1 + errors[:, :, 3])[:, :, None]
    measured = records.y[:, 0, window]
    noise = measured - np.sum(shapes * true, axis=1)
    deformation = np.sum((shapes * true)[:, 1:], axis=1)
    seen = noise + np.sum((shapes - model) * true, axis=1)

    return OutputErrors(
        rms(noise),
        rms(measured - np.sum(model * told, axis=1)),
        rms(deformation),
        rms(deformation - np.sum((model * told)[:, 1:], axis=1)),
        rms(true - told),
        rms(model / np.sum(model**2, axis=0) * seen[:, None]),
    )


def sample_output_errors(
    contest: Contest, plants: int, seed: int, size: float, law: str, rigid: bool
) -> OutputErrors:
    """Output errors of the Kalman filter on randomly perturbed plants, see `uncertainty.sample_errors`."""
    rng, scan = np.random.default_rng(seed), contest.scan
    errors = np.array([sample_errors(rng, scan.nominal, size, law, rigid) for _ in range(plants)])
    records = record_scans(scan, list(errors), rng)
    return output_errors(scan, errors, records, run_entrant("Kalman", contest, 1.0, records))
