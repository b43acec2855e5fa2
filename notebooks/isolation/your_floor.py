"""Your floor: the paper's rig as the command `isolate` takes it, and the pictures of the answer."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from experiments.isolation.recorded_floors import ground_spectrum
from experiments.isolation.twin import Twin
from stillwork.base.checks import InputError, require_number
from stillwork.estimation.adaptive import FeLms, FeRls
from stillwork.estimation.mean_adaptation import mean_adaptation
from stillwork.machine.isolate import (
    SLOWEST_HZ,
    at_sensors,
    facts_of,
    findings,
    paint_transmissibility,
    read_floor,
)
from stillwork.machine.isolation import FloorSpectra, Isolator
from stillwork.machine.isolation_design import (
    IsolationDesign,
    binned,
    design_isolation,
    motion_density,
)
from stillwork.machine.isolation_prediction import IsolationPrediction, predict
from stillwork.signals.criteria import criterion_met, criterion_velocity, one_third_octave_velocity
from workbook import figures, paths

COLOURS = {
    "floor": figures.RED,
    "passive": figures.PURPLE,
    "feedback": figures.BLUE,
    "FeRLS": figures.BLACK,
}


def isolator_of(twin: Twin) -> Isolator:
    """The mechanics of a twin along its actuators, x = J^-1 q, as `isolate` takes them; the command is one sample late."""
    plant, instruments = twin.plant, twin.instruments
    jacobian = plant.actuation.T
    if jacobian.shape[0] != jacobian.shape[1] or not np.allclose(plant.observation, jacobian):
        raise InputError(
            f"{twin.name}: give as many actuators as coordinates, each with a platform sensor along it, or the TOML of "
            "the command isolate"
        )
    back = np.linalg.inv(jacobian)
    matrices = (back.T @ each @ back for each in (plant.mass, plant.damping, plant.stiffness))
    mass, damping, stiffness = ((each + each.T) / 2 for each in matrices)
    return Isolator(
        mass, damping, stiffness, np.linalg.solve(stiffness, back.T @ plant.floor_stiffness),
        2 * np.pi * instruments.actuator_pole_hz, instruments.sample_time, instruments.floor_noise,
        instruments.platform_noise,
    )  # fmt: skip


def open_floor(
    file: str,
    unit: str,
    record_hz: float,
    channels: list[str],
    twin: Twin,
    *,
    gain: float,
    common: float,
    duration_s: float,
) -> tuple[FloorSpectra, list[str]]:
    """The floor of a file as `isolate` reads it, or the measured ground, with what is assumed or odd.

    Of spectra and of the ground, `gain` is the amplitude relative to them, `common` the share of their power that all
    sensors see alike, `duration_s` the time for which the answer holds.
    """
    rate = twin.instruments.sample_rate
    require_number("ground_s", duration_s, above=0.0)
    require_number("ground_gain", gain, above=0.0)
    require_number("ground_common", common, at_least=0.0, at_most=1.0)
    if file:
        floor, notes, seen = read_floor(file, unit, twin.sensors, rate, channels, record_hz)
        if floor.record is not None:
            return floor, [*notes, *seen]
    else:
        ground, notes, seen = ground_spectrum(), [], []
        lines = np.arange(SLOWEST_HZ, ground.frequencies_hz[-1], SLOWEST_HZ)
        density = ground.density(lines)[0].astype(complex)[:, None, None]
        floor = binned(lines, density, duration_s, ground.source)
    floor = at_sensors(floor, twin.sensors, notes)
    notes = [each for each in notes if "independent" not in each]  # they share a part
    sizes = gain * np.sqrt(np.einsum("fii->fi", floor.density).real)
    shares = common + (1 - common) * np.eye(twin.sensors)
    density = sizes[:, :, None] * sizes[:, None] * shares
    return replace(floor, density=density.astype(complex), duration=duration_s), [*notes, *seen]


@dataclass(frozen=True)
class Answer:
    """The design of `isolate` for a rig on a floor, and its prediction."""

    floor: FloorSpectra
    design: IsolationDesign
    around: list[IsolationDesign]
    found: IsolationPrediction

    def in_short(self) -> str:
        """What was chosen, in a sentence."""
        loop, algorithm = self.design.loop, {FeRls: "FeRLS", FeLms: "FeLMS"}[type(self.design.settings)]
        return (
            f"We take a skyhook gain of {loop.gain:.3g} N s/m on each axis, weak integrators with a cut-off of {loop.cutoff_hz:g} Hz, and "
            f"{algorithm} with a time constant of {float(f'{self.design.time_constant:.2g}'):g} s; the appendix has all that the command prints."
        )

    def lines(self) -> list[str]:
        """As the command prints them."""
        facts = (": ".join(row) for row in facts_of(self.design, self.found, self.floor))
        return [*facts, *findings(self.design, self.around, self.found, self.floor)]


def isolate(twin: Twin, floor: FloorSpectra, seed: int) -> Answer:
    """Design a feedforward for a rig on a floor, and predict it.

    A sensor without a channel of its own reads the mean of the others; a single channel is that of each sensor.
    """
    isolator = isolator_of(twin)
    if floor.density.shape[1] == 1:
        floor = at_sensors(floor, twin.sensors, [])
    channels = floor.density.shape[1]
    missing = twin.sensors - channels
    spread = np.vstack([np.eye(channels), np.full((missing, channels), 1 / channels)])
    isolator = replace(isolator, floor=isolator.floor @ spread)
    design, around = design_isolation(isolator, floor, twin.instruments.sample_rate, seed=seed)
    return Answer(floor, design, around, predict(design, around, floor, seed=seed))


def described(floor: FloorSpectra, notes: list[str]) -> Iterator[str]:
    """What a floor is, sentence by sentence."""
    rows = np.einsum("fii->if", floor.density).real
    sensors = "1 floor sensor" if len(rows) == 1 else f"{len(rows)} floor sensors"
    yield f"{floor.source}: {sensors}, {floor.duration:.0f} s."
    rms = ", ".join(f"{1e3 * each:.3g}" for each in np.sqrt(rows @ floor.widths_hz))
    yield f"Rms acceleration {rms} mm/s²."
    met = ", ".join(criterion_met(*one_third_octave_velocity(floor.frequencies_hz, row)) for row in rows)
    yield f"Finest criterion met at 8-80 Hz, by sensor: {met}."
    yield from notes


def densities(
    own: Answer, floor: FloorSpectra, platform_noise: float
) -> dict[str, Float64[np.ndarray, "axes f"]]:
    """Densities along the actuators of the feet and of the platform, by case, with the weights that this floor teaches."""
    paths, noises = own.design.paths, (own.design.isolator.floor_noise, platform_noise)
    weights = mean_adaptation(paths.seen, floor.widths_hz, floor.density, *noises, 0.0).weights
    bare, silent = replace(paths, skyhook=0 * paths.skyhook), np.zeros_like(weights)
    feet = own.design.isolator.floor
    return {
        "floor": np.einsum("as,fst,at->af", feet, floor.density, feet).real,
        "passive": motion_density(bare, silent, floor, noises),
        "feedback": motion_density(paths, silent, floor, noises),
        "FeRLS": motion_density(paths, weights, floor, noises),
    }


def residuals(own: Answer, gains: np.ndarray) -> dict[str, Float64[np.ndarray, " gains"]]:
    """Rms of all axes in the judged band over that of the feet, for a louder or quieter floor."""
    f = own.floor.frequencies_hz
    widths = own.floor.widths_hz * ((f >= own.found.band_hz[0]) & (f <= own.found.band_hz[1]))
    rows = []
    for gain in gains:
        louder = replace(own.floor, density=gain**2 * own.floor.density)
        found = densities(own, louder, own.design.isolator.platform_noise)
        rows.append([np.sqrt((each @ widths).sum()) for each in found.values()])
    whole = np.array(rows)
    return dict(zip(("passive", "feedback", "FeRLS"), (whole[:, 1:] / whole[:, :1]).T, strict=True))


def crossing(gains: np.ndarray, left: dict[str, np.ndarray]) -> str:
    """How loud the floor must be for this loop to leave less motion than the passive rig."""
    gain = _pays_from(gains, left["FeRLS"] / left["passive"])
    if gain == 0.0:
        return (
            f"The loop leaves less motion than the passive rig even on a floor {gains[0]:.2g} times as loud."
        )
    if gain == np.inf:
        return (
            f"The loop leaves more motion than the passive rig even on a floor {gains[-1]:.2g} times as loud."
        )
    return (
        f"The loop leaves less motion than the passive rig from {gain:.2g} times this floor's amplitude on."
    )


WORTH = 0.9  # what a feedforward that pays leaves at most of the skyhook loop's motion, chosen


def feedforward(gains: np.ndarray, left: dict[str, np.ndarray]) -> tuple[str, str]:
    """Whether the feedforward pays on this floor beside the skyhook loop alone; and from how loud a one."""
    ratio = left["FeRLS"] / left["feedback"]
    here, gain = _here(gains, ratio), _pays_from(gains, ratio / WORTH)
    pays = "pays" if here < WORTH else "does not pay"
    off = f"The feedforward leaves at most {WORTH:g} of the skyhook loop's motion"
    ends = {
        0.0: f"{off} on any floor tried.",
        np.inf: f"{off} on no floor up to {gains[-1]:.2g} times as loud.",
    }
    where = ends.get(gain, f"{off} from {gain:.2g} times this floor's amplitude on.")
    return f"The feedforward {pays}: it leaves {here:.2f} of the skyhook loop's motion.", where


def decision(gains: np.ndarray, left: dict[str, np.ndarray]) -> str:
    """What to do on this floor."""
    passive, loops = (_here(gains, left[name] / left["passive"]) for name in ("feedback", "FeRLS"))
    if loops < min(1.0, WORTH * passive):
        which = "the feedforward alone" if np.allclose(left["feedback"], left["passive"]) else "both loops"
        return f"Build {which} on this floor."
    if passive < 1:
        return "Build the skyhook loop alone on this floor."
    gain = _pays_from(gains, left["FeRLS"] / left["passive"])
    quieter = f", or take sensors {gain:.2g} times as quiet" if np.isfinite(gain) else ""
    return f"Leave this isolator passive on this floor{quieter}."


def _here(gains: np.ndarray, ratio: np.ndarray) -> float:
    """A ratio on this floor."""
    return float(np.interp(0.0, np.log(gains), ratio))


def _pays_from(gains: np.ndarray, ratio: np.ndarray) -> float:
    """The gain from which on a ratio stays below 1: 0 where it does at all, infinite where not at the last."""
    pays = ratio < 1
    if pays.all():
        return 0.0
    if not pays[-1]:
        return np.inf
    at = 1 + int(np.flatnonzero(~pays)[-1])
    log = -np.log(ratio[at - 1 : at + 1])
    return float(np.exp(np.interp(0.0, log, np.log(gains[at - 1 : at + 1]))))


def paint_floor(floor: FloorSpectra):
    """Density of each sensor's acceleration, and its one-third-octave velocity against the criteria."""
    figure, (left, right) = figures.new(1, 2, height=3.4)
    f = floor.frequencies_hz
    rows = np.einsum("fii->if", floor.density).real
    alike = np.allclose(rows, rows[0], rtol=1e-6, atol=0.0)
    for number, row in enumerate(rows[:1] if alike else rows, 1):
        left.loglog(f, np.sqrt(row), lw=0.8, label="each sensor" if alike else f"sensor {number}")
        centres, velocity = one_third_octave_velocity(f, row)
        shown = (centres >= 1.0) & (centres <= 400.0) & (velocity > 1e-4 * velocity.max())
        right.loglog(centres[shown], velocity[shown], "o-", ms=2.5, lw=0.8, label=f"_sensor {number}")
    low, high = right.get_ylim()
    _criteria(right)
    left.set(xlabel="frequency (Hz)", ylabel="floor acceleration (m/s²/√Hz)")
    left.legend()
    right.set(xlabel="one-third-octave band (Hz)", ylabel="rms velocity (m/s)")
    right.set(xlim=(0.3, 600), ylim=(low / 2.5, high * 3))
    return figure


def paint_gain(gains: np.ndarray, left: dict[str, np.ndarray]):
    """Rms motion over that of the feet, for a louder or quieter floor."""
    figure, axes = figures.new(1, 1, height=2.8)
    # FeRLS lies on the feedback where noise dominates.
    looks = (
        (1.5, 0, 1.4, "passive"),
        (3.5, -3, 0.4, "feedback alone"),
        (1.5, -3, 1.6, "  feedback and FeRLS"),
    )
    for (name, values), (width, place, above, word) in zip(left.items(), looks, strict=True):
        axes.loglog(gains, values, color=COLOURS[name], lw=width, label=name)
        axes.text(gains[place], above * values[place], word, color=COLOURS[name])
    axes.axhline(1, color=figures.GREY, lw=0.8)
    axes.axvline(1, color=figures.GREY, lw=0.8, ls="--")
    axes.text(1.1, left["feedback"][0], "this floor", color=figures.GREY, va="top")
    axes.set(xlabel="amplitude over this floor's", ylabel="platform over feet, rms")
    return figure


def explore_floor(own: Answer):
    """Explorer: one-third-octave velocity along the first actuator, on a louder floor and with other sensors."""

    def paint(gain: float, output_noise: float):
        louder = replace(own.floor, density=gain**2 * own.floor.density)
        figure, axes = figures.new(1, 1, height=3.2)
        for name, density in densities(own, louder, output_noise * 1e-4).items():
            centres, velocity = one_third_octave_velocity(own.floor.frequencies_hz, density[0])
            shown = centres > 0.9
            axes.loglog(
                centres[shown], velocity[shown], "o-", ms=2.5, lw=0.9, color=COLOURS[name], label=name
            )
        _criteria(axes)
        axes.set(xlabel="one-third-octave band (Hz)", ylabel="rms velocity along actuator 1 (m/s)")
        axes.set_ylim(bottom=1e-9)
        axes.legend(loc="upper left", ncols=4)
        return figure

    return paint


def _criteria(axes) -> None:
    bands = 2.0 ** (np.arange(0, 20) / 3)
    for name in ("VC-A", "VC-C", "VC-E", "VC-G", "VC-I", "VC-K", "VC-M"):
        defined = bands[bands > 3.9] if name == "VC-A" else bands
        limit = criterion_velocity(name, defined)
        axes.loglog(defined, limit, "--", color=figures.GREY, lw=0.7, label=f"_{name}")
        style = {"color": figures.GREY, "fontsize": 7, "ha": "right", "va": "center", "annotation_clip": True}
        axes.annotate(name, (defined[0] / 1.1, limit[0]), **style)


# === Appendix =====================================================================================================


def appendix(
    page, *, own: Answer, twin: Twin, settings: dict, gains: np.ndarray, shipped: bool, seed: int
) -> None:
    """The design in full, and the shipped record the same way.

    Parameters
    ----------
    page : workbook.appendix.Appendix
    own : Answer
        On the page's floor.
    twin : Twin
    settings : dict
        Of `open_floor`.
    gains : array
        How loud.
    shipped : bool
        Not beside a reader's own floor.
    seed : int
    """
    page.text("""## The design in full

All that is called highest holds over a time as long as the record.""")
    page.show(*own.lines())
    if not shipped:
        page.text("The shipped record of a slab stands here beside the shipped ground alone.")
        return
    page.text("""## A record, the same way

Thirty seconds of a concrete slab under walking and jumping, by a smartphone at 425 Hz (`data/isolation/slab_footfall`), valid
from 5 to 150 Hz.""")
    file = paths.data("isolation", "slab_footfall/slab_vertical.csv")
    floor, notes = open_floor(str(file), "m/s^2", 0.0, [], twin, **settings)
    slab = isolate(twin, floor, seed)
    page.save("slab", paint_floor(floor))
    page.save("slab-transmissibility", paint_transmissibility(slab.design, slab.found))
    page.show(*described(floor, notes), *slab.lines(), crossing(gains, residuals(slab, gains)))
