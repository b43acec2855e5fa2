"""The two-inertia drive: what a model error leaves: what this notebook alone needs."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from jaxtyping import Float64
from scipy.signal import csd, welch

from experiments.motion.machines import Drive, drive
from experiments.motion.pictures import (
    CASES,
    add_magnitude,
    decibel,
    labelled_lines,
    paint_bode,
    plain_numbers,
)
from stillwork.control.applications import Application, compensator
from stillwork.control.loops import channel, closed_loop
from stillwork.control.pid import PidFamily
from stillwork.estimation.observer import Observer
from stillwork.estimation.riccati import continuous_gain
from stillwork.identification.frequency_response import Identified
from stillwork.lti.discretisation import zoh
from stillwork.lti.simulation import simulate
from stillwork.lti.state_space import StateModel
from workbook import figures, run_study

# === Drive ========================================================================================================
# The experiment of section 3.6 in simulation: observer, loops and identification of the two-inertia drive.


# Section 3.6: Q = diag(.1, .1, 1, 1) and R, in rad and rad/s; here by (theta1, theta2, speed1, speed2).
SENSOR = 5e-5
WEIGHTS = {"angles first": (0.1, 0.1, 1.0, 1.0), "inertia by inertia": (0.1, 1.0, 0.1, 1.0)}


def drive_observer(drive: Drive, weights: str = "angles first") -> Observer:
    """Kalman observer of section 3.6, in modal states (sum and difference of the angles)."""
    states = drive.modal_states()
    shape = 1 / np.sqrt(2 * drive.inertia)
    # (theta1, theta2, speed1, speed2) of the modal states (eta1, speed of eta1, eta2, speed of eta2)
    physical = shape * np.array([[1, 0, 1, 0], [1, 0, -1, 0], [0, 1, 0, 1], [0, 1, 0, -1]], dtype=float)
    solved = continuous_gain(states.a, np.linalg.inv(physical), states.c, np.diag(WEIGHTS[weights]), SENSOR)
    return Observer(drive.modes(), states.a, states.b, states.c, solved.gain, solved.residual)


def drive_applications(damping: float) -> dict[str, Application | None]:
    """The four cases of Fig. 3.36, with this added damping ratio for AD."""
    return {
        "no observer": None,
        "MC": Application(compensate=True),
        "AD": Application(damping=damping),
        "MC and AD": Application(compensate=True, damping=damping),
    }


def drive_loop(
    plant: Drive,
    model: Drive,
    application: Application | None,
    bandwidth_hz: float,
    weights: str = "angles first",
) -> StateModel:
    """Closed loop of a drive with an observer made for `model`, angle measured across the rod."""
    block = None if application is None else compensator(drive_observer(model, weights), application)
    inertia = 2 * plant.inertia / plant.motor_constant  # what the controller's rules call the mass
    return closed_loop(plant.modal_states(), block, PidFamily(inertia)(bandwidth_hz).state_space())


def seen_by_controller(loop: StateModel, omega: Float64[np.ndarray, " frequencies"]) -> np.ndarray:
    """Exact response that the controller sees, u to the compensated output, from a `closed_loop`."""
    measured, force = channel(loop, "u_ff", ("e_meas", "u")).frequency_response(omega)[:, 0]
    return -measured / force


def identify(
    loop: StateModel,
    rng: np.random.Generator,
    *,
    sample_time: float,
    samples: int,
    segment: int,
    excitation: float,
    sensor_noise: float,
    imbalance: float,
    turns_hz: float,
) -> Identified:
    """The experiment: white current on the plant input, sensor noise, and the imbalance of the turning inertias.

    `excitation` (A) and `sensor_noise` (rad) are standard deviations, `imbalance` an amplitude (A at the motor).
    """
    noise = excitation * rng.standard_normal(samples)
    swing = imbalance * np.sin(2 * np.pi * turns_hz * sample_time * np.arange(samples))
    sensor = sensor_noise * rng.standard_normal(samples)
    chosen = channel(loop, ("u_ff", "w", "d"), ("u", "e_meas"))
    u, e = simulate(zoh(chosen, sample_time), np.array([noise, swing, sensor]))
    return closed_loop_response(noise, u, -e, sample_time, segment)


def closed_loop_response(
    excitation: Float64[np.ndarray, " samples"],
    inputs: Float64[np.ndarray, " samples"],
    outputs: Float64[np.ndarray, " samples"],
    sample_time: float,
    segment: int,
) -> Identified:
    """Plant response in closed loop, as the ratio of the cross spectra with the excitation.

    The direct ratio of output and input would be biased by the noise that the loop feeds back; noise that is
    independent of the excitation averages out of this one.
    """
    settings = {"fs": 1 / sample_time, "nperseg": segment, "detrend": "constant"}
    hertz, to_input = csd(excitation, inputs, **settings)
    _, to_output = csd(excitation, outputs, **settings)
    power, out_power = (welch(signal, **settings)[1] for signal in (excitation, outputs))
    coherence = np.abs(to_output) ** 2 / (power * out_power)
    keep = slice(1, None)
    return Identified(2 * np.pi * hertz[keep], (to_output / to_input)[keep], coherence[keep])


def rigid_response(plant: Drive, omega: Float64[np.ndarray, " frequencies"]) -> np.ndarray:
    """Response of the drive if its rod were stiff."""
    return plant.motor_constant / (1j * omega * (2j * omega * plant.inertia + 2 * plant.friction))


def levels_over_rigid(figure, plant: Drive, names: Iterable[str], turns_hz: float) -> dict[str, np.ndarray]:
    """The identified lines of `paint_identified` over the rigid body (dB), from 5 to 30 Hz and away from the imbalance."""
    levels = {}
    for name in names:
        hertz, level = labelled_lines(figure.axes[0])[f"{name}, identified"]
        part = (hertz > 5) & (hertz < 30) & (np.abs(hertz - turns_hz) > 1)
        levels[name] = level[part] - decibel(rigid_response(plant, 2 * np.pi * hertz[part]))
    return levels


def statements(levels: Mapping[str, np.ndarray]) -> dict[str, bool]:
    """What section 3.6 says of Fig. 3.36, from each case's level over the rigid body (dB) around the resonance.

    A notch is as far from the rigid body as a peak.
    """
    away = {name: float(np.abs(level).max()) for name, level in levels.items()}
    return {
        "compensation-reduces": away["MC"] < away["no observer"],
        "residual-peak": bool(levels["MC"].max() > -levels["MC"].min()),
        "damping-reduces-less": away["MC"] < away["AD"] < away["no observer"],
        "combination-best": away["MC and AD"] < min(away["MC"], away["AD"]),
    }


def residual_trial(
    rng: np.random.Generator,
    plant: Drive,
    applications: dict[str, Application | None],
    bandwidth_hz: float,
    error: float,
    weights: str = "angles first",
    parts: str = "all three",
) -> dict[str, float]:
    """What is left of the resonance by a model wrong by up to `error`: its peak over the rigid body (ratio), by case.

    And the largest distance from the rigid body, up or down (dB), by ``<case>, distance``.
    """
    names = ("stiffness", "inertia", "damper") if parts == "all three" else ("stiffness",)
    wrong = replace(
        plant, **{name: getattr(plant, name) * (1 + rng.uniform(-error, error)) for name in names}
    )
    omega = plant.resonance * np.linspace(0.5, 1.6, 800)
    found = {}
    for name, each in applications.items():
        seen = seen_by_controller(drive_loop(plant, wrong, each, bandwidth_hz, weights), omega)
        ratio = np.abs(seen / rigid_response(plant, omega))
        found[name] = float(ratio.max())
        found[f"{name}, distance"] = float(np.abs(20 * np.log10(ratio)).max())
    return found


def residual_study(
    plant: Drive,
    applications: Mapping[str, Application | None],
    errors: Sequence[float],
    dampings: Sequence[float],
    runs: int,
    seed: int,
    **settings,
) -> tuple[pd.DataFrame, dict[str, np.ndarray]]:
    """Mean peaks over model errors and added dampings, and in which runs each statement holds, by entry of the ledger.

    `settings` go to `residual_trial`. That AD alone leaves more than MC is judged next to an error of 0.05 and a damping of 0.1.
    """
    rows, smallest, nearest, less = [], [], [], {}
    for error, damping in [(error, damping) for error in errors for damping in dampings]:
        cases = {
            **applications,
            "AD": Application(damping=damping),
            "MC and AD": Application(compensate=True, damping=damping),
        }
        study = run_study(
            residual_trial, runs, seed, plant=plant, applications=cases, error=error, **settings
        )
        peaks, distances = ([study[f"{name}{what}"] for name in cases] for what in ("", ", distance"))
        smallest.append(np.argmin(peaks, axis=0) == 3)
        nearest.append(np.argmin(distances, axis=0) == 3)
        less[error, damping] = study["AD"] > study["MC"]
        rows.append([error, damping, *np.mean(peaks, axis=1)])
    names = ["error", "added damping", *applications]
    middle = min(less, key=lambda each: (abs(each[0] - 0.05), abs(each[1] - 0.1)))
    held = {"combination-best": np.concatenate(smallest), "combination-nearest": np.concatenate(nearest)}
    return pd.DataFrame(rows, columns=names).round(2), held | {"damping-less": less[middle]}


# === Drive pictures ===============================================================================================
# Figure and explorer of the two-inertia drive (notebook 12).


def paint_identified(
    plant: Drive, loops: Mapping[str, StateModel], found: Mapping[str, Identified], hertz: tuple[float, float]
):
    """What the controller of the drive sees, as identified and exact, beside the rigid body, and the coherence."""
    figure, axes = figures.new(2, 1, height=5.0, sharex=True)
    for name, each in found.items():
        shown = (each.omega > 2 * np.pi * hertz[0]) & (each.omega < 2 * np.pi * hertz[1])
        omega, style = each.omega[shown], {"color": CASES[name], "linewidth": 0.7}
        add_magnitude(axes[0], omega, each.response[shown], label=f"{name}, identified", **style)
        exact = seen_by_controller(loops[name], omega)
        add_magnitude(axes[0], omega, exact, label=f"{name}, exact", color=CASES[name], linestyle=":")
        style["linestyle"] = "--" if name == "MC and AD" else "-"  # it lies on MC
        axes[1].semilogx(omega / (2 * np.pi), each.coherence[shown], label=name, **style)
    add_magnitude(axes[0], omega, rigid_response(plant, omega), label="rigid body", color=figures.GREY)
    axes[0].set_ylabel("magnitude (dB re 1 rad/A)")
    *solid, last = axes[0].lines[::2]
    handles, words = [*solid, axes[0].lines[1], last], [*found, "dotted: exact", "rigid body"]
    axes[0].legend(handles, words, ncols=2, fontsize=7)
    axes[1].set(ylabel="coherence", xlabel="frequency (Hz)")
    plain_numbers(axes[1].xaxis)
    return figure


def paint_residuals(table: pd.DataFrame, dampings: Sequence[float]):
    """The mean peaks of `residual_study` over the model error, a line a use and, with damping, an added ratio."""
    figure, axis = figures.new(1, 1, height=2.8)
    for damping, style in zip(dampings, ("o-", "s--", "^:"), strict=False):
        part = table[table["added damping"] == damping]
        for case in ("AD", "MC and AD"):
            axis.plot(
                100 * part["error"], part[case], style, color=CASES[case], label=f"{case}, +{damping:g}"
            )
    for case, style in (("MC", "d-"), ("no observer", "x-")):
        axis.plot(100 * part["error"], part[case], style, color=CASES[case], label=case)
    axis.set(xlabel="largest model error (%)", ylabel="peak over the rigid body's", ylim=(0, 9))
    axis.set_xticks(100 * part["error"])
    axis.legend(ncols=4, fontsize=7, loc="upper left")
    return figure


def paint_drive(stiffness_error: float, damping: float, bandwidth_hz: float):
    """Explorer: what the controller of the two-inertia drive sees, with an observer whose stiffness is off."""
    plant = drive()
    model = replace(plant, stiffness=plant.stiffness * (1 + stiffness_error))
    omega = 2 * np.pi * np.geomspace(2, 60, 400)
    curves = {
        name: (omega, seen_by_controller(drive_loop(plant, model, each, bandwidth_hz), omega))
        for name, each in drive_applications(damping).items()
    }
    return paint_bode(curves, "magnitude (dB re 1 rad/A)", height=3.2)[0]


# --- Section 3.6: Fig. 3.36 --------------------------------------------------------------------------------------


def drive_figure(
    *, stiffness_error: float, drive_damping: float, drive_weights: str, seed: int
) -> dict[str, float]:
    """What Fig. 3.36 shows, from exact responses between 5 and 30 Hz; it has no fast variant.

    `stiffness_error` is that of the observer's model (relative), `drive_damping` the added ratio, `drive_weights` one
    of `drive.WEIGHTS`. The controller has no effect on what it sees.
    """
    plant = drive()
    model = replace(plant, stiffness=plant.stiffness * (1 + stiffness_error))
    omega = 2 * np.pi * np.linspace(5, 30, 2000)
    levels = {}
    for name, each in drive_applications(drive_damping).items():
        loop = drive_loop(plant, model, each, 4.0, drive_weights)
        levels[name] = 20 * np.log10(np.abs(seen_by_controller(loop, omega) / rigid_response(plant, omega)))
    found = {f"motion.fig-3-36.{name}": float(holds) for name, holds in statements(levels).items()}
    return found | {"motion.fig-3-36.rigid": float(np.abs(levels["MC and AD"]).max())}
