"""How much of two Dask workers the contest's table uses: `nice -n 5 python -m benchmarks.contest_dask [SEEDS]`.

The table of our entrants is made in one process, and then by two workers with one thread each. Efficiency is the
processor's time of the first over twice the time from the first task to the last of the second. On a busy machine the
clock means little: then it is the time of the processor over twice that of the worker that took more of it, tasks or not,
which holds what starting a worker, moving results and uneven shares cost, but not waiting.
"""

import sys
import time

import psutil
from distributed import Client, LocalCluster

from contest.table import run_contest
from workbook.pinned import environment

WORKERS = 2
BUSY = 1.15  # clock over the processor's time, from which on the machine was not ours alone


class Timed:
    """An executor that does everything at once and notes what each task took."""

    def __init__(self):
        self.tasks = []

    def submit(self, function, *arguments):
        began = time.process_time()
        self.value = function(*arguments)
        self.tasks.append(time.process_time() - began)
        return Done(self.value)


class Done:
    """What has been done."""

    def __init__(self, value):
        self.value = value

    def result(self):
        return self.value


def warm(plants: tuple[str, ...]) -> None:
    """Compiled code is on the disk before anything is timed."""
    run_contest("warm", 1, plants=plants[:1])


def serial(seeds: int) -> tuple[float, float, list[float]]:
    """Times of the processor and the clock, and of each task."""
    timed, began, clock = Timed(), time.process_time(), time.monotonic()
    run_contest("bench", seeds, executor=timed)
    return time.process_time() - began, time.monotonic() - clock, timed.tasks


def distributed(seeds: int) -> tuple[list[float], float, float]:
    """What each worker took of the processor, the time from the first task to the last, and the share that was idle."""
    options = {"n_workers": WORKERS, "threads_per_worker": 1, "dashboard_address": None}
    with LocalCluster(**options, env=environment()) as cluster, Client(cluster) as client:
        pids = list(client.run(lambda: __import__("os").getpid()).values())
        before = {pid: sum(psutil.Process(pid).cpu_times()[:2]) for pid in pids}
        client.get_task_stream()
        run_contest("bench", seeds, executor=client.get_executor())
        spans = [
            (each["worker"], span["start"], span["stop"])
            for each in client.get_task_stream()
            for span in each["startstops"]
            if span["action"] == "compute"
        ]
        taken = [sum(psutil.Process(pid).cpu_times()[:2]) - before[pid] for pid in pids]
    length = max(stop for *_, stop in spans) - min(start for _, start, _ in spans)
    used = sum(stop - start for _, start, stop in spans)
    return taken, length, 1 - used / (WORKERS * length)


def main(seeds: int) -> None:
    """Print both efficiencies."""
    warm(("drive",))
    alone, clock, tasks = serial(seeds)
    print(f"one process: {alone:.1f} s of the processor, {clock:.1f} s; {len(tasks)} tasks,")
    print(f"  the longest {max(tasks):.1f} s, the shortest {min(tasks):.1f} s")
    taken, length, idle = distributed(seeds)
    print(
        f"{WORKERS} workers: {' and '.join(f'{each:.1f}' for each in taken)} s of the processor, {length:.1f} s,"
    )
    print(f"  of which {100 * idle:.1f} % idle")
    print(f"efficiency by the processor's time: {alone / (WORKERS * max(taken)):.3f}")
    busy = clock > BUSY * alone
    print(
        f"efficiency by the clock: {alone / (WORKERS * length):.3f}{' (the machine was busy)' if busy else ''}"
    )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2)
