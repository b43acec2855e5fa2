"""The joint design: its closed forms against state space, its results against exact norms and eigenvalues."""

import tomllib
from dataclasses import replace

import control
import numpy as np
import pytest
from scipy import linalg

from experiments.motion.designs import DESIGNS, stage_bandwidth, stage_observer
from experiments.motion.joint import (
    CHANNELS,
    PUBLISHED,
    JointDesign,
    StageResponses,
    kalman_gains,
    relative_softness,
)
from experiments.motion.joint_designs import as_toml, rounded, stored_designs
from experiments.motion.joint_pictures import paint_joint
from experiments.motion.joint_search import plant_peaks, robust_search, sample_plants, search, starts, verify
from experiments.motion.machines import parameters, published_noise, stage
from stillwork.base.checks import InputError
from stillwork.control.bandwidth import SIX_DB
from stillwork.control.loops import channel, closed_loop
from stillwork.estimation.observer import NoiseIntensities
from stillwork.lti.reduction import truncate

ODD = replace(
    PUBLISHED, process=3.0, noise_model=50.0, damping=(0.03, 0.04, 0.05), selectivity=(1.5, 2.0, 3.0)
)
OMEGA = 2 * np.pi * np.array([2.0, 30.0, 80.0, 300.0, 469.5, 900.0, 2500.0])


STORED = stored_designs()


@pytest.fixture(scope="module")
def joint():
    return verify(STORED["joint, from the published design"])


@pytest.mark.parametrize(("process", "noise_model"), [(1.0, 1e3), (1e-3, 1e-2), (1e3, 1e6)])
def test_stacked_gains_are_those_of_the_riccati_equation(process, noise_model):
    noise = NoiseIntensities(process * published_noise().process, published_noise().sensor)
    ours = kalman_gains(truncate(stage(), 4, 3), noise, noise_model)
    for mass in (1, 4, 7):
        theirs = stage_observer(mass, noise, noise_model).gain[:, 0]
        np.testing.assert_allclose(ours[mass - 1], theirs, rtol=1e-7)


@pytest.mark.parametrize("design", [PUBLISHED, ODD, replace(ODD, observed=False)])
def test_closed_forms_are_the_state_space_loops(design):
    plants = [stage(), sample_plants(0.05, 1, 3)[0]]
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


@pytest.mark.slow
def test_published_design_is_that_of_the_bandwidth_table():
    table = stage_bandwidth("MC and AD")
    found = verify(PUBLISHED)
    np.testing.assert_allclose(found.crossing_hz, table.crossing_hz, rtol=1e-3)
    assert found.worst == pytest.approx(SIX_DB, rel=1e-3)
    assert PUBLISHED.design.application == replace(
        DESIGNS["MC and AD"].application, damping=(0.035,) * 3, selectivity=(2.0,) * 3
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", STORED)
def test_stored_designs_keep_every_constraint(name):
    found = verify(STORED[name])
    assert found.stable and found.keeps()
    assert found.crossing_hz.min() >= STORED[name].bandwidth_hz * (1 - 1e-5)
    assert np.all(relative_softness(STORED[name]) <= 1 + 1e-4)


def _blocks(design, mass):
    """Plant, observer, band-passes and PID from the printed formulas alone, masses and springs first."""
    p = parameters("stage")
    m = np.diag([p["actuator_mass"], *[p["mass"]] * 7])
    springs = [p["actuator_stiffness"], *[p["stiffness"]] * 6]
    k = sum(s * np.outer(e, e) for s, e in zip(springs, np.diff(np.eye(8), axis=0), strict=True))
    squares, shapes = linalg.eigh(k, m)
    w = np.sqrt(np.maximum(squares, 0))
    w[0] = 0.0
    push, see, ratio = shapes[0], shapes[mass], p["damping_ratio"]

    def modal(n):
        a, b, c = np.zeros((2 * n, 2 * n)), np.zeros(2 * n), np.zeros(2 * n)
        for i in range(n):
            a[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[0, 1], [-(w[i] ** 2), -2 * ratio * w[i]]]
            b[2 * i + 1], c[2 * i] = push[i], see[i]
        return a, b, c

    a, b, c = modal(4)
    d = np.sum(push[4:7] * see[4:7] / w[4:7] ** 2)
    a = np.block([[a, b[:, None]], [np.zeros((1, 9))]])
    b, c = np.append(b, 0.0), np.append(c, 0.0)
    unit = np.diag([1e-6, 1e-3] * 4 + [1.0])  # states of like size, nm for metres
    into = np.linalg.inv(unit)
    q = design.process * p["noise"]["process"] ** 2 * np.outer(b, b)
    q[-1, -1] = design.noise_model
    r = np.array([[1e18 * p["noise"]["sensor"] ** 2]])
    output = 1e9 * (c @ unit)[:, None]
    covariance = linalg.solve_continuous_are((into @ a @ unit).T, output, into @ q @ into.T, r)
    gain = 1e9 * unit @ covariance @ output[:, 0] / r[0, 0]
    states = a - np.outer(gain, c)
    velocity, flexible = np.eye(9)[[3, 5, 7]], np.where(np.isin(np.arange(9), (2, 4, 6)), c, 0.0)
    s = control.tf("s")
    bands = [
        -2 * z * wi / pi * (wi / qi) * s / (s**2 + wi / qi * s + wi**2)
        for z, qi, wi, pi in zip(design.damping, design.selectivity, w[1:4], push[1:4], strict=True)
    ]
    f = 2 * np.pi * design.bandwidth_hz
    kp, wi, wd, wl = (
        design.gain * 12.5 * f**2 / 3,
        design.integrator * f / 9,
        design.differentiator * f,
        design.low_pass * f,
    )
    pid = kp * (s + wi) / s * (s / wd + 1) * wl**2 / (s**2 + 2 * design.low_pass_damping * wl * s + wl**2)
    pa, pb, pc = modal(8)
    return [
        control.ss(pa, pb[:, None], pc[None], 0, inputs="f", outputs="y", name="plant"),
        control.ss(
            states,
            np.c_[b - gain * d, gain],
            np.vstack([velocity, flexible]),
            np.zeros((4, 2)),
            inputs=["f", "y"],
            outputs=["v1", "v2", "v3", "flex"],
            name="observer",
        ),
        *(
            control.ss(band, inputs=f"v{i}", outputs=f"d{i}", name=f"band{i}")
            for i, band in enumerate(bands, 1)
        ),
        control.ss(pid, inputs="e", outputs="c", name="pid"),
        control.summing_junction(["r", "-y", "flex"], "e", name="error"),
        control.summing_junction(["c", "u_ff"], "u", name="input"),
        control.summing_junction(["u", "d1", "d2", "d3"], "f", name="force"),
        control.summing_junction(["r", "-y"], "e_true", name="true"),
    ]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["joint, from the published design", "joint, for 5%"])
def test_python_control_closes_the_same_loops(name):
    """Poles and peaks of all seven masses without a line of the library: the design's numbers go in."""
    found = verify(STORED[name])
    for mass in range(1, 8):
        loop = control.interconnect(
            _blocks(STORED[name], mass), inplist=["r", "u_ff"], outlist=["e_true", "u"]
        )
        assert np.linalg.eigvals(loop.A).real.max() < 0
        for function, place in ((0, (1, 1)), (2, (0, 0))):  # S_O differs from r to e by its input alone
            near = found.frequencies[function, mass - 1] * np.linspace(0.999, 1.001, 5)
            grid = np.r_[np.geomspace(10, 3e4, 400), near]
            peak = np.abs(loop(1j * grid, squeeze=False)[place]).max()
            assert peak == pytest.approx(found.peaks[function, mass - 1], rel=1e-4)


@pytest.mark.slow
def test_the_search_finds_the_stored_design_again(joint):
    start = replace(joint.design, bandwidth_hz=85.0, gain=0.8, low_pass=3.5)
    again = search(start, "joint", steps=8, rounds=1)
    assert again.worst < 1.01 * SIX_DB
    assert again.crossing_hz.min() > 0.99 * joint.crossing_hz.min()


@pytest.mark.slow
def test_joint_beats_either_half_and_both_in_turn(joint):
    """The stored rivals, the two steps among them, stay 5 Hz and more below the joint design."""
    for name in (
        "observer free, controller by the rule",
        "controller free, observer as published",
        "two steps: observer, then controller",
    ):
        assert verify(STORED[name]).crossing_hz.max() < joint.crossing_hz.min() - 5


@pytest.mark.slow
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
        soft = relative_softness(tried) > 1
        assert not found.keeps() or found.crossing_hz.min() < tried.bandwidth_hz or np.any(soft)


@pytest.mark.slow
def test_peaks_on_perturbed_plants_are_the_exact_ones():
    """Also a narrow one far from every pole, which the search's own grid misses by half a decibel."""
    narrow = replace(
        STORED["joint, for 2%"],
        process=0.142694,
        noise_model=5559.94,
        selectivity=(0.731895, 8.58694, 18.3321),
        damping=(0.0596697, 0.0545687, 0.0330418),
    )
    plants = sample_plants(0.02, 24, 7)
    for design, chosen in ((PUBLISHED, plants[:1]), (narrow, plants[23:])):
        exact = [verify(design, plant).worst for plant in chosen]
        np.testing.assert_allclose(plant_peaks(design, chosen), exact, rtol=1e-4)
    fast = replace(STORED["joint, from the published design"], gain=2.0)
    assert [np.isfinite(p) for p in plant_peaks(fast, plants[:3])] == [
        verify(fast, plant).stable for plant in plants[:3]
    ]


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.02, 0.05])
def test_robust_designs_serve_stages_that_they_have_not_seen(size):
    fresh = sample_plants(size, 12, 99)
    assert plant_peaks(STORED[f"joint, for {size:.0%}"], fresh).max() <= SIX_DB
    assert plant_peaks(PUBLISHED, fresh).max() > SIX_DB


@pytest.mark.slow
def test_robust_search_keeps_its_limit_on_the_pool():
    slow, limit = replace(PUBLISHED, bandwidth_hz=38.0), 10 ** (5.7 / 20)
    found = robust_search(slow, "controller", 0.05, 7, pool=4, worst=1, turns=4, steps=6, limit=limit)
    assert found.crossing_hz.min() > 42
    assert plant_peaks(found.design, sample_plants(0.05, 4, 7)).max() <= limit * (1 + 1e-4)


def test_stored_designs_are_rounded_and_survive_the_file():
    for name, design in STORED.items():
        assert rounded(design) == design
        read = tomllib.loads(as_toml(name, design))[name]
        assert JointDesign(**{k: tuple(v) if isinstance(v, list) else v for k, v in read.items()}) == design


@pytest.mark.slow
def test_explorer_says_when_a_loop_is_unstable():
    title = paint_joint({"published": PUBLISHED}, "published", 0.0, 100.0).axes[0].get_title(loc="left")
    assert "6.0 dB" in title
    assert "unstable" in paint_joint({"p": replace(PUBLISHED, bandwidth_hz=200.0)}, "p", 0.0, 120.0).axes[
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
