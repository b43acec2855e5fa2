"""The head of a notebook's page: a few claims, what was published and what we find, from the ledger alone."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from html import escape

from workbook import paths
from workbook.checks import read_toml
from workbook.choices.judging import Robustness
from workbook.claims import DISAGREEMENT, MOSTLY, NOT_REPLICATED, RARELY, REPLICATED, Claim
from workbook.report import interval_text, our_quantity, published_quantity

MOST = 5  # claims at the head of a page
MARKS = {REPLICATED: "●", "passes": "●", MOSTLY: "◐", RARELY: "◐", NOT_REPLICATED: "◆", "fails": "◆"}


def over_combinations(standing: Robustness) -> str:
    """Under how many combinations of open choices a judged entry agrees, and what decides it.

    Parameters
    ----------
    standing : Robustness
    """
    tried = standing.tried
    if standing.agree == 0:
        return f"differs under all {tried} combinations"
    number = f"all {tried}" if standing.agree == tried else f"{standing.agree} of {tried}"
    decided = f", decided by {' and '.join(standing.decided_by)}" if standing.decided_by else ""
    return f"agrees under {number} combinations{decided}"


@dataclass(frozen=True)
class Headline:
    """One claim in a sentence.

    Attributes
    ----------
    claim : Claim
    """

    claim: Claim

    @property
    def mark(self) -> str:
        return MARKS.get(self.claim.verdict, "○")

    @property
    def found(self) -> str:
        """What was published and what we find, each with its unit; the interval where there is one."""
        claim, entry = self.claim, self.claim.entry
        published, ours = published_quantity(claim), our_quantity(claim)
        lead = "Claimed to hold" if entry.is_fraction else "Published"
        words = f"{lead} {published}." if published else "No number published."
        if claim.ours is None:
            return f"{words} Not computed yet."
        interval = f" ({text})" if (text := interval_text(claim)) else ""
        if not entry.is_fraction:
            instead = " instead" if published and claim.here in DISAGREEMENT else ""
            return f"{words} We find {ours}{instead}{interval}."
        holds = f"it {ours} holds" if ours in ("always", "never") else f"it holds {ours}"
        holds = f"Not found: {holds}" if claim.here in DISAGREEMENT else holds.capitalize()
        return f"{words} {holds}{interval}."

    @property
    def judged(self) -> str:
        """The verdict, under how many combinations of open choices it agrees, and what decides that."""
        claim, over = self.claim, self.claim.over
        word = claim.verdict.capitalize()
        if over is None or over.share is None or claim.verdict == "not judged":
            return f"{word}."
        return f"{word}: {over_combinations(over)}."

    @property
    def text(self) -> str:
        entry = self.claim.entry
        return " ".join(filter(None, [f"{entry.quantity} ({entry.place}):", self.found, self.judged]))


def headlines(
    claims: list[Claim],
    said: Sequence[str] = (),
    first_figure: str = "",
) -> list[Headline]:
    """At most `MOST` claims of one notebook: those that the ledger marks; without such the paper's own claims
    first, then those of the page's first figure, then the others, what is judged first.

    Parameters
    ----------
    claims : list of Claim
        Of the notebook, in the ledger's order.
    said : sequence of str
        The paper's own headline entries, see `said_first`.
    first_figure : str
        Name of the page's first figure, as the second part of an id has it.
    """
    marked = [claim for claim in claims if claim.entry.headline]
    replications = [claim for claim in claims if claim.entry.is_replication] or claims

    def rank(claim: Claim) -> tuple[bool, bool, bool]:
        name = claim.entry.id
        return name not in said, claim.entry.kind == "reported", name.split(".")[1] != first_figure

    chosen = marked or sorted(replications, key=rank)
    return [Headline(claim) for claim in chosen[:MOST]]


def said_first(topic: str) -> list[str]:
    """Entries that ``paper.toml`` names as the paper's own claims."""
    file = paths.data(topic, "paper.toml")
    given = read_toml(file) if file.is_file() else {}
    return [
        each["entry"] for field in ("headline", "found") for each in given.get(field, []) if "entry" in each
    ]


@dataclass(frozen=True)
class Summary:
    """The headlines as Jupyter shows them, behind what a run with other settings says first."""

    lines: tuple[Headline, ...]
    note: str = ""

    def __repr__(self) -> str:
        return "\n".join([*self.note.splitlines(), *(f"{line.mark} {line.text}" for line in self.lines)])

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<li>{line.mark} <strong>{escape(line.claim.entry.quantity)}</strong> ({escape(line.claim.entry.place)}). "
            f"{escape(line.found)} {escape(line.judged)}</li>"
            for line in self.lines
        )
        note = "".join(f"<p>{escape(line)}</p>" for line in self.note.splitlines())
        return f"{note}<ul style='list-style: none; padding-left: 0'>{rows}</ul>"


def claims_of(notebook: str) -> list[Claim]:
    """The claims of a notebook (``topic/name``) by its committed results, and those that its code names and no build has judged."""
    from workbook import notebook_source
    from workbook.choices.command import judged_ledger
    from workbook.claims import load_entries
    from workbook.notebooks import read_notebook

    topic = notebook.partition("/")[0]
    source = "\n".join(read_notebook(notebook).cells.values())
    ids = notebook_source.claims_checked(source, list(load_entries(topic)))
    return [
        claim
        for claim in judged_ledger(topic)
        if (claim.notebook == notebook if claim.notebook else claim.entry.id in ids)
    ]


def summary_of(
    notebook: str, accepted: list[Claim] | None = None, found: Sequence[Claim] = (), note: str = ""
) -> Summary:
    """The headlines of a notebook (``topic/name``), by a run where it has found them; of one without entries it is empty.

    Parameters
    ----------
    notebook : str
    accepted : list of Claim, optional
        As `claims_of` gives them, which is the default.
    found : sequence of Claim
        What the run has found so far.
    note : str
        What a run with other settings says first (`workbook.conclusions.banner`); with it, accepted values are not shown.
    """
    from workbook import notebook_source
    from workbook.notebooks import read_notebook

    mine = claims_of(notebook) if accepted is None else accepted
    source = "\n".join(read_notebook(notebook).cells.values())
    first = next(
        iter(notebook_source.figures_saved(source, [claim.entry.id.split(".")[1] for claim in mine])), ""
    )
    now = {claim.entry.id: (claim.ours, claim.interval) for claim in found}
    lines = []
    for line in headlines(mine, said_first(notebook.partition("/")[0]), first):
        claim = line.claim
        before = (None, None) if note else (claim.ours, claim.interval)
        ours, interval = now.get(claim.entry.id, before)
        lines.append(Headline(replace(claim, ours=ours, interval=interval)))
    return Summary(tuple(lines), note)
