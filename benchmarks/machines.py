"""Random machines through the command `design`, held against frequency errors that it never saw, by SciPy alone.

Each machine is a chain of masses with random springs, damping, sensor, rate and delay. The written controller meets
machines whose resonances differ by up to 5 %, each by itself: `python benchmarks/machines.py [FIRST [LAST]]`.
"""

import json
import re
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "lib"))

import numpy as np  # noqa: E402
from scipy import linalg, signal  # noqa: E402

from stillwork.base.checks import InputError  # noqa: E402
from stillwork.designing import NOTCHED, design_file  # noqa: E402

ERROR, DRAWS = 0.05, 100


def main(first: int = 0, last: int = 50) -> None:
    """Print a line a machine: how far it gets, against PID with notches, and the worst that the errors do."""
    for number in range(first, last):
        arrays, rate, delay = sample_machine(np.random.default_rng(number))
        start = time.process_time()
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "out"
            np.savez(Path(folder) / "machine.npz", **arrays)
            try:
                said = design_file(
                    str(Path(folder) / "machine.npz"), str(out), rate, delay=delay, doubt=ERROR
                )
            except InputError as error:
                print(f"{number:3d} refused: {error}", flush=True)
                continue
            held = json.loads((out / "controller.json").read_text())
        spent = time.process_time() - start
        use = held["provenance"]["use"]
        reached = {
            row[1]: float(row[2])
            for line in said
            if (row := re.match(r"(.+): on the model \(Hz\) ([\d.]+)", line))
        }
        peaks, radius = worst(arrays, held, 1 / rate, delay, np.random.default_rng(1000 + number))
        against = reached[use] / reached.get(NOTCHED, np.nan)
        print(
            f"{number:3d} {len(arrays['M'])} masses, {rate:6.0f} Hz, {delay} late, {use:16s} {reached[use]:6.1f} Hz, over "
            f"{NOTCHED} {against:5.2f}; S_O {peaks[0]:.2f} dB, r to e {peaks[1]:.2f} dB, poles {radius:.6f}; {spent:.0f} s",
            flush=True,
        )


def sample_machine(rng: np.random.Generator) -> tuple[dict[str, np.ndarray], float, int]:
    """Matrices of a chain pushed at its first mass and seen at any, its rate (Hz) and its delay (samples)."""
    count = int(rng.integers(2, 6))
    masses = rng.uniform(2.0, 30.0, count)
    stiffness = np.zeros((count, count))
    for k in range(count - 1):
        stiffness[k : k + 2, k : k + 2] += 10 ** rng.uniform(6.5, 8) * np.array([[1.0, -1.0], [-1.0, 1.0]])
    squares, vectors = linalg.eigh(stiffness, np.diag(masses))
    damping = 2 * 10 ** rng.uniform(-3, -1.3, count) * np.sqrt(np.clip(squares, 0, None))
    damping[0] = 0.0
    whole = np.diag(masses) @ vectors @ np.diag(damping) @ vectors.T @ np.diag(masses)
    shares = np.eye(count)
    arrays = {
        "M": np.diag(masses),
        "K": stiffness,
        "D": whole,
        "input": shares[0],
        "output": shares[[int(rng.integers(count))]],
    }
    return arrays, float(rng.choice([4e3, 1e4, 2e4])), int(rng.integers(0, 3))


def worst(arrays, held, sample_time: float, delay: int, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """Largest S_O and r to e_true in dB, and the largest closed-loop pole, over corners and draws of the errors."""
    a, b, c, d = (np.array(held["state_space"][key]) for key in "abcd")
    # What it sets is fed back into its third input, and does not pass through at once.
    a, b, d = a + b[:, 2:] @ c, b[:, :2] + b[:, 2:] @ d[:, :2], d[:, :2]
    squares, vectors = linalg.eigh(arrays["K"], arrays["M"])
    frequencies = np.sqrt(np.clip(squares, 0, None))
    ratios = np.diag(vectors.T @ arrays["D"] @ vectors) / np.maximum(2 * frequencies, 1e-300)
    gains = (arrays["output"] @ vectors)[0] * (arrays["input"] @ vectors)
    frequencies[0] = ratios[0] = 0.0  # the rigid body
    peaks, radius = np.zeros(2), 0.0
    for draw in range(DRAWS):
        errors = (
            rng.uniform(-ERROR, ERROR, len(gains)) if draw % 2 else ERROR * rng.choice([-1, 1], len(gains))
        )
        moved = frequencies * (1 + errors)
        plant = _held(moved, ratios, gains, sample_time, delay)
        near = moved[1:, None] * (1 + np.linspace(-0.03, 0.03, 101))
        poles = np.angle(linalg.eigvals(a)) / sample_time
        omega = np.concatenate(
            [np.geomspace(1, 0.99 * np.pi / sample_time, 600), near.ravel(), np.abs(poles)]
        )
        omega = omega[(omega > 1) & (omega < np.pi / sample_time)]
        z = np.exp(1j * omega * sample_time)
        p = _response(*plant, z)[:, 0]
        k = _response(a, b, c, d, z)
        turn = 1 - k[:, 1] * p
        peaks = np.maximum(peaks, [np.abs(1 / turn).max(), np.abs(1 - k[:, 0] * p / turn).max()])
        loop = np.block(
            [
                [plant[0], plant[1] @ c],
                [b[:, 1:] @ plant[2], a],
            ]
        )
        loop[: len(plant[0]), : len(plant[0])] += plant[1] @ d[:, 1:] @ plant[2]
        radius = max(radius, float(np.abs(linalg.eigvals(loop)).max()))
    return 20 * np.log10(peaks), radius


def _held(frequencies, ratios, gains, sample_time: float, delay: int):
    """Sampled modes between a zero-order hold and the sensor, the force `delay` samples late."""
    count = len(gains)
    a = np.zeros((2 * count, 2 * count))
    a[np.arange(0, 2 * count, 2), np.arange(1, 2 * count, 2)] = 1.0
    a[np.arange(1, 2 * count, 2), np.arange(0, 2 * count, 2)] = -(frequencies**2)
    a[np.arange(1, 2 * count, 2), np.arange(1, 2 * count, 2)] = -2 * ratios * frequencies
    b, c = np.zeros((2 * count, 1)), np.zeros((1, 2 * count))
    b[1::2, 0], c[0, ::2] = gains, 1.0
    a, b, c, d, _ = signal.cont2discrete((a, b, c, np.zeros((1, 1))), sample_time)
    for _ in range(delay):
        a = np.block([[a, b], [np.zeros((1, len(a) + 1))]])
        b = np.append(np.zeros(len(b)), 1.0)[:, None]
        c = np.append(c, [[0.0]], axis=1)
    return a, b, c, d


def _response(a, b, c, d, z):
    """c (z - a)^-1 b + d of one output at each z: a row of inputs each."""
    return np.array([(c @ np.linalg.solve(each * np.eye(len(a)) - a, b) + d)[0] for each in z])


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]))
