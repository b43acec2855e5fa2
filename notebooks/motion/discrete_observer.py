"""The observer in discrete time (section 4.1): placement in z beside its closed form, and the figures."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy import linalg

from experiments.motion.designs import COMPENSATED, DAMPING, RETAINED
from experiments.motion.machines import published_noise, stage
from experiments.motion.pictures import add_magnitude, decibel, paint_magnitudes
from stillwork.base.checks import InputError
from stillwork.control.applications import Application
from stillwork.control.discrete_damping import damped_poles, discrete_damping_gain
from stillwork.control.discrete_observer import discrete_compensator, discrete_kalman_observer
from stillwork.control.feedback import place
from stillwork.control.loops import channel, closed_loop
from stillwork.lti.discretisation import zoh_modes
from stillwork.lti.modal import ModalModel
from stillwork.lti.peaks import resonance_grid
from stillwork.lti.reduction import truncate
from stillwork.lti.state_space import StateModel, constant
from workbook import figures

Z_METHODS = ("Ackermann", "robust")


def gain_by_placement(
    model: ModalModel, increase: float | ArrayLike, sample_time: float, method: str
) -> Float64[np.ndarray, "1 states"]:
    """The gain of (4.3) by a general pole-placement method in z, for comparison: it loses digits at high rates."""
    upper = np.exp(damped_poles(model, increase) * sample_time)
    wanted = np.concatenate([upper, upper.conj()])
    rigid = model.rigid_modes
    sampled = zoh_modes(model.modes(slice(rigid, None)), sample_time)
    gain = np.zeros((1, 2 * len(model.frequencies)))
    if method == "Ackermann":
        gain[:, 2 * rigid :] = place(sampled, wanted)
        return gain
    from scipy.signal import place_poles

    try:
        gain[:, 2 * rigid :] = -place_poles(sampled.a, sampled.b, wanted).gain_matrix
    except ValueError as error:
        raise InputError(f"model: its poles cannot be placed ({error}); lower the sampling rate") from None
    return gain


def placement_error(
    model: ModalModel, gain: ArrayLike, increase: float | ArrayLike, sample_time: float
) -> float:
    """Largest distance of a pole of A + BK from the wanted one, relative to the distance it had to move."""
    rigid = model.rigid_modes
    gain = np.asarray(gain, float)
    flexible = model.modes(slice(rigid, None))
    sampled = zoh_modes(flexible, sample_time)
    poles = linalg.eigvals(sampled.a + sampled.b @ gain[:, 2 * rigid :])
    free = flexible.poles[: len(flexible.frequencies)]
    wanted, before = (np.exp(each * sample_time) for each in (damped_poles(model, increase), free))
    return float((np.abs(poles[:, None] - wanted).min(axis=0) / np.abs(before - wanted)).max())


def typical_placement_error(
    model: ModalModel, increase: float | ArrayLike, sample_time: float, method: str
) -> float:
    """Median of `placement_error` over machines that differ by a little: the size of rounding without its luck.

    What rounding leaves on one machine is a draw: the next one, or the same one on another processor, gives ten times
    as much or as little. The median over 21 of them, with frequencies within 1 % of those of `model`, moved by a
    factor below 2 between processors. NaN where the method takes most of the machines for uncontrollable.
    """
    errors = []
    for shift in np.linspace(-0.01, 0.01, 21):
        machine = replace(model, frequencies=(1 + shift) * model.frequencies)
        if method == "closed form":
            gain = discrete_damping_gain(machine, increase, sample_time)
        else:
            try:
                gain = gain_by_placement(machine, increase, sample_time, method)
            except InputError:
                errors.append(np.inf)
                continue
        errors.append(placement_error(machine, gain, increase, sample_time))
    middle = float(np.median(errors))
    return middle if np.isfinite(middle) else np.nan


# How the estimate arrives: form and delay of `discrete_compensator`.
TIMINGS = {
    "filter, no delay": ("filter", 0),
    "filter, one sample late": ("filter", 1),
    "predictor, one sample late": ("predictor", 1),
}


def equivalent_plant(plant: StateModel, block: StateModel) -> StateModel:
    """What a controller of a sampled machine sees: from u to y - y_flex, with the damping loop closed."""
    seen = channel(closed_loop(plant, block, constant(np.zeros((1, 1)), plant.sample_time)), "u_ff", "e_meas")
    return StateModel(seen.a, seen.b, -seen.c, -seen.d, seen.sample_time)


def paint_placement(rates_khz: Sequence[float] | np.ndarray, errors: Mapping[str, Sequence[float]]) -> tuple:
    """Errors of the poles over the sampling frequency, a gap where not controllable to rounding; and which lines are rounding."""
    figure, axis = figures.new(1, 1, height=3.2)
    for (name, values), marker in zip(errors.items(), "osv^", strict=True):
        axis.loglog(rates_khz, values, f"{marker}-", markersize=4, label=name)
    axis.set_xlabel("sampling frequency (kHz)")
    axis.set_ylabel("relative error of the poles")
    axis.legend(fontsize=7)
    rounding = {
        "closed form": "rounding unit times the condition of the poles, over the way they move",
        "Ackermann in z": "rounding unit times the condition of the controllability matrix",
        "robust in z": "root of the rounding unit, where the method stops",
    }
    return figure, {f"discrete gain, {name}": why for name, why in rounding.items()}


LOW_HZ = 100.0  # where the pictures begin


def sampled_frequencies(sample_time: float) -> np.ndarray:
    """Grid around the resonances of the stage, up to half the sampling frequency (rad/s)."""
    return resonance_grid(stage().poles, LOW_HZ, min(2.5e3, 0.499 / sample_time), 250, 20)


def paint_equivalent_plants(panels: Mapping[str, Mapping[str, StateModel]]):
    """Magnitude of sampled plants, one panel a group; lines that coincide are distinguished by width and dashes."""
    styles = [
        {"color": figures.GREY, "linewidth": 1.5},
        {"color": figures.SKY, "linewidth": 4.0},
        {"color": figures.RED, "linewidth": 1.1},
        {"color": figures.BLACK, "linewidth": 1.3, "linestyle": "--"},
    ]
    curves = {title: {} for title in panels}
    for title, plants in panels.items():
        for (name, plant), style in zip(plants.items(), styles, strict=False):
            omega = sampled_frequencies(plant.sample_time)
            curves[title][name] = omega, plant.frequency_response(omega)[0, 0], style
    figure, axes = paint_magnitudes(curves, "magnitude (dB re 1 m/N)", height=3.4, sharey=True)
    figures.legend_below(axes[0, 0], len(axes[0, 0].lines), fontsize=7)
    return figure


def paint_sampled(rate_khz: float, damping: float, compensate: str, timing: str):
    """Explorer: what the controller sees of the sampled stage at mass 5, bare and with a sampled observer."""
    sample_time = 1e-3 / rate_khz
    machine = stage().at([0], [4])
    plant = zoh_modes(machine, sample_time)
    reduced = truncate(machine, RETAINED, COMPENSATED)
    observer = discrete_kalman_observer(reduced, published_noise(), sample_time, 0.03)
    application = Application(compensate == "yes", damping, "pole placement")
    block = discrete_compensator(observer, application, *TIMINGS[timing])
    seen = equivalent_plant(plant, block)
    figure, axis = figures.new(1, 1, height=3.0)
    omega = sampled_frequencies(sample_time)
    for name, each, colour in (("plant", plant, figures.GREY), ("with the observer", seen, figures.BLUE)):
        add_magnitude(axis, omega, each.frequency_response(omega)[0, 0], label=name, color=colour)
    # Two poles of the rigid body stay at z = 1; everything else must decay.
    grows = np.sort(np.abs(seen.poles))[-1] > 1 + 1e-4
    axis.set_title("the damping loop is unstable" if grows else timing)
    figures.label(axis, "frequency (Hz)", "magnitude (dB re 1 m/N)")
    axis.legend()
    return figure


# === Appendix =====================================================================================================


def appendix(page, *, plant: ModalModel, reduced: ModalModel, sample_time: float, noise_model: float) -> None:
    """What this notebook judges beside its answer: integral action, and what the predictor costs."""
    _of_integral_action(page, reduced, sample_time, noise_model)
    _of_predictor(page, plant, sample_time)


def _of_integral_action(page, reduced: ModalModel, sample_time: float, noise_model: float) -> None:
    page.text(r"""
## Integral action

Sampling leaves MC unchanged, $\hat y_{flex}(k) = C_f\,\hat x(k)$ (4.1). It keeps the integral action if the transfer $O_{yu}(z)$ from
$u$ to $\hat y_{flex}$ vanishes as $z\to1$, which requires the noise model. In dB re 1 m/N:
""")
    low, falls = 2 * np.pi * np.array([1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0]), {}
    for name, size in {"with": noise_model, "without": None}.items():
        observer = discrete_kalman_observer(reduced, published_noise(), sample_time, size)
        block = discrete_compensator(observer, Application(compensate=True))
        falls[f"{name} noise model"] = decibel(block.frequency_response(low)[1, 0])
    slopes = [values[1] - values[0] for values in falls.values()]
    page.check("motion.section-4-1-1.integral-action", np.mean(np.abs(np.array(slopes) - [20, 0]) < 1))
    page.show(pd.DataFrame(falls, index=[f"{f:g} Hz" for f in low / (2 * np.pi)]).T.round(1))


def _of_predictor(page, plant: ModalModel, sample_time: float) -> None:
    page.text(r"""
## The predictor

If the plant is the model, the poles are those without delay, and the covariance is $P_{k|k-1}$ instead of the filter's
$P_{k|k} = (I - LC)\,P_{k|k-1}$. Standard deviation of the prediction over that of the filtered estimate:
""")
    alone = plant.modes(slice(0, 4))
    observer = discrete_kalman_observer(alone, published_noise(), sample_time)
    gain = discrete_damping_gain(alone, DAMPING, sample_time)
    damped = Application(damping=DAMPING, selection="pole placement")
    block, sampled = discrete_compensator(observer, damped, "predictor", 1), zoh_modes(alone, sample_time)
    poles = equivalent_plant(sampled, block).poles
    pieces = (sampled.a + sampled.b @ gain, observer.a - observer.a @ observer.gain @ observer.c)
    separate = np.concatenate([*map(np.linalg.eigvals, pieces), [0.0]])  # the last: the stored force
    apart = np.abs(poles[:, None] - separate)
    far = max(apart.min(axis=0).max(), apart.min(axis=1).max())
    page.check("motion.section-4-1-3.predictor-compensates", round(float(far), 8))
    old, new = np.sqrt(np.diag(observer.updated_covariance)), np.sqrt(np.diag(observer.covariance))
    page.check("motion.section-4-1-3.prediction-error", np.mean(new > old))
    page.show(f"{(new / old).min():.4f} to {(new / old).max():.4f} by state")
