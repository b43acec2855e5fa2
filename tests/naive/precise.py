"""Responses and norms in decimal arithmetic of 70 digits, by elimination: no polynomial and no eigenvalue."""

from decimal import Context, Decimal, localcontext

import numpy as np

from stillwork import lti
from stillwork.lti.delays import delayed
from stillwork.lti.discretisation import zoh_modes

DIGITS = 70
KINDS = (
    "modes",
    "sampled",
    "late",
    "random basis",
    "double pole",
    "cancelled",
    "pass",
    "feedthrough",
    "dense",
)


class Complex:
    """A complex number of two decimals."""

    __slots__ = ("im", "re")

    def __init__(self, re, im=Decimal(0)):
        self.re, self.im = Decimal(re), Decimal(im)

    def __sub__(self, other):
        return Complex(self.re - other.re, self.im - other.im)

    def __add__(self, other):
        return Complex(self.re + other.re, self.im + other.im)

    def __mul__(self, other):
        return Complex(self.re * other.re - self.im * other.im, self.re * other.im + self.im * other.re)

    def __truediv__(self, other):
        size = other.re**2 + other.im**2
        return Complex(
            (self.re * other.re + self.im * other.im) / size, (self.im * other.re - self.re * other.im) / size
        )

    def square(self):
        return self.re**2 + self.im**2


def place(model, w):
    """s = jw, or z = (1 + jw) / (1 - jw)."""
    return Complex(1, w) / Complex(1, -w) if model.sample_time else Complex(0, w)


def response(model, s):
    """C (sI - A)^-1 B + D at s, rows of complex numbers."""
    n, inputs = model.b.shape
    rows = [
        [Complex(-Decimal(float(x))) for x in a] + [Complex(Decimal(float(x))) for x in b]
        for a, b in zip(model.a, model.b, strict=True)
    ]
    for k in range(n):
        rows[k][k] = rows[k][k] + s
    for k in range(n):
        best = max(range(k, n), key=lambda r: rows[r][k].square())
        rows[k], rows[best] = rows[best], rows[k]
        for r in range(k + 1, n):
            if rows[r][k].square():
                factor = rows[r][k] / rows[k][k]
                rows[r] = rows[r][: k + 1] + [
                    x - factor * y for x, y in zip(rows[r][k + 1 :], rows[k][k + 1 :], strict=True)
                ]
    solved = [[Complex(0)] * inputs for _ in range(n)]
    for k in reversed(range(n)):
        for j in range(inputs):
            total = rows[k][n + j]
            for m in range(k + 1, n):
                total = total - rows[k][m] * solved[m][j]
            solved[k][j] = total / rows[k][k]
    found = []
    for i, line in enumerate(model.c):
        found.append([])
        for j in range(inputs):
            total = Complex(Decimal(float(model.d[i, j])))
            for k in range(n):
                total = total + Complex(Decimal(float(line[k]))) * solved[k][j]
            found[i].append(total)
    return found


def gain(model, w):
    """Largest singular value at `place`; one or two inputs."""
    found, inputs = response(model, place(model, w)), model.b.shape[1]
    columns = [[row[j] for row in found] for j in range(inputs)]
    if inputs == 1:
        return sum(each.square() for each in columns[0]).sqrt()
    p, r = (sum(each.square() for each in column) for column in columns)
    cross = Complex(0)
    for one, two in zip(*columns, strict=True):
        cross = cross + Complex(one.re, -one.im) * two
    return ((p + r + ((p - r) ** 2 + 4 * cross.square()).sqrt()) / 2).sqrt()


def extreme(function, low, high, sign=1):
    """Where a decimal function is largest (sign 1) or smallest (-1) between two numbers, by golden section."""
    ratio = (Decimal(5).sqrt() - 1) / 2
    low, high = Decimal(float(low)), Decimal(float(high))
    one, two = high - ratio * (high - low), low + ratio * (high - low)
    first, second = sign * function(one), sign * function(two)
    for _ in range(60):
        if first > second:
            high, two, second = two, one, first
            one = high - ratio * (high - low)
            first = sign * function(one)
        else:
            low, one, first = one, two, second
            two = low + ratio * (high - low)
            second = sign * function(two)
    return one


def precise_norm(model, start, step):
    """The local maximum of the gain over w near `start`, within `step` to either side."""
    with localcontext(Context(DIGITS)):
        low, high = max(start - step, 0.0), start + step
        at = extreme(lambda w: gain(model, w), low, high)
        return max(gain(model, w) for w in (at, Decimal(float(low)), Decimal(float(high))))


def gains(model, w):
    """Float gains over w, to see where the highest of them lie."""
    s = (1 + 1j * w) / (1 - 1j * w) if model.sample_time else 1j * w
    n = len(model.a)
    whole = model.c @ np.linalg.solve(s[:, None, None] * np.eye(n) - model.a, model.b + 0j) + model.d
    return np.linalg.norm(whole, 2, axis=(1, 2))


def sample_model(rng: np.random.Generator) -> tuple[str, lti.StateModel]:
    """A stable model of one of the kinds, each hard in its own way."""
    kind = KINDS[int(rng.integers(len(KINDS)))]
    inputs, outputs = (int(each) for each in rng.integers(1, 3, 2))
    count = int(rng.integers(1, 5))
    omega = np.sort(10 ** rng.uniform(0, 3, count))
    damping = 10 ** rng.uniform(-9 if rng.random() < 0.3 else -4, -0.3, count)
    shapes = rng.normal(size=(count, inputs)), rng.normal(size=(outputs, count))
    zero = np.zeros((outputs, inputs))
    modes = lti.ModalModel(omega, damping, *shapes, zero)
    model = modes.state_space()
    n = 2 * count
    if kind in ("sampled", "late"):
        model = zoh_modes(modes, 10 ** rng.uniform(-2, 0.3) / omega[-1])
        model = delayed(model, int(rng.integers(1, 5))) if kind == "late" else model
    elif kind == "random basis":
        basis = rng.normal(size=(n, n))
        back = np.linalg.inv(basis)
        changed = lti.StateModel(basis @ model.a @ back, basis @ model.b, model.c @ back, zero)
        model = changed if changed.is_stable else model
    elif kind == "double pole":
        chain = -np.eye(4) * 10 ** rng.uniform(-2, 2) + np.eye(4, k=1)
        model = lti.StateModel(chain, rng.normal(size=(4, inputs)), rng.normal(size=(outputs, 4)), zero)
    elif kind == "cancelled":
        b, c = model.b.copy(), model.c.copy()
        b[1] *= 1e-9
        model = lti.StateModel(model.a, b, c, zero)
    elif kind == "pass":
        rate = 10 ** rng.uniform(-3, 3)
        model = lti.StateModel(np.array([[-rate]]), np.array([[2 * rate]]), -np.eye(1), np.eye(1))
    elif kind == "feedthrough":
        model = lti.StateModel(
            model.a, model.b, model.c, rng.normal(size=zero.shape) * 10 ** rng.uniform(-6, 3)
        )
    elif kind == "dense":
        a = rng.normal(size=(n, n))
        step = float(rng.random() < 0.5)
        margin = 1 + 10 ** rng.uniform(-8, 0)
        poles = np.linalg.eigvals(a)
        a = (
            a / (margin * np.abs(poles).max())
            if step
            else a - margin * max(poles.real.max(), 0.1) * np.eye(n)
        )
        model = lti.StateModel(a, rng.normal(size=(n, inputs)), rng.normal(size=(outputs, n)), zero, step)
    return kind, model


def judged_norm(model: lti.StateModel) -> float:
    """The norm by a dense grid in floats and golden sections of 70 digits around its three highest points."""
    poles = np.linalg.eigvals(model.a)
    if model.sample_time:
        poles = (poles - 1) / (poles + 1)
    steps = np.sinh(np.linspace(-12, 12, 301)) * 0.01
    around = (
        np.abs(poles.imag)[:, None] + np.maximum(np.abs(poles.real), 1e-12 * np.abs(poles))[:, None] * steps
    )
    size = np.abs(poles)
    wide = np.geomspace(size.min() * 1e-4, size.max() * 1e12, 2000)
    w = np.unique(np.concatenate([[0.0], around[around > 0], wide]))
    seen = gains(model, w)
    tops = np.flatnonzero((seen >= np.append(seen[1:], 0)) & (seen >= np.append(0, seen[:-1])))
    tops = tops[np.argsort(seen[tops])[-3:]]
    steps = [max(w[k] - w[max(k - 1, 0)], w[min(k + 1, len(w) - 1)] - w[k]) for k in tops]
    # In floats the top of a light mode may be seen some way beside itself.
    found = [
        float(precise_norm(model, w[k], wide * step))
        for k, step in zip(tops, steps, strict=True)
        for wide in (1, 30, 1000)
    ]
    return max(found)


def precise_h2_norm(model: lti.StateModel, digits: int = 150) -> float:
    """H2 norm of the very numbers, A X + X A' + B B' = 0 or X = A X A' + B B' by elimination; NaN where there is none."""
    n = len(model.a)
    places = {pair: k for k, pair in enumerate((i, j) for i in range(n) for j in range(i, n))}

    def entry(i: int, j: int) -> int:
        return places[min(i, j), max(i, j)]

    with localcontext(Context(digits)):
        a, b, c, d = (
            [[Decimal(float(x)) for x in row] for row in m] for m in (model.a, model.b, model.c, model.d)
        )
        rows = []
        for i, j in places:
            row = [Decimal(0)] * (len(places) + 1)
            for k in range(n):
                if not model.sample_time:
                    row[entry(k, j)] += a[i][k]
                    row[entry(i, k)] += a[j][k]
                for m in range(n) if model.sample_time else ():
                    row[entry(k, m)] += a[i][k] * a[j][m]
            row[entry(i, j)] -= 1 if model.sample_time else 0
            row[-1] = -sum(x * y for x, y in zip(b[i], b[j], strict=True))
            rows.append(row)
        for k in range(len(rows)):
            pivot = max(range(k, len(rows)), key=lambda r: abs(rows[r][k]))
            rows[k], rows[pivot] = rows[pivot], rows[k]
            rows[k] = [x / rows[k][k] for x in rows[k]]
            for r in range(len(rows)):
                if r != k and (factor := rows[r][k]):
                    rows[r] = [x - factor * y for x, y in zip(rows[r], rows[k], strict=True)]
        square = [[rows[entry(i, j)][-1] for j in range(n)] for i in range(n)]
        power = sum(line[i] * square[i][j] * line[j] for line in c for i in range(n) for j in range(n))
        power += sum(x * x for row in d for x in row)
        return float(power.sqrt()) if power >= 0 else float("nan")
