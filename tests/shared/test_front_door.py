"""Arguments and fields against their annotations: what is taken as it is meant, what is refused by name."""

import inspect
import pkgutil
import re
import subprocess
import sys
import typing
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jaxtyping import Float64
from scipy import interpolate

from stillwork.base import front_door
from stillwork.base.checks import InputError
from stillwork.base.front_door import by_value, check_fields, checked
from stillwork.control import PeakConstraint, make_loop, maximise_bandwidth
from stillwork.estimation import FeLms, FeRls, adapt, identify
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
        ("number", "1.5", "number is '1.5', not a number"),
        ("number", 10**400, "number is beyond the largest"),
        pytest.param("number", 10**5000, "number is beyond the largest", id="more digits than are printed"),
        ("number", np.nan, "number is nan"),
        ("number", np.datetime64("2020-01-01"), "not a number"),
        ("number", [1.0], "not a number"),
        ("count", 2.0, "give a whole number"),
        ("count", True, "give a whole number"),
        ("matrix", [1.0, 2.0], "matrix has shape"),
        ("matrix", [["1", "2"]], "matrix is not an array of numbers"),
        ("matrix", [[1.0, np.inf]], "holds 1 NaN or infinite"),
        ("matrix", [[10**400]], "beyond the largest"),
        ("matrix", np.ma.array([[1.0]], mask=[[True]]), "masked"),
        ("parts", 3, "parts is 3; give a list"),
        ("parts", [None], r"parts\[0\] is None; give Part"),
        ("pair", (1.0,), "pair has 1 value; give 2"),
        ("pair", (1.0, "2"), r"pair\[1\] is '2'"),
        ("word", None, "word is None; give str"),
        ("call", 3, "call is 3; give a function"),
        ("either", "x", "either is 'x'; give a number or Part"),
        ("places", [True], r"places is \[True\]; give a list of whole numbers or slice"),
        ("places", "x", "places is 'x'; give a list of whole numbers or slice"),
        ("flag", 1, "flag is 1; give bool"),
        ("flag", np.array(True), "flag is array"),
    ],
)
def test_a_wrong_argument_is_named(name, value, message):
    with pytest.raises(InputError, match=message):
        taken(**{name: value})


def test_other_forms_of_the_same_numbers_become_what_the_annotation_says():
    frozen = np.arange(6.0).reshape(2, 3)
    frozen.flags.writeable = False
    for matrix in (
        frozen,
        frozen.tolist(),
        frozen.astype(np.float32),
        np.asfortranarray(frozen),
        frozen[::-1][::-1],
    ):
        result = taken(np.float32(2), np.int64(3), matrix, (Part(1, [[1, 2]]),), [0, 1])
        assert result[:2] == (2.0, 3) and result[4] == (0.0, 1.0)
        assert result[2].dtype == np.float64 and result[2].flags.c_contiguous and result[2].flags.writeable
        np.testing.assert_array_equal(result[2], frozen)


def test_a_flag_of_numpy_is_taken():
    @checked
    def opposite(flag: bool) -> bool:
        assert type(flag) is bool
        return not flag

    assert opposite(np.True_) is False and opposite(np.False_) is True and opposite(True) is False


def test_a_field_is_checked_and_converted():
    assert Part(1, [[1, 2]]).rows.dtype == np.float64
    with pytest.raises(InputError, match=r"rows has shape \(1, 3\); give any x 2"):
        Part(1.0, [[1, 2, 3]])


def test_a_result_that_is_not_finite_is_an_error():
    @checked
    def ratio(number: float) -> np.ndarray:
        with np.errstate(all="ignore"):
            return np.array([number]) / 0.0

    @checked(infinite=True)
    def endless(number: float) -> np.ndarray:
        with np.errstate(all="ignore"):
            return np.array([number]) / 0.0

    with pytest.raises(InputError, match="ratio has no result"):
        ratio(1.0)
    assert endless(1.0) == np.inf
    with pytest.raises(InputError, match="endless has no result"):
        endless(0.0)


def test_what_a_library_said_is_quoted_as_it_said_it():
    @checked
    def solved(number: float):
        raise np.linalg.LinAlgError("SVD did not converge")

    with pytest.raises(InputError, match=r"\(SVD did not converge\)"):
        solved(1.0)


def test_a_model_keeps_what_it_was_given():
    rows = np.ones((3, 2))
    part = Part(1.0, rows)
    rows[:] = 7.0
    np.testing.assert_array_equal(part.rows, np.ones((3, 2)))


@pytest.fixture(scope="module")
def models():
    """Instances of the toolbox's frozen dataclasses that the fuzz knows a good call of."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
        calls = import_module("fuzzing.calls").catalogue().values()
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
                other.flat[-1] += 1
                for change in (other, value[None], value.tolist()):
                    object.__setattr__(twin, field.name, change)
                    assert twin != model, (model, field.name)
                object.__setattr__(twin, field.name, value)


def test_a_lost_value_is_as_lost_in_an_equal_model():
    @by_value
    @dataclass(frozen=True)
    class Kept:
        parts: tuple
        named: dict

    assert Kept((np.array([np.nan]), [1.0]), {"a": np.ones(2)}) == Kept(
        (np.array([np.nan]), [1.0]), {"a": np.ones(2)}
    )
    assert Kept((), {"a": np.ones(2)}) != Kept((), {"a": np.ones(3)})
    assert Kept((np.ones(2),), {}) != Kept((np.ones(2, dtype=int),), {})
    assert hash(PeakConstraint("input_sensitivity")) == hash(PeakConstraint("input_sensitivity"))


def test_every_frozen_class_of_the_toolbox_is_equal_by_value():
    classes = {
        thing
        for folder in FOLDERS
        for each in pkgutil.iter_modules(import_module(f"stillwork.{folder}").__path__)
        for thing in vars(import_module(f"stillwork.{folder}.{each.name}")).values()
        if inspect.isclass(thing) and is_dataclass(thing) and thing.__dataclass_params__.frozen
    }
    assert len(classes) > 60
    assert [each.__name__ for each in classes if each.__eq__.__module__ != by_value.__module__] == []


def searched(family):
    """The largest bandwidth of a stage, or what its search raises."""
    numbers = ([0.0, 300.0], [0.0, 0.01], [[0.3], [0.4]], [[0.3, -0.4]], [[0.0]])
    loop = make_loop(ModalModel(*map(np.array, numbers)), points=50, around=3)
    return maximise_bandwidth([loop], family, [PeakConstraint("input_sensitivity")], 1.0, 20.0)


@pytest.mark.parametrize("error", [ValueError, IndexError, ZeroDivisionError, np.linalg.LinAlgError])
def test_an_error_of_a_readers_own_function_comes_through(error):
    def family(bandwidth):
        raise error("mine")

    with pytest.raises(error, match=r"^mine$"):
        searched(family)


def test_an_error_of_a_library_that_a_reader_calls_comes_through():
    table = interpolate.interp1d([1.0, 2.0], [1.0, 2.0])
    with pytest.raises(ValueError, match="interpolation range") as raised:
        refine_peak(table, np.array([1.0, 2.0, 3.0]), np.array([1.0, 1.5, 2.0]))
    assert not isinstance(raised.value, InputError)


def test_the_toolbox_asks_within_a_readers_own_function_too():
    @checked
    def rows_of(matrix: Float64[np.ndarray, "a b"]) -> int:
        return matrix.shape[0]

    omega = np.array([0.1, 1.0])
    assert refine_peak(lambda w: rows_of([[1.0]]) / w, omega, 1 / omega).omega == 0.1
    with pytest.raises(InputError, match="matrix is not an array"):
        refine_peak(lambda w: rows_of([["text"]]) / w, omega, 1 / omega)


def test_what_a_readers_own_function_returns_is_asked():
    with pytest.raises(InputError, match="what family returns is None; give Pid"):
        searched(lambda bandwidth: None)
    for response in (lambda omega: None, lambda omega: "text", lambda omega: np.full(len(omega), np.nan)):
        with pytest.raises(InputError, match="what response returns"):
            refine_peak(response, np.array([1.0, 2.0]), np.array([1.0, 2.0]))
    with pytest.raises(InputError, match=r"what response returns has shape \(\) for 9 frequencies"):
        refine_peak(lambda omega: 1.0, np.array([1.0, 2.0]), np.array([1.0, 2.0]))


def test_what_may_be_anything_is_taken_as_it_is():
    @checked
    def kept(value: Any, other: Any | None = None) -> list:
        return [value, other]

    assert kept("text") == ["text", None] and kept(None, kept) == [None, kept]


def test_a_record_without_rows_is_named():
    regressors, disturbance = np.ones((3, 200)), np.ones((1, 200))
    with pytest.raises(InputError, match="disturbance has no rows"):
        identify(FeRls(1.0), regressors, disturbance[:0])
    with pytest.raises(InputError, match="regressors has no rows"):
        adapt(FeLms(0.1), regressors[:0], disturbance)


@pytest.mark.parametrize("settings", [FeRls(1.0), FeLms(0.1)])
@pytest.mark.parametrize("run", [adapt, identify])
def test_read_only_records_of_one_actuator_are_taken(settings, run, tmp_path):
    """As a column of a table or a memory map gives them."""
    rng = np.random.default_rng(1)
    regressors, signal = rng.standard_normal((3, 200)), rng.standard_normal((1, 200))
    np.save(tmp_path / "rows.npy", regressors)
    mapped = np.load(tmp_path / "rows.npy", mmap_mode="r")
    frozen = signal.copy()
    frozen.flags.writeable = False
    wanted = run(settings, regressors, signal)
    np.testing.assert_array_equal(run(settings, mapped, frozen).weights, wanted.weights)


# What asks each value itself: the checks, what a loop calls for each of its samples, the interface of scikit-learn.
OWN_DOORS = re.compile(
    r"from_control|require_(noise|covariance|per_sample|sample_time|squares|finite_squares)|(Adaptation|Recursive)Stepper\.update|\w+Regressor\.fit"
)
# What hands the parts of a recursion to its kernels, a sample at a time: `run` and the steppers have asked before.
PARTS = {
    *("FeLms.trace_copies", "MinMax.bounds", "GrowingMinMax.bounds", "known_length", "empty_track"),
    *("LeastSquares.start", "LeastSquares.fill", "Ridge.start", "Ridge.fill"),
}
FOLDERS = ("signals", "lti", "identification", "estimation", "control")


def public_callables():
    """Name, and the function, of all that a stranger can import from the toolbox and call with arguments."""
    for folder in FOLDERS:
        package = import_module(f"stillwork.{folder}")
        for each in pkgutil.iter_modules(package.__path__):
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
    known = front_door.checks_of(inspect.unwrap(function)).keys()
    return [
        name
        for name in parameters  # what is like an array, `require_array` asks where it is used
        if name not in known and not front_door.OPEN & {hints.get(name), *typing.get_args(hints.get(name))}
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


def test_what_nobody_asks_is_found():
    def open_to_all(number: float, other):
        return number, other

    assert unasked(open_to_all) == ["number", "other"]
    assert unasked(checked(open_to_all)) == ["other"]


MODELS = """
import numpy as np
from stillwork.base.checks import InputError
from stillwork.control import FlowTransformation
from stillwork.control.crossover import crossover
from stillwork.control.digital import biquads
from stillwork.control.feedback import fed_back
from stillwork.control.feedforward import Feedforward
from stillwork.control.fixed_point import ending, require_noise
from stillwork.control.fixed_point_convergence import LimitCycle, Oscillation, iterate
from stillwork.control.fixed_point_linear import LinearFilter, semi_implicit_motion
from stillwork.control.machine_loops import Intensities
from stillwork.control.machine_tuning import DesignSettings, varied
from stillwork.control.setpoint import Setpoint
from stillwork.estimation import AdaptationStepper, FeLms, adapt
from stillwork.estimation.covariance_forms import factor_of
from stillwork.estimation.observer import Observer
from stillwork.estimation.plant import Plant, force_slope, partial_derivatives
from stillwork.estimation.secular import SecularFunction
from stillwork.estimation.windows import end_point_weights
from stillwork.identification.complex_frequency import Stabilisation
from stillwork.identification.frequency_response import impact_response
from stillwork.identification.machine_files import MachineFile, complex_responses, kind_of
from stillwork.identification.regressors import exponential_weights
from stillwork.lti import ModalModel, StateModel, interconnect
from stillwork.lti.peaks import refine_peak
from stillwork.lti.state_space import constant
from stillwork.signals.criteria import criterion_velocity
from stillwork.signals.densities import frequency_axis
from stillwork.signals.records import sampling_rate
from stillwork.signals.spectra import ResponseEstimate, Spectrum, band_power

model = ModalModel([0, 10], [0, 0.01], [[1], [1]], [[1, -1]], [[0]])
assert model.frequencies.dtype == np.float64
one = StateModel([[-1]], [[1]], [[1]], [[0]])
noises = Intensities(1.0, 1.0, 1.0)
stage = ModalModel([0.0, 300.0], [0.0, 0.01], [[0.3], [0.4]], [[0.3, -0.4]], [[0.0]])
hits = np.random.default_rng(1).standard_normal((2, 64))
ending_plant = Plant(lambda q, v, f, p: f / p[0] if q < 1 else np.nan, lambda q, v, a, p: a * p[0], [2.0])
for call, message in (
    (lambda: ModalModel([0.0], [0.0], [[1.0]], [[1.0]], 0.0), "feedthrough has shape ()"),
    (lambda: Observer(None, np.eye(2), np.eye(2), np.eye(2), np.eye(2)), "model is None; give ModalModel"),
    (lambda: Observer(model, -np.eye(2), np.ones((2, 1)), np.ones((1, 2)), np.ones((3, 1))), "gain has shape (3, 1)"),
    (lambda: refine_peak(np.sin, np.ones(3), np.ones(2)), "omega has 3 frequencies, magnitude 2"),
    (lambda: crossover(np.sin, np.ones(3), np.ones(2)), "omega has 3 frequencies, magnitude 2"),
    (lambda: SecularFunction([2.0, 1.0], [1.0, 1.0, 1.0], 1.0, 0.1), "one for each of the coefficients"),
    (lambda: Spectrum([0.0, 1.0], [[1.0]], 1), "density has not one value at each"),
    (lambda: AdaptationStepper("rls", np.zeros((1, 2))), "settings is 'rls'; give FeLms or FeRls"),
    (lambda: Setpoint(0.1, np.zeros((5, 0)), (0.0, 0.5), 0.1), "the arguments of Setpoint do not fit together"),
    (lambda: Feedforward(np.inf), "velocity is inf"),
    (lambda: Setpoint(0.1, np.zeros((5, 10)), ("a", 0.5), 0.1), "scan[0] is 'a'"),
    (lambda: fed_back(model, [[1.0]]), "gain has shape (1, 1)"),
    (lambda: interconnect([one], np.eye(2), [[1.0]], [[1.0]]), "feedback has shape (2, 2)"),
    (lambda: interconnect([], [[1.0]], [[1.0]], [[1.0]]), "models is empty"),
    (lambda: iterate(FlowTransformation(), 1e300, 5, response_gain=1e300), "iterate has no result"),
    (lambda: kind_of({1: 2}), "a name in arrays is 1; give str"),
    (lambda: frequency_axis({1: 2}), "a name in columns is 1; give str"),
    (lambda: sampling_rate("x", {"rate": "fast"}), "rate'] is not an array"),
    (lambda: complex_responses({}), "holds nothing, and no frequency"),
    (lambda: ending(99, 0.0, "x"), "status is 99"),
    (lambda: require_noise(0, ""), "shape is ''; give a tuple of sizes"),
    (lambda: require_noise(0, ()), "shape is (); give a tuple of sizes"),
    (
        lambda: LinearFilter(np.eye(2), np.ones((3, 2)), np.ones((3, 2)), np.ones((3, 2))),
        "do not fit together",
    ),
    (lambda: Stabilisation([1], [1.0, 2.0], [0.1], [True]), "differ in length"),
    (lambda: MachineFile("response", "x", accelerance="x"), "give Identified"),
    (lambda: DesignSettings(None, 10**400, noises), "give a whole number"),
    (
        lambda: varied(DesignSettings(None, 2, noises), "foo", 2.0),
        "name is 'foo'; use one of",
    ),
    (lambda: Oscillation(np.nan, 1.0), "frequency_hz is nan"),
    (lambda: LimitCycle(np.nan, 1.0, 1.0, 1.0, True), "frequency_hz is nan"),
    (lambda: ResponseEstimate("x", *np.ones((3, 1, 1, 1)), 1), "not an array"),
    (lambda: force_slope(ending_plant, 9.0, 0.0, 0.0), "force_slope has no result"),
    (lambda: partial_derivatives(ending_plant, 9.0, 0.0, 0.0), "has no result"),
    (lambda: impact_response(hits, hits, 1e308), "rate is 1e+308"),
    (lambda: biquads(constant([[1, 2], [3, 4]], 1e-3)), "give one of each"),
    (lambda: biquads(constant([[1]])), "model is in continuous time"),
    (lambda: exponential_weights(0, 0.9), "rows is 0"),
    (lambda: exponential_weights(3, 1.5), "forgetting is 1.5"),
    (lambda: semi_implicit_motion((1.0, 2.0, 3.0), 0.0), "sample_time is 0"),
    (lambda: criterion_velocity("VC-A", [-1.0]), "frequencies_hz holds negative"),
    (lambda: factor_of("triangle", np.ones((2, 3))), "give a square one"),
    (lambda: end_point_weights(3, 5), "give a degree below the samples"),
    (lambda: constant(np.zeros((0, 0))), "give it an input and an output"),
    (lambda: stage.state_space().select([], []), "choose one of each"),
    (lambda: stage.at([], []), "give a model an input"),
    (lambda: stage.frequency_response([]), "omega is empty"),
    (lambda: stage.state_space().frequency_response([]), "omega is empty"),
    (lambda: adapt(FeLms(0.1), np.ones((3, 0)), np.ones((1, 0))), "hold no samples"),
    (
        lambda: band_power([1, 2, 3], [1, 1, 1], 3, 1),
        "high_hz is 1; give a finite number above 1",
    ),
):
    try:
        result = call()
    except InputError as error:
        assert message in str(error), (message, error)
    else:
        raise AssertionError((message, result))
assert abs(sampling_rate("x", {"time": [0, 0.1, 0.2]}) - 10.0) < 1e-9
assert complex_responses({"frequency": [1, 2], "h": [1j, 2]})["h"].dtype == complex
"""


@pytest.mark.slow
def test_models_check_themselves():
    """In a process of its own: here the tests' type checker would answer first."""
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", MODELS], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
