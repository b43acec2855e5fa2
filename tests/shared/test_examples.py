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

FOLDERS = ("signals", "lti", "identification", "estimation", "control")
TOOLBOX = {name: import_module(f"stillwork.{name}") for name in FOLDERS}
FACES = [f"{folder}.{name}" for folder, package in TOOLBOX.items() for name in package.__all__]
# What holds, reads, runs or writes, and what was found for this toolbox: it has no source but itself.
OUR_OWN = {
    *("signals.Record", "signals.load_record", "lti.StateModel", "lti.from_control", "lti.resonance_grid"),
    *(
        "lti.simulate",
        "identification.Identified",
        "identification.build_machine",
        "identification.load_machine",
    ),
    *("identification.coloured_noise_bound", "estimation.AdaptationStepper", "estimation.NoiseIntensities"),
    *("estimation.Plant", "estimation.RecursiveStepper", "estimation.filter_signal", "estimation.run"),
    *("control.Mechanism", "control.PeakConstraint", "control.as_libraries", "control.asin_trajectory"),
    *("control.load_controller", "control.make_loop", "control.tracking_error", "control.worst_factors"),
}
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


@pytest.mark.parametrize("face", FACES)
def test_the_methods_of_a_face_say_what_they_do(face):
    thing = handed_out(face)
    if inspect.isclass(thing):
        methods = {name: each for name, each in vars(thing).items() if not name.startswith("_")}
        called = {n: m for n, m in methods.items() if inspect.isfunction(m) or isinstance(m, property)}
        assert [name for name, method in called.items() if not inspect.getdoc(method)] == []


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


@pytest.mark.parametrize("name", given_back())
def test_a_method_that_takes_something_says_what(name):
    gaps = {}
    for method, function in vars(given_back()[name]).items():
        if not method.startswith("_") and inspect.isfunction(function):
            wanted = set(inspect.signature(function).parameters) - {"self"}
            if missing := wanted - listed(sections(inspect.unwrap(function)).get("Parameters", "")):
                gaps[method] = missing
    own_recursion = {"trace_copies", "bounds", "start", "fill"}  # parts of a recursion, for its stepper alone
    assert {method: each for method, each in gaps.items() if method not in own_recursion} == {}


def run_examples():
    """What went wrong in the example of each face; numpy is `np`, as everywhere, and the folders have their names."""
    found = {}
    for face in FACES:
        finder = doctest.DocTestFinder(recurse=False)
        (example,) = finder.find(handed_out(face), face, globs={"np": np, **TOOLBOX})
        said = [] if example.examples else ["no example\n"]
        doctest.DocTestRunner(verbose=False).run(example, out=said.append)
        found[face] = "".join(said)
    return found


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    """Of all examples, as a person runs them: in a process without the tests' type checker, which refuses lists."""
    folder = tmp_path_factory.mktemp("examples")
    done = subprocess.run([sys.executable, __file__], cwd=folder, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("face", FACES)
def test_the_example_of_a_face_runs(face, outcomes):
    assert "Examples" in sections(handed_out(face))
    assert outcomes[face] == ""


def half_told(matrix, step) -> np.ndarray:
    """Two arguments.

    Parameters
    ----------
    matrix : array_like
        Numbers.
    """
    return np.zeros(2)


def test_what_is_missing_is_found():
    assert untold(half_told) == ["Raises", "Returns", "step"]


if __name__ == "__main__":
    print(json.dumps(run_examples()))
