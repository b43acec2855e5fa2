"""Pictures of combinations: a specification curve of one entry, and a topic's entries by combinations on one page."""

import textwrap
from collections.abc import Iterable

import numpy as np

from stillwork.base.checks import InputError
from workbook import figures
from workbook.choices.judging import Robustness
from workbook.choices.results import Outcomes
from workbook.claims import Entry

AGREES, DIFFERS, HALF, NOTHING = figures.BLUE, figures.ORANGE, "#D0D0D0", "#FFFFFF"
ROW = 0.14  # inches of an option or an entry


def paint_specification_curve(study: Outcomes, standing: Robustness):
    """Values under all combinations, sorted, the published one with its tolerance, and which options were on below.

    Where a study has several seeds, a point's value is their mean and a stroke its range.

    Parameters
    ----------
    study : Outcomes
    standing : Robustness
        Of one entry of the study.

    Raises
    ------
    InputError
        When no combination gave a value.
    """
    entry = standing.entry
    there = np.isfinite(standing.values).any(axis=1)
    if not there.any():
        raise InputError(f"{entry.id} has no value under any combination; there is nothing to draw")
    points = np.flatnonzero(there)
    values = standing.values[points]
    middle = np.nanmean(values, axis=1)
    order = np.argsort(middle, kind="stable")
    points, values, middle = points[order], values[order], middle[order]
    agrees = standing.agrees[points].mean(axis=1) >= 0.5
    touching = {axis.name for axis in standing.axes}
    columns = [(k, axis) for k, axis in enumerate(study.multiverse.axes) if axis.name in touching]
    rows = sum(len(axis.options) for _, axis in columns)
    height = ROW * rows + 0.12 * len(columns)
    figure, (above, below) = figures.new(
        2, height=2.9 + height, sharex=True, gridspec_kw={"height_ratios": [2.2, max(height, ROW)]}
    )
    rank = np.arange(1, len(points) + 1)
    _draw_published(above, entry)
    if values.shape[1] > 1:
        above.vlines(
            rank,
            np.nanmin(values, axis=1),
            np.nanmax(values, axis=1),
            color=figures.GREY,
            linewidth=0.8,
            label="over seeds",
        )
    for one, colour, label in ((agrees, AGREES, "agrees"), (~agrees, DIFFERS, "does not agree")):
        if standing.agree is None:
            one, colour, label = np.full(len(agrees), colour == AGREES), figures.GREY, "not judged"
        if one.any():
            above.plot(
                rank[one], middle[one], linestyle="none", marker="o", markersize=3, color=colour, label=label
            )
    unit = f" ({entry.unit})" if entry.unit not in ("", "1") else ""
    above.set_ylabel(textwrap.fill(textwrap.shorten(entry.quantity, 70) + unit, 30))
    above.set_title(f"{entry.id}\n{_summary(standing)}")
    above.legend(loc="best")
    _draw_options(below, study, columns, points, agrees, standing.agree is not None)
    below.set_xlabel("combinations, by value")
    return figure


def _draw_published(axes, entry: Entry) -> None:
    if entry.published is None:
        return
    tolerance = entry.tolerance
    reach = 0.0
    if tolerance is not None:
        reach = tolerance.absolute or (tolerance.relative or 0.0) * abs(entry.published)
    if reach:
        axes.axhspan(
            entry.published - reach, entry.published + reach, color=figures.GREEN, alpha=0.2, linewidth=0
        )
    axes.axhline(entry.published, color=figures.BLACK, linewidth=1, linestyle="--", label="published")


def _draw_options(axes, study: Outcomes, columns, points, agrees, judged: bool) -> None:
    """One row an option, a mark where it was on; axes apart from each other."""
    rank = np.arange(1, len(points) + 1)
    ticks, labels, row = [], [], 0.0
    for k, axis in columns:
        places = np.array([study.design[point][k] for point in points])
        for option, text in enumerate(axis.texts):
            on = places == option
            for one, colour in ((agrees, AGREES), (~agrees, DIFFERS)):
                shown = on & one
                if shown.any():
                    axes.plot(
                        rank[shown],
                        np.full(shown.sum(), row),
                        linestyle="none",
                        marker="|",
                        markersize=5,
                        color=colour if judged else figures.GREY,
                        label=f"{axis.name} = {text}{', agrees' if judged and one is agrees else ''}",
                    )
            ticks.append(row)
            labels.append(f"{axis.name}: {text[:28]}{' *' if option == axis.default_index else ''}")
            row += 1
        row += 0.8
    axes.set_yticks(ticks, labels)
    axes.set_ylabel("options (* default)")
    axes.set_ylim(max(row, 1) - 0.3, -0.8)
    axes.tick_params(axis="y", labelsize=6)
    axes.grid(False)


def _summary(standing: Robustness) -> str:
    if standing.class_ is None:
        return "not judged"
    text = f"{standing.class_}, agrees in {100 * standing.share:.3g} %"
    return f"{text}; decided by {' and '.join(standing.decided_by)}" if standing.decided_by else text


def paint_topic_choices(topic: str, standings: Iterable[Robustness]):
    """One page a topic: entries below one another, combinations side by side, coloured by whether they agree.

    In a row the combinations are sorted by the share of seeds under which the entry agrees: the colour's width is the
    share. What failed or gave no value is white.

    Parameters
    ----------
    topic : str
    standings : iterable of Robustness
        Those that are judged are drawn.
    """
    from matplotlib.colors import LinearSegmentedColormap

    judged = [standing for standing in standings if standing.class_ is not None]
    if not judged:
        raise InputError(
            f"topic {topic} has no entry that was judged over combinations; run `make choices` first"
        )
    cells = 100
    picture = np.full((len(judged), cells), np.nan)
    for row, standing in enumerate(judged):
        with np.errstate(invalid="ignore"):
            runs = np.where(np.isfinite(standing.values), standing.agrees.astype(float), np.nan)
        known = np.isfinite(runs).any(axis=1)
        share = np.sort(np.nanmean(runs[known], axis=1))[::-1] if known.any() else np.zeros(0)
        share = np.r_[share, np.full(len(known) - len(share), np.nan)]
        picture[row] = share[np.arange(cells) * len(share) // cells]
    figure, axes = figures.new(height=ROW * len(judged) + 1.1)
    colours = LinearSegmentedColormap.from_list("agreement", [DIFFERS, HALF, AGREES]).with_extremes(
        bad=NOTHING
    )
    image = axes.imshow(
        picture,
        aspect="auto",
        cmap=colours,
        vmin=0,
        vmax=1,
        extent=(0, 100, len(judged), 0),
        interpolation="none",
    )
    image.set_label("share of seeds that agree")
    names = [f"{standing.entry.id.partition('.')[2]} ({standing.class_})" for standing in judged]
    axes.set_yticks(np.arange(len(judged)) + 0.5, names)
    axes.set_xlabel("combinations, those that agree first (%)")
    axes.set_ylabel("entries")
    axes.set_title(f"{topic}: blue agrees, orange does not, white gave no value")
    axes.tick_params(axis="y", labelsize=6)
    axes.grid(False)
    return figure
