import numpy as np
import pandas as pd
import pytest

from workbook import figures
from workbook.checks import InputError


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
