"""How entries stand, against counts by hand and by brute force."""

import itertools

import numpy as np
import pytest
from scipy import stats

from choices.toy_work import FIRST, LEDGER, SEEDS, TOTAL, A, B, axis, study
from workbook.checks import InputError
from workbook.choices.axes import load_axes
from workbook.choices.judging import agreement, judge
from workbook.claims import Claim, load_entries
from workbook.studies import proportion_interval

GRID = list(itertools.product(range(3), range(2)))


def judged(*outcomes):
    axes, _ = load_axes("motion")
    return judge(list(outcomes), load_entries("motion"), axes)


def test_shares_and_deciding_axes_are_those_of_the_toy(outcomes):
    """Published are 3 +- 1 for y = a + 2 b + a b, 2 for a b, and a <= b; counted here over all six combinations."""
    standings = judged(outcomes())
    agree = {
        "motion.table-1.sum": [abs(a + 2 * b + a * b - 3) <= 1 for a, b in GRID],
        "motion.table-1.product": [a * b == 2 for a, b in GRID],
        "motion.order": [a <= b for a, b in GRID],
        "motion.never": [False] * 6,
        "motion.always": [True] * 6,
    }
    assert {name: standings[name].agree for name in agree} == {name: sum(a) for name, a in agree.items()}
    shares = standings["motion.table-1.sum"].shares
    assert (shares.first, shares.total) == (pytest.approx(FIRST), pytest.approx(TOTAL))
    assert standings["motion.table-1.sum"].decided_by == ["b", "a"]
    shown = standings["motion.table-1.sum"].as_dict()  # in the ledger
    counts = sum(agree["motion.table-1.sum"])
    assert (shown["tried"], shown["agree"], shown["share"], shown["range"]) == (6, counts, counts / 6, [0, 6])
    assert shown["interval"] == pytest.approx(list(proportion_interval(counts, 6)))
    assert shown["decided_by"][1] == {"axis": "a"} | {
        "first_order": pytest.approx(FIRST["a"]),
        "total": pytest.approx(TOTAL["a"]),
    }
    assert shown["axes"][0] == {"axis": "a", "options": [0, 1, 2], "unit": "", "after": False}
    assert standings["motion.never"].decided_by == []


def test_an_ordering_is_decided_by_what_flips_it(outcomes):
    flips = np.array([[a <= b] for a, b in GRID], float).reshape(3, 2)
    whole = flips.var()
    shares = judged(outcomes())["motion.order"].shares
    assert shares.total["a"] == pytest.approx(flips.var(axis=0).mean() / whole)
    assert shares.total["b"] == pytest.approx(flips.var(axis=1).mean() / whole)
    assert shares.total["a"] > shares.total["b"]


def test_seeds_count_as_tries_and_not_as_combinations(outcomes):
    """The sum with -1, 0, 1 added: agreement counted by brute force; the interval is that of six combinations."""
    standing = judged(outcomes(A + B + SEEDS + study("noisy")))["motion.table-1.sum"]
    agree = [abs(a + 2 * b + a * b + noise - 3) <= 1 for a, b in GRID for noise in (-1, 0, 1)]
    assert (standing.tried, standing.agree) == (18, sum(agree))
    assert standing.interval == proportion_interval(sum(agree) / 18 * 6, 6)
    assert standing.shares.total == pytest.approx({"a": 20 / 55, "b": 29 / 55, "seeds": 8 / 55})


def test_copies_of_a_setting_are_no_further_combinations(outcomes):
    """b moves the sum alone: of what a alone touches there are three settings, though six points were computed."""
    second = axis("b", [0, 1], 0, touches='["motion.table-1", "motion.order"]')
    standings = judged(outcomes(A + second + study()))
    always, shown = standings["motion.always"], standings["motion.shown"]
    assert (always.tried, always.agree, always.settings) == (3, 3, ((0,), (1,), (2,)))
    assert always.interval == proportion_interval(3, 3)
    assert shown.values.ravel().tolist() == pytest.approx([0, 1 / 3, 2 / 3])
    assert standings["motion.table-1.sum"].tried == 6


def test_the_default_combination_has_the_verdict_of_the_ledger(outcomes):
    """A study whose short form gives 0 at the default, where the notebook found 3.2, published 3 +- 1."""
    found = outcomes()
    entries, (axes, _) = load_entries("motion"), load_axes("motion")
    claims = {"motion.table-1.sum": Claim(entries["motion.table-1.sum"], 3.2)}
    before = judge([found], entries, axes)["motion.table-1.sum"]
    after = judge([found], entries, axes, claims)["motion.table-1.sum"]
    assert (before.agree, after.agree) == (3, 4)
    assert after.values[0, 0] == 3.2 and after.differs == "0 in its study, 3.2 in the ledger"
    assert before.differs == ""
    # Of three copies of the default one has the ledger's verdict, and it counts.
    second = axis("b", [0, 1], 0, touches='["motion.table-1", "motion.order"]')
    found = outcomes(A + second + study())
    entries, (axes, _) = load_entries("motion"), load_axes("motion")
    always = judge([found], entries, axes, {"motion.always": Claim(entries["motion.always"], 5.0)})[
        "motion.always"
    ]
    assert (always.tried, always.agree, always.values[0, 0]) == (3, 2, 5.0)


def test_failures_count_neither_way(outcomes):
    standing = judged(outcomes(A + B + study("raising")))["motion.always"]
    assert (standing.tried, standing.agree) == (4, 4)
    assert standing.as_dict()["failed"] == 2
    assert standing.interval == proportion_interval(4, 4)


def test_an_axis_that_moves_what_it_does_not_touch_is_named(outcomes):
    hidden = axis("b", [0, 1], 0, touches='["motion.order"]')
    standings = judged(outcomes(A + hidden + study()))
    assert standings["motion.table-1.sum"].undeclared == ("b",)
    assert standings["motion.always"].undeclared == ()
    assert set(standings["motion.table-1.sum"].shares.total) == {"a"}


BY_INTERVAL = LEDGER.replace(
    'tolerance = { absolute = 1.0, source = "printed digits" }',
    'tolerance = { interval = 0.95, source = "one run" }',
)


def test_an_interval_of_the_study_is_what_a_published_run_must_fall_in(outcomes):
    found = outcomes(A + B + study("spread"), BY_INTERVAL)
    agrees = agreement(found, load_entries("motion")["motion.table-1.sum"])
    assert agrees.ravel().tolist() == [a / 3 <= 3 <= b + 10 for a, b in found.design]


def test_without_one_it_is_the_interval_over_the_seeds(outcomes):
    """Three seeds at -1, 0, 1: standard deviation 1, so a next run lies within t sqrt(1 + 1/3)."""
    found = outcomes(A + B + SEEDS + study("noisy"), BY_INTERVAL)
    agrees = agreement(found, load_entries("motion")["motion.table-1.sum"])
    reach = stats.t.ppf(0.975, 2) * np.sqrt(4 / 3)
    expected = [abs(a + 2 * b + a * b - 3) <= reach for a, b in found.design]
    assert agrees.tolist() == [[each] * 3 for each in expected]


def test_an_interval_needs_seeds(outcomes):
    with pytest.raises(InputError, match=r"^motion\.table-1\.sum\b.*'seed'"):
        judged(outcomes(ledger=BY_INTERVAL))


def test_a_threshold_is_held_against_each_seeds_fraction(outcomes):
    ledger = LEDGER.replace('kind = "ordering"', 'kind = "ordering"\nthreshold = 0.4')
    standing = judged(outcomes(ledger=ledger))
    assert standing["motion.order"].agree == sum(a <= b for a, b in GRID)
