"""The workbook's notebooks, and the parameters that each one declares."""

import ast
import json
import typing
from dataclasses import dataclass
from pathlib import Path
from types import UnionType

from stillwork import paths
from stillwork.checks import InputError, nearest

TYPES = {"int": int, "float": float, "str": str, "bool": bool, "list": list, "tuple": tuple}
FORM = "write 'name: type = literal  # comment', one parameter a line"


@dataclass(frozen=True)
class Parameter:
    """One line of a notebook's parameters cell; `value` is the published setting."""

    name: str
    annotation: str
    value: object

    def read(self, text: str) -> object:
        """Turn the text of ``-p NAME=VALUE`` into a value of the declared type.

        Raises
        ------
        InputError
            When the text is not of that type.
        """
        for candidate in _candidates(text):
            try:
                return _converted(candidate, _type(self.annotation))
            except TypeError:
                continue
        raise InputError(
            f"parameter {self.name} is {text!r}; give {_article(self.annotation)} (published: {self.value!r})"
        )


@dataclass(frozen=True)
class Notebook:
    """A notebook as it stands in the workbook.

    Attributes
    ----------
    name : str
        ``room/nn-result``.
    source : str
        The file's text.
    cells : dict of str to str
        Code cells by id, without the parameters cell.
    parameters : dict of str to Parameter
        In the order of the notebook.
    """

    name: str
    source: str
    cells: dict[str, str]
    parameters: dict[str, Parameter]

    @property
    def room(self) -> str:
        return self.name.partition("/")[0]


def read_notebook(name: str) -> Notebook:
    """Read ``notebooks/<name>.ipynb``.

    Raises
    ------
    InputError
        When it is no notebook or its parameters cell has another form; the message names the line.
    """
    file = notebook_file(name)
    source = file.read_text(encoding="utf-8")
    try:
        cells = [cell for cell in json.loads(source)["cells"] if cell["cell_type"] == "code"]
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{file}: not a notebook; save it again from Jupyter") from None
    tagged = [cell for cell in cells if "parameters" in cell["metadata"].get("tags", [])]
    if len(tagged) > 1:
        raise InputError(f"{file}: {len(tagged)} cells are tagged 'parameters'; keep one")
    parameters = _parameters(file, _text(tagged[0])) if tagged else {}
    code = {cell.get("id", str(i)): _text(cell) for i, cell in enumerate(cells) if cell not in tagged}
    return Notebook(name, source, code, parameters)


def notebook_file(name: str) -> Path:
    """Path of the notebook ``room/nn-result``."""
    return paths.root() / "notebooks" / f"{name}.ipynb"


def select(target: str | None = None) -> list[Notebook]:
    """Read the notebooks that `target` means: one, all of a room, or (None) all of the workbook.

    Raises
    ------
    InputError
        When there is no such room or notebook; the nearest is named.
    """
    folder = paths.root() / "notebooks"
    names = [
        f"{room}/{file.stem}" for room in paths.ROOMS for file in sorted((folder / room).glob("[!.]*.ipynb"))
    ]
    if target:
        wanted = target.removeprefix("notebooks/").removesuffix(".ipynb").rstrip("/")
        rooms = {name.partition("/")[0] for name in names}
        chosen = [name for name in names if wanted in (name, name.partition("/")[0])]
        if not chosen:
            raise InputError(f"there is no notebook or room {target!r}{nearest(wanted, [*names, *rooms])}")
        names = chosen
    return [read_notebook(name) for name in names]


def assign(notebooks: list[Notebook], settings: dict[str, str]) -> list[tuple[Notebook, dict[str, object]]]:
    """Give each notebook the `settings` that it declares; those that declare none of them drop out.

    Returns
    -------
    list of (Notebook, dict)
        The values that differ from the published settings.

    Raises
    ------
    InputError
        When no notebook has a parameter of that name, or its type is another.
    """
    known = {name for notebook in notebooks for name in notebook.parameters}
    for name in settings:
        if name not in known:
            where = notebooks[0].name if len(notebooks) == 1 else "no notebook here"
            has = "has no" if len(notebooks) == 1 else "has a"
            raise InputError(f"{where} {has} parameter {name!r}{nearest(name, known)}")
    chosen = []
    for notebook in notebooks:
        mine = {name: text for name, text in settings.items() if name in notebook.parameters}
        if settings and not mine:
            continue
        try:
            values = {name: notebook.parameters[name].read(text) for name, text in mine.items()}
        except InputError as error:
            raise InputError(f"{notebook.name}: {error}") from None
        changed = {k: v for k, v in values.items() if repr(v) != repr(notebook.parameters[k].value)}
        chosen.append((notebook, changed))
    return chosen


def _text(cell: dict) -> str:
    return "".join(cell["source"])


def _parameters(file: Path, source: str) -> dict[str, Parameter]:
    lines = source.splitlines()

    def wrong(line: int, why: str) -> InputError:
        return InputError(f"{file}: parameters cell, line {line}: {lines[line - 1].strip()!r} {why}; {FORM}")

    try:
        statements = ast.parse(source).body
    except SyntaxError as error:
        raise wrong(error.lineno or 1, "is not Python") from None
    found = {}
    for statement in statements:
        line = statement.lineno
        if not (
            isinstance(statement, ast.AnnAssign)
            and isinstance(statement.target, ast.Name)
            and statement.value is not None
        ):
            raise wrong(line, "declares no parameter")
        annotation = ast.unparse(statement.annotation)
        try:
            value = _converted(ast.literal_eval(statement.value), _type(annotation))
        except ValueError:
            raise wrong(line, "does not have a literal value or a plain type") from None
        except TypeError:
            raise wrong(line, f"is not {_article(annotation)}") from None
        found[statement.target.id] = Parameter(statement.target.id, annotation, value)
    return found


def _type(annotation: str):
    """The type that an annotation of plain types spells; ValueError for any other."""

    def build(node):
        match node:
            case ast.Name(id=name) if name in TYPES:
                return TYPES[name]
            case ast.Constant(value=None):
                return None
            case ast.Constant(value=value) if value is ...:
                return ...
            case ast.BinOp(op=ast.BitOr(), left=left, right=right):
                return build(left) | build(right)
            case ast.Subscript(value=ast.Name(id=("list" | "tuple") as name), slice=inner):
                parts = inner.elts if isinstance(inner, ast.Tuple) else [inner]
                return TYPES[name][tuple(build(part) for part in parts)]
        raise ValueError(annotation)

    return build(ast.parse(annotation, mode="eval").body)


def _converted(value, kind):
    """`value` as a `kind` (a whole number serves as a float); TypeError when it is none."""
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if origin is UnionType:
        for part in sorted(parts, key=lambda part: part is not type(value)):
            try:
                return _converted(value, part)
            except TypeError:
                continue
    elif kind is None or kind is type(None):
        if value is None:
            return None
    elif origin in (list, tuple) and isinstance(value, list | tuple):
        if origin is list or parts[1:] == (...,):
            return origin(_converted(each, parts[0]) for each in value)
        if len(parts) == len(value):
            return tuple(_converted(each, part) for each, part in zip(value, parts, strict=True))
    elif kind is float and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    elif type(value) is kind:
        return value
    raise TypeError(kind)


def _candidates(text: str):
    """What a shell's text may mean: a Python literal, a word for one, a comma-separated list, itself."""
    words = {"none": None, "true": True, "false": False}
    if text.lower() in words:
        yield words[text.lower()]
    try:
        yield ast.literal_eval(text)
    except (ValueError, SyntaxError):
        pass
    if "," in text:
        yield [next(_candidates(part.strip())) for part in text.strip("[]()").split(",")]
    yield text


def _article(annotation: str) -> str:
    return f"{'an' if annotation[0] in 'aeiou' else 'a'} {annotation}"
