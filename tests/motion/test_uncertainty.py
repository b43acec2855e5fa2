"""Machines somewhere in a box: the worst place against draws of it."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from stillwork.control.bandwidth import FUNCTIONS, SIX_DB, PeakConstraint, make_loop
from stillwork.control.machine_loops import (
    SAFE,
    DesignSettings,
    SearchSettings,
    applications,
    observed_loops,
    observer_settings,
    pid_family,
)
from stillwork.control.pid import PidFamily
from stillwork.control.uncertainty import (
    EXCESS,
    Perturbation,
    Uncertainty,
    harmful_places,
    largest_along,
    make_box,
    perturbed_loop,
)
from stillwork.identification.machine import Machine
from stillwork.lti.modal import modal_model
from stillwork.machine.machine_designs import INTENSITIES
from stillwork.machine.machine_tuning import tuned

STIFFNESS = np.array([[3e7, -3e7, 0], [-3e7, 5e7, -2e7], [0, -2e7, 2e7]])
CHAIN = modal_model(np.diag([20.0, 10, 10]), STIFFNESS, [[1.0], [0], [0]], [[0.0, 0, 1]], damping_ratio=0.005)
ONES = np.ones(3)
SAMPLED = {"sample_time": 1e-4, "delay": 1.37}
WHOLE = Uncertainty(frequency=0.05, residue=0.1, damping=0.3, gain=0.1, mass=0.03, delay=1e-5)


def worst_place(loop, controller, function, box):
    ((size, worst),) = make_box(loop, box).worst(loop, controller, [PeakConstraint(function)], every=True)
    return size, worst


def place(frequencies=ONES, residues=ONES, damping=ONES, gain=1.0, delay=0.0):
    return Perturbation(np.array(frequencies), np.array(residues), np.array(damping), gain, delay)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "function"), list(zip([{}, SAMPLED, {"sample_time": 1.4e-3}], FUNCTIONS, strict=True))
)
def test_the_worst_place_is_the_worst_of_a_grid(options, function):
    """The last sample time folds the second mode back below half the rate."""
    loop, pid = make_loop(CHAIN, **options), PidFamily(40.0)(12.0)
    size, worst = worst_place(loop, pid, function, Uncertainty(frequency=0.05))
    sides = itertools.product(np.linspace(0.95, 1.05, 9), repeat=2)
    grid = max(perturbed_loop(loop, place([1.0, *each])).peak(pid, function).magnitude for each in sides)
    there = perturbed_loop(loop, worst).peak(pid, function).magnitude
    assert there >= 0.999 * grid and size == pytest.approx(there, rel=2e-3)
    assert worst.frequencies[0] == 1 and np.all(np.abs(worst.frequencies - 1) <= 0.05 + 1e-12)


def test_a_peak_between_the_lines_of_the_grid_is_seen():
    """A grid without the lines at the worst peak shows it too low; a limit in between is exceeded all the same."""
    loop, pid, name = make_loop(CHAIN, **SAMPLED), PidFamily(40.0)(12.0), "output_sensitivity"
    box = make_box(loop, Uncertainty(frequency=0.05), fine=False)
    ((_, there),) = box.worst(loop, pid, [PeakConstraint(name)], every=True)
    peak = perturbed_loop(loop, there).peak(pid, name)
    kept = np.abs(box.omega / peak.omega - 1) > 0.02
    coarse = box._replace(
        **{each: getattr(box, each)[kept] for each in ("omega", "rows", "fixed", "middles", "radii")}
    )
    ((shown, _),) = coarse.worst(loop, pid, [PeakConstraint(name)], every=True, exact=False)
    assert 0.995 * peak.magnitude < shown < 0.9995 * peak.magnitude
    between = [PeakConstraint(name, (shown * peak.magnitude) ** 0.5 / EXCESS)]
    assert not coarse.worst(loop, pid, between, exact=False)
    assert harmful_places([loop], pid, between, [coarse])


@pytest.mark.slow
@pytest.mark.parametrize("function", FUNCTIONS)
def test_no_draw_of_a_whole_box_is_worse(function):
    """All that a machine has moves at once, in corners and inside; an observer's loop with a delay of 1.37 samples."""
    machine = Machine((CHAIN,), 40.0, "chain")
    use = applications(0.02, 2.0)["MC and AD"]
    settings = observer_settings(machine, use, 3, INTENSITIES)
    (loop,) = observed_loops([CHAIN], use, *settings, *SAMPLED.values())
    pid = PidFamily(40.0)(12.0)
    size, worst = worst_place(loop, pid, function, WHOLE)
    assert perturbed_loop(loop, worst).peak(pid, function).magnitude == pytest.approx(size, rel=2e-3)
    rng = np.random.default_rng(0)
    for draw in range(60):
        x = rng.choice([-1.0, 1.0], 12) if draw % 2 else rng.uniform(-1, 1, 12)
        x[[0, 6]] = 0.0  # of the rigid body neither frequency nor damping
        moved = place(1 + 0.05 * x[:3], 1 + 0.1 * x[3:6], 1 + 0.3 * x[6:9], 1 + 0.1 * x[9], 1e-5 * x[10])
        moved.residues[0] = 1 / (1 + 0.03 * x[11])
        assert perturbed_loop(loop, moved).peak(pid, function).magnitude < 1.002 * size


def test_along_a_line_the_largest_ratio_is_that_of_many_points():
    rng = np.random.default_rng(11)
    inside = 0
    for _ in range(300):
        a, b, c, d = rng.standard_normal(4) + 1j * rng.standard_normal(4)
        low, high = np.sort(rng.uniform(-2, 2, 2))
        points = np.linspace(low, high, 401)
        found = largest_along(a, b, c, d, low, high)
        assert low <= found <= high
        best = np.abs(1 + (a + points * b) / (c + points * d)).max()
        assert abs(1 + (a + found * b) / (c + found * d)) >= best * (1 - 1e-12)
        inside += low < found < high
    assert inside > 50


def test_close_resonances_may_change_places():
    """The moved plant term by term: each mode keeps its shapes and its damping ratio."""
    factors, omega = [1.0, 1.5, 0.7], np.array([100.0, 1500.0, 2500.0])
    moved = CHAIN.frequencies * factors
    assert moved[1] > moved[2]
    gains = CHAIN.output_shapes[0] * CHAIN.input_shapes[:, 0] * np.array([1.0, 0.9, 1.2]) * 1.1
    damping = CHAIN.damping * np.array([1.0, 2.0, 0.5])
    parts = gains / (moved**2 - omega[:, None] ** 2 + 2j * damping * moved * omega[:, None])
    there = place(factors, [1.0, 0.9, 1.2], [1.0, 2.0, 0.5], 1.1)
    found = perturbed_loop(make_loop(CHAIN), there).plant.frequency_response(omega)[0, 0]
    assert found == pytest.approx(parts.sum(axis=1), rel=1e-9)


@pytest.mark.slow
def test_a_mode_that_is_seen_folded_back_is_worst_where_it_meets_another():
    """Of 412 Hz sampled at 625 Hz 213 Hz are seen, beside the first mode: no end of the interval is the worst place.

    Many times as high as any limit, the peak is so narrow that it lies between the places tried: beside it is bad enough.
    """
    light = replace(CHAIN, damping=0.2 * CHAIN.damping)
    loop, pid = make_loop(light, sample_time=1.6e-3), PidFamily(40.0)(40.0)
    size, found = worst_place(loop, pid, "input_sensitivity", Uncertainty(frequency=[0.0, 0.0, 0.05]))
    sizes = [
        perturbed_loop(loop, place([1.0, 1.0, factor])).peak(pid, "input_sensitivity").magnitude
        for factor in np.linspace(0.95, 1.05, 41)
    ]
    assert size >= 0.98 * max(sizes) > 2 * max(sizes[0], sizes[-1]) > SIX_DB
    assert perturbed_loop(loop, found).peak(pid, "input_sensitivity").magnitude == pytest.approx(size)


def test_tuned_settings_hold_the_limits_at_a_higher_bandwidth_on_the_whole_box():
    """Of a PID without observer its lead alone can be tuned; on a grid of places, at the corners and inside."""
    machine, settings = Machine((CHAIN,), 40.0, "chain"), DesignSettings(None, 5, INTENSITIES)
    found = tuned(machine, settings, 20.0, SearchSettings(1e-4, 1.0, {"frequency": 0.05}))
    assert found != settings
    loop, pid = make_loop(CHAIN, sample_time=1e-4, delay=1), pid_family(machine, found.lead, 1, 1e-4)(20.6)
    for each in itertools.product([0.95, 0.98, 1.0, 1.05], repeat=2):
        moved = perturbed_loop(loop, place([1.0, *each]))
        assert all(moved.peak(pid, limit.function).magnitude < limit.limit for limit in SAFE)
