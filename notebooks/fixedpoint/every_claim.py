"""The statements as a table and a map: what this notebook alone needs."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool
from scipy import special

from experiments.fixedpoint import statements as said
from experiments.fixedpoint.axes import COLOURS, METRICS, log_axis
from experiments.fixedpoint.choices import PRINTED_NOISE, SAMPLE_TIME, Values, trajectory
from experiments.fixedpoint.convergence_study import remaining_motion
from experiments.fixedpoint.metrics import compare, judge, noisy_run
from experiments.fixedpoint.noise import LOGISTIC_DEVIATION, Noise
from experiments.fixedpoint.oscillator import load_oscillator
from experiments.fixedpoint.published import KALMAN, LITERAL, LOW_PASS, WINDOW, published_controllers
from experiments.fixedpoint.statements import LOW_PASS_BEST, NOISIEST, SMOOTHEST, WINDOW_PRECISE, statements
from stillwork.control.controlled_run import ControlledRun
from stillwork.control.fixed_point import Controller, simulate
from stillwork.control.trajectory import asin_trajectory
from stillwork.control.transformation import FlowTransformation
from stillwork.estimation.coordinate_filters import MovingWindow, UnscentedKalman
from workbook import figures, paths
from workbook.choices.kept import wanted
from workbook.studies import Study, fraction, run_study

# === Open choices =================================================================================================
# The paper's statements at any combination of its open choices (``choices.toml``).


class MeasuredKalman(UnscentedKalman):
    """The Kalman filter in a loop that takes the error from the measured position, as with the other two."""

    error_from_measurement = True


def pooled(studies: dict[str, dict[str, Study]], kalman: str) -> dict[str, Bool[np.ndarray, " runs"]]:
    """The statements over the runs of all cases together."""
    each = [statements(study, kalman) for study in studies.values()]
    return {name: np.concatenate([obeyed[name] for obeyed in each]) for name in each[0]}


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


FORMS = ("printed", LITERAL), ("corrected", KALMAN)  # of (14)


RECORDS = 2  # of noise, of a call; the notebooks take 40


def ranking_values(
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
        found[f"fixedpoint.section-4.kalman-worst.{form}"] = pooled(studies, name)[said.KALMAN_WORST].mean()
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


def paint_statement_map(columns: list[str], fractions: dict[str, list[float]], label: str, chosen: str):
    """Whether each statement holds, a row a statement, a column a setting; a share where it is in some records only."""
    figure, axes = figures.new(1, height=0.34 * len(fractions) + 1.6)
    grid = np.array(list(fractions.values()), dtype=float)
    rows, places = np.arange(len(fractions)), np.arange(len(columns))
    for word, held, face in (
        ("in every record", grid == 1, figures.BLUE),
        ("in no record", grid == 0, "none"),
    ):
        at = np.nonzero(held)
        style = {"ms": 9, "color": figures.BLUE, "mfc": face, "label": f"the statement holds {word}"}
        axes.plot(at[1], at[0], "o", **style)
    some = np.nonzero((grid > 0) & (grid < 1))
    if len(some[0]):
        axes.plot(some[1], some[0], "o", ms=9, color=figures.BLUE, mfc=figures.SKY, label="in some (share)")
    for row, column in zip(*some, strict=True):
        axes.annotate(
            f"{grid[row, column]:.2g}", (column, row), (7, -3), textcoords="offset points", fontsize=7
        )
    place = columns.index(chosen)
    shade = {"color": figures.GREY, "alpha": 0.25, "lw": 0, "zorder": 0}
    axes.axvspan(place - 0.25, place + 0.25, label="the setting of the other notebooks", **shade)
    axes.set_yticks(rows, list(fractions))
    axes.set_xticks(places, columns, fontsize=8)
    axes.set(xlim=(-0.6, len(columns) - 0.4), xlabel=label)
    axes.invert_yaxis()
    figures.legend_below(axes, 2)
    return figure


def paint_ranking(frequency_hz: float, sharpness: float, amplitude: float):
    """RMS errors of the four controllers, mean over two noise records."""
    exact, approximate = (model.plant for model in load_oscillator().values())
    trajectory = asin_trajectory(sharpness=sharpness, frequency_hz=frequency_hz)
    controllers, noise = published_controllers(approximate), Noise("gaussian", amplitude)
    found = compare(exact, controllers, trajectory, noise, runs=2, seed=0)
    figure, panels = figures.new(1, 2, height=2.2)
    for axes, quantity in zip(panels, ("position", "roughness"), strict=True):
        for place, (name, study) in enumerate(found.items()):
            mean = METRICS[quantity][2] * study[quantity].mean()
            axes.plot(mean, place, "o", color=COLOURS[name], label=name)
        axes.set(xscale="log", xlabel=METRICS[quantity][0], ylim=(len(found) - 0.5, -0.5))
        axes.set_yticks(range(len(found)), [""] * len(found))
        log_axis(axes.xaxis)
    panels[0].set_yticklabels(list(found))
    return figure


def rankings(small: list[dict[str, Study]], large: list[dict[str, Study]]) -> dict[str, list[float]]:
    """Fractions of runs that obey what the paper says, a number for each pair of studies, in small and in large noise."""

    def share(studies, kalman, name, quantity="position"):
        return [float(statements(study, kalman, quantity)[name].mean()) for study in studies]

    return {
        "small noise: low pass smoothest": share(small, LITERAL, SMOOTHEST),
        "small noise: Kalman filter noisiest": share(small, LITERAL, NOISIEST),
        "large noise: Kalman filter noisiest": share(large, LITERAL, NOISIEST),
        "small noise: window most precise, (14) printed": share(small, LITERAL, WINDOW_PRECISE),
        "small noise: window most precise, (14) corrected": share(small, KALMAN, WINDOW_PRECISE),
        "small noise: window most precise in q', (14) printed": share(
            small, LITERAL, WINDOW_PRECISE, "velocity"
        ),
        "large noise: low pass best, (14) printed": share(large, LITERAL, LOW_PASS_BEST),
        "large noise: low pass best, (14) corrected": share(large, KALMAN, LOW_PASS_BEST),
        "large noise: low pass best in q', (14) printed": share(large, LITERAL, LOW_PASS_BEST, "velocity"),
    }


def table(studies: dict[str, dict[str, Study]], corrected: str, printed: str) -> list[str]:
    """All statements in all cases, for both forms of the Kalman filter, with Wilson's 95 % intervals.

    Runs that repeat one another, as those without noise do, are one run: they get no interval.
    """
    rows = [("case", "statement", "(14) printed", "(14) corrected")]
    for case, study in studies.items():
        repeated = all(np.ptp(found[quantity]) == 0 for found in study.values() for quantity in found.values)
        forms = [statements(study, form) for form in (printed, corrected)]
        for name in forms[0]:
            cells = []
            for obeyed in forms:
                share, (low, high) = fraction(obeyed[name])
                cells.append(f"{share:.2f}" if repeated else f"{share:.2f} ({low:.2f} .. {high:.2f})")
            rows.append((case, name, *cells))
    return ["{:16s} {:27s} {:22s} {:22s}".format(*row).rstrip() for row in rows]


def longest_replaced(gaps: list[float], studies: list[dict[str, Study]], kalman: str) -> float:
    """Longest gap, s, at which the better simple filter tracks q as well as the Kalman filter in every run; 0 if none."""
    replaced = [0.0]
    for gap, study in zip(gaps, studies, strict=True):
        simple = np.minimum(study[WINDOW]["position"], study[LOW_PASS]["position"])
        if (np.isfinite(simple) & (simple <= study[kalman]["position"])).all():
            replaced.append(gap)
    return max(replaced)


# === What the notebook judges beside its answer =====================================================================


def appendix(page, *, studies: dict[str, dict[str, Study]]) -> None:
    """What this notebook judges beside its answer; `studies` by noise and controller."""
    page.text("""## The rankings, case by case

Share of records in which each statement holds, with Wilson's 95 % interval.""")
    page.show(*table(studies, KALMAN, LITERAL))
    page.text("By another measure of noisy, the RMS change of the error of $\\dot q$ in a sample:")
    noisiest = {}
    for case, study in studies.items():
        if case != "no noise":
            noisiest[case] = said.in_both_forms(study, NOISIEST, noisy_by="velocity_roughness").mean()
            page.show(f"{case}: Kalman filter roughest in {noisiest[case]:.2f} of the records")
    smooth = said.in_both_forms(studies["small Gaussian"], SMOOTHEST, noisy_by="velocity_roughness").mean()
    page.show(f"small Gaussian: low pass smoothest in {smooth:.2f} of them, so the rest is the window")
    page.check("fixedpoint.fig-6.noisy-by-velocity", noisiest["small Gaussian"])
    page.text("""## Which number wants which setting

Of all printed numbers those that agree under an option and not under every one (`data/fixedpoint/settings.csv`):""")
    axes = (
        "trajectory-shape", "trajectory-frequency", "noise-amplitude", "noisy-by", "kalman-acceleration", "judged-from",
        "error-measure", "true-stiffness",
    )  # fmt: skip
    page.show(*wanted(paths.data("fixedpoint", "settings.csv"), axes, never=("fig-", "section-")))
