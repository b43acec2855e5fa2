from dataclasses import replace

import numpy as np
import pytest
from scipy import signal
from stillwork.checks import InputError
from stillwork.motion.controller import PidFamily
from stillwork.motion.designs import DESIGNS, stage_compensator
from stillwork.motion.ideal_feedforward import feedforward_error, ideal_force, invert, respond
from stillwork.motion.location_study import LocationStudy, ranges, stage_error, study_locations
from stillwork.motion.loops import closed_loop
from stillwork.motion.machines import chain, stage, stage_mass
from stillwork.motion.performance import rms
from stillwork.motion.position_dependence import stage_grid
from stillwork.motion.position_plots import draw_location
from stillwork.motion.reduction import truncate
from stillwork.motion.setpoint import published_setpoint
from stillwork.motion.tracking import Feedforward, error_loop, tracking_error

GRID = stage_grid()
APPLIED = Feedforward(acceleration=12.5, snap=1.5e-6)


@pytest.fixture(scope="module")
def setpoint():
    return published_setpoint(2e-4)


@pytest.fixture(scope="module")
def plant():
    return stage().at([0], [4])


@pytest.fixture(scope="module")
def force(plant, setpoint):
    return feedforward_error(ideal_force(invert(plant), setpoint), APPLIED)


@pytest.mark.parametrize("mass", [1, 4, 5, 7])
def test_partial_fractions_are_the_inverse(mass):
    machine = stage().at([0], [mass - 1])
    inverse = invert(machine)
    omega = 2 * np.pi * np.geomspace(0.5, 8e3, 300)
    s = 1j * omega
    ours = inverse.polynomial @ s ** np.arange(3)[:, None] + (
        inverse.residues / (s[:, None] - inverse.zeros)
    ).sum(axis=1)
    wanted = 1 / (s**2 * machine.frequency_response(omega)[0, 0])
    np.testing.assert_allclose(ours, wanted, rtol=1e-7)


def test_the_ideal_force_moves_the_plant_along_the_setpoint(plant):
    setpoint = published_setpoint(5e-6)
    force = ideal_force(invert(plant), setpoint)
    states = plant.modes(slice(0, 8)).state_space()
    end = np.searchsorted(force.time, 0.03)
    time = force.time[:end] - force.time[0]
    _, y, _ = signal.lsim((states.a, states.b, states.c, states.d), force.values[:end], time)
    ahead = len(force.time) - len(setpoint.time)
    wanted = setpoint.derivatives[0, : end - ahead]
    # Limited by the linear hold of the force in lsim.
    assert np.abs(y[ahead:] - wanted).max() < 2e-7 * wanted.max()


def test_a_force_fed_into_the_loop_gives_the_tracking_error(plant, setpoint, force):
    controller = PidFamily(stage_mass())(35.0)
    for name in ("PID", "AD"):
        loop = closed_loop(plant, stage_compensator(5, DESIGNS[name]), controller.state_space())
        wanted = tracking_error(error_loop(loop), setpoint, APPLIED)
        study = study_locations(stage(), GRID, [GRID[4]], force, setpoint, {"one": (name, controller)})
        np.testing.assert_allclose(study.errors["one"][0], wanted, atol=1e-7 * np.abs(wanted).max())


def test_the_sample_time_does_not_matter(plant, setpoint, force):
    fine = published_setpoint(1e-4)
    finer = feedforward_error(ideal_force(invert(plant), fine), APPLIED)
    loop = closed_loop(plant, None, PidFamily(stage_mass())(30.0).state_space()).select([2], [0])
    coarse, exact = respond(loop, force), respond(loop, finer)
    n = len(setpoint.time)
    np.testing.assert_allclose(coarse[0, -n:], exact[0, -2 * n + 1 :: 2], atol=1e-9 * np.abs(exact).max())


def test_a_reduced_model_has_an_ideal_force_too(setpoint):
    inverse = invert(truncate(stage().at([0], [4]), 4, 3))
    assert len(inverse.zeros) == 8
    still = ideal_force(inverse, setpoint).values
    np.testing.assert_allclose(still[-1], 0, atol=1e-2 * np.abs(still).max())


def test_rms_settling_and_ranges_by_hand(setpoint):
    time = setpoint.time
    decay = np.where(time >= 0.02, np.exp(-(time - 0.02) / 0.01), 0.0)
    places = np.linspace(0, 0.3, 7)
    study = LocationStudy(places, setpoint, {"one": decay * (1 + places[:, None])})
    np.testing.assert_allclose(study.rms("one")[0], rms(decay[setpoint.scanning]))
    expected = 0.01 * np.log(1.3 / 0.1)
    assert study.settled("one", 0.1)[-1] == pytest.approx(expected, abs=setpoint.step)
    low, mean, high = study.over("one", 0.1, 0.3, 29)
    first = study.rms("one")[0]
    np.testing.assert_allclose([low, mean, high], first * np.array([1.1, 1.2, 1.3]), rtol=1e-9)
    found = ranges(places, 0.5, 5)
    assert len(found) == 6
    assert np.all(found[:, 1] - found[:, 0] > 0.1499)
    with pytest.raises(InputError, match="low and high"):
        study.over("one", 0.2, 0.4)
    with pytest.raises(InputError, match="case"):
        study.rms("two")


def test_noise_adds_to_the_error_and_is_the_same_for_all_cases(setpoint, force):
    pid = PidFamily(stage_mass())(30.0)
    cases = {"a": ("PID", pid), "b": ("PID", pid)}
    noise = {"d": 1e-9}
    noisy, quiet = (
        study_locations(stage(), GRID, [0.1], force, setpoint, cases, "w", *extra)
        for extra in ((noise, np.random.default_rng(1)), ())
    )
    np.testing.assert_array_equal(noisy.errors["a"], noisy.errors["b"])
    added = (noisy.errors["a"] - quiet.errors["a"])[0]
    assert 1e-11 < added.std() < 3e-9
    with pytest.raises(InputError, match="belong together"):
        study_locations(stage(), GRID, [0.1], force, setpoint, cases, "w", noise)


def test_bad_plants_places_and_loops_are_refused(plant, setpoint, force):
    with pytest.raises(InputError, match="imaginary axis"):
        invert(stage(0.0).at([0], [4]))
    with pytest.raises(InputError, match="one rigid-body mode"):
        invert(chain(np.full(3, 2.0)))
    with pytest.raises(InputError, match="differentiates the snap"):
        masses = chain(np.full(8, 2.0)).at([0], [7])
        invert(masses)
    with pytest.raises(InputError, match="inputs"):
        respond(closed_loop(plant, None, PidFamily(stage_mass())(30.0).state_space()), force)
    pid, wild = PidFamily(stage_mass())(30.0), PidFamily(stage_mass())(140.0)
    with pytest.raises(InputError, match=r"wild at 0\.1 m"):
        study_locations(stage(), GRID, [0.1], force, setpoint, {"wild": ("PID", wild)})
    with pytest.raises(InputError, match="outside the grid"):
        study_locations(stage(), GRID, [0.4], force, setpoint, {"one": ("PID", pid)})
    with pytest.raises(InputError, match="ascending"):
        study_locations(stage(), GRID, [0.2, 0.1], force, setpoint, {"one": ("PID", pid)})
    with pytest.raises(InputError, match="design"):
        study_locations(stage(), GRID, [0.1], force, setpoint, {"one": ("DA", pid)})
    with pytest.raises(InputError, match="same samples"):
        study_locations(stage(), GRID, [0.1], force, published_setpoint(1e-4), {"one": ("PID", pid)})
    with pytest.raises(InputError, match="same samples"):
        shifted = replace(force, time=force.time + 1e-4)
        study_locations(stage(), GRID, [0.1], shifted, setpoint, {"one": ("PID", pid)})


def test_the_stage_has_the_error_of_its_own_feedforward(setpoint):
    found = stage_error(setpoint, PidFamily(stage_mass())(35.0))
    # Four gains fitted to the move leave some newtons in the middle of a segment, spikes where the snap jumps.
    middle = np.abs(found.values[np.abs(found.time - 0.01).argmin()])
    assert middle < 1 < np.abs(found.values).max()
    with pytest.raises(InputError, match="masses 1 to 7"):
        stage_error(setpoint, PidFamily(stage_mass())(35.0), 8)


def test_the_explorer_draws_a_location():
    assert draw_location(0.12, 0.035, "yes", 30.0).axes
