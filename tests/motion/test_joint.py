"""The joint design: its closed forms against state space, its results against exact norms and eigenvalues."""

from dataclasses import replace

import numpy as np
import pytest
from stillwork.checks import InputError
from stillwork.lti import hinf_norm
from stillwork.motion.bandwidth import SIX_DB
from stillwork.motion.designs import DESIGNS, stage_bandwidth, stage_observer
from stillwork.motion.joint import (
    CHANNELS,
    PUBLISHED,
    JointDesign,
    StageResponses,
    kalman_gains,
    published_softness,
)
from stillwork.motion.joint_plots import draw_joint
from stillwork.motion.joint_search import (
    draw_plants,
    plant_peaks,
    robust_search,
    search,
    starts,
    verify,
)
from stillwork.motion.loops import channel, closed_loop
from stillwork.motion.machines import stage
from stillwork.motion.observer import Noise, published_noise
from stillwork.motion.reduction import truncate

ODD = replace(
    PUBLISHED, process=3.0, noise_model=50.0, damping=(0.03, 0.04, 0.05), selectivity=(1.5, 2.0, 3.0)
)
OMEGA = 2 * np.pi * np.array([2.0, 30.0, 80.0, 300.0, 469.5, 900.0, 2500.0])


@pytest.fixture(scope="module")
def joint():
    return search(starts(1, 0)[0], "joint", steps=25, rounds=3)


@pytest.mark.parametrize(("process", "noise_model"), [(1.0, 1e3), (1e-3, 1e-2), (1e3, 1e6)])
def test_stacked_gains_are_those_of_the_riccati_equation(process, noise_model):
    noise = Noise(process * published_noise().process, published_noise().sensor)
    ours = kalman_gains(truncate(stage(), 4, 3), noise, noise_model)
    for mass in (1, 4, 7):
        theirs = stage_observer(mass, noise, noise_model).gain[:, 0]
        np.testing.assert_allclose(ours[mass - 1], theirs, rtol=1e-7)


@pytest.mark.parametrize("design", [PUBLISHED, ODD, replace(ODD, observed=False)])
def test_closed_forms_are_the_state_space_loops(design):
    plants = [stage(), draw_plants(0.05, 1, 3)[0]]
    found = StageResponses(OMEGA, plants).loops(design)
    for p, plant in enumerate(plants):
        for mass, loop in enumerate(design.loops(plant)):
            closed = closed_loop(loop.plant, loop.compensator, design.controller.state_space())
            for name, ends in CHANNELS.items():
                theirs = channel(closed, *ends).frequency_response(OMEGA)[0, 0]
                ours = getattr(found.response, name)[p, mass]
                np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-7)
            slow = 2 * np.pi * design.bandwidth_hz * np.array([0.05, 0.2])
            soft = np.abs(channel(closed, "w", "e_true").frequency_response(slow)[0, 0])
            scale = 12.5 * (2 * np.pi * design.bandwidth_hz) ** 2
            np.testing.assert_allclose(found.softness[p, mass, [1, 3]], soft * scale, rtol=1e-4)


def test_published_design_is_that_of_the_bandwidth_table():
    table = stage_bandwidth("MC and AD")
    found = verify(PUBLISHED)
    np.testing.assert_allclose(found.crossing_hz, table.crossing_hz, rtol=1e-3)
    assert found.worst == pytest.approx(SIX_DB, rel=1e-3)
    assert PUBLISHED.design.application == replace(
        DESIGNS["MC and AD"].application, damping=(0.035,) * 3, selectivity=(2.0,) * 3
    )


def test_joint_design_keeps_every_constraint_by_exact_norms(joint):
    """No grid and none of the search's formulas: state-space loops, Hamiltonian norms, eigenvalues."""
    assert joint.stable and joint.keeps()
    assert joint.crossing_hz.min() >= joint.design.bandwidth_hz * (1 - 1e-3)
    assert joint.crossing_hz.min() > 100
    slow = 2 * np.pi * joint.design.bandwidth_hz * np.array([0.02, 0.05, 0.1, 0.2])
    for loop in joint.design.loops():
        closed = closed_loop(loop.plant, loop.compensator, joint.design.controller.state_space())
        assert np.all(closed.poles.real < 0)
        assert all(hinf_norm(channel(closed, *ends)).magnitude <= SIX_DB for ends in CHANNELS.values())
        soft = np.abs(channel(closed, "w", "e_true").frequency_response(slow)[0, 0])
        soft *= 12.5 * (2 * np.pi * joint.design.bandwidth_hz) ** 2
        assert np.all(soft <= published_softness() * (1 + 1e-3))


def test_joint_beats_either_half_from_the_same_start(joint):
    begin = starts(1, 0)[0]
    for half in ("controller", "observer"):
        alone = search(begin, half, steps=12, rounds=1)
        assert alone.crossing_hz.min() < joint.crossing_hz.min() - 5


def test_no_small_step_of_one_number_gains_bandwidth(joint):
    """A local optimum: raise the bandwidth by 1 %, move any one number, and a limit or the crossing breaks."""
    faster = replace(joint.design, bandwidth_hz=1.01 * joint.design.bandwidth_hz)
    rng = np.random.default_rng(5)
    for _ in range(4):
        tried = replace(
            faster,
            **{
                name: float(getattr(faster, name) * np.exp(rng.normal(0, 0.01)))
                for name in ("gain", "integrator", "differentiator", "low_pass", "process", "noise_model")
            },
        )
        found = verify(tried)
        soft = StageResponses(OMEGA).loops(tried).softness.max(axis=(0, 1)) > published_softness()
        assert not found.keeps() or found.crossing_hz.min() < tried.bandwidth_hz or np.any(soft)


def test_peaks_on_perturbed_plants_are_the_exact_ones(joint):
    plants = draw_plants(0.02, 2, 2)
    peaks = plant_peaks(PUBLISHED, plants)
    exact = [verify(PUBLISHED, plant).worst for plant in plants]
    np.testing.assert_allclose(peaks, exact, rtol=2e-3)
    fast = replace(joint.design, gain=2.0 * joint.design.gain)
    assert [np.isfinite(p) for p in plant_peaks(fast, plants)] == [
        verify(fast, plant).stable for plant in plants
    ]


def test_robust_search_serves_plants_that_it_has_not_seen():
    slow = replace(PUBLISHED, bandwidth_hz=35.0)
    found = robust_search(
        slow, "controller", 0.05, 7, pool=10, worst=2, turns=2, steps=8, limit=10 ** (5.7 / 20)
    )
    fresh = plant_peaks(found.design, draw_plants(0.05, 6, 99))
    assert found.crossing_hz.min() > 35
    assert np.mean(fresh <= SIX_DB) > 0.9
    assert plant_peaks(PUBLISHED, draw_plants(0.05, 6, 99)).max() > 2 * SIX_DB


def test_explorer_says_when_a_loop_is_unstable():
    title = draw_joint({"published": PUBLISHED}, "published", 0.0, 100.0).axes[0].get_title(loc="left")
    assert "6.0 dB" in title
    assert "unstable" in draw_joint({"p": replace(PUBLISHED, bandwidth_hz=200.0)}, "p", 0.0, 120.0).axes[
        0
    ].get_title(loc="left")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: JointDesign(gain=0.0), "gain"),
        (lambda: JointDesign(damping=(0.1, 0.1)), "damping has shape"),
        (lambda: JointDesign(selectivity=(1.0, -1.0, 1.0)), "selectivity"),
        (lambda: search(PUBLISHED, "all"), "free"),
        (lambda: search(replace(PUBLISHED, bandwidth_hz=240.0), "joint"), "unstable"),
        (lambda: search(PUBLISHED, "joint", limit=0.5), "limit"),
        (lambda: search(PUBLISHED, "joint", steps=0), "steps"),
        (lambda: starts(0, 1), "count"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(InputError, match=message):
        call()
