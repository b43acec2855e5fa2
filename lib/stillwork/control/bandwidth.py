"""The largest bandwidth that keeps every loop stable and below its peak constraints: (3.2), (3.4), (3.35), (3.47)."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, wraps
from types import SimpleNamespace
from typing import Annotated, Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Complex128, Float64
from scipy import linalg

from stillwork.base.bounds import NonNegative, Positive, at_least, one_of, within
from stillwork.base.checks import InputError, require_kind, require_number
from stillwork.base.rounding import TIE
from stillwork.base.validation import by_value, check_fields, checked, user_callback
from stillwork.control.crossover import crossover
from stillwork.control.loops import LoopResponse, closed_loop, no_observer
from stillwork.control.pid import Pid
from stillwork.lti.delays import delayed, split_delay, with_input_before
from stillwork.lti.discretisation import continuous_poles, late_modes, prewarped, tustin, zoh_response
from stillwork.lti.modal import ModalModel
from stillwork.lti.peaks import Peak, refine_peak, resonance_grid
from stillwork.lti.state_space import StateModel, response_between

SIX_DB = 10 ** (6 / 20)  # not 2

FUNCTIONS = ("input_sensitivity", "output_sensitivity", "true_tracking")
# With plant and controller in the other order, (I + CP)^-1 beside (I + PC)^-1; a loop of one input has each once.
OTHER_ORDER = ("input_sensitivity_2", "output_sensitivity_2")
LoopFunction = Annotated[str, one_of((*FUNCTIONS, *OTHER_ORDER))]


# Where a closed-loop pole may lift a response: distances from its frequency, in widths of the pole.
WIDTHS = np.array([0.0, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0])
NEAR = 0.97  # of the limit: between such points no peak grows by more
LOWEST_HZ, BELOW_RESONANCE = (
    0.1,
    1 / 300,
)  # where the grid of a loop begins: the lower of these, of the first resonance


class Infeasible(InputError):
    """No design within the range of a search is stable and below every constraint."""

    stopped: "Violation | None" = None  # what the lowest one exceeds, of a search from below


class _Unseen(InputError):
    """A design that a scan found feasible, its closed-loop poles unseen, and that is not."""


@by_value
@dataclass(frozen=True)
class PeakConstraint:
    """An upper bound on the peak magnitude of one loop function.

    Parameters
    ----------
    function : str
        One of `FUNCTIONS`, such as "output_sensitivity", or of `OTHER_ORDER`.
    limit : float
        Largest magnitude, above 1; 6 dB by default.

    Raises
    ------
    InputError
        When there is no such loop function, or the limit is not above 1.

    References
    ----------
    Verkerk, Improved accuracy of flexible systems by state estimation, thesis (2018), section 3.2, (3.4).

    Examples
    --------
    >>> round(float(20 * np.log10(control.PeakConstraint("output_sensitivity").limit)), 1)
    6.0
    """

    function: LoopFunction
    limit: Annotated[float, within(above=1.0)] = SIX_DB  # largest magnitude, above 1

    def __post_init__(self):
        check_fields(self)


@runtime_checkable
class SearchLoop(Protocol):
    """What a search needs of a loop with any number of inputs and outputs; `Loop` has one of each."""

    @property
    def omega(self) -> Float64[np.ndarray, " frequencies"]:
        """The loop's own grid, rad/s."""

    def at(self, controller: Any, omega: np.ndarray | None = None) -> Any:
        """The loop functions by their names, numbers or sizes of matrices, on a grid (rad/s)."""

    def within(self, controller: Any, part: slice) -> Any:
        """Likewise, on a part of the loop's own grid."""

    def poles(self, controller: Any) -> Complex128[np.ndarray, " states"]:
        """Closed-loop poles, rad/s."""

    def crossing_hz(self, controller: Any) -> float | Float64[np.ndarray, " axes"]:
        """First 0 dB crossings of the loop at the controller, Hz."""


@by_value
@dataclass(frozen=True)
class Loop:
    """One plant with its compensator; the controller is to be found.

    With a `sample_time` the loop is sampled: the plant has a hold and a delay, a measurement is taken before the force of its
    sample acts, the controller is Tustin's.
    """

    plant: ModalModel
    compensator: StateModel
    omega: Float64[np.ndarray, " frequencies"] = field(repr=False)  # rad/s, refined around every pole
    plant_response: Complex128[np.ndarray, " frequencies"] = field(repr=False)
    compensator_response: Complex128[np.ndarray, "2 2 frequencies"] = field(repr=False)
    sample_time: float = 0.0  # s; 0: continuous time
    delay: float = 0.0  # samples from command to force, whole or not

    def __post_init__(self):
        check_fields(self)

    @checked
    def plant_at(self, omega: np.ndarray, held: bool = True) -> Complex128[np.ndarray, " frequencies"]:
        """Response of the plant at the controller; if not `held`, that of a sampled plant before aliasing.

        Parameters
        ----------
        omega : array_like, shape (frequencies,)
            Frequencies, rad/s.
        held : bool
            Include the hold and the aliases of sampling.

        Returns
        -------
        ndarray, shape (frequencies,)
            Complex, m/N.

        Raises
        ------
        InputError
            When one of them is a pole, or is not finite.

        Examples
        --------
        >>> mass = lti.ModalModel([0.0], [0.0], [[1.0]], [[0.1]], [[0.0]])  # 10 kg
        >>> control.make_loop(mass).plant_at([10.0]).real.round(6)  # m/N: -1 / (10 kg (10 rad/s)^2)
        array([-0.001])
        """
        if not self.sample_time:
            return self.plant.frequency_response(omega)[0, 0]
        turn = 1j * omega * self.sample_time
        if not held:
            hold = -np.expm1(-turn) / turn
            return self.plant.frequency_response(omega)[0, 0] * hold * np.exp(-turn * self.delay)
        compliance = self.plant.feedthrough[0, 0] * np.expm1(-turn)  # it shows the force of the sample before
        whole, late = split_delay(self.delay)
        held_response = zoh_response(self.plant, self.sample_time, omega, late)[0, 0]
        return (held_response + compliance) * np.exp(-turn * whole)

    def _controlled(self, controller: Pid, omega: np.ndarray) -> np.ndarray:
        return controller.frequency_response(
            prewarped(omega, self.sample_time) if self.sample_time else omega
        )

    @checked
    def at(self, controller: Pid, omega: np.ndarray | None = None) -> LoopResponse:
        """Loop functions on the loop's own grid, or at other frequencies (rad/s).

        Parameters
        ----------
        controller : Pid
            C of this loop.
        omega : array_like, shape (frequencies,), optional
            Frequencies, rad/s; by default the loop's own grid.

        Returns
        -------
        LoopResponse
            The loop functions at these frequencies.

        Raises
        ------
        InputError
            When one of them is a pole, or is not finite.

        Examples
        --------
        >>> mass = lti.ModalModel([0.0], [0.0], [[1.0]], [[0.1]], [[0.0]])  # 10 kg
        >>> loop, pid = control.make_loop(mass), control.PidFamily(10.0)(50.0)
        >>> np.abs(loop.at(pid, [1.0]).output_sensitivity) < 1e-3  # at 1 rad/s
        array([ True])
        """
        if omega is None:
            return self.within(controller, slice(None))
        respond = response_between if self.sample_time else StateModel.frequency_response
        observer = respond(self.compensator, omega)
        return LoopResponse(self.plant_at(omega), observer, self._controlled(controller, omega))

    @checked(missing=True)
    def within(self, controller: Pid, part: slice) -> LoopResponse:
        """Loop functions on a part of the loop's own grid.

        Parameters
        ----------
        controller : Pid
            C of this loop.
        part : slice
            Of `omega`.

        Returns
        -------
        LoopResponse
            As of `at`.

        Raises
        ------
        InputError
            When an argument is not of its kind.

        Examples
        --------
        >>> mass = lti.ModalModel([0.0], [0.0], [[1.0]], [[0.1]], [[0.0]])  # 10 kg
        >>> loop, pid = control.make_loop(mass), control.PidFamily(10.0)(50.0)
        >>> bool(np.abs(loop.within(pid, slice(0, 100)).loop).min() > 1)  # far below the crossing
        True
        """
        return LoopResponse(
            self.plant_response[part],
            self.compensator_response[..., part],
            self._controlled(controller, self.omega[part]),
        )

    @checked
    def peak(self, controller: Pid, function: LoopFunction) -> Peak:
        """Refined peak of a loop function, one of `FUNCTIONS` or of `OTHER_ORDER`.

        Parameters
        ----------
        controller : Pid
            C of this loop.
        function : str
            Which of them.

        Returns
        -------
        Peak
            Its magnitude, and where it is, rad/s.

        Raises
        ------
        InputError
            When there is no such function.

        Examples
        --------
        >>> mass = lti.ModalModel([0.0], [0.0], [[1.0]], [[0.1]], [[0.0]])  # 10 kg
        >>> loop, pid = control.make_loop(mass), control.PidFamily(10.0)(50.0)
        >>> round(loop.peak(pid, "output_sensitivity").magnitude, 3)  # below 6 dB
        1.856
        """
        return _Design([self], controller, [], refine=True).peak(0, function)

    @checked
    def poles(self, controller: Pid) -> Complex128[np.ndarray, " states"]:
        """Closed-loop poles, rad/s; of a sampled loop ln(z) over the sample time.

        Parameters
        ----------
        controller : Pid
            C of this loop.

        Returns
        -------
        ndarray, shape (states,)
            Of plant, compensator and controller.

        Raises
        ------
        InputError
            When an argument is not of its kind.

        Examples
        --------
        >>> mass = lti.ModalModel([0.0], [0.0], [[1.0]], [[0.1]], [[0.0]])  # 10 kg
        >>> loop, pid = control.make_loop(mass), control.PidFamily(10.0)(50.0)
        >>> round(float(loop.poles(pid).real.max()), 1)  # the slowest, rad/s
        -33.3
        """
        if not self.sample_time:
            a = closed_loop(self.plant, self.compensator, controller.state_space()).a
            return linalg.eigvals(a).astype(complex)
        pid = tustin(controller.state_space(), self.sample_time)
        unit = float(np.abs(pid.d[0, 0]))  # N/m: with forces in it no part of the loop is larger than another
        loop = closed_loop(
            _scaled(self.sampled_plant, [unit], [1.0]),
            _scaled(self.compensator, [unit, 1.0], [unit, 1.0]),
            _scaled(pid, [1.0], [unit]),
        )
        return continuous_poles(linalg.eigvals(loop.a), self.sample_time)

    @checked
    def is_stable(self, controller: Pid) -> bool:
        """Whether all closed-loop poles lie in the left half-plane, of a sampled loop within the unit circle.

        Parameters
        ----------
        controller : Pid
            C of this loop.

        Returns
        -------
        bool
            False with a pole on the boundary.

        Raises
        ------
        InputError
            When an argument is not of its kind.

        Examples
        --------
        >>> mass = lti.ModalModel([0.0], [0.0], [[1.0]], [[0.1]], [[0.0]])  # 10 kg
        >>> loop, pid = control.make_loop(mass), control.PidFamily(10.0)(50.0)
        >>> late = control.make_loop(mass, sample_time=1e-3, delay=10)
        >>> loop.is_stable(pid), late.is_stable(pid)
        (True, False)
        """
        return bool(np.all(self.poles(controller).real < 0))

    @cached_property
    def sampled_plant(self) -> StateModel:
        """The sampled, delayed plant; its compliance acts on the force of the sample before."""
        whole, late = split_delay(self.delay)
        held, before = late_modes(self.plant, self.sample_time, late)
        return delayed(with_input_before(held, before), whole)

    @checked
    def crossing_hz(self, controller: Pid) -> float:
        """First 0 dB crossing of the open loop that the controller sees (Definition 1.2.1), Hz.

        Parameters
        ----------
        controller : Pid
            C of this loop.

        Returns
        -------
        float
            Hz.

        Raises
        ------
        InputError
            When the loop gain does not fall through 0 dB on the grid.

        Examples
        --------
        >>> mass = lti.ModalModel([0.0], [0.0], [[1.0]], [[0.1]], [[0.0]])  # 10 kg
        >>> loop, pid = control.make_loop(mass), control.PidFamily(10.0)(50.0)
        >>> round(loop.crossing_hz(pid), 1)
        52.5
        """
        gain = np.abs(self.at(controller).loop)
        return crossover(lambda w: self.at(controller, w).loop, self.omega, gain) / (2 * np.pi)


def _scaled(model: StateModel, inputs: list[float], outputs: list[float]) -> StateModel:
    """The model with its inputs and outputs in other units."""
    into, out = np.array(inputs), np.array(outputs)[:, None]
    return StateModel(model.a, model.b * into, model.c / out, model.d * into / out, model.sample_time)


@checked
def make_loop(
    plant: ModalModel,
    compensator: StateModel | None = None,
    *,
    low_hz: float = 0.0,
    high_hz: float = 2e4,
    points: int = 600,
    around: int = 40,
    sample_time: float = 0.0,
    delay: NonNegative = 0.0,
) -> Loop:
    """Prepare a loop: responses of everything but the controller, on a grid refined around every pole.

    Parameters
    ----------
    plant : ModalModel
        One input, one output.
    compensator : StateModel, optional
        From (u, y) to (u_d, y_flex); None: no observer.
    low_hz, high_hz, points, around
        Grid, see `stillwork.lti.resonance_grid`; that of a sampled loop ends at half of its rate. `low_hz` 0: 0.1 Hz, and
        of a slow machine a part of its first resonance, below every bandwidth that it may have.
    sample_time : float
        Sample time, s; 0: continuous time.
    delay : float
        Delay of the force in samples, whole or not; for a sampled loop only.

    Returns
    -------
    Loop
        For `maximise_bandwidth`, which calls it many times.

    Raises
    ------
    InputError
        When the plant has more than one input or output, or the compensator not two of each or another sample time.

    References
    ----------
    Verkerk, Improved accuracy of flexible systems by state estimation, thesis (2018), section 3.2.

    Examples
    --------
    >>> mass = lti.ModalModel([0.0], [0.0], [[1.0]], [[0.1]], [[0.0]])  # 10 kg
    >>> round(control.make_loop(mass).crossing_hz(control.PidFamily(10.0)(50.0)))
    52
    """
    if plant.feedthrough.shape != (1, 1):
        raise InputError("plant must have one input and one output; pick them with plant.at")
    observer = no_observer(plant) if compensator is None else compensator
    if compensator is None:
        observer = replace(observer, sample_time=sample_time)
    if observer.d.shape != (2, 2):
        raise InputError(
            f"compensator has shape {observer.d.shape}; give 2 outputs and 2 inputs, as `compensator` does"
        )
    if observer.sample_time != sample_time or (delay and not sample_time):
        raise InputError(
            "compensator has another sample time than sample_time, or there is a delay without one"
        )
    omega = loop_grid(plant, observer, low_hz, high_hz, points, around, sample_time)
    loop = Loop(
        plant,
        observer,
        omega,
        np.zeros(len(omega), complex),
        observer.frequency_response(omega),
        sample_time,
        delay,
    )
    return replace(loop, plant_response=loop.plant_at(omega))


@checked
def loop_grid(
    plant: ModalModel,
    observer: StateModel | None,
    low_hz: float = 0.0,
    high_hz: float = 2e4,
    points: int = 600,
    around: int = 40,
    sample_time: float = 0.0,
) -> Float64[np.ndarray, " frequencies"]:
    """Frequencies of a loop, rad/s: the same without an observer, but for its poles; see `make_loop`."""
    poles = plant.poles
    if observer is not None:
        own = continuous_poles(observer.poles, sample_time) if sample_time else observer.poles
        poles = np.concatenate([poles, own])
    if not low_hz:
        slowest = float(plant.frequencies[1]) if len(plant.frequencies) > 1 else np.inf
        low_hz = min(LOWEST_HZ, BELOW_RESONANCE * slowest / (2 * np.pi))
    high_hz = min(high_hz, 0.499 / sample_time) if sample_time else high_hz
    return resonance_grid(poles, low_hz, high_hz, points, around)


@by_value
@dataclass(frozen=True)
class Bandwidth:
    """The largest feasible design, and what limits it."""

    design_hz: float  # parameter f_bw of the controller
    crossing_hz: Float64[np.ndarray, "loops ..."]  # first 0 dB crossing of each loop, or of each of its axes
    controller: Any  # what the family gave
    function: str  # the active constraint ...
    loop: int  # ... the loop it is active in ...
    peak: Peak  # ... and its peak there; "stability" and "the end of the search" have peak infinity
    lowest_hz: float = 0.0  # design parameter above which all are feasible, if requested


@checked(infinite=True)
def maximise_bandwidth(
    loops: Sequence[SearchLoop],
    family: Callable[[float], Pid | tuple[Pid, ...]],
    constraints: Sequence[PeakConstraint],
    low_hz: Positive = 10.0,
    high_hz: float = 150.0,
    scan: Annotated[int, at_least(2)] = 141,
    tolerance_hz: Positive = 1e-4,
    refine: bool = True,
    lowest: bool = False,
    ratio: Annotated[float, within(at_least=1.001, at_most=2.0)] = 1.02,
) -> Bandwidth:
    """Largest design parameter for which every loop is stable and below every constraint.

    A scan from above finds the highest interval that is feasible (it looks at grid values first, which reject
    nothing that is); its upper end is then bisected with refined peaks and eigenvalues. With `lowest` a scan from
    below finds the first such interval: no loop on the way up to its end breaks a constraint. Peaks are searched
    on the loop's grid and around every closed-loop pole, and the design that is returned has been checked as a whole.

    Parameters
    ----------
    loops : sequence of Loop
        One per plant (position); the controller must suit all. Or objects with the methods of a `SearchLoop`, such as
        loops of several inputs and outputs.
    family : callable
        From the design parameter (Hz) to a controller, or one for each axis.
    constraints : sequence of PeakConstraint
    low_hz, high_hz : float
        Range of the search.
    scan : int
        Number of design parameters in it.
    tolerance_hz : float
        Width at which the bisection stops.
    refine : bool
        Search for the peaks between the grid points; without it the result depends on the grid and is
        never below the true one.
    lowest : bool
        Take the lowest interval; one without an upper end stops at `high_hz`.
    ratio : float
        Ratio of two designs on the way up to the lowest interval's end, at most.

    Returns
    -------
    Bandwidth
        The design parameter with its controller, the first crossing of each loop, and the constraint that limits it.

    Raises
    ------
    InputError
        When there are no loops or constraints, nothing in the range is feasible, or all of it is.

    References
    ----------
    Verkerk, Improved accuracy of flexible systems by state estimation, thesis (2018), Definition 1.2.1, section 3.2.

    Examples
    --------
    >>> stage = lti.ModalModel([0.0, 600.0], [0.0, 0.01], [[0.3], [0.3]], [[0.3, -0.3]], [[0.0]])
    >>> limit = [control.PeakConstraint("input_sensitivity")]
    >>> best = control.maximise_bandwidth([control.make_loop(stage)], control.PidFamily(11.0), limit)
    >>> round(best.design_hz, 2), best.function
    (19.06, 'input_sensitivity')
    """
    loops = _ready(loops, constraints)
    require_number("high_hz", high_hz, above=low_hz)
    if lowest:
        return _lowest(loops, family, constraints, low_hz, high_hz, tolerance_hz, refine, ratio)
    grid = np.linspace(low_hz, high_hz, scan)
    above = None  # what was exceeded last, and is likely to be again
    for k in reversed(range(scan)):
        design = _Design(loops, family(grid[k]), constraints, refine)
        if above is not None and _still(*above, design.controller):
            continue
        above = design.above()
        if above is None and not design.violation():
            break
    else:
        raise Infeasible(
            f"no bandwidth from {low_hz:g} to {high_hz:g} Hz is stable and below every constraint; "
            "lower low_hz, relax the constraints or check the plants"
        )
    if k == len(grid) - 1:
        raise InputError(f"all constraints hold even at high_hz = {high_hz:g}; raise it to find the limit")
    stopped = _Design(loops, family(grid[k + 1]), constraints, refine).violation()
    assert stopped is not None  # `above` refuses nothing that is feasible
    return _bisected(loops, family, constraints, grid[k], grid[k + 1], stopped, tolerance_hz, refine)


def _ready(loops, constraints) -> list[SearchLoop]:
    """The loops, of which a reader's own raise errors of their own."""
    if not len(loops):
        raise InputError("loops is empty; give at least one plant")
    if not len(constraints):
        raise InputError("constraints is empty; without a peak constraint no bandwidth is the largest")
    methods = ("at", "within", "poles", "crossing_hz")
    return [
        loop
        if isinstance(loop, Loop)
        else SimpleNamespace(
            omega=loop.omega, **{name: user_callback(getattr(loop, name)) for name in methods}
        )
        for loop in loops
    ]


Violation = tuple[str, int, Peak]  # function or "stability", number of the loop, peak


def _bisected(
    loops, family, constraints, good: float, bad: float, stopped: Violation, tolerance_hz: float, refine: bool
) -> Bandwidth:
    """The end of the feasible interval between a design that is and one that is not.

    Only what stopped a design so far is looked at on the way, the whole of it at the end; what is found there is
    looked at from then on, too.
    """
    resolved = max(tolerance_hz, np.spacing(bad))
    watched = {stopped[:2]}
    feasible, first = good, bad
    designs: dict[float, _Design] = {}
    above = None  # what was exceeded last, and is likely to be again

    def design(at: float) -> _Design:
        if at not in designs:
            designs[at] = _Design(loops, family(at), constraints, refine)
        return designs[at]

    while True:
        good, bad = feasible, first
        while bad - good > resolved:
            middle = (good + bad) / 2
            if above is None or not _still(*above, design(middle).controller):
                above = design(middle).above(watched)
            fails = above or design(middle).violation(watched)
            good, bad = (good, middle) if fails else (middle, bad)
        found = design(good).violation()
        if found is None:
            break
        if good == feasible:
            raise _Unseen(f"loops: the design at {good:g} Hz was feasible, and is not any more")
        watched.add(found[:2])
    if bad < first:
        stopped = design(bad).violation() or stopped
    controller = design(good).controller
    crossings = np.array([loop.crossing_hz(controller) for loop in loops])
    return Bandwidth(float(good), crossings, controller, *stopped)


def _lowest(
    loops,
    family,
    constraints,
    low_hz: float,
    high_hz: float,
    tolerance_hz: float,
    refine: bool,
    ratio: float,
    careful: bool = False,
) -> Bandwidth:
    """See `maximise_bandwidth`.

    A loop that keeps 1 / limit away from the point -1 does not get past it by a step of which its gain, in the square
    of the bandwidth, grows by less: poles are looked for at the first feasible design and at the end alone, unless
    `careful`, which it becomes where the end does not stand.
    """
    grid = np.geomspace(low_hz, high_hz, 2 + int(np.log(high_hz / low_hz) / np.log(ratio)))
    kept = [constraint.limit for constraint in constraints if "sensitivity" in constraint.function]
    careful = careful or min(kept, default=np.inf) * (ratio**2 - 1) >= 1
    peaks = {(each.function, number) for each in constraints for number in range(len(loops))}
    first: int | None = None
    stopped: Violation | None = None
    for k, design_hz in enumerate(grid):
        whole = first is None or careful
        design = _Design(loops, family(design_hz), constraints, refine, near_poles=whole)
        fails = design.above() or design.violation(None if whole else peaks)
        if fails and (first is not None or not k):
            stopped = design.violation()
        if fails and first is not None:
            break
        if first is None and not fails:
            first, stopped = k, None
    if first is None:
        assert stopped is not None
        function, number, peak = stopped
        which = f" of loop {number + 1}" if len(loops) > 1 else ""
        size = "" if np.isinf(peak.magnitude) else f" of {20 * np.log10(peak.magnitude):.1f} dB"
        error = Infeasible(
            f"no bandwidth from {low_hz:g} to {high_hz:g} Hz is stable and below every constraint; at {low_hz:g} Hz "
            f"{function.replace('_', ' ')}{which} fails at {peak.omega / (2 * np.pi):.4g} Hz"
            f"{f' with a peak{size}' if size else ''}"
        )
        error.stopped = stopped
        raise error
    if stopped is None:
        stopped = ("the end of the search", 0, Peak(np.inf, 2 * np.pi * high_hz))
        good = bad = grid[-1]
    else:
        good, bad = grid[k - 1], grid[k]
    try:
        found = _bisected(loops, family, constraints, good, bad, stopped, tolerance_hz, refine)
    except _Unseen:
        if careful:
            raise
        return _lowest(loops, family, constraints, low_hz, high_hz, tolerance_hz, refine, ratio, careful=True)
    return replace(found, lowest_hz=float(grid[first]))


@checked
def is_feasible(
    loops: Sequence[SearchLoop],
    controller: Pid | tuple[Pid, ...],
    constraints: Sequence[PeakConstraint],
) -> bool:
    """Whether every loop is stable and below every constraint; the cheapest test comes first."""
    loops = _ready(loops, constraints)
    design = _Design(loops, controller, constraints, refine=True)
    return design.above() is None and design.violation() is None


@checked
def highest_peaks(
    loops: Sequence[Loop], controller: Pid, functions: Sequence[LoopFunction]
) -> dict[str, Peak]:
    """The highest peak over all loops, by function; infinite, at the worst pole, where a loop is unstable.

    Only the loops that come near it around their closed-loop poles are refined.
    """
    if not loops:
        raise InputError("loops is empty; give at least one")
    design, numbers = _Design(loops, controller, [], refine=True), range(len(loops))
    worst = max((pole for number in numbers for pole in design._poles(number)), key=lambda pole: pole.real)
    if not worst.real < 0:
        return dict.fromkeys(functions, Peak(np.inf, float(abs(worst))))
    found = {}
    for name in functions:
        seen = [design._seen(number, name)[1].max() for number in numbers]
        near = [number for number in numbers if seen[number] >= NEAR * max(seen)]
        found[name] = max((design.peak(number, name) for number in near), key=lambda peak: peak.magnitude)
    return found


@checked
def around_poles(
    loop: SearchLoop, poles: Complex128[np.ndarray, " states"]
) -> Float64[np.ndarray, " frequencies"]:
    """Frequencies (rad/s) at and around closed-loop poles, where a response may rise between the points of a grid."""
    poles = poles[poles.imag >= 0]
    offsets = np.abs(poles.real)[:, None] * np.concatenate([-WIDTHS, WIDTHS])
    omega = np.concatenate([(poles.imag[:, None] + offsets).ravel(), np.abs(poles)])
    low, high = loop.omega[0], loop.omega[-1]
    if isinstance(loop, Loop):  # it is defined beyond its grid
        low, high = 0.0, (1 - 1e-9) * np.pi / loop.sample_time if loop.sample_time else np.inf
    return np.minimum(omega[omega > low], high)


def _still(loop: SearchLoop, constraint: PeakConstraint, place: slice, controller) -> bool:
    """Whether another controller exceeds the constraint at the same point of the grid."""
    response = getattr(loop.within(controller, place), constraint.function)
    return bool(np.abs(response[0]) > constraint.limit)


def _kept(method: Callable) -> Callable:
    """A method of `_Design` that computes each of its results once; a `cache` for each design costs more than most."""

    @wraps(method)
    def ask(self, *asked):
        key = (method, *asked)
        if key not in self._known:
            self._known[key] = method(self, *asked)
        return self._known[key]

    return ask


class _Design:
    """A controller under the constraints, with its loops' results: a search needs them more than once."""

    def __init__(
        self,
        loops: Sequence[SearchLoop],
        controller,
        constraints: Sequence[PeakConstraint],
        refine: bool,
        near_poles: bool = True,
    ):
        self.near_poles = near_poles and refine
        self.loops, self.controller, self.constraints, self.refine = loops, controller, constraints, refine
        if any(isinstance(loop, Loop) for loop in loops):
            require_kind("controller", controller, Pid)  # that of several axes has one each
        self._known: dict[tuple, Any] = {}

    @_kept
    def _response(self, number: int) -> Any:
        return self.loops[number].at(self.controller)

    @_kept
    def _poles(self, number: int) -> np.ndarray:
        return self.loops[number].poles(self.controller)

    @_kept
    def _near(self, number: int) -> tuple[np.ndarray, Any]:
        """Frequencies at and around the closed-loop poles, and the response there."""
        loop, poles = self.loops[number], self._poles(number)
        omega = np.setdiff1d(around_poles(loop, poles), loop.omega)
        return omega, loop.at(self.controller, omega) if len(omega) else None

    @_kept
    def _seen(self, number: int, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Magnitudes on the loop's grid, and around the closed-loop poles with `near_poles`."""
        omega, magnitude = self.loops[number].omega, self._magnitude(number, name)
        if not self.near_poles:
            return omega, magnitude
        more, response = self._near(number)
        if not len(more):
            return omega, magnitude
        omega = np.concatenate([omega, more])
        magnitude = np.concatenate([magnitude, np.abs(getattr(response, name))])
        order = np.argsort(omega)
        order = order[~np.isnan(magnitude[order])]  # at an undamped pole of the plant itself
        return omega[order], magnitude[order]

    @_kept
    def peak(self, number: int, name: str) -> Peak:
        loop, (omega, magnitude) = self.loops[number], self._seen(number, name)
        if not self.refine or np.isinf(magnitude.max()):
            return Peak(float(magnitude.max()), float(omega[magnitude.argmax()]))
        return refine_peak(lambda w: getattr(loop.at(self.controller, w), name), omega, magnitude, near=NEAR)

    @_kept
    def _magnitude(self, number: int, name: str) -> np.ndarray:
        magnitude = np.abs(getattr(self._response(number), name))
        if np.isnan(magnitude.max()):
            hertz = self.loops[number].omega[np.isnan(magnitude).argmax()] / (2 * np.pi)
            raise InputError(
                f"{name} of loop {number + 1} is not a number at {hertz:.4g} Hz; check its plant"
            )
        return magnitude

    def _asked(self, watched: set[tuple[str, int]] | None) -> Iterator[tuple[int, PeakConstraint]]:
        for number in range(len(self.loops)):
            for constraint in self.constraints:
                if watched is None or (constraint.function, number) in watched:
                    yield number, constraint

    def above(
        self, watched: set[tuple[str, int]] | None = None
    ) -> tuple[SearchLoop, PeakConstraint, slice] | None:
        """The first loop and constraint that is exceeded on a grid, and where; None if there is none."""
        for number, constraint in self._asked(watched):
            magnitude = self._magnitude(number, constraint.function)
            place = int(magnitude.argmax())
            if not magnitude[place] <= constraint.limit:
                return self.loops[number], constraint, slice(place, place + 1)
        return None

    def violation(self, watched: set[tuple[str, int]] | None = None) -> Violation | None:
        """The constraint that is exceeded most, or the loop that is unstable, or None; of the `watched` ones alone.

        Of constraints that are exceeded equally, but for rounding, the first of the first loop: without an observer
        S_I and S_O are one function.
        """
        worst, excess = None, 1.0
        for number, constraint in self._asked(watched):
            name, limit = constraint.function, constraint.limit
            if self._seen(number, name)[1].max() < NEAR * limit * excess:
                continue
            peak = self.peak(number, name)
            if peak.magnitude > (1.0 if worst is None else 1 + TIE) * excess * limit:
                worst, excess = (name, number, peak), peak.magnitude / limit
        if worst is not None:
            return worst
        for number in range(len(self.loops)):
            if watched is None or ("stability", number) in watched:
                poles = self._poles(number)
                if not np.all(poles.real < 0):
                    return "stability", number, Peak(np.inf, float(np.abs(poles[poles.real.argmax()].imag)))
        return None
