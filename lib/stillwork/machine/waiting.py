"""How far one use of an observer gets with another lead of its controller and with samples of own delay."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from stillwork.base.checks import InputError
from stillwork.base.kernels import kernel
from stillwork.control.bandwidth import SIX_DB, Loop
from stillwork.control.machine_loops import (
    AchievableBandwidth,
    DesignSettings,
    SearchSettings,
    search_range,
)
from stillwork.control.pid import Pid
from stillwork.control.uncertainty import corners, harmful_places, make_box, perturbed_loops, uncertainty_of
from stillwork.identification.machine import Machine
from stillwork.lti.discretisation import prewarped

FINE = np.arange(0.5, 8.0)  # samples between whole ones that are tried, of the loop's delay
MOST_WAITS = 48
LONGEST = 100  # samples of the loop's delay, that are tried: each is a state of the controller
LEADS = (2.25, 3.0, 4.0, 16 / 3, 64 / 9)  # those that a tuning passes through
RATIO, HALVINGS = 1.1, 5  # of two bandwidths on the way up, and how often the last step is halved: 0.3 %
ROUNDS = 60  # of adding places of the box
WORTH = 0.003  # relative gain in bandwidth for which a search goes on


def waits(machine: Machine, search: SearchSettings) -> np.ndarray:
    """Samples to wait for that are tried: to half a period of the first resonance, by which its phase turns around, or `LONGEST`.

    What they make of the loop's delay is the same for all delays that differ by whole samples, so that a machine that is
    earlier by these gets as far.
    """
    most = min(max(2.0, np.floor(0.5 / (machine.rigid_to_hz * search.sample_time))), LONGEST)
    whole = np.geomspace(1, most, MOST_WAITS).round() if most > MOST_WAITS else np.arange(1, most + 1)
    later = np.concatenate([FINE, whole]) - np.floor(search.delay + 1e-9)
    return np.unique(np.concatenate([[0.0, 1.0], later[later > 0]]))


def waited(
    machine: Machine, use: DesignSettings, search: SearchSettings, known: AchievableBandwidth, known_hz: float
) -> DesignSettings:
    """The settings with the lead and the own delay that get furthest in the whole box; as they are where none do.

    All pairs are looked at on a few loops. Where the furthest does harm at a place of the box, the loops there are
    added and all pairs are looked at again, until it does none. `known` is what is found with the settings themselves.
    """
    try:
        modelled, elsewhere = search.loops_of(machine, replace(use, wait=0.0))
    except InputError:
        return use
    groups = [modelled, *((loop,) for loop in elsewhere)]
    spreads = [
        uncertainty_of(each, search.uncertainty) for each in (machine, *(other for other, _ in search.others))
    ]
    boxes = [
        [] if spread.is_empty else [make_box(loop, spread) for loop in group]
        for group, spread in zip(groups, spreads, strict=True)
    ]
    new = [loop for group in groups for loop in group]
    new += [loop for k, group in enumerate(groups) for loop in perturbed_loops(group, corners(spreads[k]))]
    if not use.wait:
        new += [*known.perturbed, *(known.loops if known.loops is not known.model_loops else ())]
    leads, late = list(dict.fromkeys([use.lead, *LEADS])), waits(machine, search)
    ratios = np.array(
        [[_over_design(modelled[0], machine, replace(use, lead=lead), search)] for lead in leads]
    )
    hertz, trial = np.full((len(leads), len(late)), np.inf), use
    for _ in range(ROUNDS):
        if new:
            wanted = ratios * hertz > known_hz
            hertz = np.minimum(hertz, design_bandwidths(new, machine, use, search, leads, late, wanted))
        j, k = np.unravel_index((ratios * hertz).argmax(), hertz.shape)
        if ratios[j, 0] * hertz[j, k] <= (1 + WORTH) * known_hz:
            return use
        trial = replace(use, lead=leads[j], wait=float(late[k]))
        stable, new = _judged(machine, trial, search, float(hertz[j, k]), groups, boxes)
        if stable and not new:
            break
        # Of a peak between the lines of its grid the next look may see nothing.
        hertz[j, k] *= 1 - WORTH if stable else 0.0
    return trial


def bound_hz(machine: Machine, use: DesignSettings, search: SearchSettings) -> float:
    """The first crossing, Hz, on the model and at two corners of the box: in the whole of it there is no more."""
    try:
        modelled, elsewhere = search.loops_of(machine, replace(use, wait=0.0))
    except InputError:
        return 0.0
    loops = [
        *modelled,
        *elsewhere,
        *perturbed_loops(modelled, corners(uncertainty_of(machine, search.uncertainty))),
    ]
    pair = [use.lead], np.array([use.wait]), np.ones((1, 1), bool)
    found = design_bandwidths(loops, machine, use, search, *pair)
    return _over_design(modelled[0], machine, use, search) * float(found[0, 0])


def _over_design(loop: Loop, machine: Machine, use: DesignSettings, search: SearchSettings) -> float:
    """First crossing over design bandwidth: far below the resonances that of the rigid body."""
    low = search_range(machine, search.sample_time)[0]
    with suppress(InputError):  # a loop about a suspension may not fall through 0 dB there
        return float(loop.crossing_hz(use.family(machine, search.sample_time)(low))) / low
    return 1.0


def _judged(
    machine: Machine, use: DesignSettings, search: SearchSettings, design_hz: float, groups, boxes
) -> tuple[bool, list[Loop]]:
    """Whether the loops on the model are stable; those without waiting at places of the box where one exceeds a constraint."""
    modelled, elsewhere = search.loops_of(machine, use)
    pid = use.family(machine, search.sample_time)((1 - WORTH) * design_hz)
    if not all(loop.is_stable(pid) for loop in (*modelled, *elsewhere)):
        return False, []
    found: list[Loop] = []
    for group, prompt, box in zip([modelled, *((loop,) for loop in elsewhere)], groups, boxes, strict=True):
        found += perturbed_loops(prompt, harmful_places(group, pid, search.limits(use.application), box, 1))
    return True, found


def design_bandwidths(
    loops: Sequence[Loop],
    machine: Machine,
    use: DesignSettings,
    search: SearchSettings,
    leads: Sequence[float],
    late: np.ndarray,
    wanted: np.ndarray,
) -> np.ndarray:
    """Design bandwidths (Hz) up to which both sensitivities stay below 6 dB on the grids of the loops, shape (leads, waits).

    The loops are those of the use without waiting. No pole is looked for: a search finds no more. Where it is not
    `wanted`, 0.
    """
    low, high = search.search_hz if any(search.search_hz) else search_range(machine, search.sample_time)
    designs_hz = np.geomspace(low, high, 2 + int(np.log(high / low) / np.log(RATIO)))
    omega = np.concatenate([loop.omega for loop in loops])
    plant = np.concatenate([loop.plant_response for loop in loops])
    (o_uu, o_uy), (o_yu, o_yy) = np.concatenate([loop.compensator_response for loop in loops], axis=-1)
    s = 1j * prewarped(omega, search.sample_time)
    notched = np.ones_like(s)
    for notch in use.family(machine, search.sample_time)(low).notches:
        notched = notched * notch.at(s)
    kept = o_uu, o_uy, o_yu * notched, (1 - o_yy) * notched
    delays = np.array([_late(omega * search.sample_time, samples) for samples in late])
    found = np.zeros((len(leads), len(late)))
    for row, lead in enumerate(leads):
        if wanted[row].any():
            rules = replace(use, lead=lead)
            unit = _numbers(rules.family(machine, search.sample_time)(1.0))
            found[row] = _reached(s, plant, *kept, delays, unit, designs_hz, SIX_DB, wanted[row])
    return found


def _late(turn: np.ndarray, samples: float) -> np.ndarray:
    """Response of `machine_loops.waiting`."""
    whole = np.floor(samples)
    a = (1 - samples + whole) / (1 + samples - whole)
    z = np.exp(-1j * turn)
    return z**whole * ((a + z) / (1 + a * z) if samples > whole else 1.0)


def _numbers(pid: Pid) -> np.ndarray:
    """Of the rules at 1 Hz: the gain grows with the square of the bandwidth, the three frequencies with it."""
    return np.array([pid.gain, pid.integrator, pid.differentiator, pid.low_pass, pid.low_pass_damping])


@kernel
def _reached(s, plant, o_uu, o_uy, o_yu, rest, delays, unit, designs_hz, limit, wanted):
    """For each wanted delay the end of the lowest feasible stretch of bandwidths; 0 where there is none."""
    found = np.zeros(len(delays))
    for k in range(len(delays)):
        if not wanted[k]:
            continue
        place = 0  # where the last design failed: there the next one is likely to
        row, good, bad, halved = 0, 0.0, 0.0, 0
        while True:
            if bad > 0:
                if halved == HALVINGS:
                    break
                halved += 1
                hertz = np.sqrt(good * bad)
            elif row == len(designs_hz):
                break
            else:
                hertz = designs_hz[row]
                row += 1
            gain, integrator, differentiator = hertz * hertz * unit[0], hertz * unit[1], hertz * unit[2]
            w, damping = hertz * unit[3], unit[4]
            fails = False
            for step in range(len(s)):
                i = (place + step) % len(s)
                x = s[i]
                c = gain * (x + integrator) * (x / differentiator + 1) * w * w
                c = c / (x * (x * x + 2 * damping * w * x + w * w))
                late, p = delays[k, i], plant[i]
                outer = 1 - late * (c * o_yu[i] + o_uu[i])
                inner = 1 - late * (o_uu[i] + o_uy[i] * p)
                turn = outer + late * (c * rest[i] - o_uy[i]) * p
                most = limit * abs(turn)
                if not (abs(outer) <= most and abs(inner) <= most):
                    place, fails = i, True
                    break
            if not fails:
                good = hertz
            elif good > 0:
                bad = hertz
        found[k] = good
    return found
