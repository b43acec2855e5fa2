"""Transmissibility: what this notebook alone needs."""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from jaxtyping import Complex128, Float64
from numpy.typing import ArrayLike

from experiments.isolation.floors import flat_floor
from experiments.isolation.performance import (
    DIRECTIONS,
    central_axes,
    diagonal_size,
    expected_density,
    record_case,
    record_cases,
    reduction_db,
    tune,
)
from experiments.isolation.performance_pictures import STYLES
from experiments.isolation.responses import COARSE_HZ, responses, thinned
from experiments.isolation.simulation import TOGETHER
from experiments.isolation.steady import steady_state
from experiments.isolation.twin import Twin, load_twin
from stillwork.base.checks import InputError, require_array
from stillwork.signals.spectra import band_power
from workbook import figures, paths
from workbook.choices.kept import wanted
from workbook.studies import fraction


def exact_transmissibility(
    twin: Twin, frequencies_hz: ArrayLike, *, weights: ArrayLike | None = None
) -> Complex128[np.ndarray, "3 3 frequencies"]:
    """Transmissibility from floor to platform in z, θx, θy without any noise, from the model's responses.

    Platform directions along the first axis, floor directions along the second.
    """
    axes = central_axes(twin.rig)
    if np.linalg.matrix_rank(axes.floor_readings, 1e-9) < 3:
        raise InputError("floor_sensors do not fix z, θx and θy of the plate; place three apart")
    whole = responses(twin, frequencies_hz).transmissibility(weights)
    return (axes.platform @ whole @ axes.floor_readings).transpose(1, 2, 0)


def band_means(
    frequencies_hz: ArrayLike, responses: dict[str, np.ndarray], lines_hz: ArrayLike
) -> tuple[Float64[np.ndarray, " bands"], dict[str, Complex128[np.ndarray, "3 3 bands"]]]:
    """Complex means of estimated responses over a twelfth of an octave, in which uncorrelated noise averages out.

    Lines within two steps of one of the mains (`lines_hz`) stand for themselves: their peaks are no noise.
    """
    f = require_array("frequencies_hz", frequencies_hz, ndim=1)
    apart = np.abs(f[:, None] - require_array("lines_hz", lines_hz, ndim=1)).min(axis=1, initial=np.inf)
    band = np.where(apart <= 2.001 * (f[1] - f[0]), -f, np.floor(12 * np.log2(f)))
    starts = np.flatnonzero(np.diff(band, prepend=np.nan) != 0)
    counts = np.diff(starts, append=len(f))
    means = {name: np.add.reduceat(response, starts, axis=2) / counts for name, response in responses.items()}
    return np.add.reduceat(f, starts) / counts, means


_LOW_DB = -80.0  # where the panels of the diagonal end


PUBLISHED_BAND_HZ = (3.0, 200.0)  # where the paper states 20 to 40 dB


_REDUCTION_STYLES = (
    {"color": figures.BLACK},
    {"color": figures.GREEN, "ls": "--"},
    {"color": figures.ORANGE, "lw": 1.0},
    {"color": figures.PURPLE, "lw": 1.0, "ls": "-."},
)


# Below this a transmissibility is rounding: the rig's symmetry makes the element zero.
_ROUNDING = 1e-9


def paint_transmissibility(f: np.ndarray, cases: dict[str, np.ndarray], exact: np.ndarray):
    """Fig. 7: the 3x3 matrix of transmissibilities over Hz as estimated, platform direction down, floor direction across.

    `exact` is that with FeRLS without noise. Off the diagonal only that with feedback and with FeRLS is drawn: the rest
    lies on it.
    """
    figure, axes = figures.new(3, 3, height=6.6, sharex=True)
    units = np.array([["", " (m/rad)", " (m/rad)"], [" (rad/m)", "", ""], [" (rad/m)", "", ""]])
    for i, to in enumerate(DIRECTIONS):
        for j, start in enumerate(DIRECTIONS):
            panel = axes[i, j]
            # An off-diagonal panel takes its scale from the lengths involved: rad/m is large, m/rad small.
            shift = {"": 0.0, " (m/rad)": -25.0, " (rad/m)": 25.0}[units[i, j]]
            lowest = 10 ** ((_LOW_DB + shift - 10) / 20)  # how deep a zero reaches hangs on the last bits
            for name, response in cases.items():
                if i == j or name in ("feedback", "FeRLS"):
                    wide = {"lw": 1.6 if name == "FeRLS" else 0.9}  # FeLMS lies on it
                    _draw(panel, f, np.maximum(np.abs(response[i, j]), lowest), name, wide | STYLES[name])
            size = np.abs(exact[i, j])
            if size.max() > _ROUNDING:
                style = {"color": figures.RED, "ls": ":", "lw": 1.2, "zorder": 4}
                _draw(panel, f, np.maximum(size, lowest), "FeRLS, without noise", style)
            if i == j:
                _mark_reduction(panel, f, cases["feedback"][i, i])
            panel.set(title=f"{start} → {to}{units[i, j]}", ylim=(_LOW_DB + shift, 25 + shift))
            panel.set(xlim=(f[0], f[-1]))
            panel.set_xticks((1, 10, 100, 1000), ("1", "10", "100", "1000"))
    figures.label(axes, "frequency (Hz)", "magnitude (dB)")
    figures.legend_below(axes[0, 0], 3)
    return figure


def _draw(panel, f: np.ndarray, size: np.ndarray, label: str, style: dict) -> None:
    shown = thinned(f, size)
    panel.semilogx(f[shown], 20 * np.log10(size[shown]), label=label, **style)


def _mark_reduction(panel, frequencies_hz: np.ndarray, feedback: np.ndarray):
    """Shade the published 20 to 40 dB below `feedback` alone, taken as its median over a twelfth of a decade."""
    edges = np.geomspace(*PUBLISHED_BAND_HZ, 23)
    decibels = 20 * np.log10(np.abs(feedback))
    inside = [(frequencies_hz >= low) & (frequencies_hz <= high) for low, high in pairwise(edges)]
    level = np.array([np.median(decibels[each]) for each in inside])
    middle = np.sqrt(edges[1:] * edges[:-1])
    style = {"color": figures.GREY, "alpha": 0.25, "lw": 0}
    panel.fill_between(middle, level - 40, level - 20, label="published: 20 to 40 dB below feedback", **style)


def paint_reduction(frequencies_hz: np.ndarray, reductions: dict[str, np.ndarray]):
    """Reduction (dB) of the three diagonal elements by the feedforward, with the published 20 and 40 dB."""
    figure, axes = figures.new(1, 3, height=3.0, sharey=True)
    for k, (panel, direction) in enumerate(zip(axes, DIRECTIONS, strict=True)):
        panel.fill_between(
            PUBLISHED_BAND_HZ,
            20,
            40,
            color=figures.GREY,
            alpha=0.25,
            lw=0,
            label="published: 20 to 40 dB, 3-200 Hz",
        )
        for (name, reduction), style in zip(reductions.items(), _REDUCTION_STYLES, strict=False):
            shown = thinned(frequencies_hz, reduction[k])
            panel.semilogx(frequencies_hz[shown], reduction[k][shown], label=name, **style)
        panel.axhline(0, color=figures.GREY, lw=0.8)
        panel.set(title=direction, ylim=(-15, 75), xlim=(1, 900))  # the parasitic resonance: 962 Hz
        panel.set_xticks((1, 3, 10, 50, 200, 500), ("1", "3", "10", "50", "200", "500"))
        panel.set_xticks((), minor=True)
    figures.label(axes, "frequency (Hz)", "reduction, without noise (dB)")
    figures.legend_below(axes[0], 3)
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
        axes.semilogx(f, 20 * np.log10(np.abs(z)), label=label, **STYLES[name])
    axes.set(xlabel="frequency (Hz)", ylabel="transmissibility z → z (dB)", ylim=(-80, 15), xlim=(0.5, 1000))
    axes.legend(loc="lower left")
    return figure


RESOLUTION_HZ = 0.25
FERLS_S, FELMS_S = 100.0, 300.0  # of adaptation before the weights are frozen
SEEDS = tuple(range(1, 9))  # tuned side by side
NOISY_HZ = (400.0, 900.0)  # "beyond 400 Hz", below the parasitic resonance
PASSIVE_RECORDS = 40  # fewer than 36 leave the interval of a share of one below the threshold of 0.9

# === Open choices =================================================================================================


def edges(
    *, strut_damping: float, actuator_pole: float, floor_upper_end: float, seed: int
) -> dict[str, float]:
    """What Fig. 7 shows without noise, with weights that FeRLS finds in 100 s, as in notebook 04.

    `strut_damping` in N s/m; `actuator_pole` (Hz) is the rig's: the controller keeps the 300 Hz of eq. (2).
    """
    twin, weights = tuned(strut_damping, actuator_pole, floor_upper_end)
    beside = statements(twin, flat_floor(floor_upper_end), weights[seed])
    return edges_of(twin, weights[seed]) | beside


def statements(twin: Twin, floor, weights: ArrayLike) -> dict[str, float]:
    """Waterbed and sensor noise beyond 400 Hz (section 5.2.1), the share of z, θx, θy that show them."""
    areas = amplification(twin, weights)
    return {
        "isolation.fig-7.waterbed": float(np.mean(areas[:, 1] >= (1 - 1e-3) * areas[:, 0])),
        "isolation.fig-7.beyond-400-hz": float(np.mean(noise_share(twin, floor, weights, NOISY_HZ) > 0.5)),
    }


def edges_of(twin: Twin, weights: ArrayLike) -> dict[str, float]:
    """Where the reduction exceeds 20 dB and 0 dB, in the worst of z, θx, θy, and its slope at the low end."""
    frequencies = np.arange(RESOLUTION_HZ, 1000 + RESOLUTION_HZ / 2, RESOLUTION_HZ)
    decibels = exact_reduction_db(twin, frequencies, weights)
    reduction = decibels.min(axis=0)
    share = frequencies / twin.feedforward.integrator_cutoff_hz
    rolling = (share >= 2) & (share <= 5)
    left = -decibels[:, rolling].mean(axis=0) / 20
    enough, less = reduction > 20, (reduction > 0) & (frequencies < 900)  # the parasitic resonance: 962 Hz
    return {
        "isolation.fig-7.lower-end": _edge(frequencies, enough, 0),
        "isolation.fig-7.upper-end": _edge(frequencies, enough, -1),
        "isolation.fig-7.low-frequency-loss": _edge(frequencies, less, 0),
        "isolation.fig-7.high-frequency-loss": _edge(frequencies, less, -1),
        "isolation.fig-7.roll-off": np.polyfit(np.log10(share[rolling]), left, 1)[0],
    }


def exact_reduction_db(
    twin: Twin, frequencies_hz: ArrayLike, weights: ArrayLike
) -> Float64[np.ndarray, "3 frequencies"]:
    """Reduction of z, θx and θy by the feedforward without noise, dB."""
    before, after = (
        diagonal_size(exact_transmissibility(twin, frequencies_hz, weights=each)) for each in (None, weights)
    )
    return 20 * np.log10(before / after)


def _edge(frequencies, inside, end: int) -> float:
    """First or last frequency inside; NaN where none is."""
    return float(frequencies[inside][end]) if inside.any() else np.nan


def records(
    *,
    strut_damping: float,
    actuator_pole: float,
    floor_upper_end: float,
    record_length: float,
    seed: int,
) -> dict[str, float]:
    """What Fig. 7 shows as estimated from records of `record_length` s, as in notebook 04."""
    twin, weights = tuned(strut_damping, actuator_pole, floor_upper_end)
    floor = flat_floor(floor_upper_end)
    felms = _felms(strut_damping, actuator_pole, floor_upper_end, seed)
    given = {"feedback": None, "FeRLS": weights[seed], "FeLMS": felms}
    f, responses = estimate(twin, floor, given, record_length, seed)
    misses = passive_misses(strut_damping, floor_upper_end, record_length, seed)
    return recorded(f, responses) | {"isolation.fig-7.passive-low-frequency": share_over(misses)}


def estimate(
    twin: Twin, floor, cases: Mapping[str, np.ndarray | None], record_s: float, seed: int
) -> tuple[Float64[np.ndarray, " frequencies"], dict[str, Complex128[np.ndarray, "3 3 frequencies"]]]:
    """Frequencies up to 1 kHz, and each case with its frozen weights as estimated from a record on another floor."""
    found = {
        name: record_case(twin, floor, name, record_s, seed + 1, weights=weights).response(RESOLUTION_HZ)
        for name, weights in cases.items()
    }
    f = next(iter(found.values())).frequencies_hz
    shown = (f > 0) & (f <= 1000)
    return f[shown], {name: each.response[:, :, shown] for name, each in found.items()}


@lru_cache(maxsize=16)
def _felms(strut_damping: float, actuator_pole: float, floor_upper_end: float, seed: int) -> np.ndarray:
    """Weights that FeLMS finds in `FELMS_S`."""
    twin = rigid_body(strut_damping, actuator_pole)
    return tune(twin, flat_floor(floor_upper_end), FELMS_S, None, [seed])[0]["FeLMS"]


def recorded(frequencies_hz: np.ndarray, responses: Mapping[str, np.ndarray]) -> dict[str, float]:
    """What the estimates of one run say as Fig. 7 shows them."""
    feedback, ferls, felms = (responses[name] for name in ("feedback", "FeRLS", "FeLMS"))
    by_ferls, by_felms = (reduction_db(frequencies_hz, feedback, each)[1] for each in (ferls, felms))
    levels = off_diagonal_db(frequencies_hz, ferls)
    return {
        "isolation.fig-7.largest-reduction": by_ferls.max(axis=1).mean(),
        "isolation.fig-7.mains-peak": float(np.mean(mains_peak_db(frequencies_hz, ferls) > 6)),
        "isolation.fig-7.same-by-both": float(np.median(np.abs(by_ferls - by_felms))),
        "isolation.fig-7.off-diagonal-bounds": float(np.all(np.diff(levels) < 0)),
    }


def mains_peak_db(frequencies_hz: np.ndarray, response: np.ndarray) -> Float64[np.ndarray, "3"]:
    """How far 100 Hz stands above its surroundings on the diagonal of an estimated transmissibility, dB."""
    level = 20 * np.log10(diagonal_size(response))
    off = np.abs(frequencies_hz - 100)
    return level[:, off.argmin()] - np.median(level[:, (off > 1) & (off < 10)], axis=1)


@lru_cache(maxsize=32)
def passive_misses(
    strut_damping: float, floor_upper_end: float, record_length: float, seed: int
) -> Float64[np.ndarray, " records"]:
    """Largest distance from 0 dB below 1 Hz of each passive record, mean of z, θx, θy, dB; no actuator takes part."""
    twin, floor = rigid_body(strut_damping, 300.0), flat_floor(floor_upper_end)
    seeds, found = range(seed + 1, seed + 1 + PASSIVE_RECORDS), []
    for first in range(0, PASSIVE_RECORDS, TOGETHER):
        for record in record_cases(twin, floor, "passive", record_length, seeds[first : first + TOGETHER]):
            passive = record.response(RESOLUTION_HZ)
            low = (passive.frequencies_hz > 0) & (passive.frequencies_hz < 1)
            level = 20 * np.log10(diagonal_size(passive.response[:, :, low]))
            found.append(np.abs(level).max(axis=1).mean())
    return np.array(found)


def share_over(misses: np.ndarray) -> tuple[float, tuple[float, float]]:
    """Share of records that miss 0 dB by over 1 dB, with its interval."""
    return fraction(misses > 1)


def rigid_body(strut_damping: float, actuator_pole: float) -> Twin:
    """The rigid body with other struts and actuators."""
    twin = load_twin("rigid_body")
    return twin.on_rig(replace(twin.rig, damping=strut_damping)).varied(actuator_pole_hz=actuator_pole)


@lru_cache(maxsize=64)  # combinations that differ in the record alone share the tuning
def tuned(strut_damping: float, actuator_pole: float, floor_upper_end: float) -> tuple[Twin, dict]:
    """Rigid body, and for each of `SEEDS` its weights after 100 s of FeRLS."""
    twin = rigid_body(strut_damping, actuator_pole)
    found = tune(twin, flat_floor(floor_upper_end), None, FERLS_S, SEEDS)
    return twin, {seed: each["FeRLS"] for seed, each in zip(SEEDS, found, strict=True)}


# === Statements of section 5.2.1 that stand beside the figure ======================================================


def amplification(twin: Twin, weights: ArrayLike) -> Float64[np.ndarray, "3 2"]:
    """Areas of reduction and of amplification in z, θx, θy: dB over a linear axis from 0.01 Hz to half the rate, dB Hz.

    Jensen's formula gives their difference: for a stable ratio R that is one at z = infinity, the mean of ln |R| over the
    unit circle is the sum of ln |z| over its zeros outside, so never negative. The trapezoidal rule is good to 1e-3.
    """
    half = twin.instruments.sample_rate / 2
    f = np.concatenate([np.geomspace(0.01, 1.0, 200, endpoint=False), np.arange(1.0, half, 0.25)])
    decibels = exact_reduction_db(twin, f, weights)
    areas = [np.trapezoid(np.maximum(sign * decibels, 0), f, axis=1) for sign in (1, -1)]
    return np.stack(areas, axis=1)


def noise_share(
    twin: Twin, floor, weights: ArrayLike, band_hz: tuple[float, float]
) -> Float64[np.ndarray, "3"]:
    """Share of the platform's measured power in a band that sensor noise makes, in z, θx, θy."""
    f = np.linspace(*band_hz, 400)
    causes = expected_density(twin, floor, f, weights=weights)
    power = {
        name: np.array([band_power(f, row, *band_hz) for row in density]) for name, density in causes.items()
    }
    return (power["floor noise"] + power["output noise"]) / sum(power.values())


def off_diagonal_db(frequencies_hz: np.ndarray, response: np.ndarray) -> Float64[np.ndarray, "3"]:
    """Median level at 3 to 200 Hz of what the estimate shows off the diagonal, dB: in rad/m, without unit, in m/rad."""
    inside = (frequencies_hz >= 3) & (frequencies_hz <= 200)
    level = 20 * np.log10(np.abs(response[:, :, inside]))
    tilts, mixed, lengths = ([(1, 0), (2, 0)], [(1, 2), (2, 1)], [(0, 1), (0, 2)])
    return np.array([np.median([level[i, j] for i, j in each]) for each in (tilts, mixed, lengths)])


def left_by_integrators(frequency_hz: float, cutoff_hz: float = 2.0, order: int = 3) -> float:
    """Share of a stiffness force that weak integrators leave with perfect weights and no delay, |2 L - L^2|, eq. (12)."""
    low_pass = (1 / (1 + 1j * frequency_hz / cutoff_hz)) ** order
    return float(np.abs(2 * low_pass - low_pass**2))


# === Appendix =====================================================================================================


def appendix(
    page,
    *,
    twin: Twin,
    weights: np.ndarray,
    low_pass_hz: float,
    frequencies,
    estimated: Mapping,
    record_s: float,
    seed: int,
) -> None:
    """What this notebook judges beside its answer.

    Parameters
    ----------
    page : workbook.appendix.Appendix
    twin : Twin
    weights : array
        Of FeRLS.
    low_pass_hz : float
        Upper end of the flat floor, Hz.
    frequencies : array
        Of the estimates, Hz.
    estimated : mapping of str to array
        Responses by case, (3, 3, frequencies).
    record_s : float
        Length of the records, s.
    seed : int
    """
    page.text("""## Statements beside the figure

*Off the diagonal* the lower bounds differ because their units do. *Beyond 400 Hz* sensor noise and modes of the floor plate
dominate (our plate is rigid): the share of sensor noise at 400-900 Hz. Then the peak at 100 Hz, of the mains. *Passive* the
platform follows the floor at low frequencies, but below 1 Hz sensor noise takes the estimate off 0 dB, as the paper suspects
(judged over several records, chosen after seeing one).""")
    floor = flat_floor(low_pass_hz)
    misses = passive_misses(float(twin.rig.damping[0]), low_pass_hz, record_s, seed)
    share, interval = share_over(misses)
    page.check("isolation.fig-7.passive-low-frequency", share, interval)
    noise = noise_share(twin, floor, weights, NOISY_HZ)
    page.show(
        f"off the diagonal in rad/m, without unit, in m/rad, dB: {off_diagonal_db(frequencies, estimated['FeRLS']).round(0)}",
        f"share of sensor noise at 400-900 Hz, z, θx, θy: {noise.round(2)}",
        f"100 Hz above its surroundings, z, θx, θy, dB: {mains_peak_db(frequencies, estimated['FeRLS']).round(1)}",
        f"passive, largest miss of 0 dB below 1 Hz, by record: {min(misses):.1f} to {max(misses):.1f} dB",
    )
    page.text("""## Roll-off

Section 3 states a roll-off of order three beyond the cut-off of the weak integrators; with perfect weights, stiffness alone and
no delay the slope from two to five times the cut-off is less.""")
    share = np.geomspace(2.0, 5.0, 100)
    cutoff_hz, order = twin.feedforward.integrator_cutoff_hz, twin.feedforward.integrator_order
    ideal = [np.log10(left_by_integrators(each * cutoff_hz, cutoff_hz, order)) for each in share]
    page.show(
        f"slope with perfect weights: {np.polyfit(np.log10(share), ideal, 1)[0]:.2f} decades per decade"
    )
    page.text("""## Which number wants which setting

Of all printed numbers those that agree under an option and not under every one (`data/isolation/settings.csv`):""")
    axes = ("strut-damping", "actuator-pole", "record-length", "floor-upper-end")
    page.show(*wanted(paths.data("isolation", "settings.csv"), axes, never=("fig-7",)))
