"""Pictures of the comparison of estimators: the map of who wins, its intervals, one setting of one's own."""

import numpy as np

from experiments.worstcase.comparison import EXCITATIONS, METHODS, Setting, among_best, compare, over_best
from workbook import figures
from workbook.studies import mean_interval

AGAINST = (
    ("min_max", figures.BLUE),
    ("bayes", figures.GREEN),
    ("total", figures.RED),
    ("hinfinity", figures.PURPLE),
)


def paint_map(names: list[str], errors: np.ndarray):
    """Error over that of the best in its row, one panel an excitation; a dot where it is level with the best."""
    figure, panels = figures.new(1, len(EXCITATIONS), height=5.4, sharey=True)
    behind, best = np.log2(over_best(errors)), among_best(errors)
    columns, rows = np.arange(len(METHODS)), np.arange(len(names))
    for number, (axes, title) in enumerate(zip(panels, EXCITATIONS, strict=True)):
        shades = {"cmap": "Reds", "vmin": 0, "vmax": 3, "shading": "nearest"}
        mesh = axes.pcolormesh(columns, rows, behind[:, number], **shades)
        level = np.nonzero(best[:, number])[::-1]
        axes.plot(*level, "o", markersize=4, color=figures.BLACK, label="level with the best")
        axes.set_title(title)
        axes.set_xticks(columns, METHODS.values(), rotation=90)
    panels[0].set_yticks(rows, names)
    panels[0].set_ylim(len(names) - 0.5, -0.5)
    figures.label(panels, y="what is wrong with the record")
    bar = figure.colorbar(mesh, ax=panels, label="error over that of the best", extend="max", ticks=range(4))
    bar.ax.set_yticklabels(["1", "2", "4", "8"])
    return figure


def paint_ratios(names: list[str], errors: np.ndarray):
    """Error over that of least squares, geometric mean over runs with its 95 % interval, one panel an excitation."""
    figure, panels = figures.new(1, len(EXCITATIONS), height=5.4, sharey=True, sharex=True)
    logs, order = np.log(errors), list(METHODS)
    ratios = logs - logs[..., order.index("least"), None]
    for number, (axes, title) in enumerate(zip(panels, EXCITATIONS, strict=True)):
        for place, (method, colour) in enumerate(AGAINST):
            rows = np.arange(len(names)) + 0.2 * (place - 1.5)
            style = {"markersize": 3, "color": colour, "label": METHODS[method]}
            _paint_geometric_means(axes, ratios[:, number, :, order.index(method)], rows, **style)
        axes.axvline(1, color=figures.BLACK, linestyle="--", linewidth=1)
        axes.set(xscale="log", xlim=(0.2, 8), title=title)
        axes.set_xticks([0.25, 0.5, 1, 2, 4], ["1/4", "1/2", "1", "2", "4"])
        axes.minorticks_off()
    panels[0].set_yticks(np.arange(len(names)), names)
    panels[0].set_ylim(len(names) - 0.5, -0.5)
    figures.label(panels, "over least squares")
    figures.legend_below(panels[0], len(AGAINST))
    return figure


def _paint_geometric_means(axes, logs: np.ndarray, rows: np.ndarray, **style):
    """Of the runs in every row of `logs`, with their 95 % intervals."""
    mean, ends = np.exp(logs.mean(axis=1)), np.exp([mean_interval(each) for each in logs]).T
    axes.errorbar(mean, rows, xerr=np.abs(ends - mean), fmt="o", **style)


def explore_comparison(input_noise: float, output_noise: float, gain: float, delay: float, taps: int):
    """Errors of all methods in a setting of one's own, with the 95 % interval of their geometric mean."""
    setting = {"yours": Setting(input_noise, output_noise, gain, delay)}
    errors = compare(setting, 20, 1, int(taps), 200, 0.98)["errors"][0]
    figure, axes = figures.new(height=3.6)
    colours = (figures.BLACK, figures.GREEN, figures.BLUE, figures.RED)
    for number, (name, colour) in enumerate(zip(EXCITATIONS, colours, strict=True)):
        rows = np.arange(len(METHODS)) + 0.2 * (number - 1.5)
        _paint_geometric_means(axes, np.log(errors[number]).T, rows, markersize=4, color=colour, label=name)
    axes.set_yticks(np.arange(len(METHODS)), METHODS.values())
    axes.axvline(1, color=figures.GREY, linestyle=":", label="the estimate zero")
    axes.set(xscale="log", xlabel="|x − estimate| over |x|")
    axes.xaxis.set_minor_formatter("{x:g}")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.invert_yaxis()
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), title="excitation")
    return figure
