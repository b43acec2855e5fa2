"""Loops of a machine with an observer, on its model and on its measurement, and the safe bandwidth of each use."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, NamedTuple

import numpy as np

from stillwork.base.bounds import NonNegative, Positive, at_least
from stillwork.base.checks import InputError
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.control.applications import Application, compensator
from stillwork.control.bandwidth import (
    FUNCTIONS,
    Bandwidth,
    Infeasible,
    Loop,
    PeakConstraint,
    make_loop,
    maximise_bandwidth,
)
from stillwork.control.discrete_observer import discrete_compensator, discrete_kalman_observer
from stillwork.control.loop_noise import NOISE, UNBOUNDED, NoiseBound
from stillwork.control.phased_loops import phased_corners, phased_loops, phased_places
from stillwork.control.pid import Pid, PidFamily
from stillwork.control.uncertainty import (
    EXCESS,
    Uncertainty,
    corners,
    harmful_places,
    make_box,
    perturbed_loops,
    uncertainty_of,
)
from stillwork.estimation.observer import NoiseIntensities, kalman_observer
from stillwork.identification.frequency_response import Identified
from stillwork.identification.machine import Machine, measured_band
from stillwork.lti.delays import delayed, split_delay
from stillwork.lti.discretisation import prewarped
from stillwork.lti.modal import ModalModel
from stillwork.lti.reduction import truncate
from stillwork.lti.state_space import StateModel, constant, interconnect

SAFE = tuple(
    PeakConstraint(name) for name in FUNCTIONS
)  # of the thesis, whose setpoint goes around the observer
HELD = FUNCTIONS[:2]  # by a controller that runs on the error, whose r to e is the output sensitivity
OF_ERROR = tuple(PeakConstraint(name) for name in HELD)
SHOWN = {"input_sensitivity": "S_I", "output_sensitivity": "S_O", "true_tracking": "r to e_true"}
ABOVE_SUSPENSION = 2.0  # of a machine on springs to the ground: lowest bandwidth sought, over its suspension
HIGHEST_NOTCH = 0.8  # of half the rate
# Of places of modes with phases; how many are added at a time.
PHASED_SEED, PHASED_ROUNDS, MOST_ADDED = 1, 8, 4
ROUNDS = 40  # of looking for another place in the box that does harm
THOROUGH = 16  # starts at each frequency in the last one
CROSSED = 0.5  # of the band of a machine that shows no resonance: highest bandwidth sought, so that its crossing is seen
SEARCH = (1 / 40, 1.0)  # of the first resonance: where bandwidths are sought


@by_value
@dataclass(frozen=True)
class Intensities:
    """Design intensities of the observer, as accelerations of the rigid body, so that they fit any mass.

    Attributes
    ----------
    disturbance : float
        m/s^2, root of the intensity of the force disturbance over the mass.
    sensor : float
        m, root of the intensity of the sensor noise.
    drift : float
        (m/s^2)^2/s, intensity of the random walk of the disturbance that gives MC its integral action.
    """

    disturbance: Positive
    sensor: Positive
    drift: Positive

    def __post_init__(self):
        check_fields(self)

    @checked
    def noise(self, mass: float) -> NoiseIntensities:
        """The same for a machine of `mass` (kg)."""
        return NoiseIntensities((self.disturbance * mass) ** 2, self.sensor**2)


@checked
def applications(added_damping: float, selectivity: float) -> dict[str, Application | None]:
    """PID alone, measurement compensation (MC), active damping (AD), and both."""
    damped = Application(damping=added_damping, selectivity=selectivity)
    return {
        "PID": None,
        "MC": Application(compensate=True),
        "AD": damped,
        "MC and AD": replace(damped, compensate=True),
    }


@checked
def observer_settings(
    machine: Machine,
    application: Application | None,
    retained: Annotated[int, at_least(2)],
    intensities: Intensities,
) -> tuple[int, NoiseIntensities, float | None]:
    """Modes in the observer, its noise, and the intensity of its noise model, which only MC has."""
    retained = min(retained, len(machine.sensors[0].frequencies))
    compensates = application is not None and application.compensate
    drift = intensities.drift * machine.mass**2 if compensates else None
    return retained, intensities.noise(machine.mass), drift


@checked
def on_measurement(
    loop: Loop, measured: Identified, factor: float, band_hz: tuple[float, float], mirror: bool = False
) -> Loop:
    """The same loop with the measured response for a plant inside `band_hz`, and the model below it.

    Its loop functions are measured; its poles stay those of the model. With `mirror` the flexible part of the
    measurement, what it has beside the rigid body, changes sign. Aliases are taken from the model.
    """
    inside = (measured.omega >= 2 * np.pi * band_hz[0]) & (measured.omega <= 2 * np.pi * band_hz[1])
    inside &= measured.omega <= loop.omega[-1]
    below = loop.omega[loop.omega < 2 * np.pi * band_hz[0]]
    seen = measured.omega[inside]
    omega = np.concatenate([below, seen])
    position = -factor * measured.response[inside] / seen**2
    if mirror:
        mobility = float(loop.plant.input_shapes[0, 0] * loop.plant.output_shapes[0, 0])
        position = -2 * mobility / seen**2 - position
    if loop.sample_time:
        before = loop.plant_at(seen, held=False)
        position *= before / loop.plant.frequency_response(seen)[0, 0]
        position += loop.plant_at(seen) - before
    return replace(
        loop,
        omega=omega,
        plant_response=np.concatenate([loop.plant_at(below), position]),
        compensator_response=loop.compensator.frequency_response(omega),
    )


@checked(infinite=True)
def encirclement_difference(measured: Loop, controller: Pid) -> int:
    """Encirclements of -1 by the measured open loop less those of the model, in the measured band.

    Zero, with a stable model, means that the loop on the measured plant is stable too (Nyquist).
    """
    model = replace(measured, plant_response=measured.plant_at(measured.omega))
    ratio = (1 + measured.at(controller).loop) / (1 + model.at(controller).loop)
    return round(float(np.sum(np.angle(ratio[1:] / ratio[:-1]))) / (2 * np.pi))


@checked
def observed_loops(
    plants: Sequence[ModalModel],
    application: Application | None,
    retained: int,
    noise: NoiseIntensities,
    noise_model: float | None,
    sample_time: float = 0.0,
    delay: float = 0.0,
) -> list[Loop]:
    """One loop a plant, each with its own observer; sampled where there is a `sample_time` (s)."""
    return [
        make_loop(
            plant,
            application
            and observing_compensator(plant, application, retained, noise, noise_model, sample_time, delay),
            sample_time=sample_time,
            delay=delay,
        )
        for plant in plants
    ]


@checked
def observing_compensator(
    plant: ModalModel,
    application: Application,
    retained: int,
    noise: NoiseIntensities,
    noise_model: float | None,
    sample_time: float = 0.0,
    delay: float = 0.0,
) -> StateModel:
    """Compensator on an observer of the plant's first `retained` modes and the compliance of the others.

    The suspension of a machine on springs to the ground counts as its rigid body. With a `sample_time` it is
    sampled, uses the newest measurement, and models the `delay` of the force in samples, whole or not.
    """
    reduced = truncate(plant, retained, len(plant.frequencies) - retained)
    if not reduced.rigid_modes:
        free = {
            name: np.concatenate([[0.0], getattr(reduced, name)[1:]]) for name in ("frequencies", "damping")
        }
        reduced = replace(reduced, **free)
    if not sample_time:
        return compensator(kalman_observer(reduced, noise, noise_model), application)
    whole, late = split_delay(delay)
    observer = discrete_kalman_observer(reduced, noise, sample_time, noise_model, late)
    block = discrete_compensator(observer, application, "filter", 0)
    if not whole:
        return block
    line = delayed(constant(np.ones((1, 1)), sample_time), whole)
    feedback, outside = np.zeros((3, 3)), np.zeros((3, 2))
    feedback[0, 2] = outside[1, 1] = outside[2, 0] = 1
    return interconnect([block, line], feedback, outside, np.eye(2, 3))


@by_value
@dataclass(frozen=True)
class AchievableBandwidth:
    """Achievable bandwidth of one use of the observer.

    Attributes
    ----------
    on_model, on_measurement : Bandwidth, optional
        None where no bandwidth is feasible, and without a measurement.
    encirclement_difference : int, optional
        Encirclements of -1 by the measured open loops less those of the model: 0 proves stability.
    loops : tuple of Loop
        One per sensor; on the measurement if there is one, and then, if the modes have their own phases, with
        these at corners of the box.
    model_loops : tuple of Loop
        The same on the model.
    perturbed : tuple of Loop
        On the model of each other response, then at points of the box around each model: two corners, then the worst
        ones; empty if there are neither.
    reason : str
        Why no bandwidth was found; empty when one was.
    elsewhere : tuple of Loop
        On the model of each other response.
    """

    on_model: Bandwidth | None
    on_measurement: Bandwidth | None
    encirclement_difference: int | None
    loops: tuple[Loop, ...]
    model_loops: tuple[Loop, ...]
    perturbed: tuple[Loop, ...] = ()
    reason: str = ""
    elsewhere: tuple[Loop, ...] = ()

    @property
    def recommended(self) -> Bandwidth | None:
        """The lower of both, feasible on both; None if one has none, or if the loop makes extra turns around -1."""
        if self.on_model is None or self.reason or self.encirclement_difference:
            return None
        if self.on_measurement is None:
            return self.on_model
        lower = min(self.on_model, self.on_measurement, key=lambda each: each.design_hz)
        first = max(self.on_model.lowest_hz, self.on_measurement.lowest_hz)
        return lower if lower.design_hz >= first else None

    @property
    def safe(self) -> Bandwidth:
        """What is recommended, where something is."""
        if self.recommended is None:
            raise InputError(
                f"no loop of this use is safe ({self.reason}); ask for less, or change the machine"
            )
        return self.recommended

    @property
    def stopped_by_noise(self) -> bool:
        """Whether the allowed sensor noise limits the bandwidth, or makes every bandwidth infeasible."""
        stop = self.recommended
        return NOISE in self.reason if stop is None else stop.function == NOISE

    def peaks_db(self) -> dict[str, tuple[float, float | None]]:
        """Largest peak of each loop function over the sensors for what is recommended: on the model, on the measurement."""
        if self.recommended is None:
            return {}
        pid, found = self.recommended.controller, {}
        for name in HELD:
            model = max(loop.peak(pid, name).magnitude for loop in self.model_loops)
            seen = max(float(np.abs(getattr(loop.at(pid), name)).max()) for loop in self.loops)
            measured = self.loops is not self.model_loops
            found[name] = float(20 * np.log10(model)), float(20 * np.log10(seen)) if measured else None
        return found

    @property
    def summary(self) -> dict[str, str]:
        """One row of a table, rounded; bandwidths from the lowest sensor to the highest."""
        row = {"on the model (Hz)": _span(self.on_model)}
        if self.loops is not self.model_loops:
            row["on the measurement (Hz)"] = _span(self.on_measurement)
        stop = self.recommended or self.on_measurement or self.on_model
        if stop is not None:
            moved, sensor = divmod(stop.loop, len(self.model_loops))
            place = f" of sensor {sensor + 1}" if stop.function in FUNCTIONS else ""
            where = " somewhere in the box" if moved else ""
            if 1 <= moved <= len(self.elsewhere):
                where = f" of response {moved + 1}"
            name = SHOWN.get(stop.function, stop.function)
            if name == NOISE:
                row["stopped by"] = f"{name}: more is not allowed"
            elif name == "the end of the search":
                row["stopped by"] = f"{name}: its design parameter is {in_hertz(stop.design_hz)} Hz"
            else:
                row["stopped by"] = f"{name}{place} at {in_hertz(stop.peak.omega / (2 * np.pi), 0)} Hz{where}"
            row["feasible"] = f"{stop.lowest_hz:.3g} to {stop.design_hz:.3g} Hz"
            suspension = float(self.model_loops[0].plant.frequencies[0]) / (2 * np.pi)
            if stop.design_hz < (1 - 1e-9) * ABOVE_SUSPENSION * suspension:
                row["feasible"] += (
                    ", about the suspension: below it the springs hold the machine, not the loop"
                )
        if self.encirclement_difference is not None:
            row["extra turns"] = str(self.encirclement_difference)
        return row


@by_value
@dataclass(frozen=True)
class DesignSettings:
    """Settings of one use of an observer.

    Attributes
    ----------
    application : Application, optional
        None: no observer.
    retained : int
        Largest number of modes in the observer, the rigid body included; the others enter as compliance.
    intensities : Intensities
        Design intensities of the observer.
    notches : bool
        Give the controller a notch at each of these resonances that the rate reaches.
    lead : float
        See `PidFamily`.
    wait : float
        Samples that the controller waits by itself; what is beside whole ones is an all-pass. See `waiting`.
    """

    application: Application | None
    retained: int
    intensities: Intensities
    notches: bool = False
    lead: float = 3.0
    wait: NonNegative = 0.0

    def __post_init__(self):
        check_fields(self)

    @checked
    def family(self, machine: Machine, sample_time: float) -> PidFamily:
        """The PID rules of a machine with these settings."""
        return pid_family(machine, self.lead, self.retained if self.notches else 1, sample_time)


@checked
def waiting(block: StateModel, samples: NonNegative) -> StateModel:
    """A sampled compensator that waits: the measurement less y_flex, and u_d, leave late by `samples`.

    Whole samples are delays; what is beside them is an all-pass of first order that is as late at low frequencies. The
    controller is behind it, so that it waits, too: with it the machine is one that is later by as much.
    """
    if not samples:
        return block
    if not block.sample_time:
        raise InputError("samples: in continuous time there are none to wait for; give a sample time")
    c, d = block.c * [[1.0], [-1.0]], block.d * [[1.0], [-1.0]] + [[0.0, 0.0], [0.0, 1.0]]
    whole, part = split_delay(samples)
    late = delayed(replace(block, c=c, d=d), whole)
    if part:
        a, one = -(1 - part) / (1 + part), np.eye(2)
        turned = StateModel(a * one, one, (1 - a * a) * one, -a * one, block.sample_time)
        late = interconnect([late, turned], np.eye(4, k=-2), np.eye(4, 2), np.eye(2, 4, k=2))
    return replace(late, c=late.c * [[1.0], [-1.0]], d=late.d * [[1.0], [-1.0]] + [[0.0, 0.0], [0.0, 1.0]])


@checked
def with_compensator(loop: Loop, block: StateModel) -> Loop:
    """The loop with another compensator."""
    if block is loop.compensator:
        return loop
    return make_loop(loop.plant, block, sample_time=loop.sample_time, delay=loop.delay)


@by_value
@dataclass(frozen=True)
class SearchSettings:
    """What a search for a bandwidth holds fixed.

    Attributes
    ----------
    sample_time : float
        Sample time, s; 0: continuous time.
    delay : float
        Samples from command to force, whole or not.
    uncertainty : mapping of str to float
        Uncertainty of the model, by the fields of `Uncertainty`, plus the intervals of a fit:
        the constraints hold all over that box. Empty: on the model alone.
    others : sequence of (Machine, float)
        The same machine at other positions, and the delay there in samples: the same controller and observer keep the
        constraints there, too, and in the box around it. One sensor each.
    noise : NoiseBound
        For a sampled loop: allowed sensor noise in the output, on the models.
    loop_hz : tuple of float
        Band in which the measurement represents the plant; (0, 0): see `measured_band`.
    search_hz : tuple of float
        Range of the design parameter; (0, 0) for 1/40 of the first resonance to all of it, from twice a suspension
        and to a tenth of the rate.
    constraints : sequence of PeakConstraint
        By default those of a controller that runs on the error: both sensitivities, each at most 6 dB.
    """

    sample_time: float = 0.0
    delay: float = 0.0
    uncertainty: Mapping[str, float] = field(default_factory=dict)
    others: Sequence[tuple[Machine, float]] = ()
    noise: NoiseBound = UNBOUNDED
    loop_hz: tuple[float, float] = (0.0, 0.0)
    search_hz: tuple[float, float] = (0.0, 0.0)
    constraints: Sequence[PeakConstraint] = OF_ERROR

    def __post_init__(self):
        check_fields(self)

    @checked
    def limits(self, application: Application | None) -> Sequence[PeakConstraint]:
        """The constraints; without an observer, where all functions of a loop are the same, the tightest."""
        if application is not None:
            return self.constraints
        return [min(self.constraints, key=lambda each: each.limit)]

    @checked
    def loops_of(self, machine: Machine, use: DesignSettings) -> tuple[tuple[Loop, ...], tuple[Loop, ...]]:
        """Loops of one use on the model: one a sensor, and the same observer's at the other positions."""
        observer = observer_settings(machine, use.application, use.retained, use.intensities)
        loops = observed_loops(machine.sensors, use.application, *observer, self.sample_time, self.delay)
        loops = tuple(with_compensator(loop, waiting(loop.compensator, use.wait)) for loop in loops)
        return loops, loops_elsewhere(loops[0], self.others)


@checked(infinite=True)
def reach(
    machine: Machine, use: DesignSettings, search: SearchSettings = SearchSettings()
) -> AchievableBandwidth:
    """Largest bandwidth of one use of the observer below which, and at which, all constraints hold at every sensor.

    Of several feasible intervals the lowest is taken, see `maximise_bandwidth`.

    Parameters
    ----------
    machine : Machine
    use : DesignSettings
    search : SearchSettings

    Raises
    ------
    InputError
        For invalid settings. A use without any feasible bandwidth is a result, see `AchievableBandwidth.reason`.
    """
    try:
        modelled, elsewhere = search.loops_of(machine, use)
    except InputError as error:
        return AchievableBandwidth(None, None, None, (), (), reason=f"no observer: {error}")
    task = _Task.of(machine, use, search, modelled, elsewhere)
    perturbed = (*elsewhere, *task.corners)
    on_model, reason = task.search((*modelled, *perturbed))
    loops, on_data, other = task.on_measurement()
    reason = reason or other
    on_model, perturbed, other = task.in_the_box(on_model, on_data, perturbed)
    reason = reason or other
    turns = None
    if on_model is not None:
        crossings = [loop.crossing_hz(on_model.controller) for loop in modelled]
        on_model = replace(on_model, crossing_hz=np.array(crossings))
    if on_data is not None:
        lower = _lower(on_model, on_data)
        turns = sum(abs(encirclement_difference(loop, lower.controller)) for loop in loops)
    return AchievableBandwidth(on_model, on_data, turns, loops, modelled, perturbed, reason, elsewhere)


class _Task(NamedTuple):
    """One use of an observer on every response of a machine, each with its loops, its box and its measured band."""

    responses: tuple[tuple[Machine, float], ...]
    groups: tuple[tuple[Loop, ...], ...]
    spreads: tuple[Uncertainty, ...]
    bands: tuple[tuple[float, float], ...]
    family: PidFamily
    limits: Sequence[PeakConstraint]
    noise: NoiseBound
    low: float
    high: float

    @classmethod
    def of(
        cls, machine: Machine, use: DesignSettings, search: SearchSettings, modelled, elsewhere
    ) -> "_Task":
        responses = ((machine, search.delay), *search.others)
        ends = search.search_hz if any(search.search_hz) else search_range(machine, search.sample_time)
        return cls(
            responses,
            (modelled, *((loop,) for loop in elsewhere)),
            tuple(uncertainty_of(each, search.uncertainty) for each, _ in responses),
            tuple(measured_band(each, search.loop_hz) for each, _ in responses),
            use.family(machine, search.sample_time),
            search.limits(use.application),
            search.noise,
            *ends,
        )

    @property
    def corners(self) -> tuple[Loop, ...]:
        pairs = zip(self.groups, self.spreads, strict=True)
        return tuple(loop for group, spread in pairs for loop in perturbed_loops(group, corners(spread)))

    def search(self, loops, low=0.0, high=0.0, refine=True) -> tuple[Bandwidth | None, str]:
        """The bandwidth of some loops, or why there is none; not refined where they are measured."""
        sizes = (len(self.groups[0]), len(self.groups) - 1) if refine else None
        ends = {"low": low or self.low, "high": high or self.high}
        return _search(loops, family=self.family, limits=self.limits, refine=refine, sizes=sizes, **ends)

    def quiet(self, found: Bandwidth) -> tuple[Bandwidth | None, str]:
        """Lowered to where the noise at the output is allowed."""
        nominal = [loop for group in self.groups for loop in group]
        return self.noise.lowered(nominal, self.family, found)

    def on_measurement(self) -> tuple[tuple[Loop, ...], Bandwidth | None, str]:
        """Measured loops and the bandwidth on them; without a measurement those of the model and none."""
        loops, beside = self._measured()
        if not loops:
            return self.groups[0], None, ""
        found, reason = self.search(loops, refine=False)
        # A few more places of phased modes at a time, where they do harm.
        for _ in range(PHASED_ROUNDS):
            if found is None or not (harmful := _exceeded(beside, found.controller, self.limits)):
                break
            loops = (*loops, *harmful)
            found, reason = self.search(loops, refine=False)
        if found is not None:
            found, other = self.quiet(found)
            reason = reason or other
        return loops, found, reason

    def _measured(self) -> tuple[tuple[Loop, ...], list[Loop]]:
        """Loops on the measurements and on models whose modes have phases, and those of the latter at further places."""
        seen = [
            on_measurement(loop, each.measured, 1.0, band)
            for group, (each, _), band in zip(self.groups, self.responses, self.bands, strict=True)
            if each.measured is not None
            for loop in group
        ]
        beside: list[Loop] = []
        for group, (each, _), spread in zip(self.groups, self.responses, self.spreads, strict=True):
            if each.fit is not None and each.fit.phased is not None:
                phased = partial(phased_loops, group, each.fit.phased)
                seen += phased(phased_corners(spread))
                beside += phased(phased_places(spread, np.random.default_rng(PHASED_SEED)))
        return tuple(seen), beside

    def in_the_box(
        self, found: Bandwidth | None, on_data: Bandwidth | None, perturbed: tuple[Loop, ...]
    ) -> tuple[Bandwidth | None, tuple[Loop, ...], str]:
        """The bandwidth lowered until no place of a box does harm, with the loops there; or why there is none."""
        boxed, modelled = not all(spread.is_empty for spread in self.spreads), self.groups[0]
        boxes = [
            [] if spread.is_empty else [make_box(loop, spread) for loop in group]
            for group, spread in zip(self.groups, self.spreads, strict=True)
        ]
        reason = ""
        for _ in range(ROUNDS):
            if found is not None:
                found, other = self.quiet(found)
                reason = reason or other
            if found is None or not boxed:
                return found, perturbed, reason
            lower = _lower(found, on_data)
            new = self._harmful(lower.controller, boxes)
            if not new:
                return found, perturbed, reason
            ends = found.lowest_hz, lower.design_hz
            before, perturbed = len(modelled) + len(perturbed), (*perturbed, *new)
            found, _ = self.search(new, *ends)
            if found is not None:  # the loops before hold up to there
                found = replace(found, loop=before + found.loop)
            else:
                found, other = self.search((*modelled, *perturbed))
                reason = reason or other
        return None, perturbed, "new places in the box do harm again and again" if found else reason

    def _harmful(self, controller: Pid, boxes) -> tuple[Loop, ...]:
        """Loops at the worst places of the boxes that exceed a constraint; looked for thoroughly where none is seen."""
        for starts in (1, THOROUGH):
            places = [
                harmful_places(group, controller, self.limits, box, starts)
                for group, box in zip(self.groups, boxes, strict=True)
            ]
            if any(places):
                break
        pairs = zip(self.groups, places, strict=True)
        return tuple(loop for group, found in pairs for loop in perturbed_loops(group, found))


def _exceeded(loops: Sequence[Loop], controller: Pid, limits: Sequence[PeakConstraint]) -> list[Loop]:
    """The few loops that exceed their limits most, on their lines."""
    sizes = [
        max(np.abs(getattr(loop.at(controller), limit.function)).max() / limit.limit for limit in limits)
        for loop in loops
    ]
    worst = np.argsort(sizes)[::-1][:MOST_ADDED]
    return [loops[k] for k in worst if sizes[k] > EXCESS]


@checked
def loops_elsewhere(loop: Loop, others: Sequence[tuple[Machine, float]]) -> tuple[Loop, ...]:
    """The same observer on the first sensor of other machines, each with its own delay in samples."""
    return tuple(
        make_loop(each.sensors[0], loop.compensator, sample_time=loop.sample_time, delay=delay)
        for each, delay in others
    )


@checked
def search_range(machine: Machine, sample_time: float) -> tuple[float, float]:
    """Where bandwidths are sought, Hz: below the first resonance, above a suspension, to a tenth of the rate.

    For the first resonance of a machine that shows none stands half the end of its measured band, in which the loop gain
    must fall through 0 dB; without a measurement the rate alone is the end.
    """
    top = machine.rigid_to_hz * (1.0 if len(machine.resonances_hz) else CROSSED)
    if not np.isfinite(top):
        if not sample_time:
            raise InputError(
                f"{machine.source}: no flexible mode and no rate limit its bandwidth; give a rate"
            )
        top = 0.1 / sample_time
    low, high = (share * top for share in SEARCH)
    low = max(low, ABOVE_SUSPENSION * float(machine.sensors[0].frequencies[0]) / (2 * np.pi))
    return low, min(high, 0.1 / sample_time) if sample_time else high


@checked
def pid_family(machine: Machine, lead: float, modes: int, sample_time: float) -> PidFamily:
    """PID rules, with notches at the resonances among the first modes; where Tustin puts them, with a `sample_time`."""
    omega = machine.sensors[0].frequencies[1:modes]
    if sample_time:
        omega = prewarped(omega[omega < HIGHEST_NOTCH * np.pi / sample_time], sample_time)
    return PidFamily(machine.mass, tuple(omega.tolist()), lead)


def _search(loops, *, family, limits, low, high, refine, sizes) -> tuple[Bandwidth | None, str]:
    try:
        return maximise_bandwidth(
            loops, family, limits, low, high, tolerance_hz=1e-4 * low, refine=refine, lowest=True
        ), ""
    except Infeasible as error:
        if error.stopped is None:
            return None, str(error)
        function, number, peak = error.stopped
        name, size = SHOWN.get(function, function), 20 * np.log10(peak.magnitude)
        what = f"{name} peaks at {size:.1f} dB" if np.isfinite(size) else f"{name} fails"
        at = f"{peak.omega / (2 * np.pi):.3g} Hz {_place(number, sizes)}"
        return None, f"none from {low:.3g} to {high:.3g} Hz: at {low:.3g} Hz {what}, at {at}"
    except InputError as error:
        return None, str(error)


def _place(number: int, sizes: tuple[int, int] | None) -> str:
    """Where a loop is, of which there are so many on the model and at other responses; None: all are measured."""
    if sizes is None:
        return f"of measurement {number + 1}"
    modelled, elsewhere = sizes
    if number < modelled:
        return "on the model"
    return "at another response" if number < modelled + elsewhere else "somewhere in the box"


def _lower(first: Bandwidth | None, second: Bandwidth | None) -> Bandwidth:
    return min((each for each in (first, second) if each), key=lambda each: each.design_hz)


@checked
def in_hertz(hertz: float, digits: int = 1) -> str:
    """Rounded for a line of text; for a slow machine to three digits."""
    return f"{hertz:.{digits}f}" if hertz >= 1 else f"{hertz:.3g}"


def _span(bandwidth: Bandwidth | None) -> str:
    if bandwidth is None:
        return "none"
    low, high = (in_hertz(pick(bandwidth.crossing_hz)) for pick in (np.min, np.max))
    return low if low == high else f"{low} to {high}"
