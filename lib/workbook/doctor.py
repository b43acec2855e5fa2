"""Compares the running environment with what environment.txt pins."""

import contextlib
import io
import os
import sys

from workbook.environment import drift, pins
from workbook.pinned import pins as processor_pins


def doctor() -> int:
    """Print Python, BLAS, thread settings and every package that drifted; returns 1 when one did."""
    print(f"Python   {sys.version.split()[0]} at {sys.executable}")
    print(f"BLAS     {_blas()}")
    for name, value in processor_pins().items():
        print(f"setting  {name} = {os.environ.get(name, 'unset')} here, {value} in a build")
    wrong = drift()
    for line in wrong:
        print(f"DRIFT    {line}")
    pinned = len(pins())
    print(f"pins     {pinned - len(wrong)} of {pinned} packages as in environment.txt")
    if wrong:
        print("Mend it: remove .venv and run make again, or install with the pip command in the Makefile.")
    return int(bool(wrong))


def _blas() -> str:
    import numpy

    with contextlib.redirect_stdout(io.StringIO()):
        build = numpy.show_config(mode="dicts")["Build Dependencies"]["blas"]
    return f"{build.get('name', '?')} {build.get('version', '?')} (numpy {numpy.__version__})"
