"""Running a filter over a whole record."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.checks import InputError, require_array, require_finite_run
from stillwork.base.kernels import borrowing_kernel
from stillwork.base.validation import by_value, checked
from stillwork.estimation.coordinate_filters import (
    ExtendedKalman,
    Filter,
    UnscentedKalman,
    require_sample_time,
)
from stillwork.estimation.filter_step import filter_step
from stillwork.estimation.plant import Plant


@by_value
@dataclass(frozen=True)
class Estimate:
    """Result of a filter on a record; each array of shape (samples,)."""

    position: Float64[np.ndarray, " samples"]  # m
    velocity: Float64[np.ndarray, " samples"]  # m/s
    acceleration: Float64[np.ndarray, " samples"]  # m/s^2


@checked
def filter_signal(
    signal_filter: Filter,
    measured: ArrayLike,
    force: ArrayLike | None = None,
    *,
    sample_time: float = 1e-3,
    start_velocity: float = 0.0,
) -> Estimate:
    """Run a filter over a record.

    Parameters
    ----------
    signal_filter : Filter
        One of `stillwork.estimation.coordinate_filters`.
    measured : array_like, shape (samples,)
        Noisy coordinate, m. Kalman filters accept NaN after the first sample (a missing measurement) and predict there.
    force : array_like, shape (samples,), optional
        Force that acts from each sample to the next, N; used by the Kalman filters; zero by default.
    sample_time : float
        s.
    start_velocity : float
        Velocity that the filter assumes before the first sample, m/s.

    Returns
    -------
    Estimate
        Position, velocity and acceleration at each sample, from the measurements up to it.

    Raises
    ------
    InputError
        When the filter cannot run at this sample time, or a covariance loses its definiteness on the way;
        the message names the sample.

    Examples
    --------
    >>> position = 0.01 * np.arange(1000) / 1000  # m, at 10 mm/s
    >>> estimate = estimation.filter_signal(estimation.LowPass(bandwidth=350.0), position)
    >>> float(estimate.velocity[-1].round(6))
    0.01
    """
    require_sample_time(signal_filter, sample_time)
    predicts = isinstance(signal_filter, UnscentedKalman | ExtendedKalman)
    measured = require_array("measured", measured, ndim=1, missing=predicts)
    if len(measured) and np.isnan(measured[0]):
        raise InputError("measured is NaN at the first sample; start with one that was measured")
    force = np.zeros_like(measured) if force is None else require_array("force", force, shape=measured.shape)
    estimates = np.empty((len(measured), 3))
    given = *model_of(signal_filter), measured, force, float(sample_time)
    done = filter_record(signal_filter.packed(), *given, np.array([0.0, start_velocity, 0.0]), estimates)
    if done < len(measured):
        raise InputError(
            f"the filter's covariance stops being positive definite at sample {done}; "
            "raise process or noise, or check that the model fits the record"
        )
    require_finite_run(
        "the estimate", estimates, "check the size of the record, the model and the filter's noises"
    )
    return Estimate(*np.ascontiguousarray(estimates.T))


@checked
def model_of(signal_filter: Filter):
    """Compiled acceleration and parameters of a filter's model; a stand-in where it has none."""
    acceleration, _, parameters = getattr(signal_filter, "plant", UNIT_MASS).compiled
    return acceleration, parameters


def _unit_mass_acceleration(position, velocity, force, parameters):
    """A free unit mass."""
    return force


def _unit_mass_force(position, velocity, acceleration, parameters):
    """A free unit mass, inverted."""
    return acceleration


UNIT_MASS = Plant(_unit_mass_acceleration, _unit_mass_force, np.zeros(0))


@borrowing_kernel
def filter_record(device, acceleration, plant, measured, force, sample_time, estimate, estimates):
    """Filter a record; returns the number of samples done."""
    last_force = 0.0
    for i in range(len(measured)):
        if not filter_step(device, acceleration, plant, sample_time, measured[i], last_force, estimate):
            return i
        last_force = force[i]
        for j in range(3):
            estimates[i, j] = estimate[j]
    return len(measured)
