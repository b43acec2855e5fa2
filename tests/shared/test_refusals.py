"""What no annotation can say is refused by the argument's name."""

import subprocess
import sys

import numpy as np
import pytest

from stillwork.base.checks import InputError
from stillwork.control.controlled_run import ending, require_noise
from stillwork.control.crossover import crossover
from stillwork.control.digital import anti_windup
from stillwork.control.feedback import fed_back
from stillwork.control.feedforward import Feedforward
from stillwork.control.fixed_point_convergence import LimitCycle, Oscillation
from stillwork.control.fixed_point_linear import LinearFilter, semi_implicit_motion
from stillwork.control.machine_loops import DesignSettings, Intensities
from stillwork.control.setpoint import Setpoint
from stillwork.control.trajectory import Trajectory
from stillwork.estimation import (
    FeLms,
    FeRls,
    LeastMeanSquares,
    LowPass,
    MinMaxRegressor,
    RecursiveLeastSquares,
    adapt,
    filter_signal,
    track,
)
from stillwork.estimation.coordinate_filters import SavitzkyGolay
from stillwork.estimation.covariance_forms import factor_of
from stillwork.estimation.filter_step import end_point_weights
from stillwork.estimation.linear_fits import total_least_squares
from stillwork.estimation.observer import Observer
from stillwork.estimation.secular import SecularFunction
from stillwork.identification.complex_frequency import Stabilisation
from stillwork.identification.frequency_response import impact_response
from stillwork.identification.machine_files import MachineFile, complex_responses
from stillwork.identification.regressors import exponential_weights, fir_regressors
from stillwork.lti import ModalModel, StateModel, interconnect, resonance_grid
from stillwork.lti.delays import delayed
from stillwork.lti.peaks import refine_peak
from stillwork.lti.state_space import constant
from stillwork.machine.machine_tuning import varied
from stillwork.signals.criteria import criterion_met, criterion_velocity, one_third_octave_velocity
from stillwork.signals.spectra import (
    ResponseEstimate,
    Spectrum,
    band_power,
    estimate_response,
    estimate_spectrum,
)

EYE, ONE, NONE = np.eye(2), np.eye(1), np.zeros((1, 1))
STAGE = ModalModel(np.array([0.0, 300.0]), np.array([0.0, 0.01]), EYE[:, :1], EYE[:1], NONE)
LAG, SAMPLED = StateModel(-ONE, ONE, ONE, NONE), StateModel(0.5 * ONE, ONE, ONE, NONE, 0.1)
NOISES = Intensities(1.0, 1.0, 1.0)
HITS, ROWS = np.random.default_rng(1).standard_normal((2, 2, 2000))
RECORD = np.zeros((1, 9))
X, Y = HITS[0, :90].reshape(30, 3), ROWS[0, :30]
WAVE, SLOPE = np.sin(np.arange(100) * 0.01), np.cos(np.arange(100) * 0.01)

REFUSED = [
    (lambda: ModalModel([0.0], [0.0], [[1.0]], [[1.0]], 0.0), "feedthrough"),
    (lambda: ModalModel([2.0, 1.0], [0, 0], EYE, EYE, np.zeros((2, 2))), "frequencies"),
    (lambda: ModalModel([0.0], [0.1], [[1]], [[1]], [[0]]), "damping"),
    (lambda: ModalModel([1.0], [1.0], [[1]], [[1]], [[0]]), "damping"),
    (lambda: Observer(None, EYE, EYE, EYE, EYE), "model"),
    (lambda: Observer(STAGE, -EYE, np.ones((2, 1)), np.ones((1, 2)), np.ones((3, 1))), "gain"),
    (lambda: refine_peak(np.sin, np.ones(3), np.ones(2)), "omega"),
    (lambda: crossover(np.sin, np.ones(3), np.ones(2)), "omega"),
    (lambda: resonance_grid([1j], 10.0, 5.0), "high_hz"),
    (lambda: SecularFunction([2.0, 1.0], [1.0, 1.0, 1.0], 1.0, 0.1), "coefficients"),
    (lambda: Spectrum([0.0, 1.0], [[1.0]], 1), "density"),
    (lambda: Feedforward(np.inf), "velocity"),
    (lambda: Setpoint(0.1, np.zeros((5, 10)), ("a", 0.5), 0.1), "scan[0]"),
    (lambda: fed_back(STAGE, [[1.0]]), "gain"),
    (lambda: interconnect([LAG], EYE, [[1.0]], [[1.0]]), "feedback"),
    (lambda: interconnect([], [[1.0]], [[1.0]], [[1.0]]), "models"),
    (lambda: complex_responses({}), "frequency"),
    (lambda: ending(99, 0.0, "x"), "status"),
    (lambda: require_noise(0, ""), "shape"),
    (lambda: require_noise(0, ()), "shape"),
    (lambda: LinearFilter(EYE, np.ones((3, 2)), np.ones((3, 2)), np.ones((3, 2))), "A, B, C"),
    (lambda: Stabilisation([1], [1.0, 2.0], [0.1], [True]), "order"),
    (lambda: MachineFile("response", "x", accelerance="x"), "accelerance"),
    (lambda: DesignSettings(None, 10**400, NOISES), "retained"),
    (lambda: varied(DesignSettings(None, 2, NOISES), "foo", 2.0), "name"),
    (lambda: Oscillation(np.nan, 1.0), "frequency_hz"),
    (lambda: LimitCycle(np.nan, 1.0, 1.0, 1.0, True), "frequency_hz"),
    (lambda: ResponseEstimate("x", *np.ones((3, 1, 1, 1)), 1), "frequencies_hz"),
    (lambda: impact_response(HITS, HITS, 1e308), "rate"),
    (lambda: semi_implicit_motion((1.0, 2.0, 3.0), 0.0), "sample_time"),
    (lambda: factor_of("triangle", np.ones((2, 3))), "covariance"),
    (lambda: end_point_weights(3, 5), "degree"),
    (lambda: constant(np.zeros((0, 0))), "gain"),
    (lambda: STAGE.state_space().select([], []), "inputs"),
    (lambda: STAGE.at([], []), "feedthrough"),
    (lambda: STAGE.frequency_response([]), "omega"),
    (lambda: STAGE.state_space().frequency_response([]), "omega"),
    (lambda: adapt(FeLms(0.1), np.ones((3, 0)), np.ones((1, 0))), "regressors"),
    (lambda: band_power([1, 2, 3], [1, 1, 1], 3, 1), "high_hz"),
    (lambda: band_power([1.0, 2.0], [1.0, 1.0], 0.5, 2.0), "low_hz"),
    (lambda: estimate_spectrum(np.ones(100), 1000.0, 1.0), "signals"),
    (lambda: estimate_spectrum(np.ones(5000), 1000.0, 900.0), "resolution_hz"),
    (lambda: estimate_spectrum(np.ones((2, 2, 500)), 1000.0, 10.0), "signals"),
    (lambda: estimate_response(ROWS, HITS[:, :-1], 1000.0, 1.0), "outputs"),
    (lambda: estimate_response(np.vstack([ROWS, HITS]), HITS, 1000.0, 1.0), "resolution_hz"),
    (lambda: criterion_velocity("VC-A", [-1.0]), "frequencies_hz"),
    (lambda: criterion_velocity("VCC", [10.0]), "'VC-C'"),
    (lambda: criterion_met([1.0], [1e-6]), "centres_hz"),
    (lambda: one_third_octave_velocity([10.0, 10.1], [1.0, 1.0]), "frequencies_hz"),
    # Settings and records that do not go together.
    (lambda: MinMaxRegressor([1.0, 2.0]).fit(X, Y), "bound"),
    (lambda: MinMaxRegressor(1.0, initial_coef=np.ones(3)).fit(X, Y), "initial_covariance"),
    (lambda: RecursiveLeastSquares(initial_coef=np.ones(2)).fit(X, Y), "initial_coef"),
    (lambda: RecursiveLeastSquares(window=9, initial_covariance=1.0).fit(X, Y), "initial_covariance"),
    (lambda: RecursiveLeastSquares().fit(X, Y, -np.ones(30)), "sample_weight"),
    (lambda: LeastMeanSquares().fit(np.nan * X, Y), "NaN"),
    (lambda: LeastMeanSquares().fit(np.ma.masked_equal([[1.0], [2.0]], 2), [1.0, 2.0]), "X"),
    (lambda: track(X.T, Y, bound=1.0, penalty=1.0), "penalty"),
    (lambda: track(1e99 * X.T, Y), "regressors"),
    (lambda: track(X.T, 1e-99 * Y), "outputs"),
    (lambda: track(EYE, np.ones(2)), "2 samples"),
    (lambda: total_least_squares([[1.0, 1.0], [1.0, 1.0], [0.0, 0.0]], [1.0, 2.0, 3.0]), "matrix"),
    (lambda: SavitzkyGolay(2, 2), "samples"),
    (lambda: filter_signal(LowPass(), [0.0, np.nan]), "measured"),
    (lambda: filter_signal(SavitzkyGolay(), np.zeros(5), sample_time=2e-3), "sample_time"),
    (lambda: filter_signal(LowPass(), np.repeat([0.0, 1e308], 50)), "sample 50"),
    (lambda: filter_signal(LowPass(2000.0), np.ones(5)), "bandwidth"),
    (lambda: Trajectory(0.01, WAVE), "record_trajectory"),
    (lambda: Trajectory(0.01, WAVE, 1.05 * SLOPE, -WAVE), "velocity"),  # five per cent off
    (lambda: Trajectory(0.01, WAVE, SLOPE, 0 * WAVE), "acceleration"),
    (lambda: Trajectory(0.01, WAVE, np.full(100, 1e307), 0 * WAVE), "velocity"),
    (
        lambda: anti_windup(
            StateModel([[1.0, 1.0], [0.0, 1.0]], np.ones((2, 1)), np.ones((1, 2)), NONE, 0.1), 0.1
        ),
        "anti_windup",
    ),
    (lambda: anti_windup(StateModel(ONE, ONE, NONE, NONE, 0.1), 0.1), "anti_windup"),
    # What cannot end is refused with its size.
    (lambda: FeRls(1.0).start(30_000), "regressors needs"),
    (lambda: fir_regressors(np.ones(60), taps=30_000_000), "taps needs"),
    (lambda: exponential_weights(10**12, 0.9), "rows needs"),
    (lambda: end_point_weights(10**12, 2), "samples needs"),
    (lambda: delayed(SAMPLED, 30_000), "samples needs"),
    (lambda: resonance_grid(np.array([-1 + 9j]), 1.0, 2.0, points=9, around=10**12), "around needs"),
]


def answered():
    """Calls that gave a result, and errors that do not name what they should."""
    for number, (call, name) in enumerate(REFUSED):
        try:
            yield number, name, call()
        except InputError as error:
            if name not in str(error):
                yield number, name, error


@pytest.mark.slow
def test_each_names_its_argument():
    """In a process of its own: here the tests' type checker would answer first."""
    done = subprocess.run([sys.executable, "-W", "ignore", __file__], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr


if __name__ == "__main__":
    print(*answered(), sep="\n", end="")
