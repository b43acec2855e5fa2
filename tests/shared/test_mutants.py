"""The faults that `make mutants` draws: each is another program, at the place that it names."""

import ast
import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

FILE = Path(__file__).parents[2] / "benchmarks" / "mutants.py"
SOURCE = """
def area(width, height, free):
    \"\"\"Not 2 + 2.\"\"\"
    if not width < height and free:
        raise ValueError(f"{width + 1} is wide")
    total = hypot(width, 2.0)
    total += height * free[width]
    return total
"""
WANTED = {
    "and, or": ["(not width < height or free)"],
    "not": ["(width < height)"],
    "comparison": ["(width <= height)"],
    "constant": ["4.0"],
    "arguments": ["(hypot(2.0, width))"],
    "operator": ["(height / free[width])"],
    "index": ["free[width + 1]"],
    "statement": ["pass", "pass"],
}


@pytest.fixture(scope="module")
def mutants():
    spec = importlib.util.spec_from_file_location("mutants_of_the_toolbox", FILE)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # for its dataclass
    spec.loader.exec_module(module)
    return module


def test_each_fault_is_found_and_changes_its_place_alone(mutants):
    text = SOURCE.encode()
    found = {}
    for each in mutants.mutants_of("x.py", text):
        changed = text[: each.start] + each.new.encode() + text[each.end :]
        assert ast.dump(ast.parse(changed)) != ast.dump(ast.parse(text)), each
        assert " ".join(text[each.start : each.end].decode().split()) == each.old and each.function == "area"
        found.setdefault(each.kind, []).append(each.new)
    assert found == WANTED


@pytest.mark.slow
def test_a_seed_draws_the_same_mutants_again_and_another_one_others(mutants):
    one, again, other = (list(map(str, mutants.draw(30, seed))) for seed in (1, 1, 2))
    assert one == again and len(set(one)) == 30 and set(one) != set(other)


LIBRARY = """
def area(width, height):
    total = width * height
    return total

class Box:
    def __init__(self, side):
        self.side = side + 0

    def volume(self):
        def cube(side):
            return side**3
        return cube(self.side) + 1 - 1

def unused(width):
    return width + 1
"""
TESTS = """
from library import Box, area

def test_area():
    assert area(2, 3) == 6

def test_volume():
    assert Box(2).volume() == 8
"""


@pytest.mark.slow
def test_the_forks_run_the_tests_that_reach_a_fault_and_nothing_else(mutants, tmp_path):
    """Each fault against a small library: which test notices, where one does, and how many tried."""
    for name, text in (("lib/library.py", LIBRARY), ("tests/part/test_library.py", TESTS)):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    source, test = tmp_path / "lib/library.py", tmp_path / "tests/part/test_library.py"
    faults = list(mutants.mutants_of("library.py", LIBRARY.encode()))
    told = [
        {"mutant": f"{each.line} {each.kind}", "path": str(source), "near": [str(test)]}
        | {"text": each.applied(LIBRARY.encode()).decode()}
        | {name: getattr(each, name) for name in ("file", "lines", "function", "outermost")}
        for each in faults
    ]
    (tmp_path / "tried.json").write_text(json.dumps(told))
    variables = {
        "TRIED": tmp_path / "tried.json",
        "ANSWERS": tmp_path / "answers",
        "RECORDS": tmp_path / "known",
    }
    variables = {f"FAULTS_{name}": str(each) for name, each in (variables | {"LIMIT": 9}).items()}
    variables |= {"PYTHONPATH": f"{tmp_path / 'lib'}:{FILE.with_name('mutating')}"}
    plugins = [f"-p{name}" for name in ("forked_tests", "no:nbval", "no:anyio", "no:cacheprovider")]
    command = [sys.executable, "-m", "pytest", "-q", "-s", *plugins, str(test)]
    done = subprocess.run(command, cwd=tmp_path, env=os.environ | variables, capture_output=True, text=True)
    found = [json.loads(line) for line in (tmp_path / "answers").read_text().splitlines()]
    ends = {each["mutant"]: (each["end"], each["by"].rpartition("::")[2], each["tests"]) for each in found}
    assert ends == {
        "3 operator": ("killed", "test_area", 1),
        "8 operator": ("survived", "", 1),
        "8 constant": ("killed", "test_volume", 1),
        "8 statement": ("killed", "test_volume", 1),
        "12 constant": ("killed", "test_volume", 1),
        "13 operator": ("killed", "test_volume", 1),
        "13 constant": ("killed", "test_volume", 1),
        "16 operator": ("not reached", "", 0),
        "16 constant": ("not reached", "", 0),
    }, done.stdout


def test_what_is_said_to_change_nothing_is_a_mutant_and_says_why(mutants):
    """An entry whose line was changed since says nothing."""
    for each in mutants.read_toml(mutants.FORKED / "equivalent.toml")["mutant"]:
        text = (mutants.ROOT / "lib" / each["file"]).read_bytes()
        known = {
            f"{m.old} -> {m.new}" for m in mutants.mutants_of(each["file"], text) if mutants.equivalent(m)
        }
        assert known >= set(each["changes"]) and each["reason"]
