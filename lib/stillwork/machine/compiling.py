"""The command ``compile``: machine code of what runs an estimator or a filter, once after an installation.

Numba compiles a kernel at its first call and keeps it on disk; until then each first call takes seconds.
"""

import time
import warnings
from collections.abc import Callable
from itertools import product

import numpy as np

from stillwork import estimation
from stillwork.estimation.coordinate_filters import MovingWindow, SavitzkyGolay
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
        step()
    return lines


def first_calls() -> dict[str, Callable]:
    """By name, a call that compiles all that a longer one runs."""
    rng = np.random.default_rng(1)
    rows, outputs = rng.standard_normal((2, SAMPLES)), rng.standard_normal((1, SAMPLES))
    plant = estimation.Plant(_acceleration, _force, np.array([1.0]))

    def adapt(settings) -> None:
        estimation.identify(settings, rows, outputs)
        estimation.adapt(settings, rows, outputs)
        estimation.AdaptationStepper(settings, np.zeros((1, 2)))

    calls = {
        f"FeRls {dtype} {form}": lambda form=form, dtype=dtype: adapt(
            estimation.FeRls(1.0, 0.99, form=form, dtype=dtype)
        )
        for form, dtype in product(("triangle", "UD"), ("float64", "float32"))
    }
    calls |= {
        "FeLms": lambda: adapt(estimation.FeLms()),
        "RecursiveLeastSquares": estimation.RecursiveLeastSquares,
        "MinMaxRegressor": lambda: estimation.MinMaxRegressor(0.1).fit(rows.T, outputs[0]),
        "LeastMeanSquares": estimation.LeastMeanSquares,
        "track": lambda: estimation.track(rows, outputs[0], 0.99),
    }
    filters = (
        estimation.LowPass(),
        MovingWindow(),
        SavitzkyGolay(),
        estimation.ExtendedKalman(plant),
        estimation.UnscentedKalman(plant),
    )
    return calls | {
        type(each).__name__: lambda each=each: estimation.filter_signal(
            each, np.zeros(100), force=np.zeros(100)
        )
        for each in filters
    }


def _acceleration(position, velocity, force, parameters):
    return force / parameters[0]


def _force(position, velocity, acceleration, parameters):
    return acceleration * parameters[0]
