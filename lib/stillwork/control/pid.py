"""The feedback controllers: PID with low-pass (3.1), and notches."""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from jaxtyping import Complex128, Float64

from stillwork.base.bounds import NonNegative, Positive, within
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.lti.state_space import StateModel, interconnect


@by_value
@dataclass(frozen=True)
class Notch:
    r"""Notch :math:`(s^2 + 2\zeta_1\omega s + \omega^2)/(s^2 + 2\zeta_2\omega s + \omega^2)`."""

    omega: Positive  # rad/s
    depth: NonNegative = 0.001  # zeta_1; the thesis prints 0.002 = 2 zeta_1
    width: Positive = 0.1  # zeta_2; the thesis prints 0.2 = 2 zeta_2

    def __post_init__(self):
        check_fields(self)

    @checked
    def at(self, s: Complex128[np.ndarray, "..."]) -> Complex128[np.ndarray, "..."]:
        """Response at complex frequencies.

        Parameters
        ----------
        s : array_like of complex
            Complex frequencies, rad/s.
        """
        w = self.omega
        return (s * s + 2 * self.depth * w * s + w**2) / (s * s + 2 * self.width * w * s + w**2)

    @checked
    def state_space(self) -> StateModel:
        w = self.omega
        a = np.array([[0, w], [-w, -2 * self.width * w]])
        c = np.array([[0, 2 * (self.depth - self.width) * w]])
        return StateModel(a, np.array([[0.0], [1.0]]), c, np.ones((1, 1)))


@by_value
@dataclass(frozen=True)
class Pid:
    r"""Controller (3.1), :math:`K_p\frac{s+\omega_i}{s}(\frac{s}{\omega_d}+1)\frac{\omega_{lp}^2}{s^2+2z\omega_{lp}s+\omega_{lp}^2}`."""

    gain: Positive  # Kp, N/m
    integrator: Positive  # omega_i, rad/s
    differentiator: Positive  # omega_d, rad/s
    low_pass: Positive  # omega_lp, rad/s
    low_pass_damping: Positive = 0.7
    notches: tuple[Notch, ...] = ()

    def __post_init__(self):
        check_fields(self)

    @checked
    def frequency_response(
        self, omega: Float64[np.ndarray, " frequencies"]
    ) -> Complex128[np.ndarray, " frequencies"]:
        """Response at `omega` (rad/s).

        Parameters
        ----------
        omega : array_like, shape (frequencies,)
            Frequencies, rad/s.
        """
        s, w = 1j * omega, self.low_pass
        response = self.gain * (s + self.integrator) / s * (s / self.differentiator + 1)
        response *= w**2 / (s * s + 2 * self.low_pass_damping * w * s + w**2)
        for notch in self.notches:
            response *= notch.at(s)
        return response

    @checked
    def state_space(self) -> StateModel:
        """Realisation by partial fractions: an integrator in parallel with the low-pass, each with its own scale."""
        return self._realised

    @property
    def model(self) -> StateModel:
        """The same as a model: `state_space`."""
        return self._realised

    @cached_property  # one controller closes the loop at every position
    def _realised(self) -> StateModel:
        w, z, wi, wd = self.low_pass, self.low_pass_damping, self.integrator, self.differentiator
        a = np.array([[0, 0, 0], [0, 0, w], [0, -w, -2 * z * w]], dtype=float)
        slope, offset = w**2 / wd - wi, w**2 * (1 + wi / wd) - 2 * z * w * wi
        c = self.gain * np.array([[wi, offset / w, slope]])
        model = StateModel(a, np.array([[1.0], [0.0], [1.0]]), c, np.zeros((1, 1)))
        return series([model, *(notch.state_space() for notch in self.notches)])


@checked
def series(models: list[StateModel]) -> StateModel:
    """Single-input single-output models in a row."""
    if len(models) == 1:
        return models[0]
    n = len(models)
    first, last = np.eye(n)[:, :1], np.eye(n)[-1:]
    return interconnect(models, np.eye(n, k=-1), first, last)


@by_value
@dataclass(frozen=True)
class PidFamily:
    """Controllers with one free parameter, the design bandwidth: the rules of Table 3.3, where `lead` is 3.

    Parameters
    ----------
    mass : float
        kg.
    notch_frequencies : tuple of float
        rad/s.
    lead : float
        Ratio of the bandwidth to the zero below it, and of the low-pass to the bandwidth; above 1.

    Raises
    ------
    InputError
        When the mass is not positive or the lead not above 1.

    References
    ----------
    Verkerk, Improved accuracy of flexible systems by state estimation, thesis (2018), (3.1), Table 3.3.

    Examples
    --------
    >>> pid = control.PidFamily(mass=10.0)(bandwidth_hz=50.0)
    >>> round(pid.gain)  # N/m: m w^2 / 3
    328987
    """

    mass: Positive  # kg
    notch_frequencies: tuple[float, ...] = ()  # rad/s
    lead: Annotated[float, within(above=1.0)] = (
        3.0  # of the bandwidth to the zero below it, and of the low-pass above it
    )

    def __post_init__(self):
        check_fields(self)

    @checked
    def __call__(self, bandwidth_hz: Positive) -> Pid:
        """The controller with design parameter f_bw (Hz)."""
        w = 2 * np.pi * bandwidth_hz
        notches = tuple(Notch(omega) for omega in self.notch_frequencies)
        lead = self.lead
        return Pid(self.mass * w**2 / lead, w / (lead * lead), w / lead, lead * w, notches=notches)
