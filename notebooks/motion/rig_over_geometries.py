"""The rig over geometries: what this notebook alone needs."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float64
from matplotlib.lines import Line2D

from experiments.motion.intervals import Values, central
from experiments.motion.pictures import plain
from experiments.motion.rig import Geometry, assumed, assumed_geometry, excitation, published, rig_model
from experiments.motion.rig_designs import (
    CASES,
    COLOURS,
    DIRECTIONS,
    IDS,
    MOTIONS,
    RigSettings,
    bandwidths,
    model_errors,
    printed,
    published_settings,
    rig_controllers,
    rig_loops,
)
from experiments.motion.rig_loops import FUNCTIONS, MEASURES, RigLoop
from experiments.motion.rig_study import Levelling, held_mass, levelling, levelling_rms
from stillwork.base.checks import InputError
from stillwork.base.validation import checked
from stillwork.control.pid import Pid
from stillwork.estimation.observer import NoiseIntensities
from workbook import figures
from workbook.studies import Study, fraction


class FlexiblePeaks(NamedTuple):
    """What is flexible in a decoupled plant, over the four positions."""

    peaks: Float64[np.ndarray, "8"]  # m/N, largest singular value near every published mode
    coupling: float  # m/N, mean magnitude of the off-diagonal entries at a tenth of the first mode


def flexible_peaks(loops: list[RigLoop]) -> FlexiblePeaks:
    """Peaks of the difference between the equivalent plant and the rigid body (motions of the edges)."""
    modes = 2 * np.pi * np.array(published()["frequencies_hz"])
    middle = np.sqrt(modes[1:] * modes[:-1])
    # Within 5 % of each mode, and no nearer to another one; further away the tails of lower modes are larger.
    low = np.maximum(0.95 * modes, np.append(0.0, middle))
    high = np.minimum(1.05 * modes, np.append(middle, np.inf))
    found, coupling = [], []
    for loop in loops:
        rigid = held_mass(loop.omega, loop.sample_time)
        seen = np.moveaxis(loop.equivalent_plant(), -1, 0)
        bands = np.array([(loop.omega >= a) & (loop.omega <= b) for a, b in zip(low, high, strict=True)])
        used = bands.any(axis=0)
        apart = seen[used] - rigid[used, None, None] * np.diag(1 / loop.decoupling.masses)
        sizes = np.linalg.norm(apart, 2, axis=(1, 2))
        found.append([sizes[band].max() for band in bands[:, used]])
        slow = np.abs(seen[np.searchsorted(loop.omega, modes[0] / 10)])
        coupling.append(slow[~np.eye(3, dtype=bool)].mean())
    return FlexiblePeaks(np.max(found, axis=0), float(np.mean(coupling)))


def sample_geometry(rng: np.random.Generator) -> Geometry:
    """A geometry from the ranges of ``rig.toml``; the length stays, since only ratios of lengths matter."""
    ranges, known = assumed()["ranges"], assumed_geometry()
    return replace(
        known,
        mass=float(np.exp(rng.uniform(*np.log(ranges["mass"])))),
        width=known.length * rng.uniform(*ranges["aspect"]),
        actuators=rng.uniform(*ranges["actuators"]),
        sensors=(rng.uniform(*ranges["sensors"]), rng.uniform(*ranges["sensors"])),
    )


def levelling_errors(
    loops: Mapping[str, Sequence[RigLoop]],
    pids: Mapping[str, Sequence[Pid] | None],
    trajectory: Levelling,
    noise: NoiseIntensities,
    mass_error: float = 0.0,
) -> Float64[np.ndarray, "2 cases 3"]:
    """`levelling_rms` at the first position, with the original's and with each case's own controllers.

    NaN where there is no controller, or the loop is unstable.
    """

    def rms(case: str, owner: str) -> Float64[np.ndarray, "3"]:
        if pids[owner] is not None:
            with suppress(InputError):  # of an unstable loop
                return levelling_rms(loops[case][0], pids[owner], trajectory, noise, mass_error)
        return np.full(3, np.nan)

    with_original = [rms(case, "Original") for case in CASES]
    return np.array([with_original, [with_original[0], *(rms(case, case) for case in CASES[1:])]])


@checked
def rig_trial(rng: np.random.Generator, settings: RigSettings) -> dict[str, np.ndarray]:
    """One geometry, one draw of model errors, all four cases, under both readings of "peaks below 6 dB".

    With one entry a reading (`MEASURES`) in front: ``crossing`` (cases, 3) in Hz, mean over positions;
    ``peaks`` (cases, functions); ``original`` and ``redesigned`` (cases, 3), rms errors in m and rad at the
    first position with the original and with the redesigned controllers; all NaN where no bandwidth passes.
    Besides ``flexible`` (cases, modes) and ``coupling`` (cases,) in m/N, the drawn ``mass``, and ``excitation``
    (2, modes), the largest of four and of three actuators.
    """
    geometry = sample_geometry(rng)
    loops = rig_loops(geometry, settings, model_errors(rng))
    trajectory = levelling(rng)
    found = [bandwidths(loops, measure).values() for measure in MEASURES]
    pids = [{case: each.pids for case, each in zip(CASES, designs, strict=True)} for designs in found]
    errors = [levelling_errors(loops, pid, trajectory, settings.noise) for pid in pids]
    original, redesigned = np.swapaxes(errors, 0, 1)
    flexible = [flexible_peaks(loop) for loop in loops.values()]
    excited = [excitation(geometry, used) for used in ((0, 1, 2, 3), geometry.used)]
    return {
        "crossing": np.array([[design.crossing_hz.mean(axis=0) for design in designs] for designs in found]),
        "peaks": np.array([[each.peaks.max(axis=0) for each in designs] for designs in found]),
        "original": original,
        "redesigned": redesigned,
        "flexible": np.array([each.peaks for each in flexible]),
        "coupling": np.array([each.coupling for each in flexible]),
        "mass": np.array(geometry.mass),
        "excitation": np.abs(excited).max(axis=2),
    }


# === Geometry pictures ============================================================================================
# The rig's tables over geometries, and an explorer of one geometry (notebook 25).


def paint_over_geometries(values: Mapping[str, np.ndarray], marks: Mapping[str, np.ndarray], quantity: str):
    """Spread over geometries of a quantity in three directions (NaN: none), one panel each, with the published values."""
    figure, axes = figures.new(1, 3, height=2.9, sharey=True)
    for k, axis in enumerate(axes):
        for place, (case, each) in enumerate(values.items()):
            found = each[np.isfinite(each[:, k]), k]
            rank = np.linspace(-0.22, 0.22, len(found))
            style = {"markersize": 4, "color": COLOURS[case]}
            axis.plot(place + rank, np.sort(found), ".", label=f"one geometry, {case}", **style)
            if case in marks:
                label = f"_published, {case}" if place else "published"
                figures.mark_published(axis, place, marks[case][k], label)
        axis.set_xticks(range(len(values)), [case.replace(" and ", "\nand ") for case in values])
        axis.set(title=f"${MOTIONS[k]}$", xlabel="use of the observer")
    axes[0].set(ylabel=quantity, ylim=(0, 1.08 * max(axis.dataLim.y1 for axis in axes)))
    handles, labels = axes[0].get_legend_handles_labels()
    # Colours are the uses on the axis; the legend's dot has none of them.
    dot = Line2D(
        [], [], linestyle="", marker=".", color=figures.GREY, label="one geometry, each use in its colour"
    )
    shown = [dot, *(handle for handle, label in zip(handles, labels, strict=True) if label == "published")]
    figure.legend(handles=shown, loc="outside lower center", ncols=2)
    return figure


def paint_geometry(aspect: float, along_x: float, along_y: float, actuators: float):
    """Explorer: what a geometry lets three actuators and four sensors do with the eight modes."""
    geometry = assumed_geometry()
    width = geometry.length * aspect
    geometry = replace(geometry, width=width, actuators=actuators, sensors=(along_x, along_y))
    model = rig_model(geometry, higher_modes=0)
    size = np.sqrt(geometry.mass)
    figure, axes = plain(2, wspace=0.3)
    x, y = geometry.half
    axes[0].plot([-x, x, x, -x, -x], [-y, -y, y, y, -y], color=figures.GREY)
    used = geometry.actuator_places[list(geometry.used)]
    axes[0].plot(*used.T, "o", color=figures.BLACK, markerfacecolor="none")
    axes[0].plot(*geometry.sensor_places.T, "x", color=figures.BLACK)
    axes[0].set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title="circles: actuators, crosses: sensors")
    number = np.arange(1, 9)
    for shift, shapes, colour, label in (
        (-0.15, np.abs(model.input_shapes[3:]).max(axis=1), figures.RED, "largest at an actuator"),
        (0.15, np.abs(model.output_shapes[:, 3:]).max(axis=0), figures.BLUE, "largest at a sensor"),
    ):
        axes[1].bar(number + shift, shapes * size, 0.3, color=colour, label=label)
    axes[1].set(xlabel="flexible mode", ylabel=r"mode shape, rms over the plate = 1", ylim=(0, 3))
    axes[1].legend()
    return figure


def ordered(crossing: np.ndarray) -> dict[str, np.ndarray]:
    """On which geometries each step of the order of Table 6.2 holds, in every direction, from (geometries, cases, 3)."""
    steps = {"MC above original": (1, 0), "AD above MC": (2, 1), "MC and AD above AD": (3, 2)}
    above = {
        name: np.all(crossing[:, one] > crossing[:, other], axis=1) for name, (one, other) in steps.items()
    }
    return above | {"the whole order": np.all(list(above.values()), axis=0)}


# === The appendix =================================================================================================


def appendix(page, *, study: Study, measure: str, ratios: Mapping[str, np.ndarray]) -> None:
    """What the page of motion/25 judges beside its answer."""
    which = MEASURES.index(measure)
    _of_limits(page, study, which)
    _of_peaks(page, study)
    _of_coupling(page, study)
    _of_errors(page, study, which, ratios)


def _of_limits(page, study: Study, which: int) -> None:
    page.text("""## What limits each case

Functions within 2 % of the limit, counted over geometries, under both measures.""")
    active = study["peaks"] > 0.98 * 10 ** (6 / 20)
    counts = {
        f"{name}, {case}": dict(zip(FUNCTIONS, active[:, m, k].sum(axis=0), strict=True))
        for m, name in enumerate(MEASURES)
        for k, case in enumerate(CASES)
    }
    page.show(pd.DataFrame(counts).T)
    near = study["peaks"][:, which, 2, 4] < 10 ** (5.5 / 20)
    page.check("motion.section-6-4-1.mc-stopped-by-true-error", *fraction(active[:, which, 1, 4]))
    page.check("motion.section-6-4-1.ad-stopped-by-sensitivity", *fraction(near))


def _of_peaks(page, study: Study) -> None:
    page.text(r"""## The resonances of the decoupled plant

$\max\bar\sigma(P_{eq} - P_{rigid})/\max\bar\sigma(P - P_{rigid})$ within 5 % of each published mode (a band chosen after we had seen
numbers), over the four positions, $\bar\sigma$ being the largest singular value. Dots: medians; bars: all geometries.""")
    left = study["flexible"][:, 1:] / study["flexible"][:, :1]
    figure, axis = figures.new(1, 1, height=2.9)
    number = np.arange(1, 9)
    for k, case in enumerate(CASES[1:]):
        low, middle, high = np.quantile(left[:, k], [0, 0.5, 1], axis=0)
        style = {"fmt": "o", "markersize": 4, "color": COLOURS[case], "label": case}
        axis.errorbar(number + 0.2 * (k - 1), middle, yerr=[middle - low, high - middle], **style)
    axis.axhline(1, color=figures.BLACK, linewidth=0.8)
    axis.set_yscale("log")
    axis.set(xlabel="flexible mode", ylabel="peak over that\nwithout observer")
    figures.legend_below(axis, 3)
    page.save("peaks", figure)
    four, three = np.moveaxis(study["excitation"], 1, 0)
    page.check("motion.section-6-1.three-excite-first-mode", *fraction(three[:, 0] > 10 * four[:, 0]))
    page.check("motion.section-6-1.four-excite-little", *fraction(three > 10 * four))
    page.conclude(
        "Remarks 6.1.1 and 6.4.1 explain the low bandwidths by the layout: a command to three corner actuators excites the first mode more "
        "than ten times as much as to four on {first:.0%} of the plates, any mode in {all:.0%} of cases.",
        first=np.mean(three[:, 0] > 10 * four[:, 0]),
        all=np.mean(three > 10 * four),
    )
    page.check("motion.section-6-4-1.mc-lowers-peaks", *fraction(left[:, 0] < 1))
    page.check("motion.section-6-4-1.ad-lowers-peaks", *fraction(left[:, 1] < 1))
    page.check("motion.section-6-4-1.both-lower-than-mc", *fraction(left[:, 2] < left[:, 0]))
    page.check("motion.section-6-4-2.mc-lowers-more-than-ad", *fraction(left[:, 0] < left[:, 1]))


def _of_coupling(page, study: Study) -> None:
    page.text("""## The coupling

The mean of the six off-diagonal entries (in motions of the edges) at a tenth of the first frequency, relative to that without
observer:""")
    coupling = study["coupling"] / study["coupling"][:, :1]
    found = np.quantile(coupling, [0, 0.5, 1], axis=0)
    shown = pd.DataFrame(found, index=["lowest", "median", "highest"], columns=CASES)
    page.show(shown, float_format="{:.3g}".format)
    page.check("motion.section-6-4-1.mc-lowers-coupling", *fraction(coupling[:, 1] < 1))
    page.check("motion.section-6-5.ad-leaves-coupling", np.median(coupling[:, 2]))
    page.check("motion.section-6-4-1.both-couple-like-mc", np.median(coupling[:, 3] / coupling[:, 1]))


def _of_errors(page, study: Study, which: int, ratios: Mapping) -> None:
    page.text("""## Tables 6.3 and 6.4 in numbers

Stable loops of each case; the share of the plates that are below the published ratio of Table 6.4:""")
    errors = {"6-3": study["original"][:, which], "6-4": study["redesigned"][:, which]}
    counts = {
        f"Table {table.replace('-', '.')}": dict(
            zip(CASES, np.isfinite(found[:, :, 0]).sum(axis=0), strict=True)
        )
        for table, found in errors.items()
    }
    page.show(pd.DataFrame(counts))
    for table, first in (("6-3", 0), ("6-4", 1)):  # Table 6.4 repeats the row without observer
        found = _over_geometries(f"motion.table-{table}", CASES[first:], 1e6 * errors[table][:, first:])
        for claim, (ours, interval) in found.items():
            page.check(claim, ours, interval)
    marks = printed("table-6-4.ratio", CASES[1:])
    lower = {
        case: [
            np.mean(plates[np.isfinite(plates)] < level)
            for plates, level in zip(each.T, marks[case], strict=True)
        ]
        for case, each in zip(CASES[1:], np.moveaxis(ratios["6-4"], 1, 0), strict=True)
    }
    page.show(pd.DataFrame(lower, index=DIRECTIONS).T.round(2))
    unchanged = np.sum(np.nanmax(ratios["6-4"][:, 0, 1:], axis=1) >= 1)
    page.show(f"plates on which MC leaves a tilt as it was, or worse: {unchanged} of {len(study['mass'])}")
    for table, found in errors.items():
        lowest = np.all(found[:, 3:] < found[:, :3], axis=(1, 2))
        page.check(f"motion.table-{table}.both-lowest", *fraction(lowest))
    factor = np.all(errors["6-4"][:, 3] < errors["6-3"][:, 0] / 3, axis=1)
    page.check("motion.section-7-2.factor-three", *fraction(factor))
    below = np.all(errors["6-4"][:, 2] < errors["6-4"][:, 1], axis=1)
    page.check("motion.table-6-4.ad-below-mc", *fraction(below))


# === Choices of rig ===============================================================================================
# Tables 6.2 to 6.4 of the observer thesis at any reading of what chapter 6 leaves open (``choices.toml``).


GEOMETRIES = 36


def rig_tables(
    *,
    six_db_of_a_matrix: str,
    rig_plates: str,
    rig_controllers_at: str,
    rig_noise_floor: float,
    rig_feedforward: str,
    seed: int,
) -> Values:
    """Bandwidths of Table 6.2 and ratios of Tables 6.3 and 6.4 over geometries; it has no fast variant.

    `six_db_of_a_matrix` is one of `rig_loops.MEASURES`; the controllers are those of the search (``own limit``) or have
    the ``printed`` bandwidths; `rig_noise_floor` (m at the edges) is in every error; `rig_feedforward` is ``exact`` or
    ``5 % too heavy``.
    """
    noise, mass_error = published_settings().noise, 0.05 if rig_feedforward == "5 % too heavy" else 0.0
    crossing, ratios = [], []
    for loops, trajectory, designs in _study(rig_plates, six_db_of_a_matrix, seed):
        crossing.append([each.crossing_hz.mean(axis=0) for each in designs.values()])
        first, pids = loops["Original"][0], {case: each.pids for case, each in designs.items()}
        if rig_controllers_at == "printed":
            family = rig_controllers(first.decoupling.masses)
            pids = {case: family(*hz[:2]) for case, hz in printed("table-6-2").items()}
        errors = levelling_errors(loops, pids, trajectory, noise, mass_error)
        errors = np.hypot(errors, rig_noise_floor / first.decoupling.edges)
        ratios.append(errors[:, 1:] / errors[0, 0])
    original, redesigned = np.moveaxis(ratios, 1, 0)
    ratio = ratio_values("6-3", original) | ratio_values("6-4", redesigned)
    return bandwidth_values(np.array(crossing)) | ratio


def bandwidth_values(crossing: np.ndarray) -> Values:
    """Table 6.2 as the ledger has it, from (geometries, cases, 3), over those on which a case has a controller."""
    return _over_geometries("motion.table-6-2", CASES, crossing)


def ratio_values(table: str, ratios: np.ndarray) -> Values:
    """Table 6.3 or 6.4 over the original without observer, as the ledger has it, from (geometries, cases but one, 3)."""
    return _over_geometries(f"motion.table-{table}.ratio", CASES[1:], ratios)


def _over_geometries(entry: str, cases: Sequence[str], sample: np.ndarray) -> Values:
    return {
        f"{entry}.{IDS[case]}.{direction}": central(each[np.isfinite(each)])
        for case, of_case in zip(cases, np.moveaxis(sample, 1, 0), strict=True)
        for direction, each in zip(DIRECTIONS, of_case.T, strict=True)
    }


@lru_cache(maxsize=8)
def _rigs(plates: str, seed: int) -> list[tuple]:
    """Loops and trajectory of each geometry."""
    settings, rigs = published_settings(), []
    for stream in np.random.SeedSequence(seed).spawn(GEOMETRIES):
        rng = np.random.default_rng(stream)
        geometry = assumed_geometry() if plates == "one" else sample_geometry(rng)
        rigs.append((rig_loops(geometry, settings, model_errors(rng)), levelling(rng)))
    return rigs


@lru_cache(maxsize=8)  # readings that differ in the levelling share the designs
def _study(plates: str, measure: str, seed: int) -> list[tuple]:
    """And the designs."""
    return [(*rig, bandwidths(rig[0], measure)) for rig in _rigs(plates, seed)]
