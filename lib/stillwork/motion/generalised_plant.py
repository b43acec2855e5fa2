"""Generalised plants, (5.1)-(5.3) of the observer thesis, and the one of its optimal observer, Fig. 5.2."""

from dataclasses import dataclass

import numpy as np

from stillwork.checks import InputError, require_number
from stillwork.lti import ModalModel, StateModel, interconnect
from stillwork.motion.controller import Pid
from stillwork.motion.feedback import band_pass, damping_gain
from stillwork.motion.observer import Observer


@dataclass(frozen=True)
class GeneralisedPlant:
    """A model from (w, u) to (z, y): exogenous inputs and controls to performance and measurements, (5.1)."""

    model: StateModel
    exogenous: int  # number of w
    performance: int  # number of z

    def __post_init__(self):
        outputs, inputs = self.model.d.shape
        if not 0 < self.exogenous < inputs or not 0 < self.performance < outputs:
            raise InputError(
                f"a model with {inputs} inputs and {outputs} outputs cannot have {self.exogenous} exogenous "
                f"inputs and {self.performance} performance outputs; leave controls and measurements"
            )

    @property
    def blocks(self) -> tuple[np.ndarray, ...]:
        """A, B1, B2, C1, C2, D11, D12, D21, D22."""
        m, w, z = self.model, self.exogenous, self.performance
        return (
            m.a,
            m.b[:, :w],
            m.b[:, w:],
            m.c[:z],
            m.c[z:],
            m.d[:z, :w],
            m.d[:z, w:],
            m.d[z:, :w],
            m.d[z:, w:],
        )

    def close(self, observer: StateModel) -> StateModel:
        """The closed loop (5.3) from w to z, with the feedthrough D22 that (5.3) leaves out."""
        a, b1, b2, c1, c2, d11, d12, d21, d22 = self.blocks
        if observer.d.shape != (b2.shape[1], len(c2)):
            raise InputError(
                f"observer has shape {observer.d.shape}; give {b2.shape[1]} outputs and {len(c2)} inputs"
            )
        n, m = len(a), len(observer.a)
        turn = np.linalg.inv(np.eye(b2.shape[1]) - observer.d @ d22)
        # u = turn (C_o x_o + D_o (C2 x + D21 w)), y = C2 x + D21 w + D22 u
        u_x, u_o, u_w = turn @ observer.d @ c2, turn @ observer.c, turn @ observer.d @ d21
        whole = np.block(
            [
                [a + b2 @ u_x, b2 @ u_o],
                [observer.b @ (c2 + d22 @ u_x), observer.a + observer.b @ d22 @ u_o],
            ]
        )
        b = np.vstack([b1 + b2 @ u_w, observer.b @ (d21 + d22 @ u_w)])
        c = np.hstack([c1 + d12 @ u_x, d12 @ u_o])
        assert whole.shape == (n + m, n + m)
        return StateModel(whole, b, c, d11 + d12 @ u_w)


def low_pass(corner_hz: float) -> StateModel:
    """First-order low-pass of unit gain."""
    w = 2 * np.pi * require_number("corner_hz", corner_hz, above=0.0)
    return StateModel(np.array([[-w]]), np.array([[w]]), np.array([[1.0]]), np.zeros((1, 1)))


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

    def generalised(self) -> GeneralisedPlant:
        """The generalised plant: 8 + 3 + 6 + 3 = 20 states for the stage."""
        plant, control, n = self.plant.state_space(), self.controller.state_space(), self.flexible
        rigid = self.plant.rigid_modes
        gain = damping_gain(self.plant, self.increase)[0, 2 * rigid + 1 :: 2]
        filters = [band_pass(float(w), self.selectivity) for w in self.plant.frequencies[rigid:]]
        weights = [low_pass(corner) for corner in self.corners_hz]
        s_w, s_v, s_d = self.scales
        # Outputs: y0, u_fb, filtered velocities, W_r r, W_w w, W_v v. Inputs likewise. External: r, w, v, d,
        # then the controls y_flex and velocities.
        total = 2 + n + 3
        reference, force, sensor = range(2 + n, total)
        feedback, external = np.zeros((total, total)), np.zeros((total, 4 + 1 + n))
        feedback[0, 1], feedback[0, 2 : 2 + n], feedback[0, force] = 1, gain, s_w
        feedback[1, 0], feedback[1, reference], feedback[1, sensor] = -1, 1, s_v
        external[1, 3], external[1, 4] = -s_d, 1
        external[2 : 2 + n, 5:] = np.eye(n)
        external[reference:, :3] = np.eye(3)
        read, direct = np.zeros((3, total)), np.zeros((3, 4 + 1 + n))
        read[0, 0], read[0, reference], read[0, sensor] = -1, 1, s_v  # e_true = r - (y0 - v)
        read[1, 1], read[1, 2 : 2 + n] = 1, gain  # f
        read[2, 0], read[2, sensor], direct[2, 3] = 1, -s_v, s_d  # y + d
        model = interconnect([plant, control, *filters, *weights], feedback, external, read, direct)
        return GeneralisedPlant(model, exogenous=4, performance=1)

    def read(self, observer: Observer) -> StateModel:
        """An observer of chapter 3 as the block that this problem asks for: (f, y + d) to (y_flex, velocities)."""
        if len(observer.model.frequencies) != len(self.plant.frequencies):
            raise InputError("observer has other modes than the problem's plant")
        velocities = observer.read(np.eye(self.flexible), "velocity")
        return observer.estimator(np.vstack([observer.flexible_outputs, velocities]))

    def idle(self) -> StateModel:
        """The block that does nothing: no observer."""
        n = 1 + self.flexible
        return StateModel(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((n, 0)), np.zeros((n, 2)))

    def compensator(self, observer: StateModel) -> StateModel:
        """The observer with band-passes and damping gain: (f, y + d) to (u_d, y_flex), as `loops` wants it."""
        n, rigid = self.flexible, self.plant.rigid_modes
        gain = damping_gain(self.plant, self.increase)[0, 2 * rigid + 1 :: 2]
        filters = [band_pass(float(w), self.selectivity) for w in self.plant.frequencies[rigid:]]
        feedback = np.zeros((2 + n, 1 + 2 * n))
        feedback[2:, 1 : 1 + n] = np.eye(n)
        read = np.zeros((2, 1 + 2 * n))
        read[0, 1 + n :], read[1, 0] = gain, 1
        return interconnect([observer, *filters], feedback, np.eye(2 + n, 2), read)
