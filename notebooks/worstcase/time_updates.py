"""Time updates: exact, approximate, fast, and what they cost: what this notebook alone needs."""

from functools import cache

import numpy as np

from experiments.worstcase.simulations import FIG_2_PARAMETERS, path
from stillwork.base.algebra import (
    add_scaled,
    copy_vector,
    factorise,
    inner_product,
    minus_row,
    plus_left,
    set_product,
    solve_backward,
    solve_forward,
)
from stillwork.base.kernels import inlined_kernel, kernel
from stillwork.estimation.min_max import solve_silently
from stillwork.estimation.recursive import Track
from stillwork.estimation.secular import ROUNDING, narrow_bracket, next_alpha, secular_root
from stillwork.identification.regressors import exponential_bound, exponential_weights
from workbook import figures
from workbook.studies import Study, run_study
from workbook.timings import measured_times


def weighting_trial(rng: np.random.Generator, row_error: float, forgetting: float, samples: int) -> dict:
    """Section 5: norm of the weighted perturbation, rows within `row_error`, over the sum and over its limit."""
    unknowns = int(rng.integers(1, 7))
    rows = rng.standard_normal((samples, unknowns)) + rng.uniform(0, 3) * rng.standard_normal(unknowns)
    rows *= row_error / np.linalg.norm(rows, axis=1, keepdims=True)
    rows *= exponential_weights(samples, forgetting)[:, None]
    size = np.linalg.norm(rows, 2)
    return {
        "over_sum": size / exponential_bound(row_error, forgetting, samples),
        "over_limit": size / exponential_bound(row_error, forgetting),
    }


def recursion_trial(
    rng: np.random.Generator, truth: np.ndarray, bound: float, forgetting: float, noise: float
) -> dict[str, np.ndarray]:
    """All min-max updates on one record, with white regressors of unit variance, beside the batch solution at every step.

    ``exact``, ``fast``, ``approximate_1`` to ``_3``: distance of the estimates from batch, over the largest norm of
    the batch estimates. ``alpha_1`` to ``alpha_3``: relative error of alpha, NaN where x = 0. ``alpha``: the batch
    alpha. ``size`` and ``size_*``: norms of the estimates. ``as_printed`` and ``corrected``: relative distance of h
    (15) from its definition with alpha_t and with lam alpha_t. ``image_as_printed`` and ``image_corrected``: the same
    of eq. (17) from f(alpha_t) and from f(lam alpha_t).
    """
    unknowns, samples = truth.shape
    regressors = rng.standard_normal((unknowns, samples))
    outputs = np.sum(regressors * truth, axis=0) + noise * rng.standard_normal(samples)
    batch = np.zeros((unknowns, samples))
    alphas = np.full(samples, np.inf)
    weighted = []
    for t in range(samples):
        weights = exponential_weights(t + 1, forgetting)
        weighted.append((regressors[:, : t + 1].T * weights[:, None], outputs[: t + 1] * weights))
        if t >= unknowns:
            found = solve_silently(*weighted[t], bound)
            batch[:, t], alphas[t] = found.estimate, found.alpha
    sizes = np.linalg.norm(batch, axis=0)
    scale = sizes.max() or 1.0  # where the bound leaves no estimate but zero
    found = {"alpha": np.where(np.isfinite(alphas), alphas, np.nan), "size": sizes}
    for name, (update, iterations) in UPDATES.items():
        ours = run_printed(update, iterations, regressors, outputs, bound, forgetting)
        found[name] = np.linalg.norm(ours.estimates - batch, axis=0) / scale
        found[f"size_{name}"] = np.linalg.norm(ours.estimates, axis=0)
        if update == "approximate":
            finite = np.where(np.isfinite(ours.alphas), ours.alphas, np.nan)
            found[f"alpha_{iterations}"] = np.abs(finite / found["alpha"] - 1)
    for name in ("as_printed", "corrected", "image_as_printed", "image_corrected"):
        found[name] = np.full(samples, np.nan)
    for t in range(unknowns, samples - 1):
        if np.isfinite(alphas[t]):
            _one_update(found, t, weighted, batch[:, t], alphas[t], bound, forgetting)
    return found


def iteration_errors(
    seeds, truth, bound: float, forgetting: float, noise: float, records: int
) -> dict[str, np.ndarray]:
    """Of one step of (20) for each seed, and for the parameters in another order: relative errors of alpha.

    ``beyond``: share of instants at which it exceeds a third; ``largest`` of a record, median over so many `records`.
    """
    found = {"beyond": [], "largest": []}
    for seed, plant in [*((seed, truth) for seed in seeds), (seeds[0], truth[::-1])]:
        rng, errors = np.random.default_rng(seed), []
        for _ in range(records):
            regressors = rng.standard_normal(truth.shape)
            outputs = np.sum(regressors * plant, axis=0) + noise * rng.standard_normal(truth.shape[1])
            exact, one = (
                run_printed(*UPDATES[name], regressors, outputs, bound, forgetting).alphas
                for name in ("exact", "approximate_1")
            )
            both = np.isfinite(exact) & np.isfinite(one)
            errors.append(np.abs(one[both] / exact[both] - 1))
        found["beyond"].append(np.mean(np.concatenate(errors) > 1 / 3))
        found["largest"].append(np.median([each.max() for each in errors]))
    return {name: np.array(values) for name, values in found.items()}


def _one_update(found, t, weighted, estimate, alpha, bound, forgetting):
    # h by (15), its image by (17), and what they stand for with alpha_t (as printed) and with lam alpha_t
    (matrix, _), (later, target) = weighted[t], weighted[t + 1]
    identity = np.eye(len(estimate))
    inverse = np.linalg.inv(matrix.T @ matrix + alpha * identity)
    row, output = later[-1], target[-1]
    gain = inverse @ row / (forgetting + row @ inverse @ row)
    h = estimate + gain * (output - row @ estimate)
    image = bound * np.linalg.norm(later @ h - target) / np.linalg.norm(h)
    for name, start in (("as_printed", alpha), ("corrected", forgetting * alpha)):
        defined = np.linalg.solve(later.T @ later + start * identity, later.T @ target)
        found[name][t + 1] = np.linalg.norm(h - defined) / np.linalg.norm(h)
        direct = bound * np.linalg.norm(later @ defined - target) / np.linalg.norm(defined)
        found[f"image_{name}"][t + 1] = abs(image / direct - 1)


# === The recursions as printed ====================================================================================
# State of the kernels: `information` R <- lam R + a a' (its lower triangle), `correlation` s <- lam s + a y, `energy`
# z <- lam z + y^2, the regularisation alpha, the number of rows seen, the estimate x.

UPDATES = {"exact": ("exact", 0), "fast": ("fast", 0)} | {
    f"approximate_{k}": ("approximate", k) for k in (1, 2, 3)
}
ALPHA, ENERGY, COUNT = 0, 1, 2  # places in the array `scalars`: alpha, z, samples seen


def run_printed(update: str, iterations: int, regressors, outputs, bound: float, forgetting: float) -> Track:
    """A record (unknowns, samples) by ``exact`` (Theorem 2), ``approximate`` (20) or ``fast`` (Section 7)."""
    n, samples = regressors.shape
    vectors = np.zeros((4, n))
    state = (vectors[0], np.array([np.inf, 0.0, 0.0]), vectors[1])
    out = np.zeros((samples, n)), np.zeros(samples), np.zeros(samples), np.zeros(samples, np.int64)
    given = np.ascontiguousarray(regressors.T), outputs, np.full(samples, bound), forgetting
    if update == "fast":  # eigenvalues and eigenvectors in place of R
        run_fast(*given, vectors[2], np.eye(n), *state, *out)
    else:
        run_sums(*given, iterations, np.zeros((n, n)), *state, np.zeros((n, n)), vectors[2], *out)
    return Track(out[0].T, *out[1:], np.zeros(n, bool))


@inlined_kernel
def _accumulate_row(row, output, forgetting, information, correlation):
    # returns |s|^2 and the trace of R
    trace = 0.0
    for i in range(len(row)):
        for j in range(i + 1):
            information[i, j] = forgetting * information[i, j] + row[i] * row[j]
        correlation[i] = forgetting * correlation[i] + row[i] * output
        trace += information[i, i]
    return inner_product(correlation, correlation), trace


@inlined_kernel
def _squared_norms(information, correlation, energy, solution):
    # |x|^2 and |A x - b|^2 = z - 2 x's + x'R x, clamped at zero as in (20)
    norm = 0.0
    residual = energy
    for i in range(len(solution)):
        half = 0.5 * information[i, i] * solution[i] - correlation[i]
        residual += 2.0 * plus_left(half, information, i, solution) * solution[i]
        norm += solution[i] * solution[i]
    return norm, max(residual, 0.0)


@inlined_kernel
def _exact_solution(
    information, correlation, energy, bound, start, least, x, factor, inverse_pivots, half, work, turned
):
    # Theorem 1 without an SVD: one factorisation per trial alpha, which stays at or above `least`
    alpha = max(start, least)
    low = 0.0
    high = np.inf
    evaluations = 0
    while True:
        factorise(information, alpha, correlation, factor, inverse_pivots, half, work)
        solve_backward(factor, inverse_pivots, half, x)
        norm, residual = _squared_norms(information, correlation, energy, x)
        evaluations += 1
        if residual == 0.0 or evaluations == 100:
            return alpha, evaluations
        solve_forward(factor, x, half)
        solve_backward(factor, inverse_pivots, half, turned)
        first = 0.0
        second = 0.0
        for i in range(len(x)):
            first += x[i] * turned[i]
            second += turned[i] * turned[i]
        image = bound * np.sqrt(residual / norm)
        low, high = narrow_bracket(alpha, image, low, high)
        step, near = next_alpha(alpha, image, norm, residual, first, second, low, high)
        if near and step > least:
            # two terms of the series of x in alpha make up for the last step
            change = step - alpha
            solve_forward(factor, turned, half)
            solve_backward(factor, inverse_pivots, half, work)
            for i in range(len(x)):
                x[i] -= change * (turned[i] - change * work[i])
            return step, evaluations
        step = max(step, least)
        if step == alpha:
            return alpha, evaluations
        alpha = step


@kernel
def run_sums(
    rows, outputs, bounds, forgetting, iterations, information, correlation, scalars, estimate,
    factor, inverse_pivots, estimates, errors, alphas, evaluations,
):  # fmt: skip
    """Min-max estimates of all data so far at every step, from R, s and z.

    With 0 `iterations` the exact ones of Theorem 2. Else algorithm (20): so many steps of the fixed-point map from
    lam alpha in place of its root; `factor` then holds P^-1 of the last step, from which h follows by a rank-one
    update, as in RLS.
    """
    n = len(estimate)
    x = np.zeros(n)
    copy_vector(estimate, x)
    half = np.zeros(n)
    work = np.zeros(n)
    gain = np.zeros(n)
    row = np.zeros(n)
    alpha = scalars[ALPHA]
    energy = scalars[ENERGY]
    seen = scalars[COUNT]
    for t in range(len(outputs)):
        output = outputs[t]
        error = output
        for i in range(n):
            row[i] = rows[t, i]
            error -= row[i] * x[i]
        errors[t] = error
        size, trace = _accumulate_row(row, output, forgetting, information, correlation)
        energy = forgetting * energy + output * output
        seen += 1.0
        least = ROUNDING * trace
        bound = bounds[t]
        count = 0
        if seen <= n or bound * bound * energy >= size:  # Theorem 1: eta >= |A'b| / |b|
            alpha = np.inf
            for i in range(n):
                x[i] = 0.0
        elif iterations == 0 or alpha == np.inf:
            # alpha_t itself is nearer to alpha_(t+1) than lam alpha_t, from which (15) starts; out of the zero
            # solution, and at the first step, there is neither
            start = alpha if alpha < np.inf else trace / n
            alpha, count = _exact_solution(
                information, correlation, energy, bound, start, least, x,
                factor, inverse_pivots, half, work, gain,
            )  # fmt: skip
            if iterations > 0:
                factorise(information, alpha, correlation, factor, inverse_pivots, half, work)
        else:
            solve_forward(factor, row, half)
            weight = forgetting
            for i in range(n):
                weight += half[i] * half[i] * inverse_pivots[i]
            share = error / weight
            solve_backward(factor, inverse_pivots, half, gain)
            add_scaled(share, gain, x)  # h = x + P a e / (lam + a'P a)
            for _ in range(iterations):
                norm, residual = _squared_norms(information, correlation, energy, x)
                alpha = max(bound * np.sqrt(residual / norm), least)
                factorise(information, alpha, correlation, factor, inverse_pivots, half, work)
                solve_backward(factor, inverse_pivots, half, x)
            count = iterations
        alphas[t] = alpha
        evaluations[t] = count
        copy_vector(x, estimates[t])
    copy_vector(x, estimate)
    scalars[ALPHA] = alpha
    scalars[ENERGY] = energy
    scalars[COUNT] = seen


EPSILON = 2.220446049250313e-16


# |s|^2 of data as small as 1e-70 starts at 1e-280; below this its parts would underflow one by one.
FORGOTTEN = 1e-300


@kernel
def _eigenvalue(poles, weights, j, differences):
    """Eigenvalue j of diag(poles) + w w'; writes poles - eigenvalue, each to full relative accuracy.

    Root of 1 + sum w_i^2 / (poles_i - x) between pole j and the next, in the distance to the nearer of the
    two; rational interpolation through both poles (Bunch, Nielsen, Sorensen), bisection as safeguard.
    """
    k = len(poles)
    last = j == k - 1
    width = inner_product(weights, weights) if last else poles[j + 1] - poles[j]
    middle = 1.0
    for i in range(k):
        middle += weights[i] * weights[i] / ((poles[i] - poles[j]) - 0.5 * width)
    origin = j if last or middle >= 0.0 else j + 1
    # the distance to the origin: in (0, width / 2] from the left pole, in [-width / 2, 0) from the right
    low = 0.0 if origin == j else -0.5 * width
    high = (width if last and middle < 0.0 else 0.5 * width) if origin == j else 0.0
    distance = 0.5 * (low + high)
    for _ in range(100):
        below = 0.0
        below_slope = 0.0
        above = 0.0
        above_slope = 0.0
        for i in range(k):
            gap = (poles[i] - poles[origin]) - distance
            differences[i] = gap
            part = weights[i] / gap
            if i <= j:
                below += weights[i] * part
                below_slope += part * part
            else:
                above += weights[i] * part
                above_slope += part * part
        value = 1.0 + below + above
        if abs(value) <= EPSILON * k * (1.0 - below + above):
            break
        if value < 0.0:
            low = distance
        else:
            high = distance
        left = differences[j]
        if last:
            # a single pole: value ~ constant + weight / (left - step)
            constant = value - left * below_slope
            step = left + left * left * below_slope / constant if constant > 0.0 else np.inf
        else:
            right = differences[j + 1]
            slope = below_slope + above_slope
            constant = value - left * below_slope - right * above_slope
            linear = (left + right) * value - left * right * slope
            square = left * right * value
            root = np.sqrt(max(linear * linear - 4.0 * square * constant, 0.0))
            if linear <= 0.0:
                step = (linear - root) / (2.0 * constant) if constant != 0.0 else square / linear
            else:
                step = 2.0 * square / (linear + root)
        following = distance + step
        if not low < following < high:
            following = 0.5 * (low + high)
        if following == distance or following == low or following == high:
            break
        distance = following
    for i in range(k):
        differences[i] = (poles[i] - poles[origin]) - distance
    return poles[origin] + distance


@kernel
def _deflate(values, vectors, weights, tolerance, kept):
    # Eigenpairs that the update leaves alone get weight 0: those orthogonal to the row, and one of every
    # pair of (numerically) equal eigenvalues, after a rotation that moves the weight to the other.
    n = len(values)
    count = 0
    for i in range(n):
        if abs(weights[i]) <= tolerance:
            continue
        if count > 0:
            j = kept[count - 1]
            length = np.hypot(weights[i], weights[j])
            cosine = weights[i] / length
            sine = weights[j] / length
            gap = values[i] - values[j]
            if abs(gap * cosine * sine) <= tolerance:
                for m in range(n):
                    first = vectors[j, m]
                    second = vectors[i, m]
                    vectors[j, m] = cosine * first - sine * second
                    vectors[i, m] = sine * first + cosine * second
                values[j] += gap * sine * sine
                values[i] -= gap * sine * sine
                weights[i] = length
                kept[count - 1] = i
                continue
        kept[count] = i
        count += 1
    return count


@kernel
def update_eigenpairs(values, vectors, row, forgetting):
    """Turn the eigenpairs of R (values ascending, vectors as rows) into those of lam R + a a', in place.

    O(n^2) but for the last product of the vectors, which costs 2 n^3.
    """
    n = len(values)
    weights = np.zeros(n)
    set_product(vectors, row, weights)
    length = inner_product(weights, weights)
    for i in range(n):
        values[i] *= forgetting
    if length == 0.0:
        return
    scale = max(values[n - 1], length)
    # both tests in one unit: a weight of this size moves an eigenvalue by rounding
    for i in range(n):
        weights[i] /= np.sqrt(scale)
        values[i] /= scale
    kept = np.zeros(n, np.int64)
    count = _deflate(values, vectors, weights, 4.0 * EPSILON, kept)
    poles = np.zeros(count)
    poles_weights = np.zeros(count)
    for i in range(count):
        poles[i] = values[kept[i]]
        poles_weights[i] = weights[kept[i]]
    new_values = np.zeros(count)
    new_vectors = np.zeros((count, count))  # row j: poles - eigenvalue j, then eigenvector j
    for j in range(count):
        new_values[j] = _eigenvalue(poles, poles_weights, j, new_vectors[j])
    # weights that make the computed eigenvalues exact (Loewner)
    for i in range(count):
        product = -new_vectors[i, i]
        for j in range(count):
            if j != i:
                product *= new_vectors[j, i] / (poles[i] - poles[j])
        poles_weights[i] = np.copysign(np.sqrt(max(product, 0.0)), poles_weights[i])
    old = np.zeros((count, n))
    for j in range(count):
        vector = new_vectors[j]
        for i in range(count):
            vector[i] = poles_weights[i] / vector[i]
        size = np.sqrt(inner_product(vector, vector))
        for i in range(count):
            vector[i] /= size
        copy_vector(vectors[kept[j]], old[j])
    turned = np.dot(new_vectors, old)
    for j in range(count):
        values[kept[j]] = new_values[j]
        copy_vector(turned[j], vectors[kept[j]])
    for i in range(n):
        values[i] *= scale
        # into ascending order: few are out of place, for only those that the update left alone can be passed
        j = i
        while j > 0 and values[j - 1] > values[j]:
            values[j - 1], values[j] = values[j], values[j - 1]
            for m in range(n):
                vectors[j - 1, m], vectors[j, m] = vectors[j, m], vectors[j - 1, m]
            j -= 1


@kernel
def run_fast(
    rows, outputs, bounds, forgetting, values, vectors, correlation, scalars, estimate,
    estimates, errors, alphas, evaluations,
):  # fmt: skip
    """The exact min-max solution at every step: eigenpairs by rank-one updates, then O(n) per Newton step."""
    n = len(estimate)
    shares = np.zeros(n)
    squares = np.zeros(n)
    for t in range(len(outputs)):
        errors[t] = minus_row(outputs[t], rows, t, estimate)
        for i in range(n):
            correlation[i] = forgetting * correlation[i] + rows[t, i] * outputs[t]
        size = inner_product(correlation, correlation)
        scalars[ENERGY] = forgetting * scalars[ENERGY] + outputs[t] * outputs[t]
        scalars[COUNT] += 1.0
        update_eigenpairs(values, vectors, rows[t], forgetting)
        count = 0
        alpha = np.inf
        for i in range(n):
            estimate[i] = 0.0
        if scalars[COUNT] > n and max(bounds[t] * bounds[t] * scalars[ENERGY], FORGOTTEN) < size:
            excess = scalars[ENERGY]
            mean = 0.0
            set_product(vectors, correlation, shares)
            for i in range(n):
                mean += values[i] / n
            # below rounding an eigenvalue holds no information; after a silence all but one are
            first = 0
            while first < n - 1 and not values[first] > n * EPSILON * values[n - 1]:
                first += 1
            for i in range(first, n):
                squares[i] = shares[i] * shares[i] / values[i]
                excess -= squares[i]
            start = scalars[ALPHA] if scalars[ALPHA] < np.inf else mean
            alpha, count = secular_root(values[first:], squares[first:], max(excess, 0.0), bounds[t], start)
            for i in range(first, n):
                add_scaled(shares[i] / (values[i] + alpha), vectors[i], estimate)
        scalars[ALPHA] = alpha
        alphas[t] = alpha
        evaluations[t] = count
        copy_vector(estimate, estimates[t])


# === Costs ========================================================================================================
# What an update costs: multiplications, divisions and roots, counted from the loops of the kernels.


# Evaluations that each root of the rank-one eigenproblem takes on average, counted over random updates.
ROOT_EVALUATIONS = 3.4


def multiplications(update: str, n: int, evaluations: float = 1.0) -> float:
    """Multiplications, divisions and square roots of one update: one of the toolbox, or ``fast``.

    For `n` unknowns. `evaluations` are those of the secular function: from `Track.evaluations` (exact, fast), or the number of
    fixed-point iterations (approximate).
    """
    accumulate = n * (n + 1) + 4 * n
    factorise = n * (n - 1) * (n - 2) / 6 + 3 * n * (n - 1) / 2 + n
    forward = n * (n - 1) / 2
    backward = forward + n
    squares = forward + 5 * n
    if update == "least squares":
        return 2.0 * n**2 + 5 * n + 3
    if update == "ridge":
        return accumulate + factorise + backward
    if update == "approximate":
        gain = forward + backward + 3 * n + 1
        return accumulate + 2 + gain + evaluations * (squares + 4 + factorise + backward)
    if update == "exact":
        trial = factorise + 2 * backward + squares + forward + 2 * n + 30
        return accumulate + 2 + evaluations * trial + forward + backward + 2 * n
    roots = n * (3 * n + ROOT_EVALUATIONS * (3 * n + 15))
    return n**3 + 8 * n**2 + 15 * n + roots + evaluations * (7 * n + 30)


def slope(sizes, costs) -> float:
    """Exponent of growth: least-squares slope of log cost over log size."""
    return float(np.polyfit(np.log(sizes), np.log(costs), 1)[0])


# === Update pictures ==============================================================================================
# Pictures of the time updates: distance from batch, accuracy of (20), cost against n.


COLOURS = {
    "least squares": figures.BLACK,
    "ridge": figures.GREEN,
    "approximate": figures.BLUE,
    "exact": figures.ORANGE,
    "fast": figures.PURPLE,
    "SOCP": figures.GREY,
}
ITERATIONS = {"approximate 1": "approximate, 1 iteration", "approximate 3": "approximate, 3 iterations"}


def paint_exactness(found: dict[str, np.ndarray]):
    """Norm of the batch estimate along time, and of the exact and the fast recursion at every eighth sample."""
    figure, axes = figures.new(height=2.8)
    time = np.arange(len(found["size"]))
    axes.plot(time, found["size"], color=figures.BLACK, linewidth=0.9, label="batch solution at every sample")
    for update, first, marker, size in (("exact", 0, "o", 3), ("fast", 4, "x", 4)):
        style = {"markersize": size, "color": COLOURS[update], "label": f"{update} recursion"}
        axes.plot(time[first::8], found[f"size_{update}"][first::8], marker, **style)
    axes.set(xlabel="time (samples)", ylabel="norm of the estimate |x|")
    axes.legend()
    return figure


def paint_accuracy(records: dict[str, dict[str, np.ndarray]]):
    """Error of alpha and of the estimate of (20) with 1, 2 and 3 iterations; one row of axes a record."""
    figure, grid = figures.new(len(records), 2, sharex=True, sharey="col", squeeze=False)
    for (title, found), (left, right) in zip(records.items(), grid, strict=True):
        for axes, name in ((left, "alpha"), (right, "approximate")):
            for iterations, colour in ((1, figures.BLUE), (2, figures.ORANGE), (3, figures.GREEN)):
                label = f"{iterations} iteration{'s' * (iterations > 1)}"
                errors = found[f"{name}_{iterations}"]
                # where (20) starts from the exact solution its error is rounding, which differs between machines
                shown = np.where(errors > 1e-11, errors, np.nan)
                axes.semilogy(shown, color=colour, linewidth=0.8, label=label)
            axes.minorticks_off()
        left.set(ylabel="relative error of α", title=title)
        right.set(ylabel="|x − batch| / max |batch|", title=f"{title}: estimate")
    for axes in grid[0]:
        axes.set_ylim(bottom=1e-10)  # after all rows: it ends the scaling of the shared axis
    figures.label(grid, "time (samples)")
    figures.legend_below(grid[0, 0], 3)
    return figure


def times_by_name() -> dict[str, np.ndarray]:
    """The committed table of benchmark times: ``unknowns`` and microseconds an update, by name."""
    rows = measured_times("worstcase", "update_times/update_times.csv")
    columns = {"unknowns": np.array(list(map(float, rows)))}
    for heading in next(iter(rows.values())):
        columns[heading.removesuffix(" (us)")] = np.array([row[heading] for row in rows.values()])
    return columns


def paint_times(times: dict[str, np.ndarray]):
    """Measured time an update against n (the committed table)."""
    figure, axes = figures.new(height=3.4)
    styles = {
        "RLS": ("least squares", "o-"),
        "ridge": ("ridge", "o-"),
        "approximate 1": ("approximate", "o-"),
        "approximate 3": ("approximate", "v:"),
        "exact": ("exact", "o-"),
        "fast": ("fast", "o-"),
        "SOCP": ("SOCP", "s-"),
    }
    for name, (kind, style) in styles.items():
        axes.loglog(
            times["unknowns"],
            times[name],
            style,
            markersize=3,
            color=COLOURS[kind],
            label=ITERATIONS.get(name, name),
        )
    axes.set(xlabel="number of unknowns n", ylabel="time per update (µs)")
    axes.legend(ncols=2)
    return figure


def explore_accuracy(bound: float, noise: float):
    """`paint_accuracy` on one record of the setting of Fig. 2."""
    truth = path("constant", FIG_2_PARAMETERS, 120)
    found = recursion_trial(np.random.default_rng(1), truth, bound, 0.95, noise)
    figure = _accuracy_figure()
    left, right = figure.axes
    for axes, name in ((left, "alpha"), (right, "approximate")):
        for line, iterations in zip(axes.lines, (1, 2, 3), strict=True):
            errors = found[f"{name}_{iterations}"]
            line.set_ydata(np.where(errors > 1e-11, errors, np.nan))
        axes.relim()
        axes.autoscale_view(scalex=False)
        axes.set_ylim(bottom=1e-10)
    left.set_title(f"η = {bound:.3g}")
    right.set_title(f"η = {bound:.3g}: estimate")
    return figure


@cache
def _accuracy_figure():
    """Figure of the explorer, kept for its next move: only its data change."""
    truth = path("constant", FIG_2_PARAMETERS, 120)
    return paint_accuracy({"η": recursion_trial(np.random.default_rng(1), truth, 1.118, 0.95, 0.1)})


# === Update choices ===============================================================================================

SMALL_BOUND, SAMPLES = 0.1, 375  # of notebook 03, which has this bound beside the large one


def updates(*, fig_2_noise: float, update_bound: float, seed: int, lean: bool) -> dict[str, float]:
    """Theorem 2, the misprint of h and (20)'s single iteration; the fast variant takes 2 records instead of 10."""
    truth = path("constant", FIG_2_PARAMETERS, SAMPLES)
    small, large = (
        run_study(
            recursion_trial, 2 if lean else 10, seed, progress=False,
            truth=truth, bound=bound, forgetting=0.95, noise=fig_2_noise,
        )
        for bound in (SMALL_BOUND, update_bound)
    )  # fmt: skip
    return update_statements(small, large)


def update_statements(small: Study, large: Study) -> dict[str, float | tuple[float, tuple[float, float]]]:
    """What records with a small and with a large bound say of the recursions, by the ledger's names."""
    largest = np.nanmax(large["alpha_1"], axis=1)
    found = {
        "theorem-2": max(study[name].max() for study in (small, large) for name in ("exact", "fast")),
        "h-as-printed": np.nanmedian(large["as_printed"]),
        "eq-18-as-printed": np.nanmedian(large["image_as_printed"]),
        "single-iteration": np.median(large["approximate_1"][:, 10:]),
        "single-iteration-large": np.nanmedian(large["alpha_1"]),
        "single-iteration-tail": np.nanquantile(large["alpha_1"], 0.95),
        "single-iteration-largest": (np.median(largest), (largest.min(), largest.max())),
    }
    return {f"worstcase.updates.{name}": value for name, value in found.items()}


# === What the notebook judges beside its answer =====================================================================


def appendix(
    page,
    *,
    row_error: float,
    forgetting: float,
    seed: int,
    studies: dict[float, Study],
    slope_sizes: list[int],
    times: dict[str, np.ndarray],
) -> None:
    """What this notebook judges beside its answer.

    Parameters
    ----------
    page : workbook.appendix.Appendix
    row_error, forgetting : float
    seed : int
    studies : dict of Study
        Of `recursion_trial`, by the bound.
    slope_sizes : list of int
        Numbers of unknowns of the slopes of the counts.
    times : dict of ndarray
        Of `times_by_name`.
    """
    page.text(r"""## The bound under forgetting

If each row is off by at most $\varepsilon$, the weighted perturbation stays below
$\varepsilon\,(\sum_j \lambda^{t-j})^{1/2} \le \varepsilon/\sqrt{1-\lambda}$ (section 5). Rows that are all off in one direction attain
it.""")
    weighting = run_study(
        weighting_trial, 500, seed, row_error=row_error, forgetting=forgetting, samples=60, progress=False
    )
    page.check("worstcase.updates.weighted-bound", np.mean(weighting["over_sum"] <= 1 + 1e-12))
    page.check("worstcase.updates.weighted-limit", np.mean(weighting["over_limit"] <= 1))
    page.show(
        f"norm over the bound: from {weighting['over_sum'].min():.2f} to {weighting['over_sum'].max():.2f}"
    )
    page.text("## One step of (20), then two and three\n\nMedian errors of the penalty and of the estimate:")
    for bound, study in studies.items():
        alphas = " ".join(f"{np.nanmedian(study[f'alpha_{k}']):.1e}" for k in (1, 2, 3))
        estimates = " ".join(f"{np.median(study[f'approximate_{k}'][:, 10:]):.1e}" for k in (1, 2, 3))
        zero = np.isnan(study["alpha"][:, 5:]).mean()
        page.show(f"η = {bound:g}: α {alphas}, estimate {estimates}; zero at {zero:.3f} of the instants")
    page.text("""## The fast algorithm, and what $O(n^2)$ means

A rank-one update of the eigenvectors of $R$ makes the *exact* root as cheap as one step of (20). The eigenvalues cost $O(n^2)$. The
eigenvectors need a product of two $n\\times n$ matrices, $n^3$ multiplications. The paper's $O(n^2)$ rests on a cited fast multipole
method, which we neither run nor judge: we count the form with the product (`cost-fast`), and tests count it in the running code.""")
    for entry, update in (
        ("cost-as-it-stands", "approximate"),
        ("cost-rls", "least squares"),
        ("cost-fast", "fast"),
    ):
        page.check(
            f"worstcase.updates.{entry}",
            slope(slope_sizes, [multiplications(update, n, 1.0) for n in slope_sizes]),
        )
    page.text("Measured:")
    page.check("worstcase.updates.time-fast", slope(times["unknowns"][3:], times["fast"][3:]))
    page.check("worstcase.updates.time-crossing", times["unknowns"][times["fast"] < times["exact"]].min())
    for name in ("RLS", "approximate 1", "exact", "fast", "SOCP"):
        over, steep = times[name] / times["RLS"], slope(times["unknowns"][3:], times[name][3:])
        page.show(
            f"{name:14s} slope from n = 50 on {steep:.2f}, over RLS: {over[0]:.3g} at n = 5, {over[-1]:.3g} at n = 200"
        )
