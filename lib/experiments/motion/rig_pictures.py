"""Figures of the over-actuated rig, and the drawings behind its explorers."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from experiments.motion.pictures import add_magnitude, paint_magnitudes, plain
from experiments.motion.rig import POSITIONS, Geometry, assumed_geometry, plate_modes, published, rig_model
from experiments.motion.rig_designs import CASES, published_settings, rig_loops
from experiments.motion.rig_identification import predicted_deviation, true_response
from experiments.motion.rig_loops import RigLoop
from stillwork.estimation.observer import NoiseIntensities
from stillwork.lti.peaks import resonance_grid
from stillwork.signals.spectra import Spectrum
from stillwork.workbook import figures

COLOURS = dict(zip(CASES, (figures.BLACK, figures.BLUE, figures.GREEN, figures.RED), strict=True))
FORCES, MOTIONS = ("F_z", "M_x", "M_y"), ("z", "r_x", "r_y")
UNITS = (("m/N", "m/Nm", "m/Nm"), ("rad/N", "rad/Nm", "rad/Nm"), ("rad/N", "rad/Nm", "rad/Nm"))


def frequencies(
    low_hz: float = 5.0, high_hz: float = 2000.0, points: int = 200, around: int = 15
) -> np.ndarray:
    """Frequencies of the figures (rad/s), dense around the published modes."""
    p = published()
    w, z = 2 * np.pi * np.array(p["frequencies_hz"]), np.array(p["damping"])
    return resonance_grid(w * (-z + 1j), low_hz, high_hz, points, around)


def physical_plant(loop: RigLoop, geometry: Geometry) -> np.ndarray:
    """Decoupled plant from (Fz, Mx, My) to (z, rx, ry) in SI units, shape (3, 3, frequencies)."""
    edges = geometry.edges
    return loop.equivalent_plant() / edges[:, None, None] / edges[None, :, None]


def places(axis, geometry: Geometry, shape: np.ndarray | None = None) -> None:
    """Plate, actuators and sensors seen from above, over the contours of a mode shape."""
    x, y = geometry.half
    if shape is not None:
        grid = np.linspace(-1, 1, len(shape))
        largest = np.abs(shape).max()
        axis.contourf(
            grid * x, grid * y, shape.T, levels=np.linspace(-largest, largest, 12), cmap="RdBu_r", alpha=0.7
        )
    axis.plot([-x, x, x, -x, -x], [-y, -y, y, y, -y], color=figures.GREY, linewidth=0.8)
    used = geometry.actuator_places[list(geometry.used)]
    idle = geometry.actuator_places[[geometry.left_out]]
    axis.plot(*used.T, "o", color=figures.BLACK, markersize=5, markerfacecolor="none", label="actuator")
    axis.plot(*idle.T, "o", color=figures.GREY, markersize=2, label="actuator, idle")
    axis.plot(*geometry.sensor_places.T, "x", color=figures.BLACK, markersize=4, label="sensor")
    axis.set_aspect("equal")
    axis.grid(False)


def paint_mode_shapes(geometry: Geometry):
    """The eight flexible modes with the published frequencies."""
    p = published()
    modes = plate_modes(geometry.width / geometry.length, geometry.poisson, 8)
    grid = np.linspace(-1, 1, 25)
    xi, eta = (g.ravel() for g in np.meshgrid(grid, grid, indexing="ij"))
    shapes = modes.shapes(xi, eta).reshape(25, 25, 8)
    figure, axes = figures.new(2, 4, height=3.9, sharex=True, sharey=True)
    for k, axis in enumerate(axes.ravel()):
        places(axis, geometry, shapes[:, :, k])
        axis.set_title(f"mode {k + 1}, {p['frequencies_hz'][k]:.0f} Hz")
    figures.label(axes, "x (m)", "y (m)")
    figures.legend_below(axes[0, 0], 3)
    return figure


def paint_decoupled_plants(loops: Sequence[RigLoop], geometry: Geometry):
    """All nine entries of the decoupled plant at the four positions: Figs 6.3 and 6.5 to 6.7."""
    figure, axes = figures.new(3, 3, height=6.2, sharex=True, sharey=False)
    for number, loop in enumerate(loops, 1):
        plant = physical_plant(loop, geometry)
        for place in np.ndindex(3, 3):
            # Thinner and thinner: on a symmetric plate positions coincide.
            width = (4.0, 2.6, 1.4, 0.6)[number - 1]
            add_magnitude(axes[place], loop.omega, plant[place], linewidth=width, label=f"position {number}")
    for i, j in np.ndindex(3, 3):
        axes[i, j].set_title(f"${FORCES[j]}$ to ${MOTIONS[i]}$")
        axes[i, j].set_ylabel(f"magnitude (dB re 1 {UNITS[i][j]})", fontsize=7)
    figures.label(axes, "frequency (Hz)")
    # Nine panels with axes of their own: the constrained layout would take longer than all the rest.
    figure.set_layout_engine(None)
    figure.subplots_adjust(left=0.09, right=0.99, bottom=0.12, top=0.96, wspace=0.4, hspace=0.28)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="lower center", ncols=4)
    return figure


def paint_one_entry(loops: Mapping[str, Sequence[RigLoop]], geometry: Geometry, to: int):
    """From F_z to one direction of the decoupled plant under the four uses of the observer: Figs 6.8 and 6.9."""
    figure, axes = figures.new(2, 2, height=4.6, sharex=True, sharey=True)
    for case, each in loops.items():
        for axis, loop in zip(axes.ravel(), each, strict=True):
            response = physical_plant(loop, geometry)[to, 0]
            add_magnitude(axis, loop.omega, response, color=COLOURS[case], linewidth=0.9, label=case)
    for number, axis in enumerate(axes.ravel(), 1):
        axis.set_title(f"position {number}")
    figures.label(axes, "frequency (Hz)", f"$F_z$ to ${MOTIONS[to]}$\n(dB re 1 {UNITS[to][0]})")
    figures.legend_below(axes[0, 0], 4)
    return figure


def paint_tracking_errors(errors: Mapping[str, np.ndarray], reference: np.ndarray, sample_time: float):
    """True errors (m and rad) over one period with the scaled trajectory in black: Figs 6.10 and 6.11."""
    figure, axes = figures.new(3, 1, height=5.2, sharex=True)
    every = 10  # samples between those drawn: the errors are slow
    time = np.arange(reference.shape[1])[::every] * sample_time
    for k, axis in enumerate(axes):
        largest = max(np.abs(error[k]).max() for error in errors.values()) * 1e6
        scale = largest / np.abs(reference[k]).max()
        style = {"color": figures.BLACK, "linewidth": 0.8}
        axis.plot(time, scale * reference[k, ::every], label="trajectory, scaled", **style)
        for order, (case, error) in enumerate(errors.items()):
            width = 1.9 - 0.45 * order  # lines that coincide stay visible
            axis.plot(time, 1e6 * error[k, ::every], color=COLOURS[case], linewidth=width, label=case)
        axis.set_ylabel(f"error in ${MOTIONS[k]}$ ({'µm' if k == 0 else 'µrad'})")
    axes[-1].set_xlabel("time (s)")
    figures.legend_below(axes[0], 5)
    return figure


def paint_error_spectra(spectra: Mapping[str, Spectrum]):
    """Amplitude spectra of the true errors in three directions: what Fig. 6.10 does not let one see."""
    figure, axes = figures.new(1, 3, height=2.7, sharex=True)
    for order, (case, each) in enumerate(spectra.items()):
        drawn = (each.frequencies_hz >= 2) & (each.frequencies_hz <= 2000)
        style = {"color": COLOURS[case], "linewidth": 2.4 - 0.6 * order, "label": case}  # all stay visible
        for axis, density in zip(axes, each.density, strict=True):
            axis.loglog(each.frequencies_hz[drawn], 1e6 * np.sqrt(density[drawn]), **style)
    figures.label(axes, "frequency (Hz)")
    for k, axis in enumerate(axes):
        axis.set(title=f"${MOTIONS[k]}$", ylabel=f"error ({'µm' if k == 0 else 'µrad'}/√Hz)")
    figures.legend_below(axes[0], 4)
    return figure


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


ENTRIES = {"Fz to z": 0, "Fz to rx": 1}


def paint_rig(
    use: str = "MC and AD",
    entry: str = "Fz to z",
    target_damping: float = 0.04,
    sensor_exponent: float = -18.0,
    position: int = 1,
):
    """Explorer: one entry of what the controller sees, with and without one use of the observer."""
    geometry, settings, row = assumed_geometry(), published_settings(), ENTRIES[entry]
    noise = NoiseIntensities(settings.noise.process, 10**sensor_exponent)
    settings = replace(settings, noise=noise, target_damping=target_damping)
    omega = frequencies(20.0, points=80, around=5)
    loops = rig_loops(geometry, settings, None, [POSITIONS[position - 1]], omega, ("Original", use))
    figure, axis = plain()
    for name, (loop, *_) in loops.items():
        response = physical_plant(loop, geometry)[row, 0]
        add_magnitude(axis, omega, response, color=COLOURS[name], label=name)
    axis.set(xlabel="frequency (Hz)", ylabel=f"$F_z$ to ${MOTIONS[row]}$ (dB re 1 {UNITS[row][0]})")
    axis.legend()
    return figure


def paint_geometry(
    aspect: float = 0.83, along_x: float = 0.85, along_y: float = 0.75, actuators: float = 0.9
):
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
    axes[0].set_aspect("equal")
    axes[0].set(xlabel="x (m)", ylabel="y (m)", title="circles: actuators, crosses: sensors")
    number = np.arange(1, 9)
    for shift, shapes, colour, label in (
        (-0.15, np.abs(model.input_shapes[3:]).max(axis=1), figures.RED, "largest at an actuator"),
        (0.15, np.abs(model.output_shapes[:, 3:]).max(axis=0), figures.BLUE, "largest at a sensor"),
    ):
        axes[1].bar(number + shift, shapes * size, 0.3, color=colour, label=label)
    axes[1].set(xlabel="flexible mode", ylabel=r"mode shape, rms over the plate = 1 (1)", ylim=(0, 3))
    axes[1].legend()
    return figure


def paint_identified(omega: np.ndarray, measured: np.ndarray, model: np.ndarray, deviation: np.ndarray):
    """Actuator 1 to all sensors: measured, fitted, what is left, and what the noise explains: Fig. 6.4."""
    lines = {
        "measured": (measured, {"color": figures.GREEN, "linewidth": 1.6}),
        "model": (model, {"color": figures.BLUE, "linewidth": 0.8}),
        "difference": (measured - model, {"color": figures.GREY, "linewidth": 0.4}),
        "least from noise": (deviation, {"color": figures.BLACK, "linewidth": 0.8, "linestyle": "--"}),
    }
    panels = {
        f"sensor {k + 1}": {name: (omega, values[:, k, 0], style) for name, (values, style) in lines.items()}
        for k in range(4)
    }
    quantity = "actuator 1 to sensor\n(dB re 1 m/N)"
    figure, axes = paint_magnitudes(panels, quantity, rows=2, height=5.0, sharex=True, sharey=True)
    figures.legend_below(axes[0, 0], 4)
    return figure


def paint_identification(
    rms: float = 1.0, averages: int = 20, bandwidth_hz: float = 4.0, sensor_exponent: float = -18.0
):
    """Explorer: response of the rig, and the deviation that an identification in closed loop leaves."""
    geometry, settings = assumed_geometry(), published_settings()
    settings = replace(settings, noise=NoiseIntensities(settings.noise.process, 10**sensor_exponent))
    omega = frequencies(1.0, 1500.0, points=90, around=5)
    response = true_response(geometry, settings, omega)
    deviation = predicted_deviation(geometry, settings, bandwidth_hz, omega, rms, averages)
    figure, axis = plain()
    add_magnitude(axis, omega, response[:, 2, 0], color=figures.BLUE, label="response")
    add_magnitude(axis, omega, deviation[:, 2, 0], ls="--", color=figures.BLACK, label="least deviation")
    axis.set(xlabel="frequency (Hz)", ylabel="actuator 1 to sensor 3 (dB re 1 m/N)")
    axis.legend()
    return figure
