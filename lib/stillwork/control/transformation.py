"""From the response and the desired acceleration to the next command: (6) and (8), and a disturbance observer."""

import warnings
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float64

from stillwork.base.bounds import Positive, within
from stillwork.base.checks import InputError
from stillwork.base.kernels import pasted_kernel
from stillwork.base.validation import by_value, check_fields, checked


class ContractionWarning(UserWarning):
    """The iteration does not contract with this gain; the message gives the range in which it does."""


@by_value
@dataclass(frozen=True)
class FlowTransformation:
    """Transformation (6): deformed += A sigma((response - desired) / w), sigma(x) = x / (1 + |x|).

    Attributes
    ----------
    gain : float
        A, m/s^2 a step (the paper prints s^-2); negative for a plant that follows its command.
    width : float
        w, m/s^2.

    Raises
    ------
    InputError
        When the gain is zero or the width not positive.

    References
    ----------
    Issa, Al-Bkree and Tar, On certain noise filtering techniques in fixed point iteration-based adaptive control,
    (6).

    Examples
    --------
    >>> round(control.FlowTransformation(gain=-1.1, width=3.0).local_gain, 3)
    -0.367
    """

    gain: float = -1.1
    width: Positive = 3.0

    def __post_init__(self):
        check_fields(self)
        if self.gain == 0:
            raise InputError("gain is 0, which never adapts; give a negative number")

    @property
    @checked
    def local_gain(self) -> float:
        """Change of the command per m/s^2 of error, at the fixed point."""
        return self.gain / self.width

    @property
    @checked
    def packed(self) -> Float64[np.ndarray, "4"]:
        """What the kernels take."""
        return np.array([0.0, self.gain, self.width, 0.0])


@by_value
@dataclass(frozen=True)
class RobustTransformation:
    """Transformation (8): deformed = (deformed + K) (1 + B sigma(A (response - desired))) - K."""

    offset: Positive = 4e7  # K_c, m/s^2, far above every acceleration
    factor: float = -1.05  # B_c
    slope: Positive = 9e-2 / 4e7  # A_c, s^2/m

    def __post_init__(self):
        check_fields(self)
        if self.factor == 0:
            raise InputError("factor is 0, which never adapts; give a negative number")

    @property
    @checked
    def local_gain(self) -> float:
        """Change of the command per m/s^2 of error, where the command is small beside K_c."""
        return self.offset * self.factor * self.slope

    @property
    @checked
    def packed(self) -> Float64[np.ndarray, "4"]:
        return np.array([1.0, self.offset, self.factor, self.slope])


@by_value
@dataclass(frozen=True)
class DisturbanceObserver:
    """Command less the disturbance, estimated by a first-order filter of response minus command; not in the paper.

    deformed = desired - d, where d += gain (response - deformed - d). With gain 0 it is computed torque: the command is the
    desired acceleration. It differs from an iteration of that gain in one term: a change of the desired acceleration is
    commanded at once.

    Attributes
    ----------
    gain : float
        Share of the error of d that is corrected in each sample, 0 to 1.

    Raises
    ------
    InputError
        When the gain is not between 0 and 1.

    References
    ----------
    Ohnishi, Shibata and Murakami, Motion control for advanced mechatronics, IEEE/ASME Trans. Mechatronics 1 (1996).

    Examples
    --------
    >>> control.DisturbanceObserver(gain=0.05).local_gain
    -0.05
    """

    gain: Annotated[float, within(at_least=0.0, at_most=1.0)] = 0.0

    def __post_init__(self):
        check_fields(self)

    @property
    @checked
    def local_gain(self) -> float:
        """Change of the command per m/s^2 of error."""
        return -self.gain

    @property
    @checked
    def packed(self) -> Float64[np.ndarray, "4"]:
        """What the kernels take."""
        return np.array([2.0, self.gain, 0.0, 0.0])


Transformation = FlowTransformation | RobustTransformation | DisturbanceObserver


@checked
def contraction_range(response_gain: float) -> tuple[float, float]:
    """Open range of `local_gain` in which deformed -> G(deformed, f(deformed), desired) contracts.

    With f' = `response_gain` (m/s^2 realised per m/s^2 commanded: the approximate over the exact mass) the multiplier
    of an iteration is 1 + local_gain f'; Banach's theorem requires it to lie within (-1, 1). A filter or a delay in the loop
    narrows the range: `stable_range` finds it.
    """
    if response_gain == 0:
        raise InputError("response_gain is 0: the plant does not respond to its command")
    edge = -2.0 / response_gain
    return min(edge, 0.0), max(edge, 0.0)


@checked
def warn_outside_contraction(transformation: Transformation, response_gain: float) -> None:
    """Warn when a transformation cannot converge on a plant, even with perfect measurements."""
    low, high = contraction_range(response_gain)
    if transformation.local_gain and not low < transformation.local_gain < high:
        warnings.warn(
            f"{type(transformation).__name__} has local gain {transformation.local_gain:.4g}, outside the "
            f"contraction range ({low:.4g}, {high:.4g}) of this plant; the iteration will not converge",
            ContractionWarning,
            stacklevel=5,
        )


@checked
def deform(transformation: Transformation, previous: float, response: float, desired: float) -> float:
    """Next deformed acceleration from the previous one, its response and the desired one, which stays, m/s^2."""
    numbers = float(previous), float(response), float(desired), float(desired)
    return float(deform_packed(transformation.packed, *numbers))


@pasted_kernel
def deform_packed(packed, previous, response, desired, before):
    """`before`: what was desired when `previous` was commanded."""
    if packed[0] == 2.0:
        return previous + (desired - before) - packed[1] * (response - before)
    if packed[0] == 0.0:  # (6)
        x = (response - desired) / packed[2]
        return previous + packed[1] * x / (1.0 + abs(x))
    x = packed[3] * (response - desired)  # (8), multiplied out so that the large K_c does not cancel
    return previous + (previous + packed[1]) * packed[2] * x / (1.0 + abs(x))
