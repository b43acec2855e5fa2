"""Proven peaks of loops, held against matrices that are written apart and against the composed state-space loop."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.motion.designs import DESIGNS, stage_compensator
from experiments.motion.machines import published_noise, stage, stage_mass
from naive.sampled_loops import judged_peak, sample_loop
from stillwork.base.checks import InputError
from stillwork.control.applications import Application
from stillwork.control.bandwidth import FUNCTIONS, PeakConstraint, make_loop, maximise_bandwidth
from stillwork.control.digital import runnable
from stillwork.control.loop_enclosures import enclose_peaks, proven_peaks
from stillwork.control.loops import channel, closed_loop
from stillwork.control.machine_loops import observed_loops
from stillwork.control.pid import PidFamily
from stillwork.lti import enclose_hinf_norm


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
    assert proven_peaks([loop, loop], pid, [written]).count(", proven") == len(FUNCTIONS)
    if application:
        other = replace(written, a=written.a + 1e-9)  # the compensator is no part of it any more
        assert not enclose_peaks(loop, pid, other)["input_sensitivity"].proven
        assert "not proven" in proven_peaks([loop], pid, [other])
