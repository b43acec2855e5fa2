"""What the isolator makes of a floor, learnt on one part of it and judged on the rest (notebook 08)."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64
from numpy.typing import ArrayLike

from experiments.isolation.performance import DIRECTIONS, central_axes, expected_density
from experiments.isolation.power import BAND_HZ
from experiments.isolation.recorded_floors import RecordedFloor, SpectralFloor
from experiments.isolation.simulation import Run, simulate
from experiments.isolation.steady import FORGETTING, steady_state
from experiments.isolation.twin import Twin
from stillwork.base.checks import InputError, require_array, require_number
from stillwork.estimation.adaptive import FeRls
from stillwork.signals.criteria import criterion_met, one_third_octave_velocity
from stillwork.signals.spectra import band_power, estimate_spectrum

SETTLE_S = 5.0  # cut off before anything is judged
TRAINING_SHARE = 2 / 3  # of the floor, its first part; the weights never see the rest
KEEP_EVERY_S = 0.2
RESOLUTION_HZ = 0.25
SAME = 0.1  # a change of the motion by less is called none: chosen
_GRID = np.unique(np.concatenate([np.geomspace(0.02, 2400, 600), np.arange(1.0, 300.0, 0.5)]))


@dataclass(frozen=True)
class Isolated:
    """A floor and what the platform does above it.

    Attributes
    ----------
    floor : ndarray, shape (3, samples)
        The plate in z, θx, θy, without sensor noise; m/s^2 and rad/s^2; from `SETTLE_S` on.
    platform : dict of str to ndarray, shape (3, samples)
        The platform's real motion, by case: ``passive``, ``feedback``, ``FeRLS`` with frozen weights.
    quiet : ndarray, shape (3, samples)
        Case ``feedback`` with sensors that have no noise.
    training : int
        Samples before the part that the weights have not seen.
    adaptation : Run
        FeRLS from zero over the training part.
    progress : ndarray, shape (kept,)
        Power of the filtered error while FeRLS adapts, over that without feedforward in the same instants.
    sample_rate : float
        Hz.
    """

    floor: Float64[np.ndarray, "3 samples"]
    platform: dict[str, Float64[np.ndarray, "3 samples"]]
    quiet: Float64[np.ndarray, "3 samples"]
    training: int
    adaptation: Run
    progress: Float64[np.ndarray, " kept"]
    sample_rate: float

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


def hear(twin: Twin, channels: int) -> tuple[Twin, Float64[np.ndarray, "sensors channels"]]:
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

    Raises
    ------
    UnstableAdaptation
        Where the adaptation diverges on this floor, see `simulate`.
    """
    require_number("start", start, above=0.0)
    axes = central_axes(twin.rig)
    twin, spread = hear(twin, floor.channels)
    training_s = round(TRAINING_SHARE * floor.duration / KEEP_EVERY_S) * KEEP_EVERY_S

    def run(**options) -> Run:
        return simulate(twin, floor, signals_from_s=SETTLE_S, keep_every_s=KEEP_EVERY_S, **options)

    before = run(seed=seed)
    rate = before.sample_rate
    training = round((training_s - SETTLE_S) * rate)
    settings = steady_start(before.filtered_regressors[:, :training], start)
    adaptation = simulate(twin, floor, training_s, adaptation=settings, seed=seed, keep_every_s=KEEP_EVERY_S)
    cases = {
        "passive": run(seed=seed + 1, feedback=False),
        "feedback": run(seed=seed + 1),
        "FeRLS": run(seed=seed + 1, weights=adaptation.final_weights),
    }
    return Isolated(
        axes.floor @ spread @ before.floor,
        {name: axes.platform @ case.platform for name, case in cases.items()},
        axes.platform @ run(seed=seed + 1, noise=False).platform,
        training,
        adaptation,
        adaptation.error_power / before.error_power[: len(adaptation.error_power)],
        rate,
    )


def steady_start(regressors: Float64[np.ndarray, "regressors samples"], start: float = 1.0) -> FeRls:
    """FeRLS that begins at `start` times the steady P of uncorrelated filtered regressors."""
    return FeRls(start * (1 - FORGETTING) / np.mean(regressors**2, axis=1))


def translating_spectrum(floor: RecordedFloor) -> SpectralFloor:
    """Spectrum of the mean of a floor's sensors, for a rig that hears it with one."""
    spectrum = estimate_spectrum(floor.acceleration.mean(axis=0), floor.sample_rate, RESOLUTION_HZ)
    return SpectralFloor(spectrum.frequencies_hz[1:], spectrum.density[0, 1:], floor.source, 1)


def optimum_left(
    twin: Twin, floor: SpectralFloor, gains: ArrayLike
) -> dict[str, Float64[np.ndarray, " gains"]]:
    """Rms motion in z at 1-300 Hz over the floor's, for a louder or quieter floor and the optimum weights.

    From spectra alone, for a plate that only translates.

    Parameters
    ----------
    twin : Twin
        Rig with geometry.
    floor : SpectralFloor
        Of one sensor.
    gains : array_like, shape (gains,)
        Amplitude of the floor relative to `floor`.
    """
    f = np.geomspace(*BAND_HZ, 1500)[:-1]
    twin, _ = hear(twin, floor.channels)
    left: dict[str, list[float]] = {"passive": [], "feedback": [], "FeRLS": []}
    for gain in require_array("gains", gains, ndim=1):
        scaled = replace(floor, levels=gain**2 * floor.levels)
        moved = band_power(f, scaled.density(f)[0], f[0], f[-1])
        weights = steady_state(twin, scaled, frequencies_hz=_GRID).weights
        for name, options in (
            ("passive", {"feedback": False}),
            ("feedback", {}),
            ("FeRLS", {"weights": weights}),
        ):
            density = sum(expected_density(twin, scaled, f, sensed=False, **options).values())[0]
            left[name].append(np.sqrt(band_power(f, density, f[0], f[-1]) / moved))
    return {name: np.array(values) for name, values in left.items()}


def described(floor: RecordedFloor) -> Iterator[str]:
    """What a floor is, sentence by sentence."""
    sensors = "1 floor sensor" if floor.channels == 1 else f"{floor.channels} floor sensors"
    yield f"{floor.source}: {sensors}, {floor.duration:.0f} s."
    rms, peak = 1e3 * floor.acceleration.std(axis=1), 1e3 * np.abs(floor.acceleration).max()
    yield f"Rms acceleration {_list(f'{each:.3g}' for each in rms)} mm/s², peak {peak:.3g} mm/s²."
    spectrum = estimate_spectrum(floor.acceleration, floor.sample_rate, RESOLUTION_HZ)
    met = [
        criterion_met(*one_third_octave_velocity(spectrum.frequencies_hz, row)) for row in spectrum.density
    ]
    yield f"Finest criterion met at 8-80 Hz, by sensor: {_list(met)}."


def findings(isolated: Isolated) -> Iterator[str]:
    """What the isolator makes of a floor, sentence by sentence; every word follows from the numbers of this run."""
    if not isolated.moving[1:].any():
        yield "The plate moves up and down without tilting, so the tilts are not judged."
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


def crossing(gains: np.ndarray, left: dict[str, np.ndarray]) -> str:
    """How loud the floor must be for the feedforward to leave less motion than the passive rig, as a sentence."""
    pays = left["FeRLS"] < left["passive"]
    if pays.all():
        return f"Even {gains[0]:.2g} times as loud, the feedforward leaves less motion than the passive rig."
    if not pays.any():
        return f"Not even {gains[-1]:.2g} times as loud does the feedforward leave less motion than the passive rig."
    ratio = np.log(left["FeRLS"] / left["passive"])
    at = int(np.argmax(pays))
    gain = np.exp(np.interp(0.0, -ratio[at - 1 : at + 1], np.log(gains[at - 1 : at + 1])))
    return f"The feedforward leaves less motion than the passive rig from {gain:.2g} times this floor's amplitude on."


def _compared(who: str, ratio: float, other: str) -> str:
    if abs(ratio - 1) <= SAME:
        return f"{who} makes neither better nor worse than {other} (within {100 * SAME:.0f} %)."
    if ratio < 1:
        return f"{who} takes {100 * (1 - ratio):.0f} % off the motion of {other}."
    return f"{who} moves the platform {ratio:.2g} times as much as {other}."


def _list(words) -> str:
    return ", ".join(map(str, words))
