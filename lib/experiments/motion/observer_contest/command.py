"""The command ``python -m stillwork contest``."""

import time
from contextlib import nullcontext

from experiments.motion.observer_contest.plants import PLANTS
from experiments.motion.observer_contest.table import leaderboard, run_contest, write_table
from stillwork.workbook.workers import client_of, cores, processes


def hold_contest(
    files: list[str],
    *,
    seeds: int,
    public: str,
    loops: int | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
    out: str | None = None,
) -> int:
    """Run the contest and print who stands where; returns 1 when an observer of the reader's was disqualified."""
    began = time.monotonic()
    jobs = min(jobs or cores(), seeds * len(PLANTS))
    if scheduler:
        context = client_of(scheduler)
        executor = context.get_executor()
    else:
        context = processes(jobs) if jobs > 1 else nullcontext()
    with context as pool:
        contest = run_contest(public, seeds, files, loops=loops, executor=executor if scheduler else pool)
    print(leaderboard(contest))
    print(
        f"{seeds} seeds a plant from the public number {public}, {len(contest.scores)} scans, "
        f"{time.monotonic() - began:.0f} s. Error: of the flexible states over that of the estimate zero."
    )
    if out:
        write_table(contest, out)
    return int(bool(contest.disqualified))
