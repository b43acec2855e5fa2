"""What the site reads from notebooks, sources, formulas and docstrings."""

import re
import xml.etree.ElementTree as tree
from html.parser import HTMLParser

import pytest
from hypothesis import given
from hypothesis import strategies as st

import stillwork.lti
from stillwork.base.checks import InputError
from workbook import notebook_source
from workbook.claims import Claim, Entry, Tolerance
from workbook.site import picture, reference
from workbook.site.mathematics import markdown, mathml
from workbook.site.pages import with_outputs

IDS = ["topic.fig-1.a", "topic.fig-1.b", "topic.table-2.a"]


def test_a_page_has_the_texts_of_now_and_the_outputs_of_the_build():
    title = {"cell_type": "markdown", "id": "title", "source": "# New"}
    code = {"cell_type": "code", "id": "a", "source": "1", "outputs": []}
    added = {"cell_type": "code", "id": "b", "source": "2", "outputs": ["kept"]}
    built = [{"output_type": "stream", "name": "stdout", "text": "built"}]
    assert with_outputs([title, code, added], {"a": built}) == [title, {**code, "outputs": built}, added]


def test_claims_and_figures_are_found_in_their_order():
    source = 'page.check("topic.table-2.a", 1)\nother.check("topic.fig-1.a")\npage.check("topic.fig-1.b", 2)'
    assert notebook_source.claims_checked(source, IDS) == ["topic.table-2.a", "topic.fig-1.b"]
    assert notebook_source.figures_saved('page.save("fig-5", figure)', ["fig-5", "fig-55"]) == ["fig-5"]


def test_a_name_made_up_in_a_loop_finds_all_that_it_can_mean():
    assert notebook_source.claims_checked('for x in y: page.check(f"topic.fig-1.{x}", 0)', IDS) == IDS[:2]
    assert notebook_source.claims_checked("for x in y: page.check(x, 0)", IDS) == IDS


def test_a_cell_that_is_not_python_draws_nothing():
    assert notebook_source.figures_saved("%time page.save('a')", ["a"]) == []


def test_used_functions_carry_their_full_names():
    cells = [
        "from workbook import paths\nfrom experiments.isolation.twin import load_twin as load",
        "load(paths.data)",
    ]
    assert notebook_source.used(cells) == [
        "experiments.isolation.twin.load_twin",
        "workbook.paths",
        "workbook.paths.data",
    ]


@pytest.mark.slow
def test_every_name_of_a_module_has_a_place():
    modules = reference.read_modules()
    places = reference.index(modules)
    assert places["stillwork.signals.records.load_record"] == "stillwork.signals.records.html#load_record"
    assert places["stillwork.estimation.FeRls"] == "stillwork.estimation.adaptive.html#FeRls"
    assert {module.folder for module in modules} >= {"lti", "workbook", "isolation"}
    names = {module.name for module in modules}
    assert not [name for name in names if ".site" in name]


def test_an_example_stands_as_it_was_typed():
    html = reference.doc_html("Sum.\n\nExamples\n--------\n>>> rows(2)\narray([[1.],\n       [2.]])\n")
    shown = "&gt;&gt;&gt; rows(2)\narray([[1.],\n       [2.]])"
    assert html == f'<p>Sum.</p><h2 class="part">Examples</h2><pre tabindex="0">{shown}</pre>'


def test_a_docstring_becomes_paragraphs_definitions_and_blocks():
    html = reference.doc_html(
        "Sum <up>.\n\nOf `x`::\n\n    a < b\n\nParameters\n----------\nx : array_like, shape (n,)\n    In m.\n\nRaises\n------\nInputError\n    When not."
    )
    assert html == (
        '<p>Sum &lt;up&gt;.</p><p>Of <code>x</code>:</p><pre tabindex="0">a &lt; b</pre>'
        '<h2 class="part">Parameters</h2><dl><dt><code>x</code> <span>array_like, shape (n,)</span></dt><dd><p>In m.</p></dd></dl>'
        '<h2 class="part">Raises</h2><dl><dt><code>InputError</code></dt><dd><p>When not.</p></dd></dl>'
    )


def test_a_docstrings_formulas_are_rendered():
    html = reference.doc_html("Solves :math:`a < b` of `x`.\n\n.. math:: a^2\n    + b\n\nThen more.")
    assert html == (
        f"<p>Solves {mathml('a < b')} of <code>x</code>.</p>{mathml('a^2 + b', block=True)}<p>Then more.</p>"
    )
    shown = tree.fromstring(mathml(r"\hat x = \arg\min_x f"))
    assert "".join(shown.itertext()) == "x^=argminxf"


@pytest.mark.slow
def test_no_docstring_of_the_reference_shows_its_markup():
    for module in reference.read_modules():
        for item in module.items:
            texts = [item.doc, *(member.doc for member in item.members)]
            html = "".join(reference.doc_html(text) for text in texts)
            assert not re.search(r":math:|\.\. \w+::", html), f"{module.name}.{item.name}"


@pytest.mark.slow
@given(st.text(alphabet="ab <>&'\"`-:\n", max_size=80))
def test_no_docstring_opens_an_element_of_its_own(text):
    html = reference.doc_html(text)
    root = tree.fromstring(f"<root>{html}</root>")  # well formed
    assert {each.tag for each in root.iter()} <= {"root", "p", "pre", "code", "h4", "dl", "dt", "dd", "span"}


@pytest.mark.parametrize(
    "formula", [r"\hat P(s) = \frac{s^2}{m s^2 + d s + k}", r"|x|^2 \le \lVert y \rVert", "a<b"]
)
def test_a_formula_becomes_mathml(formula):
    root = tree.fromstring(mathml(formula))
    assert root.tag.endswith("math")
    assert "\\" not in "".join(root.itertext())


@pytest.mark.parametrize("formula", [r"\frobnicate{x}", r"\frac", r"\left( x"])
def test_an_unknown_formula_is_refused(formula):
    with pytest.raises(InputError, match="formula"):
        mathml(formula)


def test_markdown_keeps_foreign_html_and_links_out():
    html = markdown("<b onclick=x>hi</b> [a](javascript:alert(1)) [n](../motion/01-x.ipynb#there) $x<y$")
    assert "<b" not in html
    assert "javascript" not in html
    assert 'href="../motion/01-x.html#there"' in html
    assert "<math" in html


MATHML = set(
    """
    math menclose mfrac mi mn mo mover mpadded mphantom mroot mrow mspace msqrt mstyle msub msubsup
    msup mtable mtd mtext mtr munder munderover
    """.split()
)
PROSE = set(
    """
    a code div em h1 img p pre span strong table tbody td th thead tr
    """.split()
)
HARM = "<img src=x onerror=alert(1)></math><script>alert(1)</script>"


class Opened(HTMLParser):
    """Elements and attributes that a browser finds, the text between them, and where its links lead."""

    def __init__(self, html):
        super().__init__()
        self.tags, self.attributes, self.links, self.text = set(), set(), set(), ""
        self.feed(html)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.tags.add(tag)
        self.attributes |= {name for name, _ in attributes}
        self.links |= {value for name, value in attributes if name in ("href", "src")}

    def handle_data(self, data):
        self.text += data


@pytest.mark.parametrize(
    "command", "text textbf textrm mathrm operatorname mbox hbox fbox tag emph mathit color".split()
)
@pytest.mark.parametrize("place", ["{}", "# {}", "a | b\n-|-\n{} | x", "$${}$$"])
def test_no_text_in_a_formula_becomes_an_element(command, place):
    formula = rf"\{command}{{{HARM}}} x"
    page = Opened(markdown(place.format(formula if "$" in place else f"${formula}$")))
    assert page.tags <= MATHML | PROSE - {"img"} and "math" in page.tags
    assert not {name for name in page.attributes if name.startswith("on")}
    if command in ("text", "mbox", "tag"):
        assert HARM in page.text.replace("\xa0", " ")


@pytest.mark.parametrize(
    "formula", [r"\verb|<b>|", r"\text{&lt;b&gt;}", r"\unicode{x3c}b>", r"<b>", r"\lt b>"]
)
def test_a_smaller_sign_is_a_sign(formula):
    page = Opened(mathml(formula))
    assert page.tags <= MATHML and page.text == "<b>"


@pytest.mark.parametrize(
    "formula", [r"\href{javascript:alert(1)}{x}", r'\class{a" onclick="x}{y}', r"\style{position:fixed}{x}"]
)
def test_a_formula_makes_no_link_and_no_style(formula):
    with pytest.raises(InputError, match=r"formula.*(href|class|style)"):
        mathml(formula)


def test_an_attribute_of_a_formula_ends_where_it_ends():
    assert "onclick" not in Opened(mathml(r'\textcolor{red" onclick="x}{y}')).attributes


@pytest.mark.parametrize(
    "text",
    [
        HARM,
        f"a {HARM}",
        f"# {HARM}",
        f"`{HARM}`",
        f"```mermaid\n</pre>{HARM}\n```",
        f"```{HARM}\nx\n```",
        f"```python\n{HARM}\n```",
        f"    {HARM}",
        f"[{HARM}](javascript:alert(1))",
        "[x](JaVaScRiPt:alert(1))",
        "[x](java&#115;cript:alert(1))",
        "[x]( javascript&colon;alert(1))",
        "[x](data:text/html,<script>alert(1)</script>)",
        "[x](vbscript:x)",
        "[x][1]\n\n[1]: javascript:alert(1)",
        "<javascript:alert(1)>",
        f'![{HARM}](javascript:alert(1) "a\\" onload=x")',
        f"| {HARM} | b |\n|-|-|\n| {HARM} | [x](javascript:x) |",
    ],
)
def test_no_markdown_becomes_an_element_of_its_own(text):
    page = Opened(markdown(text))
    assert page.tags <= PROSE
    assert not {name for name in page.attributes if name.startswith("on")}
    assert not [link for link in page.links if re.match(r"\W*(x$|\w+script|data)", link, re.IGNORECASE)]


@pytest.mark.parametrize("end", ["", " onclick=x", "</summary><b>"])
def test_only_a_plain_fold_stays_html(end):
    html = markdown(f"<details>\n<summary{end}>Check</summary>\n\n**4** $x$\n\n</details>")
    assert ("<details>" in html) == (not end) and "<strong>4</strong>" in html
    assert not {"b", "onclick"} & set(Opened(html).tags)


def test_a_formula_in_a_heading_is_a_formula():
    assert "math" in Opened(markdown("# The law $a < b$")).tags


def claim(ours, published=2.0, **fields) -> Claim:
    tolerance = Tolerance("digits", **(fields.pop("rule", None) or {"relative": 0.1}))
    return Claim(Entry("isolation.a.b", "p", "q", "", "value", published, tolerance), ours, **fields)


def test_the_picture_s_axis_is_logarithmic_about_one():
    one, half, twice = (picture.draw([claim(ours)]).marks[0] for ours in (2.0, 1.0, 4.0))
    assert one.x == picture.WIDTH / 2
    assert one.x - half.x == pytest.approx(twice.x - one.x)
    ticks = {label: x for x, label in picture.draw([claim(2.0)]).ticks}
    assert (half.x, one.x, twice.x) == pytest.approx((ticks["½"], ticks["1"], ticks["2"]))


@pytest.mark.parametrize(
    ("ours", "edge"), [(2.0, ""), (-1.0, "left"), (0.1, "left"), (0.0, "left"), (9.0, "right")]
)
def test_what_is_off_the_scale_is_an_arrow_at_the_edge(ours, edge):
    mark = picture.draw([claim(ours)]).marks[0]
    assert mark.edge == edge
    assert picture.MARGIN <= mark.x <= picture.WIDTH - picture.MARGIN


def test_the_grey_line_is_what_the_judge_allows():
    for rule, low, high in (({"relative": 0.1}, 0.9, 1.1), ({"absolute": 1.0}, 0.5, 1.5)):
        mark = picture.draw([claim(2.0, rule=rule)]).marks[0]
        ends = [picture.draw([claim(2.0 * share)]).marks[0].x for share in (low, high)]
        assert (mark.low, mark.high) == pytest.approx(ends)
    mark = picture.draw([claim(2.0, rule={"interval": 0.95}, interval=(1.0, 4.0))]).marks[0]
    ends = [picture.draw([claim(value)]).marks[0].x for value in (1.0, 4.0)]
    assert (mark.low, mark.high) == pytest.approx(ends)


def test_zero_and_orderings_have_no_row():
    ordering = Claim(Entry("isolation.a.c", "p", "q", "", "ordering", 1.0), 1.0)
    assert (
        picture.draw([claim(1.0, published=0.0, rule={"absolute": 1.0}), ordering, claim(None)]).marks == ()
    )


@pytest.mark.slow
def test_the_reference_shows_what_a_folder_hands_out_by_concept():
    folders = {folder.name: folder for folder in reference.folders(reference.read_modules())}
    assert list(folders)[:6] == ["base", "signals", "lti", "identification", "estimation", "control"]
    handed_out = {item.name: place for place, item in folders["lti"].public}
    assert set(handed_out) == set(stillwork.lti.__all__)
    assert handed_out["simulate"] == "stillwork.lti.simulation.html#simulate"
    designs = {item.name: place for place, item in folders["motion"].public}["DESIGNS"]
    assert designs.startswith("experiments.motion.designs.html#line-")
    assert "stillwork.lti.delays" in {module.name for module in folders["lti"].modules}
    assert all(folder.doc and folder.modules for folder in folders.values())
