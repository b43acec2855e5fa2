import subprocess
import sys
from importlib import import_module

import pytest

PACKAGES = [
    *(
        f"stillwork.{name}"
        for name in ("signals", "lti", "identification", "estimation", "control", "machine")
    ),
    "workbook",
    *(f"experiments.{name}" for name in ("isolation", "motion", "fixedpoint")),
]


@pytest.mark.parametrize("name", PACKAGES)
def test_every_public_name_resolves(name):
    package = import_module(name)
    assert package.__all__ == dir(package)
    assert all(getattr(package, each) is not None for each in package.__all__)
    with pytest.raises(AttributeError, match=f"'{name}'.*'robot'"):
        package.robot  # noqa: B018


TOY = {
    "__init__": "from stillwork.base.lazy_exports import lazy_exports\n"
    "__all__, __getattr__, __dir__ = lazy_exports(__name__, {'damp': ('damp',), 'tune': ('tune', 'shape')})",
    "damp": "def damp():\n    return 'damped'",
    "shape": "def other():\n    return 'other'",  # a module of the name that another one defines
    "tune": "from toy.damp import damp\nfrom toy.shape import other\n"
    "def tune():\n    return damp()\ndef shape():\n    return other()",
}


@pytest.mark.parametrize(
    "first",
    [
        "import toy.damp, toy.tune, toy.shape",
        "from toy.tune import tune; from toy.damp import damp",
        "from importlib import import_module; import_module('toy.shape'); import_module('toy.damp')",
    ],
)
def test_a_function_may_be_called_as_its_module(tmp_path, first):
    """However the module came to be imported, the package's name is the function."""
    folder = tmp_path / "toy"
    folder.mkdir()
    for name, text in TOY.items():
        (folder / f"{name}.py").write_text(text)
    lines = f"""
import sys
sys.path.insert(0, {str(tmp_path)!r})
{first}
import toy
for _ in range(2):
    from toy import damp, shape, tune
    assert toy.damp() == damp() == tune() == "damped" and toy.shape() == shape() == "other"
from toy.damp import damp as same
from toy.shape import other
assert same is damp and other() == "other" and sys.modules["toy.damp"].damp is damp
assert dir(toy) == toy.__all__ == ["damp", "shape", "tune"]
toy.note = 1
assert toy.note == 1
"""
    done = subprocess.run([sys.executable, "-c", lines], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
