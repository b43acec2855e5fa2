"""The bandwidth table: what this notebook alone needs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from jaxtyping import Float64
from numpy.typing import ArrayLike

from experiments.motion.designs import (
    COMPENSATIONS,
    DAMPING,
    DESIGNS,
    NOISE_MODEL,
    SIX,
    Design,
    design_controller,
    limit,
    quick_limit,
    stage_bandwidth,
    stage_loops,
    stage_observer,
)
from experiments.motion.intervals import Values
from experiments.motion.machines import published_deviations, stage, stage_mass
from stillwork.control.applications import Application, compensator
from stillwork.control.bandwidth import (
    SIX_DB,
    Bandwidth,
    PeakConstraint,
    highest_peaks,
    make_loop,
    maximise_bandwidth,
)
from stillwork.control.crossover import crossover
from stillwork.control.pid import PidFamily
from stillwork.estimation.observer import NoiseIntensities
from workbook import figures

# === Bandwidth pictures ===========================================================================================
# The published bandwidths as a table and as a map over what the thesis leaves open (notebook 09).


def paint_bandwidths(found: Mapping[str, Bandwidth], position: int, published_hz: Sequence[float]):
    """First crossings at one mass with their range over the masses, and the design parameters, beside the published."""
    figure, axis = figures.new(1, 1, height=3.2)
    places, crossings = np.arange(len(found)), np.array([each.crossing_hz for each in found.values()])
    middle = crossings[:, position - 1]
    reach = [middle - crossings.min(axis=1), crossings.max(axis=1) - middle]
    label = f"first crossing, mass {position} and range over masses"
    axis.errorbar(places, middle, yerr=reach, fmt="o", capsize=4, color=figures.BLUE, label=label)
    designs = [each.design_hz for each in found.values()]
    style = {"markersize": 14, "color": figures.RED, "label": "design parameter $f_{bw}$"}
    axis.plot(places, designs, "_", **style)
    figures.mark_published(axis, places - 0.15, published_hz)
    names = [name.replace(", ", ",\n").replace(" with ", "\nwith ") for name in found]
    axis.set_xticks(places, names, fontsize=7)
    axis.set_ylabel("bandwidth (Hz)")
    axis.legend()
    return figure


def paint_map(
    crossing_hz: np.ndarray, peaks_db: np.ndarray, selectivity: Sequence, noise_model: Sequence, best: tuple
):
    """A `bandwidth_map`, each cell as wide as the other; `best` is a printed place (Q_nu, Q) and what it says.

    Crosses: the peak from r to e_true exceeds 6 dB.
    """
    figure, axis = figures.new(1, 1, height=3.4)
    mesh = axis.pcolormesh(_edges(noise_model), _edges(selectivity), crossing_hz, cmap="viridis")
    figure.colorbar(mesh, ax=axis, label="first crossing (Hz)")
    axis.set(xscale="log", yscale="log", xlabel=r"noise model $Q_\nu$ (N²/s)", ylabel="selectivity $Q$")
    figures.mark_published(axis, *best[:2], label=best[2], markersize=9, color="white")
    rows, columns = np.nonzero(peaks_db > 20 * np.log10(SIX_DB) + 1e-3)
    at, broken = (np.take(noise_model, columns), np.take(selectivity, rows)), "breaks the third constraint"
    axis.plot(*at, "x", color="white", markersize=4, label=broken)
    axis.legend(axis.lines, [best[2], broken], loc="lower left", labelcolor="white")
    return figure


def _edges(centres: Sequence[float]) -> np.ndarray:
    """Edges of cells around ascending positive centres, halfway in logarithms."""
    inner = np.sqrt(np.multiply(centres[1:], centres[:-1]))
    return np.concatenate([[centres[0] ** 2 / inner[0]], inner, [centres[-1] ** 2 / inner[-1]]])


# === Open choices =================================================================================================


def sensor_noise_alone() -> NoiseIntensities:
    """Half the printed R: the sensor noise without the sensor reference, R = sigma_d^2."""
    sigma = published_deviations()
    return NoiseIntensities(sigma["w"] ** 2, sigma["d"] ** 2)


CHOICES = {
    "as published": {},
    "6 dB taken as 2": {"limit": 2.0},
    "R = sensor noise alone": {"noise": sensor_noise_alone},
    "grid of 2000 points": {"points": 2000, "around": 0, "low_hz": 1.0, "high_hz": 1e4, "refine": False},
    "grid of 10000 points": {"points": 10000, "around": 0, "low_hz": 1.0, "high_hz": 1e4, "refine": False},
    "damping 0.1 %": {"damping_ratio": 0.001},
}

# What the text leaves open. R is printed, so another R is a sensitivity and no open choice; the coarse grids
# are errors, and Table 3.4 refutes the damping of 0.1 %.
LEGITIMATE = ("as published", "6 dB taken as 2")


@dataclass(frozen=True)
class OpenChoices:
    """One design under every choice."""

    found: dict[str, Bandwidth]

    @property
    def published(self) -> Bandwidth:
        return self.found["as published"]

    @property
    def crossing(self) -> float:
        """First 0 dB crossing for the measured mass 5 of the chapter (Hz)."""
        return float(self.published.crossing_hz[4])

    @property
    def interval(self) -> tuple[float, float]:
        """Crossings over the seven masses and both meanings of 6 dB, widened by half a printed hertz."""
        crossings = np.concatenate([self.found[name].crossing_hz for name in LEGITIMATE])
        return float(crossings.min() - 0.5), float(crossings.max() + 0.5)


def open_choices(name: str) -> OpenChoices:
    """Bandwidth of a published design under each of `CHOICES`; without an observer R has no effect."""
    found = {}
    for choice, given in CHOICES.items():
        settings = dict(given)
        if "noise" in settings:
            settings["noise"] = settings["noise"]()
            if DESIGNS[name].application is None:  # no observer: R has no effect
                found[choice] = found["as published"]
                continue
        if "damping_ratio" in settings and DESIGNS[name].application is not None:
            continue  # the observer's damping target would change with it: shown for the PID designs only
        found[choice] = stage_bandwidth(name, **settings)
    return OpenChoices(found)


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


def bandwidth_at(name: str, limit: float, **grid) -> float:
    """Largest f_bw of a design (Hz) under another limit of the peaks, on another grid."""
    return stage_bandwidth(name, limit=limit, **grid).design_hz


def moved_by_3_19() -> dict[str, float]:
    """By how much f_bw of each design with a noise model moves (Hz) with the observer of (3.19) in place of (3.15).

    (3.19) has :math:`U - L_xT_{DC}` and :math:`-L_zT_{DC}` in the column of z where (3.15) has U and 0: as if the innovation
    contained the compliance times z.
    """
    found = {}
    for name, design in DESIGNS.items():
        if design.noise_model is None:
            continue
        loops = []
        for mass in range(1, 8):
            observer = stage_observer(mass, None, design.noise_model)
            seen = np.hstack([observer.c[:, :-1], observer.model.feedthrough])
            block = compensator(replace(observer, c=seen), design.application)
            loops.append(make_loop(stage().at([0], [mass - 1]), block))
        limits = [PeakConstraint(function) for function in design.constraints]
        other = maximise_bandwidth(loops, PidFamily(stage_mass()), limits).design_hz
        found[name] = other - stage_bandwidth(name).design_hz
    return found


def free_parameter(designs: Sequence[str], printed: Mapping[str, float]) -> pd.DataFrame:
    """f_bw beside the printed bandwidths: as published, with limit and grid moved, and the largest peak at the print."""
    coarse, rows = CHOICES["grid of 2000 points"], {}
    for name in designs:
        loops, constraints = stage_loops(DESIGNS[name]), DESIGNS[name].constraints
        peaks = highest_peaks(loops, design_controller(name, "printed"), constraints).values()
        rows[name] = {
            "printed": printed[name],
            "fine grid, 6 dB": stage_bandwidth(name).design_hz,
            "coarse grid, 2.001": bandwidth_at(name, 2.001, **coarse),
            "peak at printed (dB)": 20 * np.log10(max(peak.magnitude for peak in peaks)),
        }
    return pd.DataFrame(rows).T


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
OPEN_LOOPS = {  # which of them Definition 1.2.1 means
    "P_eq C_fb": lambda at: at.loop,
    "P C_eq": lambda at: at.output_loop,
    "P C_fb": lambda at: at.plant * at.controller,
}


LOOPS = (*OPEN_LOOPS, "f_bw")
WAYS = [(six, compensation) for six in SIX for compensation in COMPENSATIONS]  # the defaults first


def agreeing(published_hz: Sequence[float], cut_off: bool = False) -> np.ndarray:
    """Whether published values agree with ours, (loops, masses, ways, values): whole hertz rounded or cut off.

    `published_hz` are those of `BANDWIDTHS` in order, and the second one of MC with two constraints.
    """
    names = [*BANDWIDTHS.values(), "MC, two constraints"]
    found = [
        [[[bandwidth(name, loop, mass, *way) for name in names] for way in WAYS] for mass in range(1, 8)]
        for loop in LOOPS
    ]
    off = np.array(found) - np.asarray(published_hz)
    return (off >= 0) & (off < 1) if cut_off else np.abs(off) <= 0.5


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

    `open_loop` is one of `LOOPS`, `six` of `SIX`, `compensation` of `COMPENSATIONS`, `stage_damping` a ratio, and
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
