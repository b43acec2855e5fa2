"""A thousand million samples in float32 on the record that drives all three floor sensors: is anything lost?

The regressors are those of the shipped slab floor (notebook 08), repeated; their scaled condition number is 8e6. The
float32 default runs over all samples, float64 over as many as its own memory needs; both see the rounded record.
Run with `nice python benchmarks/float32.py [samples]`; it prints a line each tenth of the way.
"""

import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "lib"))

import numpy as np  # noqa: E402

from experiments.isolation import load_twin, simulate  # noqa: E402
from experiments.isolation.recorded_floors import record_floor  # noqa: E402
from stillwork.base import paths  # noqa: E402
from stillwork.estimation.adaptive import FeRls  # noqa: E402
from stillwork.estimation.online import run_ferls  # noqa: E402
from stillwork.signals import load_record  # noqa: E402

FORGETTING = float(np.exp(-2e-4 / 10))
MEMORY = 100  # time constants that the float64 reference runs


def slab_record() -> tuple[np.ndarray, np.ndarray]:
    """psi_N, (samples, regressors), and the error of zero weights, (samples, actuators), as float32 holds them."""
    slab = load_record(paths.data("isolation", "slab_footfall/slab_vertical.csv"), "m/s^2")
    run = simulate(load_twin("rigid_body"), record_floor(slab), signals_from_s=5.0, seed=1)
    return tuple(
        np.ascontiguousarray(signals.T.astype(np.float32)) for signals in (run.filtered_regressors, run.error)
    )


def left_over(dtype: str, regressors, disturbance, passes: int, growth_limit: float, told: bool):
    """Rms of the residual with the weights after so many passes, over that of zero weights; seconds; the recursion."""
    power = np.mean(regressors.astype(float) ** 2, axis=0)
    settings = FeRls((1 - FORGETTING) / power, FORGETTING, growth_limit, dtype=dtype)
    recursion = settings.start(regressors.shape[1])
    weights = np.zeros((disturbance.shape[1], regressors.shape[1]), dtype)
    history, begin = np.empty((0, *weights.shape)), time.thread_time()
    record = regressors.astype(dtype), disturbance.astype(dtype)
    for k in range(passes):
        done, definite = run_ferls(
            weights, recursion, *recursion[-2:], *record, True, np.inf, history, len(regressors) + 1, False
        )
        if done < len(regressors) or not np.all(np.isfinite(weights)):
            raise SystemExit(f"{dtype}: lost at sample {k * len(regressors) + done}, definite: {definite}")
        if told and (k + 1) % max(passes // 10, 1) == 0:
            error = disturbance + regressors @ weights.T.astype(float)
            print(
                f"  {(k + 1) * len(regressors):.3g} samples, residual {error.std() / disturbance.std():.6f}",
                flush=True,
            )
    error = disturbance + regressors @ weights.T.astype(float)
    return error.std() / disturbance.std(), time.thread_time() - begin, recursion


def main() -> None:
    samples = float(sys.argv[1]) if len(sys.argv) > 1 else 1e9
    regressors, disturbance = slab_record()
    for growth_limit, share in ((10.0, 1.0), (np.inf, 0.1)):
        passes = -(-int(samples * share) // len(regressors))
        reference = -(-round(MEMORY / (1 - FORGETTING)) // len(regressors))
        print(f"growth limit {growth_limit:g}: {passes * len(regressors):.4g} samples in float32")
        exact, _, _ = left_over("float64", regressors, disturbance, reference, growth_limit, False)
        found, seconds, recursion = left_over("float32", regressors, disturbance, passes, growth_limit, True)
        print(
            f"  residual float32 / float64 - 1: {found / exact - 1:.1e}; {seconds:.0f} s of processor time, "
            f"{1e9 * seconds / passes / len(regressors):.0f} ns a sample; held by the limit: {recursion.held.round(2)}"
        )


if __name__ == "__main__":
    main()
