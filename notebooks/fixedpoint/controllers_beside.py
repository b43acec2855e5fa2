"""Controllers beside the fixed point, tuned alike on machines that they do not know: what notebook 10 alone needs."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import product

import numpy as np

from experiments.fixedpoint.oscillator import load_oscillator
from experiments.fixedpoint.search import run_simplex, sobol_points
from stillwork.control import (
    Controller,
    DisturbanceObserver,
    KinematicDesign,
    Mechanism,
    SlotineLi,
    asin_trajectory,
    simulate_adaptive,
    simulate_mechanism,
)
from stillwork.control.controlled_run import ControlledRun
from stillwork.control.trajectory import Trajectory
from stillwork.control.transformation import RobustTransformation
from stillwork.estimation import ExtendedKalman, LowPass
from stillwork.estimation.filtering import UNIT_MASS
from workbook import figures, paths
from workbook.studies import mean_interval

DT, DURATION = 1e-3, 3.0  # s; what changes does so at half of it
EFFORT = 0.1  # largest RMS change of a force in a sample, of the force that may begin
NOISE, LOUDER = (
    1e-4,
    5.0,
)  # standard deviation of a measured position, m or rad, and what a worse sensor makes of it
AS_TUNED, FORCE, PAYLOAD, SENSOR = "nothing changes", "a force begins", "a payload", "a worse sensor"
CASES = (AS_TUNED, FORCE, PAYLOAD, SENSOR)

# === Three machines, linear in their parameters ====================================================================
# Each ends with viscous and dry friction of every axis. Numbers of the arms are made up.


def oscillator_inertia(position, parameters, out):
    """(11) of the paper: mass, stiffness, b2 - b1 a^2, b1, d, dry friction."""
    out[0, 0] = parameters[0]


def oscillator_bias(position, velocity, parameters, out):
    q, v = position[0], velocity[0]
    out[0] = parameters[1] * q + (parameters[2] + parameters[3] * q * q) * v + parameters[4] * abs(v) * v
    out[0] += parameters[5] * math.tanh(v / 0.05)


def two_link_inertia(position, parameters, out):
    c = parameters[1] * math.cos(position[1])
    out[0, 0] = parameters[0] + 2 * c
    out[0, 1] = parameters[2] + c
    out[1, 0] = out[0, 1]
    out[1, 1] = parameters[2]


def two_link_bias(position, velocity, parameters, out):
    s = parameters[1] * math.sin(position[1])
    weight = 9.81 * parameters[4] * math.cos(position[0] + position[1])
    out[0] = -s * velocity[1] * (2 * velocity[0] + velocity[1]) + weight
    out[0] += 9.81 * parameters[3] * math.cos(position[0])
    out[1] = s * velocity[0] ** 2 + weight
    for j in range(2):
        friction = parameters[5 + j] * velocity[j]
        if parameters[7 + j] != 0.0:  # it is 0 in the models, and in most columns of a regressor
            friction += parameters[7 + j] * math.tanh(velocity[j] / 0.05)
        out[j] += friction


def three_axis_inertia(position, parameters, out):
    """A column that turns, a shoulder and an elbow: J, A2, A3, B, then the two weights."""
    j, a2, a3, b = parameters[:4]
    out[:] = 0.0
    out[0, 0] = j
    if a2 == a3 == b == 0.0:
        return  # as in most columns of a regressor
    near, far = math.cos(position[1]), math.cos(position[1] + position[2])
    bend = b * math.cos(position[2])
    out[0, 0] = j + a2 * near * near + a3 * far * far + 2 * b * near * far
    out[1, 1] = a2 + a3 + 2 * bend
    out[1, 2] = a3 + bend
    out[2, 1] = out[1, 2]
    out[2, 2] = a3


def three_axis_bias(position, velocity, parameters, out):
    a2, a3, b = parameters[1:4]
    out[:] = 0.0
    if not a2 == a3 == b == parameters[4] == parameters[5] == 0.0:
        q2, q23 = position[1], position[1] + position[2]
        v1, v2, v3 = velocity
        s, sines = b * math.sin(position[2]), math.cos(q2) * math.sin(q23)
        by_q3 = -a3 * math.sin(2 * q23) - 2 * b * sines  # of the column's inertia
        by_q2 = by_q3 - a2 * math.sin(2 * q2) - 2 * b * math.sin(q2) * math.cos(q23)
        far = 9.81 * parameters[5] * math.cos(q23)
        out[0] = (by_q2 * v2 + by_q3 * v3) * v1
        out[1] = -s * v3 * (2 * v2 + v3) - by_q2 * v1 * v1 / 2 + 9.81 * parameters[4] * math.cos(q2) + far
        out[2] = s * v2 * v2 - by_q3 * v1 * v1 / 2 + far
    for axis in range(3):
        out[axis] += parameters[6 + axis] * velocity[axis]
        if parameters[9 + axis] != 0.0:
            out[axis] += parameters[9 + axis] * math.tanh(velocity[axis] / 0.05)


def _oscillator(p):
    load, damping = p["payload"], p["b2"] - p["b1"] * p["a"] ** 2
    return [p["m"] + load, p["k"], damping, p["b1"], p["d"], p["f1"]]


def _two_link(p):
    load, l1, l2 = p["payload"], p["l1"], p["l2"]
    far = p["I2"] + p["m2"] * p["c2"] ** 2 + load * l2**2
    near = p["I1"] + p["m1"] * p["c1"] ** 2 + (p["m2"] + load) * l1**2
    pull = p["m2"] * p["c2"] + load * l2
    weights = [p["m1"] * p["c1"] + (p["m2"] + load) * l1, pull]
    return [near + far, l1 * pull, far, *weights, p["d1"], p["d2"], p["f1"], p["f2"]]


def _three_axis(p):
    near, pull, far, *weights = _two_link(p)[:5]
    friction = [p[name] for name in ("d0", "d1", "d2", "f0", "f1", "f2")]
    return [p["J"], near - far, far, pull, *weights, *friction]


ARM = {"m1": 3.5, "c1": 0.20, "I1": 0.05, "l1": 0.40, "m2": 2.0, "c2": 0.18, "I2": 0.02, "l2": 0.36}
ARM |= {"d1": 0.3, "d2": 0.3}  # kg, m, kg m^2, N m s


@dataclass(frozen=True)
class Machine:
    """A machine of which the controllers know one set of numbers, and whose true ones are drawn."""

    inertia: Callable
    bias: Callable
    lump: Callable  # physical numbers by name -> parameters
    believed: dict[str, float]
    spread: dict[str, float]  # of the logarithm of a true number: evenly up to this either way
    friction: tuple[float, ...]  # N or N m, the largest dry one of every axis; unknown to the controllers
    payload: tuple[float, float]  # kg
    force: tuple[float, ...]  # N or N m
    motion: tuple[tuple[float, float], ...]  # amplitude in m or rad and frequency in Hz of every axis
    unit: str

    @property
    def axes(self) -> int:
        return len(self.motion)

    @property
    def model(self) -> Mechanism:
        return self.mechanism(self.believed | {"payload": 0.0} | dict.fromkeys(self._dry, 0.0))

    @property
    def _dry(self) -> list[str]:
        first = 0 if self.axes == 3 else 1
        return [f"f{first + axis}" for axis in range(self.axes)]

    @cached_property
    def trajectories(self) -> list[Trajectory]:
        return [asin_trajectory(size, 0.8, hertz, DURATION, DT) for size, hertz in self.motion]

    def mechanism(self, numbers: dict[str, float]) -> Mechanism:
        return Mechanism(self.inertia, self.bias, self.axes, np.array(self.lump(numbers)))

    def draw(self, rng: np.random.Generator) -> dict[str, float]:
        """True numbers, without a payload."""
        true = {
            name: value * math.exp(rng.uniform(-1, 1) * self.spread.get(name, 0.3))
            for name, value in self.believed.items()
        }
        dry = {name: rng.uniform(0, most) for name, most in zip(self._dry, self.friction, strict=True)}
        return true | dry | {"payload": 0.0}


def _table_one() -> dict[str, float]:
    known = load_oscillator()["approximate"]
    names = {"m": known.mass, "k": known.stiffness, "a": known.separator}
    return names | {"b1": known.excitation, "b2": known.damping, "d": known.drag}


LENGTHS = {"l1": 0.0, "l2": 0.0, "c1": 0.15, "c2": 0.15, "d0": 1.0, "d1": 1.0, "d2": 1.0}  # lengths are known
MACHINES = {
    "oscillator": Machine(
        oscillator_inertia,
        oscillator_bias,
        _oscillator,
        _table_one(),
        {"a": 0.6, "b1": 1.0, "b2": 1.0, "d": 1.2},  # Table I's plant is one of them
        (2.0,),
        (0.4, 1.0),
        (10.0,),
        ((0.8, 0.3),),
        "m",
    ),
    "two-link arm": Machine(
        two_link_inertia,
        two_link_bias,
        _two_link,
        ARM,
        LENGTHS,
        (0.8, 0.3),
        (0.5, 1.5),
        (3.0, 1.0),
        ((0.8, 0.25), (0.6, 0.35)),
        "rad",
    ),
    "3-axis arm": Machine(
        three_axis_inertia,
        three_axis_bias,
        _three_axis,
        ARM | {"J": 0.1, "d0": 0.4},
        LENGTHS,
        (0.6, 0.8, 0.3),
        (0.5, 1.5),
        (2.0, 3.0, 1.0),
        ((0.8, 0.25), (0.6, 0.3), (0.6, 0.35)),
        "rad",
    ),
}


# === What may change in mid-run ====================================================================================


@dataclass(frozen=True)
class Scenario:
    """One plant, and what may happen to it from the middle of a run on."""

    plant: Mechanism
    laden: np.ndarray  # its parameters with the payload
    noise: np.ndarray  # m or rad, (axes, samples)
    force: np.ndarray  # N or N m, from the middle on


def draw_scenario(machine: Machine, rng: np.random.Generator) -> Scenario:
    """A step and two slow sines of force, a payload, noise, on a plant of its own."""
    numbers = machine.draw(rng)
    laden = machine.mechanism(numbers | {"payload": rng.uniform(*machine.payload)}).parameters
    time = machine.trajectories[0].time
    noise = NOISE * rng.standard_normal((machine.axes, len(time)))
    force = np.zeros_like(noise)
    for row, size in zip(force, machine.force, strict=True):
        row[:] = rng.choice([-1.0, 1.0])
        for _ in range(2):
            row += np.sin(2 * np.pi * (rng.uniform(0.5, 3.0) * time + rng.uniform()))
        row *= size * (time >= DURATION / 2)
    return Scenario(machine.mechanism(numbers), np.asarray(laden), noise, force)


def drive(
    machine: Machine, law: Controller | SlotineLi, scenario: Scenario, *cases: str
) -> list[ControlledRun]:
    """One run in which these cases happen."""
    worse = np.where(machine.trajectories[0].time >= DURATION / 2, LOUDER, 1.0) if SENSOR in cases else 1.0
    given = {
        "noise": worse * scenario.noise,
        "disturbance": scenario.force if FORCE in cases else None,
        "change": (DURATION / 2, scenario.laden) if PAYLOAD in cases else None,
    }
    if isinstance(law, SlotineLi):
        return simulate_adaptive(scenario.plant, law, machine.trajectories, **given).coordinates
    return simulate_mechanism(scenario.plant, law, machine.trajectories, **given)


def error_of(runs: list[ControlledRun], criterion: str = "position") -> float:
    """RMS error over all axes, from the middle on; 1 m or rad, or 1 m/s or rad/s, when it diverged."""
    if runs[0].diverged_at is not None:
        return 1.0
    half = len(runs[0].position) // 2
    return float(np.sqrt(np.mean([np.square(getattr(run, f"{criterion}_error")[half:]) for run in runs])))


def effort_of(machine: Machine, runs: list[ControlledRun]) -> float:
    """RMS change of the force in a sample over the force that may begin, of the worst axis, before anything changes."""
    part = slice(len(runs[0].force) // 8, len(runs[0].force) // 2)
    changes = [np.sqrt(np.mean(np.square(np.diff(run.force[part])))) for run in runs]
    return float(np.max(np.array(changes) / machine.force)) if runs[0].diverged_at is None else math.inf


# === The laws, each with its own numbers, and one search ============================================================

COMPUTED, OBSERVER, ADAPTIVE, FIXED = ("computed torque", "disturbance observer", "Slotine-Li", "fixed point")
FROZEN = "Slotine-Li, not adapting"
EACH = "fixed point with EKF an axis"
LAWS = (COMPUTED, OBSERVER, ADAPTIVE, FIXED)
INKS = figures.BLACK, figures.GREEN, figures.ORANGE, figures.BLUE, figures.SKY
COLOURS = dict(zip((*LAWS, EACH), INKS, strict=True))
_LOW_PASS = {"exponent": (2.0, 150.0), "bandwidth": (30.0, 1900.0)}  # 1/s, rad/s
RANGES = {
    COMPUTED: _LOW_PASS,
    OBSERVER: _LOW_PASS | {"gain": (0.003, 1.0)},
    ADAPTIVE: _LOW_PASS | {"feedback": (1.0, 1000.0), "adaptation": (1e-6, 100.0)},
    FIXED: _LOW_PASS | {"strength": (0.003, 1.2)},
    EACH: {"exponent": (2.0, 150.0), "strength": (0.003, 1.2), "disturbance_step": (1e-2, 1e3)},
}


def law_of(machine: Machine, name: str, numbers: dict[str, float]) -> Controller | SlotineLi:
    """A law at a point of its search. All take the error from what is measured but those with a Kalman filter."""
    model, exponent = machine.model, numbers["exponent"]
    if name == EACH:
        device = ExtendedKalman(UNIT_MASS, numbers["disturbance_step"], NOISE)
    else:
        device = LowPass(numbers["bandwidth"])
    if name in (ADAPTIVE, FROZEN):
        feedback = numbers["feedback"] * np.diag(model.mass(np.zeros(machine.axes)))
        adaptation = numbers["adaptation"] * np.square(model.parameters)
        return SlotineLi(device, KinematicDesign(exponent, order=1), model, feedback, adaptation)
    if name in (COMPUTED, OBSERVER):
        transformation = DisturbanceObserver(numbers.get("gain", 0.0))
    else:
        transformation = RobustTransformation(slope=numbers["strength"] / (4e7 * 1.05))
    return Controller(device, transformation, KinematicDesign(exponent), model)


def search(
    cost: Callable, ranges: dict[str, tuple[float, float]], budget: int, seed: int
) -> dict[str, float]:
    """The best of `budget` points: about a third of them a Sobol sequence, evenly in the logarithms, then two simplexes from the best."""
    low, high = np.log(list(ranges.values())).T
    tried: list[tuple[float, np.ndarray]] = []

    def numbers_at(knobs) -> dict[str, float]:
        return dict(zip(ranges, np.exp(np.clip(knobs, low, high)).tolist(), strict=True))

    def value(knobs):
        tried.append((cost(numbers_at(knobs)), np.clip(knobs, low, high)))
        return min(tried[-1][0], 1e3)

    for knobs in sobol_points(low, high, budget, seed):
        value(knobs)
    for size, until in ((0.15, (budget + len(tried)) // 2), (0.05, budget)):
        start = min(tried, key=lambda each: each[0])[1]
        run_simplex(value, start, low, high, size, until - len(tried))
    return numbers_at(min(tried, key=lambda each: each[0])[1])


TRAINING, BUDGET = 2, 96  # plants in which everything happens at once; evaluations of a search


def tune(machine: str, law: str, seed: int, criterion: str) -> dict[str, float]:
    """Numbers of a law that are best where force, payload and worse sensor come together, on plants of this seed.

    The mean logarithm of the error; what the effort is over `EFFORT` counts three times.
    """
    device = MACHINES[machine]
    rng = np.random.default_rng([seed, len(machine)])
    scenarios = [draw_scenario(device, rng) for _ in range(TRAINING)]

    def cost(numbers):
        chosen, total = law_of(device, law, numbers), 0.0
        for each in scenarios:
            runs = drive(device, chosen, each, *CASES)
            if runs[0].diverged_at is not None:
                return math.inf
            total += math.log(error_of(runs, criterion))
            total += 3 * max(0.0, math.log(effort_of(device, runs) / EFFORT))
        return total / TRAINING

    return search(cost, RANGES[law], BUDGET, seed)


STORED = paths.data("fixedpoint", "tuned_controllers.csv")
SEEDS = 11, 13, 17
SEARCHES = [*product((*LAWS, EACH), SEEDS, ["position"]), *product(LAWS, SEEDS[:2], ["velocity"])]


def searched(machine: str) -> list[str]:
    """All searches of a machine anew, a row a number."""
    rows = []
    for law, seed, criterion in SEARCHES:
        numbers = tune(machine, law, seed, criterion)
        rows += [f"{machine},{law},{seed},{criterion},{name},{value:.4g}" for name, value in numbers.items()]
    return rows


def write_tuned() -> None:
    """Those of all machines into `STORED`: a minute or two of processor time."""
    rows = [row for machine in MACHINES for row in searched(machine)]
    STORED.write_text("\n".join(["machine,law,seed,criterion,number,value", *rows]) + "\n")


@cache
def stored() -> dict[tuple[str, str, int, str], dict[str, float]]:
    found: dict = {}
    for line in STORED.read_text(encoding="utf-8").splitlines()[1:]:
        machine, law, seed, criterion, name, value = line.split(",")
        found.setdefault((machine, law, int(seed), criterion), {})[name] = float(value)
    return found


def tuned(machine: str, law: str, seed: int, criterion: str = "position") -> dict[str, float]:
    """What a search found, as it is stored."""
    if law == FROZEN:
        return tuned(machine, ADAPTIVE, seed, criterion) | {"adaptation": 0.0}
    return stored()[machine, law, seed, criterion]


def at_edge() -> list[str]:
    """Numbers of the searches that lie at an end of their range: a wider one might give more."""
    return [
        f"{machine}, {law}: {name} {value:g}"
        for (machine, law, *_), numbers in stored().items()
        for name, value in numbers.items()
        if any(math.isclose(value, end, rel_tol=1e-3) for end in RANGES[law][name])
    ]


def judged(
    machine: str, laws: tuple[str, ...], seeds: list[int], plants: int, seed: int, criterion: str = "position"
):
    """Errors by law, (cases, tunings, plants), on fresh plants that all laws share."""
    device, rng = MACHINES[machine], np.random.default_rng([seed, len(machine)])
    scenarios = [draw_scenario(device, rng) for _ in range(plants)]
    found = {law: np.zeros((len(CASES), len(seeds), plants)) for law in laws}
    for law, errors in found.items():
        for t, tuning in enumerate(seeds):
            chosen = law_of(device, law, tuned(machine, law, tuning, criterion))
            for c, case in enumerate(CASES):
                errors[c, t] = [error_of(drive(device, chosen, each, case), criterion) for each in scenarios]
    return found


def compared(
    found: dict[str, dict[str, np.ndarray]],
    law: str,
    other: str,
    machines=tuple(MACHINES),
    cases=CASES,
    held: bool = False,
) -> tuple[float, tuple[float, float]]:
    """Geometric mean of a law's error over another's, and its 95 % interval over the plants of these machines.

    held: of the runs alone in which neither diverges; a plant without such runs is left out.
    """
    picked = [CASES.index(case) for case in cases]
    plants = []
    for errors, others in ((found[m][law][picked], found[m][other][picked]) for m in machines):
        counted = (errors < 1) & (others < 1) if held else np.ones_like(errors, dtype=bool)
        logs = np.where(counted, np.log(errors / others), 0.0).sum(axis=(0, 1))
        runs = counted.sum(axis=(0, 1))
        plants.append(logs[runs > 0] / runs[runs > 0])
    each = np.concatenate(plants)
    return math.exp(each.mean()), tuple(math.exp(end) for end in mean_interval(each))


def diverged_share(found: dict[str, dict[str, np.ndarray]], law: str) -> tuple[float, tuple[float, float]]:
    """Cases, plants and tunings in which a law diverged, and its interval over the plants."""
    lost = np.concatenate([np.mean(each[law] == 1.0, axis=(0, 1)) for each in found.values()])
    low, high = mean_interval(lost)
    return float(lost.mean()), (max(0.0, low), high)


def best_share(found: dict[str, dict[str, np.ndarray]], law: str) -> tuple[float, tuple[float, float]]:
    """Cases, plants and tunings in which a law has the least error of `LAWS`, and its interval over the plants."""
    best = [
        np.mean(each[law] <= np.min([each[other] for other in LAWS], axis=0), axis=(0, 1))
        for each in found.values()
    ]
    low, high = mean_interval(np.concatenate(best))
    return float(np.mean(best)), (max(0.0, low), min(1.0, high))


def by_machine(found: dict, law: str, other: str, case: str | None = None) -> list[float]:
    """A law's error over another's on each machine, of the runs in which neither diverges."""
    cases = CASES if case is None else (case,)
    return [compared(found, law, other, (machine,), cases, held=True)[0] for machine in MACHINES]


def range_of(ratios: list[float]) -> str:
    """``0.5 to 0.8``."""
    return f"{min(ratios):.2f} to {max(ratios):.2f}"


# === Pictures ======================================================================================================


def paint_ratios(found: dict[str, dict[str, np.ndarray]]):
    """Who errs least and who diverges; below, error over computed torque's by case, a panel a machine, with 95 % intervals."""
    figure, (above, below) = figures.new(2, 3, height=5.2, sharey="row", height_ratios=[1, 2.4])
    for axes, share, title in zip(
        above, (best_share, diverged_share), ("errs least", "diverges"), strict=False
    ):
        for number, law in enumerate(LAWS):
            value, ends = share(found, law)
            axes.barh(number, 100 * value, color=COLOURS[law], height=0.6, alpha=0.5, label=law)
            axes.hlines(
                number, *(100 * end for end in ends), color=COLOURS[law], label=f"{law}, 95 % interval"
            )
        axes.set(title=title, xlabel="share of all runs (%)", xlim=(0, 60), ylim=(len(LAWS) - 0.5, -0.5))
        axes.set_yticks(range(len(LAWS)), LAWS)
    above[2].axis("off")
    for axes, (machine, by_law) in zip(below, found.items(), strict=True):
        _paint_machine(axes, machine, by_law)
    below[1].set_xlabel("error of q over computed torque's, where neither diverges")
    handles, labels = below[0].get_legend_handles_labels()
    shown = {label: handle for handle, label in zip(handles, labels, strict=True) if "interval" not in label}
    above[2].legend(shown.values(), shown, loc="center")
    return figure


def _paint_machine(axes, machine: str, by_law: dict[str, np.ndarray]) -> None:
    axes.axvline(1, color=figures.BLACK, lw=1, ls="--", label="computed torque")
    for number, law in enumerate(LAWS[1:]):
        places = np.arange(len(CASES)) + 0.22 * (number - 1)
        pairs = [compared({machine: by_law}, law, COMPUTED, (machine,), (case,), held=True) for case in CASES]
        middle, ends = np.array([ratio for ratio, _ in pairs]), np.array([end for _, end in pairs])
        axes.plot(middle, places, "o", ms=4, color=COLOURS[law], label=law)
        axes.hlines(places, *ends.T, color=COLOURS[law], lw=1, label=f"{law}, 95 % interval")
        for place, errors in zip(places, by_law[law], strict=True):
            if lost := int((errors == 1.0).sum()):
                style = {"fontsize": 7, "color": COLOURS[law], "va": "center", "backgroundcolor": "white"}
                axes.text(5, place, f"{lost} of {errors.size} diverge", **style)
    axes.set(title=machine, xscale="log", xlim=(0.2, 40), ylim=(len(CASES) - 0.5, -0.5))
    axes.set_xticks([0.25, 0.5, 1, 2, 4], ["1/4", "1/2", "1", "2", "4"])
    axes.minorticks_off()
    axes.set_yticks(range(len(CASES)), CASES)


@cache
def _explorer_figure(machine: str):
    """Figure of a machine in the explorer, kept for its next move: only its data change."""
    device = MACHINES[machine]
    figure, panels = figures.new(device.axes, 1, height=1.4 + 1.2 * device.axes, sharex=True, squeeze=False)
    for number, axes in enumerate(panels[:, 0]):
        for law in LAWS:
            axes.plot([], [], color=COLOURS[law], lw=0.9, label=law)
        axes.set(ylabel=f"error, axis {number + 1} (m{device.unit})")
        axes.locator_params(axis="y", nbins=3)  # fewer texts, quicker moves
    panels[-1, 0].set(xlabel="time (s)")
    figure.legend(handles=panels[0, 0].lines, loc="outside upper center", ncols=len(LAWS))
    return figure


def explorer(seed: int, tuning: int) -> Callable:
    """Explorer: one fresh plant, the four laws, and what happens to it at half time."""

    def paint(machine: str, case: str, plant: int):
        device, rng = MACHINES[machine], np.random.default_rng([seed, len(machine)])
        scenario = [draw_scenario(device, rng) for _ in range(int(plant))][-1]
        figure = _explorer_figure(machine)
        for number, law in enumerate(LAWS):
            runs = drive(device, law_of(device, law, tuned(machine, law, tuning)), scenario, case)
            for axes, run in zip(figure.axes, runs, strict=True):
                axes.lines[number].set_data(run.time[::10], 1e3 * run.position_error[::10])
        for axes in figure.axes:
            axes.relim()
            axes.autoscale_view()
        return figure

    return paint


# === What notebook 10 judges beside its answer =====================================================================

ENTRIES = {OBSERVER: "observer", ADAPTIVE: "slotine-li", FIXED: "fixed-point", COMPUTED: "computed-torque"}
SHORT = {"oscillator": "oscillator", "two-link arm": "two-link", "3-axis arm": "three-axis"}


def appendix(
    page, *, found: dict[str, dict[str, np.ndarray]], tunings: list[int], plants: int, seed: int
) -> None:
    """What this notebook judges beside its answer: by machine and case, and tuned for q'.

    Parameters
    ----------
    page : workbook.appendix.Appendix
    found : dict
        Of `judged`, by machine.
    tunings : list of int
    plants, seed : int
    """
    page.text(
        "## By machine and case\n\nErrors of $q$ over computed torque's; a diverged run counts as 1 m or rad."
    )
    for machine, name in SHORT.items():
        for law, entry in ENTRIES.items():
            if law == COMPUTED:
                continue
            value, interval = compared(found, law, COMPUTED, (machine,))
            page.check(f"fixedpoint.beside.{name}.{entry}", value, interval)
            each = (f"{case} {compared(found, law, COMPUTED, (machine,), (case,))[0]:.2f}" for case in CASES)
            page.show(f"{machine}, {law}: {', '.join(each)}")
    page.text("Of the runs in which neither diverges, by machine:")
    for law, other, case in (
        (ADAPTIVE, FIXED, "a payload"),
        (FIXED, OBSERVER, "a force begins"),
        (FIXED, COMPUTED, "a worse sensor"),
        (ADAPTIVE, FROZEN, "a payload"),
    ):
        each = ", ".join(f"{ratio:.2f}" for ratio in by_machine(found, law, other, case))
        page.show(f"{case}: {law} over {other} {each}")
    page.text(
        "## Tuned for the velocity\n\nShares of the runs in which a law errs least, tuned for $q$ and for $\\dot q$:"
    )
    fast = {name: judged(name, LAWS, tunings[:2], plants, seed, "velocity") for name in MACHINES}
    page.check("fixedpoint.beside.best-share.velocity", *best_share(fast, FIXED))
    for law in LAWS:
        page.show(f"{law}: {best_share(found, law)[0]:.2f} and {best_share(fast, law)[0]:.2f}")
    page.show("settings at an end of their range: " + ("; ".join(at_edge()) or "none"))


if __name__ == "__main__":
    write_tuned()
