"""Who wins: min-max among the estimators that people reach for: what this notebook alone needs."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float64
from scipy import signal

from experiments.worstcase.total import total_least_squares
from stillwork.base.checks import InputError, require_array, require_choice
from stillwork.estimation.hinfinity import hinfinity_gains, smallest_level
from stillwork.estimation.min_max import solve_silently
from stillwork.estimation.recursive import run_silently
from stillwork.estimation.recursive_settings import MinMax
from stillwork.estimation.time_varying import TimeVaryingModel, estimate
from stillwork.identification.regressors import exponential_weights, fir_regressors
from workbook import figures
from workbook.studies import mean_interval, run_study

# === Comparison ===================================================================================================
# Who comes nearest to the truth: min-max estimation beside what else one would reach for, in many settings.
#
# All methods see the same measured rows and outputs with the same exponential weights. Each is told how large the errors
# are in the form that it asks for, as `estimates` says, and that the parameters are of norm 1. Nothing is tuned.


METHODS = {
    "least": "least squares",
    "ridge": "ridge, told the doubt",
    "bayes": "ridge, told the size",
    "total": "scaled TLS",
    "compensated": "bias compensation",
    "instrumental": "instruments",
    "hinfinity": "H-infinity",
    "min_max": "min-max, exact",
    "approximate": "min-max, (20)",
}
EXCITATIONS = ("white", "three tones", "low-pass", "tone")
CORNER, TONE = 0.1, 0.057  # of the sample rate; the tone lies where that of the room's measured record does
# of one size; what a short past foretells, so that instruments have a chance
TONES = (1 / 16, 3 / 16, 6 / 16)
MARGIN = 1.1  # level of the H-infinity filter over the smallest that there is


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


SETTINGS = {
    "noise 0.1, 0.01": Setting(0.1, 0.01),
    "noise 0.1, 0.1": Setting(0.1, 0.1),
    "noise 0.1, 1": Setting(0.1, 1.0),
    "noise 0.1, 3": Setting(0.1, 3.0),
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


@dataclass(frozen=True)
class FlawedRecord:
    """Rows and outputs as measured, and what was wrong: target = (matrix + perturbation) x + noise."""

    matrix: Float64[np.ndarray, "rows taps"]
    target: Float64[np.ndarray, " rows"]
    instruments: Float64[np.ndarray, "rows delays"]  # the measured input, older than in the rows
    perturbation: Float64[np.ndarray, "rows taps"]
    noise: Float64[np.ndarray, " rows"]
    truth: Float64[np.ndarray, " taps"]  # x at the end


def sample_record(
    rng: np.random.Generator, setting: Setting, excitation: str, taps: int, rows: int
) -> FlawedRecord:
    """An FIR filter with parameters of norm 1 in any direction, driven by `excitation`, measured as `setting` says."""
    require_choice("excitation", excitation, EXCITATIONS)
    if not 0 <= setting.jump < rows:
        raise InputError(f"jump is {setting.jump}; give at least 0 and less than the {rows} rows")
    before = 3 * taps  # no row and no instrument reaches before the record
    measured, true = _sample_inputs(rng, excitation, setting.delay, rows + before)
    measured = measured + setting.input_noise * _sample_coloured(rng, setting.input_pole, len(measured))
    lagged = fir_regressors(measured, before)[:, before:].T
    matrix, instruments = np.ascontiguousarray(lagged[:, :taps]), lagged[:, taps:]
    true_rows = setting.gain * fir_regressors(true, taps)[:, before:].T
    truth = rng.standard_normal(taps)
    truth /= np.linalg.norm(truth)
    sign = np.ones(rows)
    if setting.jump:
        sign[: -setting.jump] = -1
    noise = setting.output_noise * _sample_coloured(rng, setting.output_pole, rows)
    return FlawedRecord(
        matrix, sign * (true_rows @ truth) + noise, instruments, true_rows - matrix, noise, truth
    )


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
    """By method: ``errors``, distances from the true parameters, and ``worst``, worst-case residuals |A x - b| + eta |x|."""
    record = sample_record(rng, setting, excitation, taps, rows)
    found = np.array(list(estimates(record, forgetting).values()))
    weights = exponential_weights(rows, forgetting)[:, None]
    bound = np.linalg.norm(weights * record.perturbation, 2)
    residuals = np.linalg.norm(weights * (record.matrix @ found.T - record.target[:, None]), axis=0)
    return {
        "errors": np.linalg.norm(found - record.truth, axis=1),
        "worst": residuals + bound * np.linalg.norm(found, axis=1),
    }


def estimates(record: FlawedRecord, forgetting: float) -> dict[str, np.ndarray]:
    """Every method's estimate at the end of a record, in the order of `METHODS`.

    They are told, of the weighted data: min-max the 2-norm of the perturbation; ridge and bias compensation, which add
    and subtract it, its mean square; scaled total least squares this and that of the noise; the other ridge and the
    H-infinity filter, which start from parameters of norm 1, the sum of the two.
    """
    weights = exponential_weights(len(record.target), forgetting)[:, None]
    matrix, perturbation = weights * record.matrix, weights * record.perturbation
    target, noise = weights[:, 0] * record.target, weights[:, 0] * record.noise
    taps, memory = matrix.shape[1], np.sum(weights**2)
    bound, square = np.linalg.norm(perturbation, 2), np.sum(perturbation**2) / taps
    ratio = np.sqrt(square) / np.linalg.norm(noise)
    variance = (noise @ noise + square) / memory
    products, correlation, identity = matrix.T @ matrix, matrix.T @ target, np.eye(taps)
    recursion = run_silently(MinMax(bound, forgetting, "approximate"), record.matrix.T, record.target)
    return {
        "least": np.linalg.solve(products, correlation),
        "ridge": np.linalg.solve(products + square * identity, correlation),
        "bayes": np.linalg.solve(products + taps * variance * identity, correlation),
        "total": total_least_squares(matrix, ratio * target) / ratio,
        "compensated": np.linalg.solve(products - square * identity, correlation),
        "instrumental": instrumental_variables(matrix, target, weights * record.instruments),
        "hinfinity": hinfinity_estimate(record.matrix, record.target, np.sqrt(variance), forgetting),
        "min_max": solve_silently(matrix, target, bound).estimate,
        "approximate": recursion.estimates[:, -1],
    }


def instrumental_variables(matrix: np.ndarray, target: np.ndarray, instruments: np.ndarray) -> np.ndarray:
    """Two-stage least squares: rows are replaced by what the instruments say of them (Söderström and Stoica, 1983)."""
    explained = instruments @ np.linalg.lstsq(instruments, matrix, rcond=None)[0]
    return np.linalg.solve(explained.T @ matrix, explained.T @ target)


def hinfinity_model(matrix: np.ndarray, deviation: float, forgetting: float) -> TimeVaryingModel:
    """Constant parameters of norm 1 as a state that is seen through the rows; sample 0 is the start.

    Forgetting is the growth of the state times forgetting^(-t/2) (Sayed and Kailath, 1994).
    """
    taps = matrix.shape[1]
    identity, none, one = np.eye(taps), np.zeros((taps, 1)), np.ones((1, 1))
    seen = np.concatenate([np.zeros((1, 1, taps)), matrix[:, None]])
    growth = identity / np.sqrt(forgetting)
    return TimeVaryingModel(growth, none, none, seen, one, deviation**2 * one, identity / taps)


def hinfinity_estimate(
    matrix: np.ndarray, target: np.ndarray, deviation: float, forgetting: float
) -> np.ndarray:
    """The parameters at the end by the a-posteriori H-infinity filter of all of them, near its smallest level.

    Hassibi, Sayed and Kailath (1999), chapter 4.
    """
    model, wanted = hinfinity_model(matrix, deviation, forgetting), np.eye(matrix.shape[1])
    gains = hinfinity_gains(model, wanted, MARGIN * smallest_level(model, wanted, 1e-2))
    scale = forgetting ** (-np.arange(model.samples) / 2)
    outputs = scale * np.concatenate([[0.0], target])
    return estimate(gains, np.zeros((1, model.samples)), outputs[None])[:, -1] / scale[-1]


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
    logs = np.log(require_array("errors", errors)).mean(axis=-2)
    return np.exp(logs - logs.min(axis=-1, keepdims=True))


def among_best(errors: np.ndarray) -> np.ndarray:
    """Whether a method is level with the best of its cell; shape (..., methods).

    That is where the 99 % interval of its error over that of the best, run by run, reaches down to 1.02.
    """
    logs = np.log(require_array("errors", errors))
    best = logs.mean(axis=-2).argmin(axis=-1)[..., None, None]
    behind = logs - np.take_along_axis(logs, best, axis=-1)
    return np.apply_along_axis(lambda runs: mean_interval(runs, 0.99)[0] <= np.log(1.02), -2, behind)


DOUBTED = (
    "noise 0.5, 0.05",
    "noise 0.5, 0.5",
    "gain 0.8",
    "coloured input noise",
)  # too large an input is measured


def statements(found: dict[str, np.ndarray]) -> dict[str, float]:
    """What a map by `compare` of all `SETTINGS` says of min-max and of least squares, by the ledger's names."""
    errors, names, methods = found["errors"], list(SETTINGS), list(METHODS)
    minmax, least, total, hinfinity = (methods.index(m) for m in ("min_max", "least", "total", "hinfinity"))
    behind, level = over_best(errors), among_best(errors)
    worst = found["worst"] / found["worst"][..., minmax, None] - 1
    others = np.delete(behind, least, axis=-1).max(axis=(0, 1))
    doubtful = errors[[names.index(name) for name in DOUBTED]]
    return {
        "criterion": float(np.mean(worst.min(axis=-1) > -1e-9)),
        "criterion-least-squares": float(np.median(np.median(worst[..., least], axis=-1))),
        "level": float(level[..., minmax].mean()),
        "level-least-squares": float(level[..., least].mean()),
        "largest": float(behind[..., minmax].max()),
        "largest-least-squares": float(behind[..., least].max()),
        "least-squares-safest": float(np.mean(others > behind[..., least].max())),
        "hinfinity": float(np.mean(behind[..., minmax] < behind[..., hinfinity])),
        "errors-in-variables": float(np.mean(behind[..., minmax] < behind[..., total])),
        "noise-dominates": float(level[names.index("noise 0.1, 3"), :, minmax].mean()),
        "doubt-dominates": float(np.mean(doubtful[..., minmax] >= doubtful[..., least])),
    }


def statements_at(*, map_taps: int, map_memory: int, seed: int, lean: bool) -> dict[str, float]:
    """`statements` with other filters and records (``choices.toml``); the lean form has 16 records a cell, not 32."""
    # seeds count cells, so that those of another map must be far away
    found = compare(SETTINGS, 16 if lean else 32, seed, map_taps, 4 * map_memory, 1 - 1 / map_memory)
    return {f"worstcase.comparison.{name}": value for name, value in statements(found).items()}


def recommend(errors: np.ndarray) -> np.ndarray:
    """For every setting the method whose error, over the best one's, is smallest with the excitation that is worst for it."""
    return over_best(errors).max(axis=-2).argmin(axis=-1)


# === Comparison pictures ==========================================================================================
# Pictures of the comparison of estimators: the map of who wins, its intervals, one setting of one's own.


AGAINST = (
    ("min_max", figures.BLUE),
    ("bayes", figures.GREEN),
    ("total", figures.RED),
    ("hinfinity", figures.PURPLE),
)


def paint_map(names: list[str], errors: np.ndarray):
    """Error over that of the best in its row, one panel an excitation; a dot where it is level with the best."""
    figure, panels = figures.new(1, len(EXCITATIONS), height=5.4, sharey=True)
    behind, best = np.log2(over_best(errors)), among_best(errors)
    columns, rows = np.arange(len(METHODS)), np.arange(len(names))
    for number, (axes, title) in enumerate(zip(panels, EXCITATIONS, strict=True)):
        shades = {"cmap": "Reds", "vmin": 0, "vmax": 3, "shading": "nearest"}
        mesh = axes.pcolormesh(columns, rows, behind[:, number], **shades)
        level = np.nonzero(best[:, number])[::-1]
        axes.plot(*level, "o", markersize=4, color=figures.BLACK, label="level with the best")
        axes.set_title(title)
        axes.set_xticks(columns, METHODS.values(), rotation=90)
    panels[0].set_yticks(rows, names)
    panels[0].set_ylim(len(names) - 0.5, -0.5)
    figures.label(panels, y="what is wrong with the record")
    bar = figure.colorbar(mesh, ax=panels, label="error over that of the best", extend="max", ticks=range(4))
    bar.ax.set_yticklabels(["1", "2", "4", "8"])
    return figure


def paint_ratios(names: list[str], errors: np.ndarray):
    """Error over that of least squares, geometric mean over runs with its 95 % interval, one panel an excitation."""
    figure, panels = figures.new(1, len(EXCITATIONS), height=5.4, sharey=True, sharex=True)
    logs, order = np.log(errors), list(METHODS)
    ratios = logs - logs[..., order.index("least"), None]
    for number, (axes, title) in enumerate(zip(panels, EXCITATIONS, strict=True)):
        for place, (method, colour) in enumerate(AGAINST):
            rows = np.arange(len(names)) + 0.2 * (place - 1.5)
            style = {"markersize": 3, "color": colour, "label": METHODS[method]}
            _paint_geometric_means(axes, ratios[:, number, :, order.index(method)], rows, **style)
        axes.axvline(1, color=figures.BLACK, linestyle="--", linewidth=1)
        axes.set(xscale="log", xlim=(0.2, 8), title=title)
        axes.set_xticks([0.25, 0.5, 1, 2, 4], ["1/4", "1/2", "1", "2", "4"])
        axes.minorticks_off()
    panels[0].set_yticks(np.arange(len(names)), names)
    panels[0].set_ylim(len(names) - 0.5, -0.5)
    figures.label(panels, "over least squares")
    figures.legend_below(panels[0], len(AGAINST))
    return figure


def _paint_geometric_means(axes, logs: np.ndarray, rows: np.ndarray, **style):
    """Of the runs in every row of `logs`, with their 95 % intervals."""
    mean, ends = np.exp(logs.mean(axis=1)), np.exp([mean_interval(each) for each in logs]).T
    axes.errorbar(mean, rows, xerr=np.abs(ends - mean), fmt="o", **style)


def explore_comparison(input_noise: float, output_noise: float, gain: float, delay: float, taps: int):
    """Errors of all methods in a setting of one's own, with the 95 % interval of their geometric mean."""
    setting = {"yours": Setting(input_noise, output_noise, gain, delay)}
    errors = compare(setting, 20, 1, int(taps), 200, 0.98)["errors"][0]
    figure, axes = figures.new(height=3.6)
    colours = (figures.BLACK, figures.GREEN, figures.BLUE, figures.RED)
    for number, (name, colour) in enumerate(zip(EXCITATIONS, colours, strict=True)):
        rows = np.arange(len(METHODS)) + 0.2 * (number - 1.5)
        _paint_geometric_means(axes, np.log(errors[number]).T, rows, markersize=4, color=colour, label=name)
    axes.set_yticks(np.arange(len(METHODS)), METHODS.values())
    axes.axvline(1, color=figures.GREY, linestyle=":", label="the estimate zero")
    axes.set(xscale="log", xlabel="|x − estimate| over |x|")
    axes.xaxis.set_minor_formatter("{x:g}")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.invert_yaxis()
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), title="excitation")
    return figure
