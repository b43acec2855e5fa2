"""The fair comparison: every filter tuned with the same budget on the same training noise."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
from jaxtyping import Float64

from experiments.fixedpoint.axes import COLOURS, METRICS, log_axis, points_with_intervals
from experiments.fixedpoint.differentiation import steady_errors
from experiments.fixedpoint.error_lines import approximate, paint_error_lines
from experiments.fixedpoint.metrics import QUANTITIES, compare, judge
from experiments.fixedpoint.noise import Noise
from experiments.fixedpoint.noise_pictures import motion_at_rest
from experiments.fixedpoint.oscillator import VanDerPol, load_oscillator, restoring_force
from experiments.fixedpoint.published import (
    EXTENDED,
    INTEGRATION,
    KALMAN,
    LOW_PASS,
    POLYNOMIAL,
    WINDOW,
    published_controllers,
)
from experiments.fixedpoint.search import run_simplex, sobol_points
from stillwork.base.checks import InputError, require_choice, require_count
from stillwork.control.fixed_point import Controller, simulate
from stillwork.control.fixed_point_linear import linear_loop
from stillwork.control.kinematics import KinematicDesign
from stillwork.control.trajectory import Trajectory, asin_trajectory
from stillwork.control.transformation import RobustTransformation
from stillwork.estimation.coordinate_filters import (
    ExtendedKalman,
    FilterState,
    LowPass,
    MovingWindow,
    SavitzkyGolay,
    UnscentedKalman,
)
from stillwork.estimation.gaussian import COVARIANCE, ESTIMATE, MEANS, PAST
from stillwork.estimation.plant import Plant
from workbook import figures
from workbook.studies import Study, fraction, mean_interval, run_study
from workbook.timings import measured_times


def paint_low_pass(exponent: float, bandwidth: float, strength: float):
    """The low pass with other settings than the paper's, in large Gaussian noise."""
    transformation = RobustTransformation(slope=strength / (4e7 * 1.05))
    chosen = Controller(
        LowPass(bandwidth, from_zero=True), transformation, KinematicDesign(exponent), approximate()
    )
    noise = Noise("gaussian", 1e-4)
    return paint_error_lines({LOW_PASS: chosen}, asin_trajectory(), noise, "large Gaussian noise")


def paint_tuned_errors(studies: dict[str, dict[str, Study]]):
    """Errors on fresh noise of the tuned filters, mean and 95 % interval, a row a noise."""
    quantities = ("velocity", "position", "roughness")
    height = 2.0 * len(studies) + 0.6
    figure, panels = figures.new(len(studies), len(quantities), height=height, squeeze=False)
    for row, (case, study) in zip(panels, studies.items(), strict=True):
        for axes, quantity in zip(row, quantities, strict=True):
            for place, (name, runs) in enumerate(study.items()):
                points_with_intervals(axes, [METRICS[quantity][2] * runs[quantity]], [place], name)
            first = quantity == quantities[0]
            axes.set(xlabel=METRICS[quantity][0], title=case if first else "")
            axes.set_yticks(range(len(study)), map(called, study) if first else [""] * len(study))
            axes.set(ylim=(len(study) - 0.5, -0.5), xlim=(0, 1.06 * axes.get_xlim()[1]))
    return figure


# Two knobs that every loop has: Lambda in 1/s, and the strength of (8), minus its local gain.
SHARED = {"exponent": (6.0, 160.0), "strength": (0.02, 1.4)}

STARTS = 3  # simplexes


@dataclass(frozen=True)
class Family:
    """A filter with free numbers: the ranges that are searched, evenly in their logarithms."""

    name: str
    ranges: dict[str, tuple[float, float]]
    build: Callable  # (model, sample_time, **numbers) -> Filter
    whole: tuple[str, ...] = ()  # numbers that are rounded before use

    @property
    def names(self) -> tuple[str, ...]:
        return (*SHARED, *self.ranges)

    @property
    def bounds(self) -> Float64[np.ndarray, "knobs 2"]:
        """Logarithms of the ranges."""
        return np.log([*SHARED.values(), *self.ranges.values()])

    def numbers(self, knobs: np.ndarray) -> dict[str, float]:
        """The settings at a point of the search."""
        return {
            name: round(value) if name in self.whole else value
            for name, value in zip(self.names, np.exp(knobs).tolist(), strict=True)
        }

    def controller(self, model: Plant, sample_time: float, knobs: np.ndarray) -> Controller:
        """The controller at a point of the search, with transformation (8)."""
        numbers = self.numbers(knobs)
        exponent, strength = numbers.pop("exponent"), numbers.pop("strength")
        transformation = RobustTransformation(slope=strength / (4e7 * 1.05))
        signal_filter = self.build(model, sample_time, **numbers)
        return Controller(signal_filter, transformation, KinematicDesign(exponent), model)


def families() -> dict[str, Family]:
    """The five filters of the comparison; of each covariance only ratios matter, so one entry is fixed."""
    found = (
        Family(
            WINDOW,
            {"length": (1.0, 40.0)},
            lambda model, sample_time, **own: MovingWindow(**own),
            ("length",),
        ),
        Family(
            LOW_PASS,
            {"bandwidth": (60.0, 1500.0)},
            # Euler's rule diverges at 2 / sample_time.
            lambda model, sample_time, bandwidth: LowPass(min(bandwidth, 1.9 / sample_time), True),
        ),
        Family(
            KALMAN,
            {
                "velocity_process": (1e-6, 1e2),
                "position_process": (1e-10, 1e1),
                "position_noise": (1e-10, 1e1),
            },
            _kalman,
        ),
        Family(
            EXTENDED,
            {"disturbance_step": (1e-3, 1e2), "velocity_step": (1e-6, 1.0)},
            lambda model, sample_time, **own: ExtendedKalman(model, **own),
        ),
        Family(
            POLYNOMIAL,
            {"samples": (5.0, 60.0), "degree": (2.0, 3.4)},
            lambda model, sample_time, **own: SavitzkyGolay(**own, sample_time=sample_time),
            ("samples", "degree"),
        ),
    )
    return {family.name: family for family in found}


def _kalman(model, sample_time, velocity_process, position_process, position_noise) -> UnscentedKalman:
    process, noise = (velocity_process, position_process), (1e-2, position_noise)
    return UnscentedKalman(model, process=np.array(process), noise=np.array(noise))


@dataclass(frozen=True)
class Tuned:
    """The best setting found, and what the search did."""

    controller: Controller
    settings: dict[str, float]
    cost: float  # mean over the training runs, in the unit of the criterion
    evaluations: int
    diverged: int  # how many of them
    at_edge: tuple[str, ...]  # settings at an end of their range: a wider one might give more


def tune(
    family: Family,
    plant: Plant,
    model: Plant,
    trajectory: Trajectory,
    noise: Noise,
    *,
    budget: int,
    runs: int,
    seed: int,
    criteria: tuple[str, ...] = ("velocity",),
) -> list[Tuned]:
    """Search by a Sobol sequence, then by Nelder and Mead's simplex from each of the best points, once a criterion.

    The sequence takes the largest power of two within half the budget, the same for every family whatever its number
    of knobs and run once for all criteria; the simplexes share the rest. What is made small is the mean of a criterion,
    a quantity of `metrics.judge`, over the noise records of one seed; test on another one.
    """
    require_count("budget", budget, at_least=8)
    require_count("runs", runs)
    for criterion in criteria:
        require_choice("criterion", criterion, QUANTITIES[:3])
    low, high = family.bounds.T
    records = []  # drawn once: every evaluation sees the same
    for stream in np.random.SeedSequence(seed).spawn(runs):
        rng = np.random.default_rng(stream)
        records.append((noise.sample(rng, len(trajectory.position)), noise.sample_grid(rng)))

    def means(knobs) -> dict[str, float]:
        controller = family.controller(model, trajectory.sample_time, knobs)
        total = np.zeros(len(criteria))
        for record, grid in records:
            run = simulate(
                plant,
                controller,
                trajectory,
                record,
                resolution=noise.resolution,
                grid=grid,
                integration=INTEGRATION,
            )
            total += [judge(run)[criterion] for criterion in criteria]
            if np.isinf(total).any():  # one divergence spoils the mean
                break
        return dict(zip(criteria, (total / runs).tolist(), strict=True))

    points = sobol_points(low, high, budget, seed)
    seen = [means(point) for point in points]

    def best_by(criterion) -> Tuned:
        tried = [(each[criterion], point) for each, point in zip(seen, points, strict=True)]

        def cost(knobs):
            knobs = np.clip(knobs, low, high)
            tried.append((means(knobs)[criterion], knobs))
            return min(tried[-1][0], 1e3)  # the simplex needs finite numbers

        starts = [knobs for _, knobs in sorted(tried, key=lambda t: t[0])[:STARTS]]
        for number, start in enumerate(starts):
            run_simplex(cost, start, low, high, 0.1, (budget - len(tried)) // (len(starts) - number))
        best, knobs = min(tried, key=lambda t: t[0])
        if np.isinf(best):
            raise InputError(f"{family.name}: every one of {len(tried)} settings diverged; widen the ranges")
        return Tuned(
            family.controller(model, trajectory.sample_time, knobs),
            family.numbers(knobs),
            float(best),
            len(tried),
            int(sum(np.isinf(value) for value, _ in tried)),
            _at_edge(family, knobs),
        )

    return [best_by(criterion) for criterion in criteria]


def _at_edge(family: Family, knobs: np.ndarray) -> tuple[str, ...]:
    """Settings at an end of their range; a whole number is there as soon as it is the range's first or last."""
    found, *ends = (family.numbers(each) for each in (knobs, *family.bounds.T))
    return tuple(
        name
        for name, value in found.items()
        if any(np.isclose(value, end[name], rtol=1e-9, atol=0) for end in ends)
    )


# --- Sections II.C and IV: tuned alike ----------------------------------------------------------------------------

# What notebook 07 takes by default, too.
BUDGET, TRAINING_RUNS, TRAINING_S, RECORDS, TEST_SEED = 256, 2, 7.0, 40, 20221207
NOISES = {"gaussian": Noise("gaussian", 1e-4), "encoder": Noise("encoder", 2e-4)}
SIMPLE = (WINDOW, LOW_PASS)  # the paper's


def plant_of(stiffness: float) -> Plant:
    """The plant of Table I with another stiffness, N/m."""
    return replace(load_oscillator()["exact"], stiffness=stiffness).plant


@cache
def tuned_controller(name: str, stiffness: float, noise: str, seed: int, acceleration: str) -> Controller:
    """A filter tuned for q' on a plant of that stiffness."""
    family = families()[name]
    if name == KALMAN and acceleration == "model":
        family = replace(
            family, build=lambda *how, **own: replace(_kalman(*how, **own), model_acceleration=True)
        )
    how = {"budget": BUDGET, "runs": TRAINING_RUNS, "seed": seed}
    model = load_oscillator()["approximate"].plant
    training = asin_trajectory(duration=TRAINING_S)
    [found] = tune(family, plant_of(stiffness), model, training, NOISES[noise], **how)
    return found.controller


def tuned_alike(
    *, true_stiffness: float, tuned_on: str, tuning_noise: str, kalman_acceleration: str, seed: int
) -> dict[str, float | tuple[float, tuple[float, float]]]:
    """Notebook 07's statements on another plant and by another search, of which `seed` is the training seed."""
    plant, model = plant_of(true_stiffness), load_oscillator()["approximate"]
    at = load_oscillator()["exact"].stiffness if tuned_on == "Table I" else true_stiffness
    search = at, tuning_noise, seed, kalman_acceleration
    tuned = {name: tuned_controller(name, *search) for name in (*SIMPLE, KALMAN)}
    printed = published_controllers(model.plant)[KALMAN]
    as_printed = replace(printed.signal_filter, model_acceleration=kalman_acceleration == "model")
    exchanged = {
        "printed": replace(printed, signal_filter=as_printed),
        "searched": replace(printed, signal_filter=tuned[KALMAN].signal_filter),
    }
    found = compare(
        plant, tuned | exchanged, asin_trajectory(), NOISES[tuning_noise], runs=RECORDS, seed=TEST_SEED
    )
    return statements_of(found, found["printed"], found["searched"])


def statements_of(
    tuned: dict[str, Study], printed: Study, searched: Study
) -> dict[str, float | tuple[float, tuple[float, float]]]:
    """What the paper says of the Kalman filter, by the ledger's names, of filters that were tuned alike.

    `printed` and `searched`: the loop with the paper's settings, and with the Q and R of the search instead.
    """
    kalman, simple = tuned[KALMAN]["velocity"], [tuned[name]["velocity"] for name in SIMPLE]
    means = [each.mean() for each in simple]
    ratio = min(means) / kalman.mean() if np.isfinite([*means, kalman.mean()]).all() else np.nan
    return {
        "fixedpoint.abstract.simpler-can-replace": ratio,
        "fixedpoint.section-4.kalman-does-not-work": fraction(kalman > np.maximum(*simple)),
        "fixedpoint.section-2c.best-settings": fraction(printed["velocity"] <= searched["velocity"]),
    }


# --- Which error of the model ------------------------------------------------------------------------------------

# A plant of Table I that differs in one thing from itself: multiples of its number, or newtons.
SIZES = {
    "stiffness": (0.4, 1.0, 1.6, 2.4),
    "mass": (2 / 3, 1.0, 4 / 3, 1.5, 5 / 3),
    "damping": (1 / 3, 1.0, 3.0, 10.0),
    "drag": (1 / 3, 1.0, 3.0, 5.0),
    "dry friction": (0.0, 2.0, 20.0),
    "constant force": (0.0, 20.0, 100.0),
}
WITHOUT_MODEL = (WINDOW, LOW_PASS, POLYNOMIAL)
SMOOTH = 0.1  # m/s, over which dry friction turns


def friction_acceleration(position, velocity, force, parameters):
    """The oscillator of (11) with dry friction, its last parameter, N."""
    resisted = restoring_force(position, velocity, parameters) + parameters[6] * np.tanh(velocity / SMOOTH)
    return (force - resisted) / parameters[0]


def friction_force(position, velocity, acceleration, parameters):
    """The force that gives an acceleration."""
    resisted = restoring_force(position, velocity, parameters) + parameters[6] * np.tanh(velocity / SMOOTH)
    return parameters[0] * acceleration + resisted


def wrong_plant(exact: VanDerPol, kind: str, size: float) -> Plant:
    """The plant with one of `SIZES`; a constant force is no part of it."""
    if kind == "dry friction":
        numbers = np.append(exact.plant.parameters, size)
        return Plant(friction_acceleration, friction_force, numbers)
    if kind == "constant force":
        return exact.plant
    return replace(exact, **{kind: size * getattr(exact, kind)}).plant


def stable(plant: Plant, controllers: dict[str, Controller], sample_time: float) -> dict[str, bool]:
    """Whether small motion around rest decays, loop by loop."""
    found = {}
    for name, each in controllers.items():
        loop = linear_loop(plant, each, sample_time, integration=INTEGRATION)
        found[name] = loop.radius(each.transformation.local_gain) < 1
    return found


def errors_by_kind(
    exact: VanDerPol, searches: list[dict[str, Controller]], trajectory: Trajectory, noise: Noise, **how
) -> dict[str, dict[str, Float64[np.ndarray, "searches sizes"]]]:
    """Mean RMS error of q', m/s, on wrong plants: by kind, then filter; NaN where the loop is unstable, so not ranked."""
    found = {}
    for kind, sizes in SIZES.items():
        found[kind] = {name: np.full((len(searches), len(sizes)), np.nan) for name in searches[0]}
        for place, size in enumerate(sizes):
            plant = wrong_plant(exact, kind, size)
            push = np.full(len(trajectory.position), size if kind == "constant force" else 0.0)
            for number, controllers in enumerate(searches):
                kept = stable(plant, controllers, trajectory.sample_time)
                run = {name: each for name, each in controllers.items() if kept[name]}
                for name, each in compare(plant, run, trajectory, noise, disturbance=push, **how).items():
                    found[kind][name][number, place] = each["velocity"].mean()
    return found


def over_best(errors: dict[str, np.ndarray]) -> Float64[np.ndarray, "searches sizes"]:
    """The unscented filter's error over that of the best filter without a model whose loop is stable."""
    return errors[KALMAN] / np.fmin.reduce([errors[name] for name in WITHOUT_MODEL])


def largest_stable_mass(
    exact: VanDerPol, controllers: dict[str, Controller], sample_time: float
) -> dict[str, float]:
    """Largest of the plant's masses, in steps of 1/20 of Table I's up to twice it, up to which a loop is stable."""
    found = dict.fromkeys(controllers, 0.0)
    for share in np.arange(1.0, 2.01, 0.05):
        kept = stable(wrong_plant(exact, "mass", share), controllers, sample_time)
        found = {name: share if kept[name] else found[name] for name in found}
    return {name: float(share * exact.mass) for name, share in found.items()}


def called(name: str) -> str:
    """A filter's name on this page, which has two Kalman filters."""
    return "unscented Kalman filter" if name == KALMAN else name


def paint_model_error(
    errors: dict[str, dict[str, np.ndarray]], heaviest: dict[str, float], models: dict[str, VanDerPol]
):
    """RMS error of q' over the size of each kind of error: medians of the searches, where all their loops are stable.

    Stiffness is in multiples of the model's, as in the text.
    """
    figure, panels = figures.new(2, 3, height=4.8, sharey=True)
    share = models["exact"].stiffness / models["approximate"].stiffness
    for axes, (kind, found) in zip(panels.flat, errors.items(), strict=True):
        scale = share if kind == "stiffness" else 1.0
        for name, lines in found.items():
            middle = 1e3 * np.median(lines, axis=0)  # NaN where one is unstable
            sizes = scale * np.array(SIZES[kind])
            axes.plot(sizes, middle, "o-", ms=3, color=COLOURS[name], label=called(name))
        unit = "N" if kind in ("dry friction", "constant force") else "times Table I's"
        axes.set(title=kind, xlabel="times the model's" if kind == "stiffness" else unit, yscale="log")
        log_axis(axes.yaxis)
    panels[0, 0].axvline(share, color=figures.GREY, linestyle="--", label="Table I's plant")
    for name in WITHOUT_MODEL:
        edge = {"color": COLOURS[name], "linestyle": ":", "label": f"_{name}, stable up to here"}
        panels[0, 1].axvline(heaviest[name] / models["exact"].mass, **edge)
    panels[0, 1].set_title("mass (dotted: stable up to here)")
    for axes in panels[:, 0]:
        axes.set_ylabel("RMS error of q' (mm/s)")
    figures.legend_below(panels[0, 0], 3)
    return figure


def break_even(stiffness: list[float], ratio: np.ndarray) -> float:
    """Where a ratio first falls to 1 beyond the plant that the filters were tuned on, by a line between plants; else the last."""
    for (k, high), (after, low) in pairwise(zip(stiffness, ratio, strict=True)):
        if k >= TUNED_AT and high > 1 >= low:
            return float(k + (after - k) * (high - 1) / (high - low))
    return float(stiffness[-1])


TUNED_AT = 125.0  # N/m, Table I


# --- Section II.C: sigma points and Jacobians -----------------------------------------------------------------------


def prediction_trial(
    rng: np.random.Generator, model: VanDerPol, deviations: tuple[float, float]
) -> dict[str, float]:
    """One prediction of both Kalman filters from a Gaussian state [velocity, position] with these deviations.

    Distance of the predicted mean and covariance from the exact ones (Gauss and Hermite's rule), in units of the
    state's spread: ``unscented_mean``, ``unscented_covariance`` by sigma points, ``extended_...`` by the Jacobian. The
    mean is drawn within 1.5 m/s and 1 m, the force within 300 N.
    """
    mean, force, step = rng.uniform(-1, 1, 2) * (1.5, 1.0), rng.uniform(-300, 300), 1e-3
    spread = np.array(deviations)

    def move(state):
        v, q = state
        pull = model.stiffness * q - model.excitation * (model.separator**2 - q**2) * v
        pull = pull + model.damping * v + model.drag * np.abs(v) * v
        v = v + step * (force - pull) / model.mass
        return np.array([v, q + step * v])

    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    grid = np.array(np.meshgrid(nodes, nodes)).reshape(2, -1)
    weight = np.outer(weights, weights).ravel() / weights.sum() ** 2
    points = move(mean[:, None] + spread[:, None] * grid)
    exact = points @ weight
    apart = points - exact[:, None]
    covariance = (weight * apart) @ apart.T
    filters = {
        "unscented": UnscentedKalman(model.plant, process=np.full(2, 1e-20)),
        "extended": ExtendedKalman(model.plant, disturbance_step=0.0),
    }
    found = {}
    for name, kalman in filters.items():
        work = kalman.packed().work
        work[COVARIANCE, 0, 0], work[COVARIANCE, 1, 1] = spread**2
        work[MEANS, ESTIMATE, :2], work[MEANS, PAST, :2] = mean, 1.0  # it has measured before
        state = FilterState(np.array([mean[1], mean[0], 0.0]), work)
        after = kalman.step(state, np.nan, force, sample_time=step)
        own = after.estimate[1::-1] - exact, after.covariance[:2, :2] - covariance
        found[f"{name}_mean"] = float(np.linalg.norm(own[0] / spread))
        found[f"{name}_covariance"] = float(np.linalg.norm(own[1] / np.outer(spread, spread)))
    return found


# --- Notebook 07 ----------------------------------------------------------------------------------------------------


def run_searches(
    training: Trajectory, gaussian: Noise, encoder: Noise, seeds: Sequence[int], **effort: int
) -> tuple[dict[str, tuple[Tuned, ...]], list[dict[str, Controller]]]:
    """By filter: tuned for q' and for q in Gaussian noise, for q' on the encoder; and for q' once for each seed.

    On Table I's plant; `effort` is `budget` and `runs` of `tune`. The first seed gives the filters of the page.
    """
    exact, approximate = (model.plant for model in load_oscillator().values())

    def search(family: Family, noise: Noise, seed: int, **how) -> list[Tuned]:
        return tune(family, exact, approximate, training, noise, seed=seed, **effort, **how)

    both, (first, *others) = ("velocity", "position"), seeds
    searched = {
        name: (*search(family, gaussian, first, criteria=both), *search(family, encoder, first))
        for name, family in families().items()
    }
    searches = [{name: each[0].controller for name, each in searched.items()}]
    for seed in others:
        again = {name: search(family, gaussian, seed)[0] for name, family in families().items()}
        searches.append({name: found.controller for name, found in again.items()})
    return searched, searches


def exchanged_settings(model: Plant, tuned: dict[str, dict[str, Controller]]) -> dict[str, Controller]:
    """The paper's Kalman loop, and the same with the Q and R that two searches found, by the cases of `tuned`."""
    printed = published_controllers(model)[KALMAN]
    found = {"printed": printed}
    for quantity in ("q'", "q"):
        own = tuned[f"Gaussian noise, tuned for {quantity}"][KALMAN].signal_filter
        found[f"searched for {quantity}"] = replace(printed, signal_filter=own)
    return found


def scaled_covariances(model: Plant, factors: Sequence[float] | np.ndarray) -> dict[str, Controller]:
    """The paper's Kalman loop with multiples of its printed Q, then of its R, by names such as ``Q x 0.01``."""
    printed = published_controllers(model)[KALMAN]
    kalman, found = printed.signal_filter, {}
    for name, field in (("Q", "process"), ("R", "noise")):
        for factor in factors:
            scaled = replace(kalman, **{field: factor * np.asarray(getattr(kalman, field))})
            found[f"{name} x {factor:g}"] = replace(printed, signal_filter=scaled)
    return found


def appendix(
    page,
    *,
    tuned: dict[str, dict[str, Tuned]],
    trajectory: Trajectory,
    noise: Noise,
    seed: int,
    studies: dict[str, dict[str, Study]],
    settings: dict[str, Study],
) -> None:
    """What this notebook judges beside its answer.

    Parameters
    ----------
    page : workbook.appendix.Appendix
    tuned : dict
        By case: what each filter's search found.
    trajectory : Trajectory
    noise : Noise
    seed : int
        Of fresh records.
    studies : dict
        By case: the errors on fresh noise.
    settings : dict of Study
        Of `exchanged_settings`.
    """
    _of_covariances(page, settings, trajectory, noise, seed)
    _of_sigma_points(page, trajectory.sample_time, noise, seed)
    _of_cost(page, studies["Gaussian noise, tuned for q'"])
    edges = [
        f"{called(name)} ({', '.join(best.at_edge).replace('_', ' ')})"
        for case in tuned.values()
        for name, best in case.items()
        if best.at_edge
    ]
    page.text("## Ends of the ranges")
    page.conclude(
        "{count} of {all} searches end at an edge of their ranges, so a wider one might give more: {which}.",
        "None of {all} searches ends at an edge of its ranges.",
        when=len(edges) > 0,
        count=len(edges),
        all=sum(map(len, tuned.values())),
        which="; ".join(dict.fromkeys(edges)),
    )


FACTORS = (1.0, 1e-1, 1e-2, 1e-3, 1e-9)  # of Q and R; the last stands for none, which no filter can have


def _of_covariances(
    page, settings: dict[str, Study], trajectory: Trajectory, noise: Noise, seed: int
) -> None:
    page.text("""## Q and R

The paper requires that $Q$ and $R$ be "experimentally set [to] achieve the best behavior of the Kalman filter", and names a
recommendation of the literature: "small (not zero) values". Its $\\Lambda$ and (8), with the $Q$ and $R$ of the searches, then with
fractions of the printed ones; $10^{-9}$ stands for zero:""")
    exact, approximate = (model.plant for model in load_oscillator().values())
    scaled = scaled_covariances(approximate, FACTORS)
    fractions = compare(exact, scaled, trajectory, noise, runs=8, seed=seed)
    for name, judged in {**settings, **fractions}.items():
        q, speed = (1e3 * judged[quantity].mean() for quantity in ("position", "velocity"))
        page.show(f"{name:16s} q' {speed:.2f} mm/s, q {q:.4f} mm")
    speed = {name: judged["velocity"] / fractions["Q x 1"]["velocity"] for name, judged in fractions.items()}
    for entry, name in (("small-q", "Q x 0.01"), ("zero-q", "Q x 1e-09"), ("zero-r", "R x 1e-09")):
        page.check(f"fixedpoint.section-2c.{entry}", speed[name].mean(), mean_interval(speed[name]))
    page.conclude(
        "Small values, not zero: with a hundredth of the printed $Q$ the error of $\\dot q$ is {small:.2f} of that as printed, "
        "of $q$ {position:.0f} times; with none {none:.0f} times. With no $R$ it is {no_r:.2f} times.",
        "With a hundredth of the printed $Q$ the error of $\\dot q$ is {small:.2f} times that as printed, of $q$ {position:.2f}, with none {none:.2f} "
        "times, with no $R$ {no_r:.2f} times: small values are not the best here.",
        when=speed["Q x 0.01"].mean() < min(1.0, speed["Q x 1e-09"].mean()),
        small=speed["Q x 0.01"].mean(),
        position=(fractions["Q x 0.01"]["position"] / fractions["Q x 1"]["position"]).mean(),
        none=speed["Q x 1e-09"].mean(),
        no_r=speed["R x 1e-09"].mean(),
    )


def _of_sigma_points(page, sample_time: float, noise: Noise, seed: int) -> None:
    page.text("""## Sigma points or Jacobian?

Section II.C says that sigma points give "a better approximation ... for the posterior mean and covariance" than Jacobians. We
test one prediction of the oscillator's model against Gauss-Hermite quadrature, from random states and forces of the motion, with
the standard deviations that the filter computes. Table II has $\\beta = 0.001$ where a Gaussian state needs 2.""")
    process, assumed = np.diag([0.1, 0.001]), np.diag([0.01, 0.001])  # Q and R (printed)
    belief = steady_errors(motion_at_rest(sample_time), process, assumed, noise.amplitude, sample_time)
    given = {
        "model": load_oscillator()["approximate"],
        "deviations": tuple(np.sqrt(np.diag(belief.computed)).tolist()),
    }
    predicted = run_study(prediction_trial, 100, seed, progress=False, **given)
    for kind in ("mean", "covariance"):
        better = predicted[f"unscented_{kind}"] < 0.999 * predicted[f"extended_{kind}"]
        page.check(f"fixedpoint.section-2c.unscented-{kind}", *fraction(better))
        sizes = [np.median(predicted[f"{name}_{kind}"]) for name in ("unscented", "extended")]
        page.show(
            f"{kind}: median error over the spread, sigma points {sizes[0]:.1e}, Jacobian {sizes[1]:.1e}"
        )
    page.check("fixedpoint.section-2c.mean-error", np.median(predicted["extended_mean"]))
    page.conclude(
        "Sigma points predict the mean better in {mean:.0%} of the draws and the covariance in {spread:.0%}; the Jacobian's mean errs by "
        "{error:.1e} of the computed standard deviation.",
        mean=np.mean(predicted["unscented_mean"] < 0.999 * predicted["extended_mean"]),
        spread=np.mean(predicted["unscented_covariance"] < 0.999 * predicted["extended_covariance"]),
        error=np.median(predicted["extended_mean"]),
    )


def _of_cost(page, study: dict[str, Study]) -> None:
    page.text("""## What a sample costs

Compiled filters at their printed settings, timed by `benchmarks/fixedpoint.py --write` (machine: `data/fixedpoint/SOURCE.md`).""")
    cost = {
        name: time["median_ns"] for name, time in measured_times("fixedpoint", "filter_times.csv").items()
    }
    for name in study:
        error = 1e3 * study[name]["velocity"].mean()
        page.show(
            f"{called(name):22s} {cost[name]:.0f} ns a sample, {cost[name] / cost[LOW_PASS]:.0f} times the low pass, error {error:.1f} mm/s"
        )
    page.check(
        "fixedpoint.section-4.low-pass-cheapest", float(cost[LOW_PASS] < min(cost[WINDOW], cost[KALMAN]))
    )
