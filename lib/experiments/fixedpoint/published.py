"""The three controllers with the paper's numbers, and those that the fair comparison adds."""

from dataclasses import replace

from experiments.fixedpoint.noise import Noise
from stillwork.control.fixed_point import Controller
from stillwork.control.kinematics import KinematicDesign
from stillwork.control.transformation import FlowTransformation, RobustTransformation
from stillwork.estimation.coordinate_filters import (
    ExtendedKalman,
    LowPass,
    MovingWindow,
    SavitzkyGolay,
    UnscentedKalman,
)
from stillwork.estimation.plant import Plant

WINDOW, LOW_PASS, KALMAN = "moving window", "low pass", "Kalman filter"
LITERAL, EXTENDED, POLYNOMIAL = "Kalman, literal (14)", "EKF with disturbance", "Savitzky-Golay"
INTEGRATION = "semi-implicit"  # one Euler step a sample: assumed, the paper does not say how its plant moves
PUBLISHED_CASES = {
    "no noise": Noise(),
    "small Gaussian": Noise("gaussian", 1e-5),
    "small logistic": Noise("logistic", 1e-5),
    "large Gaussian": Noise("gaussian", 1e-4),
    "large logistic": Noise("logistic", 1e-4),
}


def published_controllers(model: Plant) -> dict[str, Controller]:
    """The controllers of Section II, by name: the paper's three, then the Kalman filter with (14) as printed.

    The paper does not say which transformation goes with the Kalman filter; (8) works, (6) diverges in noise.
    """
    kalman = Controller(UnscentedKalman(model), RobustTransformation(), KinematicDesign(36.0), model)
    return {
        WINDOW: Controller(MovingWindow(), FlowTransformation(), KinematicDesign(24.0), model),
        LOW_PASS: Controller(LowPass(from_zero=True), RobustTransformation(), KinematicDesign(16.0), model),
        KALMAN: kalman,
        LITERAL: replace(kalman, signal_filter=replace(kalman.signal_filter, literal=True)),
    }


def added_controllers(model: Plant) -> dict[str, Controller]:
    """Two filters that the paper leaves out, before any tuning."""
    return {
        EXTENDED: Controller(ExtendedKalman(model), RobustTransformation(), KinematicDesign(36.0), model),
        POLYNOMIAL: Controller(SavitzkyGolay(), RobustTransformation(), KinematicDesign(24.0), model),
    }
