"""The loops of decoupled axes on the measured matrix: what is checked of all of them at once, and their pictures."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from stillwork.base.checks import InputError, require_array
from stillwork.base.toml_files import Table
from stillwork.control.bandwidth import SIX_DB
from stillwork.control.pid import Pid
from stillwork.identification.matrix_files import MatrixFile
from stillwork.machine import pictures
from stillwork.machine.axes_modes import MatrixModes, fit_matrix
from stillwork.machine.decoupled import Axes, Judged, interaction, judge, own_sensitivities
from stillwork.machine.designed_loop import DesignedLoop, load_design

FORMAT = "stillwork axes 1"
LOWEST = 10  # lines
PARTS, MANY = (
    (-1.0, -0.5, 0.5, 1.0),
    48,
)  # of its share, to which each mode is moved; places of all modes at once
UNCOUNTED = "the lines are too far apart, or end too early, to count turns"
MOST_SIGNS = 64  # of gains of the actuators, that are tried


class Place(NamedTuple):
    """A place of the box: how far all modes move together, the gain of each actuator, and factors on single modes' frequencies."""

    move: float
    gain: np.ndarray
    modes: np.ndarray | None = None


class AxesLoops(NamedTuple):
    """Controllers that were written, one an axis, around a measured matrix."""

    matrix: MatrixFile
    axes: Axes
    names: tuple[str, ...]
    loops: list[DesignedLoop]
    rate: float  # Hz
    delay: float  # samples
    band_hz: tuple[float, float]  # where the matrix is the plant
    shares: Mapping[str, float]  # of the box
    modes: MatrixModes | None = None

    @classmethod
    def read(cls, file: Path, about: Table, matrix: MatrixFile, loop_hz: tuple[float, float]) -> "AxesLoops":
        """Those of an ``axes.json`` around another matrix."""
        sensing, actuation = (require_array(name, about[name], ndim=2) for name in ("sensing", "actuation"))
        shape, wanted = (len(matrix.outputs), len(matrix.inputs)), (sensing.shape[1], len(actuation))
        if shape != wanted:
            raise InputError(
                f"{matrix.source} holds {shape[0]} outputs over {shape[1]} inputs, {file.name} is of {wanted[0]} over "
                f"{wanted[1]}; give all responses of the design"
            )
        if matrix.units != (units := tuple(about["units"])):
            raise InputError(
                f"{matrix.source} is in {' over '.join(matrix.units)}, {file.name} in {' over '.join(units)}; give the response in "
                "the units of the design"
            )
        matrix = matrix.ordered(tuple(about["outputs"]), tuple(about["inputs"]))
        loops = [load_design(str(file.parent / each["controller"])) for each in about["axes"]]
        names = tuple(each["name"] for each in about["axes"])
        low, high = loop_hz if any(loop_hz) else about["band_hz"]
        band = max(low, matrix.hertz[0]), min(high, matrix.hertz[-1])
        axes = Axes(sensing, actuation, about["decoupling"])
        return cls(matrix, axes, names, loops, about["rate_hz"], about["delay_samples"], band, {})

    def places(self) -> list[Place]:
        """Of the box, the middle first: all modes moved together, then each by itself, and some of many at once."""
        inputs, shares = len(self.matrix.inputs), self.shares
        moves = dict.fromkeys((0.0, shares.get("frequency", 0.0), -shares.get("frequency", 0.0)))
        gain = shares.get("gain", 0.0) + shares.get("mass", 0.0)
        signs = np.array(list(product((1.0, -1.0), repeat=inputs)))
        if len(signs) > MOST_SIGNS:  # all alike, and some of the others
            some = np.random.default_rng(0).choice(
                np.arange(1, len(signs) - 1), MOST_SIGNS - 2, replace=False
            )
            signs = signs[[0, *some, -1]]
        signs = signs if gain else np.zeros((1, inputs))
        together = [Place(move, 1 + gain * sign) for move, sign in product(moves, signs)]
        return [Place(0.0, np.ones(inputs)), *together, *self._of_single_modes(gain)]

    def _of_single_modes(self, gain: float) -> list[Place]:
        """Each mode moved by itself in all entries, all gains high or low; then all modes and gains at random ends."""
        share, inputs = self.shares.get("frequency", 0.0), len(self.matrix.inputs)
        if self.modes is None or not share:
            return []
        count, rng = len(self.modes.frequencies), np.random.default_rng(1)
        signs = [part * row for row in np.eye(count) for part in PARTS]
        gains = [np.full(inputs, 1 + gain), np.full(inputs, 1 - gain)]
        single = [Place(0.0, each, 1 + share * sign) for sign in signs for each in gains]
        ends = rng.choice([-1.0, 1.0], (MANY, count + inputs))
        return single + [Place(0.0, 1 + gain * row[count:], 1 + share * row[:count]) for row in ends]

    def gains(self, places, slower: np.ndarray | None = None) -> list[np.ndarray]:
        """Loop gains at places of the box; with `slower`, of PID controllers at these shares of their bandwidths."""
        return [
            (self.plant(place.move, place.gain) + self._moved(place))
            * self._controllers(place.move, slower)[:, None, :]
            for place in places
        ]

    def _moved(self, place: Place) -> np.ndarray | float:
        """What single modes that have moved add to the plant; the gains of the actuators as the axes share them."""
        if place.modes is None or self.modes is None:
            return 0.0
        omega = self.lines()
        parts = self.parts()
        own = (parts / parts.sum(axis=1, keepdims=True)).real @ place.gain
        late = _late(omega / self.rate, self.delay) / omega**2
        return -self.modes.moved(omega, place.modes) * late[:, None, None] * own

    def alone(self, places, slower: np.ndarray | None = None) -> list[np.ndarray]:
        """1 + L of the model of each axis at the measured lines and at places of the box, each (lines, axes)."""
        found, parts = [], self.parts()
        own = (parts / parts.sum(axis=1, keepdims=True)).real
        for move, gain, modes in places:
            omega, held = self.lines(move), []
            for each in self.loops:
                plant = each.loop.plant
                if modes is not None and self.modes is not None:
                    plant = self.modes.own(plant, modes)
                model = plant.frequency_response(omega / (1 + move))[0, 0] / (1 + move) ** 2
                late = _late(omega / self.rate, each.made["delay_samples_of_the_loop"])
                held.append(model * late + _aliases(each, omega))
            found.append(1 + np.stack(held, axis=1) * self._controllers(move, slower) * (own @ gain))
        return found

    def with_modes(self) -> "AxesLoops":
        """The same with the modes of the matrix, which its entries have in common."""
        omega = self.lines()
        late = np.mean([each.made["delay_samples_of_the_loop"] for each in self.loops]) - self.delay
        models = [each.loop.plant for each in self.loops]
        inner = self.axes.of(self._seen(len(omega)))
        return self._replace(modes=fit_matrix(omega, inner, models, float(late / self.rate)))

    def parts(self) -> np.ndarray:
        """Of what each axis does to itself at the lowest lines, the part of each actuator: (axes, inputs)."""
        low = self._seen(LOWEST).mean(axis=0)
        return (self.axes.sensing @ low) * self.axes.actuation.T

    def _seen(self, count: int) -> np.ndarray:
        """The matrix at the first lines of the band."""
        first = np.searchsorted(self.matrix.hertz, self.band_hz[0])
        return self.matrix.accelerance[first : first + count]

    def judge(self, places, slower: np.ndarray | None = None) -> Judged:
        """All loops at places of the box, the middle first; with `slower` as of `gains`."""
        return judge(self.gains(places, slower), self.alone(places, slower))

    def lines(self, move: float = 0.0) -> np.ndarray:
        """Frequencies of the measured lines, rad/s, where all modes have moved by a share."""
        hertz = self.matrix.hertz
        inside = (hertz >= self.band_hz[0]) & (hertz * (1 + abs(move)) <= self.band_hz[1])
        return 2 * np.pi * hertz[inside] * (1 + move)

    def plant(self, move: float = 0.0, gain: np.ndarray | float = 1.0, inner: bool = True) -> np.ndarray:
        """Sampled response from the axes' forces to their positions; not `inner`: from the actuators to the sensors.

        Aliases are taken from the model of each axis, and so off the diagonal there are none.
        """
        omega = self.lines(move)
        late = _late(omega / self.rate, self.delay) / omega**2
        seen = -self._seen(len(omega)) * late[:, None, None] * gain
        if not inner:
            return seen
        position = self.axes.of(seen)
        for k, each in enumerate(self.loops):
            position[:, k, k] += _aliases(each, omega)
        return position

    def _controllers(self, move: float, slower: np.ndarray | None) -> np.ndarray:
        """From the error to the force of each axis, (lines, axes)."""
        omega = self.lines(move)
        if slower is None:
            return np.stack([each.response(omega) for each in self.loops], axis=1)
        pairs = zip(self.loops, slower, strict=True)
        return np.stack([e.loop.at(_slower(e.pid, s), omega).output_controller for e, s in pairs], axis=1)

    def judged(self) -> Judged:
        """All that is checked, with what was written."""
        return self.judge(self.places())

    def sensitivities(self) -> dict[str, np.ndarray]:
        """S_O at the sensors and S_I at the actuators, (lines, n, n)."""
        plant = self.plant(inner=False)
        whole = self.axes.actuation @ (self._controllers(0.0, None)[:, :, None] * self.axes.sensing)
        loops = {"S_O": plant @ whole, "S_I": whole @ plant}
        return {name: np.linalg.inv(np.eye(each.shape[1]) + each) for name, each in loops.items()}

    def crossed(self, places) -> np.ndarray:
        """Largest |S_jk| at places of the box: the error of axis j over the setpoint of axis k, all axes closed."""
        one = np.eye(len(self.loops))
        return np.max([np.abs(np.linalg.inv(one + gain)).max(axis=0) for gain in self.gains(places)], axis=0)

    def stability(self, judged: Judged) -> str:
        """In words."""
        if judged.stable:
            return "stable, whichever axes are open"
        if not judged.counted:
            return UNCOUNTED
        sets = "; ".join(" and ".join(self.names[k] for k in each) for each in judged.unstable[:3])
        return f"unstable with {sets} closed"


def _late(turn: np.ndarray, delay: float) -> np.ndarray:
    """The hold, and a delay in samples, at angles a sample."""
    return -np.expm1(-1j * turn) / (1j * turn) * np.exp(-1j * turn * delay)


def _aliases(designed: DesignedLoop, omega: np.ndarray) -> np.ndarray:
    """What sampling adds to the response of an axis's model."""
    return designed.loop.plant_at(omega) - designed.loop.plant_at(omega, held=False)


def _slower(pid: Pid, share: float) -> Pid:
    rates = {name: share * getattr(pid, name) for name in ("integrator", "differentiator", "low_pass")}
    return replace(pid, gain=share**2 * pid.gain, **rates)


def sizes(found: np.ndarray) -> str:
    """dB in words."""
    return " and ".join(f"{each:.2f}" for each in found)


@pictures.house_style()
def paint_decoupling(closed: AxesLoops):
    """All entries of the accelerance, and of that of the axes; below what stands beside the diagonal."""
    matrix = closed.matrix
    figure, panels = pictures.new(1, 3, height=2.8)
    shown = {"measured": matrix.accelerance, "decoupled": closed.axes.of(matrix.accelerance)}
    for panel, (title, response) in zip(panels, shown.items(), strict=False):
        for row, column in np.ndindex(response.shape[1:]):
            own = (
                {"linewidth": 1.0, "label": f"{row + 1},{row + 1}"}
                if row == column
                else {"color": pictures.GREY, "linewidth": 0.5}
            )
            panel.loglog(matrix.hertz, np.abs(response[:, row, column]), zorder=2 + (row == column), **own)
        panel.set(title=f"{title} (grey: off-diagonal)", xlabel="frequency (Hz)")
        if response.shape[1] == response.shape[2]:
            panels[2].loglog(
                matrix.hertz, np.maximum(interaction(response), 1e-9), linewidth=0.9, label=title
            )
    panels[0].set_ylabel("acceleration over force")
    panels[2].set(title="beside the diagonal", xlabel="frequency (Hz)")
    panels[2].legend()
    return figure


@pictures.house_style()
def paint_axes(closed: AxesLoops):
    """Singular values of S_O and S_I, and the sensitivity of each axis: alone, and with all axes closed."""
    hertz = closed.lines() / (2 * np.pi)
    whole = np.eye(len(closed.loops)) + closed.gains(closed.places()[:1])[0]
    figure, (left, right) = pictures.new(1, 2, height=2.8, sharey=True)
    for name, response in closed.sensitivities().items():
        size = np.linalg.norm(response, 2, axis=(1, 2))
        left.semilogx(hertz, 20 * np.log10(size), linewidth=0.9, label=name)
    together = np.abs(own_sensitivities(whole))
    alone = np.abs(1 / np.einsum("fii->fi", whole))
    for k, name in enumerate(closed.names):
        (line,) = right.semilogx(
            hertz, 20 * np.log10(together[:, k]), linewidth=0.9, label=pictures.literal(name)
        )
        right.semilogx(
            hertz, 20 * np.log10(alone[:, k]), linewidth=0.7, linestyle="--", color=line.get_color()
        )
    for panel, title in ((left, "largest singular value (dB)"), (right, "|S_kk|; dashed: the axis alone")):
        panel.axhline(20 * np.log10(SIX_DB), color=pictures.BLACK, linestyle=":", linewidth=1.0)
        panel.set(title=title, xlabel="frequency (Hz)", ylim=(-50, 15))
        panel.legend()
    return figure
