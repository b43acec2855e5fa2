"""Entrants whose gain does not depend on the data: designed once, a few products a sample."""

import numpy as np
from scipy.linalg import block_diag

from contest.nominal import Baseline, CompiledObserver, NominalModel, NominalNoise, TuningParameter
from experiments.motion.uncertainty import norm_bound, sampled_derivatives
from stillwork.base.algebra import add_product, copy_vector, plus_row, set_product
from stillwork.base.kernels import kernel
from stillwork.estimation.hinfinity import hinfinity_gains, smallest_level
from stillwork.estimation.riccati import discrete_gain
from stillwork.estimation.robust import Derivatives, regularised_gains, sensitivity_gains
from stillwork.estimation.time_varying import FilterGains, TimeVaryingModel

HORIZON = 800  # samples until a recursion's gain is taken as its last


@kernel
def _advance_fixed(data, memory, inputs, measurements, estimates):
    forward, onward, gain, c = data
    x, predicted, innovation = memory[0], np.empty(len(forward)), np.empty(len(c))
    for k in range(len(inputs)):
        set_product(forward, x, predicted)
        add_product(onward, inputs[k], predicted)
        copy_vector(predicted, x)
        if not np.isnan(measurements[k, 0]):
            for o in range(len(c)):
                innovation[o] = measurements[k, o] - plus_row(0.0, c, o, predicted)
            add_product(gain, innovation, x)
        for i in range(estimates.shape[1]):  # states of a disturbance, last, are not needed
            estimates[k, i] = x[i]


def fixed(forward, onward, gain, c) -> CompiledObserver:
    """Observer x = F x + B u + K (y - C (F x + B u)); a sample without a measurement is predicted."""
    arrays = tuple(map(np.ascontiguousarray, (forward, onward, gain, c)))
    return CompiledObserver(_advance_fixed, arrays, (np.zeros(len(forward)),))


def last(gains: FilterGains) -> CompiledObserver:
    """The gain that a recursion has come to."""
    return fixed(gains.forward[-1], gains.inputs[-1], gains.gain[-1], gains.outputs[-1])


def stationary(model: NominalModel, noise: NominalNoise) -> tuple[np.ndarray, np.ndarray]:
    """Kalman gain of the measurement, and the covariance after it."""
    solved = discrete_gain(model.a, model.b, model.c, noise.process, noise.sensor)
    after = solved.covariance - solved.filter_gain @ model.c @ solved.covariance
    return solved.filter_gain, (after + after.T) / 2


def recursion(model: NominalModel, noise: NominalNoise) -> TimeVaryingModel:
    """The model over the horizon of a design, begun where the Kalman filter ends."""
    c = np.tile(model.c, (HORIZON, 1, 1))
    start = stationary(model, noise)[1]
    return TimeVaryingModel(model.a, model.b, model.b, c, noise.process, noise.sensor, start)


def zero(model: NominalModel, noise: NominalNoise, sample_time: float) -> CompiledObserver:
    """The estimate zero: it scores 1 by definition."""
    a, b, gain = (np.zeros_like(each) for each in (model.a, model.b, model.c.T))
    return fixed(a, b, gain, model.c)


def open_model(model: NominalModel, noise: NominalNoise, sample_time: float) -> CompiledObserver:
    """The model for the flexible states, driven by the force alone; the rigid body has the Kalman gain."""
    gain = stationary(model, noise)[0]
    gain[2 * model.rigid_modes :] = 0
    return fixed(model.a, model.b, gain, model.c)


def kalman(model: NominalModel, noise: NominalNoise, sample_time: float) -> CompiledObserver:
    """The stationary Kalman filter for the noises as given (the thesis's choice)."""
    return fixed(model.a, model.b, stationary(model, noise)[0], model.c)


def fictitious(
    model: NominalModel, noise: NominalNoise, sample_time: float, force: float
) -> CompiledObserver:
    """Kalman filter with an independent force on every flexible mode besides, `force` times the deviation of w."""
    flexible = range(model.rigid_modes, len(model.frequencies))
    own = np.zeros((len(model.a), len(flexible)))
    for j, mode in enumerate(flexible):
        pair = slice(2 * mode, 2 * mode + 2)
        own[pair, j] = model.b[pair][:, np.abs(model.b[pair]).sum(axis=0).argmax()]
    own *= force * np.sqrt(noise.process[0, 0])
    driven = np.hstack([model.b @ np.linalg.cholesky(noise.process), own])
    solved = discrete_gain(model.a, driven, model.c, 1.0, noise.sensor)
    return fixed(model.a, model.b, solved.filter_gain, model.c)


_DERIVATIVES: dict[
    tuple, Derivatives
] = {}  # they cost more than the rest of a design, and no setting changes them


def derivatives(model: NominalModel, long: TimeVaryingModel, sample_time: float) -> Derivatives:
    """Derivatives of a recursion's model by the flexible modes' frequency, damping, input and output shape."""
    key = (model.a.tobytes(), model.b.tobytes(), model.c.tobytes())
    if key not in _DERIVATIVES:
        shapes = np.tile(model.output_shapes, (long.samples, 1, 1))
        _DERIVATIVES[key] = sampled_derivatives(model.machine, sample_time).along(long, shapes)
    return _DERIVATIVES[key]


def sensitivity(
    model: NominalModel, noise: NominalNoise, sample_time: float, weight: float
) -> CompiledObserver:
    """Sensitivity penalisation (5.25) with gamma = `weight` times the variance of the sensor."""
    long = recursion(model, noise)
    gamma = min(weight * noise.sensor[0, 0], 1.0)
    return last(sensitivity_gains(long, derivatives(model, long, sample_time), gamma))


def regularised(
    model: NominalModel, noise: NominalNoise, sample_time: float, size: float
) -> CompiledObserver:
    """Regularised least squares (5.21), given errors up to `size`; lambda by the rule of thumb."""
    long = recursion(model, noise)
    return last(regularised_gains(long, norm_bound(long, derivatives(model, long, sample_time), size)))


def hinfinity(model: NominalModel, noise: NominalNoise, sample_time: float, ratio: float) -> CompiledObserver:
    """H-infinity filter for the flexible states, in deviations of the Kalman filter, at `ratio` times the least level."""
    long = recursion(model, noise)
    wanted = np.diag(1 / np.sqrt(np.diag(long.initial_covariance)))[2 * model.rigid_modes :]
    return last(hinfinity_gains(long, wanted, ratio * smallest_level(long, wanted)))


def extended_state(
    model: NominalModel, noise: NominalNoise, sample_time: float, walk: float
) -> CompiledObserver:
    """Disturbance observer: every force has an unknown part beside it that walks by `walk` deviations of w a sample."""
    n, inputs = model.b.shape
    hold = np.eye(inputs)
    forward, driven = (
        np.block([[model.a, model.b], [np.zeros((inputs, n)), hold]]),
        np.vstack([model.b, 0 * hold]),
    )
    process = block_diag(noise.process, walk**2 * noise.process)
    c = np.hstack([model.c, np.zeros((len(model.c), inputs))])
    solved = discrete_gain(
        forward, np.hstack([driven, np.vstack([0 * model.b, hold])]), c, process, noise.sensor
    )
    return fixed(forward, driven, solved.filter_gain, c)


def unknown_input(
    model: NominalModel, noise: NominalNoise, sample_time: float, force: float
) -> CompiledObserver:
    """Observer of an input that is white and `force` times as large as w: the more, the less the model is followed."""
    return kalman(model, NominalNoise(force**2 * noise.process, noise.sensor), sample_time)


FIXED = {
    "zero": Baseline(zero, (), "the estimate zero"),
    "open model": Baseline(open_model, (), "the model without its measurements"),
    "Kalman": Baseline(kalman, (), "Kalman 1960; the thesis, section 5.1"),
    "fictitious noise": Baseline(
        fictitious,
        (TuningParameter("force on a mode over w", 1e-1, 1e4, 10.0),),
        "Jazwinski 1970, section 8.11",
    ),
    "regularised least squares": Baseline(
        regularised,
        (TuningParameter("largest error given", 1e-7, 1.0, 0.05),),
        "Sayed 2001; the thesis, (5.21)",
    ),
    "sensitivity penalised": Baseline(
        sensitivity, (TuningParameter("gamma over R", 1e-6, 1e8, 1.0),), "Zhou 2010; the thesis, (5.25)"
    ),
    "H-infinity": Baseline(
        hinfinity,
        (TuningParameter("level over the smallest", 1.01, 1e3, 1.2),),
        "Hassibi, Sayed and Kailath 1999",
    ),
    "disturbance observer": Baseline(
        extended_state,
        (TuningParameter("walk of the disturbance over w", 1e-4, 1e3, 1.0),),
        "Johnson 1971; Han 2009, extended state observer",
    ),
    "unknown input": Baseline(
        unknown_input,
        (TuningParameter("deviation of the input over that of w", 1.0, 1e6, 100.0),),
        "Kitanidis 1987, as a limit",
    ),
}
