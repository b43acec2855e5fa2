"""The page on which a loop is shaped by hand: its style, its modules in one script, and machines, for one file or the site."""

import html
import json
import re
from collections.abc import Mapping, Sequence
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from string import Template
from typing import Any

from stillwork.signals.headings import page_table

STATIC = Path(__file__).parent / "desk_static"
# Machines of the site's desk, as `python -m stillwork desk FILE --out desk.json` wrote them.
SHIPPED = ("motion/impact_frf_25k6", "motion/your_machine")


def offline_page(machines: Sequence[Mapping[str, Any]]) -> str:
    """The page as one file that needs no other."""
    return Template((STATIC / "desk.html").read_text(encoding="utf-8")).substitute(
        title=html.escape(f"{machines[0]['name']}: desk"),
        style=f"<style>\n{style()}</style>",
        body=body(),
        script=f"<script>\n{machines_script(machines)}\n</script>\n<script>\n{script()}</script>",
    )


def shipped_machines(root: Path) -> list[dict[str, Any]]:
    """Those of `SHIPPED` that a checkout holds."""
    files = [root / "data" / name / "desk.json" for name in SHIPPED]
    return [json.loads(file.read_text(encoding="utf-8")) for file in files if file.is_file()]


def site_page(root: Path) -> dict[str, Any]:
    """The page as a part of the site of a checkout, with its shipped machines; empty where it holds none."""
    machines = shipped_machines(root)
    if not machines:
        return {}
    return {
        "title": "Desk",
        "description": "Shape a loop by hand on a measured frequency response, in the browser; nothing leaves the page.",
        "body": body(),
        "files": {"desk.css": style(), "desk-machines.js": machines_script(machines), "desk.js": script()},
    }


def body() -> str:
    """What the page shows before its script has run."""
    return (STATIC / "body.html").read_text(encoding="utf-8")


def style() -> str:
    """The page's style."""
    return (STATIC / "desk.css").read_text(encoding="utf-8")


def machines_script(machines: Sequence[Mapping[str, Any]]) -> str:
    """The machines as a script holds them: no text of a file can end it."""
    text = json.dumps(list(machines), allow_nan=False, separators=(",", ":"))
    return f"window.deskMachines = {text};".replace("<", "\\u003c")


@cache
def modules() -> dict[str, str]:
    """The page's modules by name: those of its folder, and the table by which it reads the names of columns."""
    own = {file.name: file.read_text(encoding="utf-8") for file in STATIC.glob("*.js")}
    return own | {"units.js": f"export const TABLE = {json.dumps(page_table())};\n"}


@cache
def script() -> str:
    """All modules in one script, each in a function of its own, those that others import first."""
    every, sources, imported, wanted = modules(), {}, {}, ["main.js"]
    while wanted:
        name = wanted.pop()
        sources[name] = every[name]
        imported[name] = re.findall(r'from "\./([\w.]+)"', sources[name])
        wanted += [each for each in imported[name] if each not in sources]
    parts = [_scoped(name, sources[name]) for name in TopologicalSorter(imported).static_order()]
    return '"use strict";\nconst deskModules = {};\n' + "\n".join(parts)


def _scoped(name: str, text: str) -> str:
    exported = re.findall(r"^export (?:function\*?|const) (\w+)", text, re.MULTILINE)
    text = re.sub(
        r'^import (\{[^}]*\}) from "\./([\w.]+)";', r'const \1 = deskModules["\2"];', text, flags=re.MULTILINE
    )
    text, found = re.subn(r"^export ", "", text, flags=re.MULTILINE)
    if found != len(exported):
        raise ValueError(f"{name}: write each export as `export const NAME` or `export function NAME`")
    return f'deskModules["{name}"] = (() => {{\n{text}\nreturn {{ {", ".join(exported)} }};\n}})();\n'
