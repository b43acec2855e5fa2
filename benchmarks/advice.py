"""How good `estimation.advise` is: problems drawn at random, each with its truth.

`python benchmarks/advice.py [COUNT] [--train | --second | --third | --fourth | --fifth] [seed=N] [size=S]`. The advice was designed on the kinds of `TRAINING` alone; what is
printed without ``--train`` is of the other kinds and of other seeds, with ``--second`` of kinds by a second author. An
error is that of predictions of y at 4000 new rows, of features as they were measured where nothing was known, else of features
without their noise; once with the noise of new outputs in it, which cannot be predicted, and once without it.

With ``size=2`` the noise is given at twice its size, and with ``seed=N`` problems are drawn anew.

On seeds that no rule had met (``seed=773``, ``--second seed=774``, ``--third seed=771``, ``--fourth seed=772``, ``--fifth seed=51``, 300
each), advised without a warning in 140, 144, 87, 56 and 86: 99, 97, 95, 100 and 100 % within 10 % of the best, at worst 1.00, 1.01, 1.35,
1.00 and 0.96 times the error of ignoring the features. With a warning: 90, 82, 86, 72 and 77 %, at worst 1.01, 1.13, 41, 3.4 and 1.9.
The limits of the warnings were chosen on 400, 400, 300 and 300 others of the third, fourth, first and second kinds.

Tried and left: parts of equal leverage instead of equal time; a third of the record held out beside the tenths; weights of
the estimators by held-out likelihood (within 10 % in 77 % of the fourth kinds, at worst 190 times); the mean or the median of
all estimators; shrinking the advised one by its held-out errors (58 to 62 % of the third and fourth); the joint F of the
instruments as rule of choice. The best is that of the ranking and of bias compensation without a penalty.
"""

import os
import sys
import time
import warnings
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "lib"), str(ROOT)]

import numpy as np  # noqa: E402
from scipy import signal  # noqa: E402
from sklearn.pipeline import make_pipeline  # noqa: E402
from sklearn.preprocessing import StandardScaler  # noqa: E402

from stillwork.estimation import BiasCompensatedRegressor, advice, advise  # noqa: E402

FRESH = 4000


@dataclass
class Problem:
    X: np.ndarray
    y: np.ndarray
    new: np.ndarray  # features to predict from
    wanted: np.ndarray  # y there, without noise
    deviation: float  # of the noise of outputs
    noise: np.ndarray | None = None
    instruments: np.ndarray | None = None


def sizes(rng):
    features = int(rng.integers(1, 9))
    return features, int(np.exp(rng.uniform(np.log(3 * features + 10), np.log(400))))


def coefficients(rng, features):
    return rng.standard_normal(features) * np.exp(rng.normal(0, 1))


def deviation_of(rng, clean):
    return float(clean.std() * np.exp(rng.uniform(np.log(0.03), np.log(5))))


def assemble(
    rng, rows, truth, *, share=0.0, known=False, errors=None, instruments=None, offset=0.0, samples=None
):
    """Rows without noise, those to learn from first; noise of the features as a share of what each holds."""
    samples = len(rows) - FRESH if samples is None else samples
    clean = rows @ truth
    deviation = deviation_of(rng, clean)
    noise = share * rows.std(axis=0)
    measured = rows + noise * rng.standard_normal(rows.shape)
    e = deviation * (rng.standard_normal(samples) if errors is None else errors(samples))
    return Problem(
        measured[:samples],
        clean[:samples] + e + offset * clean.std(),
        rows[samples:] if known or instruments is not None else measured[samples:],
        clean[samples:] + offset * clean.std(),
        deviation,
        noise if known else None,
        None if instruments is None else instruments(rows, noise)[:samples],
    )


def white(rng, **how):
    features, samples = sizes(rng)
    return assemble(rng, rng.standard_normal((samples + FRESH, features)), coefficients(rng, features), **how)


def collinear(rng, **how):
    features, samples = sizes(rng)
    common = rng.standard_normal((samples + FRESH, 1))
    rows = common + 10 ** rng.uniform(-3, -0.5) * rng.standard_normal((samples + FRESH, features))
    return assemble(rng, rows, coefficients(rng, features), **how)


def few_rows(rng, **how):
    features = int(rng.integers(4, 16))
    samples = features + int(rng.integers(3, 10))
    return assemble(rng, rng.standard_normal((samples + FRESH, features)), coefficients(rng, features), **how)


def scaled(rng, **how):
    features, samples = sizes(rng)
    rows = rng.standard_normal((samples + FRESH, features))
    units = 10 ** rng.uniform(-9, 9, features)
    return assemble(rng, rows * units, coefficients(rng, features) / units, **how)


def outliers(rng):
    share, size = rng.uniform(0.02, 0.15), 10 ** rng.uniform(1, 2.5)
    return lambda n: rng.standard_normal(n) * np.where(rng.random(n) < share, size, 1.0)


def second_sensor(rng):
    return lambda rows, noise: rows + noise * rng.standard_normal(rows.shape)


TRAINING = {
    "white": white,
    "offset": lambda rng: white(rng, offset=10.0),
    "collinear": collinear,
    "few rows": few_rows,
    "scales": scaled,
    "outliers": lambda rng: white(rng, errors=outliers(rng)),
    "noisy features, not known": lambda rng: white(rng, share=rng.uniform(0.1, 0.7)),
    "noisy features": lambda rng: white(rng, share=rng.uniform(0.1, 0.7), known=True),
    "noisy features, few rows": lambda rng: few_rows(rng, share=rng.uniform(0.1, 0.7), known=True),
    "second sensor": lambda rng: white(rng, share=rng.uniform(0.1, 0.7), instruments=second_sensor(rng)),
}


# --- kinds that the advice was not designed on ---------------------------------------------------------------------


def filtered(rng, count, pole):
    return signal.lfilter([1.0], [1.0, -pole], rng.standard_normal(count + 200))[200:]


def fir(rng, **how):
    features, samples = sizes(rng)
    u = filtered(rng, samples + FRESH + features, rng.uniform(0.3, 0.97))
    rows = np.lib.stride_tricks.sliding_window_view(u, features)[: samples + FRESH, ::-1]
    return assemble(rng, rows, coefficients(rng, features), **how)


def tones(rng, **how):
    features, samples = sizes(rng)
    time, pitch = np.arange(samples + FRESH), rng.uniform(0.01, 0.4, 3)
    u = np.sin(2 * np.pi * pitch * time[:, None] + rng.uniform(0, 6.28, 3)).sum(axis=1)
    rows = np.column_stack([np.roll(u, k) for k in range(features)])
    return assemble(rng, rows, coefficients(rng, features), **how)


def powers(rng, **how):
    degree = int(rng.integers(2, 8))
    samples = int(rng.integers(2 * degree + 10, 200))
    rows = np.vander(rng.uniform(0, 1, samples + FRESH), degree + 1)[:, :-1]
    return assemble(rng, rows, coefficients(rng, degree), **how)


def switches(rng, **how):
    features, samples = sizes(rng)
    truth = coefficients(rng, features) * (rng.random(features) < 0.4)
    truth[0] = truth[0] or 1.0
    return assemble(rng, 1.0 * (rng.random((samples + FRESH, features)) < 0.5), truth, **how)


def wandering(rng, **how):
    # its new rows are of the same stretch of time: elsewhere they would be of another size
    features, samples = sizes(rng)
    rows = np.cumsum(rng.standard_normal((samples, features)), axis=0)
    return assemble(
        rng, np.vstack([rows, rows[rng.integers(0, samples, FRESH)]]), coefficients(rng, features), **how
    )


def arx(rng, known=False, instrumental=False):
    """y of an own past and an input; noise of the sensor of y stands in the regressors, too."""
    samples = int(rng.integers(60, 400))
    radius, angle = rng.uniform(0.5, 0.97), rng.uniform(0.2, 2.5)
    poles = np.array([2 * radius * np.cos(angle), -(radius**2)])
    gain = rng.standard_normal(2)
    u = filtered(rng, samples + FRESH, rng.uniform(0, 0.9))
    y = signal.lfilter(np.append(0.0, gain), np.append(1.0, -poles), u)
    truth = np.concatenate([poles, gain])
    rows = np.column_stack([np.roll(y, 1), np.roll(y, 2), np.roll(u, 1), np.roll(u, 2)])[10:]
    deviation = y.std() * 10 ** rng.uniform(-2, 0)
    measured = y + deviation * rng.standard_normal(len(y))
    seen = np.column_stack([np.roll(measured, 1), np.roll(measured, 2), rows_of(u)])[10:]
    older = np.column_stack([np.roll(u, k) for k in range(1, 9)])[10:]
    wanted, output = rows @ truth, measured[10:]
    n = samples - 10
    return Problem(
        seen[:n], output[:n], (rows if known or instrumental else seen)[n:], wanted[n:], deviation,
        np.array([deviation, deviation, 0.0, 0.0]) if known else None, older[:n] if instrumental else None,
    )  # fmt: skip


def rows_of(u):
    return np.column_stack([np.roll(u, 1), np.roll(u, 2)])


def student(rng):
    freedom = rng.uniform(1.5, 4)
    return lambda n: rng.standard_t(freedom, n)


def uneven(rng):
    return lambda n: rng.standard_normal(n) * np.linspace(0.1, 2.0, n)


def coloured(rng):
    pole = rng.uniform(0.5, 0.95)
    return lambda n: filtered(rng, n, pole) * np.sqrt(1 - pole**2)


def misjudged(rng):
    found = white(rng, share=rng.uniform(0.1, 0.5), known=True)
    found.noise = found.noise * rng.uniform(0.6, 1.6)
    return found


def units(rng, problem):
    scale, size = 10 ** rng.uniform(-9, 9, problem.X.shape[1]), 10 ** rng.uniform(-9, 9)
    problem.X, problem.new, problem.y = problem.X * scale, problem.new * scale, problem.y * size
    problem.wanted, problem.deviation = problem.wanted * size, problem.deviation * size
    problem.noise = None if problem.noise is None else problem.noise * scale
    return problem


TEST = {
    "low-pass input": fir,
    "three tones": tones,
    "powers": powers,
    "switches, few of which count": switches,
    "wandering features": wandering,
    "ARX": arx,
    "ARX, noise known": lambda rng: arx(rng, known=True),
    "ARX, older inputs": lambda rng: arx(rng, instrumental=True),
    "Student's noise": lambda rng: fir(rng, errors=student(rng)),
    "uneven noise": lambda rng: white(rng, errors=uneven(rng)),
    "coloured noise": lambda rng: fir(rng, errors=coloured(rng)),
    "low-pass input, noise known": lambda rng: fir(rng, share=rng.uniform(0.05, 0.5), known=True),
    "noise misjudged": misjudged,
    "low-pass input, second sensor": lambda rng: fir(
        rng, share=rng.uniform(0.05, 0.7), instruments=second_sensor(rng)
    ),
    "noise and units": lambda rng: units(
        rng, white(rng, share=rng.uniform(0.1, 0.6), known=True, offset=3.0)
    ),
}


# --- kinds by a second author, who had the advice's specification but not the kinds above ---------------------


def drawn(rng, rows, clean, errors, noise=0.0, given=None, instruments=None):
    """Those to learn from first, as many as there are errors of y; `given` is the noise that the advice is given."""
    n = len(errors)
    measured = rows + noise * rng.standard_normal(rows.shape)
    new = measured if given is None and instruments is None else rows
    deviation = float(np.median(np.abs(errors)) / 0.6745)
    return Problem(measured[:n], clean[:n] + errors, new[n:], clean[n:], deviation, given, instruments)


def lagged(u, taps):
    return np.column_stack([np.roll(u, k) for k in range(taps)])[taps:]


def slow(rng, n, p, pole):
    return np.column_stack([filtered(rng, n + FRESH, pole) for _ in range(p)]) * np.sqrt(1 - pole**2)


def resonance(rng):
    n, taps = rng.integers(60, 400), rng.integers(5, 30)
    rows = lagged(filtered(rng, n + FRESH + taps, rng.uniform(0, 0.97)), taps)
    t = np.arange(taps)
    clean = rows @ (np.exp(-t / rng.uniform(2, 10)) * np.sin(t * rng.uniform(0.2, 2) + 1))
    return drawn(rng, rows, clean, rng.uniform(0.05, 2) * clean.std() * rng.standard_normal(n))


def sensor_curve(rng):
    n, degree, low = rng.integers(12, 60), rng.integers(3, 8), rng.uniform(-2, 5)
    x = rng.uniform(low, low + rng.uniform(0.5, 5), n + FRESH)
    clean = 3 * np.tanh(rng.uniform(0.3, 2) * x) + 0.2 * x
    return drawn(
        rng, x[:, None] ** np.arange(1, degree + 1), clean, rng.uniform(0.02, 1) * rng.standard_normal(n)
    )


def wide(rng):
    n, p = rng.integers(25, 60), rng.integers(15, 50)
    rows, truth = rng.standard_normal((n + FRESH, p)), np.zeros(p)
    truth[rng.choice(p, 3)] = 2 * rng.standard_normal(3)
    return drawn(rng, rows, rows @ truth, rng.uniform(0.1, 3) * rng.standard_normal(n))


def plain(rng, pole, errors, most=8, offset=0.0, least=40):
    n, p = int(rng.integers(least, 400)), int(rng.integers(1, most))
    rows = slow(rng, n, p, pole)
    clean = rows @ rng.standard_normal(p) + offset
    return drawn(rng, rows, clean, errors(rows[:n], clean))


def heavy_tails(rng):
    return plain(
        rng, 0.5, lambda rows, _: rng.uniform(0.1, 1.5) * rng.standard_t(rng.uniform(0.9, 4), len(rows))
    )


def at_the_rail(rng):
    def errors(rows, _):
        found, begin = 0.2 * rng.standard_normal(len(rows)), rng.integers(0, len(rows) // 2)
        found[begin : begin + rng.integers(2, len(rows) // 5)] = rng.choice([-1, 1]) * rng.uniform(5, 50)
        return found

    return plain(rng, 0.8, errors)


def growing(rng):
    def errors(rows, _):
        by_time = rng.random() < 0.5
        size = np.linspace(0.05, 4, len(rows)) if by_time else np.linalg.norm(rows, axis=1) ** 2
        return rng.uniform(0.1, 1) * size * rng.standard_normal(len(rows))

    return plain(rng, 0.0, errors)


def weak(rng):
    def errors(rows, clean):
        return clean.std() * rng.uniform(0.01, 0.1) ** -0.5 * rng.standard_normal(len(rows))

    return plain(rng, rng.uniform(0, 0.7), errors, most=12)


def unrelated(rng):
    n, p = rng.integers(20, 300), rng.integers(1, 15)
    rows = slow(rng, n, p, rng.uniform(0, 0.99))
    return drawn(rng, rows, np.full(n + FRESH, 2.0), filtered(rng, n, rng.uniform(0, 0.9)))


def measured(rng, n, p, share, pole=0.0, given=1.0, units=1.0, offset=0.0):
    """Features with noise, of which `given` times the size is known."""
    rows = slow(rng, n, p, pole) * units
    noise = share * units * np.ones(p)
    clean = rows / units @ rng.standard_normal(p) + offset
    return drawn(rng, rows, clean, rng.uniform(0.05, 1) * rng.standard_normal(n), noise, given * noise)


def own_units(rng):
    p = rng.integers(1, 7)
    share, pole, scale = rng.uniform(0.05, 1.2, p), rng.uniform(0, 0.9), 10.0 ** rng.uniform(-6, 3, p)
    return measured(rng, rng.integers(40, 1000), p, share, pole, units=scale)


def part_noisy(rng):
    p = rng.integers(2, 7)
    share = np.where(rng.random(p) < 0.5, 0.0, rng.uniform(0.3, 2, p))
    return measured(rng, rng.integers(40, 600), p, share, 0.6, offset=1.0)


def off_by_half(rng):
    share, given = rng.uniform(0.1, 0.8), rng.uniform(0.5, 1.5)
    return measured(rng, rng.integers(60, 600), rng.integers(1, 5), share, given=given)


def drowned(rng):
    return measured(rng, rng.integers(50, 800), rng.integers(1, 5), rng.uniform(1, 6))


def seen_twice(rng, gain, other, own, pole=0.0):
    n, p = rng.integers(50, 600), rng.integers(1, 5)
    rows = slow(rng, n, p, pole)
    seen = rows[:n] @ gain(p) + other * rng.standard_normal((n, p))
    errors = rng.uniform(0.05, 1) * rng.standard_normal(n)
    return drawn(rng, rows, rows @ rng.standard_normal(p) - 3, errors, own, instruments=seen)


def cross_talk(rng):
    def gain(p):
        return np.eye(p) + 0.3 * rng.standard_normal((p, p))

    return seen_twice(rng, gain, rng.uniform(0.1, 1.5), rng.uniform(0.1, 1.5), rng.uniform(0, 0.9))


def hardly_seen(rng):
    return seen_twice(rng, lambda p: rng.uniform(0.02, 0.2) * np.eye(p), 1.0, rng.uniform(0.2, 1))


def going_on(rng):
    # trends, judged where nothing was learned
    n, p = rng.integers(60, 300), rng.integers(2, 6)
    rows = np.cumsum(rng.standard_normal((2 * n, p)), axis=0)
    return drawn(rng, rows, rows @ rng.standard_normal(p) + 10, rng.uniform(0.1, 5) * rng.standard_normal(n))


def alike(rng):
    n, p = rng.integers(30, 200), rng.integers(2, 5)
    rows = rng.standard_normal((n + FRESH, p))
    near = rows[:, 1:2] + 10.0 ** rng.uniform(-6, -2) * rng.standard_normal((n + FRESH, 1))
    clean = rows @ rng.standard_normal(p)
    rows = np.column_stack([rows, rows[:, 0], np.full(n + FRESH, 3.0), near])
    return drawn(rng, rows, clean, rng.uniform(0.1, 1) * rng.standard_normal(n))


def tones_in_taps(rng):
    n, taps = rng.integers(80, 300), rng.integers(8, 25)
    t = np.arange(n + FRESH + taps)
    pitch = rng.uniform(0.05, 2.5, rng.integers(1, 5))
    rows = lagged((rng.uniform(0.3, 1, len(pitch)) * np.sin(t[:, None] * pitch + 1)).sum(axis=1), taps)
    clean = rows @ (rng.standard_normal(taps) * 0.8 ** np.arange(taps))
    return drawn(rng, rows, clean, rng.uniform(0.1, 2) * clean.std() * rng.standard_normal(n), 1e-3)


def hardly_moved(rng):
    n, taps = rng.integers(80, 400), rng.integers(3, 10)
    rows = lagged(np.repeat(rng.standard_normal((n + FRESH + taps) // 20 + 1), 20)[: n + FRESH + taps], taps)
    return drawn(rng, rows, rows @ 0.7 ** np.arange(taps), rng.uniform(0.1, 2) * rng.standard_normal(n))


def walking(rng):
    # coefficients that walk; judged with the last ones
    n, p = rng.integers(60, 300), rng.integers(1, 6)
    rows, step = rng.standard_normal((n + FRESH, p)), rng.uniform(0.01, 0.1)
    truth = rng.standard_normal(p) + np.cumsum(step * rng.standard_normal((n, p)), axis=0)
    clean = np.concatenate([(rows[:n] * truth).sum(axis=1), rows[n:] @ truth[-1]])
    return drawn(rng, rows, clean, rng.uniform(0.1, 1) * rng.standard_normal(n))


def own_past(rng):
    n, w, z = rng.integers(80, 500), rng.uniform(0.1, 1), rng.uniform(0.01, 0.2)
    poles = [1.0, -2 * np.exp(-z * w) * np.cos(w * np.sqrt(1 - z * z)), np.exp(-2 * z * w)]
    u = rng.standard_normal(n + FRESH + 102)
    y = signal.lfilter([0.0, 1.0], poles, u)
    y += rng.uniform(0.02, 0.5) * y.std() * rng.standard_normal(len(y))
    rows = np.column_stack([y[1:-1], y[:-2], u[1:-1]])[100:]
    return drawn(rng, rows, y[102:], np.zeros(n))


SECOND = [
    resonance, sensor_curve, wide, heavy_tails, at_the_rail, growing, weak, unrelated, own_units, part_noisy,
    off_by_half, drowned, cross_talk, hardly_seen, going_on, alike, tones_in_taps, hardly_moved, walking, own_past,
]  # fmt: skip
SECOND = {each.__name__.replace("_", " "): each for each in SECOND}


# --- machines as they are measured, written before the last rules of choice and not looked at until these stood ------


def oscillating(rng, n):
    """Displacement, velocity and acceleration of a mass on a spring, under a force that is filtered noise."""
    w, z = rng.uniform(0.05, 0.8), rng.uniform(0.01, 0.4)
    q = signal.lfilter(
        [1.0], [1.0, -2 * np.exp(-z * w) * np.cos(w), np.exp(-2 * z * w)], filtered(rng, n, 0.5)
    )
    v = np.gradient(q)
    return np.column_stack([q, v, np.gradient(v)])


def friction(rng, n):
    q = oscillating(rng, n)
    return np.column_stack([q, np.sign(q[:, 1]), q[:, 0] ** 3 / np.mean(q[:, 0] ** 2)])


def moves(rng, n):
    """Point-to-point moves: long rests."""
    beat = int(rng.integers(15, 60))
    a = np.zeros(n)
    for k in range(0, n, beat):
        size, half = rng.normal(), beat // 6
        a[k : k + half], a[k + half : k + 2 * half] = size, -size
    v = np.cumsum(a) * 0.2
    return np.column_stack([a, v, np.cos(np.cumsum(v) * 0.05)])


def cams(rng, n):
    angle = 2 * np.pi * rng.uniform(0.003, 0.05) * np.arange(n)
    return np.column_stack(
        [f(k * angle) for k in range(1, int(rng.integers(2, 6))) for f in (np.sin, np.cos)]
    )


def bumps(rng, n):
    x, centres = rng.uniform(0, 1, n), np.linspace(0, 1, int(rng.integers(3, 9)))
    return np.exp(-(((x[:, None] - centres) / rng.uniform(0.1, 0.5)) ** 2))


def temperatures(rng, n):
    day = np.sin(2 * np.pi * np.arange(n) / rng.uniform(30, 300))
    return np.column_stack(
        [20 + 5 * day + filtered(rng, n, 0.95) * rng.uniform(0.05, 1) for _ in range(rng.integers(2, 6))]
    )


def garch(rng, n):
    e, size = np.zeros(n), 1.0
    for k in range(n):
        e[k] = size * rng.standard_normal()
        size = np.sqrt(0.1 + 0.3 * e[k] ** 2 + 0.6 * size**2)
    return e


def hum(rng, n):
    return np.sqrt(2) * np.sin(
        rng.uniform(0.1, 3) * np.arange(n) + rng.uniform(0, 6)
    ) + 0.2 * rng.standard_normal(n)


def steps(rng, n):
    return np.repeat(rng.standard_normal(n // 12 + 1), 12)[:n] + 0.3 * rng.standard_normal(n)


def dropouts(rng, n):
    return rng.standard_normal(n) - np.where(rng.random(n) < rng.uniform(0.01, 0.2), rng.uniform(3, 60), 0.0)


def rounded(rng, n):
    return rng.uniform(-1.7, 1.7, n)


def bench(rng):
    """One of the regressors, one of the errors, and what is known of the sensors."""
    n = int(np.exp(rng.uniform(np.log(25), np.log(700))))
    rows = [oscillating, friction, moves, cams, bumps, temperatures][rng.integers(6)](rng, n + FRESH)
    p = rows.shape[1]
    spread = rows.std(axis=0)
    clean = rows / spread @ (rng.standard_normal(p) * rng.choice([1.0, 0.2, 0.0], p, p=[0.6, 0.3, 0.1]))
    size = clean.std() or 1.0
    errors = [garch, hum, steps, dropouts, rounded, lambda r, n: r.standard_normal(n)][rng.integers(6)](
        rng, n
    )
    errors = size * 10 ** rng.uniform(-1.5, 0.6) * errors
    noise = 10 ** rng.uniform(-2, 0) * spread * rng.choice([1.0, 0.0, 2.0], p, p=[0.7, 0.2, 0.1])
    known = rng.integers(4)
    if known == 0:
        return drawn(rng, rows, clean, errors)
    if known == 1:
        return drawn(rng, rows, clean, errors, noise)
    if known == 2:
        return drawn(rng, rows, clean, errors, noise, noise * rng.uniform(0.7, 1.4))
    other = rows[:n] + noise * 10 ** rng.uniform(-0.5, 1) * rng.standard_normal((n, p))
    return drawn(rng, rows, clean, errors, noise, instruments=other)


THIRD = {"machines": bench}

# --- plants and calibrations of a laboratory, written before the last trial of other parts was dropped, and looked at once -----------------------


def thermal(rng, n):
    """Valve openings that are seldom changed, each followed by a slow creep of two temperatures."""
    u = np.repeat(rng.uniform(0, 1, n // 8 + 1), rng.integers(4, 60, n // 8 + 1))[:n]
    near, far = (
        signal.lfilter([1 - pole], [1, -pole], np.pad(u, (0, n - len(u)), mode="edge"))
        for pole in rng.uniform(0.8, 0.995, 2)
    )
    return np.column_stack([np.pad(u, (0, n - len(u)), mode="edge"), near, far])


def scan(rng, n):
    """A triangle over a stage's stroke, with its square, and a grating's period."""
    x = signal.sawtooth(2 * np.pi * rng.uniform(0.002, 0.05) * np.arange(n) + rng.uniform(0, 6.28), 0.5)
    pitch = rng.uniform(3, 40)
    return np.column_stack([x, x**2, np.sin(pitch * x), np.cos(pitch * x)])


def impacts(rng, n):
    """Hammer blows, decaying in three modes."""
    blows = (rng.random(n) < rng.uniform(0.01, 0.1)) * rng.exponential(1.0, n)
    modes = rng.uniform(0.1, 2.5, 3)
    return np.column_stack(
        [
            signal.lfilter([1.0], [1.0, -1.9 * r * np.cos(w) / 0.95, r * r], blows)
            for r, w in zip(rng.uniform(0.6, 0.97, 3), modes, strict=True)
        ]
    )


def levels(rng, n):
    """A design of two or three levels a factor with their products, in blocks."""
    factors = np.repeat(rng.integers(-1, 2, (n // 3 + 1, 3)), 3, axis=0)[:n].astype(float)
    return np.column_stack([factors, factors[:, 0] * factors[:, 1], factors[:, 2] ** 2])


def regimes(rng, n):
    """Sensors of a process that jumps between two states of unlike spread."""
    state = np.cumsum(rng.random(n) < 0.02) % 2
    common = rng.standard_normal((n, 2)) * np.where(state, 3.0, 0.2)[:, None]
    return common @ rng.standard_normal((2, int(rng.integers(2, 7)))) + 0.3 * rng.standard_normal(1)


def multisine(rng, n):
    lines = rng.integers(1, 60, 6)
    u = np.cos(2 * np.pi * np.outer(np.arange(n + 8), lines) / 256 + rng.uniform(0, 6.28, 6)).sum(axis=1)
    return np.column_stack([u[8 - k : n + 8 - k] for k in range(int(rng.integers(1, 8)))])


def laboratory(draw):
    """Problems of one kind of features, with errors and knowledge at random."""

    def problem(rng):
        n = int(rng.choice([15, 25, 40, 80, 200, 600]))
        rows = draw(rng, n + FRESH)
        spread = np.where(rows.std(axis=0) > 0, rows.std(axis=0), 1.0)
        clean = rows / spread @ rng.standard_normal(rows.shape[1]) * 10 ** rng.uniform(-1, 1)
        errors = [
            lambda: rng.laplace(size=n),
            lambda: np.cumsum(rng.standard_normal(n)) / np.sqrt(n),
            lambda: (
                rng.standard_normal(n) * (1 + 3 * np.abs(clean[:n] - clean[:n].mean()) / (clean.std() or 1.0))
            ),
            lambda: signal.lfilter([1.0, 0.9], [1.0], rng.standard_normal(n)),
            lambda: np.round(3 * rng.standard_normal(n)) / 3,
        ][rng.integers(5)]()
        errors = errors * (clean.std() or 1.0) * 10 ** rng.uniform(-1.3, 0.8)
        noise = spread * 10 ** rng.uniform(-1.5, 0.2) * rng.choice([0.0, 1.0], rows.shape[1], p=[0.3, 0.7])
        if rng.random() < 0.4:
            return drawn(rng, rows, clean, errors, 0.0 if rng.random() < 0.5 else noise)
        if rng.random() < 0.7:
            return drawn(rng, rows, clean, errors, noise, noise)
        mixed = rows[:n] @ (np.eye(rows.shape[1]) + 0.1 * rng.standard_normal((rows.shape[1],) * 2))
        other = mixed + noise * rng.standard_normal((n, rows.shape[1]))
        return drawn(rng, rows, clean, errors, noise, instruments=other)

    return problem


FOURTH = {each.__name__: laboratory(each) for each in (thermal, scan, impacts, levels, regimes, multisine)}

# --- records of two lengths, with the noise given exactly, at half or at twice its size, or not ------------------------


def stated(kind: str, given: float | None):
    """Problems of one kind; `given` is the size of the noise that is given over the true one, None for not given."""

    def problem(rng):
        short = rng.random() < 0.5
        samples = int(rng.integers(10, 31) if short else rng.integers(150, 500))
        features, pole = int(rng.integers(2, 7)), rng.choice([0.0, rng.uniform(0, 0.97)])
        if kind == "many features":
            features = int(rng.integers(samples // 2, samples + 8) if short else rng.integers(40, 80))
        shape = samples + FRESH, features
        rows = signal.lfilter([np.sqrt(1 - pole**2)], [1, -pole], rng.standard_normal(shape), axis=0)
        if kind == "nearly alike":
            rows = rows[:, :1] + 10 ** rng.uniform(-3, -0.7) * rows
        if kind == "at rest":
            moves = np.repeat(rng.random(len(rows) // 20 + 1) < 0.35, 20)[: len(rows)]
            moves[:5] = True
            rows = rows * moves[:, None]
        if kind == "off zero":
            rows = rows + rng.normal(0, 20, features)
        clean = rows @ (rng.standard_normal(features) * 10 ** rng.normal(0, 0.4, features))
        size = clean[:samples].std() * 10 ** rng.uniform(-2, 0.5)
        hit = rng.random(samples) < (rng.uniform(0.02, 0.15) if kind == "spikes" else 0.0)
        errors = size * rng.standard_normal(samples) * np.where(hit, rng.uniform(20, 100), 1.0)
        noise = (
            rows[:samples].std(axis=0) * 10 ** rng.uniform(-2, -0.2) * 10 ** rng.uniform(-0.3, 0.3, features)
        )
        return drawn(rng, rows, clean, errors, noise, None if given is None else given * noise)

    return problem


FIFTH = {
    f"{kind}, noise times {given}": stated(kind, given)
    for kind in ("plain", "nearly alike", "at rest", "off zero", "spikes", "many features")
    for given in (None, 1.0, 0.5, 2.0)
}

GENERATORS = {
    "test": (TEST, 12), "train": (TRAINING, 1), "second": (SECOND, 14), "third": (THIRD, 15), "fourth": (FOURTH, 16),
    "fifth": (FIFTH, 17),
}  # fmt: skip


def judge(problem: Problem) -> tuple[str, str, np.ndarray, np.ndarray, bool]:
    """Who is advised, who is best, over the best and over ignoring the features: (with the noise of y, without); if warned."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        advised = advise(problem.X, problem.y, problem.noise, problem.instruments)
        ranking = advised.ranking
        fitted = {each.name: each.estimator for each in ranking}
        if (
            problem.noise is not None
        ):  # one with more freedom than the advice has, which may be the best as well
            plain = BiasCompensatedRegressor(
                problem.noise / (problem.X.std(axis=0) + (np.ptp(problem.X, axis=0) == 0))
            )
            fitted["without a penalty"] = make_pipeline(StandardScaler(with_mean=False), plain).fit(
                problem.X, problem.y
            )
        errors = {
            name: np.sqrt(np.mean((each.predict(problem.new) - problem.wanted) ** 2))
            for name, each in fitted.items()
        }
    ignored = errors["ignoring the features"]
    best = min(errors, key=errors.__getitem__)
    floors = np.array([problem.deviation, 0.0])
    own, least, none = (np.hypot(each, floors) for each in (errors[ranking[0].name], errors[best], ignored))
    return ranking[0].name, best, own / least, own / none, bool(advised.warnings)


def main() -> None:
    advice.SHARES = ()  # where it would turn is not judged
    which = next((generator for generator in GENERATORS if f"--{generator}" in sys.argv), "test")
    kinds, seed = GENERATORS[which]
    given = dict(each.split("=") for each in sys.argv if "=" in each)
    seed, size = int(given.get("seed", seed)), float(given.get("size", 1.0))
    counts = [int(each) for each in sys.argv[1:] if each.isdigit()]
    kinds = list(kinds.items())
    count, rows, began = counts[0] if counts else 300, [], time.process_time()
    for number in range(count):
        name, draw = kinds[number % len(kinds)]
        problem = draw(np.random.default_rng([seed, number]))
        if size == 1.0:
            rows.append((name, *judge(problem)))
        elif problem.noise is not None:
            problem.noise = size * problem.noise
            rows.append((name, *judge(problem)))
    print(f"{'':34s} within 10 % of the best   at worst over ignoring, over the best   advised most")
    groups = {kind: [row for row in rows if row[0] == kind] for kind in dict.fromkeys(row[0] for row in rows)}
    groups |= {
        f"{word} warning": [row for row in rows if row[5] == warned]
        for word, warned in (("no", False), ("with a", True))
    }
    for kind, own in {
        f"{name}, {len(own)}": own for name, own in (groups | {"all": rows}).items() if own
    }.items():
        over, ignoring = np.array([row[3] for row in own]), np.array([row[4] for row in own])
        names = [row[1] for row in own]
        shares, worst = np.mean(over < 1.1, axis=0), ignoring.max(axis=0)
        print(
            f"{kind:34s} {shares[0]:8.0%} ({shares[1]:.0%} without noise)  {worst[0]:8.2f} ({worst[1]:.2f})"
            f"  {over.max(axis=0)[0]:8.2f}   {max(names, key=names.count)}"
        )
    print(f"{(time.process_time() - began) / len(rows):.2f} s of CPU each, of {len(rows)}")


if __name__ == "__main__":
    main()
