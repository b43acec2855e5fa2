"""Each name that the toolbox offers, and each method, has an example that runs."""

import doctest
import inspect
import json
import subprocess
import sys
import typing
from importlib import import_module

import numpy as np
import pytest

FOLDERS = ("signals", "lti", "identification", "estimation", "control", "machine")
TOOLBOX = {name: import_module(f"stillwork.{name}") for name in FOLDERS}
PUBLIC = [f"{folder}.{name}" for folder, package in TOOLBOX.items() for name in package.__all__]


def public_object(path):
    folder, name = path.split(".")
    return inspect.unwrap(getattr(TOOLBOX[folder], name))


def given_back():
    """Classes of the toolbox of a public API, or that it returns, under their names."""
    found = {}
    for name in PUBLIC:
        thing = public_object(name)
        if not inspect.isclass(thing):
            thing = typing.get_type_hints(thing).get("return")
        if inspect.isclass(thing) and thing.__module__.startswith("stillwork"):
            found[thing.__name__] = thing
    return found


def methods(thing):
    """What people call of a class, by its name: its own, and what it has of a class of the toolbox."""
    found = {name: inspect.unwrap(getattr(thing, name)) for name in dir(thing) if not name.startswith("_")}
    homes = {
        name: getattr(each, "__module__", None) or ""
        for name, each in found.items()
        if inspect.isroutine(each)
    }
    return {name: found[name] for name, home in homes.items() if home.startswith("stillwork.")}


METHODS = {
    f"{name}.{method}": each
    for name, thing in given_back().items()
    for method, each in methods(thing).items()
}


def run_examples():
    """What went wrong in each example; numpy is `np`, as everywhere, and the folders have their names."""
    found = {}
    for name, thing in ({name: public_object(name) for name in PUBLIC} | METHODS).items():
        finder = doctest.DocTestFinder(recurse=False)
        (example,) = finder.find(thing, name, globs={"np": np, **TOOLBOX})
        said = [] if example.examples else ["no example\n"]
        doctest.DocTestRunner(verbose=False).run(example, out=said.append)
        found[name] = "".join(said)
    return found


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    """Of all examples, as a person runs them: in a process without the tests' type checker, which refuses lists."""
    folder = tmp_path_factory.mktemp("examples")
    done = subprocess.run([sys.executable, __file__], cwd=folder, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*PUBLIC, *METHODS])
def test_an_example_runs(name, outcomes):
    assert outcomes[name] == ""


if __name__ == "__main__":
    print(json.dumps(run_examples()))
