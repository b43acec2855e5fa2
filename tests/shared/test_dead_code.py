"""Nothing in the library stands there for its own test alone: each top-level name is used, offered or written about."""

import ast
import json
import re
from collections import defaultdict

import pytest

from workbook import paths

# A public API, a command, a page of the site, a study of `data/<topic>/choices.toml` and a notebook's text name a function
# without calling it.
NAMED = re.compile(r"(?:experiments|contest|notebooks)[\w.]*:(\w+)|(?:stillwork|workbook)[\w.]*:(\w+)")
WRITTEN = re.compile(r"`[\w.]*?(\w+)`")
# pytest and Jupyter call these by their names.
HOOKS = re.compile(r"__\w+__|pytest_\w+")


def defined(statement):
    """Names that a statement of a module gives to functions, classes and constants."""
    if isinstance(statement, ast.FunctionDef | ast.ClassDef):
        return {statement.name}
    if isinstance(statement, ast.Assign | ast.AnnAssign):
        targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
        return {name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)}
    return set()


def used(tree, offers=False):
    """Names that a piece of code reads, imports or, as a package, exports."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            found.add(node.id)
        elif isinstance(node, ast.Attribute):
            found.add(node.attr)
        elif isinstance(node, ast.alias):
            found.add(node.name)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            if offers:
                found.add(node.value)
            elif named := NAMED.fullmatch(node.value):
                found.add(named[1] or named[2])
            elif node.value.isidentifier() and node.value[:1].isupper():  # an annotation ahead of its class
                found.add(node.value)
    return found


def dead(modules, others):
    """Top-level names of `modules` (trees by name) that neither another statement nor `others` use."""
    users = defaultdict(set)  # of a name, the places that use it
    for name in others:
        users[name].add("elsewhere")
    places = []
    for module, tree in modules.items():
        for number, statement in enumerate(tree.body):
            places.append((module, number, defined(statement)))
            for name in used(statement, offers=module.endswith("__init__")):
                users[name].add((module, number))
    return [
        f"{module}: {', '.join(sorted(names))}"
        for module, number, names in places
        if names  # of a palette or an enumeration one is enough
        if not any(HOOKS.fullmatch(name) or users[name] - {(module, number)} for name in names)
    ]


@pytest.mark.slow
def test_every_top_level_name_is_used():
    root = paths.root()
    modules = {
        str(file.relative_to(root).with_suffix("")): ast.parse(file.read_text(encoding="utf-8"))
        for folder in ("lib", "contest", "notebooks")
        for file in sorted((root / folder).rglob("*.py"))
    }
    assert modules
    others = set()
    for file in (*(root / "benchmarks").rglob("*.py"), *(root / "docs").rglob("*.py")):
        others |= used(ast.parse(file.read_text(encoding="utf-8")))
    for file in root.glob("notebooks/*/*.ipynb"):
        for cell in json.loads(file.read_text(encoding="utf-8"))["cells"]:
            text = "".join(cell["source"])
            if cell["cell_type"] == "code":
                others |= used(ast.parse(re.sub(r"^(\s*)[%!].*", r"\1pass", text, flags=re.MULTILINE)))
            else:
                others |= set(WRITTEN.findall(text))
    for file in (root / "pyproject.toml", *(root / "data").rglob("*.toml")):
        for names in NAMED.findall(file.read_text(encoding="utf-8")):
            others |= set(names)
    # What a contributor's own notebook calls, too.
    others |= set(re.findall(r"`workbook\.[\w.]*\.(\w+)[(`]", (root / "CONTRIBUTING.md").read_text("utf-8")))
    assert dead(modules, others) == []
