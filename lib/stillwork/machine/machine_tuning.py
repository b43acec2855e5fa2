"""Settings of a controller and its observer with the highest bandwidth, by one coordinate search."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from stillwork.base.bounds import NonNegative, Positive
from stillwork.base.checks import InputError, require_choice
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.control.applications import Application
from stillwork.control.bandwidth import Loop, PeakConstraint, is_feasible, make_loop
from stillwork.control.loop_noise import UNBOUNDED, NoiseBound
from stillwork.control.machine_loops import (
    OF_ERROR,
    Intensities,
    as_one,
    loops_elsewhere,
    observed_loops,
    observer_settings,
    pid_family,
    search_range,
)
from stillwork.control.uncertainty import harmful_places, make_box, uncertainty_of
from stillwork.identification.machine import Machine

# One step of each setting; tried up, then down, again and again while the bandwidth grows.
STEPS = {"lead": 4 / 3, "damping": 2.0, "selectivity": 2.0, "sensor": 10.0, "drift": 10.0, "retained": 1.5}
LEADS = (2.0, 8.0)
MAX_SETTING = {"damping": 0.5, "selectivity": 16.0}
PUSH = 1.03  # of the bandwidth, at a time


@by_value
@dataclass(frozen=True)
class DesignSettings:
    """Settings of one use of an observer."""

    application: Application | None  # None: no observer
    retained: int  # modes in the observer, the rigid body included
    intensities: Intensities
    notches: bool = False
    lead: float = 3.0

    def __post_init__(self):
        check_fields(self)


@checked(infinite=True)
def tuned(
    machine: Machine,
    settings: DesignSettings,
    design_hz: Positive,
    *,
    uncertainty: Mapping[str, float],
    sample_time: Positive,
    delay: NonNegative,
    constraints: Sequence[PeakConstraint] = OF_ERROR,
    others: Sequence[tuple[Machine, float]] = (),
    noise: NoiseBound = UNBOUNDED,
) -> DesignSettings:
    """Settings that meet the constraints and the noise bound on all models at a bandwidth above `design_hz`."""

    def loops_of(each: DesignSettings) -> list[Loop]:
        chosen = observer_settings(machine, each.application, each.retained, each.intensities)
        loops = observed_loops(machine.sensors, each.application, *chosen, sample_time, delay)
        return [*loops, *loops_elsewhere(loops[0], others)]

    def increase_bandwidth(each: DesignSettings) -> float:
        """The bandwidth up to which these settings hold, from the best so far on; that itself if they hold no more."""
        try:
            loops = loops_of(each)
        except InputError:  # no observer can be made with these
            return design_hz
        family = pid_family(machine, each.lead, each.retained if each.notches else 1, sample_time)
        reached, answers = (
            design_hz,
            [loop.compensator.frequency_response(box.omega) for loop, box in zip(loops, boxes, strict=False)],
        )
        while (
            PUSH * reached < highest
            and is_feasible(loops, pid := family(PUSH * reached), limits)
            and max(noise.excess(loop, pid) for loop in loops) <= 1
            and not harmful_places(loops, pid, limits, boxes, 1, answers, first=True)
        ):
            reached *= PUSH
        return reached

    limits = constraints if settings.application else as_one(constraints)
    # One grid for all settings: what the box holds there is the same for each.
    boxes = [
        make_box(make_loop(sensor, sample_time=sample_time, delay=late), spread, fine=False)
        for each, late in [(machine, delay), *others]
        if not (spread := uncertainty_of(each, uncertainty)).is_empty
        for sensor in each.sensors
    ]
    _, highest = search_range(machine, sample_time)
    for name, size in STEPS.items():
        for factor in (size, 1 / size):
            while (trial := varied(settings, name, factor)) is not None:
                reached = increase_bandwidth(trial)
                if reached == design_hz:
                    break
                settings, design_hz = trial, reached
    return settings


@checked
def varied(settings: DesignSettings, name: str, factor: float) -> DesignSettings | None:
    """The settings with one of them changed by a factor; None if they have no such setting, or it is at its limit."""
    require_choice("name", name, STEPS)
    application, intensities = settings.application, settings.intensities
    if name == "lead":
        lead = factor * settings.lead
        return replace(settings, lead=lead) if LEADS[0] <= lead <= LEADS[1] else None
    if name == "retained":
        count = max(2, round(factor * settings.retained))
        unused = application is None and not settings.notches
        return None if unused or count == settings.retained else replace(settings, retained=count)
    if application is None or (name == "drift" and not application.compensate):
        return None
    if name in ("sensor", "drift"):
        noise = replace(intensities, **{name: factor * getattr(intensities, name)})
        return replace(settings, intensities=noise)
    value = getattr(application, name)
    if not isinstance(value, float) or not value or factor * value > MAX_SETTING[name]:
        return None
    changed: dict[str, Any] = {name: factor * value}
    return replace(settings, application=replace(application, **changed))
