"""Your floor: what this notebook alone needs."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64
from numpy.typing import ArrayLike
from scipy import linalg

from experiments.isolation.performance import DIRECTIONS, central_axes, expected_density
from experiments.isolation.power import BAND_HZ
from experiments.isolation.recorded_floors import (
    RecordedFloor,
    SpectralFloor,
    ground_floor,
    record_floor,
    synthesise_floor,
)
from experiments.isolation.responses import COARSE_HZ, thinned
from experiments.isolation.simulation import Run, simulate
from experiments.isolation.steady import FORGETTING, steady_state
from experiments.isolation.twin import Twin
from stillwork.base.checks import InputError, require_array, require_choice, require_number
from stillwork.estimation.adaptive import FeRls
from stillwork.signals.criteria import criterion_met, criterion_velocity, one_third_octave_velocity
from stillwork.signals.datafiles import read_columns
from stillwork.signals.densities import (
    DENSITY_UNITS_TEXT,
    density_unit,
    frequency_axis,
    read_densities,
    stated_density,
)
from stillwork.signals.floor_checks import (
    HEARD_HZ,
    SLOW_HZ,
    require_floor_level,
    sensor_faults,
    slow_ratio,
)
from stillwork.signals.records import PASS_SHARE, is_time, load_record
from stillwork.signals.spectra import band_power, estimate_spectrum
from workbook import figures

# === Floor files ==================================================================================================
# A floor of one's own: a measured record, or measured spectra, as motions of the floor sensors (notebook 08).


SHORTEST_S = 15.0  # two thirds of it are the adaptation's own time constant of 10 s
FADE_S = 1.0  # at the beginning of a record; the first 5 s are judged by nobody
FARTHEST = 0.1  # m rms: no floor travels so far, a drifting sensor seems to (chosen)


TABLES = (".csv", ".txt", ".tsv", ".npz", ".mat")  # files of columns by name


def open_floor(
    floor_record: str,
    unit: str,
    rate_hz: float,
    channels: list[str],
    *,
    twin: Twin,
    ground_gain: float,
    common: float,
    duration_s: float,
    seed: int,
) -> RecordedFloor:
    """Floor from a record or from spectra, or the measured ground when no file is named.

    A record of one or two channels gives one or two: the feedforward hears no sensor that was not there. One
    spectrum moves all of the rig's sensors alike, several each its own.

    Parameters
    ----------
    floor_record : str
        Path of a CSV, MAT, NPZ or universal file, see `stillwork.signals.records.load_record`; empty for the
        ground. Spectra stand beside a column or array named ``frequency``, in Hz.
    unit : str
        Of the record; a density, such as ``(m/s)^2/Hz`` or ``m/s^2/sqrt(Hz)``, means that the file holds spectra. Empty
        where the file states it in brackets.
    rate_hz : float
        Of the record; 0 where the file states it.
    channels : list of str
        Channels to take, as many as floor sensors at most; empty for all.
    twin : Twin
        Whose sensors the floor moves.
    ground_gain, common, duration_s, seed
        Of a motion that is made from spectra: its amplitude relative to them, share of its power that all
        sensors see alike, seconds, and seed.

    Raises
    ------
    InputError
        For everything that makes the file unusable, with what to do. A floor that does not reach the rig's
        suspension is refused, since it cannot teach the feedforward anything; so is one beyond 1 g, or below the
        quietest ground on Earth, since its unit is wrong, and a record of a sensor that drifts.
    """
    rate = twin.instruments.sample_rate
    require_number("ground_s", duration_s, at_least=SHORTEST_S)
    options = {"common": common, "sample_rate": rate}
    lowest, highest = _suspension_hz(twin)
    measured = False
    if not floor_record:
        floor = ground_floor(duration_s, seed, gain=ground_gain, channels=twin.sensors, **options)
    elif density_unit(unit) if unit else _holds_densities(Path(floor_record)):
        path = Path(floor_record)
        f, density = read_densities(path, unit, channels, twin.sensors)
        if f[0] > lowest or f[-1] < highest:
            raise InputError(
                f"{path.name} holds {f[0]:.3g} to {f[-1]:.3g} Hz and misses suspension frequencies of the rig "
                f"({lowest:.3g} to {highest:.3g} Hz); give spectra that cover them"
            )
        if len(density) == 1:
            density = np.repeat(density, twin.sensors, axis=0)
        source = f"spectra of {path.name}"
        floor = synthesise_floor(
            f, ground_gain**2 * density, duration_s, seed, channels=len(density), source=source, **options
        )
    else:
        floor, measured = _recorded(floor_record, unit, rate_hz, channels, twin, highest), True
    peak, rms = np.abs(floor.acceleration).max(), floor.acceleration.std(axis=1).max()
    require_floor_level(floor.source, unit, float(peak), float(rms))
    return _from_rest(floor) if measured else floor  # a wrong unit travels far, too, and is no drift


def _holds_densities(path: Path) -> bool:
    return path.suffix.lower() in TABLES and any(map(stated_density, read_columns(path)))


def _recorded(floor_record, unit, rate_hz, channels, twin, highest) -> RecordedFloor:
    path = Path(floor_record)
    if path.suffix.lower() in TABLES and not rate_hz:
        columns = read_columns(path)
        if frequency_axis(columns) and not any(is_time(name) for name in columns):
            raise InputError(
                f"{path.name} holds spectra over frequency; say their unit as a density: {DENSITY_UNITS_TEXT}"
            )
    record = load_record(
        path,
        unit,
        sample_rate=rate_hz or None,
        channels=channels or None,
        most_channels=twin.sensors,
    )
    if record.duration < SHORTEST_S:
        raise InputError(
            f"{record.source} lasts {record.duration:.3g} s, too short for an adaptation that averages over 10 s; "
            f"give at least {SHORTEST_S:g} s"
        )
    if record.sample_rate * PASS_SHARE / 2 < highest:
        raise InputError(
            f"{record.source} is sampled at {record.sample_rate:.4g} Hz and has no content above "
            f"{record.sample_rate * PASS_SHARE / 2:.3g} Hz, where the rig has suspension frequencies up to "
            f"{highest:.3g} Hz; measure at {2 * highest / PASS_SHARE:.3g} Hz at least"
        )
    return record_floor(record, channels=len(record.signals), sample_rate=twin.instruments.sample_rate)


def _from_rest(floor: RecordedFloor) -> RecordedFloor:
    """The loop starts at rest: a floor that does not, by an offset or in mid-motion, would be a step that no floor makes."""
    if (travel := _travel(floor)) > FARTHEST:
        raise InputError(
            f"{floor.source}: integrated twice, the floor travels {travel:.2g} m rms, which is a sensor that drifts; "
            "take a high-pass of some 0.5 Hz over the record"
        )
    fade = np.minimum(np.arange(floor.acceleration.shape[1]) / (FADE_S * floor.sample_rate), 1.0)
    return replace(floor, acceleration=floor.acceleration * np.sin(np.pi / 2 * fade) ** 2)


def _travel(floor: RecordedFloor) -> float:
    """Rms displacement of the sensor that moves farthest, m, without what is slower than half the record."""
    samples = floor.acceleration.shape[1]
    omega = 2 * np.pi * np.fft.rfftfreq(samples, 1 / floor.sample_rate)[2:]
    lines = np.fft.rfft(floor.acceleration * np.hanning(samples), axis=1)[:, 2:] / omega**2
    # A Hann window keeps 3/8 of the power.
    return float(np.sqrt(2 * np.sum(np.abs(lines) ** 2, axis=1).max() * 8 / 3) / samples)


def _suspension_hz(twin: Twin) -> tuple[float, float]:
    squares = linalg.eigvalsh(twin.plant.stiffness, twin.plant.mass)
    return tuple(np.sqrt(squares[[0, -1]]) / (2 * np.pi))


# === Your floor ===================================================================================================
# What the isolator makes of a floor, learnt on one part of it and judged on the rest (notebook 08).


SETTLE_S = 5.0  # cut off before anything is judged
TRAINING_SHARE = 2 / 3  # of the floor, its first part; the weights never see the rest
KEEP_EVERY_S = 0.2
RESOLUTION_HZ = 0.25
WINDOW = 10  # kept values that the picture of the adaptation summarises
SAME = 0.1  # a change of the motion by less is called none: chosen
OTHER = 2.0  # so many times louder or quieter, a floor is called another one: chosen
SLOW_RATIO = 5.0  # of the densities there: at 10 every adaptation tried broke, at 7 none (chosen)
LESS_DAMPING = (5.0,)  # N s/m: 1 % of critical in z
_GRID = np.unique(np.concatenate([np.geomspace(0.02, 2400, 600), np.arange(1.0, 300.0, 0.5)]))


@dataclass(frozen=True)
class Isolated:
    """A floor and what the platform does above it, in z, θx, θy (m/s^2 and rad/s^2), from `SETTLE_S` on."""

    floor: Float64[np.ndarray, "3 samples"]  # the plate, without sensor noise
    platform: dict[str, Float64[np.ndarray, "3 samples"]]  # truly: ``passive``, ``feedback``, ``FeRLS``
    quiet: Float64[np.ndarray, "3 samples"]  # case ``feedback`` with sensors that have no noise
    training: int  # samples before the part that the weights have not seen
    adaptation: Run  # FeRLS from zero over the training part
    progress: Float64[np.ndarray, " kept"]  # power of the filtered error over that without feedforward
    sample_rate: float  # Hz

    @property
    def moving(self) -> Bool[np.ndarray, "3"]:
        """Directions in which the floor plate moves at all; a record of one channel does not tilt it."""
        travel = self.floor.std(axis=1) * np.array([1.0, 0.1, 0.1])  # tilts at a lever of 0.1 m
        return travel > 1e-9 * travel.max()

    def left(self, name: str, *, training: bool = False) -> Float64[np.ndarray, "3"]:
        """Rms acceleration of a case over that of the floor plate, on the test or the training part; NaN at rest."""
        part = slice(self.training) if training else slice(self.training, None)
        floor = np.where(self.moving, self.floor[:, part].std(axis=1), np.nan)
        return self.platform[name][:, part].std(axis=1) / floor

    @property
    def noise_share(self) -> Float64[np.ndarray, "3"]:
        """Share of the platform's power with feedback that its own sensors' noise makes, test part; NaN at rest."""
        whole, quiet = self.platform["feedback"][:, self.training :], self.quiet[:, self.training :]
        return (whole - quiet).var(axis=1) / np.where(self.moving, whole.var(axis=1), np.nan)


def select_floor_sensors(twin: Twin, channels: int) -> tuple[Twin, Float64[np.ndarray, "sensors channels"]]:
    """Twin whose feedforward hears `channels` floor sensors, and what each of the rig's own reads of them.

    Where the floor was measured with fewer sensors than the rig has, those that are missing read the mean of the
    others, so that one sensor is a plate that only translates. The controller gets the measured ones alone:
    copies of one signal would tell it nothing, and leave its covariance nearly singular (notebook 07).
    """
    if not 1 <= channels <= twin.sensors:
        raise InputError(
            f"channels is {channels}; the rig has {twin.sensors} floor sensors, give 1 to as many"
        )
    missing = twin.sensors - channels
    spread = np.vstack([np.eye(channels), np.full((missing, channels), 1 / channels)])
    if not missing:
        return twin, spread
    names = ("floor_damping", "floor_stiffness", "floor_inertia")
    plant = replace(twin.plant, **{name: getattr(twin.plant, name) @ spread for name in names})
    return replace(twin, plant=plant), spread


def isolate(twin: Twin, floor: RecordedFloor, seed: int, start: float = 1.0) -> Isolated:
    """Run a floor through the passive rig, with feedback, and with the weights that FeRLS learns on its first part.

    FeRLS starts from zero weights and from `start` times (1 - lambda) over the power of each filtered regressor,
    the steady P of uncorrelated regressors. Its weights are then frozen and judged on what it has not seen, with
    other sensor noise; every case is judged on the same stretch.
    """
    require_number("start", start, above=0.0)
    axes = central_axes(twin.rig)
    twin, spread = select_floor_sensors(twin, floor.channels)
    training_s = round(TRAINING_SHARE * floor.duration / KEEP_EVERY_S) * KEEP_EVERY_S

    def run(from_s: float = SETTLE_S, **options) -> Run:
        return simulate(twin, floor, signals_from_s=from_s, keep_every_s=KEEP_EVERY_S, **options)

    # The power is that of the whole part that the adaptation meets: a loud beginning is where a large P hurts.
    before = run(0.0, seed=seed)
    rate = before.sample_rate
    settled, training = (round(each * rate) for each in (SETTLE_S, training_s - SETTLE_S))
    settings = steady_start(before.filtered_regressors[:, : settled + training], start)
    adaptation = simulate(twin, floor, training_s, adaptation=settings, seed=seed, keep_every_s=KEEP_EVERY_S)
    cases = {
        name: run(seed=seed + 1, **options) for name, options in _cases(adaptation.final_weights).items()
    }
    return Isolated(
        axes.floor @ spread @ before.floor[:, settled:],
        {name: axes.platform @ case.platform for name, case in cases.items()},
        axes.platform @ run(seed=seed + 1, noise=False).platform,
        training,
        adaptation,
        adaptation.error_power / before.error_power[: len(adaptation.error_power)],
        rate,
    )


def _cases(weights) -> dict[str, dict]:
    """What distinguishes a run of each case from the others."""
    return {"passive": {"feedback": False}, "feedback": {}, "FeRLS": {"weights": weights}}


def steady_start(regressors: Float64[np.ndarray, "regressors samples"], start: float = 1.0) -> FeRls:
    """FeRLS that begins at `start` times the steady P of uncorrelated filtered regressors."""
    return FeRls(start * (1 - FORGETTING) / np.mean(regressors**2, axis=1))


def translating_spectrum(floor: RecordedFloor) -> SpectralFloor:
    """Spectrum of the mean of a floor's sensors, for a rig that hears it with one."""
    spectrum = estimate_spectrum(floor.acceleration.mean(axis=0), floor.sample_rate, RESOLUTION_HZ)
    return SpectralFloor(spectrum.frequencies_hz[1:], spectrum.density[0, 1:], floor.source, 1)


def tilting_spectrum(floor: RecordedFloor) -> SpectralFloor | None:
    """Spectrum of what each of a floor's sensors sees for itself; None where all see the same.

    The sensors' own parts are taken as independent: of n of them each keeps 1 - 1/n of its power beside their mean.
    """
    own = floor.acceleration - floor.acceleration.mean(axis=0)
    if np.abs(own).max() <= 1e-9 * np.abs(floor.acceleration).max():
        return None
    spectrum = estimate_spectrum(own, floor.sample_rate, RESOLUTION_HZ)
    density = spectrum.density[:, 1:].mean(axis=0) / (1 - 1 / floor.channels)
    return SpectralFloor(spectrum.frequencies_hz[1:], density, floor.source, floor.channels)


def optimal_residual_ratio(
    twin: Twin, floor: SpectralFloor, gains: ArrayLike, direction: str = "z"
) -> dict[str, Float64[np.ndarray, " gains"]]:
    """Rms motion in a direction at 1-300 Hz over the floor's, for a louder or quieter floor and the optimum weights.

    From spectra alone: in z of `translating_spectrum`, of one sensor and a plate that only translates; in θx and θy of
    `tilting_spectrum`. `gains` are amplitudes relative to `floor`.
    """
    row = DIRECTIONS.index(require_choice("direction", direction, DIRECTIONS))
    f = np.geomspace(*BAND_HZ, 1500)[:-1]
    axes = central_axes(twin.rig)
    twin, spread = select_floor_sensors(twin, floor.channels)
    lever = np.sum((axes.floor[row] @ spread) ** 2)
    left: dict[str, list[float]] = {name: [] for name in _cases(None)}
    for gain in require_array("gains", gains, ndim=1):
        scaled = replace(floor, levels=gain**2 * floor.levels)
        moved = lever * band_power(f, scaled.density(f)[0], f[0], f[-1])
        weights = steady_state(twin, scaled, frequencies_hz=_GRID).weights
        for name, options in _cases(weights).items():
            density = _expected(twin, scaled, f, options, row)
            left[name].append(np.sqrt(band_power(f, density, f[0], f[-1]) / moved))
    return {name: np.array(values) for name, values in left.items()}


def _expected(twin: Twin, floor: SpectralFloor, f: np.ndarray, case: dict, row: int = 0) -> np.ndarray:
    """Density of the platform's true motion in one direction."""
    return sum(expected_density(twin, floor, f, sensed=False, **case).values())[row]


@dataclass(frozen=True)
class Trial:
    """The feedforward with another skyhook gain or other struts, on the part of the floor that it has not seen."""

    damping: float  # N s/m, of a strut
    gain: float  # N s/m, of the skyhook
    left: Float64[np.ndarray, "3"]  # rms acceleration over the floor's in z, θx, θy


def try_damping(twin: Twin, floor: RecordedFloor, seed: int, start: float, isolated: Isolated) -> list[Trial]:
    """Weights learnt with the struts' own damping (`isolated`) and with less, judged with and without the skyhook loop."""
    found = []
    for each in (float(np.mean(twin.rig.damping)), *LESS_DAMPING):
        rig, changed = twin.rig, twin
        if found:
            rig = replace(rig, damping=each)
            changed = twin.on_rig(rig)
            isolated = isolate(changed, floor, seed, start)
        weights = isolated.adaptation.final_weights
        heard, _ = select_floor_sensors(changed.varied(gain=0.0), floor.channels)
        platform = central_axes(rig).platform
        run = simulate(heard, floor, signals_from_s=SETTLE_S, weights=weights, seed=seed + 1)
        without = replace(isolated, platform={"FeRLS": platform @ run.platform})
        found.append(Trial(each, twin.skyhook.gain, isolated.left("FeRLS")))
        found.append(Trial(each, 0.0, without.left("FeRLS")))
    return found


def advice(trials: list[Trial]) -> Iterator[str]:
    """Which skyhook gain and which damping leave least, direction by direction, with what they leave."""
    own = trials[0]
    for k in np.flatnonzero(np.isfinite(own.left)):
        best = min(trials, key=lambda trial: trial.left[k])
        if best.left[k] > (1 - SAME) * own.left[k]:
            yield f"{DIRECTIONS[k]}: no skyhook gain or damping tried leaves clearly less than this rig's own ({own.left[k]:.3g})."
            continue
        loop = "without the skyhook loop" if best.gain == 0 else "with the skyhook loop"
        yield (
            f"{DIRECTIONS[k]}: struts of {best.damping:g} N s/m {loop} leave {best.left[k]:.3g} instead of "
            f"{own.left[k]:.3g}, with the weights learnt there."
        )
        others = [j for j in np.flatnonzero(np.isfinite(own.left)) if best.left[j] > (1 + SAME) * own.left[j]]
        for j in others:
            yield f"  The price is {best.left[j]:.3g} instead of {own.left[j]:.3g} in {DIRECTIONS[j]}."


def warnings(floor: RecordedFloor) -> Iterator[str]:
    """What may spoil the adaptation, seen in the record before anything runs, and what to do about it."""
    yield from sensor_faults(floor.acceleration, floor.sample_rate)
    spectrum = estimate_spectrum(floor.acceleration, floor.sample_rate, RESOLUTION_HZ)
    ratio = slow_ratio(spectrum.frequencies_hz, spectrum.density)
    if ratio > SLOW_RATIO:
        yield (
            f"At {SLOW_HZ[0]:g} to {SLOW_HZ[1]:g} Hz the floor's acceleration per √Hz is {ratio:.2g} times that at "
            f"{HEARD_HZ[0]:g} to {HEARD_HZ[1]:g} Hz: the weak integrators pass it on, and from about 8 times on the "
            "adaptation breaks although its mean converges. Take a high-pass of 2 Hz over the record, of 4 Hz "
            "where that is not enough; a smaller start does not help."
        )


def described(floor: RecordedFloor) -> Iterator[str]:
    """What a floor is, sentence by sentence."""
    sensors = "1 floor sensor" if floor.channels == 1 else f"{floor.channels} floor sensors"
    yield f"{floor.source}: {sensors}, {floor.duration:.0f} s."
    rms, peak = 1e3 * floor.acceleration.std(axis=1), 1e3 * np.abs(floor.acceleration).max()
    yield f"Rms acceleration {_list(f'{each:.3g}' for each in rms)} mm/s², peak {peak:.3g} mm/s²."
    spectrum = estimate_spectrum(floor.acceleration, floor.sample_rate, RESOLUTION_HZ)
    f = spectrum.frequencies_hz
    met = [criterion_met(*one_third_octave_velocity(f, row)) for row in spectrum.density]
    yield f"Finest criterion met up to 80 Hz, by sensor: {_list(met)}."


def findings(isolated: Isolated) -> Iterator[str]:
    """What the isolator makes of a floor, sentence by sentence; every word follows from the numbers of this run."""
    if not isolated.moving[1:].any():
        yield "The plate moves up and down without tilting, so the tilts are not judged."
    parts = isolated.floor[:, : isolated.training], isolated.floor[:, isolated.training :]
    taught, judged = (part[isolated.moving].std() for part in parts)
    if not 1 / OTHER < judged / taught < OTHER:
        yield f"The floor moves {judged / taught:.3g} times as much where it is judged as where it was learnt."
    left = {name: isolated.left(name) for name in isolated.platform}
    seen = isolated.left("FeRLS", training=True)
    for k in np.flatnonzero(isolated.moving):
        parts = _list(f"{name} {values[k]:.3g}" for name, values in left.items())
        yield f"{DIRECTIONS[k]}: rms acceleration of the platform over the floor's: {parts}."
        yield f"  {_compared('The feedback', left['feedback'][k] / left['passive'][k], 'the passive rig')}"
        share = isolated.noise_share[k]
        if share > SAME:
            yield f"  {100 * share:.0f} % of what moves with feedback is noise of the platform's own sensors."
        yield f"  {_compared('The feedforward', left['FeRLS'][k] / left['feedback'][k], 'feedback alone')}"
        if left["FeRLS"][k] > (1 + SAME) * seen[k]:
            yield f"  On the part that it learnt on it left {seen[k]:.3g}; the floor changed, or noise was learnt."
    fifth = len(isolated.progress) // 5
    before, last = np.median(isolated.progress[-2 * fifth :].reshape(2, fifth), axis=1)
    if last < (1 - SAME) * before:
        yield "The filtered error was still falling when the training part ended."


def crossing(gains: np.ndarray, left: dict[str, np.ndarray], direction: str = "z") -> str:
    """How loud the floor must be for the feedforward to leave less motion in a direction than the passive rig."""
    pays = left["FeRLS"] < left["passive"]
    if pays.all():
        return f"In {direction} the feedforward leaves less motion than the passive rig even on a floor {gains[0]:.2g} times as loud."
    if not pays.any():
        return f"In {direction} the feedforward leaves more motion than the passive rig even on a floor {gains[-1]:.2g} times as loud."
    if not pays[-1]:
        some = _list(f"{gain:.2g}" for gain in gains[pays])
        return f"In {direction} the feedforward leaves less motion than the passive rig only on a floor {some} times as loud."
    ratio = np.log(left["FeRLS"] / left["passive"])
    at = 1 + int(np.flatnonzero(~pays)[-1])
    gain = np.exp(np.interp(0.0, -ratio[at - 1 : at + 1], np.log(gains[at - 1 : at + 1])))
    return f"In {direction} the feedforward leaves less motion than the passive rig from {gain:.2g} times this floor's amplitude on."


def crossings(twin: Twin, floor: RecordedFloor, gains: np.ndarray) -> Iterator[str]:
    """`crossing` in z, and in the tilts of a floor whose sensors see different motions."""
    yield crossing(gains, optimal_residual_ratio(twin, translating_spectrum(floor), gains))
    tilting = tilting_spectrum(floor)
    if tilting is not None:
        for direction in DIRECTIONS[1:]:
            yield crossing(gains, optimal_residual_ratio(twin, tilting, gains, direction), direction)


def _compared(who: str, ratio: float, other: str) -> str:
    if abs(ratio - 1) <= SAME:
        return f"{who} makes neither better nor worse than {other} (within {100 * SAME:.0f} %)."
    if ratio < 1:
        return f"{who} takes {100 * (1 - ratio):.0f} % off the motion of {other}."
    return f"{who} moves the platform {ratio:.2g} times as much as {other}."


def _list(words) -> str:
    return ", ".join(map(str, words))


_COLOURS = {"floor": figures.RED, "passive": figures.PURPLE, "feedback": figures.BLUE, "FeRLS": figures.BLACK}
_SHOWN_HZ = (1.0, 400.0)
_GROUPS = {
    "weights of acceleration": figures.BLUE,
    "of its integral": figures.GREEN,
    "of its double integral": figures.RED,
}


def paint_floor(floor: RecordedFloor):
    """The sensors' mean and what one sees beside it, over time; each in one-third-octave velocity."""
    figure, (left, right) = figures.new(1, 2, height=3.4)
    time_s = np.arange(floor.acceleration.shape[1]) / floor.sample_rate
    common = floor.acceleration.mean(axis=0)
    own = floor.acceleration[0] - common
    single = len(floor.acceleration) == 1
    left.plot(time_s, common, lw=0.6, label="acceleration" if single else "mean of the sensors")
    if np.abs(own).max() > 1e-9 * np.abs(common).max():
        left.plot(time_s, own, lw=0.6, color=figures.ORANGE, label="sensor 1 less the mean")
    left.set(xlabel="time (s)", ylabel="floor acceleration (m/s²)")
    spectrum = estimate_spectrum(floor.acceleration, floor.sample_rate, RESOLUTION_HZ)
    for number, row in enumerate(spectrum.density, 1):
        centres, velocity = one_third_octave_velocity(spectrum.frequencies_hz, row)
        shown = (centres >= _SHOWN_HZ[0]) & (centres <= _SHOWN_HZ[1]) & (velocity > 1e-4 * velocity.max())
        label = "velocity by band" if single else "velocity by band, each sensor"
        label = label if number == 1 else f"_sensor {number}"
        right.loglog(centres[shown], velocity[shown], "o-", ms=2.5, lw=0.8, color=figures.GREEN, label=label)
    low, high = right.get_ylim()
    _criteria(right)
    right.set(xlabel="one-third-octave band (Hz)", ylabel="rms velocity (m/s)")
    right.set(xlim=(0.3, 600), ylim=(low / 3, high * 3))
    lines = [line for axes in (left, right) for line in axes.get_legend_handles_labels()[0]]
    figure.legend(handles=lines, loc="outside lower center", ncols=3)
    return figure


def paint_isolated(isolated: Isolated):
    """Spectra of floor and platform on the test part, by case; directions in which the floor rests are left out."""
    figure, axes = figures.new(1, int(np.sum(isolated.moving)), height=3.0, squeeze=False)
    signals = {"floor": isolated.floor, **isolated.platform}
    spectra = {
        name: estimate_spectrum(rows[:, isolated.training :], isolated.sample_rate, 2 * RESOLUTION_HZ)
        for name, rows in signals.items()
    }
    units = ("(m/s²)²/Hz", "(rad/s²)²/Hz", "(rad/s²)²/Hz")
    for k, panel in zip(np.flatnonzero(isolated.moving), axes[0], strict=True):
        for name, spectrum in spectra.items():
            f = spectrum.frequencies_hz
            inside = np.flatnonzero((f >= _SHOWN_HZ[0]) & (f <= _SHOWN_HZ[1]))
            points = inside[thinned(f[inside], spectrum.density[k, inside])]
            look = {"lw": 2.5, "zorder": 1.8} if name == "feedback" else {"lw": 0.9}  # others lie on it
            style = {"color": _COLOURS[name], **look}
            panel.loglog(f[points], spectrum.density[k, points], label=name, **style)
        top = max(line.get_ydata().max() for line in panel.lines)
        panel.set(title=DIRECTIONS[k], xlabel="frequency (Hz)", ylabel=f"PSD ({units[k]})")
        panel.set(ylim=(top * 1e-6, top * 3))
    figures.legend_below(axes[0, 0], 4)
    return figure


def paint_adaptation(isolated: Isolated):
    """How far the feedforward brings the filtered error down while it learns, and how far its weights still move.

    Left the median and the central 80 % of `WINDOW` kept values; right the distance of each group of weights from
    where the training part ends, over its size there.
    """
    figure, (left, right) = figures.new(1, 2, height=2.9)
    run = isolated.adaptation
    whole = len(isolated.progress) // WINDOW * WINDOW
    time_s = run.time_s[:whole].reshape(-1, WINDOW).mean(axis=1)
    low, middle, high = np.quantile(isolated.progress[:whole].reshape(-1, WINDOW), [0.1, 0.5, 0.9], axis=1)
    left.fill_between(time_s, low, high, color=_COLOURS["FeRLS"], alpha=0.2, lw=0, label="central 80 %")
    left.plot(time_s, middle, color=_COLOURS["FeRLS"], lw=1.2, label=f"median of {WINDOW * KEEP_EVERY_S:g} s")
    left.axhline(1, color=figures.GREY, lw=0.8)
    left.set(xlabel="time (s)", ylabel="filtered error, power over\nthat without feedforward", ylim=(0, None))
    left.legend(loc="best")
    sensors = run.weights.shape[2] // 3
    for group, (name, color) in enumerate(_GROUPS.items()):
        weights = run.weights[:, :, group * sensors : (group + 1) * sensors].reshape(len(run.time_s), -1)
        moved = np.linalg.norm(weights - weights[-1], axis=1) / np.linalg.norm(weights[-1])
        right.plot(run.time_s, moved, color=color, lw=1.2, label=name)
    right.set(xlabel="time (s)", ylabel="distance from the last weights")
    right.legend()
    return figure


def paint_gain(gains: np.ndarray, left: dict[str, np.ndarray]):
    """Rms motion in z over that of the floor, 1-300 Hz, for a louder or quieter floor; optimum weights."""
    figure, axes = figures.new(1, 1, height=2.8)
    for name, values in left.items():
        width = 3.5 if name == "feedback" else 1.5  # FeRLS lies on it where noise dominates
        axes.loglog(gains, values, color=_COLOURS[name], lw=width, label=name)
    axes.axhline(1, color=figures.GREY, lw=0.8, label="as much as the floor")
    axes.axvline(1, color=figures.GREY, lw=0.8, ls="--", label="this floor")
    axes.set(xlabel="amplitude over this floor's", ylabel="platform over floor in z, rms")
    axes.legend()
    return figure


def explore_floor(twin: Twin, floor: SpectralFloor):
    """Explorer: one-third-octave velocity in z of a louder floor and of the platform, with other sensors."""
    f = np.geomspace(0.8, 299, 400)
    twin, _ = select_floor_sensors(twin, floor.channels)

    def paint(gain: float, output_noise: float):
        changed = twin.varied(platform_noise=output_noise * 1e-4)
        louder = replace(floor, levels=gain**2 * floor.levels)
        weights = steady_state(changed, louder, frequencies_hz=COARSE_HZ).weights
        figure, axes = figures.new(1, 1, height=3.2)
        curves = {"floor": louder.density(f)[0]}
        for name, options in _cases(weights).items():
            curves[name] = _expected(changed, louder, f, options)
        for name, density in curves.items():
            centres, velocity = one_third_octave_velocity(f, density)
            axes.loglog(centres, velocity, "o-", ms=2.5, lw=0.9, color=_COLOURS[name], label=name)
        _criteria(axes)
        axes.set(xlabel="one-third-octave band (Hz)", ylabel="rms velocity in z (m/s)")
        axes.set_ylim(bottom=1e-9)
        axes.legend(loc="upper left", ncols=4)
        return figure

    return paint


def _criteria(axes) -> None:
    bands = 2.0 ** (np.arange(0, 20) / 3)
    for name in ("VC-A", "VC-C", "VC-E", "VC-G", "VC-I", "VC-K", "VC-M"):
        defined = bands[bands > 3.9] if name == "VC-A" else bands
        limit = criterion_velocity(name, defined)
        axes.loglog(defined, limit, "--", color=figures.GREY, lw=0.7, label=f"_{name}")
        style = {"color": figures.GREY, "fontsize": 7, "ha": "right", "va": "center", "annotation_clip": True}
        axes.annotate(name, (defined[0] / 1.1, limit[0]), **style)
