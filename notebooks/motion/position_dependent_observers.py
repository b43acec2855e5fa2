"""Position-dependent observers (section 4.2), one line a place, coloured along the structure (notebook 15)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float64
from numpy.typing import ArrayLike

from experiments.motion.designs import DAMPING, DESIGNS, Design
from experiments.motion.machines import published_noise, shapes_along, stage, stage_mass
from experiments.motion.pictures import (
    LABELS,
    add_magnitude,
    decibel,
    highest,
    labelled_lines,
    mark_limit,
    paint_limited,
    paint_magnitudes,
    plain,
)
from experiments.motion.position_dependence import at_place, compensator_at, stage_grid
from experiments.motion.scan_study import along_scan
from stillwork.control.applications import Application
from stillwork.control.bandwidth import Loop, make_loop
from stillwork.control.pid import Pid, PidFamily
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


def observer_loops(
    plant: ModalModel, grid: ArrayLike, noise_model: float, both_noise_model: float, selectivity: float
) -> dict[str, dict[float, Loop]]:
    """The loops of every use of the observer at the masses, by use and place (m); noise models of MC and of both."""
    places = [float(round(place, 9)) for place in np.asarray(grid)]
    designs = {
        "bare": Design(),
        "MC": Design(Application(compensate=True), noise_model),
        "AD": DESIGNS["AD, no band-pass"],
        "AD, band-pass": Design(Application(damping=DAMPING, selectivity=selectivity)),
        "MC and AD": Design(Application(compensate=True, damping=DAMPING), both_noise_model),
    }
    return {
        name: dict(zip(places, place_loops(plant, grid, places, each, points=300, around=20), strict=True))
        for name, each in designs.items()
    }


AMPLITUDE, WAIT, REACH = (
    0.01,
    0.3,
    0.05,
)  # of the force (N); before the sensor moves (s), and from the node (m)


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
    plant: ModalModel, grid: ArrayLike, places: ArrayLike, mode: int, sample_time: float, phase: float = 0.0
) -> Passage:
    """Run the time-varying Kalman filter while an unknown force excites one mode at its resonance.

    The filter models all modes of the plant, with the noise of section 3.1; the sensor follows `places` (m).
    """
    noise = published_noise()
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
    printed_hz: float | None = None,
):
    """Loop functions, a row a controller (by the name in the title), a line a place (m), and the allowed 6 dB.

    `printed_hz` is where the text has the peak of the last function.
    """
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
    figure = paint_limited(panels, -15, 12, 3.4 if rows == 1 else 5.2, rows)
    for axis in figure.axes[len(functions) - 1 :: len(functions)] if printed_hz else ():
        axis.axvline(printed_hz, color=figures.BLACK, linestyle=":", linewidth=1.0, label="_printed")
        axis.annotate("printed peak", (1.05 * printed_hz, 10), fontsize=7)
    return figure


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


def paint_node(runs: Mapping[str, Passage], left_at: float):
    """True and estimated motion of the first mode, a panel a trajectory of the sensor."""
    titles = {
        "passing": "passing the node at the black line",
        "staying": "standing on the node until the black line",
    }
    figure, axes = figures.new(2, 1, height=4.2, sharex=True)
    for axis, (name, one) in zip(axes, runs.items(), strict=True):
        shown = one.time >= 0.2
        lines = {"true": one.truth, "estimated": one.estimate, "error": one.truth - one.estimate}
        for (label, values), colour in zip(
            lines.items(), (figures.GREY, figures.BLUE, figures.RED), strict=True
        ):
            axis.plot(one.time[shown], 1e9 * values[shown], color=colour, linewidth=0.9, label=label)
        axis.axvline(left_at, color=figures.BLACK, linewidth=0.8)
        axis.set(title=titles[name], ylabel="first mode (nm √kg)")
    axes[1].set_xlabel("time (s)")
    figures.legend_below(axes[1], 3)
    return figure


def peak_table(loops: Mapping[str, Mapping[float, Loop]], controllers: Mapping[str, Pid]) -> pd.DataFrame:
    """Peaks of S_O over the places, and how far S_O and the gain from y spread at 100 Hz, a row a use and controller."""
    at, rows = np.array([2 * np.pi * 100.0]), {}
    for title, used in controllers.items():
        for name in ("MC", "AD", "AD, band-pass", "MC and AD"):
            tops = [loop.peak(used, "output_sensitivity") for loop in loops[name].values()]
            near = [loop.at(used, at) for loop in loops[name].values()]
            hertz = [top.omega / (2 * np.pi) for top in tops]
            rows[name + title] = {
                "peak of S_O, lowest (Hz)": min(hertz),
                "median (Hz)": np.median(hertz),
                "highest (Hz)": max(hertz),
                "its spread (dB)": np.ptp([decibel(top.magnitude) for top in tops]),
                "S_O at 100 Hz, spread (dB)": np.ptp([decibel(each.output_sensitivity)[0] for each in near]),
                "gain from y there (dB)": np.ptp([decibel(each.output_controller)[0] for each in near]),
            }
    return pd.DataFrame(rows).T


# === The appendix =================================================================================================


def appendix(
    page,
    *,
    plant: ModalModel,
    grid: np.ndarray,
    loops: Mapping[str, Mapping[float, Loop]],
    controllers: Mapping[str, Pid],
    table: pd.DataFrame,
    damped,
    compensated,
    runs: Mapping[str, Sequence[Passage]],
    left_at: float,
    noise_model: float,
) -> None:
    """What the page of motion/15 judges beside its answer."""
    controller = next(iter(controllers.values()))
    resonances = plant.frequencies[1:4]
    bare = paint_sensitivities(loops["bare"], {"": controller}, ["input_sensitivity"])
    _of_the_bare_loop(page, bare, controller)
    _of_the_observer(page, loops["MC and AD"], resonances)
    _of_compensation(page, plant, loops, controller, compensated, bare)
    _of_damping(page, loops, controller, table, damped, highest(bare.axes[0], 300)[:, 1])
    _of_both(page, plant, grid, loops, controllers, noise_model)
    _of_the_node(page, runs, left_at)


def _of_the_bare_loop(page, bare, controller: Pid) -> None:
    page.text("""## Without an observer

Sensitivity at the seven masses with the original controller (Fig. 4.1a); the controllers from $r$ and from $y$ are one (Fig. 4.1b).""")
    page.save("fig-4-1a", bare)
    omega = 2 * np.pi * np.geomspace(1.0, 1e3, 400)
    figure, axis = figures.new(1, 1, height=2.6)
    response = decibel(controller.frequency_response(omega))
    axis.semilogx(omega / (2 * np.pi), response, label="$r$ to $u$", linewidth=4, color=figures.SKY)
    axis.semilogx(omega / (2 * np.pi), response, "--", label="$-y$ to $u$", color=figures.BLACK)
    axis.set(xlabel="frequency (Hz)", ylabel="magnitude (dB re 1 N/m)")
    axis.legend()
    page.save("fig-4-1b", figure)


def _of_the_observer(page, loops: Mapping[float, Loop], resonances: np.ndarray) -> None:
    page.text("""## The observer (Fig. 4.2)

The damping gain $K$ is the same everywhere, but the transfer to $u_d$ varies with compliance and observer gain. From $y$ over from
$u$ (dB), medians and, at the resonances, range:""")
    page.save("fig-4-2", paint_observers(loops))
    band = 2 * np.pi * np.geomspace(10.0, 1e3, 300)
    found = np.array([loop.compensator.frequency_response(band) for loop in loops.values()])
    ratio = decibel(found[:, :, 1] / found[:, :, 0])
    page.check("motion.section-4-2-1.ratio", np.median(ratio), np.quantile(ratio, [0.025, 0.975]))
    medians = {
        "u_d": np.median(ratio[:, 0]),
        "y_flex": np.median(ratio[:, 1]),
        "both, from 100 Hz on": np.median(ratio[..., band > 2 * np.pi * 100]),
    }
    page.show(pd.Series(medians).round(1))
    found = np.array([loop.compensator.frequency_response(resonances) for loop in loops.values()])
    spread = np.ptp(decibel(found[:, 0, 0]), axis=0)
    page.check("motion.section-4-2-1.varies", np.mean(spread > 1.0))
    page.show(f"u to u_d at the resonances, spread over the masses (dB): {np.round(spread, 1)}")
    ratio = decibel(found[:, :, 1] / found[:, :, 0])
    page.show(f"from y over from u there (dB): {ratio.min():.0f} to {ratio.max():.0f}")


def _of_compensation(page, plant: ModalModel, loops, controller: Pid, compensated, bare) -> None:
    page.text("""## Measurement compensation

The gain from $y$ over that of the controller (dB), $S_I$ near the resonances and $S_O$ above 300 Hz, at each mass:""")
    resonances = plant.frequencies[1:4]
    original = controller.frequency_response(resonances)
    depth = np.array(
        [
            decibel(loop.at(controller, resonances).output_controller / original)
            for loop in loops["MC"].values()
        ]
    )
    visible, modes = np.abs(plant.output_shapes[:, 1:4]), np.arange(3)
    page.check("motion.fig-4-3.anti-resonance", np.mean(depth < 0))
    most, least = visible.argmax(axis=0), visible.argmin(axis=0)
    page.check("motion.fig-4-3.depth", np.mean(depth[most, modes] < depth[least, modes]))
    names = [f"{place:g} m" for place in loops["MC"]]
    columns = [f"{f:.0f} Hz" for f in resonances / (2 * np.pi)]
    page.show(pd.DataFrame(depth, index=names, columns=columns).round(1))
    shown = [highest(compensated.axes[0], 0.95 * f, 1.05 * f)[:, 1] for f in resonances / (2 * np.pi)]
    page.check("motion.fig-4-4.input-suppressed", np.mean(np.array(shown) < 1.0))
    near = np.concatenate([np.linspace(0.95, 1.05, 401) * w for w in resonances])
    for name in ("bare", "MC"):
        found = [decibel(each.at(controller, near).input_sensitivity) for each in loops[name].values()]
        peaks = np.max([each.reshape(3, -1).max(axis=1) for each in found], axis=0)
        page.show(
            f"S_I within 5 % of a resonance, largest over the masses (dB), {name}: {peaks.round(1) + 0.0}"
        )
    without = highest(bare.axes[0], 300)[:, 1]  # S_O is S_I there
    reduced = highest(compensated.axes[1], 300)[:, 1] < without
    page.check("motion.fig-4-4.output-reduced", np.mean(reduced[without > 1.0]))
    high = {
        name: [
            decibel(loop.at(controller).output_sensitivity)[loop.omega > 2 * np.pi * 300].max()
            for loop in each.values()
        ]
        for name, each in loops.items()
    }
    page.show(pd.DataFrame(high, index=names).round(1))


def _of_damping(page, loops, controller: Pid, table: pd.DataFrame, damped, without: np.ndarray) -> None:
    page.text("""## Active damping

Equivalent controllers (Fig. 4.5), then the peaks of $S_O$:""")
    page.save("fig-4-5", paint_equivalent_controllers(loops["AD"], controller))
    reduced = highest(damped.axes[1], 300)[:, 1] < without
    page.check("motion.fig-4-6.output-reduced", np.mean(reduced[without > 1.0]))
    page.show(table.round(2))
    spread = [
        np.ptp([np.interp(100, *line) for name, line in labelled_lines(axis).items() if name.endswith(" m")])
        for axis in damped.axes[1::2]
    ]
    page.check("motion.fig-4-6.variation", float(spread[1] > spread[0]))
    for title, claim in (("original", "band-pass"), ("redesigned", "band-pass-redesigned")):
        lower = table.loc[f"AD, band-pass, {title}"] < table.loc[f"AD, {title}"]
        page.check(f"motion.fig-4-5.{claim}", np.mean(lower[["its spread (dB)", "gain from y there (dB)"]]))


def _of_both(
    page, plant: ModalModel, grid: np.ndarray, loops, controllers: Mapping[str, Pid], noise_model: float
) -> None:
    controller = next(iter(controllers.values()))
    page.text(r"""## Both (Figs 4.7 and 4.8)

Damping dominates. Over AD alone, with the drawn noise model and with that of section 3.4:""")
    page.save("fig-4-7", paint_equivalent_controllers(loops["MC and AD"], controller))
    page.save("fig-4-8", paint_sensitivities(loops["MC and AD"], controllers))
    strong = Design(Application(compensate=True, damping=DAMPING), 1e3)
    places = list(loops["AD"])
    combined = {
        f"Q_nu = {noise_model:g}, as drawn": list(loops["MC and AD"].values()),
        "Q_nu = 1000": place_loops(plant, grid, places, strong),
    }
    below = np.array([0.8 * plant.frequencies[1]])
    band = 2 * np.pi * np.geomspace(10.0, 1e3, 300)
    rows = {}
    for label, each in combined.items():
        gain, apart = [], []
        for both, alone in zip(each, loops["AD"].values(), strict=True):
            controllers_there = [loop.at(controller, below).output_controller[0] for loop in (both, alone)]
            gain.append(decibel(controllers_there[0] / controllers_there[1]))
            there = [loop.at(controller, band) for loop in (both, alone)]
            for name in ("input_sensitivity", "output_sensitivity"):
                apart.append(np.abs(decibel(getattr(there[0], name) / getattr(there[1], name))).max())
        rows[label] = [np.min(gain), np.max(gain), np.mean(np.array(gain) > 0), np.max(apart)]
    found = next(iter(rows.values()))
    page.check("motion.fig-4-7.before-first", found[2])
    page.check("motion.fig-4-8.identical", found[3])
    names = ["smallest change of the gain from y below the first resonance (dB)", "largest (dB)"]
    names += ["fraction of masses where it grows", "largest change of S_I and S_O (dB)"]
    page.show(pd.DataFrame(rows, index=names).round(2))
    page.conclude(
        "So the noise model decides at how many masses MC added to AD raises that gain: {few:.0%} of them as drawn, {all:.0%} with "
        "1000.",
        few=found[2],
        all=rows["Q_nu = 1000"][2],
    )


def _of_the_node(page, runs: Mapping[str, Sequence[Passage]], left_at: float) -> None:
    page.text("## Past the node\n\nLargest error over the mode's motion in the 10 ms after the node:")
    after = {
        name: np.array([one.worst(left_at, left_at + 0.01) for one in each]) for name, each in runs.items()
    }
    page.check("motion.section-4-2-1.staying", np.mean(after["staying"] > after["passing"]))
    page.show(pd.Series({name: each.max() for name, each in after.items()}).round(2))


def errors_past(plant: ModalModel, grid: np.ndarray, sample_time: float) -> pd.Series:
    """Largest error of the first mode's estimate, over its motion, past a node at several speeds (m/s)."""
    known, worst = plant.modes(slice(0, 4)), {}
    node = float(nodes(plant, grid, 1)[0])
    for speed in (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0):
        track = move(node - REACH, WAIT, speed, 2 * REACH, 0.05, sample_time)
        one = pass_node(known, grid, track, 1, sample_time)
        worst[speed] = one.worst(WAIT, WAIT + 2 * REACH / speed + 0.05)
    return pd.Series(worst)


def node_runs(
    plant: ModalModel, grid: np.ndarray, speed: float, phases: int, sample_time: float
) -> tuple[float, dict[str, list[Passage]]]:
    """When the sensor leaves the node (s), and what is estimated past it and on it, for several phases of the force."""
    known, node, left_at = plant.modes(slice(0, 4)), float(nodes(plant, grid, 1)[0]), WAIT + REACH / speed
    tracks = {
        "passing": move(node - REACH, WAIT, speed, 2 * REACH, 0.05, sample_time),
        "staying": move(node, left_at, speed, REACH, 0.05, sample_time),
    }
    angles = 2 * np.pi * np.arange(phases) / phases
    return left_at, {
        name: [pass_node(known, grid, track, 1, sample_time, angle) for angle in angles]
        for name, track in tracks.items()
    }
