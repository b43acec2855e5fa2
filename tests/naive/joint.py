"""A joint design through python-control alone.

Nothing of the toolbox closes, samples or solves anything here: masses and springs, printed formulas and the numbers of
``data/motion/joint.toml`` go in; poles, peaks and the scan's error of the nominal stage come out.
"""

from collections.abc import Iterable, Mapping

import control
import numpy as np
from scipy import linalg

SAMPLE_TIME, HALF = 1e-4, 0.5e-4  # s; the force is late by three halves of a sample
NANO = 1e9  # lengths in nm: no entry of a matrix is larger than it need be
NAMES = ("r", "u_ff", "v", "w", "d", "u0")
SAMPLES, AHEAD = 4096, 10  # of a move: what follows until all is still, and the rest before it


def check(
    machines: Mapping, design: Mapping, masses: Iterable[int] = range(1, 8)
) -> tuple[float, float, float]:
    """Largest pole and largest of the three peaks (dB) over some masses; rms scan error with noise at mass 5 (nm)."""
    radius, peak = 0.0, 0.0
    for mass in masses:
        loop = closed(machines["stage"], design, mass)
        poles = np.linalg.eigvals(loop.A)
        radius = max(radius, float(np.abs(poles).max()))
        peak = max(peak, highest(loop, poles)) if radius < 1 else np.inf
        if mass == 5 and radius < 1:
            error = np.hypot(moved(loop, machines["setpoint"]), noisy(loop, machines["stage"]["noise"]))
    return radius, 20 * np.log10(peak), float(error) if radius < 1 else np.inf


def modes(stage: Mapping):
    """Frequencies (rad/s), shapes at the actuator and at the masses (rows, nm)."""
    masses = np.diag([stage["actuator_mass"], *[stage["mass"]] * stage["masses"]])
    springs = [stage["actuator_stiffness"], *[stage["stiffness"]] * (stage["masses"] - 1)]
    stiffness = sum(k * np.outer(e, e) for k, e in zip(springs, np.diff(np.eye(8), axis=0), strict=True))
    squares, shapes = linalg.eigh(stiffness, masses)
    return np.sqrt(np.maximum(squares, 0.0)) * (np.arange(8) > 0), shapes[0], NANO * shapes[1:]


def sampled(w, push, ratio, force: bool, sample_time: float):
    """Modes (positions and velocities in turn), with a constant force as a last state if wanted, held for a sample."""
    n = 2 * len(w)
    a, b = np.zeros((n + force, n + force)), np.zeros((n + force, 1))
    for i, frequency in enumerate(w):
        a[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[0, 1], [-(frequency**2), -2 * ratio * frequency]]
        b[2 * i + 1] = push[i]
    if force:
        a[:, -1] = b[:, 0]
    held = control.c2d(control.ss(a, b, np.eye(n + force), 0), sample_time, "zoh")
    return held.A, held.B


def closed(stage: Mapping, design: Mapping, mass: int):
    """The loop of one mass, from `NAMES` to (e_true, u)."""
    w, push, shapes = modes(stage)
    see, ratio = shapes[mass - 1], stage["damping_ratio"]
    f = 2 * np.pi * design["bandwidth_hz"]
    kp, wi = 12.5 * f**2 / 3, design["integrator"] * f / 9
    wd, wl = design["differentiator"] * f, design["low_pass"] * f
    s = control.tf("s")
    pid = kp / NANO * (s + wi) / s * (s / wd + 1) * wl**2
    pid = control.ss(pid / (s**2 + 2 * design["low_pass_damping"] * wl * s + wl**2))
    pid = control.c2d(pid, SAMPLE_TIME, "tustin")
    parts = [
        _plant(w, push, see, ratio),
        _observer(stage["noise"], design, w, push, see, ratio),
        control.ss(pid, inputs="e", outputs="c", name="pid"),
    ]
    for i, (zeta, q) in enumerate(zip(design["damping"], design["selectivity"], strict=True), 1):
        band = -2 * zeta * w[i] / push[i] * (w[i] / q) * s / (s**2 + w[i] / q * s + w[i] ** 2)
        held = control.c2d(control.ss(band), SAMPLE_TIME, "tustin", prewarp_frequency=w[i])
        parts.append(control.ss(held, inputs=f"v{i}", outputs=f"d{i}", name=f"band{i}"))
    sums = {
        "e": ["r", "-y", "-d", "flex"],
        "u": ["c", "u_ff"],
        "f": ["u", "d1", "d2", "d3"],
        "command": ["f", "u0"],
        "y": ["position", "-v"],
        "seen": ["y", "d"],
        "e_true": ["r", "-y"],
    }
    parts += [control.summing_junction(terms, name, name=f"sum_{name}") for name, terms in sums.items()]
    return control.interconnect(parts, inplist=list(NAMES), outlist=["e_true", "u"])


def _plant(w, push, see, ratio):
    """All modes; the command acts from 1.5 samples later on for one sample, the disturbance w from now."""
    whole, at_once = sampled(w, push, ratio, False, SAMPLE_TIME)
    half, late = sampled(w, push, ratio, False, HALF)
    a = np.block([[whole, late, half @ late], [np.zeros((2, 16)), np.eye(2, k=-1)]])
    b = np.zeros((18, 2))
    b[16, 0], b[:16, 1] = 1.0, at_once[:, 0]
    c = np.zeros((1, 18))
    c[0, :16:2] = see
    return control.ss(a, b, c, 0, SAMPLE_TIME, inputs=["command", "w"], outputs="position", name="plant")


def _observer(noise, design, w, push, see, ratio):
    """Kalman filter of four modes and a random walk; it knows the forces that act and looks 1.5 samples ahead."""
    whole, held = sampled(w[:4], push, ratio, True, SAMPLE_TIME)
    half, late = sampled(w[:4], push, ratio, True, HALF)
    compliance = np.sum(push[4:7] * see[4:7] / w[4:7] ** 2)
    c = np.zeros((1, 9))
    c[0, :8:2] = see[:4]
    unit = np.diag([1e-6, 1e-3] * 4 + [1.0])  # states of like size
    into = np.diag(1 / np.diag(unit))
    drive = into @ np.hstack([held, np.eye(9)[:, 8:]])
    variances = [design["process"] * noise["process"] ** 2 / SAMPLE_TIME, design["noise_model"] * SAMPLE_TIME]
    sensor = np.array([[NANO**2 * (noise["sensor"] ** 2 + noise["reference"] ** 2) / SAMPLE_TIME]])
    _, p, _ = control.dlqe(into @ whole @ unit, drive, c @ unit, np.diag(variances), sensor)
    gain = unit @ p @ unit @ c.T / (c @ unit @ p @ unit @ c.T + sensor)
    # States: x before the measurement, f(k-1), f(k-2); first what the measurement makes of them.
    taken_in = [np.eye(9) - gain @ c, np.zeros((9, 1)), -gain * compliance]
    update = np.block([taken_in, [np.zeros((2, 9)), np.eye(2)]])
    taken = np.vstack([gain, np.zeros((2, 1))])
    advance = np.block([[whole, late, half @ late], [np.zeros((2, 9)), np.eye(2, k=-1)]])
    # half a sample more, on which f(k-1) acts ...
    ahead = np.hstack([half, late, np.zeros((9, 1))]) @ advance
    ahead += np.hstack([np.zeros((9, 9)), late, np.zeros((9, 1))])  # ... which in x(k+1) has become f(k-2)
    rows = np.zeros((4, 11))
    rows[0, 2:8:2] = see[1:4]
    rows[1:] = ahead[[3, 5, 7]]
    b = np.hstack([np.eye(11)[:, 9:10], advance @ taken])
    d = np.hstack([np.zeros((4, 1)), rows @ taken])
    ends = {"inputs": ["f", "seen"], "outputs": ["flex", "v1", "v2", "v3"]}
    return control.ss(advance @ update, b, rows @ update, d, SAMPLE_TIME, **ends, name="observer")


def highest(loop, poles: np.ndarray) -> float:
    """Largest magnitude of S_I, S_O and r to e_true.

    A grid and points all over every resonance, as far apart as half of it is wide; then ever closer around all tops.
    """
    near = np.log(poles[np.abs(poles) > 0.5]) / SAMPLE_TIME
    near = (np.abs(near.imag) + np.arange(-4, 5)[:, None] * near.real).ravel()
    first, last = 2 * np.pi, 0.999 * np.pi / SAMPLE_TIME
    omega = np.union1d(np.geomspace(first, last, 500), near[(near > first) & (near < last)])
    largest = 0.0
    for _ in range(4):  # to a 64th of half a width: a top is met to 0.0003 dB
        response = loop(np.exp(1j * omega * SAMPLE_TIME), squeeze=False)
        three = np.array([response[1, 1], response[0, 2], response[0, 0]])
        values = np.abs(three)
        largest = max(largest, float(values.max()))
        inner = values[:, 1:-1]
        top = (inner >= values[:, :-2]) & (inner >= values[:, 2:]) & (inner > 0.95 * largest)
        tops = 1 + np.flatnonzero(top.any(axis=0))
        if not len(tops):
            break
        # Each side by itself, so that the top stays: its neighbours may lie at unlike distances.
        omega = np.unique([np.linspace(omega[tops], omega[tops + side], 5) for side in (-1, 1)])
    return largest


def noisy(loop, noise: Mapping) -> float:
    """Rms of the true error under the noise of section 3.1, anew in each sample (nm)."""
    size = np.diag([NANO * noise["reference"], noise["process"], NANO * noise["sensor"]])
    b, d = loop.B[:, 2:5] @ size, loop.D[:1, 2:5] @ size
    power = loop.C[:1] @ control.dlyap(loop.A, b @ b.T) @ loop.C[:1].T + d @ d.T
    return float(np.sqrt(power.item()))


def moved(loop, limits: Mapping) -> float:
    """Rms of the true error in the scan without noise (nm), the four gains fitted over the whole move."""
    rows, scan, samples = setpoint(limits)
    r = np.pad(NANO * rows[0, ::2], (AHEAD, SAMPLES), "edge")[:SAMPLES]
    # The setpoint acts where the noise v does; a command acts three halves of a sample later, as a mean over one.
    shifted = np.pad(rows[:4], ((0, 0), (2 * AHEAD - 3, 2 * SAMPLES)), "edge")[:, : 2 * SAMPLES + 1 : 2]
    means = np.diff(shifted, axis=1) / SAMPLE_TIME
    signals = [("v", r), *(("u0", each / np.abs(each).max()) for each in means)]
    hit = {}
    for name in ("v", "u0"):
        inputs = np.zeros((len(NAMES), SAMPLES))
        inputs[NAMES.index(name), 0] = 1.0
        hit[name] = control.forced_response(loop, inputs=inputs).outputs[0]
    found = [np.convolve(hit[name], signal)[AHEAD : AHEAD + samples] for name, signal in signals]
    columns = np.array(found[1:]).T
    left = found[0] - columns @ np.linalg.lstsq(columns, found[0], rcond=None)[0]
    return float(np.sqrt(np.mean(left[slice(*scan)] ** 2)))


def setpoint(limits: Mapping):
    """Position and four derivatives of Table 3.6 at half samples; first and last sample of the scan, and their number."""
    snap, jerk = limits["snap"], limits["jerk"]
    quarter = round(jerk / snap / HALF)  # half samples of constant snap; nothing but snap limits this move
    cruise, settling = round(limits["cruise"] / HALF), round(limits["settling"] / HALF)
    rise = np.repeat([snap, -snap, -snap, snap], quarter)
    snaps = np.concatenate([rise, np.zeros(cruise), -rise, [0.0]])
    powers = np.array([1.0, HALF, HALF**2 / 2, HALF**3 / 6, HALF**4 / 24])
    state, all_states = np.zeros(4), []  # position, velocity, acceleration, jerk
    for s in snaps:
        all_states.append(state)
        whole = np.append(state, s)
        state = np.array([whole[k:] @ powers[: 5 - k] for k in range(4)])
    scan = (len(rise) + settling) // 2, (len(rise) + cruise) // 2 + 1
    return np.vstack([np.array(all_states).T, snaps]), scan, len(snaps) // 2 + 1
