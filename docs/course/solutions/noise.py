"""Solutions of the track on noise in an adaptive loop.

Each function answers the exercise of its number with the toolbox, compares the answer with something that shares no
code with it, and returns the check of the exercise. Its arguments are the numbers of the exercise: with others
it gives the answer to a new one.
"""

from dataclasses import replace

import control as ct
import numpy as np
from scipy import optimize

from experiments.fixedpoint import Noise, load_oscillator, published_controllers
from experiments.fixedpoint.published import LITERAL, WINDOW
from notebooks.fixedpoint.differentiation_noise import difference_quotient
from stillwork.control import FlowTransformation, KinematicDesign, asin_trajectory, simulate
from stillwork.control.fixed_point import response_gain
from stillwork.control.fixed_point_convergence import (
    describing_function,
    iterate,
    random_gain,
    strongest_oscillation,
)
from stillwork.control.transformation import contraction_range
from stillwork.estimation import LowPass, filter_signal
from stillwork.estimation.coordinate_filters import SavitzkyGolay
from stillwork.lti import h2_norm


def exercise_1(bandwidth: float = 350.0) -> str:
    """How late a third-order low pass is, from a ramp."""
    speed = 0.2  # m/s
    position = speed * 1e-4 * np.arange(20_000)
    found = filter_signal(LowPass(bandwidth), position, sample_time=1e-4)
    late = (position - found.position)[-1] / speed
    assert np.isclose(
        late, 3 / bandwidth, atol=1.01e-4
    )  # three lags of one over the bandwidth; a sample is lost
    assert np.isclose(found.velocity[-1], speed)
    return f"{1e3 * 3 / bandwidth:.1f}"


def exercise_2(deviation: float = 1e-5, rate: float = 2000.0) -> str:
    """What a difference quotient makes of noise, and what sampling twice as fast makes of it."""
    errors = Noise("gaussian", deviation).sample(np.random.default_rng(2), 400_000)
    slow, fast = (np.std(difference_quotient(errors, 1 / each)) for each in (rate / 2, rate))
    assert np.isclose(fast, np.sqrt(2) * deviation * rate, rtol=0.01)
    assert np.isclose(fast / slow, 2, rtol=0.01)
    return f"{1e3 * np.sqrt(2) * deviation * rate:.1f}"


def exercise_3(deviation: float = 1e-4, sample_time: float = 1e-3) -> str:
    """The two entries of the Kalman filter's measurement share an error, whatever its distribution."""
    found = []
    for kind in ("gaussian", "logistic"):
        errors = Noise(kind, deviation).sample(np.random.default_rng(3), 400_000)
        quotient = difference_quotient(errors, sample_time)[1:]
        found.append(np.corrcoef(quotient, errors[-len(quotient) :])[0, 1])
    assert np.allclose(found, 1 / np.sqrt(2), atol=0.01)
    return f"{np.mean(found):.2f}"


def exercise_4(samples: int = 12) -> str:
    """The velocity of a parabola through a window, against the difference quotient."""
    window = SavitzkyGolay(samples=samples, degree=2, sample_time=1e-3)
    errors = Noise("gaussian", 1e-5).sample(np.random.default_rng(4), 200_000)
    found = filter_signal(window, errors).velocity[100:]
    ratio = np.std(found) / (np.sqrt(2) * 1e-5 / 1e-3)

    # The same slope from the normal equations, read at its newest sample.
    design = np.vander(np.arange(1 - samples, 1), 3, increasing=True).astype(float)
    covariance = np.linalg.inv(design.T @ design)
    expected = np.sqrt(covariance[1, 1] / 2)
    assert np.isclose(ratio, expected, rtol=0.02)
    return f"{expected:.2f}"


def exercise_5(gain: float = -1.1, width: float = 3.0) -> str:
    """How wrong the approximate mass may be before Banach's condition fails."""
    transformation = FlowTransformation(gain, width)
    largest = optimize.brentq(lambda ratio: contraction_range(ratio)[0] - transformation.local_gain, 0.1, 100)

    for ratio, shrinks in ((0.98 * largest, True), (1.02 * largest, False)):
        errors = np.abs(iterate(transformation, 0.0, 600, response_gain=ratio, start=1e-6))
        assert (errors[-1] < errors[0]) == shrinks
    return f"{largest:.2f}"


def exercise_6(width: float = 3.0) -> str:
    """The gain that makes the static iteration arrive in one step, for the published oscillator."""
    exact, approximate = (model.plant for model in load_oscillator().values())
    ratio = response_gain(exact, approximate)
    gain = -width / ratio
    assert np.isclose(ratio, 2.0 / 1.5)  # the approximate over the exact mass
    errors = np.abs(iterate(FlowTransformation(gain, width), 0.0, 2, response_gain=ratio, start=1e-6))
    assert errors[1] < 1e-6 * errors[0]
    return f"{gain:.2f}"


def exercise_7(left: float = 0.5) -> str:
    """The amplitude at which the sigmoid has lost half of its gain, for a sine and in noise."""
    sine = optimize.brentq(lambda amplitude: describing_function(amplitude) - left, 0.1, 10)
    random = optimize.brentq(lambda deviation: random_gain(deviation) - left, 0.05, 10)

    angle = 2 * np.pi * (np.arange(200_000) + 0.5) / 200_000
    wave = sine * np.sin(angle)
    assert np.isclose(2 * np.mean(wave / (1 + np.abs(wave)) * np.sin(angle)) / sine, left, atol=1e-4)
    draws = random * np.random.default_rng(7).standard_normal(2_000_000)
    assert np.isclose(np.mean(1 / (1 + np.abs(draws)) ** 2), left, atol=2e-3)
    return f"{sine:.2f}"


def exercise_8(scale: float = 1e-5) -> str:
    """Logistic noise whose scale, not its standard deviation, is the printed number."""
    found = np.std(Noise("logistic-scale", scale).sample(np.random.default_rng(8), 400_000)) / scale
    assert np.isclose(found, np.pi / np.sqrt(3), rtol=0.01)
    return f"{np.pi / np.sqrt(3):.2f}"


def exercise_9(step: float = 2e-4) -> str:
    """An encoder's rounding as noise: its size, and where it stops being noise."""
    rng = np.random.default_rng(9)
    moving = asin_trajectory(duration=12.0, sample_time=1e-3).position
    errors = Noise("encoder", step).measure(moving, rng) - moving
    assert np.isclose(np.std(errors), step / np.sqrt(12), rtol=0.02)
    slow = 0.1 * step * np.arange(12_000) / 10  # a step each hundred samples
    errors = Noise("encoder", step).measure(slow, rng) - slow
    neighbours = np.corrcoef(errors[1:], errors[:-1])[0, 1]
    assert neighbours > 0.9
    return f"{1e6 * step / np.sqrt(12):.1f}"


def exercise_10(exponent: float = 24.0) -> str:
    """How far a kinematic block with an integral overshoots, whatever its exponent."""
    largest = []
    for each in (6.0, exponent):
        integral, error, derivative = KinematicDesign(each).gains
        a = np.array([[0.0, 1, 0], [0, 0, 1], [-integral, -error, -derivative]])
        sample_time = 1e-3 / each
        transition = np.linalg.matrix_power(np.eye(3) + sample_time * a / 64, 64)
        state, course = np.array([0.0, 1.0, 0.0]), []
        for _ in range(10_000):
            course.append(state[1])
            state = transition @ state
        largest.append(-min(course))
    assert np.allclose(largest, 5 * np.exp(-3), rtol=1e-3)  # e(t) = (1 + x - x^2) exp(-x), least at x = 3
    return f"{100 * 5 * np.exp(-3):.1f}"


def exercise_11(bandwidth: float = 350.0, factor: float = 2.0) -> str:
    """Half the bandwidth of the low pass, and how much less noise its acceleration has."""

    def noise(corner: float) -> float:
        return h2_norm(
            ct.tf([corner**3, 0.0, 0.0], np.poly(3 * [-corner]))
        )  # three lags, differentiated twice

    ratio = noise(bandwidth) / noise(bandwidth / factor)
    errors = 1e-5 * np.random.default_rng(11).standard_normal(400_000)
    found = [
        np.std(filter_signal(LowPass(each), errors, sample_time=1e-4).acceleration[2000:])
        for each in (bandwidth, bandwidth / factor)
    ]
    assert np.isclose(found[0] / found[1], ratio, rtol=0.1)  # Euler's rule at 10 kHz
    assert np.isclose(ratio, factor**2.5)
    return f"{ratio:.2f}"


def exercise_12(gains: tuple[float, ...] = (-0.7, -1.1, -1.8)) -> str:
    """The window's limit cycle with another gain: its amplitude moves, its frequency stays."""
    exact, approximate = (model.plant for model in load_oscillator().values())
    trajectory = asin_trajectory(duration=6.0, sample_time=1e-3)
    window = published_controllers(approximate)[WINDOW]
    seen = []
    for gain in gains:
        run = simulate(
            exact,
            replace(window, transformation=FlowTransformation(gain, 3.0)),
            trajectory,
            integration="semi-implicit",
        )
        tail = (run.acceleration_estimate - run.desired)[2000:]
        seen.append(strongest_oscillation(tail, 1e-3))
        spectrum = np.abs(np.fft.rfft(tail * np.hanning(len(tail))))
        peak = np.fft.rfftfreq(len(tail), 1e-3)[spectrum.argmax()]
        assert np.isclose(peak, seen[-1].frequency_hz, atol=0.3)
    assert np.ptp([each.frequency_hz for each in seen]) < 1
    assert seen[0].amplitude < seen[1].amplitude < seen[2].amplitude
    return f"{seen[len(gains) // 2].frequency_hz:.0f}"


def exercise_13(frequency: float = 0.2) -> str:
    """The printed (14) and its shift: the way that the plant travels in a sample."""
    exact, approximate = (model.plant for model in load_oscillator().values())
    trajectory = asin_trajectory(frequency_hz=frequency, duration=6.0, sample_time=1e-3)
    run = simulate(
        exact, published_controllers(approximate)[LITERAL], trajectory, integration="semi-implicit"
    )
    error = (run.position - trajectory.position)[1000:]
    way = trajectory.velocity[1000:] * 1e-3
    factor = float(error @ way / (way @ way))
    assert np.std(error - factor * way) < 0.1 * np.std(error)  # next to nothing else is left
    return f"{factor:.1f}"
