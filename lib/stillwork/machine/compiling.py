"""The command ``compile``: machine code of what runs an estimator or a filter, once after an installation.

Numba compiles a kernel at its first call and keeps it on disk; until then each first call takes seconds.
"""

import time
import warnings
from collections.abc import Callable
from functools import partial
from itertools import product

import numpy as np

from stillwork.estimation.adaptive import FeLms, FeRls
from stillwork.estimation.coordinate_filters import (
    ExtendedKalman,
    LowPass,
    MovingWindow,
    SavitzkyGolay,
    UnscentedKalman,
)
from stillwork.estimation.filtering import filter_signal
from stillwork.estimation.least_mean_squares import LeastMeanSquares
from stillwork.estimation.min_max_regression import MinMaxRegressor
from stillwork.estimation.online import AdaptationStepper, adapt, identify
from stillwork.estimation.plant import Plant
from stillwork.estimation.recursive import track
from stillwork.machine.progress import count_steps

SAMPLES = 12  # so few that only the compiler takes time


def compile_kernels() -> list[str]:
    """Compile the kernels of the adaptations, the linear estimators and the filters; a line for each with its seconds."""
    calls = first_calls()
    step, lines = count_steps(len(calls), "compiled"), []
    for name, call in calls.items():
        began = time.monotonic()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            call()
        lines.append(f"{name:24s} {time.monotonic() - began:5.1f} s")
        step(name)
    return lines


def first_calls() -> dict[str, Callable[[], object]]:
    """By name, a call that compiles all that a longer one runs."""
    rng = np.random.default_rng(1)
    rows, outputs = rng.standard_normal((2, SAMPLES)), rng.standard_normal((1, SAMPLES))
    plant = Plant(_acceleration, _force, np.array([1.0]))

    def run(settings: FeLms | FeRls) -> None:
        identify(settings, rows, outputs)
        adapt(settings, rows, outputs)
        AdaptationStepper(settings, np.zeros((1, 2)))

    calls: dict[str, Callable[[], object]] = {"FeLms": partial(run, FeLms())}
    for form, dtype in product(("triangle", "UD"), ("float64", "float32")):
        calls[f"FeRls {dtype} {form}"] = partial(run, FeRls(1.0, 0.99, form=form, dtype=dtype))
    calls["track"] = lambda: track(rows, outputs[0], 0.99)
    calls["RecursiveLeastSquares"] = lambda: MinMaxRegressor(0.1).fit(rows.T, outputs[0])  # one kernel
    calls["LeastMeanSquares"] = LeastMeanSquares
    for each in (LowPass(), MovingWindow(), SavitzkyGolay(), ExtendedKalman(plant), UnscentedKalman(plant)):
        calls[type(each).__name__] = partial(filter_signal, each, np.zeros(100), force=np.zeros(100))
    return calls


def _acceleration(position, velocity, force, parameters):
    return force / parameters[0]


def _force(position, velocity, acceleration, parameters):
    return acceleration * parameters[0]
