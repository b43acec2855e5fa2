"""All entrants of the house, by name."""

from collections.abc import Mapping

from experiments.motion.observer_contest.fixed_gain import FIXED
from experiments.motion.observer_contest.told import Rival

ENTRANTS: Mapping[str, Rival] = {**FIXED}
