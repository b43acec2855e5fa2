"""Own models: compiled beside their file once, and not again in another process."""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from fixedpoint import own_model
from fixedpoint.reuse import use
from stillwork.base.kernels import callback
from stillwork.estimation.plant import SIGNATURE


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
def test_a_second_process_compiles_nothing(tmp_path, monkeypatch):
    """An own plant in an own file: compiled and cached beside it here, found there by another process."""
    module, loader = load(tmp_path)
    monkeypatch.setitem(sys.modules, "own_model", module)
    loader.exec_module(module)
    _, hits, error = use(module)
    assert hits == 0 and error < 1e-3
    assert elsewhere(tmp_path) == ["0", "2", str(error)]


def test_a_module_that_no_other_process_can_import_leaves_no_cache(tmp_path):
    """Loaded by its path alone: numba would write a cache that it cannot read again."""
    module, loader = load(tmp_path)
    loader.exec_module(module)
    callback(module.cart_acceleration, SIGNATURE)
    assert not list(tmp_path.rglob("*.nbc"))
