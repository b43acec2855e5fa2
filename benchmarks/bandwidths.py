"""Random loops through `maximise_bandwidth`: no result may exceed its own limit, by points and an independent Hamiltonian.

`python benchmarks/bandwidths.py [FIRST [LAST]]`, one loop a seed.
"""

import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "lib"), str(ROOT / "tests")]

import numpy as np  # noqa: E402

from naive.sampled_loops import judged_peak, sample_loop  # noqa: E402
from stillwork.base.checks import InputError  # noqa: E402
from stillwork.control.bandwidth import PeakConstraint, make_loop, maximise_bandwidth  # noqa: E402
from stillwork.control.pid import PidFamily  # noqa: E402

TOLERANCE = 1e-5  # of the limit: between the points of a zoom


def main(first: int = 0, last: int = 2000) -> None:
    """Print each result that exceeds its limit, then how many there are."""
    answers, over, worst, spent = 0, 0, -np.inf, 0.0
    for seed in range(first, last):
        rng = np.random.default_rng(seed)
        case = sample_loop(rng)
        lowest = bool(rng.random() < 0.5)
        start = time.process_time()
        loop = make_loop(case.plant, sample_time=case.sample_time, delay=case.delay)
        limits = [
            PeakConstraint("input_sensitivity", case.limit),
            PeakConstraint("true_tracking", case.limit),
        ]
        try:
            found = maximise_bandwidth(
                [loop], PidFamily(case.mass, case.notches), limits, *case.search_hz, lowest=lowest
            )
        except InputError:
            found = None
        spent += time.process_time() - start
        if found is None:
            continue
        answers += 1
        slowest, peak = judged_peak(case, found.controller)
        excess = peak / case.limit - 1 if slowest < 0 else np.inf
        worst = max(worst, excess)
        if excess > TOLERANCE:
            over += 1
            print(
                f"{seed:5d} {len(case.plant.frequencies) - 1} modes, {case.sample_time:.2e} s, limit {case.limit:.4f}: "
                f"{peak:.6g} at {found.design_hz:.4f} Hz, slowest pole {slowest:.2e} 1/s",
                flush=True,
            )
    print(
        f"{last - first} loops, {answers} results, {over} over their limit by more than {TOLERANCE:g}; ",
        end="",
    )
    print(f"worst {worst:.2e}; {spent:.0f} s of CPU in the searches")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
