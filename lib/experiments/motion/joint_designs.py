"""The designs that the searches found, in ``data/motion/joint.toml``.

``python -m experiments.motion.joint_designs`` searches anew (some minutes) and prints that file. Where a search ends
can hang on the rounding of a machine, so results are stored, and everything said of them is computed from there.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace

import numpy as np

from experiments.motion.joint import CONTROLLER, NUMBERS, OBSERVER, JointDesign
from experiments.motion.joint_search import (
    Found,
    Served,
    cost,
    crossing_hz,
    judge,
    robust_search,
    sample_plants,
    search,
    serve,
    starts,
)
from experiments.motion.machines import stage
from stillwork.base.checks import InputError, require_array, require_count, require_number
from stillwork.base.toml_files import read_numbers
from stillwork.control.bandwidth import SIX_DB
from workbook import paths

STARTS, SEED = 5, 1  # of every search: the published design and random ones around it
SIZES = (0.0, 0.02, 0.05)  # relative errors of the modal parameters that the designs serve
POOL, POOL_SEED = 60, 7  # perturbed stages that a search may look at, beside the nominal one
ASKED = 10 ** (5.6 / 20)  # of these stages, to leave room for others
NOMINAL = 0.999 * SIX_DB  # asked of the nominal stage, for peaks between the grid's points
# N, rms of the control force under noise, for the front; the published design has 0.0048
FORCES = (0.005, 0.01)
KEPT = 1e-3  # logarithm by which a search may end above its limit


@dataclass(frozen=True)
class Stored:
    """A design with what its search was, and where each of its starts ended."""

    design: JointDesign
    size: float  # of the errors that it serves
    force: float  # N, allowed; 0: any
    ends: tuple[float, ...]  # m, scan errors at which the starts ended that kept every limit
    started: int  # how many there were
    meetings: int  # of a design with a stage, in all

    def __post_init__(self):
        require_number("size", self.size, at_least=0.0, below=1.0)
        require_number("force", self.force, at_least=0.0)
        require_array("ends", np.array(self.ends, dtype=float), ndim=1)
        for name in ("started", "meetings"):
            require_count(name, getattr(self, name))


def stored_designs() -> dict[str, Stored]:
    """All stored designs by name, as they were found: rounded to six digits."""
    tree = read_numbers(paths.data("motion", "joint.toml"))
    found = {}
    for name in tree:
        numbers = {k: tuple(v) if isinstance(v, list) else v for k, v in tree.table(name).items()}
        try:
            design = JointDesign(**{k: numbers.pop(k) for k in NUMBERS})
            found[name] = Stored(design, **numbers)
        except KeyError as missing:
            raise InputError(
                f"joint.toml: {name!r} has no {missing}; give all of {', '.join(NUMBERS)}"
            ) from None
        except (TypeError, InputError) as error:
            raise InputError(
                f"joint.toml: {name!r} {error}; use the fields of JointDesign and Stored"
            ) from None
    return found


def searched_designs() -> Iterator[tuple[str, Stored]]:
    """Every search again, one after the other."""
    begin = starts(STARTS, SEED)
    nominal = serve(stage())
    pools = {
        size: [nominal, *(serve(plant) for plant in sample_plants(size, POOL if size else 0, POOL_SEED))]
        for size in SIZES
    }
    fast = [_search(each, "joint", [nominal], aim="bandwidth") for each in begin]
    fast.sort(key=lambda each: -crossing_hz(each.design, nominal.model).min())
    yield "largest bandwidth, for 0%", _stored(fast, 0.0)
    for size, pool in pools.items():
        for free, kept in (("controller", OBSERVER), ("observer", CONTROLLER[1:])):
            found = _from_all([_with(each, JointDesign(), kept) for each in begin], free, pool)
            yield f"{free} free, for {size:.0%}", _stored(found, size)
        second = _from_all([_with(each, found[0].design, OBSERVER) for each in begin], "controller", pool)
        yield f"two steps, for {size:.0%}", _stored(second, size)
    # The joint searches begin where those for smaller errors ended, too, and the nominal one where the others did.
    ended: list[JointDesign] = []
    joint = {}
    for size, pool in pools.items():
        joint[size] = _from_all(begin + ended, "joint", pool)
        ended.append(joint[size][0].design)
    joint[0.0] = sorted(joint[0.0] + _from_all(ended[1:], "joint", pools[0.0]), key=cost)
    for size, pool in pools.items():
        yield f"joint, for {size:.0%}", _stored(joint[size], size)
        for force in FORCES:
            quieter = _search(joint[size][0].design, "joint", pool, force)
            yield f"joint, for {size:.0%}, {1e3 * force:g} mN", _stored([quieter], size, force)


def _with(design: JointDesign, other: JointDesign, names: tuple[str, ...]) -> JointDesign:
    """The design with some numbers of another one."""
    return replace(design, **{name: getattr(other, name) for name in names})


def _search(
    start: JointDesign, free: str, pool: list[Served], force: float | None = None, aim: str = "error"
) -> Found:
    if len(pool) > 1:
        return robust_search(start, free, pool, ASKED, force)
    limit, meetings = NOMINAL, 0
    for _ in range(4):  # where the grid has missed a peak, again with a lower limit
        found = search(start, free, pool, limit, force, aim=aim)
        meetings += found.meetings
        over = 10 ** (judge(found.design, [pool[0].model]).peaks.max() / 20) / NOMINAL
        if found.excess > KEPT or over <= 1.0005:
            break
        start, limit = found.design, limit / over
    return replace(found, meetings=meetings)


def _from_all(begin: list[JointDesign], free: str, pool: list[Served]) -> list[Found]:
    """Where the starts ended, the best first."""
    found = []
    for start in begin:
        try:
            found.append(_search(start, free, pool))
        except InputError:  # no bandwidth at which this start is stable on every stage
            continue
    return sorted(found, key=cost)


def _stored(found: list[Found], size: float, force: float = 0.0) -> Stored:
    """The first of the designs that were found, and where each start ended."""
    ends = tuple(sorted(_six(each.error) for each in found if each.excess <= KEPT))
    meetings = sum(each.meetings for each in found)
    return Stored(rounded(found[0].design), size, force, ends, len(found), meetings)


def _six(value):
    return tuple(map(_six, value)) if isinstance(value, tuple) else float(f"{value:.5e}")


def rounded(design: JointDesign) -> JointDesign:
    """The design with six significant digits."""
    return replace(design, **{name: _six(getattr(design, name)) for name in NUMBERS})


def as_toml(name: str, stored: Stored) -> str:
    """One table of ``joint.toml``."""
    values = asdict(stored)
    values = values.pop("design") | values
    lines = (f"{key} = {list(value) if isinstance(value, tuple) else value}" for key, value in values.items())
    return "\n".join([f"[{name!r}]", *lines])


if __name__ == "__main__":
    print(
        "# Observers and controllers of the stage that were searched together, and their rivals; numbers as in"
    )
    print("# experiments.motion.joint.JointDesign and joint_designs.Stored. Made by")
    print("# `python -m experiments.motion.joint_designs`.")
    for found_name, found_stored in searched_designs():
        print(f"\n{as_toml(found_name, found_stored)}", flush=True)
