"""Measurement compensation: what notebook 06 alone needs, with the loop over a soft sensor and the appendix."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from experiments.motion.designs import DESIGNS, controllers, stage_bandwidth, stage_loops, stage_observer
from experiments.motion.loop_conditions import slope, static_gain
from experiments.motion.loop_pictures import over_first, paint_controllers
from experiments.motion.machines import published_noise, stage, stage_mass
from experiments.motion.pictures import (
    add_magnitude,
    decibel,
    depth,
    labelled_lines,
    mark_printed,
    mark_slope,
    paint_bode,
    paint_over_masses,
)
from stillwork.control.applications import Application, compensator, soft_sensor
from stillwork.control.bandwidth import Loop, PeakConstraint, make_loop, maximise_bandwidth
from stillwork.control.loops import channel, closed_loop
from stillwork.control.pid import Pid, PidFamily
from stillwork.estimation.observer import Observer, kalman_observer
from stillwork.lti.modal import ModalModel
from stillwork.lti.peaks import resonance_grid
from stillwork.lti.reduction import truncate
from stillwork.lti.state_space import StateModel
from workbook import figures

PLAIN = Application(compensate=True)


def crossing_of(omega: np.ndarray, gain: np.ndarray) -> float:
    """Where a gain last falls below 1 under 1 Hz (Hz)."""
    size = np.abs(gain)
    last = np.flatnonzero((size[:-1] > 1) & (size[1:] <= 1) & (omega[1:] < 2 * np.pi))[0]
    pair = slice(last, last + 2)
    return float(np.exp(np.interp(0, -np.log(size[pair]), np.log(omega[pair]))) / (2 * np.pi))


def line_slope(axis, label: str, low: float, high: float) -> float:
    """Slope of a line in dB between two x, in decades a decade."""
    x, level = labelled_lines(axis)[label]
    part = (x >= low) & (x <= high)
    return slope(x[part], 10 ** (level[part] / 20))


def slopes_of(axis, position: int) -> dict[str, float]:
    """Slopes of S_O, by the ledger's names: with and without MC at lowest frequency, with MC below 1 Hz."""
    parts = {"original": ("no observer", 1e-4, 1e-3), "compensation": (f"mass {position}", 1e-4, 1e-3)}
    parts["compensation-below-1-hz"] = (f"mass {position}", 0.1, 1.0)
    return {claim: line_slope(axis, *part) for claim, part in parts.items()}


# === The lost integrator ==========================================================================================


def paint_integrators(loops: Sequence[Loop], controllers: Mapping[str, Pid], bare: Loop):
    """S_O over the masses down to 0.1 mHz, a panel a controller, with that of a loop without observer (Fig. 3.6)."""
    panels = {
        f"$S_O$ with MC, {name}": (loops, each, "output_sensitivity") for name, each in controllers.items()
    }
    figure = paint_over_masses(panels, low_hz=1e-4, bottom=-350.0)
    for axis, controller in zip(figure.axes, controllers.values(), strict=True):
        response = bare.at(controller).output_sensitivity
        add_magnitude(axis, bare.omega, response, color=figures.GREY, linestyle="--", label="no observer")
        axis.set_ylim(top=60)  # room for the limit's name
        mark_slope(axis, 2.0, (1e-2, 1.0), -190.0, "printed: slope 2 below 1 Hz")
    left, right = figure.axes
    right.legend(right.lines[-1:], ["printed: slope 2 below 1 Hz"], loc="lower right", fontsize=7)
    left.legend(ncols=2, loc="lower right", fontsize=6)
    return figure


# === High-pass or noise model =====================================================================================


def paint_departure(curves: Mapping[str, tuple[np.ndarray, np.ndarray]], phase_deg: float) -> tuple:
    """Magnitudes (Fig. 3.12) over the distance of the phase from -180 degrees, and where this exceeds `phase_deg` (Hz)."""
    figure, axes = figures.new(2, 1, height=5.0, sharex=True)
    styles = ({"color": figures.BLACK}, {"color": figures.BLUE}, {"color": figures.RED, "linestyle": "--"})
    for (label, (omega, response)), style in zip(curves.items(), styles, strict=True):
        add_magnitude(axes[0], omega, response, label=label, **style)
        angle = np.unwrap(np.degrees(np.angle(response)), period=360)
        away = np.abs(angle - 360 * np.ceil(angle[0] / 360 - 1e-6) + 180)
        axes[1].loglog(omega / (2 * np.pi), away, label=label, **style)
    leaves = {
        name: hertz[np.argmax(away > phase_deg)] for name, (hertz, away) in labelled_lines(axes[1]).items()
    }
    for hertz, style in zip(leaves.values(), styles, strict=True):
        axes[1].plot([hertz], [phase_deg], "o", color=style["color"])
    axes[1].axhline(phase_deg, color=figures.BLACK, linestyle=":", linewidth=1)
    axes[1].text(11, 1.15 * phase_deg, f"counts as leaving: {phase_deg:g}°", fontsize=7)
    axes[0].set(ylim=(-260, -80), ylabel="magnitude (dB re 1 m/N)")
    axes[1].set(xlim=(10, 3e3), ylim=(1e-3, 1e3), xlabel="frequency (Hz)", ylabel="phase from −180° (deg)")
    axes[0].legend()
    return figure, leaves


def left_at_resonances(figure, ideal: np.ndarray, resonances: np.ndarray) -> dict[str, np.ndarray]:
    """Largest distance (dB) of the upper panel's lines from an ideal response within 3 % of each resonance (Hz)."""
    left = {}
    for name, (hertz, level) in labelled_lines(figure.axes[0]).items():
        off = np.abs(level - 20 * np.log10(np.abs(ideal)))
        left[name] = np.array([off[np.abs(hertz / at - 1) < 0.03].max() for at in resonances])
    return left


# === High and low gain ============================================================================================

# What section 3.2.2 says of Fig. 3.16: 1, a transfer rises at the resonances; -1, it falls.
GAIN_SENTENCES = {
    "high gain": {"u_ff": 1, "w": 1, "v": 1, "d": -1},
    "low gain": {"w": -1, "v": -1, "u_ff": 1, "d": 1},
}


# === Soft sensing =================================================================================================


def soft_sensed_loop(sensor: int, performance: int) -> Loop:
    """Loop whose controller sees the soft sensor's position (3.21) of mass `performance`, measured at mass `sensor`."""
    plant, observer = stage(), stage_observer(sensor)
    shapes = plant.output_shapes[performance - 1 : performance, : len(observer.model.frequencies)]
    soft = soft_sensor(observer, shapes)
    nothing = np.zeros_like(soft.c)
    direct = np.vstack([np.zeros_like(soft.d), np.array([[0.0, 1.0]]) - soft.d])
    # A compensator gives y_flex, which is subtracted from y: here what the soft sensor takes off.
    block = StateModel(soft.a, soft.b, np.vstack([nothing, -soft.c]), direct)
    return make_loop(plant.at([0], [sensor - 1]), block)


def soft_sensed_limits(position: int) -> dict[str, float]:
    """Largest f_bw (Hz) under (3.2) with the true sensor and with a soft one, over the places that move.

    The performance output moves over the seven masses with the sensor at mass `position`; or the sensor moves and
    the performance output stays there (Remark 3.2.6).
    """
    masses, bare = range(1, 8), stage_loops(DESIGNS["PID"])
    loops = {
        "sensor moves, none": bare,
        "performance moves": [soft_sensed_loop(position, each) for each in masses],
        "fixed place, none": [bare[position - 1]],
        "sensor moves, soft": [soft_sensed_loop(each, position) for each in masses],
    }
    family, limits = PidFamily(stage_mass()), [PeakConstraint("input_sensitivity")]
    return {name: maximise_bandwidth(each, family, limits).design_hz for name, each in loops.items()}


# === Appendix =====================================================================================================


def appendix(
    page,
    *,
    position: int,
    redesign: str,
    noise_model: float,
    sample_time: float,
    low: np.ndarray,
    wide: np.ndarray,
    blocks: Mapping[str, StateModel],
    controllers: Mapping[str, Pid],
    sensitivities: Sequence[Mapping[str, tuple]],
    cases: Mapping[str, StateModel],
) -> None:
    """What this notebook judges beside its answer.

    `low` and `wide` are frequencies (rad/s), `sensitivities` the lines of Fig. 3.6 in its two panels, `cases` the loops of Fig. 3.16.
    """
    plant, observer = stage().at([0], [position - 1]), stage_observer(position)
    _of_rigid_estimate(page, plant, observer, blocks["MC"], controllers["PID"], sample_time)
    _of_redesign(page, sensitivities)
    _of_integrators(page, blocks, controllers["PID"], low)
    _of_controllers(page, plant, blocks, controllers, low, wide)
    _of_low_frequency(page, cases, plant)
    _of_velocity(page, plant, noise_model, low)
    _of_soft_sensor(page, plant, blocks["MC"], controllers["PID"], position, wide)


def _of_rigid_estimate(
    page, plant: ModalModel, observer: Observer, block: StateModel, original: Pid, sample_time: float
) -> None:
    page.text(r"""
## Why not feed back the estimated rigid body

An unknown constant force gives the estimate $\hat y_{rig} = C_r\hat x$ an error that the controller does not see (section 3.2.1).
""")
    rigid = np.eye(1, len(observer.a)) * observer.model.output_shapes[0, 0]
    estimate = observer.estimator(np.vstack([0 * rigid, -rigid]))
    instead = StateModel(estimate.a, estimate.b, estimate.c, np.diag([0.0, 1.0]))
    uses = {"no observer": None, "MC": block, "rigid body": instead}
    loops = {name: closed_loop(plant, each, original.state_space()) for name, each in uses.items()}
    hertz, density = np.geomspace(1e-3, 5e3, 4000), {name: 0.0 for name in uses}
    for name, closed in loops.items():
        for source, size in {"w": 0.01, "v": 1e-9, "d": 1e-9}.items():
            response = channel(closed, source, "e_true").frequency_response(2 * np.pi * hertz)[0, 0]
            density[name] += np.abs(response) ** 2 * 2 * sample_time * size**2
    error_nm = {name: float(1e9 * np.sqrt(np.trapezoid(each, hertz))) for name, each in density.items()}
    still = {name: float(np.sqrt(each[hertz < 0.1].mean())) for name, each in density.items()}
    page.show(pd.Series(error_nm, name="rms of the true error (nm)").round(2))
    page.check("motion.section-3-2-1.no-gain", float(error_nm["rigid body"] >= error_nm["no observer"]))
    page.check("motion.section-3-2-1.low-frequency", float(still["rigid body"] > still["no observer"]))


def _of_redesign(page, sensitivities: Sequence[Mapping[str, tuple]]) -> None:
    page.text("## What the redesign does to $S_O$")
    better, worse = [], []
    for mass in range(1, 8):
        (hertz, old), (_, new) = (each[f"mass {mass}"] for each in sensitivities)
        better.append(np.all(new[hertz < 37] < old[hertz < 37]))
        worse.append(np.max((new - old)[hertz > 50]) > 1)  # dB
    page.check("motion.fig-3-6.redesign", np.mean(np.array(better) & np.array(worse)))


def _of_integrators(page, blocks: Mapping[str, StateModel], original: Pid, low: np.ndarray) -> None:
    page.text("## The corner by mass, and with the noise model")
    static = [static_gain(compensator(stage_observer(k), PLAIN))[1, 0] for k in range(1, 8)]
    every = np.abs(static) * original.gain * original.integrator / (2 * np.pi)
    nearest = int(np.argmin(np.abs(every - 0.003)))
    page.conclude(
        "$|C_{{fb}}O_{{yu}}| = 1$ at {low:.4f} to {high:.4f} Hz; nearest to the printed 0.003 Hz at mass {mass}, {hz:.4f} Hz.",
        low=every.min(),
        high=every.max(),
        mass=nearest + 1,
        hz=every[nearest],
    )
    still = low < 2 * np.pi * 1e-2
    without, with_model = (blocks[name].frequency_response(low)[1, 0] for name in ("MC", "noise model"))
    corner = np.abs(without[still]).mean() / (np.abs(with_model[still]) / low[still]).mean() / (2 * np.pi)
    page.check("motion.integral-action.noise-model", corner)
    left = abs(static_gain(blocks["noise model"])[1, 0]) / np.abs(with_model).max()
    page.check("motion.integral-action.theorem-3-2-4", round(float(left), 13))  # rounding is left
    off = [abs(_by_3_19(name) - stage_bandwidth(name).design_hz) for name in WITH_NOISE_MODEL]
    page.conclude(
        "In (3.19) $T_{{DC}}$ acts on the noise model's $z$, too, in (3.15) on $u$ alone. Ours is (3.15); by (3.19) the largest "
        "$f_{{bw}}$ of {names} moves by {off:.2f} Hz at most.",
        names=" and ".join(WITH_NOISE_MODEL),
        off=max(off),
    )


WITH_NOISE_MODEL = ("MC", "MC and AD")


def _by_3_19(name: str) -> float:
    """Largest f_bw (Hz) of a design by an observer as (3.19) prints it."""
    design, loops = DESIGNS[name], []
    for k in range(1, 8):
        observer = stage_observer(k, None, design.noise_model)
        on_z = observer.model.feedthrough * np.eye(1, len(observer.a), len(observer.a) - 1)
        block = compensator(replace(observer, c=observer.c + on_z), design.application)
        loops.append(make_loop(stage().at([0], [k - 1]), block))
    limits = [PeakConstraint(function) for function in design.constraints]
    return maximise_bandwidth(loops, controllers(design), limits).design_hz


def _of_controllers(
    page,
    plant: ModalModel,
    blocks: Mapping[str, StateModel],
    controllers: Mapping[str, Pid],
    low: np.ndarray,
    wide: np.ndarray,
) -> None:
    page.text(r"""
## Equivalent controllers

Towards low frequency the equivalent controller from $y$ becomes flat (Fig. 3.9). Equivalent controllers with and without noise
model "overlap, except for the notches" (Fig. 3.13); with it the slope from $v$ to the true error is +3 again (Fig. 3.14). From $y$,
MC resembles notches, but "there are no notches present in the path from reference $r$" (Fig. 3.15).
""")
    bare = make_loop(plant, low_hz=1e-4)
    loop, with_model = (make_loop(plant, blocks[name]) for name in ("MC", "noise model"))
    original, redesigned = controllers["PID"], controllers["MC"]
    resonances = plant.frequencies[1:4] / (2 * np.pi)
    figure = paint_controllers({"original": (bare, original), "with MC": (loop, original)}, low)
    mark_printed(figure.axes[1], 0.003, "printed: lost below 0.003 Hz", at=0.03)
    page.save("fig-3-9", figure)
    cases = {
        "original": (bare, original),
        "without noise model": (loop, original),
        "with noise model": (with_model, original),
    }
    thick = {"color": figures.GREY, "linewidth": 3.0}  # the other lines lie on it
    figure = paint_controllers(cases, low, {"original": thick, "with noise model": {"linestyle": "--"}})
    apart = []
    for axis in figure.axes[:2]:
        (hertz, first), (_, second) = (
            labelled_lines(axis)[name] for name in ("original", "with noise model")
        )
        beside = np.all(np.abs(hertz[:, None] / resonances - 1) > 0.2, axis=1)
        apart.append(np.abs(second - first)[beside].max())
    page.check("motion.fig-3-13.overlap", max(apart))
    notched = [depth(figure.axes[1], "with noise model", at) > 3 for at in resonances]
    page.check("motion.fig-3-13.notches", np.mean(notched))
    page.save("fig-3-13", figure)
    curves = {
        "original": bare.at(original, low).output_sensitivity,
        "MC, redesigned": loop.at(redesigned, low).output_sensitivity,
        "MC with noise model, redesigned": with_model.at(redesigned, low).output_sensitivity,
    }
    lines = {name: (low, response) for name, response in curves.items()}
    figure, axes = paint_bode(lines, "$v$ to $e_{true}$ (dB)", ylim=(-350, 20))
    steep = line_slope(axes[0], "MC with noise model, redesigned", 1e-4, 1e-3)
    page.check("motion.slopes.compensation-noise-model", steep)
    mark_slope(axes[0], 3.0, (1e-3, 1.0), -230.0, "printed: slope 3 with noise model")
    axes[0].legend()
    page.save("fig-3-14", figure)
    notched = controllers["PID with notches"]
    figure = paint_controllers({"MC": (with_model, redesigned), "PID with notches": (bare, notched)}, wide)
    deep = np.array([depth(figure.axes[0], "MC", at) for at in resonances])
    page.check("motion.fig-3-15.no-notch-from-reference", np.mean(deep.round(2) < 3))
    mark_printed(figure.axes[0], 46.0, "printed: 46 Hz", at=0.6)
    mark_printed(figure.axes[1], 43.0, "printed: 43 Hz", at=0.6)
    page.save("fig-3-15", figure)


def _of_low_frequency(page, cases: Mapping[str, StateModel], plant: ModalModel) -> None:
    page.text(r"""
## The changes are local

Remark 3.2.5: largest change of each transfer below half of the first resonance (dB).
""")
    half = plant.frequencies[1] / 2
    poles = np.concatenate([loop.poles for loop in cases.values()])
    omega = resonance_grid(poles, 10.0, 2.5e3, 600, 60)
    changes = {
        name: {
            source: np.abs(decibel(ratio)).max()
            for source, ratio in over_first(cases, name, omega[omega < half]).items()
        }
        for name in ("high gain", "low gain")
    }
    page.show(pd.DataFrame(changes).round(2))
    page.check("motion.remark-3-2-5.local", max(changes["high gain"].values()))


def _of_velocity(page, plant: ModalModel, noise_model: float, low: np.ndarray) -> None:
    page.text(r"""
## Velocity measurements

With a velocity sensor, according to the text, the transfer to $\dot y_{flex}$ vanishes at zero frequency except for the compliance
feedthrough (Fig. 3.17). Here it is constant without feedthrough, too; the noise model removes it.
""")
    reduced, published = truncate(plant, 4, 3), published_noise()
    speed = replace(reduced, measures="velocity")
    no_feed = replace(speed, feedthrough=0 * reduced.feedthrough)
    velocity = {
        "no feedthrough": compensator(kalman_observer(no_feed, published), PLAIN),
        "feedthrough": compensator(kalman_observer(speed, published), PLAIN),
        "feedthrough and noise model": compensator(kalman_observer(speed, published, noise_model), PLAIN),
    }
    gains = {name: (low, block.frequency_response(low)[1, 0]) for name, block in velocity.items()}
    dashed = {"no feedthrough": {"linewidth": 4.0}, "feedthrough": {"linestyle": "--"}}  # they coincide
    label = "$u$ to $\\dot y_{flex}$ (dB re 1 m/(s N))"
    page.save("fig-3-17", paint_bode(gains, label, styles=dashed, xlim=(1e-4, 1e4))[0])
    static, gain = (each["no feedthrough"] for each in (velocity, gains))
    page.check("motion.integral-action.velocity", abs(static_gain(static)[1, 0]) / np.abs(gain[1]).max())


def _of_soft_sensor(
    page, plant: ModalModel, block: StateModel, original: Pid, position: int, wide: np.ndarray
) -> None:
    page.text(r"""
## Soft sensing

The estimate can also move the measurement, (3.21), to a mass whose resonances then have "the same bandwidth limiting effect".
(3.23) adds only the static compliance of the place, here of mass 2, times the feedforward.
""")
    other = stage().at([0], [1])
    truth = other.frequency_response(wide)[0, 0]
    static = float(other.modes(slice(1, None)).compliance()[0, 0])
    compensated = make_loop(plant, block).at(original, wide).equivalent_plant
    slow_part = wide < 2 * np.pi * 37
    with_static, without_static = (np.abs(compensated + each - truth)[slow_part] for each in (static, 0.0))
    page.check("motion.section-3-2-4.compliance", np.mean(with_static < without_static))
    limits = soft_sensed_limits(position)
    page.show(pd.Series(limits, name="largest f_bw (Hz)").round(1))
    page.check("motion.section-3-2-4.same-limit", limits["performance moves"] / limits["sensor moves, none"])
    page.check("motion.remark-3-2-6.no-limit", limits["sensor moves, soft"] / limits["fixed place, none"])
