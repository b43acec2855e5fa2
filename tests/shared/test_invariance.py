"""What no answer may depend on: the unit of a length or a force, that of time, and the order of an array.

One line of a table for each function, so that a new function gets one, too.
"""

import numpy as np
import pytest

from stillwork import control, estimation, identification, lti, signals
from stillwork.estimation.hinfinity import hinfinity_gains, smallest_level
from stillwork.estimation.time_varying import TimeVaryingModel
from stillwork.lti import StateModel

UNITS = [1e-9, 1e3]
RATES = [1e-3, 40.0]


def noise(seed=0, shape=(2, 2000)):
    return np.random.default_rng(seed).standard_normal(shape)


def stage(length=1.0, force=1.0, rate=1.0):
    """A free mass with two modes, in units of `length` m, `force` N and 1 / `rate` s."""
    shape = np.array([[0.3], [0.3], [0.2]])
    return lti.ModalModel(
        np.array([0.0, 600.0, 1500.0]) * rate,
        np.array([0.0, 0.01, 0.02]),
        shape * force * rate,
        np.array([[0.3, -0.3, 0.2]]) * rate / length,
        np.zeros((1, 1)),
    )


def filtered(length=1.0, force=1.0, rate=1.0):
    """A stable model of two inputs and outputs."""
    rng = np.random.default_rng(4)
    a = rng.standard_normal((5, 5))
    a -= (np.abs(np.linalg.eigvals(a)).max() + 0.5) * np.eye(5)
    return StateModel(
        a * rate,
        rng.standard_normal((5, 2)) * force * rate,
        rng.standard_normal((2, 5)) / length,
        np.zeros((2, 2)),
    )


def designed(length=1.0, force=1.0, rate=1.0):
    """Design parameter and crossing of a PID for the stage."""
    plant = stage(length, force, rate)
    loop = control.make_loop(plant, low_hz=0.1 * rate, high_hz=2e4 * rate)
    family = control.PidFamily(11.0 * length / force / rate**2)
    best = control.maximise_bandwidth(
        [loop],
        family,
        [control.PeakConstraint("input_sensitivity")],
        low_hz=10.0 * rate,
        high_hz=150.0 * rate,
        tolerance_hz=1e-4 * rate,
    )
    return np.array([best.design_hz, *best.crossing_hz]) / rate


def fitted(length=1.0, rate=1.0):
    """Frequencies (over `rate`), damping and shapes of a fit to a measured accelerance."""
    omega = 2 * np.pi * np.linspace(20.0, 300.0, 400)
    accelerance = -(omega**2) * stage().frequency_response(omega)[0, 0]
    accelerance = accelerance * (1 + 1e-3 * (noise(3, 400) + 1j * noise(5, 400)))
    measured = identification.Identified(omega * rate, accelerance / length, np.ones(400))
    model = identification.fit_modes(measured, [95.0 * rate, 238.0 * rate], (20.0 * rate, 299.0 * rate)).model
    return model.frequencies / rate, model.damping, model.output_shapes * model.input_shapes.T * length


def steered(length=1.0, force=1.0, rate=1.0, outputs=(0, 1), noises=(0, 1)):
    """A generalised plant: noise of a force and of a sensor, a position and a force as performance, in other orders."""
    model = filtered(length, force, rate)
    b = np.hstack([model.b[:, :1] / force, np.zeros((5, 1))])[:, noises]
    d = np.zeros((3, 3))
    d[outputs.index(1), 2], d[2, noises.index(1)] = 0.3 / length * force * np.sqrt(rate), 0.2 / length
    c = np.vstack([model.c[0], np.zeros(5)])[list(outputs)] * np.sqrt(rate)
    whole = StateModel(model.a, np.hstack([b, model.b[:, 1:]]), np.vstack([c, model.c[1:]]), d)
    return lti.GeneralisedPlant(whole, exogenous=2, performance=2)


def controlled(length=1.0, force=1.0, rate=1.0):
    """Response of the H2-optimal controller, in units of force a length."""
    controller = estimation.h2_riccati(steered(length, force, rate)).controller
    return controller.frequency_response(np.array([0.3, 2.0, 9.0]) * rate) / length * force


def decoupled(length=1.0, force=1.0, actuators=slice(None), sensors=slice(None)):
    """Matrices for a plate with a rigid-body translation and rotation, and one flexible mode."""
    shapes = np.array([[0.3, 0.3, 0.3], [0.5, -0.5, 0.1], [0.2, 0.1, -0.4]])
    plate = lti.ModalModel(
        np.array([0.0, 0.0, 600.0]),
        np.array([0.0, 0.0, 0.01]),
        (shapes * force)[:, actuators],
        (shapes.T[::-1] / length)[sensors],
        np.zeros((3, 3)),
    )
    return control.decouple(plate, sensed=[0, 1])


def fed_forward(length=1.0, force=1.0, rate=1.0):
    """Gains for the free mass with two modes under a PID."""
    plant = stage(length, force, rate)
    controller = control.PidFamily(11.0 * length / force / rate**2)(20.0 * rate).state_space()
    loop = control.error_loop(control.closed_loop(plant, None, controller))
    limits = np.array([1e4, 100.0, 2.0, 0.1]) / length * rate ** np.array([4.0, 3.0, 2.0, 1.0])
    times = np.array([0.02, 0.005, 1e-3]) / rate
    move = control.point_to_point(*limits, cruise=times[0], settling=times[1], sample_time=times[2])
    gains = control.fit_feedforward(loop, move).gains
    return gains * force / length * rate ** np.array([1.0, 2.0, 3.0, 4.0])


def adapted(settings, rows, target):
    return estimation.identify(settings, rows, target).weights


def level_kept(k):
    """Smallest level of an H-infinity filter whose states are in units of `k`."""
    return smallest_level(states_in(k), np.array([[1.0, 0.5]]) / k, 1e-9)


def gains_at_a_level(k):
    return hinfinity_gains(states_in(k), np.array([[1.0, 0.5]]) / k, 5.0).gain / k


def states_in(k):
    eye, c = np.eye(2), np.broadcast_to([[1.0, 0.3]], (40, 1, 2))
    turn = np.array([[0.9, 0.2], [-0.2, 0.9]])
    return TimeVaryingModel(turn, np.zeros((2, 1)), eye, c / k, 0.1 * eye * k**2, np.eye(1), eye * k**2)


# Of each function what it gives in a unit, brought back from it; 1.0 must give the same.
LENGTHS = {
    "spectrum": lambda k: signals.estimate_spectrum(k * noise(), 1000.0, 5.0).density / k**2,
    "response": lambda k: signals.estimate_response(k * noise(), noise(1), 1000.0, 5.0).response * k,
    "response of outputs": lambda k: (
        signals.estimate_response(noise(), k * noise(1), 1000.0, 5.0).response / k
    ),
    "coherence": lambda k: signals.estimate_response(k * noise(), noise(1) / k, 1000.0, 5.0).coherence,
    "moving average": lambda k: signals.moving(k * noise()[0], 1e-3, 7e-3).average / k,
    "moving deviation": lambda k: signals.moving(k * noise()[0], 1e-3, 7e-3).deviation / k,
    "H2 norm": lambda k: lti.h2_norm(filtered(length=k)) * k,
    "H-infinity norm": lambda k: lti.hinf_norm(filtered(length=k)).magnitude * k,
    "zoh": lambda k: lti.zoh(filtered(length=k), 0.1).c * k,
    "simulation": lambda k: lti.simulate(lti.zoh(filtered(force=k), 0.1), noise()) / k,
    "Kalman observer": lambda k: (
        estimation.kalman_observer(stage(length=k), estimation.NoiseIntensities(1.0, 1e-12 / k**2)).gain / k
    ),
    "FeRLS": lambda k: adapted(estimation.FeRls(1e3 / k**2, 0.99), k * noise(), k * noise(1)[:1]),
    "FeRLS of the disturbance": lambda k: adapted(estimation.FeRls(1e3, 0.99), noise(), k * noise(1)[:1]) / k,
    "FeLMS": lambda k: adapted(estimation.FeLms(0.1, 1e-5 * k**2), k * noise(), k * noise(1)[:1]),
    "bandwidth": lambda k: designed(length=k),
    "bandwidth of a force": lambda k: designed(force=k),
    "frequencies of a fit": lambda k: fitted(length=k)[0],
    "damping of a fit": lambda k: fitted(length=k)[1],
    "shapes of a fit": lambda k: fitted(length=k)[2],
    "damping": lambda k: control.damping_gain(stage(force=k), [0.1, 0.1]) * k,
    "level of an H-infinity filter": level_kept,
    "gains of an H-infinity filter": gains_at_a_level,
    "H2 optimum": lambda k: estimation.h2_riccati(steered(length=k)).norm * k,
    "H2-optimal controller": lambda k: controlled(length=k),
    "decoupling of sensors": lambda k: decoupled(length=k).sensing / k,
    "decoupling of actuators": lambda k: decoupled(force=k).actuation * k,
    "feedforward": lambda k: fed_forward(length=k),
    "feedforward of a force": lambda k: fed_forward(force=k),
    "low pass": lambda k: estimation.filter_signal(estimation.LowPass(350.0), k * noise()[0]).velocity / k,
    "trajectory": lambda k: control.asin_trajectory(amplitude=k).acceleration / k,
    "setpoint": lambda k: (
        control.point_to_point(
            1e4 * k, 100.0 * k, 2.0 * k, 0.1 * k, cruise=0.02, settling=0.005, sample_time=1e-3
        ).derivatives
        / k
    ),
}
TIMES = {
    "spectrum": lambda k: signals.estimate_spectrum(noise(), 1000.0 * k, 5.0 * k).density * k,
    "response": lambda k: signals.estimate_response(noise(), noise(1), 1000.0 * k, 5.0 * k).response,
    "H2 norm": lambda k: lti.h2_norm(filtered(rate=k)) / np.sqrt(k),
    "H-infinity norm": lambda k: lti.hinf_norm(filtered(rate=k)).magnitude,
    "zoh": lambda k: lti.zoh(filtered(rate=k), 0.1 / k).a,
    "tustin": lambda k: lti.tustin(filtered(rate=k), 0.1 / k, omega=3.0 * k).a,
    "bandwidth": lambda k: designed(rate=k),
    "frequencies of a fit": lambda k: fitted(rate=k)[0],
    "damping of a fit": lambda k: fitted(rate=k)[1],
    "H2 optimum": lambda k: estimation.h2_riccati(steered(rate=k)).norm / k,
    "H2-optimal controller": lambda k: controlled(rate=k),
    "feedforward": lambda k: fed_forward(rate=k),
    "low pass": lambda k: (
        estimation.filter_signal(estimation.LowPass(350.0 * k), noise()[0], sample_time=1e-3 / k).velocity / k
    ),
    "trajectory": lambda k: (
        control.asin_trajectory(frequency_hz=0.2 * k, duration=12.0 / k, sample_time=1e-3 / k).velocity / k
    ),
    "setpoint": lambda k: (
        control.point_to_point(
            1e4 * k**4,
            100.0 * k**3,
            2.0 * k**2,
            0.1 * k,
            cruise=0.02 / k,
            settling=0.005 / k,
            sample_time=1e-3 / k,
        ).derivatives[1]
        / k
    ),
}
# Searches and iterations that end at a tolerance of their own.
LOOSE = {"bandwidth": 2e-5, "bandwidth of a force": 2e-5, "FeLMS": 1e-8, "Kalman observer": 1e-6}
LOOSE |= {"frequencies of a fit": 1e-6, "damping of a fit": 1e-5}
LOOSE["shapes of a fit"] = 1e-5


def agrees(found, wanted, name):
    assert np.shape(found) == np.shape(wanted)
    assert np.abs(found - wanted).max() <= LOOSE.get(name, 1e-9) * np.abs(wanted).max()


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("name", LENGTHS)
def test_a_unit_of_length_or_force_changes_no_answer(name, unit):
    agrees(LENGTHS[name](unit), LENGTHS[name](1.0), name)


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("name", TIMES)
def test_a_unit_of_time_changes_no_answer(name, rate):
    agrees(TIMES[name](rate), TIMES[name](1.0), name)


# Of channels, or of rows, that come in another order what comes out in the order of before.
ORDER = np.array([2, 0, 1])
BACK = np.argsort(ORDER)


def quieter(shape):
    """Correlated rows that fall silent, one combination after the other, so that several limits act in a sample."""
    rows = noise(7, (shape[0], shape[0])) @ noise(shape=shape)
    return rows * np.exp(-np.arange(shape[1]) / 60)


ORDERS = {
    "spectrum": lambda o, b: signals.estimate_spectrum(noise(shape=(3, 900))[o], 1000.0, 5.0).density[b],
    "response": lambda o, b: signals.estimate_response(
        noise(shape=(3, 2000))[o], noise(1), 1000.0, 5.0
    ).response[:, b],
    "response of outputs": lambda o, b: signals.estimate_response(
        noise(), noise(1, (3, 2000))[o], 1000.0, 5.0
    ).response[b],
    "FeRLS": lambda o, b: adapted(
        estimation.FeRls(1e3, 0.99, growth_limit=np.inf), noise(shape=(3, 500))[o], noise(1, (1, 500))
    )[:, b],
    "FeRLS at its limits": lambda o, b: adapted(
        estimation.FeRls(1.0, 0.98, growth_limit=1.0), quieter((3, 500))[o], noise(1, (1, 500))
    )[:, b],
    "FeLMS": lambda o, b: adapted(estimation.FeLms(0.1), noise(shape=(3, 500))[o], noise(1, (1, 500)))[:, b],
}


@pytest.mark.filterwarnings("ignore::stillwork.estimation.recursive.GrowthLimitWarning")
@pytest.mark.parametrize("name", ORDERS)
def test_the_order_of_channels_changes_no_answer(name):
    agrees(ORDERS[name](ORDER, BACK), ORDERS[name](np.arange(3), np.arange(3)), "FeLMS")


def test_a_record_played_backwards_has_the_same_spectrum_and_the_mirrored_response():
    """Of whole windows; a system played backwards has the complex conjugate of its response."""
    x, y = noise(shape=(1, 2000)), noise(1, (1, 2000))
    forward, back = (signals.estimate_spectrum(each, 1000.0, 5.0) for each in (x, x[:, ::-1]))
    np.testing.assert_allclose(
        back.density, forward.density, rtol=0.02 + 1e-9, atol=0.02 * forward.density.max()
    )
    one, other = (signals.estimate_response(a, b, 1000.0, 5.0) for a, b in ((x, y), (x[:, ::-1], y[:, ::-1])))
    np.testing.assert_allclose(other.response, one.response.conj(), atol=0.05)
