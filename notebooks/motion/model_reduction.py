"""Model reduction: what notebook 02 alone needs, with its appendix."""

import numpy as np

from experiments.motion.loop_conditions import slope
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel


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


def appendix(
    page,
    *,
    full: ModalModel,
    plain: ModalModel,
    compensated: ModalModel,
    rolled: StateModel,
    still: np.ndarray,
) -> None:
    """What this notebook judges beside its answer: the lost compliance, and with which power each part of the error falls.

    `still` are frequencies well below the first discarded mode (rad/s).
    """
    page.text("""
## Well below the first discarded mode

The error of the truncated model is the lost compliance. With the compliance a part from the damping of the discarded modes
remains, which falls with the first power only and so dominates at the lowest frequencies.
""")
    exact, kept = full.frequency_response(still)[0, 0], len(plain.frequencies)
    missing = full.modes(slice(kept, None)).compliance()[0, 0]
    lost = abs(exact[0] - plain.frequency_response(still)[0, 0, 0])
    page.check("motion.reduction.compliance", lost / missing)
    error = exact - compensated.frequency_response(still)[0, 0]
    page.show(f"slope of the part from the damping: {slope(still, error.imag):.2f}")
    rest = exact - rolled.frequency_response(still)[0, 0]
    page.show(f"slope with the rolled-off compliance: {slope(still, rest):.2f}")
