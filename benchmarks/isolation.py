"""Speed of the isolation topic beside named peers, measured in one run: `make bench`.

Times are processor time of the one thread that works, which other programs disturb less than the clock; medians
over repeats that take the contenders in turn, so that a busy machine slows all of them alike.
With `--write` the times of the update forms are stored in `data/isolation/update_times/` for notebook 06.
"""

import ctypes
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "lib"), str(ROOT)]
os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")

import numpy as np  # noqa: E402

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

COLD = """
import sys, time
start = time.thread_time()
import numpy as np
from stillwork.estimation.adaptive import FeLms, FeRls
from notebooks.isolation.numerical_stability import run_cure, smallest_loop
from experiments.isolation.floors import flat_floor
from stillwork.estimation.online import AdaptationStepper, identify
from experiments.isolation.simulation import simulate
from notebooks.isolation.numerical_stability import covariance_run
from experiments.isolation.twin import load_twin
imported = time.thread_time() - start
rng = np.random.default_rng(0)
psi, d = rng.standard_normal((9, 200)), rng.standard_normal((6, 200))
twin = load_twin("rigid_body")
for settings in (FeLms(), FeRls(1.0)):
    identify(settings, psi, d)
    AdaptationStepper(settings, np.zeros((6, 9))).update(psi[:, 0], d[:, 0])
    simulate(twin, flat_floor(), 0.2, adaptation=settings)
simulate(twin.varied(estimate="full"), flat_floor(), 0.2)
for precision in ("float64", "float32"):
    covariance_run("triangle", psi, 0.99, np.eye(9), 2, precision)
loop = smallest_loop([(psi[:3], np.ones(9))], twin.integrator, twin.noise_shaping)
run_cure("limit", loop, np.ones(9), 0.99)
total = time.thread_time() - start
import numba, stillwork
kernels = {
    id(value): value
    for name, module in list(sys.modules.items()) if name.startswith(("stillwork", "workbook", "experiments", "notebooks"))
    for value in vars(module).values() if hasattr(value, "stats") and hasattr(value, "py_func")
}
missed = sum(sum(k.stats.cache_misses.values()) for k in kernels.values())
print(imported, total - imported, missed, sum(len(k.signatures) > 0 for k in kernels.values()))
"""


def main() -> None:
    rows = []
    updates = update_times()
    recursion = updates["recursion"][0]
    if "C" in updates:
        rows.append(
            ("update 9 x 6: numba / C (gcc -O3 -march=native)", recursion / updates["C"][0], "<= 2.5")
        )
    for peer, name in (("padasip", "padasip FilterRLS"), ("pyroomacoustics", "pyroomacoustics RLS")):
        if peer in updates:
            rows.append((f"update 9 x 6: {name} per output / numba", updates[peer][0] / recursion, ">= 400"))
    safe = updates["recursion in float32"][0]
    rows.append(("update 9 x 6: float32 safe form / triangle in float64", safe / recursion, "<= 1.5"))
    rows.append(("update 9 x 6: FeRLS / FeLMS alone", recursion / updates["FeLMS"][0], ""))
    loops = loop_times()
    felms, ferls = (loops[f"closed loop {name}"][0] for name in ("FeLMS", "FeRLS"))
    rows.append(("closed loop with FeRLS, floor drawn before, us per sample", ferls, "<= 0.5"))
    rows.append(("simulate with FeRLS, floor and all, us per sample", loops["simulation FeRLS"][0], "<= 0.5"))
    rows.append(("closed loop: FeRLS / FeLMS", ferls / felms, "<= 1.3"))
    cold, warm = compilation()
    rows.append(("cold compilation of all kernels, s", cold[1] - warm[1], "<= 10"))
    rows.append(("kernels used / compiled in the second run", f"{warm[3]:.0f} / {warm[2]:.0f}", "/ 0"))
    rows.append(("import stillwork, s", import_time(), "<= 0.2"))

    print(f"{machine()}; median of {REPEATS} repeats")
    print(
        "\nupdate of 9 regressors x 6 outputs, and closed loop: microseconds per sample (lowest .. highest)"
    )
    for name, (median, low, high) in {**updates, **loops}.items():
        print(f"  {name:38s} {median:10.3f}   ({low:.3f} .. {high:.3f})")
    print()
    for name, value, target in rows:
        text = value if isinstance(value, str) else f"{value:.3g}"
        print(f"  {name:56s} {text:>9s}   {target:8s} {verdict(value, target)}")
    if "--write" in sys.argv[1:]:
        write({**updates, **loops})


def verdict(value, target: str) -> str:
    if not target:
        return ""
    relation, bound = target.split()
    number = float(str(value).rpartition("/")[2])
    met = number >= float(bound) if relation == ">=" else number <= float(bound)
    return "met" if met else "MISSED"


def in_turn(contenders: dict, repeats: int = REPEATS) -> dict[str, tuple[float, float, float]]:
    """Median, lowest and highest time in microseconds per sample of functions that return (seconds, samples)."""
    for run in contenders.values():
        run()
    times = {name: [] for name in contenders}
    for _ in range(repeats):
        for name, run in contenders.items():
            seconds, samples = run()
            times[name].append(1e6 * seconds / samples)
    return {name: (float(np.median(t)), min(t), max(t)) for name, t in times.items()}


def update_times() -> dict[str, tuple[float, float, float]]:
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
        **compiled(psi, error, start),
    }
    return in_turn(contenders)


def peers(psi, error) -> dict:
    """Published filters, one per output, because none of them shares the covariance."""
    contenders, count = {}, 200
    try:
        from padasip.filters import FilterRLS

        def padasip():
            filters = [FilterRLS(REGRESSORS, mu=FORGETTING, eps=1.0, w="zeros") for _ in range(ACTUATORS)]
            begin = time.thread_time()
            for k in range(count):
                for a, one in enumerate(filters):
                    one.adapt(error[k, a], psi[k])
            return time.thread_time() - begin, count

        contenders["padasip"] = padasip
    except ImportError:
        print("padasip is not installed: left out")
    try:
        from pyroomacoustics.adaptive import RLS

        def pyroomacoustics():
            filters = [
                RLS(REGRESSORS, lmbd=FORGETTING, delta=1.0, dtype=np.float64) for _ in range(ACTUATORS)
            ]
            begin = time.thread_time()
            for k in range(count):
                for a, one in enumerate(filters):
                    one.update(psi[k, 0], error[k, a])
            return time.thread_time() - begin, count

        contenders["pyroomacoustics"] = pyroomacoustics
    except ImportError:
        print("pyroomacoustics is not installed: left out")
    return contenders


def compiled(psi, error, start) -> dict:
    """Hand-written C, where there is a compiler; checked to give the same weights."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        print("no C compiler: left out")
        return {}
    folder = tempfile.mkdtemp(prefix="stillwork-bench-")
    source, library = Path(folder, "update.c"), Path(folder, "update.so")
    source.write_text(C_SOURCE)
    subprocess.run(
        [compiler, "-O3", "-march=native", "-shared", "-fPIC", "-o", str(library), str(source)], check=True
    )
    run_c = ctypes.CDLL(str(library)).run
    shutil.rmtree(folder)
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


def loop_times() -> dict[str, tuple[float, float, float]]:
    """Closed loop of the rigid-body twin, alone and with floor and noise drawn; times as in `in_turn`."""
    twin, seconds = load_twin("rigid_body"), 20.0
    covariance = np.full(twin.regressors, 0.6)  # about the steady value on this floor
    algorithms = {"FeLMS": FeLms(), "FeRLS": FeRls(covariance)}
    samples = round(seconds / twin.sample_time)
    drawn_from = sources.Sources(twin, [(samples, flat_floor())], True, [0])
    blocks = [drawn_from.sample(simulation.BLOCK) for _ in range(samples // simulation.BLOCK)]

    def alone(settings):
        law, start = simulation.algorithm_of(twin, settings)
        kept = simulation.KeptSignals(twin, simulation.BLOCK, simulation.BLOCK, simulation.BLOCK, 1)

        def run():
            closed = loop.loop_of(twin, True, np.zeros((1, twin.actuators, twin.regressors)), start)
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
    contenders |= {f"simulation {name}": drawn(settings) for name, settings in algorithms.items()}
    seeds = range(simulation.TOGETHER)
    contenders |= {
        f"{len(seeds)} seeds together {name}": drawn(settings, seeds) for name, settings in algorithms.items()
    }
    return in_turn(contenders)


def compilation() -> tuple[list[float], list[float]]:
    """Import, run, compiled and used kernels of a process with an empty cache, and of the next one."""
    with tempfile.TemporaryDirectory(prefix="stillwork-bench-") as cache:
        return tuple([float(x) for x in python(COLD, NUMBA_CACHE_DIR=cache).split()] for _ in range(2))


def import_time() -> float:
    """What `import stillwork` takes in a fresh interpreter, median, seconds."""
    code = "import time; start = time.thread_time(); import stillwork; print(time.thread_time() - start)"
    return float(np.median([float(python(code)) for _ in range(REPEATS)]))


def python(code: str, **environment) -> str:
    env = {**os.environ, **environment, "PYTHONPATH": f"{ROOT / 'lib'}{os.pathsep}{ROOT}"}
    done = subprocess.run([sys.executable, "-c", code], env=env, stdout=subprocess.PIPE, text=True)
    if done.returncode:
        raise SystemExit("a measured process failed; its message stands above")
    return done.stdout


def machine() -> str:
    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        models = [
            line.partition(":")[2].strip() for line in info.read_text().splitlines() if "model name" in line
        ]
        name = models[0] if models else name
    return f"{name}, {platform.system()}, Python {platform.python_version()}, numpy {np.__version__}"


def write(updates) -> None:
    import numba

    folder = ROOT / "data" / "isolation" / "update_times"
    folder.mkdir(parents=True, exist_ok=True)
    lines = ["form,median_us,lowest_us,highest_us"]
    lines += [f"{name},{median:.4g},{low:.4g},{high:.4g}" for name, (median, low, high) in updates.items()]
    (folder / "update_times.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "SOURCE.md").write_text(
        "# Measured times of one update of 9 regressors x 6 outputs, and of the closed loop around it\n\n"
        "Microseconds per sample, median, lowest and highest of "
        f"{REPEATS} repeats; written by `python benchmarks/isolation.py --write`, which describes each form.\n"
        "Measured, not computed: another machine gives other times, which is why notebook 06 reads this file.\n\n"
        f"Machine: {machine()}, numba {numba.__version__}; other programs were running.\n",
        encoding="utf-8",
    )


if __name__ == "__main__":
    main()
