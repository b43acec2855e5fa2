"""A notebook's page: where its figures go and where its numbers are compared with the ledger."""

import contextlib
import json
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from workbook import paths
from workbook.checks import InputError, require_choice, require_kind, short_repr
from workbook.claims import Claim, ClaimsTable, ledger, make_claim
from workbook.conclusions import Sentence, banner, found_here, other_settings, sentence
from workbook.figures import plotted, save, use_house_style

# Letters, digits, - and _, with dots inside: a name that is a file's on every system, and no path.
_NAME = re.compile(r"(?=.{1,100}$)[A-Za-z0-9][A-Za-z0-9_-]*(\.[A-Za-z0-9_-]+)*")


@dataclass
class Page:
    """The page of one notebook: ``page = Page("isolation/02-convergence")``.

    In a build it writes to the folder that the runner gives, in Jupyter to ``build/interactive/``. It sets
    matplotlib's settings to those of the workbook's figures.

    Attributes
    ----------
    notebook : str
        Topic and name of the notebook, without suffix.
    claims : ClaimsTable
        What the notebook has claimed so far, ten of it as a table; show it at the end.
    conclusions : list of str
        The sentences of this run, see `conclude`.
    """

    notebook: str
    claims: ClaimsTable = field(default_factory=ClaimsTable, init=False, repr=False)
    conclusions: list[str] = field(default_factory=list, init=False, repr=False)
    _rounding: dict[str, dict[str, str]] = field(default_factory=dict, init=False, repr=False)
    _accepted: dict[str, Claim] = field(default_factory=dict, init=False, repr=False)
    _handle: Any = field(default=None, init=False, repr=False)

    def __post_init__(self):
        topic, _, name = require_kind("notebook", self.notebook, str).partition("/")
        if not paths.is_topic(topic) or not _NAME.fullmatch(name):
            raise InputError(
                f"notebook is {short_repr(self.notebook)}; give 'topic/name', e.g. 'topic/02-result'"
            )
        use_house_style()

    def _warn(self) -> None:
        """Where the settings are not the accepted ones, show above the first claim which they are and what that moved."""
        here = shell()
        settings = other_settings(self.notebook, here.user_ns.get("In", ())) if here is not None else ""
        if not settings and self._handle is None:
            return
        from IPython.display import display

        if not self._accepted:
            with contextlib.suppress(InputError):  # of what is not written yet
                self._accepted = {
                    each.entry.id: each for each in ledger(topic=self.notebook.partition("/")[0])
                }
        self.claims.note = banner(settings, self.claims.claims, self._accepted)
        shown = Sentence(self.claims.note.replace("\n", "  \n"))  # line breaks of Markdown
        if self._handle is None:
            self._handle = display(shown, display_id=True)
        else:
            self._handle.update(shown)

    def save(
        self, name: str, figure, rounding: Mapping[str, str] | None = None, *, shown: bool = True
    ) -> None:
        """Write ``<name>.png`` and the plotted numbers ``<name>.csv``, and show the picture in the notebook.

        Parameters
        ----------
        name : str
            Of the files, without suffix.
        figure : matplotlib.figure.Figure
        rounding : mapping of str to str, optional
            Series, by their labels, whose numbers are rounding itself, and why: another processor gives others
            of the same size. They are noted in ``rounding.json`` beside the figure; a rebuilt one has to agree
            with them within a factor of ten.
        shown : bool
            Not in an appendix.

        Raises
        ------
        InputError
            When the name is none of letters, digits, ``-``, ``_`` and dots inside, `figure` is no whole figure, a
            formula in it cannot be set, no series has such a label, or a reason is no text or empty.
        """
        from matplotlib.figure import Figure

        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise InputError(
                f"name is {short_repr(name)}; give at most 100 letters, digits, - or _, e.g. 'fig-5'"
            )
        require_kind("figure", figure, Figure)
        if rounding:
            require_kind("rounding", rounding, Mapping)
            drawn = {series for _, series, *_ in plotted(figure)}
            for series, why in rounding.items():
                require_choice("rounding", series, drawn)
                if not isinstance(why, str) or not why.strip():
                    raise InputError(f"rounding: state why {series!r} is rounding")
        saved = save(figure, paths.output(self.notebook) / name)
        if rounding:
            self._rounding[name] = dict(rounding)
        else:
            self._rounding.pop(name, None)
        notes = saved.path.with_name("rounding.json")
        if self._rounding:
            noted = json.dumps(self._rounding, indent=1, ensure_ascii=False)
            notes.write_text(noted + "\n", encoding="utf-8")
        else:
            notes.unlink(missing_ok=True)
        if shown:
            _display(saved)

    def check(self, claim: str, ours: float, interval: tuple[float, float] | None = None) -> None:
        """Hold `ours` against the ledger's entry `claim` (with the topic in front); `claims` shows where it lies.

        Parameters
        ----------
        claim : str
            Id in ``published.toml``.
        ours : float
            The replicated value; for an ordering the fraction of runs that obey it.
        interval : tuple of float, optional
            Its interval over runs.
        """
        made = make_claim(claim, ours, interval, self.notebook)
        self.claims.add(made)
        self.claims.write(paths.output(self.notebook) / "claims.json")
        self._warn()

    def conclude(
        self, text: str, otherwise: str | None = None, /, when: bool | str | Sequence[str] = True, **values
    ) -> None:
        """Show a sentence with the numbers of this run in it, so that it never outlives them.

        ``page.conclude("FeRLS is {ratio:.1f} times as fast.", "FeRLS is not faster: {ratio:.1f}.", when=ratio > 1, ratio=ratio)``

        Parameters
        ----------
        text : str
            Markdown with places for the values, as `str.format` has them.
        otherwise : str, optional
            The sentence where `when` does not hold; by default `text` behind "Not found in this run:".
        when : bool, str or sequence of str
            What the sentence rests on: a truth of this run, or ids of judged entries that this run has to find.
        **values
            The numbers; words that follow from them come from `workbook.conclusions.sense`.

        Raises
        ------
        InputError
            When a place has no value, a value no place, or an entry was not checked in this run.
        """
        _display(Sentence(self.sentence(text, otherwise, when, values)))

    def sentence(
        self, text: str, otherwise: str | None, when: bool | str | Sequence[str], values: Mapping[str, object]
    ) -> str:
        """The sentence that `conclude` shows, kept in `conclusions`."""
        named = isinstance(when, str) or (isinstance(when, Sequence) and len(when) > 0)
        holds = found_here(when, self.claims.claims) if named else bool(when)
        self.conclusions.append(sentence(text, otherwise, holds, values))
        return self.conclusions[-1]

    def show(self, *values, **options) -> None:
        """Show words, numbers and tables, one below the other.

        Parameters
        ----------
        *values
            A table of pandas is shown as one, and committed as text.
        **options
            Of `pandas.DataFrame.to_string` and `to_html`, as ``float_format="{:.2f}".format``.
        """
        for value in values:
            words = Sentence(value) if isinstance(value, str) else value
            _display(Table(value, options) if hasattr(value, "to_string") else words)

    def appendix(self, **settings) -> None:
        """Run the function ``appendix`` of the module beside the notebook, and show one line of it.

        It is called as ``appendix(page, **settings)`` with a `workbook.appendix.Appendix`; what it checks and saves belongs to
        this notebook. The site shows it whole.

        Parameters
        ----------
        **settings
            What it needs of the notebook: parameters and results.

        Raises
        ------
        InputError
            When the notebook has not imported the module, or that has no such function.
        """
        from workbook.appendix import Appendix, function_of

        made = Appendix(self)
        rest = self.claims.rest
        function_of(self.notebook)(made, **settings)
        if rest.claims:
            made.text("## More numbers of this page")
            made.show(rest)
        _display(made)


@dataclass(frozen=True)
class Table:
    """A table of pandas as a notebook shows it, whole."""

    frame: Any
    options: Mapping[str, Any]

    def __repr__(self) -> str:
        return self.frame.to_string(**self.options)

    def _repr_html_(self) -> str:
        frame = self.frame.to_frame() if self.frame.ndim == 1 else self.frame
        return frame.to_html(**self.options)


def _display(shown) -> None:
    if shell() is not None:
        from IPython.display import display

        display(shown)


def shell():
    """IPython, where it runs this."""
    return sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
