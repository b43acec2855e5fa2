"""Resonances in a box: the worst place against all places of a grid, and what `design` promises against errors of its own."""

import itertools
import runpy
from dataclasses import replace

import numpy as np
import pytest

from stillwork.base import paths
from stillwork.base.checks import InputError
from stillwork.control.applications import Application
from stillwork.control.bandwidth import FUNCTIONS, holds, make_loop
from stillwork.control.digital import runnable
from stillwork.control.machine_loops import SAFE, doubted_loops, doubted_shares, reach
from stillwork.control.machine_tuning import DesignSettings, tuned
from stillwork.control.moved_resonances import moved_loop, worst_factors
from stillwork.control.pid import PidFamily
from stillwork.designing import INTENSITIES
from stillwork.identification.frequency_response import Identified
from stillwork.identification.machine import Machine, build_machine
from stillwork.identification.machine_files import load_machine
from stillwork.identification.modal_fit import identify_modes
from stillwork.lti.modal import modal_model

STIFFNESS = np.array([[3e7, -3e7, 0], [-3e7, 5e7, -2e7], [0, -2e7, 2e7]])
CHAIN = modal_model(np.diag([20.0, 10, 10]), STIFFNESS, [[1.0], [0], [0]], [[0.0, 0, 1]], damping_ratio=0.005)
SHARES = [0.0, 0.05, 0.05]


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"sample_time": 1e-4, "delay": 1}, {"sample_time": 1.4e-3}])
@pytest.mark.parametrize("function", FUNCTIONS)
def test_the_worst_place_is_the_worst_of_a_grid(options, function):
    """The last sample time folds the second mode back below half the rate."""
    loop, pid = make_loop(CHAIN, **options), PidFamily(40.0)(12.0)
    size, factors = worst_factors(loop, pid, function, SHARES)
    sides = itertools.product(np.linspace(0.95, 1.05, 9), repeat=2)
    grid = max(moved_loop(loop, np.array([1.0, *each])).peak(pid, function).magnitude for each in sides)
    there = moved_loop(loop, factors).peak(pid, function).magnitude
    assert there >= 0.999 * grid and size == pytest.approx(there, rel=2e-3)
    assert factors[0] == 1 and np.all(np.abs(factors - 1) <= 0.05 + 1e-12)


def test_close_resonances_may_change_places():
    """The moved plant term by term: each mode keeps its shapes and its damping ratio."""
    factors, omega = [1.0, 1.5, 0.7], np.array([100.0, 1500.0, 2500.0])
    moved = CHAIN.frequencies * factors
    assert moved[1] > moved[2]
    gains = CHAIN.output_shapes[0] * CHAIN.input_shapes[:, 0]
    parts = gains / (moved**2 - omega[:, None] ** 2 + 2j * CHAIN.damping * moved * omega[:, None])
    found = moved_loop(make_loop(CHAIN), factors).plant.frequency_response(omega)[0, 0]
    assert found == pytest.approx(parts.sum(axis=1), rel=1e-9)


def test_where_no_mode_moves_the_worst_is_the_peak():
    loop, pid = make_loop(CHAIN), PidFamily(40.0)(12.0)
    size, factors = worst_factors(loop, pid, "input_sensitivity", [0.0, 0.0, 0.0])
    assert size == loop.peak(pid, "input_sensitivity").magnitude and np.array_equal(factors, np.ones(3))


def test_a_mode_that_is_seen_folded_back_is_worst_where_it_meets_another():
    """Of 412 Hz sampled at 625 Hz 213 Hz are seen, beside the first mode: no end of the interval is the worst place."""
    light = replace(CHAIN, damping=0.2 * CHAIN.damping)
    loop, pid = make_loop(light, sample_time=1.6e-3), PidFamily(40.0)(40.0)
    size, factors = worst_factors(loop, pid, "input_sensitivity", [0.0, 0.0, 0.05])
    sizes = {
        place: moved_loop(loop, np.array([1.0, 1.0, place])).peak(pid, "input_sensitivity").magnitude
        for place in np.linspace(0.95, 1.05, 101)
    }
    assert size >= 0.99 * max(sizes.values()) > 2 * max(sizes[0.95], sizes[1.05])
    assert moved_loop(loop, factors).peak(pid, "input_sensitivity").magnitude == pytest.approx(size, rel=2e-3)


def test_shares_that_do_not_fit_are_refused():
    loop, pid = make_loop(CHAIN), PidFamily(40.0)(12.0)
    for shares in ([0.05], [0.0, -0.1, 0.0], [0.0, 1.0, 0.0]):
        with pytest.raises(InputError, match="shares"):
            worst_factors(loop, pid, "input_sensitivity", shares)
    with pytest.raises(InputError, match="factors"):
        moved_loop(loop, [1.0, -1.0, 1.0])


def test_other_forms_of_numbers_are_taken_and_nonsense_is_named():
    loop, pid = make_loop(CHAIN), PidFamily(40.0)(12.0)
    frozen = np.array([1.0, 0.95, 1.05])
    frozen.flags.writeable = False
    forms = [frozen, frozen.astype(np.float32), frozen.tolist()]
    moved = [doubted_loops([loop], [each])[0].plant.frequencies for each in forms]
    assert moved[1] == pytest.approx(moved[0], rel=1e-6) and np.array_equal(moved[2], moved[0])
    assert holds((loop,), pid, [*SAFE]) and not holds([loop], PidFamily(40.0)(80.0), SAFE)
    for call, message in (
        (lambda: holds([], pid, SAFE), r"^loops\b"),
        (lambda: holds([loop], pid, []), r"^constraints\b"),
        (lambda: holds([loop], 3.0, SAFE), "controller"),
        (lambda: doubted_loops([loop], [[1.0, 0.9]]), "factors"),
        (lambda: doubted_loops([loop], "12"), "moves"),
    ):
        with pytest.raises(InputError, match=message):
            call()


def test_settings_are_not_tuned_for_nonsense():
    machine, settings = Machine((CHAIN,), 40.0, "chain"), DesignSettings(None, 5, INTENSITIES)
    good = {"design_hz": 10.0, "doubt": 0.05, "sample_time": 1e-4, "delay": 1}
    for name, value in {"design_hz": np.nan, "doubt": 1.5, "sample_time": 0.0, "delay": -1}.items():
        with pytest.raises(InputError, match=name):
            tuned(machine, settings, **good | {name: value})


def test_a_fit_that_knows_less_than_the_doubt_widens_it():
    omega = 2 * np.pi * np.arange(20.0, 900.0)
    rng = np.random.default_rng(0)
    noise = 1 + 0.3 * (rng.standard_normal(len(omega)) + 1j * rng.standard_normal(len(omega)))
    accelerance = -(omega**2) * CHAIN.frequency_response(omega)[0, 0] * noise
    fit = identify_modes(Identified(omega, accelerance, np.ones(len(omega))), (20.0, 899.0))
    machine = Machine((fit.model,), 40.0, "noisy", fit=fit)
    known = 1.96 * fit.deviation / fit.model.frequencies[1:]
    assert doubted_shares(machine, 1e-9)[1:] == pytest.approx(known)
    assert np.all(doubted_shares(machine, 0.05) == [0.0, *[0.05] * len(known)])
    assert not doubted_shares(machine, 0.0).any()


@pytest.mark.slow
def test_six_decibels_hold_for_errors_of_single_resonances(tmp_path):
    """By SciPy alone, over corners and draws of 5 % by resonance; all moved alike would let it go further."""
    bench = runpy.run_path(str(paths.root() / "benchmarks" / "machines.py"))
    arrays, rate, delay = bench["sample_machine"](np.random.default_rng(4))
    np.savez(tmp_path / "machine.npz", **arrays)
    file = load_machine(tmp_path / "machine.npz")
    machine = build_machine(file, modes_hz=[], fit_hz=(0.0, 0.0), mirrored_sensor=False)
    use = {"MC": Application(compensate=True)}
    how = {"sample_time": 1 / rate, "delay": delay, "doubt": 0.05}
    found = reach(machine, use, retained=5, intensities=INTENSITIES, **how)["MC"]
    assert len(found.doubted_loops) > 2
    controller = runnable(found.recommended.controller, found.loops[0].compensator, np.inf, {})
    peaks, radius = bench["worst"](arrays, controller.as_dict(), 1 / rate, delay, np.random.default_rng(5))
    assert peaks.max() < 6.01 and radius < 1
