"""The ledger as text: for a terminal, and as the summary that stands in the README."""

from collections import Counter

from stillwork.base import paths
from stillwork.workbook.claims import BASES, Claim, ledger

BEGIN, END = "<!-- ledger:begin -->", "<!-- ledger:end -->"
VERDICTS = ("replicated", "deviates", "reported", "not built")


def published_quantity(claim: Claim) -> str:
    """The published value with its unit; of an ordering, the share of cases in which it holds."""
    return _quantity(claim, claim.entry.published, f"{claim.entry.published:.4g}")


def our_quantity(claim: Claim) -> str:
    """The value found, as `published_quantity`; empty where nothing was."""
    return "" if claim.ours is None else _quantity(claim, claim.ours, claim.shown(4))


def _quantity(claim: Claim, value: float, text: str) -> str:
    if claim.entry.kind == "ordering":
        return "always" if value == 1 else "never" if value == 0 else f"in {100 * value:.3g} % of cases"
    unit = claim.entry.unit
    return text if unit in ("", "1") else f"{text} {unit}"


def ledger_text(claims: list[Claim]) -> str:
    """Table of all claims, the reasons of those that are not replicated, and the counts."""
    rows = [("claim", "place", "published", "ours", "interval", "unit", "kind", "verdict")]
    for claim in claims:
        entry = claim.entry
        ours = "" if claim.ours is None else claim.shown(4)
        spread = "{:.3g} .. {:.3g}".format(*claim.interval) if claim.interval else ""
        verdict = claim.verdict if entry.basis == "predicted" else f"{claim.verdict} ({entry.basis})"
        rows.append(
            (entry.id, entry.place, f"{entry.published:.4g}", ours, spread, entry.unit, entry.kind, verdict)
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows]
    lines.insert(1, "-" * max(map(len, lines)))
    reasons = [
        f"{claim.entry.id}: {claim.entry.reason}"
        for claim in claims
        if claim.entry.reason and claim.verdict != "replicated"
    ]
    counts = Counter(claim.verdict for claim in claims)
    total = ", ".join(f"{counts[verdict]} {verdict}" for verdict in VERDICTS if counts[verdict])
    return "\n".join([*lines, *(["", *reasons] if reasons else []), "", total or "no entries"])


def summary() -> str:
    """Markdown table of the verdicts, a row a room; `replicated` is split by what it rests on."""
    kinds = [f"replicated, {basis}" for basis in BASES] + ["deviates", "reported"]
    lines = [
        "| room | numbers | " + " | ".join(kinds) + " |",
        "|---|" + "---:|" * (len(kinds) + 1),
    ]
    for room in paths.ROOMS:
        claims = ledger(room=room)
        counts = Counter(
            f"replicated, {claim.entry.basis}" if claim.verdict == "replicated" else claim.verdict
            for claim in claims
        )
        if claims:
            numbers = " | ".join(str(counts[kind]) for kind in kinds)
            lines.append(f"| `{room}` | {len(claims)} | {numbers} |")
    return "\n".join(lines)


def readme_with_summary(text: str) -> str:
    """`text` with the block between the ledger's marks made anew; unchanged where it has no marks."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    return f"{before}{BEGIN}\n{summary()}\n{END}{after}" if begin and end else text
