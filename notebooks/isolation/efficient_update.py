"""The FeRLS update before it is made efficient: Section 4.3 and the appendices, equation by equation.

These forms exist to be compared with: they give the same weights as the recursion of `adaptation` at a cost that
grows with the third power of the number of parameters.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.checks import require_array, require_choice, require_count, require_number
from stillwork.estimation import FeLms, FeRls, identify
from workbook import figures

FORMS = ("full inverse", "Newton", "block inverse")


@dataclass(frozen=True)
class DirectRun:
    """Identification with one of the direct forms."""

    weights: Float64[np.ndarray, "samples actuators n"]  # W after every sample
    # adaptation gain matrix after the last sample: of all parameters (26), or P (28)
    gain: Float64[np.ndarray, "parameters parameters"]

    @property
    def blocks(self) -> Float64[np.ndarray, "actuators actuators n n"]:
        """Blocks of the gain matrix, eq. (27)."""
        n = self.weights.shape[2]
        count = len(self.gain) // n
        return np.ascontiguousarray(self.gain.reshape(count, n, count, n).transpose(0, 2, 1, 3))


def direct_run(
    form: str, regressors: ArrayLike, disturbance: ArrayLike, epsilon: float, forgetting: float
) -> DirectRun:
    """Fit weights to a record as `identify` does, with a matrix inverse at every sample; the error is e = d + W psi_N.

    ``full inverse``: eq. (25)-(26), the information matrix of all parameters. ``Newton``: eq. (20)-(24), the same
    with the Hessian as a sample average and the step alpha. ``block inverse``: eq. (28), one block. P(-1) = I /
    epsilon.
    """
    require_choice("form", form, FORMS)
    regressors = require_array("regressors", regressors, ndim=2)
    n, samples = regressors.shape
    disturbance = require_array("disturbance", disturbance, shape=(None, samples))
    actuators = len(disturbance)
    require_number("epsilon", epsilon, above=0.0)
    require_number("forgetting", forgetting, above=0.0, at_most=1.0)
    alpha = average_gain(forgetting, samples)
    copies = 1 if form == "block inverse" else actuators
    information = epsilon * np.eye(copies * n)
    w = np.zeros((actuators, n))
    history = np.empty((samples, actuators, n))
    for k, (psi, d) in enumerate(zip(regressors.T, disturbance.T, strict=True)):
        error = d + w @ psi
        matrix = np.kron(np.eye(copies), psi)  # Psi_N, eq. (14)
        information = forgetting * information + matrix.T @ matrix
        if form == "Newton":
            hessian = alpha[k] * information  # eq. (21)
            gain = alpha[k] * np.linalg.inv(hessian)
        else:
            gain = np.linalg.inv(information)
        if copies == actuators:
            w = w - (gain @ matrix.T @ error).reshape(actuators, n)
        else:
            w = w - np.outer(error, gain @ psi)
        history[k] = w
    return DirectRun(history, gain)


def differences(direct: Mapping[str, DirectRun], recursion) -> dict[str, Float64[np.ndarray, " samples"]]:
    """Largest distance of each form's weights from the recursion's after every sample, over the largest weight."""
    scale = np.abs(recursion.history).max()
    return {
        form: np.abs(one.weights - recursion.history).max(axis=(1, 2)) / scale for form, one in direct.items()
    }


def largest_condition(regressors: ArrayLike, epsilon: float, forgetting: float) -> float:
    """Largest condition number of the information matrix of one block on the way, eq. (28).

    The matrix of all parameters repeats the block, so it has the same one.
    """
    regressors = require_array("regressors", regressors, ndim=2)
    require_number("epsilon", epsilon, above=0.0)
    require_number("forgetting", forgetting, above=0.0, at_most=1.0)
    information, largest = epsilon * np.eye(len(regressors)), 1.0
    for psi in regressors.T:
        information = forgetting * information + np.outer(psi, psi)
        largest = max(largest, float(np.linalg.cond(information)))
    return largest


def average_gain(forgetting: float, samples: int) -> Float64[np.ndarray, " samples"]:
    """alpha(k) that makes an exponentially weighted sum an average, eq. (22) and (B.4)."""
    require_number("forgetting", forgetting, above=0.0, at_most=1.0)
    count = np.arange(1.0, require_count("samples", samples) + 1)
    if forgetting == 1:
        return 1 / count
    # expm1 keeps the digits of 1 - lambda^(k+1) while that is small.
    return (1 - forgetting) / -np.expm1(count * np.log(forgetting))


def multiplications(actuators: int, regressors: int) -> Mapping[str, int]:
    """Multiplications and divisions of one update in each form, every matrix taken as dense; without filters.

    An inverse by Gauss and Jordan takes N³ of them.
    """
    m = require_count("actuators", actuators)
    n = require_count("regressors", regressors)
    full = m * n
    return {
        # lambda A, Psi' Psi, inverse, Psi' e, gain times that
        "full inverse": full**2 + full**2 * m + full**3 + full * m + full**2,
        # P Psi', Psi P Psi', inverse, gain, gain times (P Psi')', 1 / lambda, W: no block repeats
        "FxRLS": 2 * full**2 * m + full**2 + 2 * full * m**2 + m**3 + full * m,
        # the same as the first for one block: lambda A, psi psi', inverse, P psi, W
        "block inverse": 2 * n**2 + n**3 + n**2 + m * n,
        # P psi, psi' P psi, its share; two reciprocals; the triangle; W
        "recursion": n**2 + 2 * n + 2 + n + n * (n + 1) + m * n,
        # psi' psi, trace and rate, rate times e, W
        "FeLMS": n + 2 + m + m * n,
    }


_NAMES = {
    "full inverse": "54 × 54 inverse, (25)-(26)",
    "FxRLS": "FxRLS, 54 × 54 recursion",
    "block inverse": "9 × 9 inverse, (28)",
    "recursion": "9 × 9 recursion, (29)-(30)",
    "FeLMS": "FeLMS, (19)",
}


def paint_agreement(
    time_s: ArrayLike, recursion: ArrayLike, differences: Mapping[str, ArrayLike], bound: float
):
    """Weights of one actuator by the recursion, (samples, n), and how far the direct forms are from it.

    Differences are relative to the largest weight; drawn is the largest so far: that of one sample is a draw of
    rounding. `bound` is what rounding may reach.
    """
    figure, (upper, lower) = figures.new(2, 1, height=4.8, sharex=True)
    for number, row in enumerate(np.transpose(recursion), 1):
        color = (figures.BLUE, figures.RED, figures.GREEN)[(number - 1) // 3]
        upper.plot(time_s, row, ("-", "--", ":")[(number - 1) % 3], color=color, label=f"w{number}")
    for style, (name, difference) in zip(("-", "--", ":"), differences.items(), strict=True):
        so_far = np.maximum.accumulate(np.maximum(difference, np.finfo(float).eps))
        lower.semilogy(time_s, so_far, style, label=name)
    lower.axhline(bound, color=figures.BLACK, lw=0.8, ls="-.", label="bound of rounding")
    upper.set(ylabel="weight of the first\nactuator (N per m/s²)", title="recursion")
    lower.set(xlabel="time (s)", ylabel="relative difference")
    lower.set(title="direct forms to recursion, all weights, so far")
    upper.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    lower.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


PRINTED_US = 140.0  # section 5.1.2, of either algorithm, on its hardware


def paint_costs(
    actuators: int, regressors: int, times: Mapping[str, Mapping[str, float]], sample_time: float
):
    """Multiplications of each form, and measured times against the sample time."""
    figure, (upper, lower) = figures.new(2, 1, height=4.6)
    counts = multiplications(actuators, regressors)
    _bars(upper, {_NAMES[name]: count for name, count in counts.items()}, "{:,.0f}")
    upper.set(xlabel="multiplications and divisions per sample")
    upper.set(title=f"{actuators} outputs × {regressors} regressors")
    shown = {**_NAMES, "C": "the recursion in C"}
    _bars(lower, {text: times[name]["median_us"] for name, text in shown.items() if name in times}, "{:.2g}")
    lower.axvline(1e6 * sample_time, color=figures.BLACK, lw=1, ls="--")
    style = {"va": "center", "fontsize": 8, "textcoords": "offset points"}
    lower.annotate(
        f"sample time, {1e6 * sample_time:.0f} µs", (1e6 * sample_time, 3.0), (3, 0), ha="left", **style
    )
    lower.axvline(PRINTED_US, color=figures.BLACK, lw=1, ls=":")
    lower.annotate("published: the whole controller, 140 µs", (PRINTED_US, 2.0), (-3, 0), ha="right", **style)
    lower.set(xlabel="measured time per update (µs)", title="measured, 6 outputs × 9 regressors")
    return figure


def explore_costs(actuators: int, regressors: int):
    """Multiplications of each form for any size; what the recursion saves."""
    figure, axes = figures.new(1, 1, height=2.6)
    counts = multiplications(actuators, regressors)
    names = {
        "full inverse": "inverse of all parameters",
        "FxRLS": "FxRLS",
        "block inverse": "inverse of one block",
        "recursion": "recursion",
        "FeLMS": "FeLMS",
    }
    _bars(axes, {names[name]: count for name, count in counts.items()}, "{:,.0f}")
    saved = counts["full inverse"] / counts["recursion"]
    axes.set(
        xlabel="multiplications and divisions per sample",
        title=f"{actuators * regressors} parameters: the recursion takes {saved:,.0f} times fewer than the inverse",
    )
    return figure


def _bars(axes, values: Mapping[str, float], text: str):
    """Horizontal bars on a logarithmic axis with their numbers beside them, first on top."""
    place = np.arange(len(values))
    numbers = list(values.values())
    axes.barh(place, numbers, color=figures.SKY, height=0.6)
    axes.plot(numbers, place, "|", color=figures.SKY, ms=8, mew=2, label="value")
    for y, number in zip(place, numbers, strict=True):
        style = {"xytext": (5, 0), "textcoords": "offset points", "va": "center", "fontsize": 8}
        axes.annotate(text.format(number), (number, y), **style)
    axes.set(xscale="log", xlim=(min(numbers) / 3, max(numbers) * 30))
    axes.set_yticks(place, list(values))
    axes.set_ylim(len(values) - 0.4, -0.8)
    axes.grid(visible=False, axis="y")


# === Appendix =====================================================================================================


def hessian_of_felms(regressors: ArrayLike) -> dict[str, float]:
    """How far the Hessian (31) of FeLMS is from the mean of the regressors' products, for both reasons of section 4.4.

    ``spread``: largest over smallest eigenvalue of the mean products, ``powers``: the same of their diagonal alone; both
    are one in (31). ``scatter``: standard deviation over mean of the trace, ``inverse``: mean of its inverse over the
    inverse of its mean.
    """
    psi = require_array("regressors", regressors, ndim=2)
    traces = 1e-5 + np.sum(psi**2, axis=0)
    powers = np.mean(psi**2, axis=1)
    return {
        "spread": float(np.linalg.cond(psi @ psi.T / psi.shape[1])),
        "powers": float(powers.max() / powers.min()),
        "scatter": float(traces.std() / traces.mean()),
        "inverse": float(np.mean(1 / traces) * traces.mean()),
    }


def appendix(
    page,
    *,
    run,
    longer,
    direct: Mapping[str, DirectRun],
    recursion,
    forgetting: float,
) -> None:
    """What this notebook judges beside its answer.

    Parameters
    ----------
    page : workbook.appendix.Appendix
    run, longer : Run
        The short record of the direct forms, and one of 20 s.
    direct : mapping of str to DirectRun
    recursion : Identification
        Of the same record.
    forgetting : float
    """
    page.text("""## Block structure and the matrix inversion lemma: (27), Appendix A

One block repeats on the diagonal, and the recursion's $P$ is the inverse that (A.5) defines.""")
    blocks = direct["full inverse"].blocks
    first, size = blocks[0, 0], np.abs(blocks[0, 0]).max()
    elsewhere = ~np.eye(len(blocks), dtype=bool)
    page.check("isolation.update.blocks.off-diagonal", float(np.abs(blocks[elsewhere]).max() / size))
    repeated = blocks[range(len(blocks)), range(len(blocks))]
    page.check("isolation.update.blocks.repeated", np.abs(repeated - first).max() / size)
    page.check("isolation.update.appendix-a", np.abs(recursion.covariance - first).max() / size)
    page.show(
        f"{np.count_nonzero(blocks[elsewhere])} of {blocks[elsewhere].size} elements outside the diagonal blocks differ from zero"
    )
    page.text(r"""## The gain that makes an average: (22), Appendix B

$\alpha(k)\sum_j\lambda^{k-j} = 1$ for every $k$; the gain falls from one to $1-\lambda$.""")
    count = 200_000
    alpha = average_gain(forgetting, count)
    page.check(
        "isolation.update.appendix-b", np.abs(alpha * np.cumsum(forgetting ** np.arange(count)) - 1).max()
    )
    page.check("isolation.update.gain-start", alpha[0])
    page.check("isolation.update.gain-limit", average_gain(forgetting, 2_000_000)[-1] / (1 - forgetting))
    _of_newton(page, run.filtered_regressors, run.error)
    _of_whitening(page, longer.filtered_regressors, longer.error, forgetting)


def _of_newton(page, regressors: np.ndarray, disturbance: np.ndarray) -> None:
    page.text(r"""## FeLMS is Newton's method with a poor Hessian: (31)

With $A^{-1} = 54/(\varepsilon + \mathrm{Tr}(\Psi_N^T\Psi_N))\,I$ and the step $\bar\mu/54$, Newton's update (20) is (19): one step
from zero weights on every sample.""")
    felms = FeLms(step_size=1e-4, regularisation=1e-5, trace="literal")
    parameters = disturbance.shape[0] * regressors.shape[0]
    traces = disturbance.shape[0] * np.sum(regressors**2, axis=0)
    inverse_hessians = parameters / (felms.regularisation + traces)
    newton_steps = -(felms.step_size / parameters) * inverse_hessians * disturbance[:, None] * regressors
    samples = zip(regressors.T, disturbance.T, strict=True)
    steps = np.stack([identify(felms, psi[:, None], d[:, None]).weights for psi, d in samples], axis=-1)
    page.check("isolation.update.equation-31", np.abs(steps - newton_steps).max() / np.abs(steps).max())


def _of_whitening(page, psi: np.ndarray, d: np.ndarray, forgetting: float) -> None:
    page.text(r"""## Neither whitening nor an orthonormal basis

Section 6 concludes that the covariance makes both obsolete. With regressors $T\psi$, covariance $T^{-T}PT^{-1}$ and weights
$WT^{-1}$, (29) and (30) give the same commands, as long as $P$ has no limit along axes (the printed algorithm). FeLMS has no such
invariance. Share of the disturbance's power left in the last quarter of 20 s:""")
    transform = np.linalg.inv(np.linalg.cholesky(psi @ psi.T / psi.shape[1]))
    back = np.linalg.inv(transform)
    start = np.diag((1 - forgetting) / np.mean(psi**2, axis=1))
    bases = {"as they are": (psi, start), "orthonormal": (transform @ psi, back.T @ start @ back)}
    commands, left = {}, {}
    for name, (basis, covariance) in bases.items():
        for settings in (FeRls(covariance, forgetting, np.inf), FeLms()):
            history = identify(settings, basis, d, every=10).history
            command = np.einsum("kar,rk->ak", history, basis[:, 9::10])
            key = f"{type(settings).__name__}, {name}"
            quarter = slice(-command.shape[1] // 4, None)
            left[key] = np.mean((d[:, 9::10] + command)[:, quarter] ** 2) / np.mean(
                d[:, 9::10][:, quarter] ** 2
            )
            commands[key] = command
    one, other = (commands[f"FeRls, {name}"] for name in bases)
    page.check("isolation.update.no-whitening", np.abs(one - other).max() / np.abs(one).max())
    page.show(*(f"{name}: {100 * share:.2f} %" for name, share in left.items()))
