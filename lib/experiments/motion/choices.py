"""The designs of chapter 3 at any reading of what the thesis leaves open (``choices.toml``)."""

from dataclasses import replace
from functools import lru_cache

from experiments.motion.designs import (
    DESIGNS,
    NOISE_MODEL,
    Design,
    stage_bandwidth,
    stage_loops,
)
from experiments.motion.machines import stage
from stillwork.control.bandwidth import SIX_DB, Bandwidth, Loop

COMPENSATIONS = {  # what keeps the integral action of MC: Q_nu, and the corner of a high-pass (Hz)
    "noise model": (NOISE_MODEL, None),
    "high-pass": (None, 1.0),
    "nothing": (None, None),
}
TARGET = 0.04  # wanted damping ratio, section 3.3.2
SIX = {"6 dB": SIX_DB, "2": 2.0}


@lru_cache(maxsize=128)  # readings that differ in the loop or the mass share the search
def limit(name: str, six: str, compensation: str, stage_damping: float) -> tuple[list[Loop], Bandwidth]:
    """The seven loops of a design and the largest bandwidth that they allow."""
    design = as_read(DESIGNS[name], compensation, stage_damping)
    found = stage_bandwidth(design, damping_ratio=stage_damping, limit=SIX[six])
    return stage_loops(design, plant=stage(stage_damping)), found


def as_read(design: Design, compensation: str, stage_damping: float) -> Design:
    """A design with another way of keeping the integral action, and damped up to the wanted ratio."""
    used, noise_model = design.application, design.noise_model
    if used is not None and used.damping:  # up to the wanted ratio, from what the stage has
        used = replace(used, damping=TARGET - stage_damping)
    if noise_model == NOISE_MODEL:  # printed for MC with the noise model, which is one way of two
        noise_model, high_pass_hz = COMPENSATIONS[compensation]
        used = replace(used, high_pass_hz=high_pass_hz)
    return replace(design, application=used, noise_model=noise_model)
