"""The loops of the over-actuated rig and its tracking, and an explorer of one entry (notebook 24)."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float64
from numpy.typing import ArrayLike
from scipy import linalg, signal
from scipy.optimize import linear_sum_assignment

from experiments.motion.intervals import Values
from experiments.motion.pictures import add_magnitude, paint_magnitudes, plain
from experiments.motion.rig import POSITIONS, Geometry, assumed_geometry, plate_modes, published
from experiments.motion.rig_designs import (
    COLOURS,
    FORCES,
    MOTIONS,
    frequencies,
    published_settings,
    rig_loops,
)
from experiments.motion.rig_loops import RigLoop
from experiments.motion.rig_study import Levelling, lines_of, to_error
from stillwork.base.checks import InputError
from stillwork.control.discrete_damping import sampled_feedback
from stillwork.control.feedback import fed_back
from stillwork.control.pid import Pid
from stillwork.estimation.observer import NoiseIntensities
from stillwork.lti.discretisation import zoh_modes
from stillwork.lti.modal import ModalModel
from stillwork.lti.simulation import simulate
from stillwork.signals.spectra import Spectrum
from workbook import figures


def sampled_damping(
    model: ModalModel, gains: Float64[np.ndarray, "inputs flexible"], sample_time: float
) -> tuple[Float64[np.ndarray, " flexible"], Float64[np.ndarray, " flexible"]]:
    """Damping ratios under u = K eta_dot on true states: of the continuous and of the sampled flexible modes.

    What a gain designed in continuous time gives when its force is held over a sample (section 4.1.2), sorted by
    the frequency of the continuous modes; each sampled mode stands beside the continuous one nearest to it.
    """
    rigid = model.rigid_modes
    gain = np.zeros((gains.shape[0], 2 * len(model.frequencies)))
    gain[:, 2 * rigid + 1 :: 2] = gains
    continuous, sampled = fed_back(model, gain), sampled_feedback(model, gain, sample_time)
    poles = [
        (each.frequencies * (-each.damping + 1j * np.sqrt(1 - each.damping**2)))[rigid:]
        for each in (continuous, sampled)
    ]
    nearest = linear_sum_assignment(np.abs(poles[0][:, None] - poles[1]))[1]
    return continuous.damping[rigid:], sampled.damping[rigid:][nearest]


def placed_damping(model: ModalModel, target: float, sample_time: float) -> Float64[np.ndarray, " flexible"]:
    """Damping ratios that pole placement on the sampled flexible modes reaches (section 4.1.2), ascending frequency.

    The frequencies stay, all damping ratios shall become `target`. The gain acts on positions too.
    """
    flexible = model.modes(slice(model.rigid_modes, None))
    held = zoh_modes(flexible, sample_time)
    upper = np.exp(flexible.frequencies * (-target + 1j * np.sqrt(1 - target**2)) * sample_time)
    with warnings.catch_warnings():
        # The poles are placed all the same; only their most robust eigenvectors were still being looked for.
        warnings.filterwarnings("ignore", message="Convergence was not reached")
        try:
            gain = signal.place_poles(held.a, held.b, np.concatenate([upper, upper.conj()])).gain_matrix
        except ValueError as error:
            raise InputError(f"the poles of model cannot be placed ({error}); leave modes out") from None
    poles = np.log(linalg.eigvals(held.a - held.b @ gain).astype(complex)) / sample_time
    poles = poles[poles.imag > 0]
    poles = poles[np.argsort(np.abs(poles))]
    return -poles.real / np.abs(poles)


def compensated_feedback(loop: RigLoop, pids: Sequence[Pid]) -> float:
    """Largest singular value over frequency of O_yu C_fb, which section 6.3 keeps below 1 (scaled directions)."""
    o_yu = np.moveaxis(loop.compensator.frequency_response(loop.omega)[3:, :3], -1, 0)
    seen = loop.decoupling.sensing @ o_yu @ loop.decoupling.actuation * loop.controlled(pids)[:, None, :]
    return float(np.linalg.norm(seen, 2, axis=(1, 2)).max())


UNITS = (("m/N", "m/Nm", "m/Nm"), ("rad/N", "rad/Nm", "rad/Nm"), ("rad/N", "rad/Nm", "rad/Nm"))


def levelling_error(
    loop: RigLoop,
    pids: Sequence[Pid],
    trajectory: Levelling,
    noise: NoiseIntensities,
    rng: np.random.Generator,
    periods: int = 1,
) -> Float64[np.ndarray, "3 samples"]:
    """True error over the last period (m, rad, rad), simulated with noise after `periods` periods of settling."""
    model = to_error(loop, pids)
    count = round(trajectory.period / loop.sample_time)
    if abs(count * loop.sample_time - trajectory.period) > 1e-9 * trajectory.period:
        raise InputError("period of the trajectory is not a multiple of the sample time; change one of them")
    time = np.arange((periods + 1) * count) * loop.sample_time
    known = (lines_of(trajectory, loop) @ np.exp(1j * np.outer(trajectory.omega, time))).real
    sizes = np.sqrt(np.repeat([noise.process, noise.sensor], 3))
    random = sizes[:, None] * rng.standard_normal((6, len(time)))
    inputs = np.vstack([known[:3], known[3:] + random[:3], random[3:]])
    return simulate(model, inputs)[:, -count:]


def physical_plant(loop: RigLoop) -> np.ndarray:
    """Decoupled plant from (Fz, Mx, My) to (z, rx, ry) in SI units, shape (3, 3, frequencies)."""
    edges = loop.decoupling.edges
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
    axis.plot(*idle.T, "s", color=figures.BLACK, markersize=4, label="actuator, idle")
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


def paint_decoupled_plants(loops: Sequence[RigLoop]):
    """All nine entries of the decoupled plant at the four positions: Figs 6.3 and 6.5 to 6.7."""
    figure, axes = figures.new(3, 3, height=6.2, sharex=True, sharey=False)
    for number, loop in enumerate(loops, 1):
        plant = physical_plant(loop)
        for place in np.ndindex(3, 3):
            # Thinner and thinner: on a symmetric plate positions coincide.
            width = (3.0, 2.1, 1.3, 0.6)[number - 1]
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


def paint_one_entry(loops: Mapping[str, Sequence[RigLoop]], to: int):
    """From F_z to one direction of the decoupled plant under the four uses of the observer: Figs 6.8 and 6.9."""
    panels = {f"position {number}": {} for number in range(1, 5)}
    for case, each in loops.items():
        for lines, loop in zip(panels.values(), each, strict=True):
            width = 1.8 if case == "Original" else 0.9  # AD lies on it between resonances
            lines[case] = (
                loop.omega,
                physical_plant(loop)[to, 0],
                {"color": COLOURS[case], "linewidth": width},
            )
    quantity = f"$F_z$ to ${MOTIONS[to]}$\n(dB re 1 {UNITS[to][0]})"
    figure, axes = paint_magnitudes(panels, quantity, rows=2, height=4.6, sharex=True, sharey=True)
    figures.legend_below(axes[0, 0], 4)
    return figure


def paint_tracking_errors(
    errors: Mapping[str, np.ndarray],
    reference: np.ndarray,
    sample_time: float,
    widths: Sequence[float] = (1.2, 1.2, 1.2, 0.8),
):
    """True errors (m and rad) over one period with the scaled trajectory dashed: Figs 6.10 and 6.11."""
    figure, axes = figures.new(3, 1, height=5.2, sharex=True)
    every = 10  # samples between those drawn: the errors are slow
    time = np.arange(reference.shape[1])[::every] * sample_time
    for k, axis in enumerate(axes):
        largest = max(np.abs(error[k]).max() for error in errors.values()) * 1e6
        scale = largest / np.abs(reference[k]).max()
        style = {"color": figures.GREY, "linewidth": 1.0, "linestyle": "--"}
        axis.plot(time, scale * reference[k, ::every], label="trajectory, scaled", **style)
        for width, (case, error) in zip(widths, errors.items(), strict=True):
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
        style = {"color": COLOURS[case], "linewidth": 3.6 - order, "label": case}  # all stay visible
        for axis, density in zip(axes, each.density, strict=True):
            axis.loglog(each.frequencies_hz[drawn], 1e6 * np.sqrt(density[drawn]), **style)
    figures.label(axes, "frequency (Hz)")
    for k, axis in enumerate(axes):
        axis.set(title=f"${MOTIONS[k]}$", ylabel=f"error ({'µm' if k == 0 else 'µrad'}/√Hz)")
    figures.legend_below(axes[0], 4)
    return figure


ENTRIES = {"Fz to z": 0, "Fz to rx": 1}


def paint_rig(use: str, entry: str, target_damping: float, sensor_exponent: float, position: int):
    """Explorer: one entry of what the controller sees, with and without one use of the observer."""
    settings, row = published_settings(), ENTRIES[entry]
    noise = NoiseIntensities(settings.noise.process, 10**sensor_exponent)
    settings = replace(settings, noise=noise, target_damping=target_damping)
    omega = frequencies(20.0, points=80, around=5)
    loops = rig_loops(assumed_geometry(), settings, None, [POSITIONS[position - 1]], omega, ("Original", use))
    figure, axis = plain()
    for name, (loop, *_) in loops.items():
        add_magnitude(axis, omega, physical_plant(loop)[row, 0], color=COLOURS[name], label=name)
    axis.set(xlabel="frequency (Hz)", ylabel=f"$F_z$ to ${MOTIONS[row]}$ (dB re 1 {UNITS[row][0]})")
    axis.legend()
    return figure


def positions_apart(plants: ArrayLike, omega: np.ndarray) -> Bool[np.ndarray, "pairs 3 3"]:
    """Which entries of two positions' decoupled plants differ by more than 3 dB somewhere above 100 Hz (Fig. 6.3)."""
    level = 20 * np.log10(np.abs(plants))[..., omega > 2 * np.pi * 100]
    pairs = [(i, j) for i in range(len(level)) for j in range(i)]
    return np.array([np.abs(level[i] - level[j]).max(axis=-1) for i, j in pairs]) > 3


def positions(*, plate_aspect: float, rig_sensors: float, seed: int) -> Values:
    """How many of them, on another plate; it has no fast variant."""
    base = assumed_geometry()
    geometry = replace(base, width=plate_aspect * base.length, sensors=(rig_sensors, base.sensors[1]))
    loops = rig_loops(geometry, published_settings(), omega=frequencies(), cases=("Original",))
    apart = positions_apart([loop.equivalent_plant() for loop in loops["Original"]], frequencies())
    return {"motion.fig-6-3.positions-apart": float(np.mean(apart))}
