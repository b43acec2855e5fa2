"""What the benchmarks share: contenders in turn, the machine, C by hand, and the tables that notebooks and site read."""

import ctypes
import platform
import shutil
import subprocess
import tempfile
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]


def in_turn(contenders: dict, repeats: int, samples: int = 1) -> dict[str, list[float]]:
    """Seconds of processor time of the thread a sample, of each contender in turn, after one warm-up.

    A contender that prepares something returns its own seconds and samples.
    """
    times = {name: [] for name in contenders}
    for repeat in range(repeats + 1):
        for name, run in contenders.items():
            start = time.thread_time()
            own = run()
            spent, count = own if isinstance(own, tuple) else (time.thread_time() - start, samples)
            if repeat:
                times[name].append(spent / count)
    return times


def ratio(times: dict[str, list[float]]) -> float:
    """Median of the second contender's times over the first one's, pair by pair."""
    ours, theirs = times.values()
    return float(np.median(np.array(theirs) / np.array(ours)))


def judged(value: float, target: str) -> str:
    """Whether a target such as ``<= 1.5`` is met."""
    if not target:
        return ""
    relation, bound = target.split()
    return "met" if (value >= float(bound) if relation == ">=" else value <= float(bound)) else "MISSED"


def machine(*packages: str) -> str:
    """Processor, system and versions."""
    name, info = platform.processor() or platform.machine(), Path("/proc/cpuinfo")
    if info.exists():
        models = [line for line in info.read_text().splitlines() if "model name" in line]
        name = models[0].partition(":")[2].strip() if models else name
    versions = ", ".join(f"{package} {version(package)}" for package in ("numpy", *packages))
    return f"{name}, {platform.system()}, Python {platform.python_version()}, {versions}"


def compiled(files: dict[str, str], *options: str) -> ctypes.CDLL | None:
    """A library of C files (text by name); None, and a line, where there is no compiler."""
    if not shutil.which("gcc"):
        print("no gcc: the comparison with C is left out")
        return None
    with tempfile.TemporaryDirectory(prefix="stillwork-bench-") as folder:
        for name, text in files.items():
            Path(folder, name).write_text(text)
        sources = [name for name in files if name.endswith(".c")]
        command = ["gcc", *options, "-shared", "-fPIC", *sources, "-o", "all.so", "-lm"]
        subprocess.run(command, cwd=folder, check=True)
        return ctypes.CDLL(str(Path(folder, "all.so")))


def write_times(
    file: str, first: str, unit: str, scale: float, times: dict[str, list[float]], about: str
) -> None:
    """A table of medians, lowest and highest below ``data/``, and beside it, under a heading of its name, what it is."""
    path = ROOT / "data" / file
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [f"{first},median_{unit},lowest_{unit},highest_{unit}"]
    for name, each in times.items():
        shown = ",".join(f"{scale * value:.4g}" for value in (np.median(each), min(each), max(each)))
        lines.append(f'"{name}",{shown}')
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    source, heading = path.parent / "SOURCE.md", f"## {path.name}\n"
    kept = source.read_text(encoding="utf-8").partition(heading)[0] if source.exists() else ""
    source.write_text(f"{kept}{heading}\n{about}\n", encoding="utf-8")
