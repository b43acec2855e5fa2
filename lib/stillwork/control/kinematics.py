"""The kinematic block: the desired decay of the tracking error, equation (1), for any order."""

from dataclasses import dataclass
from math import comb

import numpy as np
from jaxtyping import Float64

from stillwork.base.bounds import Count, Natural, Positive
from stillwork.base.validation import by_value, check_fields, checked


@by_value
@dataclass(frozen=True)
class KinematicDesign:
    """(Lambda + d/dt)^p of the `integrals`-fold integral of the error is zero, with p = order + integrals.

    The paper's (1) is order 2 with one integral:
    q''_des = q''_N + Lambda^3 int e + 3 Lambda^2 e + 3 Lambda e'.

    Attributes
    ----------
    exponent : float
        Lambda, 1/s.
    integrals : int
        How many times the error is integrated: 0 for PD, 1 for PID, 2 against ramps of disturbance.
    order : int
        Derivative that the plant's input commands: 2 for a mechanical system.

    Raises
    ------
    InputError
        When the exponent is not positive.

    References
    ----------
    Issa, Al-Bkree and Tar, On certain noise filtering techniques in fixed point iteration-based adaptive control,
    (1).

    Examples
    --------
    >>> control.KinematicDesign(exponent=10.0).gains  # of the integral, the error and its derivative
    array([1000.,  300.,   30.])
    """

    exponent: Positive
    integrals: Natural = 1
    order: Count = 2

    def __post_init__(self):
        check_fields(self)

    @property
    @checked
    def gains(self) -> Float64[np.ndarray, " terms"]:
        """Gains from the deepest integral over the error to its derivative of order `order` - 1."""
        power = self.order + self.integrals
        return np.array([comb(power, k) * self.exponent ** (power - k) for k in range(power)])
