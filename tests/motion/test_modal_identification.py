"""Modes that nobody typed in: synthetic machines, the shipped structure, and a dense twin of the reduced equations."""

import numpy as np
import pytest
from scipy.signal import find_peaks

from experiments.motion.machines import measured_accelerance
from stillwork.identification.complex_frequency import _poles, _sums
from stillwork.identification.frequency_response import Identified
from stillwork.identification.machine import build_machine, remove_delay
from stillwork.identification.machine_files import load_machine
from stillwork.identification.modal_fit import identify_modes
from workbook import paths


def accelerance(hertz, mass, modes):
    """Rigid body and modes (Hz, damping ratio, share of the rigid body), term by term."""
    found = np.ones(len(hertz), complex)
    for frequency, damping, share in modes:
        ratio = hertz / frequency
        found -= share * ratio**2 / (1 - ratio**2 + 2j * damping * ratio)
    return found / mass


def noisy(rng, hertz, mass, modes, noise):
    """A measurement without coherence; `noise` is a share of the mass line."""
    error = rng.normal(size=(2, len(hertz))) * noise / mass / np.sqrt(2)
    return Identified(
        2 * np.pi * hertz,
        accelerance(hertz, mass, modes) + error[0] + 1j * error[1],
        np.full(len(hertz), np.nan),
    )


def found_modes(fit):
    """Frequencies (Hz), damping ratios and mass."""
    model = fit.model
    mass = 1 / (model.input_shapes[0, 0] * model.output_shapes[0, 0])
    return model.frequencies[1:] / (2 * np.pi), model.damping[1:], mass


def random_machine(rng):
    """One to six modes of 0.1 to 10 % damping, a quarter apart at least, and their machine's mass."""
    count = rng.integers(1, 7)
    frequencies = np.cumprod(np.append(rng.uniform(50, 200), rng.uniform(1.25, 2, count - 1)))
    damping = np.exp(rng.uniform(np.log(1e-3), np.log(0.1), count))
    shares = rng.uniform(0.2, 1.5, count) * rng.choice([-1, 1], count)
    return np.exp(rng.uniform(-1, 4)), np.column_stack([frequencies, damping, shares])


def test_poles_are_those_of_the_dense_equations():
    """All unknowns of all lines in one least-squares problem, nothing eliminated, no Toeplitz sums."""
    rng = np.random.default_rng(0)
    omega, order, outputs, inputs = np.linspace(100.0, 200.0, 150), 5, 3, 2
    response = sum(
        np.outer(rng.normal(size=outputs), rng.normal(size=inputs))
        / (w**2 - omega[:, None, None] ** 2 + 2j * z * w * omega[:, None, None])
        for w, z in ((120.0, 0.01), (150.0, 0.005), (151.0, 0.006), (180.0, 0.03))
    )
    weight = rng.uniform(0.5, 2.0, len(omega))
    powers = np.exp(1j * np.pi * (omega - 100) / 100)[:, None] ** np.arange(order + 1)
    blocks = []
    for o in range(outputs):
        own = [powers if o == k else 0 * powers for k in range(outputs)]
        shared = -(powers[:, :, None] * response[:, o, None, :]).reshape(len(omega), -1)
        blocks.append(np.hstack([*own, shared]) * weight[:, None])
    dense = np.vstack([np.vstack(blocks).real, np.vstack(blocks).imag])
    solved = np.linalg.lstsq(dense[:, :-inputs], -dense[:, -inputs:], rcond=None)[0]
    below = solved[outputs * (order + 1) :].reshape(order, inputs, inputs)
    companion = np.eye(order * inputs, k=inputs)
    companion[-inputs:] = -np.hstack(list(below))
    wanted = np.log(np.linalg.eigvals(companion).astype(complex)) * 100 / np.pi
    wanted = np.sort_complex(wanted[wanted.imag > 0] + 100j)
    found = np.sort_complex(_poles(_sums(omega, response, weight, order), order, omega))
    assert found == pytest.approx(wanted, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_random_machines_are_found_whole(seed):
    """Damping within 5 %, mass within 2 %, nothing lost, nothing spurious, at noise of half a per cent; every second
    response is late by 0.3 cycles of the band's end."""
    rng = np.random.default_rng(seed)
    mass, modes = random_machine(rng)
    hertz = np.linspace(modes[0, 0] / 10, 1.5 * modes[-1, 0], 3000)
    modes[:, 1] = np.maximum(
        modes[:, 1], (hertz[1] - hertz[0]) / modes[:, 0]
    )  # two lines a resonance at least
    band = (hertz[0], hertz[-1])
    measured, late = noisy(rng, hertz, mass, modes, 0.005), 0.3 * (seed % 2) / hertz[-1]
    fit = identify_modes(
        measured._replace(response=measured.response * np.exp(-1j * measured.omega * late)), band
    )
    frequencies, damping, found = found_modes(fit)
    assert frequencies == pytest.approx(modes[:, 0], rel=5e-3)
    assert damping == pytest.approx(modes[:, 1], rel=0.05)
    assert found == pytest.approx(mass, rel=0.02)
    assert fit.delay == pytest.approx(late, rel=1e-3) and not fit.cut.size


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "end"), [(20, 1.0), (22, 0.97), (24, 1.0)])
def test_a_band_that_cuts_a_resonance_leaves_the_others_and_the_mass_alone(seed, end):
    """Three modes of a random machine, its band ended before or at the peak of the last."""
    rng = np.random.default_rng(seed)
    mass, modes = random_machine(rng)
    modes = modes[:3]
    hertz = np.linspace(modes[0, 0] / 20, end * modes[2, 0], 1000)
    fit = identify_modes(noisy(rng, hertz, mass, modes, 0.005), (hertz[0], hertz[-1]))
    frequencies, damping, found = found_modes(fit)
    assert np.append(frequencies, fit.cut / (2 * np.pi)) == pytest.approx(modes[:, 0], rel=5e-3)
    assert damping[:2] == pytest.approx(modes[:2, 1], rel=0.05)
    assert found == pytest.approx(
        mass, rel=5e-3
    )  # the aim is 2 %; without the third mode it is up to 4 % off
    assert not fit.delay


@pytest.mark.slow
def test_heavy_damping_and_a_modes_neighbour_are_kept():
    modes = [(80.0, 0.2, 1.0), (200.0, 0.05, -0.7), (212.0, 0.04, 0.9)]
    measured = noisy(np.random.default_rng(1), np.arange(5.0, 500.0, 0.25), 40.0, modes, 0.002)
    frequencies, damping, mass = found_modes(identify_modes(measured, (5.0, 500.0)))
    assert frequencies == pytest.approx([80.0, 200.0, 212.0], rel=0.01)
    assert damping == pytest.approx([0.2, 0.05, 0.04], rel=0.05)
    assert mass == pytest.approx(40.0, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("follows", "widest"), [(False, 3.0), (True, 1.6)])
def test_intervals_hold_the_truth_as_often_as_they_say(follows, widest):
    """Monte Carlo over noise alone, of the same size at all lines or of that of the response; the mode at 50 Hz is on few lines."""
    hertz, modes = np.arange(5.0, 200.0, 0.5), [(50.0, 0.01, 0.8), (120.0, 0.03, -0.5)]
    truth = np.array([50.0, 120.0, 0.01, 0.03, np.log(10.0), 0.08, -0.05])
    values, told = [], []
    for seed in range(20):
        seen = noisy(np.random.default_rng(seed), hertz, 10.0, modes, 0.02)
        if follows:
            exact = accelerance(hertz, 10.0, modes)
            seen = seen._replace(response=exact * (1 + 10 * (seen.response - exact)))
        fit = identify_modes(seen, (5.0, 200.0), [50.0, 120.0])
        frequencies, damping, mass = found_modes(fit)
        parts = (fit.model.input_shapes[:, 0] * fit.model.output_shapes[0])[1:]
        values.append([*frequencies, *damping, np.log(mass), *parts])
        spread = [fit.deviation / (2 * np.pi), fit.damping_deviation, [fit.mass_deviation]]
        told.append([*np.concatenate(spread), *fit.residue_deviation * np.abs(parts)])
    inside = np.abs(np.array(values) - truth) < 1.96 * np.array(told)
    assert inside.mean() > 0.9 and np.all(inside.mean(axis=0) > 0.75)  # of 20 each, 0.95 to be expected
    spread = np.sqrt(np.mean((values - truth) ** 2, axis=0))
    assert np.all(np.mean(told, axis=0) < widest * spread) and np.all(np.mean(told, axis=0) > 0.65 * spread)


@pytest.mark.slow
def test_ten_main_modes_of_the_shipped_structure_and_none_spurious():
    """16 s of CPU: the one measured structure with many modes; drawn ones have no noise that the fit did not expect."""
    measured = measured_accelerance(2)
    hertz = measured.omega / (2 * np.pi)
    fit = identify_modes(measured, (100.0, 6500.0))
    frequencies = found_modes(fit)[0]
    size = np.abs(measured.response)
    peaks = find_peaks(20 * np.log10(size), prominence=8.0)[0]
    peaks = peaks[(hertz[peaks] > 100) & (hertz[peaks] < 6500)]
    main = hertz[peaks[np.argsort(size[peaks])[-10:]]]
    assert sorted(main)[::9] == [900.0, 6077.5]
    apart = np.array([np.abs(frequencies - peak).min() for peak in main])
    assert (
        np.sum(apart < 1.0) >= 9 and apart.max() < 1.3
    )  # the one at 5969 Hz has a shoulder and is 11 Hz wide
    # Every mode stands on a maximum of the measurement within its own width and two lines.
    maxima = hertz[1:-1][(size[1:-1] > size[:-2]) & (size[1:-1] > size[2:])]
    for frequency, damping in zip(frequencies, found_modes(fit)[1], strict=True):
        assert np.abs(maxima - frequency).min() < max(2 * damping * frequency, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize(("sign", "place"), [(1, 0), (-1, 1)])
def test_a_measured_machine_on_springs_keeps_its_suspension(tmp_path, sign, place):
    """Two masses on a soft spring by the equations of motion; the frequencies from the matrices' eigenvalues."""
    hertz = np.arange(2.0, 1000.0, 0.5)
    mass = np.diag([30.0, 10.0])
    stiffness = 1.5e7 * np.array([[1.0, -1.0], [-1.0, 1.0]]) + np.diag([1e6, 0.0])
    damping = 1e-5 * stiffness + 0.5 * mass
    response = [
        -(w**2) * np.linalg.solve(stiffness + 1j * w * damping - w**2 * mass, [sign, 0.0])[place]
        for w in 2 * np.pi * hertz
    ]
    error = np.random.default_rng(place).normal(size=(2, len(hertz))) * 1e-4
    np.savez(tmp_path / "a.npz", frequency=hertz, h=np.array(response) + error[0] + 1j * error[1])
    machine = build_machine(load_machine(tmp_path / "a.npz"), modes_hz=[], fit_hz=(0.0, 0.0))
    wanted = np.sqrt(np.sort(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real)) / (2 * np.pi)
    assert machine.sensors[0].frequencies / (2 * np.pi) == pytest.approx(wanted, rel=1e-3)
    assert machine.mass == pytest.approx(40.0, rel=0.02)
    assert any("25.11 Hz" in note for note in machine.notes)
    assert ("counted against the force, turned" in machine.notes) == (sign < 0)


def test_a_delay_is_told_and_taken_out(tmp_path):
    """A response that is 0.3 ms late; in the machine its delay is told, brought forward it is as it was."""
    hertz, late = np.arange(2.0, 300.0, 0.5), 3e-4
    response = accelerance(hertz, 40.0, [(120.0, 0.01, 0.8), (310.0, 0.015, -0.6)])
    delayed = response * np.exp(-2j * np.pi * hertz * late)
    np.savez(tmp_path / "a.npz", **{"frequency (Hz)": hertz, "h (m/s^2/N)": delayed})
    file = load_machine(tmp_path / "a.npz")
    machine = build_machine(file, modes_hz=[], fit_hz=(0.0, 0.0))
    assert any("the response is 300 us late" in note for note in machine.notes)
    assert machine.mass == pytest.approx(40.0, rel=2e-3)
    assert machine.fit.delay == pytest.approx(late, rel=1e-3)
    assert remove_delay(machine, late).measured.response == pytest.approx(response, rel=1e-12)
    assert machine.measured.response == pytest.approx(delayed, rel=1e-12)


# --------------------------------------------------------------------------------------------------------- friction


@pytest.mark.slow
@pytest.mark.parametrize(
    ("friction", "noise", "late"),
    [(0.0, 0.01, 0.0), (300.0, 0.01, 1e-4)],
)
def test_a_body_on_viscous_friction_keeps_its_mass_and_invents_nothing(friction, noise, late):
    """10 kg with a resonance at 90 Hz: b s beside m s^2, by the equation of motion alone; none where there is none."""
    omega = 2 * np.pi * np.arange(4.0, 160.0, 0.25)
    s, own = 1j * omega, 2 * np.pi * 90.0
    errors = np.random.default_rng(1).standard_normal((2, len(omega)))
    response = (
        s**2
        * np.exp(-s * late)
        * (1 / (10.0 * s**2 + friction * s) + 0.1 / (s**2 + 2 * 0.01 * own * s + own**2))
        * (1 + noise * (errors[0] + 1j * errors[1]) / np.sqrt(2))
    )
    measured = Identified(omega, response, np.full(len(omega), 1 / (1 + noise**2)))
    fit = identify_modes(measured, (4.0, 159.75))
    model = fit.model
    assert 1 / (model.input_shapes[0, 0] * model.output_shapes[0, 0]) == pytest.approx(10.0, rel=3e-3)
    assert model.frequencies[1:] / (2 * np.pi) == pytest.approx([90.0], rel=1e-4)
    assert 10.0 * model.drag == pytest.approx(friction, rel=2e-2)
    assert fit.delay == pytest.approx(late, abs=1e-5)


@pytest.mark.slow
def test_the_modes_of_a_suspension_are_found_over_the_whole_band():
    """Measured: modes at 0.50, 0.68 and 2.75 Hz, few of 1,280 even lines up to 10 Hz; from 0.2 to 5 Hz they stand out."""
    source = paths.data("motion", "suspension_pitch/pitch.npz")
    file = load_machine(source, "rad", "N m")
    whole, given = (build_machine(file, modes_hz=[], fit_hz=band) for band in ((0.0, 0.0), (0.2, 5.0)))
    for hertz in (0.502, 0.677, 2.745):
        assert np.abs(whole.resonances_hz / hertz - 1).min() < 2e-3
        assert np.abs(given.resonances_hz / hertz - 1).min() < 2e-3
    assert any("fitted from 0.2" in note and "fit_hz" in note for note in whole.notes)
    assert not any("fitted from" in note for note in given.notes)
