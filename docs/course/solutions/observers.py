"""Solutions of the track on observers for motion.

Each function answers the exercise of its number with the toolbox, holds the answer against something that shares no
code with it, and returns what the exercise prints as its check.
"""

from dataclasses import replace

import numpy as np
from scipy import linalg, optimize, signal

from stillwork.control import (
    Application,
    PeakConstraint,
    PidFamily,
    closed_loop,
    compensator,
    damping_gain,
    decouple,
    error_loop,
    fit_feedforward,
    make_loop,
    maximise_bandwidth,
    point_to_point,
    tracking_error,
)
from stillwork.estimation import NoiseIntensities, kalman_observer
from stillwork.identification import Identified, fit_modes
from stillwork.lti import ModalModel, h2_norm, modal_model, truncate, tustin
from stillwork.signals import moving


def exercise_1() -> str:
    """The moving average of a vibration at half the frequency that the slit filters out."""
    sample_time, exposure = 1e-5, 5e-3
    error = 10 * np.sin(2 * np.pi * 100 * sample_time * np.arange(20_000))  # nm
    largest = np.abs(moving(error, sample_time, exposure).average).max()

    assert np.isclose(largest, 10 * 2 / np.pi, rtol=1e-3)  # the mean of half a period
    silent = moving(10 * np.sin(2 * np.pi * 200 * sample_time * np.arange(20_000)), sample_time, exposure)
    assert np.abs(silent.average).max() < 1e-9 and np.isclose(silent.deviation.max(), 10 / np.sqrt(2))
    return f"{largest:.2f}"


def exercise_2() -> str:
    """What a truncated mode takes with it: the anti-resonance moves, and the compliance puts it back."""
    full = ModalModel([0, 100.0, 150.0], [0, 0, 0], [[0.3], [0.3], [0.3]], [[0.3, 0.3, 0.3]], [[0.0]])

    def first_zero(model: ModalModel) -> float:
        return float(np.sort(np.abs(model.state_space().zeros))[0])

    found = [first_zero(model) for model in (full, truncate(full, 2), truncate(full, 2, 1))]

    def roots(compliance: float, kept: list[float]) -> float:
        """Of sum 1 / (w_i^2 - s) + compliance = 0 in s = w^2."""
        poles = [0.0, *(omega**2 for omega in kept)]
        total = compliance * np.poly(poles) * (-1) ** len(poles)
        for pole in poles:
            others = [each for each in poles if each != pole]
            total = np.polyadd(total, np.poly(others) * (-1) ** len(others))
        return float(np.sqrt(np.sort(np.roots(total).real[np.roots(total).real > 1])[0]))

    expected = [roots(0, [100.0, 150.0]), roots(0, [100.0]), roots(1 / 150**2, [100.0])]
    assert np.allclose(found, expected)
    return f"{100 * (found[1] / found[0] - 1):.1f}"


def exercise_3() -> str:
    """A sensor beside the actuator sees the resonances of the machine that is held there."""
    spring = np.array([[1.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
    beside = modal_model(np.eye(3), spring, [[1], [0], [0]], [[1, 0, 0]])
    zeros = np.sort(np.abs(beside.state_space().zeros))
    held = np.sqrt(linalg.eigvalsh(spring[1:, 1:]))
    assert np.allclose(zeros[::2], held)
    far = modal_model(np.eye(3), spring, [[1], [0], [0]], [[0, 0, 1]])
    assert far.state_space().zeros.size == 0  # from one end to the other: none at all
    return f"{zeros[0]:.3f}"


def exercise_4() -> str:
    """Tustin's rule moves a resonance down."""
    mode = ModalModel([2 * np.pi * 800], [0.0], [[1.0]], [[1.0]], [[0.0]])
    poles = tustin(mode.state_space(), 1 / 5000).poles
    found = np.abs(np.angle(poles[0])) * 5000 / (2 * np.pi)
    assert np.isclose(found, 5000 / np.pi * np.arctan(np.pi * 800 / 5000))
    kept = tustin(mode.state_space(), 1 / 5000, omega=2 * np.pi * 800).poles
    assert np.isclose(np.abs(np.angle(kept[0])) * 5000 / (2 * np.pi), 800)
    return f"{found:.1f}"


def exercise_5() -> str:
    """A fit finds a damping that the resolution of its data hides."""
    true = ModalModel([0.0, 2 * np.pi * 100.3], [0.0, 0.001], [[0.3], [0.3]], [[0.3, -0.3]], [[0.0]])
    omega = 2 * np.pi * np.arange(20.0, 200.0)  # each hertz; the peak is 0.2 Hz wide at half its power
    accelerance = -(omega**2) * true.frequency_response(omega)[0, 0]
    fit = fit_modes(Identified(omega, accelerance, np.ones(180)), [100.0], band_hz=(20.0, 199.0))
    assert np.isclose(fit.model.damping[1], 0.001, rtol=1e-3)

    # The half-power width, read off the data at hand and off a dense grid.
    dense = 2 * np.pi * np.linspace(99, 102, 300_001)
    power = np.abs(true.modes([1]).frequency_response(dense)[0, 0]) ** 2
    width = np.ptp(dense[power > power.max() / 2]) / (2 * np.pi)
    assert np.isclose(width, 2 * 0.001 * 100.3, rtol=1e-3)
    coarse = np.abs(true.modes([1]).frequency_response(omega)[0, 0]) ** 2
    assert coarse.max() < power.max() / 2  # no line is inside
    return f"{width:.2f}"


def exercise_6() -> str:
    """Bandwidth of a PID controller against the damping of a mode: the cube root, where the mode limits at all."""
    found = {}
    for sign in (1, -1):
        for damping in (0.005, 0.01):
            machine = ModalModel([0.0, 600.0], [0.0, damping], [[0.3], [0.3]], [[0.3, 0.3 * sign]], [[0.0]])
            limit = [PeakConstraint("input_sensitivity")]
            best = maximise_bandwidth([make_loop(machine)], PidFamily(1 / 0.09), limit, 2.0, 60.0)
            found[sign, damping] = best.design_hz
            # At the limit the peak of 1 / (1 + L) is 6 dB, with the mode written out, on a grid of its own.
            s = 1j * np.linspace(50, 1000, 1_000_001)
            plant = 0.09 / s**2 + 0.09 * sign / (s**2 + 2 * damping * 600 * s + 600**2)
            line = plant * best.controller.frequency_response(s.imag)
            assert np.isclose(np.abs(1 / (1 + line)).max(), 10 ** (6 / 20), rtol=1e-3)
    ratio = found[1, 0.01] / found[1, 0.005]
    assert np.isclose(ratio, 2 ** (1 / 3), rtol=0.01)
    assert abs(found[-1, 0.01] / found[-1, 0.005] - 1) < 0.01
    return f"{ratio:.2f}"


def exercise_7() -> str:
    """Kalman's observer of a free mass is a Butterworth filter of second order."""
    mass = ModalModel([0.0], [0.0], [[1.0]], [[1.0]], [[0.0]])
    ratio = (2 * np.pi * 100) ** 4  # process over sensor noise
    observer = kalman_observer(mass, NoiseIntensities(1.0, 1 / ratio))
    poles = np.linalg.eigvals(observer.a - observer.gain @ observer.c)

    expected = 2 * np.pi * 100 * np.exp(1j * np.pi * np.array([3, -3]) / 4)
    assert np.allclose(np.sort_complex(poles), np.sort_complex(expected))
    return f"{-poles[0].real / np.abs(poles[0]):.3f}"


def exercise_8() -> str:
    """What the observer subtracts for a steady force: more than the compliance, where it trusts the sensor."""
    stage = ModalModel([0.0, 600.0], [0.0, 0.01], [[0.3], [0.3]], [[0.3, -0.3]], [[0.0]])
    found = {}
    for sensor in (1e-12, 1e-2):
        observer = kalman_observer(stage, NoiseIntensities(1.0, sensor))
        block = compensator(observer, Application(compensate=True))
        found[sensor] = block.frequency_response([1e-6])[1, 0].real.item()
        # At rest 0 = (A - L C) x + B u, while the sensor says nothing.
        rest = -np.linalg.solve(observer.a - observer.gain @ observer.c, observer.b)
        assert np.isclose(found[sensor], (observer.c[:, 2:] @ rest[2:]).item(), rtol=1e-4)
    assert np.isclose(found[1e-2], -0.3 * 0.3 / 600**2, rtol=0.02)
    return f"{1e9 * found[1e-12]:.0f}"


def exercise_9() -> str:
    """How well a frequency must be known for a prediction to take 20 dB off its resonance."""
    damping = 0.005

    def left(error: float) -> float:
        """Largest of what remains over the largest of what was."""
        grid = np.linspace(0.98, 1.02, 80_001)
        machine, model = (
            ModalModel([scale], [damping], [[1.0]], [[1.0]], [[0.0]]).frequency_response(grid)[0, 0]
            for scale in (1.0, 1.0 + error)
        )
        return float(np.abs(machine - model).max() / np.abs(machine).max())

    error = optimize.brentq(lambda error: left(error) - 0.1, 1e-6, 1e-2)
    assert np.isclose(error, 0.1 * damping, rtol=0.1)  # to first order: error over damping
    assert left(0.01) > 0.9  # one per cent is as good as no model
    return f"{100 * error:.2f}"


def exercise_10() -> str:
    """Damping chosen mode by mode, for two modes that the one actuator cannot move apart."""
    model = ModalModel([100.0, 103.0], [0.005, 0.005], [[1.0], [1.0]], [[1.0, 1.0]], [[0.0]])
    gain = damping_gain(model, 0.1)
    state = model.state_space()
    poles = np.linalg.eigvals(state.a + state.b @ gain)
    least = float(np.min(-poles.real / np.abs(poles)))

    # The characteristic polynomial: D1 D2 + 2 zeta w s (D1 + D2), with D = s^2 + 2 zeta0 w s + w^2.
    one, two = ([1, 2 * 0.005 * w, w**2] for w in (100.0, 103.0))
    poly = np.polymul(one, two)
    for omega, other in ((100.0, two), (103.0, one)):
        poly = np.polyadd(poly, np.polymul([2 * 0.1 * omega, 0], other))
    roots = np.roots(poly)
    assert np.isclose(np.min(-roots.real / np.abs(roots)), least)
    placed = damping_gain(model, 0.1, "pole placement")
    poles = np.linalg.eigvals(state.a + state.b @ placed)
    assert np.allclose(-poles.real / np.abs(poles), 0.105)
    return f"{least:.4f}"


def exercise_11() -> str:
    """Three actuators for one translation and one rotation: the least forces that do it."""
    places = np.array([-0.5, 0.0, 1.0])
    shapes = np.stack([np.ones(3), places])
    beam = ModalModel([0.0, 0.0], [0.0, 0.0], shapes, np.eye(2), np.zeros((2, 3)))
    forces = decouple(beam, sensed=[0, 1]).actuation[:, 0]
    found = optimize.minimize(
        lambda f: f @ f,
        np.ones(3),
        constraints=[{"type": "eq", "fun": lambda f: shapes @ f - [1, 0]}],
        tol=1e-12,
    )
    assert np.allclose(found.x, forces, atol=1e-6)
    return f"{forces[2]:.3f}"


def exercise_12() -> str:
    """White noise through a mode: the variance falls with damping, and with the third power of the frequency."""
    one = h2_norm(ModalModel([100.0], [0.01], [[1.0]], [[1.0]], [[0.0]]).state_space())
    two = h2_norm(ModalModel([200.0], [0.01], [[1.0]], [[1.0]], [[0.0]]).state_space())
    assert np.isclose(one**2, 1 / (4 * 0.01 * 100.0**3))
    grid = np.linspace(0, 4000, 4_000_001)
    response = 1 / (100.0**2 - grid**2 + 2j * 0.01 * 100.0 * grid)
    assert np.isclose(np.trapezoid(np.abs(response) ** 2, grid) / np.pi, one**2, rtol=1e-3)
    return f"{one / two:.2f}"


def exercise_13() -> str:
    """How well a mass must be known for a scan that is off by no more than a nanometre."""
    mass, controller = (
        ModalModel([0.0], [0.0], [[1.0]], [[0.1]], [[0.0]]),
        PidFamily(10.0)(50.0).state_space(),
    )
    loop = error_loop(closed_loop(mass, None, controller))
    move = point_to_point(1e4, 100.0, 2.0, 0.1, cruise=0.02, settling=0.005, sample_time=1e-4)
    fitted = fit_feedforward(loop, move)
    wrong = tracking_error(loop, move, replace(fitted, acceleration=0.99 * fitted.acceleration))
    largest = np.abs(wrong[move.scanning]).max()  # m, for one per cent

    # The force that is missing, through 1 / (M s^2 + C), with polynomials.
    numerator, denominator = signal.ss2tf(controller.a, controller.b, controller.c, controller.d)
    whole = np.polyadd(10 * np.polymul([1, 0, 0], denominator), numerator[0])
    system = signal.TransferFunction(denominator, whole)
    _, error, _ = signal.lsim(system, 0.1 * move.derivatives[2], move.time)
    assert np.isclose(np.abs(error[move.scanning]).max(), largest, rtol=0.02)
    return f"{1e-9 / largest:.4f}"
