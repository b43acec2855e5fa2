"""What the rig's figures share: frequencies, directions with their units, a colour a use of the observer."""

import numpy as np

from experiments.motion.rig import published
from experiments.motion.rig_designs import CASES
from stillwork.lti.peaks import resonance_grid
from workbook import figures

COLOURS = dict(zip(CASES, (figures.BLACK, figures.BLUE, figures.GREEN, figures.RED), strict=True))
FORCES, MOTIONS = ("F_z", "M_x", "M_y"), ("z", "r_x", "r_y")
UNITS = (("m/N", "m/Nm", "m/Nm"), ("rad/N", "rad/Nm", "rad/Nm"), ("rad/N", "rad/Nm", "rad/Nm"))


def frequencies(
    low_hz: float = 5.0, high_hz: float = 2000.0, points: int = 200, around: int = 15
) -> np.ndarray:
    """Frequencies of the figures (rad/s), dense around the published modes."""
    p = published()
    w, z = 2 * np.pi * np.array(p["frequencies_hz"]), np.array(p["damping"])
    return resonance_grid(w * (-z + 1j), low_hz, high_hz, points, around)
