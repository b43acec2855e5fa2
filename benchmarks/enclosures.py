"""Enclosures of H-infinity norms, compared with 70 digits: `python benchmarks/enclosures.py [FIRST [LAST]]`, one model a seed."""

import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "lib"), str(ROOT / "tests")]

import numpy as np  # noqa: E402

from naive.precise import KINDS, judged_norm, sample_model  # noqa: E402
from stillwork.lti.enclosures import enclose_hinf_norm  # noqa: E402


def main(first: int = 0, last: int = 500) -> None:
    """Print each enclosure that misses or is wide, then a table by kind."""
    rows = {kind: [0, 0, 0, 0, 0.0] for kind in KINDS}
    for seed in range(first, last):
        kind, model = sample_model(np.random.default_rng(seed))
        start = time.process_time()
        found = enclose_hinf_norm(model)
        spent = time.process_time() - start
        norm = judged_norm(model)
        missed = found.proven and not (found.low <= norm * (1 + 1e-12) and norm <= found.high)
        wide = not (found.proven and found.high <= found.low * (1 + 1e-6))
        row = rows[kind]
        row[0] += 1
        row[1] += missed
        row[2] += wide
        row[3] += not found.proven
        row[4] = max(row[4], spent)
        if missed or wide:
            print(seed, kind, model.d.shape, len(model.a), found, found.low, found.high, norm, flush=True)
    print(f"{'kind':14s} models missed  wide not proven  slowest (s)")
    for kind, (count, missed, wide, unproven, slowest) in rows.items():
        print(f"{kind:14s} {count:6d} {missed:6d} {wide:5d} {unproven:10d} {slowest:12.2f}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
