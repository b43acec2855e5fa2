"""Random isolators through ``isolate``: the compiled C around true ones, somewhere in the box, on five floors.

python benchmarks/isolators.py [FIRST] [LAST] [RESULTS.jsonl]
python benchmarks/isolators.py microseism [FIRST] [LAST] [RESULTS.jsonl]
python benchmarks/isolators.py slow [FIRST] [LAST]
python benchmarks/isolators.py judge [FIRST] [LAST] [RESULTS.jsonl] [CHECKOUT]

The second draws an isolator and a floor with a microseism for each number, and looks for a minute louder than promised; the third
drives isolators to where slow motion breaks them; the fourth lets isolators of 1, 2, 3 and 6 axes, two of three at an end of their
box, settle from zero weights on five floors, and then meet a gust and pushes: it prints a table of what is to hold, and of another
commit's command beside it where its checkout is given, too. No public record beside the slab is shipped.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from itertools import product
from pathlib import Path

import numpy as np
from scipy import signal

from stillwork.base.checks import InputError
from stillwork.machine.c_code import isolation_code
from stillwork.machine.isolate import isolate_file
from stillwork.machine.isolation import Isolator
from stillwork.machine.isolation_design import binned, design_isolation, paths_through, try_loop
from workbook import paths

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from naive.isolators import (
    FINE,
    CompiledLoop,
    Ends,
    band_rms,
    coloured,
    draw_isolator,
    footfalls,
    microseism,
    moved,
)

AXES = (1, 2, 3, 4, 5, 6, 1, 2, 3, 6)  # of the ten
RATE = 2000.0
SPREAD = 0.05
JUDGED_S = 60.0
FLOORS = ("flat", "slab", "drift", "ground", "coloured")
JUDGED_AXES, JUDGED_FLOORS = (1, 2, 3, 6), ("flat", "microseism and mains", "footfalls", "ground", "slab")
GUST, PUSH = 4.0, 0.05  # of the slow motion, added to it; m/s^2
PUSHES = ((80.0, 0.3), (100.0, 1.0), (110.0, 0.6))  # s: start and length
WITHIN, RAN_AWAY = 1.1, 1e4  # of the power with frozen weights, as settled and as run away
RISE_S = 20  # s, in which filters settle and the feedforward rises
MINUTES = 5  # judged on a microseism, each for itself
GRID = np.geomspace(0.005, 950, 6000)  # Hz


def density(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies and acceleration density of a floor known by its spectrum."""
    if name == "microseism and mains":
        lines = sum(3e-5 * np.exp(-0.5 * ((GRID - at) / 0.3) ** 2) for at in (50, 100))
        return GRID, density("ratio 1e3")[1] + lines
    if name.startswith("microseism"):
        return GRID, microseism(np.random.default_rng(int(name.split()[1])), GRID)
    flat = 2e-6 / (1 + (3 / GRID) ** 4) / (1 + (GRID / 80) ** 4)
    if name.startswith("ratio"):  # a microseism of so many times the density in the band
        return GRID, flat + 2e-6 * float(name.split()[1]) * np.exp(-0.5 * (np.log(GRID / 0.18) / 0.2) ** 2)
    if name == "ground":
        file = paths.data("isolation", "ligo_llo_ground/ground_velocity_density.npz")
        with np.load(file, allow_pickle=False) as ground:
            f, velocity = ground["frequencies_hz"], ground["velocity_density_Z"].astype(float).mean(axis=0)
        kept = f > 0
        return f[kept], 1e4 * velocity[kept] * (2 * np.pi * f[kept]) ** 2
    if name == "coloured":
        flat = 0.1 * flat + 4e-6 * ((GRID > 15) & (GRID < 25)) + 1e-6 * ((GRID > 45) & (GRID < 60))
    if name == "drift":  # slow motion, six times as much acceleration per root Hz as in the band
        flat = flat + 36 * 2e-6 / (1 + (GRID / 0.5) ** 6)
    return GRID, flat


def make_floor(name: str, folder: Path, sensors: int, rng: np.random.Generator, rate: float):
    """File for the command, its unit, and a function that gives seconds of the motion at the plant's steps."""
    fine = FINE * rate
    if name == "slab":
        file = paths.data("isolation", "slab_footfall/slab_vertical.csv")
        seconds, record = np.loadtxt(file, delimiter=",", skiprows=1, unpack=True)
        rows = signal.detrend(record) * signal.windows.tukey(len(record), 0.05)
        count = round(seconds[-1] * fine)
        row = signal.resample(rows, count)  # periodic: it may be run round and round
        shifts = np.arange(sensors) * count // max(sensors, 1)
        whole = np.array([np.roll(row, shift) for shift in shifts])
        return file, "", lambda length: np.resize(whole.T, (round(length * fine), sensors)).T
    if name == "footfalls":  # a record, and other minutes of the same walker
        file, state = folder / "floor.csv", int(rng.integers(2**31))
        record = footfalls(state, rng, 120.0, rate, sensors)
        names = ",".join(["time (s)", *(f"floor {k} (m/s^2)" for k in range(sensors))])
        table = np.column_stack([np.arange(record.shape[1]) / rate, record.T])
        np.savetxt(file, table, delimiter=",", header=names, comments="", fmt="%.9g")
        return file, "", lambda length: footfalls(state, rng, length, fine, sensors)
    hertz, level = density(name)
    file = folder / "floor.npz"
    np.savez(file, **{"frequency (Hz)": hertz, "floor ((m/s^2)^2/Hz)": level})
    return file, "", lambda length: coloured(rng, hertz, level, round(length * fine), fine, sensors)


def isolate(nominal, name: str, folder: Path, rng: np.random.Generator, **more):
    """What the command writes for an isolator, its files, and seconds of the floor's motion."""
    (folder / "isolator.toml").write_text(nominal.toml())
    file, unit, motion = make_floor(name, folder, nominal.floor.shape[1], rng, nominal.rate)
    files = str(folder / "isolator.toml"), str(file)
    isolate_file(*files, str(folder / "out"), nominal.rate, unit=unit, spread=SPREAD, **more)
    return json.loads((folder / "out" / "isolator.json").read_text()), files, motion


def try_isolator(number: int, name: str, axes: int, rate: float = RATE, minutes: int = 1) -> dict:
    """An isolator on a floor: what was promised, and what the true one does under the compiled C, minute by minute."""
    rng = np.random.default_rng(100 + number)
    nominal = draw_isolator(rng, axes, rate)
    true = moved(nominal, rng, SPREAD)
    own = {"number": number, "floor": name, "axes": len(nominal.mass), "sensors": nominal.floor.shape[1]}
    start = time.process_time()
    with tempfile.TemporaryDirectory() as holder:
        folder = Path(holder)
        try:
            about, _, motion = isolate(nominal, name, folder, rng, limit=nominal.limit)
        except InputError as error:
            return own | {"refused": str(error)}
        own["seconds"] = time.process_time() - start
        loop = CompiledLoop(folder / "out", "isolator")
        settle = 10 + 1.5 * max(about["settling_s"])
        floor = motion(settle + JUDGED_S * minutes)
        first = round(settle * rate)
        _, _, flags = loop.run(true, floor[:, : first * FINE], 1)
        found: list[np.ndarray] = []
        for part in np.array_split(floor[:, first * FINE :], minutes, axis=1):
            platform, _, raised = loop.run(true, part, 2 + len(found))
            flags |= raised & ~4  # weights wait at the start
            found.append(band_rms(platform, rate * FINE, *about["judged_hz"]))
    low, _, high = np.array(about["remains"])
    whole = np.sqrt(np.mean(np.square(found), axis=0))
    inside = (whole >= low) & (whole <= high)
    stated = "skyhook_gain", "cutoff_hz", "highpasses", "band_hz", "time_constant_s"
    return own | {
        **{each: about[each] for each in stated},
        "inside": int(inside.sum()),
        "off": float(np.max(np.maximum(whole / high, low / whole))),
        "loudest": float(np.max(np.nan_to_num(found, nan=np.inf) / high)),
        "width": float(np.max(high / low)),
        "reduction_db": float(-10 * np.log10(np.mean(whole**2) / np.mean(np.square(about["without"])))),
        "flags": flags & ~4,
    }


def slow_motion(number: int) -> list[str]:
    """Worst ten seconds over those with frozen weights, rms, as an isolator of the box is driven to where slow motion breaks it.

    The numbers before them are those of the certificate, whose limit is 1.
    """
    rng = np.random.default_rng(number)
    nominal = draw_isolator(rng, int(rng.integers(1, 4)), RATE)
    true = moved(nominal, rng, SPREAD)
    own = Isolator(
        nominal.mass, nominal.damping, nominal.stiffness, nominal.floor, nominal.pole, nominal.late / RATE,
        nominal.floor_noise, nominal.platform_noise,
    )  # fmt: skip
    level = 2e-6 / (1 + (3 / GRID) ** 4) / (1 + (GRID / 80) ** 4)
    level = level + 2e-6 * 10 ** rng.uniform(2, 5) * np.exp(-0.5 * (np.log(GRID / 0.18) / 0.2) ** 2)
    lines = np.arange(0.02, 900, 0.02)
    floor = binned(lines, np.interp(lines, GRID, level)[:, None, None] * np.eye(own.sensors), 60.0, "slow")
    design, _ = design_isolation(own, floor, RATE, spread=SPREAD)
    paths = paths_through(own, RATE)
    seconds, lead = 10, round(1.3 * design.loop.settling * RATE) + 2000
    motion = coloured(rng, GRID, level, (lead + 6 * seconds * round(RATE)) * FINE, FINE * RATE, own.sensors)
    found, still = [], None
    for gain in (0.0, 1.0, 2.0, 4.0, 8.0, 16.0):
        slower = np.geomspace(0.02, 1e3, 2000)
        size = design.certificate.slow / design.mismatch.loop_gain(1.0, design.time_constant)
        reached = [each for each in slower if design.mismatch.loop_gain(size, each) <= (gain or 1.0)]
        step = 1 / (reached[0] * RATE)
        each = try_loop(design.loop, own, paths, floor, "FeRls", 1.0, design.mismatch, step)
        files = isolation_code(
            each.loop, each.settings, each.steady.weights, 0 * each.guard, 1.0, 1e12, 0.1, "iso"
        )
        with tempfile.TemporaryDirectory() as holder:
            for name, text in files.items():
                (Path(holder) / name).write_text(text)
            out, _, _ = CompiledLoop(Path(holder), "iso").run(true, motion, number, gain > 0)
        parts = np.array_split(np.nan_to_num(out[:, lead * FINE :], nan=1e12), 6, axis=1)
        band = 1.0, design.loop.shaping.lowpass_hz
        rms = np.array([np.linalg.norm(band_rms(part, RATE * FINE, *band)) for part in parts])
        still = rms if still is None else still
        if gain:
            found.append(f"{gain:g}: {np.max(rms / still):.2g}")
    return found


def judge(number: int, name: str, seed: int = 0, older: str = "") -> dict:
    """An isolator, nominal or at an end of its box, from zero weights on, then through a gust and pushes.

    Isolators of one `number` are alike; their place in the box and the floor differ by `seed`. `older` is a checkout of another
    commit, whose command then runs beside it on the same floor.
    """
    bits, rate, ends = np.random.PCG64(300 + number), RATE / 2, number % 12 >= 4
    nominal = draw_isolator(np.random.Generator(bits), JUDGED_AXES[number % 4], rate)
    rng = np.random.Generator(bits.jumped(seed))
    true = moved(nominal, Ends(rng), SPREAD) if ends else nominal
    own = {"number": number, "floor": name, "seed": seed, "ends": ends, "axes": len(nominal.mass)}
    with tempfile.TemporaryDirectory() as holder:
        folder = Path(holder)
        try:
            about, files, motion = isolate(nominal, name, folder, rng)
        except InputError as error:
            return own | {"refused": str(error)}
        stated, second = max(about["settling_s"]), round(FINE * rate)
        calm = int(np.ceil(RISE_S + stated))
        floor = motion(float(calm + 200))
        _shake(floor, np.arange(floor.shape[1]) / second - (calm + 60), second)
        own |= {
            "time_constant_s": about["time_constant_s"],
            "foretold": [about["variance"], *about["excess"]],
        }
        own |= {"stated_s": stated} | _judged(folder / "out", true, floor, calm, about["judged_hz"])
        if older:
            command = f"-m stillwork isolate --rate {rate} --spread {SPREAD} --out {folder / 'older'}".split()
            place = os.environ | {"PYTHONPATH": f"{older}/lib"}
            subprocess.run([sys.executable, *command, *files], env=place, check=True, capture_output=True)
            own["older"] = _judged(folder / "older", true, floor, calm, about["judged_hz"])
    return own


def _judged(folder: Path, true, floor: np.ndarray, calm: int, band: list[float]) -> dict:
    """What the C of a folder leaves from zero weights on: power over that of the frozen weights best for the minute after `calm` s."""
    about, second = json.loads((folder / "isolator.json").read_text()), round(FINE * true.rate)
    quiet = slice(calm, calm + 60)

    def run(part, weights, adapting):
        loop = CompiledLoop(folder, "isolator")
        loop.begin(weights)
        rows, steps, kept = [], [], []
        for k, each in enumerate(np.split(part, part.shape[1] // second, axis=1)):
            platform, now, _ = loop.run(true, each, k, adapting)
            rows.append(np.nan_to_num(platform, nan=1e9))
            steps.append(now)
            kept.append(loop.kept)
        return np.concatenate(rows, axis=1), steps, np.diff(kept, prepend=0) / true.rate

    moved_by, steps, kept = run(floor, 0 * np.array(about["weights"]), True)
    minute = floor[:, (calm - RISE_S) * second : (calm + 65) * second]  # five for the filters' ends
    mean = np.mean(steps[quiet], axis=0)
    tried, powers = [mean if np.abs(mean).max() < 1e9 else np.array(about["weights"])], []
    for _ in range(
        3
    ):  # from the mean on; where a walker excites few directions, the last is not always the least
        left, _, _ = run(minute, tried[-1], False)
        powers.append(banded_power(left, second, *band)[RISE_S:][:60].sum())
        tried.append(tried[-1] + _to_the_optimum(true, about, band, left, minute, second))
    best = tried[int(np.argmin(powers))]
    through = moved_by, run(floor, best, False)[0]
    adapting, frozen = (banded_power(rows, second, *band) for rows in through)
    tens = np.array([rows[k : k + 10].sum() for rows in (adapting, frozen) for k in range(calm + 191)])
    over = np.divide(*tens.reshape(2, -1))
    # What runs away later would leak back through the filters.
    early = [banded_power(rows[:, : (calm + 65) * second], second, *band)[quiet] for rows in through]
    parts = np.reshape(early, (2, 6, 10)).sum(axis=2)
    without = parts.sum(axis=1, keepdims=True) - parts  # a sixth left out at a time
    return {
        "settled_s": int(np.argmax(np.append(over[RISE_S:] < WITHIN, True))),
        "excess": float(parts[0].sum() / parts[1].sum() - 1),
        "error": float(np.sqrt(5) * np.std(without[0] / without[1])),
        "over_mean": float(parts[0].sum() / powers[0] - 1),
        "worst": float(np.sqrt(over[calm + 60 :].max())),
        "kept": float(kept[quiet].mean()),
        "left": float(np.sqrt(parts[0].sum() / 60)),
        "ran_away": bool((adapting / frozen)[calm:].max() > RAN_AWAY),
    }


def _shake(floor: np.ndarray, time_s: np.ndarray, second: int) -> None:
    """A gust, the slow motion five times as large for half a minute, and pushes, into a floor from time zero on."""
    slow = signal.sosfilt(signal.butter(3, 0.8, fs=second, output="sos"), floor, axis=1)
    floor += GUST * slow * np.clip(np.minimum(time_s - 10, 40 - time_s) / 3, 0, 1)
    for start, length in PUSHES:
        inside = (time_s > start) & (time_s < start + length)
        floor[:, inside] += PUSH * np.sin(np.pi * (time_s[inside] - start) / length)


def _to_the_optimum(true, about: dict, band, left: np.ndarray, floor: np.ndarray, second: int) -> np.ndarray:
    """Change of the weights that leaves the least power of `left` in the judged minute and band, by least squares.

    Filters and loop in continuous time: what is wrong with these moves the weights off the optimum, whose power then hardly
    changes.
    """
    f = np.maximum(
        np.fft.rfftfreq(left.shape[1], 1 / second)[: round(2 * band[1] * left.shape[1] / second)], 1e-3
    )
    judged = 1 / (1 + (band[0] / f) ** 12) / (1 + (f / band[1]) ** 12)

    def over_time(lines):
        rows = np.fft.irfft(judged * lines, axis=-1)
        first, length = (round(part * rows.shape[-1] * second / left.shape[1]) for part in (RISE_S, 60))
        return rows[..., first : first + length].reshape(*rows.shape[:-2], -1)

    s = 2j * np.pi * f
    low = (2 * np.pi * about["cutoff_hz"] / (s + 2 * np.pi * about["cutoff_hz"])) ** 3
    stack = (1 - low) ** about["highpasses"] * (about["beta"] * (1 - low) / s) ** np.arange(3)[:, None]
    out, moves = (np.fft.rfft(rows, axis=1)[:, : len(f)] for rows in (left, floor))
    psi = (stack[:, None] * moves).reshape(-1, len(f))
    path = true.response(f)
    path = np.linalg.solve(np.eye(len(true.mass)) + path * (about["skyhook_gain"] / s)[:, None, None], path)
    columns = np.array([over_time(path[:, :, axis].T * row) for axis in range(len(left)) for row in psi])
    size = np.linalg.norm(columns, axis=1)
    found = np.linalg.lstsq((columns / size[:, None]).T, -over_time(out), rcond=1e-8)[0]
    return (found / size).reshape(len(left), -1)


def summary(found: list[dict]) -> list[str]:
    """A table, floor by floor, of what is to hold: most, and how many are within; once more of the older commit's runs."""
    lines = [
        "| floor | runs (refused) | ran away | power over the best frozen weights' after the stated settling: median, most, within 10 % "
        "| over their own mean's: most, within 10 % | worst 10 s: most, within 2 | kept, calm: most, within 5 % | settled (s): median |",
        "|---|---|---|---|---|---|---|---|",
    ]
    beside = [row | row["older"] | {"floor": f"{row['floor']}, older"} for row in found if "older" in row]
    for name in dict.fromkeys(row["floor"] for row in (*found, *beside)):
        for words, ends in ((f"{name}, as given", False), (f"{name}, ends", True)):
            each = [row for row in (*found, *beside) if (row["floor"], row["ends"]) == (name, ends)]
            runs = [row for row in each if "refused" not in row]
            if not runs:
                continue
            keys = "excess", "over_mean", "worst", "kept", "settled_s"
            excess, moving, worst, kept, settled = (np.array([row[key] for row in runs]) for key in keys)
            lines.append(
                f"| {words} | {len(runs)} ({len(each) - len(runs)}) | {sum(row['ran_away'] for row in runs)} | "
                f"{100 * np.median(excess):.1f} %, {100 * excess.max():.3g} %, {np.sum(excess <= 0.1)} | "
                f"{100 * moving.max():.3g} %, {np.sum(moving <= 0.1)} | {worst.max():.3g}, {np.sum(worst <= 2)} | "
                f"{100 * kept.max():.1f} %, {np.sum(kept <= 0.05)} | {np.median(settled):.0f} |"
            )
    return lines


def resumed(results: str, cells: list, work) -> list[dict]:
    """Rows of all cells, (number, floor, ...): those that the file `results` holds, and new ones, which are added to it."""
    kept = Path(results) if results else None
    found = [json.loads(line) for line in kept.read_text().splitlines()] if kept and kept.exists() else []
    done = {(each["number"], each["floor"]) for each in found}
    for cell in cells:
        if cell[:2] not in done:
            found.append(work(*cell))
            print(json.dumps(found[-1]), flush=True)
            if kept:
                with kept.open("a") as file:
                    file.write(json.dumps(found[-1]) + "\n")
    return found


def judge_all(first: str = "0", last: str = "12", results: str = "", older: str = "") -> None:
    """Judge isolators on all floors, of three seeds each as a Latin square has it, few axes first; print one table."""
    numbers = sorted(range(int(first), int(last)), key=lambda number: (number % 4, number))
    cells = product(numbers, enumerate(JUDGED_FLOORS))
    rows = [(number, name, (number + place) % 3, older) for number, (place, name) in cells]
    print(*summary(resumed(results, rows, judge)), sep="\n")


def banded_power(rows: np.ndarray, second: int, low: float, high: float) -> np.ndarray:
    """Power of all rows between two frequencies, second by second, by Butterworth filters of sixth order run both ways.

    A brick wall over the whole run would smear a push over the calm minute before it.
    """
    for kind, corner in (("highpass", low), ("lowpass", high)):
        rows = signal.sosfiltfilt(signal.butter(6, corner, kind, fs=second, output="sos"), rows, axis=1)
    return (rows**2).reshape(len(rows), -1, second).mean(axis=2).sum(axis=0)


def main(first: str = "0", last: str = "10", results: str = "", *, slow: bool = False) -> None:
    """Try isolators, all but those that the file `results` holds already, and print one line each."""
    numbers = range(int(first), int(last))
    cells = [(number, name, AXES[number % len(AXES)]) for name in FLOORS for number in numbers]
    if slow:
        cells = [(number, f"microseism {number}", number % 3 + 1, RATE / 2, MINUTES) for number in numbers]
    found = resumed(results, cells, try_isolator)
    judged = [each for each in found if "refused" not in each]
    axes, inside = (sum(each[name] for each in judged) for name in ("axes", "inside"))
    print(f"{len(found)} tried, {len(found) - len(judged)} refused; {inside} of {axes} axes inside the band")


if __name__ == "__main__":
    if sys.argv[1:2] == ["slow"]:
        for each in range(*map(int, sys.argv[2:4] or (0, 10))):
            print(each, *slow_motion(each), sep="  ", flush=True)
    elif sys.argv[1:2] == ["judge"]:
        judge_all(*sys.argv[2:6])
    elif sys.argv[1:2] == ["microseism"]:
        main(*sys.argv[2:5], slow=True)
    else:
        main(*sys.argv[1:4])
