"""What results depend on: one system for the builds of notebooks and for the studies of open choices.

The code of the import closure (a notebook's cells or a study's module, and all that these import anywhere in their text),
the data that this code names, and files given as parameters. A module's code counts, not its wording (`code_digest`). Data
is named by ``paths.data("topic", "folder/file")``: the file, or all of that folder; without a constant name all of the
topic's folder. Of the ledger only the entries count that a notebook claims (`workbook.inputs`).

Unseen remain modules and data whose names are put together at run time: name them in the code that uses them.
"""

import ast
import contextlib
import json
import re
import sys
import sysconfig
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

from workbook import paths
from workbook.checks import InputError
from workbook.publish import digest, replace_file
from workbook.source_digest import code_digest

OWN_RESULTS = ("paper.toml", "published.toml", "choices.toml", "choices.csv")  # what is stated or came out
NAMING = ("data", "measured_times")  # functions whose arguments are a topic and a file
KERNEL = ("ipykernel", "ipython")  # loaded by every kernel

Facts = dict[str, Any]


class Module(NamedTuple):
    """A file of code, what stands in it, and the names that it may import."""

    file: Path
    facts: Facts
    leads: tuple[str, ...]


def dependencies(sources: Iterable[str] = (), modules: Iterable[str] = ()) -> dict[str, str]:
    """Digests of the modules that some code leads to, and of the data that all of it names, by path.

    Parameters
    ----------
    sources : iterable of str
        Python, such as a notebook's cells.
    modules : iterable of str
        Names of modules.
    """
    facts, found = _facts_of_code(sources), closure(sources, modules)
    files = {_shown(each.file): each.facts["code"] for each in found.values()}
    named = {tuple(each) for one in (facts, *(each.facts for each in found.values())) for each in one["data"]}
    for file in (*(file for each in named for file in _data_files(*each)), *_beside(found.values())):
        files[_shown(file)] = file_digest(file)
    return files


def packages(sources: Iterable[str] = (), modules: Iterable[str] = ()) -> set[str]:
    """Names of the installed packages that some code leads to, with all that these require, and those of a kernel."""
    facts, found = _facts_of_code(sources), closure(sources, modules)
    imports = [*facts["imports"], *(each for module in found.values() for each in module.facts["imports"])]
    tops = {name.partition(".")[0] for name, level, *_ in imports if not level}
    tops -= {name.partition(".")[0] for name in found} | sys.stdlib_module_names
    loaded = [*KERNEL, *(package for top in tops for package in _distributions(top))]
    return {each for package in loaded for each in _with_required(normal(package))}


def names_ledger(sources: Iterable[str]) -> bool:
    """Whether some code, or a module of one's own that it leads to, takes entries of the ledger by itself."""
    found = closure(sources)
    own = [each for name, each in found.items() if name.partition(".")[0] != "workbook"]
    return any(
        "load_entries" in one["ledger"] for one in (_facts_of_code(sources), *(each.facts for each in own))
    )


def closure(sources: Iterable[str] = (), modules: Iterable[str] = ()) -> dict[str, Module]:
    """All modules that some code leads to, by name.

    Raises
    ------
    InputError
        When there is no module of a name in `modules`.
    """
    return _closure(tuple(sources), tuple(modules), _roots(paths.root(), tuple(sys.path)))


@cache
def _closure(
    sources: tuple[str, ...], modules: tuple[str, ...], roots: tuple[Path, ...]
) -> dict[str, Module]:
    for name in modules:
        if not _file(name, roots):
            raise InputError(f"there is no module {name!r}; name one that can be imported")
    found: dict[str, Module] = {}
    waiting = [*modules, *_leads_to("", _facts_of_code(sources), roots)]
    while waiting:
        name = waiting.pop()
        if name not in found and (module := _module(name, roots)):
            found[name] = module
            waiting += module.leads
    return found


def look_again() -> None:
    """Forget which files there are: some may have been written or changed since."""
    for known in (_closure, _module, _file, _holding):
        known.cache_clear()


@cache
def _module(name: str, roots: tuple[Path, ...]) -> Module | None:
    if not (file := _file(name, roots)):
        return None
    facts = _facts(file)
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    above = (".".join(name.split(".")[:k]) for k in range(1, name.count(".") + 1))
    return Module(file, facts, tuple(dict.fromkeys([*above, *_leads_to(package, facts, roots)])))


def _leads_to(package: str, facts: Facts, roots: tuple[Path, ...]) -> Iterator[str]:
    """Modules that code in `package` may load by its imports, and by the attributes that it takes of packages."""
    for base, level, name, local in facts["imports"]:
        if level:
            above = package.split(".")[: package.count(".") + 2 - level]
            base = ".".join([*above, *filter(None, [base])])
        yield base
        whole = f"{base}.{name}" if name else base
        yield whole
        yield from _exported(base, name, roots)
        for attribute in facts["attributes"].get(local, ()):
            yield from _exported(whole, attribute, roots)


def _exported(package: str, name: str, roots: tuple[Path, ...]) -> Iterator[str]:
    """Modules from which a package exports a public name at first use: those named beside it in a dictionary."""
    file = _file(package, roots)
    if file and file.name == "__init__.py":
        yield from (
            f"{package}.{text}" for texts in _facts(file)["tables"] if name in texts for text in texts
        )


@cache
def _roots(root: Path, path: tuple[str, ...]) -> tuple[Path, ...]:
    """Folders with code of one's own: the workbook's, and those of Python's path that hold no installed packages."""
    standard = {Path(sysconfig.get_path(name)) for name in ("stdlib", "platstdlib", "purelib", "platlib")}
    places = dict.fromkeys([root / "lib", root, *(Path(each) for each in path if each)])
    kinds = {"site-packages", "dist-packages", "lib-dynload"}
    return tuple(
        each for each in places if each.is_dir() and each not in standard and each.resolve().name not in kinds
    )


@cache
def _file(name: str, roots: tuple[Path, ...]) -> Path | None:
    first = name.partition(".")[0]
    for place in (root.joinpath(*name.split(".")) for root in _holding(first, roots)):
        for file in (place / "__init__.py", place.with_suffix(".py")):
            if file.is_file():
                return file
    return None


@cache
def _holding(first: str, roots: tuple[Path, ...]) -> list[Path]:
    """Folders in which a name of one's own begins: of a thousand names most are those of installed packages."""
    there = [root / first for root in roots if first]
    return [each.parent for each in there if each.is_dir() or each.with_suffix(".py").is_file()]


def _beside(modules: Iterable[Module]) -> Iterator[Path]:
    """Files that are no code, and stand beside a module that names them or their folder."""
    for module in modules:
        for name in module.facts["beside"]:
            place = module.file.parent / name
            for each in place.rglob("*") if place.is_dir() else [place]:
                if each.is_file() and each.suffix not in (".py", ".pyc"):
                    yield each


def _data_files(topic: str, rest: str) -> Iterator[Path]:
    folder = paths.data(topic)
    named = folder / Path(rest).parts[0] if rest else folder
    if named.is_file():
        yield named
        return
    for file in named.rglob("*"):
        path = file.relative_to(folder).as_posix()
        if (
            file.is_file()
            and not file.name.startswith(".")
            and file.suffix != ".md"
            and path not in OWN_RESULTS
        ):
            yield file


def _shown(file: Path) -> str:
    """Path below the workbook's folder, or below the folder of the library."""
    for root in (paths.root(), Path(__file__).parents[2]):
        if file.is_relative_to(root):
            return file.relative_to(root).as_posix()
    return str(file)


_digests: dict[tuple, str] = {}


def file_digest(file: Path) -> str:
    """Digest of a file's bytes, which are read again when its time, size or place on the disk is another."""
    stat = file.stat()
    key = (str(file), stat.st_mtime_ns, stat.st_size, stat.st_ino)
    if key not in _digests:
        _digests[key] = digest(file.read_bytes())
    return _digests[key]


# What stands in a source follows from its bytes, and parsing all sources takes seconds: it is kept by their digest.
_known: dict[str, Facts] = {}
_used: set[str] = set()


def _facts(file: Path) -> Facts:
    return _facts_by(file_digest(file), file.read_bytes)


def _facts_of_code(sources: Iterable[str]) -> Facts:
    source = "\n".join(sources).encode()
    return _facts_by(digest(source), lambda: source)


def _facts_by(key: str, read: Callable[[], bytes]) -> Facts:
    if not _known:
        _known.update(_kept())
    if key not in _known:
        _known[key] = _parsed(read())
    _used.add(key)
    return _known[key]


def _place() -> Path:
    return paths.root() / "build" / f"modules-{file_digest(Path(__file__))[:12]}.json"


def _kept() -> dict[str, Facts]:
    try:
        return json.loads(_place().read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}


def keep_facts() -> None:
    """Write what was parsed, for the next process."""
    if _used - _kept().keys():
        replace_file(_place(), json.dumps({key: _known[key] for key in sorted(_used)}).encode())


def _parsed(source: bytes) -> Facts:
    """The digest of the code; imports, attributes taken of names, tables of names, and what data and files it names."""
    facts: Facts = {"code": code_digest(source), "ledger": ["load_entries"] * (b"load_entries" in source)}
    facts |= {name: [] for name in ("imports", "tables", "data", "beside")} | {"attributes": {}}
    try:
        tree = ast.parse(source)
    except (
        SyntaxError,
        ValueError,
        RecursionError,
        MemoryError,
    ):  # whoever runs it reports what is wrong with it
        return facts
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            facts["imports"] += [[each.name, 0, "", each.asname or each.name] for each in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = node.module or "", node.level
            facts["imports"] += [[*base, each.name, each.asname or each.name] for each in node.names]
        elif isinstance(node, ast.Dict):
            pairs = zip(node.keys, node.values, strict=True)
            facts["tables"] += [[*_texts(key), *_texts(value)] for key, value in pairs if _texts(key)]
        elif isinstance(node, ast.Call):
            facts["data"] += _data_named(node)
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name | ast.Attribute):
            facts["attributes"].setdefault(ast.unparse(node.value), []).append(node.attr)
    if b"__file__" in source:
        facts["beside"] = sorted({text for text in _texts(tree) if re.fullmatch(r"[\w-][\w.-]{1,60}", text)})
    return facts


def _data_named(call: ast.Call) -> list[list[str]]:
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    texts = [each.value if isinstance(each, ast.Constant) else "" for each in call.args[:2]]
    if name in NAMING and texts and isinstance(texts[0], str) and re.fullmatch(r"\w+", texts[0]):
        return [[texts[0], texts[1] if len(texts) > 1 and isinstance(texts[1], str) else ""]]
    return []


def _texts(node) -> list[str]:
    each = ast.walk(node) if node is not None else ()
    return [one.value for one in each if isinstance(one, ast.Constant) and isinstance(one.value, str)]


def normal(name: str) -> str:
    """A package's name as the index compares it."""
    return re.sub(r"[-_.]+", "-", name.strip()).lower()


@cache
def _distributions(top: str) -> list[str]:
    """Installed packages that bring a module: mostly one of its name."""
    try:
        return [metadata.distribution(top).name]
    except metadata.PackageNotFoundError:
        begins = re.compile(rf"^{re.escape(top)}(/|\.py,|\.[\w-]+\.so,)", re.MULTILINE)
        return [
            each.name
            for each in metadata.distributions()
            if top in (each.read_text("top_level.txt") or "").split()
            or begins.search(each.read_text("RECORD") or "")
        ]


@cache
def _with_required(package: str) -> frozenset[str]:
    """An installed package and all that it requires here, without extras."""
    from packaging.requirements import Requirement

    waiting, found = [package], set()
    while waiting:
        if (name := waiting.pop()) in found:
            continue
        found.add(name)
        with contextlib.suppress(metadata.PackageNotFoundError):
            for each in map(Requirement, metadata.requires(name) or ()):
                if not each.marker or each.marker.evaluate({"extra": ""}):
                    waiting.append(normal(each.name))
    return frozenset(found)
