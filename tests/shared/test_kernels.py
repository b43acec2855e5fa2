import ast
import fcntl
import importlib.util
import math
import os
import random
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
import numpy as np
import pytest

import stillwork
from layering import modules
from stillwork import estimation
from stillwork.base import kernel_cache, kernels
from stillwork.base.checks import InputError
from stillwork.base.kernel_folder import cache_folder
from stillwork.base.kernels import callback
from stillwork.estimation import coordinate_filters, filtering, hinfinity, linear_fits, min_max, time_varying
from workbook import paths

CALLED = """
from stillwork.base.kernels import inlined_kernel

@inlined_kernel
def _twice(x):
    return {factor} * x
"""
CONSTANTS = """
from typing import NamedTuple

OFFSET = {offset}

class Pair(NamedTuple):
    {fields}: float
"""
CALLER = """
from stillwork import constants
from stillwork.called import _twice
from stillwork.base.kernels import kernel

@kernel
def _use(x, pair):
    return _twice(x) + constants.OFFSET + pair.second
"""
RUN = """
from stillwork.caller import _use
from stillwork.constants import Pair
print(flush=True)
input()
print(_use(10.0, Pair(5.0, 0.0)), sum(_use.stats.cache_misses.values()))
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
    ours = {"PYTHONPATH": str(root / "lib"), "STILLWORK_ROOT": str(root), "PATH": ""}
    # Python takes a file of the same second and size for the same one.
    environment = {"PYTHONDONTWRITEBYTECODE": "1"} | ours | environment
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
    needed = ("checks", "garbage", "kernel_cache", "kernel_folder", "kernel_sources", "kernels")
    for name in ("__init__", *needed):
        shutil.copy(Path(stillwork.__file__).parent / "base" / f"{name}.py", package / "base")
    shutil.copy(Path(stillwork.__file__), package)
    (package / "caller.py").write_text(CALLER)
    (package / "called.py").write_text(CALLED.format(factor=2))
    (package / "constants.py").write_text(CONSTANTS.format(offset=1, fields="first: float; second"))
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


# The places for machine code: ours, a named one, the user's own, numba's rule, and one where nothing of ours can be written.
PLACES = (
    {},
    {"STILLWORK_KERNELS": "{own}"},
    {"NUMBA_CACHE_DIR": "{own}"},
    {"NUMBA_CACHE_LOCATOR_CLASSES": "InTreeCacheLocator"},
    {"STILLWORK_ROOT": "{own}", "NUMBA_CACHE_DIR": ""},
)


@pytest.mark.slow
@pytest.mark.parametrize("place", PLACES)
def test_a_change_of_what_a_kernel_names_is_seen_wherever_machine_code_is_kept(workbook, tmp_path, place):
    own = {name: value.format(own=tmp_path / "own") for name, value in place.items()}
    package = workbook / "lib" / "stillwork"
    for factor, offset, second, value in (
        (2, 1, 1, 21),
        (3, 1, 1, 31),
        (3, 4, 1, 34),
        (3, 4, 0, 39),
        (2, 1, 1, 21),
    ):
        (package / "called.py").write_text(CALLED.format(factor=factor))
        fields = "first: float; second" if second else "second: float; first"
        (package / "constants.py").write_text(CONSTANTS.format(offset=offset, fields=fields))
        assert run(workbook, **own)[0] == value
    assert run(workbook, **own) == [21, 0]
    named = place.keys() & {"STILLWORK_KERNELS", "NUMBA_CACHE_DIR"} and "STILLWORK_ROOT" not in place
    assert bool(list((tmp_path / "own").rglob("*.nbc"))) == bool(named)
    assert (workbook / "build").exists() == (not place)


CELLS = r"""
import sys
from IPython.core.interactiveshell import InteractiveShell
shell = InteractiveShell.instance()
shell.run_cell("from stillwork.base.kernels import kernel")
shell.run_cell("@kernel\ndef called(x):\n    return {factor} * x")
shell.run_cell("@kernel\ndef caller(x):\n    return called(x) + 1")
shell.run_cell("print(caller(10.0), sum(caller.stats.cache_misses.values()))")
"""


@pytest.mark.slow
def test_a_change_of_a_kernel_in_another_cell_is_seen(workbook, tmp_path):
    (tmp_path / "ipykernel_1").mkdir()
    environment = {
        "PYTHONPATH": str(workbook / "lib"),
        "IPYTHONDIR": str(tmp_path),
        "HOME": str(tmp_path),
        "PATH": "",
    }

    def ask(factor: int) -> list[float]:
        command = [sys.executable, "-c", CELLS.format(factor=factor)]
        said = subprocess.check_output(command, env=environment, text=True)
        return [float(word) for word in said.split()]

    assert [ask(factor) for factor in (2, 2, 3, 3)] == [[21, 1], [21, 0], [31, 1], [31, 0]]


def test_the_cache_folder_is_the_one_that_the_driver_gives(monkeypatch):
    monkeypatch.setenv("STILLWORK_KERNELS", "/given")
    assert cache_folder() == "/given"


def test_machine_code_goes_after_a_week_without_use(workbook):
    run(workbook)
    every, day = workbook / "build" / "kernels", 24 * 3600
    used = _kernel_folders(workbook)
    for name, age in {"0" * 16: 8, f"topic_{'1' * 16}": 8, "2" * 16: 6, "own": 30}.items():
        (every / name / "topic").mkdir(parents=True)
        os.utime(every / name, (time.time() - age * day,) * 2)
    (every / f"{'3' * 16}.code").touch()  # as earlier versions left it
    os.utime(every / f"{'3' * 16}.code", (1e9, 1e9))
    assert run(workbook) == [21, 0]
    assert _kernel_folders(workbook) == used | {"2" * 16, "own"}
    assert not list(every.glob("*.code"))


@pytest.mark.slow
def test_a_comment_in_a_file_of_kernels_compiles_that_file_alone(workbook):
    """Its own kernels, whose machine code is kept by the file; not those that call them."""
    assert run(workbook) == [21, 1]
    for name, compiled in (("called", 0), ("constants", 0), ("caller", 1)):
        file = workbook / "lib" / "stillwork" / f"{name}.py"
        file.write_text(f"# Why, in a comment.\n{file.read_text()}")
        assert run(workbook) == [21, compiled]


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


def free_mass(position, velocity, force, parameters):
    return force / parameters[0] - math.sqrt(parameters[1])


def mass_inverted(position, velocity, acceleration, parameters):
    return parameters[0] * (acceleration + math.sqrt(parameters[1]))


def wall(position, velocity, force, parameters):
    return force / parameters[0] + math.sqrt(1.0 - position)


def wall_inverted(position, velocity, acceleration, parameters):
    return parameters[0] * (acceleration - math.sqrt(1.0 - position))


def filtered(kind):
    """A coordinate through a filter over a record of which a sample is lost, where it can be."""
    plant = estimation.Plant(free_mass, mass_inverted, np.array([2.0, 0.1]))
    chosen = kind(plant) if kind in (estimation.ExtendedKalman, estimation.UnscentedKalman) else kind()
    position = np.cumsum(np.random.default_rng(3).normal(size=60)) / 100
    if kind in (estimation.ExtendedKalman, estimation.UnscentedKalman):
        position[20] = np.nan
    found = estimation.filter_signal(chosen, position)
    return np.array([found.position, found.velocity, found.acceleration])


def stepped(kind):
    """The same one sample at a time."""
    chosen = kind(estimation.Plant(free_mass, mass_inverted, np.array([2.0, 0.1])))
    state = chosen.start(velocity=1.0)
    for position in (0.1, 0.2, np.nan, 0.25):
        state = chosen.step(state, position, force=0.3)
    return state.estimate


def solved():
    rng = np.random.default_rng(5)
    matrix, target = rng.normal(size=(20, 3)), rng.normal(size=20)
    least_norm = np.linalg.norm(matrix.T @ target) / np.linalg.norm(target)
    found = [estimation.min_max_solve(matrix, target, share * least_norm) for share in (0.0, 0.3, 0.9)]
    robust = linear_fits.hinfinity_estimate(matrix, target, 1.0, 1.0)
    return np.array([*(each.estimate for each in found), robust])


@pytest.mark.parametrize(
    "kind",
    [
        estimation.LowPass,
        coordinate_filters.MovingWindow,
        coordinate_filters.SavitzkyGolay,
        estimation.ExtendedKalman,
        estimation.UnscentedKalman,
        "extended steps",
        "unscented steps",
        "block",
    ],
)
def test_python_gives_the_numbers_of_the_kernels(kind, monkeypatch):
    """Those of a short record, which is not worth a compilation; `tests/worstcase/test_recursive.py` has the recursions."""
    calls = {
        "extended steps": lambda: stepped(estimation.ExtendedKalman),
        "unscented steps": lambda: stepped(estimation.UnscentedKalman),
        "block": solved,
    }
    call = calls.get(kind, lambda: filtered(kind))
    modules, found, run = (coordinate_filters, filtering, hinfinity, min_max, time_varying), [], []
    for choose in (
        lambda kernel, *_: kernel,
        lambda kernel, *_: run.append(kernel) or kernels.uncompiled(kernel),
    ):
        for module in modules:
            monkeypatch.setattr(module, "kernel_for", choose)
        found.append(call())
    compiled, python = found
    assert run and np.array_equal(np.isnan(python), np.isnan(compiled))
    assert python == pytest.approx(compiled, rel=1e-9, abs=1e-9 * np.nanmax(np.abs(compiled)), nan_ok=True)


@pytest.mark.parametrize("kind", [estimation.ExtendedKalman, estimation.UnscentedKalman])
def test_a_model_that_python_refuses_goes_on_as_its_machine_code_does(kind, monkeypatch):
    """The root of a number below zero raises in Python and is NaN in machine code: one message, whatever is compiled."""

    def refused():
        plant = estimation.Plant(wall, wall_inverted, np.array([1.0]))
        with pytest.raises(InputError, match=r"finite|definite") as caught:
            estimation.filter_signal(kind(plant), np.linspace(0, 2, 30), sample_time=1e-3)
        return str(caught.value)

    messages = []
    for choose in (lambda kernel, *_: kernel, lambda kernel, *_: kernels.uncompiled(kernel)):
        monkeypatch.setattr(filtering, "kernel_for", choose)
        messages.append(refused())
    assert messages[0] == messages[1]
