"""The bandwidth table's study, and the drawings behind the explorers."""

import numpy as np
import pytest

from experiments.motion import explorers
from notebooks.motion import generalised_h2 as energy_to_peak
from notebooks.motion import scheduled_or_online as position_scan


@pytest.mark.slow
def test_filter_explorers_draw_what_their_filters_give():
    """The Kalman filter's own norm is the smaller one, and a fine table comes close to the online gains."""
    labels = [t.get_text() for t in energy_to_peak.paint_worst(0.01, 10.0).axes[0].get_legend().get_texts()]
    kalman, detuned = (float(text.partition(": ")[2]) for text in labels)
    assert kalman <= detuned
    lines = position_scan.paint_schedules("1 m/s", 0.05, 5.0).axes[0].lines
    online, scheduled = (np.abs(line.get_ydata()).max() for line in lines)
    assert abs(scheduled / online - 1) < 0.05


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
