import gc
import subprocess
import sys
from functools import partial

import matplotlib
import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stillwork.base.checks import InputError
from workbook import figures
from workbook.rendering import pixels


def numbers(figure, series):
    """The plotted numbers of one series, as the CSV has them."""
    rows = [row for row in figures.plotted(figure) if row[1] == series]
    return np.array([[float(value or "nan") for value in row[2:]] for row in rows])


def labelled(**options):
    figure, axes = figures.new(**options)
    axes.set_xlabel("time (s)")
    return figure, axes


def test_the_csv_holds_what_was_plotted(tmp_path):
    figure, axes = figures.new(1, 2)
    x = np.linspace(0, 1, 7)
    axes[0].set_title("left")
    axes[0].set_xlabel("time (s)")
    axes[0].plot(x, np.sin(x), label="sine")
    axes[0].plot(x, np.where(x < 0.5, np.nan, x))
    axes[1].set_xlabel("frequency (Hz)")
    figures.mark_published(axes[1], 3.0, 4.0)
    axes[1].axhline(2.0, label="limit")
    saved = figures.save(figure, tmp_path / "deep" / "fig-1")
    file = tmp_path / "deep" / "fig-1.csv"
    table = figures.read_table(file)
    assert list(table) == [("left", "sine"), ("left", "line 2"), ("panel 2", "published")]
    np.testing.assert_allclose(table["left", "sine"][:, :2], np.c_[x, np.sin(x)], rtol=1e-6)
    np.testing.assert_array_equal(np.isnan(table["left", "line 2"]).sum(axis=0), [0, 3, 7])
    assert file.read_text().splitlines()[-1] == "panel 2,published,3,4,"
    assert repr(saved) == "fig-1.png, fig-1.csv"
    assert saved._repr_png_() == (tmp_path / "deep" / "fig-1.png").read_bytes()
    assert saved.png.startswith(b"\x89PNG")


def test_a_name_stands_in_the_first_row_of_its_block(tmp_path):
    figure, axes = figures.new(1, 2)
    for panel, title in zip(axes, ("one", "two"), strict=True):
        panel.set_title(title)
        panel.set_xlabel("time (s)")
        panel.plot([0, 1, 2], [3, 4, 5], label="same, in both")
    axes[1].plot([6, 7], [8, 9], label="other")
    figures.save(figure, tmp_path / "a")
    assert (tmp_path / "a.csv").read_text().splitlines() == [
        "panel,series,x,y,z",
        'one,"same, in both",0,3,',
        ",,1,4,",
        ",,2,5,",
        'two,"same, in both",0,3,',
        ",,1,4,",
        ",,2,5,",
        ",other,6,8,",
        ",,7,9,",
    ]
    rows = pd.read_csv(tmp_path / "a.csv")
    rows[["panel", "series"]] = rows[["panel", "series"]].ffill()
    table = figures.read_table(tmp_path / "a.csv")
    assert len(table) == 3
    for name, block in rows.groupby(["panel", "series"]):
        np.testing.assert_array_equal(table[name], block[["x", "y", "z"]])


def test_a_file_that_is_no_table_of_a_figure_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text("time,x\n0,1\n")
    with pytest.raises(InputError, match=r"^path\b.*panel,series"):
        figures.read_table(tmp_path / "a.csv")


def test_a_name_that_would_read_as_the_one_above_is_refused(tmp_path, monkeypatch):
    figure, _ = labelled()
    monkeypatch.setattr(figures, "plotted", lambda figure: [("one", "", "0", "0", "")])
    with pytest.raises(InputError, match="series ''"):
        figures.save(figure, tmp_path / "a")


def looks(figure):
    """What a layout or a drawing could change of a figure and of its parts."""
    parts = [figure]
    for part in parts:
        parts += part.subfigs
    panels = [panel for axes in figure.axes for panel in (axes, *axes.child_axes)]
    return {
        "margins": [dict(vars(part.subplotpars)) for part in parts],
        "parts": [part.bbox.bounds for part in parts],
        "titles": [text.get_position() for part in parts for text in part.texts],
        "places": [(panel.get_position(True).bounds, panel.get_position().bounds) for panel in panels],
        "views": [(panel.get_xlim(), panel.get_ylim()) for panel in panels],
        "free": [(panel.get_autoscalex_on(), panel.get_in_layout(), panel.get_aspect()) for panel in panels],
        "boxes": [(panel.get_anchor(), panel.get_box_aspect(), panel.get_adjustable()) for panel in panels],
        "artists": [len(thing.get_children()) for thing in (*parts, *panels)],
        "figure": (figure.dpi, tuple(figure.get_size_inches()), figure.canvas, figure.get_layout_engine()),
        "ticks": [
            (axis.minor.locator, axis.minor.locator.axis) for p in panels for axis in (p.xaxis, p.yaxis)
        ],
        "settings": (dict(matplotlib.rcParams), gc.isenabled()),
    }


@pytest.mark.slow
def test_saving_leaves_the_figure_as_it_is(tmp_path):
    figure, axes = figures.new(2, 1, sharex=True)
    t = np.linspace(1, 1000, 3000)
    (line,) = axes[0].loglog(t, 1 / t)
    axes[1].set_xlabel("time (s)")
    mesh = axes[1].pcolormesh([1.0, 10, 1000], [0.0, 1, 2], [[1.0, 2], [3, 4]])
    figure.colorbar(mesh)

    before = looks(figure)
    first = figures.save(figure, tmp_path / "a")
    assert looks(figure) == before
    np.testing.assert_array_equal(line.get_xydata(), np.c_[t, 1 / t])
    again = figures.save(figure, tmp_path / "b")
    assert again.png == first.png
    assert (tmp_path / "b.csv").read_bytes() == (tmp_path / "a.csv").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("layout", [None, "none", "tight", "constrained", "compressed"])
@pytest.mark.parametrize("parts", [0, 1, 2], ids=["one figure", "parts", "parts of parts"])
@pytest.mark.parametrize("drawn", [False, True], ids=["new", "drawn before"])
def test_saving_leaves_a_readers_own_figure_as_it_is(tmp_path, layout, parts, drawn):
    figure = Figure(layout=layout, figsize=(12, 8))
    figure.suptitle("of all")
    grids = [figure]
    for _ in range(parts):
        *kept, last = grids
        grids = [*kept, *last.subfigures(1, 2)]
    for grid in grids:
        panels = grid.subplots(2, 2).ravel()
        grid.supxlabel("x (m)")
        panels[1].set_aspect("equal")
        panels[2].set_aspect("equal", adjustable="datalim")
        panels[3].inset_axes([0.5, 0.5, 0.3, 0.3]).plot([1, 2])
        figure.colorbar(panels[0].pcolormesh([1, 2, 3], [1, 2, 3], [[1, 2], [3, 4]]), ax=panels[0])
        for panel in panels:
            panel.plot([1, 2, 4], [1, 3, 2])
            panel.set(xlabel="t (s)", ylabel="y (m)")
    if parts and layout == "compressed":  # matplotlib has none
        with pytest.raises(InputError, match=r"^figure"):
            figures.save(figure, tmp_path / "a")
        return
    if drawn:
        figure.draw_without_rendering()
    before = looks(figure)
    figures.save(figure, tmp_path / "a")
    after = looks(figure)
    assert {name: after[name] for name in before if after[name] != before[name]} == {}


def test_scatter_fill_steps_and_error_bars():
    figure, axes = labelled()
    x = np.arange(4.0)
    axes.scatter(x, x**2, label="points")
    axes.scatter([9.0], [8.0], label="one point")
    axes.fill_between(x, x, x + 1, label="band")
    axes.step(x, -x, label="steps")
    axes.errorbar(x, 3 * x, yerr=0.5, label="bars")
    np.testing.assert_array_equal(numbers(figure, "points")[:, :2], np.c_[x, x**2])
    np.testing.assert_array_equal(numbers(figure, "one point")[:, :2], [[9, 8]])
    assert {(a, b) for a, b in numbers(figure, "band")[:, :2]} == {(a, a + d) for a in x for d in (0.0, 1.0)}
    np.testing.assert_array_equal(numbers(figure, "steps")[:, :2], np.c_[x, -x])
    bars = numbers(figure, "bars")[:, :2]
    assert len(bars) == 12
    assert {(a, 3 * a + d) for a in x for d in (-0.5, 0, 0.5)} == {(a, b) for a, b in bars}


def test_upright_and_lying_bars():
    figure, axes = labelled()
    axes.bar([1.0, 2.0], [3.0, 4.0], width=0.5, label="upright")
    axes.barh([1.0, 2.0], [5.0, 6.0], height=0.5, label="lying")
    np.testing.assert_array_equal(numbers(figure, "upright")[:, :2], [[1, 3], [2, 4]])
    np.testing.assert_array_equal(numbers(figure, "lying")[:, :2], [[5, 1], [6, 2]])


@pytest.mark.parametrize("origin", ["upper", "lower"])
def test_maps_have_the_middle_of_each_cell(origin):
    z = np.arange(6.0).reshape(2, 3)
    figure, axes = labelled()
    image = axes.imshow(z, extent=(0, 3, 0, 2), origin=origin, label="map")
    figure.colorbar(image)
    rows = [0.5, 1.5] if origin == "lower" else [1.5, 0.5]
    expected = [(column + 0.5, row, z[i, column]) for i, row in enumerate(rows) for column in range(3)]
    np.testing.assert_allclose(numbers(figure, "map"), expected)

    figure, axes = labelled()
    axes.pcolormesh([0.0, 1, 3], [0.0, 2, 4], [[1.0, 2], [3, 4]], label="mesh")
    np.testing.assert_allclose(numbers(figure, "mesh"), [(0.5, 1, 1), (2, 1, 2), (0.5, 3, 3), (2, 3, 4)])


def test_contours_carry_their_level():
    grid = np.linspace(-1, 1, 21)
    figure, axes = labelled()
    axes.contour(grid, grid, grid[:, None] + 0 * grid, levels=[-0.25, 0.5])
    rows = numbers(figure, "QuadContourSet 1")
    assert set(rows[:, 2]) == {-0.25, 0.5}
    np.testing.assert_allclose(rows[:, 1], rows[:, 2], atol=1e-12)


def test_an_axis_without_a_label_is_refused():
    figure, axes = figures.new(1, 2)
    axes[0].set_xlabel("time (s)")
    axes[0].plot([1, 2])
    axes[1].plot([1, 2])
    with pytest.raises(InputError, match=r"^panel 2\b"):
        figures.plotted(figure)


def test_a_shared_label_and_an_empty_or_hidden_axis_are_fine():
    figure, axes = figures.new(2, 2, sharex="col")
    axes[0, 0].plot([1, 2], label="a")
    axes[1, 0].plot([1, 2], label="b")
    axes[1, 0].set_xlabel("time (s)")
    axes[1, 1].plot([1, 2], label="drawing")
    axes[1, 1].axis("off")
    assert {row[1] for row in figures.plotted(figure)} == {"a", "b", "drawing"}


DRAW = """\
import sys
from pathlib import Path
import numpy as np
from workbook import figures
figure, axes = figures.new(height=2)
axes.plot(np.random.default_rng(1).normal(size=50), label="noise")
axes.set_xlabel("time (s)")
axes.legend()
figures.save(figure, Path(sys.argv[1]))
"""


@pytest.mark.slow
def test_two_processes_write_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        subprocess.run([sys.executable, "-c", DRAW, str(tmp_path / name)], check=True)
    for suffix in (".png", ".csv"):
        assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


@pytest.mark.slow
def test_the_settings_of_matplotlib_are_those_of_its_user(tmp_path):
    """Each step of a figure has the style of the house, and a figure of the user's has the user's."""
    with matplotlib.rc_context({"axes.titlesize": 20, "lines.linewidth": 7.0, "xtick.labelsize": 17}):
        before = dict(matplotlib.rcParams)
        figure, (left, right) = figures.new(1, 2)
        twin = left.twinx()
        (line,) = twin.plot([0, 1], [1, 2], label="b")
        title = left.set_title("a")
        left.set_xlabel("time (s)")
        legend = twin.legend()
        bar = figure.colorbar(right.pcolormesh(np.eye(3)), ax=right)
        right.set_xlabel("place (m)")
        figures.save(figure, tmp_path / "fig-1")
        assert dict(matplotlib.rcParams) == before
        sizes = [text.get_size() for text in (title, *left.get_xticklabels(), *bar.ax.get_yticklabels())]
        assert sizes[0] == 9 and set(sizes[1:]) == {8}
        assert line.get_linewidth() == 1.3 and not legend.get_frame_on()

        own = Figure()
        panel = own.subplots()
        (line,) = panel.plot([0, 1], [1, 2])
        panel.set_xlabel("time (s)")
        figures.save(own, tmp_path / "own")
        assert dict(matplotlib.rcParams) == before
        assert line.get_linewidth() == 7.0 and {t.get_size() for t in panel.get_xticklabels()} == {17}


@pytest.mark.parametrize("method", ["semilogx", "semilogy", "loglog"])
def test_a_second_line_on_a_logarithmic_axis_scales_it_as_matplotlib_does(method):
    pictures = []
    for kind in (None, Axes):
        figure, panels = figures.new(1, 2, sharex=True, sharey=True)
        panels[1].plot([1, 7], [2, 5])
        for number in range(1, 4):
            draw = getattr(panels[0], method) if kind is None else partial(getattr(kind, method), panels[0])
            draw([1, 30 * number], [2, 800 / number])
        pictures.append(pixels(figure, 60))
    np.testing.assert_array_equal(*pictures)
    figure, axes = figures.new()
    axes.loglog([1, 9], [1, 9])
    axes.loglog([1, 9], [1, 9], base=2)
    assert axes.xaxis.get_transform().base == 2


def test_the_settings_come_back_after_an_error():
    before = dict(matplotlib.rcParams)
    _, axes = figures.new()
    with pytest.raises(ValueError, match="x and y"):
        axes.plot([1, 2], [1, 2, 3])
    assert dict(matplotlib.rcParams) == before


def test_a_legend_below_names_one_panels_lines():
    figure, axes = figures.new(1, 2)
    axes[0].plot([0, 1], [0, 1], label="ours")
    axes[1].plot([0, 1], [1, 0], label="elsewhere")
    figures.legend_below(axes[0], 2)
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["ours"]
    assert axes[0].get_legend() is None
