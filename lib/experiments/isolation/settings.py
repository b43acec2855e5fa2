"""Settings of a rig's instruments and controller, and the filters that follow from the instruments."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from stillwork.base.bounds import Count, Natural, NonNegative, Positive
from stillwork.base.checks import InputError, require_array, require_number
from stillwork.base.validation import check_fields
from stillwork.control import isolation_filters as shaping
from stillwork.control.isolation_filters import NoiseShaping, SecondaryPath
from stillwork.lti.discretisation import tustin_sections


@dataclass(frozen=True)
class Instruments:
    """Sampling, actuators, sensors and their noise.

    Noise levels are one-sided amplitude densities in m/s^2/sqrt(Hz), mains amplitudes in m/s^2.
    """

    sample_rate: Positive  # Hz
    actuator_pole_hz: Positive
    force_limit: Positive  # N: a larger command ends a simulation as unstable
    parasitic_hz: Positive  # resonance beside the suspension
    parasitic_damping: Positive  # relative
    parasitic_gain: NonNegative  # 1/kg: its share of acceleration per force, 0 for none
    conditioning_highpass_hz: Positive
    conditioning_lowpass_hz: Positive
    floor_noise: NonNegative  # n0, of each floor sensor
    platform_noise: NonNegative  # n1, of each platform sensor: all of a1 that does not come from the floor
    mains_hz: list[float] = field(default_factory=list)
    floor_mains: list[float] = field(default_factory=list)
    platform_mains: list[float] = field(default_factory=list)

    def __post_init__(self):
        check_fields(self)
        require_number("parasitic_hz", self.parasitic_hz, below=self.sample_rate / 2)
        lines = len(require_array("mains_hz", self.mains_hz, ndim=1))
        for name in ("floor_mains", "platform_mains"):
            if len(require_array(name, getattr(self, name), ndim=1)) != lines:
                raise InputError(f"{name} has not one amplitude for each of mains_hz; give {lines}")

    @property
    def sample_time(self) -> float:
        """s."""
        return 1 / self.sample_rate

    @cached_property
    def actuator(self) -> np.ndarray:
        """Sections of the actuator's lag."""
        pole = 2 * np.pi * self.actuator_pole_hz
        return tustin_sections([], [-pole], pole, self.sample_time)

    @cached_property
    def parasitic(self) -> np.ndarray:
        """Sections from force to the acceleration of the parasitic resonance."""
        omega = shaping.prewarped_corner("parasitic_hz", self.parasitic_hz, self.sample_time)
        poles = np.roots([1, 2 * self.parasitic_damping * omega, omega**2])
        return tustin_sections([0, 0], poles, self.parasitic_gain, self.sample_time)

    @cached_property
    def conditioning(self) -> np.ndarray:
        """Sections of the signal conditioners."""
        return shaping.conditioning(
            self.sample_time, self.conditioning_highpass_hz, self.conditioning_lowpass_hz
        )


@dataclass(frozen=True)
class Skyhook:
    """Skyhook damping, eq. (1)."""

    gain: NonNegative  # k_v, N s/m
    cutoff: Positive  # w_i of the weak integrator, rad/s
    notch_hz: Positive

    def __post_init__(self):
        check_fields(self)


@dataclass(frozen=True)
class SelfTunedFeedforward:
    """Settings of the self-tuned feedforward, Sections 3 and 4."""

    integrator_order: Count  # n
    integrator_cutoff_hz: Positive  # alpha
    integrator_powers: Natural  # highest power of the weak integrator among the regressors
    beta: Positive  # 1/s: the weak integrator's normalisation
    shaping: NoiseShaping
    path: SecondaryPath  # eq. (2)

    def __post_init__(self):
        check_fields(self)
