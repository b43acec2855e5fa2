"""What the README tells a reader to type works as it stands there."""

import re
import shlex

import numpy as np
import pytest

from stillwork.__main__ import main
from workbook import paths

README = (paths.root() / "README.md").read_text(encoding="utf-8")
SETTINGS = [text for text in re.findall(r'ARGS="([^"]*)"', README) if "-p" in text]


def test_the_readme_shows_how_to_set_parameters():
    assert SETTINGS


@pytest.mark.parametrize("arguments", SETTINGS)
def test_parameters_exist(arguments, capsys):
    assert main(["figures", *shlex.split(arguments), "--why"]) == 0
    assert arguments.split()[0] in capsys.readouterr().out


def test_the_snippet_finds_the_weights_it_announces(capsys):
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    exec(code, {})
    (announced,) = re.findall(r"print\(.*\)\s*# (.*)", code)
    numbers = [
        np.array(re.findall(r"-?\d+\.?\d*", text), float) for text in (announced, capsys.readouterr().out)
    ]
    np.testing.assert_allclose(numbers[1], numbers[0], atol=1e-3)


def test_files_that_the_texts_name_exist():
    places = ("README.md", "CONTRIBUTING.md", "docs/your-rig.md")
    texts = [(paths.root() / name).read_text(encoding="utf-8") for name in places]
    named = {
        name
        for text in texts
        for name in re.findall(r"`((?:lib|docs|tests|data|benchmarks)/[\w./-]+)`", text)
    }
    assert named
    assert not [name for name in named if not (paths.root() / name).exists()]
