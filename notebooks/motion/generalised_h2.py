r"""Generalised H2 norm (energy to peak) of time-varying filters, section 5.5 of the observer thesis.

The error :math:`e_{k+1} = F_ke_k + D_kn_k` responds to energy-bounded disturbances n. Its largest possible peak over
:math:`\|n\|_2 \le 1` is the root of the largest eigenvalue that the reachability Gramian
:math:`P_{k+1} = F_kP_kF_k^T + D_kD_k^T` ever has: the same recursion that gives a covariance.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import pandas as pd
from jaxtyping import Float64
from numpy.typing import ArrayLike

from experiments.motion.scan_study import output_rows, published_scan
from stillwork.base.algebra import add_square, congruence
from stillwork.base.checks import InputError
from stillwork.base.kernels import kernel
from stillwork.estimation.riccati import discrete_gain
from stillwork.lti.discretisation import zoh_modes
from workbook import figures
from workbook.studies import fraction

SLACK = 1e-9  # relative, of what fulfils a strict inequality


@dataclass(frozen=True)
class ErrorSystem:
    """Error dynamics of a predictor with gain L and unit noise: F = A - L C, D = [G Q^1/2, -L R^1/2]."""

    f: Float64[np.ndarray, "samples states states"]
    d: Float64[np.ndarray, "samples states noises"]


def error_system(
    a: ArrayLike, g: ArrayLike, c: ArrayLike, process: ArrayLike, sensor: ArrayLike, gains: ArrayLike
):
    """Error dynamics of a predictor with any gains, for covariances or weights of bounded energy."""
    a, g, c, gains = (np.asarray(each, float) for each in (a, g, c, gains))
    samples, _, n = c.shape
    roots = np.linalg.cholesky(process), np.linalg.cholesky(sensor)
    driven = np.broadcast_to(g @ roots[0], (samples, n, g.shape[1]))
    return ErrorSystem(a - gains @ c, np.concatenate([driven, -gains @ roots[1]], axis=2))


def predictor_gains(
    a: ArrayLike, g: ArrayLike, c: ArrayLike, process: ArrayLike, sensor: ArrayLike
) -> Float64[np.ndarray, "samples states outputs"]:
    """Gains of the time-varying Kalman predictor that starts from a known state, (5.37).

    Parameters as for `error_system`. Known state: the disturbances are all that drives the error, as the
    definition of the norm has it.
    """
    c = np.asarray(c, float)
    samples, outputs, n = c.shape
    a, g = np.asarray(a, float), np.asarray(g, float)
    q = g @ np.asarray(process, float) @ g.T
    r = np.asarray(sensor, float)
    p, gains = np.zeros((n, n)), np.zeros((samples, n, outputs))
    for k in range(samples):
        gains[k], p = _predicted(a, c[k], p, q, r)
    return gains


def _predicted(a, c, p, q, r) -> tuple[np.ndarray, np.ndarray]:
    """Gain of the predictor and covariance after one sample, (5.37)."""
    gain = np.linalg.solve(c @ p @ c.T + r, c @ p @ a.T).T
    rest = a - gain @ c
    return gain, rest @ p @ rest.T + gain @ r @ gain.T + q


@dataclass(frozen=True)
class PeakGain:
    """Generalised H2 norm, and the disturbance that reaches it."""

    norm: float
    sample: int  # where the largest peak can occur
    gramians: Float64[np.ndarray, "ends states states"]  # P_k; index 0 is zero
    worst: Float64[np.ndarray, "samples noises"]  # unit-energy disturbance with this peak


def generalised_h2_norm(system: ErrorSystem) -> PeakGain:
    """Generalised H2 norm over the horizon, exactly, with its worst-case disturbance."""
    gramians = np.zeros((len(system.f) + 1, *system.f.shape[1:]))
    _gramians(np.ascontiguousarray(system.f), np.ascontiguousarray(system.d), gramians)
    largest = np.linalg.eigvalsh(gramians)[:, -1]
    if not np.all(np.isfinite(largest)):
        raise InputError("the error grows without bound; give gains that keep it stable")
    sample = int(largest.argmax())
    worst = np.zeros(system.d.shape[::2])
    back = np.linalg.eigh(gramians[sample])[1][:, -1]  # the direction of the peak
    for k in range(sample - 1, -1, -1):
        worst[k] = system.d[k].T @ back
        back = system.f[k].T @ back
    size = np.linalg.norm(worst)
    return PeakGain(float(np.sqrt(largest[sample])), sample, gramians, worst / (size or 1.0))


@kernel
def _gramians(f, d, out):
    half = np.empty(f.shape[1:])
    for k in range(len(f)):
        congruence(f[k], out[k], half, out[k + 1])
        add_square(d[k], out[k + 1])


def inequality_margins(system: ErrorSystem, level: float) -> tuple[float, float]:
    r"""Smallest eigenvalues of (5.30) and (5.31) over the samples for the matrices that fulfil them if any do.

    With :math:`K_k=\gamma P_k^{-1}`, P the Gramian with a factor 1 + `SLACK` a step, (5.30) is P above what one step
    makes of it, and (5.31) :math:`P\prec\gamma^2I`. Both are scaled so that the diagonal blocks are unit matrices.
    """
    n = system.f.shape[1]
    start = SLACK * np.abs(system.d[0] @ system.d[0].T).max() * np.eye(n)
    p, first, second = start, np.inf, np.inf
    for f, d in zip(system.f, system.d, strict=True):
        following = (1 + SLACK) * (f @ p @ f.T + d @ d.T) + start
        root, next_root = np.linalg.cholesky(p), np.linalg.cholesky(following)
        coupling = np.linalg.solve(next_root, np.hstack([f @ root, d]))
        block = np.block([[np.eye(n), coupling], [coupling.T, np.eye(coupling.shape[1])]])
        first = min(first, np.linalg.eigvalsh(block)[0])
        second = min(second, 1 - np.linalg.eigvalsh(following)[-1] / level**2)
        p = following
    return float(first), float(second)


def settled_covariance(a, g, c, process, sensor, start, steps: int) -> Float64[np.ndarray, "states states"]:
    """Covariance of the Kalman predictor after so many steps of (5.37) with one C, from any `start`."""
    a, g, c, process, sensor, p = map(np.asarray, (a, g, c, process, sensor, start))
    driven = g @ process @ g.T
    for _ in range(steps):
        _, p = _predicted(a, c, p, driven, sensor)
    return p


def response_peak(system: ErrorSystem, disturbance: ArrayLike) -> float:
    """Largest Euclidean norm of the error under a disturbance, by simulation."""
    disturbance = np.asarray(disturbance, float)
    e, peak = np.zeros(system.f.shape[1]), 0.0
    for f, d, n in zip(system.f, system.d, disturbance, strict=True):
        e = f @ e + d @ n
        peak = max(peak, float(np.linalg.norm(e)))
    return peak


@cache
def scaled_scan(sample_time: float, spacing: float = 0.05):
    """Sampled model and output rows of the published scan, states in displacements, lengths in nanometres.

    A, B, the rows of C, and the deviations of force (N), sensor reference and sensor noise (m).
    """
    scan = published_scan(spacing=spacing, sample_time=sample_time)
    sampled = zoh_modes(scan.nominal, sample_time)
    flexible = scan.nominal.frequencies[1:]
    scale = np.array([1.0, flexible[0], *np.repeat(flexible, 2) ** np.array([0, 1, 0, 1])])
    c = 1e9 * output_rows(scan.shapes) * scale
    return sampled.a * scale / scale[:, None], sampled.b / scale[:, None], c, scan.deviations


def paint_worst(force: float, detuning: float):
    """Explorer: what the worst disturbance does to a filter designed for `detuning` times the `force` (N)."""
    sample_time = 1e-3
    a, b, c, (_, reference, sensor) = scaled_scan(sample_time)
    noise = 1e18 * np.array([[reference**2 + sensor**2]])
    process = np.array([[force**2]])
    figure, (left, right) = figures.new(1, 2, height=2.8)
    time = sample_time * np.arange(len(c))
    for name, designed in (("Kalman", 1.0), ("detuned", detuning)):
        gains = predictor_gains(a, b, c, designed**2 * process, noise)
        found = generalised_h2_norm(error_system(a, b, c, process, noise, gains))
        peak = np.sqrt(np.linalg.eigvalsh(found.gramians[1:])[:, -1])
        left.semilogy(time, 1e9 * peak, label=f"{name}: {1e9 * found.norm:.3g}")
        right.plot(time, found.worst[:, 0], label=name)
    left.set_ylabel("largest possible error ($10^{-9}$ m√kg)")
    right.set_ylabel("worst force (in deviations)")
    figures.label((left, right), "time (s)")
    left.legend()
    return figure


def other_filters(
    a, b, c, process, noise, gains, found: PeakGain, trials: int, rng: np.random.Generator
) -> pd.DataFrame:
    """Randomly changed gains, the gain frozen at its last value, and a filter designed for a hundred times the force.

    A row a filter: its norm over the Kalman filter's, and whether its Gramian exceeds that filter's at every sample.
    """
    tried = [
        (f"gains off by {100 * part:.0f} %", gains * (1 + part * rng.standard_normal(gains.shape)))
        for part in (0.01, 0.1, 0.3)
        for _ in range(trials // 3)
    ]
    tried.append(("last gain, frozen", np.broadcast_to(gains[-1], gains.shape)))
    tried.append(("designed for 100 times the force", predictor_gains(a, b, c, 1e4 * process, noise)))
    rows = []
    for name, other in tried:
        own = generalised_h2_norm(error_system(a, b, c, process, noise, other))
        lowest = np.linalg.eigvalsh(own.gramians[1:] - found.gramians[1:])[:, 0]
        largest = np.linalg.eigvalsh(own.gramians[1:])[:, -1]
        rows.append((name, own.norm / found.norm, bool(np.all(lowest >= -1e-10 * largest))))
    return pd.DataFrame(rows, columns=["filter", "norm", "above"])


def paint_worst_disturbance(system: ErrorSystem, found: PeakGain, sample_time: float):
    """Largest peak possible over time, the error under the worst disturbance, and that disturbance before the peak."""
    figure, (top, bottom) = figures.new(2, 1)
    time = sample_time * np.arange(len(system.f))
    possible = np.sqrt(np.linalg.eigvalsh(found.gramians[1:])[:, -1]) / found.norm
    top.plot(time, possible, label="largest peak possible so far")
    error, sizes = np.zeros(system.f.shape[1]), []
    for f, d, n in zip(system.f, system.d, found.worst, strict=True):
        error = f @ error + d @ n
        sizes.append(np.linalg.norm(error) / found.norm)
    top.plot(time, sizes, label="error under the worst disturbance")
    top.set(title="the whole move", ylabel="size of the error\nover the norm")
    top.legend()
    bottom.plot(time, found.worst[:, 0], label="force")
    bottom.plot(time, found.worst[:, 1], label="sensor")
    last = time[found.sample] + np.array([-0.03, 0.005])  # s, around the largest peak
    bottom.set(
        title="the last 30 ms before the peak", xlim=last, ylabel="worst disturbance\n(standard deviations)"
    )
    figures.label((top, bottom), "time (s)")
    bottom.legend()
    return figure


def appendix(page, *, system: ErrorSystem, found: PeakGain, rivals: pd.DataFrame, still: tuple) -> None:
    """What the page of motion/22 judges beside its answer; `still` is (A, B, C, Q, R) with the sensor at rest."""
    page.text("""## Any other filter is worse

By the proof, at every sample the Gramian of any other predictor exceeds that of the Kalman filter in every direction. Norms over the
Kalman filter's:""")
    each = rivals.groupby("filter", sort=False)
    table = pd.concat([each["norm"].min(), each["norm"].median(), each["above"].mean()], axis=1)
    table.columns = ["least norm over Kalman's", "median", "Gramian above, fraction"]
    page.show(table.rename_axis(None).round(4))
    page.check("motion.theorem-5-5-1.gramians", *fraction(rivals["above"].to_numpy()))
    page.text(r"""## The lemma and the corollary

Lemma 5.5.2: a gain achieves a norm below $\gamma$ exactly if there are matrices $K_k$ with

$$\begin{bmatrix}K_{k+1}&K_{k+1}F_k&K_{k+1}D_k\\ \cdot&K_k&0\\ \cdot&\cdot&\gamma I\end{bmatrix}\succ0,\qquad
\begin{bmatrix}K_k&0&I\\ \cdot&I&0\\ \cdot&\cdot&\gamma I\end{bmatrix}\succ0 .$$

We set $K_k=\gamma P_k^{-1}$ with $P_k$ slightly above the Gramian. For $\gamma$ 0.1 % above the Kalman filter's norm both hold at
every sample. For $\gamma$ 0.1 % below it the second fails for every $K_k$, because the first forces $P_k$ above the Gramian.

Corollary 5.5.2: with the sensor at rest, the recursion converges to the solution of the algebraic equation. It does, from zero and
from a large covariance.""")
    above, below = (inequality_margins(system, part * found.norm) for part in (1.001, 0.999))
    page.check("motion.lemma-5-5-2.feasible", float(min(above) > 0))
    page.check("motion.lemma-5-5-2.infeasible", float(below[1] < 0))
    settled = discrete_gain(*still).covariance
    size = np.sqrt(np.diag(settled))
    apart = [
        np.abs((settled_covariance(*still, start, 20_000) - settled) / np.outer(size, size)).max()
        for start in (np.zeros_like(settled), 100 * np.diag(np.diag(settled)))
    ]
    page.check("motion.corollary-5-5-2.converges", max(apart))
