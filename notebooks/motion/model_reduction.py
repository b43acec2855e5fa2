"""Model reduction (notebook 02): how far the anti-resonances move, and the explorer."""

import numpy as np

from experiments.motion.machines import chain
from experiments.motion.pictures import paint_bode
from stillwork.lti.modal import ModalModel
from stillwork.lti.peaks import resonance_grid
from stillwork.lti.reduction import roll_off, truncate
from workbook import figures


def anti_resonance_shifts(
    full: ModalModel, plain: ModalModel, compensated: ModalModel, below: float
) -> dict[str, np.ndarray]:
    """Relative shift of each anti-resonance of the full model under a frequency (rad/s), in both reduced models."""
    models = {"full": full, "plain": plain, "compensated": compensated}
    places = {
        name: np.sort(np.unique(np.abs(model.state_space().zeros).round(9))) for name, model in models.items()
    }
    kept = places["full"][places["full"] < below]
    return {name: np.abs(places[name][: len(kept)] / kept - 1) for name in ("plain", "compensated")}


def paint_reduction(retained: int, cutoff_hz: float):
    """Explorer: model error of the reduced ten-mass chain, with and without compliance."""
    full = chain(np.full(10, 2.0)).at([0], [0])
    omega = resonance_grid(full.poles, 0.3, 300.0, 300, 20)
    exact = full.frequency_response(omega)[0, 0]
    compensated = truncate(full, int(retained), 10 - int(retained))
    reduced = {
        "truncated": truncate(full, int(retained)),
        "with compliance": compensated,
        "rolled off": roll_off(compensated, cutoff_hz),
    }
    curves = {"full": (omega, exact)}
    for name, each in reduced.items():
        curves[f"error, {name}"] = omega, exact - each.frequency_response(omega)[0, 0]
    grey = {"full": {"color": figures.GREY}}
    return paint_bode(curves, "magnitude (dB re 1 m/N)", styles=grey, height=3.2)[0]
