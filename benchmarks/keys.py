"""How many notebooks and studies the last commits would have built, by what a key sees of a module.

``python benchmarks/keys.py --commits 60``. Each commit that is no merge is compared with its parent: a notebook's key
is its code cells and the modules that these import anywhere in their text, a study's its module and all that this
imports. Data, parameters and pins are left out: they are the same under every scheme.

bytes        digest of each file
code         digest of each file's code, as `stillwork.base.source_digest` has it
definitions  of each file the code outside of functions and classes, and those of these whose name stands anywhere in
             what is reached, as a name, an attribute or a text
names        as before, and of the code outside only what does more than import or give a name a value: a bound, for
             it leaves out what importing a module does, and what a package's public names lead to
"""

import argparse
import ast
import hashlib
import json
import subprocess
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Iterable
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "lib"))

from stillwork.base.source_digest import code, code_digest  # noqa: E402
from workbook.choices import closure  # noqa: E402

FOLDERS = ("lib", "contest", "notebooks", "data")  # where a key finds its modules
SCHEMES = ("bytes", "code", "definitions", "names")
Fragment = tuple[str, frozenset[str]]  # digest of a piece of code, and the names that stand in it


def git(*arguments: str, given: bytes | None = None) -> bytes:
    return subprocess.run(["git", *arguments], cwd=ROOT, check=True, capture_output=True, input=given).stdout


@cache
def blob(sha: str) -> bytes:
    return git("cat-file", "blob", sha)


class Tree:
    """The library, the notebooks and the studies of one commit after the other, in a folder."""

    def __init__(self, folder: Path):
        self.folder, self.files = folder, {}
        closure.LIBRARY = folder / "lib"
        closure.syntax_tree = lambda file: parsed(self.content(file))
        self._own_imports, closure.imports = closure.imports, self._imports
        self._known: dict[tuple, list[str]] = {}
        sys.path[:0] = [str(folder / "lib"), str(folder)]

    def show(self, commit: str) -> None:
        lines = git("ls-tree", "-r", commit, *FOLDERS).decode().splitlines()
        files = {line.partition("\t")[2]: line.split()[2] for line in lines}
        files = {name: sha for name, sha in files.items() if name.endswith((".py", ".ipynb", "choices.toml"))}
        for name, sha in files.items():
            if self.files.get(name) != sha:
                file = self.folder / name
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(blob(sha))
        for name in self.files.keys() - files.keys():
            (self.folder / name).unlink()
        self.files = files
        packages = {name: sha for name, sha in files.items() if name.endswith("__init__.py")}
        # An import leads to another module where modules come and go, or a package's public names change.
        self._listing = hashlib.sha256(repr((sorted(files), sorted(packages.items()))).encode()).hexdigest()

    def content(self, file: Path) -> bytes:
        name = file.relative_to(self.folder).as_posix()
        return blob(self.files[name]) if name in self.files else file.read_bytes()

    def _imports(self, name: str, file: Path, roots: list[Path]) -> list[str]:
        key = (name, self._listing, hashlib.sha256(self.content(file)).hexdigest())
        if key not in self._known:
            self._known[key] = list(self._own_imports(name, file, roots))
        return self._known[key]

    def keys(self) -> dict[str, dict[str, str]]:
        """By notebook or study, by scheme."""
        found = {}
        for name in self.files:
            if name.endswith(".ipynb"):
                cells = [
                    cell
                    for cell in json.loads(blob(self.files[name]))["cells"]
                    if cell["cell_type"] == "code"
                ]
                text = "\n".join("".join(cell["source"]) for cell in cells)
                begin = self.folder / "cells_of_a_notebook.py"  # from where it imports what stands beside it
                begin.write_text(text)
                found[name] = self._key(text, closure.modules(begin.stem))
                begin.unlink()
            elif name.startswith("data/") and name.endswith("choices.toml"):  # no template of one
                for study, given in tomllib.loads(blob(self.files[name]).decode()).get("studies", {}).items():
                    module, _, function = given["function"].partition(":")
                    text = f"from {module} import {function}\n{function}"
                    found[f"{name} {study}"] = self._key(text, closure.modules(module))
        return found

    def _key(self, text: str, modules: dict[str, Path]) -> dict[str, str]:
        packages = {name for name, file in modules.items() if file.name == "__init__.py"}
        sources = {
            name: self.content(file) for name, file in modules.items() if name != "cells_of_a_notebook"
        }
        return {
            "bytes": digest([text, *(f"{n} {hashlib.sha256(s).hexdigest()}" for n, s in sources.items())]),
            "code": digest([text, *(f"{name} {code_of(source)}" for name, source in sources.items())]),
            "definitions": digest([text, *reached(text.encode(), sources, packages)]),
            "names": digest([text, *reached(text.encode(), sources, packages, values=True)]),
        }


@cache
def parsed(source: bytes) -> ast.Module:
    return ast.parse(source)


@cache
def code_of(source: bytes) -> str:
    return code_digest(source)


def digest(lines: Iterable[str]) -> str:
    return hashlib.sha256("\n".join(sorted(lines)).encode()).hexdigest()


def reached(text: bytes, sources: dict[str, bytes], packages: set[str], values: bool = False) -> list[str]:
    """Digests of the definitions that the cells reach, and of all that stands outside of definitions."""
    defined: dict[str, list[tuple[str, Fragment]]] = {}
    lines, names = [], set(fragments(text)[0][1])
    for module, source in sources.items():
        (outside, used), definitions = fragments(source, module in packages, values)
        lines.append(f"{module} {outside}")
        names |= used
        for name, fragment in definitions:
            defined.setdefault(name, []).append((f"{module}.{name}", fragment))
    waiting = [name for name in names if name in defined]
    seen = set(waiting)
    while waiting:
        for place, (its_code, used) in defined[waiting.pop()]:
            lines.append(f"{place} {its_code}")
            more = (used & defined.keys()) - seen
            seen |= more
            waiting += more
    return lines


@cache
def fragments(
    source: bytes, of_package: bool = False, values: bool = False
) -> tuple[Fragment, tuple[tuple[str, Fragment], ...]]:
    """What stands outside of a module's functions and classes, and these by name.

    With `of_package` the texts in a package are its public names: a name that is listed is not reached by that.
    """
    tree = code(source)
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    inside = [(node.name, node) for node in tree.body if isinstance(node, kinds)]
    if values:
        inside += [(name, node) for node in tree.body for name in assigned(node)]
        tree.body = [node for node in tree.body if not isinstance(node, ast.Import | ast.ImportFrom)]
    known = [node for _, node in inside]
    # A decorator acts when the module is imported.
    outside = [node for node in tree.body if node not in known]
    outside += [each for node in known if isinstance(node, kinds) for each in node.decorator_list]
    return fragment(outside, of_package), tuple((name, fragment([node], of_package)) for name, node in inside)


def assigned(node: ast.AST) -> list[str]:
    """Names to which a statement gives a value, if that is all it does."""
    if not isinstance(node, ast.Assign | ast.AnnAssign):
        return []
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    parts = [
        part for target in targets for part in (target.elts if isinstance(target, ast.Tuple) else [target])
    ]
    return [part.id for part in parts] if all(isinstance(part, ast.Name) for part in parts) else []


def fragment(nodes: list[ast.AST], of_package: bool) -> Fragment:
    names: set[str] = set()
    for node in (each for top in nodes for each in ast.walk(top)):
        if isinstance(node, ast.Name):
            names.add(node.id)
        elif isinstance(node, ast.Attribute):
            names.add(node.attr)
        elif isinstance(node, ast.alias) and node.asname:  # otherwise the name stands where it is used
            names.add(node.name)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and not of_package:
            names.add(node.value)
    text = "\n".join(map(ast.dump, nodes))
    return hashlib.sha256(text.encode(errors="surrogatepass")).hexdigest(), frozenset(names)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--commits", type=int, default=60)
    parser.add_argument("--until", default="HEAD", help="the last of them")
    parser.add_argument("--each", action="store_true", help="a line for each commit, too")
    given = parser.parse_args()
    commits = git("rev-list", "--no-merges", f"-{given.commits}", given.until).decode().split()
    built: Counter = Counter()
    touching, known = 0, {}
    with tempfile.TemporaryDirectory() as folder:
        tree = Tree(Path(folder).resolve())

        def keys_of(commit: str) -> dict[str, dict[str, str]]:
            parts = git("ls-tree", commit, *FOLDERS)
            if parts not in known:
                tree.show(commit)
                known[parts] = tree.keys()
            return known[parts]

        for commit in reversed(commits):
            before, now = keys_of(f"{commit}^"), keys_of(commit)
            moved = Counter(
                (scheme, "notebooks" if name.endswith(".ipynb") else "studies")
                for name, key in now.items()
                for scheme in SCHEMES
                if before.get(name, {}).get(scheme) != key[scheme]
            )
            built += moved
            touching += bool(moved)
            if given.each and moved:
                subject = git("log", "-1", "--format=%h %s", commit).decode().strip()[:60]
                counts = "  ".join(f"{moved[s, 'notebooks']:3d} {moved[s, 'studies']:3d}" for s in SCHEMES)
                print(f"{counts}  {subject}", flush=True)
    names = [name.endswith(".ipynb") for name in now]
    print(
        f"{len(commits)} commits, {touching} of which move a key; {sum(names)} notebooks, {names.count(False)} studies"
    )
    for scheme in SCHEMES:
        print(f"{scheme:12} {built[scheme, 'notebooks']:6d} notebooks {built[scheme, 'studies']:6d} studies")
    return 0


if __name__ == "__main__":
    sys.exit(main())
