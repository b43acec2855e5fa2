"""Solutions of the track on least squares with bounded uncertainty.

Each function answers the exercise of its number with the toolbox, compares the answer with something that shares no
code with it, and returns the check of the exercise. Its arguments are the numbers of the exercise: with others
it gives the answer to a new one.
"""

import warnings

import numpy as np
from scipy import optimize

from experiments.worstcase.theory import counter_example
from stillwork.estimation import min_max_solve, track
from stillwork.estimation.secular import secular_function
from stillwork.identification import fir_regressors
from stillwork.identification.regressors import exponential_bound, noise_bound


def exercise_1(
    column: tuple[float, ...] = (1.0, 1.0), data: tuple[float, ...] = (2.0, 1.0), bound: float = 0.5
) -> str:
    """One unknown, by the closed form and by trying every estimate."""
    matrix, target = np.array([column]).T, np.array(data)
    estimate = min_max_solve(matrix, target, bound).estimate[0]

    grid = np.linspace(0, 2, 200_001)
    worst = np.linalg.norm(matrix * grid - target[:, None], axis=0) + bound * np.abs(grid)
    assert np.isclose(grid[worst.argmin()], estimate, atol=1e-4)
    return f"{estimate:.3f}"


def exercise_2(column: tuple[float, ...] = (1.0, 1.0), data: tuple[float, ...] = (2.0, 1.0)) -> str:
    """The bound from which on the estimate is zero, and why: a perturbation explains all of the data."""
    matrix, target = np.array([column]).T, np.array(data)
    threshold = min_max_solve(matrix, target, 0.0).threshold

    grid = np.linspace(0, 2, 20_001)
    for bound, zero in ((0.99 * threshold, False), (1.01 * threshold, True)):
        worst = np.linalg.norm(matrix * grid - target[:, None], axis=0) + bound * grid
        assert (worst.argmin() == 0) == zero
    # The smallest perturbation that makes b orthogonal to A + dA, so that nothing is left to fit.
    change = -target * (target @ matrix[:, 0]) / (target @ target)
    assert np.isclose(target @ (matrix[:, 0] + change), 0)
    assert np.isclose(np.linalg.norm(change), threshold)
    return f"{threshold:.3f}"


def exercise_3(left: float = 3.0, pushed: float = 4.0) -> str:
    """The worst perturbation and a typical one, at a residual of 3 and eta |x| of 4."""
    rows = 4000
    rng = np.random.default_rng(3)
    residual = rng.standard_normal(rows)
    residual *= left / np.linalg.norm(residual)
    push = rng.standard_normal((200, rows))
    push *= pushed / np.linalg.norm(push, axis=1, keepdims=True)
    typical = np.median(np.linalg.norm(residual + push, axis=1)) / (left + pushed)

    along = residual * pushed / left  # the worst perturbation points where the residual does
    assert np.isclose(np.linalg.norm(residual + along), left + pushed)
    assert np.isclose(typical, np.hypot(left, pushed) / (left + pushed), atol=0.01)
    return f"{np.hypot(left, pushed) / (left + pushed):.2f}"


def exercise_4(bound: float = 0.5) -> str:
    """The penalty of ridge regression that the bound chooses."""
    rng = np.random.default_rng(4)
    matrix = rng.standard_normal((40, 3)) * [1.0, 0.5, 0.1]
    target = matrix @ [1.0, -2.0, 3.0] + 0.2 * rng.standard_normal(40)
    solution = min_max_solve(matrix, target, bound)

    # Ridge regression by rows of its own, and the worst case by a general minimiser.
    rows = np.vstack([matrix, np.sqrt(solution.alpha) * np.eye(3)])
    ridge = np.linalg.lstsq(rows, np.r_[target, np.zeros(3)], rcond=None)[0]
    assert np.allclose(ridge, solution.estimate)
    found = optimize.minimize(
        lambda x: np.linalg.norm(matrix @ x - target) + bound * np.linalg.norm(x),
        np.ones(3),
        options={"gtol": 1e-10},
    )
    assert np.allclose(found.x, solution.estimate, atol=1e-4)
    return f"{solution.alpha:.3f}"


def exercise_5(share: float = 0.9) -> str:
    """How many fixed-point steps six digits take, for one unknown and a bound at nine tenths of the threshold."""
    matrix, target = np.array([[1.0], [1.0]]), np.array([2.0, 1.0])
    function = secular_function(matrix, target, share * 3 / np.sqrt(5))
    root, _ = function.root()
    iterates = function.iterates(1.0, 400)
    steps = int(np.argmax(np.abs(iterates / root - 1) < 1e-6))

    power, excess = 2.0, 5 - 9 / 2  # a'a, and what no x explains of b'b
    kappa = power * excess / 5
    alpha, count = 1.0, 0
    own_root = max(np.roots([1 - share**2, -2 * share**2 * kappa, -(share**2) * kappa * power]).real)
    while abs(alpha / own_root - 1) >= 1e-6:
        alpha, count = share * np.sqrt(alpha**2 + 2 * kappa * alpha + kappa * power), count + 1
    assert count == steps
    assert (
        steps <= np.log(1e-6 * own_root / abs(own_root - 1)) / np.log(share) + 1
    )  # the contraction's promise
    return f"{steps}"


def exercise_6(excess: float = 0.02) -> str:
    """Up to which bound the map of two unknowns is a contraction, with b 0.02 away from the columns."""
    alphas = np.geomspace(1e-7, 1e2, 20_001)

    def steepest(bound: float) -> float:
        return float(counter_example(bound, excess).slope(alphas).max()) - 1

    bound = optimize.brentq(steepest, 0.01, 0.9)

    # By differences of the formula (4) itself: singular values 1 and 0.1, c = (1, 0.1).
    squares, c = np.array([1.0, 0.01]), np.array([1.0, 0.1])
    part = c / (squares + alphas[:, None])
    image = bound * np.sqrt(
        (excess**2 + (alphas[:, None] ** 2 * part**2).sum(1)) / (squares * part**2).sum(1)
    )
    assert np.isclose(np.max(np.diff(image) / np.diff(alphas)), 1, atol=1e-3)
    return f"{bound:.2f}"


def exercise_7(row: float = 0.25, forgetting: float = 0.975) -> str:
    """Twice the memory of forgetting: the bound grows with the square root."""
    doubled = exponential_bound(row, forgetting)

    weights = forgetting ** (np.arange(2000) / 2)
    perturbed = row * weights[:, None] * np.array([[0.6, 0.8]])  # every row off in the same direction
    assert np.isclose(np.linalg.norm(perturbed, 2), doubled)
    assert np.isclose(doubled / exponential_bound(row, 2 * forgetting - 1), np.sqrt(2))
    return f"{doubled:.3f}"


def exercise_8(power: float = 0.25) -> str:
    """Noise on the input: the bias that no amount of data takes away, and that a bound makes larger."""
    rng = np.random.default_rng(8)
    clean, noise = rng.standard_normal((2, 200_000))
    seen = clean + np.sqrt(power) * noise
    outputs = np.array([1.0, -0.5]) @ fir_regressors(clean, 2)
    matrix = fir_regressors(seen, 2).T
    least = np.linalg.lstsq(matrix, outputs, rcond=None)[0]
    assert np.allclose(least / [1.0, -0.5], 1 / (1 + power), atol=0.01)
    shrunk = min_max_solve(matrix, outputs, np.sqrt(power * len(outputs))).estimate
    assert np.linalg.norm(shrunk) < np.linalg.norm(least)
    return f"{np.mean(least / [1.0, -0.5]):.2f}"


def exercise_9(taps: int = 32, memory: int = 640, deviation: float = 0.1) -> str:
    """Two honest bounds from one sensor: every entry conspires, or none does."""
    forgetting = 1 - 1 / memory
    guaranteed = exponential_bound(3 * deviation * np.sqrt(taps), forgetting)
    typical = noise_bound(deviation, taps, forgetting)

    weights = forgetting ** (np.arange(6400) / 2)
    rng = np.random.default_rng(9)
    norms = [
        np.linalg.norm(weights[:, None] * deviation * rng.standard_normal((6400, taps)), 2) for _ in range(5)
    ]
    assert np.all(np.array(norms) < 1.05 * typical) and np.mean(norms) > 0.75 * typical
    assert np.isclose(guaranteed, 3 * deviation * np.sqrt(taps * memory))
    return f"{guaranteed / typical:.1f}"


def exercise_10(unexplained: float = 0.5, left: float = 0.5) -> str:
    """One unknown again: the bound that halves the estimate, at a residual half as large as what is explained."""
    matrix, target = np.array([[1.0], [0.0]]), np.array([1.0, unexplained])

    def half(bound: float) -> float:
        return float(min_max_solve(matrix, target, bound).estimate[0]) - left

    bound = optimize.brentq(half, 1e-3, 0.999 / np.hypot(1, unexplained))
    assert np.isclose(bound, (1 - left) / np.hypot(1 - left, unexplained))  # where |x - b1| / sqrt(...) = eta
    grid = np.linspace(0, 1, 100_001)
    worst = np.hypot(grid - 1, unexplained) + bound * grid
    assert np.isclose(grid[worst.argmin()], left, atol=1e-3)
    return f"{bound:.3f}"


def exercise_11(forgetting: float = 0.95, noise: float = 0.1) -> str:
    """Recursive min-max with a vanishing bound is recursive least squares; with a large one it stays at zero."""
    rng = np.random.default_rng(11)
    rows = fir_regressors(rng.standard_normal(600), 2)
    outputs = np.array([1.0, -0.5]) @ rows + noise * rng.standard_normal(600)
    small = track(rows, outputs, forgetting, bound=1e-9).estimates[:, -1]
    least = track(rows, outputs, forgetting).estimates[:, -1]
    assert np.allclose(small, least, atol=1e-6)

    weights = forgetting ** (np.arange(600)[::-1] / 2)
    matrix, target = (weights * rows).T, weights * outputs
    threshold = np.linalg.norm(matrix.T @ target) / np.linalg.norm(target)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        beyond = track(rows, outputs, forgetting, bound=1.001 * threshold).estimates[:, -1]
        before = track(rows, outputs, forgetting, bound=0.999 * threshold).estimates[:, -1]
    assert np.all(beyond == 0) and np.linalg.norm(before) > 0
    return f"{threshold:.2f}"


def exercise_12(power: float = 0.25) -> str:
    """The penalty that takes the bias away is minus the noise's power; the worst case wants it positive."""
    rng = np.random.default_rng(8)
    clean, noise = rng.standard_normal((2, 200_000))
    matrix = fir_regressors(clean + np.sqrt(power) * noise, 2).T
    outputs = np.array([1.0, -0.5]) @ fir_regressors(clean, 2)
    size = len(outputs)

    def found(penalty: float) -> np.ndarray:
        return np.linalg.solve(matrix.T @ matrix + size * penalty * np.eye(2), matrix.T @ outputs)

    penalty = optimize.brentq(lambda each: found(each) @ [1.0, -0.5] / 1.25 - 1, -power - 0.35, 0.5)
    assert np.allclose(found(-power), [1.0, -0.5], atol=0.01)
    assert min_max_solve(matrix, outputs, np.sqrt(power * size)).alpha > 0
    return f"{penalty:.2f}"
