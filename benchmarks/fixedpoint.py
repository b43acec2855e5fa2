"""Time of the fixed-point topic's filters beside one another, measured in one run: `make bench`.

Times are processor time of one thread, medians over repeats that take the contenders in turn, so that a busy
machine slows all of them alike.
With `--write` the filters' times are stored in `data/fixedpoint/filter_times.csv` for notebook 07.
"""

import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "lib"), str(ROOT)]

import numpy as np  # noqa: E402

from benchmarks import timing  # noqa: E402
from experiments.fixedpoint import (  # noqa: E402
    added_controllers,
    load_oscillator,
    published_controllers,
)
from stillwork.estimation.filtering import filter_record, model_of  # noqa: E402

SAMPLE_TIME = 1e-3
SAMPLES = 20_000
REPEATS = 9


def main() -> None:
    approximate = load_oscillator()["approximate"].plant
    print(f"machine: {timing.machine('numba')}")
    times = filter_times(approximate)
    if "--write" in sys.argv:
        write(times)


def record() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    time_axis = np.arange(SAMPLES) * SAMPLE_TIME
    measured = np.sin(2 * np.pi * 0.2 * time_axis) + 1e-4 * rng.standard_normal(SAMPLES)
    return measured, 100 * np.sin(2 * np.pi * 0.2 * time_axis)


def runner(signal_filter):
    """A call of the filter's kernel over the record, with fresh workspace."""
    measured, force = record()
    model, estimates = model_of(signal_filter), np.empty((SAMPLES, 3))

    def run():
        done = filter_record(
            signal_filter.packed(), *model, measured, force, SAMPLE_TIME, np.zeros(3), estimates
        )
        assert done == SAMPLES
        return estimates

    return run


def filter_times(approximate) -> dict[str, list[float]]:
    """Seconds a sample."""
    controllers = published_controllers(approximate) | added_controllers(approximate)
    contenders = {name: runner(controller.signal_filter) for name, controller in controllers.items()}
    times = timing.in_turn(contenders, REPEATS, SAMPLES)
    print("\nfilters, ns a sample (median, lowest .. highest of", REPEATS, "repeats)")
    for name, each in times.items():
        print(f"  {name:24s} {1e9 * np.median(each):7.0f}  {1e9 * min(each):7.0f} .. {1e9 * max(each):.0f}")
    return times


def write(times) -> None:
    """The table that notebook 07 reads, and the machine it was measured on."""
    timing.write_times(
        "fixedpoint/filter_times.csv",
        "filter",
        "ns",
        1e9,
        times,
        f"Nanoseconds of processor time a sample of each filter's kernel, published settings: median, lowest and highest of {REPEATS}\n"
        f"repeats over {SAMPLES} samples, written by `python benchmarks/fixedpoint.py --write`. Measured, not computed: another\n"
        "machine gives other times, which is why notebook 07 reads this file.\n\n"
        f"Machine: {timing.machine('numba')}; other programs were running.",
    )


if __name__ == "__main__":
    main()
