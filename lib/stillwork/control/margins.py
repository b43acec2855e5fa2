"""Margins of a loop that is given as a model: how far it is from instability, by gain, by phase, by delay and by both."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64

from stillwork.base.checks import InputError
from stillwork.base.validation import by_value, checked
from stillwork.lti.norms import hinf_norm, to_bilinear
from stillwork.lti.state_space import StateModel, constant

NEAR_AXIS = 1e-3  # of its size: how far a zero may lie from the imaginary axis to be looked at as a crossing
CROSSES = 1e-6  # how far a polished crossing may be off
AT_REST = 1e-13  # of the fastest pole: a pole below it is at rest
SLOWER = 1e-6  # of the slowest pole: a crossing below it is the rounding of one at rest
LEAST = 1e-9  # a gain that may change by more than a factor of 1e9 is not limited


@by_value
@dataclass(frozen=True)
class Margins:
    """Margins of one loop; each with the frequency (rad/s) where it is reached, NaN where nothing limits it.

    Parameters
    ----------
    gain, gain_reduction : float
        Factors: infinity and 0 where nothing limits the gain.
    phase : float
        rad.
    modulus : float
        Between 0 and 1 for a loop that falls off.
    delay : float
        s; 0 where the loop stays above one at the highest frequencies.
    gain_omega, gain_reduction_omega, phase_omega, modulus_omega, delay_omega : float
        rad/s.

    Notes
    -----
    The gain may grow by the factor `gain` and fall to the factor `gain_reduction`; the phase may turn by `phase`
    (rad) either way; `modulus` is the least distance to -1, the inverse of the sensitivity's peak; a delay of `delay`
    (s) makes the loop unstable.

    Examples
    --------
    >>> from control import tf
    >>> (found,) = control.margins(tf([1.0], [1.0, 3.0, 2.0, 0.0]))  # 1 / (s (s + 1) (s + 2))
    >>> round(found.gain, 6), round(found.gain_omega**2, 6)
    (6.0, 2.0)
    """

    gain: float
    gain_omega: float
    gain_reduction: float
    gain_reduction_omega: float
    phase: float
    phase_omega: float
    modulus: float
    modulus_omega: float
    delay: float
    delay_omega: float


@checked(infinite=True, missing=True)
def margins(loop: StateModel) -> list[Margins]:
    r"""Gain, phase, modulus and delay margins of a loop with negative feedback, one loop at a time.

    Crossings are zeros of :math:`1 - L(s)L(-s)` and of :math:`L(s) - L(-s)`, polished on the axis: no grid passes one
    over. A model in discrete time is looked at in :math:`(z - 1)/(z + 1)`.

    Parameters
    ----------
    loop : StateModel
        The open loop L, as many inputs as outputs; the loop is closed by u = -y.

    Returns
    -------
    list of Margins
        One for each channel, with the other channels closed.

    Raises
    ------
    InputError
        When the loop is not square, or unstable once it is closed: it has no margin.

    References
    ----------
    Astrom and Murray, Feedback Systems (2021), section 10.3.

    Examples
    --------
    >>> loop = lti.from_control(([[0.0, 1.0], [0.0, -1.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]]))  # 1 / (s (s + 1))
    >>> found = control.margins(loop)[0]
    >>> round(float(np.degrees(found.phase)), 2), round(found.phase_omega, 4), found.gain
    (51.83, 0.7862, inf)
    """
    outputs, inputs = loop.d.shape
    if outputs != inputs:
        raise InputError(f"loop has {inputs} inputs and {outputs} outputs; give as many of both")
    closed = loop.feedback()
    if not closed.is_stable:
        worst = closed.poles[np.argmax(np.abs(closed.poles) if loop.sample_time else closed.poles.real)]
        raise InputError(
            f"loop is unstable when it is closed (pole at {worst:.6g}); margins are those of a stable one"
        )
    return [_of_channel(loop, channel) for channel in range(inputs)]


def _of_channel(loop: StateModel, channel: int) -> Margins:
    others = [each for each in range(len(loop.d)) if each != channel]
    if others:  # closed around all channels but this one
        opened = np.diag([float(each in others) for each in range(len(loop.d))])
        loop = loop.feedback(constant(opened, loop.sample_time))
        loop = loop.select([channel], [channel])
    slow = to_bilinear(loop) if loop.sample_time else loop
    floor = _slowest(slow)
    real, unit = (
        places[places > SLOWER * floor] for places in (_crossings(slow, -1.0), _crossings(slow, 1.0))
    )

    def omega(places: np.ndarray) -> np.ndarray:
        return 2 * np.arctan(places) / loop.sample_time if loop.sample_time else places

    fast = np.pi / loop.sample_time if loop.sample_time else np.inf
    at_real = np.array([*omega(real), fast, 0.0])
    response = np.array([*_response(slow, real), slow.d[0, 0], *_static(slow)])
    at_real = at_real[: len(response)]
    negative = (response.real < -LEAST) & (
        np.abs(response) < 1 / LEAST
    )  # beyond these nothing limits the gain
    factors, at_real = -1 / response.real[negative], at_real[negative]
    angles = np.angle(-_response(slow, unit))
    delays, late = np.mod(angles, 2 * np.pi) / omega(unit), omega(unit)  # by how much a delay may turn it
    if not loop.sample_time and abs(slow.d[0, 0]) >= 1:  # a delay turns what is fast without end
        delays, late = np.append(delays, 0.0), np.append(late, np.inf)
    peak = hinf_norm(constant(np.eye(1), loop.sample_time) - loop.feedback())
    up, down = factors > 1 + 1e-12, factors < 1 - 1e-12
    return Margins(
        *_best(factors[up], at_real[up], np.inf, least=True),
        *_best(factors[down], at_real[down], 0.0, least=False),
        *_best(np.abs(angles), omega(unit), np.inf, least=True),
        *(1 / peak.magnitude, peak.omega),
        *_best(delays, late, np.inf, least=True),
    )


def _best(values: np.ndarray, omega: np.ndarray, without: float, *, least: bool) -> tuple[float, float]:
    if not len(values):
        return without, np.nan
    place = int(np.argmin(values) if least else np.argmax(values))
    return float(values[place]), float(omega[place])


def _response(model: StateModel, omega: np.ndarray) -> Complex128[np.ndarray, " frequencies"]:
    return model.frequency_response(omega)[0, 0] if len(omega) else np.zeros(0, complex)


def _slowest(model: StateModel) -> float:
    """The size of the slowest pole that is not at rest."""
    sizes = np.abs(model.poles)
    moving = sizes[sizes > AT_REST * sizes.max(initial=0.0)]
    return float(moving.min(initial=np.inf)) if len(moving) else 0.0


def _static(model: StateModel) -> list[complex]:
    """The response at rest, where no pole is there."""
    sizes = np.abs(model.poles)
    if len(sizes) and sizes.min() <= AT_REST * sizes.max():
        return []
    return [complex(_response(model, np.zeros(1))[0])]


def _crossings(model: StateModel, kind: float) -> Float64[np.ndarray, " crossings"]:
    """Positive frequencies where the response has magnitude one (`kind` 1), or is real (`kind` -1)."""
    mirrored = StateModel(-model.a, model.b, -model.c, model.d)
    seen = constant(np.eye(1)) - model * mirrored if kind > 0 else model - mirrored
    zeros = seen.zeros
    places = np.unique(np.abs(zeros[np.abs(zeros.real) <= NEAR_AXIS * np.abs(zeros)]))
    places = places[(places > 0) & np.isfinite(places)]

    def off(omega: np.ndarray) -> np.ndarray:
        response = _response(model, omega)
        return np.log(np.abs(response)) if kind > 0 else response.imag / np.abs(response)

    for _ in range(4):  # the secant of a frequency a little aside
        if not len(places):
            return places
        step = 1e-6 * places
        slope = (off(places + step) - off(places - step)) / (2 * step)
        change = -off(places) / np.where(slope == 0, np.inf, slope)
        places, change = places[np.isfinite(change)], change[np.isfinite(change)]  # none at a pole
        places = places + np.clip(change, -1e-2 * places, 1e-2 * places)
    return places[np.abs(off(places)) < CROSSES]
