"""Enclosures of crossings and margins, compared with 70 digits: `python benchmarks/margins.py [FIRST [LAST]]`, one loop a seed."""

import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "lib"), str(ROOT / "tests")]

import numpy as np  # noqa: E402

from naive.precise_margins import KINDS, differing, sample_case  # noqa: E402
from stillwork.control.loop_enclosures import enclose_margins  # noqa: E402


def main(first: int = 0, last: int = 500) -> None:
    """Print each enclosure that misses or is wide, then a table by kind."""
    rows = {kind: [0, 0, 0, 0, 0, 0.0] for kind in KINDS}
    for seed in range(first, last):
        kind, loop, pid = sample_case(np.random.default_rng(seed))
        start = time.process_time()
        found = enclose_margins(loop, pid)
        spent = time.process_time() - start
        missed, wide, unproven = differing(loop, pid, found)
        row = rows[kind]
        for place, more in enumerate(
            (1, found["modulus_margin"].high > 0, len(missed), len(wide), len(unproven))
        ):
            row[place] += more
        row[-1] = max(row[-1], spent)
        for word, names in (("missed", missed), ("wide", wide), ("not proven", unproven)):
            for name in names:
                print(word, seed, kind, name, found[name].low, found[name].high, flush=True)
    print(f"{'kind':14s} loops stable  numbers  missed  wide not proven  slowest (s)")
    for kind, (count, stable, missed, wide, unproven, slowest) in rows.items():
        print(
            f"{kind:14s} {count:5d} {stable:6d} {5 * count:8d} {missed:7d} {wide:5d} {unproven:10d} {slowest:12.2f}"
        )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
