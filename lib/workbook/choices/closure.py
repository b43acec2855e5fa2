"""What a study's code consists of: its module and all that this imports, as far as it lies in the same library."""

import ast
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import stillwork
from stillwork.base.checks import InputError
from stillwork.base.source_digest import code_digest
from workbook import paths
from workbook.choices.notebook_study import code_cells
from workbook.publish import digest

LIBRARY = Path(stillwork.__file__).parents[1]
OWN_RESULTS = ("paper.toml", "published.toml", "choices.toml", "choices.csv")


@cache  # for the life of the process: what it has imported does not change under it either
def study_digest(function: str, topic: str) -> str:
    """Digest of the code of ``package.module:function``, or of a notebook's cells, of all it imports, and of the topic's data.

    The ledger and the combinations are left out: they state what is computed, not what comes out.
    """
    lines = [function]
    if "/" in function:
        code = "\n".join(source for source, _ in code_cells(function))
        lines.append(digest(code.encode()))
        found = _closure([*_imported(ast.parse(code), "", [LIBRARY, paths.root()])], [LIBRARY, paths.root()])
    else:
        found = modules(function.partition(":")[0])
    for name, file in sorted(found.items()):
        lines.append(f"{name} {code_of(file)}")
    folder = paths.data(topic)
    for file in sorted(folder.rglob("*")):
        path = file.relative_to(folder).as_posix()
        if file.is_file() and not file.name.startswith(".") and path not in OWN_RESULTS:
            lines.append(f"{path} {digest(file.read_bytes())}")
    return digest("\n".join(lines).encode())


def modules(name: str) -> dict[str, Path]:
    """Files of a module and of all that it imports anywhere in its text, by module name.

    Only modules of the library, and those beside the first one, count; installed packages do not.

    Raises
    ------
    InputError
        When there is no such module.
    """
    beside = [Path(folder) for folder in sys.path if _file(name, [Path(folder)])]
    if not beside:
        raise InputError(f"there is no module {name!r}; name one that can be imported")
    return _closure([name], [LIBRARY, beside[0]])


def _closure(waiting: list[str], roots: list[Path]) -> dict[str, Path]:
    found: dict[str, Path] = {}
    while waiting:
        each = waiting.pop()
        if each in found or not (file := _file(each, roots)):
            continue
        found[each] = file
        waiting += [".".join(each.split(".")[:k]) for k in range(1, each.count(".") + 1)]
        waiting += imports(each, file, roots)
    return found


def _file(name: str, roots: list[Path]) -> Path | None:
    for root in roots:
        path = root.joinpath(*name.split("."))
        for file in (path / "__init__.py", path.with_suffix(".py")):
            if file.is_file():
                return file
    return None


def imports(name: str, file: Path, roots: list[Path]) -> Iterator[str]:
    """Modules that a module may import, anywhere in its text."""
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    yield from _imported(syntax_tree(file), package, roots)


def _imported(tree: ast.AST, package: str, roots: list[Path]) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package.split(".")[: package.count(".") + 2 - node.level]
                base = ".".join([*above, *filter(None, [base])])
            yield base
            source = _file(base, roots)
            for alias in node.names:
                if _file(f"{base}.{alias.name}", roots):
                    yield f"{base}.{alias.name}"
                elif source and source.name == "__init__.py":
                    yield from _behind_package(base, source, alias.name, roots)


def _behind_package(package: str, file: Path, name: str, roots: list[Path]) -> Iterator[str]:
    """Modules from which a package may export a public name at first use: those named beside it."""
    for node in ast.walk(syntax_tree(file)):
        if isinstance(node, ast.Dict):
            for key, value in zip(node.keys, node.values, strict=True):
                texts = _texts(key) + _texts(value)
                if name in texts:
                    yield from (f"{package}.{text}" for text in texts if _file(f"{package}.{text}", roots))


def _texts(node) -> list[str]:
    each = ast.walk(node) if node is not None else ()
    return [one.value for one in each if isinstance(one, ast.Constant) and isinstance(one.value, str)]


@cache
def code_of(file: Path) -> str:
    """Digest of a module's code."""
    return code_digest(file.read_bytes())


@cache
def syntax_tree(file: Path) -> ast.AST:
    return ast.parse(file.read_bytes())
