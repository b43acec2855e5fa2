"""The pictures show the numbers that were judged."""

from collections import Counter

import numpy as np
import pytest

from choices.toy_work import SEEDS, A, B, study
from stillwork.base.checks import InputError
from workbook.choices.axes import load_axes
from workbook.choices.drawing import paint_specification_curve, paint_topic_choices
from workbook.choices.judging import judge
from workbook.claims import load_entries
from workbook.figures import plotted, save


def stand(found):
    axes, _ = load_axes("motion")
    return judge([found], load_entries("motion"), axes)


def test_a_curve_is_sorted_and_tells_what_agrees(outcomes, tmp_path):
    found = outcomes()
    figure = paint_specification_curve(found, stand(found)["motion.table-1.sum"])
    values = {"agrees": {}, "does not agree": {}}
    for _, series, x, y, _ in plotted(figure):
        if series in values:
            values[series][float(x)] = float(y)
    both = values["agrees"] | values["does not agree"]
    assert sorted(both) == [1, 2, 3, 4, 5, 6]
    assert [both[rank] for rank in sorted(both)] == sorted(a + 2 * b + a * b for a, b in found.design)
    assert all((abs(y - 3) <= 1) == (name == "agrees") for name, ys in values.items() for y in ys.values())
    save(figure, tmp_path / "curve")
    assert (tmp_path / "curve.png").stat().st_size > 10000


def test_under_each_value_stands_one_option_of_every_axis(outcomes):
    found = outcomes()
    figure = paint_specification_curve(found, stand(found)["motion.table-1.sum"])
    options = [
        (series.removesuffix(", agrees"), x) for _, series, x, *_ in plotted(figure) if " = " in series
    ]
    assert Counter(x for _, x in options) == {str(rank): 2 for rank in range(1, 7)}
    assert Counter(name for name, _ in options) == {f"a = {k}": 2 for k in range(3)} | {
        f"b = {k}": 3 for k in range(2)
    }
    labels = [label.get_text() for label in figure.axes[1].get_yticklabels()]
    assert labels == ["a: 0 *", "a: 1", "a: 2", "b: 0 *", "b: 1"]


def test_the_published_value_stands_with_its_tolerance(outcomes):
    found = outcomes()
    above = paint_specification_curve(found, stand(found)["motion.table-1.sum"]).axes[0]
    (line,) = [line for line in above.lines if line.get_label() == "published"]
    assert list(line.get_ydata()) == [3, 3]
    (band,) = above.patches
    assert (band.get_y(), band.get_height()) == (2, 2)


@pytest.mark.parametrize("name", ["motion.shown", "motion.order"])
def test_entries_without_a_size_or_a_judgment_are_drawn_too(outcomes, name):
    found = outcomes(A + B + SEEDS + study("noisy"))
    figure = paint_specification_curve(found, stand(found)[name])
    series = {row[1] for row in plotted(figure)}
    assert ("not judged" in series) == (name == "motion.shown")


def test_without_values_there_is_no_curve(outcomes):
    found = outcomes(A + B + study("spread"))
    with pytest.raises(InputError, match=r"motion\.never"):
        paint_specification_curve(found, stand(found)["motion.never"])


def test_the_page_colours_as_much_as_agrees(outcomes):
    found = outcomes(A + B + study("raising"))
    standings = stand(found)
    figure = paint_topic_choices("motion", standings.values())
    (image,) = figure.axes[0].images
    picture = image.get_array()
    judged = [each for each in standings.values() if each.class_]
    assert picture.shape[0] == len(judged) == 5
    for row, standing in zip(np.ma.filled(picture, np.nan), judged, strict=True):
        assert np.isnan(row).mean() == pytest.approx(2 / 6, abs=0.02)  # two of six combinations failed
        assert (row == 1).mean() == pytest.approx(standing.agree / 6, abs=0.02)
    assert figure.axes[0].get_yticklabels()[0].get_text() == "table-1.sum (depends)"


def test_a_topic_without_combinations_has_no_page():
    with pytest.raises(InputError, match=r"^topic motion\b"):
        paint_topic_choices("motion", [])
