import json

import pytest
from matplotlib.figure import Figure

from stillwork.base.checks import InputError
from workbook import figures, paths
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
    saved = Page("motion/01-x").save("fig-1", drawing())
    folder = workbook / "build" / "interactive" / "motion" / "01-x"
    assert saved.path == folder / "fig-1"
    assert sorted(file.name for file in folder.iterdir()) == ["fig-1.csv", "fig-1.png"]


def test_in_a_build_it_writes_where_the_runner_says(workbook, monkeypatch, tmp_path):
    monkeypatch.setenv("STILLWORK_OUTPUT", str(tmp_path / "given"))
    page = Page("motion/01-x")
    page.save("fig-1", drawing())
    assert page.check("motion.gain", 2.01) == "replicated"
    assert page.check("motion.gain", 2.5, interval=(2.4, 2.6)) == "deviates"
    folder = tmp_path / "given" / "motion" / "01-x"
    assert sorted(file.name for file in folder.iterdir()) == ["claims.json", "fig-1.csv", "fig-1.png"]
    assert json.loads((folder / "claims.json").read_text()) == {
        "motion.gain": {"ours": 2.5, "interval": [2.4, 2.6]}
    }
    assert "deviates" in repr(page.claims)
    assert not (workbook / "build").exists()


@pytest.mark.parametrize(
    "name",
    [
        "",
        "../x",
        "a/b",
        "/tmp/x",
        "a\\b",
        ".x",
        "x.",
        "a..b",
        "..",
        "-x",
        "a b",
        "é",
        "a\n",
        "a:b",
        "n" * 300,
    ],
)
def test_a_figure_has_a_name_and_no_path(workbook, name):
    page, figure = Page("motion/01-x"), drawing()
    with pytest.raises(InputError, match=r"^name\b"):
        page.save(name, figure)
    assert [file for file in workbook.rglob("*") if file.is_file()] == [
        workbook / "data/motion/published.toml"
    ]
    page.save("Fig_1-2.a", figure)


@pytest.mark.parametrize("wrong", [None, "fig-1", drawing().axes[0], Figure().subfigures(1, 1)])
def test_only_a_whole_figure_is_saved(workbook, wrong):
    with pytest.raises(InputError, match=r"^figure\b"):
        Page("motion/01-x").save("fig-1", wrong)


@pytest.mark.parametrize(
    ("claim", "value", "interval", "message"),
    [
        ("n" * 300, 1.0, None, r"^topic\b"),
        ("motion.order", 1.5, None, r"^motion\.order\b"),
        ("motion.order", 1.0, (-0.1, 1.0), r"^motion\.order\b.*-0\.1\b"),
        ("motion.order", 1.0, (0.9, 1.1), r"^motion\.order\b.*\b1\.1\b"),
    ],
)
def test_a_claim_that_cannot_be_is_refused(workbook, claim, value, interval, message):
    with pytest.raises(InputError, match=message):
        Page("motion/01-x").check(claim, value, interval)


def test_series_that_are_rounding_are_noted_with_the_reason(workbook):
    page = Page("motion/01-x")
    page.save("fig-1", drawing())
    page.save("fig-2", drawing(), rounding={"line": "residual of an identity"})
    page.save("fig-3", drawing(), rounding={"line": "ε times the condition"})
    folder = workbook / "build" / "interactive" / "motion" / "01-x"
    assert json.loads((folder / "rounding.json").read_text(encoding="utf-8")) == {
        "fig-2": {"line": "residual of an identity"},
        "fig-3": {"line": "ε times the condition"},
    }


@pytest.mark.slow
def test_a_figure_that_is_saved_anew_without_a_note_loses_it(workbook):
    page = Page("motion/01-x")
    page.save("fig-1", drawing(), rounding={"line": "residual"})
    page.save("fig-2", drawing(), rounding={"line": "residual"})
    page.save("fig-1", drawing())
    noted = workbook / "build" / "interactive" / "motion" / "01-x" / "rounding.json"
    assert json.loads(noted.read_text(encoding="utf-8")) == {"fig-2": {"line": "residual"}}
    Page("motion/01-x").save("fig-2", drawing())  # a notebook that is run again
    assert not noted.exists()


@pytest.mark.parametrize("layout", ["constrained", None])
@pytest.mark.parametrize("wrong", [r"$\frac{$", "good\n$x^{$", r"$\nothing$"])
def test_a_formula_that_cannot_be_set_is_named(workbook, wrong, layout):
    figure = drawing()
    figure.set_layout_engine(layout or "none")
    figure.axes[0].set_ylabel(wrong)
    with pytest.raises(InputError, match=r"^figure\b") as told:
        Page("motion/01-x").save("fig-1", figure)
    assert repr(wrong) in str(told.value)


@pytest.mark.parametrize(
    ("rounding", "message"),
    [
        ({"lime": "residual"}, r"^rounding\b"),
        ({"line": ""}, r"^rounding\b.*'line'"),
        ({"line": " "}, r"^rounding\b.*'line'"),
    ],
)
def test_a_note_names_a_series_and_a_reason(workbook, rounding, message):
    with pytest.raises(InputError, match=message):
        Page("motion/01-x").save("fig-1", drawing(), rounding=rounding)


@pytest.mark.parametrize(
    "name",
    [
        "motion",
        "moton/01-x",
        "motion/",
        "",
        "motion/../x",
        "motion/a/b",
        "motion/..",
        "motion/ x",
        "motion/" + "n" * 300,
    ],
)
def test_a_page_has_a_topic_and_a_name(name):
    with pytest.raises(InputError, match=r"^notebook\b"):
        Page(name)


def test_two_pages_do_not_share_claims(workbook):
    first, second = Page("motion/01-x"), Page("motion/02-y")
    first.check("motion.gain", 2.0)
    assert second.claims.claims == []


def test_the_root_is_the_checkout_or_what_the_variable_says(workbook, monkeypatch, tmp_path):
    assert paths.root() == workbook
    monkeypatch.setenv("STILLWORK_ROOT", str(tmp_path / "nowhere"))
    with pytest.raises(FileNotFoundError, match="STILLWORK_ROOT"):
        paths.root()
    monkeypatch.delenv("STILLWORK_ROOT")
    assert (paths.root() / "lib" / "stillwork").is_dir()
