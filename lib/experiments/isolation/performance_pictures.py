"""Figures of transmissibility and power (notebooks 04 and 05)."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from experiments.isolation.floors import flat_floor
from experiments.isolation.performance import DIRECTIONS, exact_transmissibility, expected_density
from experiments.isolation.power import BAND_HZ, reduction_percent
from experiments.isolation.responses import COARSE_HZ, thinned
from experiments.isolation.steady import steady_state
from experiments.isolation.twin import load_twin
from workbook import figures

_STYLES = {
    "passive": {"color": figures.PURPLE},
    "feedback": {"color": figures.BLUE},
    "FeLMS": {"color": figures.GREEN, "ls": "--", "zorder": 3},  # lies on FeRLS
    "FeRLS": {"color": figures.BLACK},
    "output noise": {"color": figures.RED, "ls": ":"},
}
_LOW_DB = -80.0  # where the panels of the diagonal end
PUBLISHED_BAND_HZ = (3.0, 200.0)  # where the paper states 20 to 40 dB
_REDUCTION_STYLES = (
    {"color": figures.SKY, "lw": 0.8},
    {"color": figures.BLACK},
    {"color": figures.GREEN, "ls": "--"},
)
# Below this a transmissibility is rounding: the rig's symmetry makes the element zero.
_ROUNDING = 1e-9


def paint_transmissibility(f: np.ndarray, cases: dict[str, np.ndarray]):
    """Fig. 7: the 3x3 matrix of transmissibilities over Hz, platform direction down, floor direction across."""
    figure, axes = figures.new(3, 3, height=6.6, sharex=True)
    units = np.array([["", " (m/rad)", " (m/rad)"], [" (rad/m)", "", ""], [" (rad/m)", "", ""]])
    for i, to in enumerate(DIRECTIONS):
        for j, start in enumerate(DIRECTIONS):
            panel = axes[i, j]
            # An off-diagonal panel takes its scale from the lengths involved: rad/m is large, m/rad small.
            shift = {"": 0.0, " (m/rad)": -25.0, " (rad/m)": 25.0}[units[i, j]]
            for name, response in cases.items():
                size = np.abs(response[i, j])
                if size.max() > _ROUNDING:
                    # How deep a zero reaches below the panel hangs on the last bits.
                    size = np.maximum(size, 10 ** ((_LOW_DB + shift - 10) / 20))
                    shown = thinned(f, size)
                    decibels = 20 * np.log10(size[shown])
                    panel.semilogx(f[shown], decibels, label=name, lw=0.9, **_STYLES[name])
            if i == j:
                _mark_reduction(panel, f, cases["feedback"][i, i])
            panel.set(title=f"{start} → {to}{units[i, j]}", ylim=(_LOW_DB + shift, 25 + shift))
            panel.set(xlim=(f[0], f[-1]))
    figures.label(axes, "frequency (Hz)", "magnitude (dB)")
    figures.legend_below(axes[0, 0], 5)
    return figure


def _mark_reduction(panel, frequencies_hz: np.ndarray, feedback: np.ndarray):
    """Shade the published 20 to 40 dB below `feedback` alone, taken as its median over a twelfth of a decade."""
    edges = np.geomspace(*PUBLISHED_BAND_HZ, 23)
    decibels = 20 * np.log10(np.abs(feedback))
    inside = [(frequencies_hz >= low) & (frequencies_hz <= high) for low, high in pairwise(edges)]
    level = np.array([np.median(decibels[each]) for each in inside])
    middle = np.sqrt(edges[1:] * edges[:-1])
    style = {"color": figures.GREY, "alpha": 0.25, "lw": 0}
    panel.fill_between(middle, level - 40, level - 20, label="published: 20 to 40 dB less", **style)


def paint_reduction(reductions: dict[str, tuple[np.ndarray, np.ndarray]]):
    """Reduction (dB) of the three diagonal elements by the feedforward, with the published 20 and 40 dB."""
    figure, axes = figures.new(1, 3, height=2.7, sharey=True)
    for k, (panel, direction) in enumerate(zip(axes, DIRECTIONS, strict=True)):
        panel.fill_between(
            PUBLISHED_BAND_HZ, 20, 40, color=figures.GREY, alpha=0.2, lw=0, label="published, 3-200 Hz"
        )
        for (name, (f, reduction)), style in zip(reductions.items(), _REDUCTION_STYLES, strict=False):
            shown = thinned(f, reduction[k])
            panel.semilogx(f[shown], reduction[k][shown], label=name, **style)
        panel.axhline(0, color=figures.GREY, lw=0.8)
        panel.set(title=direction, xlabel="frequency (Hz)", ylim=(-15, 65), xlim=(f[0], f[-1]))
    axes[0].set_ylabel("reduction (dB)")
    figures.legend_below(axes[0], 4)
    return figure


def paint_power(
    frequencies_hz: np.ndarray, densities: dict[str, np.ndarray], published: tuple[float, float, float]
):
    """Fig. 8: power spectral density of the platform and its running sum from 1 Hz, in z, θx and θy.

    Published is the share of the power at 1-300 Hz removed in z, θx, θy, per cent.
    """
    figure, axes = figures.new(2, 3, height=5.0, sharex=True)
    units = ("(m/s²)²", "(rad/s²)²", "(rad/s²)²")
    inside = (frequencies_hz >= BAND_HZ[0]) & (frequencies_hz <= 1000)
    f = frequencies_hz[inside]
    for name, density in densities.items():
        running = np.cumsum(density[:, inside], axis=1) * (f[1] - f[0])
        for k in range(3):
            for panel, row, width in ((axes[0, k], density[k, inside], 0.9), (axes[1, k], running[k], 1.2)):
                points = thinned(f, row)
                wide = 1.8 if name == "FeRLS" else 1.0  # FeLMS lies on it
                panel.loglog(f[points], row[points], label=name, **{"lw": width * wide, **_STYLES[name]})
    for k, direction in enumerate(DIRECTIONS):
        axes[0, k].set(title=f"(a) {direction}", ylabel=f"PSD ({units[k]}/Hz)")
        axes[1, k].set(title=f"(b) {direction}", ylabel=f"power from 1 Hz ({units[k]})")
        axes[1, k].set(xlabel="frequency (Hz)")
        before = np.sum(densities["feedback"][k, inside & (frequencies_hz <= BAND_HZ[1])]) * (f[1] - f[0])
        figures.mark_published(
            axes[1, k], BAND_HZ[1], before * (1 - published[k] / 100), "published, relative to feedback"
        )
        axes[1, k].axvline(BAND_HZ[1], color=figures.GREY, ls=":", lw=1)
        style = {"xycoords": ("data", "axes fraction"), "ha": "right", "fontsize": 7}
        axes[1, k].annotate(f"{published[k]:g} % less\nat 300 Hz", (280, 0.04), **style)
    figures.legend_below(axes[1, 0], 5)
    return figure


def paint_removed(study, published: tuple[float, float, float]):
    """Share of the power removed per direction: every run of both algorithms, the limit, the published values."""
    figure, axes = figures.new(1, 1, height=2.8)
    where = np.arange(3.0)
    for name, shift in (("FeLMS", -0.2), ("FeRLS", 0.0), ("limit", 0.2)):
        values = study[f"removed {name}"]
        style, label = ("output noise", "output-noise limit") if name == "limit" else (name, name)
        x = np.repeat(where + shift, len(values))
        axes.plot(x, values.T.ravel(), "o", ms=4, alpha=0.7, color=_STYLES[style]["color"], label=label)
    figures.mark_published(axes, where, published, "published, FeRLS", markerfacecolor="white")
    axes.set(xticks=where, xticklabels=DIRECTIONS, xlabel="direction", ylabel="power removed at 1-300 Hz (%)")
    axes.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


def explore_transmissibility(integrator_cutoff_hz: float, shaping_hz: float, floor_hz: float):
    """Explorer: noise-free transmissibility with optimum weights over the cut-offs that bound it."""
    twin = load_twin("rigid_body").varied(integrator_cutoff_hz=integrator_cutoff_hz)
    twin = twin.varied(shaping=replace(twin.feedforward.shaping, lowpass_hz=shaping_hz))
    f = np.geomspace(0.5, 1000, 250)
    weights = steady_state(twin, flat_floor(floor_hz), frequencies_hz=COARSE_HZ).weights
    figure, axes = figures.new(1, 1, height=3.0)
    for name, given in (("feedback", None), ("FeRLS", weights)):
        z = exact_transmissibility(twin, f, weights=given)[0, 0]
        label = name if given is None else "with feedforward, optimum weights"
        axes.semilogx(f, 20 * np.log10(np.abs(z)), label=label, **_STYLES[name])
    axes.set(xlabel="frequency (Hz)", ylabel="transmissibility z → z (dB)", ylim=(-80, 15), xlim=(0.5, 1000))
    axes.legend(loc="lower left")
    return figure


def explore_power(output_noise: float, floor_noise: float, low_pass_hz: float):
    """Explorer: what is left of the power in z and θx with optimum weights, by cause."""
    twin = load_twin("rigid_body").varied(
        platform_noise=output_noise * 1e-4, floor_noise=floor_noise * 1e-5, mains_hz=[], floor_mains=[],
        platform_mains=[],
    )  # fmt: skip
    floor = flat_floor(low_pass_hz)
    f = np.geomspace(*BAND_HZ, 250)
    weights = steady_state(twin, floor, frequencies_hz=COARSE_HZ).weights
    before = sum(expected_density(twin, floor, f).values())
    causes = expected_density(twin, floor, f, weights=weights)
    after = sum(causes.values())
    removed = reduction_percent(f, before, after)
    colors = {"floor": figures.GREEN, "floor noise": figures.ORANGE, "output noise": figures.RED}
    figure, axes = figures.new(1, 2, height=3.0)
    for k, panel in enumerate(axes):
        panel.loglog(f, before[k], color=figures.BLUE, label="feedback")
        panel.loglog(f, after[k], color=figures.BLACK, label="with feedforward")
        for cause, color in colors.items():
            panel.loglog(f, causes[cause][k], ":", color=color, label=f"left by {cause}")
        top = before[k].max()
        panel.set(title=f"{DIRECTIONS[k]}: {removed[k]:.1f} % removed", xlabel="frequency (Hz)")
        panel.set(ylim=(top * 1e-7, top * 3))
    axes[0].set_ylabel("PSD ((m/s²)²/Hz, (rad/s²)²/Hz)")
    figures.legend_below(axes[0], 3)
    return figure
