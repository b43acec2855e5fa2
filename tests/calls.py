"""A good call of every function and class of the toolbox's public API, and of the models beside it, for property tests."""

import dataclasses
import pkgutil
from importlib import import_module
from types import ModuleType, SimpleNamespace

import numpy as np

from stillwork import control, estimation, identification, lti, machine, signals
from stillwork.estimation.time_varying import TimeVaryingModel

PACKAGES = {
    "signals": signals,
    "lti": lti,
    "identification": identification,
    "estimation": estimation,
    "control": control,
    "machine": machine,
}
# No calls: made by the functions beside them, warnings and errors.
RESULTS = {
    "Peak", "Identified", "Machine", "ModalFit", "Adaptation", "KalmanGain", "MinMaxSolution", "Track", "Bandwidth",
    "GainProof", "MinimalRealisation", "CancellationWarning",
    "LoopResponse", "ControlledRun", "Loop", "UnstableAdaptation", "ZeroEstimateWarning", "ContractionWarning",
}  # fmt: skip
# Calls whose good arguments stand for a file or a machine that is not there.
REFUSED = {
    "load_record",
    "load_machine",
    "build_machine",
    "from_control",
    "load_controller",
    "require_explained",
}


def _acceleration(position, velocity, force, parameters):
    return force / parameters[0]


def _force(position, velocity, acceleration, parameters):
    return acceleration * parameters[0]


def _inertia(position, parameters, out):
    out[0, 0], out[0, 1], out[1, 0], out[1, 1] = parameters[0], 0.1, 0.1, parameters[0]


def _bias(position, velocity, parameters, out):
    out[0], out[1] = position[0], velocity[1]


def _linear_inertia(position, parameters, out):
    out[0, 0], out[0, 1], out[1, 0], out[1, 1] = parameters[0], 0.0, 0.0, parameters[0]


def _linear_bias(position, velocity, parameters, out):
    out[0], out[1] = parameters[0] * position[0], parameters[0] * velocity[1]


def _whole(package: ModuleType) -> SimpleNamespace:
    """What all modules of a folder define, in its public API or not; the API decides between equal names."""
    names: dict = {}
    for found_module in pkgutil.iter_modules(package.__path__):
        module = import_module(f"{package.__name__}.{found_module.name}")
        names |= {n: o for n, o in vars(module).items() if getattr(o, "__module__", "") == module.__name__}
    return SimpleNamespace(**names | {name: getattr(package, name) for name in package.__all__})


def fields(value):
    """The fields of a model, by name."""
    return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}


# What the calls are given.
rng = np.random.default_rng(5)
noise = rng.standard_normal
signals, lti, i, e, c, m = map(_whole, PACKAGES.values())
model = lti.ModalModel(
    np.array([0.0, 300.0, 900.0]), np.array([0.0, 0.01, 0.02]), np.array([[0.3], [0.4], [0.2]]),
    np.array([[0.3, -0.4, 0.2]]), np.zeros((1, 1)),
)  # fmt: skip
broad = lti.ModalModel(
    np.array([0.0, 0.0, 300.0]), np.array([0.0, 0.0, 0.01]), np.array([[0.3, 0.3], [0.3, -0.3], [0.2, 0.1]]),
    np.array([[0.3, 0.3, 0.2], [0.3, -0.3, 0.1]]), np.zeros((2, 2)),
)  # fmt: skip
state = lti.StateModel(
    np.array([[-1.0, 2.0], [-2.0, -1.0]]),
    np.array([[0.0], [1.0]]),
    np.array([[1.0, 0.0]]),
    np.zeros((1, 1)),
)
sampled = lti.zoh(state, 0.01)
lag = lti.StateModel(np.array([[-10.0]]), np.ones((1, 2)), np.ones((2, 1)), np.zeros((2, 2)))
holding = lti.StateModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[-5.0]]))
network = c.Network(lag, holding, {"load": "N"}, {"drive": "N"}, {"error": "m"}, {"sensor": "m"})
source = c.Source(
    "load",
    ("load",),
    "N",
    lambda f: np.full(len(f), 2.0),
    (0.0, 1e9),
    np.array([3.0]),
    ((5.0, 0.1),),
    20.0,
    0.5,
)
afloat = c.FloorMachine(
    16.0,
    5.0,
    0.05,
    lti.ModalModel(np.zeros(1), np.zeros(1), np.full((1, 1), 0.5), np.full((1, 1), 0.5), np.zeros((1, 1))),
    c.PidFamily(4.0)(50.0),
)
digital = c.DigitalController(sampled, ("e (m)",), ("f (N)",), [-1.0], [1.0], np.zeros((2, 1)), 1)
doubled = lti.StateModel(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.array([[2.0, -2.0]]), 0.01)
single = lti.ModalModel(
    np.array([0.0, 600.0]),
    np.array([0.0, 0.01]),
    np.full((2, 1), 0.3),
    np.array([[0.3, -0.3]]),
    np.zeros((1, 1)),
)
limits = c.MoveLimits(0.2, 5.0, 500.0, 1e5)
observer = e.kalman_observer(model, e.NoiseIntensities(1.0, 1e-12))
sampled_observer = c.discrete_kalman_observer(model, e.NoiseIntensities(1.0, 1e-12), 1e-4)
plant = e.Plant(_acceleration, _force, np.array([2.0]))
guess = e.Plant(_acceleration, _force, np.array([2.2]))
controller = c.Controller(e.LowPass(), c.FlowTransformation(), c.KinematicDesign(10.0), guess)
trajectory = c.sine_trajectory(duration=0.1)
arm = c.Mechanism(_inertia, _bias, 2, np.array([2.0]))
arms = c.Controller(e.LowPass(), c.FlowTransformation(), c.KinematicDesign(10.0), arm)
linear_arm = c.Mechanism(_linear_inertia, _linear_bias, 2, np.array([2.0]))
adaptive = c.SlotineLi(
    e.LowPass(), c.KinematicDesign(10.0, order=1), linear_arm, np.array([5.0, 5.0]), np.array([0.1])
)
setpoint = c.point_to_point(1e4, 100.0, 2.0, 0.1, 0.02, 0.005, 1e-3)
pid = c.PidFamily(11.0)
loop = c.closed_loop(model, None, pid(10.0).state_space())
search = c.make_loop(model, points=50, around=3)
decoupling = c.decouple(broad)
rows, signal = noise((3, 60)), noise(60)
omega = np.linspace(50.0, 1500.0, 120)
record = signals.Record(noise((2, 600)), 100.0, "m", ("a", "b"), "record.csv")
accelerance = (-(omega**2) * model.frequency_response(omega)[0, 0]).astype(complex)
measured = i.Identified(omega, accelerance, np.ones(len(omega)))
joined = {"feedback": np.zeros((1, 1)), "inputs": np.eye(1), "outputs": np.eye(1)}
lines = {"settings": e.FeRls(1.0), "regressors": rows, "every": 10}
block = {"matrix": rows.T, "target": signal, "bound": 0.1}

walk = TimeVaryingModel(
    np.array([[0.9, 0.1], [0.0, 0.8]]), np.ones((2, 1)), np.ones((2, 1)), np.ones((20, 1, 2)),
    np.eye(1), np.eye(1), np.eye(2),
)  # fmt: skip
posed = lti.StateModel(
    state.a, np.ones((2, 3)), np.ones((3, 2)), np.array([[0, 0, 0.0], [0, 0, 1.0], [0, 1.0, 0]])
)
regular = lti.GeneralisedPlant(posed, 2, 2)
isolator = m.Isolator(
    np.array([[10.0]]), np.array([[20.0]]), np.array([[4e4]]), np.eye(1), 900.0, 1e-3, 1e-5, 1e-5
)
lines_hz = np.linspace(0.5, 125.0, 250)
ground = m.binned(lines_hz, np.full((250, 1, 1), 1e-6), 60.0, "record.csv")
feedforward = m.FeedforwardLoop(1000.0, 200.0, 1.0, 100.0, c.NoiseShaping(4.0, 60.0, 3), isolator)

# Name to (callable, good arguments by name).
CATALOGUE: dict = {
    "Record": (signals.Record, fields(record)),
    "Spectrum": (signals.Spectrum, {"frequencies_hz": np.arange(5.0), "density": np.ones((1, 5)), "averages": 3}),
    "estimate_response": (signals.estimate_response, {"inputs": rows[:1], "outputs": rows[1:], "sample_rate": 100.0, "resolution_hz": 10.0}),
    "estimate_spectrum": (signals.estimate_spectrum, {"signals": rows, "sample_rate": 100.0, "resolution_hz": 10.0}),
    "load_record": (signals.load_record, {"path": "missing.csv", "unit": "m", "sample_rate": 100.0, "channels": ["a"]}),
    "moving": (signals.moving, {"error": signal, "sample_time": 0.1, "exposure": 1.0}),
    "ModalModel": (lti.ModalModel, fields(model)),
    "ModalModel.frequency_response": (model.frequency_response, {"omega": omega}),
    "ModalModel.at": (model.at, {"inputs": [0], "outputs": [0]}),
    "ModalModel.moved": (model.moved, {"frequencies": model.frequencies}),
    "ModalModel.modes": (model.modes, {"chosen": [0, 1]}),
    "ModalModel.state_space": (model.state_space, {}),
    "lti.StateModel": (lti.StateModel, fields(state)),
    "StateModel.frequency_response": (state.frequency_response, {"omega": omega}),
    "StateModel.__call__": (state.__call__, {"s": 1j * omega}),
    "StateModel.zeros": (lambda **named: lti.StateModel(**named).zeros, fields(state)),
    "ModalModel.compliance": (lambda **named: lti.ModalModel(**named).compliance(), fields(model)),
    "StateModel.select": (state.select, {"inputs": [0], "outputs": [0]}),
    "from_control": (lti.from_control, {"system": state}),
    "h2_norm": (lti.h2_norm, {"model": state}),
    "hinf_norm": (lti.hinf_norm, {"model": state}),
    "minimal_realisation": (lti.minimal_realisation, {"model": state, "tolerance": 1e-10}),
    "interconnect": (lti.interconnect, {"models": [state], **joined, "direct": np.zeros((1, 1))}),
    "modal_model": (lti.modal_model, {"mass": np.eye(2), "stiffness": np.array([[2.0, -1], [-1, 2]]), "input_map": np.ones((2, 1)), "output_map": np.ones((1, 2)), "damping_ratio": 0.01}),
    "modal_model, damped": (lti.modal_model, {"mass": np.eye(2), "stiffness": np.array([[2.0, -1], [-1, 2]]), "input_map": np.ones((2, 1)), "output_map": np.ones((1, 2)), "damping_matrix": 0.1 * np.eye(2)}),
    "resonance_grid": (lti.resonance_grid, {"poles": model.poles, "low_hz": 1.0, "high_hz": 100.0, "points": 20, "around": 3}),
    "lti.simulate": (lti.simulate, {"model": sampled, "inputs": signal[None], "initial": np.zeros(2)}),
    "truncate": (lti.truncate, {"model": model, "modes": 2, "compensated": 1}),
    "zoh": (lti.zoh, {"model": state, "sample_time": 0.01}),
    "build_machine": (i.build_machine, {"file": None, "modes_hz": [50.0], "fit_hz": (10.0, 200.0)}),
    "fir_regressors": (i.fir_regressors, {"signal": signal, "taps": 3}),
    "stabilisation": (i.stabilisation, {"omega": measured.omega, "response": measured.response[:, None, None]}),
    "identify_modes": (i.identify_modes, {"measured": measured, "band_hz": (10.0, 200.0), "guesses_hz": [48.0, 143.0]}),
    "fit_modes": (i.fit_modes, {"measured": measured, "guesses_hz": [48.0, 143.0], "band_hz": (10.0, 200.0)}),
    "require_explained": (m.require_explained, {"path": "missing.csv", "file": None, "machine": None, "fit_hz": (10.0, 200.0), "options": {}}),
    "load_machine": (i.load_machine, {"file": "missing.csv", "response_unit": "m/s^2", "force_unit": "N", "sample_rate": 100.0, "response": "", "damping_ratio": 0.005}),
    "ExtendedKalman": (e.ExtendedKalman, fields(e.ExtendedKalman(plant))),
    "FeLms": (e.FeLms, fields(e.FeLms())),
    "FeRls": (e.FeRls, fields(e.FeRls(np.eye(3)))),
    "FeRls.start": (e.FeRls(1.0).start, {"regressors": 3}),
    "LowPass": (e.LowPass, fields(e.LowPass())),
    "MovingWindow": (e.MovingWindow, fields(e.MovingWindow())),
    "NoiseIntensities": (e.NoiseIntensities, fields(e.NoiseIntensities(1.0, 1.0))),
    "Observer": (e.Observer, fields(observer)),
    "Plant": (e.Plant, fields(plant)),
    "SavitzkyGolay": (e.SavitzkyGolay, fields(e.SavitzkyGolay())),
    "SigmaPoints": (e.SigmaPoints, fields(e.SigmaPoints())),
    "AdaptationStepper": (e.AdaptationStepper, {"settings": e.FeLms(), "weights": np.zeros((1, 3))}),
    "AdaptationStepper.update": (lambda regressor, error: e.AdaptationStepper(e.FeRls(1.0), np.zeros((1, 3))).update(regressor, error), {"regressor": rows[:, 0], "error": np.ones(1)}),
    "UnscentedKalman": (e.UnscentedKalman, fields(e.UnscentedKalman(plant))),
    "UnscentedKalman.step": (e.UnscentedKalman(plant).step, {"state": e.UnscentedKalman(plant).start(0.1), "measured": 0.1, "force": 1.0, "sample_time": 1e-3}),
    "adapt": (e.adapt, {**lines, "errors": signal[None], "weights": np.zeros((1, 3))}),
    "identify": (e.identify, {**lines, "disturbance": signal[None], "weights": np.zeros((1, 3))}),
    "identify, FeLms": (e.identify, {**lines, "settings": e.FeLms(), "disturbance": signal[None]}),
    "filter_signal": (e.filter_signal, {"signal_filter": e.MovingWindow(), "measured": signal, "sample_time": 1e-3, "start_velocity": 0.1}),
    "filter_signal, Kalman": (e.filter_signal, {"signal_filter": e.UnscentedKalman(plant), "measured": signal, "force": signal, "sample_time": 1e-3}),
    "filter_signal, extended": (e.filter_signal, {"signal_filter": e.ExtendedKalman(plant), "measured": signal, "force": signal, "sample_time": 1e-3}),
    "kalman_observer": (e.kalman_observer, {"model": model, "noise": e.NoiseIntensities(1.0, 1e-12), "noise_model": 1.0}),
    "min_max_solve": (e.min_max_solve, block),
    "LeastMeanSquares": (lambda X, y, **named: e.LeastMeanSquares(**named).fit(X, y).coef_, {"X": rows.T, "y": signal, **fields(e.LeastMeanSquares())}),
    "RecursiveLeastSquares": (lambda X, y, **named: e.RecursiveLeastSquares(**named).fit(X, y).coef_, {"X": rows.T, "y": signal, **fields(e.RecursiveLeastSquares(forgetting=0.9))}),
    "MinMaxRegressor": (lambda X, y, sample_weight, **named: e.MinMaxRegressor(**named).fit(X, y, sample_weight).coef_, {"X": rows.T, "y": signal, "sample_weight": np.ones(60), **fields(e.MinMaxRegressor(0.1))}),
    "RecursiveRegressor.predict": (lambda X: e.LeastMeanSquares().fit(rows.T, signal).predict(X), {"X": rows.T}),
    "RecursiveRegressor.score": (lambda X, y, sample_weight: e.RecursiveLeastSquares().fit(rows.T, signal).score(X, y, sample_weight), {"X": rows.T, "y": signal, "sample_weight": np.ones(60)}),
    "WeightedRegressor.partial_fit": (lambda X, y, sample_weight: e.RecursiveLeastSquares().partial_fit(rows.T, signal).partial_fit(X, y, sample_weight).coef_, {"X": rows.T, "y": signal, "sample_weight": np.ones(60)}),
    "UnweightedRegressor.partial_fit": (lambda X, y: e.LeastMeanSquares().partial_fit(rows.T, signal).partial_fit(X, y).coef_, {"X": rows.T, "y": signal}),
    "track": (e.track, {"regressors": rows, "outputs": signal, "forgetting": 0.9, "bound": 0.1, "iterations": 1}),
    "track, ridge": (e.track, {"regressors": rows, "outputs": signal, "penalty": 0.1}),
    "track, least squares": (e.track, {"regressors": rows, "outputs": signal, "initial_covariance": 10.0, "growth_limit": 1e6, "silent": True}),
    "tustin": (lti.tustin, {"model": state, "sample_time": 1e-2, "omega": 3.0}),
    "TimeVaryingModel": (TimeVaryingModel, fields(walk)),
    "GeneralisedPlant": (lti.GeneralisedPlant, fields(regular)),
    "prove_gain": (lti.prove_gain, {"model": regular.model, "uncertain": 1, "level": 9.0}),
    "uncertain_channel": (c.uncertain_channel, {"plant": single, "compensator": None, "controller": c.PidFamily(10.0)(20.0).state_space(), "source": "u_ff", "target": "u", "frequency": 0.05, "damping": 0.1, "gain": 0.1}),
    "GeneralisedPlant.close": (regular.close, {"controller": state}),
    "H2Synthesis": (e.H2Synthesis, fields(e.h2_riccati(regular, 0.1, 0.1))),
    "h2_riccati": (e.h2_riccati, {"plant": regular, "effort": 0.1, "noise": 0.1}),
    "h2_riccati, model": (lambda **named: e.h2_riccati(lti.GeneralisedPlant(lti.StateModel(**named), 2, 2)), fields(posed)),
    "h2_riccati, discrete": (lambda **named: e.h2_riccati(lti.GeneralisedPlant(lti.StateModel(**named), 2, 2)), {**fields(posed), "a": 0.5 * posed.a / np.abs(posed.poles).max(), "sample_time": 0.1}),
    "Application": (c.Application, fields(c.Application(True, 0.1, selectivity=2.0, high_pass_hz=1.0))),
    "DigitalController": (c.DigitalController, fields(digital)),
    "DigitalController.run": (digital.run, {"inputs": signal[None], "first": np.ones(1)}),
    "least_squares_code": (m.least_squares_code, {"estimator": e.RecursiveLeastSquares(), "features": 2, "outputs": 1, "name": "rls", "precision": "single"}),
    "adaptation_code": (m.adaptation_code, {"settings": e.FeRls(1.0), "actuators": 1, "regressors": 2, "name": "feed", "precision": "single"}),
    "controller_code": (m.controller_code, {"controller": digital, "name": "loop", "precision": "single"}),
    "load_controller": (c.load_controller, {"file": "missing.json"}),
    "Controller": (c.Controller, fields(controller)),
    "Mechanism": (c.Mechanism, fields(arm)),
    "Mechanism.force": (arm.force, {"position": np.zeros(2), "velocity": np.zeros(2), "acceleration": np.ones(2)}),
    "Decoupling": (c.Decoupling, fields(decoupling)),
    "DiscreteObserver": (c.DiscreteObserver, fields(sampled_observer)),
    "DisturbanceObserver": (c.DisturbanceObserver, fields(c.DisturbanceObserver(0.1))),
    "error_driven": (c.error_driven, {"controller": c.DigitalController(doubled, ("r (m)", "y (m)"), ("f (N)",)), "motion": c.Motion(c.Feedforward(1.0), 0.01, limits)}),
    "Feedforward": (c.Feedforward, fields(c.Feedforward(1.0, 1.0, 1.0, 1.0))),
    "Feedforward.force": (c.Feedforward(1.0).force, {"setpoint": setpoint}),
    "FlowTransformation": (c.FlowTransformation, fields(c.FlowTransformation())),
    "KinematicDesign": (c.KinematicDesign, fields(c.KinematicDesign(10.0))),
    "KinematicDesign.gains": (lambda **named: c.KinematicDesign(**named).gains, fields(c.KinematicDesign(10.0))),
    "Notch": (c.Notch, fields(c.Notch(10.0))),
    "PeakConstraint": (c.PeakConstraint, {"function": "input_sensitivity", "limit": 2.0}),
    "Pid": (c.Pid, fields(pid(10.0))),
    "PidFamily": (c.PidFamily, fields(c.PidFamily(11.0, (100.0,)))),
    "PidFamily.__call__": (pid, {"bandwidth_hz": 10.0}),
    "RobustTransformation": (c.RobustTransformation, fields(c.RobustTransformation())),
    "Setpoint": (c.Setpoint, fields(setpoint)),
    "Trajectory": (c.Trajectory, fields(trajectory)),
    "asin_trajectory": (c.asin_trajectory, {"amplitude": 1.0, "sharpness": 0.9, "frequency_hz": 2.0, "duration": 0.1, "sample_time": 1e-3}),
    "closed_loop": (c.closed_loop, {"plant": model, "compensator": None, "controller": pid(10.0).state_space()}),
    "compensator": (c.compensator, {"observer": observer, "application": c.Application(True, 0.1)}),
    "damping_gain": (c.damping_gain, {"model": model, "increase": np.array([0.1, 0.1]), "selection": "each mode"}),
    "damping_gain, placed": (c.damping_gain, {"model": model, "increase": 0.1, "selection": "pole placement"}),
    "decouple": (c.decouple, {"model": broad, "actuated": [0, 1], "sensed": [0, 1]}),
    "error_loop": (c.error_loop, {"loop": loop}),
    "fit_feedforward": (c.fit_feedforward, {"loop": c.error_loop(loop), "setpoint": setpoint}),
    "inverse_gains": (c.inverse_gains, {"model": model}),
    "loop_margins": (m.loop_margins, {"loop": search, "pid": pid(20.0)}),
    "make_loop": (c.make_loop, {"plant": model, "low_hz": 1.0, "high_hz": 1000.0, "points": 30, "around": 2}),
    "maximise_bandwidth": (c.maximise_bandwidth, {"loops": [search], "family": pid, "constraints": [c.PeakConstraint("input_sensitivity")], "low_hz": 5.0, "high_hz": 100.0, "scan": 10, "tolerance_hz": 0.5}),
    "Network": (c.Network, fields(network)),
    "Network.paths": (network.paths, {"frequencies_hz": np.array([1.0, 2.0])}),
    "Source": (c.Source, fields(source)),
    "error_budget": (c.error_budget, {"network": network, "sources": [source], "band_hz": (0.1, 100.0)}),
    "tone_response": (c.tone_response, {"network": network, "source": source, "time": np.array([0.0, 0.1]), "band_hz": (0.1, 100.0)}),
    "FloorMachine": (c.FloorMachine, fields(afloat)),
    "Uncertainty": (c.Uncertainty, {"frequency": 0.05, "residue": 0.1, "damping": 0.2, "gain": 0.05, "mass": 0.02, "delay": 1e-5}),
    "Motion": (c.Motion, {"feedforward": c.Feedforward(1.0), "lag": 0.01, "limits": limits}),
    "MoveLimits": (c.MoveLimits, fields(limits)),
    "point_to_point": (c.point_to_point, {"snap": 1e4, "jerk": 100.0, "acceleration": 2.0, "velocity": 0.1, "cruise": 0.02, "settling": 0.005, "sample_time": 1e-3}),
    "control.simulate": (c.simulate, {"plant": plant, "controller": controller, "trajectory": trajectory, "noise": 1e-6 * noise(100), "resolution": 1e-6, "grid": 0.1, "start": (0.0, 0.0), "bound": 10.0, "force_limit": 50.0}),
    "simulate_mechanism": (c.simulate_mechanism, {"plant": arm, "controller": arms, "trajectories": [trajectory] * 2, "noise": 1e-6 * np.array([noise(100), noise(100)]), "resolution": 1e-6, "grid": 0.1, "start": np.zeros((2, 2)), "bound": 10.0, "force_limits": [50.0, 50.0]}),
    "SlotineLi": (c.SlotineLi, fields(adaptive)),
    "simulate_adaptive": (c.simulate_adaptive, {"plant": arm, "law": adaptive, "trajectories": [trajectory] * 2, "noise": 1e-6 * np.array([noise(100), noise(100)]), "start": np.zeros((2, 2)), "bound": 10.0, "disturbance": np.ones((2, 100)), "change": (0.05, np.array([3.0]))}),
    "Mismatch": (m.Mismatch, fields(m.Mismatch(lines_hz, np.full(250, 1e-6)))),
    "FeedforwardLoop": (m.FeedforwardLoop, fields(feedforward)),
    "Isolator": (m.Isolator, fields(isolator)),
    "FloorSpectra": (m.FloorSpectra, fields(ground)),
    "tracking_error": (c.tracking_error, {"loop": c.error_loop(loop), "setpoint": setpoint, "feedforward": c.Feedforward(1.0)}),
}  # fmt: skip


def missing() -> list[str]:
    """Names of the public API without a call."""
    written = {each.split(",")[0] for each in CATALOGUE} | RESULTS
    return [
        f"{folder}.{name}"
        for folder, package in PACKAGES.items()
        for name in package.__all__
        if not {name, f"{name}.fit", f"{folder}.{name}"} & written
    ]
