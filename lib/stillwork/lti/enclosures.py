"""Proven bounds: peaks of models as they stand in floating-point numbers, by integer arithmetic alone.

A float is an integer times a power of two, so the transfer function of a model is a quotient of polynomials with
integer coefficients, exactly. Whether it stays below a level is whether one polynomial has no positive root, and
whether the model is stable is a Routh array with directed rounding: no eigenvalue is computed on the way.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from fractions import Fraction
from itertools import accumulate, pairwise, permutations
from math import inf, nextafter

import numpy as np
from scipy import linalg

from stillwork.base.checks import InputError, require_array, require_flag
from stillwork.base.validation import by_value, checked
from stillwork.lti.discretisation import continuous_poles
from stillwork.lti.peaks import refine_peak, resonance_grid
from stillwork.lti.state_space import StateModel, coupled_states

WIDTH = 1e-8  # relative, to either side of an estimate
STEPS = 8.0  # factor by which a bound moves away from an estimate that it does not enclose
BITS = 1200  # of a polynomial's coefficients, at first
DIGITS = (100, 400, 2000)  # of a Routh array
LEAST, LARGEST = 1e-250, 1e250  # norm that is looked for
DEPTH = 200  # halvings of an interval in which a root may lie
MOST_SIGNALS = 3  # inputs or outputs, whichever are fewer

Polynomial = list[int]  # coefficients, the constant one first


@by_value
@dataclass(frozen=True)
class Enclosure:
    """Two numbers between which a quantity lies, and whether that is proven.

    Parameters
    ----------
    low, high : float
        Lower and upper bound of the quantity.
    proven : bool
        False: the bounds are not known to hold.

    Raises
    ------
    InputError
        When the lower number is above the higher one.

    References
    ----------
    Moore, Kearfott and Cloud, Introduction to Interval Analysis (2009).

    Examples
    --------
    >>> print(lti.Enclosure(1.95, 1.9952, True).in_db())
    at most 5.9998, proven
    """

    low: float
    high: float
    proven: bool

    def __post_init__(self):
        for name in ("low", "high"):
            number = require_array(name, getattr(self, name), shape=(), infinite=True)
            object.__setattr__(self, name, float(number))
        object.__setattr__(self, "proven", require_flag("proven", self.proven))
        if self.low > self.high:
            raise InputError(f"low is {self.low:g}, above high, {self.high:g}; give the lower number first")

    def in_db(self) -> "Enclosure":
        """The bounds in dB, 20 log10, rounded outwards.

        Returns
        -------
        Enclosure
            In dB.

        Examples
        --------
        >>> bool(lti.Enclosure(1.0, 2.0, True).in_db().high > 6.02)
        True
        """
        low, high = (20 * np.log10(each) if each > 0 else -inf for each in (self.low, self.high))
        return Enclosure(outward(float(low), -1), outward(float(high), 1), self.proven)

    def __str__(self) -> str:
        if not self.proven:
            return "not proven"
        return f"at most {np.ceil(self.high * 1e4) / 1e4:.4f}, proven"


@checked(infinite=True)
def outward(value: float, sign: int) -> float:
    """The float some places below or above a computed one, by the sign."""
    for _ in range(4):  # a logarithm is right to less than two units in the last place
        value = nextafter(value, sign * inf)
    return value


@by_value
@dataclass(frozen=True)
class Quotients:
    """A matrix of quotients n(w) / d(w), w on the imaginary axis; a sampled model's by z = (1 + w) / (1 - w)."""

    numerators: list[list[Polynomial]]
    denominator: Polynomial

    def __post_init__(self):
        rows = self.numerators if isinstance(self.numerators, list) else [None]
        every = [each for row in rows for each in (row if isinstance(row, list) else [None])]
        for name, given in (("numerators", every), ("denominator", [self.denominator])):
            if not all(isinstance(each, list) and all(type(x) is int for x in each) for each in given):
                raise InputError(
                    f"{name} holds no lists of coefficients; give whole numbers, lowest power first"
                )


@checked(infinite=True)
def enclose_hinf_norm(model: StateModel) -> Enclosure:
    """Bounds of the H-infinity norm of a model, in continuous time or sampled, and proof of its stability.

    Parameters
    ----------
    model : StateModel
        Of at most three inputs or three outputs.

    Returns
    -------
    Enclosure
        For the floating-point numbers of the model as they are. Infinite and proven when it is unstable.

    Raises
    ------
    InputError
        When the model has more inputs and outputs.

    References
    ----------
    Collins and Akritas, Polynomial real root isolation using Descartes' rule of signs, SYMSAC (1976).

    Examples
    --------
    >>> mode = lti.ModalModel([100.0], [0.01], [[1.0]], [[1.0]], [[0.0]])
    >>> norm = lti.enclose_hinf_norm(mode.state_space())
    >>> norm.proven, round(norm.high * 100.0**2, 2)  # times the static compliance: 1 / (2 zeta)
    (True, 50.0)
    """
    if min(model.d.shape) > MOST_SIGNALS:
        raise InputError(f"model has {model.d.shape} outputs and inputs; give {MOST_SIGNALS} of one at most")
    return enclose_quotients(quotients(model), _estimate(model))


@checked
def is_proven_stable(model: StateModel) -> bool | None:
    """Whether all poles lie in the region of stability, proven for the model's floating-point numbers.

    Parameters
    ----------
    model : StateModel

    Returns
    -------
    bool or None
        None where neither is proven.

    References
    ----------
    Gantmacher, The Theory of Matrices (1959), chapter XV: Routh's array, here with directed rounding.

    Examples
    --------
    >>> lti.is_proven_stable(lti.StateModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]]))
    True
    """
    return _hurwitz(quotients(model).denominator)


def _estimate(model: StateModel) -> float:
    """The H-infinity norm by floating-point numbers, of which nothing is assumed."""
    poles, h = model.poles, model.sample_time
    omega = np.zeros(1)
    if len(poles):
        poles = continuous_poles(poles, h) if h else poles
        size = np.abs(poles)[np.abs(poles) > 0]
        if len(size):
            ends = size.min() / 1e3, size.max() * 1e3
            omega = resonance_grid(poles, ends[0] / 6.3, ends[1] / 6.3, 400, 60)
            omega = np.concatenate([[0.0], np.abs(poles.imag), omega])
        omega = np.unique(np.append(omega[omega < np.pi / h], np.pi / h) if h else omega)

    def gains(omega: np.ndarray) -> np.ndarray:
        return np.linalg.norm(np.moveaxis(model.frequency_response(omega), -1, 0), 2, axis=(1, 2))

    try:
        values = gains(omega)
    except (InputError, np.linalg.LinAlgError):  # a pole beside the axis by less than a rounding
        return 1.0
    peak = refine_peak(gains, omega, values, near=0.9).magnitude if len(omega) > 2 else values.max()
    return float(max(peak, 0.0 if h else np.linalg.norm(model.d, 2)))


@checked
def quotients(model: StateModel) -> Quotients:
    """The transfer matrix of a model in integers."""
    numerators, denominator = in_z(model)
    if not model.sample_time:
        return Quotients(numerators, denominator)
    return turned(numerators, denominator)


@checked
def turned(numerators: list[list[Polynomial]], denominator: Polynomial) -> Quotients:
    """Quotients in w of those in z, none of higher degree than the denominator."""
    degree = len(denominator) - 1
    return Quotients(
        [[_turn(each, degree) for each in row] for row in numerators], _turn(denominator, degree)
    )


@checked
def in_z(model: StateModel) -> tuple[list[list[Polynomial]], Polynomial]:
    """Numerators and denominator of C (zI - A)^-1 B + D in z (in s), coefficients multiplied by one power of two."""
    scale = linalg.matrix_balance(model.a, permute=False, separate=True)[1][0] if len(model.a) else np.ones(0)
    a = model.a * scale / scale[:, None]  # by powers of two
    if not (np.array_equal(a * scale[:, None] / scale, model.a) and np.isfinite(a).all()):
        scale, a = np.ones(len(a)), model.a
    (a_int, up), (d_int, d_up) = _integers(a), _integers(model.d)
    (b_int, b_up), (c_int, c_up) = _exact(model.b, scale[:, None], -1), _exact(model.c, scale, 1)
    n = len(a)
    characteristic: Polynomial = [1]
    for part in coupled_states(a) if n else ():
        characteristic = multiply(characteristic, _characteristic(a_int[np.ix_(part, part)]))
    markov, driven = [], b_int
    for _ in range(n):
        markov.append(c_int @ driven)
        driven = a_int @ driven
    # In units of 2^up: G = 2^(b + c - up) (C adj B) / det + 2^d D.
    strict, direct = b_up + c_up - up, d_up
    low = min(strict, direct)
    rows = []
    for i in range(len(model.c)):
        row = []
        for j in range(model.b.shape[1]):
            numerator = [int(d_int[i, j]) * each << (direct - low) for each in characteristic]
            for k in range(n):
                total = sum(characteristic[m] * int(markov[m - 1 - k][i, j]) for m in range(k + 1, n + 1))
                numerator[k] += total << (strict - low)
            row.append(_moved(numerator, max(low, 0)))
        rows.append(row)
    denominator = _moved(characteristic, max(-low, 0))
    # From the unit 2^up to 1: the coefficient of z^k times 2^(-up k), all of them times one power of two.
    least = min(0, -up * n)
    units = [-up * k - least for k in range(n + 1)]
    shifted = [[[x << u for x, u in zip(each, units, strict=True)] for each in row] for row in rows]
    return shifted, [x << u for x, u in zip(denominator, units, strict=True)]


def _moved(polynomial: Polynomial, by: int) -> Polynomial:
    return [each << by for each in polynomial]


def _integers(matrix: np.ndarray) -> tuple[np.ndarray, int]:
    """The matrix as Python's integers times a power of two."""
    mantissa, exponent = np.frexp(matrix)
    exponent = exponent - 53
    used = mantissa != 0
    least = int(exponent[used].min()) if used.any() else 0
    whole = np.zeros(matrix.shape, dtype=object)
    for place in zip(*np.nonzero(used), strict=True):
        whole[place] = int(np.ldexp(mantissa[place], 53)) << int(exponent[place] - least)
    return whole, least


def _exact(matrix: np.ndarray, scale: np.ndarray, sign: int) -> tuple[np.ndarray, int]:
    """Integers of a matrix times powers of two, and the power of two that is left."""
    whole, least = _integers(matrix)
    powers = sign * (np.frexp(np.broadcast_to(scale, matrix.shape))[1] - 1)
    lowest = int(powers.min()) if powers.size else 0
    for place in np.ndindex(matrix.shape):
        whole[place] = int(whole[place]) << int(powers[place] - lowest)
    return whole, least + lowest


def _characteristic(a: np.ndarray) -> Polynomial:
    """det(zI - A) of integers, by Faddeev and LeVerrier: its divisions leave no remainder."""
    n = len(a)
    found, power = [1], np.zeros_like(a) + 0
    one = np.array([[int(i == j) for j in range(n)] for i in range(n)], dtype=object).reshape(n, n)
    for k in range(1, n + 1):
        power = a @ (power + found[-1] * one)
        found.append(-int(np.trace(power)) // k)
    return found[::-1]


@checked
def multiply(one: Polynomial, other: Polynomial) -> Polynomial:
    """The product of two polynomials."""
    return [int(each) for each in np.convolve(np.array(one, dtype=object), np.array(other, dtype=object))]


@checked
def add(one: Polynomial, other: Polynomial, factor: int = 1) -> Polynomial:
    """The first and `factor` times the second."""
    size = max(len(one), len(other))
    first, second = (each + [0] * (size - len(each)) for each in (one, other))
    return [x + factor * y for x, y in zip(first, second, strict=True)]


@checked
def shifted(polynomial: Polynomial) -> Polynomial:
    """p(x + 1)."""
    falling = polynomial[::-1]
    for end in range(len(falling), 1, -1):
        falling[:end] = accumulate(falling[:end])
    return falling[::-1]


def _turn(polynomial: Polynomial, degree: int) -> Polynomial:
    """(1 - w)^degree p((1 + w) / (1 - w))."""
    full = polynomial + [0] * (degree + 1 - len(polynomial))
    # z = 2 / v - 1 with v = 1 - w
    alternating = [(-1) ** k * each for k, each in enumerate(full)]
    lowered = [(-1) ** k * each << k for k, each in enumerate(shifted(alternating))]  # p(t - 1), t = 2 / v
    return [(-1) ** k * each for k, each in enumerate(shifted(lowered[::-1]))]


@checked(infinite=True)
def enclose_quotients(matrix: Quotients, estimate: float) -> Enclosure:
    """Bounds of the largest singular value on the axis, infinite if it is unstable, from an estimate of any quality."""
    stable = _hurwitz(matrix.denominator)
    if stable is None:
        return Enclosure(0.0, inf, False)
    if not stable:
        return Enclosure(inf, inf, True)
    if not any(any(each) for row in matrix.numerators for each in row):
        return Enclosure(0.0, 0.0, True)
    low = high = estimate if LEAST < estimate < LARGEST else 1.0
    floor = ceiling = None
    step = WIDTH
    while floor is None or ceiling is None:
        if floor is None:
            below = is_below(matrix, trial := low / (1 + step))
            floor, ceiling = (trial, ceiling) if below is False else (None, trial if below else ceiling)
            low = trial
        if ceiling is None:
            below = is_below(matrix, trial := high * (1 + step))
            floor, ceiling = (floor, trial) if below else (trial if below is False else floor, None)
            high = trial
        step *= STEPS
        if not (LEAST < low and high < LARGEST and step < LARGEST):
            return Enclosure(0.0, inf, False)
    for _ in range(200):
        if ceiling <= floor * (1 + 3 * WIDTH):
            break
        middle = float(np.sqrt(floor) * np.sqrt(ceiling)) if ceiling > 2 * floor else (floor + ceiling) / 2
        below = is_below(matrix, middle)
        if below is None:
            break
        floor, ceiling = (floor, middle) if below else (middle, ceiling)
    return Enclosure(float(floor), float(ceiling), True)


@checked
def is_below(matrix: Quotients, level: float) -> bool | None:
    """Whether every singular value on the axis is below the level: at True at most so large, at False at least somewhere."""
    square = Fraction(level) ** 2
    rows = matrix.numerators
    if len(rows) < len(rows[0]):
        rows = [list(each) for each in zip(*rows, strict=True)]
    count = len(rows[0])
    whole = multiply(matrix.denominator, _mirrored(matrix.denominator))
    whole = [square.numerator * each for each in whole]
    entries: list[list[Polynomial]] = []
    for i in range(count):
        entries.append([])
        for j in range(count):
            products = [multiply(_mirrored(row[i]), row[j]) for row in rows]
            total: Polynomial = [0]
            for product in products:
                total = add(total, product, -square.denominator)
            entries[i].append(add(total, whole) if i == j else total)
    for size in range(1, count + 1):  # positive definite at w = 0
        static = [[each[0:1] for each in row[:size]] for row in entries[:size]]
        if _determinant(static)[0] <= 0:
            return False
    even = _determinant(entries)[::2]  # of -x = w^2
    root = _has_root([(-1) ** k * each for k, each in enumerate(even)])
    return None if root is None else not root


def _mirrored(polynomial: Polynomial) -> Polynomial:
    """p(-w)."""
    return [(-1) ** k * each for k, each in enumerate(polynomial)]


def _determinant(matrix: list[list[Polynomial]]) -> Polynomial:
    size, total = len(matrix), [0]
    for order in permutations(range(size)):
        sign = (-1) ** sum(order[i] > order[j] for i in range(size) for j in range(i + 1, size))
        product: Polynomial = [1]
        for i, j in enumerate(order):
            product = multiply(product, matrix[i][j])
        total = add(total, product, sign)
    return total


def _has_root(polynomial: Polynomial) -> bool | None:
    """Whether a polynomial that is positive at 0 has a positive root; None where that is not decided."""
    while polynomial and not polynomial[-1]:
        polynomial = polynomial[:-1]
    if polynomial[-1] < 0:
        return True
    if _reaches_zero(polynomial, BITS) is False:
        return False  # the rounded one is below the exact one
    return _reaches_zero(polynomial, None)


@checked
def root_octaves(polynomial: Polynomial) -> range:
    """Exponents of the powers of two from which on its roots above 0 may lie: Cauchy's bounds, by the coefficients' sizes."""
    sizes = [(k, abs(each).bit_length()) for k, each in enumerate(polynomial) if each]
    if len(sizes) < 2:
        return range(0)
    (first, least), (last, most) = sizes[0], sizes[-1]
    lowest = min((least - size - 2) // (k - first) for k, size in sizes[1:]) - 1
    highest = max(-((most - size - 2) // (last - k)) for k, size in sizes[:-1]) + 1
    return range(lowest, highest + 1)


def _reaches_zero(polynomial: Polynomial, bits: int | None) -> bool | None:
    """Whether it, rounded down to so many bits, has a root above 0; octave by octave."""
    for octave in root_octaves(polynomial):
        beyond = shifted(scaled(polynomial, octave, bits))  # from 2^octave on
        if beyond[0] <= 0:
            return True
        if sign_changes(beyond) == 0:
            return False
        if (found := _within(beyond)) is not False:
            return found
    return False


@checked
def scaled(polynomial: Polynomial, octave: int, bits: int | None = None) -> Polynomial:
    """p(2^octave x) times a power of two, its coefficients rounded down to so many bits of the largest."""
    n = len(polynomial) - 1
    powers = [octave * k if octave >= 0 else -octave * (n - k) for k in range(n + 1)]
    whole = [each << power for each, power in zip(polynomial, powers, strict=True)]
    spare = max(map(abs, whole)).bit_length() - bits if bits else 0
    return [each >> spare for each in whole] if spare > 0 else whole


@checked
def sign_changes(polynomial: Polynomial) -> int:
    """How often the coefficients change their sign."""
    signs = [each > 0 for each in polynomial if each]
    return sum(one != other for one, other in pairwise(signs))


def _within(polynomial: Polynomial) -> bool | None:
    """Whether it has a root in (0, 1]; it is positive at 0."""
    left = [(polynomial, 0)]
    while left:
        each, depth = left.pop()
        if sum(each) <= 0:
            return True
        changes = sign_changes(shifted(each[::-1]))
        if changes == 0:
            continue
        if changes == 1:
            return True
        if depth == DEPTH:
            return None
        n = len(each) - 1
        half = [x << (n - k) for k, x in enumerate(each)]
        right = shifted(half)
        if right[0] <= 0:
            return True
        left += [(right, depth + 1), (half, depth + 1)]
    return False


def _hurwitz(polynomial: Polynomial) -> bool | None:
    """Whether all roots lie in the left half-plane; None where the digits do not suffice."""
    if not polynomial[-1]:  # a pole at infinity: of a sampled model at -1
        return False
    found = None
    for digits in DIGITS:
        found = next((each for each in _routh(polynomial, digits) if each is not True), True)
        if found is not None:
            break
    return found


def _routh(polynomial: Polynomial, digits: int) -> Iterator[bool | None]:
    """Row by row, whether all entries are positive, as those of a stable polynomial are."""
    down, up = Context(digits, ROUND_FLOOR, -(10**9), 10**9), Context(digits, ROUND_CEILING, -(10**9), 10**9)
    sign = 1 if polynomial[-1] > 0 else -1
    falling = [sign * each for each in polynomial[::-1]]
    yield all(each > 0 for each in falling)
    rows = [
        [(down.create_decimal(each), up.create_decimal(each)) for each in falling[start::2]]
        for start in (0, 1)
    ]
    while rows[1]:
        (first_low, first_high), (second_low, second_high) = rows[0][0], rows[1][0]
        low, high = down.divide(first_low, second_high), up.divide(first_high, second_low)
        new = []
        for k in range(1, len(rows[0])):
            above, beside = rows[0][k], rows[1][k] if k < len(rows[1]) else (Decimal(0), Decimal(0))
            new.append(
                (
                    down.subtract(above[0], up.multiply(high, beside[1])),
                    up.subtract(above[1], down.multiply(low, beside[0])),
                )
            )
        if any(entry[1] <= 0 for entry in new):
            yield False
        if any(entry[0] <= 0 for entry in new):
            yield None
            return
        yield True
        rows = [rows[1], new]
