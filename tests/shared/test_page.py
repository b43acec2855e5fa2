import json
import sys
from types import ModuleType

import pytest

from workbook import figures
from workbook.appendix import KIND, Appendix
from workbook.checks import InputError
from workbook.choices.notebook_study import run_notebook
from workbook.page import Page

LEDGER = """\
[motion.gain]
place = "Table 1"
quantity = "gain"
unit = ""
published = 2.0
kind = "value"
tolerance = { relative = 0.01, source = "digits" }
[motion.order]
place = "Table 1"
quantity = "runs in this order"
unit = ""
published = 1.0
kind = "ordering"
"""


@pytest.fixture
def workbook(tmp_path, monkeypatch):
    monkeypatch.setenv("STILLWORK_ROOT", str(tmp_path))
    file = tmp_path / "data" / "motion" / "published.toml"
    file.parent.mkdir(parents=True)
    file.write_text(LEDGER, encoding="utf-8")
    return tmp_path


def drawing():
    figure, axes = figures.new()
    axes.plot([1, 2], label="line")
    axes.set_xlabel("time (s)")
    return figure


def test_in_jupyter_it_writes_below_build(workbook):
    Page("motion/01-x").save("fig-1", drawing())
    folder = workbook / "build" / "interactive" / "motion" / "01-x"
    assert sorted(file.name for file in folder.iterdir()) == ["fig-1.csv", "fig-1.png"]


def test_in_a_build_it_writes_where_the_runner_says(workbook, monkeypatch, tmp_path):
    monkeypatch.setenv("STILLWORK_OUTPUT", str(tmp_path / "given"))
    page = Page("motion/01-x")
    page.save("fig-1", drawing())
    page.check("motion.gain", 2.01)
    assert "inside" in repr(page.claims)
    assert page.check("motion.gain", 2.5, interval=(2.4, 2.6)) is None  # a word below a cell has no context
    folder = tmp_path / "given" / "motion" / "01-x"
    assert sorted(file.name for file in folder.iterdir()) == ["claims.json", "fig-1.csv", "fig-1.png"]
    assert json.loads((folder / "claims.json").read_text()) == {
        "motion.gain": {"ours": 2.5, "interval": [2.4, 2.6]}
    }
    assert "outside" in repr(page.claims)
    assert not (workbook / "build").exists()


def appendix(page, *, gain):
    page.text("## More")
    page.save("fig-2", drawing())
    page.check("motion.gain", gain)
    page.conclude("The gain is {gain:.1f}.", "It is not 2 but {gain:.1f}.", when="motion.gain", gain=gain)
    page.show("gain", gain)


def test_an_appendix_belongs_to_the_build_and_is_shown_in_a_line(workbook, monkeypatch):
    page = Page("motion/01-its-page")
    with pytest.raises(InputError, match=r"import notebooks\.motion\.its_page"):
        page.appendix(gain=3.0)
    module = ModuleType("notebooks.motion.its_page")
    module.appendix = appendix
    monkeypatch.setitem(sys.modules, module.__name__, module)
    shown = []
    monkeypatch.setattr("workbook.page._display", shown.append)
    page.appendix(gain=3.0)
    folder = workbook / "build" / "interactive" / "motion" / "01-its-page"
    assert json.loads((folder / "claims.json").read_text()) == {"motion.gain": {"ours": 3.0}}
    assert sorted(file.name for file in folder.iterdir()) == ["claims.json", "fig-2.csv", "fig-2.png"]
    assert [type(each) for each in shown] == [Appendix]  # the figure is shown there alone
    bundle = shown[0]._repr_mimebundle_()
    assert bundle["text/plain"].startswith("Appendix: 1 number and 1 picture,")
    assert bundle[KIND].split("\n\n") == [
        "## More",
        "![fig-2](fig-2.png)",
        "It is not 2 but 3.0.",
        "```\ngain\n3.0\n```\n",
    ]
    assert page.conclusions == ["It is not 2 but 3.0."]


def test_an_appendix_lists_what_the_table_of_its_page_does_not_show(workbook, monkeypatch):
    page, module, shown = Page("motion/01-its-page"), ModuleType("notebooks.motion.its_page"), []
    module.appendix = lambda page: page.text("## More")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr("workbook.page._display", shown.append)
    page.claims.most = 1
    for name in ("motion.order", "motion.gain"):
        page.check(name, 1.0)
    page.appendix()
    assert "motion.order" in repr(page.claims) and "1 more: on the page of the site" in repr(page.claims)
    *_, title, table = shown[0]._repr_mimebundle_()[KIND].split("\n\n")
    assert title == "## More numbers of this page" and "motion.gain" in table and "motion.order" not in table


def test_a_study_of_a_notebook_runs_its_appendix_where_it_needs_it(workbook, monkeypatch):
    module = ModuleType("notebooks.motion.its_page")
    module.appendix = appendix
    monkeypatch.setitem(sys.modules, module.__name__, module)
    sources = {
        "begin": "from workbook.page import Page\npage = Page('motion/01-its-page')",
        "parameters": "gain: float = 2.0  # 1",
        "order": "page.check('motion.order', 1.0)",
        "appendix": "page.appendix(gain=gain)",
    }
    cells = [
        {"cell_type": "code", "metadata": {"tags": [name]}, "source": source}
        for name, source in sources.items()
    ]
    file = workbook / "notebooks" / "motion" / "01-its-page.ipynb"
    file.parent.mkdir(parents=True)
    file.write_text(json.dumps({"cells": cells}))
    assert run_notebook("motion/01-its-page", ("motion.gain",), {"gain": 5.0}) == {"motion.gain": 5.0}
    module.appendix = None  # which this one does not need
    assert run_notebook("motion/01-its-page", ("motion.order",), {}) == {"motion.order": 1.0}


@pytest.mark.slow
def test_series_that_are_rounding_are_noted_with_the_reason_until_saved_without(workbook):
    page = Page("motion/01-x")
    noted = workbook / "build" / "interactive" / "motion" / "01-x" / "rounding.json"
    notes = {"fig-2": {"line": "residual of an identity"}, "fig-3": {"line": "ε times the condition"}}
    page.save("fig-1", drawing())
    for name, rounding in notes.items():
        page.save(name, drawing(), rounding=rounding)
    assert json.loads(noted.read_text(encoding="utf-8")) == notes
    page.save("fig-2", drawing())
    assert json.loads(noted.read_text(encoding="utf-8")) == {"fig-3": notes["fig-3"]}
    Page("motion/01-x").save("fig-3", drawing())  # a notebook that is run again
    assert not noted.exists()


@pytest.mark.parametrize("layout", ["constrained", None])
@pytest.mark.parametrize("wrong", [r"$\frac{$", "good\n$x^{$", r"$\nothing$"])
def test_a_formula_that_cannot_be_set_is_named(workbook, wrong, layout):
    figure = drawing()
    figure.set_layout_engine(layout or "none")
    figure.axes[0].set_ylabel(wrong)
    with pytest.raises(InputError, match=r"^figure\b") as told:
        Page("motion/01-x").save("fig-1", figure)
    assert wrong.splitlines()[-1].strip("$") in str(told.value)
