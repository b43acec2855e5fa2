"""Proven variances hold those of scalar equations in closed form, in a basis of whole numbers that rounds nothing."""

from decimal import Context, Decimal, localcontext

import numpy as np
import pytest

from stillwork.base.checks import InputError
from stillwork.estimation import enclose_covariance
from stillwork.estimation.riccati import continuous_gain, discrete_gain


def scalar(a, q, r, discrete):
    """P of one state that is measured as it is, by the root of its quadratic equation in 70 digits."""
    a, q, r = Decimal(a), Decimal(q), Decimal(r)
    if not discrete:  # 2 a P + q - P^2 / r = 0
        return r * (a + (a * a + q / r).sqrt())
    half = ((1 - a * a) * r - q) / 2  # P^2 + 2 half P - q r = 0
    return -half + (half * half + q * r).sqrt()


def whole_basis(rng, n):
    """A matrix of small whole numbers whose inverse is one, too."""
    lower, upper = (np.tril(rng.integers(-1, 2, (n, n)), -1) + np.eye(n) for _ in range(2))
    return lower @ upper.T


@pytest.mark.slow
@pytest.mark.parametrize("discrete", [False, True])
def test_variances_lie_within_their_proven_bounds(discrete):
    proven = narrow = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(1, 6))
        poles = np.round(rng.uniform(-1.2, 1.2, n) * 2**10) / 2**10
        q, r = 2.0 ** rng.integers(-8, 9, n), 2.0 ** rng.integers(-8, 9, n)
        basis = whole_basis(rng, n)
        back = np.round(np.linalg.inv(basis))
        a, c = basis @ np.diag(poles) @ back, back
        process, sensor = np.diag(q), np.diag(r)
        solve = discrete_gain if discrete else continuous_gain
        found = solve(a, basis, c, process, sensor).covariance
        bounds = enclose_covariance(a, basis, c, process, sensor, found, discrete)
        with localcontext(Context(70)):
            single = [scalar(*each, discrete) for each in zip(poles, q, r, strict=True)]
            exact = [
                sum((Decimal(x) ** 2 * p for x, p in zip(row, single, strict=True)), Decimal(0))
                for row in basis
            ]
            assert all(
                Decimal(low) <= each <= Decimal(high)
                for low, each, high in zip(bounds.low, exact, bounds.high, strict=True)
            ), seed
        proven += bounds.proven
        narrow += bool(np.all(bounds.high - bounds.low <= 1e-6 * bounds.high))
    assert proven >= 28 and narrow >= 27


@pytest.mark.parametrize("discrete", [False, True])
def test_what_does_not_solve_the_equation_is_not_proven(discrete):
    """Another solution, one that leaves the observer unstable, and a wrong covariance."""
    a = [[1.5]] if discrete else [[1.0]]
    for wrong in (3.0, 1e-8, 0.0):
        assert not enclose_covariance(a, [[1.0]], [[1.0]], 1e-18, 1.0, [[wrong]], discrete).proven


def test_a_covariance_of_another_size_is_refused():
    with pytest.raises(InputError, match="covariance"):
        enclose_covariance(-np.eye(2), np.eye(2), np.eye(2), 1.0, 1.0, np.eye(3))
