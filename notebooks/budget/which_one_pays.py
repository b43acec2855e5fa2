"""What to buy first: first and second purchases over floors, sensors and payloads; who tunes the feedforward; who differentiates."""

from dataclasses import dataclass, replace
from functools import cache
from itertools import product

import numpy as np
from scipy import signal

from experiments.budget.machine import (
    AS_FILED,
    BAND_HZ,
    FLOORS,
    Assumed,
    floor,
    level,
    machine,
    noises,
    on_every_floor,
)
from stillwork.control.budget import ErrorBudget, UnstableLoop, error_budget
from stillwork.control.floor_machine import FloorMachine, weak_integrator
from stillwork.estimation.adaptive import FeLms, FeRls
from stillwork.estimation.min_max import solve_silently
from stillwork.estimation.online import identify
from stillwork.lti.discretisation import tustin
from stillwork.lti.state_space import StateModel
from workbook import figures

OBSERVERS = ("AD", "MC and AD")  # uses of the observer, of which one is bought
METHODS = ("skyhook", "feedforward", *OBSERVERS)
SENSORS = (0.014, 0.14, 1.4, 14.0)  # nm/sqrt(Hz)
PAYLOADS = (0.0, 20.0, 60.0)  # kg on the frame
ADVANTAGE = 0.05  # a method is bought when it lowers the error by more than this share (chosen)

# === What to buy first ============================================================================================


@cache
def powers_of(
    bought: frozenset[str], payload: float, assumed: Assumed = AS_FILED
) -> tuple[np.ndarray, np.ndarray]:
    """Mean squares by floor and by the other sources, of the machine with these methods."""
    used = next((name for name in OBSERVERS if name in bought), "PID")
    skyhook, feedforward = "skyhook" in bought, "feedforward" in bought
    return on_every_floor(
        machine(used, skyhook=skyhook, feedforward=feedforward, payload=payload, assumed=assumed)
    )


def error(
    bought: frozenset[str], place: int, sensor: float, payload: float, assumed: Assumed = AS_FILED
) -> float:
    """Rms in m on a floor of `FLOORS` with a sensor in nm/sqrt(Hz)."""
    by_floor, others = powers_of(bought, payload, assumed)
    scale = np.array([(1e-9 * sensor / level("stage sensor")) ** 2, 1, 1, 1])
    return float(np.sqrt(by_floor[place] + others @ scale))


def order_of_purchase(
    place: int, sensor: float, payload: float, assumed: Assumed = AS_FILED, advantage: float = ADVANTAGE
) -> list[str]:
    """Methods in the order in which each lowers the error most, as long as one lowers it by `advantage`."""
    bought: frozenset[str] = frozenset()
    order = []
    while True:
        now = error(bought, place, sensor, payload, assumed)
        offers = {
            name: error(bought | {name}, place, sensor, payload, assumed)
            for name in METHODS
            if name not in bought and not (name in OBSERVERS and bought & set(OBSERVERS))
        }
        if not offers:
            break
        best = min(offers, key=lambda name: offers[name])
        if offers[best] > (1 - advantage) * now:
            break
        order.append(best)
        bought |= {best}
    return order


def purchase_map(payload: float, assumed: Assumed = AS_FILED, advantage: float = ADVANTAGE) -> np.ndarray:
    """Orders of purchase, (sensors, floors)."""
    found = np.empty((len(SENSORS), len(FLOORS)), object)
    for (row, sensor), (column, _) in product(enumerate(SENSORS), enumerate(FLOORS)):
        found[row, column] = order_of_purchase(column, sensor, payload, assumed, advantage)
    return found


def map_statements(assumed: Assumed = AS_FILED, advantage: float = ADVANTAGE) -> dict[str, float]:
    """What the map shows, by the ledger's names."""
    maps = [purchase_map(payload, assumed, advantage) for payload in PAYLOADS]
    poor, good = (
        [order for orders in maps for order in orders[SENSORS.index(sensor)]] for sensor in (14.0, 0.014)
    )
    firsts = [(order or ["nothing"])[0] for orders in maps for order in orders.ravel()]
    return {
        "budget.pays.noisy-sensor-no-observer": float(np.mean([not observed(order) for order in poor])),
        "budget.pays.good-sensor-observer": float(np.mean([observed(order) for order in good])),
        "budget.pays.first-purchases": float(len(set(firsts))),
        "budget.pays.feedforward-first": firsts.count("feedforward") / len(firsts),
    }


def map_study(frame: float, advantage: float, *, seed: int = 0) -> dict[str, float]:
    """The map's statements with another frame and least advantage."""
    return map_statements(Assumed(frame=frame), advantage)


def observed(order: list[str]) -> bool:
    """Whether an observer is among the purchases."""
    return bool(set(OBSERVERS) & set(order))


def with_both() -> tuple[float, float]:
    """Error with MC and AD over that with AD alone, less 1: least and largest where the map buys either."""
    ratios = []
    for payload in PAYLOADS:
        for (row, column), order in np.ndenumerate(purchase_map(payload)):
            if observed(order):
                others = frozenset(order) - set(OBSERVERS)
                alone, both = (error(others | {name}, column, SENSORS[row], payload) for name in OBSERVERS)
                ratios.append(both / alone - 1)
    return min(ratios), max(ratios)


def kinds_bought() -> dict[str, int]:
    """Points of the map at which each method is bought first, the most frequent first."""
    firsts = [(order or ["nothing"])[0] for payload in PAYLOADS for order in purchase_map(payload).ravel()]
    return {name: firsts.count(name) for name in sorted(set(firsts), key=firsts.count, reverse=True)}


def paint_map(payloads=PAYLOADS):
    """Over floor and sensor, one panel a payload: the square's colour is the first purchase, its dot the second."""
    from matplotlib.lines import Line2D

    shades = {
        "skyhook": figures.SKY,
        "feedforward": figures.ORANGE,
        "AD": figures.GREEN,
        "MC and AD": figures.PURPLE,
        "nothing": "#DDDDDD",
    }
    figure, axes = figures.new(len(payloads), 1, height=1.7 * len(payloads) + 0.9, sharex=True)
    for panel, payload in zip(np.atleast_1d(axes), payloads, strict=True):
        orders = purchase_map(payload)
        for name, shade in shades.items():
            for rank, style in (
                (0, {"marker": "s", "markersize": 19}),
                (1, {"marker": "o", "markersize": 8}),
            ):
                there = [
                    (c, r)
                    for (r, c), order in np.ndenumerate(orders)
                    if [*order, "nothing"][rank:][:1] == [name]
                ]
                if there and (rank == 0 or name != "nothing"):
                    edge = {
                        "markeredgecolor": figures.BLACK,
                        "markeredgewidth": 0.8 * rank,
                        "zorder": 2 + rank,
                    }
                    panel.plot(*np.array(there).T, linestyle="none", color=shade, **style, **edge)
        panel.set_yticks(range(len(SENSORS)), [f"{sensor:g}" for sensor in SENSORS])
        panel.grid(visible=False)
        panel.set(
            ylabel="stage sensor (nm/√Hz)",
            title=f"payload {payload:g} kg",
            xlim=(-0.6, len(FLOORS) - 0.4),
            ylim=(-0.6, len(SENSORS) - 0.4),
        )
    np.atleast_1d(axes)[-1].set_xticks(range(len(FLOORS)), [name.split()[0] for name in FLOORS])
    np.atleast_1d(axes)[-1].set_xlabel("floor (square: bought first; dot: bought second, none: nothing more)")
    names = {"AD": "observer, AD", "MC and AD": "observer, MC and AD"}
    keys = [Line2D([], [], marker="s", linestyle="none", color=shade) for shade in shades.values()]
    figure.legend(keys, [names.get(name, name) for name in shades], loc="outside lower center", ncols=5)
    return figure


# === Which algorithm tunes the feedforward ========================================================================

RATE_HZ = 500.0
RECORD_S = 60.0
NOISES = (1e-5, 1e-4, 1e-3)  # m/s^2/sqrt(Hz) of the floor sensor: quiet, ordinary, as loud as the floor
STEP_SIZES = (5e-4, 2e-3, 8e-3)  # of FeLMS; each trial takes its best
LEAST_DRAWN = 1e-5  # what is less is drawn there
ALGORITHMS = ("least squares by FeRLS", "FeLMS", "min-max, typical bound", "min-max, guaranteed bound")


@dataclass(frozen=True)
class Tuning:
    """Share of the floor's force that tuned weights leave over what the best weights leave, from the spectra, less 1."""

    excess: dict[str, float]
    optimum: float  # share of the floor's power that the best weights leave


def tuning_trial(
    place: str, noise: float, seed: int, record_s: float = RECORD_S, memory_s: float = 10.0
) -> Tuning:
    """Weights of damper and spring from one record with a noisy floor sensor, judged by the spectra, which are known.

    FeRLS forgets within `memory_s`, and the window of the min-max estimate is as long.
    """
    samples = round(record_s * RATE_HZ)
    f = np.fft.rfftfreq(samples, 1 / RATE_HZ)
    rng = np.random.default_rng(seed)
    first = tustin(weak_integrator(2.0, 3), 1 / RATE_HZ).frequency_response(2 * np.pi * f[1:])[0, 0]
    k, d, _ = machine().suspension
    basis = np.vstack([d * first, k * first**2])  # N per m/s^2 for weights of one
    ground = floor(place)._at(f[1:])[0, 0].real
    spectra = ground, np.full(len(f) - 1, noise**2)

    def draw(density):
        lines = np.zeros(len(f), complex)
        lines[1:] = np.sqrt(density * RATE_HZ * samples / 4) * (
            rng.standard_normal((2, len(f) - 1)).T @ [1, 1j]
        )
        return lines

    true, false = (draw(each) for each in spectra)
    moved = np.zeros((2, len(f)), complex)
    moved[:, 1:] = basis * (true + false)[1:]
    seen = np.fft.irfft(moved, samples)
    wanted = np.fft.irfft(np.concatenate([[0], basis.sum(axis=0) * true[1:]]), samples)
    # The quadratic form of what is left, exactly: weights w leave |sum of basis - w basis|^2 ground + |w basis|^2 noise.
    gram = [np.real(basis * s @ basis.conj().T) for s in spectra]
    best = np.linalg.solve(gram[0] + gram[1], gram[0] @ np.ones(2))

    def left(w):
        return float((1 - w) @ gram[0] @ (1 - w) + w @ gram[1] @ w)

    size = np.sqrt(np.mean(seen**2, axis=1))
    forgetting = 1 - 1 / (memory_s * RATE_HZ)
    rows = seen / size[:, None]
    memory = rows[:, -round(memory_s * RATE_HZ) :]
    target = wanted[-memory.shape[1] :]
    spread = np.sqrt(np.diag(gram[1]) / np.diag(gram[0] + gram[1]))  # share of noise in each regressor
    bounds = {
        "typical": spread.max() * np.sqrt(memory.shape[1]),
        "guaranteed": 3 * np.linalg.norm(spread) * np.sqrt(memory.shape[1]),
    }
    found = {
        "least squares by FeRLS": -identify(
            FeRls(memory_s, forgetting=forgetting), rows, wanted[None]
        ).weights[0],
        **{
            f"min-max, {name} bound": solve_silently(memory.T, target, bound).estimate
            for name, bound in bounds.items()
        },
    }
    by_gradient = [-identify(FeLms(step_size=mu), rows, wanted[None]).weights[0] for mu in STEP_SIZES]
    found["FeLMS"] = min(by_gradient, key=lambda w: left(w / size))
    least, whole = left(best), float(gram[0].sum())
    return Tuning({name: left(found[name] / size) / least - 1 for name in ALGORITHMS}, least / whole)


TUNED = ("VC-A", "VC-D", "slab under footfall", "LIGO ground")  # where the feedforward is tuned


def tuning_study(
    places: tuple[str, ...], seeds: range, record_s: float = RECORD_S, memory_s: float = 10.0
) -> dict[tuple[str, float], list[Tuning]]:
    """Trials of every seed on every floor with every noise."""
    return {
        (place, noise): [tuning_trial(place, noise, seed, record_s, memory_s) for seed in seeds]
        for place, noise in product(places, NOISES)
    }


def tuning_statements(study: dict[tuple[str, float], list[Tuning]]) -> dict[str, float]:
    """What the trials show, by the ledger's names; NaN where no trial is of the kind."""
    trials = [trial for case in study.values() for trial in case]
    first, others = ALGORITHMS[0], ALGORITHMS[1:]
    heard = [t for t in trials if t.optimum < 0.5]
    deaf = [t for t in trials if t.optimum > 0.95]
    nearest = [all(t.excess[first] < t.excess[name] for name in others) for t in heard]
    no_more = [min(t.excess[name] for name in ALGORITHMS[2:]) <= t.excess[first] for t in deaf]
    return {
        "budget.pays.rls-nearest": float(np.mean(nearest)) if nearest else np.nan,
        "budget.pays.min-max-deaf": float(np.mean(no_more)) if no_more else np.nan,
    }


def tuning_choices(memory: float, *, seed: int) -> dict[str, float]:
    """The statements on who tunes, with memories of other lengths and other draws."""
    return tuning_statements(tuning_study(TUNED, range(seed, seed + 4), RECORD_S, memory))


def paint_tuning(study: dict[tuple[str, float], list[Tuning]]):
    """Excess over the best weights of each algorithm, one panel a noise; dots are seeds, floors side by side."""
    figure, axes = figures.new(1, len(NOISES), height=3.0, sharey=True)
    places = list(dict.fromkeys(place for place, _ in study))
    colours = (figures.BLUE, figures.ORANGE, figures.GREEN, figures.PURPLE)
    for panel, noise in zip(axes, NOISES, strict=True):
        for k, (name, colour) in enumerate(zip(ALGORITHMS, colours, strict=True)):
            dots = [
                (i + 0.15 * (k - 1.5), max(trial.excess[name], LEAST_DRAWN))
                for i, place in enumerate(places)
                for trial in study[place, noise]
            ]
            panel.semilogy(*np.array(dots).T, "o", markersize=2.5, color=colour, label=name)
        panel.set_xticks(range(len(places)), [place.split()[0] for place in places])
        exponent = str(round(np.log10(noise))).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
        panel.set(title=f"floor sensor 10{exponent} m/s²/√Hz", ylim=(0.7 * LEAST_DRAWN, None))
    axes[0].set_ylabel("power left above the least,\nover the least")
    axes[1].set_xlabel("floor (a dot: one record of a minute)")
    figures.legend_below(axes[0], 2)
    return figure


# === Which differentiator ==========================================================================================

DIFFERENTIATORS = ("quotient", "low pass", "window", "Kalman", "observer of the stage")
SAMPLE_S = 1 / 5000
BANDWIDTHS_HZ = (40.0, 60.0, 80.0)  # of the stage where the velocity is filtered (chosen)
CHOICES = {  # of each one's parameter: rad/s over the bandwidth, samples, and ratio of the Kalman filter's bandwidth
    "quotient": (0.0,),
    "low pass": (3.0, 6.0, 12.0, 25.0),
    "window": (2.0, 4.0, 8.0, 16.0),
    "Kalman": (2.0, 4.0, 8.0, 16.0),
    "observer of the stage": (1.0, 2.0, 4.0, 8.0),
}


def differentiator(
    name: str, setting: float, bandwidth_hz: float, mass: float, sample_s: float = SAMPLE_S
) -> StateModel:
    """PID on the stage sensor, sampled, whose velocity comes from a filter: from the sensor to the force.

    Low pass: the third order of the paper's (7), here with the derivative that it holds. Window: a mean of differences.
    Kalman: position and velocity, driven by the sensor alone, in its steady state with both poles at `setting` times the
    bandwidth. The observer is the same filter with the controller's own force as input.
    """
    w, t = 2 * np.pi * bandwidth_hz, sample_s
    kp, kd, ki = mass * w**2 / 3, mass * w, mass * w**3 / 27
    a, b, c = np.zeros((1, 1)), np.ones((1, 1)), -ki * t * np.ones((1, 1))  # the integral
    if name in ("quotient", "window"):
        n = int(setting) or 1
        taps = np.zeros(n + 1)
        taps[0], taps[-1] = 1 / (n * t), -1 / (n * t)
        line = np.eye(n, k=-1)
        velocity = StateModel(line, np.eye(n, 1), taps[None, 1:], taps[:1, None], t)
    elif name == "low pass":
        bw = setting * w
        fa, fb, fc, fd = signal.tf2ss([1.0, 0.0], np.poly(-np.ones(3)))
        velocity = tustin(StateModel(fa * bw, fb * bw, fc * bw, fd * bw), t)
    else:
        pole = np.exp(-setting * w * t)
        l1, l2 = 1 - pole**2, (1 - pole) ** 2 / t  # both poles of the filter at `pole`
        step = np.array([[1.0, t], [0.0, 1.0]])
        gain = np.array([[l1], [l2]])
        keep = np.eye(2) - gain @ np.array([[1.0, 0.0]])
        force = np.array([[t**2 / 2], [t]]) / mass
        # x = keep (step x + force u) + gain y, with u of the sample before; read its velocity.
        velocity = StateModel(keep @ step, keep @ step @ gain, np.array([[0.0, 1.0]]), gain[1:], t)
        if name == "observer of the stage":
            return _with_own_force(keep, step, force, gain, (kp, kd, ki * t), t)
    n = len(velocity.a)
    whole = np.block([[a + 1, np.zeros((1, n))], [np.zeros((n, 1)), velocity.a]])
    return StateModel(
        whole,
        np.vstack([b, velocity.b]),
        np.hstack([c, -kd * velocity.c]),
        -(kp + ki * t) - kd * velocity.d,
        t,
    )


def _with_own_force(keep, step, force, gain, gains, t) -> StateModel:
    """States: integral, predicted position and velocity; u = -kp y - ki (i + y) - kd v, with v after the correction."""
    kp, kd, ki = gains
    # v = [0 1] (keep p + gain y); next p = step (keep p + gain y) + force u
    row = np.array([[0.0, 1.0]])
    cu = np.hstack([[[-ki]], -kd * row @ keep])
    du = -(kp + ki) - kd * row @ gain
    a = np.block([[np.ones((1, 1)), np.zeros((1, 2))], [np.zeros((2, 1)), step @ keep]])
    b = np.vstack([np.ones((1, 1)), step @ gain])
    inputs = np.vstack([np.zeros((1, 1)), force])
    return StateModel(a + inputs @ cu, b + inputs @ du, cu, du, t)


def velocity_machine(
    name: str, setting: float, bandwidth_hz: float, sample_s: float = SAMPLE_S, delay: float = 1.0
) -> FloorMachine:
    """A stage of the thesis's mass, rigid, with that law, sampled and late."""
    built = machine(skyhook=True, feedforward=True)
    rigid = built.stage.modes([0])
    law = differentiator(name, setting, bandwidth_hz, built.stage_mass, sample_s)
    return replace(built, stage=rigid, controller=law, sample_time=sample_s, delay=delay)


@cache
def velocity_powers(
    name: str, setting: float, bandwidth_hz: float, sample_s: float = SAMPLE_S, delay: float = 1.0
) -> ErrorBudget | None:
    """The budget on all floors at once; None where the loop is unstable."""
    try:
        network = velocity_machine(name, setting, bandwidth_hz, sample_s, delay).network()
    except UnstableLoop:
        return None
    return error_budget(network, [*map(floor, FLOORS), *noises()], (BAND_HZ[0], 2500.0))


def velocity_errors(
    bandwidth_hz: float, sensor: float, sample_s: float = SAMPLE_S, delay: float = 1.0
) -> dict[str, np.ndarray]:
    """Least rms on each floor over each differentiator's settings, m; infinite where none is stable."""
    found = {}
    for name in DIFFERENTIATORS:
        rows = [np.full(len(FLOORS), np.inf)]
        for setting in CHOICES[name]:
            budget = velocity_powers(name, setting, bandwidth_hz, sample_s, delay)
            if budget is not None:
                powers = budget.powers[:, 0].copy()
                powers[len(FLOORS)] *= (1e-9 * sensor / level("stage sensor")) ** 2
                rows.append(np.sqrt(powers[: len(FLOORS)] + powers[len(FLOORS) :].sum()))
        found[name] = np.min(rows, axis=0)
    return found


def velocity_statements(
    bandwidths_hz: tuple[float, ...] = BANDWIDTHS_HZ, sample_s: float = SAMPLE_S, delay: float = 1.0
) -> dict[str, float]:
    """Which differentiator is best, by the ledger's names."""
    observer, filters = DIFFERENTIATORS[-1], DIFFERENTIATORS[1:-1]
    loud = [FLOORS.index("VC-A"), FLOORS.index("slab under footfall")]
    found = {
        (hertz, sensor): velocity_errors(hertz, sensor, sample_s, delay)
        for hertz, sensor in product(bandwidths_hz, (0.14, 1.4, 14.0))
    }
    best = {case: np.min([errors[name] for name in filters], axis=0) for case, errors in found.items()}
    worst = {case: np.max([errors[name] for name in filters], axis=0) for case, errors in found.items()}
    gains = [np.max(1 - best[case] / errors["quotient"]) for case, errors in found.items()]
    noisy = [found[hertz, 14.0][observer] < best[hertz, 14.0] for hertz in bandwidths_hz]
    quiet = [np.all((found[hertz, 0.14][observer] > worst[hertz, 0.14])[loud]) for hertz in bandwidths_hz]
    return {
        "budget.pays.filters-level": float(max(gains)),
        "budget.pays.observer-velocity-noisy": float(np.mean(noisy)),
        "budget.pays.observer-velocity-quiet": float(np.mean(quiet)),
    }


def velocity_choices(velocity_rate: float, velocity_delay: float, *, seed: int = 0) -> dict[str, float]:
    """The statements on the velocity at another rate and delay."""
    return velocity_statements(BANDWIDTHS_HZ, 1 / velocity_rate, velocity_delay)


def paint_velocity(errors: dict[float, dict[str, np.ndarray]]):
    """Error of each differentiator over that of the best, on each floor; one panel a sensor."""
    figure, axes = figures.new(len(errors), 1, height=1.5 * len(errors) + 0.9, sharex=True)
    for panel, (sensor, found) in zip(np.atleast_1d(axes), errors.items(), strict=True):
        least = np.min(list(found.values()), axis=0)
        for k, (mark, (name, row)) in enumerate(zip("osD^v", found.items(), strict=True)):
            at = np.arange(len(FLOORS)) + 0.15 * (k - 2)
            panel.plot(at, row / least, mark, linestyle="none", markersize=4.5, label=name)
        for edge in np.arange(len(FLOORS) - 1) + 0.5:
            panel.axvline(edge, color=figures.GREY, linewidth=0.5, alpha=0.5)
        panel.grid(visible=False, axis="x")
        panel.set(
            title=f"sensor {sensor:g} nm/√Hz", ylabel="error over\nthe least", xlim=(-0.5, len(FLOORS) - 0.5)
        )
    np.atleast_1d(axes)[-1].set_xticks(range(len(FLOORS)), [name.split()[0] for name in FLOORS])
    np.atleast_1d(axes)[-1].set_xlabel("floor")
    figures.legend_below(np.atleast_1d(axes)[0], 5)
    return figure
