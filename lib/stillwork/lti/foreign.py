"""Models of python-control and SciPy, and tuples of arrays, as the matrices of a state-space model."""

import warnings
from typing import Any

import numpy as np
from scipy import linalg

from stillwork.base.checks import InputError, require_array, require_number, short_repr
from stillwork.lti.scaling import state_scale

CANCELS = 1e-6  # of a pole's size: a zero as near as this cancels it
SAME = 1e-6  # of the response: by how much states that go may change it
NEGLIGIBLE = 1e-9  # of the size of its matrix: a singular value below it is rounding
WANTED = "a stillwork.lti.StateModel, a model of python-control or scipy.signal, or arrays (A, B, C, D)"


class CancellationWarning(UserWarning):
    """Poles of a transfer function that its zeros cancel: its state-space model does without them.

    Examples
    --------
    >>> import warnings
    >>> from control import tf
    >>> with warnings.catch_warnings(record=True) as said:
    ...     warnings.simplefilter("always")
    ...     model = lti.from_control(tf([1.0, 2.0], [1.0, 3.0, 2.0]))
    >>> said[0].category.__name__, len(model.a)
    ('CancellationWarning', 1)
    """


def matrices(system: Any, name: str) -> dict[str, Any]:
    """Fields of a `StateModel` that is the same system; an `InputError` names what cannot be one."""
    if hasattr(system, "state_space") and callable(system.state_space):
        model = system.state_space()
        return {field: getattr(model, field) for field in model.__dataclass_fields__}
    if isinstance(system, tuple):
        return _of_arrays(system, name)
    if all(hasattr(system, each) for each in ("A", "B", "C", "D", "dt")):
        a, b, c, d = (_real(f"{name}.{each}", getattr(system, each), 2) for each in "ABCD")
        return {
            "a": a,
            "b": b,
            "c": c,
            "d": d,
            "sample_time": _sample_time(system, name, len(a)),
            **_labels(system),
        }
    if all(hasattr(system, each) for each in ("zeros", "poles", "gain", "dt")):
        zeros, poles = (_paired(f"{name}.{each}", getattr(system, each)) for each in ("zeros", "poles"))
        found = _realised(zeros, poles, require_number(f"{name}.gain", system.gain), name)
        return dict(zip("abcd", found, strict=True)) | {
            "sample_time": _sample_time(system, name, len(found[0]))
        }
    if all(hasattr(system, each) for each in ("num", "den", "dt")):
        found = _of_fractions(system.num, system.den, name)
        labels = {key: value for key, value in _labels(system).items() if key != "state_labels"}
        return (
            dict(zip("abcd", found, strict=True))
            | {"sample_time": _sample_time(system, name, len(found[0]))}
            | labels
        )
    if hasattr(system, "frdata"):
        raise InputError(f"{name} is a frequency response; fit a model to it first, or give {WANTED}")
    raise InputError(f"{name} is {short_repr(system)}; give {WANTED}")


def _paired(name: str, roots: Any) -> np.ndarray:
    """Roots of which each complex one stands beside its conjugate."""
    roots = require_array(name, np.ravel(roots), dtype=complex)
    if len(roots) and not np.allclose(
        np.sort_complex(roots), np.sort_complex(roots.conj()), rtol=1e-9, atol=0
    ):
        raise InputError(f"{name} holds a complex root without its conjugate; give both: the model is real")
    return roots


def _of_arrays(system: tuple, name: str) -> dict[str, Any]:
    if len(system) not in (4, 5):
        raise InputError(
            f"{name} is a tuple of {len(system)}; give (A, B, C, D), or (A, B, C, D, sample time in s), and coefficients "
            "or roots as scipy.signal.lti(*them)"
        )
    a, b, c, d = (_real(f"{name}[{place}]", each, 2) for place, each in enumerate(system[:4]))
    time = require_number(f"{name}[4]", system[4], at_least=0.0) if len(system) == 5 else 0.0
    return {"a": a, "b": b, "c": c, "d": d, "sample_time": time}


def _real(name: str, value, dimensions: int) -> np.ndarray:
    return require_array(name, np.array(value, ndmin=dimensions), dtype=float)


def _sample_time(system: Any, name: str, states: int) -> float:
    """Of python-control None is unspecified, of SciPy continuous; True is a sample time that is not stated in both."""
    continuous = type(system).__module__.startswith("scipy.")
    if system.dt is None and not states:  # a gain has none to state
        return 0.0
    if system.dt is True or (system.dt is None and not continuous):
        raise InputError(f"{name}.dt is unspecified; give 0 for continuous time or the sample time in s")
    return 0.0 if system.dt is None else require_number(f"{name}.dt", system.dt, at_least=0.0)


def _labels(system: Any) -> dict[str, tuple[str, ...]]:
    """Names of signals and states; those that python-control makes up by itself are none."""
    found = {}
    for field, made_up in (("input_labels", "u"), ("output_labels", "y"), ("state_labels", "x")):
        names = tuple(getattr(system, field, None) or ())
        if names and names != tuple(f"{made_up}[{place}]" for place in range(len(names))):
            found[field] = names
    return found


def _of_fractions(numerators: Any, denominators: Any, name: str) -> tuple[np.ndarray, ...]:
    """Realise each fraction of a transfer matrix, and leave out the states that several of them share."""
    if not isinstance(numerators, list):  # SciPy: one denominator; a numerator is a row for each output
        rows = np.atleast_2d(numerators)
        numerators, denominators = [[row] for row in rows], [[denominators] for _ in rows]
    parts = [
        [_of_fraction(n, d, name) for n, d in zip(*pair, strict=True)]
        for pair in zip(numerators, denominators, strict=True)
    ]
    a = linalg.block_diag(*(part[0] for row in parts for part in row))
    b = np.vstack(
        [linalg.block_diag(*(part[1] for part in row)) for row in parts]
    )  # every row of fractions has all inputs
    c = linalg.block_diag(*(np.hstack([part[2] for part in row]) for row in parts))
    d = np.array([[part[3].item() for part in row] for row in parts])
    if len(parts) > 1 or len(parts[0]) > 1:
        a, b, c, _ = minimal(a, b, c, NEGLIGIBLE)
    return a, b, c, d


def _of_fraction(numerator: Any, denominator: Any, name: str) -> tuple[np.ndarray, ...]:
    num, den = (
        np.trim_zeros(_real(f"{name}.{word}", each, 1), "f")
        for word, each in (("num", numerator), ("den", denominator))
    )
    if not len(den):
        raise InputError(f"{name} has a denominator of zero; give one that is not")
    if len(num) > len(den):
        raise InputError(
            f"{name} is improper: its numerator has degree {len(num) - 1}, its denominator {len(den) - 1}; add poles"
        )
    if not len(num):
        return _realised(np.zeros(0), np.zeros(0), 0.0, name)
    return _realised(np.roots(num), np.roots(den), float(num[0] / den[0]), name)


def _realised(zeros: np.ndarray, poles: np.ndarray, gain: float, name: str) -> tuple[np.ndarray, ...]:
    """A cascade of sections of first and second order, in units of the states that balance it."""
    zeros, poles = _without_cancelled(zeros, poles, name)
    if len(zeros) > len(poles):
        raise InputError(f"{name} is improper: it has {len(zeros)} zeros and {len(poles)} poles; add poles")
    a, b, c, d = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[gain]])
    if not len(poles) or not gain:
        return a, b, c, d
    d = np.ones((1, 1))
    tops, bottoms = _factors(zeros), _factors(poles)
    # One factor of first order of each kind at most: they share a section, else it stands over one that is free.
    single = [tops.pop()] if tops and len(tops[-1]) == 2 else []
    last = [bottoms.pop()] if bottoms and len(bottoms[-1]) == 2 else []
    if single and not last:
        tops, single = [*tops, *single], []
    ones = [np.ones(1)] * (len(bottoms) - len(tops))
    for top, bottom in zip([*tops, *ones, *(single or [np.ones(1)])], [*bottoms, *last], strict=False):
        own_a, own_b, own_c, own_d = _section(top, bottom)
        a = np.block([[a, np.zeros((len(a), len(own_a)))], [own_b @ c, own_a]])
        b, c, d = np.vstack([b, own_b @ d]), np.hstack([own_d @ c, own_c]), own_d @ d
    scale = state_scale(a, b, gain * c)
    return a * scale / scale[:, None], b / scale[:, None], gain * c * scale, gain * d


def _factors(roots: np.ndarray) -> list[np.ndarray]:
    """Real factors of a polynomial, by the size of their roots: of second order, and at most one of first order, last."""
    pairs = [np.array([1.0, -2 * each.real, abs(each) ** 2]) for each in roots[roots.imag > 0]]
    real = sorted(roots[roots.imag == 0].real, key=abs)
    pairs += [np.poly(real[place : place + 2]) for place in range(0, len(real) - 1, 2)]
    odd = [np.array([1.0, -real[-1]])] if len(real) % 2 else []
    return [*sorted(pairs, key=lambda each: abs(each[2])), *odd]


def _section(num: np.ndarray, den: np.ndarray) -> tuple[np.ndarray, ...]:
    """A fraction of first or second order: polynomials in falling powers, the denominator's first coefficient 1."""
    if len(den) == 2:
        (n1, n0), d0 = np.append(np.zeros(2 - len(num)), num), den[1]
        return np.array([[-d0]]), np.ones((1, 1)), np.array([[n0 - n1 * d0]]), np.array([[n1]])
    (n2, n1, n0), (_, d1, d0) = np.append(np.zeros(3 - len(num)), num), den
    rate = np.sqrt(abs(d0)) or 1.0
    a = np.array([[0.0, rate], [-d0 / rate, -d1]])
    c = np.array([[(n0 - n2 * d0) / rate, n1 - n2 * d1]])
    return a, np.array([[0.0], [1.0]]), c, np.array([[n2]])


def _without_cancelled(zeros: np.ndarray, poles: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Zeros and poles without those that cancel each other, with a warning that names them."""
    left, kept, gone = list(zeros), [], []
    for pole in sorted(poles, key=lambda each: (each.real, abs(each.imag), each.imag)):
        near = min(left, key=lambda each: abs(each - pole), default=None)
        if (
            near is not None
            and abs(near - pole) <= CANCELS * abs(pole)
            and np.sign(near.imag) == np.sign(pole.imag)
        ):
            left.remove(near)
            gone.append(pole)
        else:
            kept.append(pole)
    if gone:
        said = ", ".join(f"{each.real if not each.imag else each:.6g}" for each in gone)
        warnings.warn(
            f"zeros of {name} cancel its poles at {said} (rad/s, or z); its state-space model does without them",
            CancellationWarning,
            stacklevel=2,
        )
    return np.array(left, complex), np.array(kept, complex)


def minimal(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The part of A, B, C that the inputs reach and the outputs see, and the singular values that went, relative.

    Where poles lie many decades apart a small singular value may carry much of the response: what changes it stays.
    """
    scale = state_scale(a, b, c)
    a, b, c = a * scale / scale[:, None], b / scale[:, None], c * scale
    for share in (1.0, 1e-3, 1e-6):
        found = _reduced(a, b, c, share * tolerance)
        if len(found[0]) == len(a):  # turned states would lose digits where poles lie decades apart
            return a, b, c, found[3]
        if _unchanged((a, b, c), found[:3]):
            return found
    return a, b, c, np.zeros(0)


def _unchanged(whole: tuple[np.ndarray, ...], part: tuple[np.ndarray, ...]) -> bool:
    """Whether the response at and around the poles is the same, to `SAME` of its size there."""
    poles = linalg.eigvals(whole[0])
    poles = np.abs(poles[poles.imag >= 0])  # one of each pair, whatever their last bits
    points = 1j * np.outer([0.1, 0.5, 1.0, 2.0, 10.0], poles[poles > 0]).ravel()
    responses = []
    for a, b, c in (whole, part):
        shifted = points[:, None, None] * np.eye(len(a)) - a
        with np.errstate(all="ignore"):
            try:
                responses.append(c @ np.linalg.solve(shifted, np.broadcast_to(b, (len(points), *b.shape))))
            except np.linalg.LinAlgError:  # a pole on the axis
                return False
    return bool(
        np.all(
            np.abs(responses[0] - responses[1]) <= SAME * np.abs(responses[0]).max(axis=(1, 2), keepdims=True)
        )
    )


def _reduced(a, b, c, tolerance: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    reached, low = _reached(a, b, tolerance)
    a, b, c = reached.T @ a @ reached, reached.T @ b, c @ reached
    seen, unseen = _reached(a.T, c.T, tolerance)
    return seen.T @ a @ seen, seen.T @ b, c @ seen, np.append(low, unseen)


def _reached(a: np.ndarray, b: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal basis of what B reaches by A (a staircase by singular values), and the values that did not count."""
    basis, gone = np.zeros((len(a), 0)), []
    new, size = b, np.linalg.norm(b)
    while new.shape[1] and basis.shape[1] < len(a):
        for _ in range(2):  # once more, for orthogonality to rounding
            new = new - basis @ (basis.T @ new)
        left, values, _ = np.linalg.svd(new, full_matrices=False)
        counts = values > tolerance * size
        gone += list(values[~counts][: len(a) - basis.shape[1]] / (size or 1.0))
        basis = np.hstack([basis, left[:, counts]])
        new, size = a @ left[:, counts], np.linalg.norm(a)
    missing = len(a) - basis.shape[1]
    return basis, np.sort(gone)[::-1][:missing]
