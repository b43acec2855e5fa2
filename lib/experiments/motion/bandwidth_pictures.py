"""The published bandwidths as a table and as a map over what the thesis leaves open (notebook 09)."""

from collections.abc import Mapping, Sequence

import numpy as np

from experiments.motion.open_choices import BandwidthMap
from stillwork.control.bandwidth import Bandwidth
from stillwork.workbook import figures


def paint_bandwidths(found: Mapping[str, Bandwidth], position: int, published_hz: Sequence[float]):
    """First crossings at one mass with their range over the masses, and the design parameters, beside the published."""
    figure, axis = figures.new(1, 1, height=3.2)
    places, crossings = range(len(found)), np.array([each.crossing_hz for each in found.values()])
    middle = crossings[:, position - 1]
    reach = [middle - crossings.min(axis=1), crossings.max(axis=1) - middle]
    label = f"first crossing, mass {position} and range over masses"
    axis.errorbar(places, middle, yerr=reach, fmt="o", capsize=4, color=figures.BLUE, label=label)
    designs = [each.design_hz for each in found.values()]
    style = {"markersize": 14, "color": figures.RED, "label": "design parameter $f_{bw}$"}
    axis.plot(places, designs, "_", **style)
    figures.mark_published(axis, places, published_hz)
    names = [name.replace(", ", ",\n").replace(" with ", "\nwith ") for name in found]
    axis.set_xticks(places, names, fontsize=7)
    axis.set_ylabel("bandwidth (Hz)")
    axis.legend()
    return figure


def paint_map(chart: BandwidthMap, best: tuple[float, float, str]):
    """First crossings over Q_nu and Q, each cell as wide as the other; `best` is a printed place and what it says."""
    figure, axis = figures.new(1, 1, height=3.4)
    edges = [_edges(chart.noise_model), _edges(chart.selectivity)]
    mesh = axis.pcolormesh(*edges, chart.crossing_hz, cmap="viridis")
    figure.colorbar(mesh, ax=axis, label="first crossing (Hz)")
    axis.set(xscale="log", yscale="log", xlabel=r"noise model $Q_\nu$ (N²/s)", ylabel="selectivity $Q$")
    figures.mark_published(axis, *best[:2], label=best[2], markersize=9, color="white")
    axis.legend(axis.lines, [best[2]], loc="lower left", labelcolor="white")
    return figure


def _edges(centres: np.ndarray) -> np.ndarray:
    """Edges of cells around ascending positive centres, halfway in logarithms."""
    inner = np.sqrt(centres[1:] * centres[:-1])
    return np.concatenate([[centres[0] ** 2 / inner[0]], inner, [centres[-1] ** 2 / inner[-1]]])
