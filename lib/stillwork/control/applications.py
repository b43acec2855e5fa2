"""Uses of an observer in a loop: measurement compensation, active damping, or both (sections 3.2-3.4)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float64

from stillwork.base.bounds import Positive, one_of
from stillwork.base.checks import InputError, require_array, require_number
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.control.feedback import SELECTIONS, band_pass, damping_gain, per_flexible_mode, stiffness_gain
from stillwork.estimation.observer import Observer
from stillwork.lti.state_space import StateModel, block_matrix, interconnect


@by_value
@dataclass(frozen=True)
class Application:
    """Use of the estimate; by default none.

    Parameters
    ----------
    compensate : bool
        MC: subtract the estimated flexible part from the measurement.
    damping : float or tuple of float
        AD: desired increase of the damping ratios, one for all modes or one each.
    selection : str
        One of `SELECTIONS`: how the damping gains are chosen.
    stiffness : float
        Active stiffness: desired factor on the resonance frequencies.
    selectivity : float or tuple of float, optional
        Q of the band-pass on the damping gains, one for all modes or each; None: no filter.
    common : float, optional
        rad/s, centre of one band-pass for all gains; None: one per mode at its resonance.
    high_pass_hz : float, optional
        Corner of a high-pass on the compensation, instead of a noise model.

    Raises
    ------
    InputError
        When a damping ratio is not in [0, 1) or another number not positive.

    References
    ----------
    Verkerk, Improved accuracy of flexible systems by state estimation, thesis (2018), sections 3.2-3.4.

    Examples
    --------
    >>> control.Application(compensate=True, damping=0.05).selection
    'each mode'
    """

    compensate: bool = False  # MC: subtract the estimated flexible part from the measurement
    # AD: desired increase of the damping ratios, one for all modes or each
    damping: float | tuple[float, ...] = 0.0
    selection: Annotated[str, one_of(SELECTIONS)] = "each mode"  # of the damping gains
    stiffness: Positive = 1.0  # active stiffness: desired factor on the resonance frequencies
    # Q of the band-pass on the damping gains, one for all modes or each; None: no filter
    selectivity: float | tuple[float, ...] | None = None
    # rad/s, centre of one band-pass for all gains; None: one per mode at its resonance
    common: Positive | None = None
    high_pass_hz: Positive | None = (
        None  # corner of a high-pass on the compensation, instead of a noise model
    )

    def __post_init__(self):
        check_fields(self)
        for each in np.atleast_1d(self.damping):
            require_number("damping", each, at_least=0.0, below=1.0)
        for each in () if self.selectivity is None else np.atleast_1d(self.selectivity):
            require_number("selectivity", each, above=0.0)


@checked
def compensator(observer: Observer, application: Application) -> StateModel:
    """The block O(s) of (A.2): from plant input and measurement (u, y) to (u_d, y_flex).

    u_d is added to the plant input (and is part of u), y_flex is subtracted from the measurement.

    Parameters
    ----------
    observer : Observer
        See `stillwork.estimation.kalman_observer`.
    application : Application

    Returns
    -------
    StateModel
        Inputs (u, y), outputs (u_d, y_flex), in the observer's time.

    Raises
    ------
    InputError
        When there are no flexible modes, or the application does not fit them.

    References
    ----------
    Verkerk, Improved accuracy of flexible systems by state estimation, thesis (2018), (A.2).

    Examples
    --------
    >>> stage = lti.ModalModel([0.0, 600.0], [0.0, 0.01], [[0.3], [0.3]], [[0.3, -0.3]], [[0.0]])
    >>> observer = estimation.kalman_observer(stage, estimation.NoiseIntensities(1.0, 1e-12))
    >>> damped = control.compensator(observer, control.Application(damping=0.05))
    >>> control.closed_loop(stage, damped, control.PidFamily(11.0)(20.0).state_space()).is_stable
    True
    """
    model = observer.model
    rigid = model.rigid_modes
    inputs, outputs = len(model.input_shapes.T), len(model.output_shapes)
    flexible = len(model.frequencies) - rigid
    if not flexible:
        raise InputError("observer.model has no flexible modes; there is nothing to compensate or to damp")
    gain = np.zeros((inputs, 2 * len(model.frequencies)))
    if np.any(application.damping):
        gain = damping_gain(model, require_array("damping", application.damping), application.selection)
    static = (
        np.zeros_like(gain) if application.stiffness == 1.0 else stiffness_gain(model, application.stiffness)
    )
    velocities, filters = np.zeros((0, len(observer.a))), []
    if application.selectivity is None:
        static = static + gain
    else:
        if np.any(gain[:, ::2]):
            raise InputError(
                "selection: the band-pass is for gains on velocities; choose another than pole placement"
            )
        velocities = observer.read(np.eye(flexible), "velocity")
        centres = model.frequencies[rigid:] if application.common is None else [application.common] * flexible
        widths = per_flexible_mode(model, "selectivity", application.selectivity)
        filters = [band_pass(float(w), float(q)) for w, q in zip(centres, widths, strict=True)]
    compensation = application.compensate * observer.flexible_outputs
    estimator = observer.estimator(np.vstack([compensation, observer.feedback(static), velocities]))
    high_pass = [_high_pass(application.high_pass_hz)] * outputs if application.high_pass_hz else []
    gain = gain[:, 2 * rigid + 1 :: 2][:, : len(filters)]
    return filtered_estimates(estimator, filters, gain, direct=inputs, high_pass=high_pass)


def _high_pass(corner_hz: float) -> StateModel:
    w = 2 * np.pi * corner_hz
    return StateModel(np.array([[-w]]), np.array([[w]]), np.array([[-1.0]]), np.ones((1, 1)))


@checked
def filtered_estimates(
    estimator: StateModel,
    filters: Sequence[StateModel],
    gain: Float64[np.ndarray, "inputs filters"],
    *,
    direct: int = 0,
    high_pass: Sequence[StateModel] = (),
) -> StateModel:
    """From (u, y) to (u_d, y_flex), of an estimator of (y_flex, velocities): each velocity through its filter and gain.

    With `direct` inputs it gives forces, too, between both; y_flex passes the `high_pass` of each output.
    """
    inputs, count = gain.shape
    outputs = len(estimator.c) - direct - count
    external = np.eye(inputs + outputs + count + len(high_pass), inputs + outputs)
    found = (outputs, direct, count, count, len(high_pass))
    feedback = block_matrix(
        (inputs + outputs, count, len(high_pass)), found, (0, 0, 0, 0, 0), (0, 0, 1, 0, 0), (1, 0, 0, 0, 0)
    )
    whole = 0 if high_pass else 1
    take = block_matrix((inputs, outputs), found, (0, 1, 0, gain, 0), (whole, 0, 0, 0, 1 - whole))
    return interconnect([estimator, *filters, *high_pass], feedback, external, take)


@checked
def soft_sensor(observer: Observer, performance_shapes: Float64[np.ndarray, "places modes"]) -> StateModel:
    """Soft sensor (3.21) from (u, y) to the position at other places, for one rigid-body direction.

    The estimated deformation at the sensor is subtracted and that at the desired place added; the rigid-body
    part of the measurement passes unfiltered.
    """
    model = observer.model
    if model.rigid_modes != 1 or len(model.output_shapes) != 1:
        raise InputError("soft_sensor is for one rigid-body mode and one sensor; decouple the machine first")
    if performance_shapes.shape[1] != len(model.frequencies):
        raise InputError(
            f"performance_shapes has shape {performance_shapes.shape}; give a column for each of the observer's "
            f"{len(model.frequencies)} modes"
        )
    rigid = performance_shapes[:, :1] / model.output_shapes[:, :1]
    rows = observer.read(performance_shapes[:, 1:]) - rigid @ observer.flexible_outputs
    estimate = observer.estimator(rows)
    direct = np.hstack([np.zeros((len(rows), model.input_shapes.shape[1])), rigid])
    return StateModel(estimate.a, estimate.b, estimate.c, direct)
