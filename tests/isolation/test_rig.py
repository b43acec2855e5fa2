"""Rigid body on struts: published facts, invariances, and models that no rig can have."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.isolation.rig import Lines, Rig
from experiments.isolation.twin import load_twin

RIG = load_twin("rigid_body").rig


def random_rig(seed, struts=7):
    rng = np.random.default_rng(seed)
    lines = Lines(rng.uniform(-0.3, 0.3, (struts, 3)), rng.standard_normal((struts, 3)))
    a, b, c = rng.uniform(0.01, 0.05, 3)  # sizes of a box: an inertia that a body can have
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    inertia = turn @ np.diag([b + c, a + c, a + b]) @ turn.T
    sensors = Lines([[0.1, 0, 0], [-0.05, 0.08, 0], [-0.05, -0.08, 0]], [[0, 0, 1]] * 3)
    return Rig(
        mass=rng.uniform(1, 20),
        inertia=(inertia + inertia.T) / 2,
        struts=lines,
        stiffness=rng.uniform(1e4, 1e5, struts),
        damping=rng.uniform(0, 100, struts),
        floor_sensors=sensors,
        actuators=lines,
        platform_sensors=lines,
    )


def test_published_facts_of_the_rig():
    assert RIG.frequencies_hz == pytest.approx([15.0, 15.0, 35.2, 40.0, 40.0, 40.0], abs=0.01)
    assert RIG.equivalent_mass == pytest.approx(1.405, abs=1e-3)
    # 2 zeta omega = d omega^2 / k for equal struts: one gain cannot give all modes the same damping.
    assert RIG.damping_ratios(225.0) == pytest.approx(290 * RIG.modes[0] / (2 * 60e3), rel=1e-6)


def test_shipped_geometry_is_what_its_comment_says():
    tilt, radius = np.radians(31.08), 0.1
    azimuth = np.radians([15, -15, 135, 105, 255, 225])
    side = np.tile([1, -1], 3)
    places = radius * np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=1)
    tangent = np.stack([-np.sin(azimuth), np.cos(azimuth), 0 * azimuth], axis=1)
    directions = np.sin(tilt) * side[:, None] * tangent - np.cos(tilt) * np.array([0, 0, 1])
    assert RIG.struts.positions == pytest.approx(places, abs=1e-7)
    assert RIG.struts.directions == pytest.approx(directions, abs=1e-7)
    turns = np.radians(-70.494 + np.array([0, 120, 240]))
    sensors = 0.0648019 * np.stack([np.cos(turns), np.sin(turns), 0 * turns], axis=1)
    assert RIG.floor_sensors.positions == pytest.approx(sensors, abs=1e-6)


def test_stiffness_row_of_table_1_follows_from_the_sensors():
    twin = load_twin("rigid_body")
    row = -(RIG.struts.jacobian @ RIG.plate_motion)[0] * 60e3 / twin.feedforward.beta**2
    assert row == pytest.approx([0.5321, 1.5175, -0.7648], abs=2e-4)


def test_other_rows_follow_by_three_fold_symmetry():
    rows = RIG.struts.jacobian @ RIG.plate_motion
    assert np.roll(rows[:2], 1, axis=1) == pytest.approx(rows[2:4], abs=1e-6)
    assert np.roll(rows[:2], 2, axis=1) == pytest.approx(rows[4:], abs=1e-6)


@given(st.integers(0, 10**6))
@settings(max_examples=40)
def test_matrices_are_symmetric_and_the_modes_solve_the_equation_of_motion(seed):
    rig = random_rig(seed)
    omega, shapes = rig.modes
    assert rig.stiffness_matrix == pytest.approx(rig.stiffness_matrix.T)
    assert rig.strut_inverse_mass == pytest.approx(rig.strut_inverse_mass.T)
    residual = rig.stiffness_matrix @ shapes - rig.mass_matrix @ shapes * omega**2
    assert np.abs(residual).max() <= 1e-9 * np.abs(rig.stiffness_matrix @ shapes).max()
    assert shapes.T @ rig.mass_matrix @ shapes == pytest.approx(np.eye(6), abs=1e-9)
    assert np.linalg.eigvalsh(rig.damping_matrix)[0] >= -1e-9 * np.abs(rig.damping_matrix).max()


@given(st.integers(0, 10**6), st.floats(0.1, 10), st.floats(0.1, 10))
@settings(max_examples=25)
def test_frequencies_scale_with_stiffness_and_mass(seed, stiffer, heavier):
    rig = random_rig(seed)
    other = replace(
        rig, mass=heavier * rig.mass, inertia=heavier * rig.inertia, stiffness=stiffer * rig.stiffness
    )
    assert other.frequencies_hz == pytest.approx(rig.frequencies_hz * np.sqrt(stiffer / heavier), rel=1e-9)


@given(st.integers(0, 10**6))
@settings(max_examples=25)
def test_frequencies_do_not_change_when_the_whole_rig_is_turned(seed):
    rig = random_rig(seed)
    turn = np.linalg.qr(np.random.default_rng(seed + 1).standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    lines = Lines(rig.struts.positions @ turn.T, rig.struts.directions @ turn.T)
    inertia = turn @ rig.inertia @ turn.T
    other = replace(
        rig, inertia=(inertia + inertia.T) / 2, struts=lines, actuators=lines, platform_sensors=lines
    )
    assert other.frequencies_hz == pytest.approx(rig.frequencies_hz, rel=1e-8)


def test_plate_motion_undoes_its_sensors():
    assert RIG.floor_sensors.jacobian @ RIG.plate_motion == pytest.approx(np.eye(3), abs=1e-12)
    assert RIG.plate_motion[[0, 1, 5]] == pytest.approx(0.0, abs=1e-12)
