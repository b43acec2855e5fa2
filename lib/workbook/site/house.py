"""The house, read from its imports: which folder stands on which, and the picture of it in ``docs/house.svg``."""

import ast
import json
from html import escape
from itertools import pairwise
from pathlib import Path
from textwrap import wrap

from workbook import paths

TOOLBOX = (
    "base",
    "signals",
    "lti",
    "identification",
    "estimation",
    "control",
)  # each imports those before it

# Where a folder's box stands: row from the ground up, left and right edge. Arrows come from the imports.
PLACES = {
    "stillwork.base": (0, 0, 26),
    "stillwork.lti": (1, 0, 9),
    "stillwork.signals": (1, 10, 18),
    "workbook": (1, 19, 26),
    "stillwork.estimation": (2, 0, 7),
    "workbook.site": (2, 19.5, 26),
    "stillwork.control": (3, 0, 8),
    "stillwork.identification": (2, 11, 18),
    "experiments": (4, 0, 20.5),
    "notebooks": (5, 0, 20.5),
}
FILLS = {
    "workbook": "#e8f0e4",
    "workbook.site": "#e8f0e4",
    "experiments": "#f6ebda",
    "notebooks": "#f6ebda",
}
TOOLBOX_FILL = "#e2eaf4"
NOTEBOOKS = "One published result each: story, parameters, calls, figures, claims."
UNIT, HEIGHT, ROW, MARGIN = 36, 76, 114, 12
LETTER, LINE = 5.8, 15  # mean letter and line of the text in the boxes, in pixels


def modules(root: Path) -> dict[str, ast.Module]:
    """The library's modules by dotted name, and each notebook's code as ``notebooks.<room>.<notebook>``."""
    found = {}
    for file in sorted((root / "lib").rglob("*.py")):
        parts = file.relative_to(root / "lib").with_suffix("").parts
        found[".".join(part for part in parts if part != "__init__")] = ast.parse(file.read_text("utf-8"))
    for file in sorted((root / "notebooks").glob("*/*.ipynb")):
        cells = json.loads(file.read_text("utf-8"))["cells"]
        code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
        found[f"notebooks.{file.parent.name}.{file.stem}"] = ast.parse(code)
    return found


def imports(trees: dict[str, ast.Module]) -> dict[str, set[str]]:
    """Each module with those of the same tree that it imports, at its top or within a function.

    A name that a package hands out (`stillwork.base.faces`) counts as an import of the module that defines it.
    """
    faces = {module: face_names(tree) for module, tree in trees.items()}
    found = {}
    for module, tree in trees.items():
        named = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                named |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module in trees:
                face = faces[node.module]
                named |= {f"{node.module}.{face.get(alias.name, alias.name)}" for alias in node.names}
                named.add(node.module)
        found[module] = (named & trees.keys()) - {module}
    return found


def face_names(tree: ast.Module) -> dict[str, str]:
    """The names that a package hands out, with the module that defines each."""
    for statement in tree.body:
        match statement:
            case ast.Assign(value=ast.Call(func=ast.Name(id="face"), args=[_, by_module])):
                return {
                    name: module for module, names in ast.literal_eval(by_module).items() for name in names
                }
    return {}


def folder(module: str) -> str:
    """The box that a module belongs to; of no box are the command line's modules, which use every folder."""
    first, _, rest = module.partition(".")
    if first == "stillwork":
        return f"stillwork.{rest.partition('.')[0]}"
    return "workbook.site" if f"{rest}.".startswith("site.") and first == "workbook" else first


def arrows(imported: dict[str, set[str]]) -> list[tuple[str, str]]:
    """From each folder to those that it imports, without those that follow from other arrows."""
    below = {name: set() for name in PLACES}
    for module, others in imported.items():
        if (name := folder(module)) in PLACES:
            below[name] |= {folder(other) for other in others} & PLACES.keys() - {name}
    implied = {
        name: {far for near in others for far in _reached(near, below)} for name, others in below.items()
    }
    return [(name, other) for name in PLACES for other in PLACES if other in below[name] - implied[name]]


def _reached(name: str, below: dict[str, set[str]]) -> set[str]:
    reached, new = set(), {name}
    while new := {other for each in new for other in below[each]} - reached:
        reached |= new
    return reached


def paint_house(root: Path | None = None) -> str:
    """The picture as SVG; `root` is the checkout, this one by default."""
    trees = modules(root or paths.root())
    drawn = arrows(imports(trees))
    rooms = [name.split(".")[1] for name in trees if name.startswith("experiments.") and name.count(".") == 1]
    about = {name: (ast.get_docstring(tree) or "").partition("\n")[0] for name, tree in trees.items()}
    about["experiments"] = f"{', '.join(rooms)}: machines, studies and pictures; no room imports another."
    about["notebooks"] = NOTEBOOKS
    width = 2 * MARGIN + UNIT * max(right for _, _, right in PLACES.values())
    height = 2 * MARGIN + ROW * max(row for row, _, _ in PLACES.values()) + HEIGHT
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" role="img" '
        'font-family="sans-serif" font-size="12">',
        "<title>The folders of the house; an arrow leads from one to what it imports</title>",
        '<defs><marker id="head" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8" '
        'orient="auto"><path d="M0,0 L8,4 L0,8 z" fill="#444"/></marker></defs>',
        f'<rect width="{width}" height="{height}" fill="#fff"/>',
    ]
    lines += [_arrow(*_ends(upper, lower), height) for upper, lower in drawn]
    lines += [_box(name, about[name], height) for name in PLACES]
    return "\n".join([*lines, "</svg>", ""])


def _ends(upper: str, lower: str) -> tuple[float, float, float, float]:
    """An arrow's ends, x and height: straight down where nothing stands between, else to the nearest corner."""
    (row, left, right), (ground, low_left, low_right) = PLACES[upper], PLACES[lower]
    between = [(a - 0.5, b + 0.5) for level, a, b in PLACES.values() if ground < level < row]
    first, last = max(left, low_left), min(right, low_right)
    edges = sorted({first, last, *(x for pair in between for x in pair if first < x < last)})
    free = [
        (b - a, (a + b) / 2) for a, b in pairwise(edges) if not any(x <= a and b <= y for x, y in between)
    ]
    if first < last and free:
        x = max(free)[1]
        return x, row, x, ground
    return (
        (right - 1, row, low_left + 1, ground)
        if right <= low_left
        else (left + 1, row, low_right - 1, ground)
    )


def _arrow(x: float, row: int, to_x: float, to_row: int, height: int) -> str:
    start, end = _y(row, height) + HEIGHT, _y(to_row, height)
    return (
        f'<line x1="{_x(x)}" y1="{start}" x2="{_x(to_x)}" y2="{end - 1}" stroke="#444" stroke-width="1.3" '
        'marker-end="url(#head)"/>'
    )


def _box(name: str, about: str, height: int) -> str:
    row, left, right = PLACES[name]
    x, y = _x(left), _y(row, height)
    text = wrap(about, int((_x(right) - x - 2 * MARGIN) / LETTER))
    rows = "".join(
        f'<tspan x="{x + MARGIN}" dy="{LINE}">{escape(each, quote=False)}</tspan>' for each in text
    )
    return (
        f'<rect x="{x}" y="{y}" width="{_x(right) - x}" height="{HEIGHT}" rx="4" '
        f'fill="{FILLS.get(name, TOOLBOX_FILL)}" stroke="#444"/>\n'
        f'<text x="{x + MARGIN}" y="{y + LINE + 3}"><tspan font-weight="bold">{name.replace(".", "/")}</tspan>{rows}</text>'
    )


def _x(units: float) -> int:
    return MARGIN + round(UNIT * units)


def _y(row: int, height: int) -> int:
    return height - MARGIN - HEIGHT - ROW * row
