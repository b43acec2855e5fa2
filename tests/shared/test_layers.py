"""The layers: which folder imports which, compared with the imports of the library and the notebooks."""

import ast
import importlib
import re

import pytest

from layering import folder, imports, modules
from workbook import paths
from workbook.site.reference import TOOLBOX
from workbook.source_digest import code

ORDER = (*TOOLBOX, "workbook", "workbook.site")
ABOVE = len(ORDER)  # the command line, then what stands outside the package
OUTSIDE = ("experiments", "contest", "notebooks")


@pytest.fixture(scope="module")
def trees():
    return modules(paths.root())


@pytest.fixture(scope="module")
def imported(trees):
    return imports(trees)


def floor(module):
    """How high a module stands; the package's own ``__init__`` is the ground."""
    first, *rest = module.split(".")
    if first == "workbook":
        return ORDER.index(folder(module)) if rest not in (["__main__"], ["commands"]) else ABOVE
    if first == "stillwork":
        return ORDER.index(rest[0]) if rest and rest[0] in ORDER else ABOVE if rest else -1
    return ABOVE + 1 + OUTSIDE.index(first)


def rising(imported):
    return [(a, b) for a, others in imported.items() for b in others if floor(b) > floor(a)]


def circles(imported):
    """Modules that import themselves by way of others: those left when what imports nothing left is taken away."""
    left = {module: set(others) for module, others in imported.items()}
    while done := {module for module, others in left.items() if not others & left.keys()}:
        left = {module: others for module, others in left.items() if module not in done}
    return set(left)


def between_topics(imported):
    """A topic or a notebook with the other topic that it imports."""
    topics = {
        module: module.split(".")[1]
        for module in imported
        if module.startswith(("experiments.", "notebooks."))
    }
    return [(a, b) for a in topics for b in imported[a] if b in topics and topics[a] != topics[b]]


def foreign(imported):
    """What imports the module beside a notebook without being that notebook."""
    return [
        (a, b)
        for a, others in imported.items()
        for b in others
        if b.startswith("notebooks.") and re.sub(r"\.\d+-", ".", a).replace("-", "_") != b
    ]


@pytest.mark.slow
def test_no_arrow_runs_up(imported):
    assert rising(imported) == []


@pytest.mark.slow
def test_nothing_runs_in_a_circle(imported):
    assert circles(imported) == set()
    folders = {}
    for module, others in imported.items():
        own = folder(module)
        if own in ("stillwork.", "stillwork.__main__") or module == "workbook.commands":
            continue
        folders.setdefault(own, set()).update(folder(other) for other in others if "." in other)
    assert circles({name: others - {name} for name, others in folders.items()}) == set()


@pytest.mark.slow
def test_toolbox_and_engine_import_nothing_of_each_other(imported):
    packages = {"stillwork": set(), "workbook": set()}
    for module, others in imported.items():
        packages.get(module.partition(".")[0], set()).update(other.partition(".")[0] for other in others)
    assert packages == {"stillwork": {"stillwork"}, "workbook": {"workbook"}}


@pytest.mark.slow
def test_the_engine_names_no_topic():
    """But in examples, which docstrings give, and where its own word is the same: the minutes of ``choices --budget``."""
    topics = re.compile(rf"\b({'|'.join(set(paths.topics()) - {'budget'})})\b")
    places = {}
    for file in sorted((paths.root() / "lib" / "workbook").rglob("*")):
        if file.suffix == ".py":
            texts = [
                each.value for each in ast.walk(code(file.read_bytes())) if isinstance(each, ast.Constant)
            ]
            places[file] = " ".join(each for each in texts if isinstance(each, str))
        elif file.suffix in (".toml", ".html", ".js", ".css", ".env"):
            places[file] = file.read_text(encoding="utf-8")
    assert len(places) > 60
    assert [
        file.name
        for file, text in places.items()
        if topics.search(text.replace("prefers-reduced-motion", ""))
    ] == []


@pytest.mark.slow
def test_a_topic_imports_no_other_topic_and_nothing_of_the_site(imported):
    assert between_topics(imported) == []
    below = [module for module in imported if module.startswith(("experiments.", "notebooks."))]
    assert not [(a, b) for a in below for b in imported[a] if folder(b) == "workbook.site"]


@pytest.mark.slow
def test_what_stands_beside_a_notebook_is_its_own(imported):
    assert foreign(imported) == []


def broken_imports(source: str) -> list[str]:
    """Names that a script wants from the library and that are not there."""
    wanted = [
        (node.module, alias.name)
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.ImportFrom)
        and (node.module or "").split(".")[0]
        in ("stillwork", "workbook", "experiments", "contest", "notebooks")
        for alias in node.names
    ]
    missing = []
    for module, name in wanted:
        if not hasattr(importlib.import_module(module), name):
            try:
                importlib.import_module(f"{module}.{name}")
            except ModuleNotFoundError:
                missing.append(f"{module}.{name}")
    return missing


def test_what_the_benchmarks_import_exists():
    for file in sorted((paths.root() / "benchmarks").rglob("*.py")):
        assert not broken_imports(file.read_text(encoding="utf-8")), file.name
    assert broken_imports("from notebooks.isolation.your_floor import close_floor") == [
        "notebooks.isolation.your_floor.close_floor"
    ]
