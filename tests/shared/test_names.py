"""Names in the library: a class's stands once, a private one stays in its file, paint, sample and trial mean one thing."""

import ast
import json
from collections import defaultdict
from pathlib import Path

import pytest

LIB = Path(__file__).parents[2] / "lib"


@pytest.fixture(scope="module")
def modules():
    """Every module's syntax tree under its name."""
    trees = {}
    for file in sorted(LIB.rglob("*.py")):
        parts = file.relative_to(LIB).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        trees[name] = ast.parse(file.read_text(encoding="utf-8"))
    assert {"stillwork.base.checks", "experiments.motion"} <= trees.keys()
    return trees


def private(name):
    return name.startswith("_") and not name.startswith("__")


@pytest.mark.slow
def test_a_class_name_stands_once(modules):
    places = defaultdict(list)
    for module, tree in modules.items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef):
                places[node.name].append(module)
    assert {name: found for name, found in places.items() if len(found) > 1} == {}


@pytest.mark.slow
def test_a_private_name_is_used_in_its_own_file_alone(modules):
    """Neither imported, nor reached through a module that is."""
    reached = []
    for module, tree in modules.items():
        aliases = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom):
                for each in node.names:
                    if f"{node.module}.{each.name}" in modules:
                        aliases[each.asname or each.name] = f"{node.module}.{each.name}"
                    if node.module in modules and private(each.name):
                        reached.append(f"{module} imports {node.module}.{each.name}")
        reached += [
            f"{module} reaches {aliases[node.value.id]}.{node.attr}"
            for node in ast.walk(tree)
            if isinstance(node, ast.Attribute)
            and private(node.attr)
            and isinstance(node.value, ast.Name)
            and node.value.id in aliases
        ]
    assert reached == []


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
