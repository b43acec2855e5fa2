"""What `environment.txt` pins for this Python, and how the installed packages differ from it."""

from importlib import metadata

from workbook import paths


def pins() -> dict[str, str]:
    """Package to exact version, for the Python and the platform that run this."""
    from packaging.requirements import Requirement

    wanted = {}
    for line in (paths.root() / "environment.txt").read_text(encoding="utf-8").splitlines():
        if line and not line.startswith((" ", "#", "-")):
            requirement = Requirement(line.rstrip(" \\"))
            if requirement.marker is None or requirement.marker.evaluate():
                wanted[requirement.name] = next(iter(requirement.specifier)).version
    return wanted


def drift() -> list[str]:
    """One line for each package that is missing or of another version than pinned."""
    lines = []
    for name, wanted in pins().items():
        try:
            found = metadata.version(name)
        except metadata.PackageNotFoundError:
            lines.append(f"{name} is missing (pinned {wanted})")
            continue
        if found != wanted:
            lines.append(f"{name} is {found} (pinned {wanted})")
    return lines
