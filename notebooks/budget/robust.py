"""Robust: the waterfall at places all over the box of the stage's numbers, and which ranking changes there."""

from dataclasses import replace
from functools import cache

import numpy as np

from experiments.budget.machine import FLOORS, machine, on_every_floor, stage
from stillwork.control.budget import box_band, box_places
from stillwork.control.floor_machine import FloorMachine
from stillwork.control.uncertainty import Perturbation, Uncertainty, corners, perturbed_plant
from workbook import figures

DESIGNS = ("PID", "MC", "AD", "MC and AD")
SIZES = (0.05, 0.1, 0.2)  # shares of each frequency, of mass and gain; see `box`
PLACES, CORNERS = 8, 2
RATE_HZ = 2e4  # of the controllers, designed for a delay of one sample; see `unstable_at_nominal`
PARTS = ("frequency", "damping", "gain", "mass", "delay")
LEVEL = 0.05  # of the error: uses that are nearer to each other are level (chosen, as for a purchase)
LOUD = ("VC-A", "VC-B", "slab under footfall")  # where some use of the observer leaves less than the PID


def box(size: float, rate_hz: float, parts: tuple[str, ...] = PARTS) -> Uncertainty:
    """Frequencies, gain and mass off by `size`, damping by ten times as much, the delay by five samples times it."""
    whole = {part: size for part in PARTS} | {"damping": min(10 * size, 0.9), "delay": 5 * size / rate_hz}
    return Uncertainty(**{part: whole[part] for part in parts})


def elsewhere(design: str, rate_hz: float, place: Perturbation) -> FloorMachine:
    """The machine at a place of the box; controller and observer stay those of the nominal stage and one sample."""
    built = machine(design, skyhook=True, feedforward=True, sample_time=1 / rate_hz, delay=1.0)
    return replace(built, stage=perturbed_plant(stage(), place), delay=max(1.0 + place.delay * rate_hz, 0.0))


def errors_at(design: str, rate_hz: float, places: list[Perturbation]) -> np.ndarray:
    """Rms on every floor, (places, floors) in m, NaN where unstable."""

    def rms(place: Perturbation) -> np.ndarray:
        by_floor, others = on_every_floor(elsewhere(design, rate_hz, place))
        return np.sqrt(by_floor + others.sum())

    found = box_band(rms, places).rms.reshape(len(places), -1)
    return np.broadcast_to(found, (len(places), len(FLOORS)))


@cache
def boxed(
    design: str, size: float, rate_hz: float = RATE_HZ, places: int = PLACES, seed: int = 0
) -> np.ndarray:
    """`errors_at` at places that fill the box, then at its corners.

    These have all frequencies low or high, and light damping, high gain and long delay.
    """
    own = box(size, rate_hz)
    inside = box_places(own, stage(), places, seed)
    return errors_at(design, rate_hz, [*inside, *corners(own._of_modes(stage()))])


@cache
def best_shares(size: float, rate_hz: float = RATE_HZ, places: int = PLACES, seed: int = 0) -> np.ndarray:
    """Share of the places at which each design errs least among the stable ones, (designs, floors)."""
    best = _best([boxed(design, size, rate_hz, places, seed)[:places] for design in DESIGNS])
    return np.array([(best == k).mean(axis=0) for k in range(len(DESIGNS))])


def _best(errors: list[np.ndarray]) -> np.ndarray:
    return np.argmin(np.where(np.isnan(errors), np.inf, errors), axis=0)


def margins(errors: list[np.ndarray]) -> np.ndarray:
    """Error of each design over the least at the same place, less 1, (designs, places, floors); infinite where unstable."""
    whole = np.array([np.where(np.isnan(each), np.inf, each) for each in errors])
    return whole / whole.min(axis=0) - 1


@cache
def nominal_and_box(
    size: float, rate_hz: float = RATE_HZ, places: int = PLACES, seed: int = 0
) -> list[np.ndarray]:
    """Errors of every design, (places, floors): at the nominal stage, then at the places of the box."""
    ones = np.ones(len(stage().frequencies))
    nominal = [Perturbation(ones, ones, ones)]
    return [
        np.vstack([errors_at(design, rate_hz, nominal), boxed(design, size, rate_hz, places, seed)[:places]])
        for design in DESIGNS
    ]


def turned(errors: list[np.ndarray]) -> np.ndarray:
    """Floors on which the use that is best at the first place is behind by more than `LEVEL` at another where it is stable."""
    whole = margins(errors)
    best = np.argmin(whole[:, 0], axis=0)
    behind = (whole > LEVEL) & np.isfinite(whole)
    return np.array([behind[k, 1:, column].any() for column, k in enumerate(best)])


def turned_at_corners(size: float) -> np.ndarray:
    """As `turned`, between the nominal stage and the corners of the box."""
    whole = zip(DESIGNS, nominal_and_box(size), strict=True)
    return turned([np.vstack([errors[:1], boxed(design, size)[PLACES:]]) for design, errors in whole])


@cache
def turned_by(part: str, size: float) -> np.ndarray:
    """As `turned`, between the nominal stage and either end of one part of the box."""
    places = [*corners(box(size, RATE_HZ, (part,))._of_modes(stage()))] if part != "mass" else []
    ones = np.ones(len(stage().frequencies))
    if part == "mass":
        places = [Perturbation(ones, np.append(1 / (1 + sign * size), ones[1:]), ones) for sign in (-1, 1)]
    if part in ("gain", "delay", "damping"):
        low = {
            "gain": Perturbation(ones, ones, ones, 1 - size),
            "delay": Perturbation(ones, ones, ones, delay=-5 * size / RATE_HZ),
            "damping": Perturbation(ones, ones, ones * (1 + min(10 * size, 0.9))),
        }[part]
        places = [places[-1], low]
    whole = [Perturbation(ones, ones, ones), *places]
    return turned([errors_at(design, RATE_HZ, whole) for design in DESIGNS])


def one_sided(size: float, rate_hz: float = RATE_HZ, places: int = PLACES, seed: int = 0) -> float:
    """Share of the floors on which the PID alone is the best use at every place, or at none."""
    alone = best_shares(size, rate_hz, places, seed)[0]
    return float(np.mean((alone == 0) | (alone == 1)))


def statements(rate_hz: float = RATE_HZ, places: int = PLACES, seed: int = 0) -> dict[str, float]:
    """The values of the page, by the ledger's names."""
    quiet = [FLOORS.index(name) for name in ("VC-F", "VC-G", "LIGO ground")]
    how = (rate_hz, places, seed)
    return {
        "budget.robust.unstable": max(lost(*how).values()) / (places + CORNERS),
        "budget.robust.turns": float(np.mean(turned(nominal_and_box(0.1, *how)))),
        "budget.robust.observer-or-none": min(one_sided(0.05, *how), one_sided(0.1, *how)),
        "budget.robust.nothing-on-quiet": float(
            np.mean([best_shares(size, *how)[0][quiet] for size in SIZES])
        ),
    }


def robust_study(control_rate: float, *, seed: int) -> dict[str, float]:
    """The statements at another rate, elsewhere in the box."""
    return statements(control_rate, PLACES, seed)


def apart(size: float) -> tuple[float, float]:
    """Error with MC and AD over that with AD alone, less 1: least and largest on the loud floors, over the box."""
    alone, both = (nominal_and_box(size)[DESIGNS.index(name)] for name in ("AD", "MC and AD"))
    ratios = (both / alone - 1)[:, [FLOORS.index(name) for name in LOUD]]
    return float(np.nanmin(ratios)), float(np.nanmax(ratios))


def sense_of(least: float, most: float) -> str:
    """In words, whether errors that are so much larger are level."""
    if -LEVEL <= least and most <= LEVEL:
        return "level"
    return "level or behind" if -LEVEL <= least <= LEVEL else "behind" if least > LEVEL else "level or ahead"


def best_at_nominal() -> dict[str, str]:
    """By floor, the use that leaves least at the nominal stage."""
    first = np.argmin([errors[0] for errors in nominal_and_box(SIZES[0])], axis=0)
    return {name: DESIGNS[k] for name, k in zip(FLOORS, first, strict=True)}


def lost(rate_hz: float = RATE_HZ, places: int = PLACES, seed: int = 0) -> dict[float, int]:
    """By size of the box, at how many of its places and corners AD alone is unstable."""
    found = {size: boxed("AD", size, rate_hz, places, seed) for size in SIZES}
    return {size: int(np.isnan(errors).any(axis=1).sum()) for size, errors in found.items()}


def unstable_at_nominal(rate_hz: float) -> bool:
    """Whether AD alone is unstable at the nominal stage with controllers of this rate."""
    ones = np.ones(len(stage().frequencies))
    return bool(np.isnan(errors_at("AD", rate_hz, [Perturbation(ones, ones, ones)])).any())


def best_where_lost(size: float) -> str:
    """The uses that err least on the loud floors at the places and corners of the box where AD alone is unstable."""
    errors = [boxed(design, size) for design in DESIGNS]
    gone = np.isnan(errors[DESIGNS.index("AD")]).any(axis=1)
    best = _best(errors)[np.ix_(gone, [FLOORS.index(name) for name in LOUD])]
    return " or ".join(DESIGNS[k] for k in np.unique(best))


def in_nanometres(size: float):
    """A row a floor: each design's error at the nominal stage and, behind it, its range over the box, nm."""
    from pandas import DataFrame

    columns = {}
    for design, errors in zip(DESIGNS, nominal_and_box(size), strict=True):
        low, high = 1e9 * np.nanmin(errors, axis=0), 1e9 * np.nanmax(errors, axis=0)
        columns[design] = [
            f"{1e9 * own:.3g} ({a:.3g} to {b:.3g})" for own, a, b in zip(errors[0], low, high, strict=True)
        ]
    return DataFrame(columns, index=list(FLOORS))


def paint_box(size: float):
    """Error of each design over the least at the same place, by floor: the nominal stage, and places and corners of the box."""
    figure, axes = figures.new(height=3.4)
    pairs = zip(DESIGNS, nominal_and_box(size), strict=True)
    whole = 1 + margins([np.vstack([errors[:1], boxed(design, size)]) for design, errors in pairs])
    gone = np.isinf(whole).any(axis=(0, 2))
    whole[np.isinf(whole)] = np.nan
    colours, marks = (figures.GREY, figures.ORANGE, figures.BLUE, figures.GREEN), "sD^o"
    floors = np.arange(len(FLOORS))
    for k, (design, colour, mark) in enumerate(zip(DESIGNS, colours, marks, strict=True)):
        at, stable = floors + 0.2 * (k - 1.5), whole[k, ~gone]
        axes.vlines(at, stable.min(axis=0), stable.max(axis=0), color=colour, linewidth=3, alpha=0.5)
        axes.plot(at, whole[k, 0], mark, color=colour, markersize=4.5, linestyle="none", label=design)
        axes.plot(at, whole[k, gone].T, "x", color=colour, markersize=5, label=f"{design}, another unstable")
    if gone.any():
        label = f"stable ones, where another\nis not ({gone.sum()} of {len(gone) - 1} places)"
        axes.plot([], [], "kx", markersize=5, label=label)
    axes.axhspan(
        1.0, 1 + LEVEL, color=figures.GREY, alpha=0.25, linewidth=0, label=f"level, within {100 * LEVEL:g} %"
    )
    axes.set_xticks(floors, [name.split()[0] for name in FLOORS])
    axes.set_yscale("log")
    axes.set_yticks([1, 1.5, 2, 3, 4], ["1", "1.5", "2", "3", "4"])
    axes.minorticks_off()
    axes.set(
        ylabel="error over the least\nat the same place",
        xlabel=f"floor (mark: nominal stage; bar: places of the box of {100 * size:g} % where all are stable)",
        xlim=(-0.6, len(FLOORS) - 0.4),
    )
    shown = [each for each in axes.get_legend_handles_labels()[0] if "another unst" not in each.get_label()]
    axes.legend(handles=shown, loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return figure
