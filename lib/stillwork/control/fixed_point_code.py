"""C99 of fixed-point control: the computations of `FixedPointStepper`, with a model that you write."""

from typing import Any

import numpy as np

from stillwork.base.checks import InputError, require_choice
from stillwork.base.validation import checked
from stillwork.control.c_code import Numbers
from stillwork.control.fixed_point import LOSSES, Controller
from stillwork.control.fixed_point_mechanism import require_alike
from stillwork.control.joint_kalman import JointKalman
from stillwork.control.mechanism import Mechanism
from stillwork.control.transformation import DisturbanceObserver
from stillwork.estimation.coordinate_filters import (
    ExtendedKalman,
    LowPass,
    MovingWindow,
    SavitzkyGolay,
    UnscentedKalman,
    require_sample_time,
)
from stillwork.estimation.filtering import UNIT_MASS

KINDS = {MovingWindow: "w", LowPass: "l", UnscentedKalman: "u", ExtendedKalman: "e"}


@checked
def fixed_point_code(
    controller: Controller | list[Controller],
    sample_time: float,
    name: str,
    precision: str = "double",
    *,
    force_limits: list[float] | None = None,
    lost: str = "predict",
) -> dict[str, str]:
    """C99 of fixed-point control that allocates nothing: text by the name of its file, ``name.h`` and ``name.c``.

    The header declares what you have to write: the forces of the model, its accelerations under forces at their limits,
    and, if the filter has its own model, the acceleration of that.

    Parameters
    ----------
    controller : Controller or list of Controller
        As for `FixedPointStepper`; any filter except Savitzky-Golay, and no literal correction.
    sample_time : float
        s.
    name : str
        What all names in it begin with.
    precision : str
        ``double`` or ``single``; with the latter velocities are small differences of rounded positions, and the force
        may err by a hundredth: compare it with that of `FixedPointStepper` on one of your runs.
    force_limits : list of float, optional
        Largest force of each actuator; by default unlimited.
    lost : str
        ``predict`` or ``hold``, as for `FixedPointStepper`.

    Returns
    -------
    dict of str to str

    Raises
    ------
    InputError
        When `name` is no name in C, or the controllers do not fit together.

    References
    ----------
    Issa, Al-Bkree and Tar, On certain noise filtering techniques in fixed point iteration-based adaptive control.

    Examples
    --------
    >>> slide = estimation.Plant(lambda q, v, f, p: f / p[0], lambda q, v, a, p: p[0] * a, [2.0])
    >>> parts = estimation.LowPass(), control.FlowTransformation(), control.KinematicDesign(10.0), slide
    >>> files = control.fixed_point_code(control.Controller(*parts), 1e-3, "slide")
    >>> sorted(files), "slide_step(" in files["slide.c"]
    (['slide.c', 'slide.h'], True)
    """
    write = Numbers(name, precision)
    first = controller[0] if isinstance(controller, list) else controller
    several = isinstance(first.model, Mechanism)
    count = first.model.coordinates if isinstance(first.model, Mechanism) else 1
    controllers = list(controller) if isinstance(controller, list) else [controller] * count
    require_alike(controllers, count)
    for each in controllers:
        require_sample_time(each.signal_filter, sample_time)
    require_choice("lost", lost, LOSSES)
    own: Any = first.signal_filter
    if isinstance(own, SavitzkyGolay | JointKalman) or getattr(own, "literal", False):
        raise InputError(
            f"signal_filter is {own}; C code exists for filters of one coordinate except Savitzky-Golay and the literal correction"
        )
    if any(isinstance(each.transformation, DisturbanceObserver) for each in controllers):
        raise InputError("controller uses a DisturbanceObserver; C code exists for (6) and (8)")
    kind, packed = KINDS[type(own)], own.packed()
    filters: Any = [each.signal_filter for each in controllers]
    kalman = kind in "ue"
    foreign = kalman and own.plant is not UNIT_MASS
    limits = [np.inf] * count if force_limits is None else force_limits
    if len(limits) != count or not all(limit > 0 for limit in limits):
        raise InputError(f"force_limits is {limits}; give {count} numbers above 0")

    def row(values) -> str:
        return "{" + ", ".join("INFINITY" if value == np.inf else write(value) for value in values) + "}"

    def table(rows) -> str:
        return "{" + ", ".join(map(row, rows)) + "}"

    def tables(matrices) -> str:
        return "{" + ", ".join(map(table, matrices)) + "}"

    transformations = [each.transformation.packed for each in controllers]
    parameters = np.atleast_1d(first.model.parameters)
    parameters = parameters if len(parameters) else np.zeros(1)
    designed = [
        table(each.kinematics.gains for each in controllers),
        "{" + ", ".join(f"{int(transformation[0])}" for transformation in transformations) + "}",
        table(each[1:] for each in transformations),
        row(limits),
        row(parameters),
    ]
    values = {
        "title": f"{name}: fixed-point control by {type(own).__name__}, {1 / sample_time:g} samples a second, {precision} precision.",
        "count": count,
        "gains": len(first.kinematics.gains),
        "chain": len(first.kinematics.gains) - 1,
        "parameters": len(parameters),
        "sample_time": repr(float(sample_time)),
        "step": write(sample_time),
        "sqrt": "sqrt" if precision == "double" else "sqrtf",
        "millionth": write(1e-6),
        **{word: write(number) for word, number in (("zero", 0), ("one", 1), ("two", 2), ("three", 3))},
        "states": packed.work.shape[2],
        "outputs": len(packed.noise) if kalman else 0,
        "disturbance": " and disturbance" if kind == "e" else "",
        "seen": "z" if own.error_from_measurement else "s->estimate[j][0]",
        "push": "s->deformed[j]" if several else "s->force[j]",
        "believed": 0,
    }
    if kind == "w":
        values |= {"window": len(packed.options), "weights": row(packed.options)[1:-1]}
    if kind == "l":
        designed.append(row(each.bandwidth for each in filters))
    if kalman:
        designed += [
            tables(each.packed().process for each in filters),
            tables(each.packed().noise for each in filters),
        ]
    if kind == "u":
        spread, _, square_first, other = packed.options[:4]
        values |= {
            "spread": write(np.sqrt(spread)),
            "first_square": write(square_first),
            "other": write(other),
            "variance": row(each.initial_variance for each in filters),
        }
    if kind == "e":
        values["variances"] = table(each.packed().options for each in filters)
    if foreign:
        believed = np.append(own.plant.parameters, [] if len(own.plant.parameters) else 0.0)
        values["believed"] = len(believed)
        designed.append(row(believed))
    values["designed"] = "".join(f"    {each},\n" for each in designed)
    whole = kind == "u" and own.model_acceleration
    marks = {
        **{mark: mark == kind for mark in "wlue"},
        "k": kalman,
        "b": foreign,
        "f": kalman and not foreign,
        "a": whole,
        "d": kind == "u" and not whole,
        "h": lost == "hold",
        "p": kind == "l" and not own.from_zero,
        "x": lost == "predict" and not kalman,
    }
    return write.files("fixed_point", name, values, marks)
