"""The flexible modes of a matrix response: each moves in every entry together."""

from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64

from stillwork.base.checks import InputError
from stillwork.base.validation import checked
from stillwork.identification.frequency_response import Identified
from stillwork.identification.modal_fit import identify_modes
from stillwork.lti.modal import ModalModel
from stillwork.machine.decoupled import real_terms

SAME = 0.01  # of a frequency, within which modes of several axes are one
SUMS = 4  # of all entries, with random weights


class MatrixModes(NamedTuple):
    """Modes that all entries of a response have in common, with their parts of each."""

    frequencies: Float64[np.ndarray, " modes"]  # rad/s
    damping: Float64[np.ndarray, " modes"]
    residues: Float64[
        np.ndarray, "modes axes axes"
    ]  # of the accelerance from the axes' forces to their positions
    delay: float  # s, of the response
    misfit: float  # of all entries, root mean square over the lines, relative

    @checked
    def moved(
        self, omega: Float64[np.ndarray, " lines"], factors: Float64[np.ndarray, " modes"]
    ) -> Complex128[np.ndarray, "lines axes axes"]:
        """What is added to the accelerance where the modes' frequencies are these times as high, their parts the same."""
        s = 1j * omega
        both = [_own(s, factor * self.frequencies, self.damping) for factor in (factors, 1.0)]
        return np.einsum("fm,mab->fab", (both[0] - both[1]) * np.exp(-s * self.delay)[:, None], self.residues)

    @checked
    def own(self, model: ModalModel, factors: Float64[np.ndarray, " modes"]) -> ModalModel:
        """The model of an axis with its modes moved likewise."""
        frequencies = model.frequencies.copy()
        for k in range(1, len(frequencies)):
            frequencies[k] *= factors[np.abs(np.log(self.frequencies / frequencies[k])).argmin()]
        return model.moved(frequencies)


def _own(s: np.ndarray, frequencies: np.ndarray, damping: np.ndarray) -> np.ndarray:
    return s[:, None] ** 2 / (s[:, None] ** 2 + 2 * damping * frequencies * s[:, None] + frequencies**2)


@checked
def fit_matrix(
    omega: Float64[np.ndarray, " lines"],
    inner: Complex128[np.ndarray, "lines axes axes"],
    models: Sequence[ModalModel],
    delay: float,
) -> MatrixModes | None:
    """Real parts of every entry, by least squares, of the modes of the axes' models and of those that all entries show.

    The latter are identified on a few sums of the entries with random weights, in each of which any mode is likely to stand out.
    None where there are no flexible modes.
    """
    sizes = np.sqrt(np.abs(np.einsum("fkk->fk", inner)[: len(omega) // 10 + 1]).mean(axis=0))
    scaled = inner / (sizes[:, None] * sizes)  # the axes' units do not count
    found = [
        (model.frequencies[k], model.damping[k]) for model in models for k in range(1, len(model.damping))
    ]
    found += _shown(omega, scaled)
    modes = np.zeros((0, 2))
    for each in found:
        if not len(modes) or np.abs(np.log(modes[:, 0] / each[0])).min() > SAME:
            modes = np.vstack([modes, each])
    if not len(modes):
        return None
    springs = np.array([(m.frequencies[0], m.damping[0]) for m in models if not m.rigid_modes]).reshape(-1, 2)
    modes = modes[[not len(springs) or np.abs(np.log(springs[:, 0] / f)).min() > SAME for f, _ in modes]]
    s, every = 1j * omega, np.vstack([modes, springs])
    columns = np.column_stack([s**0, (s / omega[-1]) ** 2, (s / omega[-1]) ** 4, _own(s, *every.T)])
    parts, misfit = real_terms(columns * np.exp(-s * delay)[:, None], scaled)
    residues = parts[3 : 3 + len(modes)] * (sizes[:, None] * sizes)
    return MatrixModes(modes[:, 0], modes[:, 1], residues, delay, misfit)


def _shown(omega: np.ndarray, scaled: np.ndarray) -> list[tuple[float, float]]:
    """Frequency and damping of the modes of a few sums of all entries, with the rigid bodies' part in each."""
    found = []
    for weights in np.random.default_rng(0).standard_normal((SUMS, *scaled.shape[1:])):
        weights[np.diag_indices(len(weights))] = np.abs(weights.diagonal())
        seen = Identified(omega, np.einsum("fab,ab->f", scaled, weights), np.full(len(omega), np.nan))
        with suppress(InputError):
            model = identify_modes(seen, (omega[0] / (2 * np.pi), omega[-1] / (2 * np.pi))).model
            found += list(zip(model.frequencies, model.damping, strict=True))[model.rigid_modes :]
    return found
