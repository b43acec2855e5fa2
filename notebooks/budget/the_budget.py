"""The budget: in which order the methods stand over floors and open choices, and the spectra of one waterfall."""

from itertools import product

import numpy as np

from experiments.budget.machine import AS_FILED, BAND_HZ, FLOORS, Assumed, machine, on_every_floor, parameters
from experiments.budget.waterfall import STEPS
from stillwork.control.budget import ErrorBudget, Source, UnstableLoop, error_budget, tone_response
from stillwork.control.budget_sources import setpoint
from stillwork.machine.budget import nanometres
from workbook import figures

SCALES = (
    0.5,
    2.0,
)  # of what is assumed: frame, damper of the struts, noise of drives and of the isolator's sensors
LOUD, QUIET = ("VC-A", "VC-B", "slab under footfall"), ("VC-F", "VC-G", "LIGO ground")
STATEMENTS = {
    "feedforward-first-loud": lambda e: e["feedforward"] < np.minimum(e["skyhook"], e["observer"]),
    "observer-costs-quiet": lambda e: e["observer"] > e["passive, PID"],
    "observer-costs-quietest": lambda e: e["observer"] > e["passive, PID"],
    "together-best-loud": lambda e: e["all"] <= np.min(list(e.values()), axis=0),
    "together-costs-quiet": lambda e: e["all"] > e["skyhook"],
}
ON = {
    "feedforward-first-loud": LOUD,
    "observer-costs-quiet": QUIET,
    "observer-costs-quietest": QUIET[-1:],
    "together-best-loud": LOUD,
    "together-costs-quiet": QUIET,
}


def open_points() -> list[Assumed]:
    """Corners of what the machine's file assumes."""
    return [Assumed(*scales) for scales in product(SCALES, repeat=3)]


def step_errors(assumed: Assumed, share: float = 1.0, position: int = 0) -> dict[str, np.ndarray]:
    """Rms of each step on every floor, m; `share` of each bandwidth, the stage measured at a `position`."""
    found = {}
    for name, step in STEPS.items():
        built = machine(**step, assumed=assumed, position=position)
        if share != 1.0:
            used = step.get("used", "PID")
            law = parameters()["bandwidth"]
            built = machine(
                **step,
                assumed=assumed,
                position=position,
                bandwidth_hz=share * law["design_share"] * law[used],
            )
        by_floor, others = on_every_floor(built, FLOORS, assumed.noise)
        found[name] = np.sqrt(by_floor + others.sum())
    return found


def statements(study: list[dict[str, np.ndarray]]) -> dict[str, float]:
    """Shares of corners at which each statement holds on all of its floors."""
    return {
        name: float(np.mean([all(holds(s)[FLOORS.index(floor)] for floor in ON[name]) for s in study]))
        for name, holds in STATEMENTS.items()
    }


def waterfall_study(
    frame: float,
    struts_damping: float,
    assumed_noise: float,
    feedforward_decibels: float,
    bandwidth_share: float,
    measured_mass: int,
    *,
    seed: int = 0,
) -> dict[str, float]:
    """Whether each statement holds at one combination."""
    assumed = Assumed(frame, struts_damping, assumed_noise, feedforward_decibels)
    try:
        errors = step_errors(assumed, bandwidth_share, measured_mass)
    except UnstableLoop:
        return {f"budget.waterfall.{name}": np.nan for name in STATEMENTS}
    return {f"budget.waterfall.{name}": share for name, share in statements([errors]).items()}


def paint_spectra(budgets: dict[str, ErrorBudget]):
    """Backward cumulative spectra of all sources, one line for each of `STEPS`: from the right, where the error comes from."""
    figure, axes = figures.new(height=2.8)
    for name in STEPS:
        budget = budgets[name]
        above = np.sqrt(budget.cumulative()[:, 0].sum(axis=0))
        axes.loglog(budget.frequencies_hz, 1e9 * above, linewidth=1.0, label=name)
    axes.set(xlabel="frequency (Hz)", ylabel="rms error from all\nhigher frequencies (nm)", ylim=(0.3, None))
    axes.legend()
    return figure


def table_of(budgets: dict[str, ErrorBudget], exposure: float):
    """A row a step: rms, interval, 3 sigma, peak in a minute, MA and MSD, nm."""
    from pandas import DataFrame

    rows = []
    for budget in budgets.values():
        low, high = (_three_digits(each) for each in budget.interval()[:, 0])
        average, deviation = budget.moving(exposure)
        rms, peak = budget.rms[0], budget.peak(60.0)[0]
        sizes = [_three_digits(size) for size in (rms, 3 * rms, peak, average[0], deviation[0])]
        rows.append([sizes[0], f"{low} to {high}", *sizes[1:]])
    head = ["rms (nm)", "95 %", "3 sigma", "peak", "MA", "MSD"]
    return DataFrame(rows, index=list(budgets), columns=head)


def _three_digits(metres: float) -> str:
    return nanometres(metres).removesuffix(" nm")


# === A machine that moves =========================================================================================

RATE_HZ = 2e4  # of the controllers of the machine that moves


def there_and_back(stroke: float, seconds: float, rest: float) -> np.ndarray:
    """Positions of one period at `RATE_HZ`: a stroke by a polynomial of seventh degree, a rest, back, and a rest (m)."""
    way = np.clip(np.arange(round((seconds + rest) * RATE_HZ)) / round(seconds * RATE_HZ), 0.0, 1.0)
    there = stroke * way**4 * (35 - 84 * way + 70 * way**2 - 20 * way**3)
    return np.concatenate([there, stroke - there])


def moving_sources(period: np.ndarray, mass_share: float, force: float, force_hz: float) -> list[Source]:
    """The setpoint whose feedforward takes a share of the stage's mass, 1.5 samples ahead, and a pump on the frame."""
    mass = mass_share * machine().stage_mass
    return [
        setpoint("setpoint", period, RATE_HZ, mass, 1.5 / RATE_HZ),
        Source("pump", ("frame force",), "N", tones=((force_hz, force),)),
    ]


def moving_errors(
    period: np.ndarray, mass_share: float, force: float, force_hz: float, assumed: Assumed = AS_FILED
) -> dict[str, np.ndarray]:
    """Error over one period, m, by step: of the setpoint alone and of the pump alone, (2, samples)."""
    found = {}
    for name, step in STEPS.items():
        network = machine(**step, sample_time=1 / RATE_HZ, delay=1.0, assumed=assumed).network()
        time = np.arange(0, len(period), 10) / RATE_HZ
        found[name] = np.array(
            [
                tone_response(network, source, time, BAND_HZ)[0]
                for source in moving_sources(period, mass_share, force, force_hz)
            ]
        )
    return found


def resting(period: np.ndarray) -> np.ndarray:
    """Which of the drawn samples lie in a rest."""
    moves = np.abs(np.gradient(period)) > 1e-12 * np.ptp(period)
    return ~moves[::10]


def left_at_rest(errors: dict[str, np.ndarray], period: np.ndarray) -> dict[str, float]:
    """Rms error in the rests that the setpoint leaves, m, by step."""
    return {name: float(np.sqrt(np.mean(scan[resting(period)] ** 2))) for name, (scan, _) in errors.items()}


def moving_table(errors: dict[str, np.ndarray], left: dict[str, float]):
    """A row a method: rms error `left` at rest and largest error in µm, and what the pump adds in nm."""
    from pandas import DataFrame

    rows = {
        name: (1e6 * left[name], 1e6 * abs(scan).max(), 1e9 * pump.std())
        for name, (scan, pump) in errors.items()
    }
    columns = ["at rest (µm)", "at most (µm)", "pump (nm)"]
    return DataFrame.from_dict(rows, orient="index", columns=columns)


def moving_statements(left: dict[str, float]) -> dict[str, float]:
    """What the setpoint leaves at rest, by the ledger's names."""
    order = left["observer"] < left["skyhook"] < left["passive, PID"]
    return {
        "budget.moving.observer-first": float(order),
        "budget.moving.floor-feedforward-nothing": abs(left["feedforward"] / left["passive, PID"] - 1),
        "budget.moving.passive": 1e9 * left["passive, PID"],
        "budget.moving.together": 1e9 * left["all"],
    }


def moving_study(frame: float, stroke_time: float, mass_share: float, *, seed: int = 0) -> dict[str, float]:
    """The statements on a moving machine with another frame, setpoint and feedforward."""
    period = there_and_back(0.02, stroke_time, 0.1)
    try:
        errors = moving_errors(period, mass_share, 0.01, 24.0, Assumed(frame=frame))
    except UnstableLoop:
        return dict.fromkeys(moving_statements(dict.fromkeys(STEPS, 1.0)), np.nan)
    return moving_statements(left_at_rest(errors, period))


def paint_moving(errors: dict[str, np.ndarray], period: np.ndarray):
    """Error over one period by step, and the rests of the setpoint shaded."""
    figure, axes = figures.new(height=2.8)
    time = 10 * np.arange(next(iter(errors.values())).shape[1]) / RATE_HZ
    for name, (scan, _) in errors.items():
        axes.plot(
            1e3 * time,
            1e6 * scan,
            linewidth=4.0 if name == "passive, PID" else 1.0,  # the feedforward's lies on it
            alpha=0.4 if name == "passive, PID" else 1.0,
            label=name,
            linestyle="--" if name == "feedforward" else "-",
        )
    axes.fill_between(
        1e3 * time, 0, 1, where=resting(period), transform=axes.get_xaxis_transform(), color=figures.GREY, alpha=0.2,
        label="setpoint rests",
    )  # fmt: skip
    axes.set(xlabel="time (ms)", ylabel="error (µm)")
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return figure


def parseval_distance(period: np.ndarray) -> float:
    """Relative distance of the waveform's mean square from what the budget gives the setpoint."""
    network = machine(**STEPS["all"], sample_time=1 / RATE_HZ, delay=1.0).network()
    source = moving_sources(period, 0.99, 0.01, 24.0)[0]
    wave = tone_response(network, source, np.arange(len(period)) / RATE_HZ, BAND_HZ)[0]
    return abs(np.mean(wave**2) / error_budget(network, [source], BAND_HZ).powers[0, 0] - 1)
