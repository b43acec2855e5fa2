"""The official tuner: every entrant's knobs, set by one procedure with one budget on the development set.

``python -m contest.tuning`` tunes ours, and finds the loops that distinguish observers.
"""

import sys
from collections.abc import Callable, Iterable, Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import qmc

from contest.nominal import TuningParameter
from contest.plants import PLANTS
from contest.scores import ENTRANTS, ORACLE, Scan, scores_of
from contest.uncertainties import UNCERTAINTIES
from stillwork.base.checks import InputError, require_choice
from stillwork.base.toml_files import read_toml
from workbook import paths

DEVELOPMENT = "development"  # in a public number's place
TUNINGS = 2  # how often all is tuned, each time on another seed; a judged seed takes one of them
TRIES = 8  # settings of each entrant, the budget of evaluations
TUNED_ON = ("none", "all 5 %", "drift 5 %", "outliers", "noise x30")
WORST = 2.0  # an error beyond twice that of the estimate zero counts no more than that
TELLING = 2.0  # a loop is judged where the true states are so many times better than the Kalman filter
BANDWIDTHS = ("none", "all 5 %", "temperature and gain")  # uncertainties under which bandwidths are found
FILE = paths.data("motion", "contest_settings.toml")


def positions(knobs: Sequence[TuningParameter]) -> np.ndarray:
    """Settings that are tried: the defaults, then Halton's points, equal in the logarithms; one where there is no knob."""
    if not knobs:
        return np.empty((1, 0))
    low, high = np.log([[knob.low, knob.high] for knob in knobs]).T
    points = qmc.Halton(len(knobs), scramble=False).random(TRIES)[1:]
    return np.vstack([[knob.default for knob in knobs], np.exp(low + points * (high - low))])


def capped_mean(errors: ArrayLike) -> float:
    """Mean of errors relative to those of the estimate zero, none counted beyond `WORST`."""
    return float(np.minimum(np.nan_to_num(errors, nan=np.inf), WORST).mean())


def development_scans(plant: str, tuning: int) -> list[Scan]:
    """Scans of the development set that a tuning is made on."""
    return [Scan("estimate", plant, uncertainty, DEVELOPMENT, tuning) for uncertainty in TUNED_ON]


def tune(
    name: str, file: str | None, knobs: Sequence[TuningParameter], plant: str, tuning: int
) -> tuple[float, ...]:
    """The settings of an observer on a plant with the least mean error of the flexible states; of equals the first."""
    costs = []
    for settings in positions(knobs):
        try:
            found = [
                scores_of(name, file, scan, tuple(settings)) for scan in development_scans(plant, tuning)
            ]
            costs.append(capped_mean([each["flexible"] for each in found]))
        except InputError:  # there is no such design
            costs.append(np.inf)
    return tuple(float(f"{position:.6g}") for position in positions(knobs)[int(np.argmin(costs))])


def settings_for(plant: str, seed: int, names: Iterable[str] = ENTRANTS) -> dict[str, tuple[float, ...]]:
    """Where the tuned knobs of these entrants stand on a plant at a judged seed; at their defaults, if they are not tuned."""
    tuned = read_toml(FILE)
    return {
        name: tuple(tuned[name][plant][seed % TUNINGS])
        if name in tuned
        else tuple(knob.default for knob in ENTRANTS[name].knobs)
        for name in names
    }


def telling_loops(plant: str, track: str, uncertainties: Iterable[str]) -> list[str]:
    """Uncertainties under which the true states are `TELLING` times better than the Kalman filter in the loop.

    In the median over the development set's seeds; a bandwidth is better where it is larger.
    """
    found = []
    for uncertainty in uncertainties:
        scans = [Scan(track, plant, uncertainty, DEVELOPMENT, seed) for seed in range(TUNINGS)]
        best, usual = (
            np.median([next(iter(scores_of(name, None, scan, ()).values())) for scan in scans])
            for name in (ORACLE, "Kalman")
        )
        if track == "bandwidth":
            best, usual = usual, best
        if TELLING * best <= usual and np.isfinite(best) and usual > 0:
            found.append(uncertainty)
    return found


def scans_of(plant: str, public: str, seed: int) -> list[Scan]:
    """All scans of one seed on a plant: every uncertainty, and the loops that distinguish observers."""
    loops = read_toml(FILE)["loops"][plant]
    named = {"estimate": UNCERTAINTIES, **loops}
    return [Scan(track, plant, each, public, seed) for track, some in named.items() for each in some]


def write_settings(name: str, entries: Callable[[str], object]) -> None:
    """Write one table of the settings file, an entry a plant, and keep the others."""
    tables = read_toml(FILE) if FILE.exists() else {}
    tables[name] = {plant: entries(plant) for plant in PLANTS}
    lines = [
        "# Knobs of the contest's entrants: a plant's list holds a setting for each tuning, in the order of the knobs.",
        "# `loops`: under which uncertainties loops are judged. All made by `python -m contest.tuning`:",
        f'# {TRIES} settings each on seeds 0 to {TUNINGS - 1} of "{DEVELOPMENT}", mean over {len(TUNED_ON)} uncertainties.',
    ]
    for title in sorted(tables):
        lines += ["", f'["{title}"]']
        for plant, entry in tables[title].items():
            text = (
                "{ "
                + ", ".join(f"{track} = {some}".replace("'", '"') for track, some in entry.items())
                + " }"
                if isinstance(entry, dict)
                else entry
            )
            lines.append(f'"{plant}" = {text}')
    FILE.write_text("\n".join(lines) + "\n", encoding="utf-8")


def main(names: list[str]) -> None:
    """Tune the entrants of these names and find the ``loops``; by default all of it."""
    with_knobs = [name for name in ENTRANTS if ENTRANTS[name].knobs]
    for name in names:
        require_choice("name", name, [*with_knobs, "loops"])
    if not names or "loops" in names:
        tasks = {"loop": UNCERTAINTIES, "bandwidth": BANDWIDTHS}
        write_settings(
            "loops", lambda plant: {track: telling_loops(plant, track, some) for track, some in tasks.items()}
        )
    for name in set(names or with_knobs) - {"loops"}:
        tuned = partial(tune, name, None, ENTRANTS[name].knobs)
        write_settings(name, lambda plant, tuned=tuned: [list(tuned(plant, each)) for each in range(TUNINGS)])
        print(name, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
