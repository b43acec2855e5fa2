"""The error budget against Lyapunov equations, python-control with quad, and simulations sample by sample."""

from itertools import pairwise

import control as ct
import numpy as np
import pytest
from scipy import integrate, linalg, signal

from stillwork import control, lti, signals
from stillwork.control.budget import box_band, box_places
from stillwork.control.budget_sources import (
    criterion_floor,
    measured,
    periodic,
    quantiser,
    setpoint,
    shaped,
    tabulated,
    white,
)
from stillwork.control.floor_machine import FloorMachine, weak_integrator
from stillwork.control.uncertainty import perturbed_plant
from stillwork.lti.state_space import StateModel, constant

NOISE = 5e-8  # m/sqrt(Hz), as large as the floor's part in the simulations


def chain(seed: int, modes: int = 3) -> lti.ModalModel:
    """A free stage of 20 kg with random flexible modes that a PID of a modest bandwidth does not disturb."""
    rng = np.random.default_rng(seed)
    frequencies = np.append(0.0, np.sort(2 * np.pi * rng.uniform(300, 900, modes)))
    shape = np.append(20**-0.5, rng.uniform(-0.05, 0.05, modes))
    return lti.ModalModel(
        frequencies, np.append(0.0, np.full(modes, 0.02)), shape[:, None], shape[None], np.zeros((1, 1))
    )


def machine(seed: int = 0, sample_time: float = 0.0, delay: float = 0.0, **changed) -> FloorMachine:
    stage = chain(seed)
    settings = {"skyhook": 0.6, "skyhook_hz": 1.0, "feedforward": 0.9} | changed
    bandwidth = 9.0 if sample_time else 30.0
    return FloorMachine(
        24.0,
        12.0,
        0.04,
        stage,
        control.PidFamily(20.0)(bandwidth),
        sample_time=sample_time,
        delay=delay,
        **settings,
    )


def low_pass(hertz: float, level: float) -> StateModel:
    """Third order, so that what it makes has an end."""
    a, b, c, d = signal.tf2ss(level * np.ones(1), np.poly(-np.ones(3)))
    w = 2 * np.pi * hertz
    return StateModel(a * w, b * w, c, d)


def band_pass(level: float) -> StateModel:
    """From 4 to 60 Hz, in states of one size."""
    a, b, c, d = signal.zpk2ss(
        *signal.butter(3, np.array([4.0, 60.0]) / 30, "bandpass", analog=True, output="zpk")
    )
    w = 2 * np.pi * 30
    return StateModel(a * w, b * w, level * c, level * d)


def held(a: np.ndarray, b: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
    n, m = b.shape
    whole = linalg.expm(np.block([[a * t, b * t], [np.zeros((m, n + m))]]))
    return whole[:n, :n], whole[:n, n:]


@pytest.mark.parametrize("delay", [0.0, 1.0, 0.3, 2.6])
def test_a_sampled_loop_has_the_variance_of_its_lifted_covariance(delay):
    """Noise of samples and a coloured floor; the covariance between samples by Gauss nodes on exact transitions."""
    ts, n_quad = 1 / 500, 12
    built = machine(0, sample_time=ts, delay=delay)
    network = built.network()
    colour = band_pass(1e-3)
    floor = shaped("floor", ("floor",), "m/s^2", colour)
    noise = white("noise", "stage sensor", "m", 1e-9)
    budget = control.error_budget(network, [floor, noise], (1e-2, 2e3))
    # Plant with the floor's filter: x' = A x + B_w w + B_u u; a controller behind a line of whole delays and an old command.
    plant, k = network.plant, network.controller
    n, m = len(plant.a), len(colour.a)
    a = np.block([[plant.a, plant.b[:, :1] @ colour.c], [np.zeros((m, n)), colour.a]])
    bu = np.vstack([plant.b[:, 4:], np.zeros((m, 2))])
    bw = np.vstack([np.zeros((n, 1)), colour.b])
    c = np.hstack([plant.c, plant.d[:, :1] @ colour.c])
    s = linalg.matrix_balance(a, permute=False, separate=True)[1][0]
    a, bu, bw, c = a / s[:, None] * s, bu / s[:, None], bw / s[:, None], c * s
    whole, late = int(delay), delay - int(delay)
    lines = whole + 1  # commands that are kept
    nk, np_ = len(k.a), n + m
    size = np_ + nk + 2 * lines

    def moved(t):  # transition of the plant over t with the old command until late, and the noise on the way
        t1, t2 = min(t, late * ts), max(t - late * ts, 0)
        g1 = held(a, bu, t1)[1]
        f2, g2 = held(a, bu, t2)
        q = np.block([[-a, bw @ bw.T], [np.zeros_like(a), a.T]])
        e = linalg.expm(q * t)
        phi = e[np_:, np_:].T
        return phi, f2 @ g1, g2, phi @ e[:np_, np_:]

    state = np.eye(size)
    xs, xk = state[:np_], state[np_ : np_ + nk]
    pasts = [state[np_ + nk + 2 * i : np_ + nk + 2 * i + 2] for i in range(lines)]  # newest first
    y = c[2:] @ xs + plant.d[2:, 4:] @ pasts[-1]  # before a command changes
    u_now, v_u = k.c @ xk + k.d @ y, k.d[:, :1]
    acts, acts_v = (pasts[whole - 1], np.zeros((2, 1))) if whole else (u_now, v_u)

    def plant_at(t):
        phi, old, new, q = moved(t)
        return phi @ xs + old @ pasts[-1] + new @ acts, new @ acts_v, q

    top, top_v, q = plant_at(ts)
    step = np.vstack([top, k.a @ xk + k.b @ y, u_now, *pasts[:-1]])
    step_v = np.vstack([top_v, k.b[:, :1], v_u, np.zeros((2 * lines - 2, 1))])
    drive = np.zeros((size, size))
    drive[:np_, :np_] = q
    variance = 1e-18 * (1 / ts) / 2  # of the samples: one-sided density times half the rate
    nodes, weights = np.polynomial.legendre.leggauss(n_quad)
    for row, sensor in enumerate((False, True)):
        cov = linalg.solve_discrete_lyapunov(step, variance * step_v @ step_v.T if sensor else drive)
        total = 0.0
        pieces = [(0, late * ts), (late * ts, ts)] if late else [(0, ts)]
        for low, high in pieces:
            for node, weight in zip(nodes, weights, strict=True):
                t = low + (high - low) * (node + 1) / 2
                x, x_v, q = plant_at(t)
                value = c[0] @ (x @ cov @ x.T + (variance * x_v @ x_v.T if sensor else q)) @ c[0]
                total += weight / 2 * (high - low) / ts * value
        total -= 1e-18 * 1e-2 if sensor else 0  # below the band the stage follows its sensor
        assert budget.powers[row, 0] == pytest.approx(total, rel=2e-6, abs=0)


def test_python_control_and_quad_give_the_same():
    """python-control connects and responds, SciPy integrates: floor, sensor and a periodic force."""
    built = machine(1)
    network = built.network()
    level = lambda f: 1e-6 / (1 + (f / 20) ** 2)  # noqa: E731
    sources = [
        control.Source("floor", ("floor",), "m/s^2", level),
        white("sensor", "stage sensor", "m", 1e-9),
        control.Source("hum", ("stage force",), "N", tones=((50.0, 0.02),)),
    ]
    budget = control.error_budget(network, sources, (0.1, 3000.0))
    plant, law = (ct.ss(m.a, m.b, m.c, m.d) for m in (network.plant, network.controller))
    loop = ct.ss(*_connected(plant, law))

    def response(f, place):
        return ct.frequency_response(loop, [2 * np.pi * f]).fresp[0, place, 0]

    points = np.abs(loop.poles().imag) / (2 * np.pi)
    points = sorted(points[(points > 0.1) & (points < 3000)])
    edges = np.unique(np.concatenate([np.geomspace(0.1, 3000, 40), points]))
    for row, (place, density) in enumerate([(0, level), (4, lambda f: 1e-18)]):

        def power(f, place=place, density=density):
            return abs(response(f, place)) ** 2 * density(f)

        parts = [
            integrate.quad(power, *pair, epsrel=1e-9, epsabs=0, limit=200)[0] for pair in pairwise(edges)
        ]
        whole = sum(parts)
        assert budget.powers[row, 0] == pytest.approx(whole, rel=1e-7, abs=0)
    assert budget.powers[2, 0] == pytest.approx(abs(response(50.0, 1)) ** 2 * 0.02**2 / 2, rel=1e-9, abs=0)
    assert budget.rms[0] ** 2 == pytest.approx(budget.powers[:, 0].sum(), rel=1e-12)
    np.testing.assert_allclose(budget.cumulative()[:2, :, 0], budget.powers[:2], rtol=1e-12)


def _connected(plant, law):
    """u = K (y + v) + n around the plant by hand, from floor, forces, sensors and drives to the errors."""
    bw, bu, cz, cy = plant.B[:, :4], plant.B[:, 4:], plant.C[:2], plant.C[2:]
    dzw, dzu, dyw, dyu = plant.D[:2, :4], plant.D[:2, 4:], plant.D[2:, :4], plant.D[2:, 4:]
    assert not np.any(law.D)
    a = np.block([[plant.A, bu @ law.C], [law.B @ cy, law.A + law.B @ dyu @ law.C]])
    b = np.block([[bw, np.zeros((len(bw), 3)), bu], [law.B @ dyw, law.B, law.B @ dyu]])
    return a, b, np.hstack([cz, dzu @ law.C]), np.hstack([dzw, np.zeros((2, 3)), dzu])


def simulate(network, floor: np.ndarray, noise: np.ndarray, step: float, every: int) -> np.ndarray:
    """Sample by sample, a row per run: the plant in `every` small steps, the floor held, the law once, one sample late."""
    plant, law = network.plant, network.controller
    a, b = held(plant.a, plant.b, step)
    runs = len(floor)
    x, z, u, new = (np.zeros((size, runs)) for size in (len(a), len(law.a), 2, 2))
    error = np.empty(floor.shape)
    for k in range(floor.shape[1]):
        shake = np.vstack([floor[:, k], np.zeros((3, runs))])
        if k % every == 0:
            y = plant.c[2:] @ x + plant.d[2:] @ np.vstack([shake, u])
            y[0] += noise[:, k // every]
            u, new = new, law.c @ z + law.d @ y
            z = law.a @ z + law.b @ y
        error[:, k] = plant.c[0] @ x
        x = a @ x + b @ np.vstack([shake, u])
    return error


@pytest.mark.slow
def test_simulations_lie_in_the_stated_interval():
    """100 records of 4 s, sample by sample: at least 90 in the interval of 95 % (fewer by chance: 1.1 %)."""
    rate, every, seconds = 500.0, 4, 4.0
    network = machine(2, sample_time=1 / rate, delay=1.0, feedforward=0.9).network()
    fine = rate * every
    # A floor that changes at each fine step and is held: white of density S below the fine rate, through a filter.
    sos = signal.butter(2, [4, 60], "bandpass", fs=fine, output="sos")
    level = 1e-3

    def density(f):
        _, h = signal.freqz_sos(sos, f, fs=fine)
        return level**2 * np.abs(h) ** 2 * np.sinc(f / fine) ** 2

    budget = control.error_budget(
        network,
        [control.Source("floor", ("floor",), "m/s^2", density), white("noise", "stage sensor", "m", NOISE)],
        (0.05, fine / 2),
    )
    low, high = budget.interval(0.95, duration=seconds)[:, 0]
    rng, samples = np.random.default_rng(0), int((seconds + 2) * fine)
    floor = signal.sosfilt(sos, rng.standard_normal((100, samples))) * level * np.sqrt(fine / 2)
    noise = rng.standard_normal((100, samples // every)) * NOISE * np.sqrt(rate / 2)
    error = simulate(network, floor, noise, 1 / fine, every)[:, int(2 * fine) :]
    found = np.sqrt(np.mean(error**2, axis=1))
    inside = np.count_nonzero((found >= low) & (found <= high))
    assert 0.25 < budget.shares[1, 0] < 0.75 and 90 <= inside < 100


def test_welch_estimates_carry_their_interval_to_the_total():
    """A floor known from a record of a minute: the truth lies in the interval of 95 % in about 95 of 100 records."""
    network, rate = machine(0).network(), 400.0
    sos = signal.butter(2, [4, 60], "bandpass", fs=rate, output="sos")
    truth = lambda f: 2 / rate * np.abs(signal.freqz_sos(sos, f, fs=rate)[1]) ** 2 * 1e-6  # noqa: E731
    true = control.error_budget(network, [control.Source("f", ("floor",), "m/s^2", truth)], (0.5, 199.0)).rms[
        0
    ]
    hits = 0
    for seed in range(100):
        record = signal.sosfilt(sos, np.random.default_rng(seed).standard_normal(int(60 * rate))) * 1e-3
        spectrum = signals.estimate_spectrum(record, rate, 0.5)
        low, high = control.error_budget(
            network, [measured("f", "floor", "m/s^2", spectrum)], (0.5, 199.0)
        ).interval()[:, 0]
        hits += low <= true <= high
    assert 90 <= hits < 100


def test_correlated_sources_are_one_source_through_the_sum_of_their_paths():
    network = machine(0).network()
    colour = low_pass(40, 1.0)
    both = lti.interconnect([colour], np.zeros((1, 1)), np.ones((1, 1)), np.array([[2e-2], [-3e-2]]))
    forces = shaped("forces", ("stage force", "frame force"), "N", both)
    budget = control.error_budget(network, [forces], (0.01, 1e5))
    f = budget.frequencies_hz
    path = network.paths(f)
    single = (
        2
        * np.abs(colour.frequency_response(2 * np.pi * f)[0, 0] * (2e-2 * path[0, 1] - 3e-2 * path[0, 2]))
        ** 2
    )
    np.testing.assert_allclose(budget.density[0, 0], single, rtol=1e-9, atol=1e-12 * single.max())


def test_moving_average_and_deviation_and_peak_are_those_of_records():
    network = machine(1).network()
    level = lambda f: 1e-6 * (f < 300) * (f > 2)  # noqa: E731
    floor = control.Source("floor", ("floor",), "m/s^2", level, (2.0, 300.0), np.array([2.0, 300.0]))
    budget = control.error_budget(network, [floor], (0.5, 400.0))
    rng, rate, samples = np.random.default_rng(5), 2000.0, 100_000
    f = np.fft.rfftfreq(samples, 1 / rate)
    size = np.zeros(len(f))  # lines of fixed size and random phase: every whole record has the same powers
    size[1:] = np.abs(network.paths(f[1:])[0, 0]) * np.sqrt(level(f[1:]) * rate * samples / 2)
    averages, deviations, peaks = [], [], []
    for _ in range(20):
        error = np.fft.irfft(size * np.exp(2j * np.pi * rng.random(len(f))), samples)
        found = signals.moving(np.append(error, error[:39]), 1 / rate, 0.02)
        averages.append(np.mean(found.average**2)), deviations.append(np.mean(found.deviation**2))
        peaks += list(np.abs(error.reshape(5, -1)).max(axis=1))
    average, deviation = budget.moving(0.02)
    assert np.sqrt(np.mean(averages)) == pytest.approx(average[0], rel=0.01, abs=0)
    assert np.sqrt(np.mean(deviations)) == pytest.approx(deviation[0], rel=0.01, abs=0)
    assert average[0] ** 2 + deviation[0] ** 2 == pytest.approx(budget.rms[0] ** 2)
    assert np.mean(peaks) == pytest.approx(budget.peak(10.0)[0], rel=0.06, abs=0)


def test_a_tone_through_a_sampled_loop_leaves_its_images():
    """A force beyond half the rate: its lines against a simulation in small steps, all of them together."""
    rate, every = 250.0, 16
    network = machine(0, sample_time=1 / rate, delay=1.0).network()
    fine = rate * every
    t = np.arange(int(4 * fine)) / fine
    tone = np.minimum(t / 1.5, 1) * 40.0 * np.sin(2 * np.pi * 205.0 * t)
    hum = control.Source("hum", ("floor",), "m/s^2", tones=((205.0, 40.0),))
    budget = control.error_budget(network, [hum], (0.5, fine / 2))
    error = simulate(network, tone[None], np.zeros((1, len(t))), 1 / fine, every)[0, -int(fine) :]
    assert np.mean(error**2) == pytest.approx(
        budget.rms[0] ** 2, rel=0.02, abs=0
    )  # the simulation holds the floor


def there_and_back(samples: int) -> np.ndarray:
    """A stroke of 10 mm by a polynomial of seventh degree, a rest, and back."""
    way = np.clip(np.arange(samples // 2) / (0.35 * samples), 0, 1)
    stroke = 0.01 * way**4 * (35 - 84 * way + 70 * way**2 - 20 * way**3)
    return np.concatenate([stroke, stroke[-1] - stroke])


@pytest.mark.parametrize("advance", [0.0, 1.5])
def test_a_setpoint_leaves_what_a_simulation_leaves(advance):
    """A feedforward of 95 % of the mass, held and a sample late: the waveform between the samples, and its mean square."""
    rate, every, samples = 500.0, 8, 400
    network = machine(1, sample_time=1 / rate, delay=1.0, feedforward=0.0).network()
    period = there_and_back(samples)
    scan = setpoint("scan", period, rate, 19.0, advance / rate)
    lines = np.fft.rfft(period)
    lines[0] = 0  # a constant offset leaves nothing
    fine = np.fft.irfft(lines, samples * every) * every
    omega = 2 * np.pi * np.arange(len(lines)) * rate / samples
    lines[-1] = 0  # half the rate, whose phase is not known
    push = np.fft.irfft(-19.0 * omega**2 * lines * np.exp(1j * omega * advance / rate), samples)
    plant, law, step = network.plant, network.controller, 1 / (rate * every)
    a, b = held(plant.a, plant.b, step)
    x, z, u, new = np.zeros(len(a)), np.zeros(len(law.a)), np.zeros(2), np.zeros(2)
    error = np.zeros(8 * samples * every)
    for k in range(len(error)):
        r = fine[k % len(fine)]
        if k % every == 0:
            y = plant.c[2:] @ x + plant.d[2:, 4:] @ u - [r, 0, 0]
            u = new
            new = law.c @ z + law.d @ y + [push[k // every % samples], 0]
            z = law.a @ z + law.b @ y
        error[k] = plant.c[0] @ x + plant.d[0, 4:] @ u - r
        x = a @ x + b @ np.concatenate([np.zeros(4), u])
    last = error[-samples * every :]
    band = (0.1, 2000.0)
    found = control.tone_response(network, scan, np.arange(samples * every) * step, band)[0]
    assert np.ptp(last) > 1e-6 and np.abs(found - last).max() < 3e-3 * np.abs(last).max()
    rms = control.error_budget(network, [scan], band).rms[0]
    assert rms == pytest.approx(last.std(), rel=1e-3, abs=0)


def test_a_perfect_feedforward_of_a_rigid_stage_leaves_the_reaction_of_the_frame():
    """In continuous time, without modes: nothing is left but what the frame does, which the relative position holds."""
    rigid = lti.ModalModel(*map(np.array, ([0.0], [0.0], [[20**-0.5]], [[20**-0.5]], [[0.0]])))
    heavy = FloorMachine(24e9, 12.0, 0.04, rigid, control.PidFamily(20.0)(30.0)).network()
    period = there_and_back(400)
    left = [
        control.error_budget(heavy, [setpoint("scan", period, 500.0, mass)], (0.1, 200.0)).rms[0]
        for mass in (20.0, 19.0, 0.0)
    ]
    assert left[0] < 1e-6 * left[2] and left[1] == pytest.approx(0.05 * left[2], rel=1e-6)


def test_a_periodic_signal_keeps_its_power_and_a_quantiser_its_variance():
    signal_ = np.random.default_rng(0).standard_normal(64)
    source = periodic("p", "stage force", "N", signal_, 640.0)
    assert sum(a**2 / 2 for _, a in source.tones) == pytest.approx(np.var(signal_))
    assert quantiser("q", "stage sensor", "m", 1e-9, 5000.0)._at(np.array([1.0]))[
        0, 0, 0
    ].real * 2500 == pytest.approx(1e-18 / 12)


def test_a_weak_integrator_is_the_printed_one():
    f = np.geomspace(0.01, 100, 50)
    s, a = 2j * np.pi * f, 2 * np.pi * 2
    np.testing.assert_allclose(
        weak_integrator(2.0, 3).frequency_response(2 * np.pi * f)[0, 0],
        (1 - (a / (s + a)) ** 3) / s,
        rtol=1e-9,
    )


def test_a_source_that_ends_in_the_band_shows_its_share_at_the_edge():
    network = machine(0).network()
    f = np.linspace(5, 100, 96)
    cut = tabulated("cut", "floor", "m/s^2", f, np.full(96, 1e-6))
    whole = white("whole", "stage sensor", "m", 1e-9)
    edges = control.error_budget(network, [cut, whole], (0.5, 400.0)).edges()
    assert edges[0, 0] > 0.02 > edges[0, 1] > 0 and not edges[1].any()


def test_a_box_holds_what_lies_in_it():
    stage = chain(0)
    network = machine(0).network()
    floor = criterion_floor("floor", "floor", "VC-C")

    def rms(place):
        moved = FloorMachine(
            24.0,
            12.0,
            0.04,
            perturbed_plant(stage, place),
            control.PidFamily(20.0)(30.0),
            skyhook=0.6,
            feedforward=0.9,
        )
        return control.error_budget(moved.network(), [floor], (1.0, 300.0)).rms[0]

    band = box_band(rms, box_places(control.Uncertainty(frequency=0.05, gain=0.1, mass=0.1), stage, 8))
    nominal = control.error_budget(network, [floor], (1.0, 300.0)).rms[0]
    assert band.unstable == 0 and band.rms.min() < nominal < band.rms.max() and np.ptp(band.rms) < nominal
    places = box_places(control.Uncertainty(gain=0.5), stage, 8, seed=1)

    def stable_below(place):  # at twice the bandwidth the modes make a high gain unstable
        moved = perturbed_plant(stage, place._replace(gain=place.gain**6))
        return control.error_budget(
            FloorMachine(24.0, 12.0, 0.04, moved, control.PidFamily(20.0)(90.0)).network(),
            [floor],
            (1.0, 300.0),
        ).rms

    wild = box_band(stable_below, places)
    assert (
        0 < wild.unstable < 8 and wild.unstable == np.isnan(wild.rms[:, 0]).sum() and wild.rms.shape == (8, 2)
    )


def test_a_budget_of_pygwinc_is_the_same():
    """An open loop, which is all that pygwinc 0.6.2 expresses: two noises with calibrations, its `Budget.run().psd`."""
    f = np.array([0.5, 1.0, 3.0, 10.0, 30.0])
    theirs = [
        1.8152923340532417e-07,
        1.746899663207789e-08,
        7.531523525692627e-11,
        4.366204506065857e-15,
        5.201722761584608e-16,
    ]
    w, r = 2 * np.pi * 2, 2 * np.pi * 30
    a = np.array([[0, 1, 0], [-(w**2), -0.2 * w, 0], [0, 0, -r]])
    b = np.array([[0.0, 0, 0], [w**2, 0, 0], [0, r, 0]])
    plant = StateModel(a, b, np.array([[1.0, 0, 1], [0, 0, 0]]), np.zeros((2, 3)))
    network = control.Network(
        plant, constant(np.zeros((1, 1))), {"ground": "m", "shot": "m"}, {"u": "N"}, {"e": "m"}, {"y": "m"}
    )
    sources = [
        control.Source("seismic", ("ground",), "m", lambda f: 1e-12 * (1 + (10 / f) ** 4)),
        control.Source("shot", ("shot",), "m", lambda f: np.full(len(f), 1e-15)),
    ]
    budget = control.error_budget(network, sources, (0.4, 40.0))
    paths = np.abs(network.paths(f)[0, :2]) ** 2
    total = paths[0] * 1e-12 * (1 + (10 / f) ** 4) + paths[1] * 1e-15
    np.testing.assert_allclose(total, theirs, rtol=1e-12)
    ours = np.interp(np.log(f), np.log(budget.frequencies_hz), np.log(budget.density.sum(axis=0)[0]))
    np.testing.assert_allclose(np.exp(ours), theirs, rtol=0.02)
