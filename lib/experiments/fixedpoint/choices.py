"""The fixed-point paper's statements at any combination of its open choices."""

from dataclasses import replace

import numpy as np
from scipy import special

from experiments.fixedpoint import statements as said
from experiments.fixedpoint.convergence_study import remaining_motion
from experiments.fixedpoint.metrics import judge, noisy_run
from experiments.fixedpoint.noise import LOGISTIC_DEVIATION, Noise
from experiments.fixedpoint.oscillator import load_oscillator
from experiments.fixedpoint.published import KALMAN, LITERAL, LOW_PASS, WINDOW, published_controllers
from stillwork.control.fixed_point import ControlledRun, Controller, simulate
from stillwork.control.trajectory import Trajectory, asin_trajectory, trapezoid_trajectory
from stillwork.control.transformation import FlowTransformation
from stillwork.estimation.coordinate_filters import MovingWindow, UnscentedKalman
from workbook.studies import run_study

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


class MeasuredKalman(UnscentedKalman):
    """The Kalman filter in a loop that takes the error from the measured position, as with the other two."""

    error_from_measurement = True


def controllers(
    kalman_error: str, kalman_model: str, window_samples: int, kalman_acceleration: str = "difference"
) -> dict[str, Controller]:
    """The paper's filters, the Kalman filter in both forms, at one combination of open choices."""
    approximate = load_oscillator()["approximate"]
    believed = approximate if kalman_model == "(11)" else replace(approximate, damping=0.0, drag=0.0)
    form = UnscentedKalman if kalman_error == "estimate" else MeasuredKalman
    found = published_controllers(approximate.plant)
    found[WINDOW] = replace(found[WINDOW], signal_filter=MovingWindow(window_samples - 1))
    for name in (KALMAN, LITERAL):
        kalman = form(
            believed.plant, literal=name == LITERAL, model_acceleration=kalman_acceleration == "model"
        )
        found[name] = replace(found[name], signal_filter=kalman)
    return found


def noise_of(kind: str, size: str, amplitude: str) -> Noise:
    """Noise of a printed amplitude, which means its standard deviation, the law's scale or three deviations."""
    if (kind, amplitude) == ("logistic", "scale"):  # of a Gaussian the deviation is the scale
        kind = "logistic-scale"
    return Noise(kind, PRINTED_NOISE[size] * (1 / 3 if amplitude == "three deviations" else 1.0))


# --- Sections III.B, III.C and IV: rankings ---------------------------------------------------------------------

FORMS = ("printed", LITERAL), ("corrected", KALMAN)  # of (14)
RECORDS = 2  # of noise, of a call; the notebooks take 40


def rankings(
    *,
    trajectory_shape: str,
    trajectory_frequency: float,
    trajectory_amplitude: float,
    judged_from: float,
    noise_amplitude: str,
    integration: str,
    force_at: str,
    kalman_error: str,
    kalman_model: str,
    kalman_acceleration: str,
    window_samples: int,
    noisy_by: str,
    error_measure: str,
    seed: int,
    lean: bool,
) -> Values:
    """Rankings in four noises, as fractions of the records; the lean form takes 2 records instead of 40."""
    exact = load_oscillator()["exact"].plant
    nominal = trajectory(trajectory_shape, trajectory_frequency, trajectory_amplitude)
    who = controllers(kalman_error, kalman_model, window_samples, kalman_acceleration)
    options = {"integration": integration, "force_from_estimate": force_at == "filtered"}

    def ranked_trial(rng, controller, noise) -> dict[str, float]:
        run = noisy_run(exact, controller, nominal, noise, rng, **options)
        return _judged(run, judged_from, noisy_by, error_measure)

    runs, studies = RECORDS if lean else 40, {}
    found: Values = {}
    for size, kind in said.FIGURES:
        noise = noise_of(kind, size, noise_amplitude)
        studies[f"{size} {kind}"] = study = {
            name: run_study(ranked_trial, runs, seed, progress=False, controller=each, noise=noise)
            for name, each in who.items()
        }
        for name, obeyed in said.figure_statements(study, size, kind).items():
            found[f"fixedpoint.fig-{name}"] = obeyed.mean()
    for form, name in FORMS:
        found[f"fixedpoint.section-4.kalman-worst.{form}"] = said.pooled(studies, name)[
            said.KALMAN_WORST
        ].mean()
    offsets = {"fig-14.offset-q": "position_shift", "fig-15.offset-dq": "velocity_shift"}
    for claim, quantity in offsets.items():
        shift = np.abs(studies["large logistic"][LITERAL][quantity]) / SAMPLE_TIME
        found[f"fixedpoint.{claim}.printed"] = np.mean((shift > 0.5) & np.isfinite(shift))
    return found


def _judged(run: ControlledRun, settle: float, noisy_by: str, error_measure: str) -> dict[str, float]:
    """A run in the quantities of `metrics.judge`, by other measures of an error and of what is noisy."""
    found = judge(run, settle)
    if noisy_by == "velocity":
        found["roughness"] = found["velocity_roughness"]
    if error_measure == "largest" and run.diverged_at is None:
        part = slice(round(settle / run.trajectory.sample_time), None)
        found["position"] = float(np.abs(run.position_error[part]).max())
        found["velocity"] = float(np.abs(run.velocity_error[part]).max())
    return found


# --- Section III.A: without noise ---------------------------------------------------------------------------------

SWEEP_HZ = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5)  # of notebook 01


def noise_free(
    *,
    trajectory_shape: str,
    trajectory_amplitude: float,
    integration: str,
    kalman_acceleration: str,
    window_samples: int,
    noisy_by: str,
    kick: float,
    seed: int,
) -> Values:
    """The fluctuation and the comparable errors of Figs 2 to 4."""
    exact = load_oscillator()["exact"].plant
    who = controllers("estimate", "(11)", window_samples, kalman_acceleration)
    roughest = []
    for frequency in SWEEP_HZ:
        nominal = trajectory(trajectory_shape, frequency, trajectory_amplitude)
        found = {
            name: _judged(simulate(exact, each, nominal, integration=integration), 2.0, noisy_by, "rms")
            for name, each in who.items()
        }
        rough = {name: each["roughness"] for name, each in found.items()}
        roughest.append(max(rough, key=rough.__getitem__) == WINDOW and np.isfinite(rough[WINDOW]))
        if frequency == 0.2:
            errors = [found[name]["position"] for name in (WINDOW, LOW_PASS, LITERAL)]
    flow = FlowTransformation()
    kept = [
        remaining_motion(exact, replace(who[name], transformation=flow), kick, SAMPLE_TIME)
        for name in (WINDOW, LOW_PASS, KALMAN)
    ]
    return {
        "fixedpoint.fig-2.comparable": max(errors) / min(errors),
        "fixedpoint.fig-3.fluctuation": np.mean(roughest),
        "fixedpoint.fig-2.property-of-the-iteration": np.mean(np.array(kept) > 1),
    }


# --- Section III.B: neutral to the distribution ---------------------------------------------------------------------

NEUTRAL_RECORDS = {"small": 40, "large": 400}  # of notebooks 02 and 03
COUPLED_RECORDS = 40


def neutral(
    *,
    trajectory_shape: str,
    trajectory_frequency: float,
    trajectory_amplitude: float,
    integration: str,
    window_samples: int,
    seed: int,
    lean: bool,
) -> Values:
    """Largest change of the error of q' from Gaussian to logistic noise of one deviation that the interval holds.

    In the lean form 40 records of large noise stand for 400: the logistic one is the Gaussian one, sample by sample at
    the same place of its distribution, so that the difference scatters less and is the same in the mean.
    """
    exact = load_oscillator()["exact"].plant
    nominal = trajectory(trajectory_shape, trajectory_frequency, trajectory_amplitude)
    who = controllers("estimate", "(11)", window_samples)

    def speed_trial(rng, controller, size, coupled) -> dict[str, float]:
        laws = [Noise(kind, PRINTED_NOISE[size]) for kind in ("gaussian", "logistic")]
        stream = rng.bit_generator.seed_seq
        added = [law.sample(np.random.default_rng(stream), len(nominal.position)) for law in laws]
        if coupled:
            added[1] = coupled_logistic(added[0], PRINTED_NOISE[size])
        runs = (simulate(exact, controller, nominal, each, integration=integration) for each in added)
        return dict(zip(("before", "after"), (judge(run)["velocity"] for run in runs), strict=True))

    found: Values = {}
    for section, (size, records) in zip(("3b", "3c"), NEUTRAL_RECORDS.items(), strict=True):
        coupled = lean and size == "large"
        settings = {"size": size, "coupled": coupled, "progress": False}
        for name in (WINDOW, LOW_PASS):
            runs = COUPLED_RECORDS if coupled else records
            study = run_study(speed_trial, runs, seed, controller=who[name], **settings)
            key = f"fixedpoint.section-{section}.neutral.{name.replace(' ', '-')}"
            found[key] = np.nan
            if np.isfinite([study["before"], study["after"]]).all():
                _, interval = said.relative_change(study["before"], study["after"])
                found[key] = float(np.abs(interval).max())
    return found


def coupled_logistic(gaussian: np.ndarray, deviation: float) -> np.ndarray:
    """Logistic numbers of the same deviation, each at the place of the Gaussian one in its distribution."""
    place = gaussian / deviation
    return deviation / LOGISTIC_DEVIATION * (special.log_ndtr(place) - special.log_ndtr(-place))
