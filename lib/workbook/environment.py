"""What `environment.txt` pins for this Python, and how the installed packages differ from it.

`environment-tests.txt` pins the same and what tests and benchmarks need besides.
"""

import contextlib
import io
import os
import sys
from importlib import metadata
from pathlib import Path

from workbook import paths
from workbook.pinned import pins as processor_pins


def pins(name: str = "environment.txt") -> dict[str, str]:
    """Package to exact version, for the Python and the platform that run this."""
    from packaging.requirements import Requirement

    wanted = {}
    for line in (paths.root() / name).read_text(encoding="utf-8").splitlines():
        if line and not line.startswith((" ", "#", "-")):
            requirement = Requirement(line.rstrip(" \\"))
            if requirement.marker is None or requirement.marker.evaluate():
                wanted[requirement.name] = next(iter(requirement.specifier)).version
    return wanted


def drift(pinned: str = "environment.txt") -> list[str]:
    """One line for each package that is missing or of another version than pinned."""
    lines = []
    for name, version in pins(pinned).items():
        try:
            found = metadata.version(name)
        except metadata.PackageNotFoundError:
            lines.append(f"{name} is missing (pinned {version})")
            continue
        if found != version:
            lines.append(f"{name} is {found} (pinned {version})")
    return lines


def doctor() -> int:
    """Print Python, BLAS, thread settings and every package that drifted; returns 1 when one did."""
    print(f"Python   {sys.version.split()[0]} at {sys.executable}")
    print(f"BLAS     {_blas()}")
    for name, value in processor_pins().items():
        print(f"setting  {name} = {os.environ.get(name, 'unset')} here, {value} in a build")
    tested = (Path(sys.prefix) / "tests").exists() and (paths.root() / "environment-tests.txt").exists()
    name = "environment-tests.txt" if tested else "environment.txt"
    count, wrong = len(pins(name)), drift(name)
    for line in wrong:
        print(f"DRIFT    {line}")
    print(f"pins     {count - len(wrong)} of {count} packages as in {name}")
    if wrong:
        print(
            "To repair it: remove .venv and run make again, or install with the pip command in the Makefile."
        )
    return int(bool(wrong))


def _blas() -> str:
    import numpy

    with contextlib.redirect_stdout(io.StringIO()):
        build = numpy.show_config(mode="dicts")["Build Dependencies"]["blas"]
    return f"{build.get('name', '?')} {build.get('version', '?')} (numpy {numpy.__version__})"
