"""What ``choices.toml`` may say, and what is said where it is wrong."""

import pytest

from choices.toy_work import LEDGER, SEEDS, A, B, axis, study
from workbook.checks import InputError


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


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (A.replace("default = 0", "default = 3"), r"^motion\.a: default\b"),
        (A.replace("kind =", "knid ="), r"^motion\.a\b.*'knid'.*'kind'"),
        (A.replace('kind = "number"', 'kind = "nmber"'), r"^motion\.a: kind\b"),
        (A.replace('source = "section 1 leaves it open"', ""), r"^motion\.a: source\b"),
        (A.replace("motion.order", "motion.ordr"), r"\btouches\b.*'motion\.ordr'.*'motion\.order'"),
        (A.replace("[0, 1, 2]", "[0, 0]"), r"^motion\.a\b.*options"),
        (A.replace("[0, 1, 2]", "[0, nan]"), r"\boption nan\b"),
        (SEEDS.replace("[7, 8, 9]", "[7, 8, -9]"), r"\boption\b.*-9\b"),
        (SEEDS + SEEDS.replace("seeds", "more") + study(), r"motion\.seeds and motion\.more\b"),
        (axis("lean", [1, 2], 1), "'lean'"),
        ("[motin.a]", "'motin'"),
        ("[motion.a", r"choices\.toml\b"),
        (A + study().replace("choices.toy_work:sums", "choices.toy_work"), r"^studies\.toy: function\b"),
        (A + study(more="point = 3"), r"^studies\.toy\b.*'point'.*'points'"),
        (A + study(more="defaults = { b = 0 }"), r"^studies\.toy: defaults\b.*'b'"),
        (A + study(entries='["motion.none"]'), r"^studies\.toy: entries\b.*'motion\.none'"),
        (A + study(more="points = 1"), r"^studies\.toy: points\b"),
        (A + study() + study().replace("toy]", "other]"), r"^motion\.table-1\.sum\b.*\btoy\b"),
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
