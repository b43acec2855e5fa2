"""Speed of the motion topic beside python-control, measured in one run: `make bench`.

Times are processor time of the one thread that works; medians over repeats that take the contenders in turn, so
that a busy machine slows all of them alike. A target in the last column is missed or met; no test asserts it.
With `--write` the times beside peers are stored in `data/motion/times/` for the site's page of benchmarks.
"""

import ctypes
import os
import sys
import warnings
from functools import partial
from pathlib import Path

os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")
ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "lib"), str(ROOT)]

import control  # noqa: E402
import numpy as np  # noqa: E402

from benchmarks.timing import compiled, in_turn, machine, ratio, write_times  # noqa: E402
from experiments.motion.designs import DESIGNS, stage_bandwidth, stage_compensator  # noqa: E402
from experiments.motion.machines import (  # noqa: E402
    published_setpoint,
    stage,
    stage_mass,
)
from stillwork.control.bandwidth import SIX_DB  # noqa: E402
from stillwork.control.feedforward import Feedforward, error_loop, tracking_model  # noqa: E402
from stillwork.control.loops import closed_loop  # noqa: E402
from stillwork.control.pid import PidFamily  # noqa: E402
from stillwork.estimation.robust import kalman_gains  # noqa: E402
from stillwork.estimation.time_varying import TimeVaryingModel, estimate  # noqa: E402
from stillwork.lti import simulate  # noqa: E402
from stillwork.lti.discretisation import zoh_modes  # noqa: E402

FAMILY = PidFamily(stage_mass())
PEER_GRID = 2 * np.pi * np.geomspace(1, 3000, 300)  # a reduced grid: the peer steps over the sharpest peaks
PEER_DESIGNS = 12  # bisections of the peer, beside 141 scanned and 13 bisected designs of ours


def main() -> None:
    warnings.simplefilter("ignore")  # python-control without slycot warns at every call
    print(f"{machine('control')}; one thread; processor time, median (lowest .. highest)\n")
    response = in_turn({"modal residues": modal_response, "control.frequency_response": peer_response}, 9)
    tracking = in_turn({"simulate": our_tracking, "control.forced_response": peer_tracking}, 7)
    search = in_turn(
        {"search, seven loops with observers": our_search, "search through python-control": peer_search}, 3
    )
    rows = [
        ("response: python-control / ours, 16 states, 2000 points", ratio(response), ">= 50"),
        ("tracking: python-control / ours, per sample", ratio(tracking), ">= 50"),
        ("bandwidth search, s", float(np.median(next(iter(search.values())))), "< 0.1"),
        ("bandwidth search: python-control on a reduced grid / ours", ratio(search), ""),
        ("bandwidth search: the same, per design tried", ratio(search) * 154 / PEER_DESIGNS, ""),
    ]
    filtering = in_turn(filter_contenders(), 7)
    ours = np.array(filtering["Kalman step, ours"])
    for name, times in filtering.items():
        if "C" in name:
            rows.append((f"8 states, 3 outputs: ours over {name}", float(np.median(ours / times)), "<= 1.4"))
        if "filterpy" in name:
            rows.append(("Kalman step: filterpy / ours", float(np.median(times / ours)), ">= 30"))
    if "--write" in sys.argv[1:]:
        write({**response, **tracking, **search, **filtering})
    for group in (response, tracking, search, filtering):
        for name, times in group.items():
            print(
                f"  {name:44s} {1e3 * np.median(times):10.3f} ms   ({1e3 * min(times):.3f} .. {1e3 * max(times):.3f})"
            )
    print()
    for name, value, target in rows:
        print(f"  {name:60s} {value:10.3g}   {target}")


def write(times: dict[str, list[float]]) -> None:
    write_times(
        "motion/times/times.csv",
        "what",
        "ms",
        1e3,
        times,
        "Milliseconds of processor time of a response, a simulation, a search and a filter, beside named peers: median, lowest\n"
        "and highest of repeats in turn; written by `python benchmarks/motion.py --write`, which describes each. Measured, not\n"
        "computed: another machine gives other times.\n\n"
        f"Machine: {machine('control')}; other programs were running.",
    )


PLANT = stage().at([0], [4])
PEER_PLANT = PLANT.to_control()
OMEGA = 2 * np.pi * np.geomspace(1, 5000, 2000)


def modal_response() -> None:
    PLANT.frequency_response(OMEGA)


def peer_response() -> None:
    control.frequency_response(PEER_PLANT, OMEGA)


LOOP = closed_loop(PLANT, stage_compensator(5, DESIGNS["MC and AD"]), FAMILY(77.7).state_space())
SETPOINT = published_setpoint(1e-4)
DISCRETE = tracking_model(error_loop(LOOP), Feedforward(acceleration=12.5, snap=1.66e-6), 1e-4)
MOVES = np.tile(SETPOINT.derivatives, 20)
PEER_DISCRETE = DISCRETE.to_control()


def our_tracking() -> None:
    simulate(DISCRETE, MOVES)


def peer_tracking() -> None:
    control.forced_response(PEER_DISCRETE, inputs=MOVES)


def our_search() -> None:
    stage_bandwidth("MC and AD", damping_ratio=0.005)  # the published one, given: the observers are made anew


def peer_search() -> None:
    """Bisection with python-control's own connect, frequency_response and poles, observers included."""
    good, bad = 20.0, 120.0
    blocks = [
        (stage().at([0], [k - 1]).to_control(), stage_compensator(k, DESIGNS["MC and AD"]).to_control())
        for k in range(1, 8)
    ]
    for _ in range(PEER_DESIGNS):
        middle = (good + bad) / 2
        controller = FAMILY(middle).state_space().to_control()
        if all(peer_feasible(plant, observer, controller) for plant, observer in blocks):
            good = middle
        else:
            bad = middle


def peer_feasible(plant, observer, controller) -> bool:
    # Inputs: 1 plant, 2-3 observer (u, y), 4 controller. Outputs: 1 y, 2 u_d, 3 y_flex, 4 u.
    whole = control.append(plant, observer, controller)
    wires = [[1, 2, 4], [2, 2, 4], [3, 1, 0], [4, -1, 3]]
    loop = control.connect(whole, wires, [4, 3], [4, 1])
    if np.any(loop.poles().real >= 0):
        return False
    response = control.frequency_response(loop, PEER_GRID).frdata
    tracking = control.frequency_response(controller, PEER_GRID).frdata[0, 0]
    s_i = response[0, 0] / tracking  # r to u is C S_I
    return bool(np.abs(s_i).max() <= SIX_DB)


STEPS = 2000
C_SOURCE = r"""
#define N 8
#define O 3
/* Time-varying Kalman filter, one output after the other: estimates of one record. Where it gets places for them,
   it keeps gains and covariances, too, as ours does. */
void run(long samples, const double *a, const double *g, const double *c, double q, double r,
         const double *p0, const double *y, double *x_out, double *gain, double *covariance)
{
    double p[N][N], h[N][N], v[N], x[N] = {0}, share[O][N];
    for (int i = 0; i < N; i++) for (int j = 0; j < N; j++) p[i][j] = p0[i * N + j];
    for (long k = 1; k < samples; k++) {
        const double *A = a + k * N * N, *G = g + k * N, *C = c + k * O * N;
        for (int i = 0; i < N; i++) for (int j = 0; j < N; j++) {
            double t = 0;
            for (int m = 0; m < N; m++) t += A[i * N + m] * p[m][j];
            h[i][j] = t;
        }
        for (int i = 0; i < N; i++) for (int j = 0; j <= i; j++) {
            double t = q * G[i] * G[j];
            for (int m = 0; m < N; m++) t += h[i][m] * A[j * N + m];
            p[i][j] = p[j][i] = t;
        }
        for (int i = 0; i < N; i++) {
            double t = 0;
            for (int m = 0; m < N; m++) t += A[i * N + m] * x[m];
            v[i] = t;
        }
        for (int i = 0; i < N; i++) x[i] = v[i];
        for (int o = 0; o < O; o++) {
            double s = r, e = y[o * samples + k];
            for (int i = 0; i < N; i++) {
                double t = 0;
                for (int m = 0; m < N; m++) t += p[i][m] * C[o * N + m];
                v[i] = t;
            }
            for (int i = 0; i < N; i++) { s += C[o * N + i] * v[i]; e -= C[o * N + i] * x[i]; }
            for (int i = 0; i < N; i++) {
                x[i] += v[i] / s * e;
                for (int j = 0; j < N; j++) p[i][j] -= v[i] * v[j] / s;
            }
            if (!gain) continue;
            for (int i = 0; i < N; i++) share[o][i] = v[i] / s;
            for (int m = 0; m < o; m++) {
                double t = 0;
                for (int i = 0; i < N; i++) t += C[o * N + i] * share[m][i];
                for (int i = 0; i < N; i++) share[m][i] -= share[o][i] * t;
            }
        }
        if (gain) for (int i = 0; i < N; i++) {
            for (int o = 0; o < O; o++) gain[(k * N + i) * O + o] = share[o][i];
            for (int j = 0; j < N; j++) covariance[(k * N + i) * N + j] = p[i][j];
        }
        for (int i = 0; i < N; i++) x_out[i * samples + k] = x[i];
    }
}
"""


def filter_contenders() -> dict:
    """Gains and estimates of one record, 8 states and 3 moving outputs, by ours, by C and by filterpy."""
    rng = np.random.default_rng(1)
    plant = stage().modes(slice(0, 4))
    sampled = zoh_modes(plant, 1e-4)
    along = np.linspace(0.0, 1.0, STEPS)[:, None, None]
    shapes = (1 - along) * plant.output_shapes[None, :3] + along * plant.output_shapes[None, 3:6]
    c = np.zeros((STEPS, 3, 8))
    c[:, :, ::2] = 1e9 * shapes  # nanometres
    q, r, start = 1e-4, 2.0, 1e-14 * np.eye(8)
    model = TimeVaryingModel(sampled.a, sampled.b, sampled.b, c, [[q]], r * np.eye(3), start)
    y, u = rng.standard_normal((3, STEPS)), np.zeros((1, STEPS))

    def ours():
        return estimate(kalman_gains(model), u, y)

    expected = ours()
    contenders = {"Kalman step, ours": ours}
    for flags in (("-O3", "-march=native"), ("-O2",)):
        if library := compiled({"peer.c": C_SOURCE}, *flags):
            name = " ".join(("gcc", *flags))
            alone, keeping = c_kalman(library, model, q, r, y, expected)
            contenders[f"Kalman step, C, {name}"] = alone
            contenders[f"Kalman step, C that keeps what ours keeps, {name}"] = keeping
    from filterpy.kalman import KalmanFilter

    def peer():
        f = KalmanFilter(dim_x=8, dim_z=3)
        f.P, f.R, f.Q, f.F = start.copy(), r * np.eye(3), q * sampled.b @ sampled.b.T, sampled.a
        out = np.zeros((8, STEPS))
        for k in range(1, STEPS):
            f.predict()
            f.update(y[:, k : k + 1], H=c[k])
            out[:, k] = f.x[:, 0]
        return out

    assert np.abs(peer() - expected).max() < 1e-6 * np.abs(expected).max()
    contenders["Kalman step, filterpy"] = peer
    return contenders


def c_kalman(library, model: TimeVaryingModel, q: float, r: float, y: np.ndarray, expected: np.ndarray):
    """The filter in C twice: estimates alone, and with gains and covariances kept."""
    arrays = [
        np.ascontiguousarray(m) for m in (model.a, model.g[:, :, 0], model.c, model.initial_covariance, y)
    ]
    a, g, c, p0, measured = (m.ctypes.data_as(ctypes.c_void_p) for m in arrays)
    out, gain, covariance = np.zeros((8, STEPS)), np.zeros((STEPS, 8, 3)), np.zeros((STEPS, 8, 8))
    kept = [m.ctypes.data_as(ctypes.c_void_p) for m in (gain, covariance)]

    def run(kept=(None, None), arrays=arrays):  # the arrays must outlive the pointers
        numbers = ctypes.c_double(q), ctypes.c_double(r)
        estimates = out.ctypes.data_as(ctypes.c_void_p)
        library.run(ctypes.c_long(STEPS), a, g, c, *numbers, p0, measured, estimates, *kept)
        return out

    for each in ((None, None), kept):
        assert np.abs(run(each) - expected).max() < 1e-6 * np.abs(expected).max()
    ours = kalman_gains(model)
    for found, wanted in ((gain, ours.gain), (covariance, ours.covariance)):
        assert np.abs(found[1:] - wanted[1:]).max() < 1e-6 * np.abs(wanted).max()
    return run, partial(run, kept)


if __name__ == "__main__":
    main()
