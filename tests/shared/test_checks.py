import re
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from stillwork.base.checks import (
    InputError,
    require_array,
    require_choice,
    require_count,
    require_finite_run,
    require_number,
)
from stillwork.base.toml_files import read_toml
from stillwork.signals import load_record

numbers = st.floats(allow_nan=False, allow_infinity=False)


def steers(text: str) -> bool:
    return not all(each.isprintable() for each in text)


@pytest.mark.parametrize(
    "call",
    [
        pytest.param(lambda hostile: require_choice("floor", hostile, ["flat"]), id="an argument"),
        pytest.param(
            lambda hostile: require_number(f"deviations[{hostile}]", "x"), id="a name in an argument"
        ),
        pytest.param(lambda hostile: load_record(f"{hostile}.csv", "m"), id="a file that is not there"),
        pytest.param(
            lambda hostile: read_toml(written("a.toml", f"a = 1\n{hostile} = 2")), id="a broken TOML file"
        ),
        pytest.param(
            lambda hostile: load_record(written("a.csv", f"time,{hostile}\n1,2\n1,x\n"), "m"),
            id="a column's name",
        ),
    ],
)
def test_what_a_message_quotes_steers_no_terminal(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for hostile in ("a\x1b[2Jb", "a\x07b", "a\u202eb", "a\x9bb"):
        with pytest.raises(InputError) as refused:
            call(hostile)
        assert not steers(str(refused.value)), hostile
    assert str(InputError("a\nb \x1b[31mred")) == "a\\nb \\x1b[31mred"


def written(name: str, content: str) -> Path:
    Path(name).write_text(content)
    return Path(name)


@pytest.mark.parametrize(("axis", "sample"), [(0, 1), (1, 2), (-1, 2)])
def test_the_sample_at_which_a_run_overflows_is_named(axis, sample):
    values = np.zeros((3, 4))
    values[1, 2] = values[2, 3] = np.nan
    with pytest.raises(InputError, match=rf"^motion\b.*\bsample {sample}\b"):
        require_finite_run("motion", values, "stop", axis=axis)
    require_finite_run("motion", np.zeros((3, 4)), "stop", axis=axis)


@pytest.mark.parametrize(
    "value",
    [
        *(np.nan, np.inf, -np.inf, 1j, np.complex128(1 + 1j), Decimal("0.1"), Fraction(1, 2), True, np.True_),
        *("three", None, [1.0, 2.0], np.array([1.0]), np.ma.array(1.0, mask=True)),
    ],
)
def test_what_is_no_finite_number_is_refused(value):
    with pytest.raises(InputError, match=r"^x\b"):
        require_number("x", value)


@given(numbers, numbers)
def test_bounds_hold_as_named(value, bound):
    for option, good in (
        ("above", value > bound),
        ("at_least", value >= bound),
        ("below", value < bound),
        ("at_most", value <= bound),
    ):
        if good:
            assert require_number("x", value, **{option: bound}) == value
        else:
            with pytest.raises(InputError, match=rf"^x\b.*{re.escape(format(bound, 'g'))}$"):
                require_number("x", value, **{option: bound})


@pytest.mark.parametrize("value", [0, -1, 1.0, True, "3", None])
def test_counts_are_whole_and_positive(value):
    with pytest.raises(InputError, match=r"^runs\b"):
        require_count("runs", value)


@given(arrays.arrays(np.float64, arrays.array_shapes(max_dims=3), elements=numbers), st.data())
def test_the_first_bad_entry_is_named(value, data):
    where = tuple(data.draw(st.integers(0, n - 1)) for n in value.shape)
    value[where] = data.draw(st.sampled_from([np.nan, np.inf, -np.inf]))
    with pytest.raises(InputError, match=rf"^x\b.*{re.escape(str(where))}"):
        require_array("x", value)


@pytest.mark.parametrize(
    ("value", "options", "message"),
    [
        ([[1.0], [2.0, 3.0]], {}, r"^x\b"),
        (["a"], {}, r"^x\b"),
        ([1j], {}, r"^x\b.*complex"),
        (np.ones(2, complex), {}, r"^x\b.*complex"),
        ([1.0], {"ndim": 2}, r"^x\b.*\(1,\).*\b2 axes"),
        (1.0, {"ndim": 1}, r"^x\b.*\(\).*\b1 axes"),
        (np.zeros((2, 3)), {"shape": (2, 4)}, r"^x\b.*\(2, 3\).*\b2 x 4"),
        (np.zeros((2, 3)), {"shape": (None, 4)}, r"^x\b.*\bx 4"),
        (np.zeros(3), {"shape": (3, 1)}, r"^x\b.*\b3 x 1"),
    ],
)
def test_wrong_shapes_are_told(value, options, message):
    with pytest.raises(InputError, match=message):
        require_array("x", value, **options)
