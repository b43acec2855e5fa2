"""What the toolbox's faces hand out says what it takes and gives, and shows it in an example that runs."""

import ast
import doctest
import inspect
import json
import re
import subprocess
import sys
import typing
from importlib import import_module
from textwrap import dedent

import numpy as np
import pytest

from stillwork.base.checks import require_number

FOLDERS = ("signals", "lti", "identification", "estimation", "control")
TOOLBOX = {name: import_module(f"stillwork.{name}") for name in FOLDERS}
FACES = [f"{folder}.{name}" for folder, package in TOOLBOX.items() for name in package.__all__]
# What has no source but this toolbox, by the reason.
NO_SOURCE = {
    "holds what a person gives": (*("signals.Record", "estimation.Plant", "control.Mechanism"),),
    "reads or writes what other programs hold": (
        *(
            "signals.load_record",
            "lti.from_control",
            "identification.load_machine",
            "control.load_controller",
        ),
        "control.as_libraries",
    ),
    "runs what it is given, whose source stands there": (
        *("lti.simulate", "identification.build_machine", "estimation.filter_signal", "estimation.run"),
        "estimation.RecursiveStepper",
    ),
    "found for this toolbox": (
        *("lti.resonance_grid", "identification.coloured_noise_bound", "control.asin_trajectory"),
        "control.Uncertainty",
        "control.worst_place",
    ),
}
OUR_OWN = {face for faces in NO_SOURCE.values() for face in faces}
REFUSES = re.compile(r"\braise \w|\brequire_\w+\(")
SHAPED = re.compile(r'"[^"]*"')  # of a field: jaxtyping's sizes


def handed_out(face):
    folder, name = face.split(".")
    return inspect.unwrap(getattr(TOOLBOX[folder], name))


def sections(thing):
    """Text by heading; that before the first one under an empty heading."""
    parts = re.split(r"^(\w+)\n-{3,}\n", inspect.getdoc(thing) or "", flags=re.MULTILINE)
    return dict(zip(["", *parts[1::2]], parts[::2], strict=True))


def listed(text):
    """Names that begin an entry: ``low_hz, high_hz : float``."""
    heads = [line.partition(" : ")[0] for line in text.splitlines() if line and not line.startswith(" ")]
    return {name.strip() for head in heads for name in head.split(",")}


def untold(thing):
    """What is missing from a docstring."""
    told = sections(thing)
    node = ast.parse(dedent(inspect.getsource(thing))).body[0]
    gaps = [] if told[""].strip() else ["summary"]
    if "Raises" not in told and not hasattr(thing, "_fields"):  # a named tuple checks nothing
        gaps.append("Raises")
    if isinstance(node, ast.FunctionDef):
        wanted = set(inspect.signature(thing).parameters)
        given = ast.unparse(node.returns) if node.returns else "None"
        if given != "None" and "Returns" not in told:
            gaps.append("Returns")
    else:
        wanted = set(getattr(thing, "__annotations__", {})) or set(inspect.signature(thing).parameters)
        if wanted and not {"Parameters", "Attributes"} & set(told):
            gaps.append("Parameters")
        wanted -= beside(thing, node)
    missing = wanted - listed(told.get("Parameters", "")) - listed(told.get("Attributes", ""))
    return gaps + sorted(missing)


def beside(thing, node):
    """Fields of which a comment behind or right above, or the sizes in their annotation, say what they hold."""
    lines = dedent(inspect.getsource(thing)).splitlines()
    fields = [each for each in node.body if isinstance(each, ast.AnnAssign)]
    return {
        field.target.id
        for field in fields
        if any("  # " in line for line in lines[field.lineno - 1 : field.end_lineno])
        or lines[field.lineno - 2].lstrip().startswith("# ")
        or SHAPED.search(ast.unparse(field.annotation).replace("'", '"'))
    }


@pytest.mark.parametrize("face", FACES)
def test_a_face_tells_what_it_takes_gives_and_refuses(face):
    assert untold(handed_out(face)) == []


@pytest.mark.parametrize("face", FACES)
def test_a_face_names_its_source(face):
    assert ("References" in sections(handed_out(face))) is not (face in OUR_OWN)


def given_back():
    """Classes of the toolbox that a face hands out, or that it returns, under their names."""
    found = {}
    for face in FACES:
        thing = handed_out(face)
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


def untold_method(method):
    """What is missing from a method's docstring: it refuses something where it says so, or has arguments checked."""
    told, node = sections(method), ast.parse(dedent(inspect.getsource(method))).body[0]
    wanted = [name for name in inspect.signature(method).parameters if name not in ("self", "cls")]
    door = any("checked" in ast.unparse(each) for each in node.decorator_list)
    gaps = [] if told[""].strip() else ["summary"]
    if not (node.returns and ast.unparse(node.returns) == "None") and "Returns" not in told:
        gaps.append("Returns")
    if ((door and wanted) or REFUSES.search(ast.unparse(node))) and "Raises" not in told:
        gaps.append("Raises")
    if "Examples" not in told:
        gaps.append("Examples")
    return gaps + sorted(set(wanted) - listed(told.get("Parameters", "")))


@pytest.mark.parametrize("name", METHODS)
def test_a_method_tells_what_it_takes_gives_and_refuses(name):
    assert untold_method(METHODS[name]) == []


@pytest.mark.parametrize("name", given_back())
def test_a_property_says_what_it_is(name):
    held = {n: each for n, each in vars(given_back()[name]).items() if not n.startswith("_")}
    assert [n for n, each in held.items() if isinstance(each, property) and not inspect.getdoc(each)] == []


def run_examples():
    """What went wrong in each example; numpy is `np`, as everywhere, and the folders have their names."""
    found = {}
    for name, thing in ({face: handed_out(face) for face in FACES} | METHODS).items():
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
@pytest.mark.parametrize("name", [*FACES, *METHODS])
def test_an_example_runs(name, outcomes):
    assert outcomes[name] == ""


def half_told(matrix, step) -> np.ndarray:
    """Two arguments.

    Parameters
    ----------
    matrix : array_like
        Numbers.
    """
    return np.zeros(2)


class HalfTold:
    def fit(self, matrix):
        """One argument, which it may refuse."""
        require_number("matrix", matrix)
        return self


def test_what_is_missing_is_found():
    assert untold(half_told) == ["Raises", "Returns", "step"]
    assert untold_method(HalfTold.fit) == ["Returns", "Raises", "Examples", "matrix"]


if __name__ == "__main__":
    print(json.dumps(run_examples()))
