"""Proven crossings and margins of an open loop n(w) / d(w): real roots of integer polynomials, isolated and refined.

On the axis |L| = 1 and Im L = 0 are polynomials in w^2 with integer coefficients. Their positive roots are isolated by
Descartes' rule of signs, none of them is left out, and the terms of a margin are bounded at each.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from math import atan, atan2, inf, nextafter, pi, sqrt
from typing import NamedTuple

from stillwork.base.validation import by_value, checked
from stillwork.lti.enclosures import (
    Enclosure,
    Polynomial,
    add,
    multiply,
    outward,
    root_octaves,
    scaled,
    shifted,
    sign_changes,
)

BITS = 160, 600, 2400  # to which a root is refined, in turn
DEPTH = 600  # halvings of an interval in which several roots may lie
NARROW = 1e-9  # relative, of bounds that are refined no further
NOT_PROVEN = Enclosure(0.0, inf, False)


class Bounds(NamedTuple):
    """Integers between which a quantity lies."""

    low: int
    high: int


class NotDecided(Exception):
    """Roots that cannot be separated, or a quotient whose denominator may vanish."""


@by_value
@dataclass(frozen=True)
class _Root:
    """A root at 2^octave (1 + (place + u) / 2^depth), where `local`(u) changes its sign once between 0 and 1."""

    octave: int
    depth: int
    place: int
    local: Polynomial  # empty: at u = 0 exactly

    def refined(self, bits: int) -> tuple[Bounds, int]:
        """Bounds in units of 2^-unit, and this."""
        low, steps, exact = 0, max(bits - self.depth, 0), not self.local
        n = len(self.local) - 1
        for step in range(1, steps + 1 if self.local else 1):
            middle = 2 * low + 1  # u = middle / 2^step
            value = 0
            for k in range(n, -1, -1):
                value = value * middle + (self.local[k] << step * (n - k))
            if value == 0:
                low, steps, exact = middle, step, True
                break
            low = middle if (value > 0) == (self.local[0] > 0) else middle - 1
        whole = (((1 << self.depth) + self.place) << steps) + low
        return Bounds(whole, whole + (not exact)), self.depth + steps - self.octave


def _roots(polynomial: Polynomial) -> Iterator[_Root]:
    """Its roots above 0, rising, each as often as it counts; `NotDecided` where some are too close to be separated."""
    while polynomial and not polynomial[-1]:
        polynomial = polynomial[:-1]
    while polynomial and not polynomial[0]:
        polynomial = polynomial[1:]
    for octave in root_octaves(polynomial):
        beyond = shifted(scaled(polynomial, octave))
        if beyond[0] and not sign_changes(beyond):
            return
        yield from _within(beyond, octave)


def _within(polynomial: Polynomial, octave: int) -> Iterator[_Root]:
    """The roots in [0, 1)."""
    left = [(polynomial, 0, 0)]
    while left:
        each, depth, place = left.pop()
        while not each[0]:
            yield _Root(octave, depth, place, [])
            each = each[1:]
        changes = sign_changes(shifted(each[::-1]))
        if changes == 1:
            yield _Root(octave, depth, place, each)
        elif changes:
            if depth == DEPTH:
                raise NotDecided
            n = len(each) - 1
            half = [x << (n - k) for k, x in enumerate(each)]
            left += [(shifted(half), depth + 1, 2 * place + 1), (half, depth + 1, 2 * place)]


def _at(polynomial: Polynomial, degree: int, x: Bounds, unit: int) -> Bounds:
    """Bounds of a polynomial of at most this degree over x / 2^unit, times one power of two for all of that degree."""
    low = high = 0
    for k in range(degree, -1, -1):
        c = polynomial[k] if k < len(polynomial) else 0
        c <<= unit * (degree - k) if unit >= 0 else -unit * k
        low = low * (x.low if low >= 0 else x.high) + c
        high = high * (x.high if high >= 0 else x.low) + c
    return Bounds(low, high)


class _Axis(NamedTuple):
    """L = n / d on the axis, polynomials in x = v^2: L = (real + j v imaginary) / size, |L|^2 = square / size."""

    real: Polynomial
    imaginary: Polynomial
    square: Polynomial
    size: Polynomial


def _on_axis(n: Polynomial, d: Polynomial) -> _Axis:
    parts = []
    for each in (n, d):
        for start in (0, 1):
            parts.append([(-1) ** k * c for k, c in enumerate(each[start::2])] or [0])
    n_even, n_odd, d_even, d_odd = parts
    return _Axis(
        add(multiply(n_even, d_even), [0, *multiply(n_odd, d_odd)]),
        add(multiply(n_odd, d_even), multiply(n_even, d_odd), -1),
        add(multiply(n_even, n_even), [0, *multiply(n_odd, n_odd)]),
        add(multiply(d_even, d_even), [0, *multiply(d_odd, d_odd)]),
    )


def _ratio(one: int, other: int, sign: int) -> float:
    """one / other, rounded outwards."""
    try:
        return nextafter(one / other, sign * inf)
    except OverflowError:
        beyond = inf if (one > 0) == (other > 0) else -inf
        return beyond if beyond == sign * inf else nextafter(beyond, -beyond)


def _root_of(x: Bounds, unit: int) -> tuple[float, float]:
    """Bounds of v."""
    low, high = (float(Fraction(each) / Fraction(2) ** unit) for each in x)
    return outward(sqrt(low), -1), outward(sqrt(high), 1)


@checked(infinite=True)
def enclose_first_crossing(n: Polynomial, d: Polynomial, sample_time: float = 0.0) -> Enclosure:
    """Where the magnitude of n / d first falls through 1, Hz; infinite and proven where it never does.

    Of a sampled loop the polynomials are those of w, z = (1 + w) / (1 - w).
    """
    axis = _on_axis(n, d)
    excess = add(axis.square, axis.size, -1)
    lowest = next((each for each in excess if each), 0)
    if not lowest:
        return NOT_PROVEN
    above = lowest > 0
    try:
        for root in _roots(excess):
            above = not above
            if not above:
                ends = _root_of(*root.refined(BITS[0]))
                low, high = (atan(v) / (pi * sample_time) if sample_time else v / (2 * pi) for v in ends)
                return Enclosure(outward(low, -1), outward(high, 1), True)
    except NotDecided:
        return NOT_PROVEN
    return Enclosure(inf, inf, True)


@checked(infinite=True)
def enclose_phase_margin(n: Polynomial, d: Polynomial) -> Enclosure:
    """Smallest phase change (rad) that makes a stable loop n / d unstable; pi if its magnitude never is 1."""
    axis = _on_axis(n, d)
    excess = add(axis.square, axis.size, -1)
    if not any(excess):
        return NOT_PROVEN
    low = high = outward(pi, 1)
    try:
        for root in _roots(excess):
            for bits in BITS:
                found = _angle(axis, *root.refined(bits))
                if found is not None and _is_narrow(found):
                    break
            if found is None:
                return NOT_PROVEN
            low, high = min(low, found[0]), min(high, found[1])
    except NotDecided:
        return NOT_PROVEN
    return Enclosure(low, high, True)


def _angle(axis: _Axis, x: Bounds, unit: int) -> tuple[float, float] | None:
    """Bounds of |angle(-L)|, where L has size 1."""
    degree = max(map(len, axis)) - 1
    real, imaginary, size = (_at(each, degree, x, unit) for each in (axis.real, axis.imaginary, axis.size))
    if size.low <= 0:
        return None
    v = _root_of(x, unit)
    ends = [_ratio(real.low, size.low if real.low < 0 else size.high, -1),
            _ratio(real.high, size.high if real.high < 0 else size.low, 1)]  # fmt: skip
    largest = max(abs(imaginary.low), abs(imaginary.high))
    smallest = 0 if imaginary.low <= 0 <= imaginary.high else min(abs(imaginary.low), abs(imaginary.high))
    heights = (
        max(nextafter(v[0] * _ratio(smallest, size.high, -1), -inf), 0.0),
        nextafter(v[1] * _ratio(largest, size.low, 1), inf),
    )
    corners = [atan2(height, -end) for height in heights for end in ends]
    return max(outward(min(corners), -1), 0.0), outward(max(corners), 1)


@checked(infinite=True)
def enclose_gain_margins(n: Polynomial, d: Polynomial) -> tuple[Enclosure, Enclosure]:
    """The factors below and above 1 at which a stable loop n / d becomes unstable; 0 and infinite where none does."""
    axis = _on_axis(n, d)
    if not any(axis.imaginary):
        return NOT_PROVEN, NOT_PROVEN
    try:
        found = [*_factors_of_roots(axis), *_factors_of_ends(_trimmed(n), _trimmed(d))]
    except NotDecided:
        return NOT_PROVEN, NOT_PROVEN
    if any(low <= 1.0 <= high for low, high in found):
        return NOT_PROVEN, NOT_PROVEN
    below, above = ([each for each in found if (each[0] > 1) == larger] for larger in (False, True))
    least, most = (0.0, 0.0), (inf, inf)
    lower = [max(each) for each in zip(*below, least, strict=True)]
    upper = [min(each) for each in zip(*above, most, strict=True)]
    return Enclosure(lower[0], lower[1], True), Enclosure(upper[0], upper[1], True)


def _factors_of_roots(axis: _Axis) -> Iterator[tuple[float, float]]:
    """Where L is real and negative between the ends of the axis, the factor that brings it to -1."""
    degree = max(map(len, axis)) - 1
    for root in _roots(axis.imaginary):
        for bits in BITS:
            x, unit = root.refined(bits)
            real, size = (_at(each, degree, x, unit) for each in (axis.real, axis.size))
            if real.low >= 0 or (size.low > 0 and 0 < -real.high and _is_narrow(_factor(real, size))):
                break
        if real.low < 0:
            if size.low <= 0:  # a pole on the axis
                raise NotDecided
            yield _factor(real, size)


def _factors_of_ends(n: Polynomial, d: Polynomial) -> Iterator[tuple[float, float]]:
    """Likewise at w = 0 and at its other end, for a sampled loop half the rate."""
    ends = [(n[0], d[0])] if n and d else []
    if len(n) == len(d) and n:
        ends.append((n[-1], d[-1]))
    for top, bottom in ends:
        if top * bottom < 0:
            yield _factor(Bounds(-abs(top), -abs(top)), Bounds(abs(bottom), abs(bottom)))


def _factor(real: Bounds, size: Bounds) -> tuple[float, float]:
    return (
        _ratio(size.low, -real.low, -1),
        _ratio(size.high, -real.high, 1) if real.high < 0 else inf,
    )


def _is_narrow(ends: tuple[float, float]) -> bool:
    return ends[1] <= ends[0] * (1 + NARROW)


def _trimmed(polynomial: Polynomial) -> Polynomial:
    count = next((k for k in range(len(polynomial), 0, -1) if polynomial[k - 1]), 0)
    return polynomial[:count]
