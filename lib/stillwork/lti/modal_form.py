"""The modes of a state-space model that is one of a mechanism: rigid bodies, and pairs of poles with real mode shapes."""

import numpy as np

from stillwork.base.checks import InputError
from stillwork.lti.state_space import StateModel

AGREES = 1e-6  # of the response: by how much the modes may miss it
AT_REST = 1e-6  # of the largest pole: a double pole at zero is computed no better; slower modes count as free
EQUAL = 1e-6  # of their size: poles as near as this are modes of one frequency


def fields_of_modes(model: StateModel, name: str) -> tuple[np.ndarray, list[dict]]:
    """Frequencies around its poles, and fields of the `ModalModel`s that may have the response of `model` there."""
    if model.sample_time:
        raise InputError(
            f"{name} is in discrete time; give a continuous model: modes are those of a mechanism"
        )
    poles = model.poles
    rest = np.abs(poles) <= AT_REST * np.abs(poles).max(initial=0.0)
    pairs = poles[~rest & (poles.imag > 0)]
    if 2 * len(pairs) + rest.sum() != len(poles) or np.any(pairs.real > 0) or rest.sum() % 2:
        real = ", ".join(f"{each.real:.6g}" for each in poles[~rest & ((poles.imag == 0) | (poles.real > 0))])
        raise InputError(
            f"{name} is no model of modes: its poles are to be pairs that do not grow, and double ones at zero"
            + (f"; these are others: {real} rad/s" if real else "")
        )
    pairs, counts = _distinct(pairs[np.argsort(np.abs(pairs))])
    omega = np.geomspace(0.1, 10.0, 50) * (np.abs(pairs[0]) if len(pairs) else 1.0)
    omega = np.concatenate([omega, *(np.abs(each) * np.linspace(0.97, 1.03, 8) for each in pairs)])
    wanted = model.frequency_response(omega)
    shares = _shares(pairs, bool(rest.any()), omega, wanted - model.d[:, :, None])
    most = [int(rest.sum()) // 2, *counts][not rest.any() :]
    found = [
        _fields(pairs, share, most, model.d, measures)
        for share, measures in zip(shares, ("position", "velocity"), strict=True)
    ]
    return omega, [each for each in found if each]


def _distinct(pairs: np.ndarray) -> tuple[np.ndarray, list[int]]:
    """Poles, those that are nearly equal as one, and how many each stands for."""
    groups: list[list[complex]] = []
    for each in pairs:
        near = [group for group in groups if abs(group[0] - each) <= EQUAL * abs(each)]
        if near:
            near[0].append(each)
        else:
            groups.append([each])
    return np.array([np.mean(group) for group in groups]), [len(group) for group in groups]


def _shares(pairs: np.ndarray, free: bool, omega: np.ndarray, response: np.ndarray) -> list[list[np.ndarray]]:
    """Numerators of each mode, constant and of the first order in s, that give the response: least squares."""
    s = 1j * omega
    own = [np.abs(each) ** 2 + 2 * -each.real * s + s**2 for each in pairs]
    below = [s**2] * free + own
    found = []
    for order in (0, 1):
        columns = np.array([s**order / each for each in below]).T
        weight = 1 / np.linalg.norm(response, axis=(0, 1))
        real = np.vstack([(columns * weight[:, None]).real, (columns * weight[:, None]).imag])
        size = np.linalg.norm(real, axis=0)
        flat = (response * weight).reshape(-1, len(omega)).T
        share = np.linalg.lstsq(real / size, np.vstack([flat.real, flat.imag]))[0] / size[:, None]
        found.append([each.reshape(response.shape[:2]) for each in share])
    return found


def _fields(
    pairs: np.ndarray, shares: list, most: list[int], feedthrough: np.ndarray, measures: str
) -> dict | None:
    """Each numerator as shapes: as many modes as its rank, at most as many as its poles."""
    free = len(most) > len(pairs)
    rows: list[tuple[float, float, np.ndarray, np.ndarray]] = []
    for place, share in enumerate(shares):
        left, values, right = np.linalg.svd(share)
        pole = 0.0 if free and place == 0 else pairs[place - free]
        rank = min(int(np.sum(values > AGREES * values[0])), most[place]) or 1
        for each in range(rank):
            size = np.sqrt(values[each])
            ratio = float(-np.real(pole) / np.abs(pole)) if pole else 0.0
            rows.append((float(np.abs(pole)), ratio, right[each] * size, left[:, each] * size))
    if not rows:
        return None
    frequencies, damping, inputs, outputs = zip(*rows, strict=True)
    return {
        "frequencies": np.array(frequencies),
        "damping": np.array(damping),
        "input_shapes": np.array(inputs),
        "output_shapes": np.array(outputs).T,
        "feedthrough": feedthrough,
        "measures": measures,
    }
