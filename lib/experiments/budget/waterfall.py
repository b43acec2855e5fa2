"""The waterfall: the error without any method, with each paper's method alone, and with all, by source."""

from dataclasses import replace
from functools import lru_cache
from itertools import cycle, product

import numpy as np

from experiments.budget.machine import BAND_HZ, FLOORS, budget_of, filed, level, machine, noises, parameters
from experiments.budget.machine import floor as source_of
from stillwork.control.budget import ErrorBudget, UnstableLoop, error_budget
from stillwork.control.floor_machine import FloorMachine
from workbook import Choice, Slider, figures

STEPS = {
    "passive, PID": {},
    "skyhook": {"skyhook": True},
    "feedforward": {"feedforward": True},
    "observer": {"used": "MC and AD"},
    "all": {"skyhook": True, "feedforward": True, "used": "MC and AD"},
}
# With the observer's other use, damping alone.
ALTERNATIVES = {
    "observer, AD": {"used": "AD"},
    "all, AD": {"skyhook": True, "feedforward": True, "used": "AD"},
}
SHOWN = ("passive, PID", "skyhook", "feedforward", "observer", "observer, AD", "all", "all, AD")
COLOURS = (figures.BLUE, figures.ORANGE, figures.GREEN, figures.PURPLE, figures.SKY)


def waterfall(floor: str) -> dict[str, ErrorBudget]:
    """The budget of each of `STEPS` and `ALTERNATIVES` on a floor."""
    steps = STEPS | ALTERNATIVES
    return {name: budget_of(machine(**steps[name]), floor) for name in SHOWN}


def paint_waterfall(budgets: dict[str, ErrorBudget], title: str = ""):
    """Rms of the error by source for each step, and of all together."""
    figure, axes = figures.new(height=3.2)
    places = np.arange(len(budgets))
    total = np.array([1e9 * budget.rms[0] for budget in budgets.values()])
    axes.plot(
        places, total, "_", markersize=26, markeredgewidth=1.5, color=figures.BLACK, label="all sources"
    )
    for place, size in zip(places, total, strict=True):
        axes.annotate(
            f"{size:.3g}" if size < 100 else f"{size:.0f}",
            (place, size),
            (0, 5),
            textcoords="offset points",
            ha="center",
            fontsize=8,
        )
    first = next(iter(budgets.values()))
    parts = np.array([1e9 * np.sqrt(budget.powers[:, 0]) for budget in budgets.values()])
    styles = cycle(product("os^", COLOURS))
    for k, (name, row, (mark, colour)) in enumerate(zip(first.names, parts.T, styles, strict=False)):
        if np.any(row > 1e-4 * total.max()):
            at = places + 0.05 * (k - (len(first.names) - 1) / 2)  # side by side: equal parts hide none
            axes.plot(at, np.maximum(row, 1e-6), mark, markersize=4, color=colour, label=name)
    low = 10 ** np.floor(np.log10(max(0.03 * total.min(), 1e-3)))
    axes.set(yscale="log", ylim=(low, 3 * total.max()), ylabel="error, rms (nm)", title=title)
    axes.set_xticks(places, [name.replace(" ", "\n", 1) for name in budgets])
    axes.set(xlabel="methods", xlim=(-0.6, len(places) - 0.4))
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return figure


EXPLORED = {
    "passive": {},
    "and skyhook": {"skyhook": True},
    "and feedforward": {"skyhook": True, "feedforward": True},
    "and observer": {"skyhook": True, "feedforward": True, "used": "MC and AD"},
}


def explore_waterfall(floor: str, bandwidth_hz: float, sensor_nm: float, feedforward_db: float):
    """Passive, then with skyhook, then with feedforward, then with the observer, at one bandwidth of the stage."""
    budgets = {}
    for name, step in EXPLORED.items():
        decibels = feedforward_db if "feedforward" in step else 0.0
        try:
            budgets[name] = _with_sensor(_explored(name, floor, bandwidth_hz, decibels), 1e-9 * sensor_nm)
        except UnstableLoop:
            continue
    return paint_waterfall(
        budgets, f"{floor}, {bandwidth_hz:.0f} Hz, {sensor_nm:.2g} nm/√Hz, {feedforward_db:.0f} dB"
    )


@lru_cache(maxsize=2 * len(EXPLORED))
def _explored(name: str, floor: str, bandwidth_hz: float, decibels: float) -> ErrorBudget:
    """One of `EXPLORED` with the sensor as filed."""
    built = machine(**EXPLORED[name], bandwidth_hz=bandwidth_hz)
    network = (with_feedforward(built, decibels) if built.feedforward else built).network()
    acting = [0, *range(len(network.disturbances), network.plant.d.shape[1])]  # the floor and the commands
    error = next(iter(network.errors))
    # The error that is drawn, and what is measured.
    seen = [0, *range(len(network.errors), len(network.plant.d))]
    network = replace(
        network,
        plant=network.plant.select(acting, seen),
        disturbances={"floor": network.disturbances["floor"]},
        errors={error: network.errors[error]},
    )
    return error_budget(network, [source_of(floor), *noises()], BAND_HZ)


def _with_sensor(budget: ErrorBudget, sensor: float) -> ErrorBudget:
    """A budget with another noise of the stage's sensor, whose density is its square's."""
    row = budget.names.index("stage sensor")
    density = budget.density.copy()
    density[row] *= (sensor / level("stage sensor")) ** 2
    return replace(budget, density=density)


def with_feedforward(built: FloorMachine, decibels: float) -> FloorMachine:
    """The machine with a feedforward that takes so much of the floor's path away."""
    return replace(built, feedforward=1 - 10 ** (-decibels / 20))


def presets() -> dict[str, dict]:
    """Settings of the explorer that the pages speak of: "all" of `STEPS`, loud and quiet, and a poor sensor."""
    p = parameters()
    fast = {"bandwidth_hz": p["bandwidth"]["design_share"] * p["bandwidth"]["MC and AD"]}
    return {
        "as filed": {},
        "slab": {"floor": "slab under footfall"},
        "slab, all methods": {"floor": "slab under footfall", **fast},
        "LIGO ground": {"floor": "LIGO ground"},
        "LIGO ground, all methods": {"floor": "LIGO ground", **fast},
        "ten times the sensor's noise": {"sensor_nm": 1e10 * level("stage sensor")},
    }


def controls() -> dict:
    """Sliders of the explorer: the machine of the page."""
    p = parameters()
    return {
        "floor": Choice(FLOORS, "VC-C", basis="assumed"),
        "bandwidth_hz": Slider(15.0, 100.0, 0.95 * p["bandwidth"]["PID"], "Hz", basis="assumed"),
        "sensor_nm": Slider(0.01, 30.0, 1e9 * level("stage sensor"), "nm/√Hz", log=True, basis="assumed"),
        "feedforward_db": Slider(
            0.0, 50.0, filed().entries["controller"]["feedforward_db"], "dB", basis="assumed"
        ),
    }
