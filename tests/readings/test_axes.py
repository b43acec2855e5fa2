"""What ``readings.toml`` may say, and what is said where it is wrong."""

import pytest

from readings.toy_work import LEDGER, SEEDS, A, B, axis, study
from stillwork.base.checks import InputError
from stillwork.workbook.readings.axes import begins_with, load_axes


def test_axes_and_studies_are_read_as_declared(workbook):
    axes, (multiverse,) = workbook(A + B + SEEDS + study(more='lean = "shorter"\npoints = 8'))
    assert list(axes) == ["a", "b", "seeds"]
    assert axes["a"].options == (0, 1, 2)
    assert [each.name for each in multiverse.axes] == ["a", "b"]
    assert multiverse.seeds == (8, 7, 9)  # the default first
    assert (multiverse.size, multiverse.default_point, multiverse.points) == (6, (0, 0), 8)
    assert multiverse.options((2, 1)) == {"a": 2, "b": 1}
    assert len(multiverse.entries) == LEDGER.count("place")
    assert multiverse.touched["motion.order"] == {"a", "b", "seeds"}


def test_a_room_without_readings_has_none(workbook, tmp_path):
    workbook()
    (tmp_path / "data/motion/readings.toml").unlink()
    assert load_axes("motion") == ({}, [])


def test_a_study_gets_only_the_axes_that_touch_its_entries(workbook):
    of_order = axis("c", [1, 2], 1, touches='["motion.order"]')
    _, (multiverse,) = workbook(A + of_order + study(entries='["motion.table-1"]'))
    assert [each.name for each in multiverse.axes] == ["a"]
    _, (multiverse,) = workbook(A + of_order + study(entries='["motion.table-1", "motion.order"]'))
    assert multiverse.touched == {
        "motion.table-1.sum": {"a"},
        "motion.table-1.product": {"a"},
        "motion.order": {"a", "c"},
    }


def test_dashes_of_a_name_become_underscores_of_an_argument(workbook):
    _, (multiverse,) = workbook(axis("strut-damping", [5.0, 65.0], 65.0) + study())
    assert multiverse.options((1,)) == {"strut_damping": 65.0}
    assert multiverse.reading((1,)) == {"strut-damping": 65.0}


@pytest.mark.parametrize(
    ("entry", "start", "begins"),
    [
        ("motion.fig-7.end", "motion.fig-7", True),
        ("motion.fig-70.end", "motion.fig-7", False),
        ("motion.fig-7", "motion.fig-7", True),
        ("motion.fig-7", "motion.fig-7.end", False),
    ],
)
def test_a_prefix_is_of_whole_parts(entry, start, begins):
    assert begins_with(entry, start) == begins


def test_a_study_whose_notebook_takes_another_option_has_its_own_default(workbook):
    first, second = (
        study(entries='["motion.table-1"]'),
        study(entries='["motion.order"]').replace("toy]", "other]"),
    )
    axes, plain = workbook(A + B + SEEDS + first + second)
    axes, own = workbook(A + B + SEEDS + first + second + "defaults = { b = 1, seeds = 9 }")
    assert [each.default_point for each in own] == [(0, 0), (0, 1)]
    assert [each.seeds for each in own] == [(8, 7, 9), (9, 7, 8)]
    assert axes["b"].default == 0
    assert [a.digest == b.digest for a, b in zip(plain, own, strict=True)] == [True, False]


TEXTS = axis("trace", '["literal", "regressors"]', '"literal"', "text")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (A.replace("default = 0", "default = 3"), "motion.a: default 3 is not among its options"),
        (
            TEXTS.replace('default = "literal"', 'default = "litral"'),
            "default 'litral' is not .*did you mean 'literal'",
        ),
        (A.replace("kind =", "knid ="), "motion.a: unknown field 'knid'; did you mean 'kind'"),
        (A.replace('kind = "number"', 'kind = "nmber"'), "motion.a: kind is 'nmber'.*did you mean 'number'"),
        (A.replace('source = "section 1 leaves it open"', ""), "motion.a: source is missing"),
        (A.replace('"section 1 leaves it open"', '""'), "motion.a: source is empty"),
        (
            A.replace("motion.order", "motion.ordr"),
            "touches: .*no entry 'motion.ordr'; did you mean 'motion.order'",
        ),
        (A.replace("[0, 1, 2]", "[0]"), "options holds 1; give at least 2"),
        (A.replace("[0, 1, 2]", "[0, 0]"), "two options are written alike"),
        (A.replace("[0, 1, 2]", '[0, "0"]'), "two options are written alike"),
        (A.replace("[0, 1, 2]", "[0, [1]]"), r"option \[1\] is no text, number or flag"),
        (A.replace("[0, 1, 2]", "[0, nan]"), "option nan is no text"),
        (A.replace("[0, 1, 2]", "0"), "options is no list"),
        (A.replace("kind =", "after = 1\nkind ="), "motion.a: after is 1; give true or false"),
        (A.replace('"section 1 leaves it open"', "1"), "motion.a: source is 1; give a text"),
        (SEEDS.replace("[7, 8, 9]", "[7, 8, -9]"), "option is -9; give a whole number"),
        (SEEDS + SEEDS.replace("seeds", "more") + study(), "motion.seeds and motion.more are both its seeds"),
        (axis("lean", [1, 2], 1), "'lean' cannot be an argument"),
        (axis("2nd", [1, 2], 1), "'2nd' cannot be an argument"),
        ("[motin.a]", "table 'motin' is neither 'motion' nor 'studies'"),
        ("[motion]\na = 1", "motion.a: a value, not a table"),
        ("[motion.a", "not valid TOML"),
        (
            A + study().replace("readings.toy_work:sums", "readings.toy_work"),
            "give 'package.module:function'",
        ),
        (A + study(more="point = 3"), "studies.toy: unknown field 'point'; did you mean 'points'"),
        (A + study(more="defaults = 0"), "studies.toy: defaults is 0; give a table"),
        (A + study(more="defaults = { b = 0 }"), "studies.toy: defaults names 'b', no axis of its entries"),
        (A + study(more="defaults = { a = 7 }"), "motion.a: default 7 is not among its options"),
        (A + study(entries='["motion.none"]'), "studies.toy: entries: the ledger has no entry 'motion.none'"),
        (A + study(more="points = 1"), "studies.toy: points is 1"),
        (A + study() + study().replace("toy]", "other]"), "is given by studies toy and other; keep one"),
    ],
)
def test_what_is_wrong_is_named(workbook, text, message):
    with pytest.raises(InputError, match=message):
        workbook(text)


def test_wording_is_no_part_of_the_digest_and_options_are(workbook):
    _, (before,) = workbook(A + B + study())
    _, (reworded,) = workbook((A + B).replace("leaves it open", "does not say") + study())
    _, (changed,) = workbook((A + B).replace("[0, 1, 2]", "[0, 1, 3]") + study())
    _, (lean,) = workbook(A + B + study(more='lean = "shorter"'))
    assert before.digest == reworded.digest
    assert len({before.digest, changed.digest, lean.digest}) == 3
