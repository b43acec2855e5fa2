"""Dynamic error budget: the spectra of all disturbances through a closed loop to the errors that matter."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Complex128, Float64
from scipy import stats
from scipy.stats import qmc

from stillwork.base.bounds import Count, Fraction, NonNegative, Positive, Vector
from stillwork.base.checks import InputError, require_choice, require_number
from stillwork.base.validation import by_value, check_fields, checked, user_callback
from stillwork.control.uncertainty import Perturbation, Uncertainty, place_at
from stillwork.lti.delays import delayed, split_delay, with_input_before
from stillwork.lti.discretisation import continuous_poles, zoh
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel, block_matrix, interconnect, response_between
from stillwork.signals.levels import expected_peak
from stillwork.signals.moving_average import average_filter

NODES, WEIGHTS = np.polynomial.legendre.leggauss(5)
PANELS = 5  # a decade, and beside each pole at the powers of this ratio times its width:
RATIO = 2.2
# Squared correlation of Hann-windowed lines with themselves and with their next two neighbours.
NEIGHBOURS = (1.0, 4 / 9, 1 / 36)
KNOWN = 1e12  # degrees of freedom of what is known exactly, and Hz to which a density without an end is known


class UnstableLoop(InputError):
    """The closed loop of a network is unstable: its errors grow without bound and have no spectrum."""


@by_value
@dataclass(frozen=True)
class Source:
    """One disturbance, as a one-sided power spectral density, as tones, or both; see `budget_sources` for makers.

    Parameters
    ----------
    name : str
    places : tuple of str
        Inputs of the network at which it acts; several where the inputs are correlated.
    unit : str
        Unit of its amplitude, such as ``m/s^2``; it must be the unit of its places, ``m, N`` if these differ.
    density : callable, optional
        Frequencies (Hz) to unit^2/Hz, shape (f,), or (places, places, f) as a cross-spectral matrix.
    band_hz : tuple of float
        Where the density is known; it counts as zero outside.
    knots_hz : array_like
        Frequencies at which the density has corners.
    tones : tuple of (float, complex, ...)
        Frequency (Hz) of each tone, and its amplitude (peak) at each place, complex where its phase matters.
    freedom, resolution_hz : float
        For an estimated density: degrees of freedom per line, and the spacing of the lines.

    Raises
    ------
    InputError
        When it acts nowhere, or holds neither a density nor a tone.

    Examples
    --------
    >>> hum = control.Source("mains", ("stage force",), "N", tones=((50.0, 0.01),))
    """

    name: str
    places: tuple[str, ...]
    unit: str
    density: Callable[..., Any] | None = None
    band_hz: tuple[float, float] = (0.0, KNOWN)
    knots_hz: Float64[np.ndarray, " knots"] = field(default_factory=lambda: np.zeros(0))
    tones: tuple[tuple[float | complex, ...], ...] = ()
    freedom: float = KNOWN
    resolution_hz: float = 0.0

    def __post_init__(self):
        check_fields(self)
        if not self.places or (self.density is None and not self.tones):
            raise InputError(
                f"{self.name}: no place, or neither density nor tones; give both a place and one of these"
            )
        if any(len(tone) != 1 + len(self.places) for tone in self.tones):
            raise InputError(
                f"{self.name}: tones need a frequency and an amplitude at each of {len(self.places)} places"
            )
        if not np.isfinite(self.tones).all() or any(tone[0].imag or tone[0].real < 0 for tone in self.tones):
            raise InputError(
                f"{self.name}: tones hold a frequency that is negative or not a number, or an infinite amplitude"
            )

    @property
    def units(self) -> tuple[str, ...]:
        """Of each place."""
        known = tuple(self.unit.split(", "))
        return known * len(self.places) if len(known) == 1 else known

    def _at(self, frequencies_hz: np.ndarray) -> Complex128[np.ndarray, "places places f"]:
        """Cross-spectral matrix, zero outside the band."""
        n, f = len(self.places), np.abs(frequencies_hz)
        if self.density is None:
            return np.zeros((n, n, len(f)), complex)
        values = np.asarray(user_callback(self.density)(f), complex)
        values = values[None, None] if values.ndim == 1 else values
        if values.shape != (n, n, len(f)):
            raise InputError(f"{self.name}: density returned {values.shape}; return ({n}, {n}, {len(f)})")
        if np.any(np.einsum("iif->if", values).real < 0) or not np.isfinite(values).all():
            raise InputError(
                f"{self.name}: density is negative or not finite somewhere in the band; correct it"
            )
        # What a real signal has at negative frequencies is the conjugate.
        values = np.where(np.asarray(frequencies_hz) < 0, values.conj(), values)
        return values * ((f >= self.band_hz[0]) & (f <= self.band_hz[1]))


@by_value
@dataclass(frozen=True)
class Network:
    r"""A continuous plant with its controller, sampled or not, and the places at which sources act.

    Sources act on the disturbances of the plant, on its measurements and on the commands to it. A sampled controller takes
    the measurements at its samples, before a command changes; its commands are held, and delayed by `delay`.

    Parameters
    ----------
    plant : StateModel
        In continuous time, from disturbances and commands to errors and measurements, in this order.
    controller : StateModel
        From measurements to commands, positive feedback; sampled where it has a sample time.
    disturbances, commands, errors, measurements : mapping of str to str
        Names and units.
    delay : float
        s, from a command to the plant; of a sampled controller only.

    Raises
    ------
    InputError
        When sizes do not fit, two places have one name, or the closed loop is unstable.

    References
    ----------
    Chen and Francis, Optimal Sampled-Data Control Systems (1995), chapter 3.

    Examples
    --------
    >>> spring = lti.StateModel([[-10.0]], [[1.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
    >>> gain = lti.StateModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-5.0]])
    >>> net = control.Network(spring, gain, {"load": "N"}, {"drive": "N"}, {"error": "m"}, {"sensor": "m"})
    >>> net.paths(np.array([0.0])).real.round(3)[0, 0]  # m/N: 1 / (10 + 5)
    array([0.067])
    """

    plant: StateModel
    controller: StateModel
    disturbances: Mapping[str, str]
    commands: Mapping[str, str]
    errors: Mapping[str, str]
    measurements: Mapping[str, str]
    delay: NonNegative = 0.0

    def __post_init__(self):
        check_fields(self)
        w, u, z, y = map(len, (self.disturbances, self.commands, self.errors, self.measurements))
        if (
            self.plant.d.shape != (z + y, w + u)
            or self.controller.d.shape != (u, y)
            or self.plant.sample_time
        ):
            raise InputError(
                f"plant has shape {self.plant.d.shape}, controller {self.controller.d.shape}; give {(z + y, w + u)} in "
                f"continuous time and {(u, y)} for these names"
            )
        if len(self.places) < w + u + y:
            raise InputError("disturbances, commands and measurements share a name; give each its own")
        if self.delay and not self.rate_hz:
            raise InputError("delay is for a sampled controller; discretise it, or give 0")
        if not self.loop.is_stable:
            poles = self.loop.poles
            worst = np.abs(poles).max() if self.rate_hz else poles.real.max()
            size = f"of size {worst:.6g}" if self.rate_hz else f"at {worst:+.3g} 1/s"
            raise UnstableLoop(
                f"the closed loop is unstable (a pole {size}); lower the bandwidth, a gain or the delay"
            )

    @property
    def places(self) -> dict[str, str]:
        """Inputs for sources and their units: disturbances, measurements, commands."""
        return {**self.disturbances, **self.measurements, **self.commands}

    @property
    def rate_hz(self) -> float:
        """Of a sampled controller; 0 in continuous time."""
        return 1 / self.controller.sample_time if self.controller.sample_time else 0.0

    def _parts(self, inputs: str, outputs: str) -> StateModel:
        w, z = len(self.disturbances), len(self.errors)
        columns = {"w": range(w), "u": range(w, self.plant.d.shape[1])}[inputs]
        rows = {"z": range(z), "y": range(z, len(self.plant.d))}[outputs]
        return self.plant.select(columns, rows)

    @cached_property
    def loop(self) -> StateModel:
        """Closed loop: in continuous time from all places to the errors, sampled from measurements and commands to commands."""
        w, u, z, y = map(len, (self.disturbances, self.commands, self.errors, self.measurements))
        if self.rate_hz:
            models = [
                _held(self._parts("u", "y"), 1 / self.rate_hz, self.delay * self.rate_hz),
                self.controller,
            ]
            feedback = block_matrix((u, y), (y, u), (0, 1), (1, 0))
            inputs = block_matrix((u, y), (y, u), (0, 1), (1, 0))
            return interconnect(
                models, feedback, inputs, block_matrix((u,), (y, u), (0, 1)), np.eye(u, y + u, k=y)
            )
        feedback = block_matrix((w, u, y), (z, y, u), (0, 0, 0), (0, 0, 1), (0, 1, 0))
        inputs = block_matrix((w, u, y), (w, y, u), (1, 0, 0), (0, 0, 1), (0, 1, 0))
        return interconnect([self.plant, self.controller], feedback, inputs, np.eye(z, z + y + u))

    @checked
    def paths(self, frequencies_hz: Vector) -> Complex128[np.ndarray, "errors places f"]:
        """Response of the errors to sources at the same frequencies, exact.

        Parameters
        ----------
        frequencies_hz : array_like, shape (f,)

        Returns
        -------
        ndarray, shape (errors, places, f)

        Examples
        --------
        >>> spring = lti.StateModel([[-10.0]], [[1.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
        >>> gain = lti.StateModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-5.0]])
        >>> net = control.Network(spring, gain, {"load": "N"}, {"drive": "N"}, {"error": "m"}, {"sensor": "m"})
        >>> net.paths([0.0]).real.round(3)[0]  # of the load, the sensor and the drive
        array([[ 0.067],
               [-0.333],
               [ 0.067]])
        """
        omega = 2 * np.pi * frequencies_hz
        if not self.rate_hz:
            return response_between(self.loop, omega)
        step = omega / self.rate_hz
        hold = np.exp(-1j * (step / 2 + omega * self.delay)) * np.sinc(step / (2 * np.pi))
        held = hold * self._parts("u", "z").frequency_response(omega)
        acted = np.einsum("zuf,uif->zif", held, response_between(self.loop, omega))
        seen = self._parts("w", "y").frequency_response(omega)
        direct = self._parts("w", "z").frequency_response(omega)
        direct += np.einsum("zyf,ywf->zwf", acted[:, : len(self.measurements)], seen)
        return np.concatenate([direct, acted], axis=1)

    def _folded(
        self, paths: np.ndarray, frequencies_hz: np.ndarray, fold: int
    ) -> Complex128[np.ndarray, "errors places f"]:
        """From `paths` at these frequencies, those of disturbances at `fold` rates above: what sampling folds."""
        w, y = len(self.disturbances), len(self.measurements)
        seen = self._parts("w", "y").frequency_response(2 * np.pi * (frequencies_hz + fold * self.rate_hz))
        found = np.zeros_like(paths)
        np.einsum("zyf,ywf->zwf", paths[:, w : w + y], seen, out=found[:, :w])
        return found

    def _poles_hz(self, low_hz: float, high_hz: float) -> Complex128[np.ndarray, " poles"]:
        """Poles of all responses, f + 1j half-width, with their images by sampling between two frequencies."""
        poles = self.loop.poles
        if self.rate_hz:
            poles = np.concatenate([continuous_poles(poles, 1 / self.rate_hz), self.plant.poles])
        folds = np.arange(-self._folds(high_hz), self._folds(high_hz) + 1) * self.rate_hz
        poles = poles[:, None] / (2 * np.pi)
        widths = np.where(
            np.abs(poles) < low_hz, low_hz, np.abs(poles.real)
        )  # nothing counts closer to an integrator
        return (np.abs(poles.imag + folds) + 1j * widths).ravel()

    def _folds(self, high_hz: float) -> int:
        """Rates by which sampling moves what lies below `high_hz` to somewhere below it."""
        return int(2 * high_hz / self.rate_hz) if self.rate_hz else 0


def _held(model: StateModel, sample_time: float, delay: float) -> StateModel:
    """Zero-order-hold equivalent with the input late by `delay` samples, whole or not; measured before an input changes."""
    whole, late = split_delay(delay)
    if late:
        return zoh(model, sample_time, delay * sample_time)
    held = zoh(model, sample_time)
    if np.any(model.d):
        held = with_input_before(held, np.zeros_like(model.b))
    return delayed(held, whole)


@by_value
@dataclass(frozen=True)
class ErrorBudget:
    """Spectrum of each error due to each source, on nodes of an exact quadrature; see `error_budget`.

    Attributes
    ----------
    names, errors : tuple of str
        Sources, and errors.
    frequencies_hz, weights_hz : ndarray, shape (f,)
        Ascending; a tone has the weight 1.
    density : ndarray, shape (sources, errors, f)
        One-sided, unit^2/Hz; of a tone its power.
    is_tone : ndarray of bool, shape (f,)
    freedom, resolution_hz : ndarray, shape (sources,)
        See `Source`.
    bands_hz : ndarray, shape (sources, 2)
        Where each source is known.
    """

    names: tuple[str, ...]
    errors: tuple[str, ...]
    frequencies_hz: Float64[np.ndarray, " f"]
    weights_hz: Float64[np.ndarray, " f"]
    density: Float64[np.ndarray, "sources errors f"]
    is_tone: Bool[np.ndarray, " f"]
    freedom: Float64[np.ndarray, " sources"]
    resolution_hz: Float64[np.ndarray, " sources"]
    bands_hz: Float64[np.ndarray, "sources 2"]

    @cached_property
    def powers(self) -> Float64[np.ndarray, "sources errors"]:
        """Mean squares."""
        return self.density @ self.weights_hz

    @property
    def rms_by_source(self) -> Float64[np.ndarray, "sources errors"]:
        """Of each source alone."""
        return np.sqrt(self.powers)

    @property
    def rms(self) -> Float64[np.ndarray, " errors"]:
        """Of all sources together; three times it is the usual 3 sigma."""
        return np.sqrt(self.powers.sum(axis=0))

    @property
    def shares(self) -> Float64[np.ndarray, "sources errors"]:
        """Share of each source in the mean square; also the relative change of the rms per relative change of its level."""
        return self.powers / np.maximum(self.powers.sum(axis=0), np.finfo(float).tiny)

    @checked
    def saved(self, factor: NonNegative = 0.5) -> Float64[np.ndarray, "sources errors"]:
        """Decrease of the rms when the level of one source is multiplied by `factor`: what to buy next.

        Parameters
        ----------
        factor : float
            Of the amplitude, at least 0.

        Returns
        -------
        ndarray, shape (sources, errors)

        Examples
        --------
        >>> spring = lti.StateModel([[-10.0]], [[1.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
        >>> gain = lti.StateModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-5.0]])
        >>> net = control.Network(spring, gain, {"load": "N"}, {"drive": "N"}, {"error": "m"}, {"sensor": "m"})
        >>> load = control.Source("load", ("load",), "N", lambda f: np.full(len(f), 2.0), tones=((10.0, 0.1),))
        >>> budget = control.error_budget(net, [load], (1e-3, 1e4))
        >>> budget.saved(0.5).round(4)
        array([[0.0913]])
        """
        left = self.powers.sum(axis=0) - (1 - factor**2) * self.powers
        return self.rms - np.sqrt(np.maximum(left, 0))

    @checked
    def cumulative(self) -> Float64[np.ndarray, "sources errors f"]:
        """Mean square above each frequency.

        Returns
        -------
        ndarray, shape (sources, errors, f)

        Examples
        --------
        >>> spring = lti.StateModel([[-10.0]], [[1.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
        >>> gain = lti.StateModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-5.0]])
        >>> net = control.Network(spring, gain, {"load": "N"}, {"drive": "N"}, {"error": "m"}, {"sensor": "m"})
        >>> load = control.Source("load", ("load",), "N", lambda f: np.full(len(f), 2.0), tones=((10.0, 0.1),))
        >>> budget = control.error_budget(net, [load], (1e-3, 1e4))
        >>> bool(np.allclose(budget.cumulative()[..., 0], budget.powers))
        True
        """
        return np.cumsum((self.density * self.weights_hz)[..., ::-1], axis=-1)[..., ::-1]

    @checked
    def moving(
        self, exposure: float
    ) -> tuple[Float64[np.ndarray, " errors"], Float64[np.ndarray, " errors"]]:
        """Rms of the moving average, and of the moving standard deviation, over `exposure` seconds; exact.

        See `stillwork.signals.moving_average`; the average passes sinc^2 of the power, the deviation the rest.

        Parameters
        ----------
        exposure : float
            s.

        Returns
        -------
        tuple of ndarray, shape (errors,)

        Examples
        --------
        >>> spring = lti.StateModel([[-10.0]], [[1.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
        >>> gain = lti.StateModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-5.0]])
        >>> net = control.Network(spring, gain, {"load": "N"}, {"drive": "N"}, {"error": "m"}, {"sensor": "m"})
        >>> load = control.Source("load", ("load",), "N", lambda f: np.full(len(f), 2.0), tones=((10.0, 0.1),))
        >>> budget = control.error_budget(net, [load], (1e-3, 1e4))
        >>> average, deviation = budget.moving(0.1)
        >>> bool(np.allclose(np.hypot(average, deviation), budget.rms))
        True
        """
        passed = average_filter(2 * np.pi * self.frequencies_hz, exposure) ** 2
        whole = self.density.sum(axis=0)
        return np.sqrt(whole @ (self.weights_hz * passed)), np.sqrt(whole @ (self.weights_hz * (1 - passed)))

    @checked
    def peak(self, duration: Positive) -> Float64[np.ndarray, " errors"]:
        """Largest size expected within `duration` seconds of a Gaussian error, by Rice's crossings (Davenport 1964).

        The crossings count as independent: the peak of a narrow-band error is a few per cent lower.

        Parameters
        ----------
        duration : float
            s.

        Returns
        -------
        ndarray, shape (errors,)

        Examples
        --------
        >>> spring = lti.StateModel([[-10.0]], [[1.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
        >>> gain = lti.StateModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-5.0]])
        >>> net = control.Network(spring, gain, {"load": "N"}, {"drive": "N"}, {"error": "m"}, {"sensor": "m"})
        >>> load = control.Source("load", ("load",), "N", lambda f: np.full(len(f), 2.0), tones=((10.0, 0.1),))
        >>> budget = control.error_budget(net, [load], (1e-3, 1e4))
        >>> bool(3 < budget.peak(60.0)[0] / budget.rms[0] < 6)
        True
        """
        whole = self.density.sum(axis=0)
        rate = np.sqrt(whole @ (self.weights_hz * self.frequencies_hz**2)) / np.maximum(
            self.rms, np.finfo(float).tiny
        )
        return expected_peak(self.rms, rate, duration)

    def _freedom(self) -> Float64[np.ndarray, " errors"]:
        """Degrees of freedom of the total, from those of each estimated density (Satterthwaite)."""
        spread = np.zeros(len(self.errors))
        for row, freedom, resolution in zip(self.density, self.freedom, self.resolution_hz, strict=True):
            if freedom >= KNOWN or not resolution:
                continue
            place = np.round(self.frequencies_hz / resolution).astype(int)
            for error, parts in enumerate(row * np.where(self.is_tone, 0, self.weights_hz)):
                lines = np.bincount(place, parts, minlength=place[-1] + 1)
                spread[error] += sum(
                    (2 if lag else 1) * correlation * (lines[lag:] @ lines[: len(lines) - lag])
                    for lag, correlation in enumerate(NEIGHBOURS)
                ) * (2 / freedom)
        return np.minimum(2 * self.rms**4 / np.maximum(spread, np.finfo(float).tiny), KNOWN)

    @checked
    def interval(
        self, confidence: Fraction = 0.95, duration: NonNegative = 0.0
    ) -> Float64[np.ndarray, "2 errors"]:
        """Interval of the true rms, for densities estimated from records; with `duration` of the rms in a record of that length.

        The mean square of an estimated density is chi-squared, apart from the leakage of its windows, which is not in the interval
        (use lines closer than the narrowest feature). That of a record of the error is chi-squared, too, and both together
        are F-distributed.

        Parameters
        ----------
        confidence : float
            Probability of the interval.
        duration : float
            s; 0: of the truth.

        Returns
        -------
        ndarray, shape (2, errors)
            Lower and upper ends.

        Examples
        --------
        >>> spring = lti.StateModel([[-10.0]], [[1.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
        >>> gain = lti.StateModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-5.0]])
        >>> net = control.Network(spring, gain, {"load": "N"}, {"drive": "N"}, {"error": "m"}, {"sensor": "m"})
        >>> load = control.Source("load", ("load",), "N", lambda f: np.full(len(f), 2.0), tones=((10.0, 0.1),))
        >>> budget = control.error_budget(net, [load], (1e-3, 1e4))
        >>> low, high = budget.interval(0.95, duration=10.0)
        >>> bool(low[0] < budget.rms[0] < high[0])
        True
        """
        tail = (1 - confidence) / 2
        of_record = np.full(len(self.errors), KNOWN)
        if duration:
            random = self.density.sum(axis=0) * ~self.is_tone
            of_record = (
                2 * self.rms**4 * duration / np.maximum(random**2 @ self.weights_hz, np.finfo(float).tiny)
            )
        ends = [stats.f.ppf(q, np.minimum(of_record, KNOWN), self._freedom()) for q in (tail, 1 - tail)]
        return self.rms * np.sqrt(ends)

    def edges(self) -> Float64[np.ndarray, "sources 2"]:
        """Share of each source's largest part of an error in the first and the last third of an octave where it is known.

        A large one shows that the source matters beyond the band in which it is known; for a source known in the whole band it is 0.

        Returns
        -------
        ndarray, shape (sources, 2)
            At the lower and the upper end.

        Examples
        --------
        >>> spring = lti.StateModel([[-10.0]], [[1.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
        >>> gain = lti.StateModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-5.0]])
        >>> net = control.Network(spring, gain, {"load": "N"}, {"drive": "N"}, {"error": "m"}, {"sensor": "m"})
        >>> load = control.Source("load", ("load",), "N", lambda f: np.full(len(f), 2.0), tones=((10.0, 0.1),))
        >>> budget = control.error_budget(net, [load], (1e-3, 1e4))
        >>> budget.edges()
        array([[0., 0.]])
        """
        found, f = np.zeros((len(self.names), 2)), self.frequencies_hz
        ends = f[0], f[-1]
        for k, (low, high) in enumerate(self.bands_hz):
            for side, inside in enumerate((f <= low * 2 ** (1 / 3), f >= high * 2 ** (-1 / 3))):
                if (low > ends[0] * 1.01, high < ends[1] * 0.99)[side]:
                    parts = self.density[k] * self.weights_hz
                    found[k, side] = (
                        parts[:, inside].sum(axis=1) / np.maximum(self.powers[k], np.finfo(float).tiny)
                    ).max()
        return found


@checked
def error_budget(network: Network, sources: Sequence[Source], band_hz: tuple[Positive, float]) -> ErrorBudget:
    """Spectra of the errors by source, with cumulative spectra, intervals, moving averages and what to buy next.

    For a sampled loop these are the errors in continuous time, averaged over a sample, including aliasing.

    Parameters
    ----------
    network : Network
    sources : sequence of Source
        Independent of each other.
    band_hz : tuple of float
        From where to where sources and errors count, above 0.

    Returns
    -------
    ErrorBudget

    Raises
    ------
    InputError
        When a source acts at no place of the network, has another unit than its place, or a name is used twice.

    References
    ----------
    Monkhorst, Dynamic Error Budgeting, thesis, Delft (2004); Jabben, Mechatronic design of a magnetically suspended
    rotating platform, thesis, Delft (2007), chapter 3.

    Examples
    --------
    >>> spring = lti.StateModel([[-10.0]], [[1.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
    >>> gain = lti.StateModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-5.0]])
    >>> net = control.Network(spring, gain, {"load": "N"}, {"drive": "N"}, {"error": "m"}, {"sensor": "m"})
    >>> load = control.Source("load", ("load",), "N", density=lambda f: np.full(len(f), 2.0))
    >>> budget = control.error_budget(net, [load], (1e-6, 1e8))
    >>> budget.rms.round(4)  # white noise of unit intensity through 1 / (s + 15): sqrt(1 / 30)
    array([0.1826])
    """
    low, high = band_hz
    require_number("band_hz[1]", high, above=low)
    names = tuple(source.name for source in sources)
    if not names or len(set(names)) < len(names):
        raise InputError("sources is empty, or two have one name; give each its own")
    places = network.places
    for source in sources:
        _require_units(network, source)
    knots = np.concatenate([source.knots_hz for source in sources])
    f, weights = _quadrature(low, high, network._poles_hz(low, high), knots)
    density = np.zeros((len(sources), len(network.errors), len(f)))
    order, sampled = list(places), {*network.measurements, *network.commands} if network.rate_hz else set()
    direct = network.paths(f)
    for fold in range(-network._folds(high), network._folds(high) + 1):
        paths = network._folded(direct, f, fold) if fold else direct
        seen = f + fold * network.rate_hz
        for row, source in zip(density, sources, strict=True):
            of_samples = sampled.issuperset(source.places)
            inside = (np.abs(seen) >= low) & (np.abs(seen) <= high)
            if not inside.any() or (fold and of_samples):
                continue
            chosen = paths[:, [order.index(place) for place in source.places]][..., inside]
            spectrum = source._at(_folded(f, network.rate_hz) if of_samples else seen[inside])
            row[:, inside] += np.einsum("zif,ijf,zjf->zf", chosen, spectrum, chosen.conj()).real
    lines = [_lines(network, source, low, high) for source in sources]
    count = sum(len(at) for at, _ in lines)
    if count:
        extra = np.zeros((*density.shape[:2], count))
        first = 0
        for k, (at, sizes) in enumerate(lines):
            extra[k, :, first : first + len(at)] = np.abs(sizes) ** 2 / 2
            first += len(at)
        f = np.concatenate([f, *(at for at, _ in lines)])
        weights = np.append(weights, np.ones(count))
        density = np.concatenate([density, extra], axis=2)
    is_tone = np.arange(len(f)) >= len(f) - count
    rising = np.argsort(f, kind="stable")
    return ErrorBudget(
        names,
        tuple(network.errors),
        f[rising],
        weights[rising],
        np.maximum(density[..., rising], 0.0),
        is_tone[rising],
        np.array([source.freedom for source in sources]),
        np.array([source.resolution_hz for source in sources]),
        np.array([source.band_hz for source in sources], float),
    )


def _folded(f: np.ndarray, rate: float) -> np.ndarray:
    """Frequencies of the samples that these are images of."""
    return np.abs((f + rate / 2) % rate - rate / 2) if rate else f


def _require_units(network: Network, source: Source) -> None:
    places = network.places
    for place in source.places:
        require_choice(f"{source.name}: place", place, places)
    wanted = tuple(places[place] for place in source.places)
    if source.units != wanted:
        raise InputError(
            f"{source.name}: unit is {source.unit!r}, and {', '.join(map(repr, source.places))} needs "
            f"{', '.join(wanted)}; convert it"
        )


def _lines(
    network: Network, source: Source, low: float, high: float
) -> tuple[Float64[np.ndarray, " lines"], Complex128[np.ndarray, "errors lines"]]:
    """Frequency and complex size, by error, of every line that the tones of a source leave in the errors."""
    tones = np.array(source.tones, complex).reshape(-1, 1 + len(source.places))
    order = list(network.places)
    columns = [order.index(place) for place in source.places]
    acts_between = np.array([place in network.disturbances for place in source.places])
    found = [(np.zeros(0), np.zeros((len(network.errors), 0), complex))]
    for fold in range(-network._folds(high), network._folds(high) + 1):
        at = tones[:, 0].real - fold * network.rate_hz
        inside = (np.abs(at) >= low) & (np.abs(at) <= high)
        if not inside.any():
            continue
        at, amplitudes = at[inside], tones[inside, 1:].T
        here = np.abs(at)
        direct = network.paths(here)
        path = direct[:, columns]
        if fold:
            for k in np.flatnonzero(acts_between):
                up, down = (network._folded(direct, here, way)[:, columns[k]] for way in (fold, -fold))
                path[:, k] = np.where(at > 0, up, down)
        # A negative frequency is the positive one, conjugated.
        found.append((here, np.einsum("zif,if->zf", path, np.where(at > 0, amplitudes, amplitudes.conj()))))
    return np.concatenate([at for at, _ in found]), np.concatenate([sizes for _, sizes in found], axis=1)


@checked
def tone_response(
    network: Network, source: Source, time: Vector, band_hz: tuple[Positive, float]
) -> Float64[np.ndarray, "errors samples"]:
    """The errors over time due to the tones of a source, such as a setpoint's, in the steady state.

    Parameters
    ----------
    network : Network
    source : Source
        Only its tones are used.
    time : array_like, shape (samples,)
        s.
    band_hz : tuple of float
        From where to where lines count.

    Returns
    -------
    ndarray, shape (errors, samples)

    Examples
    --------
    >>> spring = lti.StateModel([[-10.0]], [[1.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
    >>> gain = lti.StateModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-5.0]])
    >>> net = control.Network(spring, gain, {"load": "N"}, {"drive": "N"}, {"error": "m"}, {"sensor": "m"})
    >>> hum = control.Source("hum", ("load",), "N", tones=((1e-3, 3.0),))
    >>> control.tone_response(net, hum, [0.0], (1e-4, 1.0)).round(3)  # 3 N over 15 N/m
    array([[0.2]])
    """
    _require_units(network, source)
    require_number("band_hz[1]", band_hz[1], above=band_hz[0])
    at, sizes = _lines(network, source, *band_hz)
    found = np.zeros((len(network.errors), len(time)))
    for hertz, size in zip(at, sizes.T, strict=True):
        found += (size[:, None] * np.exp(2j * np.pi * hertz * time)).real
    return found


def _quadrature(
    low: float, high: float, poles: np.ndarray, knots: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes and weights on panels that narrow towards every pole, and end at every knot."""
    edges = [np.geomspace(low, high, int(np.ceil(PANELS * np.log10(high / low))) + 1), knots]
    poles = poles[(poles.real < 2 * high) & (poles.imag < poles.real)]
    if len(poles):
        narrow = max(float((poles.real / np.maximum(poles.imag, 1e-9 * poles.real)).max()), 1.0)
        steps = 0.5 * RATIO ** np.arange(np.ceil(np.log(2 * narrow) / np.log(RATIO)) + 1)
        away = np.maximum(poles.imag, 1e-9 * poles.real)[:, None] * steps
        away[away > poles.real[:, None]] = 0.0
        edges += [(poles.real[:, None] + sign * away).ravel() for sign in (-1, 1)]
    edge = np.unique(np.concatenate(edges))
    edge = edge[(edge > low) & (edge < high)]
    edge = np.concatenate([[low], edge[np.diff(edge, prepend=low) > 1e-12 * edge], [high]])
    half = np.diff(edge) / 2
    return ((edge[:-1] + half)[:, None] + half[:, None] * NODES).ravel(), (half[:, None] * WEIGHTS).ravel()


class BoxBand(NamedTuple):
    """Errors at sampled points of a box of uncertainty."""

    rms: Float64[np.ndarray, "places ..."]  # NaN where unstable
    unstable: int  # places at which the loop is unstable


@checked
def box_places(
    uncertainty: Uncertainty, plant: ModalModel, count: Count, seed: int = 0
) -> list[Perturbation]:
    """Points that fill the box around a plant evenly, by a scrambled Sobol sequence; the rigid body's mass is among the numbers."""
    box = uncertainty._of_modes(plant)
    n = len(plant.frequencies)
    whole = 1 << (count - 1).bit_length()  # of other numbers than powers of 2 scipy warns
    size = 3 * n + 3 + bool(box.friction)
    draws = qmc.Sobol(size, seed=seed).random(whole)[:count] * 2 - 1
    if not box.friction:
        draws = np.hstack([draws, np.zeros((count, 1))])
    order = [*range(3 * n), 3 * n + 1, 3 * n + 2, 3 * n, 3 * n + 3]  # gain, mass, delay, friction
    return [place_at(box, draw) for draw in draws[:, order]]


@checked(missing=True)
def box_band(rms: Callable[..., Any], places: Sequence[Perturbation]) -> BoxBand:
    """The error at each point of a box, and the number of points at which the loop is unstable.

    Parameters
    ----------
    rms : callable
        The error, a number or several, as a function of a `Perturbation`; it raises `UnstableLoop` where the loop is
        unstable, as `Network` does.
    places : sequence of Perturbation
        See `box_places` and `corners`.
    """
    found: dict[int, np.ndarray] = {}
    for number, place in enumerate(places):
        try:
            found[number] = np.asarray(user_callback(rms)(place), float)
        except UnstableLoop:
            continue
    whole = np.full((len(places), *next(iter(found.values()), np.zeros(())).shape), np.nan)
    for number, values in found.items():
        whole[number] = values
    return BoxBand(whole, len(places) - len(found))
