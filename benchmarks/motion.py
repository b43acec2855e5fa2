"""Speed of the motion room beside python-control, measured in one run: `make bench`.

Times are processor time of the one thread that works; medians over repeats that take the contenders in turn, so
that a busy machine slows all of them alike. A target in the last column is missed or met; no test asserts it.
"""

import os
import platform
import sys
import time
import warnings
from pathlib import Path

os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")
ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "lib"))

import control  # noqa: E402
import numpy as np  # noqa: E402

from stillwork.lti import simulate  # noqa: E402
from stillwork.motion.bandwidth import SIX_DB  # noqa: E402
from stillwork.motion.controller import PidFamily  # noqa: E402
from stillwork.motion.designs import DESIGNS, stage_bandwidth, stage_compensator  # noqa: E402
from stillwork.motion.loops import closed_loop  # noqa: E402
from stillwork.motion.machines import stage, stage_mass  # noqa: E402
from stillwork.motion.plots_bandwidth import draw_design  # noqa: E402
from stillwork.motion.setpoint import published_setpoint  # noqa: E402
from stillwork.motion.tracking import Feedforward, error_loop, tracking_model  # noqa: E402

FAMILY = PidFamily(stage_mass())
PEER_GRID = 2 * np.pi * np.geomspace(1, 3000, 300)  # a reduced grid: the peer steps over the sharpest peaks
PEER_DESIGNS = 12  # bisections of the peer, beside 141 scanned and 13 bisected designs of ours


def main() -> None:
    warnings.simplefilter("ignore")  # python-control without slycot says so at every call
    print(f"{machine()}; one thread; processor time, median (lowest .. highest)\n")
    response = turns({"modal residues": modal_response, "control.frequency_response": peer_response}, 9)
    tracking = turns({"simulate": our_tracking, "control.forced_response": peer_tracking}, 7)
    search = turns(
        {"search, seven loops with observers": our_search, "search through python-control": peer_search}, 3
    )
    drawing = turns({"explorer, one redraw": redraw}, 5)
    rows = [
        ("response: python-control / ours, 16 states, 2000 points", ratio(response), ">= 50"),
        ("tracking: python-control / ours, per sample", ratio(tracking), ">= 50"),
        ("bandwidth search, s", float(np.median(next(iter(search.values())))), "< 1"),
        ("bandwidth search: python-control on a reduced grid / ours", ratio(search), ""),
        ("bandwidth search: the same, per design tried", ratio(search) * 154 / PEER_DESIGNS, ""),
        ("explorer, one redraw without encoding, s", float(np.median(next(iter(drawing.values())))), "< 0.2"),
    ]
    for group in (response, tracking, search, drawing):
        for name, times in group.items():
            print(
                f"  {name:44s} {1e3 * np.median(times):10.3f} ms   ({1e3 * min(times):.3f} .. {1e3 * max(times):.3f})"
            )
    print()
    for name, value, target in rows:
        print(f"  {name:60s} {value:10.3g}   {target}")


def machine() -> str:
    return f"{platform.processor() or platform.machine()}, Python {platform.python_version()}, control {control.__version__}"


def turns(contenders: dict, repeats: int) -> dict[str, list[float]]:
    """Processor time of every contender, in turn, after one warm-up."""
    times = {name: [] for name in contenders}
    for run in contenders.values():
        run()
    for _ in range(repeats):
        for name, run in contenders.items():
            start = time.thread_time()
            run()
            times[name].append(time.thread_time() - start)
    return times


def ratio(times: dict[str, list[float]]) -> float:
    ours, theirs = times.values()
    return float(np.median(np.array(theirs) / np.array(ours)))


PLANT = stage().at([0], [4])
PEER_PLANT = PLANT.to_control()
OMEGA = 2 * np.pi * np.geomspace(1, 5000, 2000)


def modal_response() -> None:
    PLANT.frequency_response(OMEGA)


def peer_response() -> None:
    control.frequency_response(PEER_PLANT, OMEGA)


LOOP = closed_loop(PLANT, stage_compensator(5, DESIGNS["MC and AD"]), FAMILY(77.7).state_space())
SETPOINT = published_setpoint(1e-4)
DISCRETE = tracking_model(error_loop(LOOP), Feedforward(acceleration=12.5, snap=1.66e-6), 1e-4)
MOVES = np.tile(SETPOINT.derivatives, 20)
PEER_DISCRETE = DISCRETE.to_control()


def our_tracking() -> None:
    simulate(DISCRETE, MOVES)


def peer_tracking() -> None:
    control.forced_response(PEER_DISCRETE, inputs=MOVES)


def our_search() -> None:
    stage_bandwidth("MC and AD")


def peer_search() -> None:
    """Bisection with python-control's own connect, frequency_response and poles, observers included."""
    good, bad = 20.0, 120.0
    blocks = [
        (stage().at([0], [k - 1]).to_control(), stage_compensator(k, DESIGNS["MC and AD"]).to_control())
        for k in range(1, 8)
    ]
    for _ in range(PEER_DESIGNS):
        middle = (good + bad) / 2
        controller = FAMILY(middle).state_space().to_control()
        if all(peer_feasible(plant, observer, controller) for plant, observer in blocks):
            good = middle
        else:
            bad = middle


def peer_feasible(plant, observer, controller) -> bool:
    # Inputs: 1 plant, 2-3 observer (u, y), 4 controller. Outputs: 1 y, 2 u_d, 3 y_flex, 4 u.
    whole = control.append(plant, observer, controller)
    wires = [[1, 2, 4], [2, 2, 4], [3, 1, 0], [4, -1, 3]]
    loop = control.connect(whole, wires, [4, 3], [4, 1])
    if np.any(loop.poles().real >= 0):
        return False
    response = control.frequency_response(loop, PEER_GRID).frdata
    tracking = control.frequency_response(controller, PEER_GRID).frdata[0, 0]
    s_i = response[0, 0] / tracking  # r to u is C S_I
    return bool(np.abs(s_i).max() <= SIX_DB)


def redraw() -> None:
    draw_design(73.0, 0.035)


if __name__ == "__main__":
    main()
