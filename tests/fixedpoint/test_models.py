"""Own models: only their own functions are compiled in another process."""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from fixedpoint import own_model
from fixedpoint.reuse import use


def load(folder):
    """The module of own functions out of a copy in `folder`."""
    spec = importlib.util.spec_from_file_location("own_model", shutil.copy(own_model.__file__, folder))
    return importlib.util.module_from_spec(spec), spec.loader


def elsewhere(folder) -> list[str]:
    """What `use` returns in another process that imports the module from `folder`."""
    code = "import sys; sys.path[:0] = sys.argv[1:]; import own_model, reuse; print(*reuse.use(own_model))"
    command = [sys.executable, "-c", code, str(folder), str(Path(__file__).parent)]
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2] / "lib")}
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.stderr == ""
    return done.stdout.split()


@pytest.mark.slow
def test_an_own_plant_compiles_its_functions_alone(tmp_path, monkeypatch):
    """The kernel that calls them was compiled for others: another process finds it, and comes to the same error."""
    module, loader = load(tmp_path)
    monkeypatch.setitem(sys.modules, "own_model", module)
    loader.exec_module(module)
    _, error = use(module)
    assert error < 1e-3
    assert elsewhere(tmp_path) == ["0", str(error)]
    assert not list(tmp_path.rglob("*.nbc"))
