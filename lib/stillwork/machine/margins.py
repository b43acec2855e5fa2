"""Peaks, first crossing and stability margins of a loop, from its response between the points of a grid."""

from collections.abc import Callable, Sequence
from math import inf, pi

import numpy as np
from scipy.optimize import elementwise

from stillwork.base.validation import checked
from stillwork.control.bandwidth import Loop, around_poles
from stillwork.control.machine_loops import HELD, SHOWN
from stillwork.control.pid import Pid
from stillwork.lti.state_space import StateModel, interconnect, response_between

MARGINS = {
    "crossing_hz": "first crossing of 0 dB (Hz)",
    "gain_reduction": "stable with its gain times",
    "gain_margin": "gain margin (factor)",
    "phase_margin": "phase margin (degrees)",
    "modulus_margin": "modulus margin",
}
BESIDE = 0.3  # an extreme value of a logarithm or a sine so near to zero may pass it between two points
ACCURACY = 1e-9  # relative, of what is printed
FINEST = {"xrtol": 1e-13, "frtol": 1e-16}  # of an extreme value

OpenLoops = Callable[
    [np.ndarray], tuple[np.ndarray, np.ndarray]
]  # what the controller sees, and the plant's output


@checked(infinite=True)
def loop_margins(loop: Loop, pid: Pid, written: StateModel | None = None) -> dict[str, float]:
    """Peaks of both sensitivities, first crossing and stability margins of a loop.

    Extreme values and crossings are bracketed on the loop's grid and around its closed-loop poles, then found on the
    response itself, to a billionth of a value that does not graze its bound.

    Parameters
    ----------
    loop : Loop
        Not one with a measured response.
    pid : Pid
        Controller of this loop.
    written : StateModel, optional
        The same controller and the compensator in one model, from (r, y, f) to the command, as it is written to a
        file; by default they are composed from their responses.

    Returns
    -------
    dict of str to float
        ``input_sensitivity`` and ``output_sensitivity``: largest magnitudes, infinite of an unstable loop.
        ``crossing_hz``: where the loop gain at the controller first falls through 0 dB, infinite if it never does.
        For the loop at the plant's output: ``gain_reduction`` and ``gain_margin``, the factors below and above 1 at
        which it becomes unstable (0 and infinite where none does), ``phase_margin`` (degrees) and
        ``modulus_margin``, its smallest distance from -1. The margins of an unstable loop are 0 (its gain may not be
        reduced: 1).

    Raises
    ------
    InputError
        When an argument is not of its kind.

    References
    ----------
    Skogestad and Postlethwaite, Multivariable Feedback Control (2005), section 2.4.

    Examples
    --------
    >>> mass = lti.ModalModel([0.0], [0.0], [[1.0]], [[0.1]], [[0.0]])  # 10 kg
    >>> loop, pid = control.make_loop(mass, sample_time=1e-4, delay=1), control.PidFamily(10.0)(50.0)
    >>> found = machine.loop_margins(loop, pid)
    >>> {name: round(found[name], 3) for name in ("crossing_hz", "gain_margin", "phase_margin", "modulus_margin")}
    {'crossing_hz': 52.49, 'gain_margin': 2.84, 'phase_margin': 34.334, 'modulus_margin': 0.497}
    """
    omega = np.union1d(loop.omega, around_poles(loop, loop.poles(pid)))
    if loop.sample_time:
        omega = np.union1d(omega, (1 - 1e-9) * pi / loop.sample_time)  # the loop is real at half the rate

    def opened(w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = loop.at(pid, w)
        return found.loop, found.output_loop

    def opened_as_written(w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        (_, k_y, k_f), plant = response_between(written, w)[0], loop.plant_at(w)
        (o_uu, o_uy), _ = response_between(loop.compensator, w)
        return (1 - k_f - k_y * plant) / (1 - o_uu - o_uy * plant) - 1, -k_y * plant / (1 - k_f)

    if written is None:
        return _margins(opened, omega, loop.is_stable(pid), loop.sample_time)
    return _margins(opened_as_written, omega, _is_stable(loop, written), loop.sample_time)


def _is_stable(loop: Loop, written: StateModel) -> bool:
    plant = loop.sampled_plant if loop.sample_time else loop.plant.state_space()
    feedback = np.array([[0.0, 1.0], [0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])  # (y, command) to (force, r, y, f)
    return interconnect([plant, written], feedback, np.eye(4, 1), np.eye(1, 2)).is_stable


def _margins(opened: OpenLoops, omega: np.ndarray, is_stable: bool, sample_time: float) -> dict[str, float]:
    def size(which: int) -> Callable[[np.ndarray], np.ndarray]:
        return lambda w: np.log(np.abs(opened(w)[which]))

    def distance(which: int) -> Callable[[np.ndarray], np.ndarray]:
        return lambda w: np.abs(1 + opened(w)[which])

    def sine(w: np.ndarray) -> np.ndarray:
        return np.sin(np.angle(opened(w)[1]))

    crossings, falls = _crossings(size(0), omega)
    found = {"crossing_hz": float(min(crossings[falls] / (2 * pi), default=inf))}
    if not is_stable:
        lost = dict.fromkeys(HELD, inf) | {"gain_reduction": 1.0}
        return lost | found | dict.fromkeys(("gain_margin", "phase_margin", "modulus_margin"), 0.0)
    nearest = [_least(distance(which), omega) for which in range(2)]
    found |= {name: 1 / distance for name, distance in zip(HELD, nearest, strict=True)}
    real = _crossings(sine, omega)[0]
    if sample_time:
        real = np.append(real, omega[-1])
    there = opened(real)[1] if len(real) else np.zeros(0, complex)
    factors = -1 / there.real[(there.real < 0) & (np.abs(there.imag) < 1e-6 * np.abs(there.real))]  # no pole
    gain_one = _crossings(size(1), omega)[0]
    angles = np.abs(np.angle(-opened(gain_one)[1])) if len(gain_one) else np.zeros(0)
    return found | {
        "gain_reduction": float(max(factors[factors < 1], default=0.0)),
        "gain_margin": float(min(factors[factors > 1], default=inf)),
        "phase_margin": float(np.degrees(min(angles, default=pi))),
        "modulus_margin": nearest[1],
    }


def _crossings(
    function: Callable[[np.ndarray], np.ndarray], omega: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies where a real function passes zero, in order, and whether it falls there."""
    values = function(omega)
    omega, values = omega[np.isfinite(values)], values[np.isfinite(values)]
    for sign in (1.0, -1.0):  # an extreme value on the other side of zero
        inner = sign * values
        lowest = (
            (inner[1:-1] < inner[:-2])
            & (inner[1:-1] <= inner[2:])
            & (0 < inner[1:-1])
            & (inner[1:-1] < BESIDE)
        )
        if len(k := 1 + np.flatnonzero(lowest)):
            ends = omega[k - 1], omega[k], omega[k + 1]
            beyond = elementwise.find_minimum(lambda w, s=sign: s * function(w), ends, tolerances=FINEST)
            omega, first = np.unique(np.append(omega, beyond.x), return_index=True)
            values = np.append(values, sign * beyond.f_x)[first]
    k = np.flatnonzero((values[1:] < 0) != (values[:-1] < 0))
    if not len(k):
        return np.zeros(0), np.zeros(0, bool)
    return elementwise.find_root(function, (omega[k], omega[k + 1])).x, values[k] >= 0


def _least(function: Callable[[np.ndarray], np.ndarray], omega: np.ndarray) -> float:
    """The smallest value of a positive function, on the grid and between its points."""
    values = function(omega)
    omega, values = omega[np.isfinite(values)], values[np.isfinite(values)]
    lowest = (values[1:-1] < values[:-2]) & (values[1:-1] <= values[2:]) & (values[1:-1] < 1.1 * values.min())
    if not len(k := 1 + np.flatnonzero(lowest)):
        return float(values.min())
    ends = omega[k - 1], omega[k], omega[k + 1]
    between = elementwise.find_minimum(function, ends, tolerances=FINEST)
    return float(min(values.min(), between.f_x.min()))


@checked
def computed_numbers(loops: Sequence[Loop], pid: Pid, written: Sequence[StateModel]) -> list[tuple[str, str]]:
    """Rows with the largest peaks, the range of the crossings and the least margins over all loops.

    The written models belong to the loops in turn.
    """
    found = [loop_margins(loop, pid, written[k % len(written)]) for k, loop in enumerate(loops)]

    def least(name: str) -> str:
        return f"{np.floor(1e4 * min(each[name] for each in found) * (1 + ACCURACY)) / 1e4:.4f}"

    def largest(name: str) -> str:
        return f"{np.ceil(1e4 * max(each[name] for each in found) * (1 - ACCURACY)) / 1e4:.4f}"

    for each in found:
        each |= {f"{name} (dB)": 20 * np.log10(each[name]) for name in HELD}
    words = {
        **{f"peak of {SHOWN[name]} (dB)": f"at most {largest(f'{name} (dB)')}" for name in HELD},
        MARGINS["crossing_hz"]: f"from {least('crossing_hz')} to {largest('crossing_hz')}",
        MARGINS["gain_reduction"]: f"down to {largest('gain_reduction')}",
        **{
            MARGINS[name]: f"at least {least(name)}"
            for name in ("gain_margin", "phase_margin", "modulus_margin")
        },
    }
    return [
        (name, f"{text}, computed to {ACCURACY:.0e}".replace("e-09", "e-9")) for name, text in words.items()
    ]
