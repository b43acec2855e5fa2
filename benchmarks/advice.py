"""How good `estimation.advise` is: problems drawn at random, each with its truth, `python benchmarks/advice.py [COUNT] [--train]`.

The advice was designed on the kinds of `TRAINING` alone; what is printed without ``--train`` is of the other kinds and of
other seeds. An error is that of predictions of y at 4000 new rows, of features as they were measured where nothing was
known, else of features without their noise; once with the noise of new outputs in it, which nobody can predict, and once
without it.
"""

import os
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "lib"), str(ROOT)]

import numpy as np  # noqa: E402
from scipy import signal  # noqa: E402

from stillwork.estimation import advise  # noqa: E402

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


def judge(problem: Problem) -> tuple[str, str, np.ndarray, np.ndarray]:
    """Who is advised, who is best, and over the best and over ignoring the features: (with the noise of y, without)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        advice = advise(problem.X, problem.y, problem.noise, problem.instruments)
        errors = {
            each.name: np.sqrt(np.mean((each.estimator.predict(problem.new) - problem.wanted) ** 2))
            for each in advice.ranking
        }
    ignored = errors["ignoring the features"]
    best = min(errors, key=errors.__getitem__)
    floors = np.array([problem.deviation, 0.0])
    own, least, none = (
        np.hypot(each, floors) for each in (errors[advice.ranking[0].name], errors[best], ignored)
    )
    return advice.ranking[0].name, best, own / least, own / none


def main() -> None:
    training = "--train" in sys.argv
    counts = [int(each) for each in sys.argv[1:] if each.isdigit()]
    kinds = list((TRAINING if training else TEST).items())
    count, rows = counts[0] if counts else 300, []
    for number in range(count):
        name, draw = kinds[number % len(kinds)]
        rng = np.random.default_rng([1 if training else 2, number])
        rows.append((name, *judge(draw(rng))))
    print(f"{'':34s} within 10 % of the best   at worst over ignoring   advised most")
    for kind in [name for name, _ in kinds] + ["all"]:
        own = [row for row in rows if kind in (row[0], "all")]
        over, ignoring = np.array([row[3] for row in own]), np.array([row[4] for row in own])
        names = [row[1] for row in own]
        shares, worst = np.mean(over < 1.1, axis=0), ignoring.max(axis=0)
        print(
            f"{kind:34s} {shares[0]:8.0%} ({shares[1]:.0%} without noise)  {worst[0]:8.2f} ({worst[1]:.2f})"
            f"   {max(names, key=names.count)}"
        )


if __name__ == "__main__":
    main()
