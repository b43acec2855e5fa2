import pytest

from workbook.checks import InputError
from workbook.claims import Claim, Entry, Tolerance
from workbook.conclusions import banner, found_here, run_settings, sense, sentence
from workbook.page import Page


def claim(name, ours, kind="value"):
    rule = Tolerance("x", absolute=0.1) if kind == "value" else None
    reason = "" if kind == "value" else "rig not described"
    entry = Entry(name, "Table 1", "gain", "", kind, published=2.0, tolerance=rule, reason=reason)
    return Claim(entry, ours)


INSIDE, OUTSIDE = claim("motion.a", 2.0), claim("motion.b", 3.0)


def test_a_sentence_has_the_numbers_and_the_sense_of_the_run():
    said = "The gain is {gain:.1f}.", "The gain is not 2 but {gain:.1f}."
    assert sentence(*said, True, {"gain": 2.04}) == "The gain is 2.0."
    assert sentence(*said, False, {"gain": 3}) == "The gain is not 2 but 3.0."
    assert sentence("{a:.1%} to {a:+.0%}", None, True, {"a": 0.1234}) == "12.3 % to +12 %"
    assert sentence(said[0], None, False, {"gain": 3}) == "Not found in this run: The gain is 3.0."


@pytest.mark.parametrize(
    ("values", "named"), [({}, "{gain} has no value"), ({"gain": 1, "loss": 2}, "no sentence shows loss")]
)
def test_places_and_values_belong_together(values, named):
    with pytest.raises(InputError, match=named):
        sentence("The gain is {gain}.", None, True, values)


def test_a_ratio_is_level_where_its_interval_holds_one():
    ratios = [(0.8, 0.9), (0.8, 1.0), (1.0, 1.2), (1.1, 1.2), 0.9, 1.0, 1.1]
    words = ["ahead of", "level with", "level with", "behind", "ahead of", "level with", "behind"]
    assert [sense(ratio) for ratio in ratios] == words
    assert sense(2.0, ("less", "as much", "more")) == "more"


def test_a_sentence_rests_on_what_the_run_has_judged():
    assert found_here("motion.a", [INSIDE, OUTSIDE])
    assert not found_here(["motion.a", "motion.b"], [INSIDE, OUTSIDE])
    for claims in ([], [claim("motion.b", 2.0, "reported")]):
        with pytest.raises(InputError, match=r"motion\.b"):
            found_here("motion.b", claims)


def test_settings_are_what_cells_of_assignments_alone_say():
    cells = [
        "noise: float = 0.1  # m\nseed: int = 1",
        "# Parameters\nnoise = 0.05\n",
        "for seed in range(5):\n    pass",
        "seed = 3\nprint(seed)",
        "seed = wrong(",
        "seed = len([1])",
        "a, b = 1, 2",
    ]
    assert run_settings(cells) == {"noise": 0.05, "seed": 1}


def test_the_banner_counts_what_left_and_what_entered():
    accepted = {each.entry.id: each for each in (INSIDE, OUTSIDE, claim("motion.c", 2.0, "reported"))}
    found = [claim("motion.a", 5.0), claim("motion.b", 2.0), claim("motion.c", 9.0, "reported")]
    lines = banner("noise 0.05 for 0.1", found, accepted).splitlines()
    assert lines == [
        "Other settings than the accepted: noise 0.05 for 0.1; 1 of 2 numbers left their tolerance, 1 entered.",
        "left: motion.a (gain): 5 for 2",
        "entered: motion.b (gain): 2 for 3",
    ]
    assert banner("", found, accepted) == ""


def test_a_page_keeps_its_sentences():
    page = Page("motion/01-x")
    page.conclude("It errs {ratio:.2f} times as much.", "It errs less.", when=1.5 > 1, ratio=1.5)
    page.claims.add(OUTSIDE)
    page.conclude("It is {x:.0f}.", "It is not 2 but {x:.0f}.", when="motion.b", x=OUTSIDE.ours)
    assert page.conclusions == ["It errs 1.50 times as much.", "It is not 2 but 3."]
