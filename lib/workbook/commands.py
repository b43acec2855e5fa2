"""What commands do that are more than one call."""

from json import dumps

from workbook import paths
from workbook.checks import InputError


def figures(targets: list[str], settings: list[str], **how) -> int:
    """Build what is stale, a variant where parameters are set by ``NAME=VALUE``."""
    from workbook.build import build_figures

    chosen: dict[str, str] = {}
    for text in settings:
        name, equals, value = text.partition("=")
        if not equals or not name.isidentifier():
            raise InputError(f"-p {text!r} is not a setting; give -p NAME=VALUE")
        if name in chosen:
            raise InputError(f"-p {name} is given twice; keep one")
        chosen[name] = value
    return build_figures(*targets, settings=chosen, **how)


def claims(topic: str | None, entry: str | None, json: bool, built: bool) -> str:
    """The ledger, or one entry of it, as text."""
    from workbook import report, tasks
    from workbook.choices.command import judged_ledger

    if topic is not None:
        paths.require_topic(topic)
    found = judged_ledger(topic, tasks.built() if built else None, notes=json or bool(entry))
    if entry:
        found = [report.find(found, entry)]
    if json:
        return dumps(_with_choices(found), indent=1, ensure_ascii=False)
    if entry:
        return report.entry_text(_with_choices(found)[0], report.screen())
    return report.ledger_text(found, report.screen())


def _with_choices(claims: list) -> list[dict]:
    """The claims as plain values, each with how it stands over its combinations (None where it has none)."""
    return [
        claim.as_dict() | {"choices": claim.over.as_dict() if claim.over is not None else None}
        for claim in claims
    ]


def accept() -> int:
    """Copy the built results into the tree, and update what follows from them."""
    from workbook.accept import accept
    from workbook.site.derived import refresh

    return accept(refresh)


def refresh() -> str:
    """Rewrite what follows from ledger and notebooks; returns what was not current."""
    from workbook.site.derived import refresh

    return ", ".join(refresh()) or "all current"


def new(topic: str, name: str, create: bool) -> list[str]:
    """Write the files of a new result; returns their paths, and the next step."""
    from workbook.site.scaffold import new_result

    return [*new_result(topic, name, create), f'fill them in, then: make figures ARGS="{topic}/{name}"']
