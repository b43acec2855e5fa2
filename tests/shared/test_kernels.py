import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import stillwork

CALLED = """
from stillwork.base.kernels import inlined_kernel

@inlined_kernel
def _twice(x):
    return {factor} * x
"""
CALLER = """
from stillwork.called import _twice
from stillwork.base.kernels import kernel

@kernel
def _use(x):
    return _twice(x) + 1
"""
RUN = """
from stillwork.caller import _use
print(_use(10.0), sum(_use.stats.cache_misses.values()))
"""


def run(root: Path, code: str = RUN) -> list[float]:
    """What the code prints in the checkout at `root`: a kernel's value, and how often it was compiled."""
    # Python takes a file of the same second and size for the same one.
    ours = {"PYTHONPATH": str(root / "lib"), "PYTHONDONTWRITEBYTECODE": "1", "PATH": "", "HOME": str(root)}
    said = subprocess.check_output([sys.executable, "-c", code], env=ours, text=True)
    return [float(word) for word in said.split()]


@pytest.fixture
def checkout(tmp_path) -> Path:
    """A checkout of two kernels, one of which calls the other in another file."""
    package = tmp_path / "checkout" / "lib" / "stillwork"
    (package / "base").mkdir(parents=True)
    (tmp_path / "checkout" / "data").mkdir()
    for name in ("__init__", "checks", "kernels"):
        shutil.copy(Path(stillwork.__file__).parent / "base" / f"{name}.py", package / "base")
    shutil.copy(Path(stillwork.__file__), package)
    (package / "caller.py").write_text(CALLER)
    (package / "called.py").write_text(CALLED.format(factor=2))
    return tmp_path / "checkout"


@pytest.mark.slow
def test_a_change_of_a_called_kernel_in_another_file_is_seen(checkout):
    for factor, value in ((2, 21), (3, 31)):
        (checkout / "lib" / "stillwork" / "called.py").write_text(CALLED.format(factor=factor))
        assert run(checkout)[0] == value
    assert run(checkout) == [31, 0]
    assert len(list((checkout / "build" / "kernels").iterdir())) == 2


@pytest.mark.slow
def test_a_function_typed_or_of_a_file_of_ones_own_is_compiled_in_every_process(checkout, tmp_path):
    """Nothing is named by what it calls: kept machine code could be of an older one."""
    code = "import sys; sys.path.insert(0, {!r})\nfrom mine import use\nprint(use(1.0), sum(use.stats.cache_hits.values()))"
    (tmp_path / "mine.py").write_text(
        "from stillwork.base.kernels import kernel\n\n@kernel\ndef use(x):\n    return x + 1\n"
    )
    assert run(checkout, code.format(str(tmp_path))) == [2, 0]
    assert not list(tmp_path.rglob("*.nbc"))
