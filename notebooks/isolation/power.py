"""Power that remains: what this notebook alone needs."""

from dataclasses import replace

import numpy as np
from scipy import linalg

from experiments.isolation.floors import FLAT_LEVEL, ShapedFloor, flat_floor
from experiments.isolation.performance import ENTRIES
from experiments.isolation.power import RESOLUTION_HZ, limit_ratio_db, power_trial
from experiments.isolation.simulation import TOGETHER
from experiments.isolation.twin import Twin, equal_struts
from workbook.studies import fraction, run_study, spread_interval

FELMS_S, FERLS_S, RECORD_S = 250.0, 60.0, 40.0  # s, of a run of notebook 05
RUNS = 16  # with three directions 48 for an ordering


def power(
    *, mains_in_power: str, seed: int, **open_choices
) -> dict[str, float | tuple[float, tuple[float, float]]]:
    """Fig. 8 with FeRLS by `RUNS` runs, as notebook 05 judges it.

    `mains_in_power` is ``"bridged"`` or ``"counted"``; the others are those of `other_rig`.
    """
    twin, floor = other_rig(**open_choices)
    return judged(power_runs(twin, floor, seed), twin.instruments.mains_hz, mains_in_power == "counted")


def both_algorithms(*, seed: int, **open_choices) -> dict:
    """Fig. 8 with FeLMS, too, which takes four times as long."""
    study = power_runs(*other_rig(**open_choices), seed, felms_s=FELMS_S)
    return {"isolation.fig-8.same-by-both": same_by_both(study)}


def other_rig(
    *, floor_upper_end: float, sensor_levels: str, sensor_correlation: float, **struts: float
) -> tuple[Twin, ShapedFloor]:
    """Rig and floor at a combination of open choices.

    `sensor_levels` are three numbers between colons, `sensor_correlation` the share of the sensors' power that all three
    see alike, `struts` the arguments of `equal_struts`.
    """
    levels = FLAT_LEVEL * np.array([float(level) for level in sensor_levels.split(":")])
    return correlated(equal_struts(**struts), sensor_correlation), flat_floor(floor_upper_end, levels)


def power_runs(twin: Twin, floor: ShapedFloor, seed: int, runs: int = RUNS, felms_s: float | None = None):
    """Runs of the experiment of Fig. 8; FeLMS, which takes most of the time, with `felms_s` alone."""
    settings = {"felms_s": felms_s, "ferls_s": FERLS_S, "record_s": RECORD_S}
    return run_study(
        power_trial, runs, seed, together=TOGETHER, progress=False, twin=twin, floor=floor, **settings
    )


def same_by_both(study) -> tuple[float, tuple[float, float]]:
    """Share of runs and directions in which FeLMS and FeRLS remove the same power within half a point."""
    obeyed = np.abs(study["removed FeLMS"] - study["removed FeRLS"]) < 0.5
    return fraction(obeyed.ravel())


def correlated(twin: Twin, share: float) -> Twin:
    """Twin whose floor sensors see `share` of their power alike.

    Its plant takes three independent motions and mixes them; the feedforward hears the unmixed ones, which changes
    nothing but rounding for FeRLS (notebook 06: it commands the same on any basis).
    """
    count = twin.sensors
    mixing = linalg.sqrtm((1 - share) * np.eye(count) + share * np.ones((count, count))).real
    names = ("floor_damping", "floor_stiffness", "floor_inertia")
    return replace(
        twin, plant=replace(twin.plant, **{name: getattr(twin.plant, name) @ mixing for name in names})
    )


def judged(study, mains_hz, counted: bool = False) -> dict[str, float | tuple[float, tuple[float, float]]]:
    """Every entry that the runs of Fig. 8 decide, with its interval."""
    removed = study["removed with mains" if counted else "removed FeRLS"]
    frequencies = np.arange(study["density FeRLS"].shape[2]) * RESOLUTION_HZ
    found: dict = {
        f"isolation.fig-8.removed.{name}": (float(values.mean()), spread_interval(values))
        for name, values in zip(ENTRIES, removed.T, strict=True)
    }
    for entry, obeyed in {
        "removed.range": (removed > 89.5) & (removed < 94.5),
        "reaches-the-limit": study["removed limit"] - study["removed FeRLS"] < 1.0,
        "low-end-lost": study["low end"] > 1,
        "no-limit-above-300-hz": study["above band"] > study["in band"],
    }.items():
        found[f"isolation.fig-8.{entry}"] = fraction(obeyed.ravel())
    bands, above = limit_ratio_db(
        frequencies, study["density FeRLS"], study["density output noise"], mains_hz
    )
    late = np.flatnonzero(above.max(axis=0) > 3.0)
    after = late[-1] + 1 if len(late) else 0
    found["isolation.fig-8.limit-in-band"] = float(bands[after]) if after < len(bands) else np.nan
    return found
