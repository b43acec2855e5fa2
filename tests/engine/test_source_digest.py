"""What a module's digest sees: what acts, in any layout and any words."""

import ast
import random
from pathlib import Path

import pytest

import stillwork
from workbook.source_digest import code_digest

LIBRARY = Path(stillwork.__file__).parents[1]
FILES = sorted(LIBRARY.rglob("*.py"))
DRAWN = random.Random(7).sample(FILES, 3)  # of a few hundred


def documented(tree: ast.AST):
    return (
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node)
    )


@pytest.mark.parametrize("file", DRAWN, ids=lambda file: file.relative_to(LIBRARY).as_posix())
def test_words_and_layout_are_no_part_of_it(file):
    source = file.read_text(encoding="utf-8")
    digest = code_digest(source.encode())
    assert code_digest(f"# What.\n\n{source}\n# End.\n".encode()) == digest
    tree = ast.parse(source)
    for node in documented(tree):
        node.body[0].value.value += "And more."
    assert code_digest(ast.unparse(tree).encode()) == digest
    for node in documented(tree):
        node.body[0] = ast.Pass()
    assert code_digest(ast.unparse(tree).encode()) == digest


@pytest.mark.parametrize(
    ("before", "after", "same"),
    [
        ("def f(x): return x", "def f(x: int) -> int: return x", True),
        ("def f():\n x: int = 1", "def f():\n x: float = 1", True),
        ("def f():\n x: int\n print(x)", "def f():\n print(x)", False),  # of this module, no longer local
        ("@d\ndef f(x): return x", "@d\ndef f(x: int): return x", False),
        ("class A:\n def f(x): pass", "class A:\n def f(x: int): pass", True),
        ("@cache(4)\ndef f(x): pass", "@cache(4)\ndef f(x: int): pass", True),
        ("@checked\ndef f(x): pass", "@checked\ndef f(x: int): pass", False),
        ("class A:\n x: int", "class A:\n x: float", False),
        ("x: int = 1", "x: float = 1", False),
        ("'a'", "'b'", True),
        ("f('a')", "f('b')", False),
        ("x = (1 +\n 2)", "x = 1 + 2", True),
        ("x = 1.0", "x = 1", False),
        ("x = 1_000", "x = 1000", True),
        ("def", "def ", False),  # which Python cannot read
        (
            "x = " + "+".join("1" * 20_000),
            "x = " + "+".join("1" * 20_001),
            False,
        ),  # nor this, nested too deep
    ],
)
def test_annotations_are_a_part_of_it_where_somebody_reads_them(before, after, same):
    assert (code_digest(before.encode()) == code_digest(after.encode())) == same
