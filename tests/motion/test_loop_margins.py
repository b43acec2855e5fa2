"""Peaks, crossings and margins of loops, compared with 70 digits and with matrices that are written apart."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.motion.machines import published_noise, stage, stage_mass
from naive.precise_margins import judged_margins, sample_case
from stillwork.control.applications import Application
from stillwork.control.bandwidth import make_loop
from stillwork.control.digital import runnable
from stillwork.control.machine_loops import HELD, observed_loops
from stillwork.control.pid import PidFamily
from stillwork.machine.margins import MARGINS, computed_numbers, loop_margins


@pytest.mark.parametrize("seeds", [range(8), pytest.param(range(8, 20), marks=pytest.mark.slow)])
def test_margins_are_those_of_seventy_digits_to_a_billionth(seeds):
    """Also where the loop gain passes its bound by a billionth between two points of the grid."""
    stable = 0
    for seed in seeds:
        kind, loop, pid = sample_case(np.random.default_rng(seed))
        found, judged = loop_margins(loop, pid), judged_margins(loop, pid)
        assert {name: found[name] for name in judged} == pytest.approx(judged, rel=1e-9, abs=0), (seed, kind)
        stable += found["modulus_margin"] > 0
    assert stable > len(seeds) / 3


@pytest.mark.parametrize("sample_time", [0.0, 1e-3])
def test_the_factors_of_a_gain_are_where_the_loop_becomes_unstable(sample_time):
    loop = make_loop(stage().at([0], [4]), sample_time=sample_time, delay=1 if sample_time else 0)
    pid = PidFamily(stage_mass())(10.0)
    found = loop_margins(loop, pid)
    for name, inside in (("gain_reduction", 1), ("gain_margin", -1)):
        for sign, stable in ((inside, True), (-inside, False)):
            factor = found[name] * (1 + sign * 1e-6)
            assert loop.is_stable(replace(pid, gain=factor * pid.gain)) is stable


@pytest.mark.parametrize("delay", [0, 2])
@pytest.mark.parametrize("application", [None, Application(compensate=True, damping=0.02, selectivity=2.0)])
def test_the_written_controller_is_that_of_its_parts(application, delay):
    [loop] = observed_loops([stage().at([0], [4])], application, 4, published_noise(), None, 1e-4, delay)
    pid = PidFamily(stage_mass())(25.0)
    written = runnable(pid, loop.compensator, np.inf, {}).model
    assert loop_margins(loop, pid, written) == pytest.approx(loop_margins(loop, pid), rel=1e-6)
    rows = computed_numbers([loop, loop], pid, [written])
    assert str(rows).count(", computed to 1e-9") == len(rows) == len(HELD) + len(MARGINS)
    wrong = replace(written, c=-written.c, d=-written.d)  # not the controller that was judged
    assert loop_margins(loop, pid, wrong)["output_sensitivity"] == np.inf
