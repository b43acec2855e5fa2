"""Specification curves, of a study of two axes that can be told by hand."""

import re
from itertools import pairwise

import numpy as np
import pytest

from workbook.choices.axes import Axis, Multiverse
from workbook.choices.judging import Robustness
from workbook.choices.results import Outcomes
from workbook.claims import Claim, Entry, Tolerance
from workbook.site.specification import HEIGHT, TOP, curve_of, said_of, sentence

# Value = size of `scale`, or minus it: published is 2, and 1.5 to 2.5 agree.
SCALE = Axis("motion.scale", "how large?", (1.0, 2.0, 4.0), 2.0, "not printed", ("motion.size",), "number")
SIGN = Axis("motion.sign", "which way?", ("up", "down"), "up", "not printed", ("motion.size",), "text")
OTHER = Axis("motion.other", "what else?", ("a", "b"), "a", "not printed", ("motion.else",), "text")
DESIGN = [(scale, sign, 0) for scale in range(3) for sign in range(2)]
VALUES = np.array([[(1.0, 2.0, 4.0)[scale] * (1, -1)[sign]] for scale, sign, _ in DESIGN])


def curve(values=VALUES, published=2.0, kind="value"):
    tolerance = None if kind == "reported" else Tolerance("printed", absolute=0.5)
    entry = Entry("motion.size", "Table 1", "size", "m", kind, published, tolerance, reason="a toy")
    agrees = np.abs(values - 2) <= 0.5
    settings = tuple(point[:2] for point in DESIGN)
    standing = Robustness(entry, (SCALE, SIGN), settings, values, agrees, np.zeros(values.shape, bool))
    seeds = tuple(range(1, values.shape[1] + 1))
    study = Multiverse("motion", "toy", "a:b", ("motion.size",), (SCALE, SIGN, OTHER), seeds)
    return curve_of(Outcomes(study, DESIGN, {"motion.size": values}), Claim(entry, over=standing))


def places(path):
    return [(float(x), float(y)) for x, y in re.findall(r"M([\d.]+) ([\d.]+)h0", path)]


def test_values_rise_from_left_to_right_and_colours_tell_who_agrees():
    drawn = curve()
    assert {kind: len(places(path)) for kind, path in drawn.dots.items()} == {"agrees": 1, "differs": 5}
    rising = sorted(place for path in drawn.dots.values() for place in places(path))
    assert all(a[1] > b[1] for a, b in pairwise(rising))  # heights grow downwards
    assert places(drawn.dots["agrees"])[0] == pytest.approx((rising[4][0], drawn.published), abs=0.06)
    assert drawn.ticks == ((TOP + HEIGHT, "-4"), (TOP, "4"))
    assert drawn.band == pytest.approx((TOP + HEIGHT * (4 - 2.5) / 8, HEIGHT / 8))
    assert drawn.seeds == ""


def claim_of(name, ours, published, share=None):
    """A claim that agrees at our settings within 0.5, and under a share of two combinations."""
    entry = Entry(
        f"motion.{name}", "Table 1", name, "Hz", "value", published, Tolerance("printed", absolute=0.5)
    )
    over = None
    if share is not None:
        agrees = np.array([[share > 0], [share == 1]])
        values, settings = np.array([[ours], [ours]]), ((0,), (1,))
        over = Robustness(entry, (SIGN,), settings, values, agrees, np.zeros((2, 1), bool))
    return Claim(entry, ours=ours, over=over)


@pytest.mark.parametrize(
    ("ours", "share", "expected"),
    [
        (83.2, None, "The bandwidth rises: from 37 Hz to 83.2 Hz (printed 83 Hz)."),
        (60.0, None, "It does not rise: to 60 Hz."),
        (83.2, 0, "Under most combinations of open choices, it does not rise."),
        (60.0, 1, "Under most combinations of open choices, the bandwidth rises."),
    ],
)
def test_a_sentence_has_the_numbers_of_its_run_where_they_bear_it_out(ours, share, expected):
    says = "the bandwidth rises: from {ours:motion.pid} to {ours} (printed {published})"
    statement = {"says": says, "otherwise": "it does not rise: to {ours}", "entry": "motion.both"}
    claims = [claim_of("pid", 37.0, 37.0), claim_of("both", ours, 83.0, share)]
    ((said, claim),) = said_of([statement, statement | {"entry": "motion.unknown"}], claims)
    assert sentence(said, claim) == expected
