"""Names in the library: a class's stands once, a private one stays in its file."""

import ast
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


def test_a_class_name_stands_once(modules):
    places = defaultdict(list)
    for module, tree in modules.items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef):
                places[node.name].append(module)
    assert {name: found for name, found in places.items() if len(found) > 1} == {}


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
