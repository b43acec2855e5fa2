"""A slow, obvious twin of the closed loop: scipy one sample at a time, dense matrices, eq. (29) as printed."""

import numpy as np
from scipy import signal


class Cascade:
    """Second-order sections on several channels, one sample at a time."""

    def __init__(self, sections, channels):
        self.sections = sections
        self.memory = np.zeros((len(sections), channels, 2))

    def __call__(self, values):
        out, self.memory = signal.sosfilt(self.sections, np.reshape(values, (-1, 1)), zi=self.memory)
        return out[:, 0]


def step_tustin(continuous, sample_time):
    """Trapezoidal rule on x' = A x + B u, solved anew at every sample."""
    a, b, c, d = continuous.a, continuous.b, continuous.c, continuous.d
    half = sample_time / 2
    eye = np.eye(len(a))
    state = np.zeros(len(a))
    last = np.zeros(b.shape[1])

    def step(u):
        # x is the true trapezoidal state, u[-1] = 0 as the loop starts at rest.
        nonlocal state, last
        state = np.linalg.solve(eye - half * a, (eye + half * a) @ state + half * b @ (last + u))
        last = np.array(u)
        return c @ state + d @ u

    return step


def run(twin, floor, noise, *, feedback=True, weights=None, felms=None, ferls=None, path_delay=None):
    """Simulate; `felms` is (mu, epsilon, copies), `ferls` is (P, lambda). Returns a dict of histories.

    With a `path_delay` the error of the update is d + W psi_N, d being the error that no feedforward would leave if its
    path were the delay alone.

    floor : (samples, sensors); noise : (samples, outputs + sensors).
    """
    instruments, sensors, outputs = twin.instruments, twin.sensors, twin.outputs
    sample_time = twin.sample_time
    plant = step_tustin(twin.plant.continuous, sample_time)
    actuator = Cascade(instruments.actuator, outputs)
    parasitic = Cascade(instruments.parasitic, outputs)
    platform_conditioning = Cascade(instruments.conditioning, outputs)
    floor_conditioning = Cascade(instruments.conditioning, sensors)
    skyhook = Cascade(twin.skyhook_filter, outputs)
    powers = twin.feedforward.integrator_powers
    # psi_N by filtering all regressors with N, as eq. (30) says, not N a0 with the integrators.
    integrators = [Cascade(twin.integrator, sensors) for _ in range(powers)]
    shaping = Cascade(twin.noise_shaping, twin.regressors)
    axes = [Cascade(twin.error_filter, 1) for _ in range(twin.outputs)]
    w = np.zeros((twin.actuators, twin.regressors)) if weights is None else np.array(weights)
    p = None if ferls is None else np.array(ferls[0])
    command = np.zeros(twin.actuators)
    sent = Cascade(twin.noise_shaping, twin.actuators)
    pasts = [(np.zeros(twin.regressors), np.zeros(twin.actuators))] * (path_delay or 0)
    history = {
        name: [] for name in ("platform", "measured", "sensed", "command", "psi_n", "error", "weights")
    }
    for k in range(len(floor)):
        force = actuator(command)
        platform = plant(np.concatenate([force, floor[k]])) + parasitic(force)
        measured = platform_conditioning(platform + noise[k, :outputs])
        sensed = floor_conditioning(floor[k] + noise[k, outputs:])
        parts = [sensed]
        for each in integrators:
            parts.append(each(parts[-1]))
        psi = np.concatenate(parts)
        psi_n = shaping(psi)
        error = np.array([f([x])[0] for f, x in zip(axes, measured, strict=True)])
        command = w @ psi - feedback * skyhook(measured)
        history["command"].append(command)
        kept = error
        learnt = psi_n
        if path_delay is not None:
            pasts.append((psi_n, sent(w @ psi)))
            learnt, effect = pasts[k]
            error = (error - effect) + w @ learnt
        command = command + twin.plant.floor_inertia @ floor[k]
        if felms is not None:
            mu, epsilon, copies = felms
            w = w - mu / (epsilon + copies * learnt @ learnt) * np.outer(error, learnt)
        if ferls is not None:
            forgetting = ferls[1]
            gain = p @ learnt
            p = (p - np.outer(gain, gain) / (forgetting + learnt @ gain)) / forgetting
            w = w - np.outer(error, p @ learnt)
        for name, value in (
            ("platform", platform),
            ("measured", measured),
            ("sensed", sensed),
            ("psi_n", psi_n),
            ("error", kept),
            ("weights", w),
        ):
            history[name].append(value)
    return {name: np.array(values) for name, values in history.items()}
