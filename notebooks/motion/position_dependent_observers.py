"""Position-dependent observers (section 4.2), one line a place, coloured along the structure (notebook 15)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from experiments.motion.designs import RETAINED, Design
from experiments.motion.machines import shapes_along, stage, stage_mass
from experiments.motion.pictures import (
    LABELS,
    add_magnitude,
    mark_limit,
    paint_limited,
    paint_magnitudes,
    plain,
)
from experiments.motion.position_dependence import GainTable, at_place, compensator_at, stage_grid
from experiments.motion.scan_study import along_scan
from stillwork.control.applications import Application
from stillwork.control.bandwidth import Loop, make_loop
from stillwork.control.discrete_damping import discrete_damping_gain
from stillwork.control.pid import Pid, PidFamily
from stillwork.estimation.observer import NoiseIntensities
from stillwork.estimation.robust import kalman_gains
from stillwork.estimation.time_varying import estimate
from stillwork.lti.modal import ModalModel
from stillwork.lti.peaks import resonance_grid
from stillwork.lti.simulation import simulate
from stillwork.lti.state_space import StateModel
from workbook import figures


def nodes(plant: ModalModel, grid: ArrayLike, mode: int) -> Float64[np.ndarray, " nodes"]:
    """Places (m) where a mode shape is zero: a sensor there does not see it, an actuator does not move it."""
    from scipy.interpolate import CubicSpline

    return CubicSpline(grid, plant.output_shapes[:, mode]).roots(extrapolate=False)


def place_loops(
    plant: ModalModel, grid: ArrayLike, places: ArrayLike, design: Design, **response_grid
) -> list[Loop]:
    """One loop a place, with the observer of that place; `response_grid` goes to `make_loop`."""
    return [
        make_loop(at_place(plant, grid, place), compensator_at(plant, grid, place, design), **response_grid)
        for place in np.asarray(places, float).tolist()
    ]


def damping_along(
    plant: ModalModel, grid: ArrayLike, places: ArrayLike, increase: float | ArrayLike, sample_time: float
) -> Float64[np.ndarray, "places 1 states"]:
    """Discrete damping gains (4.3) of an actuator that moves along the structure, solved at every place."""
    models = (at_place(plant, grid, place, "actuator") for place in np.asarray(places, float).tolist())
    return np.array(
        [discrete_damping_gain(model.modes(slice(0, RETAINED)), increase, sample_time) for model in models]
    )


def damping_table(
    plant: ModalModel, grid: ArrayLike, places: ArrayLike, increase: float | ArrayLike, sample_time: float
) -> GainTable:
    """The same gains computed beforehand on a grid of places without a node, for linear interpolation."""
    return GainTable(np.asarray(places, float), damping_along(plant, grid, places, increase, sample_time))


AMPLITUDE = 0.01  # N, of the force


@dataclass(frozen=True)
class Passage:
    """True and estimated modal position of one mode while the sensor follows a trajectory."""

    time: Float64[np.ndarray, " samples"]  # s
    truth: Float64[np.ndarray, " samples"]  # m sqrt(kg)
    estimate: Float64[np.ndarray, " samples"]  # m sqrt(kg)

    def worst(self, start: float, end: float) -> float:
        """Largest estimation error between two times (s), relative to the mode's largest motion there."""
        window = (self.time >= start) & (self.time <= end)
        size = np.abs(self.truth[window]).max()
        return float(np.abs(self.truth - self.estimate)[window].max() / size)


def move(
    start: float, wait: float, speed: float, length: float, rest: float, sample_time: float
) -> np.ndarray:
    """Places (m): stand at `start` for `wait` s, move `length` m at `speed` m/s, stand for `rest` s."""
    time = np.arange(round((wait + length / speed + rest) / sample_time) + 1) * sample_time
    return start + np.clip(speed * (time - wait), 0.0, length)


def pass_node(
    plant: ModalModel,
    grid: ArrayLike,
    places: ArrayLike,
    mode: int,
    noise: NoiseIntensities,
    sample_time: float,
    phase: float = 0.0,
) -> Passage:
    """Run the time-varying Kalman filter while an unknown force excites one mode at its resonance.

    The filter models all modes of the plant and is designed for `noise`; the sensor follows `places` (m).
    """
    places = np.asarray(places, float)
    shapes = shapes_along(plant, grid, places)
    model = along_scan(plant, sample_time, shapes, noise.process / sample_time, noise.sensor / sample_time)
    time = np.arange(len(places)) * sample_time
    force = AMPLITUDE * np.sin(plant.frequencies[mode] * time + phase)
    a, b = model.a[0], model.b[0]
    states = simulate(StateModel(a, b, np.eye(len(a)), np.zeros_like(b), sample_time), force[None])
    y = np.einsum("koi,ik->ok", model.c, states)
    found = estimate(kalman_gains(model), np.zeros((1, len(places))), y)
    return Passage(time, states[2 * mode], found[2 * mode])


def _along(loops: Mapping[float, Loop], low_hz: float, high_hz: float):
    """One grid for all places, dense at the poles of plants and compensators, and each loop's label and line."""
    from matplotlib import colormaps

    each = list(loops.values())
    poles = np.concatenate([each[0].plant.poles, *(loop.compensator.poles for loop in each[::3])])
    shades = colormaps["viridis"](np.linspace(0.0, 0.92, len(loops)))  # dark to light along the structure
    styles = [{"color": shade, "linewidth": 1.0} for shade in shades]
    lines = zip([f"{place:g} m" for place in loops], each, styles, strict=True)
    return resonance_grid(poles, low_hz, high_hz, 250, 6), list(lines)


def paint_sensitivities(
    loops: Mapping[float, Loop],
    controllers: Mapping[str, Pid],
    functions: Sequence[str] = ("input_sensitivity", "output_sensitivity"),
):
    """Loop functions, a row a controller (by the name in the title), a line a place (m), and the allowed 6 dB."""
    omega, lines = _along(loops, 10.0, 2e3)
    panels = {
        f"{LABELS[function]}{name}": {
            label: (omega, getattr(loop.at(controller, omega), function), style)
            for label, loop, style in lines
        }
        for name, controller in controllers.items()
        for function in functions
    }
    rows = len(controllers)
    return paint_limited(panels, -15, 12, 3.4 if rows == 1 else 5.2, rows)


def paint_equivalent_controllers(loops: Mapping[float, Loop], controller: Pid, dots: ArrayLike = ()):
    """Equivalent controllers from r and from y to the plant input, a line a place (m), beside the controller.

    `dots` are frequencies (rad/s) where the lines from y bear a dot, as only the last of lines on each other is seen.
    """
    omega, lines = _along(loops, 1.0, 3e3)
    broad = {"color": figures.GREY, "linewidth": 2.5}
    both = {"reference $r$": "reference_controller", "position $y$": "output_controller"}
    panels = {
        f"{source} to force $u$": {"controller": (omega, controller.frequency_response(omega), broad)}
        | {label: (omega, getattr(loop.at(controller, omega), name), style) for label, loop, style in lines}
        for source, name in both.items()
    }
    figure, axes = paint_magnitudes(panels, "magnitude (dB re 1 N/m)", height=3.4, sharey=True)
    at = np.asarray(dots, dtype=float)
    for _, loop, style in lines if at.size else ():
        dot = {"color": style["color"], "marker": "o", "markersize": 4, "linestyle": "none"}
        add_magnitude(axes[0, 1], at, loop.at(controller, at).output_controller, label="_dot", **dot)
    axes[0, 0].legend(ncols=2, fontsize=7)
    return figure


def paint_observers(loops: Mapping[float, Loop]):
    """Observers from u and from y to the damping force and to the estimated deformation, a line a place (Fig. 4.2)."""
    omega, lines = _along(loops, 1.0, 3e3)
    found = [(label, loop.compensator.frequency_response(omega), style) for label, loop, style in lines]
    units = {
        "$u$ to $u_d$": "N/N",
        "$y$ to $u_d$": "N/m",
        r"$u$ to $\hat y_{flex}$": "m/N",
        r"$y$ to $\hat y_{flex}$": "m/m",
    }
    panels = {
        title: {label: (omega, response[divmod(k, 2)], style) for label, response, style in found}
        for k, title in enumerate(units)
    }
    figure, axes = paint_magnitudes(panels, rows=2, height=5.0, sharex=True)
    for axis, unit in zip(axes.ravel(), units.values(), strict=True):
        axis.set_ylabel(f"magnitude (dB re 1 {unit})")
    axes[0, 0].legend(ncols=2, fontsize=7)
    return figure


def paint_place(place: float, damping: float, compensate: str, noise_exponent: float, bandwidth_hz: float):
    """Explorer: equivalent controller and output sensitivity with the sensor at one place of the stage."""
    from matplotlib.ticker import NullLocator

    application = Application(compensate == "yes", damping)
    design = Design(application if damping or compensate == "yes" else None, 10.0**noise_exponent)
    loop = place_loops(stage(), stage_grid(), [place], design, points=150, around=6)[0]
    controller = PidFamily(stage_mass())(bandwidth_hz)
    shown = (loop.omega > 2 * np.pi * 5) & (loop.omega < 2 * np.pi * 3e3)
    omega = loop.omega[shown]
    response = loop.at(controller, omega)
    margins = {"left": 0.09, "bottom": 0.16, "right": 0.985, "top": 0.91, "wspace": 0.2}
    figure, (left, right) = plain(2, 3.0, **margins)
    original = controller.frequency_response(omega)
    add_magnitude(left, omega, original, color=figures.GREY, linewidth=2.5, label="controller")
    add_magnitude(left, omega, response.output_controller, label="equivalent, $y$ to $u$")
    add_magnitude(right, omega, response.input_sensitivity, label="input sensitivity")
    add_magnitude(right, omega, response.output_sensitivity, label="output sensitivity")
    mark_limit(right)
    right.set(ylim=(-20, 15), title="stable" if loop.is_stable(controller) else "unstable")
    for axis, unit in ((left, "dB re 1 N/m"), (right, "dB")):
        axis.set(xlabel="frequency (Hz)", ylabel=f"magnitude ({unit})")
        axis.xaxis.set_minor_locator(NullLocator())
        axis.legend(fontsize=7)
    return figure
