"""Robust: the waterfall at places all over the box of the stage's numbers, and which ranking turns there."""

from dataclasses import replace
from functools import cache

import numpy as np

from experiments.budget.machine import BAND_HZ, FLOORS, floor, machine, noises, stage
from stillwork.control.error_budget import box_band, box_places, error_budget
from stillwork.control.uncertainty import Uncertainty, perturbed_plant
from workbook import figures

DESIGNS = ("PID", "MC", "AD", "MC and AD")
SIZES = (0.05, 0.1, 0.2)  # shares of each frequency and of the gain; damping ten times as much, mass alike
PLACES = 8


@cache
def boxed(design: str, size: float) -> tuple[np.ndarray, int]:
    """Rms on every floor at each stable place of the box, (places, floors) in m with NaN where unstable, and how many are.

    Skyhook and feedforward are on; the controller and its observer stay those of the nominal stage.
    """
    built = machine(design, skyhook=True, feedforward=True)
    box = Uncertainty(frequency=size, gain=size, damping=min(10 * size, 0.9), mass=size)

    def rms(place):
        network = replace(built, stage=perturbed_plant(stage(), place)).network()
        powers = error_budget(network, [*map(floor, FLOORS), *noises()], BAND_HZ).powers[:, 0]
        return np.sqrt(powers[: len(FLOORS)] + powers[len(FLOORS) :].sum())

    band = box_band(rms, box_places(box, stage(), PLACES))
    return band.rms.reshape(PLACES, -1), band.unstable


def best_shares(size: float) -> np.ndarray:
    """Share of the places at which each design errs least among the stable ones, (designs, floors)."""
    errors = np.array([boxed(design, size)[0] for design in DESIGNS])
    best = np.nanargmin(np.where(np.isnan(errors), np.inf, errors), axis=0)
    return np.array([(best == k).mean(axis=0) for k in range(len(DESIGNS))])


def one_sided(size: float) -> float:
    """Share of the floors on which the PID alone is the best use at every place, or at none."""
    alone = best_shares(size)[0]
    return float(np.mean((alone == 0) | (alone == 1)))


def paint_box(size: float):
    """Error of each design at each place, on three floors; crosses above: unstable places."""
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
        panel.set(title=name, xlabel="use of the observer", xlim=(-0.5, len(DESIGNS) - 0.5))
        panel.margins(y=0.25)
    figures.label(axes, y="error, rms (nm)")
    return figure
