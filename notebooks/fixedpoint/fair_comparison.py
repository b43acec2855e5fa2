"""The fair comparison: every filter tuned with the same budget on the same training noise."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from experiments.fixedpoint.metrics import QUANTITIES, judge
from experiments.fixedpoint.noise import Noise
from experiments.fixedpoint.published import EXTENDED, INTEGRATION, KALMAN, LOW_PASS, POLYNOMIAL, WINDOW
from stillwork.base.checks import InputError, require_choice, require_count
from stillwork.control.fixed_point import Controller, simulate
from stillwork.control.kinematics import KinematicDesign
from stillwork.control.trajectory import Trajectory
from stillwork.control.transformation import RobustTransformation
from stillwork.estimation.coordinate_filters import (
    ExtendedKalman,
    LowPass,
    MovingWindow,
    SavitzkyGolay,
    UnscentedKalman,
)
from stillwork.estimation.plant import Plant

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
            lambda model, sample_time, bandwidth: LowPass(min(bandwidth, 1.9 / sample_time)),
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
    from scipy.optimize import minimize
    from scipy.stats import qmc

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

    sobol = qmc.Sobol(len(low), rng=np.random.default_rng(seed)).random_base2(int(np.log2(budget / 2)))
    points = np.clip(low + sobol * (high - low), low, high)
    seen = [means(point) for point in points]

    def best_by(criterion) -> Tuned:
        tried = [(each[criterion], point) for each, point in zip(seen, points, strict=True)]

        def cost(knobs):
            knobs = np.clip(knobs, low, high)
            tried.append((means(knobs)[criterion], knobs))
            return min(tried[-1][0], 1e3)  # the simplex needs finite numbers

        starts = [knobs for _, knobs in sorted(tried, key=lambda t: t[0])[:STARTS]]
        for number, start in enumerate(starts):
            left = (budget - len(tried)) // (len(starts) - number)
            steps = 0.1 * (high - low) * np.where(start + 0.1 * (high - low) > high, -1.0, 1.0)
            simplex = np.vstack([start, start + np.diag(steps)])
            options = {"initial_simplex": simplex, "maxfev": left, "xatol": 1e-12, "fatol": 0.0}
            minimize(cost, start, method="Nelder-Mead", options=options)
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
