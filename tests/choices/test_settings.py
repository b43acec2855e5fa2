"""Settings found together, against hidden ones, closed forms and brute force."""

import dataclasses
import itertools
import json
import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from choices.toy_work import axis
from workbook import paths
from workbook.checks import InputError
from workbook.choices import settings
from workbook.choices.kept import read_settings, settings_text, wanted
from workbook.choices.results import results_text
from workbook.choices.running import Journal, run_combinations
from workbook.choices.settings import (
    Number,
    best_joint,
    joint_settings,
    meetings,
    printed_entries,
    report,
)
from workbook.choices.windows import pieces_of, windows_of
from workbook.claims import load_entries

# A paper of twelve numbers in a notebook: y_k = gain * s(0.3 k)^(1 / order) + k / 10, of one of three shapes s.
CELLS = [
    "from math import exp, sin\npage = None",
    "shape: str = 'ramp'  # of the curve\norder: float = 1.0  # of the root\ngain: float = 1.0  # of it",
    "s = {'ramp': lambda t: t, 'sine': sin, 'decay': lambda t: 1 - exp(-t)}[shape]\n"
    "for k in range(1, 13):\n"
    "    page.check(f'motion.table-1.y{k}', gain * s(0.3 * k / 4) ** (1 / order) + k / 10)",
]
ENTRY = (
    '[{}]\nplace = "Table 1"\nquantity = "y"\nunit = "1"\npublished = {:.2f}\nkind = "value"\n'
    'tolerance = {{ absolute = 0.005, source = "half the last printed digit" }}\n'
)
SHAPES = {"ramp": lambda t: t, "sine": np.sin, "decay": lambda t: -np.expm1(-t)}
NAMES = [f"motion.table-1.y{k}" for k in range(1, 13)]
TOUCHES = json.dumps(["motion.table-1"])
STUDY = f'[studies.toy]\nfunction = "motion/01-toy"\nentries = {TOUCHES}\nwindows = {{ gain = [0.5, 3.0] }}\n'
CHOICES = (
    axis("shape", '["ramp", "sine", "decay"]', '"ramp"', "text", TOUCHES)
    + axis("order", [1.0, 2.0, 3.0], 1.0, touches=TOUCHES)
    + axis("gain", [1.0, 2.0], 1.0, touches=TOUCHES)
    + STUDY
)


def value(k, shape, order, gain):
    return gain * SHAPES[shape](0.3 * k / 4) ** (1 / order) + k / 10


@pytest.fixture
def paper(workbook, tmp_path):
    """Writes the paper with these printed numbers, and finds its settings."""

    def find(printed, choices=CHOICES, sources=CELLS):
        ledger = "\n".join(map(ENTRY.format, NAMES, printed))
        _, multiverses = workbook(choices, ledger)
        tags = [[], ["parameters"], []]
        cells = [
            {"cell_type": "code", "metadata": {"tags": tag}, "source": source}
            for tag, source in zip(tags, sources, strict=True)
        ]
        file = tmp_path / "notebooks" / "motion" / "01-toy.ipynb"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps({"cells": cells}))
        found = run_combinations(multiverses, lambda: ThreadPoolExecutor(1), Journal(tmp_path / "a.jsonl"))
        paths.data("motion", "choices.csv").write_text(results_text(found))
        journal = Journal(tmp_path / "b.jsonl")
        with ThreadPoolExecutor(1) as pool:
            windows = windows_of(multiverses, printed_entries("motion"), pool, journal)
            journal.file.unlink()
            assert windows_of(multiverses, printed_entries("motion"), pool, journal) == windows  # as kept
        return windows, joint_settings("motion", windows)

    return find


def test_three_hidden_settings_are_found_from_twelve_printed_numbers(paper):
    windows, joint = paper([value(k, "decay", 3, 1.37) for k in range(1, 13)])
    assert (joint.agree, joint.numbers, joint.lost, joint.never) == (12, 12, (), ())
    assert (joint.best["shape"], joint.best["order"]) == ("decay", "3.0")
    # What the gain may be: by hand, each number is linear in it.
    ends = []
    for k in range(1, 13):
        printed, root = round(value(k, "decay", 3, 1.37), 2), SHAPES["decay"](0.3 * k / 4) ** (1 / 3)
        ends.append([(printed + part - k / 10) / root for part in (-0.005, 0.005)])
        mine = [each for each in windows if each.number == NAMES[k - 1]]
        (found,) = [each for each in mine if dict(each.others) == {"shape": "decay", "order": "3.0"}]
        assert found.pieces == (pytest.approx(tuple(ends[-1]), rel=1e-4),)
    low, high = max(low for low, _ in ends), min(high for _, high in ends)
    assert low < float(joint.best["gain"]) < high and low < 1.37 < high
    met = {tuple(each.others.values()): each.pieces for each in meetings(windows) if each.pieces}
    assert met["decay", "3.0"] == (pytest.approx((low, high), rel=1e-4),)
    assert report("motion", joint)[0].startswith("motion: all 12 printed numbers agree at once, calibrated")
    paths.data("motion", "settings.csv").write_text(settings_text(joint))
    assert read_settings("motion") == joint
    assert read_settings("budget") is None
    # Which number wants what, from a file with one number that wants an option and one that none explains.
    ramp, *others = joint.settings
    asked = dataclasses.replace(ramp, supports=("motion.table-1.y1", "motion.table-1.y3"))
    never = ("motion.table-1.y2", "motion.table-2.y1")
    file = paths.data("motion", "settings.csv")
    file.write_text(settings_text(dataclasses.replace(joint, settings=(asked, *others), never=never)))
    assert [ramp.axis, ramp.option] == ["shape", "ramp"]
    first, *rest, last = wanted(file, ["shape"], never=["table-1"])
    assert first == "shape ramp: table-1.y1, table-1.y3" and last == "under no computed setting: table-1.y2"
    assert rest == ["shape sine: none", "shape decay (best joint): none"]
    with pytest.raises(InputError, match="shap"):
        wanted(file, ["shap"])


@pytest.mark.slow
def test_two_hidden_settings_between_the_options_are_found(paper):
    """Both move every number: only with both right does any come out."""
    choices = CHOICES.replace("{ gain", "{ order = [0.8, 4.0], gain")
    _, joint = paper([value(k, "decay", 2.43, 1.37) for k in range(1, 13)], choices)
    assert (joint.agree, joint.best["shape"]) == (12, "decay")
    found = [float(joint.best[name]) for name in ("order", "gain")]
    assert found == pytest.approx([2.43, 1.37], rel=0.02)
    printed = np.round([value(k, "decay", 2.43, 1.37) for k in range(1, 13)], 2)
    assert np.abs([value(k, "decay", *found) for k in range(1, 13)] - printed).max() <= 0.005


# Twelve numbers each that turn round, hardly move, jump, or move in a small part of the range only.
CURVES = {
    "wave": lambda k, gain: math.exp(-gain * k / 12) * math.cos(gain * k),
    "peak": lambda k, gain: k / (1 + ((gain - 0.5 - 0.2 * k) / 0.12) ** 2),
    "plateau": lambda k, gain: min(max(gain * k / 8, 0.5), 1.5) + k / 10,
    "step": lambda k, gain: math.floor(4 * gain + k / 12) / 4,
}
BLIND = [
    "import math\npage = None",
    "shape: str = 'wave'  # of the curve\ngain: float = 1.0  # of it",
    "from choices.test_settings import CURVES\n"
    "for k in range(1, 13):\n    page.check(f'motion.table-1.y{k}', CURVES[shape](k, gain))",
]
BLIND_CHOICES = (
    axis("shape", json.dumps([*CURVES]), '"wave"', "text", TOUCHES)
    + axis("gain", [1.0, 2.0], 1.0, touches=TOUCHES)
    + STUDY
)


@pytest.mark.parametrize("shape", CURVES)
def test_a_blind_paper_has_its_hidden_setting_found(paper, shape):
    """Of several shapes, drawn at random; each window by brute force, but for what is narrower than a step and turns sharply."""
    for seed in range(3):
        hidden = np.random.default_rng([seed, len(shape)]).uniform(0.6, 2.9)
        printed = [round(CURVES[shape](k, hidden), 2) for k in range(1, 13)]
        windows, joint = paper(printed, BLIND_CHOICES, BLIND)
        assert (joint.agree, joint.best["shape"]) == (12, shape), hidden
        found = float(joint.best["gain"])
        assert all(abs(CURVES[shape](k, found) - y) <= 0.00501 for k, y in enumerate(printed, 1))
        gains = np.linspace(0.5, 3.0, 40001)
        for each in (one for one in windows if dict(one.others)["shape"] == shape):
            k = int(each.number.rpartition("y")[2])
            inside = np.abs(np.array([CURVES[shape](k, x) for x in gains]) - printed[k - 1]) <= 0.005
            ours = np.any([(low <= gains) & (gains <= high) for low, high in each.pieces], axis=0)
            differs = np.flatnonzero(inside != ours)
            # Runs of points that differ: an end between two points, or a window that hides between two searched values.
            for run in np.split(differs, np.flatnonzero(np.diff(differs) > 1) + 1) if len(differs) else ():
                narrow = float(each.step) * (shape == "peak")
                assert gains[run[-1]] - gains[run[0]] <= max(narrow, 2e-4), (hidden, each)


def test_a_window_is_found_where_a_value_turns_within_a_cell():
    """Parabolas that enter what agrees between two of the searched values, from outside and from inside."""
    for seed in range(50):
        place, width = np.random.default_rng(seed).uniform([1.1, 1e-4], [8.9, 0.4])
        grid = np.linspace(0.0, 10.0, 11).tolist()

        def outside(x, place=place, width=width):
            above = (x - place) ** 2 - width**2
            return above, -above - 100

        (found,) = pieces_of(outside, grid)
        assert found == pytest.approx((place - width, place + width), abs=2e-4)
        gaps = pieces_of(lambda x: (-outside(x)[0], -100.0), grid)
        ends = np.ravel([(0.0, place - width), (place + width, 10.0)])
        assert np.ravel(gaps) == pytest.approx(ends, abs=2e-4)


def test_ends_and_middles_of_a_window_agree():
    """Of a value that jumps at random between the searched ones, too: what disagrees is cut out where it is met."""
    for seed in range(20):
        jumps = np.sort(np.random.default_rng(seed).uniform(0, 1, 30))
        asked = {}

        def outside(x, jumps=jumps, asked=asked):
            asked[x] = (-1.0, 0.0 if np.searchsorted(jumps, x) % 2 else 1.0)
            return asked[x]

        found = pieces_of(outside, np.linspace(0, 1, 25).tolist())
        for low, high in found:
            for x in (low, high, (low + high) / 2):
                assert outside(x)[1] == 0.0
        for x, (_, below) in asked.items():
            near = any(abs(x - end) < 2e-5 for piece in found for end in piece)
            assert near or (below == 0.0) == any(low <= x <= high for low, high in found)


def test_numbers_of_two_settings_are_explained_by_none(paper):
    first = [value(k, "ramp", 2, 0.83) for k in range(1, 8)]
    _, joint = paper([*first, *(value(k, "sine", 3, 2.41) for k in range(8, 13))])
    assert joint.agree < 12 and not joint.never
    assert (joint.best["shape"], joint.best["order"], len(joint.lost)) == ("ramp", "2.0", 5)
    assert value(5, "ramp", 2, float(joint.best["gain"])) == pytest.approx(
        value(5, "ramp", 2, 0.83), abs=0.01
    )
    first, second, *_ = report("motion", joint)
    assert first.startswith("motion: no setting explains all: 7 of 12")
    assert second.startswith("at most 7 could")
    first, second, *_ = report("motion", dataclasses.replace(joint, bound=12))
    assert first.startswith("motion: none found among what was computed explains all: 7 of 12")


def test_an_option_that_was_not_computed_supports_and_contradicts_nothing():
    """Two of three options computed, both agreeing; then one of them not."""
    for agrees, supports, contradicts in (
        ([1, 1, -1], [0, 0, 0], [0, 0, 0]),
        ([1, 0, -1], [1, 0, 0], [0, 1, 0]),
    ):
        number = Number("n", ("a",), np.array(agrees, np.int8))
        found = best_joint([number], {"a": ["0", "1", "2"]}, {"a": 0}).settings
        assert [len(each.supports) for each in found] == supports
        assert [len(each.contradicts) for each in found] == contradicts


def test_a_choice_that_decides_with_others_alone_tells():
    """Each option agrees with some option of the other choice, but the default is worse at once."""
    numbers = [
        Number("n", ("a", "b"), np.array([[1, 0], [0, 1]], np.int8)),
        Number("m", ("b",), np.array([0, 1], np.int8)),
    ]
    joint = best_joint(numbers, {"a": ["0", "1"], "b": ["0", "1"]}, {"a": 0, "b": 0})
    (best,) = [each for each in joint.settings if each.axis == "a" and each.best]
    assert (best.option, best.supports, best.contradicts, joint.telling) == ("1", (), (), {"a", "b"})


def random_numbers(rng):
    """Numbers of up to three of five choices, a third of their settings agreeing, some not computed."""
    options = {name: [f"{name}{k}" for k in range(3)] for name in "abcde"}
    numbers = []
    for k in range(12):
        axes = tuple(sorted(rng.choice(list(options), rng.integers(1, 4), replace=False).tolist()))
        agrees = rng.choice([-1, 0, 1], [3] * len(axes), p=[0.2, 0.5, 0.3]).astype(np.int8)
        numbers.append(Number(f"n{k}", axes, agrees))
    return numbers, options


def table_of(number, options):
    """Whether it agrees, by the options of its axes; what was not computed is missing."""
    places = itertools.product(*(range(len(options[axis])) for axis in number.axes))
    by_places = {at: int(number.agrees[at]) for at in places if number.agrees[at] >= 0}
    return {
        tuple(options[a][k] for a, k in zip(number.axes, at, strict=True)): v for at, v in by_places.items()
    }


def test_the_best_joint_settings_are_those_of_brute_force():
    """Most numbers at once, with every single option held, and where axes must be equal."""
    for seed in range(8):
        numbers, options = random_numbers(np.random.default_rng(seed))
        tables = {n.id: table_of(n, options) for n in numbers}
        settings_of = list(itertools.product(*options.values()))
        found = [
            [tables[n.id].get(tuple(each["abcde".index(a)] for a in n.axes)) for n in numbers]
            for each in settings_of
        ]
        scores = {each: sum(v == 1 for v in row) for each, row in zip(settings_of, found, strict=True)}
        joint = best_joint(numbers, options, dict.fromkeys(options, 0))
        best = tuple(joint.best.values())
        assert joint.agree == scores[best] == max(scores.values())
        moved = [sum(not o.endswith("0") for o in each) for each, n in scores.items() if n == joint.agree]
        assert sum(not o.endswith("0") for o in best) == min(moved)
        if joint.tried == len(scores):  # all axes are linked
            assert joint.whole == sum(None not in row for row in found)
        hoped = [sum(v != 0 for v in row) for row in found]
        assert settings.most_at_best(numbers) == max(hoped)
        divided = {one.axis for one in joint.settings if one.supports or one.contradicts}
        lower = {one.axis for one in joint.settings if one.agree < joint.agree}
        assert joint.telling == divided | lower
        for one in joint.settings:
            assert one.agree == max(score for each, score in scores.items() if one.option in each)
            touched = [n for n in numbers if one.axis in n.axes]
            supports, contradicts, rest = [], [], 0
            for n in touched:
                values = {o: {v for s, v in tables[n.id].items() if o in s} for o in options[one.axis]}
                known = {o: 1 in each for o, each in values.items() if each}
                divided = len(set(known.values())) == 2
                rest += not divided
                if one.option in known and divided:
                    (supports if known[one.option] else contradicts).append(n.id)
            assert (one.supports, one.contradicts) == (tuple(supports), tuple(contradicts))
            assert one.indifferent == rest


@pytest.mark.parametrize("axes", ["ab", "ace"])
def test_axes_that_must_be_equal_have_the_best_of_brute_force(axes):
    """The same options on all of them, but for one that the last axis lacks."""
    for seed in range(8):
        numbers, options = random_numbers(np.random.default_rng(seed))
        options |= {name: ["0", "1", "2"] for name in axes}
        options[axes[-1]] = ["0", "3", "2"]
        tables = {n.id: table_of(n, options) for n in numbers}
        free = {name: texts for name, texts in options.items() if name not in axes}
        by_option = {}
        for same in ("0", "2"):
            for each in itertools.product(*free.values()):
                chosen = dict(zip(free, each, strict=True)) | dict.fromkeys(axes, same)
                score = sum(tables[n.id].get(tuple(chosen[a] for a in n.axes), 0) for n in numbers)
                by_option[same] = max(by_option.get(same, 0), score)
        assert settings.as_one(axes, numbers, options, dict.fromkeys(options, 0)) == by_option


def test_the_last_axis_of_many_is_eliminated_exactly():
    """A chain of twelve choices, which no table of all their combinations has to hold."""
    rng = np.random.default_rng(3)
    names = [f"x{k:02}" for k in range(12)]
    tables = [((a, b), rng.integers(0, 9, (3, 3))) for a, b in itertools.pairwise(names)]
    whole = np.zeros([3] * 12, int)
    for k, (_, table) in enumerate(tables):
        whole += table.reshape([3 if j in (k, k + 1) else 1 for j in range(12)])
    value, places = settings.eliminate(tables, np.add, np.max)
    assert value == whole.max() == whole[tuple(places[name] for name in names)]
    assert (
        settings.eliminate(tables, np.multiply, np.sum)[0]
        == np.linalg.multi_dot([t for _, t in tables]).sum()
    )
    wide = [(tuple("abcdefghi"), np.zeros([10] * 6 + [2, 1, 1]))]
    assert settings.eliminate(wide, np.add, np.max)[0] == 0
    with pytest.raises(InputError, match="declare fewer options"):
        settings.eliminate(
            [(("a",), np.zeros(9000)), (("b",), np.zeros(9000)), (("a", "b"), np.zeros((9000, 9000), bool))],
            np.add,
            np.max,
        )


def test_a_choice_that_a_study_holds_leaves_its_numbers_unknown(workbook):
    """Away from the default at which they were computed nothing is known of them; of others it says nothing."""
    number = Number("motion.table-1.y1", ("shape",), np.array([1, 0], np.int8))
    options, defaults = {"shape": ["a", "b"], "floor": ["1", "2"]}, {"shape": 0, "floor": 1}
    found = settings._untried(number, {"floor": ["motion.table-1"]}, options, defaults)
    assert found.axes == ("shape", "floor") and found.agrees.tolist() == [[-1, 1], [-1, 0]]
    other = settings._untried(number, {"floor = 1": ["motion.table-1"]}, options, defaults)
    assert other.agrees.tolist() == [[1, -1], [0, -1]]  # not at the default, at the option that is named
    joint = best_joint([found], options, defaults)
    assert [each.agree for each in joint.settings] == [1, 0, 0, 1]
    assert not joint.settings[2].contradicts
    assert settings._untried(number, {"floor": ["motion.table"]}, options, defaults) == number
    workbook(CHOICES, "\n".join(map(ENTRY.format, NAMES, range(12))))
    paths.data("motion", "paper.toml").write_text('untried = { floor = ["motion.table-1"] }')
    with pytest.raises(InputError, match="untried"):
        joint_settings("motion", [])


def test_half_a_printed_digit_may_be_finer_than_the_tolerance(workbook):
    digits = '[digits]\n"motion.table-1.sum" = 0.05\n'
    workbook(digits)
    assert printed_entries("motion")["motion.table-1.sum"].tolerance.absolute == 0.05
    assert load_entries("motion")["motion.table-1.sum"].tolerance.absolute == 1.0


@pytest.mark.parametrize(
    ("windows", "message"),
    [
        ("{ gain = [2.0, 1.0] }", r"^studies.toy: windows: high end of gain\b"),
        ("{ gain = 1.0 }", r"give \[low, high\]"),
        ("{ gain = [1.0, 2.0, 0.5] }", r"^studies.toy: windows: cells of gain\b"),
        ("{ shape = [0, 1] }", r"^studies.toy: windows\b.*gain"),
    ],
)
def test_a_window_is_a_range_of_a_choice_of_numbers(workbook, windows, message):
    ledger = "\n".join(map(ENTRY.format, NAMES, range(12)))
    with pytest.raises(InputError, match=message):
        workbook(CHOICES.replace("{ gain = [0.5, 3.0] }", windows), ledger)
