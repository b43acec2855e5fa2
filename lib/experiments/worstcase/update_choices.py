"""Sections 6 and 7, the recursions, at any reading of what the worst-case paper leaves open (``readings.toml``)."""

import numpy as np

from experiments.worstcase.simulations import FIG_2_PARAMETERS, path
from experiments.worstcase.theory import recursion_trial
from workbook.studies import run_study

SMALL_BOUND, SAMPLES = 0.1, 375  # of notebook 03, which has this bound beside the large one


def updates(*, fig_2_noise: float, update_bound: float, seed: int, lean: bool) -> dict[str, float]:
    """Theorem 2, the misprint of h and (20)'s single iteration; the lean form takes 2 records instead of 10."""
    truth = path("constant", FIG_2_PARAMETERS, SAMPLES)
    small, large = (
        run_study(
            recursion_trial, 2 if lean else 10, seed, progress=False,
            truth=truth, bound=bound, forgetting=0.95, noise=fig_2_noise,
        )
        for bound in (SMALL_BOUND, update_bound)
    )  # fmt: skip
    found = {
        "theorem-2": max(study[name].max() for study in (small, large) for name in ("exact", "fast")),
        "h-as-printed": np.nanmedian(large["as_printed"]),
        "eq-18-as-printed": np.nanmedian(large["image_as_printed"]),
        "single-iteration": np.median(large["approximate_1"][:, 10:]),
        "single-iteration-large": np.nanmedian(large["alpha_1"]),
        "single-iteration-tail": np.nanquantile(large["alpha_1"], 0.95),
        "single-iteration-largest": np.nanmax(large["alpha_1"]),
    }
    return {f"worstcase.updates.{name}": value for name, value in found.items()}
