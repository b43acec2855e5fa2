"""C99 of a controller or an adaptation, from templates: what a processor runs is what was computed here."""

import re
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from stillwork.base.checks import InputError, counted, require_choice, require_count, shown
from stillwork.base.front_door import checked
from stillwork.control.digital import DigitalController
from stillwork.estimation.adaptive import FeLms, FeRls

TEMPLATES = Path(__file__).parent / "c99"
PRECISIONS: dict[str, Any] = {"double": np.float64, "single": np.float32}
HOLDS = 0.5  # a state whose own coefficient is larger changes by little: it is summed up, the others are set


@checked
def controller_code(controller: DigitalController, name: str, precision: str = "double") -> dict[str, str]:
    """C99 of a controller that allocates nothing: text by the name of its file, ``name.h`` and ``name.c``.

    A state is x + (A - I)x + ..., with what rounding leaves kept beside it: in single precision a slow pole keeps its
    place, and an integrator takes in steps too small for it alone. Products with zero are left out.

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
        When `name` is no name in C.

    References
    ----------
    Middleton and Goodwin, Digital Control and Estimation (1990).

    Examples
    --------
    >>> pid = lti.tustin(control.PidFamily(10.0)(50.0).state_space(), 1e-4)
    >>> files = control.controller_code(control.DigitalController(pid, ("e (m)",), ("f (N)",)), "pid")
    >>> sorted(files), "void pid_step(" in files["pid.c"]
    (['pid.c', 'pid.h'], True)
    """
    write = _Numbers(name, precision)
    m, n = controller.model, len(controller.inputs)
    states, outputs = len(m.a), len(controller.outputs)
    sums = np.diag(m.a) > HOLDS
    change = m.a - np.diag(sums.astype(float))
    winding = controller.anti_windup
    winds = controller.limited and bool(winding.any())
    low, high = controller.low, controller.high
    names = {"x": states, "in": n, "f": controller.fed_back}
    across = [f"{each}[{k}]" for each, count in names.items() for k in range(count)]
    rows = np.hstack([change, m.b])
    if winds:
        across += [f"w[{k}]" for k in range(outputs)]
        rows = np.hstack([rows, winding])
    given = [f"in[{k}]" for k in range(n)]
    ends = [
        [write(each) if np.isfinite(each) else "" for each in pair] for pair in zip(low, high, strict=True)
    ]
    commands, clipped = [], []
    for k, (row, (least, most)) in enumerate(zip(np.hstack([m.c, m.d[:, :n]]), ends, strict=True)):
        commands.append(f"f[{k}] = {write.terms(row, across[: states + n])};")
        limits = [f"if (f[{k}] < {least})\n        f[{k}] = {least};"] if least else []
        limits += [f"if (f[{k}] > {most})\n        f[{k}] = {most};"] if most else []
        commands += [f"w[{k}] = -f[{k}];"] if winds else []
        commands += limits
        commands += [f"w[{k}] += f[{k}];"] if winds else []
        clipped += [f"f[{k}] = out[{k}];", *limits]
    values = {
        "title": f"{name}: {counted(states, 'state')}, {1 / m.sample_time:g} samples a second, {precision} precision.",
        "signals": "\n   ".join(
            [f"in[{k}]: {_comment(text)}" for k, text in enumerate(controller.inputs)]
            + [f"out[{k}]: {_comment(text)}" for k, text in enumerate(controller.outputs)]
        ),
        "inputs": n,
        "outputs": outputs,
        "states": max(states, 1),
        "sample_time": repr(m.sample_time),
        "late": f", {counted(controller.delay, 'sample')} late" if controller.delay else "",
        "ring": f"\n    {name}_real ring[{controller.delay}][{outputs}]; /* on its way out */\n    int place;"
        if controller.delay
        else "",
        "helpers": _HELPER if sums.any() else "",
        "excess": f"\n    real w[{outputs}];" if winds else "",
        "clipped": _lines(clipped),
        "commands": _lines(commands),
        "changes": _lines(f"d[{k}] = {write.terms(row, across)};" for k, row in enumerate(rows)),
        "moves": _lines(
            f"add(&s->state[{k}], &s->rest[{k}], d[{k}]);" if sums[k] else f"s->state[{k}] = d[{k}];"
            for k in range(states)
        ),
        "start": _lines(
            f"s->state[{k}] = {write.terms(row, given + [f'f[{j}]' for j in range(outputs)])};"
            for k, row in enumerate(controller.start)
        ),
        "fill": Template(_FILL).substitute(delay=controller.delay, outputs=outputs)
        if controller.delay
        else "",
        "give": Template(_LATE if controller.delay else _NOW).substitute(
            delay=controller.delay, outputs=outputs
        ),
    }
    if not states:
        values["changes"] = _lines(["(void)x;", "(void)d;"])
        values["start"] = _lines(["(void)f;", "s->state[0] = 0;"])
    return write.files("controller.h", "controller.c", values)


_HELPER = """
static void add(real *sum, real *rest, real change)
{
    const real step = change + *rest, next = *sum + step;
    *rest = step - (next - *sum);
    *sum = next;
}
"""
_NOW = """    for (int i = 0; i < $outputs; i++)
        out[i] = f[i];
"""
_FILL = """    s->place = 0;
    for (i = 0; i < $delay; i++)
        for (int j = 0; j < $outputs; j++)
            s->ring[i][j] = f[j];
"""
_LATE = """    for (int i = 0; i < $outputs; i++) {
        out[i] = s->ring[s->place][i];
        s->ring[s->place][i] = f[i];
    }
    s->place = (s->place + 1) % $delay;
"""


@checked
def adaptation_code(
    settings: FeLms | FeRls, actuators: int, regressors: int, name: str, precision: str = "double"
) -> dict[str, str]:
    """C99 of the self-tuned feedforward that allocates nothing: text by the name of its file.

    FeRLS keeps P in Bierman's factors whatever the precision; float32 holds these where it loses P itself. FeLMS
    keeps what rounding leaves of each weight, or small steps would stop it in single precision.

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
        When `name` is no name in C, or the settings ask for another form or do not fit.

    References
    ----------
    Bierman, Factorization Methods for Discrete Sequential Estimation (1977).

    Examples
    --------
    >>> sorted(control.adaptation_code(estimation.FeRls(1e3), 6, 9, "feed"))
    ['feed.c', 'feed.h']
    """
    write = _Numbers(name, precision)
    sizes = {
        "actuators": require_count("actuators", actuators),
        "regressors": require_count("regressors", regressors),
    }
    values = sizes | {
        "title": f"{name}: {actuators} x {regressors} weights by {type(settings).__name__}, {precision} precision."
    }
    if isinstance(settings, FeLms):
        values["fields"] = (
            f"    {name}_real rest[{actuators}][{regressors}]; /* what rounding has left of W */"
        )
        values |= {each: write(getattr(settings, each)) for each in ("step_size", "regularisation")}
        values["copies"] = write(settings.trace_copies(actuators))
        return write.files("adaptation.h", "felms.c", values)
    if settings.form not in ("safe", "UD"):
        raise InputError(f"settings.form is {settings.form!r}; C is written for 'safe' or 'UD'")
    dtype = PRECISIONS[precision].__name__
    kept = {each: getattr(settings, each) for each in ("initial_covariance", "forgetting", "growth_limit")}
    recursion = FeRls(**kept, form="UD", dtype=dtype).start(regressors)
    unlimited = settings.growth_limit == np.inf
    values |= {
        "forgetting": write(recursion.forgetting),
        "allowance": "INFINITY" if unlimited else write(recursion.allowance),
        "limits": ", ".join("INFINITY" if unlimited else write(each) for each in recursion.levels[0]),
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
    return write.files("adaptation.h", "ferls.c", values)


@checked
def require_names(name: str, precision: str) -> None:
    """Refuse what cannot begin names in C, and a precision that there is not."""
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,30}", name):
        raise InputError(f"name is {shown(name)}; give letters, digits and _, a letter first, 31 at most")
    require_choice("precision", precision, PRECISIONS)


class _Numbers:
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
            raise InputError(f"{float(value):g} is beyond single precision; take another unit, or double")
        text = f"{rounded:.9g}" if single else repr(float(rounded))
        return text + ("" if "." in text or "e" in text else ".0") + ("f" if single else "")

    def terms(self, row, names: list[str]) -> str:
        """The sum of products that are not zero."""
        parts = [
            each if value == 1 else f"{self(value)} * {each}"
            for value, each in zip(row, names, strict=True)
            if value
        ]
        return "\n        + ".join(" + ".join(parts[k : k + 3]) for k in range(0, len(parts), 3)) or "0"

    def files(self, header: str, source: str, values: dict) -> dict[str, str]:
        """Both files."""
        values |= {
            "name": self.name,
            "guard": self.name.upper(),
            "real": "double" if self.type is np.float64 else "float",
        }
        return {
            f"{self.name}.{kind}": Template((TEMPLATES / file).read_text(encoding="utf-8")).substitute(values)
            for kind, file in (("h", header), ("c", source))
        }


def _lines(statements) -> str:
    return "".join(f"    {each}\n" for each in statements)


def _comment(text: str) -> str:
    """A name as a comment holds it, which it neither ends nor makes a compiler warn of."""
    text = re.sub(r"[^\x20-\x7e]", "_", text).replace("\\", "/")
    for pair in ("*/", "/*", "??"):  # of two question marks C99 makes trigraphs
        text = text.replace(pair, " ".join(pair))
    return text
