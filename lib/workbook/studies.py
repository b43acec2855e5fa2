"""Seeded Monte Carlo: one trial, many independent random streams, intervals."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri, stdtrit

from workbook.checks import InputError, require_array, require_count, require_number
from workbook.paths import in_batch


@dataclass(frozen=True)
class Study:
    """What every trial of a study gave.

    Attributes
    ----------
    seed : int
        Root of all random streams: trial k draws from ``SeedSequence(seed).spawn(runs)[k]``.
    values : dict of str to ndarray, shape (runs, ...)
        One array a quantity, trials along the first axis.
    """

    seed: int
    values: Mapping[str, np.ndarray]

    @property
    def runs(self) -> int:
        """Number of trials."""
        return len(next(iter(self.values.values())))

    def __getitem__(self, quantity: str) -> np.ndarray:
        return self.values[quantity]


def run_study(
    trial: Callable[..., Mapping[str, float | np.ndarray]],
    runs: int,
    seed: int,
    *,
    together: int = 1,
    progress: bool = True,
    **settings,
) -> Study:
    """Run ``trial(rng, **settings)`` once for each of `runs` independent random streams.

    Parameters
    ----------
    trial : callable
        Takes a `numpy.random.Generator` and the settings; returns a mapping from quantity to number or
        array.
    runs : int
        Number of trials.
    seed : int
        Root seed.
    together : int
        How many trials one call makes: above 1 the trial takes a list of that many generators, at the end fewer, and
        returns a list with a mapping for each.
    progress : bool
        Show a progress bar, where a person is looking.
    **settings
        Passed to every trial.

    Raises
    ------
    InputError
        When `runs` is not a positive whole number or trials return different quantities.
    """
    runs = require_count("runs", runs)
    together = require_count("together", together)
    streams = np.random.SeedSequence(seed).spawn(runs)
    calls = [streams[first : first + together] for first in range(0, runs, together)]
    one = partial(_run_some, trial, settings, together > 1)
    outcomes = map(one, calls)
    if progress and not in_batch():
        from tqdm.auto import tqdm

        outcomes = tqdm(outcomes, total=len(calls), desc=getattr(trial, "__name__", "study"))
    outcomes = [outcome for some in outcomes for outcome in some]
    if len(outcomes) != runs:
        raise InputError(f"trial gave {len(outcomes)} mappings for {runs} generators; return one for each")
    if any(outcome.keys() != outcomes[0].keys() for outcome in outcomes):
        raise InputError("trial returned different quantities in different runs; return all of them")
    return Study(seed, {key: np.array([o[key] for o in outcomes]) for key in outcomes[0]})


def _run_some(trial, settings, several, streams) -> list[dict]:
    draws = [np.random.default_rng(stream) for stream in streams]
    return [dict(each) for each in (trial(draws, **settings) if several else [trial(draws[0], **settings)])]


def mean_interval(values, level: float = 0.95) -> tuple[float, float]:
    """Confidence interval of the mean of independent runs (Student's t)."""
    values = require_array("values", values, ndim=1)
    require_number("level", level, above=0, below=1)
    if len(values) < 2:
        raise InputError("values holds one run; an interval takes at least 2")
    half = stdtrit(len(values) - 1, 0.5 + level / 2) * values.std(ddof=1) / np.sqrt(len(values))
    return float(values.mean() - half), float(values.mean() + half)


def spread_interval(values, level: float = 0.95) -> tuple[float, float]:
    """Prediction interval: where the next single run falls with probability `level` (Student's t).

    A published experiment is one run, so this is what it is compared with.
    """
    values = require_array("values", values, ndim=1)
    low, high = mean_interval(values, level)
    half = (high - low) / 2 * np.sqrt(len(values) + 1)
    return float(values.mean() - half), float(values.mean() + half)


def proportion_interval(successes: float | np.number, runs: int | np.integer) -> tuple[float, float]:
    """Wilson's (1927) interval of 95 % of a proportion; `successes` may be a share times the runs, no whole number."""
    require_count("runs", runs)
    require_number("successes", successes, at_least=0, at_most=runs)
    share, normal = successes / runs, ndtri(0.975)
    middle = share + normal**2 / (2 * runs)
    half = normal * np.sqrt(share * (1 - share) / runs + normal**2 / (4 * runs**2))
    whole = 1 + normal**2 / runs
    # At a share of 0 or 1 an end is the share itself, which rounding would miss.
    low, high = float((middle - half) / whole), float((middle + half) / whole)
    return 0.0 if share == 0 else low, 1.0 if share == 1 else high


def fraction(holds: ArrayLike) -> tuple[float, tuple[float, float]]:
    """Share of what holds, with Wilson's interval over the runs (first axis).

    Parts of a run are not independent: they make its share, and the runs alone are counted.
    """
    holds = require_array("holds", np.asarray(holds, float))
    runs = len(holds)
    return float(holds.mean()), proportion_interval(int(np.floor(holds.mean() * runs + 1e-9)), runs)
