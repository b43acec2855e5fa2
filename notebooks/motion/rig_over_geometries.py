"""The rig over geometries: what this notebook alone needs."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from matplotlib.lines import Line2D

from experiments.motion.intervals import Values, central
from experiments.motion.pictures import plain
from experiments.motion.rig import assumed_geometry, rig_model
from experiments.motion.rig_designs import (
    CASES,
    COLOURS,
    MOTIONS,
    bandwidths,
    model_errors,
    published_settings,
    rig_loops,
)
from experiments.motion.rig_study import levelling, levelling_errors, printed_controllers, sample_geometry
from workbook import figures

# === Geometry pictures ============================================================================================
# The rig's tables over geometries, and an explorer of one geometry (notebook 25).


def paint_over_geometries(
    values: Mapping[str, np.ndarray], marks: Mapping[str, Sequence[float]], quantity: str
):
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


# === Choices of rig ===============================================================================================
# Tables 6.2 to 6.4 of the observer thesis at any reading of what chapter 6 leaves open (``choices.toml``).


DIRECTIONS = ("z", "rx", "ry")
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
        first = loops["Original"][0]
        if rig_controllers_at == "printed":
            pids = printed_controllers(first)
        else:
            pids = {case: each.pids for case, each in designs.items()}
        errors = levelling_errors(loops, pids, trajectory, noise, mass_error)
        errors = np.hypot(errors, rig_noise_floor / first.decoupling.edges)
        ratios.append(errors[:, 1:] / errors[0, 0])
    crossing, ratios = np.array(crossing), np.array(ratios)
    found: Values = {}
    for k, case in enumerate(CASES):
        name = case.lower().replace(" and ", "-")
        for d, direction in enumerate(DIRECTIONS):
            found[f"motion.table-6-2.{name}.{direction}"] = _of_feasible(crossing[:, k, d])
            if k:
                for t, table in enumerate(("6-3", "6-4")):
                    entry = f"motion.table-{table}.ratio.{name}.{direction}"
                    found[entry] = _of_feasible(ratios[:, t, k - 1, d])
    return found


def _of_feasible(sample: np.ndarray) -> float | tuple[float, tuple[float, float]]:
    """Of the geometries on which the case has a controller."""
    return central(sample[~np.isnan(sample)])


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
