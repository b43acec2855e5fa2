"""The faults that `make mutants` draws: each is another program, at the place that it names."""

import ast
import importlib.util
import sys
from pathlib import Path

import pytest

FILE = Path(__file__).parents[2] / "benchmarks" / "mutants.py"
SOURCE = """
def area(width, height, free):
    \"\"\"Not 2 + 2.\"\"\"
    if not width < height and free:
        raise ValueError(f"{width + 1} is wide")
    total = power(max(width, height), 2.0)
    total += height * free[width]
    return total
"""
WANTED = {
    "and, or": ["(not width < height or free)"],
    "not": ["(width < height)"],
    "comparison": ["(width <= height)"],
    "constant": ["4.0"],
    "arguments": ["(power(2.0, max(width, height)))"],
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


def test_what_is_said_to_change_nothing_is_a_mutant_and_says_why(mutants):
    """An entry whose line was changed since says nothing."""
    for each in mutants.read_toml(mutants.FORKED / "equivalent.toml")["mutant"]:
        text = (mutants.ROOT / "lib" / each["file"]).read_bytes()
        known = {
            f"{m.old} -> {m.new}" for m in mutants.mutants_of(each["file"], text) if mutants.equivalent(m)
        }
        assert known >= set(each["changes"]) and each["reason"]
