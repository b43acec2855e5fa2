"""The closed loop's kernel against its slow twin, and the promises of `simulate`."""

import dataclasses

import numpy as np
import pytest
from scipy import signal

from experiments.isolation import simulation as module
from experiments.isolation.floors import coloured_floor, flat_floor
from experiments.isolation.recorded_floors import RecordedFloor
from experiments.isolation.simulation import simulate, simulate_together
from experiments.isolation.sources import Sources
from experiments.isolation.twin import load_twin
from naive import closed_loop
from stillwork.estimation.adaptive import FeLms, FeRls
from stillwork.estimation.online import UnstableAdaptation

SAMPLES = 300


def rigs():
    rigid, fitted = load_twin("rigid_body"), load_twin("fitted")
    return {
        "rigid": rigid,
        "fitted": fitted,
        "one integrator": fitted.varied(integrator_powers=1),
        "no integrator": fitted.varied(integrator_powers=0),
        "order 2": rigid.varied(integrator_order=2, integrator_cutoff_hz=0.5),
    }


RIGS = rigs()


def record(twin, seed=0, samples=SAMPLES):
    rng = np.random.default_rng(seed)
    floor = 0.02 * rng.standard_normal((twin.sensors, samples))
    return RecordedFloor(floor, twin.instruments.sample_rate, "white")


@pytest.mark.slow
@pytest.mark.parametrize("name", RIGS)
@pytest.mark.parametrize(
    "case",
    ["passive", "feedback", "frozen", "felms", "ferls", "felms late 2", "ferls late 0", "ferls late 3"],
)
def test_kernel_agrees_with_its_slow_twin(name, case):
    twin = RIGS[name]
    rng = np.random.default_rng(5)
    start = 0.1 * rng.standard_normal((twin.actuators, twin.regressors))
    floor = record(twin)
    options, slow = {}, {}
    if case == "passive":
        options["feedback"] = slow["feedback"] = False
    kind, _, late = case.partition(" late ")
    delay = int(late) if late else None
    if kind in ("frozen", "felms", "ferls"):
        options["weights"] = slow["weights"] = start
        slow["path_delay"] = delay
    if kind == "felms":
        options["adaptation"] = FeLms(step_size=1e-3, trace="literal", path_delay=delay)
        slow["felms"] = (1e-3, 1e-5, twin.actuators)
    if kind == "ferls":
        options["adaptation"] = FeRls(0.3, growth_limit=np.inf, path_delay=delay)
        slow["ferls"] = (0.3 * np.eye(twin.regressors), options["adaptation"].forgetting)
    run = simulate(twin, floor, seed=3, keep_every_s=2e-4, signals_from_s=0.0, **options)
    source = Sources(twin, [(SAMPLES, floor)], True, [3])
    moved, noise = source.sample(SAMPLES)
    expected = closed_loop.run(twin, moved[:, 0], np.concatenate(noise, axis=2)[:, 0], **slow)
    for got, wanted in (
        (run.platform, expected["platform"]),
        (run.measured_platform, expected["measured"]),
        (run.sensed_floor, expected["sensed"]),
        (run.command, expected["command"]),
        (run.filtered_regressors, expected["psi_n"]),
        (run.error, expected["error"]),
    ):
        assert np.max(np.abs(got.T - wanted)) <= 1e-9 * np.max(np.abs(wanted))
    assert np.max(np.abs(run.weights - expected["weights"])) <= 1e-9 * np.max(np.abs(start))
    assert run.error_power == pytest.approx(np.sum(expected["error"] ** 2, axis=1), rel=1e-7, abs=1e-20)


def test_sources_are_white_noise_through_the_floor_and_the_mains():
    twin, floor, seeds, count = RIGS["fitted"], flat_floor(80.0), [3, 8], 1500
    moved, noises = Sources(twin, [(count, floor)], True, seeds, 4).sample(count)
    noise = np.concatenate(noises, axis=2)
    instruments, rate = twin.instruments, twin.instruments.sample_rate
    for place, seed in enumerate([*seeds, 8, 8]):
        first, second = (
            np.random.Generator(np.random.SFC64(each)) for each in np.random.SeedSequence(seed).spawn(2)
        )
        white = (first.standard_normal((count, 3)) * floor.scale).T
        shaken = [signal.sosfilt(rows, row) for rows, row in zip(floor.sections, white, strict=True)]
        assert np.abs(moved[:, place].T - shaken).max() < 1e-12 * np.abs(shaken).max()
        sensors = second.standard_normal((count, twin.outputs + 3))
        for k, column in enumerate(noise[:, place].T):
            ours = k < twin.outputs
            density = instruments.platform_noise if ours else instruments.floor_noise
            lines = instruments.platform_mains if ours else instruments.floor_mains
            expected = density * np.sqrt(rate / 2) * sensors[:, k]
            for frequency, size in zip(instruments.mains_hz, lines, strict=True):
                expected = expected + size * np.sin(2 * np.pi * frequency * np.arange(count) / rate)
            assert np.abs(column - expected).max() < 1e-12 * np.abs(expected).max()


@pytest.mark.slow
def test_run_does_not_depend_on_its_blocks(monkeypatch):
    twin = RIGS["rigid"]
    floors = [(0.7, flat_floor(80.0)), (0.4, record(twin, samples=2500)), (0.3, flat_floor(1500.0))]
    options = {"adaptation": FeRls(0.5), "seed": 4, "keep_every_s": 0.0302, "signals_from_s": 0.5}
    whole = simulate(twin, floors, **options)
    monkeypatch.setattr(module, "BLOCK", 97)
    parts = simulate(twin, floors, **options)
    # The mains' sines start anew in each block, which rounds differently.
    assert parts.weights == pytest.approx(whole.weights, abs=1e-10)
    assert parts.error_power == pytest.approx(whole.error_power, rel=1e-9)
    assert parts.floor == pytest.approx(whole.floor, abs=1e-15)
    assert parts.platform == pytest.approx(whole.platform, abs=1e-11)
    assert whole.time_s[-1] == pytest.approx(46 * 0.0302)
    assert whole.floor.shape[1] == 7000 - 2500


def test_same_seed_same_floor_whatever_the_controller_does():
    twin, floor = RIGS["fitted"], flat_floor(80.0)
    runs = [
        simulate(twin, floor, 1.0, seed=7, signals_from_s=0.0, **options)
        for options in ({}, {"feedback": False}, {"adaptation": FeLms()}, {"noise": False})
    ]
    for other in runs[1:]:
        assert np.array_equal(runs[0].floor, other.floor)
    assert not np.array_equal(runs[0].floor, simulate(twin, floor, 1.0, seed=8, signals_from_s=0.0).floor)


def test_algorithms_side_by_side_run_as_each_alone():
    twin, floors = RIGS["fitted"], [(0.9, flat_floor(80.0)), (0.6, coloured_floor(80.0))]
    adaptations = {"FeLMS": FeLms(), "FeRLS": FeRls(np.full(9, 1e-3), 0.9999), "none": None}
    weights = np.full((6, 9), 0.01)
    together = simulate_together(twin, floors, adaptations=adaptations, weights=weights, seeds=[7])[0]
    for name, adaptation in adaptations.items():
        alone = simulate(twin, floors, adaptation=adaptation, weights=weights, seed=7)
        assert np.array_equal(together[name].weights, alone.weights)
        assert np.array_equal(together[name].error_power, alone.error_power)
        assert np.array_equal(together[name].covariance, alone.covariance)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fitted", "order 2"])
def test_seeds_side_by_side_run_as_each_alone(name):
    twin, floors = RIGS[name], [(0.5, flat_floor(80.0)), (0.2, coloured_floor(80.0))]
    held = FeRls(np.full(9, 1e-3), 0.999, growth_limit=1.0)  # its limit acts in every run
    adaptations = {"FeLMS": FeLms(trace="literal"), "FeRLS": held, "none": None}
    adaptations |= (
        {"UD": FeRls(1e-3, form="UD"), "single": FeRls(1e-3, dtype="float32")} if name == "fitted" else {}
    )
    options = {"weights": np.full((6, 9), 0.01), "keep_every_s": 0.0302, "signals_from_s": 0.6}
    seeds = [7, 11, 3, 7, 5, 2, 9, 1, 4]  # a second batch of one
    together = simulate_together(twin, floors, adaptations=adaptations, seeds=seeds, **options)
    assert len(together) == len(seeds) and together[0]["FeRLS"].held.min() > 0.1
    for runs, seed in zip(together, seeds, strict=True):
        for name, adaptation in adaptations.items():
            alone = simulate(twin, floors, adaptation=adaptation, seed=seed, **options)
            for field in dataclasses.fields(alone):
                assert np.array_equal(getattr(runs[name], field.name), getattr(alone, field.name)), field.name


def test_seeds_side_by_side_take_weights_of_their_own_and_keep_what_is_asked_for():
    twin, floor, seeds = RIGS["fitted"], flat_floor(80.0), [3, 8, 1]
    weights = [np.full((6, 9), 0.01 * k) for k in seeds]
    options = {"adaptations": {"": FeLms()}, "signals_from_s": 0.3, "signals": ("command", "floor")}
    together = simulate_together(twin, floor, 0.5, seeds=seeds, weights=weights, **options)
    for runs, seed, start in zip(together, seeds, weights, strict=True):
        alone = simulate(twin, floor, 0.5, seed=seed, weights=start, adaptation=FeLms(), signals_from_s=0.3)
        for name in ("command", "floor", "weights", "final_weights"):
            assert np.array_equal(getattr(runs[""], name), getattr(alone, name)), name
        assert runs[""].platform.shape == (6, 0) and alone.platform.shape == (6, 1000)


def test_without_noise_the_loop_is_linear_in_the_floor():
    twin = RIGS["rigid"]
    one, two = record(twin, 1), record(twin, 2)
    both = RecordedFloor(2 * one.acceleration - 3 * two.acceleration, one.sample_rate, "mixed")
    platform = [simulate(twin, floor, noise=False, signals_from_s=0.0).platform for floor in (one, two, both)]
    assert platform[2] == pytest.approx(2 * platform[0] - 3 * platform[1], abs=1e-12)


@pytest.mark.parametrize(
    ("gain", "options", "message"),
    [
        (1e5, {}, "skyhook"),
        (
            1.0,
            {"weights": np.full((6, 9), 1e6)},
            "weights",
        ),
        (1.0, {"adaptation": FeLms(step_size=0.5)}, "step_size"),
        (1.0, {"adaptation": FeRls(1e8, 0.999)}, "initial_covariance.*high-pass"),
    ],
)
def test_divergence_blames_what_moved_the_platform(gain, options, message):
    with pytest.raises(UnstableAdaptation, match=message):
        simulate(RIGS["fitted"].varied(gain=gain), flat_floor(80.0), 30.0, **options)
