"""The bandwidth table: what this notebook alone needs."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import product

import numpy as np
import pandas as pd
from jaxtyping import Float64
from numpy.typing import ArrayLike

from experiments.motion.designs import (
    DAMPING,
    DESIGNS,
    NOISE_MODEL,
    PRINTED_HZ,
    Design,
    as_read,
    controllers,
    limit,
    quick_limit,
    stage_loops,
)
from experiments.motion.explorers import THREE, limit_hz, loops_of
from experiments.motion.intervals import Values
from experiments.motion.machines import published_deviations, stage
from experiments.motion.pictures import LABELS, decibel, mark_limit, paint_bode
from stillwork.control.applications import Application
from stillwork.control.bandwidth import SIX_DB, Bandwidth, highest_peaks
from stillwork.control.crossover import crossover
from stillwork.control.loops import LoopResponse
from stillwork.estimation.observer import NoiseIntensities
from workbook import figures

# === Bandwidth pictures ===========================================================================================
# The published bandwidths as a table and as a map over what the thesis leaves open (notebook 09).


AGAIN_HZ = 73.0  # printed a second time for MC with two constraints
PRINTED = sorted([*PRINTED_HZ.items(), ("MC, two constraints", AGAIN_HZ)], key=lambda each: each[1])


def table_presets(*designs: str) -> dict[str, dict]:
    """Presets of `paint_published`: each design at its limit, and at the bandwidth that Table 3.5 prints."""
    found = {name: {"design": name} for name in designs}
    for name in designs:
        part = round(100 * PRINTED_HZ[name] / limit_hz(name), 1)
        found[f"{name}, printed {PRINTED_HZ[name]:g} Hz"] = {"design": name, "part": part}
    return found


@lru_cache
def _envelopes():
    """The figure of `paint_published`, kept from one move to the next: its lines and title are set anew."""
    omega = loops_of(DESIGNS["PID"])[0].omega
    flat = {LABELS[name]: (omega, np.ones(len(omega))) for name in THREE}
    figure, axes = paint_bode(flat, "largest over the masses (dB)", height=3.2, xlim=(1, 2e3), ylim=(-50, 15))
    mark_limit(axes[0])
    return figure


def paint_published(design: str, part: float):
    """Explorer: a published design at a part (%) of the largest bandwidth that it allows, the worst of its seven loops."""
    loops, controller = loops_of(DESIGNS[design]), controllers(DESIGNS[design])(part / 100 * limit_hz(design))
    omega, figure = loops[0].omega, _envelopes()
    responses = [loop.at(controller, omega) for loop in loops]
    for line, name in zip(figure.axes[0].lines, THREE, strict=False):
        worst = np.max([np.abs(getattr(each, name)) for each in responses], axis=0)
        line.set_data(omega / (2 * np.pi), decibel(worst))
    peaks = [decibel(each.magnitude) for each in highest_peaks(loops, controller, THREE).values()]
    written = ", ".join(f"{each:.1f}" for each in peaks)
    figure.axes[0].set_title(f"peaks: {written} dB" if np.isfinite(peaks).all() else "unstable")
    return figure


def interval_of(crossings: np.ndarray) -> tuple[float, float]:
    """The range of all crossings (Hz), widened by half a printed hertz."""
    return float(crossings.min() - 0.5), float(crossings.max() + 0.5)


def paint_bandwidths(found: Mapping[str, Bandwidth], position: int):
    """First crossings at one mass with their range over the masses, and the design parameters, beside the printed ones."""
    figure, axis = figures.new(1, 1, height=3.2)
    places, crossings = np.arange(len(found)), np.array([each.crossing_hz for each in found.values()])
    middle = crossings[:, position - 1]
    reach = [middle - crossings.min(axis=1), crossings.max(axis=1) - middle]
    label = f"first crossing, mass {position} and range over masses"
    axis.errorbar(places, middle, yerr=reach, fmt="o", capsize=4, color=figures.BLUE, label=label)
    designs = [each.design_hz for each in found.values()]
    style = {"markersize": 14, "color": figures.RED, "label": "design parameter $f_{bw}$"}
    axis.plot(places, designs, "_", **style)
    twice = list(found).index("MC, two constraints")
    figures.mark_published(axis, [*(places - 0.15), twice - 0.3], [*PRINTED_HZ.values(), AGAIN_HZ])
    names = [name.replace(", ", ",\n").replace(" with ", "\nwith ") for name in found]
    axis.set_xticks(places, names, fontsize=7)
    axis.set_ylabel("bandwidth (Hz)")
    axis.legend()
    return figure


def paint_map(
    crossing_hz: np.ndarray, peaks_db: np.ndarray, selectivity: Sequence, noise_model: Sequence, best: tuple
):
    """A `bandwidth_map` as a line a selectivity over Q_nu; `best` is a printed place (Q_nu, Hz) and what it says.

    Open circles: the peak from r to e_true exceeds 6 dB.
    """
    from matplotlib import colormaps

    figure, axis = figures.new(1, 1, height=3.4)
    colours, sizes = (
        colormaps["viridis"](np.linspace(0, 0.85, len(selectivity))),
        np.asarray(noise_model, float),
    )
    for q, hertz, peaks, colour in zip(selectivity, crossing_hz, peaks_db, colours, strict=True):
        broken = peaks > 20 * np.log10(SIX_DB) + 1e-3
        axis.semilogx(sizes, hertz, color=colour, label=f"$Q$ = {q:g}")
        axis.plot(sizes[~broken], hertz[~broken], "o", color=colour, markersize=4)
        axis.plot(sizes[broken], hertz[broken], "o", color=colour, markerfacecolor="white", markersize=5)
    axis.plot([], [], "o", color=figures.BLACK, markerfacecolor="white", label="breaks the third constraint")
    figures.mark_published(axis, *best[:2], label=best[2], markersize=8)
    axis.set(xlabel=r"noise model $Q_\nu$ (N²/s)", ylabel="first crossing (Hz)")
    axis.legend()
    return figure


OPEN_LOOPS = {  # which of them Definition 1.2.1 means
    "P_eq C_fb": lambda at: at.loop,
    "P C_eq": lambda at: at.output_loop,
    "P C_fb": lambda at: at.plant * at.controller,
}


# === Open choices =================================================================================================


def sensor_noise_alone() -> NoiseIntensities:
    """Half the printed R: the sensor noise without the sensor reference, R = sigma_d^2."""
    sigma = published_deviations()
    return NoiseIntensities(sigma["w"] ** 2, sigma["d"] ** 2)


COARSE = {"points": 2000, "around": 0, "low_hz": 1.0, "high_hz": 1e4}  # frequencies of a loop


def bandwidth_map(
    selectivity: ArrayLike, noise_model: ArrayLike, third: bool = False
) -> Float64[np.ndarray, "3 rows columns"]:
    """MC and AD together over (Q, Q_nu), the search of (3.47) as a map, or with the `third` constraint, r to e_true.

    f_bw and first crossing at mass 5 (Hz), and the peak from r to e_true (dB); NaN where nothing in the range is feasible.
    """

    def cell(q: float, size: float) -> tuple[float, float, float]:
        limits = Design.constraints + ("true_tracking",) * third
        found = quick_limit(Design(Application(True, DAMPING, selectivity=q), size, limits))
        if found is None:
            return (np.nan,) * 3
        loops, best = found
        peak = highest_peaks(loops, best.controller, ["true_tracking"])["true_tracking"].magnitude
        return best.design_hz, float(best.crossing_hz[4]), float(20 * np.log10(peak))

    rows, columns = np.asarray(selectivity, float).tolist(), np.asarray(noise_model, float).tolist()
    return np.moveaxis([[cell(q, size) for size in columns] for q in rows], -1, 0)


# === Windows of the limit =========================================================================================

SEARCHES = {  # errors that a search may have: frequencies that step over a resonance, half of the R of section 3.1
    "fine grid": ({}, None),
    "fine grid, half of R": ({}, sensor_noise_alone),
    "2000 frequencies": (COARSE, None),
    "2000 frequencies, half of R": (COARSE, sensor_noise_alone),
}
WRITTEN = {"rounded": (-0.5, 0.5), "cut off": (0.0, 1.0)}  # which bandwidths are written as one hertz
MEANT = (("f_bw", 0), *((loop, mass) for loop in OPEN_LOOPS for mass in range(1, 8)))  # by a bandwidth
SIX_DB_WRITTEN = tuple(10 ** (db / 20) for db in (5.5, 6.5))  # limits that are written as 6 dB
AS_PRINTED = "as printed"


def designs_of(name: str, large: float) -> dict[str, Design]:
    """A design as printed, and what the text allows beside it.

    MC with two constraints is printed twice, with or without the noise model; MC and AD may have the third constraint and a
    `large` Q_nu, on the plateau of (3.47).
    """
    design = DESIGNS[name]
    if name == "MC, two constraints":
        return {AS_PRINTED: design, "no noise model": as_read(design, "nothing", stage().damping[1])}
    if name == "MC and AD":
        limits = (*Design.constraints, "true_tracking")
        return {
            AS_PRINTED: design,
            "third constraint": replace(design, noise_model=large, constraints=limits),
        }
    return {AS_PRINTED: design}


def peaks_and_bandwidths(
    design: Design, noise: NoiseIntensities | None, grid: Mapping, hertz: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Largest limited peak at each f_bw, and what may be called its bandwidth (Hz): (f_bw,) and (meanings, f_bw)."""
    family, highest = controllers(design), np.zeros(len(hertz))
    crossings = np.zeros((len(OPEN_LOOPS), 7, len(hertz)))
    for mass, loop in enumerate(stage_loops(design, noise, **grid)):
        pid = np.array([family(hz).frequency_response(loop.omega) for hz in hertz])
        parts = (loop.plant_response, loop.compensator_response[..., None, :], pid)
        at = LoopResponse(*parts)
        for name in design.constraints:
            highest = np.maximum(highest, np.abs(getattr(at, name)).max(axis=-1))
        low = int(
            np.searchsorted(loop.omega, 4 * np.pi * hertz[-1])
        )  # a loop crosses 0 dB below twice the largest f_bw
        at = LoopResponse(*(part[..., :low] for part in parts))
        for k, function in enumerate(OPEN_LOOPS.values()):
            gain = np.log(np.abs(function(at)))
            last = np.argmax((gain[:, :-1] >= 0) & (gain[:, 1:] < 0), axis=1)  # before the first crossing
            above, below = (np.take_along_axis(gain, (last + i)[:, None], 1)[:, 0] for i in (0, 1))
            steps = np.diff(np.log(loop.omega))[last]
            crossings[k, mass] = loop.omega[last] * np.exp(steps * above / (above - below)) / (2 * np.pi)
    return highest, np.vstack([hertz, crossings.reshape(-1, len(hertz))])


def limit_windows(printed: Sequence[tuple[str, float]], large: float) -> dict[tuple, np.ndarray]:
    """For which limits of the peaks the largest f_bw of a design, or its crossing, is written as printed.

    The largest peak rises with f_bw, so the limit under which f_bw is the largest feasible one is the peak at f_bw.

    Parameters
    ----------
    printed : sequence of (str, float)
        Names in `DESIGNS`, each with a printed bandwidth (Hz).
    large : float
        Q_nu with the third constraint, see `designs_of`.

    Returns
    -------
    dict of tuple to (meanings, 2) array
        By the search (`SEARCHES`), the way of writing (`WRITTEN`), the place in `printed` and the variant (`designs_of`): lowest
        and highest limit, by what the bandwidth means (`MEANT`).
    """
    found: dict[tuple, np.ndarray] = {}
    numbers = {name: [(k, hz) for k, (each, hz) in enumerate(printed) if each == name] for name, _ in printed}
    for (search, (grid, noise)), name in product(SEARCHES.items(), numbers):
        ends = [hz for _, hz in numbers[name]]
        hertz = np.linspace(0.88 * min(ends), 1.04 * max(ends), 41)  # crossings lie up to a tenth above f_bw
        for variant, design in designs_of(name, large).items():
            peaks, bandwidths = peaks_and_bandwidths(design, noise and noise(), grid, hertz)
            for (number, hz), (written, off) in product(numbers[name], WRITTEN.items()):
                at = [np.interp(hz + np.array(off), each, hertz) for each in bandwidths]
                found[search, written, number, variant] = np.interp(at, hertz, peaks)
    return found


def count_combinations(printed: Sequence[tuple[str, float]], windows: Mapping, large: float) -> pd.DataFrame:
    """How many printed numbers one limit gives at most, a row for each combination of choices.

    Parameters
    ----------
    printed, windows, large
        As `limit_windows` takes and gives them.

    Returns
    -------
    DataFrame
        What the bandwidth means and at which mass, search, way of writing, variants other than `AS_PRINTED` by their printed
        hertz, `count`, the ends of the limit, and the numbers (`gives`).
    """
    kinds = [list(designs_of(name, large)) for name, _ in printed]
    rows = []
    for search, written, variants in product(SEARCHES, WRITTEN, product(*kinds)):
        each = np.array([windows[search, written, *number] for number in enumerate(variants)])
        others = {hz: v for (_, hz), v in zip(printed, variants, strict=True) if v != AS_PRINTED}
        for (loop, mass), ends in zip(MEANT, np.clip(each, *SIX_DB_WRITTEN).swapaxes(0, 1), strict=True):
            count, low, high = most_at_once(ends)
            gives = [hz for (_, hz), (a, b) in zip(printed, ends, strict=True) if a <= low < b]
            rows.append((loop, mass, search, written, others, count, low, high, gives))
    return pd.DataFrame(
        rows, columns=["means", "mass", "search", "written", "variants", "count", "from", "to", "gives"]
    )


def most_at_once(windows: ArrayLike) -> tuple[int, float, float]:
    """How many windows (numbers, 2) meet at most, and between which ends; empty ones meet none."""
    windows = np.asarray(windows, float)
    inside = (windows[:, :1] <= windows[:, 0]) & (
        windows[:, 0] < windows[:, 1:]
    )  # each holds another's low end
    low = int(inside.sum(axis=0).argmax())
    met = windows[inside[:, low]]
    return len(met), float(met[:, 0].max(initial=0.0)), float(met[:, 1].min(initial=np.inf))


def best_as(combinations: pd.DataFrame, means: str) -> pd.Series:
    """The combination with the largest count, by what the bandwidth means; of several the first."""
    rows = combinations[combinations["means"] == means]
    return rows.loc[rows["count"].idxmax()]


def names_of(combinations: pd.DataFrame) -> str:
    """Which crossings are meant, each with its masses."""
    masses = combinations[combinations["mass"] > 0].groupby("means", sort=False)["mass"].unique()
    return " and ".join(
        f"crossings of `{loop}` at mass {' and '.join(map(str, sorted(each)))}"
        for loop, each in masses.items()
    )


def paint_windows(printed: Sequence[tuple[str, float]], windows: Mapping[str, np.ndarray]):
    """Windows of the limit (dB) as bars, a row for each printed bandwidth and a colour for each way of reading."""
    figure, axis = figures.new(1, 1, height=4.0)
    colours = (figures.BLUE, figures.SKY, figures.RED, figures.ORANGE)
    for k, ((way, ends), colour) in enumerate(zip(windows.items(), colours, strict=True)):
        low, high = 20 * np.log10(ends).T
        axis.barh(np.arange(len(printed)) + 0.2 * k - 0.3, high - low, 0.17, low, color=colour, label=way)
    axis.axvline(6.0, color=figures.BLACK, linestyle=":", label="6 dB")
    axis.set_yticks(np.arange(len(printed)), [f"{name}: {hz:g} Hz" for name, hz in printed], fontsize=7)
    axis.set(xlabel="limit of the peaks (dB)", xlim=(5.4, 7.6))
    axis.invert_yaxis()
    axis.legend(fontsize=7)
    return figure


# --- Chapter 3: bandwidths ---------------------------------------------------------------------------------------

BANDWIDTHS = {  # entries of Table 3.5 and of the text, in the order of the published values
    "pid": "PID",
    "notches": "PID with notches",
    "mc": "MC",
    "mc-and-ad-no-band-pass": "MC and AD, no band-pass",
    "ad-no-band-pass": "AD, no band-pass",
    "mc-two-constraints": "MC, two constraints",
    "ad": "AD",
    "mc-and-ad": "MC and AD",
}


def bandwidths(
    *,
    open_loop: str,
    mass: int,
    six: str,
    compensation: str,
    stage_damping: float,
    printed_hertz: str,
    seed: int,
) -> Values:
    """Bandwidths of chapter 3 at one mass, each with what its print may leave off; it has no fast variant.

    `open_loop` is one of `OPEN_LOOPS`, `six` of `SIX`, `compensation` of `COMPENSATIONS`, `stage_damping` a ratio, and
    `printed_hertz` ``rounded`` (half a hertz to either side) or ``cut off`` (up to one hertz more than printed).
    """
    below, above = (0.5, 0.5) if printed_hertz == "rounded" else (1.0, 0.0)
    found = {
        claim: bandwidth(name, open_loop, mass, six, compensation, stage_damping)
        for claim, name in BANDWIDTHS.items()
    }
    values = list(found.values())
    found["mc-two-constraints-again"] = found["mc-two-constraints"]
    return {f"motion.bandwidth.{claim}": (hz, (hz - below, hz + above)) for claim, hz in found.items()} | {
        "motion.bandwidth.ordering": float(values == sorted(values)),
        "motion.bandwidth.doubled-by-ad": float(found["ad"] > 2 * found["pid"]),
        "motion.bandwidth.doubled-by-both": float(found["mc-and-ad"] > 2 * found["pid"]),
        "motion.bandwidth.ad-above-mc": float(found["ad"] > found["mc"]),
        "motion.bandwidth.both-above-all": float(found["mc-and-ad"] == max(values)),
        "motion.bandwidth.mc-limited": float(found["mc"] < found["mc-two-constraints"]),
    }


def bandwidth(
    name: str,
    open_loop: str,
    mass: int,
    six: str = "6 dB",
    compensation: str = "noise model",
    stage_damping: float = 0.005,
) -> float:
    """What is called the bandwidth of a design (Hz): a crossing at one mass (1 to 7), or the parameter f_bw."""
    if DESIGNS[name].noise_model != NOISE_MODEL:  # it has none, or one that is printed
        compensation = "noise model"
    loops, found = limit(name, six, compensation, stage_damping)
    if open_loop == "f_bw":
        return found.design_hz
    loop, function = loops[mass - 1], OPEN_LOOPS[open_loop]
    magnitude = np.abs(function(loop.at(found.controller)))
    return crossover(lambda w: function(loop.at(found.controller, w)), loop.omega, magnitude) / (2 * np.pi)


def distances() -> np.ndarray:
    """Largest relative distance of the designs' crossings from the printed ones, (loops, masses)."""
    return np.array(
        [
            [
                max(abs(bandwidth(name, loop, mass) / hz - 1) for name, hz in PRINTED_HZ.items())
                for mass in range(1, 8)
            ]
            for loop in OPEN_LOOPS
        ]
    )


# === Appendix =====================================================================================================


def appendix(
    page, *, crossings: Mapping[str, np.ndarray], position: int, row: pd.Series, third: pd.DataFrame
) -> None:
    """What the notebook judges beside its answer: the second number of MC with two constraints, what AD gives, the map's optimum.

    `crossings` are by meaning of 6 dB and mass (Hz), `row` and `third` of the map over Q_nu.
    """
    again = crossings["MC, two constraints"]
    page.check("motion.bandwidth.mc-two-constraints-again", again[0, position - 1], interval_of(again))
    page.check("motion.bandwidth.doubled-by-ad", np.mean(crossings["AD"] > 2 * crossings["PID"]))
    page.check("motion.bandwidth.mc-limited", np.mean(crossings["MC"] < again))
    page.check("motion.bandwidth.ad-above-mc", np.mean(crossings["AD"] > crossings["MC"]))
    most = np.max([*crossings.values()], axis=0)
    page.check("motion.bandwidth.both-above-all", np.mean(crossings["MC and AD"] == most))
    page.text(r"""## The map in numbers

The first crossing at $Q = 2$ with the two constraints of (3.47), by $Q_\nu$, and the largest $f_{bw}$ with the third one, by $Q$
and $Q_\nu$ (Hz):""")
    page.show(row.round(1))
    page.check("motion.bandwidth.noise-model", row.idxmax())
    page.show(third.round(1))
