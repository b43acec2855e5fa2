r"""Observers whose gain has the least structured worst case: mu synthesis of a gain of few parameters.

The nominal machine's modes do not move each other, so what an error of mode j does to its states,
:math:`\Delta x_j(\omega, \delta_j) u`, is known for each real :math:`\delta_j`. An observer x = F x + B u + K (y - C (F x + B u))
of transfer H from y to its estimate turns that into the error :math:`(I - HC)\,\Delta x_j`, and errors of different modes
add up to no more than the sum of their largest sizes: a bound of the gain from the force to the errors, frequency by
frequency, over all real errors of all modes up to a size. Mu synthesis makes its peak small, the other entrant its mean.
"""

import numpy as np
from scipy.optimize import minimize

from contest.fixed_gain import fixed, stationary
from contest.nominal import Baseline, CompiledObserver, NominalModel, NominalNoise, TuningParameter
from contest.parametric import sampled_mode
from stillwork.estimation.riccati import discrete_gain

LINES = 32  # frequencies of the bound
ERRORS = np.linspace(-1, 1, 5)  # of a frequency that are tried everywhere, over the largest
EVALUATIONS = 60  # of the bound in a search
DOUBLINGS = 40  # at most
LOGARITHMS = -7.0, 12.0  # of forces over w, that are tried


def mode_responses(model: NominalModel, sample_time: float, z: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """States over forces at each of `z`, the frequencies with these errors there, a row each: line, mode, state, input."""
    lines, modes = errors.shape
    blocks, levers = np.empty((lines, modes, 2, 2)), np.empty((lines, modes, 2))
    omega = model.frequencies * (1 + errors)
    for line, mode in np.ndindex(lines, modes):
        place = omega[line, mode], model.damping[mode], sample_time
        sampled_mode(*place, blocks[line, mode], levers[line, mode])
    pushes = levers[..., None] * model.input_shapes[:, None]
    return np.linalg.solve(z[:, None, None, None] * np.eye(2) - blocks, pushes + 0j)


def doubled(a: np.ndarray, g: np.ndarray, h: np.ndarray) -> np.ndarray:
    """X = A'X(I + GX)^-1 A + H by the structure-preserving doubling algorithm (Chu, Fan, Lin and Wang 2004)."""
    unit = np.eye(len(a))
    for _ in range(DOUBLINGS):
        across = np.linalg.solve(unit + g @ h, np.hstack([a, g]))
        onward, spread = across[:, : len(a)], across[:, len(a) :]
        g = g + a @ spread @ a.T
        more = a.T @ h @ onward
        h, a = h + more, a @ onward
        if np.abs(more).max() < 1e-9 * np.abs(h).max():
            break
    return (h + h.T) / 2


class WorstCase:
    """The bound of one machine for errors up to a size, under forces of `force` deviations of w."""

    def __init__(
        self,
        model: NominalModel,
        noise: NominalNoise,
        sample_time: float,
        size: float,
        force: float,
        peak: bool,
    ):
        self.model, self.noise, self.peak = model, noise, peak
        self.units = np.sqrt(np.diag(stationary(model, noise)[1]))
        flexible = model.frequencies > 0
        angles = np.geomspace(model.frequencies[flexible].min() * sample_time / 30, 0.98 * np.pi, LINES)
        self.z = np.exp(1j * angles)
        # Ends and middle of the errors, and at each line those that put a resonance on it.
        resonances = np.where(
            flexible, model.frequencies * np.sqrt(1 - 2 * np.minimum(model.damping, 0.7) ** 2), np.inf
        )
        tuned = np.clip(angles[:, None] / sample_time / resonances - 1, -size, size)
        tried = [tuned, *(np.full(tuned.shape, size * error) for error in ERRORS)]
        nominal = mode_responses(model, sample_time, self.z, 0 * tuned)
        every = [
            gain * moved - nominal
            for moved in (mode_responses(model, sample_time, self.z, each) for each in tried)
            for gain in (1 - size, 1 + size)  # the largest lie at the ends of the gains
        ]
        self.deviations = force * np.sqrt(noise.process[0, 0]) * np.array(every)
        loud = force * np.sqrt(noise.process[0, 0]) * np.linalg.norm(nominal, axis=3)
        self.flexible = np.arange(2 * model.rigid_modes, len(model.a))
        # Machines are moved smoothly: forces fall off above a tenth of the first flexible frequency.
        corner = model.frequencies[model.frequencies > 0].min() * sample_time / 10
        smooth = 1 / (1 + (np.angle(self.z) / corner) ** 2)
        self.deviations *= smooth[:, None, None, None]
        loud *= smooth[:, None, None]
        # A state counts relative to what the forces make of it.
        self.scale = loud.max(axis=0).ravel()[self.flexible]
        self.roots = np.sqrt(np.diag(noise.process)), np.sqrt(np.diag(noise.sensor))

    def driven(self, logarithms: np.ndarray) -> np.ndarray:
        """Noise input of w and of a force on each mode, the logarithms of its sizes over w's given."""
        b, modes = self.model.b, np.arange(len(self.model.frequencies))
        pairs = b.reshape(len(modes), 2, -1)
        strongest = np.abs(pairs).sum(axis=1, keepdims=True).argmax(axis=2)[:, :, None]
        own = np.zeros((len(modes), 2, len(modes)))
        own[modes, :, modes] = np.take_along_axis(pairs, strongest, axis=2)[:, :, 0]
        own *= np.exp(np.clip(logarithms, *LOGARITHMS)) * self.roots[0][0]
        return np.hstack([b * self.roots[0], own.reshape(len(b), -1)])

    def quick_gain(self, logarithms: np.ndarray) -> np.ndarray:
        """The Kalman gain for these forces, unchecked, in the units of the states' deviations."""
        a = self.model.a * self.units / self.units[:, None]
        g, c = (
            self.driven(logarithms) / self.units[:, None],
            self.model.c * self.units / self.roots[1][:, None],
        )
        p = doubled(a.T, c.T @ c, g @ g.T)
        own = np.linalg.solve(c @ p @ c.T + np.eye(len(c)), c @ p).T
        return self.units[:, None] * own / self.roots[1]

    def of(self, logarithms: np.ndarray) -> float:
        """The bound for these forces; infinite where no gain is found."""
        try:
            return self.bound(self.quick_gain(logarithms))
        except np.linalg.LinAlgError:
            return np.inf

    def bound(self, gain: np.ndarray) -> float:
        """Over frequencies the peak or the mean of the flexible states' gains squared, of errors, w and v together."""
        m, n = self.model, len(self.model.a)
        keeps = np.eye(n) - gain @ m.c
        observe = np.linalg.solve(np.eye(n) - keeps @ m.a / self.z[:, None, None], gain + 0j)
        turns = (np.eye(n) - observe @ m.c)[:, self.flexible]  # of a deviation of the states into the error
        of_modes = turns.reshape(len(self.z), len(self.flexible), -1, 2)
        # Deviation, line, state, mode, input; then the largest over a mode's errors, and the sum over modes.
        errors = np.einsum("lsmp,dlmpi->dlsmi", of_modes, self.deviations)
        model_part = np.linalg.norm(errors, axis=4).max(axis=0).sum(axis=2)
        shaken = turns @ np.linalg.solve(self.z[:, None, None] * np.eye(n) - m.a, m.b * self.roots[0] + 0j)
        noises = (
            np.linalg.norm(shaken, axis=2) ** 2
            + np.linalg.norm(observe[:, self.flexible] * self.roots[1], axis=2) ** 2
        )
        each = ((model_part**2 + noises) / self.scale**2).sum(axis=1)
        return float(np.sqrt(each.max() if self.peak else np.trapezoid(each, np.angle(self.z))))


def least(worst: WorstCase) -> CompiledObserver:
    """The gain of least bound among Kalman gains for a force on each mode, by Nelder and Mead's search."""
    starts = [np.full(len(worst.model.frequencies), np.log(each)) for each in (0.1, 1.0, 10.0, 100.0)]
    options = {"maxfev": EVALUATIONS}
    found = minimize(worst.of, min(starts, key=worst.of), method="Nelder-Mead", options=options).x
    model = worst.model
    solved = discrete_gain(model.a, worst.driven(found), model.c, 1.0, worst.noise.sensor)
    return fixed(model.a, model.b, solved.filter_gain, model.c)


def mu_synthesis(
    model: NominalModel, noise: NominalNoise, sample_time: float, size: float, force: float
) -> CompiledObserver:
    """The least peak over frequency."""
    return least(WorstCase(model, noise, sample_time, size, force, peak=True))


def structured_h2(
    model: NominalModel, noise: NominalNoise, sample_time: float, size: float, force: float
) -> CompiledObserver:
    """The least mean over frequency."""
    return least(WorstCase(model, noise, sample_time, size, force, peak=False))


KNOBS = (
    TuningParameter("largest error given", 1e-3, 0.2, 0.03),
    TuningParameter("force over w", 1.0, 1e5, 100.0),
)
STRUCTURED = {
    "mu synthesis": Baseline(
        mu_synthesis,
        KNOBS,
        "Doyle 1982; a gain of fixed structure, the errors real: Fan, Tits and Doyle 1991",
    ),
    "structured H2": Baseline(
        structured_h2, KNOBS, "the same with the mean over frequency in the place of the peak"
    ),
}
