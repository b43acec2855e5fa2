"""Values as people's own code and files hold them: the same numbers in another form, and wrong ones."""

from dataclasses import fields, is_dataclass, replace

import numpy as np


def _nonsense(*_, **__) -> str:
    """A user's function that returns something unexpected; its exceptions would be its own."""
    return "nonsense"


ODD = (
    None, "text", "", "2020-01-01", b"x", True, float("nan"), float("inf"), -float("inf"), 0, -1, 1, 0.5, 3.7, 1e300,
    -1e300, 1e-300, 5e-324, 1e160, 10**400, -(10**400), 10**12, 1j, [], [[]], [[1], [1, 2]], ["1", "2"], [None], {},
    {"a": 1}, (), object(), np.float32(1.5), np.int64(3), np.array(2.0), np.array(np.nan), np.datetime64("2020-01-01"),
    np.zeros((0, 3)), np.zeros((2, 0)), np.zeros((2, 2, 2)), np.array(["a"]), np.array([None]), _nonsense,
)  # fmt: skip


def same(rng: np.random.Generator, value):
    """`value` in another form that holds the same numbers: it must be taken like the original."""
    try:
        array = np.asarray(value)
    except ValueError:  # lists of several lengths
        return value
    if array.dtype.kind != "f" or array.ndim == 0:
        return value
    frozen = array.copy()
    frozen.flags.writeable = False
    spaced = np.repeat(array, 2, axis=-1)[..., ::2]
    forms = (
        array.tolist(),
        frozen,
        np.asfortranarray(array),
        spaced,
        array.astype(np.longdouble),
        array.astype(object),
    )
    swapped = array.astype(array.dtype.newbyteorder())
    return (*forms, swapped)[rng.integers(len(forms) + 1)]


def wrong(rng: np.random.Generator, value):
    """A value for the same argument that may be invalid."""
    kind = rng.random()
    if kind < 0.25:
        return ODD[rng.integers(len(ODD))]
    if is_dataclass(value) and not isinstance(value, type):
        name = rng.choice([field.name for field in fields(value)])
        return replace(value, **{str(name): wrong(rng, getattr(value, name))})
    if isinstance(value, bool | str) or callable(value):
        return ODD[rng.integers(len(ODD))]
    if isinstance(value, int | float):
        return _number(rng, value)
    if isinstance(value, np.ndarray) or (isinstance(value, list | tuple) and _numeric(value)):
        return _array(rng, np.asarray(value))
    if isinstance(value, list | tuple) and len(value):
        items = list(value)
        place = rng.integers(len(items))
        if kind < 0.5:
            del items[place]
        else:
            items[place] = wrong(rng, items[place])
        return type(value)(items) if type(value) in (list, tuple) else items
    return ODD[rng.integers(len(ODD))]


def _numeric(value) -> bool:
    try:
        return np.asarray(value).dtype.kind in "fiuc"
    except ValueError:
        return False


def _number(rng, value):
    sign = rng.choice([-1, 1])
    size = float(
        rng.choice([1e-320, 1e-300, 1e-160, 1e-30, 1e-9, 1e-3, 0.1, 0.5, 2, 10, 1e3, 1e9, 1e30, 1e160, 1e300])
    )
    if isinstance(value, int):
        return int(rng.choice([-5, -1, 0, 1, 2, 3, 7, 50, 300]))
    return sign * size * value if rng.random() < 0.5 else size * value


def _array(rng, array):
    change = rng.integers(17)
    with np.errstate(all="ignore"):
        if change < 4:
            return array * float(
                rng.choice([0, -1, 1e-320, 1e-300, 1e-160, 1e-12, 1e12, 1e80, 1e160, 1e300, 1e308])
            )
        if change < 7 and array.size:
            spoiled = array.astype(complex if array.dtype.kind == "c" else float).ravel()
            spoiled[rng.integers(spoiled.size)] = rng.choice(
                [np.nan, np.inf, -np.inf, 0.0, -1.0, 1e300, 1e-300]
            )
            return spoiled.reshape(array.shape)
        return (
            lambda: array.T,
            lambda: array[None],
            lambda: array.ravel(),
            lambda: np.atleast_1d(array)[..., :1],
            lambda: np.atleast_1d(array)[..., :0],
            lambda: np.atleast_1d(array)[:0],
            lambda: np.atleast_1d(array)[:-1],
            lambda: np.zeros_like(array),
            lambda: np.ones_like(array),
            lambda: array + 1j,
            lambda: np.ma.array(array, mask=rng.random(array.shape) < 0.2),
        )[change % 11]()


def same_value(one, other) -> bool:
    """Whether two results hold the same numbers, bit by bit; a random generator, a function and a bare object are not looked at."""
    if isinstance(one, np.ndarray):
        if not isinstance(other, np.ndarray) or one.dtype != other.dtype:
            return False
        return np.array_equal(one, other, equal_nan=one.dtype.kind in "fc")
    if type(one) is not type(other):
        return False
    if (
        type(one) is object
        or isinstance(one, np.random.Generator)
        or (callable(one) and not is_dataclass(one))
    ):
        return True
    if is_dataclass(one):
        return all(same_value(getattr(one, field.name), getattr(other, field.name)) for field in fields(one))
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same_value(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(same_value, one, other))
    if type(one).__module__.startswith("stillwork"):
        return same_value(vars(one), vars(other))
    return one == other or one != one
