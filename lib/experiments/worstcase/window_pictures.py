"""Picture of the training windows, of the measured case and of a record of one's own."""

import numpy as np

from experiments.worstcase.measured import METHODS
from workbook import figures


def paint_windows(
    lengths: list[float], found: dict[str, list[np.ndarray]], label: str = "training window (samples)"
):
    """Out-of-sample residual against the length of the training window, or what `label` says; bars are quartiles."""
    figure, axes = figures.new(height=3.6)
    for number, (name, colour, style) in enumerate(METHODS):
        low, middle, high = np.transpose([np.quantile(values, (0.25, 0.5, 0.75)) for values in found[name]])
        if middle.min() > 1.6:
            name += " (above the frame)"
        places = np.array(lengths) * 1.03 ** (number - 2)  # side by side
        look = {"yerr": [middle - low, high - middle], "fmt": style, "markersize": 4, "color": colour}
        axes.errorbar(places, middle, label=name, capsize=2, **look)
    axes.axhline(1, color=figures.GREY, linewidth=0.8)
    axes.set(xscale="log", xlabel=label, ylabel="rms residual / rms output")
    axes.set(ylim=(0.4, 1.6))
    axes.legend(ncols=2)
    return figure
