"""The compute track: time a sample of ours over the Kalman filter's.

``python -m contest.compute`` makes the table: all entrants in one process on one core, in turn with the Kalman filter.
"""

import os
import time

import numpy as np
import pandas as pd

from contest.nominal import OwnObserver
from contest.plants import PLANTS
from contest.scores import ENTRANTS, Scan, recorded
from contest.tuning import DEVELOPMENT, settings_for
from workbook import paths

FILE = paths.data("motion", "contest_compute.csv")
UNCERTAINTY = "all 5 %"
ROUNDS, BLOCK = 15, 1000  # how often each entrant is timed, over so many samples


def seconds_of(observer: OwnObserver, done: tuple[np.ndarray, np.ndarray], given: tuple) -> float:
    """Time of this thread that a block of samples takes from the beginning of a scan, once all of it is at hand."""
    observer.start(*given)
    observer.run(*done)
    observer.start(*given)
    began = time.thread_time()
    observer.run(*done)
    return time.thread_time() - began


def times_on(plant: str, rounds: int = ROUNDS) -> list[tuple]:
    """Median time of each entrant over the Kalman filter's on a plant, and the latter in microseconds a sample."""
    scan = Scan("estimate", plant, UNCERTAINTY, DEVELOPMENT, 0)
    record, given = recorded(scan), scan.given()
    block = record.inputs[:BLOCK], record.measurements[:BLOCK]
    settings = settings_for(plant, 0, ENTRANTS)
    observers = {name: OwnObserver(ENTRANTS[name], settings[name]) for name in ENTRANTS}
    for observer in observers.values():
        seconds_of(observer, block, given)  # compiles it
    usual, ratios = [], {name: [] for name in observers}
    for _ in range(rounds):
        for name, observer in observers.items():
            usual.append(seconds_of(observers["Kalman"], block, given))
            ratios[name].append(seconds_of(observer, block, given) / usual[-1])
    unit = 1e6 * float(np.median(usual)) / BLOCK
    return [(plant, name, float(np.median(each)), unit) for name, each in ratios.items()]


def compute_standings(table: pd.DataFrame) -> pd.DataFrame:
    """A row an entrant: median over machines, and between which machines it lies."""
    found = (
        table.groupby("entrant")["ratio"].agg(["median", "min", "max"]).sort_values("median", kind="stable")
    )
    shown = found.map(lambda value: f"{value:.2g}" if value < 10 else f"{float(f'{value:.3g}'):.0f}")
    times = shown["median"] + " (" + shown["min"] + " to " + shown["max"] + ")"
    return pd.DataFrame({"observer": found.index, "time over Kalman's": times.to_numpy()})


def main() -> None:
    """Make the committed table."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    rows = [row for plant in PLANTS for row in times_on(plant)]
    table = pd.DataFrame(rows, columns=["plant", "entrant", "ratio", "microseconds"])
    table.round({"ratio": 3, "microseconds": 3}).to_csv(FILE, index=False, lineterminator="\n")
    print(compute_standings(table).to_string(index=False))


if __name__ == "__main__":
    main()
