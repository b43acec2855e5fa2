"""Solutions of the track on observers for motion.

Each function answers the exercise of its number with the toolbox, compares the answer with something that shares no
code with it, and returns the check of the exercise. Its arguments are the numbers of the exercise: with others
it gives the answer to a new one.
"""

from dataclasses import replace

import control as ct
import numpy as np
from scipy import linalg, optimize

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


def exercise_1(amplitude: float = 10.0, frequency_hz: float = 100.0, exposure: float = 5e-3) -> str:
    """The moving average of a vibration at half the frequency that the slit filters out."""
    sample_time, time = 1e-5, 1e-5 * np.arange(20_000)
    error = amplitude * np.sin(2 * np.pi * frequency_hz * time)  # nm
    largest = np.abs(moving(error, sample_time, exposure).average).max()

    assert np.isclose(
        largest, amplitude * np.sinc(frequency_hz * exposure), rtol=1e-3
    )  # half a period: 2 / pi
    silent = moving(amplitude * np.sin(2 * np.pi * time / exposure), sample_time, exposure)
    assert np.abs(silent.average).max() < 1e-9 and np.isclose(silent.deviation.max(), amplitude / np.sqrt(2))
    return f"{largest:.2f}"


def exercise_2(first: float = 100.0, second: float = 150.0) -> str:
    """What a truncated mode takes with it: the anti-resonance moves, and the compliance puts it back."""
    full = ModalModel([0, first, second], [0, 0, 0], [[0.3], [0.3], [0.3]], [[0.3, 0.3, 0.3]], [[0.0]])

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

    expected = [roots(0, [first, second]), roots(0, [first]), roots(1 / second**2, [first])]
    assert np.allclose(found, expected)
    return f"{100 * (found[1] / found[0] - 1):.1f}"


def exercise_3(stiffness: float = 1.0) -> str:
    """A sensor beside the actuator sees the resonances of the machine that is held there."""
    spring = stiffness * np.array([[1.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
    beside = modal_model(np.eye(3), spring, [[1], [0], [0]], [[1, 0, 0]])
    zeros = np.sort(np.abs(beside.state_space().zeros))
    held = np.sqrt(linalg.eigvalsh(spring[1:, 1:]))
    assert np.allclose(zeros[::2], held)
    far = modal_model(np.eye(3), spring, [[1], [0], [0]], [[0, 0, 1]])
    assert far.state_space().zeros.size == 0  # from one end to the other: none at all
    return f"{zeros[0]:.3f}"


def exercise_4(frequency_hz: float = 800.0, rate_hz: float = 5000.0) -> str:
    """Tustin's rule moves a resonance down."""
    mode = ModalModel([2 * np.pi * frequency_hz], [0.0], [[1.0]], [[1.0]], [[0.0]])
    poles = tustin(mode.state_space(), 1 / rate_hz).poles
    found = np.abs(np.angle(poles[0])) * rate_hz / (2 * np.pi)
    assert np.isclose(found, rate_hz / np.pi * np.arctan(np.pi * frequency_hz / rate_hz))
    kept = tustin(mode.state_space(), 1 / rate_hz, omega=2 * np.pi * frequency_hz).poles
    assert np.isclose(np.abs(np.angle(kept[0])) * rate_hz / (2 * np.pi), frequency_hz)
    return f"{found:.1f}"


def exercise_5(frequency_hz: float = 100.3, damping: float = 0.001) -> str:
    """A fit finds a damping that the resolution of its data hides."""
    true = ModalModel([0.0, 2 * np.pi * frequency_hz], [0.0, damping], [[0.3], [0.3]], [[0.3, -0.3]], [[0.0]])
    omega = 2 * np.pi * np.arange(20.0, 200.0)  # each hertz; the peak is 0.2 Hz wide at half its power
    accelerance = -(omega**2) * true.frequency_response(omega)[0, 0]
    fit = fit_modes(
        Identified(omega, accelerance, np.ones(180)), [round(frequency_hz)], band_hz=(20.0, 199.0)
    )
    assert np.isclose(fit.model.damping[1], damping, rtol=1e-3)

    # The half-power width, read off the data at hand and off a dense grid.
    dense = 2 * np.pi * np.linspace(0.99 * frequency_hz, 1.01 * frequency_hz, 300_001)
    power = np.abs(true.modes([1]).frequency_response(dense)[0, 0]) ** 2
    width = np.ptp(dense[power > power.max() / 2]) / (2 * np.pi)
    assert np.isclose(width, 2 * damping * frequency_hz, rtol=1e-3)
    coarse = np.abs(true.modes([1]).frequency_response(omega)[0, 0]) ** 2
    assert coarse.max() < power.max() / 2  # no line is inside
    return f"{width:.2f}"


def exercise_6(frequency: float = 600.0, damping: float = 0.005) -> str:
    """Bandwidth of a PID controller against the damping of a mode: the cube root, where the mode limits at all."""
    found = {}
    for sign in (1, -1):
        for each in (damping, 2 * damping):
            machine = ModalModel([0.0, frequency], [0.0, each], [[0.3], [0.3]], [[0.3, 0.3 * sign]], [[0.0]])
            limit = [PeakConstraint("input_sensitivity")]
            best = maximise_bandwidth(
                [make_loop(machine)], PidFamily(1 / 0.09), limit, frequency / 300, frequency / 10
            )
            found[sign, each] = best.design_hz
            # At the limit the peak of 1 / (1 + L) is 6 dB, with the mode written out, on a grid of its own.
            s = 1j * frequency * np.linspace(0.08, 1.7, 200_001)
            plant = 0.09 / s**2 + 0.09 * sign / (s**2 + 2 * each * frequency * s + frequency**2)
            line = plant * best.controller.frequency_response(s.imag)
            assert np.isclose(np.abs(1 / (1 + line)).max(), 10 ** (6 / 20), rtol=1e-3)
    ratio = found[1, 2 * damping] / found[1, damping]
    assert np.isclose(ratio, 2 ** (1 / 3), rtol=0.01)
    assert abs(found[-1, 2 * damping] / found[-1, damping] - 1) < 0.01
    return f"{ratio:.2f}"


def exercise_7(bandwidth_hz: float = 100.0) -> str:
    """Kalman's observer of a free mass is a Butterworth filter of second order."""
    mass = ModalModel([0.0], [0.0], [[1.0]], [[1.0]], [[0.0]])
    ratio = (2 * np.pi * bandwidth_hz) ** 4  # process over sensor noise
    observer = kalman_observer(mass, NoiseIntensities(1.0, 1 / ratio))
    poles = np.linalg.eigvals(observer.a - observer.gain @ observer.c)

    expected = 2 * np.pi * bandwidth_hz * np.exp(1j * np.pi * np.array([3, -3]) / 4)
    assert np.allclose(np.sort_complex(poles), np.sort_complex(expected))
    return f"{-poles[0].real / np.abs(poles[0]):.3f}"


def exercise_8(
    frequency: float = 600.0, damping: float = 0.01, shape: float = 0.3, sensor: float = 1e-12
) -> str:
    """What the observer subtracts for a steady force: more than the compliance, where it trusts the sensor."""
    stage = ModalModel([0.0, frequency], [0.0, damping], [[shape], [shape]], [[shape, -shape]], [[0.0]])
    found = {}
    for each in (sensor, 1e-2):
        observer = kalman_observer(stage, NoiseIntensities(1.0, each))
        block = compensator(observer, Application(compensate=True))
        found[each] = block.frequency_response([1e-6])[1, 0].real.item()
        # At rest 0 = (A - L C) x + B u, while the sensor says nothing.
        rest = -np.linalg.solve(observer.a - observer.gain @ observer.c, observer.b)
        assert np.isclose(found[each], (observer.c[:, 2:] @ rest[2:]).item(), rtol=1e-4)
    assert np.isclose(found[1e-2], -(shape**2) / frequency**2, rtol=0.02)
    return f"{1e9 * found[sensor]:.0f}"


def exercise_9(damping: float = 0.005, reduction_db: float = 20.0) -> str:
    """How well a frequency must be known for a prediction to take 20 dB off its resonance."""
    target = 10 ** (-reduction_db / 20)

    def left(error: float) -> float:
        """Largest of what remains over the largest of what was."""
        grid = np.linspace(0.98, 1.02, 80_001)
        machine, model = (
            ModalModel([scale], [damping], [[1.0]], [[1.0]], [[0.0]]).frequency_response(grid)[0, 0]
            for scale in (1.0, 1.0 + error)
        )
        return float(np.abs(machine - model).max() / np.abs(machine).max())

    error = optimize.brentq(lambda error: left(error) - target, 1e-6, 1e-2)
    assert np.isclose(error, target * damping, rtol=0.1)  # to first order: error over damping
    assert left(2 * damping) > 0.9  # one per cent is as good as no model
    return f"{100 * error:.2f}"


def exercise_10(one: float = 100.0, two: float = 103.0, damping: float = 0.005, added: float = 0.1) -> str:
    """Damping chosen mode by mode, for two modes that the one actuator cannot move apart."""
    model = ModalModel([one, two], [damping, damping], [[1.0], [1.0]], [[1.0, 1.0]], [[0.0]])
    gain = damping_gain(model, added)
    state = model.state_space()
    poles = np.linalg.eigvals(state.a + state.b @ gain)
    least = float(np.min(-poles.real / np.abs(poles)))

    # The characteristic polynomial: D1 D2 + 2 zeta w s (D1 + D2), with D = s^2 + 2 zeta0 w s + w^2.
    first, second = ([1, 2 * damping * w, w**2] for w in (one, two))
    poly = np.polymul(first, second)
    for omega, other in ((one, second), (two, first)):
        poly = np.polyadd(poly, np.polymul([2 * added * omega, 0], other))
    roots = np.roots(poly)
    assert np.isclose(np.min(-roots.real / np.abs(roots)), least)
    placed = damping_gain(model, added, "pole placement")
    poles = np.linalg.eigvals(state.a + state.b @ placed)
    assert np.allclose(-poles.real / np.abs(poles), damping + added)
    return f"{least:.4f}"


def exercise_11(places: tuple[float, ...] = (-0.5, 0.0, 1.0)) -> str:
    """Three actuators for one translation and one rotation: the least forces that do it."""
    shapes = np.stack([np.ones(3), np.array(places)])
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


def exercise_12(frequency: float = 100.0, damping: float = 0.01) -> str:
    """White noise through a mode: the variance falls with damping, and with the third power of the frequency."""
    one = h2_norm(ModalModel([frequency], [damping], [[1.0]], [[1.0]], [[0.0]]).state_space())
    two = h2_norm(ModalModel([2 * frequency], [damping], [[1.0]], [[1.0]], [[0.0]]).state_space())
    assert np.isclose(one**2, 1 / (4 * damping * frequency**3))
    grid = frequency * np.linspace(0, 40, 400_001)
    response = 1 / (frequency**2 - grid**2 + 2j * damping * frequency * grid)
    assert np.isclose(np.trapezoid(np.abs(response) ** 2, grid) / np.pi, one**2, rtol=1e-3)
    return f"{one / two:.2f}"


def exercise_13(mass: float = 10.0, bandwidth_hz: float = 50.0) -> str:
    """How well a mass must be known for a scan that is off by no more than a nanometre."""
    stage = ModalModel([0.0], [0.0], [[1.0]], [[1 / mass]], [[0.0]])
    controller = PidFamily(mass)(bandwidth_hz).state_space()
    loop = error_loop(closed_loop(stage, None, controller))
    move = point_to_point(1e4, 100.0, 2.0, 0.1, cruise=0.02, settling=0.005, sample_time=1e-4)
    fitted = fit_feedforward(loop, move)
    wrong = tracking_error(loop, move, replace(fitted, acceleration=0.99 * fitted.acceleration))
    largest = np.abs(wrong[move.scanning]).max()  # m, for one per cent

    # The force that is missing, through 1 / (M s^2 + C), by python-control.
    closed = ct.feedback(ct.ss(ct.tf([1.0], [mass, 0.0, 0.0])), controller.to_control())
    error = ct.forced_response(closed, move.time, 0.01 * mass * move.derivatives[2]).outputs
    assert np.isclose(np.abs(error[move.scanning]).max(), largest, rtol=0.02)
    return f"{1e-9 / largest:.4f}"
