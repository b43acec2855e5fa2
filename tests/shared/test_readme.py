"""What the README tells a reader to type works as it stands there."""

import re
import shlex

import numpy as np
import pytest

from stillwork.__main__ import main
from workbook import paths
from workbook.tasks import built

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


def test_it_says_where_a_build_writes():
    assert f"`{built().relative_to(paths.root())}/<topic>/<notebook>/`" in README


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


def test_the_places_that_it_names_hold_what_it_says():
    places = dict(re.findall(r"`((?:lib|notebooks)/[\w./-]+\.)(py|ipynb)`", README))
    text = {
        f"{name}{kind}": (paths.root() / f"{name}{kind}").read_text("utf-8") for name, kind in places.items()
    }
    assert "def continuous_gain(" in text["lib/stillwork/estimation/riccati.py"]
    assert r"save(\"table-3-5\"" in text["notebooks/motion/09-bandwidth-table.ipynb"]
    assert "def verdict(" in text["lib/workbook/claims.py"]


def test_own_data_and_the_library_come_before_one_row_of_pictures():
    heads = ["## Your own machine", "## The library", "<!-- gallery:begin -->", "<!-- ledger:begin -->"]
    places = [README.index(each) for each in heads]
    assert places == sorted(places)
    assert README.count("<img ") == 4
