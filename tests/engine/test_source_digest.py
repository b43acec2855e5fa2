"""What a module's digest sees: what acts, in any layout and any words."""

import ast
import io
import random
import re
import tokenize
from pathlib import Path

import pytest

import stillwork
from workbook.source_digest import code_digest

LIBRARY = Path(stillwork.__file__).parents[1]
FILES = sorted(LIBRARY.rglob("*.py"))
DRAWN = random.Random(7).sample(FILES, 8)  # of a few hundred


def tokens(source: str) -> list[tokenize.TokenInfo]:
    return list(tokenize.generate_tokens(io.StringIO(source).readline))


def at(source: str, place: tuple[int, int]) -> int:
    """Offset of a line and a column in the text."""
    return sum(map(len, source.splitlines(keepends=True)[: place[0] - 1])) + place[1]


def put(source: str, token: tokenize.TokenInfo, text: str) -> str:
    return source[: at(source, token.start)] + text + source[at(source, token.end) :]


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
    commented = "".join(put_comment(line) for line in tokens_by_line(source))
    spaced = re.sub(r"^(class |def |@|import |from )", r"\n# Why.\n\1", source, flags=re.M)
    assert code_digest(f"# What.\n\n{source}\n# End.\n".encode()) == digest
    assert code_digest(commented.encode()) == digest
    if "'''" not in source and not re.search(
        r'"""\\\n|= f?"""|\("""', source
    ):  # where no text holds such lines
        assert code_digest(spaced.encode()) == digest
    tree = ast.parse(source)
    for node in documented(tree):
        node.body[0].value.value += "And more."
    assert code_digest(ast.unparse(tree).encode()) == digest
    for node in documented(tree):
        node.body[0] = ast.Pass()
    assert code_digest(ast.unparse(tree).encode()) == digest


def tokens_by_line(source: str):
    """Each line, and whether a statement ends with it."""
    ends = {token.start[0] for token in tokens(source) if token.type == tokenize.NEWLINE}
    for number, line in enumerate(source.splitlines(keepends=True), 1):
        yield line, number in ends


def put_comment(line: tuple[str, bool]) -> str:
    text, ends = line
    return f"{text.rstrip()}  # again\n" if ends else text


@pytest.mark.slow
@pytest.mark.parametrize("file", DRAWN, ids=lambda file: file.relative_to(LIBRARY).as_posix())
def test_a_changed_token_that_acts_changes_it(file):
    """Each name, number and operator in turn, as far as Python still reads the source then."""
    source = file.read_text(encoding="utf-8")
    digest = code_digest(source.encode())
    annotations = list(annotated(ast.parse(source)))
    draw = random.Random(3)
    each = [token for token in tokens(source) if token.type in (tokenize.NAME, tokenize.NUMBER, tokenize.OP)]
    changed = 0
    for token in draw.sample(each, min(len(each), 60)):
        text = {"+": "-", "-": "+", "*": "/", "<": ">", "==": "!="}.get(token.string)
        if token.type == tokenize.NAME:
            text = f"{token.string}_"
        if token.type == tokenize.NUMBER:
            text = f"1{token.string}"
        if text is None:
            continue
        mutant = put(source, token, text)
        try:
            ast.parse(mutant)
        except SyntaxError:
            continue
        place = (token.start[0], len(token.line[: token.start[1]].encode()))
        if any(begin <= place < end for begin, end in annotations):  # of these tells the next test
            continue
        changed += 1
        assert code_digest(mutant.encode()) != digest, token
    assert changed or len(each) < 20


def annotated(tree: ast.AST):
    """Begin and end of every annotation."""
    for node in ast.walk(tree):
        for each in (getattr(node, "annotation", None), getattr(node, "returns", None)):
            if each:
                yield (each.lineno, each.col_offset), (each.end_lineno, each.end_col_offset)


@pytest.mark.parametrize(
    ("before", "after", "same"),
    [
        ("def f(x): return x", "def f(x: int) -> int: return x", True),
        ("async def f(*x, **y): pass", "async def f(*x: int, **y: str): pass", True),
        ("def f():\n x: int = 1", "def f():\n x: float = 1", True),
        ("def f():\n x: int\n print(x)", "def f():\n print(x)", False),  # of this module, no longer local
        ("@d\ndef f(x): return x", "@d\ndef f(x: int): return x", False),
        ("class A:\n def f(x): pass", "class A:\n def f(x: int): pass", True),
        ("class A:\n @property\n def f(x): pass", "class A:\n @property\n def f(x) -> int: pass", True),
        ("@cache(4)\ndef f(x): pass", "@cache(4)\ndef f(x: int): pass", True),
        ("@checked\ndef f(x): pass", "@checked\ndef f(x: int): pass", False),
        ("class A:\n x: int", "class A:\n x: float", False),
        ("class A:\n def f(x):\n  def g(y): pass", "class A:\n def f(x):\n  def g(y: int): pass", True),
        ("def f():\n class A:\n  x: int", "def f():\n class A:\n  x: float", False),
        ("x: int = 1", "x: float = 1", False),
        ("x = 'a'", "x = 'b'", False),
        ("'a'", "'b'", True),
        ("f('a')", "f('b')", False),
        ("f'{f()}'", "f'{g()}'", False),
        ("x = (1 +\n 2)", "x = 1 + 2", True),
        ("x = 1.0", "x = 1", False),
        ("x = True", "x = 1", False),
        ("assert x", "", False),
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
