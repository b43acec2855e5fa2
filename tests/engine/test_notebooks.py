"""Parameters: declared in the notebook, checked before anything runs."""

import json
from base64 import b64decode

import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.toy import cell, notebook
from workbook.checks import InputError
from workbook.notebooks import assign, read_notebook, select, with_pictures
from workbook.parameters import Parameter
from workbook.tasks import Task


@pytest.fixture
def workbook(tmp_path, monkeypatch):
    """Write a notebook of the topic `motion` with this parameters cell and read it."""
    (tmp_path / "data" / "motion").mkdir(parents=True)
    (tmp_path / "data" / "motion" / "published.toml").touch()
    (tmp_path / "notebooks" / "motion").mkdir(parents=True)
    monkeypatch.setenv("STILLWORK_ROOT", str(tmp_path))

    def write(parameters, name="motion/01-x", tags=("parameters",)):
        cells = [cell("begin", "x = 1"), cell("settings", parameters, tags=tags), cell("end", "y = 2")]
        (tmp_path / "notebooks" / f"{name}.ipynb").write_text(notebook(cells), encoding="utf-8")
        return read_notebook(name)

    return write


def test_reads_names_types_and_published_values(workbook):
    source = """\
# about the run
seed: int = 7  # root of all streams
rate: float = 5000  # Hz
record: str | None = None  # file
bands: list[float] = [1, 2.5]  # Hz
corner: tuple[float, str] = (-1e-3, "x")  # of the filter
names: tuple[str, ...] = ()  # of the axes
fast: bool = False  # or slow"""
    found = {p.name: (p.annotation, p.value) for p in workbook(source).parameters.values()}
    assert found == {
        "seed": ("int", 7),
        "rate": ("float", 5000.0),
        "record": ("str | None", None),
        "bands": ("list[float]", [1.0, 2.5]),
        "corner": ("tuple[float, str]", (-0.001, "x")),
        "names": ("tuple[str, ...]", ()),
        "fast": ("bool", False),
    }
    assert type(found["rate"][1]) is float


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("a: int = 1\nseed = 1", "line 2: 'seed = 1'"),
        ("import numpy", "line 1: 'import numpy'"),
        ("seed: int = 1 +", r"line 1\b.*Python"),
        ("seed: int = 2 * 3", r"line 1\b.*2 \* 3"),
        ("seed: Path = 'x'", r"line 1\b.*'x'"),
        ("seed: int = 1.0", r"line 1\b.*\bint\b"),
        ("bands: list[float] = [1, 'x']", r"list\[float\]"),
        ("pair: tuple[int, int] = (1, 2, 3)", r"tuple\[int, int\]"),
    ],
)
def test_a_malformed_line_is_named(workbook, source, message):
    with pytest.raises(InputError, match=message) as error:
        workbook(source)
    assert "01-x.ipynb: parameters cell" in str(error.value)
    assert "name: type = literal" in str(error.value)


@pytest.mark.parametrize(
    "text", ["<html>", '{"cells": 1}', '{"cells": [{"cell_type": "code", "source": "1"}]}']
)
def test_a_file_that_is_no_notebook(workbook, tmp_path, text):
    (tmp_path / "notebooks/motion/01-x.ipynb").write_text(text)
    with pytest.raises(InputError, match="nbformat"):
        read_notebook("motion/01-x")


@pytest.mark.parametrize(
    ("annotation", "text", "value"),
    [
        ("float", "3", 3.0),
        ("float", "1e-3", 0.001),
        ("str", "['a', 1]", "['a', 1]"),
        ("str", "../my floor.csv", "../my floor.csv"),
        ("str | None", "none", None),
        ("float | str", "2", 2.0),
        ("bool", "true", True),
        ("list[float]", "1,2.5", [1.0, 2.5]),
        ("list[str]", "a,none,2.5", ["a", "none", "2.5"]),
        ("list[str]", '["a, b", "\\"c"]', ["a, b", '"c']),
        ("tuple[int, ...]", "1,2,3", (1, 2, 3)),
        ("list[float] | None", "none", None),
    ],
)
def test_reads_what_a_shell_gives(annotation, text, value):
    read = Parameter("x", annotation, None).read(text)
    assert read == value
    assert type(read) is type(value)


@pytest.mark.parametrize(
    ("annotation", "text"),
    [
        ("int", "3.0"),
        ("list[float]", "3"),
        ("tuple[int, int]", "1,2,3"),
        ("float", "__import__('os')"),
    ],
)
def test_refuses_another_type(annotation, text):
    with pytest.raises(InputError, match=r"^parameter x\b"):
        Parameter("x", annotation, None).read(text)


@pytest.mark.slow
@given(
    st.one_of(
        st.integers().map(lambda v: ("int", v)),
        st.floats(allow_nan=False, allow_infinity=False).map(lambda v: ("float", v)),
        st.booleans().map(lambda v: ("bool", v)),
        st.lists(st.integers()).map(lambda v: ("list[int]", v)),
        st.tuples(st.booleans(), st.text()).map(lambda v: ("tuple[bool, str]", v)),
    )
)
def test_reads_back_every_literal(case):
    annotation, value = case
    assert Parameter("x", annotation, None).read(repr(value)) == value


def test_assign_keeps_what_differs_and_drops_who_has_none(workbook):
    workbook("seed: int = 1  # a\nrate: float = 2.0  # b", "motion/01-x")
    workbook("runs: int = 5  # c", "motion/02-y")
    chosen = assign(select(), {"seed": "1", "rate": "3"})
    assert [(n.name, changed) for n, changed in chosen] == [("motion/01-x", {"rate": 3.0})]
    assert [changed for _, changed in assign(select(), {})] == [{}, {}]
    with pytest.raises(InputError, match=r"'run'.*'runs'"):
        assign(select(), {"run": "3"})
    with pytest.raises(InputError, match=r"'forgetting'.* seed, rate$"):
        assign(select("motion/01-x"), {"forgetting": "3"})
    with pytest.raises(InputError, match=r"'forgetting'.* seed, rate, runs$"):
        assign(select(), {"forgetting": "3"})


def test_a_variant_has_a_folder_whatever_its_values(workbook, tmp_path):
    read = workbook('channel: str = "left"  # of the record')
    names = ["a/b", "../../x", "\n", "加速度" * 60, "x" * 1000, ".", ""]
    folders = [Task(read, {"channel": name}, {}).target for name in names]
    for folder in folders:
        folder.mkdir(parents=True)
        assert folder.parent == tmp_path / "build" / "variants" / "motion" / "01-x"
    assert len(set(folders)) == len(names)


def test_a_committed_notebook_shows_its_first_and_the_published_pictures_at_most_three(tmp_path):
    names = ["map", "fig-1", "own", "fig-2", "fig-3"]
    for name in names:
        (tmp_path / f"{name}.png").write_bytes(name.encode())
    cells = [{"cell_type": "code", "outputs": [saved_output(name)]} for name in names]
    other = {"output_type": "display_data", "data": {"text/plain": "explorer", "image/png": "AAAA"}}
    cells.append({"cell_type": "code", "outputs": [other]})
    before = json.dumps(cells)
    made = with_pictures({"cells": cells}, tmp_path, {"fig-1", "fig-2", "fig-3"})["cells"]
    shown = [cell["outputs"][0]["data"].get("image/png") for cell in made]
    assert [each and b64decode(each).decode() for each in shown] == [
        "map",
        "fig-1",
        None,
        "fig-2",
        None,
        None,
    ]
    assert json.dumps(cells) == before


def saved_output(name):
    data = {"text/plain": [f"{name}.png, {name}.csv"], "image/png": "AAAA"}
    return {"output_type": "display_data", "data": data, "metadata": {}}
