"""Speed of the worstcase topic beside named peers, measured in one run: `make bench`.

A time is CPU time, the lowest of many short repeats that take the contenders in turn: other work on the machine can
only add to it.

Of the updates, ``RLS`` is the covariance recursion (one output of `identify`), the others are those that notebook 03 judges,
as printed; ``triangle`` and ``triangle, min-max`` are what the library keeps of a record, least squares and min-max.

With `--write` the times against n go to `data/worstcase/update_times/` for notebook 03.
"""

import csv
import ctypes
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "lib"), str(ROOT)]

import numpy as np  # noqa: E402

from benchmarks.timing import compiled, judged, machine  # noqa: E402
from notebooks.worstcase.geometry import solve_cone_program  # noqa: E402
from notebooks.worstcase.time_updates import UPDATES, run_printed, slope  # noqa: E402
from stillwork.estimation import FeRls, MinMaxRegressor, RecursiveLeastSquares, identify, track  # noqa: E402
from stillwork.machine import least_squares_code  # noqa: E402

FORGETTING, BOUND = 0.95, 1.34  # of Fig. 2
SIZES = (5, 10, 20, 50, 100, 200)
REPEATS = 25
RUN_SECONDS = 2e-3  # length of one repeat

KERNELS = {
    "RLS": lambda rows, y: identify(FeRls(1e4, FORGETTING, np.inf), rows, -y[None], every=len(y) + 1),
    "triangle": lambda rows, y: track(rows, y, FORGETTING),
    "triangle, min-max": lambda rows, y: track(rows, y, FORGETTING, bound=BOUND, silent=True),
    "ridge": lambda rows, y: track(rows, y, FORGETTING, penalty=1.0),
    **{
        name.replace("_", " "): lambda rows, y, how=how: run_printed(*how, rows, y, BOUND, FORGETTING)
        for name, how in UPDATES.items()
    },
}


def main() -> None:
    print(f"{machine()}; one thread; lowest of {REPEATS} repeats (and their median)\n")
    small = update_times(5) | peer_times(5) | call_times(5) | record_times(5)
    print("one update at n = 5                      microseconds")
    for name, times in small.items():
        print(f"  {name:36s} {min(times):10.3f}   ({np.median(times):.3f})")

    cone = "SOCP, Clarabel alone, reduced data"
    rows = [
        ("approximate / RLS kernel", "approximate 1", "RLS", ""),
        ("exact / RLS kernel", "exact", "RLS", ""),
        ("triangle / RLS kernel", "triangle", "RLS", ""),
        ("SOCP (Clarabel alone, reduced data) / approximate", cone, "approximate 1", ">= 500"),
        ("padasip RLS / RLS kernel", "padasip RLS", "RLS", ""),
        ("padasip RLS / approximate kernel", "padasip RLS", "approximate 1", ""),
        ("RLS, partial_fit / padasip RLS", "RLS, partial_fit", "padasip RLS", "<= 1.3"),
        ("RLS, fit of a record / C, gcc -O3", "RLS, fit", "RLS, C", "<= 1.5"),
        ("min-max, partial_fit / padasip RLS", "min-max, partial_fit", "padasip RLS", "<= 4"),
    ]
    print()
    for name, one, other, target in rows:
        value = min(small[one]) / min(small[other])
        print(f"  {name:52s} {value:10.2f}   {target:8s} {judged(value, target)}")

    table = growth()
    print("\nmicroseconds an update, against n")
    print(
        "  " + "".join(f"{name:>15s}" for name in ("n", *table)) + "\n" + "  " + "-" * 15 * (len(table) + 1)
    )
    for i, n in enumerate(SIZES):
        print("  " + f"{n:15d}" + "".join(f"{table[name][i]:15.2f}" for name in table))
    print(
        "  "
        + f"{'slope, n >= 50':>15s}"
        + "".join(f"{slope(SIZES[3:], v[3:]):15.2f}" for v in table.values())
    )
    if "--write" in sys.argv[1:]:
        write(table)


def update_times(n: int) -> dict[str, list[float]]:
    """CPU microseconds a sample of every kernel, over a record."""
    rng = np.random.default_rng(n)
    rows = rng.standard_normal((n, 4000))
    outputs = rng.standard_normal(n) @ rows + 0.3 * rng.standard_normal(4000)
    lengths, times = {}, {name: [] for name in KERNELS}
    for name, kernel in KERNELS.items():
        cost = min(run(kernel, rows, outputs, max(4 * n, 400)) for _ in range(3))
        lengths[name] = int(np.clip(RUN_SECONDS * 1e6 / cost, max(4 * n, 400), 4000))
    for _ in range(REPEATS):
        for name, kernel in KERNELS.items():
            times[name].append(run(kernel, rows, outputs, lengths[name]))
    return times


def run(kernel, rows, outputs, samples) -> float:
    began = time.process_time()
    kernel(rows[:, :samples], outputs[:samples])
    return (time.process_time() - began) / samples * 1e6


def call_times(n: int, samples: int = 200) -> dict[str, list[float]]:
    """CPU microseconds a sample where each sample is a call from Python."""
    import padasip

    rng = np.random.default_rng(n)
    rows = rng.standard_normal((samples, n))
    outputs = rows @ rng.standard_normal(n) + 0.3 * rng.standard_normal(samples)
    regressors = {
        "RLS, partial_fit": RecursiveLeastSquares(forgetting=FORGETTING),
        "min-max, partial_fit": MinMaxRegressor(BOUND, forgetting=FORGETTING),
    }
    makers = {name: lambda e=estimator: _partial(e, n) for name, estimator in regressors.items()}
    makers["padasip RLS"] = lambda: _padasip(padasip.filters.FilterRLS(n, mu=FORGETTING))
    times = {name: [] for name in makers}
    for _ in range(REPEATS):
        for name, make in makers.items():
            update = make()
            began = time.process_time()
            for row, output in zip(rows, outputs, strict=True):
                update(row, output)
            times[name].append((time.process_time() - began) / samples * 1e6)
    return times


def record_times(n: int, samples: int = 20_000) -> dict[str, list[float]]:
    """CPU microseconds a sample of a whole record: `fit`, and the C that the library writes of the same kernel."""
    rng = np.random.default_rng(n)
    rows = rng.standard_normal((samples, n))
    outputs = rows @ rng.standard_normal(n) + 0.3 * rng.standard_normal(samples)
    estimator = RecursiveLeastSquares(forgetting=FORGETTING).fit(rows, outputs)
    driver = f"""#include "rls.h"
void run(long samples, const double *x, const double *y, double coef[1][{n}])
{{
    rls_state s;
    double intercept[1];
    rls_start(&s);
    for (long k = 0; k < samples; k++)
        (void)rls_learn(&s, x + k * {n}, y + k, 1.0);
    rls_solve(&s, coef, intercept);
}}
"""
    found, times = np.zeros((1, n)), {"RLS, fit": [], "RLS, C": []}
    library = compiled(least_squares_code(estimator, n, 1, "rls") | {"run.c": driver}, "-std=c99", "-O3")
    given = [ctypes.c_void_p(each.ctypes.data) for each in (rows, outputs, found)]
    for _ in range(REPEATS):
        began = time.process_time()
        estimator.fit(rows, outputs)
        middle = time.process_time()
        library.run(ctypes.c_long(samples), *given)
        times["RLS, fit"].append((middle - began) / samples * 1e6)
        times["RLS, C"].append((time.process_time() - middle) / samples * 1e6)
    assert np.array_equal(found[0], estimator.coef_)
    return times


def _padasip(peer):
    def update(row, output):
        peer.predict(row)
        peer.adapt(output, row)

    return update


def _partial(estimator, n):
    estimator.partial_fit(np.eye(n + 1, n), np.ones(n + 1))
    return lambda row, output: estimator.partial_fit(row[None], np.array([output]))


def peer_times(n: int, repeats: int = 15) -> dict[str, list[float]]:
    """CPU microseconds of one cone program by Clarabel alone, on n + 1 rows."""
    rng = np.random.default_rng(n)
    rows = rng.standard_normal((120, n)) * FORGETTING ** (np.arange(119, -1, -1) / 2)[:, None]
    outputs = rows @ rng.standard_normal(n) + 0.3 * rng.standard_normal(120)
    factor = np.linalg.qr(np.column_stack([rows, outputs]), mode="r")  # |A x - b| is that of n + 1 rows
    times = {"SOCP, Clarabel alone, reduced data": []}
    cost = solve_cone_program(rows, outputs, 1.0)[1]
    for _ in range(repeats):
        seconds, value = clarabel_alone(factor[:, :n], factor[:, n], 1.0)
        assert abs(value - cost) < 1e-6 * cost
        times["SOCP, Clarabel alone, reduced data"].append(seconds * 1e6)
    return times


def clarabel_alone(matrix, target, bound):
    """Seconds and cost of min t + bound u with |A x - b| <= t, |x| <= u; the solver's own entry, nothing else."""
    import clarabel
    from scipy import sparse

    rows, n = matrix.shape
    cone = np.zeros((rows + n + 2, n + 2))
    cone[0, n] = -1
    cone[1 : rows + 1, :n] = -matrix
    cone[rows + 1, n + 1] = -1
    cone[rows + 2 :, :n] = -np.eye(n)
    right = np.concatenate([[0], -target, [0], np.zeros(n)])
    costs = np.concatenate([np.zeros(n), [1.0, bound]])
    cones = [clarabel.SecondOrderConeT(rows + 1), clarabel.SecondOrderConeT(n + 1)]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    quadratic, linear = sparse.csc_matrix((n + 2, n + 2)), sparse.csc_matrix(cone)
    began = time.process_time()
    solution = clarabel.DefaultSolver(quadratic, costs, linear, right, cones, settings).solve()
    return time.process_time() - began, solution.obj_val


def growth() -> dict[str, list[float]]:
    """CPU microseconds an update against n, by update; with the cone program of Clarabel alone."""
    table = {name: [] for name in (*KERNELS, "SOCP")}
    for n in SIZES:
        for name, times in update_times(n).items():
            table[name].append(min(times))
        table["SOCP"].append(min(peer_times(n, 5)["SOCP, Clarabel alone, reduced data"]))
    return table


def write(table: dict[str, list[float]]) -> None:
    folder = ROOT / "data" / "worstcase" / "update_times"
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "update_times.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("unknowns", *(f"{name} (us)" for name in table)))
        for i, n in enumerate(SIZES):
            writer.writerow((n, *(f"{values[i]:.4g}" for values in table.values())))
    (folder / "SOURCE.md").write_text(
        "# Measured times of the updates against the number of unknowns\n\n"
        "Made by `python benchmarks/worstcase.py --write`; CPU microseconds an update, one thread, the lowest of "
        f"{REPEATS} repeats.\n"
        f"Machine: {machine()}.\n"
        "`SOCP` is Clarabel alone on data reduced to n + 1 rows.\n"
        "Times differ from run to run and from machine to machine; the committed table is one run.\n",
        encoding="utf-8",
    )
    print(f"\nwrote {folder}")


if __name__ == "__main__":
    main()
