"""Numerical stability of the covariance recursion: what this notebook alone needs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float32, Float64
from numpy.typing import ArrayLike

from experiments.isolation.floors import SAMPLE_RATE, SENSORS, ShapedFloor, flat_floor
from experiments.isolation.recorded_floors import RecordedFloor, ground_spectrum
from experiments.isolation.simulation import Run, simulate
from experiments.isolation.steady import steady_state
from experiments.isolation.twin import Twin, load_twin
from stillwork.base.algebra import add_scaled, plus_column, plus_left, plus_row, project
from stillwork.base.checks import (
    InputError,
    pluralise,
    require_array,
    require_choice,
    require_count,
    require_number,
)
from stillwork.base.kernels import borrowing_kernel, inlined_kernel
from stillwork.estimation.adaptive import FeRls
from stillwork.estimation.covariance_forms import (
    factor_of,
    update_covariance,
    update_ud,
    upper_root,
)
from stillwork.signals import load_record
from stillwork.signals.records import Record, resample, to_acceleration
from workbook import figures, paths


def synthesise_floor(
    frequencies_hz: ArrayLike,
    density: ArrayLike,
    duration: float,
    seed: int,
    *,
    common: float = 0.0,
    sample_rate: float = SAMPLE_RATE,
) -> RecordedFloor:
    """Gaussian motion of the sensors whose expected PSD is exactly the given one on every line 1/duration.

    Each Fourier line gets a random amplitude and phase; the motion is stationary and its end joins its start.
    Between the given frequencies, which rise, the one-sided density, (m/s^2)^2/Hz, runs straight; outside it is zero.
    `common` is the share of the power that all sensors see alike, 0 (independent, as the paper's three shakers) to 1
    (the plate only translates, as ground waves far longer than the plate move it).
    """
    samples = round(duration * sample_rate)
    lines = np.fft.rfftfreq(samples, 1 / sample_rate)
    amplitude = np.sqrt(np.interp(lines, frequencies_hz, density, left=0.0, right=0.0))
    # One-sided density = 2 |X|^2 / (rate samples), half of it in the real and half in the imaginary part.
    amplitude *= np.sqrt(sample_rate * samples) / 2
    draws = np.random.default_rng(seed).standard_normal((SENSORS + 1, len(lines), 2)) @ [1, 1j]
    if samples % 2 == 0:
        draws[:, -1] = 2 * draws[:, -1].real  # the Nyquist line stands for itself, and is real
    mixed = np.sqrt(common) * draws[0] + np.sqrt(1 - common) * draws[1:]
    return RecordedFloor(np.fft.irfft(mixed * amplitude, samples, axis=1), float(sample_rate), "synthesised")


def ground_floor(duration: float, seed: int, *, gain: float = 1.0, common: float = 0.0) -> RecordedFloor:
    """Motion with the spectrum of `ground_spectrum`; the record has no phase, so the motion is synthesised."""
    ground = ground_spectrum(gain=gain)
    return synthesise_floor(ground.frequencies_hz, ground.levels, duration, seed, common=common)


def record_floor(record: Record) -> RecordedFloor:
    """Measured record as a floor: acceleration without its mean, resampled for the loop.

    A sensor without a channel of its own moves as the mean of the others, so one channel is a plate that only
    translates.
    """
    moved = resample(to_acceleration(record), SAMPLE_RATE).signals
    moved = moved - moved.mean(axis=1, keepdims=True)
    missing = np.repeat(moved.mean(axis=0, keepdims=True), SENSORS - len(moved), axis=0)
    return RecordedFloor(np.concatenate([moved, missing]), float(SAMPLE_RATE), record.source)


# === Stability ====================================================================================================
# Numerical stability of the covariance recursion (29): seven ways to write it, in any precision.
#
# On paper they are one formula. In rounded arithmetic they differ in what becomes of an error of P that is
# antisymmetric, and of one that makes P indefinite.


# What one writes first, and what (29) prints; the library has the triangle and UD. What a form stores: P itself, S with
# P = S S' (``square root``, after Potter), or a triangular factor whose row j is column j of U: U D U' (``UD``), U U'
# (``inverse QR``, by Givens rotations; Haykin, Adaptive Filter Theory).
FORMS = ("one product", "both products", "triangle", "Joseph", "square root", "UD", "inverse QR")
ONE_PRODUCT, BOTH_PRODUCTS, TRIANGLE, JOSEPH, SQUARE_ROOT, UD, INVERSE_QR = range(7)
REGRESSORS = 9  # of the synthetic records, as the rig has
OVERFLOW = 1e100  # so large that its square is still a number


@dataclass(frozen=True)
class CovarianceRun:
    """What became of P, at equally spaced moments."""

    time_constants: Float64[np.ndarray, " kept"]  # samples seen times (1 - forgetting)
    asymmetry: Float64[np.ndarray, " kept"]  # norm of the antisymmetric part of P over that of P
    error: Float64[np.ndarray, " kept"]  # norm of P - R^-1, R the information matrix, over that of R^-1
    smallest: Float64[np.ndarray, " kept"]  # eigenvalue of (P + P')/2 over the smallest of R^-1
    distance: Float64[np.ndarray, " kept"]  # largest |eigenvalue of P R - 1|; from 1 on P may be indefinite
    largest: Float64[np.ndarray, " kept"]  # eigenvalue of (P + P')/2 over the largest of the initial P

    @property
    def breakdown(self) -> float:
        """Time constants until P is first seen indefinite or not finite; infinite when it never is."""
        broken = ~(self.smallest > 0)
        return float(self.time_constants[np.argmax(broken)]) if broken.any() else float("inf")

    @property
    def worst(self) -> float:
        """Largest `distance`, at most one, the size of P: beyond it P means nothing, and its numbers are chaos."""
        return min(float(np.nanmax(self.distance)), 1.0)

    def breakdown_tens(self) -> float:
        """`breakdown` to tens: rounding errors decide it, and another processor's are of the same size alone."""
        return round(self.breakdown, -1) if np.isfinite(self.breakdown) else self.breakdown

    def growth_rate(self) -> float:
        """Growth rate of the asymmetry per time constant, fitted where it lies between 1e-12 and 1e-3."""
        inside = (self.asymmetry > 1e-12) & (self.asymmetry < 1e-3) & (self.time_constants < self.breakdown)
        if inside.sum() < 3:
            return 0.0
        return float(np.polyfit(self.time_constants[inside], np.log(self.asymmetry[inside]), 1)[0])


def covariance_run(
    form: str,
    regressors: ArrayLike,
    forgetting: float,
    initial: ArrayLike,
    time_constants: float,
    precision: str = "float64",
    per_time_constant: int = 4,
    against_exact: bool = True,
) -> CovarianceRun:
    """Run the covariance recursion over a record (n, samples), repeated for so many `time_constants`, and watch P.

    Of `FORMS`, ``one product`` is P - (g / den) g' with g = P psi; ``both products``, with P psi and psi' P computed
    apart as printed. P is looked at so often `per_time_constant`.
    Not `against_exact`, `error` and `distance` are NaN and `smallest` is the eigenvalue itself: half of the time.
    """
    code = FORMS.index(require_choice("form", form, FORMS))
    dtype = np.dtype(require_choice("precision", precision, ("float64", "float32")))
    record = np.ascontiguousarray(require_array("regressors", regressors, ndim=2).T)
    n = record.shape[1]
    start = require_array("initial", initial, shape=(n, n))
    forgetting = require_number("forgetting", forgetting, above=0.0, below=1.0)
    step = int(1 / (1 - forgetting) / require_count("per_time_constant", per_time_constant))
    if not 0 < step <= len(record):
        raise InputError(
            f"regressors has {pluralise(len(record), 'sample')}; give at least {step}, or look more often"
        )

    matrix = _stored(code, start).astype(dtype)
    information, rounded = np.linalg.inv(start), float(dtype.type(forgetting))
    weights = rounded ** (np.arange(step)[::-1] / 2)
    # Rounded once for both, so that the error is the recursion's and not the data's.
    blocks = [record[at : at + step].astype(dtype) for at in range(0, len(record) - step + 1, step)]
    weighted = (block.astype(np.float64) * weights[:, None] for block in blocks)
    seen = [each.T @ each for each in weighted] if against_exact else []
    rows = []
    for k in range(int(time_constants * per_time_constant)):
        at = k % len(blocks)
        recur(code, matrix, blocks[at], dtype.type(forgetting), np.empty(n, dtype), np.empty(n, dtype))
        if against_exact:
            information = rounded**step * information + seen[at]
        now = _health(form, matrix, information if against_exact else None)
        rows.append(((k + 1) * step * (1 - forgetting), *now))
        if not np.isfinite(rows[-1][3]):
            break
    table = np.array(rows).T
    table[5] /= np.linalg.eigvalsh(start)[-1]
    return CovarianceRun(*table)


SHOWN = ("one product", "both products", "triangle", "UD")
EXPERIMENT_S, TIME_CONSTANTS = 200.0, 45.0  # Fig. 5; length of a run
FLAT, COMMON, SLAB = (
    "flat floor, three shakers",
    "ground, 99.9 % common",
    "slab, one channel for three sensors",
)


def motions_of(floor: ShapedFloor, seed: int) -> dict[str, ShapedFloor | RecordedFloor]:
    """The published floor, and two on which one motion drives the sensors."""
    slab = load_record(paths.data("isolation", "slab_footfall/slab_vertical.csv"), "m/s^2")
    return {FLAT: floor, COMMON: ground_floor(20.0, seed, gain=100.0, common=0.999), SLAB: record_floor(slab)}


def regressors_on(twin: Twin, floor, memory_s: float, seed: int) -> Float32[np.ndarray, "n samples"]:
    """A memory of filtered regressors; rounded, so that every machine starts from the same digits."""
    run = simulate(twin, floor, 2.0 + memory_s, signals_from_s=2.0, seed=seed)
    return run.filtered_regressors.astype(np.float32)


def steady_diagonal(twin: Twin, floor: ShapedFloor, forgetting: float) -> Float64[np.ndarray, " n"]:
    """Diagonal of the steady P, of which section 5.1.1 starts from ten times; rounded likewise."""
    return np.round(np.diag(steady_state(twin, floor, forgetting=forgetting).covariance), 4)


def forms_over_time(
    record: ArrayLike,
    forgetting: float,
    diagonal: ArrayLike,
    time_constants: float,
    precision: str = "float64",
) -> dict[str, CovarianceRun]:
    """Each of `SHOWN` on the published floor, from a diagonal P."""
    start = np.diag(diagonal)
    return {
        form: covariance_run(form, record, forgetting, start, time_constants, precision) for form in SHOWN
    }


def double_values(runs: Mapping[str, CovarianceRun], experiment: float) -> dict[str, float]:
    """What section 6 states on stability, in float64; `experiment` in time constants."""
    return {
        "isolation.stability.observed": float(np.mean([run.breakdown > experiment for run in runs.values()])),
        "isolation.stability.not-eliminated": float(runs["one product"].breakdown < np.inf),
    }


def double_precision(
    *, memory: float, floor_upper_end: float, seed: int, model: str = "rigid_body"
) -> dict[str, float]:
    """The same for another memory (s) or floor."""
    twin, floor = load_twin(model), flat_floor(floor_upper_end)
    forgetting = float(np.exp(-twin.sample_time / memory))
    record = regressors_on(twin, floor, memory, seed)
    diagonal = steady_diagonal(twin, floor, forgetting)
    return double_values(forms_over_time(record, forgetting, diagonal, TIME_CONSTANTS), EXPERIMENT_S / memory)


def _health(form, matrix, information) -> tuple[float, ...]:
    covariance = matrix.astype(np.float64)
    if not np.all(np.abs(covariance) < OVERFLOW):
        return (np.nan,) * 5
    root = None
    if form in ("square root", "UD", "inverse QR"):
        # A product has no negative eigenvalue; singular values keep the digits that forming it would lose.
        root = covariance if form == "square root" else covariance.T
        if form == "UD":
            root = (np.triu(root, 1) + np.eye(len(root))) * np.sqrt(np.diag(root))
        eigenvalues = np.linalg.svd(root, compute_uv=False)[::-1] ** 2
        covariance = root @ root.T
    else:
        eigenvalues = np.linalg.eigvalsh((covariance + covariance.T) / 2)
    asymmetry = np.linalg.norm(covariance - covariance.T) / 2 / np.linalg.norm(covariance)
    if information is None:
        return asymmetry, np.nan, eigenvalues[0], np.nan, eigenvalues[-1]
    metric = np.linalg.cholesky(information)
    if root is None:
        relative = np.linalg.eigvalsh(metric.T @ (covariance + covariance.T) @ metric / 2)
    else:
        relative = np.linalg.svd(metric.T @ root, compute_uv=False) ** 2
    exact = np.linalg.inv(information)
    error = np.linalg.norm(covariance - exact) / np.linalg.norm(exact)
    smallest = eigenvalues[0] * np.linalg.eigvalsh(information)[-1]
    return asymmetry, error, smallest, np.abs(relative - 1).max(), eigenvalues[-1]


def shared_motion(condition: float, samples: int, seed: int) -> np.ndarray:
    """Nine regressors of power one that share a motion, each with a rest of its own, (regressors, samples).

    The `condition` of their correlation is 1 + 9 c / (1 - c) for the share c of the power that is common.
    """
    ratio = (require_number("condition", condition, above=1.0) - 1) / REGRESSORS
    rng = np.random.default_rng(seed)
    common, own = rng.standard_normal(samples), rng.standard_normal((REGRESSORS, samples))
    return (np.sqrt(ratio) * common + own) / np.sqrt(1 + ratio)


def scaled_condition(regressors: ArrayLike) -> float:
    """Condition number of the regressors' correlation: of the information matrix in units that make its diagonal one."""
    return float(np.linalg.cond(np.corrcoef(require_array("regressors", regressors, ndim=2))))


def condition_bounds(forgetting: float, precision: str) -> tuple[float, float]:
    """Condition number up to which P stays definite for certain, and in the mean, but for a factor of order one.

    A sample rounds P by u times its size, and what was rounded before shrinks by lambda: the errors add up to
    u / (1 - lambda) of it where all have one sign, to u / sqrt(2 (1 - lambda)) where they are independent. P is
    indefinite when that reaches its smallest eigenvalue.
    """
    unit = float(np.finfo(precision).eps) / 2
    return (1 - forgetting) / unit, float(np.sqrt(2 * (1 - forgetting))) / unit


def steady_start(regressors: ArrayLike, forgetting: float) -> Float64[np.ndarray, "n n"]:
    """P that the recursion settles at, (1 - lambda) E[psi psi']^-1."""
    psi = require_array("regressors", regressors, ndim=2)
    size = np.sqrt(np.mean(psi**2, axis=1))
    scaled = psi / size[:, None]
    inverse = np.linalg.inv(scaled @ scaled.T / scaled.shape[1]) / np.outer(size, size)
    return (1 - forgetting) * (inverse + inverse.T) / 2


def stability_map(
    conditions, precisions, forms, seeds: int, samples_per_constant: int, time_constants: float
) -> dict[tuple[str, str], Float64[np.ndarray, "2 conditions seeds"]]:
    """`worst` distance of P, and time constants to its breakdown, from the steady P on, by (precision, form)."""
    forgetting = float(np.exp(-1 / samples_per_constant))
    found = {each: np.empty((2, len(conditions), seeds)) for each in product(precisions, forms)}
    for i, condition in enumerate(conditions):
        for seed in range(seeds):
            psi = shared_motion(condition, samples_per_constant, seed)
            start = steady_start(psi, forgetting)
            for (precision, form), table in found.items():
                run = covariance_run(form, psi, forgetting, start, time_constants, precision, 2)
                table[:, i, seed] = run.worst, run.breakdown
    return found


def _stored(form: int, covariance: np.ndarray) -> np.ndarray:
    if form == UD:
        return factor_of("UD", covariance)
    if form in (SQUARE_ROOT, INVERSE_QR):
        return upper_root(covariance) if form == SQUARE_ROOT else upper_root(covariance).T
    return covariance


def recur(form, matrix, regressors, forgetting, column, row):
    """Update what the form keeps over a block in place, in the arrays' precision."""
    # A kernel a form: asked at every sample for its form, the compiler would optimise none of them, and who looks at
    # one of them does not wait for the others. Those that keep a factor are functions of their own anyway.
    if form == ONE_PRODUCT:
        _one_products(matrix, regressors, forgetting, column)
    elif form == BOTH_PRODUCTS:
        _both_products(matrix, regressors, forgetting, column, row)
    elif form == TRIANGLE:
        _triangles(matrix, regressors, forgetting, column)
    else:
        _forms(form, matrix, regressors, forgetting, column, row)


@borrowing_kernel
def _triangles(matrix, regressors, forgetting, column):
    for k in range(len(regressors)):
        update_covariance(matrix, regressors[k], forgetting, column)


@borrowing_kernel
def _forms(form, matrix, regressors, forgetting, column, row):
    for k in range(len(regressors)):
        if form == UD:
            update_ud(matrix, regressors[k], forgetting, column, row)
        elif form == JOSEPH:
            _update_joseph(matrix, regressors[k], forgetting, column, row)
        elif form == SQUARE_ROOT:
            _update_square_root(matrix, regressors[k], forgetting, column, row)
        else:
            _update_inverse_qr(matrix, regressors[k], forgetting, column, row)


@borrowing_kernel
def _update_joseph(covariance, regressor, forgetting, gain, row):
    """(I - k psi') P (I - k psi')' / lambda + k k' with k = g / den, in place."""
    zero, one, n = covariance.dtype.type(0), covariance.dtype.type(1), len(regressor)
    denominator = project(covariance, regressor, forgetting, gain)
    for i in range(n):
        row[i] = plus_column(zero, covariance, i, regressor)
    shrink, forget = one / denominator, one / forgetting
    for i in range(n):
        share = gain[i] * shrink
        add_scaled(-share, row, covariance[i])
        back = plus_row(zero, covariance, i, regressor)
        for j in range(n):
            step = gain[j] * shrink
            covariance[i, j] = (covariance[i, j] - back * step) * forget + share * step
    return denominator


@borrowing_kernel
def _update_square_root(root, regressor, forgetting, gain, inner):
    """Potter's update of S in place."""
    zero, one, n = root.dtype.type(0), root.dtype.type(1), len(regressor)
    for j in range(n):
        inner[j] = 0
    for i in range(n):
        add_scaled(regressor[i], root[i], inner)
    denominator = forgetting
    for j in range(n):
        denominator += inner[j] * inner[j]
    share = one / (denominator + np.sqrt(forgetting * denominator))
    forget = one / np.sqrt(forgetting)
    for i in range(n):
        gain[i] = plus_row(zero, root, i, inner)
        scaled = gain[i] * share
        for j in range(n):
            root[i, j] = (root[i, j] - scaled * inner[j]) * forget
    return denominator


@borrowing_kernel
def _update_inverse_qr(factor, regressor, forgetting, gain, inner):
    """Givens rotations of [sqrt(lambda), psi' U; 0, U] to [sqrt(den), 0; g / sqrt(den), sqrt(lambda) U], in place."""
    n, zero = len(regressor), factor.dtype.type(0)
    root = np.sqrt(forgetting)
    forget = factor.dtype.type(1) / root
    for j in range(n):
        inner[j] = plus_left(zero, factor, j, regressor) + factor[j, j] * regressor[j]
        gain[j] = 0
    denominator = forgetting
    for j in range(n):
        denominator += inner[j] * inner[j]
        length = np.sqrt(denominator)
        cosine, sine = root / length, inner[j] / length
        for i in range(j + 1):
            entry, share = factor[j, i], gain[i]
            gain[i] = cosine * share + sine * entry
            factor[j, i] = (cosine * entry - sine * share) * forget
        root = length
    for i in range(n):
        gain[i] *= root
    return denominator


@inlined_kernel
def _multiply(matrix, psi, forgetting, column):
    """P psi into `column`; returns lambda + psi' P psi."""
    n = len(psi)
    denominator = forgetting
    for i in range(n):
        total = matrix[i, 0] * psi[0]
        for j in range(1, n):
            total += matrix[i, j] * psi[j]
        column[i] = total
        denominator += psi[i] * total
    return denominator


@borrowing_kernel
def _one_products(matrix, regressors, forgetting, column):
    one, n = matrix.dtype.type(1), len(matrix)
    forget = one / forgetting
    for k in range(len(regressors)):
        shrink = one / _multiply(matrix, regressors[k], forgetting, column)
        for i in range(n):
            gain = column[i] * shrink
            for j in range(n):
                matrix[i, j] = (matrix[i, j] - gain * column[j]) * forget


@borrowing_kernel
def _both_products(matrix, regressors, forgetting, column, row):
    one, n = matrix.dtype.type(1), len(matrix)
    forget = one / forgetting
    for k in range(len(regressors)):
        psi = regressors[k]
        shrink = one / _multiply(matrix, psi, forgetting, column)
        for i in range(n):
            row[i] = matrix[0, i] * psi[0]
        for j in range(1, n):
            for i in range(n):
                row[i] += matrix[j, i] * psi[j]
        for i in range(n):
            gain = column[i] * shrink
            for j in range(n):
                matrix[i, j] = (matrix[i, j] - gain * row[j]) * forget


# === Cures ========================================================================================================
# What keeps the covariance bounded when a direction of the floor falls silent, compared in closed loop.
#
# The loop is the smallest one that has what matters: one actuator, a secondary path that is known exactly but for
# its sample of delay, and weights w that cancel the floor perfectly:
#
#     e(k) = N (W(k-1) - w) psi(k-1)


def peak_error(run: Run, from_s: float) -> float:
    """Largest filtered error from a moment on over its mean in the ten seconds before; infinite if the run broke."""
    if run.broke_s is not None:
        return float("inf")
    error, before = np.sqrt(run.error_power), (run.time_s > from_s - 10) & (run.time_s <= from_s)
    return float(error[run.time_s > from_s].max() / error[before].mean())


# === Stability pictures ===========================================================================================
# Figures of numerical stability (notebook 07).


_LINES = ("-", "--", "-", ":", "-.", "--", "-")
EXPLORED = ("one product", "both products", "triangle", "Joseph", "UD")
FLOOR = 1e-19  # where exact zeros are drawn, as a note on the axis states
# Forms whose errors lie on one another are one band of the map.
KINDS = {
    "both products, triangle, Joseph": ("both products", "triangle", "Joseph"),
    "square root, inverse QR": ("square root", "inverse QR"),
    "UD": ("UD",),
}
FACTORED = ("square root", "UD", "inverse QR")
SHIPPED = ", shipped floors"
ROUNDED = (
    *(f"{kind}, float{bits}{of}" for kind in KINDS for bits in (32, 64) for of in ("", ", range")),
    *(f"{kind}{SHIPPED}" for kind in tuple(KINDS)[::2]),
    "P lost definiteness",
)


def paint_map(
    conditions: ArrayLike,
    found: Mapping[tuple[str, str], np.ndarray],
    shipped: Mapping[str, tuple[float, Mapping[str, CovarianceRun]]],
    memories: tuple[float, float],
):
    """Error of P in its own metric over the condition number, as a part of the safe one, from least to largest of each kind of form.

    `found` by precision and form is what `stability_map` gives, `shipped` by floor a condition number and the runs in
    float32 by form; `memories` are the time constants of both in samples.
    """
    figure, axes = figures.new(height=3.9)
    ours, theirs = (np.exp(-1 / memory) for memory in memories)
    for (kind, forms), colour, mark in zip(
        KINDS.items(), (figures.RED, figures.SKY, figures.BLUE), "soD", strict=True
    ):
        for precision, line in (("float32", "-"), ("float64", "--")):
            at = np.asarray(conditions) / condition_bounds(ours, precision)[0]
            tables = np.array(
                [found[precision, form] for form in forms]
            )  # forms, quantities, conditions, seeds
            distance, lost = tables[:, 0], np.isfinite(tables[:, 1]).any(axis=(0, 2))
            low, high = distance.min(axis=(0, 2)), distance.max(axis=(0, 2))
            name = f"{kind}, {precision}"
            axes.fill_between(at, low, high, color=colour, alpha=0.3, lw=0, label=f"{name}, range")
            axes.plot(at, high, line, lw=1.2, color=colour, label=name)
            if lost.any():
                axes.plot(at[lost], high[lost], "kx", ms=9, mew=1.8, label="P lost definiteness")
        worst = [
            (
                condition / condition_bounds(theirs, "float32")[0],
                max(runs[form].worst for form in forms if form in runs),
            )
            for condition, runs in shipped.values()
            if any(form in runs for form in forms)
        ]
        if worst:
            axes.plot(
                *np.transpose(worst),
                mark,
                color=colour,
                mec=figures.BLACK,
                ms=7,
                zorder=4,
                label=kind + SHIPPED,
            )
    axes.axvline(1, color=figures.BLACK, lw=0.8, ls=":")
    means = [
        mean / certain for certain, mean in (condition_bounds(each, "float32") for each in (ours, theirs))
    ]
    axes.axvspan(*means, color=figures.GREY, alpha=0.25, lw=0)
    axes.axhline(1.0, color=figures.GREY, lw=0.8)
    style = {"rotation": 90, "ha": "right", "va": "bottom", "fontsize": 8}
    axes.text(0.8, 1e-13, "safe to here", **style)
    axes.text(0.8 * means[0], 1e-13, "safe in the mean", **style)
    for name, (condition, _) in shipped.items():
        at = condition / condition_bounds(theirs, "float32")[0]
        axes.text(at, 5, name.split(",")[0], ha="center", fontsize=8, color=figures.GREY)
    axes.text(1e-11, 2, "as large as P", fontsize=8, color=figures.GREY)
    axes.set(xscale="log", yscale="log", ylim=(1e-13, 100), ylabel="largest relative error of P")
    axes.set_xlabel("condition number κ of the scaled regressors, over the safe one")
    named = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    shown = [name for name in named if not name.endswith("range")]
    figure.legend([named[name] for name in shown], shown, loc="outside lower center", ncols=2)
    return figure


def paint_forms(runs: Mapping[str, Mapping[str, CovarianceRun]], experiment: float):
    """Error of P over time constants by precision; `experiment` is the published length."""
    figure, grid = figures.new(1, len(runs), height=3.4, sharey=True)
    for axes, (precision, forms) in zip(grid, runs.items(), strict=True):
        axes.axvspan(0, experiment, color=figures.GREY, alpha=0.15, lw=0, label="published experiment, 200 s")
        one, t = forms["one product"], forms["one product"].time_constants
        axes.semilogy(t, one.error, color=figures.RED, lw=1.8, label="one product")
        others = {form: run for form, run in forms.items() if form != "one product"}
        errors = np.array([run.error for run in others.values()])
        t = next(iter(others.values())).time_constants
        style = {"color": figures.BLUE, "alpha": 0.4, "lw": 1.2, "label": ", ".join(others)}
        axes.fill_between(t, errors.min(axis=0), errors.max(axis=0), **style)
        unit = np.finfo(precision).eps
        guide = np.array([0.0, np.log(1 / unit)])
        style = {"color": figures.BLACK, "lw": 0.8, "ls": "--", "label": "rounding × exp(t / T)"}
        axes.semilogy(guide, unit / 10 * np.exp(guide), **style)
        if np.isfinite(one.breakdown):
            axes.axvline(one.breakdown, color=figures.RED, lw=0.8, ls=":")
            text, side = f" indefinite\n at about {one.breakdown_tens():.0f} ", one.breakdown < t[-1] / 2
            look = {"fontsize": 8, "ha": "left" if side else "right", "color": figures.RED}
            axes.annotate(text, (one.breakdown, 1e-10), **look)
        axes.set(title=precision, xlabel="time constants of the forgetting", ylim=(1e-17, 1e3))
        axes.set_yticks(10.0 ** np.arange(-15, 4, 3))
    grid[0].set(ylabel="relative error of P")
    figures.legend_below(grid[0], 2)
    return figure


def paint_return(outcomes: Mapping[str, Sequence[Run]], return_s: float):
    """Filtered error around the return of a silent sensor; a cross marks where a run broke."""
    figure, grid = figures.new(1, len(outcomes), height=3.0, sharey=True, squeeze=False)
    for axes, (name, runs) in zip(grid[0], outcomes.items(), strict=True):
        for number, run in enumerate(runs, 1):
            near, error = run.time_s > return_s - 5, np.sqrt(run.error_power)
            axes.semilogy(run.time_s[near] - return_s, error[near], lw=0.9, label=f"floor {number}")
            if run.broke_s is not None:
                style = {"color": axes.lines[-1].get_color(), "label": f"floor {number}, broke"}
                axes.plot(run.broke_s - return_s, error[-1], "x", ms=9, mew=2, **style)
        axes.axvspan(-5, 0, color=figures.GREY, alpha=0.12, lw=0, label="one sensor silent")
        axes.set(xlabel="time since the sensor's return (s)", title=name, xlim=(-5, 15))
        axes.legend(loc="upper right")
    grid[0, 0].set(ylabel="filtered error, rms (N)")
    return figure


def explore_forms(regressors: ArrayLike, initial: ArrayLike):
    """Explorer: asymmetry of every form, with another forgetting or precision."""

    def paint(precision: str, samples_per_constant: float, time_constants: float):
        figure, axes = figures.new(1, 1, height=3.0)
        forgetting = float(np.exp(-1 / samples_per_constant))
        for style, form in zip(_LINES, EXPLORED, strict=False):
            run = covariance_run(
                form, regressors, forgetting, initial, time_constants, precision, 2, against_exact=False
            )
            broke = f"indefinite at about {run.breakdown_tens():.0f}"
            label = f"{form}: {'stays definite' if np.isinf(run.breakdown) else broke}"
            axes.semilogy(run.time_constants, np.maximum(run.asymmetry, FLOOR), style, label=label)
        axes.set(xlabel="time constants of the forgetting", ylabel="antisymmetric part of P")
        axes.set(
            ylim=(FLOOR / 3, 10), title=f"{precision}, time constant of {samples_per_constant:.0f} samples"
        )
        axes.set_yticks(10.0 ** np.arange(-18, 1, 3), minor=False)
        style = {"xycoords": ("axes fraction", "data"), "ha": "right", "va": "bottom", "fontsize": 8}
        axes.annotate("exactly 0 is drawn here", (0.99, FLOOR * 2), color=figures.GREY, **style)
        axes.legend(loc="upper left", bbox_to_anchor=(1, 1))
        return figure

    # Both precisions are compiled here, not at a reader's first move.
    for precision in ("float64", "float32"):
        covariance_run("triangle", regressors, 0.5, initial, 1, precision, per_time_constant=1)
    return paint


def shipped_floors(
    records: Mapping[str, np.ndarray], forgetting: float
) -> dict[str, tuple[float, dict[str, CovarianceRun]]]:
    """By floor the condition number of its regressors, and runs in float32 from the steady P by form."""
    forms = ("triangle", "Joseph", "UD")
    return {
        name: (
            scaled_condition(psi),
            {
                form: covariance_run(form, psi, forgetting, steady_start(psi, forgetting), 6, "float32")
                for form in forms
            },
        )
        for name, psi in records.items()
    }


# === Answer =======================================================================================================


def map_values(conditions: np.ndarray, found: Mapping[tuple[str, str], np.ndarray]) -> dict[str, float]:
    """What the map shows, as shares of its runs."""
    kept = {key: np.isinf(table[1]) for key, table in found.items()}
    both = ("float32", "float64")
    held = [kept[precision, form].all() for precision in both for form in FACTORED]
    lost = [~kept["float32", form][conditions > 1e8] for form in ("both products", "triangle", "Joseph")]
    better = found["float32", "triangle"][0][2] / found["float32", "UD"][0][2]
    return {
        "isolation.stability.factors-hold": float(np.mean(held)),
        "isolation.stability.float64-holds": float(
            np.mean([kept["float64", form].all() for form in FORMS[1:]])
        ),
        "isolation.stability.float32-lost": float(np.mean(lost)),
        "isolation.stability.ud-closer": float(np.mean(better > 10)),
    }


def returns(
    twin: Twin,
    floor_upper_end: float,
    diagonal: ArrayLike,
    forgetting: float,
    *,
    time_constant_s: float,
    silent: float,
    growth_limit: float,
    floors: int,
    seed: int,
) -> tuple[dict[str, list[Run]], float]:
    """Loops in which a floor sensor is silent for a while, by algorithm, and when it returns, s."""
    # the third sensor is not shaken
    floor, quiet = flat_floor(floor_upper_end), flat_floor(floor_upper_end, level=[1.5e-3, 1.5e-3, 0.0])
    stages = [(2 * time_constant_s, floor), (silent * time_constant_s, quiet), (1.5 * time_constant_s, floor)]
    variants = {
        "printed algorithm": FeRls(diagonal, forgetting, np.inf),
        "P limited (default)": FeRls(diagonal, forgetting, growth_limit),
    }
    kept = {"keep_every_s": 0.02, "to_the_break": True}
    runs = {
        name: [simulate(twin, stages, adaptation=each, seed=seed + k, **kept) for k in range(floors)]
        for name, each in variants.items()
    }
    return runs, (2 + silent) * time_constant_s
