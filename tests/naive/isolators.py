"""Isolators that the toolbox did not make: drawn, integrated exactly between samples, with a loop in C around them.

Shares no code with the library: matrix exponentials of scipy, spectra by hand, the plant's own few lines of C.
"""

import ctypes
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import linalg, signal

FINE = 4  # steps of the plant within a sample of the loop: between these the floor runs straight
DRIVER = """
#include <string.h>
#include "{name}.h"

static long kept; /* samples in which weights were kept */
long kept_samples(void) {{ return kept; }}

/* A plant x+ = A x + B (f, a0, change of a0) with the acceleration C x, {fine} steps a sample; f comes `late` samples late. */
int simulate(long samples, int states, int late, int adapting, const double *a, const double *b, const double *c,
             const double *floor, const double *noise, double *weights, long first, {name}_state *s, double *out,
             double *forces)
{{
    enum {{ A = {NAME}_AXES, S = {NAME}_SENSORS, I = A + 2 * S, N = {NAME}_REGRESSORS }};
    static double x[256], ring[16][A];
    unsigned raised;
    double next[256];
    unsigned flags = 0;
    s->adapting = adapting;
    if (first == 0) {{ /* a library stays loaded, with the end of the last run */
        memset(x, 0, sizeof x);
        memset(ring, 0, sizeof ring);
        kept = 0;
    }}
    for (long k = 0; k < samples; k++) {{
        double in[I], read_floor[S], read_platform[A], command[A];
        for (int j = 0; j < S; j++)
            read_floor[j] = floor[k * {fine} * S + j] + noise[k * (A + S) + A + j];
        for (int i = 0; i < A; i++) {{
            read_platform[i] = noise[k * (A + S) + i];
            for (int j = 0; j < states; j++)
                read_platform[i] += c[i * states + j] * x[j];
        }}
        raised = {name}_step(s, read_floor, read_platform, command);
        flags |= raised;
        kept += (raised & {NAME}_FROZEN) != 0;
        for (int j = 0; j < A; j++) {{
            ring[(first + k + late) % (late + 1)][j] = command[j];
            in[j] = ring[(first + k) % (late + 1)][j];
            forces[k * A + j] = command[j];
        }}
        for (int step = 0; step < {fine}; step++) {{
            for (int i = 0; i < A; i++) {{
                double y = 0;
                for (int j = 0; j < states; j++)
                    y += c[i * states + j] * x[j];
                out[(k * {fine} + step) * A + i] = y;
            }}
            const double *now = floor + (k * {fine} + step) * S;
            const double *then = (k == samples - 1 && step == {fine} - 1) ? now : now + S;
            for (int j = 0; j < S; j++) {{
                in[A + j] = now[j];
                in[A + S + j] = then[j] - now[j];
            }}
            for (int i = 0; i < states; i++) {{
                next[i] = 0;
                for (int j = 0; j < states; j++)
                    next[i] += a[i * states + j] * x[j];
                for (int j = 0; j < I; j++)
                    next[i] += b[i * I + j] * in[j];
            }}
            for (int i = 0; i < states; i++)
                x[i] = next[i];
        }}
    }}
    for (int i = 0; i < A * N; i++)
        weights[i] = s->adapt.weights[i / N][i % N];
    return (int)flags;
}}
unsigned long size_of_state(void) {{ return sizeof({name}_state); }}
"""


@dataclass(frozen=True)
class TrueIsolator:
    """M q'' + C (q' - q0') + K (q - q0) = f along the actuators, f behind a first-order lag and whole samples."""

    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    floor: np.ndarray  # feet per floor sensor
    pole: float  # rad/s
    late: int  # samples
    rate: float  # Hz
    floor_noise: float
    platform_noise: float
    limit: float  # N

    def matrices(self):
        """A, B and C from (held command, floor acceleration, its change over the step) to the platform's acceleration.

        States: relative position and velocity, the actuators' lag; the floor runs straight between samples.
        """
        n, s = self.floor.shape
        inverse = np.linalg.inv(self.mass)
        stiff, loss = inverse @ self.stiffness, inverse @ self.damping
        zero, one = np.zeros((n, n)), np.eye(n)
        a = np.block([[zero, one, zero], [-stiff, -loss, inverse], [zero, zero, -self.pole * one]])
        force = np.vstack([zero, zero, self.pole * one])
        moves = np.vstack([np.zeros((n, s)), -self.floor, np.zeros((n, s))])
        h, states = 1 / (FINE * self.rate), 3 * n
        whole = np.zeros((states + n + 2 * s,) * 2)
        whole[:states] = np.hstack([a, force, moves, np.zeros((states, s))])
        whole[states + n : states + n + s, states + n + s :] = np.eye(s) / h
        step = linalg.expm(whole * h)[:states]
        c = np.hstack([-stiff, -loss, inverse])
        return step[:, :states], step[:, states:], c

    def response(self, hertz):
        """Acceleration per command in continuous time, lag, samples and hold within, (frequencies, axes, axes)."""
        s = 2j * np.pi * hertz[:, None, None]
        whole = s * s * np.linalg.inv(s * s * self.mass + s * self.damping + self.stiffness)
        held = (1 - np.exp(-s / self.rate)) / (s / self.rate)
        return whole * self.pole / (s + self.pole) * np.exp(-s * self.late / self.rate) * held

    def toml(self, more=""):
        """What the command is told of it."""

        def rows(matrix):
            return "[" + ", ".join(str(row) for row in matrix.tolist()) + "]"

        return f"""[isolator]
mass = {rows(self.mass)}
damping = {rows(self.damping)}
stiffness = {rows(self.stiffness)}
floor = {rows(self.floor)}
actuator_pole_hz = {self.pole / 2 / np.pi!r}
delay_s = {self.late / self.rate!r}

[noise]
floor = {float(self.floor_noise)!r}
platform = {float(self.platform_noise)!r}
{more}"""


def draw_isolator(rng, axes, rate):
    """Modes of 8 to 60 Hz within a factor of 4 of one another, damping of 1 to 10 %, any directions."""
    turn = linalg.qr(rng.standard_normal((axes, axes)))[0]
    masses = 10 ** rng.uniform(0, 2) * rng.uniform(0.5, 2, axes)
    lowest = 10 ** rng.uniform(np.log10(8), np.log10(20))
    omega = 2 * np.pi * lowest * np.sort(rng.uniform(1, 3, axes))
    root = turn * np.sqrt(masses)
    mass = root @ root.T
    shapes = linalg.inv(root).T @ linalg.qr(rng.standard_normal((axes, axes)))[0]
    back = linalg.inv(shapes)
    stiffness = back.T @ np.diag(omega**2) @ back
    damping = back.T @ np.diag(2 * rng.uniform(0.01, 0.1, axes) * omega) @ back
    sensors = axes if axes < 3 else int(rng.integers(3, axes + 1))
    floor = rng.standard_normal((axes, sensors)) / np.sqrt(sensors)
    if sensors == axes:
        floor = np.eye(axes) + 0.3 * rng.standard_normal((axes, axes))
    symmetric = [(each + each.T) / 2 for each in (mass, damping, stiffness)]
    noise = 10 ** rng.uniform(-5.5, -4.5, 2)
    return TrueIsolator(
        *symmetric,
        floor,
        2 * np.pi * 10 ** rng.uniform(2.2, 2.8),
        int(rng.integers(1, 3)),
        rate,
        *noise,
        1e4 * float(np.trace(mass)),
    )


def moved(machine, rng, share):
    """The true machine: each mode's mass, stiffness and damping, and the pole, off by up to `share` and multiples."""
    omega2, shapes = linalg.eigh(machine.stiffness, machine.mass)
    back = linalg.inv(shapes)
    n = len(omega2)

    def own(width):
        return 1 + width * share * rng.uniform(-1, 1, n)

    scale = own(1)
    damping = np.diag(shapes.T @ machine.damping @ shapes)
    return replace(
        machine,
        mass=back.T @ np.diag(scale) @ back,
        stiffness=back.T @ np.diag(omega2 * own(1)) @ back,
        damping=back.T @ np.diag(damping * own(4)) @ back,
        pole=machine.pole * (1 + 2 * share * rng.uniform(-1, 1)),
    )


class Ends:
    """Draws at the ends of an interval alone, for `moved`."""

    def __init__(self, rng):
        self.rng = rng

    def uniform(self, low, high, size=None):
        return self.rng.choice([float(low), float(high)], size)


def coloured(rng, hertz, density, samples, rate, sensors, common=0.0):
    """Gaussian floor with a density, (m/s^2)^2/Hz, at every sensor; `common` of its power is alike at all."""
    lines = np.fft.rfftfreq(samples, 1 / rate)
    size = np.sqrt(np.interp(lines, hertz, density, left=0.0, right=0.0) * rate * samples) / 2
    draws = rng.standard_normal((sensors + 1, len(lines))) + 1j * rng.standard_normal(
        (sensors + 1, len(lines))
    )
    mixed = np.sqrt(common) * draws[0] + np.sqrt(1 - common) * draws[1:]
    return np.fft.irfft(mixed * size, samples, axis=1)


def microseism(rng, hertz):
    """Density of a floor, (m/s^2)^2/Hz: a quiet or a loud band, up to three slow peaks and drift, all widely drawn."""
    level = 2e-6 * 10 ** rng.uniform(-4, 0)
    low, high = 10 ** rng.uniform(0, 0.6), 10 ** rng.uniform(1.6, 2.3)
    shape = 1 / (1 + (low / hertz) ** 4) / (1 + (hertz / high) ** 4)
    for _ in range(rng.integers(1, 4)):
        at, width = rng.uniform(0.1, 0.35), 10 ** rng.uniform(-1.7, -0.5)
        shape += 10 ** rng.uniform(-2, 4.6) * np.exp(-0.5 * (np.log(hertz / at) / width) ** 2)
    slope = rng.choice([2, 4])
    return level * (
        shape
        + 10 ** rng.uniform(-2, 3) * (0.05 / np.maximum(hertz, 0.01)) ** slope / (1 + (hertz / 0.5) ** 6)
    )


def footfalls(slab, rng, seconds, rate, sensors):
    """A slab (a seed) under a walker who comes and goes: steps of uneven strength strike two modes, m/s^2, (sensors, samples)."""
    time_s, force, own = (
        np.arange(round(seconds * rate)) / rate,
        np.zeros(round(seconds * rate)),
        np.random.default_rng(slab),
    )
    now = rng.exponential(4)
    while now < seconds:
        for step in now + 0.55 * np.arange(rng.integers(6, 20)):
            here = slice(*np.searchsorted(time_s, (step, step + 0.03)))
            force[here] += rng.lognormal(0, 0.4) * np.sin(np.pi * (time_s[here] - step) / 0.03)
        now = step + rng.exponential(6)
    rows = 3e-5 * np.sqrt(rate / 2) * rng.standard_normal((sensors, len(time_s)))
    for hertz, loss in ((own.uniform(9, 14), 0.04), (own.uniform(18, 30), 0.03)):
        w = 2 * np.pi * hertz
        ring = signal.bilinear([1, 0, 0], [1, 2 * loss * w, w * w], rate)
        share = own.uniform(0.5, 1, (sensors, 1)) * own.choice([-1, 1], (sensors, 1))
        rows += 0.03 * share * signal.lfilter(*ring, force)
    return signal.sosfilt(signal.butter(2, [2, 150], "bandpass", fs=rate, output="sos"), rows, axis=1)


class CompiledLoop:
    """The C of a folder, compiled with a plant around it."""

    def __init__(self, folder: Path, name: str):
        self.name = name
        (folder / "driver.c").write_text(DRIVER.format(name=name, NAME=name.upper(), fine=FINE))
        sources = [f"{name}.c", f"{name}_adapt.c", "driver.c"]
        command = ["gcc", "-std=c99", "-O2", "-shared", "-fPIC", *sources, "-o", "loop.so", "-lm"]
        subprocess.run(command, cwd=folder, check=True)
        self.library = ctypes.CDLL(str(folder / "loop.so"))
        self.library.size_of_state.restype = ctypes.c_ulong
        self.library.kept_samples.restype = ctypes.c_long
        self.state = (ctypes.c_char * self.library.size_of_state())()
        getattr(self.library, f"{name}_start")(self.state)
        self.done = 0

    @property
    def kept(self):
        """Samples in which the weights were kept, up to now."""
        return self.library.kept_samples()

    def begin(self, weights):
        """Start again with these weights, and the covariance of the design."""
        axes, regressors = np.shape(weights)
        stored = np.zeros(axes * regressors + regressors * (regressors + 1) // 2)
        given = stored.ctypes.data_as(ctypes.c_void_p)
        getattr(self.library, f"{self.name}_store")(self.state, given)
        place = 0
        for regressor in range(regressors):
            stored[place : place + axes] = np.asarray(weights)[:, regressor]
            place += axes + regressor + 1
        assert getattr(self.library, f"{self.name}_restore")(self.state, given)

    def run(self, machine: TrueIsolator, floor, seed, adapting=True):
        """Platform acceleration at every step of the plant, weights and all flags; plant and loop go on where they were.

        The commands of each sample are kept as `commands`.

        The floor has FINE samples for each one of the loop.
        """
        n, s = machine.floor.shape
        samples = floor.shape[1] // FINE
        level = np.sqrt(machine.rate / 2)
        noise = np.random.default_rng(seed).standard_normal((samples, n + s))
        noise *= level * np.r_[np.full(n, machine.platform_noise), np.full(s, machine.floor_noise)]
        arrays = [np.ascontiguousarray(each, float) for each in (*machine.matrices(), floor.T, noise)]
        weights, out, forces = np.zeros((n, 3 * s)), np.zeros((FINE * samples, n)), np.zeros((samples, n))

        def pointer(each):
            return each.ctypes.data_as(ctypes.c_void_p)

        flags = self.library.simulate(
            ctypes.c_long(samples), len(arrays[0]), machine.late, int(adapting), *map(pointer, arrays),
            pointer(weights), ctypes.c_long(self.done), self.state, pointer(out), pointer(forces),
        )  # fmt: skip
        self.done += samples
        self.commands = forces.T
        return out.T, weights, flags


def band_rms(rows, rate, low, high):
    """Rms of each row between two frequencies, by its own periodogram."""
    f, density = signal.periodogram(rows, rate, window="hann", detrend="constant")
    inside = (f >= low) & (f <= high)
    return np.sqrt(density[:, inside].sum(axis=1) * (f[1] - f[0]))
