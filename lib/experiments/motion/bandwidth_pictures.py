"""The published bandwidths as a table and as a map over what the thesis leaves open (notebook 09)."""

from collections.abc import Mapping, Sequence

import numpy as np

from stillwork.control.bandwidth import Bandwidth
from workbook import figures


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


def paint_map(crossing_hz: np.ndarray, selectivity: Sequence, noise_model: Sequence, best: tuple):
    """A `bandwidth_map`, each cell as wide as the other; `best` is a printed place (Q_nu, Q) and what it says."""
    figure, axis = figures.new(1, 1, height=3.4)
    mesh = axis.pcolormesh(_edges(noise_model), _edges(selectivity), crossing_hz, cmap="viridis")
    figure.colorbar(mesh, ax=axis, label="first crossing (Hz)")
    axis.set(xscale="log", yscale="log", xlabel=r"noise model $Q_\nu$ (N²/s)", ylabel="selectivity $Q$")
    figures.mark_published(axis, *best[:2], label=best[2], markersize=9, color="white")
    axis.legend(axis.lines, [best[2]], loc="lower left", labelcolor="white")
    return figure


def _edges(centres: Sequence[float]) -> np.ndarray:
    """Edges of cells around ascending positive centres, halfway in logarithms."""
    inner = np.sqrt(np.multiply(centres[1:], centres[:-1]))
    return np.concatenate([[centres[0] ** 2 / inner[0]], inner, [centres[-1] ** 2 / inner[-1]]])
