"""Figures of a floor and of what the isolator makes of it (notebook 08)."""

from dataclasses import replace

import numpy as np

from experiments.isolation.performance import DIRECTIONS, expected_density
from experiments.isolation.performance_pictures import thinned
from experiments.isolation.recorded_floors import RecordedFloor, SpectralFloor
from experiments.isolation.steady import steady_state
from experiments.isolation.twin import Twin
from experiments.isolation.your_floor import Isolated, hear
from stillwork.signals.criteria import criterion_velocity, one_third_octave_velocity
from stillwork.signals.spectra import estimate_spectrum
from stillwork.workbook import figures

_COLORS = {
    "floor": figures.RED,
    "passive": figures.SKY,
    "feedback": figures.BLUE,
    "FeRLS": figures.BLACK,
}
_SHOWN_HZ = (1.0, 400.0)
_GROUPS = {
    "weights of acceleration": figures.BLUE,
    "of its integral": figures.GREEN,
    "of its double integral": figures.RED,
}


def paint_floor(floor: RecordedFloor, resolution_hz: float = 0.25):
    """The sensors' mean and what one sees beside it, over time; each in one-third-octave velocity."""
    figure, (left, right) = figures.new(1, 2, height=3.4)
    time_s = np.arange(floor.acceleration.shape[1]) / floor.sample_rate
    common = floor.acceleration.mean(axis=0)
    own = floor.acceleration[0] - common
    left.plot(time_s, common, lw=0.6, label="mean of the sensors")
    if np.abs(own).max() > 1e-9 * np.abs(common).max():
        left.plot(time_s, own, lw=0.6, color=figures.ORANGE, label="sensor 1 less the mean")
    left.set(xlabel="time (s)", ylabel="floor acceleration (m/s²)")
    spectrum = estimate_spectrum(floor.acceleration, floor.sample_rate, resolution_hz)
    for number, row in enumerate(spectrum.density, 1):
        centres, velocity = one_third_octave_velocity(spectrum.frequencies_hz, row)
        shown = (centres >= _SHOWN_HZ[0]) & (centres <= _SHOWN_HZ[1]) & (velocity > 1e-4 * velocity.max())
        label = "each sensor" if number == 1 else f"_sensor {number}"
        right.loglog(centres[shown], velocity[shown], "o-", ms=2.5, lw=0.8, color=figures.GREEN, label=label)
    _criteria(right)
    right.set(xlabel="one-third-octave band (Hz)", ylabel="rms velocity (m/s)", xlim=(0.8, 600))
    lines = [line for axes in (left, right) for line in axes.get_legend_handles_labels()[0]]
    figure.legend(handles=lines, loc="outside lower center", ncols=3)
    return figure


def paint_isolated(isolated: Isolated, resolution_hz: float = 0.5):
    """Spectra of floor and platform on the test part, by case; directions in which the floor rests are left out."""
    figure, axes = figures.new(1, int(np.sum(isolated.moving)), height=3.0, squeeze=False)
    signals = {"floor": isolated.floor, **isolated.platform}
    spectra = {
        name: estimate_spectrum(rows[:, isolated.training :], isolated.sample_rate, resolution_hz)
        for name, rows in signals.items()
    }
    units = ("(m/s²)²/Hz", "(rad/s²)²/Hz", "(rad/s²)²/Hz")
    for k, panel in zip(np.flatnonzero(isolated.moving), axes[0], strict=True):
        for name, spectrum in spectra.items():
            f = spectrum.frequencies_hz
            inside = np.flatnonzero((f >= _SHOWN_HZ[0]) & (f <= _SHOWN_HZ[1]))
            points = inside[thinned(f[inside], spectrum.density[k, inside])]
            panel.loglog(f[points], spectrum.density[k, points], lw=0.9, color=_COLORS[name], label=name)
        top = max(line.get_ydata().max() for line in panel.lines)
        panel.set(
            title=DIRECTIONS[k],
            xlabel="frequency (Hz)",
            ylabel=f"PSD ({units[k]})",
            ylim=(top * 1e-6, top * 3),
        )
    figures.legend_below(axes[0, 0], 4)
    return figure


def paint_adaptation(isolated: Isolated, window: int = 10):
    """How far the feedforward brings the filtered error down while it learns, and how far its weights still move.

    Left the median and the central 80 % of `window` kept values; right the distance of each group of weights from
    where the training part ends, over its size there.
    """
    figure, (left, right) = figures.new(1, 2, height=2.9)
    run = isolated.adaptation
    whole = len(isolated.progress) // window * window
    time_s = run.time_s[:whole].reshape(-1, window).mean(axis=1)
    low, middle, high = np.quantile(isolated.progress[:whole].reshape(-1, window), [0.1, 0.5, 0.9], axis=1)
    left.fill_between(time_s, low, high, color=_COLORS["FeRLS"], alpha=0.2, lw=0, label="central 80 %")
    left.plot(time_s, middle, color=_COLORS["FeRLS"], lw=1.2, label="median of 2 s")
    left.axhline(1, color=figures.GREY, lw=0.8)
    left.set(xlabel="time (s)", ylabel="filtered error, power over\nthat without feedforward", ylim=(0, None))
    left.legend(loc="best")
    sensors = run.weights.shape[2] // 3
    for group, (name, color) in enumerate(_GROUPS.items()):
        weights = run.weights[:, :, group * sensors : (group + 1) * sensors].reshape(len(run.time_s), -1)
        moved = np.linalg.norm(weights - weights[-1], axis=1) / np.linalg.norm(weights[-1])
        right.plot(run.time_s, moved, color=color, lw=1.2, label=name)
    right.set(xlabel="time (s)", ylabel="distance from the last weights")
    right.legend()
    return figure


def paint_gain(gains: np.ndarray, left: dict[str, np.ndarray]):
    """Rms motion in z over that of the floor, 1-300 Hz, for a louder or quieter floor; optimum weights."""
    figure, axes = figures.new(1, 1, height=2.8)
    for name, values in left.items():
        axes.loglog(gains, values, color=_COLORS[name], label=name)
    axes.axhline(1, color=figures.GREY, lw=0.8)
    axes.axvline(1, color=figures.GREY, lw=0.8, ls="--")
    axes.set(xlabel="amplitude over this floor's", ylabel="platform over floor in z, rms")
    axes.legend()
    return figure


def explore_floor(twin: Twin, floor: SpectralFloor):
    """Explorer: one-third-octave velocity in z of a louder floor and of the platform, with other sensors."""
    f = np.geomspace(0.8, 299, 400)
    twin, _ = hear(twin, floor.channels)

    def paint(gain: float, output_noise: float):
        changed = twin.varied(platform_noise=output_noise * 1e-4)
        louder = replace(floor, levels=gain**2 * floor.levels)
        weights = steady_state(changed, louder, frequencies_hz=np.geomspace(0.05, 2400, 500)).weights
        figure, axes = figures.new(1, 1, height=3.2)
        curves = {"floor": louder.density(f)[0]}
        for name, options in (
            ("passive", {"feedback": False}),
            ("feedback", {}),
            ("FeRLS", {"weights": weights}),
        ):
            causes = expected_density(changed, louder, f, sensed=False, **options)
            curves[name] = sum(causes.values())[0]
        for name, density in curves.items():
            centres, velocity = one_third_octave_velocity(f, density)
            axes.loglog(centres, velocity, "o-", ms=2.5, lw=0.9, color=_COLORS[name], label=name)
        _criteria(axes)
        axes.set(xlabel="one-third-octave band (Hz)", ylabel="rms velocity in z (m/s)")
        axes.set_ylim(bottom=1e-9)
        axes.legend(loc="upper left", ncols=4)
        return figure

    return paint


def _criteria(axes) -> None:
    bands = 2.0 ** (np.arange(0, 20) / 3)
    for name in ("VC-A", "VC-C", "VC-E", "VC-G", "VC-I", "VC-K", "VC-M"):
        defined = bands[bands > 3.9] if name == "VC-A" else bands
        limit = criterion_velocity(name, defined)
        axes.loglog(defined, limit, "--", color=figures.GREY, lw=0.7, label=f"_{name}")
        axes.annotate(name, (defined[-1] * 1.1, limit[-1]), color=figures.GREY, fontsize=7, va="center")
