"""Explorers without a kernel: what of a notebook runs, what a figure becomes, and at which settings."""

import json

import numpy as np
import pytest

from workbook import figures
from workbook.explorer import Choice, Slider
from workbook.inputs import environment_inputs
from workbook.notebooks import Notebook
from workbook.site.explorers import Explorer, read_explorer, statements
from workbook.site.shapes import panels
from workbook.site.states import kept_states, make_states, missing_states, states
from workbook.site.stops import ladder
from workbook.tasks import tasks


def notebook(*cells: str) -> Notebook:
    source = json.dumps({"cells": [{"cell_type": "code", "source": cell} for cell in cells]})
    return Notebook("isolation/01-first", source, {}, {})


def points(path: list[int]) -> np.ndarray:
    """The points of one piece, from its steps."""
    return np.array(path, float).reshape(-1, 2).cumsum(axis=0)


def paint(**settings):
    """A line whose height is the sum of its settings."""
    figure, axes = figures.new()
    axes.plot([0, 1], 2 * [sum(settings.values())], label="sum")
    axes.set(xlabel="time (s)", ylabel="sum (m)", ylim=(0, 10))
    return figure


def test_only_what_the_explorer_needs_runs():
    cells = [
        "import math\nfrom workbook.explorer import Slider, explore",
        "level: float = 2.0  # V",
        "%matplotlib inline",
        "study = 1 / 0",
        "table = {}\ntable['gain'] = level\nother = [level for table in range(3)]",
        "rows = []\nfor number in range(3):\n    rows.append(number)\nprint(rows, 1 / 0)",
        "math.nothing(level)",
        "def draw(x): return table['gain'] * x + sum(rows)",
        "explore(draw, {'one': {'x': 1.0}}, x=Slider(0.0, 1.0, math.floor(0.5)))",
        "later = 1 / 0",
    ]
    explorer = read_explorer(notebook(*cells))
    assert explorer.draw(3.0) == 6.0 + 3
    assert explorer.parameters == ()
    assert explorer.controls == {"x": Slider(0.0, 1.0, 0)} and explorer.presets == {"one": {"x": 1.0}}
    assert len(statements(notebook(*cells).source)) == 9
    assert read_explorer(notebook("explored = 1")) is None


def test_a_line_stands_where_its_axes_put_it():
    figure, (left, right) = figures.new(1, 2)
    x, y = np.array([1.0, 10.0, 1000.0]), np.array([1.0, 4.0, 2.0])
    left.plot(x, y, "--", label="line", color="#0072B2")
    left.set(xscale="log", xlim=(1, 1e4), ylim=(0, 5), xlabel="frequency (Hz)", ylabel="gain (1)")
    right.axhspan(1, 2)
    right.axvline(3)
    right.set(xlim=(0, 4), ylim=(0, 4), xlabel="x (m)", ylabel="y (m)")
    first, second = panels(figure)
    width, height = first["units"]
    (line,) = first["items"]
    expected = np.column_stack([np.log10(x) / 4 * width, y / 5 * height])
    assert points(line["path"][0]) == pytest.approx(expected, abs=0.51)
    assert (line["label"], line["stroke"], line["dash"]) == ("line", "#0072b2", "6 3")
    assert first["x"] == {"label": "frequency (Hz)", "log": True, "limits": [0.0, 4.0], "ticks": None}
    assert (first["place"], second["place"], first["legend"]) == ([0, 0], [0, 1], None)
    span, mark = second["items"]
    corners = points(span["path"][0])
    assert corners.min(axis=0) == pytest.approx([0, height / 4], abs=0.51)
    assert corners.max(axis=0) == pytest.approx([width, height / 2], abs=0.51)
    assert points(mark["path"][0]) == pytest.approx(
        np.array([[0.75 * width, 0], [0.75 * width, height]]), abs=0.51
    )


def test_what_is_left_out_of_a_dense_line_is_not_seen():
    figure, axes = figures.new()
    x = np.linspace(0, 1, 20_001)
    y = np.sin(60 * x) * np.exp(-2 * x)
    axes.plot(x, y)
    axes.set(xlim=(0, 1), ylim=(-1, 1), xlabel="x (1)", ylabel="y (1)")
    (panel,) = panels(figure)
    kept = points(panel["items"][0]["path"][0])
    assert len(kept) < 2000
    width, height = panel["units"]
    drawn = np.column_stack([x * width, (y + 1) / 2 * height])[::40]
    begin, way = kept[:-1], np.diff(kept, axis=0)
    along = np.einsum("psk,sk->ps", drawn[:, None] - begin, way) / (way**2).sum(axis=1)
    nearest = begin + np.clip(along, 0, 1)[..., None] * way
    assert np.linalg.norm(drawn[:, None] - nearest, axis=2).min(axis=1).max() < 1.2  # units; two are a pixel


@pytest.mark.parametrize(
    ("control", "values"),
    [
        (Slider(1, 5, 2), (1, 2, 3, 4, 5)),
        (Slider(0, 8, 2, step=2), (0, 2, 4, 6, 8)),
        (Slider(0.1, 10.0, 1.1, log=True, step=1), (0.1, 1, 1.1, 10)),
        (Slider(12.499, 12.501, 12.49996, step=5e-4), (12.499, 12.4995, 12.49996, 12.5, 12.5005, 12.501)),
        (Choice(("a", "b"), "b"), ("a", "b")),
    ],
)
def test_a_control_stops_at_what_its_slider_offers_and_at_its_start(control, values):
    found = ladder(control, lambda value: [], 20)
    assert found.values == values
    assert found.values[found.start] == control.start
    assert [type(each) for each in found.values] == [type(each) for each in values] or control.log


CONTROLS = {
    "small": Slider(0.0, 0.1, 0.0),
    "large_m": Slider(0.0, 4.0, 2.0, "m"),
    "middle": Slider(0.0, 2.0, 1.0, "N"),
    "tiny": Slider(0.0, 0.01, 0.0),
}


@pytest.mark.slow
def test_the_two_that_change_the_picture_most_move_together():
    found = states(Explorer(paint, CONTROLS), 40)
    assert found["joint"] == [1, 2]
    assert [each["name"] for each in found["controls"]] == ["small", "large", "middle", "tiny"]
    home = [each["start"] for each in found["controls"]]
    counts = [len(each["stops"]) for each in found["controls"]]
    everything = {
        ".".join(map(str, [home[0], a, b, home[3]])) for a in range(counts[1]) for b in range(counts[2])
    }
    alone = {".".join(map(str, [a, *home[1:]])) for a in range(counts[0])}
    alone |= {".".join(map(str, [*home[:3], a])) for a in range(counts[3])}
    assert set(found["states"]) == everything | alone
    # The main control keeps 15 stops, the one moved with it at least 5.
    assert 75 <= len(found["states"]) <= 95
    for key, place in found["states"].items():
        stops = map(int, key.split("."))
        values = [float(each["stops"][stop]) for each, stop in zip(found["controls"], stops, strict=True)]
        wanted = panels(paint(**dict(zip(CONTROLS, values, strict=True))))
        assert found["pictures"][place] == wanted


EXPLORER = """\
from workbook import figures
from workbook.explorer import Slider, explore
def draw(x):
    figure, axes = figures.new()
    axes.plot([0, 1], [level, x])
    axes.set(xlabel="x (m)")
    return figure
explore(draw, x=Slider(0, 4, 1))
"""


@pytest.mark.slow
def test_pictures_are_computed_once_for_each_state_of_the_notebook(toy, monkeypatch, capsys):
    name = "isolation/01-first"
    toy.add(name, EXPLORER)
    environment_inputs()  # of this checkout, whose pins are not the toy's
    monkeypatch.setenv("STILLWORK_ROOT", str(toy.root))
    assert kept_states(tasks()) == {}
    assert [task.notebook.name for task in missing_states(tasks(), {})] == [name]
    made = make_states(tasks())  # of a notebook that nobody has built
    assert "computing the pictures of 1 explorers" in capsys.readouterr().out
    assert missing_states(tasks(), made) == []
    assert made[name]["count"] == 5
    assert kept_states(tasks()) == made
    file = toy.root / "build" / "explorers" / f"{name}.json"
    before = file.stat().st_mtime_ns
    assert make_states(tasks()) == made
    assert file.stat().st_mtime_ns == before
    toy.replace(f"notebooks/{name}.ipynb", "level, x", "2 * level, x")
    assert kept_states(tasks()) == {}
