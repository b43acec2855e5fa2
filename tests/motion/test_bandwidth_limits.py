"""No answer of the bandwidth search exceeds its own limit, and peaks are those of matrices that are written apart."""

import numpy as np
import pytest

from naive.sampled_loops import RandomLoop, judged_peak, sample_loop
from stillwork import lti
from stillwork.base.checks import InputError
from stillwork.control.bandwidth import PeakConstraint, make_loop, maximise_bandwidth
from stillwork.control.machine_loops import HELD
from stillwork.control.pid import PidFamily
from stillwork.machine.margins import loop_margins

TOLERANCE = 1e-5  # of the limit: what a zoom between two points leaves
DAMPING = np.array([0.0, 1.0272e-4, 3.3496e-4])


@pytest.mark.parametrize(
    ("lowest", "seeds"),
    [
        (True, range(5, 20)),
        (False, range(20, 35)),
        pytest.param(True, range(35, 65), marks=pytest.mark.slow),
        pytest.param(False, range(65, 95), marks=pytest.mark.slow),
    ],
)
def test_no_answer_exceeds_its_own_limit(lowest, seeds):
    answers = 0
    for seed in seeds:
        case = sample_loop(np.random.default_rng(seed))
        loop = make_loop(case.plant, sample_time=case.sample_time, delay=case.delay)
        limits = [PeakConstraint("input_sensitivity", case.limit)]
        family = PidFamily(case.mass, case.notches)
        try:
            found = maximise_bandwidth([loop], family, limits, *case.search_hz, lowest=lowest)
        except InputError:
            continue
        slowest, peak = judged_peak(case, found.controller)
        assert slowest < 0 and peak <= (1 + TOLERANCE) * case.limit, seed
        own = loop.peak(found.controller, "input_sensitivity").magnitude
        assert own <= case.limit and own == pytest.approx(peak, rel=TOLERANCE), seed
        answers += 1
        for pid in () if seed % 5 else (found.controller, *map(family, case.search_hz)):
            slowest, peak = judged_peak(case, pid)
            margins = loop_margins(loop, pid)
            wanted = peak if slowest < 0 else np.inf
            assert [margins[name] for name in HELD] == pytest.approx([wanted] * len(HELD), rel=1e-6), seed
    assert answers > len(seeds) / 3


@pytest.mark.parametrize("unit", [1.0, 1e-6, 1e6])
def test_a_mode_that_the_loop_leaves_nearly_undamped_stops_the_search_in_any_unit(unit):
    """50 kg and two modes: the controller moves a mode of 0.01 % damping off the points around the plant's own poles."""
    mass, limit = 50.0 * unit, 3.0
    shapes = np.array([1.0, 0.21651, -0.79648]) / np.sqrt(mass)
    omega = 2 * np.pi * np.array([0.0, 432.143, 715.133])
    inputs = np.full((3, 1), 1 / np.sqrt(mass))
    plant = lti.ModalModel(omega, DAMPING, inputs, shapes[None], np.zeros((1, 1)))
    case = RandomLoop(plant, mass, (), 0.0, 0, limit, (10.0, 300.0))
    found = maximise_bandwidth(
        [make_loop(plant)], PidFamily(mass), [PeakConstraint("input_sensitivity", limit)], *case.search_hz
    )
    slowest, peak = judged_peak(case, found.controller)
    assert slowest < 0 and peak <= (1 + TOLERANCE) * limit
    above = PidFamily(mass)(found.design_hz + 2e-4)  # the search stops within 1e-4 Hz of its end
    assert judged_peak(case, above)[1] > limit
