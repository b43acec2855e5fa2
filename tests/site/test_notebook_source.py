"""What the site reads from notebooks, sources, formulas and docstrings."""

import re
import xml.etree.ElementTree as tree
from html.parser import HTMLParser

import pytest

from workbook import notebook_source
from workbook.site.mathematics import markdown, mathml

IDS = ["topic.fig-1.a", "topic.fig-1.b", "topic.table-2.a"]


def test_claims_and_figures_are_found_in_their_order():
    source = 'page.check("topic.table-2.a", 1)\nother.check("topic.fig-1.a")\npage.check("topic.fig-1.b", 2)'
    assert notebook_source.claims_checked(source, IDS) == ["topic.table-2.a", "topic.fig-1.b"]
    assert notebook_source.figures_saved('page.save("fig-5", figure)', ["fig-5", "fig-55"]) == ["fig-5"]
    assert notebook_source.figures_saved('page.save(f"fig-{name}", figure)', ["fig-5", "map"]) == ["fig-5"]


@pytest.mark.parametrize(
    ("source", "named"),
    [
        ("for name, value in found.items():\n    page.check(name, value)", []),
        ('for name in ("topic.fig-1.b", "topic.else"):\n    page.check(name, 1)', ["topic.fig-1.b"]),
        ('for name in ("fig-1.a", "fig-1.c"):\n    page.check(f"topic.{name}", 1)', ["topic.fig-1.a"]),
        ('page.check(f"topic.fig-1.{name}", 1)', ["topic.fig-1.a", "topic.fig-1.b"]),
    ],
)
def test_a_variable_names_no_claim_but_those_that_its_cell_writes_out(source, named):
    assert notebook_source.claims_checked(source, IDS) == named


@pytest.mark.parametrize(
    "formula", [r"\hat P(s) = \frac{s^2}{m s^2 + d s + k}", r"|x|^2 \le \lVert y \rVert", "a<b"]
)
def test_a_formula_becomes_mathml(formula):
    root = tree.fromstring(mathml(formula))
    assert root.tag.endswith("math")
    assert "\\" not in "".join(root.itertext())


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


@pytest.mark.parametrize("command", "text mathrm operatorname mbox tag color".split())
@pytest.mark.parametrize("place", ["{}", "# {}", "a | b\n-|-\n{} | x", "$${}$$"])
def test_no_text_in_a_formula_becomes_an_element(command, place):
    formula = rf"\{command}{{{HARM}}} x"
    page = Opened(markdown(place.format(formula if "$" in place else f"${formula}$")))
    assert page.tags <= MATHML | PROSE - {"img"} and "math" in page.tags
    assert not {name for name in page.attributes if name.startswith("on")}
    if command in ("text", "mbox", "tag"):
        assert HARM in page.text.replace("\xa0", " ")


@pytest.mark.parametrize(
    "text",
    [
        HARM,
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
