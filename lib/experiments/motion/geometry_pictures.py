"""The rig's tables over geometries, and an explorer of one geometry (notebook 25)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from experiments.motion.explorer_panels import plain
from experiments.motion.rig import assumed_geometry, rig_model
from experiments.motion.rig_axes import COLOURS, MOTIONS
from workbook import figures


def paint_over_geometries(
    values: Mapping[str, np.ndarray], marks: Mapping[str, Sequence[float]], quantity: str
):
    """Spread over geometries of a quantity in three directions (NaN: none), one panel each, with the published values."""
    figure, axes = figures.new(1, 3, height=2.9, sharey=False)
    for k, axis in enumerate(axes):
        for place, (case, each) in enumerate(values.items()):
            found = each[np.isfinite(each[:, k]), k]
            rank = np.linspace(-0.22, 0.22, len(found))
            style = {"markersize": 4, "color": COLOURS[case]}
            axis.plot(place + rank, np.sort(found), ".", label=f"one geometry, {case}", **style)
            if case in marks:
                label = f"_published, {case}" if place else "published"
                figures.mark_published(axis, place, marks[case][k], label)
        axis.set_ylim(0, 1.08 * axis.dataLim.y1)
        axis.set_xticks(range(len(values)), [case.replace(" and ", "\nand ") for case in values])
        axis.set(title=f"${MOTIONS[k]}$", xlabel="use of the observer")
    axes[0].set_ylabel(quantity)
    pairs = zip(*axes[0].get_legend_handles_labels(), strict=True)
    shown = {"published" if label == "published" else "one geometry": handle for handle, label in pairs}
    figure.legend(shown.values(), shown.keys(), loc="outside lower center", ncols=2)
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
    axes[1].set(xlabel="flexible mode", ylabel=r"mode shape, rms over the plate = 1 (1)", ylim=(0, 3))
    axes[1].legend()
    return figure
