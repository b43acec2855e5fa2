"""Random loops of a PID controller, and their peaks by matrices written out here: no grid of the toolbox is used."""

from dataclasses import dataclass

import numpy as np
from scipy import linalg, signal

from stillwork import lti


@dataclass(frozen=True)
class RandomLoop:
    """A machine with its controller's rules, in continuous or in sampled time."""

    plant: lti.ModalModel
    mass: float
    notches: tuple[float, ...]  # rad/s
    sample_time: float
    delay: int
    limit: float
    search_hz: tuple[float, float]


def sample_loop(rng):
    """One to six modes beside a rigid body, light to heavy damping, any sign of the shapes, any limit from 1.2 to 10."""
    modes = int(rng.integers(1, 7))
    mass = 10 ** rng.uniform(-1, 3)
    hertz = np.sort(10 ** rng.uniform(1, 3.5, modes))
    damping = 10 ** rng.uniform(-4.5, -0.7, modes)
    shares = rng.choice([-1, 1], modes) * 10 ** rng.uniform(-2, 0.3, modes)
    size = 1 / np.sqrt(mass)
    plant = lti.ModalModel(
        np.append(0.0, 2 * np.pi * hertz),
        np.append(0.0, damping),
        np.full((modes + 1, 1), size),
        size * np.append(1.0, shares)[None],
        np.array(
            [[0.0 if rng.random() < 0.7 else rng.normal() * 0.01 / mass / (2 * np.pi * hertz[-1]) ** 2]]
        ),
    )
    sampled = rng.random() < 0.5
    rate = hertz[0] * 10 ** rng.uniform(0.7, 2.3)
    notches = tuple(2 * np.pi * hertz[:2]) if rng.random() < 0.3 else ()
    notches = tuple(w for w in notches if not sampled or w < 0.8 * np.pi * rate)
    high = min(1.5 * hertz[0], rate / 10 if sampled else np.inf)
    return RandomLoop(
        plant,
        mass,
        notches,
        1 / rate if sampled else 0.0,
        int(rng.integers(0, 4)) if sampled else 0,
        10 ** rng.uniform(np.log10(1.2), 1.0),
        (high / 60, high),
    )


def _in_a_row(first, second):
    (a, b, c, d), (a2, b2, c2, d2) = first, second
    whole = np.block([[a, np.zeros((len(a), len(a2)))], [b2 @ c, a2]])
    return whole, np.vstack([b, b2 @ d]), np.hstack([d2 @ c, c2]), d2 @ d


def sensitivity(loop, pid):
    """(A, B, C, D) of 1 / (1 + PC), and a function that evaluates it from the formulas of P and C, rad/s."""
    w, z, h = pid.low_pass, pid.low_pass_damping, loop.sample_time
    parts = [
        (np.zeros((1, 1)), np.eye(1), pid.integrator * np.eye(1), np.eye(1)),
        (
            np.array([[0.0, w], [-w, -2 * z * w]]),
            np.array([[0.0], [w]]),
            np.array([[1.0, w / pid.differentiator]]),
            np.zeros((1, 1)),
        ),
    ]
    for notch in pid.notches:
        n, wide, deep = notch.omega, notch.width, notch.depth
        a = np.array([[0.0, n], [-n, -2 * wide * n]])
        parts.append((a, np.array([[0.0], [1.0]]), np.array([[0.0, 2 * (deep - wide) * n]]), np.eye(1)))
    controller = parts[0]
    for part in parts[1:]:
        controller = _in_a_row(controller, part)
    controller = (*controller[:2], pid.gain * controller[2], pid.gain * controller[3])
    model = loop.plant
    blocks = [
        np.array([[0.0, 1.0], [-(f**2), -2 * d * f]])
        for f, d in zip(model.frequencies, model.damping, strict=True)
    ]
    a = linalg.block_diag(*blocks)
    b, c = np.zeros((len(a), 1)), np.zeros((1, len(a)))
    b[1::2, 0], c[0, ::2] = model.input_shapes[:, 0], model.output_shapes[0]
    plant = (a, b, c, model.feedthrough)
    if h:
        controller = signal.cont2discrete(controller, h, "bilinear")[:4]
        whole = linalg.expm(np.block([[a, b], [np.zeros((1, len(a) + 1))]]) * h)
        held = whole[: len(a), : len(a)], whole[: len(a), -1:], c, np.zeros((1, 1))
        plant = held
        late = [(np.zeros((1, 1)), np.eye(1), np.eye(1), np.zeros((1, 1)))] * loop.delay
        if model.feedthrough[0, 0]:  # y_k = C x_k + D u_{k-1}
            plant = (
                linalg.block_diag(held[0], 0.0),
                np.vstack([held[1], [[1.0]]]),
                np.hstack([c, model.feedthrough]),
                np.zeros((1, 1)),
            )
        for each in late:
            plant = _in_a_row(each, plant)
    a, b, c, d = _in_a_row(controller, plant)
    turn = 1 / (1 + d[0, 0])
    matrices = a - b @ c * turn, b * turn, -c * turn, np.array([[turn]])

    def response(omega):
        s = 2 / h * 1j * np.tan(omega * h / 2) if h else 1j * omega
        c_fb = pid.gain * (1 + pid.integrator / s) * (1 + s / pid.differentiator)
        c_fb = c_fb * w**2 / (s * s + 2 * z * w * s + w**2)
        for notch in pid.notches:
            n = notch.omega
            c_fb = (
                c_fb * (s * s + 2 * notch.depth * n * s + n * n) / (s * s + 2 * notch.width * n * s + n * n)
            )
        if not h:
            s = s[:, None]
            modes = model.output_shapes[0] * model.input_shapes[:, 0]
            p = (modes / (s * s + 2 * model.damping * model.frequencies * s + model.frequencies**2)).sum(
                axis=1
            )
            p = p + model.feedthrough[0, 0]
        else:
            z_ = np.exp(1j * omega * h)
            p = model.feedthrough[0, 0] / z_
            for k in range(len(blocks)):  # the transition of each mode by itself
                own = held[0][2 * k : 2 * k + 2, 2 * k : 2 * k + 2]
                drive = held[1][2 * k : 2 * k + 2, 0]
                determinant = (z_ - own[0, 0]) * (z_ - own[1, 1]) - own[0, 1] * own[1, 0]
                p = (
                    p
                    + model.output_shapes[0, k]
                    * ((z_ - own[1, 1]) * drive[0] + own[0, 1] * drive[1])
                    / determinant
                )
            p = p * z_**-loop.delay
        return np.abs(1 / (1 + p * c_fb))

    return matrices, response


def judged_peak(loop, pid):
    """Slowest decay of the loop (1/s), and its largest sensitivity, by points around all poles and by a Hamiltonian."""
    (a, b, c, d), response = sensitivity(loop, pid)
    h = loop.sample_time
    poles = linalg.eigvals(a)
    if h:
        poles = np.log(poles[np.abs(poles) > 1e-12]) / h
        # w = (z - 1) / (z + 1): the circle becomes the axis, the norm stays.
        inverse = np.linalg.inv(a + np.eye(len(a)))
        d = d - c @ inverse @ b
        a, b, c = inverse @ (a - np.eye(len(a))), np.sqrt(2) * inverse @ b, np.sqrt(2) * c @ inverse
    steps = np.sinh(np.linspace(-12, 12, 1201))
    high = (1 - 1e-9) * np.pi / h if h else np.inf
    pairs = np.concatenate([poles, loop.plant.poles])
    around = (
        np.abs(pairs.imag)[:, None] + np.maximum(np.abs(pairs.real), 1e-9)[:, None] * 0.02 * steps
    ).ravel()
    omega = np.concatenate([around, np.geomspace(1e-3, 1e6, 40000), np.abs(pairs)])
    omega = np.unique(omega[(omega > 1e-4) & (omega < high)])
    size = response(omega)
    top = size.argsort()[-5:]
    for k in top:  # between the points
        between = np.linspace(omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)], 4001)
        size = np.append(size, response(between[between < high]))
    level = 0.999 * loop.limit
    r = 1 / (level**2 - d[0, 0] ** 2)
    upper = a + b @ c * (d[0, 0] * r)
    hamiltonian = np.block([[upper, b @ b.T * r], [-c.T @ c * (1 + d[0, 0] ** 2 * r), -upper.T]])
    values = linalg.eigvals(hamiltonian)
    crossed = np.unique(np.abs(values[np.abs(values.real) < 1e-3 * np.abs(values)].imag))
    crossed = 2 / h * np.arctan(crossed) if h else crossed
    crossed = np.concatenate([crossed, (crossed[1:] + crossed[:-1]) / 2])
    crossed = crossed[(crossed > 1e-4) & (crossed < high)]
    if len(crossed):
        size = np.append(size, response(crossed))
    return poles.real.max(), float(np.nanmax(size))
