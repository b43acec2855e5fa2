"""The library's reference, read from its source: modules, functions, classes and their docstrings."""

import ast
import inspect
import re
import zlib
from dataclasses import dataclass
from functools import cache
from html import escape, unescape
from itertools import groupby
from pathlib import Path

import griffe

from workbook import paths
from workbook.site.mathematics import equation, mathml

# Each imports those before it.
TOOLBOX = ("base", "signals", "lti", "identification", "estimation", "control", "machine")
LIBRARY = Path(__file__).parents[2]
ARRAY = re.compile(
    r"""\b([A-Z]\w+)\[np\.ndarray, (["']?)([^"'\]]*)\2\]"""
)  # Float64[np.ndarray, "states inputs"]
# Modules of the workbook.
FOR_NOTEBOOKS = ("__init__", "claims", "explorer", "figures", "page", "paths", "studies")


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
    is_class : bool
    """

    name: str
    signature: str
    doc: str
    line: int
    members: tuple["Item", ...] = ()
    is_class: bool = False


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
        """The concept or the topic that it belongs to: ``lti``, ``motion``, or ``workbook``."""
        first, *rest = self.name.split(".")
        return rest[0] if rest and first in ("stillwork", "experiments", "notebooks") else first


@dataclass(frozen=True)
class Folder:
    """A concept or a topic: what it is, its places and public items, and its modules."""

    name: str
    doc: str
    public: tuple[tuple[str, Item], ...]
    modules: tuple[Module, ...]


def folders(modules: list[Module]) -> list[Folder]:
    """The modules by folder, in the order of the layers: the toolbox from the ground up, the workbook, the topics."""
    found = []
    packages = {module.name: module for module in modules}
    wanted = [f"stillwork.{name}" for name in TOOLBOX]
    shared = [f"experiments.{topic}" for topic in paths.topics()]
    for name in [*wanted, "workbook", *shared, *paths.packages()]:
        beside = name.replace("experiments.", "notebooks.")
        mine = [each for each in modules if f"{each.name}.".startswith((f"{name}.", f"{beside}."))]
        if not mine:
            continue
        package = packages.get(name, Module(name, "", "", (), {}))  # a topic's notebooks may share nothing
        names = face_names(ast.parse(package.source))
        by_name = {module.name: module for module in mine}
        public = tuple(
            _handed_out(each, by_name[f"{package.name}.{names[each]}"])
            for each in sorted(names, key=str.lower)
        )
        inner = tuple(module for module in mine if module is not package)
        found.append(Folder(package.folder, package.doc, public, inner))
    return found


def face_names(tree: ast.Module) -> dict[str, str]:
    """The public names of a package, with the module that defines each."""
    for statement in tree.body:
        match statement:
            case ast.Assign(value=ast.Call(func=ast.Name(id="lazy_exports"), args=[_, by_module])):
                return {
                    name: module for module, names in ast.literal_eval(by_module).items() for name in names
                }
            case ast.Assign(targets=[ast.Name(id="_MODULES")], value=ast.Dict() as by_name):
                return ast.literal_eval(by_name)
    return {}


def _handed_out(name: str, module: Module) -> tuple[str, Item]:
    """A public name with its place; of a constant the page shows the line."""
    for item in module.items:
        if item.name == name:
            return f"{module.name}.html#{name}", item
    line = module.constants[name]
    return f"{module.name}.html#line-{line}", Item(name, name, "", line)


def library_files() -> list[Path]:
    """Files of the toolbox, and of what notebooks use of the engine; none where they are installed from a wheel.

    Left out are what builds the notebooks, the command line and the site.
    """
    if not (paths.root() / "lib" / "stillwork").is_dir():
        return []
    files = [file for file in (LIBRARY / "stillwork").rglob("*.py") if file.name != "__main__.py"]
    return sorted([*files, *(LIBRARY / "workbook" / f"{name}.py" for name in FOR_NOTEBOOKS)])


def read_modules() -> list[Module]:
    """The toolbox's and the workbook's modules, and those of each topic: what its notebooks share, then what each has alone."""
    files = [file for file in library_files() if file != LIBRARY / "stillwork" / "__init__.py"]
    for topic in paths.topics():
        files += sorted((LIBRARY / "experiments" / topic).rglob("*.py"))
        files += sorted((paths.root() / "notebooks" / topic).glob("*.py"))
    for name in paths.packages():
        files += sorted((paths.root() / name).glob("*.py"))
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


def inventory(modules: list[Module], project: str, version: str) -> bytes:
    """``objects.inv``, by which other projects' documentation links to names of these pages (Sphinx inventory, version 2)."""
    lines = []
    for module in modules:
        page = f"reference/{module.name}.html"
        lines.append(f"{module.name} py:module 0 {page} -")
        lines += [
            f"{module.name}.{name} py:data 1 {page}#line-{line} -" for name, line in module.constants.items()
        ]
        waiting = list(module.items)
        while waiting:
            item = waiting.pop(0)
            owned = "method" if "(" in item.signature else "attribute"
            role = owned if "." in item.name else "class" if item.is_class else "function"
            lines.append(f"{module.name}.{item.name} py:{role} 1 {page}#{item.name} -")
            waiting += item.members
    head = f"# Sphinx inventory version 2\n# Project: {project}\n# Version: {version}\n"
    head += "# The remainder of this file is compressed using zlib.\n"
    return head.encode() + zlib.compress("".join(f"{line}\n" for line in lines).encode(), 9)


def _module(file: Path) -> Module:
    place = LIBRARY if file.is_relative_to(LIBRARY) else paths.root()
    parts = file.relative_to(place).with_suffix("").parts
    name = ".".join(part for part in parts if part != "__init__")
    return read_source(name, file, file.read_text(encoding="utf-8"))


@cache
def read_source(name: str, file: Path, source: str) -> Module:
    """A module by its text, read once."""
    read = griffe.visit(name, filepath=file, code=source)
    constants = {each.name: each.lineno or 1 for each in _public(read) if each.is_attribute}
    return Module(name, _text(read), source, _items(read), constants)


def _public(read: griffe.Module | griffe.Class) -> list[griffe.Object]:
    """What is defined there, without what is imported and what a leading underscore hides."""
    return [each for name, each in read.members.items() if not each.is_alias and not name.startswith("_")]


def _items(read: griffe.Module | griffe.Class, owner: str = "") -> tuple[Item, ...]:
    items = []
    for each in _public(read):
        if not each.is_attribute or "property" in each.labels:
            name = f"{owner}{each.name}"
            members = _items(each, f"{name}.") if each.is_class else ()
            line = each.lineno or 1
            items.append(Item(name, _signature(each), _text(each), line, members, each.is_class))
    return tuple(items)


def _text(read: griffe.Object) -> str:
    return read.docstring.value if read.docstring else ""


def _signature(read: griffe.Object) -> str:
    """As Python would print it: without `self`, for a class its annotated fields, and of arrays their shapes."""
    return ARRAY.sub(_shape, _as_written(read))


def _shape(annotated: re.Match) -> str:
    """Of an array's annotation what a reader needs: whole or complex numbers, and the shape."""
    kind = next((word for word in ("complex", "int", "bool") if annotated[1].lower().startswith(word)), "")
    sizes = annotated[3].split()
    return f"{kind} ({', '.join(sizes)}{',' * (len(sizes) == 1)})".strip()


def _as_written(read: griffe.Object) -> str:
    if read.is_class:
        fields = [
            f"{each.name}: {each.annotation}" + (f" = {each.value}" if each.value is not None else "")
            for each in _public(read)
            if each.is_attribute and each.annotation is not None and "property" not in each.labels
        ]
        return f"{read.name}({', '.join(fields)})"
    if read.is_attribute:
        return read.name + (f" -> {read.annotation}" if read.annotation else "")
    shown = read.signature()
    return re.sub(r"\((?:self|cls)(?:, )?", "(", shown, count=1) if read.parent.is_class else shown


@cache
def doc_html(doc: str, level: int = 2) -> str:
    """HTML of a numpydoc docstring: paragraphs, indented blocks and sections of definitions, headed at a level."""
    html = []

    def head(title: str) -> None:
        html.append(f'<h{level} class="part">{escape(title)}</h{level}>')

    for section in griffe.Docstring(inspect.cleandoc(doc)).parse("numpy", warnings=False):
        kind, value = section.kind.value, section.value
        if kind == "text":
            html.append(_blocks(value))
        elif kind == "examples":
            blocks = (
                f'<pre tabindex="0">{escape(text)}</pre>' if part.value == "examples" else _blocks(text)
                for part, text in value
            )
            head("Examples")
            html.append("".join(blocks))
        elif kind == "admonition":
            head(section.title)
            html.append(_blocks(value.contents))
        else:
            head(kind.capitalize())
            groups = groupby(value, key=lambda each: (str(each.annotation or ""), each.description))
            html.append(f"<dl>{''.join(_definition(list(some), *said) for said, some in groups)}</dl>")
    return "".join(html)


def _definition(elements: list, kind: str, description: str) -> str:
    """Names with their type, and what is said about them; a result has the type alone."""
    names = ", ".join(filter(None, (getattr(each, "name", "") for each in elements)))
    shown = f"<code>{escape(names or kind)}</code>"
    if names and kind:
        shown += f" <span>{_inline(kind)}</span>"
    return f"<dt>{shown}</dt><dd>{_blocks(description)}</dd>"


def _blocks(text: str) -> str:
    """Paragraphs, and as they stand blocks that are indented."""
    html = []
    for block in re.split(r"\n\s*\n", text.strip("\n")):
        if not block.strip():
            continue
        rows = block.splitlines()
        if rows[0].startswith(">>>") or all(row.startswith("    ") for row in rows):
            html.append(f'<pre tabindex="0">{escape(inspect.cleandoc(block))}</pre>')
        elif rows[0].startswith(".. math::"):
            html.append(equation(block.strip().removeprefix(".. math::")))
        else:
            text = " ".join(row.strip() for row in rows)
            html.append(f"<p>{_inline(text[:-1] if text.endswith('::') else text)}</p>")
    return "".join(html)


def _inline(text: str) -> str:
    """A docstring's words as HTML: its names as code, its formulas as MathML."""
    return re.sub(
        r":math:`(.+?)`|``(.+?)``|`(.+?)`",
        lambda m: mathml(unescape(m[1])) if m[1] else f"<code>{m[2] or m[3]}</code>",
        escape(text, quote=False),
    )
