"""A notebook's explorer without a kernel: its drawing function and its controls, from the statements that lead to them."""

import ast
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from workbook.explorer import Choice, Slider, whole_settings
from workbook.notebooks import Notebook

SCOPES = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)


@dataclass(frozen=True)
class Explorer:
    """What a notebook gives to `workbook.explorer.explore`."""

    draw: Callable
    controls: dict[str, Slider | Choice]
    presets: dict[str, dict] = field(default_factory=dict)
    parameters: tuple[str, ...] = ()  # of the notebook


def _taken(draw: Callable, presets: Mapping[str, Mapping] | None = None, **controls) -> Explorer:
    return Explorer(draw, controls, whole_settings(presets or {}, controls))


def read_explorer(notebook: Notebook) -> Explorer | None:
    """The explorer of a notebook at its published settings; None where it has none.

    Of the notebook runs only what the explorer needs: no study whose result it does not take.
    """
    needed = statements(notebook.source)
    if not needed:
        return None
    *before, last = needed
    names: dict[str, object] = {"_taken": _taken}
    exec(compile(ast.Module(before, []), notebook.name, "exec"), names)
    last.value.func = ast.copy_location(ast.Name("_taken", ast.Load()), last.value)
    found = eval(compile(ast.Expression(last.value), notebook.name, "eval"), names)
    return replace(found, parameters=tuple(notebook.parameters))


def statements(source: str) -> list[ast.stmt]:
    """The statements of a notebook (its file's text) that its call of ``explore`` needs, the call last.

    A statement is needed when it binds or changes a name that a later needed one reads: by assignment, or by calling a
    method of it and dropping what that returns. What a function does to its arguments is not seen.
    """
    body = []
    for cell in json.loads(source)["cells"]:
        if cell["cell_type"] == "code":
            try:
                body += ast.parse("".join(cell["source"])).body
            except SyntaxError:  # a cell with Jupyter's own commands
                continue
    calls = [number for number, each in enumerate(body) if _explores(each)]
    if not calls:
        return []
    kept = [body[calls[-1]]]
    needed = _read(kept[0])
    imported = set().union(*(_imported(each) for each in body))
    for each in reversed(body[: calls[-1]]):
        changed = _bound(each) | (_called(each) - imported)
        if changed & needed and not _explores(each):
            kept.insert(0, each)
            needed |= _read(each)
    return kept


def _explores(statement: ast.stmt) -> bool:
    match statement:
        case ast.Expr(value=ast.Call(func=ast.Name(id="explore"))):
            return True
    return False


def _read(statement: ast.stmt) -> set[str]:
    return {node.id for node in ast.walk(statement) if isinstance(node, ast.Name)} - _own(statement)


def _bound(statement: ast.stmt) -> set[str]:
    """Names that a statement binds, or whose elements or attributes it sets."""
    names = _imported(statement)
    for node in ast.walk(statement):
        match node:
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                names.add(name)
            case ast.Name(id=name, ctx=ast.Store()):
                names.add(name)
            case ast.Subscript(ctx=ast.Store()) | ast.Attribute(ctx=ast.Store()):
                names |= _root(node)
    return names - _own(statement)


def _called(statement: ast.stmt) -> set[str]:
    """Names of which a statement calls a method and drops what it returns: ``rows.append(row)``."""
    names = set()
    for node in ast.walk(statement):
        match node:
            case ast.Expr(value=ast.Call(func=ast.Attribute() as method)):
                names |= _root(method)
    return names


def _imported(statement: ast.stmt) -> set[str]:
    return {
        (each.asname or each.name).partition(".")[0]
        for node in ast.walk(statement)
        if isinstance(node, ast.Import | ast.ImportFrom)
        for each in node.names
    }


def _root(node: ast.expr) -> set[str]:
    """The name that an element, an attribute or a method is of."""
    while isinstance(node, ast.Subscript | ast.Attribute):
        node = node.value
    return {node.id} if isinstance(node, ast.Name) else set()


def _own(statement: ast.stmt) -> set[str]:
    """Names of a statement's comprehensions, which end with them."""
    return {
        node.id
        for scope in ast.walk(statement)
        if isinstance(scope, SCOPES)
        for generator in scope.generators
        for node in ast.walk(generator.target)
        if isinstance(node, ast.Name)
    }
