"""The designs that the searches found, in ``data/motion/joint.toml``.

``python -m experiments.motion.joint_designs`` searches anew (some minutes) and prints that file. Where a search ends
can hang on the rounding of a machine, so results are stored, and everything said of them is computed from there.
"""

from collections.abc import Iterator
from dataclasses import replace

from experiments.motion.joint import FREE, JointDesign
from experiments.motion.joint_search import robust_search, search, starts
from stillwork.base import paths
from stillwork.base.checks import InputError
from stillwork.base.toml_files import read_numbers

STARTS, SEED = 12, 1  # where the joint search begins: the published design and random ones
SIZES = (0.02, 0.05)  # relative errors of the modal parameters that the robust searches serve
POOL_SEED = 7  # of the perturbed stages that they may look at
ROBUST_LIMIT = 10 ** (5.7 / 20)  # asked of these stages, to leave room for others


def stored_designs() -> dict[str, JointDesign]:
    """All stored designs by name, as they were found: rounded to six digits."""
    tree = read_numbers(paths.data("motion", "joint.toml"))
    found = {}
    for name in tree:
        numbers = tree.table(name)
        try:
            found[name] = JointDesign(
                **{k: tuple(v) if isinstance(v, list) else v for k, v in numbers.items()}
            )
        except (TypeError, InputError) as error:
            raise InputError(f"joint.toml: {name!r} {error}; use the fields of JointDesign") from None
    return found


def searched_designs() -> Iterator[tuple[str, JointDesign]]:
    """Every search again, one after the other."""
    begin = starts(STARTS, SEED)
    half = begin[0].bandwidth_hz
    yield "controller alone, no observer", search(JointDesign(20.0, observed=False), "controller").design
    observer = search(JointDesign(half), "observer").design
    yield "observer free, controller by the rule", observer
    yield "controller free, observer as published", search(begin[0], "controller").design
    yield "two steps: observer, then controller", search(observer, "controller").design
    joint = [search(start, "joint") for start in begin]
    yield "joint, from the published design", joint[0].design
    kept = [each for each in joint[1:] if each.keeps()]
    kept.sort(key=lambda each: each.crossing_hz.min())
    yield "joint, median of the random starts", kept[len(kept) // 2].design
    yield "joint, best of the random starts", kept[-1].design
    for size in SIZES:
        for kind, free in (("published observer", "controller"), ("joint", "joint")):
            found = robust_search(begin[0], free, size, POOL_SEED, limit=ROBUST_LIMIT)
            yield f"{kind}, for {size:.0%}", found.design


def rounded(design: JointDesign) -> JointDesign:
    """The design with six significant digits."""

    def six(value):
        return tuple(map(six, value)) if isinstance(value, tuple) else float(f"{value:.5e}")

    names = ("bandwidth_hz", *FREE["joint"])
    return replace(design, **{name: six(getattr(design, name)) for name in names})


def as_toml(name: str, design: JointDesign) -> str:
    """One table of ``joint.toml``."""
    lines = [f"[{name!r}]"]
    for field in ("bandwidth_hz", *FREE["joint"]):
        value = getattr(design, field)
        lines.append(f"{field} = {list(value) if isinstance(value, tuple) else value}")
    if not design.observed:
        lines.append("observed = false")
    return "\n".join(lines)


if __name__ == "__main__":
    print(
        "# Observers and controllers of the stage that were searched together, and their rivals; numbers as in"
    )
    print("# experiments.motion.joint.JointDesign. Made by `python -m experiments.motion.joint_designs`.")
    for found_name, found_design in searched_designs():
        print(f"\n{as_toml(found_name, rounded(found_design))}", flush=True)
