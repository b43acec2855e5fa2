"""Drawing functions for the notebooks' explorers: one simulation or calculation, one small picture."""

from dataclasses import replace

import numpy as np

from experiments.fixedpoint.convergence_pictures import paint_limit_cycle_condition
from experiments.fixedpoint.differentiation import steady_errors
from experiments.fixedpoint.metrics import compare, judge, noisy_run
from experiments.fixedpoint.noise import Noise
from experiments.fixedpoint.oscillator import load_oscillator
from experiments.fixedpoint.published import KALMAN, LITERAL, LOW_PASS, WINDOW, published_controllers
from experiments.fixedpoint.run_pictures import COLOURS, METRICS, log_axis
from stillwork.control.fixed_point import Controller
from stillwork.control.fixed_point_convergence import limit_cycles, stable_range
from stillwork.control.fixed_point_linear import linear_loop, semi_implicit_motion
from stillwork.control.kinematics import KinematicDesign
from stillwork.control.trajectory import asin_trajectory
from stillwork.control.transformation import FlowTransformation, RobustTransformation
from stillwork.estimation.coordinate_filters import LowPass, MovingWindow
from stillwork.estimation.plant import partial_derivatives
from stillwork.workbook import figures


def _approximate():
    return load_oscillator()["approximate"].plant


def _driven(controllers, trajectory, noise, **options):
    """A run of each controller on the exact plant, in noise of one seed."""
    exact = load_oscillator()["exact"].plant
    return {
        name: noisy_run(exact, each, trajectory, noise, 0, **options) for name, each in controllers.items()
    }


def _paint_error_lines(runs, title, seconds=(6.0, 6.5)):
    figure, axes = figures.new(height=3.2)
    for name, run in runs.items():
        part = (run.time >= seconds[0]) & (run.time < seconds[1])
        error = judge(run)["position"]
        label = (
            f"{name}: {error * 1e3:.3g} mm"
            if np.isfinite(error)
            else f"{name}: diverged at {run.diverged_at:.2f} s"
        )
        axes.plot(run.time[part], 1e3 * run.position_error[part], color=COLOURS[name], label=label)
    axes.set(xlabel="time (s)", ylabel="error of q (mm)", title=title)
    axes.legend(title="RMS after 2 s", title_fontsize=8)
    return figure


def paint_noise_free(frequency_hz: float, sharpness: float, window_length: int, bandwidth: float):
    """Tracking error without noise of the three filters, with other settings of two of them."""
    chosen = published_controllers(_approximate())
    del chosen[LITERAL]
    for name, other in ((WINDOW, MovingWindow(int(window_length))), (LOW_PASS, LowPass(bandwidth))):
        chosen[name] = replace(chosen[name], signal_filter=other)
    trajectory = asin_trajectory(sharpness=sharpness, frequency_hz=frequency_hz)
    return _paint_error_lines(_driven(chosen, trajectory, Noise()), "without noise")


def paint_noisy(kind: str, amplitude: float, frequency_hz: float, integration: str):
    """Tracking error of the four controllers in noise of another size and kind."""
    chosen, trajectory = published_controllers(_approximate()), asin_trajectory(frequency_hz=frequency_hz)
    runs = _driven(chosen, trajectory, Noise(kind, amplitude), integration=integration)
    return _paint_error_lines(runs, f"{kind} noise")


def paint_ranking(frequency_hz: float, sharpness: float, amplitude: float):
    """RMS errors of the four controllers, mean over two noise records."""
    exact = load_oscillator()["exact"].plant
    trajectory = asin_trajectory(sharpness=sharpness, frequency_hz=frequency_hz)
    noise = Noise("gaussian", amplitude)
    found = compare(exact, published_controllers(_approximate()), trajectory, noise, runs=2, seed=0)
    figure, panels = figures.new(1, 2, height=2.2)
    for axes, quantity, ticks in zip(
        panels, ("position", "roughness"), (list(found), [""] * len(found)), strict=True
    ):
        for place, (name, study) in enumerate(found.items()):
            mean = METRICS[quantity][2] * study[quantity].mean()
            axes.plot(mean, place, "o", color=COLOURS[name], label=name)
        axes.set(xscale="log", xlabel=METRICS[quantity][0], ylim=(len(found) - 0.5, -0.5))
        axes.set_yticks(range(len(found)), ticks)
        log_axis(axes.xaxis)
    return figure


def motion_at_rest(sample_time: float):
    """F of x = [velocity, position] for the approximate model at rest, semi-implicit."""
    slopes = partial_derivatives(_approximate(), 0.0, 0.0, 0.0)
    return semi_implicit_motion(slopes, sample_time)[0]


def paint_expected_beliefs(assumed_scale: float, noise_deviation: float):
    """Believed and true standard deviation of the Kalman filter's errors when its R is scaled."""
    scales = np.geomspace(1e-4, 1e4, 25)
    sample_time = 1e-3
    process, assumed = np.diag([1e-1, 1e-3]), np.diag([1e-2, 1e-3])
    still = motion_at_rest(sample_time)
    settled = [
        steady_errors(still, process, s * assumed, noise_deviation, sample_time, np.zeros((2, 2)))
        for s in scales
    ]
    figure, panels = figures.new(1, 2, height=3.0)
    for axes, column, estimate in zip(panels, (1, 0), ("q (m)", "q' (m/s)"), strict=True):
        for name, colour, line in (("believed", figures.RED, "--"), ("true", figures.BLUE, "-")):
            values = [np.sqrt(getattr(s, name)[column, column]) for s in settled]
            axes.plot(scales, values, line, color=colour, label=name)
        axes.axvline(assumed_scale, color=figures.BLACK, linestyle=":")
        axes.set(xscale="log", yscale="log", xlabel="factor on the assumed R (1)")
        axes.set_ylabel(f"standard deviation of {estimate}")
        log_axis(axes.xaxis)
        log_axis(axes.yaxis)
    panels[0].legend()
    return figure


def paint_limit_cycle(gain: float, window_length: int, exponent: float):
    """Where the window's loop and transformation (6) balance."""
    transformation = FlowTransformation(-gain)
    parts = MovingWindow(int(window_length)), transformation, KinematicDesign(exponent), _approximate()
    loop = linear_loop(load_oscillator()["exact"].plant, Controller(*parts), 1e-3)
    region = stable_range(loop)
    figure = paint_limit_cycle_condition(loop, transformation)
    cycles = [
        f"{c.frequency_hz:.1f} Hz at {c.iteration_error:.3g} m/s² ({'stable' if c.stable else 'unstable'})"
        for c in limit_cycles(loop, transformation, region)
    ]
    low, high = region.limits
    figure.axes[0].set_title(
        f"stable gains {low:.3g} to {high:.3g}, here {transformation.local_gain:.3g}\n"
        f"cycles: {', '.join(cycles) or 'none'}"
    )
    return figure


def paint_low_pass(exponent: float, bandwidth: float, strength: float):
    """The low pass with other settings than the paper's, in large Gaussian noise."""
    transformation = RobustTransformation(slope=strength / (4e7 * 1.05))
    chosen = Controller(LowPass(bandwidth), transformation, KinematicDesign(exponent), _approximate())
    runs = _driven({LOW_PASS: chosen}, asin_trajectory(), Noise("gaussian", 1e-4))
    return _paint_error_lines(runs, "large Gaussian noise")


def paint_shift(frequency_hz: float, exponent: float):
    """Both forms of the Kalman filter without noise: the printed one tracks late by one sample."""
    trajectory, published = asin_trajectory(frequency_hz=frequency_hz), published_controllers(_approximate())
    moved = {
        name: replace(published[name], kinematics=KinematicDesign(exponent)) for name in (KALMAN, LITERAL)
    }
    figure = _paint_error_lines(_driven(moved, trajectory, Noise()), "without noise", (0.0, 12.0))
    [axes] = figure.axes
    nominal = trajectory.time[::20], trajectory.velocity[::20]
    axes.plot(*nominal, "k:", lw=1, label="1 ms times the nominal velocity")
    axes.legend(fontsize=7)
    return figure
