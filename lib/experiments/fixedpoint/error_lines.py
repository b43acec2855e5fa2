"""Tracking errors as lines over time, each with its RMS: what one setting gives, for the explorers."""

from dataclasses import replace

from experiments.fixedpoint.axes import COLOURS
from experiments.fixedpoint.metrics import judge, noisy_run
from experiments.fixedpoint.noise import Noise
from experiments.fixedpoint.oscillator import load_oscillator
from experiments.fixedpoint.published import LITERAL, LOW_PASS, WINDOW, published_controllers
from stillwork.control.trajectory import asin_trajectory
from stillwork.estimation.coordinate_filters import LowPass, MovingWindow
from workbook import figures


def approximate():
    return load_oscillator()["approximate"].plant


def paint_error_lines(controllers, trajectory, noise, title, seconds=(6.0, 6.5), **options):
    """A run of each controller on the exact plant, in noise of one seed."""
    figure, axes = figures.new(height=3.2)
    exact = load_oscillator()["exact"].plant
    for name, controller in controllers.items():
        run = noisy_run(exact, controller, trajectory, noise, 0, **options)
        part = (run.time >= seconds[0]) & (run.time < seconds[1])
        if run.diverged_at is None:
            label = f"{name}: {judge(run)['position'] * 1e3:.3g} mm"
        else:
            label = f"{name}: diverged at {run.diverged_at:.2f} s"
        axes.plot(run.time[part], 1e3 * run.position_error[part], color=COLOURS[name], label=label)
    axes.set(xlabel="time (s)", ylabel="error of q (mm)", title=title)
    axes.legend(title="RMS after 2 s", title_fontsize=8)
    return figure


def paint_noise_free(frequency_hz: float, sharpness: float, window_length: int, bandwidth: float):
    """Tracking error without noise of the three filters, with other settings of two of them."""
    chosen = published_controllers(approximate())
    del chosen[LITERAL]
    for name, other in (
        (WINDOW, MovingWindow(int(window_length))),
        (LOW_PASS, LowPass(bandwidth, from_zero=True)),
    ):
        chosen[name] = replace(chosen[name], signal_filter=other)
    trajectory = asin_trajectory(sharpness=sharpness, frequency_hz=frequency_hz)
    return paint_error_lines(chosen, trajectory, Noise(), "without noise")


def paint_noisy(kind: str, amplitude: float, frequency_hz: float, integration: str):
    """Tracking error of the four controllers in noise of another size and kind."""
    chosen, trajectory = published_controllers(approximate()), asin_trajectory(frequency_hz=frequency_hz)
    noise = Noise(kind, amplitude)
    return paint_error_lines(chosen, trajectory, noise, f"{kind} noise", integration=integration)
