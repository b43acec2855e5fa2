"""How entries stand, against counts by hand and by brute force."""

import itertools

import numpy as np
import pytest
from scipy import stats

from choices.toy_work import FIRST, LEDGER, SEEDS, TOTAL, A, B, axis, study
from workbook.checks import InputError
from workbook.choices.axes import load_axes, load_together
from workbook.choices.judging import agreement, judge
from workbook.choices.results import collect
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


def off(ours, published):
    return min(abs(ours / published - 1), 1)


def test_the_best_joint_combination_is_the_nearest_and_one_for_the_whole_group(outcomes):
    """Published are a sum of 3 and a product of 2; nearest to both is (1, 1) with 4 and 1, though 2, 1 gives the product."""
    standings = judged(outcomes())
    joint = standings["motion.table-1.sum"].joint
    assert joint is standings["motion.table-1.product"].joint
    by_distance = {(a, b): off(a + 2 * b + a * b, 3) + off(a * b, 2) for a, b in GRID}
    assert min(by_distance, key=by_distance.get) == (joint.combination["a"], joint.combination["b"]) == (1, 1)
    assert (joint.group, joint.tried, joint.agreeing) == ("motion.table-1", 6, ("motion.table-1.sum",))
    assert joint.distance == pytest.approx((1 / 3 + 1 / 2) / 2)
    found = standings["motion.table-1.sum"].as_dict()["joint"]
    assert found["basis"] == "calibrated"
    assert found["agrees"] and found["ours"] == 4
    assert not standings["motion.table-1.product"].as_dict()["joint"]["agrees"]
    # There the sum is a third above the published 3, and the product half below the published 2.
    assert found["within"] == {"5%": 0, "15%": 0, "25%": 0, "of": 2}


def test_a_wide_interval_agrees_and_is_not_the_nearest_for_it(outcomes):
    """Intervals from a / 3 to b + 10 hold the published 3 everywhere; the values themselves are a third of the sum."""
    found = judged(outcomes(A + B + study("spread"), BY_INTERVAL))["motion.table-1.sum"]
    assert found.agree == 6
    distance = {(a, b): off((a + 2 * b + a * b) / 3, 3) + off(a * b, 2) for a, b in GRID}
    joint = found.joint
    assert min(distance, key=distance.get) == (joint.combination["a"], joint.combination["b"]) == (2, 1)


def test_what_lies_on_the_better_side_is_at_no_distance(outcomes):
    ledger = LEDGER.replace("published = 3.0", 'better = "larger"\npublished = 1.5')
    joint = judged(outcomes(ledger=ledger))["motion.table-1.sum"].joint
    distance = {(a, b): max(0, 1 - (a + 2 * b + a * b) / 1.5) + off(a * b, 2) for a, b in GRID}
    assert min(distance, key=distance.get) == (joint.combination["a"], joint.combination["b"]) == (2, 1)


def test_what_was_published_together_has_one_joint_combination(outcomes):
    """The order a <= b beside the sum and the product; a list of choices.toml, or all of the paper."""
    together = '[together]\n"the run" = ["motion.table-1", "motion.order"]\n'
    found = outcomes(A + B + study() + together)
    axes, _ = load_axes("motion")
    lists = load_together("motion")
    assert lists == {"the run": ("motion.table-1.sum", "motion.table-1.product", "motion.order")}
    standings = judge([found], load_entries("motion"), axes, together=lists)
    joint = standings["motion.order"].joint
    assert joint is standings["motion.table-1.sum"].joint and joint.group == "the run"
    distance = {(a, b): off(a + 2 * b + a * b, 3) + off(a * b, 2) + (a > b) for a, b in GRID}
    assert min(distance, key=distance.get) == (joint.combination["a"], joint.combination["b"])
    whole = standings["motion.never"].whole
    assert whole is standings["motion.order"].whole and len(whole.ours) == 5
    assert standings["motion.shown"].whole is None


@pytest.mark.parametrize(
    ("lists", "message"),
    [
        ('[together]\na = ["motion.table-1"]\nb = ["motion.table-1.sum"]\n', r"^motion\.table-1\.sum\b"),
        ('[together]\na = ["motion.nothing"]\n', r"^together\.a\b"),
        ('[together]\na = "motion.order"\n', r"^together\.a\b"),
    ],
)
def test_lists_of_what_was_published_together_are_checked(workbook, lists, message):
    workbook(A + B + study() + lists)
    with pytest.raises(InputError, match=message):
        load_together("motion")


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
    found = outcomes()
    entries, (axes, _) = load_entries("motion"), load_axes("motion")
    # With that value the default is nearer to all (0.07 and 1) than (2, 0) or (0, 1), not than (1, 1).
    assert after.joint.combination == {"a": 1, "b": 1}
    claims["motion.table-1.product"] = Claim(entries["motion.table-1.product"], 2.0)
    both = judge([found], entries, axes, claims)["motion.table-1.sum"].joint
    assert (both.moved, both.ours["motion.table-1.sum"], len(both.agreeing)) == ((), 3.2, 2)


@pytest.mark.slow
def test_a_joint_combination_over_two_studies_is_one_combination(workbook):
    """Two studies that share the axis a: the best pair by brute force over all pairs that agree on a."""
    _, multiverses = workbook(
        A
        + axis("b", [0, 1], 0, touches='["motion.table-1.sum"]')
        + axis("c", [0, 1], 0, touches='["motion.table-1.product"]')
        + study(entries='["motion.table-1.sum"]')
        + study(entries='["motion.table-1.product"]').replace("studies.toy", "studies.other")
    )
    pairs = [(i, j) for i, one in enumerate(GRID) for j, other in enumerate(GRID) if one[0] == other[0]]
    rng = np.random.default_rng(1)
    for _ in range(50):
        sums, products = rng.choice([2.0, 50.0], (2, 6), p=[0.3, 0.7]).tolist()
        found = [
            collect(one, GRID, {(k, 0): {one.entries[0]: value} for k, value in enumerate(values)})
            for one, values in zip(multiverses, (sums, products), strict=True)
        ]
        joint = judged(*found)["motion.table-1.sum"].joint
        assert joint.tried == len(pairs) == 12
        distance = {(i, j): off(sums[i], 3) + off(products[j], 2) for i, j in pairs}
        assert joint.distance == pytest.approx(min(distance.values()) / 2)
        at = joint.combination
        one, other = GRID.index((at["a"], at["b"])), GRID.index((at["a"], at["c"]))
        assert distance[one, other] == pytest.approx(min(distance.values()))


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
