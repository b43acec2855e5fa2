"""What may not hang on the last digits: residuals are shown as bounds, ties are decided by order.

Another processor sums in another order. A residual of 8e-14 here is 1.2e-13 there, and of two values that are
equal by theory either may come out the larger.
"""

import numpy as np
from numpy.typing import ArrayLike

from stillwork.base.checks import InputError, require_array, require_number

# Values closer than this part of the larger one tie, unless the caller gives another: far above the rounding of any
# result here, far below a difference that would mean anything.
TIE = 1e-6


def below(residual: float, bound: float) -> str:
    """Text of a residual: ``below 1e-12`` within its bound, the number itself where it is not.

    The bound is the most that rounding explains: state at the call why, such as operations times rounding unit times
    condition. It follows from the problem, never from the residual, or the text would change with it.
    """
    require_number("bound", bound, above=0.0)
    size = abs(require_number("residual", residual))
    return f"below {bound:g}".replace("e-0", "e-") if size < bound else f"{residual:.1e}"


def first_largest(values: ArrayLike, tie: float = TIE) -> int:
    """Index of the largest value; of those that tie with it, by this part of its magnitude, the first."""
    values = require_array("values", values, ndim=1)
    if not len(values):
        raise InputError("values is empty; there is no largest")
    require_number("tie", tie, at_least=0.0)
    largest = values.max()
    return int(np.argmax(values >= largest - tie * abs(largest)))


def in_order(values: ArrayLike) -> np.ndarray:
    """Complex values of the order of one by imaginary, then real part: eigenvalues come in an order of rounding."""
    values = require_array("values", values, dtype=complex)
    keys = np.round(values.real, 9) + 0.0, np.round(values.imag, 9) + 0.0
    return np.take_along_axis(values, np.lexsort(keys, axis=-1), axis=-1)
