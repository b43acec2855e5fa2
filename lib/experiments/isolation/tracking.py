"""Response of the weights to a change of the floor (section 5.1.2, Fig. 6)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from experiments.isolation.convergence import ALGORITHMS
from experiments.isolation.floors import ShapedFloor
from experiments.isolation.mean_convergence import mean_course
from experiments.isolation.simulation import sample_seeds, simulate_together
from experiments.isolation.steady import Steady, steady_state
from experiments.isolation.twin import Twin
from stillwork.base.checks import require_choice
from stillwork.estimation.adaptive import FeLms, FeRls

GROUPS = {"all": slice(0, 9), "w1-w3": slice(0, 3), "w4-w6": slice(3, 6), "w7-w9": slice(6, 9)}
LEAD_S = 30.0  # on the first floor, from its optimum: three memories of FeRLS, so that its noise has settled
SHARE = 0.37  # of the shift that is left after one time constant


@dataclass(frozen=True)
class Switch:
    """A change of the floor, and where the weights settle before and after it."""

    before: ShapedFloor
    after: ShapedFloor
    start: Steady  # oracle of the floor before, end: of that after
    end: Steady

    @property
    def shift(self) -> Float64[np.ndarray, "parameters"]:
        """Way of the first actuator's optimum."""
        return self.end.weights[0] - self.start.weights[0]


def switch_between(twin: Twin, before: ShapedFloor, after: ShapedFloor) -> Switch:
    """Switch of a twin from one floor to another."""
    return Switch(before, after, steady_state(twin, before), steady_state(twin, after))


def settled(switch: Switch, step_size: float, forgetting: float) -> dict[str, FeLms | FeRls]:
    """The two algorithms as they are after a long time on the first floor.

    P is given in full, so it is also its own start on the new floor; it may grow beyond its printed law only
    where the floor gets quieter by more than the limit of `FeRls`.
    """
    covariance = (1 - forgetting) * np.linalg.inv(switch.start.correlation)
    return {
        "FeLMS": FeLms(step_size=step_size),
        "FeRLS": FeRls((covariance + covariance.T) / 2, forgetting, growth_limit=np.inf),
    }


@dataclass(frozen=True)
class Response:
    """Course of the first actuator's weights around a switch at time zero."""

    time_s: Float64[np.ndarray, "kept"]  # from the switch on; negative before it
    weights: Float64[np.ndarray, "kept parameters"]
    switch: Switch

    def left(self, group: str = "all") -> Float64[np.ndarray, "kept"]:
        """Share of the shift still to go: projection of a group of weights on it, 1 before, 0 in the end."""
        rows = GROUPS[require_choice("group", group, GROUPS)]
        shift = self.switch.shift[rows]
        return (self.switch.end.weights[0, rows] - self.weights[:, rows]) @ shift / (shift @ shift)

    def settling_s(self, group: str = "all") -> float:
        """Time from which on a group stays within 37 % of the shift around its new optimum.

        The band has two sides, as in Table 1: an overshoot beyond 137 % of the shift has not settled. Infinite
        where the last tenth of the run still leaves the band: nothing tells then that it will stay.
        """
        after = self.time_s > 0
        time = self.time_s[after]
        late = np.flatnonzero(np.abs(self.left(group)[after]) > SHARE)
        if len(late) == 0:
            return float(time[0])
        return float(time[late[-1] + 1]) if time[late[-1]] <= 0.9 * time[-1] else np.inf

    @property
    def noise(self) -> float:
        """Noise of the parameters before the switch in units of the shift, standard deviation."""
        return float(self.left()[self.time_s <= 0].std())


def respond(
    twin: Twin, switch: Switch, both: dict[str, FeLms | FeRls], duration_s: float, seeds: Sequence[int]
) -> list[dict[str, Response]]:
    """Simulate a switch of the floor for each seed, the same for each of the `settled` algorithms."""
    runs = simulate_together(
        twin,
        [(LEAD_S, switch.before), (duration_s, switch.after)],
        adaptations=both,
        weights=switch.start.weights,
        seeds=seeds,
    )
    return [
        {
            name: Response(run.time_s - LEAD_S, np.ascontiguousarray(run.weights[:, 0]), switch)
            for name, run in each.items()
        }
        for each in runs
    ]


def expected_response(twin: Twin, switch: Switch, name: str, step_size: float, memory_s: float) -> Response:
    """Mean course after a switch from the oracle, without noise and without simulation, for 20 minutes."""
    time = np.concatenate([np.arange(0.1, 60, 0.1), np.arange(60, 1200, 1.0)])
    course = mean_course(
        twin, switch.end, name, time, step_size=step_size, memory_s=memory_s, start=switch.start
    )
    return Response(time, course, switch)


def tracking_trial(
    draws: Sequence[np.random.Generator], *, twin: Twin, switch: Switch, both: dict, duration_s: float
) -> list[dict[str, float]]:
    """One switch for each generator, for `run_study` with `together`: both algorithms on the same floor.

    ``"FeLMS all"``, ``"FeRLS w4-w6"``, ...: settling time of each group, s, infinite where it has not settled;
    ``"FeLMS noise"``, ...
    """
    seeds = sample_seeds(draws)
    return [
        settling_times(responses) | {f"{name} noise": each.noise for name, each in responses.items()}
        for responses in respond(twin, switch, both, duration_s, seeds)
    ]


def settling_times(responses: Mapping[str, Response]) -> dict[str, float]:
    """``"FeLMS all"``, ``"FeRLS w4-w6"``, ...: settling time of each group of weights, s."""
    return {f"{name} {group}": responses[name].settling_s(group) for name in ALGORITHMS for group in GROUPS}
