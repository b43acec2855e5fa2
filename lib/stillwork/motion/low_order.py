r"""Low-order feedforward for a loop with an observer, the second recommendation of chapter 7.

The force is :math:`\sum_k\Theta_k r^{(k)} + \sum_i F_i(s)\ddot r` with a few filters F of one or two states. Their
poles are picked from those of the observer copy (Appendix A); all gains come from one least-squares problem on the
simulated error, like those of (A.1).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from stillwork.checks import InputError, require_choice, require_count
from stillwork.lti import ModalModel, StateModel, interconnect
from stillwork.motion.loops import INPUTS, OUTPUTS, closed_loop
from stillwork.motion.performance import rms
from stillwork.motion.setpoint import Setpoint
from stillwork.motion.tracking import BASIS, Feedforward, error_loop, fit_feedforward, tracking_error
from stillwork.motion.uncertainty import draw_errors, perturbed


def direct_loop(loop: StateModel) -> StateModel:
    """Of a single `closed_loop`, the model from (r, u_ff) to e_true: the feedforward that the observer sees."""
    return loop.select([INPUTS.index("r"), INPUTS.index("u_ff")], [OUTPUTS.index("e_true")])


def copy_poles(feedforward: StateModel) -> tuple[complex, ...]:
    """Poles a low-order feedforward may take from an observer copy: stable ones, one of every pair."""
    poles = feedforward.poles
    rate = np.abs(poles).max()
    return tuple(complex(p) for p in poles if p.real < -1e-9 * rate and p.imag >= 0)


def filters(pole: complex) -> list[StateModel]:
    """Filters with this pole (and its conjugate), gain one where they pass: 1 and s over the denominator."""
    w = abs(pole)
    if pole.imag == 0:
        return [StateModel(np.array([[-w]]), np.array([[w]]), np.ones((1, 1)), np.zeros((1, 1)))]
    a, b = np.array([[0, w], [-w, 2 * pole.real]]), np.array([[0.0], [w]])
    return [
        StateModel(a, b, row, np.zeros((1, 1))) for row in (np.array([[1.0, 0.0]]), np.array([[0.0, 1.0]]))
    ]


@dataclass(frozen=True)
class LowOrder:
    """A feedforward with filters; without any it is (A.1)."""

    gains: Feedforward
    poles: tuple[complex, ...] = ()  # one of every pair, rad/s
    weights: tuple[float, ...] = ()  # kg, one or two a pole: of its `filters`, on the acceleration

    @property
    def order(self) -> int:
        """Number of states."""
        return sum(len(filters(pole)) for pole in self.poles)

    def error(self, loop: StateModel, setpoint: Setpoint) -> Float64[np.ndarray, " samples"]:
        """True tracking error over the move (m); `loop` is a `direct_loop`."""
        error = tracking_error(loop, setpoint, self.gains)
        bank = [each for pole in self.poles for each in filters(pole)]
        base = tracking_error(loop, setpoint, Feedforward()) if bank else error
        for weight, each in zip(self.weights, bank, strict=True):
            error = error + weight * _filtered(loop, setpoint, each, base)
        return error


def _filtered(
    loop: StateModel, setpoint: Setpoint, each: StateModel, base: Float64[np.ndarray, " samples"]
) -> Float64[np.ndarray, " samples"]:
    """Error that the filtered acceleration causes as a force, exactly; `base` is the error without feedforward."""
    feedback, external = np.zeros((3, 2)), np.zeros((3, 2))
    feedback[1, 1] = external[0, 0] = external[2, 1] = 1
    whole = interconnect([loop, each], feedback, external, np.array([[1.0, 0.0]]))
    return tracking_error(whole, setpoint, Feedforward(acceleration=1.0)) - base


def fit_low_order(
    loop: StateModel, setpoint: Setpoint, poles: Sequence[complex] = (), basis: tuple[str, ...] = BASIS
) -> LowOrder:
    """Gains and weights that minimise the sum of squared errors over the whole move, for given poles.

    Parameters
    ----------
    loop : StateModel
        From (r, u_ff) to e_true, see `direct_loop`.
    setpoint : Setpoint
    poles : sequence of complex
        Of the filters, rad/s; one of every pair.
    basis : tuple of str
        Derivatives that act directly, of `tracking.BASIS`.

    Raises
    ------
    InputError
        When a pole is not stable, the basis unknown, or the move does not excite a gain.
    """
    if any(pole.real >= 0 or pole.imag < 0 for pole in poles):
        raise InputError("poles must be stable, one of every pair with a positive imaginary part, in rad/s")
    base, columns = _columns(loop, setpoint, basis)
    columns += [_filtered(loop, setpoint, each, base) for pole in poles for each in filters(pole)]
    return _solved(base, columns, basis, tuple(poles))


def _columns(loop, setpoint, basis):
    for name in basis:
        require_choice("basis", name, BASIS)
    base = tracking_error(loop, setpoint, Feedforward())
    return base, [tracking_error(loop, setpoint, Feedforward(**{name: 1.0})) - base for name in basis]


def _solved(base, columns, basis, poles) -> LowOrder:
    if not columns:
        raise InputError("basis and poles are empty; give at least one")
    matrix = np.array(columns).T
    sizes = np.linalg.norm(matrix, axis=0)
    if np.any(sizes == 0):
        raise InputError("setpoint does not move; the feedforward gains cannot be told apart")
    gains = np.linalg.lstsq(matrix / sizes, -base, rcond=1e-12)[0] / sizes
    direct, weights = gains[: len(basis)].tolist(), tuple(gains[len(basis) :].tolist())
    return LowOrder(Feedforward(**dict(zip(basis, direct, strict=True))), poles, weights)


def pick_poles(
    loop: StateModel,
    setpoint: Setpoint,
    candidates: Sequence[complex],
    order: int,
    basis: tuple[str, ...] = BASIS,
) -> list[LowOrder]:
    """Feedforwards of growing order: each takes the one candidate more that lowers the squared error most.

    Parameters
    ----------
    loop, setpoint, basis
        See `fit_low_order`.
    candidates : sequence of complex
        Poles to pick from, see `copy_poles`.
    order : int
        States at most.

    Returns
    -------
    list of LowOrder
        Beginning with the one without filters.
    """
    require_count("order", order, at_least=0)
    base, columns = _columns(loop, setpoint, basis)
    answers = {
        complex(pole): [_filtered(loop, setpoint, f, base) for f in filters(pole)] for pole in candidates
    }
    found = [_solved(base, columns, basis, ())]
    chosen: list[complex] = []
    while True:
        fitting = [
            p for p, each in answers.items() if p not in chosen and found[-1].order + len(each) <= order
        ]
        if not fitting:
            return found
        residuals = {pole: _residual(base, columns + answers[pole]) for pole in fitting}
        best = min(residuals, key=residuals.get)
        columns = columns + answers[best]
        chosen.append(best)
        found.append(_solved(base, columns, basis, tuple(chosen)))


def _residual(base: np.ndarray, columns: list[np.ndarray]) -> float:
    matrix = np.array(columns).T
    matrix = matrix / np.linalg.norm(matrix, axis=0)
    return float(np.linalg.norm(base - matrix @ np.linalg.lstsq(matrix, base, rcond=1e-12)[0]))


def perturbed_trial(
    rng: np.random.Generator,
    plant: ModalModel,
    compensator: StateModel,
    controller: StateModel,
    setpoint: Setpoint,
    copied: Feedforward,
    candidates: Mapping[str, LowOrder],
    size: float,
) -> dict[str, float]:
    """Rms of the true error in the scan (m) of every feedforward on one perturbed plant; a trial of a study.

    Every feedforward meets the plant twice: with the gains that were found on the nominal plant, and with gains
    tuned again on this one (poles and observer copy stay), as the data-based tuning does.

    Parameters
    ----------
    rng : numpy.random.Generator
    plant : ModalModel
        Nominal, one output.
    compensator, controller : StateModel
    setpoint : Setpoint
    copied : Feedforward
        Gains in front of the observer copy.
    candidates : mapping of str to LowOrder
    size : float
        Relative error of the flexible modes' parameters; mass and place of the sensor are known.
    """
    loop = closed_loop(perturbed(plant, draw_errors(rng, plant, size)), compensator, controller)
    direct, hidden = direct_loop(loop), error_loop(loop)
    found = {
        "observer copy, kept": tracking_error(hidden, setpoint, copied),
        "observer copy, tuned": tracking_error(hidden, setpoint, fit_feedforward(hidden, setpoint)),
    }
    for name, each in candidates.items():
        basis = tuple(b for b, gain in zip(BASIS, each.gains.gains, strict=True) if gain)
        found[f"{name}, kept"] = each.error(direct, setpoint)
        found[f"{name}, tuned"] = fit_low_order(direct, setpoint, each.poles, basis).error(direct, setpoint)
    return {name: rms(error[setpoint.scanning]) for name, error in found.items()}
