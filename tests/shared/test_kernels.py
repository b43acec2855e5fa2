import ast
import fcntl
import importlib.util
import os
import random
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from pathlib import Path

import numba
import numpy as np
import pytest

import stillwork
from layering import modules
from stillwork.base import kernel_cache
from stillwork.base.kernel_folder import cache_folder
from stillwork.base.kernels import callback
from workbook import paths

CALLED = """
from stillwork.base.kernels import inlined_kernel

@inlined_kernel
def _twice(x):
    return {factor} * x
"""
CALLER = """
from stillwork.called import _twice
from stillwork.base.kernels import kernel

@kernel
def _use(x):
    return _twice(x) + 1
"""
RUN = """
from stillwork.caller import _use
print(flush=True)
input()
print(_use(10.0), sum(_use.stats.cache_misses.values()))
"""
ALONE = """
from stillwork.base.kernels import kernel

@kernel
def _inner(x):
    return 2 * x

@kernel
def _outer(x):
    return _inner(x) + 1
"""


def start(root: Path, **environment) -> subprocess.Popen:
    """A process that has imported the kernels of the workbook at `root` and waits for a line to call them."""
    environment = {"PYTHONPATH": str(root / "lib"), "STILLWORK_ROOT": str(root), "PATH": ""} | environment
    process = subprocess.Popen(
        [sys.executable, "-c", RUN], env=environment, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    process.stdout.readline()
    return process


def run(*arguments, **environment) -> list[float]:
    """The kernel's value and how often it was compiled."""
    return finish(start(*arguments, **environment))


def finish(process: subprocess.Popen) -> list[float]:
    said, _ = process.communicate("\n")
    return [float(word) for word in said.split()]


@pytest.fixture
def workbook(tmp_path) -> Path:
    """A workbook of two kernels, one of which calls the other."""
    root = tmp_path / "workbook"
    package = root / "lib" / "stillwork"
    (package / "base").mkdir(parents=True)
    (root / "data").mkdir()
    needed = ("checks", "garbage", "kernel_cache", "kernel_folder", "kernels", "source_digest")
    for name in ("__init__", *needed):
        shutil.copy(Path(stillwork.__file__).parent / "base" / f"{name}.py", package / "base")
    shutil.copy(Path(stillwork.__file__), package)
    (package / "caller.py").write_text(CALLER)
    (package / "called.py").write_text(CALLED.format(factor=2))
    return root


@pytest.fixture
def fresh(tmp_path, monkeypatch):
    """Gives the two kernels of `ALONE`, at every call as another process would import them; in an own cache."""
    monkeypatch.setenv("STILLWORK_KERNELS", str(tmp_path / "kernels"))
    file = tmp_path / "alone.py"
    file.write_text(ALONE)

    def load():
        spec = importlib.util.spec_from_file_location("alone", file)
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, "alone", module)
        spec.loader.exec_module(module)
        return module._inner, module._outer

    return load


def misses(kernel) -> int:
    return sum(kernel.stats.cache_misses.values())


def is_free(lock: Path) -> bool:
    with lock.open("ab") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
    return True


@pytest.mark.slow
def test_a_copy_of_the_workbook_at_another_time_and_place_compiles_what_changed_alone(workbook, tmp_path):
    assert run(workbook) == [21, 1]
    copy = shutil.copytree(
        workbook, tmp_path / "elsewhere" / "copy", ignore=shutil.ignore_patterns("__pycache__")
    )
    for file in copy.rglob("*.py"):
        os.utime(file, (1e9, 1e9))
    shutil.rmtree(workbook)
    assert run(copy) == [21, 0]
    (copy / "lib" / "stillwork" / "called.py").write_text(CALLED.format(factor=3))  # which the kernel calls
    assert run(copy) == [31, 1]


@pytest.mark.slow
def test_of_two_processes_that_start_cold_one_compiles(workbook):
    both = [start(workbook), start(workbook)]
    for process in both:
        process.stdin.write("\n")
        process.stdin.flush()
    assert sorted(finish(process) for process in both) == [[21, 0], [21, 1]]


@pytest.mark.slow
def test_the_folders_that_the_environment_names_are_obeyed(workbook, tmp_path):
    for variable in ("STILLWORK_KERNELS", "NUMBA_CACHE_DIR"):
        own = tmp_path / variable
        assert run(workbook, **{variable: str(own)}) == [21, 1]
        assert run(workbook, **{variable: str(own)}) == [21, 0]
        assert list(own.rglob("*.nbc"))
    assert not (workbook / "build").exists()


# The user's own places for machine code, numba's rule for them, and one where nothing of the workbook's can be written.
PLACES = (
    {"NUMBA_CACHE_DIR": "{own}"},
    {"NUMBA_CACHE_LOCATOR_CLASSES": "InTreeCacheLocator"},
    {"STILLWORK_ROOT": "{own}", "NUMBA_CACHE_DIR": ""},
)


@pytest.mark.slow
@pytest.mark.parametrize("place", PLACES)
def test_a_change_of_a_called_kernel_is_seen_wherever_machine_code_is_kept(workbook, tmp_path, place):
    own = {name: value.format(own=tmp_path / "own") for name, value in place.items()}
    called = workbook / "lib" / "stillwork" / "called.py"
    for factor, value in ((2, 21), (3, 31), (2, 21)):
        called.write_text(CALLED.format(factor=factor))
        assert run(workbook, **own)[0] == value
    assert run(workbook, **own) == [21, 0]


def test_the_cache_folder_is_the_one_that_the_driver_gives(monkeypatch):
    monkeypatch.setenv("STILLWORK_KERNELS", "/given")
    assert cache_folder() == "/given"


def test_folders_of_other_digests_go_after_a_week_without_use(workbook):
    every = workbook / "build" / "kernels"
    day = 24 * 3600
    for name, age in {"0" * 16: 8, "1" * 16: 8, "2" * 16: 6, "own": 30}.items():
        (every / name / "topic").mkdir(parents=True)
        os.utime(every / name, (time.time() - age * day,) * 2)
    ask = "from stillwork.base.kernel_folder import cache_folder; print(cache_folder()); input()"
    environment = {"PYTHONPATH": str(workbook / "lib"), "STILLWORK_ROOT": str(workbook), "PATH": ""}

    def asked() -> subprocess.Popen:
        return subprocess.Popen(
            [sys.executable, "-c", ask],
            env=environment,
            text=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )

    first = asked()
    used = Path(first.stdout.readline().strip())
    folders = {folder.name for folder in every.iterdir() if folder.is_dir()}
    assert folders == {used.name, "2" * 16, "own"}

    os.utime(used, (1e9, 1e9))  # as after a long session, which has it in use
    (workbook / "lib" / "stillwork" / "called.py").write_text(CALLED.format(factor=3))
    asked().communicate("\n")
    assert used.exists()
    first.communicate("\n")
    (workbook / "lib" / "stillwork" / "called.py").write_text(CALLED.format(factor=4))
    asked().communicate("\n")
    assert not used.exists()


def test_kernels_beside_a_notebook_are_part_of_the_digest(workbook):
    ask = "from stillwork.base.kernel_folder import kernels_digest; print(kernels_digest())"
    environment = {"PYTHONPATH": str(workbook / "lib"), "STILLWORK_ROOT": str(workbook), "PATH": ""}
    own, found = workbook / "notebooks" / "motion" / "own.py", []
    own.parent.mkdir(parents=True)
    for text in ("", CALLED.format(factor=2), CALLED.format(factor=2) + "# why", CALLED.format(factor=3)):
        own.write_text(text)
        found.append(subprocess.check_output([sys.executable, "-c", ask], env=environment))
    assert found[1] == found[2] and len(set(found)) == 3


@pytest.mark.slow
def test_a_comment_in_a_file_of_kernels_compiles_that_file_alone(workbook):
    """Its own kernels, whose machine code numba keys by the file; not those that call them."""
    assert run(workbook) == [21, 1]
    folders = _kernel_folders(workbook)
    package = workbook / "lib" / "stillwork"
    called = package / "called.py"
    called.write_text(f"# Why, in a comment.\n{called.read_text()}")
    assert run(workbook) == [21, 0]
    caller = package / "caller.py"
    caller.write_text(f"# Why, in a comment.\n{caller.read_text()}")
    assert run(workbook) == [21, 1]
    assert _kernel_folders(workbook) == folders
    called.write_text(called.read_text().replace("2", "3"))
    assert run(workbook) == [31, 1]
    assert len(_kernel_folders(workbook)) == len(folders) + 1


def _kernel_folders(workbook: Path) -> set[str]:
    return {each.name for each in (workbook / "build" / "kernels").iterdir() if each.is_dir()}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_a_file_of_the_cache_that_ends_too_early_is_compiled_anew(fresh, tmp_path, seed):
    draw = random.Random(seed)
    assert fresh()[1](10.0) == 21
    files = sorted(file for file in (tmp_path / "kernels").rglob("*.nb?"))
    assert [file.suffix for file in files] == [".nbc", ".nbi"] * 2
    for file in draw.sample(files, draw.randint(1, 4)):
        os.truncate(file, draw.choice([0, draw.randrange(file.stat().st_size)]))
    inner, outer = fresh()
    assert outer(10.0) == 21 and inner(10.0) == 20
    assert misses(outer) + misses(inner) > 0
    inner, outer = fresh()
    assert outer(10.0) == 21 and inner(10.0) == 20
    assert misses(outer) + misses(inner) == 0


def test_a_constant_in_a_call_compiles_no_kernel_of_its_own(fresh):
    inner, _ = fresh()
    caller = numba.njit(lambda number: inner(2) + inner(3) + inner(number))
    assert caller(4) == 18
    assert len(inner.overloads) == 1


@pytest.mark.slow
def test_changed_machine_code_is_not_run(fresh, tmp_path):
    inner, _ = fresh()
    assert inner(10.0) == 20
    (file,) = (tmp_path / "kernels").rglob("*.nbc")
    code = bytearray(file.read_bytes())
    begin = code.index(b"\x7fELF") + 64  # behind the header: the instructions
    code[begin : begin + 64] = bytes(64)
    file.write_bytes(code)
    inner, _ = fresh()
    assert inner(10.0) == 20
    assert misses(inner) == 1


def test_a_failed_compilation_lets_others_compile(fresh, tmp_path):
    _, outer = fresh()
    with pytest.raises(numba.core.errors.TypingError):
        outer(None)
    locks = list((tmp_path / "kernels").rglob("*.lock"))
    assert len(locks) == 2 and all(is_free(lock) for lock in locks)
    assert outer(10.0) == 21  # the same process, another signature


def test_a_process_that_never_ends_compiling_is_not_waited_for(fresh, tmp_path, monkeypatch):
    inner, _ = fresh()
    with pytest.raises(numba.core.errors.TypingError):
        inner(None)
    (lock,) = (tmp_path / "kernels").rglob("*.lock")
    monkeypatch.setattr(kernel_cache, "PATIENCE", 0.1)
    with lock.open("ab") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert inner(10.0) == 20


def test_without_file_locks_every_process_compiles(fresh, tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_cache, "fcntl", None)
    assert fresh()[0](10.0) == 20
    again, _ = fresh()
    assert again(10.0) == 20 and misses(again) == 0
    assert not list((tmp_path / "kernels").rglob("*.lock"))


@pytest.mark.slow
def test_threads_do_not_wait_for_each_other_forever(fresh, tmp_path):
    inner, outer = fresh()

    @numba.njit
    def of_a_reader(x):
        return outer(x) + inner(x)

    calls = [of_a_reader, inner, outer] * 2
    values = [1.0, 1, np.ones(1), 1j, np.ones((1, 1)), True]
    with ThreadPoolExecutor(len(calls) * len(values)) as threads:
        results = [threads.submit(call, value) for call in calls for value in values[::-1]]
        for result in results:
            result.result(timeout=kernel_cache.PATIENCE / 2)
    assert len(inner.signatures) == len(outer.signatures) == len(values)
    assert all(is_free(lock) for lock in (tmp_path / "kernels").rglob("*.lock"))


def test_a_cache_that_cannot_be_written_costs_only_time(fresh, tmp_path):
    inner, _ = fresh()
    shutil.rmtree(tmp_path / "kernels")
    (tmp_path / "kernels").write_text("no folder")
    assert inner(10.0) == 20


def test_a_callback_whose_cache_is_damaged_is_compiled_anew(fresh, tmp_path):
    def of_alone():
        fresh()
        return callback(sys.modules["alone"]._inner.py_func, "float64(float64)")

    assert of_alone().ctypes(10.0) == 20 and of_alone().cache_hits == 1
    (file,) = (tmp_path / "__pycache__").glob("*.nbc")
    os.truncate(file, 100)
    damaged = of_alone()
    assert damaged.ctypes(10.0) == 20 and damaged.cache_hits == 0
    assert of_alone().cache_hits == 1


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


@pytest.mark.slow
def test_what_counts_no_references_calls_nothing_that_does():
    """It would fail to compile where that makes an array and has not been compiled for another caller before."""
    assert list(counted(modules(paths.root()))) == []


def test_a_call_of_what_counts_references_is_found():
    sources = {
        "stillwork.a": "@kernel\ndef make():\n    return np.zeros(3)\n@pasted_kernel\ndef add():\n    pass",
        "stillwork.b": "from stillwork.a import add, make\n@borrowing_kernel\ndef both():\n    add()\n    make()",
    }
    assert list(counted({name: ast.parse(text) for name, text in sources.items()})) == [
        (("stillwork.b", "both"), ("stillwork.a", "make"))
    ]


LIBRARY = Path(stillwork.__file__).parents[1]


def place_of(module: str) -> Path:
    root = LIBRARY.parent if module.startswith("contest.") else LIBRARY
    return root.joinpath(*module.split(".")).with_suffix(".py")


def imported_names(source: bytes) -> dict[str, Path]:
    """Names that a module takes from the library, with the files that they come from."""
    return {
        alias.asname or alias.name: place_of(node.module)
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.ImportFrom)
        and (node.module or "").startswith(("stillwork.", "workbook.", "experiments.", "contest."))
        for alias in node.names
    }


def test_what_a_kernel_names_comes_from_files_that_its_machine_code_is_kept_by():
    """A constant is frozen into the machine code; of a file without kernels a change of it would go unseen."""
    elsewhere, kernels = [], 0
    others = [file for name in ("contest", "notebooks") for file in (LIBRARY.parent / name).rglob("*.py")]
    for file in sorted([*LIBRARY.rglob("*.py"), *others]):
        if b"stillwork.base.kernel" not in (source := file.read_bytes()):
            continue
        root = LIBRARY if file.is_relative_to(LIBRARY) else LIBRARY.parent
        module = import_module(".".join(file.relative_to(root).with_suffix("").parts))
        taken = imported_names(source)
        for name, kernel in vars(module).items():
            if (
                isinstance(kernel, numba.core.registry.CPUDispatcher)
                and kernel.py_func.__module__ == module.__name__
            ):
                kernels += 1
                used = taken.keys() & set(kernel.py_func.__code__.co_names)
                elsewhere += [
                    (name, each) for each in used if b"stillwork.base.kernel" not in taken[each].read_bytes()
                ]
    assert kernels > 100
    assert elsewhere == []
