"""A toy work whose combinations are known in closed form: its ledger, its axes, and its studies.

The sum is y = a + 2 b + a b with a of 0, 1, 2 and b of 0, 1, each as likely as any other. By hand: the mean given a
is 1 + 1.5 a, of variance 2.25 x 2/3 = 3/2; given b it is 1 + 3 b, of variance 9 x 1/4 = 9/4; the joint part
(a - 1)(b - 1/2) has 2/3 x 1/4 = 1/6. Together 47/12.
"""

import os
import signal
import time
from pathlib import Path

FIRST = {"a": 18 / 47, "b": 27 / 47}
TOTAL = {"a": 20 / 47, "b": 29 / 47}

ENTRY = """\
[motion.{}]
place = "{}"
quantity = "{}"
unit = "{}"
{}
"""
DIGITS = 'kind = "value"\ntolerance = {{ {}, source = "printed digits" }}'
SUM, PRODUCT, RELATIVE = (
    DIGITS.format(each) for each in ("absolute = 1.0", "absolute = 0.1", "relative = 0.1")
)
LEDGER = "\n".join(
    ENTRY.format(*fields)
    for fields in (
        ("table-1.sum", "Table 1", "sum", "m", f"published = 3.0\n{SUM}"),
        ("table-1.product", "Table 1", "product", "m", f"published = 2.0\n{PRODUCT}"),
        ("order", "section 1", "a at most b", "1", 'published = 1.0\nkind = "ordering"'),
        ("never", "section 2", "what no combination gives", "1", f"published = 100.0\n{RELATIVE}"),
        ("always", "section 2", "what every combination gives", "1", f"published = 1.0\n{RELATIVE}"),
        ("shown", "section 2", "not judged", "1", 'kind = "reported"\nreason = "the work gives no number"'),
    )
)

AXIS = """\
[motion.{name}]
question = "what {name} is"
options = {options}
default = {default}
source = "section 1 leaves it open"
touches = {touches}
kind = "{kind}"

"""
ENTRIES = ("sum", "product", "order", "never", "always", "shown")
ALL = '["motion.table-1", "motion.order", "motion.never", "motion.always", "motion.shown"]'
STUDY = """\
[studies.toy]
function = "choices.toy_work:{function}"
entries = {entries}
{more}
"""


def axis(name, options, default, kind="number", touches=ALL) -> str:
    return AXIS.format(name=name, options=options, default=default, kind=kind, touches=touches)


def study(function="sums", entries=ALL, more="") -> str:
    return STUDY.format(function=function, entries=entries, more=more)


A, B = axis("a", [0, 1, 2], 0), axis("b", [0, 1], 0)
TOY = A + B + study()
SEEDS = axis("seeds", [7, 8, 9], 8, "seed")


def environment(root: Path) -> dict[str, str]:
    """Of a process on the toy at `root`, with this checkout's library."""
    here = Path(__file__).parents[2]
    places = os.pathsep.join(map(str, (here / "lib", here, here / "tests")))
    return os.environ | {"STILLWORK_ROOT": str(root), "PYTHONPATH": places}


def write(root: Path, combinations: str = TOY, ledger: str = LEDGER) -> None:
    """Make `root` a workbook whose topic `motion` is the toy."""
    folder = root / "data" / "motion"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "published.toml").write_text(ledger, encoding="utf-8")
    (folder / "choices.toml").write_text(combinations, encoding="utf-8")


def sums(*, a, b, seed, lean, **others):
    return {
        "motion.table-1.sum": a + 2 * b + a * b,
        "motion.table-1.product": a * b,
        "motion.order": float(a <= b),
        "motion.never": a - b,
        "motion.always": 1.0,
        "motion.shown": a / 3,
    }


def noisy(*, a, b, seed, lean, **others):
    """The seeds 7, 8, 9 add -1, 0, 1, of variance 2/3, to the sum."""
    found = sums(a=a, b=b, seed=seed, lean=lean)
    return found | {"motion.table-1.sum": found["motion.table-1.sum"] + seed - 8}


def spread(*, a, b, seed, lean):
    """Values with intervals, and one without a value."""
    found = sums(a=a, b=b, seed=seed, lean=lean)
    return found | {
        "motion.table-1.sum": (found["motion.table-1.sum"] / 3, (a / 3, b + 10.0)),
        "motion.never": float("nan"),
    }


def shortened(*, a, b, seed, lean):
    """Its short form is 10 off where a is 2."""
    found = sums(a=a, b=b, seed=seed, lean=lean)
    return {
        "motion.table-1.sum": found["motion.table-1.sum"] + 10 * (lean and a == 2),
        "motion.always": found["motion.always"],
    }


def raising(*, a, b, seed, lean):
    if a == 2:
        raise ValueError(f"no such\nthing at b = {b}")
    return sums(a=a, b=b, seed=seed, lean=lean)


def dying(*, a, b, seed, lean):
    if (a, b) == (1, 1):
        os.kill(os.getpid(), signal.SIGKILL)
    return sums(a=a, b=b, seed=seed, lean=lean)


def slow(*, a, b, seed, lean):
    time.sleep(0.2)
    return noisy(a=a, b=b, seed=seed, lean=lean)


def endless(*, a, b, seed, lean):
    Path(os.environ["STILLWORK_ROOT"], "begun").touch()
    time.sleep(1000)


def incomplete(*, a, b, seed, lean):
    return {"motion.order": 1.0}


def talkative(*, a, b, seed, lean):
    return sums(a=a, b=b, seed=seed, lean=lean) | {"motion.other": 1.0}


def deaf(*, a, seed, lean):
    return {}


def one(**_):
    return {"motion.order": 1.0}


def other(**_):
    return {"motion.always": 1.0}
