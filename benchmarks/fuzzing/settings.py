"""Texts for ``-p NAME=VALUE``."""

import random

import numpy as np

from workbook.parameters import Parameter

KINDS = {
    "int": 1, "float": 1.5, "str": "a", "bool": True, "list[float]": [1.0], "list[int]": [1], "list[str]": ["a"],
    "tuple[float, float]": (0.0, 1.0), "float | None": None, "tuple[float, ...]": (1.0,), "int | str": 1,
    "list[list[float]]": [[1.0]], "bool | None": None,
}  # fmt: skip
PIECES = (
    "-", "--", "+", "1", "9" * 400, "1e400", "-1e400", "inf", "nan", "none", "true", "[", "]", "(", ")", ",", ", ", "'",
    '"', "{", "}", "a", "é", "\x00", "\n", " ", "1.5", "0x", "_", "1_0", ":", "lambda", "**", "*", "1j", "b'x'", "…", "/",
)  # fmt: skip


def case(rng: np.random.Generator) -> tuple:
    """A text read as a parameter of some type."""
    annotation = list(KINDS)[rng.integers(len(KINDS))]
    letters = random.Random(int(rng.integers(2**32)))
    parts = letters.choices(PIECES, k=letters.choice((1, 2, 3, 5, 9)))
    text = "".join(parts) * letters.choice((1, 1, 1, 2, 300, 20_000))
    parameter = Parameter("name", annotation, KINDS[annotation])
    return f"-p, {annotation}", [text[:80], len(text)], False, lambda: _plain(parameter.read(text))


def _plain(value):
    """The value, of which no number may be infinite or NaN."""
    return value
