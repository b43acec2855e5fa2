"""Settings of a controller and its observer with the highest bandwidth, by one coordinate search."""

from dataclasses import replace
from typing import Any

from stillwork.base.bounds import Positive
from stillwork.base.checks import InputError, require_choice
from stillwork.base.validation import checked
from stillwork.control.bandwidth import is_feasible, make_loop
from stillwork.control.machine_loops import DesignSettings, SearchSettings, search_range
from stillwork.control.uncertainty import Box, harmful_places, make_box, uncertainty_of
from stillwork.identification.machine import Machine

# One step of each setting; tried up, then down, again and again while the bandwidth grows.
STEPS = {"lead": 4 / 3, "damping": 2.0, "selectivity": 2.0, "sensor": 10.0, "drift": 10.0, "retained": 1.5}
LEADS = (2.0, 8.0)
MAX_SETTING = {"damping": 0.5, "selectivity": 16.0}
PUSH = 1.03  # of the bandwidth, at a time


@checked(infinite=True)
def tuned(
    machine: Machine, settings: DesignSettings, design_hz: Positive, search: SearchSettings
) -> DesignSettings:
    """Settings that meet the constraints and the noise bound on all models at a bandwidth above `design_hz`."""
    # One grid for all settings: what the box holds there is the same for each.
    boxes = [
        make_box(make_loop(sensor, sample_time=search.sample_time, delay=late), spread, fine=False)
        for each, late in [(machine, search.delay), *search.others]
        if not (spread := uncertainty_of(each, search.uncertainty)).is_empty
        for sensor in each.sensors
    ]
    for name, size in STEPS.items():
        for factor in (size, 1 / size):
            while (trial := varied(settings, name, factor)) is not None:
                reached = _increased(machine, trial, design_hz, search, boxes)
                if reached == design_hz:
                    break
                settings, design_hz = trial, reached
    return settings


def _increased(
    machine: Machine, use: DesignSettings, design_hz: float, search: SearchSettings, boxes: list[Box]
) -> float:
    """The bandwidth up to which these settings hold, from the best so far on; that itself if they hold no more."""
    try:
        modelled, elsewhere = search.loops_of(machine, use)
    except InputError:  # no observer can be made with these
        return design_hz
    loops, limits = [*modelled, *elsewhere], search.limits(use.application)
    family, (_, highest) = use.family(machine, search.sample_time), search_range(machine, search.sample_time)
    answers = [
        loop.compensator.frequency_response(box.omega) for loop, box in zip(loops, boxes, strict=False)
    ]
    while (
        PUSH * design_hz < highest
        and is_feasible(loops, pid := family(PUSH * design_hz), limits)
        and max(search.noise.excess(loop, pid) for loop in loops) <= 1
        and not harmful_places(loops, pid, limits, boxes, 1, answers, first=True)
    ):
        design_hz *= PUSH
    return design_hz


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
