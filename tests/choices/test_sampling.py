import itertools
from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from workbook.choices.axes import Axis, Multiverse
from workbook.choices.running import design


def multiverse(sizes, defaults=None, points=64):
    axes = tuple(
        Axis(f"motion.x{k}", "which", tuple(range(size)), default, "open", ("motion.order",), "number")
        for k, (size, default) in enumerate(zip(sizes, defaults or [0] * len(sizes), strict=True))
    )
    touched = {"motion.order": frozenset(axis.name for axis in axes)}
    return Multiverse("motion", "toy", "a:b", ("motion.order",), axes, touched=touched, points=points)


sizes = st.lists(st.integers(2, 5), min_size=1, max_size=6)


@given(sizes, st.integers(2, 150), st.data())
def test_a_design_begins_with_the_default_and_repeats_nothing(sizes, points, data):
    defaults = [data.draw(st.integers(0, size - 1)) for size in sizes]
    given = multiverse(sizes, defaults, points)
    found = design(given)
    assert found[0] == tuple(defaults)
    assert len(set(found)) == len(found)
    assert all(0 <= k < size for point in found for k, size in zip(point, sizes, strict=True))
    if given.size <= max(64, points):
        assert set(found) == set(itertools.product(*map(range, sizes)))
    else:
        assert len(found) == points


def test_the_sample_is_the_same_on_every_machine():
    """Written down once: another numpy or scipy that draws otherwise would orphan committed results."""
    found = design(multiverse([3, 3, 3, 3], points=5))
    assert found == FOUND


FOUND = [(0, 0, 0, 0), (2, 2, 0, 0), (0, 0, 2, 2), (0, 2, 1, 1), (1, 0, 2, 2)]


def test_a_longer_sample_begins_with_the_shorter():
    given = multiverse([4, 3, 5, 2])
    assert design(replace(given, points=100))[:64] == design(given)


def test_where_an_entrys_own_axes_are_few_all_of_their_settings_are_computed():
    """Of 1024 points 20 are drawn; the entry has 16 settings, of which the sample lacks some."""
    given = replace(multiverse([4, 4, 4, 4, 4], [1] * 5, 20), entries=("motion.order", "motion.few"))
    few = frozenset({"x1", "x3"})
    given = replace(given, touched=given.touched | {"motion.few": few})
    found = design(given)
    assert found[:20] == design(replace(given, entries=("motion.order",)))
    assert len({(point[1], point[3]) for point in found[:20]}) < 16
    assert {(point[1], point[3]) for point in found} == set(itertools.product(range(4), range(4)))
    assert all(point[0] == point[2] == point[4] == 1 for point in found[20:]) and len(set(found)) == len(
        found
    )
