"""Modal models fitted to frequency responses: a sampled plant's response matrix, or one measured accelerance."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from stillwork.base.checks import InputError, require_array, require_count, require_number
from stillwork.base.front_door import check_fields, checked
from stillwork.identification.frequency_response import Identified
from stillwork.lti.discretisation import sampled_modes
from stillwork.lti.modal import ModalModel

POWERS = (0, 2, 4)  # of the frequency, in the series for the compliance of the modes above the band
DAMPING = (1e-5, 0.3)  # range of the damping ratios that the fit looks for


@dataclass(frozen=True)
class ModalMatrixFit:
    """A modal model with rigid body and compliance, and how well it fits."""

    model: ModalModel
    deviation: Float64[np.ndarray, " modes"]  # standard deviation of the flexible frequencies (rad/s) ...
    damping_deviation: Float64[np.ndarray, " modes"]  # ... and of the damping ratios
    rank_one: Float64[np.ndarray, " modes"]  # second over first singular value of each mode's residue
    compliance_deviation: float  # the same of an entry of the compliance (m/N), for known frequencies
    misfit: float  # root mean square of the weighted error; 1 where only noise remains


@checked
def fit_modal_matrix(
    omega: ArrayLike,
    response: ArrayLike,
    deviation: ArrayLike,
    modes: int,
    step: float,
    rigid_modes: int,
    damping_guess: float = 0.005,
) -> ModalMatrixFit:
    r"""Fit frequencies, damping and residue matrices by weighted least squares over all entries at once.

    The plant is sampled with a zero-order hold: :math:`G = R_0b_0 + \sum_i R_ib_i(\omega_i, \zeta_i) +
    \frac{1+z^{-1}}2(D + \omega^2D_2 + \omega^4D_4)`, where :math:`b_i` is the exact sampled response of one mode of
    unit residue. :math:`D` is the compliance of higher modes, the next terms its growth towards their resonances;
    the hold delays it by half a sample, as the exact response of an undamped mode does. The model keeps :math:`D`.
    The residues follow linearly from frequencies and damping, which alone are searched (variable projection). The
    modes are found one after the other, each where what the others leave is largest. At the end every residue is
    brought to rank one, the rigid body's to rank `rigid_modes`. The response (lines, outputs, inputs) is in m/N, and
    `deviation` the standard deviation of an entry's complex error on each line.
    """
    omega = require_array("omega", omega, ndim=1)
    response = require_array("response", response, shape=(len(omega), None, None), dtype=np.complex128)
    deviation = require_array("deviation", deviation, shape=omega.shape)
    require_count("modes", modes)
    require_number("step", step, above=0.0)
    require_number("damping_guess", damping_guess, above=0.0, below=1.0)
    outputs, inputs = response.shape[1:]
    if not 0 <= rigid_modes <= min(outputs, inputs):
        raise InputError(f"rigid_modes is {rigid_modes}; it cannot exceed the numbers of inputs and outputs")
    if np.any(deviation <= 0):
        raise InputError("deviation must be positive at every line")
    if len(omega) < 10 * (modes + 3) or np.any(np.diff(omega) <= 0) or omega[0] <= 0:
        raise InputError(f"omega must ascend from above 0 and hold at least {10 * (modes + 3)} lines")
    problem = _Problem(omega, response, deviation, step)
    parameters = np.zeros((2, 0))
    for count in range(1, modes + 1):
        left = problem.residual(parameters).reshape(2, len(omega), -1)
        where = omega[(left**2).sum(axis=(0, 2)).argmax()]
        parameters = np.column_stack([parameters, np.log([where, damping_guess])])
        # A mode may move by 2 % at a time: further away it would take the place of another.
        low = np.stack([parameters[0] - 0.02, np.full(count, np.log(DAMPING[0]))])
        high = np.stack([parameters[0] + 0.02, np.full(count, np.log(DAMPING[1]))])
        best = least_squares(
            lambda p: problem.residual(p.reshape(2, -1)),
            np.clip(parameters, low + 1e-9, high - 1e-9).ravel(),
            bounds=(low.ravel(), high.ravel()),
            x_scale=np.repeat([0.002, 0.3], count),
            max_nfev=60 if count == modes else 6,
            xtol=1e-10,
        )
        parameters = best.x.reshape(2, -1)
    if best.status <= 0:
        raise InputError(
            "the search for frequencies and damping did not end; check the band and the number of modes"
        )
    parameters = parameters[:, np.argsort(parameters[0])]
    gains = problem.residues(parameters)
    spread = problem.spread(parameters)
    u, s, v = np.linalg.svd(np.concatenate([gains[:1], gains[1 + len(POWERS) :]]))
    ranks = [rigid_modes] + [1] * modes
    pairs = [
        (u[k][:, i] * np.sqrt(s[k, i]), v[k][i] * np.sqrt(s[k, i]))
        for k, rank in enumerate(ranks)
        for i in range(rank)
    ]
    still = np.zeros(rigid_modes)
    frequencies, damping = np.exp(parameters)
    model = ModalModel(
        np.concatenate([still, frequencies]),
        np.concatenate([still, damping]),
        np.array([into for _, into in pairs]),
        np.array([out for out, _ in pairs]).T,
        gains[1],
    )
    return ModalMatrixFit(
        model,
        frequencies * spread[0],
        damping * spread[1],
        s[1:, 1] / s[1:, 0] if s.shape[1] > 1 else np.zeros(len(s) - 1),  # one entry is of rank one
        problem.compliance_spread(parameters),
        float(np.sqrt(np.mean(np.sum(problem.residual(parameters).reshape(2, -1) ** 2, axis=0)))),
    )


class _Problem:
    """Weighted data, and what is linear in the residues."""

    def __init__(self, omega, response, deviation, step):
        self.omega, self.deviation, self.step, self.shape = omega, deviation, step, response.shape[1:]
        target = (response / deviation[:, None, None]).reshape(len(omega), -1)
        self.goal = np.vstack([target.real, target.imag])
        held = (1 + np.exp(-1j * omega * step)) / 2
        self.fixed = held * (omega / omega.max()) ** np.array(POWERS)[:, None]

    def _columns(self, parameters):
        """Orthogonal columns (rigid body, compliance terms, modes), their triangle and their sizes."""
        modes, ratios = np.exp(parameters)
        each = sampled_modes(np.append(0.0, modes), np.append(0.0, ratios), self.step, self.omega)
        whole = (np.vstack([each[:1], self.fixed, each[1:]]) / self.deviation).T
        stacked = np.vstack([whole.real, whole.imag])
        sizes = np.linalg.norm(stacked, axis=0)
        return *np.linalg.qr(stacked / sizes), sizes

    def residual(self, parameters) -> np.ndarray:
        q, _, _ = self._columns(parameters)
        return (self.goal - q @ (q.T @ self.goal)).ravel()

    def residues(self, parameters) -> np.ndarray:
        q, r, sizes = self._columns(parameters)
        return (np.linalg.solve(r, q.T @ self.goal) / sizes[:, None]).reshape(-1, *self.shape)

    def compliance_spread(self, parameters) -> float:
        """Standard deviation of an entry of D; each of the two parts of an error has half its variance."""
        _, r, sizes = self._columns(parameters)
        return float(np.linalg.norm(np.linalg.inv(r)[1]) / sizes[1] / np.sqrt(2))

    def spread(self, parameters) -> np.ndarray:
        """Standard deviations of the logarithms; each of the two parts of an error has half its variance."""
        small = 1e-6
        jacobian = [
            self.residual(parameters + small * direction.reshape(parameters.shape))
            - self.residual(parameters - small * direction.reshape(parameters.shape))
            for direction in np.eye(parameters.size)
        ]
        jacobian = np.array(jacobian) / (2 * small)
        return np.sqrt(np.diag(np.linalg.inv(jacobian @ jacobian.T)) / 2).reshape(parameters.shape)


@dataclass(frozen=True)
class ModalFit:
    """A modal model fitted to a measured accelerance."""

    model: ModalModel  # force to position
    omega: Float64[np.ndarray, " frequencies"]  # rad/s, of the fit
    error: Float64[np.ndarray, " frequencies"]  # relative

    def __post_init__(self):
        check_fields(self)

    @property
    def rms_error(self) -> float:
        """Root mean square of the relative error."""
        return float(np.sqrt(np.mean(self.error**2)))


@checked
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

    Examples
    --------
    >>> stage = lti.ModalModel([0.0, 600.0], [0.0, 0.01], [[0.3], [0.3]], [[0.3, -0.3]], [[0.0]])
    >>> omega = 2 * np.pi * np.arange(20.0, 200.0)
    >>> accelerance = -(omega**2) * stage.frequency_response(omega)[0, 0]
    >>> measured = identification.Identified(omega, accelerance, np.ones(180))
    >>> fit = identification.fit_modes(measured, [95.0], band_hz=(20.0, 199.0))
    >>> fit.model.frequencies.round(1), fit.model.damping.round(4)
    (array([  0., 600.]), array([0.  , 0.01]))
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
