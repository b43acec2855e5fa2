"""One search for the controller of a machine: `design`, `report` and the notebook print what it finds."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from stillwork.base.bounds import NonNegative
from stillwork.base.checks import InputError, require_number
from stillwork.base.validation import checked
from stillwork.control.loop_noise import USUAL, NoiseBound
from stillwork.control.machine_loops import (
    AchievableBandwidth,
    DesignSettings,
    Intensities,
    SearchSettings,
    applications,
    in_hertz,
    reach,
    search_range,
)
from stillwork.control.uncertainty import (
    ABSOLUTE,
    NAMES,
    Uncertainty,
    require_shares,
    uncertainty_of,
)
from stillwork.identification.machine import TRUSTED, Machine, measured_band, remove_delay
from stillwork.lti.modal import ModalModel
from stillwork.machine.machine_tuning import tuned, varied
from stillwork.machine.waiting import bound_hz, waited

# What the observer is made for where nothing is known: accelerations and noise of a machine that moves by nanometres.
INTENSITIES = Intensities(disturbance=8e-4, sensor=1.41e-9, drift=1.92e-4)
ADDED_DAMPING, SELECTIVITY, RETAINED = 0.02, 2.0, 5
NOTCHED = "PID with notches"
UNCERTAINTY = {"frequency": 0.05, "gain": 0.05}  # where nothing else is given
DELAY = 1.0  # samples from a measurement to the force that follows from it
OVER_FIRST, OVER_LAST = 20.0, 4.0  # the default rate, over the first resonance and over the last
STEPS = (1, 2, 5)  # of default rates, times powers of ten
DEAFER = 4  # decades of more sensor noise that an observer is made for, where its own makes too much of it
ABOUT_SUSPENSION = (
    1.0,
    0.5,
)  # of a suspension: where bandwidths are sought from, if none is safe well above it
LEAD_ABOUT_SUSPENSION = 16 / 3  # there: a crossing above the resonance needs more phase than a free body's
CHANGES = 4  # of the machine or its processor, of which each is tried for what it would help
WORTH = 0.01  # relative gain in bandwidth below which a change of the machine is not listed
# The uses that each contains: where it gets no further than one of them, its design is that one's.
CONTAINED: dict[str, tuple[str, ...]] = {
    "PID": (),
    NOTCHED: ("PID",),
    "MC": ("PID",),
    "AD": ("PID",),
    "MC and AD": ("MC", "AD"),
}
LITTLE = 1 / 8  # of the added damping: what AD begins with beside an MC that is tuned
EACH = 2  # steps a use: with the first settings, and with those that are tuned


class Designed(NamedTuple):
    """Results of the search, with its settings."""

    machine: Machine  # its measurement early by the delay that it was found to hold
    others: tuple[Machine, ...]  # other responses of it that the same controller serves
    rate: float  # Hz
    delay: float  # samples, what the measurement holds included
    delays: tuple[float, ...]  # likewise, of the others
    uncertainty: dict[str, float]
    spreads: tuple[Uncertainty, ...]  # of the machine, then of the others
    settings: dict[str, DesignSettings]
    found: dict[str, AchievableBandwidth]  # by use
    notes: tuple[str, ...]  # what the search is for, in words
    same: dict[str, str]  # uses whose design is that of another one, which they contain
    noise: NoiseBound = USUAL
    loop_hz: tuple[float, float] = (0.0, 0.0)
    search_hz: tuple[float, float] = (0.0, 0.0)

    @property
    def search(self) -> SearchSettings:
        """What the search of every use holds fixed."""
        others = tuple(zip(self.others, self.delays, strict=True))
        fixed = SearchSettings(1 / self.rate, self.delay, self.uncertainty, others, self.noise)
        return replace(fixed, loop_hz=self.loop_hz, search_hz=self.search_hz)

    @property
    def ranking(self) -> list[str]:
        """The uses with a safe loop, the highest bandwidth first; of equals the simplest."""
        safe = [use for use, each in self.found.items() if each.recommended is not None]
        return sorted(safe, key=lambda use: -float(f"{crossing(self.found[use]):.4g}"))

    @property
    def ranking_line(self) -> str:
        """The same in words, with the bandwidths."""
        listed = [f"{use} {in_hertz(crossing(self.found[use]))} Hz" for use in self.ranking]
        return f"highest bandwidth first: {', '.join(listed) or 'none has a safe loop'}"

    @checked
    def words(self, use: str) -> str:
        """What is special about the design of a use: that it is a simpler one's, and that it waits."""
        same, wait = self.same.get(use), self.settings[use].wait
        return (f"as {same}; " if same else "") + (f"waits {wait:g} samples; " if wait else "")

    def lines(self) -> list[str]:
        """Settings and results of the search, one line each."""
        rows = [
            f"{use}: {self.words(use)}{', '.join(f'{key} {value}' for key, value in each.summary.items())}"
            f"{each.reason and '; ' + each.reason}"
            for use, each in self.found.items()
        ]
        return [*self.notes, *rows, self.ranking_line]


@checked
def default_rate(machine: Machine) -> float:
    """The rate (Hz) where none is given: 1, 2 or 5 times a power of ten, well above all resonances of the model."""
    first = machine.rigid_to_hz
    if not np.isfinite(first):
        raise InputError(f"{machine.source}: no flexible mode tells what rate it needs; give a rate")
    least = max(OVER_FIRST * first, OVER_LAST * float(machine.resonances_hz.max(initial=first)))
    power = 10 ** np.floor(np.log10(least))
    return float(next(step * power for step in (*STEPS, 10) if step * power >= (1 - 1e-9) * least))


@checked
def stated_uncertainty(stated: str | Mapping[str, float]) -> dict[str, float]:
    """Shares by `NAMES`: those given, the others as in `UNCERTAINTY`; with ``none`` the others are zero."""
    if not isinstance(stated, str):
        named = dict(stated)
    else:
        words = [each.strip() for each in stated.split(",") if each.strip()]
        named = {}
        for word in words:
            name, _, value = word.partition("=")
            if word == "none":
                continue
            try:
                named[name.strip()] = float(value)
            except ValueError:
                raise InputError(
                    f"uncertainty holds {word!r}; give NAME=VALUE of {', '.join(NAMES)}, separated by commas, or none"
                ) from None
        if "none" not in words:
            named = UNCERTAINTY | named
    require_shares(named)
    # Of a friction of nothing more the interval of the fit is left.
    return {name: value for name, value in named.items() if value or name == "friction"}


def _require_fit(machine: Machine, others: Sequence[Machine], rate: float, delay: float) -> None:
    """That rate, delay and the other machines fit the machine, else `InputError`."""
    resonance = machine.rigid_to_hz
    lowest = search_range(machine, 0.0 if np.isfinite(resonance) else 1 / rate)[0]
    # Bandwidths are sought to a tenth of the rate; a mode's part in the coefficients is the square of its angle a sample.
    require_number("rate", rate, above=10 * lowest, at_most=resonance / np.sqrt(np.finfo(float).eps))
    if delay / rate * lowest >= 1:
        raise InputError(
            f"delay is {delay:g}, a period of the lowest bandwidth ({lowest:.3g} Hz) or more; give fewer samples"
        )
    if others and max(len(each.sensors) for each in (machine, *others)) > 1:
        raise InputError(
            "others: with several responses only one sensor is supported; leave the other sensors out"
        )
    for other in others:
        if other.units != machine.units:
            raise InputError(
                f"others: {other.source} is in {' and '.join(other.units)}, {machine.source} in "
                f"{' and '.join(machine.units)}; give all in the same units"
            )


@checked(missing=True)
def search_designs(
    machine: Machine,
    others: Sequence[Machine] = (),
    *,
    rate: NonNegative = 0.0,
    delay: NonNegative = DELAY,
    uncertainty: str | Mapping[str, float] = "",
    loop_hz: tuple[float, float] = (0.0, 0.0),
    search_hz: tuple[float, float] = (0.0, 0.0),
    intensities: Intensities = INTENSITIES,
    retained: int = RETAINED,
    added_damping: float = ADDED_DAMPING,
    selectivity: float = SELECTIVITY,
    noise: NoiseBound = USUAL,
    on_step: Callable[[str], None] | None = None,
) -> Designed:
    """Bandwidth of PID, PID with notches, MC, AD, and MC with AD, each with tuned settings.

    Parameters
    ----------
    machine : Machine
    others : sequence of Machine
        The same machine at another position or with another load: the controller, whose observer is made for
        `machine`, holds the constraints there and in the box around it, too.
    rate : float
        Samples per second of the controller, Hz; 0: `default_rate`.
    delay : float
        Delay from a measurement to the force that follows from it, in samples, whole or not, in addition to the hold and to a delay
        of the measured response itself, which is detected, reported and included.
    uncertainty : str or mapping of str to float
        See `stated_uncertainty`.
    loop_hz, search_hz : tuple of float
        See `reach`.
    intensities, retained, added_damping, selectivity
        Initial settings of an observer.
    noise : NoiseBound
        Allowed sensor noise in the output.
    on_step : callable, optional
        Called with the name of each use before it is searched, `EACH` times.

    Returns
    -------
    Designed

    Raises
    ------
    InputError
        For invalid settings, or settings that do not fit this machine.
    """
    shares = stated_uncertainty(uncertainty)
    chosen = not rate
    rate = rate or default_rate(machine)
    _require_fit(machine, others, rate, delay)
    prompt, late = zip(*(_prompt(each, delay, rate) for each in (machine, *others)), strict=True)
    spreads = tuple(uncertainty_of(each, shares) for each in prompt)
    notes = _searched_for(prompt[0], rate, chosen, late[0], shares, noise, loop_hz)
    made = Designed(
        prompt[0],
        prompt[1:],
        rate,
        late[0],
        late[1:],
        shares,
        spreads,
        {},
        {},
        notes,
        {},
        noise,
        loop_hz,
        search_hz,
    )
    uses = {"PID": None, NOTCHED: None} | applications(added_damping, selectivity)
    for use in uses_of(machine):
        first = DesignSettings(uses[use], retained, intensities, use == NOTCHED)
        _search_use(made, use, first, partial(on_step or (lambda _: None), use))
    return made


def _searched_for(
    machine: Machine,
    rate: float,
    chosen: bool,
    late: float,
    shares: Mapping[str, float],
    noise: NoiseBound,
    loop_hz: tuple[float, float],
) -> tuple[str, ...]:
    """What a search assumes; `chosen` where nobody gave the rate."""
    shares_text = " and ".join(
        f"{name} ± {value:g} {ABSOLUTE.get(name, '')}".rstrip() for name, value in shares.items()
    )
    return (
        f"searched at {rate:g} Hz{' (no rate was given: above 20 times the first resonance and 4 times the last)' * chosen}, "
        f"delay {late:.4g} samples plus the hold, uncertainty {shares_text or 'none'}"
        f"{' plus the intervals of the fit' * bool(shares_text and machine.fit)}",
        "S_I and S_O, which is also r to e since the controller runs on the error, at most 6 dB",
        *noise.words(machine.units),
        *_cut(machine, loop_hz),
    )


def _search_use(made: Designed, use: str, first: DesignSettings, on_step: Callable[[], object]) -> None:
    """How far a use gets, into `made`: no less far than one that it contains."""
    best = _furthest(made.machine, first, _carried(first, made.settings), made.search, on_step)
    made.settings[use], made.found[use] = best
    for name in CONTAINED[use]:
        if crossing(made.found[name]) >= crossing(made.found[use]) and made.found[name].recommended:
            made.settings[use], made.found[use] = made.settings[name], made.found[name]
            made.same[use] = made.same.get(name, name)


def _cut(machine: Machine, loop_hz: tuple[float, float]) -> Iterator[str]:
    """That the measurement is the plant in a part of its band only, where that follows from the coherence."""
    if machine.fit is None or any(loop_hz):
        return
    low, high = measured_band(machine)
    if not np.allclose((low, high), machine.fit.omega[[0, -1]] / (2 * np.pi)):
        yield (
            f"the measurement is the plant from {low:.4g} to {high:.4g} Hz, the first and the last line that its coherence lets be "
            f"trusted to {100 * TRUSTED:g} %; give loop_hz for another band"
        )


@checked
def uses_of(machine: Machine) -> list[str]:
    """The uses that are searched: of a machine that shows no flexible mode PID alone."""
    return list(CONTAINED) if len(machine.resonances_hz) else ["PID"]


def _prompt(machine: Machine, delay: float, rate: float) -> tuple[Machine, float]:
    """A measured machine early by the delay that it holds, and the delay of the loop, in samples, with it."""
    if machine.fit is None:
        return machine, delay
    # What is early is no part of a machine: the measurement is only made to agree with the model.
    return remove_delay(machine, machine.fit.delay), delay + max(machine.fit.delay, 0.0) * rate


class _Reached(NamedTuple):
    """Settings of one use, and how far they get."""

    use: DesignSettings
    found: AchievableBandwidth

    @property
    def hertz(self) -> float:
        """The bandwidth."""
        return crossing(self.found)


def _furthest(
    machine: Machine,
    first: DesignSettings,
    contained: list[DesignSettings],
    search: SearchSettings,
    on_step: Callable[[], object],
) -> _Reached:
    """How far one use gets: from its first settings, from those of the uses that it contains, and with waiting.

    Of a machine on springs that has no safe loop well above its suspension, those about it are sought.
    """
    on_step()
    best = _tuned_from(machine, first, search)
    high = search_range(machine, search.sample_time)[1]
    suspension = float(machine.sensors[0].frequencies[0]) / (2 * np.pi)
    for share in ABOUT_SUSPENSION if suspension and not any(search.search_hz) else ():
        low = share * suspension
        if best.found.recommended is None and low < high:
            wide = replace(search, search_hz=(low, high))
            best = _further(best, _tuned_from(machine, replace(first, lead=LEAD_ABOUT_SUSPENSION), wide))
            search = wide if best.hertz else search
    on_step()
    for start in contained:
        if bound_hz(machine, start, search) > (1 + WORTH) * best.hertz:
            best = _further(best, _tuned_from(machine, start, search))
    if first.application is not None:  # an observer is tuned anew
        best = _further(best, _tuned_from(machine, replace(first, wait=1.0), search))
    trial = waited(machine, best.use, search, best.found, best.hertz)
    if trial != best.use:
        best = _further(best, _Reached(trial, reach(machine, trial, search)))
        if trial.application is not None and best.use == trial:
            best = _further(best, _tuned(machine, best, search))
    return best


def _further(one: _Reached, other: _Reached) -> _Reached:
    return other if other.hertz > one.hertz else one


def _tuned_from(machine: Machine, settings: DesignSettings, search: SearchSettings) -> _Reached:
    """How far some settings get, tuned where that leads further."""
    found = reach(machine, settings, search)
    deaf, other = settings, found
    for _ in range(DEAFER):
        deafer = varied(deaf, "sensor", 10.0)  # an observer for a noisier sensor
        if deafer is None or not other.stopped_by_noise:
            break
        deaf, other = deafer, reach(machine, deafer, search)
        if crossing(other) > crossing(found):
            settings, found = deaf, other
    return _tuned(machine, _Reached(settings, found), search)


def _tuned(machine: Machine, known: _Reached, search: SearchSettings) -> _Reached:
    """The settings tuned, where that leads further."""
    lowest = search.search_hz[0] or search_range(machine, search.sample_time)[0]
    recommended = known.found.recommended
    trial = tuned(machine, known.use, recommended.design_hz if recommended else lowest, search)
    return known if trial == known.use else _further(known, _Reached(trial, reach(machine, trial, search)))


def _carried(first: DesignSettings, settings: Mapping[str, DesignSettings]) -> list[DesignSettings]:
    """Of MC with AD, the optima of MC and of AD with little of the other."""
    if first.application is None or not (first.application.compensate and first.application.damping):
        return []
    little = {
        "damping": LITTLE * float(np.max(first.application.damping)),
        "selectivity": first.application.selectivity,
    }
    starts = []
    for use, added in (("MC", little), ("AD", {"compensate": True})):
        known = settings[use]
        if known.application is not None:  # the use gets further than PID
            starts.append(replace(known, application=replace(known.application, **added)))
    return starts


@checked
def crossing(reached: AchievableBandwidth) -> float:
    """The lowest first crossing of the recommended design, Hz; 0 if there is none."""
    return float(reached.recommended.crossing_hz.min()) if reached.recommended else 0.0


@checked
def improvements(
    machines: Sequence[Machine], made: Designed, delay: float, on_step: Callable[[str], object] | None = None
) -> list[list[str]]:
    """Changes of the machine or of its processor that raise the bandwidth, the best first, each by the whole search.

    `machines` and `delay` are those that the design `made` was searched for. With other modes there is no measurement:
    the search is that of the model, as if a file held its matrices.
    """
    damped, beside = (
        [
            replace(each, measured=None, fit=None, sensors=tuple(map(change, each.sensors)))
            for each in machines
        ]
        for change in (_damped, _beside)
    )
    trials = {
        "twice the damping of its modes": (damped, made.rate, made.delay),
        "the sensor where the force acts": (beside, made.rate, made.delay),
        "twice the rate": (machines, 2 * made.rate, delay),
        "no delay": (machines, made.rate, 0.0),
    }
    asked = {
        "uncertainty": made.uncertainty,
        "loop_hz": made.loop_hz,
        "noise": made.noise,
        "on_step": on_step,
    }
    before, gains = crossing(made.found[made.ranking[0]]), []
    for words, ((first, *others), rate, late) in trials.items():
        if late == delay and rate == made.rate and first is machines[0]:
            continue
        if first is not machines[0] and not len(first.resonances_hz):
            continue
        found = search_designs(first, others, rate=rate, delay=late, **asked)
        hertz = max(map(crossing, found.found.values()))
        if hertz > (1 + WORTH) * before:
            gains.append((hertz, words, found.ranking[0]))
    return [[words, use, f"{hertz:.1f}"] for hertz, words, use in sorted(gains, reverse=True)]


def _damped(model: ModalModel) -> ModalModel:
    factor = np.append(1.0, np.full(len(model.damping) - 1, 2.0))
    return replace(model, damping=np.minimum(factor * model.damping, np.maximum(model.damping, 0.5)))


def _beside(model: ModalModel) -> ModalModel:
    whole = np.abs(model.output_shapes[0, 0] / model.input_shapes[0, 0])  # it reads the whole body as before
    return replace(model, output_shapes=whole * model.input_shapes.T, feedthrough=np.abs(model.feedthrough))
