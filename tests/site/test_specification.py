"""Specification curves, of a study of two axes that can be told by hand."""

import numpy as np
import pytest

from workbook.choices.axes import Axis
from workbook.choices.judging import Robustness
from workbook.claims import Claim, Entry, Tolerance
from workbook.site.specification import said_of, sentence

SIGN = Axis("motion.sign", "which way?", ("up", "down"), "up", "not printed", ("motion.size",), "text")


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
