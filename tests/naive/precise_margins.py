"""Crossings and margins of a loop in decimal arithmetic of 70 digits: its responses by elimination, roots by bisection."""

from dataclasses import replace
from decimal import Context, Decimal, localcontext
from itertools import pairwise
from math import atan, atan2, degrees, inf, pi

import numpy as np

from naive.precise import DIGITS, Complex, extreme, place, response
from stillwork import control, estimation, lti
from stillwork.lti.discretisation import tustin
from stillwork.lti.peaks import refine_peak

KINDS = ("continuous", "sampled", "late", "light", "opposed", "grazing", "observed", "grazing late")


def sample_case(rng):
    """A kind, a loop of one to three modes beside a rigid body, and its controller; grazing: a peak of |L| at nearly 1."""
    kind = KINDS[int(rng.integers(len(KINDS)))]
    modes = int(rng.integers(1, 4))
    mass = 10 ** rng.uniform(-1, 2)
    hertz = np.sort(10 ** rng.uniform(1.5, 3, modes))
    damping = 10 ** rng.uniform(-9 if kind == "light" else -4, -1, modes)
    signs = rng.choice([-1, 1], modes) if kind in ("opposed", "late", "grazing late") else np.ones(modes)
    shares = signs * 10 ** rng.uniform(-2, 0.3, modes)
    size = 1 / np.sqrt(mass)
    plant = lti.ModalModel(
        np.append(0.0, 2 * np.pi * hertz),
        np.append(0.0, damping),
        np.full((modes + 1, 1), size),
        size * np.append(1.0, shares)[None],
        np.zeros((1, 1)),
    )
    sampled = kind in ("sampled", "late", "grazing late") or (kind == "light" and rng.random() < 0.5)
    rate = hertz[0] * 10 ** rng.uniform(0.8, 2)
    delay = float(rng.choice([1.0, 1.5, 3.25])) if "late" in kind else 0.0
    compensator = None
    if kind == "observed":
        noise = estimation.NoiseIntensities(1.0, 10 ** rng.uniform(-16, -10))
        compensator = control.compensator(
            estimation.kalman_observer(plant, noise), control.Application(True, 0.1)
        )
    loop = control.make_loop(
        plant, compensator, sample_time=1 / rate if sampled else 0.0, delay=delay if sampled else 0.0
    )
    highest = min(0.5 * hertz[0], rate / 12 if sampled else inf)
    pid = control.PidFamily(mass)(highest * 10 ** rng.uniform(-2, 0))
    if "grazing" in kind:
        size = np.abs(loop.at(pid).loop)
        tops = np.flatnonzero((size[1:-1] > size[:-2]) & (size[1:-1] > size[2:])) + 1
        if len(tops):
            peak = refine_peak(lambda w: loop.at(pid, w).loop, loop.omega[tops[-1] - 1 : tops[-1] + 2],
                                   size[tops[-1] - 1 : tops[-1] + 2]).magnitude  # fmt: skip
            factor = (1 + rng.choice([-1, 1]) * 10 ** rng.uniform(-12, -3)) / peak
            pid = replace(pid, gain=pid.gain * factor)
    return kind, loop, pid


class OpenLoop:
    """The two open loops, in floats to look at, and in decimals; over w, z = (1 + jw) / (1 - jw) of a sampled one."""

    def __init__(self, loop, pid):
        feedback = pid.state_space()
        self.sample_time = loop.sample_time
        self.plant = loop.sampled_plant if loop.sample_time else loop.plant.state_space()
        self.pid = tustin(feedback, loop.sample_time) if loop.sample_time else feedback
        self.compensator = loop.compensator

    @staticmethod
    def both(p, c, o, one):
        """What the controller sees, and what the plant's output sees: Figs 3.4 and 3.20 solved by hand."""
        (o_uu, o_uy), (o_yu, o_yy) = o
        seen = ((one - o_yy) * p - o_yu) / (one - o_uu - o_uy * p) * c
        return seen, p * ((c * (one - o_yy) - o_uy) / (one - c * o_yu - o_uu))

    def exact(self, w):
        models = self.plant, self.pid, self.compensator
        [[p]], [[c]], o = (response(each, place(self.plant, w)) for each in models)
        return self.both(p, c, o, Complex(1))

    def exact_end(self):
        """At half the rate."""
        [[p]], [[c]], o = (response(each, Complex(-1)) for each in (self.plant, self.pid, self.compensator))
        return self.both(p, c, o, Complex(1))

    def rough(self, w):
        s = (1 + 1j * w) / (1 - 1j * w) if self.sample_time else 1j * w

        def of(model):
            n = len(model.a)
            inner = np.linalg.solve(s[:, None, None] * np.eye(n) - model.a, model.b + 0j) if n else 0.0
            whole = (model.c @ inner if n else 0.0) + np.broadcast_to(model.d, (len(s), *model.d.shape))
            return np.moveaxis(whole, 0, -1)

        return self.both(of(self.plant)[0, 0], of(self.pid)[0, 0], of(self.compensator), 1.0)

    def grid(self):
        poles = np.concatenate(
            [np.linalg.eigvals(each.a) for each in (self.plant, self.pid, self.compensator) if len(each.a)]
        ).astype(complex)
        if self.sample_time:
            poles = poles[np.abs(poles + 1) > 1e-9]
            poles = (poles - 1) / (poles + 1)
        poles = poles[np.abs(poles) > 1e-12]
        steps = np.sinh(np.linspace(-16, 16, 1001)) * 1e-3
        around = np.abs(poles.imag)[:, None] + np.maximum(np.abs(poles.real), 1e-12)[:, None] * steps
        size = np.abs(poles)
        wide = np.geomspace(size.min() * 1e-4, size.max() * 1e4, 6000)
        return np.unique(np.concatenate([around[around > size.min() * 1e-5], wide]))


def _crossings(function, w, size):
    """Where the square of a magnitude passes 1, and whether it falls there; a grazing peak may do so between two points."""
    places = dict(zip(map(Decimal, w.tolist()), (size >= 1).tolist(), strict=True))
    for sign in (1, -1):
        inner = sign * size
        tops = 1 + np.flatnonzero((inner[1:-1] >= inner[:-2]) & (inner[1:-1] >= inner[2:]))
        for k in tops[np.abs(np.log(size[tops])) < 0.2]:
            at = extreme(function, w[k - 1], w[k + 1], sign)
            places[at] = function(at) >= 1
    ordered = sorted(places)
    return [
        (_root(lambda x: function(x) - 1, one, two), places[one])
        for one, two in pairwise(ordered)
        if places[one] != places[two]
    ]


def _root(function, low, high):
    """Where a decimal function changes its sign, to about 30 digits, by false position with Illinois' rule."""
    low, high = Decimal(low), Decimal(high)
    one, two = function(low), function(high)
    for _ in range(80):
        middle = high - two * (high - low) / (two - one)
        value = function(middle)
        if value == 0 or abs(high - low) < abs(high) * Decimal("1e-30"):
            return middle
        if (value > 0) != (two > 0):
            low, one = high, two
        else:
            one /= 2
        if abs(middle - high) < abs(high) * Decimal("1e-32"):
            return middle
        high, two = middle, value
    return high


def judged_margins(loop, pid):
    """First crossing and margins, by the names of `loop_margins`; none but the crossing of an unstable loop."""
    whole = control.closed_loop(
        loop.sampled_plant if loop.sample_time else loop.plant,
        loop.compensator,
        tustin(pid.state_space(), loop.sample_time) if loop.sample_time else pid.state_space(),
    )
    poles = np.linalg.eigvals(whole.a)
    stable = np.abs(poles).max() < 1 if loop.sample_time else poles.real.max() < 0
    open_loop = OpenLoop(loop, pid)
    w = open_loop.grid()
    seen, output = open_loop.rough(w)
    observed = len(loop.compensator.a) > 0
    with localcontext(Context(DIGITS)):
        passes = _crossings(lambda x: open_loop.exact(x)[0].square(), w, np.abs(seen))
        falls = [at for at, down in passes if down]
        crossing = inf
        if falls:
            at = falls[0]
            crossing = atan(float(at)) / (pi * loop.sample_time) if loop.sample_time else float(at) / (2 * pi)
        found = {"crossing_hz": crossing}
        if not stable:
            lost = dict.fromkeys(("gain_margin", "phase_margin", "modulus_margin"), 0.0)
            return found | lost | {"gain_reduction": 1.0}

        def apart(x):
            return (open_loop.exact(x)[1] + Complex(1)).square()

        distance = np.abs(1 + output)
        k = int(np.clip(np.nanargmin(distance), 1, len(w) - 2))
        nearest = apart(extreme(apart, w[k - 1], w[k + 1], -1)).sqrt()
        angles, factors = [pi], []
        if observed:
            passes = _crossings(lambda x: open_loop.exact(x)[1].square(), w, np.abs(output))
        for at, _ in passes:
            there = open_loop.exact(at)[1]
            angles.append(atan2(abs(float(there.im)), -float(there.re)))
        upper = output.imag > 0
        for k in np.flatnonzero(
            (upper[1:] != upper[:-1]) & (np.minimum(output.real[1:], output.real[:-1]) < 0)
        ):
            at = _root(lambda x: open_loop.exact(x)[1].im, float(w[k]), float(w[k + 1]))
            factors.append(float(-1 / open_loop.exact(at)[1].re))
        if loop.sample_time:
            end = open_loop.exact_end()[1]
            factors.append(float(-1 / end.re) if end.re else -1.0)
    return found | {
        "gain_reduction": max([0.0, *(each for each in factors if 0 < each < 1)]),
        "gain_margin": min([inf, *(each for each in factors if each > 1)]),
        "phase_margin": degrees(min(angles)),
        "modulus_margin": float(nearest),
    }
