import gc
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import settings

import typecheck

# What is imported stays, half a million objects of it: the search for garbage leaves them out, while they are made and
# in every test, and comes more rarely. It took a twelfth of the time of the tests that are not slow.
gc.disable()
gc.set_threshold(20_000)

# As in `stillwork.base.command_line`: a second or two of every process that loads nbformat.
sys.modules.setdefault("rfc3987_syntax", None)

# Neither the machine's load nor chance decides a test: every run tries the same examples. Others are sought with
# make quick ARGS=--hypothesis-profile=search.
settings.register_profile("workbook", deadline=None, derandomize=True)
settings.register_profile("search", deadline=None, derandomize=False)
settings.load_profile("workbook")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config):
    """One worker more than processors for all tests: a tenth of the time some wait for processes that they started."""
    if config.option.dist == "loadfile" and not config.option.markexpr:
        from workbook.workers import cores  # not before the types of what it imports can be checked

        return cores() + 1
    return None  # as many as processors


def pytest_collection_finish():
    gc.freeze()
    gc.enable()


@pytest.fixture(autouse=True)
def as_a_person(monkeypatch):
    """Tests look at this checkout's library as a person does, unless they say otherwise."""
    root = Path(__file__).parents[1]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(root / "lib"), str(root)]))
    monkeypatch.delenv("STILLWORK_OUTPUT", raising=False)


@pytest.fixture(autouse=True)
def types_are_checked():
    """Each test checks the types of all functions that it calls, whatever the tests before it called."""
    typecheck.begin_again()


@pytest.fixture(scope="session")
def node(tmp_path_factory):
    """``node(calls)``: results of calls (module, name, *arguments) of the desk's modules."""
    from stillwork.machine.desk_page import modules  # not before the types of what it imports can be checked
    from workbook import paths

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
