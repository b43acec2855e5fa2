"""What the uses of the observer and the loop functions are called, and one colour a use in every figure."""

from collections.abc import Iterable

from workbook import figures

LABELS = {
    "input_sensitivity": "input sensitivity $S_I$",
    "output_sensitivity": "output sensitivity $S_O$",
    "true_tracking": r"$r$ to $e_{true}$",
}


# One colour a use of the observer, in every figure.
_WITHOUT = ("PID", "PID with notches", "no observer", "original", "plant", "plant $P$")
CASES = dict.fromkeys(_WITHOUT, figures.BLACK) | dict.fromkeys(("MC", "compensated $P_{eq}$"), figures.BLUE)
CASES |= {"AD": figures.GREEN, "MC and AD": figures.RED}


def case_styles(labels: Iterable[str]) -> dict[str, dict]:
    """Line options by label where every label names a case, dashed for a redesigned controller; else none."""
    styles = {}
    for label in labels:
        name, _, controller = label.removeprefix("with ").partition(", ")
        if name not in CASES or controller not in ("", "original", "redesigned"):
            return {}
        styles[label] = {"color": CASES[name], "linestyle": "--" if controller == "redesigned" else "-"}
    return styles
