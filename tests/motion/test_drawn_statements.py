"""What notebooks 01 to 15 judge on drawn lines, and the functions that their open choices vary."""

import numpy as np
import pytest

from experiments.motion.decoupling_pictures import paint_slope_ranges
from experiments.motion.machines import loaded_modes
from experiments.motion.pictures import add_zoom, labelled_lines, mark_limit, turning_points
from motion.test_choices import open_loop_gain
from notebooks.motion.bandwidth_table import LOOPS, WAYS, agreeing
from workbook import figures

PRINTED = [37.0, 43.0, 46.0, 59.0, 65.0, 72.0, 77.0, 83.0, 73.0]


def test_peaks_and_dips_of_a_line_are_found_and_ripples_are_not():
    x = np.linspace(1, 10, 9001)
    line = 20 * np.exp(-((x - 3) ** 2) / 0.01) - 15 * np.exp(-((x - 7) ** 2) / 0.01) + 0.01 * np.sin(40 * x)
    assert turning_points(x, line, "peaks") == pytest.approx([3.0], abs=2e-3)
    assert turning_points(x, line, "dips") == pytest.approx([7.0], abs=2e-3)


def test_a_limit_and_a_zoom_add_no_line_to_those_that_are_judged():
    figure, axis = figures.new(1, 1)
    (line,) = axis.plot([1.0, 2.0, 3.0], [0.0, 5.0, 0.0], "--", label="mass 1")
    mark_limit(axis)
    add_zoom(axis, (0.5, 0.1, 0.4, 0.4), (1.5, 2.5), (0.0, 6.0))
    (inset,) = axis.child_axes
    assert list(labelled_lines(axis)) == ["mass 1"]
    assert figure.axes == [axis]
    assert (inset.lines[0].get_xydata() == line.get_xydata()).all()
    assert (inset.lines[0].get_linestyle(), inset.get_xlim()) == ("--", (1.5, 2.5))


def test_the_lines_of_a_zoom_do_not_cross_where_its_frame_is_narrow():
    figure, axis = figures.new(1, 1)
    axis.semilogx([10.0, 470.0, 3e3], [-110.0, -120.0, -190.0], label="plant")
    add_zoom(axis, (0.17, 0.12, 0.32, 0.32), (462.0, 478.0), (-130.0, -118.0))
    figure.draw_without_rendering()
    (inset,) = axis.child_axes
    (zoom,) = (each for each in axis.get_children() if hasattr(each, "connectors"))
    shown = [each for each in zoom.connectors if each.get_visible()]
    corners = inset.transAxes.transform([each.xy1 for each in shown])
    frame = axis.transData.transform([each.xy2 for each in shown])

    def side(a, b, p):
        return np.sign((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]))

    assert len(shown) == 2
    assert side(corners[0], frame[0], corners[1]) == side(corners[0], frame[0], frame[1])


def test_slopes_that_are_only_rounding_in_the_limit_are_drawn_once():
    above = {"undamped": np.full((3, 2, 2), 0.01), "MC": np.zeros((3, 2, 2))}
    slopes = {"undamped": np.zeros((3, 2, 2)), "MC": np.zeros((3, 2, 2))}
    figure = paint_slope_ranges(slopes, above, dict.fromkeys(above, (0.0, 0.0)))
    limit = [line for line in figure.axes[0].lines if line.get_label() == "machines, in the limit"]
    assert [set(line.get_ydata()) for line in limit] == [{-0.22}]
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert names == ["machines, in the limit", "machines, 0.03 to 0.3 Hz", "published"]


@pytest.mark.slow
def test_six_of_nine_bandwidths_agree_where_hertz_are_cut_off():
    """By the gain of the open loop from the closed loop's states: above 1 at the printed hertz, below 1 one hertz on."""
    from notebooks.motion.bandwidth_table import BANDWIDTHS

    names = [*BANDWIDTHS.values(), "MC, two constraints"]
    inside = [
        open_loop_gain(name, "P C_eq", 3, hertz)[0] >= 1 > open_loop_gain(name, "P C_eq", 3, hertz + 1)[0]
        for name, hertz in zip(names, PRINTED, strict=True)
    ]
    found = agreeing(PRINTED, cut_off=True)
    assert WAYS[0] == ("6 dB", "noise model")
    assert found[LOOPS.index("P C_eq"), 2, 0].tolist() == inside
    assert sum(inside) == found.sum(axis=-1).max() == 6


@pytest.mark.parametrize("sharing", ["linear", "smooth"])
def test_a_mass_between_two_places_is_all_there(sharing):
    masses = [loaded_modes(place, sharing)[0] for place in (2.0, 2.3, 2.5)]
    assert [np.trace(each) for each in masses] == pytest.approx([5 * 1.6 + 1.0] * 3)
    assert masses[0][1, 1] == pytest.approx(2.6)
    assert masses[2][1, 1] == pytest.approx(masses[2][2, 2]) == pytest.approx(2.1)
