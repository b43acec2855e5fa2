"""What is judged beside a page's answer: shown in one line by the notebook, whole by the site."""

import sys
from dataclasses import dataclass, field
from typing import Any

from workbook.checks import InputError

KIND = "text/vnd.workbook.appendix"  # of the output that holds it, in Markdown


def module_name(notebook: str) -> str:
    """The module beside a notebook: ``notebooks.isolation.convergence`` of ``isolation/02-convergence``."""
    topic, _, name = notebook.partition("/")
    return f"notebooks.{topic}.{name.partition('-')[2].replace('-', '_')}"


def function_of(notebook: str):
    """The function ``appendix`` of the module beside a notebook.

    Raises
    ------
    InputError
        When the notebook has not imported that module, so that no build would follow its changes, or it has none.
    """
    name = module_name(notebook)
    function = getattr(sys.modules.get(name), "appendix", None)
    if function is None:
        raise InputError(f"appendix: import {name} in the notebook, and define appendix(page, ...) there")
    return function


@dataclass
class Appendix:
    """The page, as the function ``appendix`` has it: `text` and `show` add to it, `save`, `check` and `conclude` are the page's.

    Attributes
    ----------
    page : Page or its stand-in
    parts : list of str
        Markdown; a picture has a part of its own.
    """

    page: Any
    parts: list[str] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=lambda: {"numbers": 0, "pictures": 0})

    def text(self, markdown: str) -> None:
        """Add prose and equations."""
        self.parts.append(markdown.strip())

    def show(self, *values, **options) -> None:
        """Add words, numbers and tables, one below the other, also of several calls; `options` as of `workbook.page.Page.show`."""
        lines = [each.to_string(**options) if hasattr(each, "to_string") else str(each) for each in values]
        above = (
            self.parts.pop().removesuffix("```")
            if self.parts and self.parts[-1].startswith("```")
            else "```\n"
        )
        self.parts.append(above + "\n".join(lines) + "\n```")

    def save(self, name: str, figure, rounding=None) -> None:
        """`workbook.page.Page.save`, shown here."""
        self.page.save(name, figure, rounding, shown=False)
        self.counts["pictures"] += 1
        self.parts.append(f"![{name}]({name}.png)")

    def check(self, claim: str, ours: float, interval=None) -> None:
        """`workbook.page.Page.check`."""
        self.counts["numbers"] += 1
        self.page.check(claim, ours, None if interval is None else tuple(interval))

    def conclude(self, text: str, otherwise: str | None = None, /, when=True, **values) -> None:
        """`workbook.page.Page.conclude`, shown here."""
        self.parts.append(self.page.sentence(text, otherwise, when, values))

    def __repr__(self) -> str:
        counts = " and ".join(
            f"{count} {what[: -1 if count == 1 else None]}" for what, count in self.counts.items() if count
        )
        return f"Appendix: {counts or 'text'}, whole on the page of the site (`make site`)."

    def _repr_mimebundle_(self, include=None, exclude=None) -> dict[str, str]:
        return {"text/plain": repr(self), KIND: "\n\n".join(self.parts) + "\n"}
