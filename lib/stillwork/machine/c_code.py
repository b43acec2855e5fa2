"""C99 of a controller or an adaptation, from templates, with the numbers computed here."""

import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from string import Template
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float64

from stillwork.base.bounds import Count, NonNegative, Positive, one_of, within
from stillwork.base.checks import (
    InputError,
    pluralise,
    require_array,
    require_kind,
    require_number,
    short_repr,
)
from stillwork.base.validation import checked
from stillwork.control.digital import DigitalController, without_dead_states
from stillwork.control.feedforward import Motion
from stillwork.control.setpoint import HALVINGS
from stillwork.estimation.adaptive import FeLms, FeRls
from stillwork.estimation.triangle_kernels import POWER, SINGULAR, least_share, start_record
from stillwork.machine.isolation import POWERS, FeedforwardLoop
from stillwork.machine.single_precision import in_single_precision, kept_states

TEMPLATES = Path(__file__).parent / "c99"
PRECISIONS: dict[str, Any] = {"double": np.float64, "single": np.float32}
PATIENCE_S = 0.01  # for which the loop of an isolator holds a missing sensor
REARM_S = (
    300.0  # in which a floor that stays louder raises the level of the guard by e: a gust of 30 s by a tenth
)
FADE = 1 / 8  # of the time until its filters have settled, in which its feedforward then rises


@checked
def controller_code(controller: DigitalController, name: str, precision: str = "double") -> dict[str, str]:
    """C99 of a controller that allocates nothing: text by the name of its file.

    ``name.h`` and ``name.c`` are the controller itself, ``name_motion.h`` and ``name_motion.c`` of one with a `motion`
    its setpoint and feedforward. A state is x + (A - I)x + ..., with its rounding errors kept beside it: in single
    precision a slow pole stays accurate, and an integrator accumulates steps below its resolution. Products with zero,
    and states that reach no output, are left out.

    Parameters
    ----------
    controller : DigitalController
    name : str
        What all names in it begin with.
    precision : str
        ``double`` or ``single``.

    Returns
    -------
    dict of str to str

    Raises
    ------
    InputError
        When `name` is no name in C, or single precision does not hold the controller, see `in_single_precision`.

    References
    ----------
    Middleton and Goodwin, Digital Control and Estimation (1990).

    Examples
    --------
    >>> pid = lti.tustin(control.PidFamily(10.0)(50.0).state_space(), 1e-4)
    >>> files = machine.controller_code(control.DigitalController(pid, ("e (m)",), ("f (N)",)), "pid")
    >>> sorted(files), "pid_step(" in files["pid.c"]
    (['pid.c', 'pid.h'], True)
    """
    write = Numbers(name, precision)
    single = precision == "single"
    controller = in_single_precision(controller).controller if single else without_dead_states(controller)
    commands, changes, start = _steps(write, controller)
    late, text = controller.delay, commands + changes
    marks = {
        "x": len(controller.model.a),
        "d": late,
        "n": not late,
        "m": controller.motion,
        **{mark: f" {mark}[" in text for mark in "efw"},
        **{mark: f" {mark.lower()}[" in start for mark in "EF"},
    }
    steps = {"start": start, "commands": commands, "changes": changes.rstrip()}
    values = _facts(write, controller, precision) | steps
    if controller.motion is None:
        return write.files("controller", name, values, marks)
    values["designed"] += _lines(_designed_motion(write, controller.motion))
    values["halvings"] = HALVINGS
    moving = write.files("motion", f"{name}_motion", values, marks)
    return write.files("controller", name, values, marks) | moving


def _steps(write: "Numbers", controller: DigitalController) -> tuple[str, str, str]:
    """Lines in C of the commands, of what they change in the states, and of the states that a start in rest has."""
    m, n = controller.model, len(controller.inputs)
    states, outputs = len(m.a), len(controller.outputs)
    rows = np.hstack([m.a - np.diag(kept_states(controller).astype(float)), m.b])
    names = {"x": states, "e": n, "f": controller.fed_back}
    if controller.anti_windup.any():
        rows, names = np.hstack([rows, controller.anti_windup]), names | {"w": outputs}
    across = [f"{each}[{k}]" for each, count in names.items() for k in range(count)]
    commands = _lines(
        f"v[{k}] = {write.terms(row, across[: states + n])};"
        for k, row in enumerate(np.hstack([m.c, m.d[:, :n]]))
    )
    changes = _lines(f"change[{k}] = {write.terms(row, across)};" for k, row in enumerate(rows))
    into = [f"{each}[{k}]" for each, count in (("e", n), ("f", outputs)) for k in range(count)]
    start = _lines(
        (f"s->state[{k}] = {write.terms(row, into)};" for k, row in enumerate(controller.start)), 8
    )
    return commands, changes, start


def _facts(write: "Numbers", controller: DigitalController, precision: str) -> dict:
    """Names, sizes, limits and units for the templates."""
    m, n, late = controller.model, len(controller.inputs), controller.delay
    states = len(m.a)
    limits = [
        [write(end) if np.isfinite(end) else ("-INFINITY" if end < 0 else "INFINITY") for end in ends]
        for ends in (controller.low, controller.high)
    ]
    ones = [write(1)] * n
    designed = [f"{{{', '.join(each)}}}," for each in (ones, *limits)] + [f"{controller.patience},"]
    return {
        "title": f"{write.name}: {pluralise(states, 'state')}, {1 / m.sample_time:g} samples a second, {precision} precision.",
        "signals": "\n   ".join(
            [f"in[{k}]: {_comment(text)}" for k, text in enumerate(controller.inputs)]
            + [f"out[{k}]: {_comment(text)}" for k, text in enumerate(controller.outputs)]
        ),
        "inputs": n,
        "outputs": len(controller.outputs),
        "states": states,
        "delay": late,
        "sample_time": repr(m.sample_time),
        "late": f", {pluralise(late, 'sample')} late" if late else "",
        "designed": _lines(designed),
        "keeps": ", ".join(write(each) for each in kept_states(controller)),
        "zero": write(0),
        "position": _unit(controller.inputs[0]),
        "force": _unit(controller.outputs[0]),
    }


def _designed_motion(write: "Numbers", motion: Motion) -> list[str]:
    """Gains, lag and limits as the struct of what may be tuned holds them."""
    gains, limits = asdict(motion.feedforward), motion.limits and asdict(motion.limits)
    whole = Numbers(write.name, "double")
    rates = ("velocity", "acceleration", "jerk", "snap")
    reached = [0.0 if not limits or limits[name] == np.inf else limits[name] for name in rates]
    return [f"{write(gains[name])}," for name in (*rates, "coulomb")] + [
        f"{whole(each)}," for each in (motion.lag, *reached)
    ]


@checked
def adaptation_code(
    settings: FeLms | FeRls, actuators: Count, regressors: Count, name: str, precision: str = "double"
) -> dict[str, str]:
    """C99 of the self-tuned feedforward that allocates nothing: text by the name of its file.

    FeRLS keeps P in Bierman's factors whatever the precision; float32 holds these where it loses P itself. FeLMS
    keeps the rounding error of each weight: otherwise small steps would be lost in single precision. With a `path_delay` the
    update takes N[u], too, and a sample without an update is passed.

    Parameters
    ----------
    settings : FeLms or FeRls
        Of FeRLS the form ``safe`` or ``UD``; its dtype is that of `precision`.
    actuators, regressors : int
        Rows and columns of W.
    name : str
        What all names in it begin with.
    precision : str
        ``double`` or ``single``.

    Returns
    -------
    dict of str to str

    Raises
    ------
    InputError
        When `name` is not a valid name in C, or the settings need another form or do not fit.

    References
    ----------
    Bierman, Factorization Methods for Discrete Sequential Estimation (1977).

    Examples
    --------
    >>> sorted(machine.adaptation_code(estimation.FeRls(1e3), 6, 9, "feed"))
    ['feed.c', 'feed.h']
    """
    write = Numbers(name, precision)
    sizes = {"actuators": actuators, "regressors": regressors}
    delay = settings.path_delay
    marks = {"m": delay is not None, "p": delay is None}
    values = sizes | {
        "delay": delay,
        "places": 1 + (delay or 0),
        "zero": write(0),
        "one": write(1),
        "title": f"{name}: {actuators} x {regressors} weights by {type(settings).__name__}, {precision} precision.",
    }
    values["shared"] = write._text("adaptation.c", values, marks).rstrip()
    if isinstance(settings, FeLms):
        values["fields"] = (
            f"    {name}_real rest[{actuators}][{regressors}]; /* what rounding has left of W */"
        )
        values |= {each: write(getattr(settings, each)) for each in ("step_size", "regularisation")}
        values["copies"] = write(settings.trace_copies(actuators))
        return write.files(("adaptation", "felms"), name, values, marks)
    if settings.form not in ("safe", "UD"):
        raise InputError(f"settings.form is {settings.form!r}; C code exists for 'safe' and 'UD'")
    dtype = PRECISIONS[precision].__name__
    kept = {each: getattr(settings, each) for each in ("initial_covariance", "forgetting", "growth_limit")}
    recursion = FeRls(**kept, form="UD", dtype=dtype).start(regressors)
    unlimited = settings.growth_limit == np.inf
    values |= {
        "forgetting": write(recursion.forgetting),
        "allowance": "INFINITY" if unlimited else write(recursion.allowance),
        "limits": ", ".join("INFINITY" if unlimited else write(level) for level in recursion.levels[0]),
        "first": ",\n".join("    {" + ", ".join(map(write, row)) + "}" for row in recursion.matrix),
        "sqrt": "sqrt" if precision == "double" else "sqrtf",
        "fields": _lines(
            f"{name}_real {field}[{regressors}]; /* {what} */"
            for field, what in (
                (f"factor[{regressors}]", "row j: column j of U, D on the diagonal; P = U D U'"),
                ("limit", "of each variance"),
                ("power", "of each regressor in the window"),
                ("held", "share of the last time constant in which the limit held it"),
            )
        )
        + "    int axis; /* whose limit is looked at next */",
    }
    return write.files(("adaptation", "ferls"), name, values, marks)


@checked
def least_squares_code(
    estimator: Any, features: Count, outputs: Count, name: str, precision: str = "double"
) -> dict[str, str]:
    """C99 of `RecursiveLeastSquares` that allocates nothing: text by the name of its file.

    It is the kernel of Python, in double precision bit by bit: a row is turned into the triangle, lost rows let time pass.

    Parameters
    ----------
    estimator : RecursiveLeastSquares
        Its settings, without a window; an initial estimate has a covariance.
    features, outputs : int
        Of a row.
    name, precision : str
        See `controller_code`.

    Returns
    -------
    dict of str to str

    Raises
    ------
    InputError
        When `name` is no name in C, or a setting has no C.

    Examples
    --------
    >>> sorted(machine.least_squares_code(estimation.RecursiveLeastSquares(forgetting=0.99), 3, 1, "rls"))
    ['rls.c', 'rls.h']
    """
    from stillwork.estimation.recursive_least_squares import RecursiveLeastSquares

    write = Numbers(name, precision)
    require_kind("estimator", estimator, RecursiveLeastSquares)
    if estimator.window is not None:
        raise InputError("estimator.window has no C; use forgetting, or keep the rows of a window yourself")
    given = estimator.initial_coef
    if given is not None and estimator.initial_covariance is None:
        raise InputError("estimator.initial_coef has C only with initial_covariance; give it")
    first = np.zeros((outputs, features))
    if given is not None:
        first[:] = require_array("estimator.initial_coef", given, shape=first.shape[outputs == 1 :])
    record = start_record(first, estimator.initial_covariance)
    forgetting = require_number("estimator.forgetting", estimator.forgetting, above=0.0, at_most=1.0)
    single = precision == "single"
    values = {
        "title": f"{name}: recursive least squares, {features} features, {pluralise(outputs, 'output')}, {precision} precision.",
        "features": features,
        "outputs": outputs,
        "columns": features + outputs,
        "zero": write(0),
        "one": write(1),
        "two": write(2),
        "forgetting": write(forgetting),
        "share": write(max(least_share(estimator.growth_limit), 1e-30 if single else 0.0)),
        "singular": write(1e-6 if single else SINGULAR),
        "first": _rows(write, record[:features]).rstrip(),
        "power": ", ".join(map(write, record[features + POWER, :features])),
        "sqrt": "sqrtf" if single else "sqrt",
        "fabs": "fabsf" if single else "fabs",
    }
    return write.files("least_squares", name, values, {"C": bool(estimator.fit_intercept)})


def _limit(name: str, value) -> float:
    return np.inf if isinstance(value, float) and value == np.inf else require_number(name, value, above=0.0)


@checked
def isolation_code(
    loop: FeedforwardLoop,
    settings: FeLms | FeRls,
    weights: Float64[np.ndarray, "axes regressors"],
    guard: Float64[np.ndarray, "regressors regressors"],
    growth: Annotated[float, within(at_least=1.0)],
    limit: Annotated[float, _limit],
    pause_s: NonNegative,
    name: str,
    precision: str = "double",
) -> dict[str, str]:
    """C99 of the whole loop of an isolator, which allocates nothing: text by the name of its file.

    ``name.h`` and ``name.c`` hold the filters, skyhook, limit, warm start and stored weights, ``name_adapt.h`` and
    ``name_adapt.c`` the update. The filters' states are in double precision whatever the precision of the rest: corners
    of a hertz at thousands of samples per second are inaccurate in single precision.

    Parameters
    ----------
    loop : FeedforwardLoop
    settings : FeLms or FeRls
        Of the adaptation, with the `path_delay` of the loop.
    weights : ndarray, shape (axes, regressors)
        Initial weights.
    guard : ndarray, shape (regressors, regressors)
        G, upper triangular: the weights are kept while |G psi| is above its level, first 1, and for a pause after it.
    growth : float
        To where the level may rise: while |G psi| is above it, by e in `REARM_S`; else it falls a tenth as fast, to 1.
    limit : float
        Of each command, N.
    pause_s : float
        Time, s, for which the weights are frozen after the limit or the guard acted; at the start until the feedforward, which
        gives no force before the floor sensors' filters have settled (`FeedforwardLoop.settling`), is at full strength.
    name, precision : str
        See `controller_code`.

    Returns
    -------
    dict of str to str

    Raises
    ------
    InputError
        When `name` is no name in C, or the settings have another path's delay.
    """
    if settings.path_delay != loop.path_delay:
        raise InputError(
            f"settings.path_delay is {settings.path_delay}; give that of the loop, {loop.path_delay}"
        )
    write, wide = Numbers(name, precision), Numbers(name, "double")
    axes, sensors = loop.estimate.axes, loop.estimate.sensors
    regressors = sensors * (POWERS + 1)
    require_array("weights", weights, shape=(axes, regressors))
    before, modes, after = loop.error
    unlimited = limit == np.inf
    recursive = isinstance(settings, FeRls)
    start, fade, pause = waiting_samples(loop, pause_s)
    values = {
        "title": f"{name}: {axes}-axis feedforward from {pluralise(sensors, 'floor sensor')}, "
        f"{loop.rate:g} samples a second.",
        "axes": axes,
        "sensors": sensors,
        "both": 2 * sensors,
        "late": loop.folded[1],
        "kept": loop.folded[1] + 1,
        "regressors": regressors,
        "stored": axes * regressors + recursive * regressors * (regressors + 1) // 2,
        "sample_time": repr(loop.sample_time),
        "zero": write(0),
        "limit": "INFINITY" if unlimited else write(limit),
        "start": start,
        "fade": fade,
        "two": write(2),
        "three": write(3),
        "pause": pause,
        "patience": round(PATIENCE_S * loop.rate),
        "powers": POWERS,
        "power_sections": len(loop.integrator),
        "integrator_sections": POWERS * len(loop.integrator),
        "skyhook_sections": len(loop.skyhook),
        "shaping_sections": len(loop.noise_shaping),
        "highpass_sections": len(loop.highpass),
        "error_sections": modes.shape[1],
        "weights": _rows(write, weights),
        "smooth": repr(loop.smooth),
        "folded": _rows(wide, loop.folded[0]),
        "before": _rows(wide, before),
        "after": _rows(wide, after),
        "guard_rows": _rows(wide, guard),
        "highest": repr(growth**2),
        **dict(zip(("rise", "fall"), map(repr, level_steps(loop.rate)), strict=True)),
        "modes": _lines("{" + _rows(wide, np.delete(mode, 3, axis=1)).strip() + "}," for mode in modes),
        **{
            each: _rows(wide, np.delete(getattr(loop, kind), 3, axis=1))
            for each, kind in (
                ("skyhook", "skyhook"),
                ("shaping", "noise_shaping"),
                ("highpass", "highpass"),
                ("integrator", "integrator"),
            )
        },
    }
    marks = {"r": recursive}
    return write.files("isolation", name, values, marks) | adaptation_code(
        settings, axes, regressors, f"{name}_adapt", precision
    )


@checked
def axes_code(
    sensing: Float64[np.ndarray, "axes outputs"],
    actuation: Float64[np.ndarray, "inputs axes"],
    folders: Sequence[str],
    name: str,
    precision: str = "double",
    signals: Sequence[str] = (),
) -> dict[str, str]:
    """C99 of a decoupling around the controllers ``name_1``, ``name_2``, ... that the folders hold; `signals` in words."""
    write = Numbers(name, precision)
    (axes, sensors), actuators = sensing.shape, len(actuation)
    numbers = range(1, axes + 1)

    def product(out: str, matrix: np.ndarray, given: str) -> str:
        signals = [f"{given}[{k}]" for k in range(matrix.shape[1])]
        return _lines(f"{out}[{k}] = {write.terms(row, signals)};" for k, row in enumerate(matrix))

    values = {
        "title": f"{name}: {axes} axes from {pluralise(sensors, 'sensor')} to {pluralise(actuators, 'actuator')}, {precision} precision.",
        "includes": "".join(
            f'#include "{folder}/{name}_{k}.h"\n' for k, folder in zip(numbers, folders, strict=True)
        ),
        "signals": "".join(f"   {_comment(each)}\n" for each in signals),
        "sensors": sensors,
        "axes": axes,
        "actuators": actuators,
        "fields": _lines(f"{name}_{k}_state axis_{k};" for k in numbers),
        "zero": write(0),
        "sense": product("q", sensing, "y"),
        "actuate": product("u", actuation, "f"),
        "steps": _lines(
            f"flags |= {name}_{k}_step(&s->axis_{k}, &{name}_{k}_designed, &q[{k - 1}], known, &f[{k - 1}]);"
            for k in numbers
        ),
    }
    return write.files("axes", name, values)


@checked
def waiting_samples(loop: FeedforwardLoop, pause_s: NonNegative) -> tuple[int, int, int]:
    """Samples until the floor sensors' filters have settled, in which the feedforward then rises, and of a pause."""
    start = round(max(loop.settling, pause_s) * loop.rate)
    return start, max(round(FADE * start), 1), round(pause_s * loop.rate)


@checked
def level_steps(rate: Positive) -> tuple[float, float]:
    """Factors by which the square of the guard's level rises and falls each sample."""
    rise = 2 / (REARM_S * rate)
    return float(np.exp(rise)), float(np.exp(-rise / 10))


def _rows(write: "Numbers", matrix: np.ndarray) -> str:
    return _lines("{" + ", ".join(map(write, row)) + "}," for row in matrix)


@checked
def require_names(name: str, precision: Annotated[str, one_of(PRECISIONS)]) -> None:
    """Refuse an invalid prefix of names in C."""
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,30}", name):
        raise InputError(
            f"name is {short_repr(name)}; give letters, digits and _, a letter first, 31 at most"
        )


class Numbers:
    """Numbers, sums and files of one piece of C."""

    def __init__(self, name: str, precision: str):
        require_names(name, precision)
        self.name, self.type = name, PRECISIONS[precision]

    def __call__(self, value) -> str:
        """A literal that reads back as the same number."""
        single = self.type is np.float32
        with np.errstate(over="ignore"):
            rounded = self.type(value)
        if not np.isfinite(rounded) or (rounded == 0 and value != 0):
            raise InputError(
                f"{float(value):g} is beyond the range of single precision; use another unit, or double"
            )
        text = f"{rounded:.9g}" if single else repr(float(rounded))
        return text + ("" if "." in text or "e" in text else ".0") + ("f" if single else "")

    def terms(self, row, names: list[str]) -> str:
        """The sum of products that are not zero."""
        parts = [
            each if value == 1 else f"({self(value)} * {each})"
            for value, each in zip(row, names, strict=True)
            if value
        ]
        return "\n        + ".join(" + ".join(parts[k : k + 3]) for k in range(0, len(parts), 3)) or "0"

    def files(
        self, templates: tuple[str, str] | str, stem: str, values: dict, marks: dict | None = None
    ) -> dict[str, str]:
        """Header and source from templates of these names; lines that begin with a mark and | are used only where that mark is set."""
        header, source = (templates, templates) if isinstance(templates, str) else templates
        return {
            f"{stem}.{kind}": self._text(f"{file}.{kind}", values, marks or {})
            for kind, file in (("h", header), ("c", source))
        }

    def _text(self, template: str, values: dict, marks: dict) -> str:
        """A template of this name, filled; see `files`."""
        lines = (TEMPLATES / template).read_text(encoding="utf-8").splitlines(keepends=True)
        kept = [
            line[2:] if line[1:2] == "|" else line for line in lines if line[1:2] != "|" or marks[line[0]]
        ]
        names = {
            "name": self.name,
            "guard": self.name.upper(),
            "real": "double" if self.type is np.float64 else "float",
        }
        return Template("".join(kept)).substitute(values | names)


def _lines(statements, indent: int = 4) -> str:
    return "".join(f"{' ' * indent}{statement}\n" for statement in statements)


def _unit(name: str) -> str:
    """The unit of a signal, as of ``e (m)``, for a comment."""
    found = re.search(r"\((.+)\)", name)
    return _comment(found[1]) if found else "unit"


def _comment(text: str) -> str:
    """A name as a comment holds it, which it neither ends nor makes a compiler warn of."""
    text = re.sub(r"[^\x20-\x7e]", "_", text).replace("\\", "/")
    for pair in ("*/", "/*", "??"):  # of two question marks C99 makes trigraphs
        text = text.replace(pair, " ".join(pair))
    return text
