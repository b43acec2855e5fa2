"""Random isolators through ``isolate``: the compiled C around true ones, somewhere in the box, on five floors.

python benchmarks/isolators.py [FIRST] [LAST] [RESULTS.jsonl]
python benchmarks/isolators.py microseism [FIRST] [LAST] [RESULTS.jsonl]
python benchmarks/isolators.py slow [FIRST] [LAST]
python benchmarks/isolators.py judge [FIRST] [LAST] [RESULTS.jsonl]

The second draws an isolator and a floor with a microseism for each number, and looks for a minute that is louder than
promised; the third drives isolators to where slow motion breaks them; the
fourth lets isolators of 1, 2, 3 and 6 axes, two of three at an end of their box, settle from zero weights on five floors, and then
meet a gust and pushes; no public record beside the slab is shipped. It prints a table of what is to hold.
"""

import json
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
        return (
            file,
            "",
            lambda length: np.tile(whole, -(-round(length * fine) // count))[:, : round(length * fine)],
        )
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


def try_isolator(number: int, name: str, axes: int, rate: float = RATE, minutes: int = 1) -> dict:
    """An isolator on a floor: what was promised, and what the true one does under the compiled C, minute by minute."""
    rng = np.random.default_rng(100 + number)
    nominal = draw_isolator(rng, axes, rate)
    true = moved(nominal, rng, SPREAD)
    own = {"number": number, "floor": name, "axes": len(nominal.mass), "sensors": nominal.floor.shape[1]}
    start = time.process_time()
    with tempfile.TemporaryDirectory() as holder:
        folder = Path(holder)
        (folder / "isolator.toml").write_text(nominal.toml())
        file, unit, motion = make_floor(name, folder, true.floor.shape[1], rng, rate)
        try:
            isolate_file(
                str(folder / "isolator.toml"),
                str(file),
                str(folder / "out"),
                rate,
                unit=unit,
                limit=nominal.limit,
                spread=SPREAD,
            )
        except InputError as error:
            return own | {"refused": str(error)}
        own["seconds"] = time.process_time() - start
        about = json.loads((folder / "out" / "isolator.json").read_text())
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
    return own | {
        "gain": about["skyhook_gain"],
        "cutoff_hz": about["cutoff_hz"],
        "highpasses": about["highpasses"],
        "band_hz": about["band_hz"],
        "time_constant_s": 1 / (about["step"] * rate),
        "inside": int(inside.sum()),
        "off": float(np.max(np.maximum(whole / high, low / whole))),
        "loudest": float(np.max(np.nan_to_num(found, nan=np.inf) / high)),
        "width": float(np.max(high / low)),
        "reduction_db": float(
            -20 * np.log10(np.sqrt(np.mean(whole**2) / np.mean(np.square(about["without"]))))
        ),
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


def judge(number: int, name: str) -> dict:
    """An isolator, nominal or at an end of its box, from zero weights on, then through a gust and pushes.

    Power is compared with that of the optimum: the frozen weights that leave the least in a calm minute after the stated settling.
    """
    rng, rate, ends = np.random.default_rng(300 + number), RATE / 2, number % 12 >= 4
    nominal = draw_isolator(rng, JUDGED_AXES[number % 4], rate)
    true = moved(nominal, Ends(rng), SPREAD) if ends else nominal
    own = {"number": number, "floor": name, "ends": ends, "axes": len(nominal.mass)}
    with tempfile.TemporaryDirectory() as holder:
        folder = Path(holder)
        (folder / "isolator.toml").write_text(nominal.toml())
        file, unit, motion = make_floor(name, folder, true.floor.shape[1], rng, rate)
        files = str(folder / "isolator.toml"), str(file), str(folder / "out")
        try:
            isolate_file(*files, rate, unit=unit, spread=SPREAD)
        except InputError as error:
            return own | {"refused": str(error)}
        about = json.loads((folder / "out" / "isolator.json").read_text())
        settling, second = max(about["settling_s"]), round(FINE * rate)
        calm = int(np.ceil(RISE_S + settling))
        floor = motion(float(calm + 200))
        _shake(floor, np.arange(floor.shape[1]) / second - (calm + 60), second)
        lead = calm - RISE_S
        minute = floor[:, lead * second : (calm + 60) * second]

        def run(part, weights, adapting):
            loop = CompiledLoop(folder / "out", "isolator")
            loop.begin(weights)
            rows, steps, kept = [], [], []
            for k, each in enumerate(np.split(part, part.shape[1] // second, axis=1)):
                platform, now, _ = loop.run(true, each, k, adapting)
                rows.append(np.nan_to_num(platform, nan=1e9))
                steps.append(now)
                kept.append(loop.kept)
            return np.concatenate(rows, axis=1), steps, np.diff(kept, prepend=0) / rate

        moved_by, steps, kept = run(floor, 0 * np.array(about["weights"]), True)
        mean = np.mean(steps[calm : calm + 60], axis=0)
        left, _, _ = run(minute, mean, False)
        best = mean + _to_the_optimum(true, about, left, minute, second)
        still, _, _ = run(floor, best, False)
    band = about["judged_hz"]
    adapting, frozen = (banded_power(rows, second, *band) for rows in (moved_by, still))
    own_mean = banded_power(left, second, *band)[RISE_S:].sum()
    quiet, over = slice(calm, calm + 60), adapting / frozen
    tens = np.array(
        [rows[k : k + 10].sum() for rows in (adapting, frozen) for k in range(calm + 191)]
    ).reshape(2, -1)
    return own | {
        "time_constant_s": about["time_constant_s"],
        "stated_s": settling,
        "settled_s": int(np.argmax((tens[0] < WITHIN * tens[1])[RISE_S:])),
        "excess": float(adapting[quiet].sum() / frozen[quiet].sum() - 1),
        "over_mean": float(adapting[quiet].sum() / own_mean - 1),
        "worst": float(np.sqrt((tens[0] / tens[1])[calm + 60 :].max())),
        "kept": float(kept[quiet].mean()),
        "foretold": about["variance"],
        "ran_away": bool(not np.isfinite(over).all() or over[calm:].max() > RAN_AWAY),
    }


def _shake(floor: np.ndarray, time_s: np.ndarray, second: int) -> None:
    """A gust, the slow motion five times as large for half a minute, and pushes, into a floor from time zero on."""
    slow = signal.sosfilt(signal.butter(3, 0.8, fs=second, output="sos"), floor, axis=1)
    floor += GUST * slow * np.clip(np.minimum(time_s - 10, 40 - time_s) / 3, 0, 1)
    for start, length in PUSHES:
        inside = (time_s > start) & (time_s < start + length)
        floor[:, inside] += PUSH * np.sin(np.pi * (time_s[inside] - start) / length)


def _to_the_optimum(true, about: dict, left: np.ndarray, floor: np.ndarray, second: int) -> np.ndarray:
    """Change of the weights that leaves the least power of `left` in the judged band, by least squares over its lines.

    Filters and loop in continuous time: what is wrong with these moves the weights off the optimum, whose power then hardly
    changes.
    """
    count = left.shape[1] - RISE_S * second
    window = signal.windows.hann(count, sym=False)
    f = np.fft.rfftfreq(count, 1 / second)
    inside = (f >= about["judged_hz"][0]) & (f <= about["judged_hz"][1])
    out, moves = (
        np.fft.rfft(rows[:, RISE_S * second :] * window, axis=1)[:, inside].T for rows in (left, floor)
    )
    s = 2j * np.pi * f[inside]
    low = (2 * np.pi * about["cutoff_hz"] / (s + 2 * np.pi * about["cutoff_hz"])) ** 3
    stack = (1 - low) ** about["highpasses"] * (about["beta"] * (1 - low) / s) ** np.arange(3)[:, None]
    psi = (stack.T[:, :, None] * moves[:, None, :]).reshape(len(s), -1)
    path = true.response(f[inside])
    path = np.linalg.solve(np.eye(len(true.mass)) + path * (about["skyhook_gain"] / s)[:, None, None], path)
    columns = np.einsum("fab,fi->fabi", path, psi).reshape(out.size, -1)
    rows = np.concatenate([columns.real, columns.imag])
    size = np.linalg.norm(rows, axis=0)
    found = np.linalg.lstsq(rows / size, -np.concatenate([out.ravel().real, out.ravel().imag]), rcond=1e-8)[0]
    return (found / size).reshape(path.shape[2], -1)


def summary(found: list[dict]) -> list[str]:
    """A table, floor by floor, of what is to hold: the worst of each, and how many are within."""
    lines = [
        "| floor | runs (refused) | ran away | excess after the stated settling: median, most, within 10 % | worst 10 s over the "
        "optimum's: most, within 2 | weights kept, calm: most, within 5 % | settled, as given (s): median |",
        "|---|---|---|---|---|---|---|",
    ]
    for name in (*JUDGED_FLOORS, ""):
        each = [row for row in found if name in ("", row["floor"])]
        runs = [row for row in each if "refused" not in row]
        if not runs:
            continue
        excess, worst, kept = (np.array([row[key] for row in runs]) for key in ("excess", "worst", "kept"))
        given = [row["settled_s"] for row in runs if not row["ends"]]
        lines.append(
            f"| {name or 'all'} | {len(runs)} ({len(each) - len(runs)}) | {sum(row['ran_away'] for row in runs)} | "
            f"{100 * np.median(excess):.1f} %, {100 * excess.max():.1f} %, {np.sum(excess <= 0.1)} | "
            f"{worst.max():.2f}, {np.sum(worst <= 2)} | {100 * kept.max():.1f} %, {np.sum(kept <= 0.05)} | "
            f"{np.median(given) if given else np.nan:.0f} |"
        )
    return lines


def judge_all(first: str = "0", last: str = "12", results: str = "") -> None:
    """Judge isolators on all floors, few axes first, all but those that the file `results` holds; print one table."""
    kept = Path(results) if results else None
    found = [json.loads(line) for line in kept.read_text().splitlines()] if kept and kept.exists() else []
    done = {(each["number"], each["floor"]) for each in found}
    numbers = sorted(range(int(first), int(last)), key=lambda number: (number % 4, number))
    for number, name in product(numbers, JUDGED_FLOORS):
        if (number, name) in done:
            continue
        found.append(judge(number, name))
        print(json.dumps(found[-1]), flush=True)
        if kept:
            with kept.open("a") as file:
                file.write(json.dumps(found[-1]) + "\n")
    print(*summary(found), sep="\n")


def banded_power(rows: np.ndarray, second: int, low: float, high: float) -> np.ndarray:
    """Power of all rows between two frequencies, second by second, by Butterworth filters of sixth order run both ways.

    A brick wall over the whole run would smear a push over the calm minute before it.
    """
    for kind, corner in (("highpass", low), ("lowpass", high)):
        rows = signal.sosfiltfilt(signal.butter(6, corner, kind, fs=second, output="sos"), rows, axis=1)
    return (rows**2).reshape(len(rows), -1, second).mean(axis=2).sum(axis=0)


def main(first: str = "0", last: str = "10", results: str = "", *, slow: bool = False) -> None:
    """Try isolators, all but those that the file `results` holds already, and print one line each."""
    kept = Path(results) if results else None
    lines = kept.read_text().splitlines() if kept and kept.exists() else []
    known = {(each["number"], each["floor"]): each for each in map(json.loads, lines)}
    numbers = range(int(first), int(last))
    cells = [(number, name) for name in FLOORS for number in numbers]
    if slow:
        cells = [(number, f"microseism {number}") for number in numbers]
    for number, name in cells:
        if (number, name) not in known:
            axes = number % 3 + 1 if slow else AXES[number % len(AXES)]
            known[number, name] = try_isolator(number, name, axes, *((RATE / 2, MINUTES) if slow else ()))
            if kept:
                with kept.open("a") as file:
                    file.write(json.dumps(known[number, name]) + "\n")
        each = known[number, name]
        head = f"{number:3d} {each['axes']} axes, {each['sensors']} sensors, {name:8s}"
        if "refused" in each:
            print(f"{head} refused: {each['refused']}", flush=True)
            continue
        print(
            f"{head} gain {each['gain']:8.3g}, cut-off {each['cutoff_hz']:g} Hz, {each['highpasses']} high-passes, "
            f"{each['band_hz'][0]:.3g} to {each['band_hz'][1]:.3g} Hz, {each['time_constant_s']:5.1f} s: "
            f"{each['inside']} of {each['axes']} inside (at worst {each['off']:.3f} of a limit; band {each['width']:.2f} "
            f"wide), loudest minute {each['loudest']:.3f} of the highest, {each['reduction_db']:.1f} dB, flags {each['flags']}",
            flush=True,
        )
    judged = [each for each in known.values() if "refused" not in each]
    axes, inside = (sum(each[name] for each in judged) for name in ("axes", "inside"))
    print(f"{len(known)} tried, {len(known) - len(judged)} refused; {inside} of {axes} axes inside the band")


if __name__ == "__main__":
    if sys.argv[1:2] == ["slow"]:
        for each in range(*map(int, sys.argv[2:4] or (0, 10))):
            print(each, *slow_motion(each), sep="  ", flush=True)
    elif sys.argv[1:2] == ["judge"]:
        judge_all(*sys.argv[2:5])
    elif sys.argv[1:2] == ["microseism"]:
        main(*sys.argv[2:5], slow=True)
    else:
        main(*sys.argv[1:4])
