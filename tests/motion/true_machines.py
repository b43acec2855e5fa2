"""True machines by SciPy alone, and the C of a controller in the loop with them, sample by sample in one program."""

import ctypes
import itertools
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, signal

from shared.compiled import call, pointer

LOOP = """
#include "{name}.h"

void loop(long states, long samples, const double *a, const double *b, const double *c, double into, double out,
          double kick, double *error)
{{
    static {name}_state zero;
    {name}_state s = zero;
    double x[64] = {{0.0}};

    for (long k = 0; k < samples; k++) {{
        double next[64], known[1] = {{0.0}}, force[1], position = 0.0, given[1];

        for (long i = 0; i < states; i++) position += c[i] * x[i];
        given[0] = (k == 0 ? kick : 0.0) - out * position;
        error[k] = given[0];
        (void){name}_step(&s, &{name}_designed, given, known, force);
        for (long i = 0; i < states; i++) {{
            next[i] = b[i] * into * force[0];
            for (long j = 0; j < states; j++) next[i] += a[i * states + j] * x[j];
        }}
        for (long i = 0; i < states; i++) x[i] = next[i];
    }}
}}
"""


@dataclass(frozen=True)
class TrueMachine:
    """A rigid body on springs and friction and modes (velocity s + position) / (s^2 + 2 z w s + w^2) beside it, behind a delay."""

    mass: float  # kg, or kg m^2
    hertz: tuple
    damping: tuple
    position: tuple  # over the mass, as all parts
    velocity: tuple = ()
    friction: float = 0.0  # b/m, 1/s
    delay: float = 0.0  # s
    springs: float = 0.0  # Hz, of the rigid body on its springs to ground

    def parts(self):
        """Numerator and denominator of each term."""
        found = [([1.0], [1.0, self.friction, (2 * np.pi * self.springs) ** 2])]
        moving = self.velocity or (0.0,) * len(self.hertz)
        for f, z, b0, b1 in zip(self.hertz, self.damping, self.position, moving, strict=True):
            w = 2 * np.pi * f
            found.append(([b1, b0] if b1 else [b0], [1.0, 2 * z * w, w * w]))
        return found

    def response(self, hertz):
        """Force to position in continuous time."""
        s = 2j * np.pi * np.asarray(hertz)
        whole = sum(np.polyval(top, s) / np.polyval(bottom, s) for top, bottom in self.parts())
        return whole * np.exp(-s * self.delay) / self.mass

    def sampled(self, rate):
        """A, b, c with the force held from sample to sample and late by the delay, exactly."""
        whole = int(self.delay * rate + 1e-9)
        part = max(self.delay * rate - whole, 0.0)
        parts = self.parts()
        n = 2 * len(parts)
        size = n + whole + 1  # then the force of the sample before, and those on their way
        a, b, c = np.zeros((size, size)), np.zeros(size), np.zeros(size)
        last = n + whole
        for k, (top, bottom) in enumerate(parts):
            place = slice(2 * k, 2 * k + 2)
            model = signal.tf2ss(top, bottom)
            after, new, *_ = signal.cont2discrete(model, (1 - part) / rate)
            early, old = np.eye(2), np.zeros((2, 1))
            if part:
                early, old, *_ = signal.cont2discrete(model, part / rate)
            a[place, place] = after @ early
            a[place, n] += (after @ old)[:, 0]
            (a[place, n + 1] if whole else b[place])[:] += new[:, 0]
            c[place] = model[2][0] / self.mass
        for k in range(n, last):
            a[k, k + 1] = 1.0
        b[last] = 1.0
        return a, b, c

    def moved(self, signs, box):
        """At a place of a box of shares, from -1 to 1: a frequency and a damping ratio of each mode, gain, friction and delay."""
        count = len(self.hertz)
        factors = 1 + box.get("frequency", 0.0) * np.asarray(signs[:count])
        ratios = 1 + box.get("damping", 0.0) * np.asarray(signs[count : 2 * count])
        gain, friction, delay = signs[2 * count :]
        return replace(
            self,
            mass=self.mass / (1 + box.get("gain", 0.0) * gain),
            hertz=tuple(np.multiply(self.hertz, factors)),
            damping=tuple(np.multiply(self.damping, ratios)),
            velocity=tuple(np.divide(self.velocity, factors)) if self.velocity else (),
            friction=max(self.friction + box.get("friction", 0.0) * friction, 0.0),
            delay=max(self.delay + box.get("delay", 0.0) * delay, 0.0),
        )


def machine_of_matrices(mass, loss, stiffness, into, out):
    """A free machine whatever its dampers, from the poles of its first-order form; they brake no motion of the whole."""
    n = len(mass)
    inverse = np.linalg.inv(mass)
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness, -inverse @ loss]])
    b, c = np.append(np.zeros(n), inverse @ into), np.append(out, np.zeros(n))
    values, left, right = linalg.eig(a, left=True)
    modes = []
    for pole, row, column in zip(values, left.T, right.T, strict=True):
        if pole.imag > 1e-3:
            residue = (c @ column) * (row.conj() @ b) / (row.conj() @ column)
            modes.append((pole, residue))
    modes.sort(key=lambda each: abs(each[0]))
    whole = float(np.ones(n) @ mass @ np.ones(n))
    poles, residues = (np.array(each) for each in zip(*modes, strict=True))
    return TrueMachine(
        mass=whole,
        hertz=tuple(np.abs(poles) / (2 * np.pi)),
        damping=tuple(-poles.real / np.abs(poles)),
        position=tuple(whole * -2 * (residues * poles.conj()).real),
        velocity=tuple(whole * 2 * residues.real),
    )


def error_law(space):
    """A, B, C, D from error to force of the state space of a controller.json, which is given its own force, too."""
    a, b, c, d = (np.array(space[name], dtype=float) for name in "abcd")
    return a + b[:, 1:] @ c, b[:, :1] + b[:, 1:] @ d[:, :1], c, d[:, :1]


class CompiledLoop:
    """The C of a controller in `folder`, closed around true machines; `into` and `out` are units of drive and sensor."""

    def __init__(self, folder, rate, into=1.0, out=1.0, name="controller"):
        self.rate, self.into, self.out = rate, into, out
        (folder / "loop.c").write_text(LOOP.format(name=name), encoding="utf-8")
        call(f"gcc -std=c99 -O2 -shared -fPIC {name}.c loop.c -o loop.so -lm".split(), folder)
        self.library = ctypes.CDLL(str(folder / "loop.so"))

    def peak_db(self, machine):
        """Largest output sensitivity, from the error after one sample of setpoint; infinite where that does not die out."""
        a, b, c = (np.ascontiguousarray(each) for each in machine.sampled(self.rate))
        slowest = min(np.multiply(machine.damping, machine.hertz), default=1.0)
        samples = int(self.rate * 30 / (2 * np.pi * slowest))
        for _ in range(7):
            error = np.zeros(samples)
            self.library.loop(
                ctypes.c_long(len(a)), ctypes.c_long(samples), *map(pointer, (a, b, c)), ctypes.c_double(self.into),
                ctypes.c_double(self.out), ctypes.c_double(1.0), pointer(error),
            )  # fmt: skip
            left, first = np.abs(error[-samples // 8 :]).max(), np.abs(error[: samples // 8]).max()
            if left < 1e-6 * first:
                return float(20 * np.log10(np.abs(np.fft.rfft(error)).max()))
            if not left < 1e3:
                return np.inf
            samples *= 2
        return np.inf

    def worst_db(self, machine, box, draws, rng):
        """Over the middle, the corners of frequencies and gain, and as many draws from faces and inside."""
        count = len(machine.hertz)
        size = 2 * count + 3
        places = [np.zeros(size)]
        for corner in itertools.product([-1.0, 1.0], repeat=min(count, 4) + 1):
            rest = rng.choice([-1.0, 1.0], size)
            rest[: min(count, 4)], rest[2 * count] = corner[:-1], corner[-1]
            places.append(rest)
        for draw in range(draws):
            places.append(rng.choice([-1.0, 0.0, 1.0], size) if draw % 2 else rng.uniform(-1, 1, size))
        return max(self.peak_db(machine.moved(place, box)) for place in places)
