"""Proven peaks of a loop's functions, from the very numbers of plant, compensator and controller."""

from collections.abc import Sequence
from fractions import Fraction
from math import inf, lcm

from stillwork.base.checks import counted
from stillwork.base.front_door import checked
from stillwork.control.bandwidth import FUNCTIONS, Loop
from stillwork.control.machine_loops import SHOWN
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
    turned,
)
from stillwork.lti.state_space import StateModel


@checked(infinite=True)
def enclose_peaks(loop: Loop, pid: Pid, written: StateModel | None = None) -> dict[str, Enclosure]:
    """Bounds of the peaks of a loop, each proven together with the stability of the whole loop where it can be.

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
    found = dict.fromkeys(FUNCTIONS, Enclosure(0.0, inf, False))
    for name, (numerator, denominator) in _functions(loop, pid, written).items():
        matrix = (
            turned([[numerator]], denominator) if loop.sample_time else Quotients([[numerator]], denominator)
        )
        found[name] = enclose_quotients(matrix, loop.peak(pid, name).magnitude)
    return found


@checked
def proven_peaks(loops: Sequence[Loop], pid: Pid, written: Sequence[StateModel]) -> str:
    """One line: the largest peaks of all loops in dB, and which are proven; the written models serve them in turn."""
    found = [enclose_peaks(loop, pid, written[k % len(written)]) for k, loop in enumerate(loops)]
    words = []
    for name in FUNCTIONS:
        peaks = [each[name] for each in found]
        highest = max(each.high for each in peaks)
        words.append(f"{SHOWN[name]} {Enclosure(0.0, highest, all(each.proven for each in peaks)).in_db()}")
    return f"peaks in dB of the written controller over {counted(len(loops), 'loop')}: {'; '.join(words)}"


def _functions(loop: Loop, pid: Pid, written: StateModel | None) -> dict[str, tuple[Polynomial, Polynomial]]:
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
