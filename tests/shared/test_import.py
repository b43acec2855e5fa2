import subprocess
import sys

import pytest

TOOLBOX = ("base", "signals", "lti", "identification", "estimation", "control", "machine")
HEAVY = ("numba", "matplotlib", "pandas", "control", "scipy", "clarabel", "numpy", "papermill")


@pytest.mark.parametrize(
    ("module", "allowed"),
    [
        (", ".join(["stillwork", *(f"stillwork.{name}" for name in TOOLBOX)]), ()),
        ("workbook.page, workbook.explorer, workbook.build, workbook.choices.command", ("numpy",)),
    ],
)
def test_an_import_loads_no_more_than_it_needs(module, allowed):
    script = f"import sys, {module}\nprint([name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(list(allowed))
