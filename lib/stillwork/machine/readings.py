"""What a machine's file was taken for, and whether another reading of its columns explains the response better."""

import sys
from collections.abc import Mapping
from itertools import product
from pathlib import Path

import numpy as np
from jaxtyping import Float64
from scipy.ndimage import uniform_filter1d

from stillwork.base.checks import InputError
from stillwork.base.validation import checked
from stillwork.identification.frequency_response import Identified
from stillwork.identification.machine import MISFIT, TURNED, Machine, build_machine, thinned, whole_band
from stillwork.identification.machine_files import PADDING, MachineFile, load_machine
from stillwork.identification.modal_fit import SMOOTH, ModalFit, identify_modes
from stillwork.signals.datafiles import read_arrays

OVER_NOISE = 3.0  # times the noise, that a misfit of the model may be
CLEARLY = 2.0  # times the misfit of another reading, that the one taken may have
LINES = 3000  # of a response, to which readings are compared
SHOWN_MODES = 5
OTHER = {"magnitude": ("dB", "1"), "phase": ("deg", "rad")}
# Of a magnitude in dB and a phase in degrees: how far the written number moves where the response moves by its own size.
PER_SIZE = {"dB": 20 / np.log(10), "deg": 180 / np.pi, "rad": 1.0}


@checked(missing=True)
def believed(file: MachineFile, machine: Machine) -> str:
    """One line on what a file was taken for: mass, modes, and the unit of each column, written or by default."""
    hertz, rigid = machine.resonances_hz, f"no flexible mode up to {machine.rigid_to_hz:.4g} Hz"
    modes = ", ".join(f"{each:.4g}" for each in hertz[:SHOWN_MODES])
    modes = (
        " and ".join(modes.rsplit(", ", 1))
        if len(hertz) <= SHOWN_MODES
        else f"{modes} Hz, ... {hertz[-1]:.4g}"
    )
    parts: dict[str, list[str]] = {}
    for each in file.readings:
        if each.quantity not in ("coherence", "time", "rate"):
            word = "from" if each.quantity == "frequency" else "in"
            unit = {"deg": "degrees"}.get(each.unit, each.unit) or "1"
            parts.setdefault(f"{word} {unit}{'' if each.written else ' (default, not written)'}", []).append(
                each.quantity
            )
    told = [f"{' and '.join(dict.fromkeys(names))} {unit}" for unit, names in parts.items()]
    units = ", ".join(told) or f"matrices in {machine.units[0]} and {machine.units[1]}"
    found = f"mode{'s' if len(hertz) > 1 else ''} at {modes} Hz" if len(hertz) else rigid
    against = f"; {TURNED}" if TURNED in machine.notes else ""
    return f"{machine.mass:.4g} {machine.mass_unit}, {found}; {units}{against}"


@checked(missing=True)
def require_explained(
    path: str | Path,
    file: MachineFile,
    machine: Machine | None,
    fit_hz: tuple[float, float],
    options: Mapping,
) -> None:
    """Refuse a measurement that its model does not explain, or that another reading of its columns explains better.

    Parameters
    ----------
    path : str or Path
    file : MachineFile
        As `load_machine` read it with `options`.
    machine : Machine or None
        As `build_machine` fitted it in the band `fit_hz`; None where it could not.
    fit_hz : tuple of float
    options : mapping
        Arguments of `load_machine`.

    Raises
    ------
    InputError
        When the model leaves more than `MISFIT` of the response and `OVER_NOISE` times its noise; or when with the
        magnitude or the phase in another unit a model of the same kind leaves `CLEARLY` less. The misfits are compared in
        the written numbers: a reading that makes all lines alike, as dB of numbers near one do, gains nothing by it. Hz
        and rad/s cannot be told apart: with all frequencies scaled, the response of a machine is that of another.

    Examples
    --------
    >>> free = {"M": np.diag([8.0, 2.0]), "K": [[1e6, -1e6], [-1e6, 1e6]], "input": [1.0, 0.0]}
    >>> np.savez("stage.npz", **free)
    >>> file = identification.load_machine("stage.npz")
    >>> machine.require_explained("stage.npz", file, None, (0, 0), {})  # matrices have no other reading
    """
    if file.accelerance is None:
        return
    units = {each.quantity: each for each in file.readings}
    if OTHER.keys() <= units.keys():
        _compare(path, file, units, fit_hz, options)
    if machine is None or machine.fit is None or machine.measured is None:
        return
    off, noise = misfit(machine.measured, machine.fit)
    # What a cut spreads to other lines scatters there as noise does.
    if off > MISFIT and (file.cut_off or off > OVER_NOISE * noise):
        raise InputError(
            f"{file.source}: the model is off by {100 * off:.2g} % of the response (root mean square) at a noise of "
            f"{100 * noise:.2g} %, so that nothing can be promised; the file was read as {believed(file, machine)}: correct "
            "its units, or let fit_hz end before strong or dry damping, play, or where the response is no longer reliable"
        )


@checked(missing=True)
def build_explained(
    path: str | Path,
    file: MachineFile,
    *,
    fit_hz: tuple[float, float],
    options: Mapping,
) -> Machine:
    """`build_machine`, with what it believes printed, and refused as by `require_explained`."""
    try:
        machine = build_machine(file, modes_hz=[], fit_hz=fit_hz, rigid=True)
    except InputError:
        require_explained(path, file, None, fit_hz, options)
        raise
    print(believed(file, machine), file=sys.stderr, flush=True)
    require_explained(path, file, machine, fit_hz, options)
    return machine


def _compare(path, file, units, fit_hz, options) -> None:
    """Refuse where another unit of magnitude or phase explains the written numbers clearly better."""
    arrays = read_arrays(Path(path))
    numbers = np.abs(np.ravel(arrays[units["magnitude"].column]))
    numbers = float(np.exp(np.mean(np.log(numbers[numbers > 0]))))
    taken = tuple(_kind(units[name].unit, name) for name in OTHER)
    left = {}
    for each in product(*OTHER.values()):
        moves = PER_SIZE.get(each[0], numbers) * PER_SIZE[each[1]]
        left[each] = _left(path, each, fit_hz, options) * np.sqrt(moves)
    best = min(left, key=lambda each: left[each])
    # What moves the written numbers divides out: another reading must explain the response, not only do so less badly.
    plain = left[best] / np.sqrt(PER_SIZE.get(best[0], numbers) * PER_SIZE[best[1]])
    if CLEARLY * left[best] < left[taken] and plain < MISFIT:
        words = " and ".join(
            f"{name} in {_word(new)} (not {_word(old)})"
            for name, old, new in zip(OTHER, taken, best, strict=True)
            if old != new
        )
        columns = ", ".join(
            units[name].column for name, old, new in zip(OTHER, taken, best, strict=True) if old != new
        )
        raise InputError(
            f"{file.source}: {words} explains the response {left[taken] / left[best]:.2g} times better; write the unit "
            f"into the name of {columns}"
        )


def _left(path, reading, fit_hz, options) -> float:
    """Relative misfit of the best model with a reading of magnitude and phase; infinite where there is none."""
    try:
        file = load_machine(path, **{**options, "read_as": dict(zip(OTHER, reading, strict=True))})
        measured = file.accelerance
        band = whole_band(measured, fit_hz)
        with np.errstate(all="ignore"):
            few = thinned(measured, LINES, band)
            return misfit(few, identify_modes(few, band))[0]
    except (
        InputError,
        np.linalg.LinAlgError,
        OverflowError,
    ):  # numbers read as decibels may have hundreds of decades
        return np.inf


@checked(missing=True)
def misfit(measured: Identified, fit: ModalFit) -> tuple[float, float]:
    """Root mean squares of what a fit leaves and of the noise, both relative to the response's size near each line.

    The noise is the larger of what the coherence gives and what neighbouring lines do not share of the residual: each
    line's less the mean of those `PADDING` away, within which lines of a padded record hang together.
    """
    places = np.searchsorted(measured.omega, fit.omega)
    seen, omega = measured.response[places], fit.omega
    size = np.sqrt(uniform_filter1d(np.abs(seen) ** 2, SMOOTH, mode="nearest"))
    left = _residual(fit, omega, seen) / size
    scatter = left[PADDING:-PADDING] - (left[: -2 * PADDING] + left[2 * PADDING :]) / 2
    coherence = np.clip(np.nan_to_num(measured.coherence[places], nan=1.0), 1e-6, 1.0)
    noise = np.mean(np.abs(scatter) ** 2) / 1.5, np.mean((1 - coherence) / coherence)
    return float(np.sqrt(np.mean(np.abs(left) ** 2))), float(np.sqrt(max(noise)))


def _residual(fit: ModalFit, omega: Float64[np.ndarray, " lines"], seen: np.ndarray) -> np.ndarray:
    shape = fit.model.frequency_response(omega)[0, 0]
    if fit.phased is not None:
        shape = shape + fit.phased.velocity_response(fit.phased.model, fit.phased.velocity, omega, 0.0, 0.0)
    model = -(omega**2) * shape
    early = seen * np.exp(1j * omega * fit.delay)
    return min((early - model, -early - model), key=lambda each: float(np.sum(np.abs(each) ** 2)))


def _kind(unit: str, name: str) -> str:
    if name == "phase":
        return "rad" if unit == "rad" else "deg"
    return "dB" if unit.startswith("dB") else "1"


def _word(unit: str) -> str:
    return {"1": "linear numbers", "deg": "degrees"}.get(unit, unit)
