import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from stillwork.base import extras
from stillwork.base.extras import missing

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
        "",
        "import toy.damp, toy.tune, toy.shape",
        "from toy import damp, shape",
        "from toy.tune import tune; from toy.damp import damp",
        "from importlib import import_module; import_module('toy.shape'); import_module('toy.damp')",
        "import pickle, toy; assert pickle.loads(pickle.dumps(toy.damp)) is toy.damp",
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


def test_what_no_extra_brings_is_missing_under_its_own_name():
    for name in ("stillwork.none", "workbook.none", None):
        error = ModuleNotFoundError("none", name=name)
        assert missing(error) is error


def test_a_missing_package_comes_from_the_clone_or_the_wheel_at_hand(monkeypatch, tmp_path):
    """No index has a package of this name: the command names a folder or a file that pip finds."""
    error = ModuleNotFoundError("none", name="matplotlib")
    clone = Path(__file__).parents[2]
    assert str(missing(error)).endswith(f"python -m pip install '{clone}[design]'")

    wheel = tmp_path / "a folder" / "stillwork-0.1.0-py3-none-any.whl"
    installed = tmp_path / "site-packages"
    module = installed / "stillwork" / "base" / "extras.py"
    for folder in (wheel.parent, module.parent, installed / "stillwork-0.1.0.dist-info"):
        folder.mkdir(parents=True)
    module.write_text("")
    (installed / "stillwork-0.1.0.dist-info" / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: stillwork\nVersion: 0.1.0\n"
    )
    monkeypatch.setattr(extras, "__file__", str(module))
    monkeypatch.syspath_prepend(str(installed))
    assert str(missing(error)).endswith("python -m pip install 'stillwork-0.1.0-py3-none-any.whl[design]'")
    wheel.write_text("")
    noted = installed / "stillwork-0.1.0.dist-info" / "direct_url.json"
    noted.write_text(f'{{"url": "{wheel.as_uri()}", "archive_info": {{}}}}')
    assert str(missing(error)).endswith(f"python -m pip install '{wheel}[design]'")
