"""Arguments and fields against their annotations: what is taken as it is meant, what is refused by name."""

import inspect
import pkgutil
import re
import typing
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from importlib import import_module
from typing import Annotated

import numpy as np
import pytest
from jaxtyping import Float64

from calls import CATALOGUE
from stillwork.base import validation
from stillwork.base.bounds import Fraction, Positive, Vector, at_least
from stillwork.base.checks import InputError
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.control import PeakConstraint, make_loop, maximise_bandwidth
from stillwork.lti import ModalModel
from stillwork.lti.peaks import refine_peak


@dataclass(frozen=True)
class Part:
    size: float
    rows: Float64[np.ndarray, "rows 2"]

    def __post_init__(self):
        check_fields(self)


@checked
def taken(
    number: float = 1.0,
    count: int = 1,
    matrix: Float64[np.ndarray, "a b"] | None = None,
    parts: Sequence[Part] = (),
    pair: tuple[float, float] = (0.0, 1.0),
    word: str = "",
    call: Callable = abs,
    either: float | Part = 0.0,
    places: Sequence[int] | slice = (),
    flag: bool = False,
):
    return number, count, matrix, parts, pair, word, call, either


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("number", "1.5", r"^number\b"),
        ("number", 10**400, r"^number\b"),
        pytest.param("number", 10**5000, r"^number\b", id="more digits than are printed"),
        ("number", np.nan, r"^number\b"),
        ("number", np.datetime64("2020-01-01"), r"^number\b"),
        ("number", [1.0], r"^number\b"),
        ("count", 2.0, r"^count\b"),
        ("count", True, r"^count\b"),
        ("matrix", [1.0, 2.0], r"^matrix\b"),
        ("matrix", [["1", "2"]], r"^matrix\b"),
        ("matrix", [[1.0, np.inf]], r"^matrix\b"),
        ("matrix", [[10**400]], r"^matrix\b"),
        ("matrix", np.ma.array([[1.0]], mask=[[True]]), r"^matrix\b"),
        ("parts", 3, r"^parts\b"),
        ("parts", [None], r"^parts\[0\]"),
        ("pair", (1.0,), r"^pair\b"),
        ("pair", (1.0, "2"), r"^pair\[1\]"),
        ("word", None, r"^word\b"),
        ("call", 3, r"^call\b"),
        ("either", "x", r"^either\b"),
        ("places", [True], r"^places\b"),
        ("places", "x", r"^places\b"),
        ("flag", 1, r"^flag\b"),
        ("flag", np.array(True), r"^flag\b"),
    ],
)
def test_a_wrong_argument_is_named(name, value, message):
    with pytest.raises(InputError, match=message):
        taken(**{name: value})


def test_a_result_that_is_not_finite_is_an_error():
    @checked
    def ratio(number: float) -> np.ndarray:
        with np.errstate(all="ignore"):
            return np.array([number]) / 0.0

    @checked(infinite=True)
    def endless(number: float) -> np.ndarray:
        with np.errstate(all="ignore"):
            return np.array([number]) / 0.0

    with pytest.raises(InputError, match=r"^ratio\b"):
        ratio(1.0)
    assert endless(1.0) == np.inf
    with pytest.raises(InputError, match=r"^endless\b"):
        endless(0.0)


def test_a_result_out_of_range_names_the_argument_farthest_from_1():
    @checked
    def product(number: float, others: Sequence[Part], matrix: Float64[np.ndarray, "a b"]) -> float:
        return float(np.float64(number) * others[0].size * matrix.sum() ** 2)

    part = Part(1e250, np.ones((1, 2)))
    with pytest.raises(InputError, match=r"^product\b.*: check others\[0\]\.size \(1e\+250\)$"):
        product(3.0, [part], matrix=[[1e29]])
    with pytest.raises(InputError, match=r"^product\b.*: check matrix \(1e\+200\)$"):
        product(3.0, [Part(1.0, part.rows)], matrix=[[-1e200]])

    @checked
    def inverse(matrix: Float64[np.ndarray, "a a"], model: Part):
        return np.linalg.inv(matrix)

    with pytest.raises(InputError, match=r"^inverse\b.*: check matrix, model\.size, model\.rows$"):
        inverse(np.zeros((2, 2)), Part(1.0, [[1, 2]]))


@pytest.fixture(scope="module")
def models():
    """Instances of the toolbox's frozen dataclasses out of the good calls."""
    calls = CATALOGUE.values()
    values = [value for _, good in calls for value in good.values()]
    made = [make(**good) for make, good in calls if inspect.isclass(make) and is_dataclass(make)]
    made = [each for each in values + made if is_dataclass(each) and each.__dataclass_params__.frozen]
    return [each for each in made if type(each).__module__.startswith("stillwork.")]


def test_a_model_equals_another_of_the_same_values(models):
    assert len({type(model) for model in models}) > 30
    for model in models:
        twin = replace(model)
        assert twin == model and model in [twin] and [None, twin].index(model) == 1
        assert model != 1 and model is not None
        for field in fields(model):
            value = getattr(model, field.name)
            if isinstance(value, np.ndarray) and value.size:
                other = value.copy()
                other.flat[-1] = 0 if np.isinf(value.flat[-1]) else value.flat[-1] + 1
                for change in (other, value[None], value.tolist()):
                    object.__setattr__(twin, field.name, change)
                    assert twin != model, (model, field.name)
                object.__setattr__(twin, field.name, value)


def test_every_frozen_class_of_the_toolbox_is_equal_by_value():
    classes = {
        thing
        for folder in FOLDERS
        for each in pkgutil.iter_modules(import_module(f"stillwork.{folder}").__path__)
        for thing in vars(import_module(f"stillwork.{folder}.{each.name}")).values()
        if inspect.isclass(thing) and is_dataclass(thing) and thing.__dataclass_params__.frozen
    }
    assert classes
    assert [each.__name__ for each in classes if each.__eq__.__module__ != by_value.__module__] == []


def searched(family):
    """The largest bandwidth of a stage, or what its search raises."""
    numbers = ([0.0, 300.0], [0.0, 0.01], [[0.3], [0.4]], [[0.3, -0.4]], [[0.0]])
    loop = make_loop(ModalModel(*map(np.array, numbers)), points=50, around=3)
    return maximise_bandwidth([loop], family, [PeakConstraint("input_sensitivity")], 1.0, 20.0)


@checked
def bounded(
    share: Fraction = 0.5,
    count: Annotated[int, at_least(2)] = 2,
    times: Sequence[Positive] = (),
    limit: Positive | None = None,
    signal: Vector = (),
):
    return share, count, times, limit, signal


@checked
def passing_on(**values):
    return bounded(**values)


@pytest.mark.parametrize("call", [bounded, passing_on])
@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"share": 1.0}, r"^share is 1; .*above 0 and below 1$"),
        ({"count": 1}, r"^count is 1; .*at least 2$"),
        ({"times": [1.0, 0.0]}, r"^times\[1\] is 0; .*above 0$"),
        ({"limit": -1.0}, r"^limit is -1; .*above 0$"),
        ({"signal": [[1.0]]}, r"^signal has shape \(1, 1\)"),
    ],
)
def test_bounds_of_an_annotation_are_asked_of_calls_from_inside_too(call, values, message):
    with pytest.raises(InputError, match=message):
        call(**values)
    share, count, times, limit, signal = call(share=np.float32(0.25), times=[np.float32(1)], signal=[1, 2])
    assert (share, count, times, limit) == (0.25, 2, [1.0], None) and type(share) is type(times[0]) is float
    assert signal.dtype == float


@pytest.mark.parametrize("count", [10**14, 2**62])
def test_what_asks_for_more_than_the_memory_is_refused_with_its_size(count):
    @checked
    def zeros(count: int) -> np.ndarray:
        return np.zeros((count, 2))

    with pytest.raises(InputError, match=r"^zeros needs .*memory.*count " + re.escape(f"{count:g}")):
        zeros(count)


def test_what_a_readers_own_function_returns_is_asked():
    with pytest.raises(InputError, match=r"\bfamily\b.*\bPid\b"):
        searched(lambda bandwidth: None)
    for response in (lambda omega: None, lambda omega: "text", lambda omega: np.full(len(omega), np.nan)):
        with pytest.raises(InputError, match=r"\bresponse\b"):
            refine_peak(response, np.array([1.0, 2.0]), np.array([1.0, 2.0]))
    with pytest.raises(InputError, match=r"\bresponse\b.*\(\).*\b9\b"):
        refine_peak(lambda omega: 1.0, np.array([1.0, 2.0]), np.array([1.0, 2.0]))


# What asks each value itself: the checks, what a loop calls for each of its samples, the interface of scikit-learn.
OWN_DOORS = re.compile(
    r"\w+\.converted|matrices|minimal|fields_of_modes|response_arrays|load_machine|least_squares_code|from_control|require_(noise|covariance|per_sample|sample_time|squares|finite_squares|floor_level)|(Adaptation|Recursive)Stepper\.update|(\w+Regressor|LeastMeanSquares)\.((partial_)?fit|predict|score|[gs]et_params)"
)
# What hands the parts of a recursion to its kernels, a sample at a time: `track` and the steppers have asked before.
PARTS = {
    *("first_state", "joint_start", "close_loop", "regressor_at"),
    "FeLms.trace_copies",
    *(
        "solve_plain",
        "spectrum",
        "empty_record",
        "start_record",
        "upper_root",
        "least_share",
    ),  # by the regressor that holds the fitting triangle
    *("Numbers.terms", "Numbers.files"),  # by the functions that write C
    "minimise",  # by the functions that make the cones
    *(
        "AgreedUnits.accelerance",
        "one_response",
        "require_motion",
    ),  # by `load_machine` and the decoupled axes
    "perturbed",  # by the search of an isolator, of isolators that it has asked
    *(
        "MovingPaths.commands",
        "MovingPaths.noises",
        "MovingPaths.transmissibility",
    ),  # by `try_loop` and `predict`
    *("moving_paths", "density_through", "jitter_density", "record_grid", "through"),
    *("alike_ends", "at_end", "moving_weights"),  # by the box, `worst_excess` and `try_loop`
    *("MovingWeights.jitter", "MovingWeights.wandering"),  # by `try_loop` and `predict`
    *("held_force", "folded_force"),  # by `Isolator.paths` and the search of `fit_path`
}
FOLDERS = ("signals", "lti", "identification", "estimation", "control", "machine")
COMMANDS = "axes axes_loops budget budget_isolator budget_tables design desk design_page designed_loop desk_page export hardware html_page inspect isolate machine_toml noisy_peak pictures progress promise replay report retest settling waiting".split()


def public_callables():
    """Name, and the function, of all that a stranger can import from the toolbox and call with arguments."""
    for folder in FOLDERS:
        package = import_module(f"stillwork.{folder}")
        for each in pkgutil.iter_modules(package.__path__):
            if folder == "machine" and each.name in COMMANDS:
                continue
            module = import_module(f"{package.__name__}.{each.name}")
            for name, thing in list(vars(module).items()):
                if name.startswith("_") or getattr(thing, "__module__", "") != module.__name__:
                    continue
                if inspect.isfunction(thing):
                    yield name, thing
                elif inspect.isclass(thing) and not getattr(thing, "_is_protocol", False):
                    for method, function in list(vars(thing).items()):
                        function = getattr(function, "__func__", function)
                        if not method.startswith("_") and inspect.isfunction(function):
                            yield f"{name}.{method}", function


def unasked(function):
    """Parameters of which nobody asks whether they are what they should be; all of them where there is no door."""
    parameters = [name for name in inspect.signature(function).parameters if name != "self"]
    if "door" not in through(function):
        return parameters
    hints = typing.get_type_hints(inspect.unwrap(function))
    known = validation.checks_of(inspect.unwrap(function)).keys()
    return [
        name
        for name in parameters  # what is like an array, `require_array` asks where it is used
        if name not in known and not validation.OPEN & {hints.get(name), *typing.get_args(hints.get(name))}
    ]


def through(function):
    """Names of the functions through which a call reaches what was written."""
    while True:
        yield function.__code__.co_name
        if (function := getattr(function, "__wrapped__", None)) is None:
            return


def test_every_public_function_has_a_front_door():
    found = dict(public_callables())
    assert len(found) > 200 and found.keys() >= PARTS
    doorless = {
        name: gaps
        for name, function in found.items()
        if name not in PARTS and not OWN_DOORS.fullmatch(name) and (gaps := unasked(function))
    }
    assert doorless == {}
