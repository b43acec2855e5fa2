import json
import shutil
import subprocess

import pytest

from stillwork.control.machine_loops import reach
from stillwork.machine import machine_designs
from stillwork.machine.desk_page import modules
from workbook import paths


@pytest.fixture(scope="session")
def node(tmp_path_factory):
    """``node(calls)``: results of calls (module, name, *arguments) of the desk's modules."""
    if shutil.which("node") is None:
        pytest.skip("node is not installed, which runs the desk's modules: apt-get install nodejs")
    folder = tmp_path_factory.mktemp("modules")
    for name, text in modules().items():
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "package.json").write_text('{"type": "module"}')

    def run(calls):
        asked = [{"module": each[0], "name": each[1], "arguments": each[2:]} for each in calls]
        command = ["node", str(paths.root() / "tests" / "desk" / "run.mjs"), str(folder)]
        text = json.dumps(asked, default=lambda value: value.tolist())
        done = subprocess.run(command, input=text, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return run


@pytest.fixture
def untuned(monkeypatch):
    """Designs with the first settings of each use, as a search begins: a tenth of the time of one that tunes them."""

    def first_settings(machine, first, contained, search, on_step):
        return machine_designs._Reached(first, reach(machine, first, search))

    monkeypatch.setattr(machine_designs, "_furthest", first_settings)
