import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from workbook import figures
from workbook.thinning import DENSE, REACH, kept_points, thin


def distance(points, line):
    """Largest distance of `points` from a line through the vertices `line`."""
    start, step = line[:-1], np.diff(line, axis=0)
    along = np.einsum("psk,sk->ps", points[:, None] - start, step) / np.maximum((step**2).sum(axis=1), 1e-300)
    nearest = start + np.clip(along, 0, 1)[..., None] * step
    return np.linalg.norm(points[:, None] - nearest, axis=2).min(axis=1).max()


@pytest.mark.parametrize(
    ("curve", "at_most"),
    [
        (lambda t: np.c_[t, 0.3 * t], 2),
        (lambda t: np.c_[t, 100 * np.sin(t / 40)], 150),
        (lambda t: np.c_[t, -20 * np.log10(np.abs(1 - (t / 200 + 1e-3j) ** 2))], 120),
        (lambda t: np.c_[t, 100.0 * (t > 200)], 4),
        (lambda t: 150 * np.c_[np.cos(t / 80), np.sin(t / 80)], 120),
        (lambda t: np.c_[200 - np.abs(t - 200), 0 * t], 3),
    ],
    ids=["straight", "wave", "resonance", "step", "circle", "there and back"],
)
def test_no_point_lies_farther_than_the_reach_from_what_is_kept(curve, at_most):
    points = curve(np.linspace(1e-3, 480, 1500))
    kept = kept_points(points)
    assert distance(points, points[kept]) <= REACH
    assert {0, len(points) - 1} <= set(kept) and np.all(np.diff(kept) > 0)
    assert len(kept) <= at_most


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(*[st.floats(-300, 300)] * 2), min_size=3, max_size=40), st.floats(0.05, 3.0))
@example(
    [(1.0, -1.0), (0.0, 0.3125), (0.0, 0.0)], 0.25
)  # turns back, beside the line as well as beyond its end
def test_any_line_is_kept_within_the_reach(points, reach):
    points = np.array(points)
    assume(len(points) <= 8 * np.ptp(points[:, 0]))  # else columns of pixels become strokes
    assert distance(points, points[kept_points(points, reach)]) <= np.sqrt(2) * reach * (1 + 1e-9)


def test_many_samples_a_column_become_its_lowest_and_highest():
    points = np.c_[np.linspace(0, 100, 20000), np.random.default_rng(1).normal(scale=40, size=20000)]
    points[12345, 1] = 500.0
    kept = kept_points(points)
    assert 12345 in kept and len(kept) <= 4 * 201
    for column in range(100):
        inside = np.flatnonzero((points[:, 0] >= column) & (points[:, 0] < column + 1))
        left = points[np.intersect1d(inside, kept), 1]
        assert left.min() <= points[inside, 1].min() + REACH and left.max() >= points[inside, 1].max() - REACH


def test_rounding_does_not_choose_other_points():
    t = np.linspace(0, 500, 6000)
    flat = np.where(t < 100, 0.0, np.where(t < 300, 60 * np.sin(t), 40.0))
    noise = 1e-12 * np.random.default_rng(2).normal(size=len(t))
    np.testing.assert_array_equal(kept_points(np.c_[t, flat]), kept_points(np.c_[t, flat + noise]))


def test_only_dense_plain_lines_are_thinned_and_the_limits_stay():
    figure, axes = figures.new()
    t = np.linspace(1, 10, 5 * DENSE)
    gap = np.where(np.abs(t - 5) < 1, np.nan, t)
    lines = {
        "thinned": axes.semilogx(t, t**2)[0],
        "broken": axes.plot(t, gap)[0],
        "marked": axes.plot(t, t, ".")[0],
        "steps": axes.step(t, t)[0],
        "short": axes.plot(t[:DENSE], t[:DENSE])[0],
        "limit": axes.axhline(3.0),
    }
    before = axes.get_xlim(), axes.get_ylim()
    whole = {name: line.get_xydata().copy() for name, line in lines.items()}
    with thin(figure, 150):
        assert (axes.get_xlim(), axes.get_ylim()) == before
        left = {name: len(line.get_xdata()) for name, line in lines.items()}
        x, y = lines["broken"].get_data()
    assert (axes.get_xlim(), axes.get_ylim()) == before
    for name, line in lines.items():
        np.testing.assert_array_equal(line.get_xydata(), whole[name])
    assert left.pop("thinned") < 80 and left.pop("broken") < 80
    assert left == {"marked": 5 * DENSE, "steps": 5 * DENSE, "short": DENSE, "limit": 2}
    assert np.isnan(y).sum() == 1
    assert (
        np.isclose(x[~np.isnan(y)], 4.0, atol=0.02).any()
        and np.isclose(x[~np.isnan(y)], 6.0, atol=0.02).any()
    )


def test_a_line_is_whole_again_after_an_error_inside():
    figure, axes = figures.new()
    t = np.linspace(0, 1, 5 * DENSE)
    (line,) = axes.plot(t, t)
    with pytest.raises(ZeroDivisionError), thin(figure, 150):
        assert len(line.get_xdata()) == 2
        _ = 1 / 0
    assert len(line.get_xdata()) == 5 * DENSE
    axes.plot([2.0], [3.0])
    assert axes.get_xlim()[1] > 2 and axes.get_ylim()[1] > 3  # still follows the data
