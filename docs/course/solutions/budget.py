"""Solutions of the track on the error budget.

Each function answers the exercise of its number with the toolbox, compares the answer with something that shares no
code with it, and returns the check of the exercise. Its arguments are the numbers of the exercise: with others
it gives the answer to a new one.
"""

import control as ct
import numpy as np
from scipy import optimize, signal, stats

from stillwork import control, lti
from stillwork.control.budget_sources import quantiser, tabulated, white

RIGID = lti.ModalModel([0.0], [0.0], [[12.5**-0.5]], [[12.5**-0.5]], [[0.0]])
OPEN = ct.tf([0.0], [1.0])


def frame(hertz: float, damping: float) -> control.Network:
    """A mass on a floor: what moves it to how far it moves, relative to the floor."""
    w = 2 * np.pi * hertz
    one, over = [1.0], [1.0, 2 * damping * w, w**2]
    model = ct.tf([[one, one], [one, one]], [[over, over], [over, over]])  # from both inputs to both outputs
    return control.Network(model, OPEN, {"floor": "m/s^2"}, {"u": "m/s^2"}, {"travel": "m"}, {"y": "m"})


def direct() -> control.Network:
    """An error that is its source."""
    pass_on = ct.ss([], [], [], [[1.0, 0.0], [0.0, 0.0]])
    return control.Network(pass_on, OPEN, {"error": "m"}, {"u": "m"}, {"e": "m"}, {"y": "m"})


def exercise_1(level: float = 1e-5, hertz: float = 12.3, damping: float = 0.04) -> str:
    """How far a frame on springs travels on a white floor, by the budget and by the closed form of one resonance."""
    floor = white("floor", "floor", "m/s^2", level)
    rms = control.error_budget(frame(hertz, damping), [floor], (1e-3, 1e5)).rms[0]
    expected = level / np.sqrt(8 * damping * (2 * np.pi * hertz) ** 3)
    assert np.isclose(rms, expected, rtol=1e-4)
    return f"{1e9 * expected:.1f}"


def exercise_2(passive: float = 0.04, damped: float = 0.7) -> str:
    """What damping saves on a white floor."""
    floor = white("floor", "floor", "m/s^2", 1e-5)
    ratio = np.divide(
        *(control.error_budget(frame(12.3, each), [floor], (1e-3, 1e5)).rms[0] for each in (passive, damped))
    )
    assert np.isclose(ratio, np.sqrt(damped / passive), rtol=1e-4)
    return f"{ratio:.2f}"


def exercise_3(first: float = 20.0, second: float = 15.0) -> str:
    """What halving the larger of two independent parts saves."""
    sources = [white(name, "error", "m", size) for name, size in (("a", first), ("b", second))]
    saved = control.error_budget(direct(), sources, (1.0, 2.0)).saved(0.5)[0, 0]
    draws = np.random.default_rng(3).standard_normal((2, 1_000_000)) * [[first], [second]]
    assert np.isclose(saved, np.std(draws.sum(axis=0)) - np.std(draws[0] / 2 + draws[1]), rtol=0.02)
    return f"{saved:.2f}"


def exercise_4(step: float = 20.0, rate: float = 5000.0) -> str:
    """The density of an encoder's rounding, from a record of it."""
    found = np.sqrt(quantiser("encoder", "stage sensor", "m", step, rate)._at(np.ones(1))[0, 0, 0].real)
    smooth = np.cumsum(np.random.default_rng(4).normal(0, 3 * step, 400_000))
    f, density = signal.welch(smooth - step * np.round(smooth / step), rate, nperseg=1024)
    assert np.isclose(np.sqrt(density[(f > 10) & (f < 0.45 * rate)].mean()), found, rtol=0.02)
    return f"{found:.3f}"


def exercise_5(hertz: float = 37.0, exposure: float = 0.01) -> str:
    """Which share of an oscillation an exposure sees as a shift."""
    tone = control.Source("tone", ("error",), "m", tones=((hertz, np.sqrt(2)),))
    average, deviation = control.error_budget(direct(), [tone], (1.0, 1e4)).moving(exposure)
    at = np.random.default_rng(5).uniform(0, 1, 1000)[:, None] + np.linspace(0, exposure, 401)
    windows = np.sqrt(2) * np.sin(2 * np.pi * hertz * at)
    means = np.trapezoid(windows, dx=1 / 400, axis=1)
    assert np.isclose(np.sqrt(np.mean(means**2)), average[0], rtol=0.05)
    assert np.isclose(average[0] ** 2 + deviation[0] ** 2, 1)
    return f"{average[0]:.2f}"


def exercise_6(hertz: float = 37.0, seconds: float = 60.0) -> str:
    """How far beyond its rms an error comes in a minute, by Rice and in records."""
    band = 0.5 * hertz, 1.5 * hertz
    noise = white("noise", "error", "m", np.diff(band).item() ** -0.5)
    peak = control.error_budget(direct(), [noise], band).peak(seconds)[0]
    rng, samples = np.random.default_rng(6), round(seconds * 20 * hertz)
    f = np.fft.rfftfreq(samples, 1 / (20 * hertz))
    inside = (f > band[0]) & (f < band[1])
    largest = []
    for _ in range(60):
        lines = inside * (rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f)))
        error = np.fft.irfft(lines)
        largest.append(np.abs(error).max() / error.std())
    assert np.isclose(np.mean(largest), peak, rtol=0.05)
    return f"{peak:.1f}"


def exercise_7(bandwidth: float = 83.0, floor: float = 26.0, sensor: float = 25.0) -> str:
    """Where more bandwidth begins to cost: the floor's part falls with its square, the sensor's rises with its root."""
    best = bandwidth * (4 * floor**2 / sensor**2) ** 0.2

    def error(hertz):
        return floor**2 * (bandwidth / hertz) ** 4 + sensor**2 * hertz / bandwidth

    assert np.isclose(optimize.minimize_scalar(error, (10.0, 50.0), method="brent").x, best, rtol=1e-4)
    loops = [  # the second law, from a machine: its sensor alone at two bandwidths
        control.FloorMachine(31.7, 12.3, 0.04, RIGID, control.PidFamily(12.5)(hertz)).network()
        for hertz in (bandwidth, 2 * bandwidth)
    ]
    noise = white("sensor", "stage sensor", "m", 1e-9)
    parts = [control.error_budget(loop, [noise], (1e-2, 1e5)).rms[0] for loop in loops]
    assert np.isclose(parts[1] / parts[0], np.sqrt(2), rtol=0.02)
    return f"{best:.0f}"


def exercise_8(averages: int = 29) -> str:
    """How far up the rms may lie that one line of a Welch spectrum makes."""
    freedom = tabulated("floor", "error", "m", [1.0, 2.0, 3.0], np.ones(3), averages).freedom
    upper = np.sqrt(freedom / stats.chi2.ppf(0.025, freedom))
    rng, size = np.random.default_rng(8), 64
    spectra = [
        signal.welch(rng.standard_normal(size * (averages + 1) // 2), 1.0, "hann", size, detrend=False)[1][16]
        for _ in range(3000)
    ]
    assert np.isclose(np.mean(np.sqrt(2.0 / np.array(spectra)) < upper), 0.975, atol=0.012)
    return f"{upper:.2f}"


def exercise_9(pull: float = 4.0, seconds: float = 0.2) -> str:
    """How far the frame gives way while the stage accelerates, and that a slow pull is that static answer."""
    machine = control.FloorMachine(31.7, 12.3, 0.04, RIGID, control.PidFamily(12.5)(40.0))
    stiffness = (2 * np.pi * 12.3) ** 2 * 44.2
    static = 12.5 * pull / stiffness
    assert np.isclose(machine.suspension[0], stiffness)
    t = np.linspace(0, 20 * seconds, 4000)
    force = 12.5 * pull * np.minimum(t / (10 * seconds), 1)
    body = ct.tf([1.0], [31.7, machine.suspension[1], stiffness])
    assert np.isclose(ct.forced_response(body, t, force).outputs[-1], static, rtol=0.01)
    return f"{1e6 * static:.0f}"


def exercise_10(runs: int = 100, refused: float = 0.03) -> str:
    """How many of the runs must lie in an interval of 95 % before it is believed."""
    fewest = next(k for k in range(runs, 0, -1) if stats.binom.cdf(k - 1, runs, 0.95) <= refused)
    inside = (np.random.default_rng(10).random((100_000, runs)) < 0.95).sum(axis=1)
    assert np.mean(inside < fewest) <= refused + 0.002 and np.mean(inside < fewest + 1) > refused - 0.002
    return f"{fewest}"
