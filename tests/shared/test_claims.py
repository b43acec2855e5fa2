import json
import math
from types import SimpleNamespace

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from workbook.checks import InputError
from workbook.claims import Claim, ClaimsTable, Entry, Tolerance, ledger, load_entries, make_claim

values = st.floats(-1e6, 1e6).filter(lambda v: abs(v) > 1e-6)
levels = st.floats(0, 1)


def entry(kind="value", published=2.0, **fields):
    fields = {"place": "Table 1", "quantity": "gain", "unit": "Hz", **fields}
    if kind in ("value", "exact", "slope"):
        fields.setdefault("tolerance", Tolerance("printed digits", relative=0.01))
    return Entry(**{"id": "motion.gain"} | fields, kind=kind, published=published)


@given(values, values, levels, st.sampled_from(["relative", "absolute"]))
def test_a_tolerance_is_a_distance(published, ours, size, rule):
    claim = Claim(entry(published=published, tolerance=Tolerance("x", **{rule: size})), ours)
    distance, allowed = abs(ours - published), size * (abs(published) if rule == "relative" else 1.0)
    assume(abs(distance - allowed) > 1e-9 * abs(published))  # the edge itself rounds
    assert claim.here == ("inside" if distance < allowed else "outside")


@given(values, values, values, values)
def test_interval_tolerance_looks_at_the_interval_only(published, ours, one, other):
    low, high = sorted((one, other))
    claim = Claim(entry(published=published, tolerance=Tolerance("x", interval=0.95)), ours, (low, high))
    assert claim.here == ("inside" if low <= published <= high else "outside")


@pytest.mark.parametrize(
    "asking",
    [entry(tolerance=Tolerance("x", interval=0.95)), entry("ordering", published=1.0, threshold=0.9)],
)
def test_a_rule_of_an_interval_needs_one(asking):
    with pytest.raises(InputError, match=r"interval=\(low, high\)"):
        Claim(asking, 1.0).here  # noqa: B018


@given(levels, levels, levels, st.floats(0.01, 1))
def test_a_threshold_is_held_against_the_lower_end_of_the_interval(fraction, one, other, threshold):
    low, high = sorted((one, other))
    claim = Claim(entry("ordering", published=1.0, threshold=threshold), fraction, (low, high))
    assert claim.here == ("inside" if low >= threshold else "outside")
    claim = Claim(entry("ordering", published=1.0), fraction)  # without one it must hold in every run
    assert claim.here == ("inside" if fraction == 1 else "outside")


@given(st.floats(-5, 5), st.sampled_from(["larger", "smaller"]))
def test_better_is_beyond_the_tolerance_on_one_side(off, better):
    assume(abs(abs(off) - 1) > 1e-9)
    claim = Claim(entry(tolerance=Tolerance("x", absolute=1.0), better=better), 2.0 + off)
    on_better_side = off > 0 if better == "larger" else off < 0
    assert claim.here == ("inside" if abs(off) <= 1 else "better" if on_better_side else "outside")


@pytest.mark.parametrize(
    ("fields", "ours", "verdict"),
    [
        ({"tolerance": Tolerance("rounding", absolute=1e-9)}, 1e-12, "passes"),
        ({"tolerance": Tolerance("rounding", absolute=1e-9)}, 1e-3, "fails"),
        ({"tolerance": Tolerance("theory", relative=0.1), "published": 2.0}, 2.1, "passes"),
        ({"tolerance": Tolerance("theory", relative=0.1), "published": 2.0}, 2.3, "fails"),
        ({"tolerance": Tolerance("theory", relative=0.1), "expected": 2.0}, 2.1, "passes"),
        ({"tolerance": Tolerance("theory", relative=0.1), "expected": 2.0}, 0.0, "fails"),
        ({}, 1.0, "passes"),
        ({}, 0.99, "fails"),
    ],
)
def test_a_check_of_our_own_passes_or_fails(fields, ours, verdict):
    claim = Claim(entry("check", **{"published": None, **fields}), ours)
    assert claim.verdict == verdict
    assert claim.entry.is_own and not claim.entry.is_replication


def test_what_the_work_does_not_state_is_no_replication():
    shown = entry("reported", published=None, reason="the work gives no number")
    assert Claim(shown, 3.0).verdict == "not judged"
    assert Claim(shown, 3.0).deviation is None
    assert shown.is_own and Claim(entry()).verdict == "not built"
    assert not entry("reported", reason="rig not described").is_own
    assert not entry(counterfactual=True).is_replication
    assert entry().is_replication


@given(st.integers(1, 60), st.data(), st.booleans())
def test_the_verdict_is_that_of_the_share_of_combinations(tried, data, inside):
    """By whole numbers: hundredths of the combinations."""
    agree = data.draw(st.integers(0, tried))
    if 100 * agree >= 95 * tried:
        word = "replicated"
    elif 2 * agree >= tried:
        word = "mostly replicated"
    elif 100 * agree >= 5 * tried:
        word = "rarely replicated"
    else:
        word = "not replicated"
    over = SimpleNamespace(share=agree / tried)
    ours = 2.0 if inside else 3.0
    assert Claim(entry(published=2.0), ours, over=over).verdict == word
    assert Claim(entry(published=2.0), ours).verdict == ("replicated" if inside else "not replicated")
    assert Claim(entry("check", published=2.0), ours, over=over).verdict == ("passes" if inside else "fails")
    shown = Claim(entry("reported", reason="rig not described"), ours, over=SimpleNamespace(share=None))
    assert (shown.verdict, shown.unjudged) == ("not judged", "rig not described")


@pytest.mark.parametrize(
    ("rule", "interval", "ours", "verdict"),
    [
        ({"absolute": 1.1}, None, 2.5, "not judged"),
        ({"absolute": 1.1}, None, 3.5, "not replicated"),
        ({"absolute": 0.9}, None, 2.5, "replicated"),
        ({"relative": 0.6}, None, 2.5, "not judged"),
        ({"interval": 0.95}, (0.9, 3.0), 2.0, "not judged"),
        ({"interval": 0.95}, (1.1, 3.0), 2.0, "replicated"),
    ],
)
def test_what_is_wider_than_the_printed_value_cannot_replicate_it(rule, interval, ours, verdict):
    claim = Claim(entry(published=2.0, tolerance=Tolerance("x", **rule)), ours, interval)
    assert claim.verdict == verdict
    assert ("wider" in claim.unjudged) == (verdict == "not judged")
    here = {"replicated": "inside", "not replicated": "outside"}.get(verdict, verdict)
    assert repr(ClaimsTable([claim])).splitlines()[2].endswith(f"  {here}")
    over = Claim(claim.entry, ours, interval, over=SimpleNamespace(share=0.04))  # excluded under nearly all
    assert over.verdict == "not replicated"
    one_sided = entry(published=2.0, tolerance=Tolerance("x", **rule), better="larger")
    assert Claim(one_sided, ours, interval).verdict != "not judged"


def test_deviation_is_relative_and_has_no_meaning_at_zero():
    assert Claim(entry(published=2.0), 2.5).deviation == 0.25
    assert Claim(entry(published=-2.0), -2.5).deviation == 0.25
    assert Claim(entry(published=0.0), 1.0).deviation is None
    assert Claim(entry()).deviation is None


ROUNDING = Tolerance("rounding", absolute=1e-12)


@pytest.mark.parametrize(
    ("fields", "ours", "text"),
    [
        # Of an identity the bound is shown, not its rounding.
        ({"kind": "exact", "published": 0.0, "tolerance": ROUNDING}, 6.6613381e-16, "< 1e-12"),
        ({"kind": "exact", "published": 0.0, "tolerance": ROUNDING}, 2.3456e-5, "2.35e-05"),
        ({"kind": "exact", "published": 0.0, "tolerance": Tolerance("a count", absolute=0.0)}, 0.0, "0"),
        ({"kind": "exact", "published": 1.0, "tolerance": ROUNDING}, 1.0, "1"),
        ({"published": 0.0, "tolerance": Tolerance("half a digit", absolute=0.05)}, 0.012345, "0.0123"),
        ({"kind": "check", "published": None, "tolerance": ROUNDING}, 6.6613381e-16, "< 1e-12"),
        # No digit is shown that the drift lets turn.
        ({"drift": Tolerance("two processors", absolute=0.01)}, 0.21105, "0.21"),
        ({"drift": Tolerance("two processors", absolute=0.2)}, -37.26, "-37"),
        ({"drift": Tolerance("two processors", absolute=1e-6)}, 37.26, "37.3"),
        ({"drift": Tolerance("two processors", absolute=0.2)}, 0.3, "0.3"),
    ],
)
def test_as_many_digits_are_shown_as_mean_something(fields, ours, text):
    assert Claim(entry(**fields), ours).shown(3) == text


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"kind": "vlaue"}, r"\bkind\b"),
        ({"kind": "value", "tolerance": None}, r"^motion\.gain\b.*tolerance"),
        ({"kind": "ordering", "tolerance": Tolerance("x", absolute=1)}, r"\btolerance\b"),
        ({"kind": "reported"}, r"\breason\b"),
        ({"published": math.nan}, r"\bpublished\b"),
        ({"published": None}, r"\bpublished\b"),
        ({"kind": "check", "expected": 2.0}, r"\bexpected\b"),
        ({"kind": "ordering", "threshold": 1.5}, r"\bthreshold\b"),
        ({"kind": "ordering", "better": "larger"}, r"\bbetter\b"),
        ({"drift": Tolerance("x", interval=0.95)}, r"\bdrift\b"),
    ],
)
def test_an_incomplete_entry_is_refused(fields, message):
    with pytest.raises(InputError, match=message):
        entry(**{"kind": "value", **fields})


LEDGER = """\
[motion.table-1.pid]
place = "Table 1"
quantity = "bandwidth"
unit = "Hz"
published = 37.0
kind = "value"
tolerance = { relative = 0.03, source = "digits" }

[motion.order]
place = "Fig. 2"
quantity = "PID below the observer"
unit = ""
published = 1.0
kind = "ordering"
reason = "one run differs"
"""


@pytest.fixture
def workbook(tmp_path, monkeypatch):
    """A workbook with a ledger of the topic `motion`; give it another text or found values."""
    monkeypatch.setenv("STILLWORK_ROOT", str(tmp_path))

    def write(text=LEDGER, **found):
        file = tmp_path / "data" / "motion" / "published.toml"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
        for notebook, values in found.items():
            claims = tmp_path / "figures" / "motion" / notebook / "claims.json"
            claims.parent.mkdir(parents=True)
            claims.write_text(json.dumps(values), encoding="utf-8")

    return write


def test_reads_the_drift_of_an_entry(workbook):
    workbook(LEDGER.replace("tolerance", 'drift = { absolute = 0.1, source = "fit" }\ntolerance'))
    entries = load_entries("motion")
    assert entries["motion.table-1.pid"].drift == Tolerance("fit", absolute=0.1)
    assert entries["motion.order"].drift.relative == 1e-3


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("published = 37.0", "publishd = 37.0", r"^motion\.table-1\.pid\b.*'publishd'.*'published'"),
        ('source = "digits"', 'sauce = "digits"', r"^motion\.table-1\.pid\b.*'sauce'"),
        ("37.0", "'high'", r"(?s)^motion\.table-1\.pid\b.*published"),
        ("[motion.order]", "[motion.order", r"published\.toml\b"),
        ("[motion.table-1.pid]", "[motion]\nx = 1\n[motion.table-1.pid]", r"^motion\.x\b"),
    ],
)
def test_a_wrong_ledger_names_the_entry(workbook, old, new, message):
    assert old in LEDGER
    workbook(LEDGER.replace(old, new))
    with pytest.raises(InputError, match=message):
        load_entries("motion")


@pytest.mark.parametrize("interval", [None, (1.0, math.inf)])
def test_only_finite_values_are_claimed(workbook, interval):
    workbook()
    with pytest.raises(InputError, match=r"^motion\.order\b"):
        make_claim("motion.order", math.nan if interval is None else 1.0, interval)


def test_the_ledger_joins_entries_with_what_was_found(workbook):
    workbook(**{"01-x": {"motion.table-1.pid": {"ours": 37.5, "interval": [37, 38]}}})
    pid, order = ledger()
    assert (pid.verdict, pid.notebook, pid.interval) == ("replicated", "motion/01-x", (37, 38))
    assert order.verdict == "not built"
    shown = {"published": 37.0, "ours": 37.5, "interval": [37, 38], "tolerance": "digits", "own": False}
    shown |= {"verdict": "replicated", "here": "inside", "notebook": "motion/01-x"}
    assert pid.as_dict() == pid.as_dict() | shown


def test_a_value_without_the_interval_that_its_entry_asks_for_is_not_built(workbook):
    text = LEDGER.replace('kind = "ordering"', 'kind = "ordering"\nthreshold = 0.9')
    found = {"motion.order": {"ours": 1.0}}
    workbook(text, **{"01-x": found})
    _, order = ledger()
    assert (order.verdict, order.notebook, order.ours) == ("not built", "motion/01-x", None)
    workbook(text, **{"02-y": {"motion.table-1.pid": {"ours": 37.0}}})
    assert ledger()[0].verdict == "replicated"


def test_a_value_claimed_twice_or_unknown_is_refused(workbook):
    found = {"motion.order": {"ours": 1.0}}
    workbook(**{"01-x": found, "02-y": found})
    with pytest.raises(InputError, match=r"motion/01-x.*motion/02-y"):
        ledger()
    workbook(LEDGER.replace("motion.order", "motion.other"))
    with pytest.raises(InputError, match=r"'motion\.order'.*'motion\.other'"):
        ledger()


def test_the_table_prints_verdicts_and_reasons_and_keeps_the_last_value(workbook, tmp_path):
    workbook()
    table = ClaimsTable()
    table.add(make_claim("motion.order", 1.0))
    table.add(make_claim("motion.table-1.pid", 37.123456789, (36.0, 38.0)))
    table.add(make_claim("motion.order", 0.9))
    printed = repr(table)
    assert printed.splitlines()[0].split() == "claim place published ours interval unit here".split()
    assert "motion.table-1.pid  Table 1  37         37.1  36 .. 38  Hz    inside" in printed
    assert printed.endswith("motion.order: one run differs")
    table.write(tmp_path / "deep" / "claims.json")
    assert json.loads((tmp_path / "deep" / "claims.json").read_text()) == {
        "motion.table-1.pid": {"ours": 37.123457, "interval": [36.0, 38.0]},
        "motion.order": {"ours": 0.9},
    }


@given(st.lists(st.tuples(st.sampled_from("abc"), st.booleans(), st.booleans()), min_size=1, max_size=40))
def test_a_page_shows_ten_claims_headlines_first_then_of_each_table_in_turn(drawn):
    table = ClaimsTable()
    rule = Tolerance("printed digits", relative=0.01)
    for number, (group, headline, published) in enumerate(drawn):
        fields = {"id": f"motion.{group}.{number}", "headline": headline, "tolerance": rule}
        table.add(Claim(entry("value" if published else "check", **fields), 2.0))
    shown, rest = table.shown, table.rest.claims
    assert len(shown) == min(10, len(drawn))
    assert sorted(map(table.claims.index, [*shown, *rest])) == list(range(len(drawn)))
    assert shown == sorted(shown, key=table.claims.index)
    assert not any(claim.entry.headline for claim in rest) or all(claim.entry.headline for claim in shown)
    if rest:
        ranks = [(not each.entry.headline, each.entry.kind == "check") for each in (*shown, *rest)]
        assert max(ranks[:10]) <= min(ranks[10:])
        assert f"{len(rest)} more: on the page of the site (`make site`)." in repr(table)
    assert repr(table.rest).count("motion.") == len(rest)
