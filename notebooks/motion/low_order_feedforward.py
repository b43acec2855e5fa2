r"""Low-order feedforward for a loop with an observer, the second recommendation of chapter 7.

The force is :math:`\sum_k\Theta_k r^{(k)} + \sum_i F_i(s)\ddot r` with a few filters F of one or two states. Their
poles are picked from those of the observer copy (Appendix A); all gains come from one least-squares problem on the
simulated error, like those of (A.1).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float64

from experiments.motion.designs import DESIGNS, design_controller, stage_compensator
from experiments.motion.machines import published_deviations, published_setpoint, stage
from experiments.motion.pictures import paint_errors
from stillwork.control.feedforward import (
    BASIS,
    Feedforward,
    error_loop,
    fit_feedforward,
    least_squares,
    modified_feedforward,
    noise_error,
    tracking_error,
    tracking_model,
)
from stillwork.control.loops import channel, closed_loop
from stillwork.control.setpoint import Setpoint
from stillwork.lti.simulation import simulate
from stillwork.lti.state_space import StateModel, interconnect
from stillwork.signals.moving_average import rms
from workbook import figures


def direct_loop(loop: StateModel) -> StateModel:
    """Of a single `closed_loop`, the model from (r, u_ff) to e_true: the feedforward that the observer sees."""
    return channel(loop, ("r", "u_ff"), "e_true")


def copy_poles(feedforward: StateModel) -> tuple[complex, ...]:
    """Poles a low-order feedforward may take from an observer copy: stable ones, one of every pair."""
    poles = feedforward.poles
    rate = np.abs(poles).max()
    return tuple(complex(p) for p in poles if p.real < -1e-9 * rate and p.imag >= 0)


def filters(pole: complex) -> list[StateModel]:
    """Filters with this pole (and its conjugate), gain one where they pass: 1 and s over the denominator."""
    w = abs(pole)
    if pole.imag == 0:
        return [StateModel(np.array([[-w]]), np.array([[w]]), np.ones((1, 1)), np.zeros((1, 1)))]
    a, b = np.array([[0, w], [-w, 2 * pole.real]]), np.array([[0.0], [w]])
    return [StateModel(a, b, row[None], np.zeros((1, 1))) for row in np.eye(2)]


@dataclass(frozen=True)
class LowOrder:
    """A feedforward with filters; without any it is (A.1)."""

    gains: Feedforward
    poles: tuple[complex, ...] = ()  # one of every pair, rad/s
    weights: tuple[float, ...] = ()  # kg, one or two a pole: of its `filters`, on the acceleration

    @property
    def order(self) -> int:
        """Number of states."""
        return sum(len(filters(pole)) for pole in self.poles)

    def error(self, loop: StateModel, setpoint: Setpoint) -> Float64[np.ndarray, " samples"]:
        """True tracking error over the move (m); `loop` is a `direct_loop`."""
        return MoveResponses(loop, setpoint).error(self)


class MoveResponses:
    """What a move without feedforward and one unit of every feedforward give: the error is their sum, linear in the gains."""

    def __init__(self, loop: StateModel, setpoint: Setpoint):
        """Prepare a model from (r, force) to e_true, a `direct_loop` or an `error_loop`, and a move."""
        self._loop, self._setpoint = loop, setpoint
        self._filtered: dict[complex, list[np.ndarray]] = {}
        self.alone = tracking_error(loop, setpoint, Feedforward())
        # One model for the four derivatives: its inputs are the force and its own derivatives, in each sample.
        turned = StateModel(loop.a, loop.b[:, ::-1], loop.c, loop.d[:, ::-1])
        forced = tracking_model(turned, Feedforward(), setpoint.sample_time)
        rows = setpoint.derivatives
        self._direct = {  # error that one unit of a derivative causes as a force
            name: simulate(forced, np.vstack([rows[k:], np.zeros_like(rows[:k])]))[0]
            for k, name in enumerate(BASIS, 1)
        }

    def filtered(self, pole: complex) -> list[Float64[np.ndarray, " samples"]]:
        """Errors that the acceleration causes through each of the `filters` of a pole, exactly."""
        if pole not in self._filtered:
            feedback, external = np.zeros((3, 2)), np.zeros((3, 2))
            feedback[1, 1] = external[2, 1] = 1  # the setpoint itself stays out
            wanted, unit = np.array([[1.0, 0.0]]), Feedforward(acceleration=1.0)
            through = (interconnect([self._loop, each], feedback, external, wanted) for each in filters(pole))
            self._filtered[pole] = [tracking_error(each, self._setpoint, unit) for each in through]
        return self._filtered[pole]

    def error(self, feedforward: LowOrder) -> Float64[np.ndarray, " samples"]:
        """True tracking error over the move (m)."""
        gains = [*feedforward.gains.gains, *feedforward.weights]
        return self.alone + np.array(gains) @ self._columns(BASIS, feedforward.poles)

    def fit(self, poles: tuple[complex, ...] = (), basis: tuple[str, ...] = BASIS) -> LowOrder:
        """Gains and weights of the least sum of squared errors over the move, for given poles (one of a pair)."""
        gains = least_squares(self._columns(basis, poles).T, -self.alone)
        direct, weights = gains[: len(basis)], tuple(gains[len(basis) :])
        return LowOrder(Feedforward(**dict(zip(basis, direct, strict=True))), poles, weights)

    def _columns(self, basis, poles) -> Float64[np.ndarray, "gains samples"]:
        direct = [self._direct[name] for name in basis]
        return np.array(direct + [each for pole in poles for each in self.filtered(pole)])


def pick_poles(
    loop: StateModel, setpoint: Setpoint, candidates: Sequence[complex], order: int
) -> list[LowOrder]:
    """Feedforwards of growing order: each takes the one candidate more that lowers the squared error most."""
    responses = MoveResponses(loop, setpoint)
    found = [responses.fit()]
    while True:
        chosen = found[-1].poles
        fitting = [
            responses.fit((*chosen, pole))
            for pole in candidates
            if pole not in chosen and found[-1].order + len(filters(pole)) <= order
        ]
        if not fitting:
            return found
        found.append(min(fitting, key=lambda each: np.sum(responses.error(each) ** 2)))


class Compared(NamedTuple):
    """One redesigned loop of Table 3.7 with the observer copy and the low-order feedforwards; errors in m, rms in the scan."""

    loop: StateModel  # as `closed_loop` gives it
    direct: StateModel  # see `direct_loop`
    found: list[LowOrder]
    points: list[tuple[int, float]]  # of these the states and the error
    copied: tuple[int, float]  # of the copy the states and the error
    alone: float  # what noise alone makes


@cache
def original_gains(sample_time: float, position: int, redesign: str) -> Feedforward:
    """Tuned in the loop without observer, as in the thesis."""
    plant, controller = stage().at([0], [position - 1]), design_controller("PID", redesign).state_space()
    return fit_feedforward(error_loop(closed_loop(plant, None, controller)), published_setpoint(sample_time))


DEFAULTS = (1e-4, 5, "own limit", 8, 1)  # of the notebook, which `compare` takes behind the name


@cache
def compare(
    name: str, sample_time: float, position: int, redesign: str, largest_order: int, seed: int, /
) -> Compared:
    """The design `name` of Table 3.7, measured at a mass; the noise is that of section 3.1."""
    setpoint, window = published_setpoint(sample_time), published_setpoint(sample_time).scanning
    block, controller = (
        stage_compensator(position, DESIGNS[name]),
        design_controller(name, redesign).state_space(),
    )
    loop = closed_loop(stage().at([0], [position - 1]), block, controller)
    direct, copy = direct_loop(loop), modified_feedforward(block, controller)
    found = pick_poles(direct, setpoint, copy_poles(copy), largest_order)
    points = [(each.order, rms(each.error(direct, setpoint)[window])) for each in found]
    copied = tracking_error(error_loop(loop), setpoint, original_gains(sample_time, position, redesign))
    noise = noise_error(loop, sample_time, 22_000, published_deviations(), np.random.default_rng(seed))
    return Compared(loop, direct, found, points, (len(copy.a), rms(copied[window])), rms(noise[0, 2_000:]))


def paint_errors_over_order(designs: Mapping[str, Compared], published: Mapping[str, float]):
    """Rms error in the scan over the number of states of the feedforward, a column a design, with noise above and without below.

    Published is Table 3.7 (nm), with noise.
    """
    figure, axes = figures.new(2, len(designs), height=4.4, sharex="col", sharey="row", squeeze=False)
    for column, (name, each) in zip(axes.T, designs.items(), strict=True):
        states, errors = np.array(each.points).T
        order, copied = each.copied
        for axis, alone in zip(column, (each.alone, 0.0), strict=True):
            axis.semilogy(states, 1e9 * np.hypot(errors, alone), "o-", color=figures.BLUE, label="low order")
            level = [1e9 * np.hypot(copied, alone)] * 2
            axis.semilogy([0, order], level, color=figures.GREY, linewidth=2, label="observer copy")
            axis.annotate(
                f"copy, {order} states",
                (order, level[0]),
                (0, 4),
                textcoords="offset points",
                ha="right",
                fontsize=7,
            )
        figures.mark_published(column[0], order, published[name], "published copy, with noise")
        column[0].xaxis.get_major_locator().set_params(integer=True)
        column[0].set_title(f"{name}, redesigned")
    axes[0, 0].set_ylabel("rms error in the scan,\nwith noise (nm)")
    axes[1, 0].set_ylabel("without noise (nm)")
    figures.label(axes, "states of the feedforward")
    figures.legend_below(axes[0, 0], 3)
    return figure


# === The appendix =================================================================================================


def appendix(
    page,
    *,
    setpoint: Setpoint,
    designs: Mapping[str, Compared],
    published: Mapping[str, float],
    moves: Mapping[str, Setpoint],
    other: pd.DataFrame,
) -> None:
    """What the page of motion/28 judges beside its answer."""
    window, rows = setpoint.scanning, {}
    page.text('## Errors in the scan (nm)\n\n"Rigid body and snap" are two of the four gains of (A.1).')
    for name, each in designs.items():
        responses = MoveResponses(each.direct, setpoint)
        two = responses.error(responses.fit((), ("acceleration", "snap")))
        rows[name] = {
            "published, with noise": published[name],
            "observer copy": 1e9 * each.copied[1],
            "with noise": 1e9 * np.hypot(each.copied[1], each.alone),
            "its states": each.copied[0],
            "rigid body and snap": 1e9 * rms(two[window]),
        }
        for order, error in each.points:
            rows[name]["four gains" if order == 0 else f"and {order} states"] = 1e9 * error
    page.show(pd.DataFrame(rows).round(2))
    for name, each in designs.items():
        picked = ", ".join(f"{abs(pole) / (2 * np.pi):.0f} Hz" for pole in each.found[-1].poles)
        page.show(f"{name}: poles in the order picked at {picked}")
    damped = designs["AD"]
    whole = [round(1e9 * rms(each.error(damped.direct, setpoint)), 1) for each in damped.found[:2]]
    page.show(f"AD, rms over the whole move: {whole[0]} nm with four gains, {whole[1]} nm with two states")
    poor = [designs[name].points[0][1] > designs[name].copied[1] for name in ("MC", "MC and AD")]
    page.check("motion.appendix-a.four-gains-poor", float(np.mean(poor)))
    page.text("""## Other moves (nm)

Moves with shorter and longer snap segments. "0.1 % wrong": all gains of the copy are off by this much, as with a
wrong motor constant.""")
    page.show(other.round(2))
    less = [
        other.loc[f"2 states, {title}"] < other.loc[f"observer copy, {title}"] for title in list(moves)[1:]
    ]
    page.check("motion.section-7-3.two-states-other-moves", float(np.mean(less)))


def over_moves(
    designs: Mapping[str, Compared], moves: Mapping[str, Setpoint], original: Feedforward, largest: int
) -> pd.DataFrame:
    """Rms errors in the scan (nm) of the same gains on several moves, the first being the one they were tuned on."""
    rows, tuned = {}, next(iter(moves.values()))
    wrong = replace(original, **{gain: 1.001 * getattr(original, gain) for gain in BASIS})
    for name, compared in designs.items():
        hidden = error_loop(compared.loop)
        off = rms(tracking_error(hidden, tuned, wrong)[tuned.scanning])
        rows[name] = {"noise alone": compared.alone, "observer copy, 0.1 % wrong": off}
        for title, move in moves.items():
            errors = {"observer copy": tracking_error(hidden, move, original)}
            for each in compared.found:
                if each.order in (2, largest):
                    errors[f"{each.order} states"] = each.error(compared.direct, move)
            rows[name] |= {f"{key}, {title}": rms(error[move.scanning]) for key, error in errors.items()}
    return 1e9 * pd.DataFrame(rows)


def paint_low_order(design: str, states: int, gain: float):
    """Explorer: error over the move for a feedforward of so many states, its filters' gains scaled by `gain` %."""
    compared, setpoint = compare(design, *DEFAULTS), published_setpoint(DEFAULTS[0])
    chosen = [each for each in compared.found if each.order <= states][-1]
    chosen = replace(chosen, weights=tuple(gain / 100 * w for w in chosen.weights))
    error = chosen.error(compared.direct, setpoint)
    size = 1e9 * rms(error[setpoint.scanning])
    title = f"{chosen.order} states: {size:.2f} nm rms in the scan (grey)"
    return paint_errors(setpoint, {"error": error}, title)
