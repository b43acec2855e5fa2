"""The rules of the house, held against the imports of the library and the notebooks."""

import ast
import importlib
import json
import re

import pytest

from stillwork.base import paths
from stillwork.site.house import TOOLBOX, arrows, face_names, folder, imports, modules

ORDER = (*TOOLBOX, "workbook", "site")
ABOVE = len(ORDER)  # the command line, then the rooms, then the notebooks
PICTURE = (paths.root() / "docs" / "house.svg").read_text(encoding="utf-8")
PAINTS = re.compile("^(paint|explore)_|_(painter|explorer)$")  # the last give a function that paints
GUIDE = (paths.root() / "CONTRIBUTING.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def trees():
    return modules(paths.root())


@pytest.fixture(scope="module")
def imported(trees):
    return imports(trees)


def floor(module):
    """How high a module stands; the package's own ``__init__`` is the ground."""
    first, *rest = module.split(".")
    if first == "stillwork":
        return ORDER.index(rest[0]) if rest and rest[0] in ORDER else ABOVE if rest else -1
    return ABOVE + 1 + (first == "notebooks")


def rising(imported):
    return [(a, b) for a, others in imported.items() for b in others if floor(b) > floor(a)]


def circles(imported):
    """Modules that import themselves by way of others: those left when what imports nothing left is taken away."""
    left = {module: set(others) for module, others in imported.items()}
    while done := {module for module, others in left.items() if not others & left.keys()}:
        left = {module: others for module, others in left.items() if module not in done}
    return set(left)


LOADERS = {"stillwork.base.faces", "stillwork.base.extras"}  # import what they are told by name


def hidden(trees):
    """Modules that import in a way that the rules do not read: relatively, or in the toolbox by a text."""
    for module, tree in trees.items():
        calls = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
        calls |= {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
        by_text = (
            module.startswith("stillwork.") and module.split(".")[1] in TOOLBOX and module not in LOADERS
        )
        if any(isinstance(node, ast.ImportFrom) and node.level for node in ast.walk(tree)):
            yield module
        elif by_text and calls & {"import_module", "__import__"}:
            yield module


def between_rooms(imported):
    """A room or a notebook with the other room that it imports."""
    rooms = {
        module: module.split(".")[1]
        for module in imported
        if module.startswith(("experiments.", "notebooks."))
    }
    return [(a, b) for a in rooms for b in imported[a] if b in rooms and rooms[a] != rooms[b]]


def placed(imported):
    """Modules of the toolbox that ask where the workbook stands: the ledger and what a paper printed lie there."""
    above_base = {f"stillwork.{name}" for name in TOOLBOX if name != "base"}
    return [
        module
        for module, others in imported.items()
        if folder(module) in above_base and "stillwork.base.paths" in others
    ]


def reached(start, below):
    found, new = set(), {start}
    while new:
        found |= new
        new = {other for each in new for other in below.get(each, ())} - found
    return found


def mentions(statement, named):
    for node in ast.walk(statement):
        match node:
            case ast.Name(id=name) if name in named:
                yield named[name]
            case ast.Attribute(value=ast.Name(id=name), attr=part) if name in named:
                yield f"{named[name]}.{part}"


def uses(module, trees):
    """Each name that a module binds at its top, with the names that its statement uses; of a notebook, all of them."""
    tree, named = trees[module], {}
    bound = {module: tree} if module.startswith("notebooks.") else {}
    for statement in tree.body:
        match statement:
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                named[name] = f"{module}.{name}"
            case ast.Assign(targets=[ast.Name(id=name)]) | ast.AnnAssign(target=ast.Name(id=name)):
                named[name] = f"{module}.{name}"
            case _:
                continue
        bound[named[name]] = statement
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module in trees:
            face = face_names(trees[node.module])
            for alias in node.names:
                home = ".".join([node.module, *filter(None, [face.get(alias.name)])])
                named[alias.asname or alias.name] = f"{home}.{alias.name}"
    return {name: set(mentions(statement, named)) for name, statement in bound.items()}


def idle_pictures(trees, imported):
    """A notebook with a module that paints, which it imports in some way, but of which it uses no picture."""
    below = {name: others for module in trees for name, others in uses(module, trees).items()}
    pictures = {
        module: {
            f"{module}.{node.name}"
            for node in tree.body
            if isinstance(node, ast.FunctionDef) and PAINTS.search(node.name)
        }
        for module, tree in trees.items()
        if module.startswith("experiments.")
    }
    return [
        (notebook, module)
        for notebook in trees
        if notebook.startswith("notebooks.")
        for module in reached(notebook, imported)
        if pictures.get(module) and not pictures[module] & reached(notebook, below)
    ]


@pytest.mark.slow
def test_every_folder_has_its_place(trees):
    folders = {file.name for file in (paths.root() / "lib" / "stillwork").iterdir() if file.is_dir()}
    assert folders - {"__pycache__"} == set(ORDER)
    rooms = {name.split(".")[1] for name in trees if name.startswith(("experiments.", "notebooks."))}
    assert rooms <= set(paths.rooms())


@pytest.mark.slow
def test_no_arrow_runs_up(imported):
    assert rising(imported) == []


@pytest.mark.slow
def test_imports_are_where_the_rules_read_them(trees):
    assert list(hidden(trees)) == []


@pytest.mark.slow
def test_nothing_runs_in_a_circle(imported):
    assert circles(imported) == set()
    folders = {}
    for module, others in imported.items():
        own = folder(module)
        if own in ("stillwork.", "stillwork.__main__"):
            continue
        folders.setdefault(own, set()).update(folder(other) for other in others if "." in other)
    assert circles({name: others - {name} for name, others in folders.items()}) == set()


@pytest.mark.slow
def test_the_workbook_knows_no_physics(imported):
    seen = {
        folder(other)
        for module, others in imported.items()
        if folder(module) in ("stillwork.workbook", "stillwork.site")
        for other in others
    }
    assert not seen & {f"stillwork.{name}" for name in TOOLBOX if name != "base"}


@pytest.mark.slow
def test_a_room_imports_no_other_room_and_nothing_of_the_site(imported):
    assert between_rooms(imported) == []
    below = [module for module in imported if module.startswith(("experiments.", "notebooks."))]
    assert not [(a, b) for a in below for b in imported[a] if folder(b) == "stillwork.site"]


@pytest.mark.slow
def test_an_edit_of_a_picture_makes_only_its_own_notebooks_stale(trees, imported):
    assert idle_pictures(trees, imported) == []


@pytest.mark.slow
def test_the_toolbox_reads_no_ledger_and_no_work(imported):
    assert placed(imported) == []


def test_every_notebook_writes_its_model_out():
    silent = []
    files = sorted(paths.root().glob("notebooks/*/*.ipynb"))
    for file in files:
        cells = json.loads(file.read_text(encoding="utf-8"))["cells"]
        if not any("$$" in "".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown"):
            silent.append(file.stem)
    assert len(files) > 50 and silent == []


# Where calling costs more than 3 % of the kernel's time, measured best of many; the extended filter up to 30, the
# robust filter's Riccati step, compiled for its sizes, 70, the filters along a record up to 17, the min-max estimators
# up to 13, a window's sum, which rides on the shift of its buffer, up to 97.
# Three are no call of the algebra: each partial sum is used (`update_inverse_qr`), the sum runs on, with the gains
# backwards (`command_step`), or four of them run side by side (`_step_decoupled`).
WRITTEN_OUT = {
    ("experiments.isolation.loop", "advance"),
    ("experiments.isolation.stability", "_multiply"),
    ("experiments.motion.observer_contest.parametric", "propagate"),
    ("stillwork.control.fixed_point", "command_step"),
    ("stillwork.estimation.covariance_forms", "update_inverse_qr"),
    ("stillwork.estimation.covariance_forms", "update_square_root"),
    ("stillwork.estimation.extended", "correct_extended"),
    ("stillwork.estimation.extended", "predict_extended"),
    ("stillwork.estimation.gaussian", "correct_gaussian"),
    ("stillwork.estimation.recursive_kernels", "_exact_solution"),
    ("stillwork.estimation.recursive_kernels", "_squared_norms"),
    ("stillwork.estimation.recursive_kernels", "run_min_max"),
    ("stillwork.estimation.robust", "recursion"),
    ("stillwork.estimation.time_varying", "_estimate"),
    ("stillwork.estimation.windows", "_slide"),
    ("stillwork.lti.simulation", "_step_decoupled"),
}


def sums_of_products(tree):
    """Functions of a module, compiled by numba, with a loop that adds up products along its index, whatever else it does."""
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef):
            continue
        if not any("kernel" in ast.unparse(each) for each in function.decorator_list):
            continue
        sums = [
            (node.target.id, statement)
            for node in ast.walk(function)
            if isinstance(node, ast.For) and isinstance(node.target, ast.Name)
            for statement in node.body
        ]
        if any(sums_along(index, statement) for index, statement in sums):
            yield function.name


def sums_along(index, statement):
    """Whether a statement adds the product of two elements at the index to what does not stand at it."""
    match statement:
        case ast.AugAssign(
            target=total,
            op=ast.Add() | ast.Sub(),
            value=ast.BinOp(left=ast.Subscript() as left, op=ast.Mult(), right=ast.Subscript() as right),
        ):
            along = [
                any(isinstance(node, ast.Name) and node.id == index for node in ast.walk(each))
                for each in (left, right, total)
            ]
            return along == [True, True, False]
    return False


def counted(trees):
    """A kernel that counts no references, with one that it calls and that does: numba compiles that as its caller."""
    kinds, named = {}, {}
    for module, tree in trees.items():
        for node in tree.body:
            if isinstance(node, ast.FunctionDef):
                for decorator in map(ast.unparse, node.decorator_list):
                    if decorator.endswith("kernel"):
                        kinds[module, node.name] = decorator, node
            if isinstance(node, ast.ImportFrom):
                for each in node.names:
                    named[module, each.asname or each.name] = node.module, each.name
    for (module, name), (kind, node) in kinds.items():
        if kind in ("borrowing_kernel", "pasted_kernel"):
            for call in ast.walk(node):
                if isinstance(call, ast.Call) and isinstance(call.func, ast.Name):
                    called = named.get((module, call.func.id), (module, call.func.id))
                    if kinds.get(called, [""])[0] == "kernel":
                        yield (module, name), called


def written(**sources):
    return {name.replace("__", "."): ast.parse(source) for name, source in sources.items()}


def test_the_rules_find_what_breaks_them():
    broken = imports(
        written(
            stillwork="",
            stillwork__lti="from stillwork.base.faces import face\nall = face(__name__, {'zoh': ('hold',)})",
            stillwork__lti__zoh="def hold():\n    from stillwork.signals import spectra",
            stillwork__signals="",
            stillwork__signals__spectra="from stillwork.lti import hold",
            experiments__motion__rig="import experiments.isolation.twin",
            experiments__isolation__twin="",
            stillwork__base="",
            stillwork__base__paths="",
            stillwork__lti__a="from stillwork.base.paths import data",
            stillwork__lti__b="from stillwork.base import paths",
            stillwork__lti__c="def read():\n    import stillwork.base.paths as places",
            stillwork__site__d="from stillwork.base.paths import data",
        )
    )
    assert ("stillwork.signals.spectra", "stillwork.lti.zoh") in rising(broken)
    assert {"stillwork.signals.spectra", "stillwork.lti.zoh"} <= circles(broken)
    assert between_rooms(broken) == [("experiments.motion.rig", "experiments.isolation.twin")]
    assert placed(broken) == ["stillwork.lti.a", "stillwork.lti.b", "stillwork.lti.c"]


@pytest.mark.slow
def test_a_kernel_calls_its_sums_of_products(trees):
    found = {(module, name) for module, tree in trees.items() for name in sums_of_products(tree)}
    assert {each for each in found if each[0] != "stillwork.base.algebra"} == WRITTEN_OUT


@pytest.mark.slow
def test_what_counts_no_references_calls_nothing_that_does(trees):
    """It would fail to compile where that makes an array and has not been compiled for another caller before."""
    assert list(counted(trees)) == []


def test_a_call_of_what_counts_references_is_found():
    sources = {
        "stillwork__a": "@kernel\ndef make():\n    return np.zeros(3)\n@pasted_kernel\ndef add():\n    pass",
        "stillwork__b": "from stillwork.a import add, make\n@borrowing_kernel\ndef both():\n    add()\n    make()",
    }
    assert list(counted(written(**sources))) == [(("stillwork.b", "both"), ("stillwork.a", "make"))]


def test_a_sum_of_products_that_is_written_out_is_found():
    loop = "    for i in range(3):\n        {}\n"
    lines = (
        "total += a[i] * b[i, 0]",
        "total -= a[j, i] * x[i]",
        "x[i] += a[i] * b[i]",
        "total += a[i] * 2.0",
        "x[i] = b[i]; total += x[i] * x[i]",
        "x[i] = b[i]; x[i] += x[i] * b[i]",
    )
    source = "".join(f"@kernel\ndef f{n}():\n" + loop.format(line) for n, line in enumerate(lines))
    assert list(sums_of_products(ast.parse(source))) == ["f0", "f1", "f4"]
    assert list(sums_of_products(ast.parse(source.replace("@kernel", "@cache")))) == []


def test_an_import_that_the_rules_would_not_see_is_found():
    sources = {
        "stillwork__lti__a": "from ..control.pid import Pid",
        "stillwork__lti__b": "import importlib\nimportlib.import_module('stillwork.control.pid')",
        "stillwork__base__faces": "from importlib import import_module\nimport_module('x')",
    }
    assert list(hidden(written(**sources))) == ["stillwork.lti.a", "stillwork.lti.b"]


def test_a_picture_that_is_only_imported_is_found():
    sources = {
        "experiments__a": "COLOUR = 1\ndef paint_a():\n    pass",
        "experiments__b": "from experiments import a\ndef paint_b():\n    pass\ndef paint_c():\n    a.paint_a()",
        "experiments": "",
        "notebooks__room__one": "from experiments.b import paint_b\npaint_b()",
        "notebooks__room__two": "from experiments import b as draw\ndraw.paint_c()",
        "notebooks__room__three": "from experiments.a import COLOUR\nCOLOUR",
    }
    trees = written(**sources)
    wanted = [("notebooks.room.one", "experiments.a"), ("notebooks.room.three", "experiments.a")]
    assert idle_pictures(trees, imports(trees)) == wanted


def test_an_arrow_that_follows_from_others_is_not_drawn():
    chain = {
        "experiments.motion": {"stillwork.control.pid", "stillwork.lti.zoh"},
        "stillwork.control.pid": {"stillwork.lti.zoh", "stillwork.base.checks"},
        "stillwork.lti.zoh": {"stillwork.base.checks"},
        "stillwork.base.checks": set(),
    }
    assert arrows(chain) == [
        ("stillwork.lti", "stillwork.base"),
        ("stillwork.control", "stillwork.lti"),
        ("experiments", "stillwork.control"),
    ]


def test_every_arrow_of_the_picture_leads_down():
    ends = re.findall(r'<line x1="\d+" y1="(\d+)" x2="\d+" y2="(\d+)"', PICTURE)
    assert len(ends) > 8
    assert all(int(start) < int(end) for start, end in ends)


def test_the_examples_of_where_a_line_lives_are_where_they_live():
    examples = re.findall(
        r"^\| `(.+?)` \| `([a-z].+?)` \|", GUIDE.partition("does this line live")[2], re.MULTILINE
    )
    assert len(examples) == 10
    for line, file in examples:
        assert line in (paths.root() / file).read_text(encoding="utf-8"), f"`{line}` is not in {file}"


def test_files_that_the_texts_name_exist():
    texts = [
        GUIDE,
        *((paths.root() / name).read_text(encoding="utf-8") for name in ("README.md", "docs/your-rig.md")),
    ]
    named = {
        name
        for text in texts
        for name in re.findall(r"`((?:lib|docs|tests|data|benchmarks)/[\w./-]+)`", text)
    }
    assert len(named) > 5
    assert not [name for name in named if not (paths.root() / name).exists()]


def broken_imports(source: str) -> list[str]:
    """Names that a script wants from the library and that are not there."""
    wanted = [
        (node.module, alias.name)
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.ImportFrom)
        and (node.module or "").split(".")[0] in ("stillwork", "experiments")
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
    assert broken_imports("from experiments.isolation.your_floor import open_floor") == [
        "experiments.isolation.your_floor.open_floor"
    ]
