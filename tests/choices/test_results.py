"""What ``choices.csv`` keeps, and what it refuses to keep quiet about."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from choices.toy_work import SEEDS, TOY, A, B, study
from workbook.checks import InputError
from workbook.choices.results import read_results, results_text, rounded


def written(found, tmp_path):
    (tmp_path / "data/motion/choices.csv").write_text(results_text([found]), encoding="utf-8")
    (read,) = read_results([found.multiverse])
    return read


@pytest.mark.parametrize("function", ["sums", "noisy", "spread", "raising"])
def test_what_is_written_is_read(outcomes, tmp_path, function):
    seeds = SEEDS if function == "noisy" else ""
    found = outcomes(A + B + seeds + study(function))
    read = written(found, tmp_path)
    assert (read.design, read.failures, read.code) == (found.design, found.failures, found.code)
    for one, other in ((found.values, read.values), (found.low, read.low), (found.high, read.high)):
        assert one.keys() == other.keys()
        for entry in one:
            np.testing.assert_array_equal(one[entry], other[entry])


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_seven_digits_are_kept(value):
    assert rounded(value) == pytest.approx(value, rel=5.1e-7, abs=1e-300)
    assert rounded(rounded(value)) == rounded(value)


def test_results_of_other_axes_are_none(outcomes, workbook, tmp_path):
    written(outcomes(), tmp_path)
    _, changed = workbook(TOY.replace("[0, 1, 2]", "[0, 1]"))
    assert read_results(changed) == []
    _, same = workbook(TOY.replace("leaves it open", "does not say"))
    assert len(read_results(same)) == 1


def test_a_damaged_file_is_named(outcomes, tmp_path):
    found = outcomes()
    text = results_text([found]).replace("1.333333", "?").replace("\n1,1,0,1", "\n1,1,0,5")
    (tmp_path / "data/motion/choices.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"choices\.csv.*\btoy\b"):
        read_results([found.multiverse])
