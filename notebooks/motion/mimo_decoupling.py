"""Decoupling a machine with several inputs and outputs: what this notebook alone needs."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float64

from experiments.motion.beam import beam, beam_parameters, beam_shapes
from experiments.motion.decoupled_damping import added_damping
from experiments.motion.decoupling_schemes import (
    Settings,
    low_frequency_slopes,
    published_settings,
    with_compensation,
)
from experiments.motion.intervals import Values
from experiments.motion.machines import published_noise
from stillwork.control.decoupling import decouple, decoupled_plant
from stillwork.control.feedback import damping_gain
from stillwork.estimation.observer import kalman_observer
from stillwork.lti.modal import ModalModel
from stillwork.lti.reduction import truncate
from stillwork.lti.state_space import StateModel
from workbook import figures, proportion_interval
from workbook.studies import Study

Places = Sequence[float] | np.ndarray  # along the beam, as parts of its length


def paint_beam_layout(actuators: Places, sensors: Places):
    """Flexible mode shapes of the uniform beam with the places of actuators and sensors."""
    published = beam_parameters()["published"]["frequencies_hz"]
    along = np.linspace(0, 1, 201)
    figure, axis = figures.new(1, 1, height=2.6)
    shapes = beam_shapes(along, 2 + len(published))[:, 2:]
    for frequency, shape in zip(published, shapes.T, strict=True):
        axis.plot(along, shape, label=f"{frequency:g} Hz")
    axis.plot(actuators, np.full(len(actuators), -2.35), "^", color=figures.BLACK, label="actuators")
    for number, place in enumerate(actuators, 1):
        axis.annotate(str(number), (place, -2.3), xytext=(6, 0), textcoords="offset points", fontsize=8)
    axis.plot(sensors, np.full(len(sensors), 2.35), "v", color=figures.GREY, label="sensors")
    axis.set(xlabel="place along the beam (of its length)", ylabel="mode shape (tip = 2)")
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, 1.22), ncols=len(published) + 2)
    return figure


def observable_noise_models(plant: ModalModel) -> int:
    """How many constant forces, one per actuator, the sensors can tell apart: the rank test (3.17).

    The rank of [A B; C 0] beyond the states, after scaling.
    """
    states = plant.state_space()
    size = np.linalg.norm(states.a)
    whole = np.block([[states.a, states.b], [states.c, np.zeros_like(states.d)]])
    scale = np.repeat(np.where(plant.frequencies > 0, plant.frequencies, size**0.5), 2)
    scale[1::2] = 1.0  # velocities count as the displacement they lead to
    whole[:, : len(states.a)] /= scale
    whole[: len(states.a)] *= scale[:, None]
    whole /= np.linalg.norm(whole, axis=1)[:, None]
    whole /= np.linalg.norm(whole, axis=0)
    return int(np.linalg.matrix_rank(whole, tol=1e-10)) - len(states.a)


ACTUATORS, SENSORS = (0.1, 0.85), (0.03, 0.92)  # places as parts of the length; unpublished
TRAVEL, SENSOR_TRAVEL = (-0.1, 0.15), (-0.03, 0.07)  # of both along the beam; unpublished


class Moved(NamedTuple):
    """Added damping of the damped modes as both actuators move, with K(p) and with the gain of the built place."""

    shifts: Float64[np.ndarray, " shifts"]
    following: Float64[np.ndarray, "shifts modes"]
    kept: Float64[np.ndarray, "shifts modes"]


def move_actuators(actuators: Places, sensors: Places, settings: Settings, taper: float = 0.0) -> Moved:
    """Both actuators at eleven places along `TRAVEL`."""
    actuators, sensors = np.array(actuators), np.array(sensors)
    retained, rows = 2 + settings.damped, []
    built = damping_gain(truncate(beam(actuators, sensors, taper=taper), retained), settings.increase)
    shifts = np.linspace(*TRAVEL, 11)
    for shift in shifts:
        there = beam(actuators + shift, sensors, taper=taper)
        follows = damping_gain(truncate(there, retained), settings.increase)
        systems = [decoupled_plant(there, decouple(there), gain) for gain in (follows, built)]
        rows.append([added_damping(there, system)[0][: settings.damped] for system in systems])
    return Moved(shifts, *np.moveaxis(rows, 1, 0))


class Seen(NamedTuple):
    """MC as both sensors move: slopes off the diagonal, peaks lowered, and the slope with the sensing of the built place."""

    slopes: Float64[np.ndarray, "shifts 2"]
    lowered: Bool[np.ndarray, " shifts"]
    stale: Float64[np.ndarray, " shifts"]


def move_sensors(actuators: Places, sensors: Places, settings: Settings, taper: float = 0.0) -> Seen:
    """Both sensors at six places along `SENSOR_TRAVEL`, with the C_f of each."""
    actuators, sensors = np.array(actuators), np.array(sensors)
    slow, found = (0.03, 0.3), []  # Hz
    plant = beam(actuators, sensors, taper=taper)
    modes = plant.frequencies[2 : 2 + settings.damped]
    idle, built = np.zeros((2, 2 * len(plant.frequencies[: 2 + settings.damped]))), decouple(plant)
    for shift in np.linspace(*SENSOR_TRAVEL, 6):
        there = beam(actuators, sensors + shift, taper=taper)
        bare, seen = decoupled_plant(there, decouple(there), idle), with_compensation(there, settings)
        lowered = np.abs(seen.frequency_response(modes)) < np.abs(bare.frequency_response(modes))
        stale = low_frequency_slopes(decoupled_plant(there, built, idle), *slow)[0, 1]
        found.append((low_frequency_slopes(seen, *slow)[[0, 1], [1, 0]], lowered.all(), stale))
    return Seen(*map(np.array, zip(*found, strict=True)))


def moving_values(moved: Moved, seen: Seen, increase: float) -> Values:
    """What section 4.3 says of moving actuators and sensors, as the ledger has it: fractions of the places."""
    off = np.abs(moved.kept / increase - 1) > 0.1
    return {
        "motion.section-4-3.moving-actuators": float(
            np.all(np.abs(moved.following / increase - 1) < 0.01, axis=1).mean()
        ),
        "motion.section-4-3.kept-gain": float(off.any(axis=1)[np.abs(moved.shifts) > 1e-9].mean()),
        "motion.section-4-3.moving-sensors-peaks": float(seen.lowered.mean()),
    }


def moving(*, second_actuator: float, beam_taper: float, seed: int) -> Values:
    """The same on another beam; it has no fast variant."""
    places, settings = ((ACTUATORS[0], second_actuator), SENSORS), published_settings()
    moved, seen = (each(*places, settings, beam_taper) for each in (move_actuators, move_sensors))
    return moving_values(moved, seen, settings.increase)


def paint_moving(plant: ModalModel, actuators: Places, sensors: Places, settings: Settings, moved: Moved):
    """Added damping as both actuators move, and the gain that follows them; the largest gain over that of the built place."""
    fine, modes = np.linspace(*TRAVEL, 201), slice(2, 2 + settings.damped)
    shapes = beam(np.concatenate([place + fine for place in actuators]), sensors).input_shapes[modes]
    shapes = shapes.reshape(settings.damped, 2, -1)  # modes, actuators, places
    wanted = 2 * settings.increase * plant.frequencies[modes, None]
    alone, together = wanted / np.abs(shapes[:, 0]), wanted / np.linalg.norm(shapes, axis=1)
    figure, axes = figures.new(1, 2, height=2.8)
    for mode, colour in zip(range(settings.damped), (figures.BLUE, figures.RED), strict=True):
        name = f"{plant.frequencies[2 + mode] / (2 * np.pi):.0f} Hz"
        marker = {"markersize": (8, 3)[mode], "linewidth": (3, 1)[mode]}  # the two lie on each other
        axes[0].plot(
            moved.shifts,
            moved.following[:, mode],
            "o-",
            color=colour,
            label=f"{name}, gains follow",
            **marker,
        )
        axes[0].plot(moved.shifts, moved.kept[:, mode], "--", color=colour, label=f"{name}, gains kept")
        axes[1].semilogy(fine, together[mode], color=colour, label=f"{name}, two actuators")
        axes[1].semilogy(fine, alone[mode], ":", color=colour, label=f"{name}, one actuator")
    axes[0].axhline(-plant.damping[2], color=figures.BLACK, linewidth=0.8, label="unstable below")
    axes[0].set_ylabel("added damping ratio")
    axes[1].set(ylabel="gain (N s/m/√kg)", ylim=(1e2, 3e4))
    for axis in axes:
        axis.set_xlabel("shift along the beam (of its length)")
        axis.legend(fontsize=6)
    built = np.linalg.norm(damping_gain(truncate(plant, 2 + settings.damped), settings.increase), axis=0)[
        5::2
    ]
    return figure, together.max(axis=1) / built


# === The appendix =================================================================================================


def appendix(
    page,
    *,
    plant: ModalModel,
    settings: Settings,
    study: Study,
    systems: Mapping[str, StateModel],
    actuators: Places,
    sensors: Places,
) -> None:
    """What the page of motion/17 judges beside its answer."""
    _of_noise_models(page, actuators, sensors, plant)
    decoupling = decouple(plant)
    gain = damping_gain(truncate(plant, 2 + settings.damped, 3 - settings.damped), settings.increase)
    page.text("""## Remark 4.3.1

A Kalman observer with all modes couples exactly as perfect estimates do.""")
    whole = decoupled_plant(plant, decoupling, gain, kalman_observer(plant, published_noise()))
    omega = 2 * np.pi * np.geomspace(1.0, 2000.0, 300)
    apart = np.abs(whole.frequency_response(omega) / systems["(3.31)"].frequency_response(omega) - 1)
    page.check("motion.section-4-3.remark-4-3-1", round(float(apart.max()), 7))  # what is left is rounding
    rows = {name: added_damping(plant, system)[0] for name, system in systems.items()}
    page.show("added damping ratio", pd.DataFrame(rows, index=["161 Hz", "517 Hz", "760 Hz"]).round(4) + 0.0)
    _of_moving(page, plant, actuators[:2], sensors, settings)
    _of_geometries(page, study, settings.increase)


def _of_noise_models(page, actuators: Places, sensors: Places, plant: ModalModel) -> None:
    page.text("""## Noise models

The rank test counts the constant forces that two sensors can distinguish: at most two, so more actuators than sensors cannot have
a noise model each. By number of actuators:""")
    counts = {n: observable_noise_models(beam(actuators[:n], sensors)) for n in range(1, len(actuators) + 1)}
    page.show(pd.Series(counts))
    page.check("motion.section-4-3.noise-models", max(counts.values()) - len(sensors))
    machines = [beam(actuators[:n], sensors) for n in range(2, len(actuators) + 1)]
    on_u = [observable_noise_models(decouple(machine).apply(machine)) for machine in machines]
    page.check("motion.section-4-3.noise-models-on-u", min(on_u) - plant.rigid_modes)


def _of_moving(page, plant: ModalModel, actuators: Places, sensors: Places, settings: Settings) -> None:
    page.text(r"""## At other places

When actuators or sensors move, the matrices follow the place $p$ (section 4.2): for sensors $\Upsilon(p)$ and $C_f(p)$, for
actuators $\Gamma(p)$ and, "to ensure the same level of damping for all positions",

$$K_{dj}(p) = -\big(\phi_{aj}(p)^\top\big)^\dagger\,2\,\zeta_{des}\,\omega_j,\qquad |K_{dj}(p)| = \frac{2\,\zeta_{des}\,\omega_j}{|\phi_{aj}(p)|}$$

The gain is infinite only where both actuators stand on nodes of one mode.""")
    moved, seen = (each(actuators, sensors, settings) for each in (move_actuators, move_sensors))
    figure, over = paint_moving(plant, actuators, sensors, settings, moved)
    page.save("moving-actuators", figure)
    unstable = np.any(moved.kept + plant.damping[2 : 2 + settings.damped] < 0, axis=1)
    page.conclude(
        "With the gain of the built place the beam is unstable from a shift of {shift:.3f} of its length on; the gain that follows "
        "grows at most {most:.1f} times.",
        "With the gain of the built place the beam stays stable; the gain that follows grows at most {most:.1f} times.",
        when=bool(unstable.any()),
        shift=moved.shifts[unstable].min() if unstable.any() else np.nan,
        most=over.max(),
    )
    for claim, ours in moving_values(moved, seen, settings.increase).items():
        page.check(claim, ours)
    page.text("""Now the sensors move, with MC. With the original $\\Upsilon$ a rotation is measured as a translation, and $q_1/u_2$ is a
double integrator again.""")
    page.check("motion.section-4-3.moving-sensors", round(float(np.abs(seen.slopes).max()), 2))
    page.check("motion.section-4-3.kept-sensing", round(float(np.abs(seen.stale + 2).max()), 2))


def _of_geometries(page, study: Study, increase: float) -> None:
    page.text("""## Over geometries

The coupling of (4.15) over its closed form, its onset (Hz), how the schemes couple and what (3.32) adds:""")
    off_diagonal = ~np.eye(2, dtype=bool)
    by_closed_form = study["each mode: limit"][:, off_diagonal]
    page.check(
        "motion.section-4-3.limit", round(float(np.abs(by_closed_form - 1).max()), 9)
    )  # left: rounding
    onset = study["each mode: onset_hz"][:, off_diagonal]
    page.show(
        f"onset of the slope -1 (Hz), least, 5 %, median, 95 %: {np.quantile(onset, [0, 0.05, 0.5, 0.95]).round(2)}"
    )
    reached = np.abs(study["each mode: slopes above"][:, off_diagonal] + 1) < 0.02
    page.show(f"entries whose slope is within 0.02 of -1 at 0.03 to 0.3 Hz: {reached.mean():.3f}")
    names = ("undamped", "compensation", "each mode", "minimal interaction")
    low = {name: study[f"{name}: low"][:, off_diagonal] for name in names}
    added = study["minimal interaction: added"]
    orderings = {
        "compensation-peaks": (study["compensation: at modes"] < 1).all(axis=(1, 2, 3)),
        "compensation-compliance": (low["compensation"] < low["undamped"]).all(axis=1),
        "minimal-interaction-couples-less": (low["minimal interaction"] < low["each mode"]).all(axis=1),
        "minimal-interaction-damps-little": (added < 0.1 * increase).all(axis=1),
    }
    for claim, obeys in orderings.items():
        interval = proportion_interval(obeys.sum(), len(obeys))
        page.check(f"motion.section-4-3.{claim}", obeys.mean(), interval)
    quantiles = np.quantile(added / increase, [0.025, 0.5, 0.975], axis=0).T
    page.show(
        "(3.32), part of the wanted damping, central 95 % and median, a row a mode:", quantiles.round(2)
    )
    entries = {name: float(np.median(low[name] / low["undamped"])) for name in names}
    page.show("off-diagonal entries at 1 Hz over the undamped ones, median:", pd.Series(entries).round(2))
