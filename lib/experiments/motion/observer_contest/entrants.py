"""All entrants of the house, by name."""

from collections.abc import Mapping

from experiments.motion.observer_contest.adaptive import ADAPTIVE
from experiments.motion.observer_contest.fixed_gain import FIXED
from experiments.motion.observer_contest.multi_model import MULTI_MODEL
from experiments.motion.observer_contest.parametric import PARAMETRIC
from experiments.motion.observer_contest.told import Rival

ENTRANTS: Mapping[str, Rival] = {**FIXED, **PARAMETRIC, **ADAPTIVE, **MULTI_MODEL}
