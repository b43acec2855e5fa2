"""Time per sample of the generated C code beside Python's kernels and plain dense C, as ratios: `make bench`."""

import ctypes
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "lib"), str(ROOT)]

import numpy as np  # noqa: E402

from benchmarks.timing import compiled, in_turn  # noqa: E402
from stillwork.control import DigitalController  # noqa: E402
from stillwork.control.applications import Application  # noqa: E402
from stillwork.control.digital import anti_windup, observed_controller  # noqa: E402
from stillwork.control.discrete_observer import discrete_compensator, discrete_kalman_observer  # noqa: E402
from stillwork.control.pid import PidFamily  # noqa: E402
from stillwork.estimation import FeRls, NoiseIntensities, adapt  # noqa: E402
from stillwork.lti import ModalModel, simulate, tustin  # noqa: E402
from stillwork.machine import adaptation_code, controller_code  # noqa: E402

SAMPLES, SAMPLE_TIME = 50_000, 1e-4
# The same linear controller with all its zeros, as a loop over matrices: what one writes by hand.
DENSE = """
void run(long samples, const double *a, const double *b, const double *c, const double *d, const double *in, double *out)
{
    double x[N] = {0}, next[N];
    for (long k = 0; k < samples; k++) {
        const double *u = in + 2 * k;
        double y = d[0] * u[0] + d[1] * u[1];
        for (int i = 0; i < N; i++) {
            double sum = b[2 * i] * u[0] + b[2 * i + 1] * u[1];
            for (int j = 0; j < N; j++)
                sum += a[i * N + j] * x[j];
            y += c[i] * x[i];
            next[i] = sum;
        }
        for (int i = 0; i < N; i++)
            x[i] = next[i];
        out[k] = y;
    }
}
"""
LOOP = """
#include "loop.h"
void run(long samples, const loop_real *in, loop_real *out)
{
    static const loop_state zero;
    const loop_real known[LOOP_OUTPUTS] = {0};
    loop_state s = zero;
    for (long k = 0; k < samples; k++)
        loop_step(&s, &loop_designed, in + k * LOOP_INPUTS, known, out + k);
}
"""
FEED = """
#include "feed.h"
void run(long samples, const feed_real *psi, const feed_real *e, feed_real *out)
{
    feed_state s;
    feed_start(&s);
    for (long k = 0; k < samples; k++)
        feed_update(&s, psi + k * FEED_REGRESSORS, e + k * FEED_ACTUATORS);
    out[0] = s.weights[0][0];
}
"""


def main() -> None:
    """Print medians and ratios; ours and the peers take turns in one process."""
    rng = np.random.default_rng(1)
    controller = observing()
    model = controller.linear
    inputs = 1e-9 * rng.standard_normal((2, SAMPLES))
    psi, errors = rng.standard_normal((9, SAMPLES)), rng.standard_normal((6, SAMPLES))
    settings = FeRls(1e-3, 0.9999, form="UD")
    dense = [np.ascontiguousarray(m) for m in (model.a, model.b, model.c, model.d, inputs.T)]
    runs = {
        "controller, Python's kernel": lambda: simulate(model, inputs),
        "controller, dense C": library({"dense.c": f"#define N {len(model.a)}\n{DENSE}"}, dense, np.float64),
        "FeRLS 6 x 9, Python's kernel": lambda: adapt(settings, psi, errors),
    }
    for precision, dtype in (("double", np.float64), ("single", np.float32)):
        code = {**controller_code(controller, "loop", precision), "run.c": LOOP}
        runs[f"controller, C, {precision}"] = library(code, [np.ascontiguousarray(inputs.T, dtype)], dtype)
        code = {**adaptation_code(settings, 6, 9, "feed", precision), "run.c": FEED}
        given = [np.ascontiguousarray(each.T, dtype) for each in (psi, errors)]
        runs[f"FeRLS 6 x 9, C, {precision}"] = library(code, given, dtype)
    times = in_turn(runs, 7, SAMPLES)
    print(
        f"a PID with an observer: {len(model.a)} states with limits; gcc -O2; processor time a sample, median\n"
    )
    for name, each in times.items():
        print(f"  {name:40s} {1e9 * np.median(each):9.0f} ns")
    print()
    for part, peers in (
        ("controller", ("Python's kernel", "dense C")),
        ("FeRLS 6 x 9", ("Python's kernel",)),
    ):
        for precision in ("double", "single"):
            ours = np.array(times[f"{part}, C, {precision}"])
            for peer in peers:
                ratio = float(np.median(np.array(times[f"{part}, {peer}"]) / ours))
                print(f"  {part}: {peer} / C in {precision} precision {ratio:10.2f}")


def observing() -> DigitalController:
    """A PID behind an observer of two flexible modes that compensates and damps, with limits."""
    shapes = np.array([[0.3], [0.3], [0.2]])
    stage = ModalModel([0.0, 2000.0, 5000.0], [0.0, 0.01, 0.01], shapes, shapes.T * [1, -1, 1], [[0.0]])
    observer = discrete_kalman_observer(stage, NoiseIntensities(1.0, 1e-12), SAMPLE_TIME)
    application = Application(compensate=True, damping=0.05, selectivity=2.0)
    pid = tustin(PidFamily(11.0)(50.0).state_space(), SAMPLE_TIME)
    model = observed_controller(pid, discrete_compensator(observer, application, "filter", 0))
    return DigitalController(model, ("r (m)", "y (m)"), ("f (N)",), -1e3, 1e3, anti_windup(model, 0.02))


def library(files: dict[str, str], arrays: list[np.ndarray], dtype):
    """Compile `files` and return what calls their `run` with these arrays."""
    loaded, out = compiled(files, "-std=c99", "-O2"), np.zeros(SAMPLES, dtype)

    def run():
        loaded.run(ctypes.c_long(SAMPLES), *(each.ctypes.data_as(ctypes.c_void_p) for each in (*arrays, out)))

    return run


if __name__ == "__main__":
    main()
