"""The bandwidth table's study, and the drawings behind the explorers."""

import numpy as np
import pytest

from experiments.motion import explorers, pictures
from notebooks.motion import discretisation as printed_matrices
from notebooks.motion import disturbance_rejection as performance
from notebooks.motion import generalised_h2 as energy_to_peak
from notebooks.motion import scan_performance as three_masses
from notebooks.motion import scheduled_or_online as position_scan
from notebooks.motion import tracking as tracking_pictures
from notebooks.motion import two_inertia_drive as drive_pictures
from notebooks.motion.bandwidth_table import bandwidth_map, open_choices
from workbook import figures


@pytest.mark.slow
def test_what_is_open_moves_the_bandwidth_as_it_must():
    study = open_choices("PID")
    published = study.published
    assert study.found["6 dB taken as 2"].design_hz > published.design_hz
    assert study.found["grid of 2000 points"].design_hz > published.design_hz
    assert study.found["damping 0.1 %"].design_hz < 0.7 * published.design_hz
    assert study.found["R = sensor noise alone"] is published
    low, high = study.interval
    assert low < published.crossing_hz.min() < study.crossing < published.crossing_hz.max() < high
    # The crossing lies a few per cent above the design parameter.
    assert np.all(published.crossing_hz > 1.03 * published.design_hz)


@pytest.mark.slow
def test_the_limit_rises_with_the_noise_model_beyond_the_printed_optimum():
    crossing_hz = bandwidth_map([2.0], [1e3, 1e5, 1e12])
    assert crossing_hz[0, 1] > crossing_hz[0, 0] > 80
    assert np.isnan(crossing_hz[0, 2])


@pytest.mark.parametrize(
    "draw",
    [
        lambda: explorers.paint_design(60.0, 0.035, 2.0, "yes"),
        lambda: explorers.paint_published("PID with notches", 100.0),
        lambda: explorers.paint_reduction(3, 100.0),
        lambda: explorers.paint_heavy_mass(2, 2.6),
        lambda: printed_matrices.paint_transition_error(470.0, 0.005),
        lambda: tracking_pictures.paint_feedforward(12.5, 1.66, 35.0),
        lambda: performance.paint_disturbance(35.0, 0.01, 0.035),
        lambda: drive_pictures.paint_drive(0.05, 0.1, 4.0),
        lambda: three_masses.paint_three_masses(40.0),
    ],
)
def test_explorers_draw_labelled_curves(draw):
    figure = draw()
    for axes in figure.axes:
        assert axes.get_ylabel() or axes.get_shared_y_axes().get_siblings(axes)
        for line in axes.lines:
            x, y = (np.asarray(values, dtype=float) for values in line.get_data())
            assert len(x) == len(y) > 0
            assert np.isfinite(y).all()


@pytest.mark.slow
def test_filter_explorers_draw_what_their_filters_give():
    """The Kalman filter's own norm is the smaller one, and a fine table comes close to the online gains."""
    labels = [t.get_text() for t in energy_to_peak.paint_worst(0.01, 10.0).axes[0].get_legend().get_texts()]
    kalman, detuned = (float(text.partition(": ")[2]) for text in labels)
    assert kalman <= detuned
    lines = position_scan.paint_schedules("1 m/s", 0.05, 5.0).axes[0].lines
    online, scheduled = (np.abs(line.get_ydata()).max() for line in lines)
    assert abs(scheduled / online - 1) < 0.05


def test_what_is_drawn_is_drawn_lines_by_line():
    _, axis = figures.new(1, 1)
    axis.plot([1.0, 2.0, 3.0], [0.0, 5.0, 1.0], label="first")
    axis.plot([1.0, 2.0, 3.0], [7.0, 2.0, 4.0], label="second")
    axis.axhline(6.0)  # without a label
    assert list(pictures.labelled_lines(axis)) == ["first", "second"]
    np.testing.assert_array_equal(pictures.labelled_lines(axis)["second"], [[1, 2, 3], [7, 2, 4]])
    np.testing.assert_array_equal(pictures.highest(axis), [[2, 5], [1, 7]])
    np.testing.assert_array_equal(pictures.highest(axis, 1.5), [[2, 5], [3, 4]])


def test_a_logarithmic_axis_of_a_decade_shows_plain_numbers():
    figure, axis = figures.new()
    axis.semilogy([2.0, 30.0])
    pictures.plain_numbers(axis.yaxis)
    figure.draw_without_rendering()
    texts = [label.get_text() for label in axis.get_yticklabels(which="both") if label.get_text()]
    assert {"3", "10"} <= set(texts)
    assert not any("^" in text for text in texts)


def test_a_preset_of_a_design_touches_its_limit():
    """The highest peak of a transfer that limits the design is 6 dB, less what rounding down to 0.1 Hz leaves."""
    names = ("MC and AD", "AD", "AD, original controller")
    controls = ("bandwidth_hz", "damping", "selectivity", "compensate", "noise_model")
    highest = []
    for settings in explorers.design_presets(names, *controls).values():
        figure = explorers.paint_design(**settings)
        highest.append(max(float(axis.get_title(loc="left").split()[-2]) for axis in figure.axes))
    assert highest[:2] == pytest.approx([6.0, 6.0], abs=0.1)
    assert highest[2] < 5.9
