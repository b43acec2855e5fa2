"""The tests' type checker: beartype, with an int serving as a float, as PEP 484 and everybody's code have it."""

from functools import cache

from beartype import BeartypeConf, beartype

compiled = cache(beartype(conf=BeartypeConf(is_pep484_tower=True)))


def check(function):
    """The function with its arguments checked; the check is written at the first call, as most are never called."""

    def checked(*arguments, **named):
        return compiled(function)(*arguments, **named)

    return checked
