"""Power that remains: what this notebook alone needs."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy import linalg

from experiments.isolation.floors import FLAT_LEVEL, ShapedFloor, flat_floor
from experiments.isolation.performance import (
    DIRECTIONS,
    CaseRecord,
    expected_density,
    record_cases,
    third_octaves,
    tune,
)
from experiments.isolation.performance_pictures import STYLES
from experiments.isolation.responses import COARSE_HZ, thinned
from experiments.isolation.simulation import TOGETHER, sample_seeds
from experiments.isolation.steady import steady_state
from experiments.isolation.twin import Twin, equal_struts, load_twin
from stillwork.base.checks import require_array
from stillwork.signals.spectra import Spectrum, band_power
from workbook import figures, paths
from workbook.choices.kept import wanted
from workbook.studies import fraction, run_study, spread_interval

BAND_HZ = (1.0, 300.0)  # the paper's range of interest
RESOLUTION_HZ = 0.25  # fine enough for the suspension's skirt at 1 Hz


def reduction_percent(
    frequencies_hz: ArrayLike, before: ArrayLike, after: ArrayLike
) -> Float64[np.ndarray, " channels"]:
    """Share of the power at 1-300 Hz that is gone, per cent, for densities of shape (channels, frequencies)."""
    left, total = (
        np.array([band_power(frequencies_hz, row, *BAND_HZ) for row in rows]) for rows in (after, before)
    )
    return 100 * (1 - left / total)


def without_lines(spectrum: Spectrum, lines_hz: ArrayLike) -> Spectrum:
    """Spectrum with a straight bridge over two bins on either side of each line (a Hann window's main lobe)."""
    f, density = spectrum.frequencies_hz, spectrum.density.copy()
    for line in require_array("lines_hz", lines_hz, ndim=1):
        middle = int(np.argmin(np.abs(f - line)))
        ends = [max(middle - 3, 0), min(middle + 3, len(f) - 1)]
        inside = slice(ends[0] + 1, ends[1])
        density[:, inside] = [np.interp(f[inside], f[ends], row[ends]) for row in density]
    return Spectrum(f, density, spectrum.averages)


def limit_ratio_db(
    frequencies_hz: ArrayLike, density: ArrayLike, limit: ArrayLike, lines_hz: ArrayLike
) -> tuple[Float64[np.ndarray, " bands"], Float64[np.ndarray, "3 bands"]]:
    """Mean density of several runs over that of the limit, in one-third-octave bands from 3 to 200 Hz, dB.

    Densities have shape (runs, 3, frequencies); mains lines are bridged because their size in the twins is assumed.
    """
    f = require_array("frequencies_hz", frequencies_hz, ndim=1)
    centres, inside = third_octaves(f)
    over, under = (
        without_lines(Spectrum(f, np.mean(np.asarray(each), axis=0), len(each)), lines_hz).density
        for each in (density, limit)
    )
    ratio = [over[:, band].mean(axis=1) / under[:, band].mean(axis=1) for band in inside]
    return centres, 10 * np.log10(np.stack(ratio, axis=1))


def paint_power(
    frequencies_hz: np.ndarray, densities: dict[str, np.ndarray], published: tuple[float, float, float]
):
    """Fig. 8: power spectral density of the platform and its running sum from 1 Hz, in z, θx and θy.

    Published is the share of the power at 1-300 Hz that FeRLS removes in z, θx, θy, per cent; ours stands beside it, with
    the lines of the mains, as drawn.
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
                panel.loglog(f[points], row[points], label=name, **{"lw": width * wide, **STYLES[name]})
    for k, direction in enumerate(DIRECTIONS):
        axes[0, k].set(title=f"(a) {direction}", ylabel=f"PSD ({units[k]}/Hz)")
        axes[1, k].set(title=f"(b) {direction}", ylabel=f"power from 1 Hz ({units[k]})")
        axes[1, k].set(xlabel="frequency (Hz)")
        band = inside & (frequencies_hz <= BAND_HZ[1])
        before, after = (np.sum(densities[name][k, band]) * (f[1] - f[0]) for name in ("feedback", "FeRLS"))
        figures.mark_published(
            axes[1, k],
            BAND_HZ[1],
            before * (1 - published[k] / 100),
            "published for FeRLS, below our feedback",
        )
        axes[1, k].axvline(BAND_HZ[1], color=figures.GREY, ls=":", lw=1)
        style = {"xycoords": ("data", "axes fraction"), "ha": "right", "fontsize": 7}
        text = f"FeRLS at 300 Hz below\nfeedback: paper {published[k]:g} %,\nhere {100 * (1 - after / before):.0f} % (with mains)"
        axes[1, k].annotate(text, (280, 0.03), **style)
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
        axes.plot(x, values.T.ravel(), "o", ms=4, alpha=0.7, color=STYLES[style]["color"], label=label)
    figures.mark_published(axes, where, published, "published, FeRLS", markerfacecolor="white")
    axes.set(xticks=where, xticklabels=DIRECTIONS, xlabel="direction", ylabel="power removed at 1-300 Hz (%)")
    axes.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


CAUSES = {
    "floor": figures.GREEN,
    "floor noise": figures.ORANGE,
    "output noise": figures.RED,
}  # of the explorer


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
    figure = _explorer_figure()
    for k, panel in enumerate(figure.axes):
        for line, density in zip(
            panel.lines, (before, after, *(causes[cause] for cause in CAUSES)), strict=True
        ):
            line.set_data(f, density[k])
        top = before[k].max()
        panel.set(title=f"{DIRECTIONS[k]}: {removed[k]:.1f} % removed", ylim=(top * 1e-7, top * 3))
    return figure


@cache
def _explorer_figure():
    """Figure of the explorer, kept for its next move: only its data change."""
    figure, axes = figures.new(1, 2, height=3.0)
    for panel in axes:
        panel.loglog([], [], color=figures.BLUE, label="feedback")
        panel.loglog([], [], color=figures.BLACK, label="with feedforward")
        for cause, color in CAUSES.items():
            panel.loglog([], [], ":", color=color, label=f"left by {cause}")
        panel.set(xlabel="frequency (Hz)", xlim=BAND_HZ)
    axes[0].set_ylabel("PSD ((m/s²)²/Hz, (rad/s²)²/Hz)")
    figures.legend_below(axes[0], 3)
    return figure


LOW_END_HZ = 6.0  # high-pass of N: below it nothing adapts, and the weak integrators end


def left_by_cause(twin: Twin, floor: ShapedFloor) -> dict[str, Float64[np.ndarray, "3"]]:
    """Share of the power at 1-300 Hz left by optimum weights that each cause makes, in z, θx, θy.

    The causes are motion of the floor below and above `LOW_END_HZ`, noise of the floor's and of the platform's sensors.
    """
    f = np.unique(np.append(np.geomspace(*BAND_HZ, 1000), LOW_END_HZ))
    causes = expected_density(twin, floor, f, weights=steady_state(twin, floor).weights)

    def power(name: str, low: float, high: float) -> np.ndarray:
        return np.array([band_power(f, row, low, high) for row in causes[name]])

    found = {
        "low end": power("floor", BAND_HZ[0], LOW_END_HZ),
        "high end": power("floor", LOW_END_HZ, BAND_HZ[1]),
        "floor sensors": power("floor noise", *BAND_HZ),
        "platform sensors": power("output noise", *BAND_HZ),
    }
    whole = sum(found.values())
    return {name: each / whole for name, each in found.items()}


def power_trial(
    draws: Sequence[np.random.Generator],
    *,
    twin: Twin,
    floor: ShapedFloor,
    felms_s: float | None,
    ferls_s: float,
    record_s: float,
) -> list[dict[str, np.ndarray]]:
    """Repetitions of the experiment of Fig. 8 for `run_study` with `together`: adapt, freeze, record, compare.

    ``removed FeLMS``, ``removed FeRLS``: share of the power at 1-300 Hz that the feedforward removes from the
    feedback-only case, per cent, (3,); ``removed limit``: the same if only the output noise were left;
    ``removed with mains``: as FeRLS, lines counted, which all others but the spectra bridge. ``in band``, ``above band``: power with
    FeRLS over that of the output noise at 3-200 and 300-500 Hz, (3,); ``low end``: power with FeRLS over feedback
    only at 1-2 Hz. ``density feedback``, ``... FeLMS``, ``... FeRLS``, ``... output noise``: spectra, (3,
    frequencies). Without `felms_s` FeLMS is left out.
    """
    seeds = sample_seeds(draws)
    tuned = tune(twin, floor, felms_s, ferls_s, seeds)
    records = {}
    for name in ("feedback", *tuned[0]):
        weights = None if name == "feedback" else [each[name] for each in tuned]
        after = [seed + 1 for seed in seeds]
        records[name] = record_cases(twin, floor, name, record_s, after, weights=weights)
    return [
        _removed(twin, dict(zip(records, each, strict=True))) for each in zip(*records.values(), strict=True)
    ]


def _removed(twin: Twin, records: dict[str, CaseRecord]) -> dict[str, np.ndarray]:
    measured = {name: record.spectrum(RESOLUTION_HZ) for name, record in records.items()}
    measured["output noise"] = records["feedback"].output_noise(RESOLUTION_HZ)
    bridged = {name: without_lines(each, twin.instruments.mains_hz) for name, each in measured.items()}
    f = measured["feedback"].frequencies_hz
    found: dict[str, np.ndarray] = {}
    if "FeLMS" in bridged:
        found["removed FeLMS"] = reduction_percent(f, bridged["feedback"].density, bridged["FeLMS"].density)
    return (
        found
        | measures(bridged["feedback"], bridged["FeRLS"], bridged["output noise"])
        | {
            "removed with mains": reduction_percent(
                f, measured["feedback"].density, measured["FeRLS"].density
            ),
            **{f"density {name}": spectrum.density for name, spectrum in measured.items()},
        }
    )


def measures(before: Spectrum, after: Spectrum, limit: Spectrum) -> dict[str, np.ndarray]:
    """Of FeRLS, in the words of `power_trial`, from spectra with feedback alone, with it, and of the output noise."""
    f = before.frequencies_hz
    return {
        "removed FeRLS": reduction_percent(f, before.density, after.density),
        "removed limit": reduction_percent(f, before.density, limit.density),
        "in band": after.power(3.0, 200.0) / limit.power(3.0, 200.0),
        "above band": after.power(300.0, 500.0) / limit.power(300.0, 500.0),
        "low end": after.power(1.0, 2.0) / before.power(1.0, 2.0),
    }


ENTRIES = ("z", "theta-x", "theta-y")  # the ledger's words for them


FELMS_S, FERLS_S, RECORD_S = 250.0, 60.0, 40.0  # s, of a run of notebook 05
RUNS = 16  # with three directions 48 for an ordering


def power(
    *, mains_in_power: str, seed: int, **open_choices
) -> dict[str, float | tuple[float, tuple[float, float]]]:
    """Fig. 8 with FeRLS by `RUNS` runs, as notebook 05 judges it.

    `mains_in_power` is ``"bridged"`` or ``"counted"``; the others are those of `other_rig`.
    """
    twin, floor = other_rig(**open_choices)
    return judged(power_runs(twin, floor, seed), twin.instruments.mains_hz, mains_in_power == "counted")


def both_algorithms(*, seed: int, **open_choices) -> dict:
    """Fig. 8 with FeLMS, too, which takes four times as long."""
    study = power_runs(*other_rig(**open_choices), seed, felms_s=FELMS_S)
    return {"isolation.fig-8.same-by-both": same_by_both(study)}


def other_rig(
    *, floor_upper_end: float, sensor_levels: str, sensor_correlation: float, **struts: float
) -> tuple[Twin, ShapedFloor]:
    """Rig and floor at a combination of open choices.

    `sensor_levels` are three numbers between colons, `sensor_correlation` the share of the sensors' power that all three
    see alike, `struts` the arguments of `equal_struts`.
    """
    levels = FLAT_LEVEL * np.array([float(level) for level in sensor_levels.split(":")])
    return correlated(equal_struts(**struts), sensor_correlation), flat_floor(floor_upper_end, levels)


def power_runs(twin: Twin, floor: ShapedFloor, seed: int, runs: int = RUNS, felms_s: float | None = None):
    """Runs of the experiment of Fig. 8; FeLMS, which takes most of the time, with `felms_s` alone."""
    settings = {"felms_s": felms_s, "ferls_s": FERLS_S, "record_s": RECORD_S}
    return run_study(
        power_trial, runs, seed, together=TOGETHER, progress=False, twin=twin, floor=floor, **settings
    )


def same_by_both(study) -> tuple[float, tuple[float, float]]:
    """Share of runs and directions in which FeLMS and FeRLS remove the same power within half a point."""
    obeyed = np.abs(study["removed FeLMS"] - study["removed FeRLS"]) < 0.5
    return fraction(obeyed.ravel())


def correlated(twin: Twin, share: float) -> Twin:
    """Twin whose floor sensors see `share` of their power alike.

    Its plant takes three independent motions and mixes them; the feedforward hears the unmixed ones, which changes
    nothing but rounding for FeRLS (notebook 06: it commands the same on any basis).
    """
    count = twin.sensors
    mixing = linalg.sqrtm((1 - share) * np.eye(count) + share * np.ones((count, count))).real
    names = ("floor_damping", "floor_stiffness", "floor_inertia")
    return replace(
        twin, plant=replace(twin.plant, **{name: getattr(twin.plant, name) @ mixing for name in names})
    )


def judged(study, mains_hz, counted: bool = False) -> dict[str, float | tuple[float, tuple[float, float]]]:
    """Every entry that the runs of Fig. 8 decide, with its interval."""
    removed = study["removed with mains" if counted else "removed FeRLS"]
    frequencies = np.arange(study["density FeRLS"].shape[2]) * RESOLUTION_HZ
    found: dict = {
        f"isolation.fig-8.removed.{name}": (float(values.mean()), spread_interval(values))
        for name, values in zip(ENTRIES, removed.T, strict=True)
    }
    for entry, obeyed in {
        "removed.range": (removed > 89.5) & (removed < 94.5),
        "reaches-the-limit": study["removed limit"] - study["removed FeRLS"] < 1.0,
        "low-end-lost": study["low end"] > 1,
        "no-limit-above-300-hz": study["above band"] > study["in band"],
    }.items():
        found[f"isolation.fig-8.{entry}"] = fraction(obeyed.ravel())
    bands, above = limit_ratio_db(
        frequencies, study["density FeRLS"], study["density output noise"], mains_hz
    )
    late = np.flatnonzero(above.max(axis=0) > 3.0)
    after = late[-1] + 1 if len(late) else 0
    found["isolation.fig-8.limit-in-band"] = float(bands[after]) if after < len(bands) else np.nan
    return found


# === Appendix =====================================================================================================


def appendix(page, *, twin: Twin, floor: ShapedFloor, study, low_pass_hz: float) -> None:
    """What this notebook judges beside its answer.

    Parameters
    ----------
    page : workbook.appendix.Appendix
    twin : Twin
    floor : ShapedFloor
    study : Study
        Of `power_runs`.
    low_pass_hz : float
        Upper end of the flat floor, Hz.
    """
    page.text("""## The spectra in numbers

In z, θx, θy: per cent removed, with the mains lines bridged and counted; FeRLS over feedback only and over the output noise;
then FeRLS over the output noise by band, in the worst direction (an entry added after Fig. 8 had shown it).""")
    frequencies = np.arange(study["density FeRLS"].shape[2]) * RESOLUTION_HZ
    bands, above = limit_ratio_db(
        frequencies, study["density FeRLS"], study["density output noise"], twin.instruments.mains_hz
    )
    page.show(
        *(
            f"{name}, % removed: {study[f'removed {name}'].mean(axis=0).round(1)}"
            for name in ("FeLMS", "FeRLS", "limit", "with mains")
        ),
        f"FeRLS over feedback only, 1-2 Hz: {study['low end'].mean(axis=0).round(2)}",
        f"more power at 1-2 Hz than with feedback only: {(study['low end'] > 1).sum()} of {study['low end'].size}",
        f"FeRLS over output noise, 3-200 Hz: {study['in band'].mean(axis=0).round(2)}",
        f"FeRLS over output noise, 300-500 Hz: {study['above band'].mean(axis=0).round(2)}",
        ", ".join(f"{hz:.3g} Hz {db:.1f} dB" for hz, db in zip(bands, above.max(axis=0), strict=True)),
    )
    page.text(r"""## Sensors elsewhere, and the proportions of Table 1

Power removed and stiffness row of Table 1 (printed: 0.53, 1.52, -0.76), to which the radius was fitted, from spectra alone. A strut pushes with $(c_i/s + k_i/s^2)$ times its foot's
acceleration. So $w_4 : w_5 : w_6 = w_7 : w_8 : w_9$ except for lag and delay, wherever struts and sensors are; Table 1 prints ratios of 0.26, 0.22 and 0.49. Nor do struts give w1 to w3, a force in proportion to the floor's acceleration (02).""")
    for radius, corner in ((0.0648, low_pass_hz), (0.0648, 80.0), (0.09, low_pass_hz), (0.12, low_pass_hz)):
        shares, row = wide_sensors(radius, corner)
        page.show(
            f"sensors at {radius:g} m, flat to {corner:g} Hz, % in z, θx, θy: {shares.round(1)}, w7 to w9: {row.round(2)}"
        )
    page.check("isolation.fig-8.wide-sensors-w9", row[2])
    best = steady_state(twin, floor).weights
    ratios = best[0, 3:6] / best[0, 6:]
    page.check("isolation.fig-8.in-proportion", ratios.max() / ratios.min())
    page.show(f"w4/w7, w5/w8, w6/w9: {ratios.round(2)}")
    page.text(
        """Of all printed numbers those that agree under an option and not under every one (`data/isolation/settings.csv`):"""
    )
    axes = (
        "output-noise",
        "sensor-levels",
        "sensor-radius",
        "sensor-correlation",
        "strut-tilt",
        "floor-upper-end",
    )
    page.show(*wanted(paths.data("isolation", "settings.csv"), axes, never=("fig-8",)))


def wide_sensors(
    radius: float, corner_hz: float
) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
    """Per cent removed with floor sensors at another radius (m), and the stiffness row w7 to w9, from spectra alone."""
    grid = np.geomspace(*BAND_HZ, 1000)
    rig = equal_struts(strut_damping=65.0, actuator_pole=300.0, sensor_radius=radius)
    floor = flat_floor(corner_hz)
    best = steady_state(rig, floor).weights
    before, after = (sum(expected_density(rig, floor, grid, weights=w).values()) for w in (None, best))
    return reduction_percent(grid, before, after), np.ascontiguousarray(best[0, 6:])
