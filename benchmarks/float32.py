"""A thousand million samples in float32 on the record that drives all three floor sensors: is anything lost?

The regressors are those of the shipped slab floor (notebook 08), repeated; their scaled condition number is 8e6. The
float32 default runs over all samples, float64 over as many as its own memory needs; both see the rounded record.
Held against each other are the residual and what one motion of three sensors determines of the weights: their sum
over the sensors, by actuator and power of the weak integrator.

Run with `nice python benchmarks/float32.py [samples]`. Each tenth of the way it prints a line and keeps its state in
`build/float32/`; stopped, it goes on from there, and from the end of fewer samples to more. Remove that folder to
begin anew.
"""

import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "lib"))

import numpy as np  # noqa: E402

from experiments.isolation import load_twin, simulate  # noqa: E402
from experiments.isolation.recorded_floors import record_floor  # noqa: E402
from stillwork.estimation.adaptive import FeRls  # noqa: E402
from stillwork.estimation.online import run_ferls  # noqa: E402
from stillwork.signals import load_record  # noqa: E402
from workbook import paths  # noqa: E402

FORGETTING = float(np.exp(-2e-4 / 10))
MEMORY = 100  # time constants that the float64 reference runs


def slab_record() -> tuple[np.ndarray, np.ndarray]:
    """psi_N, (samples, regressors), and the error of zero weights, (samples, actuators), as float32 holds them."""
    slab = load_record(paths.data("isolation", "slab_footfall/slab_vertical.csv"), "m/s^2")
    run = simulate(load_twin("rigid_body"), record_floor(slab), signals_from_s=5.0, seed=1)
    return tuple(
        np.ascontiguousarray(signals.T.astype(np.float32)) for signals in (run.filtered_regressors, run.error)
    )


def settled(dtype: str, regressors, disturbance, passes: int, growth_limit: float, lines: int):
    """Weights after so many passes over the record, seconds of processor time, and the recursion."""
    power = np.mean(regressors.astype(float) ** 2, axis=0)
    settings = FeRls((1 - FORGETTING) / power, FORGETTING, growth_limit, dtype=dtype)
    recursion = settings.start(regressors.shape[1])
    weights = np.zeros((disturbance.shape[1], regressors.shape[1]), dtype)
    kept = paths.root() / "build" / "float32" / f"{dtype}-{growth_limit:g}.npz"
    done, seconds = resume(kept, weights, recursion, passes)
    history, record = np.empty((0, *weights.shape)), (regressors.astype(dtype), disturbance.astype(dtype))
    every = max(passes // lines, 1)
    while done < passes:
        begin = time.thread_time()
        ran, definite = run_ferls(
            weights, recursion, *recursion[-2:], *record, True, np.inf, history, len(regressors) + 1, False, 0
        )
        if ran < len(regressors) or not np.all(np.isfinite(weights)):
            raise SystemExit(f"{dtype}: lost at sample {done * len(regressors) + ran}, definite: {definite}")
        done, seconds = done + 1, seconds + time.thread_time() - begin
        if done % every == 0 or done == passes:
            keep(kept, weights, recursion, done, seconds)
            left = residual(regressors, disturbance, weights)
            print(f"  {dtype}: {done * len(regressors):.3g} samples, residual {left:.6f}", flush=True)
    return weights, seconds, recursion


def resume(kept: Path, weights, recursion, passes: int) -> tuple[int, float]:
    """Passes and seconds of a run that was stopped, whose state is put into the arrays; none of a longer run."""
    if kept.exists():
        with np.load(kept) as state:
            if state["done"] <= passes:
                weights[:], recursion.matrix[:] = state["weights"], state["matrix"]
                recursion.levels[:] = state["levels"]
                return int(state["done"]), float(state["seconds"])
    return 0, 0.0


def keep(kept: Path, weights, recursion, done: int, seconds: float) -> None:
    """Keep the state whole or not at all."""
    kept.parent.mkdir(parents=True, exist_ok=True)
    beside = kept.with_suffix(".new.npz")
    state = {"weights": weights, "matrix": recursion.matrix, "levels": recursion.levels}
    np.savez(beside, **state, done=done, seconds=seconds)
    beside.replace(kept)


def residual(regressors, disturbance, weights) -> float:
    """Rms of the error that the weights leave over that of zero weights."""
    return float((disturbance + regressors @ weights.T.astype(float)).std() / disturbance.std())


def sums(weights) -> np.ndarray:
    """Sum over the three sensors of the weights of each power, (actuators, powers)."""
    return weights.astype(float).reshape(len(weights), -1, 3).sum(axis=2)


def main() -> None:
    samples = float(sys.argv[1]) if len(sys.argv) > 1 else 1e9
    regressors, disturbance = slab_record()
    for growth_limit, share in ((10.0, 1.0), (np.inf, 0.1)):
        passes = -(-int(samples * share) // len(regressors))
        reference = -(-round(MEMORY / (1 - FORGETTING)) // len(regressors))
        print(f"growth limit {growth_limit:g}: {passes * len(regressors):.4g} samples in float32")
        exact, _, _ = settled("float64", regressors, disturbance, reference, growth_limit, 1)
        found, seconds, recursion = settled("float32", regressors, disturbance, passes, growth_limit, 10)
        left = residual(regressors, disturbance, found) / residual(regressors, disturbance, exact) - 1
        off = np.abs(sums(found) - sums(exact)).max(axis=0) / np.abs(sums(exact)).max(axis=0)
        print(
            f"  float32 / float64 - 1: residual {left:.1e}, sums over the sensors by power of the integrator at most",
            *[f"{each:.1e}" for each in off],
        )
        print(
            f"  {seconds:.0f} s of processor time, {1e9 * seconds / passes / len(regressors):.0f} ns a sample; "
            f"held by the limit: {recursion.held.round(2)}"
        )


if __name__ == "__main__":
    main()
