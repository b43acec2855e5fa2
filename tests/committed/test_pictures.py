"""What is drawn lies within its picture."""

import matplotlib.image
import pytest

from .test_figures import COMMITTED

PICTURES = sorted(COMMITTED.rglob("*.png"))


def test_there_are_pictures():
    assert PICTURES


@pytest.mark.parametrize("picture", PICTURES, ids=[str(each.relative_to(COMMITTED)) for each in PICTURES])
def test_nothing_dark_touches_the_edge(picture):
    shades = matplotlib.image.imread(picture)[..., :3].min(axis=2)
    edges = (shades[0], shades[-1], shades[:, 0], shades[:, -1])
    assert min(each.min() for each in edges) > 0.6, "a label or a mark is cut off"
