"""Accepting copies text and numbers, and nothing that differs from run to run."""

import base64
import fcntl
import json
import signal

import pytest

from engine import toy as toys
from engine.toy import cell
from workbook.__main__ import main
from workbook.notebooks import cleaned

pytestmark = pytest.mark.slow

README = "# Toy\n\n<!-- ledger:begin -->\nold\n<!-- ledger:end -->\n\nThe end.\n"


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """A workbook of a page and another notebook, built once and not accepted."""
    made = toys.make(tmp_path_factory.mktemp("page"))
    made.add_page("isolation/01-first")
    made.add("motion/01-first", "print('hello')")
    made.write("README.md", README)
    assert made.run("figures").returncode == 0
    yield made
    toys.clean_up(made)


@pytest.fixture(scope="module")
def accepted_page(page, tmp_path_factory):
    with toys.copy_of(page, tmp_path_factory.mktemp("accepted")) as copy:
        assert copy.run("accept").returncode == 0
        yield copy


@pytest.fixture
def built(page, tmp_path):
    """A copy of the built workbook that a test may change."""
    with toys.copy_of(page, tmp_path) as copy:
        yield copy


@pytest.fixture
def accepted(accepted_page, tmp_path):
    """A copy of the accepted workbook that a test may change."""
    with toys.copy_of(accepted_page, tmp_path) as copy:
        yield copy


def test_accepts_a_build(built):
    toy = built
    toy.write("figures/motion/00-gone/fig-1.csv", "panel,series,x,y,z\n")
    ledger = toy.files("data")
    done = toy.run("accept")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "claimed by no notebook: motion.gain",
        "belongs to no notebook, remove it: figures/motion/00-gone",
        "accepted 2 notebooks and 2 ledger entries: 12 files changed",
    ]

    assert toy.files("data") == ledger
    claims = (toy.root / "figures/isolation/01-first/claims.json").read_text()
    assert json.loads(claims) == {"isolation.gain": {"ours": 2.0}}

    text = (toy.root / "notebooks/isolation/01-first.ipynb").read_text()
    cells = {each["id"]: each for each in json.loads(text)["cells"]}
    assert [each.get("execution_count") for each in cells.values()] == [None, 1, 2, 3, 4, 5]
    shown = cells["figure"]["outputs"][0]["data"]
    assert shown["text/plain"] == ["fig-1.png, fig-1.csv"]
    png = (toy.root / "figures/isolation/01-first/fig-1.png").read_bytes()
    assert base64.b64decode(shown["image/png"]) == png
    for kind in ("text/plain", "text/html"):
        assert "inside" in "".join(cells["claims"]["outputs"][0]["data"][kind])
    assert cells["parameters"]["metadata"] == {"tags": ["parameters"]}
    for forbidden in ("papermill", str(toy.root), "injected"):
        assert forbidden not in text

    readme = (toy.root / "README.md").read_text()
    assert "| `isolation` | 1 | 1 |" in readme
    assert readme.endswith("<!-- ledger:end -->\n\nThe end.\n")

    assert toy.reasons() == {}
    before = toy.stamps("notebooks", "data", "figures", "README.md")
    assert toy.run("accept").stdout.endswith("2 ledger entries: 0 files changed\n")
    assert toy.stamps("notebooks", "data", "figures", "README.md") == before
    assert toy.leftovers() == []


def test_what_agrees_keeps_its_bytes_whatever_the_last_bits(accepted):
    """As on another processor: the library gives the same within rounding, at another commit."""
    toy = accepted
    before = toy.stamps("notebooks", "data", "figures", "README.md")
    toy.replace("lib/experiments/isolation/model.py", "2.0", "2.0 * (1 + 1e-9)")
    done = toy.run("figures")
    assert (
        "2 pictures agree with the committed ones (worst 0e+00 of the range), 0 verdicts moved" in done.stdout
    )
    assert toy.run("accept").stdout.endswith("0 files changed\n")
    assert toy.stamps("notebooks", "data", "figures", "README.md") == before


def test_what_is_stale_is_not_accepted(built):
    before = built.stamps("notebooks", "data", "figures", "README.md")
    built.replace("lib/experiments/isolation/model.py", "2.0", "2.5")
    refused = built.run("accept")
    assert refused.returncode == 1
    assert "stale: isolation/01-first: lib/experiments/isolation/model.py changed" in refused.stdout
    assert built.stamps("notebooks", "data", "figures", "README.md") == before


def test_an_accept_that_is_ended_while_it_writes_goes_to_its_end(built):
    script = f"""
import os
from stillwork.__main__ import main
from workbook.site import derived
rewrite = derived.refresh
derived.refresh = lambda: os.kill(os.getpid(), {int(signal.SIGTERM)}) or rewrite()
raise SystemExit(main(["accept"]))
"""
    done = built.run(script=script, preexec_fn=toys.set_signals)
    assert done.returncode == 128 + signal.SIGTERM
    assert "Traceback" not in done.stderr
    assert built.leftovers() == []
    assert built.run("accept").stdout.endswith(" 0 files changed\n")


def test_what_moved_is_said_by_the_build_and_taken_over(accepted):
    toy = accepted
    toy.replace("lib/experiments/isolation/model.py", "2.0", "2.1")
    toy.replace("notebooks/isolation/01-first.ipynb", "size=3)", "size=3) + gain(level)")
    said = toy.run("figures").stdout.splitlines()
    assert "moved: isolation/01-first: figure fig-1, cell claims, claim isolation.gain" in said
    assert "verdict moved: isolation.gain: inside -> outside" in said
    assert said[-1].startswith("1 of 2 pictures agree") and "1 verdicts moved" in said[-1]
    done = toy.run("accept")
    assert done.returncode == 0
    assert "moved: isolation.gain: 2 -> 2.1\n" in done.stdout
    assert (
        toy.files("figures")["figures/isolation/01-first/fig-1.csv"]
        == (toy.files("build/figures")["build/figures/isolation/01-first/fig-1.csv"])
    )
    assert '"ours": 2.1' in (toy.root / "figures/isolation/01-first/claims.json").read_text()


def test_a_value_that_agrees_keeps_the_accepted_one_though_another_claim_moved(accepted):
    """Else many small steps, each within the drift, would add up unseen."""
    file = "figures/isolation/01-first/claims.json"
    kept = {"isolation.gain": {"ours": 2.001}}
    accepted.write(file, json.dumps(kept | {"isolation.gone": {"ours": 1.0}}))
    assert accepted.run("accept").returncode == 0
    assert json.loads((accepted.root / file).read_text()) == kept


@pytest.mark.parametrize("command", ["accept", "figures"])
def test_two_at_once_are_refused(tmp_path, monkeypatch, capsys, command):
    (tmp_path / "data").mkdir()
    (tmp_path / "build").mkdir()
    monkeypatch.setenv("STILLWORK_ROOT", str(tmp_path))
    with (tmp_path / "build/lock").open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert main([command]) == 2
    assert "another build or accept of this checkout is running" in capsys.readouterr().err


def test_cleaning_keeps_text_and_tables():
    source = {
        "cells": [cell("a", "x"), cell("b", "# t", "markdown")],
        "metadata": {"kernelspec": {"name": "odd"}},
    }
    data = {"text/plain": "<Figure>", "image/png": "iVBO", "text/html": "<b>", "application/vnd.x+json": {}}
    outputs = [
        {"output_type": "stream", "name": "stdout", "text": "sa"},
        {"output_type": "stream", "name": "stdout", "text": "id\n"},
        {"output_type": "display_data", "data": data, "metadata": {"isolated": True}},
        {"output_type": "display_data", "data": {"image/png": "iVBO"}, "metadata": {}},
        {"output_type": "stream", "name": "stdout", "text": ["more\n"]},
        {"output_type": "stream", "name": "stdout", "text": ["and ", "more\n", "lines\n"]},
    ]
    ran = {
        "cells": [{**cell("a", "x"), "outputs": outputs, "execution_count": 1}, cell("b", "# t", "markdown")]
    }
    code, text = cleaned(source, ran)["cells"]
    assert code["outputs"] == [
        {"output_type": "stream", "name": "stdout", "text": "said\n"},
        {
            "output_type": "display_data",
            "data": {"text/plain": "<Figure>", "text/html": "<b>"},
            "metadata": {},
        },
        {"output_type": "stream", "name": "stdout", "text": ["more\n", "and more\n", "lines\n"]},
    ]
    assert text == cell("b", "# t", "markdown")
