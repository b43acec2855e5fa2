"""The library's reference, read from its source: modules, functions, classes and their docstrings."""

import ast
import inspect
import re
from dataclasses import dataclass
from html import escape
from pathlib import Path

import stillwork
from stillwork.base import paths
from stillwork.site.house import TOOLBOX, face_names

LIBRARY = Path(stillwork.__file__).parent
FOR_NOTEBOOKS = ("__init__", "claims", "explorer", "figures", "page", "studies")  # modules of the workbook


@dataclass(frozen=True)
class Item:
    """A public function, class or method.

    Attributes
    ----------
    name : str
        As it is called within its module: ``adapt``, ``Record.duration``.
    signature : str
        As Python would print it.
    doc : str
        The docstring, without indentation; empty when there is none.
    line : int
        Where it begins in the module.
    members : tuple of Item
        Public methods and properties of a class.
    """

    name: str
    signature: str
    doc: str
    line: int
    members: tuple["Item", ...] = ()


@dataclass(frozen=True)
class Module:
    """A module of the library: ``experiments.isolation.twin``; `doc` and `source` as in its file."""

    name: str
    doc: str
    source: str
    items: tuple[Item, ...]
    constants: dict[str, int]  # line by name

    @property
    def folder(self) -> str:
        """The concept or the room that it belongs to: ``lti``, ``motion``."""
        return self.name.split(".")[1]


@dataclass(frozen=True)
class Folder:
    """A concept or a room: what it is, the places and items that it hands out, and its modules."""

    name: str
    doc: str
    public: tuple[tuple[str, Item], ...]
    modules: tuple[Module, ...]


def folders(modules: list[Module]) -> list[Folder]:
    """The modules by folder, in the order of the house: the toolbox from the ground up, the workbook, the rooms."""
    found = []
    for name in (*TOOLBOX, "workbook", *paths.ROOMS):
        mine = [module for module in modules if module.folder == name]
        package = next(module for module in mine if module.name.count(".") == 1)
        names = face_names(ast.parse(package.source))
        by_name = {module.name: module for module in mine}
        public = tuple(
            _handed_out(each, by_name[f"{package.name}.{names[each]}"])
            for each in sorted(names, key=str.lower)
        )
        inner = tuple(module for module in mine if module is not package)
        found.append(Folder(name, package.doc, public, inner))
    return found


def _handed_out(name: str, module: Module) -> tuple[str, Item]:
    """A public name with its place; of a constant the page shows the line."""
    for item in module.items:
        if item.name == name:
            return f"{module.name}.html#{name}", item
    line = module.constants[name]
    return f"{module.name}.html#line-{line}", Item(name, name, "", line)


def library_files() -> list[Path]:
    """Files of the toolbox, and of what notebooks use of the workbook: not what builds them, nor the command line and the site."""
    others = ("__main__.py", "inspecting.py", "workbook", "site")
    files = [file for file in LIBRARY.rglob("*.py") if file.relative_to(LIBRARY).parts[0] not in others]
    return sorted([*files, *(LIBRARY / "workbook" / f"{name}.py" for name in FOR_NOTEBOOKS)])


def read_modules() -> list[Module]:
    """The toolbox's and the workbook's modules and those of the rooms, in this order, each sorted by name."""
    files = [file for file in library_files() if file != LIBRARY / "__init__.py"]
    for room in paths.ROOMS:
        files += sorted((LIBRARY.parent / "experiments" / room).rglob("*.py"))
    return [_module(file) for file in files]


def index(modules: list[Module]) -> dict[str, str]:
    """Dotted name to its place ``<module>.html#<item>`` among the reference's pages.

    A folder also answers for what its modules define, as it does in Python: ``stillwork.estimation.FeRls``.
    """
    places = {}
    for module in modules:
        places[module.name] = f"{module.name}.html"
        for name, line in module.constants.items():
            places[f"{module.name}.{name}"] = f"{module.name}.html#line-{line}"
        for item in module.items:
            place = f"{module.name}.html#{item.name}"
            places[f"{module.name}.{item.name}"] = place
            places.setdefault(f"{module.name.rpartition('.')[0]}.{item.name}", place)
    return places


def _module(file: Path) -> Module:
    parts = file.relative_to(LIBRARY.parent).with_suffix("").parts
    name = ".".join(part for part in parts if part != "__init__")
    source = file.read_text(encoding="utf-8")
    tree = ast.parse(source)
    constants = {
        each.id: node.lineno
        for node in tree.body
        if isinstance(node, ast.Assign)
        for each in ast.walk(node.targets[0])
        if isinstance(each, ast.Name) and not each.id.startswith("_")
    }
    return Module(name, ast.get_docstring(tree) or "", source, _items(tree.body), constants)


def _items(body: list[ast.stmt], owner: str = "") -> tuple[Item, ...]:
    items = []
    for node in body:
        if not isinstance(node, ast.FunctionDef | ast.ClassDef) or node.name.startswith("_"):
            continue
        name = f"{owner}{node.name}"
        members = _items(node.body, f"{name}.") if isinstance(node, ast.ClassDef) else ()
        items.append(Item(name, _signature(node, owner), ast.get_docstring(node) or "", node.lineno, members))
    return tuple(items)


def _signature(node: ast.FunctionDef | ast.ClassDef, owner: str) -> str:
    if isinstance(node, ast.ClassDef):
        fields = [ast.unparse(each) for each in node.body if isinstance(each, ast.AnnAssign)]
        return f"{node.name}({', '.join(field for field in fields if not field.startswith('_'))})"
    decorators = {ast.unparse(each) for each in node.decorator_list}
    if decorators & {"property", "cached_property"}:
        return f"{node.name}{f' -> {ast.unparse(node.returns)}' if node.returns else ''}"
    arguments = node.args
    if owner and "staticmethod" not in decorators and arguments.args:
        arguments = ast.arguments(**{**dict(ast.iter_fields(arguments)), "args": arguments.args[1:]})
    returns = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    return f"{node.name}({ast.unparse(arguments)}){returns}"


def doc_html(doc: str) -> str:
    """HTML of a numpydoc docstring: paragraphs, indented blocks and sections of definitions."""
    lines = inspect.cleandoc(doc).splitlines()
    html, at = [], 0
    while at < len(lines):
        if at + 1 < len(lines) and re.fullmatch(r"-{3,}", lines[at + 1].strip()):
            html.append(f"<h4>{escape(lines[at])}</h4>")
            body, at = _until_section(lines, at + 2)
            html.append(_definitions(body))
        else:
            body, at = _until_section(lines, at)
            html.append(_blocks(body))
    return "".join(html)


def _until_section(lines: list[str], start: int) -> tuple[list[str], int]:
    for at in range(start, len(lines)):
        if at + 1 < len(lines) and re.fullmatch(r"-{3,}", lines[at + 1].strip()):
            return lines[start:at], at
    return lines[start:], len(lines)


def _definitions(lines: list[str]) -> str:
    """``name : type`` lines with indented descriptions as a list; free text (References, Notes) as blocks."""
    if (lines[:1] and lines[0].startswith(">>>")) or not any(line.startswith(" ") for line in lines):
        return _blocks(lines)
    html = []
    for chunk in re.split(r"\n(?=\S)", "\n".join(lines).strip("\n")):
        head, _, body = chunk.partition("\n")
        name, colon, kind = head.partition(" : ")
        shown = f"<code>{escape(name)}</code>{f' <span>{_inline(kind)}</span>' if colon else ''}"
        html.append(f"<dt>{shown}</dt><dd>{_blocks(inspect.cleandoc(body).splitlines())}</dd>")
    return f"<dl>{''.join(html)}</dl>"


def _blocks(lines: list[str]) -> str:
    """Paragraphs, and as they stand examples and blocks that are indented."""
    html = []
    for block in re.split(r"\n\s*\n", "\n".join(lines).strip("\n")):
        if not block.strip():
            continue
        rows = block.splitlines()
        if rows[0].startswith(">>>") or all(row.startswith("    ") for row in rows):
            html.append(f'<pre tabindex="0">{escape(inspect.cleandoc(block))}</pre>')
        else:
            text = " ".join(row.strip() for row in rows)
            html.append(f"<p>{_inline(text[:-1] if text.endswith('::') else text)}</p>")
    return "".join(html)


def _inline(text: str) -> str:
    return re.sub(r"``(.+?)``|`(.+?)`", lambda m: f"<code>{m[1] or m[2]}</code>", escape(text, quote=False))
