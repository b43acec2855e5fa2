"""Which module imports which, read from the library and the notebooks without running them."""

import ast
import json
from pathlib import Path

from IPython.core.inputtransformer2 import TransformerManager

from workbook.site.reference import face_names


def modules(root: Path) -> dict[str, ast.Module]:
    """The modules by dotted name, and each notebook's code as ``notebooks.<topic>.<notebook>``."""
    found = {}
    files = [(root / "lib", file) for file in sorted((root / "lib").rglob("*.py"))]
    files += [
        (root, file) for name in ("contest", "notebooks") for file in sorted((root / name).rglob("*.py"))
    ]
    for place, file in files:
        parts = file.relative_to(place).with_suffix("").parts
        found[".".join(part for part in parts if part != "__init__")] = ast.parse(file.read_text("utf-8"))
    for file in sorted((root / "notebooks").glob("*/*.ipynb")):
        cells = json.loads(file.read_text("utf-8"))["cells"]
        code = [plain("".join(cell["source"])) for cell in cells if cell["cell_type"] == "code"]
        found[f"notebooks.{file.parent.name}.{file.stem}"] = ast.parse("\n".join(code))
    return found


def plain(cell: str) -> str:
    """The Python of a cell: magics and shell commands of IPython are calls of it."""
    return TransformerManager().transform_cell(cell)


def imports(trees: dict[str, ast.Module]) -> dict[str, set[str]]:
    """Each module with those of the same tree that it imports, at its top or within a function.

    A public name of a package (`stillwork.base.lazy_exports`) counts as an import of the module that defines it.
    """
    faces = {module: face_names(tree) for module, tree in trees.items()}
    found = {}
    for module, tree in trees.items():
        named = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                named |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                face = faces.get(node.module, {})  # none of a folder that is no module
                named |= {f"{node.module}.{face.get(alias.name, alias.name)}" for alias in node.names}
                named.add(node.module)
        found[module] = (named & trees.keys()) - {module}
    return found


def folder(module: str) -> str:
    """The folder that a module belongs to; of none are the command line's modules, which use every folder."""
    first, _, rest = module.partition(".")
    if first == "stillwork":
        return f"stillwork.{rest.partition('.')[0]}"
    return "workbook.site" if f"{rest}.".startswith("site.") and first == "workbook" else first
