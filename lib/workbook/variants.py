"""A variant beside the published settings: where it is, which claims moved, and a picture of both."""

import io
from pathlib import Path

from workbook import paths
from workbook.claims import Claim, ledger, make_claim, recorded_claims
from workbook.publish import replace_file
from workbook.report import screen, table
from workbook.tasks import Task

GAP, HEAD = 16, 40  # pixels: between two pictures; above them, for the words


def difference(task: Task) -> list[str]:
    """Lines for the terminal on a built variant; writes the picture of both beside its folder."""
    where = task.target.relative_to(paths.root()).as_posix()
    lines = [f"{task.label}: {where}"]
    if not task.committed.is_dir():
        return [*lines, "  the published settings have no accepted results yet to hold it against"]
    moved = _moved(task)
    if moved:
        rows = [("claim", "published", "at its settings", "here", "tolerance"), *moved]
        lines += [f"  {line}" for line in table(rows, screen() - 2)]
    else:
        lines.append("  no claim moved")
    if picture := beside(task):
        lines.append(f"  both pictures: {picture.relative_to(paths.root()).as_posix()}")
    else:
        lines.append("  no figure moved")
    return lines


def _moved(task: Task) -> list[tuple[str, ...]]:
    """Of each claim whose value is another, or inside where it was outside: what is published, accepted and found."""
    accepted = {claim.entry.id: claim for claim in ledger(topic=task.notebook.topic)}
    file = task.target / "claims.json"
    found = recorded_claims(file) if file.is_file() else {}
    rows = []
    for name, (ours, interval) in found.items():
        before, now = accepted[name], make_claim(name, ours, interval)
        if (before.ours, before.here) != (now.ours, now.here):
            published = "" if now.entry.published is None else f"{now.entry.published:.4g}"
            stands = now.here if now.here == before.here else f"{before.here} -> {now.here}"
            rows.append((name, published, _shown(before), _shown(now), stands))
    return rows


def _shown(claim: Claim) -> str:
    return "" if claim.ours is None else claim.shown(4)


def beside(task: Task) -> Path | None:
    """Write each picture that moved beside its published one, in one picture; None when none did."""
    from PIL import Image, ImageDraw, ImageFont

    pairs = []
    for file in sorted(task.target.glob("[!.]*.png")):
        published = task.committed / file.name
        if published.is_file() and published.read_bytes() != file.read_bytes():
            pairs.append([Image.open(each).convert("RGB") for each in (published, file)])
    if not pairs:
        return None
    width = max(picture.width for pair in pairs for picture in pair)
    heights = [max(picture.height for picture in pair) for pair in pairs]
    whole = Image.new("RGB", (2 * width + GAP, HEAD + sum(heights) + GAP * len(heights)), "white")
    draw, font = ImageDraw.Draw(whole), ImageFont.load_default(22)
    for x, words in ((0, "published settings"), (width + GAP, task.label)):
        draw.text((x + GAP, GAP // 2), words, "black", font)
    top = HEAD
    for pair, height in zip(pairs, heights, strict=True):
        for x, picture in zip((0, width + GAP), pair, strict=True):
            whole.paste(picture, (x, top))
        top += height + GAP
    content = io.BytesIO()
    whole.save(content, "PNG")
    target = task.target.with_name(f"{task.target.name}.png")
    replace_file(target, content.getvalue())
    return target
