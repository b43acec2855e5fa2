"""A good call of every function and class of the toolbox's public API, and of much beside it, for property tests."""

import dataclasses
import pkgutil
from functools import cache
from importlib import import_module
from types import ModuleType, SimpleNamespace

import numpy as np

from stillwork import control, estimation, identification, lti, machine, signals
from stillwork.estimation import robust
from stillwork.estimation.hinfinity import hinfinity_gains, smallest_level
from stillwork.estimation.time_varying import TimeVaryingModel, estimate
from stillwork.lti.discretisation import zoh_response

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
    "GainProof", "MinimalRealisation", "Margins", "CancellationWarning",
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


@cache
def catalogue() -> dict:
    """Name to (callable, good arguments by name)."""
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
        lti.ModalModel(
            np.zeros(1), np.zeros(1), np.full((1, 1), 0.5), np.full((1, 1), 0.5), np.zeros((1, 1))
        ),
        c.PidFamily(4.0)(50.0),
    )
    digital = c.DigitalController(sampled, ("e (m)",), ("f (N)",), [-1.0], [1.0], np.zeros((2, 1)), 1)
    doubled = lti.StateModel(
        np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.array([[2.0, -2.0]]), 0.01
    )
    single = lti.ModalModel(
        np.array([0.0, 600.0]),
        np.array([0.0, 0.01]),
        np.full((2, 1), 0.3),
        np.array([[0.3, -0.3]]),
        np.zeros((1, 1)),
    )
    phased = i.PhasedModel(single, np.array([0.0, 1e-4]))
    lone = c.make_loop(single, points=50, around=3)
    place = c.Perturbation(np.array([1.0, 1.05]), np.ones(2), np.ones(2))
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
    near = c.linear_loop(plant, controller, 1e-3)
    setpoint = c.point_to_point(1e4, 100.0, 2.0, 0.1, 0.02, 0.005, 1e-3)
    pid = c.PidFamily(11.0)
    loop = c.closed_loop(model, None, pid(10.0).state_space())
    search = c.make_loop(model, points=50, around=3)
    damping = c.damping_gain(model, 0.01)
    wide = c.damping_gain(broad, 0.05)
    decoupling = c.decouple(broad)
    rows, signal = noise((3, 60)), noise(60)
    omega = np.linspace(50.0, 1500.0, 120)
    record = signals.Record(noise((2, 600)), 100.0, "m", ("a", "b"), "record.csv")
    accelerance = (-(omega**2) * model.frequency_response(omega)[0, 0]).astype(complex)
    measured = i.Identified(omega, accelerance, np.ones(len(omega)))
    pair = {"a": state.a, "noise_input": np.eye(2), "c": state.c, "process": 1.0, "sensor": 1.0}
    joined = {"feedback": np.zeros((1, 1)), "inputs": np.eye(1), "outputs": np.eye(1)}
    lines = {"settings": e.FeRls(1.0), "regressors": rows, "every": 10}
    block = {"matrix": rows.T, "target": signal, "bound": 0.1}

    def fields(value):
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}

    walk = TimeVaryingModel(
        np.array([[0.9, 0.1], [0.0, 0.8]]), np.ones((2, 1)), np.ones((2, 1)), np.ones((20, 1, 2)),
        np.eye(1), np.eye(1), np.eye(2),
    )  # fmt: skip
    matrices = fields(walk)
    gains = robust.kalman_gains(walk)
    uncertain = {
        "m": np.ones((20, 1, 1)),
        "e_a": 0.1 * np.eye(2),
        "e_b": np.zeros((2, 1)),
        "e_g": np.zeros((2, 1)),
    }
    bound = robust.NormBound(**uncertain)
    slopes = robust.Derivatives(
        np.eye(2)[None], np.ones((1, 2, 1)), np.ones((1, 2, 1)), np.zeros((20, 1, 1, 2))
    )
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

    def isolator_paths(f):
        return isolator.paths(f, 1e-3)

    mismatch = m.Mismatch(lines_hz, np.full(250, 1e-6))
    isolated = m.try_loop(feedforward, isolator, isolator_paths, ground, "FeRls", 0.1, mismatch)
    two = {"u": rows[:1, :20], "y": rows[1:2, :20]}
    impulse = {"force": noise((2, 128)), "response": noise((2, 128)), "rate": 100.0}
    return {
        "Record": (signals.Record, fields(record)),
        "Spectrum": (signals.Spectrum, {"frequencies_hz": np.arange(5.0), "density": np.ones((1, 5)), "averages": 3}),
        "Spectrum.power": (signals.estimate_spectrum(signal, 100.0, 10.0).power, {"low_hz": 10.0, "high_hz": 30.0}),
        "estimate_response": (signals.estimate_response, {"inputs": rows[:1], "outputs": rows[1:], "sample_rate": 100.0, "resolution_hz": 10.0}),
        "estimate_spectrum": (signals.estimate_spectrum, {"signals": rows, "sample_rate": 100.0, "resolution_hz": 10.0}),
        "load_record": (signals.load_record, {"path": "missing.csv", "unit": "m", "sample_rate": 100.0, "channels": ["a"]}),
        "moving": (signals.moving, {"error": signal, "sample_time": 0.1, "exposure": 1.0}),
        "resample": (signals.resample, {"record": record, "sample_rate": 50.0}),
        "rms": (signals.rms, {"error": signal}),
        "PhasedModel": (i.PhasedModel, {"model": single, "velocity": np.array([0.0, 1e-4])}),
        "PhasedModel.mirrored": (phased.mirrored, {}),
        "PhasedModel.velocity_response": (phased.velocity_response, {"moved": single, "velocity": phased.velocity, "omega": omega, "sample_time": 1e-3, "delay": 0.5}),
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
        "margins": (control.margins, {"loop": state}),
        "interconnect": (lti.interconnect, {"models": [state], **joined, "direct": np.zeros((1, 1))}),
        "modal_model": (lti.modal_model, {"mass": np.eye(2), "stiffness": np.array([[2.0, -1], [-1, 2]]), "input_map": np.ones((2, 1)), "output_map": np.ones((1, 2)), "damping_ratio": 0.01}),
        "modal_model, damped": (lti.modal_model, {"mass": np.eye(2), "stiffness": np.array([[2.0, -1], [-1, 2]]), "input_map": np.ones((2, 1)), "output_map": np.ones((1, 2)), "damping_matrix": 0.1 * np.eye(2)}),
        "refine_peak": (lti.refine_peak, {"response": np.sin, "omega": np.linspace(0, 3, 20), "magnitude": np.sin(np.linspace(0, 3, 20)), "near": 0.7}),
        "resonance_grid": (lti.resonance_grid, {"poles": model.poles, "low_hz": 1.0, "high_hz": 100.0, "points": 20, "around": 3}),
        "roll_off": (lti.roll_off, {"model": model, "cutoff_hz": 1000.0}),
        "lti.simulate": (lti.simulate, {"model": sampled, "inputs": signal[None], "initial": np.zeros(2)}),
        "truncate": (lti.truncate, {"model": model, "modes": 2, "compensated": 1}),
        "zoh": (lti.zoh, {"model": state, "sample_time": 0.01}),
        "zoh_modes": (lti.zoh_modes, {"model": model, "sample_time": 1e-4}),
        "remove_delay": (i.remove_delay, {"machine": i.Machine((model,), 10.0, "x"), "delay": 1e-4}),
        "build_machine": (i.build_machine, {"file": None, "modes_hz": [50.0], "fit_hz": (10.0, 200.0), "mirrored_sensor": True}),
        "exponential_bound": (i.exponential_bound, {"row": 1.0, "forgetting": 0.9, "samples": 10}),
        "fir_regressors": (i.fir_regressors, {"signal": signal, "taps": 3}),
        "complex_frequency_poles": (i.complex_frequency_poles, {"omega": measured.omega, "response": measured.response[:, None, None], "weight": np.ones(len(measured.omega)), "order": 4}),
        "stabilisation": (i.stabilisation, {"omega": measured.omega, "response": measured.response[:, None, None]}),
        "Stabilisation.settled": (i.stabilisation(measured.omega, measured.response[:, None, None]).settled, {}),
        "identify_modes": (i.identify_modes, {"measured": measured, "band_hz": (10.0, 200.0), "guesses_hz": [48.0, 143.0]}),
        "fit_modes": (i.fit_modes, {"measured": measured, "guesses_hz": [48.0, 143.0], "band_hz": (10.0, 200.0)}),
        "impact_response": (i.impact_response, impulse),
        "require_explained": (m.require_explained, {"path": "missing.csv", "file": None, "machine": None, "fit_hz": (10.0, 200.0), "options": {}}),
        "load_machine": (i.load_machine, {"file": "missing.csv", "response_unit": "m/s^2", "force_unit": "N", "sample_rate": 100.0, "response": "", "damping_ratio": 0.005}),
        "coloured_noise_bound": (i.coloured_noise_bound, {"noise": signals.estimate_spectrum(signal, 10.0, 1.0), "taps": 3, "forgetting": 0.9, "coverage": 0.9, "draws": 5, "seed": 1}),
        "noise_bound": (i.noise_bound, {"deviation": 1.0, "unknowns": 3, "forgetting": 0.9}),
        "ExtendedKalman": (e.ExtendedKalman, fields(e.ExtendedKalman(plant))),
        "FeLms": (e.FeLms, fields(e.FeLms())),
        "FeRls": (e.FeRls, fields(e.FeRls(np.eye(3)))),
        "FeRls.start": (e.FeRls(1.0).start, {"regressors": 3}),
        "LowPass": (e.LowPass, fields(e.LowPass())),
        "MovingWindow": (e.MovingWindow, fields(e.MovingWindow())),
        "NoiseIntensities": (e.NoiseIntensities, fields(e.NoiseIntensities(1.0, 1.0))),
        "Observer": (e.Observer, fields(observer)),
        "Observer.read": (observer.read, {"flexible": np.eye(2), "quantity": "velocity"}),
        "Observer.estimator": (observer.estimator, {"rows": np.eye(6)}),
        "Plant": (e.Plant, fields(plant)),
        "SavitzkyGolay": (e.SavitzkyGolay, fields(e.SavitzkyGolay())),
        "SavitzkyGolay.packed": (lambda **named: e.SavitzkyGolay(**named).packed(), fields(e.SavitzkyGolay())),
        "SecularFunction": (e.SecularFunction, {"eigenvalues": np.array([2.0, 1.0]), "coefficients": np.ones(2), "excess": 1.0, "bound": 0.1}),
        "SecularFunction.slope": (e.secular_function(**block).slope, {"alpha": 0.3}),
        "SecularFunction.iterates": (e.secular_function(**block).iterates, {"start": 0.3, "steps": 4}),
        "SecularFunction.root": (e.secular_function(**block).root, {"start": 0.3}),
        "SigmaPoints": (e.SigmaPoints, fields(e.SigmaPoints())),
        "SigmaPoints.weights": (lambda **named: e.SigmaPoints(**named).weights(2), fields(e.SigmaPoints())),
        "AdaptationStepper": (e.AdaptationStepper, {"settings": e.FeLms(), "weights": np.zeros((1, 3))}),
        "AdaptationStepper.update": (lambda regressor, error: e.AdaptationStepper(e.FeRls(1.0), np.zeros((1, 3))).update(regressor, error), {"regressor": rows[:, 0], "error": np.ones(1)}),
        "UnscentedKalman": (e.UnscentedKalman, fields(e.UnscentedKalman(plant))),
        "AdaptationStepper.skip": (lambda regressor: e.AdaptationStepper(e.FeRls(1.0), np.zeros((1, 3))).skip(regressor), {"regressor": rows[:, 0]}),
        "UnscentedKalman.step": (e.UnscentedKalman(plant).step, {"state": e.UnscentedKalman(plant).start(0.1), "measured": 0.1, "force": 1.0, "sample_time": 1e-3}),
        "adapt": (e.adapt, {**lines, "errors": signal[None], "weights": np.zeros((1, 3))}),
        "identify": (e.identify, {**lines, "disturbance": signal[None], "weights": np.zeros((1, 3))}),
        "identify, FeLms": (e.identify, {**lines, "settings": e.FeLms(), "disturbance": signal[None]}),
        "continuous_gain": (e.continuous_gain, pair),
        "discrete_gain": (e.discrete_gain, {**pair, "a": 0.1 * state.a}),
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
        "secular_function": (e.secular_function, block),
        "worst_case_residuals": (e.worst_case_residuals, {"regressors": rows, "outputs": signal, "estimates": rows, "bounds": np.ones(60), "forgetting": 0.9}),
        "tustin": (lti.tustin, {"model": state, "sample_time": 1e-2, "omega": 3.0}),
        "zoh_response": (zoh_response, {"model": model, "sample_time": 1e-4, "omega": omega}),
        "TimeVaryingModel": (TimeVaryingModel, matrices),
        "kalman_gains": (lambda **named: robust.kalman_gains(TimeVaryingModel(**named)), matrices),
        "sensitivity_gains": (robust.sensitivity_gains, {"model": walk, "derivatives": slopes, "weight": 0.5}),
        "regularised_gains": (robust.regularised_gains, {"model": walk, "bound": bound, "margin": 1.0}),
        "regularised_gains, bound": (lambda **named: robust.regularised_gains(walk, robust.NormBound(**named)), uncertain),
        "estimate": (estimate, {"gains": gains, **two, "initial": np.zeros(2)}),
        "hinfinity_gains": (hinfinity_gains, {"model": walk, "wanted": np.eye(2), "level": 9.0}),
        "smallest_level": (smallest_level, {"model": walk, "wanted": np.eye(2), "tolerance": 1e-2}),
        "smallest_level, model": (lambda **named: smallest_level(TimeVaryingModel(**named), np.eye(2)), matrices),
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
        "Decoupling.apply": (decoupling.apply, {"model": broad}),
        "DiscreteObserver": (c.DiscreteObserver, fields(sampled_observer)),
        "DiscreteObserver.estimator": (sampled_observer.estimator, {"rows": np.eye(6), "form": "predictor", "delay": 1}),
        "DiscreteObserver.read": (sampled_observer.read, {"flexible": np.eye(2), "quantity": "velocity"}),
        "DisturbanceObserver": (c.DisturbanceObserver, fields(c.DisturbanceObserver(0.1))),
        "error_driven": (c.error_driven, {"controller": c.DigitalController(doubled, ("r (m)", "y (m)"), ("f (N)",)), "motion": c.Motion(c.Feedforward(1.0), 0.01, limits)}),
        "Feedforward": (c.Feedforward, fields(c.Feedforward(1.0, 1.0, 1.0, 1.0))),
        "Feedforward.force": (c.Feedforward(1.0).force, {"setpoint": setpoint}),
        "FlowTransformation": (c.FlowTransformation, fields(c.FlowTransformation())),
        "JointKalman": (c.JointKalman, fields(c.JointKalman(arm))),
        "JointKalman.packed": (lambda **named: c.JointKalman(**named).packed(), fields(c.JointKalman(arm))),
        "KinematicDesign": (c.KinematicDesign, fields(c.KinematicDesign(10.0))),
        "KinematicDesign.gains": (lambda **named: c.KinematicDesign(**named).gains, fields(c.KinematicDesign(10.0))),
        "Loop.at": (search.at, {"controller": pid(10.0), "omega": omega}),
        "Loop.peak": (search.peak, {"controller": pid(10.0), "function": "input_sensitivity"}),
        "Loop.poles": (search.poles, {"controller": pid(10.0)}),
        "Loop.crossing_hz": (search.crossing_hz, {"controller": pid(10.0)}),
        "Notch": (c.Notch, fields(c.Notch(10.0))),
        "PeakConstraint": (c.PeakConstraint, {"function": "input_sensitivity", "limit": 2.0}),
        "Pid": (c.Pid, fields(pid(10.0))),
        "Pid.frequency_response": (pid(10.0).frequency_response, {"omega": omega}),
        "Pid.state_space": (lambda **named: c.Pid(**named).state_space(), fields(c.Pid(1.0, 2.0, 3.0, 100.0, 0.7, (c.Notch(50.0),)))),
        "PidFamily": (c.PidFamily, fields(c.PidFamily(11.0, (100.0,)))),
        "PidFamily.__call__": (pid, {"bandwidth_hz": 10.0}),
        "RobustTransformation": (c.RobustTransformation, fields(c.RobustTransformation())),
        "Setpoint": (c.Setpoint, fields(setpoint)),
        "Trajectory": (c.Trajectory, fields(trajectory)),
        "asin_trajectory": (c.asin_trajectory, {"amplitude": 1.0, "sharpness": 0.9, "frequency_hz": 2.0, "duration": 0.1, "sample_time": 1e-3}),
        "band_pass": (c.band_pass, {"omega": 10.0, "selectivity": 2.0}),
        "channel": (c.channel, {"loop": loop, "source": "r", "target": "e_true", "inputs": 1, "outputs": 1}),
        "closed_loop": (c.closed_loop, {"plant": model, "compensator": None, "controller": pid(10.0).state_space()}),
        "compensator": (c.compensator, {"observer": observer, "application": c.Application(True, 0.1)}),
        "contraction_range": (c.contraction_range, {"response_gain": 1.0}),
        "crossings": (c.crossings, {"loop": near, "points": 20}),
        "damping_gain": (c.damping_gain, {"model": model, "increase": np.array([0.1, 0.1]), "selection": "each mode"}),
        "damping_gain, placed": (c.damping_gain, {"model": model, "increase": 0.1, "selection": "pole placement"}),
        "decouple": (c.decouple, {"model": broad, "actuated": [0, 1], "sensed": [0, 1]}),
        "decoupled_plant": (c.decoupled_plant, {"plant": broad, "decoupling": decoupling, "gain": wide}),
        "deform": (c.deform, {"transformation": c.FlowTransformation(), "previous": 1.0, "response": 1.0, "desired": 2.0}),
        "describing_function": (c.describing_function, {"amplitude": 1.0}),
        "discrete_compensator": (c.discrete_compensator, {"observer": sampled_observer, "application": c.Application(True, 0.1), "form": "predictor", "delay": 1}),
        "discrete_damping_gain": (c.discrete_damping_gain, {"model": model, "increase": np.array([0.1, 0.1]), "sample_time": 1e-4}),
        "discrete_kalman_observer": (c.discrete_kalman_observer, {"model": model, "noise": e.NoiseIntensities(1.0, 1e-12), "sample_time": 1e-4, "noise_model": 1.0}),
        "error_loop": (c.error_loop, {"loop": loop}),
        "fed_back": (c.fed_back, {"model": model, "gain": damping}),
        "fit_feedforward": (c.fit_feedforward, {"loop": c.error_loop(loop), "setpoint": setpoint, "basis": ("acceleration",)}),
        "inverse_gains": (c.inverse_gains, {"model": model}),
        "iterate": (c.iterate, {"transformation": c.FlowTransformation(), "desired": 1.0, "steps": 5, "response_gain": 1.0, "response_offset": 0.1, "start": 0.5}),
        "iterate, robust": (c.iterate, {"transformation": c.RobustTransformation(), "desired": 1.0, "steps": 5}),
        "limit_cycles": (c.limit_cycles, {"loop": near, "transformation": c.FlowTransformation(), "region": None}),
        "linear_filter": (c.linear_filter, {"signal_filter": e.UnscentedKalman(plant), "sample_time": 1e-3, "position": 0.1, "velocity": 0.1}),
        "linear_filter, window": (c.linear_filter, {"signal_filter": e.MovingWindow(), "sample_time": 1e-3}),
        "linear_filter, extended": (c.linear_filter, {"signal_filter": e.ExtendedKalman(plant), "sample_time": 1e-3}),
        "linear_loop": (c.linear_loop, {"plant": plant, "controller": controller, "sample_time": 1e-3, "position": 0.1, "velocity": 0.1}),
        "loop_margins": (m.loop_margins, {"loop": search, "pid": pid(20.0)}),
        "phased_loop": (c.phased_loop, {"loop": lone, "phased": phased, "place": place}),
        "phased_loops": (c.phased_loops, {"loops": (lone,), "phased": phased, "mirrors": (False,), "places": (place,)}),
        "make_loop": (c.make_loop, {"plant": model, "low_hz": 1.0, "high_hz": 1000.0, "points": 30, "around": 2}),
        "maximise_bandwidth": (c.maximise_bandwidth, {"loops": [search], "family": pid, "constraints": [c.PeakConstraint("input_sensitivity")], "low_hz": 5.0, "high_hz": 100.0, "scan": 10, "tolerance_hz": 0.5}),
        "Network": (c.Network, fields(network)),
        "Network.paths": (network.paths, {"frequencies_hz": np.array([1.0, 2.0])}),
        "Source": (c.Source, fields(source)),
        "error_budget": (c.error_budget, {"network": network, "sources": [source], "band_hz": (0.1, 100.0)}),
        "tone_response": (c.tone_response, {"network": network, "source": source, "time": np.array([0.0, 0.1]), "band_hz": (0.1, 100.0)}),
        "ErrorBudget.edges": (c.error_budget(network, [source], (0.1, 100.0)).edges, {}),
        "box_band": (c.box_band, {"rms": lambda place: 1.0, "places": tuple(c.box_places(c.Uncertainty(frequency=0.05), model, 2))}),
        "FloorMachine": (c.FloorMachine, fields(afloat)),
        "Uncertainty": (c.Uncertainty, {"frequency": 0.05, "residue": 0.1, "damping": 0.2, "gain": 0.05, "mass": 0.02, "delay": 1e-5}),
        "worst_place": (c.worst_place, {"loop": search, "controller": pid(20.0), "function": "true_tracking", "uncertainty": c.Uncertainty(frequency=0.05, gain=0.1)}),
        "Motion": (c.Motion, {"feedforward": c.Feedforward(1.0), "lag": 0.01, "limits": limits}),
        "MoveLimits": (c.MoveLimits, fields(limits)),
        "modified_feedforward": (c.modified_feedforward, {"compensator": c.compensator(observer, c.Application(True)), "controller": pid(10.0).state_space()}),
        "point_to_point": (c.point_to_point, {"snap": 1e4, "jerk": 100.0, "acceleration": 2.0, "velocity": 0.1, "cruise": 0.02, "settling": 0.005, "sample_time": 1e-3}),
        "random_gain": (c.random_gain, {"deviation": 1.0}),
        "record_trajectory": (c.record_trajectory, {"time": np.arange(20.0), "position": signal[:20], "sample_time": 0.1}),
        "response_gain": (c.response_gain, {"plant": plant, "model": guess}),
        "sampled_feedback": (c.sampled_feedback, {"model": model, "gain": damping, "sample_time": 1e-4, "delay": 1}),
        "control.simulate": (c.simulate, {"plant": plant, "controller": controller, "trajectory": trajectory, "noise": 1e-6 * noise(100), "resolution": 1e-6, "grid": 0.1, "start": (0.0, 0.0), "bound": 10.0, "force_limit": 50.0}),
        "simulate_mechanism": (c.simulate_mechanism, {"plant": arm, "controller": arms, "trajectories": [trajectory] * 2, "noise": 1e-6 * np.array([noise(100), noise(100)]), "resolution": 1e-6, "grid": 0.1, "start": np.zeros((2, 2)), "bound": 10.0, "force_limits": [50.0, 50.0]}),
        "sine_trajectory": (c.sine_trajectory, {"amplitude": 1.0, "frequency_hz": 2.0, "duration": 0.1, "sample_time": 1e-3}),
        "soft_sensor": (c.soft_sensor, {"observer": observer, "performance_shapes": np.ones((1, 3))}),
        "stable_range": (c.stable_range, {"loop": near}),
        "stiffness_gain": (c.stiffness_gain, {"model": model, "factor": np.array([1.5, 1.2])}),
        "strongest_oscillation": (c.strongest_oscillation, {"values": signal, "sample_time": 0.1}),
        "plan_move": (c.plan_move, {"distance": 0.1, "limits": limits, "start": 0.0}),
        "SlotineLi": (c.SlotineLi, fields(adaptive)),
        "regressor": (c.regressor, {"mechanism": arm, "position": np.zeros(2), "velocity": np.ones(2), "reference": np.ones(2), "acceleration": np.ones(2)}),
        "simulate_adaptive": (c.simulate_adaptive, {"plant": arm, "law": adaptive, "trajectories": [trajectory] * 2, "noise": 1e-6 * np.array([noise(100), noise(100)]), "start": np.zeros((2, 2)), "bound": 10.0, "disturbance": np.ones((2, 100)), "change": (0.05, np.array([3.0]))}),
        "isolation_code": (m.isolation_code, {"loop": feedforward, "settings": isolated.settings, "weights": isolated.steady.weights, "guard": isolated.guard, "limit": 50.0, "pause_s": 0.1, "name": "iso", "precision": "single"}),
        "Mismatch": (m.Mismatch, fields(mismatch)),
        "Mismatch.loop_gain": (mismatch.loop_gain, {"level": 3.0, "time_constant": 2.0}),
        "path_mismatch": (m.path_mismatch, {"paths": isolated.paths.seen}),
        "slow_level": (m.slow_level, {"paths": isolated.paths.seen, "floor": ground, "sensor_noise": 1e-5, "steady": isolated.steady}),
        "settling_time": (m.settling_time, {"design": isolated, "floor": ground}),
        "FeedforwardLoop": (m.FeedforwardLoop, fields(feedforward)),
        "FeedforwardLoop.responses": (feedforward.responses, dict(zip(("primary", "secondary", "frequencies_hz"), (*isolator_paths(lines_hz)[::2], lines_hz), strict=True))),
        "Isolator": (m.Isolator, fields(isolator)),
        "FloorSpectra": (m.FloorSpectra, fields(ground)),
        "binned": (m.binned, {"f": lines_hz, "density": np.full((250, 1, 1), 1e-6 + 0j), "duration": 60.0, "source": "record.csv", "bursts": (1.0, 1.0)}),
        "floor_spectra": (m.floor_spectra, {"acceleration": noise((1, 600)), "sample_rate": 100.0, "source": "record.csv", "resolution_hz": 1.0, "slow_hz": 0.2}),
        "choose_beta": (m.choose_beta, {"loop": feedforward, "floor": ground}),
        "try_loop": (m.try_loop, {"loop": feedforward, "isolator": isolator, "paths_of": isolator_paths, "floor": ground, "algorithm": "FeLms", "variance": 0.1, "mismatch": mismatch, "step": 1e-4}),
        "design_isolation": (lambda **named: m.design_isolation(**named)[0], {"isolator": isolator, "floor": ground, "rate": 1000.0, "band_hz": (4.0, 60.0), "notches": (), "algorithm": "FeRls", "variance": 0.1, "spread": 0.01, "seed": 1}),
        "predict": (m.predict, {"design": isolated, "around": [isolated], "floor": ground, "seed": 1}),
        "weak_highpass": (c.weak_highpass, {"order": 3, "cutoff": 3.0, "times": 2, "sample_time": 1e-3}),
        "noise_shaping": (c.noise_shaping, {"shaping": feedforward.shaping, "path": feedforward.path, "sample_time": 1e-3}),
        "inverse_secondary_shaping": (c.inverse_secondary_shaping, {"shaping": feedforward.shaping, "path": feedforward.path, "sample_time": 1e-3, "estimate": feedforward.path}),
        "tracking_error": (c.tracking_error, {"loop": c.error_loop(loop), "setpoint": setpoint, "feedforward": c.Feedforward(1.0)}),
        "trapezoid_trajectory": (c.trapezoid_trajectory, {"amplitude": 1.0, "rounding": 0.5, "frequency_hz": 2.0, "duration": 0.1, "sample_time": 1e-3}),
    }  # fmt: skip


def missing() -> list[str]:
    """Names of the public API without a call."""
    written = {each.split(",")[0] for each in catalogue()} | RESULTS
    return [
        f"{folder}.{name}"
        for folder, package in PACKAGES.items()
        for name in package.__all__
        if not {name, f"{name}.fit", f"{folder}.{name}"} & written
    ]
