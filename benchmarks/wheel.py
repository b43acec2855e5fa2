"""The toolbox in an empty environment of some Python: size, imports, examples, `stillwork inspect` and `design`.

``python3.13 benchmarks/wheel.py stillwork-0.1.0-py3-none-any.whl`` needs nothing but that Python and the network; what
stands behind the file are extras, ``data control design``. `python -m hatchling build -t wheel -d FOLDER` makes the wheel.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

FOLDERS = ("base", "signals", "lti", "identification", "estimation", "control")
DATA = Path(__file__).parents[1] / "data"
RECORD = DATA / "worstcase" / "your_record"
MACHINE = DATA / "motion" / "your_machine" / "matrices.csv"

EXAMPLES = """
import doctest, inspect, json
from importlib import import_module
import numpy as np
folders = {name: import_module("stillwork." + name) for name in %s}
lacking, failed = [], {}
for folder, package in folders.items():
    for name in getattr(package, "__all__", ()):
        finder = doctest.DocTestFinder(recurse=False)
        try:
            thing = inspect.unwrap(getattr(package, name))
        except ImportError:
            lacking.append(name)
            continue
        said = []
        for example in finder.find(thing, name, globs={"np": np, **folders}):
            doctest.DocTestRunner(verbose=False).run(example, out=said.append)
        text = "".join(said)
        if "pip install 'stillwork[" in text or "No module named 'control'" in text:
            lacking.append(name)
        elif text:
            failed[name] = text
print(json.dumps([sum(len(getattr(each, "__all__", ())) for each in folders.values()), lacking, failed]))
"""
IMPORT = """
import sys, time
before = time.perf_counter()
import stillwork.%s
print(time.perf_counter() - before)
"""


def megabytes(folder: Path) -> tuple[float, float]:
    """What lies in a folder, without pip and what comes with an environment: as the wheels hold it, and compiled."""
    kept, compiled = 0, 0
    for file in folder.rglob("*"):
        if file.is_file() and not file.relative_to(folder).parts[0].startswith(
            ("pip", "setuptools", "pkg_res")
        ):
            size = file.stat().st_size
            kept, compiled = (kept, compiled + size) if file.suffix == ".pyc" else (kept + size, compiled)
    return kept / 1e6, compiled / 1e6


def main() -> int:
    """Try one wheel; 1 where something of it does not work."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("wheel", type=Path)
    parser.add_argument("extras", nargs="*", help="data, control, design")
    given = parser.parse_args()
    wanted = str(given.wheel.resolve()) + (f"[{','.join(given.extras)}]" if given.extras else "")
    with tempfile.TemporaryDirectory() as folder:
        venv.create(folder, with_pip=True)
        programs = Path(folder, "Scripts" if os.name == "nt" else "bin")

        def run(*arguments) -> str:
            environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "STILLWORK"))}
            done = subprocess.run(arguments, cwd=folder, env=environment, capture_output=True, text=True)
            if done.returncode:
                raise SystemExit(done.stdout + done.stderr)
            return done.stdout

        python = programs / "python"
        run(python, "-m", "pip", "install", "--quiet", wanted)
        (site,) = Path(folder).rglob("site-packages")
        plain, compiled = megabytes(site)
        print(f"Python {sys.version.split()[0]}: {plain:.0f} MB, and {compiled:.0f} MB of bytecode by pip")
        times = {name: min(float(run(python, "-c", IMPORT % name)) for _ in range(5)) for name in FOLDERS}
        print("import, s: " + ", ".join(f"{name} {time:.3f}" for name, time in times.items()))
        count, lacking, failed = json.loads(run(python, "-c", EXAMPLES % (FOLDERS,)))
        print(f"{count} examples, {len(lacking)} need an extra ({', '.join(lacking)}), {len(failed)} fail")
        print("".join(failed.values()), end="")
        record = next(RECORD.glob("*.csv"))
        if "data" in given.extras:
            print(run(programs / "stillwork", "inspect", str(record)).splitlines()[0])
        if "design" in given.extras:
            out = Path(folder, "controller")
            run(programs / "stillwork", "design", MACHINE, "--rate", "10000", "--out", out)
            print("design: " + ", ".join(sorted(each.name for each in out.iterdir())))
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main())
