"""Robust: the waterfall at places all over the box of the stage's numbers, and which ranking changes there."""

from dataclasses import replace
from functools import cache

import numpy as np

from experiments.budget.machine import FLOORS, machine, on_every_floor, stage
from stillwork.control.error_budget import box_band, box_places
from stillwork.control.floor_machine import FloorMachine
from stillwork.control.uncertainty import Perturbation, Uncertainty, corners, perturbed_plant
from workbook import figures

DESIGNS = ("PID", "MC", "AD", "MC and AD")
SIZES = (0.05, 0.1, 0.2)  # shares of each frequency, of mass and gain; see `box`
PLACES = 8
RATE_HZ = 2e4  # of the controllers, designed for a delay of one sample; at 10 kHz AD is unstable with it
PARTS = ("frequency", "damping", "gain", "mass", "delay")


def box(size: float, rate_hz: float, parts: tuple[str, ...] = PARTS) -> Uncertainty:
    """Frequencies, gain and mass off by `size`, damping by ten times as much, the delay by five samples times it."""
    whole = {part: size for part in PARTS} | {"damping": min(10 * size, 0.9), "delay": 5 * size / rate_hz}
    return Uncertainty(**{part: whole[part] for part in parts})


def elsewhere(design: str, rate_hz: float, place: Perturbation) -> FloorMachine:
    """The machine at a place of the box; controller and observer stay those of the nominal stage and one sample."""
    built = machine(design, skyhook=True, feedforward=True, sample_time=1 / rate_hz, delay=1.0)
    return replace(built, stage=perturbed_plant(stage(), place), delay=max(1.0 + place.delay * rate_hz, 0.0))


def errors_at(design: str, rate_hz: float, places: list[Perturbation]) -> tuple[np.ndarray, int]:
    """Rms on every floor, (places, floors) in m with NaN where unstable, and at how many places it is."""

    def rms(place: Perturbation) -> np.ndarray:
        by_floor, others = on_every_floor(elsewhere(design, rate_hz, place))
        return np.sqrt(by_floor + others.sum())

    band = box_band(rms, places)
    return np.broadcast_to(band.rms.reshape(len(places), -1), (len(places), len(FLOORS))), band.unstable


@cache
def boxed(
    design: str, size: float, rate_hz: float = RATE_HZ, places: int = PLACES, seed: int = 0
) -> tuple[np.ndarray, int]:
    """`errors_at` at places that fill the box."""
    return errors_at(design, rate_hz, box_places(box(size, rate_hz), stage(), places, seed))


@cache
def best_shares(size: float, rate_hz: float = RATE_HZ, places: int = PLACES, seed: int = 0) -> np.ndarray:
    """Share of the places at which each design errs least among the stable ones, (designs, floors)."""
    best = _best([boxed(design, size, rate_hz, places, seed)[0] for design in DESIGNS])
    return np.array([(best == k).mean(axis=0) for k in range(len(DESIGNS))])


def _best(errors: list[np.ndarray]) -> np.ndarray:
    return np.argmin(np.where(np.isnan(errors), np.inf, errors), axis=0)


@cache
def turned_by(part: str, size: float) -> np.ndarray:
    """Floors on which the best use is another at either end of one part of the box than at the nominal stage."""
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
    best = _best(
        [errors_at(design, RATE_HZ, [Perturbation(ones, ones, ones), *places])[0] for design in DESIGNS]
    )
    return (best[1:] != best[0]).any(axis=0)


def one_sided(size: float, rate_hz: float = RATE_HZ, places: int = PLACES, seed: int = 0) -> float:
    """Share of the floors on which the PID alone is the best use at every place, or at none."""
    alone = best_shares(size, rate_hz, places, seed)[0]
    return float(np.mean((alone == 0) | (alone == 1)))


def statements(rate_hz: float = RATE_HZ, places: int = PLACES, seed: int = 0) -> dict[str, float]:
    """The values of the page, by the ledger's names."""
    quiet = [FLOORS.index(name) for name in ("VC-F", "VC-G", "LIGO ground")]
    how = (rate_hz, places, seed)
    return {
        "budget.robust.unstable": boxed("MC and AD", 0.2, *how)[1] / places,
        "budget.robust.turns": float(np.mean(best_shares(0.1, *how).max(axis=0) < 1)),
        "budget.robust.observer-or-none": min(one_sided(0.05, *how), one_sided(0.1, *how)),
        "budget.robust.nothing-on-quiet": float(
            np.mean([best_shares(size, *how)[0][quiet] for size in SIZES])
        ),
    }


def robust_study(control_rate: float, *, seed: int) -> dict[str, float]:
    """The statements at another rate, elsewhere in the box."""
    return statements(control_rate, PLACES, seed)


def paint_box(size: float):
    """Error of each design at each place, on three floors; numbers above: unstable places."""
    shown = ("VC-A", "VC-C", "LIGO ground")
    figure, axes = figures.new(1, len(shown), height=3.0)
    for panel, name in zip(axes, shown, strict=True):
        column = FLOORS.index(name)
        for k, design in enumerate(DESIGNS):
            errors, unstable = boxed(design, size)
            good = 1e9 * errors[~np.isnan(errors[:, 0]), column]
            panel.semilogy(np.full(len(good), k), good, "o", markersize=3, color=figures.BLUE)
            panel.annotate(
                f"{unstable}",
                (k, 0.97),
                xycoords=("data", "axes fraction"),
                ha="center",
                va="top",
                fontsize=7,
            )
        panel.set_xticks(range(len(DESIGNS)), DESIGNS, fontsize=7)
        panel.set(
            title=name,
            xlabel="use of the observer\n(above: unstable places)",
            xlim=(-0.5, len(DESIGNS) - 0.5),
        )
        panel.margins(y=0.25)
        for axis in (panel.yaxis.set_major_formatter, panel.yaxis.set_minor_formatter):
            axis("{x:.0f}")
    figures.label(axes, y="error, rms (nm)")
    return figure
