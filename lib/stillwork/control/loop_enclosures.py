"""Proven peaks of a loop's functions, for the floating-point numbers of plant, compensator and controller."""

from collections.abc import Sequence
from fractions import Fraction
from math import degrees, inf, lcm

import numpy as np

from stillwork.base.validation import checked
from stillwork.control.bandwidth import FUNCTIONS, Loop
from stillwork.control.machine_loops import HELD, SHOWN
from stillwork.control.pid import Pid
from stillwork.lti.discretisation import tustin
from stillwork.lti.enclosures import (
    Enclosure,
    Polynomial,
    Quotients,
    add,
    enclose_quotients,
    in_z,
    multiply,
    outward,
    turned,
)
from stillwork.lti.margin_enclosures import enclose_first_crossing, enclose_gain_margins, enclose_phase_margin
from stillwork.lti.state_space import StateModel

MARGINS = {
    "crossing_hz": "first crossing of 0 dB (Hz)",
    "gain_reduction": "stable with its gain times",
    "gain_margin": "gain margin (factor)",
    "phase_margin": "phase margin (degrees)",
    "modulus_margin": "modulus margin",
}

Functions = dict[str, tuple[Polynomial, Polynomial]]  # numerator and denominator, in s or z


@checked(infinite=True)
def enclose_peaks(loop: Loop, pid: Pid, written: StateModel | None = None) -> dict[str, Enclosure]:
    """Bounds of the peaks of a loop, each proven together with the stability of the whole loop if possible.

    Parameters
    ----------
    loop : Loop
        Its plant and compensator are taken as the numbers of their models: of a sampled loop after the hold.
    pid : Pid
        Controller of this loop.
    written : StateModel, optional
        The same controller and the compensator in one model, from (r, y, f) to the command, as it is written to a
        file; by default they are composed without rounding.

    Returns
    -------
    dict of str to Enclosure
        One for each of `control.bandwidth.FUNCTIONS`, magnitudes; infinite and proven of an unstable loop. The
        inverse of the output sensitivity's is the distance that the loop keeps from -1 at least.

    Raises
    ------
    InputError
        When an argument is not of its kind.

    References
    ----------
    Verkerk, Improved accuracy of flexible systems by state estimation, thesis (2018), section 3.2.

    Examples
    --------
    >>> mass = lti.ModalModel([0.0], [0.0], [[1.0]], [[0.1]], [[0.0]])  # 10 kg
    >>> loop, pid = control.make_loop(mass, sample_time=1e-4, delay=1), control.PidFamily(10.0)(50.0)
    >>> print(control.enclose_peaks(loop, pid)["output_sensitivity"].in_db())
    at most 6.0694, proven
    """
    functions = _functions(loop, pid, written)
    return {name: _peak(loop, pid, functions, name) for name in FUNCTIONS}


@checked(infinite=True)
def enclose_margins(loop: Loop, pid: Pid, written: StateModel | None = None) -> dict[str, Enclosure]:
    """Bounds of a loop's first crossing and of its stability margins, each proven if possible.

    Parameters
    ----------
    loop, pid, written
        See `enclose_peaks`.

    Returns
    -------
    dict of str to Enclosure
        ``crossing_hz``: where the loop gain at the controller first falls through 0 dB, infinite if it
        never does. For the loop at the plant's output: ``gain_reduction`` and ``gain_margin``, the factors
        below and above 1 at which it becomes unstable (0 and infinite where none does), ``phase_margin`` (degrees)
        and ``modulus_margin``, its smallest distance from -1. The margins of an unstable loop are 0 (its gain
        may not be reduced: 1).

    Raises
    ------
    InputError
        When an argument is not of its kind.

    References
    ----------
    Collins and Akritas, Polynomial real root isolation using Descartes' rule of signs, SYMSAC (1976).

    Examples
    --------
    >>> mass = lti.ModalModel([0.0], [0.0], [[1.0]], [[0.1]], [[0.0]])  # 10 kg
    >>> loop, pid = control.make_loop(mass, sample_time=1e-4, delay=1), control.PidFamily(10.0)(50.0)
    >>> {name: round(each.low, 3) for name, each in control.enclose_margins(loop, pid).items()}
    {'crossing_hz': 52.49, 'gain_reduction': 0.107, 'gain_margin': 2.84, 'phase_margin': 34.334, 'modulus_margin': 0.497}
    """
    functions = _functions(loop, pid, written)
    return _margins(loop, functions, _peak(loop, pid, functions, "output_sensitivity"))


def _peak(loop: Loop, pid: Pid, functions: Functions, name: str) -> Enclosure:
    if name not in functions:
        return Enclosure(0.0, inf, False)
    return enclose_quotients(_on_axis(loop, *functions[name]), loop.peak(pid, name).magnitude)


def _margins(loop: Loop, functions: Functions, peak: Enclosure) -> dict[str, Enclosure]:
    """See `enclose_margins`; `peak` is that of the output sensitivity."""
    found = dict.fromkeys(MARGINS, Enclosure(0.0, inf, False))
    if not peak.proven:
        return found
    if "input_sensitivity" in functions:
        n, d = _opened(loop, *functions["input_sensitivity"])
        found["crossing_hz"] = enclose_first_crossing(n, d, loop.sample_time)
    if peak.low == inf:
        none = Enclosure(0.0, 0.0, True)
        unstable = dict.fromkeys(MARGINS, none) | {
            "gain_reduction": Enclosure(1.0, 1.0, True),
            "crossing_hz": found["crossing_hz"],
        }
        return found | unstable
    n, d = _opened(loop, *functions["output_sensitivity"])
    found["gain_reduction"], found["gain_margin"] = enclose_gain_margins(n, d)
    phase = enclose_phase_margin(n, d)
    found["phase_margin"] = Enclosure(
        outward(degrees(phase.low), -1), outward(degrees(phase.high), 1), phase.proven
    )
    found["modulus_margin"] = Enclosure(outward(1 / peak.high, -1), outward(1 / peak.low, 1), True)
    return found


def _on_axis(loop: Loop, numerator: Polynomial, denominator: Polynomial) -> Quotients:
    """A function of the loop over the imaginary axis, which for a sampled one stands for the unit circle."""
    if loop.sample_time:
        return turned([[numerator]], denominator)
    return Quotients([[numerator]], denominator)


def _opened(loop: Loop, numerator: Polynomial, denominator: Polynomial) -> tuple[Polynomial, Polynomial]:
    """The open loop 1 / S - 1 on the axis, of its sensitivity."""
    sensitivity = _on_axis(loop, numerator, denominator)
    [[d]], own = sensitivity.numerators, sensitivity.denominator
    return add(own, d, -1), d


@checked
def proven_numbers(loops: Sequence[Loop], pid: Pid, written: Sequence[StateModel]) -> list[tuple[str, str]]:
    """The largest peaks, the range of the crossings and the least margins over all loops, and which are proven.

    The written models belong to the loops in turn.
    """
    peaks, margins = [], []
    for k, loop in enumerate(loops):
        functions = _functions(loop, pid, written[k % len(written)])
        peaks.append({name: _peak(loop, pid, functions, name) for name in HELD})
        margins.append(_margins(loop, functions, peaks[-1]["output_sensitivity"]))
    rows = []
    for name in HELD:
        highest = Enclosure(
            0.0, max(peak[name].high for peak in peaks), all(each[name].proven for each in peaks)
        )
        rows.append((f"peak of {SHOWN[name]} (dB)", str(highest.in_db())))
    for name, words in MARGINS.items():
        every = [margin[name] for margin in margins]
        low, high = min(each.low for each in every), max(each.high for each in every)
        text = f"at least {np.floor(low * 1e4) / 1e4:.4f}"
        if name == "crossing_hz":
            text = f"from {np.floor(low * 1e4) / 1e4:.4f} to {np.ceil(high * 1e4) / 1e4:.4f}"
        elif name == "gain_reduction":
            text = f"down to {np.ceil(high * 1e4) / 1e4:.4f}"
        rows.append((words, f"{text}, proven" if all(each.proven for each in every) else "not proven"))
    return rows


def _functions(loop: Loop, pid: Pid, written: StateModel | None) -> Functions:
    """Numerator and denominator of each function; S_I is left out where the written model does not hold the compensator.

    With P = p / q and the command (k_r r + k_y y + k_f f) / k the loop's own polynomial is q (k - k_f) - k_y p.
    """
    [[p]], q = in_z(loop.sampled_plant if loop.sample_time else loop.plant.state_space())
    [[o_uu, o_uy], [o_yu, o_yy]], o = in_z(loop.compensator)
    feedback = pid.state_space()
    [[c]], rest = in_z(tustin(feedback, loop.sample_time) if loop.sample_time else feedback)
    if written is None:
        k = multiply(rest, o)
        k_r, unit = multiply(c, o), 1
        k_y = add(multiply(rest, o_uy), multiply(c, add(o, o_yy, -1)), -1)
        k_f = add(multiply(rest, o_uu), multiply(c, o_yu))
    else:
        [[k_r, k_y, k_f]], k = in_z(written)
        rest, unit = _divided(k, o)
    free = add(k, k_f, -1)
    own = add(multiply(q, free), multiply(k_y, p), -1)
    found = {
        "output_sensitivity": (multiply(free, q), own),
        "true_tracking": (add(own, multiply(p, k_r), -1), own),
    }
    if rest is not None:
        inner = add(multiply(q, add(o, o_uu, -1)), multiply(o_uy, p), -1)
        found["input_sensitivity"] = (multiply(rest, inner), [unit * each for each in own])
    return found


def _divided(whole: Polynomial, part: Polynomial) -> tuple[Polynomial | None, int]:
    """Quotient of two polynomials times the whole number that makes it one of integers; None where something remains."""
    left, found = [Fraction(each) for each in whole], []
    for k in reversed(range(len(whole) - len(part) + 1)):
        factor = left[k + len(part) - 1] / part[-1]
        found.append(factor)
        for j, each in enumerate(part):
            left[k + j] -= factor * each
    unit = lcm(*(each.denominator for each in found))
    return (None if any(left) else [int(each * unit) for each in found[::-1]]), unit
