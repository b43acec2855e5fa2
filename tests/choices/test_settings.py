"""Settings found together, against hidden ones, closed forms and brute force."""

import dataclasses
import itertools
import json
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
from workbook.choices.windows import windows_of
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

    def find(printed, choices=CHOICES):
        ledger = "\n".join(map(ENTRY.format, NAMES, printed))
        _, multiverses = workbook(choices, ledger)
        tags = [[], ["parameters"], []]
        cells = [
            {"cell_type": "code", "metadata": {"tags": tag}, "source": source}
            for tag, source in zip(tags, CELLS, strict=True)
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
    assert first == "shape ramp: table-1.y1, table-1.y3" and last == "under no setting: table-1.y2"
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


def test_numbers_of_two_settings_are_explained_by_none(paper):
    first = [value(k, "ramp", 2, 0.83) for k in range(1, 8)]
    _, joint = paper([*first, *(value(k, "sine", 3, 2.41) for k in range(8, 13))])
    assert joint.agree < 12 and not joint.never
    assert (joint.best["shape"], joint.best["order"], len(joint.lost)) == ("ramp", "2.0", 5)
    assert value(5, "ramp", 2, float(joint.best["gain"])) == pytest.approx(
        value(5, "ramp", 2, 0.83), abs=0.01
    )
    assert report("motion", joint)[0].startswith("motion: no setting explains all: 7 of 12")


def random_numbers(rng):
    """Numbers of up to three of five choices, half of their settings agreeing, with what was not tried left out."""
    options = {name: [f"{name}{k}" for k in range(3)] for name in "abcde"}
    numbers = []
    for k in range(12):
        axes = tuple(sorted(rng.choice(list(options), rng.integers(1, 4), replace=False).tolist()))
        whole = itertools.product(*(options[name] for name in axes))
        agrees = {setting: bool(rng.random() < 0.3) for setting in whole if rng.random() < 0.8}
        numbers.append(Number(f"n{k}", axes, agrees))
    return numbers, options


@pytest.mark.parametrize("factorial", [5e7, 0])
def test_the_best_joint_settings_are_those_of_brute_force(monkeypatch, factorial):
    """Most numbers at once, and with every single option held; by one choice after the other, too."""
    monkeypatch.setattr(settings, "FACTORIAL", factorial)
    for seed in range(5):
        numbers, options = random_numbers(np.random.default_rng(seed))
        scores = {
            each: sum(n.agrees.get(tuple(each["abcde".index(a)] for a in n.axes), False) for n in numbers)
            for each in itertools.product(*options.values())
        }
        joint = best_joint(numbers, options, {name: texts[0] for name, texts in options.items()})
        assert joint.agree == scores[tuple(joint.best.values())] == max(scores.values())
        for one in joint.settings:
            held = max(score for each, score in scores.items() if one.option in each)
            assert one.agree == held or (not factorial and one.agree < held)  # a climb may end below
            touched = [n for n in numbers if one.axis in n.axes]
            yes = [n.id for n in touched if any(one.option in s for s, agrees in n.agrees.items() if agrees)]
            some = [n.id for n in touched if any(n.agrees.values())]
            by_all = [
                n.id
                for n in touched
                if all(any(o in s for s, agrees in n.agrees.items() if agrees) for o in options[one.axis])
            ]
            assert one.supports == tuple(name for name in yes if name not in by_all)
            assert one.contradicts == tuple(name for name in some if name not in yes)
            assert one.indifferent == len(touched) - len(one.supports) - len(one.contradicts)


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
        ("{ shape = [0, 1] }", r"^studies.toy: windows\b.*gain"),
    ],
)
def test_a_window_is_a_range_of_a_choice_of_numbers(workbook, windows, message):
    ledger = "\n".join(map(ENTRY.format, NAMES, range(12)))
    with pytest.raises(InputError, match=message):
        workbook(CHOICES.replace("{ gain = [0.5, 3.0] }", windows), ledger)
