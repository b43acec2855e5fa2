"""What commands do that take results over, rewrite what follows from the ledger, or begin a new result."""


def accept() -> int:
    """Take the built results over, and what follows from them."""
    from workbook.accept import accept
    from workbook.site.derived import refresh

    return accept(refresh)


def refresh() -> str:
    """Rewrite what follows from ledger and notebooks; returns what was not current."""
    from workbook.site.derived import refresh

    return ", ".join(refresh()) or "all current"


def new(room: str, name: str, create: bool) -> list[str]:
    """Write the files of a new result; returns their paths, and what comes next."""
    from workbook.site.scaffold import new_result

    return [*new_result(room, name, create), f'fill them in, then: make figures ARGS="{room}/{name}"']
