"""Your own machine as a modal model: fitted to its frequency response, or built from mass and stiffness."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64
from scipy.ndimage import median_filter

from stillwork.base.checks import InputError, pluralise, require_kind
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.identification.frequency_response import Identified
from stillwork.identification.machine_files import MachineFile
from stillwork.identification.modal_fit import SUSPENDED, ModalFit, identify_modes
from stillwork.lti.modal import ModalModel
from stillwork.lti.reduction import truncate

LEAST_LINES = 32  # of a band
MAX_RELATIVE_ERROR = (
    0.5  # relative error below half the first resonance, or at the end of the band, that is reported
)
MISFIT = 0.25  # relative error over the whole band, root mean square, that is reported
LEAST_PHASE = 1.0  # degrees, that is reported
BAND_END_SHARE = 0.01  # of the band's highest frequency
AROUND = (0.4, 10.0)  # times the one resonance that stands out, where more is looked for
TURNED = "counted against the force, turned"
TRUSTED = 0.1  # noise over response by the coherence, up to which a line is trusted
SMOOTH = 15  # lines of the running median of that
MOST_MODES = 12  # of a matrix model: the others enter as compliance


@by_value
@dataclass(frozen=True)
class Machine:
    """A machine as input of the search for a controller."""

    sensors: tuple[ModalModel, ...]  # force to position, one per sensor that the controller must serve
    mass: float  # kg, of the rigid body
    source: str  # where it comes from
    measured: Identified | None = None  # its accelerance at the first sensor, 1/kg, counted along the force
    fit: ModalFit | None = None  # of `measured`
    notes: tuple[str, ...] = ()  # what was done to it, and what to mind
    units: tuple[str, str] = ("m", "N")  # of the position and of what drives it

    def __post_init__(self):
        check_fields(self)
        if not self.sensors:
            raise InputError("sensors is empty; give the model of at least one sensor")

    @property
    def mass_unit(self) -> str:
        """Unit of `mass`: kg, kg m^2 for an inertia, or drive over acceleration."""
        position, drive = self.units
        known = {("m", "N"): "kg", ("rad", "N m"): "kg m^2"}
        return known.get(self.units, f"{drive}/({position}/s^2)")

    @property
    def rigid_to_hz(self) -> float:
        """Up to where it moves as one body, Hz: to its first flexible mode; without one to the end of the measured band."""
        end = float(self.fit.omega[-1]) / (2 * np.pi) if self.fit else np.inf
        return float(self.resonances_hz[0]) if len(self.resonances_hz) else end

    @property
    def resonances_hz(self) -> Float64[np.ndarray, " modes"]:
        """Frequencies of the flexible modes, without the suspension mode of a machine on springs to the ground."""
        return self.sensors[0].frequencies[1:] / (2 * np.pi)


@checked(missing=True)
def remove_delay(machine: Machine, delay: float) -> Machine:
    """The machine with its measurement advanced by a delay (s), which the loop then contains instead."""
    if machine.measured is None:
        return machine
    turned = machine.measured.response * np.exp(1j * machine.measured.omega * delay)
    return replace(machine, measured=machine.measured._replace(response=turned))


@checked
def trusted(measured: Identified) -> Bool[np.ndarray, " lines"]:
    """The lines that the coherence lets be trusted to `TRUSTED`; without a coherence all."""
    if not np.isfinite(measured.coherence).any():
        return np.ones(len(measured.omega), dtype=bool)
    known = np.clip(np.nan_to_num(measured.coherence, nan=0.0), 1e-9, 1.0)
    return median_filter(np.sqrt((1 - known) / known), SMOOTH, mode="nearest") <= TRUSTED


@checked
def whole_band(measured: Identified, band_hz: tuple[float, float]) -> tuple[float, float]:
    """The band, or the whole measured band for (0, 0); `InputError` if it holds too few lines."""
    hertz = measured.omega / (2 * np.pi)
    low, high = band_hz if any(band_hz) else (hertz[0], hertz[-1])
    inside = int(np.sum((hertz >= low) & (hertz <= high)))
    if not low < high or inside < LEAST_LINES:
        raise InputError(
            f"the band {low:g} to {high:g} Hz holds {pluralise(inside, 'line')} of the measurement, which runs from "
            f"{hertz[0]:.4g} to {hertz[-1]:.4g} Hz; give a band inside it, or (0, 0) for all of it"
        )
    return float(low), float(high)


@checked(missing=True)
def measured_band(machine: Machine, loop_hz: tuple[float, float] = (0.0, 0.0)) -> tuple[float, float]:
    """Where the measurement stands for the plant, Hz: as given, else from the first to the last trusted line of the fit's band."""
    if machine.measured is None or machine.fit is None:
        return 0.0, 0.0
    if not any(loop_hz):
        hertz = machine.measured.omega / (2 * np.pi)
        low, high = map(float, machine.fit.omega[[0, -1]] / (2 * np.pi))
        held = hertz[trusted(machine.measured) & (hertz >= low) & (hertz <= high)]
        loop_hz = (float(held[0]), float(held[-1])) if len(held) >= LEAST_LINES else (low, high)
    return whole_band(machine.measured, loop_hz)


@checked(missing=True)
def build_machine(
    file: MachineFile,
    *,
    modes_hz: list[float],
    fit_hz: tuple[float, float],
    rigid: bool = False,
) -> Machine:
    """Fit a modal model to a measurement, or compute it from the matrices.

    Parameters
    ----------
    file : MachineFile
    modes_hz : list of float
        Where the fit starts; empty: found by `identify_modes`.
    fit_hz : tuple of float
        Band of the fit; (0, 0) for all that was measured.
    rigid : bool
        Whether a machine without a flexible mode, or with none in the band, is taken as a rigid body, which may stand on
        springs; otherwise it is refused.

    Returns
    -------
    Machine
        Models from force to position, one per sensor, with the fit behind them.

    Raises
    ------
    InputError
        When the machine is not free to move as one rigid body, or nothing can be fitted.

    Examples
    --------
    >>> free = {"M": np.diag([8.0, 2.0]), "K": [[1e6, -1e6], [-1e6, 1e6]], "input": [1.0, 0.0]}
    >>> np.savez("stage.npz", **free)
    >>> stage = identification.load_machine("stage.npz")
    >>> machine = identification.build_machine(stage, modes_hz=[], fit_hz=(0, 0))
    >>> round(machine.mass, 6), machine.resonances_hz.round(1)  # kg, Hz
    (10.0, array([125.8]))
    """
    if file.accelerance is None:
        return _built(file, require_kind("file.model", file.model, ModalModel), rigid)
    return _fitted(file, file.accelerance, modes_hz, fit_hz, rigid)


def _fitted(
    file: MachineFile, measured: Identified, modes_hz: list[float], fit_hz: tuple[float, float], rigid: bool
) -> Machine:
    band = whole_band(measured, fit_hz)
    fit = identify_modes(thinned(measured, 12_000, band), band, modes_hz, rigid=rigid)
    notes = [*file.notes]
    if not len(fit.deviation) and fit.rms_error > MISFIT:
        raise InputError(
            f"{file.source}: no resonance stands out from {band[0]:g} to {band[1]:g} Hz, and a rigid body alone is off by "
            f"{100 * fit.rms_error:.2g} % (root mean square); let fit_hz be the band in which the response stands out of its "
            "noise, or measure with less of it"
        )
    if len(fit.deviation) and len(fit.model.frequencies) < 2:
        whole, only = band, float(fit.model.frequencies[-1]) / (2 * np.pi)
        part, closer = _closer(measured, band, only) or (band, fit)
        if len(closer.model.frequencies) > 1:
            band, fit = part, closer
            notes.append(
                f"fitted from {band[0]:.4g} to {band[1]:.4g} Hz: from {whole[0]:.4g} to {whole[1]:.4g} Hz one resonance alone "
                "stood out; give fit_hz, the band in which the response is reliable"
            )
        elif not rigid or fit.rms_error > MISFIT:
            everything = not any(fit_hz) or whole_band(measured, (0.0, 0.0)) == whole
            raise InputError(
                f"{file.source} has one resonance from {whole[0]:.4g} to {whole[1]:.4g} Hz, at {only:.4g} Hz, and no flexible "
                f"mode beside it; {'measure further' if everything else 'widen fit_hz'}, or let fit_hz be the band in "
                "which the response stands out of its noise"
            )
    if fit.turned:
        measured = measured._replace(response=-measured.response)
    notes += [*_model_notes(file, fit), *_misfit_notes(measured, fit, band)]
    model = fit.model
    return Machine((model,), _mass(model), file.source, measured, fit, notes=tuple(notes), units=file.units)


def _model_notes(file: MachineFile, fit: ModalFit) -> Iterator[str]:
    """What the fitted model is, and what of the response it is without."""
    model, low = fit.model, fit.omega[0] / (2 * np.pi)
    yield f"the mass is that from {low:.4g} Hz on, with a standard deviation of {100 * fit.mass_deviation:.2g} %"
    if len(model.frequencies) < 2:
        yield f"no flexible mode stands out up to {fit.omega[-1] / (2 * np.pi):.4g} Hz: the model is a rigid body, and the controller a PID"
    if fit.turned:
        yield TURNED
    if not model.rigid_modes:
        yield f"on springs to the ground: its suspension at {model.frequencies[0] / (2 * np.pi):.4g} Hz"
    if model.drag:
        yield (
            f"on viscous friction: {model.drag:.4g} 1/s of the mass, {model.drag * _mass(model):.4g} "
            f"{file.units[1]}/({file.units[0]}/s)"
        )
    if fit.phased is not None:
        turned = ", ".join(
            f"{degrees:.0f} degrees at {omega / (2 * np.pi):.4g} Hz"
            for omega, degrees in zip(fit.phased.model.frequencies, fit.phased.degrees, strict=True)
            if abs(degrees) >= LEAST_PHASE
        )
        yield (
            f"the modes have phases of their own, {turned or f'each below {LEAST_PHASE:g} degree'}: dampers that the mode shapes do not decouple; the model is "
            "without, loops are judged with them"
        )
    if fit.delay:
        yield (
            f"the response is {1e6 * abs(fit.delay):.4g} us {'late' if fit.delay > 0 else 'early'}: a delay beside the "
            "machine, which the model is without"
        )


def _misfit_notes(measured: Identified, fit: ModalFit, band: tuple[float, float]) -> Iterator[str]:
    """Where the model is off the response by more than its noise, and what its lines do not resolve."""
    model = fit.model
    inside = (measured.omega >= fit.omega[0]) & (measured.omega <= fit.omega[-1])
    coherence = np.clip(np.nan_to_num(measured.coherence[inside], nan=1.0), 1e-6, 1.0)
    noise = float(np.sqrt(np.mean((1 - coherence) / coherence)))
    if fit.rms_error > max(MISFIT, 3 * noise):
        yield (
            f"all over the band the model is off by {100 * fit.rms_error:.2g} % (root mean square), and noise by the coherence is "
            f"{100 * noise:.2g} %: what is promised in the box around the model may not hold around this machine; strong or "
            "dry damping, play, or modes that were not found: end fit_hz before them"
        )
    first = float(model.frequencies[1:].min(initial=fit.omega[-1]))
    below = fit.omega < first / 2
    missed = float(np.sqrt(np.mean(fit.error[below] ** 2))) if below.any() else 0.0
    if missed > MAX_RELATIVE_ERROR:
        yield (
            f"up to {first / (4 * np.pi):.4g} Hz the model is off by {100 * missed:.2g} % (root mean "
            "square): noise, or a suspension that the lines do not resolve; mind the mass, start fit_hz above it, or "
            "measure finer"
        )
    end = fit.omega > (1 - BAND_END_SHARE) * fit.omega[-1]
    if len(fit.cut):
        yield (
            f"a resonance at about {fit.cut[0] / (2 * np.pi):.4g} Hz, beyond the band, is left out of the model; widen "
            "fit_hz to hold it"
        )
    elif (off := float(np.sqrt(np.mean(fit.error[end] ** 2)))) > MAX_RELATIVE_ERROR:
        yield (
            f"at the end of the band, {band[1]:.4g} Hz, the model is off by {100 * off:.2g} % (root mean square): "
            "noise, or a resonance that the band cuts, which draws at the mass; end fit_hz well beyond it, or before it"
        )
    widths = 2 * model.damping[1:] * model.frequencies[1:] / (2 * np.pi)
    spacing = float(np.median(np.diff(measured.omega))) / (2 * np.pi)
    if spacing > widths.min(initial=np.inf):
        yield (
            f"lines {spacing:.3g} Hz apart do not resolve a resonance {widths.min():.3g} Hz wide: its peak may lie "
            "between them"
        )


def _closer(
    measured: Identified, band: tuple[float, float], only: float
) -> tuple[tuple[float, float], ModalFit] | None:
    """A part of a band around the one resonance that was found in it, and the fit there; None where it fails, too.

    Lines are evenly spaced: modes at one end of a long band are few of them, between which noise and what lies far away
    decide.
    """
    low, high = max(band[0], AROUND[0] * only), min(band[1], AROUND[1] * only)
    try:
        part = whole_band(measured, (low, high))
        return part, identify_modes(thinned(measured, 12_000, part), part)
    except InputError:
        return None


def _built(file: MachineFile, model: ModalModel, rigid: bool) -> Machine:
    suspended = not model.rigid_modes and SUSPENDED * model.frequencies[0] <= model.frequencies[1:].min(
        initial=np.inf
    )
    if model.rigid_modes != 1 and not suspended:
        raise InputError(
            f"{file.source} has {model.rigid_modes} rigid-body modes; the PID rules are for a machine that is free to "
            f"move in one direction, or on springs to the ground with all resonances above {SUSPENDED:g} times that "
            "of its suspension: free this direction, and fix the others"
        )
    if not rigid and not len(model.frequencies) > 1:
        raise InputError(
            f"{file.source} has no flexible mode; an observer of flexible modes has nothing to do"
        )
    if len(model.frequencies) > MOST_MODES:
        model = truncate(model, MOST_MODES, len(model.frequencies) - MOST_MODES)
    sensors = tuple(model.at([0], [k]) for k in range(len(model.output_shapes)))
    turned = _mass(sensors[0]) < 0
    if turned:
        sensors = tuple(
            replace(sensor, output_shapes=-sensor.output_shapes, feedthrough=-sensor.feedthrough)
            for sensor in sensors
        )
    masses = [_mass(each) for each in sensors]
    if not np.allclose(masses, masses[0], rtol=1e-3):
        listing = ", ".join(f"{mass:.4g}" for mass in masses)
        raise InputError(
            f"{file.source}: the sensors see rigid bodies of {listing} kg; let each output be a position along "
            "the force (a row of shares that add up to 1)"
        )
    notes = (TURNED,) if turned else ()
    if suspended:
        notes += (f"on springs to the ground: its suspension at {model.frequencies[0] / (2 * np.pi):.4g} Hz",)
    return Machine(sensors, masses[0], file.source, notes=notes, units=file.units)


def _mass(model: ModalModel) -> float:
    mobility = float(model.input_shapes[0, 0] * model.output_shapes[0, 0])
    if mobility == 0:
        raise InputError(
            "the force does not move the rigid body, or the sensor does not measure it; check input and output"
        )
    return 1 / mobility


@checked(missing=True)
def thinned(measured: Identified, most: int, band_hz: tuple[float, float]) -> Identified:
    """At most about `most` lines in the band, evenly chosen."""
    low, high = (2 * np.pi * end for end in band_hz)
    step = max(1, int(np.sum((measured.omega >= low) & (measured.omega <= high))) // most)
    return Identified(*(values[step - 1 :: step] for values in measured))
