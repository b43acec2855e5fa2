"""What the isolator makes of a floor: any record, or the measured ground (notebook 08)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64
from numpy.typing import ArrayLike

from experiments.isolation.performance import central_axes, expected_density
from experiments.isolation.power import BAND_HZ
from experiments.isolation.recorded_floors import RecordedFloor, ground_floor, ground_spectrum, record_floor
from experiments.isolation.simulation import Run, simulate
from experiments.isolation.steady import FORGETTING, steady_state
from experiments.isolation.twin import Twin
from stillwork.base.checks import InputError, require_array
from stillwork.estimation.adaptive import FeRls
from stillwork.signals.records import load_record
from stillwork.signals.spectra import band_power

# Follows the lines of the measured ground.
_GRID = np.unique(np.concatenate([np.geomspace(0.02, 2400, 600), np.arange(1.0, 300.0, 0.5)]))
SETTLE_S = 5.0  # cut off before anything is judged
SHORTEST_S = 15.0  # the adaptation's own time constant is 10 s


@dataclass(frozen=True)
class Isolated:
    """A floor and what the platform does above it.

    Attributes
    ----------
    floor : ndarray, shape (3, samples)
        The plate in z, θx, θy, without sensor noise; m/s^2 and rad/s^2.
    platform : dict of str to ndarray, shape (3, samples)
        The platform's real motion, by case: ``passive``, ``feedback``, ``FeRLS`` with frozen weights.
    adaptation : Run
        FeRLS from zero over the whole floor.
    sample_rate : float
        Hz.
    """

    floor: Float64[np.ndarray, "3 samples"]
    platform: dict[str, Float64[np.ndarray, "3 samples"]]
    adaptation: Run
    sample_rate: float

    @property
    def moving(self) -> Bool[np.ndarray, "3"]:
        """Directions in which the floor plate moves at all; a record of one channel does not tilt it."""
        travel = self.floor.std(axis=1) * np.array([1.0, 0.1, 0.1])  # tilts at a lever of 0.1 m
        return travel > 1e-9 * travel.max()

    def left(self, name: str) -> Float64[np.ndarray, "3"]:
        """Rms acceleration of a case over that of the floor plate; NaN where the plate does not move."""
        floor = np.where(self.moving, self.floor.std(axis=1), np.nan)
        return self.platform[name].std(axis=1) / floor


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
    """Floor from a record, or synthesised from the measured ground when no record is named.

    Parameters
    ----------
    floor_record : str
        Path of a CSV, MAT or NPZ file, see `stillwork.signals.records.load_record`; empty for the ground.
    unit : str
        Of the record.
    rate_hz : float
        Of the record; 0 where the file tells it.
    channels : list of str
        Channels to take, as many as floor sensors at most; empty for all.
    twin : Twin
        Whose sensors the floor moves.
    ground_gain, common, duration_s, seed
        Amplitude of the ground relative to the measured one, share of its power that all sensors see alike,
        seconds, and the seed of its motion.

    Raises
    ------
    InputError
        For everything that makes the record unusable; it says what to do.
    """
    rate = twin.instruments.sample_rate
    if not floor_record:
        return ground_floor(
            duration_s,
            seed,
            gain=ground_gain,
            common=common,
            channels=twin.sensors,
            sample_rate=rate,
        )
    record = load_record(
        floor_record,
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
    return record_floor(record, channels=twin.sensors, sample_rate=rate)


def isolate(twin: Twin, floor: RecordedFloor, seed: int) -> Isolated:
    """Run a floor through the passive rig, with feedback, with FeRLS from zero, and with the weights it ends at.

    The frozen weights are judged on the floor they were tuned on, with other sensor noise. FeRLS starts from
    (1 - lambda) over the power of each filtered regressor, the steady value for uncorrelated regressors.
    """
    axes = central_axes(twin.rig)

    def run(**options) -> Run:
        return simulate(twin, floor, signals_from_s=SETTLE_S, **options)

    before = run(seed=seed)
    power = np.mean(before.filtered_regressors**2, axis=1)
    settings = FeRls((1 - FORGETTING) / power)
    adaptation = simulate(twin, floor, adaptation=settings, seed=seed, keep_every_s=0.2)
    cases = {
        "passive": run(seed=seed + 1, feedback=False),
        "feedback": before,
        "FeRLS": run(seed=seed + 1, weights=adaptation.final_weights),
    }
    return Isolated(
        axes.floor @ before.floor,
        {name: axes.platform @ case.platform for name, case in cases.items()},
        adaptation,
        before.sample_rate,
    )


def optimum_left(twin: Twin, gains: ArrayLike) -> dict[str, Float64[np.ndarray, " gains"]]:
    """Rms motion in z at 1-300 Hz over the floor's, for a louder measured ground and the optimum weights.

    From spectra alone; the three sensors move independently.

    Parameters
    ----------
    twin : Twin
        Rig with geometry.
    gains : array_like, shape (gains,)
        Amplitude of the ground relative to the measured one.
    """
    f = np.geomspace(*BAND_HZ, 1500)[:-1]
    left: dict[str, list[float]] = {"passive": [], "feedback": [], "FeRLS": []}
    for gain in require_array("gains", gains, ndim=1):
        floor = ground_spectrum(gain=float(gain))
        weights = steady_state(twin, floor, frequencies_hz=_GRID).weights
        axes = central_axes(twin.rig)
        moved = band_power(f, np.sum(axes.floor[0] ** 2) * floor.density(f)[0], f[0], f[-1])
        for name, options in (
            ("passive", {"feedback": False}),
            ("feedback", {}),
            ("FeRLS", {"weights": weights}),
        ):
            density = sum(expected_density(twin, floor, f, sensed=False, **options).values())[0]
            left[name].append(np.sqrt(band_power(f, density, f[0], f[-1]) / moved))
    return {name: np.array(values) for name, values in left.items()}
