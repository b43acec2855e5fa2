"""A plant and a trajectory of one's own in the adaptive loop: read, checked for contraction, driven."""

import importlib
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from experiments.fixedpoint.metrics import noisy_run
from experiments.fixedpoint.noise import Noise
from experiments.fixedpoint.oscillator import load_oscillator
from experiments.fixedpoint.published import KALMAN, LOW_PASS, WINDOW, published_controllers
from stillwork.base import paths
from stillwork.base.checks import InputError, nearest, require_choice, require_number
from stillwork.control.fixed_point import ControlledRun, Controller
from stillwork.control.fixed_point_convergence import StableRange, stable_range
from stillwork.control.fixed_point_linear import linear_loop
from stillwork.control.kinematics import KinematicDesign
from stillwork.control.trajectory import (
    Trajectory,
    asin_trajectory,
    record_trajectory,
    sine_trajectory,
    trapezoid_trajectory,
)
from stillwork.control.transformation import (
    ContractionWarning,
    FlowTransformation,
    RobustTransformation,
    contraction_range,
)
from stillwork.estimation.plant import Plant, partial_derivatives
from stillwork.inspecting import NEEDED, TABLES, outline
from stillwork.signals.records import load_record

OWN_FORM = {"approximate_acceleration": 4, "approximate_force": 4}
SHAPES = ("sine", "asin", "trapezoid")
_PLACES = 200  # along a trajectory, where the gain is looked at


@dataclass(frozen=True)
class Models:
    """The plant and what the controller believes it to be."""

    exact: Plant
    approximate: Plant
    source: str


def load_models(plant: str = "") -> Models:
    """Exact and approximate model from a Python file, a module, or a TOML file of the van der Pol form.

    A Python file (it is executed) or a module defines ``acceleration(position, velocity, force, parameters)``
    and its inverse ``force(position, velocity, acceleration, parameters)``, and the tables ``EXACT`` and
    ``APPROXIMATE`` from names to numbers, whose values the functions get in order. An approximate model of
    another form is ``approximate_acceleration`` and ``approximate_force``.

    Parameters
    ----------
    plant : str
        Path of a ``.py`` or ``.toml`` file, or an import path such as ``mylab.stage``; empty: the template
        ``data/fixedpoint/your_plant.py``.

    Raises
    ------
    InputError
        When the file or module lacks one of these, or they do not fit together; it says what to do.
    """
    path = Path(plant) if plant else paths.data("fixedpoint", "your_plant.py")
    if path.suffix == ".toml":
        models = load_oscillator(path)
        return Models(models["exact"].plant, models["approximate"].plant, path.name)
    if path.suffix == ".py":
        return _models(_executed(path), path.name)
    try:
        module = importlib.import_module(plant)
    except (ImportError, ValueError) as error:
        raise InputError(
            f"plant is {plant!r}, no .py or .toml file, and cannot be imported ({error}); give the path of a file "
            "or the import path of a module"
        ) from None
    return _models(module, plant)


def _executed(file: Path) -> SimpleNamespace:
    if missing := outline(file):
        raise InputError(
            f"{file.name}: {', '.join(missing)}; copy data/fixedpoint/your_plant.py and fill it in"
        )
    space = {"__name__": file.stem}
    try:
        # Under no file name, so that nothing is cached beside a file of the user's, or of the data.
        exec(compile(file.read_text(encoding="utf-8"), f"<{file.name}>", "exec"), space)
    except Exception as error:
        raise InputError(f"{file.name} stops with {type(error).__name__}: {error}; mend it") from None
    return SimpleNamespace(**space)


def _models(space, source: str) -> Models:
    for name in (*NEEDED, *TABLES):
        if not hasattr(space, name):
            raise InputError(
                f"{source} lacks {name}{nearest(name, vars(space))}; see data/fixedpoint/your_plant.py"
            )
    tables = {name: getattr(space, name) for name in TABLES}
    for name, table in tables.items():
        if not isinstance(table, Mapping) or not table:
            raise InputError(f"{source}: {name} is no table; give names and numbers, such as {{'mass': 1.5}}")
        for key, value in table.items():
            require_number(f"{source}: {name}[{key!r}]", value)
    own_form = [name for name in OWN_FORM if hasattr(space, name)]
    if len(own_form) == 1:
        raise InputError(
            f"{source} defines {own_form[0]} alone; the approximate model takes both {' and '.join(OWN_FORM)}"
        )
    if not own_form and list(tables["EXACT"]) != list(tables["APPROXIMATE"]):
        raise InputError(
            f"{source}: EXACT has {', '.join(tables['EXACT'])} and APPROXIMATE has "
            f"{', '.join(tables['APPROXIMATE'])}; give the same names in the same order, or an approximate model of "
            f"its own form ({' and '.join(OWN_FORM)})"
        )
    prefix = "approximate_" if own_form else ""
    try:
        exact = Plant(space.acceleration, space.force, list(tables["EXACT"].values()))
        approximate = Plant(
            getattr(space, f"{prefix}acceleration"),
            getattr(space, f"{prefix}force"),
            list(tables["APPROXIMATE"].values()),
        )
        for model in (exact, approximate):
            _ = model.compiled  # fails here, with the name of the function, not in the loop
    except InputError as error:
        raise InputError(f"{source}: {error}") from None
    except Exception as error:
        raise InputError(
            f"{source}: a model function stops with {type(error).__name__}: {error}; mend it"
        ) from None
    return Models(exact, approximate, source)


def open_trajectory(
    record: str = "",
    unit: str = "m",
    *,
    sample_rate: float | None = None,
    channel: str = "",
    low_pass_hz: float = 0.0,
    shape: str = "asin",
    amplitude: float = 1.0,
    sharpness: float = 0.98,
    frequency_hz: float = 0.2,
    duration: float = 12.0,
    time_step: float = 1e-3,
) -> Trajectory:
    """Nominal motion from a record of positions, or from a formula where none is named.

    Parameters
    ----------
    record : str
        Path of a CSV, MAT, NPZ or UFF file, see `stillwork.signals.records.load_record`; empty for the formula.
    unit : str
        Of the record: m, mm, um, km, ...
    sample_rate : float, optional
        Hz; needed when the file has neither a time nor a rate.
    channel : str
        Which to take where there are several.
    low_pass_hz : float
        Corner of a fourth-order zero-phase low pass for the record, whose noise two derivatives would blow up;
        0: none.
    shape : str
        ``sine``, ``asin`` (sharp corners) or ``trapezoid``.
    amplitude, sharpness, frequency_hz, duration : float
        Of the formula: m, 0 to 1 (the trapezoid's rounding is its rest to 1), Hz, s.
    time_step : float
        s, of the loop.

    Raises
    ------
    InputError
        For everything that makes the record unusable; it says what to do.
    """
    if not record:
        require_choice("shape", shape, SHAPES)
        common = {"frequency_hz": frequency_hz, "duration": duration, "time_step": time_step}
        if shape == "sine":
            return sine_trajectory(amplitude, **common)
        if shape == "asin":
            return asin_trajectory(amplitude, sharpness, **common)
        return trapezoid_trajectory(
            amplitude, 1 - require_number("sharpness", sharpness, above=0, below=1), **common
        )
    read = load_record(
        record, unit, sample_rate=sample_rate, channels=[channel] if channel else None, most_channels=1
    )
    if read.unit != "m":
        raise InputError(f"trajectory_unit is {unit!r}; a trajectory is a position: m, mm, um or km")
    position = read.signals[0]
    if low_pass_hz:
        from scipy.signal import butter, sosfiltfilt

        require_number("low_pass_hz", low_pass_hz, above=0, below=read.sample_rate / 2)
        position = sosfiltfilt(butter(4, low_pass_hz, fs=read.sample_rate, output="sos"), position)
    return record_trajectory(np.arange(len(position)) / read.sample_rate, position, time_step)


def controllers(
    model: Plant, flow: FlowTransformation, robust: RobustTransformation, exponents: list[float]
) -> dict[str, Controller]:
    """The paper's three filters with one's own settings: (6) for the moving window, (8) for the others, lambda in 1/s."""
    names = (WINDOW, LOW_PASS, KALMAN)
    if len(exponents) != len(names):
        raise InputError(f"exponents holds {len(exponents)} numbers; give one each for {', '.join(names)}")
    published = published_controllers(model)
    return {
        name: replace(
            published[name],
            transformation=flow if name == WINDOW else robust,
            kinematics=KinematicDesign(exponent),
        )
        for name, exponent in zip(names, exponents, strict=True)
    }


class Contraction(NamedTuple):
    """How the iteration contracts along a trajectory."""

    time: Float64[np.ndarray, " places"]  # s
    gain: Float64[np.ndarray, " places"]  # f': m/s^2 realised per m/s^2 commanded

    def multiplier(self, local_gain: float) -> Float64[np.ndarray, " places"]:
        """1 + local_gain f': within (-1, 1) an iteration brings the command nearer to what is wanted."""
        return 1 + local_gain * self.gain

    @property
    def allowed(self) -> tuple[float, float]:
        """Local gains that contract everywhere on the way; empty (NaN) when f' changes its sign."""
        ranges = [contraction_range(float(gain)) for gain in self.gain]
        low, high = max(low for low, _ in ranges), min(high for _, high in ranges)
        return (low, high) if low < high else (np.nan, np.nan)


def contraction_along(models: Models, trajectory: Trajectory) -> Contraction:
    """Gain f' of the approximate model's command at the states that the trajectory visits."""
    at = np.unique(np.linspace(0, len(trajectory.position) - 1, _PLACES).astype(int))
    gains = []
    for position, velocity, wanted in zip(
        trajectory.position[at], trajectory.velocity[at], trajectory.acceleration[at], strict=True
    ):
        slopes = []
        for model in (models.exact, models.approximate):
            force = model.force(position, velocity, wanted, model.parameters)
            slopes.append(partial_derivatives(model, position, velocity, force)[2])
        if slopes[1] == 0 or not np.isfinite(slopes).all() or slopes[0] == 0:
            raise InputError(
                f"a model does not answer the force at q = {position:.3g} m, q' = {velocity:.3g} m/s; mend it there"
            )
        gains.append(slopes[0] / slopes[1])
    return Contraction(trajectory.time[at], np.array(gains))


def warnings_of(found: Contraction, chosen: Mapping[str, Controller]) -> list[str]:
    """One sentence for each controller whose gain leaves the contraction range on the way."""
    low, high = found.allowed
    said = []
    for name, controller in chosen.items():
        gain = controller.transformation.local_gain
        outside = np.abs(found.multiplier(gain)) >= 1
        if outside.any():
            said.append(
                f"{name}: the local gain {gain:.3g} is outside the contraction range ({low:.3g}, {high:.3g}) on "
                f"{100 * outside.mean():.0f} % of the way, first at {found.time[outside.argmax()]:.2f} s; there the "
                "iteration does not converge: lower the gain, widen w, or give a better approximate model"
            )
    return said


def stable_ranges(
    models: Models, chosen: Mapping[str, Controller], trajectory: Trajectory
) -> dict[str, StableRange]:
    """Local gains for which the whole linear loop, filter and delay included, is stable where the motion starts."""
    return {
        name: stable_range(
            linear_loop(
                models.exact,
                controller,
                trajectory.time_step,
                float(trajectory.position[0]),
                float(trajectory.velocity[0]),
            )
        )
        for name, controller in chosen.items()
    }


def drive(
    models: Models, chosen: Mapping[str, Controller], trajectory: Trajectory, noise: Noise, seed: int
) -> dict[str, ControlledRun]:
    """One run of every controller in the same noise; contraction is judged by `warnings_of`, not here."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ContractionWarning)
        return {
            name: noisy_run(models.exact, controller, trajectory, noise, seed)
            for name, controller in chosen.items()
        }
