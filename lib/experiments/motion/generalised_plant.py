"""Generalised plants, (5.1)-(5.3) of the observer thesis."""

from dataclasses import dataclass

import numpy as np

from stillwork.base.checks import InputError, require_number
from stillwork.base.front_door import check_fields
from stillwork.lti.state_space import StateModel


@dataclass(frozen=True)
class GeneralisedPlant:
    """A model from (w, u) to (z, y): exogenous inputs and controls to performance and measurements, (5.1)."""

    model: StateModel
    exogenous: int  # number of w
    performance: int  # number of z

    def __post_init__(self):
        check_fields(self)
        outputs, inputs = self.model.d.shape
        if not 0 < self.exogenous < inputs or not 0 < self.performance < outputs:
            raise InputError(
                f"a model with {inputs} inputs and {outputs} outputs cannot have {self.exogenous} exogenous "
                f"inputs and {self.performance} performance outputs; leave controls and measurements"
            )

    @property
    def blocks(self) -> tuple[np.ndarray, ...]:
        """A, B1, B2, C1, C2, D11, D12, D21, D22."""
        m, w, z = self.model, self.exogenous, self.performance
        d = [part for row in (m.d[:z], m.d[z:]) for part in np.split(row, [w], axis=1)]
        return m.a, m.b[:, :w], m.b[:, w:], m.c[:z], m.c[z:], *d

    def close(self, observer: StateModel) -> StateModel:
        """The closed loop (5.3) from w to z, with the feedthrough D22 that (5.3) leaves out."""
        a, b1, b2, c1, c2, d11, d12, d21, d22 = self.blocks
        if observer.d.shape != (b2.shape[1], len(c2)):
            raise InputError(
                f"observer has shape {observer.d.shape}; give {b2.shape[1]} outputs and {len(c2)} inputs"
            )
        turn = np.linalg.inv(np.eye(b2.shape[1]) - observer.d @ d22)
        # u = turn (C_o x_o + D_o (C2 x + D21 w)), y = C2 x + D21 w + D22 u
        u_x, u_o, u_w = turn @ observer.d @ c2, turn @ observer.c, turn @ observer.d @ d21
        whole = np.block(
            [[a + b2 @ u_x, b2 @ u_o], [observer.b @ (c2 + d22 @ u_x), observer.a + observer.b @ d22 @ u_o]]
        )
        b = np.vstack([b1 + b2 @ u_w, observer.b @ (d21 + d22 @ u_w)])
        c = np.hstack([c1 + d12 @ u_x, d12 @ u_o])
        return StateModel(whole, b, c, d11 + d12 @ u_w)


def low_pass(corner_hz: float) -> StateModel:
    """First-order low-pass of unit gain."""
    w = 2 * np.pi * require_number("corner_hz", corner_hz, above=0.0)
    return StateModel(np.array([[-w]]), np.array([[w]]), np.array([[1.0]]), np.zeros((1, 1)))
