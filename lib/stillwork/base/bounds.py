"""Annotations that state bounds: `checked` and `check_fields` validate by them."""

from collections.abc import Callable, Iterable
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

from numpy.typing import ArrayLike

from stillwork.base.checks import require_array, require_choice, require_count, require_number

Positive = Annotated[float, partial(require_number, above=0.0)]
NonNegative = Annotated[float, partial(require_number, at_least=0.0)]
Fraction = Annotated[float, partial(require_number, above=0.0, below=1.0)]
Count = Annotated[int, partial(require_count, at_least=1)]
Natural = Annotated[int, partial(require_count, at_least=0)]
if TYPE_CHECKING:  # array_like becomes an array by validation: types have one of the two
    Vector = Any
    Matrix = Any
else:
    Vector = Annotated[ArrayLike, partial(require_array, ndim=1)]
    Matrix = Annotated[ArrayLike, partial(require_array, ndim=2)]


def within(**bounds: Any) -> Callable:
    """A finite number `above`, `below`, `at_least` or `at_most` these, as `require_number` takes them."""
    return partial(require_number, **bounds)


def one_of(choices: Iterable[str]) -> Callable:
    """One of these words."""
    return partial(require_choice, choices=tuple(choices))


def at_least(count: int) -> Callable:
    """A whole number of at least so much."""
    return partial(require_count, at_least=count)
