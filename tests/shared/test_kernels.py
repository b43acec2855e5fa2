import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import stillwork

CALLED = """
from stillwork.kernels import inlined_kernel

@inlined_kernel
def _twice(x):
    return {factor} * x
"""
CALLER = """
from stillwork.called import _twice
from stillwork.kernels import kernel

@kernel
def _use(x):
    return _twice(x) + 1
"""
RUN = "from stillwork.caller import _use; print(_use(10.0), sum(_use.stats.cache_misses.values()))"


def run(root: Path) -> list[float]:
    environment = {"PYTHONPATH": str(root / "lib"), "STILLWORK_ROOT": str(root), "PATH": ""}
    done = subprocess.run(
        [sys.executable, "-c", RUN], env=environment, capture_output=True, text=True, check=True
    )
    return [float(word) for word in done.stdout.split()]


@pytest.mark.slow
def test_a_kernel_notices_a_change_of_one_that_it_calls(tmp_path):
    package = tmp_path / "lib" / "stillwork"
    package.mkdir(parents=True)
    (tmp_path / "data").mkdir()
    for name in ("__init__.py", "checks.py", "kernels.py", "paths.py"):
        shutil.copy(Path(stillwork.__file__).parent / name, package)
    (package / "caller.py").write_text(CALLER)
    (package / "called.py").write_text(CALLED.format(factor=2))
    assert run(tmp_path) == [21, 1]
    assert run(tmp_path) == [21, 0]
    (package / "called.py").write_text(CALLED.format(factor=3))
    assert run(tmp_path) == [31, 1]
