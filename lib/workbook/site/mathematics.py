"""Markdown with formulas to HTML with MathML: the browser needs no script and no network to show them."""

import re
from functools import cache
from html import unescape
from xml.etree.ElementTree import tostring

from latex2mathml.converter import convert_to_element
from nbconvert.filters.markdown_mistune import IPythonRenderer, MarkdownWithMath

from workbook.checks import InputError

# What a link, a script or a style sheet could hang on to: formulas have none.
_FOREIGN = {"href", "class", "style"}


def mathml(formula: str, block: bool = False) -> str:
    """MathML of a LaTeX formula; what stands in a text of it is shown as text.

    Raises
    ------
    InputError
        When a command of it is unknown to the converter, or makes a link or a style.
    """
    try:
        known = re.sub(r"\\arg\b", r"\\operatorname{arg}", formula)  # the only common word that it lacks
        root = convert_to_element(known.strip(), display="block" if block else "inline")
    except Exception as error:  # the converter raises a class of its own for every kind of mistake
        raise InputError(
            f"the formula {formula!r} cannot be rendered ({error!r}); write it simpler"
        ) from None
    # The converter means its characters as references, which would be escaped with what the author wrote.
    for each in root.iter():
        each.text = unescape(each.text or "")
        each.attrib = {name: unescape(value) for name, value in each.attrib.items()}
        if foreign := _FOREIGN & set(each.attrib):
            raise InputError(
                f"the formula {formula!r} sets {min(foreign)}; write links and styles outside of it"
            )
    del root.attrib["xmlns"]  # a page needs none, and in a heading it would become a prefix
    rendered = tostring(root, encoding="unicode")
    if unknown := re.search(r"\\[a-zA-Z]+", rendered):
        raise InputError(f"the formula {formula!r} uses {unknown[0]}, which is unknown; write it otherwise")
    return rendered


def equation(formula: str) -> str:
    """A displayed formula, in a box that scrolls where it is wider than its place."""
    return f'<span class="equation">{mathml(formula, block=True)}</span>'


# The only HTML of a text that stays HTML, besides a line break: what hides an answer behind a click.
_FOLD = re.compile(r"<details>\n<summary>[\w ,]+</summary>|</details>")


class _Renderer(IPythonRenderer):
    """Other HTML in the text than `_FOLD` and ``<br>`` is shown as text; links to notebooks, guides and their code lead to the pages."""

    def __init__(self):
        super().__init__(escape=True, allow_harmful_protocols=False, anchor_link_text="#")

    def block_html(self, html: str) -> str:
        return html if _FOLD.fullmatch(html.strip()) else super().block_html(html)

    def inline_html(self, html: str) -> str:
        return html if html == "<br>" else super().inline_html(html)

    def block_mermaidjs(self, code: str) -> str:
        return self.block_code(code)  # no script draws it here, and the base class would not escape it

    def table(self, text: str) -> str:
        return f'<table tabindex="0">\n{text}</table>\n'  # a wide one slides on a phone, by the keyboard too

    def inline_math(self, body: str) -> str:
        return mathml(body)

    def block_math(self, body: str) -> str:
        return equation(body)

    def latex_environment(self, name: str, body: str) -> str:
        return equation(rf"\begin{{{name}}}{body}\end{{{name}}}")

    def multiline_math(self, text: str) -> str:
        return equation(text.strip().removeprefix("$$").removesuffix("$$"))

    def link(self, text: str, url: str, title: str | None = None) -> str:
        if ":" not in url:
            url = re.sub(r"\.(ipynb|md|py)(?=$|#)", ".html", url)
        return super().link(text, url, title)


@cache
def markdown(text: str) -> str:
    """HTML of a markdown text with ``$...$`` and ``$$...$$`` formulas."""
    return MarkdownWithMath(renderer=_Renderer()).render(text)
