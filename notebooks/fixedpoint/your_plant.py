"""Your plant: what this notebook alone needs."""

import importlib
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from experiments.fixedpoint.axes import COLOURS, LINES, NOMINAL, fill_range
from experiments.fixedpoint.metrics import judge
from experiments.fixedpoint.noise import Noise, drop_samples
from experiments.fixedpoint.oscillator import load_oscillator
from experiments.fixedpoint.published import KALMAN, LOW_PASS, WINDOW, published_controllers
from stillwork.base.checks import InputError, nearest, pluralise, require_choice, require_number
from stillwork.control.controlled_run import ControlledRun
from stillwork.control.fixed_point import Controller, simulate
from stillwork.control.fixed_point_convergence import StableRange, stable_range
from stillwork.control.fixed_point_linear import LinearLoop, linear_loop
from stillwork.control.fixed_point_mechanism import simulate_mechanism
from stillwork.control.kinematics import KinematicDesign
from stillwork.control.mechanism import Mechanism, response_matrix
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
    Transformation,
)
from stillwork.estimation.filtering import UNIT_MASS
from stillwork.estimation.plant import Plant, force_slope
from stillwork.machine.inspect import TABLES, outline, plant_form
from stillwork.signals.records import load_record
from workbook import figures, paths

# === Your plant ============================================================================================
UNITS = {"m": "N", "rad": "N m"}  # of a coordinate, and of what pushes it
COPY = "copy data/fixedpoint/your_plant.py, or arm.py beside it for several coordinates, and fill it in"
SHAPES = ("sine", "asin", "trapezoid")
_PLACES = 200  # along a trajectory, where the gain is looked at


@dataclass(frozen=True)
class Models:
    """The plant and what the controller believes it to be."""

    exact: Plant | Mechanism
    approximate: Plant | Mechanism
    source: str
    units: tuple[str, ...] = ("m",)  # of the coordinates


def load_models(plant: str = "") -> Models:
    """Exact and approximate model from a Python file, a module, or a TOML file of the van der Pol form.

    A Python file (it is executed) or a module such as ``mylab.stage`` defines
    ``acceleration(position, velocity, force, parameters)`` and its inverse
    ``force(position, velocity, acceleration, parameters)``, or with several coordinates
    ``inertia(position, parameters, out)`` and ``bias(position, velocity, parameters, out)``, and the tables ``EXACT``
    and ``APPROXIMATE`` from names to numbers, whose values the functions get in order. ``UNITS`` names the unit of each
    coordinate, m or rad; without it there is one, in m. An approximate model of another form is a second pair of
    functions, with ``approximate_`` before their names. A bare file name is sought in ``data/fixedpoint``; empty is the
    template ``data/fixedpoint/your_plant.py``.
    """
    path = Path(plant or "your_plant.py")
    shipped = paths.data("fixedpoint", path.name)
    if not plant or (plant == path.name and not path.exists() and shipped.exists()):
        path = shipped
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
    return _models(vars(module), plant)


def _executed(file: Path) -> dict[str, Any]:
    if missing := outline(file):
        raise InputError(f"{file.name}: {', '.join(missing)}; {COPY}")
    space = {"__name__": file.stem}
    try:
        # Under no file name, so that nothing is cached beside a file of the user's, or of the data.
        exec(compile(file.read_text(encoding="utf-8"), f"<{file.name}>", "exec"), space)
    except Exception as error:
        raise InputError(f"{file.name} stops with {type(error).__name__}: {error}; correct it") from None
    return space


def _models(space: Mapping, source: str) -> Models:
    form = [*plant_form(space)]
    for name in (*form, *TABLES):
        if name not in space:
            raise InputError(f"{source} lacks {name}{nearest(name, space)}; {COPY}")
    for name in TABLES:
        table = space[name]
        if not isinstance(table, Mapping) or not table:
            raise InputError(f"{source}: {name} is no table; give names and numbers, such as {{'mass': 1.5}}")
        for key, value in table.items():
            require_number(f"{source}: {name}[{key!r}]", value)
    own_form = [f"approximate_{name}" for name in form]
    defined = [name for name in own_form if name in space]
    if len(defined) == 1:
        raise InputError(
            f"{source} defines {defined[0]} alone; the approximate model takes both {' and '.join(own_form)}"
        )
    exact, approximate = (space[name] for name in TABLES)
    if not defined and list(exact) != list(approximate):
        raise InputError(
            f"{source}: EXACT has {', '.join(exact)} and APPROXIMATE has {', '.join(approximate)}; give the same "
            f"names in the same order, or an approximate model of its own form ({' and '.join(own_form)})"
        )
    units = _units(space, form, source)
    try:
        plant = _model(space, form, exact, len(units))
        believed = _model(space, defined or form, approximate, len(units))
    except InputError as error:
        raise InputError(f"{source}: {error}") from None
    except Exception as error:
        raise InputError(
            f"{source}: a model function stops with {type(error).__name__}: {error}; correct it"
        ) from None
    return Models(plant, believed, source, units)


def _units(space: Mapping, form: list[str], source: str) -> tuple[str, ...]:
    units = space.get("UNITS", ("m",) if "force" in form else ())
    if not isinstance(units, tuple | list) or not units or any(unit not in UNITS for unit in units):
        raise InputError(
            f"{source}: UNITS is {units!r}; give the unit of each coordinate, m or rad, such as ('rad', 'rad')"
        )
    if "force" in form and len(units) != 1:
        raise InputError(
            f"{source}: UNITS names {len(units)} coordinates, acceleration and force know one; define inertia and bias "
            "for more, as data/fixedpoint/arm.py does"
        )
    return tuple(units)


def _model(space: Mapping, names: list[str], table: Mapping, coordinates: int) -> Plant | Mechanism:
    functions, numbers = [space[name] for name in names], list(table.values())
    if names[0].endswith("inertia"):
        model = Mechanism(*functions, coordinates, numbers)
    else:
        model = Plant(*functions, numbers)
    _ = model.compiled  # fails here, with the name of the function, not in the loop
    return model


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
    sample_time: float = 1e-3,
    quantity: str = "m",
) -> Trajectory:
    """Nominal motion from a record of positions, or from a formula where none is named.

    `unit` and, where the file does not tell it, `sample_rate` are the record's; a zero-phase low pass of fourth order
    spares it from noise that two derivatives would blow up. A formula's `shape` is ``sine``, ``asin`` (sharp corners) or
    ``trapezoid``, whose rounding is the rest of `sharpness` to 1. `quantity` is what the record must hold: m or rad.
    """
    if not record:
        require_choice("shape", shape, SHAPES)
        common = {"frequency_hz": frequency_hz, "duration": duration, "sample_time": sample_time}
        if shape == "sine":
            return sine_trajectory(amplitude, **common)
        if shape == "asin":
            return asin_trajectory(amplitude, sharpness, **common)
        rounding = 1 - require_number("sharpness", sharpness, above=0, below=1)
        return trapezoid_trajectory(amplitude, rounding, **common)
    read = load_record(
        record, unit, sample_rate=sample_rate, channels=[channel] if channel else None, most_channels=1
    )
    if read.unit != quantity:
        raise InputError(
            f"trajectory_unit is {unit or read.unit!r}; this coordinate is in {quantity}: {quantity}, m{quantity}, u{quantity} or "
            f"k{quantity}"
        )
    position = read.signals[0]
    if low_pass_hz:
        from scipy.signal import butter, sosfiltfilt

        require_number("low_pass_hz", low_pass_hz, above=0, below=read.sample_rate / 2)
        position = sosfiltfilt(butter(4, low_pass_hz, fs=read.sample_rate, output="sos"), position)
    return record_trajectory(np.arange(len(position)) / read.sample_rate, position, sample_time)


def open_trajectories(
    units: tuple[str, ...], record: str, unit: str, *, channel: str, amplitudes: list[float], **options
) -> list[Trajectory]:
    """`open_trajectory` for each coordinate: of its channel (names separated by ;), or with its amplitude."""
    channels = [name.strip() for name in channel.split(";")] if len(units) > 1 and record else [channel]
    if record and len(channels) != len(units):
        raise InputError(
            f"trajectory_channel names {len(channels)}; give {len(units)} names for the coordinates, separated by ;"
        )
    if len(amplitudes) not in (1, len(units)):
        raise InputError(
            f"amplitudes holds {len(amplitudes)} numbers; give one, or one for each of {len(units)}"
        )
    return [
        open_trajectory(
            record,
            unit,
            channel=channels[number % len(channels)],
            amplitude=amplitudes[number % len(amplitudes)],
            quantity=quantity,
            **options,
        )
        for number, quantity in enumerate(units)
    ]


def for_each(name: str, values: Sequence[float], units: tuple[str, ...]) -> list[float]:
    """One number for each coordinate, from as many or from one for all."""
    if len(values) not in (1, len(units)):
        raise InputError(
            f"{name} holds {pluralise(len(values), 'number')}; give one, or one for each of {len(units)} coordinates"
        )
    return [values[number % len(values)] for number in range(len(units))]


def noises(kind: str, sizes: list[float], units: tuple[str, ...]) -> list[Noise]:
    """Noise of each coordinate, in its unit."""
    sizes = for_each("noise_sizes", sizes, units)
    return [Noise() if kind == "none" else Noise(kind, size) for size in sizes]


FILTERS = (WINDOW, LOW_PASS, KALMAN)


@dataclass(frozen=True)
class Numbers:
    """What may be chosen of the paper's three controllers. A list holds one number for all coordinates, or one for each."""

    exponents: Sequence[float] = (
        24.0,
        16.0,
        36.0,
    )  # Lambda of (1), 1/s: three, or three for each coordinate in turn
    flow_gains: Sequence[float] = (-1.1,)  # A of (6), in the coordinate's unit over s^2
    flow_widths: Sequence[float] = (3.0,)  # w of (6), likewise
    robust_slopes: Sequence[float] = (2.25e-9,)  # A_c of (8), over it
    scales: Sequence[float] = (1.0,)  # of A, w, K_c, 1 / A_c and the Kalman filter's deviations: 1000 for mm

    def controller(self, name: str, model: Plant | Mechanism, units: tuple[str, ...], j: int) -> Controller:
        """That of a filter and the coordinate j: (6) for the moving window, (8) for the others.

        The Kalman filter believes in the approximate model; of several coordinates, in a unit mass that the deformed
        acceleration pushes.
        """

        def own(knob: str) -> float:
            return for_each(knob, getattr(self, knob), units)[j]

        if len(self.exponents) not in (len(FILTERS), len(FILTERS) * len(units)):
            raise InputError(
                f"exponents holds {pluralise(len(self.exponents), 'number')}; give one each for {', '.join(FILTERS)}, or as many "
                "for each coordinate in turn"
            )
        exponent = self.exponents[(len(FILTERS) * j + FILTERS.index(name)) % len(self.exponents)]
        scale = own("scales")
        published = published_controllers(model if isinstance(model, Plant) else UNIT_MASS)[name]
        device: Any = published.signal_filter
        if name == KALMAN:
            knobs = ("process", "noise", "initial_variance")
            device = replace(device, **{knob: scale**2 * getattr(device, knob) for knob in knobs})
        transformation: Transformation = RobustTransformation(
            scale * RobustTransformation.offset, slope=own("robust_slopes") / scale
        )
        if name == WINDOW:
            transformation = FlowTransformation(scale * own("flow_gains"), scale * own("flow_widths"))
        return Controller(device, transformation, KinematicDesign(exponent), model)


def controllers(models: Models, numbers: Numbers) -> dict[str, list[Controller]]:
    """The paper's three filters with one's own numbers, a controller for each coordinate."""
    count = range(len(models.units))
    return {
        name: [numbers.controller(name, models.approximate, models.units, j) for j in count]
        for name in FILTERS
    }


def local_gains(controller: list[Controller]) -> Float64[np.ndarray, " coordinates"]:
    """g of each coordinate."""
    return np.array([each.transformation.local_gain for each in controller])


class Contraction(NamedTuple):
    """How the iteration contracts along a trajectory."""

    time: Float64[np.ndarray, " places"]  # s
    # F = M^-1 M_model: what is realised of commanded accelerations
    response: Float64[np.ndarray, "places coordinates coordinates"]

    @property
    def gain(self) -> Float64[np.ndarray, "places coordinates"]:
        """f', the eigenvalues of F, smallest first; with one coordinate m/s^2 realised per m/s^2 commanded."""
        return np.sort(np.linalg.eigvals(self.response).real, axis=-1)

    def multiplier(self, gains: Float64[np.ndarray, " coordinates"]) -> np.ndarray:
        """Eigenvalues of 1 + G F, (places, coordinates): within the unit circle the iteration converges there."""
        return 1 + np.sort(np.linalg.eigvals(gains[:, None] * self.response), axis=-1)

    def outside(self, gains: Float64[np.ndarray, " coordinates"]) -> Bool[np.ndarray, " places"]:
        """Where the iteration does not converge."""
        return (np.abs(self.multiplier(gains)) >= 1).any(axis=1)

    def allowed(self, gains: Float64[np.ndarray, " coordinates"]) -> tuple[float, float]:
        """First gains, the others in their ratio to it, that converge everywhere; empty (NaN) when f' changes its sign."""
        values = self.multiplier(gains / gains[0]).ravel() - 1
        edges = -2 * values.real / np.abs(values) ** 2
        low, high = np.minimum(edges, 0.0).max(), np.maximum(edges, 0.0).min()
        return (float(low), float(high)) if low < high else (np.nan, np.nan)


def contraction_along(models: Models, trajectories: list[Trajectory]) -> Contraction:
    """Gains f' of the approximate model's command at the states that the trajectories visit."""
    time = trajectories[0].time
    at = np.unique(np.linspace(0, len(time) - 1, _PLACES).astype(int))
    motion = np.array([[each.position, each.velocity, each.acceleration] for each in trajectories])[..., at]
    if isinstance(models.exact, Mechanism):
        found = [response_matrix(models.exact, models.approximate, place) for place in motion[:, 0].T]
    else:
        found = [[[_response_gain(models, *point)]] for point in motion[0].T]
    return Contraction(time[at], np.array(found))


def _response_gain(models: Models, position: float, velocity: float, wanted: float) -> float:
    slopes = []
    for model in (models.exact, models.approximate):
        force = model.force(position, velocity, wanted, model.parameters)
        with suppress(InputError):  # where it is not finite
            slopes.append(force_slope(model, position, velocity, force))
    if len(slopes) < 2 or 0 in slopes:
        unit = models.units[0]
        raise InputError(
            f"a model does not answer the force at q = {position:.3g} {unit}, q' = {velocity:.3g} {unit}/s; correct it there"
        )
    return slopes[0] / slopes[1]


def said(gains: Float64[np.ndarray, " coordinates"]) -> str:
    """Gains as they are printed: one number where all are equal."""
    return ", ".join(f"{gain:.3g}" for gain in (gains[:1] if np.ptp(gains) == 0 else gains))


def warnings_of(found: Contraction, chosen: Mapping[str, list[Controller]]) -> list[str]:
    """One sentence for each controller with which the iteration does not converge somewhere on the way."""
    sentences = []
    for name, controller in chosen.items():
        gains = local_gains(controller)
        outside, (low, high) = found.outside(gains), found.allowed(gains)
        if outside.any():
            which, of = ("gain {} is", "") if np.ptp(gains) == 0 else ("gains {} are", " of the first")
            sentences.append(
                f"{name}: the local {which.format(said(gains))} outside the contraction range ({low:.3g}, {high:.3g}){of} on "
                f"{100 * outside.mean():.0f} % of the way, first at {found.time[outside.argmax()]:.2f} s; there the iteration does "
                "not converge: lower the gain, widen w, or give a better approximate model"
            )
    return sentences


def _loops(models, controller, trajectories, places) -> list[LinearLoop]:
    motion = np.array([[each.position, each.velocity] for each in trajectories])
    sample_time = trajectories[0].sample_time
    return [linear_loop(models.exact, controller, sample_time, *motion[:, :, at].T) for at in places]


def stable_ranges(
    models: Models, chosen: Mapping[str, list[Controller]], trajectories: list[Trajectory]
) -> dict[str, StableRange]:
    """Local gains for which the whole linear loop, filter and delay included, is stable where the motion starts.

    Of the first coordinate; those of the others keep their ratio to it.
    """
    return {
        name: stable_range(*_loops(models, controller, trajectories, [0]))
        for name, controller in chosen.items()
    }


def largest_radii(
    models: Models, chosen: Mapping[str, list[Controller]], trajectories: list[Trajectory], places: int = 20
) -> dict[str, float]:
    """Largest spectral radius of the linear loop of all coordinates, over places on the way; stable below 1."""
    at = np.linspace(0, len(trajectories[0].position) - 1, places).astype(int)
    return {
        name: max(
            loop.radius(float(local_gains(controller)[0]))
            for loop in _loops(models, controller, trajectories, at)
        )
        for name, controller in chosen.items()
    }


def table_of(
    models: Models,
    chosen: Mapping[str, list[Controller]],
    trajectories: list[Trajectory],
    contraction: Contraction,
):
    """A row a filter: its gains, where iteration and loop allow them, and whether the loop is stable all the way."""
    from pandas import DataFrame

    ranges, radii = (each(models, chosen, trajectories) for each in (stable_ranges, largest_radii))
    rows = {}
    for name, controller in chosen.items():
        gains = local_gains(controller)
        rows[name] = {
            "local gain": said(gains),
            "contracts in": "({:.3g}, {:.3g})".format(*contraction.allowed(gains)),
            "loop stable in": "({:.3g}, {:.3g})".format(*ranges[name].limits),
            "largest radius": f"{radii[name]:.4f}",
            "stable": bool(gains[0] in ranges[name] and radii[name] < 1),
        }
    return DataFrame.from_dict(rows, orient="index")


def described(
    runs: Mapping[str, list[ControlledRun]], units: tuple[str, ...], settle: float
) -> Iterator[str]:
    """What each filter leaves, coordinate by coordinate."""
    for name, each in runs.items():
        if each[0].diverged_at is not None:
            yield f"{name}: diverges at {each[0].diverged_at:.2f} s, {each[0].cause}"
            continue
        for number, (run, unit) in enumerate(zip(each, units, strict=True)):
            errors, q = judge(run, settle), symbol(number, units)
            yield (
                f"{name}: RMS error of {q} {1e3 * errors['position']:.3g} m{unit}, of {q}' {1e3 * errors['velocity']:.3g} m{unit}/s, "
                f"change of {q}'' per sample {errors['roughness']:.3g} {unit}/s², largest |u| {np.abs(run.force).max():.3g} {UNITS[unit]}"
            )


def drive(
    models: Models,
    chosen: Mapping[str, list[Controller]],
    trajectories: list[Trajectory],
    noise: list[Noise],
    seed: int,
    *,
    lost_every: float = 0.0,
    lost_for: float = 0.0,
    lost: str = "predict",
    force_limits: list[float] | None = None,
) -> dict[str, list[ControlledRun]]:
    """One run of every controller in the same noise, for each coordinate.

    Contraction is judged by `warnings_of`, not here. `lost_every`, `lost_for` (s): see `noise.drop_samples`; `lost`: what stands
    for a lost sample, see `control.simulate`; `force_limits` (N or N m): of each actuator, 0 for none.
    """
    rng, count = np.random.default_rng(seed), len(trajectories)
    added = np.array([each.sample(rng, len(trajectories[0].position)) for each in noise])
    added = drop_samples(added, trajectories[0].sample_time, lost_every, lost_for)
    encoders = {
        "resolution": [each.resolution for each in noise],
        "grid": [each.sample_grid(rng) for each in noise],
    }
    limits = np.array([limit or np.inf for limit in force_limits or [0.0] * count])

    def run(controller) -> list[ControlledRun]:
        if isinstance(models.exact, Mechanism):
            largest = np.where(np.isfinite(limits), limits, 1e300)
            options = {"force_limits": largest if np.isfinite(limits).any() else None, "lost": lost}
            return simulate_mechanism(models.exact, controller, trajectories, added, **encoders, **options)
        limit = float(limits[0]) if np.isfinite(limits[0]) else None
        options = {name: value[0] for name, value in encoders.items()} | {"force_limit": limit, "lost": lost}
        return [simulate(models.exact, controller[0], trajectories[0], added[0], **options)]

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ContractionWarning)
        return {name: run(controller) for name, controller in chosen.items()}


# === Your plant pictures ==========================================================================================
# Pictures of a plant of one's own in the adaptive loop (notebook 09).


_BINS = 240  # of an envelope over a run
_SHOWN = 20_000  # samples in the explorer at most


def paint_contraction(found: Contraction, chosen: Mapping[str, list[Controller]]):
    """Multipliers of the iteration along the trajectory: it contracts between -1 and 1, fastest at 0.

    Of complex ones the magnitude.
    """
    figure, axes = figures.new(1, 1, height=2.6)
    for number, (name, controller) in enumerate(chosen.items()):
        values = found.multiplier(local_gains(controller))
        values = np.where(values.imag == 0, values.real, np.abs(values))
        # Equal gains lie upon each other; of several coordinates there are several lines.
        for line, each in enumerate(values.T):
            label = name if line == 0 else f"{name}, direction {line + 1}"
            axes.plot(found.time, each, "--" if number == 2 else "-", color=COLOURS[name], label=label)
    for edge in (-1.0, 1.0):
        axes.axhline(edge, color=figures.BLACK, ls="--", lw=0.9)
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, -1.3), max(high, 1.3))
    axes.set(xlabel="time (s)", ylabel="multiplier of an iteration")
    axes.set(title="the iteration contracts between the dashed lines")
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(handles[:: found.gain.shape[1]], labels[:: found.gain.shape[1]], ncols=3)
    return figure


def paint_runs(runs: Mapping[str, list[ControlledRun]], units: tuple[str, ...], settle: float):
    """Nominal and true motion, and the range of the tracking error in short stretches; a column for each coordinate."""
    figure, panels = figures.new(2, len(units), height=4.8, sharex=True, squeeze=False)
    for number, ((motion, error), unit) in enumerate(zip(panels.T, units, strict=True)):
        _paint_coordinate(motion, error, {name: each[number] for name, each in runs.items()}, settle)
        motion.set(ylabel=f"{symbol(number, units)} ({unit})")
        error.set(xlabel="time (s)", ylabel=f"error of {symbol(number, units)} (m{unit})")
        error.set_title("smallest to largest error in short stretches")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def symbol(number: int, units: tuple[str, ...]) -> str:
    """q, or q1, q2, ... where there are several."""
    return "q" if len(units) == 1 else f"q{number + 1}"


def _paint_coordinate(motion, error, runs: Mapping[str, ControlledRun], settle: float):
    nominal = next(iter(runs.values())).trajectory
    coarse = slice(None, None, max(1, len(nominal.position) // 600))
    motion.plot(nominal.time[coarse], nominal.position[coarse], **NOMINAL)
    reach = 0.0
    for name, run in runs.items():
        label = name if run.diverged_at is None else f"{name}, diverges at {run.diverged_at:.2f} s"
        motion.plot(
            run.time[coarse], run.position[coarse], color=COLOURS[name], lw=LINES[name][0], label=label
        )
        _paint_error(error, run, color=COLOURS[name], label=f"_{name}")
        if run.diverged_at is None:
            reach = max(reach, 1.15e3 * np.abs(run.position_error[run.time >= settle]).max())
    margin = 0.2 * np.ptp(nominal.position)
    motion.set_ylim(nominal.position.min() - margin, nominal.position.max() + margin)
    if reach:
        error.set_ylim(-reach, reach)


def _paint_error(axes, run: ControlledRun, **style):
    """In mm or mrad, each bin's extremes."""
    fill_range(axes, run.time, 1e3 * run.position_error, max(1, len(run.time) // _BINS), **style)


def _stronger(controller: Controller, gain: float, stiffness: float) -> Controller:
    old = controller.transformation
    knob = "gain" if isinstance(old, FlowTransformation) else "slope"
    stronger = replace(old, **{knob: gain * getattr(old, knob)})
    stiffer = KinematicDesign(stiffness * controller.kinematics.exponent)
    return replace(controller, transformation=stronger, kinematics=stiffer)


def plant_explorer(
    models: Models,
    chosen: Mapping[str, list[Controller]],
    trajectories: list[Trajectory],
    noise: list[Noise],
    settle: float,
    seed: int,
) -> Callable:
    """Explorer: all filters with another gain, stiffness of tracking and noise."""
    found = contraction_along(models, trajectories)
    trajectories = [  # a long record would take too long to redraw
        Trajectory(
            each.sample_time, each.position[:_SHOWN], each.velocity[:_SHOWN], each.acceleration[:_SHOWN]
        )
        for each in trajectories
    ]

    def paint(gain: float, stiffness: float, noise_factor: float):
        """Every local gain times `gain`, every Lambda times `stiffness`, every noise times `noise_factor`."""
        moved = {
            name: [_stronger(each, gain, stiffness) for each in controller]
            for name, controller in chosen.items()
        }
        louder = [replace(each, amplitude=noise_factor * each.amplitude) for each in noise]
        runs = drive(models, moved, trajectories, louder, seed)
        count = len(models.units)
        figure, panels = figures.new(count, 1, height=1.6 + 1.6 * count, squeeze=False)
        for number, (axes, unit) in enumerate(zip(panels[:, 0], models.units, strict=True)):
            for name, each in runs.items():
                run = each[number]
                if run.diverged_at is None:
                    text = f"{1e3 * judge(run, settle)['position']:.3g} m{unit} rms"
                else:
                    text = f"diverges at {run.diverged_at:.2f} s"
                if found.outside(local_gains(moved[name])).any():
                    text += ", outside the contraction range"
                _paint_error(axes, run, color=COLOURS[name], label=f"{name}: {text}")
            axes.set(xlabel="time (s)", ylabel=f"error of {symbol(number, models.units)} (m{unit})")
            axes.margins(y=0.4)  # room for the legend
            axes.legend(loc="upper right")
        return figure

    return paint
