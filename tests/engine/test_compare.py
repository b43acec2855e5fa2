"""What counts as the same result, and what does not."""

import io

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from matplotlib.figure import Figure

from workbook.claims import Claim, Entry, Tolerance
from workbook.compare import (
    difference,
    numbers_difference,
    same_outputs,
    same_picture,
    same_size,
    same_text,
    same_value,
    table_difference,
)
from workbook.figures import BLUE

HEADER = "panel,series,x,y,z\n"


def table(folder, name, rows):
    file = folder / f"{name}.csv"
    file.write_text(HEADER + "".join(f"a,line,{x:.9g},{y:.9g},\n" for x, y in rows))
    return file


@pytest.mark.parametrize(
    ("now", "before"),
    [
        ("rms 1.235 m", "rms 1.234 m"),
        ("rms 9.999 m", "rms 10.00 m"),
        ("a  1.235\n---  -----", "a  1.2349\n---  ------"),
        ("-0.1", "-0.2"),
        ("motion.table-3-5.pid  Table 3.5  37  37.1", "motion.table-3-5.pid  Table 3.5  37  37.2"),
        ("1.3e-13", "1.4e-13"),
    ],
)
def test_texts_that_agree(now, before):
    assert same_text(now, before)
    assert same_text(before, now)


@pytest.mark.parametrize(
    ("now", "before"),
    [
        ("rms 1.236 m", "rms 1.234 m"),
        ("holds for 27 of 30", "holds for 28 of 30"),
        ("S_I", "S_O"),
        ("Table 3.5, PID  37.1", "Table 3.6, PID  37.1"),
        ("Fig. 1.5", "Fig. 1.6"),
        ("1.3e-13", "1.3e-12"),
        ("fig-1.png", "fig-2.png"),
        ("0.5", "-0.5"),
        ("gain 2", "gain 1.01"),
        ("0.05", "0.0"),
    ],
)
def test_texts_that_differ(now, before):
    assert not same_text(now, before)
    assert not same_text(before, now)


@given(st.floats(1e-3, 1e3), st.floats(-1, 1), st.integers(1, 6))
def test_numbers_that_agree_print_texts_that_agree(number, share, digits):
    """Whatever the rounding: a number that moved by less than half a unit of the last digit is the same."""
    moved = number * (1 + share * 0.05 * 10.0**-digits)
    assert same_text(f"x = {moved:.{digits}e}", f"x = {number:.{digits}e}")


def test_outputs_are_compared_by_kind_and_text():
    stream = {"output_type": "stream", "name": "stdout", "text": ["a 1.0\n"]}
    result = {"output_type": "execute_result", "data": {"text/plain": "a 1.0\n"}}
    assert same_outputs([stream], [{**stream, "text": "a 1.1\n"}])
    assert not same_outputs([stream], [result])
    assert not same_outputs([stream], [stream, result])
    halves = [{**stream, "text": "a "}, {**stream, "text": "1.0\n"}]
    assert same_outputs([stream], halves) and same_outputs(halves, [stream])
    error = {"output_type": "error", "ename": "ValueError", "evalue": "no", "traceback": []}
    assert same_outputs([error], [error]) and not same_outputs([error], [stream])


def test_the_difference_of_two_tables_is_of_the_range(tmp_path):
    x = np.linspace(0, 1, 50)
    before = table(tmp_path, "before", zip(x, 3 * np.sin(6 * x), strict=True))
    span = np.ptp(3 * np.sin(6 * x))
    now = table(tmp_path, "now", zip(x, 3 * np.sin(6 * x) + 5e-5 * span, strict=True))
    assert table_difference(now, before) == pytest.approx(5e-5, rel=1e-2)
    far = table(tmp_path, "far", zip(x, 3 * np.sin(6 * x) + 2e-4 * span, strict=True))
    assert table_difference(far, before) is None


def test_on_a_logarithmic_scale_it_is_of_the_decades(tmp_path):
    x = np.linspace(0, 8, 50)
    before = table(tmp_path, "before", zip(x, 10**x, strict=True))
    now = table(tmp_path, "now", zip(x, 10**x * 1.0001, strict=True))
    assert table_difference(now, before) == pytest.approx(np.log10(1.0001) / 8, rel=1e-2)
    assert table_difference(table(tmp_path, "far", zip(x, 10**x * 1.1, strict=True)), before) is None


def test_rounding_is_compared_by_its_size(tmp_path):
    rng = np.random.default_rng(1)
    first, second = 1e-14 * np.abs(rng.standard_normal((2, 40)))
    rows = [np.c_[np.arange(40.0), each] for each in (first, second)]
    assert same_size(*rows)
    assert not same_size(rows[0], rows[1] * [1, 100])
    assert not same_size(rows[0] * [1, 1e3], rows[1])
    assert same_size(0 * rows[0], rows[1])  # exactly zero on one machine
    tables = [table(tmp_path, str(number), each) for number, each in enumerate(rows)]
    assert table_difference(*tables) is None
    assert table_difference(*tables, rounding={"line"}) == 0.0


def picture(y=1.0, label="time (s)", colour=BLUE) -> bytes:
    figure = Figure(figsize=(7.2, 2.9), dpi=150)
    axes = figure.subplots()
    axes.plot([0, 1, 2], [0, y, 0.3], label="a line", color=colour)
    axes.set_xlabel(label)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


@pytest.mark.slow
def test_pictures_agree_when_a_line_moved_within_its_width_and_not_when_a_word_changed():
    assert same_picture(picture(), picture())
    assert same_picture(picture(1.0 + 1e-4), picture())
    assert not same_picture(picture(1.2), picture())
    assert not same_picture(picture(label="time (h)"), picture())
    assert not same_picture(picture(label="time (s)."), picture())


@pytest.mark.slow
def test_a_figure_is_its_table_and_its_picture(tmp_path):
    for name, label in (("now", "time (s)"), ("before", "time (s)"), ("other", "time (h)")):
        table(tmp_path, name, [(0, 0), (1, 1)])
        (tmp_path / f"{name}.png").write_bytes(picture(label=label))
    assert difference(tmp_path / "now", tmp_path / "before") == 0.0
    assert difference(tmp_path / "now", tmp_path / "other") is None
    assert difference(tmp_path / "now", tmp_path / "gone") is None
    assert numbers_difference(tmp_path / "now", tmp_path / "other") == 0.0
    assert numbers_difference(tmp_path / "now", tmp_path / "gone") is None
    for text in ("", f"{HEADER}a,b,1,2,3,4\n"):
        (tmp_path / "before.csv").write_text(text)
        assert difference(tmp_path / "now", tmp_path / "before") is None
    table(tmp_path, "before", [(0, 0), (1, 1)])
    for cut in (0, 2000):
        (tmp_path / "before.png").write_bytes(picture()[:cut])
        assert difference(tmp_path / "now", tmp_path / "before") is None
    for name, number in (("one", 1), ("same", 1), ("more", 2)):
        table(tmp_path, name, [(0, number)])
    assert difference(tmp_path / "one", tmp_path / "same") == 0.0
    assert difference(tmp_path / "one", tmp_path / "more") is None


def claim(ours, interval=None, **fields):
    rule = Tolerance("digits", absolute=1.0)
    return Claim(Entry("motion.a", "p", "q", "", "value", 1.0, rule, **fields), ours, interval)


@given(st.floats(0.01, 100), st.floats(-0.01, 0.01))
def test_a_value_may_move_by_a_thousandth(accepted, step):
    now = accepted * (1 + step)
    distance = abs(now - accepted) / accepted
    assume(abs(distance - 1e-3) > 1e-9)
    assert same_value(claim(now), claim(accepted)) == (distance < 1e-3)


@pytest.mark.parametrize(
    ("drift", "now", "same"),
    [
        (Tolerance("resolution of the fit", absolute=0.002), 0.0013, True),
        (Tolerance("resolution of the fit", absolute=0.002), -0.0027, False),
        (Tolerance("spread over processors", relative=0.5), -0.0004, True),
        (Tolerance("spread over processors", relative=0.5), -0.0001, False),
    ],
)
def test_an_entry_may_say_how_far_it_moves_with_the_machine(drift, now, same):
    assert same_value(claim(now, drift=drift), claim(-0.0006, drift=drift)) == same


def test_what_an_identity_leaves_is_rounding():
    rule = Tolerance("rounding", absolute=1e-7)

    def residual(ours, kind="check", published=None, expected=None):
        return Claim(Entry("motion.a", "p", "q", "", kind, published, rule, expected=expected), ours)

    assert same_value(residual(6e-8), residual(4e-8))
    assert same_value(residual(3e-15, "exact", 0.0), residual(1e-16, "exact", 0.0))
    assert not same_value(residual(2.1, published=1.0), residual(2.0, published=1.0))
    assert not same_value(residual(6e-8, expected=4e-8), residual(4e-8, expected=4e-8))


def test_the_ends_of_an_interval_may_move_by_the_drift_of_the_larger():
    assert same_value(claim(5.0, (0.001, 10.0)), claim(5.0, (0.009, 10.0)))
    assert not same_value(claim(5.0, (0.001, 10.0)), claim(5.0, (0.02, 10.0)))
    assert not same_value(claim(5.0), claim(5.0, (4.0, 6.0)))
