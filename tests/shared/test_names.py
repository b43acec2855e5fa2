"""Names in the library: a class's stands once, a private one stays in its file, paint, sample and trial mean one thing."""

import ast
import json
from collections import defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LIB = ROOT / "lib"


def read(folder):
    """Every module's syntax tree under the name by which what lies beside it imports it."""
    trees = {}
    for file in sorted(folder.rglob("*.py")):
        parts = file.relative_to(folder).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        trees[name] = ast.parse(file.read_text(encoding="utf-8"))
    return trees


@pytest.fixture(scope="module")
def modules():
    trees = read(LIB)
    assert {"stillwork.base.checks", "experiments.motion"} <= trees.keys()
    return trees


def private(name):
    return name.startswith("_") and not name.startswith("__") and "jupyter_server_extension" not in name


@pytest.mark.slow
def test_a_class_name_stands_once(modules):
    places = defaultdict(list)
    for module, tree in modules.items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef):
                places[node.name].append(module)
    assert {name: found for name, found in places.items() if len(found) > 1} == {}


def reached(tree, names):
    """Private names of the modules `names` that a file imports, or reaches through a module.

    A test may replace what is private, for there is no other way to break it, and call what it replaces.
    """
    aliases, replaced = {}, set()
    for node in ast.walk(tree):
        match node:
            case ast.ImportFrom(module=module, names=given, level=level):
                for each in given:
                    if private(each.name) and (level or module in names):
                        yield f"{module}.{each.name}"
                    aliases[each.asname or each.name] = f"{module}.{each.name}"
            case ast.Import(names=given):
                aliases |= {each.asname or each.name: each.name for each in given}
            case ast.Call(func=ast.Attribute(attr="setattr"), args=[module, ast.Constant(value=name), _]):
                replaced.add((ast.unparse(module), name))
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and private(node.attr):
            module = ast.unparse(node.value)
            if aliases.get(module) in names and (module, node.attr) not in replaced:
                yield f"{aliases[module]}.{node.attr}"


@pytest.mark.slow
def test_a_private_name_is_used_in_its_own_file_alone(modules):
    """In the library, in the benchmarks and in the tests."""
    folders = [modules, *(read(ROOT / name) for name in ("benchmarks", "tests"))]
    names = {name for folder in folders for name in folder}
    assert "fuzzing.behind" in names and "shared.test_names" in names
    found = [
        (name, each) for folder in folders for name, tree in folder.items() for each in reached(tree, names)
    ]
    assert found == []


def test_a_private_name_that_is_reached_is_found():
    lines = """
from a.b import _one
from a import b as c; c._two
import a.b; a.b._three; a.b.__name__
import a.b as d; d._four; monkeypatch.setattr(d, "_five", lambda: d._five())
from .e import _six
from numba import _seven; import os; os._exit(0); x._replace()
"""
    wanted = {"a.b._one", "a.b._two", "a.b._three", "a.b._four", "e._six"}
    assert set(reached(ast.parse(lines), {"a", "a.b"})) == wanted


# Where such a name means something else: when the optimum jumps; a function, an observer's next sample.
NO_SAMPLE_TIME = {
    ("experiments.isolation.stability_pictures", "paint_cures", "step"),
    ("experiments.motion.observer_contest.bench", "run_scans", "step"),
}


@pytest.mark.slow
def test_the_interval_between_samples_is_called_sample_time(modules):
    """As a parameter or a field; it had three names, and a caller had to look up which one a function takes."""
    others = {"step", "time_step", "dt", "Ts", "sampling_time"}
    found = set()
    for module, tree in modules.items():
        if module.startswith(("stillwork.workbook", "stillwork.site")):
            continue
        for node in ast.walk(tree):
            names = []
            if isinstance(node, (ast.FunctionDef, ast.Lambda)):
                given = node.args
                names = [each.arg for each in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
                if any(ast.unparse(each) == "property" for each in getattr(node, "decorator_list", ())):
                    names.append(node.name)
            elif isinstance(node, ast.ClassDef):
                names = [ast.unparse(each.target) for each in node.body if isinstance(each, ast.AnnAssign)]
            found |= {(module, getattr(node, "name", "lambda"), name) for name in names if name in others}
    assert found == NO_SAMPLE_TIME


def functions(tree):
    return [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]


@pytest.mark.slow
def test_a_figure_is_painted_and_chance_is_sampled(modules):
    """`paint_*` makes a figure, `sample_*` is random; "draw" would mean both."""
    for module, tree in modules.items():
        if not module.startswith(("stillwork.workbook", "stillwork.site")):
            assert [(module, each.name) for each in functions(tree) if "draw" in each.name.split("_")] == []
    unpainted = [
        (module, each.name)
        for module, tree in modules.items()
        if module.startswith("experiments.")
        for each in tree.body
        if isinstance(each, ast.FunctionDef)
        and not each.name.lstrip("_").startswith(("paint_", "explore_"))
        and not each.name.endswith(("_explorer", "_painter"))
        and makes_a_figure(each)
    ]
    assert unpainted == []


def makes_a_figure(function):
    """Whether it returns what `figures.new` gave it."""
    made = {
        name.id
        for node in ast.walk(function)
        if isinstance(node, ast.Assign)
        and isinstance(node.value, ast.Call)
        and ast.unparse(node.value.func) == "figures.new"
        for target in node.targets
        for name in ast.walk(target)
        if isinstance(name, ast.Name)
    }
    return any(
        isinstance(node, ast.Return) and isinstance(node.value, ast.Name) and node.value.id in made
        for node in ast.walk(function)
    )


def test_one_run_of_a_study_is_a_trial():
    """What `run_study` is given, in the library and in the notebooks."""
    texts = [file.read_text(encoding="utf-8") for file in sorted(LIB.rglob("*.py"))]
    for file in sorted(LIB.parent.glob("notebooks/*/*.ipynb")):
        cells = json.loads(file.read_text(encoding="utf-8"))["cells"]
        texts += ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    trials = [
        ast.unparse(node.args[0])
        for text in texts
        if "run_study(" in text
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] == "run_study"
    ]
    assert len(trials) > 20
    assert [each for each in trials if not each.endswith("trial")] == []
