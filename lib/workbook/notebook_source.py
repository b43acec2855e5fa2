"""What a code cell draws, claims and calls, read from its source without running it."""

import ast
import json
import re

from workbook import paths
from workbook.notebooks import Notebook

BARE = r"(\w+\\\.)?\.\+"  # the pattern of a variable, with or without the topic before it
PACKAGES = ("stillwork", "workbook", "experiments", "notebooks")  # and those of the workbook's own


def figures_saved(source: str, available: list[str]) -> list[str]:
    """Names of the figures that a cell saves, of those `available`."""
    return _named(source, "save", available)


def claims_checked(source: str, available: list[str]) -> list[str]:
    """Ids of the claims that a cell makes, of those `available`."""
    return _named(source, "check", available)


def _named(source: str, method: str, available: list[str]) -> list[str]:
    """Those `available` that a first argument of ``page.<method>(...)`` can mean, in the order of the calls.

    A variable means those that the cell writes out, whole or without the topic; what a function gives is not seen.
    """
    tree, found = _parsed(source), []
    written = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)} - {""}
    for node in ast.walk(tree):
        match node:
            case ast.Call(func=ast.Attribute(value=ast.Name(id="page"), attr=name), args=[first, *_]) if (
                name == method
            ):
                pattern = _pattern(first)
                named = [each for each in available if re.fullmatch(pattern, each) and each not in found]
                if re.fullmatch(BARE, pattern):
                    named = [each for each in named if {each, each.partition(".")[2]} & written]
                found += named
    return found


def _pattern(node: ast.expr) -> str:
    """Regular expression of the strings that an expression may give: what is not literal matches anything."""
    match node:
        case ast.Constant(value=str(text)):
            return re.escape(text)
        case ast.JoinedStr(values=parts):
            return "".join(_pattern(part) for part in parts)
    return ".+"


def used(sources: list[str]) -> list[str]:
    """Dotted names of what cells use of the library, e.g. ``experiments.isolation.twin.load_twin``, sorted."""
    local, packages = {}, (*PACKAGES, *paths.packages())
    trees = [_parsed(source) for source in sources]
    for tree in trees:
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in packages:
                local |= {each.asname or each.name: f"{node.module}.{each.name}" for each in node.names}
    found = set()
    for tree in trees:
        for node in ast.walk(tree):
            match node:
                case ast.Attribute(value=ast.Name(id=name), attr=member) if name in local:
                    found |= {local[name], f"{local[name]}.{member}"}
                case ast.Name(id=name) if name in local:
                    found.add(local[name])
    return sorted(found)


def comments(notebook: Notebook) -> dict[str, str]:
    """What stands behind each parameter in the notebook's cell of parameters."""
    cells = json.loads(notebook.source)["cells"]
    tagged = [cell for cell in cells if "parameters" in cell["metadata"].get("tags", [])]
    lines = "".join(tagged[0]["source"]) if tagged else ""
    found = {}
    for name in notebook.parameters:
        comment = re.search(rf"^{name}\s*:[^#\n]*#\s*(.+)$", lines, re.MULTILINE)
        found[name] = comment[1] if comment else ""
    return found


def _parsed(source: str) -> ast.Module:
    try:
        return ast.parse(source)
    except SyntaxError:  # a cell with Jupyter's own commands
        return ast.Module(body=[], type_ignores=[])
