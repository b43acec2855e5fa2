"""A modal model fitted to a measured accelerance."""

from copy import copy
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize_scalar

from stillwork.base.bounds import Vector
from stillwork.base.checks import InputError, pluralise
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.identification.complex_frequency import STRONGEST, Stabilisation, stabilisation
from stillwork.identification.frequency_response import Identified
from stillwork.identification.phased import PhasedModel
from stillwork.lti.modal import ModalModel

FIXED = 3  # columns of an accelerance beside its modes: rigid body, compliance and its growth towards higher modes
# times its suspension's frequency that a machine's first resonance must have, or it is no rigid body
SUSPENDED = 3.0
GROUNDED = 0.02  # of the first mode's part, below which what would move freely is none
ROUNDS = 4  # of looking at what the modes so far leave
MOST_FITTED = 40  # of a measurement
FLOOR = 0.1  # relative noise of a line below which all lines weigh the same
SMOOTH = 9  # lines over which a response's size and its noise are averaged
MIN_MODE_ERROR = 0.5  # relative error that a mode must prevent, root mean square over its own width
F_RATIO = 30.0  # times the mean square error beside it, that the sum of squares without a mode must grow by
RUBBED = 0.7  # part of the squares without friction that may be left with it
RESONANT = 0.2  # damping ratio of a pole that may be a resonance beside friction
CANCELLED = 3.0  # times the response at its frequency, that a mode's own part may have
NEAR_GUESS = 5e-3  # of a frequency, within which a pole that settles takes the place of a guess
UNSETTLED = 1e-3  # damping ratio of a guess that no such pole is near
PHASED = 0.5  # part of the squares that modes with a phase of their own must leave, of those of the same modes without
MIN_GAIN = 1e-4  # part of the error that a candidate must take away to be tried
ROUNDING_POWER = 1e-16  # part of the response's square that is rounding
LEAST_LINES, HUGE = 32, 1e30  # of a measurement; what its response stays below, and its inverse above
# where a resonance that the band cuts may be, over the band's end, and its damping
LOG_CUT = np.log(
    np.array([(end, ratio) for end in (0.98, 0.99, 1.0, 1.01, 1.03, 1.06, 1.12) for ratio in (2e-3, 0.02)]).T
)
# a delay is one from that phase at the band's end on (rad), and with that share of the squares left
LATE_MODE = (0.05, 0.5)
CYCLES = 2.0  # of the band's end, that a response may be late or early at most
LAGS = 8  # lines over which errors may depend on each other, zeros appended to a record among the reasons


@by_value
@dataclass(frozen=True)
class ModalFit:
    """A modal model fitted to a measured accelerance.

    Standard deviations account for the noise, the error of the model and the correlation of neighbouring lines
    (Newey and West). Plus or minus 1.96 of them held the truth in 80 to 100 % of 40 fits each, on four machines with modes on
    one line to ten and noise of 2 % of the response, and in 88 to 100 % where the noise stays the same at all lines.
    """

    model: ModalModel  # force to position
    omega: Float64[np.ndarray, " frequencies"]  # rad/s, of the fit
    # relative, of the model, with the phases of its modes if it has them
    error: Float64[np.ndarray, " frequencies"]
    deviation: Float64[np.ndarray, " modes"]  # rad/s, of the flexible frequencies
    damping_deviation: Float64[np.ndarray, " modes"]  # of the damping ratios
    mass_deviation: float  # relative
    turned: bool  # whether the response is counted against the force
    diagram: Stabilisation  # where the modes were looked for
    # relative, of each mode's part of the response
    residue_deviation: Float64[np.ndarray, " modes"] = field(default_factory=lambda: np.zeros(0))
    delay: float = 0.0  # s, by which the response is late; the model is without
    delay_deviation: float = 0.0  # s, whether or not a delay was found
    drag_deviation: float = 0.0  # 1/s, of the friction over mass, where one was found
    # rad/s, resonances beyond the band
    cut: Float64[np.ndarray, " cut"] = field(default_factory=lambda: np.zeros(0))
    # with the phases of the modes' parts, where these are not decoupled
    phased: PhasedModel | None = None

    def __post_init__(self):
        check_fields(self)

    @property
    def rms_error(self) -> float:
        """Root mean square of the relative error."""
        return float(np.sqrt(np.mean(self.error**2)))


@checked
def fit_modes(measured: Identified, guesses_hz: Vector, band_hz: tuple[float, float]) -> ModalFit:
    r"""Fit rigid body, modes and compliance to an accelerance, by least squares of the relative error.

    :math:`A(\omega) = \frac1M + \sum_i\frac{-\omega^2 r_i}{\omega_i^2 - \omega^2 + 2j\zeta_i\omega_i\omega}
    - \omega^2 D`: the real residues follow linearly from frequencies and damping, which alone are searched (variable
    projection). :math:`M` is what the force feels far below the resonances at its own place, the rotation of a free body
    included; the lines below half the first resonance weigh as much as all others together.

    Parameters
    ----------
    measured : Identified or control.FrequencyResponseData or (frequencies in Hz, response)
        Accelerance, 1/kg. Lines with little coherence weigh less.
    guesses_hz : array_like
        Approximate frequencies, one entry per mode.
    band_hz : tuple of float
        Band of the fit.

    Returns
    -------
    ModalFit
        The model, its relative error at each line, and standard deviations of frequencies, damping ratios and mass.

    Raises
    ------
    InputError
        When there are no guesses, a guess lies outside the band, or the fitted mass is not positive.

    References
    ----------
    Golub and Pereyra, The differentiation of pseudo-inverses and nonlinear least squares problems whose variables
    separate (1973).

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
    if not len(guesses_hz):
        raise InputError(
            "guesses_hz must hold at least one frequency; identify_modes finds the modes by itself"
        )
    fit = identify_modes(measured, band_hz, guesses_hz)
    if fit.turned:
        raise InputError("the fitted mass is not positive; check the sign of the response and the band")
    return fit


@checked
def identify_modes(
    measured: Identified, band_hz: tuple[float, float], guesses_hz: Vector = (), *, rigid: bool = False
) -> ModalFit:
    """Find the modes of an accelerance, leave out the spurious ones, and fit as `fit_modes` does.

    Candidates are the poles that settle in a stabilisation diagram (`stabilisation`). In rounds, those that lower the
    error most are added and all are refined together; then modes go one by one that do not prevent an error of 50 %
    over their own width, that noise could have made, or that mostly cancel another. With `guesses_hz` the modes are
    these. A response of the opposite sign is inverted, and one with a delay is brought
    forward. A resonance beyond the band that shows in its lines is fitted, too, so that it does not bias the others, and
    left out of the model.

    Parameters
    ----------
    measured : Identified or control.FrequencyResponseData or (frequencies in Hz, response)
        Accelerance at one point, with its coherence.
    band_hz : tuple of float
        Lines that count; the mass comes from those below half the first resonance.
    guesses_hz : array_like, shape (modes,)
        Approximate frequencies of the modes; empty to find them.
    rigid : bool
        Whether the rigid body alone may be the answer, where no resonance stands out.

    Returns
    -------
    ModalFit
        See `fit_modes`; of the identified modes.

    Raises
    ------
    InputError
        When no mode is found and not `rigid`, or a guess lies outside the band.

    References
    ----------
    B. Peeters, H. Van der Auweraer, P. Guillaume and J. Leuridan, "The PolyMAX frequency-domain method: a new standard
    for modal parameter estimation?", Shock and Vibration 11 (2004).

    Examples
    --------
    >>> stage = lti.ModalModel([0.0, 600.0], [0.0, 0.01], [[0.3], [0.3]], [[0.3, -0.3]], [[0.0]])
    >>> omega = 2 * np.pi * np.arange(20.0, 200.0)
    >>> accelerance = -(omega**2) * stage.frequency_response(omega)[0, 0]
    >>> measured = identification.Identified(omega, accelerance, np.ones(180))
    >>> identification.identify_modes(measured, band_hz=(20.0, 199.0)).model.frequencies.round(1)
    array([  0., 600.])
    """
    guesses = np.sort(np.asarray(guesses_hz, float))
    if len(guesses) and (guesses[0] <= band_hz[0] or guesses[-1] >= band_hz[1]):
        raise InputError("guesses_hz must be empty or hold frequencies all inside band_hz")
    problem = _Accelerance(measured, band_hz)
    diagram = stabilisation(problem.omega, problem.target[:, None, None])
    free = _identified(problem, diagram, guesses, band_hz, rigid)
    problem, modes = _rubbed(measured, band_hz, diagram, guesses, free, rigid)
    if modes.size and not len(guesses):
        phased = _Accelerance(measured, band_hz, phased=True)
        found = phased.phase(problem, modes, np.log(diagram.settled()))
        if found is not None:
            problem, modes = phased, found
    return problem.fit(modes, diagram)


def _rubbed(measured, band_hz, diagram, guesses, free, rigid):
    """The problem and its modes with friction where that explains more, else those without."""
    # A free body on viscous friction, where that explains more with no more modes than without.
    if not free[0].grounded:
        rubbed = _Accelerance(measured, band_hz)
        if rubbed.rub(np.log(diagram.settled()) if free[1].size else free[1]):
            try:
                other = _identified(rubbed, diagram, guesses, band_hz, rigid)
            except InputError:
                return free
            left = [each.cost(modes) for each, modes in (free, other)]
            fewer = free[1].shape[1] - other[1].shape[1]
            if not other[0].grounded and (
                left[1] < RUBBED * left[0] if fewer <= 0 else left[1] < left[0] / RUBBED
            ):
                return other
    return free


def _identified(problem, diagram, guesses, band_hz, rigid=False):
    """The modes of `identify_modes`, and the problem with its delay and friction as they were found."""
    settled = np.log(diagram.settled())
    ends = LOG_CUT + np.log([[problem.omega[-1]], [1.0]])
    problem.bring_forward(np.hstack([settled[:, :MOST_FITTED], ends]))
    modes = np.zeros((2, 0))
    if len(guesses):
        modes = np.log([2 * np.pi * guesses, np.full(len(guesses), UNSETTLED)])
        for mode in modes.T:
            apart = np.abs(settled[0] - mode[0])
            if apart.size and apart.min() < NEAR_GUESS:
                mode[:] = settled[:, apart.argmin()]
        modes = problem.refined(modes, 60)
    else:
        modes = problem.found(modes, settled)
        beyond = problem.columns(ends, derivatives=False)[0][:, FIXED:]
        cut = problem.pruned(
            problem.refined(problem.extended(modes, ends, beyond, most=1), 20), MIN_MODE_ERROR
        )
        if cut.shape[1] > modes.shape[1]:
            modes = problem.found(cut, settled)
    problem.grounded = problem.on_springs(modes)
    if modes.size and (problem.grounded or not len(guesses)):
        modes = problem.refined(modes, 60)
        modes = modes if len(guesses) else problem.pruned(modes, MIN_MODE_ERROR)
    if not rigid and not np.any(modes[0] <= np.log(problem.omega[-1])):
        raise InputError(
            f"no resonance stands out from {band_hz[0]:g} to {band_hz[1]:g} Hz; widen fit_hz, or let it "
            "be the band in which the response stands out of its noise"
        )
    if not modes.size:
        problem.take_back()  # of a delay that was found among poles that are none
    problem.bring_forward(modes)
    problem.rub_again(modes)
    return problem, problem.refined(modes, 60) if problem.drag and modes.size else modes


class _Accelerance:
    """An accelerance in a band, its weights, and what is linear in the residues."""

    def __init__(self, measured: Identified, band_hz: tuple[float, float], phased: bool = False):
        inside = (measured.omega >= 2 * np.pi * band_hz[0]) & (measured.omega <= 2 * np.pi * band_hz[1])
        self.omega, self.target = measured.omega[inside], measured.response[inside]
        if (
            len(self.omega) < LEAST_LINES
            or not 1 / HUGE < np.abs(self.target).min() <= np.abs(self.target).max() < HUGE
        ):
            raise InputError(
                f"measured holds {pluralise(len(self.omega), 'line')} from {band_hz[0]:g} to {band_hz[1]:g} Hz, or a response of zero, "
                f"NaN or beyond {HUGE:g}; give at least {LEAST_LINES} lines of a response in 1/kg"
            )
        # A line that noise has made small by chance must not weigh more than its neighbours.
        size = np.sqrt(uniform_filter1d(np.abs(self.target) ** 2, SMOOTH, mode="nearest"))
        coherence = np.nan_to_num(measured.coherence[inside], nan=1.0)
        coherence = np.clip(uniform_filter1d(coherence, SMOOTH, mode="nearest"), 1e-6, 1.0)
        noise = np.sqrt((1 - coherence) / coherence)
        self.weight = 1 / (size * np.hypot(1.0, noise / FLOOR))
        self.goal = _stacked(self.target * self.weight)
        self.delay = 0.0  # s, by which the response was late
        self.drag = 0.0  # 1/s, of the rigid body
        self.phased = phased  # whether each mode's part has a velocity's beside it
        self.grounded = False  # then no rigid body is free, and a third term of the series takes its column

    def columns(self, modes, derivatives=True):
        """Weighted columns, real above imaginary: rigid body, compliance, its growth, modes; and the modes' derivatives."""
        (frequency, damping), w = np.exp(modes)[:, :, None], self.omega
        loss = 2j * damping * frequency * w
        own = -(w**2) / (frequency**2 - w**2 + loss)
        fixed = -((w / w[-1]) ** np.array([[6 if self.grounded else 0], [2], [4]]))
        fixed[0] *= -1
        if self.drag and not self.grounded:
            fixed = fixed.astype(complex)
            fixed[0] = 1j * w / (1j * w + self.drag)
        moved = own**2 / w**2
        moving = [moved * (2 * frequency**2 + loss), moved * loss] if derivatives else []
        speed = 1j * w / w[-1]
        beside = [speed * own] if self.phased else []
        if self.phased:
            moving += [speed * each for each in moving]
        parts = np.vstack([*fixed, own, *beside, *moving]) * self.weight
        stacked = np.hstack([parts.real, parts.imag]).T
        return np.split(stacked, [FIXED + (1 + self.phased) * modes.shape[1]], axis=1)

    def solved(self, modes):
        """Gains, residual and its derivative by the modes' parameters, what the gains take up left out (Kaufman)."""
        linear, moving = self.columns(modes)
        q, r, sizes = _orthogonal(linear)
        gains = np.linalg.solve(r, q.T @ self.goal) / sizes
        moving = self.slopes(moving, gains)
        return gains, linear @ gains - self.goal, moving - q @ (q.T @ moving)

    def slopes(self, moving, gains):
        """Derivatives of the response by the modes' parameters, from those of its parts."""
        if not self.phased:
            return moving * np.tile(gains[FIXED:], 2)
        own, beside = np.split(gains[FIXED:], 2)
        first, second = np.split(moving, 2, axis=1)
        return first * np.tile(own, 2) + second * np.tile(beside, 2)

    def refined(self, modes, steps):
        """Frequencies and damping by Levenberg and Marquardt; a mode that moved further would take another's place."""
        reach = np.stack([np.maximum(0.01, np.exp(modes[1])), np.full(modes.shape[1], np.log(30))])
        low, high = modes - reach, modes + reach
        low[1], high[1] = np.maximum(low[1], np.log(1e-5)), np.minimum(high[1], np.log(STRONGEST))
        _, residual, jacobian = self.solved(modes)
        cost, caution = residual @ residual, 1e-3
        for _ in range(steps):
            normal, slope = jacobian.T @ jacobian, jacobian.T @ residual
            normal[np.diag_indices_from(normal)] *= 1 + caution
            move = np.linalg.lstsq(np.asarray_chkfinite(normal), -slope, rcond=None)[0]
            trial = np.clip(modes + move.reshape(2, -1), low, high)
            _, residual_there, jacobian_there = self.solved(trial)
            gained = cost - residual_there @ residual_there
            if gained < 0:
                caution *= 10
                continue
            modes, residual, jacobian, caution = trial, residual_there, jacobian_there, caution / 10
            cost -= gained
            if gained <= 1e-7 * cost:
                break
        return modes

    def bring_forward(self, modes):
        """Take the delay out of the response with which these modes, moved a little, leave least of it."""
        linear, moving = self.columns(modes)
        q, _, _ = _orthogonal(np.hstack([linear, moving]))

        def left(delay):
            turned = np.exp(1j * np.multiply.outer(self.omega, delay))
            goal = _stacked((turned.T * (self.target * self.weight)).T)
            return np.sum((goal - q @ (q.T @ goal)) ** 2, axis=0)

        cycle = 2 * np.pi / self.omega[-1]
        tried = cycle * np.arange(-CYCLES, CYCLES + 1e-9, 1 / 16)
        near = tried[np.argmin(left(tried))]  # one product of matrices instead of many with a vector
        found = minimize_scalar(
            left,
            bounds=(near - cycle / 16, near + cycle / 16),
            method="bounded",
            options={"xatol": 1e-6 * cycle},
        )
        phase, share = LATE_MODE
        if abs(found.x) * self.omega[-1] > phase and found.fun < share * left(0.0):
            self.delay += float(found.x)
            self.target = self.target * np.exp(1j * self.omega * found.x)
            self.goal = _stacked(self.target * self.weight)

    def take_back(self):
        """The response as late as it was."""
        self.target, self.delay = self.target * np.exp(-1j * self.omega * self.delay), 0.0
        self.goal = _stacked(self.target * self.weight)

    def cost(self, modes):
        """Squares that these modes leave."""
        residual = self.solved(modes)[1]
        return residual @ residual

    def phase(self, plain, before, settled):
        """Modes with phases of their own, where these explain the response far better than the same modes without."""
        self.drag, self.grounded = plain.drag, plain.grounded
        taken = np.zeros((2, 0))
        inside = settled[:, settled[0] <= np.log(self.omega[-1])][:, :MOST_FITTED]
        for mode in np.hstack([inside, before[:, before[0] <= np.log(self.omega[-1])]]).T:
            if not np.any(np.abs(taken[0] - mode[0]) < 0.5 * np.exp(mode[1])):
                taken = np.column_stack([taken, mode])
        self.bring_forward(taken)
        modes = self.pruned(self.refined(self.pruned(taken, MIN_MODE_ERROR / 2), 20), MIN_MODE_ERROR)
        if not modes.size:
            return None
        if not self.grounded and self.on_springs(modes):
            # Without phases its suspension was no mode of its own.
            self.grounded, self.drag = True, 0.0
        self.bring_forward(modes)
        modes = self.refined(modes, 60)
        left, decoupled = self.cost(modes), copy(self)
        decoupled.phased = False
        without = min(decoupled.cost(decoupled.refined(modes, 60)), plain.cost(before))
        noise = left / (2 * len(self.omega))
        if left > PHASED * without or without - left < F_RATIO * modes.shape[1] * noise:
            return None
        return modes

    def _model(self, modes, rigid, own, compliance, sign):
        """A model of gains as `columns` counts them, all times a sign."""
        free = np.zeros(0 if self.grounded else 1)
        residues = sign * np.append(np.full(len(free), rigid), own)
        shapes = np.sqrt(np.abs(residues))
        frequencies, damping = np.exp(modes)
        return ModalModel(
            np.append(free, frequencies),
            np.append(free, damping),
            shapes[:, None],
            (shapes * np.sign(residues))[None, :],
            np.array([[sign * compliance / self.omega[-1] ** 2]]),
            drag=0.0 if self.grounded else self.drag,
        )

    def rub(self, settled):
        """Look for viscous friction and a delay at once; whether any friction explains the response far better.

        Of the settled poles those that are no resonance, by their damping, are left out: they stand for what is sought.
        """
        modes = settled[:, np.exp(settled[1]) < RESONANT][:, :MOST_FITTED]
        if settled.size and not modes.size:
            return False
        first = np.exp(modes[0].min(initial=np.log(self.omega[-1])))
        trials = np.append(0.0, np.geomspace(self.omega[0] / 100, first, 60))
        left = self.left_with(modes, trials)
        best = int(left.argmin())
        noise = left[best] / (2 * len(self.omega))
        if not best or left[0] - left[best] < F_RATIO * noise or left[best] > RUBBED * left[0]:
            return False
        self.drag = self.finer(modes, trials, best)
        return True

    def rub_again(self, modes):
        """The friction that leaves least with these modes, moved a little."""
        if self.drag:
            trials = self.drag * np.geomspace(0.5, 2, 41)
            self.drag = self.finer(modes, trials, int(self.left_with(modes, trials).argmin()))

    def finer(self, modes, trials, best):
        """The least between the neighbours of the best of the trials."""
        ends = trials[max(best - 1, 1)], trials[min(best + 1, len(trials) - 1)]
        found = minimize_scalar(
            lambda drag: float(self.left_with(modes, np.array([drag]))[0]),
            bounds=(min(ends), max(ends)),
            method="bounded",
            options={"xatol": 1e-6 * trials[best]},
        )
        return float(found.x)

    def left_with(self, modes, drags):
        """Squares left by these modes, moved a little, a delay, and each friction: the rigid body's column alone differs."""
        before, self.drag = self.drag, 0.0
        linear, moving = self.columns(modes)
        self.drag = before
        lag = -1j * self.omega * self.target * self.weight  # a little delay of all of it
        q, _, _ = _orthogonal(np.column_stack([linear[:, 1:], moving, _stacked(lag)]))
        goal = self.goal - q @ (q.T @ self.goal)
        found = []
        for drag in drags:
            column = _stacked(1j * self.omega / (1j * self.omega + drag) * self.weight)
            column = column - q @ (q.T @ column)
            found.append(goal @ goal - (column @ goal) ** 2 / (column @ column))
        return np.array(found)

    def found(self, modes, settled):
        """These modes and those of the settled poles that stand, in rounds."""
        columns = self.columns(settled, derivatives=False)[0][:, FIXED:]
        for _ in range(ROUNDS):
            more = self.extended(modes, settled, columns)
            if more.shape[1] == modes.shape[1]:
                break
            modes = self.pruned(self.refined(self.pruned(more, MIN_MODE_ERROR / 2), 20), MIN_MODE_ERROR)
        return modes

    def extended(self, modes, settled, settled_columns, most=MOST_FITTED):
        """The modes and of the settled poles those that lower the error most, one after the other."""
        both = np.hstack([modes, settled])
        columns = np.hstack([self.columns(modes, derivatives=False)[0], settled_columns])
        columns = np.column_stack([columns / np.linalg.norm(columns, axis=0), self.goal])
        gram = columns.T @ columns
        taken = list(range(FIXED + modes.shape[1]))
        for pivot in taken:
            gram = _swept(gram, pivot)
        while len(taken) < FIXED + min(modes.shape[1] + most, MOST_FITTED):
            own = np.diag(gram)[:-1]
            gain = np.where(own > 1e-6, gram[-1, :-1] ** 2 / np.maximum(own, 1e-6), 0.0)
            gain[taken] = 0.0
            best = int(gain.argmax())
            if gain[best] <= max(MIN_GAIN * gram[-1, -1], ROUNDING_POWER * columns[:, -1] @ columns[:, -1]):
                break
            taken.append(best)
            gram = _swept(gram, best)
        return both[:, np.array(taken[FIXED:], dtype=int) - FIXED]

    def pruned(self, modes, least):
        """Without the spurious modes, which go one by one."""
        linear, _ = self.columns(modes, derivatives=False)
        linear = linear / np.linalg.norm(linear, axis=0)
        gram, right = linear.T @ linear, linear.T @ self.goal
        while modes.size:
            standing = self._standing(modes, linear, gram, right)
            worst = int(standing.argmin())
            if standing[worst] >= least:
                break
            own = self.places(modes)[:, worst]
            modes, linear = np.delete(modes, worst, axis=1), np.delete(linear, own, axis=1)
            gram, right = np.delete(np.delete(gram, own, axis=0), own, axis=1), np.delete(right, own)
        return modes

    def places(self, modes):
        """Which columns hold each mode's part, and in a second row its velocity's if the modes have phases."""
        return np.arange((1 + self.phased) * modes.shape[1]).reshape(1 + self.phased, -1) + FIXED

    def _standing(self, modes, linear, gram, right):
        """Relative error that each mode prevents over its own width; 0 for one that noise or cancelling could make."""
        inverse = np.linalg.pinv(gram, rcond=1e-13, hermitian=True)
        gains, places = inverse @ right, self.places(modes).T
        blocks = np.linalg.pinv(inverse[places[:, :, None], places[:, None, :]], hermitian=True)
        growth = np.einsum("ki,kij,kj->k", gains[places], blocks, gains[places])
        error = np.sum((linear @ gains - self.goal).reshape(2, -1) ** 2, axis=0)
        found = np.zeros(len(growth))
        for k, (frequency, damping) in enumerate(np.exp(modes).T):
            inside, noise, nearest = self._about(frequency, damping, error)
            part = np.hypot(*linear[:, FIXED + k].reshape(2, -1)[:, nearest]) * abs(gains[FIXED + k])
            if growth[k] >= F_RATIO * noise and (self.phased or part <= CANCELLED):
                found[k] = np.sqrt(growth[k] / inside)
        return found

    def _about(self, frequency, damping, error):
        """Lines in a mode's width, two at least, the mean error of a few widths, and the line that is nearest."""
        place = np.abs(self.omega - frequency)
        inside = max(int(np.sum(place < damping * frequency)), 2)
        beside = np.partition(place, min(20, len(place) - 1))[min(20, len(place) - 1)]
        return inside, np.mean(error[place <= max(beside, 5 * damping * frequency)]), place.argmin()

    def on_springs(self, modes):
        """Whether the first mode is the whole machine on its springs: beside its part nothing moves freely."""
        if not modes.size:
            return False
        modes = modes[:, np.argsort(modes[0])]
        gains = self.solved(modes)[0]
        first = np.append(np.exp(modes[0]), np.inf)
        return bool(abs(gains[0]) < GROUNDED * abs(gains[FIXED]) and SUSPENDED * first[0] <= first[1])

    def _unmodelled(self, columns, seen, noise, mass):
        """Standard deviations of a delay, and of the rate of a friction where there is one, beside what is fitted."""
        lag = -1j * self.omega * (seen[: len(self.omega)] + 1j * seen[len(self.omega) :])
        columns = np.column_stack([columns, _stacked(lag)])
        late = float(_deviations(_rows(columns)[-1:], *noise)[0])
        if not self.drag or self.grounded:
            return late, 0.0
        slope = -1j * self.omega / (1j * self.omega + self.drag) ** 2 * self.weight * mass
        columns = np.column_stack([columns, _stacked(slope)])
        return late, float(_deviations(_rows(columns)[-1:], *noise)[0])

    def _parts(self, kept, left):
        """Least squares with columns of one size: the gains, and what they leave."""
        sizes = np.linalg.norm(kept, axis=0)
        gains = np.linalg.lstsq(np.asarray_chkfinite(kept / sizes), left, rcond=None)[0] / sizes
        return gains, left - kept @ gains

    def fit(self, modes, diagram):
        """The model, its relative error and the standard deviations."""
        modes = modes[:, np.argsort(modes[0])]
        gains, residual, _ = self.solved(modes)
        linear, moving = self.columns(modes)
        rigid = FIXED if self.grounded else 0  # the suspension is the rigid body of a machine on springs
        first = np.exp(modes[0].min(initial=np.inf))
        below = np.tile(self.omega < first / 2, 2)
        jacobian = np.hstack([linear, self.slopes(moving, gains)])
        rows = _rows(jacobian)
        if below.any() and not self.grounded:
            # The mass by itself: what the flexible part leaves of the lines below half the first resonance.
            line = below * linear[:, 0] / np.sum(linear[below, 0] ** 2)
            gains[0] -= line @ residual
            rows[0] += line - (line @ jacobian) @ rows
        seen = linear @ gains
        noise = _noise(jacobian, seen - self.goal, seen)
        spread = _deviations(rows, *noise)
        # What a delay would add is a part of no other number's error: the model is without, and phases hold what they take up.
        places = self.places(modes)
        beside_phases = np.delete(jacobian, places[1:], axis=1)
        late, rubbed = self._unmodelled(beside_phases, seen, noise, gains[0])
        # The model has no growth of the compliance and no mode beyond the band: its gains are those that do best without.
        every, count = modes.shape[1], int(np.sum(modes[0] <= np.log(self.omega[-1])))
        places = places[:, :count]
        kept = linear[:, [1, *places.ravel()]]
        left = self.goal - (0.0 if self.grounded else gains[0] * linear[:, 0])
        (compliance, *own), residual = self._parts(kept, left)
        gained = _rows(kept)
        moved = [*([] if self.grounded else [0]), *range(linear.shape[1], jacobian.shape[1])]
        gained -= (gained @ jacobian[:, moved]) @ rows[moved]  # by the mass, frequencies and damping
        own_spread = np.reshape(_deviations(gained, *noise)[1:], places.shape)
        own, *beside = np.reshape(own, places.shape)
        sign = float(np.sign(gains[rigid]))
        frequencies, damping = np.exp(modes[:, :count])
        model = self._model(modes[:, :count], gains[0], own, compliance, sign)
        # Of a mode's part at its resonance, where a velocity's stands beside it.
        shares = np.stack([np.ones(count), frequencies / self.omega[-1]])[: len(places)]
        return ModalFit(
            model,
            self.omega,
            np.hypot(*residual.reshape(2, -1)) / (self.weight * np.abs(self.target)),
            frequencies * spread[-2 * every :][:count],
            damping * spread[-every:][:count],
            float(spread[rigid] / abs(gains[rigid])),
            sign < 0,
            diagram,
            residue_deviation=np.hypot.reduce(shares * own_spread)
            / np.hypot.reduce(shares * np.array([own, *beside])),
            delay=self.delay,
            delay_deviation=late,
            drag_deviation=rubbed,
            cut=np.exp(modes[0, count:]),
            phased=PhasedModel(
                model, np.append(np.zeros(model.rigid_modes), sign * beside[0] / self.omega[-1])
            )
            if self.phased
            else None,
        )


def _stacked(values: np.ndarray) -> np.ndarray:
    """Real parts above imaginary ones."""
    return np.concatenate([values.real, values.imag])


def _orthogonal(columns: np.ndarray):
    """Orthonormal columns, their triangle, and the sizes by which the columns were divided."""
    sizes = np.linalg.norm(columns, axis=0)
    return *np.linalg.qr(columns / sizes), sizes


def _swept(gram, pivot):
    """What is left of normal equations when one column is taken."""
    if gram[pivot, pivot] < 1e-12:
        return gram
    return gram - np.outer(gram[:, pivot], gram[pivot]) / gram[pivot, pivot]


def _rows(columns):
    """How each parameter moves with each error: the columns' pseudo-inverse."""
    q, r, sizes = _orthogonal(columns)
    return np.linalg.solve(r, q.T) / sizes[:, None]


def _noise(jacobian, residual, seen):
    """Standard deviation of each line's error, and the correlation of errors some lines apart, which is that of all lines.

    A mode often rests on a few lines, whose own errors are too few to judge their size by. A line's variance is the mean over
    `SMOOTH` lines, but for a share that follows the square of what is seen there: noise may follow the response, or stay.
    """
    free = np.maximum(
        1 - np.sum(_orthogonal(jacobian)[0] ** 2, axis=1), 1e-9
    )  # of what a line draws the fit to
    squares, free, power = (np.mean(each.reshape(2, -1), axis=0) for each in (residual**2, free, seen**2))
    own = np.sqrt(_likeliest(squares, free, power))
    error = residual.reshape(2, -1) / np.sqrt(free)
    scaled = error / own
    lags = range(1, min(LAGS, len(own) - 1) + 1)
    alike = [np.sum(scaled[:, lag:] * scaled[:, :-lag]) / np.sum(scaled**2) for lag in lags]
    return own, alike


def _deviations(rows, own, alike):
    """Standard deviations of parameters that move with the errors like this (Newey and West)."""
    moved = rows.reshape(len(rows), 2, -1) * own
    variance = np.sum(moved**2, axis=(1, 2))
    for lag, share in enumerate(alike, 1):
        both = np.sum(moved[:, :, lag:] * moved[:, :, :-lag], axis=(1, 2))
        variance += 2 * (1 - lag / (len(alike) + 1)) * share * both
    return np.sqrt(np.maximum(variance, 0.0))


def _likeliest(squares, free, power):
    """Variance of each line's error: smooth but for a share that follows the response's power, whichever is likeliest."""
    found = []
    for share in np.linspace(0.0, 1.0, 11):
        shape = share * power / power.mean() + 1 - share
        near, over = (uniform_filter1d(each, SMOOTH, mode="nearest") for each in (squares / shape, free))
        variance = np.maximum(shape * near / over, 1e-300)
        found.append((np.sum(free * np.log(variance) + squares / variance), variance))
    return min(found, key=lambda each: each[0])[1]
