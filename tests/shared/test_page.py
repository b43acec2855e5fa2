import json
from dataclasses import replace

import pytest
from matplotlib.figure import Figure

from stillwork.base.checks import InputError
from workbook import figures, paths
from workbook.claims import Claim, Entry, Tolerance, ledger
from workbook.headlines import headlines, summary_of
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
    "name", [*"../x a/b /tmp/x a\\b .x x. a..b .. -x é a:b".split(), "", "a b", "a\n", "n" * 300]
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
        "",
        *"motion moton/01-x motion/ motion/../x motion/a/b motion/..".split(),
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


def test_the_summary_has_what_was_published_and_found():
    name = "motion/09-bandwidth-table"
    summary = summary_of(name)
    claims = {claim.entry.id: claim for claim in ledger(topic="motion")}
    assert 0 < len(summary.lines) <= 5
    first = summary.lines[0]
    assert first.claim == claims["motion.bandwidth.pid"]  # what the thesis says of itself first
    low, high = first.claim.interval
    assert f"Published 37 Hz. We find {first.claim.ours:.4g} Hz ({low:.3g} to {high:.3g})." in repr(summary)
    assert (
        f"agrees under {first.robustness.agree} of {first.robustness.tried} combinations"
        in first.open_choices
    )
    # The mark is that over the open choices: the number agrees at the default, and depends on them.
    assert (first.claim.verdict, first.status) == ("replicated", "depends")
    assert repr(summary).splitlines()[0].startswith("◐")
    assert "<li>◐ <strong>bandwidth with PID</strong>" in summary._repr_html_()


@pytest.mark.parametrize("name", ["fixedpoint/02-small-noise", "fixedpoint/05-differentiation-noise"])
def test_a_summary_has_its_own_page_s_entries_alone(name):
    """Though the code of the page makes the ends of ids, which fit those of other pages."""
    assert {line.claim.notebook for line in summary_of(name).lines} == {name}


def test_a_statement_is_said_to_hold_and_holds_in_a_share_of_the_cases():
    entry = Entry("motion.order.a", "section 1", "runs in which it holds", "1", "ordering", 1.0)
    line = headlines([Claim(entry, 0.075, (0.0258, 0.199))], {})[0]
    assert line.found == "Claimed to hold always. Not found: it holds in 7.5 % of cases (2.58 to 19.9 %)."


@pytest.mark.parametrize(
    ("interval", "text"),
    [
        ((0.84, 1.1), "We find 0.84 instead (0.84 to 1.1; 0.84 is judged, to within 5 %)."),
        ((0.8, 0.9), "We find 0.84 instead (0.8 to 0.9)."),
        ((0.84, 0.84), "We find 0.84 instead."),
    ],
)
def test_an_interval_that_holds_what_deviates_says_what_is_judged(interval, text):
    rule = Tolerance("digits", relative=0.05)
    entry = Entry("motion.ratio.a", "section 1", "ratio", "1", "value", 1.0, rule)
    assert headlines([Claim(entry, 0.84, interval)], {})[0].found == f"Published 1. {text}"


def test_marked_entries_come_first_and_what_is_not_computed_is_not_hidden():
    rule = Tolerance("digits", relative=0.1)
    entries = [Entry(f"motion.table-{k}.a", f"Table {k}", "time", "s", "value", 2.0, rule) for k in range(7)]
    marked = [replace(entry, headline=entry.id[13] in "36") for entry in entries]
    assert [line.claim.entry.id[13] for line in headlines([Claim(e, 2.0) for e in marked], {})] == ["3", "6"]
    drawn = headlines([Claim(entry) for entry in entries], {}, ["motion.table-5.a"], "table-2")
    assert [line.claim.entry.id[13] for line in drawn] == ["5", "2", "0", "1", "3"]
    assert drawn[0].text == "time (Table 5): Published 2 s. Not computed yet."
    assert [line.mark for line in headlines([Claim(entries[0], 4.0), Claim(entries[1], 2.1)], {})] == [
        "◆",
        "●",
    ]


def test_a_saved_figure_is_shown_wherever_it_stands_in_its_cell(workbook, monkeypatch):
    shown = []
    monkeypatch.setattr("IPython.display.display", shown.append)
    Page("motion/01-x").save("fig-1", drawing())
    assert not shown  # outside IPython
    monkeypatch.setattr("workbook.page._shell", lambda: object())
    Page("motion/01-x").save("fig-1", drawing())
    assert [repr(each) for each in shown] == ["fig-1.png, fig-1.csv"]


def test_the_claims_are_a_table_for_jupyter(workbook):
    page = Page("motion/01-x")
    page.check("motion.gain", 2.5, interval=(2.4, 2.6))
    html = page.claims._repr_html_()
    assert "<th>published</th>" in html and "<td>2.4 .. 2.6</td>" in html and "<td>motion.gain</td>" in html


def test_jupyter_shows_the_summary_and_a_build_does_not(monkeypatch):
    shown = []
    monkeypatch.setattr("IPython.display.display", shown.append)
    monkeypatch.setattr("workbook.page._in_jupyter", lambda: True)
    Page("motion/09-bandwidth-table")
    assert len(shown) == 1 and shown[0].lines
    Page("motion/99-not-written-yet")
    monkeypatch.setenv("STILLWORK_OUTPUT", "/somewhere")
    Page("motion/09-bandwidth-table")
    assert len(shown) == 1
