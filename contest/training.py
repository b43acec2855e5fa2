"""Training of the learned filter on the development set: ``python -m contest.training`` writes its weights."""

from collections.abc import Callable

import numpy as np

from contest import bench
from contest.learned import FEATURES, FILE, HIDDEN, SIZE, with_weights
from contest.plants import PLANTS
from contest.scores import recorded
from contest.tuning import capped_mean, development_scans


def evolve(
    cost: Callable[[np.ndarray], float], size: int, rounds: int, rng: np.random.Generator, step: float = 0.3
) -> np.ndarray:
    """Weights of small cost by a separable evolution strategy (Ros and Hansen 2008), from zero."""
    count, best = 16, 8
    mean, deviation = np.zeros(size), np.full(size, step)
    shares = np.log(best + 0.5) - np.log(np.arange(1, best + 1))
    shares /= shares.sum()
    lowest, kept = np.inf, mean
    for _ in range(rounds):
        draws = rng.standard_normal((count, size))
        costs = np.array([cost(mean + deviation * draw) for draw in draws])
        chosen = draws[np.argsort(costs)[:best]]
        mean = mean + deviation * (shares @ chosen)
        deviation = deviation * np.exp(0.1 * (shares @ (chosen**2 - 1)))
        if (now := cost(mean)) < lowest:
            lowest, kept = now, mean
    return kept


def main() -> None:
    """Train the weights on the development set's scans of the first tuning and write them."""
    tasks = [(scan.given(), recorded(scan)) for plant in PLANTS for scan in development_scans(plant, 0)]
    empty = [with_weights(np.zeros(SIZE), *given) for given, _ in tasks]

    def cost(weights: np.ndarray) -> float:
        errors = []
        first, second = np.split(weights, [HIDDEN * FEATURES])
        shapes = first.reshape(HIDDEN, FEATURES), second.reshape(-1, HIDDEN)
        for (given, record), made in zip(tasks, empty, strict=True):
            estimates = np.empty((len(record.inputs), len(given[0].a)))
            memory = tuple(each.copy() for each in made.memory)
            made.advance((*made.data[:5], *shapes), memory, record.inputs, record.measurements, estimates)
            errors.append(bench.state_errors(record, estimates, given[0].rigid_modes)[1])
        return capped_mean(errors)

    weights = evolve(cost, SIZE, 80, np.random.default_rng(0))
    print(cost(np.zeros(SIZE)), cost(weights))
    np.savetxt(FILE, weights, fmt="%.5g")


if __name__ == "__main__":
    main()
