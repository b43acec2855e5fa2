"""Speed of the isolation topic beside named peers, measured in one run: `make bench`.

Times are processor time of the one thread that works, which other programs disturb less than the clock; medians
over repeats that take the contenders in turn, so that a busy machine slows all of them alike.
With `--write` the times of the update forms are stored in `data/isolation/update_times/` for notebook 06.
"""

import ctypes
import os
import sys
import time
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "lib"), str(ROOT)]
os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")

import numpy as np  # noqa: E402

from benchmarks.timing import compiled, in_turn, judged, machine, write_times  # noqa: E402
from experiments.isolation import loop, simulation, sources  # noqa: E402
from experiments.isolation.floors import flat_floor  # noqa: E402
from experiments.isolation.twin import load_twin  # noqa: E402
from stillwork.estimation.adaptive import FeLms, FeRls, ferls_update  # noqa: E402
from stillwork.estimation.online import run_felms, run_ferls  # noqa: E402

ACTUATORS, REGRESSORS = 6, 9
FORGETTING = float(np.exp(-2e-4 / 10))
REPEATS = 9

C_SOURCE = r"""
/* The update of eq. (29)-(30) as one would write it by hand, sizes known to the compiler. */
enum { N = 9, M = 6 };
void run(double *w, double *p, const double *psi, const double *e, double lambda, long samples) {
    double g[N];
    for (long k = 0; k < samples; k++, psi += N, e += M) {
        double den = lambda, forget = 1 / lambda, shrink;
        for (int i = 0; i < N; i++) {
            double sum = 0;
            for (int j = 0; j < N; j++) sum += p[i * N + j] * psi[j];
            g[i] = sum;
            den += sum * psi[i];
        }
        shrink = 1 / den;
        for (int i = 0; i < N; i++)
            for (int j = 0; j <= i; j++)
                p[j * N + i] = p[i * N + j] = (p[i * N + j] - g[i] * shrink * g[j]) * forget;
        for (int i = 0; i < N; i++) g[i] *= shrink;
        for (int a = 0; a < M; a++)
            for (int i = 0; i < N; i++) w[a * N + i] -= e[a] * g[i];
    }
}
"""


def main() -> None:
    updates, loops = update_times(), loop_times()
    taken = {name: float(np.median(times)) for name, times in {**updates, **loops}.items()}
    recursion, rows = taken["recursion"], []
    if "C" in updates:
        rows.append(("update 9 x 6: numba / C (gcc -O3 -march=native)", recursion / taken["C"], "<= 2.5"))
    for peer, name in (("padasip", "padasip FilterRLS"), ("pyroomacoustics", "pyroomacoustics RLS")):
        rows.append((f"update 9 x 6: {name} per output / numba", taken[peer] / recursion, ">= 400"))
    safe = taken["recursion in float32"] / recursion
    rows.append(("update 9 x 6: float32 safe form / triangle in float64", safe, "<= 1.5"))
    rows.append(("update 9 x 6: FeRLS / FeLMS alone", recursion / taken["FeLMS"], ""))
    felms, ferls = (taken[f"closed loop {name}"] for name in ("FeLMS", "FeRLS"))
    rows.append(("closed loop with FeRLS, floor drawn before, us per sample", 1e6 * ferls, "<= 0.5"))
    whole = 1e6 * taken["simulation FeRLS"]
    rows.append(("simulate with FeRLS, floor and all, us per sample", whole, "<= 0.5"))
    rows.append(("closed loop: FeRLS / FeLMS", ferls / felms, "<= 1.3"))
    for name, plain in (("FeLMS", felms), ("FeRLS", ferls)):
        modified = taken[f"closed loop {name}, modified error"]
        rows.append((f"closed loop with {name}: modified / plain error", modified / plain, "<= 1.3"))

    print(f"{machine('numba')}; median of {REPEATS} repeats")
    print(
        "\nupdate of 9 regressors x 6 outputs, and closed loop: microseconds per sample (lowest .. highest)"
    )
    for name, times in {**updates, **loops}.items():
        print(
            f"  {name:38s} {1e6 * np.median(times):10.3f}   ({1e6 * min(times):.3f} .. {1e6 * max(times):.3f})"
        )
    print()
    for name, value, target in rows:
        print(f"  {name:56s} {value:9.3g}   {target:8s} {judged(value, target)}")
    if "--write" in sys.argv[1:]:
        write({**updates, **loops})


def update_times() -> dict[str, list[float]]:
    rng = np.random.default_rng(0)
    samples = 100_000
    psi = rng.standard_normal((samples, REGRESSORS))
    error = 1e-3 * rng.standard_normal((samples, ACTUATORS))

    def start():
        return np.zeros((ACTUATORS, REGRESSORS)), np.eye(REGRESSORS) * (1 - FORGETTING)

    def recursion(**settings):
        def run():
            weights, covariance = start()
            state = FeRls(covariance, FORGETTING, **settings).start(REGRESSORS)
            history = np.empty((0, ACTUATORS, REGRESSORS))
            arrays = [array.astype(state.matrix.dtype) for array in (weights, psi, error)]
            begin = time.thread_time()
            run_ferls(
                arrays[0], state, *state[-2:], *arrays[1:], False, np.inf, history, samples + 1, False, 0
            )
            return time.thread_time() - begin, samples

        return run

    def felms():
        weights, _ = start()
        history = np.empty((0, ACTUATORS, REGRESSORS))
        begin = time.thread_time()
        run_felms(weights, 1e-4, 1e-5, 1.0, psi, error, False, np.inf, history, samples + 1, False)
        return time.thread_time() - begin, samples

    def inverse(copies):
        """The information matrix of `copies` blocks, inverted at every sample by LAPACK through numpy."""

        def run(count=200):
            weights, _ = start()
            w = weights.ravel()
            information = np.eye(copies * REGRESSORS)
            matrices = [np.kron(np.eye(copies), psi[k]) for k in range(count)]
            begin = time.thread_time()
            for k in range(count):
                matrix = matrices[k]
                information *= FORGETTING
                information += matrix.T @ matrix
                gain = np.linalg.inv(information)
                if copies == ACTUATORS:
                    w -= gain @ (matrix.T @ error[k])
                else:
                    weights -= np.outer(error[k], gain @ psi[k])
            return time.thread_time() - begin, count

        return run

    contenders = {
        "recursion": recursion(),
        "recursion in float32": recursion(dtype="float32"),
        "FeLMS": felms,
        "block inverse": inverse(1),
        "full inverse": inverse(ACTUATORS),
        **peers(psi, error),
        **by_hand(psi, error, start),
    }
    return in_turn(contenders, REPEATS)


def peers(psi, error) -> dict:
    """Published filters, one per output, because none of them shares the covariance."""
    from padasip.filters import FilterRLS
    from pyroomacoustics.adaptive import RLS

    count = 200

    def padasip():
        filters = [FilterRLS(REGRESSORS, mu=FORGETTING, eps=1.0, w="zeros") for _ in range(ACTUATORS)]
        begin = time.thread_time()
        for k in range(count):
            for a, one in enumerate(filters):
                one.adapt(error[k, a], psi[k])
        return time.thread_time() - begin, count

    def pyroomacoustics():
        filters = [RLS(REGRESSORS, lmbd=FORGETTING, delta=1.0, dtype=np.float64) for _ in range(ACTUATORS)]
        begin = time.thread_time()
        for k in range(count):
            for a, one in enumerate(filters):
                one.update(psi[k, 0], error[k, a])
        return time.thread_time() - begin, count

    return {"padasip": padasip, "pyroomacoustics": pyroomacoustics}


def by_hand(psi, error, start) -> dict:
    """Hand-written C, where there is a compiler; checked to give the same weights."""
    if not (library := compiled({"update.c": C_SOURCE}, "-O3", "-march=native")):
        return {}
    run_c = library.run
    pointer = ctypes.POINTER(ctypes.c_double)
    run_c.argtypes = [pointer, pointer, pointer, pointer, ctypes.c_double, ctypes.c_long]

    def call(samples):
        weights, covariance = start()
        arrays = [array.ctypes.data_as(pointer) for array in (weights, covariance, psi, error)]
        begin = time.thread_time()
        run_c(*arrays, FORGETTING, samples)
        return time.thread_time() - begin, weights

    weights, covariance = start()
    for k in range(1000):
        levels, gain = np.full((4, REGRESSORS), np.inf), np.empty(REGRESSORS)
        ferls_update(weights, covariance, FORGETTING, levels, np.inf, gain, psi[k], error[k])
    if not np.allclose(call(1000)[1], weights, rtol=1e-9, atol=1e-12):
        raise SystemExit("the C update gives other weights than the kernel")
    return {"C": lambda: (call(len(psi))[0], len(psi))}


def loop_times() -> dict[str, list[float]]:
    """Closed loop of the rigid-body twin, alone and with floor and noise drawn; times as in `in_turn`."""
    twin, seconds = load_twin("rigid_body"), 20.0
    covariance = np.full(twin.regressors, 0.6)  # about the steady value on this floor
    algorithms = {"FeLMS": FeLms(), "FeRLS": FeRls(covariance)}
    samples = round(seconds / twin.sample_time)
    drawn_from = sources.Sources(twin, [(samples, flat_floor())], True, [0])
    blocks = [drawn_from.sample(simulation.BLOCK) for _ in range(samples // simulation.BLOCK)]

    def alone(settings, delay=None):
        law, start = simulation.algorithm_of(twin, replace(settings, path_delay=delay))
        kept = simulation.KeptSignals(twin, simulation.BLOCK, simulation.BLOCK, simulation.BLOCK, 1)

        def run():
            closed = loop.loop_of(twin, True, np.zeros((1, twin.actuators, twin.regressors)), start, delay)
            signals = kept.block(0, simulation.BLOCK)
            begin = time.thread_time()
            for floor, noise in blocks:
                loop.advance(
                    floor,
                    noise,
                    closed,
                    signals,
                    simulation.BLOCK,
                    0,
                    law,
                    *closed.recursion[-2:],
                    np.inf,
                )
            return time.thread_time() - begin, len(blocks) * simulation.BLOCK

        return run

    def drawn(settings, seeds=(0,)):
        def run():
            begin = time.thread_time()
            simulation.simulate_together(twin, flat_floor(), seconds, adaptations={"": settings}, seeds=seeds)
            return time.thread_time() - begin, samples * len(seeds)

        return run

    contenders = {f"closed loop {name}": alone(settings) for name, settings in algorithms.items()}
    contenders |= {
        f"closed loop {name}, modified error": alone(settings, 2) for name, settings in algorithms.items()
    }
    contenders |= {f"simulation {name}": drawn(settings) for name, settings in algorithms.items()}
    seeds = range(simulation.TOGETHER)
    contenders |= {
        f"{len(seeds)} seeds together {name}": drawn(settings, seeds) for name, settings in algorithms.items()
    }
    return in_turn(contenders, REPEATS)


def write(times: dict[str, list[float]]) -> None:
    write_times(
        "isolation/update_times/update_times.csv",
        "form",
        "us",
        1e6,
        times,
        "Measured times of one update of 9 regressors x 6 outputs, and of the closed loop around it: microseconds per sample,\n"
        f"median, lowest and highest of {REPEATS} repeats; written by `python benchmarks/isolation.py --write`, which describes\n"
        "each form. Measured, not computed: another machine gives other times, which is why notebook 06 reads this file.\n\n"
        f"Machine: {machine('numba')}; other programs were running.",
    )


if __name__ == "__main__":
    main()
