"""Proven peaks of loops, compared with matrices that are written apart and against the composed state-space loop."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.motion.designs import DESIGNS, stage_compensator
from experiments.motion.machines import published_noise, stage, stage_mass
from naive.precise_margins import differing, sample_case
from naive.sampled_loops import judged_peak, sample_loop
from stillwork.base.checks import InputError
from stillwork.base.validation import checked
from stillwork.control import loop_enclosures
from stillwork.control.applications import Application
from stillwork.control.bandwidth import FUNCTIONS, PeakConstraint, make_loop, maximise_bandwidth
from stillwork.control.digital import runnable
from stillwork.control.loop_enclosures import MARGINS, enclose_margins, enclose_peaks, proven_numbers
from stillwork.control.loops import channel, closed_loop
from stillwork.control.machine_loops import HELD, observed_loops
from stillwork.control.pid import PidFamily
from stillwork.lti import Enclosure, enclose_hinf_norm
from stillwork.lti.margin_enclosures import enclose_first_crossing, enclose_gain_margins, enclose_phase_margin


@pytest.mark.parametrize("seeds", [range(200, 215), pytest.param(range(215, 300), marks=pytest.mark.slow)])
def test_proven_peaks_are_those_of_loops_written_apart_and_keep_the_limit_of_a_search(seeds):
    stable = 0
    for seed in seeds:
        case = sample_loop(np.random.default_rng(seed))
        loop = make_loop(case.plant, sample_time=case.sample_time, delay=case.delay)
        family = PidFamily(case.mass, case.notches)
        designs = [family(case.search_hz[0]), family(case.search_hz[1])]
        limits = [PeakConstraint("output_sensitivity", case.limit)]
        try:
            designs.append(maximise_bandwidth([loop], family, limits, *case.search_hz).controller)
        except InputError:
            pass
        for number, pid in enumerate(designs):
            slowest, peak = judged_peak(case, pid)
            for name, found in enclose_peaks(loop, pid).items():
                assert found.proven, (seed, number, name)
                assert (found.low == np.inf) == (slowest > 0), (seed, number, name)
                if slowest < 0:
                    assert found.low <= peak * (1 + 1e-6) and peak <= found.high * (1 + 1e-9), (seed, number)
                    assert found.high <= found.low * (1 + 1e-6)
                    stable += 1
            if number == 2:
                assert found.high <= case.limit * (1 + 1e-6)
    assert stable > len(seeds)


@pytest.mark.parametrize("seeds", [range(10), pytest.param(range(10, 60), marks=pytest.mark.slow)])
def test_margins_hold_what_seventy_digits_give(seeds):
    stable = 0
    for seed in seeds:
        kind, loop, pid = sample_case(np.random.default_rng(seed))
        found = enclose_margins(loop, pid)
        assert differing(loop, pid, found) == ([], [], []), (seed, kind)
        stable += found["modulus_margin"].low > 0
    assert stable > len(seeds) / 3


@pytest.mark.parametrize("sample_time", [0.0, 1e-3])
def test_the_factors_of_a_gain_are_where_the_loop_becomes_unstable(sample_time):
    loop = make_loop(stage().at([0], [4]), sample_time=sample_time, delay=1 if sample_time else 0)
    pid = PidFamily(stage_mass())(10.0)
    found = enclose_margins(loop, pid)
    for name, inside in (("gain_reduction", 1), ("gain_margin", -1)):
        for sign, stable in ((inside, True), (-inside, False)):
            factor = found[name].low * (1 + sign * 1e-6)
            assert loop.is_stable(replace(pid, gain=factor * pid.gain)) is stable


def test_closed_forms():
    triple = enclose_gain_margins([2], [1, 3, 3, 1])  # 2 / (s + 1)^3: 8 / 2 at sqrt(3)
    assert triple[0] == Enclosure(0.0, 0.0, True) and triple[1].low < 4.0 < triple[1].high < 4.0 + 1e-12
    crossing = enclose_first_crossing([1], [0, 0, 1])  # 1 / s^2
    assert crossing.low < 1 / (2 * np.pi) < crossing.high
    assert enclose_first_crossing([1], [2, 1]) == Enclosure(np.inf, np.inf, True)  # below 1 everywhere
    assert enclose_phase_margin([1], [2, 1]).high == pytest.approx(np.pi)
    turned = enclose_phase_margin([1], [0, 1])  # an integrator: 90 degrees
    assert turned.low < np.pi / 2 < turned.high < np.pi / 2 + 1e-12


def test_a_margin_far_below_rounding_is_enclosed_as_narrowly():
    """(1 + e) 2 (s + 1)^2 / (s^2 (s^2 + 4 s + 1)) is -1 - e at s = j: to first order its phase margin is e / 4."""
    one = 10**50
    gain = 2 * (one + 1)
    found = checked(lambda: enclose_phase_margin([gain, 2 * gain, gain], [0, 0, one, 4 * one, one]))()
    assert found.low <= 2.5e-51 <= found.high <= found.low * (1 + 1e-9)


def test_an_unstable_loop_has_proven_margins_of_nothing_and_where_no_peak_is_proven_no_margin_is(monkeypatch):
    loop, fast = make_loop(stage().at([0], [4])), PidFamily(stage_mass())(2000.0)
    assert not loop.is_stable(fast)
    found = enclose_margins(loop, fast)
    assert all(each.proven for each in found.values())
    assert (
        found["gain_reduction"].high == 1.0 and found["gain_margin"].high == found["phase_margin"].high == 0.0
    )
    monkeypatch.setattr(loop_enclosures, "enclose_quotients", lambda *_: Enclosure(0.0, np.inf, False))
    assert not any(each.proven for each in enclose_margins(loop, fast).values())


def test_what_cannot_be_decided_is_not_proven():
    touching = [0, 6], [1, 6, 9]  # 6 s / (3 s + 1)^2 has magnitude 1 at s = j / 3 alone: a double root
    assert not enclose_phase_margin(*touching).proven and not enclose_first_crossing(*touching).proven
    assert not enclose_gain_margins([-1], [1])[0].proven  # on the boundary
    assert not enclose_gain_margins([1], [1, 0, 1])[1].proven  # real all along the axis


@pytest.mark.slow
@pytest.mark.parametrize("name", ["PID", "MC", "AD", "MC and AD"])
def test_with_an_observer_they_are_those_of_the_composed_loop(name):
    plant, pid = stage().at([0], [4]), PidFamily(stage_mass())(35.0)
    block = stage_compensator(5, DESIGNS[name])
    loop = make_loop(plant, block)
    whole = closed_loop(plant, loop.compensator, pid.state_space())
    signals = dict(zip(FUNCTIONS, (("u_ff", "u"), ("v", "e_true"), ("r", "e_true")), strict=True))
    found = enclose_peaks(loop, pid)
    for function, ends in signals.items():
        composed = enclose_hinf_norm(channel(whole, *ends))
        # Composing in floating-point numbers moves the loop by roundings.
        assert found[function].proven and found[function].high == pytest.approx(composed.high, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0, 2])
@pytest.mark.parametrize("application", [None, Application(compensate=True, damping=0.02, selectivity=2.0)])
def test_the_written_controller_is_that_of_its_parts(application, delay):
    [loop] = observed_loops([stage().at([0], [4])], application, 4, published_noise(), None, 1e-4, delay)
    pid = PidFamily(stage_mass())(25.0)
    written = runnable(pid, loop.compensator, np.inf, {}).model
    parts, whole = enclose_peaks(loop, pid), enclose_peaks(loop, pid, written)
    for name in FUNCTIONS:
        assert parts[name].proven and whole[name].proven
        assert whole[name].high == pytest.approx(parts[name].high, rel=1e-6)
    assert str(proven_numbers([loop, loop], pid, [written])).count(", proven") == len(HELD) + len(MARGINS)
    if application:
        other = replace(written, a=written.a + 1e-9)  # the compensator is no part of it any more
        assert not enclose_peaks(loop, pid, other)["input_sensitivity"].proven
        assert (
            str(proven_numbers([loop], pid, [other])).count("not proven") == 2
        )  # S_I, and its loop's crossing
