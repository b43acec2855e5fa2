"""The tests' type checker: beartype, with an int serving as a float, as PEP 484 and everybody's code have it.

In each test a function's types are checked at its first calls. They are the same at those that follow: where thousands
followed, the checks took ten times as long as what they checked.
"""

import sys
from collections import Counter
from functools import cache

from beartype import BeartypeConf, beartype

FIRST = 32  # checked calls of a function in a test

compiled = cache(beartype(conf=BeartypeConf(is_pep484_tower=True)))
_calls: Counter = Counter()
_trusted: set = set()


def check(function):
    """The function with its arguments checked; the check is written at the first call, as most are never called."""

    def checked(*arguments, **named):
        _calls[function] += 1
        if _calls[function] == FIRST:
            # The function around, which jaxtyping made to check by `function`. The function itself keeps its
            # annotations: the front door reads them at its own first call.
            around = sys._getframe(2).f_locals["wrapped_fn_holder"][0]()
            around.__no_type_check__ = True
            _trusted.add(around)
        return compiled(function)(*arguments, **named)

    return checked


def begin_again():
    """Check every function's calls again, as a test does that begins."""
    for function in _trusted:
        del function.__no_type_check__
    _trusted.clear()
    _calls.clear()
