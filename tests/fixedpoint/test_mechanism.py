"""Several coordinates: the arm against its Lagrangian, the loop against one coordinate and a solver, contraction."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fixedpoint.carts import cart_acceleration, cart_bias, cart_force, cart_inertia
from naive import fixedpoint as naive
from stillwork.base.checks import InputError
from stillwork.control import (
    Controller,
    FlowTransformation,
    KinematicDesign,
    Mechanism,
    asin_trajectory,
    simulate,
    simulate_mechanism,
)
from stillwork.control.fixed_point import IntegrationWarning
from stillwork.control.fixed_point_convergence import stable_range
from stillwork.control.fixed_point_linear import linear_loop
from stillwork.control.mechanism import iteration_radius, response_gains, response_matrix
from stillwork.control.transformation import ContractionWarning, RobustTransformation, deform
from stillwork.estimation import LowPass, Plant
from stillwork.estimation.coordinate_filters import (
    ExtendedKalman,
    MovingWindow,
    SavitzkyGolay,
    UnscentedKalman,
)
from stillwork.estimation.filtering import UNIT_MASS, filter_signal

PUSHED = UnscentedKalman(UNIT_MASS)


def frictionless(model):
    return Mechanism(model.inertia, model.bias, 2, np.r_[model.parameters[:8], 0, 0, 0, 0, 1.0])


def lagrangian(q, v, numbers):
    """Kinetic minus potential energy of two bars, from the velocities of their centres; and their sum."""
    m1, c1, i1, l1, m2, c2, i2, g = numbers[:8]
    across = [np.array([-np.sin(a), np.cos(a)]) for a in (q[0], q[0] + q[1])]
    first = c1 * v[0] * across[0]
    second = l1 * v[0] * across[0] + c2 * (v[0] + v[1]) * across[1]
    kinetic = m1 * first @ first + m2 * second @ second + i1 * v[0] ** 2 + i2 * (v[0] + v[1]) ** 2
    potential = m1 * g * c1 * np.sin(q[0]) + m2 * g * (l1 * np.sin(q[0]) + c2 * np.sin(q[0] + q[1]))
    return kinetic / 2 - potential, kinetic / 2 + potential


def from_lagrangian(q, v, a, numbers, step=1e-4):
    """d/dt dL/dv - dL/dq by differences alone."""
    x = np.concatenate([q, v])

    def energy(point):
        return lagrangian(point[:2], point[2:], numbers)[0]

    def second(i, j):
        e, f = step * np.eye(4)[i], step * np.eye(4)[j]
        return (energy(x + e + f) - energy(x + e - f) - energy(x - e + f) + energy(x - e - f)) / (4 * step**2)

    def first(i):
        e = step * np.eye(4)[i]
        return (energy(x + e) - energy(x - e)) / (2 * step)

    return np.array(
        [
            sum(second(2 + i, 2 + j) * a[j] + second(2 + i, j) * v[j] for j in range(2)) - first(i)
            for i in range(2)
        ]
    )


@pytest.mark.slow
def test_the_arm_is_its_lagrangian_and_friction(arm, rng):
    for _ in range(20):
        q, v, a = rng.uniform(-3, 3, (3, 2))
        numbers = arm.exact.parameters
        friction = numbers[8:10] * v + numbers[10:12] * np.tanh(v / numbers[12])
        assert arm.exact.force(q, v, a) == pytest.approx(
            from_lagrangian(q, v, a, numbers) + friction, abs=1e-5
        )
        assert arm.exact.acceleration(q, v, arm.exact.force(q, v, a)) == pytest.approx(a)


@pytest.mark.slow
@pytest.mark.parametrize("integration", ["exact", "semi-implicit"])
def test_without_friction_and_torque_the_loop_keeps_the_energy_as_well_as_a_solver_finds_it(arm, integration):
    """Motors of no torque leave a double pendulum; the error of an Euler step is of the order of its sample time."""
    free = frictionless(arm.exact)
    start = np.array([[-1.0, 0.8], [0.0, 0.0]])
    energy = lagrangian(*start, free.parameters)[1]
    solved = solve_ivp(
        lambda _, x: np.r_[x[2:], free.acceleration(x[:2], x[2:], [0.0, 0.0])],
        (0, 1.0),
        start.ravel(),
        rtol=1e-10,
        atol=1e-12,
        dense_output=True,
    )
    assert lagrangian(solved.y[:2, -1], solved.y[2:, -1], free.parameters)[1] == pytest.approx(
        energy, rel=1e-8
    )
    errors = []
    for sample_time in (1e-3, 5e-4):
        still = asin_trajectory(duration=1.0, sample_time=sample_time)
        parts = Controller(LowPass(), RobustTransformation(), KinematicDesign(1.0), arm.approximate)
        runs = simulate_mechanism(
            free, parts, [still] * 2, start=start, force_limits=[1e-12] * 2, integration=integration
        )
        moved = np.array([[run.position, run.velocity] for run in runs])
        assert np.ptp(moved[0, 0]) > 0.5
        held = [lagrangian(*moved[:, :, i].T, free.parameters)[1] for i in range(0, moved.shape[2], 50)]
        at = solved.sol(still.time).reshape(2, 2, -1).swapaxes(0, 1)
        errors.append((np.abs(np.array(held) - energy).max(), np.abs(moved - at).max()))
    if integration == "exact":
        assert np.max(errors) < 1e-7
        return
    assert np.array(errors[0]) / np.array(errors[1]) == pytest.approx([2, 2], rel=0.1)
    assert errors[1][0] < 0.01 * abs(energy) and errors[1][1] < 0.02


FILTERS = [
    (MovingWindow(), FlowTransformation(-0.22)),
    (LowPass(), RobustTransformation()),
    (SavitzkyGolay(), RobustTransformation()),
    (PUSHED, RobustTransformation()),
    (ExtendedKalman(UNIT_MASS), RobustTransformation()),
]


@pytest.mark.parametrize("number", range(len(FILTERS)))
def test_uncoupled_coordinates_run_as_one_alone(number, short, rng):
    """With losses and with a limit of the force; the Kalman filters where their model is the believed mass alone."""
    device, transformation = FILTERS[number]
    numbers, guess = [2.0, 40.0, 0.7], [1.5, 0.0, 0.0]
    alone = device
    if hasattr(device, "plant"):
        alone = type(device)(Plant(cart_acceleration, cart_force, guess))
    many, one = (
        Controller(each, transformation, KinematicDesign(16.0), model)
        for each, model in (
            (device, Mechanism(cart_inertia, cart_bias, 2, guess)),
            (alone, Plant(cart_acceleration, cart_force, guess)),
        )
    )
    noise = 1e-5 * rng.standard_normal((2, len(short.position)))
    noise[:, 200:215] = np.nan
    plant = Mechanism(cart_inertia, cart_bias, 2, numbers)
    runs = simulate_mechanism(plant, many, [short] * 2, noise, force_limits=[30.0] * 2, resolution=1e-5)
    for run, added in zip(runs, noise, strict=True):
        want = simulate(
            Plant(cart_acceleration, cart_force, numbers),
            one,
            short,
            added,
            force_limit=30.0,
            resolution=1e-5,
        )
        assert np.abs(want.force).max() <= 30.0
        assert run.position == pytest.approx(want.position, abs=1e-9)
        assert run.force == pytest.approx(want.force, rel=1e-5, abs=1e-5)


def test_the_arm_runs_as_its_naive_twin(arm, short, rng):
    """Fig. 1 with vectors, by numpy alone."""
    noise = 1e-5 * rng.standard_normal((2, len(short.position)))
    controller = Controller(LowPass(), RobustTransformation(), KinematicDesign(16.0), arm.approximate)
    runs = simulate_mechanism(arm.exact, controller, [short] * 2, noise, integration="semi-implicit")
    transform, command = naive.robust(4e7, -1.05, 9e-2 / 4e7), None

    def answer(desired, response):
        nonlocal command
        if command is None:
            command = desired
        else:
            command = np.array([transform(*each) for each in zip(command, response, desired, strict=True)])
        return command

    nominal, gains = (short.position, short.velocity, short.acceleration), controller.kinematics.gains
    places, _ = naive.loop_of_coordinates(arm.exact, arm.approximate, gains, nominal, noise, 1e-3, answer)
    assert places == pytest.approx(np.array([run.position for run in runs]), abs=1e-7)


def test_a_response_is_what_the_plant_makes_of_a_command(arm, rng):
    for _ in range(10):
        q, v, a = rng.uniform(-2, 2, (3, 2))
        columns = []
        for direction in 1e-3 * np.eye(2):
            high, low = (
                arm.exact.acceleration(q, v, arm.approximate.force(q, v, a + s * direction)) for s in (1, -1)
            )
            columns.append((high - low) / 2e-3)
        response = response_matrix(arm.exact, arm.approximate, q)
        assert response == pytest.approx(np.array(columns).T, rel=1e-6, abs=1e-8)
        assert response_gains(arm.exact, arm.approximate, q) == pytest.approx(
            np.sort(np.linalg.eigvals(response).real)
        )


def test_iterations_contract_in_the_energy_norm_as_the_gains_say_and_grow_beyond(arm, rng):
    """By brute force: `deform` in each coordinate, the plant's answer, again."""
    q, v, wanted = np.array([0.4, 1.1]), np.array([0.3, -0.5]), np.array([1.0, -2.0])
    gains = response_gains(arm.exact, arm.approximate, q)
    root = np.linalg.cholesky(arm.exact.mass(q)).T
    for factor in (0.3, 0.9, 1.1):
        transformation = RobustTransformation(slope=factor * 2 / gains[-1] / (4e7 * 1.05))
        radius = np.abs(1 + transformation.local_gain * gains).max()
        assert (radius < 1) == (factor < 1)
        command, sizes = wanted + rng.standard_normal(2), []
        for _ in range(30):
            response = arm.exact.acceleration(q, v, arm.approximate.force(q, v, command))
            sizes.append(np.linalg.norm(root @ (response - wanted)))
            command = np.array(
                [deform(transformation, *each) for each in zip(command, response, wanted, strict=True)]
            )
        growth = np.array(sizes[1:]) / sizes[:-1]
        assert (growth < radius * (1 + 1e-5)).all()
        assert growth[-1] == pytest.approx(radius, rel=1e-3)


def test_stable_gains_of_the_whole_loop_are_those_with_which_it_settles(arm):
    """The arm at rest, kicked: decays with a gain inside the range, grows outside."""
    controller = Controller(
        PUSHED, RobustTransformation(), KinematicDesign(36.0), frictionless(arm.approximate)
    )
    plant, place = frictionless(arm.exact), np.array([0.4, 1.1])
    found = stable_range(linear_loop(plant, controller, 1e-3, place, np.zeros(2)))
    still = [asin_trajectory(1e-9, duration=1.5)] * 2
    still = [
        type(each)(1e-3, each.position + q, each.velocity, each.acceleration)
        for each, q in zip(still, place, strict=True)
    ]

    def grows(gain):
        moved = replace(controller, transformation=RobustTransformation(slope=-gain / (4e7 * 1.05)))
        runs = simulate_mechanism(plant, moved, still, start=np.array([place + 1e-6, [0.0, 0.0]]))
        speed = np.array([run.velocity for run in runs]) ** 2
        return runs[0].diverged_at is not None or speed[:, -300:].sum() > speed[:, 300:600].sum()

    low, high = found.limits
    assert not grows(0.95 * low) and not grows(1.05 * high)
    assert grows(1.05 * low) and grows(0.9 * high)


# -------------------------------------------------------------------------------- lost samples and limited forces


@pytest.mark.parametrize(
    ("number", "lost"), [(0, "hold"), (1, "predict"), (2, "predict"), (3, "hold"), (4, "predict")]
)
def test_what_stands_for_a_lost_sample_is_what_the_filter_gets(number, lost, exact, approximate, short, rng):
    """The filter alone, over the record that the loop says it measured."""
    device, transformation = FILTERS[number]
    if hasattr(device, "plant"):
        device = type(device)(approximate)
    noise = 1e-5 * rng.standard_normal(len(short.position))
    noise[300:320] = np.nan
    controller = Controller(device, transformation, KinematicDesign(16.0), approximate)
    run = simulate(exact, controller, short, noise, lost=lost)
    estimate = filter_signal(device, run.measured, run.force, start_velocity=short.velocity[0])
    if not isinstance(device, LowPass | MovingWindow | SavitzkyGolay):
        assert run.position_estimate == pytest.approx(estimate.position, abs=1e-9)
    part = slice(100, None)  # a window starts from the nominal acceleration in the loop
    assert run.velocity_estimate[part] == pytest.approx(estimate.velocity[part], abs=1e-7)
    gone = run.measured[300:320]
    if lost == "hold":
        assert (gone == run.measured[299]).all()
    elif hasattr(device, "plant"):
        assert np.isnan(gone).all() and np.isfinite(run.measured[320:]).all()
    else:
        assert np.diff(run.measured[299:320]) == pytest.approx(
            1e-3 * run.velocity_estimate[299:319], abs=1e-12
        )


def test_a_limited_force_does_not_wind_up(exact, approximate):
    """Off the trajectory at the start: the force stays at its limit, and the loop comes back without a swing."""
    controller = Controller(
        LowPass(from_zero=True), RobustTransformation(), KinematicDesign(16.0), approximate
    )
    long = asin_trajectory(duration=3.0)
    free, limited = (
        simulate(exact, controller, long, start=(0.15, 0.0), force_limit=f) for f in (None, 160.0)
    )
    assert np.abs(free.force).max() > 190.0 and np.abs(limited.force).max() == 160.0
    at = np.abs(limited.force) == 160.0
    assert 5 < at.sum() < 1500
    believed = [
        approximate.acceleration(q, v, u, approximate.parameters)
        for q, v, u in zip(
            limited.measured[at], limited.velocity_estimate[at], limited.force[at], strict=True
        )
    ]
    assert limited.deformed[at] == pytest.approx(believed)
    assert np.abs(limited.position_error[-500:]).max() < 1.05 * np.abs(free.position_error[-500:]).max()


def test_models_that_do_not_fit(arm, exact, approximate, short):
    parts = LowPass(), RobustTransformation(), KinematicDesign(16.0)
    with pytest.raises(InputError, match="simulate_mechanism"):
        simulate(exact, Controller(*parts, arm.approximate), short)
    with pytest.raises(InputError, match=r"\bsimulate\b"):
        simulate_mechanism(arm.exact, Controller(*parts, approximate), [short] * 2)
    wild = [asin_trajectory(duration=0.6), asin_trajectory(duration=0.5)]
    with pytest.raises(InputError, match=r"^trajectories\b"):
        simulate_mechanism(arm.exact, Controller(*parts, arm.approximate), wild)
    with pytest.raises(InputError, match=r"^inertia\b.*symmetric"):
        Mechanism(lopsided, cart_bias, 2, [1.0, 0.0, 0.0])
    with pytest.raises(InputError, match=r"^inertia or bias\b.*q = \[0\.3 0\.7\]"):
        Mechanism(lambda q, p, out: None, cart_bias, 2, [1.0, 0.0, 0.0])
    with pytest.raises(InputError, match=r"^inertia\b.*definite"):
        Mechanism(cart_inertia, cart_bias, 2, [-1.0, 0.0, 0.0]).mass([0.0, 0.0])


def lopsided(position, parameters, out):
    out[:] = 1.0
    out[0, 1] = 0.5


def test_divergence_and_its_cause_are_those_of_all_coordinates(arm, short):
    wild = Controller(PUSHED, RobustTransformation(slope=1e-7), KinematicDesign(36.0), arm.approximate)
    with pytest.warns(ContractionWarning):
        runs = simulate_mechanism(
            arm.exact, wild, [short] * 2, np.full((2, 600), 1e-4) * (np.arange(600) % 2)
        )
    assert runs[0].diverged_at == runs[1].diverged_at is not None
    assert "bound" in runs[0].cause


def test_each_coordinate_may_have_its_own_controller_noise_and_encoder():
    """Two masses that do not touch: each moves as it does alone."""

    def inertia(position, parameters, out):
        out[0, 0], out[1, 1], out[0, 1], out[1, 0] = parameters[0], parameters[1], 0.0, 0.0

    def bias(position, velocity, parameters, out):
        out[0], out[1] = parameters[2] * velocity[0], parameters[2] * velocity[1]

    both, believed = (
        Mechanism(inertia, bias, 2, [3.0, 0.5, 1.0]),
        Mechanism(inertia, bias, 2, [2.5, 0.6, 0.5]),
    )
    paths = [asin_trajectory(a, 0.9, 0.5, 2.0) for a in (0.1, 0.3)]
    settings = [(350.0, FlowTransformation(-2.0, 30.0), 12.0), (500.0, FlowTransformation(-1.0, 20.0), 8.0)]
    chosen = [Controller(LowPass(width), t, KinematicDesign(x), believed) for width, t, x in settings]
    noise = 1e-5 * np.random.default_rng(2).standard_normal((2, len(paths[0].position)))
    encoders = {"resolution": [1e-5, 3e-5], "grid": [0.0, 1e-5]}
    found = simulate_mechanism(both, chosen, paths, noise, **encoders)

    def single(mass, drag):
        return Plant(
            lambda q, v, f, p: (f - p[1] * v) / p[0], lambda q, v, a, p: p[0] * a + p[1] * v, [mass, drag]
        )

    for number, (mass, guess) in enumerate(((3.0, 2.5), (0.5, 0.6))):
        own = {name: values[number] for name, values in encoders.items()}
        alone = replace(chosen[number], model=single(guess, 0.5))
        run = simulate(single(mass, 1.0), alone, paths[number], noise[number], **own)
        assert np.abs(found[number].position - run.position).max() < 1e-9
        assert np.abs(run.position - paths[number].position).max() > 1e-6
    still = [0.0, 0.0]
    loop = linear_loop(both, chosen, 1e-3, still, still)
    radii = []
    for number, (mass, guess) in enumerate(((3.0, 2.5), (0.5, 0.6))):
        alone = replace(chosen[number], model=single(guess, 0.5))
        radii.append(linear_loop(single(mass, 1.0), alone, 1e-3).radius(alone.transformation.local_gain))
    assert loop.radius(chosen[0].transformation.local_gain) == pytest.approx(max(radii), abs=1e-9)
    gains = np.array([each.transformation.local_gain for each in chosen])
    radius = np.abs(1 + gains * [2.5 / 3.0, 0.6 / 0.5]).max()
    assert iteration_radius(both, believed, still, gains) == pytest.approx(radius)
    strong = [chosen[0], replace(chosen[1], transformation=FlowTransformation(-36.0, 20.0))]  # 1 - 1.8 * 1.2
    with pytest.warns(ContractionWarning, match=r"spectral radius of 1\.16\b"):
        simulate_mechanism(both, strong, paths, noise)


@pytest.mark.slow
def test_a_payload_and_disturbances_move_the_arm_as_a_solver_does(arm):
    path = asin_trajectory(amplitude=0.2, frequency_hz=0.5, duration=0.2)
    push = np.random.default_rng(1).normal(size=(2, len(path.position)))
    loaded = Mechanism(arm.exact.inertia, arm.exact.bias, 2, 1.2 * arm.exact.parameters)
    controller = Controller(LowPass(), FlowTransformation(-0.1, 10.0), KinematicDesign(8.0), arm.approximate)
    change = 0.1, loaded.parameters
    runs = simulate_mechanism(arm.exact, controller, [path] * 2, disturbance=push, change=change)
    motion = np.array([[run.position, run.velocity] for run in runs])
    for i in range(1, 190, 21):
        plant, force = loaded if i >= 100 else arm.exact, [run.force[i] for run in runs] + push[:, i]
        state = solve_ivp(
            lambda t, x, plant=plant, force=force: np.r_[x[2:], plant.acceleration(x[:2], x[2:], force)],
            (0, path.sample_time),
            motion[:, :, i].T.ravel(),
            rtol=1e-10,
            atol=1e-13,
        ).y[:, -1]
        assert motion[:, :, i + 1].T.ravel() == pytest.approx(state, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize(("stiffness", "turns"), [(4.4e4, False), (4.6e4, True)])
def test_a_long_euler_step_of_a_mode_is_reported(stiffness, turns, short, recwarn):
    """Two unit masses with a spring between them turn by (2 k)^(1/2) 1e-3 s a sample, against each other."""
    masses = Mechanism(cart_inertia, spring, 2, [1.0, stiffness])
    parts = Controller(LowPass(), RobustTransformation(), KinematicDesign(16.0), masses)
    simulate_mechanism(masses, parts, [short] * 2, integration="semi-implicit")
    simulate_mechanism(masses, parts, [short] * 2)
    assert [each.category for each in recwarn] == [IntegrationWarning] * turns


def spring(position, velocity, parameters, out):
    out[0] = parameters[1] * (position[0] - position[1])
    out[1] = -out[0]
