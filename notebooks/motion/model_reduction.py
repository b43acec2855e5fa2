"""Model reduction (notebook 02): how far the anti-resonances move."""

import numpy as np

from stillwork.lti.modal import ModalModel


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
