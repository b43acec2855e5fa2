"""The observer in discrete time: filter and predictor form, and their treatment of delays (section 4.1)."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy import linalg

from stillwork.base.bounds import Positive, one_of
from stillwork.base.checks import Converted, InputError, require_array, require_count
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.control.applications import Application, filtered_estimates
from stillwork.control.discrete_damping import discrete_damping_gain
from stillwork.control.feedback import band_pass, damping_gain
from stillwork.estimation.observer import FlexibleEstimates, NoiseIntensities, augment_random_walk
from stillwork.estimation.riccati import discrete_gain
from stillwork.lti.delays import delayed
from stillwork.lti.discretisation import late_modes, zoh, zoh_modes
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel

FORMS = ("filter", "predictor")


@by_value
@dataclass(frozen=True)
class DiscreteObserver(FlexibleEstimates):
    r"""Observer of a sampled reduced modal model, the force of the last period among its states.

    A measurement is taken before the force of its sample acts, so the compliance acts on the last force:
    :math:`y_k = Cx_k + Du_{k-1}`. (4.8) prints :math:`u_k`, which is not yet available to a filter.
    """

    model: ModalModel
    a: Float64[np.ndarray, "states states"]
    b: Float64[np.ndarray, "states inputs"]
    c: Float64[np.ndarray, "outputs states"]
    gain: ArrayLike  # (states, outputs), of the filter, K; the predictor's is L = AK
    covariance: Float64[np.ndarray, "states states"]  # P(k|k-1)
    sample_time: Positive  # s
    before: Converted = 0.0  # (states, inputs), of the force of the sample before, which a late one follows

    @checked
    def __post_init__(self):
        check_fields(self)
        gain = require_array("gain", self.gain, shape=(len(self.a), len(self.c)))
        object.__setattr__(self, "gain", gain)
        before = np.broadcast_to(require_array("before", self.before), self.b.shape).copy()
        object.__setattr__(self, "before", before)
        require_array("covariance", self.covariance, shape=self.a.shape)
        if np.any(np.abs(linalg.eigvals(self.a - self.a @ self.gain @ self.c)) >= 1):
            raise InputError("the observer is unstable; its gain must stabilise A - AKC")

    @property
    def updated_covariance(self) -> Float64[np.ndarray, "states states"]:
        """P(k|k), after the measurement."""
        rest = self.covariance - self.gain @ self.c @ self.covariance
        return (rest + rest.T) / 2

    @checked
    def estimator(
        self, rows: ArrayLike, form: Annotated[str, one_of(FORMS)] = "filter", delay: int = 0
    ) -> StateModel:
        """Model from (u, y) to ``rows @ x_hat`` as it arrives, `delay` samples after the measurement it uses.

        ``filter``: at sample k there is x(k-d|k-d), which is old. ``predictor``: there is x(k-d+1|k-d), for d = 1 the
        state of this very sample; it has a delay of one at least, the sample that it looks ahead.

        Parameters
        ----------
        rows : array_like, shape (signals, states)
            Weights of the estimated states, e.g. of `read`.
        form : str
            ``filter`` or ``predictor``.
        delay : int
            d, samples.

        Raises
        ------
        InputError
            When the rows do not fit the states, or the form has no such delay.
        """
        rows = require_array("rows", rows, shape=(None, len(self.a)))
        delay = require_count("delay", delay, at_least=int(form == "predictor"))
        inputs, outputs = self.b.shape[1], len(self.c)
        d = self.model.feedthrough
        kept = np.eye(len(self.a)) - self.gain @ self.c
        old = self.before - self.a @ self.gain @ d
        a = np.block([[self.a @ kept, old], [np.zeros((inputs, len(self.a) + inputs))]])
        b = np.block([[self.b, self.a @ self.gain], [np.eye(inputs), np.zeros((inputs, outputs))]])
        read, now = rows @ kept, rows @ self.gain  # of the filter, which sees the measurement of this sample
        if form == "predictor":
            read, now, delay = rows, np.zeros((len(rows), outputs)), delay - 1
        c, direct = np.hstack([read, -now @ d]), np.hstack([np.zeros((len(rows), inputs)), now])
        return delayed(StateModel(a, b, c, direct, self.sample_time), delay)


@checked
def discrete_kalman_observer(
    model: ModalModel,
    noise: NoiseIntensities,
    sample_time: float,
    noise_model: Positive | None = None,
    late: float = 0.0,
) -> DiscreteObserver:
    r"""Stationary discrete Kalman observer, (4.7) and section 4.1.3, with the process noise at the plant input.

    The model is reduced, its feedthrough the compliance T_DC. The noises, Q_nu (N^2/s) of the random walk at the
    plant input among them, are intensities of the continuous design: they become variances by the factor 1/Ts, which
    changes no gain. The force, not the disturbance, may begin `late` by a part of a sample.
    """
    if model.measures != "position":
        raise InputError("model measures velocities; this observer is for positions")
    sampled, (late_model, before) = zoh_modes(model, sample_time), late_modes(model, sample_time, late)
    a, b, c = sampled.a, sampled.b, sampled.c
    inputs = b.shape[1]
    g, q = b, noise.process / sample_time * np.eye(inputs)
    if noise_model is not None:
        a, b, g, c = augment_random_walk(a, b, c, np.eye(inputs))
        q = linalg.block_diag(q, noise_model * sample_time * np.eye(inputs))
    solved = discrete_gain(a, g, c, q, noise.sensor / sample_time)
    b, before = (np.vstack([each, np.zeros((len(a) - len(each), inputs))]) for each in (late_model.b, before))
    return DiscreteObserver(model, a, b, c, solved.filter_gain, solved.covariance, sample_time, before)


@checked
def discrete_compensator(
    observer: DiscreteObserver, application: Application, form: str = "predictor", delay: int = 1
) -> StateModel:
    """The block from (u, y) to (u_d, y_flex) in discrete time; `form` and `delay` are those of an `estimator`.

    The selection ``pole placement`` takes the discrete gain (4.3), the others the continuous gain as it is; each
    band-pass is sampled with a zero-order hold.
    """
    if application.stiffness != 1.0 or application.high_pass_hz or application.common:
        raise InputError("application: in discrete time there are only MC and AD with one band-pass per mode")
    model = observer.model
    rigid, inputs = model.rigid_modes, observer.b.shape[1]
    flexible = len(model.frequencies) - rigid
    if not flexible:
        raise InputError("observer.model has no flexible modes; there is nothing to compensate or to damp")
    gain = np.zeros((inputs, 2 * len(model.frequencies)))
    if application.damping and application.selection == "pole placement":
        gain = discrete_damping_gain(model, application.damping, observer.sample_time)
    elif application.damping:
        gain = damping_gain(model, application.damping, application.selection)
    compensation = application.compensate * observer.flexible_outputs
    if application.selectivity is None:
        return observer.estimator(np.vstack([observer.feedback(gain), compensation]), form, delay)
    if np.any(gain[:, ::2]):
        raise InputError("selection: the band-pass is for gains on velocities; choose another one")
    velocities = observer.read(np.eye(flexible), "velocity")
    estimator = observer.estimator(np.vstack([compensation, velocities]), form, delay)
    filters = [
        zoh(band_pass(float(w), application.selectivity), observer.sample_time)
        for w in model.frequencies[rigid:]
    ]
    return filtered_estimates(estimator, filters, gain[:, 2 * rigid + 1 :: 2])
