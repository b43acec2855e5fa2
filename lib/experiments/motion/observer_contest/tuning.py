"""Every entrant's knobs, set by one procedure with one budget on training seeds: python -m experiments.motion.observer_contest.tuning."""

import sys
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import qmc

from experiments.motion.observer_contest.plants import PLANTS
from experiments.motion.observer_contest.scores import ENTRANTS, contest_trial
from stillwork.base.checks import InputError, require_choice
from stillwork.base.toml_files import read_toml
from workbook import paths

TRAINING = "training"  # in a public number's place
SEEDS, TRIES = 2, 12  # a plant, and settings of each entrant
DOUBTS_TUNED_ON = (
    "none",
    "all 2 %",
    "all 5 %",
    "drift 5 %",
    "outliers",
    "noise x10",
    "noise x100",
    "lost 20 %",
)
WORST = 2.0  # an error beyond twice that of the estimate zero counts no more than that
FILE = paths.data("motion", "contest_settings.toml")


def positions(name: str) -> np.ndarray:
    """Settings that are tried: where the paper has the knobs, then Halton's points, equal in the logarithms.

    Who has no knobs has one, with nothing to set.
    """
    knobs = ENTRANTS[name].knobs
    if not knobs:
        return np.empty((1, 0))
    low, high = np.log([[knob.low, knob.high] for knob in knobs]).T
    points = qmc.Halton(len(knobs), scramble=False).random(TRIES)[1:]
    return np.vstack([[knob.given for knob in knobs], np.exp(low + points * (high - low))])


def capped_mean(errors: ArrayLike) -> float:
    """Mean of errors relative to those of the estimate zero, none counted beyond `WORST`."""
    return float(np.minimum(np.nan_to_num(errors, nan=np.inf), WORST).mean())


def tune(name: str, plant: str) -> list[float]:
    """The settings of an entrant on a plant with the least mean error of the flexible states; of equals the first."""
    costs = []
    for settings in positions(name):
        errors = []
        for seed in range(SEEDS):
            try:
                run, _ = contest_trial(plant, seed, TRAINING, {name: settings}, {}, DOUBTS_TUNED_ON, False)
                errors += [each.flexible for each in run]
            except InputError:  # there is no such design
                errors.append(np.inf)
        costs.append(capped_mean(errors))
    return [float(f"{each:.6g}") for each in positions(name)[int(np.argmin(costs))]]


def settings_for(plant: str, names: Iterable[str] = ENTRANTS) -> dict[str, list[float]]:
    """Where the tuned knobs of these entrants stand on a plant."""
    tuned = read_toml(FILE)
    return {name: list(tuned[name][plant]) if ENTRANTS[name].knobs else [] for name in names}


def main(names: list[str]) -> None:
    """Tune the entrants of these names, by default all, and write the settings file."""
    with_knobs = [name for name in ENTRANTS if ENTRANTS[name].knobs]
    for name in names:
        require_choice("name", name, with_knobs)
    before = read_toml(FILE) if FILE.exists() else {}
    lines = [
        "# Knobs of the contest's entrants, a list a plant, in the order of the entrants' knobs.",
        "# Made by `python -m experiments.motion.observer_contest.tuning`:",
        f'# {TRIES} settings each, on seeds 0 to {SEEDS - 1} of "{TRAINING}", mean over {len(DOUBTS_TUNED_ON)} doubts.',
    ]
    for name in with_knobs:
        lines += ["", f'["{name}"]']
        for plant in PLANTS:
            fresh = not names or name in names or plant not in before.get(name, {})
            found = tune(name, plant) if fresh else list(before[name][plant])
            lines.append(f'"{plant}" = {found}')
            print(name, plant, found, flush=True)
    FILE.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
