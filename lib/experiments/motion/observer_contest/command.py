"""The command ``python -m stillwork contest``."""

import time
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

import pandas as pd

from experiments.motion.observer_contest.plants import PLANTS
from experiments.motion.observer_contest.table import (
    joined,
    measured,
    ranked,
    run_contest,
    standings,
    write_table,
)
from stillwork.workbook.workers import client_of, cores, processes


def hold_contest(
    files: list[str],
    *,
    seeds: int,
    public: str,
    only: Sequence[str] = (),
    loops: int | None = None,
    heavy: int | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
    out: str | None = None,
) -> int:
    """Run the contest and print who stands where; returns 1 when an observer of the reader's was disqualified.

    With `only` some of ours, the rows of all others are those that the file `out` holds, if it is there.
    """
    began = time.monotonic()
    jobs = min(jobs or cores(), seeds * len(PLANTS))
    if scheduler:
        context = client_of(scheduler)
        executor = context.get_executor()
    else:
        context = processes(jobs) if jobs > 1 else nullcontext()
    with context as pool:
        contest = run_contest(
            public,
            seeds,
            files,
            only=only,
            loops=loops,
            heavy=heavy,
            executor=executor if scheduler else pool,
        )
    table = measured(contest)
    late = only and out and Path(out).exists()
    table = joined(pd.read_csv(out), table) if late else ranked(table)
    print(standings(table).to_string(index=False))
    for name, reason in contest.disqualified.items():
        print(f"{name} is disqualified: {reason}")
    print(
        f"{seeds} seeds a plant from the public number {public}, {len(contest.scores)} scans, "
        f"{time.monotonic() - began:.0f} s. Error: of the flexible states over that of the estimate zero."
    )
    if out:
        write_table(table, out)
    return int(bool(contest.disqualified))
