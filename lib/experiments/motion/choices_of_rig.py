"""Tables 6.2 to 6.4 of the observer thesis at any reading of what chapter 6 leaves open (``readings.toml``)."""

from functools import lru_cache

import numpy as np

from experiments.motion.intervals import Values, central
from experiments.motion.rig import assumed_geometry
from experiments.motion.rig_designs import CASES, bandwidths, model_errors, published_settings, rig_loops
from experiments.motion.rig_study import levelling, levelling_errors, printed_controllers, sample_geometry

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

    `six_db_of_a_matrix` is one of `rig_loops.MEASURES`; the controllers are those of the search (``own limit``) or have
    the ``printed`` bandwidths; `rig_noise_floor` (m at the edges) is in every error; `rig_feedforward` is ``exact`` or
    ``5 % too heavy``.
    """
    noise, mass_error = published_settings().noise, 0.05 if rig_feedforward == "5 % too heavy" else 0.0
    crossing, ratios = [], []
    for loops, trajectory, designs in _study(rig_plates, six_db_of_a_matrix, seed):
        crossing.append([each.crossing_hz.mean(axis=0) for each in designs.values()])
        first = loops["Original"][0]
        if rig_controllers_at == "printed":
            pids = printed_controllers(first)
        else:
            pids = {case: each.pids for case, each in designs.items()}
        errors = levelling_errors(loops, pids, trajectory, noise, mass_error)
        errors = np.hypot(errors, rig_noise_floor / first.decoupling.edges)
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
def _rigs(plates: str, seed: int) -> list[tuple]:
    """Loops and trajectory of each geometry."""
    settings, rigs = published_settings(), []
    for stream in np.random.SeedSequence(seed).spawn(GEOMETRIES):
        rng = np.random.default_rng(stream)
        geometry = assumed_geometry() if plates == "one" else sample_geometry(rng)
        rigs.append((rig_loops(geometry, settings, model_errors(rng)), levelling(rng)))
    return rigs


@lru_cache(maxsize=8)  # readings that differ in the levelling share the designs
def _study(plates: str, measure: str, seed: int) -> list[tuple]:
    """And the designs."""
    return [(*rig, bandwidths(rig[0], measure)) for rig in _rigs(plates, seed)]
