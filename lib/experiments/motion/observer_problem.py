"""The problem of the optimal observer, Fig. 5.2 of the observer thesis, as a generalised plant."""

from dataclasses import dataclass

import numpy as np

from stillwork.base.checks import InputError
from stillwork.control.applications import filtered_estimates
from stillwork.control.feedback import band_pass, damping_gain
from stillwork.control.ideal_feedforward import invert
from stillwork.control.pid import Pid
from stillwork.estimation.generalised_plant import GeneralisedPlant, low_pass
from stillwork.estimation.observer import Observer
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel, constant, interconnect


@dataclass(frozen=True)
class ObserverProblem:
    """Fig. 5.2: find the observer for given controller, damping gain and compensation.

    The estimate acts only through the compensation C_f and the damped modal velocities, so these few signals,
    not all states, are the control: y_flex first, then one velocity a flexible mode. The observer sees the
    plant input f and the measurement y + d. Exogenous: r, w, v, d; performance: e_true.
    """

    plant: ModalModel
    controller: Pid
    increase: float  # of the damping ratios
    selectivity: float  # Q of the band-passes
    scales: tuple[float, float, float]  # S_w (N), S_v, S_d (m), for a reference of unit intensity
    corners_hz: tuple[float, float, float] = (700.0, 200.0, 200.0)  # W_r, W_w, W_v

    def __post_init__(self):
        outputs, inputs = self.plant.feedthrough.shape
        if (inputs, outputs) != (1, 1) or np.any(self.plant.feedthrough):
            raise InputError("plant must have one input, one output and no feedthrough; pick them with at()")

    @property
    def flexible(self) -> int:
        """Number of flexible modes, as many as band-passes."""
        return len(self.plant.frequencies) - self.plant.rigid_modes

    def _damping(self) -> tuple[list[StateModel], np.ndarray]:
        """Band-pass and gain of every flexible mode's velocity."""
        rigid = self.plant.rigid_modes
        filters = [band_pass(float(w), self.selectivity) for w in self.plant.frequencies[rigid:]]
        return filters, damping_gain(self.plant, self.increase)[:, 2 * rigid + 1 :: 2]

    def generalised(self) -> GeneralisedPlant:
        """The generalised plant: 8 + 3 + 6 + 3 = 20 states for the stage."""
        plant, control, n = self.plant.state_space(), self.controller.state_space(), self.flexible
        filters, gain = self._damping()
        weights = [low_pass(corner) for corner in self.corners_hz]
        s_w, s_v, s_d = self.scales
        # Outputs: y0, u_fb, filtered velocities, W_r r, W_w w, W_v v. Inputs likewise. External: r, w, v, d,
        # then the controls y_flex and velocities.
        total = 2 + n + 3
        reference, force, sensor = range(2 + n, total)
        feedback, external = np.zeros((total, total)), np.zeros((total, 4 + 1 + n))
        feedback[0, 1], feedback[0, 2 : 2 + n], feedback[0, force] = 1, gain[0], s_w
        feedback[1, 0], feedback[1, reference], feedback[1, sensor] = -1, 1, s_v
        external[1, 3], external[1, 4] = -s_d, 1
        external[2 : 2 + n, 5:] = np.eye(n)
        external[reference:, :3] = np.eye(3)
        read, direct = np.zeros((3, total)), np.zeros((3, 4 + 1 + n))
        read[0, 0], read[0, reference], read[0, sensor] = -1, 1, s_v  # e_true = r - (y0 - v)
        read[1, 1], read[1, 2 : 2 + n] = 1, gain[0]  # f
        read[2, 0], read[2, sensor], direct[2, 3] = 1, -s_v, s_d  # y + d
        model = interconnect([plant, control, *filters, *weights], feedback, external, read, direct)
        return GeneralisedPlant(model, exogenous=4, performance=1)

    @property
    def bound(self) -> float:
        r"""What no linear controller's two-norm can fall below, whatever it measures.

        The error to the reference is (1 - T) W_r with T = P Q stable, so at every zero z of P in the right half plane
        it is W_r(z). The smallest two-norm of a stable function with given values at given points follows from the
        kernel 1 / (s + z*) of that space: the root of :math:`w^HK^{-1}w` with :math:`K_{ij}=1/(z_i+z_j^*)`.
        """
        zeros = invert(self.plant).zeros
        zeros = zeros[zeros.real > 1e-9 * np.abs(zeros).max()]
        reference = 2 * np.pi * self.corners_hz[0]
        values = reference / (zeros + reference)
        kernel = 1 / (zeros[:, None] + zeros.conj())
        return float(np.sqrt((values.conj() @ np.linalg.solve(kernel, values)).real))

    def read(self, observer: Observer) -> StateModel:
        """An observer of chapter 3 as the block that this problem asks for: (f, y + d) to (y_flex, velocities)."""
        if len(observer.model.frequencies) != len(self.plant.frequencies):
            raise InputError("observer has other modes than the problem's plant")
        velocities = observer.read(np.eye(self.flexible), "velocity")
        return observer.estimator(np.vstack([observer.flexible_outputs, velocities]))

    def idle(self) -> StateModel:
        """The block that does nothing: no observer."""
        return constant(np.zeros((1 + self.flexible, 2)))

    def compensator(self, observer: StateModel) -> StateModel:
        """The observer with band-passes and damping gain: (f, y + d) to (u_d, y_flex), as `loops` wants it."""
        return filtered_estimates(observer, *self._damping())


def problem_sizes(weight_states: int, axes: int, modes: int, flexible: int, sensors: int) -> dict[str, int]:
    """Size of Fig. 5.2's problem for a machine with so many controlled axes, modes, band-passes an axis and sensors.

    States are those of the plant, of a PID and of `flexible` band-passes, and of four weights, three of first order;
    inputs r, w, v, d and the estimates; outputs e, weighted e, f and y.
    """
    states = 2 * modes + 3 * axes + 2 * flexible + 3 * axes + weight_states * axes
    return {"states": states, "inputs": axes + 3 * sensors + 2 * modes, "outputs": 2 * axes + 2 * sensors}
