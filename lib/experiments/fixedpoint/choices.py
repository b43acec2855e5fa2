"""The motion of the fixed-point paper and the size of its noise, as it leaves them open."""

from stillwork.control.trajectory import Trajectory, asin_trajectory, trapezoid_trajectory

Values = dict[str, float | tuple[float, tuple[float, float]]]

SAMPLE_TIME = 1e-3  # s, section III
PRINTED_NOISE = {"small": 1e-5, "large": 1e-4}  # m, sections III.B and III.C
SHAPES = {"asin 0.9": 0.9, "asin 0.98": 0.98, "asin 0.999": 0.999}
ROUNDINGS = {"trapezoid 1/2": 0.5, "trapezoid 1/5": 0.2}


def trajectory(shape: str, frequency_hz: float, amplitude: float) -> Trajectory:
    """A nominal motion of 12 s with corners; `amplitude` in m."""
    timing = {"frequency_hz": frequency_hz, "sample_time": SAMPLE_TIME}
    if shape in SHAPES:
        return asin_trajectory(amplitude, SHAPES[shape], **timing)
    return trapezoid_trajectory(amplitude, ROUNDINGS[shape], **timing)
