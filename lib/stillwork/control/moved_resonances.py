"""Loops whose resonances are each somewhere in an interval: where they do most harm, and the loop with them there."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from stillwork.base.checks import InputError, require_array, require_choice
from stillwork.base.front_door import checked
from stillwork.control.bandwidth import FUNCTIONS, Loop, PeakConstraint, make_loop
from stillwork.control.loops import LoopResponse
from stillwork.control.pid import Pid
from stillwork.lti.discretisation import sampled_modes

STEPS = np.linspace(-1, 1, 25)  # to places of a mode beside its resonance, dense at its width, that are tried
SWEEPS = 2
SEEN = 1.0005  # times a limit, 0.004 dB: what is handed out keeps it within 0.01 dB


@checked
def moved_loop(loop: Loop, factors: Float64[np.ndarray, " modes"]) -> Loop:
    """The same observer and sample time on a plant whose frequencies are multiplied by these factors.

    Two of them may change places.
    """
    factors = require_array("factors", factors, shape=loop.plant.frequencies.shape)
    if not factors.min() > 0:
        raise InputError("factors must be above 0")
    plant = loop.plant.moved(factors * loop.plant.frequencies)
    return make_loop(plant, loop.compensator, sample_time=loop.sample_time, delay=loop.delay)


@checked
def worst_factors(
    loop: Loop, controller: Pid, function: str, shares: Float64[np.ndarray, " modes"]
) -> tuple[float, Float64[np.ndarray, " modes"]]:
    """Largest magnitude of a loop function over all resonances in their intervals, and factors that lead there.

    At each frequency of the loop's grid the modes are moved one after the other to the place that raises the
    magnitude most, from all of them low, high and in the middle: a mode's part of the plant runs along an arc. As a
    bounded sensitivity never lets the loop pass -1, the loop is stable in the whole box when it is in its middle.

    Parameters
    ----------
    loop : Loop
        On a model.
    controller : Pid
    function : str
        One of `FUNCTIONS`.
    shares : array_like, shape (modes,)
        By which each frequency of the plant may be lower or higher; 0: it stays.

    Returns
    -------
    tuple
        The magnitude, and the factors, one a frequency of the plant.

    Raises
    ------
    InputError
        When a share is negative or not below 1, or there is not one a frequency.

    Examples
    --------
    >>> stage = lti.ModalModel([0.0, 600.0], [0.0, 0.01], [[0.3], [0.3]], [[0.3, -0.3]], [[0.0]])
    >>> loop, pid = control.make_loop(stage), control.PidFamily(11.0)(15.0)
    >>> size, factors = control.worst_factors(loop, pid, "input_sensitivity", [0.0, 0.05])
    >>> bool(size > loop.peak(pid, "input_sensitivity").magnitude), factors  # lower is worse
    (True, array([1.  , 0.95]))
    """
    require_choice("function", function, FUNCTIONS)
    return _worst(_box(loop, shares), controller, function)


class _Box(NamedTuple):
    """A loop on a grid that its moved resonances need, and what each mode adds to its plant at the places tried."""

    loop: Loop
    moving: np.ndarray  # numbers of the modes that move
    places: np.ndarray  # rad/s, (moving, places, frequencies): lowest, highest, found, beside a line
    parts: np.ndarray  # m/N, of a mode at a place
    rest: np.ndarray  # m/N, of everything else


def _box(loop: Loop, shares: np.ndarray) -> _Box:
    plant = loop.plant
    shares = require_array("shares", shares, shape=plant.frequencies.shape)
    if not 0 <= shares.min() <= shares.max() < 1:
        raise InputError("shares must be at least 0 and below 1; 0 for a frequency that stays")
    moving = np.flatnonzero(shares)
    if not len(moving):
        nothing = np.zeros((0, 0, len(loop.omega)))
        return _Box(loop, moving, nothing, nothing, loop.plant_response)
    # As dense at the ends of the intervals as in their middle: there the worst place changes most from line to line.
    ends = [factor * loop.omega for factor in (1 - shares.max(), 1.0, 1 + shares.max())]
    omega = np.unique(np.clip(np.concatenate(ends), loop.omega[0], loop.omega[-1]))
    observer = loop.compensator.frequency_response(omega)
    loop = replace(loop, omega=omega, plant_response=loop.plant_at(omega), compensator_response=observer)
    centre, damping = plant.frequencies[moving, None, None], plant.damping[moving, None, None]
    low, high = centre * (1 - shares[moving, None, None]), centre * (1 + shares[moving, None, None])
    # Sampled, a mode above half the rate is seen folded back.
    turns = np.round(centre * loop.sample_time / (2 * np.pi))
    folded = 2 * np.pi * turns / loop.sample_time if loop.sample_time else 0 * centre
    seen = np.abs(folded + np.where((centre < folded), -1, 1) * omega)
    width = np.maximum(damping, 1e-7)
    reach = np.arcsinh(2 * shares[moving, None, None] / width)
    beside = seen * (1 + width * np.sinh(reach * STEPS[:, None]))
    ends = np.broadcast_to(np.concatenate([low, high, centre], axis=1), (len(moving), 3, len(omega)))
    places = np.concatenate([ends, np.clip(beside, low, high)], axis=1)
    parts = (plant.output_shapes[0] * plant.input_shapes[:, 0])[moving, None, None] * _unit(
        loop, places, damping
    )
    rest = loop.plant_response - parts[:, 2].sum(axis=0)
    return _Box(loop, moving, places, parts, rest)


def _worst(box: _Box, controller: Pid, function: str) -> tuple[float, np.ndarray]:
    loop, moving, places, parts, rest = box
    if not len(moving):
        return loop.peak(controller, function).magnitude, np.ones(len(loop.plant.frequencies))
    k_fb = loop.within(controller, slice(None)).controller
    every, worst, best = np.arange(len(loop.omega)), 0.0, np.ones(len(loop.plant.frequencies))
    starts, sweeps = (3, SWEEPS) if len(moving) > 1 else (1, 1)  # a mode by itself is seen through in one go
    for start in range(starts):
        taken = np.full((len(moving), len(loop.omega)), start)
        sum_of = rest + parts[:, start].sum(axis=0)
        for mode in [*range(len(moving))] * sweeps:
            others = sum_of - parts[mode, taken[mode], every]
            response = LoopResponse(others + parts[mode], loop.compensator_response, k_fb)
            sizes = np.abs(getattr(response, function))
            taken[mode] = sizes.argmax(axis=0)
            sum_of = others + parts[mode, taken[mode], every]
        sizes = sizes.max(axis=0)
        place = int(sizes.argmax())
        if sizes[place] > worst:
            worst = float(sizes[place])
            there = places[np.arange(len(moving)), taken[:, place], place]
            best[moving] = there / loop.plant.frequencies[moving]
    return worst, best


def _unit(loop: Loop, frequencies: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """Responses of modes of mass 1 on the loop's grid, each element of it with a frequency of its own."""
    omega = np.broadcast_to(loop.omega, frequencies.shape)
    if not loop.sample_time:
        return 1 / (frequencies**2 - omega**2 + 2j * damping * frequencies * omega)
    ratios = np.broadcast_to(damping, frequencies.shape)
    flat = sampled_modes(frequencies.ravel(), ratios.ravel(), loop.sample_time, omega.reshape(-1, 1))
    return flat.reshape(frequencies.shape) * np.exp(-1j * loop.omega * loop.sample_time * loop.delay)


@checked
def harmful_factors(
    loops: Sequence[Loop], controller: Pid, constraints: Sequence[PeakConstraint], shares: np.ndarray
) -> list[np.ndarray]:
    """Factors that make a loop exceed a constraint, the worst of each; empty when no place in the box does."""
    found, boxes = [], [_box(loop, shares) for loop in loops]
    for constraint in constraints:
        size, factors = max(
            (_worst(box, controller, constraint.function) for box in boxes),
            key=lambda each: each[0],
        )
        if size > SEEN * constraint.limit:
            found.append(factors)
    return found
