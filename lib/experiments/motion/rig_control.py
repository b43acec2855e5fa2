"""Discrete control of the rig: PID, observer in predictor form, measurement compensation and active damping."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Complex128, Float64

from stillwork.base.checks import InputError, require_number
from stillwork.control.applications import filtered_estimates
from stillwork.control.discrete_observer import DiscreteObserver, discrete_kalman_observer
from stillwork.control.feedback import band_pass, damping_gain
from stillwork.estimation.observer import NoiseIntensities
from stillwork.lti.discretisation import tustin
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel


def rig_observer(
    model: ModalModel, noise: NoiseIntensities, sample_time: float, noise_model: float | None = None
) -> DiscreteObserver:
    """Stationary Kalman observer of chapter 6, from covariances a sample as (6.2) prints them (N^2, m^2, N^2)."""
    if noise_model is not None:
        noise_model = noise_model / sample_time
    intensities = NoiseIntensities(noise.process * sample_time, noise.sensor * sample_time)
    return discrete_kalman_observer(model, intensities, sample_time, noise_model)


@dataclass(frozen=True)
class RigCompensator:
    """What the observer does: y_flex = C_f x_hat for MC, u_d = sum of K_i H_i(z) velocity_i for AD."""

    observer: DiscreteObserver
    compensate: bool
    gains: Float64[np.ndarray, "inputs flexible"]  # K_i on the modal velocities, zero without damping
    selectivity: float | None  # Q of the band-passes; None: none

    @property
    def _centres(self) -> Float64[np.ndarray, " flexible"]:
        return self.observer.model.frequencies[self.observer.model.rigid_modes :]

    def _read(self) -> Float64[np.ndarray, "signals states"]:
        velocities = self.observer.read(np.eye(self.gains.shape[1]), "velocity")
        return np.vstack([self.compensate * self.observer.flexible_outputs, velocities])

    @cached_property
    def _estimator(self) -> StateModel:
        return self.observer.estimator(self._read(), "predictor", 1)

    def frequency_response(
        self, omega: Float64[np.ndarray, " frequencies"]
    ) -> Complex128[np.ndarray, "signals signals frequencies"]:
        """Response from (f, y) to (u_d, y_flex); the filters are multiplied in, not realised."""
        outputs = len(self.observer.c)
        estimates = self._estimator.frequency_response(omega)
        flexible, velocities = estimates[:outputs], estimates[outputs:]
        if self.selectivity is not None:
            half = self.observer.sample_time / 2
            # s over the centre, both warped
            ratio = 1j * np.tan(omega * half) / np.tan(self._centres[:, None] * half)
            passed = ratio / self.selectivity / (ratio**2 + ratio / self.selectivity + 1)
            velocities = velocities * passed[:, None, :]
        return np.concatenate([np.einsum("if,fjw->ijw", self.gains, velocities), flexible])

    @cached_property  # one compensator closes the loop with every controller
    def realised(self) -> StateModel:
        """The same block with its states, for closed loops; without damping the filters are left out."""
        if not np.any(self.gains) or self.selectivity is None:
            damping, outputs = self.observer.read(self.gains, "velocity"), len(self.observer.c)
            return self.observer.estimator(np.vstack([damping, self._read()[:outputs]]), "predictor", 1)
        filters = [
            tustin(band_pass(w, self.selectivity), self.observer.sample_time, w)
            for w in self._centres.tolist()
        ]
        return filtered_estimates(self._estimator, filters, self.gains)


def rig_compensator(
    observer: DiscreteObserver,
    compensate: bool = False,
    target_damping: float | None = None,
    selectivity: float | None = 2.0,
) -> RigCompensator:
    """Compensator for MC, AD or both: one damping ratio for all modes, (4.17) with the factor 2 omega that it lacks.

    `selectivity` is the Q of one band-pass per mode, (4.16); None: no filter.
    """
    model = observer.model
    rigid = model.rigid_modes
    gains = np.zeros((model.input_shapes.shape[1], len(model.frequencies) - rigid))
    if target_damping is not None:
        increase = require_number("target_damping", target_damping, below=1.0) - model.damping[rigid:]
        if np.any(increase < 0):
            raise InputError(f"target_damping is {target_damping:g}, below that of a mode; raise it")
        gains = damping_gain(model, increase)[:, 2 * rigid + 1 :: 2]
    return RigCompensator(observer, compensate, gains, selectivity)
