"""Figure of one rig for the whole paper (notebook 05)."""

from collections.abc import Mapping

import numpy as np

from experiments.isolation.performance import DIRECTIONS, ENTRIES
from workbook import figures

_BANDS = {
    "seen": ("all numbers seen", figures.BLUE, -0.17),
    "held_out": ("this one held out", figures.ORANGE, 0.17),
}
_WEIGHTS = [f"w{k}" for k in range(1, 10)]
_PANELS = [
    ("table-1.felms.tau-", _WEIGHTS, _WEIGHTS, "FeLMS", "time to stay within 63 % (s)"),
    ("table-1.ferls.tau-", _WEIGHTS, _WEIGHTS, "FeRLS", "time (s)"),
    ("fig-8.removed.", ENTRIES, DIRECTIONS, "Fig. 8", "power removed (%)"),
    ("table-1.felms.final-", _WEIGHTS, _WEIGHTS, "", "final value (N per m/s²)"),
    ("table-1.ferls.final-", _WEIGHTS, _WEIGHTS, "", "final value (N per m/s²)"),
    (
        "fig-7.",
        ["low-frequency-loss", "lower-end", "upper-end"],
        ["0 dB", "20 dB", "to 20 dB"],
        "Fig. 7",
        "frequency (Hz)",
    ),
]


def paint_one_rig(found: Mapping[str, Mapping[str, tuple[float, float]]], printed: Mapping[str, float]):
    """95 % predictive bands of every printed number, with the numbers: Table 1 on the left, Figs. 8 and 7 on the right."""
    figure, axes = figures.new(2, 3, height=5.4)
    for panel, (first, names, labels, title, unit) in zip(axes.flat, _PANELS, strict=True):
        for kind, (label, color, shift) in _BANDS.items():
            bands = [
                (k + shift, *found[first + name][kind])
                for k, name in enumerate(names)
                if kind in found.get(first + name, {})
            ]
            if bands:
                x, low, high = np.transpose(bands)
                panel.vlines(x, low, high, color=color, lw=3, alpha=0.6, label=label)
                # Some bands are a point.
                panel.plot(x, (low + high) / 2, "o", ms=3, color=color, label=f"{label}, middle")
        known = [(k, printed[first + name]) for k, name in enumerate(names) if first + name in printed]
        figures.mark_published(panel, *zip(*known, strict=True))
        panel.set_xticks(range(len(names)), labels)
        panel.set(title=title, ylabel=unit)
        if "tau" in first or first == "fig-7.":
            panel.set_yscale("log")
        elif "final" in first:
            panel.set_yscale("symlog", linthresh=0.1)
    figures.label(axes, "number")
    figures.legend_below(axes[0, 0], 3)
    return figure
