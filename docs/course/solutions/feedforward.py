"""Solutions of the track on adaptive feedforward.

Each function answers the exercise of its number with the toolbox, compares the answer with something that shares no
code with it, and returns the check of the exercise. Its arguments are the numbers of the exercise: with others
it gives the answer to a new one.
"""

import control as ct
import numpy as np
from scipy import optimize, signal

from experiments.isolation import load_twin
from notebooks.isolation.floor_and_paths import suspension_modes
from stillwork.estimation import AdaptationStepper, FeLms, FeRls, identify
from stillwork.signals import estimate_spectrum, load_record
from workbook import paths


def signs(seed: int, rows: int, samples: int) -> np.ndarray:
    """Regressors of power one that are independent of each other and never vary in size."""
    return np.random.default_rng(seed).choice([-1.0, 1.0], size=(rows, samples))


def crossing(values: np.ndarray, level: float) -> float:
    """First place, between samples, at which falling values reach a level."""
    after = int(np.argmax(values <= level))
    return after - (level - values[after]) / (values[after - 1] - values[after])


def exercise_1(damping: float = 0.7, stiffness: float = 60e3) -> str:
    """One skyhook gain for all modes: damping goes with frequency."""
    modes = suspension_modes(load_twin("rigid_body"), feedback=False)
    lowest, highest = modes.frequencies_hz.min(), modes.frequencies_hz.max()
    gain = 2 * damping * stiffness / (2 * np.pi * lowest)  # N s/m
    highest_damping = gain * 2 * np.pi * highest / (2 * stiffness)

    # The poles of a strut with the mass that puts it at each frequency.
    for frequency_hz, wanted in ((lowest, damping), (highest, highest_damping)):
        mass = stiffness / (2 * np.pi * frequency_hz) ** 2
        poles = np.roots([mass, gain, stiffness])
        assert np.isclose(-poles.real.sum() / 2 / np.sqrt(poles.prod().real), wanted)
    return f"{highest_damping:.2f}"


def exercise_2(step: float = 0.05, weak: float = 0.1) -> str:
    """FeLMS's slow mode: the weak regressor learns at its own share of the power."""
    share = weak**2 / (1 + weak**2)  # of the power in all regressors
    expected = -1 / np.log1p(-step * share)
    samples = round(2 * expected)
    courses = []
    for seed in range(60):
        regressors = signs(seed, 2, samples) * [[1.0], [weak]]
        found = identify(FeLms(step, 1e-12), regressors, -np.array([[0.0, 1.0]]) @ regressors, every=1)
        courses.append(1 - found.history[:, 0, 1])
    measured = crossing(np.mean(courses, axis=0), np.exp(-1))

    assert abs(measured / expected - 1) < 0.1  # sixty runs scatter by a few per cent
    return f"{expected:.0f}"


def exercise_3(bold: float = 10.0) -> str:
    """FeRLS from a covariance ten times the steady one: most of the way in a sixth of the memory."""
    memory = 2000
    forgetting = np.exp(-1 / memory)
    regressors = signs(1, 1, 2 * memory)
    steady = 1 - forgetting  # of regressors of power one
    taken = {}
    for start in (1, bold):
        settings = FeRls(start * steady, forgetting, growth_limit=np.inf)
        history = identify(settings, regressors, -regressors, every=1).history[:, 0, 0]
        taken[start] = crossing(1 - history, np.exp(-1)) / memory

    # In least squares the start counts as its own information, which is forgotten like all other.
    x = optimize.brentq(lambda x: x / bold / (1 - (1 - 1 / bold) * x) - np.exp(-1), 0, 1)
    assert np.isclose(taken[1], 1, atol=2e-3)
    assert np.isclose(taken[bold], -np.log(x), atol=2e-3)
    return f"{taken[bold]:.2f}"


def exercise_4(degrees: float = 60.0) -> str:
    """A path estimate that is wrong by a phase: slower by its cosine, and unstable beyond a quarter turn."""

    def course(phase: float) -> np.ndarray:
        stepper = AdaptationStepper(FeLms(0.02, 1e-12), np.zeros((1, 2)))
        left = []
        for angle in 2.399963 * np.arange(1500):  # a tone
            psi = np.array([np.cos(angle), np.sin(angle)])
            late = np.array([np.cos(angle + phase), np.sin(angle + phase)])
            stepper.update(psi, (stepper.weights - [[1.0, 0.0]]) @ late)
            left.append(np.linalg.norm(stepper.weights - [[1.0, 0.0]]))
        return np.array(left)

    slower = crossing(course(np.radians(degrees)), np.exp(-1)) / crossing(course(0.0), np.exp(-1))
    grows = course(np.radians(100))

    # Averaged over the tone the step is -mu/2 times a rotation.
    def rate(phase: float) -> float:
        rotation = np.array([[np.cos(phase), -np.sin(phase)], [np.sin(phase), np.cos(phase)]])
        return float(np.linalg.eigvals(-rotation).real.max())

    assert np.isclose(slower, rate(0.0) / rate(np.radians(degrees)), rtol=0.02)
    assert rate(np.radians(100)) > 0 and grows[-1] > grows[0]
    return f"{slower:.1f}"


def exercise_5(louder: float = 16.0) -> str:
    """A floor that becomes sixteen times quieter in power: FeRLS waits until it has forgotten the loud one."""
    memory = 2000
    forgetting = np.exp(-1 / memory)
    quiet = signs(2, 1, 5 * memory)
    settings = FeRls((1 - forgetting) / louder, forgetting, growth_limit=np.inf)  # steady on the loud floor
    history = identify(settings, quiet, -quiet, every=1).history[:, 0, 0]
    measured = crossing(1 - history, np.exp(-1)) / memory

    # Of the information after a sample, the part from before it stays with the wrong weight.
    information, left, samples = louder / (1 - forgetting), 1.0, 0
    while left > np.exp(-1):
        left *= forgetting * information / (forgetting * information + 1)
        information, samples = forgetting * information + 1, samples + 1
    assert np.isclose(measured, samples / memory, atol=2e-3)
    return f"{measured:.2f}"


def exercise_6(frequency_hz: float = 3.0, reduction_db: float = 20.0) -> str:
    """Weak integrators: what a reduction of 20 dB at 3 Hz asks of their cut-off."""
    target = 10 ** (-reduction_db / 20)
    low_pass = ct.tf([1.0], [1.0, 1.0]) ** 3  # with its corner at 1 rad/s: all that matters is the ratio
    remainder = 1 - (1 - low_pass) ** 2
    ratio = optimize.brentq(lambda omega: abs(remainder(1j * omega)) - target, 1, 10)
    cutoff_hz = frequency_hz / ratio

    # By the powers themselves: 1 - (1 - L)^2 with L = 1 / (1 + j f / f_c)^3.
    grid = cutoff_hz * np.linspace(0.5, 2.0, 150_001)
    remains = np.abs(1 - (1 - (1 + 1j * frequency_hz / grid) ** -3.0) ** 2)
    assert np.isclose(grid[np.argmax(remains >= target)], cutoff_hz, atol=1e-4)
    return f"{cutoff_hz:.2f}"


def exercise_7(frequency_hz: float = 160.0, reduction_db: float = 20.0) -> str:
    """A late command: the rate at which one sample of delay still leaves 20 dB at 160 Hz."""
    target = 10 ** (-reduction_db / 20)
    rate_hz = np.pi * frequency_hz / np.arcsin(target / 2)

    time = np.arange(200_000) / rate_hz
    floor = np.sin(2 * np.pi * frequency_hz * time)
    late = np.r_[0.0, floor[:-1]]
    assert np.isclose(np.std((floor - late)[1:]) / np.std(floor), target, rtol=1e-3)
    return f"{rate_hz / 1e3:.2f}"


def exercise_8(removed: float = 0.94, louder: float = 2.0) -> str:
    """Output noise sets the limit: what is left of 94 % when the sensor is twice as loud."""
    noise = (1 - removed) / removed  # over the power that the floor makes
    doubled = 1 / (1 + louder**2 * noise)

    rng = np.random.default_rng(8)
    floor, sensor = rng.standard_normal((2, 400_000))
    for scale, expected in ((1, removed), (louder, doubled)):
        output = signal.lfilter([0.6, -0.8], 1, floor) + scale * np.sqrt(noise) * sensor
        rows = np.stack([floor[1:], floor[:-1]])
        weights = np.linalg.lstsq(rows.T, output[1:], rcond=None)[0]
        assert np.isclose(1 - np.var(output[1:] - weights @ rows) / np.var(output[1:]), expected, atol=2e-3)
    return f"{100 * doubled:.1f}"


def exercise_9(correlation: float = 0.99, step: float = 0.05) -> str:
    """Two sensors that see the same motion to 99 %: FeLMS takes the ratio of the eigenvalues, FeRLS does not care."""
    samples = 12_000
    courses = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        one = rng.choice([-1.0, 1.0], samples)
        both = np.stack([one, one * np.where(rng.random(samples) < (1 + correlation) / 2, 1, -1)])
        courses.append(identify(FeLms(step, 1e-12), both, [[-1.0, -0.0]] @ both, every=1).history[:, 0])
    wrong = [1.0, 0.0] - np.mean(courses, axis=0)
    slow = crossing(np.abs(wrong @ [1, -1]), np.exp(-1))
    fast = crossing(np.abs(wrong @ [1, 1]), np.exp(-1))
    eigenvalues = np.linalg.eigvalsh([[1, correlation], [correlation, 1]])
    ratio = eigenvalues[1] / eigenvalues[0]
    assert abs(slow / fast / ratio - 1) < 0.15  # forty runs scatter by some per cent

    # FeRLS: the same commands from the motions' sum and difference, when its start is carried over.
    basis = np.array([[1.0, 1.0], [1.0, -1.0]])
    back = np.linalg.inv(basis)
    start = np.eye(2)
    plain = identify(FeRls(start, 0.999, np.inf), both, [[-1.0, 0.0]] @ both).weights
    moved = identify(FeRls(back.T @ start @ back, 0.999, np.inf), basis @ both, [[-1.0, 0.0]] @ both).weights
    assert np.allclose(moved @ basis, plain, atol=1e-9)
    return f"{ratio:.0f}"


def exercise_10(limit: float = 10.0, constants: int = 12) -> str:
    """A silent sensor winds the covariance up, and the limit says when it stops."""
    memory = 500
    forgetting = np.exp(-1 / memory)
    steady = 1 - forgetting
    silent = np.zeros((1, constants * memory))
    still = np.zeros((1, constants * memory))
    free = identify(FeRls(steady, forgetting, np.inf), silent, still).covariance[0, 0] / steady
    assert np.isclose(free, np.exp(constants), rtol=1e-9)

    def growth(samples: int) -> float:
        settings = FeRls(steady, forgetting, growth_limit=limit)
        return identify(settings, silent[:, :samples], still[:, :samples]).covariance[0, 0] / steady

    reached = next(n for n in range(memory, len(silent[0])) if growth(n) >= limit * (1 - 1e-9))
    assert np.isclose(reached / memory, np.log(limit), atol=2 / memory)
    assert growth(len(silent[0])) < 1.01 * limit
    return f"{reached / memory:.2f}"


def exercise_11(rate_hz: float = 5000.0) -> str:
    """The longest memory that single precision can tell from none, at 5 kHz."""
    low, high = 1, 2**40
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if np.float32(np.exp(-1 / middle)) < 1 else (low, middle)

    half_spacing = float(1 - np.nextafter(np.float32(1), np.float32(0))) / 2
    assert np.isclose(high, 1 / half_spacing, rtol=1e-6)
    return f"{high / rate_hz / 3600:.2f}"


def exercise_12(low_hz: float = 8.0, high_hz: float = 80.0) -> str:
    """A record of a slab: its motion in a band from the spectrum, and from the filtered record."""
    record = load_record(paths.data("isolation", "slab_footfall/slab_vertical.csv"), "m/s^2")
    found = {
        resolution: float(
            np.sqrt(
                estimate_spectrum(record.signals, record.sample_rate, resolution).power(low_hz, high_hz)[0]
            )
        )
        for resolution in (0.1, 2.0)
    }

    # Parseval: the transform of the whole record, without windows.
    transform = np.fft.rfft(record.signals[0])
    frequencies = np.fft.rfftfreq(record.signals.shape[1], 1 / record.sample_rate)
    inside = (frequencies >= low_hz) & (frequencies <= high_hz)
    rms = np.sqrt(2 * np.sum(np.abs(transform[inside]) ** 2)) / record.signals.shape[1]
    assert np.isclose(found[2.0], rms, rtol=0.02)
    assert found[0.1] > 1.1 * rms  # a few long windows give the steps in the middle too much weight
    return f"{1e3 * rms:.0f}"
