"""Tables 6.2 to 6.4 of the observer thesis at any reading of what chapter 6 leaves open (``readings.toml``)."""

from functools import lru_cache

import numpy as np

from experiments.motion.rig import assumed_geometry
from experiments.motion.rig_designs import CASES, bandwidths, model_errors, published_settings, rig_loops
from experiments.motion.rig_loops import RigBandwidth
from experiments.motion.rig_study import Rig, levelling, levelling_errors, sample_geometry
from experiments.motion.shares import Values, central

DIRECTIONS = ("z", "rx", "ry")
GEOMETRIES = 36


def rig_tables(
    *,
    six_db_of_a_matrix: str,
    rig_plates: str,
    rig_controllers_at: str,
    rig_noise_floor: float,
    rig_feedforward: str,
    seed: int,
    lean: bool,
) -> Values:
    """Bandwidths of Table 6.2 and ratios of Tables 6.3 and 6.4 over geometries; it has no leaner form.

    `six_db_of_a_matrix` is one of `rig_loops.MEASURES`; `rig_noise_floor` (m at the edges) is in every error;
    `rig_feedforward` is ``exact`` or ``5 % too heavy``.
    """
    crossing, ratios = [], []
    for rig, each in _study(rig_plates, six_db_of_a_matrix, seed):
        crossing.append(
            [[np.nan] * 3 if each[case] is None else each[case].crossing_hz.mean(axis=0) for case in CASES]
        )
        mass_error = 0.05 if rig_feedforward == "5 % too heavy" else 0.0
        errors = levelling_errors(rig, each, rig_controllers_at, rig_noise_floor, mass_error)
        ratios.append(errors[:, 1:] / errors[0, 0])
    crossing, ratios = np.array(crossing), np.array(ratios)
    found: Values = {}
    for k, case in enumerate(CASES):
        name = case.lower().replace(" and ", "-")
        for d, direction in enumerate(DIRECTIONS):
            found[f"motion.table-6-2.{name}.{direction}"] = _of_feasible(crossing[:, k, d])
            if k:
                for t, table in enumerate(("6-3", "6-4")):
                    entry = f"motion.table-{table}.ratio.{name}.{direction}"
                    found[entry] = _of_feasible(ratios[:, t, k - 1, d])
    return found


def _of_feasible(sample: np.ndarray) -> float | tuple[float, tuple[float, float]]:
    """Of the geometries on which the case has a controller."""
    return central(sample[~np.isnan(sample)])


@lru_cache(maxsize=8)
def _rigs(plates: str, seed: int) -> list[Rig]:
    settings, rigs = published_settings(), []
    for stream in np.random.SeedSequence(seed).spawn(GEOMETRIES):
        rng = np.random.default_rng(stream)
        geometry = assumed_geometry() if plates == "one" else sample_geometry(rng)
        rigs.append((geometry, rig_loops(geometry, settings, model_errors(rng)), levelling(rng)))
    return rigs


@lru_cache(maxsize=8)  # readings that differ in the levelling share the designs
def _study(plates: str, measure: str, seed: int) -> list[tuple[Rig, dict[str, RigBandwidth | None]]]:
    return [(rig, bandwidths(rig[1], rig[0], measure)) for rig in _rigs(plates, seed)]
