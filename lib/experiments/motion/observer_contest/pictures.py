"""Figures of the observer contest, from its table."""

from functools import cache

import numpy as np
import pandas as pd

from experiments.motion.observer_contest.entrants import ENTRANTS
from experiments.motion.observer_contest.noise_map import MAPPED, flexible_errors
from experiments.motion.observer_contest.plants import sample_plant
from experiments.motion.observer_contest.told import OwnObserver
from experiments.motion.observer_contest.tuning import settings_for
from stillwork.workbook import figures

COLOURS = dict(zip(MAPPED, (figures.RED, figures.BLUE, figures.GREEN, figures.ORANGE), strict=True))


def paint_leaderboard(ranked: pd.DataFrame):
    """Mean error of every entrant with its interval, the best on top; `ranked` holds the rows of the score."""
    figure, axis = figures.new(1, 1, height=3.8)
    places = np.arange(len(ranked))
    ends = [ranked["median"] - ranked["low"], ranked["high"] - ranked["median"]]
    axis.errorbar(
        ranked["median"],
        places,
        xerr=ends,
        fmt="o",
        color=figures.BLUE,
        capsize=3,
        markersize=4,
        label="mean error",
    )
    axis.set_yticks(places, ranked["entrant"])
    axis.axvline(1, color=figures.BLACK, linewidth=0.8)
    axis.axvspan(0.9, 1.1, color=figures.GREY, alpha=0.2)
    axis.set_xlabel("error of the flexible states over that of the estimate zero (grey: says nothing)")
    axis.invert_yaxis()
    return figure


def paint_matrix(table: pd.DataFrame, over: str):
    """Errors of the entrants, one row each, over plants or doubts."""
    figure, axis = figures.new(1, 1, height=4.6)
    columns, rows = np.arange(table.shape[1]), np.arange(table.shape[0])
    mesh = axis.pcolormesh(columns, rows, np.clip(table.to_numpy(), 0, 2), cmap="coolwarm", vmin=0, vmax=2)
    axis.set_xticks(columns, table.columns, rotation=60, ha="right")
    axis.set_yticks(rows, table.index)
    axis.invert_yaxis()
    axis.set_xlabel(over)
    axis.set_ylabel("observer")
    figure.colorbar(mesh, ax=axis, label="error over that of zero")
    return figure


def paint_cost(speed: pd.Series, error: pd.Series, unstable: pd.Series):
    """Error over time a sample; the larger the dot, the more loops ran away."""
    figure, axis = figures.new(1, 1, height=3.6)
    for name in error.index:
        axis.semilogx(
            speed[name],
            error[name],
            "o",
            markersize=3 + 14 * unstable[name],
            color=figures.BLUE,
            alpha=0.6,
            label=name,
        )
        axis.annotate(name, (speed[name], error[name]), fontsize=6, xytext=(3, 3), textcoords="offset points")
    axis.set_xlabel("time a sample (µs)")
    axis.set_ylabel("mean error over that of zero")
    return figure


@cache
def _stage():
    return sample_plant("stage", np.random.default_rng(0))


def paint_cell(size_percent: float, noise_exponent: float):
    """Explorer: errors of four observers, with the contest's settings, on eight scans of one cell of the map."""
    settings = settings_for("stage")
    observers = {name: OwnObserver(ENTRANTS[name], tuple(settings[name])) for name in MAPPED}
    errors = flexible_errors(_stage(), size_percent / 100, 10.0**noise_exponent, "explorer", 8, observers)
    figure, axis = figures.new(1, 1, height=2.8)
    for place, name in enumerate(MAPPED):
        axis.semilogx(
            errors[name], np.full(8, place), "o", color=COLOURS[name], markersize=5, alpha=0.6, label=name
        )
    axis.axvline(1, color=figures.BLACK, linewidth=0.8)
    axis.set_yticks(range(len(MAPPED)), MAPPED)
    axis.set_xlabel("error of the flexible states over that of the estimate zero")
    return figure
