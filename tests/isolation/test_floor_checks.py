"""What is said of a floor before an adaptation listens to it."""

import numpy as np
import pytest

from stillwork.design.isolate import LINE_HZ, read_floor
from stillwork.signals.floor_checks import drift_ratio


def microseism(level: float, low_hz: float = 0.02):
    """Acceleration from 3 Hz on, and a narrow band at 0.15 Hz."""
    f = np.arange(low_hz, 200.0, 0.01)
    return f, 1e-12 / (1 + (3 / f) ** 4) + level * np.exp(-(((f - 0.15) / 0.02) ** 2))


def test_velocity_below_the_certificates_lines_is_the_closed_form():
    f = np.geomspace(0.02, 100.0, 20001)
    found = drift_ratio(f, (f**2)[None], 0.25)  # a white velocity
    assert found == pytest.approx(np.sqrt(0.23 / 99.75), rel=1e-3)
    assert drift_ratio(f[f > 1], (f**2)[None, f > 1], 0.25) == 0.0


@pytest.mark.parametrize(
    ("level", "low_hz", "said"), [(1e-8, 0.02, True), (1e-14, 0.02, False), (1e-8, 0.3, False)]
)
def test_a_microseism_is_reported(tmp_path, level, low_hz, said):
    file = tmp_path / "floor.csv"
    np.savetxt(file, np.sqrt(np.column_stack(microseism(level, low_hz)) ** [2, 1]), delimiter=",", header="f_hz,a_m/s2_rthz", comments="")  # fmt: skip
    _, _, seen = read_floor(str(file), "m/s^2/sqrt(Hz)", 1, 1000.0, [])
    assert any(f"Below {LINE_HZ:g} Hz" in each for each in seen) == said
