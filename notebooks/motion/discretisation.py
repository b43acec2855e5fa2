"""The sampled matrices of a flexible mode as chapter 2 prints them, beside the exact ones (notebook 04)."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from stillwork.lti.state_space import StateModel
from workbook import figures

VARIANTS = ("exact", "printed", "lightly damped")


def transition(
    omega: float, damping: float, sample_time: float, variant: str = "exact"
) -> Float64[np.ndarray, "2 2"]:
    r"""Transition matrix of one flexible mode, states :math:`(\eta, \dot\eta)`.

    ``exact``; ``printed``, (2.31) to the letter, whose off-diagonal terms lack :math:`1/\sqrt{1-\zeta^2}`;
    ``lightly damped``, (2.32).
    """
    light = variant == "lightly damped"
    root = 1.0 if light else np.sqrt(1 - damping**2)
    ratio = 0.0 if light else damping / root
    sine, cosine = np.sin(omega * root * sample_time), np.cos(omega * root * sample_time)
    off = sine if variant == "printed" else sine / root
    decay = np.exp(-damping * omega * sample_time)
    return decay * np.array([[ratio * sine + cosine, off / omega], [-omega * off, cosine - ratio * sine]])


def transition_error(omega: float, ratios, sample_time: float, variant: str, row: int) -> list[float]:
    """Relative error of an entry in the second column of a variant's transition matrix, by damping ratio."""
    pairs = ([transition(omega, ratio, sample_time, each) for each in (variant, "exact")] for ratio in ratios)
    return [float(np.abs(given / exact - 1)[row, 1]) for given, exact in pairs]


def discrete_compliance(model: StateModel) -> Float64[np.ndarray, "outputs inputs"]:
    """Static gain C (I - A)^-1 B + D of a discrete model without rigid-body modes, (2.22)."""
    return model.c @ np.linalg.solve(np.eye(len(model.a)) - model.a, model.b) + model.d


def order_differences(
    reduced_first: StateModel, whole: StateModel, kept: Sequence[int], left_out: np.ndarray
) -> list[float]:
    """Relative differences of A, B and D of a model that was reduced first from the `kept` states of the `whole` one.

    `left_out` is the discrete compliance of the discarded modes (Theorem 2.4.1).
    """
    kept = list(kept)
    return [
        np.abs(reduced_first.a - whole.a[np.ix_(kept, kept)]).max() / np.abs(whole.a).max(),
        np.abs(reduced_first.b - whole.b[kept]).max() / np.abs(whole.b).max(),
        np.abs(reduced_first.d - left_out).max() / np.abs(left_out).max(),
    ]


def type_2(states: StateModel) -> StateModel:
    """The same model with the positions of all modes first, (2.7)."""
    order = [*range(0, len(states.a), 2), *range(1, len(states.a), 2)]
    return StateModel(states.a[np.ix_(order, order)], states.b[order], states.c[:, order], states.d)


def paint_transition_error(frequency_hz: float, damping: float):
    """Explorer: error of the printed and of the lightly damped transition matrix over the sample time."""
    steps = np.geomspace(1e-6, 0.4 / frequency_hz, 200)
    figure, axis = figures.new(1, 1, height=2.8)
    w = 2 * np.pi * frequency_hz
    size = np.array([[1, 1 / w], [w, 1]])  # of each entry, which itself passes zero
    for variant in VARIANTS[1:]:
        off = [transition(w, damping, step, variant) - transition(w, damping, step) for step in steps]
        axis.loglog(1e3 * steps, (np.abs(off) / size).max(axis=(1, 2)), label=variant)
    axis.set(xlabel="sample time (ms)", ylabel="largest error, scaled entries")
    axis.legend()
    return figure
