"""The paper's other misprints in the loop, and how the shift of (14) follows the velocity: what notebook 08 alone needs."""

from dataclasses import replace

import numpy as np

from experiments.fixedpoint.axes import COLOURS, legend_above
from experiments.fixedpoint.error_lines import approximate, paint_error_lines
from experiments.fixedpoint.metrics import compare, sweep
from experiments.fixedpoint.noise import Noise
from experiments.fixedpoint.oscillator import load_oscillator
from experiments.fixedpoint.published import KALMAN, LITERAL, published_controllers
from experiments.fixedpoint.run_pictures import paint_errors_over_frequency
from stillwork.control.controlled_run import ControlledRun
from stillwork.control.fixed_point import Controller
from stillwork.control.kinematics import KinematicDesign
from stillwork.control.trajectory import Trajectory, asin_trajectory
from stillwork.estimation.unscented import SigmaPoints
from workbook import figures

FREQUENCIES_HZ = (0.1, 0.15, 0.2, 0.3, 0.4)


def paint_shift(frequency_hz: float, exponent: float):
    """Both forms of the Kalman filter without noise: the printed one tracks late by one sample."""
    trajectory, published = asin_trajectory(frequency_hz=frequency_hz), published_controllers(approximate())
    moved = {
        name: replace(published[name], kinematics=KinematicDesign(exponent)) for name in (KALMAN, LITERAL)
    }
    figure = paint_error_lines(moved, trajectory, Noise(), "without noise", (0.0, 12.0))
    [axes] = figure.axes
    nominal = trajectory.time[::20], trajectory.velocity[::20]
    axes.plot(*nominal, "k:", lw=1, label="1 ms times the nominal velocity")
    axes.legend(fontsize=7)
    return figure


def paint_estimate_shift(runs: dict[str, ControlledRun]):
    """Error of the filter's estimates against the derivative, after 2 s: a shift in time is a straight line."""
    figure, panels = figures.new(1, 2, height=3.4)
    rows = (
        ("position", "velocity", "velocity q' (m/s)", "error of the estimate of q (mm)"),
        ("velocity", "deformed", "the model's acceleration (m/s²)", "error of the estimate of q' (mm/s)"),
    )
    step_ms = 1e3 * next(iter(runs.values())).trajectory.sample_time
    part = slice(round(2e3 / step_ms), None, 40)
    for axes, (quantity, derivative, across, up) in zip(panels, rows, strict=True):
        for name, run in runs.items():
            error = 1e3 * (getattr(run, f"{quantity}_estimate") - getattr(run, quantity))[part]
            axes.plot(getattr(run, derivative)[part], error, ".", ms=3, color=COLOURS[name], label=name)
        reach = np.array(axes.get_xlim())
        axes.plot(reach, step_ms * reach, "k:", lw=1, label=f"one sample ({step_ms:g} ms) ahead")
        axes.set(xlabel=across, ylabel=up)
    legend_above(panels[0])
    return figure


def appendix(
    page, *, controllers: dict[str, Controller], trajectory: Trajectory, noise_m: float, runs: int, seed: int
) -> None:
    """What this notebook judges beside its answer: the shift over frequencies, and the other misprints.

    Parameters
    ----------
    page : workbook.appendix.Appendix
    controllers : dict of Controller
        The Kalman filter in both forms.
    trajectory : Trajectory
    noise_m : float
        Standard deviation of the large noise, m.
    runs, seed : int
    """
    exact, sample_time = load_oscillator()["exact"].plant, trajectory.sample_time
    page.text(
        "## It follows the velocity\n\nWithout noise, the printed filter's tracking error over the RMS travel of one sample:"
    )
    swept = sweep(exact, controllers, Noise(), FREQUENCIES_HZ, runs=2, seed=seed)
    for frequency, found in zip(FREQUENCIES_HZ, swept, strict=True):
        speed = asin_trajectory(frequency_hz=frequency, sample_time=sample_time).velocity
        travel = sample_time * np.sqrt(np.mean(speed[round(2 / sample_time) :] ** 2))
        page.show(f"{frequency:.2f} Hz: {found[LITERAL]['position'][0] / travel:.3f}")
    page.save("errors-over-frequency", paint_errors_over_frequency(FREQUENCIES_HZ, {"no noise": swept}))
    page.text(MISPRINTS)
    points = SigmaPoints()
    spread = points.alpha**2 * (2 + points.kappa)  # L + lambda
    page.check("fixedpoint.eq-12.as-printed", (spread - 1) / spread)
    printed = as_printed(controllers[KALMAN], points)
    large = Noise("gaussian", noise_m)
    found = compare(exact, printed | {KALMAN: controllers[KALMAN]}, trajectory, large, runs=runs, seed=seed)
    worst = 0.0
    for name in printed:
        q, speed = (
            found[name][each].mean() / found[KALMAN][each].mean() for each in ("position", "velocity")
        )
        page.show(f"{name}: errors over the corrected filter's: q {q:.4f}, q' {speed:.4f}")
        page.check(f"fixedpoint.{name}", speed)
        worst = max(worst, q, speed)
    page.conclude("The costliest of these misprints raises an error {worst:.2f} times.", worst=worst)


def as_printed(corrected: Controller, points: SigmaPoints) -> dict[str, Controller]:
    """The corrected filter with one misprint each, by the ledger's names."""
    kalman = corrected.signal_filter
    thin = replace(load_oscillator()["approximate"], damping=0.0, drag=0.0).plant
    weight = replace(points, beta=points.beta + points.alpha**2 - points.alpha)  # gives the printed W0c
    misprints = {
        "eq-10.as-printed": replace(kalman, plant=thin),
        "table-2.weight-as-printed": replace(kalman, points=weight),
        "eq-17.gain-as-printed": replace(kalman, noise=1e-9 * np.asarray(kalman.noise)),  # K = I
    }
    return {name: replace(corrected, signal_filter=each) for name, each in misprints.items()}


MISPRINTS = r"""## The other misprints

What cannot be meant as printed, and what we run instead:

| place | printed | meant |
|---|---|---|
| (6) | $A$ in s⁻² | m/s² a step |
| after (9) | $w_k = 0$, beside $Q = \mathrm{diag}(0.1, 0.001)$ after (13) | a process noise of covariance $Q$ |
| (10) | without $b_2$ and $d$ | all terms of (11) |
| Table I | $d$ in N s² m⁻³ | N s² m⁻² |
| (12), (14) | $\sqrt{(1+\lambda)P}$, $\sqrt{(2+\lambda)P}$ | $\sqrt{(L+\lambda)P}$ in every column |
| Table II | $W_0^c$ with $1 - \alpha + \beta$ | $1 - \alpha^2 + \beta$ |
| (13) | about $\hat q_k$, which is not yet computed | about $\hat q_k^-$ |
| above (17) | $K = P_{q_k z_k} P_{q_k z_k}^{-1}$ | $P_{q_k z_k} P_{z_k^- z_k^-}^{-1}$ |
| (21) | announced as a standard deviation | a variance (notebook 5) |

With $\lambda = \alpha^2 (L + \kappa) - L$ of Table II the first root of (12) is that of a negative number. Squared, the printed points carry

$$2 W_i\,(1 + \lambda) = \frac{1 + \lambda}{L + \lambda}$$

of the variance that they represent, where 1 is required. The printed gain is the identity: the estimate follows every measurement fully. Below, (10), the weight and the gain as printed run in the loop in large Gaussian noise, with (14) corrected."""
