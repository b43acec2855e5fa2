"""Loops on a machine with non-proportional damping, in the box around it; the phases are used for checks, not in the observer."""

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stillwork.base.validation import checked
from stillwork.control.bandwidth import Loop, loop_grid
from stillwork.control.uncertainty import Perturbation, Uncertainty, perturbed_plant, place_at
from stillwork.identification.phased import PhasedModel

CORNERED = 5  # modes of which all corners are tried
DRAWS = 60


@checked
def phased_loop(loop: Loop, phased: PhasedModel, place: Perturbation) -> Loop:
    """The loop with the response of the phased model at a place of the box; its poles stay those of the loop's model.

    As for a measurement, `encirclement_difference` decides whether it is stable.
    """
    plant = perturbed_plant(phased.model, place)
    late = place.delay / loop.sample_time if loop.sample_time else 0.0
    there = replace(loop, plant=plant, delay=max(loop.delay + late, 0.0))
    # The compensator's lines and responses there are those of the loop.
    more = np.setdiff1d(loop_grid(plant, None, sample_time=loop.sample_time), loop.omega)
    omega = np.concatenate([loop.omega, more])
    order = omega.argsort()
    answers = [loop.compensator_response]
    if len(more):
        answers.append(loop.compensator.frequency_response(more))
    # The moved model has its modes in their order.
    modes = np.argsort(phased.model.frequencies * place.frequencies, kind="stable")
    velocity = (phased.velocity * place.gain * place.residues / place.frequencies)[modes]
    added = phased.velocity_response(plant, velocity, omega[order], loop.sample_time, there.delay)
    return replace(
        loop,
        omega=omega[order],
        plant_response=there.plant_at(omega[order]) + added,
        compensator_response=np.concatenate(answers, axis=2)[..., order],
    )


@checked
def phased_corners(uncertainty: Uncertainty) -> list[Perturbation]:
    """All frequencies low or high, and each against the others, with the gain low and high; all damping low."""
    if uncertainty.is_empty:
        return []
    modes = np.size(uncertainty.frequency)
    sides = [np.full(modes, sign) for sign in (-1.0, 1.0)]
    if modes > 2:
        sides += [np.where(np.arange(modes) == k, -sign, sign) for k in range(1, modes) for sign in (-1, 1)]
    damped = np.append(np.zeros(modes), -np.ones(modes))
    return [
        place_at(uncertainty, np.concatenate([side, damped, [gain, 0.0, 0.0, 0.0]]))
        for side in sides
        for gain in (-1.0, 1.0)
    ]


@checked
def phased_places(uncertainty: Uncertainty, rng: np.random.Generator) -> list[Perturbation]:
    """Every corner of gain and of up to `CORNERED` frequencies, the other numbers at ends; then draws from faces and inside."""
    modes = np.size(uncertainty.frequency)
    ends, size = min(modes - 1, CORNERED), 3 * modes + 4
    places = []
    for corner in itertools.product([-1.0, 1.0], repeat=ends + 1):
        signs = rng.choice([-1.0, 1.0], size)
        signs[3 * modes], signs[1 : ends + 1] = corner[0], corner[1:]
        places.append(place_at(uncertainty, signs))
    for draw in range(DRAWS):
        signs = rng.choice([-1.0, 0.0, 1.0], size) if draw % 2 else rng.uniform(-1, 1, size)
        places.append(place_at(uncertainty, signs))
    return places


@checked
def phased_loops(
    loops: Sequence[Loop],
    phased: PhasedModel,
    places: Sequence[Perturbation],
) -> list[Loop]:
    """All sensors' loops at the first place, then at the next ones."""
    return [phased_loop(loop, phased, place) for place in places for loop in loops]
