"""A measured structure as a stage: hammer records, a modal fit, and loops on the measured response."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from scipy.optimize import least_squares

from stillwork import paths
from stillwork.checks import InputError, require_array, require_number
from stillwork.lti import ModalModel, StateModel
from stillwork.motion.applications import Application, compensator
from stillwork.motion.bandwidth import Loop, make_loop
from stillwork.motion.controller import Pid
from stillwork.motion.identification import Identified, impact_response
from stillwork.motion.observer import Noise, kalman_observer
from stillwork.motion.reduction import truncate


def hammer_records() -> dict[str, np.ndarray]:
    """The shipped records: ``force_n`` and ``accel_m_s2`` (hits, samples) and ``fs_hz``; see SOURCE.md beside them."""
    file = paths.data("motion", "impact_frf_25k6/impact_hammer_5_hits.npz")
    with np.load(file, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive}


def measured_accelerance(padding: int = 4) -> Identified:
    """Acceleration over force of the structure (1/kg), counted positive along the force.

    The response has died out within each record, so zeros appended to it give a finer grid, not an
    interpolation.
    """
    records = hammer_records()
    force, response = (
        np.pad(records[name], ((0, 0), (0, (padding - 1) * records[name].shape[1])))
        for name in ("force_n", "accel_m_s2")
    )
    return impact_response(force, -response, float(records["fs_hz"]))  # the accelerometer faces the hammer


@dataclass(frozen=True)
class ModalFit:
    """A modal model fitted to a measured accelerance."""

    model: ModalModel  # force to position
    omega: Float64[np.ndarray, " frequencies"]  # rad/s, of the fit
    error: Float64[np.ndarray, " frequencies"]  # relative

    @property
    def rms_error(self) -> float:
        """Root mean square of the relative error."""
        return float(np.sqrt(np.mean(self.error**2)))


def fit_modes(
    measured: Identified, guesses_hz, band_hz: tuple[float, float], damping_guess: float = 1e-3
) -> ModalFit:
    r"""Fit rigid body, modes and compliance to an accelerance, by least squares of the relative error.

    :math:`A(\omega) = \frac1M + \sum_i\frac{-\omega^2 r_i}{\omega_i^2 - \omega^2 + 2j\zeta_i\omega_i\omega}
    - \omega^2 D`: the real residues follow linearly from frequencies and damping, which alone are searched.

    Parameters
    ----------
    measured : Identified
        Accelerance, 1/kg.
    guesses_hz : array_like
        Where the modes are, one entry a mode.
    band_hz : tuple of float
        Band of the fit.
    damping_guess : float
        Where the search for the damping ratios starts.

    Raises
    ------
    InputError
        When there are no guesses, a guess lies outside the band, or the fitted mass is not positive.
    """
    guesses = np.sort(require_array("guesses_hz", guesses_hz, ndim=1))
    low, high = (2 * np.pi * f for f in band_hz)
    if not len(guesses) or guesses[0] * 2 * np.pi <= low or guesses[-1] * 2 * np.pi >= high:
        raise InputError("guesses_hz must hold at least one frequency, all inside band_hz")
    require_number("damping_guess", damping_guess, above=0.0, below=1.0)
    inside = (measured.omega >= low) & (measured.omega <= high)
    w, target = measured.omega[inside], measured.response[inside]
    weight = 1 / np.abs(target)

    def columns(parameters):
        modes, ratios = np.exp(parameters.reshape(2, -1))
        terms = -(w**2) / (modes[:, None] ** 2 - w**2 + 2j * ratios[:, None] * modes[:, None] * w)
        return modes, ratios, np.vstack([np.ones_like(w), terms, -(w**2) / high**2])

    def solve(parameters):
        matrix = (columns(parameters)[2] * weight).T
        stacked, goal = (
            np.vstack([matrix.real, matrix.imag]),
            np.concatenate([(target * weight).real, (target * weight).imag]),
        )
        sizes = np.linalg.norm(stacked, axis=0)
        gains = np.linalg.lstsq(stacked / sizes, goal, rcond=None)[0] / sizes
        return gains, stacked @ gains - goal

    start = np.log(np.concatenate([2 * np.pi * guesses, np.full(len(guesses), damping_guess)]))
    # Modes may move by 1 % and damping by a factor of 30: further away they would swap places.
    reach = np.concatenate([np.full(len(guesses), 0.01), np.full(len(guesses), np.log(30))])
    best = least_squares(
        lambda p: solve(p)[1], start, bounds=(start - reach, start + reach), x_scale=reach / 10, max_nfev=60
    )
    gains, residual = solve(best.x)
    modes, ratios, _ = columns(best.x)
    order = np.argsort(modes)
    residues = gains[1:-1][order]
    if gains[0] <= 0:
        raise InputError("the fitted mass is not positive; check the sign of the response and the band")
    shapes = np.sqrt(np.abs(np.concatenate([gains[:1], residues])))
    model = ModalModel(
        np.concatenate([[0.0], modes[order]]),
        np.concatenate([[0.0], ratios[order]]),
        shapes[:, None],
        (shapes * np.sign(np.concatenate([gains[:1], residues])))[None, :],
        np.array([[gains[-1] / high**2]]),
    )
    half = len(w)
    return ModalFit(model, w, np.hypot(residual[:half], residual[half:]))


def as_stage(fit: ModalFit, mass: float) -> tuple[ModalModel, float]:
    """The fitted structure with another total mass, and the factor on its response."""
    require_number("mass", mass, above=0.0)
    factor = 1 / (mass * float(fit.model.input_shapes[0, 0] * fit.model.output_shapes[0, 0]))
    root = np.sqrt(factor)
    model = fit.model
    scaled = replace(
        model,
        input_shapes=root * model.input_shapes,
        output_shapes=root * model.output_shapes,
        feedthrough=factor * model.feedthrough,
    )
    return scaled, factor


def mirrored(model: ModalModel) -> ModalModel:
    """The same structure seen by a second sensor, at which every flexible mode has the other sign."""
    shapes = model.output_shapes.copy()
    shapes[:, model.rigid_modes :] *= -1
    return replace(model, output_shapes=shapes, feedthrough=-model.feedthrough)


def on_measurement(
    loop: Loop, measured: Identified, factor: float, band_hz: tuple[float, float], mirror: bool = False
) -> Loop:
    """The same loop with the measured response for a plant inside `band_hz`, and the model below it.

    Its loop functions are measured; its poles stay those of the model. With `mirror` the flexible part of the
    measurement, what it has beside the rigid body, changes sign.
    """
    inside = (measured.omega >= 2 * np.pi * band_hz[0]) & (measured.omega <= 2 * np.pi * band_hz[1])
    below = loop.omega[loop.omega < 2 * np.pi * band_hz[0]]
    omega = np.concatenate([below, measured.omega[inside]])
    position = -factor * measured.response[inside] / measured.omega[inside] ** 2
    if mirror:
        mobility = float(loop.plant.input_shapes[0, 0] * loop.plant.output_shapes[0, 0])
        position = -2 * mobility / measured.omega[inside] ** 2 - position
    plant = np.concatenate([loop.plant.frequency_response(below)[0, 0], position])
    return replace(
        loop,
        omega=omega,
        plant_response=plant,
        compensator_response=loop.compensator.frequency_response(omega),
    )


def extra_turns(measured: Loop, controller: Pid) -> int:
    """Turns around -1 that the measured open loop makes more than that of the model, on the measured band.

    Zero, with a stable model, means that the loop on the measured plant is stable too (Nyquist).
    """
    model = replace(
        measured,
        plant_response=measured.plant.frequency_response(measured.omega)[0, 0],
    )
    ratio = (1 + measured.at(controller).loop) / (1 + model.at(controller).loop)
    return round(float(np.sum(np.angle(ratio[1:] / ratio[:-1]))) / (2 * np.pi))


def structure_loops(
    stage: ModalModel, application: Application | None, retained: int, noise: Noise, noise_model: float | None
) -> list[Loop]:
    """Loops of a one-sensor structure and of its mirror image under one use of the observer."""
    return observed_loops((stage, mirrored(stage)), application, retained, noise, noise_model)


def observed_loops(
    plants: Sequence[ModalModel],
    application: Application | None,
    retained: int,
    noise: Noise,
    noise_model: float | None,
) -> list[Loop]:
    """One loop a plant, each with its own observer."""
    return [
        make_loop(
            plant,
            application and observing_compensator(plant, application, retained, noise, noise_model),
        )
        for plant in plants
    ]


def observing_compensator(
    plant: ModalModel, application: Application, retained: int, noise: Noise, noise_model: float | None
) -> StateModel:
    """Compensator on an observer of the plant's first `retained` modes and the compliance of the others."""
    reduced = truncate(plant, retained, len(plant.frequencies) - retained)
    return compensator(kalman_observer(reduced, noise, noise_model), application)
