"""Accepting takes over text and numbers, and nothing that differs from run to run."""

import json
import tomllib

import pytest

from stillwork.workbook.accept import cleaned
from workbook.toy import cell

pytestmark = pytest.mark.slow

README = "# Toy\n\n<!-- ledger:begin -->\nold\n<!-- ledger:end -->\n\nThe end.\n"


def test_accepts_a_build(toy):
    toy.add_page("isolation/01-first")
    toy.add("motion/01-first", "print('hello')")
    toy.write("README.md", README)
    toy.write("figures/motion/00-gone/fig-1.csv", "panel,series,x,y,z\n")

    refused = toy.run("accept")
    assert refused.returncode == 1
    assert "stale: isolation/01-first: never built" in refused.stdout
    assert toy.run("figures").returncode == 0
    done = toy.run("accept")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "claimed by no notebook: motion.gain",
        "belongs to no notebook, remove it: figures/motion/00-gone",
        "accepted 2 notebooks and 2 ledger entries",
    ]

    ledger = (toy.root / "data/isolation/published.toml").read_text()
    assert tomllib.loads(ledger)["isolation"]["gain"]["ours"] == 2.0
    assert ledger.startswith("# Numbers of the toy.")
    assert "published = 2.0  # as printed" in ledger
    assert 'digits" }\nours = 2.0\n\n# What comes next.\n' in ledger
    assert (toy.root / "data/motion/published.toml").read_text().count("ours") == 0

    text = (toy.root / "notebooks/isolation/01-first.ipynb").read_text()
    cells = {each["id"]: each for each in json.loads(text)["cells"]}
    assert [each.get("execution_count") for each in cells.values()] == [None, 1, 2, 3, 4, 5]
    assert cells["figure"]["outputs"][0]["data"] == {"text/plain": ["fig-1.png, fig-1.csv"]}
    assert "replicated" in "".join(cells["claims"]["outputs"][0]["data"]["text/plain"])
    assert cells["parameters"]["metadata"] == {"tags": ["parameters"]}
    for forbidden in ("papermill", "image/png", "text/html", str(toy.root), "injected"):
        assert forbidden not in text

    readme = (toy.root / "README.md").read_text()
    assert "| `isolation` | 1 | 1 | 0 | 0 | 0 | 0 |" in readme
    assert readme.endswith("<!-- ledger:end -->\n\nThe end.\n")

    assert toy.run("figures").stdout == "nothing to do: 2 up to date\n"
    before = toy.files("notebooks", "data", "figures")
    assert toy.run("accept").returncode == 0
    assert toy.files("notebooks", "data", "figures") == before


def test_says_what_moved_and_what_lacks_a_reason(toy):
    toy.add_page("isolation/01-first")
    toy.replace("data/isolation/published.toml", "published = 2.0", "ours = 1.9\npublished = 3.0")
    toy.run("figures")
    said = toy.run("accept").stdout.splitlines()
    assert "moved: isolation.gain: 1.9 -> 2" in said
    assert "deviates without a reason: isolation.gain" in said


def test_cleaning_keeps_text_only():
    source = {
        "cells": [cell("a", "x"), cell("b", "# t", "markdown")],
        "metadata": {"kernelspec": {"name": "odd"}},
    }
    data = {"text/plain": "<Figure>", "image/png": "iVBO", "text/html": "<b>", "application/vnd.x+json": {}}
    outputs = [
        {"output_type": "stream", "name": "stdout", "text": "said\n"},
        {"output_type": "display_data", "data": data, "metadata": {"isolated": True}},
        {"output_type": "display_data", "data": {"image/png": "iVBO"}, "metadata": {}},
    ]
    ran = {
        "cells": [{**cell("a", "x"), "outputs": outputs, "execution_count": 1}, cell("b", "# t", "markdown")]
    }
    code, text = cleaned(source, ran)["cells"]
    assert code["outputs"] == [
        {"output_type": "stream", "name": "stdout", "text": "said\n"},
        {"output_type": "display_data", "data": {"text/plain": "<Figure>"}, "metadata": {}},
    ]
    assert text == cell("b", "# t", "markdown")
