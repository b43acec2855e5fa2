"""Studies of several algorithms on the same floors and noises, whose runs a process makes once."""

from collections.abc import Callable, Hashable, Mapping

import numpy as np

from experiments.isolation.simulation import TOGETHER
from stillwork.estimation.adaptive import FeLms, FeRls
from workbook.studies import Study

_MADE: dict[tuple, list[dict[str, np.ndarray]]] = {}  # quantities of a case in the runs of a batch


def study_each(
    trial: Callable[..., list[dict]],
    cases: Mapping[tuple, FeLms | FeRls],
    where: Hashable,
    runs: int,
    seed: int,
    **settings,
) -> list[Study]:
    """Study of each of several cases, all on the floors and noises of `seed`.

    A case is a tuple that starts with the algorithm's name and tells its settings apart; `where` does so for all else
    that decides what ``trial(generators, both=cases, **settings)`` gives: for each generator quantities that start with
    the case. Here they start with the algorithm's name. Runs that were made before, for one case or for more, are
    not made again, and those that are missing are made together.
    """
    found: dict[tuple, list[dict]] = {case: [] for case in cases}
    streams = np.random.SeedSequence(seed).spawn(runs)
    for first in range(0, runs, TOGETHER):
        batch = streams[first : first + TOGETHER]
        key = trial.__qualname__, where, seed, first, len(batch)
        new = {str(k): case for k, case in enumerate(cases) if (key, case) not in _MADE}
        if new:
            draws = [np.random.default_rng(stream) for stream in batch]
            both = {place: cases[case] for place, case in new.items()}
            each = trial(draws, both=both, **settings)
            _MADE.update(
                {(key, case): [_of(place, case[0], row) for row in each] for place, case in new.items()}
            )
        for case in cases:
            found[case] += _MADE[key, case]
    return [
        Study(seed, {name: np.array([row[name] for row in rows]) for name in rows[0]})
        for rows in found.values()
    ]


def _of(place: str, name: str, row: Mapping) -> dict:
    mine = f"{place} "
    return {f"{name} {key.removeprefix(mine)}": value for key, value in row.items() if key.startswith(mine)}
