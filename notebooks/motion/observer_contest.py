"""Figures of the observer contest, from its two tables."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import pandas as pd
from scipy.optimize import isotonic_regression

from contest.noise_map import (
    MAPPED,
    NOISES,
    ROBUST,
    SAYING,
    ahead_of,
    crossings,
    flexible_errors,
    leads,
)
from contest.nominal import OwnObserver
from contest.plants import plant_of
from contest.scores import ENTRANTS
from contest.tuning import settings_for
from workbook import figures

INKS = figures.RED, figures.BLUE, figures.GREEN, figures.PURPLE
COLOURS = dict(zip(MAPPED, INKS, strict=True))


def paint_leaderboard(ranks: pd.DataFrame, critical: float):
    """Mean rank of every entrant with its interval, the best on top; grey: within Nemenyi's difference of the best."""
    figure, axis = figures.new(1, 1, height=3.8)
    ends = [ranks["rank"] - ranks["low"], ranks["high"] - ranks["rank"]]
    style = {"fmt": "o", "color": figures.BLUE, "capsize": 3, "markersize": 4, "label": "mean rank, 95 %"}
    axis.errorbar(ranks["rank"], range(len(ranks)), xerr=ends, **style)
    axis.set_yticks(range(len(ranks)), ranks.index)
    shade = {"color": figures.GREY, "alpha": 0.2, "label": "not proven worse than the best"}
    axis.axvspan(ranks["rank"].min(), ranks["rank"].min() + critical, **shade)
    axis.set_xlabel("mean rank over machines (1: best)")
    axis.legend(loc="upper right", fontsize=7)
    axis.invert_yaxis()
    return figure


def _name_rows(axis, observers: Sequence[str], remark: str = "") -> None:
    axis.set_yticks(range(len(observers)), observers)
    axis.axvline(1, color=figures.BLACK, linewidth=0.8)
    axis.set_xlabel(f"error of the flexible states over that of the estimate zero{remark}")


def paint_matrix(table: pd.DataFrame, over: str):
    """Errors of the entrants, one row each, over machines or uncertainties; beyond twice that of zero the number stands in the cell."""
    figure, axis = figures.new(1, 1, height=4.6)
    columns, rows = np.arange(table.shape[1]), np.arange(table.shape[0])
    mesh = axis.pcolormesh(columns, rows, np.clip(table.to_numpy(), 0, 2), cmap="coolwarm", vmin=0, vmax=2)
    axis.set_xticks(columns, table.columns, rotation=60, ha="right")
    axis.set_yticks(rows, table.index)
    axis.invert_yaxis()
    for row, column in np.argwhere(table.to_numpy() > 2):
        value = f"{table.iloc[row, column]:.0f}"
        axis.text(column, row, value, color="white", ha="center", va="center", fontsize=5)
    axis.set(xlabel=over, ylabel="observer")
    figure.colorbar(mesh, ax=axis, label="error over that of zero", extend="max")
    return figure


def paint_cost(speed: pd.Series, error: pd.Series, unstable: pd.Series):
    """Error over time a sample, that of the Kalman filter being 1; the larger the dot, the more loops were unstable."""
    figure, axis = figures.new(1, 1, height=3.6)
    error = error.sort_values()
    arrow = {"arrowstyle": "-", "color": figures.GREY, "lw": 0.4, "alpha": 0.6, "shrinkA": 1}
    arrow["relpos"] = (0, 0.5)  # to the name's left end
    style = {"textcoords": ("axes fraction", "data"), "va": "center", "fontsize": 7, "arrowprops": arrow}
    apart = 0.04 * np.arange(len(error))  # names in a column, each as near its dot as the others let it
    places = isotonic_regression(error - apart).x + apart
    dot = {"color": figures.BLUE, "alpha": 0.6, "linestyle": "none", "marker": "o"}
    for name, place in zip(error.index, places, strict=True):
        at, size = (speed[name], error[name]), 3 + 14 * unstable[name]
        axis.semilogx(*at, markersize=size, label=name, **dot)
        axis.annotate(name, at, xytext=(1.04, place), **style)
    sizes = {f"{percent} % unstable": 3 + 0.14 * percent for percent in (0, 30, 90)}
    handles = [axis.plot([], [], markersize=size, label=name, **dot)[0] for name, size in sizes.items()]
    corner = {"loc": "upper right", "bbox_to_anchor": (1, 0.97)}
    axis.legend(handles=handles, fontsize=7, labelspacing=1, **corner)
    axis.set_ylim(places[0] - 0.03, places[-1] + 0.03)
    axis.set(xlabel="time a sample over that of the Kalman filter", ylabel="mean error over that of zero")
    return figure


def paint_noise(errors: pd.DataFrame, size: float):
    """Median errors with quartiles over the sensor's noise, for errors of one size."""
    figure, axis = figures.new(1, 1, height=3.2)
    one = errors[np.isclose(errors["size"], size)]
    for name in MAPPED:
        quartiles = one.groupby("noise")[name].quantile([0.25, 0.5, 0.75]).unstack()
        style = {"color": COLOURS[name], "markersize": 3, "label": name}
        style["linewidth"] = 4 if name == "Kalman" else 1.2  # others lie on it at much noise
        axis.semilogx(quartiles.index, quartiles[0.5], "o-", **style)
        axis.fill_between(quartiles.index, quartiles[0.25], quartiles[0.75], color=COLOURS[name], alpha=0.12)
    axis.axhline(1, color=figures.BLACK, linewidth=0.8, label="estimate zero")
    axis.fill_between([], [], color=figures.GREY, alpha=0.3, label="bands: quartiles")
    axis.set(xlabel="sensor's noise over the thesis's", ylabel="error over that of zero", ylim=(0, 1.5))
    figures.legend_below(axis, 3)
    return figure


def paint_leads(errors: pd.DataFrame, over: tuple[str, ...]):
    """Leads of the robust observers, a column each, over these Kalman filters; a dot where a lead is sure and the error below 0.9.

    The line is where a lead begins, the dashed one where the observer's error comes within a tenth of zero's, each with its interval.
    """
    figure, axes = figures.new(len(over), len(ROBUST), height=4.6, sharex=True, sharey=True)
    silent = {name: crossings(errors, ahead_of(SAYING, name)) for name in ROBUST}
    for row, rival in zip(axes, over, strict=True):
        found = leads(errors, rival)
        for axis, name in zip(row, ROBUST, strict=True):
            own = found[found["entrant"] == name].pivot(index="size", columns="noise")
            lead, sure = own["lead"], (own["low"] > 0) & (own["error at most"] < SAYING)
            columns, rows = np.arange(lead.shape[1]), np.arange(lead.shape[0])
            mesh = axis.pcolormesh(columns, rows, lead.to_numpy(), cmap="coolwarm_r", vmin=-0.2, vmax=0.2)
            down, across = np.nonzero(sure.to_numpy())
            axis.plot(
                across,
                down,
                "o",
                color=figures.BLACK,
                markersize=3,
                label="surely ahead, and better than zero",
            )
            for line, style, label in (
                (crossings(errors, ahead_of(name, rival)), "-", "ahead from here on"),
                (silent[name], "--", "no better than zero from here on"),
            ):
                inside = line["crosses"].to_numpy() > 0.5
                low, at, high = (
                    np.interp(np.log(line[end].clip(NOISES[0], NOISES[-1])), np.log(NOISES), columns)[inside]
                    for end in ("low", "noise", "high")
                )
                bars = {"xerr": [at - low, high - at], "fmt": f"|{style}", "color": figures.GREEN}
                axis.errorbar(at, rows[inside], **bars, label=label)
            axis.set_xticks(columns, [f"{noise:g}" for noise in lead.columns])
            axis.set_yticks(rows, [f"{100 * size:g}" for size in lead.index])
            axis.set_title(f"{name} over {rival}", fontsize=8)
    figures.label(axes, "sensor's noise over the thesis's", "size of the errors (%)")
    figures.legend_below(axes[-1, 0], 3)
    figure.colorbar(mesh, ax=axes, label="lead (of errors over that of zero)", extend="max")
    return figure


@lru_cache(maxsize=1)
def _map_observers() -> dict[str, OwnObserver]:
    """Observers of the map with the contest's settings on the stage."""
    settings = settings_for("stage", 0, MAPPED)
    return {name: OwnObserver(ENTRANTS[name], tuple(settings[name])) for name in MAPPED}


def paint_cell(size_percent: float, noise_exponent: float):
    """Explorer: errors of the map's observers, with the contest's settings, on eight scans of one cell of the map."""
    observers = _map_observers()
    errors = flexible_errors(
        plant_of("stage"), size_percent / 100, 10.0**noise_exponent, "explorer", range(8), observers
    )
    figure, axis = figures.new(1, 1, height=2.8)
    for place, name in enumerate(MAPPED):
        style = {"color": COLOURS[name], "markersize": 5, "alpha": 0.6, "label": name}
        axis.semilogx(errors[name], np.full(8, place), "o", **style)
    _name_rows(axis, MAPPED)
    return figure


def paint_record(table: pd.DataFrame):
    """Errors on the measured record, a panel a task: medians over the pairs of releases, with the least and the largest."""
    tasks, parts = table["task"].unique(), table["part"].unique()
    names = table.groupby("entrant")["error"].median().sort_values(kind="stable").index
    figure, axes = figures.new(1, len(tasks), height=4.0, sharex=True, sharey=True)
    for axis, task in zip(axes.ravel(), tasks, strict=True):
        for shift, (part, colour) in enumerate(zip(parts, INKS, strict=False)):
            some = table[(table["task"] == task) & (table["part"] == part)].groupby("entrant")["error"]
            middle, low, high = (each.loc[names] for each in (some.median(), some.min(), some.max()))
            style = {"fmt": "o", "color": colour, "markersize": 4, "label": part}
            axis.errorbar(
                middle, np.arange(len(names)) + 0.3 * shift, xerr=[middle - low, high - middle], **style
            )
        axis.set_xscale("log")
        axis.set_title(task, fontsize=8)
        axis.axvline(1, color=figures.BLACK, linewidth=0.8, label="estimate zero")
    axes.ravel()[0].set_yticks(range(len(names)), names)
    axes.ravel()[0].invert_yaxis()
    figures.label(axes, "error over that of zero", "")
    figures.legend_below(axes.ravel()[0], 3)
    return figure
