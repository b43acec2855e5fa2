"""Random machines through the command `design`; what its C does on the true ones, by SciPy and a compiler alone.

A machine has 1 to 6 flexible modes of either sign, perhaps viscous friction, and a delay of 0 to 3 samples, whole or
not. It is given as matrices or as a noisy frequency response. From number 1000 on it is a chain of masses, free or on
springs to the ground, whose dampers its mode shapes do not decouple, and always measured. The C that is written is compiled, its linear map read
out of its states, and closed around the sampled plant with its exact zero-order hold and delay, everywhere in the box
that was stated, of frequencies, gain and damping: `python benchmarks/machines.py [FIRST [LAST [RESULTS.jsonl [BEFORE.jsonl]]]]`, of
sixty machines without any. A file of results is gone on with; with that of an earlier search the gain is stated.
"""

import ctypes
import json
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "lib"))

import numpy as np  # noqa: E402
from scipy import linalg  # noqa: E402

from stillwork.base.checks import InputError  # noqa: E402
from stillwork.machine.design import design_file  # noqa: E402
from stillwork.machine.progress import count_steps  # noqa: E402

LIMIT_DB = 6.01
LOWER = 0.995  # of a bandwidth before: a machine gets less far
COUPLED = 1000  # the first number of machines with coupled dampers
DRAWS, SWEEPS = 60, 1  # random places in the box, and looks along each axis from the worst of them


@dataclass(frozen=True)
class TrueMachine:
    """The true machine, known to the judge alone."""

    mass: float  # kg, or kg m^2
    friction: float  # b/m, 1/s
    frequencies: np.ndarray  # rad/s, of the flexible modes
    damping: np.ndarray
    shares: np.ndarray  # residues over that of the rigid body
    delay: float  # s, from command to force
    ground: float = 0.0  # rad/s, of the suspension of a machine on springs
    velocity: np.ndarray | None = (
        None  # s, share of each mode's part that grows with s, the whole body's first
    )

    def response(self, omega):
        """Force to position in continuous time."""
        s = 1j * omega
        whole = 0.0
        for (stiffness, loss), share, rising in zip(*self.parts, strict=True):
            whole = whole + (share + s * rising) / (s * s + loss * s + stiffness)
        return whole * np.exp(-s * self.delay) / self.mass

    @property
    def parts(self):
        """Of the whole body and of each mode: stiffness and loss over mass, and the shares of position and velocity."""
        w, z = self.frequencies, self.damping
        rates = [(self.ground**2, self.friction), *zip(w * w, 2 * z * w, strict=True)]
        return (
            rates,
            np.append(1.0, self.shares),
            np.zeros(len(rates)) if self.velocity is None else self.velocity,
        )

    def sampled(self, sample_time):
        """A, b, c of the exact zero-order hold: the force of a period arrives late by the delay."""
        whole = int(np.floor(self.delay / sample_time + 1e-9))
        part = max(self.delay - whole * sample_time, 0.0)
        rates, gains, rising = self.parts
        n = 2 * len(rates)
        a, old, new, c = np.zeros((n, n)), np.zeros(n), np.zeros(n), np.zeros(n)
        for k, (stiffness, loss) in enumerate(rates):
            place = slice(2 * k, 2 * k + 2)
            after, held = _held(stiffness, loss, sample_time - part)
            before, earlier = _held(stiffness, loss, part)
            a[place, place], new[place], old[place] = after @ before, held, after @ earlier
            c[2 * k : 2 * k + 2] = gains[k] / self.mass, rising[k] / self.mass
        size = n + whole + 1  # the force of the period before, and those under way
        big, b, out = np.zeros((size, size)), np.zeros(size), np.append(c, np.zeros(whole + 1))
        big[:n, :n] = a
        big[:n, n] = old  # place n holds the force that is older by one than the newest that acts
        if whole:
            big[:n, n + 1] = new
            for k in range(n, size - 1):
                big[k, k + 1] = 1.0
            b[-1] = 1.0
        else:
            b[:n], b[n] = new, 1.0
        return big, b, out


def _held(stiffness, loss, length):
    """Transition over `length` of one mode of mass 1, and what a force of 1 adds meanwhile."""
    whole = np.zeros((3, 3))
    whole[0, 1], whole[1] = 1.0, [-stiffness, -loss, 1.0]
    found = linalg.expm(whole * length)
    return found[:2, :2], found[:2, 2]


def draw_machine(rng: np.random.Generator, sample_time: float, highest_hz: float) -> TrueMachine:
    """Of the wide class."""
    count = int(rng.integers(1, 7))
    ratios = np.append(1.0, rng.uniform(1.25, 2.2, count - 1))
    hertz = 10 ** rng.uniform(1.6, 2.4) * np.cumprod(ratios)
    hertz = hertz[hertz < highest_hz]
    count = len(hertz)
    return TrueMachine(
        mass=10 ** rng.uniform(-3, 2),
        friction=float(rng.choice([0.0, 1.0])) * 10 ** rng.uniform(-1, 1.5),
        frequencies=2 * np.pi * hertz,
        damping=10 ** rng.uniform(-2.7, -1.5, count),
        shares=10 ** rng.uniform(-1.2, 0, count) * rng.choice([-1.0, 1.0], count, p=[0.4, 0.6]),
        delay=float(rng.choice([rng.integers(0, 4), rng.uniform(0, 3)])) * sample_time,
    )


def draw_coupled(rng: np.random.Generator, sample_time: float, highest_hz: float) -> TrueMachine:
    """A chain of three to five masses, pushed at the first, with a damper of its own beside each spring."""
    n = int(rng.integers(3, 6))
    masses = 10 ** rng.uniform(-1, 2) * 10 ** rng.uniform(-1, 0, n)
    links = np.eye(n) - np.eye(n, k=-1)  # the first to the ground
    lighter = masses[1:] * masses[:-1] / (masses[1:] + masses[:-1])
    ends = 2 * np.pi * 10 ** rng.uniform(1.8, 2.5, n - 1)
    springs = np.append(0.0, lighter * ends**2)
    dampers = np.append(0.0, 2 * 10 ** rng.uniform(-2.7, -1.0, n - 1) * lighter * ends)
    if rng.integers(2):
        soft = 2 * np.pi * rng.uniform(1, 4)
        springs[0], dampers[0] = masses.sum() * soft**2, 2 * rng.uniform(0.01, 0.1) * masses.sum() * soft
    spring, damper = (links.T @ np.diag(each) @ links for each in (springs, dampers))
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-spring / masses[:, None], -damper / masses[:, None]]])
    into, out = np.zeros(2 * n), np.zeros(2 * n)
    into[n], out[int(rng.integers(0, n))] = 1 / masses[0], 1.0
    poles, left, right = linalg.eig(a, left=True)
    residues = (out @ right) * (left.conj().T @ into) / np.sum(left.conj() * right, axis=0)
    chosen = np.flatnonzero(poles.imag > 1e-3)
    chosen = chosen[np.abs(poles[chosen]).argsort()]
    p, r = poles[chosen], residues[chosen]
    gains, rising = -2 * (r * p.conj()).real, 2 * r.real
    if not springs[0]:  # the rigid body's poles are no pair
        p, gains, rising = np.append(0.0, p), np.append(1 / masses.sum(), gains), np.append(0.0, rising)
    seen = np.abs(p[1:]) < 2 * np.pi * highest_hz
    keep = np.append(True, seen)
    return TrueMachine(
        mass=float(1 / gains[0]),
        friction=2 * abs(float(p[0].real)),
        frequencies=np.abs(p[1:])[seen],
        damping=(-p[1:].real / np.abs(p[1:]))[seen],
        shares=(gains[1:] / gains[0])[seen],
        delay=rng.uniform(0, 2) * sample_time,
        ground=float(np.abs(p[0])),
        velocity=(rising / gains[0])[keep],
    )


def write_response(file: Path, machine: TrueMachine, noise: float, rng: np.random.Generator) -> None:
    """A noisy frequency response with its coherence, lines that resolve every mode."""
    hertz = machine.frequencies / (2 * np.pi)
    width = float((machine.damping * hertz).min())
    first = machine.ground / (8 * np.pi) or hertz[0] / 20
    lines = np.arange(first, 1.4 * hertz[-1], max(0.4 * width, hertz[-1] / 20_000))
    omega = 2 * np.pi * lines
    errors = rng.standard_normal((2, len(lines)))
    seen = machine.response(omega) * (1 + noise * (errors[0] + 1j * errors[1]) / np.sqrt(2))
    coherence = np.full(len(lines), 1 / (1 + noise**2))
    np.savez(file, **{"frequency (Hz)": lines, "h (m/N)": seen, "coherence": coherence})


def write_matrices(file: Path, machine: TrueMachine) -> None:
    """M, D and K in modal coordinates: the machine's own are not what `design` works in."""
    w, z = np.append(0.0, machine.frequencies), np.append(0.0, machine.damping)
    rates = 2 * z * w
    rates[0] = machine.friction
    sizes = np.sqrt(np.abs(np.append(1.0, machine.shares)) / machine.mass)
    signs = np.sign(np.append(1.0, machine.shares))
    turn = linalg.qr(np.random.default_rng(len(w)).standard_normal((len(w), len(w))))[0]
    arrays = {"M": np.eye(len(w)), "K": turn @ np.diag(w**2) @ turn.T, "D": turn @ np.diag(rates) @ turn.T}
    np.savez(file, **arrays, input=turn @ sizes, output=(turn @ (signs * sizes))[None])


def linear_map(folder: Path, name: str = "controller"):
    """A, B, C, D of the compiled C from (r, y) to the force, each column by one step from one state or input.

    A struct of zeros has states of zero, which come first in it, and what rounding has left of them after them.
    """
    real = ctypes.c_double
    header = (folder / f"{name}.h").read_text()
    inputs = int(re.search(r"_INPUTS (\d+)", header)[1])
    states = int(re.search(r"_STATES (\d+)", header)[1])
    library = folder / f"{name}.so"
    source = str(folder / f"{name}.c")
    subprocess.run(["gcc", "-std=c99", "-O2", "-shared", "-fPIC", source, "-o", str(library)], check=True)
    loaded = ctypes.CDLL(str(library))
    step, tuning = (
        getattr(loaded, f"{name}_step"),
        ctypes.byref(ctypes.c_char.in_dll(loaded, f"{name}_designed")),
    )
    room = 2 * states + 64  # states, what rounding has left of them, and what else the struct may hold
    columns = np.zeros((states + 1, states + inputs))
    for k in range(states + inputs):
        state, given, known, force = (real * room)(), (real * inputs)(), (real * 1)(), (real * 1)()
        if k < states:
            state[k] = 1.0
        else:
            given[k - states] = 1.0
        step(state, tuning, given, known, force)
        columns[:states, k], columns[states, k] = np.add(state[:states], state[states : 2 * states]), force[0]
    if inputs == 1:  # the error
        columns = np.hstack([columns, -columns[:, -1:]])
    return np.split(columns[:states], [states], axis=1) + np.split(columns[states:], [states], axis=1)


def judge(machine: TrueMachine, controller, sample_time: float) -> tuple[float, float, float]:
    """Largest sensitivity and largest r to e, dB, and the largest closed-loop pole of one true machine."""
    a, b, c, d = controller
    ap, bp, cp = machine.sampled(sample_time)
    loop = np.block([[ap + np.outer(bp, d[0, 1] * cp), bp[:, None] @ c], [b[:, 1:] @ cp[None], a]])
    radius = float(np.abs(linalg.eigvals(loop)).max())
    poles = np.angle(np.concatenate([linalg.eigvals(a), linalg.eigvals(loop)])) / sample_time
    near = np.concatenate([machine.frequencies, np.abs(poles)])[:, None]
    omega = [
        np.geomspace(1, 0.999 * np.pi / sample_time, 800),
        (near * (1 + np.linspace(-0.02, 0.02, 41))).ravel(),
    ]
    omega = np.concatenate(omega)
    omega = np.unique(omega[(omega > 1) & (omega < np.pi / sample_time)])
    best = np.zeros(2)
    for _ in range(2):  # once more, finer, about the highest peaks
        z = np.exp(1j * omega * sample_time)
        p = response(ap, bp[:, None], cp[None], np.zeros((1, 1)), z)[0]
        k_r, k_y = response(a, b, c, d, z)
        sizes = np.abs([1 / (1 - k_y * p), 1 - k_r * p / (1 - k_y * p)])
        peaks = omega[np.argsort(sizes.max(axis=0))[-8:]]
        omega = np.unique(
            np.concatenate([peaks, *(peak * (1 + np.linspace(-2e-3, 2e-3, 41)) for peak in peaks)])
        )
        omega = omega[omega < np.pi / sample_time]
        best = np.maximum(best, sizes.max(axis=1))
    return (*(float(each) for each in 20 * np.log10(best)), radius)


def response(a, b, c, d, z):
    """c (z - a)^-1 b + d of one output at each z, shape (inputs, frequencies), by one Hessenberg form."""
    h, q = linalg.hessenberg(a, calc_q=True)
    left, right = c @ q, q.T @ b
    # Balanced solves of all frequencies at once: these are small matrices.
    solved = np.linalg.solve(
        z[:, None, None] * np.eye(len(a)) - h, np.broadcast_to(right, (len(z), *right.shape))
    )
    return (left @ solved)[:, 0].T + d.T


def moved(machine: TrueMachine, box: dict, place: np.ndarray) -> TrueMachine:
    """The machine at a place of the box, each coordinate from -1 to 1: modes' frequency, residue and damping, then the rest."""
    n = len(machine.frequencies)
    frequency, residue, damping = (
        1 + np.resize(box.get(name, 0.0), n) * place[k * n : (k + 1) * n]
        for k, name in enumerate(("frequency", "residue", "damping"))
    )
    gain, mass, delay = place[3 * n :]
    stays = 1 + box.get("mass", 0.0) * mass
    return replace(
        machine,
        mass=machine.mass * stays / (1 + box.get("gain", 0.0) * gain),
        shares=machine.shares * residue * stays,  # the flexible part does not change with the rigid body
        frequencies=machine.frequencies * frequency,
        damping=machine.damping * damping,
        velocity=None
        if machine.velocity is None
        else machine.velocity * np.append(1.0, residue * stays / frequency),
        delay=max(machine.delay + box.get("delay", 0.0) * delay, 0.0),
    )


def worst(machine: TrueMachine, controller, box: dict, sample_time: float, rng, draws: int = DRAWS):
    """Largest peaks (dB) and pole over corners, draws and a search from the worst of them."""
    size = 3 * len(machine.frequencies) + 3
    at = lambda place: np.array(judge(moved(machine, box, place), controller, sample_time))  # noqa: E731
    best, start, names = at(np.zeros(size)), np.zeros(size), ("frequency", "residue", "damping")
    used = [bool(np.any(box.get(name, 0.0))) for name in names]
    used = np.append(
        np.repeat(used, len(machine.frequencies)), [bool(box.get(name)) for name in ("gain", "mass", "delay")]
    )
    top, whole = best[:2].max(), best
    for draw in range(draws):
        place = rng.choice([-1.0, 0.0, 1.0], size) if draw % 2 else rng.uniform(-1, 1, size)
        place = place * used
        found = at(place)
        whole = np.maximum(whole, found)
        if found[:2].max() > top:
            top, start = found[:2].max(), place
    for _ in range(SWEEPS):
        for axis in np.flatnonzero(used):
            for value in (-1.0, -0.5, 0.0, 0.5, 1.0, start[axis] - 0.15, start[axis] + 0.15):
                place = start.copy()
                place[axis] = np.clip(value, -1, 1)
                found = at(place)
                whole = np.maximum(whole, found)
                if found[:2].max() > top:
                    top, start = found[:2].max(), place
    return whole


def asked_box() -> dict:
    """Settings of every design of this benchmark."""
    return {"frequency": 0.05, "gain": 0.1, "damping": 0.2}


def try_machine(number: int, draws: int = DRAWS) -> dict:
    """A machine by its number: drawn, designed for and judged; what was promised, and what is true."""
    rng = np.random.default_rng(number)
    rate = float(rng.choice([2e3, 4e3, 1e4, 2e4]))
    coupled = number >= COUPLED
    machine = (draw_coupled if coupled else draw_machine)(rng, 1 / rate, 0.45 * rate)
    measured = bool(rng.integers(2)) or coupled
    noise = 10 ** rng.uniform(-4, -2)
    own = min(int(rng.integers(0, 2)), int(machine.delay * rate + 1e-9)) if measured else machine.delay * rate
    found = {
        "number": number,
        "form": ("coupled" if coupled else "measured") if measured else "matrices",
        "modes": len(machine.frequencies),
        "negative": int((machine.shares < 0).sum()),
        "friction_1_s": machine.friction,
        "rate_hz": rate,
        "delay_samples": machine.delay * rate,
    }
    start = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        file, out = Path(folder) / "machine.npz", Path(folder) / "out"
        if measured:
            late = replace(machine, delay=machine.delay - own / rate)
            write_response(file, late, noise, rng)
        else:
            write_matrices(file, machine)
        try:
            said = design_file(str(file), str(out), rate, delay=own, uncertainty=asked_box())
        except InputError as error:
            return found | {"refused": str(error), "seconds": time.process_time() - start}
        found["seconds"] = time.process_time() - start
        held = json.loads((out / "controller.json").read_text())
        controller = linear_map(out)
    sizes = [float(each) for each in re.findall(r"S_[IO] (-?[\d.]+) dB", said[1])]
    # About the true machine: the box that was stated. The design has to add the errors of the fit.
    sensitivity, error, radius = worst(
        machine, controller, asked_box(), 1 / rate, np.random.default_rng(1000 + number), draws
    )
    return found | {
        "use": held["provenance"]["use"],
        "phases": any("phases of their own" in line for line in held["provenance"]["notes"]),
        "mass_error": held["provenance"]["mass"] / machine.mass - 1,
        "design_hz": held["provenance"]["design_hz"],
        "bandwidth_hz": float(re.search(r"bandwidth of ([\d.]+) Hz", said[0])[1]),
        "waits": held["provenance"]["settings"]["wait"],
        "promised_db": max(sizes, default=None),
        "sensitivity_db": float(sensitivity),
        "r_to_e_db": float(error),
        "largest_pole": float(radius),
    }


def line_of(each: dict) -> str:
    """What is printed of a machine."""
    if "refused" in each:
        return f"{each['number']:3d} refused: {each['refused']}"
    return (
        f"{each['number']:3d} {each['form']} {each['modes']} modes {each['negative']} negative, "
        f"b/m {each['friction_1_s']:.2g}, {each['rate_hz']:6.0f} Hz, {each['delay_samples']:.2f} late, "
        f"mass {100 * each['mass_error']:+.2g} %{', phases' * each['phases']}, {each['use']:16s} waits {each['waits']:g}, {each['bandwidth_hz']:6.1f} Hz; promised {each['promised_db']:.2f} dB, S "
        f"{each['sensitivity_db']:.2f} dB, r to e {each['r_to_e_db']:.2f} dB, poles {each['largest_pole']:.6f}; "
        f"{each['seconds']:.0f} s"
    )


def read_results(file: str) -> dict[int, dict]:
    """The machines of a file of results by their numbers."""
    lines = Path(file).read_text().splitlines() if file and Path(file).exists() else []
    return {each["number"]: each for each in map(json.loads, lines)}


def gain_line(found: dict[int, dict], before: dict[int, dict]) -> str:
    """How much further the bandwidths go than before, on the machines of both; a refused one has none."""
    both = sorted(found.keys() & before.keys())
    pairs = [[each[n].get("bandwidth_hz", 0.0) for each in (found, before)] for n in both]
    ratios = np.array([new / old for new, old in pairs if old] or [np.nan])
    lower = [n for n, (new, old) in zip(both, pairs, strict=True) if new < LOWER * old]
    return (
        f"{len(both)} tried before: bandwidth {np.median(ratios):.3f} times as large (median), {ratios.min():.3f} to "
        f"{ratios.max():.3f} times, below {LOWER} times on {lower}; {sum(new > old == 0 for new, old in pairs)} were refused before"
    )


def main(first: str = "0", last: str = "60", results: str = "", before: str = "") -> None:
    """Try machines, all but those that the file `results` holds already, and print what was promised and what is true."""
    kept = Path(results) if results else None
    known = read_results(results)
    step = count_steps(int(last) - int(first), "machines")
    for number in range(int(first), int(last)):
        if number not in known:
            known[number] = try_machine(number)
            if kept:
                with kept.open("a") as file:
                    file.write(json.dumps(known[number]) + "\n")
        print(line_of(known[number]), flush=True)
        step()
    tried = list(known.values())
    judged = [each for each in tried if "refused" not in each]
    refused = Counter(
        re.sub(r"[-+]?\d[\d.e+-]*", "#", each["refused"].partition("machine.npz")[2])[:60]
        for each in tried
        if "refused" in each
    )
    above = [each["number"] for each in judged if max(each["sensitivity_db"], each["r_to_e_db"]) > LIMIT_DB]
    unstable = [each["number"] for each in judged if each["largest_pole"] >= 1]
    spent = [each["seconds"] for each in judged] or [0.0]
    print(
        f"{len(tried)} machines, {len(tried) - len(judged)} refused, {len(above)} above {LIMIT_DB} dB {above}, "
        f"{len(unstable)} unstable {unstable}; {np.mean(spent):.1f} s of CPU each, at most {max(spent):.0f} s"
    )
    if before:
        print(gain_line(known, read_results(before)))
    for reason, count in refused.most_common():
        print(f"  {count} refused: {reason}")


if __name__ == "__main__":
    main(*sys.argv[1:5])
