"""Which estimator comes nearest to the truth: min-max beside the usual ones, in many settings."""

from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
from jaxtyping import Float64
from scipy import signal

from stillwork.estimation.linear_fits import (
    cross_validated_penalty,
    evidence_penalty,
    hinfinity_estimate,
    huber_estimate,
    instrumental_variables,
    total_least_squares,
)
from stillwork.estimation.min_max import solve_silently
from stillwork.estimation.recursive import track
from stillwork.identification.regressors import exponential_weights, fir_regressors
from workbook import figures
from workbook.studies import fraction, mean_interval, run_study

# === Comparison ===================================================================================================
# All methods see the same measured rows and outputs with the same exponential weights. `estimates` lists what each is
# given of the true errors. Nothing is tuned.


METHODS = {
    "least": "least squares",
    "ridge": "ridge, given the uncertainty",
    "bayes": "ridge, given the size",
    "evidence": "ridge by evidence",
    "gcv": "ridge by GCV, memory counted",
    "gcv_rows": "ridge by GCV, rows counted",
    "huber": "Huber",
    "total": "scaled TLS",
    "compensated": "bias compensation",
    "instrumental": "instruments",
    "hinfinity": "H-infinity",
    "min_max": "min-max, exact",
    "approximate": "min-max, approximate",
}
EXCITATIONS = ("white", "three tones", "low-pass", "tone")
CORNER, TONE = (
    0.1,
    0.057,
)  # of the sample rate; the tone lies where that of the measured record of notebook 06 does
# of one size; what a short past foretells, so that instruments have a chance
TONES = (1 / 16, 3 / 16, 6 / 16)
MARGIN = 1.05  # error over that of the best up to which a method counts as equal; stated before the map was computed


@dataclass(frozen=True)
class Setting:
    """What is wrong with a record; noises are standard deviations, that of the input is 1."""

    input_noise: float = 0.0
    output_noise: float = 0.1
    gain: float = 1.0  # true input over the measured one
    delay: float = 0.0  # of the true input against the measured one, samples
    input_pole: float = 0.0  # that colours the input noise
    output_pole: float = 0.0  # that colours the output noise
    jump: int = 0  # samples from a change of sign of all parameters to the end of the record; 0 for none
    outliers: float = 0.0  # share of the outputs with a hundred times the noise
    weakest: float = 1.0  # what is left of the difference between the first two regressors
    second_sensor: bool = False  # of the input, with noise of its own: its rows are the instruments
    decay: bool = False  # a mode that dies out, and its own past as regressors


SETTINGS = {
    "noise 0.1, 0.01": Setting(0.1, 0.01),
    "noise 0.1, 0.1": Setting(0.1, 0.1),
    "noise 0.1, 1": Setting(0.1, 1.0),
    "noise 0.1, 3": Setting(0.1, 3.0),
    "noise 0.1, 10": Setting(0.1, 10.0),
    "noise 0.1, 30": Setting(0.1, 30.0),
    "noise 0.5, 0.05": Setting(0.5, 0.05),
    "noise 0.5, 0.5": Setting(0.5, 0.5),
    "noise 0.5, 5": Setting(0.5, 5.0),
    "gain 0.8": Setting(gain=0.8),
    "gain 1.2": Setting(gain=1.2),
    "half a sample early": Setting(delay=-0.5),
    "half a sample late": Setting(delay=0.5),
    "coloured input noise": Setting(0.5, 0.05, input_pole=0.9),
    "coloured output noise": Setting(0.1, 1.0, output_pole=0.9),
    "jump": Setting(0.1, 0.1, jump=50),
}
# Where something else than the size of the errors decides.
STRUCTURED = {
    "outliers": Setting(0.01, 0.1, outliers=0.05),
    "near-collinear": Setting(0.01, 0.1, weakest=0.01),
    "free decay": Setting(output_noise=0.1, decay=True),
    "second sensor": Setting(0.5, 0.5, second_sensor=True),
}


@dataclass(frozen=True)
class FlawedRecord:
    """Rows and outputs as measured, and what was wrong: target = (matrix + perturbation) x + noise."""

    matrix: Float64[np.ndarray, "rows taps"]
    target: Float64[np.ndarray, " rows"]
    instruments: Float64[np.ndarray, "rows delays"]  # older samples, or a second sensor's
    perturbation: Float64[np.ndarray, "rows taps"]
    noise: Float64[np.ndarray, " rows"]
    truth: Float64[np.ndarray, " taps"]  # x at the end


def sample_record(
    rng: np.random.Generator, setting: Setting, excitation: str, taps: int, rows: int
) -> FlawedRecord:
    """An FIR filter with parameters of norm 1 in any direction, driven by `excitation`, measured as `setting` says."""
    if setting.decay:
        return sample_decay(rng, setting.output_noise, rows)
    before = 3 * taps  # no row and no instrument reaches before the record
    clean, true = _sample_inputs(rng, excitation, setting.delay, rows + before)
    measured = clean + setting.input_noise * _sample_coloured(rng, setting.input_pole, len(clean))
    lagged = fir_regressors(measured, before)[:, before:].T
    matrix, instruments = np.ascontiguousarray(lagged[:, :taps]), lagged[:, taps:]
    true_rows = setting.gain * fir_regressors(true, taps)[:, before:].T
    if setting.second_sensor:
        other = clean + setting.input_noise * _sample_coloured(rng, setting.input_pole, len(clean))
        instruments = fir_regressors(other, taps)[:, before:].T
    if (
        setting.weakest != 1 and taps > 1
    ):  # the second input is nearly the first; each has a sensor of its own
        clean_rows = fir_regressors(clean, taps)[:, before:].T
        for inputs in (clean_rows, true_rows):
            inputs[:, 1] = inputs[:, 0] + setting.weakest * (inputs[:, 1] - inputs[:, 0])
        matrix = clean_rows + setting.input_noise * rng.standard_normal(clean_rows.shape)
    truth = rng.standard_normal(taps)
    truth /= np.linalg.norm(truth)
    sign = np.ones(rows)
    if setting.jump:
        sign[: -setting.jump] = -1
    noise = setting.output_noise * _sample_coloured(rng, setting.output_pole, rows)
    if setting.outliers:
        noise = np.where(rng.random(rows) < setting.outliers, 100 * noise, noise)
    return FlawedRecord(
        matrix, sign * (true_rows @ truth) + noise, instruments, true_rows - matrix, noise, truth
    )


def sample_decay(rng: np.random.Generator, deviation: float, rows: int) -> FlawedRecord:
    """A mode of amplitude 1 that dies out to 0.1 to 0.5, measured with white noise: y_t = x1 y_(t-1) + x2 y_(t-2)."""
    angle = 2 * np.pi * rng.uniform(0.05, 0.25)
    radius = rng.uniform(0.1, 0.5) ** (1 / rows)
    truth = np.array([2 * radius * np.cos(angle), -(radius**2)])
    time = np.arange(-6, rows)
    clean = radius**time * np.cos(angle * time + rng.uniform(0, 2 * np.pi))
    measured = clean + deviation * rng.standard_normal(len(time))
    lagged, true = (fir_regressors(each, 7)[1:, 6:].T for each in (measured, clean))
    noise = measured[6:] - clean[6:]
    matrix = np.ascontiguousarray(lagged[:, :2])
    return FlawedRecord(matrix, measured[6:], lagged[:, 2:], true[:, :2] - matrix, noise, truth)


def _sample_inputs(rng, excitation, delay, count) -> tuple[np.ndarray, np.ndarray]:
    # one period of an input of deviation 1, made of lines, and the same delayed, be it by a part of a sample
    frequency = np.fft.rfftfreq(count)
    lines = rng.standard_normal(len(frequency)) + 1j * rng.standard_normal(len(frequency))
    lines[0] = 0
    lines[frequency == 0.5] = 0  # half a sample has no meaning there
    if excitation == "three tones":
        tones = np.round(np.array(TONES) * count).astype(int)
        only = np.zeros_like(lines)
        only[tones] = lines[tones] / np.abs(lines[tones])
        lines = only
    elif excitation != "white":
        lines /= 1 + 1j * frequency / CORNER
    power = np.sum(np.abs(lines) ** 2)
    if excitation == "tone":  # holds three quarters of the power
        lines[round(TONE * count)] += np.sqrt(3 * power) * np.exp(2j * np.pi * rng.random())
        power = np.sum(np.abs(lines) ** 2)
    lines *= count / np.sqrt(2 * power)
    delayed = lines * np.exp(-2j * np.pi * frequency * delay)
    return np.fft.irfft(lines, count), np.fft.irfft(delayed, count)


def _sample_coloured(rng, pole, count) -> np.ndarray:
    # stationary noise of deviation 1 with one pole
    start = pole * rng.standard_normal(1)
    driven = np.sqrt(1 - pole**2) * rng.standard_normal(count)
    return signal.lfilter([1.0], [1.0, -pole], driven, zi=start)[0]


def comparison_trial(
    rng: np.random.Generator, setting: Setting, excitation: str, taps: int, rows: int, forgetting: float
) -> dict[str, np.ndarray]:
    """By method: ``errors``, distances from the true parameters over their norm, and ``worst``, |A x - b| + eta |x|."""
    record = sample_record(rng, setting, excitation, taps, rows)
    found = np.array(list(estimates(record, forgetting).values()))
    weights = exponential_weights(rows, forgetting)[:, None]
    bound = np.linalg.norm(weights * record.perturbation, 2)
    residuals = np.linalg.norm(weights * (record.matrix @ found.T - record.target[:, None]), axis=0)
    return {
        "errors": np.linalg.norm(found - record.truth, axis=1) / np.linalg.norm(record.truth),
        "worst": residuals + bound * np.linalg.norm(found, axis=1),
    }


def estimates(record: FlawedRecord, forgetting: float) -> dict[str, np.ndarray]:
    """Every method's estimate at the end of a record, in the order of `METHODS`.

    They are given, of the weighted data: min-max the 2-norm of the perturbation; ridge and bias compensation, which add
    and subtract it, its mean square; scaled total least squares this and that of the noise; ridge given the size and the
    H-infinity filter, which start from parameters of the true norm, the sum of the two. Least squares, ridge by evidence
    or by cross-validation, and Huber's estimate are given nothing.
    """
    weights = exponential_weights(len(record.target), forgetting)[:, None]
    matrix, perturbation = weights * record.matrix, weights * record.perturbation
    target, noise = weights[:, 0] * record.target, weights[:, 0] * record.noise
    taps, memory = matrix.shape[1], np.sum(weights**2)
    bound, square = np.linalg.norm(perturbation, 2), np.sum(perturbation**2) / taps
    ratio = np.sqrt(square) / np.linalg.norm(noise)
    size = record.truth @ record.truth
    variance = (noise @ noise + square * size) / memory
    products, correlation, identity = matrix.T @ matrix, matrix.T @ target, np.eye(taps)
    settings = {"bound": bound, "iterations": 1, "silent": True}
    recursion = track(record.matrix.T, record.target, forgetting, **settings)
    penalties = {
        "evidence": evidence_penalty(matrix, target, memory),
        "gcv": cross_validated_penalty(matrix, target, memory),
        "gcv_rows": cross_validated_penalty(matrix, target, len(target)),
    }
    return {
        "least": np.linalg.solve(products, correlation),
        "ridge": np.linalg.solve(products + square * identity, correlation),
        "bayes": np.linalg.solve(products + taps * variance / size * identity, correlation),
        **{
            name: np.linalg.solve(products + each * identity, correlation) for name, each in penalties.items()
        },
        "huber": huber_estimate(record.matrix, record.target, weights[:, 0] ** 2),
        "total": total_least_squares(matrix, ratio * target) / ratio,
        "compensated": np.linalg.solve(products - square * identity, correlation),
        "instrumental": instrumental_variables(matrix, target, weights * record.instruments),
        "hinfinity": hinfinity_estimate(record.matrix, record.target, variance, size, forgetting),
        "min_max": solve_silently(matrix, target, bound).estimate,
        "approximate": recursion.estimates[:, -1],
    }


def compare(
    settings: dict[str, Setting], runs: int, seed: int, taps: int, rows: int, forgetting: float
) -> dict[str, Float64[np.ndarray, "settings excitations runs methods"]]:
    """`comparison_trial` in every setting with every excitation: ``errors`` and ``worst``.

    Cell k, counted along the rows, has the root seed `seed` + k: its runs are independent of all others, and it can be
    made again on its own.
    """
    cells = [
        run_study(
            comparison_trial, runs, seed + number, progress=False, setting=setting, excitation=excitation,
            taps=taps, rows=rows, forgetting=forgetting,
        ).values
        for number, (setting, excitation) in enumerate(product(settings.values(), EXCITATIONS))
    ]  # fmt: skip
    shape = (len(settings), len(EXCITATIONS), runs, len(METHODS))
    return {key: np.reshape([cell[key] for cell in cells], shape) for key in ("errors", "worst")}


def over_best(errors: np.ndarray) -> np.ndarray:
    """Geometric mean over runs of every method's error, over the smallest of a cell; shape (..., methods)."""
    logs = np.log(errors).mean(axis=-2)
    return np.exp(logs - logs.min(axis=-1, keepdims=True))


def best_intervals(errors: np.ndarray) -> np.ndarray:
    """95 % interval of every method's error over that of the best of its cell, run by run; shape (2, ..., methods).

    The best is found from every second run, the interval from the others.
    """
    logs = np.log(errors)
    best = logs[..., ::2, :].mean(axis=-2).argmin(axis=-1)[..., None, None]
    proof = logs[..., 1::2, :]
    behind = proof - np.take_along_axis(proof, best, axis=-1)
    return np.moveaxis(np.exp(np.apply_along_axis(mean_interval, -2, behind)), -2, 0)


def equal_to_best(errors: np.ndarray) -> np.ndarray:
    """Whether a method is equal to the best of its cell: its whole interval lies below `MARGIN`; shape (..., methods)."""
    return best_intervals(errors)[1] < MARGIN


def worse_than_best(errors: np.ndarray) -> np.ndarray:
    """Whether a method is worse than the best of its cell: its whole interval lies above `MARGIN`; shape (..., methods)."""
    return best_intervals(errors)[0] > MARGIN


MISJUDGED = (
    "noise 0.5, 0.05",
    "noise 0.5, 0.5",
    "gain 0.8",
    "coloured input noise",
)  # too large an input is measured


def statements(found: dict[str, np.ndarray]) -> dict[str, float | tuple[float, tuple[float, float]]]:
    """What a map by `compare` of all `SETTINGS` says, by the ledger's names."""
    errors, names, methods = found["errors"], list(SETTINGS), list(METHODS)
    minmax, least, total, hinfinity = (methods.index(m) for m in ("min_max", "least", "total", "hinfinity"))
    behind, equal, worse = over_best(errors), equal_to_best(errors), worse_than_best(errors)
    worst = found["worst"] / found["worst"][..., minmax, None] - 1
    largest = dict(zip(methods, behind.max(axis=(0, 1)), strict=True))
    loses = (errors[..., minmax] >= errors[..., least])[[names.index(name) for name in MISJUDGED]]
    said = {
        "criterion": float(np.mean(worst.min(axis=-1) > -1e-9)),
        "criterion-least-squares": float(np.median(np.median(worst[..., least], axis=-1))),
        "hinfinity": float(np.mean(behind[..., minmax] < behind[..., hinfinity])),
        "errors-in-variables": float(np.mean(behind[..., minmax] < behind[..., total])),
        "uncertainty-dominates": fraction(loses.ravel()),
        "size-ridge-safest": float(np.mean([largest[m] > largest["bayes"] for m in methods if m != "bayes"])),
    }
    for name, method in REPORTED.items():
        said[f"largest-{name}"] = float(largest[method])
    for name in ("min-max", "least-squares", "size-ridge"):
        said[f"equal-{name}"] = float(equal[..., methods.index(REPORTED[name])].mean())
        said[f"worse-{name}"] = float(worse[..., methods.index(REPORTED[name])].mean())
    return {f"worstcase.comparison.{name}": value for name, value in said.items()}


# Methods whose largest error over the best of a cell stands in the ledger, by their names there.
REPORTED = {
    "min-max": "min_max",
    "least-squares": "least",
    "size-ridge": "bayes",
    "evidence": "evidence",
    "gcv": "gcv",
    "gcv-rows": "gcv_rows",
}
SWEEP = (0.3, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 30.0)  # output noise over the signal


def turning_points(errors: np.ndarray, noises: tuple[float, ...] = SWEEP) -> dict[str, float]:
    """Between which output noises min-max pays, of errors (noises, excitations, runs, methods), by the ledger's names.

    From where it is nearer to the truth than least squares with every excitation, and up to where it is nearer than the
    estimate zero with every excitation: crossings of the geometric means, by lines between logarithms; NaN for none.
    """
    logs, methods = np.log(errors).mean(axis=2), list(METHODS)
    own = logs[..., methods.index("min_max")]
    to_least, to_zero = own - logs[..., methods.index("least")], own
    return {
        "worstcase.comparison.pays-from": _crossing(noises, to_least.max(axis=1), falling=True),
        "worstcase.comparison.pays-to": _crossing(noises, to_zero.max(axis=1), falling=False),
        "worstcase.comparison.evidence-at-the-end": float(
            np.exp(logs[-1, :, methods.index("evidence")].max())
        ),
    }


def pays_between(memory: int, runs: int, seed: int, taps: int) -> tuple[list[float], list[float]]:
    """Where min-max begins to pay and where it ends, as in `turning_points`, with a memory; of six seeds together, then of each.

    Few runs find the beginning late and the end soon: their largest mean of four excitations is too large.
    """
    cells = {f"{n:g}": Setting(0.1, n) for n in SWEEP}
    how = {"taps": taps, "rows": 4 * memory, "forgetting": 1 - 1 / memory}
    seeds = range(seed, seed + 6000, 1000)
    parts = [compare(cells, max(runs // 8, 2), each, **how)["errors"] for each in seeds]
    ends = [turning_points(each) for each in (np.concatenate(parts, axis=2), *parts)]
    first, last = ([found[f"worstcase.comparison.pays-{end}"] for found in ends] for end in ("from", "to"))
    return first, last


def structured_ratios(errors: np.ndarray) -> dict[str, float]:
    """What a map of all `STRUCTURED` says, by the ledger's names: ratios of geometric means, largest of the excitations."""
    means, methods = np.exp(np.log(errors).mean(axis=2)), list(METHODS)

    def ratio(row, one, other, excitations=slice(None)) -> float:
        own = means[list(STRUCTURED).index(row), excitations]
        return float((own[:, methods.index(one)] / own[:, methods.index(other)]).max())

    white = slice(1)

    found = {
        "outliers": ratio("outliers", "huber", "min_max"),
        "near-collinear": ratio("near-collinear", "min_max", "least"),
        "free-decay": ratio("free decay", "total", "least"),
        "free-decay-min-max": ratio("free decay", "min_max", "least"),
        "second-sensor": ratio("second sensor", "instrumental", "least", white),
        "second-sensor-min-max": ratio("second sensor", "min_max", "least", white),
    }
    return {f"worstcase.comparison.structured.{name}": value for name, value in found.items()}


def _crossing(noises, logs, falling: bool) -> float:
    # the last passage below zero, or the first above it
    found = np.nan
    for k in range(len(logs) - 1):
        one, two = logs[k], logs[k + 1]
        if (one > 0 >= two) if falling else (one <= 0 < two):
            share = one / (one - two)
            found = float(np.exp(np.log(noises[k]) + share * np.log(noises[k + 1] / noises[k])))
            if not falling:
                break
    return found


def statements_at(*, map_taps: int, map_memory: int, seed: int, lean: bool) -> dict:
    """`statements` and `turning_points` with other filters and records; the lean form has 16 records a cell, not 40."""
    # seeds count cells, so that those of another map must be far away
    how = {
        "runs": 16 if lean else 64,
        "taps": map_taps,
        "rows": 4 * map_memory,
        "forgetting": 1 - 1 / map_memory,
    }
    sweep = compare({f"{n:g}": Setting(0.1, n) for n in SWEEP}, seed=seed + 500, **how)
    return statements(compare(SETTINGS, seed=seed, **how)) | turning_points(sweep["errors"])


# === Comparison pictures ==========================================================================================


LEVELS = (1.0, 1.1, 1.5, 2.0, 4.0, 8.0, 100.0)  # of the map's colours


def paint_min_max(names: list[str], errors: np.ndarray):
    """Min-max's error over that of the best in every cell, a row a setting, a column an excitation; framed: equal, dots: open."""
    number = list(METHODS).index("min_max")
    values, equal, worse = (of(errors)[..., number] for of in (over_best, equal_to_best, worse_than_best))
    marks = {"equal to the best": ("s", equal), "open": (".", ~(equal | worse))}
    return _paint_cells("min-max's error over that of the best", names, EXCITATIONS, values, marks)


def paint_map(names: list[str], errors: np.ndarray):
    """Largest error over that of the best, of the excitations, a row a setting; framed: the smallest of a row."""
    largest = over_best(errors).max(axis=1)
    smallest = largest == largest.min(axis=1, keepdims=True)
    title = "error over that of the best; a square: the worst of four cells, one an excitation"
    return _paint_cells(title, names, METHODS.values(), largest, {"smallest of the row": ("s", smallest)})


def _paint_cells(title: str, names, columns, values: np.ndarray, marks: dict):
    from matplotlib.colors import BoundaryNorm

    few = len(columns) < 8
    figure, axes = figures.new(height=0.25 * len(names) + 1.2 if few else 0.33 * len(names) + 2.6)
    norm = BoundaryNorm(LEVELS, 256)
    at = np.arange(len(columns)), np.arange(len(names))
    axes.pcolormesh(*at, values, cmap="Reds", norm=norm, shading="nearest", alpha=0.75)
    for (row, column), value in np.ndenumerate(values):
        word = f"{value:.2f}" if value < 1.995 else f"{value:.1f}" if value < 9.95 else f"{value:.0f}"
        ink = "white" if value >= LEVELS[-2] else "black"
        axes.text(column, row, word, ha="center", va="center", fontsize=6.5, color=ink)
    for label, (mark, where) in marks.items():
        rows, places = np.nonzero(where)
        look = {"ms": 18, "mfc": "none"} if mark == "s" else {"ms": 6}
        axes.plot(places + 0.25 * (mark == "."), rows, mark, mec=figures.BLUE, mew=1.5, label=label, **look)
    axes.set_xticks(at[0], columns, rotation=0 if few else 90)
    axes.set_yticks(at[1], names)
    axes.set(ylim=(len(names) - 0.5, -0.5), xlabel="excitation" if few else "method")
    axes.grid(visible=False)
    axes.set_title(title)
    # Beside few rows there is no height for the whole label.
    axes.set_ylabel("what is wrong (noise: input, output)" if len(names) > 8 else "what is wrong")
    figure.legend(loc="outside upper center", ncols=len(marks), markerscale=0.5)
    return figure


def paint_turning(noises, errors: np.ndarray):
    """Errors over that of least squares and over that of the estimate zero, by output noise; a column an excitation."""
    figure, panels = figures.new(2, len(EXCITATIONS), height=5.0, sharey="row", sharex=True)
    means, methods = np.exp(np.log(errors).mean(axis=2)), list(METHODS)
    turns = turning_points(errors, noises)
    pays = [turns[f"worstcase.comparison.pays-{end}"] for end in ("from", "to")]
    colours = {"min_max": "BLUE", "bayes": "GREEN", "evidence": "ORANGE", "gcv": "SKY"}
    for number, (upper, lower) in enumerate(panels.T):
        least = means[:, number, methods.index("least")]
        for axes, below in ((upper, least), (lower, 1.0)):
            axes.axvspan(
                *pays, color=figures.GREY, alpha=0.2, lw=0, label="min-max beats both in every panel"
            )
            axes.axhline(1, color=figures.BLACK, lw=0.8, ls=":", label="least squares (top), zero (bottom)")
            for name, colour in colours.items():
                look = {"color": getattr(figures, colour), "linestyle": "--" if name == "gcv" else "-"}
                axes.plot(noises, means[:, number, methods.index(name)] / below, label=METHODS[name], **look)
        upper.set(title=EXCITATIONS[number], xscale="log", yscale="log", ylim=(0.05, 2.5))
        upper.set_yticks([0.0625, 0.125, 0.25, 0.5, 1, 2], ["1/16", "1/8", "1/4", "1/2", "1", "2"])
        upper.minorticks_off()
    figures.label(panels, "output noise / signal")
    panels[0, 0].set_ylabel("error over least squares'")
    panels[1, 0].set_ylabel("error over that of zero")
    figures.legend_below(panels[0, 0], 2)
    return figure


def explore_comparison(input_noise: float, output_noise: float, gain: float, delay: float, taps: int):
    """Errors of all methods in a setting of one's own, with the 95 % interval of their geometric mean over 4 records.

    A record takes 3 ms, and the picture has 0.1 s for 16 of them.
    """
    setting = {"yours": Setting(input_noise, output_noise, gain, delay)}
    logs = np.log(compare(setting, 4, 1, int(taps), 200, 0.98)["errors"][0]).swapaxes(1, 2)
    figure, axes, bars = _comparison_figure()
    mean, ends = logs.mean(axis=2), np.array([[mean_interval(each) for each in rows] for rows in logs])
    for (points, _, (intervals,)), middle, pair in zip(bars, np.exp(mean), np.exp(ends), strict=True):
        rows = points.get_ydata()
        points.set_xdata(middle)
        intervals.set_segments([[(x, y) for x in both] for both, y in zip(pair, rows, strict=True)])
    low, high = min(ends.min(), 0.0), max(ends.max(), 0.0)
    margin = 0.05 * (high - low)
    axes.set_xlim(np.exp(low - margin), np.exp(high + margin))
    return figure


@cache
def _comparison_figure():
    """Figure, axes and error bars of the explorer, kept for its next move: only their data change."""
    figure, axes = figures.new(height=3.6)
    colours, ones = (figures.BLACK, figures.GREEN, figures.BLUE, figures.RED), np.ones(len(METHODS))
    bars = []
    for number, (name, colour) in enumerate(zip(EXCITATIONS, colours, strict=True)):
        rows = np.arange(len(METHODS)) + 0.2 * (number - 1.5)
        style = {"fmt": "o", "markersize": 4, "color": colour, "label": name}
        bars.append(axes.errorbar(ones, rows, xerr=ones / 2, **style))
    axes.set_yticks(np.arange(len(METHODS)), METHODS.values())
    axes.axvline(1, color=figures.GREY, linestyle=":", label="the estimate zero")
    axes.set(xscale="log", xlabel="|x − estimate| over |x|")
    axes.xaxis.set_minor_formatter("{x:g}")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.invert_yaxis()
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), title="excitation")
    return figure, axes, bars


# === What the notebook judges beside its answer =====================================================================


def appendix(
    page, *, found: dict[str, np.ndarray], said: dict, sweep: np.ndarray, structured: np.ndarray
) -> None:
    """What this notebook judges beside its answer.

    Parameters
    ----------
    page : workbook.appendix.Appendix
    found : dict
        Of `compare`, of all `SETTINGS`.
    said : dict
        Of `statements`.
    sweep, structured : ndarray
        Errors over the output noise, and of all `STRUCTURED`.
    """
    errors, methods = found["errors"], list(METHODS)
    page.text(OTHER_METHODS)
    _of_criterion(page, found, said)
    page.text("""## All methods

Error over that of the best in the worst of a row's four cells, one an excitation; then how often a method is proved equal to the
best of its cell, and its largest error over the best.""")
    page.save("methods", paint_map(list(SETTINGS), errors))
    behind, equal = over_best(errors), equal_to_best(errors)
    for number, name in enumerate(METHODS.values()):
        share, most = equal[..., number].mean(), behind[..., number].max()
        page.show(
            f"{name:28s} equal to the best in {share:4.0%} of the cells, at most {most:.2g} times its error"
        )
    answered = ("equal-min-max", "worse-min-max", "hinfinity", "errors-in-variables", "largest-min-max")
    for entry, value in said.items():
        if "criterion" not in entry and entry.rpartition(".")[2] not in answered:
            page.check(entry, *(value if isinstance(value, tuple) else (value,)))
    entry = "worstcase.comparison.evidence-at-the-end"
    page.check(entry, turning_points(sweep)[entry])
    apart = np.log(errors[..., methods.index("approximate")] / errors[..., methods.index("min_max")]).mean(
        axis=-1
    )
    most = float(np.abs(np.expm1(apart)).max())
    page.check("worstcase.comparison.approximate", most)
    page.conclude("The approximate update (20) errs as the exact one does, to {most:.1%}.", most=most)
    _of_structure(page, structured)


def _of_criterion(page, found: dict[str, np.ndarray], said: dict) -> None:
    page.text("""## In its own criterion

No estimate has a smaller worst case $\\|A_wx-b_w\\|+\\eta\\|x\\|$: "less conservative" holds by definition.""")
    methods, names = list(METHODS), list(SETTINGS)
    worst = found["worst"] / found["worst"][..., methods.index("min_max"), None] - 1
    given_away = np.median(worst[..., methods.index("least")], axis=-1)
    for entry in ("criterion", "criterion-least-squares"):
        page.check(f"worstcase.comparison.{entry}", said[f"worstcase.comparison.{entry}"])
    row, column = np.unravel_index(given_away.argmax(), given_away.shape)
    page.conclude(
        "Least squares costs {low:.1%} to {high:.0%} of the worst case (medians of the cells), most with {row}, {column}.",
        low=given_away.min(),
        high=given_away.max(),
        row=names[row],
        column=EXCITATIONS[column],
    )


def _of_structure(page, structured: np.ndarray) -> None:
    page.text("""## Where something else decides

Four more rows: a twentieth of the outputs with a hundred times the noise; two inputs that differ by a hundredth; a free decay with
its own past as regressors (no excitation: its four cells are four draws); and a second sensor of the input, whose rows are the
instruments.""")
    page.save("structured", paint_map(list(STRUCTURED), structured))
    for entry, value in structured_ratios(structured).items():
        page.check(entry, value)


OTHER_METHODS = r"""## The other methods

- ridge without such numbers: $c$ has the largest evidence (MacKay, 1992) or the smallest generalised cross-validation (Golub, Heath
  and Wahba, 1979), which counts the memory $m$ or all samples as its rows;
- Huber's estimate;
- total least squares with both noises scaled to one size, $\min_x\|A_wx-b_w\|^2/(q\|x\|^2+r)$;
- instrumental variables, with $2n$ older samples of the measured input;
- the a-posteriori $H_\infty$ filter of the constant $x$ (Hassibi, Sayed and Kailath, 1999), 10 % above the smallest $\gamma$ for which
  $P_t^{-1}-\gamma^{-2}I$ stays positive, with the information

$$P_{t+1}^{-1}=\lambda\,(P_t^{-1}-\gamma^{-2}I)+\frac{m}{q+r}\,a_{t+1}a_{t+1}^T,\qquad P_0=I/n.$$
"""
