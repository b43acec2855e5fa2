"""Speed of the fixedpoint topic beside named peers, measured in one run: `make bench`.

Times are processor time of one thread, medians over repeats that take the contenders in turn, so that a busy
machine slows all of them alike.
With `--write` the filters' times are stored in `data/fixedpoint/filter_times.csv` for notebook 07.
"""

import ctypes
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "lib"), str(ROOT)]

import numpy as np  # noqa: E402

from benchmarks import timing  # noqa: E402
from experiments.fixedpoint import (  # noqa: E402
    PUBLISHED_CASES,
    added_controllers,
    compare,
    load_oscillator,
    published_controllers,
)
from stillwork.control import asin_trajectory  # noqa: E402
from stillwork.estimation.coordinate_filters import UnscentedKalman  # noqa: E402
from stillwork.estimation.filtering import filter_record, model_of  # noqa: E402

SAMPLE_TIME = 1e-3
SAMPLES = 20_000
REPEATS = 9

C_SOURCE = r"""
/* The unscented Kalman filter for the oscillator as one would write it by hand, n = 2. */
#include <math.h>
enum { N = 2, POINTS = 2 * N + 1 };
static int root(const double p[N][N], double spread, double l[N][N]) {
    if (!(p[0][0] > 0)) return 0;
    l[0][0] = sqrt(spread * p[0][0]);
    l[1][0] = spread * p[1][0] / l[0][0];
    double rest = spread * p[1][1] - l[1][0] * l[1][0];
    if (!(rest > 0)) return 0;
    l[0][1] = 0;
    l[1][1] = sqrt(rest);
    return 1;
}
static int draw(const double x[N], const double p[N][N], double spread, double s[POINTS][N]) {
    double l[N][N];
    if (!root(p, spread, l)) return 0;
    for (int j = 0; j < N; j++) {
        s[0][j] = x[j];
        for (int i = 0; i < N; i++) {
            s[1 + i][j] = x[j] + l[j][i];
            s[1 + N + i][j] = x[j] - l[j][i];
        }
    }
    return 1;
}
static void moments(double s[POINTS][N], double wm, double wc, double w, const double add[N][N],
                    double x[N], double p[N][N]) {
    for (int j = 0; j < N; j++) {
        x[j] = wm * s[0][j];
        for (int i = 1; i < POINTS; i++) x[j] += w * s[i][j];
    }
    for (int a = 0; a < N; a++)
        for (int b = 0; b < N; b++) {
            p[a][b] = add[a][b] + wc * (s[0][a] - x[a]) * (s[0][b] - x[b]);
            for (int i = 1; i < POINTS; i++) p[a][b] += w * (s[i][a] - x[a]) * (s[i][b] - x[b]);
        }
}
long run(const double *q, const double *z, const double *u, long samples, double dt, const double *weights,
         const double *Q, const double *R, double variance, double *out) {
    double x[N] = {0, z[0]}, p[N][N] = {{variance, 0}, {0, variance}}, last = z[0], force = 0;
    double spread = weights[0], wm = weights[1], wc = weights[2], w = weights[3];
    double Qm[N][N] = {{Q[0], Q[1]}, {Q[2], Q[3]}}, Rm[N][N] = {{R[0], R[1]}, {R[2], R[3]}};
    for (long k = 0; k < samples; k++) {
        double s[POINTS][N], seen[N], S[N][N], cross[N][N], gain[N][N], before = x[0];
        if (!draw(x, p, spread, s)) return k;
        for (int i = 0; i < POINTS; i++) {
            double v = s[i][0], y = s[i][1];
            double pull = q[1] * y - q[3] * (q[2] * q[2] - y * y) * v + q[4] * v + q[5] * fabs(v) * v;
            s[i][0] += dt * (force - pull) / q[0];
            s[i][1] += dt * s[i][0];
        }
        moments(s, wm, wc, w, Qm, x, p);
        if (!draw(x, p, spread, s)) return k;
        moments(s, wm, wc, w, Rm, seen, S);
        for (int a = 0; a < N; a++)
            for (int b = 0; b < N; b++) {
                cross[a][b] = wc * (s[0][a] - x[a]) * (s[0][b] - seen[b]);
                for (int i = 1; i < POINTS; i++) cross[a][b] += w * (s[i][a] - x[a]) * (s[i][b] - seen[b]);
            }
        double det = S[0][0] * S[1][1] - S[0][1] * S[1][0];
        if (!(det > 0)) return k;
        for (int a = 0; a < N; a++) {
            gain[a][0] = (cross[a][0] * S[1][1] - cross[a][1] * S[1][0]) / det;
            gain[a][1] = (cross[a][1] * S[0][0] - cross[a][0] * S[0][1]) / det;
        }
        double i0 = (z[k] - last) / dt - seen[0], i1 = z[k] - seen[1];
        for (int a = 0; a < N; a++) x[a] += gain[a][0] * i0 + gain[a][1] * i1;
        for (int a = 0; a < N; a++)
            for (int b = 0; b < N; b++) p[a][b] -= cross[a][0] * gain[b][0] + cross[a][1] * gain[b][1];
        last = z[k];
        force = u[k];
        out[3 * k] = x[1];
        out[3 * k + 1] = x[0];
        out[3 * k + 2] = (x[0] - before) / dt;
    }
    return samples;
}
"""


def main() -> None:
    models = load_oscillator()
    exact, approximate = models["exact"].plant, models["approximate"].plant
    print(f"machine: {timing.machine('numba')}")
    times = filter_times(approximate)
    peers(approximate, times)
    whole_study(exact, approximate)
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


def peers(approximate, times) -> None:
    """The unscented filter beside C and beside filterpy, on the same record and to the same numbers."""
    signal_filter = UnscentedKalman(approximate)
    ours = runner(signal_filter)
    expected = ours().copy()
    contenders = {"ours": ours}
    if library := timing.compiled({"peer.c": C_SOURCE}, "-O3", "-march=native"):
        contenders["C, gcc -O3 -march=native"] = c_filter(library, signal_filter, expected)
    taken = {name: np.median(each) for name, each in timing.in_turn(contenders, REPEATS, SAMPLES).items()}
    print("\nunscented Kalman filter, n = 2, beside its peers")
    for name, median in taken.items():
        if name != "ours":
            report(f"ours / {name}", taken["ours"] / median, "<= 1.5")
    report("filterpy / ours", filterpy_time(signal_filter, expected) / taken["ours"], ">= 300")


def c_filter(library, signal_filter, expected):
    library.run.restype = ctypes.c_long
    measured, force = record()
    packed, out = signal_filter.packed(), np.empty((SAMPLES, 3))
    pointers = [
        array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
        for array in (signal_filter.plant.parameters, measured, force, packed.options)
    ]
    matrices = [
        np.ascontiguousarray(m).ctypes.data_as(ctypes.c_void_p) for m in (packed.process, packed.noise)
    ]

    def run():
        done = library.run(
            *pointers[:3],
            ctypes.c_long(SAMPLES),
            ctypes.c_double(SAMPLE_TIME),
            pointers[3],
            *matrices,
            ctypes.c_double(signal_filter.initial_variance),
            out.ctypes.data_as(ctypes.c_void_p),
        )
        assert done == SAMPLES
        return out

    assert np.abs(run() - expected)[:, :2].max() < 1e-9
    return run


def filterpy_time(signal_filter, expected, samples: int = 400) -> float:
    """Seconds a sample."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    measured, force = record()
    plant = signal_filter.plant

    def move(x, dt, u):
        velocity = x[0] + dt * plant.acceleration(x[1], x[0], u, plant.parameters)
        return np.array([velocity, x[1] + dt * velocity])

    points = MerweScaledSigmaPoints(2, 1e-2, 1e-3, 0.0)
    peer = UnscentedKalmanFilter(2, 2, SAMPLE_TIME, lambda x: x, move, points)
    peer.x, peer.P = np.array([0.0, measured[0]]), signal_filter.initial_variance * np.eye(2)
    peer.Q, peer.R = signal_filter.process, signal_filter.noise
    last, start = measured[0], time.process_time()
    for k in range(samples):
        peer.predict(u=force[k - 1] if k else 0.0)
        peer.update(np.array([(measured[k] - last) / SAMPLE_TIME, measured[k]]))
        last = measured[k]
    taken = (time.process_time() - start) / samples
    assert np.abs(peer.x - expected[samples - 1, [1, 0]]).max() < 1e-9
    return taken


def whole_study(exact, approximate) -> None:
    """12 s at 1 kHz, three filters, five noise cases, 40 seeds: noise, loops and metrics."""
    controllers = dict(list(published_controllers(approximate).items())[:3])
    trajectory = asin_trajectory()
    start = time.process_time()
    for noise in PUBLISHED_CASES.values():
        compare(exact, controllers, trajectory, noise, runs=40, seed=0)
    print()
    report("study of 3 filters x 5 noises x 40 seeds, s", time.process_time() - start, "<= 5")


def report(name: str, value: float, target: str) -> None:
    print(f"  {name:62s} {value:8.2f}   target: {target}   {timing.judged(value, target)}")


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
