"""The record track: a measured beam, where the truth is a laser that no observer sees.

``python -m contest.record`` makes ``data/motion/contest_record.csv``. The tip of a beam is pushed by hand and released,
three times; an observer is given the actuator's voltage and one or two other sensors, and estimates the deflection that
the laser measured. The model, the noises and the settings are fitted to one release, two others judge.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import pandas as pd
from jaxtyping import Float64
from scipy.optimize import least_squares

from contest.nominal import NominalModel, NominalNoise, TuningParameter
from contest.scores import ENTRANTS, observer_of
from contest.tuning import WORST, positions
from stillwork.base.checks import InputError
from stillwork.lti.discretisation import zoh_modes
from stillwork.lti.modal import ModalModel
from workbook import paths

RECORD = paths.data("motion", "piezo_beam/three_sensors.npz")
FILE = paths.data("motion", "contest_record.csv")
RELEASES = (823, 1693, 2540)  # samples at which the beam leaves the hand: the steepest of the laser
BEFORE, AFTER, FITTED = (
    200,
    400,
    150,
)  # samples of a run about its release; of the ringing that the model is fitted to
FIRST_FITTED = 12  # samples after the release: the hand has left
CLIPPED = 14.9  # mm, beyond which the laser measures nothing
TASKS = {"both sensors": ("capacitive_v", "piezo_v"), "piezo alone": ("piezo_v",)}
PARTS = {"pushed": slice(0, BEFORE), "ringing": slice(BEFORE, None)}
LAGS = 25  # samples of each signal in the linear filters
LINEAR = ("linear, trained", "linear, oracle")  # fitted to the training release; to what is judged
# Ours whose design takes a sensor of any kind: those of the model's derivatives are made for positions.
POSITIONS_ALONE = ("regularised least squares", "sensitivity penalised")
COLUMNS = ["task", "part", "trained", "judged", "entrant", "error"]
RUNNING = tuple(name for name in ENTRANTS if name not in POSITIONS_ALONE)


@dataclass(frozen=True)
class Run:
    """One release as it was measured, without the sensors' rest."""

    voltage: Float64[np.ndarray, " samples"]  # held until the sample
    measured: Float64[np.ndarray, "samples outputs"]
    laser: Float64[np.ndarray, " samples"]  # mm

    @property
    def judged(self) -> np.ndarray:
        """Samples at which the laser is within its range."""
        return np.abs(self.laser) < CLIPPED


@cache
def run_of(task: str, release: int) -> Run:
    """The run about a release, from 0; offsets are the means of the first two seconds, when the beam hangs still."""
    record = np.load(RECORD)
    at = RELEASES[release]
    part, still = slice(at - BEFORE, at + AFTER), slice(100, 300)
    signals = [record[name].astype(float) for name in (*TASKS[task], "laser_mm")]
    *measured, laser = (signal[part] - signal[still].mean() for signal in signals)
    voltage = record["voltage_v"].astype(float)[at - BEFORE - 1 : at + AFTER - 1]
    return Run(voltage, np.stack(measured, axis=1), laser)


def one_mode(omega: float, damping: float, push: float) -> ModalModel:
    """The beam's first mode in millimetres of the tip: its acceleration a volt is `push`."""
    return ModalModel(np.array([omega]), np.array([damping]), np.array([[push]]), np.eye(1), np.zeros((1, 1)))


def free_states(a: np.ndarray, b: np.ndarray, start: np.ndarray, voltage: np.ndarray) -> np.ndarray:
    """States from `start` on, under voltages that are held until each sample."""
    states = np.empty((len(voltage), len(a)))
    states[0] = start
    for k in range(1, len(states)):
        states[k] = a @ states[k - 1] + b[:, 0] * voltage[k]
    return states


@cache
def fitted(task: str, release: int) -> tuple[NominalModel, NominalNoise, float]:
    """What observers are given: one mode fitted to the ringing of a release, rows of sensors, and noises.

    The noise of a sensor is what its row leaves; that of the force is the most likely one over the whole run.
    """
    run, step = run_of(task, release), float(np.load(RECORD)["sample_time_s"])
    ringing = slice(BEFORE + FIRST_FITTED, BEFORE + FIRST_FITTED + FITTED)
    laser, voltage = run.laser[ringing], run.voltage[ringing]

    def states(values: np.ndarray) -> np.ndarray:
        model = zoh_modes(one_mode(values[0], values[1], values[2]), step)
        return free_states(model.a, model.b, values[3:], voltage)

    found = least_squares(
        lambda values: states(values)[:, 0] - laser,
        [2 * np.pi * 8.2, 0.01, -1.0, laser[0], np.gradient(laser)[0] / step],
        x_scale=[1.0, 0.01, 1.0, 1.0, 50.0],
    ).x
    rows, *_ = np.linalg.lstsq(states(found), run.measured[ringing], rcond=None)
    left = run.measured[ringing] - states(found) @ rows
    sensor = np.diag((left**2).mean(axis=0))
    mode = one_mode(*found[:3])
    sampled = zoh_modes(mode, step)
    known = mode.frequencies, mode.damping, mode.input_shapes, rows[:1].T
    model = NominalModel(sampled.a, sampled.b, np.ascontiguousarray(rows.T), *known)
    forces = np.geomspace(1e-1, 1e4, 26)
    likely = [_likelihood(model, NominalNoise(np.array([[q * q]]), sensor), run) for q in forces]
    best = forces[int(np.argmax(likely))]
    return model, NominalNoise(np.array([[best * best]]), sensor), step


def _likelihood(model: NominalModel, noise: NominalNoise, run: Run) -> float:
    """Logarithm of the density of a run's measurements under a Kalman filter, less a constant."""
    a, b, c = model.a, model.b, model.c
    x, p, total = np.zeros(len(a)), np.eye(len(a)), 0.0
    for u, y in zip(run.voltage, run.measured, strict=True):
        x, p = a @ x + b[:, 0] * u, a @ p @ a.T + b @ noise.process @ b.T
        spread = c @ p @ c.T + noise.sensor
        gain, innovation = np.linalg.solve(spread, c @ p).T, y - c @ x
        total -= innovation @ np.linalg.solve(spread, innovation) + np.linalg.slogdet(spread)[1]
        x, p = x + gain @ innovation, p - gain @ c @ p
    return total / 2


def errors_of(run: Run, estimate: np.ndarray) -> dict[str, float]:
    """Root mean square error over that of the estimate zero, of each part and of the whole."""
    found = {}
    for part, some in {**PARTS, "whole": slice(None)}.items():
        judged = run.judged[some]
        truth, error = run.laser[some][judged], (run.laser - estimate)[some][judged]
        ratio = np.sqrt(np.mean(error**2) / np.mean(truth**2))
        found[part] = float(ratio) if np.isfinite(ratio) else np.inf
    return found


def regressors(run: Run) -> np.ndarray:
    """The last `LAGS` samples of every signal, this one among them, and a constant."""
    signals = np.column_stack([run.voltage, run.measured])
    padded = np.vstack([np.zeros((LAGS - 1, signals.shape[1])), signals])
    late = [padded[LAGS - 1 - k : len(padded) - k] for k in range(LAGS)]
    return np.column_stack([*late, np.ones(len(signals))])


def linear_estimate(run: Run, fitted_to: Run) -> np.ndarray:
    """The causal linear filter with the least squared error on `fitted_to`, applied to `run`."""
    kept = fitted_to.judged
    weights, *_ = np.linalg.lstsq(regressors(fitted_to)[kept], fitted_to.laser[kept], rcond=None)
    return regressors(run) @ weights


def estimate(name: str, file: str | None, settings: tuple[float, ...], given: tuple, run: Run) -> np.ndarray:
    """Deflections that an observer with these settings estimates, one of ours or the one of a file."""
    observer = observer_of(name, file, settings)
    observer.start(*given)
    return observer.run(np.ascontiguousarray(run.voltage[:, None]), run.measured)[:, 0]


def tuned_settings(
    name: str, file: str | None, knobs: Sequence[TuningParameter], given: tuple, run: Run
) -> tuple[float, ...]:
    """Those of least error on the training release, by the official tuner's rule."""
    tried = []
    every = [tuple(settings) for settings in positions(knobs).tolist()]
    for settings in every:
        try:
            tried.append(min(errors_of(run, estimate(name, file, settings, given, run))["whole"], WORST))
        except InputError:  # there is no such design
            tried.append(np.inf)
    return every[int(np.argmin(tried))]


def rows_on(task: str, trained: int, estimates: Callable[[tuple, Run], dict[str, np.ndarray]]) -> list[tuple]:
    """Rows of the releases that judge, of ``estimates(given, run)`` by name."""
    rows = []
    for judged in set(range(len(RELEASES))) - {trained}:
        run = run_of(task, judged)
        for name, found in estimates(fitted(task, trained), run).items():
            errors = errors_of(run, found)
            rows += [(task, part, trained, judged, name, errors[part]) for part in PARTS]
    return rows


def file_rows(name: str, file: str, knobs: Sequence[TuningParameter], tuned: bool) -> list[tuple]:
    """Rows of a file's observer, its knobs at their defaults where these are not to be `tuned`."""
    rows = []
    for task in TASKS:
        for trained in range(len(RELEASES)):
            given, run = fitted(task, trained), run_of(task, trained)
            own = (
                tuned_settings(name, file, knobs, given, run)
                if tuned
                else tuple(knob.default for knob in knobs)
            )
            rows += rows_on(
                task, trained, lambda given, run, own=own: {name: estimate(name, file, own, given, run)}
            )
    return rows


def record_table(names: Sequence[str] = RUNNING) -> pd.DataFrame:
    """A row for each task, pair of releases, part and entrant."""
    rows: list[tuple] = []
    for task in TASKS:
        for trained in range(len(RELEASES)):
            train = run_of(task, trained)
            settings = {
                name: tuned_settings(name, None, ENTRANTS[name].knobs, fitted(task, trained), train)
                for name in names
            }

            def estimates(given, run, settings=settings, train=train):
                ours = {name: estimate(name, None, own, given, run) for name, own in settings.items()}
                return ours | {
                    name: linear_estimate(run, to) for name, to in zip(LINEAR, (train, run), strict=True)
                }

            rows += rows_on(task, trained, estimates)
    return pd.DataFrame(rows, columns=COLUMNS)


def record_standings(table: pd.DataFrame) -> pd.DataFrame:
    """A row an entrant: median error over the pairs of releases, the least and the largest, on each task and part.

    Three releases are too few for an interval of 95 %.
    """
    names = table.groupby("entrant")["error"].median().sort_values(kind="stable").index
    columns = {}
    for (task, part), some in table.groupby(["task", "part"], sort=False):
        errors = some.groupby("entrant")["error"]
        ends = zip(errors.median()[names], errors.min()[names], errors.max()[names], strict=True)
        columns[f"{task}, {part}"] = [f"{middle:.2f} ({low:.2f} to {high:.2f})" for middle, low, high in ends]
    return pd.DataFrame({"observer": names, **columns})


def main() -> None:
    """Make the committed table."""
    table = record_table()
    table.round({"error": 4}).to_csv(FILE, index=False, lineterminator="\n")
    print(record_standings(table).to_string(index=False))


if __name__ == "__main__":
    main()
