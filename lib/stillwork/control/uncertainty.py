"""Bounded uncertainty of a machine: the box of its parameters, the worst point in it, and the loop there."""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from stillwork.base.bounds import NonNegative, within
from stillwork.base.checks import Converted, InputError, require_array, require_choice, require_number
from stillwork.base.kernels import kernel
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.control.bandwidth import Loop, PeakConstraint, loop_grid, make_loop
from stillwork.control.pid import Pid
from stillwork.identification.machine import Machine
from stillwork.lti.delays import split_delay
from stillwork.lti.discretisation import sampled_modes
from stillwork.lti.modal import ModalModel
from stillwork.lti.peaks import resonance_grid

Share = Annotated[float, within(at_least=0.0, below=1.0)]
NAMES = ("frequency", "residue", "damping", "gain", "mass", "delay", "friction")
ABSOLUTE = {"delay": "s", "friction": "1/s"}  # the others are shares
NORMAL = 1.96  # standard deviations either side of a number, 95 %
WIDEST = 0.9  # share by which a number may be lower at most
STEPS = np.linspace(-1, 1, 25)  # to places of a mode beside its resonance, dense at its width, that are tried
TURNS = np.linspace(-1, 1, 5)  # of the delay's interval, that are tried
DRAGS = 17  # likewise of the friction's
STARTS, SWEEPS = 4, 2
GRID = {"points": 800, "around": 60}
EXCESS = 1.0005  # times a limit, 0.004 dB: results keep it within 0.01 dB
BETWEEN = 0.995  # of a peak that its grid shows at least: 0.04 dB
MOST_DAMPED = 0.999
SLIGHT = 1e-3  # share of a damping ratio that changes no peak worth the while


@by_value
@dataclass(frozen=True)
class Uncertainty:
    """Deviation of a machine from its model: half the widths of a box around the model's parameters.

    Parameters
    ----------
    frequency, residue, damping : array_like, shape (modes,)
        Share of each mode's frequency, of its part of the response and of its damping ratio; one number for all
        flexible modes. The rigid body has none.
    gain : float
        Share of the whole response: the motor constant, or the sensor's scale.
    mass : float
        Share of the rigid body's mass, without the flexible part.
    delay : float
        s.
    friction : float
        1/s, of the rigid body's viscous friction over its mass, `ModalModel.drag`, which stays at least 0.

    Raises
    ------
    InputError
        When a share is negative or not below 1, or the delay or the friction negative.

    Examples
    --------
    >>> box = control.Uncertainty(frequency=0.05, gain=0.1)
    >>> box.is_empty, control.Uncertainty().is_empty
    (False, True)
    """

    frequency: Converted = 0.0
    residue: Converted = 0.0
    damping: Converted = 0.0
    gain: Share = 0.0
    mass: Share = 0.0
    delay: NonNegative = 0.0
    friction: NonNegative = 0.0

    @checked
    def __post_init__(self):
        check_fields(self)
        for name in NAMES[:3]:
            shares = require_array(name, getattr(self, name))
            if shares.ndim > 1 or not np.all((shares >= 0) & (shares < 1)):
                raise InputError(f"{name} must hold shares of at least 0 and below 1; 0 for what is known")
            object.__setattr__(self, name, shares)

    def _of_modes(self, plant: ModalModel) -> "Uncertainty":
        """The same with a number for each mode of a plant, 0 for its first, the rigid body or the suspension."""
        spread: dict[str, Any] = {}
        for name in NAMES[:3]:
            value = getattr(self, name)
            if value.ndim and value.shape != plant.frequencies.shape:
                raise InputError(f"{name} holds {value.size} shares; give one, or one per mode of the plant")
            shares = np.broadcast_to(value, plant.frequencies.shape).copy()
            shares[0] = 0.0
            spread[name] = shares
        if self.friction and not plant.rigid_modes:
            raise InputError("friction is that of a machine that moves freely; on springs leave it out")
        return replace(self, **spread)

    @property
    def is_empty(self) -> bool:
        """Whether everything is known."""
        return not any(np.any(getattr(self, name)) for name in NAMES)


class Perturbation(NamedTuple):
    """A point in the box: factors on the modes' parameters and on the whole response, and additions to delay and friction."""

    frequencies: Float64[np.ndarray, " modes"]
    residues: Float64[np.ndarray, " modes"]
    damping: Float64[np.ndarray, " modes"]
    gain: float = 1.0
    delay: float = 0.0  # s
    friction: float = 0.0  # 1/s


@checked
def place_at(box: Uncertainty, signs: Float64[np.ndarray, " numbers"]) -> Perturbation:
    """The place of signs from -1 to 1: frequency, residue and damping of each mode; gain, mass, delay and friction."""
    frequency, residue, damping = signs[:-4].reshape(3, -1)
    gain, mass, delay, friction = map(float, signs[-4:])
    residues = 1 + box.residue * residue
    residues[0] = 1 / (1 + box.mass * mass)
    return Perturbation(
        1 + box.frequency * frequency,
        residues,
        1 + box.damping * damping,
        1 + box.gain * gain,
        box.delay * delay,
        box.friction * friction,
    )


@checked
def require_shares(asked: Mapping[str, float]) -> None:
    """Refuse names other than `NAMES` and invalid shares, delays or frictions."""
    for name, value in asked.items():
        require_choice("uncertainty", name, NAMES)
        below = {} if name in ABSOLUTE else {"below": 1.0}
        require_number(f"uncertainty: {name}", value, at_least=0.0, **below)


@checked
def uncertainty_of(machine: Machine, asked: Mapping[str, float]) -> Uncertainty:
    """The stated shares, by `NAMES`, plus the fit's 95 % intervals: a machine changes after it was measured.

    If nothing is stated there is no uncertainty. The interval of the friction enters where ``friction`` is named.
    """
    require_shares(asked)
    model, fit = machine.sensors[0], machine.fit
    found: dict = dict(asked)
    if fit is not None and asked:
        flexible = slice(1 - model.rigid_modes, None)  # a suspension is fitted like a mode
        known = {
            "frequency": fit.deviation[flexible] / model.frequencies[1:],
            "damping": fit.damping_deviation[flexible] / model.damping[1:],
            "residue": fit.residue_deviation[flexible],
        }
        for name, spread in known.items():
            found[name] = np.append(0.0, np.clip(asked.get(name, 0.0) + NORMAL * spread, 0.0, WIDEST))
        found["mass"] = min(asked.get("mass", 0.0) + NORMAL * fit.mass_deviation, WIDEST)
        found["delay"] = asked.get("delay", 0.0) + NORMAL * fit.delay_deviation
        if "friction" in asked:
            found["friction"] = asked["friction"] + NORMAL * fit.drag_deviation
    return Uncertainty(**found)._of_modes(model)


@checked
def perturbed_plant(plant: ModalModel, place: Perturbation) -> ModalModel:
    """The plant at a place of the box."""
    rows = [
        require_array(name, values, shape=plant.frequencies.shape)
        for name, values in zip(Perturbation._fields, place[:3], strict=False)
    ]
    if not min(row.min() for row in rows) > 0 or not place.gain > 0:
        raise InputError("place must hold factors above 0")
    frequencies, residues, damping = rows
    return replace(
        plant,
        damping=np.minimum(plant.damping * damping, MOST_DAMPED),
        output_shapes=plant.output_shapes * residues * place.gain,
        feedthrough=plant.feedthrough * place.gain,
        drag=max(plant.drag + place.friction, 0.0),
    ).moved(frequencies * plant.frequencies)


@checked
def perturbed_loop(loop: Loop, place: Perturbation) -> Loop:
    """The same observer and sample time on a plant at a point of the box; two of its frequencies may swap."""
    plant = perturbed_plant(loop.plant, place)
    delay = loop.delay
    if loop.sample_time:
        delay = max(loop.delay + place.delay / loop.sample_time, 0.0)
    return make_loop(plant, loop.compensator, sample_time=loop.sample_time, delay=delay)


@checked
def perturbed_loops(loops: Sequence[Loop], places: Sequence[Perturbation]) -> tuple[Loop, ...]:
    """All loops at the first place, then at the next ones."""
    return tuple(perturbed_loop(loop, place) for place in places for loop in loops)


@checked
def corners(uncertainty: Uncertainty) -> list[Perturbation]:
    """Two initial points: all frequencies low and the gain high, and all of both high; none without a box."""
    if uncertainty.is_empty:
        return []
    ones = np.ones_like(uncertainty.frequency)
    gain = 1 + uncertainty.gain
    return [
        Perturbation(1 + sign * uncertainty.frequency, ones, 1 - uncertainty.damping, gain, uncertainty.delay)
        for sign in (-1, 1)
    ]


@checked
def make_box(loop: Loop, uncertainty: Uncertainty, fine: bool = True) -> "Box":
    """The box of a loop's plant at each frequency; `fine`: also on the loop's own grid."""
    plant, sample_time = loop.plant, loop.sample_time
    uncertainty = uncertainty._of_modes(plant)
    ends = float(loop.omega[0]), min(loop.omega[-1], 0.998 * np.pi / sample_time if sample_time else np.inf)
    omega = _grid(plant, uncertainty, sample_time, *ends)
    if fine:
        omega = np.unique(np.concatenate([omega, loop.omega]))
    asked = plant, uncertainty, sample_time, loop.delay
    known = next((box for key, box in tuple(_recent) if key == asked), None)
    if known is None:
        # What each observer's grid has beside that of the plant is computed for itself.
        own = loop_grid(plant, None, sample_time=sample_time)
        known = _box_on(np.union1d(_grid(plant, uncertainty, sample_time, *ends), own), *asked)
        _recent.append((asked, known))
    return _moved_to(omega, known, asked)


# The uses of an observer share a plant and its box: what was computed of the last few.
_recent: deque[tuple[tuple, "Box"]] = deque(maxlen=4)


def _moved_to(omega: np.ndarray, known: "Box", asked: tuple) -> "Box":
    """A box on another grid, of which only the frequencies that its own lacks are computed.

    The parts are not copied: of many modes they are hundreds of megabytes.
    """
    there = np.isin(omega, known.omega)
    rows = np.searchsorted(known.omega, omega)
    rows[~there] = -1 - np.arange(np.sum(~there))
    rest = ("parts", "places", "fixed", "middles", "radii")
    none = known._replace(**{name: getattr(known, name)[:0] for name in rest})
    own = none if there.all() else _box_on(omega[~there], *asked)
    joined: dict[str, Any] = {"omega": omega, "rows": rows, "own_parts": own.parts, "own_places": own.places}
    for name in rest[2:]:
        joined[name] = np.empty(len(omega), getattr(known, name).dtype)
        joined[name][there], joined[name][~there] = getattr(known, name)[rows[there]], getattr(own, name)
    return known._replace(**joined)


def _box_on(
    omega: np.ndarray, plant: ModalModel, uncertainty: Uncertainty, sample_time: float, delay: float
) -> "Box":
    """The box on a grid."""
    whole, late = split_delay(delay)
    turn = np.exp(-1j * omega * sample_time * whole)
    gains = plant.output_shapes[0] * plant.input_shapes[:, 0]
    count = 3 + len(STEPS)
    many = 3 if np.any(uncertainty.damping > SLIGHT) else 1
    parts = np.zeros((len(omega), len(gains), many * count), complex)
    places, ratios = np.zeros(parts.shape), np.ones(parts.shape[1:])
    drags = _drags(plant.drag, uncertainty.friction)
    sizes = np.ones(len(gains), int)
    for k, (w, z, share) in enumerate(
        zip(plant.frequencies, plant.damping, uncertainty.frequency, strict=True)
    ):
        own = (
            np.array([0.0])
            if uncertainty.damping[k] <= SLIGHT
            else np.array([0.0, -1, 1]) * uncertainty.damping[k]
        )
        tried = _places(omega, w, z, share, sample_time) if share else np.full((1, len(omega)), w)
        if w == 0:
            sizes[k] = len(drags)
            for j, drag in enumerate(drags):
                response = _unit(omega, tried, z, sample_time, late, drag)
                parts[:, k, j] = gains[k] * response[0] * turn
            continue
        sizes[k] = len(own) * len(tried)
        for j, more in enumerate(own):
            columns = slice(j * len(tried), (j + 1) * len(tried))
            ratio = min(z * (1 + more), MOST_DAMPED)
            parts[:, k, columns] = (gains[k] * _unit(omega, tried, ratio, sample_time, late) * turn).T
            places[:, k, columns] = tried.T
            ratios[k, columns] = 1 + more
    fixed = plant.feedthrough[0, 0] * turn
    if sample_time:
        fixed = fixed * np.exp(-1j * omega * sample_time)  # it shows the force of the sample before
    low, high = 1 - uncertainty.residue, 1 + uncertainty.residue
    low[0], high[0] = 1 / (1 + uncertainty.mass), 1 / (1 - uncertainty.mass)
    delays = uncertainty.delay * TURNS if uncertainty.delay and sample_time else np.zeros(1)
    # A delay of less than nothing there is not.
    delays = np.maximum(delays, -delay * sample_time)
    middle = len(delays) // 2
    delays = np.append(delays[middle], np.delete(delays, middle))
    late_by = np.exp(-1j * omega[:, None] * delays)
    gain = uncertainty.gain
    discs = _discs(parts, sizes, fixed, low, high, 1 - gain, 1 + gain, late_by)
    rows = np.arange(len(omega))
    whole = omega, rows, parts, places, parts[:0], places[:0], sizes, ratios, fixed
    return Box(*whole, low, high, gain, delays, drags, *discs)


def _drags(drag: float, spread: float) -> np.ndarray:
    """Frictions that are tried, 1/s: the lowest, the highest, that of the plant, and between."""
    if not spread:
        return np.array([drag])
    low, high = max(drag - spread, 0.0), drag + spread
    return np.array([low, high, drag, *np.linspace(low, high, DRAGS + 2)[1:-1]])


def _grid(plant, uncertainty, sample_time, low, high) -> np.ndarray:
    """Dense at each mode and at both ends of its interval, as it is seen, and in between."""
    w, z, share = plant.frequencies, plant.damping, uncertainty.frequency
    ends = np.concatenate([w * (1 - share), w, w * (1 + share)])
    between = (w * (1 + share * np.linspace(-1.02, 1.02, 121)[:, None])).ravel()
    if sample_time:
        ends, between = (_folded(each, sample_time) for each in (ends, between))
    upper = ends * (-np.tile(z, 3) + 1j)
    grid = resonance_grid(upper[ends > 0], low / (2 * np.pi), high / (2 * np.pi), **GRID)
    between = between[(between > low) & (between < high)]
    return np.unique(np.concatenate([grid, between]))


def _folded(omega, sample_time):
    """Where a sampled response shows a frequency."""
    rate = 2 * np.pi / sample_time
    return np.abs(omega - rate * np.round(omega / rate))


def _places(omega, w, z, share, sample_time) -> np.ndarray:
    """Frequencies of a mode that are tried at each frequency: lowest, highest, found, beside a line."""
    low, high = w * (1 - share), w * (1 + share)
    turns = np.round(w * sample_time / (2 * np.pi))
    folded = 2 * np.pi * turns / sample_time if sample_time else 0.0
    seen = np.abs(folded + (-1 if w < folded else 1) * omega)
    width = max(z, 1e-7)
    reach = np.arcsinh(2 * share / width)
    beside = seen * (1 + width * np.sinh(reach * STEPS[:, None]))
    ends = np.broadcast_to(np.array([[low], [high], [w]]), (3, len(omega)))
    return np.concatenate([ends, np.clip(beside, low, high)])


def _unit(omega, frequencies, ratio, sample_time, late, drag=0.0) -> np.ndarray:
    """Responses of modes of mass 1 at places (places, frequencies), each element with a frequency of its own."""
    if not sample_time:
        loss = np.where(frequencies > 0, 2 * ratio * frequencies, drag)
        return 1 / (frequencies**2 - omega**2 + 1j * loss * omega)
    spread = np.broadcast_to(omega, frequencies.shape)
    if len(frequencies) == 1:  # one place, the same at every line
        return sampled_modes(frequencies[:, 0], np.array([ratio]), sample_time, omega, late, drag)
    flat = frequencies.ravel()
    found = sampled_modes(flat, np.full(flat.shape, ratio), sample_time, spread.reshape(-1, 1), late, drag)
    return found.reshape(frequencies.shape)


class Box(NamedTuple):
    """The parts of a plant on a grid at all points of the box that are tried."""

    omega: np.ndarray  # (frequencies,), rad/s
    rows: np.ndarray  # (frequencies,), of each in `parts`; below 0 in `own_parts`: -1 is the first
    parts: np.ndarray  # (rows, modes, places), m/N
    places: np.ndarray  # (rows, modes, places), rad/s
    own_parts: np.ndarray  # likewise, of the frequencies that another grid lacks
    own_places: np.ndarray
    sizes: np.ndarray  # (modes,), how many of the places there are
    ratios: np.ndarray  # (modes, places), factors on the damping
    fixed: np.ndarray  # (frequencies,), m/N, of the compliance
    low: np.ndarray  # (modes,), least factor on each part ...
    high: np.ndarray  # ... and largest
    gain: float
    delays: np.ndarray  # s, the middle first
    drags: np.ndarray  # 1/s, by the places of a rigid body
    middles: np.ndarray  # (frequencies,), m/N: centres of discs that the plant does not leave ...
    radii: np.ndarray  # ... and their radii

    @checked(infinite=True)
    def worst(
        self,
        loop: Loop,
        controller: Pid,
        constraints: Sequence[PeakConstraint],
        *,
        every: bool = False,
        starts: int = STARTS,
        compensator: np.ndarray | None = None,
        first: bool = False,
        exact: bool = True,
    ) -> list[tuple[float, Perturbation]]:
        """Places where a constraint is exceeded, the worst of each, with the magnitude there.

        `every`: in any case; `first`: not the worst but the first that is found; `exact`: judged by its peak itself,
        which may lie between the lines of the grid.
        """
        if compensator is None:
            compensator = loop.compensator.frequency_response(self.omega)
        if np.shape(compensator) != (2, 2, len(self.omega)):
            raise InputError(
                f"compensator has shape {np.shape(compensator)}; give its response, {(2, 2, len(self.omega))}"
            )
        (o_uu, o_uy), (o_yu, o_yy) = compensator
        c = loop._controlled(controller, self.omega)
        turn = 1 - c * o_yu - o_uu
        slope = c * (1 - o_yy) - o_uy
        zero = np.zeros_like(turn)
        # What numerators have beside the denominator turn + slope P: with a slow controller next to nothing.
        beside = {
            "input_sensitivity": (c * o_yu, c * (o_yy - 1)),
            "output_sensitivity": (zero, -slope),
            "true_tracking": (zero, -c),
        }
        found = []
        late = np.exp(-1j * self.omega[:, None] * self.delays)
        for constraint in constraints:
            ratio = np.stack([*beside[constraint.function], turn, slope], axis=1)
            limit = 0.0 if every else EXCESS * constraint.limit
            least = BETWEEN * limit if exact else limit
            size, row, taken, parts, gain, delay = _worst(self, ratio, late, least**2, starts, first)
            if row < 0:
                continue
            frequencies = loop.plant.frequencies
            modes = np.arange(len(taken))
            row = self.rows[row]
            there = self.places[row, modes, taken] if row >= 0 else self.own_places[-1 - row, modes, taken]
            moved = np.divide(there, frequencies, out=np.ones(len(there)), where=frequencies > 0)
            friction = float(self.drags[taken[0]] - loop.plant.drag) if len(self.drags) > 1 else 0.0
            place = Perturbation(
                moved, parts, self.ratios[modes, taken], gain, float(self.delays[delay]), friction
            )
            peak = math.sqrt(size)
            if exact:
                peak = max(peak, perturbed_loop(loop, place).peak(controller, constraint.function).magnitude)
            if peak > limit:
                found.append((peak, place))
        return found


@kernel
def _discs(parts, sizes, fixed, low, high, least_gain, most_gain, late):
    """Centre and radius, at each frequency, of a disc that holds what the plant may be: by the triangle inequality."""
    rows, modes = parts.shape[0], parts.shape[1]
    middles, radii = np.zeros(rows, np.complex128), np.zeros(rows)
    scale = max(most_gain - 1, 1 - least_gain)
    for row in range(rows):
        middle, radius = fixed[row], 0.0
        for k in range(modes):
            nominal = 2 if sizes[k] > 2 and sizes[k] != 3 else 0
            own = parts[row, k, nominal]
            middle += own
            far, size = 0.0, 0.0
            for j in range(sizes[k]):
                far = max(far, abs(parts[row, k, j] - own))
                size = max(size, abs(parts[row, k, j]))
            radius += far + max(high[k] - 1, 1 - low[k]) * size
        turned = 0.0
        for j in range(late.shape[1]):
            turned = max(turned, abs(late[row, j] - 1))
        radius += (scale + turned * (1 + scale)) * (abs(middle) + radius)
        middles[row], radii[row] = middle, radius
    return middles, radii


@kernel
def _worst(box, ratio, late, least, starts, first):
    """Largest square of |1 + (a + bP)/(c + dP)| above `least`, P anywhere in the box: its row and what P is made of."""
    sizes, fixed, low, high = box.sizes, box.fixed, box.low, box.high
    least_gain, most_gain = 1 - box.gain, 1 + box.gain
    rows, modes = len(box.rows), len(sizes)
    best, best_row, best_gain, best_late = least, -1, 1.0, 0
    best_taken, best_parts = np.zeros(modes, np.int64), np.ones(modes)
    taken, factors = np.zeros(modes, np.int64), np.ones(modes)
    for row in range(rows):
        a, b, c, d = ratio[row, 0], ratio[row, 1], ratio[row, 2], ratio[row, 3]
        # No place can exceed what is sought where even the triangle inequality does not.
        middle, radius = box.middles[row], box.radii[row]
        below = abs(c + d * middle) - abs(d) * radius
        if below > 0 and (abs(a + c + (b + d) * middle) + abs(b + d) * radius) ** 2 <= best * below**2:
            continue
        at = box.rows[row]
        parts = box.parts[at] if at >= 0 else box.own_parts[-1 - at]
        for start in range(starts):
            gain, when = 1.0, 0
            whole = fixed[row]
            for k in range(modes):
                if start < 3:
                    taken[k] = start if start < sizes[k] else 0
                else:
                    taken[k] = ((row + 1) * 7919 * (k + 1) + start * 104729) % sizes[k]
                factors[k] = 1.0
                whole += parts[k, taken[k]]
            for _ in range(SWEEPS):
                for k in range(modes):
                    others = whole - factors[k] * parts[k, taken[k]]
                    turn = gain * late[row, when]
                    beside, base = a + b * turn * others, c + d * turn * others
                    b_turned, d_turned = b * turn, d * turn
                    if sizes[k] > 1:
                        most, least_under = -1.0, 1.0
                        b_own, d_own = factors[k] * b_turned, factors[k] * d_turned
                        for j in range(sizes[k]):
                            under = base + d_own * parts[k, j]
                            over = under + (beside + b_own * parts[k, j])
                            above, size = over.real**2 + over.imag**2, under.real**2 + under.imag**2
                            if above * least_under > most * size:
                                most, least_under, taken[k] = above, size, j
                    own = parts[k, taken[k]]
                    if high[k] > low[k]:
                        factors[k] = largest_along(
                            beside, b_turned * own, base, d_turned * own, low[k], high[k]
                        )
                    whole = others + factors[k] * own
                most = -1.0
                for j in range(late.shape[1]):
                    p = gain * late[row, j] * whole
                    under = c + d * p
                    over = under + (a + b * p)
                    size = (over.real**2 + over.imag**2) / (under.real**2 + under.imag**2)
                    if size > most:
                        most, when = size, j
                if most_gain > least_gain:
                    p = late[row, when] * whole
                    gain = largest_along(a, b * p, c, d * p, least_gain, most_gain)
            p = gain * late[row, when] * whole
            under = c + d * p
            over = under + (a + b * p)
            size = (over.real**2 + over.imag**2) / (under.real**2 + under.imag**2)
            if size > best:
                best, best_row, best_gain, best_late = size, row, gain, when
                best_taken[:] = taken
                best_parts[:] = factors
        if first and best_row >= 0:
            break
    return best, best_row, best_taken, best_parts, best_gain, best_late


@kernel
def largest_along(a, b, c, d, low, high):
    """The x in [low, high] at which |1 + (a + xb) / (c + xd)| is largest: at an end, or where its slope, a quadratic, is zero.

    The quadratic is that of the difference of both squares: their own would cancel where a and b are small.
    """
    c0, c1, c2 = c.real**2 + c.imag**2, c.real * d.real + c.imag * d.imag, d.real**2 + d.imag**2
    e0 = 2 * (c.real * a.real + c.imag * a.imag) + a.real**2 + a.imag**2
    e1 = c.real * b.real + c.imag * b.imag + a.real * (d.real + b.real) + a.imag * (d.imag + b.imag)
    e2 = 2 * (d.real * b.real + d.imag * b.imag) + b.real**2 + b.imag**2
    p, q, r = e2 * c1 - e1 * c2, e2 * c0 - e0 * c2, e1 * c0 - e0 * c1
    tried = (low, high, low, high)
    root = q * q - 4 * p * r
    if root > 0:
        half = -0.5 * (q + math.copysign(math.sqrt(root), q))
        first = half / p if p != 0 else low
        second = r / half if half != 0 else low
        tried = (low, high, min(max(first, low), high), min(max(second, low), high))
    best, most = low, -1.0
    for x in tried:
        under = c + x * d
        over = under + (a + x * b)
        size = (over.real**2 + over.imag**2) / (under.real**2 + under.imag**2)
        if size > most:
            best, most = x, size
    return best


@checked
def harmful_places(
    loops: Sequence[Loop],
    controller: Pid,
    constraints: Sequence[PeakConstraint],
    boxes: Sequence[Box],
    starts: int = STARTS,
    compensators: Sequence[np.ndarray] = (),
    first: bool = False,
) -> list[Perturbation]:
    """Places of the box where a loop exceeds a constraint, the worst of each; empty when none is found.

    `compensators` are the responses of the loops' own on the grids of the boxes; of the `first` place no other matters.
    """
    if not compensators:
        compensators = [
            loop.compensator.frequency_response(box.omega) for loop, box in zip(loops, boxes, strict=False)
        ]
    found = []
    for constraint in constraints:
        worst = [
            each
            for loop, box, own in zip(loops, boxes, compensators, strict=False)
            for each in box.worst(
                loop, controller, [constraint], starts=starts, compensator=own, first=first, exact=not first
            )
        ]
        if worst:
            found.append(max(worst, key=lambda each: each[0])[1])
            if first:
                break
    return found
